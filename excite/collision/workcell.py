"""A robot in its cell: all shapes, which pairs of them must keep apart, and how far."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import UnusableInput
from ..robot.inertial_parameters import ranges, spread_poses
from ..robot.limits import Limits
from ..robot.robot import Robot
from .distance_query import Body, Pair, Probe, bodies
from .geometry import Kind, Shape

Array = np.ndarray
NOT_CHECKED = "collision not checked"
MARGIN = 0.02
"""Clearance that is kept unless another is asked for [m]."""
POSES = 400
ALWAYS = 0.95
"""Share of random poses in which neighbours touch that were built to touch."""
FEW, NEAR = 40, 2.0
"""Poses that tell which pairs may be close by construction: those within so many margins in more
than a quarter of them."""
CLOSE = 1e-3
"""Links that a joint or two hold apart keep this distance at least [m]."""
CONSTANT = 1e-7
"""Distances that vary by less than this over all poses do not depend on the motion [m]."""
GRID, SPARSE, SPARE = 24, 9, 5e-3
"""Steps per joint over which bodies with one or two joints between them are looked at; of meshes,
which take their time; and what must then be left everywhere of those that are taken never to touch
[m]."""


@dataclass(frozen=True)
class Apart:
    """A pair of bodies that is not held to the margin, and why."""

    first: str
    second: str
    why: str


@dataclass(frozen=True)
class Recipe:
    """From which files and options a cell was made, so that it can be made again from what is on
    disk now.

    packages: folders of `package://` meshes. scene, srdf: absolute paths of the files, None
        without. floor, clearance: as the options state them [m], None where they say nothing;
        False: no floor.
    """

    packages: tuple[str, ...] = ()
    scene: str | None = None
    srdf: str | None = None
    floor: float | bool | None = None
    clearance: float | None = None

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Recipe:
        """Read back what `dataclasses.asdict` made."""
        return Recipe(**{**document, "packages": tuple(document.get("packages", ()))})


@dataclass(frozen=True, eq=False)
class Cell:
    """What verification checks. It is hashed by identity, so that what takes long to find of it can
    be kept.

    bodies: links, tools, surroundings. pairs: of them, that keep apart. excepted: pairs that need
        not, with reasons.
    margin: clearance [m]. disabled: names of bodies whose contact is no matter. notes: what a user
        should know.
    recipe: how it was made, None where it cannot be made again. assumed_floor: nobody stated the
        floor's height.
    """

    robot: Robot
    limits: Limits
    bodies: tuple[Body, ...]
    pairs: tuple[Pair, ...]
    excepted: tuple[Apart, ...]
    margin: float
    disabled: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    recipe: Recipe | None = None
    assumed_floor: bool = False

    def floor_is_assumed(self, pair: Sequence[Body]) -> bool:
        """Whether one of the bodies is a floor that nobody stated."""
        return self.assumed_floor and any(
            one.kind is Kind.FLOOR for body in pair for one in body.shapes
        )

    @property
    def floor(self) -> float | None:
        """Height of the floor in the base frame [m], None without one."""
        heights = [
            one.position[2] for body in self.bodies for one in body.shapes if one.kind is Kind.FLOOR
        ]
        return heights[0] if heights else None

    def floor_words(self) -> str:
        """The height of the floor, in words."""
        return (
            "no floor" if self.floor is None else f"floor at z = {round(self.floor, 6) + 0.0:g} m"
        )

    def names(self, pair: Pair) -> str:
        """Both bodies of a pair."""
        return f"{self.bodies[pair.first].name} – {self.bodies[pair.second].name}"

    def probe(self) -> Probe:
        """Distances of its pairs, by coal."""
        return Probe(self.robot, self.bodies, self.pairs, 2.0 * self.margin)

    def document(self) -> dict[str, Any]:
        """As a trajectory states it; `from_document` makes the same cell of it again."""
        return {
            "margin": self.margin,
            "shapes": [one.document() for body in self.bodies for one in body.shapes],
            "disabled": [list(pair) for pair in self.disabled],
            "excepted": [dataclasses.asdict(one) for one in self.excepted],
            "notes": list(self.notes),
            **({} if self.recipe is None else {"recipe": dataclasses.asdict(self.recipe)}),
        }


def build(
    robot: Robot,
    limits: Limits,
    found: Sequence[Shape],
    margin: float = MARGIN,
    disabled: Sequence[tuple[str, str]] = (),
    notes: Sequence[str] = (),
    recipe: Recipe | None = None,
    *,
    assumed_floor: bool = False,
) -> Cell:
    """Place the shapes and find the pairs that can meet. disabled: names of links or things whose
    contact is no matter.

    Raises UnusableInput for a link that the robot has not, a margin that is no length, and for
    surroundings that a link is in always.
    """
    if not (np.isfinite(margin) and margin >= 0.0):
        raise UnusableInput(f"--clearance {margin:g} should be 0 or more metres")
    bare = Cell(
        robot,
        limits,
        bodies(robot, found),
        (),
        (),
        margin,
        tuple(disabled),
        tuple(notes),
        recipe,
        assumed_floor,
    )
    pairs, excepted = _sorted_out(
        dataclasses.replace(bare, pairs=tuple(Pair(*both, margin) for both in _movable(bare)))
    )
    return dataclasses.replace(bare, pairs=tuple(pairs), excepted=tuple(excepted))


def _movable(cell: Cell) -> Iterator[tuple[int, int]]:
    """Pairs whose distance can change, but for links that a joint connects and pairs that are
    disabled."""
    parents = list(cell.robot.model.parents)
    off = {frozenset(pair) for pair in cell.disabled}
    for (first, one), (second, other) in itertools.combinations(enumerate(cell.bodies), 2):
        a, b = one.joint, other.joint
        # what stands around is no neighbour of the first joint's link; the base's own links are
        neighbours = (parents[a] == b or parents[b] == a) and not (one.around or other.around)
        if a != b and not neighbours and frozenset((one.name, other.name)) not in off:
            yield first, second


def _sorted_out(cell: Cell) -> tuple[list[Pair], list[Apart]]:
    """Which pairs keep the margin, which keep less, and which need not, over poses that fill the
    ranges."""
    probe, kept, excepted = cell.probe(), list[Pair](), list[Apart]()
    distances = _distances(cell, probe)
    for k, pair in enumerate(cell.pairs):
        both = cell.bodies[pair.first], cell.bodies[pair.second]
        names, around, usual = (
            (both[0].name, both[1].name),
            both[0].around or both[1].around,
            distances[k],
        )
        if (
            around
            and len(usual) == POSES
            and np.ptp(usual) < CONSTANT
            and (usual.min() > 0.0 or cell.floor_is_assumed(both))
        ):
            # turns about the vertical, say: its distance is the mounting's matter, not the motion's
            excepted.append(
                Apart(*names, f"always at the same distance, {1e3 * usual.min():.0f} mm")
            )
            continue
        if len(usual) == POSES and np.mean(usual <= 0.0) > ALWAYS:
            if around:
                raise UnusableInput(_in_the_way(cell, *sorted(both, key=lambda body: body.around)))
            excepted.append(Apart(*names, "always in contact"))
            continue
        grid = (
            None
            if around or usual.min() > NEAR * pair.margin
            else _between_neighbours(cell, probe, k)
        )
        usual = usual if grid is None else grid
        middle = float(np.median(usual))
        sure = SPARE if both[0].is_mesh or both[1].is_mesh else CLOSE
        if grid is not None and grid.min() > sure:
            excepted.append(Apart(*names, "never in contact within the joint limits"))
        elif around or middle > (NEAR if grid is not None else 1.0) * pair.margin:
            kept.append(pair)
        elif middle <= CLOSE:
            excepted.append(Apart(*names, "in contact in most poses by construction"))
        else:
            margin = max(0.5 * middle, min(CLOSE, pair.margin))
            kept.append(dataclasses.replace(pair, margin=margin))
            excepted.append(
                Apart(
                    *names,
                    f"close by construction: {1e3 * margin:.0f} mm, half of what is usual between "
                    "them",
                )
            )
    return kept, excepted


def _distances(cell: Cell, probe: Probe) -> list[Array]:
    """Of every pair over poses that fill the ranges: POSES of them for pairs that are often near, a
    few for the others [m]."""
    out: list[list[float]] = [[] for _ in cell.pairs]
    looked = list(range(len(cell.pairs)))
    for count, pose in enumerate(spread_poses(cell.limits, POSES), start=1):
        probe.to(pose)
        for k in looked:
            out[k].append(probe.distance(k))
        if count == FEW:  # most pairs are far apart nearly always, which a few poses show
            looked = [k for k in looked if np.mean(np.array(out[k]) < NEAR * cell.margin) > 0.25]
    return [np.array(one) for one in out]


def _between_neighbours(cell: Cell, probe: Probe, number: int) -> Array | None:
    """Distances of two links with at most two joints between them, all over those joints' ranges;
    None for other pairs [m]."""
    pair, robot = cell.pairs[number], cell.robot
    both = cell.bodies[pair.first], cell.bodies[pair.second]
    ways = [set(robot.model.supports[body.joint]) for body in both]
    rows = [joint - 1 for joint in ways[0] ^ ways[1]]
    moving = np.flatnonzero(np.abs(robot.spread[rows]).any(axis=0))
    if len(moving) > 2:
        return None
    pose, out, steps = (
        spread_poses(cell.limits, 1)[0],
        [],
        SPARSE if both[0].is_mesh or both[1].is_mesh else GRID,
    )
    for values in itertools.product(
        *(np.linspace(low, high, steps) for low, high in ranges(cell.limits)[moving])
    ):
        pose[moving] = values
        out.append(probe.to(pose).distance(number))
    return np.array(out)


def _in_the_way(cell: Cell, link: Body, thing: Body) -> str:
    floor = thing.shapes[0].kind is Kind.FLOOR
    remedy = "--floor Z or --no-floor" if floor else f'move it, or let it: ignore = ["{link.name}"]'
    return f"{cell.robot.source}: '{thing.name}' touches '{link.name}' in every pose; {remedy}"
