"""Inertia of one link: its principal moments, and whether a rigid body can have them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray

TRIANGLE_TOLERANCE = 0.01
"""Excess of the largest principal moment over the sum of the others, relative to itself, and
negative moment, that count as rounding [1]: tensors printed with two or three digits break the
inequality by up to 0.5 %."""
POINT_GYRATION = 1e-6
"""Radius of gyration below which a body is a point mass [m]; tensors that were meant to be zero
hold rounding errors of 1e-20 kg m²."""
LARGEST_LENGTH = 10.0
"""Distance of a centre of mass and radius of gyration that no link of a robot has [m], unless the
robot is itself that large."""
REACH_MULTIPLE = 10.0
"""The same, relative to the sum of the robot's joint offsets [1]."""


@dataclass(frozen=True)
class LinkInertia:
    """Mass, centre of mass and inertia of a link as its file states them.

    Attributes:
        mass: Mass [kg].
        centre: Centre of mass in the link's frame. [m]
        tensor: Moments about the centre of mass, xx, xy, yy, xz, yz, zz, in the axes of the
            <inertial> element [kg m²].
        rpy: Roll, pitch and yaw of these axes in the link's frame [rad].
    """

    mass: float
    centre: tuple[float, float, float]
    tensor: tuple[float, float, float, float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def is_empty(self) -> bool:
        """True for a link that has neither mass nor inertia."""
        return self.mass == 0.0 and not any(self.tensor)

    @property
    def is_placeholder(self) -> bool:
        """True for the identity matrix that templates put where the inertia is not known."""
        return self.tensor == (1.0, 0.0, 1.0, 0.0, 0.0, 1.0)

    def moments(self) -> FloatArray:
        """Principal moments in ascending order. Shape (3,) [kg m²]."""
        xx, xy, yy, xz, yz, zz = self.tensor
        return np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))

    def scale_fault(self, reach: float) -> str:
        """Say what makes mass and size impossible for a link of a robot, "" where nothing does.

        Args:
            reach: Sum of the lengths of the robot's joint offsets [m].
        """
        if self.mass <= 0.0:
            return ""
        largest = max(LARGEST_LENGTH, REACH_MULTIPLE * reach)
        distance = float(np.linalg.norm(self.centre))
        if distance > largest:
            return (
                f"its centre of mass is {distance:.3g} m from its joint; lengths are in m "
                "(millimetres?)"
            )
        moments = self.moments()
        gyration = float(np.sqrt(np.abs(moments).max() / self.mass))
        if gyration > largest:
            return (
                f"its inertia of {moments[-1]:.3g} kg m² with {self.mass:g} kg is that of a body "
                f"with its mass {gyration:.3g} m from its centre; inertias are in kg m² (1 g mm² "
                "is 1e-9 kg m²)"
            )
        return ""

    def moments_fault(self) -> str:
        """Say why no rigid body has these moments, "" where one can have them."""
        moments = self.moments()
        if np.abs(moments).max() <= max(self.mass, 0.0) * POINT_GYRATION**2:
            return ""
        return impossible_moments(moments)


def impossible_moments(moments: FloatArray) -> str:
    """Say why no rigid body has such principal moments, "" where one can have them.

    Args:
        moments: Principal moments about the centre of mass in ascending order. Shape (3,) [kg m²].
    """
    first, second, third = (float(moment) for moment in moments)
    shown = f"{first:.3g}, {second:.3g}, {third:.3g} kg m²"
    if first < -TRIANGLE_TOLERANCE * abs(third):
        return (
            f"its principal moments of inertia are {shown}, one of them negative; check the order "
            "and the signs of ixx … izz"
        )
    if third - first - second > TRIANGLE_TOLERANCE * third:
        return (
            f"its principal moments of inertia are {shown}; the largest exceeds the sum of the "
            "others, which no rigid body has"
        )
    return ""
