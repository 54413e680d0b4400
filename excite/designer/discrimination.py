"""Discrimination between competing explanations of a torque: separation, objective, gradient.

Explanation a has the torque C_a c_a, its rival b the columns C_b; both are fitted jointly with the
base regressor Γ and the columns of all other effects of the model. The separation

    T_ab = min_θ ‖W^½ (C_a c_a − [Γ C_b] θ)‖²

is what of a's torque its rival cannot reproduce, and the expected log-odds after the recording are
T_ab/2 (Atkinson and Fedorov, Biometrika 62, 1975). A rival, like all effects that are fitted
jointly, may bend its curve: the columns of its uncertain form (`form_uncertainty`) belong to C_b,
and their prior adds ‖θ_f/s_f‖² to the square, where s_f is the expected size of the coefficient of
the column that each of them bends. With u the coefficients of all columns at the
minimum and r the residual, ∂T = 2 rᵀ(∂C u − ∂Γ θ) (envelope theorem), so that one least-squares
solution gives the exact gradient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from .._linear_algebra import triangle
from .._types import FloatArray
from .design_objective import ObjectiveGradient, SampledMotion
from .effect_columns import EffectColumns, SymbolicEffect
from .task_variance import PRIOR_STD

INDEPENDENT_RATE = 40.0
"""Independent torque samples per second [Hz]: twice the 20 Hz band in which torque is compared."""
RELATIVE_RANK = 1e-10
"""Eigenvalue of a Gram matrix over the largest one, below which a column adds nothing [1]."""
COEFFICIENT_STD = 10.0
"""Prior standard deviation of the coefficients of an effect over the largest that is expected [1]:
so wide that it counts where the motion shows nothing of a coefficient."""
ABSENT_SHARE = 1e-6
"""Size of a coefficient that is not expected, over the largest of the same effect [1]."""
EVIDENCE_SHARE = 0.2
"""Share of the expected evidence that counts [1], because real effects have not exactly the form of
their columns: the reciprocal of the temperature T′ of a diagnosis."""
STOPPING_GAIN = 5e-3
"""Decrease of the objective over ten iterations below which the search ends; the objective is about
the logarithm of a separation."""
INDISTINGUISHABLE_SHARE = 1e-8
"""Share of its squared torque that an explanation keeps at most when a rival reproduces it, for
rounding [1]."""


@dataclass(frozen=True)
class Explanation:
    """An effect at a joint with its expected coefficients.

    Attributes:
        form: The effect with its nonlinear parameters.
        factor: L with E[c cᵀ] = L Lᵀ: one column where the coefficients are known, several where
            for example a phase is not; zero for the columns of its uncertain form. Shape (k, r).
        probability: Posterior probability that it is what acts there.
        nominal: True where the size is not that of the diagnosis but a usual one.
    """

    form: SymbolicEffect
    factor: FloatArray
    probability: float
    nominal: bool = False


@dataclass(frozen=True)
class Comparison:
    """A question that a recording should decide: is it this explanation, or the rival?

    Attributes:
        true: Index of the explanation whose torque acts.
        rival: Index of its rival; None for no effect at all.
        nuisance: Indices of effects that are fitted jointly in either case.
        weight: Weight by the probabilities of both; all weights sum to 1.
    """

    true: int
    rival: int | None
    nuisance: tuple[int, ...]
    weight: float


@dataclass(frozen=True)
class WeightedRows:
    """Rows of base regressor and effect columns, each over the noise.

    Attributes:
        base: Γ in scaled coordinates. Shape (m, p).
        columns: C. Shape (m, K).
    """

    base: FloatArray
    columns: FloatArray

    def stacked(self, other: WeightedRows) -> WeightedRows:
        """Return the rows of two recordings, one below the other."""
        return WeightedRows(
            np.vstack([self.base, other.base]), np.vstack([self.columns, other.columns])
        )

    def compressed(self) -> WeightedRows:
        """Return the fewest rows with the same inner products of all columns."""
        p = self.base.shape[1]
        fewest = triangle(np.hstack([self.base, self.columns]))
        return WeightedRows(fewest[:, :p], fewest[:, p:])


@dataclass(frozen=True)
class BaseProjection:
    """Effect columns projected off the base regressor, by the normal equations.

    Residuals are computed from the rows themselves, so that their squares are exact to second order
    in the rounding error of the coefficients.

    Attributes:
        coefficients: Γ⁺C. Shape (p, K).
        gram: Cᵀ(1 − ΓΓ⁺)C. Shape (K, K).
    """

    coefficients: FloatArray
    gram: FloatArray

    @classmethod
    def of(cls, rows: WeightedRows) -> BaseProjection:
        """Project the columns of rows whose base has full column rank."""
        information, cross = rows.base.T @ rows.base, rows.base.T @ rows.columns
        scale = 1.0 / np.sqrt(np.diag(information))
        triangle = np.linalg.cholesky(information * scale[:, None] * scale)
        half = np.linalg.solve(triangle, scale[:, None] * cross)
        coefficients = scale[:, None] * np.linalg.solve(triangle.T, half)
        return cls(coefficients, rows.columns.T @ rows.columns - half.T @ half)


@dataclass(frozen=True)
class Separations:
    """Separations of all comparisons with what their gradient needs.

    Attributes:
        values: T of each comparison. Shape (c,).
        coefficients: u of each comparison and column of its factor. Shape (K, t).
        base_coefficients: θ likewise. Shape (p, t).
        residuals: r likewise. Shape (m, t).
        owner: Comparison that each of the t solutions belongs to. Shape (t,).
    """

    values: FloatArray
    coefficients: FloatArray
    base_coefficients: FloatArray
    residuals: FloatArray
    owner: FloatArray


def _independent_solution(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a positive semidefinite system in the directions that hold information."""
    if not len(gram):
        return np.zeros((0, right.shape[1]))
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / scale[:, None] / scale)
    kept = values > RELATIVE_RANK * values[-1]
    basis = vectors[:, kept] / scale[:, None]
    return np.asarray(basis @ ((basis.T @ right) / values[kept, None]))


def separations(
    rows: WeightedRows,
    slices: Sequence[slice],
    explanations: Sequence[Explanation],
    comparisons: Sequence[Comparison],
) -> Separations:
    """Compute the separation of every comparison.

    Args:
        rows: Rows of one or more recordings; the base must have full column rank.
        slices: Columns of each explanation.
        explanations: The explanations.
        comparisons: The comparisons.
    """
    projection = BaseProjection.of(rows)
    gram = projection.gram
    values, solutions, owner = np.zeros(len(comparisons)), [], []
    for index, comparison in enumerate(comparisons):
        place = slices[comparison.true]
        factor = explanations[comparison.true].factor
        rivals = [*comparison.nuisance, *([] if comparison.rival is None else [comparison.rival])]
        others = np.concatenate(
            [np.arange(slices[k].start, slices[k].stop) for k in rivals] or [np.zeros(0, int)]
        )
        cross = gram[np.ix_(others, np.arange(place.start, place.stop))] @ factor
        u = np.zeros((len(gram), factor.shape[1]))
        u[place] = factor
        u[others] -= _independent_solution(gram[np.ix_(others, others)], cross)
        solutions.append(u)
        owner += [index] * factor.shape[1]
    u = np.hstack(solutions) if solutions else np.zeros((len(gram), 0))
    theta = projection.coefficients @ u
    residuals = rows.columns @ u - rows.base @ theta
    np.add.at(values, owner, np.sum(residuals**2, axis=0))
    return Separations(values, u, theta, residuals, np.array(owner, int))


@dataclass(frozen=True)
class RunSettings:
    """How a periodic motion is recorded.

    Attributes:
        coordinates: W, coordinates of the base parameters. Shape (P, p).
        noise: Standard deviation of the torque. Shape (n,) [N m].
        periods: Number of periods.
        run_time: Run time of the robot when the recording starts [s].
    """

    coordinates: FloatArray
    noise: FloatArray
    periods: int
    run_time: float = 0.0


def prior_rows(settings: RunSettings, count: int, std: float = PRIOR_STD) -> WeightedRows:
    """Return the rows of the weak prior on the base parameters.

    Args:
        settings: Coordinates of the base parameters.
        count: Number K of effect columns.
        std: Prior standard deviation of the base parameters in the metric [1].
    """
    p = settings.coordinates.shape[1]
    return WeightedRows(np.eye(p) / std, np.zeros((p, count)))


def coefficient_rows(
    settings: RunSettings,
    effects: EffectColumns,
    explanations: Sequence[Explanation],
    std: float = PRIOR_STD,
) -> WeightedRows:
    """Return the rows of the priors on the coefficients of effects, and on their uncertain forms.

    Args:
        settings: Coordinates of the base parameters.
        effects: Columns of the explanations.
        explanations: The explanations.
        std: Factor on the prior standard deviation of the coefficients [1].
    """
    expected, largest = np.zeros(effects.count), np.zeros(effects.count)
    for place, explanation in zip(effects.slices, explanations, strict=True):
        sizes = np.linalg.norm(explanation.factor, axis=1)
        largest[place] = max(float(sizes.max(initial=0.0)), 1e-300)
        expected[place] = np.maximum(sizes, ABSENT_SHARE * largest[place])
    is_form = effects.parents >= 0
    size = np.where(is_form, expected[effects.parents], std * COEFFICIENT_STD * largest)
    return WeightedRows(np.zeros((len(size), settings.coordinates.shape[1])), np.diag(1.0 / size))


@dataclass(frozen=True)
class RunRows:
    """Rows of a periodic motion with what their gradient needs.

    Attributes:
        rows: Rows of the motion, period by period where a column depends on the run time.
        scale: Weight of the rows of each joint. Shape (n,).
        factors: Factors of the run time on the columns, None without. Shape (periods, N, K).
    """

    rows: WeightedRows
    scale: FloatArray
    factors: FloatArray | None


def run_rows(
    motion: SampledMotion, columns: FloatArray, effects: EffectColumns, settings: RunSettings
) -> RunRows:
    """Return the rows of a periodic motion.

    Args:
        motion: One period at N samples.
        columns: Columns of the effects along it. Shape (N, n, K).
        effects: The effects.
        settings: How it is recorded.
    """
    samples, n = motion.q.shape
    times = np.arange(settings.periods * samples).reshape(settings.periods, samples)
    factors = effects.time_factors(settings.run_time + times * motion.period / samples)
    repeats = 1 if factors is None else settings.periods
    independent = settings.periods * motion.period * INDEPENDENT_RATE
    scale = np.sqrt(independent / (samples * repeats)) / settings.noise
    base = (motion.regressor * scale[:, None]).reshape(samples * n, -1) @ settings.coordinates
    scaled = columns * scale[:, None]
    if factors is None:
        return RunRows(WeightedRows(base, scaled.reshape(samples * n, -1)), scale, None)
    varied = (scaled * factors[:, :, None]).reshape(repeats * samples * n, -1)
    return RunRows(WeightedRows(np.tile(base, (repeats, 1)), varied), scale, factors)


@dataclass(frozen=True)
class SeparationObjective:
    """Objective: the expected share of wrong decisions, which the smallest separation dominates.

    The log-odds after the recording are distributed as N(T/2, T), so that the wrong explanation is
    favoured with probability Φ(−√T/2). With ε = Σ w_ab Φ(−√(s T_ab)/2),

        f = −log(−log ε) → −log min T_ab + const

    for large separations. A comparison that hardly any motion decides costs its weight, whatever
    the motion, and leaves the others alone; so does one that is decided already.

    Attributes:
        effects: Columns of all explanations.
        explanations: The explanations.
        comparisons: The comparisons that a motion can decide.
        settings: How the motion is recorded.
        undecidable: Comparisons that no motion decides, as the rival reproduces the torque.
        given: Rows of earlier recordings; None without.
    """

    effects: EffectColumns
    explanations: tuple[Explanation, ...]
    comparisons: tuple[Comparison, ...]
    settings: RunSettings
    undecidable: tuple[Comparison, ...] = ()
    stopping_gain: float = STOPPING_GAIN
    given: WeightedRows | None = None

    def known_rows(self, std: float = PRIOR_STD) -> WeightedRows:
        """Return the rows of the priors and of earlier recordings.

        Args:
            std: Prior standard deviation of the base parameters in the metric, and factor on that
                of the coefficients of effects [1].
        """
        prior = prior_rows(self.settings, self.effects.count, std).stacked(
            coefficient_rows(self.settings, self.effects, self.explanations, std)
        )
        return prior if self.given is None else prior.stacked(self.given)

    def rows(self, motion: SampledMotion) -> WeightedRows:
        """Return the rows of a recording of a motion, without the prior's."""
        values = self.effects.evaluate(motion)
        return run_rows(motion, values.columns, self.effects, self.settings).rows

    def separations(self, motion: SampledMotion) -> FloatArray:
        """Return the separation of every comparison after a recording of a motion. Shape (c,)."""
        rows = self.rows(motion).stacked(self.known_rows())
        return separations(rows, self.effects.slices, self.explanations, self.comparisons).values

    def statement(self, value: float) -> str:
        """Return a value of the objective in words.

        Args:
            value: The objective.
        """
        return f"expected share of wrong decisions: {np.exp(-np.exp(-value)):.2g}"

    def evaluate(self, motion: SampledMotion) -> ObjectiveGradient:
        """Evaluate the objective and its gradient."""
        values = self.effects.evaluate(motion)
        recorded = run_rows(motion, values.columns, self.effects, self.settings)
        m = len(recorded.rows.base)
        rows = recorded.rows.stacked(self.known_rows())
        result = separations(rows, self.effects.slices, self.explanations, self.comparisons)
        weights = np.array([c.weight for c in self.comparisons])
        values_of = np.maximum(result.values, 1e-12)
        z = -0.5 * np.sqrt(EVIDENCE_SHARE * values_of)
        terms = np.log(weights) + special.log_ndtr(z)
        log_error = float(special.logsumexp(terms))
        hazard = np.exp(-0.5 * z**2 - special.log_ndtr(z)) / np.sqrt(2.0 * np.pi)
        slopes = np.exp(terms - log_error) * hazard * 0.5 * z / values_of / -log_error
        objective = -float(np.log(-log_error))
        weighted = 2.0 * result.residuals[:m] * slopes[result.owner]
        by_columns, by_base = self._by_sample(
            motion, recorded, weighted @ result.coefficients.T, weighted, result.base_coefficients
        )
        by_regressor, by_motion = self.effects.gradients(values, by_columns)
        return ObjectiveGradient(objective, by_regressor + by_base, by_motion)

    def _by_sample(
        self,
        motion: SampledMotion,
        recorded: RunRows,
        by_columns: FloatArray,
        weighted: FloatArray,
        theta: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the gradients by the columns and by the regressor at each sample."""
        samples, n = motion.q.shape
        scale = recorded.scale[:, None]
        repeats = len(weighted) // (samples * n)
        per_period = by_columns.reshape(repeats, samples, n, -1)
        if recorded.factors is not None:
            per_period = per_period * recorded.factors[:, :, None]
        summed = weighted.reshape(repeats, samples, n, -1).sum(axis=0)
        by_base = -(summed @ (theta.T @ self.settings.coordinates.T)) * scale
        return per_period.sum(axis=0) * scale, by_base


def indistinguishable(values: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return which comparisons no motion decides, as the rival reproduces the torque. Shape (c,).

    Args:
        values: Separations along a motion that shows the explanations. Shape (c,).
        sizes: Squared torque of the explanations themselves. Shape (c,).
    """
    return np.asarray(values <= INDISTINGUISHABLE_SHARE * np.maximum(sizes, 1e-300))
