"""A whole motion from rest to rest: approach, ramp-in, whole Fourier periods, ramp-out, return."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import UnusableInput
from ..robot.samples import Samples
from ..schemas.trajectory import SegmentDocument
from .fourier import FourierSeries

Array = np.ndarray


@dataclass(frozen=True)
class JerkProfile:
    """Joint motions of piecewise constant jerk, replayable without the planner that found them.

    position, velocity, acceleration: the state at the start. Shape (n,).
    pieces: per joint, (duration [s], jerk [rad/s³]) one after the other; after the last the acceleration stays.
    """

    position: Array
    velocity: Array
    acceleration: Array
    pieces: tuple[tuple[tuple[float, float], ...], ...]

    def at(self, t: Array, order: int = 0) -> Array:
        """The order-th derivative at times t ≥ 0 since the start. Shape (len(t), n)."""
        t = np.asarray(t, float)
        out = np.empty((len(t), len(self.position)))
        for j, pieces in enumerate(self.pieces):
            knots, states = self._states(j, pieces)
            index = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 1)
            q, v, a, jerk = states[index].T
            s = t - knots[index]
            out[:, j] = (
                q + s * (v + s * (a / 2 + s * jerk / 6)),
                v + s * (a + s * jerk / 2),
                a + s * jerk,
                jerk,
            )[order]
        return out

    def _states(self, joint: int, pieces: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
        """Knot times and (position, velocity, acceleration, jerk) at each."""
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

    def knots(self) -> Array:
        """All times at which some joint's jerk changes [s]."""
        return np.unique(np.concatenate([self._states(j, p)[0] for j, p in enumerate(self.pieces)]))

    def critical_times(self, length: float) -> Array:
        """Every time in [0, length] at which a derivative of some joint up to the third can be extreme [s].

        These are both ends, the knots, and on each cubic the roots of its acceleration and of its velocity: position, velocity and
        acceleration over [0, length] are bounded exactly by their values there, and jerk is constant between them.
        """
        times = [np.array([0.0, length])]
        for joint, pieces in enumerate(self.pieces):
            knots, states = self._states(joint, pieces)
            _, v, a, jerk = states.T
            duration = np.diff(np.append(knots, max(length, knots[-1])))
            for root in (_ratio(-a, jerk), *_quadratic_roots(0.5 * jerk, a, v)):
                inside = (root > 0.0) & (root < duration)
                times.append(knots[inside] + root[inside])
            times.append(knots)
        every = np.unique(np.concatenate(times))
        return every[(every >= 0.0) & (every <= length)]


def _ratio(numerator: Array, denominator: Array) -> Array:
    """Quotients; NaN where the denominator vanishes, which no comparison accepts as a root."""
    return np.divide(
        numerator, denominator, out=np.full_like(numerator, np.nan), where=denominator != 0.0
    )


def _quadratic_roots(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Real roots of a x² + b x + c, element by element and without cancellation; NaN where there is none."""
    discriminant = b * b - 4.0 * a * c
    root = np.sqrt(np.where(discriminant >= 0.0, discriminant, np.nan))
    half = -0.5 * (b + np.where(b >= 0.0, root, -root))
    return _ratio(half, a), _ratio(c, half)


@dataclass(frozen=True)
class MotionSegment:
    """One part of a motion, from `start` to `end` [s]; its profile, or None for the Fourier part."""

    kind: str
    start: float
    end: float
    profile: JerkProfile | None = None


@dataclass(frozen=True)
class Motion:
    """Segments in order of time; the Fourier part repeats `periods` times."""

    joints: tuple[str, ...]
    fourier: FourierSeries
    periods: int
    segments: tuple[MotionSegment, ...]

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return self.segments[-1].end

    @property
    def end_poses(self) -> tuple[Array, Array]:
        """Poses at the beginning and at the end. Shapes (n,)."""
        first, last = self.segments[0], self.segments[-1]
        begin = self.fourier.at(np.zeros(1))[0] if first.profile is None else first.profile.position
        if last.profile is None:
            return begin, self.fourier.at(np.zeros(1))[0]
        return begin, last.profile.at(np.array([last.end - last.start]))[0]

    def segment(self, kind: str) -> MotionSegment:
        """The segment of that kind; KeyError where the motion has none."""
        for segment in self.segments:
            if segment.kind == kind:
                return segment
        raise KeyError(kind)

    def at(self, t: Array, order: int = 0) -> Array:
        """The order-th derivative at times t; outside [0, duration] the motion rests. Shape (len(t), n)."""
        t = np.asarray(t, float)
        begin, end = self.end_poses
        out = (
            np.where((t <= self.duration / 2)[:, None], begin, end)
            if order == 0
            else np.zeros((len(t), len(begin)))
        )
        inside = (t > 1e-9) & (t < self.duration - 1e-9)
        for segment in self.segments:
            # a joint of two segments belongs to the later one, the end to the last
            here = inside & (t >= segment.start - 1e-12) & (t <= segment.end)
            if not here.any():
                continue
            local = np.maximum(t[here] - segment.start, 0.0)
            out[here] = (
                self.fourier.at(local, order)
                if segment.profile is None
                else segment.profile.at(local, order)
            )
        return out

    def samples(self, t: Array) -> Samples:
        """Position, velocity and acceleration at times t."""
        return Samples(self.at(t), self.at(t, 1), self.at(t, 2))

    def grid(self, rate: float) -> Array:
        """Times k/rate from 0 to the first at or after the end [s]; the last row is at rest."""
        return np.arange(int(np.ceil(self.duration * rate - 1e-6)) + 1) / rate

    def slowed(self, speed: float) -> Motion:
        """The same path at `speed` times the speed (a first, careful run)."""
        if not 0.0 < speed <= 1.0:
            raise UnusableInput(f"--speed {speed:g} should be above 0 and at most 1")
        parts = []
        for s in self.segments:
            profile = None
            if s.profile is not None:
                pieces = tuple(
                    tuple((d / speed, j * speed**3) for d, j in row) for row in s.profile.pieces
                )
                profile = JerkProfile(
                    s.profile.position,
                    s.profile.velocity * speed,
                    s.profile.acceleration * speed**2,
                    pieces,
                )
            parts.append(MotionSegment(s.kind, s.start / speed, s.end / speed, profile))
        return Motion(self.joints, self.fourier.slowed(speed), self.periods, tuple(parts))


def segments_to_document(motion: Motion) -> list[dict[str, Any]]:
    """The segments as `trajectory.json` holds them."""
    out: list[dict[str, Any]] = []
    for s in motion.segments:
        entry: dict[str, Any] = {"kind": s.kind, "start": s.start, "end": s.end}
        if s.profile is not None:
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
    document: Sequence[SegmentDocument], joints: tuple[str, ...]
) -> tuple[MotionSegment, ...]:
    """The inverse of `segment_document`."""
    out = []
    for entry in document:
        profile, stated = None, entry.profile
        if stated is not None:
            pieces = tuple(
                tuple((float(d), float(j)) for d, j in stated.pieces[joint]) for joint in joints
            )
            state = [
                np.array(values, float)
                for values in (stated.position, stated.velocity, stated.acceleration)
            ]
            profile = JerkProfile(state[0], state[1], state[2], pieces)
        out.append(MotionSegment(entry.kind, float(entry.start), float(entry.end), profile))
    return tuple(out)
