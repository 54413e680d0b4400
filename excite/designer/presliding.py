"""State of presliding friction along a sampled periodic motion, with its exact gradient.

Between two samples a joint either keeps its direction or reverses once, with constant acceleration
a = Δq̇/Δt: it then travels −q̇ₖ²/(2a) to the reversal and q̇ₖ₊₁²/(2a) after it. Over a travel Δ the
state of Dahl's model becomes s + (z − s) exp(−|Δ|/r), s = sgn Δ (Dahl 1968), that of a Maxwell-slip
element clip(z + Δ/r, −1, 1) (Iwan 1966). The state is that of the second period, when the
transient from z = 0 has decayed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray


@dataclass(frozen=True)
class PreslidingState:
    """State of a friction element along a periodic motion and what its gradient needs.

    Attributes:
        z: State at each sample. Shape (N,).
        slope: ∂z′/∂z of each of the 4N steps over two periods. Shape (4N,).
        by_travel: ∂z′/∂Δ of each step. Shape (4N,).
        acceleration: a of each interval. Shape (N,) [rad/s²].
        reverses: Intervals within which the joint reverses. Shape (N,).
        dq: Velocity. Shape (N,) [rad/s].
        step: Time between samples [s].
    """

    z: FloatArray
    slope: FloatArray
    by_travel: FloatArray
    acceleration: FloatArray
    reverses: BoolArray
    dq: FloatArray
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
        plain = ~self.reverses
        by_q -= np.where(plain, first, 0.0)
        by_q += np.roll(np.where(plain, first, 0.0), 1)
        a, v = self.acceleration, self.dq
        w = np.roll(v, -1)
        by_v = np.where(self.reverses, -first * v / a, 0.0)
        by_w = np.where(self.reverses, second * w / a, 0.0)
        by_a = np.where(self.reverses, (first * v**2 - second * w**2) / (2.0 * a**2), 0.0)
        by_dq += by_v - by_a / self.step
        by_dq += np.roll(by_w + by_a / self.step, 1)
        return by_q, by_dq


def presliding_state(
    q: FloatArray, dq: FloatArray, step: float, reach: float, *, slips: bool
) -> PreslidingState:
    """Compute the state of a friction element along a periodic motion.

    Args:
        q: Positions over one period. Shape (N,) [rad or m].
        dq: Velocities. Shape (N,) [rad/s or m/s].
        step: Time between samples [s].
        reach: Travel r of the element [rad or m].
        slips: True for a Maxwell-slip element, False for Dahl's model.

    Returns:
        The state, −1 to 1.
    """
    w = np.roll(dq, -1)
    reverses = dq * w < 0.0
    a = np.where(reverses, (w - dq) / step, 1.0)
    first = np.where(reverses, -(dq**2) / (2.0 * a), np.roll(q, -1) - q)
    second = np.where(reverses, w**2 / (2.0 * a), 0.0)
    travels = np.tile(np.column_stack([first, second]).ravel(), 2)
    signs, decays = np.sign(travels), np.exp(-np.abs(travels) / reach)
    states, state = [], 0.0
    slope, by_travel = np.empty(len(travels)), np.empty(len(travels))
    for k, (travel, sign, decay) in enumerate(
        zip(travels.tolist(), signs.tolist(), decays.tolist(), strict=True)
    ):
        states.append(state)
        if slips:
            moved = state + travel / reach
            free = -1.0 < moved < 1.0
            slope[k], by_travel[k] = float(free), free / reach
            state = min(max(moved, -1.0), 1.0)
        else:
            slope[k] = decay
            by_travel[k] = (sign - state) * decay * sign / reach
            state = sign + (state - sign) * decay
    z = np.array(states[2 * len(q) :: 2])
    return PreslidingState(z, slope, by_travel, a, reverses, dq, step)
