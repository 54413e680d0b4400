"""MJCF of an identified robot: inertias, armature, damping, friction loss, springs, limits.

MuJoCo's dry friction is a constraint. Its force in the middle of its range is −(b q̇ + q̈)/R with
the damping b of `solreffriction` and the regularisation R = (1 − d)/d · (M⁻¹)ⱼⱼ at qpos0, d the
impedance of `solimpfriction`, and is limited to ±frictionloss F (MuJoCo documentation,
"Computation", section "Constraint model"). With b = 1/timestep it is the friction of the speed at
the end of the step, F clip(q̇/w, ±1) with w = R F/b: it has the width and the slope of the
identified F tanh(q̇/w) if R = w/(F timestep), and differs from it by less than 0.5 % of F from 3 w
on.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._system.comments import xml_comment
from .._types import FloatArray
from ..robot.mjcf import OFFSET_STIFFNESS
from .simulator_model import Held, SimulatorModel

HOLDS: frozenset[Held] = frozenset(Held) - {Held.STATIC_FRICTION}
"""Quantities that MuJoCo holds."""
TIMESTEP = 5e-4
"""Time step of a new file [s]: friction is that of the speed at the end of a step, and acceleration
times step should be small compared with the width of Coulomb friction."""
IMPEDANCE_RANGE = (1e-4, 0.9999)
"""Range of MuJoCo's impedance d (mjMINIMP, mjMAXIMP)."""
DELAY_MARGIN = 2
"""Samples of an actuator's history beyond those that its delay spans."""
LARGEST_ROOT = 1e6
"""Largest rest position of a polynomial spring [rad or m]: a further one would lose digits."""


@dataclass(frozen=True)
class JointAttributes:
    """Attributes of an MJCF <joint> by name; None: it is not stated.

    Attributes:
        values: Text of each attribute.
        holds_offset: False where the offset has no place next to the spring.
    """

    values: Mapping[str, str | None]
    holds_offset: bool = True


def mjcf_text(model: SimulatorModel, *, servos: bool = True) -> str:
    """Return the MJCF of an identified robot.

    Bodies are the links that the joints move, with all that is fixed to them. Frames of fixed links
    are sites. Collision shapes and meshes are left out: they do not change the torque, and
    `mjcf_merge` keeps those of the user's own file.

    Args:
        model: The identified robot.
        servos: Whether joints with an identified position loop get a <position> actuator, whose
            control is the commanded position, instead of a torque motor.
    """
    robot = model.model.robot
    root = ElementTree.Element("mujoco", model=robot.name)
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true")
    gravity = words(robot.model.gravity.linear)
    ElementTree.SubElement(
        root, "option", timestep=repr(TIMESTEP), gravity=gravity, integrator="implicitfast"
    )
    world = ElementTree.SubElement(root, "worldbody")
    bodies = [world]
    attributes = joint_attributes(model, inverse_mass_diagonal(model), TIMESTEP)
    names, axes = list(robot.model.names)[1:], robot.axes()
    for i, name in enumerate(names):
        parent = bodies[int(robot.model.parents[i + 1])]
        placement = robot.model.jointPlacements[i + 1]
        body = ElementTree.SubElement(
            parent,
            "body",
            name=robot.links[i],
            pos=words(placement.translation),
            quat=words(quaternion(placement.rotation)),
        )
        bodies.append(body)
        slides = bool(np.linalg.norm(axes[i][:3]) > 0.5)
        joint = ElementTree.SubElement(
            body,
            "joint",
            name=name,
            type="slide" if slides else "hinge",
            axis=words(axes[i][:3] if slides else axes[i][3:]),
        )
        if name in robot.joints:
            j = robot.joints.index(name)
            limit = model.position_limit(j)
            if limit is not None:
                joint.set("range", words(limit))
            for key, value in attributes[name].values.items():
                if value is not None:
                    joint.set(key, value)
        body.append(inertial_element(model.link_inertia(i)))
    _add_sites(model, bodies)
    _add_followers(model, root)
    is_servo = servos and bool(model.model.position_loop)
    if is_servo:
        _add_servos(model, root)
    else:
        _add_actuators(model, root)
    lost = [name for name, entry in attributes.items() if not entry.holds_offset]
    lines = [*model.header("MJCF", HOLDS), *offset_notes(model), *_notes(TIMESTEP, lost)]
    if is_servo:
        lines.append("actuators: kv brakes the joint; the identified K_d acts on the error's rate")
    return with_comment(root, lines)


def with_comment(root: ElementTree.Element, lines: Sequence[str]) -> str:
    """Return an XML document that begins with a comment.

    Args:
        root: Root element.
        lines: Lines of the comment.
    """
    ElementTree.indent(root)
    comment = xml_comment(f"  {line}" for line in lines)
    body = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0"?>\n{comment}\n{body}\n'


def offset_notes(model: SimulatorModel) -> list[str]:
    """Lines that say which springs stand for a constant torque, as MJCF has no place for one."""
    offsets = [
        f"{name} {-torque[0]:.4g} {model.model.robot.entries[j].unit('N m')}"
        for j, (name, torque) in enumerate(zip(model.joints, model.torques.spring, strict=True))
        if torque[0] and not np.any(torque[1:])
    ]
    if not offsets:
        return []
    return [
        f"offsets: MJCF has none of joints; a spring of stiffness {OFFSET_STIFFNESS:g} with a far",
        f"  springref (rad, m) is the constant torque stiffness * springref: {', '.join(offsets)}",
    ]


def _notes(timestep: float, lost: Sequence[str]) -> list[str]:
    """Lines that say how MuJoCo's friction is to be understood."""
    lines = [
        f"frictionloss acts on the speed at the end of a step: solreffriction holds 1/{timestep:g} "
        "s;",
        "  with another timestep, export again or set its second number to -1/timestep",
        "velocity limits: MuJoCo has none of joints",
    ]
    if lost:
        lines.append(f"the offset has no place next to the spring of: {', '.join(lost)}")
    return lines


def joint_attributes(
    model: SimulatorModel, inverse_mass: Mapping[str, float], timestep: float
) -> dict[str, JointAttributes]:
    """Return the attributes of each joint's torque.

    Args:
        model: The identified robot.
        inverse_mass: (M⁻¹)ⱼⱼ of each joint at qpos0, armature included [1/(kg m²) or 1/kg].
        timestep: Time step of the simulation [s].
    """
    torques, out = model.torques, dict[str, JointAttributes]()
    for j, name in enumerate(model.joints):
        friction = float(torques.coulomb[j])
        values: dict[str, str | None] = {
            "armature": repr(float(torques.rotor_inertia[j])),
            "damping": _polynomial(torques.damping[j]),
            "frictionloss": repr(friction),
            "solreffriction": None,
            "solimpfriction": None,
        }
        if friction > 0.0:
            solref, solimp = friction_solver(
                friction, float(torques.widths[j]), inverse_mass[name], timestep
            )
            values |= {"solreffriction": words(solref), "solimpfriction": words(solimp)}
        coefficients, reference, holds_offset = spring(torques.spring[j])
        values |= {"stiffness": None, "springref": None}
        if np.any(coefficients):
            values |= {"stiffness": _polynomial(coefficients), "springref": repr(reference)}
        out[name] = JointAttributes(values, holds_offset)
    return out


def friction_solver(
    friction: float, width: float, inverse_mass: float, timestep: float
) -> tuple[tuple[float, float], tuple[float, ...]]:
    """Return `solreffriction` and `solimpfriction` of a joint; see the module's docstring.

    Args:
        friction: Coulomb friction F [N m].
        width: Width w of its sign function [rad/s].
        inverse_mass: (M⁻¹)ⱼⱼ at qpos0 [1/(kg m²)].
        timestep: Time step [s].

    Returns:
        The two values of `solreffriction`, in MuJoCo's format of stiffness and damping, and the
        five of `solimpfriction`.
    """
    regularisation = width / (friction * timestep)
    low, high = IMPEDANCE_RANGE
    impedance = float(np.clip(inverse_mass / (regularisation + inverse_mass), low, high))
    # MuJoCo divides the damping by the largest impedance. A stiffness above 0 selects this format;
    # friction has no position, so that it is not used
    return (-1.0, -impedance / timestep), (impedance, impedance, 1.0, 0.5, 2.0)


def spring(polynomial: FloatArray) -> tuple[FloatArray, float, bool]:
    """Return MuJoCo's form k₀x + k₁x² + k₂x³, x = q − ref, of a polynomial torque of position.

    Args:
        polynomial: Coefficients of 1, q, q², q³; the first is the offset. Shape (4,).

    Returns:
        Coefficients k, shape (3,), the rest position, and False if the constant has no place: a
        polynomial without a zero, or one that is too far away.
    """
    offset, springs = float(polynomial[0]), np.array(polynomial[1:], float)
    if not offset:
        return springs, 0.0, True
    if not np.any(springs):
        return np.array([OFFSET_STIFFNESS, 0.0, 0.0]), -offset / OFFSET_STIFFNESS, True
    roots = np.roots(np.trim_zeros(polynomial[::-1], "f"))
    real = roots[np.abs(roots.imag) < 1e-9 * np.maximum(np.abs(roots), 1.0)].real
    if not len(real) or np.abs(real).min() > LARGEST_ROOT:
        return springs, 0.0, False
    zero = float(real[np.argmin(np.abs(real))])
    linear, square, cube = springs
    shifted = [
        linear + 2.0 * square * zero + 3.0 * cube * zero**2,
        square + 3.0 * cube * zero,
        cube,
    ]
    return np.array(shifted), zero, True


def inverse_mass_diagonal(model: SimulatorModel) -> dict[str, float]:
    """Return the diagonal of M⁻¹ at q = 0 by joint, as MuJoCo's `dof_invweight0`.

    Args:
        model: The identified robot.
    """
    robot = model.model.robot
    body = robot.model.copy()
    for i in range(len(robot.links)):
        body.inertias[i + 1] = model.link_inertia(i)
    upper = np.triu(pin.crba(body, body.createData(), np.zeros(body.nq)))
    mass = upper + np.triu(upper, 1).T
    names = list(robot.model.names)[1:]
    for j, name in enumerate(robot.joints):
        mass[names.index(name), names.index(name)] += model.torques.rotor_inertia[j]
    return dict(zip(names, np.diag(np.linalg.inv(mass)).tolist(), strict=True))


def inertial_element(inertia: pin.Inertia) -> ElementTree.Element:
    """Return an <inertial>: mass, centre of mass, and the full inertia tensor about it."""
    tensor = inertia.inertia
    moments = [tensor[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return ElementTree.Element(
        "inertial",
        pos=words(inertia.lever),
        mass=repr(float(inertia.mass)),
        fullinertia=words(moments),
    )


def quaternion(rotation: FloatArray) -> list[float]:
    """Return a rotation as (w, x, y, z)."""
    value = pin.Quaternion(np.asarray(rotation))
    return [float(value.w), float(value.x), float(value.y), float(value.z)]


def _add_sites(model: SimulatorModel, bodies: Sequence[ElementTree.Element]) -> None:
    """Add the frames of links that are fixed to others."""
    robot = model.model.robot
    for frame in robot.model.frames:
        if frame.type == pin.FrameType.BODY and frame.name not in (*robot.links, "universe"):
            ElementTree.SubElement(
                bodies[int(frame.parentJoint)],
                "site",
                name=frame.name,
                pos=words(frame.placement.translation),
                quat=words(quaternion(frame.placement.rotation)),
            )


def _add_followers(model: SimulatorModel, root: ElementTree.Element) -> None:
    """Add the couplings of mimic joints, which are soft constraints in MuJoCo."""
    followers = model.model.robot.followers
    if followers:
        equality = ElementTree.SubElement(root, "equality")
        for follower in followers:
            ElementTree.SubElement(
                equality,
                "joint",
                joint1=follower.entry.name,
                joint2=follower.master,
                polycoef=words([follower.offset, follower.multiplier, 0.0, 0.0, 0.0]),
            )


def _add_actuators(model: SimulatorModel, root: ElementTree.Element) -> None:
    """Add a torque motor for each joint, with its limit and its delay."""
    actuators = ElementTree.SubElement(root, "actuator")
    for j, name in enumerate(model.joints):
        motor = ElementTree.SubElement(actuators, "motor", name=name, joint=name)
        limit = model.torque_limit(j)
        if limit is not None and np.isfinite(limit):
            motor.set("ctrlrange", words([-limit, limit]))
            motor.set("forcerange", words([-limit, limit]))
        _set_delay(motor, float(model.torques.actuator_delay[j]))


def _add_servos(model: SimulatorModel, root: ElementTree.Element) -> None:
    """Add the position loop of each joint, with its largest torque and its delay."""
    actuators = ElementTree.SubElement(root, "actuator")
    for j, name in enumerate(model.joints):
        loop = model.model.position_loop[name]
        gain, limit = float(loop.proportional), model.position_limit(j)
        servo = ElementTree.SubElement(
            actuators,
            "position",
            name=name,
            joint=name,
            kp=repr(gain),
            kv=repr(float(loop.derivative)),
        )
        if limit is not None:
            servo.set("ctrlrange", words(limit))
        largest = np.inf if loop.error_limit is None else gain * float(loop.error_limit)
        torque = model.torque_limit(j)
        largest = min(largest, np.inf if torque is None else torque)
        if np.isfinite(largest):
            servo.set("forcerange", words([-largest, largest]))
        _set_delay(servo, float(loop.delay) + float(model.torques.actuator_delay[j]))


def _set_delay(actuator: ElementTree.Element, delay: float) -> None:
    """State the delay [s] of an actuator, if it has any."""
    if delay > 0.0:
        actuator.set("delay", repr(delay))
        actuator.set("nsample", str(int(np.ceil(delay / TIMESTEP)) + DELAY_MARGIN))


def _polynomial(coefficients: Iterable[float]) -> str:
    """Coefficients of damping or stiffness; one number where the others are 0, as older versions
    of MuJoCo read no more."""
    values = [float(value) for value in coefficients]
    return words(values if any(values[1:]) else values[:1])


def words(values: Iterable[float]) -> str:
    """Return numbers of an XML attribute, with all digits.

    Args:
        values: The numbers; −0 becomes 0.
    """
    return " ".join(repr(float(value) + 0.0) for value in values)
