"""Selection of effects: candidates are compared with optimised nonlinear parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from synthetic_recordings import (
    NO_KNOWN_COLUMNS,
    single_joint_columns,
    single_joint_fold,
    unexpected_columns,
)

from excite._types import FloatArray
from excite.diagnosis import contest, hypothesis, judge, search
from excite.diagnosis.columns import Columns
from excite.diagnosis.half import Half, whitened
from excite.diagnosis.measured import Measured
from excite.effects import base_compliance, gear_dynamics
from excite.effects.effect import CandidateModel, grid_candidates, variants_within

RNG = np.random.default_rng(5)
PLACES, STRONG, ODD, NOISE = (
    [RNG.uniform(-3.0, 3.0, 500) if k == 0 else RNG.normal(size=500) for _ in range(2)]
    for k in range(4)
)
BASE = [RNG.normal(size=(500, 2)) for _ in range(2)]
KNOWN = (1e-2 * np.eye(2), np.zeros(2))


def wave(order: float, number: int) -> FloatArray:
    return np.asarray(np.cos(order * PLACES[number]))


def regression_of(
    columns: list[FloatArray], torque: list[FloatArray], grid: tuple[float, float]
) -> search.EffectRegression:
    """Return a regression with a spring of given columns and ripples with orders of a grid."""
    folds = [
        single_joint_fold(g, (g @ [1.0, -2.0] + t + n)[:, None], KNOWN)
        for g, t, n in zip(BASE, torque, NOISE, strict=True)
    ]

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        rows = (
            columns
            if shape.effect == "spring"
            else [wave(shape.values["order"], n) for n in range(2)]
        )
        return single_joint_columns(*(row[:, None] for row in rows))

    def ripple(order: float) -> CandidateModel:
        return CandidateModel("torque_ripple", 0, unexpected_columns, {"order": order})

    return search.design(
        (folds[0], folds[1]),
        [CandidateModel("spring", 0, unexpected_columns), *grid_candidates(grid, ripple)],
        build,
    )


def test_an_effect_between_two_grid_values_is_preferred_to_a_similar_effect():
    near = [wave(5.0, n) + 0.3 * ODD[n] for n in range(2)]
    regression = regression_of(near, [4.0 * wave(5.0, n) for n in range(2)], (4.7, 5.3))
    alone = list(hypothesis.ranked(regression))
    assert [h.effect for h in alone] == ["spring", "torque_ripple"] and alone[
        1
    ].trial.gain > contest.CLOSE * alone[0].trial.gain
    result, (winner,) = contest._contested(regression, [alone[0].shape])
    assert result.shapes[winner].effect == "torque_ripple"
    assert result.shapes[winner].values["order"] == pytest.approx(5.0, abs=0.02)
    assert contest._contested(result, [winner]) == (result, [winner])


@pytest.mark.parametrize(("odd", "tuned"), [(0.3, 1), (0.125, 2)])
def test_all_effects_are_optimised_only_with_a_nearly_equal_candidate(monkeypatch, odd, tuned):
    """A ripple that explains, optimised, 0.85 or 0.97 of the torque of a spring."""
    regression = regression_of(*([[wave(5.0, n) + odd * ODD[n] for n in range(2)]] * 2), (4.7, 5.3))
    optimised, calls = search.optimised, list[int]()

    def count_calls(
        design: search.EffectRegression, chosen: Sequence[int], sweeps: int, since: int = 0
    ) -> list[search.Built]:
        calls.append(since)
        return optimised(design, chosen, sweeps, since)

    monkeypatch.setattr(search, "optimised", count_calls)
    contest._contested(regression, [0])
    assert len(calls) == tuned


def test_a_removed_effect_is_not_added_again(monkeypatch):
    regression = regression_of(
        [wave(5.0, n) for n in range(2)], [wave(5.0, n) for n in range(2)], (4.7, 5.3)
    )
    calls = list[list[int]]()
    monkeypatch.setattr(
        contest, "_further", lambda design, chosen: calls.append(chosen) or (design, [*chosen, 1])
    )
    monkeypatch.setattr(contest, "_replaced", lambda design, chosen: chosen[:1])
    monkeypatch.setattr(contest, "_contested", lambda design, chosen: (design, chosen))
    assert contest.searched(regression, [0]) == (regression, [0]) and calls == [[0]]


MIMICKED = Measured({("torque_ripple", 0): 1e5})
"""Quantisation that may mimic any torque ripple."""


def test_an_effect_that_an_artefact_mimics_replaces_no_other():
    both = [
        4.0 * wave(5.0, n) + 0.7 * ODD[n] for n in range(2)
    ]  # part of the spring's torque is no ripple
    regression = regression_of([wave(5.0, n) + 0.3 * ODD[n] for n in range(2)], both, (4.7, 5.3))
    regression = dataclasses.replace(regression, measured=MIMICKED)
    assert contest._contested(regression, [0]) == (regression, [0])
    assert [h.effect for h in judge.judged(regression)[1].chosen] == ["spring"]


def test_an_effect_that_an_artefact_mimics_is_accepted_if_it_explains_more_than_another():
    near = [wave(5.0, n) + 0.3 * ODD[n] for n in range(2)]
    regression = dataclasses.replace(
        regression_of(near, [4.0 * wave(5.0, n) for n in range(2)], (4.7, 5.3)), measured=MIMICKED
    )
    assert [h.effect for h in judge.judged(regression)[1].chosen] == ["torque_ripple"]
    alone = dataclasses.replace(
        regression_of(ODD, [4.0 * wave(5.0, n) for n in range(2)], (4.7, 5.3)), measured=MIMICKED
    )
    assert not judge.judged(alone)[1].findings  # no other effect is significant


def test_the_search_starts_with_an_optimised_effect_instead_of_two_grid_values():
    torque = [4.0 * wave(5.0, n) for n in range(2)]
    spring_columns = [wave(5.0, n) - 0.8 * wave(4.8, n) + 0.1 * ODD[n] for n in range(2)]
    regression = regression_of(spring_columns, torque, (4.8, 5.3))
    alone = list(hypothesis.ranked(regression))
    pair = contest._best_pair(regression, alone)
    assert alone[0].effect == "torque_ripple" and pair is not None
    done, chosen = contest.begun(regression, alone)
    assert [done.shapes[i].values["order"] for i in chosen] == [pytest.approx(5.0, abs=0.02)]
    regression = regression_of(ODD, [x + 2.0 * ODD[n] for n, x in enumerate(torque)], (4.8, 5.3))
    alone = list(hypothesis.ranked(regression))
    assert {regression.shapes[i].effect for i in contest.begun(regression, alone)[1]} == {
        "torque_ripple",
        "spring",
    }


def test_a_further_effect_is_optimised_before_it_is_rejected():
    strong = [30.0 * STRONG[n] + 5.0 * wave(5.0, n) for n in range(2)]
    regression = regression_of(STRONG, strong, (4.4, 5.6))
    spring = judge.judged(regression, [0])[1]
    without = search.trial(regression, [0])
    grid = max((search.trial(regression, [0, k]) for k in (1, 2)), key=lambda trial: trial.gain)
    assert grid.gain > without.gain and not contest._earns(
        regression, [0], grid, without.gain
    )  # the grid value is not significant
    assert {h.effect for h in spring.chosen} == {"spring", "torque_ripple"}


@pytest.mark.parametrize(("apart", "reported"), [(0.1, "friction"), (1.0, "nonlinear_viscous")])
def test_the_simpler_of_two_equivalent_effects_is_reported(apart, reported):
    """Torque of a nonlinear friction, and a simple friction that differs by `apart`."""
    columns = {
        "nonlinear_viscous": STRONG,
        "friction": [STRONG[n] + apart * ODD[n] for n in range(2)],
    }
    folds = [
        single_joint_fold(g, (g @ [1.0, -2.0] + 1.5 * x + n)[:, None], KNOWN)
        for g, x, n in zip(BASE, STRONG, NOISE, strict=True)
    ]
    shapes = [CandidateModel(name, 0, unexpected_columns) for name in columns]
    regression = search.design(
        (folds[0], folds[1]),
        shapes,
        lambda shape: single_joint_columns(*(x[:, None] for x in columns[shape.effect])),
    )
    assert next(hypothesis.ranked(regression)).effect == "nonlinear_viscous"
    assert [h.effect for h in judge.judged(regression)[1].chosen] == [reported]


PUSHED = [np.convolve(RNG.normal(size=4000), np.hanning(25), "same") for _ in range(2)]


def oscillation(frequency: float, damping: float, half: int) -> FloatArray:
    """Return the velocity of a driven oscillator over 40 s."""
    omega, ones = 2.0 * np.pi * frequency, np.ones(4000)
    return gear_dynamics.simulate_oscillator(
        omega * PUSHED[half], ones, omega**2 * ones, 2.0 * damping * omega * ones, 0.01
    )[1][::8]


@pytest.mark.parametrize("frequency", [1.7, 2.2, 2.82, 3.64])
def test_a_resonance_between_two_grid_frequencies_is_identified(frequency):
    folds = [
        single_joint_fold(
            g, (g @ [1.0, -2.0] + oscillation(frequency, 0.02, n) + n_)[:, None], KNOWN
        )
        for n, (g, n_) in enumerate(zip(BASE, NOISE, strict=True))
    ]

    def swing(damping: float):  # type: ignore[no-untyped-def]
        def shape(hertz: float) -> CandidateModel:
            variants = lambda: variants_within(  # noqa: E731
                hertz,
                gear_dynamics.FREQUENCY_FACTOR,
                map(swing, gear_dynamics.neighbouring_damping_ratios(damping)),
            )
            return CandidateModel(
                "base_compliance",
                0,
                unexpected_columns,
                {"frequency": hertz, "damping": damping},
                variants=variants,
            )

        return shape

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        return single_joint_columns(
            *(
                oscillation(shape.values["frequency"], shape.values["damping"], n)[:, None]
                for n in range(2)
            )
        )

    shapes = [
        candidate
        for damping in base_compliance.DAMPING_RATIOS
        for candidate in grid_candidates(base_compliance.FREQUENCIES.tolist(), swing(damping))
    ]
    done, verdict = judge.judged(search.design((folds[0], folds[1]), shapes, build))
    (finding,) = verdict.findings
    values = done.shapes[finding.main.shape].values
    assert values["frequency"] == pytest.approx(frequency, rel=0.02) and values["damping"] < 0.06


def test_effects_that_cancel_each_other_are_no_finding():
    """A small residual that equals the difference of two large, nearly equal torques."""
    rng = np.random.default_rng(0)
    gammas, common = (
        [rng.normal(size=(400, 2)) for _ in range(2)],
        [rng.normal(size=400) for _ in range(2)],
    )
    difference = [rng.normal(size=400) for _ in range(2)]
    columns = [
        {"drag": s, "stribeck": s + 0.01 * d} for s, d in zip(common, difference, strict=True)
    ]
    torques = [
        g @ [1.0, -2.0] + 2.0 * d + rng.normal(size=400)
        for g, d in zip(gammas, difference, strict=True)
    ]
    known = (1e-2 * np.eye(2), np.zeros(2))
    first, second = (
        single_joint_fold(g, t[:, None], known) for g, t in zip(gammas, torques, strict=True)
    )

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        return single_joint_columns(*(fold[shape.effect][:, None] for fold in columns))

    regression = search.design(
        (first, second),
        [
            CandidateModel("drag", 0, unexpected_columns),
            CandidateModel("stribeck", 0, unexpected_columns),
        ],
        build,
    )
    regression = dataclasses.replace(regression, prior=np.full(2, 1e-6))
    assert search.trial(regression, [0, 1]).gain > 200.0
    assert (
        not list(hypothesis.ranked(regression, (0,))) and not judge.judged(regression)[1].findings
    )


def two_joints(blurred: float = 1.0, fitting_effect: str = "spring") -> search.EffectRegression:
    """Return a regression with a strong drag at one joint and a weak effect at the other.

    A noisy copy of the model error of the drag is the column of a further effect.

    Args:
        blurred: Noise of that column.
        fitting_effect: Name of the further effect.
    """
    rng = np.random.default_rng(0)
    strong, model_error, other = ([rng.normal(size=300) for _ in range(2)] for _ in range(3))
    blur = [blurred * rng.normal(size=300) for _ in range(2)]
    folds, columns = list[Half](), list[dict[tuple[str, int | None], FloatArray]]()
    for s, r, o, b in zip(strong, model_error, other, blur, strict=True):
        both = np.column_stack([30.0 * s + 0.8 * r, 0.8 * o])
        torque = both + rng.normal(size=(300, 2))
        folds.append(
            whitened(
                [np.ones((300, 2, 1))],
                [torque],
                [np.ones(torque.shape, bool)],
                np.ones(2),
                NO_KNOWN_COLUMNS,
            )
        )
        joints = {
            ("drag", 0): np.column_stack([s, 0.0 * s]),
            (fitting_effect, 0): np.column_stack([r + b, 0.0 * r]),
        }
        columns.append({**joints, ("stribeck", 1): np.column_stack([0.0 * o, o])})

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        first, second = (
            Columns.of(fold[shape.effect, shape.joint][:, :, None]) for fold in columns
        )
        return first, second

    shapes = [CandidateModel(effect, joint, unexpected_columns) for effect, joint in columns[0]]
    regression = search.design((folds[0], folds[1]), shapes, build)
    return dataclasses.replace(regression, measured=Measured(noise=np.ones(2)))


def test_a_remaining_effect_has_to_be_significant_by_itself():
    regression = two_joints()
    _, verdict = judge.judged(regression, [0])
    assert ("drag", 0) in {(h.effect, h.joint) for h in verdict.chosen}
    doubtful = dataclasses.replace(
        regression,
        shapes=tuple(
            dataclasses.replace(shape, threshold_factor=1e12) for shape in regression.shapes
        ),
    )
    assert not judge.judged(doubtful, [0])[1].chosen


def test_a_weak_effect_at_another_joint_needs_no_share_of_a_strong_effect():
    regression = two_joints()
    _, verdict = judge.judged(regression)
    assert {(h.effect, h.joint) for h in verdict.chosen} == {
        ("drag", 0),
        ("stribeck", 1),
    }  # the effect that fits its model error is no finding
    guessed = dataclasses.replace(regression, measured=Measured())
    assert {(h.effect, h.joint) for h in judge.judged(guessed)[1].chosen} == {("drag", 0)}


def test_an_effect_that_explains_the_residual_to_the_noise_needs_no_share_of_a_strong_effect():
    regression = two_joints(blurred=0.0)
    _, verdict = judge.judged(regression)
    assert {(h.effect, h.joint) for h in verdict.chosen} == {
        ("drag", 0),
        ("spring", 0),
        ("stribeck", 1),
    }
    noisier = dataclasses.replace(
        regression, measured=Measured(noise=np.full(2, 1.5))
    )  # then the residual is within the noise
    assert {(h.effect, h.joint) for h in judge.judged(noisier)[1].chosen} == {
        ("drag", 0),
        ("stribeck", 1),
    }
    alike = two_joints(
        blurred=0.0, fitting_effect="nonlinear_viscous"
    )  # a confusable effect that fits all of the model error
    assert {(h.effect, h.joint) for h in judge.judged(alike)[1].chosen} == {
        ("drag", 0),
        ("stribeck", 1),
    }


def test_the_model_variant_of_a_strong_effect_depends_on_other_effects():
    """x³ and x/(1 + |x|) together resemble x^1.5: a power function alone has a lower exponent, with
    which the other effect would have the wrong sign."""
    rng = np.random.default_rng(1)
    x = [rng.normal(size=400) for _ in range(2)]
    torques = [3.0 * values**3 + 20.0 * values / (1.0 + np.abs(values)) for values in x]
    folds = [
        single_joint_fold(
            np.ones((400, 1)), t[:, None] + rng.normal(size=(400, 1)), NO_KNOWN_COLUMNS
        )
        for t in torques
    ]

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        if shape.effect == "stribeck":
            first, second = (values / (1.0 + np.abs(values)) for values in x)
        else:
            first, second = (
                np.sign(values) * np.abs(values) ** shape.values["exponent"] for values in x
            )
        return single_joint_columns(first[:, None], second[:, None])

    powers = [
        CandidateModel(
            "drag", 0, unexpected_columns, {"exponent": k}, is_plausible=lambda c: bool(c[0] > 0.0)
        )
        for k in (2.0, 2.5, 3.0)
    ]
    shapes = [
        *powers,
        CandidateModel("stribeck", 0, unexpected_columns, is_plausible=lambda c: bool(c[0] > 0.0)),
    ]
    regression = dataclasses.replace(
        search.design((folds[0], folds[1]), shapes, build), measured=Measured(noise=np.ones(1))
    )
    alone = next(hypothesis.ranked(regression))
    assert regression.shapes[alone.shape].values != {"exponent": 3.0}
    together, verdict = judge.judged(regression, [alone.shape])
    assert {together.shapes[i].effect for i in verdict.named} == {"drag", "stribeck"}
    assert {
        together.shapes[i].values["exponent"]
        for i in verdict.named
        if together.shapes[i].effect == "drag"
    } == {3.0}


def test_the_best_candidates_of_each_model_variant_are_kept():
    """Four other candidates alone predict better than a light coupling, which may still be the best
    after its nonlinear parameter is optimised."""
    rng = np.random.default_rng(4)
    truth = [rng.normal(size=200) for _ in range(2)]
    folds = [
        single_joint_fold(
            np.ones((200, 1)), 5.0 * t[:, None] + rng.normal(size=(200, 1)), NO_KNOWN_COLUMNS
        )
        for t in truth
    ]
    blurred = {
        ratio: [t + 0.1 * ratio * rng.normal(size=200) for t in truth] for ratio in range(1, 8)
    }

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        first, second = (x[:, None] for x in blurred[int(shape.values["ratio"])])
        return single_joint_columns(first, second)

    heavy = [
        CandidateModel("coupling", 0, unexpected_columns, {"ratio": float(ratio)}, 1)
        for ratio in range(1, 7)
    ]
    regression = search.design(
        (folds[0], folds[1]),
        [
            *heavy,
            CandidateModel("coupling", 0, unexpected_columns, {"ratio": 7.0, "light": 1.0}, 1),
        ],
        build,
    )
    assert [shape.values["ratio"] for shape in regression.shapes] == [1.0, 2.0, 3.0, 4.0, 7.0]


def test_folds_agree_about_torque_that_both_observe():
    rng = np.random.default_rng(2)
    a, b, noise_ = ([rng.normal(size=200) for _ in range(2)] for _ in range(3))
    slight = 0.01  # the first fold hardly observes the second column

    def regression_of(first: float, second: float) -> search.EffectRegression:
        """Return a regression with columns a and b; arguments: coefficient of b in each fold."""
        weights = (slight, 1.0)
        columns = [np.column_stack([x, by * y]) for x, y, by in zip(a, b, weights, strict=True)]
        torques = [
            c @ [2.0, k] + 0.1 * n for c, k, n in zip(columns, (first, second), noise_, strict=True)
        ]
        folds = [
            single_joint_fold(np.ones((200, 1)), t[:, None], NO_KNOWN_COLUMNS, 0.1) for t in torques
        ]
        return search.design(
            (folds[0], folds[1]),
            [CandidateModel("drag", 0, unexpected_columns)],
            lambda _: single_joint_columns(columns[0] / 0.1, columns[1] / 0.1),
        )

    for other, agree in ((3.0, True), (-40.0, True), (-3e3, False)):
        regression = regression_of(other, 3.0)
        assert hypothesis.agrees(regression, search.trial(regression, [0])) is agree


@pytest.mark.parametrize(
    ("large", "has_stronger", "counted"),
    [(0.27, False, True), (0.27, True, False), (0.2, False, False), (0.35, True, True)],
)
def test_a_weak_effect_counts_only_without_a_stronger_one(large, has_stronger, counted):
    shapes = [0, 1] if has_stronger else [1]
    regression = regression_of(
        [wave(5.0, n) for n in range(2)], [wave(5.0, n) for n in range(2)], (4.7, 5.3)
    )
    assert (
        hypothesis.counts(regression, search.trial(regression, shapes), [large] * len(shapes))
        == counted
    )
