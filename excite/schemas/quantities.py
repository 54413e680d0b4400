"""Numbers and names of documents, each type with its accepted range and unit.

A field of a struct is annotated with one of these types; `converted` checks a value and makes it
one. They are floats and strings, so that the code behind the reader computes with them as they are.
"""

from __future__ import annotations

import math
import re
import unicodedata
from typing import Any, ClassVar

from .. import physical_ranges as ranges
from ..physical_ranges import Range

LONGEST_NAME = 1000
"""Longest name [characters]. The longest joint name among 100 published URDFs has 60."""
LONGEST_TEXT = 100_000
"""Longest text other than the URDF in a model [characters]: notes, sources, statements."""
LONGEST_PATH = 4096
"""Longest path [bytes]: PATH_MAX of Linux."""
LONGEST_FILE_NAME = 255
"""Longest part of a path [bytes]: NAME_MAX of common file systems."""
MAX_SHOWN = 40
"""Longest part of a value that a message repeats [characters]."""


def shown(value: Any, longest: int = MAX_SHOWN) -> str:
    """Format a value for a message: printable, on one line, of at most `longest` characters."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    if (
        isinstance(value, int) and value.bit_length() > 100
    ):  # Python refuses to convert it, or takes long
        return f"an integer of about {int(value.bit_length() * math.log10(2.0)) + 1} digits"
    text = repr(value)
    printable = "".join(
        letter if letter.isprintable() else f"\\u{ord(letter):04x}" for letter in text
    )
    return printable if len(printable) <= longest else f"{printable[:longest]}…"


def _positive(accepted: Range, smallest: float | None = None) -> Range:
    """Restrict a range to positive numbers."""
    least = accepted.smallest if smallest is None else smallest
    return Range(least, accepted.upper, accepted.unit)


class Quantity(float):
    """A finite number with a unit.

    Attributes:
        accepted: Its range, with the unit.
    """

    accepted: ClassVar[Range] = Range(-1e15, 1e15, "1")


class Coefficient(Quantity):
    """A linear coefficient of an effect, whose unit depends on the effect."""


class Position(Quantity):
    """A joint position, or a bound of one."""

    accepted = ranges.POSITION


class Velocity(Quantity):
    """A joint velocity; at rest it may be a rounding error."""

    accepted = Range(ranges.VELOCITY.lower, ranges.VELOCITY.upper, ranges.VELOCITY.unit)


class Acceleration(Quantity):
    """A joint acceleration: at most the largest velocity gained in 1 ms, a usual control cycle."""

    accepted = Range(-1e9, 1e9, "rad/s² or m/s²")


class Jerk(Quantity):
    """A joint jerk: at most the largest acceleration gained in 1 ms."""

    accepted = Range(-1e12, 1e12, "rad/s³ or m/s³")


class VelocityLimit(Quantity):
    """A velocity limit."""

    accepted = _positive(ranges.VELOCITY)


class AccelerationLimit(Quantity):
    """An acceleration limit."""

    accepted = _positive(Acceleration.accepted, 1e-9)


class JerkLimit(Quantity):
    """A jerk limit."""

    accepted = _positive(Jerk.accepted, 1e-9)


class TorqueLimit(Quantity):
    """A torque limit, or a force limit of a prismatic joint."""

    accepted = _positive(ranges.EFFORT)


class VelocityOffset(Quantity):
    """The offset of a velocity limit that depends on position."""

    accepted = Range(0.0, ranges.VELOCITY.upper, ranges.VELOCITY.unit)


class Torque(Quantity):
    """A torque or force of either sign."""

    accepted = Range(ranges.EFFORT.lower, ranges.EFFORT.upper, ranges.EFFORT.unit)


class TorqueNoise(Quantity):
    """A standard deviation of torque; it is a divisor, hence not 0."""

    accepted = Range(1e-12, ranges.EFFORT.upper, ranges.EFFORT.unit)


class CoulombFriction(Quantity):
    """Coulomb friction, which dissipates energy: not negative."""

    accepted = Range(0.0, ranges.COULOMB_FRICTION.upper, ranges.COULOMB_FRICTION.unit)


class ViscousFriction(Quantity):
    """Viscous friction, which dissipates energy: not negative."""

    accepted = Range(0.0, ranges.VISCOUS_FRICTION.upper, ranges.VISCOUS_FRICTION.unit)


class RotorInertia(Quantity):
    """Reflected rotor inertia."""

    accepted = Range(0.0, ranges.ROTOR_INERTIA.upper, ranges.ROTOR_INERTIA.unit)


class InertialParameter(Quantity):
    """One of the ten inertial parameters of a link: mass, first moment or inertia."""

    accepted = Range(ranges.INERTIA.lower, ranges.INERTIA.upper, "kg, kg m or kg m²")


class Mass(Quantity):
    """A mass, 0 included."""

    accepted = Range(0.0, ranges.MASS.upper, ranges.MASS.unit)


class PositiveMass(Quantity):
    """A mass above 0: at least a milligram, below which the estimator cannot tell it from 0."""

    accepted = Range(1e-6, ranges.MASS.upper, ranges.MASS.unit)


class Inertia(Quantity):
    """An element of an inertia tensor."""

    accepted = ranges.INERTIA


class Length(Quantity):
    """A coordinate."""

    accepted = ranges.LENGTH


class Size(Quantity):
    """A dimension of a shape."""

    accepted = ranges.SIZE


class ClearanceDistance(Quantity):
    """A distance that bodies must keep."""

    accepted = Range(0.0, ranges.LENGTH.upper, "m")


class Angle(Quantity):
    """A roll, pitch or yaw angle."""

    accepted = ranges.ANGLE


class MeshScale(Quantity):
    """A scale of a mesh along an axis; a mesh must not be mirrored."""

    accepted = Range(ranges.MESH_SCALE.smallest, ranges.MESH_SCALE.upper, "1")


class ShapeSize(Quantity):
    """A size of a shape, or a scale of a mesh, which a URDF may mirror by a negative one."""

    accepted = ranges.MESH_SCALE


class Gravity(Quantity):
    """A component of the acceleration of gravity."""

    accepted = ranges.GRAVITY


class Time(Quantity):
    """A time of a motion or a recording: at most 12 days."""

    accepted = Range(0.0, 1e6, "s")


class ClockTime(Quantity):
    """A time on the clock of a recording, which may count from 1970: within 3000 years."""

    accepted = Range(-1e11, 1e11, "s")


class Period(Quantity):
    """A period of an excitation: at least a control cycle, at most 12 days."""

    accepted = ranges.PERIOD


class PhaseTime(Quantity):
    """A phase of an excitation, as the time at which the periodic motion has it."""

    accepted = Range(-ranges.PERIOD.upper, ranges.PERIOD.upper, "s")


class PhaseRate(Quantity):
    """The rate of a phase over its rate in the periodic motion; a ramp never runs faster."""

    accepted = Range(-1.0, 1.0, "1")


class PhaseAcceleration(Quantity):
    """The acceleration of a phase: from 0 to 1 within 1 ms at most, a usual control cycle."""

    accepted = Range(-1e3, 1e3, "1/s")


class PhaseJerk(Quantity):
    """The jerk of a phase: the largest acceleration gained in 1 ms at most."""

    accepted = Range(-1e6, 1e6, "1/s²")


class Rate(Quantity):
    """Sampling rate."""

    accepted = ranges.RATE


class AngularFrequency(Quantity):
    """The base frequency of a Fourier series, 2π over a `Period`."""

    accepted = Range(
        2.0 * math.pi / Period.accepted.upper, 2.0 * math.pi / Period.accepted.lower, "rad/s"
    )


class Band(Quantity):
    """Cutoff frequency of a low-pass filter."""

    accepted = ranges.RATE


class FrictionWidth(Quantity):
    """Velocity over which Coulomb friction changes its sign."""

    accepted = Range(1e-12, ranges.VELOCITY.upper, ranges.VELOCITY.unit)


class Share(Quantity):
    """Share of a limit that is kept free, below 1."""

    accepted = Range(0.0, math.nextafter(1.0, 0.0), "1")


class Speed(Quantity):
    """Share of full speed, above 0."""

    accepted = Range(1e-6, 1.0, "1")


class Uncertainty(Quantity):
    """Radius, in the metric H₀, of the ball of parameters for which torque limits hold."""

    accepted = Range(0.0, 1e3, "1")


class DriveGain(Quantity):
    """Torque per motor current, of either sign but not 0."""

    accepted = Range(-1e6, 1e6, "N m/A", smallest=1e-9, zero=False)


class PositionGain(Quantity):
    """Gain of a position loop in any unit."""

    accepted = Range(0.0, 1e9, "1", smallest=1e-9, zero=False)


class PositionError(Quantity):
    """Position error at which a motor saturates."""

    accepted = Range(0.0, 1e3, "rad or m", smallest=1e-6, zero=False)


class CommandDelay(Quantity):
    """Time by which a command acts late."""

    accepted = Range(0.0, 10.0, "s")


class Statistic(Quantity):
    """A number that is reported and not used in a computation."""

    accepted = Range(-math.inf, math.inf, "1")


class Covariance(Quantity):
    """Covariance of two parameters."""

    accepted = Range(-1e12, 1e12, "SI units")


class Name(str):
    """Name of a robot, a joint, a link or a frame; see `name_fault`."""


class Text(str):
    """Any text up to LONGEST_TEXT characters."""


class FilePath(str):
    """A path that is valid for the operating system."""


class Sha256(str):
    """A SHA-256 digest in hexadecimal digits."""


def unprintable(text: str) -> str | None:
    """Return the first control character or line separator of a text, None without one."""
    return next(
        (letter for letter in text if unicodedata.category(letter) in ("Cc", "Zl", "Zp")), None
    )


def name_fault(text: str) -> str | None:
    """Describe why a text is no valid name; None if it is one."""
    if not text.strip():
        return "the name is empty"
    if len(text) > LONGEST_NAME:
        return f"the name has {len(text)} characters, more than {LONGEST_NAME}"
    control = unprintable(text)
    return None if control is None else f"the name has the control character U+{ord(control):04X}"


def _text(kind: type, value: str) -> str:
    if issubclass(kind, Name):
        if (fault := name_fault(value)) is not None:
            raise ValueError(fault)
    elif issubclass(kind, FilePath):
        longest = max((len(part.encode()) for part in value.split("/")), default=0)
        if (
            not value
            or unprintable(value) is not None
            or len(value.encode()) > LONGEST_PATH
            or longest > LONGEST_FILE_NAME
        ):
            raise ValueError(f"{shown(value)} is no path of a file")
    elif issubclass(kind, Sha256):
        if re.fullmatch(r"[0-9a-fA-F]{64}", value) is None:
            raise ValueError(f"{shown(value)} should be 64 hexadecimal digits")
    elif len(value) > LONGEST_TEXT:
        raise ValueError(f"the text has {len(value)} characters, more than {LONGEST_TEXT}")
    return kind(value)


def converted(kind: type, value: Any) -> Any:
    """Convert a plain value to one of this module's types.

    Raises:
        ValueError: The value is of another type or outside the range.
        NotImplementedError: `kind` is none of this module's types.
    """
    if issubclass(kind, Quantity):
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{shown(value)} should be a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not kind.accepted.accepts(number):
            raise ValueError(f"{shown(value)} should be {kind.accepted}")
        return kind(number)
    if issubclass(kind, str):
        if not isinstance(value, str):
            raise ValueError(f"{shown(value)} should be a text")
        return _text(kind, value)
    raise NotImplementedError(kind)
