"""Report of `excite design --for-payload LINK --static`: poses at rest and the motion between."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from ..collision.workcell import Cell
from ..designer.static_poses import StaticDesign
from ..robot.robot import Robot
from .content import Banner, ReportContent, Section, Table
from .figures.static_poses import draw_poses
from .figures.trajectory import MotionScene, draw_kinematics
from .formatting import number
from .render import render


def static_poses_page(design: StaticDesign, robot: Robot, cell: Cell | None) -> str:
    """Render the report of static poses as HTML.

    Args:
        design: The poses, the motion and its certificate.
        robot: The robot.
        cell: Surroundings that were checked; None: distances were not checked.
    """
    trajectory, certificate, deviation = design.trajectory, design.certificate, design.deviation
    clearance, limits = certificate.verdict_lines()
    tone = "good" if certificate.ok else "bad"
    scene = MotionScene(trajectory.motion, trajectory.limits, robot, cell)
    count = len(design.poses)
    content = ReportContent(
        title=f"Static poses for a payload of {robot.name}",
        subtitle=f"{count} poses at rest that show mass and centre of mass of a body at "
        f"{design.link}, each reached from both sides.",
        banners=[
            Banner(limits.capitalize() + ".", tone),
            Banner(clearance.capitalize() + ".", tone if cell is not None else "warn"),
            Banner("Moments of inertia are not shown by static poses.", "warn"),
        ],
        cards=[
            (f"{1e3 * deviation.mass:.3g} g", "predicted standard deviation of the mass"),
            (
                f"{1e3 * float(deviation.centre.max()):.2g} mm",
                "of the centre of mass of 1 kg, largest coordinate",
            ),
            (f"{trajectory.motion.duration:.1f} s", "from rest to rest"),
        ],
        sections=[
            _pose_section(design, robot, scene),
            _prediction_section(design, robot),
            Section(
                "motion",
                "How does the robot move?",
                "Position, velocity, acceleration and jerk with their limits; the robot rests "
                "where the positions are level.",
                {"figures": [Markup(svg) for _, svg in draw_kinematics(scene)]},
            ),
        ],
        footer=f"excite {trajectory.versions['excite']}, seed {trajectory.seed}",
    )
    return render("summary", content)


def _pose_section(design: StaticDesign, robot: Robot, scene: MotionScene) -> Section:
    """The poses in numbers and in space."""
    rows = [
        (joint, *(number(float(pose[j]), 3) for pose in design.poses))
        for j, joint in enumerate(robot.joints)
    ]
    head = ("joint", *(f"pose {k + 1}" for k in range(len(design.poses))))
    units = {entry.unit("rad") for entry in robot.entries}
    return Section(
        "poses",
        "At which poses does the robot rest?",
        f"Joint positions [{' or '.join(sorted(units))}], in the order of the motion. Every joint "
        "arrives at every pose once from above and once from below, so that its friction at rest "
        f"cancels. The poses are D-optimal: one is worth {number(design.efficiency, 2)} random "
        "ones.",
        {
            "figures": [Markup(draw_poses(scene, design.poses))],
            "tables": [Table(head, rows, tuple(range(1, len(head))))],
        },
    )


def _prediction_section(design: StaticDesign, robot: Robot) -> Section:
    """Predicted standard deviations and what they assume."""
    deviation = design.deviation
    rows = [("mass", number(1e3 * deviation.mass, 3), "g")]
    rows += [
        (f"centre of mass of 1 kg, {axis}", number(1e3 * float(value), 3), "mm")
        for axis, value in zip("xyz", deviation.centre, strict=True)
    ]
    rows += [(f"moment of inertia {name}", "not shown", "") for name in ("xx", "xy", "yy")]
    rows += [(f"moment of inertia {name}", "not shown", "") for name in ("xz", "yz", "zz")]
    friction = ", ".join(
        f"{joint} {number(float(value), 3)}"
        for joint, value in zip(robot.joints, np.asarray(deviation.friction), strict=True)
    )
    return Section(
        "prediction",
        "How precisely will the payload be known?",
        "Standard deviations before the motion runs, by the difference of recordings with and "
        "without payload. Friction at rest may be anything within Coulomb friction, evenly: "
        f"{friction} [N m or N]. Where it follows the direction of the arrival, the estimate is "
        "better; 'excite payload --static' finds that from the recordings.",
        {"tables": [Table(("quantity", "standard deviation", "unit"), rows, (1,))]},
    )
