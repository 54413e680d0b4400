"""Time and memory that a design takes, estimated before it begins.

An iteration of the optimiser costs, on one core (K harmonics, N samples, n joints, P standard and p
base parameters, V = n (2K + 1) variables, A pairs of a joint and a joint on its way to the base,
itself included):

    t = 6e-4 s + N (1.8e-6 A + 3.6e-8 n P + 1.6e-10 n p²) s + 5.8e-10 V³ s

The terms are the regressor and its derivative, passes over it, its products with itself, and the
quadratic subproblem. A start takes about 100 iterations to its end, and a finished motion as many
again for its ramps and for what its certificate finds between samples. A process holds eight
regressors (N n P) and the gradients of the active rows, about 2.4 for each sample and joint:

    m = 160 MB + 8 bytes · N n (8.2 P + 2.4 V)

`scripts/bench_scale.py` measured the coefficients on chains and trees of 2 to 60 joints with 100 to
50,000 samples and 5 to 100 harmonics, of which an iteration's time is met within a factor of 1.5
and memory within 1.4.
"""

from __future__ import annotations

from collections.abc import Callable

import joblib

from .._system.resources import Cost
from ..errors import UnusableInput
from ..robot.robot import Robot
from ..schemas.trajectory import MAX_ROWS
from .options import DesignOptions

FIXED_TIME = 6e-4
"""Time of an iteration whatever its size [s]."""
PAIR_TIME = 1.8e-6
"""Time per sample and pair of a joint and a joint on its way to the base [s]."""
PASS_TIME = 3.6e-8
"""Time per number of a regressor [s]."""
PRODUCT_TIME = 1.6e-10
"""Time per sample, joint and pair of base parameters [s]."""
SUBPROBLEM_TIME = 5.8e-10
"""Time per cubed number of variables [s]."""
USUAL_ITERATIONS = 100
"""Iterations of a start until it gains next to nothing, and of the work on a finished motion."""
ROW_TIME = 2.5e-8
"""Time per number of the regressor along the exported motion and the certificate's dense grid
[s]."""
DENSE_GRIDS = 30
"""Rows of regressors that certificate and report compute, over the optimiser's samples."""
LONGEST_RAMPS = 20.0
"""Time that is left for the ramps of a motion at its file's end [s]."""
PROCESS_MEMORY = 1.6e8
"""Memory of a process with its libraries [bytes]."""
REGRESSORS = 8.2
"""Regressors of all samples that an evaluation holds."""
GRADIENTS = 2.4
"""Gradients of constraint rows, over samples times joints, that an iteration holds."""


def estimated(robot: Robot, options: DesignOptions) -> Cost:
    """Estimate what a design takes, its certificate and report included."""
    n, N, K = robot.n, float(options.samples), options.harmonics
    P = 10.0 * robot.model.nv + n * len(options.drive)
    p = min(P, 7.0 * robot.model.nv + n * len(options.drive))  # one joint shows at most seven more
    V = float(n * (2 * K + 1))
    pairs = float(sum(len(list(way)) - 1 for way in list(robot.model.supports)[1:]))
    per_sample = PAIR_TIME * pairs + PASS_TIME * n * P + PRODUCT_TIME * n * p**2
    iteration = FIXED_TIME + N * per_sample + SUBPROBLEM_TIME * V**3
    workers = min(joblib.effective_n_jobs(options.jobs), options.starts)
    rounds = -(-options.starts // workers)
    count = min(options.iterations, USUAL_ITERATIONS)
    rows = options.periods * options.period * options.rate
    after = ROW_TIME * n * P * (DENSE_GRIDS * N + 3.0 * rows)
    memory = workers * (PROCESS_MEMORY + 8.0 * N * n * (REGRESSORS * P + GRADIENTS * V))
    return Cost(iteration * count * (rounds + 1) + after, memory + 100.0 * rows * (1 + 4 * n))


def require(
    robot: Robot,
    options: DesignOptions,
    speed: float = 1.0,
    say: Callable[[str], None] | None = None,
) -> None:
    """Refuse a design that is too large for this machine or for a trajectory file.

    Args:
        robot: The robot.
        options: What was asked for.
        speed: Share of its speed at which the motion is delivered.
        say: Prints a line that announces a long design; None: nothing is announced.

    Raises:
        UnusableInput: The design is too large; the line has the figure and what makes it smaller.
    """
    seconds = options.periods * options.period / speed + LONGEST_RAMPS
    if seconds * options.rate > MAX_ROWS:
        raise UnusableInput(
            f"--periods {options.periods} of {options.period:g} s with ramps at --rate "
            f"{options.rate:g} Hz "
            f"are {seconds * options.rate:.3g} rows, a trajectory has at most {MAX_ROWS}; lower "
            "one of them"
        )
    starts = "1 start" if options.starts == 1 else f"{options.starts} starts"
    size = f"{robot.n} joints, {options.harmonics} harmonics, {options.samples} samples"
    work = f"{robot.name}: {size}, {starts}"
    remedy = "move fewer joints (--joints), or use fewer --samples, --harmonics or --starts"
    estimated(robot, options).require(work, remedy, say)
