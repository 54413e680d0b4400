"""Rigid-body dynamics in CasADi: what the optimiser differentiates. Pinocchio's wheel has no CasADi binding.

Spatial vectors are pairs (angular, linear) in body frames; the recursion is Featherstone's, the body regressor that of
Atkeson, An & Hollerbach (1986).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..robot.inertial_parameters import COULOMB_WIDTH, Parameters
from ..robot.robot import Robot
from . import casadi_batch

Pair = tuple[ca.SX, ca.SX]


@dataclass(frozen=True)
class Functions:
    """CasADi functions of one sample of motion (q, dq, ddq), each of shape (n,).

    regressor: -> Yᵀ (P, n), dense; transposed, so that samples side by side are rows of a C array (N, n, P).
    adjoint: (q, dq, ddq, Ȳᵀ) -> gradients of ⟨Ȳ, Y⟩ with respect to q, dq, ddq; one reverse sweep.
    row: (q, dq, ddq, w (P,), s (n,)) -> gradients of sᵀ Y w with respect to q, dq, ddq, for torque limits row by row.
    library: where their C is compiled, or will be; None without a compiler.
    support: per joint the columns of Y that can differ from 0.
    """

    regressor: ca.Function
    adjoint: ca.Function
    row: ca.Function
    library: casadi_batch.Library | None
    support: tuple[np.ndarray, ...]


def _rotate(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    """Rodrigues' formula for a unit axis."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R = (
        ca.SX.eye(3)
        + ca.sin(angle) * ca.sparsify(ca.SX(K))
        + (1.0 - ca.cos(angle)) * ca.sparsify(ca.SX(K @ K))
    )
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


@dataclass(frozen=True)
class _Velocities:
    """Per body, in its own frame: angular velocity and acceleration, and the origin's acceleration minus gravity."""

    w: list[ca.SX]
    dw: list[ca.SX]
    acc: list[ca.SX]


def _velocities(robot: Robot, kin: _Kinematics, dq: ca.SX, ddq: ca.SX) -> _Velocities:
    spread = _clean(robot.spread)
    v, a = ca.mtimes(spread, dq), ca.mtimes(spread, ddq)
    out = _Velocities([], [], [])
    still, lift = ca.SX(3, 1), _clean(-np.array(robot.model.gravity.linear))
    for i, up in enumerate(kin.parent):
        back = kin.rotation[i].T
        w0, dw0, a0 = (still, still, lift) if up < 0 else (out.w[up], out.dw[up], out.acc[up])
        turn, slide = kin.axis[i]
        wp = ca.mtimes(back, w0)
        out.w.append(wp + turn * v[i])
        out.dw.append(ca.mtimes(back, dw0) + turn * a[i] + ca.cross(wp, turn) * v[i])
        carried = a0 + ca.cross(dw0, kin.lever[i]) + ca.cross(w0, ca.cross(w0, kin.lever[i]))
        out.acc.append(ca.mtimes(back, carried) + slide * a[i] + 2.0 * ca.cross(wp, slide) * v[i])
    return out


def _inertial_regressor(robot: Robot, kin: _Kinematics, motion: _Velocities) -> ca.SX:
    """Block (j, i) is body i's 6x10 wrench map along the axis of joint j, for i itself and every ancestor j."""
    count = robot.model.nv
    Y = ca.SX(count, 10 * count)
    carried: list[
        dict[int, Pair]
    ] = []  # per body the axes of itself and its ancestors, in its frame
    for i, up in enumerate(kin.parent):
        back = kin.rotation[i].T
        above = carried[up] if up >= 0 else {}
        axes = {
            j: (ca.mtimes(back, turn), ca.mtimes(back, slide + ca.cross(turn, kin.lever[i])))
            for j, (turn, slide) in above.items()
        }
        axes[i] = kin.axis[i]
        carried.append(axes)
        wrench = _body(motion.w[i], motion.dw[i], motion.acc[i])
        for j, (turn, slide) in axes.items():
            Y[j, 10 * i : 10 * i + 10] = ca.mtimes(ca.vertcat(turn, slide).T, wrench)
    return ca.mtimes(_clean(robot.spread).T, Y)


def _inverse_dynamics(robot: Robot, kin: _Kinematics, motion: _Velocities, phi: ca.SX) -> ca.SX:
    """Torque of bodies with inertial parameters `phi`, ten a body: the regressor times phi, at the cost of one recursion."""
    torque = ca.SX(robot.model.nv, 1)
    moments, forces = [], []
    for i, (w, dw, acc) in enumerate(zip(motion.w, motion.dw, motion.acc, strict=True)):
        mass, h, inertia = phi[10 * i], phi[10 * i + 1 : 10 * i + 4], phi[10 * i + 4 : 10 * i + 10]
        forces.append(mass * acc + ca.cross(dw, h) + ca.cross(w, ca.cross(w, h)))
        moments.append(
            ca.mtimes(_lever(dw), inertia)
            + ca.cross(w, ca.mtimes(_lever(w), inertia))
            + ca.cross(h, acc)
        )
    for i in reversed(range(len(forces))):
        turn, slide = kin.axis[i]
        torque[i] = ca.dot(turn, moments[i]) + ca.dot(slide, forces[i])
        if (up := kin.parent[i]) >= 0:
            force = ca.mtimes(kin.rotation[i], forces[i])
            forces[up] += force
            moments[up] += ca.mtimes(kin.rotation[i], moments[i]) + ca.cross(kin.lever[i], force)
    return ca.mtimes(_clean(robot.spread).T, torque)


def functions(robot: Robot, parameters: Parameters) -> Functions:
    """Build the functions of one sample that the optimiser needs, all with exact derivatives."""
    n = robot.n
    q, dq, ddq = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq"))
    state = ca.vertcat(q, dq, ddq)
    columns = {
        "rotor_inertia": ddq,
        "viscous": dq,
        "coulomb": ca.tanh(dq / COULOMB_WIDTH),
        "offset": ca.SX.ones(n),
    }
    kin = _kinematics(robot, q)
    motion = _velocities(robot, kin, dq, ddq)
    Y = ca.horzcat(
        _inertial_regressor(robot, kin, motion),
        *[ca.diag(columns[kind]) for kind in parameters.drive],
    )
    seed, weight, pick = (
        ca.SX.sym("seed", parameters.count, n),
        ca.SX.sym("weight", parameters.count),
        ca.SX.sym("pick", n),
    )
    gradient = ca.jtimes(ca.vec(Y.T), state, ca.vec(seed), True)
    torque = _inverse_dynamics(robot, kin, motion, weight)
    for kind in parameters.drive:
        torque += columns[kind] * weight[parameters.block(kind)]
    along = ca.gradient(ca.dot(pick, torque), state)
    regressor = ca.Function("regressor", [q, dq, ddq], [ca.densify(Y.T)])
    adjoint = ca.Function(
        "adjoint", [q, dq, ddq, seed], [ca.densify(g) for g in ca.vertsplit(gradient, n)]
    )
    row = ca.Function(
        "row", [q, dq, ddq, weight, pick], [ca.densify(g) for g in ca.vertsplit(along, n)]
    )
    support = tuple(np.array(Y[j, :].sparsity().get_col(), int) for j in range(n))
    return Functions(
        regressor, adjoint, row, casadi_batch.library((regressor, adjoint, row)), support
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
