"""The model that a diagnosis saves: prediction, held-out errors, budget, withheld findings."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from diagnosis_cases import (
    HIDDEN,
    RATE,
    SUBJECT,
    diagnosed,
    effect_entry,
    inverted,
    model_with_effects,
    noise_ratios,
    recording_of,
    recordings_of,
    weak_torque,
)
from synthetic_recordings import validated, write_recording

import excite
from excite.api.diagnosis_result import DiagnosisResult
from excite.diagnosis import effect_curves, estimates, fitted_effects
from excite.diagnosis.budget import TorqueBudget, torque_budget
from excite.diagnosis.diagnosis_file import document
from excite.diagnosis.estimates import EffectEstimate
from excite.effects import torque_saturation
from excite.errors import UnusableInput
from excite.identification.lowpass import Grid, LowPassFilter
from excite.recordings import Remark, RemarkKind

PREDICTED = ("stribeck", "torque_ripple", "coupling", "delay")
"""Effects whose torque the saved model adds; a delay moves all of it."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Diagnose files of a robot with two effects; two held-out recordings, one after the other."""
    folder = tmp_path_factory.mktemp("saved")

    def both(*state):
        return HIDDEN["torque_ripple"].torque(*state) + HIDDEN["coupling"].torque(*state)

    train = write_recording(recording_of(both, 2), folder / "train.csv")
    for seed in (5, 8):
        held_out = write_recording(recording_of(both, seed), folder / f"{seed}.csv")
        result = excite.diagnose("two_link", [train], [held_out], with_report=False)
        result.save(folder / str(seed))
    return folder


@pytest.mark.filterwarnings("ignore:.*begins or ends in motion:excite.errors.ExciteWarning")
def test_the_model_file_predicts_with_the_stated_error(folder):
    """Measured torque below the cutoff, minus the torque that `excite predict` writes."""
    stated = json.loads((folder / "5" / "diagnosis.json").read_text())
    recording = excite.read_recording(folder / "5.csv", "two_link")
    predicted = excite.predict(folder / "5" / "model.json", folder / "5.csv")
    lowpass = LowPassFilter(stated["band_hz"], recording.rate, len(recording.t))
    measured = lowpass.filter(recording.torque, Grid.RECORDED)
    kept = slice(lowpass.margin, -lowpass.margin)
    at_rows = np.column_stack(
        [np.interp(recording.t, predicted.time, column) for column in predicted.torque.T]
    )
    residual = (measured - at_rows)[kept]
    moving = np.abs(np.gradient(recording.q, recording.t, axis=0))[kept] > 0.01
    rmse = [float(np.sqrt(np.mean(x[on] ** 2))) for x, on in zip(residual.T, moving.T, strict=True)]
    after = [entry["rmse_after"] for entry in stated["joints"].values()]
    before = [entry["rmse_before"] for entry in stated["joints"].values()]
    assert rmse == pytest.approx(after, rel=0.03) and max(before) > 3.0 * max(after)
    assert stated["model_check"] == pytest.approx(
        dict(zip(stated["joints"], after, strict=True)), rel=0.01
    )


def test_reported_parameters_are_those_of_the_saved_effects(folder):
    stated = json.loads((folder / "5" / "diagnosis.json").read_text())
    saved = json.loads((folder / "5" / "model.json").read_text())["effects"]
    (ripple,) = (f for f in stated["findings"] if f["effect"] == "torque_ripple")
    waves = [
        np.hypot(*e["coefficients"][:2])
        for e in saved
        if (e["effect"], e["joint"]) == ("torque_ripple", ripple["joint"])
    ]
    assert ripple["parameters"]["amplitude"]["value"] == pytest.approx(max(waves), rel=1e-9)


@pytest.mark.parametrize("name", ["torque_ripple", "spring"])
def test_errors_contain_the_distance_of_the_saved_effect_from_the_joint_model(name):
    """Saved coefficients of 1.5 times the fitted ones: an error of half of the joint model's."""
    result = diagnosed(name)
    (finding,) = (f for f in result.findings if f.effect == name)

    def reported(factor: float) -> EffectEstimate:
        effects = tuple(
            dataclasses.replace(e, coefficients=factor * e.coefficients)
            for e in result.final.effects
        )
        final = dataclasses.replace(result.final, effects=effects)
        (out,) = estimates.as_saved([finding], final)
        return out

    saved, larger = reported(1.0), reported(1.5)
    (value, std), (larger_value, larger_std) = (x.parameters["amplitude"] for x in (saved, larger))
    assert larger_value == pytest.approx(1.5 * value)
    assert larger_std > 0.45 * value > std
    in_joint_model = dataclasses.replace(finding, saved=())
    before, curve, joint = (
        effect_curves.effect_curve(result.model, x, "position")
        for x in (saved, larger, in_joint_model)
    )
    torque = np.array(curve["torque"])
    np.testing.assert_allclose(torque, 1.5 * np.array(before["torque"]))
    assert (np.array(curve["std"]) >= np.abs(torque - np.array(joint["torque"]))).all()


def test_held_out_recordings_change_neither_findings_nor_the_model(folder):
    models, documents = (
        [json.loads((folder / seed / name).read_text()) for seed in ("5", "8")]
        for name in ("model.json", "diagnosis.json")
    )
    assert models[0] == models[1]
    keys = ("effect", "joint", "probability", "equivalents", "parameters", "curve")
    first, second = (
        [{key: f[key] for key in keys} for f in stated["findings"]] for stated in documents
    )
    assert first == second and len(first) == 2
    assert documents[0]["joints"] != documents[1]["joints"]


@pytest.mark.parametrize("name", [None, *PREDICTED])
def test_the_shares_of_the_torque_budget_sum_to_1(name):
    stated = document(diagnosed(name))
    for joint, shares in stated["budget"].items():
        assert sum(entry["share"] for entry in shares.values()) == pytest.approx(1.0)
        assert all(entry["std"] >= 0.0 for entry in shares.values())
        joint_number = SUBJECT.robot.joints.index(joint)
        if name is not None and HIDDEN[name].joint == joint_number:
            assert shares[name]["share"] > 0.8
            assert shares["residual"]["share"] < 0.2


def test_a_share_is_as_uncertain_in_one_wave_as_in_several():
    result = diagnosed("torque_ripple")
    motions = result.model.motions, result.held_out.motions

    def budget(parts: int) -> TorqueBudget:
        effects = tuple(
            dataclasses.replace(effect, coefficients=effect.coefficients / parts)
            for effect in result.final.effects
            for _ in range(parts)
        )
        final = dataclasses.replace(result.final, effects=effects)
        return torque_budget(result.identified, motions, final, result.effects, result.held_out)

    whole, parted = budget(1), budget(3)
    assert whole.std["torque_ripple"].max() > 0.0
    for name, std in whole.std.items():
        np.testing.assert_allclose(parted.std[name], std, rtol=1e-9)
        np.testing.assert_allclose(parted.shares[name], whole.shares[name], rtol=1e-9)


@pytest.mark.parametrize("name", ["stribeck", "coupling"])
def test_what_no_share_of_the_budget_removes_is_the_error_of_the_saved_model(name):
    """Base parameters that were fitted jointly with the effects are a part of the budget."""
    result = diagnosed(name)
    base, final = result.held_out.base, result.held_out.final
    remaining = np.sum(final * base, axis=0) / np.sum(base**2, axis=0)
    budget = document(result)["budget"].values()
    assert [shares["residual"]["share"] for shares in budget] == pytest.approx(remaining)
    assert all(0.0 < shares["base_parameters"]["std"] < 0.1 for shares in budget)


def test_findings_of_doubted_recordings_are_withheld_from_document_and_model():
    train, held_out = recordings_of(HIDDEN["coupling"].torque)
    doubted = dataclasses.replace(
        train, remarks=(Remark(RemarkKind.GRAVITY, "gravity may be missing", doubt=True),)
    )
    result = DiagnosisResult(diagnosed("coupling"), (doubted,), (held_out,), with_report=False)
    stated, model = result.document(), result.model()
    assert stated["findings"] == [] and model["effects"] == []
    assert [entry["effect"] for entry in stated["considered"]][:1] == ["coupling"]
    assert stated["verdict"] == "unexplained" and stated["doubts"]
    for joint, entry in stated["joints"].items():
        assert entry["rmse_after"] == entry["rmse_before"] == stated["model_check"][joint]
        assert entry["unexplained_share"] == entry["systematic_share"]
        assert stated["budget"][joint] == {"residual": {"share": 1.0, "std": 0.0}}
    fitted = {row["name"]: row["value"] for row in model["standard_parameters"]}
    assert fitted == pytest.approx(model["without_effects"])
    trusted = DiagnosisResult(diagnosed("coupling"), (train,), (held_out,), with_report=False)
    assert trusted.model()["effects"] and trusted.document()["findings"]


@pytest.mark.parametrize("name", [*PREDICTED, "hysteresis", "position_friction", "spring"])
def test_saved_effects_are_read_back_with_the_same_torque(name):
    result = diagnosed(name)
    saved = result.final.saved_effects
    assert any(effect.shape.effect == name for effect in saved)
    restored = [
        fitted_effects.restored(validated(fitted_effects.entry(part, SUBJECT.robot)), SUBJECT.robot)
        for part in saved
    ]
    for motion in result.final.motions:
        np.testing.assert_allclose(*(fitted_effects.torque(x, motion) for x in (restored, saved)))
    assert (noise_ratios(result)[1] < 1.4).all()


def test_known_effects_leave_nothing_at_the_edge_of_the_band():
    """Filtered before it is subtracted, their torque would be filtered twice, and a part remain."""
    along = recording_of(None, 5)
    values = {"order": 80.0, "load": 1.0}
    model = model_with_effects(effect_entry("torque_ripple", "joint_2", values, 1.0, 0.0, 0.0, 0.0))
    (_, with_ripple), (_, plain) = (
        fitted_effects.predict(m, along) for m in (model, model_with_effects())
    )
    known = (with_ripple - plain)[:, 1]
    removed = (along.torque - fitted_effects.without_effects(model, along).torque)[:, 1]
    band = LowPassFilter(model.hertz, RATE, len(removed))
    inside = slice(int(0.4 * RATE), -int(0.4 * RATE))
    left = (band.filter(removed, Grid.RECORDED) - known)[inside]
    assert np.std(left) < 1e-3 * np.std(known[inside])


@pytest.mark.parametrize("seconds", [0.004, 0.012])
def test_a_delay_is_applied_to_the_predicted_torque(seconds):
    along = recording_of(None, 5)
    spring = effect_entry("spring", "joint_2", {"form": 0.0}, 5.0)
    late = effect_entry("delay", None, {"measured": 1.0}, seconds)
    t, prompt = fitted_effects.predict(model_with_effects(spring), along)
    _, delayed = fitted_effects.predict(model_with_effects(spring, late), along)
    expected = np.column_stack([np.interp(t - seconds, t, column) for column in prompt.T])
    inside = slice(int(0.4 * RATE), -int(0.4 * RATE))
    error, moved = (np.std((x - expected)[inside], axis=0) for x in (delayed, prompt))
    assert (error < 0.1 * moved).all()


def test_a_torque_loss_is_applied_to_the_predicted_torque():
    along, loss = recording_of(None, 5), {"power": 3.0, "largest": 40.0, "measured": 1.0}
    effect = effect_entry("torque_saturation", "joint_1", loss, 0.15)
    _, produced = fitted_effects.predict(model_with_effects(), along)
    _, recorded = fitted_effects.predict(model_with_effects(effect), along)
    expected = inverted(produced[:, 0], weak_torque)
    inner = slice(int(0.2 * RATE), -int(0.2 * RATE))
    error = np.abs(recorded[inner, 0] - expected[inner]).max()
    assert error < 0.05 * np.abs(expected - produced[:, 0]).max()
    assert np.array_equal(recorded[:, 1], produced[:, 1])
    beyond = torque_saturation.recorded_torque(0.9, loss, np.array([-1e3, 0.0, 1e3]))
    assert np.isfinite(beyond).all() and beyond[2] == -beyond[0] >= 1e3 and beyond[1] == 0.0


@pytest.mark.parametrize(
    ("effect", "problem"),
    [
        (
            effect_entry("backlash", "joint_1", {"width": 1e-3}, 1.0),
            "values: 'backlash' should have width, hold, not width",
        ),
        (
            {k: v for k, v in effect_entry("drag", "joint_1", {}, 1.0).items() if k != "time"},
            "has no 'time'",
        ),
        (
            effect_entry("drag", "joint_1", {}, 1.0, 2.0),
            "coefficients: 'drag' should have 1, not 2",
        ),
        (effect_entry("slack", "joint_1", {}, 1.0), "effect: this version has no effect 'slack'"),
        (effect_entry("drag", None, {}, 1.0), "joint: 'drag' needs a joint, not null"),
    ],
)
def test_an_effect_of_an_unknown_form_is_refused_in_one_line(effect, problem):
    with pytest.raises(UnusableInput, match=rf"model\.json: {problem}; diagnose again"):
        validated(effect)
