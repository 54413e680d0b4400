"""How many parameters a robot's structure lets one see, counted without any sample of motion.

The recursion of Wensing, Niemeyer & Slotine (A geometric characterization of observability in
inertial parameter identification, IJRR 2024): the invisible directions are sums of transfers across
single joints. A change δI of body i's inertia is invisible across joint i, up to an equal change of
its parent, when for all attainable velocities v, w of the body (gravity counted as an acceleration
of the base) Sᵢᵀ δI v = 0   and   vᵀ (ad(S)ᵀ δI + δI ad(S)) w = 0. Here it also counts rotor inertia
and a constant torque offset, which the first condition can trade against δI.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .inertial_parameters import Parameters
from .robot import Robot

Array = np.ndarray
_TOLERANCE = 1e-9


def _spatial_inertia(phi: Array) -> Array:
    """6x6 inertia about the joint's origin for (linear, angular) vectors; linear in φ, defined for
    mass 0 too."""
    lever = pin.skew(phi[1:4])
    tensor = np.array(
        [[phi[4], phi[5], phi[7]], [phi[5], phi[6], phi[8]], [phi[7], phi[8], phi[9]]]
    )
    return np.block([[phi[0] * np.eye(3), -lever], [lever, tensor]])


_INERTIAS = np.array([_spatial_inertia(unit) for unit in np.eye(10)])


def _span(columns: Array) -> Array:
    """Orthonormal basis of the columns' span."""
    if columns.shape[1] == 0:
        return columns
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    keep = values > _TOLERANCE * max(1.0, float(values[0]))
    return np.ascontiguousarray(left[:, keep])


def _poses(robot: Robot, index: int, axis: Array) -> list[pin.SE3]:
    """Placements of body `index` in its parent at coordinates that together show all the joint can
    do.

    A joint's action on velocities is a trigonometric polynomial of degree ≤ 2, or one of degree ≤ 2
    in a slide: five coordinates determine it.
    """
    placement = robot.model.jointPlacements[index]
    steps = (
        np.arange(5) * (2.0 * np.pi / 5.0)
        if np.linalg.norm(axis[3:]) > 0.5
        else np.linspace(-1.0, 1.0, 5)
    )
    return [placement * pin.exp6(pin.Motion(axis * step)) for step in steps]


def _ad(axis: Array) -> Array:
    """Matrix of the motion cross product S × for (linear, angular) vectors."""
    linear, angular = pin.skew(axis[:3]), pin.skew(axis[3:])
    return np.block([[angular, linear], [np.zeros((3, 3)), angular]])


def base_count(robot: Robot, parameters: Parameters) -> int:
    """Number of base parameters that the structure of `robot` admits.

    Exact for every tree of one-degree joints. Mimic joints, whose transfers are not single-joint,
    are not covered: the count is then of the robot with its mimic joints moving freely, an upper
    bound.
    """
    model = robot.model
    rotor, offset = "rotor_inertia" in parameters.drive, "offset" in parameters.drive
    motions: list[Array] = [np.zeros((6, 0))]
    gravity: list[Array] = [np.concatenate([np.asarray(model.gravity.linear), np.zeros(3)])]
    changes: list[Array] = [np.zeros((6, 0))]
    invisible = 0
    for i, axis in enumerate(robot.axes(), start=1):
        parent, poses = model.parents[i], _poses(robot, i, axis)
        actions = [pose.inverse().action for pose in poses]
        reached = _span(np.hstack([action @ motions[parent] for action in actions]))
        pulls = [action @ gravity[parent] for action in actions]
        varying = _span(
            np.hstack(
                [
                    np.column_stack(pulls[1:]) - pulls[0][:, None],
                    *[a @ changes[parent] for a in actions],
                ]
            )
        )
        invisible += _transfers(axis, reached, pulls[0], varying, rotor, offset)
        motions.append(_span(np.column_stack([reached, axis])))
        gravity.append(pulls[0])
        changes.append(varying)
    drives = len(parameters.drive) * (model.nv if robot.n == model.nv else robot.n)
    return 10 * parameters.bodies + drives - invisible


def _transfers(
    axis: Array, reached: Array, pull: Array, varying: Array, rotor: bool, offset: bool
) -> int:
    """Dimension of the invisible changes (δφ, rotor inertia, offset) of one body and joint."""
    momenta = np.einsum("a,kab->kb", axis, _INERTIAS)  # Sᵀ E_k
    conditions = [
        np.hstack([(momenta @ vector), 0.0, 0.0]) for vector in np.hstack([reached, varying]).T
    ]
    conditions.append(np.hstack([momenta @ axis, 1.0, 0.0]))
    conditions.append(np.hstack([momenta @ pull, 0.0, 1.0]))
    turned = np.array([_ad(axis).T @ inertia + inertia @ _ad(axis) for inertia in _INERTIAS])
    others = np.column_stack([reached, varying, pull])
    conditions += [np.hstack([turned @ w @ v, 0.0, 0.0]) for v in reached.T for w in others.T]
    matrix = np.array(conditions)
    keep = [True] * 10 + [rotor, offset]
    values = np.linalg.svd(matrix[:, keep], compute_uv=False)
    rank = int(np.sum(values > _TOLERANCE * max(1.0, float(values[0]))))
    return int(np.sum(keep)) - rank
