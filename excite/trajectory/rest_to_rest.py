"""Complete motions from rest to rest: approach, ramp-in, Fourier periods, ramp-out, return.

Ramps have piecewise constant jerk in joint space, or follow the path of the periodic motion with a
phase that accelerates from standstill.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.samples import Samples
from ..schemas.trajectory import SegmentDocument
from .fourier import FourierSeries

TIME_TOLERANCE = 1e-9
"""Times closer than this to the start or the end of a motion are at rest [s]."""
SEGMENT_START_TOLERANCE = 1e-12
"""Rounding error of the start of a segment [s]: a time up to this much earlier belongs to it."""
GRID_TOLERANCE = 1e-6
"""Share of a sampling interval by which the last sample may precede the end of a motion [1]."""


@dataclass(frozen=True)
class JerkProfile:
    """Joint motion of piecewise constant jerk, replayable without the planner that made it.

    Units are those of revolute joints; read m in place of rad for a prismatic joint.

    Attributes:
        position: Positions at the start. Shape (n,) [rad or m].
        velocity: Velocities at the start. Shape (n,) [rad/s or m/s].
        acceleration: Accelerations at the start. Shape (n,) [rad/s² or m/s²].
        pieces: For each joint its consecutive pieces (duration [s], jerk [rad/s³ or m/s³]). The
            acceleration stays constant after the last piece.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    pieces: tuple[tuple[tuple[float, float], ...], ...]

    def at(self, t: float | FloatArray, order: int = 0) -> FloatArray:
        """Evaluate the motion or one of its time derivatives.

        Args:
            t: Times since the start, not negative [s]. Shape () or (N,).
            order: Order of the derivative, 0 to 3.

        Returns:
            Positions [rad or m] or derivatives [rad/s^order or m/s^order]. Shape (n,) or (N, n).
        """
        times = np.atleast_1d(np.asarray(t, float))
        out = np.empty((len(times), len(self.position)))
        for j, pieces in enumerate(self.pieces):
            knots, states = self._states(j, pieces)
            index = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 1)
            q, v, a, jerk = states[index].T
            s = times - knots[index]
            out[:, j] = (
                q + s * (v + s * (a / 2 + s * jerk / 6)),
                v + s * (a + s * jerk / 2),
                a + s * jerk,
                jerk,
            )[order]
        return out[0] if np.ndim(t) == 0 else out

    def _states(
        self, joint: int, pieces: Sequence[tuple[float, float]]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the knots of a joint and (position, velocity, acceleration, jerk) at each."""
        q, v, a = self.position[joint], self.velocity[joint], self.acceleration[joint]
        time, knots, states = 0.0, [], []
        for duration, jerk in pieces:
            knots.append(time)
            states.append((q, v, a, jerk))
            q += duration * (v + duration * (a / 2 + duration * jerk / 6))
            v += duration * (a + duration * jerk / 2)
            a += duration * jerk
            time += duration
        knots.append(time)
        states.append((q, v, a, 0.0))
        return np.array(knots), np.array(states)

    def knots(self) -> FloatArray:
        """Return all times at which the jerk of any joint changes [s]."""
        return np.unique(np.concatenate([self._states(j, p)[0] for j, p in enumerate(self.pieces)]))

    def max_acceleration(self, duration: float) -> FloatArray:
        """Return the largest acceleration of each joint from the start to a time, exactly.

        The acceleration is linear between knots, hence extreme at knots and at both ends.

        Args:
            duration: Duration that is considered, from the start [s].

        Returns:
            Largest absolute values. Shape (n,) [rad/s² or m/s²].
        """
        knots = self.knots()
        times = np.append(knots[knots < duration], duration)
        return np.abs(self.at(times, 2)).max(axis=0)

    def slowed(self, speed: float) -> JerkProfile:
        """Return the same path at `speed` times the speed [1]."""
        pieces = tuple(tuple((d / speed, j * speed**3) for d, j in row) for row in self.pieces)
        return JerkProfile(
            self.position, self.velocity * speed, self.acceleration * speed**2, pieces
        )

    def critical_times(self, duration: float) -> FloatArray:
        """Return all times at which position, velocity, acceleration or jerk can be extreme.

        These are both ends, the knots, and on each cubic the roots of its acceleration and of its
        velocity. Position, velocity and acceleration over [0, duration] are bounded exactly by
        their values at these times, and jerk is constant between them.

        Args:
            duration: Duration that is considered, from the start [s].

        Returns:
            Ascending times in [0, duration] [s].
        """
        times = [np.array([0.0, duration])]
        for joint, pieces in enumerate(self.pieces):
            knots, states = self._states(joint, pieces)
            _, v, a, jerk = states.T
            lengths = np.diff(np.append(knots, max(duration, knots[-1])))
            for root in (_ratio(-a, jerk), *_quadratic_roots(0.5 * jerk, a, v)):
                inside = (root > 0.0) & (root < lengths)
                times.append(knots[inside] + root[inside])
            times.append(knots)
        candidates = np.unique(np.concatenate(times))
        return candidates[(candidates >= 0.0) & (candidates <= duration)]


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Divide element by element; NaN where the denominator is 0, so that it is not a root."""
    return np.divide(
        numerator, denominator, out=np.full_like(numerator, np.nan), where=denominator != 0.0
    )


def _quadratic_roots(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the real roots of a x² + b x + c without cancellation, NaN where there are none."""
    discriminant = b * b - 4.0 * a * c
    root = np.sqrt(np.where(discriminant >= 0.0, discriminant, np.nan))
    half = -0.5 * (b + np.where(b >= 0.0, root, -root))
    return _ratio(half, a), _ratio(c, half)


@dataclass(frozen=True)
class PhaseProfile:
    """Part of a periodic motion f played at a varying rate: q(t) = f(σ(t)).

    A ramp of this form stays on the path of the periodic motion, so that position limits, boxes
    and clearances that hold along the path hold on the ramp.

    Attributes:
        fourier: Periodic motion f.
        phase: Phase σ as a profile of one coordinate, piecewise cubic in time [s].
    """

    fourier: FourierSeries
    phase: JerkProfile

    @property
    def position(self) -> FloatArray:
        """Positions at the start. Shape (n,) [rad or m]."""
        return self.at(np.zeros(1))[0]

    def at(self, t: float | FloatArray, order: int = 0) -> FloatArray:
        """Evaluate the motion or one of its time derivatives, by the chain rule.

        Args:
            t: Times since the start, not negative [s]. Shape () or (N,).
            order: Order of the derivative, 0 to 3.

        Returns:
            Positions [rad or m] or derivatives [rad/s^order or m/s^order]. Shape (n,) or (N, n).
        """
        times = np.atleast_1d(np.asarray(t, float))
        phase, *rates = (self.phase.at(times, k) for k in range(order + 1))
        f = [self.fourier.at(phase[:, 0], k) for k in range(order + 1)]
        out = _chain_rule(f, rates, order)
        return out[0] if np.ndim(t) == 0 else out

    def knots(self) -> FloatArray:
        """Return all times at which the third derivative of the phase changes [s]."""
        return self.phase.knots()

    def max_acceleration(self, duration: float) -> FloatArray:
        """Return an upper bound of the acceleration of each joint from the start to a time.

        It is not exact, unlike that of a `JerkProfile`; see `derivative_bound`.

        Args:
            duration: Duration that is considered, from the start [s].

        Returns:
            Upper bounds of the absolute values. Shape (n,) [rad/s² or m/s²].
        """
        return self.derivative_bound(2, duration)

    def derivative_bound(self, order: int, duration: float) -> FloatArray:
        """Return an upper bound of a time derivative of each joint from the start to a time.

        The chain rule is evaluated with the largest absolute values of all factors.

        Args:
            order: Order of the derivative, 1 to 5.
            duration: Duration that is considered, from the start [s].

        Returns:
            Upper bounds of the absolute values. Shape (n,) [rad/s^order or m/s^order].
        """
        times = self.phase.critical_times(duration)
        middle = 0.5 * (times[:-1] + times[1:])
        rates = [np.abs(self.phase.at(times, k)).max(axis=0) for k in (1, 2)]
        rates.append(np.abs(self.phase.at(middle, 3)).max(axis=0))
        peaks = [np.zeros(self.fourier.n), *(self.fourier.peak(k) for k in range(1, order + 1))]
        return _chain_rule(peaks, rates, order)

    def slowed(self, speed: float) -> PhaseProfile:
        """Return the same path at `speed` times the speed [1]."""
        p = self.phase
        # σ counts the time of the periodic motion, which is slowed as well: σ'(t) = σ(s t)/s
        pieces = tuple(tuple((d / speed, j * speed**2) for d, j in row) for row in p.pieces)
        phase = JerkProfile(p.position / speed, p.velocity, p.acceleration * speed, pieces)
        return PhaseProfile(self.fourier.slowed(speed), phase)


def _chain_rule(f: Sequence[FloatArray], rates: Sequence[FloatArray], order: int) -> FloatArray:
    """Return a derivative of f(σ(t)) by t, for a phase σ that is cubic (Faà di Bruno).

    Args:
        f: Derivatives of f by σ, of order 0 to `order`.
        rates: Derivatives of σ by t, of order 1 to min(order, 3).
        order: Order of the derivative, 0 to 5.
    """
    if order == 0:
        return f[0]
    a = rates[0]
    if order == 1:
        return f[1] * a
    b = rates[1]
    if order == 2:
        return f[2] * a**2 + f[1] * b
    c = rates[2]
    if order == 3:
        return f[3] * a**3 + 3.0 * f[2] * a * b + f[1] * c
    if order == 4:
        return f[4] * a**4 + 6.0 * f[3] * a**2 * b + f[2] * (3.0 * b**2 + 4.0 * a * c)
    return (
        f[5] * a**5
        + 10.0 * f[4] * a**3 * b
        + f[3] * (15.0 * a * b**2 + 10.0 * a**2 * c)
        + 10.0 * f[2] * b * c
    )


Profile = JerkProfile | PhaseProfile
"""Motion of a segment other than the Fourier part."""


class SegmentKind(StrEnum):
    """Kinds of the parts of a motion, in their order."""

    APPROACH = "approach"
    RAMP_IN = "ramp_in"
    FOURIER = "fourier"
    RAMP_OUT = "ramp_out"
    RETURN = "return"


@dataclass(frozen=True)
class MotionSegment:
    """Part of a motion.

    Attributes:
        kind: Kind of the part.
        start: Time at which it starts [s].
        end: Time at which it ends [s].
        profile: Its motion in time since `start`; None for the Fourier part.
    """

    kind: SegmentKind
    start: float
    end: float
    profile: Profile | None = None


@dataclass(frozen=True)
class Motion:
    """Complete motion from rest to rest.

    Attributes:
        joints: Names of the n joints.
        fourier: Periodic part.
        periods: Number of periods of the periodic part.
        segments: Consecutive parts in order of time.
    """

    joints: tuple[str, ...]
    fourier: FourierSeries
    periods: int
    segments: tuple[MotionSegment, ...]

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return self.segments[-1].end

    @property
    def end_poses(self) -> tuple[FloatArray, FloatArray]:
        """Poses at the start and at the end. Shape (n,) each [rad or m]."""
        first, last = self.segments[0], self.segments[-1]
        begin = self.fourier.at(np.zeros(1))[0] if first.profile is None else first.profile.position
        if last.profile is None:
            return begin, self.fourier.at(np.zeros(1))[0]
        return begin, last.profile.at(np.array([last.end - last.start]))[0]

    def segment(self, kind: SegmentKind) -> MotionSegment:
        """Return the first segment of a kind.

        Raises:
            KeyError: The motion has no segment of this kind.
        """
        for segment in self.segments:
            if segment.kind == kind:
                return segment
        raise KeyError(kind)

    def at(self, t: float | FloatArray, order: int = 0) -> FloatArray:
        """Evaluate the motion or one of its time derivatives; outside [0, duration] it rests.

        Args:
            t: Times [s]. Shape () or (N,).
            order: Order of the derivative, 0 to 3.

        Returns:
            Positions [rad or m] or derivatives [rad/s^order or m/s^order]. Shape (n,) or (N, n).
        """
        times = np.atleast_1d(np.asarray(t, float))
        begin, end = self.end_poses
        out = (
            np.where((times <= self.duration / 2)[:, None], begin, end)
            if order == 0
            else np.zeros((len(times), len(begin)))
        )
        inside = (times > TIME_TOLERANCE) & (times < self.duration - TIME_TOLERANCE)
        for segment in self.segments:
            # where two segments meet the later one is evaluated, at the very end the last one
            here = (
                inside & (times >= segment.start - SEGMENT_START_TOLERANCE) & (times <= segment.end)
            )
            if not here.any():
                continue
            local = np.maximum(times[here] - segment.start, 0.0)
            out[here] = (
                self.fourier.at(local, order)
                if segment.profile is None
                else segment.profile.at(local, order)
            )
        return out[0] if np.ndim(t) == 0 else out

    def samples(self, t: FloatArray) -> Samples:
        """Return position, velocity and acceleration at times `t` [s]. Shape of `t`: (N,)."""
        return Samples(self.at(t), self.at(t, 1), self.at(t, 2))

    def grid(self, rate: float) -> FloatArray:
        """Return the times k/rate from 0 to the first one at or after the end [s].

        Args:
            rate: Samples per second [Hz].
        """
        return np.arange(int(np.ceil(self.duration * rate - GRID_TOLERANCE)) + 1) / rate

    def slowed(self, speed: float) -> Motion:
        """Return the same path at a lower speed, as for a first careful run.

        Args:
            speed: Share of the speed, above 0 and at most 1 [1].

        Raises:
            UnusableInput: `speed` is outside its range.
        """
        if not 0.0 < speed <= 1.0:
            raise UnusableInput(f"--speed {speed:g} should be above 0 and at most 1")
        if speed == 1.0:
            return self
        parts = [
            MotionSegment(
                s.kind,
                s.start / speed,
                s.end / speed,
                None if s.profile is None else s.profile.slowed(speed),
            )
            for s in self.segments
        ]
        return Motion(self.joints, self.fourier.slowed(speed), self.periods, tuple(parts))


def segments_to_document(motion: Motion) -> list[dict[str, Any]]:
    """Return the segments of a motion as `trajectory.json` holds them."""
    out: list[dict[str, Any]] = []
    for s in motion.segments:
        entry: dict[str, Any] = {"kind": str(s.kind), "start": s.start, "end": s.end}
        if isinstance(s.profile, PhaseProfile):
            phase = s.profile.phase
            entry["phase"] = {
                "start": float(phase.position[0]),
                "rate": float(phase.velocity[0]),
                "acceleration": float(phase.acceleration[0]),
                "pieces": [list(p) for p in phase.pieces[0]],
            }
        elif s.profile is not None:
            entry["profile"] = {
                "position": s.profile.position.tolist(),
                "velocity": s.profile.velocity.tolist(),
                "acceleration": s.profile.acceleration.tolist(),
                "pieces": {
                    joint: [list(p) for p in pieces]
                    for joint, pieces in zip(motion.joints, s.profile.pieces, strict=True)
                },
            }
        out.append(entry)
    return out


def segments_from_document(
    document: Sequence[SegmentDocument], joints: tuple[str, ...], fourier: FourierSeries
) -> tuple[MotionSegment, ...]:
    """Return the segments of a validated `trajectory.json`; inverse of `segments_to_document`.

    Args:
        document: Entries of the key `segments`.
        joints: Names of the joints, in the order of the motion.
        fourier: Periodic motion, which phase ramps follow.
    """
    out = []
    for entry in document:
        profile: Profile | None = None
        stated, phase = entry.profile, entry.phase
        if phase is not None:
            start, rate, acceleration = (
                np.array([value], float) for value in (phase.start, phase.rate, phase.acceleration)
            )
            row = tuple((float(d), float(j)) for d, j in phase.pieces)
            profile = PhaseProfile(fourier, JerkProfile(start, rate, acceleration, (row,)))
        elif stated is not None:
            pieces = tuple(
                tuple((float(d), float(j)) for d, j in stated.pieces[joint]) for joint in joints
            )
            state = [
                np.array(values, float)
                for values in (stated.position, stated.velocity, stated.acceleration)
            ]
            profile = JerkProfile(state[0], state[1], state[2], pieces)
        out.append(
            MotionSegment(SegmentKind(entry.kind), float(entry.start), float(entry.end), profile)
        )
    return tuple(out)
