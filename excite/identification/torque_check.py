"""Check measured torque against the robot before it is fitted: columns without a measurement, wrong units and turned signs.

A fit absorbs all three in part: torque of a turned sign gives masses near 0 and no error message. Each finding is a remark of the
recording and a warning that states the figure it rests on.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from ..errors import ExciteWarning, UnusableInput
from ..recordings import Kind, Recording, Remark
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..robot.samples import Samples

Array = np.ndarray
ROWS = 1000
"""Rows, spread evenly over the longest stretch without a gap, at which torque is compared with the nominal model."""
BEYOND = 3.0
"""Largest |torque| over the torque limit that is not remarked. Recordings of ten real machines reach 0.9."""
TURNED = -0.75
"""Correlation of measured and nominal torque below which a sign is doubted. Joint by joint, real machines reach −0.72 (joint 7 of a
KUKA LWR4+, of which the nominal torque is small) and recordings with turned signs −0.86 to −0.99 where gravity or inertia prevails."""
SUBSTANTIAL = 0.05
"""Least standard deviation of the nominal torque, over that of the measured one, for a sign to be judged by."""


def checked(recording: Recording, robot: Robot, limits: Limits) -> Recording:
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
            f"{recording.source}: the torque of every joint is {value} in all {len(torque)} rows; record torque or current"
        )
    found = [
        *_constant(recording, torque, constant),
        *_beyond(recording, torque, limits),
        *_turned(recording, robot, constant),
    ]
    for remark in found:
        warnings.warn(f"{recording.source}: {remark.text}", ExciteWarning, stacklevel=2)
    return dataclasses.replace(recording, remarks=(*recording.remarks, *found))


def _constant(recording: Recording, torque: Array, constant: Array) -> Iterator[Remark]:
    for i in np.flatnonzero(constant).tolist():
        joint = recording.joints[i]
        text = f"joint '{joint}': torque is {torque[0, i]:g} in all {len(torque)} rows; was it measured?"
        yield Remark(Kind.FROZEN, text, joint)


def _beyond(recording: Recording, torque: Array, limits: Limits) -> Iterator[Remark]:
    ratio = np.abs(torque) / limits.torque
    for i in np.flatnonzero(ratio.max(axis=0) > BEYOND).tolist():
        joint, row = recording.joints[i], int(np.argmax(ratio[:, i]))
        text = (
            f"joint '{joint}': torque reaches {torque[row, i]:.4g}, {ratio[row, i]:.4g} times its limit {limits.torque[i]:.4g}; "
            "is its unit or drive_gain right?"
        )
        yield Remark(Kind.UNIT, text, joint, float(recording.t[row]), float(recording.t[row]))


def _turned(recording: Recording, robot: Robot, constant: Array) -> Iterator[Remark]:
    stretch = max(recording.segments(), key=len, default=None)
    if stretch is None:
        return
    rows = np.unique(np.linspace(0, len(stretch) - 1, ROWS).astype(int))
    measured, nominal = stretch.torque[rows], _nominal(robot, stretch.samples().rows(rows))
    measured, nominal = measured - measured.mean(axis=0), nominal - nominal.mean(axis=0)
    sizes = np.sqrt(np.mean(measured**2, axis=0)), np.sqrt(np.mean(nominal**2, axis=0))
    judged = ~constant & (sizes[1] > SUBSTANTIAL * sizes[0]) & (sizes[0] > 0.0)
    for i in np.flatnonzero(judged).tolist():
        correlation = float(np.mean(measured[:, i] * nominal[:, i]) / (sizes[0][i] * sizes[1][i]))
        if correlation < TURNED:
            joint = recording.joints[i]
            text = f"joint '{joint}': measured torque and that of the nominal model are correlated by {correlation:.2f}; is the sign turned?"
            yield Remark(Kind.INCONSISTENT, text, joint)


def _nominal(robot: Robot, motion: Samples) -> Array:
    """Torque of the nominal rigid bodies. Shape (N, n) [N m]."""
    data = robot.model.createData()
    states = zip(
        robot.expand(motion.q), motion.dq @ robot.spread.T, motion.ddq @ robot.spread.T, strict=True
    )
    return np.array([robot.spread.T @ pin.rnea(robot.model, data, *state) for state in states])
