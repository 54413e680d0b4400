"""What was found, as a part of the model: predicted, written, read again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_recordings import FRICTION_WIDTH, perturbed_parameters
from test_diagnosis import PLANTED, found, recordings_of

from excite.diagnosis import fitted_effects
from excite.effects import recorded_motion
from excite.errors import UnusableInput
from excite.identification.identified_model import IdentifiedModel
from excite.identification.regression import IdentificationModel
from excite.schemas.document_file import DocumentFile
from excite.schemas.effects import EffectDocument

Array = np.ndarray


def validated(effect: dict[str, Any]) -> EffectDocument:
    file = DocumentFile(Path("model.json"), "a model", "diagnose again", "a model.json")
    return file.converted(effect, EffectDocument)


def test_what_was_found_is_predicted_and_gone_from_the_recording(subject):
    result = found(subject, PLANTED["stribeck"][0])
    assert result.parts and result.refitted is not None
    _, validate = recordings_of(subject, PLANTED["stribeck"][0])
    bare = fitted_effects.removed(result.parts, validate, result.motions[1])
    _, clean = recordings_of(subject, None)
    one = result.motions[1][0]
    apart = one.band.filter(bare.torque - clean.torque, recorded_motion.Grid.KEPT)[one.kept]
    hidden = one.band.filter(validate.torque - clean.torque, recorded_motion.Grid.KEPT)[one.kept]
    assert np.sqrt(np.mean(apart**2)) < 0.25 * np.sqrt(np.mean(hidden**2))
    again = [
        fitted_effects.restored(validated(fitted_effects.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    np.testing.assert_allclose(
        fitted_effects.torque(again, one), fitted_effects.torque(result.parts, one)
    )
    before, after = result.ahead
    assert (
        before is not None
        and after is not None
        and after.fitted[-1].sum() < before.fitted[-1].sum()
    )


def fitted_with(
    subject: IdentificationModel, effects: tuple[dict[str, Any], ...]
) -> IdentifiedModel:
    documents = tuple(validated(effect) for effect in effects)
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    return IdentifiedModel(
        "model.json",
        subject.robot,
        subject.parameters.drive,
        psi,
        np.full(2, FRICTION_WIDTH),
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
    t, early = fitted_effects.predict(fitted_with(subject, (spring,)), along)
    _, late = fitted_effects.predict(late_model, along)
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
