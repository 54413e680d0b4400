"""Floating-base robots and their shared files; tests that need an absent file are skipped."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from excite._types import FloatArray
from excite.recordings.floating_signals import POSE
from excite.robot.floating_base import FloatingMotion, FloatingRobot

_SHARED = Path(os.environ.get("EXCITE_SHARED", Path(__file__).resolve().parents[2] / "shared"))
HUMAN = _SHARED / "recordings" / "human_wrench"
"""Recording of a human on a force plate, with the URDF."""

BIPED_JOINTS = ("left_hip", "left_knee", "right_hip", "right_knee")
"""Joints of the robot of `biped_urdf`."""

needs_human = pytest.mark.skipif(
    not (HUMAN / "motion.csv").is_file(), reason=f"the shared recording is not at {HUMAN}"
)


def example_robot(path: str) -> Path:
    """Return the path of a URDF of the wheel example-robot-data, or skip the test without it.

    The wheel is searched in the environment variable EXAMPLE_ROBOT_DATA, a folder that contains
    the folder `robots`, then among the installed packages.
    """
    folders = [Path(os.environ["EXAMPLE_ROBOT_DATA"])] if "EXAMPLE_ROBOT_DATA" in os.environ else []
    try:
        import example_robot_data

        folders.append(Path(example_robot_data.__file__).parents[4] / "share/example-robot-data")
    except ImportError:
        pass
    folders.append(Path("/tmp/erd/cmeel.prefix/share/example-robot-data"))
    for folder in folders:
        if (folder / "robots" / path).is_file():
            return folder / "robots" / path
    pytest.skip(f"{path}: the wheel example-robot-data is absent; set EXAMPLE_ROBOT_DATA")


def biped_urdf(*, drive: bool = False) -> str:
    """Return the URDF of a small robot: a trunk and two legs of two joints, named left_/right_.

    Args:
        drive: True if joints state friction.
    """
    parts = [
        '<robot name="biped"><link name="trunk"><inertial><origin xyz="0.02 0.01 0.1"/>'
        '<mass value="8"/><inertia ixx="0.12" ixy="0.002" ixz="0.01" iyy="0.1" iyz="0" '
        'izz="0.06"/></inertial></link>'
    ]
    friction = '<dynamics damping="0.3" friction="0.5"/>' if drive else ""
    for side, sign in (("left", 1), ("right", -1)):
        for name, parent, origin, axis, mass in (
            ("hip", "trunk", f"0 {0.1 * sign} 0", "1 0 0", 2.0),
            ("knee", f"{side}_thigh", "0 0 -0.3", "0 1 0", 1.0),
        ):
            child = f"{side}_{'thigh' if name == 'hip' else 'shank'}"
            parts.append(
                f'<link name="{child}"><inertial><origin xyz="0.01 {0.02 * sign} -0.12"/>'
                f'<mass value="{mass}"/><inertia ixx="{0.012 * mass}" ixy="0" ixz="0" '
                f'iyy="{0.01 * mass}" iyz="0" izz="{0.004 * mass}"/></inertial></link>'
                f'<joint name="{side}_{name}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{child}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
                f'<limit lower="-1.5" upper="1.5" velocity="0" effort="0"/>{friction}</joint>'
            )
    return "".join([*parts, "</robot>"])


def motion_csv(seconds: float = 20.0, seed: int = 0, rate: float = 100.0) -> str:
    """Return a CSV file of a random smooth motion of the robot of `biped_urdf`."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate

    def smooth(count: int, amplitude: float) -> np.ndarray:
        frequency, phase = rng.uniform(0.1, 1.5, (6, count)), rng.uniform(0.0, 6.3, (6, count))
        size = amplitude / 2.5 * rng.normal(size=(6, count))
        waves = np.sin(2.0 * np.pi * frequency * t[:, None, None] + phase)
        return np.sum(size * waves, axis=1)

    rotations = Rotation.from_rotvec(smooth(3, 0.5)).as_quat()
    table = np.column_stack([t, smooth(3, 0.1), rotations, smooth(4, 0.5)])
    names = ["t", *POSE, *(f"q.{joint}" for joint in BIPED_JOINTS)]
    lines = [",".join(names), *(",".join(f"{x:.12g}" for x in row) for row in table)]
    return "\n".join(lines) + "\n"


def generalised_forces(robot: FloatingRobot, motion: FloatingMotion) -> FloatArray:
    """Compute the inverse dynamics of the nominal rigid bodies: the total wrench on the base and
    the joint torques. Shape (N, 6 + n)."""
    data = robot.model.createData()
    q = robot.configurations(motion)
    v, a = (robot.model_velocities(x) for x in (motion.velocity, motion.acceleration))
    out = np.empty((len(motion), 6 + robot.n))
    for t in range(len(motion)):
        tau = pin.rnea(robot.model, data, q[t], v[t], a[t])
        out[t, :6], out[t, 6:] = tau[:6], robot.joint_robot.spread.T @ tau[6:]
    return out
