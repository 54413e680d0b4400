"""Work cell of a robot: all bodies, the pairs that must keep a distance, and how large it is."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.inertial_parameters import ranges, spread_poses
from ..robot.limits import Limits
from ..robot.robot import Robot
from . import contact_exclusion, urdf_geometry
from .distance_query import Body, BodyPair, DistanceQuery, group_bodies
from .geometry import Shape, ShapeKind

NOT_CHECKED = "collision not checked"
DEFAULT_CLEARANCE = 0.02
"""Clearance unless another is stated [m]."""
POSES = 400
"""Poses, spread over the position ranges, at which pairs are classified."""
CONTACT_SHARE = 0.95
"""Share of poses in contact from which a pair of links counts as in contact by construction [1]."""
SCREENING_POSES = 40
"""Number of the first poses at which all pairs are evaluated; the others, only for near pairs."""
NEAR_RATIO = 2.0
"""Distance over the margin below which a pair counts as near at a pose [1]."""
NEAR_SHARE = 0.25
"""Share of the screening poses above which a near pair is evaluated at all poses [1]."""
MIN_LINK_DISTANCE = 1e-3
"""Distance that links with up to two joints between them must keep at least [m]."""
MIN_MESH_DISTANCE = 5e-3
"""The same for meshes, whose grid of configurations is coarser [m]."""
CONSTANT_DISTANCE = 1e-4
"""Variation over all poses below which a distance does not depend on the motion [m]: right angles
that a URDF rounds to four decimals tilt a link of 1 m by 0.05 mm."""
GRID_STEPS = 24
"""Configurations per joint at which links with up to two joints between them are evaluated, for
their usual distance."""
MESH_GRID_STEPS = 9
"""The same for meshes, whose distances take longer."""


@dataclass(frozen=True)
class ExceptedPair:
    """A pair of bodies that is not held to the clearance.

    Attributes:
        first: Name of a body.
        second: Name of the other body.
        why: Reason, as a trajectory states it.
    """

    first: str
    second: str
    why: str


@dataclass(frozen=True)
class Recipe:
    """Files and options from which a cell was built, to build it again from the files on disk.

    Attributes:
        packages: Folders of `package://` meshes.
        scene: Absolute path of the scene file, None without one.
        srdf: Absolute path of the SRDF, None without one.
        floor: Height of the floor that an option states [m]; False: no floor; None: not stated.
        clearance: Clearance that an option states [m], None: not stated.
    """

    packages: tuple[str, ...] = ()
    scene: str | None = None
    srdf: str | None = None
    floor: float | bool | None = None
    clearance: float | None = None

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Recipe:
        """Read the result of `dataclasses.asdict`."""
        return Recipe(**{**document, "packages": tuple(document.get("packages", ()))})


@dataclass(frozen=True, eq=False)
class Cell:
    """A robot and its surroundings. It is hashed by identity, so that results can be cached.

    Attributes:
        robot: The robot.
        limits: Its limits.
        bodies: Links, tools and surroundings.
        pairs: Pairs of bodies that must keep a distance.
        excepted: Pairs that need not keep the clearance, with reasons.
        margin: Clearance [m].
        disabled: Names of bodies that may touch.
        notes: Remarks for the user.
        recipe: Files and options that it was built from; None if it cannot be built again.
        assumed_floor: True if the height of the floor was not stated.
        pose: Pose in which all pairs keep twice their margin, near which the robot moves; None:
            anywhere in its ranges. Shape (n,).
    """

    robot: Robot
    limits: Limits
    bodies: tuple[Body, ...]
    pairs: tuple[BodyPair, ...]
    excepted: tuple[ExceptedPair, ...]
    margin: float
    disabled: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    recipe: Recipe | None = None
    assumed_floor: bool = False
    pose: FloatArray | None = None

    def floor_is_assumed(self, bodies: Sequence[Body]) -> bool:
        """Return True if one of the bodies is a floor whose height was not stated."""
        return self.assumed_floor and any(
            shape.kind is ShapeKind.FLOOR for body in bodies for shape in body.shapes
        )

    @property
    def floor(self) -> float | None:
        """Height of the floor in the base frame [m], None without one."""
        heights = [
            shape.position[2]
            for body in self.bodies
            for shape in body.shapes
            if shape.kind is ShapeKind.FLOOR
        ]
        return heights[0] if heights else None

    def floor_words(self) -> str:
        """Describe the height of the floor."""
        return (
            "no floor" if self.floor is None else f"floor at z = {round(self.floor, 6) + 0.0:g} m"
        )

    def names(self, pair: BodyPair) -> str:
        """Name both bodies of a pair."""
        return f"{self.bodies[pair.first].name} – {self.bodies[pair.second].name}"

    def distance_query(self) -> DistanceQuery:
        """Build a query for the distances of all pairs."""
        return DistanceQuery(self.robot, self.bodies, self.pairs, 2.0 * self.margin)

    def document(self) -> dict[str, Any]:
        """Entry of the cell in a trajectory file; `scene_file.rebuild_cell` reads it."""
        return {
            "margin": self.margin,
            "shapes": [shape.document() for body in self.bodies for shape in body.shapes],
            "disabled": [list(pair) for pair in self.disabled],
            "excepted": [dataclasses.asdict(pair) for pair in self.excepted],
            "notes": list(self.notes),
            **({} if self.recipe is None else {"recipe": dataclasses.asdict(self.recipe)}),
        }


def build(
    robot: Robot,
    limits: Limits,
    shapes: Sequence[Shape],
    margin: float = DEFAULT_CLEARANCE,
    disabled: Sequence[tuple[str, str]] = (),
    notes: Sequence[str] = (),
    recipe: Recipe | None = None,
    *,
    assumed_floor: bool = False,
) -> Cell:
    """Place shapes and select the pairs of bodies that must keep a distance.

    Args:
        robot: The robot.
        limits: Its limits; pairs are classified over its position ranges.
        shapes: Shapes of links, tools and surroundings.
        margin: Clearance [m].
        disabled: Names of bodies that may touch.
        notes: Remarks for the user.
        recipe: Files and options that the shapes come from.
        assumed_floor: The height of the floor was not stated.

    Raises:
        UnusableInput: A link does not exist, the margin is no distance, or an object of the
            surroundings touches a link in every pose.
    """
    if not (np.isfinite(margin) and margin >= 0.0):
        raise UnusableInput(f"--clearance {margin:g} should be 0 or more metres")
    unpaired = Cell(
        robot,
        limits,
        group_bodies(robot, shapes),
        (),
        (),
        margin,
        tuple(disabled),
        tuple(notes),
        recipe,
        assumed_floor,
    )
    candidates, left_out = _movable_pairs(unpaired)
    pairs, excepted = _classify_pairs(dataclasses.replace(unpaired, pairs=tuple(candidates)))
    return dataclasses.replace(unpaired, pairs=tuple(pairs), excepted=(*left_out, *excepted))


def _movable_pairs(cell: Cell) -> tuple[list[BodyPair], list[ExceptedPair]]:
    """Return the pairs of bodies that move relative to each other, those of them apart that are
    neighbouring links or disabled."""
    pairs, excepted = list[BodyPair](), list[ExceptedPair]()
    disabled = {frozenset(pair) for pair in cell.disabled}
    neighbours = urdf_geometry.neighbouring_links(
        cell.robot.source, {body.name for body in cell.bodies if body.is_link}
    )
    for (i, first), (k, second) in itertools.combinations(enumerate(cell.bodies), 2):
        if first.joint == second.joint:
            continue
        names = frozenset((first.name, second.name))
        if names in disabled:
            excepted.append(ExceptedPair(first.name, second.name, "allowed to touch"))
        elif names in neighbours:
            excepted.append(ExceptedPair(first.name, second.name, "joined by one joint"))
        else:
            pairs.append(BodyPair(i, k, cell.margin))
    return pairs, excepted


def _classify_pairs(cell: Cell) -> tuple[list[BodyPair], list[ExceptedPair]]:
    """Select the pairs that keep the margin, a reduced margin, or none, by their distances over
    poses that fill the position ranges."""
    query, kept, excepted = cell.distance_query(), list[BodyPair](), list[ExceptedPair]()
    all_distances = _sampled_distances(cell, query)
    for k, pair in enumerate(cell.pairs):
        bodies = cell.bodies[pair.first], cell.bodies[pair.second]
        names = bodies[0].name, bodies[1].name
        with_surroundings = bodies[0].is_surrounding or bodies[1].is_surrounding
        distances = all_distances[k]
        if (
            with_surroundings
            and len(distances) == POSES
            and np.ptp(distances) < CONSTANT_DISTANCE
            and (distances.min() > 0.0 or cell.floor_is_assumed(bodies))
        ):
            # e.g. a link that turns about the vertical above a floor: no motion changes this
            distance = 1e3 * distances.min()
            excepted.append(ExceptedPair(*names, f"always at the same distance, {distance:.0f} mm"))
            continue
        if len(distances) == POSES and np.mean(distances <= 0.0) > CONTACT_SHARE:
            if with_surroundings:
                link, obstacle = sorted(bodies, key=lambda body: body.is_surrounding)
                raise UnusableInput(_permanent_contact_message(cell, link, obstacle))
            excepted.append(ExceptedPair(*names, "always in contact"))
            continue
        grid = (
            None
            if with_surroundings or distances.min() > NEAR_RATIO * pair.margin
            else _grid_distances(cell, query, k)
        )
        median = float(np.median(distances if grid is None else grid))
        has_mesh = bodies[0].has_mesh or bodies[1].has_mesh
        least_allowed = MIN_MESH_DISTANCE if has_mesh else MIN_LINK_DISTANCE
        if (
            grid is not None
            and min(distances.min(), grid.min()) > least_allowed
            and contact_exclusion.excludes_contact(cell.robot, cell.limits, *bodies)
        ):
            excepted.append(ExceptedPair(*names, "never in contact within the joint limits"))
        elif with_surroundings or median > (NEAR_RATIO if grid is not None else 1.0) * pair.margin:
            kept.append(pair)
        elif median <= MIN_LINK_DISTANCE:
            excepted.append(ExceptedPair(*names, "in contact in most poses by construction"))
        else:
            margin = 0.5 * median
            kept.append(dataclasses.replace(pair, margin=margin))
            stated = f"{1e3 * margin:.0f} mm, half of the usual distance between them"
            excepted.append(ExceptedPair(*names, f"close by construction: {stated}"))
    return kept, excepted


def _sampled_distances(cell: Cell, query: DistanceQuery) -> list[FloatArray]:
    """Distances of every pair over poses that fill the position ranges.

    Pairs that are rarely near at the first SCREENING_POSES poses are evaluated at these only.

    Returns:
        For each pair its distances. Shape (POSES,) or (SCREENING_POSES,) [m].
    """
    out: list[list[float]] = [[] for _ in cell.pairs]
    evaluated = list(range(len(cell.pairs)))
    for count, pose in enumerate(spread_poses(cell.limits, POSES), start=1):
        query.set_configuration(pose)
        for k in evaluated:
            out[k].append(query.distance(k))
        if count == SCREENING_POSES:
            near = NEAR_RATIO * cell.margin
            evaluated = [k for k in evaluated if np.mean(np.array(out[k]) < near) > NEAR_SHARE]
    return [np.array(distances) for distances in out]


def _grid_distances(cell: Cell, query: DistanceQuery, number: int) -> FloatArray | None:
    """Distances of two links with up to two joints between them, over these joints' ranges.

    Returns:
        Distances on a grid, shape (m,) [m]; None for links with more joints between them.
    """
    pair, robot = cell.pairs[number], cell.robot
    bodies = cell.bodies[pair.first], cell.bodies[pair.second]
    supports = [set(robot.model.supports[body.joint]) for body in bodies]
    rows = [joint - 1 for joint in supports[0] ^ supports[1]]
    moving = np.flatnonzero(np.abs(robot.spread[rows]).any(axis=0))
    if len(moving) > 2:
        return None
    steps = MESH_GRID_STEPS if bodies[0].has_mesh or bodies[1].has_mesh else GRID_STEPS
    pose, distances = spread_poses(cell.limits, 1)[0], []
    for values in itertools.product(
        *(np.linspace(low, high, steps) for low, high in ranges(cell.limits)[moving])
    ):
        pose[moving] = values
        distances.append(query.set_configuration(pose).distance(number))
    return np.array(distances)


def _permanent_contact_message(cell: Cell, link: Body, obstacle: Body) -> str:
    is_floor = obstacle.shapes[0].kind is ShapeKind.FLOOR
    remedy = (
        "--floor Z or --no-floor"
        if is_floor
        else f'move it, or allow the contact: ignore = ["{link.name}"]'
    )
    return f"{cell.robot.source}: '{obstacle.name}' touches '{link.name}' in every pose; {remedy}"
