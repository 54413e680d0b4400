"""Clocks and encoders."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ...identify.band import Grid
from ..effect import Columns, Effect, Shape, amplitude, named, within
from ..track import Track

Array = np.ndarray


def _slope(track: Track) -> Array:
    """−τ̇ of the base model's torque, at the kept rows. Shape (N, n)."""
    return -track.band.transformed(track.motor).low(Grid.KEPT, 1)[track.kept]


def _late(joint: int | None) -> Columns:
    def build(track: Track) -> Array:
        slope = _slope(track)
        if joint is None:
            return slope[:, :, None]
        out = np.zeros((*slope.shape, 1))
        out[:, joint, 0] = slope[:, joint]
        return out

    return build


def _delay(tracks: Sequence[Track]) -> Iterator[Shape]:
    alone = tracks[0].n == 1  # the joint is the whole robot
    for joint in (*(() if alone else (None,)), *range(tracks[0].n)):
        yield Shape("delay", joint, _late(joint), named("seconds"), within(-0.05, 0.05))


def _misread(joint: int, forms: Callable[[Array], Array]) -> Columns:
    """Torque when a joint is where its encoder says less an error: −(∂τ/∂q δ + ∂τ/∂q̇ δ̇ + (M + I_a) δ̈)."""

    def build(track: Track) -> Array:
        by_q, by_v, mass = track.derivatives
        columns = []
        for shift in forms(track.coarse.q[:, joint]).T:
            line = track.band.transformed(shift, Grid.COARSE)
            first, second = line.low(Grid.COARSE, 1, 2.0), line.low(Grid.COARSE, 2, 2.0)
            torque = by_q[:, :, joint] * shift[:, None] + by_v[:, :, joint] * first[:, None] + mass[:, :, joint] * second[:, None]
            torque[:, joint] += track.body.drive("rotor_inertia")[joint] * second + track.body.drive("viscous")[joint] * first
            columns.append(-track.reduce(torque, Grid.COARSE))
        return np.stack(columns, axis=2)

    return build


def _encoder(tracks: Sequence[Track]) -> Iterator[Shape]:
    def waves(order: float) -> Callable[[Array], Array]:
        return lambda q: np.column_stack([np.cos(order * q), np.sin(order * q)])

    def small(c: Array) -> bool:
        return bool(np.hypot(c[0], c[1]) < 0.1)

    for j in range(tracks[0].n):
        for order in (1.0, 2.0, 3.0, 4.0, 8.0, 16.0):
            yield Shape("encoder_error", j, _misread(j, waves(order)), amplitude(order=order), small, {"order": order})


EFFECTS = (
    Effect(
        "delay",
        "τ(t − d) ≈ τ − d τ̇",
        _delay,
        {"seconds": "s"},
        "residual like the slope of torque",
        ("hysteresis", "elasticity", "stribeck"),
        "fast, jerky motion; the same delay on all joints is the logging's",
    ),
    Effect(
        "encoder_error",
        "q + ε cos(kq + φ)",
        _encoder,
        {"amplitude": "rad", "order": "1/turn"},
        "once or a few times a turn, growing with the square of speed",
        ("torque_ripple",),
        "constant speeds, slow and fast, over a turn",
    ),
)
