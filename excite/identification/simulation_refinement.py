"""Parameters refined against simulation error, from the equation-error solution: Gauss-Newton with exact sensitivities.

min ½ Σ ‖q(ψ, x₀) − q_recorded‖²_Λ + ½‖R(Bψ − θ̂)‖² + γ d(ψ, ψ₀)², over ψ and the initial state of every window (review, eq. 6 and 21).
Motion depends on ψ by θ = Bψ alone, so sensitivities are taken with respect to θ and nothing depends on the choice of B. Each step is
solved by `consistent.maximum_a_posteriori` with the linearised simulation error as further rows: every iterate is a robot that
could exist, and the second term, what equation error says with its own certainty, keeps it from leaving that. The noise of torque
enters both terms, so that no covariance is given: intervals stay those of the equation error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import UnusableInput
from . import consistency, forward_dynamics, simulation_error
from .consistency import Bounds, Prior
from .estimators import Estimate
from .regression import IdentificationModel
from .simulation_error import SimulationWindows

Array = np.ndarray
STEPS = 8
ENOUGH = 1e-3
"""Relative decrease of the cost below which a step was the last."""
HALVINGS = 6


@dataclass(frozen=True)
class Refinement:
    """psi: refined, physically consistent. Shape (P,). costs: what is minimised, at the start and after every step.

    states: of each group of windows, q and q̇ at the start as they fit best. Shape (W, 2n).
    """

    psi: Array
    costs: tuple[float, ...]
    states: tuple[Array, ...]


@dataclass(frozen=True)
class _Iterate:
    psi: Array
    states: tuple[Array, ...]


@dataclass(frozen=True)
class _Task:
    """What stays the same from step to step. weights: of position errors, by group. Shape (n,) [1/rad or 1/m]."""

    model: IdentificationModel
    groups: Sequence[SimulationWindows]
    root: Array
    target: Array
    prior: Prior
    bounds: Bounds | None
    weights: tuple[Array, ...]

    def cost(self, x: _Iterate) -> float:
        body, total = forward_dynamics.build_dynamics(self.model, x.psi), 0.0
        for windows, states, weight in zip(self.groups, x.states, self.weights, strict=True):
            total += 0.5 * float(
                np.sum(
                    (weight * (simulation_error.simulate_positions(body, windows, states) - windows.q)) ** 2
                )
            )
        return total + consistency.map_objective(
            self.model.parameters, self.root, self.target, self.prior, x.psi
        )

    def step(self, x: _Iterate) -> _Iterate:
        """The minimum of the problem linearised at x."""
        B = self.model.base.matrix
        theta, body = B @ x.psi, forward_dynamics.build_dynamics(self.model, x.psi)
        rows, target, moves = [self.root], [self.target], []
        for windows, states, weight in zip(self.groups, x.states, self.weights, strict=True):
            left, slopes, move = _eliminated(
                *simulation_error.simulate_sensitivities(body, windows, states), windows.q, weight
            )
            R: Array = np.linalg.qr(np.column_stack([slopes, slopes @ theta - left]), mode="r")  # type: ignore[assignment]
            rows.append(R[:, :-1] @ B)
            target.append(R[:, -1])
            moves.append(move)
        found = consistency.maximum_a_posteriori(
            self.model.parameters, np.vstack(rows), np.concatenate(target), self.prior, self.bounds
        )
        change = B @ found.psi - theta
        return _Iterate(
            found.psi, tuple(s + a + b @ change for s, (a, b) in zip(x.states, moves, strict=True))
        )


def refine(
    model: IdentificationModel,
    groups: Sequence[SimulationWindows],
    start: Array,
    data: Estimate,
    prior: Prior,
    bounds: Bounds | None = None,
    *,
    anchored: bool = True,
) -> Refinement:
    """ψ that foresees positions best. groups: by `forward.cut`. start: of equation error, physically consistent. Shape (P,).
    data, prior, bounds: as for it. anchored: whether the equation-error term is there.

    A position error counts by its RMS at the start, and a window of S positions as (tr C)²/tr C² of them, C the covariance of its errors:
    neighbours in time say nearly the same (Satterthwaite 1946). Raises UnusableInput where there is no window and where the
    starting parameters lose one.
    """
    if not groups:
        raise UnusableInput(
            "refinement: no recording is as long as one window and the ends a filter spoils; take a shorter horizon"
        )
    soft = simulation_error.widen_friction(model, start, groups)
    body = forward_dynamics.build_dynamics(soft, start)
    for windows in groups:
        if (joint := _lost(body, windows)) is not None:
            raise UnusableInput(
                f"refinement: the identified model loses the recorded motion within a window, joint '{model.robot.joints[joint]}' first; "
                "take a shorter horizon, or a motion that shows that joint's inertia"
            )
    root, target = data.root @ model.base.matrix, data.root @ data.theta
    kept = slice(None) if anchored else slice(0)
    weights = tuple(_weight(body, windows) for windows in groups)
    task = _Task(soft, groups, root[kept], target[kept], prior, bounds, weights)
    x = _Iterate(start, tuple(windows.states for windows in groups))
    costs = [task.cost(x)]
    for _ in range(STEPS):
        x, now = _searched(task, x, task.step(x), costs[-1])
        costs.append(now)
        if costs[-2] - now <= ENOUGH * costs[-2]:
            break
    return Refinement(x.psi, tuple(costs), x.states)


def _lost(body: forward_dynamics.RobotDynamics, windows: SimulationWindows) -> int | None:
    """The joint that is furthest off in the last position before the first window is lost; None where none is."""
    errors = np.abs(simulation_error.simulate_positions(body, windows, windows.states) - windows.q)
    first = int(np.isfinite(errors).all(axis=2).sum(axis=1).min())
    if first == errors.shape[1]:
        return None
    last = errors[:, first - 1]
    return int(np.argmax(np.max(last[~np.isfinite(errors[:, first]).all(axis=1)], axis=0)))


def _searched(task: _Task, x: _Iterate, to: _Iterate, now: float) -> tuple[_Iterate, float]:
    """The furthest of x + (to − x)/2ᵏ that costs less, or x itself. Parameters between two consistent ones are consistent."""
    for k in range(HALVINGS):
        part = 0.5**k
        trial = _Iterate(
            x.psi + part * (to.psi - x.psi),
            tuple(a + part * (b - a) for a, b in zip(x.states, to.states, strict=True)),
        )
        cost = task.cost(trial)
        if cost < now:
            return trial, cost
    return x, now


def _eliminated(
    q: Array, slopes: Array, measured: Array, weight: Array
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Weighted errors and their slopes by θ, less what initial states take up, and how the states follow: a + b δθ.

    Shapes (W, S, n), (W, S, n, 2n + p) -> (m,), (m, p), ((W, 2n), (W, 2n, p)).
    """
    W, states = len(q), 2 * q.shape[2]
    error = (weight * (q - measured)).reshape(W, -1, 1)
    slopes = (weight[:, None] * slopes).reshape(W, error.shape[1], -1)
    Q, R = np.linalg.qr(slopes[:, :, :states])
    joined = np.concatenate([error, slopes[:, :, states:]], axis=2)
    taken = np.swapaxes(Q, 1, 2) @ joined
    moves = -np.linalg.solve(R, taken)
    left = (joined - Q @ taken).reshape(-1, joined.shape[2])
    return left[:, 0], left[:, 1:], (moves[:, :, 0], moves[:, :, 1:])


def _weight(body: forward_dynamics.RobotDynamics, windows: SimulationWindows) -> Array:
    """Weight of a position error of each joint. Shape (n,)."""
    n = windows.q.shape[2]
    q, slopes = simulation_error.simulate_sensitivities(body, windows, windows.states)
    left, _, _ = _eliminated(q, slopes, windows.q, np.ones(n))
    errors = left.reshape(windows.q.shape)
    out = np.empty(n)
    for joint in range(n):
        C = errors[:, :, joint].T @ errors[:, :, joint] / len(windows)
        power = max(float(np.trace(C)), 1e-24)
        alike = power**2 / max(float(np.sum(C * C)), 1e-300)
        freedom = max(len(C) - 2, 1)  # two went into the initial state
        out[joint] = np.sqrt(alike / len(C) * freedom / power)
    return out
