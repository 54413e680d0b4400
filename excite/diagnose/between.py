"""What of a robot's drives differs between recordings: friction of a day that was colder, an offset of a sensor that drifted.

What one recording teaches is judged on another. Where friction itself is another by then, that looks like whatever law comes near it; so,
where it shows, every recording after the first has friction and an offset of its own, of which about as much is known beforehand as of
friction on any day. Predictions do not know them: held-out torque is foretold as if nothing had changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from . import search
from .blocks import sandwiched
from .effect import Shape, alone
from .search import Design
from .track import Track

Array = np.ndarray
KINDS = ("coulomb", "viscous", "offset")
CHANGES, LEAST = 0.5, 0.01
"""Standard deviation of a change over friction itself; and of friction, over the joint's largest torque, at the least."""
TAKES, EXCESS = 0.7, 0.44
"""Of what is left beyond noise at a joint, what such changes must take to be there; and how much that must be, over the noise."""
BLOCKS, SURE = 40, 4.0
"""Parts of the recordings that errors are told between; and standard deviations from which a change is one."""


EXPERIMENT = "the same warm-up before every recording, or temp.<joint> recorded; then the first motion once more at the end"


@dataclass(frozen=True)
class Change:
    """By how much a joint's drive differs in a recording from what it was in the first. change, std: of `KINDS`. Shape (3,)."""

    source: str
    joint: int
    change: Array
    std: Array

    @property
    def sure(self) -> bool:
        """Whether any of them is more than noise."""
        return bool(np.any(np.abs(self.change) > SURE * self.std))


def sources(tracks: Sequence[Track]) -> list[str]:
    """Every recording after the first, once."""
    return list(dict.fromkeys(t.piece.source for t in tracks))[1:]


def _own(t: Track, s: Shape) -> Array:
    """sgn q̇, q̇ and 1 at a joint, in one recording only."""
    columns = np.column_stack([t.sign(s.place), t.fine.dq[:, s.place], np.ones(len(t.piece))])
    return alone(t, s.place, columns if t.piece.source == s.source else np.zeros_like(columns))


def _shapes(tracks: Sequence[Track]) -> list[Shape]:
    """One of each recording after the first and joint, in this order. They have no name: they are never told apart from the base model."""
    return [Shape("", j, _own, source=source) for source in sources(tracks) for j in range(tracks[0].n)]


def columns(track: Track, every: Sequence[Track]) -> Array:
    """Of drives that every recording after the first has its own of, on one stretch. Shape (N, n, 3n × recordings)."""
    return np.concatenate([shape.columns(track) for shape in _shapes(every)], axis=2)


def known(every: Sequence[Track]) -> Array:
    """Standard deviation of the coefficients of `columns`, before anything is seen. Shape (3n × recordings,)."""
    body, n = every[0].body, every[0].n
    fastest, largest = (
        np.max([np.abs(x).max(axis=0) for x in own], axis=0) for own in ([t.fine.dq for t in every], [t.torque for t in every])
    )
    coulomb = np.maximum(body.drive("coulomb"), LEAST * largest)
    viscous = np.maximum(body.drive("viscous"), LEAST * largest / np.maximum(fastest, 1e-9))
    one = np.column_stack([coulomb, viscous, coulomb]).ravel()
    assert len(one) == len(KINDS) * n
    return CHANGES * np.tile(np.maximum(one, 1e-12), len(sources(every)))


def foretold_otherwise(left: Array, held_out: Sequence[Track], every: Sequence[Track], noise: Array) -> bool:
    """The same of what is left of the held-out torque: both fits together may lie between two days, and leave little of either.

    left: over some scale, Shape (N, n). noise: mean square over that which a right model would leave. Shape (n,).
    """
    every_column, moves = (np.concatenate(x) for x in ([columns(t, every) for t in held_out], [t.moves for t in held_out]))
    for j in range(left.shape[1]):
        rows, felt = moves[:, j], every_column[:, j].any(axis=0)
        own, x = left[rows, j], every_column[rows, j][:, felt]
        taken = x @ np.linalg.lstsq(x, own, rcond=None)[0]
        beyond = float(np.mean(own**2)) - noise[j]
        if beyond > EXCESS * noise[j] and float(np.mean(own**2) - np.mean((own - taken) ** 2)) > TAKES * beyond:
            return True
    return False


def differs(one: Design, shapes: Sequence[int], every: Sequence[Track], noise: Array) -> bool:
    """Whether some joint's drive does: whether changes of drives take most of what the base model and some shapes leave there beyond noise.

    noise: mean square over the scale. Shape (n,).
    """
    made = _shapes(every)
    if not made:
        return False
    left = search.level(one, shapes)
    bare = search.only(one, shapes)
    changed = search.appended(bare, made)
    beyond = left - noise
    takes = left - search.level(changed, range(len(changed.shapes)))
    return bool(np.any((beyond > EXCESS * noise) & (takes > TAKES * beyond)))


def changes(one: Design, shapes: Sequence[int], every: Sequence[Track]) -> tuple[Change, ...]:
    """By how much, of a design whose recordings have drives of their own, beside some shapes; errors between stretches of time."""
    both, which = one.both, one.which(shapes)
    added = np.concatenate([part.picked(which).full() for part in one.columns])
    start = both.gamma.shape[1] - every[0].n  # friction's widths are last
    place = start - len(KINDS) * every[0].n * len(sources(every))
    A = np.hstack([both.gamma[:, place:start], both.gamma[:, :place], both.gamma[:, start:], both.full(added)])
    rows = [*np.array_split(np.flatnonzero(both.rows), BLOCKS), np.flatnonzero(~both.rows)]
    found, covariance = sandwiched([(A[part], both.torque[part]) for part in rows])
    count = start - place
    values, std = found[:count].reshape(-1, len(KINDS)), np.sqrt(np.diag(covariance)[:count]).reshape(-1, len(KINDS))
    told = zip(_shapes(every), values, std, strict=True)
    return tuple(Change(shape.source, shape.place, value, error) for shape, value, error in told)
