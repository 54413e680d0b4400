"""Checks of measured torque before it is fitted: constant columns, wrong units, inverted signs.

A fit partly absorbs all three: torque with an inverted sign gives masses near 0 and no error
message. Each finding is a remark of the recording and a warning that states the figure it rests
on.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from .._types import BoolArray, FloatArray
from ..errors import ExciteWarning, UnusableInput
from ..recordings import Recording, Remark, RemarkKind
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..robot.samples import Samples

COMPARED_ROWS = 1000
"""Number of rows, spread evenly over the longest stretch without a gap, at which torque is compared
with the nominal model."""
MAX_TORQUE_RATIO = 3.0
"""Largest |torque| over the torque limit without a remark. Recordings of ten real machines reach
0.9."""
INVERTED_CORRELATION = -0.75
"""Correlation of measured and nominal torque below which a sign is doubted. Of single joints, real
machines reach −0.72 (joint 7 of a KUKA LWR4+, whose nominal torque is small) and recordings with
inverted signs −0.86 to −0.99 where gravity or inertia prevails."""
MIN_NOMINAL_RATIO = 0.05
"""Standard deviation of the nominal torque over that of the measured one below which the sign is
not checked."""


def check_torque(recording: Recording, robot: Robot, limits: Limits) -> Recording:
    """Check a recording's torque.

    Args:
        recording: The recording, with torque or current of every joint.
        robot: The robot with its nominal parameters.
        limits: Its limits.

    Returns:
        The recording with a remark for each finding; each is also given as a warning.

    Raises:
        UnusableInput: The torque of every joint is constant, or a joint has none.
    """
    torque = recording.torque
    constant = np.ptp(torque, axis=0) == 0.0
    if constant.all():
        value = "0" if not torque.any() else "constant"
        raise UnusableInput(
            f"{recording.source}: the torque of every joint is {value} in all {len(torque)} rows; "
            "record torque or current"
        )
    remarks = [
        *_constant_torque(recording, torque, constant),
        *_excessive_torque(recording, torque, limits),
        *_inverted_torque(recording, robot, constant),
    ]
    for remark in remarks:
        warnings.warn(f"{recording.source}: {remark.text}", ExciteWarning, stacklevel=2)
    return dataclasses.replace(recording, remarks=(*recording.remarks, *remarks))


def _constant_torque(
    recording: Recording, torque: FloatArray, constant: BoolArray
) -> Iterator[Remark]:
    """Yield a remark for each joint whose torque is constant."""
    for i in np.flatnonzero(constant).tolist():
        joint = recording.joints[i]
        text = (
            f"joint '{joint}': torque is {torque[0, i]:g} in all {len(torque)} rows; "
            "check that it was measured"
        )
        yield Remark(RemarkKind.FROZEN, text, joint)


def _excessive_torque(recording: Recording, torque: FloatArray, limits: Limits) -> Iterator[Remark]:
    """Yield a remark for each joint whose torque exceeds its limit by far."""
    ratio = np.abs(torque) / limits.torque
    for i in np.flatnonzero(ratio.max(axis=0) > MAX_TORQUE_RATIO).tolist():
        joint, row = recording.joints[i], int(np.argmax(ratio[:, i]))
        text = (
            f"joint '{joint}': torque reaches {torque[row, i]:.4g}, {ratio[row, i]:.4g} times its "
            f"limit {limits.torque[i]:.4g}; check its unit or drive_gain"
        )
        yield Remark(RemarkKind.UNIT, text, joint, float(recording.t[row]), float(recording.t[row]))


def _inverted_torque(recording: Recording, robot: Robot, constant: BoolArray) -> Iterator[Remark]:
    """Yield a remark for each joint whose torque is anticorrelated with the nominal model's."""
    stretch = max(recording.segments(), key=len, default=None)
    if stretch is None:
        return
    rows = np.unique(np.linspace(0, len(stretch) - 1, COMPARED_ROWS).astype(int))
    measured, nominal = stretch.torque[rows], _nominal_torque(robot, stretch.samples().rows(rows))
    measured, nominal = measured - measured.mean(axis=0), nominal - nominal.mean(axis=0)
    sizes = np.sqrt(np.mean(measured**2, axis=0)), np.sqrt(np.mean(nominal**2, axis=0))
    checked = ~constant & (sizes[1] > MIN_NOMINAL_RATIO * sizes[0]) & (sizes[0] > 0.0)
    for i in np.flatnonzero(checked).tolist():
        correlation = float(np.mean(measured[:, i] * nominal[:, i]) / (sizes[0][i] * sizes[1][i]))
        if correlation < INVERTED_CORRELATION:
            joint = recording.joints[i]
            text = (
                f"joint '{joint}': measured torque and torque of the nominal model have a "
                f"correlation of {correlation:.2f}; check the sign"
            )
            yield Remark(RemarkKind.INCONSISTENT, text, joint)


def _nominal_torque(robot: Robot, motion: Samples) -> FloatArray:
    """Torque of the nominal rigid bodies. Shape (N, n) [N m]."""
    data = robot.model.createData()
    states = zip(
        robot.expand(motion.q), motion.dq @ robot.spread.T, motion.ddq @ robot.spread.T, strict=True
    )
    return np.array([robot.spread.T @ pin.rnea(robot.model, data, *state) for state in states])
