"""Period, harmonics and repeats that nobody gave: the rule, and the budget of robot time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import BUILTIN, loaded, pendulum

from excite.designer import optimize, pipeline, time_budget
from excite.designer.criteria import Criterion
from excite.designer.options import DesignOptions
from excite.designer.time_budget import (
    DEVIATION_TOLERANCE,
    MAX_FREQUENCY,
    BudgetCandidate,
    BudgetPlan,
    MotionRequest,
)
from excite.errors import UnusableInput
from excite.robot import robot
from excite.robot.limits import Limits, resolve

SHORT = DesignOptions(iterations=15, jobs=1)


def bounds(position=(-1.0, 1.0), velocity=2.0, acceleration=np.inf, n=1) -> Limits:
    return Limits(
        joints=tuple(f"j{i}" for i in range(n)),
        position=np.array([position] * n, float),
        velocity=np.full(n, velocity),
        acceleration=np.full(n, acceleration),
        jerk=np.full(n, np.inf),
        torque=np.full(n, 10.0),
        braking=(None,) * n,
        sources={},
    )


# -- the rule ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "swept"),
    [
        ({}, np.pi),  # A ω = v
        ({"acceleration": 1.0}, 2.0 * np.pi),  # A ω² = a
        ({"position": (-7.0, 7.0)}, np.pi**2),  # half a turn each way is all there is
        ({"position": (-np.inf, np.inf)}, np.pi**2),
        ({"position": (2.0, 4.0)}, np.pi),
    ],
    ids=str,
)
def test_a_sweep_is_the_sinusoid_that_its_limits_just_allow(changes, swept):
    assert time_budget.sweep_periods(bounds(**changes)) == pytest.approx([swept])


@pytest.mark.parametrize("name", BUILTIN)
@pytest.mark.parametrize("rate", [100.0, 125.0, 500.0, 33.0])
def test_the_rule_gives_whole_samples_and_no_fast_harmonic(name, rate):
    found = resolve(robot.load(name))
    for harmonics in (3, 5, 12):
        period = time_budget.choose_period(found, harmonics, rate)
        optimize.samples_per_period(period, rate)
        assert harmonics / period <= MAX_FREQUENCY + 1e-9
        assert period <= time_budget.MAX_PERIOD


def test_the_rule_on_the_built_in_robots():
    """As in the README's table."""
    found = {name: time_budget.choose_period(resolve(robot.load(name))) for name in BUILTIN}
    assert found == {
        "fr3": 4.0,
        "iiwa14": 8.8,
        "panda": 7.0,
        "two_link": 5.2,
        "tx40": 4.0,
        "ur10e": 6.2,
        "ur5e": 6.2,
    }


def test_slow_joints_get_at_most_the_longest_period():
    assert time_budget.choose_period(bounds(velocity=0.01)) == time_budget.MAX_PERIOD


def test_the_rule_beats_ten_seconds_per_sample(two_link, table):
    fill = MotionRequest().complete(SHORT, table)
    ruled, ten = (
        optimize.solve(optimize.set_up(two_link, table, replace(fill, period=p)))
        .attempts[0]
        .objective
        for p in (fill.period, 10.0)
    )
    assert ruled < ten - 0.3


def test_what_is_given_is_kept(table):
    wish = MotionRequest(period=3.0, harmonics=7, samples=33, periods=4)
    found = wish.complete(DesignOptions(), table)
    assert (found.period, found.harmonics, found.samples, found.periods) == (3.0, 7, 33, 4)
    assert wish.unspecified == [] and MotionRequest(harmonics=7).unspecified == ["period", "samples", "periods"]
    assert MotionRequest(harmonics=7).complete(DesignOptions(), table).samples == 140


def test_a_joint_without_position_limits_has_a_period():
    machine = loaded(pendulum('<limit velocity="3" effort="40"/>', "continuous"))
    assert time_budget.choose_period(resolve(machine)) == pytest.approx(2.0 * np.pi**2 / 3.0, abs=0.1)


# -- the budget ----------------------------------------------------------------------------------------------------


def planned(two_link, table, budget=16.0, wish=MotionRequest(), options=SHORT, **more) -> BudgetPlan:  # noqa: B008
    return time_budget.plan_for_budget(two_link, table, options, wish, budget, **more)


def test_candidates_fill_the_time_and_the_simplest_good_one_is_chosen(two_link, table):
    found = planned(two_link, table)
    assert len(found.candidates) >= 3
    for c in found.candidates:
        assert (
            0.8 * 16.0 < c.robot_time <= 16.0
            and c.repeats >= 2
            and c.harmonics / c.period <= MAX_FREQUENCY + 1e-9
        )
        assert c.robot_time > c.repeats * c.period
    least = min(c.deviation for c in found.candidates)
    assert found.best.deviation <= (1.0 + DEVIATION_TOLERANCE) * least
    assert all(
        c.effort >= found.best.effort
        for c in found.candidates
        if c.deviation <= (1.0 + DEVIATION_TOLERANCE) * least
    )


def test_one_seed_gives_one_plan_on_any_number_of_processes(two_link, table):
    one, two = (
        planned(two_link, table, options=replace(SHORT, jobs=jobs)).reproducible_document() for jobs in (1, 2)
    )
    assert one == two and "seconds" not in one["candidates"][0]


@pytest.mark.parametrize(
    "wish",
    [
        MotionRequest(period=4.0),
        MotionRequest(harmonics=4),
        MotionRequest(samples=60),
        MotionRequest(periods=3),
        MotionRequest(period=3.0, harmonics=3, samples=40, periods=2),
    ],
)
def test_what_is_given_is_respected_and_only_the_rest_chosen(two_link, table, wish):
    for c in planned(two_link, table, request=wish).candidates:
        for name, value in (
            ("period", c.period),
            ("harmonics", c.harmonics),
            ("samples", c.samples),
            ("periods", c.repeats),
        ):
            assert getattr(wish, name) in (None, value)
        assert c.samples > 2 * c.harmonics


def test_information_already_there_counts_per_sample(two_link, table):
    setting = optimize.set_up(two_link, table, SHORT)
    root = setting.problem.parameters.scale / 1e3
    there = 1e9 * np.linalg.inv(root @ root.T)
    wish = MotionRequest(harmonics=3)
    assert max(
        c.deviation for c in planned(two_link, table, request=wish, earlier_information=there).candidates
    ) < 0.5 * min(c.deviation for c in planned(two_link, table, request=wish).candidates)


@pytest.mark.parametrize("criterion", list(Criterion))
def test_deviations_are_of_one_kind(two_link, table, criterion):
    """Twice the samples of a motion halve its variance; a condition number does not know how many there are."""
    base = optimize.set_up(two_link, table, SHORT).base
    once, twice = (time_budget._deviation(criterion, 2.0, base, count) for count in (100.0, 200.0))
    assert once / twice == pytest.approx(
        1.0 if criterion in (Criterion.COND, Criterion.COND_REGRESSOR) else np.sqrt(2.0)
    )


def test_time_that_is_too_short_is_refused_with_the_least_that_is_not(two_link, table):
    with pytest.raises(
        UnusableInput,
        match=r"--time 3 is too short: 2 periods of 2.4 s with ramps .* at least --time",
    ) as caught:
        planned(two_link, table, 3.0)
    least = float(str(caught.value).rsplit(" ", 1)[1])
    assert planned(two_link, table, least).best.robot_time <= least


@pytest.mark.parametrize(
    ("budget", "wish", "options", "words"),
    [
        (0.0, MotionRequest(), SHORT, "--time 0 should be positive"),
        (np.nan, MotionRequest(), SHORT, "--time nan should be positive"),
        (20.0, MotionRequest(), replace(SHORT, free_period=(1.0, 5.0)), "--optimise-period"),
        (12.0, MotionRequest(period=10.0), SHORT, "2 periods of 10 s"),
        (12.0, MotionRequest(periods=20), SHORT, "20 periods"),
        (12.0, MotionRequest(harmonics=0), SHORT, "--harmonics should be positive"),
        (12.0, MotionRequest(periods=1), SHORT, "--periods should be at least 2"),
        (12.0, MotionRequest(period=0.0), SHORT, "--period 0"),
    ],
)
def test_a_budget_that_contradicts_the_rest_is_refused(
    two_link, table, budget, wish, options, words
):
    with pytest.raises(UnusableInput, match=words):
        planned(two_link, table, budget, wish, options)


def test_a_start_pose_costs_time(two_link, table):
    pose = np.array([-1.5, 0.3])
    found = planned(two_link, table, start=pose, request=MotionRequest(harmonics=3))
    delivery = time_budget.run_plan(
        found, SHORT, lambda options: pipeline.design_trajectory(two_link, table, options, start=pose)
    )
    assert delivery.trajectory.motion.duration <= 16.0
    assert max(c.repeats * c.period for c in found.candidates) < 15.0


# -- the motion itself ---------------------------------------------------------------------------------------------


def candidate(period: float, repeats: int) -> BudgetCandidate:
    return BudgetCandidate(period, 3, 60, repeats, repeats * period + 1.0, 1.0, 1.0, 0.1)


class Robotic:
    """Stands for `workflow.run`: motions with ramps of one length, and what was asked for."""

    def __init__(self, ramps: float, speed: float = 1.0) -> None:
        self.ramps, self.speed, self.asked = ramps, speed, []

    def __call__(self, options: DesignOptions) -> SimpleNamespace:
        self.asked.append((options.period, options.periods))
        motion = SimpleNamespace(
            duration=(options.period * options.periods + self.ramps) / self.speed
        )
        return SimpleNamespace(
            trajectory=SimpleNamespace(motion=motion, design={"speed": self.speed})
        )


def test_longer_ramps_than_foreseen_shorten_the_period():
    run = Robotic(2.5)
    time_budget.run_plan(BudgetPlan(11.0, MotionRequest(), (candidate(3.0, 3),), 0), DesignOptions(), run)
    assert run.asked == [(3.0, 3), (2.8, 3)]


def test_or_take_a_repeat_where_the_period_is_given():
    run = Robotic(2.5)
    time_budget.run_plan(BudgetPlan(11.0, MotionRequest(period=3.0), (candidate(3.0, 3),), 0), DesignOptions(), run)
    assert run.asked == [(3.0, 3), (3.0, 2)]


def test_and_are_refused_where_nothing_may_give_way():
    with pytest.raises(
        UnusableInput, match=r"the motion takes 11\.5 s; give at least --time 11\.5"
    ):
        time_budget.run_plan(
            BudgetPlan(11.0, MotionRequest(period=3.0, periods=3), (candidate(3.0, 3),), 0),
            DesignOptions(),
            Robotic(2.5),
        )


def test_time_is_that_of_full_speed():
    run = Robotic(1.0, speed=0.1)
    time_budget.run_plan(BudgetPlan(11.0, MotionRequest(), (candidate(3.0, 3),), 0), DesignOptions(), run)
    assert run.asked == [(3.0, 3)]


def test_a_planned_motion_keeps_its_time(two_link, table):
    found = planned(two_link, table, 12.0, MotionRequest(harmonics=3))
    delivery = time_budget.run_plan(
        found, SHORT, lambda options: pipeline.design_trajectory(two_link, table, options)
    )
    assert delivery.trajectory.motion.duration <= 12.0 and delivery.certificate.ok
