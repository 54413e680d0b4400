"""Search for the periodic motion, and the pipeline from options to a certified trajectory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import (
    QUICK,
    document,
    information_of,
    joint,
    link,
    loaded,
    pendulum,
    random_urdf,
    reframed,
    text_of,
)

from excite.api import design
from excite.designer import criteria, optimize, pipeline
from excite.designer.criteria import Criterion
from excite.designer.evaluator import Evaluator
from excite.designer.optimize import OptimizedDesign
from excite.designer.options import DesignOptions, WorkspaceBox
from excite.errors import CheckFailed, Infeasible, UnusableInput
from excite.robot import dynamics
from excite.robot.limits import Limits, resolve
from excite.robot.robot import Robot, load
from excite.trajectory.fourier import FourierSeries

CERTAIN = replace(QUICK, uncertainty=0.0)
ABOVE = WorkspaceBox("tip", (-1.0, -0.1, 0.0), (1.0, 0.1, 1.0))
ORDERS = {"position": 0, "velocity": 1, "acceleration": 2, "jerk": 3}


def solved(
    robot: Robot,
    limits: Limits,
    options: DesignOptions = QUICK,
    earlier_information: np.ndarray | None = None,
) -> OptimizedDesign:
    return optimize.solve(optimize.set_up(robot, limits, options, earlier_information))


def criteria_of(design: OptimizedDesign, motion: FourierSeries | None = None) -> dict:
    """Evaluate all criteria of a motion by Pinocchio on another grid than the optimiser's."""
    p, motion = design.setup.problem, motion or design.motion
    Y = dynamics.regressor(p.robot, p.parameters, motion.samples(motion.grid(400)))
    return criteria.evaluate_criteria(Y, design.setup.base, design.setup.noise)


def loosened(limits: Limits) -> Limits:
    """Return limits that do not restrict two_link."""
    return replace(limits.scaled(torque=5.0, acceleration=10.0, jerk=20.0, velocity=2.0))


# search and ranking


@pytest.mark.parametrize("name", ["two_link", "ur10e", "tree"])
def test_design_obeys_all_limits_on_a_dense_grid(name):
    text = random_urdf(np.random.default_rng(0), 4, kinds=("revolute", "prismatic")).replace(
        'effort="40"', 'effort="400"'
    )
    robot = loaded(text) if name == "tree" else load(name)
    limits = resolve(robot)
    options = replace(QUICK, period=4.0, samples=60, iterations=15)
    motion = pipeline.design_trajectory(robot, limits, options).trajectory.motion
    t = np.linspace(0, motion.duration, 20001)
    for kind, order in ORDERS.items():
        bound, values = getattr(limits, kind), motion.at(t, order)
        lower, upper = bound.T if kind == "position" else (-bound, bound)
        assert (values <= upper).all() and (values >= lower).all(), kind
    setup = optimize.set_up(robot, limits, options)
    torque = (
        dynamics.regressor(robot, setup.problem.parameters, motion.samples(t[::10]))
        @ setup.problem.parameters.nominal
    )
    assert (np.abs(torque) <= limits.torque).all()


@pytest.mark.parametrize("criterion", list(Criterion))
@pytest.mark.parametrize("plain", [False, True])
def test_search_improves_on_the_initial_guess(two_link, table, criterion, plain):
    attempt = solved(two_link, table, replace(QUICK, criterion=criterion, plain=plain)).attempts[0]
    assert attempt.objective < attempt.history.objective[0] - 0.1


@pytest.mark.parametrize(
    "criterion", [Criterion.D, Criterion.E, Criterion.COND, Criterion.COND_REGRESSOR]
)
def test_each_criterion_is_best_in_the_design_that_optimises_it(two_link, table, criterion):
    options = replace(QUICK, iterations=120)
    optimal, other = (
        criteria_of(solved(two_link, table, replace(options, criterion=c)))
        for c in (criterion, Criterion.A)
    )
    sign = -1.0 if criterion in criteria.MAXIMISED_CRITERIA else 1.0
    assert sign * criteria.select_criterion(
        optimal, criterion, plain=False
    ) < sign * criteria.select_criterion(other, criterion, plain=False)


def test_objective_is_the_logarithm_of_the_criterion(two_link, table):
    design = solved(two_link, table)
    motion, p = design.motion, design.setup.problem
    Y = dynamics.regressor(two_link, p.parameters, motion.samples(motion.grid(40)))
    stated = criteria.evaluate_criteria(Y, design.setup.base, design.setup.noise)["geometric"]["a"]
    assert design.attempts[0].objective == pytest.approx(np.log(stated), rel=1e-9)


def test_starts_are_ranked_by_objective(two_link, table):
    attempts = solved(two_link, table, replace(QUICK, starts=3, iterations=10)).attempts
    assert [a.objective for a in attempts] == sorted(a.objective for a in attempts) and {
        a.number for a in attempts
    } == {0, 1, 2}


def test_same_seed_gives_the_same_result(two_link, table):
    first, second = (solved(two_link, table).motion for _ in range(2))
    assert np.array_equal(first.sine, second.sine) and np.array_equal(first.offset, second.offset)


def test_design_for_a_single_joint():
    robot = load("two_link", joints=["joint_1"])
    assert pipeline.design_trajectory(
        robot, resolve(robot), replace(QUICK, iterations=10)
    ).certificate.ok


def test_different_seeds_give_different_starts(two_link, table):
    first, second = (
        solved(two_link, table, replace(QUICK, seed=s, iterations=1)).motion for s in (0, 1)
    )
    assert not np.allclose(first.sine, second.sine)


def test_number_of_processes_does_not_change_the_result(two_link, table):
    serial, parallel = (
        solved(two_link, table, replace(QUICK, starts=2, jobs=jobs)) for jobs in (1, 2)
    )
    assert all(
        np.array_equal(a.motion.sine, b.motion.sine)
        for a, b in zip(serial.attempts, parallel.attempts, strict=True)
    )


def test_timing_reports_first_feasible_and_near_optimal_times(two_link, table):
    timing = pipeline.design_trajectory(two_link, table, QUICK).timing
    assert set(timing) == {"build", "first_feasible", "within_1_percent", "solve", "total"}
    assert (
        0
        < timing["first_feasible"]
        <= timing["within_1_percent"]
        <= timing["solve"]
        < timing["total"]
    )


def test_infeasible_iterates_are_no_first_feasible_motion(two_link, table):
    design = solved(two_link, table)
    build, history = design.setup.build_time, design.attempts[0].history
    late = replace(history, worst=[1.5, 1.5, *history.worst[2:]])
    late = replace(design, attempts=(replace(design.attempts[0], history=late),))
    assert late.timing()["first_feasible"] == pytest.approx(history.time[2] - build)


# limits

TIGHT = {
    "position": np.array([[-0.8, 0.9], [-0.7, 0.6]]),
    "velocity": np.array([1.0, 1.5]),
    "acceleration": np.array([6.0, 8.0]),
    "jerk": np.array([60.0, 80.0]),
    "torque": np.array([30.0, 8.0]),
}


def largest_ratio(kind: str, design: OptimizedDesign, bound: np.ndarray) -> float:
    """Return the largest quantity over its limit on a dense grid, by Pinocchio."""
    motion, p = design.motion, design.setup.problem
    t = motion.grid(4001)
    if kind == "torque":
        values = dynamics.regressor(p.robot, p.parameters, motion.samples(t)) @ p.parameters.nominal
    else:
        values = motion.at(t, ORDERS[kind])
    lower, upper = bound.T if kind == "position" else (-bound, bound)
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    return float(np.abs((values - middle) / half).max())


@pytest.mark.parametrize("kind", TIGHT)
def test_optimum_violates_a_limit_only_where_it_is_absent(two_link, table, kind):
    free = solved(two_link, loosened(table), CERTAIN)
    bound = pipeline.design_trajectory(
        two_link, replace(loosened(table), **{kind: TIGHT[kind]}), CERTAIN
    ).design
    assert largest_ratio(kind, free, TIGHT[kind]) > 1.1
    assert 0.5 < largest_ratio(kind, bound, TIGHT[kind]) <= 1.0


def test_optimum_leaves_a_box_only_where_it_is_absent(two_link, table):
    def lowest(design):
        return dynamics.positions(two_link, "tip", design.motion.at(design.motion.grid(2001)))[
            :, 2
        ].min()

    assert lowest(solved(two_link, table, CERTAIN)) < -0.2
    assert (
        0.0
        <= lowest(
            pipeline.design_trajectory(two_link, table, replace(CERTAIN, boxes=(ABOVE,))).design
        )
        < 0.1
    )


def test_optimum_violates_braking_limits_only_where_they_are_absent():
    robot = load("fr3", joints=("fr3_joint4", "fr3_joint6"))
    limits = resolve(robot)
    free = replace(limits, braking=(None, None), acceleration=10 * limits.acceleration)
    options = replace(CERTAIN, period=3.0)

    def largest_excess_speed(design):
        motion = design.motion
        q, dq = motion.at(motion.grid(2001)), motion.at(motion.grid(2001), 1)
        excess_speeds = []
        for j, brake in enumerate(limits.braking):
            for s, stop in ((1, brake.stop[1]), (-1, brake.stop[0])):
                allowed = -brake.offset + np.sqrt(
                    np.maximum(brake.rate * s * (stop - q[:, j]), 0.0)
                )
                excess_speeds.append(np.max(s * dq[:, j] - np.maximum(allowed, 0.0)))
        return max(excess_speeds)

    assert largest_excess_speed(solved(robot, free, options)) > 0.05
    assert (
        largest_excess_speed(
            pipeline.design_trajectory(robot, replace(free, braking=limits.braking), options).design
        )
        <= 0.0
    )


def test_uncertainty_increases_the_torque_margin(two_link, table):
    limits = replace(loosened(table), torque=TIGHT["torque"])
    certain, uncertain = (
        solved(two_link, limits, replace(QUICK, uncertainty=r)) for r in (0.0, 0.3)
    )
    assert (
        largest_ratio("torque", uncertain, limits.torque)
        < largest_ratio("torque", certain, limits.torque) - 0.02
    )


# invariance, earlier information, period


@pytest.mark.parametrize("criterion", [Criterion.A, Criterion.D, Criterion.E, Criterion.COND])
def test_geometric_optimum_does_not_depend_on_link_frames(criterion):
    text = (
        text_of("two_link").replace('name="tip"', 'name="end"').replace('link="tip"', 'link="end"')
    )
    robots = loaded(text), loaded(reframed(text, np.random.default_rng(3)))
    original, moved = (
        solved(r, resolve(r), replace(QUICK, criterion=criterion, iterations=15)) for r in robots
    )
    assert np.exp(moved.attempts[0].objective - original.attempts[0].objective) == pytest.approx(
        1.0, abs=1e-6
    )


def test_earlier_information_changes_the_design(two_link, table):
    setup = optimize.set_up(two_link, table, QUICK)
    only_second = FourierSeries(
        np.diag([0.0, 1.0]) @ np.full((2, 3), 0.8), np.zeros((2, 3)), np.zeros(2), 2.0
    )
    Y = dynamics.regressor(
        two_link, setup.problem.parameters, only_second.samples(only_second.grid(400))
    )
    earlier = 10.0 * information_of(Y, setup.noise)
    alone, together = solved(two_link, table), solved(two_link, table, earlier_information=earlier)

    def combined(design):
        p = design.setup.problem
        Y = dynamics.regressor(
            two_link, p.parameters, design.motion.samples(design.motion.grid(400))
        )
        return criteria.evaluate_criteria(Y, design.setup.base, design.setup.noise, earlier / 400)[
            "geometric"
        ]["a"]

    assert combined(together) < 0.999 * combined(alone)


def test_optimised_period_is_a_whole_number_of_samples(two_link, table):
    design = solved(two_link, table, replace(QUICK, free_period=(1.5, 2.987)))
    period = design.motion.period
    assert 1.5 <= period <= 3.0 and abs(period * 100 - round(period * 100)) < 1e-9


def test_free_period_improves_the_criterion(two_link, table):
    fixed, free = (
        solved(two_link, table),
        solved(two_link, table, replace(QUICK, free_period=(2.0, 6.0), iterations=60)),
    )
    assert criteria_of(free)["geometric"]["a"] < criteria_of(fixed)["geometric"]["a"]


# errors


def test_torque_limit_below_gravity_names_the_joint():
    parts = link("base"), link("column", 1.0), link("cart", 5.0)
    robot = loaded(
        document(
            *parts, joint("turn", "base", "column"), joint("lift", "column", "cart", "prismatic")
        )
    )
    with pytest.raises(
        UnusableInput,
        match=r"'lift': gravity requires .* times its torque limit .* raise the limit",
    ):
        solved(robot, resolve(robot))


def test_torque_limit_below_gravity_in_all_allowed_poses_is_refused(two_link, table):
    weak = replace(
        table, torque=np.array([5.0, 20.0]), position=np.array([[-0.4, 0.4], [-0.4, 0.4]])
    )
    with pytest.raises(
        UnusableInput, match=r"'joint_1': gravity requires .* or lighten the payload"
    ):
        solved(two_link, weak)


def test_unreachable_box_is_infeasible_and_named(two_link, table):
    away = WorkspaceBox("tip", (2.0, -0.1, 0.0), (3.0, 0.1, 1.0))
    with pytest.raises(Infeasible, match="the box limit of 'tip' conflicts with the others"):
        solved(two_link, table, replace(QUICK, boxes=(away,)))


def test_box_that_conflicts_with_position_limits_is_infeasible(two_link, table):
    ahead = replace(table, position=np.array([[-0.2, 0.2], [-0.2, 0.2]]))
    behind = WorkspaceBox("tip", (-0.9, -0.1, -0.5), (-0.3, 0.1, 0.5))
    with pytest.raises(
        Infeasible, match=r"conflicts with the others .*; widen the box or the position limits"
    ):
        solved(two_link, ahead, replace(QUICK, boxes=(behind,)))


def test_errors_of_starts_in_other_processes_are_raised(two_link, table):
    away = WorkspaceBox("tip", (2.0, -0.1, 0.0), (3.0, 0.1, 1.0))
    with pytest.raises(Infeasible, match="'tip'"):
        solved(two_link, table, replace(QUICK, boxes=(away,), starts=2, jobs=2))


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"period": 2.005}, "no whole number of samples at --rate 100 Hz; use --period 2"),
        ({"period": np.nan}, "--period nan .* positive and finite"),
        ({"rate": 0.0}, "--rate 0 should be positive"),
        ({"harmonics": 20}, "--samples 40 cannot carry 20 harmonics; use more than 40"),
        ({"harmonics": 0}, "--harmonics should be positive"),
        ({"periods": 1}, "--periods should be at least 2"),
        ({"starts": 0}, "--starts should be positive"),
        ({"uncertainty": -0.1}, "--uncertainty -0.1 should be 0 or more"),
        ({"boxes": (WorkspaceBox("tip", (0, 0, 0), (0, 1, 1)),)}, "--box tip: its lower corner"),
        ({"boxes": (WorkspaceBox("claw", (0, 0, 0), (1, 1, 1)),)}, "no frame 'claw'"),
        ({"drive": ("magic",)}, "no joint parameter 'magic'"),
    ],
)
def test_inconsistent_options_are_refused(two_link, table, changes, part):
    with pytest.raises(UnusableInput, match=part):
        solved(two_link, table, replace(QUICK, **changes))


def test_start_pose_outside_limits_names_the_joint(two_link, table):
    with pytest.raises(
        UnusableInput, match=r"start pose: joint 'joint_2' at 9 is outside \[-2.6, 2.6\]"
    ):
        pipeline.design_trajectory(two_link, table, QUICK, start=np.array([0.0, 9.0]))


def test_motion_that_fails_its_certificate_is_not_delivered(two_link, table, monkeypatch):
    original = pipeline.certificate_module.certify
    monkeypatch.setattr(
        pipeline.certificate_module,
        "certify",
        lambda *a, **k: replace(original(*a, **k), faults=("it wobbles",)),
    )
    with pytest.raises(CheckFailed, match="it wobbles; --force delivers it"):
        pipeline.design_trajectory(two_link, table, replace(QUICK, iterations=5))


def test_forced_motion_is_marked(two_link, table, monkeypatch):
    original = pipeline.certificate_module.certify
    monkeypatch.setattr(
        pipeline.certificate_module,
        "certify",
        lambda *a, **k: replace(original(*a, **k), faults=("it wobbles",)),
    )
    assert pipeline.design_trajectory(
        two_link, table, replace(QUICK, iterations=5), force=True
    ).trajectory.forced


@pytest.mark.parametrize(
    "change",
    [{"seed": -1}, {"noise": (0.0, 0.0)}, {"noise": (1.0,)}, {"noise": (np.nan, 1.0)}],
    ids=str,
)
def test_options_out_of_range_are_refused(two_link, table, change):
    with pytest.raises(UnusableInput):
        optimize.set_up(two_link, table, replace(QUICK, **change))


def test_earlier_information_is_refused_for_cond_regressor(two_link, table):
    with pytest.raises(UnusableInput, match="cond_regressor"):
        optimize.set_up(
            two_link, table, replace(QUICK, criterion=Criterion.COND_REGRESSOR), np.eye(100)
        )


def test_optimised_period_stays_within_its_bounds(two_link, table):
    design = solved(two_link, table, replace(QUICK, free_period=(1.5, 1.537)))
    assert 1.5 <= design.motion.period <= 1.537
    assert (design.motion.period * 100.0) % 1.0 == pytest.approx(0.0, abs=1e-6)


def test_continuous_joint_has_no_position_constraints(recwarn):
    machine = loaded(pendulum('<limit velocity="3" effort="40"/>', "continuous"))
    setup = optimize.set_up(machine, resolve(machine), replace(QUICK, period=2.0))
    assert Evaluator(setup.problem).kinds == ("velocity", "torque")
    assert not recwarn.list


@pytest.mark.parametrize("start", [np.zeros(1), np.array([np.nan, 0.0])])
def test_malformed_start_pose_is_refused(two_link, table, start):
    with pytest.raises(UnusableInput, match="start pose"):
        pipeline.design_trajectory(two_link, table, QUICK, start=start)


def test_search_works_far_from_all_limits():
    machine = loaded(pendulum('<limit velocity="500" effort="1e6"/>', "continuous"))
    limits = resolve(machine)
    design = solved(machine, limits, replace(QUICK, iterations=3))
    assert np.isfinite(design.attempts[0].objective)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"criterion": "q"}, "--criterion q: no such criterion; there are a, d, e"),
        ({"threshold": -1.0}, "--threshold -1 should be a positive number"),
        ({"speed": 0.0, "time": 20.0}, "--speed 0 should be above 0"),
        ({"iterations": 0}, "--iterations should be positive"),
        ({"free_period": (8.0, 3.0)}, "--optimise-period 8,3: should be MIN,MAX"),
        ({"free_period": (2.0, 4.0), "period": 9.0}, "--period and --optimise-period"),
        ({"payload_link": "tip", "criterion": "d"}, "--for-payload: has the A-criterion"),
        ({"payload_link": "tip", "plain": True}, "--for-payload: has the A-criterion"),
        ({"payload_link": "base_link"}, "--for-payload base_link: does not move"),
    ],
)
def test_unusable_arguments_of_a_design_are_refused(options, words):
    with pytest.raises(UnusableInput, match=words):
        design("two_link", **options)


def test_a_criterion_may_be_stated_by_its_name():
    result = design("two_link", criterion="d", period=2.0, starts=1, iterations=5, jobs=1)
    assert result.trajectory.design["criterion"] == "d"


def test_a_motion_for_a_payload_has_the_default_time_of_the_command():
    result = design("ur5e", payload_link="tool0", starts=1, iterations=5, jobs=1)
    assert result.plan is not None and result.plan.budget == 15.0
