"""What the choices that excite makes for the user are worth: the period, a budget of robot time, a validation motion.

(1) Predicted standard deviations (the root of the geometric A criterion over the seconds of excitation): of the rule's
period beside 10 s for equal time, and of the motion planned for a budget beside the rule's, repeated to fill it.
(2) For several weights of the overlap, means over seeds: the overlap of a second motion with the first, how much
larger its standard deviation is, and the torque error it shows of a model fitted to the first motion when friction depends
on position, over the error that the fit itself leaves. Weight 0 is a mere other start.
"""

from __future__ import annotations

import argparse
import warnings
from functools import partial

import numpy as np

from excite.designer import motion_overlap, optimize, pipeline, time_budget
from excite.designer.motion_overlap import StateScaling
from excite.designer.optimize import DesignSetup
from excite.designer.pipeline import CertifiedDesign
from excite.designer.options import DesignOptions
from excite.designer.time_budget import MotionRequest
from excite.errors import ExciteWarning
from excite.robot import dynamics, limits, robot
from excite.trajectory.fourier import FourierSeries

Array = np.ndarray


def deviation(delivery: CertifiedDesign) -> float:
    """Of the parameters, from the periodic part; up to a factor that depends on the robot and the rate alone."""
    motion = delivery.trajectory.motion
    value: float = delivery.trajectory.criteria["optimum"]["geometric"]["a"]
    return float(np.sqrt(value / (motion.periods * motion.fourier.period)))


def periods(name: str, options: DesignOptions, budget: float) -> str:
    """A row of the first table."""
    machine = robot.load(name)
    table = limits.resolve(machine)
    run = partial(pipeline.design_trajectory, machine, table)
    rule, ten = (run(wish.complete(options, table)) for wish in (MotionRequest(), MotionRequest(period=10.0)))
    planned = time_budget.plan_for_budget(machine, table, options, MotionRequest(), budget)
    filled = time_budget.run_plan(planned, options, run)
    motion, period = filled.trajectory.motion, rule.trajectory.motion.fourier.period
    ramps = rule.trajectory.motion.duration - 2.0 * period
    repeated = deviation(rule) * np.sqrt(2.0 / int((budget - ramps) / period))
    # two periods each: the ratio for equal time is the one for equal numbers, times the root of the times' ratio
    equal = deviation(rule) / deviation(ten) * np.sqrt(period / 10.0)
    chosen = f"{motion.periods} × {motion.fourier.period:g} s, {motion.fourier.harmonics} harmonics, {motion.duration:.1f} s"
    seconds = sum(c.seconds for c in planned.candidates)
    return f"| {name} | {period:g} | {equal:.2f} | {chosen} | {deviation(filled) / repeated:.2f} | {seconds:.1f} |"


def regressor(setting: DesignSetup, motion: FourierSeries) -> tuple[Array, Array, Array]:
    """Regressor rows over noise in base coordinates, positions and velocities along a period."""
    problem = setting.problem
    samples = motion.samples(motion.grid(problem.options.samples))
    Y = dynamics.regressor(problem.robot, problem.parameters, samples) / setting.noise[:, None]
    return Y.reshape(-1, Y.shape[2]) @ setting.base.geometric, samples.q, samples.dq


def held_out(setting: DesignSetup, first: FourierSeries, second: FourierSeries) -> float:
    """Error of friction that depends on position, on the second motion over the first, after a fit to the first."""
    rng, squares = np.random.default_rng(0), np.zeros(2)
    both = [regressor(setting, motion) for motion in (first, second)]
    for _ in range(20):
        phase, order = rng.uniform(0.0, 2.0 * np.pi, first.n), rng.integers(1, 3, first.n)
        torque = [(np.sin(order * q + phase) * np.tanh(dq / 0.02)).ravel() for _, q, dq in both]
        found = np.linalg.lstsq(both[0][0], torque[0], rcond=1e-6)[0]
        squares += [
            np.mean((t - rows @ found) ** 2) for t, (rows, _, _) in zip(torque, both, strict=True)
        ]
    return float(np.sqrt(squares[1] / squares[0]))


def second_motions(name: str, options: DesignOptions, weights: list[float], seeds: int) -> str:
    """A row of the second table."""
    machine = robot.load(name)
    table = limits.resolve(machine)
    gauge = StateScaling.for_robot(machine, table)
    found = np.zeros((len(weights), 3))
    for seed in range(seeds):
        one = MotionRequest().complete(DesignOptions(starts=options.starts, seed=seed, jobs=options.jobs), table)
        setting = optimize.set_up(machine, table, one)
        first = optimize.solve(setting)
        for k, weight in enumerate(weights):
            kept = motion_overlap.penalise_overlap(gauge, first.motion, weight)
            second = optimize.solve(optimize.set_up(machine, table, one, overlap_penalty=kept))
            common = motion_overlap.compute_overlap(gauge, first.motion, second.motion)
            price = second.attempts[0].objective - weight * common - first.attempts[0].objective
            found[k] += (
                common,
                np.expm1(0.5 * price),
                held_out(setting, first.motion, second.motion),
            )
    cells = [f"{a:.2f}, {100.0 * b:+.1f} %, {c:.2f}" for a, b, c in found / seeds]
    return f"| {name} | " + " | ".join(cells) + " |"


def main() -> None:
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
        f"| robot | period by the rule [s] | beside 10 s | planned for {given.time:g} s | beside the rule repeated | planning [s] |"
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
