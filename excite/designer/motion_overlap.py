"""How much of the same ground two motions cover, and its slopes: what keeps a validation motion away from the first.

A joint's state is its place and speed, z = (q, q̇). With a kernel k of such states, S_ab the mean of k over all pairs of
a state of motion a and one of motion b, and over the joints,

    ρ = S₁₂ / √(S₁₁ S₂₂)    (cosine of two kernel mean embeddings; Gretton et al., JMLR 13, 2012)

lies in [0, 1], is 1 for a motion and itself, and knows neither phase nor period nor how often a motion is sampled. If what
a model leaves out of a joint's torque were a random function of that joint's state with covariance k, then ρ would be the
correlation of its means along the two motions: it says how far an error that a fit on one motion has swallowed returns
in the other.

The kernel is taken joint by joint, not on the state of the whole arm. There, any two motions of six joints are far apart,
and turning a joint that no torque depends on (the base's) is enough to make them so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.fourier import FourierSeries

Array = np.ndarray
KERNEL_WIDTH = 0.25
"""Width h of the kernel in scaled states: a motion sweeps about ±0.6 of range and speed, so five widths each way tell
its corners apart, and samples 20 to a harmonic (0.06 apart) still fill the curve between them."""
OVERLAP_WEIGHT = 0.5
"""What the optimiser pays for ρ, in nats of the criterion's logarithm. Over the built-in robots and three seeds each, ρ falls
from 0.67 for a mere other start to 0.41 and the standard deviation the second motion predicts rises by 2 %; twice the
weight gives 0.35 and 4 % (scripts/choices.py)."""
MAX_COMPARED_SAMPLES = 60
"""Samples of a motion that are compared, at most: the pairs are as many as this squared."""


@dataclass(frozen=True)
class StateScaling:
    """Measures the states of a robot's joints so that they compare.

    turns: which joints come back to the same pose after a turn. Shape (n,).
    reach: half of each position range, at most π [rad or m]. speed: velocity limits [rad/s or m/s]. Shape (n,).
    """

    is_revolute: Array
    position_scale: Array
    velocity_scale: Array

    @staticmethod
    def of(robot: Robot, limits: Limits) -> StateScaling:
        """The gauge of a robot under its limits."""
        turns = np.array([entry.kind != "prismatic" for entry in robot.entries])
        return StateScaling(
            turns,
            np.minimum(0.5 * (limits.position[:, 1] - limits.position[:, 0]), np.pi),
            limits.velocity,
        )

    def states(self, q: Array, dq: Array) -> Array:
        """Points whose distances the kernel sees: (cos q, sin q)/reach or (q, 0)/reach, and speed. (N, n) -> (n, N, 3)."""
        place = np.where(self.is_revolute, np.cos(q), q), np.where(self.is_revolute, np.sin(q), 0.0)
        return np.stack(
            [place[0] / self.position_scale, place[1] / self.position_scale, dq / self.velocity_scale], axis=-1
        ).swapaxes(0, 1)

    def pull_back(self, q: Array, slope: Array) -> tuple[Array, Array]:
        """Slopes by states as slopes by q and q̇. (N, n), (n, N, 3) -> (N, n) twice."""
        x, y, v = slope.swapaxes(0, 1).transpose(2, 0, 1)
        turned = y * np.cos(q) - x * np.sin(q)
        return np.where(self.is_revolute, turned, x) / self.position_scale, v / self.velocity_scale


@dataclass(frozen=True)
class OverlapPenalty:
    """A motion that another should keep apart from. states: its own, Shape (n, M, 3). itself: S₁₁. weight: in nats."""

    gauge: StateScaling
    states: Array
    itself: float
    weight: float = OVERLAP_WEIGHT

    def overlap(self, q: Array, dq: Array) -> tuple[float, Array, Array]:
        """ρ with a motion sampled over whole periods, and its slopes by q and q̇. Shapes (N, n) -> (), (N, n), (N, n)."""
        every = -(-len(q) // MAX_COMPARED_SAMPLES)
        at = slice(None, None, every)
        states = self.gauge.states(q[at], dq[at])
        both, both_slope = _mean(self.states, states)
        own, own_slope = _mean(states, states)
        value = both / np.sqrt(self.itself * own)
        # a state of the second motion stands on both sides of S₂₂: twice the slope, times −½ of the root
        slope = both_slope / np.sqrt(self.itself * own) - value / own * own_slope
        by_q, by_dq = np.zeros_like(q), np.zeros_like(q)
        by_q[at], by_dq[at] = self.gauge.pull_back(q[at], slope)
        return float(value), by_q, by_dq


def penalise_overlap(gauge: StateScaling, motion: FourierSeries, weight: float = OVERLAP_WEIGHT) -> OverlapPenalty:
    """What keeps another motion apart from this one."""
    t = motion.grid(MAX_COMPARED_SAMPLES)
    states = gauge.states(motion.at(t), motion.at(t, 1))
    return OverlapPenalty(gauge, states, _mean(states, states)[0], weight)


def compute_overlap(gauge: StateScaling, first: FourierSeries, second: FourierSeries) -> float:
    """ρ of two motions, in [0, 1]."""
    t = second.grid(MAX_COMPARED_SAMPLES)
    return penalise_overlap(gauge, first).overlap(second.at(t), second.at(t, 1))[0]


def _mean(a: Array, b: Array) -> tuple[float, Array]:
    """S_ab and its slope by b. Shapes (n, M, 3), (n, N, 3) -> (), (n, N, 3).

    The kernel is ½ exp(−|z−z'|²/2h²) and the same with the speed of z reversed: a place passed the other way counts as
    visited, since a motion run backwards asks rigid bodies for the same torque.
    """
    value, slope = 0.0, np.zeros_like(b)
    squares = 0.5 * np.sum(b * b, axis=-1)[:, None, :] + 0.5 * np.sum(a * a, axis=-1)[:, :, None]
    for mirror in (1.0, -1.0):
        seen = a * (1.0, 1.0, mirror)
        kernel = np.exp((seen @ b.swapaxes(1, 2) - squares) / KERNEL_WIDTH**2)
        value += float(kernel.sum())
        slope += kernel.swapaxes(1, 2) @ seen - kernel.sum(axis=1)[:, :, None] * b
    pairs = 2.0 * a.shape[0] * a.shape[1] * b.shape[1]
    return value / pairs, slope / (pairs * KERNEL_WIDTH**2)
