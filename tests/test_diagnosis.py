"""Diagnosis of simulated two-link robots with known effects, and of unusable input."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from contract import EFFECT_NAMES
from diagnosis_cases import (
    EFFECTS,
    Effect,
    at_joint,
    diagnose_effect,
    maxwell_slip_force,
    recordings_of,
    shaft_friction,
)
from scipy import signal
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from synthetic_recordings import (
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    write_recording,
)

from excite import effects
from excite._types import FloatArray
from excite.cli import main as main_module
from excite.diagnosis import belief, diagnosis, interval
from excite.diagnosis.diagnosis_file import document
from excite.effects import EFFECTS_BY_NAME
from excite.errors import UnusableInput
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries


@pytest.mark.parametrize("name", list(EFFECTS))
def test_a_simulated_effect_is_reported_and_modelled(subject, name):
    effect, joint = EFFECTS[name]
    result = diagnose_effect(subject, effect)
    assert result.verdict.chosen and result.verdict.chosen[0].effect == name
    assert joint is None or result.verdict.chosen[0].joint == joint
    assert len(result.verdict.chosen) == 1 and not result.unknown
    assert np.all(result.after < 1.4 * result.floor) and np.any(result.before > 1.5 * result.floor)


def test_a_robot_without_effects_has_no_findings(subject):
    result = diagnose_effect(subject, None)
    assert result.name == "no-mismatch" and not result.verdict.chosen and not result.unknown
    assert np.allclose(result.after, result.floor, rtol=0.25)


class Paused(FourierSeries):
    """A motion that stops for a second, twice per period."""

    def samples(self, t: FloatArray) -> Samples:
        pace = np.linspace(0.0, self.period, 20001)
        speed = np.clip(np.abs(np.sin(2.0 * np.pi * pace / self.period)) - 0.2, 0.0, None)
        speed *= self.period / np.trapezoid(speed, pace)
        clock = CubicSpline(pace, cumulative_trapezoid(speed, pace, initial=0.0))
        turns, within = np.divmod(t, self.period)
        s, rate, change = (
            clock(within) + turns * self.period,
            clock(within, 1)[:, None],
            clock(within, 2)[:, None],
        )
        along = super().samples(s)
        return Samples(along.q, along.dq * rate, along.ddq * rate**2 + along.dq * change)


def test_static_friction_at_rest_is_no_mismatch(subject):
    psi, pair = perturbed_parameters(subject.parameters, np.random.default_rng(4)), []
    for seed in (2, 5):
        plain = random_fourier(2, seed)
        paused = Paused(plain.sine, plain.cosine, plain.offset, 2.0 * plain.period)
        recording = synthetic_recording(subject, psi, paused, 1.3, 0.1)
        s = paused.samples(recording.t)
        still = np.abs(s.dq).max(axis=1, keepdims=True) < 1e-3
        assert still.mean() > 0.1
        pair.append(
            dataclasses.replace(recording, tau=recording.torque + 4.0 * still, source=f"{seed}.csv")
        )  # static friction
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [pair[0]], [pair[1]]
    )
    assert not result.verdict.chosen and not result.unknown
    assert np.all(result.moving.mean(axis=0) < 0.9) and np.all(result.after < 1.3 * 0.1)


def test_confidence_intervals_contain_the_true_parameters(subject):
    result = diagnose_effect(subject, EFFECTS["torque_ripple"][0])
    value, std = interval.finding_parameters(result.design, result.verdict, 0)["amplitude"]
    assert value == pytest.approx(0.5, rel=0.1) and std < 0.05


def test_maxwell_slip_friction_is_reported_as_hysteresis_only(subject):
    thresholds = np.geomspace(0.004, 0.2, 9)
    result = diagnose_effect(
        subject, lambda t, q, dq, tau: at_joint(1, 4.0 * maxwell_slip_force(q[:, 1], thresholds))
    )
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [
        ("hysteresis", 1)
    ] and not result.unknown
    estimates = interval.finding_parameters(result.design, result.verdict, 0)
    for key, truth in (("amplitude", 4.0), ("stiffness", 4.0 * float((1.0 / thresholds).mean()))):
        value, std = estimates[key]
        assert abs(value - truth) < 2.0 * std < 2.0 * truth
    assert (
        estimates["stiffness"][1] > 0.45 * estimates["stiffness"][0]
    )  # elements with smaller thresholds would look the same


@pytest.mark.parametrize(("after", "unknown"), [(2.0, []), (6.0, [0, 1])])
def test_residual_of_held_out_torque_is_unknown_although_the_fit_explains_the_training_torque(
    subject, after, unknown
):
    result = diagnose_effect(subject, EFFECTS["spring"][0])
    modified = dataclasses.replace(
        result,
        fitted=(10.0 * result.noise_rms, 2.0 * result.noise_rms),
        before=10.0 * result.expected,
        after=after * result.expected,
    )
    assert modified.unknown == unknown


def test_an_eccentric_encoder_is_reported_with_its_first_harmonic(subject):
    """The torque contains the second harmonic more strongly, by the square of its order."""
    recordings = []
    for recording in recordings_of(subject, None):
        angle, q = 2.0 * recording.q[:, 1] + 0.4, recording.q.copy()
        q[:, 1] += 0.02 * (np.sin(angle) + 0.4 * np.sin(2.0 * angle))
        recordings.append(dataclasses.replace(recording, q=q))
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, recordings[:1], recordings[1:]
    )
    (finding,) = result.verdict.findings
    assert (finding.main.effect, finding.main.joint) == ("encoder_error", 1)
    values = interval.finding_parameters(result.design, result.verdict, 0)
    assert values["order"][0] == pytest.approx(2.0, rel=0.1) and values["amplitude"][
        0
    ] == pytest.approx(0.02, rel=0.2)
    assert np.all(result.after < 0.5 * result.before)


def test_position_friction_is_estimated_over_the_range_of_the_motion(subject):
    result = diagnose_effect(subject, EFFECTS["position_friction"][0])
    train = np.concatenate([t.samples.q[:, 0] for half in result.motions for t in half])
    wave = 0.8 * np.cos(2.0 * np.linspace(train.min(), train.max(), 500) + 1.0)
    value, _ = interval.finding_parameters(result.design, result.verdict, 0)["amplitude"]
    assert value == pytest.approx(0.5 * np.ptp(wave), rel=0.1)


def test_torque_ripple_is_reported_with_harmonics_and_weak_orders(subject):
    def cogging(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
        angle = 19.0 * q[:, 1]
        return at_joint(
            1,
            2.0 * np.cos(angle)
            + 0.5 * np.cos(2.0 * angle + 0.4)
            + 0.15 * np.cos(3.0 * angle + 1.0)
            + 0.3 * np.cos(27.0 * q[:, 1]),
        )

    result = diagnose_effect(subject, cogging)
    (finding,) = result.verdict.findings
    values = [result.design.shapes[part.shape].values for part in finding.parts]
    assert (
        finding.main.effect == "torque_ripple"
        and values[0]["order"] == pytest.approx(19.0, rel=1e-3)
        and {"twice", "thrice"} <= set(values[0])
    )
    assert any(part["order"] == pytest.approx(27.0, rel=5e-3) for part in values)
    assert interval.finding_parameters(result.design, result.verdict, 0)["amplitude"][
        0
    ] == pytest.approx(2.0, rel=0.02)
    assert np.all(result.after < 1.4 * result.floor)


def test_torque_that_only_a_rejected_effect_predicts_is_unknown(subject, monkeypatch):
    monkeypatch.setattr(belief, "ASSERTED", 0.995)  # no effect is probable enough to be reported
    result = diagnose_effect(subject, EFFECTS["stribeck"][0])
    assert not result.verdict.findings and [f.main.effect for f in result.verdict.doubted] == [
        "stribeck"
    ]
    assert (
        result.unknown == [0]
        and result.name == "unexplained"
        and result.doubted[0] > result.floor[0]
    )
    (stated,) = document(result)["unknown"]
    assert "most similar to stribeck" in stated["where"]["statement"]


def test_coupling_friction_dissipates_energy_for_both_signs_of_the_ratio(subject):
    for ratio in (0.8, -0.8):

        def effect(
            t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray, ratio: float = ratio
        ) -> FloatArray:
            return at_joint(0, shaft_friction(dq[:, 0] + ratio * dq[:, 1]))

        result = diagnose_effect(subject, effect)
        (finding,) = result.verdict.chosen
        assert finding.effect == "coupling" and result.design.shapes[finding.shape].values[
            "ratio"
        ] == pytest.approx(ratio, rel=0.02)
        estimates = interval.finding_parameters(result.design, result.verdict, 0)
        assert estimates["coulomb"][0] == pytest.approx(0.9, rel=0.05) and estimates["viscous"][
            0
        ] == pytest.approx(0.2, rel=0.05)  # of the shaft
        assert not result.design.shapes[finding.shape].is_plausible(-finding.trial.coefficients)


def test_a_stiffening_spring_is_not_reported_as_torque_ripple(subject):
    """A rubber stop at one end of the range."""
    result = diagnose_effect(
        subject,
        lambda t, q, dq, tau: at_joint(1, 1.5 * q[:, 1] + 12.0 * np.maximum(q[:, 1] - 0.5, 0.0)),
    )
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [("spring", 1)]
    q = np.concatenate([motion.samples.q[:, 1] for half in result.motions for motion in half])
    grid = np.linspace(q.min(), q.max(), 400)
    curve = 1.5 * grid + 12.0 * np.maximum(grid - 0.5, 0.0)
    values = interval.finding_parameters(result.design, result.verdict, 0)
    for name, truth in (("stiffness", 13.5), ("amplitude", 0.5 * np.ptp(curve))):
        assert values[name][0] == pytest.approx(truth, rel=0.05)


def test_two_effects_are_both_reported(subject):
    def both(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
        return EFFECTS["stribeck"][0](t, q, dq, tau) + EFFECTS["spring"][0](t, q, dq, tau)

    assert {h.effect for h in diagnose_effect(subject, both).verdict.chosen} == {
        "stribeck",
        "spring",
    }


def test_torque_outside_the_catalogue_is_unknown(subject):
    """A repeatable torque that no effect of the catalogue models: a random function of both
    positions."""
    rng = np.random.default_rng(3)
    waves, phases = rng.normal(0.0, 9.0, (60, 2)), rng.uniform(0.0, 6.28, 60)

    def random_torque(t: FloatArray, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
        return at_joint(0, 0.6 * np.cos(q @ waves.T + phases).sum(axis=1) / np.sqrt(30.0))

    result = diagnose_effect(subject, random_torque)
    assert 0 in result.unknown and result.name in ("unexplained", "partly-explained")


def test_a_trusted_prior_reveals_an_offset_that_a_refit_absorbs(subject):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    trusted = dict(enumerate(psi.tolist()))
    effect: Effect = lambda t, q, dq, tau: at_joint(1, np.full(len(t), 1.0))  # noqa: E731
    assert not diagnose_effect(subject, effect).verdict.chosen
    result = diagnose_effect(subject, effect, trusted=trusted)
    assert (
        result.verdict.chosen[0].effect == "torque_offset" and result.verdict.chosen[0].joint == 1
    )
    assert interval.finding_parameters(result.design, result.verdict, 0)["offset"][
        0
    ] == pytest.approx(1.0, rel=0.05)


def test_the_catalogue_has_the_effects_of_the_contract():
    assert sorted(EFFECTS_BY_NAME) == sorted(EFFECT_NAMES) and len(effects.EFFECTS) == len(
        EFFECT_NAMES
    )
    for effect in effects.EFFECTS:
        assert effect.units and effect.signature and effect.experiment and effect.equation
        assert set(effect.similar) <= set(EFFECT_NAMES)


def test_every_candidate_model_has_parameters_of_its_effect(subject):
    result = diagnose_effect(
        subject,
        EFFECTS["spring"][0],
        trusted=dict(
            enumerate(perturbed_parameters(subject.parameters, np.random.default_rng(4)).tolist())
        ),
    )
    effects_of_candidates = {shape.effect for shape in result.design.shapes}
    assert effects_of_candidates >= set(EFFECT_NAMES) - {"contact", "kinematic_error"}
    for shape, place in zip(result.design.shapes, result.design.places, strict=True):
        values = shape.parameters(np.full(place.stop - place.start, 0.3))
        assert set(values) <= set(EFFECTS_BY_NAME[shape.effect].units), shape.effect


def test_the_document_has_the_keys_of_the_contract(subject):
    stated = json.loads(json.dumps(document(diagnose_effect(subject, EFFECTS["stribeck"][0]))))
    assert stated["schema"] == "excite.diagnosis/1" and stated["verdict"] in (
        "explained",
        "partly-explained",
    )
    (finding,) = stated["findings"]
    assert (
        finding["effect"] == "stribeck"
        and finding["joint"] == "joint_1"
        and 0.5 <= finding["probability"] <= 1.0
    )
    assert (
        set(finding["parameters"]) == {"amplitude", "velocity"}
        and finding["parameters"]["amplitude"]["unit"] == "N m"
    )
    assert set(stated["joints"]["joint_1"]) >= {
        "noise_floor",
        "noise_floor_method",
        "rmse_before",
        "rmse_after",
        "unexplained_share",
    }
    assert stated["band_hz"] == 20.0 and stated["considered"]


def test_the_command_writes_its_files_and_refuses_unusable_recordings(subject, tmp_path, capsys):
    train, held_out = recordings_of(subject, EFFECTS["asymmetric_viscous"][0])
    first, second = (
        write_recording(train, tmp_path / "a.csv"),
        write_recording(held_out, tmp_path / "b.csv"),
    )
    command = ["diagnose", "two_link", str(first), "-o", str(tmp_path / "out")]
    assert main_module.main([*command, "--validate", str(second)]) == 0
    assert "asymmetric_viscous" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "diagnosis.json",
        "model.json",
        "report.html",
    }
    (effect,) = json.loads((tmp_path / "out" / "model.json").read_text())["effects"]
    assert effect["effect"] == "asymmetric_viscous"
    assert (
        main_module.main(
            [
                "predict",
                str(tmp_path / "out" / "model.json"),
                str(second),
                "-o",
                str(tmp_path / "torque.csv"),
            ]
        )
        == 0
    )
    predicted = np.loadtxt(tmp_path / "torque.csv", delimiter=",", skiprows=1)[:, 1:]
    lowpass = signal.butter(4, 12.0, fs=held_out.rate, output="sos")
    residual = signal.sosfiltfilt(lowpass, held_out.tau - predicted, axis=0)[300:-300]
    assert (
        np.sqrt(np.mean(residual**2, axis=0)) < 0.05
    ).all()  # white noise of 0.1 N m has 0.022 N m below 12 Hz
    for arguments, message in (
        ([], "--validate"),
        (["--validate", str(first)], "same motion"),
        (["--validate", str(tmp_path / "no.csv")], "no.csv"),
    ):
        assert main_module.main([*command[:-1], str(tmp_path / "none"), *arguments]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_short_recording_is_refused(subject):
    train, held_out = recordings_of(subject, None)
    short = dataclasses.replace(
        held_out.between(0.0, 0.6),
        sidecar=dataclasses.replace(held_out.sidecar, period=None, periodic=None),
    )
    with pytest.raises(UnusableInput, match=r"short|stretch"):
        diagnosis.diagnose(subject.robot, subject.parameters, subject.base, [train], [short])
