"""Simulation error: deviation of the identified robot, simulated forward, from the recorded motion.

Multiple shooting (review, eq. 6): the recording is cut into short windows. Each is simulated from
its own initial state, with the recorded torque as input (linear between samples), by the classical
Runge-Kutta method. The derivatives of the positions with respect to θ and the initial state are
those of the same steps, so that they are exact for the discrete map (variational equations:
Hairer, Nørsett & Wanner, "Solving Ordinary Differential Equations I", section I.14). Coulomb
friction is widened where its stiffness would make the steps unstable.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from .forward_dynamics import RobotDynamics, build_dynamics, stable_friction_widths, with_widths
from .lowpass import FRICTION_BANDWIDTH_RATIO, Grid
from .regression import IdentificationModel
from .segments import RecordingSegment

WINDOW_LENGTH = 0.2
"""Length of a window [s]."""
MAX_WINDOWS = 60
"""Number of windows, at most, spread evenly over the recordings."""
POSITIONS_PER_WINDOW = 20
"""Number of positions compared in a window, besides the first."""
MAX_INTEGRATION_STEP = 1e-3
"""Longest step of integration [s]."""
LOST_DISTANCE = 1.0
"""Distance from the recording at which the simulation of a window counts as lost, and the error it
then counts as [rad or m]."""


@dataclass(frozen=True)
class SimulationWindows:
    """Windows of recordings that have the same rate.

    Attributes:
        states: q and q̇ at the start, filtered. Shape (W, 2n).
        torque: Torque at every sample. Shape (W, K + 1, n) [N m].
        q: Recorded positions, the first at the start. Shape (W, S + 1, n) [rad or m].
        every: Number of samples of torque from one position to the next.
        rate: Rate of the torque samples [Hz].
    """

    states: FloatArray
    torque: FloatArray
    q: FloatArray
    every: int
    rate: float

    def __len__(self) -> int:
        return len(self.q)

    @property
    def lag(self) -> FloatArray:
        """Times of the positions after the start. Shape (S + 1,) [s]."""
        return np.arange(self.q.shape[1]) * self.every / self.rate

    @property
    def steps(self) -> int:
        """Number of integration steps per sample of torque."""
        return max(1, int(np.ceil(1.0 / (self.rate * MAX_INTEGRATION_STEP) - 1e-9)))


@dataclass(frozen=True)
class SimulationError:
    """RMS over windows of the difference between simulated and recorded positions.

    Attributes:
        lag: Times after the start of a window. Shape (S,) [s].
        fitted: Error of the identified parameters. Shape (S, n) [rad or m].
        nominal: Error of the nominal parameters. Shape (S, n) [rad or m].
        windows: Number of windows.
        share: Share of the recordings that the windows cover.
    """

    lag: FloatArray
    fitted: FloatArray
    nominal: FloatArray
    windows: int
    share: float

    @property
    def summary(self) -> str:
        """The error at the end of the windows, RMS over the joints, in one line."""
        fitted, nominal = (float(np.sqrt(np.mean(x[-1] ** 2))) for x in (self.fitted, self.nominal))
        return (
            f"simulated {self.lag[-1]:.3g} s ahead in {self.windows} windows, "
            f"{100 * self.share:.0f} % of the recordings: position error {fitted:.3g}, "
            f"{nominal:.3g} with the nominal parameters (RMS, rad or m)"
        )


def cut_windows(
    segments: Sequence[RecordingSegment],
    hertz: float,
    horizon: float = WINDOW_LENGTH,
    most: int = MAX_WINDOWS,
) -> tuple[list[SimulationWindows], float]:
    """Cut windows from segments.

    Initial states come from positions filtered below FRICTION_BANDWIDTH_RATIO bands; margins that
    the filter spoils are left out.

    Args:
        segments: Segments of recordings.
        hertz: Cutoff frequency [Hz].
        horizon: Length of a window [s].
        most: Largest number of windows.

    Returns:
        The windows, one set per rate, and the share of the recordings that they cover.
    """
    starts, total = [], 0.0
    for k, segment in enumerate(segments):
        band, size = segment.band(hertz), _samples_per_window(segment, horizon)
        starts += [
            (k, begin) for begin in range(band.margin, len(segment) - band.margin - size, size)
        ]
        total += len(segment) / segment.rate
    if not starts:
        return [], 0.0
    chosen = [
        starts[i]
        for i in np.unique(np.linspace(0, len(starts) - 1, min(most, len(starts))).astype(int))
    ]
    groups: dict[float, list[SimulationWindows]] = {}
    for k, segment in enumerate(segments):
        if begins := [begin for index, begin in chosen if index == k]:
            groups.setdefault(segment.rate, []).append(
                _segment_windows(segment, begins, hertz, horizon)
            )
    return [_joined(group) for group in groups.values()], len(chosen) * horizon / total


def _samples_per_window(segment: RecordingSegment, horizon: float) -> int:
    """Number of samples from the start of a window to its end."""
    return max(2, round(horizon * segment.rate))


def _segment_windows(
    segment: RecordingSegment, begins: list[int], hertz: float, horizon: float
) -> SimulationWindows:
    """Windows of a segment that begin at given samples."""
    band = segment.band(hertz)
    states = np.concatenate(
        [
            band.filter(segment.q, Grid.RECORDED, order, bandwidth_ratio=FRICTION_BANDWIDTH_RATIO)
            for order in range(2)
        ],
        axis=1,
    )
    size = _samples_per_window(segment, horizon)
    every = max(1, size // POSITIONS_PER_WINDOW)
    index = np.asarray(begins)[:, None] + np.arange(size // every * every + 1)
    return SimulationWindows(
        states[begins], segment.torque[index], segment.q[index[:, ::every]], every, segment.rate
    )


def _joined(parts: Sequence[SimulationWindows]) -> SimulationWindows:
    """Windows of several segments of the same rate."""
    states, torque, q = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("states", "torque", "q")
    )
    return SimulationWindows(states, torque, q, parts[0].every, parts[0].rate)


def widen_friction(
    model: IdentificationModel, psi: FloatArray, groups: Sequence[SimulationWindows]
) -> IdentificationModel:
    """Return the model with Coulomb friction wide enough for the steps of integration."""
    widths, n = model.widths, model.robot.n
    for windows in groups:
        dynamics = build_dynamics(model, psi)
        step = 1.0 / (windows.rate * windows.steps)
        widths = np.maximum(widths, stable_friction_widths(dynamics, windows.states[:, :n], step))
    return with_widths(model, widths)


def compute_simulation_error(
    model: IdentificationModel,
    psi: FloatArray,
    nominal: FloatArray,
    groups: Sequence[SimulationWindows],
    share: float = 1.0,
) -> SimulationError:
    """Compute how well parameters predict positions from the filtered initial states.

    Args:
        model: The model.
        psi: Identified parameters. Shape (P,).
        nominal: Nominal parameters, to compare. Shape (P,).
        groups: Windows, as `cut_windows` returns them.
        share: Share of the recordings that they cover.

    Raises:
        UnusableInput: There is no window.
    """
    if not groups:
        raise UnusableInput(
            "--simulate: no recording is as long as one window and the margins of the filter; "
            "record for longer"
        )
    widened = widen_friction(model, psi, groups)
    lags = np.unique(np.concatenate([np.round(g.lag[1:], 9) for g in groups]))
    errors = []
    for parameters in (psi, nominal):
        dynamics = build_dynamics(widen_friction(widened, parameters, groups), parameters)
        parts = [
            (
                g.lag[1:],
                np.clip(
                    simulate_positions(dynamics, g, g.states) - g.q, -LOST_DISTANCE, LOST_DISTANCE
                )[:, 1:],
            )
            for g in groups
        ]
        square = np.array(
            [
                [np.interp(lags, lag, np.mean(e[:, :, j] ** 2, axis=0)) for j in range(e.shape[2])]
                for lag, e in parts
            ]
        )
        weights = np.array([len(g) for g in groups], float)
        errors.append(np.sqrt(np.einsum("g,gjs->sj", weights / weights.sum(), square)))
    return SimulationError(lags, errors[0], errors[1], sum(map(len, groups)), share)


def simulate_positions(
    dynamics: RobotDynamics, windows: SimulationWindows, states: FloatArray
) -> FloatArray:
    """Simulate windows from given states.

    Args:
        dynamics: The robot.
        windows: Windows with the torque.
        states: q and q̇ at the start. Shape (W, 2n).

    Returns:
        Positions; ∞ after a window is lost. Shape (W, S + 1, n).
    """
    n = states.shape[1] // 2
    x, out = states.copy(), np.full(windows.q.shape, np.inf)
    alive, last = np.ones(len(x), bool), 0
    for at, h, torque in _integration_steps(windows):
        last = last if at is None else at
        alive &= (np.abs(x[:, :n] - windows.q[:, last]).max(axis=1) < LOST_DISTANCE) & (
            h * np.abs(x[:, n:]).max(axis=1) < LOST_DISTANCE
        )
        x[~alive] = states[~alive]  # their values are not used, but have to stay finite
        if at is not None:
            out[alive, at] = x[alive, :n]
        if torque is None:
            break
        k1 = _state_rate(dynamics, x, torque[0])
        k2 = _state_rate(dynamics, x + 0.5 * h * k1, torque[1])
        k3 = _state_rate(dynamics, x + 0.5 * h * k2, torque[1])
        k4 = _state_rate(dynamics, x + h * k3, torque[2])
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return out


def simulate_sensitivities(
    dynamics: RobotDynamics, windows: SimulationWindows, states: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Simulate windows with derivatives with respect to the initial state and θ.

    Args:
        dynamics: The robot.
        windows: Windows with the torque.
        states: q and q̇ at the start. Shape (W, 2n).

    Returns:
        Positions, shape (W, S + 1, n), and derivatives, shape (W, S + 1, n, 2n + p).
    """
    W, n = len(states), states.shape[1] // 2
    p = dynamics.model.base.count
    x, X = states.copy(), np.zeros((W, 2 * n, 2 * n + p))
    X[:, range(2 * n), range(2 * n)] = 1.0
    out, slopes = np.empty(windows.q.shape), np.empty((*windows.q.shape, 2 * n + p))
    for at, h, torque in _integration_steps(windows):
        if at is not None:
            out[:, at], slopes[:, at] = x[:, :n], X[:, :n]
        if torque is None:
            break
        k1, K1 = _sensitivity_rate(dynamics, x, X, torque[0])
        k2, K2 = _sensitivity_rate(dynamics, x + 0.5 * h * k1, X + 0.5 * h * K1, torque[1])
        k3, K3 = _sensitivity_rate(dynamics, x + 0.5 * h * k2, X + 0.5 * h * K2, torque[1])
        k4, K4 = _sensitivity_rate(dynamics, x + h * k3, X + h * K3, torque[2])
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        X = X + h / 6.0 * (K1 + 2.0 * K2 + 2.0 * K3 + K4)
    return out, slopes


def _integration_steps(
    windows: SimulationWindows,
) -> Iterator[tuple[int | None, float, tuple[FloatArray, FloatArray, FloatArray] | None]]:
    """Yield the steps of integration.

    Yields:
        Index of the position at the start of the step, or None; length of the step [s]; torque at
        its start, middle and end, None after the last step.
    """
    steps = windows.steps
    h = 1.0 / windows.rate / steps
    for k in range(windows.torque.shape[1] - 1):
        now, change = windows.torque[:, k], windows.torque[:, k + 1] - windows.torque[:, k]
        for i in range(steps):
            at = k // windows.every if k % windows.every == 0 and i == 0 else None
            a, b, c = (now + (i + part) / steps * change for part in (0.0, 0.5, 1.0))
            yield at, h, (a, b, c)
    yield windows.q.shape[1] - 1, h, None


def _state_rate(dynamics: RobotDynamics, x: FloatArray, torque: FloatArray) -> FloatArray:
    """Time derivative of the state (q, q̇). Shape (W, 2n)."""
    n = torque.shape[1]
    return np.concatenate([x[:, n:], dynamics.acceleration(x[:, :n], x[:, n:], torque)], axis=1)


def _sensitivity_rate(
    dynamics: RobotDynamics, x: FloatArray, X: FloatArray, torque: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Time derivatives of the state and of its sensitivities (variational equations)."""
    n = torque.shape[1]
    a, slopes = dynamics.acceleration_derivatives(x[:, :n], x[:, n:], torque)
    rate = slopes[:, :, : 2 * n] @ X
    rate[:, :, 2 * n :] += slopes[:, :, 2 * n :]
    return np.concatenate([x[:, n:], a], axis=1), np.concatenate([X[:, n:], rate], axis=1)
