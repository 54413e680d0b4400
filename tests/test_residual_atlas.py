"""The residual atlas: p-values on coloured noise, joint and variable of unmodelled torque."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from synthetic_recordings import (
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
)

from excite.diagnosis import diagnosis, residual_atlas, residual_curves
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.isolability import isolability
from excite.diagnosis.judge import Verdict
from excite.recordings import Recording
from excite.robot import robot

NOISE = 0.1
NULLS = 100


def with_effect(recording: Recording, extra: str) -> Recording:
    """Add the torque of an effect outside the base model to the second joint."""
    rate = recording.rate
    dq = np.gradient(recording.q, 1.0 / rate, axis=0)
    tau = recording.tau.copy()
    if extra == "stribeck":
        tau[:, 1] += 2.5 * np.exp(-((dq[:, 1] / 0.4) ** 2)) * np.tanh(dq[:, 1] / 0.004)
    elif extra == "ripple":
        tau[:, 1] += 1.0 * np.cos(20.0 * recording.q[:, 1])
    elif extra == "spring":
        tau[:, 1] += 4.0 * recording.q[:, 1] ** 3
    elif extra == "contact":
        t = recording.t - recording.t[0]
        tau[:, 1] += 3.0 * ((t > 6.0) & (t < 9.0)) * (recording.source == "validate.csv")
    return dataclasses.replace(recording, tau=tau)


@cache
def diagnosis_of(extra: str = "") -> Diagnosis:
    """Return a diagnosis that searches for no relevant effect: the residual contains the effect."""
    model = two_link_model()
    psi = perturbed_parameters(model.parameters, np.random.default_rng(3))
    recordings_of_both = []
    for seed, name in ((1, "train.csv"), (2, "validate.csv")):
        recording = synthetic_recording(
            model, psi, random_fourier(2, seed, 9.0), 2.5, NOISE, period=None, periodic=None
        )
        recordings_of_both.append(with_effect(dataclasses.replace(recording, source=name), extra))
    options = diagnosis.DiagnosisOptions(names=("drag",))
    result = diagnosis.diagnose(
        model.robot,
        model.parameters,
        model.base,
        recordings_of_both[:1],
        recordings_of_both[1:],
        options,
    )
    verdict = Verdict((), None, result.verdict.considered)
    return dataclasses.replace(
        result,
        verdict=verdict,
        after=result.before,
        residuals=(result.residuals[0], result.residuals[0]),
    )


def coloured(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return noise with a correlation time of about 0.15 s at 40 rows per second."""
    white = rng.normal(size=(shape[0] + 60, shape[1]))
    for k in range(1, len(white)):
        white[k] += 0.85 * white[k - 1]
    return white[60:]


def null(result: Diagnosis, rng: np.random.Generator, noise_rms: tuple[float, float]) -> Diagnosis:
    """Return the diagnosis of the same robot and motion with noise alone, its base model refit."""
    fitted, held_out = result.design.halves
    gammas = [half.gamma[half.rows] for half in (fitted, held_out)]
    noise = [(coloured(rng, (len(g) // 2, 2)) * noise_rms).ravel() for g in gammas]
    theta = np.linalg.lstsq(gammas[0], noise[0], rcond=1e-8)[0]
    residual_rows = np.zeros(len(fitted.joint))
    residual_rows[fitted.rows] = noise[0] - gammas[0] @ theta
    across = noise[1] - gammas[1] @ theta
    design = dataclasses.replace(
        result.design, residual=(residual_rows, result.design.residual[1]), across=across
    )
    scale = result.before / np.sqrt(np.mean(result.design.across.reshape(-1, 2) ** 2, axis=0))
    residual = across.reshape(-1, 2) * scale
    rms = np.sqrt(np.mean(residual**2, axis=0))
    return dataclasses.replace(
        result,
        design=design,
        residuals=(residual, residual),
        before=rms,
        after=rms,
        method="differences",
    )


def test_coloured_noise_has_uniform_p_values(monkeypatch: pytest.MonkeyPatch) -> None:
    result, rng = diagnosis_of(), np.random.default_rng(0)
    monkeypatch.setattr(residual_curves, "MAX_ORDERS", 60)
    rows = residual_curves.motion_rows(result.motions[1])
    curves = list(residual_curves.residual_curves(rows, ("joint_1", "joint_2")))
    monkeypatch.setattr(residual_curves, "motion_rows", lambda *_: rows)
    monkeypatch.setattr(residual_curves, "residual_curves", lambda *_: iter(curves))
    smallest_p = np.array(
        [
            min(
                p.p_before
                for p in residual_atlas.compute_atlas(
                    null(result, rng, (1.0, 5.0)), draws=199, seed=k
                ).panels
            )
            for k in range(NULLS)
        ]
    )
    assert np.mean(smallest_p < 0.05) <= 0.05 + 2.0 * np.sqrt(0.05 * 0.95 / NULLS)
    assert np.median(smallest_p) > 0.2  # the p-values are not conservative by construction


@pytest.mark.parametrize(
    ("extra", "against"),
    [("stribeck", "speed"), ("ripple", "order"), ("spring", "position"), ("contact", "time")],
)
def test_unmodelled_torque_is_shown_at_its_joint_over_its_variable(
    extra: str, against: str
) -> None:
    atlas = residual_atlas.compute_atlas(diagnosis_of(extra))
    first = atlas.shown[0]
    assert (first.joint, first.against) == (1, against)
    assert first.p_before < 0.05 and first.share_before > 0.5
    # the biased base fit leaves a residual at the other joint too, which is smaller
    assert (
        max((p.score_before for p in atlas.shown if p.joint == 0), default=0.0) < first.score_before
    )


def test_curve_of_a_torque_ripple_has_its_order_and_amplitude() -> None:
    result = diagnosis_of("ripple")
    panel = next(p for p in residual_atlas.compute_atlas(result).of(1) if p.against == "order")
    top = int(np.argmax(panel.mean_before))
    assert abs(panel.centres[top] - 20.0) < 0.5
    assert panel.mean_before[top] == pytest.approx(1.0, rel=0.25)
    assert panel.share_before > 0.5


def test_curves_before_and_after_are_equal_without_findings() -> None:
    for panel in residual_atlas.compute_atlas(diagnosis_of("stribeck")).panels:
        assert panel.p_before == panel.p_after
        np.testing.assert_array_equal(panel.mean_before, panel.mean_after)


def test_same_seed_gives_the_same_atlas() -> None:
    a, b = (residual_atlas.compute_atlas(diagnosis_of("stribeck"), seed=4) for _ in range(2))
    assert [p.p_before for p in a.panels] == [p.p_before for p in b.panels]


def test_temperature_is_a_variable_if_it_was_recorded() -> None:
    result = diagnosis_of("stribeck")
    first, *other_motions = result.motions[1]
    warm = np.column_stack([30.0 + 0.1 * first.times, np.full(len(first.segment), np.nan)])
    measured = dataclasses.replace(
        first, segment=dataclasses.replace(first.segment, temperature=warm)
    )
    warmed = dataclasses.replace(result, motions=(result.motions[0], [measured, *other_motions]))
    variables = {(p.joint, p.against) for p in residual_atlas.compute_atlas(warmed).panels}
    assert (0, "temperature, along the motion") in variables
    assert not any("temperature" in against for joint, against in variables if joint == 1)


def test_blocks_last_a_second_or_less_in_short_recordings() -> None:
    clock = np.arange(0.0, 10.0, 0.025)
    assert np.allclose(np.diff(clock[residual_curves.block_starts(clock, 1.0)]), 1.0)
    assert residual_curves.block_length(diagnosis_of().motions[1]) == pytest.approx(0.5, rel=0.2)


def test_travel_since_reversal_ignores_small_speed_reversals() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 401)
    q, dq = np.sin(t), np.cos(t) + 0.001 * (-1.0) ** np.arange(401)
    distance = residual_curves.travel_since_reversal(q, dq)
    assert distance.max() == pytest.approx(2.0, abs=0.01)
    assert distance[130] < 0.15 < distance[60]


def test_isolability_matrix_is_symmetric_with_unit_diagonal() -> None:
    machine = robot.load("two_link")
    result = diagnosis_of("stribeck")
    matrix = isolability(result.design)
    assert {machine.joints[c.joint] for c in matrix.candidates if c.joint is not None} == set(
        machine.joints
    )
    np.testing.assert_allclose(np.diag(matrix.matrix), 1.0)
    assert np.all((matrix.matrix >= 0.0) & (matrix.matrix <= 1.0))
    np.testing.assert_array_equal(matrix.matrix, matrix.matrix.T)
