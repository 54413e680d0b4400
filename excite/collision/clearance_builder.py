"""From a cell to its clearance: what covers each body, and which pairs of covers the optimiser has
to look at."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ..robot.inertial_parameters import spread_poses
from . import batch_kinematics, capsule_cover
from .capsule_cover import Capsule
from .clearance_constraint import FAR, Clearance, Hull
from .distance_query import Body, Pair
from .geometry import Kind
from .workcell import Cell

Array = np.ndarray
POSES = 1000
LOOSE = 0.05
"""Share of poses in which covers may break a margin that the bodies keep."""
LOOKS = 15
"""Of those, poses at which the bodies themselves are looked at."""
OFTEN = 0.5
"""Share of poses in which hulls break a margin, from which they say nothing."""


@dataclass
class _Covers:
    """Covers of all bodies, and per body the numbers of its own capsules, boxes and planes."""

    capsules: list[tuple[Capsule, int]] = field(default_factory=list)
    boxes: list[tuple[Array, Array, Array]] = field(default_factory=list)
    planes: list[tuple[Array, float]] = field(default_factory=list)
    own: list[tuple[range, range, range]] = field(default_factory=list)

    def add(self, body: Body) -> None:
        """Cover one more body."""
        before = self._counts()
        for one, placement in zip(body.shapes, body.placements, strict=True):
            if one.kind is Kind.FLOOR:
                normal = placement.rotation[:, 2]
                self.planes.append((normal, float(normal @ placement.translation)))
            elif body.joint == 0 and one.kind in (Kind.BOX, Kind.MESH):
                for low, high in capsule_cover.boxes(one):
                    self.boxes.append(
                        (placement.rotation, placement.act(0.5 * (low + high)), 0.5 * (high - low))
                    )
            else:
                # the cover is in the frame of the shape's link; from there to the joint's
                outer = placement * one.placement.inverse()
                self.capsules += [
                    (c.moved(outer.rotation, outer.translation), body.joint)
                    for c in capsule_cover.capsules(one)
                ]
        first, second, third = (range(a, b) for a, b in zip(before, self._counts(), strict=True))
        self.own.append((first, second, third))

    def _counts(self) -> tuple[int, int, int]:
        return len(self.capsules), len(self.boxes), len(self.planes)

    def rows(self, pair: Pair) -> Iterator[tuple[int, int, int]]:
        """Kind of a pair's covers, the capsule's number, the other's."""
        one, other = self.own[pair.first], self.own[pair.second]
        if not one[0]:
            one, other = other, one
        for kind, numbers in enumerate(other):
            yield from ((kind, first, second) for first in one[0] for second in numbers)


@lru_cache(maxsize=2)
def clearance(cell: Cell) -> Clearance | None:
    """Covers of a cell and the pairs of them that can come near; None where none can.

    Where covers are too loose for a pair, convex hulls take their place; where these are too, the
    certificate alone decides.
    """
    covers = _Covers()
    for body in cell.bodies:
        covers.add(body)
    rows = [(*row, number) for number, pair in enumerate(cell.pairs) for row in covers.rows(pair)]
    if not rows:
        return None
    kind, first, second, pair = np.array(rows, int).T
    capsules = [capsule for capsule, _ in covers.capsules]
    whole = Clearance(
        chain=batch_kinematics.of(cell.robot),
        joint=np.array([joint for _, joint in covers.capsules], int),
        begin=np.array([one.begin for one in capsules]),
        end=np.array([one.end for one in capsules]),
        radius=np.array([one.radius for one in capsules]),
        box_pose=np.array([pose for pose, _, _ in covers.boxes]).reshape(-1, 3, 3),
        box_centre=np.array([centre for _, centre, _ in covers.boxes]).reshape(-1, 3),
        box_half=np.array([half for _, _, half in covers.boxes]).reshape(-1, 3),
        normal=np.array([normal for normal, _ in covers.planes]).reshape(-1, 3),
        height=np.array([height for _, height in covers.planes], float),
        hulls=(),
        kind=kind,
        first=first,
        second=second,
        need=np.array([cell.pairs[k].margin for k in pair]),
        names=tuple(cell.names(cell.pairs[k]) for k in pair),
    )
    return _pruned(whole, cell, pair)


def _pruned(whole: Clearance, cell: Cell, pair: Array) -> Clearance | None:
    """Without the covers that never come near, over many poses; hulls instead of those that are too
    loose. pair: of each row."""
    poses = spread_poses(cell.limits, POSES)
    room = whole.at(poses).distances() - whole.need
    dropped = ~(room < FAR).any(axis=0)
    loose, probe = list[Pair](), cell.probe()
    for number, one in enumerate(cell.pairs):
        rows = pair == number
        broken = (room[:, rows] < 0.0).any(axis=1)
        if broken.mean() <= LOOSE:
            continue
        some = poses[broken][:: max(int(broken.sum()) // LOOKS, 1)]
        share = float(np.mean([probe.to(q).distance(number) >= one.margin for q in some]))
        if share * broken.mean() > LOOSE:
            dropped |= rows
            loose.append(one)
    kept = _with_hulls(whole.without(dropped), cell, loose)
    return kept if len(kept) else None


def _with_hulls(whole: Clearance, cell: Cell, pairs: Sequence[Pair]) -> Clearance:
    """With the hulls of pairs, but for those that break their margin in most poses."""
    numbers = sorted({i for pair in pairs for i in (pair.first, pair.second)})
    hulls, own = list[Hull](), dict[int, range]()
    for i in numbers:
        body, begin = cell.bodies[i], len(hulls)
        hulls += [
            Hull(s, body.joint, p.rotation, p.translation)
            for s, p in zip(body.shapes, body.placements, strict=True)
        ]
        own[i] = range(begin, len(hulls))
    rows = [
        (*both, pair)
        for pair in pairs
        for both in itertools.product(own[pair.first], own[pair.second])
    ]
    more = dataclasses.replace(
        whole,
        hulls=tuple(hulls),
        kind=np.append(whole.kind, np.full(len(rows), 3)),
        first=np.append(whole.first, [row[0] for row in rows]).astype(int),
        second=np.append(whole.second, [row[1] for row in rows]).astype(int),
        need=np.append(whole.need, [row[2].margin for row in rows]),
        names=(*whole.names, *(cell.names(row[2]) for row in rows)),
    )
    room = more.at(spread_poses(cell.limits, POSES // 10)).distances() - more.need
    return more.without((more.kind == 3) & ((room < 0.0).mean(axis=0) > OFTEN))
