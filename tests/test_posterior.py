"""Posterior probability of a finding from the fraction of its torque that remains unexplained."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Sequence

import numpy as np
import pytest
from synthetic_recordings import unexpected_columns

from excite._types import FloatArray
from excite.diagnosis import belief, hypothesis, judge, search
from excite.diagnosis.measured import Measured
from excite.effects import EFFECTS_BY_NAME, are_confusable
from excite.effects.effect import CandidateModel

EXACT_NOISE = (np.ones(1), np.ones(1))
"""Bounds of a known noise floor."""
TRIAL = search.Trial((0,), np.ones(1), (np.ones(1), np.ones(1)), 50.0, True)


def only(effect: str) -> judge.Verdict:
    """Return a verdict with a single effect at the first joint."""
    return judge.Verdict(
        (judge.Finding((hypothesis.Hypothesis(effect, 0, 0, TRIAL, 1.0, True),), 50.0, {}),),
        TRIAL,
        (),
    )


def shares(
    monkeypatch: pytest.MonkeyPatch,
    effects: Sequence[str],
    both: float,
    without: Sequence[float],
    once: Sequence[bool] | None = None,
    bounds: tuple[float, float] = (1.0, 1.0),
) -> list[float]:
    """Return the unexplained fraction of each of several effects at a joint.

    Args:
        monkeypatch: Replaces the residual level.
        effects: Names of the effects.
        both: Mean square residual over the noise with all effects.
        without: Mean square residual over the noise without each effect.
        once: True for transient effects.
        bounds: Bounds of the noise over its estimate.
    """
    places = tuple(range(len(effects)))
    intervals = [(1.0, 2.0) if happens else None for happens in once or [False] * len(effects)]
    shapes = tuple(
        CandidateModel(name, 0, unexpected_columns, interval=interval)
        for name, interval in zip(effects, intervals, strict=True)
    )
    tried = search.Trial(places, np.ones(len(effects)), (np.ones(1), np.ones(1)), 50.0, True)
    findings = tuple(
        judge.Finding((hypothesis.Hypothesis(name, 0, i, tried, 1.0, True),), 50.0, {})
        for i, name in enumerate(effects)
    )

    def level(_: object, chosen: Sequence[int]) -> FloatArray:
        (gone,) = set(places) - set(chosen) or {None}
        return np.array([both if gone is None else without[gone]])

    monkeypatch.setattr(hypothesis, "acting", lambda *_: np.array([True]))
    monkeypatch.setattr(search, "level", level)
    return unexplained(shapes, judge.Verdict(findings, tried, ()), bounds=bounds)


def unexplained(
    shapes: Sequence[CandidateModel],
    verdict: judge.Verdict,
    joints: int = 1,
    bounds: tuple[float, float] = (1.0, 1.0),
) -> list[float]:
    regression = types.SimpleNamespace(shapes=shapes)
    within = np.full(joints, bounds[0]), np.full(joints, bounds[1])
    return [x for x, _ in belief.shares(regression, verdict, np.ones(joints), within)]


def test_probability_decreases_with_the_unexplained_fraction():
    probabilities = [
        belief.probability(belief.odds("drag", fraction)) for fraction in (0.02, 0.2, 0.6, 1.0)
    ]
    assert (
        probabilities[0] > 0.9
        and probabilities[-1] < 0.5
        and sorted(probabilities, reverse=True) == probabilities
    )
    assert belief.odds("backlash", 0.6) > belief.odds(
        "drag", 0.6
    )  # simulated effects have larger model errors


def test_unexplained_fraction_with_an_overestimated_noise_floor(monkeypatch):
    def fraction(without: float, both: float) -> float:
        return shares(monkeypatch, ["drag"], both, [without])[0]

    assert fraction(11.0, 2.0) == pytest.approx(0.09)
    assert fraction(0.9, 0.02) < 0.1  # explained, whatever the noise
    assert 0.3 < fraction(0.9, 0.5) < 0.6  # undetermined
    assert fraction(1.6, 1.02) < fraction(1.6, 1.3)


def test_noise_limits_the_unexplained_fraction_of_a_weak_effect():
    assert belief.share(1.0, 9.0) == pytest.approx(0.09)
    assert belief.share(0.1, 0.2) < belief.share(0.25, 0.05)


def test_residual_within_the_uncertainty_of_the_noise_counts_less(monkeypatch):
    def fraction(level: float, bounds: tuple[float, float]) -> float:
        return shares(monkeypatch, ["drag"], level, [level + 1.0], bounds=bounds)[0]

    for level in (1.5, 0.7):
        exact, uncertain = fraction(level, (1.0, 1.0)), fraction(level, (0.6, 1.6))
        assert uncertain < 0.6 * exact  # closer to zero
        assert uncertain > 1.5 * fraction(1.0, (1.0, 1.0))
        assert exact < fraction(level, (1.0, 1.0)) * 1.001 <= fraction(level, (0.99, 1.01)) * 1.05
    assert fraction(3.0, (0.6, 1.6)) > 0.3  # more than the noise


def test_residual_of_two_effects_is_divided_between_them(monkeypatch):
    alone = shares(monkeypatch, ["position_friction"], 5.0, [60.0])[0]
    slight, strong = shares(
        monkeypatch, ["position_friction", "base_compliance"], 5.0, [60.0, 60.0]
    )
    assert slight < 0.8 * alone  # base compliance has ten times the model error
    whole = shares(monkeypatch, ["base_compliance"], 5.0, [60.0])[0]
    assert 0.95 * whole < strong < whole


def test_share_of_the_residual_decreases_with_the_number_of_effects(monkeypatch):
    def first(count: int) -> float:
        return shares(monkeypatch, ["drag"] * count, 5.0, [60.0] * count)[0]

    fractions = [first(count) for count in (1, 2, 3, 5)]
    assert sorted(fractions, reverse=True) == fractions
    part = fractions[0] / 5.0  # share of five effects
    assert 0.3 * fractions[0] < fractions[3] < 0.6 * fractions[0] and fractions[3] > part


def test_a_flexible_effect_is_attributed_the_entire_residual(monkeypatch):
    assert shares(monkeypatch, ["position_friction", "base_compliance"], 5.0, [15.0, 600.0])[
        0
    ] == pytest.approx(shares(monkeypatch, ["position_friction"], 5.0, [15.0])[0])
    transient = shares(
        monkeypatch, ["contact", "base_compliance"], 5.0, [15.0, 60.0], [True, False]
    )[0]
    assert transient == pytest.approx(shares(monkeypatch, ["contact"], 5.0, [15.0], [True])[0])


def test_gain_that_quantization_mimics_lowers_the_probability(monkeypatch):
    monkeypatch.setattr(belief, "shares", lambda *_: [(0.09, np.inf)])
    probabilities = []
    for mimicked in (0.0, 20.0, 45.0):
        regression = types.SimpleNamespace(
            shapes=(), measured=Measured({("stribeck", 0): mimicked})
        )
        weighed = belief.weighed(regression, only("stribeck"), np.ones(1), EXACT_NOISE)
        probabilities.append((*weighed.findings, *weighed.doubted)[0].probability)
    assert probabilities[0] > probabilities[1] > 0.5 > probabilities[2]


def test_a_rival_that_no_artefact_mimics_raises_the_probability(monkeypatch):
    monkeypatch.setattr(belief, "shares", lambda *_: [(0.09, np.inf)])
    probabilities = []
    rivals = {"hysteresis": 30.0}
    for here in (frozenset[str](), frozenset(rivals)):  # a rival at another joint does not count
        shapes = tuple(
            CandidateModel(effect, 0, unexpected_columns) for effect in ("delay", *rivals)
        )
        regression = types.SimpleNamespace(shapes=shapes, measured=Measured({("delay", 0): 45.0}))
        single = only("delay")
        verdict = dataclasses.replace(
            single, findings=(dataclasses.replace(single.findings[0], rivals=rivals, here=here),)
        )
        weighed = belief.weighed(regression, verdict, np.ones(1), EXACT_NOISE)
        probabilities.append((*weighed.findings, *weighed.doubted)[0].probability)
    assert probabilities[1] > 0.5 > probabilities[0]


def test_an_improbable_effect_is_rejected_with_its_probability(
    monkeypatch,
):
    monkeypatch.setattr(belief, "shares", lambda *_: [(0.8, np.inf)])
    regression = types.SimpleNamespace(shapes=(), measured=Measured())
    weighed = belief.weighed(regression, only("drag"), np.ones(1), EXACT_NOISE)
    assert not weighed.findings and weighed.together is None
    (rejected,) = weighed.doubted
    assert rejected.main.effect == "drag" and 0.0 < rejected.probability < 0.5


@pytest.mark.parametrize(("fraction", "raised"), [(0.01, True), (0.09, False)])
def test_a_certain_finding_raises_the_probability_of_others(monkeypatch, fraction, raised):
    """A spring with this unexplained fraction, and a ripple at another joint with a larger one."""
    monkeypatch.setattr(
        belief, "shares", lambda *_: [(fraction, np.inf), (0.15, np.inf)][: len(_[1].findings)]
    )
    regression = types.SimpleNamespace(shapes=(), measured=Measured())
    (spring,), (ripple,) = only("spring").findings, only("torque_ripple").findings
    both = dataclasses.replace(only("spring"), findings=(spring, ripple))
    weighed = belief.weighed(regression, both, np.ones(2), EXACT_NOISE)
    first, second = (*weighed.findings, *weighed.doubted)
    by_itself = belief.probability(belief.odds("torque_ripple", 0.15))
    assert (first.probability > belief.SURE) == raised
    assert (second.probability > by_itself + 0.05) == raised and second.probability >= by_itself
    assert first.probability == pytest.approx(
        belief.probability(belief.odds("spring", fraction))
    )  # a certain finding is not changed


def test_equivalents_are_effects_within_the_error_of_the_model_form():
    (finding,) = only("nonlinear_viscous").findings
    finding = judge.Finding(finding.parts, 100.0, {"drag": 99.0, "spring": 80.0, "stribeck": 20.0})
    assert tuple(belief.alike(finding, 0.1, EFFECTS_BY_NAME)) == ("drag", "spring")
    assert tuple(belief.alike(finding, 0.002, EFFECTS_BY_NAME)) == ("drag",)


def test_an_uncertain_finding_has_all_confusable_effects_as_equivalents():
    (finding,) = only("elasticity").findings
    finding = judge.Finding(finding.parts, 100.0, {"base_compliance": 10.0, "torque_ripple": 15.0})
    assert tuple(belief.alike(finding, 0.3, EFFECTS_BY_NAME)) == ()
    equivalents = belief.alike(finding, 0.5, EFFECTS_BY_NAME)
    assert tuple(equivalents) == (
        "backlash",
        "base_compliance",
    )  # neither effects with small model errors nor dissimilar ones
    assert "backlash" not in belief.alike(
        finding, 0.5, ("elasticity", "base_compliance")
    )  # backlash was not tried


def test_equivalents_include_those_of_a_rival():
    (finding,) = only("torque_ripple").findings
    finding = judge.Finding(finding.parts, 100.0, {"base_compliance": 50.0})
    assert not are_confusable("torque_ripple", "backlash")
    tried = ("spring", "backlash", "base_compliance", "elasticity", "drag")
    assert set(belief.alike(finding, 0.55, tried)) == {"base_compliance", "backlash", "elasticity"}


@pytest.mark.parametrize(
    ("strong", "level", "accepted"),
    [(1e4, 1.5, False), (1e4, 1.0, False), (200.0, 1.0, True), (50.0, 1.5, True)],
)
def test_the_model_error_of_a_strong_effect_is_no_further_effect(
    monkeypatch, strong, level, accepted
):
    """A ripple and a spring at the same joint; the ripple is smaller or larger than the usual model
    error of a spring."""
    shapes = tuple(
        CandidateModel(name, 0, unexpected_columns) for name in ("spring", "torque_ripple")
    )
    tried = search.Trial((0, 1), np.ones(2), (np.ones(1), np.ones(1)), 50.0, True)
    findings = tuple(
        judge.Finding((hypothesis.Hypothesis(s.effect, 0, i, tried, 1.0, True),), 50.0, {})
        for i, s in enumerate(shapes)
    )
    squares = {(0, 1): level, (1,): strong, (0,): 10.0}
    monkeypatch.setattr(hypothesis, "acting", lambda *_: np.array([True]))
    monkeypatch.setattr(search, "level", lambda _, chosen: np.array([squares[tuple(chosen)]]))
    regression = types.SimpleNamespace(shapes=shapes, measured=Measured())
    weighed = belief.weighed(
        regression, judge.Verdict(findings, tried, ()), np.ones(1), EXACT_NOISE
    )
    assert [f.main.effect for f in weighed.findings] == ["spring", "torque_ripple"][: 1 + accepted]


def test_a_joint_without_explained_torque_counts_against_an_effect(monkeypatch):
    """Base compliance explains much at one joint and nothing at another with a large residual."""
    tried = search.Trial((0,), np.ones(1), (np.ones(1), np.ones(1)), 50.0, True)
    verdict = judge.Verdict(
        (
            judge.Finding(
                (hypothesis.Hypothesis("base_compliance", None, 0, tried, 1.0, True),), 50.0, {}
            ),
        ),
        tried,
        (),
    )
    monkeypatch.setattr(hypothesis, "acting", lambda *_: np.array([True, True]))
    fractions = []
    for second in (29.0, 31.0):
        monkeypatch.setattr(
            search,
            "level",
            lambda _, chosen, second=second: np.array([1.2, 30.0] if chosen else [50.0, second]),
        )
        fractions += unexplained(
            (CandidateModel("base_compliance", None, unexpected_columns),), verdict, 2
        )
    assert fractions == pytest.approx([0.37, 0.37], abs=0.02)
