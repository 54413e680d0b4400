"""Diagnosis of real machines whose truth others have published, and the tool is not told."""

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


def diagnosed(
    folder: str,
    train: tuple[str, ...],
    held_out: str,
    prior: str | None = None,
    band: float | None = None,
) -> Diagnosis:
    place = REAL / folder
    machine = robot.load(str(place / f"{folder}.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    first, last = (
        [recordings.read(place / f"{name}.csv", machine, table) for name in names]
        for names in (train, (held_out,))
    )
    known = prior_module.read_trusted_parameters(place / prior, machine, standard) if prior else {}
    return diagnosis.diagnose(
        machine,
        standard,
        base_parameters.find(machine, standard, table),
        first,
        last,
        DiagnosisOptions(band, known),
    )


def relative(found: Diagnosis) -> np.ndarray:
    return np.asarray(found.after / found.torque)


def values(found: Diagnosis, effect: str, joint: int | None) -> dict[str, float]:
    number = next(
        i for i, h in enumerate(found.verdict.chosen) if (h.effect, h.joint) == (effect, joint)
    )
    return {
        key: value
        for key, (value, _) in interval.finding_parameters(
            found.design, found.verdict, number
        ).items()
    }


def test_emps_rubs_more_one_way_than_the_other():
    found = diagnosed("emps", ("train",), "validate_pulses")
    assert (
        22.0 < found.hertz < 30.0
    )  # it moves fast: what tells its friction apart reaches further than an arm's
    viscous = values(found, "asymmetric_viscous", 0)
    assert viscous["positive"] == pytest.approx(167.0, rel=0.05) and viscous[
        "negative"
    ] == pytest.approx(240.0, rel=0.05)
    assert relative(found)[0] <= 0.030
    (change,) = (
        found.changes
    )  # what is left of the pulses is friction that is a little more by then
    assert (
        change.is_significant
        and 4.0 < change.change[1] < 14.0
        and found.fitted[1][0] < 1.2 * found.noise_rms[0]
    )


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
def test_tx40_turns_its_last_motor_with_two_joints():
    found = diagnosed("tx40", ("train",), "validate")
    assert {(h.effect, h.joint) for h in found.verdict.chosen} >= {("coupling", 4), ("coupling", 5)}
    friction = values(found, "coupling", 4)
    assert friction["viscous"] == pytest.approx(0.62, rel=0.15) and friction[
        "coulomb"
    ] == pytest.approx(1.95, rel=0.15)
    assert relative(found)[4] <= 0.43


def test_kuka_carries_a_load_and_has_a_spring():
    found = diagnosed("kuka_kr300", ("traj_A", "traj_B"), "traj_C", prior="prior.json")
    names = {(h.effect, h.joint) for h in found.verdict.chosen}
    assert ("payload", 5) in names and ("spring", 1) in names
    assert values(found, "payload", 5)["mass"] == pytest.approx(150.0, rel=0.1)
    assert relative(found)[1] <= 0.05
    first, second, third = found.gears
    assert second.stiffness is not None and second.stiffness[0] == pytest.approx(7.5e6, rel=0.3)
    assert third.stiffness is not None and third.stiffness[0] == pytest.approx(4.1e6, rel=0.3)
    assert first.backlash is not None and 2e-5 < first.backlash[0] < 2e-4
    assert all(gear.after < 0.15 * gear.before for gear in found.gears)


@pytest.mark.filterwarnings(f"ignore::{ExciteWarning.__module__}.{ExciteWarning.__name__}")
def test_a_bare_motor_cogs_72_times_a_turn():
    place = REAL / "laas_cogging"
    machine = robot.load(str(place / "motor.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    first, last = (
        recordings.read(place / f"{name}.csv", machine, table)
        for name in ("speed_1rev_per_s_comp_off_then_on", "speed_test_b")
    )
    found = diagnosis.diagnose(
        machine, standard, base_parameters.find(machine, standard, table), [first], [last]
    )
    assert found.hertz > 72.0  # the data ask for it
    (ripple,) = (f for f in found.verdict.findings if f.main.effect == "torque_ripple")
    told = [found.design.shapes[part.shape].values for part in ripple.parts]
    assert abs(told[0]["order"] - 72.0) < 0.1 and {"twice", "thrice"} <= set(
        told[0]
    )  # 144 and 216 with it
    assert all(
        abs(one["order"] / 6.0 - round(one["order"] / 6.0)) < 0.01 for one in told
    )  # as all that its poles and slots make
    assert relative(found)[0] < 0.2
