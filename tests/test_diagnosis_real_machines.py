"""Diagnosis of recordings of real machines, compared with published results."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import findings_of, parameters
from slow_tests import slow

from excite import recordings
from excite._types import FloatArray
from excite.diagnosis import diagnosis, fitted_effects
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.regression import rms
from excite.errors import ExciteWarning
from excite.identification import prior as prior_module
from excite.identification.prior import TrustedPrior
from excite.recordings import Recording
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot
from excite.robot.inertial_parameters import Parameters

REAL = Path(__file__).resolve().parent.parent.parent / "shared" / "recordings"
pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")


def diagnose_machine(
    name: str,
    train: tuple[str, ...],
    held_out: str,
    prior: str | None = None,
    urdf: str | None = None,
) -> Diagnosis:
    """Diagnose a machine by its recordings in the shared folder."""
    machine, standard, base, files = machine_of(name, train, held_out, urdf)
    known = prior_module.read_prior(REAL / name / prior if prior else None, machine, standard)
    return diagnosis.diagnose(machine, standard, base, *files, prior=known)


@cache
def diagnose_tx40() -> Diagnosis:
    """Diagnose the TX40 by its recordings."""
    return diagnose_machine("tx40", ("train",), "validate")


def machine_of(
    name: str, train: Sequence[str], held_out: str, urdf: str | None = None
) -> tuple[robot.Robot, Parameters, base_parameters.Base, list[list[Recording]]]:
    """Read a machine, with its recordings to fit and to validate, in the shared folder."""
    folder = REAL / name
    machine = robot.load(str(folder / f"{urdf or name}.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    files = [
        [recordings.read(folder / f"{file}.csv", machine, table) for file in group]
        for group in (train, (held_out,))
    ]
    return machine, standard, base_parameters.find(machine, standard, table), files


def relative(result: Diagnosis) -> np.ndarray:
    """Return the held-out RMSE over the RMS torque, shape (n,)."""
    held_out = result.held_out
    return np.asarray(held_out.rmse_after / rms(held_out.torque, held_out.moving))


def assert_not_worse_than_the_base_model(result: Diagnosis) -> None:
    held_out = result.held_out
    assert (held_out.rmse_after <= 1.02 * held_out.rmse_before).all()


def test_emps_has_asymmetric_viscous_friction():
    result = diagnose_machine("emps", ("train",), "validate_pulses")
    assert 22.0 < result.hertz < 30.0  # a fast axis: its friction has a wide spectrum
    viscous = parameters(result, "asymmetric_viscous", 0)
    # published with linear friction alone: 167 and 240; here a concave part is separate
    difference = viscous["negative"][0] - viscous["positive"][0]
    assert difference == pytest.approx(240.0 - 167.0, rel=0.25)
    assert relative(result)[0] <= 0.030
    assert_not_worse_than_the_base_model(result)


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
@pytest.mark.slow
def test_tx40_has_coupled_wrist_joints():
    result = diagnose_tx40()
    assert set(findings_of(result)) >= {("coupling", 4), ("coupling", 5)}
    friction = parameters(result, "coupling", 4)
    assert friction["viscous"][0] == pytest.approx(0.62, rel=0.3)
    assert friction["coulomb"][0] == pytest.approx(1.95, rel=0.2)
    assert relative(result)[4] <= 0.5
    assert_not_worse_than_the_base_model(result)


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
@pytest.mark.parametrize("effects_are_known", [True, False])
@pytest.mark.slow
def test_a_payload_is_found_next_to_the_couplings_of_tx40(effects_are_known):
    """Parameters of a saved model are trusted, its effects are known or have to be found again."""
    machine, standard, base, files = machine_of("tx40", ("train",), "validate")
    saved = fitted_effects.read_back(diagnose_tx40().document)
    known = TrustedPrior.of_model(saved)
    if not effects_are_known:
        known = TrustedPrior(known.parameters)
    load = np.zeros(standard.count)
    load[10 * (standard.bodies - 1) :][:4] = 1.5 * np.array([1.0, 0.02, 0.0, 0.1])
    carried = [[with_load(r, machine, standard, load) for r in group] for group in files]
    result = diagnosis.diagnose(machine, standard, base, *carried, prior=known)
    named = set(findings_of(result))
    assert ("payload", 5) in named
    assert (named >= {("coupling", 4), ("coupling", 5)}) is not effects_are_known
    if effects_are_known:
        assert named == {("payload", 5)}
        assert {entry["effect"] for entry in result.document["effects"]} >= {"coupling", "payload"}


def with_load(
    recording: Recording, machine: robot.Robot, standard: Parameters, load: FloatArray
) -> Recording:
    """Return a recording with the torque of a load, a change of the standard parameters."""
    motion = recording.samples(10.0)
    torque = np.asarray(dynamics.regressor(machine, standard, motion) @ load)
    return dataclasses.replace(recording, tau=recording.torque + torque)


@pytest.mark.parametrize("train", [("traj_A", "traj_B"), ("traj_B",)])
@pytest.mark.slow
def test_kuka_has_the_documented_payload_and_counterbalance_that_its_prior_lacks(train):
    result = diagnose_machine("kuka_kr300", train, "traj_C", prior="prior.json")
    named = findings_of(result)
    assert ("payload", 5) in named and ("spring", 1) in named
    assert parameters(result, "payload", 5)["mass"][0] == pytest.approx(150.0, rel=0.1)
    held_out = result.held_out
    assert (held_out.rmse_after < [0.5, 0.2, 0.3, 0.8, 0.6, 1.2] * held_out.rmse_before).all()
    gears = {gear.joint: gear for gear in result.gears}
    if len(train) > 1:  # file B alone does not show the gears well
        assert gears[0].backlash is not None and 2e-5 < gears[0].backlash[0] < 2e-4
        assert gears[1].stiffness is not None
        assert gears[1].stiffness[0] == pytest.approx(7.5e6, rel=0.3)
        assert gears[2].stiffness is not None
        assert gears[2].stiffness[0] == pytest.approx(4.1e6, rel=0.3)
    assert all(gear.after < 0.15 * gear.before for gear in result.gears)


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
@pytest.mark.parametrize(
    ("name", "train", "held_out", "prior", "urdf"),
    [
        slow("kuka_kr300", ("traj_B",), "traj_A", "prior.json", None),
        slow("kuka_kr300", ("traj_A",), "traj_B", "prior.json", None),
        (
            *("xl330", ("kp200_sin_time_square", "kp400_up_and_down"), "kp400_sin_sin"),
            *(None, "xl330_pendulum"),
        ),
    ],
    ids=["KR300, file B", "KR300, file A", "XL330"],
)
def test_no_contact_is_found_where_none_was(name, train, held_out, prior, urdf):
    """The model error varies over time, which alone is no evidence of a contact."""
    result = diagnose_machine(name, train, held_out, prior, urdf)
    assert "contact" not in {effect for effect, _ in findings_of(result)}


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
def test_a_part_of_the_emps_recording_shows_its_friction_next_to_unknown_torque():
    """In the saved model, effects of the catalogue take the place of a flexible model."""
    machine = robot.load(str(REAL / "emps" / "emps.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    whole = recordings.read(REAL / "emps" / "train.csv", machine, table)
    cut = int(0.4 * len(whole))
    parts = [whole.rows(slice(cut, None)), whole.rows(slice(0, cut))]
    base = base_parameters.find(machine, standard, table)
    result = diagnosis.diagnose(machine, standard, base, parts[:1], parts[1:])
    saved = {effect.shape.effect for effect in result.final.saved_effects}
    assert saved >= {"asymmetric_viscous", "delay"}
    assert (result.held_out.rmse_after < 0.6 * result.held_out.rmse_before).all()


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
@pytest.mark.parametrize(
    ("train", "held_out"),
    [
        ("speed_1rev_per_s_comp_off_then_on", "speed_test_b"),
        ("speed_test_b", "speed_1rev_per_s_comp_off_then_on"),
    ],
)
@pytest.mark.slow
def test_a_bare_motor_has_cogging_torque_of_order_72(train, held_out):
    result = diagnose_machine("laas_cogging", (train,), held_out, urdf="motor")
    assert result.hertz > 72.0  # chosen from the data
    (finding,) = (f for f in result.findings if f.effect == "torque_ripple")
    order, std = finding.parameters["order"]
    assert order == pytest.approx(72.0, abs=0.1)
    assert std < 0.25, "71 and 73 cannot be told from it"
    assert "encoder_error" not in {effect for effect, _ in findings_of(result)}
    errors = result.held_out
    assert errors.rmse_after[0] < 0.6 * errors.rmse_before[0]
