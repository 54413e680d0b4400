#!/usr/bin/env python
"""Measure designs for a task: the realised torque standard deviation along it, as Markdown.

For each robot and each of two tasks (a pick and place by Ruckig, a recorded motion), three motions
of equal length are designed: for the task (V-optimal), geometric A-optimal and D-optimal. Robots
that differ from the URDF are recorded along each complete motion with torque noise and identified
by maximum a posteriori; the error of the predicted torque along the task is what counts. Errors are
over the noise of each joint; ratios have 95 % intervals by resampling the robots. The complete
motions differ in their ramps and therefore in length. Two comparisons are exactly of equal length:
complete motions that go on periodically until the longest of the three ends, and the periodic parts
alone.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
import ruckig

import excite
from excite import api
from excite._types import FloatArray
from excite.api.design_result import CellOptions
from excite.designer.criteria import Criterion
from excite.errors import ExciteError, ExciteWarning
from excite.robot import dynamics, limits, robot
from excite.robot.limits import Limits
from excite.robot.robot import Robot
from excite.trajectory.rest_to_rest import SegmentKind

ROBOTS = {
    "Panda": ("panda_unit2/panda.urdf", "panda_unit2/validate.csv"),
    "TX40": ("tx40/tx40.urdf", "tx40/validate.csv"),
    "LWR4": ("lwr4/lwr4.urdf", "lwr4/fast_3.csv"),
    "SO-101": ("so101/so101.urdf", "so101/pick_place.csv"),
    "KR300": ("kuka_kr300/kuka_kr300.urdf", "kuka_kr300/traj_C.csv"),
}
"""URDF and recorded task of each robot, in the folder of recordings."""
TASK_RATE = 100.0
"""Rows per second of the pick-and-place task [Hz]."""
TASK_SPEED = 0.5
"""Share of the velocity limits at which the pick and place moves [1]."""
TASK_RANGE = 0.6
"""Share of the joint ranges within which its poses lie [1]."""
APPROACH = 0.08
"""Distance of the pose above a place, over the joint ranges [1]."""
MAX_TASK_RANGE = np.pi
"""Largest range of a joint's poses [rad]."""
TASK_ACCELERATION_TIME = 0.4
"""Time to reach the velocity limit where no acceleration limit is stated [s]."""
SPREAD = 0.2
"""How far the true robots are from the nominal one, per direction of the metric [1]."""


@dataclass(frozen=True)
class Errors:
    """Errors of one motion's identified models along a task.

    Attributes:
        square: Mean square error of the predicted torque over the noise, per robot. Shape (draws,).
        predicted: Predicted root mean square [1].
    """

    square: FloatArray
    predicted: float

    @property
    def rms(self) -> float:
        """Root mean square over all robots."""
        return float(np.sqrt(np.mean(self.square)))


def pick_and_place(machine: Robot, table: Limits, rng: np.random.Generator) -> FloatArray:
    """Return the positions of a pick and place: above, down, up, over to the place, down, up.

    Args:
        machine: The robot.
        table: Its limits.
        rng: Random generator of the two places.

    Returns:
        Positions at `TASK_RATE`. Shape (N, n) [rad or m].
    """
    bounded = np.isfinite(table.position).all(axis=1)
    middle = np.where(bounded, np.where(bounded[:, None], table.position, 0.0).mean(axis=1), 0.0)
    half = np.where(
        bounded, 0.5 * np.ptp(np.where(bounded[:, None], table.position, 0.0), axis=1), np.pi
    )
    half = np.minimum(TASK_RANGE * half, 0.5 * MAX_TASK_RANGE)
    pick, place = (middle + half * rng.uniform(-1.0, 1.0, machine.n) for _ in range(2))
    above = APPROACH * half * rng.choice([-1.0, 1.0], machine.n)
    poses = [pick + above, pick, pick + above, place + above, place, place + above, pick + above]
    parts = []
    for start, goal in itertools.pairwise(poses):
        request = ruckig.InputParameter(machine.n)
        request.current_position, request.target_position = start.tolist(), goal.tolist()
        request.max_velocity = (TASK_SPEED * table.velocity).tolist()
        acceleration = np.where(
            np.isfinite(table.acceleration),
            table.acceleration,
            table.velocity / TASK_ACCELERATION_TIME,
        )
        request.max_acceleration = (TASK_SPEED * acceleration).tolist()
        request.max_jerk = (10.0 * TASK_SPEED * acceleration).tolist()
        planned = ruckig.Trajectory(machine.n)
        ruckig.Ruckig(machine.n).calculate(request, planned)
        times = np.arange(0.0, planned.duration, 1.0 / TASK_RATE)
        parts.append(np.array([planned.at_time(float(t))[0] for t in times]))
    return np.vstack(parts)


def write_task(path: Path, machine: Robot, q: FloatArray) -> None:
    """Write positions as a recording."""
    head = ",".join(["t", *(f"q.{joint}" for joint in machine.joints)])
    rows = np.column_stack([np.arange(len(q)) / TASK_RATE, q])
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.9g")


def realised(
    result: excite.DesignResult,
    reference: excite.DesignResult,
    draws: int,
    rng: np.random.Generator,
    *,
    periodic: bool = False,
    length: float = 0.0,
) -> Errors:
    """Identify random robots from a recording of a motion and predict the task of `reference`.

    Args:
        result: Design of the motion.
        reference: Design for the task.
        draws: Number of robots.
        rng: Random generator of robots and noise.
        periodic: Use the periodic part of the motion alone, without its ramps.
        length: Time for which the robot moves [s]; a shorter motion goes on periodically.
    """
    task = reference.task_design
    assert task is not None
    trajectory, setup = result.trajectory, result.delivery.design.setup
    times = trajectory.motion.grid(TASK_RATE)
    if periodic:
        part = trajectory.motion.segment(SegmentKind.FOURIER)
        times = times[(times >= part.start - 1e-9) & (times < part.end - 1e-9)]
    parts = [trajectory.motion.samples(times)]
    longer = np.arange(0.0, length - trajectory.motion.duration - 1e-9, 1.0 / TASK_RATE)
    if len(longer):
        parts.append(trajectory.motion.fourier.samples(longer))
    Y = np.vstack([dynamics.regressor(result.robot, setup.problem.parameters, m) for m in parts])
    Y = Y @ setup.base.geometric
    rows = (Y / trajectory.noise[:, None]).reshape(-1, Y.shape[2])
    along = ((task.regressor @ setup.base.geometric) / task.noise[:, None]).reshape(-1, Y.shape[2])
    _, singular, right = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    truth = SPREAD * rng.normal(size=(draws, Y.shape[2]))
    measured = singular * (truth @ right.T) + rng.normal(size=truth.shape)
    estimate = (measured * singular / (singular**2 + 1.0)) @ right  # prior of 100 %
    moment = along.T @ along / len(along)
    square = np.einsum("di,ij,dj->d", estimate - truth, moment, estimate - truth)
    spread = right.T / np.sqrt(singular**2 + 1.0)
    predicted = float(np.sqrt(np.trace(spread.T @ moment @ spread)))
    return Errors(square, predicted)


def ratio_interval(
    numerator: Errors, denominator: Errors, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Return the ratio of two RMS errors with its 95 % interval."""
    draws = len(numerator.square)
    picks = rng.integers(draws, size=(1000, draws))
    ratios = np.sqrt(numerator.square[picks].mean(axis=1) / denominator.square[picks].mean(axis=1))
    low, high = np.quantile(ratios, (0.025, 0.975))
    return numerator.rms / denominator.rms, float(low), float(high)


def compare(
    name: str, machine: Robot, task: Path, title: str, given: argparse.Namespace
) -> list[str]:
    """Return a row of the table: one robot and one task."""
    common = {
        "cell": CellOptions(check=False),
        "starts": given.starts,
        "seed": given.seed,
        "period": given.period,
        "harmonics": given.harmonics,
    }
    designs = {
        "V": api.design(machine, for_task=task, **common),
        "A": api.design(machine, criterion=Criterion.A, **common),
        "D": api.design(machine, criterion=Criterion.D, **common),
    }
    length = max(design.trajectory.motion.duration for design in designs.values())
    complete, equal, periodic = (
        {
            key: realised(
                design, designs["V"], given.draws, np.random.default_rng(given.seed), **options
            )
            for key, design in designs.items()
        }
        for options in ({}, {"length": length}, {"periodic": True})
    )
    rng = np.random.default_rng(given.seed)
    cells = [
        "{:.3f} ({:.3f} to {:.3f})".format(*ratio_interval(errors["V"], errors[key], rng))
        for errors in (complete, equal, periodic)
        for key in ("A", "D")
    ]
    seconds = designs["V"].delivery.timing["total"]
    durations = "/".join(f"{d.trajectory.motion.duration:.1f}" for d in designs.values())
    return [
        name,
        title,
        durations,
        *(f"{complete[key].rms:.4f}" for key in designs),
        f"{complete['V'].predicted:.4f}",
        *cells,
        f"{seconds:.1f}",
    ]


def main() -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--data",
        type=Path,
        metavar="FOLDER",
        default=Path(os.environ.get("EXCITE_SHARED", "../shared")) / "recordings",
        help="folder of the recordings (default: recordings in $EXCITE_SHARED)",
    )
    parser.add_argument("--only", help="one robot of the table")
    parser.add_argument("--starts", type=int, default=2)
    parser.add_argument("--period", type=float, help="period [s] (default: that of a design)")
    parser.add_argument("--harmonics", type=int, help="harmonics (default: 5)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--draws", type=int, default=400, help="random robots per motion")
    given = parser.parse_args()
    warnings.simplefilter("ignore", ExciteWarning)
    head = ["robot", "task", "V/A/D [s]", "V", "A", "D", "V predicted", "V/A", "V/D"]
    head += ["V/A, equal length", "V/D, equal length"]
    head += ["V/A, periodic part", "V/D, periodic part", "design [s]"]
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|", flush=True)
    try:
        for name, (urdf, recorded) in ROBOTS.items():
            if given.only not in (None, name):
                continue
            machine = robot.load(str(given.data / urdf))
            table = limits.resolve(machine)
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "pick_and_place.csv"
                motion = pick_and_place(machine, table, np.random.default_rng(given.seed))
                write_task(path, machine, motion)
                tasks = {"pick and place": path, "recorded": given.data / recorded}
                for title, task in tasks.items():
                    row = compare(name, machine, task, title, given)
                    print("| " + " | ".join(row) + " |", flush=True)
    except ExciteError as error:
        print(f"bench_for: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
