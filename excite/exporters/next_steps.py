"""Instructions for an exported file: the start pose, the command that runs it, how to record, and
how to identify."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..robot.limits import Limits, limits_files
from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory
from .goal_options import GoalOptions

CONTROLLER = "joint_trajectory_controller"
"""Usual name of the ROS 2 controller; drivers for Universal Robots call theirs
`scaled_joint_trajectory_controller`."""


def next_steps(
    trajectory: Trajectory,
    robot: Robot,
    limits: Limits,
    source: str,
    format: str,
    path: Path,
    goal: GoalOptions,
    speed: float = 1.0,
) -> list[str]:
    """Return lines that say how to run an exported file and how to record the motion.

    Args:
        trajectory: The exported trajectory.
        robot: Its robot, as loaded.
        limits: Limits of the robot, from their sources.
        source: Its file.
        format: Name of the format.
        path: The exported file.
        goal: Options of a ROS 2 goal.
        speed: Share of the planned speed at which the file plays the motion.

    Returns:
        Lines for the user; none for formats that only store the motion.
    """
    controller = _controller(format)
    if controller is None:
        return []
    pose = trajectory.motion.end_poses[0]
    shown = _joint_list(dict(zip(trajectory.joints, pose, strict=True)))
    locked: Mapping[str, Any] = trajectory.robot["locked"]
    run, record = controller(shlex.quote(str(path)), goal)
    files = [f"--limits={file}" for file in limits_files(robot, limits)]
    options = [*robot.command_options(), *files, "--trajectory", source]
    words = [robot.source, record[1], *options]
    return [
        f"start pose [rad or m]: {shown}" + (f"; locked: {_joint_list(locked)}" if locked else ""),
        "1. bring the robot to the start pose, at reduced speed and with a clear cell; "
        + _start_note(format, goal),
        f"2. record: {record[0]}",
        f"3. run: {run}" + _partial_goal_note(format, locked),
        f"4. identify: excite identify {shlex.join(words)} -o model" + _speed_note(speed),
    ]


def _joint_list(positions: Mapping[str, float]) -> str:
    """List joints with their positions."""
    return ", ".join(f"{joint} {value:.4f}" for joint, value in positions.items())


def _partial_goal_note(format: str, locked: Mapping[str, Any]) -> str:
    """Say what a ROS 2 controller that also commands locked joints needs to accept the motion.

    Its parameter `allow_partial_joints_goal` is false by default (ros2_controllers,
    joint_trajectory_controller, "Details about parameters").
    """
    if not locked or not format.startswith("ros2"):
        return ""
    names = ", ".join(locked)
    return (
        f" (the file has no positions of the locked {names}: a controller that commands "
        "them, too, rejects it unless its parameter allow_partial_joints_goal is true)"
    )


def _speed_note(speed: float) -> str:
    """Say what a recording at reduced speed is good for."""
    if speed >= 1.0:
        return ""
    return (
        f" (at --speed {speed:g} it shows gravity and friction but hardly inertia: check with it "
        "that joints, signs and units are right, then export without --speed and record again)"
    )


def _start_note(format: str, goal: GoalOptions) -> str:
    """Say how the controller gets to the start pose if the robot is not there."""
    if format.startswith("ros2"):
        return f"the controller moves from any pose straight to it within {goal.lead:g} s"
    if format == "urscript":
        return "the program moves there first, straight in joint space"
    return "the first row is that pose, and the stream does not move there"


def _controller(
    format: str,
) -> Callable[[str, GoalOptions], tuple[str, tuple[str, str]]] | None:
    """Function that returns the commands to run a file and to record, and the recording's name."""
    if format == "ros2-follow-joint-trajectory":
        return _follow_joint_trajectory
    if format == "ros2-joint-trajectory":
        return _joint_trajectory
    if format in ("urscript", "ur-csv"):
        return _universal_robots if format == "urscript" else _universal_robots_stream
    if format == "franka-csv":
        return _franka
    return None


_BAG = ("ros2 bag record /joint_states -o run1", "run1")


def _follow_joint_trajectory(path: str, goal: GoalOptions) -> tuple[str, tuple[str, str]]:
    run = (
        f"ros2 action send_goal --stdin /{CONTROLLER}/follow_joint_trajectory "
        f"control_msgs/action/FollowJointTrajectory < {path}"
    )
    return run, _BAG


def _joint_trajectory(path: str, goal: GoalOptions) -> tuple[str, tuple[str, str]]:
    run = (
        f"ros2 topic pub --once /{CONTROLLER}/joint_trajectory "
        f"trajectory_msgs/msg/JointTrajectory --yaml-file {path}"
    )
    return run, _BAG


_RTDE = (
    "record timestamp, actual_q, target_q and actual_current_as_torque (or actual_current and "
    "drive_gain) at 125 Hz or more, as ur_rtde's 'record' example writes them, into run1.csv",
    "run1.csv",
)


def _universal_robots(path: str, goal: GoalOptions) -> tuple[str, tuple[str, str]]:
    return f"load {path} on the panel, or send it: nc ROBOT_IP 30002 < {path}", _RTDE


def _universal_robots_stream(path: str, goal: GoalOptions) -> tuple[str, tuple[str, str]]:
    return f"stream the rows of {path} with ur_rtde's servoJ at the rate of the file", _RTDE


def _franka(path: str, goal: GoalOptions) -> tuple[str, tuple[str, str]]:
    run = f"stream the rows of {path} at 1 kHz as franka::JointPositions of libfranka"
    record = (
        "log time, q, dq, q_d and tau_J of franka::RobotState of every row into run1.csv with the "
        "columns t, q.<joint>, dq.<joint>, qref.<joint>, tau.<joint>"
    )
    return run, (record, "run1.csv")
