"""How often a finding is right, by what it leaves of what it should explain."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Sequence

import numpy as np
import pytest

from excite.diagnosis import belief, hypothesis, judge, search
from excite.diagnosis.measured import Measured
from excite.effects import EFFECTS_BY_NAME, are_confusable
from excite.effects.effect import CandidateModel
from excite.effects.recorded_motion import RecordedMotion

Array = np.ndarray
SURE = (np.ones(1), np.ones(1))
"""Bounds of noise that is known."""
TRIED = search.Trial((0,), np.ones(1), (np.ones(1), np.ones(1)), 50.0, True)


def nothing(track: RecordedMotion, shape: CandidateModel) -> Array:
    raise NotImplementedError


def only(effect: str) -> judge.Verdict:
    """Nothing but one effect, at the first joint."""
    return judge.Verdict(
        (judge.Finding((hypothesis.Hypothesis(effect, 0, 0, TRIED, 1.0, True),), 50.0, {}),),
        TRIED,
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
    """What each of some effects leaves on a joint where mean squares over the noise are as stated,
    with all and without each.

    once: which of them happen for some of the time. bounds: of the noise, over what it is told to
        be.
    """
    places = tuple(range(len(effects)))
    intervals = [(1.0, 2.0) if happens else None for happens in once or [False] * len(effects)]
    shapes = tuple(
        CandidateModel(name, 0, nothing, interval=own)
        for name, own in zip(effects, intervals, strict=True)
    )
    tried = search.Trial(places, np.ones(len(effects)), (np.ones(1), np.ones(1)), 50.0, True)
    findings = tuple(
        judge.Finding((hypothesis.Hypothesis(name, 0, i, tried, 1.0, True),), 50.0, {})
        for i, name in enumerate(effects)
    )

    def level(_: object, chosen: Sequence[int]) -> Array:
        (gone,) = set(places) - set(chosen) or {None}
        return np.array([both if gone is None else without[gone]])

    monkeypatch.setattr(hypothesis, "acting", lambda *_: np.array([True]))
    monkeypatch.setattr(search, "level", level)
    return told_of(shapes, judge.Verdict(findings, tried, ()), bounds=bounds)


def told_of(
    shapes: Sequence[CandidateModel],
    verdict: judge.Verdict,
    joints: int = 1,
    bounds: tuple[float, float] = (1.0, 1.0),
) -> list[float]:
    one = types.SimpleNamespace(shapes=shapes)
    within = np.full(joints, bounds[0]), np.full(joints, bounds[1])
    return [x for x, _ in belief.shares(one, verdict, np.ones(joints), within)]  # type: ignore[arg-type]


def test_probabilities_fall_with_what_speaks_against_a_name():
    said = [belief.probability(belief.odds("drag", left)) for left in (0.02, 0.2, 0.6, 1.0)]
    assert said[0] > 0.9 and said[-1] < 0.5 and sorted(said, reverse=True) == said
    assert belief.odds("backlash", 0.6) > belief.odds(
        "drag", 0.6
    )  # a simulation leaves more where it is right


def test_what_a_name_leaves_is_told_where_noise_was_taken_for_more_than_it_is(monkeypatch):
    def left(without: float, both: float) -> float:
        return shares(monkeypatch, ["drag"], both, [without])[0]

    assert left(11.0, 2.0) == pytest.approx(0.09)
    assert left(0.9, 0.02) < 0.1  # all of it is explained, whatever the noise
    assert 0.3 < left(0.9, 0.5) < 0.6  # nobody knows
    assert left(1.6, 1.02) < left(1.6, 1.3)


def test_noise_hides_how_much_a_slight_effect_leaves():
    assert belief.share(1.0, 9.0) == pytest.approx(0.09)
    assert belief.share(0.1, 0.2) < belief.share(0.25, 0.05)


def test_what_may_be_noise_speaks_less_against_a_name(monkeypatch):
    def left(level: float, bounds: tuple[float, float]) -> float:
        return shares(monkeypatch, ["drag"], level, [level + 1.0], bounds=bounds)[0]

    for level in (1.5, 0.7):
        sure, unsure = left(level, (1.0, 1.0)), left(level, (0.6, 1.6))
        assert unsure < 0.6 * sure  # halfway to nothing, not there
        assert unsure > 1.5 * left(1.0, (1.0, 1.0))
        assert sure < left(level, (1.0, 1.0)) * 1.001 <= left(level, (0.99, 1.01)) * 1.05
    assert left(3.0, (0.6, 1.6)) > 0.3  # more than noise can be


def test_of_what_two_leave_neither_is_charged_with_all(monkeypatch):
    alone = shares(monkeypatch, ["position_friction"], 5.0, [60.0])[0]
    slight, strong = shares(
        monkeypatch, ["position_friction", "base_compliance"], 5.0, [60.0, 60.0]
    )
    assert slight < 0.8 * alone  # a rocking base leaves ten times as much of its own
    whole = shares(monkeypatch, ["base_compliance"], 5.0, [60.0])[0]
    assert 0.95 * whole < strong < whole


def test_the_more_are_at_work_the_less_each_is_charged_with_what_all_leave(monkeypatch):
    def first(count: int) -> float:
        return shares(monkeypatch, ["drag"] * count, 5.0, [60.0] * count)[0]

    charged = [first(count) for count in (1, 2, 3, 5)]
    assert sorted(charged, reverse=True) == charged
    part = charged[0] / 5.0  # what such a law leaves of all that five do
    assert 0.3 * charged[0] < charged[3] < 0.6 * charged[0] and charged[3] > part


def test_what_may_mend_another_is_charged_with_all_that_is_left(monkeypatch):
    assert shares(monkeypatch, ["position_friction", "base_compliance"], 5.0, [15.0, 600.0])[
        0
    ] == pytest.approx(shares(monkeypatch, ["position_friction"], 5.0, [15.0])[0])
    once = shares(monkeypatch, ["contact", "base_compliance"], 5.0, [15.0, 60.0], [True, False])[0]
    assert once == pytest.approx(shares(monkeypatch, ["contact"], 5.0, [15.0], [True])[0])


def test_what_an_encoder_may_feign_of_a_gain_speaks_for_no_name(monkeypatch):
    monkeypatch.setattr(belief, "shares", lambda *_: [(0.09, np.inf)])
    said = []
    for feigned in (0.0, 20.0, 45.0):
        one = types.SimpleNamespace(shapes=(), measured=Measured({("stribeck", 0): feigned}))
        weighed = belief.weighed(one, only("stribeck"), np.ones(1), SURE)  # type: ignore[arg-type]
        said.append((*weighed.findings, *weighed.doubted)[0].probability)
    assert said[0] > said[1] > 0.5 > said[2]


def test_what_no_fault_feigns_vouches_for_what_says_the_same(monkeypatch):
    monkeypatch.setattr(belief, "shares", lambda *_: [(0.09, np.inf)])
    said = []
    rivals = {"hysteresis": 30.0}
    for here in (frozenset[str](), frozenset(rivals)):  # another joint's does not vouch for it
        shapes = tuple(CandidateModel(effect, 0, nothing) for effect in ("delay", *rivals))
        one = types.SimpleNamespace(shapes=shapes, measured=Measured({("delay", 0): 45.0}))
        alone = only("delay")
        verdict = dataclasses.replace(
            alone, findings=(dataclasses.replace(alone.findings[0], rivals=rivals, here=here),)
        )
        weighed = belief.weighed(one, verdict, np.ones(1), SURE)  # type: ignore[arg-type]
        said.append((*weighed.findings, *weighed.doubted)[0].probability)
    assert said[1] > 0.5 > said[0]


def test_what_is_likelier_wrong_than_right_is_told_with_its_probability_and_not_asserted(
    monkeypatch,
):
    monkeypatch.setattr(belief, "shares", lambda *_: [(0.8, np.inf)])
    one = types.SimpleNamespace(shapes=(), measured=Measured())
    weighed = belief.weighed(one, only("drag"), np.ones(1), SURE)  # type: ignore[arg-type]
    assert not weighed.findings and weighed.together is None
    (doubted,) = weighed.doubted
    assert doubted.main.effect == "drag" and 0.0 < doubted.probability < 0.5


@pytest.mark.parametrize(("left", "raised"), [(0.01, True), (0.09, False)])
def test_what_stands_beside_a_sure_name_is_likelier_a_name_too(monkeypatch, left, raised):
    """A spring that leaves this much, beside a ripple at another joint that leaves more."""
    monkeypatch.setattr(
        belief, "shares", lambda *_: [(left, np.inf), (0.15, np.inf)][: len(_[1].findings)]
    )
    one = types.SimpleNamespace(shapes=(), measured=Measured())
    (spring,), (ripple,) = only("spring").findings, only("torque_ripple").findings
    both = dataclasses.replace(only("spring"), findings=(spring, ripple))
    weighed = belief.weighed(one, both, np.ones(2), SURE)  # type: ignore[arg-type]
    first, second = (*weighed.findings, *weighed.doubted)
    by_itself = belief.probability(belief.odds("torque_ripple", 0.15))
    assert (first.probability > belief.SURE) == raised
    assert (second.probability > by_itself + 0.05) == raised and second.probability >= by_itself
    assert first.probability == pytest.approx(
        belief.probability(belief.odds("spring", left))
    )  # of what is sure, nothing more is said


def test_equivalents_are_the_names_within_reach_of_a_wrong_form():
    (finding,) = only("nonlinear_viscous").findings
    finding = judge.Finding(finding.parts, 100.0, {"drag": 99.0, "spring": 80.0, "stribeck": 20.0})
    assert tuple(belief.alike(finding, 0.1, EFFECTS_BY_NAME)) == ("drag", "spring")
    assert tuple(belief.alike(finding, 0.002, EFFECTS_BY_NAME)) == ("drag",)


def test_what_is_barely_told_is_told_with_all_that_it_is_taken_for():
    (finding,) = only("elasticity").findings
    finding = judge.Finding(finding.parts, 100.0, {"base_compliance": 10.0, "torque_ripple": 15.0})
    assert tuple(belief.alike(finding, 0.3, EFFECTS_BY_NAME)) == ()
    barely = belief.alike(finding, 0.5, EFFECTS_BY_NAME)
    assert tuple(barely) == (
        "backlash",
        "base_compliance",
    )  # a play may leave all; neither what leaves little, nor what looks otherwise
    assert "backlash" not in belief.alike(
        finding, 0.5, ("elasticity", "base_compliance")
    )  # that was not tried


def test_what_is_told_with_a_name_brings_what_it_is_taken_for_itself():
    (finding,) = only("torque_ripple").findings
    finding = judge.Finding(finding.parts, 100.0, {"base_compliance": 50.0})
    assert not are_confusable("torque_ripple", "backlash")
    tried = ("spring", "backlash", "base_compliance", "elasticity", "drag")
    assert set(belief.alike(finding, 0.55, tried)) == {"base_compliance", "backlash", "elasticity"}


@pytest.mark.parametrize(
    ("strong", "left", "told"),
    [(1e4, 1.5, False), (1e4, 1.0, False), (200.0, 1.0, True), (50.0, 1.5, True)],
)
def test_what_another_law_may_leave_is_no_further_effect_though_it_is_taken_whole(
    monkeypatch, strong, left, told
):
    """A ripple beside a spring at the same joint, of less or more than springs usually leave, and
    what is left then."""
    shapes = tuple(CandidateModel(name, 0, nothing) for name in ("spring", "torque_ripple"))
    tried = search.Trial((0, 1), np.ones(2), (np.ones(1), np.ones(1)), 50.0, True)
    findings = tuple(
        judge.Finding((hypothesis.Hypothesis(s.effect, 0, i, tried, 1.0, True),), 50.0, {})
        for i, s in enumerate(shapes)
    )
    squares = {(0, 1): left, (1,): strong, (0,): 10.0}
    monkeypatch.setattr(hypothesis, "acting", lambda *_: np.array([True]))
    monkeypatch.setattr(search, "level", lambda _, chosen: np.array([squares[tuple(chosen)]]))
    one = types.SimpleNamespace(shapes=shapes, measured=Measured())
    weighed = belief.weighed(one, judge.Verdict(findings, tried, ()), np.ones(1), SURE)  # type: ignore[arg-type]
    assert [f.main.effect for f in weighed.findings] == ["spring", "torque_ripple"][: 1 + told]


def test_a_joint_where_nothing_is_taken_speaks_against_who_acts_there(monkeypatch):
    """A rocking base takes much at one joint and nothing at another, which is loud."""
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
    told = []
    for second in (29.0, 31.0):
        monkeypatch.setattr(
            search,
            "level",
            lambda _, chosen, second=second: np.array([1.2, 30.0] if chosen else [50.0, second]),
        )
        told += told_of((CandidateModel("base_compliance", None, nothing),), verdict, 2)
    assert told == pytest.approx([0.37, 0.37], abs=0.02)
