"""The same estimate by another road: linear matrix inequalities and a conic solver, to check `consistent` against.

min ½‖R ψ − z‖² + γ d(ψ, ψ₀)² subject to P(φᵢ) ⪰ 0 for every body (Wensing, Kim & Slotine, IEEE RA-L 2018; review, eq. 15, 17, 18, 21),
stated in cvxpy and solved by Clarabel. The Riemannian distance isn't convex in the parameters and has no such form.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import UnusableInput
from ..robot.inertial_parameters import Parameters
from . import consistency
from .consistency import (
    NONNEGATIVE_KINDS,
    Bounds,
    ConsistentEstimate,
    Prior,
    inertial_rows,
    map_objective,
    prior_information,
)
from .inertia_distance import PSEUDO_INERTIA_BASIS, Distance, distance_metrics, pseudo_inertias

Array = np.ndarray
AGREEMENT_TOLERANCE = 1e-4
"""Difference of the objective, relative to its size where that is above 1, up to which two solvers say the same, besides the barrier."""
INSTALL = "pip install 'excite[lmi]'"


@dataclass(frozen=True)
class LmiCheck:
    """psi: by the conic solver. Shape (P,). objective: ½‖Rψ − z‖² + γ d² of it. own: the same of the estimate that is checked.

    barrier: what that one's barrier may cost, its last weight times the number of its terms (Boyd & Vandenberghe 2004, 11.2.2).
    """

    psi: Array
    objective: float
    own: float
    barrier: float

    @property
    def gap(self) -> float:
        """How much worse the checked estimate is, relative to the objective where that is above 1; negative: better."""
        return (self.own - self.objective) / max(1.0, abs(self.objective))

    @property
    def agrees(self) -> bool:
        """Whether the two differ by no more than AGREED and, upwards, what the barrier may cost."""
        return -AGREEMENT_TOLERANCE <= self.gap <= AGREEMENT_TOLERANCE + self.barrier / max(1.0, abs(self.objective))


def check_estimate(
    parameters: Parameters,
    root: Array,
    target: Array,
    prior: Prior,
    found: ConsistentEstimate,
    bounds: Bounds | None = None,
) -> LmiCheck:
    """Solve the problem of `consistent.maximum_a_posteriori` again and compare. Arguments as there; found: what it returned.

    Raises UnusableInput without cvxpy and Clarabel, for the Riemannian distance, and where no body obeys the bounds.
    """
    psi = solve_lmi(parameters, root, target, prior, bounds)
    lines = sum(len(parameters.joints) for kind in NONNEGATIVE_KINDS if kind in parameters.drive)
    lines += 0 if bounds is None else 2 * len(bounds.mass) + 6 * len(bounds.centre)
    theirs, own = (map_objective(parameters, root, target, prior, one) for one in (psi, found.psi))
    return LmiCheck(psi, theirs, own, consistency.BARRIER_WEIGHTS[-1] * (4 * parameters.bodies + lines))


def solve_lmi(
    parameters: Parameters, root: Array, target: Array, prior: Prior, bounds: Bounds | None = None
) -> Array:
    """ψ̂ by Clarabel. root: R B. Shape (m, P). target: R θ̂. Shape (m,). Returns shape (P,). Raises UnusableInput as `check`."""
    if prior.distance is Distance.RIEMANNIAN:
        raise UnusableInput(
            "linear matrix inequalities: the Riemannian distance is not convex in the parameters; take bregman or pullback"
        )
    if importlib.util.find_spec("cvxpy") is None or importlib.util.find_spec("clarabel") is None:
        raise UnusableInput(
            f"linear matrix inequalities: cvxpy and Clarabel are not installed; {INSTALL}"
        )
    import casadi  # both slow to import

    casadi.load_conic("highs")  # its own HiGHS, before cvxpy loads another (see `subproblem`)
    import cvxpy as cp

    half = _half(parameters, root, prior)
    x = cp.Variable(parameters.count)
    psi = prior.nominal + half @ x
    R: Array = np.linalg.qr(np.column_stack([root @ half, target - root @ prior.nominal]), mode="r")  # type: ignore[assignment]
    cost = 0.5 * cp.sum_squares(R[:, :-1] @ x - R[:, -1]) + _distance(
        parameters, prior, half, psi, x
    )
    problem = cp.Problem(cp.Minimize(cost), _limits(parameters, prior, psi, bounds or Bounds()))
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    if x.value is None:
        raise UnusableInput(
            f"linear matrix inequalities: Clarabel finds the problem {problem.status}; widen the bounds of mass and centre"
        )
    return np.asarray(prior.nominal + half @ x.value)


def _half(parameters: Parameters, root: Array, prior: Prior) -> Array:
    """H with ψ = ψ₀ + H x and a Hessian near 1 in x: left as it stands, the solver loses the digits of what only the prior decides."""
    scale = parameters.scale
    values, vectors = np.linalg.eigh(
        scale.T @ (root.T @ root + prior_information(parameters, prior)) @ scale
    )
    return np.asarray(scale @ vectors / np.sqrt(np.maximum(values, 1e-16 * values[-1])))


def _distance(parameters: Parameters, prior: Prior, half: Array, psi: Any, x: Any) -> Any:
    import cvxpy as cp

    edge, bodies = 10 * parameters.bodies, inertial_rows(parameters, prior.nominal)
    units = np.sqrt(prior.drives) / prior.scales
    cost = cp.sum_squares((units[:, None] * half[edge:]) @ x) if parameters.drive else 0.0
    if prior.bodies == 0.0:
        return cost
    if prior.distance is Distance.BREGMAN:
        for i in range(parameters.bodies):
            scaled = _scaled(prior, psi, i)
            cost = cost + prior.bodies * (cp.trace(scaled) - cp.log_det(scaled) - 4.0)
        return cost
    for i, G in enumerate(distance_metrics(prior.distance, bodies)):
        change = np.linalg.cholesky(G).T @ half[10 * i : 10 * i + 10]
        cost = cost + prior.bodies * cp.sum_squares(change @ x)
    return cost


def _scaled(prior: Prior, psi: Any, body: int) -> Any:
    """P(φ) in the frame where that of the nominal body is 1: an expression of shape (4, 4)."""
    import cvxpy as cp

    place = slice(10 * body, 10 * body + 10)
    inverse = np.linalg.inv(np.linalg.cholesky(pseudo_inertias(prior.nominal[None, place])[0]))
    units = inverse @ PSEUDO_INERTIA_BASIS @ inverse.T
    return cp.reshape(units.reshape(10, 16).T @ psi[place], (4, 4), order="C")


def _limits(parameters: Parameters, prior: Prior, psi: Any, bounds: Bounds) -> list[Any]:
    """Bodies that are bodies by as much as `consistent` wants, friction that brakes, and the bounds given."""
    limits = [
        _scaled(prior, psi, i) >> consistency.MIN_PSEUDO_INERTIA * np.eye(4) for i in range(parameters.bodies)
    ]
    scale = np.diag(parameters.scale)
    for kind in NONNEGATIVE_KINDS:
        if kind in parameters.drive:
            block = parameters.block(kind)
            limits.append(psi[block] / scale[block] >= 0.0)
    for link, (least, most) in bounds.mass.items():
        mass = psi[10 * parameters.links.index(link)]
        limits += [mass >= least, mass <= most]
    for link, (low, high) in bounds.centre.items():
        place = 10 * parameters.links.index(link)
        mass, first = psi[place], psi[place + 1 : place + 4]
        limits += [first >= mass * np.asarray(low), first <= mass * np.asarray(high)]
    return limits
