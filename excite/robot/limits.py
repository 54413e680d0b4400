"""Limits of the moving joints, each with the place it came from."""

from __future__ import annotations

import dataclasses
import math
import os.path
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np

from .._types import FloatArray
from ..errors import ExciteWarning, LimitFault, MissingLimit, UnusableInput
from ..schemas.document_file import DocumentFile, written
from ..schemas.limits import (
    MOVEIT_UNUSED,
    MOVEIT_VALUES,
    BrakingDocument,
    BuiltinLimitsFile,
    JointLimits,
    LimitsFile,
    MoveItSwitchesFile,
    MoveItValues,
    MoveItValuesFile,
    StandLimits,
    StatedLimits,
)
from ..schemas.quantities import shown
from .robot import Follower, Robot, builtin_names
from .urdf import NARROWEST_RANGE, WIDEST_RANGE, range_in_turns

QUANTITIES = ("position", "velocity", "acceleration", "jerk", "torque")
REQUIRED = ("position", "velocity", "torque")
DERIVED = "derived"
ASSUMED = "assumed"
"""Source of a limit that nothing states, in analyses that need it as a scale only."""
ASSUMED_VELOCITY = 2.0 * math.pi
"""Assumed velocity limit [rad/s or m/s]: a turn per second."""
ASSUMED_LEVER = 0.2
"""Lever at which the assumed torque limit holds the robot's weight [m]: the hip of a standing
person carries a few tenths of the body's weight times a metre."""
URDF = "urdf"
"""Source of a limit that the URDF states."""
SOFT_LIMITS = "urdf, safety_controller"
"""Source of a position limit that the URDF's <safety_controller> narrows."""
MIMIC = "urdf, mimic "
"""Beginning of the source of a limit that a mimic joint imposes on the joint it follows."""
WITH_MARGIN = ("velocity", "acceleration", "jerk", "torque")
"""Limits of which a design keeps a share free."""
DEFAULT_MARGIN = 0.02
"""Share of these limits that a design keeps free unless told otherwise [1]: a controller stops the
robot at the limit itself, and its tracking overshoots the commanded motion. `--margin` and the
limits file's [margin] table change it."""
LimitTable: TypeAlias = "dict[str, dict[str, tuple[Any, str]]]"
"""Joint -> quantity -> (value, source)."""
TomlLimits = TypeVar("TomlLimits", bound=LimitsFile)
SHOWN_PATH = 300
"""Characters of the name of a file that a message repeats."""
MOVEIT = {
    "max_velocity": "velocity",
    "max_acceleration": "acceleration",
    "max_jerk": "jerk",
    "max_effort": "torque",
}
"""Our names of MoveIt's limits."""


@dataclass(frozen=True)
class Braking:
    """Velocity limit that falls towards a position stop: |q̇| ≤ −offset + √(rate · distance to the
    stop).

    The form in which Franka states the FR3's limits.

    Attributes:
        offset: Reduction of the velocity at the stop [rad/s].
        rate: Increase of the squared velocity with the distance [rad/s²].
        stop: Lower and upper position stop [rad].
    """

    offset: float
    rate: float
    stop: tuple[float, float]

    def scaled(self, factor: float) -> Braking:
        """The same limit with every velocity multiplied by `factor`."""
        return Braking(self.offset * factor, self.rate * factor**2, self.stop)


@dataclass(frozen=True)
class Stand:
    """Load that the stand of a robot's base takes, the robot's weight included.

    Attributes:
        force: Largest magnitude of the force on it [N].
        moment: Largest magnitude of the moment about its point [N m].
        point: Point of the base link, in its frame [m].
        source: File that states it.
    """

    force: float = math.inf
    moment: float = math.inf
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    source: str = ""

    def document(self) -> dict[str, Any]:
        """The entry of a trajectory file; an absent limit is absent."""
        loads = {"force": self.force, "moment": self.moment}
        stated = {name: value for name, value in loads.items() if math.isfinite(value)}
        return {**stated, "point": list(self.point), "source": self.source}


@dataclass(frozen=True)
class Limits:
    """Limits of n joints, ±inf where nothing is stated.

    Attributes:
        joints: Names of the joints.
        position: Shape (n, 2) [rad or m].
        velocity: Positive and symmetric, as the following. Shape (n,) [rad/s or m/s].
        acceleration: Shape (n,) [rad/s² or m/s²].
        jerk: Shape (n,) [rad/s³ or m/s³].
        torque: Shape (n,) [N m or N].
        braking: Per joint, None where the velocity limit does not depend on position.
        sources: Per quantity n texts saying where each value came from ("" where there is none).
        margin: Share of each limit of `WITH_MARGIN` that a design keeps free [1]; a kind that is
            absent keeps none.
        stand: Load that the stand of the base takes; None: any.
    """

    joints: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    torque: FloatArray
    braking: tuple[Braking | None, ...]
    sources: Mapping[str, tuple[str, ...]]
    margin: Mapping[str, float] = field(default_factory=dict)
    stand: Stand | None = None

    def reduced(self) -> Limits:
        """The limits that a design uses: the margin is taken off, braking included, and none is
        left to take."""
        kept = {kind: 1.0 - self.margin.get(kind, 0.0) for kind in WITH_MARGIN}
        braking = tuple(None if b is None else b.scaled(kept["velocity"]) for b in self.braking)
        return dataclasses.replace(self.scaled(**kept), braking=braking, margin={})

    def scaled(self, **factors: float) -> Limits:
        """Symmetric limits multiplied by a factor each; positions are left as they are."""
        return dataclasses.replace(
            self, **{name: getattr(self, name) * factor for name, factor in factors.items()}
        )

    def document(self) -> dict[str, Any]:
        """The limits as `trajectory.json` states them; an absent limit is absent."""
        out: dict[str, Any] = {}
        for quantity in QUANTITIES:
            values = getattr(self, quantity)
            out[quantity] = {
                joint: {
                    "value": np.asarray(values[i]).tolist(),
                    "source": self.sources[quantity][i],
                }
                for i, joint in enumerate(self.joints)
                if np.isfinite(values[i]).all()
            }
        stated = {
            j: dataclasses.asdict(b)
            for j, b in zip(self.joints, self.braking, strict=True)
            if b is not None
        }
        if stated:
            out["braking"] = stated
        if self.stand is not None:
            out["stand"] = self.stand.document()
        return out


def from_document(document: StatedLimits, joints: tuple[str, ...]) -> Limits:
    """The limits that a trajectory states; an absent limit is infinite."""
    sources: dict[str, tuple[str, ...]] = {}
    arrays: dict[str, FloatArray] = {}
    for quantity in QUANTITIES:
        absent: Any = [-math.inf, math.inf] if quantity == "position" else math.inf
        entries = getattr(document, quantity)
        arrays[quantity] = np.array(
            [entries[j].value if j in entries else absent for j in joints], float
        )
        sources[quantity] = tuple(str(entries[j].source) if j in entries else "" for j in joints)
    braking = tuple(
        _braking(document.braking[j]) if j in document.braking else None for j in joints
    )
    return Limits(
        joints=joints,
        braking=braking,
        sources=sources,
        stand=None
        if document.stand is None
        else _stand(document.stand, str(document.stand.source)),
        **arrays,  # type: ignore[arg-type]
    )


def _stand(document: StandLimits, source: str) -> Stand:
    x, y, z = (float(value) for value in document.point)
    return Stand(
        math.inf if document.force is None else float(document.force),
        math.inf if document.moment is None else float(document.moment),
        (x, y, z),
        source,
    )


def _braking(document: BrakingDocument) -> Braking:
    return Braking(
        float(document.offset),
        float(document.rate),
        (float(document.stop[0]), float(document.stop[1])),
    )


def resolve(robot: Robot, file: Path | None = None, margin: float | None = None) -> Limits:
    """Limits of a robot: the URDF's, then the built-in model's own table, then `file`, the later
    overriding.

    Args:
        robot: The robot whose moving joints need limits.
        file: TOML (`[joints.<name>] position = [lower, upper]`, velocity, acceleration, jerk,
            torque, braking, `[margin] velocity = 0.05`, …, and `[stand] force, moment, point`) or a
            MoveIt `joint_limits.yaml`.
        margin: Share of every limit of `WITH_MARGIN` to keep free [1]; None: as the file says, else
            `DEFAULT_MARGIN`.

    Raises:
        MissingLimit: Position (of a joint that isn't continuous), velocity or torque is absent.
        UnusableInput: A file cannot be read, names an unknown joint or contradicts itself; or the
            margin is no share.
    """
    if margin is not None and not 0.0 <= margin < 1.0:
        raise UnusableInput(
            f"--margin {margin:g} should be a share of the limits, at least 0 and below 1"
        )
    table, shares, stand = stated_limits(robot, file)
    for follower in robot.followers:
        tighten(robot, table[follower.master], follower)
    missing = missing_limits(robot, table)
    if missing:
        raise MissingLimit(robot.source, missing, is_mjcf=robot.is_mjcf)
    if margin is not None:
        shares = dict.fromkeys(WITH_MARGIN, margin)
    return dataclasses.replace(_assemble(robot, table), margin=shares, stand=stand)


def stated_limits(
    robot: Robot, file: Path | None = None
) -> tuple[LimitTable, dict[str, float], Stand | None]:
    """Limits that the URDF, a built-in model's own table and a limits file state, the later
    overriding, the shares of them to keep free, and the load that a stand takes; see `resolve`."""
    table: LimitTable = {joint: {} for joint in robot.joints}
    for entry in robot.entries:
        for quantity in REQUIRED:
            value = getattr(entry, quantity)
            if value is not None:
                table[entry.name][quantity] = (value, URDF)
        if entry.soft_position is not None and entry.position is not None:
            table[entry.name]["position"] = (entry.soft_position, SOFT_LIMITS)
    if robot.source in builtin_names():
        table_file = _builtin_table(robot)
        _merge(
            robot,
            table,
            table_file,
            _read_toml(table_file, BuiltinLimitsFile).joints,
            table_file.name,
        )
    shares, stand = dict.fromkeys(WITH_MARGIN, DEFAULT_MARGIN), None
    if file is not None:
        stated = LimitsFile(_read_yaml(file)) if _is_yaml(file) else _read_toml(file, LimitsFile)
        _merge(robot, table, file, stated.joints, str(file.resolve()))
        if stated.stand is not None:
            stand = _stand(stated.stand, str(file.resolve()))
        shares |= {
            kind: float(share)
            for kind in WITH_MARGIN
            if (share := getattr(stated.margin, kind, None)) is not None
        }
    return table, shares, stand


def resolve_with_assumptions(robot: Robot, file: Path | None = None) -> Limits:
    """Limits of a robot for analyses in which they are scales only, with assumed values of missing
    ones: half a turn each way, ASSUMED_VELOCITY, and the torque that holds the robot's weight at
    ASSUMED_LEVER.

    Args:
        robot: The robot.
        file: Limits file, as of `resolve`.

    Raises:
        UnusableInput: The file cannot be read, names an unknown joint or contradicts itself.
    """
    table, *_ = stated_limits(robot, file)
    assumed: dict[str, Any] = {
        "position": (-math.pi, math.pi),
        "velocity": ASSUMED_VELOCITY,
        "torque": ASSUMED_LEVER * robot.weight or 1.0,
    }
    for fault in missing_limits(robot, table):
        table[fault.joint][fault.quantity] = (assumed[fault.quantity], ASSUMED)
    return _assemble(robot, table)


def missing_limits(robot: Robot, table: LimitTable) -> list[LimitFault]:
    """Required limits that a table of stated ones lacks, with what the URDF states instead."""
    return [
        LimitFault(entry.name, quantity, entry.unusable.get(quantity, ""))
        for entry in robot.entries
        for quantity in REQUIRED
        if quantity not in table[entry.name]
        and not (quantity == "position" and entry.kind == "continuous")
    ]


def limits_files(robot: Robot, limits: Limits) -> list[str]:
    """Paths of the limits files among the sources of a robot's limits, in alphabetical order."""
    known = {"", URDF, SOFT_LIMITS, DERIVED, f"{robot.source}.toml"}
    stand_sources = () if limits.stand is None else ((limits.stand.source,),)
    return sorted(
        {
            text
            for texts in (*limits.sources.values(), *stand_sources)
            for text in texts
            if text not in known and not text.startswith(MIMIC)
        }
    )


def from_sources(
    robot: Robot, stated: Limits, file: Path | None = None, folder: Path | None = None
) -> Limits:
    """Resolve again, from their sources, the limits that a trajectory states.

    Args:
        robot: The robot of the trajectory.
        stated: The limits of its file; only their sources are used.
        file: Where the limits file is now; None: where the sources say, or of that name in
            `folder`.
        folder: The trajectory's own folder.

    Raises:
        UnusableInput: The limits file that a source names is not there, or cannot be read.
    """
    named = limits_files(robot, stated)
    if file is None and named:
        if len(named) > 1:
            raise UnusableInput(
                f"{robot.source}: the limits name several sources "
                f"({', '.join(shown(name, SHOWN_PATH) for name in named)}); give the "
                "file with --limits"
            )
        candidates = [Path(named[0]), *([] if folder is None else [folder / Path(named[0]).name])]
        file = next((path for path in candidates if os.path.isfile(path)), None)
        if file is None:
            raise UnusableInput(
                f"{shown(named[0], SHOWN_PATH)}: the limits file of this trajectory is not there; "
                "say where it is "
                "with --limits FILE"
            )
    return resolve(robot, file)


def mounting_plane(robot: Robot) -> float | None:
    """Height of the plane that a built-in model's base stands on, in the base frame [m]; None where
    no built-in table states it."""
    if robot.source not in builtin_names():
        return None
    mounting = _read_toml(_builtin_table(robot), BuiltinLimitsFile).mounting
    return None if mounting is None else float(mounting.floor)


def _builtin_table(robot: Robot) -> Path:
    return Path(str(resources.files("excite.robot") / "models" / f"{robot.source}.toml"))


def tighten(robot: Robot, entries: dict[str, tuple[Any, str]], follower: Follower) -> None:
    """Apply a mimic joint's own position and velocity limits to the joint it follows: q_mimic =
    multiplier q + offset.

    Raises:
        UnusableInput: The two joints have no common range.
    """
    stated, factor = follower.entry, follower.multiplier
    if factor == 0.0:
        return
    source = f"{MIMIC}{stated.name}"
    if stated.position is not None:
        ends = sorted((bound - follower.offset) / factor for bound in stated.position)
        lower, upper = entries.get("position", ((-np.inf, np.inf), ""))[0]
        if ends[0] > lower or ends[1] < upper:
            both = max(ends[0], lower), min(ends[1], upper)
            if not both[1] - both[0] >= NARROWEST_RANGE:
                raise UnusableInput(
                    f"{robot.source}: mimic joint '{stated.name}' ({factor:g} times "
                    f"'{follower.master}' plus {follower.offset:g}) may go from "
                    f"{stated.position[0]:g} to {stated.position[1]:g}, which leaves "
                    f"'{follower.master}' no range between {lower:g} and {upper:g}; correct the "
                    f"<limit> of '{stated.name}' or lock the pair with --lock {follower.master}="
                    f"{float(np.clip(0.0, lower, upper)):g}"
                )
            entries["position"] = (both, source)
    if (
        stated.velocity is not None
        and stated.velocity / abs(factor) < entries.get("velocity", (np.inf, ""))[0]
    ):
        entries["velocity"] = (stated.velocity / abs(factor), source)


def _assemble(robot: Robot, table: Mapping[str, Mapping[str, tuple[Any, str]]]) -> Limits:
    def values(quantity: str, absent: Any) -> FloatArray:
        array = np.array(
            [table[joint].get(quantity, (absent, ""))[0] for joint in robot.joints], float
        )
        array.setflags(write=False)
        return array

    return Limits(
        joints=robot.joints,
        position=values("position", (-np.inf, np.inf)),
        velocity=values("velocity", np.inf),
        acceleration=values("acceleration", np.inf),
        jerk=values("jerk", np.inf),
        torque=values("torque", np.inf),
        braking=tuple(table[joint].get("braking", (None, ""))[0] for joint in robot.joints),
        sources={
            q: tuple(table[joint].get(q, (None, ""))[1] for joint in robot.joints)
            for q in QUANTITIES
        },
    )


def _merge(
    robot: Robot,
    table: dict[str, dict[str, tuple[Any, str]]],
    file: Path,
    stated: Mapping[str, JointLimits],
    source: str,
) -> None:
    """Enter the limits of a file into the table, over those that are there."""
    known = {*robot.options["locked"], *robot.joints, *robot.mimics}  # type: ignore[misc]
    unknown = [joint for joint in stated if joint not in known]
    if unknown and (not _is_yaml(file) or len(unknown) == len(stated)):
        raise UnusableInput(
            f"{file}: no joint '{unknown[0]}' in {robot.source}; there are: "
            f"{', '.join(robot.joints)}"
        )
    for joint in unknown:
        warnings.warn(
            f"{file}: joint '{joint}' is not in {robot.source}; ignored",
            ExciteWarning,
            stacklevel=4,
        )
    kinds = {entry.name: entry.kind for entry in robot.entries}
    for joint, entry in stated.items():
        if joint not in table:
            continue
        values = {quantity: getattr(entry, quantity) for quantity in QUANTITIES}
        values["braking"] = None if entry.braking is None else _braking(entry.braking)
        position = values["position"]
        if (
            position is not None
            and kinds[joint] != "prismatic"
            and position[1] - position[0] > WIDEST_RANGE
        ):
            raise UnusableInput(
                f"{file}: joint '{joint}': position {range_in_turns(position)}; state radians, and "
                "of a joint that turns without end the part that the motion may use"
            )
        table[joint].update(
            {quantity: (value, source) for quantity, value in values.items() if value is not None}
        )


def _is_yaml(file: Path) -> bool:
    return file.suffix in (".yaml", ".yml")


def _document(file: Path) -> DocumentFile:
    return DocumentFile(
        file,
        "a limits file",
        "correct it",
        "a TOML file with [joints.<name>] tables, or a MoveIt joint_limits.yaml",
    )


def _read_toml(file: Path, schema: type[TomlLimits]) -> TomlLimits:
    document = _document(file)
    return document.converted(document.toml(), schema)


def _read_yaml(file: Path) -> dict[str, JointLimits]:
    """The limits of a MoveIt joint_limits.yaml whose switches, has_<x>_limits, are on.

    Raises:
        UnusableInput: The file is none; a switch is on and its value is missing; or a key looks
            like a limit and is none.
    """
    document = _document(file)
    content = document.yaml()
    switches = document.converted(content, MoveItSwitchesFile).joint_limits
    if not switches:
        raise document.error("names no joint", "joint_limits")
    known = {
        *MOVEIT_VALUES,
        *MOVEIT_UNUSED,
        *(value for values in MOVEIT_VALUES.values() for value in values),
    }
    values: dict[str, dict[str, Any]] = {}
    for joint, entry in content["joint_limits"].items():
        for key in entry:
            if key.startswith(("has_", "min_", "max_")) and key not in known:
                known_keys = ", ".join(sorted(known))
                raise document.error(
                    f"has the unknown key '{key}'; it may have {known_keys}",
                    written(("joint_limits", joint)),
                )
        wanted = [
            (switch, key)
            for switch, keys in MOVEIT_VALUES.items()
            if getattr(switches[joint], switch)
            for key in keys
        ]
        for switch, key in wanted:
            if entry.get(key) is None:
                raise document.error(
                    f"has no '{key}', but {switch} is true", written(("joint_limits", joint))
                )
        values[joint] = {key: entry[key] for _, key in wanted}
    stated = document.converted({"joint_limits": values}, MoveItValuesFile).joint_limits
    return {joint: _of_moveit(entry) for joint, entry in stated.items()}


def _of_moveit(entry: MoveItValues) -> JointLimits:
    """The limits of one joint under our names."""
    position = (
        None
        if entry.min_position is None or entry.max_position is None
        else (entry.min_position, entry.max_position)
    )
    return JointLimits(
        position=position, **{ours: getattr(entry, theirs) for theirs, ours in MOVEIT.items()}
    )
