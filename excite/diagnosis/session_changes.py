"""Changes between recording sessions: friction and offsets of the joint actuators.

Coefficients fitted to one recording are judged on another. If friction has changed in between, the
difference looks like whatever friction model comes near it. Where such a change shows, every
recording after the first therefore gets its own Coulomb friction, viscous friction and offset, with
a prior of about the size of friction itself. Predictions do not use them: held-out torque is
predicted with the mean of the training recordings.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..effects.effect import CandidateModel, single_joint_columns
from ..effects.recorded_motion import RecordedMotion
from . import search
from .blocks import sandwiched
from .hypothesis import ranked
from .search import EffectRegression

Halves = tuple[list[RecordedMotion], list[RecordedMotion]]
"""Motions of the training and of the held-out recordings."""
KINDS = ("coulomb", "viscous", "offset")
"""Actuator parameters that may change, in the order of `SessionChange.change`."""
RELATIVE_CHANGE = 0.5
"""Prior standard deviation of a change over friction itself."""
MIN_FRICTION_SHARE = 0.01
"""Smallest friction that is assumed, over the joint's largest torque."""
MIN_EXPLAINED_SHARE = 0.7
"""Share of the residual beyond noise that session changes must explain at a joint."""
MIN_EXCESS = 0.44
"""Mean square residual beyond noise, over the noise, from which a change is sought."""
MIN_HELD_OUT_EXCESS = 1.0
"""The same on held-out recordings, which an imprecise friction model also predicts worse."""
MAX_COMPETITORS = 8
"""Number of best candidate models that are compared with session changes."""
BLOCKS_PER_SEGMENT = 20
"""Blocks of a segment for the sandwich estimator."""
FEW_BLOCKS_FACTOR = 1.2
"""Factor on standard errors, as the blocks are few."""
WALD_THRESHOLD = 20.0
"""Wald statistic from which a change is significant; with three degrees of freedom chance exceeds
it twice in ten thousand times."""

EXPERIMENT = (
    "the same warm-up before every recording, or temp.<joint> recorded; then the first motion "
    "once more at the end"
)
"""Experiment that tells a session change from friction that drifts."""


@dataclass(frozen=True)
class SessionChange:
    """Change of a joint actuator in a recording since the first recording.

    Attributes:
        source: The recording.
        joint: Index of the joint.
        change: Change of `KINDS`, shape (3,).
        covariance: Its covariance, shape (3, 3). At uniform speeds an increase of Coulomb friction
            may compensate a decrease of viscous friction.
    """

    source: str
    joint: int
    change: FloatArray
    covariance: FloatArray

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each parameter, shape (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def is_significant(self) -> bool:
        """True if the change of all parameters is more than noise (Wald 1943)."""
        wald = self.change @ np.linalg.pinv(self.covariance) @ self.change
        return bool(wald > WALD_THRESHOLD)


def sources(motions: Sequence[RecordedMotion]) -> list[str]:
    """Return the recordings after the first."""
    return list(dict.fromkeys(motion.segment.source for motion in motions))[1:]


def _actuator_columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """sgn q̇, q̇ and 1 at a joint, in the model's recording only if it states one."""
    j = model.joint_index
    columns = np.column_stack(
        [motion.sign(j), motion.samples.dq[:, j], np.ones(len(motion.segment))]
    )
    applies = model.source in ("", motion.segment.source)
    return single_joint_columns(motion, j, columns if applies else np.zeros_like(columns))


def _actuator_models(motions: Sequence[RecordedMotion], of: Sequence[str]) -> list[CandidateModel]:
    """Actuator parameters of each joint in each recording; they belong to no effect."""
    return [
        CandidateModel("", j, _actuator_columns, source=source)
        for source in of
        for j in range(motions[0].n)
    ]


def columns(motion: RecordedMotion, halves: Halves) -> FloatArray:
    """Return the columns of session changes on one motion, shape (N, n, 3n × recordings).

    The first recording gets minus the sum of the other training recordings, so that the base
    model's parameters are the mean of the training set.
    """
    changing, source = sources([*halves[0], *halves[1]]), motion.segment.source
    training = sources(halves[0]) if source == halves[0][0].segment.source else ()
    actuators = np.concatenate(
        [model.columns(motion) for model in _actuator_models(halves[0], [source])], axis=2
    )
    return np.concatenate(
        [
            actuators[:, :, :0],
            *(
                (float(other == source) - float(other in training)) * actuators
                for other in changing
            ),
        ],
        axis=2,
    )


def prior_std(motions: Sequence[RecordedMotion]) -> FloatArray:
    """Return the prior standard deviation of the coefficients of `columns`."""
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
    scale = np.column_stack([coulomb, viscous, coulomb]).ravel()
    return RELATIVE_CHANGE * np.tile(np.maximum(scale, 1e-12), len(sources(motions)))


def differs(
    regression: EffectRegression,
    shapes: Sequence[int],
    motions: Sequence[RecordedMotion],
    noise: FloatArray,
) -> bool:
    """Return True if session changes explain most of some joint's residual.

    The residual is that of the base model, some candidate models, and actuator parameters common to
    all recordings, which a trusted prior may have wrong.

    Args:
        regression: The effect regression.
        shapes: Indices of candidate models.
        motions: Motions of all recordings.
        noise: Mean square noise over the scale, shape (n,).
    """
    return _explain_residual(*_residual_levels(regression, shapes, motions), noise, MIN_EXCESS)


def differs_at_first(
    regression: EffectRegression, motions: Sequence[RecordedMotion], noise: FloatArray
) -> bool:
    """Return True if session changes explain the base model's residual, and no effect does.

    A single candidate model that explains as much without any change has precedence.

    Args:
        regression: The effect regression.
        motions: Motions of all recordings.
        noise: Mean square noise over the scale, shape (n,).
    """
    common, changing = _residual_levels(regression, (), motions)
    if not _explain_residual(common, changing, noise, MIN_EXCESS):
        return False
    threshold = float(np.sum(np.maximum(changing / noise - 1.0, MIN_EXCESS)))
    competitors = itertools.islice(ranked(regression), MAX_COMPETITORS)
    return not any(
        float(np.sum(np.maximum(search.level(regression, [h.shape]) / noise - 1.0, 0.0)))
        < threshold
        for h in competitors
    )


def _explain_residual(
    common: FloatArray, changing: FloatArray, noise: FloatArray, min_excess: float
) -> bool:
    """Return True if session changes explain most of a joint's residual beyond noise.

    Args:
        common: Mean square residual with common actuator parameters, shape (n,).
        changing: The same with session changes.
        noise: Mean square noise.
        min_excess: Residual beyond noise over the noise from which it counts.
    """
    beyond = common - noise
    return bool(
        np.any((beyond > min_excess * noise) & (common - changing > MIN_EXPLAINED_SHARE * beyond))
    )


def _residual_levels(
    regression: EffectRegression, shapes: Sequence[int], motions: Sequence[RecordedMotion]
) -> tuple[FloatArray, FloatArray]:
    """Mean square residual with common actuator parameters and with session changes, (n,)."""
    common = search.appended(search.only(regression, shapes), _actuator_models(motions, [""]))
    changing = search.appended(common, _actuator_models(motions, sources(motions)))
    level, other = (search.level(r, range(len(r.shapes))) for r in (common, changing))
    return level, other


def differs_later(
    residual: FloatArray, without_changes: FloatArray, moves: BoolArray, noise: FloatArray
) -> bool:
    """Return True if session changes explain the residual of the held-out torque.

    A joint fit of both recordings may lie between two sessions and leave little of either.

    Args:
        residual: Residual over some scale, shape (N, n).
        without_changes: The same minus what session changes explain.
        moves: Rows that count, shape (N, n).
        noise: Mean square that a right model would leave, shape (n,).
    """
    return _explain_residual(
        search.mean_square(residual, moves),
        search.mean_square(without_changes, moves),
        noise,
        MIN_HELD_OUT_EXCESS,
    )


def changes(
    regression: EffectRegression, shapes: Sequence[int], halves: Halves
) -> tuple[SessionChange, ...]:
    """Estimate session changes jointly with candidate models.

    Args:
        regression: An effect regression with columns of session changes.
        shapes: Indices of the candidate models.
        halves: Motions of the training and of the held-out recordings.
    """
    motions = [*halves[0], *halves[1]]
    both, which, n = regression.both, regression.which(shapes), motions[0].n
    effects = np.concatenate([part.picked(which).full() for part in regression.columns])
    end = both.gamma.shape[1] - n  # the last columns are those of the friction widths
    start = end - len(KINDS) * n * len(sources(motions))
    A = np.hstack(
        [both.gamma[:, start:end], both.gamma[:, :start], both.gamma[:, end:], both.full(effects)]
    )
    recorded, prior = np.flatnonzero(both.rows), np.flatnonzero(~both.rows)
    solution, covariance = sandwiched(
        [(A[part], both.torque[part]) for part in _blocks(recorded, prior, motions)]
    )
    out, models = [], _actuator_models(motions, sources(motions))
    training, count = sources(halves[0]), end - start
    for model in models:  # change from the mean, minus that of the first recording
        weights = [
            float(other is model)
            + float(other.joint_index == model.joint_index and other.source in training)
            for other in models
        ]
        L = np.kron(weights, np.eye(len(KINDS)))
        out.append(
            SessionChange(
                model.source,
                model.joint_index,
                L @ solution[:count],
                FEW_BLOCKS_FACTOR**2 * L @ covariance[:count, :count] @ L.T,
            )
        )
    return tuple(out)


def _blocks(
    recorded: IntArray, prior: IntArray, motions: Sequence[RecordedMotion]
) -> list[IntArray]:
    """Rows of blocks of time, equally many in each motion; and the rows of the prior."""
    by_motion = np.split(recorded, np.cumsum([len(motion) * motion.n for motion in motions])[:-1])
    return [
        *(part for rows in by_motion for part in np.array_split(rows, BLOCKS_PER_SEGMENT)),
        prior,
    ]
