"""What every file format shares: the motion to be written, its rows and its notes."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import UnusableInput
from ..robot.samples import Samples
from ..trajectory.rest_to_rest import Motion
from ..trajectory.trajectory_file import Trajectory
from .goal_options import GoalOptions

Array = np.ndarray
Columns = tuple[Array, ...]
Torque = Callable[[Samples], Array]

FORCED = "FORCED: breaks its limits"
UNTRIED = "never tried on hardware"
DECIMALS = 12
MOST_ROWS = 5_000_000
# What a planner's rounding leaves at the ends; a motion that starts faster would jerk the robot.
REST_VELOCITY, REST_ACCELERATION = 1e-6, 1e-3


@dataclass(frozen=True)
class Job:
    """One file to write.

    motion: the trajectory's, already slowed. rate: rows a second, None for the format's own [Hz].
    tau: torque of samples, (N, n) [N m], or None where it is not known. goal: options of ROS 2.
    """

    trajectory: Trajectory
    motion: Motion
    format: str
    path: Path
    speed: float
    rate: float | None
    tau: Torque | None
    goal: GoalOptions = field(default_factory=GoalOptions)

    @property
    def joints(self) -> tuple[str, ...]:
        return self.motion.joints


@dataclass(frozen=True)
class Written:
    """Text of a file, and of the note beside it where the format has no room for comments."""

    text: str
    note: str | None = None


def require_joints(job: Job, counts: Sequence[int]) -> None:
    """Raise UnusableInput unless the motion has one of these numbers of joints; no numbers allow
    all."""
    n = len(job.joints)
    if not counts or n in counts:
        return
    wanted = " or ".join(str(c) for c in counts)
    raise UnusableInput(
        f"{job.path}: format '{job.format}' takes {wanted} joints, this trajectory has {n} "
        f"({', '.join(job.joints)}); "
        f"choose them with 'excite design --joints', or a format for any robot such as csv"
    )


def require_rate(job: Job, rates: Sequence[float]) -> float:
    """The rate to write at [Hz]: the one asked for, which has to be among `rates`, or the first of
    these."""
    if job.rate is None:
        return rates[0]
    if job.rate not in rates:
        allowed = ", ".join(f"{r:g}" for r in rates)
        raise UnusableInput(
            f"{job.path}: format '{job.format}' is streamed at {allowed} Hz; --rate {job.rate:g} "
            "would change its speed, leave it out"
        )
    return job.rate


def require_rest(job: Job) -> None:
    """Raise UnusableInput where the motion does not begin and end at rest: a controller would be
    told to jump."""
    inside = np.array([2e-9, job.motion.duration - 2e-9])
    for order, most, unit in ((1, REST_VELOCITY, "/s"), (2, REST_ACCELERATION, "/s²")):
        value = np.abs(job.motion.at(inside, order)).max(axis=0)
        if value.max() > most:
            worst = job.joints[int(value.argmax())]
            raise UnusableInput(
                f"{job.path}: joint '{worst}' of this trajectory does not start and end at rest "
                f"({value.max():.3g} rad{unit}); design it with its ramps, 'excite design' adds "
                "them"
            )


def sampled(job: Job, rate: float) -> tuple[Array, Samples]:
    """Times k/rate and the motion there, the first and the last row exactly at rest. Shapes (N,),
    (N, n).

    Raises UnusableInput for too many rows, a motion not at rest at its ends, or one that is not
    finite.
    """
    if job.motion.duration * rate > MOST_ROWS:
        raise UnusableInput(
            f"{job.path}: {job.motion.duration:.4g} s at {rate:g} Hz is over {MOST_ROWS:,} rows; "
            "lower --rate or raise --speed"
        )
    require_rest(job)
    t = job.motion.grid(rate)
    # The grid tolerates an end that rounding puts a hair before the motion's; the last row is the
    # end all the same.
    samples = job.motion.samples(np.append(t[:-1], max(t[-1], job.motion.duration)))
    if not all(np.isfinite(part).all() for part in (samples.q, samples.dq, samples.ddq)):
        raise UnusableInput(
            f"{job.path}: the trajectory holds numbers that are not finite; design it again"
        )
    return t, samples


def notes(job: Job, details: Sequence[str], tried: bool) -> list[str]:
    """Lines that tell a reader of the file what it is, in ASCII, none with a line break: a robot's
    parser may know no more."""
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
    return [comment(line) for line in lines]


def comment(text: str) -> str:
    """A text as it may stand in a comment of any format: one line of printable ASCII.

    Every text from a trajectory that enters a file for a controller passes through here.
    """
    line = " ".join(text.split()).encode("ascii", "replace").decode()
    return "".join(letter if letter.isprintable() else "?" for letter in line)


def fixed(value: float, decimals: int | None = DECIMALS) -> str:
    """A number without exponent or negative zero; with all its digits where decimals is None.

    Without exponent, for YAML 1.1 takes 1e-05 for a word and a robot's parser may not know it at
    all.
    """
    value = float(value)
    rounded = value if decimals is None else round(value, decimals)
    if abs(rounded) < 1e-15:
        rounded = 0.0
    return np.format_float_positional(rounded, unique=True, trim="0")


def check_options(speed: float, rate: float | None) -> None:
    """Raise UnusableInput for a speed outside (0, 1] or a rate that is no positive number."""
    if not 0.0 < speed <= 1.0:
        raise UnusableInput(f"--speed {speed:g} should be above 0 and at most 1")
    if rate is not None and not (math.isfinite(rate) and rate > 0.0):
        raise UnusableInput(f"--rate {rate:g} should be a positive number of rows a second")


def beside(path: Path) -> Path:
    """Where the note to a file without comments goes."""
    return path.with_name(path.name + ".txt")


def is_note(path: Path) -> bool:
    """Return whether a file is the note to an exported file, as `notes` begins it."""
    if not os.path.isfile(path):  # a pipe would wait for its other end
        return False
    try:
        with path.open("rb") as stream:
            lines = [stream.readline(1000) for _ in range(2)]
    except OSError:  # not ours to read
        return False
    return lines[0].startswith(b"excite: ") and lines[1].startswith(b"format: ")
