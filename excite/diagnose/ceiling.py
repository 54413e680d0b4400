"""How much of what is left a flexible model foresees in recordings that it was not fitted to: physics, whatever its name. Noise it cannot.

Ridge regression (Hoerl & Kennard, Technometrics 12, 1970) on one kind of features at a time, fitted to either half of the recordings
and judged on the other. Bumps over place and speed tell what a joint's state says; a finite impulse response of its acceleration or of its
load tells any linear resonance, without knowing which (Ljung, System Identification, 1999, 4.2).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .looks import Rows

Array = np.ndarray
HARMONICS, BUMPS = 40, 13
"""Of a turn, or of a slide's range; and bumps over a joint's speeds."""
MEMORY, LAGS = 4.0, 250
"""How long a resonance is remembered [s], and by how many values at the most."""
RIDGES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Over the mean square of the features."""
PARTS = 40
"""Stretches between which it is told how sure a share is."""


@dataclass(frozen=True)
class Sight:
    """What predicts a joint's residual best. regime: which kind of features. share: of the mean square, held out, what they foresee; not
    above zero for noise. sure: that share over its standard error between stretches."""

    regime: str
    share: float
    sure: float


def _position(rows: Rows, joint: int) -> Array:
    q = rows.q[:, joint]
    turn = 2.0 * np.pi * (q - q.min()) / max(np.ptp(q), 1e-12) if rows.linear[joint] else q
    waves = np.outer(turn, np.arange(1, HARMONICS + 1))
    return np.hstack([np.cos(waves), np.sin(waves)])


def _direction(rows: Rows, joint: int) -> Array:
    return _position(rows, joint) * rows.direction(joint)[:, None]


def _speed(rows: Rows, joint: int) -> Array:
    """Bumps over every joint's speed."""
    centres = np.linspace(-1.0, 1.0, BUMPS)
    over = rows.dq / np.maximum(np.abs(rows.dq).max(axis=0), 1e-12)
    return np.exp(-0.5 * np.square((over[:, :, None] - centres) * 0.5 * (BUMPS - 1))).reshape(len(rows), -1)


def _power(rows: Rows, joint: int) -> Array:
    """The joint's torque as it may change with what all drives draw and bear together."""
    torque = rows.motor[:, joint]
    each = rows.motor * rows.dq
    drawn, borne = each.sum(axis=1), np.abs(rows.motor / np.maximum(np.abs(rows.motor).max(axis=0), 1e-12))
    together = borne.sum(axis=1)
    of_all = np.column_stack([drawn, np.abs(drawn), drawn**2, together, together**2])
    scaled = torque[:, None] * np.hstack([of_all, each, np.maximum(each, 0.0), borne])
    return np.hstack([scaled, rows.direction(joint)[:, None] * drawn[:, None]])


def _remembered(x: Array, rows: Rows) -> Array:
    """Values of the last seconds; zero before a recording begins."""
    step = max(1, int(np.ceil(MEMORY * rows.rate / LAGS)))
    count = int(MEMORY * rows.rate / step)
    starts = [0, *(np.flatnonzero(np.diff(rows.time) > 1.5 / rows.rate) + 1).tolist(), len(rows)]
    out = np.zeros((len(rows), count))
    for a, b in itertools.pairwise(starts):
        own = x[a:b] - x.mean()
        for k in range(count):
            out[a + k * step : b, k] = own[: max(b - a - k * step, 0)]
    return out


KINDS: Mapping[str, Callable[[Rows, int], Array]] = {
    "position": _position,
    "position and direction": _direction,
    "speed": _speed,
    "past acceleration": lambda rows, joint: _remembered(rows.ddq[:, joint], rows),
    "past load": lambda rows, joint: _remembered(rows.load[:, joint], rows),
    "power": _power,
}


def seen(rows: Rows, halves: Sequence[Array], residual: Array, joint: int) -> Sight:
    """What a flexible model foresees of a joint's residual. halves: which rows either has, as masks. residual: Shapes (N,)."""
    found = []
    for regime, features in KINDS.items():
        x = features(rows, joint)
        x -= x.mean(axis=0)
        spread = x.std(axis=0)
        x /= np.maximum(spread, 1e-3 * spread.max() + 1e-300)
        found.append(Sight(regime, *_foreseen([x[half] for half in halves], [residual[half] for half in halves])))
    return max(found, key=lambda one: one.share)


def _foreseen(features: Sequence[Array], residual: Sequence[Array]) -> tuple[float, float]:
    """The share of the residual's square that each half foresees of the other, at the ridge where that is most; and how sure that is."""
    square = np.square(np.concatenate(residual))
    spent = np.zeros((len(RIDGES), len(square)))
    at = 0
    for own, other in ((1, 0), (0, 1)):
        values, vectors = np.linalg.eigh(features[own].T @ features[own] / len(features[own]))
        score = vectors.T @ (features[own].T @ residual[own]) / len(features[own])
        turned = features[other] @ vectors
        for k, ridge in enumerate(RIDGES):
            left = residual[other] - turned @ (score / (np.maximum(values, 0.0) + ridge))
            spent[k, at : at + len(left)] = np.square(left)
        at += len(residual[other])
    saved = max(square - spent, key=np.sum)
    parts = np.array([part.sum() for part in np.array_split(saved, PARTS)])
    error = parts.std() * np.sqrt(PARTS)
    return float(saved.sum() / max(square.sum(), 1e-300)), float(saved.sum() / max(error, 1e-300))
