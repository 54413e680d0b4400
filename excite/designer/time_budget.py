"""Choose period, harmonics and repeats where the user states none.

Without a time budget a rule derives the period from the limits, without any optimisation: joint j
sweeps its range at its limits with the sinusoid A sin(ωt), A ω ≤ v, A ω² ≤ a, of period
2π max(A/v, √(A/a)). A is half the position range, at most π, beyond which poses recur. The base
harmonic gets the median of the joints' periods. With a budget of robot time, candidates that fill
it are compared by short optimisations.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import joblib
import numpy as np

from .._types import FloatArray
from ..collision.clearance_constraint import ClearanceConstraint
from ..errors import ExciteError, UnusableInput
from ..robot import dynamics
from ..robot.base_parameters import Base
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.fourier import FourierSeries
from . import criteria, optimize, problem, ramps
from .criteria import Criterion
from .optimize import DesignSetup
from .options import DesignOptions, check_options
from .pipeline import CertifiedDesign

DEFAULT_HARMONICS = 5
"""Harmonics without a time budget [1]."""

DEFAULT_PERIODS = 2
"""Periods in the motion without a time budget [1]; noise is estimated from their differences."""

MAX_FREQUENCY = 1.25
"""Highest frequency that is chosen for the user [Hz].

It is that of 5 harmonics of 4 s, well below the first elastic modes of robot arms, which rigid-body
models do not describe.
"""

MAX_PERIOD = 30.0
"""Longest period that is chosen for the user [s]."""

PERIOD_STEP = 0.2
"""Step of the periods that the rule chooses, where the sampling rate allows [s].

Periods that fill a time budget are multiples of the time grid of the ramps instead.
"""

MIN_CHOSEN_HARMONICS = 3
"""Least number of harmonics chosen for a time budget [1]; fewer excite too few directions."""

MAX_CHOSEN_HARMONICS = 12
"""Largest number of harmonics chosen for a time budget [1]; more take too long to optimise."""

REDUCED_HARMONICS_SHARE = 0.6
"""Share of the largest number of harmonics that is tried next to that number [1]."""

MAX_TRIED_PERIODS = 4
"""Number of periods that are tried for a time budget, those nearest to the rule's [1]."""

TRIAL_ITERATIONS = 25
"""Iterations of the short optimisation of a candidate [1]."""

DEVIATION_TOLERANCE = 0.05
"""Share above the least standard deviation within which the simplest candidate is chosen [1].

Results of short optimisations scatter by as much.
"""

RAMP_TIME_RESERVE = 0.4
"""Time by which the ramps of the final motion may exceed those of a short run, plus a fifth [s]."""


def sweep_periods(limits: Limits) -> FloatArray:
    """Return for each joint the period of a sinusoidal sweep at its limits. Shape (n,) [s]."""
    half = np.minimum(0.5 * (limits.position[:, 1] - limits.position[:, 0]), np.pi)
    out: FloatArray = (
        2.0 * np.pi * np.maximum(half / limits.velocity, np.sqrt(half / limits.acceleration))
    )
    return out


def choose_period(
    limits: Limits, harmonics: int = DEFAULT_HARMONICS, rate: float = DesignOptions.rate
) -> float:
    """Choose a period by the rule.

    Args:
        limits: Limits of the robot.
        harmonics: Number of harmonics; none exceeds `MAX_FREQUENCY`.
        rate: Samples per second, of which the period holds a whole number [Hz].

    Returns:
        The period [s].
    """
    grid = (
        PERIOD_STEP
        if abs(PERIOD_STEP * rate - round(PERIOD_STEP * rate)) < 1e-9
        else ramps.time_grid(rate)
    )
    swept = grid * round(float(np.median(sweep_periods(limits))) / grid)
    return round(max(min(swept, MAX_PERIOD), _round_up(harmonics / MAX_FREQUENCY, grid)), 9)


def default_samples(harmonics: int) -> int:
    """Return the number of the optimiser's samples over one period for a number of harmonics."""
    return 20 * max(harmonics, 3)


def _round_down(duration: float, grid: float) -> float:
    """Round a duration down to a multiple of `grid` [s]."""
    return round(grid * float(np.floor(duration / grid + 1e-9)), 9)


def _round_up(duration: float, grid: float) -> float:
    """Round a duration up to a multiple of `grid` [s]."""
    return round(grid * float(np.ceil(duration / grid - 1e-9)), 9)


def _default_to(stated: int | None, default: int) -> int:
    """Return a stated value, else the default."""
    return default if stated is None else stated


@dataclass(frozen=True)
class MotionRequest:
    """Motion that the user asks for, with None where the choice is free.

    Attributes:
        period: Period [s].
        harmonics: Number of harmonics.
        samples: Samples of the optimiser over one period.
        periods: Number of periods in the motion.
    """

    period: float | None = None
    harmonics: int | None = None
    samples: int | None = None
    periods: int | None = None

    @property
    def unspecified(self) -> list[str]:
        """Names of the quantities that are free."""
        return [name for name, value in dataclasses.asdict(self).items() if value is None]

    def complete(self, options: DesignOptions, limits: Limits) -> DesignOptions:
        """Return options with the stated quantities, and free ones by the rule."""
        harmonics = _default_to(self.harmonics, DEFAULT_HARMONICS)
        swept = (
            choose_period(limits, harmonics, options.rate) if self.period is None else self.period
        )
        return self.with_motion(
            options, swept, harmonics, _default_to(self.periods, DEFAULT_PERIODS)
        )

    def with_motion(
        self, options: DesignOptions, period: float, harmonics: int, periods: int
    ) -> DesignOptions:
        """Return options with a motion, on the stated grid or the default one."""
        grid = _default_to(self.samples, default_samples(harmonics))
        return dataclasses.replace(
            options, period=period, harmonics=harmonics, periods=periods, samples=grid
        )

    def harmonics_to_try(self, period: float) -> list[int]:
        """Return the numbers of harmonics to try for a period [s], ascending."""
        if self.harmonics is not None:
            return [self.harmonics]
        resolved = MAX_CHOSEN_HARMONICS if self.samples is None else (self.samples - 1) // 2
        largest = max(min(int(MAX_FREQUENCY * period + 1e-9), resolved, MAX_CHOSEN_HARMONICS), 1)
        return sorted(
            {
                largest,
                min(max(round(REDUCED_HARMONICS_SHARE * largest), MIN_CHOSEN_HARMONICS), largest),
            }
        )


@dataclass(frozen=True)
class BudgetCandidate:
    """Candidate motion for a time budget, after a short optimisation.

    Attributes:
        period: Period at the speed of the motion [s].
        harmonics: Number of harmonics.
        samples: Samples of the optimiser over one period.
        repeats: Number of periods.
        robot_time: Duration of the motion with its ramps [s].
        value: Criterion per sample of the periodic part.
        deviation: Standard deviation predicted for all its samples, up to a common factor.
        seconds: Duration of the optimisation [s].
    """

    period: float
    harmonics: int
    samples: int
    repeats: int
    robot_time: float
    value: float
    deviation: float
    seconds: float

    @property
    def effort(self) -> int:
        """Cost of an iteration, up to a common factor: variables per joint times samples."""
        return self.harmonics * self.samples


@dataclass(frozen=True)
class BudgetPlan:
    """Candidates for a time budget, and the chosen one.

    Attributes:
        budget: Robot time, ramps included [s].
        request: Motion that the user asks for.
        candidates: Candidates that fit the budget.
        chosen_index: Index of the chosen candidate.
        speed: Share of the designed speed at which the motion is executed [1].
    """

    budget: float
    request: MotionRequest
    candidates: tuple[BudgetCandidate, ...]
    chosen_index: int
    speed: float = 1.0

    @property
    def best(self) -> BudgetCandidate:
        """Chosen candidate."""
        return self.candidates[self.chosen_index]

    def document(self) -> dict[str, Any]:
        """Return the entry of `excite design --json`."""
        candidates = [dataclasses.asdict(candidate) for candidate in self.candidates]
        return {
            "budget": self.budget,
            "tolerance": DEVIATION_TOLERANCE,
            "candidates": candidates,
            "chosen": self.chosen_index,
        }

    def reproducible_document(self) -> dict[str, Any]:
        """Return the entry of `trajectory.json`: the document without computing times."""
        document = self.document()
        for candidate in document["candidates"]:
            del candidate["seconds"]
        return document

    def summary(self) -> str:
        """Return a line of text about the choice and the best of the other candidates."""
        best = self.best
        text = (
            f"planned for {self.budget:g} s: {best.repeats} × {best.period:g} s "
            f"with {best.harmonics} harmonics"
        )
        others = [
            f"{100.0 * (c.deviation / best.deviation - 1.0):+.0f} % with {c.repeats} × "
            f"{c.period:g} s and {c.harmonics}"
            for c in sorted(self.candidates, key=lambda c: c.deviation)
            if c is not best
        ]
        return f"{text}; standard deviations {', '.join(others[:3])}" if others else text


def plan_for_budget(
    robot: Robot,
    limits: Limits,
    options: DesignOptions,
    request: MotionRequest,
    budget: float,
    *,
    start: FloatArray | None = None,
    earlier_information: FloatArray | None = None,
    clearance: ClearanceConstraint | None = None,
    speed: float = 1.0,
) -> BudgetPlan:
    """Choose the free quantities of a motion for a budget of robot time.

    Candidates that fill the budget are optimised for a few iterations each. Their information is
    that per sample times the number of recorded samples. Of those within `DEVIATION_TOLERANCE` of
    the least standard deviation, the one with the least effort is chosen.

    Args:
        robot: The robot.
        limits: Its limits.
        options: Options of the design.
        request: Motion that the user asks for.
        budget: Robot time, ramps included [s].
        start: Pose at which the motion starts and ends at rest. Shape (n,).
        earlier_information: Information of earlier recordings in standard parameters.
            Shape (P, P).
        clearance: Bodies that have to keep their distance.
        speed: Share of the designed speed at which the motion is executed [1].

    Raises:
        UnusableInput: The budget is too short; the message says how much is needed.
        Infeasible: No candidate is feasible.
    """
    if not (np.isfinite(budget) and budget > 0.0):
        raise UnusableInput(f"--time {budget:g} should be positive [s]")
    if options.free_period is not None:
        raise UnusableInput("--time and --optimise-period both choose the period; drop one of them")
    check_options(request.complete(options, limits))
    available = speed * budget  # of the motion at the speed for which it is optimised
    grid, repeats = ramps.time_grid(options.rate), request.periods or DEFAULT_PERIODS
    shortest = request.period or _round_up(
        (request.harmonics or MIN_CHOSEN_HARMONICS) / MAX_FREQUENCY, grid
    )
    # a first short run measures the duration of the ramps
    rule = choose_period(limits, request.harmonics or DEFAULT_HARMONICS, options.rate)
    trial_period = request.period or max(
        min(rule, _round_down(available / repeats, grid)), shortest
    )
    short = dataclasses.replace(
        options, starts=1, iterations=min(TRIAL_ITERATIONS, options.iterations)
    )
    setup = optimize.set_up(
        robot,
        limits,
        request.with_motion(
            short, trial_period, request.harmonics_to_try(trial_period)[0], repeats
        ),
        earlier_information,
        clearance=clearance,
        start_pose=start,
    )
    pilot = _try_candidate(setup, setup.problem.options, speed)
    if isinstance(pilot, ExciteError):
        raise pilot
    ramp_time = 1.2 * (speed * pilot.robot_time - repeats * trial_period) + RAMP_TIME_RESERVE
    if available < repeats * shortest + ramp_time:
        raise _too_short(
            budget,
            f"{repeats} periods of {shortest / speed:g} s with ramps take about",
            (repeats * shortest + ramp_time) / speed,
        )
    motions = _periods_and_repeats(request, rule, available - ramp_time, shortest, grid)
    trials = [
        request.with_motion(short, t, k, r) for t, r in motions for k in request.harmonics_to_try(t)
    ]
    results = joblib.Parallel(n_jobs=options.jobs)(
        joblib.delayed(_try_candidate)(setup, trial, speed) for trial in trials
    )
    fitting = tuple(
        c for c in results if isinstance(c, BudgetCandidate) and c.robot_time <= budget + 1e-9
    )
    if not fitting:
        failed = [c for c in results if isinstance(c, ExciteError)]
        raise (
            failed[0]
            if failed
            else _too_short(budget, "ramps take it to", min(c.robot_time for c in results))
        )
    return BudgetPlan(budget, request, fitting, choose_candidate(fitting), speed)


def choose_candidate(candidates: tuple[BudgetCandidate, ...]) -> int:
    """Return the index of the simplest candidate within `DEVIATION_TOLERANCE` of the best one."""
    least = min(c.deviation for c in candidates)
    acceptable = [
        k for k, c in enumerate(candidates) if c.deviation <= (1.0 + DEVIATION_TOLERANCE) * least
    ]
    return min(acceptable, key=lambda k: (candidates[k].effort, candidates[k].deviation))


def run_plan(
    plan: BudgetPlan, options: DesignOptions, run: Callable[[DesignOptions], CertifiedDesign]
) -> CertifiedDesign:
    """Design the chosen candidate in full.

    If its ramps take longer than those of the short run, the period is shortened, else the number
    of periods is reduced.

    Args:
        plan: The plan.
        options: Options of the design.
        run: Design with given options.

    Raises:
        UnusableInput: The motion exceeds the budget, and neither may be changed.
    """
    request, best, repeats = plan.request, plan.best, plan.best.repeats
    period = longest = round(plan.speed * best.period, 9)
    while True:
        delivery = run(request.with_motion(options, period, best.harmonics, repeats))
        duration = delivery.trajectory.motion.duration
        if duration <= plan.budget + 1e-9:
            return delivery
        if request.period is None and period > 0.8 * longest:
            excess = plan.speed * (duration - plan.budget)
            period = _round_down(period - excess / repeats, ramps.time_grid(options.rate))
        elif request.periods is None and repeats > DEFAULT_PERIODS:
            repeats -= 1
        else:
            raise _too_short(plan.budget, "the motion takes", duration)


def _too_short(budget: float, reason: str, needed: float) -> UnusableInput:
    """Return the error for a time budget that is too short, with the time needed [s]."""
    return UnusableInput(
        f"--time {budget:g} is too short: {reason} {needed:.1f} s; "
        f"give at least --time {np.ceil(10.0 * needed) / 10.0:g}"
    )


def _periods_and_repeats(
    request: MotionRequest, rule: float, available: float, shortest: float, grid: float
) -> list[tuple[float, int]]:
    """Return pairs of period and repeats that fill `available` [s], nearest to the rule's."""
    if request.period is not None:
        return [(request.period, request.periods or int(available / request.period + 1e-9))]
    if request.periods is not None:
        return [(_round_down(available / request.periods, grid), request.periods)]
    filling = [
        (_round_down(available / r, grid), r) for r in _repeats(int(available / shortest + 1e-9))
    ]
    valid = [(t, r) for t, r in filling if shortest <= t <= MAX_PERIOD]
    return sorted(sorted(valid, key=lambda pair: abs(np.log(pair[0] / rule)))[:MAX_TRIED_PERIODS])


def _repeats(largest: int) -> Iterator[int]:
    """Yield 2, 3, 4, 6, 8, 12, 16, 24 … up to the largest number."""
    number = DEFAULT_PERIODS
    while number <= largest:
        yield number
        if 3 * number // 2 <= largest and number > 1:
            yield 3 * number // 2
        number *= 2


def _try_candidate(
    setup: DesignSetup, options: DesignOptions, speed: float
) -> BudgetCandidate | ExciteError:
    """Optimise a candidate briefly and plan its ramps; errors are returned as values."""
    begin_time = time.perf_counter()
    p = setup.problem
    earlier_root = (
        None
        if p.earlier_root is None
        else p.earlier_root * np.sqrt(_recorded_samples(p.options) / _recorded_samples(options))
    )
    varied = dataclasses.replace(
        setup, problem=problem.rebuild_problem(p, setup.limits, options, earlier_root)
    )
    try:
        motion = optimize.solve(varied).motion
        complete = varied.complete(motion)
    except ExciteError as error:
        return error
    value = _criterion_per_sample(varied.problem, motion)
    return BudgetCandidate(
        period=options.period / speed,
        harmonics=options.harmonics,
        samples=options.samples,
        repeats=options.periods,
        robot_time=complete.duration / speed,
        value=value,
        deviation=predicted_deviation(
            options.criterion, value, setup.base, _recorded_samples(options)
        ),
        seconds=time.perf_counter() - begin_time,
    )


def _recorded_samples(options: DesignOptions) -> float:
    """Return the number of recorded samples of the periodic part."""
    return options.periods * options.period * options.rate


def _criterion_per_sample(varied: problem.DesignProblem, motion: FourierSeries) -> float:
    """Return the exact criterion per sample."""
    options = varied.options
    rows = varied.weighting.rows(
        dynamics.regressor(
            varied.robot, varied.parameters, motion.samples(motion.grid(options.samples))
        )
    )
    return criteria.criterion_value(
        options.criterion,
        criteria.information_eigenvalues(
            rows if varied.earlier_root is None else np.vstack([rows, varied.earlier_root])
        ),
    )


def predicted_deviation(criterion: Criterion, value: float, base: Base, count: float) -> float:
    """Return the standard deviation that a criterion stands for.

    It is the root of the mean (A), geometric mean (D) or largest (E) variance; condition numbers,
    which have no unit, give their own root.
    """
    if criterion is Criterion.COND_REGRESSOR:
        return value
    if criterion is Criterion.COND:
        return float(np.sqrt(value))
    variance = {
        Criterion.A: value / base.count,
        Criterion.D: float(np.exp(-value / base.count)),
    }.get(criterion, 1.0 / value)
    return float(np.sqrt(variance / count))
