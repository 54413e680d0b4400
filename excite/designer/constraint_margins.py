"""Constrained quantities along a motion, by Pinocchio, bounded between its samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray
from ..collision.clearance_constraint import ClearanceConstraint
from ..robot import dynamics
from ..robot.inertial_parameters import COULOMB_WIDTH, Parameters
from ..robot.limits import Braking, Limits
from ..robot.robot import Robot
from ..robot.samples import Samples
from ..trajectory.fourier import VERIFICATION_DENSITY
from ..trajectory.rest_to_rest import PhaseProfile
from . import stand_load
from .options import WorkspaceBox

MIN_STEPS_PER_PIECE = 4
"""Least number of steps over one cubic of a ramp for quantities without a closed form [1]."""

STAND = "stand load"
"""Name of the load on the stand among the kinds of limits."""

KNOT_INSET = 1e-12
"""Distance of the samples from the knots of a phase over the length of a piece [1], as the jerk
jumps there; it is below the rounding of the bounds."""


@dataclass(frozen=True)
class MotionConstraints:
    """Constraints on the motion of a robot.

    Attributes:
        robot: The robot.
        limits: Its limits.
        parameters: Its standard parameters.
        uncertainty: Radius of the ellipsoid of parameters for which torque limits hold [1].
        boxes: Boxes that frames have to stay in.
        clearance: Bodies that have to keep their distance, None where distances are not checked.
    """

    robot: Robot
    limits: Limits
    parameters: Parameters
    uncertainty: float = 0.0
    boxes: tuple[WorkspaceBox, ...] = ()
    clearance: ClearanceConstraint | None = None


@dataclass(frozen=True)
class BoundedQuantity:
    """Quantity that a limit bounds: lower ≤ value ≤ upper, over N samples of m joints or axes.

    Attributes:
        limit: Kind of the limit.
        names: Names of the m joints or axes.
        low: Least value that the motion reaches, also between samples. Shape (N, m).
        high: Largest value that the motion reaches, also between samples. Shape (N, m).
        lower: Lower bounds, infinite without. Shape (m,).
        upper: Upper bounds, infinite without. Shape (m,).
    """

    limit: str
    names: tuple[str, ...]
    low: FloatArray
    high: FloatArray
    lower: FloatArray
    upper: FloatArray

    def largest_ratio(self) -> float:
        """Return the largest distance from the middle of the range over its half width.

        It is at most 1 where the limit is kept.
        """
        bounded = np.isfinite(self.upper - self.lower)
        if not bounded.any():
            return 0.0
        lower, upper = self.lower[bounded], self.upper[bounded]
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        return float(
            (np.maximum(self.high[:, bounded] - middle, middle - self.low[:, bounded]) / half).max()
        )


def intersample_bound(values: FloatArray, blocks: IntArray | None = None) -> FloatArray:
    """Bound the rise of a function between equispaced samples by its second differences.

    The bound is half the larger neighbouring second difference. It is exact for piecewise linear
    functions with at most one kink between two samples, where h·Δslope·α(1−α) is the worst;
    it is four times what a smooth function needs (h²/8 |f″|).

    Args:
        values: Samples of m functions. Shape (N, m).
        blocks: Number of the block that each sample belongs to, ascending, at least three samples
            each. Samples are equispaced within a block, and no difference is taken across its
            ends. Shape (N,). None: all samples are one block.

    Returns:
        The bound at each sample. Shape (N, m).
    """
    if len(values) < 3:
        return np.zeros_like(values)
    second = np.zeros_like(values)
    second[1:-1] = np.abs(np.diff(values, 2, axis=0))
    if blocks is None:
        first, last = np.array([0]), np.array([len(values) - 1])
    else:
        edges = np.flatnonzero(np.diff(blocks))
        first, last = np.append(0, edges + 1), np.append(edges, len(values) - 1)
    second[first], second[last] = second[first + 1], second[last - 1]
    largest = second.copy()
    after, before = second[1:].copy(), second[:-1].copy()
    after[last[:-1]], before[last[:-1]] = 0.0, 0.0  # not across the end of a block
    largest[:-1] = np.maximum(largest[:-1], after)
    largest[1:] = np.maximum(largest[1:], before)
    return 0.5 * largest


def torque_quantity(
    constraints: MotionConstraints, motion: Samples, blocks: IntArray | None = None
) -> BoundedQuantity:
    """Bound the joint torques of all robots in the ellipsoid of uncertain parameters.

    Coulomb friction jumps at a velocity reversal between two samples. As it is monotone in
    velocity, the values at the neighbouring samples bound it; only the smooth part of the torque is
    bounded by its second differences.

    Args:
        constraints: Robot, parameters and limits.
        motion: Samples of the motion.
        blocks: Blocks of equispaced samples, see `intersample_bound`.
    """
    nominal, width = dynamics.torque_band(
        constraints.robot, constraints.parameters, motion, constraints.uncertainty
    )
    friction = constraints.parameters.coulomb()
    smooth = nominal - friction * np.tanh(motion.dq / COULOMB_WIDTH)
    rise = intersample_bound(motion.dq, blocks)
    friction_high = _neighbours(friction * np.tanh((motion.dq + rise) / COULOMB_WIDTH), np.maximum)
    friction_low = _neighbours(friction * np.tanh((motion.dq - rise) / COULOMB_WIDTH), np.minimum)
    high, low = smooth + width, smooth - width
    high, low = (
        high + intersample_bound(high, blocks) + friction_high,
        low - intersample_bound(low, blocks) + friction_low,
    )
    bound = constraints.limits.torque
    return BoundedQuantity("torque", constraints.robot.joints, low, high, -bound, bound)


def _neighbours(values: FloatArray, pick: np.ufunc) -> FloatArray:
    """Return the largest or the smallest value of each sample and its two neighbours."""
    out = values.copy()
    out[1:] = pick(out[1:], values[:-1])
    out[:-1] = pick(out[:-1], values[1:])
    return out


def braking_quantity(
    constraints: MotionConstraints, motion: Samples, blocks: IntArray | None = None
) -> BoundedQuantity | None:
    """Bound the braking limits, which lower the velocity towards a stop.

    The limit is (s q̇ + c)₊²/rate + s q ≤ s·stop for both signs s.

    Args:
        constraints: Robot and limits.
        motion: Samples of the motion.
        blocks: Blocks of equispaced samples, see `intersample_bound`.

    Returns:
        The bounded quantity; None where no joint has such a limit.
    """
    limited = [j for j, brake in enumerate(constraints.limits.braking) if brake is not None]
    if not limited:
        return None
    brakes: list[Braking] = [b for b in constraints.limits.braking if b is not None]
    offset, rate = np.array([b.offset for b in brakes]), np.array([b.rate for b in brakes])
    q, dq = motion.q[:, limited], motion.dq[:, limited]
    high = q + np.maximum(dq + offset, 0.0) ** 2 / rate
    low = q - np.maximum(-dq + offset, 0.0) ** 2 / rate
    stops = np.array([b.stop for b in brakes])
    names = tuple(constraints.robot.joints[j] for j in limited)
    return BoundedQuantity(
        "braking",
        names,
        low - intersample_bound(low, blocks),
        high + intersample_bound(high, blocks),
        stops[:, 0],
        stops[:, 1],
    )


def box_quantities(
    constraints: MotionConstraints, motion: Samples, blocks: IntArray | None = None
) -> list[BoundedQuantity]:
    """Bound the positions of frames that have to stay in boxes; see `torque_quantity`."""
    out = []
    for box in constraints.boxes:
        p = dynamics.positions(constraints.robot, box.frame, motion.q)
        names = tuple(f"{box.frame}.{axis}" for axis in "xyz")
        out.append(
            BoundedQuantity(
                "box",
                names,
                p - intersample_bound(p, blocks),
                p + intersample_bound(p, blocks),
                np.array(box.lower),
                np.array(box.upper),
            )
        )
    return out


def stand_quantity(
    constraints: MotionConstraints, motion: Samples, blocks: IntArray | None = None
) -> BoundedQuantity | None:
    """Bound the load on the stand of the nominal robot's base; see `torque_quantity`.

    Returns:
        The bounded quantity; None without a limit.
    """
    stand = constraints.limits.stand
    if stand is None:
        return None
    loads = stand_load.stand_loads(constraints.robot, stand, motion)
    rise = intersample_bound(loads, blocks)
    # magnitudes: the range is symmetric, so that the free share is that of the limit itself
    bound = np.array([stand.force, stand.moment])
    return BoundedQuantity(STAND, stand_load.LOADS, loads - rise, loads + rise, -bound, bound)


def joint_quantity(
    limit: str, constraints: MotionConstraints, low: FloatArray, high: FloatArray
) -> BoundedQuantity:
    """Compare a joint quantity with the limit of that name.

    Args:
        limit: position, velocity, acceleration, jerk or torque.
        constraints: Robot and limits.
        low: Least values reached. Shape (N, n).
        high: Largest values reached. Shape (N, n).
    """
    bounds = getattr(constraints.limits, limit)
    lower, upper = (bounds[:, 0], bounds[:, 1]) if limit == "position" else (-bounds, bounds)
    return BoundedQuantity(limit, constraints.robot.joints, low, high, lower, upper)


def model_quantities(
    constraints: MotionConstraints, motion: Samples, blocks: IntArray | None = None
) -> list[BoundedQuantity]:
    """Bound torques, braking limits, loads on the stand and boxes; see `torque_quantity`."""
    others = (
        quantity(constraints, motion, blocks) for quantity in (braking_quantity, stand_quantity)
    )
    return [
        torque_quantity(constraints, motion, blocks),
        *(quantity for quantity in others if quantity is not None),
        *box_quantities(constraints, motion, blocks),
    ]


def ramp_step(period: float, samples: int, rate: float) -> float:
    """Return the largest time step at which ramps are sampled between their knots [s].

    Args:
        period: Period of the periodic motion [s].
        samples: Samples of the optimiser over one period.
        rate: Rows per second of the exported motion [Hz].
    """
    return min(period / (VERIFICATION_DENSITY * samples), 1.0 / rate)


def divided_pieces(edges: FloatArray, step: float) -> tuple[FloatArray, IntArray]:
    """Sample each interval between ascending times at equal steps, both ends included.

    Args:
        edges: Ascending times. Shape (m,) [s].
        step: Largest time step [s].

    Returns:
        Times, shape (N,) [s], and the number of the interval of each, shape (N,).
    """
    counts = np.maximum(np.ceil(np.diff(edges) / step).astype(int), MIN_STEPS_PER_PIECE)
    times = [
        np.linspace(a, b, n + 1) for a, b, n in zip(edges[:-1], edges[1:], counts, strict=True)
    ]
    return np.concatenate(times), np.repeat(np.arange(len(counts)), counts + 1)


def phase_quantities(
    constraints: MotionConstraints, profile: PhaseProfile, duration: float, step: float
) -> Iterator[tuple[FloatArray, BoundedQuantity]]:
    """Yield the bounded quantities of a ramp along the path of the periodic motion.

    Between two samples that are h apart, a function differs from its linear interpolation by at
    most h²/8 max|f″|; for a derivative of order k of the motion, f″ is that of order k + 2, which
    `PhaseProfile.derivative_bound` bounds.

    Args:
        constraints: Constraints, derived limits included.
        profile: The ramp.
        duration: Its duration [s].
        step: Largest time step [s].

    Yields:
        Times of the samples since the start, shape (N,) [s], and the quantity.
    """
    knots = profile.knots()
    edges = np.unique(np.concatenate([[0.0, duration], knots[knots < duration]]))
    pieces = np.diff(edges) > KNOT_INSET * duration
    edges = np.append(edges[:-1][pieces], edges[-1])
    times, blocks = divided_pieces(edges, step)
    begin, end = edges[blocks], edges[blocks + 1]
    inside = np.clip(times, begin + KNOT_INSET * (end - begin), end - KNOT_INSET * (end - begin))
    widest = float(np.diff(times).max())
    derivatives = [profile.at(inside, order) for order in range(4)]
    for order, limit in enumerate(("position", "velocity", "acceleration", "jerk")):
        rise = widest**2 / 8.0 * profile.derivative_bound(order + 2, duration)
        values = derivatives[order]
        yield times, joint_quantity(limit, constraints, values - rise, values + rise)
    samples = Samples(derivatives[0], derivatives[1], derivatives[2])
    for quantity in model_quantities(constraints, samples, blocks):
        yield times, quantity
