"""Verdict: from fitted candidate models to findings with their rivals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import TypeVar

from .._types import FloatArray
from ..effects.effect import CandidateModel
from . import search
from .contest import begun, searched
from .hypothesis import Hypothesis, name, ranked, size, who
from .measured import Measured
from .search import EffectRegression, Trial, trial

T = TypeVar("T")
ARTEFACT_FACTOR, AT_ALL = 1.5, 150.0
"""Further gain that an effect needs, over what it gains at its joint from what an encoder's steps
drawn anew would leave, the most of a few draws; and what it needs besides if it gains anything from
them at any joint. What came nearest to its bar, in 46 simulated robots with coarse encoders and
nothing missing, reached 0.7 of it."""
CONSIDERED = 8
"""Effects told beside the findings."""


@dataclass(frozen=True)
class Finding:
    """An accepted effect at a joint.

    Attributes:
        parts: Its candidate models, the largest first.
        gain: Log-likelihood gain that it adds to the others.
        rivals: Gain of other effects in its place.
        here: Those of them at the same joint.
        equivalents: Effects from which the recordings cannot distinguish it.
        probability: Probability that the truth is the effect or an equivalent.
        evidence: Quantities from which the probability is computed.
    """

    parts: tuple[Hypothesis, ...]
    gain: float
    rivals: Mapping[str, float]
    here: frozenset[str] = frozenset()
    equivalents: tuple[str, ...] = ()
    probability: float = 1.0
    evidence: Mapping[str, float] = field(default_factory=dict)

    @property
    def main(self) -> Hypothesis:
        """The largest of its candidate models."""
        return self.parts[0]


@dataclass(frozen=True)
class Verdict:
    """Result of a selection.

    Attributes:
        findings: Findings, the largest gain first.
        together: Joint fit of all accepted models; None if there are none.
        considered: Best alternatives.
        doubted: Findings that are more likely wrong than right.
    """

    findings: tuple[Finding, ...]
    together: Trial | None
    considered: tuple[Hypothesis, ...]
    doubted: tuple[Finding, ...] = ()

    @property
    def named(self) -> tuple[int, ...]:
        """Indices of the candidate models of the findings."""
        return tuple(part.shape for finding in self.findings for part in finding.parts)

    @property
    def chosen(self) -> tuple[Hypothesis, ...]:
        """Largest candidate model of each finding."""
        return tuple(finding.main for finding in self.findings)


def warned(
    one: EffectRegression,
    steps: Sequence[tuple[FloatArray, FloatArray]],
    sharpened: tuple[FloatArray, FloatArray],
    stepped: float,
    noise: FloatArray | None,
) -> EffectRegression:
    """Return the regression with the gains that measurement artefacts mimic.

    Args:
        one: The effect regression.
        steps: Residuals of both folds by encoder quantisation, several draws.
        sharpened: Residuals of both folds by too low a sample rate.
        stepped: Share of the noise power by encoder quantisation.
        noise: Mean square noise over the scale, shape (n,); None if it is not known.
    """
    drawn, rare = _most(one, steps, who), _most(one, [sharpened], name)
    at_all, artefact_gains = {effect for effect, _ in drawn}, dict[tuple[str, int | None], float]()
    for shape in one.shapes:
        by_steps = ARTEFACT_FACTOR * drawn.get(who(shape), 0.0) + AT_ALL * (shape.effect in at_all)
        artefact_gains[who(shape)] = max(by_steps, rare.get(shape.effect, 0.0))
    return replace(one, measured=Measured(artefact_gains, stepped, noise))


def _most(
    one: EffectRegression,
    residuals: Sequence[tuple[FloatArray, FloatArray]],
    each: Callable[[CandidateModel], T],
) -> dict[T, float]:
    """Largest gain of each effect, or effect at a joint, from some residuals."""
    out: dict[T, float] = {}
    for residual in residuals:
        for h in ranked(search.pretended(one, residual), each=each):
            key = each(one.shapes[h.shape])
            out[key] = max(out.get(key, 0.0), h.trial.gain)
    return {key: gain for key, gain in out.items() if gain > 0.0}


def judged(one: EffectRegression, chosen: Sequence[int] = ()) -> tuple[EffectRegression, Verdict]:
    """Return the verdict, and the regression with the candidate models that were optimised.

    Args:
        one: The effect regression.
        chosen: Models to start with; the best when empty.
    """
    if not chosen:
        alone = list(ranked(one))
        counts = [h for h in alone if h.shows and h.trial.gain > one.bar(h.shape)]
        if not counts:
            return one, Verdict((), None, tuple(alone[:CONSIDERED]))
        one, chosen = begun(one, counts)
    one, chosen = searched(one, list(chosen))
    verdict = said(one, chosen)
    named = {(f.main.effect, f.main.joint) for f in verdict.findings}
    others = (h for h in ranked(one) if (h.effect, h.joint) not in named)
    return one, replace(verdict, considered=tuple(islice(others, CONSIDERED)))


def said(one: EffectRegression, chosen: Sequence[int]) -> Verdict:
    """Group some candidate models into findings."""
    if not chosen:
        return Verdict((), None, ())
    together = trial(one, chosen)
    groups: dict[tuple[str, int | None], list[Hypothesis]] = {}
    for number, i in enumerate(chosen):
        shape = one.shapes[i]
        own = Hypothesis(
            shape.effect, shape.joint, i, trial(one, [i]), size(one, together, number), True
        )
        groups.setdefault(who(shape), []).append(own)
    findings = [
        _finding(one, together, tuple(sorted(parts, key=lambda h: -h.size)))
        for parts in groups.values()
    ]
    return Verdict(tuple(sorted(findings, key=lambda f: -f.gain)), together, ())


def moved(one: EffectRegression, verdict: Verdict, better: Verdict, start: int) -> Verdict:
    """Return the verdict with the models of a better fit of the same findings.

    The better fit's models start at index `start` of the regression.
    """
    assert better.together is not None
    place = {shape: start + k for k, shape in enumerate(better.together.shapes)}
    parts = {
        (f.main.effect, f.main.joint): tuple(replace(p, shape=place[p.shape]) for p in f.parts)
        for f in better.findings
    }
    findings = tuple(replace(f, parts=parts[f.main.effect, f.main.joint]) for f in verdict.findings)
    return replace(
        verdict,
        findings=findings,
        together=trial(one, [place[shape] for shape in better.together.shapes]),
    )


def refused(one: EffectRegression, verdict: Verdict, refuted: Sequence[Finding]) -> Verdict:
    """Return the verdict with some findings moved to the doubted ones."""
    assert verdict.together is not None
    left = instead(
        one,
        verdict,
        without(verdict.together.shapes, [part for finding in refuted for part in finding.parts]),
    )
    return replace(left, doubted=(*verdict.doubted, *refuted))


def instead(one: EffectRegression, verdict: Verdict, chosen: Sequence[int]) -> Verdict:
    """Return the verdict of other models, with the same alternatives and doubts."""
    return replace(said(one, chosen), considered=verdict.considered, doubted=verdict.doubted)


def without(shapes: Sequence[int], parts: Sequence[Hypothesis]) -> list[int]:
    """Return the models that are not among some hypotheses."""
    return [i for i in shapes if all(i != part.shape for part in parts)]


def _finding(one: EffectRegression, together: Trial, parts: tuple[Hypothesis, ...]) -> Finding:
    """A finding with the gains of rival effects in its place."""
    others = without(together.shapes, parts)
    effect, rest = parts[0].effect, trial(one, others).gain
    gain = together.gain - rest
    best = [h for h in ranked(one, tuple(others), name) if h.effect != effect]
    here = frozenset(h.effect for h in best if h.joint == parts[0].joint)
    return Finding(parts, gain, {h.effect: h.trial.gain - rest for h in best}, here)
