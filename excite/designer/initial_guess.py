"""Construct a feasible initial guess.

Find a static pose inside all limits, then scale a random motion around it until a limit becomes
active.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from .._types import FloatArray
from ..collision.clearance_constraint import ClearanceConstraint
from ..errors import Infeasible, UnusableInput
from ..robot.inertial_parameters import ranges
from .evaluator import BOX, ConstraintRows, Evaluator
from .problem import DesignProblem

COMFORTABLE_ROW_VALUE = 0.95
"""Largest constraint value of a static pose to start from [1]."""

MAX_INITIAL_ROW_VALUE = 0.99
"""Largest constraint value of the initial motion where its pose has more slack [1]."""

POSE_SLACK_SHARE = 0.8
"""Share of the slack of a constraint at the pose that the initial motion may use up where the
slack is little [1]."""

USUAL_SLACK = 0.25
"""Slack at which a constraint counts as satisfied with ease [1]; constraints that reach less in
nine of ten poses are judged by what they reach."""

RANGE_SHARE = 0.97
"""Share of the position ranges in which poses are improved [1], so that a pose at the end of a
range does not hide the constraint that drove it there."""

AMPLITUDE_STEPS = 12
"""Bisections of the amplitude of the initial motion."""

AMPLITUDE_TOLERANCE = 0.1
"""Relative tolerance of that amplitude [1]."""

CLEARANCE_SCALING = 2.5
"""Factor on the slack of clearance constraints of static poses [1].

Their unit is many times the required clearance, and neighbouring bodies may never be more than two
units apart, so that without it no pose would count as comfortable.
"""

FLOOR_NAME = " floor"
"""End of the name of a pair of bodies of which one is the floor."""

POSES_PER_LINE = 60
"""Steps along the straight line from the start pose on which clearance is checked [1]."""


def stationary_variables(problem: DesignProblem, pose: FloatArray) -> FloatArray:
    """Return the variables of a robot at rest at `pose`. Shape (size,)."""
    x = np.zeros(problem.size)
    table = x[: problem.scale.size].reshape(problem.scale.shape)
    table[:, -1] = pose / problem.scale[:, -1]
    if problem.options.free_period is not None:
        x[-1] = 1.0
    return x


def _max_values(evaluator: Evaluator, poses: FloatArray) -> FloatArray:
    """Return the largest constraint value of each pose at rest. Shape (N,).

    Args:
        evaluator: Evaluator of the design problem.
        poses: As many poses as the problem has samples. Shape (N, n).
    """
    return np.max(
        [
            _scale_slack(kind, values).max(axis=(0, 2))
            for kind, values in evaluator.static_constraint_values(poses).items()
        ],
        axis=0,
    )


def _relative_max_values(evaluator: Evaluator, poses: FloatArray) -> FloatArray:
    """Return the largest constraint value of each pose, by what each constraint can reach.

    Bodies that are close by construction leave little slack at all poses, and a constant constraint
    the same at all; both would outweigh all others. Shape (N,).
    """
    worst = np.full(len(poses), -np.inf)
    for kind, values in evaluator.static_constraint_values(poses).items():
        scaled = _scale_slack(kind, values)
        reached = np.quantile(1.0 - scaled, 0.9, axis=1, keepdims=True)
        tight = (scaled < 1.0) & (reached < USUAL_SLACK) & (reached > 0.0)
        relative = 1.0 - USUAL_SLACK * (1.0 - scaled) / np.where(reached > 0.0, reached, 1.0)
        worst = np.maximum(worst, np.where(tight, relative, scaled).max(axis=(0, 2)))
    return worst


def _scale_slack(kind: str, values: FloatArray) -> FloatArray:
    """Scale the slack of clearance constraints."""
    return (
        np.where(values < 1.0, 1.0 - CLEARANCE_SCALING * (1.0 - values), values)
        if kind == "clearance"
        else values
    )


def find_static_poses(evaluator: Evaluator, rng: np.random.Generator, tries: int = 4) -> FloatArray:
    """Find static poses well inside all limits.

    Random poses are tried first; if none suffices, the best ones are improved by optimisation.

    Args:
        evaluator: Evaluator of the design problem.
        rng: Random number generator.
        tries: Number of batches of random poses.

    Returns:
        Poses, the one with the most slack first. Shape (m, n), m ≥ 1.

    Raises:
        UnusableInput: Gravity alone exceeds a torque limit in all poses.
        Infeasible: No pose keeps all other limits.
    """
    problem = evaluator.problem
    limits, count = problem.limits, problem.options.samples
    lower, upper = ranges(limits).T
    feasible: list[FloatArray] = []
    for attempt in range(tries):
        # the first batch stays in the middle of the ranges, where motions can be large
        share = 0.6 if attempt == 0 else 1.0
        middle = 0.5 * (lower + upper)
        candidates = middle + share * (rng.uniform(lower, upper, (count, len(lower))) - middle)
        if problem.start_pose is not None and problem.clearance is not None:
            candidates = reachable_along_lines(
                problem.clearance, problem.start_pose, candidates, rng
            )
        worst = _max_values(evaluator, candidates)
        good = worst < COMFORTABLE_ROW_VALUE
        if good.any():
            order = np.argsort(worst[good])
            return np.asarray(candidates[good][order])
        relative = _relative_max_values(evaluator, candidates)
        good = relative < COMFORTABLE_ROW_VALUE
        feasible += list(candidates[good][np.argsort(relative[good])])
    if feasible:
        return np.array(feasible)
    return _improved(evaluator, candidates[np.argsort(worst)[:8]])


def reachable_along_lines(
    clearance: ClearanceConstraint,
    start_pose: FloatArray,
    poses: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Move poses towards the start pose until the straight lines between them are clear.

    Obstacles divide the joint space, so a motion around another pose might be unreachable.

    Args:
        clearance: Bodies that have to keep their distance.
        start_pose: Start pose. Shape (n,).
        poses: Poses. Shape (N, n).
        rng: Random number generator, for the place on the clear part of each line.

    Returns:
        Poses on the clear parts of the lines. Shape (N, n).
    """
    share = np.linspace(0.0, 1.0, POSES_PER_LINE + 1)
    lines = start_pose + share[:, None] * (poses - start_pose)[:, None]
    excess, _ = clearance.least_excess(lines.reshape(-1, len(start_pose)))
    clear = excess.reshape(lines.shape[:2]) > 0.0
    last_clear = np.logical_and.accumulate(clear, axis=1).sum(axis=1) - 1
    return np.asarray(
        start_pose
        + rng.uniform(0.0, share[np.maximum(last_clear, 0)])[:, None] * (poses - start_pose)
    )


def _improved(evaluator: Evaluator, candidates: FloatArray) -> FloatArray:
    """Improve poses by minimising their largest constraint value; return the best. Shape (1, n)."""
    best, best_value = candidates[0], np.inf
    for pose in candidates:
        improved = _minimise_largest(evaluator, pose)
        value = float(_max_values(evaluator, _repeated(evaluator, improved))[0])
        if value < best_value:
            best, best_value = improved, value
        if best_value < COMFORTABLE_ROW_VALUE:
            break
    if best_value >= 1.0 - 1e-3:
        _raise_infeasible(evaluator, best)
    return best[None, :]


def _repeated(evaluator: Evaluator, pose: FloatArray) -> FloatArray:
    """Return a pose at all samples. Shape (N, n)."""
    return np.tile(pose, (evaluator.problem.options.samples, 1))


def _minimise_largest(evaluator: Evaluator, pose: FloatArray) -> FloatArray:
    """Minimise s subject to g ≤ s over poses within the joint ranges, by SLSQP. Shape (n,)."""
    from scipy import optimize  # rarely needed, slow to import

    # all samples of a robot at rest are equal
    options = dataclasses.replace(evaluator.problem.options, samples=1)
    evaluator = Evaluator(dataclasses.replace(evaluator.problem, options=options))
    problem = evaluator.problem
    n = problem.robot.n
    columns = np.arange(n) * problem.scale.shape[1] + problem.scale.shape[1] - 1
    # position limits are bounds of the optimiser instead of constraints
    position = evaluator.kinds.index("position") if "position" in evaluator.kinds else -1

    def rows_at(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        x = stationary_variables(problem, z[:n])
        rows: ConstraintRows = evaluator.rows(x, evaluator.rows_above(x, -np.inf))
        values = evaluator.row_values(x, rows)
        keep = np.isfinite(values) & (rows.kind != position)
        slopes = evaluator.row_gradients(x, rows)[:, columns] / problem.scale[:, -1]
        return values[keep], slopes[keep]

    slack = rows_at(np.append(pose, 0.0))[0].max()
    result = optimize.minimize(
        lambda z: z[-1],
        np.append(np.clip(pose, *_inner_range(problem.limits.position).T), slack),
        jac=lambda z: np.append(np.zeros(n), 1.0),
        constraints={
            "type": "ineq",
            "fun": lambda z: z[-1] - rows_at(z)[0],
            "jac": lambda z: np.column_stack([-(s := rows_at(z)[1]), np.ones(len(s))]),
        },
        bounds=[*_inner_range(problem.limits.position), (None, None)],
        method="SLSQP",
        options={"maxiter": 60},
    )
    return np.asarray(result.x[:n])


def _inner_range(position: FloatArray) -> FloatArray:
    """Return the middle share of position ranges; unbounded ones stay. Shape (n, 2) -> (n, 2)."""
    lower, upper = position.T
    trimmed = 0.5 * (1.0 - RANGE_SHARE) * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    return np.column_stack([lower + trimmed, upper - trimmed])


def _raise_infeasible(evaluator: Evaluator, pose: FloatArray) -> None:
    """Raise the error that names the constraint which no pose keeps."""
    table = evaluator.static_constraint_values(_repeated(evaluator, pose))
    largest = {kind: values[:, 0].max(axis=0) for kind, values in table.items()}
    kind = max(largest, key=lambda k: float(largest[k].max()))
    joint, value = int(np.argmax(largest[kind])), float(largest[kind].max())
    problem, robot = evaluator.problem, evaluator.problem.robot
    if kind == "torque":
        r = problem.options.uncertainty
        hint = f" (with --uncertainty {r:g}; try less)" if r else ""
        text = (
            f"{robot.source}: joint '{robot.joints[joint]}': gravity requires {value:.3g} times "
            f"its torque limit {problem.limits.torque[joint]:.4g} in the best pose found{hint}; "
            "raise the limit or lighten the payload"
        )
        raise Infeasible(text) if problem.boxes else UnusableInput(text)
    if kind == "clearance":
        assert problem.clearance is not None
        pair = problem.clearance.names[joint]
        remedy = (
            "give the floor's height with --floor, or --no-floor"
            if pair.endswith(FLOOR_NAME)
            else "clear the scene"
        )
        raise Infeasible(
            f"{robot.source}: no pose keeps the clearance of {pair}; "
            f"{remedy}, lower --clearance, or widen the position limits"
        )
    name = problem.boxes[joint // 3].frame if kind == BOX else robot.joints[joint]
    raise Infeasible(
        f"{robot.source}: no pose keeps all limits: the {kind} limit of "
        f"'{name}' conflicts with the others (the best pose reaches {value:.3g} times it); "
        "widen the box or the position limits"
    )


def scale_random_motion(
    evaluator: Evaluator, pose: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return a random motion around a pose, scaled until a limit becomes active.

    Args:
        evaluator: Evaluator of the design problem.
        pose: Static pose inside all limits. Shape (n,).
        rng: Random number generator.

    Returns:
        Variables of the motion, which is feasible; at rest if the pose is not. Shape (size,).
    """
    problem = evaluator.problem
    stationary = stationary_variables(problem, pose)
    K = problem.options.harmonics
    amplitude = rng.normal(size=(problem.robot.n, 2, K)) / np.sqrt(np.arange(1, K + 1))
    step = np.zeros(problem.size)
    step[: problem.scale.size].reshape(problem.scale.shape)[:, : 2 * K] = amplitude.reshape(
        problem.robot.n, -1
    )
    allowed = {
        kind: np.maximum(MAX_INITIAL_ROW_VALUE, 1.0 - (1.0 - POSE_SLACK_SHARE) * (1.0 - values))
        for kind, values in evaluator.constraint_values(stationary).items()
    }
    low, high = 0.0, 1.0
    for _ in range(AMPLITUDE_STEPS):
        middle = 0.5 * (low + high)
        values = evaluator.constraint_values(stationary + middle * step)
        if all((values[kind] < allowed[kind]).all() for kind in values):
            low = middle
        else:
            high = middle
        if low > 0.0 and high - low < AMPLITUDE_TOLERANCE * low:
            break
    return np.asarray(stationary + low * step)
