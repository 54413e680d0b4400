"""Names against each other, each as good as it gets."""

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

from excite.diagnosis import contest, hypothesis, judge, search
from excite.diagnosis.columns import Columns
from excite.diagnosis.half import Half, whitened
from excite.diagnosis.measured import Measured
from excite.effects import base_compliance, gear_dynamics
from excite.effects.effect import CandidateModel, grid_candidates, variants_within

Array = np.ndarray
RNG = np.random.default_rng(5)
PLACES, STRONG, ODD, NOISE = (
    [RNG.uniform(-3.0, 3.0, 500) if k == 0 else RNG.normal(size=500) for _ in range(2)]
    for k in range(4)
)
BASE = [RNG.normal(size=(500, 2)) for _ in range(2)]
KNOWN = (1e-2 * np.eye(2), np.zeros(2))


def wave(order: float, number: int) -> Array:
    return np.asarray(np.cos(order * PLACES[number]))


def designed(
    columns: list[Array], torque: list[Array], grid: tuple[float, float]
) -> search.EffectRegression:
    """A spring with a column of its own, and ripples whose order lies between those of a grid."""
    halves = [
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
        (halves[0], halves[1]),
        [CandidateModel("spring", 0, unexpected_columns), *grid_candidates(grid, ripple)],
        build,
    )


def test_a_name_between_two_of_a_grid_beats_one_that_is_nearly_it():
    near = [wave(5.0, n) + 0.3 * ODD[n] for n in range(2)]
    one = designed(near, [4.0 * wave(5.0, n) for n in range(2)], (4.7, 5.3))
    alone = list(hypothesis.ranked(one))
    assert [h.effect for h in alone] == ["spring", "torque_ripple"] and alone[
        1
    ].trial.gain > contest.CLOSE * alone[0].trial.gain
    done, (winner,) = contest._contested(one, [alone[0].shape])
    assert done.shapes[winner].effect == "torque_ripple"
    assert done.shapes[winner].values["order"] == pytest.approx(5.0, abs=0.02)
    assert contest._contested(done, [winner]) == (done, [winner])


@pytest.mark.parametrize(("odd", "tuned"), [(0.3, 1), (0.125, 2)])
def test_all_are_tuned_only_with_what_tuned_alone_is_nearly_as_good(monkeypatch, odd, tuned):
    """A ripple that, tuned, takes 0.85 or 0.97 of what a spring does."""
    one = designed(*([[wave(5.0, n) + odd * ODD[n] for n in range(2)]] * 2), (4.7, 5.3))
    real, asked = search.optimised, list[int]()

    def turned(
        design: search.EffectRegression, chosen: Sequence[int], sweeps: int, since: int = 0
    ) -> list[search.Built]:
        asked.append(since)
        return real(design, chosen, sweeps, since)

    monkeypatch.setattr(search, "optimised", turned)
    contest._contested(one, [0])
    assert len(asked) == tuned


def test_what_did_not_stay_is_not_added_again(monkeypatch):
    one = designed([wave(5.0, n) for n in range(2)], [wave(5.0, n) for n in range(2)], (4.7, 5.3))
    asked = list[list[int]]()
    monkeypatch.setattr(
        contest, "_further", lambda design, chosen: asked.append(chosen) or (design, [*chosen, 1])
    )
    monkeypatch.setattr(contest, "_replaced", lambda design, chosen: chosen[:1])
    monkeypatch.setattr(contest, "_contested", lambda design, chosen: (design, chosen))
    assert contest.searched(one, [0]) == (one, [0]) and asked == [[0]]


FEIGNED = Measured({("torque_ripple", 0): 1e5})
"""An encoder's steps may look like any ripple."""


def test_who_replaces_a_name_must_be_believed():
    both = [
        4.0 * wave(5.0, n) + 0.7 * ODD[n] for n in range(2)
    ]  # some of what the spring says is no ripple's
    one = designed([wave(5.0, n) + 0.3 * ODD[n] for n in range(2)], both, (4.7, 5.3))
    one = dataclasses.replace(one, measured=FEIGNED)
    assert contest._contested(one, [0]) == (one, [0])
    assert [h.effect for h in judge.judged(one)[1].chosen] == ["spring"]


def test_what_a_fault_may_feign_is_believed_where_it_says_all_that_another_says_and_better():
    near = [wave(5.0, n) + 0.3 * ODD[n] for n in range(2)]
    one = dataclasses.replace(
        designed(near, [4.0 * wave(5.0, n) for n in range(2)], (4.7, 5.3)), measured=FEIGNED
    )
    assert [h.effect for h in judge.judged(one)[1].chosen] == ["torque_ripple"]
    alone = dataclasses.replace(
        designed(ODD, [4.0 * wave(5.0, n) for n in range(2)], (4.7, 5.3)), measured=FEIGNED
    )
    assert not judge.judged(alone)[1].findings  # nothing else says that something is there


def test_a_search_begins_with_one_name_where_it_says_tuned_what_two_say_on_a_grid():
    torque = [4.0 * wave(5.0, n) for n in range(2)]
    rest = [wave(5.0, n) - 0.8 * wave(4.8, n) + 0.1 * ODD[n] for n in range(2)]
    one = designed(rest, torque, (4.8, 5.3))
    alone = list(hypothesis.ranked(one))
    pair = contest._best_pair(one, alone)
    assert alone[0].effect == "torque_ripple" and pair is not None
    done, chosen = contest.begun(one, alone)
    assert [done.shapes[i].values["order"] for i in chosen] == [pytest.approx(5.0, abs=0.02)]
    one = designed(ODD, [x + 2.0 * ODD[n] for n, x in enumerate(torque)], (4.8, 5.3))
    alone = list(hypothesis.ranked(one))
    assert {one.shapes[i].effect for i in contest.begun(one, alone)[1]} == {
        "torque_ripple",
        "spring",
    }


def test_a_further_name_is_tuned_before_it_is_left_out():
    strong = [30.0 * STRONG[n] + 5.0 * wave(5.0, n) for n in range(2)]
    one = designed(STRONG, strong, (4.4, 5.6))
    spring = judge.judged(one, [0])[1]
    now = search.trial(one, [0])
    grid = max((search.trial(one, [0, k]) for k in (1, 2)), key=lambda found: found.gain)
    assert grid.gain > now.gain and not contest._earns(
        one, [0], grid, now.gain
    )  # not worth it, as the grid has it
    assert {h.effect for h in spring.chosen} == {"spring", "torque_ripple"}


@pytest.mark.parametrize(("apart", "told"), [(0.1, "friction"), (1.0, "nonlinear_viscous")])
def test_of_names_as_good_as_each_other_the_plain_one_is_told(apart, told):
    """Torque of a bent friction; a plain one that is `apart` from it."""
    columns = {
        "nonlinear_viscous": STRONG,
        "friction": [STRONG[n] + apart * ODD[n] for n in range(2)],
    }
    halves = [
        single_joint_fold(g, (g @ [1.0, -2.0] + 1.5 * x + n)[:, None], KNOWN)
        for g, x, n in zip(BASE, STRONG, NOISE, strict=True)
    ]
    shapes = [CandidateModel(name, 0, unexpected_columns) for name in columns]
    one = search.design(
        (halves[0], halves[1]),
        shapes,
        lambda shape: single_joint_columns(*(x[:, None] for x in columns[shape.effect])),
    )
    assert next(hypothesis.ranked(one)).effect == "nonlinear_viscous"
    assert [h.effect for h in judge.judged(one)[1].chosen] == [told]


PUSHED = [np.convolve(RNG.normal(size=4000), np.hanning(25), "same") for _ in range(2)]


def swings(frequency: float, damping: float, half: int) -> Array:
    """Speed of a mass on a spring that is pushed for 40 s."""
    omega, ones = 2.0 * np.pi * frequency, np.ones(4000)
    return gear_dynamics.simulate_oscillator(
        omega * PUSHED[half], ones, omega**2 * ones, 2.0 * damping * omega * ones, 0.01
    )[1][::8]


@pytest.mark.parametrize("frequency", [1.7, 2.2, 2.82, 3.64])
def test_a_resonance_between_two_tried_frequencies_is_found(frequency):
    halves = [
        single_joint_fold(g, (g @ [1.0, -2.0] + swings(frequency, 0.02, n) + n_)[:, None], KNOWN)
        for n, (g, n_) in enumerate(zip(BASE, NOISE, strict=True))
    ]

    def swing(damping: float):  # type: ignore[no-untyped-def]
        def shape(hertz: float) -> CandidateModel:
            kin = lambda: variants_within(  # noqa: E731
                hertz,
                gear_dynamics.FREQUENCY_FACTOR,
                map(swing, gear_dynamics.neighbouring_damping_ratios(damping)),
            )
            return CandidateModel(
                "base_compliance",
                0,
                unexpected_columns,
                {"frequency": hertz, "damping": damping},
                variants=kin,
            )

        return shape

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        return single_joint_columns(
            *(
                swings(shape.values["frequency"], shape.values["damping"], n)[:, None]
                for n in range(2)
            )
        )

    shapes = [
        one
        for damping in base_compliance.DAMPING_RATIOS
        for one in grid_candidates(base_compliance.FREQUENCIES.tolist(), swing(damping))
    ]
    done, verdict = judge.judged(search.design((halves[0], halves[1]), shapes, build))
    (finding,) = verdict.findings
    told = done.shapes[finding.main.shape].values
    assert told["frequency"] == pytest.approx(frequency, rel=0.02) and told["damping"] < 0.06


def test_shapes_that_take_each_other_off_are_no_finding():
    """A small residual, told as the difference of two large torques that are nearly the same."""
    rng = np.random.default_rng(0)
    gammas, same = (
        [rng.normal(size=(400, 2)) for _ in range(2)],
        [rng.normal(size=400) for _ in range(2)],
    )
    slight = [rng.normal(size=400) for _ in range(2)]
    columns = [{"drag": s, "stribeck": s + 0.01 * d} for s, d in zip(same, slight, strict=True)]
    torques = [
        g @ [1.0, -2.0] + 2.0 * d + rng.normal(size=400)
        for g, d in zip(gammas, slight, strict=True)
    ]
    known = (1e-2 * np.eye(2), np.zeros(2))
    first, second = (
        single_joint_fold(g, t[:, None], known) for g, t in zip(gammas, torques, strict=True)
    )

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        return single_joint_columns(*(own[shape.effect][:, None] for own in columns))

    one = search.design(
        (first, second),
        [
            CandidateModel("drag", 0, unexpected_columns),
            CandidateModel("stribeck", 0, unexpected_columns),
        ],
        build,
    )
    one = dataclasses.replace(one, prior=np.full(2, 1e-6))
    assert search.trial(one, [0, 1]).gain > 200.0
    assert not list(hypothesis.ranked(one, (0,))) and not judge.judged(one)[1].findings


def two_joints(blurred: float = 1.0, mend: str = "spring") -> search.EffectRegression:
    """A strong drag at one of two joints, of a form that a blurred spring mends, or another effect;
    and a slight one at the other."""
    rng = np.random.default_rng(0)
    strong, rest, other = ([rng.normal(size=300) for _ in range(2)] for _ in range(3))
    blur = [blurred * rng.normal(size=300) for _ in range(2)]
    halves, columns = list[Half](), list[dict[tuple[str, int | None], Array]]()
    for s, r, o, b in zip(strong, rest, other, blur, strict=True):
        both = np.column_stack([30.0 * s + 0.8 * r, 0.8 * o])
        left = both + rng.normal(size=(300, 2))
        halves.append(
            whitened(
                [np.ones((300, 2, 1))],
                [left],
                [np.ones(left.shape, bool)],
                np.ones(2),
                NO_KNOWN_COLUMNS,
            )
        )
        joints = {
            ("drag", 0): np.column_stack([s, 0.0 * s]),
            (mend, 0): np.column_stack([r + b, 0.0 * r]),
        }
        columns.append({**joints, ("stribeck", 1): np.column_stack([0.0 * o, o])})

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        first, second = (Columns.of(own[shape.effect, shape.joint][:, :, None]) for own in columns)
        return first, second

    shapes = [CandidateModel(effect, joint, unexpected_columns) for effect, joint in columns[0]]
    one = search.design((halves[0], halves[1]), shapes, build)
    return dataclasses.replace(one, measured=Measured(noise=np.ones(2)))


def test_what_is_left_alone_must_be_believed_by_itself():
    one = two_joints()
    _, verdict = judge.judged(one, [0])
    assert ("drag", 0) in {(h.effect, h.joint) for h in verdict.chosen}
    doubtful = dataclasses.replace(
        one, shapes=tuple(dataclasses.replace(shape, threshold_factor=1e12) for shape in one.shapes)
    )
    assert not judge.judged(doubtful, [0])[1].chosen


def test_where_a_strong_effect_does_not_act_a_slight_one_needs_no_share_of_it():
    one = two_joints()
    _, verdict = judge.judged(one)
    assert {(h.effect, h.joint) for h in verdict.chosen} == {
        ("drag", 0),
        ("stribeck", 1),
    }  # what mends the drag is no finding
    guessed = dataclasses.replace(one, measured=Measured())
    assert {(h.effect, h.joint) for h in judge.judged(guessed)[1].chosen} == {("drag", 0)}


def test_what_explains_all_that_another_leaves_beyond_noise_needs_no_share_of_it():
    one = two_joints(blurred=0.0)
    _, verdict = judge.judged(one)
    assert {(h.effect, h.joint) for h in verdict.chosen} == {
        ("drag", 0),
        ("spring", 0),
        ("stribeck", 1),
    }
    louder = dataclasses.replace(
        one, measured=Measured(noise=np.full(2, 1.5))
    )  # then there is nothing beyond it
    assert {(h.effect, h.joint) for h in judge.judged(louder)[1].chosen} == {
        ("drag", 0),
        ("stribeck", 1),
    }
    alike = two_joints(
        blurred=0.0, mend="nonlinear_viscous"
    )  # what is taken for a drag mends one, and all of it
    assert {(h.effect, h.joint) for h in judge.judged(alike)[1].chosen} == {
        ("drag", 0),
        ("stribeck", 1),
    }


def test_beside_another_a_strong_effect_may_need_another_of_its_shapes():
    """x³ and x/(1 + |x|) look like x^1.5 or so: alone, the power is told between them, beside which
    the other is told of the wrong sign."""
    rng = np.random.default_rng(1)
    x = [rng.normal(size=400) for _ in range(2)]
    torques = [3.0 * own**3 + 20.0 * own / (1.0 + np.abs(own)) for own in x]
    halves = [
        single_joint_fold(
            np.ones((400, 1)), t[:, None] + rng.normal(size=(400, 1)), NO_KNOWN_COLUMNS
        )
        for t in torques
    ]

    def build(shape: CandidateModel) -> tuple[Columns, Columns]:
        if shape.effect == "stribeck":
            first, second = (own / (1.0 + np.abs(own)) for own in x)
        else:
            first, second = (np.sign(own) * np.abs(own) ** shape.values["exponent"] for own in x)
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
    one = dataclasses.replace(
        search.design((halves[0], halves[1]), shapes, build), measured=Measured(noise=np.ones(1))
    )
    alone = next(hypothesis.ranked(one))
    assert one.shapes[alone.shape].values != {"exponent": 3.0}
    together, verdict = judge.judged(one, [alone.shape])
    assert {together.shapes[i].effect for i in verdict.named} == {"drag", "stribeck"}
    assert {
        together.shapes[i].values["exponent"]
        for i in verdict.named
        if together.shapes[i].effect == "drag"
    } == {3.0}


def test_the_best_of_each_law_is_looked_at():
    """Alone, four other shapes predict better than a light coupling; a law with a value turned
    better than its grid may win yet."""
    rng = np.random.default_rng(4)
    truth = [rng.normal(size=200) for _ in range(2)]
    halves = [
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
    one = search.design(
        (halves[0], halves[1]),
        [
            *heavy,
            CandidateModel("coupling", 0, unexpected_columns, {"ratio": 7.0, "light": 1.0}, 1),
        ],
        build,
    )
    assert [shape.values["ratio"] for shape in one.shapes] == [1.0, 2.0, 3.0, 4.0, 7.0]


def test_halves_agree_about_what_both_see():
    rng = np.random.default_rng(2)
    a, b, noise_ = ([rng.normal(size=200) for _ in range(2)] for _ in range(3))
    slight = 0.01  # of the second column, the first half sees next to nothing

    def designed(first: float, second: float) -> search.EffectRegression:
        """b's coefficient in either half, of columns a and b."""
        seen = (slight, 1.0)
        columns = [np.column_stack([x, by * y]) for x, y, by in zip(a, b, seen, strict=True)]
        own = [
            c @ [2.0, k] + 0.1 * n for c, k, n in zip(columns, (first, second), noise_, strict=True)
        ]
        halves = [
            single_joint_fold(np.ones((200, 1)), t[:, None], NO_KNOWN_COLUMNS, 0.1) for t in own
        ]
        return search.design(
            (halves[0], halves[1]),
            [CandidateModel("drag", 0, unexpected_columns)],
            lambda _: single_joint_columns(columns[0] / 0.1, columns[1] / 0.1),
        )

    for other, agree in ((3.0, True), (-40.0, True), (-3e3, False)):
        one = designed(other, 3.0)
        assert hypothesis.agrees(one, search.trial(one, [0])) is agree


@pytest.mark.parametrize(
    ("large", "beside", "counted"),
    [(0.27, False, True), (0.27, True, False), (0.2, False, False), (0.35, True, True)],
)
def test_a_slight_effect_counts_alone_and_not_beside_another(large, beside, counted):
    shapes = [0, 1] if beside else [1]
    one = designed([wave(5.0, n) for n in range(2)], [wave(5.0, n) for n in range(2)], (4.7, 5.3))
    assert hypothesis.counts(one, search.trial(one, shapes), [large] * len(shapes)) == counted
