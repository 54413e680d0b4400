"""Search for the times at which something pushed the robot, in the residual of a joint model."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray
from ..effects import contact
from ..effects.contact import MAX_SHARE
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import RecordedMotion
from .joint_model import JointModel
from .session_changes import sources

WINDOWS = 40
"""Length of a motion over that of the shortest window in which a contact is sought."""
BLOCKS = 400
"""Blocks of a motion at whose edges a contact may begin and end."""
DOUBLINGS = 5
"""Lengths of windows, each twice the one before."""
MAX_WINDOWS = 2
"""Windows in which a contact is proposed."""


def contacts(fitted: JointModel) -> list[CandidateModel]:
    """Return forces on every link, in the windows in which a constant force explains most.

    The joint model is refitted with each force, as it absorbs a large part of a long contact. Of
    windows of all lengths the best is chosen, and the best that it does not overlap; then both ends
    move while that explains more.
    """
    rows = np.cumsum([0, *(len(motion) for motion in fitted.motions)])
    forces = [
        _WindowedForces.of(fitted, motion, slice(first, last))
        for motion, (first, last) in zip(
            fitted.motions, itertools.pairwise(rows.tolist()), strict=True
        )
    ]
    windows: list[tuple[float, int, IntArray]] = []
    for number, force in enumerate(forces):
        grid = force.grid()
        gains = force.gains(grid).tolist()
        windows += [(gain, number, window) for gain, window in zip(gains, grid, strict=True)]
    chosen: list[tuple[int, IntArray]] = []
    for _, number, window in sorted(windows, key=lambda entry: -entry[0]):
        if all(k != number or window[1] <= w[0] or window[0] >= w[1] for k, w in chosen):
            chosen.append((number, window))
        if len(chosen) == MAX_WINDOWS:
            break
    lengths = np.arange(1, int(MAX_SHARE * WINDOWS) + 1)
    count = float((WINDOWS + 1 - lengths).sum()) * len(sources(fitted.motions))
    out: list[CandidateModel] = []
    for number, window in chosen:
        motion, force = fitted.motions[number], forces[number]
        low, high = motion.time[force.edges[force.refined(window)] - (0, 1)].tolist()
        out += contact.contact_models(fitted.motions, number, low, high, count)
    return out


@dataclass(frozen=True)
class _WindowedForces:
    """Constant forces on the links of a motion, each during a window, fitted with a joint model.

    Windows begin and end at the edges of B blocks of rows. Sums are over all blocks before one.

    Attributes:
        edges: First row of each block, and the number of rows, shape (B + 1,).
        score: Sum of the products of force and weighted residual, for each link and component of
            the force, shape (B + 1, links, 3).
        shared: The same of force and active columns of the joint model, shape (B + 1, a, links, 3).
        square: The same of the components of the force, shape (B + 1, links, 3, 3).
        inverse: Inverse information of the active coefficients, shape (a, a).
    """

    edges: IntArray
    score: FloatArray
    shared: FloatArray
    square: FloatArray
    inverse: FloatArray

    @classmethod
    def of(cls, fitted: JointModel, motion: RecordedMotion, rows: slice) -> _WindowedForces:
        """Return the forces on all links of a motion, the given rows of the joint model."""
        regression = fitted.regression
        n, active = fitted.n, int(fitted.solution.active.sum())
        forces = contact.unit_forces(motion)
        count = len(forces)
        edges = np.linspace(0, count, min(BLOCKS, count) + 1).astype(int)
        score, square = np.zeros((len(edges), n, 3)), np.zeros((len(edges), n, 3, 3))
        shared = np.zeros((len(edges), active, n, 3))
        for j, weight in enumerate(regression.weights.tolist()):
            columns, places = regression.active_columns(j)
            columns, moving = columns[rows], regression.moving[rows, j]
            residual = regression.residual_of(j)[rows]
            x = forces[:, :, j] * moving[:, None, None]
            for b, (first, last) in enumerate(itertools.pairwise(edges.tolist()), 1):
                block = x[first:last]
                score[b] += weight * np.tensordot(residual[first:last], block, 1)
                square[b] += weight * np.einsum("tlx,tly->lxy", block, block)
                shared[b, places] += weight * np.tensordot(columns[first:last].T, block, 1)
        inverse = fitted.solution.solve(np.eye(active))
        score, shared, square = (np.cumsum(x, axis=0) for x in (score, shared, square))
        return cls(edges, score, shared, square, inverse)

    def grid(self) -> IntArray:
        """Return windows of all lengths as first block and end, half overlapping, shape (w, 2)."""
        blocks = len(self.edges) - 1
        lengths = max(blocks // WINDOWS, 2) * 2 ** np.arange(DOUBLINGS)
        lengths = lengths[lengths <= MAX_SHARE * blocks]
        return np.array(
            [
                (start, start + length)
                for length in lengths.tolist()
                for start in range(0, blocks - length + 1, max(length // 2, 1))
            ]
        )

    def gains(self, windows: IntArray) -> FloatArray:
        """Return the log-likelihood gain of the best link's force in each window, shape (w,)."""
        low, high = windows.T
        score, shared, square = (x[high] - x[low] for x in (self.score, self.shared, self.square))
        shared = np.moveaxis(shared, 1, 2)  # windows, links, coefficients, components
        explained = np.swapaxes(shared, 2, 3) @ (self.inverse @ shared)
        force = np.linalg.pinv(square - explained, rcond=1e-9, hermitian=True) @ score[..., None]
        return np.asarray(0.5 * np.einsum("wlx,wlx->wl", score, force[..., 0]).max(axis=1))

    def refined(self, window: IntArray) -> IntArray:
        """Return a window whose ends move by ever smaller steps while that raises the gain."""
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
