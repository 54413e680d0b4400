"""Changes between recordings: friction and offsets of the joint actuators.

The friction of a joint differs between sessions by lubrication, temperature and mounting. Every
recording therefore has its own Coulomb friction, viscous friction and offset of each joint,

    τ_j ← τ_j + (ΔF_c tanh(q̇/w) + ΔF_v q̇ + Δτ₀),   Δ ~ N(0, (0.5 s_j F)²),

with a prior of the size of the friction F itself and a scale s_j that the recordings determine.
Joints of one robot change alike, ln s_j ~ N(ln s, SPREAD²): where nothing changes, a recording that
determines the friction of a joint badly must not move the mean that the base model holds. Torque
that nothing explains, which looks like a change at its own joint, does not loosen the others. The
base model holds the mean of the recordings, by which held-out torque is predicted. A recording that
determines a parameter badly, such as the offset of a joint that creeps in one direction, counts
less.

A change is significant by its Wald statistic W over k = 3 parameters with the sandwich covariance
of B blocks of a second. With few blocks the covariance is uncertain, too: W/k ~ F(k, B − k), which
is exact for blocks of equal columns (Hotelling, Annals of Mathematical Statistics 2, 1931).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, special

from .._types import BoolArray, FloatArray, IntArray
from ..effects.recorded_motion import Motions, RecordedMotion, for_all_fits, split_by_motion

KINDS = ("coulomb", "viscous", "offset")
"""Actuator parameters that may change, in the order of `SessionChange.change`."""
RELATIVE_CHANGE = 0.5
"""Prior standard deviation of a change over friction itself."""
SCALES = np.geomspace(0.02, 1.0, 12)
"""Scales, as probable beforehand: changes of 1 to 50 % of the friction."""
SPREAD = np.log(3.0)
"""Standard deviation of the logarithm of the scale over the joints of a robot [1]: it is 0.6 to 0.9
where recordings of the KR300 and of the LWR4 are fitted joint by joint. A term of the model."""
MIN_FRICTION_SHARE = 0.01
"""Smallest friction that is assumed, over the joint's largest torque."""
UNINFORMED = 1e-6
"""Information of a recording on a parameter that it does not show, over that of the prior [1]. Only
for the inverse of a matrix that is singular without it."""
MAX_P_VALUE = 2e-4
"""Largest p-value of a change that is significant [1]: of 100 joints and recordings, one is found
by chance in 50 diagnoses."""
FEW_BLOCKS = 2 * len(KINDS)
"""Number of blocks up to which a change that is not significant is undecided [1]: the covariance
has no more degrees of freedom than there are parameters, and W/k has no expected value or one of
at least three times that of many blocks."""
MIN_SHARE = 0.1
"""Share of the residual's mean square that a change must explain to be reported."""
BLOCK_SECONDS = 1.0
"""Length of a block [s], longer than the correlation time of a servo's noise."""


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
        blocks: Number of blocks in motion that it is estimated from.
    """

    source: str
    joint: int
    change: FloatArray
    covariance: FloatArray
    share: float
    blocks: int

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each parameter, shape (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def p_value(self) -> float:
        """Probability of a change as large by chance [1]; 1 where no blocks are left to judge."""
        k = len(KINDS)
        if self.blocks <= k:
            return 1.0
        wald = float(self.change @ np.linalg.pinv(self.covariance) @ self.change)
        return float(special.fdtrc(k, self.blocks - k, max(wald, 0.0) / k))

    @property
    def is_significant(self) -> bool:
        """True if the change is neither by chance nor small."""
        return self.p_value < MAX_P_VALUE and self.share > MIN_SHARE

    @property
    def is_undecided(self) -> bool:
        """True if the change would explain a part of the residual, but the joint moves for too
        short a time to tell it from chance."""
        is_small = self.share <= MIN_SHARE
        return self.blocks <= FEW_BLOCKS and not is_small and not self.is_significant


def sources(motions: Motions) -> list[str]:
    """Return the recordings in their order."""
    return list(dict.fromkeys(motion.segment.source for motion in motions))


@for_all_fits
def _speed_and_unit(motion: RecordedMotion) -> tuple[FloatArray, FloatArray]:
    """Low-passed q̇ and 1 at the rows of a motion, shapes (N, n) and (N, 1)."""
    return motion.lowpass(motion.samples.dq), motion.lowpass(np.ones((len(motion.segment), 1)))


def actuator_columns(motion: RecordedMotion) -> FloatArray:
    """Return tanh(q̇/w), q̇ and 1 of every joint at the rows of a motion, shape (N, n, 3)."""
    speed, unit = _speed_and_unit(motion)
    return np.stack([motion.coulomb_columns, speed, np.broadcast_to(unit, speed.shape)], axis=2)


def weights_in_mean(motions: Motions, scale: FloatArray, error: FloatArray) -> FloatArray:
    """Return the weight of each recording in the mean of `KINDS`, shape (recordings, n, 3).

    It is 1 / (σ² + e²/q), with the prior σ of a change, the residual e, and the mean square q of
    the parameter's column in the recording next to the others of the joint: as if all rows of a
    recording had the same error, since that of a model is not independent from row to row.

    Args:
        scale: Scale of the changes of each joint, shape (n,).
        error: RMS residual of each joint, shape (n,) [N m].
    """
    std = scale[:, None] * parameter_std(motions)
    names, eye = sources(motions), np.eye(len(KINDS))
    if len(names) == 1:
        return np.ones((1, *std.shape))
    square, rows = np.zeros((len(names), *std.shape, len(KINDS))), np.zeros((len(names), len(std)))
    for motion in motions:
        source, actuator = names.index(motion.segment.source), actuator_columns(motion)
        square[source] += np.einsum("tj,tja,tjb->jab", motion.moving, actuator, actuator)
        rows[source] += motion.moving.sum(axis=0)
    precision = square / np.maximum(rows, 1.0)[:, :, None, None] / error[:, None, None] ** 2
    covariance = np.linalg.inv(precision + eye * (UNINFORMED / std**2)[:, :, None])
    weights = 1.0 / (std**2 + np.diagonal(covariance, axis1=2, axis2=3))
    return np.asarray(weights / weights.sum(axis=0))


def columns(motions: Motions, weights: FloatArray) -> list[FloatArray]:
    """Return the columns of the changes, shapes (N, n, 3n × (recordings − 1)).

    A change of recording r acts by the columns there, less its weight (of `weights_in_mean`) times
    those of all recordings. Equal changes of all recordings are none: the coefficients are
    orthonormal contrasts, which have the prior of the changes.
    """
    names, n = sources(motions), motions[0].n
    if len(names) == 1:
        return [np.zeros((len(motion), n, 0)) for motion in motions]
    joint, contrasts, out = np.arange(n), linalg.helmert(len(names)), []
    for motion in motions:
        present = np.equal(names, motion.segment.source)[:, None, None]
        changed = np.tensordot(contrasts, present - weights, 1)
        part = np.zeros((len(motion), n, len(contrasts), n, len(KINDS)))
        part[:, joint, :, joint] = np.einsum("tja,rja->jtra", actuator_columns(motion), changed)
        out.append(part.reshape(len(motion), n, -1))
    return out


def prior_std(motions: Motions, scale: FloatArray) -> FloatArray:
    """Return the prior standard deviation of the coefficients of `columns`; `scale` is (n,)."""
    of_joint = scale[:, None] * parameter_std(motions)
    return np.tile(of_joint.ravel(), len(sources(motions)) - 1)


def scale_of_joints(log_evidence: FloatArray) -> FloatArray:
    """Return the scale of every joint, shape (n,): the root of its mean square given the data.

    `log_evidence` is that of each of `SCALES` at each joint, shape (n, S).
    """
    logs = np.log(SCALES)
    of_joint = special.log_softmax(-0.5 * ((logs[:, None] - logs) / SPREAD) ** 2, axis=1)
    given = special.logsumexp(of_joint[None] + log_evidence[:, None, :], axis=2)  # joint, common
    common = special.log_softmax(given.sum(axis=0))
    # of each joint: the common scale, given the evidence of all joints, and its own
    joint = common[None, :, None] + of_joint[None] + log_evidence[:, None, :] - given[:, :, None]
    posterior = np.exp(special.logsumexp(joint, axis=1))
    return np.asarray(np.sqrt(posterior @ SCALES**2))


def parameter_std(motions: Motions) -> FloatArray:
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


def changes(motions: Motions, residual: FloatArray, moving: BoolArray) -> list[SessionChange]:
    """Estimate the changes of every recording in which a joint moves from a residual.

    The residual (N, n) [N m] is of a model common to all recordings; `moving` rows (N, n) count.
    With no more blocks than parameters the covariance is that of the prior.
    """
    prior, out = parameter_std(motions), []
    parts = split_by_motion(residual, motions), split_by_motion(moving, motions)
    by_motion = list(zip(motions, map(actuator_columns, motions), *parts, strict=True))
    for source in sources(motions):
        of_source = [part for part in by_motion if part[0].segment.source == source]
        for j in range(motions[0].n):
            blocks, power = [], 0.0
            for motion, actuator, errors, counted in of_source:
                rows = counted[:, j]
                x, y, block = actuator[rows, j], errors[rows, j], block_numbers(motion.time)[rows]
                blocks += [(x[block == k], y[block == k]) for k in np.unique(block)]
                power += float(y @ y)
            if not blocks:
                continue
            error = float(np.sqrt(power / max(sum(len(y) for _, y in blocks), 1)))
            solution, covariance = sandwiched(blocks, prior[j], error)
            after = float(sum(np.sum((y - x @ solution) ** 2) for x, y in blocks))
            spare = len(blocks) - len(KINDS)
            covariance = covariance * len(blocks) / spare if spare > 0 else np.diag(prior[j] ** 2)
            share = 1.0 - after / max(power, 1e-300)
            out.append(SessionChange(source, j, solution, covariance, share, len(blocks)))
    return out


def block_numbers(time: FloatArray) -> IntArray:
    """Return the block of each row of a motion by its clock [s], shape (N,).

    The last block is the longest: a remainder of less than half a block belongs to it.
    """
    clock = (time - time[0]) / BLOCK_SECONDS
    return np.minimum(clock.astype(int), max(round(clock[-1]), 1) - 1)


def sandwiched(
    blocks: Sequence[tuple[FloatArray, FloatArray]],
    prior_std: FloatArray | None = None,
    error: float = 1.0,
) -> tuple[FloatArray, FloatArray]:
    """Return least-squares coefficients and their sandwich covariance A⁻¹ (Σ s sᵀ + e² P) A⁻¹.

    The blocks have columns X (m, k) and a right side y (m,); s is the share of a block in the score
    Xᵀ(y − Xc), so that the covariance is valid for noise of any colour that decorrelates within a
    block (Liang & Zeger 1986). The prior information P = (e/σ)² of the coefficients is no block of
    its own, since its error is known. A = Σ XᵀX + P.

    Args:
        blocks: Columns and right side of each block.
        prior_std: Prior standard deviations σ, shape (k,); no prior if None.
        error: RMS error e of a row, in units of the right side.

    Returns:
        Coefficients, shape (k,), and covariance, shape (k, k).
    """
    X, y = (
        np.concatenate([columns for columns, _ in blocks]),
        np.concatenate([right for _, right in blocks]),
    )
    prior = np.zeros((X.shape[1],) * 2) if prior_std is None else np.diag((error / prior_std) ** 2)
    information = X.T @ X + prior
    size = np.sqrt(np.diag(information))
    size[size == 0.0] = np.inf  # a column of zeros: coefficient 0, variance 0
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-10)
    inverse /= np.outer(size, size)
    estimate = inverse @ (X.T @ y)
    scores = np.array([columns.T @ (right - columns @ estimate) for columns, right in blocks])
    return estimate, inverse @ (scores.T @ scores + error**2 * prior) @ inverse
