"""State of presliding friction along a sampled periodic motion, with its exact gradient.

Between two samples a joint either keeps its direction or reverses once, at the extremum of the
cubic through both positions and velocities (Hermite). Over a travel Δ the state of Dahl's model
becomes s + (z − s) exp(−|Δ|/r), s = sgn Δ (Dahl 1968). The state is that of the second period, when
the transient from z = 0 has decayed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray


@dataclass(frozen=True)
class PreslidingState:
    """State of Dahl's model along a periodic motion and what its gradient needs.

    Attributes:
        z: State at each sample. Shape (N,).
        slope: ∂z′/∂z of each of the 4N steps over two periods. Shape (4N,).
        by_travel: ∂z′/∂Δ of each step. Shape (4N,).
        reverses: Intervals within which the joint reverses. Shape (N,).
        place: Time of the reversal over that between two samples [1]. Shape (N,).
        step: Time between samples [s].
    """

    z: FloatArray
    slope: FloatArray
    by_travel: FloatArray
    reverses: BoolArray
    place: FloatArray
    step: float

    def gradients(self, seed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the gradients of Σ seed·z with respect to position and velocity.

        Args:
            seed: Gradient with respect to z. Shape (N,).

        Returns:
            Gradients by q and by q̇. Shapes (N,).
        """
        count = len(self.z)
        by_travel, carried = np.zeros((2, count, 2)), 0.0
        slope, direct = self.slope.tolist(), self.by_travel.tolist()
        seeds = seed.tolist()
        flat = by_travel.reshape(-1)
        # z at sample k of the second period is the state before its step 2 (N + k)
        for step in range(len(slope) - 1, -1, -1):
            flat[step] = carried * direct[step]
            carried *= slope[step]
            if step % 2 == 0 and step >= 2 * count:
                carried += seeds[step // 2 - count]
        first, second = by_travel.sum(axis=0).T
        by_q, by_dq = np.zeros(count), np.zeros(count)
        # travels: extremum − qₖ and qₖ₊₁ − extremum; without a reversal qₖ₊₁ − qₖ and 0
        by_extremum = np.where(self.reverses, first - second, 0.0)
        h00, h10, h01, h11 = _hermite(self.place)
        by_q += h00 * by_extremum - first
        by_q += np.roll(h01 * by_extremum + np.where(self.reverses, second, first), 1)
        by_dq += self.step * h10 * by_extremum
        by_dq += np.roll(self.step * h11 * by_extremum, 1)
        return by_q, by_dq


def _hermite(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the cubic Hermite basis at s between 0 and 1: of q₀, q̇₀Δt, q₁ and q̇₁Δt."""
    return (
        (1.0 + 2.0 * s) * (1.0 - s) ** 2,
        s * (1.0 - s) ** 2,
        s**2 * (3.0 - 2.0 * s),
        s**2 * (s - 1.0),
    )


def _extremum_place(travel: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    """Return the place s of the extremum of a cubic whose slopes v and w at 0 and 1 differ in sign.

    Args:
        travel: q₁ − q₀.
        v: q̇₀Δt.
        w: q̇₁Δt.
    """
    a, b = 3.0 * (v + w - 2.0 * travel), 2.0 * (3.0 * travel - 2.0 * v - w)
    root = np.sqrt(np.maximum(b**2 - 4.0 * a * v, 0.0))
    half = -0.5 * (b + np.where(b < 0.0, -root, root))
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = half / a, v / half
    inside = (first >= 0.0) & (first <= 1.0)
    return np.asarray(np.where(inside, first, np.nan_to_num(second)))


def presliding_state(q: FloatArray, dq: FloatArray, step: float, reach: float) -> PreslidingState:
    """Compute the state of Dahl's model along a periodic motion.

    Args:
        q: Positions over one period. Shape (N,) [rad or m].
        dq: Velocities. Shape (N,) [rad/s or m/s].
        step: Time between samples [s].
        reach: Travel r of the model [rad or m].

    Returns:
        The state, −1 to 1.
    """
    w = np.roll(dq, -1)
    reverses = dq * w < 0.0
    total = np.roll(q, -1) - q
    place = np.where(reverses, _extremum_place(total, step * dq, step * w), 0.0)
    _, h10, h01, h11 = _hermite(place)
    first = np.where(reverses, h01 * total + step * (h10 * dq + h11 * w), total)
    second = total - first
    travels = np.tile(np.column_stack([first, second]).ravel(), 2)
    signs, decays = np.sign(travels), np.exp(-np.abs(travels) / reach)
    states, state = [], 0.0
    slope, by_travel = np.empty(len(travels)), np.empty(len(travels))
    for k, (sign, decay) in enumerate(zip(signs.tolist(), decays.tolist(), strict=True)):
        states.append(state)
        slope[k] = decay
        by_travel[k] = (sign - state) * decay * sign / reach
        state = sign + (state - sign) * decay
    z = np.array(states[2 * len(q) :: 2])
    return PreslidingState(z, slope, by_travel, reverses, place, step)
