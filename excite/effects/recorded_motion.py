"""Recordings as a diagnosis sees them: motion, measured torque and what the base model makes of them, on one band."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar, cast

import numpy as np
import pinocchio as pin

from ..identification.lowpass import MOTION_BANDWIDTH_RATIO, Grid, LowPassFilter, friction_speed
from ..identification.regression import IdentificationModel, filtered_regressor
from ..identification.segments import RecordingSegment
from ..recordings.missing_values import runs
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..robot.samples import Samples
from .base_dynamics import FloatingBaseDynamics, floating_base_dynamics

Array = np.ndarray
T = TypeVar("T")
STILL, LOOSE = 0.01, 0.02
"""Of a joint's largest speed, below which it stands; and of its range, by how much it must have moved since it rested: until then friction
is whatever held it."""
REST, BLURRED, COUNTS = 0.06, 0.2, 50.0
"""For how long a joint stands until that is rest [s]; and where an encoder hides how fast it turns back: so many of its steps, at the
least, should lie in the way that a joint can have gone meanwhile."""
MOVING = 0.3
"""Of its time, what a joint must move at the least, lest it be judged where it stands too: there is little else."""


@dataclass(frozen=True)
class FittedRobot:
    """The rigid robot that the base fit found. model: Pinocchio's, with its inertias. psi: ψ̂. Shape (P,)."""

    robot: Robot
    parameters: Parameters
    model: pin.Model
    psi: Array

    def drive(self, kind: str) -> Array:
        """A drive parameter of every joint, 0 where the base model has none. Shape (n,)."""
        if kind not in self.parameters.drive:
            return np.zeros(self.robot.n)
        return np.asarray(self.psi[self.parameters.block(kind)])


def fitted_robot(robot: Robot, parameters: Parameters, psi: Array) -> FittedRobot:
    """The robot with bodies ψ."""
    model = robot.model.copy()
    for i in range(parameters.bodies):
        model.inertias[i + 1] = pin.Inertia.FromDynamicParameters(psi[10 * i : 10 * i + 10])
    return FittedRobot(robot, parameters, model, psi)


class memoized(Generic[T]):
    """A property that is found once for a track and for all that see it later."""

    def __init__(self, found: Callable[[RecordedMotion], T]) -> None:
        self.found, self.__doc__ = found, found.__doc__

    def __get__(self, track: RecordedMotion, owner: type[RecordedMotion]) -> T:
        name = self.found.__name__
        if name not in track.cache:
            track.cache[name] = self.found(track)
        return cast(T, track.cache[name])


@dataclass(frozen=True)
class RecordedMotion:
    """One stretch of a recording. torque: measured, below the band, at the kept rows. Shape (N, n). gamma: Γ there. Shape (N, n, p).

    theta: θ̂ of the base fit. to: where its rows lie. behind: by which what acts on it is recorded later, and the lag of the filter that it
    has passed [s]. slopes: of torque by the log of friction's width. Shape (N, n). time: of the kept rows [s]. piece: as recorded. body:
    the base fit. known: what is `remembered`.
    """

    segment: RecordingSegment
    band: LowPassFilter
    fitted_robot: FittedRobot
    widths: Array
    theta: Array
    torque: Array
    gamma: Array
    slopes: Array
    kept: slice
    time: Array
    grid: Grid = Grid.KEPT
    behind: tuple[float, float] = (0.0, 0.0)
    cache: dict[str, object] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def n(self) -> int:
        return int(self.torque.shape[1])

    def delayed(self, seconds: float, lagging: bool = False) -> RecordedMotion:
        """The same with all that is remembered, as seen by what is recorded later; or, lagging, through a filter of first order."""
        out = copy.copy(self)
        object.__setattr__(out, "behind", (0.0, seconds) if lagging else (seconds, 0.0))
        return out

    @memoized
    def residual(self) -> Array:
        """Torque that the base fit leaves. Shape (N, n)."""
        return self.torque - self.gamma @ self.theta

    @memoized
    def samples(self) -> Samples:
        """Motion at every sample of the recording. Shapes (M, n)."""
        position = self.band.transform(self.segment.q)
        speed = friction_speed(self.segment.q, self.band, position)
        return Samples(
            position.filter(Grid.RECORDED, 0, MOTION_BANDWIDTH_RATIO),
            speed,
            position.filter(Grid.RECORDED, 2, MOTION_BANDWIDTH_RATIO),
        )

    def sign(self, joint: int) -> Array:
        """The smooth sign of a joint's speed that the base model's Coulomb friction has, at every sample. Shape (M,)."""
        return np.asarray(np.tanh(self.samples.dq[:, joint] / self.widths[joint]))

    @property
    def temperature(self) -> Array:
        """Of every joint, at every sample; NaN where a joint's was not recorded. Shape (M, n) [°C]."""
        told = self.segment.temperature
        return np.full((len(self.segment), self.n), np.nan) if told is None else told

    @memoized
    def moving(self) -> Array:
        """Kept rows at which a joint moves, friction known but for its law: at rest it can be anything that sticks. Shape (N, n)."""
        rows = np.rint((self.time - self.segment.start) * self.segment.rate).astype(int)
        out = np.empty((len(self), self.n), bool)
        for j in range(self.n):
            speed, steps = self.samples.dq[:, j], COUNTS * float(self.steps.max())
            rest = REST if STILL * float(np.abs(speed).max()) * REST > steps else BLURRED
            moving = _moving(self.samples.q[:, j], speed, self.segment.rate, rest)[rows]
            out[:, j] = moving if moving.mean() > MOVING else True
        return out

    @memoized
    def reversal_dwell(self) -> Array:
        """How long each joint stays within a step Δ of its encoder where it turns back, √(2 Δ/|q̈|); ∞ where it does not. Shape (n,) [s]."""
        out = np.full(self.n, np.inf)
        for j, step in enumerate(self.steps):
            turns = np.flatnonzero(np.diff(np.sign(self.samples.dq[:, j])))
            if len(turns):
                out[j] = np.sqrt(
                    2.0 * step / max(float(np.median(np.abs(self.samples.ddq[turns, j]))), 1e-9)
                )
        return out

    @property
    def steps(self) -> Array:
        """Δ of each encoder. Shape (n,) [rad or m]."""
        return np.asarray(np.sqrt(12.0) * self.segment.encoder)

    @memoized
    def coarse_samples(self) -> Samples:
        """Motion where rigid-body dynamics are evaluated. Shapes (C, n)."""
        position = self.band.transform(self.segment.q)
        return Samples(
            *(position.filter(Grid.COARSE, order, MOTION_BANDWIDTH_RATIO) for order in range(3))
        )

    @memoized
    def times(self) -> Array:
        """Times of every sample [s]. Shape (M,)."""
        return self.segment.start + np.arange(len(self.segment)) / self.segment.rate

    @property
    def run_time(self) -> Array:
        """For how long the recording has been going on, at every sample. Shape (M,) [s]."""
        return self.times - (
            self.segment.start
            if self.segment.recording_start is None
            else self.segment.recording_start
        )

    def lowpass(self, x: Array, of: Grid = Grid.RECORDED) -> Array:
        """Below the band, at the kept rows, as late as it comes. Shapes (M or C, …) -> (N, …)."""
        if self.grid is Grid.RECORDED and of is Grid.COARSE:
            x = self.upsample(x.reshape(len(x), -1)).reshape(-1, *x.shape[1:])
        late, lag = self.behind
        return self.band.filter(
            x,
            self.grid,
            source=Grid.RECORDED if self.grid is Grid.RECORDED else of,
            delay=late,
            time_constant=lag,
        )[self.kept]

    def upsample(self, x: Array) -> Array:
        """From the coarse grid to every sample. Shapes (C, k) -> (M, k)."""
        t = np.arange(len(x)) / self.band.rate_of(Grid.COARSE)
        fine = np.arange(len(self.segment)) / self.segment.rate
        return np.column_stack([np.interp(fine, t, column) for column in x.T])

    @memoized
    def rigid_torque(self) -> Array:
        """Torque of the rigid bodies alone, without drives, at the coarse samples. Shape (C, n)."""
        return self._inverse(self.coarse_samples.q, self.coarse_samples.dq, self.coarse_samples.ddq)

    @memoized
    def initial_torque(self) -> Array:
        """Torque of the rigid bodies where they begin, at rest. Shape (n,)."""
        q = self.coarse_samples.q[:1]
        return np.asarray(self._inverse(q, np.zeros_like(q), np.zeros_like(q))[0])

    @memoized
    def transmitted_torque(self) -> Array:
        """What the gear carries: the rigid bodies' torque at every sample. Shape (M, n)."""
        return self.upsample(self.rigid_torque)

    @memoized
    def motor_torque(self) -> Array:
        """What the base model says the drive makes: rigid, rotor, friction, offset, at every sample. Shape (M, n)."""
        s, drive = self.samples, self.fitted_robot.drive
        friction = drive("viscous") * s.dq + drive("coulomb") * np.tanh(s.dq / self.widths)
        return self.transmitted_torque + drive("rotor_inertia") * s.ddq + friction + drive("offset")

    @memoized
    def measured_torque(self) -> Array:
        """What the drive was measured to make, below the band: with all that the base model lacks, and noise. Shape (M, n)."""
        return self.band.filter(self.segment.torque, Grid.RECORDED)

    def _inverse(self, q: Array, dq: Array, ddq: Array) -> Array:
        robot, data = self.fitted_robot.robot, self.fitted_robot.model.createData()
        Q, V, A = robot.expand(q), dq @ robot.spread.T, ddq @ robot.spread.T
        out = np.array(
            [pin.rnea(self.fitted_robot.model, data, *state) for state in zip(Q, V, A, strict=True)]
        )
        return out @ robot.spread

    @memoized
    def derivatives(self) -> tuple[Array, Array, Array]:
        """∂τ/∂q, ∂τ/∂q̇ and M of the rigid bodies at the coarse samples. Three arrays of shape (C, n, n)."""
        robot, model = self.fitted_robot.robot, self.fitted_robot.model
        data, s = model.createData(), self.coarse_samples
        out = np.empty((3, len(s), robot.n, robot.n))
        for t, (q, v, a) in enumerate(
            zip(robot.expand(s.q), s.dq @ robot.spread.T, s.ddq @ robot.spread.T, strict=True)
        ):
            by_q, by_v, mass = pin.computeRNEADerivatives(model, data, q, v, a)
            full = np.triu(mass) + np.triu(mass, 1).T
            for k, matrix in enumerate((by_q, by_v, full)):
                out[k, t] = robot.spread.T @ matrix @ robot.spread
        return out[0], out[1], out[2]

    @memoized
    def gravity(self) -> Array:
        """Torque of a unit acceleration of the base against x, y and z: −∂τ/∂g. Shape (C, n, 3)."""
        robot = self.fitted_robot.robot
        out = np.empty((len(self.coarse_samples), robot.n, 3))
        q, rest = self.coarse_samples.q, np.zeros_like(self.coarse_samples.q)
        for axis in range(3):
            model = self.fitted_robot.model.copy()
            model.gravity.linear = -np.eye(3)[axis]
            data = model.createData()
            torque = [
                pin.rnea(model, data, one, still, still)
                for one, still in zip(robot.expand(q), rest @ robot.spread.T, strict=True)
            ]
            out[:, :, axis] = np.array(torque) @ robot.spread
        return out

    @memoized
    def leaning(self) -> Array:
        """Torque of a base turned by a radian about x, y, z, to first order: it sees gravity turned back, δg = g × φ. Shape (C, n, 3)."""
        return np.asarray(-self.gravity @ pin.skew(self.fitted_robot.model.gravity.linear))

    @memoized
    def base_dynamics(self) -> FloatingBaseDynamics:
        """What a base that gives way would do, at the coarse samples."""
        return floating_base_dynamics(
            self.fitted_robot.robot, self.fitted_robot.model, self.coarse_samples
        )

    @memoized
    def upright_inertia(self) -> Array:
        """Mass and moments of inertia of the whole robot about the base's axes with all joints at zero, and above zero: the same of every
        recording of a robot. Shape (6,)."""
        still = np.zeros((1, self.n))
        stretched = floating_base_dynamics(
            self.fitted_robot.robot, self.fitted_robot.model, Samples(still, still, still)
        )
        return np.maximum(np.diag(stretched.mass[0, :6]), 1e-9)

    @memoized
    def link_jacobians(self) -> Array:
        """How a force on the centre of each link acts on the joints, base frame, at the coarse samples. Shape (C, n links, 3, n)."""
        robot, model = self.fitted_robot.robot, self.fitted_robot.model
        data, held = (
            model.createData(),
            [int(np.flatnonzero(column)[0]) + 1 for column in robot.spread.T],
        )
        # column v of the Jacobian of joint i: the joint of v carries i
        carried = np.zeros((robot.n, model.nv))
        for k, joint in enumerate(held):
            carried[k, [model.joints[int(i)].idx_v for i in model.supports[joint] if i > 0]] = 1.0
        jacobians, centres = (
            np.empty((len(self.coarse_samples), 6, model.nv)),
            np.empty((len(self.coarse_samples), robot.n, 3)),
        )
        for t, q in enumerate(robot.expand(self.coarse_samples.q)):
            jacobians[t] = np.reshape(pin.computeJointJacobians(model, data, q), (6, -1))
            centres[t] = [data.oMi[joint].act(model.inertias[joint].lever) for joint in held]
        turning = np.cross(
            jacobians[:, None, 3:], centres[:, :, :, None], axisa=2, axisb=2, axisc=2
        )
        return np.asarray((jacobians[:, None, :3] + turning) * carried[:, None] @ robot.spread)


def _moving(q: Array, dq: Array, rate: float, rest: float) -> Array:
    """Samples at which a joint moves: not at rest, nor within a little of where it rested. rest: how long it stands until that is [s].
    Shapes (M,)."""
    out, far = np.ones(len(q), bool), LOOSE * float(np.ptp(q))
    still = np.abs(dq) < STILL * np.abs(dq).max()
    for start, end in runs(still).tolist():
        if end - start > rest * rate:
            away = np.abs(q[end:] - q[end - 1]) > far
            out[start : end + int(np.argmax(away)) if away.any() else len(q)] = False
    return out


def position_range(stretches: Sequence[RecordedMotion], joint: int) -> tuple[float, float]:
    """Ends of where a joint was [rad or m]."""
    places = [one.samples.q[:, joint] for one in stretches]
    return min(float(q.min()) for q in places), max(float(q.max()) for q in places)


def split_by_motion(rows: Array, stretches: Sequence[RecordedMotion]) -> list[Array]:
    """Rows of several stretches, one after the other, by stretch."""
    return np.split(rows, np.cumsum([len(one) for one in stretches])[:-1])


def recorded_motions(
    model: IdentificationModel,
    fitted: FittedRobot,
    theta: Array,
    pieces: Sequence[RecordingSegment],
    hertz: float,
) -> list[RecordedMotion]:
    """Every stretch that is long enough for the band."""
    out = []
    for piece in pieces:
        band = piece.band(hertz)
        step, margin = band.steps(Grid.KEPT), band.margin
        kept = slice(margin // step, -(-(len(piece) - margin) // step))
        if len(piece) <= 2 * margin + 8 * step:
            continue
        gamma, slopes, _ = filtered_regressor(model, piece.q, band)
        torque = band.filter(piece.torque, Grid.KEPT)
        time = piece.start + np.arange(len(torque)) * step / piece.rate
        out.append(
            RecordedMotion(
                piece,
                band,
                fitted,
                model.widths,
                theta,
                torque[kept],
                gamma[kept],
                slopes[kept],
                kept,
                time[kept],
            )
        )
    return out
