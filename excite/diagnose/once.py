"""What touched the robot once: it does not come again whenever the motion does. A load that swings, a broken tooth or a weak supply do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from . import judge, search
from .foretold import BELIEVED
from .judge import Finding, Verdict
from .noise import Period, shifted
from .search import Design
from .track import Track, split

Array = np.ndarray
AGAIN = 0.5
"""Share of a touch's torque that comes again when the motion does, from which it was none."""
SEEN = 0.5
"""Share of it, in squares, that must have been made again, for that to be told."""


def kept(one: Design, verdict: Verdict, every: Sequence[Track], periods: Mapping[str, Period]) -> Verdict:
    """The verdict without touches that come again. every: stretches of both halves; periods: see `Noise`."""
    refuted = list[Finding]()
    for finding in verdict.findings:
        share = _again(one, verdict, finding, every, periods)
        if share > AGAIN:
            refuted.append(replace(finding, probability=BELIEVED, evidence={"again": share}))
    if not refuted:
        return verdict
    assert verdict.together is not None
    parts = [part for finding in refuted for part in finding.parts]
    left = judge.said(one, judge.without(verdict.together.shapes, parts))
    return replace(left, considered=verdict.considered, doubted=(*verdict.doubted, *refuted))


def _again(one: Design, verdict: Verdict, finding: Finding, every: Sequence[Track], periods: Mapping[str, Period]) -> float:
    """How much of a touch's torque is in what others leave a period before or after it; 0 where that is not known."""
    together = verdict.together
    assert together is not None
    touches = [part.shape for part in finding.parts if one.shapes[part.shape].interval is not None]
    if len(touches) < len(finding.parts):
        return 0.0
    n, which = int(one.both.joint.max()) + 1, one.which(touches)
    values = dict(zip(together.shapes, one.split(together.shapes, together.coefficients), strict=True))
    torque = np.concatenate([part.picked(which).full() for part in one.columns]) @ np.concatenate([values[i] for i in touches])
    left = search.remaining(one, judge.without(together.shapes, finding.parts))
    found = np.zeros(3)  # the touch along what is left elsewhere, its square there, and its square in all
    for track, own, rest in zip(every, split(torque.reshape(-1, n), every), split(left, every), strict=True):
        found[2] += float(np.sum(own**2))
        if track.piece.source in periods and own.any():
            found[:2] += _compared(track, own, rest, *periods[track.piece.source])
    return float(found[0] / found[1]) if found[1] > SEEN * found[2] else 0.0


def _compared(track: Track, own: Array, rest: Array, period: float, window: tuple[float, float]) -> Array:
    """A touch along what is left a period later and a period earlier, and its square where the motion was made again."""
    rate = 1.0 / (track.time[1] - track.time[0])
    rows = int(np.floor(period * rate))
    later = shifted(rest, period * rate - rows)[rows:]  # at the times of the first rows
    count = len(later)
    inside = (track.time[:count] >= window[0]) & (track.time[rows : rows + count] + 1.0 / rate <= window[1])
    before = shifted(own, period * rate - rows)[rows:]
    pairs = [(own[:count][inside], later[inside]), (before[inside], rest[:count][inside])]
    return np.array([sum(float(np.sum(a * b)) for a, b in pairs), sum(float(np.sum(a * a)) for a, _ in pairs)])
