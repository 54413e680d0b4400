"""Soles from the shapes of feet: where the shapes of a foot would touch flat ground.

The outline is the convex hull of the lowest points of the foot's shapes. The contact constraints
need a rectangle along the axes of the contact frame; it is the largest one inside the outline.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..collision import urdf_geometry
from ..collision.geometry import Shape, ShapeKind
from ..errors import UnusableInput
from ..robot.robot import Robot
from .support_stance import SoleSize

SOLE_TOLERANCE = 3e-3
"""Height over the lowest point up to which points belong to the sole [m]: soles of rubber are some
millimetres thick and yield by about this much, and meshes round or facet their edges."""

LEAST_HALF_WIDTH = 5e-3
"""Least half length and half width of a sole [m]: less is an edge or a point, not a sole."""

LARGEST_RATIO = 20.0
"""Largest ratio of the sides of the rectangle that is considered [1]."""


def find_sole(robot: Robot, frame: str, packages: Sequence[str] = ()) -> SoleSize:
    """Return the sole of a foot from its collision shapes, or else from its visual ones.

    Args:
        robot: The robot.
        frame: Contact frame, with its z axis up where all joints are at 0.
        packages: Folders of `package://` meshes.

    Raises:
        UnusableInput: The foot has no shapes, they are not flat, or a mesh does not exist.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    contact = robot.model.frames[robot.frame(frame)]
    remedy = "state its size with --sole LENGTH,WIDTH[,X,Y[,Z]]"
    for element in ("collision", "visual"):
        try:
            shapes = _shapes_of_body(robot, int(contact.parentJoint), element, packages)
        except urdf_geometry.MissingMesh as error:
            raise UnusableInput(
                f"{robot.source}: --support {frame}: the mesh {error.mesh} of its {element} shapes "
                f"is not found; say where with --packages DIR, or {remedy}"
            ) from error
        if shapes:
            break
    else:
        raise UnusableInput(f"{robot.source}: --support {frame}: its link has no shape; {remedy}")
    to_frame = contact.placement.inverse()
    points = np.vstack([_points(shape, to_frame * placement) for shape, placement in shapes])
    height = float(points[:, 2].min())
    lowest = points[points[:, 2] <= height + SOLE_TOLERANCE, :2]
    fault = (
        f"{robot.source}: --support {frame}: the lowest points of its {element} shapes form no "
        f"flat sole; {remedy}"
    )
    try:
        hull = ConvexHull(lowest)
    except (QhullError, ValueError) as error:
        raise UnusableInput(fault) from error
    centre, half = largest_rectangle(hull.equations)
    if half.min() < LEAST_HALF_WIDTH:
        raise UnusableInput(fault)
    outline = lowest[hull.vertices] - centre
    return SoleSize(
        float(half[0]),
        float(half[1]),
        (float(centre[0]), float(centre[1])),
        height,
        tuple((float(x), float(y)) for x, y in outline),
        f"{element} shapes: points at most {1e3 * SOLE_TOLERANCE:g} mm above the lowest",
    )


def _shapes_of_body(
    robot: Robot, joint: int, element: str, packages: Sequence[str]
) -> list[tuple[Shape, pin.SE3]]:
    """Return the shapes that a joint moves, with their poses in its frame."""
    out = []
    for shape in urdf_geometry.read(robot.source, packages, element):
        link = robot.model.frames[robot.frame(str(shape.link))]
        if int(link.parentJoint) == joint:
            out.append((shape, link.placement * shape.placement))
    return out


def _points(shape: Shape, placement: pin.SE3) -> FloatArray:
    """Return points of a shape in another frame; the lowest one of a round shape. Shape (m, 3)."""
    if shape.kind in (ShapeKind.SPHERE, ShapeKind.CAPSULE):
        return np.array([[*placement.translation[:2], shape.lowest(placement)]])
    corners = shape.triangles().reshape(-1, 3)
    return np.asarray(corners @ placement.rotation.T + placement.translation)


def largest_rectangle(equations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest rectangle along the axes inside a convex polygon.

    For a ratio of its sides, the rectangle with centre c and half sides h that satisfies
    A c + |A| h ≤ b is found by linear programming; the area is unimodal in the ratio.

    Args:
        equations: Rows (a, −b) of the polygon a·p ≤ b. Shape (m, 3).

    Returns:
        Centre and half sides. Shape (2,) each [m].
    """
    from scipy.optimize import linprog, minimize_scalar  # slow to import

    A, b = equations[:, :2], -equations[:, 2]

    def solved(log_ratio: float) -> FloatArray:
        shape = np.exp([-0.5 * log_ratio, 0.5 * log_ratio])
        rows = np.column_stack([A, np.abs(A) @ shape])
        result = linprog([0.0, 0.0, -1.0], rows, b, bounds=[(None, None), (None, None), (0, None)])
        return np.asarray([*result.x[:2], *(result.x[2] * shape)])

    limit = float(np.log(LARGEST_RATIO))
    best = minimize_scalar(
        lambda r: -float(np.prod(solved(r)[2:])), bounds=(-limit, limit), method="bounded"
    )
    solution = solved(float(best.x))
    return solution[:2], solution[2:]
