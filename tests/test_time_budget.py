"""Choice of period, harmonics and repeats, by the rule and for a budget of robot time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import BUILTIN, loaded, pendulum

from excite.api import design
from excite.designer import optimize, pipeline, time_budget
from excite.designer.criteria import Criterion
from excite.designer.options import DesignOptions, check_played_period, samples_per_period
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


# rule


@pytest.mark.parametrize(
    ("changes", "swept"),
    [
        ({}, np.pi),  # A ω = v
        ({"acceleration": 1.0}, 2.0 * np.pi),  # A ω² = a
        ({"position": (-7.0, 7.0)}, np.pi**2),  # at most half a turn in each direction
        ({"position": (-np.inf, np.inf)}, np.pi**2),
        ({"position": (2.0, 4.0)}, np.pi),
    ],
    ids=str,
)
def test_sweep_period_of_a_sinusoid_at_its_limits(changes, swept):
    assert time_budget.sweep_periods(bounds(**changes)) == pytest.approx([swept])


@pytest.mark.parametrize("name", BUILTIN)
@pytest.mark.parametrize("rate", [100.0, 125.0, 500.0, 33.0])
def test_rule_gives_whole_samples_and_bounded_frequencies(name, rate):
    limits = resolve(robot.load(name))
    for harmonics in (3, 5, 12):
        period = time_budget.choose_period(limits, harmonics, rate)
        samples_per_period(period, rate)
        assert harmonics / period <= MAX_FREQUENCY + 1e-9
        assert period <= time_budget.MAX_PERIOD


@pytest.mark.parametrize(
    ("speed", "remedy"), [(0.6, "--period 4.59"), (1.0 / np.sqrt(2.0), "another --speed")]
)
def test_a_slower_motion_needs_whole_samples_too(speed, remedy):
    with pytest.raises(UnusableInput, match=f"--speed .* use {remedy}"):
        check_played_period(4.6, 100.0, speed)
    check_played_period(4.59, 100.0, 0.6)


def test_rule_for_built_in_robots():
    """The periods in the table of the documentation."""
    periods = {name: time_budget.choose_period(resolve(robot.load(name))) for name in BUILTIN}
    assert periods == {
        "fr3": 4.0,
        "iiwa14": 8.8,
        "panda": 7.0,
        "two_link": 5.2,
        "tx40": 4.0,
        "ur10e": 6.2,
        "ur5e": 6.2,
    }


def test_period_is_limited_for_slow_joints():
    assert time_budget.choose_period(bounds(velocity=0.01)) == time_budget.MAX_PERIOD


def test_rule_gives_more_information_per_sample_than_ten_seconds(two_link, table):
    completed = MotionRequest().complete(SHORT, table)
    ruled, ten = (
        optimize.solve(optimize.set_up(two_link, table, replace(completed, period=p)))
        .attempts[0]
        .objective
        for p in (completed.period, 10.0)
    )
    assert ruled < ten - 0.3


def test_stated_quantities_are_kept(table):
    desired = MotionRequest(period=3.0, harmonics=7, samples=33, periods=4)
    options = desired.complete(DesignOptions(), table)
    assert (options.period, options.harmonics, options.samples, options.periods) == (3.0, 7, 33, 4)
    assert desired.unspecified == [] and MotionRequest(harmonics=7).unspecified == [
        "period",
        "samples",
        "periods",
    ]
    assert MotionRequest(harmonics=7).complete(DesignOptions(), table).samples == 140


def test_continuous_joint_has_a_sweep_period():
    machine = loaded(pendulum('<limit velocity="3" effort="40"/>', "continuous"))
    assert time_budget.choose_period(resolve(machine)) == pytest.approx(
        2.0 * np.pi**2 / 3.0, abs=0.1
    )


# budget


def planned(two_link, table, budget=16.0, desired=None, options=SHORT, **arguments) -> BudgetPlan:
    return time_budget.plan_for_budget(
        two_link, table, options, desired or MotionRequest(), budget, **arguments
    )


def test_candidates_fill_the_budget_and_the_simplest_good_one_is_chosen(two_link, table):
    plan = planned(two_link, table)
    assert len(plan.candidates) >= 3
    for c in plan.candidates:
        assert (
            0.8 * 16.0 < c.robot_time <= 16.0
            and c.repeats >= 2
            and c.harmonics / c.period <= MAX_FREQUENCY + 1e-9
        )
        assert c.robot_time > c.repeats * c.period
    least = min(c.deviation for c in plan.candidates)
    assert plan.best.deviation <= (1.0 + DEVIATION_TOLERANCE) * least
    assert all(
        c.effort >= plan.best.effort
        for c in plan.candidates
        if c.deviation <= (1.0 + DEVIATION_TOLERANCE) * least
    )


def test_plan_does_not_depend_on_the_number_of_processes(two_link, table):
    serial, parallel = (
        planned(two_link, table, options=replace(SHORT, jobs=jobs)).reproducible_document()
        for jobs in (1, 2)
    )
    assert serial == parallel and "seconds" not in serial["candidates"][0]


@pytest.mark.parametrize(
    "desired",
    [
        MotionRequest(period=4.0),
        MotionRequest(harmonics=4),
        MotionRequest(samples=60),
        MotionRequest(periods=3),
        MotionRequest(period=3.0, harmonics=3, samples=40, periods=2),
    ],
)
def test_only_free_quantities_are_chosen(two_link, table, desired):
    for c in planned(two_link, table, desired=desired).candidates:
        for name, value in (
            ("period", c.period),
            ("harmonics", c.harmonics),
            ("samples", c.samples),
            ("periods", c.repeats),
        ):
            assert getattr(desired, name) in (None, value)
        assert c.samples > 2 * c.harmonics


def test_earlier_information_lowers_the_deviation(two_link, table):
    setup = optimize.set_up(two_link, table, SHORT)
    root = setup.problem.parameters.scale / 1e3
    earlier = 1e9 * np.linalg.inv(root @ root.T)
    desired = MotionRequest(harmonics=3)
    assert max(
        c.deviation
        for c in planned(two_link, table, desired=desired, earlier_information=earlier).candidates
    ) < 0.5 * min(c.deviation for c in planned(two_link, table, desired=desired).candidates)


@pytest.mark.parametrize("criterion", list(Criterion))
def test_deviation_scales_with_the_number_of_samples(two_link, table, criterion):
    """Twice the samples halve the variance; condition numbers do not depend on their number."""
    base = optimize.set_up(two_link, table, SHORT).base
    once, twice = (
        time_budget.predicted_deviation(criterion, 2.0, base, count) for count in (100.0, 200.0)
    )
    assert once / twice == pytest.approx(
        1.0 if criterion in (Criterion.COND, Criterion.COND_REGRESSOR) else np.sqrt(2.0)
    )


def test_short_budget_is_refused_with_the_time_needed(two_link, table):
    with pytest.raises(
        UnusableInput,
        match=r"--time 3 is too short: 2 periods of 2.4 s with ramps .* at least --time",
    ) as caught:
        planned(two_link, table, 3.0)
    least = float(str(caught.value).rsplit(" ", 1)[1])
    assert planned(two_link, table, least).best.robot_time <= least


def test_slower_motion_keeps_its_budget(two_link):
    result = design("two_link", options=SHORT, time=25.0, speed=0.5)
    assert 20.0 < result.trajectory.motion.duration <= 25.0
    assert result.plan.best.period == result.trajectory.motion.fourier.period


@pytest.mark.parametrize(
    ("budget", "desired", "options", "words"),
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
def test_inconsistent_budget_is_refused(two_link, table, budget, desired, options, words):
    with pytest.raises(UnusableInput, match=words):
        planned(two_link, table, budget, desired, options)


def test_approach_to_a_start_pose_counts_for_the_budget(two_link, table):
    pose = np.array([-1.5, 0.3])
    plan = planned(two_link, table, start=pose, desired=MotionRequest(harmonics=3))
    delivery = time_budget.run_plan(
        plan,
        SHORT,
        lambda options: pipeline.design_trajectory(two_link, table, options, start=pose),
    )
    assert delivery.trajectory.motion.duration <= 16.0
    assert max(c.repeats * c.period for c in plan.candidates) < 15.0


# final motion


def candidate(period: float, repeats: int) -> BudgetCandidate:
    return BudgetCandidate(period, 3, 60, repeats, repeats * period + 1.0, 1.0, 1.0, 0.1)


class RecordedRun:
    """Stand-in for the pipeline: motions with ramps of a given duration, and the requests."""

    def __init__(self, ramps: float, speed: float = 1.0) -> None:
        self.ramps, self.speed, self.requests = ramps, speed, []

    def __call__(self, options: DesignOptions) -> SimpleNamespace:
        self.requests.append((options.period, options.periods))
        motion = SimpleNamespace(
            duration=(options.period * options.periods + self.ramps) / self.speed
        )
        return SimpleNamespace(
            trajectory=SimpleNamespace(motion=motion, design={"speed": self.speed})
        )


def test_longer_ramps_than_predicted_shorten_the_period():
    run = RecordedRun(2.5)
    time_budget.run_plan(
        BudgetPlan(11.0, MotionRequest(), (candidate(3.0, 3),), 0), DesignOptions(), run
    )
    assert run.requests == [(3.0, 3), (2.8, 3)]


def test_longer_ramps_reduce_the_repeats_where_the_period_is_stated():
    run = RecordedRun(2.5)
    time_budget.run_plan(
        BudgetPlan(11.0, MotionRequest(period=3.0), (candidate(3.0, 3),), 0), DesignOptions(), run
    )
    assert run.requests == [(3.0, 3), (3.0, 2)]


def test_longer_ramps_are_refused_where_all_is_stated():
    with pytest.raises(
        UnusableInput, match=r"the motion takes 11\.5 s; give at least --time 11\.5"
    ):
        time_budget.run_plan(
            BudgetPlan(11.0, MotionRequest(period=3.0, periods=3), (candidate(3.0, 3),), 0),
            DesignOptions(),
            RecordedRun(2.5),
        )


def test_budget_is_that_of_a_slower_motion():
    run = RecordedRun(2.5, speed=0.5)
    time_budget.run_plan(
        BudgetPlan(22.0, MotionRequest(), (candidate(6.0, 3),), 0, 0.5), DesignOptions(), run
    )
    assert run.requests == [(3.0, 3), (2.8, 3)]


def test_planned_motion_keeps_its_budget(two_link, table):
    plan = planned(two_link, table, 12.0, MotionRequest(harmonics=3))
    delivery = time_budget.run_plan(
        plan, SHORT, lambda options: pipeline.design_trajectory(two_link, table, options)
    )
    assert delivery.trajectory.motion.duration <= 12.0 and delivery.certificate.ok
