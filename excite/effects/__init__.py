"""Catalogue of effects that the rigid base model leaves out, one module for each effect.

To add an effect, write a module that defines an `Effect` and list it in `EFFECTS`.
"""

from __future__ import annotations

from .asymmetric_viscous import ASYMMETRIC_VISCOUS
from .backlash import BACKLASH
from .base_compliance import BASE_COMPLIANCE
from .contact import CONTACT
from .coupling import COUPLING
from .delay import DELAY
from .drag import DRAG
from .effect import Effect
from .elasticity import ELASTICITY
from .encoder_error import ENCODER_ERROR
from .friction import FRICTION
from .gravity_tilt import GRAVITY_TILT
from .hysteresis import HYSTERESIS
from .kinematic_error import KINEMATIC_ERROR
from .load_friction import LOAD_FRICTION
from .nonlinear_viscous import NONLINEAR_VISCOUS
from .payload import PAYLOAD
from .position_friction import POSITION_FRICTION
from .rotor_inertia import ROTOR_INERTIA
from .spring import SPRING
from .stribeck import STRIBECK
from .thermal_drift import THERMAL_DRIFT
from .torque_gain import TORQUE_GAIN
from .torque_offset import TORQUE_OFFSET
from .torque_ripple import TORQUE_RIPPLE
from .torque_saturation import TORQUE_SATURATION

EFFECTS: tuple[Effect, ...] = (
    ASYMMETRIC_VISCOUS,
    STRIBECK,
    NONLINEAR_VISCOUS,
    DRAG,
    LOAD_FRICTION,
    POSITION_FRICTION,
    FRICTION,
    HYSTERESIS,
    THERMAL_DRIFT,
    ELASTICITY,
    BACKLASH,
    SPRING,
    COUPLING,
    TORQUE_RIPPLE,
    PAYLOAD,
    GRAVITY_TILT,
    ROTOR_INERTIA,
    KINEMATIC_ERROR,
    TORQUE_OFFSET,
    TORQUE_GAIN,
    TORQUE_SATURATION,
    DELAY,
    ENCODER_ERROR,
    BASE_COMPLIANCE,
    CONTACT,
)
"""All effects. The order decides between candidates of equal evidence, and a model applies effects
of measured torque in this order: an actuator's loss before a clock's delay."""
EFFECTS_BY_NAME = {effect.name: effect for effect in EFFECTS}
"""The effects by their names in `diagnosis.json`."""
