"""The report of an identification, also for a single joint and without held-out data."""

from __future__ import annotations

import dataclasses
import re
import shlex
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from test_report import answer, check_page, section

from excite import recordings
from excite.cli import main
from excite.identification import estimators
from excite.identification.identification import Identification, IdentificationOptions, identify
from excite.recordings import Recording, Remark, RemarkKind, Sidecar
from excite.report import identification_page, noise
from excite.report.figures import torque_fit
from excite.report.figures.inertia_ellipsoids import LinkBody
from excite.report.formatting import number
from excite.report.identification import next_design_command
from excite.robot import base_parameters, inertial_parameters, limits, robot

REAL = Path(__file__).resolve().parents[2] / "shared" / "recordings"
QUESTIONS = {
    "prediction": "Does the model predict another recording?",
    "parameters": "How did the base parameters change?",
    "directions": "Which directions did the recording determine, which the prior?",
    "bodies": "How did each link's inertia change?",
    "noise": "Is the noise white, and which band was used?",
    "next": "What should the next trajectory identify?",
    "made": "How was it made?",
}
PERIOD, PERIODS, RATE = 3.0, 3, 100.0


def recorded(name: str, seed: int) -> Recording:
    """Simulate three periods of a two-link arm; its second link is 0.4 kg heavier than its URDF."""
    loaded = robot.load("two_link")
    model = loaded.model.copy()
    model.inertias[2] = pin.Inertia(
        model.inertias[2].mass + 0.4, model.inertias[2].lever, model.inertias[2].inertia
    )
    data, rng = model.createData(), np.random.default_rng(seed)
    t = np.arange(int(PERIOD * PERIODS * RATE)) / RATE
    angle = 2.0 * np.pi / PERIOD * np.arange(1, 5)[:, None] * t
    a, b = (rng.normal(size=(2, 4)) / np.arange(1, 5) for _ in range(2))
    omega = 2.0 * np.pi / PERIOD * np.arange(1, 5)
    q = 0.6 * (a @ np.sin(angle) + b @ np.cos(angle)).T
    dq = 0.6 * ((a * omega) @ np.cos(angle) - (b * omega) @ np.sin(angle)).T
    ddq = -0.6 * ((a * omega**2) @ np.sin(angle) + (b * omega**2) @ np.cos(angle)).T
    torque = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    torque += 0.3 * dq + 0.5 * np.tanh(dq / 0.005) + rng.normal(scale=(0.3, 0.1), size=torque.shape)
    return Recording(
        name,
        loaded.joints,
        t,
        q,
        tau=torque,
        sidecar=Sidecar(period=PERIOD, periodic=(0.0, PERIOD * PERIODS)),
    )


@cache
def identification_of(*, held_out: bool = True, periodic: bool = True) -> Identification:
    loaded = robot.load("two_link")
    table = limits.resolve(loaded)
    standard = inertial_parameters.standard_parameters(loaded, table)
    first, second = recorded("first.csv", 1), recorded("second.csv", 2)
    if not periodic:
        first, second = (dataclasses.replace(r, sidecar=Sidecar()) for r in (first, second))
    return identify(
        loaded,
        standard,
        base_parameters.find(loaded, standard, table),
        [first],
        [second] if held_out else [],
    )


REMARKS = {
    "monday.csv": (
        Remark(RemarkKind.GAP, "a gap of <12> rows & more", start=1.0, end=1.12),
        Remark(RemarkKind.UNIT, "degrees, read as such", joint="joint_1", repaired=True),
        Remark(RemarkKind.UNIT, "degrees, read as such", joint="joint_2", repaired=True),
    ),
    "tuesday.csv": (
        Remark(RemarkKind.UNIT, "degrees, read as such", joint="joint_2", repaired=True),
    ),
}


@cache
def page_of(*, held_out: bool = True, periodic: bool = True) -> str:
    return identification_page(
        identification_of(held_out=held_out, periodic=periodic),
        REMARKS,
    )


@pytest.mark.parametrize(("held_out", "periodic"), [(True, True), (False, True), (True, False)])
def test_report_is_self_contained_and_answers_every_question(
    held_out: bool, periodic: bool
) -> None:
    page = page_of(held_out=held_out, periodic=periodic)
    check_page(page)
    assert re.findall(r'<section id="(\w+)"', page) == list(QUESTIONS)
    for key, question in QUESTIONS.items():
        assert question in section(page, key).replace("&#39;", "'")
        assert answer(page, key).endswith(".") and len(answer(page, key)) > 20, key
    for key in ("prediction", "parameters", "directions", "bodies", "noise"):
        assert "<svg" in section(page, key), key
    assert len(page.encode()) < 1_500_000


def test_same_input_gives_the_same_bytes() -> None:
    assert identification_page(identification_of(), REMARKS) == page_of()


def test_table_states_the_errors_of_the_identification() -> None:
    prediction, text = identification_of().validations[0], section(page_of(), "prediction")
    rows = re.findall(r"<tr><td>(joint_\d)</td>(.*?)</tr>", text)
    held_out = rows[:2]
    for k, (joint, cells) in enumerate(held_out):
        values = [
            re.sub(r"<[^>]*>", "", cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", cells)
        ]
        assert joint == prediction_joints()[k]
        assert values[1:4] == [
            number(v[k], 3)
            for v in (prediction.error("nominal"), prediction.error(), prediction.noise_floor)
        ]
        assert values[4] == f"{prediction.error()[k] / prediction.noise_floor[k]:.2f}"
    assert answer(page_of(), "prediction").startswith("Yes, down to the noise")


def prediction_joints() -> tuple[str, ...]:
    return identification_of().model.robot.joints


def test_table_states_the_base_parameters_of_the_identification() -> None:
    result, text = identification_of(), section(page_of(), "parameters")
    half = estimators.interval_half_widths(result.data, np.eye(result.model.base.count))
    now = result.model.base.matrix @ result.psi
    for k, place in enumerate(result.model.base.independent):
        row = re.search(
            rf"<tr><td><code>{result.model.parameters.names[place]}</code></td>(.*?)</tr>", text
        )
        assert row
        values = [
            re.sub(r"<[^>]*>", "", cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", row[1])
        ]
        assert values[2:5] == [number(result.data.theta[k]), number(half[k], 2), number(now[k])]


def test_missing_held_out_recording_is_stated() -> None:
    page = page_of(held_out=False)
    assert answer(page, "prediction").startswith("Not known, because no recording was held out")
    assert "fitted to: a small error here says little" in section(page, "prediction")


def test_warning_if_a_fitted_recording_is_held_out() -> None:
    contaminated = dataclasses.replace(identification_of(), validations=identification_of().fits)
    page = identification_page(contaminated)
    assert "among those held out" in page and 'class="answer warn"' in section(page, "prediction")
    assert "among those held out" not in page_of()


def test_no_noise_floor_without_periods() -> None:
    text = section(page_of(periodic=False), "prediction")
    assert "no noise floor is known" in text and "noise floors" not in answer(
        page_of(periodic=False), "prediction"
    )


def test_joint_predicted_worse_than_by_zero_torque_is_named() -> None:
    result = identification_of(periodic=False)
    bad = dataclasses.replace(
        result.validations[0], fitted=result.validations[0].fitted * np.array([1.0, -3.0])
    )
    page = identification_page(dataclasses.replace(result, validations=(bad,)))
    assert answer(page, "prediction").startswith("Not for joint_2, where a prediction of no torque")
    assert 'class="answer bad"' in section(page, "prediction")


def test_remarks_and_facts_are_listed() -> None:
    text = section(page_of(), "made")
    assert "a gap of &lt;12&gt; rows &amp; more" in text and "1 to 1.12" in text
    assert "the data-quality checks have 4 remarks" in answer(page_of(), "made")
    assert "monday.csv, tuesday.csv" in text and text.count("degrees, read as such") == 1


def test_data_share_of_each_direction() -> None:
    """With a single γ, the share is λ/(λ + 2γ) exactly."""
    result = identification_of()
    drive_scale = np.diag(result.model.parameters.scale)[10 * result.model.parameters.bodies :]
    prior = dataclasses.replace(
        result.prior,
        inertial_weight=50.0,
        joint_weights=np.full_like(drive_scale, 50.0),
        joint_scales=drive_scale,
    )
    alike = dataclasses.replace(
        result, prior=prior, metric=result.model.parameters, metric_base=result.model.base
    )
    values = (
        np.linalg.svd(
            result.data.information_root @ result.model.base.matrix @ result.model.base.geometric,
            compute_uv=False,
        )
        ** 2
    )
    assert np.allclose(alike.data_shares(), values / (values + 100.0), rtol=1e-6)


def test_next_command_is_valid() -> None:
    words = shlex.split(next_design_command(identification_of()))
    arguments = main.parser().parse_args(words[1:])
    assert words[:2] == ["excite", "design"] and arguments.robot == "two_link"
    assert arguments.given == ["first.csv"] and arguments.validation


def test_next_command_repeats_the_options_of_the_robot() -> None:
    payload = robot.Payload("link_2", 0.5, (0.1, 0.0, 0.02))
    other = robot.load(
        "two_link",
        joints=("joint_2",),
        lock={"joint_1": 0.25},
        payload=payload,
        gravity=(0.0, 0.0, -1.62),
    )
    result = dataclasses.replace(
        identification_of(), model=dataclasses.replace(identification_of().model, robot=other)
    )
    arguments = main.parser().parse_args(shlex.split(next_design_command(result))[1:])
    assert arguments.joints == "joint_2" and arguments.lock == [("joint_1", (0.25,))]
    assert arguments.gravity == (0.0, 0.0, -1.62)
    assert arguments.payload == [("link_2", (0.5, 0.1, 0.0, 0.02, *(0.0,) * 6))]


def test_ellipsoid_has_the_mass_and_inertia_of_its_link() -> None:
    a, b, c, centre = 0.3, 0.2, 0.1, np.array([0.1, -0.2, 0.3])
    phi = pin.Inertia(
        2.0, centre, 0.4 * np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    ).toDynamicParameters()
    body = LinkBody(phi)
    assert np.allclose(body.half_axes, [a, b, c]) and np.allclose(body.centre, centre)
    outline = body.outline((0, 2)) - centre[[0, 2]]
    assert np.allclose((outline[:, 0] / a) ** 2 + (outline[:, 1] / c) ** 2, 1.0)


def test_residual_density_integrates_to_the_residual_power() -> None:
    """Of white noise the mean density over the band times the band is the variance."""
    result = identification_of()
    density = noise.residual_density(result)
    power = density.power.mean(axis=0) * result.spectra.hertz
    assert np.allclose(power, result.data.noise**2, rtol=0.3)
    assert np.all(noise.density_ratios(density) < 3.0)


def test_long_recording_is_drawn_around_its_largest_error() -> None:
    t = np.arange(0.0, 300.0, 0.1)
    torque = np.sin(t)[:, None]
    residual = np.where(np.abs(t - 200.0) < 0.5, 0.4, 0.0)[:, None]
    result = dataclasses.replace(
        identification_of().validations[0],
        time=t,
        measured=torque,
        nominal=torque,
        fitted=torque - residual,
        noise_floor=None,
        starts=(0, 1000),
        moving=np.ones(torque.shape, bool),
    )
    start, end = torque_fit.drawn_interval(result)
    assert (
        end - start == pytest.approx(torque_fit.EXCERPT_SECONDS) and start < 199.5 and end > 200.5
    )


def test_robot_with_one_sliding_joint() -> None:
    folder = REAL / "emps"
    if not folder.is_dir():
        pytest.skip(
            f"no real recordings at {folder}; see its README in the project's shared folder"
        )
    loaded = robot.load(str(folder / "emps.urdf"))
    table = limits.resolve(loaded)
    standard = inertial_parameters.standard_parameters(loaded, table)
    train, pulses = (
        recordings.read(folder / f"{name}.csv", loaded) for name in ("train", "validate_pulses")
    )
    result = identify(
        loaded,
        standard,
        base_parameters.find(loaded, standard, table),
        [train],
        [pulses],
        IdentificationOptions(band=25.0),
    )
    page = identification_page(result, {"train.csv": train.remarks})
    check_page(page)
    assert answer(page, "prediction").startswith(
        "Yes: on validate_pulses.csv the error is 4.6 % of the RMS torque"
    )
    assert "[N s/m]" in page and "[N m]" not in section(page, "parameters")
    assert "Nothing in particular" in answer(page, "next")
