"""Payloads, springs, rotors, kinematic errors, torque offsets and the direction of gravity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..._types import FloatArray
from ...errors import UnusableInput
from ..actuator import JointActuators
from ..physical_effect import JointStates, PhysicalEffect
from ..urdf_tree import UrdfTree
from .effect_type import EffectParameter, EffectSite, EffectType, memoryless_effect, torque_at_joint

Values = Mapping[str, float]


@dataclass(frozen=True)
class AttachedBody(PhysicalEffect):
    """A body attached to a link.

    Attributes:
        link: Name of the link.
        mass: Mass [kg].
        centre: Centre of mass in the link frame [m].
        radii: Radii of gyration about the centre of mass, along the axes of the link frame [m].
    """

    link: str
    mass: float
    centre: tuple[float, float, float]
    radii: tuple[float, float, float]

    def modify_tree(self, tree: UrdfTree) -> UrdfTree:
        """Return the tree with the effect in it."""
        if self.mass == 0.0:
            return tree
        point = np.array([*self.centre, 1.0])
        added = self.mass * np.outer(point, point)
        added[:3, :3] += self.mass * np.diag(np.square(self.radii))
        return tree.with_pseudo_inertia(self.link, tree.pseudo_inertia(self.link) + added)


def _attached_body(
    site: EffectSite, p: Values, radii: tuple[float, float, float]
) -> PhysicalEffect:
    """Build the attached body from its parameter values."""
    return AttachedBody(site.link, p["mass"], (p["com_x"], p["com_y"], p["com_z"]), radii)


@dataclass(frozen=True)
class TiltedGravity(PhysicalEffect):
    """Gravity of a base that is not level: turned by roll, then by pitch.

    Attributes:
        roll: Angle about x [rad].
        pitch: Angle about y [rad].
        reduction: Relative reduction of the magnitude of gravity [1].
    """

    roll: float
    pitch: float
    reduction: float = 0.0

    def modify_gravity(self, gravity: FloatArray) -> FloatArray:
        """Return gravity in the tilted base frame, shape (3,) [m/s²]."""
        rotation = Rotation.from_euler("xy", [self.roll, self.pitch])
        return (
            np.asarray(rotation.inv().apply(gravity)) * (1.0 - self.reduction)
            if self.roll or self.pitch
            else gravity
        )


@dataclass(frozen=True)
class DisplacedFrame(PhysicalEffect):
    """A kinematic error: the frames of the joints behind a joint are rotated and shifted.

    Attributes:
        joint: Joint whose link has the error.
        rotation: Rotation vector in the frame of the next joint, shape (3,) [rad].
        shift: Translation in the same frame, shape (3,) [m].
    """

    joint: str
    rotation: FloatArray
    shift: FloatArray

    def modify_tree(self, tree: UrdfTree) -> UrdfTree:
        """Return the tree with the effect in it."""
        if not self.rotation.any() and not self.shift.any():
            return tree
        following = tree.following_joints(self.joint)
        if not following:
            raise UnusableInput(
                f"{tree.source}: joint '{self.joint}' carries no further joint; "
                "name a joint that does"
            )
        for name in following:
            tree = tree.with_moved_frame(
                name, Rotation.from_rotvec(self.rotation).as_matrix(), self.shift
            )
        return tree


def _displaced_frame(
    site: EffectSite, p: Values, axis: FloatArray, direction: FloatArray
) -> PhysicalEffect:
    """Build the error from its values and the directions of rotation and shift."""
    return DisplacedFrame(site.joint, p["angle"] * axis, p["length"] * direction)


@dataclass(frozen=True)
class AddedRotor(PhysicalEffect):
    """A rotor with torque J (1 + w cos q) q̈, seen through a gear whose ratio varies by w.

    Attributes:
        site: Place of the effect.
        inertia: Reflected inertia J [kg m²].
        ratio_variation: Relative variation w [1].
    """

    site: EffectSite
    inertia: float
    ratio_variation: float

    def modify_actuators(self, actuators: JointActuators) -> JointActuators:
        """Return the actuators with the added rotor."""
        added = np.zeros(self.site.n)
        added[self.site.j] = self.inertia
        return replace(actuators, inertia=actuators.inertia + added)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        j = self.site.j
        return torque_at_joint(
            self.site.n, j, self.ratio_variation * self.inertia * np.cos(x.q[..., j]) * x.a[..., j]
        )


def constant_offset(site: EffectSite, p: Values) -> PhysicalEffect:
    """A constant torque τ₀."""
    return memoryless_effect(site, lambda x: p["offset"] + 0.0 * x.v)


def drifting_offset(site: EffectSite, p: Values) -> PhysicalEffect:
    """An offset τ₀ (1 + 0.1 sin(2πt/17 s)), as of a strain-gauge bridge that warms up."""
    return memoryless_effect(
        site, lambda x: p["offset"] * (1.0 + 0.1 * np.sin(2.0 * np.pi * x.t / 17.0)) + 0.0 * x.v
    )


def spring_softening(site: EffectSite, p: Values) -> PhysicalEffect:
    """A softening spring k q₁ tanh((q − q₀)/q₁), q₁ = 0.8 rad."""
    return memoryless_effect(
        site, lambda x: p["stiffness"] * 0.8 * np.tanh((x.q - p["centre"]) / 0.8)
    )


def spring_one_sided(site: EffectSite, p: Values) -> PhysicalEffect:
    """A one-sided spring k d log(1 + e^{(q−q₀)/d}), d = 0.3 rad, as of a slack dress pack."""
    return memoryless_effect(
        site, lambda x: p["stiffness"] * 0.3 * np.logaddexp(0.0, (x.q - p["centre"]) / 0.3)
    )


EFFECT_TYPES = (
    EffectType(
        "payload",
        (
            EffectParameter("mass", "kg", 0.3, 3.0),
            EffectParameter("com_x", "m", -0.05, 0.05, size_exponent=0.0),
            EffectParameter("com_y", "m", -0.05, 0.05, size_exponent=0.0),
            EffectParameter("com_z", "m", 0.02, 0.12, size_exponent=0.0),
        ),
        {
            "tuning": lambda site, p: _attached_body(site, p, (0.03,) * 3),
            "scored": lambda site, p: _attached_body(site, p, (0.08, 0.03, 0.05)),
        },
    ),
    EffectType(
        "gravity_tilt",
        (
            EffectParameter("roll", "rad", -0.035, 0.035),
            EffectParameter("pitch", "rad", -0.035, 0.035),
        ),
        {
            "tuning": lambda site, p: TiltedGravity(p["roll"], p["pitch"]),
            "scored": lambda site, p: TiltedGravity(p["roll"], p["pitch"], 1e-3),
        },
        place="robot",
    ),
    EffectType(
        "kinematic_error",
        (EffectParameter("angle", "rad", 2e-4, 3.5e-3), EffectParameter("length", "m", 1e-4, 2e-3)),
        {
            "tuning": lambda site, p: _displaced_frame(
                site, p, np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
            ),
            "scored": lambda site, p: _displaced_frame(
                site, p, np.array([0.6, 0.8, 0.0]), np.array([0.0, 0.8, 0.6])
            ),
        },
    ),
    EffectType(
        "rotor_inertia",
        (EffectParameter("inertia", "kg m²", 0.1, 0.5, "inertia"),),
        {
            "tuning": lambda site, p: AddedRotor(site, p["inertia"], 0.0),
            "scored": lambda site, p: AddedRotor(site, p["inertia"], 0.1),
        },
    ),
    EffectType(
        "torque_offset",
        (EffectParameter("offset", "N m", 0.003, 0.02, "torque"),),
        {"tuning": constant_offset, "scored": drifting_offset},
    ),
    EffectType(
        "spring",
        (
            EffectParameter("stiffness", "N m/rad", 0.01, 0.1, "torque"),
            EffectParameter("centre", "rad", -0.8, 0.8, size_exponent=0.0, in_contract=False),
        ),
        {"tuning": spring_softening, "scored": spring_one_sided},
    ),
)
