"""Python module with the friction of an identified robot: `friction_runtime.py` and its table.

The generated file is the source of `friction_runtime`, followed by the robot's terms, so that what
is tested here is what runs there.
"""

from __future__ import annotations

import inspect
import pprint
from typing import Any

from .._system.comments import line_comment
from ..effects import friction_runtime
from ..schemas.effects import EffectDocument
from . import isaaclab_file, mjcf_file
from .simulator_model import Held, SimulatorModel

HOLDS: frozenset[Held] = frozenset(Held)
"""All quantities of simulators: the module computes them, or the exported robot holds them."""
SIMULATORS = {"mjcf": mjcf_file.HOLDS, "isaaclab": isaaclab_file.HOLDS}
"""Simulators whose files hold a part of the terms."""
NOT_FRICTION = {
    Held.INERTIA: "it is in the inertias of the exported robot",
    Held.ROTOR_INERTIA: "it is in the armature of the exported robot",
    Held.ACTUATOR_DELAY: "it is in the actuators of the exported MJCF",
}
"""Why an effect that simulators hold is no term of the module."""


def friction_table(model: SimulatorModel) -> dict[str, Any]:
    """Return the table that `friction_runtime.Friction` takes.

    Args:
        model: The identified robot.
    """
    robot, base = model.model.robot, model.model
    drive = {
        kind: base.psi[base.layout.block(kind)].tolist() if kind in base.drive else [0.0] * robot.n
        for kind in ("viscous", "coulomb", "offset")
    }
    terms: list[dict[str, Any]] = []
    for j in range(robot.n):
        friction = [drive["coulomb"][j], drive["viscous"][j]]
        terms.append(_base_term("base", j, friction, Held.COULOMB))
        if drive["offset"][j]:
            terms.append(_base_term("base_offset", j, [drive["offset"][j]], Held.OFFSET))
    terms += [
        _term(model, effect, held)
        for effect, held in zip(base.effects, model.held, strict=True)
        if is_term(effect)
    ]
    return {
        "joints": list(robot.joints),
        "widths": model.torques.widths.tolist(),
        "terms": terms,
    }


def is_term(effect: EffectDocument) -> bool:
    """Return whether `friction_runtime` computes an effect."""
    return effect.effect in friction_runtime.KNOWN and effect.joint is not None


def _base_term(name: str, joint: int, coefficients: list[float], held: Held) -> dict[str, Any]:
    """Entry of the table of a part of the base model."""
    return {
        "effect": name,
        "joint": joint,
        "other": -1,
        "values": {},
        "coefficients": coefficients,
        "held_by": _holders(held),
    }


def _holders(held: Held | None) -> list[str]:
    """Simulators whose files hold a quantity."""
    return [name for name, holds in SIMULATORS.items() if held in holds]


def _term(model: SimulatorModel, effect: EffectDocument, held: Held | None) -> dict[str, Any]:
    """Entry of the table of an effect."""
    joints = model.joints
    return {
        "effect": effect.effect,
        "joint": joints.index(str(effect.joint)),
        "other": -1 if effect.other is None else joints.index(effect.other),
        "values": {key: float(value) for key, value in effect.values.items()},
        "coefficients": [float(c) for c in effect.coefficients],
        "held_by": _holders(held),
    }


def _left_out(model: SimulatorModel) -> list[str]:
    """Lines on the effects that the exported robot holds and this module does not."""
    lines = []
    for effect, held in zip(model.model.effects, model.held, strict=True):
        if not is_term(effect) and held in NOT_FRICTION:
            place = effect.joint or "all joints"
            lines.append(f"{effect.effect} at {place} is no friction: {NOT_FRICTION[held]}")
    return lines


def python_text(model: SimulatorModel) -> str:
    """Return the Python module of an identified robot's friction.

    Args:
        model: The identified robot.
    """
    source = inspect.getsource(friction_runtime)
    header = [*model.header("python-friction", HOLDS, is_term), *_left_out(model)]
    table = pprint.pformat(friction_table(model), width=96, sort_dicts=False)
    return (
        f"{line_comment(header)}\n{source}\n\nTABLE = {table}\n"
        '"""Terms of this robot."""\n\nFRICTION = Friction(TABLE)\n'
        '"""Friction of this robot, with its own state; make another one for another robot."""\n'
    )
