"""Load on the stand that holds the base of a robot: symbolic for the optimiser, by Pinocchio for
certificates.

The load is the wrench that the base exerts on the stand, with the weight of all links: the
magnitudes of its force and of its moment about the point of the stand. Links have the inertias of
the model.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.limits import Limits, Stand
from ..robot.robot import Robot
from ..robot.samples import Samples
from .casadi_model import body_motions, constant, inverse_dynamics, kinematic_tree

LOADS = ("force", "moment")
"""Names of the two magnitudes."""

SMOOTHING = 1e-9
"""Magnitude at which the norms are rounded off [N, N m], for their derivative at 0."""


def require_weight(robot: Robot, limits: Limits) -> None:
    """Check that the stand takes the weight of the robot.

    Raises:
        UnusableInput: It does not.
    """
    if limits.stand is None:
        return
    if robot.weight >= limits.stand.force:
        raise UnusableInput(
            f"{limits.stand.source}: [stand] force {limits.stand.force:g} N is not above the "
            f"weight of {robot.name}, {robot.weight:.4g} N; state the load that the stand takes "
            "with the robot"
        )


def load_function(robot: Robot, stand: Stand) -> ca.Function:
    """Build the function of the two loads.

    Args:
        robot: The robot, whose base is fixed.
        stand: The stand.

    Returns:
        Function from q, q̇ and q̈ to the loads over their limits, shape (2,), and their gradients
        by q, q̇ and q̈, shape (2, n) each.
    """
    q, dq, ddq = (ca.SX.sym(name, robot.n) for name in ("q", "dq", "ddq"))
    kinematics = kinematic_tree(robot, q)
    inertias = [np.array(inertia.toDynamicParameters()) for inertia in robot.model.inertias]
    phi = ca.SX(np.concatenate(inertias[1:]))
    motion = body_motions(robot, kinematics, dq, ddq)
    moment, force = inverse_dynamics(robot, kinematics, motion, phi)[1]
    base, lift = robot.model.inertias[0], -np.array(robot.model.gravity.linear)
    force += constant(base.mass * lift)
    moment += constant(np.cross(base.mass * np.array(base.lever), lift))
    moment -= ca.cross(constant(np.array(stand.point)), force)
    loads = ca.vertcat(
        *(
            ca.sqrt(ca.sumsqr(part) + SMOOTHING**2) / bound
            for part, bound in ((force, stand.force), (moment, stand.moment))
        )
    )
    gradients = [ca.densify(ca.jacobian(loads, v)) for v in (q, dq, ddq)]
    return ca.Function("stand", [q, dq, ddq], [ca.densify(loads), *gradients])


def stand_loads(robot: Robot, stand: Stand, motion: Samples) -> FloatArray:
    """Compute force and moment along a motion by the recursive Newton-Euler algorithm.

    Args:
        robot: The robot, whose base is fixed.
        stand: The stand.
        motion: Samples of the motion.

    Returns:
        Magnitudes. Shape (N, 2) [N, N m].
    """
    model, data = robot.model, robot.model.createData()
    children = [i for i in range(1, model.njoints) if int(model.parents[i]) == 0]
    at_rest = pin.Motion(-np.array(model.gravity.linear), np.zeros(3))
    of_base = model.inertias[0] * at_rest
    about = pin.SE3(np.eye(3), np.array(stand.point))
    q = robot.expand(motion.q)
    v, a = motion.dq @ robot.spread.T, motion.ddq @ robot.spread.T
    out = np.empty((len(q), len(LOADS)))
    for row, *coordinates in zip(out, q, v, a, strict=True):
        pin.rnea(model, data, *coordinates)
        total = of_base
        for child in children:
            total = total + data.oMi[child].act(data.f[child])
        local = about.actInv(total)
        row[:] = np.linalg.norm(local.linear), np.linalg.norm(local.angular)
    return out
