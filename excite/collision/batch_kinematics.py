"""Poses of all joints at many configurations at once, and how points on them move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robot.robot import Robot

Array = np.ndarray


@dataclass(frozen=True)
class Chain:
    """The kinematic tree as arrays; joint 0 is the base, which does not move.

    parent: of each joint. rotation, translation: of each joint's frame in its parent's, at q = 0.
        linear, angular: unit motion subspaces, joint frame. above: above[i, k], whether joint k
        moves joint i's frame. spread, shift: see `Robot`. Shapes (J,), (J, 3, 3), (J, 3), (J, 3),
        (J, 3), (J, J), (J − 1, n), (J − 1,).
    """

    parent: Array
    rotation: Array
    translation: Array
    linear: Array
    angular: Array
    above: Array
    spread: Array
    shift: Array

    def poses(self, q: Array) -> tuple[Array, Array]:
        """Rotations and origins of all joint frames in the base frame. Shapes (N, n) -> (N, J, 3,
        3), (N, J, 3) [m]."""
        full = q @ self.spread.T + self.shift
        R, p = np.empty((len(q), len(self.parent), 3, 3)), np.empty((len(q), len(self.parent), 3))
        R[:, 0], p[:, 0] = np.eye(3), 0.0
        for i in range(1, len(self.parent)):
            up, angle = int(self.parent[i]), full[:, i - 1]
            p[:, i] = p[:, up] + R[:, up] @ self.translation[i]
            R[:, i] = R[:, up] @ self.rotation[i]
            if self.linear[i].any():
                p[:, i] += angle[:, None] * (R[:, i] @ self.linear[i])
            if self.angular[i].any():
                R[:, i] = R[:, i] @ _turn(self.angular[i], angle)
        return R, p

    def screws(self, R: Array, p: Array) -> Array:
        """Velocity field of each joint's unit speed as (angular, linear at the base's origin).
        Shapes as of `poses` -> (N, J, 6).

        A point x that joint k moves has velocity ω × x + v; along n that is ω · (x × n) + v · n.
        """
        turning, sliding = ((R @ axis[:, :, None])[..., 0] for axis in (self.angular, self.linear))
        x, y, z = (p[..., i] for i in range(3))
        u, v, w = (turning[..., i] for i in range(3))
        return np.concatenate(
            [turning, sliding + np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)],
            axis=-1,
        )


def of(robot: Robot) -> Chain:
    """The kinematic tree of a robot."""
    model = robot.model
    count = model.njoints
    axes = np.zeros((count, 6))
    axes[1:] = robot.axes()
    above = np.zeros((count, count))
    for i in range(1, count):
        above[i] = above[model.parents[i]]
        above[i, i] = 1.0
    return Chain(
        parent=np.array([int(parent) for parent in model.parents]),
        rotation=np.array([placement.rotation for placement in model.jointPlacements]),
        translation=np.array([placement.translation for placement in model.jointPlacements]),
        linear=axes[:, :3],
        angular=axes[:, 3:],
        above=above,
        spread=robot.spread,
        shift=robot.shift,
    )


def _turn(axis: Array, angle: Array) -> Array:
    """Rodrigues' rotations about one unit axis. Shapes (3,), (N,) -> (N, 3, 3)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * K + (1.0 - c) * (K @ K))
