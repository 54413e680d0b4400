"""Friction that depends on temperature, where that was recorded: another day's recording, warmer,
is foretold."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import integrate
from synthetic_recordings import FRICTION_WIDTH, perturbed_parameters
from test_diagnosis import found, on, recordings_of
from test_fitted_effects import fitted_with, stated

from excite.diagnosis import diagnosis, fitted_effects, interval
from excite.diagnosis.diagnosis_file import document
from excite.effects import EFFECTS_BY_NAME, thermal_drift
from excite.effects.effect import CandidateModel
from excite.effects.recorded_motion import Grid, RecordedMotion
from excite.errors import UnusableInput
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording

Array = np.ndarray
PER_DEGREE = -0.02
"""Of friction at the first recording's coldest."""
DAYS = (24.0, 30.0), (38.0, 33.0)
"""Temperature of the first joint at the beginning and the end of either recording."""


def days(subject: IdentificationModel, dry: bool) -> list[Recording]:
    """Two recordings, the second warmer; only the first joint has a sensor. dry: Coulomb friction
    changes as viscous friction does."""
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    coulomb, viscous = (
        float(psi[subject.parameters.block(kind)][0]) for kind in ("coulomb", "viscous")
    )
    out = []
    for one, (start, end) in zip(recordings_of(subject, None), DAYS, strict=True):
        degrees = start + (end - start) * (one.t - one.t[0]) / (one.t[-1] - one.t[0])
        speed = np.gradient(one.q[:, 0], one.t)
        changed = (
            PER_DEGREE
            * (degrees - DAYS[0][0])
            * (viscous * speed + dry * coulomb * np.tanh(speed / FRICTION_WIDTH))
        )
        warm = np.column_stack([degrees, np.full(len(degrees), np.nan)])
        out.append(dataclasses.replace(one, tau=one.torque + on(0, changed), temperature=warm))
    return out


@pytest.mark.parametrize("dry", [True, False])
def test_friction_by_temperature_is_named_and_foretells_another_day(subject, dry):
    train, held_out = days(subject, dry)
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [
        ("thermal_drift", 0)
    ] and not result.unknown
    assert result.after[0] < 1.3 * result.floor[0] and result.before[0] > 1.5 * result.floor[0]
    told = document(result)["findings"][0]
    assert told["where"]["statement"] == "joint 'joint_1': friction changes with temperature"
    assert told["where"]["regime"] == "temperature" and "time_constant" not in told["parameters"]
    change, std = interval.finding_parameters(result.design, result.verdict, 0)["change"]
    span = DAYS[1][0] - DAYS[0][0]
    if dry:
        assert change == pytest.approx(PER_DEGREE * span, rel=0.1)
    assert PER_DEGREE * span - 2.0 * std < change < 0.0


def test_without_temperatures_the_other_day_has_no_such_name(subject):
    train, held_out = (dataclasses.replace(one, temperature=None) for one in days(subject, True))
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [train], [held_out]
    )
    assert all("reference" not in shape.values for shape in result.design.shapes)
    assert result.after[0] > 1.3 * result.floor[0]


def test_a_prediction_needs_the_temperature_that_friction_depends_on(subject):
    values = {"reference": 30.0, "coulomb": 1.5, "viscous": 0.8}
    model, warm = (
        fitted_with(subject, (stated("thermal_drift", "joint_1", values, PER_DEGREE),)),
        days(subject, True)[1],
    )
    bare = fitted_effects.predict(fitted_with(subject, ()), warm)[1]
    assert np.abs(fitted_effects.predict(model, warm)[1] - bare).max() > 0.05
    with pytest.raises(UnusableInput, match=r"5\.csv: .*no column temp\.joint_1"):
        fitted_effects.predict(model, dataclasses.replace(warm, temperature=None))


def test_a_joint_that_its_own_friction_heats_cools_where_it_slows_down(subject):
    """T ϑ̇ = p/p̄ − ϑ over motions that begin and end at rest: by run time alone the time constant
    would be another."""
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    coulomb, viscous = (
        float(psi[subject.parameters.block(kind)][0]) for kind in ("coulomb", "viscous")
    )
    constant, change, recordings, powers = 4.0, -0.5, [], []
    for one in recordings_of(subject, None):
        speed = np.gradient(one.q[:, 0], one.t)
        friction = coulomb * np.tanh(speed / FRICTION_WIDTH) + viscous * speed
        recordings.append((one, friction, friction * speed))
        powers.append(float(np.mean(friction * speed)))
    made = []
    for one, friction, power in recordings:
        warm = integrate.solve_ivp(
            lambda t, x, one=one, power=power: (
                (np.interp(t, one.t, power) / np.mean(powers) - x) / constant
            ),
            (one.t[0], one.t[-1]),
            [0.0],
            t_eval=one.t,
            max_step=0.05,
        ).y[0]
        made.append(dataclasses.replace(one, tau=one.torque + on(0, change * warm * friction)))
    result = diagnosis.diagnose(
        subject.robot, subject.parameters, subject.base, [made[0]], [made[1]]
    )
    (named,) = result.verdict.chosen
    assert (named.effect, named.joint) == ("thermal_drift", 0) and "power" in result.design.shapes[
        named.shape
    ].values
    assert document(result)["findings"][0]["where"]["statement"].endswith(
        "its own power heats the joint"
    )
    told = interval.finding_parameters(result.design, result.verdict, 0)
    assert told["time_constant"][0] == pytest.approx(constant, rel=0.1) and told["change"][
        0
    ] == pytest.approx(change, rel=0.1)
    assert result.after[0] < 1.3 * result.floor[0]


def heated(subject: IdentificationModel, constant: float) -> tuple[RecordedMotion, CandidateModel]:
    track = found(subject, None).motions[0][0]
    shapes = EFFECTS_BY_NAME["thermal_drift"].candidates([track])
    return track, next(s for s in shapes if s.joint == 0 and "power" in s.values).nonlinear.at(
        constant
    )


@pytest.mark.parametrize("constant", [1.0, 4.0, 15.0])
def test_friction_of_a_heated_joint_never_falls_far_below_nothing(subject, constant):
    """Fast at first and slow then: the joint is far warmer than at its usual power, and a change
    that is small there is large here."""
    track, _ = heated(subject, constant)
    q = track.segment.q.copy()
    slow = len(q) // 3
    q[slow:] = q[slow] + 0.1 * (q[slow:] - q[slow])
    uneven = dataclasses.replace(track, segment=dataclasses.replace(track.segment, q=q))
    shapes = EFFECTS_BY_NAME["thermal_drift"].candidates([uneven])
    shape = next(s for s in shapes if s.joint == 0 and "power" in s.values).nonlinear.at(constant)
    warm = thermal_drift._warming_by_losses(uneven, shape)
    for c in np.linspace(-4.0, -0.01, 200):
        if shape.is_plausible(np.array([c])):
            assert 1.0 + c * (warm.max() - warm.mean()) > -1e-9


@pytest.mark.parametrize("power", [True, False])
def test_a_gap_in_a_recording_makes_no_joint_cold(subject, power):
    track, shape = heated(subject, 6.0)
    if not power:
        shape = dataclasses.replace(
            shape, values={k: v for k, v in shape.values.items() if k != "power"}
        )
    half, start = len(track.segment) // 2, track.segment.start
    later = dataclasses.replace(
        track.segment,
        q=track.segment.q[half:],
        torque=track.segment.torque[half:],
        start=float(track.times[half]),
        recording_start=start,
    )
    whole_way, after = (
        thermal_drift._columns(
            dataclasses.replace(
                track, segment=piece, grid=Grid.RECORDED, kept=slice(0, len(piece))
            ),
            shape,
        )[:, 0, 0]
        for piece in (track.segment, later)
    )
    inside = slice(200, -200)  # off the ends, which a filter feels
    gone = whole_way[half:][inside] - after[inside]
    assert np.sqrt(np.mean(gone**2)) < 0.1 * np.sqrt(np.mean(after[inside] ** 2))
