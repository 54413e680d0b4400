"""Uncertain forms of effects: columns that a diagnosis may fit beyond those of the model.

A diagnosis optimises the nonlinear parameters s of an effect, and lets its torque differ from the
form of its model (`effects.form_error`). The torque of an effect with coefficients c is therefore

    C(s) c + Σ_k δ_k ½ [C(s e^{+σ_k}) − C(s e^{−σ_k})] c + Σ_m a_m η φ_m C(s) c,   δ, a ~ N(0, 1)

with the prior standard deviation σ_k of ln s_k. The difference between two points, at plus and
minus one standard deviation, is the statistical linearisation of a curve over its parameter (Julier
and Uhlmann, AeroSense 1997); for small σ it is σ ∂C/∂ln s. φ_m are smooth factors of position and
speed, η their standard deviation. A rival that may bend its curve explains more of the torque of
the true effect, so that less evidence is expected.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import casadi as ca
import numpy as np

from ..schemas.effects import FORM_ERROR_STD, FORM_POSITION_WAVES, FORM_SPEED_WAVES

SHAPE_STD: Mapping[str, Mapping[str, float]] = {
    "elasticity": {"stiffness": 0.35, "damping": 0.7},
    "stribeck": {"velocity": 0.7, "exponent": 0.35},
    "hysteresis": {"reach": 0.7},
    "nonlinear_viscous": {"exponent": 0.35},
    "torque_saturation": {"power": 0.35},
    "position_friction": {"order": 0.35},
    "thermal_drift": {"time_constant": 0.7},
    "load_friction": {"power": 0.35},
}
"""Prior standard deviation of the logarithm of each nonlinear parameter [1]: a factor of √2 (0.35)
where usual values span a factor of 2 to 4, of 2 (0.7) where they span a decade. The spatial
frequencies of ripple and encoder errors, the ratio of a coupling and the bends of springs are
precise."""
EXACT_FORMS = frozenset(
    ("payload", "gravity_tilt", "rotor_inertia", "torque_offset", "friction", "torque_gain")
)
"""Effects that have exactly the form of their columns: those that a refit of the base model absorbs
(`prior_only` in the catalogue)."""


def shape_points(
    effect: str, values: Mapping[str, float]
) -> Iterator[tuple[dict[str, float], dict[str, float]]]:
    """Yield nonlinear parameters with one of them one standard deviation above and below.

    Args:
        effect: Name of the effect.
        values: Its nonlinear parameters.
    """
    for key, std in SHAPE_STD.get(effect, {}).items():
        if key in values:
            above, below = (values[key] * float(np.exp(sign * std)) for sign in (1.0, -1.0))
            yield {**values, key: above}, {**values, key: below}


def discrepancy_factors(
    q: ca.SX, speed: ca.SX, span: tuple[float, float], top_speed: float
) -> list[ca.SX]:
    """Return the factors η φ_m of position and speed.

    Args:
        q: Position of the joint.
        speed: Magnitude of its velocity.
        span: Range of the position.
        top_speed: Largest speed.
    """
    low, high = span
    place, rate = (q - low) / (high - low), speed / top_speed
    return [
        FORM_ERROR_STD * ca.cos(np.pi * m * x)
        for x, count in ((place, FORM_POSITION_WAVES), (rate, FORM_SPEED_WAVES))
        for m in range(1, count + 1)
    ]
