"""Changes between recordings: friction and offsets of the joint actuators.

The friction of a joint differs between sessions by lubrication, temperature and mounting. Every
recording therefore has its own Coulomb friction, viscous friction and offset of each joint,

    τ_j ← τ_j + (ΔF_c tanh(q̇/w) + ΔF_v q̇ + Δτ₀),   Δ ~ N(0, (0.5 s F)²),

with a prior of the size of the friction F itself and a scale s that the recordings determine. The
changes of the fitted recordings sum to zero, so that the base model holds their mean, by which
held-out torque is predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray
from ..effects.recorded_motion import RecordedMotion
from .blocks import BLOCK_SECONDS, sandwiched

KINDS = ("coulomb", "viscous", "offset")
"""Actuator parameters that may change, in the order of `SessionChange.change`."""
RELATIVE_CHANGE = 0.5
"""Prior standard deviation of a change over friction itself."""
SCALES = np.geomspace(0.02, 1.0, 12)
"""Scales s, as probable beforehand: changes of 1 to 50 % of the friction."""
MIN_FRICTION_SHARE = 0.01
"""Smallest friction that is assumed, over the joint's largest torque."""
WALD_THRESHOLD = 20.0
"""Wald statistic from which a change is significant; with three degrees of freedom chance exceeds
it twice in ten thousand times."""
MIN_SHARE = 0.1
"""Share of the residual's mean square that a change must explain to be reported."""


@dataclass(frozen=True)
class SessionChange:
    """Change of a joint actuator in a recording, from the mean of the fitted recordings.

    Attributes:
        source: The recording.
        joint: Index of the joint.
        change: Change of `KINDS`, shape (3,).
        covariance: Its covariance, shape (3, 3). At uniform speeds an increase of Coulomb friction
            may compensate a decrease of viscous friction.
        share: Share of the joint's mean square residual that the change explains.
    """

    source: str
    joint: int
    change: FloatArray
    covariance: FloatArray
    share: float

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each parameter, shape (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def wald(self) -> float:
        """Wald statistic of all parameters."""
        return float(self.change @ np.linalg.pinv(self.covariance) @ self.change)


def sources(motions: Sequence[RecordedMotion]) -> list[str]:
    """Return the recordings in their order."""
    return list(dict.fromkeys(motion.segment.source for motion in motions))


def actuator_columns(motion: RecordedMotion) -> FloatArray:
    """Return tanh(q̇/w), q̇ and 1 of every joint at the rows of a motion, shape (N, n, 3n)."""
    n = motion.n
    out, joints = np.zeros((len(motion), n, n, 3)), np.arange(n)
    out[:, joints, joints, 0] = motion.lowpass(np.tanh(motion.samples.dq / motion.widths))
    out[:, joints, joints, 1] = motion.for_all_fits(
        "low-passed speed", lambda: motion.lowpass(motion.samples.dq)
    )
    out[:, joints, joints, 2] = motion.for_all_fits(
        "low-passed one", lambda: motion.lowpass(np.ones((len(motion.segment), 1)))
    )
    return out.reshape(len(motion), n, 3 * n)


def columns(motion: RecordedMotion, motions: Sequence[RecordedMotion]) -> FloatArray:
    """Return the columns of session changes on one motion, shape (N, n, 3n × (recordings − 1)).

    Args:
        motion: One of the fitted motions.
        motions: All fitted motions.
    """
    names = sources(motions)
    if len(names) == 1:
        return np.zeros((len(motion), motion.n, 0))
    first = motion.segment.source == names[0]
    actuators = actuator_columns(motion)
    signs = [-1.0 if first else float(motion.segment.source == name) for name in names[1:]]
    return np.concatenate([sign * actuators for sign in signs], axis=2)


def prior_std(motions: Sequence[RecordedMotion]) -> FloatArray:
    """Return the prior standard deviation of the coefficients of `columns`."""
    return np.tile(parameter_std(motions).ravel(), len(sources(motions)) - 1)


def parameter_std(motions: Sequence[RecordedMotion]) -> FloatArray:
    """Return the prior standard deviation of `KINDS` at every joint, shape (n, 3)."""
    robot = motions[0].fitted_robot
    max_speed, max_torque = (
        np.max([np.abs(x).max(axis=0) for x in signals], axis=0)
        for signals in (
            [motion.samples.dq for motion in motions],
            [motion.torque for motion in motions],
        )
    )
    min_torque = MIN_FRICTION_SHARE * max_torque
    coulomb = np.maximum(robot.actuator_parameter("coulomb"), min_torque)
    viscous = np.maximum(
        robot.actuator_parameter("viscous"), min_torque / np.maximum(max_speed, 1e-9)
    )
    scale = np.column_stack([coulomb, viscous, coulomb])
    return np.asarray(RELATIVE_CHANGE * np.maximum(scale, 1e-12))


def changes(
    motions: Sequence[RecordedMotion], residual: FloatArray, moving: BoolArray
) -> list[SessionChange]:
    """Estimate the changes of every recording from a residual.

    Args:
        motions: Motions.
        residual: Torque that a model common to all recordings leaves, shape (N, n) [N m].
        moving: Rows that count, shape (N, n).
    """
    ends = np.cumsum([0, *(len(motion) for motion in motions)])
    prior = parameter_std(motions)
    out = []
    for source in sources(motions):
        for j in range(motions[0].n):
            blocks, power = [], 0.0
            for start, motion in zip(ends, motions, strict=False):
                if motion.segment.source != source:
                    continue
                rows = moving[start : start + len(motion), j]
                x = actuator_columns(motion)[rows, j, 3 * j : 3 * j + 3]
                y = residual[start : start + len(motion), j][rows]
                count = max(1, int((motion.time[-1] - motion.time[0]) / BLOCK_SECONDS))
                parts = np.array_split(np.arange(len(y)), count)
                blocks += [(x[part], y[part]) for part in parts if len(part)]
                power += float(y @ y)
            if len(blocks) <= 2 * len(KINDS):
                continue
            weight = np.sqrt(power / max(sum(len(y) for _, y in blocks), 1))
            solution, covariance = sandwiched(
                [*blocks, (np.diag(weight / prior[j]), np.zeros(len(KINDS)))]
            )
            after = float(sum(np.sum((y - x @ solution) ** 2) for x, y in blocks))
            covariance = covariance * len(blocks) / (len(blocks) - len(KINDS))
            share = 1.0 - after / max(power, 1e-300)
            out.append(SessionChange(source, j, solution, covariance, share))
    return out
