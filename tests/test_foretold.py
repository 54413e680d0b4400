"""What one half of the recordings foretells of the other, and findings that make it worse."""

from __future__ import annotations

import numpy as np
import pytest

from excite.diagnose import foretold, judge, search
from excite.diagnose.columns import Columns
from excite.diagnose.effect import Shape
from excite.diagnose.half import Half, whitened
from excite.diagnose.track import Track

Array = np.ndarray
ROWS = 300
EMPTY = (np.zeros((0, 1)), np.zeros(0))
EVERY = np.ones((ROWS, 2), bool)


def nothing(track: Track, shape: Shape) -> Array:
    raise NotImplementedError


def halved(turned: float, once: bool = False) -> search.Design:
    """A drag at either joint. At the second the other half has it `turned` times as large. once: for some of the time only."""
    rng = np.random.default_rng(3)
    halves, columns = list[Half](), list[list[Array]]()
    for by in (1.0, turned):
        x = rng.normal(size=(ROWS, 2))
        left = 3.0 * x * [1.0, by] + rng.normal(size=(ROWS, 2))
        halves.append(whitened([np.ones((ROWS, 2, 1))], [left], [EVERY], np.ones(2), EMPTY))
        columns.append([x * [1.0, 0.0], x * [0.0, 1.0]])

    def build(shape: Shape) -> tuple[Columns, Columns]:
        first, second = (Columns.of(own[shape.place][:, :, None]) for own in columns)
        return first, second

    shapes = [Shape("drag", 0, nothing), Shape("drag", 1, nothing, interval=(1.0, 2.0) if once else None)]
    return search.design((halves[0], halves[1]), shapes, build)


def left_by(one: search.Design) -> judge.Verdict:
    return foretold.tested(one, judge.said(one, [0, 1]), EVERY, np.ones(2))


def test_what_helps_either_half_stays():
    verdict = left_by(halved(0.8))
    assert {f.main.joint for f in verdict.findings} == {0, 1} and not verdict.doubted


def test_what_makes_held_out_torque_worse_is_refuted_and_what_is_beside_it_is_not():
    one = halved(0.2)
    before = judge.said(one, [0, 1])
    verdict = left_by(one)
    assert [f.main.joint for f in verdict.findings] == [0]
    assert verdict.together is not None and verdict.together.shapes == (0,)
    (refuted,) = verdict.doubted
    assert refuted.main.joint == 1 and refuted.probability < 0.5 and refuted.evidence["foretold"] > foretold.WORSE
    gains = {f.main.joint: f.gain for f in before.findings}
    assert verdict.findings[0].gain == pytest.approx(gains[0], rel=0.05)


def test_what_happens_once_is_not_to_be_foretold():
    assert not left_by(halved(0.2, once=True)).doubted


def test_residuals_are_those_of_the_first_halfs_fit():
    one = halved(1.0)
    before, after = foretold.residuals(one, search.trial(one, [0, 1]), np.array([1.0, 2.0]))
    assert before.std(axis=0) == pytest.approx([np.sqrt(10.0), 2.0 * np.sqrt(10.0)], rel=0.15)
    assert after.std(axis=0) == pytest.approx([1.0, 2.0], rel=0.15)
    assert np.array_equal(foretold.residuals(one, None, np.ones(2))[1], before / [1.0, 2.0])


def test_a_design_without_findings_has_nothing_to_test():
    one = halved(1.0)
    assert foretold.tested(one, judge.Verdict((), None, ()), EVERY, np.ones(2)) == judge.Verdict((), None, ())
