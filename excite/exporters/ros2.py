"""ROS 2: `trajectory_msgs/JointTrajectory` and the goal of
`control_msgs/action/FollowJointTrajectory`.

The files are JSON, which is also valid YAML. They are too long for an argument of a shell command,
so pass them by name or by standard input:

    ros2 topic pub --once /joint_trajectory_controller/joint_trajectory
        trajectory_msgs/msg/JointTrajectory --yaml-file FILE
    ros2 action send_goal --stdin /…/follow_joint_trajectory
        control_msgs/action/FollowJointTrajectory < FILE

The first point is the start pose, at LEAD seconds; all other points follow with the same offset.
The controller interpolates from the present pose to the first point, but would jump to a point at
time 0. A robot that is not exactly at the start pose therefore moves there slowly.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .._types import FloatArray
from .file_format import FORCED, Columns, ExportedText, ExportJob, fixed, sampled

LEAD = 5.0
"""Time from the present pose to the start pose [s]."""
KNOTS = 50.0
"""Points per second [Hz]; the controller interpolates between them by quintic polynomials."""
GOAL_TIME_TOLERANCE = 2.0
"""Time by which the controller may reach the end too late [s]."""
NANO = 1_000_000_000
"""Nanoseconds per second."""


def _stamp(nanoseconds: int) -> str:
    return f'{{"sec": {nanoseconds // NANO}, "nanosec": {nanoseconds % NANO}}}'


def _list(values: FloatArray) -> str:
    return "[" + ", ".join(fixed(value) for value in values) + "]"


def _quoted(text: str) -> str:
    """Return a text in double quotes that JSON and YAML read alike.

    Letters are not escaped: JSON escapes those beyond the basic multilingual plane as surrogate
    pairs, which YAML reads as two characters. Characters that YAML does not allow are escaped.
    """
    return "".join(
        letter if letter.isprintable() or ord(letter) > 0xFFFF else f"\\u{ord(letter):04x}"
        for letter in json.dumps(text, ensure_ascii=False)
    )


def _trajectory(job: ExportJob) -> str:
    """Return a JointTrajectory, one point per line.

    Efforts are empty: controllers without an effort interface refuse them.
    """
    t, samples = sampled(job, job.rate or KNOTS)
    lead = round(LEAD * NANO)
    points = [
        f'{{"positions": {_list(q)}, "velocities": {_list(dq)}, "accelerations": {_list(ddq)}, '
        f'"effort": [], "time_from_start": {_stamp(lead + round(time * NANO))}}}'
        for time, q, dq, ddq in zip(t.tolist(), samples.q, samples.dq, samples.ddq, strict=True)
    ]
    # Joint controllers ignore the frame of the header; it is the only free text of the message.
    names = ", ".join(map(_quoted, job.joints))
    frame = FORCED if job.trajectory.forced else ""
    return (
        f'{{"header": {{"stamp": {{"sec": 0, "nanosec": 0}}, "frame_id": {_quoted(frame)}}},\n'
        f'"joint_names": [{names}],\n"points": [\n' + ",\n".join(points) + "\n]}"
    )


def write_trajectory(job: ExportJob) -> ExportedText:
    """Return a JointTrajectory message with positions, velocities and accelerations.

    The velocity of the last point is exactly 0.
    """
    return ExportedText(_trajectory(job) + "\n")


def write_goal(job: ExportJob) -> ExportedText:
    """Return a FollowJointTrajectory goal.

    Empty tolerances select those of the controller; the end may be late by GOAL_TIME_TOLERANCE.
    """
    tolerance = _stamp(round(GOAL_TIME_TOLERANCE * NANO))
    return ExportedText(
        f'{{"trajectory": {_trajectory(job)},\n'
        f'"path_tolerance": [], "goal_tolerance": [], "goal_time_tolerance": {tolerance}}}\n'
    )


def read(path: Path) -> Columns:
    """Read a message or a goal.

    Returns:
        Times since the first point, shape (N,) [s], positions, velocities and accelerations, shape
        (N, n) each.
    """
    document: Any = json.loads(path.read_text(encoding="utf-8"))
    points = document.get("trajectory", document)["points"]
    time = np.array(
        [p["time_from_start"]["sec"] * NANO + p["time_from_start"]["nanosec"] for p in points],
        dtype=np.int64,
    )
    columns = [
        np.array([p[key] for p in points], float)
        for key in ("positions", "velocities", "accelerations")
    ]
    return ((time - time[0]) / NANO, *columns)
