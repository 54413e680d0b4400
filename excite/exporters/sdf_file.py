"""SDFormat of an identified robot: inertias, damping, friction, linear springs, limits."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..errors import ExciteWarning
from ..robot.inertial_parameters import TENSOR_ELEMENTS
from .mjcf_file import with_comment, words
from .simulator_model import Held, SimulatorModel

HOLDS: frozenset[Held] = frozenset({Held.INERTIA, Held.VISCOUS, Held.COULOMB, Held.SPRING})
"""Quantities that SDFormat holds. Its <friction> has no width, and no simulator that reads it has
rotor inertia."""
VERSION, VERSION_OF_MIMICS = "1.9", "1.11"
"""Version of SDFormat, and the first one with <mimic>."""
WORLD = "world"
"""Parent of the first link: the robot is fixed where its base is."""


def sdf_text(model: SimulatorModel) -> str:
    """Return the SDF of an identified robot.

    The pose of each link is that of the joint that moves it. Collision shapes and meshes are left
    out.

    Args:
        model: The identified robot.
    """
    robot = model.model.robot
    root = ElementTree.Element("sdf", version=VERSION_OF_MIMICS if robot.followers else VERSION)
    element = ElementTree.SubElement(root, "model", name=robot.name)
    names = sibling_names(robot.links, list(robot.model.names)[1:])
    for i, (link, joint) in enumerate(zip(names.links, names.joints, strict=True)):
        _add_link(element, link, joint, model.link_inertia(i))
    for i in range(len(robot.links)):
        _add_joint(model, element, i, names)
    lines = model.header("SDF", HOLDS)
    for renamed in names.renamed:
        lines.append(f"renamed, as names in a model of SDFormat are unique: {renamed}")
        warnings.warn(f"SDFormat: {renamed}", ExciteWarning, stacklevel=2)
    gravity = np.array(robot.model.gravity.linear)
    lines.append(f"gravity belongs to the world: {words(gravity)} m/s2 in the base's frame")
    lines.append("friction: simulators differ in how they regularise it at rest")
    return with_comment(root, lines)


@dataclass(frozen=True)
class SiblingNames:
    """Names of links and joints in a model of SDFormat.

    Attributes:
        links: Names of the links.
        joints: Names of the joints that move them.
        renamed: What has another name than in the robot, in words.
    """

    links: tuple[str, ...]
    joints: tuple[str, ...]
    renamed: tuple[str, ...]


def sibling_names(links: Sequence[str], joints: Sequence[str]) -> SiblingNames:
    """Return names of which each is used once, as SDFormat 1.7 and later require of siblings.

    URDF has joints with the name of a link, and links with the name "world", which SDFormat
    reserves.

    Args:
        links: Names of the links.
        joints: Names of the joints that move them.
    """
    taken, renamed = {WORLD, *links, *joints}, list[str]()

    def free(name: str, kind: str, used: Collection[str]) -> str:
        new = name
        while new in (used if new == name else taken):
            new += f"_{kind}"
        if new != name:
            taken.add(new)
            renamed.append(f"{kind} '{name}' is '{new}'")
        return new

    new_links = tuple(free(name, "link", (WORLD,)) for name in links)
    new_joints = tuple(free(name, "joint", (WORLD, *links)) for name in joints)
    return SiblingNames(new_links, new_joints, tuple(renamed))


def _add_link(model: ElementTree.Element, name: str, joint: str, inertia: pin.Inertia) -> None:
    """Add a link whose frame is that of its joint."""
    link = ElementTree.SubElement(model, "link", name=name)
    ElementTree.SubElement(link, "pose", relative_to=joint).text = "0 0 0 0 0 0"
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "pose").text = f"{words(inertia.lever)} 0 0 0"
    ElementTree.SubElement(inertial, "mass").text = repr(float(inertia.mass))
    tensor = ElementTree.SubElement(inertial, "inertia")
    for key, place in TENSOR_ELEMENTS.items():
        ElementTree.SubElement(tensor, key).text = repr(float(inertia.inertia[place]))


def _add_joint(
    model: SimulatorModel, parent: ElementTree.Element, number: int, names: SiblingNames
) -> None:
    """Add a joint with its limits and its friction."""
    robot = model.model.robot
    name, above = str(robot.model.names[number + 1]), int(robot.model.parents[number + 1])
    axis_vector = robot.axes()[number]
    slides = bool(np.linalg.norm(axis_vector[:3]) > 0.5)
    joint = ElementTree.SubElement(
        parent, "joint", name=names.joints[number], type="prismatic" if slides else "revolute"
    )
    frame = {"relative_to": names.links[above - 1]} if above else {"relative_to": "__model__"}
    placement = robot.model.jointPlacements[number + 1]
    pose = ElementTree.SubElement(joint, "pose", frame)
    angles = pin.rpy.matrixToRpy(placement.rotation)
    pose.text = f"{words(placement.translation)} {words(angles)}"
    ElementTree.SubElement(joint, "parent").text = names.links[above - 1] if above else WORLD
    ElementTree.SubElement(joint, "child").text = names.links[number]
    axis = ElementTree.SubElement(joint, "axis")
    ElementTree.SubElement(axis, "xyz").text = words(axis_vector[:3] if slides else axis_vector[3:])
    for follower in robot.followers:
        if follower.entry.name == name:
            master = names.joints[list(robot.model.names).index(follower.master) - 1]
            mimic = ElementTree.SubElement(axis, "mimic", joint=master)
            ElementTree.SubElement(mimic, "multiplier").text = repr(float(follower.multiplier))
            ElementTree.SubElement(mimic, "offset").text = repr(float(follower.offset))
            ElementTree.SubElement(mimic, "reference").text = "0"
    if name not in robot.joints:
        return
    j = robot.joints.index(name)
    limit = ElementTree.SubElement(axis, "limit")
    position = model.position_limit(j)
    lower, upper = (-np.inf, np.inf) if position is None else position
    values = {
        "lower": lower,
        "upper": upper,
        "effort": model.torque_limit(j),
        "velocity": model.velocity_limit(j),
    }
    for key, value in values.items():
        if value is not None:
            ElementTree.SubElement(limit, key).text = repr(float(value))
    dynamics = ElementTree.SubElement(axis, "dynamics")
    torques = model.torques
    ElementTree.SubElement(dynamics, "damping").text = repr(float(torques.damping[j, 0]))
    ElementTree.SubElement(dynamics, "friction").text = repr(float(torques.coulomb[j]))
    if torques.spring[j, 1]:
        ElementTree.SubElement(dynamics, "spring_reference").text = "0.0"
        ElementTree.SubElement(dynamics, "spring_stiffness").text = repr(
            float(torques.spring[j, 1])
        )
