#!/usr/bin/env python
"""Conceal simulated effects in recordings of real machines, and see what `diagnose` names.

Real machines have frictions and errors of their own, of which nobody knows the truth. An effect of
the simulator, in a form that the diagnosis does not use, adds torque along the recorded motion;
what the diagnosis finds in addition to what it finds in the recording as it is can be judged. The
effect is scaled to a multiple of what the diagnosis leaves in the recording as it is.

    python scripts/concealed_in_recordings.py --data DIR [--only TX40] [--severity 3]
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from held_out_errors import DataSet
from scipy.interpolate import make_interp_spline

from excite import recordings
from excite._types import FloatArray
from excite.diagnosis import diagnosis, fitted_effects
from excite.diagnosis.diagnosis import Diagnosis
from excite.effects import EFFECTS_BY_NAME
from excite.errors import UnusableInput
from excite.identification.prior import TrustedPrior
from excite.recordings import Recording
from excite.robot import base_parameters, inertial_parameters, limits
from excite.robot import robot as robots
from excite.simulator.effect_instance import sample_effect, with_effects
from excite.simulator.effects import EFFECT_TYPES
from excite.simulator.experiment import ExperimentSettings, build_robot, measurement_chain
from excite.simulator.reference_trajectory import ReferenceTrajectory
from excite.simulator.severity import Severity, residual_torque, scale_to_severity
from excite.simulator.simulated_robot import SimulatedMotion, SimulatedRobot

DATA_SETS = {
    "TX40": DataSet("tx40/tx40.urdf", ["train"], ["validate"]),
    "KR300": DataSet("kuka_kr300/kuka_kr300.urdf", ["traj_A", "traj_B"], ["traj_C"]),
    "Panda": DataSet("panda_unit2/panda.urdf", ["train"], ["validate"]),
    "LWR4": DataSet("lwr4/lwr4.urdf", ["slow_1", "slow_2"], ["fast_3"]),
    "double pendulum": DataSet(
        "double_pendulum/double_pendulum.urdf",
        ["trajectory_00", "trajectory_01", "trajectory_03"],
        ["trajectory_02"],
    ),
}
"""Machines of the shared recordings, whose folder `--data` names."""
EFFECTS = (
    *("asymmetric_viscous", "stribeck", "drag", "load_friction", "position_friction"),
    *("torque_ripple", "spring", "coupling", "torque_saturation", "contact"),
    *("payload", "torque_gain", "torque_offset", "rotor_inertia", "kinematic_error"),
)
"""Effects that only add torque along a given motion; the last five need a trusted prior."""
SMOOTHING_HERTZ = 10.0
"""Cutoff frequency of the recorded positions along which the simulated robot moves [Hz]."""
PAUSE = 0.2
"""Time at both ends of a recording that the simulated robot does not follow [s]."""
SEVERITY_RANGE = (1.0, 10.0)
"""Severities between which a case is counted: physics limits some effects, and a motion that the
simulated controller cannot follow adds torque of its own."""
SAME_CURVE = {"drag": ("nonlinear_viscous",), "nonlinear_viscous": ("drag",)}
"""Names of one thing (the contract)."""


@dataclass(frozen=True)
class Subject:
    """A robot with its parameters, prepared once for all diagnoses.

    Attributes:
        robot: The robot.
        table: Its limits.
        parameters: Layout of its standard parameters.
        base: Its base parameters.
    """

    robot: robots.Robot
    table: limits.Limits
    parameters: inertial_parameters.Parameters
    base: base_parameters.Base

    @classmethod
    def read(cls, urdf: Path) -> Subject:
        """Read a robot."""
        robot = robots.load(str(urdf))
        table = limits.resolve(robot)
        parameters = inertial_parameters.standard_parameters(robot, table)
        return cls(robot, table, parameters, base_parameters.find(robot, parameters, table))

    def diagnose(
        self,
        train: Sequence[Recording],
        validate: Sequence[Recording],
        prior: TrustedPrior,
    ) -> Diagnosis:
        """Diagnose recordings.

        Args:
            train: Recordings to fit.
            validate: Held-out recordings.
            prior: What is known.
        """
        return diagnosis.diagnose(
            self.robot, self.parameters, self.base, train, validate, prior=prior
        )


@dataclass(frozen=True)
class Machine:
    """A real machine, its recordings, and what the diagnosis finds in them as they are.

    Attributes:
        urdf: Path of its URDF.
        subject: The robot.
        train: Recordings to fit.
        validate: Held-out recordings.
        saved: The saved model, as a trusted prior.
        findings: Effect and joint of all findings, without and with the prior.
        residual: RMS that the diagnosis leaves without and with the prior, shapes (n,) [N m].
    """

    urdf: Path
    subject: Subject
    train: Sequence[Recording]
    validate: Sequence[Recording]
    saved: TrustedPrior
    findings: Mapping[bool, set[tuple[str, str | None]]]
    residual: Mapping[bool, FloatArray]


def findings(result: Diagnosis) -> set[tuple[str, str | None]]:
    """Return effect and joint of all findings."""
    joints = result.identified.model.robot.joints
    return {(f.effect, None if f.joint is None else joints[f.joint]) for f in result.findings}


def load(folder: Path, data: DataSet) -> Machine:
    """Read a machine's recordings and diagnose them as they are.

    Args:
        folder: Folder of the recordings.
        data: The machine.
    """
    urdf = folder / data.robot
    subject = Subject.read(urdf)
    train, validate = (
        [
            recordings.read(urdf.parent / f"{name}.csv", subject.robot, subject.table)
            for name in names
        ]
        for names in (data.train, data.validate)
    )
    without_prior = subject.diagnose(train, validate, TrustedPrior())
    saved = TrustedPrior.of_model(fitted_effects.read_back(without_prior.document))
    results = {False: without_prior, True: subject.diagnose(train, validate, saved)}
    return Machine(
        urdf,
        subject,
        train,
        validate,
        saved,
        {key: findings(result) for key, result in results.items()},
        {key: result.residual for key, result in results.items()},
    )


def recorded_reference(recording: Recording) -> ReferenceTrajectory:
    """Return the motion of a recording as a commanded motion, from 0 s on.

    Args:
        recording: The recording.
    """
    q = recording.samples(SMOOTHING_HERTZ).q
    position = make_interp_spline(recording.t - recording.t[0], q, k=5)
    speed, acceleration = position.derivative(), position.derivative(2)
    end = float(recording.t[-1] - recording.t[0])

    def at(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        inside = np.clip(t, 0.0, end)
        return position(inside), speed(inside), acceleration(inside)

    return ReferenceTrajectory(recording.joints, at, end, end, (PAUSE, end - PAUSE), {})


def with_added_torque(
    recording: Recording, reference: ReferenceTrajectory, pair: Sequence[SimulatedRobot]
) -> Recording:
    """Return a recording with the torque by which a simulated robot with an effect differs.

    Args:
        recording: The recording.
        reference: Its motion.
        pair: The simulated robot with and without the effect.
    """
    t = recording.t - recording.t[0]
    with_, without = (robot.follow(reference).measured(t)[1] for robot in pair)
    return dataclasses.replace(recording, tau=recording.torque + with_ - without, current=None)


def conceal(
    machine: Machine, name: str, joint: str | None, severity: float, seed: int
) -> tuple[list[Recording], list[Recording], float]:
    """Conceal an effect in the recordings of a machine.

    Args:
        machine: The machine.
        name: Name of the effect.
        joint: Its joint; None: the whole robot.
        severity: Its torque after a refit of the base model, over what the diagnosis leaves in the
            recordings as they are, at the joint with the largest ratio [1].
        seed: Seed of the effect's parameters.

    Returns:
        Recordings to fit, held-out recordings, and the severity that was reached.
    """
    trusted = EFFECTS_BY_NAME[name].prior_only
    references = [recorded_reference(r) for r in (*machine.train, *machine.validate)]
    settings = ExperimentSettings(seed=seed)
    plain = build_robot(machine.urdf, references[0], settings)
    effect_type = EFFECT_TYPES[name]
    family = list(effect_type.forms)[-1]
    effect = sample_effect(effect_type, plain, joint, family, np.random.default_rng(seed))

    def measure(motion: SimulatedMotion) -> Severity:
        torque = residual_torque(motion, plain, references[0], trusted=trusted)
        return Severity(np.sqrt(np.mean(torque**2, axis=0)) / machine.residual[trusted])

    chain = measurement_chain(plain, settings)
    scaled, _, reached = scale_to_severity(
        effect, severity, plain, references[0], chain, trusted=trusted, measure=measure
    )
    hidden = with_effects(plain, (scaled,))
    last = 1 if name == "contact" else len(references)  # a contact happens once
    out = [
        with_added_torque(recording, reference, (hidden, plain)) if k < last else recording
        for k, (recording, reference) in enumerate(
            zip((*machine.train, *machine.validate), references, strict=True)
        )
    ]
    count = len(machine.train)
    return out[:count], out[count:], reached.value


def is_named(result: Diagnosis, name: str, joint: str | None) -> bool:
    """Tell whether a finding, or one of its equivalents, is the concealed effect.

    The link of a load is less certain than its name.

    Args:
        result: The diagnosis.
        name: Name of the effect.
        joint: Its joint.
    """
    joints = result.identified.model.robot.joints
    for finding in result.findings:
        place = None if finding.joint is None else joints[finding.joint]
        names = (finding.effect, *finding.equivalents, *SAME_CURVE.get(finding.effect, ()))
        if name in names and (place in (None, joint) or EFFECTS_BY_NAME[name].of_link):
            return True
    return False


def main() -> None:
    """Print a row for each concealed effect, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    parser.add_argument("--only", nargs="*", default=list(DATA_SETS), choices=list(DATA_SETS))
    parser.add_argument("--effects", nargs="*", default=list(EFFECTS), choices=list(EFFECTS))
    parser.add_argument("--severity", type=float, default=3.0, help="size over the residual")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    named, others, total = 0, 0, 0
    print("| machine | concealed | joint | severity | named | also found | time [s] |")
    print("|---|---|---|---:|---|---|---:|", flush=True)
    for place, machine_name in enumerate(arguments.only):
        machine = load(arguments.data, DATA_SETS[machine_name])
        rng = np.random.default_rng([arguments.seed, place])
        for name in arguments.effects:
            trusted = EFFECTS_BY_NAME[name].prior_only
            joint = str(rng.choice(machine.subject.robot.joints))
            if EFFECTS_BY_NAME[name].of_link:
                joint = machine.subject.robot.joints[-1]
            seed = int(rng.integers(1000))
            try:
                train, validate, severity = conceal(machine, name, joint, arguments.severity, seed)
            except UnusableInput:  # the effect needs another joint after it
                continue
            if not SEVERITY_RANGE[0] <= severity <= SEVERITY_RANGE[1]:
                continue
            start = time.process_time()
            prior = machine.saved if trusted else TrustedPrior()
            result = machine.subject.diagnose(train, validate, prior)
            seconds = time.process_time() - start
            right = is_named(result, name, joint)
            new = sorted(
                f"{effect} {place}"
                for effect, place in findings(result) - machine.findings[trusted]
                if effect != name
            )
            named, others, total = named + right, others + len(new), total + 1
            print(
                f"| {machine_name} | {name} | {joint} | {severity:.1f} | "
                f"{'yes' if right else 'no'} | {', '.join(new)} | {seconds:.0f} |",
                flush=True,
            )
    print(f"\nnamed: {named} of {total}; other new findings: {others}")


if __name__ == "__main__":
    main()
