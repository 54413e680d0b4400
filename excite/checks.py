"""How near a motion comes to every limit, by Pinocchio, including what can happen between its samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import dynamics
from .collision.clearance import Clearance
from .limits import Braking, Limits
from .parameters import COULOMB_WIDTH, Parameters
from .problem import Box
from .robot import Robot
from .trajectory import Samples

Array = np.ndarray


@dataclass(frozen=True)
class Subject:
    """What a motion is held against: a robot, its limits, how uncertain its parameters are, and what it must not touch."""

    robot: Robot
    limits: Limits
    parameters: Parameters
    uncertainty: float = 0.0
    boxes: tuple[Box, ...] = ()
    clearance: Clearance | None = None


@dataclass(frozen=True)
class Demand:
    """A quantity that a limit bounds, over N samples of m joints (or axes): lower ≤ value ≤ upper.

    low, high: what the motion reaches, between samples too. Shape (N, m). names: of the m columns.
    """

    limit: str
    names: tuple[str, ...]
    low: Array
    high: Array
    lower: Array
    upper: Array

    def ratio(self) -> float:
        """The largest distance from the middle of the range over its half width; ≤ 1 inside."""
        bounded = np.isfinite(self.upper - self.lower)
        if not bounded.any():
            return 0.0
        lower, upper = self.lower[bounded], self.upper[bounded]
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        return float((np.maximum(self.high[:, bounded] - middle, middle - self.low[:, bounded]) / half).max())


def excess(values: Array) -> Array:
    """How far a function may rise between equispaced samples: half the larger neighbouring second difference.

    Proven for piecewise linear functions with at most one kink between two samples, where h·Δslope·α(1−α) is
    the worst; four times what a smooth function needs (h²/8 |f″|). Shape (N, m) -> (N, m), per sample.
    """
    if len(values) < 3:
        return np.zeros_like(values)
    second = np.abs(np.diff(values, 2, axis=0))
    second = np.vstack([second[:1], second, second[-1:]])
    near = second.copy()
    near[1:] = np.maximum(near[1:], second[:-1])
    near[:-1] = np.maximum(near[:-1], second[1:])
    return 0.5 * near


def torque(subject: Subject, motion: Samples) -> Demand:
    """Torque of every robot in the uncertain ball, equispaced samples.

    Coulomb friction jumps at a reversal, between two samples; it is monotone in speed, so its bounds are those of its
    neighbours, and only the smooth rest is given room for its curvature.
    """
    Y = dynamics.regressor(subject.robot, subject.parameters, motion)
    nominal, width = dynamics.band(Y, subject.parameters, subject.uncertainty)
    friction = subject.parameters.coulomb()
    smooth = nominal - friction * np.tanh(motion.dq / COULOMB_WIDTH)
    doubt = excess(motion.dq)
    most = _neighbours(friction * np.tanh((motion.dq + doubt) / COULOMB_WIDTH), np.maximum)
    least = _neighbours(friction * np.tanh((motion.dq - doubt) / COULOMB_WIDTH), np.minimum)
    high, low = smooth + width, smooth - width
    high, low = high + excess(high) + most, low - excess(low) + least
    bound = subject.limits.torque
    return Demand("torque", subject.robot.joints, low, high, -bound, bound)


def _neighbours(values: Array, pick: np.ufunc) -> Array:
    """The largest or smallest of each sample and the ones beside it."""
    out = values.copy()
    out[1:] = pick(out[1:], values[:-1])
    out[:-1] = pick(out[:-1], values[1:])
    return out


def braking(subject: Subject, motion: Samples) -> Demand | None:
    """Velocity limits that fall towards a stop, as (s q̇ + c)₊²/rate + s q ≤ s stop; None where there are none."""
    at = [j for j, brake in enumerate(subject.limits.braking) if brake is not None]
    if not at:
        return None
    brakes: list[Braking] = [b for b in subject.limits.braking if b is not None]
    offset, rate = np.array([b.offset for b in brakes]), np.array([b.rate for b in brakes])
    q, dq = motion.q[:, at], motion.dq[:, at]
    high = q + np.maximum(dq + offset, 0.0) ** 2 / rate
    low = q - np.maximum(-dq + offset, 0.0) ** 2 / rate
    stops = np.array([b.stop for b in brakes])
    names = tuple(subject.robot.joints[j] for j in at)
    return Demand("braking", names, low - excess(low), high + excess(high), stops[:, 0], stops[:, 1])


def boxes(subject: Subject, motion: Samples) -> list[Demand]:
    """Cartesian boxes around frames."""
    out = []
    for box in subject.boxes:
        p = dynamics.positions(subject.robot, box.frame, motion.q)
        names = tuple(f"{box.frame}.{axis}" for axis in "xyz")
        out.append(Demand("box", names, p - excess(p), p + excess(p), np.array(box.lower), np.array(box.upper)))
    return out


def symmetric(limit: str, subject: Subject, low: Array, high: Array) -> Demand:
    """A joint quantity against the limit of that name."""
    bounds = getattr(subject.limits, limit)
    lower, upper = (bounds[:, 0], bounds[:, 1]) if limit == "position" else (-bounds, bounds)
    return Demand(limit, subject.robot.joints, low, high, lower, upper)


def loads(subject: Subject, motion: Samples) -> list[Demand]:
    """All demands that need the robot's model: torque, braking, boxes."""
    brake = braking(subject, motion)
    return [torque(subject, motion), *([] if brake is None else [brake]), *boxes(subject, motion)]
