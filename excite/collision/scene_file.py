"""Scenes: surroundings and tools of a robot from a TOML file, and cells built from them.

    floor = -0.75                    # height [m], or false for none
    clearance = 0.03                 # [m]

    [[box]]                          # or sphere, capsule, cylinder, mesh
    name = "table"
    size = [1.2, 0.8, 0.05]          # radius and length of round shapes; file and scale of a mesh
    position = [0.5, 0.0, -0.025]    # [m]
    rotation = [0.0, 0.0, 0.0]       # roll, pitch, yaw [rad]
    link = "tool0"                   # fixed to a link, in its frame; else fixed in the base frame
    ignore = ["base_link"]           # bodies that it may touch

The path of a mesh is relative to the scene file.
"""

from __future__ import annotations

import os.path
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.inertial_parameters import spread_poses
from ..robot.limits import Limits, mounting_plane
from ..robot.robot import Robot
from ..schemas.document_file import DocumentFile
from ..schemas.scene import MeshEntry, SceneFile, ShapeEntry
from . import capsule_cover, geometry, urdf_geometry, workcell
from .batch_kinematics import KinematicTree
from .geometry import SIZE_KEYS, Shape, ShapeKind
from .workcell import Cell, Recipe

KINDS = tuple(kind.value for kind in SIZE_KEYS)
"""Kinds of shapes that a scene file may hold."""
POSES = 200
"""Poses, spread over the position ranges, by which a hanging robot is recognized."""
HANGING_SHARE = 0.95
"""Share of poses that reach below the assumed floor above which the robot counts as hanging [1]."""
GRAVITY_TOLERANCE = 1e-6
"""Horizontal over total gravity above which the base is not level [1]."""


@dataclass(frozen=True)
class Scene:
    """Shapes around the robot and on it.

    Attributes:
        shapes: The shapes.
        ignored: Pairs of a shape of the scene and a body that it may touch.
        floor: Height of the floor [m]; False: no floor; None: not stated.
        clearance: Clearance [m], None: not stated.
        source: File that states the shapes, for messages.
        disabled: Pairs of bodies that an SRDF allows to touch.
        file: Absolute path of the scene file, None without one.
        srdf: Absolute path of the SRDF, None without one.
        options: Floor and clearance that options of the command state.
    """

    shapes: tuple[Shape, ...] = ()
    ignored: tuple[tuple[str, str], ...] = ()
    floor: float | bool | None = None
    clearance: float | None = None
    source: str = "scene"
    disabled: tuple[tuple[str, str], ...] = ()
    file: str | None = None
    srdf: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def overridden(
        self, floor: float | bool | None = None, clearance: float | None = None
    ) -> Scene:
        """Return the scene with another floor or clearance; None keeps the stated one."""
        stated = {
            key: value
            for key, value in (("floor", floor), ("clearance", clearance))
            if value is not None
        }
        return replace(self, options={**self.options, **stated}, **stated)  # type: ignore[arg-type]

    def with_srdf(self, path: Path) -> Scene:
        """Return the scene with the pairs of links that an SRDF disables."""
        disabled = urdf_geometry.disabled_pairs(path)
        return replace(self, disabled=disabled, srdf=str(path.resolve()))

    def recipe(self, packages: Sequence[str]) -> Recipe:
        """Return the files and options from which the cell of this scene can be built again."""
        folders = tuple(str(Path(folder).resolve()) for folder in packages)
        stated = (
            {"floor": self.floor, "clearance": self.clearance}
            if self.file is None
            else self.options
        )
        return Recipe(folders, self.file, self.srdf, stated.get("floor"), stated.get("clearance"))


def read(path: Path) -> Scene:
    """Read a scene file.

    Raises:
        UnusableInput: The file is missing, breaks a rule of `schemas.scene`, gives two shapes the
            same name, or names a mesh file that does not exist.
    """
    file = DocumentFile(
        path, "a scene", "correct it", "a TOML file of shapes, [[box]], [[sphere]], …"
    )
    stated = file.converted(file.toml(), SceneFile)
    shapes, ignored = list[Shape](), list[tuple[str, str]]()
    for kind in KINDS:
        for number, entry in enumerate(getattr(stated, kind)):
            shape = _shape(file, kind, number, entry)
            if shape.name in {other.name for other in shapes}:
                raise file.error(
                    f"'{shape.name}' is the name of another shape too", f"{kind}[{number}].name"
                )
            shapes.append(shape)
            ignored += [(shape.name, str(other)) for other in entry.ignore]
    floor = stated.floor if stated.floor is None or stated.floor is False else float(stated.floor)
    clearance = None if stated.clearance is None else float(stated.clearance)
    return Scene(
        tuple(shapes), tuple(ignored), floor, clearance, str(path), file=str(path.resolve())
    )


def _shape(file: DocumentFile, kind: str, number: int, entry: ShapeEntry) -> Shape:
    """Read a shape; without a name it is named after its kind and number in the file."""
    name = str(entry.name or f"{kind} {number + 1}")
    mesh = None
    if isinstance(entry, MeshEntry):
        mesh = file.path.parent / entry.file
        if not os.path.isfile(mesh):
            raise file.error(f"the mesh {mesh} does not exist", f"{kind}[{number}].file")
    position, rotation = (tuple(map(float, values)) for values in (entry.position, entry.rotation))
    return Shape(
        name,
        ShapeKind(kind),
        tuple(map(float, entry.dimensions)),
        position,  # type: ignore[arg-type]
        rotation,  # type: ignore[arg-type]
        None if entry.link is None else str(entry.link),
        None if mesh is None else str(mesh.resolve()),
    )


def find_cell(
    robot: Robot,
    limits: Limits,
    scene: Scene,
    packages: Sequence[str] = (),
    *,
    required: bool = False,
) -> tuple[Cell | None, str]:
    """Build the cell of a robot unless no link has a shape.

    Args:
        robot: The robot.
        limits: Its limits.
        scene: Surroundings and tools.
        packages: Folders of `package://` meshes.
        required: Fail if no link has a shape.

    Returns:
        The cell and ""; or None and a sentence that says why collisions are not checked.

    Raises:
        MissingMesh: A mesh file does not exist.
        UnusableInput: `build_cell` raises it.
    """
    link_shapes = urdf_geometry.read(robot.source, packages)
    if not link_shapes and not required:
        return None, f"{workcell.NOT_CHECKED}: the URDF gives no link a shape"
    return _build(robot, limits, scene, link_shapes, scene.recipe(packages)), ""


def build_cell(robot: Robot, limits: Limits, scene: Scene, packages: Sequence[str] = ()) -> Cell:
    """Build the cell of a robot in a scene.

    Args:
        robot: The robot.
        limits: Its limits.
        scene: Surroundings and tools.
        packages: Folders of `package://` meshes.

    Raises:
        MissingMesh: A mesh file does not exist.
        UnusableInput: No moving link has a shape, names contradict each other, or an object of the
            scene touches a link in every pose.
    """
    link_shapes = urdf_geometry.read(robot.source, packages)
    return _build(robot, limits, scene, link_shapes, scene.recipe(packages))


def rebuild_cell(
    robot: Robot,
    limits: Limits,
    document: Mapping[str, Any],
    packages: Sequence[str] = (),
    ignored: Sequence[tuple[str, str]] = (),
) -> tuple[Cell | None, str | None]:
    """Build the cell that a trajectory states again, from the files as they are now.

    Shapes of links come from the URDF, surroundings and disabled pairs from the scene file and the
    SRDF. Shapes of a scene that was not read from a file come from the document.

    Args:
        robot: The robot of the trajectory.
        limits: Its limits, from their sources.
        document: `Cell.document` of the cell that the motion was designed for.
        packages: Further folders of `package://` meshes.
        ignored: Pairs of bodies that may touch whatever the files say.

    Returns:
        The cell and None; or None and a sentence that says why it cannot be built or how it differs
        from the stated one.
    """
    try:
        cell = _rebuild(robot, limits, document, packages, ignored)
    except UnusableInput as error:
        return None, f"the cell cannot be rebuilt: {error}"
    difference = _difference(document, cell.document())
    return (
        (cell, None)
        if difference is None
        else (None, f"the cell is not the one that the motion was designed for: {difference}")
    )


def files_of_cell(document: Mapping[str, Any]) -> list[str]:
    """Return the scene file, the SRDF and the meshes that a trajectory's cell was built from.

    Args:
        document: `Cell.document` of the cell.
    """
    recipe = document.get("recipe", {})
    stated = (recipe.get("scene"), recipe.get("srdf"), *(s.get("file") for s in document["shapes"]))
    return [str(file) for file in stated if file is not None]


def _rebuild(
    robot: Robot,
    limits: Limits,
    document: Mapping[str, Any],
    packages: Sequence[str],
    ignored: Sequence[tuple[str, str]],
) -> Cell:
    stated = [geometry.from_document(entry) for entry in document["shapes"]]
    disabled = tuple((str(a), str(b)) for a, b in document.get("disabled", ()))
    recipe = Recipe.from_document(document["recipe"]) if "recipe" in document else None
    folders = [*packages, *(recipe.packages if recipe else ())]
    link_shapes = urdf_geometry.read(robot.source, folders)
    if recipe is not None and recipe.scene is not None:
        scene = read(Path(recipe.scene))
    else:
        links = {shape.name for shape in link_shapes}
        shapes = tuple(
            shape
            for shape in stated
            if shape.kind is not ShapeKind.FLOOR and shape.name not in links
        )
        # an SRDF, if there is one, states again which links may touch
        has_srdf = recipe is not None and recipe.srdf is not None
        scene = Scene(
            shapes,
            tuple(pair for pair in disabled if not has_srdf or not links.issuperset(pair)),
        )
    if recipe is not None:
        scene = scene.with_srdf(Path(recipe.srdf)) if recipe.srdf is not None else scene
        scene = scene.overridden(recipe.floor, recipe.clearance)
    else:  # the file is of a version that did not store recipes
        floors = [shape.position[2] for shape in stated if shape.kind is ShapeKind.FLOOR]
        scene = scene.overridden(floors[0] if floors else False, float(document["margin"]))
    scene = replace(scene, ignored=(*scene.ignored, *ignored))
    return _build(robot, limits, scene, link_shapes, recipe)


def _difference(stated: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """Describe the first difference between the documents of two cells; paths of mesh files may
    differ."""

    def numbered(document: Mapping[str, Any]) -> dict[tuple[str, int], dict[str, Any]]:
        out: dict[tuple[str, int], dict[str, Any]] = {}
        for entry in document["shapes"]:
            number = sum(name == entry["name"] for name, _ in out)
            out[entry["name"], number] = {
                key: value for key, value in entry.items() if key != "file"
            }
        return out

    before, after = numbered(stated), numbered(now)
    for name, _ in before.keys() ^ after.keys():
        return f"'{name}' has another number of shapes"
    for (name, number), entry in before.items():
        for key in entry.keys() | after[name, number].keys():
            if entry.get(key) != after[name, number].get(key):
                return f"'{name}' has another {'mesh' if key == 'sha256' else key}"
    if stated["margin"] != now["margin"]:
        return f"the clearance is {now['margin']:g} m, not {stated['margin']:g} m"
    if {frozenset(pair) for pair in stated.get("disabled", ())} != {
        frozenset(pair) for pair in now["disabled"]
    }:
        return "other pairs of bodies may touch"
    return None


def _build(
    robot: Robot,
    limits: Limits,
    scene: Scene,
    link_shapes: Sequence[Shape],
    recipe: Recipe | None,
) -> Cell:
    moving = {
        shape.link
        for shape in link_shapes
        if robot.model.frames[robot.frame(str(shape.link))].parentJoint > 0
    }
    if not moving:
        raise UnusableInput(
            f"{robot.source}: gives no moving link a <collision> shape to check or draw; add "
            "shapes, or design with --no-collision"
        )
    _check_names(robot, scene, link_shapes)
    floor, notes = _floor_height(robot, limits, link_shapes, scene)
    without_shape = [
        link
        for i, link in enumerate(robot.links, 1)
        if link not in moving and robot.model.inertias[i].mass > 0.0
    ]
    notes += [f"no collision shape of {', '.join(without_shape)}"] if without_shape else []
    shapes = [
        *link_shapes,
        *scene.shapes,
        *([] if floor is None else [Shape("floor", ShapeKind.FLOOR, position=(0.0, 0.0, floor))]),
    ]
    clearance = workcell.DEFAULT_CLEARANCE if scene.clearance is None else scene.clearance
    pairs = [*scene.disabled, *scene.ignored]
    return workcell.build(
        robot, limits, shapes, clearance, pairs, notes, recipe, assumed_floor=scene.floor is None
    )


def _check_names(robot: Robot, scene: Scene, link_shapes: Sequence[Shape]) -> None:
    """Raise UnusableInput for a shape of the scene with the name of another body, or that may touch
    a body that does not exist."""
    taken = {"floor", *(shape.name for shape in link_shapes)}
    for shape in scene.shapes:
        if shape.name in taken:
            raise UnusableInput(
                f"{scene.source}: '{shape.name}' is the name of a link or of the floor already; "
                "rename the shape of the scene"
            )
    existing = {
        "floor",
        *(frame.name for frame in robot.model.frames),
        *(shape.name for shape in scene.shapes),
    }
    for name, other in scene.ignored:
        if other not in existing:
            raise UnusableInput(
                f"{scene.source}: '{name}' ignores '{other}', which does not exist; correct its "
                "'ignore'"
            )


def _floor_height(
    robot: Robot, limits: Limits, link_shapes: Sequence[Shape], scene: Scene
) -> tuple[float | None, list[str]]:
    """Determine the height of the floor.

    It is the stated height; else the mounting plane of a built-in robot; else z = 0 or, if lower,
    the lowest point of the fixed links. No floor is assumed where gravity does not point along −z
    or where the robot hangs, which is where nearly all poses reach below the floor.

    Returns:
        The height, None without a floor [m], and notes for the user.
    """
    if scene.floor is False:
        return None, []
    if scene.floor is not None:
        return float(scene.floor), []
    gravity = robot.model.gravity.linear
    horizontal = np.hypot(gravity[0], gravity[1])
    if horizontal > GRAVITY_TOLERANCE * np.linalg.norm(gravity) or gravity[2] >= 0.0:
        return None, [
            "gravity does not point down the base's z axis: no floor is assumed (--floor Z says "
            "where it is)"
        ]
    height = mounting_plane(robot)
    if height is None:
        frames = [robot.model.frames[robot.frame(str(shape.link))] for shape in link_shapes]
        heights = [
            shape.lowest(frame.placement * shape.placement)
            for shape, frame in zip(link_shapes, frames, strict=True)
            if int(frame.parentJoint) == 0
        ]
        height = min([0.0, *heights])
    lowest = _lowest_moving_point(robot, link_shapes, spread_poses(limits, POSES))
    if np.mean(lowest < height) > HANGING_SHARE:
        return None, [
            f"the robot hangs below its base: no floor is assumed at {height:g} m (--floor Z says "
            "where it is)"
        ]
    return height, []


def default_floor(robot: Robot, limits: Limits, link_shapes: Sequence[Shape]) -> float | None:
    """Height of the floor where none is stated [m]; None where none is assumed."""
    return _floor_height(robot, limits, link_shapes, Scene())[0]


def _lowest_moving_point(robot: Robot, link_shapes: Sequence[Shape], q: FloatArray) -> FloatArray:
    """Height of the lowest point of the capsules of links whose height changes with the pose.

    Args:
        robot: The robot.
        link_shapes: Shapes of its links.
        q: Poses. Shape (N, n) [rad or m].

    Returns:
        Heights in the base frame. Shape (N,) [m].
    """
    frames = [robot.model.frames[robot.frame(str(shape.link))] for shape in link_shapes]
    covers = [
        (
            int(frame.parentJoint),
            capsule.transformed(frame.placement.rotation, frame.placement.translation),
        )
        for shape, frame in zip(link_shapes, frames, strict=True)
        if int(frame.parentJoint) > 0
        for capsule in capsule_cover.cover_with_capsules(shape)
    ]
    joint = np.array([joint for joint, _ in covers])
    ends = np.array([(capsule.begin, capsule.end) for _, capsule in covers])
    radius = np.array([capsule.radius for _, capsule in covers])
    R, p = KinematicTree.from_robot(robot).poses(q)
    end_heights = np.einsum("nci,cei->nce", R[:, joint, 2], ends) + p[:, joint, 2, None]
    heights = end_heights.min(axis=2) - radius
    changes = np.ptp(heights, axis=0) > workcell.CONSTANT_DISTANCE
    return np.asarray(heights[:, changes].min(axis=1, initial=np.inf))
