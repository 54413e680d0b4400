"""Bounds of masses and centres of mass, a TOML file.

[links.NAME]
mass = [0.5, 2.0]                             # smallest, largest [kg]
centre = [[-0.1, -0.1, 0.0], [0.1, 0.1, 0.3]] # smallest, largest x, y, z [m]
"""

from __future__ import annotations

import msgspec

from .limits import require_ordered
from .quantities import Length, Mass, PositiveMass

NARROWEST_MASS = 1e-6
"""Narrowest interval of a mass [kg]: the interior-point estimator needs a strictly feasible
point."""
NARROWEST_CENTRE = 1e-6
"""Narrowest interval of a coordinate of a centre of mass [m]."""


class LinkBounds(msgspec.Struct, forbid_unknown_fields=True):
    """Bounds of a link, None where there are none.

    Attributes:
        mass: Smallest and largest mass [kg].
        centre: Smallest and largest coordinates of the centre of mass in the link's frame [m].
    """

    mass: tuple[Mass, PositiveMass] | None = None
    centre: tuple[tuple[Length, Length, Length], tuple[Length, Length, Length]] | None = None

    def __post_init__(self) -> None:
        if self.mass is not None:
            _check_interval("mass", self.mass, NARROWEST_MASS)
        if self.centre is not None:
            for axis, pair in zip("xyz", zip(*self.centre, strict=True), strict=True):
                _check_interval(f"centre, {axis}", pair, NARROWEST_CENTRE)


def _check_interval(key: str, pair: tuple[float, float], narrowest: float) -> None:
    """Raise ValueError for an interval that is empty or too narrow."""
    require_ordered(key, pair)
    if pair[1] - pair[0] < narrowest:
        raise ValueError(
            f"{key}: {pair[0]:g} and {pair[1]:g} are nearer than {narrowest:g}; widen the bounds"
        )


class BoundsFile(msgspec.Struct, forbid_unknown_fields=True):
    """The complete file."""

    links: dict[str, LinkBounds]
