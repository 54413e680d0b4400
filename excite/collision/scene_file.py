"""What stands around a robot, and what it carries: a TOML file, a floor, and where the floor is if
nobody says.

[[box]]                      # or sphere, capsule, cylinder, mesh name = "table" size = [1.2, 0.8,
0.05]      # radius, length of the round ones; file, scale of a mesh, beside the scene file position
= [0.5, 0.0, -0.025] rotation = [0.0, 0.0, 0.0]   # roll, pitch, yaw [rad] link = "tool0"
# fixed to a link, in its frame: a tool; without it, fixed in the base frame ignore = ["base_link"]
# bodies that it may touch

floor = -0.75                # or false
clearance = 0.03
"""

from __future__ import annotations

import os.path
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UnusableInput
from ..robot.inertial_parameters import spread_poses
from ..robot.limits import Limits, mounting_plane
from ..robot.robot import Robot
from ..schemas.document_file import DocumentFile
from ..schemas.scene import Mesh, SceneFile, StatedShape
from . import batch_kinematics, capsule_cover, urdf_geometry
from . import geometry as shape_documents
from . import workcell as cells
from .geometry import WORDS, Kind, Shape
from .workcell import Cell, Recipe

Array = np.ndarray
KINDS = tuple(kind.value for kind in WORDS)
POSES = 200
HANGING = 0.95
"""Share of random poses that reach below the assumed floor, from which on the robot is taken to
hang [1]."""


@dataclass(frozen=True)
class Scene:
    """Shapes around the robot and on it. floor: its height [m]; False: none; None: not said.
    clearance: [m], None: not said.

    ignored: a shape and a body that it may touch. disabled: pairs of bodies besides, by an SRDF.
        source: the file that says so. file, srdf: absolute paths of the scene file and of the SRDF,
        None without. options: floor and clearance that options state.
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
        """The scene with another floor or clearance than its file states; None leaves one as it
        is."""
        said = {
            key: value
            for key, value in (("floor", floor), ("clearance", clearance))
            if value is not None
        }
        return replace(self, options={**self.options, **said}, **said)  # type: ignore[arg-type]

    def with_srdf(self, path: Path) -> Scene:
        """The scene with the pairs of links that an SRDF disables."""
        return replace(self, disabled=urdf_geometry.disabled(path), srdf=str(path.resolve()))

    def recipe(self, packages: Sequence[str]) -> Recipe:
        """How to make the cell of this scene again."""
        folders = tuple(str(Path(folder).resolve()) for folder in packages)
        said = (
            {"floor": self.floor, "clearance": self.clearance}
            if self.file is None
            else self.options
        )
        return Recipe(folders, self.file, self.srdf, said.get("floor"), said.get("clearance"))


def read(path: Path) -> Scene:
    """Read a scene file.

    Raises:
        UnusableInput: The file is missing, breaks a rule of `schemas.scene`, names two shapes
            alike, or names a mesh that is not there.
    """
    file = DocumentFile(
        path, "a scene", "correct it", "a TOML file of shapes, [[box]], [[sphere]], …"
    )
    stated = file.converted(file.toml(), SceneFile)
    shapes, ignored = list[Shape](), list[tuple[str, str]]()
    for kind in KINDS:
        for number, entry in enumerate(getattr(stated, kind)):
            one = _shape(file, kind, number, entry)
            if one.name in {other.name for other in shapes}:
                raise file.error(
                    f"'{one.name}' is the name of another shape too", f"{kind}[{number}].name"
                )
            shapes.append(one)
            ignored += [(one.name, str(other)) for other in entry.ignore]
    floor = stated.floor if stated.floor is None or stated.floor is False else float(stated.floor)
    clearance = None if stated.clearance is None else float(stated.clearance)
    return Scene(
        tuple(shapes), tuple(ignored), floor, clearance, str(path), file=str(path.resolve())
    )


def _shape(file: DocumentFile, kind: str, number: int, entry: StatedShape) -> Shape:
    """A shape of a scene; one without a name is named after its kind and place in the file."""
    name = str(entry.name or f"{kind} {number + 1}")
    mesh = None
    if isinstance(entry, Mesh):
        mesh = file.path.parent / entry.file
        if not os.path.isfile(mesh):
            raise file.error(f"the mesh {mesh} is not there", f"{kind}[{number}].file")
    position, rotation = (tuple(map(float, values)) for values in (entry.position, entry.rotation))
    return Shape(
        name,
        Kind(kind),
        tuple(map(float, entry.dimensions)),
        position,  # type: ignore[arg-type]
        rotation,  # type: ignore[arg-type]
        None if entry.link is None else str(entry.link),
        None if mesh is None else str(mesh.resolve()),
    )


def known(
    robot: Robot,
    limits: Limits,
    scene: Scene,
    packages: Sequence[str] = (),
    *,
    required: bool = False,
) -> tuple[Cell | None, str]:
    """The cell; or, where no link has a shape and nobody required a check, None and a sentence that
    says so.

    Raises MissingMesh for a mesh that is not there, UnusableInput as the parts do.
    """
    own = urdf_geometry.read(robot.source, packages)
    if not own and not required:
        return None, f"{cells.NOT_CHECKED}: the URDF gives no link a shape"
    return _cell(robot, limits, scene, own, scene.recipe(packages)), ""


def cell(robot: Robot, limits: Limits, scene: Scene, packages: Sequence[str] = ()) -> Cell:
    """The robot among what the scene holds.

    Raises MissingMesh or UnusableInput as its parts do; a robot without any shape of a moving link
    has no cell: UnusableInput.
    """
    return _cell(
        robot, limits, scene, urdf_geometry.read(robot.source, packages), scene.recipe(packages)
    )


def as_on_disk(
    robot: Robot, limits: Limits, document: Mapping[str, Any], packages: Sequence[str] = ()
) -> tuple[Cell | None, str | None]:
    """The cell that a trajectory states, made again from the files as they are now.

    The links' shapes come from the URDF, the surroundings and the disabled pairs from the scene
    file and the SRDF. Only shapes of a scene that never was a file are taken from the document
    itself.

    Args:
        robot: The robot of the trajectory.
        limits: Its limits, from their sources.
        document: `Cell.document` of the cell that the motion was designed for.
        packages: Further folders of `package://` meshes.

    Returns:
        The cell and None; or, where it can no longer be made or differs from the stated one, None
        and a sentence that says why.
    """
    try:
        found = _remade(robot, limits, document, packages)
    except UnusableInput as error:
        return None, f"the cell cannot be made again: {error}"
    difference = _difference(document, found.document())
    return (
        (found, None)
        if difference is None
        else (None, f"the cell is not the one that the motion was designed for: {difference}")
    )


def _remade(
    robot: Robot, limits: Limits, document: Mapping[str, Any], packages: Sequence[str]
) -> Cell:
    stated = [shape_documents.from_document(entry) for entry in document["shapes"]]
    disabled = tuple((str(a), str(b)) for a, b in document.get("disabled", ()))
    recipe = Recipe.from_document(document["recipe"]) if "recipe" in document else None
    own = urdf_geometry.read(robot.source, [*packages, *(recipe.packages if recipe else ())])
    if recipe is not None and recipe.scene is not None:
        around = read(Path(recipe.scene))
    else:
        names = {one.name for one in own}
        shapes = tuple(
            one for one in stated if one.kind is not Kind.FLOOR and one.name not in names
        )
        own_pairs = (
            recipe is not None and recipe.srdf is not None
        )  # then the SRDF says which links may touch
        around = Scene(
            shapes, tuple(pair for pair in disabled if not own_pairs or not names.issuperset(pair))
        )
    if recipe is not None:
        around = around.with_srdf(Path(recipe.srdf)) if recipe.srdf is not None else around
        around = around.overridden(recipe.floor, recipe.clearance)
    else:  # written before cells stated how they were made
        floors = [one.position[2] for one in stated if one.kind is Kind.FLOOR]
        around = around.overridden(floors[0] if floors else False, float(document["margin"]))
    return _cell(robot, limits, around, own, recipe)


def _difference(stated: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """The first difference between the documents of two cells, in words; where the mesh files are
    does not matter."""

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


def _cell(
    robot: Robot, limits: Limits, scene: Scene, own: Sequence[Shape], recipe: Recipe | None
) -> Cell:
    moving = {
        one.link for one in own if robot.model.frames[robot.frame(str(one.link))].parentJoint > 0
    }
    if not moving:
        raise UnusableInput(
            f"{robot.source}: gives no moving link a <collision> shape to check or draw; add "
            "shapes, or design with --no-collision"
        )
    _check_names(robot, scene, own)
    floor, notes = _floor_height(robot, limits, own, scene)
    bare = [
        link
        for i, link in enumerate(robot.links, 1)
        if link not in moving and robot.model.inertias[i].mass > 0.0
    ]
    notes += [f"no shape is known of {', '.join(bare)}"] if bare else []
    shapes = [
        *own,
        *scene.shapes,
        *([] if floor is None else [Shape("floor", Kind.FLOOR, position=(0.0, 0.0, floor))]),
    ]
    clearance = cells.MARGIN if scene.clearance is None else scene.clearance
    pairs = [*scene.disabled, *scene.ignored]
    return cells.build(
        robot, limits, shapes, clearance, pairs, notes, recipe, assumed_floor=scene.floor is None
    )


def _check_names(robot: Robot, scene: Scene, own: Sequence[Shape]) -> None:
    """Raise UnusableInput for a shape of the scene that has the name of another body, or that may
    touch what there is not."""
    taken = {"floor", *(one.name for one in own)}
    for one in scene.shapes:
        if one.name in taken:
            raise UnusableInput(
                f"{scene.source}: '{one.name}' is the name of a link or of the floor already; "
                "rename the shape of the scene"
            )
    there = {
        "floor",
        *(frame.name for frame in robot.model.frames),
        *(one.name for one in scene.shapes),
    }
    for name, other in scene.ignored:
        if other not in there:
            raise UnusableInput(
                f"{scene.source}: '{name}' may touch '{other}', which there is not; correct its "
                "'ignore'"
            )


def _floor_height(
    robot: Robot, limits: Limits, own: Sequence[Shape], scene: Scene
) -> tuple[float | None, list[str]]:
    """The stated floor; else a built-in model's mounting plane; else z = 0 or, if lower, the exact
    lowest point of the links that stand.

    No floor is assumed where gravity does not point down, or where nearly all poses reach below it:
    that robot hangs.
    """
    if scene.floor is False:
        return None, []
    if scene.floor is not None:
        return float(scene.floor), []
    gravity = robot.model.gravity.linear
    if np.hypot(gravity[0], gravity[1]) > 1e-6 * np.linalg.norm(gravity) or gravity[2] >= 0.0:
        return None, [
            "gravity does not point down the base's z axis: no floor is assumed (--floor Z says "
            "where it is)"
        ]
    height = mounting_plane(robot)
    if height is None:
        frames = [robot.model.frames[robot.frame(str(one.link))] for one in own]
        fixed = [
            (one, frame.placement)
            for one, frame in zip(own, frames, strict=True)
            if int(frame.parentJoint) == 0
        ]
        height = min([0.0, *(one.lowest(placement * one.placement) for one, placement in fixed)])
    if np.mean(_lowest_moving(robot, own, spread_poses(limits, POSES)) < height) > HANGING:
        return None, [
            f"the robot hangs below its base: no floor is assumed at {height:g} m (--floor Z says "
            "where it is)"
        ]
    return height, []


def _lowest_moving(robot: Robot, own: Sequence[Shape], q: Array) -> Array:
    """Height of the lowest point of the capsule covers of the links that rise and fall, at many
    poses. Shapes (N, n) -> (N,) [m]."""
    frames = [robot.model.frames[robot.frame(str(one.link))] for one in own]
    covers = [
        (
            int(frame.parentJoint),
            capsule.moved(frame.placement.rotation, frame.placement.translation),
        )
        for one, frame in zip(own, frames, strict=True)
        if int(frame.parentJoint) > 0
        for capsule in capsule_cover.capsules(one)
    ]
    joint = np.array([joint for joint, _ in covers])
    ends, radius = (
        np.array([(one.begin, one.end) for _, one in covers]),
        np.array([one.radius for _, one in covers]),
    )
    R, p = batch_kinematics.of(robot).poses(q)
    above = np.einsum("nci,cei->nce", R[:, joint, 2], ends) + p[:, joint, 2, None]
    heights = above.min(axis=2) - radius
    return np.asarray(
        heights[:, np.ptp(heights, axis=0) > cells.CONSTANT].min(axis=1, initial=np.inf)
    )
