"""An effect chosen: its kind, joint, form and parameters, as a user writes it and as the key keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from ..errors import UnusableInput
from .effects import CATALOGUE, FAMILIES, KINDS, Kind
from .effects.effect_type import Quantity, Site
from .physical_effect import Law
from .simulated_robot import Plant

Array = np.ndarray


@dataclass(frozen=True)
class Effect:
    """name: of the contract. joint: None for the whole robot. family: of forms. values: all parameters.

    source: the joint that a coupling comes from.
    """

    name: str
    joint: str | None
    family: str
    values: Mapping[str, float]
    source: str | None = None

    @property
    def kind(self) -> Kind:
        return KINDS[self.name]

    def law(self, plant: Plant) -> Law | None:
        """Its physics on a robot; None for what vanishes at size 0."""
        if any(not np.isfinite(v) for v in self.values.values()):
            return None
        return self.kind.forms[self.family](site(plant, self.joint, self.source), self.values)

    def sized(self, size: float) -> Effect:
        """The effect made `size` times as large; at 0 what has no finite parameters vanishes."""
        if size == 0.0 and self.kind.vanishes:
            return replace(self, values=dict.fromkeys(self.values, np.inf))
        values = {
            key: self.kind.quantity(key).sized(value, size) for key, value in self.values.items()
        }
        return replace(self, values=values)

    def most(self, plant: Plant) -> float:
        """How many times as large physics lets it be made at the most, on a robot."""
        at = site(plant, self.joint, self.source)
        return min(self.kind.quantity(key).room(value, at) for key, value in self.values.items())

    def document(self) -> dict[str, Any]:
        """As the truth states it; `details` are parameters that the contract doesn't name."""
        stated = {
            q.name: {"value": self.values[q.name], "unit": q.unit}
            for q in self.kind.quantities
            if q.stated
        }
        details = {
            q.name: {"value": self.values[q.name], "unit": q.unit}
            for q in self.kind.quantities
            if not q.stated
        }
        out = {
            "effect": self.name,
            "joint": self.joint,
            "outsider": self.kind.outsider,
            "family": self.family,
        }
        more = {} if self.source is None else {"from": self.source}
        return {**out, **more, "parameters": stated, "details": details}


def site(plant: Plant, joint: str | None, source: str | None = None) -> Site:
    """What an effect may know of its robot."""
    j = plant.joints.index(joint) if joint else 0
    i = plant.joints.index(source) if source else (j - 1 if j else 1 % len(plant.joints))
    speed = np.array([plant.tree.limits(name)[0] for name in plant.joints])
    link = plant.tree.child(joint or plant.joints[-1])
    return Site(len(plant.joints), j, i, plant.limit, speed, plant.drive, joint or "", link)


def hide(plant: Plant, effects: tuple[Effect, ...]) -> Plant:
    """The robot with effects in it."""
    laws = (effect.law(plant) for effect in effects)
    return replace(plant, laws=tuple(law for law in laws if law is not None))


def draw(
    kind: Kind, plant: Plant, joint: str | None, family: str, rng: np.random.Generator
) -> Effect:
    """An effect of random parameters, each of its usual size."""
    at = site(plant, joint)
    values = {
        q.name: q.draw(float(at.torque[at.j]), float(at.speed[at.j]), rng) for q in kind.quantities
    }
    source = plant.joints[at.source] if kind.name == "coupling" else None
    return Effect(kind.name, joint, family, values, source)


def parse(text: str, plant: Plant) -> Effect:
    """NAME:JOINT[:k=v,…] with what is left out at its usual size; `form=scored` takes the other form, `from=JOINT` couples.

    Raises UnusableInput, with the effects or the parameters there are.
    """
    name, _, rest = text.partition(":")
    joint, _, pairs = rest.partition(":")
    if name not in KINDS:
        near = get_close_matches(name, KINDS, 1)
        remedy = f"did you mean {_signature(near[0])}?" if near else f"there are: {listing()}"
        raise UnusableInput(f"--effect {text}: no effect '{name}'; {remedy}")
    kind = KINDS[name]
    place = _place(text, kind, joint, plant)
    stated = dict(_pair(text, pair) for pair in pairs.split(",") if pair)
    family, source = stated.pop("form", FAMILIES[0]), stated.pop("from", None)
    if family not in FAMILIES:
        raise UnusableInput(
            f"--effect {text}: no form '{family}'; there are: {', '.join(FAMILIES)}"
        )
    if source is not None and (name != "coupling" or source not in plant.joints or source == joint):
        raise UnusableInput(
            f"--effect {text}: from={source} should name another joint, for a coupling; joints: {', '.join(plant.joints)}"
        )
    unknown = set(stated) - {q.name for q in kind.quantities}
    if unknown:
        raise UnusableInput(
            f"--effect {text}: {name} has no parameter '{min(unknown)}'; it has: {_words(kind.quantities)}"
        )
    at = site(plant, place, source)
    limits = float(at.torque[at.j]), float(at.speed[at.j])
    values = {
        q.name: _number(text, q, stated[q.name]) if q.name in stated else q.middle(*limits)
        for q in kind.quantities
    }
    if kind.vanishes and min(values.values()) == 0.0:
        raise UnusableInput(
            f"--effect {text}: should be above 0; leave the effect out to have none"
        )
    return Effect(
        name, place, family, values, plant.joints[at.source] if name == "coupling" else None
    )


def stated(truth: Mapping[str, Any]) -> tuple[Effect, ...]:
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
        kind = KINDS[one["effect"]]
        if one["family"] not in kind.forms or set(values) != {q.name for q in kind.quantities}:
            raise ValueError(f"no {kind.name} of this form with these parameters")
        for quantity in kind.quantities:
            if not quantity.accepts(values[quantity.name]):
                raise ValueError(f"{kind.name} with {quantity.name} {values[quantity.name]:g}")
        joint, source = one["joint"], one.get("from")
        placed = {"joint": joint is not None, "robot": joint is None}.get(kind.place, True)
        if not placed or joint not in (None, *truth["joints"]):
            raise ValueError(f"{kind.name} in joint {joint}, which is not among its joints")
        if kind.name == "coupling" and (source == joint or source not in truth["joints"]):
            raise ValueError(f"{kind.name} from joint {source}, which is not another of its joints")
        out.append(Effect(kind.name, joint, one["family"], values, source))
    return tuple(out)


def _place(text: str, kind: Kind, joint: str, plant: Plant) -> str | None:
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


def _number(text: str, quantity: Quantity, value: str) -> float:
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


def _words(quantities: tuple[Quantity, ...]) -> str:
    return ", ".join(f"{q.name} [{q.unit}]" for q in quantities)


def listing() -> str:
    """Every effect with its parameters and units, outsiders last."""
    names = [*CATALOGUE, *(name for name in KINDS if name not in CATALOGUE)]
    return "; ".join(_signature(name) for name in names)


def _signature(name: str) -> str:
    return f"{name}({_words(KINDS[name].quantities)})"
