"""The effects that can be named, a file a family; adding one takes an `Effect` in a file's EFFECTS."""

from __future__ import annotations

from . import (
    electrical,
    environment,
    friction,
    hysteresis,
    load,
    ripple,
    sensing,
    thermal,
    transmission,
)
from .effect import Effect

EFFECTS: tuple[Effect, ...] = (
    *friction.EFFECTS,
    *hysteresis.EFFECTS,
    *thermal.EFFECTS,
    *transmission.EFFECTS,
    *ripple.EFFECTS,
    *load.EFFECTS,
    *electrical.EFFECTS,
    *sensing.EFFECTS,
    *environment.EFFECTS,
)
EFFECTS_BY_NAME = {effect.name: effect for effect in EFFECTS}


def are_confusable(name: str, other: str) -> bool:
    """Whether either effect is taken for the other."""
    return name in EFFECTS_BY_NAME[other].confused or other in EFFECTS_BY_NAME[name].confused
