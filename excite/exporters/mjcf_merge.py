"""Merge an identified robot into the user's own MJCF: only what was identified changes.

The file is edited as text: attributes of <joint> elements and the <inertial> elements of bodies.
Everything else, comments and formatting included, stays. Joints are matched by name. Frames of
bodies may differ from those of the identified links: both are compared at q = 0, where the joint
axes of both have to be the same lines, up to the place of the base.

A body with all that is fixed to it gets the identified inertia, its fixed parts none of their own;
what other joints move, such as the fingers of a gripper, keeps its inertia, which is subtracted.
"""

from __future__ import annotations

import dataclasses
import re
import xml.etree.ElementTree as ElementTree
import xml.parsers.expat
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .._system.comments import xml_comment
from .._types import FloatArray
from ..errors import UnusableInput
from ..robot import xml_file
from ..robot.inertial_parameters import pseudo_inertia
from ..robot.samples import Samples
from .mjcf_file import (
    HOLDS,
    JointAttributes,
    inertial_element,
    inverse_mass_diagonal,
    joint_attributes,
    offset_notes,
)
from .simulator_model import SimulatorModel

AXIS_TOLERANCE = 1e-3
"""Largest distance [m] and difference of direction [1] of axes that are the same."""
BASE_TURNS = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)
"""Turns of the base about the vertical that are tried [rad]."""
CHECK_STATES = 8
"""States at which the torque of the merged file is compared with the model."""
CHECK_TOLERANCE = 1e-6
"""Largest difference of torque there, over the largest torque."""
ATTRIBUTE = r"""\s+{name}\s*=\s*(?:"[^"]*"|'[^']*')"""
"""An attribute with its value and the space before it."""
ROOT = re.compile(r"<mujoco(?=[\s>/])")


@dataclass
class _Tag:
    """Place of a start tag in the text.

    Attributes:
        start: Index of its "<".
        end: Index after its ">".
    """

    start: int
    end: int


@dataclass
class _Body:
    """Place of a <body>: its start tag, and its <inertial> from "<" to after its end.

    Attributes:
        name: Its name; "" without one.
        tag: Its start tag.
        inertial: Its <inertial>; None without one.
    """

    name: str
    tag: _Tag
    inertial: _Tag | None = None


@dataclass
class _Places:
    """Where bodies and joints are in an MJCF.

    Attributes:
        bodies: Bodies in the order of the file, which is MuJoCo's.
        joints: Start tag of each named joint, with the number of its body.
        has_include: True if the file includes others.
    """

    bodies: list[_Body] = field(default_factory=list)
    joints: dict[str, tuple[_Tag, int]] = field(default_factory=dict)
    has_include: bool = False


def merged_mjcf(model: SimulatorModel, path: Path) -> str:
    """Return the text of the user's MJCF with the identified parameters.

    Args:
        model: The identified robot.
        path: The user's MJCF.

    Raises:
        UnusableInput: MuJoCo is not installed, the file cannot be compiled, or its joints are not
            those of the model.
    """
    if find_spec("mujoco") is None:
        raise UnusableInput(
            f"{path}: --into takes MuJoCo: .venv/bin/pip install -e '.[sim]', or leave --into out"
        )
    text = xml_file.read_text(path, "an MJCF")
    places = _places(path, text)
    compiled = _compiled(path, None)
    missing = [name for name in model.joints if name not in places.joints]
    if missing:
        place = "may be in an included file" if places.has_include else "is not in it"
        known = ", ".join(places.joints) or "none"
        raise UnusableInput(
            f"{path}: joint '{missing[0]}' of the model {place}; there are: {known}; rename it, or "
            "save the file in one piece"
        )
    merge = _Merge(model, path, compiled, places)
    out = merge.edited(text)
    merge.check(out)
    return out


def _compiled(path: Path, text: str | None) -> Any:
    """Compile an MJCF, or another text in its place."""
    import mujoco

    try:
        if text is None:
            return mujoco.MjModel.from_xml_path(str(path))
        spec = mujoco.MjSpec.from_string(text)
        spec.modelfiledir = str(path.resolve().parent)
        return spec.compile()
    except (ValueError, RuntimeError, OSError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split()) or "no reason given"
        raise UnusableInput(
            f"{path}: MuJoCo cannot compile it ({reason}); correct the file"
        ) from error


def _places(path: Path, text: str) -> _Places:
    """Find bodies, inertias and joints of the world in the text of an MJCF."""
    out, stack, open_bodies = _Places(), list[str](), list[int]()
    data = text.encode("utf-8")
    parser = xml.parsers.expat.ParserCreate("utf-8")

    def start(name: str, attributes: dict[str, str]) -> None:
        begin = len(data[: parser.CurrentByteIndex].decode("utf-8"))
        tag = _Tag(begin, _tag_end(text, begin))
        in_world = "worldbody" in stack
        stack.append(name)
        out.has_include |= name == "include"
        if not in_world:
            return
        if name == "body":
            open_bodies.append(len(out.bodies))
            out.bodies.append(_Body(attributes.get("name", ""), tag))
        elif name == "joint" and open_bodies and "name" in attributes:
            out.joints[attributes["name"]] = (tag, open_bodies[-1])
        elif name == "inertial" and open_bodies:
            if not text[tag.start : tag.end].endswith("/>"):
                tag.end = text.index("</inertial", tag.end)
                tag.end = text.index(">", tag.end) + 1
            out.bodies[open_bodies[-1]].inertial = tag

    def end(name: str) -> None:
        stack.pop()
        if name == "body" and "worldbody" in stack:
            open_bodies.pop()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    declared = re.sub(r'(<\?xml[^>]*?)\sencoding\s*=\s*["\'][^"\']*["\']', r"\1", text, count=1)
    if declared != text:
        text = declared
        data = text.encode("utf-8")
    try:
        parser.Parse(data, True)
    except xml.parsers.expat.ExpatError as error:
        raise UnusableInput(f"{path}: is not valid XML ({error}); repair the file") from error
    return out


def _tag_end(text: str, start: int) -> int:
    """Index after the ">" of the tag that begins at `start`."""
    match = re.compile(r"""<(?:[^<>"']|"[^"]*"|'[^']*')*>""").match(text, start)
    return start if match is None else match.end()


class _Merge:
    """The merge of one model into one compiled file."""

    def __init__(self, model: SimulatorModel, path: Path, compiled: Any, places: _Places) -> None:
        import mujoco

        self._model, self._path, self._compiled, self._places = model, path, compiled, places
        self._mujoco = mujoco
        self._data = mujoco.MjData(compiled)
        if compiled.nbody - 1 != len(places.bodies):
            raise UnusableInput(
                f"{path}: has {len(places.bodies)} bodies but {compiled.nbody - 1} once compiled "
                "(includes, replicas or attachments); save it in one piece, as MuJoCo's "
                "'mj_saveLastXML' does"
            )
        self._joints = {name: self._joint(name) for name in model.joints}
        for name, (_, body) in places.joints.items():
            if name in self._joints and self._body(name) != body + 1:
                raise UnusableInput(f"{path}: joint '{name}' is attached by a macro; expand it")

    def _joint(self, name: str) -> int:
        """Number of a joint in the compiled model."""
        number = self._mujoco.mj_name2id(self._compiled, self._mujoco.mjtObj.mjOBJ_JOINT, name)
        kinds = (self._mujoco.mjtJoint.mjJNT_HINGE, self._mujoco.mjtJoint.mjJNT_SLIDE)
        if self._compiled.jnt_type[number] not in [int(kind) for kind in kinds]:
            raise UnusableInput(f"{self._path}: joint '{name}' is neither a hinge nor a slide")
        return int(number)

    def _body(self, joint: str) -> int:
        """Number of the body that a joint moves."""
        return int(self._compiled.jnt_bodyid[self._joints[joint]])

    def edited(self, text: str) -> str:
        """Return the text with the identified attributes and inertias."""
        edits = [*self._joint_edits(text), *self._inertia_edits(text)]
        for start, end, new in sorted(edits, key=lambda edit: -edit[0]):
            text = text[:start] + new + text[end:]
        lines = [*self._model.header("MJCF", HOLDS), *offset_notes(self._model)]
        header = xml_comment(f"  {line}" for line in lines)
        match = ROOT.search(xml_file.COMMENT.sub(lambda m: " " * len(m[0]), text))
        assert match is not None  # it has been compiled
        return f"{text[: match.start()]}{header}\n{text[match.start() :]}"

    def _joint_edits(self, text: str) -> Iterator[tuple[int, int, str]]:
        """Yield the edits of joint tags: start, end, new text."""
        inverse = self._inverse_mass()
        timestep = float(self._compiled.opt.timestep)
        for name, attributes in joint_attributes(self._model, inverse, timestep).items():
            tag, _ = self._places.joints[name]
            stated = text[tag.start : tag.end]
            yield tag.start, tag.end, self._with_attributes(stated, name, attributes)

    def _with_attributes(self, tag: str, joint: str, attributes: JointAttributes) -> str:
        """A joint's start tag with other attributes."""
        number, degrees = self._joints[joint], not self._uses_radians()
        values = dict(attributes.values)
        if values["stiffness"] is None and np.any(self._compiled.jnt_stiffness[number]):
            values |= {"stiffness": "0"}
        reference = values.get("springref")
        is_hinge = self._compiled.jnt_type[number] == self._mujoco.mjtJoint.mjJNT_HINGE
        if reference is not None and degrees and is_hinge:
            values["springref"] = repr(float(np.rad2deg(float(reference))))
        close = "/>" if tag.endswith("/>") else ">"
        body = tag[: -len(close)].rstrip()
        for key, value in values.items():
            pattern = re.compile(ATTRIBUTE.format(name=key))
            if value is None:
                continue
            new = f' {key}="{value}"'
            body = pattern.sub(new, body) if pattern.search(body) else body + new
        return body + tag[len(tag[: -len(close)].rstrip()) :]

    def _uses_radians(self) -> bool:
        """True if the file states angles in radians."""
        specification = self._mujoco.MjSpec.from_file(str(self._path))
        return not bool(specification.compiler.degree)

    def _inverse_mass(self) -> dict[str, float]:
        """(M⁻¹)ⱼⱼ of each joint at q = 0, with the identified inertias."""
        return inverse_mass_diagonal(self._model)

    # -- inertias ---------------------------------------------------------------------------------

    def _inertia_edits(self, text: str) -> Iterator[tuple[int, int, str]]:
        """Yield the edits of inertias: start, end, new text."""
        moved = {self._body(name): name for name in self._joints}
        if len(moved) < len(self._joints):
            raise UnusableInput(
                f"{self._path}: a body has several joints of the model; give each its own body"
            )
        frames = self._link_frames()
        names = list(self._model.model.robot.model.names)[1:]
        for body, name in moved.items():
            inertia = frames[name].act(self._model.link_inertia(names.index(name)))
            fixed = list[int]()
            phi = inertia.toDynamicParameters() - self._carried(body, set(moved), fixed)
            if np.linalg.eigvalsh(pseudo_inertia(phi))[0] <= 0.0:
                raise UnusableInput(
                    f"{self._path}: body '{self._places.bodies[body - 1].name}': what other joints "
                    "move on it is heavier than the identified link; give the inertias of those "
                    "bodies, or identify with these joints"
                )
            yield self._inertial_edit(text, body, pin.Inertia.FromDynamicParameters(phi))
            for part in fixed:
                if self._compiled.body_mass[part]:
                    yield self._inertial_edit(text, part, None)

    def _inertial_edit(
        self, text: str, body: int, inertia: pin.Inertia | None
    ) -> tuple[int, int, str]:
        """The edit that gives a body an inertia, None: none."""
        element = (
            ElementTree.Element("inertial", pos="0 0 0", mass="0", diaginertia="0 0 0")
            if inertia is None
            else inertial_element(inertia)
        )
        new = ElementTree.tostring(element, encoding="unicode")
        place = self._places.bodies[body - 1]
        if place.inertial is not None:
            return place.inertial.start, place.inertial.end, new
        if text[: place.tag.end].endswith("/>"):
            return place.tag.end - 2, place.tag.end, f">{new}</body>"
        line = text[text.rfind("\n", 0, place.tag.start) + 1 : place.tag.start]
        indent = line if not line.strip() else ""
        return place.tag.end, place.tag.end, f"\n{indent}  {new}"

    def _carried(self, body: int, moved: set[int], fixed: list[int]) -> FloatArray:
        """Inertial parameters of what other joints move on a body, in its frame; appends the
        bodies that are fixed to it to `fixed`. Shape (10,)."""
        total, model = np.zeros(10), self._compiled
        frame = self._pose(body)
        is_rigid = {body: True}
        for child in range(body + 1, model.nbody):
            parent = int(model.body_parentid[child])
            if parent not in is_rigid or child in moved:
                continue
            is_rigid[child] = is_rigid[parent] and not model.body_jntnum[child]
            if is_rigid[child]:
                fixed.append(child)
                continue
            place = frame.actInv(self._pose(child)) * pin.SE3(
                pin.Quaternion(*_wxyz(model.body_iquat[child])).toRotationMatrix(),
                np.array(model.body_ipos[child]),
            )
            inertia = pin.Inertia(
                float(model.body_mass[child]), np.zeros(3), np.diag(model.body_inertia[child])
            )
            total += place.act(inertia).toDynamicParameters()
        return total

    def _pose(self, body: int) -> pin.SE3:
        """Pose of a body in the world at q = 0."""
        return pin.SE3(
            np.array(self._data.xmat[body]).reshape(3, 3), np.array(self._data.xpos[body])
        )

    def _link_frames(self) -> dict[str, pin.SE3]:
        """Pose of each identified link in the frame of its body, by joint."""
        model, data, robot = self._compiled, self._data, self._model.model.robot
        data.qpos[:] = model.qpos0
        for joint in range(model.njnt):
            if model.jnt_type[joint] in (2, 3):  # slide, hinge
                data.qpos[model.jnt_qposadr[joint]] = 0.0
        self._mujoco.mj_kinematics(model, data)
        zero = robot.model.createData()
        pin.forwardKinematics(robot.model, zero, robot.expand(np.zeros(robot.n)))
        names, axes = list(robot.model.names)[1:], robot.axes()
        ours, theirs = [], []
        for name, number in self._joints.items():
            i = names.index(name)
            pose, axis = zero.oMi[i + 1], axes[i]
            slides = bool(np.linalg.norm(axis[:3]) > 0.5)
            direction = pose.rotation @ (axis[:3] if slides else axis[3:])
            ours.append((pose.translation.copy(), direction, slides))
            theirs.append((np.array(data.xanchor[number]), np.array(data.xaxis[number])))
        base = self._base(ours, theirs)
        return {
            name: self._pose(self._body(name)).actInv(base * zero.oMi[names.index(name) + 1])
            for name in self._joints
        }

    def _base(
        self,
        ours: list[tuple[FloatArray, FloatArray, bool]],
        theirs: list[tuple[FloatArray, FloatArray]],
    ) -> pin.SE3:
        """Pose of the identified robot's base in the file's world.

        Raises:
            UnusableInput: At q = 0 an axis is another line than the model's.
        """
        best: tuple[float, int, pin.SE3] | None = None
        still = np.zeros((3, 3))
        for turn in BASE_TURNS:
            R = pin.exp3(np.array([0.0, 0.0, turn]))
            rows, right = [], []
            for (p, u, slides), (m, _) in zip(ours, theirs, strict=True):
                if not slides:  # the place of a sliding axis does not matter
                    across = np.eye(3) - np.outer(R @ u, R @ u)
                    rows.append(across)
                    right.append(across @ (m - R @ p))
            left, wanted = np.vstack([*rows, still]), np.concatenate([*right, still[0]])
            t = np.linalg.lstsq(left, wanted, rcond=1e-9)[0]
            errors = [
                max(
                    float(np.linalg.norm(R @ u - a)),
                    0.0 if slides else float(np.linalg.norm(np.cross(R @ u, m - R @ p - t))),
                )
                for (p, u, slides), (m, a) in zip(ours, theirs, strict=True)
            ]
            worst = int(np.argmax(errors))
            if best is None or errors[worst] < best[0]:
                best = errors[worst], worst, pin.SE3(R, t)
        assert best is not None
        if best[0] > AXIS_TOLERANCE:
            joint = list(self._joints)[best[1]]
            raise UnusableInput(
                f"{self._path}: joint '{joint}': at q = 0 its axis differs from the model's by "
                f"{best[0]:.2g} (m or 1); --into takes the same robot with the same zero pose"
            )
        return best[2]

    # -- check ------------------------------------------------------------------------------------

    def check(self, text: str) -> None:
        """Compare the torque of the merged file with the model's at random states, at rest.

        Raises:
            UnusableInput: They differ: a setting of the file's <compiler> overrides the inertias.
        """
        mujoco, model = self._mujoco, _compiled(self._path, text)
        data, n = mujoco.MjData(model), self._model.model.robot.n
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        gravity = np.array(self._model.model.robot.model.gravity.linear)
        model.opt.gravity[:] = gravity
        rng = np.random.default_rng(0)
        q, a = rng.uniform(-1.0, 1.0, (2, CHECK_STATES, n))
        still = np.zeros_like(q)
        joints = [
            mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in self._joints
        ]
        positions, degrees = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        others = [k for k in range(model.nv) if k not in set(degrees.tolist())]
        if others:
            return  # what other joints move is not rigid in the file
        expected = _torque(self._model, Samples(q, still, a))
        torque = np.empty_like(expected)
        for k in range(CHECK_STATES):
            data.qpos[positions], data.qvel[:], data.qacc[degrees] = q[k], 0.0, a[k]
            mujoco.mj_inverse(model, data)
            torque[k] = data.qfrc_inverse[degrees]
        error = np.abs(torque - expected).max(axis=0)
        worst = int(np.argmax(error))
        if error[worst] > CHECK_TOLERANCE * max(1.0, float(np.abs(expected).max())):
            raise UnusableInput(
                f"{self._path}: joint '{self._model.joints[worst]}': the merged file's torque "
                f"differs by {error[worst]:.3g} N m; a setting of its <compiler> (inertiafromgeom, "
                "settotalmass, boundmass, balanceinertia) overrides inertias: remove it"
            )


def _torque(model: SimulatorModel, motion: Samples) -> FloatArray:
    """Torque of an identified robot at rest: no friction. Shape (N, n) [N m]."""
    base = dataclasses.replace(model.model, psi=model.psi)
    powers = motion.q[..., None] ** np.arange(4)
    extra = np.einsum("tjk,jk->tj", powers, model.torques.spring)
    layout = base.layout
    if "offset" in base.drive:
        extra -= base.psi[layout.block("offset")]
    inertia = model.torques.rotor_inertia
    if "rotor_inertia" in base.drive:
        inertia = inertia - base.psi[layout.block("rotor_inertia")]
    return base.torque(motion, motion.dq) + extra + inertia * motion.ddq


def _wxyz(quaternion: FloatArray) -> tuple[float, float, float, float]:
    """MuJoCo's quaternion as arguments of pin.Quaternion, (w, x, y, z)."""
    w, x, y, z = (float(value) for value in quaternion)
    return w, x, y, z
