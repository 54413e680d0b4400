"""Formats of our own: `trajectory.csv` with all quantities, and `trajectory.json` as it stands."""

from __future__ import annotations

import csv
import dataclasses
import io
from pathlib import Path

import numpy as np

from .. import _json
from ..errors import UnusableInput
from ..trajectory import trajectory_file
from .file_format import DECIMALS, Array, Columns, Job, Written, sampled

QUANTITIES = ("q", "dq", "ddq", "tau")


def text(trajectory: trajectory_file.Trajectory, torque: Array | None = None) -> str:
    """`trajectory.csv` at the trajectory's own rate. torque: of every row, (N, n) [N m], None to
    leave its columns out."""
    tau = None if torque is None else lambda _: torque
    return write_csv(
        Job(trajectory, trajectory.motion, "csv", Path("trajectory.csv"), 1.0, None, tau)
    ).text


def write_csv(job: Job) -> Written:
    """`t,q.<joint>…,dq.<joint>…,ddq.<joint>…,tau.<joint>…` at k/rate; 12 significant digits.

    The contract leaves no room for a comment, so whether it was forced stands in the JSON only.
    The torque columns are absent where the job knows no torque.
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
    return Written(out.getvalue())


def read_csv(path: Path) -> Columns:
    """Times and the quantities there are, in the order q, dq, ddq, tau. Shapes (N,), (N, n) each.

    Raises ValueError for a header or a row that does not fit.
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


def write_json(job: Job) -> Written:
    """The document as it is; only the rate may differ.

    Its margins and criteria hold for the speed it was certified at, so a slower one is refused with
    UnusableInput.
    """
    if job.speed != 1.0:
        raise UnusableInput(
            f"{job.path}: format 'json' carries margins and criteria of full speed, --speed "
            f"{job.speed:g} would void them; "
            f"leave --speed out, or use 'excite design --speed'"
        )
    return Written(
        _json.dumps(
            dataclasses.replace(job.trajectory, rate=job.rate or job.trajectory.rate).document()
        )
        + "\n"
    )


def read_json(path: Path) -> Columns:
    """Times, positions, velocities, accelerations at the file's own rate. Shapes (N,), (N, n)."""
    trajectory = trajectory_file.read_trajectory(path)
    t = trajectory.motion.grid(trajectory.rate)
    samples = trajectory.motion.samples(t)
    return t, samples.q, samples.dq, samples.ddq
