"""Simulated recordings of a two-link robot with known effects, and their diagnoses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy import integrate
from scipy.interpolate import CubicSpline
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    pinocchio_model,
    random_fourier,
    synthetic_recording,
    two_link_model,
    validated,
)

from excite._types import FloatArray
from excite.diagnosis import diagnosis
from excite.diagnosis.diagnosis import Diagnosis
from excite.effects.recorded_motion import RecordedMotion
from excite.identification.identified_model import IdentifiedModel
from excite.identification.prior import TrustedPrior
from excite.recordings import Recording

NOISE = 0.1
"""Standard deviation of the white torque noise [N m]."""
RATE = 200.0
"""Sampling rate [Hz]."""
PERIODS = 4.0
"""Periods of each recording, about 20 s."""
HELD_OUT = 5
"""Seed of the motion and the noise of the held-out recording."""
SUBJECT = two_link_model()
"""The robot."""
PSI = perturbed_parameters(SUBJECT.parameters, np.random.default_rng(4))
"""Its standard parameters, shape (P,)."""
COULOMB, VISCOUS = (PSI[SUBJECT.parameters.block(kind)] for kind in ("coulomb", "viscous"))
TRUSTED = TrustedPrior(dict(enumerate(PSI.tolist())))
"""All its parameters as a trusted prior."""
Effect = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]
"""Torque of an effect [N m], shape (N, 2), from t, q, dq and the torque without it."""


# -- recordings and diagnoses ---------------------------------------------------------------------


def recording_of(effect: Effect | None, seed: int, noise: float = NOISE) -> Recording:
    """Return a recording of the robot with an effect; the seed is that of motion and noise."""
    fourier = random_fourier(2, seed)
    recording = synthetic_recording(SUBJECT, PSI, fourier, PERIODS, 0.0, RATE)
    s, tau = fourier.samples(recording.t), recording.torque
    added = 0.0 if effect is None else effect(recording.t, s.q, s.dq, tau)
    white = noise * np.random.default_rng(seed).normal(size=tau.shape)
    return dataclasses.replace(recording, tau=tau + added + white, source=f"{seed}.csv")


def recordings_of(effect: Effect | None, seeds: Sequence[int] = (2, HELD_OUT)) -> list[Recording]:
    """Return recordings of the robot with an effect, each along another motion."""
    return [recording_of(effect, seed) for seed in seeds]


def added_torque(recording: Recording, torque: FloatArray) -> Recording:
    """Return a recording with more torque, shape (N, 2)."""
    return dataclasses.replace(recording, tau=recording.torque + torque)


def diagnose(recordings: Sequence[Recording], **options: Any) -> Diagnosis:
    """Return the diagnosis of recordings, the last of which is held out."""
    return diagnosis.diagnose(
        SUBJECT.robot,
        SUBJECT.parameters,
        SUBJECT.base,
        recordings[:-1],
        recordings[-1:],
        **options,
    )


def diagnosed_with_friction(
    friction: Callable[[FloatArray, FloatArray], FloatArray], share: float = 1.0
) -> Diagnosis:
    """Return the diagnosis of a robot with further friction at its first joint [N m].

    Args:
        friction: Function of position and velocity of the joint, shapes (M,).
        share: Amplitude of the fitted motions over that of the held-out one.
    """
    recordings = []
    for seed, size in ((2, share), (5, share), (7, 1.0)):
        full = random_fourier(2, seed)
        fourier = dataclasses.replace(full, sine=size * full.sine, cosine=size * full.cosine)
        recording = synthetic_recording(SUBJECT, PSI, fourier, 4, 0.02, RATE)
        motion = fourier.samples(recording.t)
        named = dataclasses.replace(recording, source=f"{seed}.csv")
        further = friction(motion.q[:, 0], motion.dq[:, 0])
        recordings.append(added_torque(named, at_joint(0, further)))
    return diagnose(recordings)


def findings_of(result: Diagnosis) -> list[tuple[str, int | None]]:
    """Return effect and joint of the findings, the most probable first."""
    return [(finding.effect, finding.joint) for finding in result.findings]


def parameters(
    result: Diagnosis, effect: str, joint: int | None
) -> Mapping[str, tuple[float, float]]:
    """Return value and standard deviation of each parameter of a finding."""
    (finding,) = (f for f in result.findings if (f.effect, f.joint) == (effect, joint))
    return finding.parameters


def known_failures(
    names: Iterable[Any], reasons: Mapping[Any, str], slow: Collection[Any] = ()
) -> list[Any]:
    """Return parameters of a test, those with a reason marked as a known failure.

    Args:
        names: Values of the parameter.
        reasons: Reasons of the known failures, by value.
        slow: Values with which the test is slow.
    """
    marks = dict[Any, list[pytest.MarkDecorator]]()
    for name in names:
        marks[name] = [pytest.mark.slow] if name in slow else []
        if name in reasons:
            marks[name].append(pytest.mark.xfail(strict=True, reason=reasons[name]))
    return [pytest.param(name, marks=applied) for name, applied in marks.items()]


def noise_ratios(result: Diagnosis) -> tuple[FloatArray, FloatArray]:
    """Return the held-out RMSE before and after over the noise, shapes (n,)."""
    held_out, noise = result.held_out, result.noise.floor
    return held_out.rmse_before / noise, held_out.rmse_after / noise


def motions() -> tuple[RecordedMotion, ...]:
    """Return recorded motions of the robot without effects, with one base model."""
    result = diagnosed(None)
    return (*result.final.motions, *result.held_out.motions)


# -- effects, independent of the formulas of `excite.effects` -------------------------------------


def at_joint(joint: int, torque: FloatArray) -> FloatArray:
    """Return a torque of one joint, shape (N,), as a torque of both, shape (N, 2)."""
    out = np.zeros((len(torque), 2))
    out[:, joint] = torque
    return out


def friction_sign(speed: FloatArray) -> FloatArray:
    """Return the smooth sign of a speed."""
    return np.asarray(np.tanh(speed / FRICTION_WIDTH))


def link_torque(t: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
    """Return the torque without that of the joint actuators, shape (N, 2)."""
    inertia, offset = (PSI[SUBJECT.parameters.block(k)] for k in ("rotor_inertia", "offset"))
    friction = COULOMB * friction_sign(dq) + VISCOUS * dq
    return np.asarray(tau - friction - offset - inertia * np.gradient(dq, t, axis=0))


def shaft_friction(speed: FloatArray) -> FloatArray:
    """Return the friction of a shaft that is driven by two joints [N m]."""
    return 0.9 * friction_sign(speed) + 0.2 * speed


def maxwell_slip_force(q: FloatArray, thresholds: FloatArray) -> FloatArray:
    """Return the mean force of Maxwell-slip elements, each over its largest force [1].

    Each element is a spring that slips at a deflection of its threshold; simulated sample by
    sample.
    """
    out, anchors = np.empty((len(q), len(thresholds))), np.full(len(thresholds), q[0])
    for k, position in enumerate(q):
        anchors = np.clip(anchors, position - thresholds, position + thresholds)
        out[k] = (position - anchors) / thresholds
    return np.asarray(out.mean(axis=1))


def cogging(q: FloatArray) -> FloatArray:
    """Return a torque ripple with harmonics and a weak wave of another order [N m]."""
    angle = 19.0 * q
    waves = 2.0 * np.cos(angle) + 0.5 * np.cos(2.0 * angle + 0.4)
    return np.asarray(waves + 0.15 * np.cos(3.0 * angle + 1.0) + 0.3 * np.cos(27.0 * q))


def inverted(produced: FloatArray, actuator: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return the recorded torque that makes a produced torque, by bisection."""
    low, high = np.zeros_like(produced), np.full_like(produced, 60.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        short = actuator(middle) < np.abs(produced)
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.asarray(np.sign(produced) * low)


def weak_torque(x: FloatArray) -> FloatArray:
    """Return the torque of an actuator with a quadratic loss of 15 % at 40 N m."""
    return np.asarray(x * (1.0 - 0.15 * (x / 40.0) ** 2))


def limited_torque(x: FloatArray) -> FloatArray:
    """Return the torque of an actuator that saturates at 60 N m."""
    return np.asarray(x / np.sqrt(1.0 + (x / 60.0) ** 2))


def simulate_elastic_gear(
    stiffness: float, damping: float, t: FloatArray, q: FloatArray, at_rest: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Simulate an elastic gear at the second joint with inverse dynamics of the link's motion.

    Args:
        stiffness: Stiffness of the gear [N m/rad].
        damping: Damping of the gear [N m s/rad].
        t: Times. Shape (N,) [s].
        q: Motor positions. Shape (N, 2) [rad].
        at_rest: True if the link is initially at rest, else it moves with the motor.

    Returns:
        Deflection, shape (N,) [rad], and its torque on both joints, shape (N, 2) [N m].
    """
    bodies = pinocchio_model(SUBJECT, PSI)
    data, zero, e = bodies.createData(), np.zeros(2), np.array([0.0, 1.0])
    position = CubicSpline(t, q)
    velocity, acceleration = position.derivative(), position.derivative(2)
    mass = float(pin.crba(bodies, data, zero)[1, 1])  # inertia of the last link, in any pose

    def derivative(time: float, state: FloatArray) -> FloatArray:
        link = position(time) - e * state[0], velocity(time) - e * state[1]
        load = pin.rnea(bodies, data, *link, acceleration(time))[1]
        return np.array([state[1], (load - stiffness * state[0] - damping * state[1]) / mass])

    motion = (zero, zero) if at_rest else (velocity(t[0]), acceleration(t[0]))
    speed = float(velocity(t[0])[1]) if at_rest else 0.0
    start = [pin.rnea(bodies, data, q[0], *motion)[1] / stiffness, speed]
    deflection = integrate.solve_ivp(
        derivative, (t[0], t[-1]), start, t_eval=t, rtol=1e-7, atol=1e-10
    ).y.T
    torque = np.empty_like(q)
    for k, state in enumerate(deflection):
        motor = q[k], velocity(t[k]), acceleration(t[k])
        change = (state[0], state[1], derivative(t[k], state)[1])
        link = [x - e * dx for x, dx in zip(motor, change, strict=True)]
        torque[k] = pin.rnea(bodies, data, *link) - pin.rnea(bodies, data, *motor)
    return deflection[:, 0], torque


def force_along_x(q: FloatArray, model: pin.Model = SUBJECT.robot.model) -> FloatArray:
    """Return the torque of a unit force along x on the centre of mass of the second link.

    By Pinocchio's Jacobian.
    """
    data = model.createData()
    out = np.empty((len(q), 2))
    for k, pose in enumerate(q):
        pin.computeJointJacobians(model, data, pose)
        J = pin.getJointJacobian(model, data, 2, pin.LOCAL_WORLD_ALIGNED)
        lever = data.oMi[2].rotation @ np.array(model.inertias[2].lever)
        out[k] = (J[:3] - pin.skew(lever) @ J[3:])[0]
    return out


def pushed(
    start: float, end: float, force: float, course: Callable[[FloatArray], FloatArray]
) -> Effect:
    """Return a push of the second link, with the course of its force over its duration."""

    def torque(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
        inside = np.where((t > start) & (t < end), course((t - start) / (end - start)), 0.0)
        return -force * inside[:, None] * force_along_x(q)

    return torque


@dataclass(frozen=True)
class HiddenEffect:
    """An effect of the robot.

    Attributes:
        effect: Its name.
        joint: Index of the joint; None for an effect of the whole robot.
        torque: Its torque.
        parameters: By name: true value and relative tolerance; None: two standard deviations.
        train: Seeds of the training recordings.
        transient: True if the held-out recording does not contain it.
    """

    effect: str
    joint: int | None
    torque: Effect
    parameters: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)
    train: tuple[int, ...] = (2,)
    transient: bool = False


SLIP = np.geomspace(0.004, 0.2, 9)
"""Thresholds of Maxwell-slip elements [rad]."""
HIDDEN: Mapping[str, HiddenEffect] = {
    "asymmetric_viscous": HiddenEffect(
        "asymmetric_viscous",
        1,
        lambda t, q, dq, tau: at_joint(1, 0.35 * np.abs(dq[:, 1])),
        {"positive": (VISCOUS[1] + 0.35, 0.05), "negative": (VISCOUS[1] - 0.35, 0.05)},
    ),
    "stribeck": HiddenEffect(
        "stribeck",
        0,
        lambda t, q, dq, tau: at_joint(
            0, 1.5 * friction_sign(dq[:, 0]) * np.exp(-((np.abs(dq[:, 0]) / 0.12) ** 2))
        ),
        {"velocity": (0.12, 0.1)},
    ),
    "nonlinear_viscous": HiddenEffect(
        "nonlinear_viscous",
        0,
        lambda t, q, dq, tau: at_joint(
            0, 2.0 * friction_sign(dq[:, 0]) * np.sqrt(np.abs(dq[:, 0]))
        ),
    ),
    "load_friction": HiddenEffect(
        "load_friction",
        0,
        lambda t, q, dq, tau: at_joint(
            0, 0.1 * np.abs(link_torque(t, dq, tau)[:, 0]) * friction_sign(dq[:, 0])
        ),
        {"mu": (0.1, 0.1)},
    ),
    "hysteresis": HiddenEffect(
        "hysteresis",
        1,
        lambda t, q, dq, tau: at_joint(1, 4.0 * maxwell_slip_force(q[:, 1], SLIP)),
        {"amplitude": (4.0, 0.1), "stiffness": (4.0 * float(np.mean(1.0 / SLIP)), None)},
    ),
    "position_friction": HiddenEffect(
        "position_friction",
        0,
        lambda t, q, dq, tau: at_joint(
            0, 0.8 * friction_sign(dq[:, 0]) * np.cos(2.0 * q[:, 0] + 1.0)
        ),
        {"amplitude": (0.8, 0.1)},
    ),
    "torque_ripple": HiddenEffect(
        "torque_ripple",
        1,
        lambda t, q, dq, tau: at_joint(1, 0.5 * np.cos(23.0 * q[:, 1] + 0.4)),
        {"amplitude": (0.5, 0.1), "order": (23.0, 5e-3)},
    ),
    "cogging": HiddenEffect(
        "torque_ripple",
        1,
        lambda t, q, dq, tau: at_joint(1, cogging(q[:, 1])),
        {"amplitude": (2.0, 0.02), "order": (19.0, 5e-3)},
    ),
    "spring": HiddenEffect(
        "spring",
        1,
        lambda t, q, dq, tau: at_joint(1, 1.7 * q[:, 1]),
        {"stiffness": (1.7, 0.3)},
        train=(2, 8),
    ),
    "stiffening_spring": HiddenEffect(  # a rubber stop at one end of the range
        "spring",
        1,
        lambda t, q, dq, tau: at_joint(1, 1.5 * q[:, 1] + 12.0 * np.maximum(q[:, 1] - 0.5, 0.0)),
        {"stiffness": (13.5, 0.05)},
        train=(2, 8),
    ),
    "coupling": HiddenEffect(
        "coupling",
        0,
        lambda t, q, dq, tau: at_joint(0, shaft_friction(dq[:, 0] - 0.7 * dq[:, 1])),
        {"viscous": (0.2, 0.05), "coulomb": (0.9, 0.05)},
    ),
    "coupling_of_other_sign": HiddenEffect(
        "coupling",
        0,
        lambda t, q, dq, tau: at_joint(0, shaft_friction(dq[:, 0] + 0.8 * dq[:, 1])),
        {"viscous": (0.2, 0.05), "coulomb": (0.9, 0.05)},
    ),
    "thermal_drift": HiddenEffect(
        "thermal_drift",
        0,
        lambda t, q, dq, tau: at_joint(
            0, (1.5 * friction_sign(dq[:, 0]) + 0.4 * dq[:, 0]) * np.exp(-2.0 * t / t[-1])
        ),
    ),
    "torque_loss": HiddenEffect(
        "torque_saturation",
        0,
        lambda t, q, dq, tau: at_joint(0, inverted(tau[:, 0], weak_torque) - tau[:, 0]),
        {"loss": (0.159, 0.15)},  # at 41.3 N m, the largest recorded torque
    ),
    "torque_limit": HiddenEffect(
        "torque_saturation",
        0,
        lambda t, q, dq, tau: at_joint(0, inverted(tau[:, 0], limited_torque) - tau[:, 0]),
    ),
    "elasticity": HiddenEffect(
        "elasticity",
        1,
        lambda t, q, dq, tau: simulate_elastic_gear(55.0, 0.05, t, q)[1],
        {"stiffness": (55.0, 0.05)},
    ),
    "delay": HiddenEffect(
        "delay",
        None,
        lambda t, q, dq, tau: np.column_stack([np.interp(t - 6e-3, t, x) for x in tau.T]) - tau,
        {"seconds": (6e-3, 0.03)},
    ),
    "contact": HiddenEffect(
        "contact",
        1,
        pushed(4.0, 6.0, 12.0, lambda u: np.sin(np.pi * u)),
        {"force": (12.0, 0.25)},
        transient=True,
    ),
    "dragging_contact": HiddenEffect(  # a course of the force that is not in the catalogue
        "contact",
        1,
        pushed(4.0, 6.0, 12.0, lambda u: np.minimum(1.0, 3.0 * u) * (1.0 - 0.8 * u)),
        {"force": (12.0 * 0.733, 0.25)},
        transient=True,
    ),
    "contact_of_a_period": HiddenEffect(
        "contact",
        1,
        pushed(3.0, 8.0, 30.0, lambda u: np.sin(np.pi * u)),
        {"force": (30.0, 0.1)},
        transient=True,
    ),
}

SLOW_HIDDEN = (
    "cogging",
    "stiffening_spring",
    "coupling_of_other_sign",
    "torque_limit",
    "elasticity",
    "dragging_contact",
    "contact_of_a_period",
)
"""Those whose tests are slow: of most of them, another of the same effect is not."""


@cache
def diagnosed(name: str | None) -> Diagnosis:
    """Return the diagnosis of the robot with an effect of `HIDDEN`; None: without effects."""
    if name is None:
        return diagnose(recordings_of(None))
    hidden = HIDDEN[name]
    held_out = recording_of(None if hidden.transient else hidden.torque, HELD_OUT)
    return diagnose([*recordings_of(hidden.torque, hidden.train), held_out])


# -- saved models ---------------------------------------------------------------------------------


def model_with_effects(*effects: dict[str, Any]) -> IdentifiedModel:
    """Return an identified model that contains some effects."""
    return IdentifiedModel(
        "model.json",
        SUBJECT.robot,
        SUBJECT.parameters.drive,
        PSI,
        np.full(2, FRICTION_WIDTH),
        20.0,
        tuple(validated(effect) for effect in effects),
    )


def effect_entry(
    effect: str, joint: str | None, values: dict[str, float], *coefficients: float
) -> dict[str, Any]:
    """Return the entry of an effect in a `model.json`."""
    return {
        "effect": effect,
        "joint": joint,
        "from": None,
        "values": values,
        "coefficients": list(coefficients),
        "time": None,
        "recording": None,
    }
