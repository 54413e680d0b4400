"""Parts that all export formats share: the job, its checks, its rows and its comments."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .._system.comments import ascii_line
from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.samples import Samples
from ..trajectory.rest_to_rest import Motion
from ..trajectory.trajectory_file import Trajectory
from .goal_options import GoalOptions

Columns = tuple[FloatArray, ...]
"""Times, shape (N,) [s], then positions, velocities, … of the joints, shape (N, n) each."""
Torque = Callable[[Samples], FloatArray]
"""Function from samples to nominal torque. Shape (N, n) [N m]."""

FORCED = "FORCED: breaks its limits"
UNTRIED = "never tried on hardware"
DECIMALS = 12
"""Decimals of exported numbers: 1e-12 rad is below the resolution of any encoder."""
MAX_ROWS = 5_000_000
"""Largest number of rows of a table: about 1 GB of text for seven joints with all quantities."""
REST_VELOCITY = 1e-6
"""Largest velocity at the ends of a motion that counts as rest [rad/s or m/s]: the rounding error
of the ramp planner; a motion that starts faster would jerk the robot."""
REST_ACCELERATION = 1e-3
"""Largest acceleration at the ends of a motion that counts as rest [rad/s² or m/s²]."""


@dataclass(frozen=True)
class ExportJob:
    """A file to export.

    Attributes:
        trajectory: The trajectory.
        motion: Its motion, played at `speed`.
        format: Name of the format.
        path: File to write, for messages.
        speed: Share of the designed speed [1].
        rate: Rows per second [Hz]; None: the format's own.
        tau: Function from samples to nominal torque; None: unknown.
        goal: Lead and tolerances of a ROS 2 goal.
        sliding: Names of the prismatic joints.
    """

    trajectory: Trajectory
    motion: Motion
    format: str
    path: Path
    speed: float
    rate: float | None
    tau: Torque | None
    goal: GoalOptions = field(default_factory=GoalOptions)
    sliding: tuple[str, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.motion.joints


@dataclass(frozen=True)
class ExportedText:
    """Content of an exported file.

    Attributes:
        text: Text of the file.
        note: Text of a second file, for formats that have no comments.
    """

    text: str
    note: str | None = None


def require_joints(job: ExportJob, counts: Sequence[int]) -> None:
    """Check that a format supports the number of joints.

    Args:
        job: The file to export.
        counts: Supported numbers of joints; empty: any number.

    Raises:
        UnusableInput: The motion has another number of joints.
    """
    n = len(job.joints)
    if not counts or n in counts:
        return
    supported = " or ".join(str(c) for c in counts)
    raise UnusableInput(
        f"{job.path}: format '{job.format}' takes {supported} joints, this trajectory has {n} "
        f"({', '.join(job.joints)}); "
        f"choose them with 'excite design --joints', or a format for any robot such as csv"
    )


def require_turning(job: ExportJob) -> None:
    """Check that all joints turn, for formats that state angles.

    Raises:
        UnusableInput: A joint slides.
    """
    if job.sliding:
        raise UnusableInput(
            f"{job.path}: format '{job.format}' states angles, but joint '{job.sliding[0]}' "
            "slides; lock it with 'excite design --lock', or choose a format for any robot such as "
            "csv"
        )


def require_rate(job: ExportJob, rates: Sequence[float]) -> float:
    """Return the rate of the rows: the requested rate, or the first of the supported ones.

    Args:
        job: The file to export.
        rates: Rates that the controller supports [Hz].

    Raises:
        UnusableInput: The requested rate is not supported.
    """
    if job.rate is None:
        return rates[0]
    if job.rate not in rates:
        allowed = ", ".join(f"{r:g}" for r in rates)
        raise UnusableInput(
            f"{job.path}: format '{job.format}' is streamed at {allowed} Hz; --rate {job.rate:g} "
            "would change its speed, leave it out"
        )
    return job.rate


def require_rest(job: ExportJob) -> None:
    """Check that the motion begins and ends at rest; otherwise the set points would jump.

    Raises:
        UnusableInput: It does not.
    """
    inside = np.array([2e-9, job.motion.duration - 2e-9])
    for order, largest, unit in ((1, REST_VELOCITY, "/s"), (2, REST_ACCELERATION, "/s²")):
        value = np.abs(job.motion.at(inside, order)).max(axis=0)
        if value.max() > largest:
            worst = job.joints[int(value.argmax())]
            raise UnusableInput(
                f"{job.path}: joint '{worst}' of this trajectory does not start and end at rest "
                f"({value.max():.3g} rad{unit}); design it with its ramps, 'excite design' adds "
                "them"
            )


def sampled(job: ExportJob, rate: float) -> tuple[FloatArray, Samples]:
    """Sample the motion at the times k/rate, with the first and the last row exactly at rest.

    Args:
        job: The file to export.
        rate: Rows per second [Hz].

    Returns:
        Times, shape (N,) [s], and samples, shape (N, n).

    Raises:
        UnusableInput: There are more than MAX_ROWS rows, the motion is not at rest at its ends, or
            a number is not finite.
    """
    if job.motion.duration * rate > MAX_ROWS:
        raise UnusableInput(
            f"{job.path}: {job.motion.duration:.4g} s at {rate:g} Hz is over {MAX_ROWS:,} rows; "
            "lower --rate or raise --speed"
        )
    require_rest(job)
    t = job.motion.grid(rate)
    # By rounding, the last time may be slightly before the end of the motion: use the end itself.
    samples = job.motion.samples(np.append(t[:-1], max(t[-1], job.motion.duration)))
    if not all(np.isfinite(part).all() for part in (samples.q, samples.dq, samples.ddq)):
        raise UnusableInput(
            f"{job.path}: the trajectory holds numbers that are not finite; design it again"
        )
    return t, samples


def notes(job: ExportJob, details: Sequence[str], tried: bool) -> list[str]:
    """Return the lines that describe an exported file: robot, format, certificate, warnings.

    Args:
        job: The file to export.
        details: Further lines of the format.
        tried: True if the format has been run on hardware.

    Returns:
        Lines of printable ASCII, which any controller's parser accepts in comments.
    """
    lines = [
        f"excite: {job.trajectory.robot.get('name', 'robot')}; joints {', '.join(job.joints)}",
        f"format: {job.format}; speed: {job.speed:g}; duration: {job.motion.duration:.9g} s",
        job.trajectory.collision.replace("–", "-"),
        *details,
    ]
    if not tried:
        lines.append(UNTRIED)
    if job.trajectory.forced:
        lines.append(FORCED)
    return [ascii_line(line) for line in lines]


def fixed(value: float, decimals: int | None = DECIMALS) -> str:
    """Format a number without exponent and without negative zero.

    YAML 1.1 reads 1e-05 as a word, and some controllers do not parse exponents.

    Args:
        value: The number.
        decimals: Number of decimals; None: all digits.
    """
    value = float(value)
    rounded = value if decimals is None else round(value, decimals)
    if abs(rounded) < 1e-15:
        rounded = 0.0
    return np.format_float_positional(rounded, unique=True, trim="0")


def check_options(speed: float, rate: float | None) -> None:
    """Check the options of an export.

    Args:
        speed: Share of the designed speed [1].
        rate: Rows per second [Hz]; None: not stated.

    Raises:
        UnusableInput: The speed is not in (0, 1], or the rate is not a positive number.
    """
    if not 0.0 < speed <= 1.0:
        raise UnusableInput(f"--speed {speed:g} should be above 0 and at most 1")
    if rate is not None and not (math.isfinite(rate) and rate > 0.0):
        raise UnusableInput(f"--rate {rate:g} should be a positive number of rows a second")


def note_path(path: Path) -> Path:
    """Return the path of the note that describes a file without comments."""
    return path.with_name(path.name + ".txt")


def is_note(path: Path) -> bool:
    """Return True if a file is a note that `write` has placed next to an exported file."""
    if not os.path.isfile(path):  # opening a pipe would block
        return False
    try:
        with path.open("rb") as stream:
            lines = [stream.readline(1000) for _ in range(2)]
    except OSError:  # no permission to read it
        return False
    return lines[0].startswith(b"excite: ") and lines[1].startswith(b"format: ")
