"""MJCF robots, compiled by MuJoCo and converted to the URDF that all other modules read.

Everything is taken from the compiled model, in which defaults, classes, includes, units and the
inertias of geoms are resolved. Bodies become links; the frame of a link is its body's, moved to the
anchor of the body's last joint.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..errors import UnusableInput

MESH_FORMATS = (".stl", ".obj")
"""Formats of meshes that are read from their own file; others become the box around them."""
SHAPE_DIGITS = 9
"""Decimals of the placement of collision shapes [m and rad]: MuJoCo turns meshes into their
principal axes and back, which leaves rounding errors."""
COEFFICIENT_TOLERANCE = 1e-12
"""Coefficient of a joint coupling that counts as zero."""
GRAVITY_TOLERANCE = 0.05
"""Difference of gravity that is not worth a remark [m/s²]: gravity varies by as much on earth."""
OFFSET_STIFFNESS = 1e-12
"""Stiffness up to which a spring is a constant torque [N m/rad or N/m]: `excite export` holds the
offset of a joint by a spring of this stiffness with a rest position so far away that its torque is
constant to 1e-11 N m over ten radians, as MJCF has no constant torque of a joint."""
STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""MuJoCo's and this package's default [m/s²]."""


@dataclass(frozen=True)
class Conversion:
    """A robot converted to URDF.

    Attributes:
        text: The URDF.
        remarks: Sentences on what was changed or left out.
        is_mjcf: True if the file is an MJCF.
    """

    text: str
    remarks: tuple[str, ...]
    is_mjcf: bool = False


def convert_mjcf(path: Path) -> Conversion:
    """Compile an MJCF file and convert it to URDF.

    Raises:
        UnusableInput: MuJoCo is not installed or cannot compile the file; the robot has ball
            joints, closed loops or nonlinear couplings.
    """
    if find_spec("mujoco") is None:
        raise UnusableInput(
            f"{path}: is an MJCF; reading it takes MuJoCo: .venv/bin/pip install -e '.[sim]'"
        )
    import mujoco

    try:
        specification = mujoco.MjSpec.from_file(str(path))
        model = specification.compile()
    except (ValueError, RuntimeError, OSError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split()) or "no reason given"
        raise UnusableInput(
            f"{path}: MuJoCo cannot compile it ({reason}); correct the file"
        ) from error
    return _Converter(path, specification, model).convert()


class _Converter:
    """The conversion of one compiled model."""

    def __init__(self, path: Path, specification: Any, model: Any) -> None:
        import mujoco

        self._path, self._specification, self._model = path, specification, model
        self._mujoco = mujoco
        self._remarks: list[str] = []
        objects = mujoco.mjtObj
        self._bodies = self._names(objects.mjOBJ_BODY, model.nbody, "body")
        self._joints = self._names(objects.mjOBJ_JOINT, model.njnt, "joint")
        self._root = ElementTree.Element("robot", name=self._robot_name())
        self._anchors = np.zeros((model.nbody, 3))  # of each link, in its body's frame

    def convert(self) -> Conversion:
        """Convert all bodies, in the order of the model, in which parents come first."""
        model = self._model
        self._require_no_loops()
        followers = self._couplings()
        torque = self._torque_limits()
        for body in range(model.nbody):
            if body:
                self._add_joints(body, followers, torque)
            self._add_link(body)
        if model.ntendon and (np.any(model.tendon_stiffness) or np.any(model.tendon_damping)):
            self._remark("its tendons are not modelled")
        for site in range(model.nsite):
            self._add_site(site)
        gravity = np.array(model.opt.gravity)
        if model.opt.disableflags & int(self._mujoco.mjtDisableBit.mjDSBL_GRAVITY):
            gravity = np.zeros(3)
        if not np.allclose(gravity, STANDARD_GRAVITY, atol=GRAVITY_TOLERANCE):
            stated = ",".join(f"{value:g}" for value in gravity)
            self._remark(f"its gravity is not used; state it with --gravity {stated}")
        ElementTree.indent(self._root)
        text = ElementTree.tostring(self._root, encoding="unicode") + "\n"
        return Conversion(text, tuple(self._remarks), is_mjcf=True)

    def _remark(self, text: str) -> None:
        self._remarks.append(f"{self._path}: {text}")

    def _refusal(self, text: str) -> UnusableInput:
        return UnusableInput(f"{self._path}: {text}")

    def _names(self, kind: Any, count: int, word: str) -> list[str]:
        """Names of objects; those without one are numbered."""
        stated = [self._mujoco.mj_id2name(self._model, kind, i) or "" for i in range(count)]
        names = []
        for i, name in enumerate(stated):
            unique = name or f"{word}_{i}"
            while not name and unique in stated:
                unique += "_"
            names.append(unique)
        return names

    def _robot_name(self) -> str:
        return str(self._specification.modelname) or self._path.stem

    # -- what a URDF cannot express ---------------------------------------------------------------

    def _require_no_loops(self) -> None:
        """Raise UnusableInput for ball joints and for constraints that close loops."""
        model, kinds = self._model, self._mujoco.mjtEq
        for joint in range(model.njnt):
            if model.jnt_type[joint] == self._mujoco.mjtJoint.mjJNT_BALL:
                raise self._refusal(
                    f"joint '{self._joints[joint]}' is a ball; only hinge and slide joints are "
                    "known, write it as three hinges"
                )
        for equality in range(model.neq):
            kind = model.eq_type[equality]
            if not model.eq_active0[equality] or kind == kinds.mjEQ_JOINT:
                continue
            name = self._mujoco.mj_id2name(
                model, self._mujoco.mjtObj.mjOBJ_EQUALITY, equality
            ) or str(equality)
            word = self._mujoco.mjtEq(kind).name.removeprefix("mjEQ_").lower()
            if int(kind) in (int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)):
                raise self._refusal(
                    f"the equality '{name}' ({word}) closes a loop; closed loops are not modelled, "
                    "remove it or the joints of the loop"
                )
            self._remark(f"the equality '{name}' ({word}) is ignored")

    def _couplings(self) -> dict[int, tuple[int, float, float]]:
        """Joints that follow another one: joint -> (joint that leads, multiplier, offset).

        MuJoCo couples differences from the reference positions (qpos0):
        q − q₀ = c₀ + c₁ (q_lead − q₀_lead) + c₂ (…)² + …
        """
        model, out = self._model, dict[int, tuple[int, float, float]]()
        for equality in range(model.neq):
            if (
                model.eq_type[equality] != self._mujoco.mjtEq.mjEQ_JOINT
                or not model.eq_active0[equality]
            ):
                continue
            joint, lead = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
            coefficients = model.eq_data[equality, :5]
            if lead < 0 or np.abs(coefficients[2:]).max() > COEFFICIENT_TOLERANCE:
                raise self._refusal(
                    f"joint '{self._joints[joint]}' is coupled by a polynomial of degree 2 or more "
                    "or to a constant; only q = a + b q_other is known"
                )
            reference = model.qpos0[model.jnt_qposadr]
            constant, factor = float(coefficients[0]), float(coefficients[1])
            out[joint] = lead, factor, float(reference[joint] + constant - factor * reference[lead])
        return out

    # -- joints -----------------------------------------------------------------------------------

    def _torque_limits(self) -> dict[int, float]:
        """Largest torque of each joint that has a limit, from its actuators and its own
        actuatorfrcrange [N m or N]."""
        model, out = self._model, dict[int, float]()
        for actuator in range(model.nu):
            if not self._drives_joint(actuator):
                continue
            force = self._actuator_force(actuator)
            if force is not None:
                joint = int(model.actuator_trnid[actuator, 0])
                torque = force * abs(float(model.actuator_gear[actuator, 0]))
                out[joint] = out.get(joint, 0.0) + torque
        for joint in range(model.njnt):
            if model.jnt_actfrclimited[joint]:
                limit = float(np.abs(model.jnt_actfrcrange[joint]).min())
                out[joint] = min(limit, out.get(joint, math.inf))
        return {joint: torque for joint, torque in out.items() if torque > 0.0}

    def _drives_joint(self, actuator: int) -> bool:
        kinds = self._mujoco.mjtTrn
        return int(self._model.actuator_trntype[actuator]) in (
            int(kinds.mjTRN_JOINT),
            int(kinds.mjTRN_JOINTINPARENT),
        )

    def _actuator_force(self, actuator: int) -> float | None:
        """Largest force of an actuator in both directions; None where it has no limit.

        A motor, whose gain is constant and whose bias is zero, is limited by its control too.
        """
        model = self._model
        limits = []
        if model.actuator_forcelimited[actuator]:
            limits.append(np.abs(model.actuator_forcerange[actuator]).min())
        is_motor = (
            model.actuator_gaintype[actuator] == self._mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[actuator] == self._mujoco.mjtBias.mjBIAS_NONE
            and model.actuator_dyntype[actuator] == self._mujoco.mjtDyn.mjDYN_NONE
        )
        if is_motor and model.actuator_ctrllimited[actuator]:
            gain = abs(float(model.actuator_gainprm[actuator, 0]))
            limits.append(gain * np.abs(model.actuator_ctrlrange[actuator]).min())
        return float(min(limits)) if limits else None

    def _add_joints(
        self, body: int, followers: dict[int, tuple[int, float, float]], torque: dict[int, float]
    ) -> None:
        """Append the joints between a body and its parent, a fixed one where there is none.

        MuJoCo applies the joints of a body one after the other to its pose, each about its anchor
        and from its reference position.
        """
        model, mujoco = self._model, self._mujoco
        parent = int(model.body_parentid[body])
        start = int(model.body_jntadr[body])
        joints = [
            joint
            for joint in range(start, start + int(model.body_jntnum[body]))
            if not self._is_free(joint)
        ]
        placement = pin.SE3(np.eye(3), -self._anchors[parent]) * _pose(
            model.body_pos[body], model.body_quat[body]
        )
        link = self._bodies[parent]
        if not joints:
            self._joint_element(
                self._unique(f"{self._bodies[body]}_fixed"),
                "fixed",
                link,
                self._bodies[body],
                placement,
            )
            return
        before = np.zeros(3)
        for joint in joints:
            anchor, axis = np.array(model.jnt_pos[joint]), np.array(model.jnt_axis[joint])
            slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            motion = axis * -reference
            back = pin.SE3(np.eye(3), motion) if slides else pin.SE3(pin.exp3(motion), np.zeros(3))
            placement = placement * pin.SE3(np.eye(3), anchor - before) * back
            is_last = joint == joints[-1]
            child = (
                self._bodies[body]
                if is_last
                else self._unique(f"{self._bodies[body]}_{self._joints[joint]}")
            )
            limited = bool(model.jnt_limited[joint])
            kind = "prismatic" if slides else "revolute" if limited else "continuous"
            element = self._joint_element(self._joints[joint], kind, link, child, placement)
            ElementTree.SubElement(element, "axis", xyz=_words(axis))
            self._add_limits(element, joint, torque)
            self._add_friction(element, joint)
            if joint in followers:
                lead, multiplier, offset = followers[joint]
                ElementTree.SubElement(
                    element,
                    "mimic",
                    joint=self._joints[lead],
                    multiplier=repr(multiplier),
                    offset=repr(offset),
                )
            if not is_last:
                ElementTree.SubElement(self._root, "link", name=child)
            link, placement, before = child, pin.SE3.Identity(), anchor
        self._anchors[body] = before

    def _is_free(self, joint: int) -> bool:
        """True for a free joint, with a remark."""
        if self._model.jnt_type[joint] != self._mujoco.mjtJoint.mjJNT_FREE:
            return False
        body = self._bodies[self._model.jnt_bodyid[joint]]
        self._remark(f"the free joint of '{body}' is held: its base is fixed where it begins")
        return True

    def _unique(self, name: str) -> str:
        """A name that no body and no joint has."""
        while name in self._bodies or name in self._joints:
            name += "_"
        return name

    def _joint_element(
        self, name: str, kind: str, parent: str, child: str, placement: pin.SE3
    ) -> ElementTree.Element:
        element = ElementTree.SubElement(self._root, "joint", name=name, type=kind)
        ElementTree.SubElement(element, "parent", link=parent)
        ElementTree.SubElement(element, "child", link=child)
        element.append(_origin(placement))
        return element

    def _add_limits(
        self, element: ElementTree.Element, joint: int, torque: dict[int, float]
    ) -> None:
        """Append position and torque limits; MJCF has none of velocity."""
        limits: dict[str, str] = {}
        if self._model.jnt_limited[joint]:
            lower, upper = (float(value) for value in self._model.jnt_range[joint])
            limits |= {"lower": repr(lower), "upper": repr(upper)}
        if joint in torque:
            limits["effort"] = repr(torque[joint])
        if limits:
            ElementTree.SubElement(element, "limit", limits)

    def _add_friction(self, element: ElementTree.Element, joint: int) -> None:
        """Append damping, friction and rotor inertia, those of the actuators included."""
        model = self._model
        degree = int(model.jnt_dofadr[joint])
        damping, armature = float(model.dof_damping[degree]), float(model.dof_armature[degree])
        for actuator in range(model.nu):
            if self._drives_joint(actuator) and model.actuator_trnid[actuator, 0] == joint:
                squared = float(model.actuator_gear[actuator, 0]) ** 2
                armature += squared * _optional(model, "actuator_armature", actuator)
                damping += squared * _optional(model, "actuator_damping", actuator)
        friction = float(model.dof_frictionloss[degree])
        if damping or friction:
            ElementTree.SubElement(
                element, "dynamics", damping=repr(damping), friction=repr(friction)
            )
        stiffness, extra = float(model.jnt_stiffness[joint]), dict[str, str]()
        if armature:
            extra["rotor_inertia"] = repr(armature)
        if 0.0 < stiffness <= OFFSET_STIFFNESS:
            position = float(model.qpos_spring[model.jnt_qposadr[joint]])
            extra["offset"] = repr(-stiffness * position)
        if extra:
            ElementTree.SubElement(element, "excite", extra)
        if np.any(_higher_powers(model, "dof_dampingpoly", degree)):
            self._remark(
                f"the damping of joint '{self._joints[joint]}' that grows with powers of the speed "
                "is not modelled"
            )
        if stiffness > OFFSET_STIFFNESS:
            self._remark(f"the spring of joint '{self._joints[joint]}' is not modelled")

    # -- links ------------------------------------------------------------------------------------

    def _add_link(self, body: int) -> None:
        """Append a link with its inertia and its collision shapes."""
        model = self._model
        element = ElementTree.SubElement(self._root, "link", name=self._bodies[body])
        shift = pin.SE3(np.eye(3), -self._anchors[body])
        mass = float(model.body_mass[body])
        if body and mass > 0.0:
            inertial = ElementTree.SubElement(element, "inertial")
            inertial.append(_origin(shift * _pose(model.body_ipos[body], model.body_iquat[body])))
            ElementTree.SubElement(inertial, "mass", value=repr(mass))
            xx, yy, zz = (repr(float(moment)) for moment in model.body_inertia[body])
            ElementTree.SubElement(
                inertial, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz
            )
        if model.body_gravcomp[body]:
            self._remark(f"the gravity compensation of body '{self._bodies[body]}' is ignored")
        start = int(model.body_geomadr[body])
        for geom in range(start, start + int(model.body_geomnum[body])):
            self._add_shape(element, geom, shift)

    def _add_shape(self, link: ElementTree.Element, geom: int, shift: pin.SE3) -> None:
        """Append the collision shape of a geom that can collide."""
        model, kinds = self._model, self._mujoco.mjtGeom
        if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            return
        kind = int(model.geom_type[geom])
        size = [float(value) for value in model.geom_size[geom]]
        name = self._mujoco.mj_id2name(model, self._mujoco.mjtObj.mjOBJ_GEOM, geom) or str(geom)
        if kind in (int(kinds.mjGEOM_PLANE), int(kinds.mjGEOM_HFIELD)):
            self._remark(
                f"the plane or height field '{name}' is left out; state a floor with --floor Z"
            )
            return
        placement = shift * _pose(model.geom_pos[geom], model.geom_quat[geom])
        tag, attributes = "box", dict[str, str]()
        if kind == int(kinds.mjGEOM_SPHERE):
            tag, attributes = "sphere", {"radius": repr(size[0])}
        elif kind in (int(kinds.mjGEOM_CAPSULE), int(kinds.mjGEOM_CYLINDER)):
            tag = "cylinder"
            attributes = {"radius": repr(size[0]), "length": repr(2.0 * size[1])}
        elif kind == int(kinds.mjGEOM_BOX):
            attributes = {"size": _words([2.0 * value for value in size])}
        elif kind == int(kinds.mjGEOM_MESH) and (mesh := self._mesh_file(geom)) is not None:
            file, scale, frame = mesh
            placement = placement * frame.inverse()
            tag, attributes = "mesh", {"filename": str(file), "scale": _words(scale)}
        else:
            box = model.geom_aabb[geom]
            placement = placement * pin.SE3(np.eye(3), np.array(box[:3]))
            attributes = {"size": _words([2.0 * float(value) for value in box[3:]])}
            self._remark(f"the shape '{name}' is replaced by the box around it")
        collision = ElementTree.SubElement(link, "collision", name=f"geom_{geom}")
        collision.append(_origin(placement, digits=SHAPE_DIGITS))
        ElementTree.SubElement(ElementTree.SubElement(collision, "geometry"), tag, attributes)
        if kind == int(kinds.mjGEOM_CAPSULE):
            checking = link.find("collision_checking")
            if checking is None:
                checking = ElementTree.SubElement(link, "collision_checking")
            ElementTree.SubElement(checking, "capsule", name=f"geom_{geom}")

    def _mesh_file(self, geom: int) -> tuple[Path, list[float], pin.SE3] | None:
        """File and scale of a geom's mesh, and the pose of MuJoCo's mesh frame in the file's; None
        where the mesh cannot be read from a file as it is."""
        model = self._model
        data = int(model.geom_dataid[geom])
        stated = self._specification.meshes[data]
        file = Path(str(stated.file))
        folder = Path(str(self._specification.meshdir or ""))
        candidates = [
            file,
            self._path.resolve().parent / folder / file,
            self._path.resolve().parent / file,
        ]
        existing = next(
            (path for path in candidates if path.is_absolute() and path.is_file()), None
        )
        moved = np.any(stated.refpos) or not np.allclose(stated.refquat, [1.0, 0.0, 0.0, 0.0])
        if existing is None or moved or existing.suffix.lower() not in MESH_FORMATS:
            return None
        frame = _pose(model.mesh_pos[data], model.mesh_quat[data])
        return existing, [float(value) for value in stated.scale], frame

    def _add_site(self, site: int) -> None:
        """Append a named site as a massless link, so that it can be named as a frame."""
        model = self._model
        name = self._mujoco.mj_id2name(model, self._mujoco.mjtObj.mjOBJ_SITE, site)
        if not name or name in self._bodies:
            return
        body = int(model.site_bodyid[site])
        ElementTree.SubElement(self._root, "link", name=name)
        placement = pin.SE3(np.eye(3), -self._anchors[body]) * _pose(
            model.site_pos[site], model.site_quat[site]
        )
        self._joint_element(
            self._unique(f"{name}_fixed"), "fixed", self._bodies[body], name, placement
        )


def _optional(model: Any, name: str, index: int) -> float:
    """An entry of an array that older versions of MuJoCo do not have; 0 there."""
    values = getattr(model, name, None)
    return 0.0 if values is None else float(values[index])


def _higher_powers(model: Any, name: str, index: int) -> FloatArray:
    """Coefficients of higher powers in an array that older versions of MuJoCo do not have; 0
    there."""
    values = getattr(model, name, None)
    return np.zeros(1) if values is None else np.array(values[index], float)


def _pose(position: FloatArray, quaternion: FloatArray) -> pin.SE3:
    """A pose from MuJoCo's position and quaternion (w, x, y, z)."""
    w, x, y, z = (float(value) for value in quaternion)
    rotation = pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()
    return pin.SE3(rotation, np.array(position, float))


def _origin(placement: pin.SE3, digits: int | None = None) -> ElementTree.Element:
    """An <origin>; with `digits` decimals where stated."""
    vectors: Iterator[Any] = iter((placement.translation, pin.rpy.matrixToRpy(placement.rotation)))
    xyz, rpy = (vector if digits is None else np.round(vector, digits) + 0.0 for vector in vectors)
    return ElementTree.Element("origin", xyz=_words(xyz), rpy=_words(rpy))


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
