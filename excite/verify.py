"""The certificate: a finished motion recomputed from its file with Pinocchio, densely, with bounds between samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import base, checks, criteria, dynamics, parameters
from .artefact import Trajectory
from .checks import Demand, Subject
from .collision import cell as cells
from .collision import sweep
from .collision.cell import NOT_CHECKED, Cell
from .collision.sweep import Near
from .errors import UnusableInput
from .limits import DERIVED
from .motion import Motion, Segment
from .problem import Box
from .robot import Robot
from .trajectory import DENSITY, Samples, oversampling_bound

Array = np.ndarray
ROUNDING = 1e-9
CELL = "cell"
CLEARANCE = "clearance"
LISTED = 12
"""Pairs of bodies that a certificate lists, the nearest to their margin."""


@dataclass(frozen=True)
class Margin:
    """How near one joint comes to one limit: the worst value with its time [s], and the bound it must not pass.

    room: distance to the bound over the half width of the allowed range; negative where the limit is broken.
    """

    limit: str
    joint: str
    time: float
    value: float
    bound: float
    room: float

    def words(self) -> str:
        """What it reaches, of what."""
        if self.limit == CLEARANCE:
            state = f"come within {1e3 * self.value:.1f} mm" if self.value > 0.0 else "collide"
            return f"{self.joint} {state} at {self.time:.2f} s, of {1e3 * self.bound:.1f} mm to keep"
        return f"{self.limit} of '{self.joint}' reaches {self.value:.4g} of {self.bound:.4g}"

    def document(self) -> dict[str, Any]:
        """As `excite verify --json` prints it."""
        return {"limit": self.limit, "joint": self.joint, "time": self.time, "value": self.value, "bound": self.bound, "margin": self.room}


@dataclass(frozen=True)
class Certificate:
    """What verification found. faults: sentences about the file itself (a jump, a wrong criterion, no rest).

    near: pairs of bodies with the least distance each, the one nearest to its margin first.
    """

    margins: tuple[Margin, ...]
    criteria: Mapping[str, Any]
    faults: tuple[str, ...]
    collision: str = NOT_CHECKED
    near: tuple[Near, ...] = ()
    joints: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Every margin kept and no fault found."""
        return not self.faults and all(margin.room >= -ROUNDING for margin in self.margins)

    def worst(self) -> Margin:
        """The margin that is nearest to, or furthest beyond, its bound."""
        return min(self.margins, key=lambda margin: margin.room)

    def short_of_clearance(self) -> dict[str, float]:
        """By how much each pair that breaks its margin misses it [m]."""
        return {m.joint: m.bound - m.value for m in self.margins if m.limit == CLEARANCE and m.room < -ROUNDING}

    def document(self) -> dict[str, Any]:
        """As `excite verify --json` prints it."""
        return {
            "ok": self.ok,
            "margins": [margin.document() for margin in self.margins],
            "criteria": dict(self.criteria),
            "collision": self.collision,
            "clearance": [near.document(self.joints) for near in self.near[:LISTED]],
            "faults": list(self.faults),
        }


def verify(trajectory: Trajectory, robot: Robot, cell: Cell | None = None) -> Certificate:
    """Recompute every limit, the distances, the junctions, the rests and the criteria of a trajectory from its file's content.

    cell: what the file states, where it is at hand already.
    """
    subject = subject_of(trajectory, robot)
    motion, limits = trajectory.motion, trajectory.limits
    margins: dict[tuple[str, str], Margin] = {}
    for segment in motion.segments:
        for start, step, demand in _demands(subject, trajectory, segment):
            ramps_only = [source == DERIVED for source in limits.sources.get(demand.limit, ("",) * len(demand.names))]
            for margin in _margins(demand, start, step):
                derived = margin.joint in robot.joints and ramps_only[robot.joints.index(margin.joint)]
                if derived and segment.profile is None:
                    continue
                key = (margin.limit, margin.joint)
                if key not in margins or margin.room < margins[key].room:
                    margins[key] = margin
    collision, near = trajectory.collision, list[Near]()
    if cell is not None or CELL in trajectory.design:
        collision, near = _distances(trajectory, robot, cell)
    margins |= {(CLEARANCE, one.names): _clearance(one) for one in near[:LISTED]}
    scores = score(trajectory, robot, subject.parameters)
    faults = [*_faults(trajectory), *_criteria_faults(trajectory, scores)]
    ordered = tuple(sorted(margins.values(), key=lambda margin: margin.room))
    return Certificate(ordered, scores, tuple(faults), collision, tuple(near), robot.joints)


def _distances(trajectory: Trajectory, robot: Robot, cell: Cell | None) -> tuple[str, list[Near]]:
    """What there is to say of collisions, and the least distances."""
    try:
        known = cell or cells.from_document(robot, trajectory.limits, trajectory.design[CELL])
    except UnusableInput as error:
        return f"{NOT_CHECKED}: {error}", []
    near = sweep.along(known, trajectory.motion)
    but = "".join(f"; {note}" for note in known.notes)
    if not near:
        return f"collision checked: nothing can meet{but}", []
    worst = min(near, key=lambda one: one.proven)
    if worst.proven <= 0.0:
        return f"COLLISION: {worst.names} at {worst.time:.2f} s{but}", near
    wide = [one for one in near if one.pair.margin >= known.margin]
    said = [f"never less than {_words(min(wide, key=lambda one: one.proven))}"] if wide else []
    close = [one for one in near if one.pair.margin < known.margin]
    said += [f"neighbours {_words(min(close, key=lambda one: one.proven))}"] if close else []
    return f"collision checked: {'; '.join(said)}{but}", near


def _words(near: Near) -> str:
    return f"{1e3 * near.proven:.1f} mm, {near.names} at {near.time:.2f} s"


def _clearance(near: Near) -> Margin:
    bound = near.pair.margin
    return Margin(CLEARANCE, near.names, near.time, near.proven, bound, near.proven / max(bound, 1e-6) - 1.0)


def subject_of(trajectory: Trajectory, robot: Robot) -> Subject:
    """What the trajectory promises to hold against."""
    design = trajectory.design
    standard = parameters.standard(robot, trajectory.limits, design.get("drive", parameters.DRIVE))
    boxes = tuple(Box(b["frame"], tuple(b["lower"]), tuple(b["upper"])) for b in design.get("boxes", ()))
    return Subject(robot, trajectory.limits, standard, float(design.get("uncertainty", 0.0)), boxes)


def score(trajectory: Trajectory, robot: Robot, standard: parameters.Parameters) -> dict[str, Any]:
    """All criteria of the Fourier part on the optimiser's grid, and of the motion as exported."""
    motion = trajectory.motion
    found = base.find(robot, standard, trajectory.limits)
    samples = int(trajectory.design.get("samples", round(motion.fourier.period * trajectory.rate)))
    parts = {"optimum": motion.fourier.samples(motion.fourier.grid(samples)), "exported": motion.samples(motion.grid(trajectory.rate))}
    return {name: criteria.score(dynamics.regressor(robot, standard, part), found, trajectory.noise) for name, part in parts.items()}


def _demands(subject: Subject, trajectory: Trajectory, segment: Segment) -> Iterator[tuple[float, float, Demand]]:
    """Demands of one segment with the start and spacing of their samples [s]."""
    motion = trajectory.motion
    fourier = motion.fourier
    if segment.profile is None:
        samples = int(trajectory.design.get("samples", 100))
        count = DENSITY * max(samples, 8 * fourier.harmonics)
        t = fourier.grid(count)
        factor = oversampling_bound(count, fourier.harmonics) - 1.0
        for order, limit in enumerate(("position", "velocity", "acceleration", "jerk")):
            values = fourier.at(t, order)
            swing = values - (fourier.offset if order == 0 else 0.0)
            more = factor * np.abs(swing).max(axis=0)
            yield segment.start, t[1], checks.symmetric(limit, subject, values - more, values + more)
        closed = np.append(t, fourier.period)  # second differences across the end of the period
        for demand in checks.loads(subject, fourier.samples(closed)):
            yield segment.start, t[1], demand
        return
    length = segment.end - segment.start
    dt = min(fourier.period / (DENSITY * int(trajectory.design.get("samples", 100))), 1.0 / trajectory.rate)
    count = max(int(np.ceil(length / dt)), 8)
    t = np.linspace(0.0, length, count + 1)
    q, dq, ddq = (segment.profile.at(t, order) for order in range(3))
    yield segment.start, t[1], checks.symmetric("position", subject, q - checks.excess(q), q + checks.excess(q))
    yield segment.start, t[1], checks.symmetric("velocity", subject, dq - checks.excess(dq), dq + checks.excess(dq))
    knots = segment.profile.knots()
    for order, limit in ((2, "acceleration"), (3, "jerk")):  # linear and constant between knots: extreme at them
        for at in (knots[knots < length - 1e-12], np.maximum(knots - 1e-12, 0.0)):
            values = segment.profile.at(at, order)
            for row, time in zip(values, at, strict=True):
                yield segment.start + time, 0.0, checks.symmetric(limit, subject, row[None], row[None])
    for demand in checks.loads(subject, Samples(q, dq, ddq)):
        yield segment.start, t[1], demand


def _margins(demand: Demand, start: float, step: float) -> Iterator[Margin]:
    half = 0.5 * (demand.upper - demand.lower)
    for j, name in enumerate(demand.names):
        if not np.isfinite(half[j]):
            continue
        above, below = int(np.argmax(demand.high[:, j])), int(np.argmin(demand.low[:, j]))
        up = float(demand.upper[j] - demand.high[above, j]) / half[j]
        down = float(demand.low[below, j] - demand.lower[j]) / half[j]
        if up <= down:
            yield Margin(demand.limit, name, start + step * above, float(demand.high[above, j]), float(demand.upper[j]), up)
        else:
            yield Margin(demand.limit, name, start + step * below, float(demand.low[below, j]), float(demand.lower[j]), down)


def _faults(trajectory: Trajectory) -> Iterator[str]:
    """Sentences about what makes a motion no motion."""
    motion, joints = trajectory.motion, trajectory.joints
    samples = motion.fourier.period * trajectory.rate
    if abs(samples - round(samples)) > 1e-6:
        yield f"the period {motion.fourier.period:g} s is no whole number of samples at {trajectory.rate:g} Hz"
    if motion.periods < 2:
        yield f"{motion.periods} period(s): noise can be told from physics only when the motion repeats"
    for before, after in zip(motion.segments, motion.segments[1:], strict=False):
        if abs(before.end - after.start) > 1e-9:
            yield f"{before.kind} ends at {before.end:g} s but {after.kind} starts at {after.start:g} s"
        for order, name in enumerate(("position", "velocity", "acceleration")):
            jump = np.abs(_end(motion, before, order) - _begin(motion, after, order))
            j = int(np.argmax(jump))
            if jump[j] > 1e-7:
                yield f"{name} of {joints[j]} jumps by {jump[j]:.2g} from {before.kind} to {after.kind}"
    for edge, segment in (("start", motion.segments[0]), ("end", motion.segments[-1])):
        read = _begin if edge == "start" else _end
        for order in (1, 2):
            speed = np.abs(read(motion, segment, order))
            if speed.max() > 1e-7:
                yield f"{joints[int(np.argmax(speed))]} is not at rest at the {edge}"


def _begin(motion: Motion, segment: Segment, order: int) -> Array:
    zero = np.zeros(1)
    out: Array = (motion.fourier.at(zero, order) if segment.profile is None else segment.profile.at(zero, order))[0]
    return out


def _end(motion: Motion, segment: Segment, order: int) -> Array:
    at = np.array([segment.end - segment.start])
    out: Array = (motion.fourier.at(at, order) if segment.profile is None else segment.profile.at(at, order))[0]
    return out


def _criteria_faults(trajectory: Trajectory, found: Mapping[str, Any]) -> Iterator[str]:
    for part, entries in found.items():
        recomputed = dict(_flat(entries))
        for name, value in _flat(trajectory.criteria[part]):
            again = recomputed.get(name)
            if value is None or again is None or not np.isfinite(again):
                continue
            if abs(again - value) > 1e-5 * max(abs(value), 1e-300):
                yield f"criterion {part}.{name} is {again:.8g}, the file says {value:.8g}"


def _flat(entries: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float | None]]:
    for key, value in entries.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value
