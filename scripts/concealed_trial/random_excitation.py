"""Random excitation within the limits of a robot; all motions have the same duration."""

from __future__ import annotations

import numpy as np

from excite.simulator.mujoco_dynamics import build_dynamics
from excite.simulator.reference_trajectory import (
    ReferenceTrajectory,
    blended_fourier,
    fourier_series,
)
from excite.simulator.simulated_robot import SimulatedRobot
from excite.simulator.urdf_tree import UrdfTree

PERIOD = 8.0
"""Period of the excitation [s]."""
BLEND_TIME = 1.0
"""Duration of the blends from and to rest [s]."""
HARMONICS = 5
"""Harmonics of the excitation."""
TORQUE_SHARE = 0.85
"""Largest torque over the limit [1]; the controller needs the remainder."""
RANGE_LIMIT = 2.4
"""Bound of position on either side [rad], for joints with a larger range or none."""


def draw_excitation(
    robot: SimulatedRobot, periods: int, rng: np.random.Generator, *, poor: bool = False
) -> ReferenceTrajectory:
    """Draw a Fourier motion at 50-80 % of the velocity limits, within position and torque limits.

    Args:
        robot: The robot.
        periods: Number of periods.
        rng: Generator of the draw.
        poor: Use one harmonic at a tenth of the speed.
    """
    n = len(robot.joints)
    dynamics = build_dynamics(robot.tree, robot.joints, robot.lock, robot.gravity)
    velocity_limit = np.array(
        [robot.tree.velocity_and_torque_limit(name)[0] for name in robot.joints]
    )
    low, high = np.array([position_range(robot.tree, name) for name in robot.joints]).T
    harmonics = 1 if poor else HARMONICS
    sine, cosine = rng.standard_normal((2, n, harmonics))
    share = rng.uniform(0.5, 0.8, n) * (0.1 if poor else 1.0)
    grid = np.linspace(0.0, PERIOD, 400, endpoint=False)
    q, v, _ = fourier_series(sine, cosine, np.zeros(n), PERIOD)(grid)
    reach = 0.9 * (high - low)
    scale = np.minimum(share * velocity_limit / np.abs(v).max(axis=0), reach / np.ptp(q, axis=0))
    spare = 0.95 * (high - low) - scale * np.ptp(q, axis=0)
    centre = (
        0.5 * (low + high)
        + (rng.uniform(-0.4, 0.4, n)) * spare
        - 0.5 * scale * (q.max(axis=0) + q.min(axis=0))
    )
    for _ in range(20):
        motion = fourier_series(sine * scale[:, None], cosine * scale[:, None], centre, PERIOD)(
            grid
        )
        torque = (
            dynamics.inverse_dynamics(*motion)
            + robot.actuators.inertia * motion[2]
            + robot.actuators.friction_torque(motion[1])
        )
        overload = np.abs(torque).max(axis=0) / (TORQUE_SHARE * robot.torque_limit)
        if overload.max() <= 1.0:
            break
        # a slower motion does not reduce gravity: move towards hanging or upright poses as well
        scale = scale * 0.85
        centre = centre * 0.9
    return blended_fourier(
        robot.joints,
        sine * scale[:, None],
        cosine * scale[:, None],
        centre,
        PERIOD,
        periods,
        BLEND_TIME,
    )


def position_range(tree: UrdfTree, joint: str) -> tuple[float, float]:
    """Return the position limits of a joint, at most ±`RANGE_LIMIT` [rad]."""
    element = tree.joint_element(joint)
    limit = element.find("limit")
    low, high = -RANGE_LIMIT, RANGE_LIMIT
    if element.get("type") != "continuous" and limit is not None:
        low, high = (
            max(low, float(limit.get("lower", low))),
            min(high, float(limit.get("upper", high))),
        )
    return low, high
