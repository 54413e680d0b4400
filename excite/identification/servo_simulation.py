"""Closed-loop simulation of a robot with position servos, with exact sensitivities.

The motor torque of joint j is u = K_p clip(e, ±E) + K_d ė with e = q_ref(t − d) − q. Steps of
length h are semi-implicit: command, position, gravity and Coriolis torque are those of the start of
a step, friction and K_d act on the speed v⁺ at its end, as in MuJoCo:

    M(q) (v⁺ − v)/h + b(q, v) + F_v v⁺ + F_c tanh(v⁺/w) + c = u,    q⁺ = q + h v⁺.

Speeds are thus those of the middle of a step, and positions of second order in h (leapfrog).

v⁺ minimises ½ v⁺ᵀA v⁺ − rᵀv⁺ + h Σ F_c w log cosh(v⁺/w), A = M + h (F_v + K_d), a strictly convex
function. The sensitivities of the discrete map follow from the implicit function theorem and the
derivatives of inverse dynamics at the acceleration (v⁺ − v)/h, so that they are exact however small
the width w is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from .._types import BoolArray, FloatArray
from ..robot.dynamics import regressor
from ..robot.samples import Samples
from .forward_dynamics import RobotDynamics

MAX_STEP = 5e-3
"""Longest step of the simulation [s]."""
LOST_DISTANCE = 1.0
"""Distance from the recording at which the simulation of a window counts as lost, and the error it
then counts as [rad or m]."""
KEPT_DISTANCE = 100.0
"""The same where a lost window is simulated to its end [rad or m]."""
MAX_ITERATIONS = 60
"""Number of iterations for the speed at the end of a step, at most."""
SPEED_TOLERANCE = 1e-9
"""Change of a speed below which it has converged [rad/s or m/s]."""
LOOP_PARAMETERS = 3
"""Estimated parameters of a position loop: log K_p, K_d and the delay."""


@dataclass(frozen=True)
class ServoLoop:
    """Position loops of the joints.

    Attributes:
        proportional: K_p, for a recording of relative gain 1. Shape (n,) [N m/rad].
        derivative: K_d, for the same. Shape (n,) [N m s/rad].
        delay: Time d by which the command acts late. Shape (n,) [s].
    """

    proportional: FloatArray
    derivative: FloatArray
    delay: FloatArray

    def changed(self, step: FloatArray) -> ServoLoop:
        """Return the loops after a step of log K_p, K_d and d, one after the other. Shape (3n,)."""
        log_gain, derivative, delay = step.reshape(LOOP_PARAMETERS, -1)
        return ServoLoop(
            self.proportional * np.exp(log_gain), self.derivative + derivative, self.delay + delay
        )


@dataclass(frozen=True)
class ServoCommand:
    """Commanded positions of a gap-free stretch of a recording.

    Attributes:
        time: Times. Shape (N,) [s].
        q: Commanded positions. Shape (N, n) [rad or m].
    """

    time: FloatArray
    q: FloatArray

    def delayed(self, times: FloatArray, delay: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return commanded positions and speeds, linear between commands.

        Args:
            times: Times. Shape (K,) [s].
            delay: Delay of each joint. Shape (n,) [s].

        Returns:
            Shapes (K, n); the speed is the slope between two commands, 0 outside.
        """
        slope = np.diff(self.q, axis=0) / np.diff(self.time)[:, None]
        q, dq = (np.empty((len(times), self.q.shape[1])) for _ in range(2))
        for j, d in enumerate(delay):
            shifted = times - d
            q[:, j] = np.interp(shifted, self.time, self.q[:, j])
            place = np.searchsorted(self.time, shifted) - 1
            inside = (place >= 0) & (place < len(slope))
            dq[:, j] = np.where(inside, slope[np.clip(place, 0, len(slope) - 1), j], 0.0)
        return q, dq


@dataclass(frozen=True)
class ServoWindows:
    """Windows of recordings, all of the same length and rate.

    Attributes:
        states: Recorded q and q̇ at the start, filtered. Shape (W, 2n).
        q: Recorded positions. Shape (W, S + 1, n) [rad or m].
        begins: Time of each window's start. Shape (W,) [s].
        commands: Command of the stretch that each window is from.
        step: Time between positions [s].
        gain: Gains of each window over those of `ServoLoop`. Shape (W, n) [1].
        error_limit: Position error E at which the motor saturates, ∞ without. Shape (W, n).
    """

    states: FloatArray
    q: FloatArray
    begins: FloatArray
    commands: tuple[ServoCommand, ...]
    step: float
    gain: FloatArray
    error_limit: FloatArray

    def __len__(self) -> int:
        return len(self.q)

    @property
    def seconds(self) -> float:
        """Length of all windows together [s]."""
        return len(self) * (self.q.shape[1] - 1) * self.step

    @property
    def substeps(self) -> int:
        """Number of steps of integration between two positions."""
        return max(1, int(np.ceil(self.step / MAX_STEP - 1e-9)))

    def delayed_command(self, delay: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return commanded positions and speeds at the start of every step of integration.

        Args:
            delay: Delay of each joint. Shape (n,) [s].

        Returns:
            Shapes (W, K, n).
        """
        lag = self.step / self.substeps * np.arange((self.q.shape[1] - 1) * self.substeps)
        parts = [
            command.delayed(begin + lag, delay)
            for begin, command in zip(self.begins, self.commands, strict=True)
        ]
        return np.array([part[0] for part in parts]), np.array([part[1] for part in parts])


@dataclass(frozen=True)
class ServoRun:
    """A simulation of all windows.

    Attributes:
        q: Positions. Shape (W, S + 1, n) [rad or m].
        slopes: Derivatives with respect to log K_p, K_d, d and θ. Shape (W, S + 1, n, 3n + p); None
            if they were not computed.
        lost: Windows that left the recording.
    """

    q: FloatArray
    slopes: FloatArray | None
    lost: BoolArray


def simulate_servo(
    dynamics: RobotDynamics,
    loop: ServoLoop,
    windows: ServoWindows,
    *,
    sensitivities: bool = False,
    keep_lost: bool = False,
) -> ServoRun:
    """Simulate the robot under its position loops from the recorded state of every window.

    Args:
        dynamics: The robot.
        loop: The position loops.
        windows: The windows.
        sensitivities: Also compute derivatives.
        keep_lost: Simulate windows that are lost, too; a servo brings the robot back.
    """
    n, W, S = windows.q.shape[2], len(windows), windows.q.shape[1]
    p = dynamics.model.base.count
    h = windows.step / windows.substeps
    command = windows.delayed_command(loop.delay)
    q, v = windows.states[:, :n].copy(), windows.states[:, n:].copy()
    step = _ServoStep(dynamics, loop, windows, h)
    out, lost = np.empty(windows.q.shape), np.zeros(W, bool)
    X = np.zeros((W, 2 * n, LOOP_PARAMETERS * n + p)) if sensitivities else None
    slopes = np.zeros((W, S, n, LOOP_PARAMETERS * n + p)) if sensitivities else None
    out[:, 0] = q
    for k in range(command[0].shape[1]):
        q, v, X = step.advance(q, v, X, command[0][:, k], command[1][:, k])
        at, is_row = divmod(k + 1, windows.substeps)
        if is_row:
            continue
        distance = np.abs(q - windows.q[:, at]).max(axis=1)
        lost |= ~(distance < (KEPT_DISTANCE if keep_lost else LOST_DISTANCE))
        q[lost], v[lost] = windows.states[lost, :n], 0.0  # unused, but have to stay finite
        out[:, at] = np.where(lost[:, None], windows.q[:, at] + LOST_DISTANCE, q)
        if slopes is not None and X is not None:
            X[lost] = 0.0
            slopes[:, at] = X[:, :n]
    return ServoRun(out, slopes, lost)


class _ServoStep:
    """One step of integration of all windows.

    Args:
        dynamics: The robot.
        loop: The position loops.
        windows: The windows.
        h: Length of a step [s].
    """

    def __init__(
        self, dynamics: RobotDynamics, loop: ServoLoop, windows: ServoWindows, h: float
    ) -> None:
        self._dynamics, self._h, self._limit = dynamics, h, windows.error_limit
        self._gain, self._relative = loop.proportional * windows.gain, windows.gain
        self._derivative = loop.derivative * windows.gain

    def advance(
        self,
        q: FloatArray,
        v: FloatArray,
        X: FloatArray | None,
        reference: FloatArray,
        reference_speed: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Return q, q̇ and, where X is given, their sensitivities at the end of the step."""
        dynamics, h = self._dynamics, self._h
        M, bias = dynamics.mass_matrix(q), dynamics.bias(q, v)
        error = np.clip(reference - q, -self._limit, self._limit)
        diagonal = np.arange(q.shape[1])
        A = M.copy()
        A[:, diagonal, diagonal] += h * (dynamics.viscous + self._derivative)
        r = np.einsum("wij,wj->wi", M, v) + h * (
            self._gain * error + self._derivative * reference_speed - bias - dynamics.offset
        )
        end = end_speed(A, r, h * dynamics.coulomb, dynamics.widths, v)
        if X is None:
            return q + h * end, end, None
        a, n = (end - v) / h, q.shape[1]
        by_q, by_v = self._rigid_slopes(q, v, a)
        inside = np.abs(reference - q) < self._limit
        by_q[:, diagonal, diagonal] += self._gain * inside
        change = h * (by_q @ X[:, :n] + by_v @ X[:, n:]) - M @ X[:, n:]
        change[:, diagonal, diagonal] -= h * self._gain * error
        change[:, diagonal, n + diagonal] -= h * self._relative * (reference_speed - end)
        change[:, diagonal, 2 * n + diagonal] += h * self._gain * inside * reference_speed
        change[:, :, LOOP_PARAMETERS * n :] += h * self._regressor(q, v, a, end)
        coulomb_slope = 1.0 - np.tanh(end / dynamics.widths) ** 2
        A[:, diagonal, diagonal] += h * dynamics.coulomb / dynamics.widths * coulomb_slope
        end_slopes = -np.linalg.solve(A, change)
        return (
            q + h * end,
            end,
            np.concatenate([X[:, :n] + h * end_slopes, end_slopes], axis=1),
        )

    def _rigid_slopes(
        self, q: FloatArray, v: FloatArray, a: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """∂τ/∂q and ∂τ/∂q̇ of the links at constant acceleration. Shapes (W, n, n)."""
        robot, body, data = self._dynamics.model.robot, self._dynamics.body, self._dynamics.data
        spread = robot.spread
        parts: list[Any] = []
        for state in zip(robot.expand(q), v @ spread.T, a @ spread.T, strict=True):
            by_q, by_v, _ = pin.computeRNEADerivatives(body, data, *state)
            parts.append((spread.T @ by_q @ spread, spread.T @ by_v @ spread))
        return np.array([part[0] for part in parts]), np.array([part[1] for part in parts])

    def _regressor(
        self, q: FloatArray, v: FloatArray, a: FloatArray, end: FloatArray
    ) -> FloatArray:
        """Γ with friction of the speed at the end of the step. Shape (W, n, p)."""
        model, widths = self._dynamics.model, self._dynamics.widths
        Y = regressor(model.robot, model.parameters, Samples(q, v, a))
        joints = np.arange(q.shape[1])
        for kind, value in (("viscous", end), ("coulomb", np.tanh(end / widths))):
            if kind in model.parameters.drive:
                Y[:, joints, model.parameters.block(kind).start + joints] = value
        return np.asarray(Y[:, :, model.base.independent])


def end_speed(
    A: FloatArray, r: FloatArray, friction: FloatArray, widths: FloatArray, start: FloatArray
) -> FloatArray:
    """Solve A v + f tanh(v/w) = r for the speed v.

    v minimises a strictly convex function. Newton's method, stopped where a speed would change its
    sign, as the slope of the friction is largest there; where it does not decrease the function, a
    step of the quadratic that majorises it, f tanh(v₀/w)/v₀ · v²/2 (de Leeuw & Lange,
    "Sharp quadratic majorization in one dimension", 2009), which always does.

    Args:
        A: Symmetric positive definite matrices. Shape (W, n, n).
        r: Right-hand sides. Shape (W, n).
        friction: f. Shape (n,).
        widths: w. Shape (n,).
        start: Initial guess. Shape (W, n).

    Returns:
        Speeds. Shape (W, n).
    """
    joints = np.arange(A.shape[1])
    v = start.copy()
    active = np.arange(len(r))
    before = _speed_cost(A, r, friction, widths, v)
    for _ in range(MAX_ITERATIONS):
        speed, matrix, right = v[active], A[active], r[active]
        tanh = np.tanh(speed / widths)
        gradient = np.einsum("wij,wj->wi", matrix, speed) + friction * tanh - right
        newton = matrix.copy()
        newton[:, joints, joints] += friction / widths * (1.0 - tanh**2)
        change = np.linalg.solve(newton, gradient[..., None])[..., 0]
        trial = speed - change
        trial[(trial * speed < 0.0) & (np.abs(speed) > widths)] = 0.0
        cost = _speed_cost(matrix, right, friction, widths, trial)
        worse = cost > before + 1e-15 * np.abs(before)
        if worse.any():
            small = np.maximum(np.abs(speed[worse]), 1e-12 * widths)
            secant = matrix[worse].copy()
            secant[:, joints, joints] += friction * np.tanh(small / widths) / small
            trial[worse] = np.linalg.solve(secant, right[worse][..., None])[..., 0]
            cost[worse] = _speed_cost(matrix[worse], right[worse], friction, widths, trial[worse])
        v[active] = trial
        moving = np.abs(trial - speed).max(axis=1) > SPEED_TOLERANCE
        if not moving.any():
            break
        active, before = active[moving], cost[moving]
    return v


def _speed_cost(
    A: FloatArray, r: FloatArray, friction: FloatArray, widths: FloatArray, v: FloatArray
) -> FloatArray:
    """The convex function that `end_speed` minimises, of each row. Shape (W,)."""
    x = np.abs(v) / widths
    dissipated = friction * widths * (x + np.log1p(np.exp(-2.0 * x)))
    product = np.einsum("wij,wj->wi", A, v)
    return np.asarray(np.sum(v * (0.5 * product - r) + dissipated, axis=1))
