"""Names against each other, each as good as it gets."""

from __future__ import annotations

import numpy as np
import pytest
from test_diagnose_search import halved, nothing, on_one

from excite.diagnose import judge, search
from excite.diagnose.columns import Columns
from excite.diagnose.effect import Shape, family

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
    alone = list(judge.ranked(one))
    assert [h.effect for h in alone] == ["spring", "torque_ripple"] and alone[1].trial.gain > judge.CLOSE * alone[0].trial.gain
    done, (winner,) = judge._contested(one, [alone[0].shape])
    assert done.shapes[winner].effect == "torque_ripple"
    assert done.shapes[winner].values["order"] == pytest.approx(5.0, abs=0.02)
    assert judge._contested(done, [winner]) == (done, [winner])
    assert [h.effect for h in judge.judged(one)[1].chosen] == ["torque_ripple"]


def test_a_further_name_is_tuned_before_it_is_left_out():
    strong = [30.0 * STRONG[n] + 5.0 * wave(5.0, n) for n in range(2)]
    one = designed(STRONG, strong, (4.4, 5.6))
    spring = judge.judged(one, [0])[1]
    now = search.trial(one, [0])
    grid = max((search.trial(one, [0, k]) for k in (1, 2)), key=lambda found: found.gain)
    assert judge.SMALLEST < grid.gain - now.gain < judge.SHARE * now.gain  # not worth it, as the grid has it
    assert {h.effect for h in spring.chosen} == {"spring", "torque_ripple"}
