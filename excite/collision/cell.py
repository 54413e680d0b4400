"""A robot in its cell: all shapes, which pairs of them must keep apart, and how far."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ..errors import UnusableInput
from ..limits import Limits
from ..parameters import ranges, spread_poses
from ..robot import Robot
from . import shape as shapes
from .shape import Kind, Shape

Array = np.ndarray
MARGIN = 0.02
"""Clearance that is kept unless another is asked for [m]."""
POSES = 400
ALWAYS = 0.95
"""Share of random poses in which neighbours touch that were built to touch."""
CLOSE = 1e-3
"""Links that a joint or two hold apart keep this distance at least [m]."""
GRID = 24
"""Steps per joint over which bodies with one or two joints between them are looked at."""


@dataclass(frozen=True)
class Pair:
    """Two shapes (indices) that keep at least `margin` apart [m]."""

    first: int
    second: int
    margin: float


@dataclass(frozen=True)
class Apart:
    """A pair of bodies that is not held to the margin, and why."""

    first: str
    second: str
    why: str


@dataclass(frozen=True)
class Cell:
    """What verification checks.

    shapes: of the robot, its tools and its surroundings. joints: the model's joint that moves each, 0 for what stands.
    placements: in that joint's frame. solids, hulls: for coal, exactly and convex.
    pairs: that keep apart. excepted: pairs that need not, with reasons.
    margin: clearance [m]. notes: what a user should know.
    """

    robot: Robot
    limits: Limits
    shapes: tuple[Shape, ...]
    joints: tuple[int, ...]
    placements: tuple[pin.SE3, ...]
    solids: tuple[coal.CollisionGeometry, ...]
    hulls: tuple[coal.CollisionGeometry, ...]
    pairs: tuple[Pair, ...]
    excepted: tuple[Apart, ...]
    margin: float
    disabled: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = field(default=())

    def body(self, index: int) -> str:
        """Name that people know a shape by: its link's, or its own where it stands in the base frame or is a tool."""
        one = self.shapes[index]
        return one.name if one.link is None or not one.name.startswith(one.link) else one.link

    def names(self, pair: Pair) -> str:
        """Both bodies of a pair."""
        return f"{self.body(pair.first)} – {self.body(pair.second)}"

    def document(self) -> dict[str, Any]:
        """As a trajectory states it; `from_document` makes the same cell of it again."""
        return {
            "margin": self.margin,
            "shapes": [one.document() for one in self.shapes],
            "disabled": [list(pair) for pair in self.disabled],
            "excepted": [dataclasses.asdict(one) for one in self.excepted],
            "notes": list(self.notes),
        }


class Probe:
    """Distances of a cell's pairs at one configuration after another, by coal."""

    def __init__(self, cell: Cell, pairs: Sequence[Pair]) -> None:
        self.robot, self.pairs, self.margin = cell.robot, tuple(pairs), cell.margin
        self.data = cell.robot.model.createData()
        self.meshes = [any(cell.shapes[i].kind is Kind.MESH for i in (pair.first, pair.second)) for pair in pairs]
        self.convex, self.exact = (_geometry(cell, pairs, solids) for solids in (cell.hulls, cell.solids))

    def to(self, q: Array) -> Probe:
        """Go to a configuration of the moving joints. Shape (n,)."""
        pose = self.robot.expand(q)
        pin.forwardKinematics(self.robot.model, self.data, pose)
        pin.updateGeometryPlacements(self.robot.model, self.data, *self.convex)
        if any(self.meshes):
            pin.updateGeometryPlacements(self.robot.model, self.data, *self.exact)
        return self

    def distance(self, pair: int, near: float | None = None) -> float:
        """Of a pair by its number; ≤ 0 where the bodies meet [m].

        Of meshes further apart than `near` (None: twice the margin) it is that of their convex hulls, which is never larger
        and a hundred times cheaper.
        """
        least = float(pin.computeDistance(*self.convex, pair).min_distance)
        if self.meshes[pair] and least < (2.0 * self.margin if near is None else near):
            least = float(pin.computeDistance(*self.exact, pair).min_distance)
        return least


def _geometry(cell: Cell, pairs: Sequence[Pair], solids: Sequence[coal.CollisionGeometry]) -> tuple[pin.GeometryModel, pin.GeometryData]:
    model = pin.GeometryModel()
    for one, joint, placement, solid in zip(cell.shapes, cell.joints, cell.placements, solids, strict=True):
        model.addGeometryObject(pin.GeometryObject(one.name, joint, placement, solid))
    for pair in pairs:
        model.addCollisionPair(pin.CollisionPair(pair.first, pair.second))
    return model, model.createData()


def from_document(robot: Robot, limits: Limits, document: Mapping[str, Any]) -> Cell:
    """The cell that a trajectory states. Raises UnusableInput where a mesh is missing or has changed."""
    found = [shapes.from_document(entry) for entry in document["shapes"]]
    disabled = [(str(a), str(b)) for a, b in document.get("disabled", ())]
    return build(robot, limits, found, float(document["margin"]), disabled, document.get("notes", ()))


def build(
    robot: Robot,
    limits: Limits,
    found: Sequence[Shape],
    margin: float = MARGIN,
    disabled: Sequence[tuple[str, str]] = (),
    notes: Sequence[str] = (),
) -> Cell:
    """Place the shapes and find the pairs that can meet. disabled: names of links or things whose contact is no matter.

    Raises UnusableInput for a link that the robot has not, a margin that is no length, and for surroundings that a link is in
    always.
    """
    if not (np.isfinite(margin) and margin >= 0.0):
        raise UnusableInput(f"--clearance {margin:g} should be 0 or more metres")
    joints, placements = [], []
    for one in found:
        joint, placement = 0, pin.SE3.Identity()
        if one.link is not None:
            frame = robot.model.frames[robot.frame(one.link)]
            joint, placement = int(frame.parentJoint), frame.placement
        joints.append(joint)
        placements.append(placement * one.placement)
    solids, hulls = tuple(one.solid() for one in found), tuple(one.hull() for one in found)
    bare = Cell(robot, limits, tuple(found), tuple(joints), tuple(placements), solids, hulls, (), (), margin, tuple(disabled), tuple(notes))
    pairs, excepted = _sorted_out(bare, [Pair(*both, margin) for both in _movable(bare)])
    return dataclasses.replace(bare, pairs=tuple(pairs), excepted=tuple(excepted))


def _movable(cell: Cell) -> list[tuple[int, int]]:
    """Pairs whose distance can change, but for links that a joint connects and pairs that are disabled."""
    parents = list(cell.robot.model.parents)
    off = {frozenset(pair) for pair in cell.disabled}
    out = []
    for first, second in itertools.combinations(range(len(cell.shapes)), 2):
        a, b = cell.joints[first], cell.joints[second]
        one, other = cell.shapes[first], cell.shapes[second]
        if a == b or frozenset((_known(one), _known(other))) in off:
            continue
        # what stands around is no neighbour of the first joint's link; the base's own links are
        both_links = one.link is not None and other.link is not None
        if both_links and (parents[a] == b or parents[b] == a):
            continue
        out.append((first, second))
    return out


def _known(one: Shape) -> str:
    return one.link if one.link is not None and one.name.startswith(one.link) else one.name


def _sorted_out(cell: Cell, pairs: Sequence[Pair]) -> tuple[list[Pair], list[Apart]]:
    """Which pairs keep the margin, which only must not touch, and which always or never do, over poses that fill the ranges."""
    candidates = list(pairs)
    probe, kept, excepted = Probe(cell, candidates), list[Pair](), list[Apart]()
    touching, near = np.zeros(len(candidates)), np.zeros(len(candidates))
    open_ones = np.ones(len(candidates), bool)
    for count, pose in enumerate(spread_poses(cell.limits, POSES), start=1):
        probe.to(pose)
        for k in (int(k) for k in np.flatnonzero(open_ones)):
            d = probe.distance(k)
            touching[k] += d <= 0.0
            near[k] += d < cell.margin
        if count >= 20:  # most pairs are far apart nearly always, which a few poses show
            open_ones &= near > 0.25 * count
    for k, pair in enumerate(candidates):
        names = cell.body(pair.first), cell.body(pair.second)
        if open_ones[k] and touching[k] > ALWAYS * POSES:
            around = next((i for i in (pair.first, pair.second) if cell.shapes[i].link is None), None)
            if around is not None:
                raise UnusableInput(_in_the_way(cell, names, cell.shapes[around]))
            excepted.append(Apart(*names, "always in contact"))
            continue
        between = _between_neighbours(cell, probe, k) if near[k] else None
        if between is not None and between.min() > CLOSE:
            excepted.append(Apart(*names, "never in contact within the joint limits"))
        elif between is not None and np.median(between) < 2.0 * pair.margin:
            margin = max(0.5 * float(np.median(between)), min(CLOSE, pair.margin))
            kept.append(dataclasses.replace(pair, margin=margin))
            excepted.append(Apart(*names, f"close by construction: {1e3 * margin:.0f} mm, half of what is usual between them"))
        else:
            kept.append(pair)
    return kept, excepted


def _between_neighbours(cell: Cell, probe: Probe, number: int) -> Array | None:
    """Distances of two links with at most two joints between them, all over those joints' ranges; None for other pairs [m]."""
    pair, robot = probe.pairs[number], cell.robot
    ways = [set(robot.model.supports[cell.joints[i]]) for i in (pair.first, pair.second)]
    rows = [joint - 1 for joint in ways[0] ^ ways[1]]
    moving = np.flatnonzero(np.abs(robot.spread[rows]).any(axis=0))
    if len(moving) > 2 or any(cell.shapes[i].link is None for i in (pair.first, pair.second)):
        return None
    pose, out = spread_poses(cell.limits, 1)[0], []
    for values in itertools.product(*(np.linspace(low, high, GRID) for low, high in ranges(cell.limits)[moving])):
        pose[moving] = values
        out.append(probe.to(pose).distance(number))
    return np.array(out)


def _in_the_way(cell: Cell, names: tuple[str, str], thing: Shape) -> str:
    other = names[0] if names[1] == thing.name else names[1]
    remedy = "--floor Z or --no-floor" if thing.kind is Kind.FLOOR else f'move it, or let it: ignore = ["{other}"]'
    return f"{cell.robot.source}: '{thing.name}' touches '{other}' in every pose; {remedy}"


def at_pose(cell: Cell, q: Array) -> tuple[Pair, float]:
    """The pair nearest to breaking its margin at a pose, and its distance [m]. Shape (n,)."""
    probe = Probe(cell, cell.pairs)
    probe.to(q)
    distances = [probe.distance(k) for k in range(len(cell.pairs))]
    k = int(np.argmin([d - pair.margin for d, pair in zip(distances, cell.pairs, strict=True)]))
    return cell.pairs[k], distances[k]
