"""`trajectory.json`, schema excite.trajectory/1: a motion that can be replayed and checked."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from itertools import pairwise
from typing import Any, Literal, TypeAlias, get_args

import msgspec

from .. import physical_ranges as ranges
from ..physical_ranges import Range
from .cell import CellDocument
from .limits import StatedLimits
from .quantities import (
    Acceleration,
    AngularFrequency,
    FilePath,
    Gravity,
    Inertia,
    Jerk,
    Length,
    Name,
    Period,
    PhaseAcceleration,
    PhaseJerk,
    PhaseRate,
    PhaseTime,
    Position,
    PositiveMass,
    Rate,
    Sha256,
    Share,
    Speed,
    Statistic,
    Text,
    Time,
    TorqueNoise,
    Uncertainty,
    Velocity,
    shown,
)

SCHEMA = "excite.trajectory/1"
SegmentKind = Literal["approach", "ramp_in", "fourier", "ramp_out", "return"]
"""Kinds of segments of a motion."""
ORDER: tuple[str, ...] = get_args(SegmentKind)
"""Order of the segments; approach and return may consist of several."""
Drive = Literal["rotor_inertia", "viscous", "coulomb", "offset"]
MAX_ROWS = 1_000_000
"""Largest number of rows of the exported motion, over which the criterion is recomputed.

The regressor of a robot with 6 joints then takes 3 GB.
"""
TIME_TOLERANCE = 1e-6
"""Tolerance of the times in a file [s]; half the shortest control cycle in use is 60 µs."""
FREQUENCY_TOLERANCE = 1e-9
"""Relative difference of `base_frequency` and 2π over `period` that is tolerated [1]."""


InertiaNumbers: TypeAlias = tuple[
    PositiveMass, Length, Length, Length, Inertia, Inertia, Inertia, Inertia, Inertia, Inertia
]
"""Mass, centre of mass and moments xx, xy, yy, xz, yz, zz of a link."""


class PayloadDocument(msgspec.Struct):
    """A body that is attached to a link."""

    link: Name
    mass: PositiveMass
    centre: tuple[Length, Length, Length]
    inertia: tuple[Inertia, Inertia, Inertia, Inertia, Inertia, Inertia]


class RobotDocument(msgspec.Struct):
    """The robot of a document and the options with which it was loaded."""

    name: Name
    source: FilePath
    sha256: Sha256
    locked: dict[str, Position]
    payload: PayloadDocument | None
    gravity: tuple[Gravity, Gravity, Gravity]
    inertias: dict[str, InertiaNumbers] | None = None


class ProfileDocument(msgspec.Struct):
    """A ramp of piecewise constant jerk.

    Attributes:
        position: Positions at its start [rad or m].
        velocity: Velocities at its start.
        acceleration: Accelerations at its start.
        pieces: For each joint the duration [s] and the jerk of its pieces.
    """

    position: list[Position]
    velocity: list[Velocity]
    acceleration: list[Acceleration]
    pieces: dict[str, list[tuple[Time, Jerk]]]


class PhaseDocument(msgspec.Struct):
    """A ramp f(σ(t)) along the path of the Fourier part f, whose phase σ is piecewise cubic.

    start, rate, acceleration: phase [s] and its derivatives [1, 1/s] at its start. pieces:
    (duration [s], jerk of the phase [1/s²]) of each piece.
    """

    start: PhaseTime
    rate: PhaseRate
    acceleration: PhaseAcceleration
    pieces: list[tuple[Time, PhaseJerk]]


class SegmentDocument(msgspec.Struct):
    """A segment of a motion: a ramp has a profile or a phase, the Fourier segment has neither."""

    kind: SegmentKind
    start: Time
    end: Time
    profile: ProfileDocument | None = None
    phase: PhaseDocument | None = None

    def __post_init__(self) -> None:
        if self.profile is not None and self.phase is not None:
            raise ValueError(f"the {self.kind} has both a profile and a phase")
        if self.phase is not None and self.kind not in ("ramp_in", "ramp_out"):
            raise ValueError(f"the {self.kind} has a phase, as ramps alone may have")
        if (self.profile is None and self.phase is None) != (self.kind == "fourier"):
            raise ValueError(
                "the Fourier part has no profile"
                if self.kind == "fourier"
                else f"the {self.kind} has no profile"
            )
        if self.end < self.start:
            raise ValueError(f"it ends at {self.end:g} s, before it starts at {self.start:g} s")


class BoxDocument(msgspec.Struct):
    """A box in which the origin of a frame stays."""

    frame: Name
    lower: tuple[Length, Length, Length]
    upper: tuple[Length, Length, Length]


class DesignDocument(msgspec.Struct):
    """The options of a design that verification reads; other keys are kept."""

    criterion: Literal["a", "d", "e", "cond", "cond_regressor"] | None = None
    plain: bool = False
    drive: list[Drive] | None = None
    samples: int | None = None
    uncertainty: Uncertainty = Uncertainty(0.0)
    margin: dict[str, Share] = {}
    speed: Speed = Speed(1.0)
    boxes: list[BoxDocument] = []
    cell: CellDocument | None = None

    def __post_init__(self) -> None:
        if self.samples is not None:
            _check_count("samples", self.samples, ranges.SAMPLES)
        if self.drive is not None and len(set(self.drive)) < len(self.drive):
            raise ValueError("drive: a parameter is named twice")


class ScoresDocument(msgspec.Struct):
    """One family of criteria; null where the information is singular."""

    a: Statistic | None
    d: Statistic | None
    e: Statistic | None
    cond: Statistic | None


class PartCriteriaDocument(msgspec.Struct):
    """The criteria of one part of a motion."""

    geometric: ScoresDocument
    plain: ScoresDocument
    cond_regressor: Statistic | None


class CriteriaDocument(msgspec.Struct):
    """The criteria of the Fourier part and of the motion as exported."""

    optimum: PartCriteriaDocument
    exported: PartCriteriaDocument


class MarginDocument(msgspec.Struct):
    """The margin of a joint to a limit."""

    limit: Text
    joint: Text
    time: Statistic | None
    value: Statistic | None
    bound: Statistic | None
    margin: Statistic | None


class TrajectoryDocument(msgspec.Struct):
    """The complete file."""

    schema: Literal["excite.trajectory/1"]
    robot: RobotDocument
    joints: list[Name]
    base_frequency: AngularFrequency
    harmonics: int
    period: Period
    periods: int
    sine: list[list[Velocity]]
    cosine: list[list[Velocity]]
    offset: list[Position]
    segments: list[SegmentDocument]
    rate: Rate
    limits: StatedLimits
    torque_noise: dict[str, TorqueNoise]
    criteria: CriteriaDocument
    margins: list[MarginDocument]
    collision: Text
    seed: int
    versions: dict[str, Text]
    design: DesignDocument = msgspec.field(default_factory=DesignDocument)
    forced: bool = False

    def __post_init__(self) -> None:
        _check_joints(self.joints)
        _check_series(self)
        _check_segments(self)
        _check_limits(self.limits, self.joints)
        _check_keys("torque_noise", self.torque_noise, self.joints)
        for key in set(self.design.margin) - {"velocity", "acceleration", "jerk", "torque"}:
            raise ValueError(f"design.margin: {shown(key)} is no kind of limit")
        _check_count("seed", self.seed, ranges.SEED)
        if self.segments[-1].end * self.rate > MAX_ROWS:
            length = f"{self.segments[-1].end:.4g} s at {self.rate:g} Hz"
            raise ValueError(f"rate: {length} are more than {MAX_ROWS} rows")


def _check_count(key: str, count: int, accepted: Range) -> None:
    """Raise ValueError for a whole number outside its range."""
    if not accepted.accepts(count):
        raise ValueError(f"{key}: {shown(count)} should be {accepted}")


def _check_joints(joints: Sequence[str]) -> None:
    if not joints:
        raise ValueError("joints: is empty")
    if len(set(joints)) < len(joints):
        raise ValueError(
            f"joints: {shown(next(j for j in joints if joints.count(j) > 1))} is named twice"
        )


def _check_series(document: TrajectoryDocument) -> None:
    """Raise ValueError unless coefficients, joints, harmonics, frequency and period fit."""
    n = len(document.joints)
    _check_count("harmonics", document.harmonics, ranges.HARMONICS)
    _check_count("periods", document.periods, ranges.PERIODS)
    for key, rows in (("sine", document.sine), ("cosine", document.cosine)):
        if len(rows) != n:
            raise ValueError(f"{key}: should hold {n} rows, one a joint, not {len(rows)}")
        for i, row in enumerate(rows):
            if len(row) != document.harmonics:
                expected = f"should hold {document.harmonics} numbers, one a harmonic"
                raise ValueError(f"{key}[{i}]: {expected}, not {len(row)}")
    if len(document.offset) != n:
        raise ValueError(
            f"offset: should hold {n} numbers, one a joint, not {len(document.offset)}"
        )
    if abs(document.base_frequency * document.period / (2.0 * math.pi) - 1.0) > FREQUENCY_TOLERANCE:
        frequency, period = f"{document.base_frequency:g} rad/s", f"{document.period:g} s"
        raise ValueError(f"base_frequency: {frequency} is not 2π over the period of {period}")


def _check_segments(document: TrajectoryDocument) -> None:
    """Raise ValueError unless the segments follow each other without gaps from time 0.

    One of them is the Fourier part, as long as its periods.
    """
    segments, expected = document.segments, document.periods * document.period
    parts = [i for i, segment in enumerate(segments) if segment.kind == "fourier"]
    if len(parts) != 1:
        raise ValueError(f"segments: should hold one Fourier part, not {len(parts)}")
    if abs(segments[0].start) > TIME_TOLERANCE:
        raise ValueError(f"segments[0].start: {segments[0].start:g} s should be 0")
    for i, (before, after) in enumerate(pairwise(segments), start=1):
        if ORDER.index(after.kind) < ORDER.index(before.kind):
            raise ValueError(f"segments[{i}].kind: {after.kind} cannot follow {before.kind}")
        if abs(after.start - before.end) > TIME_TOLERANCE:
            end = f"where {before.kind} ends, {before.end:g} s"
            raise ValueError(f"segments[{i}].start: {after.start:g} s is not {end}")
    length = segments[parts[0]].end - segments[parts[0]].start
    if abs(length - expected) > TIME_TOLERANCE:
        stated = f"{document.periods} periods of {document.period:g} s"
        raise ValueError(
            f"segments[{parts[0]}]: lasts {length:g} s, but {stated} last {expected:g} s"
        )
    for i, segment in enumerate(segments):
        if segment.profile is not None:
            _check_profile(f"segments[{i}].profile", segment.profile, document.joints)


def _check_profile(where: str, profile: ProfileDocument, joints: Sequence[str]) -> None:
    for key in ("position", "velocity", "acceleration"):
        count = len(getattr(profile, key))
        if count != len(joints):
            expected = f"should hold {len(joints)} numbers, one a joint"
            raise ValueError(f"{where}.{key}: {expected}, not {count}")
    _check_keys(f"{where}.pieces", profile.pieces, joints)


def _check_limits(limits: StatedLimits, joints: Sequence[str]) -> None:
    """Raise ValueError unless every joint has its limits; the position limit is optional."""
    for quantity in ("position", "velocity", "acceleration", "jerk", "torque", "braking"):
        optional = quantity in ("position", "braking")
        _check_keys(f"limits.{quantity}", getattr(limits, quantity), joints, optional=optional)


def _check_keys(
    where: str, table: dict[str, Any], joints: Collection[str], *, optional: bool = False
) -> None:
    """Raise ValueError for a joint without an entry, or an entry that is no joint."""
    for name in table:
        if name not in joints:
            raise ValueError(f"{where}: {shown(name)} is none of the joints")
    for joint in joints:
        if joint not in table and not optional:
            raise ValueError(f"{where}: has no entry for the joint {shown(joint)}")
