"""Check of a robot: report of everything that is missing or implausible."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._system.one_or_several import one_or_several_texts
from .._types import FloatArray, Paths
from ..errors import ExciteWarning, LimitFault, UnusableInput
from ..robot import base_parameters, dynamics, inertial_parameters, urdf
from ..robot import limits as robot_limits
from ..robot.limits import QUANTITIES, Limits, LimitTable
from ..robot.limits_template import UNITS, limits_template
from ..robot.parameter_names import plural
from ..robot.robot import GRAVITY, Payload, Robot, load, locate, mass_faults
from ..robot.samples import Samples

FASTEST_TURN = 60.0
"""Velocity limit of a turning joint above which it is doubted [rad/s]: ten turns a second. Legged
robots reach 50 rad/s; degrees per second begin at about 60."""
FASTEST_SLIDE = 20.0
"""Velocity limit of a sliding joint above which it is doubted [m/s]: linear axes reach 10 m/s;
millimetres per second begin at 50."""
WIDEST_SLIDE = 20.0
"""Range of a sliding joint above which it is doubted [m]; gantries reach 20 m."""
LARGEST_EFFORT = 1e5
"""Torque or force limit above which it can only be a placeholder where gravity needs less than its
HOLDING_MULTIPLE-th part [N m or N]; the joints of the largest robots have 2e4 N m."""
HOLDING_MULTIPLE = 10.0
"""Torque limit of the joint that carries the arm, relative to its weight: 2 to 10 [1]."""
EFFORT_MULTIPLE = 1000.0
"""Torque limit, relative to the largest torque of gravity at any joint, above which it is doubted
[1]."""
POSES = 200
"""Number of poses over which the torque of gravity is computed."""


@dataclass(frozen=True)
class RobotCheck:
    """A robot's file under examination.

    Attributes:
        robot: The robot.
        table: Limits by joint and quantity, each with its source.
        missing: Required limits that are missing or unusable.
        faults: Sentences on what has to be corrected before a design.
        remarks: Sentences on what is unusual or was ignored.
        base_parameters: Number of base parameters.
        base_link: Name of the root link, which is fixed to the ground.
        fixed: Number of fixed joints.
        gravity_torque: Largest torque of gravity over the position ranges. Shape (n,) [N m or N].
        floor: Height of the floor that a design assumes [m]; None: no floor or no shapes.
    """

    robot: Robot
    table: LimitTable
    missing: tuple[LimitFault, ...]
    faults: tuple[str, ...]
    remarks: tuple[str, ...]
    base_parameters: int
    base_link: str
    fixed: int
    gravity_torque: FloatArray
    floor: float | None

    @property
    def usable(self) -> bool:
        """True if a design can begin."""
        return not self.faults

    def template(self) -> str:
        """Text of a limits file with the known limits and blanks for the others."""
        return limits_template(self.robot, self.table, self.missing)

    def document(self) -> dict[str, Any]:
        """The check as `excite check --json` prints it."""
        robot = self.robot
        return {
            "robot": {"name": robot.name, "source": robot.source, "sha256": robot.sha256},
            "usable": self.usable,
            "faults": list(self.faults),
            "remarks": list(self.remarks),
            "joints": [
                {
                    "name": entry.name,
                    "type": entry.kind,
                    "link": entry.child,
                    "limits": {
                        quantity: {"value": np.asarray(value).tolist(), "source": source}
                        for quantity, (value, source) in self.table[entry.name].items()
                        if quantity in QUANTITIES
                    },
                    "missing": [f.quantity for f in self.missing if f.joint == entry.name],
                    "gravity_torque": float(self.gravity_torque[i]),
                    "viscous": entry.viscous,
                    "coulomb": entry.coulomb,
                    "rotor_inertia": entry.rotor_inertia,
                }
                for i, entry in enumerate(robot.entries)
            ],
            "locked": dict(robot.options["locked"]),  # type: ignore[call-overload]
            "mimics": [
                {
                    "name": follower.entry.name,
                    "joint": follower.master,
                    "multiplier": follower.multiplier,
                    "offset": follower.offset,
                }
                for follower in robot.followers
            ],
            "fixed_joints": self.fixed,
            "base_parameters": self.base_parameters,
            "base_link": self.base_link,
            "floor": self.floor,
        }

    def lines(self) -> list[str]:
        """One page for people."""
        robot = self.robot
        locked: Mapping[str, float] = robot.options["locked"]  # type: ignore[assignment]
        counts = [plural(robot.n, "moving joint"), f"{self.fixed} fixed"]
        counts += [f"{len(locked)} locked"] if locked else []
        counts += [f"{len(robot.followers)} mimic"] if robot.followers else []
        out = [
            f"{robot.name} ({robot.source})",
            f"{', '.join(counts)}; {self.base_parameters} base parameters",
            "base frame: link "
            f"'{self.base_link}', gravity {_vector(robot.model.gravity.linear)} m/s², "
            + (
                "no floor assumed"
                if self.floor is None
                else f"floor at z = {round(self.floor, 6) + 0.0:g} m"
            ),
            "",
            *self._table(),
        ]
        out += [
            f"  mimic '{f.entry.name}' = {f.multiplier:g} · '{f.master}' + {f.offset:g}"
            for f in robot.followers
        ]
        out += [f"  locked '{name}' at {value:g}" for name, value in locked.items()]
        for title, sentences in (("to correct", self.faults), ("remarks", self.remarks)):
            if sentences:
                out += ["", f"{title} ({len(sentences)}):", *(f"  {line}" for line in sentences)]
        out += ["", "usable" if self.usable else "not usable before it is corrected"]
        return out

    def _table(self) -> list[str]:
        """Joints with their limits; missing ones are shown as ?."""
        header = ["joint", "type", "position", "velocity", "torque", "gravity", "sources"]
        rows = [header]
        for i, entry in enumerate(self.robot.entries):
            limits = self.table[entry.name]
            sources = dict.fromkeys(limits[q][1] for q in QUANTITIES if q in limits)
            rows.append(
                [
                    entry.name,
                    entry.kind,
                    _range(limits, entry.kind),
                    _value(limits, "velocity", entry.unit(UNITS["velocity"])),
                    _value(limits, "torque", entry.unit(UNITS["torque"])),
                    f"{round(self.gravity_torque[i], 9):.3g}",
                    "; ".join(sources) or "-",
                ]
            )
        widths = [max(len(row[k]) for row in rows) for k in range(len(header))]
        return [("  " + "  ".join(map(str.ljust, row, widths))).rstrip() for row in rows]


def _vector(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{float(value):g}" for value in values) + ")"


def _range(limits: Mapping[str, tuple[Any, str]], kind: str) -> str:
    if "position" not in limits:
        return "none" if kind == "continuous" else "?"
    lower, upper = limits["position"][0]
    return f"{lower:.4g} to {upper:.4g}"


def _value(limits: Mapping[str, tuple[Any, str]], quantity: str, unit: str) -> str:
    return f"{limits[quantity][0]:.4g} {unit}" if quantity in limits else "?"


def check_robot(
    source: str | Path,
    *,
    limits: str | Path | None = None,
    joints: str | Sequence[str] | None = None,
    lock: Mapping[str, float] | None = None,
    payload: Payload | None = None,
    gravity: Sequence[float] = GRAVITY,
    mass: float | None = None,
    packages: Paths = (),
) -> RobotCheck:
    """Examine a robot's file.

    Args:
        source: Path of a URDF or name of a built-in model.
        limits: Limits file that overrides the URDF's limits.
        joints: Joints that move, see `load_robot`.
        lock: Positions of locked joints [rad or m].
        payload: Body attached to a link.
        gravity: Gravity in the base frame. Shape (3,) [m/s²].
        mass: Mass of the complete robot [kg], for links without inertia; see `load_robot`.
        packages: Folders in which `package://` meshes are searched.

    Raises:
        UnusableInput: The file cannot be read, or is no tree of joints.
    """
    packages = one_or_several_texts(packages)
    with warnings.catch_warnings(record=True) as recorded:
        warnings.simplefilter("always", ExciteWarning)
        inertias = None
        if mass is not None:
            from ..collision.nominal_inertia import nominal_inertias  # slow to import

            inertias = nominal_inertias(str(source), mass, packages)
        robot = load(
            str(source),
            joints=joints,
            lock=lock,
            payload=payload,
            gravity=gravity,
            inertias=inertias,
            require_mass=False,
        )
        document = urdf.read(locate(str(source)))
        table, *_ = robot_limits.stated_limits(robot, None if limits is None else Path(limits))
        faults = [*mass_faults(robot)]
        for follower in robot.followers:
            try:
                robot_limits.tighten(robot, table[follower.master], follower)
            except UnusableInput as error:
                faults.append(_without_source(robot, str(error)))
        missing = tuple(robot_limits.missing_limits(robot, table))
        faults += [str(fault) for fault in missing]
        faults += [f"{fault}; correct its <inertial>" for fault in robot.inertia_faults]
        substitute = _with_substitutes(robot, table)
        standard = inertial_parameters.standard_parameters(robot, substitute)
        count = base_parameters.find(robot, standard, substitute).count
        torque = _gravity_torque(robot, standard, substitute)
        floor, shape_faults = _floor(robot, substitute, packages)
    faults += shape_faults
    remarks = [_without_source(robot, str(warning.message)) for warning in recorded]
    remarks += [
        *_limit_remarks(robot, table, torque),
        *_link_remarks(robot, document),
    ]
    children = {placement.child for placement in document.placements}
    return RobotCheck(
        robot=robot,
        table=table,
        missing=missing,
        faults=tuple(dict.fromkeys(faults)),
        remarks=tuple(dict.fromkeys(remarks)),
        base_parameters=count,
        base_link=next(link for link in document.links if link not in children),
        fixed=sum(placement.kind == "fixed" for placement in document.placements),
        gravity_torque=torque,
        floor=floor,
    )


def _without_source(robot: Robot, text: str) -> str:
    return text.removeprefix(f"{robot.source}: ")


def _with_substitutes(robot: Robot, table: LimitTable) -> Limits:
    """Return the limits with substitutes for missing ones.

    The results that use them depend only weakly on the substitutes: number of base parameters,
    torque of gravity, floor.
    """

    def values(quantity: str, substitute: Any) -> FloatArray:
        return np.array(
            [table[joint].get(quantity, (substitute, ""))[0] for joint in robot.joints], float
        )

    infinite = np.full(robot.n, math.inf)
    known = [entry["torque"][0] for entry in table.values() if "torque" in entry]
    return Limits(
        joints=robot.joints,
        position=values("position", (-math.inf, math.inf)),
        velocity=values("velocity", 1.0),
        acceleration=infinite,
        jerk=infinite,
        torque=values("torque", float(np.median(known)) if known else 1.0),
        braking=(None,) * robot.n,
        sources={quantity: ("",) * robot.n for quantity in QUANTITIES},
    )


def _gravity_torque(
    robot: Robot, standard: inertial_parameters.Parameters, limits: Limits
) -> FloatArray:
    """Return the largest torque of gravity over the position ranges. Shape (n,) [N m or N]."""
    q = inertial_parameters.spread_poses(limits, POSES)
    still = np.zeros_like(q)
    frictionless = dataclasses.replace(standard, nominal=standard.nominal.copy())
    frictionless.nominal[10 * standard.bodies :] = 0.0
    return np.abs(dynamics.torque(robot, frictionless, Samples(q, still, still))).max(axis=0)


def _floor(robot: Robot, limits: Limits, packages: Sequence[str]) -> tuple[float | None, list[str]]:
    """Return the height of the floor that a design assumes, and faults of the shapes."""
    from ..collision import scene_file, urdf_geometry  # slow to import

    missing = urdf_geometry.missing_meshes(robot.source, packages)
    if missing:
        return None, [
            *(f"link '{link}': its mesh {mesh} is not found" for link, mesh in missing),
            "say where the meshes are with --packages DIR or in ROS_PACKAGE_PATH, or design with "
            "--no-collision",
        ]
    try:
        shapes = urdf_geometry.read(robot.source, packages)
        frames = [robot.model.frames[robot.frame(str(shape.link))] for shape in shapes]
        if not any(int(frame.parentJoint) > 0 for frame in frames):
            warnings.warn(
                "no moving link has a <collision> shape: collision cannot be checked",
                ExciteWarning,
                stacklevel=2,
            )
            return None, []
        return scene_file.default_floor(robot, limits, shapes), []
    except UnusableInput as error:
        return None, [_without_source(robot, str(error))]


def _limit_remarks(robot: Robot, table: LimitTable, gravity_torque: FloatArray) -> list[str]:
    """Return sentences on limits that are implausible or were narrowed."""
    out = []
    largest = float(gravity_torque.max())
    for entry, needed in zip(robot.entries, gravity_torque, strict=True):
        limits, owner = table[entry.name], f"joint '{entry.name}'"
        slides = entry.kind == "prismatic"
        speed = limits.get("velocity", (0.0, ""))[0]
        if speed > (FASTEST_SLIDE if slides else FASTEST_TURN):
            doubt = "mm/s?" if slides else "degrees per second?"
            out.append(f"{owner}: its velocity limit is {speed:g} {entry.unit('rad/s')} ({doubt})")
        if slides and "position" in limits:
            lower, upper = limits["position"][0]
            if upper - lower > WIDEST_SLIDE:
                out.append(f"{owner}: its range is {upper - lower:g} m (mm?)")
        effort, unit = limits.get("torque", (None, ""))[0], entry.unit("N m")
        if effort is not None:
            if effort > max(LARGEST_EFFORT, HOLDING_MULTIPLE * largest):
                out.append(f"{owner}: its torque limit of {effort:g} {unit} is a placeholder")
            elif effort > EFFORT_MULTIPLE * largest > 0.0:
                out.append(
                    f"{owner}: its torque limit of {effort:g} {unit} is {effort / largest:.2g} "
                    "times the largest torque of gravity"
                )
            elif effort < needed:
                out.append(
                    f"{owner}: gravity needs up to {needed:.3g} {unit}, its limit is {effort:g}"
                )
        if "soft position" in entry.unusable:
            out.append(f"{owner}: {entry.unusable['soft position']}, outside its limits; ignored")
    return out


def _link_remarks(robot: Robot, document: urdf.Urdf) -> list[str]:
    """Return sentences on inertias that are unusual but prevent nothing."""
    reported = " ".join(robot.inertia_faults)
    out = []
    for link, inertia in document.inertias.items():
        fault = inertia.scale_fault(document.reach) or inertia.moments_fault()
        if fault and f"link '{link}'" not in reported:
            out.append(f"link '{link}': {fault} (it is fixed, or part of a possible body)")
    without = [
        link for i, link in enumerate(robot.links, start=1) if robot.model.inertias[i].mass == 0.0
    ]
    if without and not mass_faults(robot):
        out.append(f"links without mass: {', '.join(without)}")
    if robot.placeholders:
        out.append(
            f"the inertia of {', '.join(robot.placeholders)} is a placeholder of 1 kg m² about "
            "every axis"
        )
    return out
