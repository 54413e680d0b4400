"""How far a link lies behind its motor, where a spring or play is between them, and what all joints feel of it.

The motor's encoder is what was recorded, so the link's motion has to be found: M δ̈ = τ_r − (what the gear passes on), with δ = θ − q the
wind-up, τ_r the torque that would carry a rigid joint's link along θ, and M the link's own inertia (Spong 1987).
"""

from __future__ import annotations

import numpy as np

from ...identify.band import Grid
from ..track import Track

Array = np.ndarray
DAMPING = 0.07
"""Damping ratio of a link on its motor: gears have a few per cent."""
OIL = 0.3
"""Damping ratio of a link that is held in its play."""


def felt(track: Track, joint: int, lag: Array, of: Grid) -> Array:
    """Torque on all joints when a link lies `lag` behind its motor [rad, on a grid]. Shapes (M or C,) -> (N, n, 1).

    First order: −(∂τ/∂q δ + ∂τ/∂q̇ δ̇ + M δ̈), the rotor staying with the encoder.
    """
    by_q, by_v, mass = track.derivatives
    lines = track.band.transformed(lag[:, None], of)
    shift, first, second = (lines.low(Grid.COARSE, order, 1.0) for order in range(3))
    torque = by_q[:, :, joint] * shift + by_v[:, :, joint] * first + mass[:, :, joint] * second
    return -track.reduce(torque, Grid.COARSE)[:, :, None]


def mass(track: Track, joint: int) -> Array:
    """The link's own inertia about a joint, at the coarse samples. Shape (C,) [kg m²]."""
    return np.maximum(track.derivatives[2][:, joint, joint], 1e-9)


def wound(track: Track, joint: int, stiffness: float) -> Array:
    """Wind-up of a spring of `stiffness` [N m/rad], damped a little, at the coarse samples. Shape (C,)."""
    return oscillator(track.rigid[:, joint], mass(track, joint), stiffness, DAMPING, 1.0 / track.band.rate_of(Grid.COARSE))[0]


def oscillator(force: Array, inertia: Array, stiffness: float, damping: float, dt: float) -> tuple[Array, Array]:
    """Place and speed of an inertia that changes slowly, on a spring; exact for steps of constant force. Three shapes of (M,)."""
    omega = np.sqrt(stiffness / inertia)
    slow = omega * np.sqrt(1.0 - damping**2)
    decay, ratio = np.exp(-damping * omega * dt), damping / np.sqrt(1.0 - damping**2)
    cosine, sine = decay * np.cos(slow * dt), decay * np.sin(slow * dt)
    steps = zip(
        (force / stiffness).tolist(),
        (cosine + ratio * sine).tolist(),
        (sine / slow).tolist(),
        (-sine * omega * omega / slow).tolist(),
        (cosine - ratio * sine).tolist(),
        strict=True,
    )
    out, x, v = np.empty((2, len(force))), float(force[0] / stiffness), 0.0
    for k, (rest, a, b, c, d) in enumerate(steps):
        away = x - rest
        x, v = rest + a * away + b * v, c * away + d * v
        out[0, k], out[1, k] = x, v
    return out[0], out[1]


def played(track: Track, joint: int, width: float, hold: float) -> Array:
    """Where a link is in a play of `width` [rad]: driven by its load, it stops where it meets the other flank. Shape (M,).

    hold: how fast it would swing in there, for what a gear's soft first stage, oil and seals hold of it [Hz].
    """
    push = track.upsampled((track.rigid[:, joint] / mass(track, joint))[:, None])[:, 0]
    dt, half, omega = 1.0 / track.piece.rate, 0.5 * width, 2.0 * np.pi * hold
    stiff, damp = omega**2, 2.0 * OIL * omega
    out, x, v = np.empty(len(push)), half if push[0] > 0.0 else -half, 0.0
    for k, a in enumerate(push.tolist()):
        v += (a - stiff * x - damp * v) * dt
        x += v * dt
        if x > half:
            x, v = half, 0.0
        elif x < -half:
            x, v = -half, 0.0
        out[k] = x
    return out
