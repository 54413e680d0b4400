"""ROS 2: `trajectory_msgs/JointTrajectory` and the goal of
`control_msgs/action/FollowJointTrajectory`.

JSON, which is YAML too. A file is longer than a shell's argument may be, so it is to be piped or
named:

    ros2 topic pub --once /joint_trajectory_controller/joint_trajectory
    trajectory_msgs/msg/JointTrajectory --yaml-file FILE ros2 action send_goal --stdin
    /…/follow_joint_trajectory control_msgs/action/FollowJointTrajectory < FILE

The first point is the start pose at `GoalOptions.lead` seconds, not at 0, and everything follows
that much later: the controller interpolates from where the robot is to its first point, but jumps
to a point at time 0. A point one knot after 0 would bridge whatever is missing in 20 ms; seconds
let a robot that is a little off glide there, and one far off move slowly.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .file_format import FORCED, Array, Columns, Job, Written, fixed, sampled

KNOTS = 50.0
"""Points a second: the controller interpolates quintically between them [Hz]."""
GOAL_TIME_TOLERANCE = 2.0
NANO = 1_000_000_000


def _stamp(nanoseconds: int) -> str:
    return f'{{"sec": {nanoseconds // NANO}, "nanosec": {nanoseconds % NANO}}}'


def _list(values: Array) -> str:
    return "[" + ", ".join(fixed(value) for value in values) + "]"


def _quoted(text: str) -> str:
    """A text in double quotes that JSON and YAML read alike.

    Beyond the basic multilingual plane JSON would escape surrogates, which YAML takes for two
    characters, so letters stay as they are; what a YAML reader refuses is escaped.
    """
    return "".join(
        letter if letter.isprintable() or ord(letter) > 0xFFFF else f"\\u{ord(letter):04x}"
        for letter in json.dumps(text, ensure_ascii=False)
    )


def _trajectory(job: Job) -> str:
    """A JointTrajectory, one point a line; efforts are empty, for controllers refuse them without
    an effort interface."""
    t, samples = sampled(job, job.rate or KNOTS)
    lead = round(job.goal.lead * NANO)
    points = [
        f'{{"positions": {_list(q)}, "velocities": {_list(dq)}, "accelerations": {_list(ddq)}, '
        f'"effort": [], "time_from_start": {_stamp(lead + round(time * NANO))}}}'
        for time, q, dq, ddq in zip(t.tolist(), samples.q, samples.dq, samples.ddq, strict=True)
    ]
    # The header's frame is not used by joint controllers, and is the one text that the message has.
    names = ", ".join(map(_quoted, job.joints))
    frame = FORCED if job.trajectory.forced else ""
    return (
        f'{{"header": {{"stamp": {{"sec": 0, "nanosec": 0}}, "frame_id": {_quoted(frame)}}},\n'
        f'"joint_names": [{names}],\n"points": [\n' + ",\n".join(points) + "\n]}"
    )


def write_trajectory(job: Job) -> Written:
    """A JointTrajectory message: positions, velocities and accelerations full, the last velocity
    exactly 0."""
    return Written(_trajectory(job) + "\n")


def write_goal(job: Job) -> Written:
    """A FollowJointTrajectory goal; empty tolerances leave the controller's own, the end may be
    late by 2 s."""
    late = _stamp(round(GOAL_TIME_TOLERANCE * NANO))
    path, goal = (
        _tolerances(job, value) for value in (job.goal.path_tolerance, job.goal.goal_tolerance)
    )
    return Written(
        f'{{"trajectory": {_trajectory(job)},\n"path_tolerance": {path}, '
        f'"goal_tolerance": {goal}, "goal_time_tolerance": {late}}}\n'
    )


def _tolerances(job: Job, position: float | None) -> str:
    """JointTolerance of every joint; velocities and accelerations of 0 are not checked."""
    if position is None:
        return "[]"
    entries = [
        f'{{"name": {_quoted(joint)}, "position": {fixed(position)}, "velocity": 0.0, '
        '"acceleration": 0.0}'
        for joint in job.joints
    ]
    return "[" + ", ".join(entries) + "]"


def read(path: Path) -> Columns:
    """Times since the first point, positions, velocities, accelerations, of a message or a goal.
    Shapes (N,), (N, n)."""
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
