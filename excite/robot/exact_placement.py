"""Placements of joints with rounded right angles made exact, for the structure of a robot.

Which inertial parameters are visible depends on exact geometry: whether two axes are parallel, or
whether gravity is along an axis. A URDF that states 1.5708 for π/2 tilts axes by 4 µrad. That makes
directions of the parameters visible in exact arithmetic that no measurement shows. The structure
(which columns of the regressor are independent) is therefore computed with exact placements; the
dynamics keep the numbers of the file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal

ANGLE_TOLERANCE = 1e-4
"""Distance from a multiple of π/4 within which an angle is meant to be that multiple [rad]. Four
decimals, the coarsest rounding found in the URDFs of the wheel example-robot-data, round by up to
5e-5 rad; a tilt of 1e-4 rad changes a joint's torque by 1e-4 of the torque of gravity at most, a
hundredth of a good torque sensor's noise. Angles that are printed with fewer digits are rounded by
up to half a unit of the last one, see `angle_tolerance`."""
MIN_DECIMALS = 2
"""Decimals from which an angle may be a rounded multiple of π/4; 0.8 and 1.6 are just numbers."""
LENGTH_TOLERANCE = 1e-6
"""Length below which an offset is meant to be zero [m]: a thousandth of the tolerance to which
robots are machined, and above the residue of unit conversions and CAD exports (1e-9 to 1e-7 m)."""
PRINTING_ERROR = 1e-9
"""Change of an angle [rad] or a length [m] that is no rounding worth a remark: numbers printed with
ten or more digits. Placements that differ by no more are kept as they are."""
EIGHTH_TURN = 0.25 * math.pi
"""Step of the angles that are considered exact [rad]."""


def angle_tolerance(number: str) -> float:
    """Distance from a multiple of π/4 within which a printed angle is meant to be it [rad]."""
    exponent = int(Decimal(number).as_tuple().exponent)
    return max(0.5 * 10.0**exponent if exponent <= -MIN_DECIMALS else 0.0, ANGLE_TOLERANCE)


def exact_angle(angle: float, tolerance: float = ANGLE_TOLERANCE) -> float:
    """The multiple of π/4 within a tolerance [rad] of an angle [rad], else the angle."""
    multiple = round(angle / EIGHTH_TURN) * EIGHTH_TURN
    return multiple if abs(angle - multiple) <= tolerance else angle


def exact_lengths(xyz: Sequence[float]) -> list[float]:
    """Lengths [m] with those below LENGTH_TOLERANCE set to zero."""
    return [0.0 if abs(value) <= LENGTH_TOLERANCE else value for value in xyz]


def exact_angles(
    rpy: Sequence[float], tolerances: Sequence[float] = (ANGLE_TOLERANCE,) * 3
) -> list[float]:
    """Roll, pitch and yaw [rad], each exact; where the pitch is a right angle, their sum too.

    At a pitch of ±π/2 the rotation depends on yaw ∓ roll only, which is then what has to be exact.

    Args:
        rpy: The angles.
        tolerances: What `angle_tolerance` returns of each.
    """
    roll, pitch, yaw = (exact_angle(*each) for each in zip(rpy, tolerances, strict=True))
    if abs(abs(math.remainder(pitch, 2.0 * math.pi)) - 0.5 * math.pi) < PRINTING_ERROR:
        sign = math.copysign(1.0, math.sin(pitch))
        combined = exact_angle(rpy[2] - sign * rpy[0])
        if combined != rpy[2] - sign * rpy[0]:
            return [0.0, pitch, combined]
    return [roll, pitch, yaw]


def exact_direction(axis: Sequence[float]) -> list[float]:
    """A unit vector with components that belong to a multiple of π/4 exact."""
    known = (0.0, math.sqrt(0.5), 1.0)
    exact = [
        next(
            (
                math.copysign(size, value)
                for size in known
                if abs(abs(value) - size) <= ANGLE_TOLERANCE
            ),
            value,
        )
        for value in axis
    ]
    length = math.hypot(*exact)
    return [value / length for value in exact]


def is_rounded(stated: Sequence[float], exact: Sequence[float]) -> bool:
    """Compare exact numbers with the stated ones: true where one differs by more than printing."""
    return any(abs(a - b) > PRINTING_ERROR for a, b in zip(stated, exact, strict=True))
