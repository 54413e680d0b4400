"""Dynamics in CasADi of a robot that stands on one or two feet, for exact derivatives.

The base link moves with the coordinates b = (x, y, z, roll, pitch, yaw): its origin in the world,
and the rotation Rz(yaw)·Ry(pitch)·Rx(roll). The joints of a support leg are a function of b, given
by the closed chain; its first two time derivatives follow from those of the chain's equations.

The wrench of the ground is determined by the motion (eq. 12 of Lee, Kwon, Wensing and Park). Two
feet share it as stated in `contact_wrenches`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from .._types import FloatArray, IntArray
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from . import casadi_batch
from .casadi_model import (
    BodyMotions,
    BodyPlacements,
    axis_rotation,
    body_motions,
    body_regressor,
    constant,
    inverse_dynamics,
    kinematic_tree,
)
from .support_stance import BASE_COORDINATES, Foot, Stance

BODY_STATE = 21
"""Numbers that describe a body: rotation (9, column by column) and origin (3) in the frame of the
base link, angular velocity, angular acceleration and acceleration minus gravity in its own."""

WRENCH_SIZE = 6
"""Components of a wrench: force, then moment."""

Triple = tuple[ca.SX, ca.SX, ca.SX]
"""Positions, velocities and accelerations."""


@dataclass(frozen=True)
class LegFunctions:
    """CasADi functions of the closed chain of one support leg.

    Attributes:
        joints: Indices of its joints, from the base to the foot. Shape (6,).
        closure: Maps (b, l) to the six chain equations c = 0, ∂c/∂l and ∂c/∂b.
        rates: Maps (b, ḃ, b̈, l, l̇) to ċ without l̇ and c̈ without l̈, so that
            ∂c/∂l l̇ = −ċ and ∂c/∂l l̈ = −c̈.
        jets: Maps (b, ḃ, b̈, l, l̇, l̈) to the Jacobians of (c, ċ, c̈) by (b, ḃ, b̈) and by
            (l, l̇, l̈). Shape (18, 18) each.
    """

    joints: IntArray
    closure: ca.Function
    rates: ca.Function
    jets: ca.Function


@dataclass(frozen=True)
class SupportFunctions:
    """CasADi functions of one sample; the motion is (b, q) with two derivatives, each (6 + n,).

    Attributes:
        bodies: Maps the motion to the state of all bodies, the base link first. Shape
            (BODY_STATE, n + 1).
        bodies_adjoint: Maps the motion and the gradient by the state of the bodies to the gradient
            by the motion.
        regressor: Maps the state of a body to its block of the regressor of the base rows,
            transposed. Shape (10, 6).
        regressor_adjoint: Maps the state of a body and the gradient by that block to the gradient
            by the state.
        rows: Maps the motion to the joint torques over their limits, shape (n,), and to the contact
            constraints, at most 1 where they hold.
        rows_adjoint: Maps the motion and weights of these rows to the gradient by the motion.
        contact_names: Name of each contact constraint.
        legs: The support legs.
        library: Compiled functions; None without a compiler.
    """

    bodies: ca.Function
    bodies_adjoint: ca.Function
    regressor: ca.Function
    regressor_adjoint: ca.Function
    rows: ca.Function
    rows_adjoint: ca.Function
    contact_names: tuple[str, ...]
    legs: tuple[LegFunctions, ...]
    library: casadi_batch.CompiledLibrary | None


def base_rotation(angles: ca.SX) -> ca.SX:
    """Return Rz(yaw)·Ry(pitch)·Rx(roll) of the angles (roll, pitch, yaw)."""
    x, y, z = np.eye(3)
    return ca.mtimes(
        [axis_rotation(z, angles[2]), axis_rotation(y, angles[1]), axis_rotation(x, angles[0])]
    )


def _along(expression: ca.SX, variables: Sequence[ca.SX], rates: Sequence[ca.SX]) -> ca.SX:
    """Return the derivative of an expression along rates of its variables."""
    return ca.jtimes(expression, ca.vertcat(*variables), ca.vertcat(*rates))


def _base_motion(robot: Robot, b: ca.SX, db: ca.SX, ddb: ca.SX) -> Triple:
    """Return angular velocity, angular acceleration and acceleration minus gravity of the base.

    All are in the frame of the base link.
    """
    R = base_rotation(b[3:6])
    angles, rates = b[3:6], db[3:6]
    spin = ca.mtimes(R.T, ca.reshape(ca.jtimes(ca.vec(R), angles, rates), 3, 3))
    w = ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0])
    dw = _along(w, (angles, rates), (rates, ddb[3:6]))
    return w, dw, ca.mtimes(R.T, ddb[0:3] - ca.SX(np.array(robot.model.gravity.linear)))


def _poses(placements: BodyPlacements) -> list[tuple[ca.SX, ca.SX]]:
    """Return rotation and origin of each body in the frame of the base link."""
    out: list[tuple[ca.SX, ca.SX]] = []
    for rotation, lever, up in zip(
        placements.rotation, placements.lever, placements.parent, strict=True
    ):
        R, p = out[up] if up >= 0 else (ca.SX.eye(3), ca.SX(3, 1))
        out.append((ca.mtimes(R, rotation), p + ca.mtimes(R, lever)))
    return out


def _leg_functions(
    robot: Robot, foot: Foot, number: int, b: ca.SX, q: ca.SX, placements: BodyPlacements
) -> LegFunctions:
    """Build the functions of the closed chain that ends at a foot."""
    joints = foot.joints
    R0 = base_rotation(b[3:6])
    R, p = _poses(placements)[int(joints[-1])]
    R, p = ca.mtimes(R0, R), b[0:3] + ca.mtimes(R0, p)
    offset = ca.SX(np.array(foot.in_body.translation))
    error = ca.mtimes(constant(np.array(foot.body_rotation())).T, R)
    closure = ca.vertcat(
        p + ca.mtimes(R, offset) - ca.SX(np.array(foot.in_world.translation)),
        0.5
        * ca.vertcat(
            error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]
        ),
    )
    names = ("l", "dl", "ddl")
    leg, dleg, ddleg = (ca.SX.sym(name, len(joints)) for name in names)
    closure = ca.substitute([closure], [q], [ca.densify(_scatter(leg, joints, robot.n))])[0]
    db, ddb = ca.SX.sym("db", BASE_COORDINATES), ca.SX.sym("ddb", BASE_COORDINATES)
    first = _along(closure, (b, leg), (db, dleg))
    second = _along(first, (b, leg, db, dleg), (db, dleg, ddb, ddleg))
    without_dleg = ca.substitute([first], [dleg], [ca.SX.zeros(len(joints), 1)])[0]
    without_ddleg = ca.substitute([second], [ddleg], [ca.SX.zeros(len(joints), 1)])[0]
    equations = ca.vertcat(closure, first, second)
    y, z = ca.vertcat(b, db, ddb), ca.vertcat(leg, dleg, ddleg)
    densify = ca.densify
    return LegFunctions(
        joints,
        ca.Function(
            f"closure{number}",
            [b, leg],
            # transposed, as results are stored column by column
            [
                densify(closure),
                densify(ca.jacobian(closure, leg)).T,
                densify(ca.jacobian(closure, b)).T,
            ],
        ),
        ca.Function(
            f"rates{number}",
            [b, db, ddb, leg, dleg],
            [densify(without_dleg), densify(without_ddleg)],
        ),
        ca.Function(
            f"jets{number}",
            [b, db, ddb, leg, dleg, ddleg],
            [densify(ca.jacobian(equations, y)).T, densify(ca.jacobian(equations, z)).T],
        ),
    )


def _scatter(values: ca.SX, places: IntArray, count: int) -> ca.SX:
    """Return a vector of zeros with values at some places."""
    out = ca.SX(count, 1)
    for value, place in enumerate(places):
        out[int(place)] = values[value]
    return out


def contact_wrenches(stance: Stance, force: ca.SX, moment: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Share the wrench of the ground between the feet.

    Foot i carries the share s_i of the force, and of the moment about the point that divides the
    line between the centres of the soles by the shares. They are chosen so that this moment has no
    component about the horizontal normal of that line: the centre of pressure of each foot lies at
    the same distance from the line. Σ r_i × s_i f = (Σ s_i r_i) × f, so the sum is exact.

    Args:
        stance: The feet.
        force: Force of the ground, in the world. Shape (3,) [N].
        moment: Its moment about the origin of the world. Shape (3,) [N m].

    Returns:
        Force and moment about the centre of its sole of each foot, in the world.
    """
    centres = [ca.SX(np.array(foot.in_world.translation)) for foot in stance.feet]
    about_first = moment - ca.cross(centres[0], force)
    if len(centres) == 1:
        return [(force, about_first)]
    line = np.array(stance.feet[1].in_world.translation - stance.feet[0].in_world.translation)
    normal = ca.SX(np.cross([0.0, 0.0, 1.0], line))
    share = ca.dot(normal, about_first) / ca.dot(normal, ca.cross(ca.SX(line), force))
    remaining = about_first - share * ca.cross(ca.SX(line), force)
    return [
        ((1.0 - share) * force, (1.0 - share) * remaining),
        (share * force, share * remaining),
    ]


def contact_rows(
    stance: Stance, foot: Foot, weight: float, force: ca.SX, moment: ca.SX
) -> tuple[list[str], list[ca.SX]]:
    """Return the constraints on the wrench of one foot: at most 1 where they hold.

    They are the closed form of the wrench cone of a rectangular sole (Caron, Pham and Nakamura,
    ICRA 2015), with the sole shrunk by the margin of the centre of pressure, and a friction pyramid
    inside the friction cone.

    Args:
        stance: The feet and the limits of their contact.
        foot: The foot.
        weight: Force by which the constraints are scaled [N].
        force: Force of the ground, in the world. Shape (3,) [N].
        moment: Its moment about the centre of the sole, in the world. Shape (3,) [N m].
    """
    R = constant(np.array(foot.in_world.rotation)).T
    (fx, fy, fz), (mx, my, mz) = (ca.vertsplit(ca.mtimes(R, v)) for v in (force, moment))
    length, width = foot.half_length, foot.half_width
    inner_length, inner_width = length - stance.contact.margin, width - stance.contact.margin
    mu = stance.contact.friction / np.sqrt(2.0)
    name = foot.frame
    rows = [(f"normal force of {name}", (stance.contact.least_share * weight - fz) / weight)]
    for sign in (1.0, -1.0):
        rows += [
            (f"centre of pressure of {name}", (sign * mx / inner_width - fz) / weight),
            (f"centre of pressure of {name}", (sign * my / inner_length - fz) / weight),
            (f"friction of {name}", (sign * fx / mu - fz) / weight),
            (f"friction of {name}", (sign * fy / mu - fz) / weight),
        ]
        # −(μ(X+Y) f_z − |Y f_x − μ m_x| − |X f_y − μ m_y|) ≤ m_z ≤ μ(X+Y) f_z − |Y f_x + μ m_x| − …
        for first in (1.0, -1.0):
            for second in (1.0, -1.0):
                slip = (
                    sign * mz
                    + first * (width * fx + sign * mu * mx)
                    + second * (length * fy + sign * mu * my)
                )
                lever = mu * (length + width)
                rows.append((f"turning friction of {name}", (slip / lever - fz) / weight))
    return [label for label, _ in rows], [1.0 + value for _, value in rows]


def support_functions(
    robot: Robot, parameters: Parameters, stance: Stance, torque_bound: FloatArray
) -> SupportFunctions:
    """Build the functions of one sample of motion that the optimiser needs.

    Args:
        robot: The robot; its base link moves.
        parameters: Its standard parameters, for those of its joints; the links have the inertias of
            the model.
        stance: The feet that stand on the ground.
        torque_bound: Limit of the torque of each joint. Shape (n,) [N m].
    """
    n = robot.n
    size = BASE_COORDINATES + n
    motion = [ca.SX.sym(name, size) for name in ("x", "dx", "ddx")]
    (b, db, ddb), (q, dq, ddq) = (
        [v[:BASE_COORDINATES] for v in motion],
        [v[BASE_COORDINATES:] for v in motion],
    )
    placements = kinematic_tree(robot, q)
    base = _base_motion(robot, b, db, ddb)
    moving = body_motions(robot, placements, dq, ddq, base)
    states = [_state(ca.SX.eye(3), ca.SX(3, 1), *base)]
    states += [
        _state(R, p, *rates)
        for (R, p), *rates in zip(_poses(placements), moving.w, moving.dw, moving.acc, strict=True)
    ]
    table = ca.densify(ca.horzcat(*states))
    seed = ca.SX.sym("seed", BODY_STATE, n + 1)
    gradient = ca.jtimes(ca.vec(table), ca.vertcat(*motion), ca.vec(seed), True)
    state = ca.SX.sym("state", BODY_STATE)
    block = _block(state)
    block_seed = ca.SX.sym("block_seed", 10, WRENCH_SIZE)
    torque, names, contacts = _constraint_rows(
        robot, parameters, stance, (b, dq, ddq), placements, moving, base
    )
    rows = ca.vertcat(torque / ca.SX(torque_bound), *contacts)
    weight = ca.SX.sym("weight", rows.shape[0])
    along = ca.gradient(ca.dot(weight, rows), ca.vertcat(*motion))
    leg_b, leg_q = ca.SX.sym("b", BASE_COORDINATES), ca.SX.sym("q", n)
    leg_placements = kinematic_tree(robot, leg_q)
    split = [0, size, 2 * size, 3 * size]
    functions = (
        ca.Function("bodies", motion, [table]),
        ca.Function(
            "bodies_adjoint",
            [*motion, seed],
            [ca.densify(g) for g in ca.vertsplit(gradient, split)],
        ),
        ca.Function("block", [state], [ca.densify(block.T)]),
        ca.Function(
            "block_adjoint",
            [state, block_seed],
            [ca.densify(ca.jtimes(ca.vec(block.T), state, ca.vec(block_seed), True))],
        ),
        ca.Function("rows", motion, [ca.densify(rows)]),
        ca.Function(
            "rows_adjoint", [*motion, weight], [ca.densify(g) for g in ca.vertsplit(along, split)]
        ),
    )
    legs = tuple(
        _leg_functions(robot, foot, i, leg_b, leg_q, leg_placements)
        for i, foot in enumerate(stance.feet)
    )
    compiled = [*functions, *(f for leg in legs for f in (leg.closure, leg.rates, leg.jets))]
    return SupportFunctions(*functions, tuple(names), legs, casadi_batch.find_library(compiled))


def _state(R: ca.SX, p: ca.SX, w: ca.SX, dw: ca.SX, acc: ca.SX) -> ca.SX:
    """Return the state of a body as one vector, see `BODY_STATE`."""
    return ca.vertcat(ca.vec(R), p, w, dw, acc)


def _block(state: ca.SX) -> ca.SX:
    """Return the wrench on the base link by the inertial parameters of a body. Shape (6, 10)."""
    R, p = ca.reshape(state[0:9], 3, 3), state[9:12]
    local = body_regressor(state[12:15], state[15:18], state[18:21])
    force = ca.mtimes(R, local[3:6, :])
    return ca.vertcat(force, ca.mtimes(R, local[0:3, :]) + ca.mtimes(ca.skew(p), force))


def _constraint_rows(
    robot: Robot,
    parameters: Parameters,
    stance: Stance,
    motion: Triple,
    placements: BodyPlacements,
    moving: BodyMotions,
    base: Triple,
) -> tuple[ca.SX, list[str], list[ca.SX]]:
    """Return the nominal torques, and names and values of the contact constraints."""
    b, dq, ddq = motion
    inertias = [np.array(inertia.toDynamicParameters()) for inertia in robot.model.inertias]
    phi = ca.SX(np.concatenate(inertias[1:]))
    torque, (moment, force) = inverse_dynamics(robot, placements, moving, phi)
    for kind, column in (("rotor_inertia", ddq), ("viscous", dq), ("offset", None)):
        if kind in parameters.drive:
            nominal = ca.SX(parameters.nominal[parameters.block(kind)])
            torque += nominal if column is None else nominal * column
    of_base = ca.mtimes(body_regressor(*base), ca.SX(inertias[0]))
    moment, force = moment + of_base[0:3], force + of_base[3:6]
    R0 = base_rotation(b[3:6])
    force = ca.mtimes(R0, force)
    moment = ca.mtimes(R0, moment) + ca.cross(b[0:3], force)
    weight = stance.weight / len(stance.feet)
    names, rows = [], []
    for foot, (f, m) in zip(stance.feet, contact_wrenches(stance, force, moment), strict=True):
        labels, values = contact_rows(stance, foot, weight, f, m)
        names += labels
        rows += values
        _subtract_contact(torque, placements, foot, f, m)
    return torque, names, rows


def _subtract_contact(
    torque: ca.SX, placements: BodyPlacements, foot: Foot, force: ca.SX, moment: ca.SX
) -> None:
    """Subtract the torque Jᵀw of the wrench on a foot from the torque of the joints of its leg."""
    R = constant(np.array(foot.body_rotation())).T
    f = ca.mtimes(R, force)
    m = ca.mtimes(R, moment) + ca.cross(ca.SX(np.array(foot.in_body.translation)), f)
    j = int(foot.joints[-1])
    while j >= 0:
        turn, slide = placements.axis[j]
        torque[j] -= ca.dot(turn, m) + ca.dot(slide, f)
        f = ca.mtimes(placements.rotation[j], f)
        m = ca.mtimes(placements.rotation[j], m) + ca.cross(placements.lever[j], f)
        j = placements.parent[j]
