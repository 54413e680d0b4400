"""Refinement of parameters against the simulation error, by Gauss-Newton with exact sensitivities.

Minimises ½ Σ ‖q(ψ, x₀) − q_recorded‖²_Λ + ½‖R(Bψ − θ̂)‖² + γ d(ψ, ψ₀)² over ψ and the initial
state of every window (review, eq. 6 and 21), starting from the equation-error solution. The motion
depends on ψ through θ = Bψ alone, so sensitivities are taken with respect to θ and nothing depends
on the choice of B. Each step is solved by `consistency.maximum_a_posteriori` with the linearised
simulation error as additional rows: every iterate is physically consistent, and the second term,
the equation-error estimate with its covariance, keeps it near the data. The torque noise enters
both terms, so no covariance is given; confidence intervals remain those of the equation error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from .consistency import Bounds, Prior, map_objective, maximum_a_posteriori
from .estimators import Estimate
from .forward_dynamics import RobotDynamics, build_dynamics
from .regression import IdentificationModel
from .simulation_error import (
    SimulationWindows,
    simulate_positions,
    simulate_sensitivities,
    widen_friction,
)

MAX_STEPS = 8
"""Number of Gauss-Newton steps, at most."""
COST_TOLERANCE = 1e-3
"""Relative decrease of the cost below which the refinement has converged."""
MAX_HALVINGS = 6
"""Number of step lengths tried per step, each half of the one before."""
ESTIMATED_STATE_PARAMETERS = 2
"""Parameters of the initial state per joint and window: position and speed."""


@dataclass(frozen=True)
class Refinement:
    """Result of a refinement.

    Attributes:
        psi: Refined, physically consistent parameters. Shape (P,).
        costs: Cost at the start and after every step.
        states: For each group of windows, the estimated q and q̇ at the start. Shape (W, 2n).
    """

    psi: FloatArray
    costs: tuple[float, ...]
    states: tuple[FloatArray, ...]


@dataclass(frozen=True)
class _Iterate:
    """Parameters and initial states."""

    psi: FloatArray
    states: tuple[FloatArray, ...]


@dataclass(frozen=True)
class _RefinementProblem:
    """Terms of the cost; `weights`: of position errors, by group. Shape (n,) [1/rad or 1/m]."""

    model: IdentificationModel
    groups: Sequence[SimulationWindows]
    root: FloatArray
    target: FloatArray
    prior: Prior
    bounds: Bounds | None
    weights: tuple[FloatArray, ...]

    def cost(self, iterate: _Iterate) -> float:
        """Cost of an iterate."""
        dynamics, total = build_dynamics(self.model, iterate.psi), 0.0
        for windows, states, weight in zip(self.groups, iterate.states, self.weights, strict=True):
            total += 0.5 * float(
                np.sum((weight * (simulate_positions(dynamics, windows, states) - windows.q)) ** 2)
            )
        return total + map_objective(
            self.model.parameters, self.root, self.target, self.prior, iterate.psi
        )

    def gauss_newton(self, iterate: _Iterate) -> _Iterate:
        """Minimum of the problem linearised at an iterate."""
        B = self.model.base.matrix
        theta, dynamics = B @ iterate.psi, build_dynamics(self.model, iterate.psi)
        rows, target, state_changes = [self.root], [self.target], []
        for windows, states, weight in zip(self.groups, iterate.states, self.weights, strict=True):
            error, slopes, state_change = _eliminate_states(
                *simulate_sensitivities(dynamics, windows, states), windows.q, weight
            )
            R: FloatArray = np.linalg.qr(  # type: ignore[assignment]
                np.column_stack([slopes, slopes @ theta - error]), mode="r"
            )
            rows.append(R[:, :-1] @ B)
            target.append(R[:, -1])
            state_changes.append(state_change)
        solution = maximum_a_posteriori(
            self.model.parameters, np.vstack(rows), np.concatenate(target), self.prior, self.bounds
        )
        change = B @ solution.psi - theta
        return _Iterate(
            solution.psi,
            tuple(
                s + a + b @ change for s, (a, b) in zip(iterate.states, state_changes, strict=True)
            ),
        )


def refine(
    model: IdentificationModel,
    groups: Sequence[SimulationWindows],
    start: FloatArray,
    data: Estimate,
    prior: Prior,
    bounds: Bounds | None = None,
) -> Refinement:
    """Refine parameters so that they predict positions best.

    A position error is weighted by its RMS at the start, and a window of S positions counts as
    (tr C)²/tr C² of them, C the covariance of its errors, because errors close in time are
    correlated (Satterthwaite, Biometrics Bulletin 2(6), 1946).

    Args:
        model: The model.
        groups: Windows, as `simulation_error.cut_windows` returns them.
        start: Physically consistent equation-error estimate. Shape (P,).
        data: Equation-error estimate of the base parameters.
        prior: ψ₀, the distance and γ.
        bounds: Bounds of masses and centres of mass.

    Raises:
        UnusableInput: There is no window, or the starting parameters lose the recorded motion.
    """
    if not groups:
        raise UnusableInput(
            "--refine: no recording is as long as one window and the margins of the filter; record "
            "for longer"
        )
    widened = widen_friction(model, start, groups)
    dynamics = build_dynamics(widened, start)
    for windows in groups:
        if (joint := _lost_joint(dynamics, windows)) is not None:
            raise UnusableInput(
                "--refine: the identified model loses the recorded motion within a window, joint "
                f"'{model.robot.joints[joint]}' first; record a motion that excites that joint's "
                "inertia, or leave --refine out"
            )
    root, target = data.information_root @ model.base.matrix, data.information_root @ data.theta
    weights = tuple(_error_weights(dynamics, windows) for windows in groups)
    problem = _RefinementProblem(widened, groups, root, target, prior, bounds, weights)
    iterate = _Iterate(start, tuple(windows.states for windows in groups))
    costs = [problem.cost(iterate)]
    for _ in range(MAX_STEPS):
        iterate, cost = _line_search(problem, iterate, problem.gauss_newton(iterate), costs[-1])
        costs.append(cost)
        if costs[-2] - cost <= COST_TOLERANCE * costs[-2]:
            break
    return Refinement(iterate.psi, tuple(costs), iterate.states)


def _lost_joint(dynamics: RobotDynamics, windows: SimulationWindows) -> int | None:
    """Joint with the largest error just before the first window is lost; None if none is lost."""
    errors = np.abs(simulate_positions(dynamics, windows, windows.states) - windows.q)
    first = int(np.isfinite(errors).all(axis=2).sum(axis=1).min())
    if first == errors.shape[1]:
        return None
    last = errors[:, first - 1]
    return int(np.argmax(np.max(last[~np.isfinite(errors[:, first]).all(axis=1)], axis=0)))


def _line_search(
    problem: _RefinementProblem, start: _Iterate, end: _Iterate, cost: float
) -> tuple[_Iterate, float]:
    """First of start + (end − start)/2ᵏ that costs less, else start, with its cost.

    Parameters between two consistent ones are consistent.
    """
    for k in range(MAX_HALVINGS):
        part = 0.5**k
        trial = _Iterate(
            start.psi + part * (end.psi - start.psi),
            tuple(a + part * (b - a) for a, b in zip(start.states, end.states, strict=True)),
        )
        trial_cost = problem.cost(trial)
        if trial_cost < cost:
            return trial, trial_cost
    return start, cost


def _eliminate_states(
    q: FloatArray, slopes: FloatArray, measured: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Project weighted errors and slopes off what changes of the initial states explain.

    Args:
        q: Simulated positions. Shape (W, S, n).
        slopes: Derivatives with respect to state and θ. Shape (W, S, n, 2n + p).
        measured: Recorded positions. Shape (W, S, n).
        weight: Weight of an error of each joint. Shape (n,).

    Returns:
        Errors, shape (m,), their slopes by θ, shape (m, p), and the change a + b δθ of the states,
        shapes (W, 2n) and (W, 2n, p).
    """
    W, states = len(q), 2 * q.shape[2]
    error = (weight * (q - measured)).reshape(W, -1, 1)
    slopes = (weight[:, None] * slopes).reshape(W, error.shape[1], -1)
    Q, R = np.linalg.qr(slopes[:, :, :states])
    joined = np.concatenate([error, slopes[:, :, states:]], axis=2)
    explained = np.swapaxes(Q, 1, 2) @ joined
    changes = -np.linalg.solve(R, explained)
    remaining = (joined - Q @ explained).reshape(-1, joined.shape[2])
    return remaining[:, 0], remaining[:, 1:], (changes[:, :, 0], changes[:, :, 1:])


def _error_weights(dynamics: RobotDynamics, windows: SimulationWindows) -> FloatArray:
    """Weight of a position error of each joint. Shape (n,) [1/rad or 1/m]."""
    n = windows.q.shape[2]
    q, slopes = simulate_sensitivities(dynamics, windows, windows.states)
    residual, _, _ = _eliminate_states(q, slopes, windows.q, np.ones(n))
    errors = residual.reshape(windows.q.shape)
    out = np.empty(n)
    for joint in range(n):
        C = errors[:, :, joint].T @ errors[:, :, joint] / len(windows)
        power = max(float(np.trace(C)), 1e-24)
        independent = power**2 / max(float(np.sum(C * C)), 1e-300)
        freedom = max(len(C) - ESTIMATED_STATE_PARAMETERS, 1)
        out[joint] = np.sqrt(independent / len(C) * freedom / power)
    return out
