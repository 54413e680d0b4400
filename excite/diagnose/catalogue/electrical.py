"""Torque that is not what the drive says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..effect import Effect, Shape, alone, named, within
from ..track import Track

Array = np.ndarray


def _constant(t: Track, s: Shape) -> Array:
    return alone(t, s.place, np.ones(len(t.piece)))


def _offset(tracks: Sequence[Track]) -> Iterator[Shape]:
    for j in range(tracks[0].n):
        yield Shape("torque_offset", j, _constant, parameters=named("offset"))


def _made(t: Track, s: Shape) -> Array:
    return alone(t, s.place, t.motor[:, s.place])


def _gain(tracks: Sequence[Track]) -> Iterator[Shape]:
    """True over stated: the torque recorded is the true one over the gain."""
    for j in range(tracks[0].n):
        yield Shape("torque_gain", j, _made, parameters=lambda c: {"gain": 1.0 / (1.0 + float(c[0]))}, plausible=within(-0.7, 2.0))


def _bent(t: Track, s: Shape) -> Array:
    x = t.motor[:, s.place]
    return alone(t, s.place, x * (np.abs(x) / s.values["largest"]) ** (s.values["power"] - 1.0))


def _saturation(tracks: Sequence[Track]) -> Iterator[Shape]:
    """Recorded τ stands for a current that made less: true = τ (1 − loss (τ/τ_max)²), so recorded ≈ true + loss true³/τ_max²."""

    def told(c: Array) -> dict[str, float]:
        return {"loss": float(c[0] / (1.0 + c[0]))}

    for j in range(tracks[0].n):
        largest = max(*(float(np.abs(t.motor[:, j]).max()) for t in tracks), 1e-9)
        for power in (2.0, 3.0, 5.0):
            fixed = {"power": power, "largest": largest}
            yield Shape("torque_saturation", j, _bent, fixed, parameters=told, plausible=within(0.0, 2.0))


EFFECTS = (
    Effect(
        "torque_offset",
        "τ₀",
        _constant,
        _offset,
        {"offset": "N m"},
        "constant, whatever the motion",
        ("payload",),
        "hold a pose, reached from both sides",
        prior_only=True,
        form={"offset": 0.04},
    ),
    Effect(
        "torque_gain",
        "τ = (1 + ε) k_t i",
        _made,
        _gain,
        {"gain": "1"},
        "every term of one joint scaled",
        ("payload", "torque_saturation"),
        "two known loads",
        prior_only=True,
        form={"gain": 0.035},
    ),
    Effect(
        "torque_saturation",
        "k_t (1 − β i²)",
        _bent,
        _saturation,
        {"loss": "1"},
        "torque is missing at high current only",
        ("load_friction", "nonlinear_viscous"),
        "short bursts near the torque limit",
    ),
)
