"""Compare geometric and plain design criteria by the errors of identified parameters.

For each robot, trajectories are designed for geometric and plain A-, D-, E-optimality and condition
number, and for the regressor's condition number. The table has (1) all criteria of each, (2) the
error when a robot whose parameters differ from the nominal ones is recorded with noise and
identified, with known truth: in the metric, and as torque on other motions.
"""

from __future__ import annotations

import argparse
import sys
import warnings

import numpy as np

from excite._types import FloatArray
from excite.designer import criteria, optimize
from excite.designer.criteria import Criterion
from excite.designer.options import DesignOptions
from excite.errors import ExciteWarning
from excite.robot import dynamics, limits, robot
from excite.trajectory.fourier import FourierSeries


def designs(name: str, starts: int, seed: int) -> dict[str, optimize.OptimizedDesign]:
    """Design for every criterion, geometric and plain."""
    machine = robot.load(name)
    table = limits.resolve(machine)
    out = {}
    for criterion in Criterion:
        for plain in (False, True):
            if criterion is Criterion.COND_REGRESSOR and plain:
                continue
            kind = (
                ""
                if criterion is Criterion.COND_REGRESSOR
                else ("plain " if plain else "geometric ")
            )
            options = DesignOptions(criterion=criterion, plain=plain, starts=starts, seed=seed)
            print(f"{name}: {kind}{criterion.value}", file=sys.stderr, flush=True)
            out[kind + criterion.value] = optimize.solve(optimize.set_up(machine, table, options))
    return out


def whitened_regressor(
    design: optimize.OptimizedDesign, motion: FourierSeries, samples: int
) -> FloatArray:
    """Return the regressor rows of one period over the noise, shape (samples·n, P)."""
    problem = design.setup.problem
    Y = dynamics.regressor(problem.robot, problem.parameters, motion.samples(motion.grid(samples)))
    return (Y / design.setup.noise[:, None]).reshape(-1, Y.shape[2])


def estimation_errors(
    design: optimize.OptimizedDesign,
    others: FloatArray,
    draws: int,
    spread: float,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Return the RMS error in the metric, and the RMS torque error over noise on other motions.

    The truth is nominal plus a normal deviation of size `spread` per direction of the metric. The
    estimate is maximum a posteriori with that prior (METHOD eq. 21 with the distance of eq. 18)
    from the recorded periods at 100 Hz.
    """
    problem, base = design.setup.problem, design.setup.base
    options = problem.options
    rows = (
        whitened_regressor(design, design.motion, round(options.period * options.rate))
        @ base.geometric
        * np.sqrt(options.periods)
    )
    _, singular, right = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    truth = spread * rng.normal(size=(draws, base.count))
    measured = singular * (truth @ right.T) + rng.normal(size=truth.shape)
    estimate = (measured * singular / (singular**2 + spread**-2)) @ right
    error = estimate - truth
    torque = error @ (others @ base.geometric).T
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), float(np.sqrt(np.mean(torque**2)))


def random_motion_rows(
    design: optimize.OptimizedDesign, count: int, rng: np.random.Generator
) -> FloatArray:
    """Return regressor rows of random feasible motions, for held-out torque."""
    from excite.designer import initial_guess
    from excite.designer.evaluator import Evaluator

    evaluator = Evaluator(design.setup.problem)
    rows = []
    for _ in range(count):
        static_poses = initial_guess.find_static_poses(evaluator, rng)
        x = initial_guess.scale_random_motion(
            evaluator, static_poses[rng.integers(len(static_poses))], rng
        )
        rows.append(whitened_regressor(design, design.setup.problem.fourier(x), 50))
    return np.vstack(rows)


def report(name: str, arguments: argparse.Namespace) -> None:
    """Print both tables of one robot."""
    results = designs(name, arguments.starts, arguments.seed)
    first = next(iter(results.values()))
    other_rows = random_motion_rows(first, 20, np.random.default_rng(12345))
    columns = [("geometric", c) for c in ("a", "d", "e", "cond")] + [
        ("plain", c) for c in ("a", "d", "e", "cond")
    ]
    print(
        f"\n### {name}\n\n| designed for | "
        + " | ".join(f"{k} {c}" for k, c in columns)
        + " | cond_regressor | error in the metric | held-out torque / noise |"
    )
    print("|---" * (len(columns) + 4) + "|")
    for title, design in results.items():
        problem = design.setup.problem
        Y = dynamics.regressor(
            problem.robot,
            problem.parameters,
            design.motion.samples(design.motion.grid(problem.options.samples)),
        )
        scores = criteria.evaluate_criteria(Y, design.setup.base, design.setup.noise)
        cells = [
            criteria.select_criterion(scores, Criterion(c), plain=k == "plain") for k, c in columns
        ]
        cells.append(criteria.select_criterion(scores, Criterion.COND_REGRESSOR, plain=True))
        metric, torque = estimation_errors(
            design,
            other_rows,
            arguments.draws,
            arguments.spread,
            np.random.default_rng(arguments.seed),
        )
        print(
            f"| {title} | "
            + " | ".join(f"{value:.4g}" for value in cells)
            + f" | {metric:.4f} | {torque:.4f} |",
            flush=True,
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robots", nargs="*", default=["ur10e", "panda"])
    parser.add_argument("--starts", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument(
        "--spread",
        type=float,
        default=0.2,
        help="how far the true robot is from the nominal one, per direction of the metric",
    )
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", ExciteWarning)
    for name in arguments.robots:
        report(name, arguments)


if __name__ == "__main__":
    main()
