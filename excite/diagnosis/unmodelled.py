"""How much of what is left a flexible model foresees in recordings that it was not fitted to: physics, whatever its name. Noise it cannot.

Ridge regression (Hoerl & Kennard, Technometrics 12, 1970) on one basis of features at a time, fitted to either half of the recordings
and judged on the other. Waves and bumps over place and speed tell what a joint's state says; a finite impulse response of its
acceleration or of its load tells any linear resonance, without knowing which (Ljung, System Identification, 1999, 4.2).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .residual_curves import LEAST_ROWS, MotionRows

Array = np.ndarray
HARMONICS, BUMPS, PLACES = 40, 13, 150
"""Of a turn, or of a slide's range; bumps over a joint's speeds; and narrow ones over its range."""
MEMORY, LAGS = 4.0, 250
"""How long a resonance is remembered [s], and by how many values at the most."""
FORESEEN, SURE = 0.05, 1.5
"""Share of what is left that must be foreseen in other recordings to count, and that share over its standard error: 0.036 is the most
in 90 simulated robots with nothing missing, 0.009 of one place in 60."""
RIDGES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Over the mean square of the features."""
BINS = 100
PARTS = 40
"""Steps of a response; stretches between which it is told how sure a share is."""
STEADY = 1e-9
"""Spread of features over their largest value, below which they are constant."""


@dataclass(frozen=True)
class ResidualResponse:
    """A joint's residual over what it depends on. over: what that is, with its unit. other: of which joint, where not of its own.
    y: torque, or of what goes on after a cause its share of the largest. Shapes (b,), (b,)."""

    over: str
    x: Array
    y: Array
    other: int | None = None
    relative: bool = False


@dataclass(frozen=True)
class ResidualPrediction:
    """What predicts a joint's residual best. regime: which basis of features. share: of the mean square, held out, what they foresee; of
    noise hardly above zero. sure: that share over its standard error between stretches."""

    regime: str
    share: float
    sure: float
    response: ResidualResponse

    @property
    def counts(self) -> bool:
        """Whether that is more than noise would be."""
        return self.share > FORESEEN and self.sure > SURE


def _position(rows: MotionRows, joint: int) -> Array:
    q = rows.q[:, joint]
    turn = 2.0 * np.pi * (q - q.min()) / max(np.ptp(q), 1e-12) if rows.linear[joint] else q
    waves = np.outer(turn, np.arange(1, HARMONICS + 1))
    return np.hstack([np.cos(waves), np.sin(waves)])


def _place(rows: MotionRows, joint: int) -> Array:
    """Narrow bumps over the joint's range, each its own: a broken tooth, a dent in a race."""
    q = rows.q[:, joint]
    centres = np.linspace(q.min(), q.max(), PLACES)
    width = max(float(centres[1] - centres[0]), 1e-12)
    return np.asarray(np.exp(-0.5 * np.square((q[:, None] - centres) / width)))


def _direction(rows: MotionRows, joint: int) -> Array:
    return _position(rows, joint) * rows.direction(joint)[:, None]


def _speed(rows: MotionRows, joint: int) -> Array:
    """Bumps over every joint's speed."""
    centres = np.linspace(-1.0, 1.0, BUMPS)
    over = rows.dq / np.maximum(np.abs(rows.dq).max(axis=0), 1e-12)
    return np.exp(-0.5 * np.square((over[:, :, None] - centres) * 0.5 * (BUMPS - 1))).reshape(
        len(rows), -1
    )


def _power(rows: MotionRows, joint: int) -> Array:
    """The joint's torque as it may change with what all drives draw and bear together."""
    torque, borne = rows.motor_torque[:, joint], _scaled(np.abs(rows.motor_torque))
    each = _scaled(rows.motor_torque * rows.dq)
    drawn, together = _scaled(_drawn(rows, joint)), borne.sum(axis=1) / borne.shape[1]
    of_all = np.column_stack([drawn, np.abs(drawn), drawn**2, together, together**2])
    changed = _scaled(torque)[:, None] * np.hstack([of_all, each, np.maximum(each, 0.0), borne])
    return np.hstack([changed, rows.direction(joint)[:, None] * drawn[:, None]])


def _drawn(rows: MotionRows, joint: int) -> Array:
    """Power of all drives [W]."""
    return np.asarray(np.sum(rows.motor_torque * rows.dq, axis=1))


def _scaled(x: Array) -> Array:
    """Over the largest of each column."""
    return np.asarray(x / np.maximum(np.abs(x).max(axis=0), 1e-300))


def _lag(rows: MotionRows) -> float:
    """Time between values that are remembered [s]."""
    return max(MEMORY / LAGS, 1.0 / rows.rate)


def _remembered(x: Array, rows: MotionRows) -> Array:
    """Values of the last seconds; zero before a recording begins."""
    lag = _lag(rows)
    out = np.zeros((len(rows), int(MEMORY / lag)))
    for a, b in itertools.pairwise([*rows.begins.tolist(), len(rows)]):
        time, own = rows.time[a:b], x[a:b] - x.mean()
        for k in range(out.shape[1]):
            out[a:b, k] = np.interp(time - k * lag, time, own, left=0.0)
    return out


@dataclass(frozen=True)
class FeatureBasis:
    """features: of a joint at all rows, Shape (N, k). experiment: what would show it alone. label: of what its response is drawn over.
    over: that, [rows, joint] -> (N,), None: time since. sign: by which the residual is taken there, 0 where it is not. every: features
    are of every joint, one after the other."""

    features: Callable[[MotionRows, int], Array]
    experiment: str
    label: str
    over: Callable[[MotionRows, int], Array] | None = None
    sign: Callable[[MotionRows, int], Array] = lambda rows, joint: np.ones(len(rows))
    every: bool = False


STOP = "a sharp stop, then rest: what swings on does so alone"
BASES: Mapping[str, FeatureBasis] = {
    "position": FeatureBasis(
        _position,
        "that joint alone, slowly to and fro over its range",
        "position [{}]",
        lambda rows, j: rows.q[:, j],
    ),
    "place": FeatureBasis(
        _place,
        "that joint alone, slowly past the place, both ways",
        "position [{}]",
        lambda rows, j: rows.q[:, j],
    ),
    "position and direction": FeatureBasis(
        _direction,
        "that joint alone, slowly to and fro, between ends that shift",
        "position, along the motion [{}]",
        lambda rows, j: rows.q[:, j],
        lambda rows, j: rows.direction(j),
    ),
    "speed": FeatureBasis(
        _speed,
        "constant speeds of one joint after the other",
        "speed [{}/s]",
        lambda rows, j: rows.dq[:, j],
        every=True,
    ),
    "past acceleration": FeatureBasis(
        lambda rows, j: _remembered(rows.ddq[:, j], rows), STOP, "since an acceleration [s]"
    ),
    "past load": FeatureBasis(
        lambda rows, j: _remembered(rows.load[:, j], rows), STOP, "since a load [s]"
    ),
    "power": FeatureBasis(
        _power,
        "that joint slowly, alone, then while the others move fast",
        "power of all drives, along the torque [W]",
        _drawn,
        lambda rows, j: np.sign(rows.motor_torque[:, j]),
    ),
}


def predict_residual(rows: MotionRows, halves: Sequence[Array], residual: Array, joint: int) -> ResidualPrediction:
    """What a flexible model foresees of a joint's residual, of what is sure the most. halves: rows of either, as masks.
    residual: Shape (N,)."""
    found = list[tuple[bool, float, float, float, str]]()
    for regime, basis in BASES.items():
        x = _standard(basis.features(rows, joint))[0]
        share, sure, ridge = _foreseen(
            [x[half] for half in halves], [residual[half] for half in halves]
        )
        found.append((sure > SURE, share, sure, ridge, regime))
    _, share, sure, ridge, regime = max(found)
    return ResidualPrediction(
        regime, share, sure, _response(rows, np.logical_or(*halves), residual, joint, regime, ridge)
    )


def _standard(x: Array) -> tuple[Array, Array]:
    """Columns about their means, of unit spread, and that spread; zeros where a column is constant."""
    centred = x - x.mean(axis=0)
    spread = centred.std(axis=0)
    spread[spread <= STEADY * np.abs(x).max(axis=0, initial=0.0)] = np.inf
    return centred / spread, spread


def _response(
    rows: MotionRows, moves: Array, residual: Array, joint: int, regime: str, ridge: float
) -> ResidualResponse:
    """The residual where a joint moves over what its regime says."""
    basis = BASES[regime]
    if basis.over is None:
        c, _, spread = _told(rows, basis, moves, residual, joint, ridge)
        felt = c / spread  # 0 of what is constant
        return ResidualResponse(
            basis.label,
            _lag(rows) * np.arange(len(c)),
            felt / max(float(np.abs(felt).max()), 1e-300),
            relative=True,
        )
    if basis.every:  # over the one that tells most of it
        c, x, _ = _told(rows, basis, moves, residual, joint, ridge)
        joint = int(np.argmax((x * c).reshape(len(x), rows.n, -1).sum(axis=2).var(axis=0)))
    sign = basis.sign(rows, joint)
    shown = moves & (sign != 0.0)
    curve = _binned(basis.over(rows, joint)[shown], (residual * sign)[shown])
    label = basis.label.format("m" if rows.linear[joint] else "rad")
    return ResidualResponse(label, *curve, other=joint if basis.every else None)


def _told(
    rows: MotionRows, basis: FeatureBasis, moves: Array, residual: Array, joint: int, ridge: float
) -> tuple[Array, Array, Array]:
    """Coefficients of features by all rows where a joint moves, the features there, and the spread that they are over."""
    features, spread = _standard(basis.features(rows, joint))
    x = features[moves]
    return (
        np.linalg.solve(
            x.T @ x / len(x) + ridge * np.eye(x.shape[1]), x.T @ residual[moves] / len(x)
        ),
        x,
        spread,
    )


def _binned(x: Array, y: Array) -> tuple[Array, Array]:
    """Means between equal steps of x, where there are enough rows. Shapes (b,)."""
    edges = np.linspace(x.min(), x.max(), BINS + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    count = np.bincount(place, minlength=BINS)
    enough = count >= LEAST_ROWS
    mean = np.bincount(place, y, minlength=BINS) / np.maximum(count, 1)
    return 0.5 * (edges[1:] + edges[:-1])[enough], mean[enough]


def _foreseen(features: Sequence[Array], residual: Sequence[Array]) -> tuple[float, float, float]:
    """The share of the residual's square that each half foresees of the other, how sure that is, and at which ridge it is most."""
    square = np.square(np.concatenate(residual))
    spent, at = np.zeros((len(RIDGES), len(square))), 0
    for own, other in ((1, 0), (0, 1)):
        values, vectors = np.linalg.eigh(features[own].T @ features[own] / len(features[own]))
        score = vectors.T @ (features[own].T @ residual[own]) / len(features[own])
        turned = features[other] @ vectors
        for k, ridge in enumerate(RIDGES):
            left = residual[other] - turned @ (score / (np.maximum(values, 0.0) + ridge))
            spent[k, at : at + len(left)] = np.square(left)
        at += len(residual[other])
    saved = square - spent
    best = int(np.argmax(saved.sum(axis=1)))
    parts = np.array([part.sum() for part in np.array_split(saved[best], PARTS)])
    error = max(float(parts.std() * np.sqrt(PARTS)), 1e-300)
    return float(parts.sum() / max(square.sum(), 1e-300)), float(parts.sum() / error), RIDGES[best]
