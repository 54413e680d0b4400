"""Registry of the export formats, and the functions that write and read any of them.

To add a format:

1. If a file of the format is a table of joint positions at the control rate, add a profile to
   `vendors.toml`, whose comments describe the keys, and go to step 4.
2. Otherwise add a module to this package with two functions: one that renders an `ExportJob` as
   `ExportedText`, and one that reads the file back as `Columns`. `file_format.py` holds the checks
   and helpers that all formats share: number of joints, rate, rest at both ends, comments.
3. Add an entry to `_registry` below. Its name becomes a value of `excite export --format`, and its
   description a line of `excite formats`.
4. Store a file of the new format in `tests/golden/`: `tests/test_export.py` tests every entry of
   the registry, fails for one without such a file, and states how to write it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from .._system.output_files import output_files
from ..errors import UnusableInput
from ..trajectory.trajectory_file import Trajectory
from . import csv_json, ros2, urscript, vendor_table
from .file_format import (
    Columns,
    ExportedText,
    ExportJob,
    Torque,
    check_options,
    is_note,
    note_path,
)
from .goal_options import GoalOptions


@dataclass(frozen=True)
class _Format:
    """An export format.

    Attributes:
        description: One line for `excite formats`.
        render: Returns the text of the file.
        parse: Reads the motion back from a file.
    """

    description: str
    render: Callable[[ExportJob], ExportedText]
    parse: Callable[[Path], Columns]


def _registry() -> dict[str, _Format]:
    tables = {
        name: _Format(
            profile.title,
            partial(vendor_table.render_table, profile=profile),
            partial(vendor_table.read, profile=profile),
        )
        for name, profile in vendor_table.profiles().items()
    }
    return {
        "csv": _Format(
            "trajectory.csv: time, positions, velocities, accelerations, torques",
            csv_json.render_csv,
            csv_json.read_csv,
        ),
        "json": _Format(
            "trajectory.json as it is: exact and replayable",
            csv_json.render_json,
            csv_json.read_json,
        ),
        "ros2-joint-trajectory": _Format(
            "ROS 2 trajectory_msgs/JointTrajectory, 50 Hz knots or denser",
            ros2.render_trajectory,
            ros2.read,
        ),
        "ros2-follow-joint-trajectory": _Format(
            "ROS 2 goal of control_msgs/FollowJointTrajectory, 50 Hz knots or denser",
            ros2.render_goal,
            ros2.read,
        ),
        "urscript": _Format(
            "Universal Robots: a program that computes the motion on the controller",
            urscript.render_program,
            urscript.read,
        ),
        **tables,
    }


_FORMATS = _registry()
FORMATS: Mapping[str, str] = {name: entry.description for name, entry in _FORMATS.items()}
"""Name of each format -> its description in one line."""


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
    sliding: Sequence[str] = (),
    inputs: Sequence[Path] = (),
) -> Path:
    """Write a trajectory for a controller, completely or not at all.

    A format without comments gets a second file, `<path>.txt`, that describes the first.

    Args:
        trajectory: The trajectory.
        format: Name of the format.
        path: File to write.
        speed: Share of the designed speed, in (0, 1]; the path stays the same.
        rate: Rows per second [Hz]; None: the format's own.
        tau: Function from samples to nominal torque, shape (N, n) [N m], for the columns
            `tau.<joint>` of `csv`; None: without these columns.
        goal: Lead and tolerances of a ROS 2 goal.
        sliding: Names of the prismatic joints, which formats of angles refuse.
        inputs: Files that must not be replaced: those that the trajectory was read from.

    Returns:
        The path of the file.

    Raises:
        UnusableInput: The format is unknown or does not fit the robot, or the path cannot be
            written or is an input.
    """
    entry = _entry(format)
    check_options(speed, rate)
    goal.require_format(format)
    output_files(path, inputs=inputs)
    motion = trajectory.motion if speed == 1.0 else trajectory.motion.slowed(speed)
    job = ExportJob(trajectory, motion, format, path, speed, rate, tau, goal, tuple(sliding))
    exported = entry.render(job)
    note = note_path(path)
    contents = {path.name: exported.text}
    if exported.note is not None:
        contents[note.name] = exported.note
    replaces_note = exported.note is not None or is_note(note)
    output_files(path, (note.name,) if replaces_note else (), inputs).replace(contents)
    return path


def read(format: str, path: Path) -> Columns:
    """Read the motion of an exported file.

    Args:
        format: Name of the format.
        path: The file.

    Returns:
        Times, shape (N,) [s], and positions, then velocities and accelerations where the format has
        them, shape (N, n) each.

    Raises:
        UnusableInput: The format is unknown, or the file is not of that format.
    """
    entry = _entry(format)
    try:
        return entry.parse(path)
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise UnusableInput(
            f"{path}: cannot be read as '{format}' ({type(error).__name__}: {error}); give a file "
            "of that format"
        ) from error
