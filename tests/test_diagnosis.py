"""Diagnosis of simulated two-link robots with one thing planted, and of bad input."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable

import numpy as np
import pytest
from contract import EFFECT_NAMES
from scipy import signal
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    write_recording,
)

from excite.cli import main as main_module
from excite.diagnosis import belief, diagnosis, interval
from excite.diagnosis.diagnosis import Diagnosis, DiagnosisOptions
from excite.diagnosis.diagnosis_file import document
from excite.effects import EFFECTS, EFFECTS_BY_NAME
from excite.errors import UnusableInput
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries

Array = np.ndarray
Plant = Callable[
    [Array, Array, Array, Array], Array
]  # t, q, dq, tau -> torque added to the recording


def recordings_of(subject: IdentificationModel, plant: Plant | None) -> tuple[Recording, Recording]:
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    out = []
    for seed in (2, 5):
        fourier = random_fourier(2, seed)
        one = synthetic_recording(subject, psi, fourier, 4, 0.0)
        s = fourier.samples(one.t)
        added = np.zeros_like(one.q) if plant is None else plant(one.t, s.q, s.dq, one.tau)
        noise = 0.1 * np.random.default_rng(seed).normal(size=one.q.shape)
        out.append(dataclasses.replace(one, tau=one.tau + added + noise, source=f"{seed}.csv"))
    return out[0], out[1]


def found(subject: IdentificationModel, plant: Plant | None, **options: object) -> Diagnosis:
    train, held_out = recordings_of(subject, plant)
    return diagnosis.diagnose(
        subject.robot,
        subject.parameters,
        subject.base,
        [train],
        [held_out],
        DiagnosisOptions(**options),  # type: ignore[arg-type]
    )


def on(joint: int, column: Array) -> Array:
    out = np.zeros((len(column), 2))
    out[:, joint] = column
    return out


def shaft(speed: Array) -> Array:
    """Friction of a shaft that two joints turn."""
    return 0.9 * np.tanh(speed / FRICTION_WIDTH) + 0.2 * speed


PLANTED: dict[str, tuple[Plant, int | None]] = {
    "asymmetric_viscous": (lambda t, q, dq, tau: on(1, 0.35 * np.abs(dq[:, 1])), 1),
    "stribeck": (
        lambda t, q, dq, tau: on(
            0, 1.5 * np.tanh(dq[:, 0] / FRICTION_WIDTH) * np.exp(-((np.abs(dq[:, 0]) / 0.12) ** 2))
        ),
        0,
    ),
    "torque_ripple": (lambda t, q, dq, tau: on(1, 0.5 * np.cos(23.0 * q[:, 1] + 0.4)), 1),
    "spring": (lambda t, q, dq, tau: on(1, 1.7 * q[:, 1]), 1),
    "position_friction": (
        lambda t, q, dq, tau: on(
            0, 0.8 * np.tanh(dq[:, 0] / FRICTION_WIDTH) * np.cos(2.0 * q[:, 0] + 1.0)
        ),
        0,
    ),
    "coupling": (lambda t, q, dq, tau: on(0, shaft(dq[:, 0] - 0.7 * dq[:, 1])), 0),
    "delay": (
        lambda t, q, dq, tau: np.column_stack([np.interp(t - 0.006, t, c) for c in tau.T]) - tau,
        None,
    ),
}


@pytest.mark.parametrize("name", list(PLANTED))
def test_what_was_planted_is_named_and_modelled(subject, name):
    plant, joint = PLANTED[name]
    result = found(subject, plant)
    assert result.verdict.chosen and result.verdict.chosen[0].effect == name
    assert joint is None or result.verdict.chosen[0].joint == joint
    assert len(result.verdict.chosen) == 1 and not result.unknown
    assert np.all(result.after < 1.4 * result.floor) and np.any(result.before > 1.5 * result.floor)


def test_nothing_planted_nothing_found(subject):
    result = found(subject, None)
    assert result.name == "no-mismatch" and not result.verdict.chosen and not result.unknown
    assert np.allclose(result.after, result.floor, rtol=0.25)


class Paused(FourierSeries):
    """A motion that slows to a stop for a second, twice a period."""

    def samples(self, t: Array) -> Samples:
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


def test_what_holds_a_joint_at_rest_is_no_mismatch(subject):
    psi, pair = perturbed_parameters(subject.parameters, np.random.default_rng(4)), []
    for seed in (2, 5):
        plain = random_fourier(2, seed)
        paused = Paused(plain.sine, plain.cosine, plain.offset, 2.0 * plain.period)
        one = synthetic_recording(subject, psi, paused, 1.3, 0.1)
        s = paused.samples(one.t)
        still = np.abs(s.dq).max(axis=1, keepdims=True) < 1e-3
        assert still.mean() > 0.1
        pair.append(
            dataclasses.replace(one, tau=one.torque + 4.0 * still, source=f"{seed}.csv")
        )  # what sticks pushes back
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [pair[0]], [pair[1]]
    )
    assert not result.verdict.chosen and not result.unknown
    assert np.all(result.moving.mean(axis=0) < 0.9) and np.all(result.after < 1.3 * 0.1)


def test_parameters_come_with_intervals_that_hold_the_truth(subject):
    result = found(subject, PLANTED["torque_ripple"][0])
    value, std = interval.finding_parameters(result.design, result.verdict, 0)["amplitude"]
    assert value == pytest.approx(0.5, rel=0.1) and std < 0.05


def slips(q: Array, ways: Array) -> Array:
    """Mean force of springs that each slip after a way of their own: the play operator, by what was
    last pushed past."""
    out, rest = np.empty((len(q), len(ways))), np.full(len(ways), q[0])
    for k, place in enumerate(q):
        rest = np.clip(rest, place - ways, place + ways)
        out[k] = (place - rest) / ways
    return np.asarray(out.mean(axis=1))


def test_friction_whose_springs_slip_one_after_the_other_is_hysteresis_and_nothing_else(subject):
    ways = np.geomspace(0.004, 0.2, 9)
    result = found(subject, lambda t, q, dq, tau: on(1, 4.0 * slips(q[:, 1], ways)))
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [
        ("hysteresis", 1)
    ] and not result.unknown
    told = interval.finding_parameters(result.design, result.verdict, 0)
    for key, truth in (("amplitude", 4.0), ("stiffness", 4.0 * float((1.0 / ways).mean()))):
        value, std = told[key]
        assert abs(value - truth) < 2.0 * std < 2.0 * truth
    assert (
        told["stiffness"][1] > 0.45 * told["stiffness"][0]
    )  # what slips sooner than the first would look the same


@pytest.mark.parametrize(("after", "unknown"), [(2.0, []), (6.0, [0, 1])])
def test_what_a_finding_does_not_foretell_is_unknown_though_fitted_it_takes_nearly_all(
    subject, after, unknown
):
    result = found(subject, PLANTED["spring"][0])
    said = dataclasses.replace(
        result,
        fitted=(10.0 * result.noise_rms, 2.0 * result.noise_rms),
        before=10.0 * result.expected,
        after=after * result.expected,
    )
    assert said.unknown == unknown


def test_an_encoder_off_its_centre_is_told_by_its_first_wave(subject):
    """Torque shows the second wave more than the first: by the square of its order."""
    misread = []
    for one in recordings_of(subject, None):
        angle, q = 2.0 * one.q[:, 1] + 0.4, one.q.copy()
        q[:, 1] += 0.02 * (np.sin(angle) + 0.4 * np.sin(2.0 * angle))
        misread.append(dataclasses.replace(one, q=q))
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, misread[:1], misread[1:]
    )
    (finding,) = result.verdict.findings
    assert (finding.main.effect, finding.main.joint) == ("encoder_error", 1)
    values = interval.finding_parameters(result.design, result.verdict, 0)
    assert values["order"][0] == pytest.approx(2.0, rel=0.1) and values["amplitude"][
        0
    ] == pytest.approx(0.02, rel=0.2)
    assert np.all(result.after < 0.5 * result.before)


def test_friction_by_place_is_told_where_the_joint_was(subject):
    result = found(subject, PLANTED["position_friction"][0])
    train = np.concatenate([t.samples.q[:, 0] for half in result.motions for t in half])
    wave = 0.8 * np.cos(2.0 * np.linspace(train.min(), train.max(), 500) + 1.0)
    value, _ = interval.finding_parameters(result.design, result.verdict, 0)["amplitude"]
    assert value == pytest.approx(0.5 * np.ptp(wave), rel=0.1)


def test_a_ripple_is_told_with_its_multiples_and_slight_orders_beside_strong_ones(subject):
    def cogging(t: Array, q: Array, dq: Array, tau: Array) -> Array:
        angle = 19.0 * q[:, 1]
        return on(
            1,
            2.0 * np.cos(angle)
            + 0.5 * np.cos(2.0 * angle + 0.4)
            + 0.15 * np.cos(3.0 * angle + 1.0)
            + 0.3 * np.cos(27.0 * q[:, 1]),
        )

    result = found(subject, cogging)
    (finding,) = result.verdict.findings
    told = [result.design.shapes[part.shape].values for part in finding.parts]
    assert (
        finding.main.effect == "torque_ripple"
        and told[0]["order"] == pytest.approx(19.0, rel=1e-3)
        and {"twice", "thrice"} <= set(told[0])
    )
    assert any(one["order"] == pytest.approx(27.0, rel=5e-3) for one in told)
    assert interval.finding_parameters(result.design, result.verdict, 0)["amplitude"][
        0
    ] == pytest.approx(2.0, rel=0.02)
    assert np.all(result.after < 1.4 * result.floor)


def test_what_only_a_doubted_name_foresees_is_unknown(subject, monkeypatch):
    monkeypatch.setattr(belief, "ASSERTED", 0.995)  # nothing is sure enough to be named
    result = found(subject, PLANTED["stribeck"][0])
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


def test_a_coupling_takes_energy_whichever_way_the_other_joint_turns_the_shaft(subject):
    for ratio in (0.8, -0.8):

        def plant(t: Array, q: Array, dq: Array, tau: Array, ratio: float = ratio) -> Array:
            return on(0, shaft(dq[:, 0] + ratio * dq[:, 1]))

        result = found(subject, plant)
        (one,) = result.verdict.chosen
        assert one.effect == "coupling" and result.design.shapes[one.shape].values[
            "ratio"
        ] == pytest.approx(ratio, rel=0.02)
        told = interval.finding_parameters(result.design, result.verdict, 0)
        assert told["coulomb"][0] == pytest.approx(0.9, rel=0.05) and told["viscous"][
            0
        ] == pytest.approx(0.2, rel=0.05)  # the shaft's own
        assert not result.design.shapes[one.shape].is_plausible(-one.trial.coefficients)


def test_a_spring_that_stiffens_is_no_ripple(subject):
    """A stop of rubber, met at one end of the range."""
    result = found(
        subject, lambda t, q, dq, tau: on(1, 1.5 * q[:, 1] + 12.0 * np.maximum(q[:, 1] - 0.5, 0.0))
    )
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [("spring", 1)]
    q = np.concatenate([one.samples.q[:, 1] for half in result.motions for one in half])
    grid = np.linspace(q.min(), q.max(), 400)
    law = 1.5 * grid + 12.0 * np.maximum(grid - 0.5, 0.0)
    values = interval.finding_parameters(result.design, result.verdict, 0)
    for name, truth in (("stiffness", 13.5), ("amplitude", 0.5 * np.ptp(law))):
        assert values[name][0] == pytest.approx(truth, rel=0.05)


def test_two_effects_are_both_named(subject):
    def both(t: Array, q: Array, dq: Array, tau: Array) -> Array:
        return PLANTED["stribeck"][0](t, q, dq, tau) + PLANTED["spring"][0](t, q, dq, tau)

    assert {h.effect for h in found(subject, both).verdict.chosen} == {"stribeck", "spring"}


def test_what_no_name_takes_is_unknown(subject):
    """A torque that repeats with the motion but follows no law of the catalogue: a random function
    of both positions."""
    rng = np.random.default_rng(3)
    waves, phases = rng.normal(0.0, 9.0, (60, 2)), rng.uniform(0.0, 6.28, 60)

    def odd(t: Array, q: Array, dq: Array, tau: Array) -> Array:
        return on(0, 0.6 * np.cos(q @ waves.T + phases).sum(axis=1) / np.sqrt(30.0))

    result = found(subject, odd)
    assert 0 in result.unknown and result.name in ("unexplained", "partly-explained")


def test_a_trusted_prior_shows_what_a_refit_absorbs(subject):
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    trusted = dict(enumerate(psi.tolist()))
    plant: Plant = lambda t, q, dq, tau: on(1, np.full(len(t), 1.0))  # noqa: E731
    assert not found(subject, plant).verdict.chosen
    result = found(subject, plant, trusted=trusted)
    assert (
        result.verdict.chosen[0].effect == "torque_offset" and result.verdict.chosen[0].joint == 1
    )
    assert interval.finding_parameters(result.design, result.verdict, 0)["offset"][
        0
    ] == pytest.approx(1.0, rel=0.05)


def test_the_catalogue_is_the_contracts():
    assert sorted(EFFECTS_BY_NAME) == sorted(EFFECT_NAMES) and len(EFFECTS) == len(EFFECT_NAMES)
    for effect in EFFECTS:
        assert effect.units and effect.signature and effect.experiment and effect.equation
        assert set(effect.similar) <= set(EFFECT_NAMES)


def test_every_shape_gives_finite_columns_and_named_parameters(subject):
    result = found(
        subject,
        PLANTED["spring"][0],
        trusted=dict(
            enumerate(perturbed_parameters(subject.parameters, np.random.default_rng(4)).tolist())
        ),
    )
    seen = {shape.effect for shape in result.design.shapes}
    assert seen >= set(EFFECT_NAMES) - {"contact", "kinematic_error"}
    for shape, place in zip(result.design.shapes, result.design.places, strict=True):
        values = shape.parameters(np.full(place.stop - place.start, 0.3))
        assert set(values) <= set(EFFECTS_BY_NAME[shape.effect].units), shape.effect


def test_the_document_is_the_contracts(subject):
    stated = json.loads(json.dumps(document(found(subject, PLANTED["stribeck"][0]))))
    assert stated["schema"] == "excite.diagnosis/1" and stated["verdict"] in (
        "explained",
        "partly-explained",
    )
    (one,) = stated["findings"]
    assert (
        one["effect"] == "stribeck"
        and one["joint"] == "joint_1"
        and 0.5 <= one["probability"] <= 1.0
    )
    assert (
        set(one["parameters"]) == {"amplitude", "velocity"}
        and one["parameters"]["amplitude"]["unit"] == "N m"
    )
    assert set(stated["joints"]["joint_1"]) >= {
        "noise_floor",
        "noise_floor_method",
        "rmse_before",
        "rmse_after",
        "unexplained_share",
    }
    assert stated["band_hz"] == 20.0 and stated["considered"]


def test_the_command_and_what_it_refuses(subject, tmp_path, capsys):
    train, held_out = recordings_of(subject, PLANTED["asymmetric_viscous"][0])
    first, second = (
        write_recording(train, tmp_path / "a.csv"),
        write_recording(held_out, tmp_path / "b.csv"),
    )
    go = ["diagnose", "two_link", str(first), "-o", str(tmp_path / "out")]
    assert main_module.main([*go, "--validate", str(second)]) == 0
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
    slow = signal.butter(4, 12.0, fs=held_out.rate, output="sos")
    left = signal.sosfiltfilt(slow, held_out.tau - predicted, axis=0)[300:-300]
    assert (
        np.sqrt(np.mean(left**2, axis=0)) < 0.05
    ).all()  # of white noise of 0.1 N m 0.022 are that slow
    for words, part in (
        ([], "--validate"),
        (["--validate", str(first)], "same motion"),
        (["--validate", str(tmp_path / "no.csv")], "no.csv"),
    ):
        assert main_module.main([*go[:-1], str(tmp_path / "none"), *words]) == 2
        assert part in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_recording_too_short_is_refused(subject):
    train, held_out = recordings_of(subject, None)
    short = dataclasses.replace(
        held_out.between(0.0, 0.6),
        sidecar=dataclasses.replace(held_out.sidecar, period=None, periodic=None),
    )
    with pytest.raises(UnusableInput, match=r"short|stretch"):
        diagnosis.diagnose(subject.robot, subject.parameters, subject.base, [train], [short])
