"""The rest-to-rest motion around the Fourier part: Ruckig plans, and every ramp is checked before it is taken.

Ruckig keeps velocity, acceleration and jerk; it knows neither position limits nor torque. So ramps are tried from the
briskest to the gentlest, at phases of the periodic part where it is slow, until one passes all checks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import ruckig

from ..errors import Infeasible, UnusableInput
from ..robot.inertial_parameters import spread_poses
from ..robot.limits import DERIVED, Limits
from ..robot.samples import Samples
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import JerkProfile, Motion, MotionSegment
from . import constraint_margins
from .constraint_margins import MotionConstraints

Array = np.ndarray
RAMP_SCALES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1)
TRANSFER_SCALES = (0.3, 0.2, 0.1, 0.05)
"""Scales of approach and return, which show nothing and so need not hurry."""
PHASE_COUNT = 40
EXTRA_CLEARANCE = 1e-3
"""Clearance beyond the margin that a ramp keeps [m]: what the certificate cannot resolve, twice."""
POSES_PER_LINE = 100
"""Poses at which a straight line is looked at first."""
VIA_POSE_COUNT = 64
MAX_ROADMAP_SEARCHES = 300
"""Legs that are tried at most to find a way round."""
TIME_GRID = 0.04
"""Segments last whole multiples of this [s] where the rate allows: also of 1, 2, 4, 8 and 20 ms, for other rates."""


@dataclass(frozen=True)
class JointState:
    """Joint positions, velocities, accelerations at one moment. Shapes (n,)."""

    q: Array
    dq: Array
    ddq: Array

    @staticmethod
    def rest(q: Array) -> JointState:
        """Standing still at q."""
        return JointState(q, np.zeros_like(q), np.zeros_like(q))


MAX_JERK_RATIO = 1e3
"""Jerk over acceleration beyond which more jerk buys nothing [1/s]: Ruckig's root finding fails at far larger ratios."""


def with_derived_limits(limits: Limits, fourier: FourierSeries) -> Limits:
    """Limits with a stated acceleration and jerk where the maker gives none; they bind the ramps only.

    Acceleration: 4 v_max/s or 1.2 times the Fourier part's peak, if that is more; jerk: 10/s times that, or likewise. They follow from
    `limits` and the motion alone, so that a certificate can derive them again; a slower run of the same path keeps its own.
    """
    peak = [1.2 * fourier.peak(order) for order in (2, 3)]
    rule = {"acceleration": np.maximum(4.0 * limits.velocity, peak[0])}
    known = np.where(np.isfinite(limits.acceleration), limits.acceleration, rule["acceleration"])
    rule["jerk"] = np.maximum(10.0 * known, peak[1])
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
    """The time grid on which segments begin and end [s]."""
    return TIME_GRID if abs(TIME_GRID * rate - round(TIME_GRID * rate)) < 1e-9 else 1.0 / rate


class RampPlanner:
    """Ramps under the limits of `subject` (derived ones included), on the time grid of `rate` [Hz]."""

    def __init__(self, subject: MotionConstraints, rate: float) -> None:
        self.constraints, self.rate, self.grid = subject, rate, time_grid(rate)
        self.n = subject.robot.n
        self._ruckig = ruckig.Ruckig(self.n, self.grid)
        self.obstacle = ""
        """What the last stop that was tried would break."""

    def _plan(self, begin: JointState, target: Array | None, scale: float) -> JerkProfile | None:
        """Ruckig's profile from a state to rest at `target`, or to rest anywhere; None where it finds none."""
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
        # 1e-3 keeps clear of the limits by more than rounding
        request.max_velocity = (1.0 - 1e-3) * limits.velocity * min(1.0, 1.5 * scale)
        request.max_acceleration = (1.0 - 1e-3) * limits.acceleration * scale
        jerk = np.minimum(limits.jerk, MAX_JERK_RATIO * limits.acceleration)
        request.max_jerk = (1.0 - 1e-3) * jerk * scale
        request.duration_discretization = ruckig.DurationDiscretization.Discrete
        found = ruckig.Trajectory(self.n)
        try:
            result = self._ruckig.calculate(request, found)
        except ruckig.RuckigError:  # its numbers gave out
            return None
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            return None
        return _profile(begin, found)

    def _passes(self, profile: JerkProfile, duration: float) -> tuple[bool, str]:
        """Whether a ramp keeps position, velocity, the loads and its distance; and what it breaks most."""
        count = max(int(np.ceil(duration / 0.004)), 4)
        t = np.linspace(0.0, duration, count + 1)
        motion = Samples(profile.at(t), profile.at(t, 1), profile.at(t, 2))
        demands = [
            constraint_margins.joint_quantity(
                "position",
                self.constraints,
                motion.q - constraint_margins.intersample_bound(motion.q),
                motion.q + constraint_margins.intersample_bound(motion.q),
            ),
            constraint_margins.joint_quantity(
                "velocity",
                self.constraints,
                motion.dq - constraint_margins.intersample_bound(motion.dq),
                motion.dq + constraint_margins.intersample_bound(motion.dq),
            ),
            constraint_margins.joint_quantity("acceleration", self.constraints, motion.ddq, motion.ddq),
        ]
        if max(d.largest_ratio() for d in demands) <= 1.0 - 1e-6:
            demands = constraint_margins.model_quantities(self.constraints, motion)
        worst = max(demands, key=lambda d: d.largest_ratio())
        if worst.largest_ratio() > 1.0 - 1e-4:
            return False, f"the {worst.limit} limits"
        blocked = self.clearance_violation(motion.q)
        return not blocked, blocked

    def clearance_violation(self, q: Array) -> str:
        """The pair that comes too near along equispaced poses, between them too; "" where none does. Shape (N, n)."""
        if self.constraints.clearance is None:
            return ""
        room, pair = self.constraints.clearance.least(q)
        room = room - constraint_margins.intersample_bound(room[:, None])[:, 0]
        worst = int(np.argmin(room))
        return (
            ""
            if room[worst] >= EXTRA_CLEARANCE
            else f"the clearance of {self.constraints.clearance.names[pair[worst]]}"
        )

    def stop(self, begin: JointState, *, backwards: bool = False) -> Iterator[tuple[JerkProfile, float]]:
        """Ways to come to rest from a state, briskest first; all checked.

        backwards: ways to reach the state from rest instead. Such a ramp is a stop from the state with velocity
        reversed, run backwards in time; it is checked as it will run, for friction does not reverse with time.
        """
        if backwards:
            begin = JointState(begin.q, -begin.dq, begin.ddq)
        for scale in RAMP_SCALES:
            profile = self._plan(begin, None, scale)
            if profile is None:
                continue
            duration = _duration(profile, self.grid)
            ramp = reverse_profile(profile, duration) if backwards else profile
            passes, self.obstacle = self._passes(ramp, duration)
            if passes:
                yield ramp, duration

    def plan_transfer(
        self, begin: Array, end: Array, known: Array
    ) -> tuple[list[tuple[JerkProfile, float]], str]:
        """From rest to rest, straight in joint space or through poses at rest; and what forbids it where it is empty.

        known: poses that are clear. Shape (m, n). The shortest way over them is tried, leg by leg, and one that fails is
        not taken again (a lazy roadmap; Bohlin & Kavraki 2000).
        """
        direct, reason = self._leg(begin, end)
        if direct is not None:
            return [direct], ""
        from scipy.sparse import csgraph  # rarely needed

        poses = np.vstack([begin, end, self._open(known)])
        length = np.abs((poses[:, None] - poses[None]) / self.constraints.limits.velocity).max(axis=2)
        cost = length + 0.2 * float(np.median(length))  # every stop costs
        cost[0, 1] = cost[1, 0] = np.inf
        legs: dict[tuple[int, int], tuple[JerkProfile, float]] = {}
        for _ in range(MAX_ROADMAP_SEARCHES):
            total, before = csgraph.dijkstra(cost, indices=0, return_predecessors=True)
            if not np.isfinite(total[1]):
                break
            way = [1]
            while way[-1] != 0:
                way.append(int(before[way[-1]]))
            pairs = list(zip(way[:0:-1], way[-2::-1], strict=True))
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

    def _open(self, known: Array) -> Array:
        """Poses to go through: known ones, and others that fill the joint ranges, as far as they are clear. Shape (m, n)."""
        poses = np.vstack([known, spread_poses(self.constraints.limits, VIA_POSE_COUNT)])
        clearance = self.constraints.clearance
        return poses if clearance is None else poses[clearance.least(poses)[0] >= EXTRA_CLEARANCE]

    def _leg(self, begin: Array, end: Array) -> tuple[tuple[JerkProfile, float] | None, str]:
        # Ruckig's way is not straight, but near enough to spare it the hopeless ones
        reason = self.clearance_violation(begin + np.linspace(0.0, 1.0, POSES_PER_LINE)[:, None] * (end - begin))
        if reason:
            return None, reason
        reason = "the velocity limits"
        for scale in TRANSFER_SCALES:
            profile = self._plan(JointState.rest(begin), end, scale)
            if profile is None:
                continue
            passes, reason = self._passes(profile, _duration(profile, self.grid))
            if passes:
                return (profile, _duration(profile, self.grid)), ""
        return None, reason


def _duration(profile: JerkProfile, grid: float) -> float:
    longest = max(sum(d for d, _ in pieces) for pieces in profile.pieces)
    return max(round(longest / grid), 1) * grid


def _profile(begin: JointState, found: ruckig.Trajectory) -> JerkProfile:
    """Ruckig's profile as pieces of constant jerk."""
    rows = []
    for joint in found.profiles[0]:
        pieces = [
            *zip(joint.brake.t, joint.brake.j, strict=True),
            *zip(joint.t, joint.j, strict=True),
        ]
        rows.append(tuple((float(d), float(j)) for d, j in pieces if d > 0.0))
    return JerkProfile(
        np.array(begin.q, float), np.array(begin.dq, float), np.array(begin.ddq, float), tuple(rows)
    )


def reverse_profile(profile: JerkProfile, duration: float) -> JerkProfile:
    """The same path run backwards in time: r(t) = p(duration − t)."""
    end = np.array([duration])
    rows = []
    for pieces in profile.pieces:
        rest = duration - sum(d for d, _ in pieces)
        padded = [*pieces, (rest, 0.0)] if rest > 1e-12 else list(pieces)
        rows.append(tuple((d, -j) for d, j in reversed(padded)))
    return JerkProfile(profile.at(end)[0], -profile.at(end, 1)[0], profile.at(end, 2)[0], tuple(rows))


def plan_rest_to_rest(
    subject: MotionConstraints, fourier: FourierSeries, periods: int, rate: float, start: Array | None = None
) -> Motion:
    """The whole motion around `fourier`, which may begin at another phase than it was given with.

    subject: its limits must state accelerations and jerks (`with_derived`), less the margin to keep free.
    start: pose to begin and end at, at rest; None: where the ramp-in begins.
    Raises Infeasible when no ramp obeys the limits, UnusableInput when `start` breaks one.
    """
    planner = RampPlanner(subject, rate)
    shifted, ramp_in, ramp_out = _ramps(planner, fourier, start)
    ready = ramp_in[0].position
    halt = ramp_out[0].at(np.array([ramp_out[1]]))[0]
    home = ready if start is None else start
    known = shifted.at(shifted.grid(PHASE_COUNT))
    approach = [] if start is None else _connect(planner, home, ready, known, "approach")
    back = _connect(planner, halt, home, known, "return")
    parts: list[tuple[str, JerkProfile | None, float]] = [("approach", *leg) for leg in approach]
    parts += [
        ("ramp_in", *ramp_in),
        ("fourier", None, periods * fourier.period),
        ("ramp_out", *ramp_out),
    ]
    parts += [("return", *leg) for leg in back]
    segments, ticks = [], 0
    for kind, profile, duration in parts:
        begin, ticks = ticks, ticks + round(duration * rate)
        segments.append(MotionSegment(kind, begin / rate, ticks / rate, profile))
    return Motion(subject.robot.joints, shifted, periods, tuple(segments))


def _connect(
    planner: RampPlanner, begin: Array, end: Array, known: Array, what: str
) -> list[tuple[JerkProfile, float]]:
    if np.abs(begin - end).max() < 1e-12:
        return []
    legs, reason = planner.plan_transfer(begin, end, known)
    if not legs:
        robot = planner.constraints.robot
        raise Infeasible(
            f"{robot.source}: no {what} keeps {reason}; give another --start pose, widen them or clear the way"
        )
    return legs


def _ramps(
    planner: RampPlanner, fourier: FourierSeries, start: Array | None
) -> tuple[FourierSeries, tuple[JerkProfile, float], tuple[JerkProfile, float]]:
    """The phase at which ramping in and out is shortest among the slow ones, and both ramps there."""
    if start is not None:
        check_start_pose(planner.constraints, start)
    times = fourier.grid(PHASE_COUNT)
    brisk = np.abs(fourier.at(times, 1) / planner.constraints.limits.velocity).max(axis=1)
    best: tuple[float, FourierSeries, tuple[JerkProfile, float], tuple[JerkProfile, float]] | None = None
    for tried, index in enumerate(np.argsort(brisk)):
        shifted = fourier.shifted(float(times[index]))
        zero = np.zeros(1)
        state = JointState(*(shifted.at(zero, order)[0] for order in range(3)))
        out = next(planner.stop(state), None)
        into = next(planner.stop(state, backwards=True), None) if out is not None else None
        if out is not None and into is not None and (best is None or out[1] + into[1] < best[0]):
            best = (out[1] + into[1], shifted, into, out)
        if best is not None and tried >= 5:
            break
    if best is None:
        source = planner.constraints.robot.source
        raise Infeasible(
            f"{source}: no ramp into the periodic motion keeps {planner.obstacle}; "
            "try another --seed, lower --uncertainty or lengthen --period"
        )
    return best[1], best[2], best[3]


def check_start_pose(subject: MotionConstraints, start: Array) -> None:
    """Raise UnusableInput where a start pose cannot be held, or touches something."""
    robot, limits = subject.robot, subject.limits
    if start.shape != (robot.n,) or not np.isfinite(start).all():
        raise UnusableInput(
            f"{robot.source}: start pose: should be {robot.n} finite positions, one per joint"
        )
    outside = (start < limits.position[:, 0]) | (start > limits.position[:, 1])
    if outside.any():
        j = int(np.argmax(outside))
        low, high = limits.position[j]
        raise UnusableInput(
            f"{robot.source}: start pose: joint '{robot.joints[j]}' at {start[j]:g} is outside [{low:g}, {high:g}]; move it inside"
        )
    if subject.clearance is not None:
        room, pair = subject.clearance.least(start[None])
        if room[0] < EXTRA_CLEARANCE:
            near, k = 1e3 * (room[0] + subject.clearance.need[pair[0]]), pair[0]
            state = (
                f"{near:.0f} mm apart, {1e3 * subject.clearance.need[k]:.0f} mm to keep"
                if near > 0.0
                else "in each other"
            )
            raise UnusableInput(
                f"{robot.source}: start pose: {subject.clearance.names[k]} are {state}; give another --start or clear the scene"
            )
    still = np.tile(start, (3, 1))
    for demand in constraint_margins.model_quantities(
        subject, Samples(still, np.zeros_like(still), np.zeros_like(still))
    ):
        if demand.largest_ratio() > 1.0:
            raise UnusableInput(
                f"{robot.source}: start pose: breaks the {demand.limit} limits at rest; give another --start pose"
            )
