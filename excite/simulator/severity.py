"""Severity of a hidden effect: its torque after a refit of the base model, over the noise.

Severity is the RMS of the effect's torque below 20 Hz after projection on the base model, divided
by the RMS of the torque noise in the same band.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, signal

from .._types import FloatArray
from ..errors import UnusableInput
from .effect_instance import EffectInstance, with_effects
from .measurement import MeasurementChain
from .mujoco_dynamics import build_dynamics
from .physical_effect import PhysicalEffect
from .reference_trajectory import ReferenceTrajectory
from .regressor import actuator_regressor, rigid_body_regressor
from .simulated_robot import SimulatedMotion, SimulatedRobot

SEVERITY_BAND = 20.0
"""Corner of the low-pass of torque [Hz]: the band of the diagnosis."""
RIGID_RATE = 200.0
"""Rate at which the torque of a robot without elasticity is evaluated [Hz]."""
ELASTIC_RATE = 2000.0
"""Rate for a robot with elasticity or backlash [Hz].

Its links may oscillate at hundreds of Hz, which a lower rate would alias into the band.
"""
KEPT_RATE = 100.0
"""Rate at which the low-passed torque is kept [Hz]."""
DERIVATIVE_STEP = 1e-4
"""Step of the central differences of an encoder error [s], much finer than its waves."""


@dataclass(frozen=True)
class Severity:
    """Severity of the effects of a robot.

    Attributes:
        joints: Severity in each joint, shape (n,) [1].
    """

    joints: FloatArray

    @property
    def value(self) -> float:
        """The largest severity of all joints."""
        return float(self.joints.max())


@dataclass(frozen=True)
class HiddenTorque:
    """The torque that effects hide, and the motion at which the base model looks for it.

    Attributes:
        torque: Reported torque beyond that of the true base model, shape (N, n) [N m].
        q: Reported position without noise, shape (N, n) [rad].
        v: Its first derivative.
        a: Its second derivative.
    """

    torque: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray


def hidden_torque(motion: SimulatedMotion, robot: SimulatedRobot, t: FloatArray) -> HiddenTorque:
    """Return the torque that the base model with true parameters misses along a motion.

    Args:
        motion: Motion of the robot with its effects.
        robot: The robot without effects.
        t: Times, shape (N,) [s].
    """
    (q, v, a), (q_measured, tau) = motion.motor_motion(t), motion.measured(t)
    if any(
        type(effect).measured_position is not PhysicalEffect.measured_position
        for effect in motion.robot.effects
    ):
        h = DERIVATIVE_STEP
        before, here, after = (_position_error(motion, t + shift) for shift in (-h, 0.0, h))
        q, v, a = (
            q_measured,
            v + (after - before) / (2 * h),
            a + (after - 2 * here + before) / h**2,
        )
    dynamics = build_dynamics(robot.tree, robot.joints, robot.lock, robot.gravity)
    actuators = robot.actuators
    base_torque = (
        dynamics.inverse_dynamics(q, v, a) + actuators.inertia * a + actuators.friction_torque(v)
    )
    return HiddenTorque(tau - base_torque, q, v, a)


def _position_error(motion: SimulatedMotion, t: FloatArray) -> FloatArray:
    """Return the error of the reported position, shape (N, n) [rad]."""
    theta = motion.motor_motion(t)[0]
    measured = theta
    for effect in motion.robot.effects:
        measured = effect.measured_position(measured)
    return measured - theta


def residual_torque(
    motion: SimulatedMotion,
    robot: SimulatedRobot,
    reference: ReferenceTrajectory,
    *,
    trusted: bool = False,
) -> FloatArray:
    """Return the torque below 20 Hz that a refit of the base model leaves unexplained.

    Args:
        motion: Motion of the robot with its effects.
        robot: The robot without effects.
        reference: The commanded motion; its periodic part counts, or all of it where it has none.
        trusted: Keep the base model as it is instead of refitting it.

    Returns:
        Residual torque, shape (N, n) [N m].
    """
    rate = ELASTIC_RATE if motion.robot.springs else RIGID_RATE
    begin, end = reference.periodic
    if begin == end:
        begin, end = 0.0, reference.duration
    t = np.arange(begin, end, 1.0 / rate)
    hidden = hidden_torque(motion, robot, t)
    torque = low_passed(hidden.torque, rate)
    if trusted:
        return torque
    weight = 1.0 / robot.torque_limit
    basis = column_space(base_columns(robot, hidden.q, hidden.v, hidden.a, rate))
    projection = basis @ (basis.T @ (torque * weight).ravel())
    return np.asarray(torque - projection.reshape(torque.shape) / weight)


def base_columns(
    robot: SimulatedRobot, q: FloatArray, v: FloatArray, a: FloatArray, rate: float
) -> FloatArray:
    """Return the base regressor below 20 Hz, over the torque limits.

    Args:
        robot: The robot without effects.
        q: Reported position at `rate`, shape (N, n) [rad].
        v: Its first derivative.
        a: Its second derivative.
        rate: Rate of the samples [Hz].

    Returns:
        Shape (M·n, P), M samples at `KEPT_RATE`.
    """
    dynamics = build_dynamics(robot.tree, robot.joints, robot.lock, robot.gravity)
    blocks = [
        low_passed(block, rate)
        for block in (
            rigid_body_regressor(dynamics, q, v, a),
            actuator_regressor(v, a, robot.actuators.width),
        )
    ]
    columns = np.concatenate(blocks, axis=2) / robot.torque_limit[:, None]
    return columns.reshape(-1, columns.shape[2])


def column_space(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the span of columns, which may be linearly dependent."""
    size = np.sqrt(np.square(columns).mean(axis=0))
    kept = columns[:, size > 1e-12 * size.max()] / size[size > 1e-12 * size.max()]
    basis, triangle, _ = linalg.qr(kept, mode="economic", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    return np.asarray(basis[:, diagonal > 1e-9 * diagonal[0]])


def low_passed(x: FloatArray, rate: float) -> FloatArray:
    """Low-pass at 20 Hz without phase, and keep the samples that this band needs."""
    return np.asarray(
        signal.sosfiltfilt(signal.butter(4, SEVERITY_BAND, fs=rate, output="sos"), x, axis=0)[
            :: round(rate / KEPT_RATE)
        ]
    )


def evaluate_severity(
    motion: SimulatedMotion,
    robot: SimulatedRobot,
    reference: ReferenceTrajectory,
    chain: MeasurementChain,
    *,
    trusted: bool = False,
) -> Severity:
    """Return the severity of the effects in a motion.

    Args:
        motion: Motion of the robot with its effects.
        robot: The robot without effects.
        reference: The commanded motion.
        chain: Measurement chain that defines the noise.
        trusted: Keep the base model as it is instead of refitting it.
    """
    residual = residual_torque(motion, robot, reference, trusted=trusted)
    return Severity(np.sqrt(np.square(residual).mean(axis=0)) / chain.noise_floor(SEVERITY_BAND))


def scale_to_severity(
    effect: EffectInstance,
    target: float,
    robot: SimulatedRobot,
    reference: ReferenceTrajectory,
    chain: MeasurementChain,
    *,
    trusted: bool = False,
    measure: Callable[[SimulatedMotion], Severity] | None = None,
    tolerance: float = 0.15,
    tries: int = 4,
    largest: float = np.inf,
) -> tuple[EffectInstance, SimulatedMotion, Severity]:
    """Scale an effect until its severity is the target, by secant steps in the logarithms.

    A robot whose control loop is unstable has too much of the effect.

    Args:
        effect: The effect, from whose size the search starts.
        target: Wanted severity [1].
        robot: The robot without effects.
        reference: The commanded motion.
        chain: Measurement chain that defines the noise.
        trusted: Keep the base model as it is instead of refitting it.
        measure: Function from a motion to the severity that shall be the target; None: that of
            `evaluate_severity`.
        tolerance: Accepted relative deviation [1].
        tries: Largest number of simulations.
        largest: Largest factor of the effect; physics may set a smaller one.

    Returns:
        The scaled effect that came closest, its motion and its severity.

    Raises:
        UnusableInput: The loop is unstable in all tries.
    """

    def simulated(size: float) -> tuple[EffectInstance, SimulatedMotion, Severity]:
        scaled = effect.scaled(size)
        motion = with_effects(robot, (scaled,)).follow(reference)
        severity = (
            evaluate_severity(motion, robot, reference, chain, trusted=trusted)
            if measure is None
            else measure(motion)
        )
        return scaled, motion, severity

    largest = min(largest, effect.largest_scale(robot))
    size, slope, last = min(1.0, largest), 1.0, None
    results: list[tuple[float, tuple[EffectInstance, SimulatedMotion, Severity]]] = []
    for _ in range(tries):
        try:
            result = simulated(size)
        except UnusableInput as error:
            unstable, size = error, 0.3 * size
            continue
        here = (float(np.log(size)), float(np.log(max(result[2].value, 1e-9) / target)))
        results.append((abs(here[1]), result))
        if abs(here[1]) < np.log1p(tolerance) or (size >= largest and here[1] < 0.0):
            break
        if last is not None and abs(here[0] - last[0]) > 1e-6:
            slope = float(np.clip((here[1] - last[1]) / (here[0] - last[0]), 0.5, 4.0))
        last, size = here, min(largest, size * float(np.exp(np.clip(-here[1] / slope, -4.0, 4.0))))
    if not results:
        raise unstable
    return min(results, key=lambda entry: entry[0])[1]
