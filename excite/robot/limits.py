"""Limits of the moving joints, each with the place it came from."""

from __future__ import annotations

import dataclasses
import math
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ExciteWarning, MissingLimit, UnusableInput
from .robot import Follower, Robot, builtin_names

Array = np.ndarray
QUANTITIES = ("position", "velocity", "acceleration", "jerk", "torque")
REQUIRED = ("position", "velocity", "torque")
DERIVED = "derived"
MIMIC = "urdf, mimic "
"""Beginning of the source of a limit that a mimic joint imposes on the joint it follows."""
WITH_MARGIN = ("velocity", "acceleration", "jerk", "torque")
"""Limits of which a design keeps a share free."""
DEFAULT_MARGIN = 0.02
"""Share of these limits that a design keeps free unless told otherwise [1]: a controller stops the robot at the limit itself, and
its tracking overshoots the commanded motion. `--margin` and the limits file's [margin] table change it."""
_EXAMPLES = {
    "position": "[-2.9, 2.9]",
    "braking": "{ offset = 0.2, rate = 7.0, stop = [-2.9, 2.9] }",
}
"""What a limits file would say, of limits that are no number."""


@dataclass(frozen=True)
class Braking:
    """Velocity limit that falls towards a position stop: |q̇| ≤ −offset + √(rate · distance to the stop).

    The form in which Franka states the FR3's limits. offset: [rad/s]. rate: [rad/s²]. stop: (lower, upper) [rad].
    """

    offset: float
    rate: float
    stop: tuple[float, float]

    def scaled(self, factor: float) -> Braking:
        """The same limit with every velocity multiplied by `factor`."""
        return Braking(self.offset * factor, self.rate * factor**2, self.stop)


@dataclass(frozen=True)
class Limits:
    """What each of n joints may do; ±inf where nothing is stated.

    position: Shape (n, 2) [rad or m]. velocity, acceleration, jerk, torque: Shape (n,), positive, symmetric
    [rad/s, rad/s², rad/s³, N m; for a prismatic joint m and N].
    braking: per joint, None where the velocity limit does not depend on position.
    sources: quantity -> n texts saying where each value came from ("" where there is none).
    margin: share of each limit of `WITH_MARGIN` that a design keeps free [1]; a kind that is absent keeps none.
    """

    joints: tuple[str, ...]
    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array
    braking: tuple[Braking | None, ...]
    sources: Mapping[str, tuple[str, ...]]
    margin: Mapping[str, float] = field(default_factory=dict)

    def reduced(self) -> Limits:
        """The limits that a design uses: the margin is taken off, braking included, and none is left to take."""
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
        return out


def from_document(document: Mapping[str, Any], joints: tuple[str, ...]) -> Limits:
    """Read back what `Limits.document` wrote."""
    sources: dict[str, tuple[str, ...]] = {}
    arrays: dict[str, Array] = {}
    for quantity in QUANTITIES:
        absent: Any = [-math.inf, math.inf] if quantity == "position" else math.inf
        entries = document.get(quantity, {})
        arrays[quantity] = np.array(
            [entries[j]["value"] if j in entries else absent for j in joints], float
        )
        sources[quantity] = tuple(
            str(entries[j].get("source", "")) if j in entries else "" for j in joints
        )
    stated = document.get("braking", {})
    braking = tuple(_braking(stated[j]) if j in stated else None for j in joints)
    return Limits(joints=joints, braking=braking, sources=sources, **arrays)  # type: ignore[arg-type]


def _braking(entry: Mapping[str, Any]) -> Braking:
    return Braking(
        float(entry["offset"]),
        float(entry["rate"]),
        (float(entry["stop"][0]), float(entry["stop"][1])),
    )


def _sensible(brake: Braking) -> Braking:
    if not np.isfinite([brake.offset, brake.rate, *brake.stop]).all():
        raise ValueError("not finite")
    if brake.offset < 0.0 or brake.rate <= 0.0 or brake.stop[0] >= brake.stop[1]:
        raise ValueError("offset ≥ 0, rate > 0 and stop = [lower, upper] are needed")
    return brake


def resolve(robot: Robot, file: Path | None = None, margin: float | None = None) -> Limits:
    """Limits of a robot: the URDF's, then the built-in model's own table, then `file`, the later overriding.

    Args:
        robot: The robot whose moving joints need limits.
        file: TOML (`[joints.<name>] position = [lower, upper]`, velocity, acceleration, jerk, torque, braking, and
            `[margin] velocity = 0.05`, …) or a MoveIt `joint_limits.yaml`.
        margin: Share of every limit of `WITH_MARGIN` to keep free [1]; None: as the file says, else `DEFAULT_MARGIN`.

    Raises:
        MissingLimit: Position (of a joint that isn't continuous), velocity or torque is absent.
        UnusableInput: A file cannot be read, names an unknown joint or contradicts itself; or the margin is no share.
    """
    if margin is not None and not 0.0 <= margin < 1.0:
        raise UnusableInput(
            f"--margin {margin:g} should be a share of the limits, at least 0 and below 1"
        )
    table: dict[str, dict[str, tuple[Any, str]]] = {joint: {} for joint in robot.joints}
    for entry in robot.entries:
        for quantity in REQUIRED:
            value = getattr(entry, quantity)
            if value is not None:
                table[entry.name][quantity] = (value, "urdf")
    if robot.source in builtin_names():
        _merge(robot, table, _builtin_table(robot), f"{robot.source}.toml")
    if file is not None:
        _merge(robot, table, file, str(file.resolve()))
    for follower in robot.followers:
        _tighten(table[follower.master], follower)
    for entry in robot.entries:
        for quantity in REQUIRED:
            if quantity not in table[entry.name] and not (
                quantity == "position" and entry.kind == "continuous"
            ):
                raise MissingLimit(entry.name, quantity, robot.source)
    shares = dict.fromkeys(WITH_MARGIN, DEFAULT_MARGIN) | (
        {} if file is None else _stated_margin(file)
    )
    if margin is not None:
        shares = dict.fromkeys(WITH_MARGIN, margin)
    return dataclasses.replace(_assemble(robot, table), margin=shares)


def from_sources(
    robot: Robot, stated: Limits, file: Path | None = None, folder: Path | None = None
) -> Limits:
    """Resolve again, from their sources, the limits that a trajectory states.

    Args:
        robot: The robot of the trajectory.
        stated: The limits of its file; only their sources are used.
        file: Where the limits file is now; None: where the sources say, or of that name in `folder`.
        folder: The trajectory's own folder.

    Raises:
        UnusableInput: The limits file that a source names is not there, or cannot be read.
    """
    known = {"", "urdf", DERIVED, f"{robot.source}.toml"}
    named = sorted(
        {
            text
            for texts in stated.sources.values()
            for text in texts
            if text not in known and not text.startswith(MIMIC)
        }
    )
    if file is None and named:
        if len(named) > 1:
            raise UnusableInput(
                f"{robot.source}: the limits name several sources ({', '.join(named)}); give the file with --limits"
            )
        candidates = [Path(named[0]), *([] if folder is None else [folder / Path(named[0]).name])]
        file = next((path for path in candidates if path.is_file()), None)
        if file is None:
            raise UnusableInput(
                f"{named[0]}: the limits file of this trajectory is not there; say where it is with --limits FILE"
            )
    return resolve(robot, file)


def mounting_plane(robot: Robot) -> float | None:
    """Height of the plane that a built-in model's base stands on, in the base frame [m]; None where no built-in table states it."""
    if robot.source not in builtin_names():
        return None
    table = tomllib.loads(_read_text(_builtin_table(robot)))
    floor = table.get("mounting", {}).get("floor")
    return None if floor is None else float(floor)


def _builtin_table(robot: Robot) -> Path:
    return Path(str(resources.files("excite.robot") / "models" / f"{robot.source}.toml"))


def _stated_margin(file: Path) -> dict[str, float]:
    """The [margin] table of a TOML limits file; empty where there is none."""
    if file.suffix in (".yaml", ".yml"):
        return {}
    stated = tomllib.loads(_read_text(file)).get("margin", {})
    if not isinstance(stated, dict) or set(stated) - set(WITH_MARGIN):
        raise UnusableInput(f"{file}: [margin] should hold {', '.join(WITH_MARGIN)}; correct it")
    for kind, share in stated.items():
        if not isinstance(share, int | float) or isinstance(share, bool) or not 0.0 <= share < 1.0:
            raise UnusableInput(
                f"{file}: [margin] {kind} = {share!r} should be a share of the limit, at least 0 and below 1"
            )
    return {kind: float(share) for kind, share in stated.items()}


def _tighten(entries: dict[str, tuple[Any, str]], follower: Follower) -> None:
    """A mimic's own position and velocity limits bind the joint it follows: q_mimic = multiplier q + offset."""
    stated, factor = follower.entry, follower.multiplier
    if factor == 0.0:
        return
    source = f"{MIMIC}{stated.name}"
    if stated.position is not None:
        ends = sorted((bound - follower.offset) / factor for bound in stated.position)
        lower, upper = entries.get("position", ((-np.inf, np.inf), ""))[0]
        if ends[0] > lower or ends[1] < upper:
            entries["position"] = ((max(ends[0], lower), min(ends[1], upper)), source)
    if (
        stated.velocity is not None
        and stated.velocity / abs(factor) < entries.get("velocity", (np.inf, ""))[0]
    ):
        entries["velocity"] = (stated.velocity / abs(factor), source)


def _assemble(robot: Robot, table: Mapping[str, Mapping[str, tuple[Any, str]]]) -> Limits:
    def values(quantity: str, absent: Any) -> Array:
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
    robot: Robot, table: dict[str, dict[str, tuple[Any, str]]], file: Path, source: str
) -> None:
    stated = _read_yaml(file) if file.suffix in (".yaml", ".yml") else _read_toml(file)
    known = {*robot.options["locked"], *robot.joints, *robot.mimics}  # type: ignore[misc]
    for joint, entries in stated.items():
        if joint not in known:
            if file.suffix == ".toml":
                raise UnusableInput(
                    f"{file}: no joint '{joint}' in {robot.source}; there are: {', '.join(robot.joints)}"
                )
            warnings.warn(
                f"{file}: joint '{joint}' is not in {robot.source}; ignored",
                ExciteWarning,
                stacklevel=4,
            )
        if joint in table:
            table[joint].update(
                {q: (_checked(file, joint, q, value), source) for q, value in entries.items()}
            )


def _read_text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UnusableInput(
            f"{file}: cannot be read as a limits file ({error}); give a TOML or MoveIt YAML"
        ) from error


def _read_toml(file: Path) -> dict[str, dict[str, Any]]:
    try:
        joints = tomllib.loads(_read_text(file)).get("joints")
    except tomllib.TOMLDecodeError as error:
        raise UnusableInput(f"{file}: is not valid TOML ({error}); correct it") from error
    if not isinstance(joints, dict) or not all(
        isinstance(entry, dict) for entry in joints.values()
    ):
        raise UnusableInput(
            f"{file}: has no [joints.<name>] tables; write one per joint, e.g. [joints.elbow] velocity = 2.0"
        )
    for joint, entries in joints.items():
        unknown = set(entries) - {*QUANTITIES, "braking"}
        if unknown:
            raise UnusableInput(
                f"{file}: joint '{joint}' has an unknown key '{min(unknown)}'; known are {', '.join(QUANTITIES)}, braking"
            )
    return joints


def _yaml_loader() -> Any:
    """The safe loader, and the tags !degrees and !radians that Universal Robots' own files use."""
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        pass

    for tag, unit in (("!degrees", math.pi / 180.0), ("!radians", 1.0)):
        Loader.add_constructor(
            tag, lambda loader, node, unit=unit: unit * float(loader.construct_scalar(node))
        )
    return Loader


def _read_yaml(file: Path) -> dict[str, dict[str, Any]]:
    """MoveIt's joint_limits.yaml: has_<x>_limits switches and max_<x> values, min/max_position."""
    import yaml

    try:
        document = yaml.load(_read_text(file), _yaml_loader())
        joints = dict(document["joint_limits"])
    except (yaml.YAMLError, TypeError, KeyError, ValueError) as error:
        raise UnusableInput(
            f"{file}: is no MoveIt joint_limits.yaml (a 'joint_limits:' map); correct it"
        ) from error
    out: dict[str, dict[str, Any]] = {}
    for joint, entry in joints.items():
        if not isinstance(entry, dict):
            raise UnusableInput(
                f"{file}: joint '{joint}' has no map of limits; write has_velocity_limits, max_velocity, …"
            )
        found: dict[str, Any] = {}
        for quantity, key in (
            ("velocity", "velocity"),
            ("acceleration", "acceleration"),
            ("jerk", "jerk"),
            ("torque", "effort"),
        ):
            if entry.get(f"has_{key}_limits") and f"max_{key}" in entry:
                found[quantity] = entry[f"max_{key}"]
        if entry.get("has_position_limits") and "min_position" in entry and "max_position" in entry:
            found["position"] = [entry["min_position"], entry["max_position"]]
        out[str(joint)] = found
    return out


def _checked(file: Path, joint: str, quantity: str, value: Any) -> Any:
    """One stated value as numbers that make sense, or the line that says why not."""
    where = f"{file}: joint '{joint}': {quantity}"
    try:
        if quantity == "braking":
            return _sensible(_braking(value))
        if any(isinstance(v, (bool, str)) for v in (value if isinstance(value, list) else [value])):
            raise ValueError("not a number")
        numbers = np.array(value, float)
    except (TypeError, ValueError, KeyError, IndexError) as error:
        raise UnusableInput(
            f"{where} = {value!r} is no limit; write e.g. {_EXAMPLES.get(quantity, '3.0')}"
        ) from error
    if quantity == "position":
        if numbers.shape != (2,) or np.isnan(numbers).any():
            raise UnusableInput(f"{where} = {value!r} should be [lower, upper]")
        if not numbers[0] < numbers[1]:
            raise UnusableInput(
                f"{where} limits contradict each other: lower {numbers[0]:g} is not below upper {numbers[1]:g}; swap or widen them"
            )
        if np.isfinite(numbers).sum() == 1:
            raise UnusableInput(f"{where} = {value!r} is open at one end; give both bounds")
        return (float(numbers[0]), float(numbers[1]))
    if numbers.shape != () or not numbers > 0.0:
        raise UnusableInput(f"{where} = {value!r} should be one positive number")
    if not np.isfinite(numbers).all() and quantity in REQUIRED:
        raise UnusableInput(
            f"{where} = {value!r} is not finite; give a number, the design needs it"
        )
    return float(numbers)
