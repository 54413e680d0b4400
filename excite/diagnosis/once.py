"""Rejection of contact findings that recur with the motion.

A true contact happens once; a torque that reappears one period later is caused by the motion, as by
an oscillating load, a broken tooth or a weak supply.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from .._types import FloatArray
from ..effects.recorded_motion import RecordedMotion, split_by_motion
from . import judge, search
from .held_out_test import BELIEVED
from .judge import Finding, Verdict
from .noise import Period, shifted
from .search import EffectRegression

LASTS = 0.05
"""Of its largest torque, what a touch has at the least while it lasts: the rest is the band's."""
AGAIN = 0.5
"""Share of a touch's torque that comes again when the motion does, from which it was none."""
SEEN = 0.5
"""Share of it, in squares, that must have been made again, for that to be told."""


def kept(
    one: EffectRegression,
    verdict: Verdict,
    every: Sequence[RecordedMotion],
    periods: Mapping[str, Period],
) -> Verdict:
    """Return the verdict without contacts that recur.

    Args:
        one: The effect regression.
        verdict: The verdict.
        every: Motions of both folds.
        periods: See `noise.NoiseEstimate`.
    """
    refuted = list[Finding]()
    for finding in verdict.findings:
        share = _recurring_share(one, verdict, finding, every, periods)
        if share > AGAIN:
            refuted.append(replace(finding, probability=BELIEVED, evidence={"again": share}))
    return judge.refused(one, verdict, refuted) if refuted else verdict


def _recurring_share(
    one: EffectRegression,
    verdict: Verdict,
    finding: Finding,
    every: Sequence[RecordedMotion],
    periods: Mapping[str, Period],
) -> float:
    """Share of a contact's torque in the residual a period later or earlier; 0 if unknown."""
    together = verdict.together
    assert together is not None
    touches = [i for i in together.shapes if one.shapes[i].interval is not None]
    if any(part.shape not in touches for part in finding.parts):
        return 0.0
    n, values = (
        int(one.both.joint.max()) + 1,
        dict(zip(together.shapes, one.split(together.shapes, together.coefficients), strict=True)),
    )
    left = split_by_motion(
        search.remaining(one, [i for i in together.shapes if i not in touches]).reshape(-1, n),
        every,
    )
    found = np.zeros(
        3
    )  # the touch along what is left elsewhere, its square there, and its square in all
    for part in finding.parts:  # each by itself: the next of them is what comes again
        torque = (
            np.concatenate([own.picked(one.which([part.shape])).full() for own in one.columns])
            @ values[part.shape]
        )
        for track, own, rest in zip(
            every, split_by_motion(torque.reshape(-1, n), every), left, strict=True
        ):
            found[2] += float(np.sum(own**2))
            if track.segment.source in periods and own.any():
                then = _a_period_apart(track, own, rest, *periods[track.segment.source])
                seen = np.isfinite(then).all(axis=1)
                found[:2] += float(np.sum((own * then)[seen])), float(np.sum(own[seen] ** 2))
    return float(found[0] / found[1]) if found[1] > SEEN * found[2] else 0.0


def _a_period_apart(
    track: RecordedMotion,
    own: FloatArray,
    rest: FloatArray,
    period: float,
    window: tuple[float, float],
) -> FloatArray:
    """Residual a period later, else a period earlier, at every row, shape (N, n).

    NaN where the motion was not repeated, or where the contact still lasts.
    """
    rate, acts = (
        1.0 / (track.time[1] - track.time[0]),
        np.abs(own).max(axis=1) > LASTS * np.abs(own).max(),
    )
    rows = int(np.floor(period * rate))
    part, count, out = period * rate - rows, len(own), np.full(own.shape, np.nan)
    for ahead, by in (
        (-rows - 1, 1.0 - part),
        (rows, part),
    ):  # at row i: what is at row i + ahead + by
        here = np.arange(max(0, -ahead), min(count, count - ahead))
        here = here[(here + ahead >= 0) & (here + ahead + 1 < count)]
        then = track.time[here] + (ahead + by) / rate
        made = (np.minimum(then, track.time[here]) >= window[0]) & (
            np.maximum(then, track.time[here]) + 1.0 / rate <= window[1]
        )
        good = here[made & ~acts[here + ahead] & ~acts[here + ahead + 1]]
        out[good] = shifted(rest, by)[good + ahead]
    return out
