"""Overlap of two motions in joint state space, with its gradient.

The state of a joint is z = (q, q̇). With a kernel k of such states, S_ab the mean of k over all
pairs of a state of motion a and one of motion b, and over the joints, the overlap

    ρ = S₁₂ / √(S₁₁ S₂₂)    (cosine of two kernel mean embeddings; Gretton et al., JMLR 13, 2012)

lies in [0, 1], is 1 for identical motions, and does not depend on phase, period or sampling rate.
If the model error of a joint's torque were a random function of the joint's state with covariance
k, then ρ would be the correlation of its means along the two motions: it is the share of an error
absorbed by a fit to one motion that recurs in the other.

The kernel acts on each joint, not on the state of the whole arm. Any two motions of six joints are
far apart in the latter, and moving a joint that does not change any torque (the first one of an
upright arm) would be enough to separate them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.fourier import FourierSeries

KERNEL_WIDTH = 0.25
"""Width h of the kernel in scaled states [1].

A motion spans about ±0.6 of range and speed, so five widths in each direction resolve it, while
samples 20 to a harmonic (0.06 apart) still fill the curve between them.
"""

OVERLAP_WEIGHT = 0.5
"""Weight of the overlap ρ in the objective, the logarithm of the criterion [nats].

Over the built-in robots and three seeds each, ρ falls from 0.67 (another start, no penalty) to 0.41
and the standard deviation that the second motion predicts rises by 2 %; twice the weight gives 0.35
and 4 % (scripts/period_and_validation.py).
"""

MAX_COMPARED_SAMPLES = 60
"""Largest number of samples of a motion that are compared; the cost grows with its square [1]."""


@dataclass(frozen=True)
class StateScaling:
    """Units in which the states of joints are compared.

    Attributes:
        is_revolute: Joints whose pose recurs after a turn. Shape (n,).
        position_scale: Half of each position range, at most π. Shape (n,) [rad or m].
        velocity_scale: Velocity limits. Shape (n,) [rad/s or m/s].
    """

    is_revolute: BoolArray
    position_scale: FloatArray
    velocity_scale: FloatArray

    @staticmethod
    def for_robot(robot: Robot, limits: Limits) -> StateScaling:
        """Return the units of a robot under its limits."""
        is_revolute = np.array([entry.kind != "prismatic" for entry in robot.entries])
        return StateScaling(
            is_revolute,
            np.minimum(0.5 * (limits.position[:, 1] - limits.position[:, 0]), np.pi),
            limits.velocity,
        )

    def states(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return points in scaled state space.

        They are (cos q, sin q, q̇) for revolute and (q, 0, q̇) for prismatic joints, divided by the
        scales.

        Args:
            q: Positions. Shape (N, n).
            dq: Velocities. Shape (N, n).

        Returns:
            Points. Shape (n, N, 3).
        """
        coordinates = (
            np.where(self.is_revolute, np.cos(q), q),
            np.where(self.is_revolute, np.sin(q), 0.0),
        )
        return np.stack(
            [
                coordinates[0] / self.position_scale,
                coordinates[1] / self.position_scale,
                dq / self.velocity_scale,
            ],
            axis=-1,
        ).swapaxes(0, 1)

    def gradients(self, q: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Convert a gradient with respect to scaled states to gradients by q and q̇.

        Args:
            q: Positions. Shape (N, n).
            slope: Gradient with respect to the points. Shape (n, N, 3).

        Returns:
            Gradients by q and by q̇. Shape (N, n) each.
        """
        x, y, v = slope.swapaxes(0, 1).transpose(2, 0, 1)
        turned = y * np.cos(q) - x * np.sin(q)
        return np.where(self.is_revolute, turned, x) / self.position_scale, v / self.velocity_scale


@dataclass(frozen=True)
class OverlapPenalty:
    """Penalty on the overlap with a given motion.

    Attributes:
        scaling: Units of the states.
        states: Scaled states of the given motion. Shape (n, M, 3).
        self_similarity: S₁₁ of the given motion.
        weight: Weight of ρ in the objective [nats].
    """

    scaling: StateScaling
    states: FloatArray
    self_similarity: float
    weight: float = OVERLAP_WEIGHT

    def overlap(self, q: FloatArray, dq: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Evaluate the overlap with a motion that is sampled over whole periods.

        Args:
            q: Positions. Shape (N, n).
            dq: Velocities. Shape (N, n).

        Returns:
            ρ, and its gradients by q and q̇. Shape (N, n) each.
        """
        stride = -(-len(q) // MAX_COMPARED_SAMPLES)
        compared = slice(None, None, stride)
        states = self.scaling.states(q[compared], dq[compared])
        cross, cross_slope = _mean_kernel(self.states, states)
        auto, auto_slope = _mean_kernel(states, states)
        value = cross / np.sqrt(self.self_similarity * auto)
        # a state of the second motion occurs twice in S₂₂, which cancels the factor ½ of the root
        slope = cross_slope / np.sqrt(self.self_similarity * auto) - value / auto * auto_slope
        by_q, by_dq = np.zeros_like(q), np.zeros_like(q)
        by_q[compared], by_dq[compared] = self.scaling.gradients(q[compared], slope)
        return float(value), by_q, by_dq


def penalise_overlap(
    scaling: StateScaling, motion: FourierSeries, weight: float = OVERLAP_WEIGHT
) -> OverlapPenalty:
    """Return the penalty on the overlap with a motion."""
    t = motion.grid(MAX_COMPARED_SAMPLES)
    states = scaling.states(motion.at(t), motion.at(t, 1))
    return OverlapPenalty(scaling, states, _mean_kernel(states, states)[0], weight)


def compute_overlap(scaling: StateScaling, first: FourierSeries, second: FourierSeries) -> float:
    """Return the overlap ρ of two motions, between 0 and 1."""
    t = second.grid(MAX_COMPARED_SAMPLES)
    return penalise_overlap(scaling, first).overlap(second.at(t), second.at(t, 1))[0]


def _mean_kernel(a: FloatArray, b: FloatArray) -> tuple[float, FloatArray]:
    """Return S_ab and its gradient by the states of motion b.

    The kernel is ½ exp(−|z−z'|²/2h²) plus the same with the velocity of z reversed: states passed
    in the other direction count as visited, as rigid bodies need the same torque for a motion that
    runs backwards.

    Args:
        a: Scaled states of motion a. Shape (n, M, 3).
        b: Scaled states of motion b. Shape (n, N, 3).

    Returns:
        S_ab, and its gradient by `b`. Shape (n, N, 3).
    """
    value, slope = 0.0, np.zeros_like(b)
    squares = 0.5 * np.sum(b * b, axis=-1)[:, None, :] + 0.5 * np.sum(a * a, axis=-1)[:, :, None]
    for mirror in (1.0, -1.0):
        mirrored = a * (1.0, 1.0, mirror)
        kernel = np.exp((mirrored @ b.swapaxes(1, 2) - squares) / KERNEL_WIDTH**2)
        value += float(kernel.sum())
        slope += kernel.swapaxes(1, 2) @ mirrored - kernel.sum(axis=1)[:, :, None] * b
    pairs = 2.0 * a.shape[0] * a.shape[1] * b.shape[1]
    return value / pairs, slope / (pairs * KERNEL_WIDTH**2)
