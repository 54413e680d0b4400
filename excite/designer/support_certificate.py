"""Certificate of motions in single or double support.

The motion is sampled densely and computed by Pinocchio, see `support_kinematics`. Between samples
each quantity is bounded by its second differences.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from .._types import FloatArray
from ..robot.floating_base import FloatingRobot
from ..robot.inertial_parameters import Parameters
from ..robot.limits import WITH_MARGIN, Limits
from ..trajectory.rest_to_rest import PhaseProfile
from .certificate import Certificate, LimitMargin, nearest_margins
from .constraint_margins import BoundedQuantity, intersample_bound
from .support_kinematics import SupportSamples, sole_friction_use, support_samples
from .support_problem import motion_duration
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

NOT_CHECKED = "distances between bodies are not checked in support"


def certify(
    robot: FloatingRobot,
    limits: Limits,
    stance: Stance,
    parameters: Parameters,
    motions: Sequence[PhaseProfile],
) -> Certificate:
    """Certify motions that are played one after the other.

    Args:
        robot: The robot.
        limits: Limits of its joints, with their margins.
        stance: The feet, the limits of their contact and the standing pose.
        parameters: Its standard parameters.
        motions: Motions of the independent coordinates, from rest to rest.
    """
    margins: dict[tuple[str, str], LimitMargin] = {}
    faults, start = [], 0.0
    for number, profile in enumerate(motions, start=1):
        duration = motion_duration(profile.fourier.period)
        t = np.linspace(0.0, duration, round(duration * CERTIFICATE_RATE) + 1)
        samples = support_samples(robot, stance, parameters, profile, t)
        faults += [f"motion {number}: {fault}" for fault in _faults(samples, stance)]
        for margin in _margins_of(robot, limits, stance, parameters, samples, start):
            key = (margin.limit, margin.joint)
            if key not in margins or margin.spare_share < margins[key].spare_share:
                margins[key] = margin
        start += duration
    ordered = tuple(sorted(margins.values(), key=lambda margin: margin.free_share))
    return Certificate(ordered, {}, tuple(faults), collision=NOT_CHECKED, joints=robot.joints)


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
    robot: FloatingRobot,
    limits: Limits,
    stance: Stance,
    parameters: Parameters,
    samples: SupportSamples,
    start: float,
) -> Iterator[LimitMargin]:
    """Yield the nearest margins of one motion that begins at a time."""
    for quantity in _quantities(robot, limits, stance, parameters, samples):
        promised = float(limits.margin.get(quantity.limit, 0.0))
        required = promised if quantity.limit in WITH_MARGIN else 0.0
        yield from nearest_margins(quantity, start + samples.t, required)


def _quantities(
    robot: FloatingRobot,
    limits: Limits,
    stance: Stance,
    parameters: Parameters,
    samples: SupportSamples,
) -> Iterator[BoundedQuantity]:
    """Yield all bounded quantities of a motion."""
    motion, joints = samples.motion, robot.joints
    yield _bounded("position", joints, motion.q, limits.position[:, 0], limits.position[:, 1])
    for limit, values in (
        ("velocity", samples.joint_velocity),
        ("acceleration", samples.joint_acceleration),
    ):
        bound = getattr(limits, limit)
        yield _bounded(limit, joints, values, -bound, bound)
    yield _bounded(
        "torque", joints, samples.torque, -limits.torque, limits.torque, parameters.coulomb()
    )
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
        friction = np.array([contact.friction])
        yield _bounded("friction", (foot.frame,), sliding[:, None], -friction, friction)
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
