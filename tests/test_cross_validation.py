"""What one half of the recordings foretells of the other, and findings that make it worse."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from excite.diagnosis import held_out_test, judge, search
from excite.diagnosis.columns import Columns
from excite.diagnosis.half import Half, whitened
from excite.effects.effect import CandidateModel
from excite.effects.recorded_motion import RecordedMotion

Array = np.ndarray
ROWS = 300
EVERY, NOTHING = np.ones((ROWS, 2), bool), Columns.of(np.zeros((ROWS, 2, 1)))


def nothing(track: RecordedMotion, shape: CandidateModel) -> Array:
    raise NotImplementedError


def halved(
    moved: float, spread: float = 1.0, bent: float = 3.0, once: bool = False
) -> search.EffectRegression:
    """A drag at either joint, and an offset that the base model has. At the second joint the drag's
    column is `moved` more in the other half and varies by `spread` in either, and the torque by
    three times that; in the first half by `bent` times. once: for some of the time."""
    rng = np.random.default_rng(3)
    halves, columns = list[Half](), list[list[Array]]()
    for number in (0, 1):
        x = rng.normal(size=(ROWS, 2)) * [1.0, spread]
        left = 3.0 * x + rng.normal(size=(ROWS, 2)) + [0.0, 3.0 * moved * number]
        left[:, 1] += (bent - 3.0) * x[:, 1] * (1 - number)
        base = np.broadcast_to(np.eye(2), (ROWS, 2, 2))
        halves.append(
            whitened([base], [left], [EVERY], np.ones(2), (np.zeros((0, 2)), np.zeros(0)))
        )
        columns.append([x * [1.0, 0.0], (x + np.array([0.0, moved * number])) * [0.0, 1.0]])

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        first, second = (Columns.of(own[shape.joint_index][:, :, None]) for own in columns)
        return first, second

    shapes = [
        CandidateModel("drag", 0, nothing),
        CandidateModel("drag", 1, nothing, interval=(1.0, 2.0) if once else None),
    ]
    return search.design((halves[0], halves[1]), shapes, build)


def left_by(one: search.EffectRegression) -> judge.Verdict:
    return held_out_test.tested(one, judge.said(one, [0, 1]), EVERY, np.ones(2))


ODD = {"moved": 1.0, "spread": 0.01, "bent": -60.0}
"""An offset that changes from half to half, which a column that hardly varies in either may
explain."""


@pytest.mark.parametrize("bent", [3.0, 2.4, 0.5])
def test_what_a_half_shows_by_itself_stays(bent):
    verdict = left_by(halved(0.0, bent=bent))
    assert {f.main.joint for f in verdict.findings} == {0, 1} and not verdict.doubted


def test_what_only_the_difference_between_halves_shows_and_makes_held_out_torque_worse_is_refuted_alone():  # noqa: E501
    one = halved(**ODD)
    before = judge.said(one, [0, 1])
    verdict = left_by(one)
    assert [f.main.joint for f in verdict.findings] == [0]
    assert verdict.together is not None and verdict.together.shapes == (0,)
    (refuted,) = verdict.doubted
    assert (
        refuted.main.joint == 1
        and refuted.probability < 0.5
        and refuted.evidence["foretold"] > held_out_test.WORSE
    )
    gains = {f.main.joint: f.gain for f in before.findings}
    assert gains[1] > 100.0 and verdict.findings[0].gain == pytest.approx(gains[0], rel=0.05)


def test_what_the_first_half_does_not_tell_refutes_nothing(monkeypatch):
    one = halved(
        1.0, spread=0.01, bent=-8.0
    )  # two standard deviations from what the other half has
    assert not left_by(one).doubted
    monkeypatch.setattr(held_out_test, "CHANCE", 0.0)
    assert [f.main.joint for f in left_by(one).doubted] == [1]


def test_a_column_of_nothing_is_no_matter():
    """Of a force, for one, in a direction that no joint feels."""
    one = halved(0.0)
    wider = search.appended(
        dataclasses.replace(one, build=lambda _: (NOTHING, NOTHING)),
        [CandidateModel("contact", 1, nothing)],
    )
    assert not held_out_test.tested(wider, judge.said(wider, [0, 1, 2]), EVERY, np.ones(2)).doubted


def test_a_touch_excuses_nobody():
    """What happened in the second recording is unknown to the first, and known from where it
    was."""
    one, touch = halved(**ODD), np.zeros((ROWS, 2, 1))
    touch[:20, 1] = 1.0
    wider = dataclasses.replace(one, build=lambda _: (NOTHING, Columns.of(touch)))
    wider = search.appended(wider, [CandidateModel("contact", 1, nothing, interval=(1.0, 2.0))])
    verdict = held_out_test.tested(wider, judge.said(wider, [0, 1, 2]), EVERY, np.ones(2))
    assert "drag" in {f.main.effect for f in verdict.doubted if f.main.joint == 1}


def test_what_happens_once_is_not_to_be_foretold():
    assert not left_by(halved(**ODD, once=True)).doubted


def test_residuals_are_those_of_the_first_halfs_fit():
    one = halved(0.0)
    before, after = held_out_test.residuals(one, search.trial(one, [0, 1]), np.array([1.0, 2.0]))
    assert before.std(axis=0) == pytest.approx([np.sqrt(10.0), 2.0 * np.sqrt(10.0)], rel=0.15)
    assert after.std(axis=0) == pytest.approx([1.0, 2.0], rel=0.15)
    assert np.array_equal(held_out_test.residuals(one, None, np.ones(2))[1], before / [1.0, 2.0])


def test_a_design_without_findings_has_nothing_to_test():
    assert held_out_test.tested(
        halved(0.0), judge.Verdict((), None, ()), EVERY, np.ones(2)
    ) == judge.Verdict((), None, ())
