"""Linear regression of torque on the base model and effects of all joints, with sign constraints.

    τ = Γ θ + Σ C_e c_e + ε,   θ ~ N(θ₀, Σ₀),   c_e ~ N(0, Λ_e⁻¹),   c_e ≥ 0 where physics says so

The rows of joint j are weighted by ρ/σ_j², with σ_j the RMS residual and ρ the share of independent
rows in an autocorrelated residual. The weighted objective J is a quadratic form of the
coefficients, so that only Gram matrices are kept: one for each joint, to which columns are appended
and which are weighted anew without another pass over the rows. The unconstrained coefficients are
eliminated by a Schur complement (`normal_equations`).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg

from .._types import BoolArray, FloatArray, IntArray
from ..identification.autocorrelation import correlation_length
from .normal_equations import RIDGE, Elimination, Solution, System

MIN_REMAINING = 1e-6
"""Share of a squared error that is not told from rounding."""
FIXED_STD = 1e-12
"""Prior standard deviation of a coefficient that is held at zero."""
_Products = tuple[FloatArray, FloatArray, float]
"""XᵀX, Xᵀτ and τᵀτ of the columns X of one joint, without weights."""


@dataclass(frozen=True)
class Columns:
    """Torque columns of one effect on the joints that they affect.

    Attributes:
        joints: Indices of these joints, shape (J,).
        values: Torque per unit of each coefficient, one array of shape (N, k) for each joint.
        nonnegative: Coefficients that physics requires to be ≥ 0, shape (k,).
        prior_std: Prior standard deviation of each coefficient, shape (k,).
    """

    joints: tuple[int, ...]
    values: tuple[FloatArray, ...]
    nonnegative: BoolArray
    prior_std: FloatArray

    @property
    def count(self) -> int:
        """Number of columns k."""
        return len(self.nonnegative)

    def after(self, first: int) -> Columns:
        """Return the columns from number `first` on."""
        values = tuple(x[:, first:] for x in self.values)
        return Columns(self.joints, values, self.nonnegative[first:], self.prior_std[first:])


@dataclass(frozen=True)
class CandidateFit:
    """Coefficients of additional columns.

    Attributes:
        coefficients: Shape (k,).
        gain: Decrease of the objective, a log-likelihood by the weights of the regression.
        log_occam_factor: Logarithm of the prior volume over what the data leave of it.
        log_gain: Gain of log-likelihood with the variance that remains at each joint, less the cost
            of the prior; None if it was not computed.
    """

    coefficients: FloatArray
    gain: float
    log_occam_factor: float
    log_gain: float | None = None

    @classmethod
    def of_all(
        cls, score: FloatArray, information: FloatArray, prior: FloatArray
    ) -> list[CandidateFit]:
        """Return the minima of ½ cᵀ A c − sᵀ c of C candidates with k coefficients each.

        With coefficients in units of their prior standard deviations the information has no
        eigenvalue below 1, whatever the units of the columns; one that is lower has rounding errors
        of the elimination.

        Args:
            score: Scores s, shape (C, k).
            information: Information A after elimination of all other coefficients, that of the
                prior included, shape (C, k, k).
            prior: Prior precision of each, shape (C, k).
        """
        std = prior**-0.5
        scaled = std[:, :, None] * information * std[:, None, :]
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.swapaxes(1, 2)))
        values = np.maximum(values, 1.0)
        along = np.einsum("ckv,ck->cv", vectors, std * score)
        coefficients = std * np.einsum("ckv,cv->ck", vectors, along / values)
        gains = 0.5 * np.sum(along**2 / values, axis=1)
        factors = 0.5 * np.sum(np.log(values), axis=1)
        return [
            cls(c, gain, factor)
            for c, gain, factor in zip(coefficients, gains.tolist(), factors.tolist(), strict=True)
        ]


@dataclass(frozen=True)
class CandidateBatch:
    """Columns of many candidates over the same rows.

    Attributes:
        parts: Columns of each candidate among the S columns of all.
        prior: Prior precision of the coefficient of each column, shape (S,).
        values: Columns that act on each joint, rows at standstill zero, shapes (N, S_j).
        places: Places of these columns among all, shapes (S_j,).
        squares: Products of the columns of each candidate over the rows of each joint, without
            weights, shapes (n, k, k).
    """

    parts: tuple[slice, ...]
    prior: FloatArray
    values: tuple[FloatArray, ...]
    places: tuple[IntArray, ...]
    squares: tuple[FloatArray, ...]

    @property
    def of_same_size(self) -> list[list[int]]:
        """Numbers of the candidates that have equally many columns."""
        members: dict[int, list[int]] = {}
        for i, part in enumerate(self.parts):
            members.setdefault(part.stop - part.start, []).append(i)
        return list(members.values())

    @classmethod
    def of(cls, candidates: Sequence[Columns], moving: BoolArray) -> CandidateBatch:
        """Return the batch of columns of some candidates; `moving` rows (N, n) count."""
        ends = np.cumsum([0, *(c.count for c in candidates)]).tolist()
        parts = tuple(slice(first, last) for first, last in itertools.pairwise(ends))
        squares = tuple(np.zeros((moving.shape[1], c.count, c.count)) for c in candidates)
        values, places = [], []
        for j, rows in enumerate(moving.T):
            acting = [i for i, c in enumerate(candidates) if j in c.joints]
            of_joint = [candidates[i].values[candidates[i].joints.index(j)] for i in acting]
            values.append(np.hstack([np.zeros((len(rows), 0)), *of_joint]))
            values[-1] *= rows[:, None]
            places.append(np.concatenate([np.arange(0), *(np.r_[parts[i]] for i in acting)]))
            first = 0
            for i in acting:
                part = values[-1][:, first : first + candidates[i].count]
                squares[i][j] = part.T @ part
                first += candidates[i].count
        prior = np.concatenate([c.prior_std**-2.0 for c in candidates])
        return cls(parts, prior, tuple(values), tuple(places), squares)


@dataclass
class _JointGram:
    """Products of all columns that act on one joint, over its rows in motion.

    Attributes:
        columns: The columns X, shape (N, k); rows at standstill are zero.
        places: Place of each column among all coefficients, shape (k,).
        matrix: XᵀX.
        score: Xᵀτ.
        power: τᵀτ.
    """

    columns: FloatArray
    places: IntArray
    matrix: FloatArray
    score: FloatArray
    power: float

    def appended(self, values: FloatArray, places: IntArray, torque: FloatArray) -> _JointGram:
        """Return the products with further columns (rows at standstill zero)."""
        cross = self.columns.T @ values
        matrix = np.block([[self.matrix, cross], [cross.T, values.T @ values]])
        return _JointGram(
            np.hstack([self.columns, values]),
            np.concatenate([self.places, places]),
            matrix,
            np.concatenate([self.score, values.T @ torque]),
            self.power,
        )

    def keeping(self, place: IntArray) -> _JointGram:
        """Return the products of the columns that have a new place, −1 for none, shape (K,)."""
        on = place[self.places] >= 0
        matrix, score = self.matrix[np.ix_(on, on)], self.score[on]
        return _JointGram(self.columns[:, on], place[self.places[on]], matrix, score, self.power)


@dataclass
class JointRegression:
    """The regression of all joints.

    Attributes:
        torque: Measured torque τ, shape (N, n) [N m].
        moving: Rows that count for each joint, shape (N, n).
        base_count: Number of coefficients of the base model, which come first.
        sigma: RMS residual of each joint, shape (n,) [N m].
        independent_share: Share ρ of independent rows.
        slices: Coefficients of each effect, in the order in which they were added.
        prior_matrix: Prior information of all coefficients, shape (K, K).
        nonnegative: Coefficients that cannot be negative, shape (K,).
        built_up: Numbers of effects that are used with another one alone, and of that one; and of
            the effect that stands in where they are not used. Either may be None.
    """

    torque: FloatArray
    moving: BoolArray
    base_count: int
    sigma: FloatArray
    independent_share: float
    slices: list[slice] = field(default_factory=list)
    prior_matrix: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    nonnegative: BoolArray = field(default_factory=lambda: np.zeros(0, bool))
    built_up: Mapping[int, tuple[int | None, int | None]] = field(default_factory=dict)
    _grams: list[_JointGram] = field(default_factory=list)
    _prior_score: FloatArray = field(default_factory=lambda: np.zeros(0))
    _prior_power: float = 0.0
    _likely: BoolArray = field(default_factory=lambda: np.zeros(0, bool))
    _system: System | None = None
    _eliminations: dict[bytes, Elimination] = field(default_factory=dict)
    _solutions: dict[bytes, Solution] = field(default_factory=dict)
    _fold_products: dict[bytes, list[_Products]] = field(default_factory=dict)

    @classmethod
    def of_base(
        cls,
        torque: FloatArray,
        moving: BoolArray,
        base: FloatArray,
        prior: tuple[FloatArray, FloatArray],
        sigma: FloatArray,
        independent_share: float,
        nonnegative: BoolArray | None = None,
    ) -> JointRegression:
        """Return the regression on the base model alone.

        Args:
            torque: Measured torque, shape (N, n) [N m].
            moving: Rows that count for each joint, shape (N, n).
            base: Columns of the base model, shape (N, n, p).
            prior: Mean, shape (p,), and information matrix, shape (p, p), of its parameters.
            sigma: RMS residual of each joint, shape (n,) [N m].
            independent_share: Share of independent rows.
            nonnegative: Parameters that cannot be negative, shape (p,); none if None.
        """
        p = base.shape[2]
        mean, information = prior
        out = cls(torque, moving, p, sigma, independent_share)
        out.prior_matrix, out._prior_score = information.copy(), information @ mean
        out._prior_power = float(mean @ information @ mean)
        out.nonnegative = np.zeros(p, bool) if nonnegative is None else nonnegative
        out._likely = np.ones(p, bool)
        for j in range(torque.shape[1]):
            of_joint = np.ascontiguousarray(base[:, j])
            used = np.flatnonzero(of_joint.any(axis=0))
            x = of_joint[:, used] * moving[:, j, None]
            power = float(np.sum(torque[moving[:, j], j] ** 2))
            out._grams.append(_JointGram(x, used, x.T @ x, x.T @ torque[:, j], power))
        return out

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.torque.shape[1])

    @property
    def weights(self) -> FloatArray:
        """Weight ρ/σ² of the rows of each joint, shape (n,)."""
        return self.independent_share / self.sigma**2

    def copy(self) -> JointRegression:
        """Return a regression to which columns and priors can be added without changing this."""
        return replace(
            self,
            slices=list(self.slices),
            prior_matrix=self.prior_matrix.copy(),
            _grams=list(self._grams),
            _prior_score=self._prior_score.copy(),
            _eliminations={},
            _solutions={},
            _fold_products={},
        )

    def keeping(self, effects: Sequence[int]) -> JointRegression:
        """Return a regression with some of the effects, in rising order, and the same rows."""
        kept = np.concatenate(
            [np.arange(self.base_count)]
            + [np.arange(self.slices[e].start, self.slices[e].stop) for e in effects]
        )
        place = np.full(len(self.nonnegative), -1)
        place[kept] = np.arange(len(kept))
        first = [int(place[self.slices[e].start]) for e in effects]
        return replace(
            self.copy(),
            slices=[
                slice(start, start + self.slices[e].stop - self.slices[e].start)
                for e, start in zip(effects, first, strict=True)
            ],
            prior_matrix=self.prior_matrix[np.ix_(kept, kept)],
            nonnegative=self.nonnegative[kept],
            built_up={},
            _grams=[gram.keeping(place) for gram in self._grams],
            _prior_score=self._prior_score[kept],
            _likely=self._likely[kept],
            _system=None,
        )

    def fix_at_zero(self, places: Sequence[int]) -> None:
        """Hold some coefficients at zero, by a prior without uncertainty."""
        for place in places:
            self.prior_matrix[place, place] = 1.0 / FIXED_STD**2
        self._changed()

    def reduce_prior(self, probabilities: Sequence[float]) -> None:
        """Make the prior of every effect that of one that is there with some probability P.

        A coefficient that is zero with probability 1 − P, and normally distributed about zero with
        variance v otherwise, has the variance P v.
        """
        for part, probability in zip(self.slices, probabilities, strict=True):
            self.prior_matrix[part, part] /= probability
        self._changed()

    def add(self, *effects: Columns) -> range:
        """Append the columns of some effects; return their numbers."""
        start = len(self.nonnegative)
        for columns in effects:
            stop = start + columns.count
            self.slices.append(slice(start, stop))
            start = stop
        parts = self.slices[len(self.slices) - len(effects) :]
        for j, gram in enumerate(self._grams):
            acting = [(c, part) for c, part in zip(effects, parts, strict=True) if j in c.joints]
            if acting:
                values = np.hstack([c.values[c.joints.index(j)] for c, _ in acting])
                places = np.concatenate([np.arange(p.start, p.stop) for _, p in acting])
                self._grams[j] = gram.appended(
                    values * self.moving[:, j, None], places, self.torque[:, j]
                )
        count = start - len(self.nonnegative)
        self.nonnegative = np.concatenate([self.nonnegative, *(c.nonnegative for c in effects)])
        precision = [np.diag(c.prior_std**-2.0) for c in effects]
        self.prior_matrix = linalg.block_diag(self.prior_matrix, *precision)
        self._prior_score = np.concatenate([self._prior_score, np.zeros(count)])
        self._likely = np.concatenate([self._likely, np.ones(count, bool)])
        self._fold_products.clear()
        self._changed()
        return range(len(self.slices) - len(effects), len(self.slices))

    def reweighted(self, sigma: FloatArray, independent_share: float) -> None:
        """Replace the weights of the rows."""
        self.sigma, self.independent_share = sigma, independent_share
        self._changed()

    @property
    def solution(self) -> Solution:
        """The minimum of the objective."""
        return self.without(())

    def without(self, effects: Iterable[int], unused: Sequence[int] = ()) -> Solution:
        """Return the minimum of the objective without effects of some numbers, the others refitted.

        `unused` are further coefficients that are left out.
        """
        used = self._used(effects)
        used[list(unused)] = False
        return self._solve(used)

    def _used(self, left_out: Iterable[int]) -> BoolArray:
        """Coefficients that are used without some effects, shape (K,)."""
        absent = set(left_out)
        for effect, (other, stand_in) in self.built_up.items():
            if other is None or other in absent:
                absent.add(effect)
            if effect not in absent and stand_in is not None:
                absent.add(stand_in)
        used = np.ones(len(self.nonnegative), bool)
        for e in absent:
            used[self.slices[e]] = False
        return used

    def log_evidence(self, solution: Solution) -> float:
        """Return the log evidence of a solution, up to a constant of the regression.

        In the Laplace approximation, over the coefficients that are not held at zero by their sign.
        """
        active = solution.active.copy()
        # what has either sign in the base model is there in every model
        active[: self.base_count] &= self.nonnegative[: self.base_count]
        precision = np.diag(self.prior_matrix)[active]
        halves = float(np.log(2.0) * np.count_nonzero(active & self.nonnegative))
        return (
            -solution.objective
            - 0.5 * solution.log_determinant
            + 0.5 * float(np.sum(np.log(precision)))
            + halves
        )

    def _assembled(self) -> System:
        """Normal equations of the weighted rows and the priors."""
        if self._system is None:
            self._system = self._system_of([self._whole()])
        return self._system

    def _whole(self) -> list[_Products]:
        """Products of all rows, for each joint."""
        return [(gram.matrix, gram.score, gram.power) for gram in self._grams]

    def _products(self, rows: BoolArray) -> list[_Products]:
        """Products XᵀX, Xᵀτ and τᵀτ of some rows, for each joint; formed once for all weights."""
        key = rows.tobytes()
        if key not in self._fold_products:
            out = []
            for j, gram in enumerate(self._grams):
                x = gram.columns[rows]
                tau = np.where(self.moving[rows, j], self.torque[rows, j], 0.0)
                out.append((x.T @ x, x.T @ tau, float(tau @ tau)))
            self._fold_products[key] = out
        return self._fold_products[key]

    def _with_fitted(
        self, joint: int, products: _Products, fitted: slice, information: FloatArray
    ) -> _Products:
        """Products of a joint's rows to which some coefficients are always fitted.

        The squared error of the others is then the minimum over those, with their prior.
        """
        places, (matrix, score, power) = self._grams[joint].places, products
        on = (places >= fitted.start) & (places < fitted.stop)
        prior = information[places[on] - fitted.start] / self.weights[joint]
        right = np.column_stack([matrix[on], score[on]])
        follow = np.linalg.solve(matrix[np.ix_(on, on)] + np.diag(prior), right)
        return (
            matrix - matrix[:, on] @ follow[:, :-1],
            score - matrix[:, on] @ follow[:, -1],
            power - float(score[on] @ follow[:, -1]),
        )

    def _system_of(
        self,
        parts: Sequence[Sequence[_Products]],
        prior: tuple[FloatArray, FloatArray] | None = None,
    ) -> System:
        """Normal equations of the weighted rows of some parts and of the priors, or other ones."""
        matrix, score = (x.copy() for x in prior or (self.prior_matrix, self._prior_score))
        power = self._prior_power
        for part in parts:
            for gram, products, weight in zip(
                self._grams, part, self.weights.tolist(), strict=True
            ):
                matrix[np.ix_(gram.places, gram.places)] += weight * products[0]
                score[gram.places] += weight * products[1]
                power += weight * products[2]
        return System(matrix, score, power)

    def _changed(self) -> None:
        """Forget all that was computed with other columns, weights or priors."""
        self._system = None
        self._eliminations.clear()
        self._solutions.clear()

    def _solve(self, used: BoolArray) -> Solution:
        """Minimum of the objective over the used coefficients, with the present weights."""
        key = used.tobytes()
        if key not in self._solutions:
            system, base = self._assembled(), used[: self.base_count].tobytes()
            if base not in self._eliminations:
                self._eliminations[base] = self._elimination_of(system, used)
            likely = self._likely
            if self._solutions:  # that of the most similar problem
                masks = np.array([np.frombuffer(k, bool) for k in self._solutions])
                nearest = int(np.argmin(np.count_nonzero(masks != used, axis=1)))
                near = list(self._solutions.values())[nearest].active
                likely = np.where(masks[nearest], near, likely)
            solution = self._eliminations[base].minimum(system, used, likely)
            self._likely = np.where(used, solution.active, self._likely)
            self._solutions[key] = solution
        return self._solutions[key]

    def _elimination_of(self, system: System, used: BoolArray) -> Elimination:
        """Normal equations without the used coefficients of the base model of either sign."""
        free = ~self.nonnegative
        free[self.base_count :] = False
        return Elimination.of(system, np.flatnonzero(used & free), ~free, self.nonnegative)

    def data_information(self, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the data say of the first `count` coefficients, all others eliminated.

        Their own prior is left out from the start: a difference of information matrices would leave
        the rounding errors of a strong prior.

        Returns:
            Their information, shape (p, p); their score, shape (p,); and how the other active
            coefficients follow them, shape (a − p, p).
        """
        prior = self.prior_matrix.copy()
        prior[:count, :count] = 0.0
        system = self._system_of([self._whole()], (prior, np.zeros(len(prior))))
        others = np.flatnonzero(self.solution.active[count:]) + count
        scale = 1.0 / np.sqrt(np.diag(system.matrix)[others])
        block = system.matrix[np.ix_(others, others)] * scale[:, None] * scale
        cross = scale[:, None] * np.column_stack(
            [system.matrix[others, :count], system.score[others]]
        )
        half = np.linalg.solve(block + RIDGE * np.eye(len(others)), cross)
        reduced = cross[:, :count].T @ half
        information = system.matrix[:count, :count] - reduced[:, :count]
        score = system.score[:count] - reduced[:, count]
        return 0.5 * (information + information.T), score, -scale[:, None] * half[:, :count]

    def cross_validated(
        self,
        folds: Sequence[BoolArray],
        variants: Sequence[Collection[int]],
        unused: BoolArray,
        per_fold: slice,
        change: FloatArray | None = None,
        judged: BoolArray | None = None,
    ) -> FloatArray:
        """Return squared errors on rows that the coefficients were not fitted to.

        Args:
            folds: Rows of each fold, shape (N,).
            variants: Effects that are left out, by variant of the model.
            unused: Coefficients that say nothing about other rows, shape (K,).
            per_fold: Those of them that differ from fold to fold, which are fitted to the errors
                of each, with their prior.
            change: Factor on the information of this prior in each fold, shape (folds, k); 1 if
                None.
            judged: Rows whose errors count, shape (N,); all if None.

        Returns:
            Sum over the rows of each fold [(N m)²], shape (folds, variants, n).
        """
        used = [self._used(left_out) & ~unused for left_out in variants]
        out = np.zeros((len(folds), len(variants), self.n))
        parts = [self._products(fold) for fold in folds]
        held_out = parts if judged is None else [self._products(fold & judged) for fold in folds]
        information = np.diag(self.prior_matrix)[per_fold] * np.ones((len(folds), 1))
        if change is not None:
            information = information * change
        for k, (errors, products, prior) in enumerate(zip(out, held_out, information, strict=True)):
            # a sum over the other folds: a difference would leave the rounding errors of the whole
            system = self._system_of([*parts[:k], *parts[k + 1 :]])
            elimination = self._elimination_of(system, ~unused)
            reduced = [self._with_fitted(j, p, per_fold, prior) for j, p in enumerate(products)]
            for v, mask in enumerate(used):
                c = elimination.minimum(system, mask, self.solution.active).coefficients
                for j, (gram, (matrix, score, power)) in enumerate(
                    zip(self._grams, reduced, strict=True)
                ):
                    x = c[gram.places]
                    errors[v, j] = max(power - float(x @ (2.0 * score - matrix @ x)), 0.0)
        return out

    def residual(self, solution: Solution | None = None) -> FloatArray:
        """Return the torque residual, shape (N, n) [N m]; rows at standstill have the torque."""
        return self.torque - self.torque_along((solution or self.solution).coefficients)

    def residual_of(self, joint: int) -> FloatArray:
        """Return the torque residual of one joint, shape (N,) [N m]."""
        gram = self._grams[joint]
        fitted = gram.columns @ self.solution.coefficients[gram.places]
        return np.asarray(self.torque[:, joint] - fitted)

    def residual_rms(self, solution: Solution) -> FloatArray:
        """Return the RMS residual of each joint over its rows in motion, shape (n,) [N m]."""
        x = solution.coefficients
        square = [
            g.power - x[g.places] @ (2.0 * g.score - g.matrix @ x[g.places]) for g in self._grams
        ]
        rows = np.maximum(self.moving.sum(axis=0), 1)
        return np.asarray(np.sqrt(np.maximum(square, 0.0) / rows))

    def active_columns(self, joint: int) -> tuple[FloatArray, IntArray]:
        """Return the columns (N, k) of the active coefficients that act on a joint.

        And their positions among the active coefficients, shape (k,).
        """
        acting, positions = self._acting(self._grams[joint], self.solution)
        return self._grams[joint].columns[:, acting], positions

    def fitted_per_joint(self) -> FloatArray:
        """Return the number of coefficients that are fitted to the rows of each joint, shape (n,).

        A coefficient that acts on several joints counts as a part in each. One that the data do not
        determine counts little: by 1 − Λ/A, with its prior precision Λ and total information A.
        """
        solution = self.solution
        total = np.maximum(np.diag(solution.information), 1e-300)
        weight = np.where(solution.active, 1.0 - np.diag(self.prior_matrix) / total, 0.0)
        joints = np.zeros(len(weight))
        for gram in self._grams:
            joints[gram.places] += 1.0
        weight = np.clip(weight, 0.0, 1.0) / np.maximum(joints, 1.0)
        return np.array([float(weight[gram.places].sum()) for gram in self._grams])

    def torque_along(self, coefficients: FloatArray) -> FloatArray:
        """Return the torque of given coefficients, shape (N, n) [N m]; zero at standstill."""
        return np.column_stack([g.columns @ coefficients[g.places] for g in self._grams])

    def sensitivity(self, column: Columns, solution: Solution) -> tuple[FloatArray, float]:
        """Return how the active coefficients follow one more column, and its information.

        That is their change per unit of the column's coefficient, shape (a,), and the information
        of that coefficient after their elimination.
        """
        batch = CandidateBatch.of([column], self.moving)
        cross, _, _ = self._coupling(batch, solution)
        change = -solution.solve(cross)
        square = self.weights @ batch.squares[0][:, 0, 0]
        return change[:, 0], float(square + (cross.T @ change)[0, 0])

    def joints_of(self, effects: Iterable[int]) -> set[int]:
        """Return the joints on which some effects act."""
        parts = [self.slices[effect] for effect in effects]
        return {
            j
            for j, g in enumerate(self._grams)
            if any(np.any((g.places >= p.start) & (g.places < p.stop)) for p in parts)
        }

    def candidate(self, columns: Columns) -> CandidateFit:
        """Fit further columns jointly with the active coefficients, without sign constraints."""
        return self.candidates(CandidateBatch.of([columns], self.moving))[0]

    def candidates(self, batch: CandidateBatch, log_gains: bool = False) -> list[CandidateFit]:
        """Fit each of many candidates jointly with the active coefficients.

        They have no sign constraints. All products with the columns of the model are formed at
        once. By the weights of the regression, what explains nearly all torque is hardly better
        than what explains most. With the variance that remains at each joint the gain is
        Σ_j ½ ρ N_j ln(E_j/E_j'), E and E' the squared errors without and with the candidate.

        Args:
            batch: Columns of the candidates.
            log_gains: Whether to compute these gains as well.
        """
        solution = self.solution
        cross, score, shared = self._coupling(batch, solution)
        change = solution.solve(cross)
        fits: dict[int, CandidateFit] = {}
        for members in batch.of_same_size:
            places = np.array([np.r_[batch.parts[i]] for i in members])
            squares = np.tensordot(
                self.weights, np.stack([batch.squares[i] for i in members], 1), 1
            )
            prior = batch.prior[places]
            explained = cross[:, places].transpose(1, 2, 0) @ change[:, places].transpose(1, 0, 2)
            schur = squares + prior[:, :, None] * np.eye(places.shape[1]) - explained
            fits.update(zip(members, CandidateFit.of_all(score[places], schur, prior), strict=True))
        out = [fits[i] for i in range(len(batch.parts))]
        if not log_gains:
            return out
        gains = self._log_gains(batch, shared, change, [fit.coefficients for fit in out])
        return [replace(fit, log_gain=gain) for fit, gain in zip(out, gains.tolist(), strict=True)]

    def _log_gains(
        self,
        batch: CandidateBatch,
        shared: Sequence[tuple[FloatArray, FloatArray]],
        change: FloatArray,
        fitted: Sequence[FloatArray],
    ) -> FloatArray:
        """Gains of log-likelihood with the variance that remains next to each candidate.

        With the products of `_coupling`, and the change (a, S) of the active coefficients, which
        fall by that much per unit of each column.
        """
        x = linalg.block_diag(*(c[:, None] for c in fitted))  # a column for each candidate
        squares = np.array([q @ c @ c for q, c in zip(batch.squares, fitted, strict=True)])
        moved, out = change @ x, -0.5 * batch.prior @ x**2
        rows = self.independent_share * self.moving.sum(axis=0)
        for j, (gram, (products, target), places) in enumerate(
            zip(self._grams, shared, batch.places, strict=True)
        ):
            acting, positions = self._acting(gram, self.solution)
            added, u, c = x[places], moved[positions], self.solution.coefficients[gram.places]
            score = gram.score - gram.matrix @ c
            power = gram.power - float(c @ (gram.score + score))
            if power <= 0.0:
                continue
            others = gram.matrix[np.ix_(acting, acting)] @ u - 2.0 * (products @ added)
            error = power + squares[:, j] - 2.0 * target @ added + 2.0 * score[acting] @ u
            remaining = (error + np.sum(u * others, axis=0)) / power
            out -= 0.5 * rows[j] * np.log(np.maximum(remaining, MIN_REMAINING))
        return np.asarray(out)

    def _acting(self, gram: _JointGram, solution: Solution) -> tuple[IntArray, IntArray]:
        """Columns of a joint whose coefficients are active, and their places among these."""
        acting = np.flatnonzero(solution.active[gram.places])
        return acting, (np.cumsum(solution.active) - 1)[gram.places[acting]]

    def _coupling(
        self, batch: CandidateBatch, solution: Solution
    ) -> tuple[FloatArray, FloatArray, list[tuple[FloatArray, FloatArray]]]:
        """Information that active coefficients and columns share, score, and products by joint.

        Shapes (a, S), (S,), and of each joint those of its columns with the active ones and with
        the residual, (b, S_j) and (S_j,).
        """
        shared, total = [], len(batch.prior)
        cross, score = np.zeros((int(solution.active.sum()), total)), np.zeros(total)
        for j, (gram, x, places) in enumerate(
            zip(self._grams, batch.values, batch.places, strict=True)
        ):
            products = gram.columns.T @ x
            target = x.T @ self.torque[:, j] - products.T @ solution.coefficients[gram.places]
            acting, positions = self._acting(gram, solution)
            shared.append((products[acting], target))
            cross[np.ix_(positions, places)] += self.weights[j] * products[acting]
            score[places] += self.weights[j] * target
        return cross, score, shared


def rms(residual: FloatArray, moving: BoolArray) -> FloatArray:
    """Return the RMS of each joint over its rows in motion, shape (n,)."""
    count = np.maximum(moving.sum(axis=0), 1)
    return np.asarray(np.sqrt(np.sum(np.where(moving, residual, 0.0) ** 2, axis=0) / count))


def log_error_ratio(new: FloatArray, old: FloatArray, rows: BoolArray) -> FloatArray:
    """Return N ln(r_old/r_new) of each joint, r the RMS of its N `rows`, shape (n,).

    It is the log likelihood ratio of two models, by their torque residuals (N, n), if all rows are
    independent.
    """
    after, before = (np.maximum(rms(residual, rows), 1e-300) for residual in (new, old))
    return np.asarray(rows.sum(axis=0) * np.log(before / after))


def independent_share(residual: FloatArray, moving: BoolArray) -> float:
    """Return the share ρ of independent rows, the median over the joints.

    One share for all joints: weighted each by its own, a joint with a white residual would bend the
    rigid-body parameters of its neighbours.

    Args:
        residual: Torque residual, shape (N, n).
        moving: Rows that count, shape (N, n).
    """
    lengths = [correlation_length(x) for x in np.where(moving, residual, 0.0).T]
    return 1.0 / float(np.median(lengths))
