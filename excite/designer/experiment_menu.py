"""Menu of further experiments, with expected log-odds of every comparison.

Each experiment is added to the earlier recordings, or else to one of the reference motion: a
repeat, a slower or faster one, one with a load at the flange, in another pose of joint 1, after a
warm-up, a longer one, and the designed motion. The expected log-odds are half the separation along
all recordings together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..robot.limits import Limits
from ..trajectory.fourier import FourierSeries
from .design_objective import SampledMotion
from .discrimination import (
    RunSettings,
    SeparationObjective,
    WeightedRows,
    run_rows,
    separations,
)
from .discrimination_design import sampled_motion
from .effect_columns import EffectColumns
from .evaluator import Evaluator
from .problem import DesignProblem
from .sqp import MAX_FEASIBLE_ROW_VALUE

DECISIVE_LOG_ODDS = 5.0
"""Log-odds from which a comparison counts as decided [nat]: odds of 150 to 1."""
SLOWER, FASTER = 0.5, 1.3
"""Speeds of the slower and the faster repeat, over that of the reference motion [1]."""
LONGER = 4
"""Periods of the longer recording over those of the reference motion [1]."""
WARM_UP = 1200.0
"""Run time before the recording after a warm-up [s]."""
MOUNTING = 300.0
"""Time to mount a load at the flange [s]."""
MASSES = (5.0, 3.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05)
"""Loads that are tried, the largest that the torque limits allow first [kg]."""
LOAD_DISTANCE = 0.1
"""Distance of the load's centre of mass from the last joint's frame [m]."""
LOAD_RADIUS = 0.05
"""Radius of gyration of the load [m]."""
LOAD_STD = 0.05
"""Standard deviation of the load's parameters, each over its size [1]."""
POSE_SHARES = (0.25, -0.25, 0.125, -0.125)
"""Shifts of joint 1 that are tried, over its range [1]."""


@dataclass(frozen=True)
class Experiment:
    """An experiment and what it would decide.

    Attributes:
        name: What to do.
        seconds: Robot time, with preparation [s].
        log_odds: Expected log-odds of each comparison after it; None where it is not possible.
            Shape (c,) [nat].
        obstacle: Why it is not possible; empty where it is.
    """

    name: str
    seconds: float
    log_odds: FloatArray | None
    obstacle: str = ""

    @property
    def decides(self) -> bool:
        """True if every comparison is decided."""
        return self.log_odds is not None and bool((self.log_odds >= DECISIVE_LOG_ODDS).all())


def recommended(menu: tuple[Experiment, ...]) -> Experiment:
    """Return the cheapest experiment that decides every comparison.

    Where none does, the one with the largest expected log-odds of its worst comparison.

    Args:
        menu: Experiments, at least one of them possible.
    """
    possible = [e for e in menu if e.log_odds is not None]
    deciding = [e for e in possible if e.decides]
    if deciding:
        return min(deciding, key=lambda e: e.seconds)
    return max(possible, key=lambda e: float(np.min(e.log_odds)))  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Bench:
    """The reference recording and what all experiments share."""

    problem: DesignProblem
    limits: Limits
    objective: SeparationObjective
    reference: FourierSeries

    def rows(
        self,
        motion: FourierSeries,
        effects: EffectColumns | None = None,
        settings: RunSettings | None = None,
    ) -> WeightedRows:
        """Return the rows of a recording of a motion."""
        effects = effects or self.objective.effects
        sampled = self.sampled(motion)
        columns = effects.evaluate(sampled).columns
        return run_rows(sampled, columns, effects, settings or self.objective.settings).rows

    def sampled(self, motion: FourierSeries) -> SampledMotion:
        """Return a densely sampled period of a motion."""
        return sampled_motion(self.problem.robot, self.problem.parameters, motion)

    def log_odds(self, added: WeightedRows) -> FloatArray:
        """Return the expected log-odds of earlier recordings and added rows together."""
        objective = self.objective
        known = objective.known_rows()
        if objective.given is None:
            known = self.rows(self.reference).stacked(known)
        extra = added.base.shape[1] - known.base.shape[1]
        if extra:  # parameters of a load, which the earlier recordings do not have
            base = np.hstack([known.base, np.zeros((len(known.base), extra))])
            prior = np.hstack([np.zeros((extra, known.base.shape[1])), np.eye(extra)])
            columns = np.vstack([known.columns, np.zeros((extra, known.columns.shape[1]))])
            known = WeightedRows(np.vstack([base, prior]), columns)
        result = separations(
            known.stacked(added),
            objective.effects.slices,
            objective.explanations,
            objective.comparisons,
        )
        return 0.5 * result.values

    @property
    def duration(self) -> float:
        """Time of one recording, without ramps [s]."""
        return self.objective.settings.periods * self.reference.period


def _with_load(bench: _Bench) -> Experiment:
    """Repeat the reference motion with a load at the flange."""
    problem, effects = bench.problem, bench.objective.effects
    constants = effects.constants
    link = 10 * (constants.parameters.bodies - 1)
    sampled = bench.sampled(bench.reference)
    seconds = bench.duration + MOUNTING
    for mass in MASSES:
        unit = np.array([1.0, 0.0, 0.0, LOAD_DISTANCE, *[0.0] * 6])
        inertia = LOAD_RADIUS**2
        unit[[4, 6]] = inertia + LOAD_DISTANCE**2
        unit[9] = inertia
        psi = constants.psi.copy()
        psi[link : link + 10] += mass * unit
        torque = np.abs(sampled.regressor @ psi).max(axis=0)
        if not (torque <= bench.limits.torque).all():
            continue
        loaded = EffectColumns(
            dataclasses.replace(constants, psi=psi),
            effects.effects,
            uncertain_forms=effects.uncertain_forms,
        )
        rows = bench.rows(bench.reference, loaded)
        spread = LOAD_STD * mass * np.array([1.0, *[LOAD_DISTANCE] * 3, *[LOAD_DISTANCE**2] * 6])
        scale = run_rows(
            sampled, effects.evaluate(sampled).columns, effects, bench.objective.settings
        ).scale
        payload = (sampled.regressor[:, :, link : link + 10] * scale[:, None]) * spread
        flat = payload.reshape(-1, 10)
        added = np.tile(flat, (len(rows.base) // len(flat), 1))
        stacked = WeightedRows(np.hstack([rows.base, added]), rows.columns)
        name = f"repeat with {mass:g} kg at {problem.robot.links[-1]}, weighed"
        return Experiment(name, seconds, bench.log_odds(stacked))
    return Experiment("repeat with a load at the flange", seconds, None, "torque limits")


def _repeat(bench: _Bench, name: str, motion: FourierSeries) -> Experiment:
    """Repeat the reference motion in a changed form, where all limits of the design allow it."""
    problem, options = bench.problem, bench.problem.options
    played = dataclasses.replace(
        problem, options=dataclasses.replace(options, period=motion.period)
    )
    evaluator, x = Evaluator(played), played.variables(motion)
    seconds = options.periods * motion.period
    if evaluator.max_constraint_value(x) > MAX_FEASIBLE_ROW_VALUE:
        return Experiment(name, seconds, None, " and ".join(evaluator.active_constraints(x, 1)))
    return Experiment(name, seconds, bench.log_odds(bench.rows(motion)))


def _other_pose(bench: _Bench) -> Experiment:
    """Repeat the reference motion about another mean position of joint 1."""
    robot = bench.problem.robot
    low, high = bench.limits.position[0]
    reach = float(high - low) if np.isfinite(high - low) else 2.0 * np.pi
    for share in POSE_SHARES:
        shift = share * reach
        offset = bench.reference.offset.copy()
        offset[0] += shift
        is_sliding = robot.entries[0].kind == "prismatic"
        size = f"{shift:.2g} m" if is_sliding else f"{np.degrees(shift):.0f}°"
        name = f"repeat with {robot.joints[0]} shifted by {size.replace('-', '−')}"
        experiment = _repeat(bench, name, dataclasses.replace(bench.reference, offset=offset))
        if not experiment.obstacle:
            return experiment
    name = f"repeat in another pose of {robot.joints[0]}"
    return dataclasses.replace(experiment, name=name)


def compute_menu(
    problem: DesignProblem,
    limits: Limits,
    objective: SeparationObjective,
    reference: FourierSeries,
    designed: FourierSeries,
) -> tuple[Experiment, ...]:
    """Predict what each experiment would decide.

    Args:
        problem: The design problem of the discriminating motion.
        limits: Limits of the robot.
        objective: Explanations and comparisons.
        reference: D-optimal motion, whose recording comes first where none is given.
        designed: The discriminating motion.

    Returns:
        The experiments, the designed motion first.
    """
    bench = _Bench(problem, limits.reduced(), objective, reference)
    settings = objective.settings
    simple: list[tuple[str, float, Callable[[], WeightedRows]]] = [
        ("this motion", settings.periods * designed.period, lambda: bench.rows(designed)),
        ("repeat the D-optimal motion", bench.duration, lambda: bench.rows(reference)),
        (
            f"record it {LONGER} times as long",
            LONGER * bench.duration,
            lambda: bench.rows(
                reference,
                settings=dataclasses.replace(settings, periods=LONGER * settings.periods),
            ),
        ),
        (
            f"repeat it after a warm-up of {WARM_UP / 60.0:.0f} min",
            bench.duration + WARM_UP,
            lambda: bench.rows(reference, settings=dataclasses.replace(settings, run_time=WARM_UP)),
        ),
    ]
    return (
        *(Experiment(name, time, bench.log_odds(rows())) for name, time, rows in simple),
        *(
            _repeat(bench, f"repeat at {speed:g} times the speed", reference.slowed(speed))
            for speed in (SLOWER, FASTER)
        ),
        _other_pose(bench),
        _with_load(bench),
    )
