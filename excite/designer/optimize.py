"""From a robot and its limits to the best periodic motion of several starts."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import threadpoolctl

from ..collision.clearance_constraint import Clearance
from ..errors import ExciteError, UnusableInput
from ..robot import base_parameters, inertial_parameters
from ..robot.base_parameters import Base
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.fourier import Fourier
from . import criteria, design_cost, initial_guess, multistart, problem, sqp
from .constraint_margins import Subject
from .criteria import Criterion
from .evaluator import Evaluator
from .motion_overlap import Apart
from .multistart import Attempt, Progress
from .problem import Options, Problem

Array = np.ndarray


@dataclass(frozen=True)
class Setting:
    """A design problem with what it was built from."""

    problem: Problem
    base: Base
    noise: Array
    built: float  # time.perf_counter() when the problem was complete [s]

    def subject(self, limits: Limits) -> Subject:
        """What its motions are held against, by limits that are not shrunk."""
        p = self.problem
        return Subject(
            p.robot, limits, p.parameters, p.options.uncertainty, p.options.boxes, p.clearance
        )


@dataclass(frozen=True)
class Design:
    """The best motion and all attempts, the best first."""

    setting: Setting
    attempts: tuple[Attempt, ...]

    @property
    def motion(self) -> Fourier:
        """The best periodic motion found."""
        return self.attempts[0].motion

    def timing(self) -> dict[str, float]:
        """Seconds from the built problem to the first feasible motion and to within 1 % of the best objective's value."""
        final = [self._final(a) for a in self.attempts]
        first = min(times[0] for times, _ in final)
        best = min(values.min() for _, values in final)
        # the objective is a logarithm, of the square for the regressor's condition number; D's is the mean of log λ
        share = 0.02 if self.setting.problem.options.criterion is Criterion.COND_REGRESSOR else 0.01
        within = min(
            times[values <= best + share][0]
            for times, values in final
            if (values <= best + share).any()
        )
        return {"first_feasible": float(first), "within_1_percent": float(within)}

    def _final(self, attempt: Attempt) -> tuple[Array, Array]:
        """Times and best feasible objective of an attempt's last stage (the ones before smooth more)."""
        stage, worst = np.array(attempt.stage), np.array(attempt.worst)
        last = (stage == stage.max()) & (worst <= sqp.FEASIBLE)
        values = np.where(last, np.array(attempt.values), np.inf)
        return np.array(attempt.time), np.minimum.accumulate(values)


def check(options: Options) -> None:
    """Refuse options that contradict themselves; UnusableInput names the option and the remedy."""
    o = options
    if o.free_period is None:
        whole_samples(o.period, o.rate)
    if o.samples <= 2 * o.harmonics:
        raise UnusableInput(
            f"--samples {o.samples} cannot carry {o.harmonics} harmonics; use more than {2 * o.harmonics}"
        )
    positive = {
        "--harmonics": o.harmonics,
        "--period": o.period,
        "--periods": o.periods - 1,
        "--rate": o.rate,
        "--starts": o.starts,
    }
    for name, value in positive.items():
        if not (np.isfinite(value) and value > 0):
            least = "at least 2" if name == "--periods" else "positive"
            raise UnusableInput(f"{name} should be {least}")
    if not (np.isfinite(o.uncertainty) and o.uncertainty >= 0.0):
        raise UnusableInput(f"--uncertainty {o.uncertainty:g} should be 0 or more")
    if o.seed < 0:
        raise UnusableInput(f"--seed {o.seed} should be 0 or more")
    if o.jobs == 0:
        raise UnusableInput("--jobs 0 does nothing; give 1 or more, or -1 for one per core")
    for box in o.boxes:
        if not all(low < high for low, high in zip(box.lower, box.upper, strict=True)):
            raise UnusableInput(
                f"--box {box.frame}: its lower corner {box.lower} is not below its upper one {box.upper}"
            )


def whole_samples(period: float, rate: float) -> int:
    """Samples in one period; UnusableInput when they are no whole number."""
    if not (np.isfinite(period) and np.isfinite(rate) and period > 0.0 and rate > 0.0):
        raise UnusableInput(
            f"--period {period:g} and --rate {rate:g} should be positive and finite"
        )
    count = period * rate
    if abs(count - round(count)) > 1e-6 or round(count) < 1:
        better = max(round(count), 1) / rate
        raise UnusableInput(
            f"--period {period:g} s is no whole number of samples at --rate {rate:g} Hz; use --period {better:.6g}"
        )
    return round(count)


def prepare(
    robot: Robot,
    limits: Limits,
    options: Options,
    given: Array | None = None,
    apart: Apart | None = None,
    clearance: Clearance | None = None,
    home: Array | None = None,
) -> Setting:
    """Build the problem. given: information of earlier recordings in standard parameters. Shape (P, P). The others: see Problem."""
    check(options)
    design_cost.require(robot, options)
    if options.free_period is not None:
        options = dataclasses.replace(
            options, period=float(np.clip(options.period, *options.free_period))
        )
    if given is not None and options.criterion is Criterion.COND_REGRESSOR:
        raise UnusableInput(
            "--given and --criterion cond_regressor do not go together (it knows no noise); use --criterion cond"
        )
    if options.noise is not None and (
        len(options.noise) != robot.n or not all(0.0 < s < np.inf for s in options.noise)
    ):
        raise UnusableInput(f"--torque-noise should be {robot.n} positive numbers, one per joint")
    standard = inertial_parameters.standard(robot, limits, options.drive)
    found = base_parameters.find(robot, standard, limits)
    noise = problem.noise_levels(limits, options.noise)
    weights = criteria.weighting(options.criterion, found, noise, plain=options.plain)
    count = options.periods * options.period * options.rate
    root = None if given is None else weights.root(given / count)
    bare = problem.build(robot, limits, standard, weights, options, root)
    built = dataclasses.replace(bare, apart=apart, clearance=clearance, home=home)
    return Setting(built, found, noise, time.perf_counter())


def solve(setting: Setting, progress: Progress | None = None) -> Design:
    """Run all starts of a design and rank them; one seed gives one result, whatever the number of processes.

    Raises Infeasible or UnusableInput when no pose can be held under the limits.
    """
    options = setting.problem.options
    # a second motion's starts are numbered on from the first's, so that they have random streams of their own
    first = 0 if setting.problem.apart is None else options.starts
    results = multistart.run(
        setting.problem, setting.built, range(first, first + options.starts), progress
    )
    attempts = [r for r in results if isinstance(r, Attempt)]
    if not attempts:
        raise next(r for r in results if isinstance(r, ExciteError))
    design = Design(setting, tuple(attempts))
    return _fixed_period(design) if options.free_period is not None else design


def improve(setting: Setting, motion: Fourier, number: int = 0) -> Attempt:
    """Optimise on from a motion that may break limits a little: it is first drawn in, if that makes it obey them."""
    with threadpoolctl.threadpool_limits(1):
        evaluator = Evaluator(setting.problem)
        x = setting.problem.variables(motion)
        rest = initial_guess.at_rest(setting.problem, motion.offset)
        for share in (1.0, *(1.0 - 0.5 ** np.arange(9, 1, -1)), 0.6, 0.45, 0.3, 0.2):
            drawn = rest + share * (x - rest)
            if evaluator.worst(drawn) <= 1.0:
                break
        else:  # its middle pose can't be held, say: the solver finds its own way back
            drawn = x
        return multistart.refine(evaluator, drawn, setting.built, number)


def _fixed_period(design: Design) -> Design:
    """Round an optimised period to whole samples (and to the ramps' time grid) and settle the motion there."""
    old = design.setting.problem
    motion, rate = design.motion, old.options.rate
    period = _whole_period(motion.period, rate, old.options.free_period)
    options = dataclasses.replace(old.options, period=period, free_period=None)
    rebuilt = dataclasses.replace(old, options=options)
    setting = dataclasses.replace(design.setting, problem=rebuilt)
    stretched = Fourier(motion.sine, motion.cosine, motion.offset, period)
    slower = motion.slowed(motion.period / period)
    best = min(
        (improve(setting, m, design.attempts[0].number) for m in (stretched, slower)),
        key=lambda a: a.objective,
    )
    return Design(setting, (best, *design.attempts[1:]))


def _whole_period(period: float, rate: float, bounds: tuple[float, float] | None) -> float:
    """The next period of whole samples within the bounds: longer if there is one, on the ramps' time grid if it fits."""
    assert bounds is not None
    for grid in (max(round(0.04 * rate), 1) / rate, 1.0 / rate):
        for rounded in (
            np.ceil(period / grid - 1e-9) * grid,
            np.floor(period / grid + 1e-9) * grid,
        ):
            if bounds[0] - 1e-9 <= rounded <= bounds[1] + 1e-9:
                return float(rounded)
    raise UnusableInput(
        f"--optimise-period {bounds[0]:g},{bounds[1]:g}: holds no whole number of samples at --rate {rate:g} Hz; widen it"
    )


def tightened(
    setting: Setting,
    limits: Limits,
    reserve: float,
    short: Mapping[str, float] | None = None,
    *,
    finer: bool = False,
) -> Setting:
    """The same problem with a larger reserve on curved limits, for when the certificate finds a gap between samples.

    short: clearance that pairs of bodies lack [m]. finer: with samples twice as dense.
    """
    p, lacking = setting.problem, short or {}
    options = dataclasses.replace(p.options, samples=(1 + finer) * p.options.samples)
    tighter = problem.rebuilt(p, limits, options, p.given, reserve)
    if p.clearance is not None:
        more = np.array([lacking.get(pair, 0.0) for pair in p.clearance.names])
        tighter = dataclasses.replace(
            tighter, clearance=dataclasses.replace(p.clearance, more=p.clearance.more + more)
        )
    return dataclasses.replace(setting, problem=tighter)
