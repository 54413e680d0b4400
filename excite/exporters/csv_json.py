"""Formats of this package: `trajectory.csv` with all quantities, and `trajectory.json`."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from .. import _json
from .._types import FloatArray
from ..errors import UnusableInput
from ..trajectory import trajectory_file
from .file_format import DECIMALS, Columns, ExportedText, ExportJob, sampled

QUANTITIES = ("q", "dq", "ddq", "tau")
"""Prefixes of the columns of `trajectory.csv`, in their order."""


def text(trajectory: trajectory_file.Trajectory, torque: FloatArray | None = None) -> str:
    """Return `trajectory.csv` at the trajectory's own rate.

    Args:
        trajectory: The trajectory.
        torque: Torque of every row, shape (N, n) [N m]; None: without the torque columns.
    """
    tau = None if torque is None else lambda _: torque
    return render_csv(
        ExportJob(trajectory, trajectory.motion, "csv", Path("trajectory.csv"), 1.0, None, tau)
    ).text


def render_csv(job: ExportJob) -> ExportedText:
    """Return the rows `t,q.<joint>…,dq.<joint>…,ddq.<joint>…,tau.<joint>…` at the times k/rate.

    Numbers have 12 significant digits. The torque columns are absent where the job has no torque
    function. The format has no comments, so only the JSON file states that a motion was forced.
    """
    t, samples = sampled(job, job.rate or job.trajectory.rate)
    parts = [samples.q, samples.dq, samples.ddq]
    if job.tau is not None:
        parts.append(np.asarray(job.tau(samples), float))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        [
            "t",
            *(
                f"{name}.{joint}"
                for name, _ in zip(QUANTITIES, parts, strict=False)
                for joint in job.joints
            ),
        ]
    )
    for row in np.round(np.column_stack([t, *parts]), DECIMALS) + 0.0:  # adding 0 turns -0 into 0
        writer.writerow([f"{value:.12g}" for value in row])
    return ExportedText(out.getvalue())


def read_csv(path: Path) -> Columns:
    """Read a `trajectory.csv`.

    Returns:
        Times, shape (N,) [s], and the quantities of the file in the order q, dq, ddq, tau, shape
        (N, n) each.

    Raises:
        ValueError: The header or a row has the wrong form.
    """
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = list(csv.reader(file))
    names = [name.partition(".")[0] for name in header]
    joints = names.count("q")
    if names != [
        "t",
        *(name for name in QUANTITIES[: (len(names) - 1) // max(joints, 1)] for _ in range(joints)),
    ]:
        raise ValueError("its header is not t,q.<joint>…,dq.<joint>…,ddq.<joint>…,tau.<joint>…")
    table = np.array(rows, float).reshape(len(rows), len(header))
    return (table[:, 0], *(table[:, i : i + joints] for i in range(1, len(header), joints)))


def render_json(job: ExportJob) -> ExportedText:
    """Return the JSON document of the trajectory.

    Raises:
        UnusableInput: A lower speed or another rate is requested: margins and criteria of the
            document hold for the motion that was certified.
    """
    trajectory = job.trajectory
    for option, value, designed in (
        ("--speed", job.speed, 1.0),
        ("--rate", job.rate or trajectory.rate, trajectory.rate),
    ):
        if value != designed:
            raise UnusableInput(
                f"{job.path}: format 'json' carries margins and criteria of the motion as it was "
                f"designed, {option} {value:g} would void them; leave {option} out, or use "
                f"'excite design {option}'"
            )
    return ExportedText(_json.dumps(trajectory.document()) + "\n")


def read_json(path: Path) -> Columns:
    """Read times, positions, velocities and accelerations at the rate of the file.

    Returns:
        Shapes (N,) [s] and (N, n) each.
    """
    trajectory = trajectory_file.read_trajectory(path)
    t = trajectory.motion.grid(trajectory.rate)
    samples = trajectory.motion.samples(t)
    return t, samples.q, samples.dq, samples.ddq
