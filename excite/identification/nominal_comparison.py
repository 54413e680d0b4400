"""Compare measured torque with the nominal model before anything is fitted.

The nominal inertial parameters are 5-30 % off, or the payload is missing from them, but they
determine the sign and the size of a torque. Joint by joint, friction and offset are removed from
the measured and from the nominal torque by linear regression, and then

    τ_measured = s · τ_nominal + e        and        τ_measured = g · τ_gravity + h · τ_motion + e.

A slope s near −1 is an inverted sign, one near 1000 a torque in N mm, one near a gear ratio a
torque on the motor's side; g near 0 with h near 1 is torque without gravity. A doubt requires a
high correlation, so a poor nominal model raises none.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from .._types import BoolArray, FloatArray
from ..recordings import Recording, Remark, RemarkKind
from ..robot.dynamics import inverse_dynamics
from ..robot.robot import Robot
from ..robot.samples import Samples
from . import friction_sign
from .torque_columns import OWN_COLUMNS, friction_columns, link_columns

COMPARED_ROWS = 600
"""Number of compared rows, spread evenly over the longest stretch without a gap."""
MOTION_CUTOFF_HZ = 10.0
"""Cutoff frequency of the positions from which the nominal torque is computed [Hz]: the
accelerations of an arm that cause its inertial torque lie below."""
EDGE_PERIODS = 5.0
"""Periods of the cutoff frequency at each end whose accelerations the filter makes wrong [1]."""
MAX_CUTOFF_SHARE = 0.15
"""Cutoff over the sampling rate of slow recordings [1]: second differences of positions that jitter
against their stamps are noise above that."""
MIN_CORRELATION = 0.85
"""Correlation with the nominal torque from which the sign and the scale of a joint are judged [1].
On ten real machines the most negative is −0.78 (joint 7 of a KUKA LWR4+, whose torque comes from
cables), and the sign is wrong at none of them; inverted joints of simulated arms reach −0.96 to
−1.00 where gravity or inertia prevails."""
MAX_CORRELATION_OF_INVERTED = 0.3
"""Largest correlation of a joint whose torque may be inverted as well, where that of several joints
is [1]: joints whose torque is mostly noise have either sign."""
PLAUSIBLE_SLOPE = (0.125, 30.0)
"""Smallest and largest plausible ratio of measured to nominal torque [1]. On the same machines it
is 0.42 to 16 at this correlation; 16 is a wrist whose payload of 150 kg is not in the model."""
MAX_EXPECTED_RATIO = 3.0
"""Measured over nominal torque, or its inverse, from which the difference is remarked [1]. With
calibrated torque and all bodies in the model the ratio is 0.41 to 1.3 on the same machines."""
MAX_WEIGHT_RATIO = 10.0
"""Ratio of a nearly constant torque of gravity to the RMS of measured torque from which the
difference is remarked [1]: an order of magnitude. On nine real machines it is at most 4."""
SLOPE_AGREEMENT = 4.0
"""Largest ratio of the largest to the smallest slope at which all joints share one unit [1]."""
NOMINAL_ERROR = 1.3
"""Factor within which a scale of 1000 or 1/1000 counts as that of a prefix such as mN m [1]:
nominal inertial parameters are up to 30 % off. A scale of 600 is that of counts, or of any other
unit."""
MIN_GRAVITY_RATIO = 0.3
"""Smallest standard deviation of the nominal gravity torque over that of the measured torque at
which gravity is judged at a joint [1]."""
MAX_GRAVITY_SLOPE = 0.3
"""Largest measured share of the nominal gravity torque at which gravity counts as missing [1]:
links are rarely lighter than a third of the URDF's mass."""
MIN_EXPLAINED = 0.8
"""Smallest share of a joint's torque that gravity and motion explain where they are judged [1]."""
MIN_GRAVITY_JOINTS = 2
"""Smallest number of joints at which gravity is missing: at a single joint, a spring or a
counterbalance compensates it (axis 2 of a KUKA KR300)."""
MAX_GRAVITY_ANGLE = 35.0
"""Largest angle between stated and estimated gravity that is not doubted [°]: wrong masses tilt the
estimate by up to 20° on the machines above; a mounting on a wall or ceiling, or a wrong axis, gives
90° or 180°."""
MIN_UNEXPLAINED = 0.3
"""Smallest mean unexplained share of the torque of two joints at which their exchange is considered
[1]."""
MAX_UNEXPLAINED_RATIO = 0.25
"""Largest unexplained share with two joints exchanged over that as read at which their names are
doubted [1]: the right exchange leaves a tenth on simulated arms."""
MAX_EXPLAINED_AS_READ = 0.5
"""Largest explained share of the torque of a joint at which the sign or the zero of a position is
doubted because of it [1]."""
MIN_EXPLAINED_AS_CHANGED = 0.85
"""Smallest explained share of that joint with the other sign or zero [1]: 0.92 to 0.99 on simulated
arms, 0.51 at most on ten real machines, whose signs and zeros are right."""
MAX_SCALE_RATIO = 2.0
"""Measured over nominal torque, or its inverse, up to which a changed position explains a joint: a
wrong zero or sign leaves the scale as it is [1]."""
MIN_EXPLAINED_GAIN = 0.4
"""Smallest sum over the joints of the changes of the explained shares [1]."""
MIN_SWING_SHARE = 0.5
"""Smallest torque on one side of zero, over its RMS, that counts as a swing [1]: not noise about
zero."""
ZERO_OFFSETS_DEG = (90, -90, 180)
"""Offsets between the zero of an encoder and that of the URDF that are considered [°]: conventions
of the zero pose differ by right angles."""
ROUNDING = 1e-9
"""Nominal over measured torque below which the nominal torque is a rounding error [1], as that of
gravity on a vertical axis."""


@dataclass(frozen=True)
class NominalComparison:
    """Measured and nominal torque of a recording, without what the nominal model does not state:
    friction, offset and rotor inertia are removed from both.

    Attributes:
        measured: Measured torque. Shape (N, n) [N m or N].
        gravity: Nominal gravity torque. Shape (N, n) [N m or N].
        motion: Nominal torque of the accelerations. Shape (N, n) [N m or N].
    """

    measured: FloatArray
    gravity: FloatArray
    motion: FloatArray

    @property
    def nominal(self) -> FloatArray:
        """Nominal torque. Shape (N, n) [N m or N]."""
        return self.gravity + self.motion

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Return s and the correlation of each joint, 0 where either torque is constant."""
        x, y = self.nominal, self.measured
        xx, yy, xy = (np.sum(a * b, axis=0) for a, b in ((x, x), (y, y), (x, y)))
        known = (xx > ROUNDING**2 * yy) & (yy > 0.0)
        slope = np.where(known, xy / np.where(known, xx, 1.0), 0.0)
        return slope, np.where(known, xy / np.sqrt(np.where(known, xx * yy, 1.0)), 0.0)

    def gravity_slopes(self) -> tuple[FloatArray, BoolArray]:
        """Return g, and where gravity would show if it is in the torque. Shapes (n,).

        It shows where it is a part of the nominal torque, and g and h explain the measured torque,
        which is not the case of a torque of zero, as that of a joint at rest.
        A torque that is explained better by s · τ_nominal than by h · τ_motion contains gravity,
        whatever its scale.
        """
        n = self.measured.shape[1]
        slope, explained = np.zeros(n), np.zeros(n)
        power = np.sum(self.measured**2, axis=0)
        for j in np.flatnonzero(power > 0.0).tolist():
            columns = np.column_stack([self.gravity[:, j], self.motion[:, j]])
            fitted = np.linalg.lstsq(columns, self.measured[:, j], rcond=None)[0]
            slope[j] = fitted[0]
            residual = self.measured[:, j] - columns @ fitted
            explained[j] = 1.0 - np.sum(residual**2) / power[j]
        strong = np.sum(self.gravity**2, axis=0) > MIN_GRAVITY_RATIO**2 * power
        of_motion = replace(self, gravity=np.zeros_like(self.gravity)).slopes()[1]
        is_scaled = self.slopes()[1] > np.abs(of_motion)
        return slope, strong & (explained > MIN_EXPLAINED) & ~is_scaled


@dataclass(frozen=True)
class ComparedRows:
    """Rows of a recording that are compared with a model.

    Attributes:
        motion: Motion at N rows.
        torque: Measured torque. Shape (N, n) [N m or N].
        independent: Number of rows that the cutoff frequency leaves independent, over N, at most 1.
        inner: Rows whose accelerations the ends of the filter do not reach.
    """

    motion: Samples
    torque: FloatArray
    independent: float
    inner: slice


def compared_rows(recording: Recording) -> ComparedRows | None:
    """Return rows spread over the longest stretch of a recording without a gap.

    Args:
        recording: The recording, with torque or current of every joint.

    Returns:
        The rows; None without such a stretch, or where torque is missing in it.
    """
    stretch = max(recording.segments(), key=len, default=None)
    if stretch is None:
        return None
    cutoff = min(MOTION_CUTOFF_HZ, MAX_CUTOFF_SHARE * stretch.rate)
    rows = np.unique(np.linspace(0, len(stretch) - 1, COMPARED_ROWS).astype(int))
    motion, torque = stretch.samples(cutoff).rows(rows), stretch.torque[rows]
    if not np.isfinite(torque).all():
        return None
    independent = 2.0 * cutoff * len(stretch) / stretch.rate / len(rows)
    edge = min(int(EDGE_PERIODS / cutoff * stretch.rate * len(rows) / len(stretch)), len(rows) // 4)
    return ComparedRows(motion, torque, min(independent, 1.0), slice(edge, len(rows) - edge))


def compare_with_nominal(recording: Recording, robot: Robot) -> list[Remark]:
    """Doubt sign, scale and gravity of a recording's torque, and the names, signs and zeros of its
    joints.

    Args:
        recording: The recording, with torque or current of every joint.
        robot: The robot with its nominal parameters and its gravity.

    Returns:
        Doubts and other remarks, each with the figure that shows it; none where the nominal model
        is too poor.
    """
    rows = compared_rows(recording)
    if rows is None:
        return []
    motion, torque = rows.motion, rows.torque
    gravity, dynamic = nominal_torque(robot, motion)
    comparison = _comparison(torque, motion, gravity, dynamic)
    remarks = [
        *_sign_doubts(recording, robot, rows, comparison),
        *_scale_doubts(recording, robot, comparison),
    ]

    def is_explained() -> bool:
        """Tell whether something other than a load differs, which mimics what follows."""
        return any(r.doubt or r.kind is not RemarkKind.TORQUE_SCALE for r in remarks)

    if not is_explained():
        remarks += _exchanged_joints(recording, robot, torque, motion, comparison)
    if not is_explained() and np.any(robot.model.gravity.linear):
        remarks += _gravity_doubts(recording, robot, torque, motion, comparison)
    if not is_explained():  # another direction of gravity mimics another zero of the second axis
        remarks += _position_doubts(recording, robot, torque, motion, comparison)
    if not is_explained():
        remarked = {remark.joint for remark in remarks}
        remarks += [r for r in _scale_remarks(recording, comparison) if r.joint not in remarked]
        remarks += _weight_remarks(recording, robot, torque, gravity, gravity + dynamic)
    return remarks


def nominal_torque(robot: Robot, motion: Samples) -> tuple[FloatArray, FloatArray]:
    """Compute the torque of gravity and of the accelerations of the nominal bodies.

    Args:
        robot: The robot.
        motion: Motion at N rows.

    Returns:
        Two arrays. Shapes (N, n) [N m or N].
    """
    model, data, q = robot.model, robot.model.createData(), robot.expand(motion.q)
    held = np.array([pin.computeGeneralizedGravity(model, data, row) for row in q])
    gravity = held @ robot.spread
    return gravity, inverse_dynamics(robot, model, motion) - gravity


def _comparison(
    torque: FloatArray, motion: Samples, gravity: FloatArray, dynamic: FloatArray
) -> NominalComparison:
    """Remove friction, offset and rotor inertia of each joint from all torques.

    The nominal model states none of them, and at a wrist the rotor inertia is far larger than that
    of the link, to whose torque it is proportional.
    """
    parts = [np.empty_like(torque) for _ in range(3)]
    for j, (speed, acceleration) in enumerate(zip(motion.dq.T, motion.ddq.T, strict=True)):
        orthogonal = np.linalg.qr(np.column_stack([friction_columns(speed), acceleration]))[0]
        for part, whole in zip(parts, (torque, gravity, dynamic), strict=True):
            part[:, j] = whole[:, j] - orthogonal @ (orthogonal.T @ whole[:, j])
    return NominalComparison(*parts)


def _sign_doubts(
    recording: Recording, robot: Robot, rows: ComparedRows, comparison: NominalComparison
) -> Iterator[Remark]:
    """Yield a doubt for each joint whose torque has the opposite sign.

    Where its friction takes out power the sign is right, and the nominal model is wrong. The
    gravity of a single joint has the opposite sign half a turn away as well.
    """
    slope, correlation = comparison.slopes()
    opposite = np.flatnonzero(correlation < -MIN_CORRELATION).tolist()
    if not opposite:
        return
    motion = rows.motion.rows(rows.inner)
    nominal, links = link_columns(robot, motion)
    is_right = [
        friction_sign.friction_dissipates(
            rows.torque[rows.inner, j],
            motion,
            j,
            nominal[:, j],
            np.abs(slope[j]) * links[:, j],
            rows.independent,
        )
        for j in opposite
    ]
    of_all = (
        len(opposite) > 1 and not any(is_right) and correlation.max() < MAX_CORRELATION_OF_INVERTED
    )
    for j, right in zip(opposite, is_right, strict=True):
        joint = recording.joints[j]
        reason = (
            "its friction takes out power, so that its sign is right, and mass or centre of mass "
            "of the links that it moves are wrong in the robot description"
            if right
            else "its sign is inverted, as probably that of all joints; turn it"
            if of_all
            else "its sign is inverted, turn it, or the zero of its position is half a turn off"
            if robot.n == 1 and robot.entries[j].kind != "prismatic"
            else "its sign is inverted, turn it"
        )
        text = (
            f"joint '{joint}': measured torque is {slope[j]:.3g} times the torque of the nominal "
            f"model, with a correlation of {correlation[j]:.2f}; {reason}"
        )
        yield Remark(RemarkKind.TORQUE_SIGN, text, joint, doubt=not right)


def _scale_doubts(
    recording: Recording, robot: Robot, comparison: NominalComparison
) -> Iterator[Remark]:
    """Yield a doubt for each joint whose torque is of another size than the nominal one.

    At a last joint whose own link is small and symmetric a usual load has 50 times the nominal
    torque. That is no doubt where a joint before it shows a load as well and carries more.
    """
    slope, correlation = comparison.slopes()
    size = np.abs(slope)
    judged = np.abs(correlation) > MIN_CORRELATION
    wrong = judged & ((size < PLAUSIBLE_SLOPE[0]) | (size > PLAUSIBLE_SLOPE[1]))
    if not wrong.any():
        return
    measured, nominal = (np.std(x, axis=0) for x in (comparison.measured, comparison.nominal))
    supports = [set(robot.model.supports[robot.body_of(i)]) for i in range(robot.n)]
    agree = bool(wrong[judged].all() and np.ptp(np.log(size[judged])) < np.log(SLOPE_AGREEMENT))
    for j in np.flatnonzero(wrong).tolist():
        joint = recording.joints[j]
        others = [i for i in range(robot.n) if i != j]
        is_last = not any(robot.body_of(j) in supports[i] for i in others)
        carrying = [
            i
            for i in others
            if robot.body_of(i) in supports[j]
            and robot.entries[i].kind == robot.entries[j].kind
            and judged[i]
            and not wrong[i]
        ]
        is_less = measured[j] < nominal[carrying].max(initial=0.0)
        is_shown = slope[carrying].max(initial=0.0) > NOMINAL_ERROR
        may_be_load = is_last and slope[j] > 1.0 and bool(is_less and is_shown)
        reason = (
            "a load is missing there in the robot description, or its unit is wrong"
            if may_be_load
            else _likely_unit(float(size[j]), recording, joint, agree)
        )
        text = (
            f"joint '{joint}': measured torque is {slope[j]:.3g} times the torque of the nominal "
            f"model, with a correlation of {correlation[j]:.2f}; {reason}"
        )
        yield Remark(RemarkKind.TORQUE_SCALE, text, joint, doubt=not may_be_load)


def _scale_remarks(recording: Recording, comparison: NominalComparison) -> Iterator[Remark]:
    """Yield a remark for each joint whose torque and nominal bodies differ in scale.

    Torque alone cannot tell a wrong torque constant from wrong masses, so that this is no doubt.
    """
    slope, correlation = comparison.slopes()
    differs = (correlation > MIN_CORRELATION) & (
        np.abs(np.log(np.maximum(slope, ROUNDING))) > np.log(MAX_EXPECTED_RATIO)
    )
    for j in np.flatnonzero(differs).tolist():
        joint = recording.joints[j]
        is_current = not recording.has("tau", joint)
        source = "drive_gain" if is_current else "scale of the torque"
        bodies = "a load is missing there" if slope[j] > 1.0 else "the links there are too heavy"
        text = (
            f"joint '{joint}': measured torque is {slope[j]:.3g} times the torque of the nominal "
            f"model, with a correlation of {correlation[j]:.2f}, and identified masses follow it; "
            f"check the {source}, unless {bodies} in the robot description"
        )
        yield Remark(RemarkKind.TORQUE_SCALE, text, joint)


def _weight_remarks(
    recording: Recording,
    robot: Robot,
    torque: FloatArray,
    gravity: FloatArray,
    nominal: FloatArray,
) -> Iterator[Remark]:
    """Yield a remark for each joint whose torque is far less than a nearly constant weight.

    Such a weight has no slope, as that of a vertical slide, so that an offset of any size fits it.
    Larger torque is not remarked: it may be friction, which differs between the directions.
    """
    weight, size = np.abs(gravity.mean(axis=0)), np.sqrt(np.mean(torque**2, axis=0))
    is_constant = (weight > nominal.std(axis=0)) & (weight > ROUNDING * size) & (size > 0.0)
    for j in np.flatnonzero(is_constant & (MAX_WEIGHT_RATIO * size < weight)).tolist():
        joint, entry = recording.joints[j], robot.entries[j]
        subject = "force" if entry.kind == "prismatic" else "torque"
        unit = entry.unit("N m")
        remedy = (
            f"is it in another unit (convert it, or name it i.{joint} and state drive_gain)"
            if recording.has("tau", joint)
            else "is the drive_gain wrong"
        )
        text = (
            f"joint '{joint}': measured {subject} is {size[j]:.3g} {unit} (RMS), but the nominal "
            f"weight needs {weight[j]:.3g} {unit}, and identified mass and offset follow it; "
            f"{remedy}, or does a counterbalance, a brake or a self-locking gear carry the weight?"
        )
        yield Remark(RemarkKind.WEIGHT, text, joint)


def _likely_unit(size: float, recording: Recording, joint: str, agree: bool) -> str:
    """Likely reason for a wrong scale, with the remedy."""
    is_current = not recording.has("tau", joint)
    power = round(np.log10(size) / 3.0)
    if power and abs(np.log10(size) - 3.0 * power) < np.log10(NOMINAL_ERROR):
        prefix = {1: "m", 2: "µ", -1: "k"}.get(power)
        if prefix is not None:
            unit = f"{prefix}A, not A" if is_current else f"{prefix}N m, not N m"
            return f"it is off by 1e{3 * power:+d}: is it in {unit}? Convert it"
        return f"it is off by 1e{3 * power:+d}; check its unit"
    if is_current:
        return f"check the drive_gain, which should be {1.0 / size:.3g} times as large"
    if size < 1.0:
        return (
            "is it a motor current or a torque on the motor's side of the gear? Name it "
            f"i.{joint} and state drive_gain, or multiply it by {1.0 / size:.3g}"
        )
    ratio = "" if agree else ", or multiplied by a gear ratio"
    return (
        f"about {float(f'{size:.1g}'):g} times too large: is it in counts or another unit{ratio}? "
        f"Convert it, or name it i.{joint} and state drive_gain"
    )


def _gravity_doubts(
    recording: Recording,
    robot: Robot,
    torque: FloatArray,
    motion: Samples,
    comparison: NominalComparison,
) -> list[Remark]:
    """Doubt that the torque contains gravity, and that gravity points where the robot says."""
    stated = robot.model.gravity.linear
    gravity, judged, unexplained = _measured_gravity(robot, torque, motion, stated)
    size = float(np.linalg.norm(stated))
    cosine = float(gravity @ stated) / max(float(np.linalg.norm(gravity)) * size, 1e-9)
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    ratio = float(np.linalg.norm(gravity)) / size
    is_present = MAX_GRAVITY_SLOPE < ratio < 1.0 / MAX_GRAVITY_SLOPE
    if (
        judged.sum() >= MIN_GRAVITY_JOINTS
        and is_present
        and angle > MAX_GRAVITY_ANGLE
        and unexplained < MAX_UNEXPLAINED_RATIO
    ):
        direction = ", ".join(f"{value:.1f}" for value in gravity)
        text = (
            f"gravity as the torque shows it is ({direction}) m/s² in the base frame, {angle:.0f}° "
            "from the one that is stated; is the base mounted another way? Give --gravity X,Y,Z, "
            "or correct the zero of the joints' positions"
        )
        return [Remark(RemarkKind.GRAVITY, text, doubt=True)]
    slope, judged = comparison.gravity_slopes()
    if judged.sum() < MIN_GRAVITY_JOINTS or (np.abs(slope[judged]) > MAX_GRAVITY_SLOPE).any():
        return []
    shown = ", ".join(
        f"{100.0 * slope[j]:.0f} % at {recording.joints[j]}" for j in np.flatnonzero(judged)
    )
    text = (
        f"gravity is missing from the torque, which holds {shown} of the nominal gravity torque "
        'and the torque of the motion; state "effort": "without gravity" in the .json file, or '
        "record the complete torque"
    )
    return [Remark(RemarkKind.GRAVITY, text, doubt=True)]


def _measured_gravity(
    robot: Robot, torque: FloatArray, motion: Samples, stated: FloatArray
) -> tuple[FloatArray, BoolArray, float]:
    """Estimate the vector of gravity by least squares over the joints that show it.

    Returns:
        Gravity, shape (3,) [m/s²], True for the joints that it is estimated from, shape (n,), and
        its unexplained torque there over that of the stated gravity: a motion that hardly changes
        the pose does not determine the direction.
    """
    model, spread = robot.model.copy(), robot.spread
    data, columns = model.createData(), list[FloatArray]()
    q = robot.expand(motion.q)
    for axis in np.eye(3):
        model.gravity = pin.Motion(axis, np.zeros(3))
        columns.append(np.array([pin.computeGeneralizedGravity(model, data, row) for row in q]))
    dynamic = nominal_torque(robot, motion)[1]
    normal, right, judged = np.zeros((3, 3)), np.zeros(3), np.zeros(robot.n, bool)
    shown: list[tuple[float, FloatArray, FloatArray]] = []
    for j in range(robot.n):
        orthogonal = np.linalg.qr(
            np.column_stack([friction_columns(motion.dq[:, j]), dynamic[:, j]])
        )[0]
        X = np.column_stack([column @ spread[:, j] for column in columns])
        X -= orthogonal @ (orthogonal.T @ X)
        y = torque[:, j] - orthogonal @ (orthogonal.T @ torque[:, j])
        fitted = X @ np.linalg.lstsq(X, y, rcond=None)[0]
        power = float(y @ y)
        judged[j] = power > 0.0 and float(np.sum((y - fitted) ** 2)) < (1.0 - MIN_EXPLAINED) * power
        if judged[j]:
            weight = 1.0 / max(float(np.mean((y - fitted) ** 2)), 1e-300)
            normal += weight * X.T @ X
            right += weight * X.T @ y
            shown.append((weight, X, y))
    # a direction that no joint shows, such as across the plane of a planar arm, keeps 0
    gravity = np.asarray(np.linalg.pinv(normal, rcond=1e-6) @ right)

    def unexplained(direction: FloatArray) -> float:
        """Weighted squares that gravity of this direction leaves, its size free at each joint."""
        total = 0.0
        for weight, X, y in shown:
            x = X @ direction
            explained = max(float(x @ y), 0.0) ** 2 / max(float(x @ x), 1e-300)
            total += weight * (float(y @ y) - explained)
        return total

    return gravity, judged, unexplained(gravity) / max(unexplained(stated), 1e-300)


def _exchanged_joints(
    recording: Recording,
    robot: Robot,
    torque: FloatArray,
    motion: Samples,
    comparison: NominalComparison,
) -> list[Remark]:
    """Doubt the names of two joints whose exchange explains the torque of both."""
    before = _explained(comparison)
    out: list[Remark] = []
    for first, second in itertools.combinations(_varied_joints(comparison), 2):
        unexplained = 1.0 - float(before[[first, second]].mean())
        if unexplained < MIN_UNEXPLAINED:
            continue
        order = list(range(robot.n))
        order[first], order[second] = second, first
        swapped = Samples(motion.q[:, order], motion.dq[:, order], motion.ddq[:, order])
        gravity, dynamic = nominal_torque(robot, swapped)
        cases: Sequence[tuple[str, NominalComparison]] = (
            ("torques", _with_torque(comparison, torque[:, order], motion)),
            ("positions", _comparison(torque, swapped, gravity, dynamic)),
            ("names", _comparison(torque[:, order], swapped, gravity, dynamic)),
        )
        name, after = max(
            ((name, _explained(case)) for name, case in cases),
            key=lambda entry: float(entry[1][[first, second]].min()),
        )
        pair = after[[first, second]]
        if pair.min() > MIN_EXPLAINED and 1.0 - pair.mean() < MAX_UNEXPLAINED_RATIO * unexplained:
            a, b = recording.joints[first], recording.joints[second]
            text = (
                f"joints '{a}' and '{b}': the nominal model explains {100 * before[first]:.0f} and "
                f"{100 * before[second]:.0f} % of their torque, and "
                f"{100 * after[first]:.0f} and {100 * after[second]:.0f} % if their {name} are "
                "exchanged; check the names of the columns"
            )
            out.append(Remark(RemarkKind.EXCHANGED, text, a, doubt=True))
    return out


def _varied_joints(comparison: NominalComparison) -> list[int]:
    """Return the joints whose nominal torque varies by more than friction could explain.

    A torque that swings m times from one side to the other has about m + 1 degrees of freedom.
    Without OWN_COLUMNS, which are removed from it, it still swings as many times: the residual
    torque of a slow motion, which swings about OWN_COLUMNS times, fits any other by chance.
    """
    out = []
    for j, torque in enumerate(comparison.nominal.T):
        sides = torque[np.abs(torque) > MIN_SWING_SHARE * np.sqrt(np.mean(torque**2))]
        if np.count_nonzero(np.diff(np.sign(sides))) > OWN_COLUMNS + 1:
            out.append(j)
    return out


def _position_doubts(
    recording: Recording,
    robot: Robot,
    torque: FloatArray,
    motion: Samples,
    comparison: NominalComparison,
) -> list[Remark]:
    """Doubt the sign or the zero of a joint's position whose change explains the torque."""
    before = _explained(comparison)
    best: tuple[float, Remark] | None = None
    for j, joint in enumerate(recording.joints):
        for offset in (None, *ZERO_OFFSETS_DEG):
            if offset is not None and robot.entries[j].kind == "prismatic":
                continue
            changed = _changed_position(motion, j, offset)
            gravity, dynamic = nominal_torque(robot, changed)
            compared = _comparison(torque, changed, gravity, dynamic)
            after = _explained(compared)
            gain = after - before
            k = int(np.argmax(gain))
            if (
                before[k] > MAX_EXPLAINED_AS_READ
                or after[k] < MIN_EXPLAINED_AS_CHANGED
                or abs(np.log(max(compared.slopes()[0][k], 1e-9))) > np.log(MAX_SCALE_RATIO)
                or gain.sum() < MIN_EXPLAINED_GAIN
                or (after[before > MIN_EXPLAINED] < MIN_EXPLAINED).any()
                or (best is not None and gain.sum() <= best[0])
            ):
                continue
            change = "with the opposite sign" if offset is None else f"shifted by {offset:+d}°"
            remedy = "turn its sign" if offset is None else "correct its zero"
            text = (
                f"joint '{joint}': the nominal model explains {100 * before[k]:.0f} % of the "
                f"torque of '{recording.joints[k]}', and {100 * after[k]:.0f} % with the position "
                f"of '{joint}' {change}; {remedy} if the robot counts it otherwise than the URDF"
            )
            best = float(gain.sum()), Remark(RemarkKind.POSITION, text, joint, doubt=True)
    return [] if best is None else [best[1]]


def _changed_position(motion: Samples, joint: int, offset: int | None) -> Samples:
    """The motion with a joint's position shifted by degrees; None: with the opposite sign."""
    q, dq, ddq = motion.q.copy(), motion.dq.copy(), motion.ddq.copy()
    if offset is None:
        for values in (q, dq, ddq):
            values[:, joint] *= -1.0
    else:
        q[:, joint] += np.radians(offset)
    return Samples(q, dq, ddq)


def _with_torque(
    comparison: NominalComparison, torque: FloatArray, motion: Samples
) -> NominalComparison:
    """The comparison with other measured torque."""
    # nominal torque is unchanged by removing friction twice
    return _comparison(torque, motion, comparison.gravity, comparison.motion)


def _explained(comparison: NominalComparison) -> FloatArray:
    """Share of each joint's torque that a positive multiple of the nominal torque explains."""
    return np.asarray(np.maximum(comparison.slopes()[1], 0.0) ** 2)
