"""Set up a design problem and search for the best periodic motion from several starts."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .._system.blas_threads import single_blas_thread
from .._types import FloatArray
from ..collision.clearance_constraint import ClearanceConstraint
from ..errors import ExciteError, UnusableInput
from ..robot import base_parameters, inertial_parameters
from ..robot.base_parameters import Base
from ..robot.limits import Limits
from ..robot.robot import Robot, require_possible_bodies
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import Motion
from . import criteria, design_cost, initial_guess, multistart, problem, ramps, sqp, stand_load
from .constraint_margins import MotionConstraints
from .criteria import Criterion
from .evaluator import Evaluator
from .motion_overlap import OverlapPenalty
from .multistart import Attempt, Progress
from .options import DesignOptions, check_options, torque_noise_levels
from .payload_weighting import payload_weighting
from .problem import DesignProblem

SHRINKING = (1.0, *(1.0 - 0.5 ** np.arange(9, 1, -1)), 0.6, 0.45, 0.3, 0.2)
"""Factors on the amplitude of a motion that is slightly infeasible, tried in this order [1]."""

STARTS_PER_RESTART = 2
"""Starts of a search that is repeated because no motion of the first one was certified."""

WARM_ITERATIONS = 20
"""Iterations of a search that continues with the curvature of an earlier one; the motion changes by
millimetres."""

WARM_RADIUS = 0.05
"""First trust-region radius of a search that continues with the curvature of an earlier one, in
units of the variables: a quarter of that of a new search."""


ObjectiveBuilder = Callable[[DesignProblem, Base], DesignProblem]
"""Returns a design problem with an objective in place of its criterion."""


@dataclass(frozen=True)
class DesignSetup:
    """Design problem with the quantities it was built from.

    Attributes:
        problem: The design problem.
        limits: Limits that its motions have to keep at all times.
        base: Base parameters of the robot.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        build_time: `time.perf_counter()` when the problem was complete [s].
    """

    problem: DesignProblem
    limits: Limits
    base: Base
    noise: FloatArray
    build_time: float

    def complete(self, motion: FourierSeries) -> Motion:
        """Complete a periodic motion to one from rest to rest.

        Raises:
            Infeasible: No ramps keep all limits.
        """
        usable = ramps.with_derived_limits(self.limits, motion).reduced()
        p, options = self.problem, self.problem.options
        return ramps.plan_rest_to_rest(
            _constraints(p, usable),
            motion,
            options.periods,
            options.rate,
            p.start_pose,
            options.samples,
        )


def _constraints(p: DesignProblem, limits: Limits) -> MotionConstraints:
    """Return the constraints on the motions of a problem under given limits."""
    return MotionConstraints(
        p.robot, limits, p.parameters, p.options.uncertainty, p.options.boxes, p.clearance
    )


@dataclass(frozen=True)
class OptimizedDesign:
    """Result of a search.

    Attributes:
        setup: The design problem.
        attempts: Results of all starts, the best first.
    """

    setup: DesignSetup
    attempts: tuple[Attempt, ...]

    @property
    def motion(self) -> FourierSeries:
        """Best periodic motion."""
        return self.attempts[0].motion

    def timing(self) -> dict[str, float]:
        """Return how long the search took, from the built problem on [s].

        Returns:
            `first_feasible`: until the first feasible motion; `within_1_percent`: until a
            criterion within 1 % of the best one.
        """
        first = min(_first_feasible(a.history) for a in self.attempts)
        final = [_feasible_objectives(a.history) for a in self.attempts]
        best = min(values.min() for _, values in final)
        # The objective is the logarithm of the criterion, for the condition number of the regressor
        # that of its square; for D it is the mean of log λ.
        share = 0.02 if self.setup.problem.options.criterion is Criterion.COND_REGRESSOR else 0.01
        within = min(
            times[values <= best + share][0]
            for times, values in final
            if (values <= best + share).any()
        )
        built = self.setup.build_time
        return {"first_feasible": float(first - built), "within_1_percent": float(within - built)}


def _first_feasible(history: sqp.History) -> float:
    """Return the time of the first feasible iterate, of the last one where none is feasible."""
    records = zip(history.time, history.worst, strict=True)
    feasible = (t for t, worst in records if worst <= sqp.MAX_FEASIBLE_ROW_VALUE)
    return next(feasible, history.time[-1])


def _feasible_objectives(history: sqp.History) -> tuple[FloatArray, FloatArray]:
    """Return times and best feasible objectives of the last stage, which smooths the least."""
    stage, worst = np.array(history.stage), np.array(history.worst)
    last = (stage == stage.max()) & (worst <= sqp.MAX_FEASIBLE_ROW_VALUE)
    values = np.where(last, np.array(history.objective), np.inf)
    return np.array(history.time), np.minimum.accumulate(values)


def set_up(
    robot: Robot,
    limits: Limits,
    options: DesignOptions,
    earlier_information: FloatArray | None = None,
    overlap_penalty: OverlapPenalty | None = None,
    clearance: ClearanceConstraint | None = None,
    start_pose: FloatArray | None = None,
    objective: ObjectiveBuilder | None = None,
) -> DesignSetup:
    """Build the design problem of a robot.

    Args:
        robot: The robot.
        limits: Its limits.
        options: Options of the design.
        earlier_information: Information of earlier recordings in standard parameters.
            Shape (P, P).
        overlap_penalty: Penalty on similarity to another motion.
        clearance: Bodies that have to keep their distance.
        start_pose: Pose from which the motion has to be reachable. Shape (n,).
        objective: Sets the objective that replaces the criterion; None: the criterion.

    Raises:
        UnusableInput: Options are inconsistent, or the start pose violates a limit.
    """
    check_options(options)
    design_cost.require(robot, options)
    if options.free_period is not None:
        options = dataclasses.replace(
            options, period=float(np.clip(options.period, *options.free_period))
        )
    if earlier_information is not None and options.criterion is Criterion.COND_REGRESSOR:
        raise UnusableInput(
            "--given and --criterion cond_regressor do not go together, as this criterion ignores "
            "the noise; use --criterion cond"
        )
    if options.noise is not None and (
        len(options.noise) != robot.n or not all(0.0 < s < np.inf for s in options.noise)
    ):
        raise UnusableInput(f"--torque-noise should be {robot.n} positive numbers, one per joint")
    require_possible_bodies(robot)
    stand_load.require_weight(robot, limits)
    standard = inertial_parameters.standard_parameters(robot, limits, options.drive)
    base = base_parameters.find(robot, standard, limits)
    noise = torque_noise_levels(limits, options.noise)
    weights = (
        criteria.criterion_weighting(options.criterion, base, noise, plain=options.plain)
        if options.payload_link is None
        else payload_weighting(robot, standard, noise, options.payload_link)
    )
    count = options.periods * options.period * options.rate
    root = (
        None
        if earlier_information is None
        else weights.information_root(earlier_information / count)
    )
    built = dataclasses.replace(
        problem.build_problem(robot, limits, standard, weights, options, root),
        overlap_penalty=overlap_penalty,
        clearance=clearance,
        start_pose=start_pose,
    )
    if start_pose is not None:  # before a search begins
        ramps.check_start_pose(_constraints(built, limits.reduced()), start_pose)
    if objective is not None:
        built = objective(built, base)
    return DesignSetup(built, limits, base, noise, time.perf_counter())


def solve(
    setup: DesignSetup, progress: Progress | None = None, restart: int = 0
) -> OptimizedDesign:
    """Run all starts of a design and rank them.

    The result depends on the seed alone, not on the number of processes.

    Args:
        setup: The design problem.
        progress: Called with a line of text after each start.
        restart: Number of the restart, 0 for the first search; each has other random streams.

    Raises:
        Infeasible: No pose keeps all limits.
        UnusableInput: No pose is within the torque limits.
    """
    options = setup.problem.options
    # the starts of a validation motion have other numbers, hence other random streams
    first = 0 if setup.problem.overlap_penalty is None else options.starts
    numbers = range(first, first + options.starts)
    if restart:
        begin = 2 * options.starts + (2 * restart + (first > 0)) * STARTS_PER_RESTART
        numbers = range(begin, begin + min(options.starts, STARTS_PER_RESTART))
    results = multistart.run_starts(setup.problem, numbers, progress)
    attempts = [r for r in results if isinstance(r, Attempt)]
    if not attempts:
        raise next(r for r in results if isinstance(r, ExciteError))
    design = OptimizedDesign(setup, tuple(attempts))
    return _fixed_period(design) if options.free_period is not None else design


def improve(
    setup: DesignSetup,
    motion: FourierSeries,
    number: int = 0,
    earlier: sqp.SearchState | None = None,
) -> Attempt:
    """Optimise a motion that may break limits slightly.

    The motion is first shrunk a little towards its mean pose, so that it keeps all limits; where
    that does not suffice, the search restores feasibility.

    Args:
        setup: The design problem.
        motion: Motion to begin with.
        number: Number of the start that the motion stems from.
        earlier: State of the search that found the motion, whose curvature is used again; None:
            begin a new search.
    """
    with single_blas_thread():
        evaluator = Evaluator(setup.problem)
        x = setup.problem.variables(motion)
        stationary = initial_guess.stationary_variables(setup.problem, motion.offset)
        for share in SHRINKING:
            shrunk = stationary + share * (x - stationary)
            if evaluator.max_constraint_value(shrunk) <= 1.0:
                break
        else:
            shrunk = x
        state = None
        if earlier is not None:
            last = len(sqp.sharpness_stages(setup.problem.options.criterion)) - 1
            state = sqp.SearchState(shrunk, shrunk, stage=last, B=earlier.B, radius=WARM_RADIUS)
        return multistart.optimize_from(
            evaluator,
            shrunk,
            number,
            until=None if state is None else WARM_ITERATIONS,
            state=state,
        )


def _fixed_period(design: OptimizedDesign) -> OptimizedDesign:
    """Round an optimised period to whole samples and optimise the motion at that period."""
    free = design.setup.problem
    motion, rate = design.motion, free.options.rate
    period = _whole_period(motion.period, rate, free.options.free_period)
    options = dataclasses.replace(free.options, period=period, free_period=None)
    rebuilt = dataclasses.replace(free, options=options)
    setup = dataclasses.replace(design.setup, problem=rebuilt)
    stretched = FourierSeries(motion.sine, motion.cosine, motion.offset, period)
    slower = motion.slowed(motion.period / period)
    best = min(
        (improve(setup, m, design.attempts[0].number) for m in (stretched, slower)),
        key=lambda a: a.objective,
    )
    return OptimizedDesign(setup, (best, *design.attempts[1:]))


def _whole_period(period: float, rate: float, bounds: tuple[float, float] | None) -> float:
    """Round a period to whole samples within its bounds.

    Longer periods and those on the time grid of the ramps (0.04 s) are preferred.
    """
    assert bounds is not None
    for grid in (max(round(0.04 * rate), 1) / rate, 1.0 / rate):
        for rounded in (
            np.ceil(period / grid - 1e-9) * grid,
            np.floor(period / grid + 1e-9) * grid,
        ):
            if bounds[0] - 1e-9 <= rounded <= bounds[1] + 1e-9:
                return float(rounded)
    raise UnusableInput(
        f"--optimise-period {bounds[0]:g},{bounds[1]:g}: contains no whole number of samples "
        f"at --rate {rate:g} Hz; widen it"
    )


def tighten(
    setup: DesignSetup,
    reserve: float,
    deficits: Mapping[str, float] | None = None,
    *,
    finer: bool = False,
) -> DesignSetup:
    """Return a design problem with more reserve, for a motion that fails between samples.

    Args:
        setup: The design problem.
        reserve: Share of torque, braking and box limits to keep free [1].
        deficits: Clearance to add for pairs of bodies [m].
        finer: Double the number of samples.
    """
    p = setup.problem
    options = dataclasses.replace(p.options, samples=(1 + finer) * p.options.samples)
    tighter = problem.rebuild_problem(p, setup.limits, options, p.earlier_root, reserve)
    if p.clearance is not None:
        extra = np.array([(deficits or {}).get(pair, 0.0) for pair in p.clearance.names])
        tighter = dataclasses.replace(
            tighter, clearance=dataclasses.replace(p.clearance, extra=p.clearance.extra + extra)
        )
    return dataclasses.replace(setup, problem=tighter)
