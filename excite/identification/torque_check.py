"""Checks of measured torque before it is fitted: constant columns, wrong units, and whether it is
the torque that the nominal model expects (`nominal_comparison`).

A fit absorbs such faults in part: torque with an inverted sign gives masses near 0 and no error
message. Each finding is a doubt of the recording and a warning that states the figure it rests
on. Clipped torque is a warning only: that of a drive at its limit is as it was measured. So are
torque of one repeated value, as a drive may have a dead band, torque of one sign, as a load may be
held throughout, torque beyond a limit that cannot hold the robot, and velocities that are not the
slope of the positions, as they are not fitted.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator

import numpy as np

from .._types import BoolArray, FloatArray
from ..errors import ExciteWarning, UnusableInput
from ..recordings import Recording, Remark, RemarkKind
from ..robot.limits import URDF, Limits
from ..robot.robot import Robot
from ..robot.samples import MIN_TRAVEL, Samples
from . import nominal_comparison
from .exchanged_torque import find_exchange

WARNED_KINDS = (RemarkKind.CLIPPED, RemarkKind.REPEATED_TORQUE, RemarkKind.INCONSISTENT)
"""Remarks on the columns of a recording that are given as warnings."""
REST_STEPS = 2.0
"""Range of a position at rest, over the step of its encoder, at most [1]."""
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
        earlier doubts, clipped torque, torque of one repeated value and inconsistent velocities.

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
        *_magnitudes(recording, torque),
        *_excessive_torque(recording, torque, limits, robot),
        *(() if planned else nominal_comparison.compare_with_nominal(recording, robot)),
    ]
    if has_payload:
        remarks = [r for r in remarks if r.doubt or r.kind is not RemarkKind.TORQUE_SCALE]
    if not planned and not any(remark.doubt for remark in remarks):
        remarks += _exchanged_torque(recording, robot)
    warned = [remark for remark in recording.remarks if remark.kind in WARNED_KINDS]
    for remark in (*recording.doubts, *warned, *remarks):
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
    """Yield a remark for each joint whose torque is constant.

    It is a doubt where the joint moves: friction holds a joint at rest, with or without a torque.
    """
    moves = np.ptp(recording.q, axis=0) > _range_at_rest(recording)
    for i in np.flatnonzero(constant).tolist():
        joint = recording.joints[i]
        text = f"joint '{joint}': torque is {torque[0, i]:g} in all {len(torque)} rows; "
        text += "check that it was measured" if moves[i] else "the joint is at rest"
        yield Remark(RemarkKind.FROZEN, text, joint, doubt=bool(moves[i]))


def _magnitudes(recording: Recording, torque: FloatArray) -> Iterator[Remark]:
    """Yield a remark if no joint that moves in both directions has torque of both signs.

    Friction has the sign of the motion: such torque is that of a load that is held throughout, or
    the magnitude of a current. The former stays away from zero, the latter comes as near to it as
    it changes from one row to the next, at most joints: some may carry a load as well.
    """
    q, least = recording.q, _range_at_rest(recording)
    rises = (q - np.minimum.accumulate(q)).max(axis=0) > least
    falls = (np.maximum.accumulate(q) - q).max(axis=0) > least
    both_ways = np.flatnonzero(rises & falls & (np.ptp(torque, axis=0) > 0.0)).tolist()
    values = torque[:, both_ways]
    if ((values > 0.0).any(axis=0) & (values < 0.0).any(axis=0)).any():
        return
    if 2 * sum(map(_comes_near_zero, values.T)) <= len(both_ways):
        return
    joints = ", ".join(f"'{recording.joints[i]}'" for i in both_ways)
    text = (
        f"{'joint' if len(both_ways) == 1 else 'joints'} {joints}: torque has one sign in both "
        "directions of motion, as that of a load that is held throughout; check that it is not "
        "the magnitude of a current, and record its sign"
    )
    yield Remark(RemarkKind.MAGNITUDE, text, recording.joints[both_ways[0]])


def _comes_near_zero(torque: FloatArray) -> bool:
    """Tell whether torque of one sign, shape (N,), may have crossed zero between two rows."""
    least = int(np.argmin(np.abs(torque)))
    changes = np.abs(np.diff(torque[max(least - 1, 0) : least + 2]))
    return bool(np.abs(torque[least]) <= changes.max())


def _range_at_rest(recording: Recording) -> FloatArray:
    """Return the range of positions up to which a joint is at rest, shape (n,) [rad or m]."""
    step = np.sqrt(12.0) * recording.quantization_noise
    return np.maximum(REST_STEPS * step, MIN_TRAVEL)


def _excessive_torque(
    recording: Recording, torque: FloatArray, limits: Limits, robot: Robot
) -> Iterator[Remark]:
    """Yield a remark for each joint whose torque exceeds its limit by far.

    Where the limit is a placeholder, a remark for all joints with that limit says so instead.
    """
    ratio = np.abs(torque) / limits.torque
    excessive = ratio.max(axis=0) > MAX_TORQUE_RATIO
    if not excessive.any():
        return
    gravity = _largest_gravity(recording, robot)
    slides = np.array([entry.kind == "prismatic" for entry in robot.entries])
    largest = np.array([gravity[slides == is_slide].max() for is_slide in slides.tolist()])
    plausible = np.abs(torque).max(axis=0) < nominal_comparison.PLAUSIBLE_SLOPE[1] * largest
    too_small = limits.torque[MAX_TORQUE_RATIO * limits.torque < gravity]
    excused = excessive & plausible & np.isin(limits.torque, too_small)
    for limit in np.unique(limits.torque[excused]).tolist():
        yield _placeholder_limit(robot, limits, excused & (limits.torque == limit), gravity)
    for i in np.flatnonzero(excessive & ~excused).tolist():
        joint, row = recording.joints[i], int(np.argmax(ratio[:, i]))
        text = (
            f"joint '{joint}': torque reaches {torque[row, i]:.4g}, {ratio[row, i]:.4g} times its "
            f"limit {limits.torque[i]:.4g}; check its unit or drive_gain"
        )
        time = float(recording.t[row])
        yield Remark(RemarkKind.UNIT, text, joint, time, time, doubt=True)


def _largest_gravity(recording: Recording, robot: Robot) -> FloatArray:
    """Return the largest nominal torque of gravity in the recorded poses. Shape (n,) [N m or N]."""
    count = min(len(recording), nominal_comparison.COMPARED_ROWS)
    q = recording.q[np.linspace(0, len(recording) - 1, count).astype(int)]
    still = np.zeros_like(q)
    gravity, _ = nominal_comparison.nominal_torque(robot, Samples(q, still, still))
    return np.asarray(np.abs(gravity).max(axis=0))


def _placeholder_limit(
    robot: Robot, limits: Limits, excused: BoolArray, gravity: FloatArray
) -> Remark:
    """Remark a torque limit that is less than gravity needs at a joint, and that others share.

    The joints `excused` (n,) have this limit and exceed it; `gravity` (n,) is the largest torque.
    """
    joints = np.flatnonzero(excused).tolist()
    names = ", ".join(f"'{robot.joints[i]}'" for i in joints)
    same = limits.torque == limits.torque[joints[0]]
    heaviest = int(np.argmax(np.where(same, gravity, 0.0)))
    source = limits.sources["torque"][heaviest]
    text = (
        f"{'joint' if len(joints) == 1 else 'joints'} {names}: the torque limit of "
        f"{limits.torque[heaviest]:.4g} cannot hold the robot, gravity needs "
        f"{gravity[heaviest]:.3g} {robot.entries[heaviest].unit('N m')} at "
        f"'{robot.joints[heaviest]}'; correct it in "
        f"{robot.source if source == URDF else source}, or give --limits FILE"
    )
    return Remark(RemarkKind.TORQUE_LIMIT, text, robot.joints[joints[0]])
