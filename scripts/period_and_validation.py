"""Measure the benefit of the default period, the time budget and the validation motion.

1. Predicted standard deviations (root of the geometric A criterion over the seconds of excitation):
   of the default period against 10 s for equal time, and of the motion that is planned for a time
   budget against the default motion repeated to fill it.
2. For several weights of the overlap, means over seeds: overlap of a second motion with the first,
   increase of its standard deviation, and torque error of a model that is fitted to the first
   motion when friction depends on position, over the error of the fit itself. Weight 0 is merely
   another start.
"""

from __future__ import annotations

import argparse
import warnings
from functools import partial

import numpy as np

from excite._types import FloatArray
from excite.designer import motion_overlap, optimize, pipeline, time_budget
from excite.designer.motion_overlap import StateScaling
from excite.designer.optimize import DesignSetup
from excite.designer.options import DesignOptions
from excite.designer.pipeline import CertifiedDesign
from excite.designer.time_budget import MotionRequest
from excite.errors import ExciteWarning
from excite.robot import dynamics, limits, robot
from excite.trajectory.fourier import FourierSeries


def deviation(delivery: CertifiedDesign) -> float:
    """Return the predicted standard deviation of the parameters, up to a factor of robot and rate.

    Only the periodic part of the motion counts.
    """
    motion = delivery.trajectory.motion
    value: float = delivery.trajectory.criteria["optimum"]["geometric"]["a"]
    return float(np.sqrt(value / (motion.periods * motion.fourier.period)))


def periods(name: str, options: DesignOptions, budget: float) -> str:
    """Return a row of the first table."""
    machine = robot.load(name)
    table = limits.resolve(machine)
    run = partial(pipeline.design_trajectory, machine, table)
    default, ten_seconds = (
        run(request.complete(options, table))
        for request in (MotionRequest(), MotionRequest(period=10.0))
    )
    planned = time_budget.plan_for_budget(machine, table, options, MotionRequest(), budget)
    filled = time_budget.run_plan(planned, options, run)
    motion, period = filled.trajectory.motion, default.trajectory.motion.fourier.period
    ramps = default.trajectory.motion.duration - 2.0 * period
    repeated = deviation(default) * np.sqrt(2.0 / int((budget - ramps) / period))
    # for equal time, the ratio for equal numbers of periods times the root of the ratio of periods
    equal = deviation(default) / deviation(ten_seconds) * np.sqrt(period / 10.0)
    chosen = f"{motion.periods} × {motion.fourier.period:g} s, {motion.fourier.harmonics} harmonics"
    chosen += f", {motion.duration:.1f} s"
    seconds = sum(c.seconds for c in planned.candidates)
    against_repeated = deviation(filled) / repeated
    return (
        f"| {name} | {period:g} | {equal:.2f} | {chosen} | {against_repeated:.2f} | {seconds:.1f} |"
    )


def regressor(
    setting: DesignSetup, motion: FourierSeries
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return regressor rows over noise in base coordinates, and the states of a period."""
    problem = setting.problem
    samples = motion.samples(motion.grid(problem.options.samples))
    Y = dynamics.regressor(problem.robot, problem.parameters, samples) / setting.noise[:, None]
    return Y.reshape(-1, Y.shape[2]) @ setting.base.geometric, samples.q, samples.dq


def held_out(setting: DesignSetup, first: FourierSeries, second: FourierSeries) -> float:
    """Return the error of position-dependent friction on a second motion over that of the fit."""
    rng, squares = np.random.default_rng(0), np.zeros(2)
    regressors = [regressor(setting, motion) for motion in (first, second)]
    for _ in range(20):
        phase, order = rng.uniform(0.0, 2.0 * np.pi, first.n), rng.integers(1, 3, first.n)
        torque = [
            (np.sin(order * q + phase) * np.tanh(dq / 0.02)).ravel() for _, q, dq in regressors
        ]
        solution = np.linalg.lstsq(regressors[0][0], torque[0], rcond=1e-6)[0]
        squares += [
            np.mean((t - rows @ solution) ** 2)
            for t, (rows, _, _) in zip(torque, regressors, strict=True)
        ]
    return float(np.sqrt(squares[1] / squares[0]))


def second_motions(name: str, options: DesignOptions, weights: list[float], seeds: int) -> str:
    """Return a row of the second table."""
    machine = robot.load(name)
    table = limits.resolve(machine)
    gauge = StateScaling.for_robot(machine, table)
    sums = np.zeros((len(weights), 3))
    for seed in range(seeds):
        filled = MotionRequest().complete(
            DesignOptions(starts=options.starts, seed=seed, jobs=options.jobs), table
        )
        setting = optimize.set_up(machine, table, filled)
        first = optimize.solve(setting)
        for k, weight in enumerate(weights):
            penalty = motion_overlap.penalise_overlap(gauge, first.motion, weight)
            second = optimize.solve(
                optimize.set_up(machine, table, filled, overlap_penalty=penalty)
            )
            common = motion_overlap.compute_overlap(gauge, first.motion, second.motion)
            increase = second.attempts[0].objective - weight * common - first.attempts[0].objective
            sums[k] += (
                common,
                np.expm1(0.5 * increase),
                held_out(setting, first.motion, second.motion),
            )
    cells = [f"{a:.2f}, {100.0 * b:+.1f} %, {c:.2f}" for a, b, c in sums / seeds]
    return f"| {name} | " + " | ".join(cells) + " |"


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robots", nargs="*", default=list(robot.builtin_names()))
    parser.add_argument(
        "--time", type=float, default=60.0, help="budget of robot time [s] (default %(default)g)"
    )
    parser.add_argument(
        "--weights",
        type=float,
        nargs="+",
        default=[0.0, motion_overlap.OVERLAP_WEIGHT, 2.0 * motion_overlap.OVERLAP_WEIGHT],
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--starts", type=int, default=2)
    parser.add_argument("--jobs", type=int, default=-1)
    given = parser.parse_args()
    warnings.simplefilter("ignore", ExciteWarning)
    options = DesignOptions(starts=given.starts, jobs=given.jobs)
    print(
        f"| robot | default period [s] | relative to 10 s | planned for {given.time:g} s "
        "| relative to default, repeated | planning [s] |"
    )
    print("|---|---:|---:|---|---:|---:|")
    for name in given.robots:
        print(periods(name, options, given.time), flush=True)
    print(
        "\n| overlap, standard deviation, held-out over fit's error at weight | "
        + " | ".join(f"{w:g}" for w in given.weights)
        + " |"
    )
    print("|---" * (len(given.weights) + 1) + "|")
    for name in given.robots:
        print(second_motions(name, options, given.weights, given.seeds), flush=True)


if __name__ == "__main__":
    main()
