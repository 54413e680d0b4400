"""A robot on its feet, simulated with contact: the chain from design to identification."""

from __future__ import annotations

import json
import re
import shutil
import sys

import numpy as np
import pytest
from test_support_design import walker_urdf

from excite.api import (
    identify_floating,
    load_floating_robot,
    read_floating_recording,
    simulate_standing,
)
from excite.cli.main import main
from excite.errors import CheckFailed, UnusableInput
from excite.identification import floating_regression
from excite.identification.consistency import is_consistent
from excite.identification.lowpass import Grid, LowPassFilter
from excite.robot import floating_base
from excite.robot.floating_base import Rows
from excite.robot.inertial_parameters import DRIVE

pytest.importorskip("mujoco")

FEET = ("left_sole", "right_sole")
HERTZ = 10.0
"""Cutoff frequency at which equations are compared [Hz]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Walker, its design in double support, and a simulated recording with little noise."""
    out = tmp_path_factory.mktemp("standing")
    (out / "walker.urdf").write_text(walker_urdf(), encoding="utf-8")
    words = ("design", out / "walker.urdf", "--floating", "--support", ",".join(FEET))
    words += ("--sole", "0.2,0.12,0.01,0", "--duration", 2, "--harmonics", 3, "--iterations", 6)
    words += ("--starts", 1, "--wrench-noise", "0.5,1.5", "-o", out / "design")
    assert main([str(word) for word in words]) == 0
    return out


@pytest.fixture(scope="module")
def simulated(folder):
    result = simulate_standing(
        folder / "walker.urdf",
        folder / "design" / "trajectory.json",
        wrench_noise=(0.05, 0.01),
        torque_noise=(0.01,),
        model_error=0.1,
        seed=2,
    )
    result.save(folder / "feet.csv")
    return result


@pytest.fixture(scope="module")
def robot(folder):
    return load_floating_robot(folder / "walker.urdf")


def test_recorded_wrenches_agree_with_our_dynamics_of_the_true_bodies(folder, simulated, robot):
    """MuJoCo's contact forces, against Pinocchio's regressor times the true parameters."""
    recording = read_floating_recording(folder / "feet.csv", robot)
    assert recording.contacts == FEET
    parameters = floating_base.standard_parameters(robot, floating_base.limits(robot), DRIVE)
    true = np.array(list(simulated.truth["parameters"].values()))
    band = LowPassFilter(HERTZ, recording.rate, len(recording))
    motion = floating_regression.filtered_motion(recording, robot, band, Grid.RECORDED, 1.0)
    maps = floating_regression.contact_maps(robot, motion, FEET, Rows.BASE)
    wrenches = np.hstack([recording.wrench(frame) for frame in FEET])
    measured = np.einsum("trk,tk->tr", maps, wrenches)
    inner = slice(len(measured) // 5, 4 * len(measured) // 5)

    def error(psi):
        Y = floating_base.regressor(robot, parameters, motion, Rows.BASE)
        rows = floating_regression.in_world_axes(Y @ psi, motion.pose) - measured
        smooth = band.transform(rows).filter(Grid.RECORDED, 0, 1.0)[inner]
        return np.sqrt(np.mean(smooth**2, axis=0))

    size = measured[inner].std(axis=0)
    assert (error(true) < 0.02 * size).all()
    assert (error(true) < 0.2 * error(parameters.nominal)).all()


def test_the_feet_carry_the_true_weight_and_stay_in_place(simulated, robot):
    masses = [
        value
        for name, value in simulated.truth["parameters"].items()
        if re.fullmatch(r"m\d+", name)
    ]
    first = dict(zip(simulated.columns, simulated.table[0], strict=True))
    weight = sum(first[f"wrench.{foot}.fz"] for foot in FEET)
    assert weight == pytest.approx(9.81 * sum(masses), rel=0.01)
    assert weight != pytest.approx(9.81 * robot.mass, rel=0.01)
    standing = simulated.truth["standing"]
    assert standing["slip"] < 0.01
    assert max(standing["tracking_error"].values()) < 0.05


def test_the_recording_identifies_the_bodies(folder, simulated, robot):
    result = identify_floating(robot, [folder / "feet.csv"], rows="base", gamma=1.0).identification
    assert is_consistent(result.model.parameters, result.psi)
    fitted = result.fits[0]
    assert (fitted.error() < 0.5 * fitted.error("nominal")).all()
    true = np.array(list(simulated.truth["parameters"].values()))[: result.model.parameters.count]
    base = result.model.base.matrix
    root = result.information_root

    def distance(psi):
        return np.linalg.norm(root @ base @ (psi - true))

    assert distance(result.psi) < 0.1 * distance(result.prior.nominal)


def test_the_total_wrench_needs_no_joint_torque(folder, simulated):
    total = simulate_standing(
        folder / "walker.urdf",
        folder / "design" / "trajectory.json",
        contacts=("world",),
        wrench_noise=(1e-6, 1e-6),
        model_error=0.1,
        rate=125.0,
        seed=2,
    )
    assert not any(name.startswith("tau.") for name in total.columns)
    assert total.table[1, 0] == pytest.approx(1.0 / 125.0)
    force = total.table[0, total.columns.index("wrench.world.fz")]
    feet = sum(simulated.table[:5, simulated.columns.index(f"wrench.{f}.fz")] for f in FEET)
    assert force == pytest.approx(feet.mean(), rel=0.02)


def run(capsys, *words):
    code = main([str(word) for word in words])
    out, err = capsys.readouterr()
    return code, out, err


def test_the_command_writes_recording_and_truth(folder, capsys):
    code, out, err = run(
        capsys,
        *("simulate", folder / "walker.urdf", folder / "design" / "trajectory.json"),
        *("--floating", "--rate", 125, "--json", "-o", folder / "command.csv"),
    )
    assert code == 0, err
    document = json.loads(out)
    assert document["standing"]["slip"] < 0.01
    assert f"wrench.{FEET[1]}.mz" in document["columns"]
    truth = json.loads((folder / "command.truth.json").read_text(encoding="utf-8"))
    assert truth["parameters"]["Fc3"] > 0.0


def test_a_robot_on_soles_smaller_than_planned_falls(folder):
    tiptoe = folder / "tiptoe"
    shutil.copytree(folder / "design", tiptoe)
    design = json.loads((tiptoe / "trajectory.json").read_text(encoding="utf-8"))
    for foot in design["support"]:
        foot["half_length"] = 0.005
    (tiptoe / "trajectory.json").write_text(json.dumps(design), encoding="utf-8")
    with pytest.raises(CheckFailed, match=r"falls at .*--cop-margin"):
        simulate_standing(folder / "walker.urdf", tiptoe / "trajectory.json")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("{json}", "--contact", "left_sole"), "name all of them, or 'world'"),
        (("{other}",), "its schema is 'excite.other/1'"),
        (("{csv}", "--rate", "200"), "--rate: the recording has the times"),
        (("{footless}",), "support: should hold 1 or 2 feet, not 0"),
        (("{linkless}",), "support: 'sole' is no link"),
        (("{json}", "--effect", "payload:arm"), "--effect: is not available with --floating"),
    ],
)
def test_faults_are_one_line_with_exit_code_2(folder, capsys, words, message):
    design = json.loads((folder / "design" / "trajectory.json").read_text(encoding="utf-8"))
    changed = {
        "other": {"schema": "excite.other/1"},
        "footless": {"support": []},
        "linkless": {"support": [{**design["support"][0], "frame": "sole"}]},
    }
    paths = {
        "json": folder / "design" / "trajectory.json",
        "csv": folder / "design" / "trajectory.csv",
    }
    for name, change in changed.items():
        paths[name] = folder / f"{name}.json"
        paths[name].write_text(json.dumps({**design, **change}), encoding="utf-8")
    code, _, err = run(
        capsys,
        *("simulate", folder / "walker.urdf", *(word.format(**paths) for word in words)),
        *("--floating", "-o", folder / "fault.csv"),
    )
    assert code == 2
    assert message in err.splitlines()[-1]
    assert not (folder / "fault.csv").exists()


def test_without_mujoco_a_line_says_what_to_install(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    code, _, err = run(
        capsys,
        *("simulate", folder / "walker.urdf", folder / "design" / "trajectory.json"),
        *("--floating", "-o", folder / "none.csv"),
    )
    assert code == 2
    assert err.splitlines()[-1].endswith("install the extra: .venv/bin/pip install -e '.[sim]'")


def test_another_robot_is_refused(folder):
    other = folder / "other.urdf"
    other.write_text(walker_urdf().replace('value="9.0"', 'value="9.5"'), encoding="utf-8")
    with pytest.raises(UnusableInput, match="sha256 differs"):
        simulate_standing(other, folder / "design" / "trajectory.json")
