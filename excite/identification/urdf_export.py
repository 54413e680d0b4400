"""Export of the identified robot as a URDF: the user's file with new inertial parameters.

A body is the link that a joint moves together with all that is fixed to it. Its inertia is written
into that link, and the links fixed to it get none. Locked joints become fixed at the position at
which they were locked. Rotor inertia, offset and friction width, for which URDF has no elements, go
into an <excite> element of the joint, which other programs ignore and this one reads.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from .._system.comments import xml_comment
from .._types import FloatArray
from ..robot import source_text, xml_file
from ..robot.inertial_parameters import TENSOR_ELEMENTS, Parameters, body_inertia
from ..robot.robot import Robot, locate


def identified_urdf(
    robot: Robot,
    parameters: Parameters,
    psi: FloatArray,
    widths: FloatArray,
    provenance: Sequence[str] = (),
    model: pin.Model | None = None,
) -> str:
    """Return the URDF of a robot with parameters ψ.

    Loaded with the same joints, it gives the same torque. Relative paths of meshes and textures are
    made absolute, because the file is written to another folder. Elements of other programs stay as
    they are, with their prefixes.

    Args:
        robot: The robot, whose source file is read again.
        parameters: Its standard parameters.
        psi: Values of the parameters. Shape (P,).
        widths: Widths of Coulomb friction. Shape (n,) [rad/s or m/s].
        provenance: Lines of a comment that says where the figures come from.
        model: Model whose moving links get new inertias; None: that of the robot.
    """
    path = locate(robot.source)
    text = source_text.read_urdf_text(path)
    # comments before the root element belong to no element, and the parser drops them
    prolog = re.match(r"\s*(<\?xml.*?\?>)?((\s|<!--.*?-->)*)<", text, re.DOTALL)
    root = xml_file.parse_as_written(path, text)
    _lock_joints(root, robot)
    bodies = {link: psi[10 * i : 10 * i + 10] for i, link in enumerate(parameters.links)}
    moving = {
        frame.name
        for frame in (robot.model if model is None else model).frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint > 0
    }
    for link in root.findall("link"):
        name = str(link.get("name"))
        if name in moving:
            for element in link.findall("inertial"):
                link.remove(element)
        if name in bodies:
            link.insert(0, _inertial_element(bodies[name]))
    for joint in root.findall("joint"):
        if joint.get("name") in robot.joints:
            place = robot.joints.index(str(joint.get("name")))
            _set_joint_parameters(
                joint,
                {kind: float(psi[parameters.block(kind)][place]) for kind in parameters.drive},
                float(widths[place]),
            )
        elif any(joint.get("name") == follower.entry.name for follower in robot.followers):
            _remove_joint_parameters(joint, parameters.drive)
    _make_paths_absolute(root, path.parent)
    ElementTree.indent(root)
    comments = "" if prolog is None else prolog[2].strip()
    if provenance:
        comments = xml_comment(provenance) + ("\n" + comments if comments else "")
    return (
        '<?xml version="1.0"?>\n'
        + (comments + "\n" if comments else "")
        + ElementTree.tostring(root, encoding="unicode")
        + "\n"
    )


def _make_paths_absolute(root: ElementTree.Element, folder: Path) -> None:
    """Replace relative paths of meshes and textures that exist in the URDF's folder."""
    for tag in ("mesh", "texture"):
        for element in root.iter(tag):
            name = element.get("filename", "")
            if name and "://" not in name and not Path(name).is_absolute():
                target = (folder / name).resolve()
                if target.is_file():
                    element.set("filename", str(target))


def _lock_joints(root: ElementTree.Element, robot: Robot) -> None:
    """Fix the joints that do not move, at the position they were locked at, and their mimics."""
    locked: Mapping[str, float] = robot.options["locked"]  # type: ignore[assignment]
    kept = {*robot.joints, *(f.entry.name for f in robot.followers)}
    joints = [
        joint
        for joint in root.findall("joint")
        if joint.get("type") != "fixed" and joint.get("name") not in kept
    ]
    # all positions first: a joint that is fixed follows none any more
    positions = [_locked_position(root, joint, locked) for joint in joints]
    for joint, position in zip(joints, positions, strict=True):
        _make_fixed(joint, position)


def _locked_position(
    root: ElementTree.Element, joint: ElementTree.Element, locked: Mapping[str, float]
) -> float:
    """Position of a locked joint or of a mimic of it [rad or m]."""
    mimic = joint.find("mimic")
    if mimic is None:
        return float(locked.get(str(joint.get("name")), 0.0))
    master = next(j for j in root.findall("joint") if j.get("name") == mimic.get("joint"))
    return float(mimic.get("multiplier", 1.0)) * _locked_position(root, master, locked) + float(
        mimic.get("offset", 0.0)
    )


def _make_fixed(joint: ElementTree.Element, position: float) -> None:
    """Turn a joint into a fixed joint at a position."""
    origin, axis = joint.find("origin"), joint.find("axis")
    xyz = np.array(
        [float(v) for v in ("0 0 0" if origin is None else origin.get("xyz", "0 0 0")).split()]
    )
    rpy = [float(v) for v in ("0 0 0" if origin is None else origin.get("rpy", "0 0 0")).split()]
    direction = np.array(
        [float(v) for v in ("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split()]
    )
    direction /= np.linalg.norm(direction)
    placement = pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
    if joint.get("type") == "prismatic":
        placement = placement * pin.SE3(np.eye(3), position * direction)
    else:
        placement = placement * pin.SE3(pin.exp3(position * direction), np.zeros(3))
    joint.set("type", "fixed")
    for tag in ("origin", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
        for element in joint.findall(tag):
            joint.remove(element)
    attributes = {
        "xyz": _formatted(placement.translation),
        "rpy": _formatted(pin.rpy.matrixToRpy(placement.rotation)),
    }
    joint.insert(0, ElementTree.Element("origin", attributes))


def _inertial_element(phi: FloatArray) -> ElementTree.Element:
    """Mass, centre of mass, and inertia about it with axes parallel to the link's."""
    body = body_inertia(phi)
    out = ElementTree.Element("inertial")
    ElementTree.SubElement(out, "origin", {"xyz": _formatted(body.lever), "rpy": "0 0 0"})
    ElementTree.SubElement(out, "mass", {"value": repr(float(body.mass))})
    tensor = body.inertia
    moments = {key: repr(float(tensor[place])) for key, place in TENSOR_ELEMENTS.items()}
    ElementTree.SubElement(out, "inertia", moments)
    return out


def _remove_joint_parameters(joint: ElementTree.Element, kinds: Sequence[str]) -> None:
    """Remove the parameters of a mimic joint, which the joint that it follows has too now."""
    for tag, key, kind in (
        ("dynamics", "damping", "viscous"),
        ("dynamics", "friction", "coulomb"),
        ("excite", "rotor_inertia", "rotor_inertia"),
        ("excite", "offset", "offset"),
    ):
        element = joint.find(tag)
        if element is not None and kind in kinds:
            element.attrib.pop(key, None)


def _set_joint_parameters(
    joint: ElementTree.Element, values: Mapping[str, float], width: float
) -> None:
    """Write friction into <dynamics>, and the other joint parameters into <excite>."""
    dynamics = joint.find("dynamics")
    if "viscous" in values or "coulomb" in values:
        dynamics = ElementTree.SubElement(joint, "dynamics") if dynamics is None else dynamics
        for kind, key in (("viscous", "damping"), ("coulomb", "friction")):
            if kind in values:
                dynamics.set(key, repr(values[kind]))
    extension = joint.find("excite")
    extension = ElementTree.SubElement(joint, "excite") if extension is None else extension
    for kind in ("rotor_inertia", "offset"):
        if kind in values:
            extension.set(kind, repr(values[kind]))
    if "coulomb" in values:
        extension.set("coulomb_width", repr(width))


def _formatted(values: FloatArray) -> str:
    """Numbers of a URDF attribute, with all digits."""
    return " ".join(repr(float(value)) for value in values)
