"""A feasible start is found, not hoped for: a pose that can be held, then as much motion as the limits allow."""

from __future__ import annotations

import numpy as np

from ..collision.clearance_constraint import Clearance
from ..errors import Infeasible, UnusableInput
from ..robot.inertial_parameters import ranges
from .evaluator import ConstraintRows, Evaluator
from .problem import DesignProblem

Array = np.ndarray
COMFORTABLE_ROW_VALUE = 0.95
"""Largest row value of a pose or start that counts as comfortably inside the limits."""
CLEARANCE_SCALING = 2.5
"""Clearance counts as so much roomier: a row's unit is many margins, and neighbours may never be more than two of them apart."""
POSES_PER_LINE = 60
"""Poses at which a straight line from the start pose is looked at."""


def stationary_variables(problem: DesignProblem, pose: Array) -> Array:
    """Variables of the motion that stays at `pose`."""
    x = np.zeros(problem.size)
    table = x[: problem.scale.size].reshape(problem.scale.shape)
    table[:, -1] = pose / problem.scale[:, -1]
    if problem.options.free_period is not None:
        x[-1] = 1.0
    return x


class _Poses:
    """Row values of poses held at rest, many at a time: the samples of an evaluator stand for poses."""

    def __init__(self, evaluator: Evaluator) -> None:
        self.evaluator = evaluator

    def worst(self, poses: Array) -> Array:
        """Largest row value of each pose. Shapes (N, n) -> (N,)."""
        return np.max(
            [
                _eased(kind, values).max(axis=(0, 2))
                for kind, values in self.evaluator.static_constraint_values(poses).items()
            ],
            axis=0,
        )

    def worst_of(self, pose: Array) -> tuple[str, int, float]:
        """Kind, joint and value of the row that binds most at one pose."""
        table = self.evaluator.static_constraint_values(np.tile(pose, (self.evaluator.problem.options.samples, 1)))
        kind = max(table, key=lambda k: float(table[k][:, 0].max()))
        joint = int(np.argmax(table[kind][:, 0].max(axis=0)))
        return kind, joint, float(table[kind][:, 0].max())


def _eased(kind: str, values: Array) -> Array:
    return (
        np.where(values < 1.0, 1.0 - CLEARANCE_SCALING * (1.0 - values), values)
        if kind == "clearance"
        else values
    )


def find_static_poses(evaluator: Evaluator, rng: np.random.Generator, tries: int = 4) -> Array:
    """Poses that can be held with room to spare, the roomiest first. Shape (m, n), m ≥ 1.

    Random poses first; when none has room, the best is improved by a gradient method.
    Raises UnusableInput when gravity alone exceeds a torque limit everywhere, Infeasible when other limits fight.
    """
    problem = evaluator.problem
    limits, count = problem.limits, problem.options.samples
    lower, upper = ranges(limits).T
    holder = _Poses(evaluator)
    for attempt in range(tries):
        # the first attempt stays in the middle of the ranges, where there is room to move
        share = 0.6 if attempt == 0 else 1.0
        middle = 0.5 * (lower + upper)
        candidates = middle + share * (rng.uniform(lower, upper, (count, len(lower))) - middle)
        if problem.start_pose is not None and problem.clearance is not None:
            candidates = _within_sight(problem.clearance, problem.start_pose, candidates, rng)
        worst = holder.worst(candidates)
        good = worst < COMFORTABLE_ROW_VALUE
        if good.any():
            order = np.argsort(worst[good])
            return np.asarray(candidates[good][order])
    return _improved(evaluator, holder, candidates[np.argsort(worst)[:8]])


def _within_sight(
    clearance: Clearance, home: Array, poses: Array, rng: np.random.Generator
) -> Array:
    """Poses on the straight lines from home to others, before anything is in the way. Shape (N, n).

    Folds and obstacles part the joint space: a motion that begins elsewhere may be out of reach.
    """
    share = np.linspace(0.0, 1.0, POSES_PER_LINE + 1)
    lines = home + share[:, None] * (poses - home)[:, None]
    clear = clearance.least(lines.reshape(-1, len(home)))[0].reshape(lines.shape[:2]) > 0.0
    far = np.logical_and.accumulate(clear, axis=1).sum(axis=1) - 1
    return np.asarray(home + rng.uniform(0.0, share[np.maximum(far, 0)])[:, None] * (poses - home))


def _improved(evaluator: Evaluator, holder: _Poses, candidates: Array) -> Array:
    """Lower the largest row value of the best poses by sequential quadratic programming on max g ≤ s, within the joint ranges."""
    best, best_value = candidates[0], np.inf
    for pose in candidates:
        found = _least_worst(evaluator, pose)
        value = float(holder.worst(np.tile(found, (evaluator.problem.options.samples, 1)))[0])
        if value < best_value:
            best, best_value = found, value
        if best_value < COMFORTABLE_ROW_VALUE:
            break
    if best_value >= 1.0 - 1e-3:
        _refuse(evaluator.problem, holder, best)
    return best[None, :]


def _least_worst(evaluator: Evaluator, pose: Array) -> Array:
    from scipy import optimize  # rarely needed, slow to import

    problem = evaluator.problem
    n = problem.robot.n
    columns = np.arange(n) * problem.scale.shape[1] + problem.scale.shape[1] - 1
    position = (
        evaluator.kinds.index("position") if "position" in evaluator.kinds else -1
    )  # kept as bounds instead
    first = np.zeros(problem.options.samples, bool)
    first[0] = True

    def rows_at(z: Array) -> tuple[Array, Array]:
        x = stationary_variables(problem, z[:n])
        table = evaluator.constraint_values(x)
        mask = np.concatenate(
            [np.broadcast_to(first[None, :, None], v.shape).ravel() for v in table.values()]
        )
        rows: ConstraintRows = evaluator.rows(mask)
        values = evaluator.row_values(x, rows)
        keep = np.isfinite(values) & (rows.kind != position)
        slopes = evaluator.row_gradients(x, rows)[:, columns] / problem.scale[:, -1]
        return values[keep], slopes[keep]

    slack = rows_at(np.append(pose, 0.0))[0].max()
    result = optimize.minimize(
        lambda z: z[-1],
        np.append(pose, slack),
        jac=lambda z: np.append(np.zeros(n), 1.0),
        constraints={
            "type": "ineq",
            "fun": lambda z: z[-1] - rows_at(z)[0],
            "jac": lambda z: np.column_stack([-(s := rows_at(z)[1]), np.ones(len(s))]),
        },
        bounds=[*problem.limits.position, (None, None)],
        method="SLSQP",
        options={"maxiter": 60},
    )
    return np.asarray(result.x[:n])


def _refuse(problem: DesignProblem, holder: _Poses, pose: Array) -> None:
    kind, joint, value = holder.worst_of(pose)
    robot = problem.robot
    if kind == "torque":
        r = problem.options.uncertainty
        hint = f" (with --uncertainty {r:g}; try less)" if r else ""
        text = (
            f"{robot.source}: joint '{robot.joints[joint]}': gravity asks {value:.3g} times its torque limit "
            f"{problem.limits.torque[joint]:.4g} in the best pose found{hint}; raise the limit or lighten the payload"
        )
        raise Infeasible(text) if problem.boxes else UnusableInput(text)
    if kind == "clearance":
        assert problem.clearance is not None
        raise Infeasible(
            f"{robot.source}: no pose found keeps the clearance of {problem.clearance.names[joint]}; "
            "clear the scene, lower --clearance, or widen the position limits"
        )
    name = problem.boxes[int(kind[3:])].frame if kind.startswith("box") else robot.joints[joint]
    raise Infeasible(
        f"{robot.source}: no pose obeys all limits: the {kind.rstrip('0123456789')} limit of '{name}' fights the others "
        f"(best reaches {value:.3g} times it); widen the box or the position limits"
    )


def scale_random_motion(evaluator: Evaluator, pose: Array, rng: np.random.Generator) -> Array:
    """A random motion around `pose`, as large as the limits allow. Returns feasible variables."""
    problem = evaluator.problem
    rest = stationary_variables(problem, pose)
    K = problem.options.harmonics
    amplitude = rng.normal(size=(problem.robot.n, 2, K)) / np.sqrt(np.arange(1, K + 1))
    step = np.zeros(problem.size)
    step[: problem.scale.size].reshape(problem.scale.shape)[:, : 2 * K] = amplitude.reshape(
        problem.robot.n, -1
    )
    low, high = 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        if evaluator.max_constraint_value(rest + middle * step) < COMFORTABLE_ROW_VALUE + 0.04:
            low = middle
        else:
            high = middle
        if low > 0.0 and high - low < 0.1 * low:
            break
    return np.asarray(rest + low * step)
