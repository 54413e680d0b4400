"""Random excitation within a robot's limits, each as long as any other."""

from __future__ import annotations

import numpy as np

from excite.simulator import reference_trajectory
from excite.simulator.mujoco_dynamics import build
from excite.simulator.reference_trajectory import Reference
from excite.simulator.simulated_robot import Plant
from excite.simulator.urdf_tree import Tree

Array = np.ndarray
PERIOD, RAMP, HARMONICS = 8.0, 1.0, 5


def draw(plant: Plant, periods: int, rng: np.random.Generator, *, poor: bool = False) -> Reference:
    """A Fourier motion at 50-80 % of the top speed, within position and 85 % of the torque limits. poor: one harmonic at a tenth of it."""
    n, arm = len(plant.joints), build(plant.tree, plant.joints, plant.lock, plant.gravity)
    speed = np.array([plant.tree.limits(name)[0] for name in plant.joints])
    low, high = np.array([position(plant.tree, name) for name in plant.joints]).T
    harmonics = 1 if poor else HARMONICS
    sine, cosine = rng.standard_normal((2, n, harmonics))
    share = rng.uniform(0.5, 0.8, n) * (0.1 if poor else 1.0)
    grid = np.linspace(0.0, PERIOD, 400, endpoint=False)
    wave = reference_trajectory.fourier(sine, cosine, np.zeros(n), PERIOD)
    q, v, _ = wave(grid)
    reach = 0.9 * (high - low)
    scale = np.minimum(share * speed / np.abs(v).max(axis=0), reach / np.ptp(q, axis=0))
    spare = 0.95 * (high - low) - scale * np.ptp(q, axis=0)
    middle = (
        0.5 * (low + high)
        + (rng.uniform(-0.4, 0.4, n)) * spare
        - 0.5 * scale * (q.max(axis=0) + q.min(axis=0))
    )
    for _ in range(20):
        motion = reference_trajectory.fourier(
            sine * scale[:, None], cosine * scale[:, None], middle, PERIOD
        )(grid)
        torque = (
            arm.inverse(*motion) + plant.drive.inertia * motion[2] + plant.drive.friction(motion[1])
        )
        over = np.abs(torque).max(axis=0) / (0.85 * plant.limit)
        if over.max() <= 1.0:
            break
        # gravity is not slowed: move towards hanging or upright poses as well as towards rest
        scale = scale * 0.85
        middle = middle * 0.9
    return reference_trajectory.blended(
        plant.joints, sine * scale[:, None], cosine * scale[:, None], middle, PERIOD, periods, RAMP
    )


def position(tree: Tree, joint: str) -> tuple[float, float]:
    """Range of a joint, not above a turn's three quarters either way [rad]."""
    element = tree.joint(joint)
    limit = element.find("limit")
    low, high = -2.4, 2.4
    if element.get("type") != "continuous" and limit is not None:
        low, high = (
            max(low, float(limit.get("lower", low))),
            min(high, float(limit.get("upper", high))),
        )
    return low, high
