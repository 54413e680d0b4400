"""Physically consistent parameters: the maximum a-posteriori estimate (review, eq. 15 and 21).

Minimises ½‖R(Bψ − θ̂)‖² + γ d(ψ, ψ₀)² such that the pseudo-inertia of every body is positive
definite and friction and rotor inertia are not negative. A damped Newton method minimises the sum
of this and a logarithmic barrier (Boyd & Vandenberghe, "Convex Optimization", 2004, chapter 11),
whose weight is reduced until it costs at most a hundredth of a unit of log-likelihood.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg

from .._types import FloatArray
from ..errors import ExciteWarning, UnusableInput
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import (
    Parameters,
    inverse_root,
    of_pseudo_inertia,
    proper_body,
    pseudo_inertia,
)
from .inertia_distance import Distance, NominalFrames, distance_metrics, pseudo_inertias

NONNEGATIVE_KINDS = ("rotor_inertia", "viscous", "coulomb")
"""Joint parameters that cannot be negative."""
BARRIER_WEIGHTS = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
"""Weights of the barrier, one after the other, from a start near the data. With the last the
barrier costs at most 1e-4 per term (Boyd & Vandenberghe 2004, 11.2.2): 0.01 for 100 terms."""
FIRST_WEIGHT_FACTOR = 100.0
"""Factor between the weights that come before, where the start is far from the data: of 10, 100 and
1000 the one with the fewest Newton steps."""
MIN_PSEUDO_INERTIA = 1e-6
"""Lower bound of the pseudo-inertia, P ≻ MIN_PSEUDO_INERTIA · P₀: at the boundary of the consistent
set a body has no finite metric."""
MAX_NEWTON_STEPS = 60
"""Number of Newton steps per barrier weight, at most."""
FINAL_NEWTON_DECREMENT = 1e-8
"""Squared Newton decrement at which the last minimisation has converged [log-likelihood]."""
NEWTON_DECREMENT = 1e-3
"""The same for the minimisations before, over the weight where that is larger than 1."""
MAX_GAP = 0.02
"""Squared Newton decrement above which the minimisation has not converged: twice what the barrier
costs of the log-likelihood; relative to the objective where that is larger than 1."""
ROUNDING = 1e-14
"""Rounding errors of a Hessian relative to its diagonal [1]; where a parameter has no prior, the
share of its information by the data that stands for one."""
STEP_TO_BOUNDARY = 0.95
"""Largest step as a share of the step that reaches the boundary of the consistent set."""
MAX_HALVINGS = 40
"""Number of halvings of a Newton step, at most."""
SUFFICIENT_DECREASE = 1e-4
"""Share of the linear prediction by which a step must reduce the objective (Armijo's rule)."""
INITIAL_SCALE_SHARE = 0.05
"""Initial value of a joint parameter that is nominally 0, as a share of its scale."""
INITIAL_BOUND_SHARE = 0.05
"""Initial distance from a bound as a share of the distance between the bounds."""


@dataclass(frozen=True)
class Bounds:
    """Additional convex constraints.

    Attributes:
        mass: Smallest and largest mass by link [kg].
        centre: Opposite corners of a box that contains the centre of mass, by link, in the frame of
            the joint that moves the link. Shape (2, 3) [m].
    """

    mass: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    centre: Mapping[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True)
class Prior:
    """Prior of ψ: the nominal parameters and the weight of the distance from them.

    Attributes:
        nominal: ψ₀, physically consistent. Shape (P,).
        distance: Distance of link inertias.
        inertial_weight: γ of the inertial parameters.
        joint_weights: γ of each friction, rotor inertia and offset. Shape (P − 10 bodies,).
        joint_scales: Scales s of these in their squared distance ((ψ − ψ₀)/s)². Same shape.
    """

    nominal: FloatArray
    distance: Distance
    inertial_weight: float
    joint_weights: FloatArray
    joint_scales: FloatArray

    @property
    def joint_information(self) -> FloatArray:
        """Information 2γ/s² on each friction, rotor inertia and offset, shape (P − 10 bodies,)."""
        return np.asarray(2.0 * self.joint_weights / self.joint_scales**2)


@dataclass(frozen=True)
class ConsistentEstimate:
    """A physically consistent estimate.

    Attributes:
        psi: ψ̂. Shape (P,).
        covariance: Posterior covariance of ψ̂, (RᵀR + 2γG)⁻¹ with the metric of `local_prior`.
            Shape (P, P).
        misfit: ½‖R(Bψ̂ − θ̂)‖²: log-likelihood lost to consistency and the prior.
        distance: Squared distance d(ψ̂, ψ₀)².
        gap: Squared Newton decrement at the end, twice the log-likelihood by which the objective
            may still be above its minimum.
    """

    psi: FloatArray
    covariance: FloatArray
    misfit: float
    distance: float
    gap: float


def consistent_nominal(parameters: Parameters) -> FloatArray:
    """Return the nominal parameters made physically consistent.

    Bodies are corrected as `inertial_parameters.proper_body` states, negative friction and rotor
    inertia become 0. Shape (P,).
    """
    psi, edge = parameters.nominal.copy(), 10 * parameters.bodies
    mass = float(np.maximum(psi[:edge:10], 0.0).sum()) or 1.0
    for i in range(0, edge, 10):
        psi[i : i + 10] = proper_body(psi[i : i + 10], mass)[0]
    for kind in NONNEGATIVE_KINDS:
        if kind in parameters.drive:
            psi[parameters.block(kind)] = np.maximum(psi[parameters.block(kind)], 0.0)
    return psi


def inertial_rows(parameters: Parameters, psi: FloatArray) -> FloatArray:
    """Return the inertial part of ψ, one body per row. Shapes (P,) -> (b, 10)."""
    out: FloatArray = psi[: 10 * parameters.bodies].reshape(-1, 10)
    return out


def prior_information(parameters: Parameters, prior: Prior) -> FloatArray:
    """Compute 2γG, the information that the prior is worth near ψ₀. Shape (P, P)."""
    edge = 10 * parameters.bodies
    out = np.diag(np.concatenate([np.zeros(edge), prior.joint_information]))
    for i, G in enumerate(
        distance_metrics(prior.distance, inertial_rows(parameters, prior.nominal))
    ):
        out[10 * i : 10 * i + 10, 10 * i : 10 * i + 10] = 2.0 * prior.inertial_weight * G
    return out


def local_prior(parameters: Parameters, prior: Prior, psi: FloatArray) -> Prior:
    """Return the prior whose information is that of its curvature about an estimate ψ̂.

    The curvature of a quadratic distance is the metric at the nominal body, that of the others the
    metric at the body itself. The latter has no bound where the data press a body against the edge
    of the consistent set, as if what they do not show were known there. The metric is therefore
    that of the mean of the body and the nominal body, each scaled to the larger of both masses.

    Args:
        parameters: Standard parameters.
        prior: The prior.
        psi: ψ̂, physically consistent. Shape (P,).
    """
    if prior.distance in (Distance.PULLBACK, Distance.EUCLIDEAN):
        return prior
    bodies, nominal = inertial_rows(parameters, psi), inertial_rows(parameters, prior.nominal)
    local = psi.copy()
    mass = np.maximum(bodies[:, :1], nominal[:, :1])
    mean = 0.5 * mass * (bodies / bodies[:, :1] + nominal / nominal[:, :1])
    local[: 10 * parameters.bodies] = mean.ravel()
    return replace(prior, nominal=local)


def base_prior_information(parameters: Parameters, base: Base, prior: Prior) -> FloatArray:
    """Compute (B (2γG)⁺ Bᵀ)⁺, what the prior is worth for the base parameters. Shape (p, p)."""
    covariance = symmetric_pseudo_inverse(prior_information(parameters, prior))
    return symmetric_pseudo_inverse(base.matrix @ covariance @ base.matrix.T)


class _BarrierProblem:
    """Objective plus barrier as a function of ψ, and its Newton step.

    Linear constraints are `rows` ψ > `levels`. The step is computed in coordinates x, ψ = S x, in
    which distances from the nominal parameters have unit curvature, since the ten parameters of a
    small body differ by many orders of magnitude.
    """

    def __init__(
        self,
        parameters: Parameters,
        root: FloatArray,
        target: FloatArray,
        prior: Prior,
        rows: FloatArray,
        levels: FloatArray,
    ) -> None:
        self.parameters, self.root, self.target, self.prior = parameters, root, target, prior
        self.edge = 10 * parameters.bodies
        bodies = inertial_rows(parameters, prior.nominal)
        coordinates = np.array([inverse_root(body) for body in bodies])
        self.frames = NominalFrames(bodies, coordinates)
        self.rows, self.levels = rows, levels
        self.scale = prior.joint_scales
        self.S = linalg.block_diag(*coordinates, np.diag(self.scale))
        self.rows_x, self.root_x = rows @ self.S, root @ self.S

    def slack(self, psi: FloatArray) -> FloatArray:
        """Slack of the linear constraints, positive inside."""
        return np.asarray(self.rows @ psi - self.levels)

    def bodies(self, psi: FloatArray) -> FloatArray:
        """Inertial part of ψ, one body per row."""
        return inertial_rows(self.parameters, psi)

    def value(self, psi: FloatArray, weight: float) -> float:
        """Objective plus barrier; ∞ outside the constraints."""
        slack, bodies = self.slack(psi), self.bodies(psi)
        if (slack.size and float(slack.min()) <= 0.0) or self.frames.min_eigenvalue(
            bodies
        ) <= MIN_PSEUDO_INERTIA:
            return float("inf")
        misfit = self.root @ psi - self.target
        log_barrier = float(np.sum(np.log(slack))) - float(
            self.frames.barrier(bodies, MIN_PSEUDO_INERTIA).value.sum()
        )
        return 0.5 * float(misfit @ misfit) + self.penalty(psi) - weight * log_barrier

    def penalty(self, psi: FloatArray) -> float:
        """Weighted squared distance from the nominal parameters, γ d²."""
        delta = (psi - self.prior.nominal)[self.edge :] / self.scale
        squared = self.frames.squared_distance(self.prior.distance, self.bodies(psi)).value
        return float(self.prior.joint_weights @ delta**2) + self.prior.inertial_weight * float(
            squared.sum()
        )

    def regularisation(self, psi: FloatArray, weight: float) -> tuple[FloatArray, FloatArray]:
        """Gradient and Hessian by x of the penalty and of the barrier of the pseudo-inertias."""
        delta = (psi - self.prior.nominal)[self.edge :] / self.scale
        bodies = self.bodies(psi)
        barrier = self.frames.barrier(bodies, MIN_PSEUDO_INERTIA)
        distance = self.frames.squared_distance(self.prior.distance, bodies)
        gamma = self.prior.inertial_weight
        gradient = weight * barrier.gradient + gamma * distance.gradient
        hessian = weight * barrier.hessian + gamma * distance.hessian
        return (
            np.concatenate([gradient.ravel(), 2.0 * self.prior.joint_weights * delta]),
            linalg.block_diag(*hessian, 2.0 * np.diag(self.prior.joint_weights)),
        )

    def newton_step(self, psi: FloatArray, weight: float) -> tuple[FloatArray, float]:
        """Return the Newton step of `value`, and the squared Newton decrement.

        The data know some directions 10²⁰ times better than the prior knows the others: the sum of
        both Hessians would have lost the prior. With that of the regularisation, H = L Lᵀ, the
        step is Δx = L⁻ᵀ y, y = argmin ‖A L⁻ᵀ y − b‖² + ‖y + L⁻¹ g‖² by a QR decomposition of all
        rows, A and b those of the misfit and of the barrier of the linear constraints.
        """
        slack = self.slack(psi)
        A = np.vstack([self.root_x, np.sqrt(weight) * self.rows_x / slack[:, None]])
        b = np.concatenate([self.target - self.root @ psi, np.full(len(slack), np.sqrt(weight))])
        gradient, hessian = self.regularisation(psi, weight)
        diagonal = np.diag(hessian) * (1.0 + ROUNDING)
        by_data = np.sum(A**2, axis=0)
        np.fill_diagonal(hessian, np.where(diagonal > 0.0, diagonal, ROUNDING * (by_data + 1.0)))
        factor = linalg.cholesky(hessian, lower=True)
        rows = np.vstack([linalg.solve_triangular(factor, A.T, lower=True).T, np.eye(len(psi))])
        right = np.concatenate([b, -linalg.solve_triangular(factor, gradient, lower=True)])
        triangle = np.asarray(np.linalg.qr(np.column_stack([rows, right]), mode="r"))[:-1]
        y = linalg.solve_triangular(triangle[:, :-1], triangle[:, -1])
        step = self.S @ linalg.solve_triangular(factor, y, lower=True, trans=1)
        return np.asarray(step), float(np.sum((rows @ y) ** 2))

    def max_step(self, psi: FloatArray, step: FloatArray) -> float:
        """Length of the step that reaches the boundary of the constraints."""
        change, slack = self.rows @ step, self.slack(psi)
        falling = change < 0.0
        linear = float(np.min(-slack[falling] / change[falling])) if falling.any() else np.inf
        return min(
            linear, self.frames.max_step(self.bodies(psi), self.bodies(step), MIN_PSEUDO_INERTIA)
        )


def maximum_a_posteriori(
    parameters: Parameters,
    root: FloatArray,
    target: FloatArray,
    prior: Prior,
    bounds: Bounds | None = None,
    *,
    start: FloatArray | None = None,
    barrier_weights: Sequence[float] = BARRIER_WEIGHTS,
) -> ConsistentEstimate:
    """Compute the physically consistent ψ̂ = argmin ½‖root ψ − target‖² + γ d(ψ, ψ₀)².

    Args:
        parameters: Standard parameters.
        root: R B. Shape (m, P).
        target: R θ̂. Shape (m,).
        prior: ψ₀, the distance and γ.
        bounds: Bounds of masses and centres of mass.
        start: Estimate of a similar problem, from which fewer steps lead to this one, shape (P,).
        barrier_weights: Decreasing weights of the barrier, after those that the start needs.

    Raises:
        UnusableInput: No physically consistent body satisfies the bounds.

    Warns:
        ExciteWarning: The minimisation has not converged.
    """
    rows, levels = _halfspaces(parameters, bounds or Bounds())
    problem = _BarrierProblem(parameters, root, target, prior, rows, levels)
    psi, decrement = _interior_point(parameters, prior.nominal, bounds or Bounds()), np.inf
    if rows.size and float(problem.slack(psi).min()) <= 0.0:
        raise UnusableInput(
            "bounds: no physically consistent body satisfies the bounds of mass and centre; "
            "widen them"
        )
    if start is not None and np.isfinite(problem.value(start, 1.0)):
        near, decrement = _minimised(problem, start, barrier_weights[-1:])
    if decrement < FINAL_NEWTON_DECREMENT:
        psi = near
    else:
        weights = [*_first_weights(problem, psi, barrier_weights[0]), *barrier_weights]
        psi, decrement = _minimised(problem, psi, weights)
    if decrement > MAX_GAP * max(problem.value(psi, 0.0), 1.0):
        warnings.warn(
            "the physically consistent parameters are not the best ones: the search for them has "
            f"not converged, and their log-likelihood is about {0.5 * decrement:.2g} too low",
            ExciteWarning,
            stacklevel=2,
        )
    spread = prior_information(parameters, local_prior(parameters, prior, psi))
    misfit = root @ psi - target
    distance = problem.penalty(psi) / prior.inertial_weight if prior.inertial_weight else 0.0
    return ConsistentEstimate(
        psi,
        posterior_covariance(root, spread),
        0.5 * float(misfit @ misfit),
        distance,
        decrement,
    )


def _minimised(
    problem: _BarrierProblem, psi: FloatArray, weights: Sequence[float]
) -> tuple[FloatArray, float]:
    """Minimise objective plus barrier for one weight after the other.

    Args:
        problem: The problem.
        psi: The start.
        weights: Decreasing weights of the barrier.

    Returns:
        ψ and the squared Newton decrement there.
    """
    decrement = np.inf
    for weight in weights:
        is_last = weight == weights[-1]
        small = FINAL_NEWTON_DECREMENT if is_last else NEWTON_DECREMENT * max(weight, 1.0)
        for _ in range(MAX_NEWTON_STEPS):
            step, decrement = problem.newton_step(psi, weight)
            if decrement < small:
                break
            psi = _line_search(problem, psi, step, decrement, weight)
    return psi, decrement


def _first_weights(problem: _BarrierProblem, psi: FloatArray, last: float) -> list[float]:
    """Weights of the barrier before the last one, the largest first.

    The number of Newton steps grows with the difference of objective plus barrier from its minimum,
    over the weight (Boyd & Vandenberghe 2004, 9.6.4). A start far from the data would be driven
    straight to the boundary of the constraints, and stay there.

    Args:
        problem: The problem.
        psi: The start.
        last: The weight that follows.
    """
    stages = np.log(max(problem.value(psi, 0.0) / last, 1.0)) / np.log(FIRST_WEIGHT_FACTOR)
    return [last * FIRST_WEIGHT_FACTOR**k for k in range(int(np.ceil(stages)), 0, -1)]


def _line_search(
    problem: _BarrierProblem, psi: FloatArray, step: FloatArray, decrement: float, weight: float
) -> FloatArray:
    """Halve the step until the objective decreases sufficiently."""
    length = min(1.0, STEP_TO_BOUNDARY * problem.max_step(psi, step))
    value = problem.value(psi, weight)
    for _ in range(MAX_HALVINGS):
        if (
            problem.value(psi + length * step, weight)
            <= value - SUFFICIENT_DECREASE * length * decrement
        ):
            return np.asarray(psi + length * step)
        length *= 0.5
    return psi


def posterior_covariance(root: FloatArray, prior: FloatArray) -> FloatArray:
    """Compute (RᵀR + prior)⁻¹ by a QR decomposition of R above the root of the prior.

    The data may know some directions 10²⁰ times better than the prior knows the others, which the
    sum of both matrices would have lost: their variance would be 0.

    Args:
        root: R. Shape (m, P).
        prior: Information of the prior. Shape (P, P).

    Returns:
        Shape (P, P).
    """
    own_scale = np.sqrt(np.maximum(np.diag(prior), 1e-300))
    values, vectors = np.linalg.eigh(prior / np.outer(own_scale, own_scale))
    prior_root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * own_scale
    rows = np.vstack([root, prior_root])
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-150)
    rows = np.vstack([rows / scale, ROUNDING * np.eye(len(scale))])
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    half = linalg.solve_triangular(triangle, np.eye(len(scale))) / scale[:, None]
    return np.asarray(half @ half.T)


def symmetric_pseudo_inverse(matrix: FloatArray) -> FloatArray:
    """Invert a positive semi-definite matrix whose rows have very different units.

    Rows are scaled to a unit diagonal; directions without information get variance 0.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    kept = values > 1e-14 * values[-1]
    half = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(half @ half.T)


def _halfspaces(parameters: Parameters, bounds: Bounds) -> tuple[FloatArray, FloatArray]:
    """Linear constraints rows ψ > levels: signs of joint parameters, bounds of mass and centre."""
    rows, levels = [], []

    def add(entries: Mapping[int, float], level: float = 0.0) -> None:
        row = np.zeros(parameters.count)
        for place, factor in entries.items():
            row[place] = factor
        rows.append(row)
        levels.append(level)

    for kind in NONNEGATIVE_KINDS:
        if kind in parameters.drive:
            for place in range(parameters.count)[parameters.block(kind)]:
                add({place: 1.0})
    for link, (lower, upper) in bounds.mass.items():
        place = 10 * _link_index(parameters, link)
        add({place: 1.0}, lower)
        add({place: -1.0}, -upper)
    for link, box in bounds.centre.items():
        place = 10 * _link_index(parameters, link)
        for axis in range(3):
            add({place + 1 + axis: 1.0, place: -float(box[0][axis])})
            add({place + 1 + axis: -1.0, place: float(box[1][axis])})
    return np.array(rows).reshape(-1, parameters.count), np.array(levels)


def _link_index(parameters: Parameters, link: str) -> int:
    """Index of a link among the bodies."""
    if link not in parameters.links:
        raise UnusableInput(
            f"bounds: no moving link '{link}'; the links are {', '.join(parameters.links)}"
        )
    return parameters.links.index(link)


def _interior_point(parameters: Parameters, nominal: FloatArray, bounds: Bounds) -> FloatArray:
    """Parameters near the nominal ones that satisfy every constraint strictly."""
    psi, edge = nominal.copy(), 10 * parameters.bodies
    for kind in NONNEGATIVE_KINDS:
        if kind in parameters.drive:
            block = parameters.block(kind)
            psi[block] = np.maximum(
                psi[block], INITIAL_SCALE_SHARE * np.diag(parameters.scale)[block]
            )
    for i in range(0, edge, 10):
        link = parameters.links[i // 10]
        if link not in bounds.mass and link not in bounds.centre:
            continue
        mass, centre = psi[i], psi[i + 1 : i + 4] / psi[i]
        second = pseudo_inertia(psi[i : i + 10])[:3, :3] - mass * np.outer(centre, centre)
        if link in bounds.mass:
            lower, upper = bounds.mass[link]
            bounded = float(
                np.clip(
                    mass,
                    lower + INITIAL_BOUND_SHARE * (upper - lower),
                    upper - INITIAL_BOUND_SHARE * (upper - lower),
                )
            )
            second, mass = second * bounded / mass, bounded
        if link in bounds.centre:
            low, high = np.asarray(bounds.centre[link], float)
            centre = np.clip(
                centre,
                low + INITIAL_BOUND_SHARE * (high - low),
                high - INITIAL_BOUND_SHARE * (high - low),
            )
        place = np.append(centre, 1.0)
        P = mass * np.outer(place, place)
        P[:3, :3] += second
        psi[i : i + 10] = of_pseudo_inertia(P)
    return psi


def is_consistent(parameters: Parameters, psi: FloatArray) -> bool:
    """Return True if ψ is physically consistent (review, eq. 15).

    Every pseudo-inertia is positive definite; friction and rotor inertia are not negative.
    """
    bodies = bool((np.linalg.eigvalsh(pseudo_inertias(inertial_rows(parameters, psi))) > 0.0).all())
    return bodies and all(
        float(psi[parameters.block(kind)].min()) >= 0.0
        for kind in NONNEGATIVE_KINDS
        if kind in parameters.drive
    )


def map_objective(
    parameters: Parameters, root: FloatArray, target: FloatArray, prior: Prior, psi: FloatArray
) -> float:
    """Compute ½‖root ψ − target‖² + γ d(ψ, ψ₀)², the objective of `maximum_a_posteriori`.

    Args:
        parameters: Standard parameters.
        root: R B. Shape (m, P).
        target: R θ̂. Shape (m,).
        prior: ψ₀, the distance and γ.
        psi: Physically consistent parameters. Shape (P,).
    """
    edge = 10 * parameters.bodies
    misfit = root @ psi - target
    inertial = (
        NominalFrames(inertial_rows(parameters, prior.nominal))
        .squared_distance(prior.distance, inertial_rows(parameters, psi))
        .value
    )
    joint = ((psi - prior.nominal)[edge:] / prior.joint_scales) ** 2
    return (
        0.5 * float(misfit @ misfit)
        + prior.inertial_weight * float(inertial.sum())
        + float(prior.joint_weights @ joint)
    )
