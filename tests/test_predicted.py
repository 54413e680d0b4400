"""What was found, as a part of the model: predicted, written, read again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made import WIDTH, perturbed, validated
from test_diagnose import PLANTED, found, recordings_of

from excite.diagnosis import whole
from excite.effects import track
from excite.errors import UnusableInput
from excite.identification.identified_model import FittedModel
from excite.identification.regression import Model

Array = np.ndarray


def test_what_was_found_is_predicted_and_gone_from_the_recording(subject):
    result = found(subject, PLANTED["stribeck"][0])
    assert result.parts and result.refitted is not None
    _, validate = recordings_of(subject, PLANTED["stribeck"][0])
    bare = whole.removed(result.parts, validate, result.tracks[1])
    _, clean = recordings_of(subject, None)
    one = result.tracks[1][0]
    apart = one.band.low(bare.torque - clean.torque, track.Grid.KEPT)[one.kept]
    hidden = one.band.low(validate.torque - clean.torque, track.Grid.KEPT)[one.kept]
    assert np.sqrt(np.mean(apart**2)) < 0.25 * np.sqrt(np.mean(hidden**2))
    again = [
        whole.restored(validated(whole.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    np.testing.assert_allclose(whole.torque(again, one), whole.torque(result.parts, one))
    before, after = result.ahead
    assert (
        before is not None
        and after is not None
        and after.fitted[-1].sum() < before.fitted[-1].sum()
    )


def fitted_with(subject: Model, effects: tuple[dict[str, Any], ...]) -> FittedModel:
    documents = tuple(validated(effect) for effect in effects)
    psi = perturbed(subject.parameters, np.random.default_rng(4))
    return FittedModel(
        "model.json",
        subject.robot,
        subject.parameters.drive,
        psi,
        np.full(2, WIDTH),
        20.0,
        documents,
    )


def stated(
    effect: str, joint: str | None, values: dict[str, float], *coefficients: float
) -> dict[str, Any]:
    return {
        "effect": effect,
        "joint": joint,
        "from": None,
        "values": values,
        "coefficients": list(coefficients),
        "time": None,
        "recording": None,
    }


@pytest.mark.parametrize("seconds", [0.004, 0.012])
def test_a_measured_delay_is_predicted_from_what_is_predicted(subject, seconds):
    _, along = recordings_of(subject, None)
    spring = stated("spring", "joint_2", {"form": 0.0}, 5.0)
    late_model = fitted_with(subject, (spring, stated("delay", None, {"measured": 1.0}, seconds)))
    t, early = whole.predict(fitted_with(subject, (spring,)), along)
    _, late = whole.predict(late_model, along)
    expected = np.column_stack([np.interp(t - seconds, t, column) for column in early.T])
    inside = slice(200, -200)
    left = np.sqrt(np.mean((late - expected)[inside] ** 2, axis=0))
    assert np.all(left < 0.1 * np.sqrt(np.mean((early - expected)[inside] ** 2, axis=0)))


@pytest.mark.parametrize(
    ("effect", "problem"),
    [
        (
            stated("backlash", "joint_1", {"width": 1e-3}, 1.0),
            "values: 'backlash' should have width, hold, not width",
        ),
        (
            {key: v for key, v in stated("drag", "joint_1", {}, 1.0).items() if key != "time"},
            "has no 'time'",
        ),
        (
            stated("drag", "joint_1", {}, 1.0, 2.0),
            "coefficients: 'drag' should have 1, not 2",
        ),
        (stated("slack", "joint_1", {}, 1.0), "effect: this version has no effect 'slack'"),
    ],
)
def test_a_model_of_an_earlier_version_is_refused_in_one_line(effect, problem):
    with pytest.raises(UnusableInput, match=rf"model\.json: {problem}; diagnose again"):
        validated(effect)
