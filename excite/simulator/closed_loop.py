"""The closed loop: what motion a controlled robot with all its physics makes of a reference.

Linearly implicit steps of half a millisecond to two: friction and suspension enter with their slopes, so tanh(ω/3 mrad/s) is no
obstacle; springs between motor and link are integrated in steps of a tenth of a millisecond, with the rest of the arm condensed to one
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
"""Step of a spring [s]."""
SLOPE_SPEED_DIFFERENCE = 1e-4
"""Difference of speed that shows an effect's slope [rad/s]."""
SLOPE_SPEED_OFFSETS = np.array([[0.0], [SLOPE_SPEED_DIFFERENCE]])
DIVERGENCE_SPEED = 1e3
"""Speed from which nothing comes back: it is not followed further, lest numbers overflow [rad/s or m/s]."""


@dataclass(frozen=True)
class StateHistory:
    """States at t = k·step. q: links and base, Shape (N, k + n); theta: motors, (N, n); z: memory, (N, m). Of a loop that is lost, q is not
    finite from there on."""

    t: FloatArray
    q: FloatArray
    theta: FloatArray
    z: FloatArray


@dataclass
class ClosedLoop:
    """One run. k base coordinates come before the n joints in the arm's order. limit: Shape (n,) [N m]. step [s]."""

    arm: RigidBodyDynamics
    drive: JointActuators
    control: ControllerGains
    effects: Sequence[PhysicalEffect]
    base_suspension: BaseSuspension | None
    limit: FloatArray
    step: float

    def __post_init__(self) -> None:
        self.n = len(self.drive.inertia)
        self.k = self.arm.n - self.n
        self.springs: list[TransmissionSpring] = [
            spring for law in self.effects if (spring := law.transmission_spring()) is not None
        ]
        self.active = [law for law in self.effects if type(law).torque is not PhysicalEffect.torque]
        self.sensors = [
            law
            for law in self.effects
            if type(law).measured_position is not PhysicalEffect.measured_position
        ]
        self.rigid = self.drive.inertia.copy()
        self.rigid[[s.joint for s in self.springs]] = 0.0
        self.follow = 1.0 - float(np.exp(-self.step / self.control.lag))

    def run(self, reference: ReferenceTrajectory) -> StateHistory:
        """Follow a reference from rest to rest. Raises nothing: a loop that does not hold shows in the motion."""
        t = np.arange(int(np.ceil(reference.duration / self.step)) + 1) * self.step
        asked = reference.at(t)
        forward = self._forward(*asked)
        self._begin(asked[0][0])
        rows = len(t)
        q, theta, z = (
            np.zeros((rows, self.arm.n)),
            np.zeros((rows, self.n)),
            np.zeros((rows, len(self.z))),
        )
        q[0], theta[0], z[0] = self.q, self.theta, self.z
        for i in range(rows - 1):
            self._command(asked[0][i], asked[1][i], forward[i])
            if not self._held(t[i]):
                q[i + 1 :] = np.inf
                break
            q[i + 1], theta[i + 1], z[i + 1] = self.q, self.theta, self.z
        return StateHistory(t, q, theta, z)

    def _forward(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        pad = np.zeros((len(q), self.k))
        whole = [np.hstack([pad, part]) for part in (q, v, a)]
        rigid = self.arm.inverse_dynamics(*whole)[:, self.k :] + self.drive.inertia * a
        return self.control.forward * rigid

    def _begin(self, q: FloatArray) -> None:
        self.q, self.v, self.a = np.zeros(self.arm.n), np.zeros(self.arm.n), np.zeros(self.arm.n)
        self.q[self.k :] = q
        self.load = self.arm.mass_and_bias(self.q, self.v)[1][self.k :]
        self.omega, self.alpha, self.theta = np.zeros(self.n), np.zeros(self.n), q.copy()
        for spring in self.springs:
            self.theta[spring.joint] += static_deflection(spring, float(self.load[spring.joint]))
        self.z = np.zeros(sum(law.state_size for law in self.active))
        self.u = self.load + self.drive.offset
        self.sum = (1.0 - self.control.forward) * self.load + self.drive.offset
        self.gain = self.control.speed * self._inertia()

    def _inertia(self) -> FloatArray:
        return np.diag(self.arm.mass_and_bias(self.q, self.v)[0])[self.k :] + self.drive.inertia

    def _command(self, q: FloatArray, v: FloatArray, forward: FloatArray) -> None:
        """The controller's torque, through the current loop's lag."""
        c, seen = self.control, self.theta
        for law in self.sensors:
            seen = law.measured_position(seen)
        if c.step > 0.0:
            seen = np.round(seen / c.step) * c.step
        error = self.gain * (v + c.position * (q - seen) - self.omega)
        wanted = forward + error + self.sum
        bounded = np.minimum(np.maximum(wanted, -self.limit), self.limit)
        self.sum = self.sum + c.integral * self.step * error * (
            wanted == bounded
        )  # no wind-up at the limit
        self.u = self.u + self.follow * (bounded - self.u)

    def _held(self, time: float) -> bool:
        """A step; whether the loop still holds after it."""
        try:
            self._advance(time)
        except OverflowError:  # of a spring whose torque grows with the cube
            return False
        return bool(np.abs(self.v).max() < DIVERGENCE_SPEED)

    def _advance(self, time: float) -> None:
        mass, bias = self.arm.mass_and_bias(self.q, self.v)
        k, drive = self.k, self.drive
        still = np.tanh(self.omega / drive.width)
        resist = drive.viscous * self.omega + drive.coulomb * still + drive.offset
        slope = drive.viscous + drive.coulomb / drive.width * (1.0 - still * still)
        if self.active:
            extra, steep = self._effects(time)
            resist, slope = resist + extra, slope + steep
        torque, steady = self.u - resist, self.rigid + self.step * slope
        for spring in self.springs:
            torque[spring.joint], steady[spring.joint] = 0.0, 0.0
        matrix, force = mass.copy(), -bias
        matrix.ravel()[k * (self.arm.n + 1) :: self.arm.n + 1] += steady
        force[k:] += torque
        if self.base_suspension is not None:
            s, base = self.base_suspension, np.arange(k)
            matrix[base, base] += 0.5 * self.step * s.damping + 0.25 * self.step**2 * s.stiffness
            force[:k] -= (
                s.stiffness * (self.q[:k] + 0.5 * self.step * self.v[:k]) + s.damping * self.v[:k]
            )
        before, theta, omega = self.v, self.theta, self.omega.copy()
        self.a, shift = (
            self._wind(matrix, force, resist, omega)
            if self.springs
            else (solve_positive_definite(matrix, force), 0.0)
        )
        self.v = before + self.step * self.a
        self.q = self.q + 0.5 * self.step * (before + self.v) + shift
        theta, turned = self.q[k:].copy(), self.v[k:].copy()
        for spring in self.springs:
            theta[spring.joint], turned[spring.joint] = (
                self.theta[spring.joint],
                omega[spring.joint],
            )
        self.alpha, self.theta, self.omega = (turned - self.omega) / self.step, theta, turned
        if self.active:
            self.load = (mass @ self.a + bias)[k:]
            self._remember(time + self.step)

    def _wind(
        self, matrix: FloatArray, force: FloatArray, resist: FloatArray, omega: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Fine steps of the springs, which set theta, omega of elastic joints; returns the arm's mean acceleration over them, and how much
        further it comes than with that from the first: else links drift off the motors that teeth knock them back and forth on."""
        columns = np.zeros((self.arm.n, len(self.springs)))
        for i, spring in enumerate(self.springs):
            columns[self.k + spring.joint, i] = 1.0
        solved = solve_positive_definite(matrix, np.column_stack([force, columns]))
        mean, shift = solved[:, 0], np.zeros(self.arm.n)
        for i, spring in enumerate(self.springs):
            j, row = spring.joint, self.k + spring.joint
            pulse, further = self._wind_one(
                spring,
                float(solved[row, 0]),
                float(solved[row, 1 + i]),
                float(self.u[j] - resist[j]),
                omega,
            )
            mean, shift = mean + solved[:, 1 + i] * pulse, shift + solved[:, 1 + i] * further
        return mean, shift

    def _wind_one(
        self, spring: TransmissionSpring, free: float, yields: float, push: float, omega: FloatArray
    ) -> tuple[float, float]:
        """One spring: links accelerate by free + yields·f, the motor by (push − f)/J. Returns the mean of f [N m], and the double integral
        of f less its mean over the step [N m s²]."""
        j, drive, count = spring.joint, self.drive, max(1, round(self.step / SPRING_STEP))
        dt = self.step / count
        inertia, viscous = float(drive.inertia[j]), float(drive.viscous[j])
        coulomb, width = float(drive.coulomb[j]), float(drive.width[j])
        q, v = float(self.q[self.k + j]), float(self.v[self.k + j])
        theta, w, total, first = (
            float(self.theta[j]),
            float(omega[j]),
            0.0,
            float(np.tanh(omega[j] / width)),
        )
        for _ in range(count):
            s = float(np.tanh(w / width))
            drag = viscous * (w - float(self.omega[j])) + coulomb * (s - first)
            heavy = inertia + dt * (viscous + coulomb / width * (1.0 - s * s))
            d, dd = theta - q, w - v
            pull, stiff, damp = spring.torque_and_slopes(d, dd)
            both = 1.0 / heavy + yields
            # the pull is taken at the middle of the step, so a spring without damper neither gains nor loses
            rate = (push - drag) / heavy - free
            change = (
                dt
                * (rate - (pull + 0.5 * stiff * dt * dd) * both)
                / (1.0 + 0.5 * dt * (damp + 0.5 * dt * stiff) * both)
            )
            force = pull + 0.5 * stiff * dt * (dd + 0.5 * change) + 0.5 * damp * change
            faster, quicker = dt * (push - drag - force) / heavy, dt * (free + yields * force)
            theta, q = theta + dt * (w + 0.5 * faster), q + dt * (v + 0.5 * quicker)
            w, v = w + faster, v + quicker
            total += force
        self.theta[j], omega[j] = theta, w
        mean, before = total / count, float(self.v[self.k + j])
        steady = float(self.q[self.k + j]) + self.step * (
            before + 0.5 * self.step * (free + yields * mean)
        )
        return mean, (q - steady) / yields

    def _effects(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Torque of the effects at the end of a step without acceleration, and how it grows with speed."""
        total, slope, at = np.zeros(self.n), np.zeros(self.n), 0
        # two speeds at once, the rest broadcasts
        x = JointStates(
            np.asarray(time), self.theta, self.omega + SLOPE_SPEED_OFFSETS, self.alpha, self.load
        )
        for law in self.active:
            z = self.z[at : at + law.state_size]
            at += law.state_size
            torque = law.torque(x, law.advance_state(x, z, self.step) if law.state_size else z)
            if torque is None:
                continue
            if torque.ndim == 1:
                total += torque
            else:
                total += torque[0]
                slope += np.maximum(0.0, torque[1] - torque[0]) / SLOPE_SPEED_DIFFERENCE
        return total, slope

    def _remember(self, time: float) -> None:
        if not len(self.z):
            return
        x, at, parts = (
            JointStates(np.asarray(time), self.theta, self.omega, self.alpha, self.load),
            0,
            [],
        )
        for law in self.active:
            z = self.z[at : at + law.state_size]
            parts.append(law.advance_state(x, z, self.step) if law.state_size else z)
            at += law.state_size
        self.z = np.concatenate(parts)


def solve_positive_definite(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution for a positive definite matrix."""
    _, out, _ = lapack.dposv(matrix, right)
    return np.asarray(out)


def static_deflection(spring: TransmissionSpring, load: float) -> float:
    """Wind-up at which a spring carries a load; bisection, for a pull that grows with wind-up [rad]."""
    low, high = -1.0, 1.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if spring.torque_and_slopes(middle, 0.0)[0] < load else (low, middle)
        )
    return 0.5 * (low + high)
