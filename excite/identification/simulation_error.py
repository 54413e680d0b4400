"""Simulation error: how far the identified robot, simulated forward, strays from where the recording went (review, eq. 6).

Multiple shooting: the recording is cut into short windows, each simulated from its own initial state with the recorded torque as input
(linear between samples) by the classical Runge-Kutta method. Derivatives of the positions with respect to θ and the initial
state are those of the very same steps, so that they are exact for the discrete map (variational equations; Hairer, Nørsett & Wanner I.14).
Friction steeper than a step carries is widened (`mechanism.softened`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import UnusableInput
from . import forward_dynamics
from .forward_dynamics import RobotDynamics
from .lowpass import FRICTION_BANDWIDTH_RATIO, Grid
from .regression import IdentificationModel
from .segments import Segment

Array = np.ndarray
HORIZON = 0.2
"""Length of a window [s]."""
WINDOWS = 60
"""Windows at the most, evenly spread over the recordings."""
SAMPLES = 20
"""Positions compared in a window, besides the first."""
STEP = 1e-3
"""Longest step of integration [s]."""
LOST_DISTANCE = 1.0
"""Distance from the recording at which a window's simulation counts as lost, and what it counts then [rad or m]."""


@dataclass(frozen=True)
class SimulationWindows:
    """Parts of recordings of one rate. states: q, q̇ at the start, filtered. Shape (W, 2n). torque: Shape (W, K + 1, n) [N m].

    q: as recorded, at times lag after the start, 0 the first. Shape (W, S + 1, n). every: samples of torque from one position to the
    next. rate: of torque [Hz].
    """

    states: Array
    torque: Array
    q: Array
    every: int
    rate: float

    def __len__(self) -> int:
        return len(self.q)

    @property
    def lag(self) -> Array:
        """Times of the positions after the start. Shape (S + 1,) [s]."""
        return np.arange(self.q.shape[1]) * self.every / self.rate

    @property
    def steps(self) -> int:
        """Steps of integration from one sample of torque to the next."""
        return max(1, int(np.ceil(1.0 / (self.rate * STEP) - 1e-9)))


@dataclass(frozen=True)
class SimulationError:
    """RMS over windows of predicted less recorded position. lag: Shape (S,) [s]. fitted, nominal: Shape (S, n) [rad or m].

    windows: how many. share: of the recordings that they cover.
    """

    lag: Array
    fitted: Array
    nominal: Array
    windows: int
    share: float

    @property
    def words(self) -> str:
        """One line: the end of the horizon, joints in quadratic mean."""
        fitted, nominal = (float(np.sqrt(np.mean(x[-1] ** 2))) for x in (self.fitted, self.nominal))
        ahead = f"simulated {self.lag[-1]:.3g} s ahead in {self.windows} windows, {100 * self.share:.0f} % of the recordings"
        return (
            f"{ahead}: off by {fitted:.3g}, by the nominal parameters {nominal:.3g} (RMS, rad or m)"
        )


def cut_windows(
    pieces: Sequence[Segment], hertz: float, horizon: float = HORIZON, most: int = WINDOWS
) -> tuple[list[SimulationWindows], float]:
    """Windows of all pieces, one set a rate, and the share of the recordings that they cover.

    Initial states come from positions below `EDGE` bands of `hertz`; what is too near to a piece's end to be filtered is left out.
    """
    starts, total = [], 0.0
    for k, piece in enumerate(pieces):
        band, size = piece.band(hertz), _size(piece, horizon)
        starts += [
            (k, begin) for begin in range(band.margin, len(piece) - band.margin - size, size)
        ]
        total += len(piece) / piece.rate
    if not starts:
        return [], 0.0
    chosen = [
        starts[i]
        for i in np.unique(np.linspace(0, len(starts) - 1, min(most, len(starts))).astype(int))
    ]
    groups: dict[float, list[SimulationWindows]] = {}
    for k, piece in enumerate(pieces):
        if own := [begin for which, begin in chosen if which == k]:
            groups.setdefault(piece.rate, []).append(_windows(piece, own, hertz, horizon))
    return [_joined(group) for group in groups.values()], len(chosen) * horizon / total


def _size(piece: Segment, horizon: float) -> int:
    return max(2, round(horizon * piece.rate))


def _windows(piece: Segment, begins: list[int], hertz: float, horizon: float) -> SimulationWindows:
    band = piece.band(hertz)
    states = np.concatenate(
        [band.low(piece.q, Grid.RECORDED, order, reach=FRICTION_BANDWIDTH_RATIO) for order in range(2)], axis=1
    )
    size = _size(piece, horizon)
    every = max(1, size // SAMPLES)
    index = np.asarray(begins)[:, None] + np.arange(size // every * every + 1)
    return SimulationWindows(
        states[begins], piece.torque[index], piece.q[index[:, ::every]], every, piece.rate
    )


def _joined(parts: Sequence[SimulationWindows]) -> SimulationWindows:
    states, torque, q = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("states", "torque", "q")
    )
    return SimulationWindows(states, torque, q, parts[0].every, parts[0].rate)


def widen_friction(model: IdentificationModel, psi: Array, groups: Sequence[SimulationWindows]) -> IdentificationModel:
    """The model with friction as wide as the steps of integration need it."""
    widths, n = model.widths, model.robot.n
    for windows in groups:
        body = forward_dynamics.build_dynamics(model, psi)
        widths = np.maximum(
            widths,
            forward_dynamics.stable_friction_widths(
                body, windows.states[:, :n], 1.0 / (windows.rate * windows.steps)
            ),
        )
    return forward_dynamics.with_widths(model, widths)


def compute_simulation_error(
    model: IdentificationModel, psi: Array, nominal: Array, groups: Sequence[SimulationWindows], share: float = 1.0
) -> SimulationError:
    """How well ψ and, to compare, nominal parameters foresee positions, from the filtered initial states. psi, nominal: Shape (P,).

    share: as `cut` found it. Raises UnusableInput where there is no window.
    """
    if not groups:
        raise UnusableInput(
            "simulation: no recording is as long as one window and the ends a filter spoils; take a shorter horizon"
        )
    own = widen_friction(model, psi, groups)
    lags = np.unique(np.concatenate([np.round(g.lag[1:], 9) for g in groups]))
    found = []
    for one in (psi, nominal):
        body = forward_dynamics.build_dynamics(widen_friction(own, one, groups), one)
        parts = [
            (g.lag[1:], np.clip(simulate_positions(body, g, g.states) - g.q, -LOST_DISTANCE, LOST_DISTANCE)[:, 1:])
            for g in groups
        ]
        square = np.array(
            [
                [np.interp(lags, lag, np.mean(e[:, :, j] ** 2, axis=0)) for j in range(e.shape[2])]
                for lag, e in parts
            ]
        )
        weights = np.array([len(g) for g in groups], float)
        found.append(np.sqrt(np.einsum("g,gjs->sj", weights / weights.sum(), square)))
    return SimulationError(lags, found[0], found[1], sum(map(len, groups)), share)


def simulate_positions(body: RobotDynamics, windows: SimulationWindows, states: Array) -> Array:
    """Positions that forward dynamics foresees from given states. Shape (W, S + 1, n); inf after a window is lost."""
    n = states.shape[1] // 2
    x, out = states.copy(), np.full(windows.q.shape, np.inf)
    alive, last = np.ones(len(x), bool), 0
    for at, h, torque in _march(windows):
        last = last if at is None else at
        alive &= (np.abs(x[:, :n] - windows.q[:, last]).max(axis=1) < LOST_DISTANCE) & (
            h * np.abs(x[:, n:]).max(axis=1) < LOST_DISTANCE
        )
        x[~alive] = states[~alive]  # any state will do
        if at is not None:
            out[alive, at] = x[alive, :n]
        if torque is None:
            break
        k1 = _rate(body, x, torque[0])
        k2 = _rate(body, x + 0.5 * h * k1, torque[1])
        k3 = _rate(body, x + 0.5 * h * k2, torque[1])
        k4 = _rate(body, x + h * k3, torque[2])
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return out


def simulate_sensitivities(body: RobotDynamics, windows: SimulationWindows, states: Array) -> tuple[Array, Array]:
    """The same with derivatives by the initial state and by θ. Shapes (W, S + 1, n), (W, S + 1, n, 2n + p)."""
    W, n = len(states), states.shape[1] // 2
    p = body.model.base.count
    x, X = states.copy(), np.zeros((W, 2 * n, 2 * n + p))
    X[:, range(2 * n), range(2 * n)] = 1.0
    out, slopes = np.empty(windows.q.shape), np.empty((*windows.q.shape, 2 * n + p))
    for at, h, torque in _march(windows):
        if at is not None:
            out[:, at], slopes[:, at] = x[:, :n], X[:, :n]
        if torque is None:
            break
        k1, K1 = _rates(body, x, X, torque[0])
        k2, K2 = _rates(body, x + 0.5 * h * k1, X + 0.5 * h * K1, torque[1])
        k3, K3 = _rates(body, x + 0.5 * h * k2, X + 0.5 * h * K2, torque[1])
        k4, K4 = _rates(body, x + h * k3, X + h * K3, torque[2])
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        X = X + h / 6.0 * (K1 + 2.0 * K2 + 2.0 * K3 + K4)
    return out, slopes


def _march(
    windows: SimulationWindows,
) -> Iterator[tuple[int | None, float, tuple[Array, Array, Array] | None]]:
    """Steps: which position the state before it is, if any, its length, and torque at its start, middle and end (None: the end)."""
    steps = windows.steps
    h = 1.0 / windows.rate / steps
    for k in range(windows.torque.shape[1] - 1):
        now, change = windows.torque[:, k], windows.torque[:, k + 1] - windows.torque[:, k]
        for i in range(steps):
            at = k // windows.every if k % windows.every == 0 and i == 0 else None
            a, b, c = (now + (i + part) / steps * change for part in (0.0, 0.5, 1.0))
            yield at, h, (a, b, c)
    yield windows.q.shape[1] - 1, h, None


def _rate(body: RobotDynamics, x: Array, torque: Array) -> Array:
    n = torque.shape[1]
    return np.concatenate([x[:, n:], body.acceleration(x[:, :n], x[:, n:], torque)], axis=1)


def _rates(body: RobotDynamics, x: Array, X: Array, torque: Array) -> tuple[Array, Array]:
    n = torque.shape[1]
    a, slopes = body.sensitive(x[:, :n], x[:, n:], torque)
    turned = slopes[:, :, : 2 * n] @ X
    turned[:, :, 2 * n :] += slopes[:, :, 2 * n :]
    return np.concatenate([x[:, n:], a], axis=1), np.concatenate([X[:, n:], turned], axis=1)
