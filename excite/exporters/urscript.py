"""URScript: a program that computes the motion on the controller from its formulas.

A table of 20 s at 500 Hz has 60,000 numbers, more than controllers are known to load. The program
contains the parameters of the trajectory instead: for each ramp the initial state and the intervals
of constant jerk, for the periodic part the Fourier coefficients. In every control cycle it computes
one set point and passes it to servoj, which takes one cycle. Time is counted in cycles, so speed
scaling slows the motion down without changing its path. The program first moves to the start pose
with movej, slowly and without checking for obstacles, and holds the last pose for HOLD before
stopj, because servoj follows with a delay. To run it, send the file to port 30002 of the
controller.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from .._system.comments import ascii_line
from .._types import FloatArray
from ..errors import UnusableInput
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import JerkProfile, Motion, MotionSegment, PhaseProfile, SegmentKind
from .file_format import (
    Columns,
    ExportedText,
    ExportJob,
    fixed,
    notes,
    require_joints,
    require_rest,
    require_turning,
)

STEP_RATES = (500.0, 250.0, 125.0)
"""Control rates of Universal Robots' controllers, e-Series first [Hz]."""
LOOKAHEAD = 0.1
"""Look-ahead time of servoj [s]: the default of URScript."""
GAIN = 300
"""Proportional gain of servoj [1]: the default of URScript."""
HOLD = 0.5
"""Time at the last pose before the program ends [s]."""
JOINTS = range(6)
"""Indices of the joints."""

_TAYLOR = ", ".join(
    f"pos[{i}] + s * (vel[{i}] + s * (acc[{i}] / 2.0 + s * jerk[{i}] / 6.0))" for i in JOINTS
)
_FUNCTIONS = f"""\
  def follow(target):
    servoj(target, t=dt, lookahead_time={LOOKAHEAD}, gain={GAIN})
    tick = tick + 1
  end
  def enter(start, position, velocity, acceleration):
    origin = start
    pos = position
    vel = velocity
    acc = acceleration
  end
  def piece(duration, jerk):
    local s = tick * dt - origin
    while s < duration:
      follow([{_TAYLOR}])
      s = tick * dt - origin
    end
    local i = 0
    while i < 6:
      pos[i] = pos[i] + duration * (vel[i] + duration * (acc[i] / 2.0 + duration * jerk[i] / 6.0))
      vel[i] = vel[i] + duration * (acc[i] + duration * jerk[i] / 2.0)
      acc[i] = acc[i] + duration * jerk[i]
      i = i + 1
    end
    origin = origin + duration
  end
"""

_SERIES = """\
  def series(start, end_time):
    while tick * dt < end_time:
      wave(tick * dt - start)
    end
  end
  def warp(start, duration, phase, rate, acceleration, jerk):
    local s = tick * dt - start
    while s < duration:
      wave(phase + s * (rate + s * (acceleration / 2.0 + s * jerk / 6.0)))
      s = tick * dt - start
    end
  end
"""


def _vector(values: Iterable[float]) -> str:
    return "[" + ", ".join(fixed(v, None) for v in values) + "]"


def _pieces(profile: JerkProfile, duration: float) -> Iterator[tuple[float, FloatArray]]:
    """Intervals of constant jerk of all joints, from the start of a segment to its end.

    Yields:
        Duration [s] and jerk, shape (n,), of each interval.
    """
    knots = np.unique(np.append(profile.knots(), duration))
    knots = knots[knots <= duration]
    for begin, end in pairwise(knots.tolist()):
        if end - begin > 1e-15:
            yield end - begin, profile.at(np.array([(begin + end) / 2]), 3)[0]


def _series(fourier: FourierSeries) -> Iterator[str]:
    """Yield the functions that follow the periodic part: position amplitudes, one line a joint."""
    orders = range(1, fourier.harmonics + 1)
    k = fourier.omega * np.arange(1, fourier.harmonics + 1)
    sine, cosine = fourier.sine / k, -fourier.cosine / k
    names = [*(f"s{o}" for o in orders), *(f"c{o}" for o in orders), *(f"q{i}" for i in JOINTS)]
    yield "  def wave(phase):"
    yield f"    local x = {fixed(fourier.omega, None)} * phase"
    yield from (f"    local {name} = 0.0" for name in names)
    for o in orders:
        yield f"    s{o} = sin({o} * x)"
        yield f"    c{o} = cos({o} * x)"
    for i in JOINTS:
        terms = [
            f"({fixed(sine[i, o - 1], None)}) * s{o} + ({fixed(cosine[i, o - 1], None)}) * c{o}"
            for o in orders
        ]
        yield f"    q{i} = {' + '.join([f'({fixed(fourier.offset[i], None)})', *terms])}"
    yield f"    follow([{', '.join(f'q{i}' for i in JOINTS)}])"
    yield "  end"
    yield from _SERIES.splitlines()


def _warped(profile: PhaseProfile, start: float, duration: float) -> Iterator[str]:
    """Yield the calls that follow a ramp along the path of the periodic part, one per cubic."""
    knots = np.unique(np.append(profile.knots(), duration))
    for begin, end in pairwise(knots[knots <= duration].tolist()):
        if end - begin > 1e-15:
            state = [profile.phase.at(begin, order)[0] for order in range(3)]
            jerk = profile.phase.at(0.5 * (begin + end), 3)[0]
            numbers = [start + begin, end - begin, *state, jerk]
            yield f"  warp({', '.join(fixed(number, None) for number in numbers)})"


def _run(motion: Motion) -> Iterator[str]:
    for segment in motion.segments:
        yield f"  # {ascii_line(segment.kind)}"
        if segment.profile is None:
            yield f"  series({fixed(segment.start, None)}, {fixed(segment.end, None)})"
            continue
        p = segment.profile
        if isinstance(p, PhaseProfile):
            yield from _warped(p, segment.start, segment.end - segment.start)
            continue
        state = ", ".join(_vector(values) for values in (p.position, p.velocity, p.acceleration))
        yield f"  enter({fixed(segment.start, None)}, {state})"
        for duration, jerk in _pieces(p, segment.end - segment.start):
            yield f"  piece({fixed(duration, None)}, {_vector(jerk)})"


def render_program(job: ExportJob) -> ExportedText:
    """Return the program.

    Its step is that of the controller, unless the job states a rate of 500, 250 or 125 Hz.

    Raises:
        UnusableInput: The motion does not have six joints, one of them slides, it does not begin
            and end at rest, or the rate is not supported.
    """
    require_joints(job, (6,))
    require_turning(job)
    require_rest(job)
    if job.rate is not None and job.rate not in STEP_RATES:
        raise UnusableInput(
            f"{job.path}: format 'urscript' steps at 500, 250 or 125 Hz; leave --rate {job.rate:g} "
            "out to take the controller's own"
        )
    motion, step = job.motion, "get_steptime()" if job.rate is None else fixed(1.0 / job.rate, None)
    begin, end = motion.end_poses
    lines = [
        *(
            f"# {line}"
            for line in notes(
                job, ["begins with a movej to its start pose that looks out for nothing"], False
            )
        ),
        "def excite_motion():",
        f"  global dt = {step}",
        "  global tick = 1",
        "  global origin = 0.0",
        *(f"  global {name} = {_vector(np.zeros(6))}" for name in ("pos", "vel", "acc")),
        _FUNCTIONS.rstrip("\n"),
        *_series(motion.fourier),
        f"  movej({_vector(begin)}, a=0.5, v=0.2)",
        *_run(motion),
        "  # hold",
        f"  while tick * dt < {fixed(motion.duration + HOLD, None)}:",
        f"    follow({_vector(end)})",
        "  end",
        "  stopj(2.0)",
        "end",
    ]
    return ExportedText("\n".join(lines) + "\n")


_NUMBER = re.compile(r"-?\d+\.?\d*(?:[eE][-+]?\d+)?")


def _numbers(text: str) -> list[float]:
    return [float(number) for number in _NUMBER.findall(text)]


def rebuilt_motion(text: str) -> Motion:
    """Rebuild the motion of a program from the numbers in its text.

    Args:
        text: A program that `render_program` returned.

    Raises:
        ValueError: The text is no such program.
    """
    lines = [line.strip() for line in text.splitlines()]
    omega = [
        _numbers(line.partition("*")[0])[0]
        for line in lines
        if line.startswith("local x = ") and "phase" in line
    ]
    rows = [_coefficients(line) for line in lines if re.match(r"q\d = ", line)]
    if len(omega) != 1 or len(rows) != 6:
        raise ValueError("it is no program that excite wrote")
    table = np.array(rows)
    k = omega[0] * np.arange(1, table.shape[1] // 2 + 1)
    fourier = FourierSeries(
        table[:, 1::2] * k, -table[:, 2::2] * k, table[:, 0], 2.0 * np.pi / omega[0]
    )
    segments: list[MotionSegment] = []
    comment_text = ""
    for line in lines:
        if line.startswith("# "):
            comment_text = line[2:]
        elif line.startswith("series("):
            start, end = _numbers(line)
            segments.append(MotionSegment(SegmentKind(comment_text), start, end))
        elif line.startswith("enter("):
            start, *state = _numbers(line)
            segments.append(
                MotionSegment(
                    SegmentKind(comment_text),
                    start,
                    start,
                    JerkProfile(*_thirds(state), ((),) * 6),
                )
            )
        elif line.startswith("warp("):
            _add_warp(segments, SegmentKind(comment_text), fourier, _numbers(line))
        elif line.startswith("piece("):
            segments[-1] = _extended(segments[-1], *_numbers(line))
    return Motion(tuple(f"joint {i}" for i in JOINTS), fourier, 1, tuple(segments))


def _add_warp(
    segments: list[MotionSegment], kind: SegmentKind, fourier: FourierSeries, numbers: list[float]
) -> None:
    """Begin a ramp along the path of the periodic part, or continue the last one."""
    start, duration, phase, rate, acceleration, jerk = numbers
    last = segments[-1] if segments else None
    if last is not None and last.kind == kind and isinstance(last.profile, PhaseProfile):
        before = last.profile.phase
        row = (*before.pieces[0], (duration, jerk))
        longer = JerkProfile(before.position, before.velocity, before.acceleration, (row,))
        profile = PhaseProfile(fourier, longer)
        segments[-1] = MotionSegment(kind, last.start, last.end + duration, profile)
        return
    pieces = (((duration, jerk),),)
    state = JerkProfile(np.array([phase]), np.array([rate]), np.array([acceleration]), pieces)
    profile = PhaseProfile(fourier, state)
    segments.append(MotionSegment(kind, start, start + duration, profile))


def _thirds(state: list[float]) -> tuple[FloatArray, FloatArray, FloatArray]:
    position, velocity, acceleration = np.array(state).reshape(3, 6)
    return position, velocity, acceleration


def _coefficients(line: str) -> list[float]:
    return [float(number) for number in re.findall(r"\(([^)]*)\)", line)]


def _extended(segment: MotionSegment, duration: float, *jerk: float) -> MotionSegment:
    if not isinstance(segment.profile, JerkProfile):
        raise ValueError("a piece stands before the state it starts from")
    p = segment.profile
    pieces = tuple((*before, (duration, j)) for before, j in zip(p.pieces, jerk, strict=True))
    return MotionSegment(
        segment.kind,
        segment.start,
        segment.end + duration,
        JerkProfile(p.position, p.velocity, p.acceleration, pieces),
    )


def read(path: Path) -> Columns:
    """Read the motion of a program at the step of the program, or 2 ms if it does not state one.

    Returns:
        Times, shape (N,) [s], positions, velocities and accelerations, shape (N, 6) each.

    Raises:
        ValueError: The file is no program that `render_program` returned.
    """
    text = path.read_text(encoding="utf-8")
    motion = rebuilt_motion(text)
    step = re.search(r"global dt = ([\d.]+)$", text, re.MULTILINE)
    t = motion.grid(1.0 / float(step[1]) if step else STEP_RATES[0])
    samples = motion.samples(t)
    return t, samples.q, samples.dq, samples.ddq
