"""Period, harmonics and repeats where the user gave none: by a rule from the limits, or by trial for a budget of robot time.

The rule optimises nothing. Joint j sweeps its range at its limits with the sinusoid A sin(ωt), A ω ≤ v, A ω² ≤ a, of period
2π max(A/v, √(A/a)); A is half the position range, at most half a turn, beyond which poses repeat. The lowest harmonic
gets the median of the joints' periods.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import joblib
import numpy as np

from ..collision.clearance_constraint import Clearance
from ..errors import ExciteError, UnusableInput
from ..robot import dynamics
from ..robot.base_parameters import Base
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.fourier import FourierSeries
from . import criteria, optimize, problem, ramps
from .criteria import Criterion
from .optimize import DesignSetup
from .options import DesignOptions
from .pipeline import CertifiedDesign

Array = np.ndarray
DEFAULT_HARMONICS = 5
DEFAULT_PERIODS = 2
MAX_FREQUENCY = 1.25
"""Highest frequency that is chosen for the user [Hz]: 5 harmonics of 4 s, a few times below where the drives of arms
begin to swing, which rigid bodies do not model."""
MAX_PERIOD = 30.0
PERIOD_STEP = 0.2
"""The rule's periods are multiples of this [s] where the rate allows, those that fill a budget of the ramps' 0.04 s."""
MIN_CHOSEN_HARMONICS, MAX_CHOSEN_HARMONICS = 3, 12
"""Harmonics that are chosen for a budget: fewer tell too little, more cost too long."""
REDUCED_HARMONICS_SHARE = 0.6
"""Besides as many harmonics as HIGHEST allows, this share of them is tried."""
MAX_TRIED_PERIODS = 4
"""How many periods are tried for a budget, those nearest to the rule's."""
TRIAL_ITERATIONS = 25
DEVIATION_TOLERANCE = 0.05
"""The simplest candidate within this share of the least standard deviation is chosen: short runs scatter as much."""
RAMP_TIME_RESERVE = 0.4
"""Ramps of the final motion may take this much longer than those of a short run [s] and a fifth; more costs a second run."""


# -- the rule ------------------------------------------------------------------------------------------------------


def sweep_periods(limits: Limits) -> Array:
    """Per joint the period of the sinusoid that sweeps its range within its limits. Shape (n,) [s]."""
    half = np.minimum(0.5 * (limits.position[:, 1] - limits.position[:, 0]), np.pi)
    out: Array = (
        2.0 * np.pi * np.maximum(half / limits.velocity, np.sqrt(half / limits.acceleration))
    )
    return out


def choose_period(limits: Limits, harmonics: int = DEFAULT_HARMONICS, rate: float = DesignOptions.rate) -> float:
    """The period by the rule [s]: a whole number of samples at `rate` [Hz], no harmonic above HIGHEST."""
    grid = PERIOD_STEP if abs(PERIOD_STEP * rate - round(PERIOD_STEP * rate)) < 1e-9 else ramps.time_grid(rate)
    swept = grid * round(float(np.median(sweep_periods(limits))) / grid)
    return round(max(min(swept, MAX_PERIOD), _up(harmonics / MAX_FREQUENCY, grid)), 9)


def default_samples(harmonics: int) -> int:
    """The optimiser's grid over one period where none is given."""
    return 20 * max(harmonics, 3)


def _down(duration: float, grid: float) -> float:
    return round(grid * float(np.floor(duration / grid + 1e-9)), 9)


def _up(duration: float, grid: float) -> float:
    return round(grid * float(np.ceil(duration / grid - 1e-9)), 9)


def _or(given: int | None, otherwise: int) -> int:
    return otherwise if given is None else given


@dataclass(frozen=True)
class MotionRequest:
    """What the user gave; None where the choice is free."""

    period: float | None = None
    harmonics: int | None = None
    samples: int | None = None
    periods: int | None = None

    @property
    def unspecified(self) -> list[str]:
        """Names of what is left to choose."""
        return [name for name, value in dataclasses.asdict(self).items() if value is None]

    def complete(self, options: DesignOptions, limits: Limits) -> DesignOptions:
        """The options with what was given, and the rest by the rule."""
        harmonics = _or(self.harmonics, DEFAULT_HARMONICS)
        swept = choose_period(limits, harmonics, options.rate) if self.period is None else self.period
        return self.with_motion(options, swept, harmonics, _or(self.periods, DEFAULT_PERIODS))

    def with_motion(self, options: DesignOptions, period: float, harmonics: int, periods: int) -> DesignOptions:
        """The options with this motion, on the grid that was given or that suits it."""
        grid = _or(self.samples, default_samples(harmonics))
        return dataclasses.replace(
            options, period=period, harmonics=harmonics, periods=periods, samples=grid
        )

    def harmonics_to_try(self, period: float) -> list[int]:
        """Numbers of harmonics to try for a period: as many as may be, and fewer."""
        if self.harmonics is not None:
            return [self.harmonics]
        carried = MAX_CHOSEN_HARMONICS if self.samples is None else (self.samples - 1) // 2
        most = max(min(int(MAX_FREQUENCY * period + 1e-9), carried, MAX_CHOSEN_HARMONICS), 1)
        return sorted({most, min(max(round(REDUCED_HARMONICS_SHARE * most), MIN_CHOSEN_HARMONICS), most)})


# -- a budget of robot time ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BudgetCandidate:
    """One way to spend the robot's time, judged by a short optimisation.

    robot_time: of the whole motion with its ramps [s]. value: the criterion per sample of the periodic part.
    deviation: the standard deviation that all its samples predict, up to a factor that the candidates share.
    seconds: what the optimisation took.
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
        """What an iteration costs, up to a factor: harmonics, the share of each joint's variables, times samples."""
        return self.harmonics * self.samples


@dataclass(frozen=True)
class BudgetPlan:
    """What was tried for a budget of robot time [s], and the place of the one chosen among it."""

    budget: float
    request: MotionRequest
    candidates: tuple[BudgetCandidate, ...]
    chosen_index: int

    @property
    def best(self) -> BudgetCandidate:
        """The chosen candidate."""
        return self.candidates[self.chosen_index]

    def document(self) -> dict[str, Any]:
        """As `excite design --json` states it."""
        listed = [dataclasses.asdict(c) for c in self.candidates]
        return {
            "budget": self.budget,
            "tolerance": DEVIATION_TOLERANCE,
            "candidates": listed,
            "chosen": self.chosen_index,
        }

    def facts(self) -> dict[str, Any]:
        """The same without what differs from run to run, as `trajectory.json` states it."""
        document = self.document()
        for candidate in document["candidates"]:
            del candidate["seconds"]
        return document

    def words(self) -> str:
        """The choice, and the best of the others, in a line."""
        one = self.best
        text = f"planned for {self.budget:g} s: {one.repeats} × {one.period:g} s with {one.harmonics} harmonics"
        others = [
            f"{100.0 * (c.deviation / one.deviation - 1.0):+.0f} % with {c.repeats} × {c.period:g} s and {c.harmonics}"
            for c in sorted(self.candidates, key=lambda c: c.deviation)
            if c is not one
        ]
        return f"{text}; standard deviations {', '.join(others[:3])}" if others else text


def plan_for_budget(
    robot: Robot,
    limits: Limits,
    options: DesignOptions,
    wish: MotionRequest,
    budget: float,
    *,
    start: Array | None = None,
    given: Array | None = None,
    clearance: Clearance | None = None,
) -> BudgetPlan:
    """Choose what the wish leaves open, for a whole motion of at most `budget` [s] that shows as much as can be.

    Candidates that fill the budget are optimised for a few iterations each. Their information is that of a sample times the
    samples recorded; of those within TOLERANCE of the least standard deviation the one of the least effort is taken.
    start, given: as `workflow.run` takes them. clearance: of its cell. Raises UnusableInput that says the least time needed, and what the
    optimisation raises where no candidate is feasible.
    """
    if not (np.isfinite(budget) and budget > 0.0):
        raise UnusableInput(f"--time {budget:g} should be positive [s]")
    if options.free_period is not None:
        raise UnusableInput("--time and --optimise-period both choose the period; drop one of them")
    optimize.check_options(wish.complete(options, limits))  # what was given makes sense from here on
    grid, repeats = ramps.time_grid(options.rate), wish.periods or DEFAULT_PERIODS
    shortest = wish.period or _up((wish.harmonics or MIN_CHOSEN_HARMONICS) / MAX_FREQUENCY, grid)
    # a first short run tells how long the ramps take
    rule = choose_period(limits, wish.harmonics or DEFAULT_HARMONICS, options.rate)
    swept = wish.period or max(min(rule, _down(budget / repeats, grid)), shortest)
    short = dataclasses.replace(options, starts=1, iterations=min(TRIAL_ITERATIONS, options.iterations))
    setting = optimize.set_up(
        robot,
        limits,
        wish.with_motion(short, swept, wish.harmonics_to_try(swept)[0], repeats),
        given,
        clearance=clearance,
        start_pose=start,
    )
    if start is not None:
        ramps.check_start_pose(setting.constraints(limits.reduced()), start)
    pilot = _attempt(setting, limits, setting.problem.options, start)
    if isinstance(pilot, ExciteError):
        raise pilot
    around = 1.2 * (pilot.robot_time - repeats * swept) + RAMP_TIME_RESERVE
    if budget < repeats * shortest + around:
        raise _too_short(
            budget,
            f"{repeats} periods of {shortest:g} s with ramps take about",
            repeats * shortest + around,
        )
    motions = _motions(wish, rule, budget - around, shortest, grid)
    several = [wish.with_motion(short, t, k, r) for t, r in motions for k in wish.harmonics_to_try(t)]
    tried = joblib.Parallel(n_jobs=options.jobs)(
        joblib.delayed(_attempt)(setting, limits, one, start) for one in several
    )
    fitting = tuple(c for c in tried if isinstance(c, BudgetCandidate) and c.robot_time <= budget + 1e-9)
    if not fitting:
        failed = [c for c in tried if isinstance(c, ExciteError)]
        raise (
            failed[0]
            if failed
            else _too_short(budget, "ramps take it to", min(c.robot_time for c in tried))
        )
    return BudgetPlan(budget, wish, fitting, choose_candidate(fitting))


def choose_candidate(candidates: tuple[BudgetCandidate, ...]) -> int:
    """The place of the candidate of the least effort within TOLERANCE of the least standard deviation."""
    least = min(c.deviation for c in candidates)
    good = [k for k, c in enumerate(candidates) if c.deviation <= (1.0 + DEVIATION_TOLERANCE) * least]
    return min(good, key=lambda k: (candidates[k].effort, candidates[k].deviation))


def run_plan(plan: BudgetPlan, options: DesignOptions, run: Callable[[DesignOptions], CertifiedDesign]) -> CertifiedDesign:
    """Run the chosen candidate in full. Where its ramps came out longer than the short run's, its period gives way, or a repeat.

    run: `workflow.run` with all but the options. Raises UnusableInput when nothing may give way.
    """
    wish, best = plan.request, plan.best
    swept, repeats = best.period, best.repeats
    while True:
        delivery = run(wish.with_motion(options, swept, best.harmonics, repeats))
        duration = delivery.trajectory.motion.duration * float(delivery.trajectory.design["speed"])
        if duration <= plan.budget + 1e-9:
            return delivery
        if wish.period is None and swept > 0.8 * best.period:
            swept = _down(swept - (duration - plan.budget) / repeats, ramps.time_grid(options.rate))
        elif wish.periods is None and repeats > DEFAULT_PERIODS:
            repeats -= 1
        else:
            raise _too_short(plan.budget, "the motion takes", duration)


def _too_short(budget: float, what: str, needed: float) -> UnusableInput:
    return UnusableInput(
        f"--time {budget:g} is too short: {what} {needed:.1f} s; give at least --time {np.ceil(10.0 * needed) / 10.0:g}"
    )


def _motions(
    wish: MotionRequest, rule: float, room: float, shortest: float, grid: float
) -> list[tuple[float, int]]:
    """Periods and repeats that fill `room` [s]: the NEAREST whose periods are nearest to the rule's, as a ratio."""
    if wish.period is not None:
        return [(wish.period, wish.periods or int(room / wish.period + 1e-9))]
    if wish.periods is not None:
        return [(_down(room / wish.periods, grid), wish.periods)]
    filling = [(_down(room / r, grid), r) for r in _repeats(int(room / shortest + 1e-9))]
    usable = [(t, r) for t, r in filling if shortest <= t <= MAX_PERIOD]
    return sorted(sorted(usable, key=lambda one: abs(np.log(one[0] / rule)))[:MAX_TRIED_PERIODS])


def _repeats(most: int) -> Iterator[int]:
    """2, 3, 4, 6, 8, 12, 16, 24 …"""
    number = DEFAULT_PERIODS
    while number <= most:
        yield number
        if 3 * number // 2 <= most and number > 1:
            yield 3 * number // 2
        number *= 2


def _attempt(
    setting: DesignSetup, limits: Limits, options: DesignOptions, start: Array | None
) -> BudgetCandidate | ExciteError:
    """A short optimisation and its ramps; errors come back as values, out of any process."""
    begun = time.perf_counter()
    p = setting.problem
    given = None if p.given is None else p.given * np.sqrt(_count(p.options) / _count(options))
    varied = dataclasses.replace(setting, problem=problem.rebuild_problem(p, limits, options, given))
    try:
        motion = optimize.solve(varied).motion
        usable = ramps.with_derived_limits(limits, motion).reduced()
        whole = ramps.plan_rest_to_rest(
            varied.constraints(usable), motion, options.periods, options.rate, start
        )
    except ExciteError as error:
        return error
    value = _value(varied.problem, motion)
    return BudgetCandidate(
        period=options.period,
        harmonics=options.harmonics,
        samples=options.samples,
        repeats=options.periods,
        robot_time=whole.duration,
        value=value,
        deviation=_deviation(options.criterion, value, setting.base, _count(options)),
        seconds=time.perf_counter() - begun,
    )


def _count(options: DesignOptions) -> float:
    """Samples recorded of the periodic part."""
    return options.periods * options.period * options.rate


def _value(varied: problem.DesignProblem, motion: FourierSeries) -> float:
    """The criterion per sample, exactly."""
    options = varied.options
    rows = varied.weighting.rows(
        dynamics.regressor(
            varied.robot, varied.parameters, motion.samples(motion.grid(options.samples))
        )
    )
    return criteria.criterion_value(
        options.criterion,
        criteria.information_eigenvalues(rows if varied.given is None else np.vstack([rows, varied.given])),
    )


def _deviation(criterion: Criterion, value: float, base: Base, count: float) -> float:
    """Standard deviation: the root of the mean (A), geometric mean (D) or largest (E) variance; a condition's own root."""
    if criterion is Criterion.COND_REGRESSOR:
        return value
    if criterion is Criterion.COND:
        return float(np.sqrt(value))
    variance = {
        Criterion.A: value / base.count,
        Criterion.D: float(np.exp(-value / base.count)),
    }.get(criterion, 1.0 / value)
    return float(np.sqrt(variance / count))
