"""Rigid-body dynamics in CasADi: what the optimiser differentiates. Pinocchio's wheel has no CasADi binding.

Spatial vectors are pairs (angular, linear) in body frames; the recursion is Featherstone's, the body regressor that of
Atkeson, An & Hollerbach (1986).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from .parameters import COULOMB_WIDTH, Parameters
from .robot import Robot

Pair = tuple[ca.SX, ca.SX]


@dataclass(frozen=True)
class Functions:
    """CasADi functions of one sample of motion (q, dq, ddq), each of shape (n,).

    regressor: -> Yᵀ (P, n), dense; transposed, so that samples side by side are rows of a C array (N, n, P).
    adjoint: (q, dq, ddq, Ȳᵀ) -> gradients of ⟨Ȳ, Y⟩ with respect to q, dq, ddq; one reverse sweep.
    rows: per joint j, (q, dq, ddq, w (P,)) -> gradient (3n,) of Y_j w, for torque limits row by row.
    """

    regressor: ca.Function
    adjoint: ca.Function
    rows: tuple[ca.Function, ...]


def _rotate(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    """Rodrigues' formula for a unit axis."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R = ca.SX.eye(3) + ca.sin(angle) * ca.sparsify(ca.SX(K)) + (1.0 - ca.cos(angle)) * ca.sparsify(ca.SX(K @ K))
    return ca.sparsify(R)


def _clean(matrix: np.ndarray) -> ca.SX:
    """A constant with rounding dust removed, so that zeros stay structural."""
    return ca.sparsify(ca.SX(np.where(np.abs(matrix) < 1e-14, 0.0, matrix)))


def _lever(vector: ca.SX) -> ca.SX:
    """The 3x6 map from (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) to I·vector."""
    x, y, z = vector[0], vector[1], vector[2]
    out = ca.SX(3, 6)
    out[0, 0], out[0, 1], out[0, 3] = x, y, z
    out[1, 1], out[1, 2], out[1, 4] = x, y, z
    out[2, 3], out[2, 4], out[2, 5] = x, y, z
    return out


def _body(w: ca.SX, dw: ca.SX, a: ca.SX) -> ca.SX:
    """6x10 map from φ to (moment, force): w, dw angular velocity and acceleration, a that of the origin minus gravity."""
    out = ca.SX(6, 10)
    out[3:6, 0] = a
    out[3:6, 1:4] = ca.skew(dw) + ca.mtimes(ca.skew(w), ca.skew(w))
    out[0:3, 1:4] = -ca.skew(a)
    out[0:3, 4:10] = _lever(dw) + ca.mtimes(ca.skew(w), _lever(w))
    return out


@dataclass(frozen=True)
class _Kinematics:
    rotation: list[ca.SX]  # parent from child
    lever: list[ca.SX]  # child's origin in the parent's frame
    axis: list[Pair]  # (angular, linear) motion axis, child frame
    parent: list[int]


def _kinematics(robot: Robot, q: ca.SX) -> _Kinematics:
    model = robot.model
    coordinates = ca.mtimes(_clean(robot.spread), q) + ca.SX(robot.shift)
    rotation, lever, axis, parent = [], [], [], []
    for i, unit in enumerate(robot.axes(), start=1):
        placement = model.jointPlacements[i]
        linear, angular = unit[:3], unit[3:]
        R, p = _clean(placement.rotation), _clean(placement.translation)
        if np.linalg.norm(angular) > 0.5:
            rotation.append(ca.mtimes(R, _rotate(angular, coordinates[i - 1])))
            lever.append(p)
        else:
            rotation.append(R)
            lever.append(p + ca.mtimes(R, _clean(linear)) * coordinates[i - 1])
        axis.append((_clean(angular), _clean(linear)))
        parent.append(int(model.parents[i]) - 1)
    return _Kinematics(rotation, lever, axis, parent)


def _inertial_regressor(robot: Robot, q: ca.SX, dq: ca.SX, ddq: ca.SX) -> ca.SX:
    spread = _clean(robot.spread)
    v, a = ca.mtimes(spread, dq), ca.mtimes(spread, ddq)
    kin = _kinematics(robot, q)
    count = robot.model.nv
    Y = ca.SX(count, 10 * count)
    w: list[ca.SX] = []
    dw: list[ca.SX] = []
    acc: list[ca.SX] = []
    still, lift = ca.SX(3, 1), _clean(-np.array(robot.model.gravity.linear))
    for i in range(count):
        up, back = kin.parent[i], kin.rotation[i].T
        w0, dw0, a0 = (still, still, lift) if up < 0 else (w[up], dw[up], acc[up])
        turn, slide = kin.axis[i]
        wp = ca.mtimes(back, w0)
        w.append(wp + turn * v[i])
        dw.append(ca.mtimes(back, dw0) + turn * a[i] + ca.cross(wp, turn) * v[i])
        carried = a0 + ca.cross(dw0, kin.lever[i]) + ca.cross(w0, ca.cross(w0, kin.lever[i]))
        acc.append(ca.mtimes(back, carried) + slide * a[i] + 2.0 * ca.cross(wp, slide) * v[i])
        wrench = _body(w[i], dw[i], acc[i])
        # Row j of the block is body i's wrench along axis j: the axes of all ancestors are carried to frame i.
        angular, linear, j = turn, slide, i
        R, p = ca.SX.eye(3), ca.SX(3, 1)  # frame i seen from frame j
        while j >= 0:
            turn_j, slide_j = kin.axis[j]
            angular = ca.mtimes(R.T, turn_j)
            linear = ca.mtimes(R.T, slide_j + ca.cross(turn_j, p))
            Y[j, 10 * i : 10 * i + 10] = ca.mtimes(ca.vertcat(angular, linear).T, wrench)
            p = kin.lever[j] + ca.mtimes(kin.rotation[j], p)
            R = ca.mtimes(kin.rotation[j], R)
            j = kin.parent[j]
    return ca.mtimes(spread.T, Y)


def functions(robot: Robot, parameters: Parameters) -> Functions:
    """Build the functions of one sample that the optimiser needs, all with exact derivatives."""
    n = robot.n
    q, dq, ddq = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq"))
    columns = {
        "rotor_inertia": ca.diag(ddq),
        "viscous": ca.diag(dq),
        "coulomb": ca.diag(ca.tanh(dq / COULOMB_WIDTH)),
        "offset": ca.SX.eye(n),
    }
    Y = ca.horzcat(_inertial_regressor(robot, q, dq, ddq), *[columns[kind] for kind in parameters.drive])
    seed = ca.SX.sym("seed", parameters.count, n)
    state = ca.vertcat(q, dq, ddq)
    gradient = ca.jtimes(ca.vec(Y.T), state, ca.vec(seed), True)
    weight = ca.SX.sym("weight", parameters.count)
    rows = []
    for j in range(n):
        row = ca.gradient(ca.mtimes(Y[j, :], weight), state)
        rows.append(ca.Function(f"row{j}", [q, dq, ddq, weight], [ca.densify(row)]))
    return Functions(
        regressor=ca.Function("regressor", [q, dq, ddq], [ca.densify(Y.T)]),
        adjoint=ca.Function("adjoint", [q, dq, ddq, seed], [ca.densify(g) for g in ca.vertsplit(gradient, n)]),
        rows=tuple(rows),
    )


def position(robot: Robot, frame: str) -> ca.Function:
    """Origin of a frame in the base frame and its Jacobian: q (n,) -> (3,), (3, n) [m]."""
    q = ca.SX.sym("q", robot.n)
    kin = _kinematics(robot, q)
    target = robot.model.frames[robot.frame(frame)]
    point, j = _clean(target.placement.translation), int(target.parentJoint) - 1
    while j >= 0:
        point = kin.lever[j] + ca.mtimes(kin.rotation[j], point)
        j = kin.parent[j]
    return ca.Function("position", [q], [ca.densify(point), ca.densify(ca.jacobian(point, q))])
