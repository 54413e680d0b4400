"""How far a link lies behind its motor, where a spring or play is between them, and what all joints feel of it.

The motor's encoder is what was recorded, so the link's motion has to be found: M δ̈ = τ_r − (what the gear passes on), with δ = θ − q the
wind-up, τ_r the torque that would carry a rigid joint's link along θ, and M the link's own inertia (Spong 1987).
"""

from __future__ import annotations

import numpy as np

from ...identify.band import Grid
from ..track import Track

Array = np.ndarray
LEAST_DAMPED, MOST_DAMPED = 0.008, 0.3
SOFTEST, STEADIEST = 0.2, 0.9
"""Of a spring, what may be left of it beside gravity; and the largest damping ratio, of either sign."""
LAUNCHED = 0.01
"""Of its largest speed, from which a motor turns already."""
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


def damped(ratio: float) -> list[float]:
    """Damping ratios that are tried beside one: twice and half of it, between those of steel and of rubber."""
    return [ratio * by for by in (0.5, 2.0) if LEAST_DAMPED < ratio * by < MOST_DAMPED]


def launched(track: Track, joint: int) -> bool:
    """Whether a recording begins with a motor that turns already: the link may have been at rest, or have turned with it."""
    speed = np.abs(track.coarse.dq[:, joint])
    return bool(speed[0] > LAUNCHED * speed.max())


def wound(track: Track, joint: int, stiffness: float, ratio: float, rests: bool) -> Array:
    """Wind-up of a spring of `stiffness` [N m/rad] and a damping ratio, at the coarse samples. Shape (C,).

    M δ̈ + (∂τ/∂q̇ + D) δ̇ + (∂τ/∂q + K) δ = τ_r: the link's load is not quite what it would be where its motor is. rests: whether the link
    hung still when the recording began, however its motor turned; else it turned with it.
    """
    by_q, by_v = (part[:, joint, joint] for part in track.derivatives[:2])
    force, inertia = track.rigid[:, joint], mass(track, joint)
    damping = 2.0 * ratio * np.sqrt(stiffness * inertia.mean())
    stiff = np.maximum(stiffness + by_q, SOFTEST * stiffness)
    start = (track.held[joint] / stiff[0], track.coarse.dq[0, joint]) if rests else (force[0] / stiff[0], 0.0)
    return oscillator(force, inertia, stiff, damping + by_v, 1.0 / track.band.rate_of(Grid.COARSE), start)[0]


def oscillator(
    force: Array, inertia: Array, stiffness: Array, damping: Array, dt: float, start: tuple[float, float]
) -> tuple[Array, Array]:
    """Place and speed of an inertia on a spring and a damper that change slowly, from a place and speed; each step is exact for the mean
    of the forces at its ends. Shapes (M,)."""
    omega = np.sqrt(stiffness / inertia)
    ratio = np.clip(damping / (2.0 * omega * inertia), -STEADIEST, STEADIEST)
    root = np.sqrt(1.0 - ratio**2)
    slow, decay = omega * root, np.exp(-ratio * omega * dt)
    cosine, sine = decay * np.cos(slow * dt), decay * np.sin(slow * dt)
    steps = zip(
        (0.5 * (force[1:] + force[:-1]) / stiffness[1:]).tolist(),
        (cosine + ratio / root * sine)[1:].tolist(),
        (sine / slow)[1:].tolist(),
        (-sine * omega / root)[1:].tolist(),
        (cosine - ratio / root * sine)[1:].tolist(),
        strict=True,
    )
    x, v = start
    out = np.empty((2, len(force)))
    out[:, 0] = start
    for k, (rest, a, b, c, d) in enumerate(steps, start=1):
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
