"""How far a link lies behind its motor, where a spring or play is between them, and what all joints feel of it.

The motor's encoder is what was recorded, so the link's motion has to be found: M δ̈ + ∂τ/∂q̇ δ̇ + ∂τ/∂q δ = τ_r − (what the gear passes on),
with δ = θ − q the wind-up, τ_r the torque that would carry a rigid joint's link along θ, and M the link's own inertia (Spong 1987).
"""

from __future__ import annotations

import numpy as np

from ..identification.lowpass import Grid
from .recorded_motion import RecordedMotion

Array = np.ndarray
LEAST_DAMPED, MOST_DAMPED = 0.008, 0.3
"""Damping ratios that are tried, between those of steel and of rubber."""
NEAR = 1.06
"""Factor by which a frequency may turn with its damping."""
SOFTEST, STEADIEST = 0.2, 0.9
"""Of a spring, what may be left of it beside gravity; and the largest damping ratio, of either sign."""
LAUNCHED, CARRIED = 0.01, 0.5
"""Of its largest speed, from which a motor turns already, and from which it has taken its link along."""
OIL = 0.3
"""Damping ratio of a link that is held in its play."""
FLIGHT = 32
"""Samples of a free link that are looked at first."""


def felt(track: RecordedMotion, joint: int, lag: Array, of: Grid) -> Array:
    """Torque on all joints when a link lies `lag` behind its motor [rad, on a grid]. Shapes (M or C,) -> (N, n, 1).

    First order: −(∂τ/∂q δ + ∂τ/∂q̇ δ̇ + M δ̈), the rotor staying with the encoder.
    """
    by_q, by_v, mass = track.derivatives
    lines = track.band.transform(lag[:, None], of)
    shift, first, second = (lines.filter(Grid.COARSE, order, 1.0) for order in range(3))
    torque = by_q[:, :, joint] * shift + by_v[:, :, joint] * first + mass[:, :, joint] * second
    return -track.lowpass(torque, Grid.COARSE)[:, :, None]


def mass(track: RecordedMotion, joint: int) -> Array:
    """The link's own inertia about a joint, at the coarse samples. Shape (C,) [kg m²]."""
    return np.maximum(track.derivatives[2][:, joint, joint], 1e-9)


def damped(ratio: float) -> list[float]:
    """Damping ratios that are tried beside one: twice and half of it."""
    return [ratio * by for by in (0.5, 2.0) if LEAST_DAMPED < ratio * by < MOST_DAMPED]


def launched(track: RecordedMotion, joint: int) -> bool:
    """Whether a recording begins with a motor that turns already, and a link that may hang still."""
    speed = np.abs(track.coarse_samples.dq[:, joint])
    return bool(LAUNCHED * speed.max() < speed[0] < CARRIED * speed.max())


def wound(track: RecordedMotion, joint: int, stiffness: float, ratio: float, rests: bool) -> Array:
    """Wind-up of a spring of `stiffness` [N m/rad] and a damping ratio, at the coarse samples. Shape (C,).

    M δ̈ + (∂τ/∂q̇ + D) δ̇ + (∂τ/∂q + K) δ = τ_r: the link's load is not quite what it would be where its motor is. rests: whether the
    link hung still where a recording begins with a motor that turns (`launched`); else it turned with it.
    """
    by_q, by_v = (part[:, joint, joint] for part in track.derivatives[:2])
    force, inertia = track.rigid_torque[:, joint], mass(track, joint)
    damping = 2.0 * ratio * np.sqrt(stiffness * inertia.mean())
    stiff = np.maximum(stiffness + by_q, SOFTEST * stiffness)
    start = (
        (track.initial_torque[joint] / stiffness, track.coarse_samples.dq[0, joint])
        if rests and launched(track, joint)
        else None
    )
    return oscillator(
        force, inertia, stiff, damping + by_v, 1.0 / track.band.rate_of(Grid.COARSE), start
    )[0]


def oscillator(
    force: Array,
    inertia: Array,
    stiffness: Array,
    damping: Array,
    dt: float,
    start: tuple[float, float] | None = None,
) -> tuple[Array, Array]:
    """m ẍ + d ẋ + k x = f, from a place and a speed, or else from where f holds it: both at every sample. Each step is exact for the means
    of f, m, k and d at its ends. Shapes (M,)."""
    x, v = start or (float(force[0] / stiffness[0]), 0.0)
    force, inertia, stiffness, damping = (
        0.5 * (x[1:] + x[:-1]) for x in (force, inertia, stiffness, damping)
    )
    omega = np.sqrt(stiffness / inertia)
    ratio = np.clip(damping / (2.0 * omega * inertia), -STEADIEST, STEADIEST)
    root = np.sqrt(1.0 - ratio**2)
    slow, decay = omega * root, np.exp(-ratio * omega * dt)
    cosine, sine = decay * np.cos(slow * dt), decay * np.sin(slow * dt)
    a, b, c, d = (
        cosine + ratio / root * sine,
        sine / slow,
        -sine * omega / root,
        cosine - ratio / root * sine,
    )
    rest = force / stiffness
    turn, push = (
        np.array([[a, b], [c, d]]).transpose(2, 0, 1),
        np.array([rest - a * rest, -c * rest]).T[:, :, None],
    )
    out = stepped(turn, push, np.array([[x], [v]]))
    return out[:, 0, 0], out[:, 1, 0]


def stepped(turn: Array, push: Array, start: Array) -> Array:
    """zₖ₊₁ = A(k) zₖ + b(k), all steps at once: a banded triangular system. Shapes (M, m, m), (M, m, c), (m, c) -> (M + 1, m, c)."""
    from scipy.linalg.lapack import dtbtrs  # slow to import

    m, right = len(start), np.concatenate([start[None], push]).reshape(-1, start.shape[1])
    bands = np.zeros((2 * m, len(right)))
    bands[0] = 1.0
    for i in range(m):
        for j in range(m):
            bands[m + i - j, j:-m:m] = -turn[:, i, j]
    return np.asarray(dtbtrs(bands, right, uplo="L")[0]).reshape(-1, *start.shape)


def played(track: RecordedMotion, joint: int, width: float, hold: float) -> Array:
    """Where a link is in a play of `width` [rad]: driven by its load, it stops where it meets the other flank. Shape (M,).

    hold: how fast it would swing in there, for what a gear's soft first stage, oil and seals hold of it [Hz].
    """
    push = track.upsample((track.rigid_torque[:, joint] / mass(track, joint))[:, None])[:, 0]
    return between_flanks(push, 1.0 / track.segment.rate, 0.5 * width, 2.0 * np.pi * hold)


def between_flanks(push: Array, dt: float, half: float, omega: float) -> Array:
    """Where a link is between flanks at ±half, at which it stops dead: ẍ = a − ω² x − 2 ζ ω ẋ, ζ = `OIL`. Shape (M,) [rad].

    By steps (Euler, implicit in the place): free of the flanks, xₖ = b xₖ₋₁ − c xₖ₋₂ + aₖ dt². push: a [rad/s²]. dt [s], half [rad],
    omega [rad/s].
    """
    from scipy.signal import lfilter  # slow to import

    c = 1.0 - 2.0 * OIL * omega * dt
    b, count = 1.0 + c - (omega * dt) ** 2, len(push)
    leaves = (
        np.flatnonzero(push < omega**2 * half),
        np.flatnonzero(push > -(omega**2) * half),
    )  # the upper flank, the lower one
    out, x, k = np.empty(count), half if push[0] > 0.0 else -half, 0
    while k < count:
        own = leaves[0 if x > 0.0 else 1]
        place, rested = int(np.searchsorted(own, k)), k
        k = int(own[place]) if place < len(own) else count
        out[rested:k] = x
        state, size = x * np.array([b - c, -c]), FLIGHT
        while k < count:
            flies, state = lfilter([dt**2], [1.0, -b, c], push[k : k + size], zi=state)
            met = np.abs(flies) > half
            meets = int(met.argmax())
            if met[meets]:
                x = half if flies[meets] > 0.0 else -half
                out[k : k + meets], out[k + meets] = flies[:meets], x
                k += meets + 1
                break
            out[k : k + size] = flies
            k, size = k + len(flies), 4 * size
    return out
