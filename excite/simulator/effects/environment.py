"""Contact with the environment, and a compliant base."""

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
BASE_DAMPING_RATIO = 0.04
"""Damping ratio of the base's oscillation; a few per cent is usual of steel structures."""


@dataclass(frozen=True)
class ContactForce(PhysicalEffect):
    """A force on the centre of mass of a joint's link between two times.

    The actuators give −Jᵀf in addition. The force is horizontal, with half as much downwards.

    Attributes:
        joint: Joint that moves the link.
        force: Peak force [N].
        start: Begin of the contact [s].
        end: End of the contact [s].
        heading: Horizontal direction of the force [rad].
        plateau: False: half a sine wave. True: a plateau between short ramps, whose direction
            turns by one radian.
        dynamics: Rigid-body dynamics; set by `bind`.
    """

    joint: str
    force: float
    start: float
    end: float
    heading: float
    plateau: bool
    dynamics: RigidBodyDynamics | None = None

    def bind(self, dynamics: RigidBodyDynamics) -> PhysicalEffect:
        """Return the effect with the dynamics that it acts on."""
        return replace(self, dynamics=dynamics)

    def torque(self, x: JointStates, z: FloatArray) -> FloatArray:
        """Return the torque of the effect, shape (…, n) [N m]."""
        t, q = np.atleast_1d(x.t), np.atleast_2d(x.q)
        u = (t - self.start) / (self.end - self.start)
        inside, out = (u > 0.0) & (u < 1.0), np.zeros(q.shape)
        if self.dynamics is not None and inside.any():
            u = u[inside]
            magnitude = self.force * (
                np.minimum(1.0, 8.0 * np.minimum(u, 1.0 - u)) if self.plateau else np.sin(np.pi * u)
            )
            direction = self.heading + (u if self.plateau else 0.0 * u)
            unit_vector = np.column_stack(
                [np.cos(direction), np.sin(direction), -0.5 + 0.0 * u]
            ) / np.sqrt(1.25)
            base = self.dynamics.n - q.shape[1]
            jacobian = self.dynamics.centre_of_mass_jacobian(
                np.hstack([np.zeros((len(u), base)), q[inside]]), self.joint
            )[:, :, base:]
            out[inside] = -np.einsum("ki,kij->kj", magnitude[:, None] * unit_vector, jacobian)
        return out.reshape(np.shape(x.q))


@dataclass(frozen=True)
class CompliantBase(PhysicalEffect):
    """A base that turns about two or three axes on springs and dampers.

    Attributes:
        frequency: Natural frequency about the first axis with the arm at zero [Hz].
        ratios: Natural frequencies about the axes, over that of the first.
        stiffness: Per axis, shape (k,) [N m/rad]; set by `bind`.
        damping: Per axis, shape (k,) [N m s/rad]; set by `bind`.
    """

    frequency: float
    ratios: tuple[float, ...]
    stiffness: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()

    def modify_tree(self, tree: UrdfTree) -> UrdfTree:
        """Return the tree with the effect in it."""
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
        # the pedestal weighs half of the arm
        mass = 0.5 * sum(float(tree.pseudo_inertia(link)[3, 3]) for link in tree.links)
        return out.with_pseudo_inertia(
            base, out.pseudo_inertia(base) + mass * np.diag([0.02, 0.02, 0.03, 1.0])
        )

    def bind(self, dynamics: RigidBodyDynamics) -> PhysicalEffect:
        """Return the effect with the dynamics that it acts on."""
        inertia = np.diag(dynamics.mass_and_bias(np.zeros(dynamics.n), np.zeros(dynamics.n))[0])[
            : len(self.ratios)
        ]
        omega = 2.0 * np.pi * self.frequency * np.array(self.ratios)
        return replace(
            self,
            stiffness=tuple(omega**2 * inertia),
            damping=tuple(2.0 * BASE_DAMPING_RATIO * omega * inertia),
        )

    def base_suspension(self) -> BaseSuspension:
        """Return the springs and dampers of the base."""
        return BaseSuspension(np.array(self.stiffness), np.array(self.damping))


def _contact_force(site: EffectSite, p: Values, plateau: bool) -> PhysicalEffect:
    """Build the contact from its parameter values."""
    return ContactForce(site.joint, p["force"], p["start"], p["end"], p["heading"], plateau)


EFFECT_TYPES = (
    EffectType(
        "contact",
        (
            EffectParameter("force", "N", 0.03, 0.2, "torque"),
            EffectParameter("start", "s", 2.0, 4.0, size_exponent=0.0, in_contract=False),
            EffectParameter("end", "s", 5.0, 7.0, size_exponent=0.0, in_contract=False),
            phase_parameter("heading"),
        ),
        {
            "tuning": lambda site, p: _contact_force(site, p, False),
            "scored": lambda site, p: _contact_force(site, p, True),
        },
    ),
    EffectType(
        "base_compliance",
        (EffectParameter("frequency", "Hz", 5.0, 20.0, size_exponent=-0.5),),
        {
            "tuning": lambda site, p: CompliantBase(p["frequency"], (1.0, 1.15)),
            "scored": lambda site, p: CompliantBase(p["frequency"], (1.0, 0.85, 1.5)),
        },
        place="robot",
        omitted_at_zero=True,
    ),
)
