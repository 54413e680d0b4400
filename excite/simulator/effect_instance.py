"""An effect chosen: its kind, joint, form and parameters, as a user writes it and as the key keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from ..errors import UnusableInput
from .effects import CATALOGUE_NAMES, EFFECT_TYPES, FORM_FAMILIES, EffectType
from .effects.effect_type import EffectParameter, EffectSite
from .physical_effect import PhysicalEffect
from .simulated_robot import SimulatedRobot


@dataclass(frozen=True)
class EffectInstance:
    """name: of the contract. joint: None for the whole robot. family: of forms. values: all parameters.

    source: the joint that a coupling comes from.
    """

    name: str
    joint: str | None
    family: str
    values: Mapping[str, float]
    source: str | None = None

    @property
    def kind(self) -> EffectType:
        return EFFECT_TYPES[self.name]

    def law(self, plant: SimulatedRobot) -> PhysicalEffect | None:
        """Its physics on a robot; None for what vanishes at size 0."""
        if any(not np.isfinite(v) for v in self.values.values()):
            return None
        return self.kind.forms[self.family](
            effect_site(plant, self.joint, self.source), self.values
        )

    def sized(self, size: float) -> EffectInstance:
        """The effect made `size` times as large; at 0 what has no finite parameters vanishes."""
        if size == 0.0 and self.kind.omitted_at_zero:
            return replace(self, values=dict.fromkeys(self.values, np.inf))
        values = {
            key: self.kind.quantity(key).sized(value, size) for key, value in self.values.items()
        }
        return replace(self, values=values)

    def most(self, plant: SimulatedRobot) -> float:
        """How many times as large physics lets it be made at the most, on a robot."""
        at = effect_site(plant, self.joint, self.source)
        return min(self.kind.quantity(key).room(value, at) for key, value in self.values.items())

    def to_document(self) -> dict[str, Any]:
        """As the truth states it; `details` are parameters that the contract doesn't name."""
        stated = {
            q.name: {"value": self.values[q.name], "unit": q.unit}
            for q in self.kind.parameters
            if q.stated
        }
        details = {
            q.name: {"value": self.values[q.name], "unit": q.unit}
            for q in self.kind.parameters
            if not q.stated
        }
        out = {
            "effect": self.name,
            "joint": self.joint,
            "outsider": self.kind.out_of_catalogue,
            "family": self.family,
        }
        more = {} if self.source is None else {"from": self.source}
        return {**out, **more, "parameters": stated, "details": details}


def effect_site(plant: SimulatedRobot, joint: str | None, source: str | None = None) -> EffectSite:
    """What an effect may know of its robot."""
    j = plant.joints.index(joint) if joint else 0
    i = plant.joints.index(source) if source else (j - 1 if j else 1 % len(plant.joints))
    speed = np.array([plant.tree.velocity_and_torque_limit(name)[0] for name in plant.joints])
    link = plant.tree.child_link(joint or plant.joints[-1])
    return EffectSite(len(plant.joints), j, i, plant.limit, speed, plant.drive, joint or "", link)


def with_effects(plant: SimulatedRobot, effects: tuple[EffectInstance, ...]) -> SimulatedRobot:
    """The robot with effects in it."""
    laws = (effect.law(plant) for effect in effects)
    return replace(plant, effects=tuple(law for law in laws if law is not None))


def draw_effect(
    kind: EffectType,
    plant: SimulatedRobot,
    joint: str | None,
    family: str,
    rng: np.random.Generator,
) -> EffectInstance:
    """An effect of random parameters, each of its usual size."""
    at = effect_site(plant, joint)
    values = {
        q.name: q.draw(float(at.torque[at.j]), float(at.speed[at.j]), rng) for q in kind.parameters
    }
    source = plant.joints[at.source] if kind.name == "coupling" else None
    return EffectInstance(kind.name, joint, family, values, source)


def parse_effect(text: str, plant: SimulatedRobot) -> EffectInstance:
    """NAME:JOINT[:k=v,…] with what is left out at its usual size; `form=scored` takes the other form, `from=JOINT` couples.

    Raises UnusableInput, with the effects or the parameters there are.
    """
    name, _, rest = text.partition(":")
    joint, _, pairs = rest.partition(":")
    if name not in EFFECT_TYPES:
        near = get_close_matches(name, EFFECT_TYPES, 1)
        remedy = (
            f"did you mean {_signature(near[0])}?" if near else f"there are: {catalogue_listing()}"
        )
        raise UnusableInput(f"--effect {text}: no effect '{name}'; {remedy}")
    kind = EFFECT_TYPES[name]
    place = _place(text, kind, joint, plant)
    stated = dict(_pair(text, pair) for pair in pairs.split(",") if pair)
    family, source = stated.pop("form", FORM_FAMILIES[0]), stated.pop("from", None)
    if family not in FORM_FAMILIES:
        raise UnusableInput(
            f"--effect {text}: no form '{family}'; there are: {', '.join(FORM_FAMILIES)}"
        )
    if source is not None and (name != "coupling" or source not in plant.joints or source == joint):
        raise UnusableInput(
            f"--effect {text}: from={source} should name another joint, for a coupling; joints: {', '.join(plant.joints)}"
        )
    unknown = set(stated) - {q.name for q in kind.parameters}
    if unknown:
        raise UnusableInput(
            f"--effect {text}: {name} has no parameter '{min(unknown)}'; it has: {_words(kind.quantities)}"
        )
    at = effect_site(plant, place, source)
    limits = float(at.torque[at.j]), float(at.speed[at.j])
    values = {
        q.name: _number(text, q, stated[q.name]) if q.name in stated else q.middle(*limits)
        for q in kind.parameters
    }
    if kind.omitted_at_zero and min(values.values()) == 0.0:
        raise UnusableInput(
            f"--effect {text}: should be above 0; leave the effect out to have none"
        )
    return EffectInstance(
        name, place, family, values, plant.joints[at.source] if name == "coupling" else None
    )


def effects_of_truth(truth: Mapping[str, Any]) -> tuple[EffectInstance, ...]:
    """The effects of a truth: see `Effect.document`.

    Raises:
        KeyError: There is no effect of that name.
        ValueError: The effect has no such form, parameter, value or joint.
    """
    out = []
    for one in truth["effects"]:
        values = {
            key: float(own["value"]) for key, own in {**one["parameters"], **one["details"]}.items()
        }
        kind = EFFECT_TYPES[one["effect"]]
        if one["family"] not in kind.forms or set(values) != {q.name for q in kind.parameters}:
            raise ValueError(f"no {kind.name} of this form with these parameters")
        for quantity in kind.parameters:
            if not quantity.accepts(values[quantity.name]):
                raise ValueError(f"{kind.name} with {quantity.name} {values[quantity.name]:g}")
        joint, source = one["joint"], one.get("from")
        placed = {"joint": joint is not None, "robot": joint is None}.get(kind.place, True)
        if not placed or joint not in (None, *truth["joints"]):
            raise ValueError(f"{kind.name} in joint {joint}, which is not among its joints")
        if kind.name == "coupling" and (source == joint or source not in truth["joints"]):
            raise ValueError(f"{kind.name} from joint {source}, which is not another of its joints")
        out.append(EffectInstance(kind.name, joint, one["family"], values, source))
    return tuple(out)


def _place(text: str, kind: EffectType, joint: str, plant: SimulatedRobot) -> str | None:
    if kind.place == "robot" or (kind.place == "either" and not joint):
        if joint:
            raise UnusableInput(
                f"--effect {text}: {kind.name} is of the whole robot; write {kind.name}::… without a joint"
            )
        return None
    if joint not in plant.joints:
        raise UnusableInput(
            f"--effect {text}: no joint '{joint}'; write NAME:JOINT[:k=v,…] with one of: {', '.join(plant.joints)}"
        )
    if kind.name == "coupling" and len(plant.joints) < 2:
        raise UnusableInput(
            f"--effect {text}: joint '{joint}' is alone; a coupling needs two joints"
        )
    return joint


def _pair(text: str, pair: str) -> tuple[str, str]:
    key, separator, value = pair.partition("=")
    if not separator:
        raise UnusableInput(f"--effect {text}: '{pair}' should read PARAMETER=VALUE")
    return key, value


def _number(text: str, quantity: EffectParameter, value: str) -> float:
    try:
        number = float(value)
    except ValueError as error:
        raise UnusableInput(f"--effect {text}: {quantity.name}={value} is no number") from error
    if not quantity.accepts(number):
        raise UnusableInput(
            f"--effect {text}: {quantity.name}={value} should be finite and "
            f"{'not below' if quantity.power > 0.0 else 'above'} 0 [{quantity.unit}]"
        )
    return number


def _words(quantities: tuple[EffectParameter, ...]) -> str:
    return ", ".join(f"{q.name} [{q.unit}]" for q in quantities)


def catalogue_listing() -> str:
    """Every effect with its parameters and units, outsiders last."""
    names = [*CATALOGUE_NAMES, *(name for name in EFFECT_TYPES if name not in CATALOGUE_NAMES)]
    return "; ".join(_signature(name) for name in names)


def _signature(name: str) -> str:
    return f"{name}({_words(EFFECT_TYPES[name].quantities)})"
