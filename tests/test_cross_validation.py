"""Prediction of the held-out torque with coefficients of the training recordings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic_recordings import unexpected_columns

from excite._types import FloatArray
from excite.diagnosis import held_out_test, judge, search
from excite.diagnosis.columns import Columns
from excite.diagnosis.half import Half, whitened
from excite.effects.effect import CandidateModel

ROWS = 300
ALL_ROWS, NO_TORQUE = np.ones((ROWS, 2), bool), Columns.of(np.zeros((ROWS, 2, 1)))


def regression_of_folds(
    shift: float, spread: float = 1.0, training_coefficient: float = 3.0, once: bool = False
) -> search.EffectRegression:
    """Return a regression with a drag at each joint and an offset in the base model.

    Args:
        shift: Shift of the drag's column at the second joint in the held-out fold.
        spread: Standard deviation of that column in each fold.
        training_coefficient: Coefficient of that column in the training fold; 3 in the other fold.
        once: True for a transient effect.
    """
    rng = np.random.default_rng(3)
    folds, columns = list[Half](), list[list[FloatArray]]()
    for number in (0, 1):
        x = rng.normal(size=(ROWS, 2)) * [1.0, spread]
        torque = 3.0 * x + rng.normal(size=(ROWS, 2)) + [0.0, 3.0 * shift * number]
        torque[:, 1] += (training_coefficient - 3.0) * x[:, 1] * (1 - number)
        base = np.broadcast_to(np.eye(2), (ROWS, 2, 2))
        folds.append(
            whitened([base], [torque], [ALL_ROWS], np.ones(2), (np.zeros((0, 2)), np.zeros(0)))
        )
        columns.append([x * [1.0, 0.0], (x + np.array([0.0, shift * number])) * [0.0, 1.0]])

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        first, second = (Columns.of(fold[shape.joint_index][:, :, None]) for fold in columns)
        return first, second

    shapes = [
        CandidateModel("drag", 0, unexpected_columns),
        CandidateModel("drag", 1, unexpected_columns, interval=(1.0, 2.0) if once else None),
    ]
    return search.design((folds[0], folds[1]), shapes, build)


def verdict_of(regression: search.EffectRegression) -> judge.Verdict:
    return held_out_test.tested(regression, judge.said(regression, [0, 1]), ALL_ROWS, np.ones(2))


DIFFERENT_OFFSETS = {"shift": 1.0, "spread": 0.01, "training_coefficient": -60.0}
"""An offset that differs between the folds; a nearly constant column may explain it."""


@pytest.mark.parametrize("training_coefficient", [3.0, 2.4, 0.5])
def test_findings_that_both_folds_show_are_kept(training_coefficient):
    verdict = verdict_of(regression_of_folds(0.0, training_coefficient=training_coefficient))
    assert {f.main.joint for f in verdict.findings} == {0, 1} and not verdict.doubted


def test_a_finding_that_worsens_the_held_out_prediction_is_rejected():
    regression = regression_of_folds(**DIFFERENT_OFFSETS)
    before = judge.said(regression, [0, 1])
    verdict = verdict_of(regression)
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


def test_a_coefficient_that_the_training_fold_does_not_determine_rejects_nothing(monkeypatch):
    regression = regression_of_folds(
        1.0, spread=0.01, training_coefficient=-8.0
    )  # two standard deviations from the coefficient of the other fold
    assert not verdict_of(regression).doubted
    monkeypatch.setattr(held_out_test, "CHANCE", 0.0)
    assert [f.main.joint for f in verdict_of(regression).doubted] == [1]


def test_a_zero_column_is_ignored():
    """For example of a force in a direction that has no effect on any joint."""
    regression = regression_of_folds(0.0)
    wider = search.appended(
        dataclasses.replace(regression, build=lambda _: (NO_TORQUE, NO_TORQUE)),
        [CandidateModel("contact", 1, unexpected_columns)],
    )
    assert not held_out_test.tested(
        wider, judge.said(wider, [0, 1, 2]), ALL_ROWS, np.ones(2)
    ).doubted


def test_a_contact_does_not_excuse_other_effects():
    """A contact in the held-out recording is known from that recording alone."""
    regression, touch = regression_of_folds(**DIFFERENT_OFFSETS), np.zeros((ROWS, 2, 1))
    touch[:20, 1] = 1.0
    wider = dataclasses.replace(regression, build=lambda _: (NO_TORQUE, Columns.of(touch)))
    wider = search.appended(
        wider, [CandidateModel("contact", 1, unexpected_columns, interval=(1.0, 2.0))]
    )
    verdict = held_out_test.tested(wider, judge.said(wider, [0, 1, 2]), ALL_ROWS, np.ones(2))
    assert "drag" in {f.main.effect for f in verdict.doubted if f.main.joint == 1}


def test_a_transient_effect_is_not_tested():
    assert not verdict_of(regression_of_folds(**DIFFERENT_OFFSETS, once=True)).doubted


def test_residuals_are_those_of_the_training_fit():
    regression = regression_of_folds(0.0)
    before, after = held_out_test.residuals(
        regression, search.trial(regression, [0, 1]), np.array([1.0, 2.0])
    )
    assert before.std(axis=0) == pytest.approx([np.sqrt(10.0), 2.0 * np.sqrt(10.0)], rel=0.15)
    assert after.std(axis=0) == pytest.approx([1.0, 2.0], rel=0.15)
    assert np.array_equal(
        held_out_test.residuals(regression, None, np.ones(2))[1], before / [1.0, 2.0]
    )


def test_a_regression_without_findings_is_unchanged():
    assert held_out_test.tested(
        regression_of_folds(0.0), judge.Verdict((), None, ()), ALL_ROWS, np.ones(2)
    ) == judge.Verdict((), None, ())
