"""Normal equations of a regression some of whose coefficients cannot be negative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from .._types import BoolArray, FloatArray, IntArray

RIDGE = 1e-10
"""Share of the diagonal that is added to a matrix before it is factored."""
BLOCK_EXCHANGES = 3
"""Exchanges of all coefficients at once that may not lower the number of violated conditions."""
RELATIVE_TOLERANCE = 1e-10
"""Coefficient or gradient of either sign that counts as zero, over the largest."""


@dataclass(frozen=True)
class System:
    """Normal equations: the objective is ½ xᵀ A x − bᵀ x + ½ power.

    Attributes:
        matrix: A, shape (K, K).
        score: b, shape (K,).
        power: Twice the objective of x = 0.
    """

    matrix: FloatArray
    score: FloatArray
    power: float


@dataclass
class Solution:
    """A minimum of the objective.

    Attributes:
        coefficients: All coefficients, shape (K,); 0 where an effect is left out.
        active: Coefficients that are neither left out nor held at zero by their sign, shape (K,).
        objective: Negative log posterior up to a constant.
        information: Information matrix of all coefficients, shape (K, K).
        log_determinant: log det A over the active coefficients.
    """

    coefficients: FloatArray
    active: BoolArray
    objective: float
    information: FloatArray
    log_determinant: float
    _factor: tuple[FloatArray, FloatArray] | None = None

    def at(self, places: IntArray | slice) -> FloatArray:
        """Return the coefficients with all but those at some places zero, shape (K,)."""
        out = np.zeros_like(self.coefficients)
        out[places] = self.coefficients[places]
        return out

    def solve(self, x: FloatArray) -> FloatArray:
        """Return A⁻¹ x over the active coefficients, shape (active, k)."""
        if self._factor is None:
            on = np.flatnonzero(self.active)
            a = self.information[np.ix_(on, on)]
            scale = 1.0 / np.sqrt(np.diag(a))
            self._factor = _cholesky(a * scale[:, None] * scale, RIDGE), scale
        factor, scale = self._factor
        return scale[:, None] * _solved(factor, scale[:, None] * x)

    def covariance(self, first: IntArray, second: IntArray) -> FloatArray:
        """Return the block of A⁻¹ of some active coefficients and others, shape (k, l)."""
        on = np.flatnonzero(self.active)
        unit = np.zeros((len(on), len(second)))
        unit[np.searchsorted(on, second), np.arange(len(second))] = 1.0
        return np.asarray(self.solve(unit)[np.searchsorted(on, first)])


@dataclass(frozen=True)
class Elimination:
    """Normal equations of all other coefficients, those of the base model eliminated.

    The latter have either sign. Which effects are left out changes nothing here, so that one
    elimination serves all refits.

    With the Cholesky factor L of the base model's information, and W = L⁻¹ [A_bo, b_b], the others
    have the information A_oo − WᵀW.

    Attributes:
        scale: Units of all coefficients, in which A has a unit diagonal, shape (K,).
        base: Eliminated coefficients, shape (f,).
        others: The others, shape (m,).
        bounded: Those of the others that cannot be negative, shape (m,).
        factor: L, shape (f, f).
        half_solved: W, shape (f, m + 1).
        schur: Information of the others, shape (m, m).
        score: Their score, shape (m,).
    """

    scale: FloatArray
    base: IntArray
    others: IntArray
    bounded: BoolArray
    factor: FloatArray
    half_solved: FloatArray
    schur: FloatArray
    score: FloatArray

    @classmethod
    def of(
        cls, system: System, base: IntArray, kept: BoolArray, nonnegative: BoolArray
    ) -> Elimination:
        """Eliminate the coefficients `base` (f,) of the base model by a Schur complement.

        `kept` coefficients (K,) remain, of which the `nonnegative` ones (K,) cannot be negative.
        """
        others = np.flatnonzero(kept)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(system.matrix), 1e-300))
        a, b = system.matrix * scale[:, None] * scale, system.score * scale
        factor = _cholesky(a[np.ix_(base, base)], RIDGE)
        right = np.column_stack([a[np.ix_(base, others)], b[base]])
        half_solved = _half_solved(factor, right)
        product = half_solved.T @ half_solved
        schur = a[np.ix_(others, others)] - product[:-1, :-1]
        schur[np.diag_indices(len(others))] += RIDGE
        score = b[others] - product[:-1, -1]
        return cls(scale, base, others, nonnegative[others], factor, half_solved, schur, score)

    def minimum(self, system: System, used: BoolArray, likely: BoolArray) -> Solution:
        """Return the minimum over the used coefficients, shape (K,).

        `likely` ones (K,) are probably active, by a similar problem.
        """
        x, active = np.zeros(len(used)), used.copy()
        others = self.others
        x[others], active[others], log_determinant = _bounded_minimum(
            self.schur, self.score, used[others], self.bounded, likely[others]
        )
        right = self.half_solved[:, -1] - self.half_solved[:, :-1] @ x[others]
        x[self.base] = _half_solved(self.factor, right, transposed=True)
        x *= self.scale
        objective = 0.5 * (system.power + x @ system.matrix @ x) - system.score @ x
        log_determinant += _log_determinant(self.factor)
        log_determinant -= 2.0 * float(np.sum(np.log(self.scale[active])))
        return Solution(x, active, float(objective), system.matrix, log_determinant)


def _bounded_minimum(
    matrix: FloatArray,
    target: FloatArray,
    used: BoolArray,
    bounded: BoolArray,
    likely: BoolArray,
) -> tuple[FloatArray, BoolArray, float]:
    """Minimise ½ xᵀ M x − tᵀ x, x[bounded] ≥ 0, x[~used] = 0, by exchanges of the active set.

    From the active set `likely` of a similar problem a few exchanges of all coefficients that
    violate an optimality condition suffice (Portugal, Júdice & Vicente, Math. Comput. 63, 1994).
    These exchanges may cycle. The objective then falls from one active set to the next (Lawson &
    Hanson, Solving Least Squares Problems, 1974, but with all coefficients added at once: the step
    of one of them at least is positive). Returns x, its active coefficients, and log det M over
    these.
    """
    bounded = bounded & used
    tolerance = RELATIVE_TOLERANCE * float(np.abs(target[bounded]).max(initial=0.0))

    def minimum(active: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the unbounded minimum over active coefficients, and the factor of M over these."""
        p, x = np.flatnonzero(active), np.zeros(len(target))
        factor = _cholesky(matrix[np.ix_(p, p)])
        x[p] = _solved(factor, target[p])
        return x, factor

    def negative(x: FloatArray, active: BoolArray) -> BoolArray:
        """Return the active coefficients that violate their bound."""
        least = -RELATIVE_TOLERANCE * np.abs(x[bounded]).max(initial=0.0)
        return np.asarray(bounded & active & (x < least))

    def missing(x: FloatArray, active: BoolArray) -> BoolArray:
        """Return the coefficients at zero that would lower the objective."""
        return np.asarray(bounded & ~active & (matrix @ x - target < -tolerance))

    active, fewest, tries = used & (likely | ~bounded), len(target) + 1, BLOCK_EXCHANGES
    x, factor = minimum(active)
    while (wrong := negative(x, active) | missing(x, active)).any() and tries > 0:
        count = int(np.count_nonzero(wrong))
        tries = BLOCK_EXCHANGES if count < fewest else tries - 1
        fewest = min(fewest, count)
        active = active ^ wrong
        x, factor = minimum(active)
    while (below := negative(x, active)).any():  # until all coefficients are feasible
        active = active & ~below
        x, factor = minimum(active)
    x[bounded] = np.maximum(x[bounded], 0.0)
    objective = np.inf
    while (added := missing(x, active)).any():
        value = float(x @ (0.5 * matrix @ x - target))
        if value >= objective:  # by rounding errors
            break
        objective, active = value, active | added
        end, factor = minimum(active)
        while (below := negative(end, active)).any():
            shares = x[below] / (x[below] - end[below])
            x = x + shares.min() * (end - x)
            active = active.copy()
            active[np.flatnonzero(below)[shares == shares.min()]] = False
            x[~active] = 0.0
            end, factor = minimum(active)
        x = np.where(bounded, np.maximum(end, 0.0), end)
    return x, active, _log_determinant(factor)


def _cholesky(matrix: FloatArray, ridge: float = 0.0) -> FloatArray:
    """Cholesky factor of a matrix with a share of the unit matrix added, in its lower triangle."""
    if not len(matrix):
        return matrix
    regular = matrix.T.copy(order="F")
    regular[np.diag_indices(len(matrix))] += ridge
    # without the checks of scipy.linalg, which take longer than small matrices
    factor, failed = lapack.dpotrf(regular, lower=1, clean=0, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("matrix is not positive definite")
    return np.asarray(factor)


def _solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of the equations of a matrix with a Cholesky factor."""
    return np.asarray(lapack.dpotrs(factor, right, lower=1)[0]) if right.size else right


def _half_solved(factor: FloatArray, right: FloatArray, transposed: bool = False) -> FloatArray:
    """Solution of the equations of a Cholesky factor, or of its transpose."""
    if not right.size:
        return right
    return np.asarray(lapack.dtrtrs(factor, right, lower=1, trans=int(transposed))[0])


def _log_determinant(factor: FloatArray) -> float:
    """Log determinant of the matrix with a Cholesky factor."""
    return float(2.0 * np.sum(np.log(np.diag(factor))))
