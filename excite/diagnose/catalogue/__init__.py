"""The effects that can be named, a file a family; adding one takes an `Effect` in a file's EFFECTS."""

from __future__ import annotations

from ..effect import Effect
from . import electrical, environment, friction, load, memory, ripple, sensing, thermal, transmission

EFFECTS: tuple[Effect, ...] = (
    *friction.EFFECTS,
    *memory.EFFECTS,
    *thermal.EFFECTS,
    *transmission.EFFECTS,
    *ripple.EFFECTS,
    *load.EFFECTS,
    *electrical.EFFECTS,
    *sensing.EFFECTS,
    *environment.EFFECTS,
)
BY_NAME = {effect.name: effect for effect in EFFECTS}


def confused(name: str, other: str) -> bool:
    """Whether either effect is taken for the other."""
    return name in BY_NAME[other].confused or other in BY_NAME[name].confused
