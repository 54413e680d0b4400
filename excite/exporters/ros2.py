"""ROS 2: `trajectory_msgs/JointTrajectory` and the goal of
`control_msgs/action/FollowJointTrajectory`.

The files are JSON, which is also valid YAML. They are too long for an argument of a shell command,
so pass them by name or by standard input:

    ros2 topic pub --once /joint_trajectory_controller/joint_trajectory
        trajectory_msgs/msg/JointTrajectory --yaml-file FILE
    ros2 action send_goal --stdin /…/follow_joint_trajectory
        control_msgs/action/FollowJointTrajectory < FILE

The first point is the start pose, at `GoalOptions.lead` seconds; all other points follow with the
same offset. The controller interpolates from the present pose to the first point, but would jump to
a point at time 0. A robot that is not exactly at the start pose therefore moves there slowly.

Between the points the controller interpolates by quintic polynomials. Their velocity and
acceleration keep the limits, and their path is the certified one; their jerk exceeds that of the
motion for one interval wherever it jumps between two points, however dense these are.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.limits import DERIVED
from ..robot.samples import Samples
from .file_format import FORCED, Columns, ExportedText, ExportJob, fixed, sampled

RATES = (50.0, 100.0, 200.0, 400.0, 800.0)
"""Points per second, the first of which suffices for the interpolation of the controller is the
default [Hz]."""
MAX_DEVIATION = 1e-4
"""Largest deviation of the interpolation from the certified path [rad or m]; at a reach of 1 m it
is a fifth of the tolerance of a certified distance, 0.5 mm."""
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


def _points(job: ExportJob) -> tuple[FloatArray, Samples]:
    """Sample the motion at the stated rate, or at the first of RATES that suffices.

    Returns:
        Times, shape (N,) [s], and samples, shape (N, n).

    Raises:
        UnusableInput: The interpolation between the points breaks a limit or leaves the path.
    """
    stated = job.rate or RATES[0]
    points = sampled(job, stated)
    fault = _interpolation_fault(job, *points)
    if fault is None:
        return points
    for rate in RATES:
        if rate <= stated:
            continue
        denser = sampled(job, rate)
        if _interpolation_fault(job, *denser) is not None:
            continue
        if job.rate is None:
            return denser
        raise UnusableInput(f"{job.path}: --rate {stated:g}: {fault}; use --rate {rate:g}")
    raise UnusableInput(
        f"{job.path}: at {stated:g} points a second, and at up to {RATES[-1]:g}, {fault}; lower "
        "--speed, or design it with a wider --margin"
    )


def _interpolation_fault(job: ExportJob, t: FloatArray, samples: Samples) -> str | None:
    """Describe the first fault of the quintic polynomials between points.

    The velocity is bounded by its Bézier control points, the differences of those of the position
    (Farin, Curves and Surfaces for CAGD, 2002, ch. 5). A forced motion is not checked.

    Args:
        job: The file to export.
        t: Times of the points. Shape (N,) [s].
        samples: The points. Shape (N, n).
    """
    if job.trajectory.forced or len(t) < 2:
        return None
    h = np.diff(t)[:, None]
    ends = [
        (q, q + sign * h * dq / 5.0, q + sign * h * dq / 2.5 + h**2 * ddq / 20.0)
        for sign, q, dq, ddq in (
            (1.0, samples.q[:-1], samples.dq[:-1], samples.ddq[:-1]),
            (-1.0, samples.q[1:], samples.dq[1:], samples.ddq[1:]),
        )
    ]
    control = np.array([*ends[0], *ends[1][::-1]])
    limits = job.trajectory.limits
    for limit, values in (
        ("velocity", 5.0 * np.diff(control, axis=0) / h),
        ("acceleration", _cubic_extremes(20.0 * np.diff(control, 2, axis=0) / h**2)),
    ):
        # a derived limit applies to the ramps alone, which were planned within it
        stated = np.array([source != DERIVED for source in limits.sources[limit]])
        bound = np.where(stated, getattr(limits, limit), np.inf)
        value = np.abs(values).max(axis=(0, 1))
        j = int(np.argmax(value / bound))
        if value[j] > bound[j]:
            return (
                f"the interpolated {limit} of joint '{job.joints[j]}' is up to {value[j]:.4g} of "
                f"{bound[j]:.4g}"
            )
    middle = np.tensordot([1.0, 5.0, 10.0, 10.0, 5.0, 1.0], control, 1) / 32.0
    deviation = np.abs(middle - job.motion.at(0.5 * (t[:-1] + t[1:]))).max(axis=0)
    j = int(np.argmax(deviation))
    if deviation[j] > MAX_DEVIATION:
        return f"the interpolation of joint '{job.joints[j]}' leaves the path by {deviation[j]:.2g}"
    return None


def _cubic_extremes(control: FloatArray) -> FloatArray:
    """Return the values of cubics on [0, 1] at the ends and where they can be extreme.

    Args:
        control: Bézier control points. Shape (4, N, n).

    Returns:
        Values. Shape (4, N, n).
    """
    first, middle, last = np.diff(control, axis=0)
    # the derivative a s² + b s + first, up to a factor
    a, b = first - 2.0 * middle + last, 2.0 * (middle - first)
    half = -0.5 * (b + np.copysign(np.sqrt(np.maximum(b**2 - 4.0 * a * first, 0.0)), b))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.array([half / a, first / half])
    s = np.clip(np.nan_to_num(roots), 0.0, 1.0)
    r = 1.0 - s
    c = control[:, None]
    inside = r**3 * c[0] + 3.0 * s * r**2 * c[1] + 3.0 * s**2 * r * c[2] + s**3 * c[3]
    return np.array([control[0], *inside, control[3]])


def _trajectory(job: ExportJob) -> str:
    """Return a JointTrajectory, one point per line.

    Efforts are empty: controllers without an effort interface refuse them.
    """
    t, samples = _points(job)
    lead = round(job.goal.lead * NANO)
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


def render_trajectory(job: ExportJob) -> ExportedText:
    """Return a JointTrajectory message with positions, velocities and accelerations.

    The velocity of the last point is exactly 0.
    """
    return ExportedText(_trajectory(job) + "\n")


def render_goal(job: ExportJob) -> ExportedText:
    """Return a FollowJointTrajectory goal.

    Empty tolerances select those of the controller; the end may be late by GOAL_TIME_TOLERANCE.
    """
    time_tolerance = _stamp(round(GOAL_TIME_TOLERANCE * NANO))
    path_tolerance, goal_tolerance = (
        _tolerances(job, position)
        for position in (job.goal.path_tolerance, job.goal.goal_tolerance)
    )
    return ExportedText(
        f'{{"trajectory": {_trajectory(job)},\n"path_tolerance": {path_tolerance}, '
        f'"goal_tolerance": {goal_tolerance}, "goal_time_tolerance": {time_tolerance}}}\n'
    )


def _tolerances(job: ExportJob, position: float | None) -> str:
    """JointTolerance of every joint; velocities and accelerations of 0 are not checked.

    Args:
        job: The file to export.
        position: Position tolerance [rad or m]; None: the controller's own.
    """
    if position is None:
        return "[]"
    entries = [
        f'{{"name": {_quoted(joint)}, "position": {fixed(position)}, "velocity": 0.0, '
        '"acceleration": 0.0}'
        for joint in job.joints
    ]
    return "[" + ", ".join(entries) + "]"


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
