"""Figure of a validation motion: phase planes of two motions."""

from __future__ import annotations

import numpy as np

from ...robot.robot import Robot
from ...trajectory.trajectory_file import Trajectory
from .drawing import COMPACT_LAYOUT_JOINTS
from .small_multiples import PhasePlane, draw_phase_planes
from .trajectory import is_prismatic, short_names


def draw_motion_pair(first: Trajectory, second: Trajectory, robot: Robot) -> str:
    """Draw velocity against position of every joint over a period of both motions."""
    curves = []
    for trajectory in (first, second):
        fourier = trajectory.motion.fourier
        t = fourier.grid(300 if robot.n <= COMPACT_LAYOUT_JOINTS else 150)
        curves.append(np.stack([fourier.at(t), fourier.at(t, 1)], axis=-1))
    limits, sliding = first.limits, is_prismatic(robot)
    # whole turns are removed where a joint may turn so far: a turn further is the same place
    turning = np.array([not slides for slides in sliding]) & (
        limits.position[:, 1] - limits.position[:, 0] >= 2.0 * np.pi
    )
    apart = second.motion.fourier.offset - first.motion.fourier.offset
    curves[1][:, :, 0] -= np.where(turning, 2.0 * np.pi * np.rint(apart / (2.0 * np.pi)), 0.0)
    names, panels = short_names(robot.joints, 26), []
    for j, (joint, slides) in enumerate(zip(names, sliding, strict=True)):
        lower, upper = (-np.inf, np.inf) if turning[j] else limits.position[j]
        speed = float(limits.velocity[j])
        title = f"{joint} (m)" if slides else joint
        panels.append(
            PhasePlane(
                title,
                curves[0][:, j],
                curves[1][:, j],
                (float(lower), float(upper)),
                (-speed, speed),
            )
        )
    is_compact = robot.n > COMPACT_LAYOUT_JOINTS
    turns = ", whole turns removed" if turning.any() else ""
    return draw_phase_planes(
        "Velocity against position of every joint",
        panels,
        ("motion", "validation"),
        f"velocity [rad/s] against position [rad]{turns}",
        columns=5 if is_compact else min(robot.n, 3),
        height=80.0 if is_compact else 110.0,
    )
