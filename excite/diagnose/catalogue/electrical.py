"""Torque that is not what the drive says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..effect import Effect, Shape, alone, named, within
from ..track import Track

Array = np.ndarray
FINE, GRAINY = 0.01, 3.0
"""Noise of measured torque over the torque, up to which its cube is a column; and how many times the usual gain that takes."""


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
    x = (t.drawn if s.values.get("measured") else t.motor)[:, s.place]
    return alone(t, s.place, x * (np.abs(x) / s.values["largest"]) ** (s.values["power"] - 1.0))


def _saturation(tracks: Sequence[Track]) -> Iterator[Shape]:
    """Recorded τ stands for a current that made less: true = τ (1 − loss (τ/τ_max)²), or recorded ≈ true + loss true³/τ_max².

    The first is exact, of torque as it was measured: only where that has little noise, whose square its cube has in it. The second is of
    the base model's, which a strong loss has bent.
    """

    def laws(joint: int, largest: float, measured: float) -> Iterator[Shape]:
        told = (lambda c: {"loss": float(c[0])}) if measured else (lambda c: {"loss": float(c[0] / (1.0 + c[0]))})
        for power in (2.0, 3.0, 5.0):
            fixed = {"power": power, "largest": largest} | ({"measured": measured} if measured else {})
            gate = within(0.0, 1.0 if measured else 2.0)
            law = Shape("torque_saturation", joint, _bent, fixed, parameters=told, plausible=gate)
            yield replace(law, doubt=GRAINY, grain=FINE) if measured else law

    for j in range(tracks[0].n):
        for measured in (0.0, 1.0):
            seen = (np.abs((t.drawn if measured else t.motor)[:, j]).max() for t in tracks)
            yield from laws(j, max(*(float(x) for x in seen), 1e-9), measured)


def _overdrawn(t: Track, s: Shape, c: Array, made: Array) -> Array:
    """What a drive that loses torque is recorded with beyond what it makes. Shape (M, n)."""
    out = np.zeros_like(made)
    out[:, s.place] = overdrawn(float(c[0]), s.values, made[:, s.place]) - made[:, s.place]
    return out


def overdrawn(loss: float, values: Mapping[str, float], torque: Array) -> Array:
    """What is recorded where a drive that loses as `_bent` says makes a torque: x of x − c x |x/L|^(p−1) = τ. Shape (M,)."""
    most = values["largest"]
    x = np.linspace(0.0, 2.0 * most, 4001)
    made = x - loss * x * (x / most) ** (values["power"] - 1.0)
    rising = slice(0, int(np.argmax(made)) + 1)  # a drive makes no more than that
    size = np.abs(torque)
    return np.asarray(np.sign(torque) * np.maximum(size, np.interp(size, made[rising], x[rising])))


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
        recorded=_overdrawn,
        loose=-0.2,
    ),
)
