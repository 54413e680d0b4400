"""Effects of a diagnosis as parts of the model: prediction, file, and removal from recordings."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis_cases import (
    EFFECTS,
    diagnose_effect,
    effect_entry,
    model_with_effects,
    recordings_of,
)
from synthetic_recordings import validated

from excite.diagnosis import fitted_effects
from excite.effects import recorded_motion
from excite.errors import UnusableInput


def test_a_fitted_effect_is_predicted_and_removed_from_the_recording(subject):
    result = diagnose_effect(subject, EFFECTS["stribeck"][0])
    assert result.parts and result.refitted is not None
    _, validate = recordings_of(subject, EFFECTS["stribeck"][0])
    without = fitted_effects.removed(result.parts, validate, result.motions[1])
    _, clean = recordings_of(subject, None)
    motion = result.motions[1][0]
    remaining = motion.band.filter(without.torque - clean.torque, recorded_motion.Grid.KEPT)[
        motion.kept
    ]
    effect = motion.band.filter(validate.torque - clean.torque, recorded_motion.Grid.KEPT)[
        motion.kept
    ]
    assert np.sqrt(np.mean(remaining**2)) < 0.25 * np.sqrt(np.mean(effect**2))
    restored = [
        fitted_effects.restored(validated(fitted_effects.entry(part, subject.robot)), subject.robot)
        for part in result.parts
    ]
    np.testing.assert_allclose(
        fitted_effects.torque(restored, motion), fitted_effects.torque(result.parts, motion)
    )
    before, after = result.ahead
    assert (
        before is not None
        and after is not None
        and after.fitted[-1].sum() < before.fitted[-1].sum()
    )


@pytest.mark.parametrize("seconds", [0.004, 0.012])
def test_a_torque_delay_is_applied_to_the_predicted_torque(subject, seconds):
    _, along = recordings_of(subject, None)
    spring = effect_entry("spring", "joint_2", {"form": 0.0}, 5.0)
    delayed_model = model_with_effects(
        subject, (spring, effect_entry("delay", None, {"measured": 1.0}, seconds))
    )
    t, undelayed = fitted_effects.predict(model_with_effects(subject, (spring,)), along)
    _, delayed = fitted_effects.predict(delayed_model, along)
    expected = np.column_stack([np.interp(t - seconds, t, column) for column in undelayed.T])
    inside = slice(200, -200)
    error = np.sqrt(np.mean((delayed - expected)[inside] ** 2, axis=0))
    assert np.all(error < 0.1 * np.sqrt(np.mean((undelayed - expected)[inside] ** 2, axis=0)))


@pytest.mark.parametrize(
    ("effect", "problem"),
    [
        (
            effect_entry("backlash", "joint_1", {"width": 1e-3}, 1.0),
            "values: 'backlash' should have width, hold, not width",
        ),
        (
            {
                key: v
                for key, v in effect_entry("drag", "joint_1", {}, 1.0).items()
                if key != "time"
            },
            "has no 'time'",
        ),
        (
            effect_entry("drag", "joint_1", {}, 1.0, 2.0),
            "coefficients: 'drag' should have 1, not 2",
        ),
        (effect_entry("slack", "joint_1", {}, 1.0), "effect: this version has no effect 'slack'"),
    ],
)
def test_an_effect_of_an_unknown_form_is_refused_in_one_line(effect, problem):
    with pytest.raises(UnusableInput, match=rf"model\.json: {problem}; diagnose again"):
        validated(effect)
