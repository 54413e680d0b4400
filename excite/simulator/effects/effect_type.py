"""Types of hidden effects: their parameters with units and usual sizes, and their model forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ..._types import FloatArray
from ..actuator import REFERENCE_ACCELERATION, JointActuators
from ..physical_effect import JointStates, PhysicalEffect

FORM_FAMILIES = ("tuning", "scored")
"""Two families of model forms for each effect of the catalogue; others have one of them.

Diagnosis may be tuned on the first only, so that cases of the second show how well it generalises
to forms that it has not seen.
"""
SIGN_WIDTH = 4e-3
"""Speed over which `smooth_sign` changes sign [rad/s]: the middle of the actuators' own range."""


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect, with its usual size and its physical bounds.

    Attributes:
        name: Name of the parameter.
        unit: Its unit.
        low: Lower end of the usual range, in multiples of `relative_to` at the joint.
        high: Upper end of the same.
        relative_to: "1", "torque" (torque limit), "speed" (velocity limit), "viscous" (torque limit
            over velocity limit), "square" (torque limit over its square) or "inertia".
        size_exponent: How the parameter grows with the size of the effect: 1 for an amplitude, −1
            for a stiffness, 0 for a parameter of shape only.
        neutral_value: Value at which the effect vanishes.
        in_contract: Whether the contract names the parameter.
        largest: Largest physically possible magnitude. (Friction that decreases with temperature
            never becomes negative, a saturating motor never brakes.)
        bounded_by: Friction of the same joint ("viscous" or "coulomb") that bounds the magnitude of
            an effect that reduces it; empty: none.
    """

    name: str
    unit: str
    low: float
    high: float
    relative_to: str = "1"
    size_exponent: float = 1.0
    neutral_value: float = 0.0
    in_contract: bool = True
    largest: float = np.inf
    bounded_by: str = ""

    def usual_range(self, torque_limit: float, velocity_limit: float) -> tuple[float, float]:
        """Return the usual range at a joint of these limits [N m, rad/s]."""
        reference = {
            "1": 1.0,
            "torque": torque_limit,
            "viscous": torque_limit / velocity_limit,
            "square": torque_limit / velocity_limit**2,
            "speed": velocity_limit,
            "inertia": torque_limit / REFERENCE_ACCELERATION,
        }[self.relative_to]
        return self.low * reference, self.high * reference

    def default_value(self, torque_limit: float, velocity_limit: float) -> float:
        """Return the value for a user who states none.

        It is the (geometric) mean of the usual range, or half its upper end for a size that may
        have either sign.
        """
        low, high = self.usual_range(torque_limit, velocity_limit)
        if low > 0.0:
            return float(np.sqrt(low * high))
        return 0.5 * (low + high) if self.size_exponent == 0.0 or low + high != 0.0 else 0.5 * high

    def draw(self, torque_limit: float, velocity_limit: float, rng: np.random.Generator) -> float:
        """Draw a value from the usual range; log-uniform where the range is positive."""
        low, high = self.usual_range(torque_limit, velocity_limit)
        return (
            float(np.exp(rng.uniform(np.log(low), np.log(high))))
            if low > 0.0
            else float(rng.uniform(low, high))
        )

    def largest_scale(self, value: float, site: EffectSite) -> float:
        """Return the largest factor by which an effect with this value may be scaled."""
        size = abs(value - self.neutral_value)
        largest = (
            float(getattr(site.actuators, self.bounded_by)[site.j])
            if self.bounded_by
            else self.largest
        )
        return (
            float((largest / size) ** (1.0 / self.size_exponent))
            if np.isfinite(largest) and size
            else np.inf
        )

    def accepts(self, value: float) -> bool:
        """Return whether a value is finite and of a sign that the parameter can have.

        An amplitude may be 0; a parameter of shape, such as the Stribeck velocity, may not.
        """
        if not np.isfinite(value) or self.low <= 0.0:
            return bool(np.isfinite(value))
        return value > 0.0 or (value == 0.0 and self.size_exponent > 0.0)

    def scaled(self, value: float, factor: float) -> float:
        """Return the parameter of the effect made `factor` > 0 times as large."""
        return (
            value
            if self.size_exponent == 0.0
            else self.neutral_value + (value - self.neutral_value) * factor**self.size_exponent
        )


@dataclass(frozen=True)
class EffectSite:
    """The place of an effect in a robot.

    Attributes:
        n: Number of joints.
        j: Index of the joint that carries the effect.
        source: Index of the joint from which a coupling comes.
        torque_limit: Shape (n,) [N m].
        velocity_limit: Shape (n,) [rad/s].
        actuators: Actuators of the robot.
        joint: Name of joint j; empty for an effect of the whole robot.
        link: Name of the link that the joint moves.
    """

    n: int
    j: int
    source: int
    torque_limit: FloatArray
    velocity_limit: FloatArray
    actuators: JointActuators
    joint: str
    link: str


EffectForm = Callable[[EffectSite, Mapping[str, float]], PhysicalEffect]
"""Function from a site and parameter values to the physics of the effect."""
ValueConversion = Callable[[Mapping[str, float]], Mapping[str, float]]
"""Function from the values of a model form to those that the contract calls by the same names."""


@dataclass(frozen=True)
class EffectType:
    """An effect of the contract's catalogue, or one outside it.

    Attributes:
        name: Name of the effect.
        parameters: Its parameters.
        forms: One model form per family; an effect outside the catalogue belongs to one family.
        place: "joint", "robot" or "either".
        out_of_catalogue: Whether the contract has no name for it, so that `unknown` is the answer.
        omitted_at_zero: Whether the effect of size 0 has no finite parameters (a rigid
            transmission has infinite stiffness) and is left out instead.
        conversions: By family, where a parameter of the contract is another number than the
            parameter of the same name in the model form.
    """

    name: str
    parameters: tuple[EffectParameter, ...]
    forms: Mapping[str, EffectForm]
    place: str = "joint"
    out_of_catalogue: bool = False
    omitted_at_zero: bool = False
    conversions: Mapping[str, ValueConversion] = field(default_factory=dict)

    def parameter(self, name: str) -> EffectParameter:
        """Return the parameter of a name."""
        return next(parameter for parameter in self.parameters if parameter.name == name)


@dataclass(frozen=True)
class MemorylessEffect(PhysicalEffect):
    """A torque at one joint that depends on the present state of that joint only.

    Attributes:
        n: Number of joints.
        j: Index of the joint.
        model: Function from the states of the joint (arrays of shape (…)) to its torque [N m].
    """

    n: int
    j: int
    model: Callable[[JointStates], FloatArray]

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        return torque_at_joint(self.n, self.j, self.model(single_joint_state(x, self.j)))


def single_joint_state(x: JointStates, j: int) -> JointStates:
    """Return the states of joint j, arrays of shape (…)."""
    return JointStates(x.t, x.q[..., j], x.v[..., j], x.a[..., j], x.load[..., j])


def torque_at_joint(n: int, j: int, torque: FloatArray) -> FloatArray:
    """Return torques of n joints that are zero but at joint j. Shape (…) to (…, n) [N m]."""
    out = np.zeros((*np.shape(torque), n))
    out[..., j] = torque
    return out


def memoryless_effect(
    site: EffectSite, model: Callable[[JointStates], FloatArray]
) -> PhysicalEffect:
    """Return an effect whose torque at the site is a function of the joint's present state."""
    return MemorylessEffect(site.n, site.j, model)


def smooth_sign(v: FloatArray) -> FloatArray:
    """Return v/√(v² + w²), a smooth sign of another shape than the tanh of the base model."""
    return v / np.sqrt(v * v + SIGN_WIDTH**2)


def phase_parameter(name: str = "phase") -> EffectParameter:
    """Return a parameter for a phase, which is a shape and no size."""
    return EffectParameter(name, "rad", -np.pi, np.pi, size_exponent=0.0, in_contract=False)
