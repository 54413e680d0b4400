"""Explanations of a torque from the names and parameters of a `diagnosis.json`.

A diagnosis states an effect by parameters in physical units, and its equivalents by name only. What
it does not state (a spatial phase, the form of an equivalent) is a usual value, or unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from .effect_columns import RobotConstants, SymbolicEffect, position_range

STRIBECK_SPEED = 0.05
"""Usual Stribeck speed over the velocity limit [1] (0.02-0.3 rad/s)."""
CONVEX_EXPONENT = 3.0
"""Exponent of viscous friction that grows faster than the speed [1]."""
CONCAVE_EXPONENT = 0.5
"""Exponent of viscous friction that grows more slowly [1]."""
PRESLIDING_REACH = 5e-3
"""Usual travel of presliding friction [rad or m] (0.1-10 mrad)."""
RIPPLE_ORDER = 8.0
"""Spatial frequency of a ripple of which none is stated [1/turn]."""
ENCODER_ORDER = 1.0
"""Spatial frequency of an encoder's error of which none is stated [1/turn]: an eccentric disc."""
TIME_CONSTANT = 600.0
"""Usual time constant of warming up [s]."""
RESONANCE = 15.0
"""Resonance of a link on its elastic joint, of which no stiffness is stated [Hz]."""
DAMPING_RATIO = 0.07
"""Usual damping ratio of an elastic joint [1], as in `effects.elasticity`."""
SATURATION_POWER = 3.0
"""Power of the torque that is lost [1]: a torque constant that falls with the square of current."""
FRICTION_SHARE = 0.05
"""Coulomb friction where the model has none, and viscous friction at full speed, over the torque
limit [1]."""
POSITION_WAVES = 2.0
"""Waves of friction over the position where it is only a rival [1]."""
SPRING_WAVES = 12.0
"""Half waves over the range of the joint of a spring whose curve may have any form, as in
`effects.spring`."""

Stated = Mapping[str, float]
"""Parameters as a diagnosis states them, by name."""


@dataclass(frozen=True)
class EffectSpecification:
    """An effect as a diagnosis names it.

    Attributes:
        effect: Name of the effect.
        joint: Index of its joint; None for an effect of no single joint.
        parameters: Stated parameters, empty for an equivalent.
        other: Index of a second joint.
    """

    effect: str
    joint: int | None
    parameters: Stated
    other: int | None = None


def friction_of(constants: RobotConstants, joint: int) -> tuple[float, float]:
    """Return Coulomb [N m] and viscous friction [N m s/rad] of a joint, or usual ones.

    Args:
        constants: The robot.
        joint: Index of the joint.
    """
    layout, limits = constants.parameters, constants.limits
    usual = FRICTION_SHARE * float(limits.torque[joint])
    stated = [
        float(constants.psi[layout.block(kind)][joint]) if kind in layout.drive else 0.0
        for kind in ("coulomb", "viscous")
    ]
    return (
        stated[0] if stated[0] > 0.0 else usual,
        stated[1] if stated[1] > 0.0 else usual / float(limits.velocity[joint]),
    )


Values = dict[str, float]


def _stribeck(c: RobotConstants, j: int, p: Stated) -> Values:
    usual = STRIBECK_SPEED * float(c.limits.velocity[j])
    return {"velocity": p.get("velocity", usual), "exponent": 1.0}


def _nonlinear_viscous(c: RobotConstants, j: int, p: Stated) -> Values:
    """The stated exponent; without one, a curve of both kinds."""
    if "exponent" in p:
        return {"exponent": p["exponent"]}
    return {"exponent": CONVEX_EXPONENT, "concave": CONCAVE_EXPONENT}


def _position_friction(c: RobotConstants, j: int, p: Stated) -> Values:
    low, high = position_range(c.limits, j)
    return {"order": 1.0, "waves": POSITION_WAVES, "low": low, "high": high}


def _spring(c: RobotConstants, j: int, p: Stated) -> Values:
    """A straight line, a wave of one turn, or a curve of any form where no stiffness is stated."""
    if "stiffness" in p:
        return {"form": 0.0 if set(p) == {"stiffness"} else 1.0}
    low, high = position_range(c.limits, j)
    return {"waves": SPRING_WAVES, "low": low, "high": high}


def _hysteresis(c: RobotConstants, j: int, p: Stated) -> Values:
    if p.get("stiffness", 0.0) > 0.0 and p.get("amplitude", 0.0) > 0.0:
        return {"reach": p["amplitude"] / p["stiffness"]}
    return {"reach": PRESLIDING_REACH}


def _thermal_drift(c: RobotConstants, j: int, p: Stated) -> Values:
    coulomb, viscous = friction_of(c, j)
    constant = p.get("time_constant", TIME_CONSTANT)
    return {"time_constant": constant, "coulomb": coulomb, "viscous": viscous}


def _elasticity(c: RobotConstants, j: int, p: Stated) -> Values:
    usual = float(c.mean_inertia[j]) * (2.0 * np.pi * RESONANCE) ** 2
    stiffness = p.get("stiffness", usual)
    return {"stiffness": stiffness, "damping": DAMPING_RATIO, "rests": 0.0}


_VALUES: dict[str, Callable[[RobotConstants, int, Stated], Values]] = {
    "stribeck": _stribeck,
    "nonlinear_viscous": _nonlinear_viscous,
    "load_friction": lambda c, j, p: {"power": 1.0, "scale": float(c.limits.torque[j])},
    "position_friction": _position_friction,
    "spring": _spring,
    "hysteresis": _hysteresis,
    "thermal_drift": _thermal_drift,
    "elasticity": _elasticity,
    "torque_ripple": lambda c, j, p: {"order": p.get("order", RIPPLE_ORDER)},
    "encoder_error": lambda c, j, p: {"order": p.get("order", ENCODER_ORDER)},
    "torque_saturation": lambda c, j, p: {
        "power": SATURATION_POWER,
        "largest": float(c.limits.torque[j]),
    },
    "coupling": lambda c, j, p: {"ratio": 1.0},
    "payload": lambda c, j, p: {"link": float(j), "count": 4.0},
}


def symbolic_effect(
    specification: EffectSpecification, constants: RobotConstants
) -> SymbolicEffect:
    """Return the form of an effect, with stated nonlinear parameters or usual ones.

    Args:
        specification: The effect with its parameters; a joint is needed by all but delay and
            gravity tilt.
        constants: The robot.
    """
    effect, joint = specification.effect, specification.joint
    other = specification.other
    if effect == "coupling" and joint is not None and other is None:
        other = joint + 1 if joint + 1 < constants.robot.n else joint - 1
    values = (
        _VALUES[effect](constants, joint, specification.parameters)
        if effect in _VALUES and joint is not None
        else {}
    )
    return SymbolicEffect(effect, joint, values, other if effect == "coupling" else None)


def _phase_unknown(amplitude: float, count: int = 2) -> FloatArray:
    """Return L of a wave of known amplitude and unknown phase, zero for further columns."""
    out = np.zeros((count, 2))
    out[:2] = amplitude / np.sqrt(2.0) * np.eye(2)
    return out


def stated_factor(specification: EffectSpecification, form: SymbolicEffect) -> FloatArray | None:
    """Return L with E[c cᵀ] = L Lᵀ from stated parameters; None where they do not suffice.

    Args:
        specification: The effect with its parameters.
        form: Its form.

    Returns:
        Shape (k, r).
    """
    p, effect = specification.parameters, specification.effect
    try:
        out = _stated_factor(effect, p, form)
    except KeyError:
        return None
    return out if np.isfinite(out).all() and np.abs(out).max(initial=0.0) > 0.0 else None


def _stated_factor(effect: str, p: Stated, form: SymbolicEffect) -> FloatArray:
    """Return L; raise KeyError for a parameter that is not stated."""
    if effect in ("position_friction", "torque_ripple", "encoder_error"):
        count = 2 * int(form.values.get("waves", 1.0))
        return _phase_unknown(p["amplitude"], count)
    if effect == "spring":
        if form.values.get("form") == 0.0:
            return np.array([[p["stiffness"]]])
        if "waves" in form.values:  # prior sizes 1/m, as in `effects.spring`
            sizes = 1.0 / np.arange(1.0, form.values["waves"] + 1.0)
            return np.diag(p["amplitude"] / np.linalg.norm(sizes) * sizes)
        return _phase_unknown(p["amplitude"])
    single: dict[str, Callable[[], list[float]]] = {
        "rotor_inertia": lambda: [p["inertia"]],
        "torque_offset": lambda: [p["offset"]],
        "friction": lambda: [p["coulomb"], p["viscous"]],
        "asymmetric_viscous": lambda: [0.5 * (p["positive"] - p["negative"])],
        "stribeck": lambda: [p["amplitude"]],
        "nonlinear_viscous": lambda: [p["coefficient"]],
        "drag": lambda: [p["coefficient"]],
        "load_friction": lambda: [p["mu"]],
        "hysteresis": lambda: [p["amplitude"]],
        "thermal_drift": lambda: [p["change"]],
        "elasticity": lambda: [1.0] if p["stiffness"] > 0.0 else [0.0],
        "coupling": lambda: [p.get(k, 0.0) for k in ("viscous", "coulomb", "inertia")],
        "torque_gain": lambda: [1.0 / p["gain"] - 1.0] if p["gain"] else [np.inf],
        "torque_saturation": lambda: [p["loss"] / (1.0 - p["loss"])] if p["loss"] < 1 else [np.inf],
        "delay": lambda: [p["seconds"]],
        "gravity_tilt": lambda: [p["roll"], p["pitch"]],
        "payload": lambda: [
            p["mass"],
            *(p["mass"] * p.get(f"com_{axis}", 0.0) for axis in "xyz"),
        ],
    }
    return np.array(single[effect](), float)[:, None]
