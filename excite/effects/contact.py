"""Contact: an external force on a link for some of the time."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._types import FloatArray, IntArray
from ..identification.lowpass import Grid
from .effect import CandidateModel, Effect, NonlinearParameter
from .recorded_motion import RecordedMotion

WINDOWS = 40
"""The shortest window in which a contact is sought is this share of a recording."""
BLOCKS = 400
"""Blocks of a recording at whose edges a contact may begin and end."""
DOUBLINGS = 5
"""Lengths of windows, each twice the one before."""
MAX_SHARE = 0.5
"""Length of the longest interval over that of its recording [1], the bound of its prior: the base
model without the contact is known from the rest, which is not to be the smaller part."""
MAX_INTERVALS = 2
"""Intervals that are proposed."""
COURSES = ((1.0, 0.0, 0.0), (1.348, 1.0, 0.0), (1.0, 0.0, 8.0))
"""Time courses of the force that are tried, each (stretch, swells, knots).

Length of the interval over that of the constant force that explains most of it [1]: for half a sine
that which maximises (∫ sin)²/length; 1 if the force rises and falls as half a sine, 0 if it is
constant; number of knots of a piecewise linear course, 0 for the other two.
"""
END_FACTOR = 1.5
"""Largest factor by which a search for one end changes the length of an interval [1]."""
KNOT_EXTENSION = 0.3
"""Extension of a piecewise linear course before and after the interval, over its length."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the torque −Jᵀ f of a force f on a link's centre of mass during an interval.

    The force is in the base frame; one column per basis function and component. Shape (C, n, 3 k).
    """
    course = _course(motion, model)
    torque = -np.einsum("tk,txj->tjkx", course, motion.link_jacobians[:, model.joint_index])
    return motion.lowpass(torque.reshape(*torque.shape[:2], -1), Grid.COARSE)


def _course(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the basis functions of the force over time, at the coarse samples. Shape (C, k)."""
    assert model.interval is not None
    low, high = model.interval
    rate = motion.band.rate_of(Grid.COARSE)
    time = motion.segment.start + np.arange(len(motion.coarse_samples)) / rate
    u = (time - low) / (high - low)
    inside = (u > 0.0) & (u < 1.0) & (motion.segment.source == model.source)
    if not model.values["knots"]:
        return np.where(inside, np.sin(np.pi * u) if model.values["swells"] else 1.0, 0.0)[:, None]
    count = int(model.values["knots"])
    u = (u + KNOT_EXTENSION) / (1.0 + 2.0 * KNOT_EXTENSION) * (count + 1.0)
    hats = np.maximum(1.0 - np.abs(u[:, None] - np.arange(1, count + 1)), 0.0)
    return hats * (motion.segment.source == model.source)


def _largest_force(c: FloatArray) -> dict[str, float]:
    """Return the largest force of the course [N]."""
    return {"force": float(np.linalg.norm(c.reshape(-1, 3), axis=1).max())}


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Yield forces on every link, about the intervals in which a force explains most."""
    sources = {motion.segment.source for motion in motions}
    lengths = np.arange(1, int(MAX_SHARE * WINDOWS) + 1)
    windows = float((WINDOWS + 1 - lengths).sum()) * len(sources)
    for source, (low, high) in _intervals(motions):
        for stretch, swells, knots in COURSES:
            margin = 0.5 * (stretch - 1.0) * (high - low)
            for joint in range(motions[0].n):
                model = CandidateModel(
                    "contact",
                    joint,
                    _columns,
                    {"swells": swells, "knots": knots},
                    source=source,
                    parameters=_largest_force,
                    alternatives=windows,
                )
                yield _moving_end(model, low - margin, high + margin, first=True).current


def _moving_end(model: CandidateModel, low: float, high: float, first: bool) -> NonlinearParameter:
    """Return the length of an interval of which one end is free, and in turn the other.

    Args:
        model: The contact.
        low: Begin of the interval [s].
        high: End of the interval [s].
        first: True if the begin is free, False if the end is.
    """

    def of_length(length: float) -> CandidateModel:
        interval = (high - length, high) if first else (low, low + length)

        def variants() -> list[NonlinearParameter]:
            return [_moving_end(model, *interval, not first)]

        return replace(model, interval=interval, variants=variants)

    length = high - low
    return NonlinearParameter(length, length / END_FACTOR, length * END_FACTOR, of_length)


def _intervals(motions: Sequence[RecordedMotion]) -> list[tuple[str, tuple[float, float]]]:
    """Return the intervals in which a constant force explains most, with their recordings.

    The base model is fitted anew with each force: it takes a large part of the torque of a contact
    that lasts. Of windows of all lengths the best is chosen, and the best that it does not overlap;
    then both ends move while that explains more. In the joint model they move once more.
    """
    usual = np.array([np.median(np.abs(m.residual), axis=0) for m in motions]).mean(axis=0) + 1e-12
    weights = [motion.moving / usual**2 for motion in motions]
    information = sum(
        np.einsum("tjp,tj,tjq->pq", motion.gamma, weight, motion.gamma)
        for motion, weight in zip(motions, weights, strict=True)
    )
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information * scale[:, None] * scale, rcond=1e-9, hermitian=True)
    inverse *= scale[:, None] * scale
    change = inverse @ sum(
        np.einsum("tjp,tj->p", motion.gamma, weight * motion.residual)
        for motion, weight in zip(motions, weights, strict=True)
    )
    forces = [
        _WindowedForces.of(motion, weight, motion.residual - motion.gamma @ change, inverse)
        for motion, weight in zip(motions, weights, strict=True)
    ]
    windows = [
        (gain, number, window)
        for number, force in enumerate(forces)
        for gain, window in zip(force.gains(force.grid()).tolist(), force.grid(), strict=True)
    ]
    chosen: list[tuple[int, IntArray]] = []
    for _, number, window in sorted(windows, key=lambda entry: -entry[0]):
        if all(k != number or window[1] <= w[0] or window[0] >= w[1] for k, w in chosen):
            chosen.append((number, window))
        if len(chosen) == MAX_INTERVALS:
            break
    out = []
    for number, window in chosen:
        motion, force = motions[number], forces[number]
        rows = force.edges[force.refined(window)] - (0, 1)
        low, high = motion.time[rows].tolist()
        out.append((motion.segment.source, (low, high)))
    return out


@dataclass(frozen=True)
class _WindowedForces:
    """Constant forces on the links of a motion, each during a window, fitted with the base model.

    Windows begin and end at the edges of B blocks of rows.

    Attributes:
        edges: First row of each block, and the number of rows, shape (B + 1,).
        score: Sum over the first blocks of the products of force and residual of the base model,
            for each link and component of the force, shape (B + 1, links, 3).
        shared: The same of force and base regressor, shape (B + 1, links, p, 3).
        square: The same of the components of the force, shape (B + 1, links, 3, 3).
        inverse: Inverse information of the base parameters, shape (p, p).
    """

    edges: IntArray
    score: FloatArray
    shared: FloatArray
    square: FloatArray
    inverse: FloatArray

    @classmethod
    def of(
        cls,
        motion: RecordedMotion,
        weight: FloatArray,
        residual: FloatArray,
        inverse: FloatArray,
    ) -> _WindowedForces:
        """Return the forces on all links of a motion.

        Args:
            motion: The motion.
            weight: Weights of its rows, shape (N, n).
            residual: Residual of the base model fitted with these weights [N m], shape (N, n).
            inverse: Inverse information of the base parameters, shape (p, p).
        """
        n, rows = motion.n, len(motion)
        torque = -np.swapaxes(motion.link_jacobians, 2, 3)  # links, joints, components
        columns = motion.lowpass(torque.reshape(len(torque), -1), Grid.COARSE)
        columns = columns.reshape(rows, n, n, 3)
        edges = np.linspace(0, rows, min(BLOCKS, rows) + 1).astype(int)
        score, shared, square = [], [], []
        for first, last in itertools.pairwise(edges.tolist()):
            x = columns[first:last]
            weighted = x * weight[first:last, None, :, None]
            score.append(np.einsum("tljx,tj->lx", weighted, residual[first:last]))
            shared.append(np.tensordot(weighted, motion.gamma[first:last], ((0, 2), (0, 1))))
            square.append(np.einsum("tljx,tljy->lxy", weighted, x))

        def sums(parts: list[FloatArray]) -> FloatArray:
            return np.concatenate([np.zeros_like(parts[0])[None], np.cumsum(parts, axis=0)])

        return cls(edges, sums(score), np.swapaxes(sums(shared), 2, 3), sums(square), inverse)

    def grid(self) -> IntArray:
        """Return windows of all lengths, each half overlapping the next, shape (w, 2)."""
        blocks = len(self.edges) - 1
        lengths = max(blocks // WINDOWS, 2) * 2 ** np.arange(DOUBLINGS)
        return np.array(
            [
                (start, start + length)
                for length in lengths.tolist()
                for start in range(0, blocks - length + 1, max(length // 2, 1))
            ]
        )

    def gains(self, windows: IntArray) -> FloatArray:
        """Return the log-likelihood gain of the best link's force in each window, shape (w,).

        Args:
            windows: First block and the block after the last, shape (w, 2).
        """
        low, high = windows.T
        score, shared, square = (x[high] - x[low] for x in (self.score, self.shared, self.square))
        square = square - np.einsum(
            "wlpx,pq,wlqy->wlxy", shared, self.inverse, shared, optimize=True
        )
        force = np.linalg.pinv(square, rcond=1e-9, hermitian=True) @ score[..., None]
        return np.asarray(0.5 * np.einsum("wlx,wlx->wl", score, force[..., 0]).max(axis=1))

    def refined(self, window: IntArray) -> IntArray:
        """Return a window whose ends move by ever smaller steps while that raises the gain.

        Args:
            window: First block and the block after the last, shape (2,).
        """
        blocks, step = len(self.edges) - 1, int(window[1] - window[0]) // 4
        best = float(self.gains(window[None])[0])
        while step:
            near = window + step * np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
            length = np.diff(near)[:, 0]
            possible = (length > 1) & (length <= MAX_SHARE * blocks)
            near = near[(near[:, 0] >= 0) & (near[:, 1] <= blocks) & possible]
            gains = self.gains(near)
            if len(near) and float(gains.max()) > best:
                best, window = float(gains.max()), near[int(np.argmax(gains))]
            else:
                step //= 2
        return window


CONTACT = Effect(
    "contact",
    "Jᵀ f on an interval",
    _columns,
    _candidates,
    {"force": "N"},
    "for some of the time only, in the joints before the contact",
    (),
    "the same motion without anything near the robot",
    form_std={"force": 0.1},
    of_link=True,
)
"""Collision or contact with the environment or a person."""
