"""The course of a search: from the equations of two halves to names, over a scale that sharpens as more is found."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..identify.identification import Identification
from . import between, equations, foretold, judge, late, noise, once, search, track
from .catalogue import EFFECTS
from .judge import Verdict
from .noise import Noise
from .search import Design
from .track import Track

Array = np.ndarray
Progress = Callable[[str], None]
Halves = tuple[list[Track], list[Track]]
MISFIT = {"periods": 0.1, "differences": 0.3}
"""Share of the residual taken for a form that is not quite the catalogue's, by how the noise is known."""
AGAIN, COARSE = 2, 0.7
"""Times that all is looked at again over what is left, and from which share of its scale on that is not worth it."""


@dataclass(frozen=True)
class Course:
    """What a search came to. scale: that torque is told over. Shape (n,) [N m]. differing: whether drives differ between recordings, so
    that each after the first has its own."""

    one: Design
    verdict: Verdict
    noisy: Noise
    scale: Array
    differing: bool = False

    @property
    def shapes(self) -> tuple[int, ...]:
        """Of what was found."""
        return () if self.verdict.together is None else self.verdict.together.shapes


def run(
    identified: Identification, halves: Halves, noisy: Noise, trusted: Mapping[int, float], names: Collection[str], progress: Progress
) -> Course:
    """Search with drives that are the same in all recordings, unless what is left, before or after, says otherwise.

    trusted, names: see `diagnosis.Options`.
    """
    every, scale = [*halves[0], *halves[1]], _scale(noisy, np.sqrt(np.mean(identified.data.residual**2, axis=0)))
    build, listed = equations.builder(halves, scale), equations.shapes(halves, bool(trusted), noisy.floor, names)

    def bare(differing: Sequence[Track]) -> Design:
        first, second = (equations.half(half, identified, trusted, scale, differing) for half in halves)
        return search.bare((first, second), build)

    one = bare(())
    heated = any(np.isfinite(t.temperature).any() for t in every)  # which tells what friction does, and foretells it
    if heated or not between.differs(one, (), every, (noisy.quiet / scale) ** 2):
        progress(f"{len(listed)} shapes of {len(EFFECTS)} effects, alone and together")
        found = _searched(search.filled(one, listed), noisy, scale, every)
        if not _otherwise(found, halves):
            return found
    progress(f"drives differ between the recordings, so that each has its own; {len(listed)} shapes beside that")
    return replace(_searched(search.filled(bare(every), listed), noisy, scale, every), differing=True)


def _otherwise(found: Course, halves: Halves) -> bool:
    """Whether what a search leaves, of all recordings or of those held out, says that drives differ between them."""
    every, quiet = [*halves[0], *halves[1]], (found.noisy.quiet / found.scale) ** 2
    if between.differs(found.one, found.shapes, every, quiet):
        return True
    unit = np.ones(len(found.scale))
    left = foretold.residuals(found.one, found.verdict.together, unit)[1]
    return between.foretold_otherwise(left, halves[1], every, quiet + foretold.reach(found.one, unit) ** 2)


def _searched(one: Design, noisy: Noise, scale: Array, every: Sequence[Track]) -> Course:
    """What is found, first over a coarse scale, then over what that leaves."""
    one, verdict = judge.judged(_warned(one, noisy, scale))
    one, verdict, scale = _sharper(one, verdict, noisy, scale)
    one, verdict, scale = _sharper(*late.followed(one, verdict), noisy, scale)
    for _ in range(AGAIN):
        if verdict.together is None or all(one.shapes[i].interval is None for i in verdict.together.shapes):
            break
        left = search.remaining(one, verdict.together.shapes) * scale  # without what touched the robot once, which looked like noise
        noisy = noise.repeated(noisy, every, track.split(left, every))
        one, verdict, scale = _sharper(one, verdict, noisy, scale)
    return Course(one, once.kept(one, verdict, every, noisy.periods), noisy, scale)


def _scale(noisy: Noise, left: Array) -> Array:
    """Noise, and a share of an RMS residual for a form that is not quite the catalogue's. Shape (n,) [N m]."""
    return np.asarray(np.sqrt(noisy.floor**2 + (MISFIT[noisy.method] * left) ** 2))


def _warned(one: Design, noisy: Noise, scale: Array) -> Design:
    """The design that knows what the encoders' steps feign, and samples that are too rare."""
    steps, sharpened = ([((a / scale).ravel(), (b / scale).ravel()) for a, b in own] for own in (noisy.feigned, [noisy.sharpened]))
    stepped = float(np.mean((noisy.steps / noisy.floor) ** 2))
    return judge.warned(one, steps, sharpened[0], stepped, (noisy.floor / scale) ** 2 if noisy.method == "periods" else None)


def _sharper(one: Design, verdict: Verdict, noisy: Noise, scale: Array) -> tuple[Design, Verdict, Array]:
    """Looked at again over the scale that is left with what was found: a slight effect beside a strong one drowns in the first."""
    for _ in range(AGAIN):
        if verdict.together is None:
            break
        finer = np.minimum(_scale(noisy, rms(one, verdict.together.shapes, scale)), scale)
        if (finer > COARSE * scale).all():
            break
        one = _warned(search.rescaled(one, scale / finer), noisy, finer)
        one, verdict = judge.judged(one, verdict.together.shapes)
        scale = finer
    return one, verdict, scale


def rms(one: Design, shapes: Sequence[int], scale: Array) -> Array:
    """RMS of what is left of all recordings when base and shapes are fitted to them. Shape (n,) [N m]."""
    return np.asarray(np.sqrt(search.level(one, shapes)) * scale)
