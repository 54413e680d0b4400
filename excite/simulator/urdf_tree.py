"""A URDF as the simulator reads it: a tree whose joints, bodies and frames can be altered."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .._types import FloatArray
from ..errors import UnusableInput

MOVABLE_TYPES = ("revolute", "continuous", "prismatic")
"""Joint types with one degree of freedom."""
INERTIA_INDICES = {
    "ixx": (0, 0),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyy": (1, 1),
    "iyz": (1, 2),
    "izz": (2, 2),
}
"""Entry of the inertia tensor for each attribute of a URDF's <inertia>."""


@dataclass(frozen=True)
class UrdfTree:
    """A robot description without visual and collision geometry.

    It is immutable: each method that alters it returns another tree.

    Attributes:
        source: File that it was read from, for messages.
        root: Root element.
    """

    source: str
    root: ElementTree.Element

    @property
    def xml(self) -> str:
        """The tree as text."""
        return ElementTree.tostring(self.root, encoding="unicode")

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the movable joints, in the order of the file."""
        return tuple(
            str(j.get("name")) for j in self.root.findall("joint") if j.get("type") in MOVABLE_TYPES
        )

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that have mass."""
        return tuple(
            str(link.get("name"))
            for link in self.root.findall("link")
            if link.find("inertial") is not None
        )

    def joint_element(self, name: str) -> ElementTree.Element:
        """Return the element of a joint.

        Raises:
            UnusableInput: There is no such joint; the message lists those that exist.
        """
        for element in self.root.findall("joint"):
            if element.get("name") == name:
                return element
        raise UnusableInput(
            f"{self.source}: no joint '{name}'; its joints are: {', '.join(self.joints)}"
        )

    def child_link(self, joint: str) -> str:
        """Return the name of the link that a joint moves."""
        element = self.joint_element(joint).find("child")
        return str(element.get("link")) if element is not None else ""

    def following_joints(self, joint: str) -> tuple[str, ...]:
        """Return the names of all joints, fixed ones included, on the link that a joint moves."""
        link, joints = self.child_link(joint), self.root.findall("joint")
        parents = [(j, j.find("parent")) for j in joints]
        return tuple(
            str(j.get("name"))
            for j, parent in parents
            if parent is not None and parent.get("link") == link
        )

    def pseudo_inertia(self, link: str) -> FloatArray:
        """Return the pseudo-inertia [[S, h], [hᵀ, m]] of a link in its own frame.

        S are the second moments of mass and h = m·c (Wensing, Kim & Slotine 2018).

        Returns:
            Shape (4, 4) [kg m², kg m, kg]; zero for a link without mass.
        """
        inertial = self._link(link).find("inertial")
        if inertial is None:
            return np.zeros((4, 4))
        rotation, centre = _origin(inertial)
        mass, tensor = _number(inertial.find("mass"), "value"), np.zeros((3, 3))
        moments = inertial.find("inertia")
        for key, (i, j) in INERTIA_INDICES.items():
            tensor[i, j] = tensor[j, i] = _number(moments, key)
        about = rotation @ tensor @ rotation.T
        second = 0.5 * np.trace(about) * np.eye(3) - about + mass * np.outer(centre, centre)
        return np.block(
            [[second, mass * centre[:, None]], [mass * centre[None, :], np.array([[mass]])]]
        )

    def with_pseudo_inertia(self, link: str, pseudo_inertia: FloatArray) -> UrdfTree:
        """Return the tree with another body in a link.

        Args:
            link: Name of the link.
            pseudo_inertia: Shape (4, 4), as `pseudo_inertia` returns it.
        """
        mass = float(pseudo_inertia[3, 3])
        centre = pseudo_inertia[:3, 3] / mass
        second = pseudo_inertia[:3, :3] - mass * np.outer(centre, centre)
        tensor = np.trace(second) * np.eye(3) - second
        root = copy.deepcopy(self.root)
        element = next(e for e in root.findall("link") if e.get("name") == link)
        for previous in element.findall("inertial"):
            element.remove(previous)
        inertial = ElementTree.SubElement(element, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_attribute_text(centre), rpy="0 0 0")
        ElementTree.SubElement(inertial, "mass", value=repr(mass))
        ElementTree.SubElement(
            inertial,
            "inertia",
            {key: repr(float(tensor[at])) for key, at in INERTIA_INDICES.items()},
        )
        return UrdfTree(self.source, root)

    def with_moved_frame(self, joint: str, rotation: FloatArray, shift: FloatArray) -> UrdfTree:
        """Return the tree with a joint frame rotated and shifted, both seen in that frame.

        Args:
            joint: Name of the joint.
            rotation: Rotation matrix, shape (3, 3).
            shift: Translation, shape (3,) [m].
        """
        root = copy.deepcopy(self.root)
        element = next(e for e in root.findall("joint") if e.get("name") == joint)
        orientation, position = _origin(element)
        for previous in element.findall("origin"):
            element.remove(previous)
        rpy = Rotation.from_matrix(orientation @ rotation).as_euler("xyz")
        ElementTree.SubElement(
            element,
            "origin",
            xyz=_attribute_text(position + orientation @ shift),
            rpy=_attribute_text(rpy),
        )
        return UrdfTree(self.source, root)

    def with_locked_joint(self, joint: str, value: float) -> UrdfTree:
        """Return the tree with a joint fixed at a position [rad or m]."""
        element = self.joint_element(joint)
        axis = _vector(element.find("axis"), "xyz", (1.0, 0.0, 0.0))
        axis = axis / np.linalg.norm(axis)
        if element.get("type") == "prismatic":
            out = self.with_moved_frame(joint, np.eye(3), value * axis)
        else:
            out = self.with_moved_frame(
                joint, Rotation.from_rotvec(value * axis).as_matrix(), np.zeros(3)
            )
        out.joint_element(joint).set("type", "fixed")
        return out

    def velocity_and_torque_limit(self, joint: str) -> tuple[float, float]:
        """Return velocity [rad/s] and torque [N m] limit of a joint.

        Raises:
            UnusableInput: A limit is missing.
        """
        element = self.joint_element(joint).find("limit")
        values = tuple(
            0.0 if element is None else float(element.get(key, "0"))
            for key in ("velocity", "effort")
        )
        if min(values) <= 0.0:
            raise UnusableInput(
                f"{self.source}: joint '{joint}' has no velocity or torque limit; "
                "a simulated joint needs both in its <limit>"
            )
        return values[0], values[1]

    def _link(self, name: str) -> ElementTree.Element:
        """Return the element of a link."""
        for element in self.root.findall("link"):
            if element.get("name") == name:
                return element
        raise UnusableInput(
            f"{self.source}: no link '{name}'; its links are: {', '.join(self.links)}"
        )


def read_urdf(path: Path) -> UrdfTree:
    """Read a URDF.

    Raises:
        UnusableInput: The file is no URDF, or it has mimic joints.
    """
    try:
        return parse_urdf(path.read_bytes(), str(path))
    except OSError as error:
        raise UnusableInput(f"{path}: cannot be read as a URDF ({error}); give a URDF") from error


def parse_urdf(text: str | bytes, source: str) -> UrdfTree:
    """Read the text of a URDF.

    Args:
        text: The text, or its bytes in their declared encoding.
        source: Name of the robot's file, for messages.

    Raises:
        UnusableInput: It is no URDF, or it has mimic joints.
    """
    try:
        root = ElementTree.fromstring(text)
    except (ValueError, LookupError, ElementTree.ParseError) as error:
        raise UnusableInput(f"{source}: cannot be read as a URDF ({error}); give a URDF") from error
    if root.tag != "robot":
        raise UnusableInput(
            f"{source}: its root is <{root.tag}>, not <robot>; give a URDF (expand a .xacro first)"
        )
    for link in root.findall("link"):
        for name in ("visual", "collision"):
            for element in link.findall(name):
                link.remove(element)
    for name in ("material", "transmission", "gazebo"):
        for element in root.findall(name):
            root.remove(element)
    for element in (*root.findall("joint"), *root.findall("link/inertial")):
        _keep_first_of_each(element)
    tree = UrdfTree(source, root)
    for joint in root.findall("joint"):
        if joint.get("type") in MOVABLE_TYPES and joint.find("mimic") is not None:
            raise UnusableInput(
                f"{source}: joint '{joint.get('name')}' is a mimic joint, "
                "which cannot be simulated; make it fixed in the URDF"
            )
    return tree


def _keep_first_of_each(element: ElementTree.Element) -> None:
    """Remove children that repeat an earlier one: the first counts, and MuJoCo refuses a second."""
    names = set[str]()
    for child in list(element):
        if child.tag in names:
            element.remove(child)
        names.add(child.tag)


def _origin(element: ElementTree.Element) -> tuple[FloatArray, FloatArray]:
    """Return rotation matrix and translation of an element's <origin>."""
    origin = element.find("origin")
    rpy, xyz = _vector(origin, "rpy", (0.0,) * 3), _vector(origin, "xyz", (0.0,) * 3)
    return Rotation.from_euler("xyz", rpy).as_matrix(), xyz


def _vector(
    element: ElementTree.Element | None, key: str, default: tuple[float, ...]
) -> FloatArray:
    """Return the numbers of an attribute, or the default."""
    text = None if element is None else element.get(key)
    return np.array(default if text is None else text.split(), float)


def _number(element: ElementTree.Element | None, key: str) -> float:
    """Return the number of an attribute, or 0."""
    return 0.0 if element is None else float(element.get(key, "0"))


def _attribute_text(values: FloatArray) -> str:
    """Return numbers as the text of an attribute, without loss of precision."""
    return " ".join(repr(float(v)) for v in values)
