"""Diagnosis of recordings of real machines, compared with published results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from excite import recordings
from excite.diagnosis import diagnosis, interval
from excite.diagnosis.diagnosis import Diagnosis, DiagnosisOptions
from excite.errors import ExciteWarning
from excite.identification import prior as prior_module
from excite.robot import base_parameters, inertial_parameters, limits, robot

REAL = Path(__file__).resolve().parent.parent.parent / "shared" / "recordings"
pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")


def diagnose_machine(
    name: str,
    train: tuple[str, ...],
    held_out: str,
    prior: str | None = None,
    band: float | None = None,
) -> Diagnosis:
    folder = REAL / name
    machine = robot.load(str(folder / f"{name}.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    training, validation = (
        [recordings.read(folder / f"{file}.csv", machine, table) for file in files]
        for files in (train, (held_out,))
    )
    trusted = (
        prior_module.read_trusted_parameters(folder / prior, machine, standard) if prior else {}
    )
    return diagnosis.diagnose(
        machine,
        standard,
        base_parameters.find(machine, standard, table),
        training,
        validation,
        DiagnosisOptions(band, trusted),
    )


def relative(result: Diagnosis) -> np.ndarray:
    return np.asarray(result.after / result.torque)


def values(result: Diagnosis, effect: str, joint: int | None) -> dict[str, float]:
    number = next(
        i for i, h in enumerate(result.verdict.chosen) if (h.effect, h.joint) == (effect, joint)
    )
    return {
        key: value
        for key, (value, _) in interval.finding_parameters(
            result.design, result.verdict, number
        ).items()
    }


def test_emps_has_asymmetric_viscous_friction():
    result = diagnose_machine("emps", ("train",), "validate_pulses")
    assert (
        22.0 < result.hertz < 30.0
    )  # a fast axis, whose friction has a wider spectrum than that of an arm
    viscous = values(result, "asymmetric_viscous", 0)
    assert viscous["positive"] == pytest.approx(167.0, rel=0.05) and viscous[
        "negative"
    ] == pytest.approx(240.0, rel=0.05)
    assert relative(result)[0] <= 0.030
    (change,) = result.changes  # the residual of the pulses is slightly higher friction
    assert (
        change.is_significant
        and 4.0 < change.change[1] < 14.0
        and result.fitted[1][0] < 1.2 * result.noise_rms[0]
    )


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
def test_tx40_has_coupled_wrist_joints():
    result = diagnose_machine("tx40", ("train",), "validate")
    assert {(h.effect, h.joint) for h in result.verdict.chosen} >= {
        ("coupling", 4),
        ("coupling", 5),
    }
    friction = values(result, "coupling", 4)
    assert friction["viscous"] == pytest.approx(0.62, rel=0.15) and friction[
        "coulomb"
    ] == pytest.approx(1.95, rel=0.15)
    assert relative(result)[4] <= 0.43


def test_kuka_has_a_payload_and_a_counterbalance_spring():
    result = diagnose_machine("kuka_kr300", ("traj_A", "traj_B"), "traj_C", prior="prior.json")
    names = {(h.effect, h.joint) for h in result.verdict.chosen}
    assert ("payload", 5) in names and ("spring", 1) in names
    assert values(result, "payload", 5)["mass"] == pytest.approx(150.0, rel=0.1)
    assert relative(result)[1] <= 0.05
    first, second, third = result.gears
    assert second.stiffness is not None and second.stiffness[0] == pytest.approx(7.5e6, rel=0.3)
    assert third.stiffness is not None and third.stiffness[0] == pytest.approx(4.1e6, rel=0.3)
    assert first.backlash is not None and 2e-5 < first.backlash[0] < 2e-4
    assert all(gear.after < 0.15 * gear.before for gear in result.gears)


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
def test_a_bare_motor_has_cogging_torque_of_order_72():
    folder = REAL / "laas_cogging"
    machine = robot.load(str(folder / "motor.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    first, last = (
        recordings.read(folder / f"{name}.csv", machine, table)
        for name in ("speed_1rev_per_s_comp_off_then_on", "speed_test_b")
    )
    result = diagnosis.diagnose(
        machine, standard, base_parameters.find(machine, standard, table), [first], [last]
    )
    assert result.hertz > 72.0  # chosen from the data
    (finding,) = (f for f in result.verdict.findings if f.main.effect == "torque_ripple")
    ripples = [result.design.shapes[part.shape].values for part in finding.parts]
    assert abs(ripples[0]["order"] - 72.0) < 0.1 and {"twice", "thrice"} <= set(
        ripples[0]
    )  # with orders 144 and 216
    assert all(
        abs(ripple["order"] / 6.0 - round(ripple["order"] / 6.0)) < 0.01 for ripple in ripples
    )  # multiples of the common order of poles and slots
    assert relative(result)[0] < 0.2
