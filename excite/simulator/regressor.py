"""The base model's columns, by Newton and Euler in numpy: an answer of its own to what MuJoCo computes.

Per body, in its own frame: f = m a + α×h + ω×(ω×h), n = Iα + ω×(Iω) + h×a, linear in [m, h, I]; a joint feels axis·n or axis·f.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from .._types import FloatArray
from .mujoco_dynamics import RigidBodyDynamics

MUJOCO_SLIDE = 2  # MuJoCo's number for a prismatic joint


def rigid_body_regressor(
    arm: RigidBodyDynamics, q: FloatArray, v: FloatArray, a: FloatArray
) -> FloatArray:
    """Columns of [m, m·c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] of each body that moves, at its frame. Shapes (N, n) -> (N, n, 10·bodies)."""
    model, rows = arm.model, len(q)
    turn = {0: np.broadcast_to(np.eye(3), (rows, 3, 3))}
    zero = np.zeros((rows, 3))
    place, spin, surge = {0: zero}, {0: zero}, {0: zero}
    pull = {0: np.broadcast_to(-np.array(model.opt.gravity), (rows, 3))}
    chain: dict[int, list[int]] = {0: []}
    axes, blocks = np.zeros((arm.n, rows, 3)), []
    for b in range(1, model.nbody):
        p = int(model.body_parentid[b])
        arm_of = np.einsum("kij,j->ki", turn[p], model.body_pos[b])
        r = turn[p] @ Rotation.from_quat(model.body_quat[b][[1, 2, 3, 0]]).as_matrix()
        place[b], spin[b], surge[b] = place[p] + arm_of, spin[p], surge[p]
        pull[b] = (
            pull[p] + np.cross(surge[p], arm_of) + np.cross(spin[p], np.cross(spin[p], arm_of))
        )
        chain[b] = list(chain[p])
        if model.body_jntnum[b]:
            j = int(model.body_jntadr[b])
            axis = np.einsum("kij,j->ki", r, model.jnt_axis[j])
            axes[j], chain[b] = axis, [*chain[b], j]
            along, rate, gain = q[:, j, None] * axis, v[:, j, None] * axis, a[:, j, None] * axis
            if model.jnt_type[j] == MUJOCO_SLIDE:
                place[b] = place[b] + along
                pull[b] = (
                    pull[b]
                    + np.cross(surge[b], along)
                    + np.cross(spin[b], np.cross(spin[b], along))
                    + gain
                    + 2 * np.cross(spin[b], rate)
                )
            else:
                r = r @ Rotation.from_rotvec(q[:, j, None] * model.jnt_axis[j]).as_matrix()
                surge[b] = surge[b] + gain + np.cross(spin[b], rate)
                spin[b] = spin[b] + rate
        turn[b] = r
        if chain[b]:
            blocks.append(
                _body_columns(arm, b, chain[b], turn, place, (spin[b], surge[b], pull[b]), axes)
            )
    return np.concatenate(blocks, axis=2)


def _body_columns(
    arm: RigidBodyDynamics,
    b: int,
    chain: list[int],
    turn: dict[int, FloatArray],
    place: dict[int, FloatArray],
    motion: tuple[FloatArray, FloatArray, FloatArray],
    axes: FloatArray,
) -> FloatArray:
    """One body's ten columns at every joint. Shape (N, n, 10)."""
    model, r = arm.model, turn[b]
    force, moment = _wrench(*(np.einsum("kji,kj->ki", r, x) for x in motion))
    force, moment = r @ force, r @ moment
    out = np.zeros((len(r), arm.n, 10))
    for j in chain:
        away = place[b] - place[int(model.jnt_bodyid[j])]
        if model.jnt_type[j] == MUJOCO_SLIDE:
            out[:, j] = np.einsum("ki,kic->kc", axes[j], force)
        else:
            out[:, j] = np.einsum("ki,kic->kc", axes[j], moment) + np.einsum(
                "ki,kic->kc", np.cross(axes[j], away), force
            )
    return out


def _wrench(w: FloatArray, alpha: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Force and moment at the frame's origin, per unit parameter, in the body's frame. Shapes (N, 3, 10)."""
    force, moment = np.zeros((len(w), 3, 10)), np.zeros((len(w), 3, 10))
    force[:, :, 0] = a
    turning = _skew(alpha) + _skew(w) @ _skew(w)
    force[:, :, 1:4] = turning
    moment[:, :, 1:4] = -_skew(a)
    moment[:, :, 4:] = _inertia_product(alpha) + _skew(w) @ _inertia_product(w)
    return force, moment


def _skew(x: FloatArray) -> FloatArray:
    out = np.zeros((len(x), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -x[:, 2], x[:, 1], -x[:, 0]
    return out - np.swapaxes(out, 1, 2)


def _inertia_product(x: FloatArray) -> FloatArray:
    """I x = _times(x) [Ixx, Ixy, Iyy, Ixz, Iyz, Izz]. Shape (N, 3, 6)."""
    out = np.zeros((len(x), 3, 6))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 3] = x[:, 0], x[:, 1], x[:, 2]
    out[:, 1, 1], out[:, 1, 2], out[:, 1, 4] = x[:, 0], x[:, 1], x[:, 2]
    out[:, 2, 3], out[:, 2, 4], out[:, 2, 5] = x[:, 0], x[:, 1], x[:, 2]
    return out


def actuator_regressor(v: FloatArray, a: FloatArray, width: FloatArray) -> FloatArray:
    """Columns of rotor inertia, viscous, Coulomb friction and offset of each joint. Shapes (N, n) -> (N, n, 4n)."""
    rows, n = v.shape
    out = np.zeros((rows, n, 4, n))
    for j in range(n):
        out[:, j, :, j] = np.column_stack(
            [a[:, j], v[:, j], np.tanh(v[:, j] / width[j]), np.ones(rows)]
        )
    return out.reshape(rows, n, 4 * n)
