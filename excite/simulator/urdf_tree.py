"""A URDF as the plant reads it: a tree of links whose joints can be locked, whose bodies and frames can be altered."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import UnusableInput

Array = np.ndarray
MOVING = ("revolute", "continuous", "prismatic")
MOMENTS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


@dataclass(frozen=True)
class Tree:
    """An XML tree without pictures, never changed in place: each method that alters it returns another.

    source: the file it came from, for messages.
    """

    source: str
    root: ElementTree.Element

    @property
    def text(self) -> str:
        return ElementTree.tostring(self.root, encoding="unicode")

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that can move, in the file's order."""
        return tuple(
            str(j.get("name")) for j in self.root.findall("joint") if j.get("type") in MOVING
        )

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that have mass."""
        return tuple(
            str(link.get("name"))
            for link in self.root.findall("link")
            if link.find("inertial") is not None
        )

    def joint(self, name: str) -> ElementTree.Element:
        """The element of a joint; UnusableInput lists the ones there are."""
        for element in self.root.findall("joint"):
            if element.get("name") == name:
                return element
        raise UnusableInput(
            f"{self.source}: no joint '{name}'; there are: {', '.join(self.joints)}"
        )

    def child(self, joint: str) -> str:
        """Name of the link that a joint moves."""
        element = self.joint(joint).find("child")
        return str(element.get("link")) if element is not None else ""

    def after(self, joint: str) -> tuple[str, ...]:
        """Names of the joints, fixed ones too, on the link that a joint moves."""
        link, joints = self.child(joint), self.root.findall("joint")
        parents = [(j, j.find("parent")) for j in joints]
        return tuple(
            str(j.get("name"))
            for j, parent in parents
            if parent is not None and parent.get("link") == link
        )

    def body(self, link: str) -> Array:
        """Pseudo-inertia [[S, h], [hᵀ, m]] of a link in its own frame, S the second moments. Shape (4, 4) [kg m², kg m, kg]."""
        inertial = self._link(link).find("inertial")
        if inertial is None:
            return np.zeros((4, 4))
        rotation, centre = _origin(inertial)
        mass, tensor = _number(inertial.find("mass"), "value"), np.zeros((3, 3))
        moments = inertial.find("inertia")
        for key, (i, j) in MOMENTS.items():
            tensor[i, j] = tensor[j, i] = _number(moments, key)
        about = rotation @ tensor @ rotation.T
        second = 0.5 * np.trace(about) * np.eye(3) - about + mass * np.outer(centre, centre)
        return np.block(
            [[second, mass * centre[:, None]], [mass * centre[None, :], np.array([[mass]])]]
        )

    def with_body(self, link: str, pseudo: Array) -> Tree:
        """The tree with another body in a link. pseudo: Shape (4, 4), as `body` gives it."""
        mass = float(pseudo[3, 3])
        centre = pseudo[:3, 3] / mass
        second = pseudo[:3, :3] - mass * np.outer(centre, centre)
        tensor = np.trace(second) * np.eye(3) - second
        root = copy.deepcopy(self.root)
        element = next(e for e in root.findall("link") if e.get("name") == link)
        for old in element.findall("inertial"):
            element.remove(old)
        inertial = ElementTree.SubElement(element, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_words(centre), rpy="0 0 0")
        ElementTree.SubElement(inertial, "mass", value=repr(mass))
        ElementTree.SubElement(
            inertial, "inertia", {key: repr(float(tensor[at])) for key, at in MOMENTS.items()}
        )
        return Tree(self.source, root)

    def moved(self, joint: str, rotation: Array, shift: Array) -> Tree:
        """The tree with a joint's frame turned and shifted, both seen in that frame. Shapes (3, 3), (3,) [m]."""
        root = copy.deepcopy(self.root)
        element = next(e for e in root.findall("joint") if e.get("name") == joint)
        before, at = _origin(element)
        for old in element.findall("origin"):
            element.remove(old)
        rpy = Rotation.from_matrix(before @ rotation).as_euler("xyz")
        ElementTree.SubElement(element, "origin", xyz=_words(at + before @ shift), rpy=_words(rpy))
        return Tree(self.source, root)

    def locked(self, joint: str, value: float) -> Tree:
        """The tree with a joint fixed at a position [rad or m]."""
        element = self.joint(joint)
        axis = _vector(element.find("axis"), "xyz", (1.0, 0.0, 0.0))
        axis = axis / np.linalg.norm(axis)
        if element.get("type") == "prismatic":
            out = self.moved(joint, np.eye(3), value * axis)
        else:
            out = self.moved(joint, Rotation.from_rotvec(value * axis).as_matrix(), np.zeros(3))
        out.joint(joint).set("type", "fixed")
        return out

    def limits(self, joint: str) -> tuple[float, float]:
        """Velocity [rad/s] and torque [N m] limit of a joint; UnusableInput when one is missing."""
        element = self.joint(joint).find("limit")
        values = tuple(
            0.0 if element is None else float(element.get(key, "0"))
            for key in ("velocity", "effort")
        )
        if min(values) <= 0.0:
            raise UnusableInput(
                f"{self.source}: joint '{joint}' has no velocity or torque limit; a simulated drive needs both in its <limit>"
            )
        return values[0], values[1]

    def _link(self, name: str) -> ElementTree.Element:
        for element in self.root.findall("link"):
            if element.get("name") == name:
                return element
        raise UnusableInput(f"{self.source}: no link '{name}'; there are: {', '.join(self.links)}")


def read(path: Path) -> Tree:
    """Read a URDF. Raises UnusableInput for a file that is none, or that has mimic joints."""
    try:
        root = ElementTree.fromstring(path.read_bytes())  # in its declared encoding
    except (OSError, ValueError, LookupError, ElementTree.ParseError) as error:
        raise UnusableInput(f"{path}: cannot be read as a URDF ({error}); give a URDF") from error
    if root.tag != "robot":
        raise UnusableInput(
            f"{path}: its root is <{root.tag}>, not <robot>; give a URDF (expand a .xacro first)"
        )
    for link in root.findall("link"):
        for name in ("visual", "collision"):
            for element in link.findall(name):
                link.remove(element)
    for name in ("material", "transmission", "gazebo"):
        for element in root.findall(name):
            root.remove(element)
    tree = Tree(str(path), root)
    for joint in root.findall("joint"):
        if joint.find("mimic") is not None:
            raise UnusableInput(
                f"{path}: joint '{joint.get('name')}' is a mimic; the simulated robot has none: make it fixed in the URDF"
            )
    return tree


def _origin(element: ElementTree.Element) -> tuple[Array, Array]:
    origin = element.find("origin")
    rpy, xyz = _vector(origin, "rpy", (0.0,) * 3), _vector(origin, "xyz", (0.0,) * 3)
    return Rotation.from_euler("xyz", rpy).as_matrix(), xyz


def _vector(element: ElementTree.Element | None, key: str, default: tuple[float, ...]) -> Array:
    text = None if element is None else element.get(key)
    return np.array(default if text is None else text.split(), float)


def _number(element: ElementTree.Element | None, key: str) -> float:
    return 0.0 if element is None else float(element.get(key, "0"))


def _words(values: Array) -> str:
    return " ".join(repr(float(v)) for v in values)
