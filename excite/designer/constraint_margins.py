"""How near a motion comes to every limit, by Pinocchio, including what can happen between its samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..collision.clearance_constraint import Clearance
from ..robot import dynamics
from ..robot.inertial_parameters import COULOMB_WIDTH, Parameters
from ..robot.limits import Braking, Limits
from ..robot.robot import Robot
from ..robot.samples import Samples
from .options import WorkspaceBox

Array = np.ndarray


@dataclass(frozen=True)
class MotionConstraints:
    """What a motion is held against: a robot, its limits, how uncertain its parameters are, and what it must not touch."""

    robot: Robot
    limits: Limits
    parameters: Parameters
    uncertainty: float = 0.0
    boxes: tuple[WorkspaceBox, ...] = ()
    clearance: Clearance | None = None


@dataclass(frozen=True)
class BoundedQuantity:
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
        return float(
            (np.maximum(self.high[:, bounded] - middle, middle - self.low[:, bounded]) / half).max()
        )


def intersample_bound(values: Array, blocks: Array | None = None) -> Array:
    """Bound how far a function may rise between equispaced samples: half the larger neighbouring second difference.

    Proven for piecewise linear functions with at most one kink between two samples, where h·Δslope·α(1−α) is
    the worst; four times what a smooth function needs (h²/8 |f″|).

    Args:
        values: Samples of m functions. Shape (N, m).
        blocks: Number of the block that each sample belongs to, in ascending order, at least three samples each; samples are
            equispaced within a block only, and no difference is taken across its ends. Shape (N,). None: all in one block.

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
    near = second.copy()
    after, before = second[1:].copy(), second[:-1].copy()
    after[last[:-1]], before[last[:-1]] = 0.0, 0.0  # neighbours across the end of a block
    near[:-1] = np.maximum(near[:-1], after)
    near[1:] = np.maximum(near[1:], before)
    return 0.5 * near


def torque_quantity(subject: MotionConstraints, motion: Samples, blocks: Array | None = None) -> BoundedQuantity:
    """Torque of every robot in the uncertain ball; samples equispaced within `blocks` (see `excess`).

    Coulomb friction jumps at a reversal, between two samples; it is monotone in speed, so its bounds are those of its
    neighbours, and only the smooth rest is given room for its curvature.
    """
    nominal, width = dynamics.torque_band(
        subject.robot, subject.parameters, motion, subject.uncertainty
    )
    friction = subject.parameters.coulomb()
    smooth = nominal - friction * np.tanh(motion.dq / COULOMB_WIDTH)
    doubt = intersample_bound(motion.dq, blocks)
    most = _neighbours(friction * np.tanh((motion.dq + doubt) / COULOMB_WIDTH), np.maximum)
    least = _neighbours(friction * np.tanh((motion.dq - doubt) / COULOMB_WIDTH), np.minimum)
    high, low = smooth + width, smooth - width
    high, low = high + intersample_bound(high, blocks) + most, low - intersample_bound(low, blocks) + least
    bound = subject.limits.torque
    return BoundedQuantity("torque", subject.robot.joints, low, high, -bound, bound)


def _neighbours(values: Array, pick: np.ufunc) -> Array:
    """The largest or smallest of each sample and the ones beside it."""
    out = values.copy()
    out[1:] = pick(out[1:], values[:-1])
    out[:-1] = pick(out[:-1], values[1:])
    return out


def braking_quantity(subject: MotionConstraints, motion: Samples, blocks: Array | None = None) -> BoundedQuantity | None:
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
    return BoundedQuantity(
        "braking",
        names,
        low - intersample_bound(low, blocks),
        high + intersample_bound(high, blocks),
        stops[:, 0],
        stops[:, 1],
    )


def box_quantities(subject: MotionConstraints, motion: Samples, blocks: Array | None = None) -> list[BoundedQuantity]:
    """Cartesian boxes around frames."""
    out = []
    for box in subject.boxes:
        p = dynamics.positions(subject.robot, box.frame, motion.q)
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


def joint_quantity(limit: str, subject: MotionConstraints, low: Array, high: Array) -> BoundedQuantity:
    """A joint quantity against the limit of that name."""
    bounds = getattr(subject.limits, limit)
    lower, upper = (bounds[:, 0], bounds[:, 1]) if limit == "position" else (-bounds, bounds)
    return BoundedQuantity(limit, subject.robot.joints, low, high, lower, upper)


def model_quantities(subject: MotionConstraints, motion: Samples, blocks: Array | None = None) -> list[BoundedQuantity]:
    """All demands that need the robot's model: torque, braking, boxes. blocks: as in `excess`."""
    brake = braking_quantity(subject, motion, blocks)
    return [
        torque_quantity(subject, motion, blocks),
        *([] if brake is None else [brake]),
        *box_quantities(subject, motion, blocks),
    ]
