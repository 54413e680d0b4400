"""Forward kinematics of all joints at many configurations at once, and the joint twists there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray
from ..robot.robot import Robot


@dataclass(frozen=True)
class KinematicTree:
    """Kinematic tree of a robot as arrays; joint 0 is the base, which does not move.

    J counts the joints with the base, n the independent joint positions.

    Attributes:
        parent: Index of each joint's parent. Shape (J,).
        rotation: Orientation of each joint frame in its parent's frame at q = 0. Shape (J, 3, 3).
        translation: Origin of each joint frame in its parent's frame. Shape (J, 3) [m].
        linear: Linear part of each joint's unit motion subspace, joint frame. Shape (J, 3).
        angular: Angular part of it. Shape (J, 3).
        support: support[i, k] is 1 if joint k moves the frame of joint i, else 0. Shape (J, J).
        spread: Matrix of the map from q to all joint positions, see `Robot`. Shape (J − 1, n).
        shift: Constant of that map. Shape (J − 1,).
    """

    parent: IntArray
    rotation: FloatArray
    translation: FloatArray
    linear: FloatArray
    angular: FloatArray
    support: FloatArray
    spread: FloatArray
    shift: FloatArray

    @staticmethod
    def from_robot(robot: Robot) -> KinematicTree:
        """Collect the kinematic tree of a robot from its Pinocchio model."""
        model = robot.model
        count = model.njoints
        axes = np.zeros((count, 6))
        axes[1:] = robot.axes()
        support = np.zeros((count, count))
        for i in range(1, count):
            support[i] = support[model.parents[i]]
            support[i, i] = 1.0
        return KinematicTree(
            parent=np.array([int(parent) for parent in model.parents]),
            rotation=np.array([placement.rotation for placement in model.jointPlacements]),
            translation=np.array([placement.translation for placement in model.jointPlacements]),
            linear=axes[:, :3],
            angular=axes[:, 3:],
            support=support,
            spread=robot.spread,
            shift=robot.shift,
        )

    def poses(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the poses of all joint frames in the base frame.

        Args:
            q: Configurations. Shape (N, n) [rad or m].

        Returns:
            Rotations, shape (N, J, 3, 3), and origins, shape (N, J, 3) [m].
        """
        positions = q @ self.spread.T + self.shift
        R, p = np.empty((len(q), len(self.parent), 3, 3)), np.empty((len(q), len(self.parent), 3))
        R[:, 0], p[:, 0] = np.eye(3), 0.0
        for i in range(1, len(self.parent)):
            parent, position = int(self.parent[i]), positions[:, i - 1]
            p[:, i] = p[:, parent] + R[:, parent] @ self.translation[i]
            R[:, i] = R[:, parent] @ self.rotation[i]
            if self.linear[i].any():
                p[:, i] += position[:, None] * (R[:, i] @ self.linear[i])
            if self.angular[i].any():
                R[:, i] = R[:, i] @ _rotation_about(self.angular[i], position)
        return R, p

    def joint_twists(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the twist (ω, v) that unit speed of each joint causes, at the base origin.

        A point x that the joint moves has velocity ω × x + v; its component along a direction n is
        ω · (x × n) + v · n.

        Args:
            R: Rotations of the joint frames, as `poses` returns them. Shape (N, J, 3, 3).
            p: Origins of the joint frames. Shape (N, J, 3) [m].

        Returns:
            Twists in the base frame. Shape (N, J, 6).
        """
        angular, linear = ((R @ axis[:, :, None])[..., 0] for axis in (self.angular, self.linear))
        x, y, z = (p[..., i] for i in range(3))
        u, v, w = (angular[..., i] for i in range(3))
        return np.concatenate(
            [angular, linear + np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)],
            axis=-1,
        )


def _rotation_about(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rodrigues' rotation matrices about a unit axis. Shapes (3,), (N,) -> (N, 3, 3)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * K + (1.0 - c) * (K @ K))
