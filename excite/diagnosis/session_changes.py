"""What of a robot's drives differs between recordings: friction of a day that was colder, an offset of a sensor that drifted.

What one recording teaches is judged on another. Where friction itself is another by then, that looks like whatever law comes near it; so,
where it shows, every recording after the first has friction and an offset of its own, of which about as much is known beforehand as of
friction on any day. Predictions do not know them: held-out torque is foretold with the mean of what the recordings say that teach.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..effects.effect import CandidateModel, single_joint_columns
from ..effects.recorded_motion import RecordedMotion
from . import search
from .blocks import sandwiched
from .hypothesis import ranked
from .search import EffectRegression

Array = np.ndarray
Halves = tuple[list[RecordedMotion], list[RecordedMotion]]
KINDS = ("coulomb", "viscous", "offset")
CHANGES, LEAST = 0.5, 0.01
"""Standard deviation of a change over friction itself; and of friction, over the joint's largest torque, at the least."""
TAKES, EXCESS, LATER = 0.7, 0.44, 1.0
"""Of what is left beyond noise at a joint, what such changes must take to be there; and how much that must be, over the noise, of all
recordings and of those held out, where a law that is foretold a little beyond what it was fitted to is off too."""
LAWS = 8
"""The best of them that are compared with other drives."""
BLOCKS, FEW, SURE = 20, 1.2, 20.0
"""Parts of a stretch that errors are told between, a factor on these as they are few, and the statistic of three degrees of freedom from
which a change is sure: chance exceeds it twice in ten thousand times."""

EXPERIMENT = "the same warm-up before every recording, or temp.<joint> recorded; then the first motion once more at the end"


@dataclass(frozen=True)
class SessionChange:
    """By how much a joint's drive differs in a recording from what it was in the first. change: of `KINDS`, Shape (3,). covariance: of all,
    Shape (3, 3): where speeds are alike, Coulomb friction may be more and viscous friction less."""

    source: str
    joint: int
    change: Array
    covariance: Array

    @property
    def std(self) -> Array:
        """Of each by itself. Shape (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def is_significant(self) -> bool:
        """Whether together they are more than noise (Wald 1943)."""
        return bool(self.change @ np.linalg.pinv(self.covariance) @ self.change > SURE)


def sources(tracks: Sequence[RecordedMotion]) -> list[str]:
    """Every recording after the first, once."""
    return list(dict.fromkeys(t.segment.source for t in tracks))[1:]


def _drive(t: RecordedMotion, s: CandidateModel) -> Array:
    """sgn q̇, q̇ and 1 at a joint; of a shape with a source, in that recording only."""
    columns = np.column_stack([t.sign(s.joint_index), t.samples.dq[:, s.joint_index], np.ones(len(t.segment))])
    return single_joint_columns(
        t, s.joint_index, columns if s.source in ("", t.segment.source) else np.zeros_like(columns)
    )


def _shapes(tracks: Sequence[RecordedMotion], of: Sequence[str]) -> list[CandidateModel]:
    """Drives of each joint in each of some recordings. They have no name: they are never told apart from the base model."""
    return [CandidateModel("", j, _drive, source=source) for source in of for j in range(tracks[0].n)]


def columns(track: RecordedMotion, halves: Halves) -> Array:
    """Of drives that every recording after the first has its own of, on one stretch. Shape (N, n, 3n × recordings).

    The first has what the others of its half have less, in sum: the base model's is the mean of that half.
    """
    of, here = sources([*halves[0], *halves[1]]), track.segment.source
    taught = sources(halves[0]) if here == halves[0][0].segment.source else ()
    own = np.concatenate([shape.columns(track) for shape in _shapes(halves[0], [here])], axis=2)
    return np.concatenate(
        [
            own[:, :, :0],
            *((float(source == here) - float(source in taught)) * own for source in of),
        ],
        axis=2,
    )


def prior_std(every: Sequence[RecordedMotion]) -> Array:
    """Standard deviation of the coefficients of `columns`, before anything is seen. Shape (3n × recordings,)."""
    body = every[0].fitted_robot
    fastest, largest = (
        np.max([np.abs(x).max(axis=0) for x in own], axis=0)
        for own in ([t.samples.dq for t in every], [t.torque for t in every])
    )
    coulomb = np.maximum(body.actuator_parameter("coulomb"), LEAST * largest)
    viscous = np.maximum(body.actuator_parameter("viscous"), LEAST * largest / np.maximum(fastest, 1e-9))
    one = np.column_stack([coulomb, viscous, coulomb]).ravel()
    return CHANGES * np.tile(np.maximum(one, 1e-12), len(sources(every)))


def differs(one: EffectRegression, shapes: Sequence[int], every: Sequence[RecordedMotion], noise: Array) -> bool:
    """Whether some joint's drive does: whether changes of drives take most of what is left there beyond noise by the base model, some
    shapes, and a drive that is the same in all recordings, which a prior may have wrong.

    noise: mean square over the scale. Shape (n,).
    """
    return _taken(*_levels(one, shapes, every), noise, EXCESS)


def differs_at_first(one: EffectRegression, every: Sequence[RecordedMotion], noise: Array) -> bool:
    """The same of the base model alone; but for a shape by itself, which needs nothing to differ and leaves about as little as drives that
    do: it is to be believed first.

    noise: mean square over the scale. Shape (n,).
    """
    left, other = _levels(one, (), every)
    if not _taken(left, other, noise, EXCESS):
        return False
    least = float(np.sum(np.maximum(other / noise - 1.0, EXCESS)))
    alone = itertools.islice(ranked(one), LAWS)
    return not any(
        float(np.sum(np.maximum(search.level(one, [h.shape]) / noise - 1.0, 0.0))) < least
        for h in alone
    )


def _taken(left: Array, other: Array, noise: Array, excess: float) -> bool:
    """Whether at some joint much is left beyond noise, and of that little with drives of its own. Mean squares. Shapes (n,)."""
    beyond = left - noise
    return bool(np.any((beyond > excess * noise) & (left - other > TAKES * beyond)))


def _levels(one: EffectRegression, shapes: Sequence[int], every: Sequence[RecordedMotion]) -> tuple[Array, Array]:
    """What is left of all recordings with drives that are the same, and with drives that differ. Shapes (n,)."""
    same = search.appended(search.only(one, shapes), _shapes(every, [""]))
    left, other = (
        search.level(d, range(len(d.shapes)))
        for d in (same, search.appended(same, _shapes(every, sources(every))))
    )
    return left, other


def differs_later(left: Array, taken: Array, moves: Array, noise: Array) -> bool:
    """The same of what is left of the held-out torque: both fits together may lie between two days, and leave little of either.

    left: over some scale; taken: without what drives of its own take of it; moves: rows that count. Shapes (N, n). noise: mean square over
    that scale which a right model would leave. Shape (n,).
    """
    return _taken(search.mean_square(left, moves), search.mean_square(taken, moves), noise, LATER)


def changes(one: EffectRegression, shapes: Sequence[int], halves: Halves) -> tuple[SessionChange, ...]:
    """By how much, of a design whose recordings have drives of their own, beside some shapes; errors between stretches of time."""
    every = [*halves[0], *halves[1]]
    both, which, n = one.both, one.which(shapes), every[0].n
    added = np.concatenate([part.picked(which).full() for part in one.columns])
    start = both.gamma.shape[1] - n  # friction's widths are last
    place = start - len(KINDS) * n * len(sources(every))
    A = np.hstack(
        [both.gamma[:, place:start], both.gamma[:, :place], both.gamma[:, start:], both.full(added)]
    )
    found, covariance = sandwiched(
        [
            (A[part], both.torque[part])
            for part in _blocks(np.flatnonzero(both.rows), np.flatnonzero(~both.rows), every)
        ]
    )
    told, own, taught, count = [], _shapes(every, sources(every)), sources(halves[0]), start - place
    for shape in own:  # from the mean; and what the first has less than that
        parts = [
            float(other is shape) + float(other.joint_index == shape.joint_index and other.source in taught)
            for other in own
        ]
        L = np.kron(parts, np.eye(len(KINDS)))
        told.append(
            SessionChange(
                shape.source,
                shape.joint_index,
                L @ found[:count],
                FEW**2 * L @ covariance[:count, :count] @ L.T,
            )
        )
    return tuple(told)


def _blocks(recorded: Array, known: Array, every: Sequence[RecordedMotion]) -> list[Array]:
    """Rows of blocks of time, as many of each stretch, be it short; and those that no recording made. Shapes (m,), (k,)."""
    stretches = np.split(recorded, np.cumsum([len(t) * t.n for t in every])[:-1])
    return [*(part for rows in stretches for part in np.array_split(rows, BLOCKS)), known]
