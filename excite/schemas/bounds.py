"""Bounds of masses and centres of mass, a TOML file.

`[links.NAME] mass = [least, most]`, `centre = [[x, y, z], [x, y, z]]`.
"""

from __future__ import annotations

import msgspec

from .limits import ordered
from .quantities import Length, Mass, PositiveMass

NARROWEST_MASS = 1e-6
"""Narrowest interval of a mass [kg]: the interior-point estimator needs room between the bounds."""
NARROWEST_CENTRE = 1e-6
"""Narrowest interval of a coordinate of a centre of mass [m]."""


class LinkBounds(msgspec.Struct, forbid_unknown_fields=True):
    """Bounds of one link; None where there are none.

    centre: the least and the largest coordinates.
    """

    mass: tuple[Mass, PositiveMass] | None = None
    centre: tuple[tuple[Length, Length, Length], tuple[Length, Length, Length]] | None = None

    def __post_init__(self) -> None:
        if self.mass is not None:
            _interval("mass", self.mass, NARROWEST_MASS)
        if self.centre is not None:
            for axis, pair in zip("xyz", zip(*self.centre, strict=True), strict=True):
                _interval(f"centre, {axis}", pair, NARROWEST_CENTRE)


def _interval(key: str, pair: tuple[float, float], narrowest: float) -> None:
    ordered(key, pair)
    if pair[1] - pair[0] < narrowest:
        raise ValueError(
            f"{key}: {pair[0]:g} and {pair[1]:g} are nearer than {narrowest:g}; widen the bounds"
        )


class BoundsFile(msgspec.Struct, forbid_unknown_fields=True):
    """The whole file."""

    links: dict[str, LinkBounds]
