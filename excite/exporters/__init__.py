"""Files for controllers: a certified motion in the form that a robot's own software takes, and
back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from .._system.output_files import output_files
from ..errors import UnusableInput
from ..trajectory.trajectory_file import Trajectory
from . import csv_json, ros2, urscript, vendor_table
from .file_format import Columns, Job, Torque, Written, beside, check_options, is_note
from .goal_options import GoalOptions

__all__ = ["FORMATS", "Columns", "Torque", "read", "write"]


@dataclass(frozen=True)
class _Format:
    """What a format is, how its text is made and how it is read back."""

    description: str
    render: Callable[[Job], Written]
    parse: Callable[[Path], Columns]


def _registry() -> dict[str, _Format]:
    positions = {
        name: _Format(
            profile.title,
            partial(vendor_table.write, profile=profile),
            partial(vendor_table.read, profile=profile),
        )
        for name, profile in vendor_table.profiles().items()
    }
    return {
        "csv": _Format(
            "trajectory.csv: time, positions, velocities, accelerations, torques",
            csv_json.write_csv,
            csv_json.read_csv,
        ),
        "json": _Format(
            "trajectory.json as it is: exact and replayable",
            csv_json.write_json,
            csv_json.read_json,
        ),
        "ros2-joint-trajectory": _Format(
            "ROS 2 trajectory_msgs/JointTrajectory, 50 Hz knots", ros2.write_trajectory, ros2.read
        ),
        "ros2-follow-joint-trajectory": _Format(
            "ROS 2 goal of control_msgs/FollowJointTrajectory, 50 Hz knots",
            ros2.write_goal,
            ros2.read,
        ),
        "urscript": _Format(
            "Universal Robots: a program that computes the motion on the controller",
            urscript.write,
            urscript.read,
        ),
        **positions,
    }


_FORMATS = _registry()
FORMATS: Mapping[str, str] = {name: entry.description for name, entry in _FORMATS.items()}
"""Names of all formats, each with one line that says what it is."""


def _entry(name: str) -> _Format:
    if name not in _FORMATS:
        raise UnusableInput(f"--format {name}: is no format; there are: {', '.join(_FORMATS)}")
    return _FORMATS[name]


def write(
    trajectory: Trajectory,
    format: str,
    path: Path,
    *,
    speed: float = 1.0,
    rate: float | None = None,
    tau: Torque | None = None,
    goal: GoalOptions = GoalOptions(),  # noqa: B008  # immutable
) -> Path:
    """Write a trajectory for a controller, whole or not at all, and return the path.

    A format without room for comments gets a second file, `<path>.txt`, that says what the first
    one is. speed: The same path at this share of the speed, in (0, 1]. rate: Rows a second, where
    the format leaves a choice [Hz]; its own where None. tau: Nominal torque of samples, (N, n) [N
    m], for the columns `tau.<joint>` of `csv`. goal: Options of ROS 2 goals.
    Raises UnusableInput for an unknown format, a robot the format doesn't fit, or a path that
    cannot be written.
    """
    entry = _entry(format)
    check_options(speed, rate)
    output_files(path)
    motion = trajectory.motion if speed == 1.0 else trajectory.motion.slowed(speed)
    written = entry.render(Job(trajectory, motion, format, path, speed, rate, tau, goal))
    note = beside(path)
    contents = {path.name: written.text} | (
        {} if written.note is None else {note.name: written.note}
    )
    output_files(path, (note.name,) if written.note is not None or is_note(note) else ()).replace(
        contents
    )
    return path


def read(format: str, path: Path) -> Columns:
    """Times [s] and positions, then velocities and accelerations where the format has them. Shapes
    (N,), (N, n) each.

    Raises UnusableInput for an unknown format or a file that isn't one.
    """
    entry = _entry(format)
    try:
        return entry.parse(path)
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise UnusableInput(
            f"{path}: cannot be read as '{format}' ({type(error).__name__}: {error}); give a file "
            "of that format"
        ) from error
