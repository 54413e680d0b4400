"""What the robot touches and stands on."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..._types import FloatArray
from ..mujoco_dynamics import RigidBodyDynamics
from ..physical_effect import BaseSuspension, JointStates, PhysicalEffect
from ..urdf_tree import UrdfTree
from .effect_type import EffectParameter, EffectSite, EffectType, phase_parameter

Values = Mapping[str, float]


@dataclass(frozen=True)
class ContactForce(PhysicalEffect):
    """A force on the centre of a joint's link from start to end; the drives give −Jᵀf more.

    plateau: half a sine, or a plateau between short flanks, whose direction turns by a radian. heading: of the force, in the
    horizontal plane [rad], with half as much downwards.
    """

    joint: str
    force: float
    start: float
    end: float
    heading: float
    plateau: bool
    arm: RigidBodyDynamics | None = None

    def bind(self, arm: RigidBodyDynamics) -> PhysicalEffect:
        return replace(self, arm=arm)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        t, q = np.atleast_1d(x.t), np.atleast_2d(x.q)
        u = (t - self.start) / (self.end - self.start)
        inside, out = (u > 0.0) & (u < 1.0), np.zeros(q.shape)
        if self.arm is not None and inside.any():
            u = u[inside]
            size = self.force * (
                np.minimum(1.0, 8.0 * np.minimum(u, 1.0 - u)) if self.plateau else np.sin(np.pi * u)
            )
            turn = self.heading + (u if self.plateau else 0.0 * u)
            way = np.column_stack([np.cos(turn), np.sin(turn), -0.5 + 0.0 * u]) / np.sqrt(1.25)
            base = self.arm.n - q.shape[1]
            lever = self.arm.centre_of_mass_jacobian(
                np.hstack([np.zeros((len(u), base)), q[inside]]), self.joint
            )[:, :, base:]
            out[inside] = -np.einsum("ki,kij->kj", size[:, None] * way, lever)
        return out.reshape(np.shape(x.q))


@dataclass(frozen=True)
class CompliantBase(PhysicalEffect):
    """A base that turns about the horizontal axes, or about all three, on springs. frequency: of the first, arm at 0 [Hz].

    ratios: frequencies of the axes over the first.
    """

    frequency: float
    ratios: tuple[float, ...]
    stiffness: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()

    def modify_tree(self, tree: UrdfTree) -> UrdfTree:
        root = copy.deepcopy(tree.root)
        children = {str(e.get("link")) for e in root.iter("child")}
        base = next(
            str(link.get("name"))
            for link in root.findall("link")
            if link.get("name") not in children
        )
        names = ["base_ground", *(f"base_swing_{i}" for i in range(1, len(self.ratios)))]
        for name in names:
            ElementTree.SubElement(root, "link", name=name)
        for i, (parent, child) in enumerate(zip(names, [*names[1:], base], strict=True)):
            joint = ElementTree.SubElement(root, "joint", name=f"base_axis_{i}", type="revolute")
            ElementTree.SubElement(joint, "parent", link=parent)
            ElementTree.SubElement(joint, "child", link=child)
            ElementTree.SubElement(joint, "axis", xyz=("1 0 0", "0 1 0", "0 0 1")[i])
            ElementTree.SubElement(joint, "limit", lower="-1", upper="1", velocity="1", effort="1")
        out = UrdfTree(tree.source, root)
        # a pedestal as heavy as half of what it carries
        mass = 0.5 * sum(float(tree.pseudo_inertia(link)[3, 3]) for link in tree.links)
        return out.with_pseudo_inertia(
            base, out.pseudo_inertia(base) + mass * np.diag([0.02, 0.02, 0.03, 1.0])
        )

    def bind(self, arm: RigidBodyDynamics) -> PhysicalEffect:
        inertia = np.diag(arm.mass_and_bias(np.zeros(arm.n), np.zeros(arm.n))[0])[
            : len(self.ratios)
        ]
        omega = 2.0 * np.pi * self.frequency * np.array(self.ratios)
        return replace(
            self, stiffness=tuple(omega**2 * inertia), damping=tuple(2.0 * 0.04 * omega * inertia)
        )

    def base_suspension(self) -> BaseSuspension:
        return BaseSuspension(np.array(self.stiffness), np.array(self.damping))


def _push(site: EffectSite, p: Values, plateau: bool) -> PhysicalEffect:
    return ContactForce(site.joint, p["force"], p["start"], p["end"], p["heading"], plateau)


EFFECT_TYPES = (
    EffectType(
        "contact",
        (
            EffectParameter("force", "N", 0.03, 0.2, "torque"),
            EffectParameter("start", "s", 2.0, 4.0, power=0.0, stated=False),
            EffectParameter("end", "s", 5.0, 7.0, power=0.0, stated=False),
            phase_parameter("heading"),
        ),
        {
            "tuning": lambda site, p: _push(site, p, False),
            "scored": lambda site, p: _push(site, p, True),
        },
    ),
    EffectType(
        "base_compliance",
        (EffectParameter("frequency", "Hz", 5.0, 20.0, power=-0.5),),
        {
            "tuning": lambda site, p: CompliantBase(p["frequency"], (1.0, 1.15)),
            "scored": lambda site, p: CompliantBase(p["frequency"], (1.0, 0.85, 1.5)),
        },
        place="robot",
        omitted_at_zero=True,
    ),
)
