"""What the robot carries and what pulls at it: bodies, springs, rotors, forces from outside, where down is."""

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
    """A body more in a link. radii: of gyration about its centre, along the link's axes [m]."""

    link: str
    mass: float
    centre: tuple[float, float, float]
    radii: tuple[float, float, float]

    def modify_tree(self, tree: UrdfTree) -> UrdfTree:
        if self.mass == 0.0:
            return tree
        point = np.array([*self.centre, 1.0])
        more = self.mass * np.outer(point, point)
        more[:3, :3] += self.mass * np.diag(np.square(self.radii))
        return tree.with_pseudo_inertia(self.link, tree.pseudo_inertia(self.link) + more)


def _attached_body(
    site: EffectSite, p: Values, radii: tuple[float, float, float]
) -> PhysicalEffect:
    return AttachedBody(site.link, p["mass"], (p["com_x"], p["com_y"], p["com_z"]), radii)


@dataclass(frozen=True)
class TiltedGravity(PhysicalEffect):
    """A base that is not level: gravity turned by roll, then pitch, and `less` weaker (1)."""

    roll: float
    pitch: float
    less: float = 0.0

    def gravity(self, vector: FloatArray) -> FloatArray:
        turn = Rotation.from_euler("xy", [self.roll, self.pitch])
        return (
            np.asarray(turn.inv().apply(vector)) * (1.0 - self.less)
            if self.roll or self.pitch
            else vector
        )


@dataclass(frozen=True)
class DisplacedFrame(PhysicalEffect):
    """What a joint's link carries sits elsewhere on it: the frames of the joints after it, turned and shifted as they see it."""

    joint: str
    turn: FloatArray
    shift: FloatArray

    def modify_tree(self, tree: UrdfTree) -> UrdfTree:
        if not self.turn.any() and not self.shift.any():
            return tree
        after = tree.following_joints(self.joint)
        if not after:
            raise UnusableInput(
                f"{tree.source}: joint '{self.joint}' carries no further joint; name one that does"
            )
        for name in after:
            tree = tree.with_moved_frame(
                name, Rotation.from_rotvec(self.turn).as_matrix(), self.shift
            )
        return tree


def _displaced_frame(
    site: EffectSite, p: Values, axis: FloatArray, way: FloatArray
) -> PhysicalEffect:
    return DisplacedFrame(site.joint, p["angle"] * axis, p["length"] * way)


@dataclass(frozen=True)
class AddedRotor(PhysicalEffect):
    """J (1 + w cos q) v̇: a rotor seen through a gear whose ratio wavers by w, or not at all."""

    site: EffectSite
    inertia: float
    waver: float

    def modify_actuators(self, drive: JointActuators) -> JointActuators:
        more = np.zeros(self.site.n)
        more[self.site.j] = self.inertia
        return replace(drive, inertia=drive.inertia + more)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        j = self.site.j
        return torque_at_joint(
            self.site.n, j, self.waver * self.inertia * np.cos(x.q[..., j]) * x.a[..., j]
        )


def constant_offset(site: EffectSite, p: Values) -> PhysicalEffect:
    """τ₀."""
    return memoryless_effect(site, lambda x: p["offset"] + 0.0 * x.v)


def drifting_offset(site: EffectSite, p: Values) -> PhysicalEffect:
    """τ₀ (1 + 0.1 sin(2πt/17 s)): a bridge that warms up."""
    return memoryless_effect(
        site, lambda x: p["offset"] * (1.0 + 0.1 * np.sin(2.0 * np.pi * x.t / 17.0)) + 0.0 * x.v
    )


def spring_softening(site: EffectSite, p: Values) -> PhysicalEffect:
    """k q₁ tanh((q − q₀)/q₁), q₁ = 0.8 rad: a spring that gives way."""
    return memoryless_effect(
        site, lambda x: p["stiffness"] * 0.8 * np.tanh((x.q - p["centre"]) / 0.8)
    )


def spring_one_sided(site: EffectSite, p: Values) -> PhysicalEffect:
    """k d log(1 + e^{(q−q₀)/d}), d = 0.3 rad: a dress pack that is slack on one side."""
    return memoryless_effect(
        site, lambda x: p["stiffness"] * 0.3 * np.logaddexp(0.0, (x.q - p["centre"]) / 0.3)
    )


EFFECT_TYPES = (
    EffectType(
        "payload",
        (
            EffectParameter("mass", "kg", 0.3, 3.0),
            EffectParameter("com_x", "m", -0.05, 0.05, power=0.0),
            EffectParameter("com_y", "m", -0.05, 0.05, power=0.0),
            EffectParameter("com_z", "m", 0.02, 0.12, power=0.0),
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
            EffectParameter("centre", "rad", -0.8, 0.8, power=0.0, stated=False),
        ),
        {"tuning": spring_softening, "scored": spring_one_sided},
    ),
)
