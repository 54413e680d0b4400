"""Check of the consistent estimate by a conic solver with linear matrix inequalities.

Solves min ½‖R ψ − z‖² + γ d(ψ, ψ₀)² subject to P(φᵢ) ⪰ 0 for every body (Wensing, Kim & Slotine,
"Linear matrix inequalities for physically consistent inertial parameter identification", IEEE
Robotics and Automation Letters 3(1), 2018; review, eq. 15, 17, 18, 21), stated in cvxpy and solved
by Clarabel. The Riemannian distance is not convex in the parameters and has no such form.
"""

from __future__ import annotations

import importlib.util
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.inertial_parameters import PSEUDO_INERTIA_BASIS, Parameters
from .consistency import (
    BARRIER_WEIGHTS,
    MIN_PSEUDO_INERTIA,
    NONNEGATIVE_KINDS,
    Bounds,
    ConsistentEstimate,
    Prior,
    inertial_rows,
    map_objective,
    prior_information,
)
from .inertia_distance import Distance, distance_metrics, pseudo_inertias

AGREEMENT_TOLERANCE = 1e-4
"""Difference of the objectives, relative to the objective where that is above 1, up to which the
two solvers agree, in addition to the cost of the barrier."""
SOLVER_TOLERANCE = 1e-9
"""Gap and feasibility tolerances of Clarabel."""
INSTALL_COMMAND = "pip install 'excite[lmi]'"
"""Command that installs the conic solver."""


@dataclass(frozen=True)
class LmiCheck:
    """Comparison of a consistent estimate with a conic solver's.

    Attributes:
        psi: ψ̂ of the conic solver. Shape (P,).
        objective: ½‖Rψ − z‖² + γ d² of `psi`.
        checked_objective: The same of the estimate that is checked.
        barrier: Cost of the logarithmic barrier in the checked estimate, at most: its last weight
            times the number of its terms (Boyd & Vandenberghe 2004, 11.2.2).
    """

    psi: FloatArray
    objective: float
    checked_objective: float
    barrier: float

    @property
    def gap(self) -> float:
        """Excess of the checked objective, relative where the objective is above 1."""
        return (self.checked_objective - self.objective) / max(1.0, abs(self.objective))

    @property
    def agrees(self) -> bool:
        """True if the gap is within the tolerance and, upwards, the cost of the barrier."""
        upper = AGREEMENT_TOLERANCE + self.barrier / max(1.0, abs(self.objective))
        return -AGREEMENT_TOLERANCE <= self.gap <= upper


def check_estimate(
    parameters: Parameters,
    root: FloatArray,
    target: FloatArray,
    prior: Prior,
    checked: ConsistentEstimate,
    bounds: Bounds | None = None,
) -> LmiCheck:
    """Solve the problem of `consistency.maximum_a_posteriori` again and compare.

    Args:
        parameters: Standard parameters.
        root: R B. Shape (m, P).
        target: R θ̂. Shape (m,).
        prior: ψ₀, the distance and γ.
        checked: Result of `maximum_a_posteriori` with the same arguments.
        bounds: Bounds of masses and centres of mass.

    Raises:
        UnusableInput: As `solve_lmi`.
    """
    psi = solve_lmi(parameters, root, target, prior, bounds)
    terms = sum(len(parameters.joints) for kind in NONNEGATIVE_KINDS if kind in parameters.drive)
    terms += 0 if bounds is None else 2 * len(bounds.mass) + 6 * len(bounds.centre)
    conic, barrier = (
        map_objective(parameters, root, target, prior, solution) for solution in (psi, checked.psi)
    )
    return LmiCheck(psi, conic, barrier, BARRIER_WEIGHTS[-1] * (4 * parameters.bodies + terms))


def solve_lmi(
    parameters: Parameters,
    root: FloatArray,
    target: FloatArray,
    prior: Prior,
    bounds: Bounds | None = None,
) -> FloatArray:
    """Compute ψ̂ by Clarabel.

    Args:
        parameters: Standard parameters.
        root: R B. Shape (m, P).
        target: R θ̂. Shape (m,).
        prior: ψ₀, the distance and γ.
        bounds: Bounds of masses and centres of mass.

    Returns:
        ψ̂. Shape (P,).

    Raises:
        UnusableInput: cvxpy or Clarabel is not installed, the distance is Riemannian, or no
            consistent body satisfies the bounds.
    """
    if prior.distance is Distance.RIEMANNIAN:
        raise UnusableInput(
            "--check-lmi: the Riemannian distance is not convex in the parameters; use "
            "--distance bregman or pullback"
        )
    if importlib.util.find_spec("cvxpy") is None or importlib.util.find_spec("clarabel") is None:
        raise UnusableInput(
            f"--check-lmi: cvxpy and Clarabel are not installed; run {INSTALL_COMMAND}"
        )
    import cvxpy as cp  # slow to import

    half = _preconditioner(parameters, root, prior)
    x = cp.Variable(parameters.count)
    psi = prior.nominal + half @ x
    R: FloatArray = np.linalg.qr(  # type: ignore[assignment]
        np.column_stack([root @ half, target - root @ prior.nominal]), mode="r"
    )
    cost = 0.5 * cp.sum_squares(R[:, :-1] @ x - R[:, -1]) + _penalty(
        parameters, prior, half, psi, x
    )
    problem = cp.Problem(
        cp.Minimize(cost), _constraints(parameters, prior, psi, bounds or Bounds())
    )
    with warnings.catch_warnings():  # how accurate it is the comparison of the objectives tells
        warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
        problem.solve(
            solver=cp.CLARABEL,
            tol_gap_abs=SOLVER_TOLERANCE,
            tol_gap_rel=SOLVER_TOLERANCE,
            tol_feas=SOLVER_TOLERANCE,
        )
    if x.value is None:
        raise UnusableInput(
            f"--check-lmi: Clarabel reports that the problem is {problem.status}; widen the bounds "
            "of mass and centre"
        )
    return np.asarray(prior.nominal + half @ x.value)


def _preconditioner(parameters: Parameters, root: FloatArray, prior: Prior) -> FloatArray:
    """H with ψ = ψ₀ + H x such that the Hessian in x is near the identity.

    Without it the solver loses the digits of what only the prior determines.
    """
    scale = parameters.scale
    values, vectors = np.linalg.eigh(
        scale.T @ (root.T @ root + prior_information(parameters, prior)) @ scale
    )
    return np.asarray(scale @ vectors / np.sqrt(np.maximum(values, 1e-16 * values[-1])))


def _penalty(parameters: Parameters, prior: Prior, half: FloatArray, psi: Any, x: Any) -> Any:
    """Expression of γ d(ψ, ψ₀)²."""
    import cvxpy as cp

    edge, bodies = 10 * parameters.bodies, inertial_rows(parameters, prior.nominal)
    units = np.sqrt(prior.joint_weights) / prior.joint_scales
    cost = cp.sum_squares((units[:, None] * half[edge:]) @ x) if parameters.drive else 0.0
    if prior.inertial_weight == 0.0:
        return cost
    if prior.distance is Distance.BREGMAN:
        for i in range(parameters.bodies):
            M = _normalised_pseudo_inertia(prior, psi, i)
            cost = cost + prior.inertial_weight * (cp.trace(M) - cp.log_det(M) - 4.0)
        return cost
    for i, G in enumerate(distance_metrics(prior.distance, bodies)):
        change = np.linalg.cholesky(G).T @ half[10 * i : 10 * i + 10]
        cost = cost + prior.inertial_weight * cp.sum_squares(change @ x)
    return cost


def _normalised_pseudo_inertia(prior: Prior, psi: Any, body: int) -> Any:
    """Expression of L⁻¹P(φ)L⁻ᵀ, the identity for the nominal body. Shape (4, 4)."""
    import cvxpy as cp

    place = slice(10 * body, 10 * body + 10)
    inverse = np.linalg.inv(np.linalg.cholesky(pseudo_inertias(prior.nominal[None, place])[0]))
    units = inverse @ PSEUDO_INERTIA_BASIS @ inverse.T
    return cp.reshape(units.reshape(10, 16).T @ psi[place], (4, 4), order="C")


def _constraints(parameters: Parameters, prior: Prior, psi: Any, bounds: Bounds) -> list[Any]:
    """Physical consistency, signs of joint parameters, and the bounds of masses and centres."""
    constraints = [
        _normalised_pseudo_inertia(prior, psi, i) >> MIN_PSEUDO_INERTIA * np.eye(4)
        for i in range(parameters.bodies)
    ]
    scale = np.diag(parameters.scale)
    for kind in NONNEGATIVE_KINDS:
        if kind in parameters.drive:
            block = parameters.block(kind)
            constraints.append(psi[block] / scale[block] >= 0.0)
    for link, (lower, upper) in bounds.mass.items():
        mass = psi[10 * parameters.links.index(link)]
        constraints += [mass >= lower, mass <= upper]
    for link, (low, high) in bounds.centre.items():
        place = 10 * parameters.links.index(link)
        mass, first = psi[place], psi[place + 1 : place + 4]
        constraints += [first >= mass * np.asarray(low), first <= mass * np.asarray(high)]
    return constraints
