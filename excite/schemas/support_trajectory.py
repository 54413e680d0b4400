"""`trajectory.json`, schema excite.support_trajectory/1: motions of a robot on its feet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import msgspec

from .. import physical_ranges as ranges
from .cell import CellDocument
from .limits import StatedLimits
from .quantities import (
    AngularFrequency,
    ClearanceDistance,
    Coefficient,
    Length,
    Name,
    Period,
    PhaseJerk,
    Position,
    Rate,
    Share,
    Size,
    Text,
    Time,
    TorqueNoise,
    Velocity,
    shown,
)
from .trajectory import (
    FREQUENCY_TOLERANCE,
    MAX_ROWS,
    TIME_TOLERANCE,
    MarginDocument,
    RobotDocument,
)

SCHEMA = "excite.support_trajectory/1"
MAX_FEET = 2
"""Largest number of feet on the ground."""


class FootDocument(msgspec.Struct):
    """A foot on the ground.

    Attributes:
        frame: Name of its contact frame.
        joints: Joints between the base link and the foot.
        half_length: Half of the length of the sole along x [m].
        half_width: Half of its width along y [m].
        centre: Centre of the sole in the world [m].
        sole_centre: Centre of the sole in the contact frame [m].
        sole_source: Where the size of the sole comes from.
        outline: Corners (x, y) of the sole's outline about its centre; none: the rectangle [m].
    """

    frame: Name
    joints: list[Name]
    half_length: Size
    half_width: Size
    centre: tuple[Length, Length, Length]
    sole_centre: tuple[Length, Length, Length]
    sole_source: Text = Text("")
    outline: list[tuple[Length, Length]] = []


class ContactDocument(msgspec.Struct):
    """Limits of the contact: friction [1], margin of the centre of pressure [m], least load [1]."""

    friction: Coefficient
    cop_margin: ClearanceDistance
    least_share: Share

    def __post_init__(self) -> None:
        if self.friction <= 0.0:
            raise ValueError(f"friction: {shown(float(self.friction))} should be positive")


class StandingDocument(msgspec.Struct):
    """The pose at which each motion starts and ends: base coordinates and joint positions."""

    base: dict[str, Position]
    joints: dict[str, Position]


class SupportMotionDocument(msgspec.Struct):
    """Fourier series of the independent coordinates of one motion."""

    sine: list[list[Velocity]]
    cosine: list[list[Velocity]]
    offset: list[Position]


class WrenchNoiseDocument(msgspec.Struct):
    """Standard deviation of the base rows: force [N] and moment [N m]."""

    force: TorqueNoise
    moment: TorqueNoise


class SupportDesignDocument(msgspec.Struct):
    """The options of a design that verification reads; other keys are kept.

    Attributes:
        margin: Shares of limits that the motions promise to keep free, by kind.
        cell: Bodies that keep their distance.
    """

    margin: dict[str, Share] = {}
    cell: CellDocument | None = None


class SupportTrajectoryDocument(msgspec.Struct):
    """The complete file."""

    schema: Literal["excite.support_trajectory/1"]
    robot: RobotDocument
    joints: list[Name]
    support: list[FootDocument]
    contact: ContactDocument
    standing: StandingDocument
    coordinates: list[Name]
    base_frequency: AngularFrequency
    harmonics: int
    period: Period
    duration: Time
    phase: list[tuple[Time, PhaseJerk]]
    motions: list[SupportMotionDocument]
    rate: Rate
    limits: StatedLimits
    wrench_noise: WrenchNoiseDocument
    torque_noise: dict[str, TorqueNoise]
    criterion: Literal["a", "d"]
    identifiable: list[int]
    base_parameters: int
    margins: list[MarginDocument]
    collision: Text
    seed: int
    versions: dict[str, Text]
    design: SupportDesignDocument

    def __post_init__(self) -> None:
        if not 1 <= len(self.support) <= MAX_FEET:
            raise ValueError(f"support: should hold 1 or {MAX_FEET} feet, not {len(self.support)}")
        if not self.motions:
            raise ValueError("motions: is empty")
        if len(self.identifiable) != len(self.motions):
            raise ValueError(
                f"identifiable: should hold {len(self.motions)} numbers, one a motion, not "
                f"{len(self.identifiable)}"
            )
        _check_names("standing.joints", self.standing.joints, self.joints)
        _check_names("torque_noise", self.torque_noise, self.joints)
        for quantity in ("velocity", "torque"):
            _check_names(f"limits.{quantity}", getattr(self.limits, quantity), self.joints)
        for number, motion in enumerate(self.motions):
            _check_motion(f"motions[{number}]", motion, len(self.coordinates), self.harmonics)
        if not ranges.HARMONICS.accepts(self.harmonics):
            raise ValueError(f"harmonics: {shown(self.harmonics)} should be {ranges.HARMONICS}")
        if abs(self.base_frequency * self.period / (2.0 * math.pi) - 1.0) > FREQUENCY_TOLERANCE:
            raise ValueError(f"base_frequency: is not 2π over the period of {self.period:g} s")
        length = sum(duration for duration, _ in self.phase)
        if abs(length - self.duration) > TIME_TOLERANCE:
            raise ValueError(
                f"duration: {self.duration:g} s, but the pieces of the phase last {length:g} s"
            )
        if len(self.motions) * self.duration * self.rate > MAX_ROWS:
            raise ValueError(f"rate: the motions have more than {MAX_ROWS} rows")


def _check_names(where: str, table: Mapping[str, object], names: Sequence[str]) -> None:
    """Raise ValueError unless a table has exactly these keys."""
    for name in names:
        if name not in table:
            raise ValueError(f"{where}: has no entry for the joint {shown(name)}")
    for name in table:
        if name not in names:
            raise ValueError(f"{where}: {shown(name)} is none of the joints")


def _check_motion(
    where: str, motion: SupportMotionDocument, coordinates: int, harmonics: int
) -> None:
    """Raise ValueError unless a motion has as many coefficients as coordinates and harmonics."""
    for key, rows in (("sine", motion.sine), ("cosine", motion.cosine)):
        if len(rows) != coordinates or any(len(row) != harmonics for row in rows):
            raise ValueError(
                f"{where}.{key}: should hold {coordinates} rows of {harmonics} numbers"
            )
    if len(motion.offset) != coordinates:
        raise ValueError(f"{where}.offset: should hold {coordinates} numbers")
