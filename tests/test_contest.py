"""Names against each other, each as good as it gets."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from test_diagnose_search import halved, nothing, on_one

from excite.diagnose import contest, hypothesis, judge, search
from excite.diagnose.catalogue import environment, windup
from excite.diagnose.columns import Columns
from excite.diagnose.effect import Shape, beside, family

Array = np.ndarray
RNG = np.random.default_rng(5)
PLACES, STRONG, ODD, NOISE = ([RNG.uniform(-3.0, 3.0, 500) if k == 0 else RNG.normal(size=500) for _ in range(2)] for k in range(4))
BASE = [RNG.normal(size=(500, 2)) for _ in range(2)]
KNOWN = (1e-2 * np.eye(2), np.zeros(2))


def wave(order: float, number: int) -> Array:
    return np.asarray(np.cos(order * PLACES[number]))


def designed(columns: list[Array], torque: list[Array], grid: tuple[float, float]) -> search.Design:
    """A spring with a column of its own, and ripples whose order lies between those of a grid."""
    halves = [halved(g, (g @ [1.0, -2.0] + t + n)[:, None], KNOWN) for g, t, n in zip(BASE, torque, NOISE, strict=True)]

    def build(shape: Shape) -> tuple[Columns, Columns]:
        rows = columns if shape.effect == "spring" else [wave(shape.values["order"], n) for n in range(2)]
        return on_one(*(row[:, None] for row in rows))

    def ripple(order: float) -> Shape:
        return Shape("torque_ripple", 0, nothing, {"order": order})

    return search.design((halves[0], halves[1]), [Shape("spring", 0, nothing), *family(grid, ripple)], build)


def test_a_name_between_two_of_a_grid_beats_one_that_is_nearly_it():
    near = [wave(5.0, n) + 0.3 * ODD[n] for n in range(2)]
    one = designed(near, [4.0 * wave(5.0, n) for n in range(2)], (4.7, 5.3))
    alone = list(hypothesis.ranked(one))
    assert [h.effect for h in alone] == ["spring", "torque_ripple"] and alone[1].trial.gain > contest.CLOSE * alone[0].trial.gain
    done, (winner,) = contest._contested(one, [alone[0].shape])
    assert done.shapes[winner].effect == "torque_ripple"
    assert done.shapes[winner].values["order"] == pytest.approx(5.0, abs=0.02)
    assert contest._contested(done, [winner]) == (done, [winner])


def test_who_replaces_a_name_must_be_believed():
    near = [wave(5.0, n) + 0.3 * ODD[n] for n in range(2)]
    one = designed(near, [4.0 * wave(5.0, n) for n in range(2)], (4.7, 5.3))
    one = dataclasses.replace(one, measured=search.Measured({"torque_ripple": 1e5}))  # an encoder's steps may look like any ripple
    assert contest._contested(one, [0]) == (one, [0])
    assert [h.effect for h in judge.judged(one)[1].chosen] == ["spring"]


def test_a_further_name_is_tuned_before_it_is_left_out():
    strong = [30.0 * STRONG[n] + 5.0 * wave(5.0, n) for n in range(2)]
    one = designed(STRONG, strong, (4.4, 5.6))
    spring = judge.judged(one, [0])[1]
    now = search.trial(one, [0])
    grid = max((search.trial(one, [0, k]) for k in (1, 2)), key=lambda found: found.gain)
    assert grid.gain > now.gain and not contest._earns(one, [0], grid, now.gain)  # not worth it, as the grid has it
    assert {h.effect for h in spring.chosen} == {"spring", "torque_ripple"}


@pytest.mark.parametrize(("apart", "told"), [(0.1, "friction"), (1.0, "nonlinear_viscous")])
def test_of_names_as_good_as_each_other_the_plain_one_is_told(apart, told):
    """Torque of a bent friction; a plain one that is `apart` from it."""
    columns = {"nonlinear_viscous": STRONG, "friction": [STRONG[n] + apart * ODD[n] for n in range(2)]}
    halves = [halved(g, (g @ [1.0, -2.0] + 1.5 * x + n)[:, None], KNOWN) for g, x, n in zip(BASE, STRONG, NOISE, strict=True)]
    shapes = [Shape(name, 0, nothing) for name in columns]
    one = search.design((halves[0], halves[1]), shapes, lambda shape: on_one(*(x[:, None] for x in columns[shape.effect])))
    assert next(hypothesis.ranked(one)).effect == "nonlinear_viscous"
    assert [h.effect for h in judge.judged(one)[1].chosen] == [told]


PUSHED = [np.convolve(RNG.normal(size=4000), np.hanning(25), "same") for _ in range(2)]


def swings(frequency: float, damping: float, half: int) -> Array:
    """Speed of a mass on a spring that is pushed for 40 s."""
    omega, ones = 2.0 * np.pi * frequency, np.ones(4000)
    return windup.oscillator(omega * PUSHED[half], ones, omega**2 * ones, 2.0 * damping * omega * ones, 0.01)[1][::8]


@pytest.mark.parametrize("frequency", [1.7, 2.2, 2.82, 3.64])
def test_a_resonance_between_two_tried_frequencies_is_found(frequency):
    halves = [
        halved(g, (g @ [1.0, -2.0] + swings(frequency, 0.02, n) + n_)[:, None], KNOWN)
        for n, (g, n_) in enumerate(zip(BASE, NOISE, strict=True))
    ]

    def swing(damping: float):  # type: ignore[no-untyped-def]
        def shape(hertz: float) -> Shape:
            kin = lambda: beside(hertz, windup.NEAR, map(swing, windup.damped(damping)))  # noqa: E731
            return Shape("base_compliance", 0, nothing, {"frequency": hertz, "damping": damping}, kin=kin)

        return shape

    def build(shape: Shape) -> tuple[Columns, Columns]:
        return on_one(*(swings(shape.values["frequency"], shape.values["damping"], n)[:, None] for n in range(2)))

    shapes = [one for damping in environment.DAMPINGS for one in family(environment.SWINGS.tolist(), swing(damping))]
    done, verdict = judge.judged(search.design((halves[0], halves[1]), shapes, build))
    (finding,) = verdict.findings
    told = done.shapes[finding.main.shape].values
    assert told["frequency"] == pytest.approx(frequency, rel=0.02) and told["damping"] < 0.06
