"""The residual atlas: silent on noise of any colour, and where something is missing it says in
which joint and against what."""

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


def plant(recording: Recording, extra: str) -> Recording:
    """Torque of something that the base model does not have, on the second joint."""
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
def found(extra: str = "") -> Diagnosis:
    """A diagnosis with nothing looked for, so that what is planted stays in the residual."""
    model = two_link_model()
    psi = perturbed_parameters(model.parameters, np.random.default_rng(3))
    both = []
    for seed, name in ((1, "train.csv"), (2, "validate.csv")):
        one = synthetic_recording(
            model, psi, random_fourier(2, seed, 9.0), 2.5, NOISE, period=None, periodic=None
        )
        both.append(plant(dataclasses.replace(one, source=name), extra))
    options = diagnosis.DiagnosisOptions(names=("drag",))
    done = diagnosis.diagnose(
        model.robot, model.parameters, model.base, both[:1], both[1:], options
    )
    none = Verdict((), None, done.verdict.considered)
    return dataclasses.replace(
        done, verdict=none, after=done.before, residuals=(done.residuals[0], done.residuals[0])
    )


def coloured(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Noise that remembers about 0.15 s at 40 rows a second."""
    white = rng.normal(size=(shape[0] + 60, shape[1]))
    for k in range(1, len(white)):
        white[k] += 0.85 * white[k - 1]
    return white[60:]


def null(one: Diagnosis, rng: np.random.Generator, loud: tuple[float, float]) -> Diagnosis:
    """The same robot and motion with noise alone, its base refit."""
    fitted, held_out = one.design.halves
    gammas = [half.gamma[half.rows] for half in (fitted, held_out)]
    noise = [(coloured(rng, (len(g) // 2, 2)) * loud).ravel() for g in gammas]
    theta = np.linalg.lstsq(gammas[0], noise[0], rcond=1e-8)[0]
    left = np.zeros(len(fitted.joint))
    left[fitted.rows] = noise[0] - gammas[0] @ theta
    across = noise[1] - gammas[1] @ theta
    design = dataclasses.replace(one.design, residual=(left, one.design.residual[1]), across=across)
    scale = one.before / np.sqrt(np.mean(one.design.across.reshape(-1, 2) ** 2, axis=0))
    residual = across.reshape(-1, 2) * scale
    rms = np.sqrt(np.mean(residual**2, axis=0))
    return dataclasses.replace(
        one,
        design=design,
        residuals=(residual, residual),
        before=rms,
        after=rms,
        method="differences",
    )


def test_pure_noise_of_any_colour_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    one, rng = found(), np.random.default_rng(0)
    monkeypatch.setattr(residual_curves, "MAX_ORDERS", 60)
    motion_of = residual_curves.motion_rows(one.motions[1])
    same = list(residual_curves.residual_curves(motion_of, ("joint_1", "joint_2")))
    monkeypatch.setattr(residual_curves, "motion_rows", lambda *_: motion_of)
    monkeypatch.setattr(residual_curves, "residual_curves", lambda *_: iter(same))
    least = np.array(
        [
            min(
                p.p_before
                for p in residual_atlas.compute_atlas(
                    null(one, rng, (1.0, 5.0)), draws=199, seed=k
                ).panels
            )
            for k in range(NULLS)
        ]
    )
    assert np.mean(least < 0.05) <= 0.05 + 2.0 * np.sqrt(0.05 * 0.95 / NULLS)
    assert np.median(least) > 0.2  # and the p-values are no excuse for never saying anything


@pytest.mark.parametrize(
    ("extra", "against"),
    [("stribeck", "speed"), ("ripple", "order"), ("spring", "position"), ("contact", "time")],
)
def test_what_is_missing_shows_in_its_joint_against_what_it_depends_on(
    extra: str, against: str
) -> None:
    looked = residual_atlas.compute_atlas(found(extra))
    first = looked.shown[0]
    assert (first.joint, first.against) == (1, against)
    assert first.p_before < 0.05 and first.share_before > 0.5
    # the base fit, bent by what is missing, leaves a little in the other joint too: less than in
    # its own
    assert (
        max((p.score_before for p in looked.shown if p.joint == 0), default=0.0)
        < first.score_before
    )


def test_the_curve_is_that_of_what_was_planted() -> None:
    one = found("ripple")
    panel = next(p for p in residual_atlas.compute_atlas(one).of(1) if p.against == "order")
    top = int(np.argmax(panel.mean_before))
    assert abs(panel.centres[top] - 20.0) < 0.5
    assert panel.mean_before[top] == pytest.approx(1.0, rel=0.25)
    assert panel.share_before > 0.5


def test_before_and_after_are_the_same_without_findings() -> None:
    for panel in residual_atlas.compute_atlas(found("stribeck")).panels:
        assert panel.p_before == panel.p_after
        np.testing.assert_array_equal(panel.mean_before, panel.mean_after)


def test_the_same_seed_gives_the_same_atlas() -> None:
    a, b = (residual_atlas.compute_atlas(found("stribeck"), seed=4) for _ in range(2))
    assert [p.p_before for p in a.panels] == [p.p_before for p in b.panels]


def test_temperature_is_looked_at_where_it_was_recorded() -> None:
    one = found("stribeck")
    first, *rest = one.motions[1]
    warm = np.column_stack([30.0 + 0.1 * first.times, np.full(len(first.segment), np.nan)])
    measured = dataclasses.replace(
        first, segment=dataclasses.replace(first.segment, temperature=warm)
    )
    warmed = dataclasses.replace(one, motions=(one.motions[0], [measured, *rest]))
    seen = {(p.joint, p.against) for p in residual_atlas.compute_atlas(warmed).panels}
    assert (0, "temperature, along the motion") in seen
    assert not any("temperature" in against for joint, against in seen if joint == 1)


def test_blocks_are_of_a_second_but_a_short_recording_has_shorter_ones() -> None:
    clock = np.arange(0.0, 10.0, 0.025)
    assert np.allclose(np.diff(clock[residual_curves.block_starts(clock, 1.0)]), 1.0)
    assert residual_curves.block_length(found().motions[1]) == pytest.approx(0.5, rel=0.2)


def test_distance_since_reversal_ignores_a_crawl() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 401)
    q, dq = np.sin(t), np.cos(t) + 0.001 * (-1.0) ** np.arange(401)
    distance = residual_curves._travel_since_reversal(q, dq)
    assert distance.max() == pytest.approx(2.0, abs=0.01)
    assert distance[130] < 0.15 < distance[60]


def test_isolability_of_an_effect_with_itself_is_whole_and_of_unlike_ones_small() -> None:
    machine = robot.load("two_link")
    one = found("stribeck")
    seen = isolability(one.design)
    assert {machine.joints[c.joint] for c in seen.candidates if c.joint is not None} == set(
        machine.joints
    )
    np.testing.assert_allclose(np.diag(seen.matrix), 1.0)
    assert np.all((seen.matrix >= 0.0) & (seen.matrix <= 1.0))
    np.testing.assert_array_equal(seen.matrix, seen.matrix.T)
