"""Certificate of motions in single or double support.

The motion is sampled densely and computed by Pinocchio, see `support_kinematics`. Between samples
each quantity is bounded by its second differences.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._types import FloatArray
from ..collision import continuous_check
from ..collision.continuous_check import PairDistance, SampledPath
from ..collision.workcell import NOT_CHECKED, Cell
from ..robot.floating_base import FloatingRobot
from ..robot.inertial_parameters import Parameters
from ..robot.limits import WITH_MARGIN, Limits
from ..trajectory.rest_to_rest import PhaseProfile
from .certificate import (
    CLEARANCE,
    MAX_LISTED_PAIRS,
    Certificate,
    CertificateVerdict,
    LimitMargin,
    distance_margin,
    distance_verdict,
    nearest_margins,
)
from .constraint_margins import BoundedQuantity, intersample_bound
from .support_cell import BASE_NAMES
from .support_kinematics import (
    SupportSamples,
    sole_friction_use,
    support_samples,
)
from .support_problem import profile_duration
from .support_stance import MAX_CLOSURE_ERROR, Stance

CERTIFICATE_RATE = 500.0
"""Samples a second of the certificate [Hz]."""

MAX_LOAD = 3.0
"""Largest normal force of a foot over the weight of the robot [1]; a foot that carries more has
been given an impact."""

REST_TOLERANCE = 1e-9
"""Largest speed and acceleration at both ends of a motion [rad/s, rad/s²]: rounding."""

JOINT_LIMITS = ("position", "velocity", "acceleration", "torque")
"""Kinds of limits of the joints."""

CONTACT_LIMITS = ("normal force", "centre of pressure", "friction", "turning friction")
"""Kinds of limits of the contact with the ground."""


@dataclass(frozen=True)
class SupportConstraints:
    """Constraints on motions in support.

    Attributes:
        robot: The robot.
        limits: Limits of its joints, with their margins.
        stance: The feet, the limits of their contact and the standing pose.
        parameters: Its standard parameters.
        cell: Bodies that have to keep their distance; None where distances are not checked.
        unchecked_reason: Sentence that the certificate states where `cell` is None.
        cell_fault: Why the cell is not that of the design; the clearance fails.
    """

    robot: FloatingRobot
    limits: Limits
    stance: Stance
    parameters: Parameters
    cell: Cell | None = None
    unchecked_reason: str = NOT_CHECKED
    cell_fault: str | None = None

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates (b, q) of a pose of the cell."""
        return (*BASE_NAMES, *self.robot.joints)


def certify(constraints: SupportConstraints, motions: Sequence[PhaseProfile]) -> Certificate:
    """Certify motions that are played one after the other.

    Args:
        constraints: The constraints.
        motions: Motions of the independent coordinates, from rest to rest.
    """
    return joined(
        constraints,
        [certify_motion(constraints, profile, number) for number, profile in enumerate(motions)],
    )


def certify_motion(
    constraints: SupportConstraints, profile: PhaseProfile, number: int
) -> Certificate:
    """Certify one of the motions that are played one after the other.

    Args:
        constraints: The constraints.
        profile: Motion of the independent coordinates, from rest to rest.
        number: Number of the motion, from 0; all have the same duration.
    """
    c = constraints
    duration = profile_duration(profile)
    start = number * duration
    t = np.linspace(0.0, duration, round(duration * CERTIFICATE_RATE) + 1)
    samples = support_samples(c.robot, c.stance, c.parameters, profile, t)
    faults = [f"motion {number + 1}: {fault}" for fault in _faults(samples, c.stance)]
    margins = list(_margins_of(c, samples, start))
    distances: list[PairDistance] = []
    if c.cell is not None and samples.closure_error <= MAX_CLOSURE_ERROR:
        path = _sampled_path(c.cell, samples, start)
        distances = continuous_check.least_distances_along(c.cell, [path])
    return _certificate(c, margins, faults, distances)


def joined(constraints: SupportConstraints, parts: Sequence[Certificate]) -> Certificate:
    """Return the certificate of all motions from those of each.

    Args:
        constraints: The constraints.
        parts: Results of `certify_motion`.
    """
    distances: dict[str, PairDistance] = {}
    for near in (near for part in parts for near in part.pair_distances):
        previous = distances.get(near.names, near)
        nearer = near if near.observed < previous.observed else previous
        proven = min(near.proven, previous.proven)
        distances[near.names] = replace(nearer, proven=proven)
    margins = [m for part in parts for m in part.margins if m.limit != CLEARANCE]
    faults = [fault for part in parts for fault in part.faults]
    ordered = sorted(distances.values(), key=lambda near: near.proven - near.pair.margin)
    return _certificate(constraints, margins, faults, ordered)


def _certificate(
    constraints: SupportConstraints,
    margins: Sequence[LimitMargin],
    faults: Sequence[str],
    distances: Sequence[PairDistance],
) -> Certificate:
    """Return the certificate with the nearest margin of each joint to each limit."""
    nearest: dict[tuple[str, str], LimitMargin] = {}
    for margin in margins:
        key = (margin.limit, margin.joint)
        if key not in nearest or margin.spare_share < nearest[key].spare_share:
            nearest[key] = margin
    clearance, sentence = _clearance(constraints, distances)
    all_margins = [*nearest.values(), *map(distance_margin, distances[:MAX_LISTED_PAIRS])]
    return Certificate(
        tuple(sorted(all_margins, key=lambda margin: margin.free_share)),
        {},
        tuple(faults),
        clearance,
        sentence,
        tuple(distances),
        constraints.coordinates,
    )


def _clearance(
    constraints: SupportConstraints, distances: Sequence[PairDistance]
) -> tuple[CertificateVerdict, str]:
    """Return the verdict on the distances, and a sentence."""
    cell, stance = constraints.cell, constraints.stance
    if constraints.cell_fault is not None:
        return CertificateVerdict.FAILED, constraints.cell_fault
    if cell is None:
        return CertificateVerdict.NOT_CHECKED, constraints.unchecked_reason
    inside = continuous_check.find_contained_pair(cell, np.concatenate([stance.base, stance.pose]))
    if inside is not None:
        sentence = f"COLLISION: {cell.names(inside)}, one begins inside the other"
        return CertificateVerdict.FAILED, sentence
    return distance_verdict(cell, distances)


def _sampled_path(cell: Cell, samples: SupportSamples, start: float) -> SampledPath:
    """Return the poses of a cell along a motion that begins at a time [s].

    Speeds are bounded between samples by their second differences. Poses between samples are
    interpolated by cubics with the rates at both ends; with their fourth derivative f they are
    within h⁴/384 |f|, some nanometres at 500 Hz.
    """
    from scipy.interpolate import CubicHermiteSpline  # slow to import

    q = np.hstack([samples.base, samples.motion.q])
    rate = np.hstack([samples.base_rate, samples.joint_velocity])
    speed = continuous_check.approach_speeds(cell, q, rate)
    largest = speed + intersample_bound(speed)
    approach = np.maximum(largest[:-1], largest[1:]) * np.diff(samples.t)[:, None]
    spline = CubicHermiteSpline(start + samples.t, q, rate)
    return SampledPath(start + samples.t, q, approach, lambda times: np.asarray(spline(times)))


def _faults(samples: SupportSamples, stance: Stance) -> Iterator[str]:
    """Yield sentences about feet that leave their place, and ends that are not at rest."""
    if not samples.closure_error <= MAX_CLOSURE_ERROR:
        yield (
            f"a foot leaves its place by {samples.closure_error:.2g} (of at most "
            f"{MAX_CLOSURE_ERROR:g} m or rad)"
        )
    motion = samples.motion
    for index, end in ((0, "start"), (-1, "end")):
        speed = max(np.abs(motion.velocity[index]).max(), np.abs(motion.acceleration[index]).max())
        if speed > REST_TOLERANCE:
            yield f"its {end} is not at rest"
        distance = float(np.abs(motion.q[index] - stance.pose).max())
        if distance > MAX_CLOSURE_ERROR:
            yield f"its {end} is not the standing pose"


def _margins_of(
    constraints: SupportConstraints, samples: SupportSamples, start: float
) -> Iterator[LimitMargin]:
    """Yield the nearest margins of one motion that begins at a time."""
    for quantity in _quantities(constraints, samples):
        promised = float(constraints.limits.margin.get(quantity.limit, 0.0))
        required = promised if quantity.limit in WITH_MARGIN else 0.0
        yield from nearest_margins(quantity, start + samples.t, required)


def _quantities(
    constraints: SupportConstraints, samples: SupportSamples
) -> Iterator[BoundedQuantity]:
    """Yield all bounded quantities of a motion."""
    limits, stance, motion = constraints.limits, constraints.stance, samples.motion
    joints = constraints.robot.joints
    yield _bounded("position", joints, motion.q, limits.position[:, 0], limits.position[:, 1])
    for limit, values in (
        ("velocity", samples.joint_velocity),
        ("acceleration", samples.joint_acceleration),
    ):
        bound = getattr(limits, limit)
        yield _bounded(limit, joints, values, -bound, bound)
    friction = constraints.parameters.coulomb()
    yield _bounded("torque", joints, samples.torque, -limits.torque, limits.torque, friction)
    contact, weight = stance.contact, stance.weight
    for number, foot in enumerate(stance.feet):
        wrench = samples.wrenches[:, number]
        force = wrench[:, 2]
        least = contact.least_share * weight / len(stance.feet)
        yield _bounded(
            "normal force",
            (foot.frame,),
            force[:, None],
            np.array([least]),
            np.array([MAX_LOAD * weight]),
        )
        pressure = np.column_stack([-wrench[:, 4], wrench[:, 3]]) / force[:, None]
        room = np.array([foot.half_length, foot.half_width]) - contact.margin
        names = (f"{foot.frame} x", f"{foot.frame} y")
        yield _bounded("centre of pressure", names, pressure, -room, room)
        sliding = np.hypot(wrench[:, 0], wrench[:, 1]) / force
        coefficient = np.array([contact.friction])
        yield _bounded("friction", (foot.frame,), sliding[:, None], -coefficient, coefficient)
        turning = sole_friction_use(foot, contact.friction, wrench)
        yield _bounded("turning friction", (foot.frame,), turning[:, None], -np.ones(1), np.ones(1))


def _bounded(
    limit: str,
    names: tuple[str, ...],
    values: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    spread: FloatArray | float = 0.0,
) -> BoundedQuantity:
    """Return a quantity with its bounds between samples.

    Args:
        limit: Kind of the limit.
        names: Names of the joints or axes.
        values: Samples. Shape (N, m).
        lower: Lower bounds. Shape (m,).
        upper: Upper bounds. Shape (m,).
        spread: Amount by which values may differ either way, such as Coulomb friction. Shape (m,).
    """
    spread = intersample_bound(values) + spread
    return BoundedQuantity(limit, names, values - spread, values + spread, lower, upper)
