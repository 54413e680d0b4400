"""Rigid-body dynamics in CasADi, for exact derivatives; Pinocchio's wheel has no CasADi binding.

Spatial vectors are pairs (angular, linear) in body frames. The recursion is Featherstone's (Rigid
Body Dynamics Algorithms, 2008), the body regressor that of Atkeson, An and Hollerbach (1986).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from .._types import FloatArray, IntArray
from ..robot.inertial_parameters import COULOMB_WIDTH, Parameters
from ..robot.robot import Robot
from . import casadi_batch

SpatialVector = tuple[ca.SX, ca.SX]
"""Angular and linear part of a spatial vector in a body frame."""

ROUNDING = 1e-14
"""Entries of constant matrices below this are rounding errors of 0 [1 or m]."""


@dataclass(frozen=True)
class DynamicsFunctions:
    """CasADi functions of one sample of motion (q, dq, ddq), each of shape (n,).

    Attributes:
        regressor: Returns Yᵀ, dense, shape (P, n); so that samples become rows of a C array
            (N, n, P).
        adjoint: Maps (q, dq, ddq, Ȳᵀ) to the gradients of ⟨Ȳ, Y⟩ by q, dq and ddq, by one reverse
            sweep.
        row: Maps (q, dq, ddq, w, s), shapes (P,) and (n,), to the gradients of sᵀ Y w by q, dq and
            ddq, for single torque limits.
        library: Compiled functions, possibly still being compiled; None without a compiler.
        support: For each joint the columns of Y that can differ from 0.
    """

    regressor: ca.Function
    adjoint: ca.Function
    row: ca.Function
    library: casadi_batch.CompiledLibrary | None
    support: tuple[IntArray, ...]


def axis_rotation(axis: FloatArray, angle: ca.SX) -> ca.SX:
    """Return the rotation about a unit axis by Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R = (
        ca.SX.eye(3)
        + ca.sin(angle) * ca.sparsify(ca.SX(K))
        + (1.0 - ca.cos(angle)) * ca.sparsify(ca.SX(K @ K))
    )
    return ca.sparsify(R)


def constant(matrix: FloatArray) -> ca.SX:
    """Return a constant without rounding errors, so that zeros remain structural."""
    return ca.sparsify(ca.SX(np.where(np.abs(matrix) < ROUNDING, 0.0, matrix)))


def _inertia_times(vector: ca.SX) -> ca.SX:
    """Return the map from (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) to I·vector. Shape (3, 6)."""
    x, y, z = vector[0], vector[1], vector[2]
    out = ca.SX(3, 6)
    out[0, 0], out[0, 1], out[0, 3] = x, y, z
    out[1, 1], out[1, 2], out[1, 4] = x, y, z
    out[2, 3], out[2, 4], out[2, 5] = x, y, z
    return out


def body_regressor(w: ca.SX, dw: ca.SX, a: ca.SX) -> ca.SX:
    """Return the map from inertial parameters φ to (moment, force) on a body. Shape (6, 10).

    Args:
        w: Angular velocity.
        dw: Angular acceleration.
        a: Acceleration of the origin minus gravity.
    """
    out = ca.SX(6, 10)
    out[3:6, 0] = a
    out[3:6, 1:4] = ca.skew(dw) + ca.mtimes(ca.skew(w), ca.skew(w))
    out[0:3, 1:4] = -ca.skew(a)
    out[0:3, 4:10] = _inertia_times(dw) + ca.mtimes(ca.skew(w), _inertia_times(w))
    return out


@dataclass(frozen=True)
class BodyPlacements:
    """Kinematic tree at one configuration, for each body.

    Attributes:
        rotation: Rotation from the body to its parent.
        lever: Origin of the body in the frame of its parent [m].
        axis: Motion axis of its joint in its own frame.
        parent: Index of its parent, −1 for the base.
    """

    rotation: list[ca.SX]
    lever: list[ca.SX]
    axis: list[SpatialVector]
    parent: list[int]


def kinematic_tree(robot: Robot, q: ca.SX) -> BodyPlacements:
    """Return the kinematic tree at positions `q`."""
    model = robot.model
    coordinates = ca.mtimes(constant(robot.spread), q) + ca.SX(robot.shift)
    rotation, lever, axis, parent = [], [], [], []
    for i, unit in enumerate(robot.axes(), start=1):
        placement = model.jointPlacements[i]
        linear, angular = unit[:3], unit[3:]
        R, p = constant(placement.rotation), constant(placement.translation)
        if np.linalg.norm(angular) > 0.5:
            rotation.append(ca.mtimes(R, axis_rotation(angular, coordinates[i - 1])))
            lever.append(p)
        else:
            rotation.append(R)
            lever.append(p + ca.mtimes(R, constant(linear)) * coordinates[i - 1])
        axis.append((constant(angular), constant(linear)))
        parent.append(int(model.parents[i]) - 1)
    return BodyPlacements(rotation, lever, axis, parent)


@dataclass(frozen=True)
class BodyMotions:
    """Motion of each body in its own frame.

    Attributes:
        w: Angular velocity.
        dw: Angular acceleration.
        acc: Acceleration of the origin minus gravity.
    """

    w: list[ca.SX]
    dw: list[ca.SX]
    acc: list[ca.SX]


def body_motions(
    robot: Robot,
    kinematics: BodyPlacements,
    dq: ca.SX,
    ddq: ca.SX,
    base: tuple[ca.SX, ca.SX, ca.SX] | None = None,
) -> BodyMotions:
    """Propagate velocities and accelerations from the base to the tips.

    Args:
        robot: The robot.
        kinematics: Its kinematic tree.
        dq: Joint velocities.
        ddq: Joint accelerations.
        base: Angular velocity, angular acceleration and acceleration of the origin minus gravity of
            the base link, in its own frame; None: it does not move.
    """
    spread = constant(robot.spread)
    v, a = ca.mtimes(spread, dq), ca.mtimes(spread, ddq)
    out = BodyMotions([], [], [])
    if base is None:
        base = (ca.SX(3, 1), ca.SX(3, 1), constant(-np.array(robot.model.gravity.linear)))
    for i, up in enumerate(kinematics.parent):
        back = kinematics.rotation[i].T
        w0, dw0, a0 = base if up < 0 else (out.w[up], out.dw[up], out.acc[up])
        turn, slide = kinematics.axis[i]
        wp = ca.mtimes(back, w0)
        out.w.append(wp + turn * v[i])
        out.dw.append(ca.mtimes(back, dw0) + turn * a[i] + ca.cross(wp, turn) * v[i])
        carried = (
            a0
            + ca.cross(dw0, kinematics.lever[i])
            + ca.cross(w0, ca.cross(w0, kinematics.lever[i]))
        )
        out.acc.append(ca.mtimes(back, carried) + slide * a[i] + 2.0 * ca.cross(wp, slide) * v[i])
    return out


def _inertial_regressor(robot: Robot, kinematics: BodyPlacements, motion: BodyMotions) -> ca.SX:
    """Return the regressor of the inertial parameters. Shape (n, 10·bodies).

    Block (j, i) is the wrench map of body i along the axis of joint j, for i and all its ancestors.
    """
    count = robot.model.nv
    Y = ca.SX(count, 10 * count)
    # for each body the axes of its own joint and of its ancestors' joints, in its frame
    carried: list[dict[int, SpatialVector]] = []
    for i, up in enumerate(kinematics.parent):
        back = kinematics.rotation[i].T
        above = carried[up] if up >= 0 else {}
        axes = {
            j: (ca.mtimes(back, turn), ca.mtimes(back, slide + ca.cross(turn, kinematics.lever[i])))
            for j, (turn, slide) in above.items()
        }
        axes[i] = kinematics.axis[i]
        carried.append(axes)
        wrench = body_regressor(motion.w[i], motion.dw[i], motion.acc[i])
        for j, (turn, slide) in axes.items():
            Y[j, 10 * i : 10 * i + 10] = ca.mtimes(ca.vertcat(turn, slide).T, wrench)
    return ca.mtimes(constant(robot.spread).T, Y)


def inverse_dynamics(
    robot: Robot, kinematics: BodyPlacements, motion: BodyMotions, phi: ca.SX
) -> tuple[ca.SX, SpatialVector]:
    """Return the torque of bodies with given inertial parameters, by one recursion.

    Args:
        robot: The robot.
        kinematics: Its kinematic tree.
        motion: Motion of its bodies.
        phi: Inertial parameters of the bodies. Shape (10·bodies,).

    Returns:
        Joint torques, the regressor times `phi`, shape (n,), and the moment and force that the base
        link exerts on the bodies, at its origin and in its frame.
    """
    torque = ca.SX(robot.model.nv, 1)
    moments, forces = [], []
    base_moment, base_force = ca.SX(3, 1), ca.SX(3, 1)
    for i, (w, dw, acc) in enumerate(zip(motion.w, motion.dw, motion.acc, strict=True)):
        mass, h, inertia = phi[10 * i], phi[10 * i + 1 : 10 * i + 4], phi[10 * i + 4 : 10 * i + 10]
        forces.append(mass * acc + ca.cross(dw, h) + ca.cross(w, ca.cross(w, h)))
        moments.append(
            ca.mtimes(_inertia_times(dw), inertia)
            + ca.cross(w, ca.mtimes(_inertia_times(w), inertia))
            + ca.cross(h, acc)
        )
    for i in reversed(range(len(forces))):
        turn, slide = kinematics.axis[i]
        torque[i] = ca.dot(turn, moments[i]) + ca.dot(slide, forces[i])
        force = ca.mtimes(kinematics.rotation[i], forces[i])
        moment = ca.mtimes(kinematics.rotation[i], moments[i]) + ca.cross(
            kinematics.lever[i], force
        )
        if (up := kinematics.parent[i]) >= 0:
            forces[up] += force
            moments[up] += moment
        else:
            base_force += force
            base_moment += moment
    return ca.mtimes(constant(robot.spread).T, torque), (base_moment, base_force)


def dynamics_functions(robot: Robot, parameters: Parameters) -> DynamicsFunctions:
    """Build the functions of one sample of motion that the optimiser needs.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
    """
    n = robot.n
    q, dq, ddq = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq"))
    state = ca.vertcat(q, dq, ddq)
    columns = {
        "rotor_inertia": ddq,
        "viscous": dq,
        "coulomb": ca.tanh(dq / COULOMB_WIDTH),
        "offset": ca.SX.ones(n),
    }
    kinematics = kinematic_tree(robot, q)
    motion = body_motions(robot, kinematics, dq, ddq)
    Y = ca.horzcat(
        _inertial_regressor(robot, kinematics, motion),
        *[ca.diag(columns[kind]) for kind in parameters.drive],
    )
    seed, weight, pick = (
        ca.SX.sym("seed", parameters.count, n),
        ca.SX.sym("weight", parameters.count),
        ca.SX.sym("pick", n),
    )
    gradient = ca.jtimes(ca.vec(Y.T), state, ca.vec(seed), True)
    torque, _ = inverse_dynamics(robot, kinematics, motion, weight)
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
    return DynamicsFunctions(
        regressor, adjoint, row, casadi_batch.find_library((regressor, adjoint, row)), support
    )


def link_torque(
    robot: Robot, q: ca.SX, dq: ca.SX, ddq: ca.SX, phi: ca.SX, lift: ca.SX | None = None
) -> ca.SX:
    """Return the torque of the links, without actuators, by inverse dynamics.

    Args:
        robot: The robot.
        q: Joint positions. Shape (n,).
        dq: Joint velocities. Shape (n,).
        ddq: Joint accelerations. Shape (n,).
        phi: Inertial parameters of all bodies. Shape (10·bodies,).
        lift: Acceleration of the base minus gravity [m/s²]; None: the robot's gravity alone.

    Returns:
        Joint torques. Shape (n,) [N m].
    """
    kinematics = kinematic_tree(robot, q)
    base = None if lift is None else (ca.SX(3, 1), ca.SX(3, 1), lift)
    motion = body_motions(robot, kinematics, dq, ddq, base)
    return ca.densify(inverse_dynamics(robot, kinematics, motion, phi)[0])


def frame_position(robot: Robot, frame: str) -> ca.Function:
    """Build the function of the position of a frame.

    Args:
        robot: The robot.
        frame: Name of the frame.

    Returns:
        Function from q, shape (n,), to the origin of the frame in the base frame, shape (3,) [m],
        and its Jacobian, shape (3, n).
    """
    q = ca.SX.sym("q", robot.n)
    kinematics = kinematic_tree(robot, q)
    target = robot.model.frames[robot.frame(frame)]
    point, j = constant(target.placement.translation), int(target.parentJoint) - 1
    while j >= 0:
        point = kinematics.lever[j] + ca.mtimes(kinematics.rotation[j], point)
        j = kinematics.parent[j]
    return ca.Function("position", [q], [ca.densify(point), ca.densify(ca.jacobian(point, q))])
