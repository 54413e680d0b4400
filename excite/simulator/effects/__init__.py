"""All hidden effects by name."""

from __future__ import annotations

from . import environment, friction, load, out_of_catalogue, sensing, transmission
from .effect_type import FORM_FAMILIES, EffectType

EFFECT_TYPES: dict[str, EffectType] = {
    effect_type.name: effect_type
    for module in (load, friction, transmission, sensing, environment, out_of_catalogue)
    for effect_type in module.EFFECT_TYPES
}
"""Every effect that a simulated robot can have."""
CATALOGUE_NAMES = tuple(
    name for name, effect_type in EFFECT_TYPES.items() if not effect_type.out_of_catalogue
)
"""Names of the effects in the contract's catalogue."""
OUT_OF_CATALOGUE_NAMES = tuple(
    name for name, effect_type in EFFECT_TYPES.items() if effect_type.out_of_catalogue
)
"""Names of the effects that the contract has no name for."""

__all__ = [
    "CATALOGUE_NAMES",
    "EFFECT_TYPES",
    "FORM_FAMILIES",
    "OUT_OF_CATALOGUE_NAMES",
    "EffectType",
]
