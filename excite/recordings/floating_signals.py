"""Signals of a floating base in a recording: pose, contact wrenches and inertial measurement unit.

Columns:

- `base.x`, `base.y`, `base.z` [m] and `base.qx`, `base.qy`, `base.qz`, `base.qw`: pose of the base
  link in the world, unit quaternion;
- `wrench.<frame>.fx` … `.mz` [N, N m]: wrench of a contact on the robot, in the axes of the frame
  at its origin; `wrench.world.*`: in the axes of the world, about the world's origin. Columns
  `fx` … `mz` alone are those of `wrench.world`;
- `imu.wx`, `imu.wy`, `imu.wz` [rad/s] and `imu.ax`, `imu.ay`, `imu.az` [m/s²]: angular velocity and
  specific force (acceleration minus gravity: +9.81 upwards at standstill) at the origin of the base
  link in its axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from .block import Block
from .remark import shown_time

POSE = tuple(f"base.{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw"))
"""Columns of the pose of the base."""
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")
"""Components of a wrench."""
WORLD = "world"
"""Name that stands for the world in the columns of a wrench."""
GYROSCOPE = ("imu.wx", "imu.wy", "imu.wz")
"""Columns of the angular velocity."""
ACCELEROMETER = ("imu.ax", "imu.ay", "imu.az")
"""Columns of the specific force."""
MAX_NORM_ERROR = 0.02
"""Deviation of a quaternion's norm from 1 that is rounding or filtering [1]; more is no unit
quaternion, as where its columns are in another order or missing."""


def signal_columns(source: str, header: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Find the columns of a floating base in a header.

    Args:
        source: Name of the file, for messages.
        header: Names of all columns.

    Returns:
        Names of the columns of each signal: "base", "wrench.<frame>", "gyroscope", "accelerometer".

    Raises:
        UnusableInput: The pose is missing, or a signal lacks a column.
    """
    _require_all(source, header, POSE, "record the pose of the base")
    out = {"base": POSE}
    frames = dict.fromkeys(
        name[len("wrench.") : -3]
        for name in header
        if name.startswith("wrench.") and name[-3:] in {f".{c}" for c in COMPONENTS}
    )
    for frame in frames:
        columns = tuple(f"wrench.{frame}.{component}" for component in COMPONENTS)
        _require_all(source, header, columns, "record all six components")
        out[f"wrench.{frame}"] = columns
    if not frames and set(COMPONENTS) <= set(header):
        out[f"wrench.{WORLD}"] = COMPONENTS
    for signal, columns in (("gyroscope", GYROSCOPE), ("accelerometer", ACCELEROMETER)):
        if set(columns) & set(header):
            _require_all(source, header, columns, "record all three axes")
            out[signal] = columns
    return out


def _require_all(
    source: str, header: Sequence[str], columns: Sequence[str], instruction: str
) -> None:
    """Raise UnusableInput that names the first missing column."""
    for column in columns:
        if column not in header:
            near = get_close_matches(column, header, 3, 0.7)
            similar = f" (similar: {', '.join(near)})" if near else ""
            raise UnusableInput(
                f"{source}: has no column '{column}'{similar}; {instruction}, or name its column "
                f"with --columns {column}=COLUMN"
            )


def with_continuous_quaternions(source: str, block: Block) -> Block:
    """Return rows whose quaternions have unit length and do not change sign between rows.

    Args:
        source: Name of the recording, for messages.
        block: Rows in the order of time.

    Raises:
        UnusableInput: The columns hold no unit quaternion.
    """
    if "base" not in block.values:
        return block
    pose = block.values["base"].copy()
    quaternion = pose[:, 3:]
    known = np.flatnonzero(np.isfinite(quaternion).all(axis=1))
    norm = np.linalg.norm(quaternion[known], axis=1)
    wrong = np.abs(norm - 1.0) > MAX_NORM_ERROR
    if wrong.any():
        row = known[np.argmax(wrong)]
        raise UnusableInput(
            f"{source}: base.qx … base.qw have the norm {norm[np.argmax(wrong)]:.3g} at "
            f"t = {shown_time(block.t[row])} s; give a unit quaternion, the real part in base.qw"
        )
    unit = quaternion[known] / norm[:, None]
    flips = np.einsum("ti,ti->t", unit[1:], unit[:-1]) < 0.0
    unit[1:] *= np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)[:, None]
    quaternion[known] = unit
    return Block(block.t, {**block.values, "base": pose}, block.remarks)


def unit_quaternions(pose: FloatArray) -> FloatArray:
    """Return poses whose quaternions have unit length, as after an interpolation. Shape (N, 7)."""
    out = pose.copy()
    out[:, 3:] /= np.linalg.norm(out[:, 3:], axis=1)[:, None]
    return out
