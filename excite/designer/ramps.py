"""Plan the ramps that complete a periodic motion to a motion from rest to rest.

Ruckig plans ramps under velocity, acceleration and jerk limits; it knows neither position limits
nor torque nor obstacles. Ramps are therefore tried from the fastest to the slowest, at phases of
the periodic motion where it is slow, until one passes all checks. Ramps along the path of the
periodic motion (`phase_ramps`) are tried as well; the shorter ones are taken.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import ruckig

from .._types import FloatArray
from ..errors import Infeasible, UnusableInput
from ..robot.inertial_parameters import spread_poses
from ..robot.limits import DERIVED, Limits
from ..robot.samples import Samples
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import (
    JerkProfile,
    Motion,
    MotionSegment,
    PhaseProfile,
    Profile,
    SegmentKind,
)
from . import constraint_margins, phase_ramps
from .constraint_margins import MotionConstraints

RAMP_SCALES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1)
"""Shares of the acceleration and jerk limits that ramps are tried with [1]."""

TRANSFER_SCALES = (0.3, 0.2, 0.1, 0.05)
"""Shares of these limits for approach and return, which carry no information [1]."""

PHASE_COUNT = 40
"""Phases of the periodic motion at which ramps are tried [1]."""

MIN_TRIED_PHASES = 6
"""Phases that are tried before the shortest ramps found so far are accepted [1]."""

EXTRA_CLEARANCE = 1e-3
"""Clearance of ramps beyond the required one [m]: twice the resolution of the certificate."""

POSES_PER_LINE = 100
"""Poses on the straight line between two poses that are checked before planning [1]."""

VIA_POSE_COUNT = 64
"""Poses in the roadmap that fill the joint ranges [1]."""

MAX_ROADMAP_SEARCHES = 300
"""Shortest paths over the roadmap that are tried at most [1]."""

STOP_COST = 0.2
"""Cost of an intermediate stop over the median duration of a leg [1]."""

TIME_GRID = 0.04
"""Duration that segments are multiples of, where the sampling rate allows [s].

It is a multiple of 1, 2, 4, 8 and 20 ms, too, for export at other rates.
"""

DERIVED_ACCELERATION_RATE = 4.0
"""Derived acceleration limit over the velocity limit [1/s]: full speed is reached in 0.25 s."""

DERIVED_JERK_RATE = 10.0
"""Derived jerk limit over the acceleration limit [1/s]: full acceleration is reached in 0.1 s."""

VELOCITY_SCALE_FACTOR = 1.5
"""Share of the velocity limits that a ramp may use, over its share of the acceleration limits [1].

A slow ramp, which is planned for clearances or torque, should not run at full speed.
"""

MAX_JERK_RATIO = 1e3
"""Ratio of jerk to acceleration limit passed to Ruckig at most [1/s].

More jerk gains nothing, and Ruckig's root finding fails at far larger ratios.
"""

LIMIT_MARGIN = 1e-3
"""Share of the limits that Ruckig keeps free, above its rounding errors [1]."""

JOINT_LIMIT_MARGIN = 1e-6
"""Share of the position, velocity and acceleration limits that a checked ramp keeps free [1].

It is above rounding errors, and below LIMIT_MARGIN, so that a ramp at Ruckig's limits is accepted.
"""

MODEL_LIMIT_MARGIN = 1e-4
"""Share of the torque limits and workspace boxes that a checked ramp keeps free [1].

The certificate samples these quantities at other times than the check.
"""

CHECK_STEP = 0.004
"""Largest time step at which a ramp is checked [s]."""

SAME_POSE = 1e-9
"""Largest difference of poses between which no motion is planned [rad]; a certificate accepts jumps
up to 1e-7."""

DEFAULT_SAMPLES = 100
"""Samples of the optimiser over one period where a file states none [1]."""

PEAK_FACTOR = 1.2
"""Least ratio of a derived limit to the peak of the periodic motion [1]."""


@dataclass(frozen=True)
class JointState:
    """Joint positions, velocities and accelerations at one time.

    Attributes:
        q: Positions. Shape (n,).
        dq: Velocities. Shape (n,).
        ddq: Accelerations. Shape (n,).
    """

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray

    @staticmethod
    def at_rest(q: FloatArray) -> JointState:
        """Return the state of rest at positions `q`."""
        return JointState(q, np.zeros_like(q), np.zeros_like(q))


def with_derived_limits(limits: Limits, fourier: FourierSeries) -> Limits:
    """Derive acceleration and jerk limits where the manufacturer states none.

    Derived limits apply to the ramps only. Acceleration: 4 v_max per second, at least 1.2 times the
    peak of the periodic motion; jerk: 10 times the acceleration limit per second, at least 1.2
    times the peak. They follow from `limits` and the motion alone, so that a certificate can derive
    them again; a slower run of the same path keeps its own.

    Args:
        limits: Stated limits.
        fourier: Periodic motion.

    Returns:
        Limits without missing values; derived ones have the source `limits.DERIVED`.
    """
    peak = [PEAK_FACTOR * fourier.peak(order) for order in (2, 3)]
    rule = {"acceleration": np.maximum(DERIVED_ACCELERATION_RATE * limits.velocity, peak[0])}
    known = np.where(np.isfinite(limits.acceleration), limits.acceleration, rule["acceleration"])
    rule["jerk"] = np.maximum(DERIVED_JERK_RATE * known, peak[1])
    arrays, sources = {}, dict(limits.sources)
    for name, values in rule.items():
        stated = getattr(limits, name)
        arrays[name] = np.where(np.isfinite(stated), stated, values)
        sources[name] = tuple(
            s if np.isfinite(v) else DERIVED
            for s, v in zip(limits.sources[name], stated, strict=True)
        )
    return dataclasses.replace(limits, sources=sources, **arrays)  # type: ignore[arg-type]


def time_grid(rate: float) -> float:
    """Return the time grid on which segments begin and end [s]; `rate`: samples per second [Hz]."""
    return TIME_GRID if abs(TIME_GRID * rate - round(TIME_GRID * rate)) < 1e-9 else 1.0 / rate


class RampPlanner:
    """Planner of ramps and transfers.

    Attributes:
        constraints: Constraints on the ramps, derived limits included.
        time_step: Time grid of the segments [s].
        n: Number of joints.
        violated: Constraint that the last ramp violated, "" where it violated none.
    """

    def __init__(self, constraints: MotionConstraints, rate: float) -> None:
        """Set up Ruckig for the joints and the time grid."""
        self.constraints, self.time_step = constraints, time_grid(rate)
        self.n = constraints.robot.n
        self._ruckig = ruckig.Ruckig(self.n, self.time_step)
        self.violated = ""

    def _plan(
        self, begin: JointState, target: FloatArray | None, scale: float
    ) -> JerkProfile | None:
        """Plan a profile from a state to rest, at `target` or anywhere; None where Ruckig fails."""
        limits = self.constraints.limits
        request = ruckig.InputParameter(self.n)
        request.current_position, request.current_velocity, request.current_acceleration = (
            begin.q,
            begin.dq,
            begin.ddq,
        )
        request.target_velocity = request.target_acceleration = np.zeros(self.n)
        if target is None:
            request.control_interface = ruckig.ControlInterface.Velocity
        else:
            request.target_position = target
        request.max_velocity = (
            (1.0 - LIMIT_MARGIN) * limits.velocity * min(1.0, VELOCITY_SCALE_FACTOR * scale)
        )
        request.max_acceleration = (1.0 - LIMIT_MARGIN) * limits.acceleration * scale
        jerk = np.minimum(limits.jerk, MAX_JERK_RATIO * limits.acceleration)
        request.max_jerk = (1.0 - LIMIT_MARGIN) * jerk * scale
        request.duration_discretization = ruckig.DurationDiscretization.Discrete
        planned = ruckig.Trajectory(self.n)
        try:
            result = self._ruckig.calculate(request, planned)
        except ruckig.RuckigError:  # its root finding failed
            return None
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            return None
        return profile_from_ruckig(begin, planned)

    def _check(self, profile: JerkProfile, duration: float) -> tuple[bool, str]:
        """Return whether a ramp keeps all constraints, and the one it violates most."""
        count = max(int(np.ceil(duration / CHECK_STEP)), 4)
        t = np.linspace(0.0, duration, count + 1)
        motion = Samples(profile.at(t), profile.at(t, 1), profile.at(t, 2))
        quantities = []
        for limit, values in (("position", motion.q), ("velocity", motion.dq)):
            rise = constraint_margins.intersample_bound(values)
            quantities.append(
                constraint_margins.joint_quantity(
                    limit, self.constraints, values - rise, values + rise
                )
            )
        quantities.append(
            constraint_margins.joint_quantity(
                "acceleration", self.constraints, motion.ddq, motion.ddq
            )
        )
        if max(d.largest_ratio() for d in quantities) <= 1.0 - JOINT_LIMIT_MARGIN:
            quantities = constraint_margins.model_quantities(self.constraints, motion)
        worst = max(quantities, key=lambda d: d.largest_ratio())
        if worst.largest_ratio() > 1.0 - MODEL_LIMIT_MARGIN:
            return False, f"the {worst.limit} limits"
        violation = self.clearance_violation(motion.q)
        return not violation, violation

    def clearance_violation(self, q: FloatArray) -> str:
        """Name the pair of bodies whose clearance is violated most along a path.

        Args:
            q: Equispaced poses; the distance is bounded between them, too. Shape (N, n).

        Returns:
            The name of its constraint, "" where all clearances are kept.
        """
        if self.constraints.clearance is None:
            return ""
        excess, pair = self.constraints.clearance.least_excess(q)
        excess = excess - constraint_margins.intersample_bound(excess[:, None])[:, 0]
        worst = int(np.argmin(excess))
        return (
            ""
            if excess[worst] >= EXTRA_CLEARANCE
            else f"the clearance of {self.constraints.clearance.names[pair[worst]]}"
        )

    def plan_stop(
        self, begin: JointState, *, backwards: bool = False
    ) -> tuple[JerkProfile, float] | None:
        """Plan the fastest ramp from a state to rest that passes the checks.

        Args:
            begin: State to begin with.
            backwards: Plan a ramp from rest to the state instead. Such a ramp is a stop from the
                state with reversed velocity, run backwards in time. It is checked in the direction
                of its execution, as friction is not symmetric in time.

        Returns:
            The ramp and its duration [s]; None where there is none.
        """
        if backwards:
            begin = JointState(begin.q, -begin.dq, begin.ddq)
        for scale in RAMP_SCALES:
            profile = self._plan(begin, None, scale)
            if profile is None:
                continue
            duration = _duration(profile, self.time_step)
            ramp = reverse_profile(profile, duration) if backwards else profile
            passes, self.violated = self._check(ramp, duration)
            if passes:
                return ramp, duration
        return None

    def plan_transfer(
        self, begin: FloatArray, end: FloatArray, known: FloatArray
    ) -> tuple[list[tuple[JerkProfile, float]], str]:
        """Plan a motion between two poses at rest, directly or through intermediate poses.

        The intermediate poses form a lazy roadmap (Bohlin and Kavraki 2000): legs of the shortest
        path are planned only when needed, and one that fails is removed.

        Args:
            begin: Pose to begin at. Shape (n,).
            end: Pose to end at. Shape (n,).
            known: Poses that are clear. Shape (m, n).

        Returns:
            Legs with their durations [s], and the reason where there are none.
        """
        direct, reason = self._leg(begin, end)
        if direct is not None:
            return [direct], ""
        from scipy.sparse import csgraph  # rarely needed, slow to import

        poses = np.vstack([begin, end, self._clear_poses(known)])
        length = np.abs((poses[:, None] - poses[None]) / self.constraints.limits.velocity).max(
            axis=2
        )
        cost = length + STOP_COST * float(np.median(length))
        cost[0, 1] = cost[1, 0] = np.inf
        legs: dict[tuple[int, int], tuple[JerkProfile, float]] = {}
        for _ in range(MAX_ROADMAP_SEARCHES):
            total, before = csgraph.dijkstra(cost, indices=0, return_predecessors=True)
            if not np.isfinite(total[1]):
                break
            path = [1]
            while path[-1] != 0:
                path.append(int(before[path[-1]]))
            pairs = list(zip(path[:0:-1], path[-2::-1], strict=True))
            for pair in pairs:
                if pair not in legs:
                    leg, _ = self._leg(poses[pair[0]], poses[pair[1]])
                    if leg is None:
                        cost[pair] = cost[pair[::-1]] = np.inf
                        break
                    legs[pair] = leg
            else:
                return [legs[pair] for pair in pairs], ""
        return [], reason

    def _clear_poses(self, known: FloatArray) -> FloatArray:
        """Return the clear ones of the known poses and of poses that fill the joint ranges."""
        poses = np.vstack([known, spread_poses(self.constraints.limits, VIA_POSE_COUNT)])
        clearance = self.constraints.clearance
        return (
            poses
            if clearance is None
            else poses[clearance.least_excess(poses)[0] >= EXTRA_CLEARANCE]
        )

    def _leg(
        self, begin: FloatArray, end: FloatArray
    ) -> tuple[tuple[JerkProfile, float] | None, str]:
        """Plan a direct motion between two poses; return None and the reason where it fails."""
        # a straight line approximates Ruckig's path well enough to discard most blocked legs
        reason = self.clearance_violation(
            begin + np.linspace(0.0, 1.0, POSES_PER_LINE)[:, None] * (end - begin)
        )
        if reason:
            return None, reason
        reason = "the velocity limits"
        for scale in TRANSFER_SCALES:
            profile = self._plan(JointState.at_rest(begin), end, scale)
            if profile is None:
                continue
            passes, reason = self._check(profile, _duration(profile, self.time_step))
            if passes:
                return (profile, _duration(profile, self.time_step)), ""
        return None, reason


def _duration(profile: JerkProfile, grid: float) -> float:
    """Return the duration of a profile, rounded to the time grid [s]."""
    longest = max(sum(d for d, _ in pieces) for pieces in profile.pieces)
    return max(round(longest / grid), 1) * grid


def profile_from_ruckig(begin: JointState, planned: ruckig.Trajectory) -> JerkProfile:
    """Convert a trajectory of Ruckig to pieces of constant jerk."""
    rows = []
    for joint in planned.profiles[0]:
        pieces = [
            *zip(joint.brake.t, joint.brake.j, strict=True),
            *zip(joint.t, joint.j, strict=True),
        ]
        rows.append(tuple((float(d), float(j)) for d, j in pieces if d > 0.0))
    return JerkProfile(
        np.array(begin.q, float), np.array(begin.dq, float), np.array(begin.ddq, float), tuple(rows)
    )


def reverse_profile(profile: JerkProfile, duration: float) -> JerkProfile:
    """Return a profile run backwards in time: r(t) = p(duration − t); `duration` in s."""
    end = np.array([duration])
    rows = []
    for pieces in profile.pieces:
        remaining = duration - sum(d for d, _ in pieces)
        padded = [*pieces, (remaining, 0.0)] if remaining > 1e-12 else list(pieces)
        rows.append(tuple((d, -j) for d, j in reversed(padded)))
    return JerkProfile(
        profile.at(end)[0], -profile.at(end, 1)[0], profile.at(end, 2)[0], tuple(rows)
    )


Part = tuple[SegmentKind, Profile | None, float]
"""Kind, motion (None for the periodic part) and duration [s] of a part of a motion."""


@dataclass(frozen=True)
class _RampPair:
    """Periodic motion that begins at some phase, with the ramps that fit there.

    Attributes:
        fourier: The periodic motion.
        ramp_in: Ramp into it, and its duration [s].
        ramp_out: Ramp out of it, and its duration [s].
    """

    fourier: FourierSeries
    ramp_in: tuple[Profile, float]
    ramp_out: tuple[Profile, float]

    @property
    def duration(self) -> float:
        """Duration of both ramps [s]."""
        return self.ramp_in[1] + self.ramp_out[1]

    def rest_poses(self) -> tuple[FloatArray, FloatArray]:
        """Return the poses at the start of the ramp-in and the end of the ramp-out."""
        profile, duration = self.ramp_out
        return self.ramp_in[0].position, profile.at(np.array([duration]))[0]


def plan_rest_to_rest(
    constraints: MotionConstraints,
    fourier: FourierSeries,
    periods: int,
    rate: float,
    start: FloatArray | None = None,
    samples: int = DEFAULT_SAMPLES,
) -> Motion:
    """Complete a periodic motion to a motion from rest to rest.

    Args:
        constraints: Constraints, with acceleration and jerk limits (`with_derived_limits`) that
            are reduced by the margins to keep free.
        fourier: Periodic motion; it may begin at another phase in the result.
        periods: Number of periods.
        rate: Samples per second [Hz].
        start: Pose to start and end at; None: where the ramp-in begins. Shape (n,).
        samples: Samples of the optimiser over one period, on which the certificate's depend.

    Raises:
        Infeasible: No pair of ramps keeps all limits, or for no pair an approach or a return does.
        UnusableInput: The start pose violates a limit.
    """
    planner = RampPlanner(constraints, rate)
    if start is not None:
        check_start_pose(constraints, start)
    step = constraint_margins.ramp_step(fourier.period, samples, rate)
    error: Infeasible | None = None
    for pair in _ramp_pairs(planner, fourier, step):
        try:
            return _with_approach_and_return(planner, pair, periods, rate, start)
        except Infeasible as failure:
            error = error or failure
    if error is None:
        raise Infeasible(
            f"{constraints.robot.source}: no ramp into the periodic motion keeps "
            f"{planner.violated}; lower --uncertainty, lengthen --period or widen that limit"
        )
    raise error


def _with_approach_and_return(
    planner: RampPlanner, pair: _RampPair, periods: int, rate: float, start: FloatArray | None
) -> Motion:
    """Add approach and return to a pair of ramps.

    Raises:
        Infeasible: There is no approach or no return.
    """
    ramp_start, ramp_end = pair.rest_poses()
    home_pose = ramp_start if start is None else start
    known = pair.fourier.at(pair.fourier.grid(PHASE_COUNT))
    approach = (
        []
        if start is None
        else _transfer_legs(planner, home_pose, ramp_start, known, SegmentKind.APPROACH)
    )
    back = _transfer_legs(planner, ramp_end, home_pose, known, SegmentKind.RETURN)
    parts: tuple[Part, ...] = (
        *((SegmentKind.APPROACH, *leg) for leg in approach),
        (SegmentKind.RAMP_IN, *pair.ramp_in),
        (SegmentKind.FOURIER, None, periods * pair.fourier.period),
        (SegmentKind.RAMP_OUT, *pair.ramp_out),
        *((SegmentKind.RETURN, *leg) for leg in back),
    )
    return joined_parts(planner.constraints.robot.joints, pair.fourier, periods, parts, rate)


def joined_parts(
    joints: tuple[str, ...],
    fourier: FourierSeries,
    periods: int,
    parts: Iterable[Part],
    rate: float,
) -> Motion:
    """Join consecutive parts to a motion; each lasts a whole number of samples.

    Args:
        joints: Names of the joints.
        fourier: Periodic part.
        periods: Its number of periods.
        parts: The parts in order of time.
        rate: Samples per second [Hz].
    """
    segments, ticks = [], 0
    for kind, profile, duration in parts:
        begin, ticks = ticks, ticks + round(duration * rate)
        segments.append(MotionSegment(kind, begin / rate, ticks / rate, profile))
    return Motion(joints, fourier, periods, tuple(segments))


def _transfer_legs(
    planner: RampPlanner, begin: FloatArray, end: FloatArray, known: FloatArray, kind: SegmentKind
) -> list[tuple[JerkProfile, float]]:
    """Plan the approach or the return; no legs where the poses are equal.

    Raises:
        Infeasible: No motion between the poses keeps all limits and clearances.
    """
    if np.abs(begin - end).max() < SAME_POSE:
        return []
    legs, reason = planner.plan_transfer(begin, end, known)
    if not legs:
        robot = planner.constraints.robot
        raise Infeasible(
            f"{robot.source}: no {kind} keeps {reason}; "
            "give another --start pose, widen them or clear the way"
        )
    return legs


def _ramp_pairs(planner: RampPlanner, fourier: FourierSeries, step: float) -> Iterator[_RampPair]:
    """Yield ramps into and out of a periodic motion, the shortest ones first.

    At each phase the shorter one of Ruckig's ramp and of the ramp along the path is taken. The
    second pair starts and ends at the same pose of the path, so that it needs no return.
    """
    times = fourier.grid(PHASE_COUNT)
    speed = np.abs(fourier.at(times, 1) / planner.constraints.limits.velocity).max(axis=1)
    pairs: list[_RampPair] = []
    order = np.argsort(speed)
    for tried, index in enumerate(order):
        shifted = fourier.shifted(float(times[index]))
        ramp_out = _shortest_ramp(planner, shifted, step, inwards=False)
        ramp_in = _shortest_ramp(planner, shifted, step, inwards=True) if ramp_out else None
        if ramp_out is not None and ramp_in is not None:
            pairs.append(_RampPair(shifted, ramp_in, ramp_out))
        if pairs and tried >= MIN_TRIED_PHASES - 1:
            break
    shortest = sorted(pairs, key=lambda pair: pair.duration)
    yield from shortest[:1]
    closed = (_closed_pair(planner, fourier, float(times[index]), step) for index in order)
    yield from itertools.islice((pair for pair in closed if pair is not None), 1)
    yield from shortest[1:]


def _shortest_ramp(
    planner: RampPlanner, fourier: FourierSeries, step: float, *, inwards: bool
) -> tuple[Profile, float] | None:
    """Return the shortest ramp at the start of a periodic motion, None where there is none."""
    zero = np.zeros(1)
    state = JointState(*(fourier.at(zero, order)[0] for order in range(3)))
    free = planner.plan_stop(state, backwards=inwards)
    along_path = phase_ramps.shortest_ramp(
        planner.constraints,
        fourier.period,
        planner.time_step,
        step,
        lambda duration: phase_ramps.phase_profile(fourier, duration, inwards=inwards),
        np.inf if free is None else free[1],
    )
    return free if along_path is None else along_path


def _closed_pair(
    planner: RampPlanner, fourier: FourierSeries, rest_phase: float, step: float
) -> _RampPair | None:
    """Return ramps along the path from rest at a phase and back to it, None where there are none.

    The ramp-out follows the periodic motion, whose limits hold, until it can stop at the pose at
    which the ramp-in began. Each of both ramps is short, as a slow one may exceed a torque limit
    where the motion of the periodic part helps against gravity.
    """

    def shortest(inwards: bool) -> tuple[PhaseProfile, float] | None:
        def ramp_of(duration: float) -> PhaseProfile:
            half = 0.5 * duration  # by which the phase advances
            shifted = fourier.shifted(rest_phase + half if inwards else rest_phase - half)
            return phase_ramps.phase_profile(shifted, duration, inwards=inwards)

        grid = 2.0 * planner.time_step
        return phase_ramps.shortest_ramp(planner.constraints, fourier.period, grid, step, ramp_of)

    ramp_in = shortest(inwards=True)
    ramp_out = None if ramp_in is None else shortest(inwards=False)
    if ramp_in is None or ramp_out is None:
        return None
    shifted, (_, begin), (_, end) = ramp_in[0].fourier, ramp_in, ramp_out
    advance = 0.5 * (begin + end)  # of the phase, in both ramps
    cruise = float(np.ceil(advance / fourier.period - 1e-9) * fourier.period - advance)
    if cruise < 1e-9:  # both ramps together take whole periods already
        stop = phase_ramps.phase_profile(shifted, end, inwards=False)
        return _RampPair(shifted, ramp_in, (stop, end))
    stop = phase_ramps.delayed_stop(shifted, cruise, end)
    return _RampPair(shifted, ramp_in, (stop, cruise + end))


def check_start_pose(constraints: MotionConstraints, start: FloatArray) -> None:
    """Check a start pose.

    Args:
        constraints: Constraints on the motion.
        start: Start pose. Shape (n,).

    Raises:
        UnusableInput: It violates a limit at rest, or a clearance.
    """
    robot, limits = constraints.robot, constraints.limits
    if start.shape != (robot.n,) or not np.isfinite(start).all():
        raise UnusableInput(
            f"{robot.source}: start pose: should be {robot.n} finite positions, one per joint"
        )
    outside = (start < limits.position[:, 0]) | (start > limits.position[:, 1])
    if outside.any():
        j = int(np.argmax(outside))
        low, high = limits.position[j]
        raise UnusableInput(
            f"{robot.source}: start pose: joint '{robot.joints[j]}' at {start[j]:g} is outside "
            f"[{low:g}, {high:g}]; move it inside"
        )
    if constraints.clearance is not None:
        excess, pair = constraints.clearance.least_excess(start[None])
        if excess[0] < EXTRA_CLEARANCE:
            k = pair[0]
            required = constraints.clearance.required[k]
            distance = 1e3 * (excess[0] + required)
            state = (
                f"{distance:.0f} mm apart, {1e3 * required:.0f} mm required"
                if distance > 0.0
                else "in collision"
            )
            raise UnusableInput(
                f"{robot.source}: start pose: {constraints.clearance.names[k]} are {state}; "
                "give another --start or clear the scene"
            )
    stationary = np.tile(start, (3, 1))
    for quantity in constraint_margins.model_quantities(
        constraints, Samples(stationary, np.zeros_like(stationary), np.zeros_like(stationary))
    ):
        if quantity.largest_ratio() > 1.0:
            raise UnusableInput(
                f"{robot.source}: start pose: violates the {quantity.limit} limits at rest; "
                "give another --start pose"
            )
