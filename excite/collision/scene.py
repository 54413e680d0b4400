"""What stands around a robot, and what it carries: a TOML file, a floor, and where the floor is if nobody says.

[[box]]                      # or sphere, capsule, cylinder, mesh
name = "table"
size = [1.2, 0.8, 0.05]      # radius, length of the round ones; file, scale of a mesh, beside the scene file
position = [0.5, 0.0, -0.025]
rotation = [0.0, 0.0, 0.0]   # roll, pitch, yaw [rad]
link = "tool0"               # fixed to a link, in its frame: a tool; without it, fixed in the base frame
ignore = ["base_link"]       # bodies that it may touch

floor = -0.75                # or false
clearance = 0.03
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UnusableInput
from ..limits import Limits
from ..parameters import spread_poses
from ..robot import Robot
from . import cell as cells
from . import chain, cover, links
from .cell import Cell
from .shape import WORDS, Kind, Shape

Array = np.ndarray
KINDS = tuple(kind.value for kind in WORDS)
PLACING = {"name", "position", "rotation", "link", "ignore"}
POSES = 200


@dataclass(frozen=True)
class Scene:
    """Shapes around the robot and on it. floor: its height [m]; False: none; None: not said. clearance: [m], None: not said.

    ignored: a shape and a body that it may touch. disabled: pairs of bodies besides, by an SRDF. source: the file that says so.
    """

    shapes: tuple[Shape, ...] = ()
    ignored: tuple[tuple[str, str], ...] = ()
    floor: float | bool | None = None
    clearance: float | None = None
    source: str = "scene"
    disabled: tuple[tuple[str, str], ...] = ()


def read(path: Path) -> Scene:
    """Read a scene file. Raises UnusableInput that names the entry and what is wrong with it."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UnusableInput(f"{path}: cannot be read as a scene ({error}); give a TOML file") from error
    unknown = set(table) - {*KINDS, "floor", "clearance"}
    if unknown:
        raise UnusableInput(f"{path}: '{min(unknown)}' is nothing a scene has; it has {', '.join(KINDS)}, floor and clearance")
    shapes, ignored = list[Shape](), list[tuple[str, str]]()
    for kind in KINDS:
        for number, entry in enumerate(_list(path, kind, table.get(kind, []))):
            one = _shape(path, kind, entry, f"{kind} {number + 1}")
            if one.name in {other.name for other in shapes}:
                raise UnusableInput(f"{path}: two shapes are named '{one.name}'; rename one")
            shapes.append(one)
            ignored += [(one.name, str(other)) for other in _list(path, f"{one.name}: ignore", entry.get("ignore", []))]
    clearance = _positive(path, "clearance", table.get("clearance"))
    return Scene(tuple(shapes), tuple(ignored), _floor(path, table.get("floor")), clearance, str(path))


def _list(path: Path, what: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise UnusableInput(f"{path}: {what} should be a list; write [[{what}]]")
    return value


def _floor(path: Path, value: Any) -> float | bool | None:
    if value is None or value is False:
        return value
    return _vector(path, "floor", [value], 1)[0]


def _positive(path: Path, what: str, value: Any) -> float | None:
    if value is None:
        return None
    number = _vector(path, what, [value], 1)[0]
    if number < 0.0:
        raise UnusableInput(f"{path}: {what} = {value} should be 0 or more metres")
    return number


def _shape(path: Path, kind: str, entry: Any, unnamed: str) -> Shape:
    if not isinstance(entry, Mapping):
        raise UnusableInput(f"{path}: {unnamed} is no table; write [[{kind}]]")
    name = str(entry.get("name", unnamed))
    words = WORDS[Kind(kind)]
    own = PLACING | {*words} | ({"file"} if kind == "mesh" else set())
    unknown = set(entry) - own
    if unknown:
        raise UnusableInput(f"{path}: '{name}': a {kind} has no '{min(unknown)}'; it has {', '.join(sorted(own))}")
    file = None
    if kind == "mesh":
        file = path.parent / str(entry.get("file", ""))
        if not file.is_file():
            raise UnusableInput(f"{path}: '{name}': its mesh {file} is not there; correct 'file'")
        size = _vector(path, f"'{name}': scale", entry.get("scale", [1.0, 1.0, 1.0]), 3)
    elif kind == "box":
        size = _vector(path, f"'{name}': size", entry.get("size"), 3)
    else:
        size = _vector(path, f"'{name}': {' and '.join(words)}", [entry.get(word) for word in words], len(words))
    if min(size) <= 0.0:
        raise UnusableInput(f"{path}: '{name}': its size {list(size)} should be positive")
    position, rotation = (_vector(path, f"'{name}': {key}", entry.get(key, [0.0] * 3), 3) for key in ("position", "rotation"))
    link = entry.get("link")
    return Shape(
        name, Kind(kind), size, position, rotation,  # type: ignore[arg-type]
        None if link is None else str(link), None if file is None else str(file.resolve()),
    )  # fmt: skip


def _vector(path: Path, what: str, value: Any, count: int) -> tuple[float, ...]:
    numbers = isinstance(value, list) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in value)
    if not numbers or len(value) != count or not np.isfinite(value).all():
        raise UnusableInput(f"{path}: {what} should be {count} finite number(s), not {value}")
    return tuple(float(v) for v in value)


def known(robot: Robot, limits: Limits, scene: Scene, packages: Sequence[str] = (), *, required: bool = False) -> tuple[Cell | None, str]:
    """The cell; or, where the robot's shapes are not known and nobody required a check, None and a sentence that says so."""
    try:
        own = links.read(robot.source, packages)
    except links.MissingMesh as error:
        if required:
            raise
        return None, f"{cells.NOT_CHECKED}: {error}"
    if not own and not required:
        return None, f"{cells.NOT_CHECKED}: the URDF gives no link a shape"
    return _cell(robot, limits, scene, own), ""


def cell(robot: Robot, limits: Limits, scene: Scene, packages: Sequence[str] = ()) -> Cell:
    """The robot among what the scene holds.

    Raises MissingMesh or UnusableInput as its parts do; a robot without any shape of a moving link has no cell: UnusableInput.
    """
    return _cell(robot, limits, scene, links.read(robot.source, packages))


def _cell(robot: Robot, limits: Limits, scene: Scene, own: Sequence[Shape]) -> Cell:
    moving = {one.link for one in own if robot.model.frames[robot.frame(str(one.link))].parentJoint > 0}
    if not moving:
        raise UnusableInput(
            f"{robot.source}: gives no moving link a <collision> shape to check or draw; add shapes, or design with --no-collision"
        )
    _check_names(robot, scene, own)
    floor, notes = _floor_height(robot, limits, own, scene)
    bare = [link for i, link in enumerate(robot.links, 1) if link not in moving and robot.model.inertias[i].mass > 0.0]
    notes += [f"no shape is known of {', '.join(bare)}"] if bare else []
    shapes = [*own, *scene.shapes, *([] if floor is None else [Shape("floor", Kind.FLOOR, position=(0.0, 0.0, floor))])]
    clearance = cells.MARGIN if scene.clearance is None else scene.clearance
    return cells.build(robot, limits, shapes, clearance, [*scene.disabled, *scene.ignored], notes)


def _check_names(robot: Robot, scene: Scene, own: Sequence[Shape]) -> None:
    """Raise UnusableInput for a shape of the scene that has the name of another body, or that may touch what there is not."""
    taken = {"floor", *(one.name for one in own)}
    for one in scene.shapes:
        if one.name in taken:
            raise UnusableInput(
                f"{scene.source}: '{one.name}' is the name of a link or of the floor already; rename the shape of the scene"
            )
    there = {"floor", *(frame.name for frame in robot.model.frames), *(one.name for one in scene.shapes)}
    for name, other in scene.ignored:
        if other not in there:
            raise UnusableInput(f"{scene.source}: '{name}' may touch '{other}', which there is not; correct its 'ignore'")


def _floor_height(robot: Robot, limits: Limits, own: Sequence[Shape], scene: Scene) -> tuple[float | None, list[str]]:
    """The stated floor; else the base frame's origin or, if that is lower, the lowest point of the links that stand.

    No floor is guessed where gravity does not point down, or where nearly all poses reach below it: that robot hangs.
    """
    if scene.floor is False:
        return None, []
    if scene.floor is not None:
        return float(scene.floor), []
    gravity = robot.model.gravity.linear
    if np.hypot(gravity[0], gravity[1]) > 1e-6 * np.linalg.norm(gravity) or gravity[2] >= 0.0:
        return None, ["gravity does not point down the base's z axis: no floor is assumed (--floor Z says where it is)"]
    heights, moves = _heights(robot, own, spread_poses(limits, POSES))
    height = float(heights[0, ~moves].min(initial=0.0))
    if np.mean(heights[:, moves].min(axis=1) < height) > 0.95:
        return None, [f"the robot hangs below its base: no floor is assumed at {height:g} m (--floor Z says where it is)"]
    return height, []


def _heights(robot: Robot, own: Sequence[Shape], q: Array) -> tuple[Array, Array]:
    """Heights of the lowest points of covers of the links at many poses, and which move. Shapes (N, n) -> (N, C) [m], (C,)."""
    frames = [robot.model.frames[robot.frame(str(one.link))] for one in own]
    covers = [
        (int(frame.parentJoint), capsule.moved(frame.placement.rotation, frame.placement.translation))
        for one, frame in zip(own, frames, strict=True)
        for capsule in cover.capsules(one)
    ]
    joint = np.array([joint for joint, _ in covers])
    ends, radius = np.array([(one.begin, one.end) for _, one in covers]), np.array([one.radius for _, one in covers])
    R, p = chain.of(robot).poses(q)
    above = np.einsum("nci,cei->nce", R[:, joint, 2], ends) + p[:, joint, 2, None]
    return above.min(axis=2) - radius, joint > 0
