"""Elasticity and backlash of a gear: dynamics of the link behind it, and torque on all joints.

The recorded position θ is the motor's, so the link's motion q = θ − δ must be simulated:
M δ̈ + ∂τ/∂q̇ δ̇ + ∂τ/∂q δ = τ_r − τ_gear, where τ_r is the torque that a rigid joint would need
along θ, τ_gear what the gear transmits, and M the link's inertia about its joint (Spong, Modeling
and control of elastic joint robots, J. Dyn. Syst. Meas. Control 109, 1987).
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from .recorded_motion import RecordedMotion

MIN_DAMPING_RATIO = 0.008
"""Smallest damping ratio that is tried: that of steel."""
MAX_DAMPING_RATIO = 0.3
"""Largest damping ratio that is tried: that of rubber."""
FREQUENCY_FACTOR = 1.06
"""Factor within which a resonance frequency is optimised jointly with its damping."""
MIN_STIFFNESS_SHARE = 0.2
"""Smallest share of a spring's stiffness that gravity leaves, which would otherwise topple it."""
MAX_OSCILLATOR_DAMPING = 0.9
"""Largest damping ratio of a simulated oscillator, of either sign."""
MIN_INITIAL_SPEED_RATIO = 0.01
"""Initial over largest motor speed from which a recording starts in motion."""
MAX_INITIAL_SPEED_RATIO = 0.5
"""Initial over largest motor speed up to which the link may still hang at rest."""
GAP_DAMPING_RATIO = 0.3
"""Damping ratio of a link inside its backlash gap, by oil and seals."""


def link_lag_torque(motion: RecordedMotion, joint: int, lag: FloatArray, of: Grid) -> FloatArray:
    """Return the torque on all joints by a link that lags behind its motor, shape (N, n, 1) [N m].

    To first order −(∂τ/∂q δ + ∂τ/∂q̇ δ̇ + M δ̈) with the lag δ = θ − q [rad], shape (M,) or (C,);
    the rotor moves with the encoder.
    """
    by_q, by_v, mass = motion.derivatives
    spectrum = motion.band.transform(lag[:, None], of)
    position, speed, acceleration = (spectrum.filter(Grid.COARSE, order, 1.0) for order in range(3))
    torque = (
        by_q[:, :, joint] * position + by_v[:, :, joint] * speed + mass[:, :, joint] * acceleration
    )
    return -motion.lowpass(torque, Grid.COARSE)[:, :, None]


def neighbouring_damping_ratios(ratio: float) -> list[float]:
    """Return half and twice a damping ratio, as far as they are within the limits."""
    return [
        ratio * factor
        for factor in (0.5, 2.0)
        if MIN_DAMPING_RATIO < ratio * factor < MAX_DAMPING_RATIO
    ]


def starts_in_motion(motion: RecordedMotion, joint: int) -> bool:
    """Return True if the motor turns when the recording starts, while the link may be at rest."""
    speed = np.abs(motion.coarse_samples.dq[:, joint])
    return bool(
        MIN_INITIAL_SPEED_RATIO * speed.max() < speed[0] < MAX_INITIAL_SPEED_RATIO * speed.max()
    )


def elastic_deflection(
    motion: RecordedMotion, joint: int, stiffness: float, ratio: float, starts_at_rest: bool
) -> FloatArray:
    """Return the elastic deflection δ of a joint at the coarse samples [rad], shape (C,).

    M δ̈ + (∂τ/∂q̇ + D) δ̇ + (∂τ/∂q + K) δ = τ_r: the load is that at the link's position, not at
    the motor's. The damping `ratio` is D / (2 √(K M)).

    Args:
        starts_at_rest: Whether the link is at rest where the recording starts with a turning
            motor (`starts_in_motion`); otherwise it moves with the motor.
    """
    by_q, by_v = (part[:, joint, joint] for part in motion.derivatives[:2])
    force, inertia = motion.rigid_torque[:, joint], motion.link_inertias[:, joint]
    damping = 2.0 * ratio * np.sqrt(stiffness * inertia.mean())
    total_stiffness = np.maximum(stiffness + by_q, MIN_STIFFNESS_SHARE * stiffness)
    start = (
        (motion.initial_torque[joint] / stiffness, motion.coarse_samples.dq[0, joint])
        if starts_at_rest and starts_in_motion(motion, joint)
        else None
    )
    return simulate_oscillator(
        force,
        inertia,
        total_stiffness,
        damping + by_v,
        1.0 / motion.band.rate_of(Grid.COARSE),
        start,
    )[0]


def simulate_oscillator(
    force: FloatArray,
    inertia: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    dt: float,
    start: tuple[float, float] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of m ẍ + d ẋ + k x = f with time-varying coefficients, (M,).

    Each step is exact for the means of f, m, k and d over the step. The start is an initial
    position and velocity; static equilibrium when None.
    """
    x, v = start or (float(force[0] / stiffness[0]), 0.0)
    force, inertia, stiffness, damping = (
        0.5 * (x[1:] + x[:-1]) for x in (force, inertia, stiffness, damping)
    )
    omega = np.sqrt(stiffness / inertia)
    ratio = np.clip(
        damping / (2.0 * omega * inertia), -MAX_OSCILLATOR_DAMPING, MAX_OSCILLATOR_DAMPING
    )
    root = np.sqrt(1.0 - ratio**2)
    damped_omega, decay = omega * root, np.exp(-ratio * omega * dt)
    cosine, sine = decay * np.cos(damped_omega * dt), decay * np.sin(damped_omega * dt)
    # transition matrix [[a, b], [c, d]] of a damped oscillator over one step
    a, b, c, d = (
        cosine + ratio / root * sine,
        sine / damped_omega,
        -sine * omega / root,
        cosine - ratio / root * sine,
    )
    equilibrium = force / stiffness
    transition = np.array([[a, b], [c, d]]).transpose(2, 0, 1)
    push = np.array([equilibrium - a * equilibrium, -c * equilibrium]).T[:, :, None]
    out = solve_linear_recursion(transition, push, np.array([[x], [v]]))
    return out[:, 0, 0], out[:, 1, 0]


def solve_linear_recursion(
    transition: FloatArray, push: FloatArray, start: FloatArray
) -> FloatArray:
    """Return z, shape (M + 1, m, c), of zₖ₊₁ = A(k) zₖ + b(k) by one banded triangular system.

    The transitions A have the shape (M, m, m), the pushes b (M, m, c), and the start z₀ (m, c).
    """
    from scipy.linalg.lapack import dtbtrs  # slow to import

    m, right = len(start), np.concatenate([start[None], push]).reshape(-1, start.shape[1])
    bands = np.zeros((2 * m, len(right)))
    bands[0] = 1.0
    for i in range(m):
        for j in range(m):
            bands[m + i - j, j:-m:m] = -transition[:, i, j]
    return np.asarray(dtbtrs(bands, right, uplo="L")[0]).reshape(-1, *start.shape)


def simulate_backlash_gap(push: FloatArray, dt: float, half_gap: float, omega: float) -> FloatArray:
    """Simulate a link inside its backlash gap, shape (M,): free motion with inelastic impacts.

    ẍ = a − ω² x − 2 ζ ω ẋ inside ±`half_gap`, with the acceleration a by the load, `push`, and ζ =
    `GAP_DAMPING_RATIO`; impacts at the gap boundaries are perfectly inelastic. Euler steps,
    implicit in the position: between the boundaries xₖ = b xₖ₋₁ − c xₖ₋₂ + aₖ dt².
    """
    c = 1.0 - 2.0 * GAP_DAMPING_RATIO * omega * dt
    b, threshold = 1.0 + c - (omega * dt) ** 2, omega**2 * half_gap
    leaves_high, leaves_low = np.flatnonzero(push < threshold), np.flatnonzero(push > -threshold)
    kicks, out = (push * dt**2).tolist(), np.empty(len(push))
    k, x = 0, half_gap if push[0] > 0.0 else -half_gap
    while k < len(push):
        leaves = leaves_high if x > 0.0 else leaves_low
        place = int(leaves.searchsorted(k))
        start = int(leaves[place]) if place < len(leaves) else len(push)
        out[k:start] = x  # at rest on a boundary
        flight, before = [], x
        for i in range(start, len(push)):  # most flights are of a few samples
            x, before = b * x - c * before + kicks[i], x
            if abs(x) > half_gap:
                x = half_gap if x > 0.0 else -half_gap
                flight.append(x)
                break
            flight.append(x)
        k = start + len(flight)
        out[start:k] = flight
    return out
