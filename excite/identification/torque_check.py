"""Checks of measured torque before it is fitted: constant columns, wrong units, and whether it is
the torque that the nominal model expects (`nominal_comparison`).

A fit absorbs such faults in part: torque with an inverted sign gives masses near 0 and no error
message. Each finding is a doubt of the recording and a warning that states the figure it rests
on. Clipped torque is a warning only: that of a drive at its limit is as it was measured. So is
torque of one repeated value: a drive may have a dead band.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator

import numpy as np

from .._types import BoolArray, FloatArray
from ..errors import ExciteWarning, UnusableInput
from ..recordings import Recording, Remark, RemarkKind
from ..robot.limits import Limits
from ..robot.robot import Robot
from . import nominal_comparison
from .exchanged_torque import find_exchange

WARNED = (RemarkKind.CLIPPED, RemarkKind.REPEATED_TORQUE)
"""Remarks of `signal_checks` that are given as warnings."""
MAX_TORQUE_RATIO = 3.0
"""Largest |torque| over the torque limit without a remark. Recordings of ten real machines reach
0.9."""


def check_torque(
    recording: Recording, robot: Robot, limits: Limits, *, has_payload: bool = False
) -> Recording:
    """Check a recording's torque.

    Args:
        recording: The recording, with torque or current of every joint.
        robot: The robot with its nominal parameters.
        limits: Its limits.
        has_payload: True if the robot carries a payload that its description lacks: then torque of
            another scale is no remark.

    Returns:
        The recording with a remark for each finding. Each is also given as a warning, as are
        earlier doubts, clipped torque and torque of one repeated value.

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
    planned = [remark for remark in recording.doubts if remark.kind is RemarkKind.PLANNED]
    remarks = [
        *_constant_torque(recording, torque, constant),
        *_excessive_torque(recording, torque, limits),
        *(() if planned else nominal_comparison.compare_with_nominal(recording, robot)),
    ]
    if has_payload:
        remarks = [r for r in remarks if r.doubt or r.kind is not RemarkKind.TORQUE_SCALE]
    if not planned and not any(remark.doubt for remark in remarks):
        remarks += _exchanged_torque(recording, robot)
    measured = [remark for remark in recording.remarks if remark.kind in WARNED]
    for remark in (*recording.doubts, *measured, *remarks):
        warnings.warn(f"{recording.source}: {remark.text}", ExciteWarning, stacklevel=2)
    return dataclasses.replace(recording, remarks=(*recording.remarks, *remarks))


def _exchanged_torque(recording: Recording, robot: Robot) -> Iterator[Remark]:
    """Yield a remark for two joints whose torques are exchanged."""
    rows = nominal_comparison.compared_rows(recording)
    if rows is None:
        return
    exchange = find_exchange(robot, rows.motion, rows.torque, rows.independent)
    if exchange is not None:
        a, b = recording.joints[exchange.first], recording.joints[exchange.second]
        before, after = (
            " and ".join(f"{100.0 * max(1.0 - share, 0.0):.0f}" for share in shares)
            for shares in (exchange.before, exchange.after)
        )
        text = (
            f"joints '{a}' and '{b}': a model of all links predicts {before} % of their torque, "
            f"and {after} % if their torques are exchanged; check the names of the columns"
        )
        yield Remark(RemarkKind.EXCHANGED, text, a, doubt=True)


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
        yield Remark(RemarkKind.FROZEN, text, joint, doubt=True)


def _excessive_torque(recording: Recording, torque: FloatArray, limits: Limits) -> Iterator[Remark]:
    """Yield a remark for each joint whose torque exceeds its limit by far."""
    ratio = np.abs(torque) / limits.torque
    for i in np.flatnonzero(ratio.max(axis=0) > MAX_TORQUE_RATIO).tolist():
        joint, row = recording.joints[i], int(np.argmax(ratio[:, i]))
        text = (
            f"joint '{joint}': torque reaches {torque[row, i]:.4g}, {ratio[row, i]:.4g} times its "
            f"limit {limits.torque[i]:.4g}; check its unit or drive_gain"
        )
        time = float(recording.t[row])
        yield Remark(RemarkKind.UNIT, text, joint, time, time, doubt=True)
