"""Simulated robots and their motions, shared by the tests of the simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from excite.robot.robot import locate
from excite.simulator.reference_trajectory import ReferenceTrajectory, blended_fourier
from excite.simulator.urdf_tree import read_urdf

MODELS = locate("two_link").parent
TRAJECTORIES = Path(__file__).parents[1] / "trajectories"


def builtin_urdf(name: str) -> Path:
    """Return the path of a built-in model."""
    return MODELS / f"{name}.urdf"


def quick_motion(seconds: float = 2.0, seed: int = 0, n: int = 2) -> ReferenceTrajectory:
    """Return a fast motion of `two_link`, or of n joints like it."""
    rng = np.random.default_rng(seed)
    sine, cosine = 1.2 * rng.standard_normal((2, n, 3))
    return blended_fourier(
        read_urdf(builtin_urdf("two_link")).joints,
        sine,
        cosine,
        np.array([-1.4, 0.6]),
        seconds - 0.6,
        1,
        0.3,
    )
