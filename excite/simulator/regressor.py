"""Regressor of the base model by the Newton-Euler recursion in numpy, independent of MuJoCo.

Each body contributes f = m a + α×h + ω×(ω×h) and n = Iα + ω×(Iω) + h×a in its own frame, linear in
[m, h, I]; a joint feels axis·n or axis·f.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from .._types import FloatArray
from .mujoco_dynamics import RigidBodyDynamics

MUJOCO_SLIDE = 2
"""MuJoCo's number for a prismatic joint."""


def rigid_body_regressor(
    dynamics: RigidBodyDynamics, q: FloatArray, v: FloatArray, a: FloatArray
) -> FloatArray:
    """Return the columns of [m, m·c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] of each movable body.

    Args:
        dynamics: The robot.
        q: Positions, shape (N, n).
        v: Velocities, shape (N, n).
        a: Accelerations, shape (N, n).

    Returns:
        Regressor, shape (N, n, 10·bodies), parameters in the body frames.
    """
    model, rows = dynamics.model, len(q)
    rotation = {0: np.broadcast_to(np.eye(3), (rows, 3, 3))}
    zero = np.zeros((rows, 3))
    position, omega, alpha = {0: zero}, {0: zero}, {0: zero}
    acceleration = {0: np.broadcast_to(-np.array(model.opt.gravity), (rows, 3))}
    chain: dict[int, list[int]] = {0: []}
    axes, blocks = np.zeros((dynamics.n, rows, 3)), []
    for b in range(1, model.nbody):
        p = int(model.body_parentid[b])
        lever = np.einsum("kij,j->ki", rotation[p], model.body_pos[b])
        r = rotation[p] @ Rotation.from_quat(model.body_quat[b][[1, 2, 3, 0]]).as_matrix()
        position[b], omega[b], alpha[b] = position[p] + lever, omega[p], alpha[p]
        acceleration[b] = (
            acceleration[p]
            + np.cross(alpha[p], lever)
            + np.cross(omega[p], np.cross(omega[p], lever))
        )
        chain[b] = list(chain[p])
        if model.body_jntnum[b]:
            j = int(model.body_jntadr[b])
            axis = np.einsum("kij,j->ki", r, model.jnt_axis[j])
            axes[j], chain[b] = axis, [*chain[b], j]
            displacement, joint_velocity, joint_acceleration = (
                q[:, j, None] * axis,
                v[:, j, None] * axis,
                a[:, j, None] * axis,
            )
            if model.jnt_type[j] == MUJOCO_SLIDE:
                position[b] = position[b] + displacement
                acceleration[b] = (
                    acceleration[b]
                    + np.cross(alpha[b], displacement)
                    + np.cross(omega[b], np.cross(omega[b], displacement))
                    + joint_acceleration
                    + 2 * np.cross(omega[b], joint_velocity)
                )
            else:
                r = r @ Rotation.from_rotvec(q[:, j, None] * model.jnt_axis[j]).as_matrix()
                alpha[b] = alpha[b] + joint_acceleration + np.cross(omega[b], joint_velocity)
                omega[b] = omega[b] + joint_velocity
        rotation[b] = r
        if chain[b]:
            blocks.append(
                _body_columns(
                    dynamics,
                    b,
                    chain[b],
                    rotation,
                    position,
                    (omega[b], alpha[b], acceleration[b]),
                    axes,
                )
            )
    return np.concatenate(blocks, axis=2)


def _body_columns(
    dynamics: RigidBodyDynamics,
    b: int,
    chain: list[int],
    rotation: dict[int, FloatArray],
    position: dict[int, FloatArray],
    motion: tuple[FloatArray, FloatArray, FloatArray],
    axes: FloatArray,
) -> FloatArray:
    """Return the ten columns of a body at every joint, shape (N, n, 10)."""
    model, r = dynamics.model, rotation[b]
    force, moment = _wrench(*(np.einsum("kji,kj->ki", r, x) for x in motion))
    force, moment = r @ force, r @ moment
    out = np.zeros((len(r), dynamics.n, 10))
    for j in chain:
        lever = position[b] - position[int(model.jnt_bodyid[j])]
        if model.jnt_type[j] == MUJOCO_SLIDE:
            out[:, j] = np.einsum("ki,kic->kc", axes[j], force)
        else:
            out[:, j] = np.einsum("ki,kic->kc", axes[j], moment) + np.einsum(
                "ki,kic->kc", np.cross(axes[j], lever), force
            )
    return out


def _wrench(w: FloatArray, alpha: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return force and moment at a body frame's origin per unit parameter, shapes (N, 3, 10)."""
    force, moment = np.zeros((len(w), 3, 10)), np.zeros((len(w), 3, 10))
    force[:, :, 0] = a
    turning = _skew(alpha) + _skew(w) @ _skew(w)
    force[:, :, 1:4] = turning
    moment[:, :, 1:4] = -_skew(a)
    moment[:, :, 4:] = _inertia_product(alpha) + _skew(w) @ _inertia_product(w)
    return force, moment


def _skew(x: FloatArray) -> FloatArray:
    """Return the cross-product matrices of vectors. Shapes (N, 3) to (N, 3, 3)."""
    out = np.zeros((len(x), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -x[:, 2], x[:, 1], -x[:, 0]
    return out - np.swapaxes(out, 1, 2)


def _inertia_product(x: FloatArray) -> FloatArray:
    """Return the matrix L(x) with I x = L(x) [Ixx, Ixy, Iyy, Ixz, Iyz, Izz], shape (N, 3, 6)."""
    out = np.zeros((len(x), 3, 6))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 3] = x[:, 0], x[:, 1], x[:, 2]
    out[:, 1, 1], out[:, 1, 2], out[:, 1, 4] = x[:, 0], x[:, 1], x[:, 2]
    out[:, 2, 3], out[:, 2, 4], out[:, 2, 5] = x[:, 0], x[:, 1], x[:, 2]
    return out


def actuator_regressor(v: FloatArray, a: FloatArray, width: FloatArray) -> FloatArray:
    """Return the columns of rotor inertia, viscous and Coulomb friction and offset of each joint.

    Args:
        v: Velocities, shape (N, n).
        a: Accelerations, shape (N, n).
        width: Speed over which Coulomb friction changes sign, shape (n,) [rad/s].

    Returns:
        Regressor, shape (N, n, 4n).
    """
    rows, n = v.shape
    out = np.zeros((rows, n, 4, n))
    for j in range(n):
        out[:, j, :, j] = np.column_stack(
            [a[:, j], v[:, j], np.tanh(v[:, j] / width[j]), np.ones(rows)]
        )
    return out.reshape(rows, n, 4 * n)
