"""Closed-loop simulation: the motion of a controlled robot, with its effects, along a reference.

The integrator takes linearly implicit steps of 0.5-2 ms: friction and base suspension enter with
their derivatives, so that the stiffness of tanh(ω / 3 mrad/s) limits no step. Springs between motor
and link are integrated with steps of 0.1 ms, for which the rest of the arm is condensed to one
acceleration and one compliance per elastic joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from .._types import FloatArray
from .actuator import ControllerGains, JointActuators
from .mujoco_dynamics import RigidBodyDynamics
from .physical_effect import BaseSuspension, JointStates, PhysicalEffect, TransmissionSpring
from .reference_trajectory import ReferenceTrajectory

SPRING_STEP = 1e-4
"""Time step of a transmission spring [s]."""
SLOPE_SPEED_DIFFERENCE = 1e-4
"""Difference of speed over which the derivative of an effect's torque is taken [rad/s]."""
SLOPE_SPEED_OFFSETS = np.array([[0.0], [SLOPE_SPEED_DIFFERENCE]])
"""Offsets that evaluate an effect at two speeds in one call, shape (2, 1) [rad/s]."""
DIVERGENCE_SPEED = 1e3
"""Speed above which a loop counts as unstable; stopping here avoids overflows [rad/s or m/s]."""


@dataclass(frozen=True)
class StateHistory:
    """States at the times t = k·step. A loop that diverges has infinite q from there on.

    Attributes:
        t: Shape (N,) [s].
        q: Positions of base and links, shape (N, k + n) [rad or m].
        theta: Positions of the motors at the joint shafts, shape (N, n) [rad].
        z: Internal states of the effects, shape (N, m).
    """

    t: FloatArray
    q: FloatArray
    theta: FloatArray
    z: FloatArray


@dataclass
class ClosedLoop:
    """One simulation of a controlled robot.

    Attributes:
        dynamics: Rigid bodies; k base coordinates come before the n joints.
        actuators: Actuators of the n joints.
        gains: Gains of the controller.
        effects: Hidden effects.
        base_suspension: Suspension of the k base coordinates.
        torque_limit: Shape (n,) [N m].
        step: Time step [s].
    """

    dynamics: RigidBodyDynamics
    actuators: JointActuators
    gains: ControllerGains
    effects: Sequence[PhysicalEffect]
    base_suspension: BaseSuspension | None
    torque_limit: FloatArray
    step: float

    def __post_init__(self) -> None:
        """Sort the effects by what they override."""
        self.n = len(self.actuators.inertia)
        self.k = self.dynamics.n - self.n
        self.springs: list[TransmissionSpring] = [
            spring
            for effect in self.effects
            if (spring := effect.transmission_spring()) is not None
        ]
        self.torque_effects = [
            effect for effect in self.effects if type(effect).torque is not PhysicalEffect.torque
        ]
        self.sensor_effects = [
            effect
            for effect in self.effects
            if type(effect).measured_position is not PhysicalEffect.measured_position
        ]
        self.rigid_inertia = self.actuators.inertia.copy()
        self.rigid_inertia[[spring.joint for spring in self.springs]] = 0.0
        self.lag_factor = 1.0 - float(np.exp(-self.step / self.gains.lag))

    def run(self, reference: ReferenceTrajectory) -> StateHistory:
        """Follow a reference from rest to rest; an unstable loop shows in the history."""
        t = np.arange(int(np.ceil(reference.duration / self.step)) + 1, dtype=float) * self.step
        q_ref, v_ref, a_ref = reference.at(t)
        feedforward = self._feedforward_torque(q_ref, v_ref, a_ref)
        self.initialise(q_ref[0])
        rows = len(t)
        q, theta, z = (
            np.zeros((rows, self.dynamics.n)),
            np.zeros((rows, self.n)),
            np.zeros((rows, len(self.z))),
        )
        q[0], theta[0], z[0] = self.q, self.theta, self.z
        for i in range(rows - 1):
            self._update_controller(q_ref[i], v_ref[i], feedforward[i])
            if not self._advance_is_stable(t[i]):
                q[i + 1 :] = np.inf
                break
            q[i + 1], theta[i + 1], z[i + 1] = self.q, self.theta, self.z
        return StateHistory(t, q, theta, z)

    def _feedforward_torque(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the fraction of the rigid-body torque that is fed forward, shape (N, n) [N m]."""
        pad = np.zeros((len(q), self.k))
        padded = [np.hstack([pad, part]) for part in (q, v, a)]
        rigid = self.dynamics.inverse_dynamics(*padded)[:, self.k :] + self.actuators.inertia * a
        return self.gains.forward * rigid

    def initialise(self, q: FloatArray) -> None:
        """Set the robot to rest at joint positions q, with the controller in equilibrium.

        Args:
            q: Positions of the joints, shape (n,) [rad].
        """
        size = self.dynamics.n
        self.q, self.v, self.a = np.zeros(size), np.zeros(size), np.zeros(size)
        self.q[self.k :] = q
        self.load = self.dynamics.mass_and_bias(self.q, self.v)[1][self.k :]
        self.omega, self.alpha, self.theta = np.zeros(self.n), np.zeros(self.n), q.copy()
        for spring in self.springs:
            self.theta[spring.joint] += static_deflection(spring, float(self.load[spring.joint]))
        self.z = np.zeros(sum(effect.state_size for effect in self.torque_effects))
        self.motor_torque = self.load + self.actuators.offset
        self.integral_torque = (1.0 - self.gains.forward) * self.load + self.actuators.offset
        self.speed_gain = self.gains.speed * self._joint_inertia()

    def _joint_inertia(self) -> FloatArray:
        """Return the inertia that each joint moves, shape (n,) [kg m²]."""
        return (
            np.diag(self.dynamics.mass_and_bias(self.q, self.v)[0])[self.k :]
            + self.actuators.inertia
        )

    def _update_controller(self, q: FloatArray, v: FloatArray, feedforward: FloatArray) -> None:
        """Compute the motor torque from the reference, through the lag of the current loop."""
        gains, measured = self.gains, self.theta
        for effect in self.sensor_effects:
            measured = effect.measured_position(measured)
        if gains.step > 0.0:
            measured = np.round(measured / gains.step) * gains.step
        error = self.speed_gain * (v + gains.position * (q - measured) - self.omega)
        wanted = feedforward + error + self.integral_torque
        bounded = np.minimum(np.maximum(wanted, -self.torque_limit), self.torque_limit)
        # the integrator of a joint at its torque limit is held
        self.integral_torque = self.integral_torque + gains.integral * self.step * error * (
            wanted == bounded
        )
        self.motor_torque = self.motor_torque + self.lag_factor * (bounded - self.motor_torque)

    def _advance_is_stable(self, time: float) -> bool:
        """Advance by one step and return whether the loop is still stable."""
        try:
            self.advance(time)
        except OverflowError:  # a spring whose torque grows with the cube of its deflection
            return False
        return bool(np.abs(self.v).max() < DIVERGENCE_SPEED)

    def advance(self, time: float) -> None:
        """Advance the states by one time step that starts at `time` [s]."""
        mass, bias = self.dynamics.mass_and_bias(self.q, self.v)
        k, actuators = self.k, self.actuators
        sign = np.tanh(self.omega / actuators.width)
        resistance = actuators.viscous * self.omega + actuators.coulomb * sign + actuators.offset
        slope = actuators.viscous + actuators.coulomb / actuators.width * (1.0 - sign * sign)
        if self.torque_effects:
            effect_torque, effect_slope = self._effect_torques(time)
            resistance, slope = resistance + effect_torque, slope + effect_slope
        torque, diagonal = self.motor_torque - resistance, self.rigid_inertia + self.step * slope
        for spring in self.springs:
            torque[spring.joint], diagonal[spring.joint] = 0.0, 0.0
        matrix, force = mass.copy(), -bias
        matrix.ravel()[k * (self.dynamics.n + 1) :: self.dynamics.n + 1] += diagonal
        force[k:] += torque
        if self.base_suspension is not None:
            suspension, base = self.base_suspension, np.arange(k)
            matrix[base, base] += (
                0.5 * self.step * suspension.damping + 0.25 * self.step**2 * suspension.stiffness
            )
            force[:k] -= (
                suspension.stiffness * (self.q[:k] + 0.5 * self.step * self.v[:k])
                + suspension.damping * self.v[:k]
            )
        v_before, theta, omega = self.v, self.theta, self.omega.copy()
        self.a, shift = (
            self._integrate_springs(matrix, force, resistance, omega)
            if self.springs
            else (solve_positive_definite(matrix, force), 0.0)
        )
        self.v = v_before + self.step * self.a
        self.q = self.q + 0.5 * self.step * (v_before + self.v) + shift
        theta, motor_speed = self.q[k:].copy(), self.v[k:].copy()
        for spring in self.springs:
            theta[spring.joint], motor_speed[spring.joint] = (
                self.theta[spring.joint],
                omega[spring.joint],
            )
        self.alpha, self.theta, self.omega = (
            (motor_speed - self.omega) / self.step,
            theta,
            motor_speed,
        )
        if self.torque_effects:
            self.load = (mass @ self.a + bias)[k:]
            self._advance_effect_states(time + self.step)

    def _integrate_springs(
        self, matrix: FloatArray, force: FloatArray, resistance: FloatArray, omega: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Integrate all springs over a step; sets theta and omega of the elastic joints.

        Returns:
            The mean acceleration of the arm over the step, and the displacement beyond that of a
            constant mean acceleration. Without the latter, links would drift away from motors when
            gear teeth knock them back and forth within a step.
        """
        columns = np.zeros((self.dynamics.n, len(self.springs)))
        for i, spring in enumerate(self.springs):
            columns[self.k + spring.joint, i] = 1.0
        solved = solve_positive_definite(matrix, np.column_stack([force, columns]))
        mean, shift = solved[:, 0], np.zeros(self.dynamics.n)
        for i, spring in enumerate(self.springs):
            j, row = spring.joint, self.k + spring.joint
            mean_torque, extra_displacement = self._integrate_spring(
                spring,
                float(solved[row, 0]),
                float(solved[row, 1 + i]),
                float(self.motor_torque[j] - resistance[j]),
                omega,
            )
            mean = mean + solved[:, 1 + i] * mean_torque
            shift = shift + solved[:, 1 + i] * extra_displacement
        return mean, shift

    def _integrate_spring(
        self,
        spring: TransmissionSpring,
        free: float,
        compliance: float,
        push: float,
        omega: FloatArray,
    ) -> tuple[float, float]:
        """Integrate one spring over a step; the link accelerates by free + compliance·f.

        The motor accelerates by (push − f)/J.

        Returns:
            The mean of the spring torque f [N m], and the double integral over the step of f
            minus its mean [N m s²].
        """
        j, actuators, count = spring.joint, self.actuators, max(1, round(self.step / SPRING_STEP))
        dt = self.step / count
        inertia, viscous = float(actuators.inertia[j]), float(actuators.viscous[j])
        coulomb, width = float(actuators.coulomb[j]), float(actuators.width[j])
        q, v = float(self.q[self.k + j]), float(self.v[self.k + j])
        theta, w, total, first_sign = (
            float(self.theta[j]),
            float(omega[j]),
            0.0,
            float(np.tanh(omega[j] / width)),
        )
        for _ in range(count):
            sign = float(np.tanh(w / width))
            # `push` contains the friction at the start of the step already
            drag = viscous * (w - float(self.omega[j])) + coulomb * (sign - first_sign)
            implicit_inertia = inertia + dt * (viscous + coulomb / width * (1.0 - sign * sign))
            d, dd = theta - q, w - v
            pull, stiffness, damping = spring.torque_and_slopes(d, dd)
            both = 1.0 / implicit_inertia + compliance
            # the torque at the middle of the step makes an undamped spring conserve energy
            rate = (push - drag) / implicit_inertia - free
            change = (
                dt
                * (rate - (pull + 0.5 * stiffness * dt * dd) * both)
                / (1.0 + 0.5 * dt * (damping + 0.5 * dt * stiffness) * both)
            )
            force = pull + 0.5 * stiffness * dt * (dd + 0.5 * change) + 0.5 * damping * change
            motor_change = dt * (push - drag - force) / implicit_inertia
            link_change = dt * (free + compliance * force)
            theta, q = theta + dt * (w + 0.5 * motor_change), q + dt * (v + 0.5 * link_change)
            w, v = w + motor_change, v + link_change
            total += force
        self.theta[j], omega[j] = theta, w
        mean, v_start = total / count, float(self.v[self.k + j])
        q_of_mean = float(self.q[self.k + j]) + self.step * (
            v_start + 0.5 * self.step * (free + compliance * mean)
        )
        return mean, (q - q_of_mean) / compliance

    def _effect_torques(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return the torque of the effects at the end of the step, and its derivative by speed."""
        total, slope, start = np.zeros(self.n), np.zeros(self.n), 0
        x = JointStates(
            np.asarray(time), self.theta, self.omega + SLOPE_SPEED_OFFSETS, self.alpha, self.load
        )
        for effect in self.torque_effects:
            z = self.z[start : start + effect.state_size]
            start += effect.state_size
            torque = effect.torque(
                x, effect.advance_state(x, z, self.step) if effect.state_size else z
            )
            if torque is None:
                continue
            if torque.ndim == 1:
                total += torque
            else:
                total += torque[0]
                slope += np.maximum(0.0, torque[1] - torque[0]) / SLOPE_SPEED_DIFFERENCE
        return total, slope

    def _advance_effect_states(self, time: float) -> None:
        """Advance the internal states of the effects to the end of the step."""
        if not len(self.z):
            return
        x, start, parts = (
            JointStates(np.asarray(time), self.theta, self.omega, self.alpha, self.load),
            0,
            [],
        )
        for effect in self.torque_effects:
            z = self.z[start : start + effect.state_size]
            parts.append(effect.advance_state(x, z, self.step) if effect.state_size else z)
            start += effect.state_size
        self.z = np.concatenate(parts)


def solve_positive_definite(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a linear system with a symmetric positive definite matrix."""
    _, out, _ = lapack.dposv(matrix, right)
    return np.asarray(out)


def static_deflection(spring: TransmissionSpring, load: float) -> float:
    """Return the deflection at which a spring carries a load, by bisection.

    Args:
        spring: A spring whose torque grows with its deflection.
        load: Torque [N m].

    Returns:
        Deflection within ±1 rad [rad].
    """
    low, high = -1.0, 1.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if spring.torque_and_slopes(middle, 0.0)[0] < load else (low, middle)
        )
    return 0.5 * (low + high)
