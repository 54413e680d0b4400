"""Torque that is not what the drive says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..effect import Effect, Shape, column, named, within
from ..track import Track

Array = np.ndarray


def _offset(tracks: Sequence[Track]) -> Iterator[Shape]:
    for j in range(tracks[0].n):
        yield Shape("torque_offset", j, column(j, lambda t, j: np.ones(len(t.piece))), named("offset"))


def _gain(tracks: Sequence[Track]) -> Iterator[Shape]:
    """True over stated: the torque recorded is the true one over the gain."""
    for j in range(tracks[0].n):
        made = column(j, lambda t, j: t.motor[:, j])
        yield Shape("torque_gain", j, made, lambda c: {"gain": 1.0 / (1.0 + float(c[0]))}, within(-0.7, 2.0))


def _saturation(tracks: Sequence[Track]) -> Iterator[Shape]:
    """Recorded τ stands for a current that made less: true = τ (1 − loss (τ/τ_max)²), so recorded ≈ true + loss true³/τ_max²."""

    def bent(t: Track, j: int, power: float, largest: float) -> Array:
        x = t.motor[:, j]
        return np.asarray(x * (np.abs(x) / largest) ** (power - 1.0))

    for j in range(tracks[0].n):
        largest = max(*(float(np.abs(t.motor[:, j]).max()) for t in tracks), 1e-9)
        for power in (2.0, 3.0, 5.0):
            loss = column(j, bent, power, largest)
            yield Shape("torque_saturation", j, loss, lambda c: {"loss": float(c[0] / (1.0 + c[0]))}, within(0.0, 2.0), {"power": power})


EFFECTS = (
    Effect(
        "torque_offset",
        "τ₀",
        _offset,
        {"offset": "N m"},
        "constant, whatever the motion",
        ("payload",),
        "hold a pose, reached from both sides",
        prior_only=True,
    ),
    Effect(
        "torque_gain",
        "τ = (1 + ε) k_t i",
        _gain,
        {"gain": "1"},
        "every term of one joint scaled",
        ("payload", "torque_saturation"),
        "two known loads",
        prior_only=True,
    ),
    Effect(
        "torque_saturation",
        "k_t (1 − β i²)",
        _saturation,
        {"loss": "1"},
        "torque is missing at high current only",
        ("load_friction", "nonlinear_viscous"),
        "short bursts near the torque limit",
    ),
)
