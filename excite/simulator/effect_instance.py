"""Effects with chosen parameters: from the command line, a random draw or a truth file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from ..errors import UnusableInput
from .effects import CATALOGUE_NAMES, EFFECT_TYPES, EffectType
from .effects.effect_type import EffectParameter, EffectSite
from .physical_effect import PhysicalEffect
from .simulated_robot import SimulatedRobot


@dataclass(frozen=True)
class EffectInstance:
    """An effect in a joint, with values for all its parameters.

    Attributes:
        name: Name of the effect type.
        joint: Joint that carries it; None: the whole robot.
        family: Family of its model form.
        values: Values of all parameters.
        source: Joint from which a coupling comes.
    """

    name: str
    joint: str | None
    family: str
    values: Mapping[str, float]
    source: str | None = None

    @property
    def effect_type(self) -> EffectType:
        """Type of the effect."""
        return EFFECT_TYPES[self.name]

    def physics(self, robot: SimulatedRobot) -> PhysicalEffect | None:
        """Build the physics on a robot; None for an effect of size 0 that is left out."""
        if any(not np.isfinite(value) for value in self.values.values()):
            return None
        return self.effect_type.forms[self.family](
            effect_site(robot, self.joint, self.source), self.values
        )

    def scaled(self, factor: float) -> EffectInstance:
        """Return the effect made `factor` times as large."""
        if factor == 0.0 and self.effect_type.omitted_at_zero:
            return replace(self, values=dict.fromkeys(self.values, np.inf))
        values = {
            key: self.effect_type.parameter(key).scaled(value, factor)
            for key, value in self.values.items()
        }
        return replace(self, values=values)

    def largest_scale(self, robot: SimulatedRobot) -> float:
        """Return the largest factor by which the effect may physically be scaled on a robot."""
        site = effect_site(robot, self.joint, self.source)
        return min(
            self.effect_type.parameter(key).largest_scale(value, site)
            for key, value in self.values.items()
        )

    def to_document(self) -> dict[str, Any]:
        """Return the effect as an entry of `excite.truth/1`.

        `parameters` are those of the contract, `details` the others.
        """
        stated, details = (
            {
                parameter.name: {"value": self.values[parameter.name], "unit": parameter.unit}
                for parameter in self.effect_type.parameters
                if parameter.in_contract == in_contract
            }
            for in_contract in (True, False)
        )
        document: dict[str, Any] = {
            "effect": self.name,
            "joint": self.joint,
            "outsider": self.effect_type.out_of_catalogue,
            "family": self.family,
        }
        coupled = {} if self.source is None else {"from": self.source}
        return {**document, **coupled, "parameters": stated, "details": details}


def effect_site(robot: SimulatedRobot, joint: str | None, source: str | None = None) -> EffectSite:
    """Return the site of an effect.

    Args:
        robot: The robot.
        joint: Joint that carries the effect; None: the whole robot.
        source: Joint from which a coupling comes; None: a neighbour.
    """
    j = robot.joints.index(joint) if joint else 0
    i = robot.joints.index(source) if source else (j - 1 if j else 1 % len(robot.joints))
    velocity_limit = np.array(
        [robot.tree.velocity_and_torque_limit(name)[0] for name in robot.joints]
    )
    link = robot.tree.child_link(joint or robot.joints[-1])
    return EffectSite(
        len(robot.joints),
        j,
        i,
        robot.torque_limit,
        velocity_limit,
        robot.actuators,
        joint or "",
        link,
    )


def with_effects(robot: SimulatedRobot, effects: tuple[EffectInstance, ...]) -> SimulatedRobot:
    """Return the robot with hidden effects instead of those that it has."""
    physics = (effect.physics(robot) for effect in effects)
    return replace(robot, effects=tuple(effect for effect in physics if effect is not None))


def sample_effect(
    effect_type: EffectType,
    robot: SimulatedRobot,
    joint: str | None,
    family: str,
    rng: np.random.Generator,
) -> EffectInstance:
    """Draw an effect whose parameters have usual sizes."""
    site = effect_site(robot, joint)
    values = {
        parameter.name: parameter.draw(
            float(site.torque_limit[site.j]), float(site.velocity_limit[site.j]), rng
        )
        for parameter in effect_type.parameters
    }
    source = robot.joints[site.source] if effect_type.name == "coupling" else None
    return EffectInstance(effect_type.name, joint, family, values, source)


def parse_effect(text: str, robot: SimulatedRobot) -> EffectInstance:
    """Parse NAME:JOINT[:k=v,…]; parameters that are not stated have their usual size.

    `form=scored` takes the scored model form, `from=JOINT` states the other joint of a coupling.

    Raises:
        UnusableInput: The text is malformed, or effect, joint, form or parameter do not exist.
    """
    name, _, remainder = text.partition(":")
    joint, _, pairs = remainder.partition(":")
    if name not in EFFECT_TYPES:
        near = get_close_matches(name, EFFECT_TYPES, 1)
        remedy = (
            f"did you mean {_signature(near[0])}?"
            if near
            else f"the effects are: {catalogue_listing()}"
        )
        raise UnusableInput(f"--effect {text}: no effect '{name}'; {remedy}")
    effect_type = EFFECT_TYPES[name]
    place = _parse_place(text, effect_type, joint, robot)
    stated = dict(_parse_pair(text, pair) for pair in pairs.split(",") if pair)
    forms = tuple(effect_type.forms)
    family, source = stated.pop("form", forms[0]), stated.pop("from", None)
    if family not in forms:
        raise UnusableInput(f"--effect {text}: no form '{family}'; its forms: {', '.join(forms)}")
    if source is not None and (name != "coupling" or source not in robot.joints or source == joint):
        raise UnusableInput(
            f"--effect {text}: from={source} must name another joint, and only for a coupling; "
            f"joints: {', '.join(robot.joints)}"
        )
    unknown = set(stated) - {parameter.name for parameter in effect_type.parameters}
    if unknown:
        raise UnusableInput(
            f"--effect {text}: {name} has no parameter '{min(unknown)}'; "
            f"it has: {_parameter_list(effect_type.parameters)}"
        )
    site = effect_site(robot, place, source)
    limits = float(site.torque_limit[site.j]), float(site.velocity_limit[site.j])
    values = {
        parameter.name: (
            _parse_number(text, parameter, stated[parameter.name])
            if parameter.name in stated
            else parameter.default_value(*limits)
        )
        for parameter in effect_type.parameters
    }
    if effect_type.omitted_at_zero and min(values.values()) == 0.0:
        raise UnusableInput(
            f"--effect {text}: its value must be above 0; to have no such effect, leave it out"
        )
    return EffectInstance(
        name, place, family, values, robot.joints[site.source] if name == "coupling" else None
    )


def effects_of_truth(truth: Mapping[str, Any]) -> tuple[EffectInstance, ...]:
    """Return the effects of a truth file; see `EffectInstance.to_document`.

    Raises:
        KeyError: There is no effect of that name.
        ValueError: The effect has no such form, parameter, value or joint.
    """
    out = []
    for entry in truth["effects"]:
        values = {
            key: float(parameter["value"])
            for key, parameter in {**entry["parameters"], **entry["details"]}.items()
        }
        effect_type = EFFECT_TYPES[entry["effect"]]
        names = {parameter.name for parameter in effect_type.parameters}
        if entry["family"] not in effect_type.forms or set(values) != names:
            raise ValueError(f"no {effect_type.name} of this form with these parameters")
        for parameter in effect_type.parameters:
            if not parameter.accepts(values[parameter.name]):
                raise ValueError(
                    f"{effect_type.name} with {parameter.name} {values[parameter.name]:g}"
                )
        joint, source = entry["joint"], entry.get("from")
        is_placed = {"joint": joint is not None, "robot": joint is None}.get(
            effect_type.place, True
        )
        if not is_placed or joint not in (None, *truth["joints"]):
            raise ValueError(f"{effect_type.name} in joint {joint}, which the robot does not have")
        if effect_type.name == "coupling" and (source == joint or source not in truth["joints"]):
            raise ValueError(
                f"{effect_type.name} from joint {source}, which is not another joint of the robot"
            )
        out.append(EffectInstance(effect_type.name, joint, entry["family"], values, source))
    return tuple(out)


def _parse_place(
    text: str, effect_type: EffectType, joint: str, robot: SimulatedRobot
) -> str | None:
    """Return the joint of an effect, or None for one of the whole robot."""
    if effect_type.place == "robot" or (effect_type.place == "either" and not joint):
        if joint:
            raise UnusableInput(
                f"--effect {text}: {effect_type.name} is of the whole robot; "
                f"write {effect_type.name}::… without a joint"
            )
        return None
    if joint not in robot.joints:
        raise UnusableInput(
            f"--effect {text}: no joint '{joint}'; "
            f"write NAME:JOINT[:k=v,…] with one of: {', '.join(robot.joints)}"
        )
    if effect_type.name == "coupling" and len(robot.joints) < 2:
        raise UnusableInput(
            f"--effect {text}: the robot has joint '{joint}' only; a coupling needs two joints"
        )
    return joint


def _parse_pair(text: str, pair: str) -> tuple[str, str]:
    """Split PARAMETER=VALUE."""
    key, separator, value = pair.partition("=")
    if not separator:
        raise UnusableInput(f"--effect {text}: '{pair}' must read PARAMETER=VALUE")
    return key, value


def _parse_number(text: str, parameter: EffectParameter, value: str) -> float:
    """Return the number of a stated parameter, of a sign that the parameter can have."""
    try:
        number = float(value)
    except ValueError as error:
        raise UnusableInput(f"--effect {text}: {parameter.name}={value} is no number") from error
    if not parameter.accepts(number):
        raise UnusableInput(
            f"--effect {text}: {parameter.name}={value} must be finite and "
            f"{'not below' if parameter.size_exponent > 0.0 else 'above'} 0 [{parameter.unit}]"
        )
    return number


def _parameter_list(parameters: tuple[EffectParameter, ...]) -> str:
    """Return parameters with their units, for messages."""
    return ", ".join(f"{parameter.name} [{parameter.unit}]" for parameter in parameters)


def catalogue_listing() -> str:
    """Return all effects with parameters and units, those of the catalogue first."""
    names = [*CATALOGUE_NAMES, *(name for name in EFFECT_TYPES if name not in CATALOGUE_NAMES)]
    return "; ".join(_signature(name) for name in names)


def _signature(name: str) -> str:
    """Return NAME(PARAMETER [UNIT], …)."""
    return f"{name}({_parameter_list(EFFECT_TYPES[name].parameters)})"
