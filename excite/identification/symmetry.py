"""Prior that the bodies on the left and on the right of a robot mirror each other.

With all joints at 0 the placements H_L, H_R of a pair of links mirror each other at a plane through
the base link, D = diag(±1, ±1, ±1, 1) with one −1. Mirrored bodies then have pseudo-inertias
P_R = A P_L Aᵀ with A = H_R⁻¹ D H_L. The difference of a body from its mirrored partner, in the
metric at the nominal body, is normally distributed with RELATIVE_DEVIATION in each direction.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.floating_base import FloatingRobot
from ..robot.inertial_parameters import Parameters, frame_map, metric
from .consistency import consistent_nominal, inertial_rows

RELATIVE_DEVIATION = 0.05
"""Standard deviation of the difference of mirrored bodies in the metric [1]: segments of healthy
limbs and parts of one drawing differ by a few percent."""
MAX_MIRROR_ERROR = 0.05
"""Distance of a link from its mirrored partner [m] above which the two are no pair."""


def mirrored_pairs(parameters: Parameters, left: str, right: str) -> list[tuple[int, int]]:
    """Return the indices of the bodies on the left and on the right.

    Args:
        parameters: Standard parameters.
        left: Prefix of the names of links on the left.
        right: Prefix of the names of links on the right.

    Raises:
        UnusableInput: A link has no partner, or there is no pair.
    """
    pairs = []
    for i, link in enumerate(parameters.links):
        if not link.startswith(left):
            continue
        partner = right + link.removeprefix(left)
        if partner not in parameters.links:
            raise UnusableInput(
                f"--symmetric {left}:{right}: link '{link}' has no partner '{partner}' with a mass"
            )
        pairs.append((i, parameters.links.index(partner)))
    if not pairs:
        raise UnusableInput(
            f"--symmetric {left}:{right}: no link with a mass begins with '{left}'; there are "
            f"{', '.join(parameters.links)}"
        )
    return pairs


def symmetry_root(
    robot: FloatingRobot, parameters: Parameters, left: str, right: str
) -> FloatArray:
    """Return R with ‖R ψ‖² the squared distance of all pairs from symmetry over its variance.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        left: Prefix of the names of links on the left.
        right: Prefix of the names of links on the right.

    Returns:
        Shape (10 pairs, P).

    Raises:
        UnusableInput: A link has no partner, or the placements of the links are no mirror images.
    """
    pairs = mirrored_pairs(parameters, left, right)
    placements = _placements(robot)
    mirror = _mirror(robot, parameters, pairs, placements)
    nominal = inertial_rows(parameters, consistent_nominal(parameters))
    out = np.zeros((10 * len(pairs), parameters.count))
    for k, (i, j) in enumerate(pairs):
        map_to_right = np.asarray(np.linalg.solve(placements[j], mirror @ placements[i]))
        reflected = frame_map(map_to_right)
        root = np.linalg.cholesky(metric(nominal[j])).T / RELATIVE_DEVIATION
        out[10 * k : 10 * k + 10, 10 * j : 10 * j + 10] = root
        out[10 * k : 10 * k + 10, 10 * i : 10 * i + 10] = -root @ reflected
    return out


def _placements(robot: FloatingRobot) -> list[FloatArray]:
    """Placement of each body in the base link with all joints at 0, as homogeneous matrices."""
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    return [np.array((data.oMi[1].inverse() * data.oMi[i]).homogeneous) for i in robot.bodies]


def _mirror(
    robot: FloatingRobot,
    parameters: Parameters,
    pairs: list[tuple[int, int]],
    placements: list[FloatArray],
) -> FloatArray:
    """Reflection at the coordinate plane of the base link that maps left links to right ones."""
    errors = []
    for axis in range(3):
        reflection = np.eye(4)
        reflection[axis, axis] = -1.0
        distances = [
            float(np.linalg.norm((reflection @ placements[i] - placements[j])[:3, 3]))
            for i, j in pairs
        ]
        errors.append((max(distances), axis, int(np.argmax(distances))))
    error, axis, worst = min(errors)
    if error > MAX_MIRROR_ERROR:
        i, j = pairs[worst]
        raise UnusableInput(
            f"{robot.source}: --symmetric: '{parameters.links[i]}' and '{parameters.links[j]}' are "
            f"{error:.2g} m from mirror images with all joints at 0; check the names"
        )
    out = np.eye(4)
    out[axis, axis] = -1.0
    return out
