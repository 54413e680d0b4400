"""The robot: a Pinocchio model whose coordinates are the joints to be moved, one number each."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .. import physical_ranges as ranges
from .._system.one_or_several import one_or_several
from .._types import FloatArray
from ..errors import ExciteWarning, UnusableInput, UnusableRobot
from . import exact_placement, urdf
from .link_inertia import LinkInertia, impossible_moments

GRAVITY = (0.0, 0.0, -9.81)
LIMIT_ROUNDING = 1e-4
"""Distance by which a locked joint may be beyond its position limits [rad or m]: URDFs round a
right angle to four decimals."""
FLOATING_BASE = "excite_floating_base"
"""Name of the free flyer in the models of `free_flyer_models`."""


@dataclass(frozen=True)
class Payload:
    """A body rigidly attached to a link, in the link's frame.

    Attributes:
        link: Name of the link.
        mass: Mass [kg].
        centre: Centre of mass. Shape (3,) [m].
        inertia: Moments about the centre of mass, xx, xy, yy, xz, yz, zz [kg m²].
    """

    link: str
    mass: float
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float, float, float, float] = (0.0,) * 6


@dataclass(frozen=True)
class Follower:
    """A mimic joint that moves with a moving joint: q = multiplier q_master + offset."""

    entry: urdf.JointEntry
    master: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class LockedJoint:
    """A joint that does not move.

    Attributes:
        name: Name of the joint.
        position: Position at which it is locked [rad or m].
        unit: Unit of the position, "rad" or "m".
        share: Mass that it carries over that of all bodies which the joints of the robot carry [1].
    """

    name: str
    position: float
    unit: str
    share: float = 1.0


@dataclass(frozen=True)
class Robot:
    """A robot as designed for, identified and verified: n moving joints, all else locked.

    Attributes:
        name: Name of the robot.
        source: Path of its file, or name of the built-in model.
        sha256: Digest of the file.
        model: Pinocchio model with nq = nv ≥ n (a mimic joint is a coordinate of its own there).
        joints: Names of the n moving joints, in the model's order.
        spread: q_model = spread q + shift; τ = spreadᵀ τ_model. Shape (nv, n).
        shift: See `spread`. Shape (nv,).
        entries: Each moving joint as the URDF states it.
        links: Name of the link that each of the model's nv joints moves.
        structure: The model with exact placements; see `exact_placement`.
        rounded: Names of the model's joints whose placement differs between model and structure.
        inertia_faults: For each moving link whose inertia no body of the robot can have, a
            sentence.
        placeholders: Names of the moving links whose inertia is the identity matrix.
        followers: The mimic joints that move with the moving joints.
        mimics: Names of all mimic joints, moving or not.
        locked: The joints that do not move, without mimic joints.
        all_joints: Names of the moving and the locked joints, in the order of the file's model.
        options: How it was loaded (locked joints, payload, gravity, inertias), enough to load it
            again.
        is_mjcf: True if its file is an MJCF.
    """

    name: str
    source: str
    sha256: str
    model: pin.Model
    joints: tuple[str, ...]
    spread: FloatArray
    shift: FloatArray
    entries: tuple[urdf.JointEntry, ...]
    links: tuple[str, ...]
    structure: pin.Model
    rounded: tuple[str, ...] = ()
    inertia_faults: tuple[str, ...] = ()
    placeholders: tuple[str, ...] = ()
    followers: tuple[Follower, ...] = ()
    mimics: tuple[str, ...] = ()
    locked: tuple[LockedJoint, ...] = ()
    all_joints: tuple[str, ...] = ()
    options: Mapping[str, object] = field(default_factory=dict)
    is_mjcf: bool = False

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return len(self.joints)

    @property
    def mass(self) -> float:
        """Mass of all bodies, the base link included [kg]."""
        return float(sum(inertia.mass for inertia in self.model.inertias))

    @property
    def weight(self) -> float:
        """Weight of all bodies, the base link included [N]."""
        return self.mass * float(np.linalg.norm(self.model.gravity.linear))

    def with_exact_placements(self) -> Robot:
        """The robot whose rounded right angles are exact, for what depends on its structure."""
        return dataclasses.replace(self, model=self.structure)

    def index(self, joint: str) -> int:
        """Position of a moving joint's name; UnusableInput lists the names there are."""
        if joint not in self.joints:
            raise UnusableInput(
                f"{self.source}: no moving joint '{joint}'; there are: {', '.join(self.joints)}"
            )
        return self.joints.index(joint)

    def body_of(self, joint: int) -> int:
        """Return the number in the Pinocchio model of the first body that a joint moves.

        Args:
            joint: Index of the joint; mimic joints have none.
        """
        return int(np.flatnonzero(self.spread[:, joint])[0]) + 1

    def document(self) -> dict[str, Any]:
        """Return the robot's entry in a file, from which it is found from any folder."""
        is_builtin = self.source in builtin_names()
        source = self.source if is_builtin else str(Path(self.source).resolve())
        return {"name": self.name, "source": source, "sha256": self.sha256, **self.options}

    def command_options(self) -> list[str]:
        """Return the options with which a command loads this robot from its source."""
        stated: Mapping[str, Any] = self.options
        locked, payload = stated.get("locked"), stated.get("payload")
        words = []
        if locked:
            words.append(f"--joints={','.join(self.joints)}")
            words += [f"--lock={joint}={value}" for joint, value in locked.items()]
        if payload is not None:
            numbers = (payload["mass"], *payload["centre"], *payload["inertia"])
            words.append(f"--payload={payload['link']}:{','.join(map(str, numbers))}")
        gravity = tuple(stated.get("gravity", GRAVITY))
        if gravity != GRAVITY:
            words.append(f"--gravity={','.join(map(str, gravity))}")
        if "inertias" in stated:
            words.append("--mass=KG")
        return words

    def expand(self, q: FloatArray) -> FloatArray:
        """Coordinates of the Pinocchio model for joint positions. Shapes (…, n) -> (…, nv) [rad or
        m]."""
        return q @ self.spread.T + self.shift

    def axes(self) -> list[FloatArray]:
        """Unit motion subspace of each model joint, (linear, angular), joint frame. nv arrays of
        shape (6,)."""
        return _axes(self.model)

    def frame(self, name: str) -> int:
        """Index of a link's frame, else a joint's; UnusableInput names the ones nearest in
        spelling."""
        if self.model.existFrame(name, pin.FrameType.BODY):  # a joint may have the same name
            return int(self.model.getFrameId(name, pin.FrameType.BODY))
        if not self.model.existFrame(name):
            from difflib import get_close_matches

            known = [frame.name for frame in self.model.frames]
            near = get_close_matches(name, known, 3) or known[-3:]
            raise UnusableInput(
                f"{self.source}: no frame '{name}'; did you mean {', '.join(near)}?"
            )
        return int(self.model.getFrameId(name))

    def carrying_body(self, name: str, option: str) -> tuple[int, pin.SE3]:
        """Return the index of the body that carries a link, and the link's pose in its joint frame.

        Args:
            name: Name of a link, or of a frame that is fixed to one.
            option: Command-line option that names it.

        Raises:
            UnusableInput: There is no such link, or it does not move.
        """
        frame = self.model.frames[self.frame(name)]
        if int(frame.parentJoint) == 0:
            raise UnusableInput(
                f"{option} {name}: does not move; name a moving link of {self.source}"
            )
        return int(frame.parentJoint) - 1, frame.placement


def builtin_names() -> tuple[str, ...]:
    """Names of the models that come with the package."""
    folder = resources.files("excite.robot") / "models"
    return tuple(sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".urdf")))


def locate(source: str) -> Path:
    """Path of a URDF: `source` itself, or the built-in model of that name."""
    if source in builtin_names():
        return Path(str(resources.files("excite.robot") / "models" / f"{source}.urdf"))
    path = Path(source)
    if not os.path.isfile(path) and path.suffix == "" and "/" not in source:
        raise UnusableInput(
            f"{source}: neither a file nor a built-in model ({', '.join(builtin_names())})"
        )
    return path


def load(
    source: str,
    *,
    joints: str | Sequence[str] | None = None,
    lock: Mapping[str, float] | None = None,
    payload: Payload | None = None,
    gravity: Sequence[float] = GRAVITY,
    inertias: Mapping[str, LinkInertia] | None = None,
    require_mass: bool = True,
) -> Robot:
    """Load a robot from a URDF path or a built-in name.

    Args:
        source: The path or the name.
        joints: The joints that move (all that are not mimics, when None); the others are locked.
        lock: Positions [rad or m] of locked joints; a joint named here doesn't move. Elsewhere 0,
            moved inside its limits.
        payload: A body added to a link before anything else is computed.
        gravity: Shape (3,) [m/s²], base frame.
        inertias: Inertia of links that state none.
        require_mass: Whether every joint has to move a mass.

    Raises:
        UnusableInput: The file cannot be used, a joint is unknown, moves no mass, or is locked
            outside its position limits.
    """
    path = locate(source)
    document = urdf.read(path)
    for remark in document.remarks:
        warnings.warn(remark, ExciteWarning, stacklevel=2)
    if inertias:
        document = dataclasses.replace(document, inertias={**inertias, **document.inertias})
    _require_gravity(document.source, gravity)
    full = _parse(document, document.text())
    lock = dict(lock or {})
    moving = _moving(document, full, joints, lock)
    kept, multipliers = _followers(document, moving)
    reference = _rest_positions(document, full, lock)
    links = {document.alias(link): link for link in document.links}
    model = _reduced(full, kept, reference, gravity, links)
    structure, rounded = model, tuple[str, ...]()
    if document.rounded:
        exact = _parse(document, document.text(exact=True))
        turned = np.array([exact_placement.exact_angle(float(angle)) for angle in reference])
        structure = _reduced(exact, kept, turned, gravity, links)
        rounded = _moved_joints(model, structure)
    inertia_faults = _inertia_faults(document, model)
    if payload is not None:
        _attach(model, document.source, payload)
    order = [name for name in model.names[1:] if name in moving]
    carried = full.createData()
    pin.computeSubtreeMasses(full, carried)
    locked = tuple(
        LockedJoint(
            str(name),
            float(reference[full.joints[full.getJointId(name)].idx_q]),
            document.joints[name].unit("rad"),
            float(carried.mass[full.getJointId(name)]) / max(float(carried.mass[0]), 1e-300),
        )
        for name in full.names[1:]
        if name not in kept and document.joints[name].mimic is None
    )
    spread, shift = np.zeros((model.nv, len(order))), np.zeros(model.nv)
    for row, name in enumerate(model.names[1:]):
        master, multiplier, offset = multipliers[name]
        spread[row, order.index(master)], shift[row] = multiplier, offset
    robot = Robot(
        name=source if source in builtin_names() else document.name,
        source=document.source if source not in builtin_names() else source,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        model=model,
        structure=structure,
        rounded=rounded,
        inertia_faults=inertia_faults,
        placeholders=_placeholders(document, model),
        joints=tuple(order),
        spread=_frozen(spread),
        shift=_frozen(shift),
        entries=tuple(document.joints[name] for name in order),
        mimics=tuple(name for name, entry in document.joints.items() if entry.mimic is not None),
        followers=tuple(
            Follower(document.joints[name], *multipliers[name])
            for name in model.names[1:]
            if name not in moving
        ),
        links=tuple(document.joints[name].child for name in model.names[1:]),
        locked=locked,
        all_joints=tuple(
            str(name) for name in full.names[1:] if document.joints[name].mimic is None
        ),
        options={
            "locked": {joint.name: joint.position for joint in locked},
            "payload": None if payload is None else vars(payload) | {},
            "gravity": [float(g) for g in gravity],
            **({"inertias": _inertia_document(inertias)} if inertias else {}),
        },
        is_mjcf=document.is_mjcf,
    )
    faults = mass_faults(robot) if require_mass else []
    if faults:
        raise UnusableRobot([f"{robot.source}: {fault}" for fault in faults])
    return robot


def _require_gravity(source: str, gravity: Sequence[float]) -> None:
    if len(gravity) != 3 or not np.isfinite(gravity).all():
        stated = ",".join(f"{value:g}" for value in gravity)
        raise UnusableInput(f"{source}: --gravity {stated}: should be three numbers [m/s²]")


def free_flyer_models(robot: Robot) -> tuple[pin.Model, pin.Model]:
    """Return models of a robot whose base moves freely: as its file states, and with exact
    placements.

    The first joint, FLOATING_BASE, is a free flyer (nq = 7 + nv of the robot's joints).

    Args:
        robot: The robot; its locked joints, gravity, payload and inertias apply.

    Raises:
        UnusableInput: Its file cannot be read any more.
    """
    document = urdf.read(locate(robot.source))
    options: Mapping[str, Any] = robot.options
    stated = options.get("inertias")
    if isinstance(stated, Mapping):
        inertias = {**inertias_of_document(stated), **document.inertias}
        document = dataclasses.replace(document, inertias=inertias)
    links = {document.alias(link): link for link in document.links}
    models = []
    for exact in (False, True) if document.rounded else (False,):
        full = _parse(document, document.text(exact=exact), free_flyer=True)
        reference = pin.neutral(full)
        moving = {FLOATING_BASE, *robot.model.names[1:]}
        for name in full.names[2:]:
            master, multiplier, offset = _resolve(document, name)
            value = multiplier * float(options["locked"].get(master, 0.0)) + offset
            if name not in moving:
                angle = exact_placement.exact_angle(value) if exact else value
                reference[full.joints[full.getJointId(name)].idx_q] = angle
        models.append(_reduced(full, moving, reference, options["gravity"], links))
    payload = options.get("payload")
    if isinstance(payload, Mapping):
        for model in models:
            _attach(model, document.source, Payload(**payload))
    return models[0], models[-1]


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array


def _reduced(
    full: pin.Model,
    kept: set[str],
    reference: FloatArray,
    gravity: Sequence[float],
    links: Mapping[str, str],
) -> pin.Model:
    """The model in which all joints but the kept ones are fixed at their reference positions.

    Args:
        full: The model of all joints.
        kept: Names of the joints that move.
        reference: Positions of all joints. Shape (nq,) [rad or m].
        gravity: Gravity in the base frame. Shape (3,) [m/s²].
        links: Names of links whose frame has an alias, by the alias.
    """
    frozen = [full.getJointId(name) for name in full.names[1:] if name not in kept]
    model = pin.buildReducedModel(full, frozen, reference) if frozen else full
    model.gravity.linear = np.asarray(gravity, float)
    aliases = {link: alias for alias, link in links.items()}
    for frame in model.frames:  # a joint's frame of the same name takes the alias
        names = links if frame.type == pin.FrameType.BODY else aliases
        frame.name = names.get(frame.name, frame.name)
    return model


def _moved_joints(model: pin.Model, other: pin.Model) -> tuple[str, ...]:
    """Names of the joints whose placement or axis differs between two models of one robot."""
    tolerance = exact_placement.PRINTING_ERROR
    axes = zip(_axes(model), _axes(other), strict=True)
    return tuple(
        str(model.names[i])
        for i, (axis, other_axis) in enumerate(axes, start=1)
        if np.max(np.abs(axis - other_axis)) > tolerance
        or not model.jointPlacements[i].isApprox(other.jointPlacements[i], tolerance)
    )


def _axes(model: pin.Model) -> list[FloatArray]:
    """Unit motion subspace of each joint, (linear, angular), joint frame. Shape (6,) each."""
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nv))
    before = [data.liMi[i].copy() for i in range(1, model.njoints)]
    pin.forwardKinematics(model, data, np.ones(model.nv))
    return [pin.log6(a.actInv(data.liMi[i])).vector for i, a in enumerate(before, start=1)]


def _parse(document: urdf.Urdf, text: str, *, free_flyer: bool = False) -> pin.Model:
    try:
        if free_flyer:
            return pin.buildModelFromXML(text, pin.JointModelFreeFlyer(), FLOATING_BASE)
        return pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no kinematic tree"
        raise UnusableInput(
            f"{document.source}: is no kinematic tree ({reason}); check its joints and links"
        ) from error


def _moving(
    document: urdf.Urdf, full: pin.Model, joints: str | Sequence[str] | None, lock: dict[str, float]
) -> set[str]:
    free = [name for name in full.names[1:] if document.joints[name].mimic is None]
    if not free:
        raise UnusableInput(
            f"{document.source}: has no movable joint; excite needs at least one revolute or "
            "prismatic joint"
        )
    wanted = (
        list(one_or_several(joints))
        if joints is not None
        else [name for name in free if name not in lock]
    )
    for name in [*wanted, *lock]:
        if name not in document.joints:
            raise UnusableInput(
                f"{document.source}: no joint '{name}'; there are: {', '.join(free)}"
            )
        mimic = document.joints[name].mimic
        if mimic is not None:
            raise UnusableInput(
                f"{document.source}: joint '{name}' mimics '{mimic[0]}'; name that one instead"
            )
    both = set(wanted) & set(lock)
    if both:
        raise UnusableInput(
            f"{document.source}: joint '{min(both)}' is both in --joints and in --lock; drop one"
        )
    for name, value in lock.items():
        if not ranges.POSITION.accepts(value):
            raise UnusableInput(
                f"{document.source}: --lock {name}={value:g}: the position should be "
                f"{ranges.POSITION}"
            )
    if not wanted:
        raise UnusableInput(f"{document.source}: every joint is locked; leave at least one to move")
    return set(wanted)


def _resolve(document: urdf.Urdf, name: str) -> tuple[str, float, float]:
    """Master joint, multiplier and offset of a joint, through chains of mimics."""
    first, multiplier, offset, seen = name, 1.0, 0.0, {name}
    while (mimic := document.joints[name].mimic) is not None:
        name, factor, constant = mimic
        if name in seen or name not in document.joints:
            known = {joint.name for joint in document.placements}
            reason = (
                "itself"
                if name == first
                else f"'{name}', which follows it"
                if name in seen
                else f"'{name}', which is fixed"
                if name in known
                else f"'{name}', which the robot does not have"
            )
            raise UnusableInput(
                f"{document.source}: mimic joint '{first}' follows {reason}; correct its <mimic> "
                "or make it a fixed joint"
            )
        seen.add(name)
        offset, multiplier = offset + multiplier * constant, multiplier * factor
    if not (ranges.MIMIC_MULTIPLIER.accepts(multiplier) and ranges.POSITION.accepts(offset)):
        raise UnusableInput(
            f"{document.source}: mimic joint '{first}' is at {multiplier:g} times '{name}' plus "
            f"{offset:g}; the multiplier should be "
            f"{ranges.MIMIC_MULTIPLIER}, the offset {ranges.POSITION}; correct the multipliers and "
            "offsets of its chain of mimics"
        )
    return name, multiplier, offset


def _followers(
    document: urdf.Urdf, moving: set[str]
) -> tuple[set[str], dict[str, tuple[str, float, float]]]:
    resolved = {name: _resolve(document, name) for name in document.joints}
    return {name for name, (master, _, _) in resolved.items() if master in moving}, resolved


def _rest_positions(document: urdf.Urdf, full: pin.Model, lock: dict[str, float]) -> FloatArray:
    reference = np.zeros(full.nq)
    for name in full.names[1:]:
        master, multiplier, offset = _resolve(document, name)
        lower, upper = document.joints[master].position or (-np.inf, np.inf)
        value = lock.get(master, float(np.clip(0.0, lower, upper)))
        if not lower - LIMIT_ROUNDING <= value <= upper + LIMIT_ROUNDING:
            raise UnusableInput(
                f"{document.source}: --lock {master}={value:g}: the position should be within the "
                f"limits of the joint, {lower:g} to {upper:g}"
            )
        reference[full.joints[full.getJointId(name)].idx_q] = multiplier * value + offset
    return reference


def _attach(model: pin.Model, source: str, payload: Payload) -> None:
    stated = {"mass": (payload.mass,), "centre": payload.centre, "inertia": payload.inertia}
    accepted = {"mass": ranges.MASS, "centre": ranges.LENGTH, "inertia": ranges.INERTIA}
    for quantity, values in stated.items():
        for value in values:
            if not accepted[quantity].accepts(value):
                raise UnusableInput(
                    f"{source}: --payload at '{payload.link}': its {quantity} {value:g} should be "
                    f"{accepted[quantity]}"
                )
    if payload.mass == 0.0:
        raise UnusableInput(f"{source}: --payload at '{payload.link}' needs a positive mass")
    if not model.existFrame(payload.link, pin.FrameType.BODY):
        raise UnusableInput(
            f"{source}: --payload names no link '{payload.link}'; name a link of the URDF"
        )
    frame = model.frames[model.getFrameId(payload.link, pin.FrameType.BODY)]
    if frame.parentJoint == 0:
        raise UnusableInput(
            f"{source}: --payload link '{payload.link}' does not move; name a moving link"
        )
    xx, xy, yy, xz, yz, zz = payload.inertia
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments = np.linalg.eigvalsh(tensor)
    if moments[0] < 0.0 or moments[2] > moments[0] + moments[1] + 1e-12:
        raise UnusableInput(
            f"{source}: --payload at '{payload.link}': no body has that inertia about its centre; "
            "check the signs"
        )
    body = pin.Inertia(payload.mass, np.array(payload.centre, float), tensor)
    model.appendBodyToJoint(frame.parentJoint, body, frame.placement)


def _placeholders(document: urdf.Urdf, model: pin.Model) -> tuple[str, ...]:
    """Names of the moving links whose inertia is the identity matrix."""
    return tuple(
        frame.name
        for frame in model.frames
        if frame.type == pin.FrameType.BODY
        and frame.parentJoint > 0
        and frame.name in document.inertias
        and document.inertias[frame.name].is_placeholder
    )


def _inertia_faults(document: urdf.Urdf, model: pin.Model) -> tuple[str, ...]:
    """Sentences on moving links whose inertia no link of the robot can have.

    Moments that break the triangle inequality are a fault where the body that the link is part of,
    all links that are fixed to each other, breaks it too: the dynamics depend on that body alone.
    """
    broken = {
        joint
        for joint in range(1, model.njoints)
        if model.inertias[joint].mass > 0.0
        and impossible_moments(np.linalg.eigvalsh(model.inertias[joint].inertia))
    }
    faults = []
    for frame in model.frames:
        inertia = document.inertias.get(frame.name)
        if frame.type != pin.FrameType.BODY or frame.parentJoint == 0 or inertia is None:
            continue
        fault = inertia.scale_fault(document.reach)
        if not fault and frame.parentJoint in broken:
            fault = inertia.moments_fault()
        if fault:
            faults.append(f"link '{frame.name}': {fault}")
    return tuple(faults)


def require_possible_bodies(robot: Robot) -> None:
    """Check the inertias with which torques are certified.

    A placeholder, the identity matrix that templates hold, is reported by a warning.

    Raises:
        UnusableRobot: No body of the robot can have the inertia of a moving link.
    """
    if robot.placeholders:
        warnings.warn(
            f"{robot.source}: the inertia of {', '.join(map(repr, robot.placeholders))} is a "
            "placeholder of 1 kg m² about every axis; torques and the metric depend on it",
            ExciteWarning,
            stacklevel=2,
        )
    if robot.inertia_faults:
        raise UnusableRobot(
            [f"{robot.source}: {fault}; correct its <inertial>" for fault in robot.inertia_faults]
        )


def _inertia_document(inertias: Mapping[str, LinkInertia]) -> dict[str, list[float]]:
    """Inertias as `trajectory.json` states them: mass, centre of mass, and the six moments."""
    return {
        link: [inertia.mass, *inertia.centre, *inertia.tensor] for link, inertia in inertias.items()
    }


def inertias_of_document(document: Mapping[str, Sequence[float]]) -> dict[str, LinkInertia]:
    """Read back the inertias that `Robot.options` states."""
    inertias = {}
    for link, numbers in document.items():
        mass, x, y, z, *moments = (float(number) for number in numbers)
        inertias[link] = LinkInertia(mass, (x, y, z), tuple(moments))  # type: ignore[arg-type]
    return inertias


def mass_faults(robot: Robot) -> list[str]:
    """Sentences on bodies with inertia but no mass, and on joints that move no mass, which make the
    dynamics singular."""
    model = robot.model
    faults = [
        f"link '{link}' has an inertia but the mass 0; correct its <mass> or remove its <inertial>"
        for link, body in zip(robot.links, model.inertias[1:], strict=True)
        if body.mass == 0.0 and np.any(body.inertia)
    ]
    if faults:
        return faults
    for column, joint in enumerate(robot.joints):
        carried = [
            i
            for row in np.flatnonzero(robot.spread[:, column])
            for i in model.subtrees[int(row) + 1]
        ]
        moments = [
            float(model.inertias[i].mass) + float(np.trace(model.inertias[i].inertia))
            for i in carried
        ]
        if not any(moment > 0.0 for moment in moments):
            faults.append(
                f"joint '{joint}' moves no mass; give its links an <inertial>, or the robot's mass "
                f"with --mass, or lock it with --lock {joint}=0"
            )
    return faults
