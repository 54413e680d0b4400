"""Generate a case: files for the analyst in one folder, the ground truth in another."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from excite._types import FloatArray
from excite.errors import UnusableInput
from excite.simulator.actuator import ControllerGains, JointActuators
from excite.simulator.dense_robot import DenseSettings, draw_dense_effects, static_load
from excite.simulator.effect_instance import EffectInstance, sample_effect, with_effects
from excite.simulator.effects import EFFECT_TYPES
from excite.simulator.experiment import (
    ExperimentSettings,
    SimulatedSession,
    build_robot,
    measurement_chain,
    run_session,
)
from excite.simulator.recording_file import json_text
from excite.simulator.reference_trajectory import ReferenceTrajectory
from excite.simulator.severity import (
    SEVERITY_BAND,
    Severity,
    evaluate_severity,
    hidden_torque,
    scale_to_severity,
)
from excite.simulator.simulated_robot import SimulatedMotion, SimulatedRobot
from excite.simulator.urdf_tree import read_urdf

from .base_model_fit import oracle_rmse
from .case_plan import CaseSpec
from .random_excitation import draw_excitation
from .unique_severity import EffectSeverity, friction_severities, severity_of_motion

TORQUE_NOISE = 0.002
"""Usual standard deviation of the torque noise over the torque limit [1]."""
COARSE_ENCODER = 2.0 * np.pi / 2**16
"""Resolution of position under `coarse_encoder` [rad]: 16 bits per turn."""
JITTER = 5e-5
"""Standard deviation of the sampling times under `jitter` [s]."""
ANGLE_DECIMALS = 4
"""Decimals of the URDF's angles under `rounded_angles`: π/2 becomes 1.5708."""
TIME_STEP = 2e-3
"""Time step of the simulation [s]."""
SESSION_CHANGE = 0.1, 0.3
"""Range of the relative change of friction under `changed_session` [1]."""
FRICTION_PROBABILITY = {"dense": 1.0, "half_dense": 0.5}
"""Probability of each friction at each joint by category [1]."""
PERIODS = {1: (2, 1), 2: (3, 3)}
"""Periods of training and validation motions, by number of training recordings."""
LARGEST_SCALE = 10.0
"""Largest factor on the usual size of an effect, for any severity."""
DRAWS = 3
"""Number of times that a robot, or place and size of an effect, is usually drawn."""
MAX_EFFECT_DRAWS = 12
"""Number of draws of an effect where none reaches `LEAST_SEVERITY`."""
LEAST_SEVERITY = 0.5
"""Least severity of a hidden effect [1].

An effect that does not show in the recording (saturation at torques that are never reached, drag at
low speed) cannot be found by anyone.
"""


@dataclass(frozen=True)
class HiddenEffect:
    """A hidden effect and its severity.

    Attributes:
        instance: The effect.
        severity: Its severity, alone and beyond the frictions of the joint.
    """

    instance: EffectInstance
    severity: EffectSeverity


@dataclass(frozen=True)
class GeneratedCase:
    """A case before it is written.

    Attributes:
        spec: Its specification.
        urdf: The URDF that the analyst is given.
        robot: The robot without hidden effects.
        frictions: Hidden frictions of a dense robot.
        hidden: The other hidden effects.
        sessions: Training recordings, then the validation recording.
        motions: Their commanded motions.
    """

    spec: CaseSpec
    urdf: str
    robot: SimulatedRobot
    frictions: tuple[EffectInstance, ...]
    hidden: tuple[HiddenEffect, ...]
    sessions: tuple[SimulatedSession, ...]
    motions: tuple[ReferenceTrajectory, ...]

    def effects_of_session(self, number: int) -> tuple[EffectInstance, ...]:
        """Return the effects in a recording; a contact happens in the first recording only."""
        named = (effect.instance for effect in self.hidden)
        return (*self.frictions, *(e for e in named if number == 0 or e.name != "contact"))


def case_settings(spec: CaseSpec) -> ExperimentSettings:
    """Return measurement and controller of a case, with its nuisance condition.

    Where a prior is trusted, the true bodies are those of the URDF.
    """
    rng = np.random.default_rng([spec.seed, 1])
    gains = ControllerGains(
        position=float(rng.uniform(20.0, 40.0)),
        speed=float(rng.uniform(120.0, 200.0)),
        forward=float(rng.uniform(0.6, 0.95)),
    )
    if spec.nuisance == "changed_gains":
        gains = replace(gains, position=8.0, speed=60.0, forward=0.3)
    return ExperimentSettings(
        seed=int(rng.integers(2**31)),
        noise=TORQUE_NOISE
        * (5.0 if spec.nuisance == "heavy_noise" else float(rng.uniform(0.7, 1.4))),
        colour=8.0 if spec.nuisance == "coloured_noise" else None,
        jitter=JITTER if spec.nuisance == "jitter" else 0.0,
        encoder=COARSE_ENCODER if spec.nuisance == "coarse_encoder" else 2e-6,
        model_error=0.0 if spec.trusted else 0.05,
        control=gains,
    )


def generate_case(spec: CaseSpec, models: Path) -> GeneratedCase:
    """Simulate a case; the same specification gives the same numbers.

    A robot whose control loop is unstable, or in which an effect does not show, is drawn again; at
    last without the nuisance condition, then without the demand that the effect shows.

    Args:
        spec: Specification of the case.
        models: Folder of the robots' URDFs.

    Raises:
        UnusableInput: All draws are unstable.
    """
    for draw in range(DRAWS - 1):
        with suppress(UnusableInput):
            return draw_case(replace(spec, seed=spec.seed + draw), models, LEAST_SEVERITY)
    last = replace(spec, seed=spec.seed + DRAWS - 1)
    with suppress(UnusableInput):
        return draw_case(replace(last, nuisance="none"), models, LEAST_SEVERITY)
    return draw_case(last, models, 0.0)


def draw_case(spec: CaseSpec, models: Path, least_severity: float) -> GeneratedCase:
    """Draw a case in which every named effect alone has at least a given severity.

    Args:
        spec: Specification of the case.
        models: Folder of the robots' URDFs.
        least_severity: Least severity of each effect [1].

    Raises:
        UnusableInput: An effect does not reach the severity, or the loop is unstable.
    """
    rng, settings, path = (
        np.random.default_rng([spec.seed, 2]),
        case_settings(spec),
        models / f"{spec.robot}.urdf",
    )
    tree = read_urdf(path)
    robot = build_robot(path, _joints_only(tree.joints), settings)
    # where a prior is trusted, the URDF is exact
    robot = replace(robot, step=TIME_STEP, tree=tree if spec.trusted else robot.tree)
    poor = spec.nuisance == "poor_excitation"
    periods = PERIODS[spec.training]
    # the short motion is the first period of the first training motion
    streams = [(1, 3), (periods[0], 3), (periods[0], 6), (periods[1], 4)]
    if spec.training == 1:
        del streams[2]
    short, *motions = (
        draw_excitation(robot, n, np.random.default_rng([spec.seed, stream]), poor=poor)
        for n, stream in streams
    )
    frictions: tuple[EffectInstance, ...] = ()
    if spec.is_dense:
        chosen = DenseSettings(friction_probability=FRICTION_PROBABILITY[spec.category])
        load = static_load(robot, motions[0])
        frictions = draw_dense_effects(robot, load, rng, chosen, (spec.family,))
    case = GeneratedCase(spec, tree.xml, robot, frictions, (), (), tuple(motions))
    for name, level in zip(spec.names, spec.severities, strict=True):
        effect = _draw_effect(case, name, level, settings, short, rng, least_severity)
        case = replace(case, hidden=(*case.hidden, effect))
        if name == "drag":  # which is a nonlinear viscous friction
            replaced = ("nonlinear_viscous", effect.instance.joint)
            kept = (e for e in case.frictions if (e.name, e.joint) != replaced)
            case = replace(case, frictions=tuple(kept))
    return _record(case, settings)


def _record(case: GeneratedCase, settings: ExperimentSettings) -> GeneratedCase:
    """Return the case with its recordings; named effects that make the loop unstable are reduced.

    The validation recording is made later, with friction that may have changed.
    """
    last = len(case.motions) - 1
    for _ in range(4):
        try:
            sessions = [
                run_session(
                    replace(
                        with_effects(case.robot, case.effects_of_session(number)),
                        actuators=_later_actuators(case)
                        if number == last
                        else case.robot.actuators,
                    ),
                    motion,
                    replace(settings, seed=settings.seed + number),
                )
                for number, motion in enumerate(case.motions)
            ]
        except UnusableInput:
            reduced = (
                HiddenEffect(effect.instance.scaled(0.3), effect.severity.scaled(0.3))
                for effect in case.hidden
            )
            case = replace(case, hidden=tuple(reduced))
            continue
        return replace(case, sessions=tuple(sessions))
    raise UnusableInput(
        f"case {case.spec.name}: the control loop is unstable even with small effects; "
        "plan with another seed"
    )


def _later_actuators(case: GeneratedCase) -> JointActuators:
    """Return the actuators of the validation recording.

    Under `changed_session` the friction of all joints has changed by about the same factor.
    """
    actuators = case.robot.actuators
    if case.spec.nuisance != "changed_session":
        return actuators
    rng = np.random.default_rng([case.spec.seed, 5])
    factor = 1.0 + rng.choice((-1.0, 1.0)) * rng.uniform(*SESSION_CHANGE) * rng.uniform(
        0.8, 1.2, len(case.robot.joints)
    )
    return replace(
        actuators, viscous=factor * actuators.viscous, coulomb=factor * actuators.coulomb
    )


def _joints_only(joints: tuple[str, ...]) -> ReferenceTrajectory:
    """Return a reference that states the joints and no motion."""
    return ReferenceTrajectory(joints, lambda t: (t, t, t), 0.0, 1.0, (0.0, 1.0), {})


def analyst_files(case: GeneratedCase) -> dict[str, str]:
    """Return the files that the analyst is given, by name."""
    rounded = case.spec.nuisance == "rounded_angles"
    files = {"robot.urdf": with_rounded_angles(case.urdf) if rounded else case.urdf}
    for name, session in zip(recording_names(case.spec), case.sessions, strict=True):
        files[f"{name}.csv"] = session.recording.to_csv()
        files[f"{name}.json"] = json_text({**session.recording.to_sidecar(), "notes": ""})
    if case.spec.trusted:
        files["prior.json"] = _prior(case.robot)
    return files


def recording_names(spec: CaseSpec) -> tuple[str, ...]:
    """Return the names of the training recordings, then that of the validation recording."""
    if spec.training == 1:
        return "train", "validate"
    return (*(f"train{k + 1}" for k in range(spec.training)), "validate")


def with_rounded_angles(urdf: str) -> str:
    """Return a URDF whose angles have `ANGLE_DECIMALS` decimals, as many published ones."""

    def rounded(match: re.Match[str]) -> str:
        angles = (f"{float(value):.{ANGLE_DECIMALS}f}" for value in match[1].split())
        return f'rpy="{" ".join(angles)}"'

    return re.sub(r'rpy="([^"]*)"', rounded, urdf)


def _draw_effect(
    case: GeneratedCase,
    name: str,
    level: float,
    settings: ExperimentSettings,
    short: ReferenceTrajectory,
    rng: np.random.Generator,
    least_severity: float,
) -> HiddenEffect:
    """Draw an effect and scale it to its severity, on a dense robot to its unique severity.

    Place and parameters are drawn again where the joint shows too little of the effect whatever
    its size (a wrist that hardly loads its spring), or where the loop is unstable.

    Args:
        case: The case so far.
        name: Name of the effect.
        level: Wanted severity [1].
        settings: Measurement of the robot.
        short: First period of the training motion.
        rng: Generator of the draw.
        least_severity: Least accepted severity [1].

    Raises:
        UnusableInput: No draw reaches the least severity, or all are unstable.
    """
    spec, robot = case.spec, case.robot
    effect_type, n = EFFECT_TYPES[name], len(robot.joints)
    first = {"payload": n // 2, "contact": n // 2}.get(name, 0)
    end = max(n - 1, 1) if name == "kinematic_error" else n
    chain = measurement_chain(robot, settings)
    noise = chain.noise_floor(SEVERITY_BAND)
    motion = case.motions[0] if name == "thermal_drift" else short
    on_whole_robot = rng.random() < 0.3
    # most pairs share a joint, where they mask each other
    partner = case.hidden[0].instance.joint if case.hidden and rng.random() < 0.6 else None
    others = (*case.frictions, *(effect.instance for effect in case.hidden))

    def severity(effect: EffectInstance, simulated: SimulatedMotion) -> EffectSeverity:
        if spec.trusted:
            value = evaluate_severity(simulated, robot, motion, chain, trusted=True).joints
            return EffectSeverity(value, value)
        return severity_of_motion(effect, robot, simulated, motion.periodic, noise, others)

    candidates: list[tuple[float, float, EffectInstance, SimulatedMotion]] = []
    for draw in range(MAX_EFFECT_DRAWS):
        if draw >= DRAWS and candidates and max(entry[1] for entry in candidates) > LEAST_SEVERITY:
            break
        drawn = robot.joints[int(rng.integers(first, end))]
        where = partner if draw == 0 and partner in robot.joints[first:end] else drawn
        is_jointless = effect_type.place == "robot" or (
            effect_type.place == "either" and on_whole_robot
        )
        effect = sample_effect(
            effect_type, robot, None if is_jointless else where, spec.family, rng
        )

        def unique(simulated: SimulatedMotion, effect: EffectInstance = effect) -> Severity:
            return Severity(severity(effect, simulated).unique)

        try:
            scaled, simulated, reached = scale_to_severity(
                effect,
                level,
                robot,
                motion,
                chain,
                trusted=spec.trusted,
                measure=unique if spec.is_dense else None,
                tolerance=0.5,
                tries=3,
                largest=LARGEST_SCALE,
            )
        except UnusableInput as error:
            unstable = error
            continue
        distance = abs(float(np.log(max(reached.value, 1e-9) / level)))
        candidates.append((distance, reached.value, scaled, simulated))
        if distance < np.log(2.0):
            break
    if not candidates:
        raise unstable
    visible = [entry for entry in candidates if entry[1] >= least_severity]
    if not visible:
        raise UnusableInput(f"case {spec.name}: no joint shows {name}; plan with another seed")
    _, _, best, simulated = min(visible, key=lambda entry: entry[0])
    return HiddenEffect(best, severity(best, simulated))


def _prior(robot: SimulatedRobot) -> str:
    """Return the true actuators as an `excite.prior/1`."""
    actuators = robot.actuators
    joints = {
        name: {
            "coulomb": float(actuators.coulomb[j]),
            "viscous": float(actuators.viscous[j]),
            "rotor_inertia": float(actuators.inertia[j]),
            "offset": float(actuators.offset[j]),
        }
        for j, name in enumerate(robot.joints)
    }
    return json_text({"schema": "excite.prior/1", "trust_prior": True, "joints": joints})


def ground_truth(case: GeneratedCase, folder: Path) -> dict[str, Any]:
    """Return the ground truth of a case.

    `severity` and `unique_severity` of an effect are the largest of all joints, those of every
    joint are in `severity_by_joint` and `unique_severity_by_joint`. `held_out` are RMSEs on the
    validation recording [N m]: of the refit base model, of the oracle that knows the hidden torque,
    and of the noise.

    Args:
        case: The case.
        folder: Folder with the analyst's files.
    """
    last = len(case.sessions) - 1
    torques = [
        _true_torque(
            session,
            replace(case.robot, actuators=_later_actuators(case)) if k == last else case.robot,
        )
        for k, session in enumerate(case.sessions)
    ]
    before, after = oracle_rmse(folder, recording_names(case.spec), torques)
    noise = case.sessions[-1].chain.noise_floor(SEVERITY_BAND)
    severities = friction_severities(
        case.robot,
        case.frictions,
        [
            (session.motion, motion.periodic)
            for session, motion in zip(case.sessions[:-1], case.motions, strict=False)
        ],
        noise,
    )
    frictions = (
        HiddenEffect(instance, severity)
        for instance, severity in zip(case.frictions, severities, strict=True)
    )
    return {
        "spec": asdict(case.spec),
        "joints": list(case.robot.joints),
        "effects": [
            {
                **effect.instance.to_document(),
                "severity": float(effect.severity.alone.max()),
                "unique_severity": float(effect.severity.unique.max()),
                "severity_by_joint": effect.severity.alone.tolist(),
                "unique_severity_by_joint": effect.severity.unique.tolist(),
            }
            for effect in (*frictions, *case.hidden)
        ],
        "held_out": {
            "before": before.tolist(),
            "oracle": after.tolist(),
            "noise": noise.tolist(),
        },
        "truth": case.sessions[0].truth,
    }


def _true_torque(
    session: SimulatedSession, robot: SimulatedRobot
) -> Callable[[FloatArray], FloatArray]:
    """Return the hidden torque of a session as a function of time."""
    return lambda t: hidden_torque(session.motion, robot, t).torque


def write_case(case: GeneratedCase, folder: Path, truth_path: Path) -> None:
    """Write a case and its ground truth.

    The folder appears at once, with all files, so that an interruption leaves no half case. All
    files have the same date.

    Args:
        case: The case.
        folder: Folder that the analyst is given.
        truth_path: File of the ground truth.
    """
    staged = folder.with_name(f".{folder.name}")
    shutil.rmtree(staged, ignore_errors=True)
    staged.mkdir(parents=True)
    for name, text in analyst_files(case).items():
        (staged / name).write_text(text, encoding="utf-8")
        os.utime(staged / name, (0, 0))
    truth_path.parent.mkdir(parents=True, exist_ok=True)
    truth_path.write_text(json.dumps(ground_truth(case, staged), allow_nan=False), encoding="utf-8")
    os.utime(staged, (0, 0))
    staged.rename(folder)
