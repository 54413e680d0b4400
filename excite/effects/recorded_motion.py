"""Recorded motion for effects and diagnosis: low-passed motion and torque, and the base model."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
import pinocchio as pin

from .._types import BoolArray, FloatArray, IntArray
from ..identification.lowpass import MOTION_BANDWIDTH_RATIO, Grid, LowPassFilter, friction_speed
from ..identification.regression import IdentificationModel, filtered_friction, filtered_regressor
from ..identification.segments import RecordingSegment
from ..identification.standstill import (
    FILTER_REACH,
    LargestMotion,
    far_from_rest,
    moving_rows,
)
from ..robot.dynamics import inverse_dynamics
from ..robot.inertial_parameters import Parameters, model_with_inertias
from ..robot.robot import Robot
from ..robot.samples import MIN_TRAVEL, Samples
from .base_dynamics import FloatingBaseDynamics, floating_base_dynamics, symmetric

Function = TypeVar("Function", bound=Callable[..., Any])
Rows = TypeVar("Rows", FloatArray, BoolArray)
MIN_MOVING_SHARE = 0.3
"""Share of the time of all motions that a joint must move. A joint that moves less is judged near
its stops as well, as little would remain."""
MIN_SPEED = 1e-9
"""Smallest speed that scales others, above the rounding errors of filters [rad/s or m/s]."""
MIN_KEPT_ROWS = 8
"""Rows that the low-pass filter must leave of a motion [1]: four periods of its cutoff."""
HELD_SHARE = 0.03
"""Share of the time of all motions that a joint moves up to which it counts as held and is judged
at all times, as nothing would remain [1]: 1/33, so that 30 joints that move one after the other are
not held."""


@dataclass(frozen=True)
class FittedRobot:
    """The robot with the parameters of the fitted base model.

    Attributes:
        psi: Standard parameters ψ̂, shape (P,).
    """

    robot: Robot
    parameters: Parameters
    psi: FloatArray

    @cached_property
    def model(self) -> pin.Model:
        """Pinocchio model with the fitted link inertias."""
        return model_with_inertias(self.robot, self.parameters.of_bodies(self.psi))

    def actuator_parameter(self, kind: str) -> FloatArray:
        """Return "rotor_inertia", "viscous", "coulomb" or "offset" of every joint, (n,), or 0."""
        if kind not in self.parameters.drive:
            return np.zeros(self.robot.n)
        return np.asarray(self.psi[self.parameters.block(kind)])


def for_all_fits(compute: Function) -> Function:
    """Compute a function of a motion once, as it depends on neither torque nor base model."""

    @wraps(compute)
    def computed_once(motion: RecordedMotion, *args: Hashable) -> Any:
        key = compute, *args
        if key not in motion.motion_cache:
            motion.motion_cache[key] = compute(motion, *args)
        return motion.motion_cache[key]

    return cast(Function, computed_once)


Motions: TypeAlias = "Sequence[RecordedMotion]"
"""The motions of some recordings: one of each segment."""


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """A segment of a recording, low-passed, with the fitted base model.

    Arrays have N rows on the grid of the regression, M on that of the recording, and C on the
    coarse grid on which the rigid-body dynamics are evaluated.

    Attributes:
        segment: The segment as it was recorded.
        fitted_robot: Robot with the parameters of the base model.
        widths: Widths of the smooth Coulomb friction [rad/s], shape (n,).
        theta: Base parameters θ̂ of the fit. Without a fit this is empty, as the next four are.
        gamma: Base regressor Γ, low-passed, shape (N, n, p).
        slopes: Derivative of the torque by the logarithm of the friction width, shape (N, n).
        moving: Rows at which a joint moves; static friction is not modelled. Shape (N, n).
        far_from_rest: Rows that no friction at rest reaches through the low-pass filter, shape
            (N, n).
        grid: Grid of the rows, to which `lowpass` reduces: of the regression or the recording.
        bandwidth_ratio: Cutoff of `lowpass` over that of the band.
        modelled_torque: Torque of a fitted joint model, which takes the place of the measured
            torque; None without one, shape (M, n) [N m].
        modelled_motor_torque: The same in the place of the base model's torque.
        motion_cache: Values of functions `for_all_fits`, which all fits to the motion share.
    """

    segment: RecordingSegment
    band: LowPassFilter
    fitted_robot: FittedRobot
    widths: FloatArray
    theta: FloatArray = field(default_factory=lambda: np.zeros(0))
    gamma: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    slopes: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    moving: BoolArray = field(default_factory=lambda: np.zeros((0, 0), bool))
    far_from_rest: BoolArray = field(default_factory=lambda: np.zeros((0, 0), bool))
    grid: Grid = Grid.KEPT
    bandwidth_ratio: float = 1.0
    modelled_torque: FloatArray | None = None
    modelled_motor_torque: FloatArray | None = None
    motion_cache: dict[Hashable, object] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __len__(self) -> int:
        return len(self.time)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.segment.q.shape[1])

    @property
    def kept(self) -> slice:
        """Rows of the grid that count: on that of the regression those far from both ends."""
        if self.grid is Grid.RECORDED:
            return slice(0, len(self.segment))
        step, margin = self.band.steps(Grid.KEPT), self.band.margin
        return slice(margin // step, -(-(len(self.segment) - margin) // step))

    @cached_property
    def row_samples(self) -> IntArray:
        """Sample of each row, shape (N,)."""
        return (np.arange(self.band.samples(self.grid)) * self.band.steps(self.grid))[self.kept]

    @cached_property
    def time(self) -> FloatArray:
        """Time of each row [s], shape (N,)."""
        return self.times[self.row_samples]

    @cached_property
    def torque(self) -> FloatArray:
        """Measured torque, low-passed [N m], shape (N, n)."""
        return self.band.filter(self.segment.torque, self.grid)[self.kept]

    def _of_same_motion(self, **changes: Any) -> RecordedMotion:
        """Return another fit to the same motion, which shares all that depends on it alone."""
        out = replace(self, **{"modelled_torque": None, "modelled_motor_torque": None, **changes})
        object.__setattr__(out, "motion_cache", self.motion_cache)
        return out

    def with_base_model(
        self,
        fitted_robot: FittedRobot,
        widths: FloatArray,
        theta: FloatArray,
        coulomb: Mapping[int, int],
    ) -> RecordedMotion:
        """Return the motion with another fit of the base model.

        `coulomb` are joints by the columns of Γ that are their Coulomb friction.
        """
        step, slopes = filtered_friction(widths, self.samples.dq, self.band)
        gamma = self.gamma.copy()
        for column, joint in coulomb.items():
            gamma[:, joint, column] = step[self.kept, joint]
        return self._of_same_motion(
            fitted_robot=fitted_robot,
            widths=widths,
            theta=theta,
            gamma=gamma,
            slopes=slopes[self.kept],
        )

    def with_torque(self, torque: FloatArray) -> RecordedMotion:
        """Return the motion with another measured torque, shape (M, n) [N m]."""
        return self._of_same_motion(segment=replace(self.segment, torque=torque))

    def with_modelled_torque(
        self, torque: FloatArray, motor_torque: FloatArray | None = None
    ) -> RecordedMotion:
        """Return the motion with a joint model's torques (M, n) [N m]: measured, and of motors."""
        return self._of_same_motion(modelled_torque=torque, modelled_motor_torque=motor_torque)

    @cached_property
    def residual(self) -> FloatArray:
        """Measured torque minus the base model's [N m], shape (N, n)."""
        return self.torque - self.gamma @ self.theta

    @cached_property
    def coulomb_columns(self) -> FloatArray:
        """Low-passed tanh(q̇/w) of every joint, shape (N, n)."""
        return self.lowpass(np.tanh(self.samples.dq / self.widths))

    @cached_property
    def base_friction(self) -> FloatArray:
        """Coulomb and viscous friction of the base model [N m], shape (N, n)."""
        parameter = self.fitted_robot.actuator_parameter
        speed = self.at_rows(self.samples.dq)
        return parameter("viscous") * speed + parameter("coulomb") * self.coulomb_columns

    @cached_property
    def torque_slope(self) -> FloatArray:
        """Time derivative of the measured torque [N m/s], shape (N, n)."""
        return self.band.filter(self.segment.torque, self.grid, 1)[self.kept]

    def sign(self, joint: int) -> FloatArray:
        """Return the smooth sign tanh(q̇/w) of the base model's Coulomb friction, shape (M,)."""
        return np.asarray(np.tanh(self.samples.dq[:, joint] / self.widths[joint]))

    @property
    @for_all_fits
    def samples(self) -> Samples:
        """Low-passed motion at every sample of the recording, shapes (M, n).

        q and q̈ pass a filter of twice the bandwidth, q̇ that of `friction_speed`: it is not the
        derivative of q.
        """
        position = self.band.transform(self.segment.q)
        return Samples(
            position.filter(Grid.RECORDED, 0, MOTION_BANDWIDTH_RATIO),
            friction_speed(self.segment.q, self.band, position),
            position.filter(Grid.RECORDED, 2, MOTION_BANDWIDTH_RATIO),
        )

    @property
    def temperature(self) -> FloatArray:
        """Joint temperatures [°C], shape (M, n); NaN where none was recorded."""
        recorded = self.segment.temperature
        return np.full((len(self.segment), self.n), np.nan) if recorded is None else recorded

    @property
    @for_all_fits
    def reversal_dwell(self) -> FloatArray:
        """Time √(2 Δ/|q̈|) of each joint in an encoder step Δ at reversals, or ∞; (n,) [s]."""
        out = np.full(self.n, np.inf)
        for j, step in enumerate(self.steps):
            turns = np.flatnonzero(np.diff(np.sign(self.samples.dq[:, j])))
            if len(turns):
                out[j] = np.sqrt(
                    2.0 * step / max(float(np.median(np.abs(self.samples.ddq[turns, j]))), 1e-9)
                )
        return out

    @property
    def steps(self) -> FloatArray:
        """Step Δ of each encoder, √12 times its quantisation error [rad or m], shape (n,)."""
        return np.asarray(np.sqrt(12.0) * self.segment.encoder)

    @property
    @for_all_fits
    def coarse_samples(self) -> Samples:
        """Low-passed motion on the grid of the rigid-body dynamics, shapes (C, n)."""
        position = self.band.transform(self.segment.q)
        return Samples(
            *(position.filter(Grid.COARSE, order, MOTION_BANDWIDTH_RATIO) for order in range(3))
        )

    @property
    @for_all_fits
    def times(self) -> FloatArray:
        """Times of all samples of the recording [s], shape (M,)."""
        return self.segment.start + np.arange(len(self.segment)) / self.segment.rate

    @property
    def run_time(self) -> FloatArray:
        """Time since the start of the recording [s], shape (M,)."""
        return self.times - (
            self.segment.start
            if self.segment.recording_start is None
            else self.segment.recording_start
        )

    def lowpass(self, x: FloatArray, of: Grid = Grid.RECORDED) -> FloatArray:
        """Low-pass signals (M, …) or (C, …) and return their kept rows, shape (N, …)."""
        if self.grid is Grid.RECORDED and of is Grid.COARSE:
            x = self.upsample(x.reshape(len(x), -1)).reshape(-1, *x.shape[1:])
        source = Grid.RECORDED if self.grid is Grid.RECORDED else of
        ratio = self.bandwidth_ratio
        return self.band.filter(x, self.grid, source=source, bandwidth_ratio=ratio)[self.kept]

    def at_samples(self, rows: FloatArray) -> FloatArray:
        """Interpolate from the kept rows to every sample: (N, k) -> (M, k)."""
        return interpolated(self.times, self.time, rows)

    def at_rows(self, x: FloatArray, of: Grid = Grid.RECORDED) -> FloatArray:
        """Interpolate from the grid of x to the kept rows: (M, k) or (C, k) -> (N, k)."""
        times = self.segment.start + np.arange(len(x)) / self.band.rate_of(of)
        return np.column_stack([np.interp(self.time, times, column) for column in x.T])

    def upsample(self, x: FloatArray) -> FloatArray:
        """Interpolate from the coarse grid to every sample: (C, k) -> (M, k)."""
        t = np.arange(len(x)) / self.band.rate_of(Grid.COARSE)
        return interpolated(np.arange(len(self.segment)) / self.segment.rate, t, x)

    @cached_property
    def rigid_torque(self) -> FloatArray:
        """Torque of the rigid links without actuators [N m], shape (C, n)."""
        robot = self.fitted_robot
        return inverse_dynamics(robot.robot, robot.model, self.coarse_samples)

    @cached_property
    def initial_torque(self) -> FloatArray:
        """Static torque of the rigid links in the first pose [N m], shape (n,)."""
        robot, q = self.fitted_robot, self.coarse_samples.q[:1]
        still = Samples(q, np.zeros_like(q), np.zeros_like(q))
        return np.asarray(inverse_dynamics(robot.robot, robot.model, still)[0])

    @cached_property
    def transmitted_torque(self) -> FloatArray:
        """Torque that the gears transmit: `rigid_torque` at every sample [N m], shape (M, n)."""
        return self.upsample(self.rigid_torque)

    @cached_property
    def motor_torque(self) -> FloatArray:
        """Torque of the base model with actuators, or of a fitted joint model [N m], (M, n)."""
        if self.modelled_motor_torque is not None:
            return self.modelled_motor_torque
        s, parameter = self.samples, self.fitted_robot.actuator_parameter
        friction = parameter("viscous") * s.dq + parameter("coulomb") * np.tanh(s.dq / self.widths)
        return (
            self.transmitted_torque
            + parameter("rotor_inertia") * s.ddq
            + friction
            + parameter("offset")
        )

    @cached_property
    def measured_torque(self) -> FloatArray:
        """Measured torque, low-passed, or that of a fitted joint model [N m], shape (M, n)."""
        if self.modelled_torque is not None:
            return self.modelled_torque
        return self.band.filter(self.segment.torque, Grid.RECORDED)

    @cached_property
    def derivatives(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives ∂τ/∂q, ∂τ/∂q̇ and mass matrix M of the rigid links, each (C, n, n)."""
        robot, model = self.fitted_robot.robot, self.fitted_robot.model
        data, s = model.createData(), self.coarse_samples
        out = np.empty((3, len(s), model.nv, model.nv))
        for t, (q, v, a) in enumerate(
            zip(robot.expand(s.q), s.dq @ robot.spread.T, s.ddq @ robot.spread.T, strict=True)
        ):
            out[:, t] = pin.computeRNEADerivatives(model, data, q, v, a)
        out[2] = symmetric(out[2])
        # the columns of a joint lie together in memory: each effect of a gear needs them alone
        of_joints = np.ascontiguousarray(
            (robot.spread.T @ out @ robot.spread).transpose(0, 3, 2, 1)
        )
        by_q, by_v, mass = of_joints.transpose(0, 3, 2, 1)
        return by_q, by_v, mass

    @cached_property
    def link_inertias(self) -> FloatArray:
        """The links' inertia about each joint [kg m²], shape (C, n)."""
        return np.maximum(np.diagonal(self.derivatives[2], axis1=1, axis2=2), 1e-9)

    @cached_property
    def free_acceleration(self) -> FloatArray:
        """Acceleration by its load of each link that its motor does not hold [rad/s²], (M, n)."""
        return self.upsample(self.rigid_torque / self.link_inertias)

    @cached_property
    def base_dynamics(self) -> FloatingBaseDynamics:
        """Dynamics of a compliant base, linearised along the motion, at the coarse samples."""
        return floating_base_dynamics(
            self.fitted_robot.robot, self.fitted_robot.model, self.coarse_samples
        )

    @cached_property
    def upright_inertia(self) -> FloatArray:
        """Mass and moments of inertia of the robot about the base axes, all joints at zero.

        Positive, and the same for all recordings of a robot. Shape (6,) [kg, kg m²].
        """
        zero = np.zeros((1, self.n))
        dynamics = floating_base_dynamics(
            self.fitted_robot.robot, self.fitted_robot.model, Samples(zero, zero, zero)
        )
        return np.maximum(np.diag(dynamics.mass[0, :6]), 1e-9)

    @property
    @for_all_fits
    def _link_placements(self) -> tuple[FloatArray, FloatArray]:
        """Jacobians of a point of the robot at the origin of the base frame, shape (C, 6, nv), and
        placements [R | p] of the links' joints, shape (C, n links, 3, 4)."""
        robot, model = self.fitted_robot.robot, self.fitted_robot.model
        data, bodies = model.createData(), [robot.body_of(joint) for joint in range(robot.n)]
        jacobians = np.empty((len(self.coarse_samples), 6, model.nv))
        placements = np.empty((len(self.coarse_samples), robot.n, 3, 4))
        for t, q in enumerate(robot.expand(self.coarse_samples.q)):
            jacobians[t] = np.reshape(pin.computeJointJacobians(model, data, q), (6, -1))
            placements[t] = [data.oMi[body].homogeneous[:3] for body in bodies]
        return jacobians, placements

    @cached_property
    def link_jacobians(self) -> FloatArray:
        """Jacobians of the links' centres of mass in the base frame, shape (C, n links, 3, n)."""
        robot, model = self.fitted_robot.robot, self.fitted_robot.model
        bodies = [robot.body_of(joint) for joint in range(robot.n)]
        # column v of the Jacobian of joint i is zero unless the joint of v carries joint i
        carries = np.zeros((robot.n, model.nv))
        for k, body in enumerate(bodies):
            carries[k, [model.joints[int(i)].idx_v for i in model.supports[body] if i > 0]] = 1.0
        jacobians, placements = self._link_placements
        levers = np.array([model.inertias[body].lever for body in bodies])
        centres = np.einsum("tkxy,ky->tkx", placements[..., :3], levers) + placements[..., 3]
        turning = np.cross(
            jacobians[:, None, 3:], centres[:, :, :, None], axisa=2, axisb=2, axisc=2
        )
        return np.asarray((jacobians[:, None, :3] + turning) * carries[:, None] @ robot.spread)


def position_range(motions: Motions, joint: int) -> tuple[float, float]:
    """Return the smallest and largest position of a joint [rad or m]."""
    positions = [motion.samples.q[:, joint] for motion in motions]
    return min(float(q.min()) for q in positions), max(float(q.max()) for q in positions)


def max_speed(motions: Motions, joint: int) -> float:
    """Return the largest speed of a joint, at least `MIN_SPEED` [rad/s or m/s]."""
    speeds = (float(np.abs(motion.samples.dq[:, joint]).max()) for motion in motions)
    return max(MIN_SPEED, *speeds)


def stands_still(motions: Motions, joint: int) -> bool:
    """Return True if a joint has one position in each of several motions."""
    travels = (float(np.ptp(motion.samples.q[:, joint])) for motion in motions)
    return max(travels) < MIN_TRAVEL


def radian(motions: Motions, joint: int) -> float:
    """Return the travel that counts as a radian of a joint: 1, or a sliding joint's range/(2π)."""
    low, high = position_range(motions, joint)
    is_sliding = motions[0].fitted_robot.robot.entries[joint].kind == "prismatic"
    return max(high - low, MIN_TRAVEL) / (2.0 * np.pi) if is_sliding else 1.0


def interpolated(at: FloatArray, times: FloatArray, x: FloatArray) -> FloatArray:
    """Interpolate signals (N, k) to times (M,) by a cubic spline; constant beyond their ends.

    Linear interpolation would lose 17 % of a sine wave that is sampled four times a period.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    return np.asarray(CubicSpline(times, x)(np.clip(at, times[0], times[-1])))


def split_by_motion(rows: Rows, motions: Motions) -> list[Rows]:
    """Split rows of several motions, one after the other, by motion."""
    return np.split(rows, np.cumsum([len(motion) for motion in motions])[:-1])


def recorded_motions(
    model: IdentificationModel,
    psi: FloatArray,
    segments: Sequence[RecordingSegment],
    hertz: float,
) -> list[RecordedMotion]:
    """Return the motion of every segment that is long enough for the low-pass filter.

    The base model is that of standard parameters ψ, shape (P,). Which rows of a joint count, see
    `RecordedMotion.moving`, is decided for all segments together: a joint may stand still
    throughout one of them.
    """
    fitted, theta = FittedRobot(model.robot, model.parameters, psi), model.base.matrix @ psi
    bands = [(segment, segment.band(hertz)) for segment in segments]
    motions = [
        RecordedMotion(segment, band, fitted, model.widths, theta)
        for segment, band in bands
        if len(segment) > band.needed_samples(MIN_KEPT_ROWS)
    ]
    if not motions:
        return []
    largest = LargestMotion.of((motion.samples.q, motion.samples.dq) for motion in motions)
    out = []
    for motion, moving in zip(motions, _moving_rows(motions, largest, hertz), strict=True):
        gamma, slopes, _ = filtered_regressor(model, motion.segment.q, motion.band)
        reach = int(FILTER_REACH / hertz * motion.segment.rate)
        s = motion.samples
        out.append(
            motion._of_same_motion(
                gamma=gamma[motion.kept],
                slopes=slopes[motion.kept],
                moving=moving,
                far_from_rest=far_from_rest(s.q, s.dq, motion.row_samples, largest, reach),
            )
        )
    return out


def _moving_rows(motions: Motions, largest: LargestMotion, hertz: float) -> list[BoolArray]:
    """Rows of each motion at which a joint moves, shapes (N, n); see `RecordedMotion.moving`."""
    out = np.zeros((sum(map(len, motions)), motions[0].n), bool)
    for reach in (FILTER_REACH / hertz, 0.0):
        few = out.mean(axis=0) <= MIN_MOVING_SHARE
        if few.any():
            moving = [
                moving_rows(
                    m.segment, m.samples.q, m.samples.dq, m.row_samples, largest, reach=reach
                )
                for m in motions
            ]
            out[:, few] = np.concatenate(moving)[:, few]
    out |= out.mean(axis=0) <= HELD_SHARE
    return split_by_motion(out, motions)
