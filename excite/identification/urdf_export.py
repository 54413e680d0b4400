"""The identified robot as a URDF: the user's own file, meshes and all, with every moving body's inertia replaced.

A body is the link that a joint moves with all that is fixed to it; it is written into that link, and what was fixed to it keeps no
inertia of its own. Locked joints become fixed where they were locked. Rotor inertia, offset and friction's width, for which URDF
has no words, stand in an <excite> element of the joint, which other programs pass over and this one reads.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ..robot import xml_file
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot, locate

Array = np.ndarray


def identified(robot: Robot, parameters: Parameters, psi: Array, widths: Array) -> str:
    """URDF text of `robot` with parameters ψ. Loaded again with the same joints, it gives the same torque."""
    path = locate(robot.source)
    raw = xml_file.read_text(path, "a URDF")
    before = re.match(
        r"\s*(<\?xml.*?\?>)?((\s|<!--.*?-->)*)<", raw, re.DOTALL
    )  # comments there belong to no element
    root = xml_file.parse_text(path, raw, keep_comments=True)
    _lock(root, robot)
    bodies = {link: psi[10 * i : 10 * i + 10] for i, link in enumerate(parameters.links)}
    moving = {
        frame.name
        for frame in robot.model.frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint > 0
    }
    for link in root.iter("link"):
        name = str(link.get("name"))
        if name in moving:
            for element in link.findall("inertial"):
                link.remove(element)
        if name in bodies:
            link.insert(0, _inertial(bodies[name]))
    for joint in root.findall("joint"):
        if joint.get("name") in robot.joints:
            place = robot.joints.index(str(joint.get("name")))
            _drive(
                joint,
                {kind: float(psi[parameters.block(kind)][place]) for kind in parameters.drive},
                float(widths[place]),
            )
    ElementTree.indent(root)
    comments = "" if before is None else before[2].strip()
    return (
        '<?xml version="1.0"?>\n'
        + (comments + "\n" if comments else "")
        + ElementTree.tostring(root, encoding="unicode")
        + "\n"
    )


def _lock(root: ElementTree.Element, robot: Robot) -> None:
    """Joints that don't move become fixed, at the position they were locked at; mimics of locked joints too."""
    locked: Mapping[str, float] = robot.options["locked"]  # type: ignore[assignment]
    kept = {*robot.joints, *(f.entry.name for f in robot.followers)}
    for joint in root.findall("joint"):
        name = str(joint.get("name"))
        if joint.get("type") == "fixed" or name in kept:
            continue
        _fix(joint, _position(root, joint, locked))


def _position(
    root: ElementTree.Element, joint: ElementTree.Element, locked: Mapping[str, float]
) -> float:
    mimic = joint.find("mimic")
    if mimic is None:
        return float(locked.get(str(joint.get("name")), 0.0))
    master = next(j for j in root.findall("joint") if j.get("name") == mimic.get("joint"))
    return float(mimic.get("multiplier", 1.0)) * _position(root, master, locked) + float(
        mimic.get("offset", 0.0)
    )


def _fix(joint: ElementTree.Element, position: float) -> None:
    origin, axis = joint.find("origin"), joint.find("axis")
    xyz = np.array(
        [float(v) for v in ("0 0 0" if origin is None else origin.get("xyz", "0 0 0")).split()]
    )
    rpy = [float(v) for v in ("0 0 0" if origin is None else origin.get("rpy", "0 0 0")).split()]
    direction = np.array(
        [float(v) for v in ("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split()]
    )
    direction /= np.linalg.norm(direction)
    place = pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
    if joint.get("type") == "prismatic":
        place = place * pin.SE3(np.eye(3), position * direction)
    else:
        place = place * pin.SE3(pin.exp3(position * direction), np.zeros(3))
    joint.set("type", "fixed")
    for tag in ("origin", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
        for element in joint.findall(tag):
            joint.remove(element)
    words = {"xyz": _words(place.translation), "rpy": _words(pin.rpy.matrixToRpy(place.rotation))}
    joint.insert(0, ElementTree.Element("origin", words))


def _inertial(phi: Array) -> ElementTree.Element:
    """Mass, centre and inertia about the centre, axes parallel to the link's."""
    body = pin.Inertia.FromDynamicParameters(phi)
    out = ElementTree.Element("inertial")
    ElementTree.SubElement(out, "origin", {"xyz": _words(body.lever), "rpy": "0 0 0"})
    ElementTree.SubElement(out, "mass", {"value": repr(float(body.mass))})
    tensor = body.inertia
    keys = {
        "ixx": (0, 0),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyy": (1, 1),
        "iyz": (1, 2),
        "izz": (2, 2),
    }
    ElementTree.SubElement(
        out, "inertia", {key: repr(float(tensor[place])) for key, place in keys.items()}
    )
    return out


def _drive(joint: ElementTree.Element, values: Mapping[str, float], width: float) -> None:
    dynamics = joint.find("dynamics")
    if "viscous" in values or "coulomb" in values:
        dynamics = ElementTree.SubElement(joint, "dynamics") if dynamics is None else dynamics
        for kind, key in (("viscous", "damping"), ("coulomb", "friction")):
            if kind in values:
                dynamics.set(key, repr(values[kind]))
    own = joint.find("excite")
    own = ElementTree.SubElement(joint, "excite") if own is None else own
    for kind in ("rotor_inertia", "offset"):
        if kind in values:
            own.set(kind, repr(values[kind]))
    if "coulomb" in values:
        own.set("coulomb_width", repr(width))


def _words(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
