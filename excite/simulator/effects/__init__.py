"""The hidden effects by name."""

from __future__ import annotations

from . import environment, friction, load, out_of_catalogue, sensing, transmission
from .effect_type import FORM_FAMILIES, EffectType

EFFECT_TYPES: dict[str, EffectType] = {
    kind.name: kind
    for module in (load, friction, transmission, sensing, environment, out_of_catalogue)
    for kind in module.EFFECT_TYPES
}
"""Every kind there is; those with `outsider` are not of the contract's list."""
CATALOGUE_NAMES = tuple(name for name, kind in EFFECT_TYPES.items() if not kind.out_of_catalogue)
OUT_OF_CATALOGUE_NAMES = tuple(name for name, kind in EFFECT_TYPES.items() if kind.out_of_catalogue)

__all__ = ["CATALOGUE", "FAMILIES", "KINDS", "OUTSIDERS", "Kind"]
