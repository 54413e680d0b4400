"""Set up the design of a motion that discriminates between competing explanations."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..errors import ExciteError, UnusableInput
from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..trajectory.fourier import FourierSeries
from . import multistart
from .design_objective import SampledMotion
from .discrimination import (
    INDEPENDENT_RATE,
    BaseProjection,
    Comparison,
    Explanation,
    RunSettings,
    SeparationObjective,
    WeightedRows,
    indistinguishable,
    prior_rows,
    run_rows,
    separations,
)
from .effect_columns import EffectColumns, RobotConstants, SymbolicEffect
from .multistart import Attempt
from .options import torque_noise_levels
from .problem import DesignProblem

USUAL_SEVERITY = 1.0
"""RMS torque of an explanation of unknown size after projection off the base, over the noise, along
the reference motion [1]."""
VAGUE_STD = 1e3
"""Prior standard deviation with which indistinguishable explanations are sought [1]."""
DENSE_RATE = 100.0
"""Samples per second at which separations are reported [Hz]."""


@dataclass(frozen=True)
class CandidateExplanation:
    """An explanation whose size may be unknown.

    Attributes:
        form: The effect with its nonlinear parameters.
        factor: L with E[c cᵀ] = L Lᵀ; None: a usual size. Shape (k, r).
        probability: Posterior probability.
        like: Index of the explanation whose size it has where its own is unknown, as an equivalent
            has; None: `USUAL_SEVERITY`.
    """

    form: SymbolicEffect
    factor: FloatArray | None
    probability: float
    like: int | None = None


def sampled_motion(
    robot: Robot, parameters: Parameters, motion: FourierSeries, rate: float = DENSE_RATE
) -> SampledMotion:
    """Return one period of a motion, densely sampled, with its regressor.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        motion: The motion.
        rate: Samples per second [Hz].
    """
    samples = motion.samples(motion.grid(max(round(motion.period * rate), 16)))
    Y = regressor(robot, parameters, samples)
    return SampledMotion(samples.q, samples.dq, samples.ddq, Y, motion.period)


@dataclass(frozen=True)
class ExplanationSet:
    """Competing explanations of a robot's torque.

    Attributes:
        constants: Robot with the parameters by which columns are computed.
        candidates: The explanations.
        comparisons: Which of them compete.
        given: Motions that are recorded already, each counted as one period.
    """

    constants: RobotConstants
    candidates: tuple[CandidateExplanation, ...]
    comparisons: tuple[Comparison, ...]
    given: tuple[SampledMotion, ...] = ()

    def sized(
        self,
        effects: EffectColumns,
        motion: SampledMotion,
        settings: RunSettings,
        severity: float = USUAL_SEVERITY,
        given: WeightedRows | None = None,
    ) -> tuple[Explanation, ...]:
        """Return the explanations, those of unknown size scaled along a reference motion.

        An equivalent has the size that its finding has in the recordings that are given: elsewhere
        a finding may be extrapolated, by a power of the speed for example, to where nothing is
        known of it. Where none is given, it has that size along the reference motion.

        Args:
            effects: Columns of the candidates.
            motion: The reference motion.
            settings: How it is recorded.
            severity: RMS torque of an explanation of unknown size after projection off the base,
                over the noise [1].
            given: Rows of earlier recordings; None without.
        """
        columns = effects.evaluate(motion).columns
        rows = run_rows(motion, columns, effects, settings).rows
        prior = prior_rows(settings, effects.count)
        rows = rows.stacked(prior)
        usual = severity**2 * settings.periods * motion.period * INDEPENDENT_RATE
        raw = [
            _unit_factor(coefficients, place.stop - coefficients.stop, rows, c.factor)
            for coefficients, place, c in zip(
                effects.coefficients, effects.slices, self.candidates, strict=True
            )
        ]
        sizes = _sizes(rows, effects, raw)
        recorded = sizes if given is None else _sizes(given.stacked(prior), effects, raw)
        out = []
        for i, candidate in enumerate(self.candidates):
            if candidate.factor is not None:
                out.append(Explanation(candidate.form, raw[i], candidate.probability))
                continue
            model = candidate.like
            if model is not None and self.candidates[model].factor is not None:
                target, size = recorded[model], recorded[i]
            else:
                target, size = usual, sizes[i]
            scale = np.sqrt(target / size) if size > 0.0 else 0.0
            out.append(Explanation(candidate.form, scale * raw[i], candidate.probability, True))
        return tuple(out)

    def with_objective(self, problem: DesignProblem, base: Base) -> DesignProblem:
        """Return a design problem whose objective is the smallest separation.

        The optimum of the problem's own criterion is the reference motion along which sizes are
        set, and the first start of the search.

        Args:
            problem: The design problem, with the criterion of the reference motion.
            base: Base parameters of the robot.

        Raises:
            UnusableInput: The period is free, or no comparison can be decided by any motion.
        """
        options = problem.options
        if options.free_period is not None:
            raise UnusableInput(
                "--discriminate and --optimise-period do not go together, as some effects depend "
                "on the time; state --period"
            )
        attempts = multistart.run_starts(problem, range(options.starts))
        complete = [a for a in attempts if isinstance(a, Attempt)]
        if not complete:
            raise next(a for a in attempts if isinstance(a, ExciteError))
        reference = complete[0].motion
        objective = self.objective(problem, base, reference)
        return dataclasses.replace(problem, objective=objective, warm_start=reference)

    def objective(
        self, problem: DesignProblem, base: Base, reference: FourierSeries
    ) -> SeparationObjective:
        """Return the objective for sizes along a reference motion.

        Args:
            problem: The design problem.
            base: Base parameters of the robot.
            reference: The reference motion.

        Raises:
            UnusableInput: No comparison can be decided by any motion.
        """
        noise = torque_noise_levels(self.constants.limits, problem.options.noise)
        settings = RunSettings(base.geometric, noise, problem.options.periods)
        effects = EffectColumns(
            self.constants, [c.form for c in self.candidates], uncertain_forms=True
        )
        motion = sampled_motion(problem.robot, problem.parameters, reference)
        given = self._given_rows(effects, settings)
        explanations = self.sized(effects, motion, settings, given=given)
        objective = SeparationObjective(
            effects, explanations, self.comparisons, settings, given=given
        )
        # without the prior, against which large parameters of the base model would stand out
        rows = objective.rows(motion).stacked(objective.known_rows(VAGUE_STD))
        result = separations(rows, effects.slices, explanations, self.comparisons)
        lost = indistinguishable(
            result.values, _raw_sizes(rows, effects, explanations, self.comparisons)
        )
        kept = [c for c, gone in zip(self.comparisons, lost, strict=True) if not gone]
        undecidable = [c for c, gone in zip(self.comparisons, lost, strict=True) if gone]
        if not kept:
            names = sorted({self.candidates[c.true].form.effect for c in undecidable})
            raise UnusableInput(
                f"no motion can decide between the explanations ({', '.join(names)}): each "
                "reproduces the torque of the others, or the base model does; change the load or "
                "trust a prior"
            )
        total = sum(c.weight for c in kept)
        return dataclasses.replace(
            objective,
            comparisons=tuple(dataclasses.replace(c, weight=c.weight / total) for c in kept),
            undecidable=tuple(undecidable),
        )

    def _given_rows(self, effects: EffectColumns, settings: RunSettings) -> WeightedRows | None:
        """Return the rows of the motions that are recorded already; None without any."""
        once = dataclasses.replace(settings, periods=1)
        out: WeightedRows | None = None
        for motion in self.given:
            columns = effects.evaluate(motion).columns
            rows = run_rows(motion, columns, effects, once).rows
            out = (rows if out is None else out.stacked(rows)).compressed()
        return out


def _unit_factor(
    place: slice, form_columns: int, rows: WeightedRows, factor: FloatArray | None
) -> FloatArray:
    """Return a stated factor, or one that gives all columns the same size independently.

    Args:
        place: Columns of the effect.
        form_columns: Number of columns of its uncertain form, for which the factor is zero.
        rows: Rows along the reference motion.
        factor: The stated factor; None if there is none.
    """
    if factor is None:
        size = np.linalg.norm(rows.columns[:, place], axis=0)
        factor = np.diag(1.0 / np.maximum(size, 1e-12 * max(float(size.max()), 1e-300)))
    return np.vstack([factor, np.zeros((form_columns, factor.shape[1]))])


def _sizes(rows: WeightedRows, effects: EffectColumns, factors: list[FloatArray]) -> FloatArray:
    """Return each explanation's squared torque over the noise, after projection off the base."""
    projection = BaseProjection.of(rows)
    free = rows.columns - rows.base @ projection.coefficients
    return np.array(
        [
            float(np.sum((free[:, place] @ factor) ** 2))
            for place, factor in zip(effects.slices, factors, strict=True)
        ]
    )


def _raw_sizes(
    rows: WeightedRows,
    effects: EffectColumns,
    explanations: tuple[Explanation, ...],
    comparisons: tuple[Comparison, ...],
) -> FloatArray:
    """Return the squared torque of the true explanation of each comparison. Shape (c,)."""
    torque = [
        float(np.sum((rows.columns[:, effects.slices[i]] @ e.factor) ** 2))
        for i, e in enumerate(explanations)
    ]
    return np.array([torque[c.true] for c in comparisons])


def competing_pairs(
    members: list[int], probabilities: list[float], nuisance: Callable[[int, int], tuple[int, ...]]
) -> list[Comparison]:
    """Return both comparisons of every two members of a class.

    Args:
        members: Indices of the explanations in the class.
        probabilities: Probability of every explanation.
        nuisance: Returns the effects that are fitted jointly with two explanations.

    Returns:
        Comparisons, weighted by the product of both probabilities.
    """
    return [
        Comparison(a, b, nuisance(a, b), probabilities[a] * probabilities[b])
        for a in members
        for b in members
        if a != b
    ]
