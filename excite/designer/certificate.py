"""Certificate of a finished motion, recomputed from its file, its robot and its cell.

No result that the file states is trusted. Limits are read from the sources that the file names,
torques are computed by Pinocchio, and distances by the shapes and meshes as they are on disk now.
What the user may choose for a design has no other source than the file: the radius of uncertainty,
the margins and the boxes. The verdict states them, and where the limits file or the default asks
for larger margins.

The periodic part is bounded between samples by the oversampling bound, ramps at the knots and the
extremes of each cubic.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from .._types import FloatArray
from ..collision import continuous_check, scene_file
from ..collision.continuous_check import PairDistance
from ..collision.workcell import NOT_CHECKED, Cell
from ..robot import base_parameters, dynamics, inertial_parameters
from ..robot.limits import DERIVED, QUANTITIES, WITH_MARGIN, Limits, Stand
from ..robot.robot import Robot, require_possible_bodies
from ..robot.samples import Samples
from ..trajectory.fourier import VERIFICATION_DENSITY, oversampling_bound
from ..trajectory.rest_to_rest import Motion, MotionSegment, PhaseProfile, SegmentKind
from ..trajectory.trajectory_file import Trajectory, package_versions
from . import constraint_margins, criteria
from .constraint_margins import BoundedQuantity, MotionConstraints
from .options import DesignOptions, WorkspaceBox
from .ramps import DEFAULT_SAMPLES, with_derived_limits

RELATIVE_ROUNDING = 1e-9
"""Share of a limit by which rounding may exceed it [1]."""

CRITERION_TOLERANCE = 1e-5
"""Relative difference between a stated and a recomputed criterion that counts as a fault [1]."""

STATE_TOLERANCE = 1e-7
"""Jump or speed at rest that counts as a fault [rad, rad/s, rad/s²]."""

CELL_KEY = "cell"
"""Key of the cell in the `design` of a trajectory file."""

CLEARANCE = "clearance"
"""Name of the clearance among the kinds of limits."""

MAX_LISTED_FAULTS = 3
"""Faults that a line of the verdict lists; `faults` of the document has all [1]."""

MAX_LISTED_PAIRS = continuous_check.REFINED_PAIRS
"""Pairs of bodies that a certificate lists, the nearest to their margin [1]."""


class CertificateVerdict(Enum):
    """Verdict on one of the two parts of a certificate."""

    CERTIFIED = "certified"
    FAILED = "failed"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True)
class LimitMargin:
    """Nearest approach of one joint to one limit.

    Attributes:
        limit: Kind of the limit.
        joint: Name of the joint, frame axis or pair of bodies.
        time: Time of the nearest approach [s].
        value: Value at that time.
        bound: Bound that the value must not pass.
        free_share: Distance to the bound over the half width of the allowed range, negative where
            the limit is violated [1].
        required_share: Free share that the file promises [1].
        ramps_only: The limit is derived for the ramps; the periodic part is not held to it, and its
            value is not in `value`.
    """

    limit: str
    joint: str
    time: float
    value: float
    bound: float
    free_share: float
    required_share: float = 0.0
    ramps_only: bool = False

    @property
    def title(self) -> str:
        """Kind of the limit, and the part of the motion if the limit is not for all of it."""
        return f"{self.limit} (ramps)" if self.ramps_only else self.limit

    @property
    def spare_share(self) -> float:
        """Free share beyond the promised one; negative where either is violated [1]."""
        return self.free_share - self.required_share

    def describe(self) -> str:
        """Return a sentence about the value and the bound."""
        if self.limit == CLEARANCE:
            if self.value <= 0.0:
                return f"{self.joint} collide (t = {self.time:.2f} s)"
            relation = "<" if self.value < self.bound else "≥"
            return (
                f"clearance {self.joint} is {1e3 * self.value:.1f} mm "
                f"{relation} {1e3 * self.bound:.1f} mm (t = {self.time:.2f} s)"
            )
        text = (
            f"{self.title} of '{self.joint}' reaches {self.value:.4g} of {self.bound:.4g} "
            f"(t = {self.time:.3f} s)"
        )
        if self.free_share < -RELATIVE_ROUNDING or not self.required_share:
            return text
        return f"{text}, where {format_percent(self.required_share)} should stay free"

    def document(self) -> dict[str, Any]:
        """Return the margin as `excite verify --json` prints it."""
        return {
            "limit": self.limit,
            "joint": self.joint,
            "time": self.time,
            "value": self.value,
            "bound": self.bound,
            "margin": self.free_share,
            **({"ramps_only": True} if self.ramps_only else {}),
        }


@dataclass(frozen=True)
class CertificateTerms:
    """Choices of the design under which its limits are certified.

    Attributes:
        uncertainty: Radius of the ellipsoid of robots for which torque limits hold [1].
        margin: Share of each kind of limit that is kept free [1].
        boxes: Names of the frames that stay in a box.
        asked_margin: Share of each kind of limit that the limits file or the default asks for [1].
    """

    uncertainty: float
    margin: Mapping[str, float]
    boxes: tuple[str, ...]
    asked_margin: Mapping[str, float]

    def describe(self) -> str:
        """Return the choices in words."""
        robots = f"robots within {self.uncertainty:g} of the nominal one"
        kept = []
        for kind, share in self.margin.items():
            asked = self.asked_margin.get(kind, 0.0)
            source = f" (limits file or default: {100.0 * asked:g} %)" if share < asked else ""
            kept.append(f"{kind} {100.0 * share:g} %{source}")
        return "; ".join(
            [
                f"for {robots if self.uncertainty else 'the nominal robot'}",
                f"kept free: {', '.join(kept)}",
                *(f"{frame} in its box" for frame in self.boxes),
            ]
        )

    def document(self) -> dict[str, Any]:
        """Return the entry of `excite verify --json`."""
        return {
            "uncertainty": self.uncertainty,
            "margin": dict(self.margin),
            "boxes": list(self.boxes),
        }


@dataclass(frozen=True)
class Certificate:
    """Result of a verification.

    Attributes:
        margins: Margins to all limits, the nearest first.
        criteria: Recomputed criteria.
        faults: Sentences about the file itself: a jump, a limit that differs from its source.
        clearance: Verdict on the distances.
        collision: Sentence about the distances.
        pair_distances: Least distance of each pair of bodies, the nearest to its margin first.
        joints: Names of the joints.
        terms: Choices of the design under which the limits are certified; None: there are none.
    """

    margins: tuple[LimitMargin, ...]
    criteria: Mapping[str, Any]
    faults: tuple[str, ...]
    clearance: CertificateVerdict = CertificateVerdict.NOT_CHECKED
    collision: str = NOT_CHECKED
    pair_distances: tuple[PairDistance, ...] = ()
    joints: tuple[str, ...] = ()
    terms: CertificateTerms | None = None

    @property
    def limits(self) -> CertificateVerdict:
        """Verdict on the limits and on the file itself."""
        kept = all(
            margin.spare_share >= -RELATIVE_ROUNDING
            for margin in self.margins
            if margin.limit != CLEARANCE
        )
        return (
            CertificateVerdict.CERTIFIED if kept and not self.faults else CertificateVerdict.FAILED
        )

    @property
    def ok(self) -> bool:
        """True if nothing failed; the clearance may be unchecked."""
        return (
            self.limits is CertificateVerdict.CERTIFIED
            and self.clearance is not CertificateVerdict.FAILED
        )

    def worst(self) -> LimitMargin:
        """Return the margin with the least free share beyond the promised one."""
        return min(self.margins, key=lambda margin: margin.spare_share)

    def clearance_deficits(self) -> dict[str, float]:
        """Return how much clearance each pair lacks that violates it [m]."""
        return {
            m.joint: m.bound - m.value
            for m in self.margins
            if m.limit == CLEARANCE and m.free_share < -RELATIVE_ROUNDING
        }

    def verdict_lines(self) -> tuple[str, str]:
        """Return both verdicts, one line each, the clearance first."""
        nearest = min(
            (m for m in self.margins if m.limit != CLEARANCE), key=lambda margin: margin.spare_share
        )
        detail = (
            f"nearest: {nearest.title} of {nearest.joint}, {nearest.value:.5g} of "
            f"{nearest.bound:.5g} at {nearest.time:.3f} s"
        )
        share = f"{format_percent(nearest.free_share)} free"
        if nearest.required_share:
            share += f", {format_percent(nearest.required_share)} promised"
        more = len(self.faults) - MAX_LISTED_FAULTS
        faults = [
            *self.faults[:MAX_LISTED_FAULTS],
            *([f"and {more} more faults"] if more > 0 else []),
        ]
        limits = [
            self.limits.value,
            *faults,
            *([] if self.terms is None else [self.terms.describe()]),
            f"{detail} ({share})",
        ]
        return (
            f"clearance: {self.clearance.value}; {self.collision}",
            f"limits: {'; '.join(limits)}",
        )

    def failure_reason(self) -> str:
        """Return the main reason of a failure, in one sentence."""
        if self.faults:
            return self.faults[0]
        worst = self.worst()
        return worst.describe() if worst.spare_share < -RELATIVE_ROUNDING else self.collision

    def document(self) -> dict[str, Any]:
        """Return the certificate as `excite verify --json` prints it."""
        return {
            "ok": self.ok,
            "verdict": {"limits": self.limits.value, "clearance": self.clearance.value},
            "margins": [margin.document() for margin in self.margins],
            "criteria": dict(self.criteria),
            "collision": self.collision,
            "clearance": [
                distance.document(self.joints)
                for distance in self.pair_distances[:MAX_LISTED_PAIRS]
            ],
            "faults": list(self.faults),
            "terms": None if self.terms is None else self.terms.document(),
        }


def format_percent(share: float) -> str:
    """Format a share as percentage; zero within rounding has no sign."""
    if abs(share) <= RELATIVE_ROUNDING:
        return "0 %"
    value = 100.0 * share
    return (
        f"{value:.2g} %"
        if abs(value) < 1.0
        else f"{value:.1f} %"
        if abs(value) < 10.0
        else f"{value:.0f} %"
    )


def verify(
    trajectory: Trajectory,
    robot: Robot,
    limits: Limits,
    cell: Cell | None = None,
    *,
    unchecked_reason: str = NOT_CHECKED,
    cell_fault: str | None = None,
) -> Certificate:
    """Verify a trajectory: limits, distances, junctions of its segments, rest and criteria.

    Args:
        trajectory: The file's content.
        robot: The robot it was designed for.
        limits: Limits from their sources (`limits.from_sources`); those of the file are compared
            with them.
        cell: Surroundings to keep clear of, as they are now; None: distances are not checked.
        unchecked_reason: Sentence that the certificate states where `cell` is None.
        cell_fault: Why the cell is not that of the design; the clearance fails.

    Returns:
        The certificate; nothing is raised for a motion that fails.
    """
    certificate = certify(
        trajectory, robot, limits, cell, unchecked_reason=unchecked_reason, cell_fault=cell_fault
    )
    faults = _criteria_faults(trajectory, certificate.criteria)
    return replace(certificate, faults=(*certificate.faults, *faults))


def certify(
    trajectory: Trajectory,
    robot: Robot,
    limits: Limits,
    cell: Cell | None = None,
    *,
    unchecked_reason: str = NOT_CHECKED,
    cell_fault: str | None = None,
) -> Certificate:
    """Compute the certificate of a trajectory; stated criteria are not compared; see `verify`."""
    truth = with_derived_limits(limits, trajectory.motion.fourier)
    constraints = motion_constraints(trajectory, robot, truth)
    margins = limit_margins(trajectory, constraints)
    clearance, collision, distances = _clearance(trajectory, cell, unchecked_reason, cell_fault)
    margins += [distance_margin(distance) for distance in distances[:MAX_LISTED_PAIRS]]
    scores = recompute_criteria(trajectory, robot, truth, constraints.parameters)
    faults = (*limit_faults(trajectory.limits, truth), *_motion_faults(trajectory))
    ordered = tuple(sorted(margins, key=lambda margin: margin.free_share))
    terms = CertificateTerms(
        constraints.uncertainty,
        {kind: promised_share(trajectory, kind) for kind in WITH_MARGIN},
        tuple(box.frame for box in constraints.boxes),
        limits.margin,
    )
    return Certificate(
        ordered, scores, faults, clearance, collision, tuple(distances), robot.joints, terms
    )


def certified_trajectory(
    robot: Robot,
    limits: Limits,
    motion: Motion,
    options: DesignOptions,
    noise: FloatArray,
    design: Mapping[str, Any],
    cell: Cell | None,
    unchecked_reason: str,
) -> tuple[Trajectory, Certificate]:
    """Return the content of the file of a new motion, and its certificate.

    Args:
        robot: The robot.
        limits: Its limits.
        motion: The motion.
        options: Options of its design.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        design: Entries of the file's `design`, without the cell.
        cell: Surroundings to keep clear of; None: distances are not checked.
        unchecked_reason: Sentence that the file states where `cell` is None.
    """
    draft = Trajectory(
        robot=robot.document(),
        motion=motion,
        rate=options.rate,
        limits=with_derived_limits(limits, motion.fourier),
        noise=noise,
        design={**design, **({} if cell is None else {CELL_KEY: cell.document()})},
        criteria={},
        margins=[],
        collision=unchecked_reason,
        seed=options.seed,
        versions=package_versions(),
    )
    certificate = certify(draft, robot, limits, cell, unchecked_reason=unchecked_reason)
    trajectory = replace(
        draft,
        criteria=certificate.criteria,
        margins=[margin.document() for margin in certificate.margins],
        collision=certificate.collision,
        forced=not certificate.ok,
    )
    return trajectory, certificate


def motion_constraints(trajectory: Trajectory, robot: Robot, limits: Limits) -> MotionConstraints:
    """Return the constraints on a trajectory, with the uncertainty and boxes of its design."""
    design = trajectory.design
    standard = inertial_parameters.standard_parameters(
        robot, limits, design.get("drive", inertial_parameters.DRIVE)
    )
    boxes = tuple(
        WorkspaceBox(b["frame"], tuple(b["lower"]), tuple(b["upper"]))
        for b in design.get("boxes", ())
    )
    return MotionConstraints(robot, limits, standard, float(design.get("uncertainty", 0.0)), boxes)


def recompute_criteria(
    trajectory: Trajectory, robot: Robot, limits: Limits, standard: inertial_parameters.Parameters
) -> dict[str, Any]:
    """Evaluate all criteria of the periodic part and of the exported motion.

    The periodic part is sampled as in the optimisation.
    """
    require_possible_bodies(robot)
    motion = trajectory.motion
    base = base_parameters.find(robot, standard, limits)
    samples = int(trajectory.design.get("samples", round(motion.fourier.period * trajectory.rate)))
    parts = {
        "optimum": motion.fourier.samples(motion.fourier.grid(samples)),
        "exported": motion.samples(motion.grid(trajectory.rate)),
    }
    return {
        name: criteria.evaluate_criteria(
            dynamics.regressor_blocks(robot, standard, part), base, trajectory.noise
        )
        for name, part in parts.items()
    }


def verify_with_cell_on_disk(
    trajectory: Trajectory, robot: Robot, limits: Limits, packages: Sequence[str] = ()
) -> Certificate:
    """Verify a trajectory against given limits and its cell as it is on disk.

    Args:
        trajectory: The file's content.
        robot: The robot of its URDF.
        limits: Limits from their sources.
        packages: Further folders of `package://` meshes.
    """
    if CELL_KEY not in trajectory.design:
        return verify(
            trajectory,
            robot,
            limits,
            unchecked_reason=f"{NOT_CHECKED}: the file states no shapes to keep clear of",
        )
    cell, fault = scene_file.rebuild_cell(robot, limits, trajectory.design[CELL_KEY], packages)
    return verify(trajectory, robot, limits, cell, cell_fault=fault)


def limit_margins(trajectory: Trajectory, constraints: MotionConstraints) -> list[LimitMargin]:
    """Return the least margin of each joint to each limit.

    Args:
        trajectory: Content of the file.
        constraints: Constraints, derived limits included.
    """
    margins: dict[tuple[str, str], LimitMargin] = {}
    for segment in trajectory.motion.segments:
        for times, quantity in segment_quantities(constraints, trajectory, segment):
            required = promised_share(trajectory, quantity.limit)
            for nearest in nearest_margins(quantity, times, required):
                is_derived = _is_derived(constraints.limits, constraints.robot, nearest)
                if segment.profile is None and is_derived:
                    continue
                margin = replace(nearest, ramps_only=is_derived)
                key = (margin.limit, margin.joint)
                if key not in margins or margin.free_share < margins[key].free_share:
                    margins[key] = margin
    return list(margins.values())


def broken_when_slowed(
    trajectory: Trajectory, robot: Robot, limits: Limits, speed: float
) -> LimitMargin | None:
    """Return the limit that a motion violates most at a lower speed, None where it violates none.

    A slower run is not safe by itself: where inertia helps the actuator against gravity, a lower
    speed needs more torque.

    Args:
        trajectory: Content of the file.
        robot: The robot.
        limits: Limits from their sources.
        speed: Share of the designed speed [1].
    """
    slower = replace(trajectory, motion=trajectory.motion.slowed(speed))
    constraints = motion_constraints(
        slower, robot, with_derived_limits(limits, slower.motion.fourier)
    )
    worst = min(limit_margins(slower, constraints), key=lambda margin: margin.free_share)
    return worst if worst.free_share < -RELATIVE_ROUNDING else None


def promised_share(trajectory: Trajectory, limit: str) -> float:
    """Return the share of a limit that the design promises to keep free."""
    return (
        float(trajectory.design.get("margin", {}).get(limit, 0.0)) if limit in WITH_MARGIN else 0.0
    )


def _is_derived(limits: Limits, robot: Robot, margin: LimitMargin) -> bool:
    """Return whether a limit is derived, so that it applies to the ramps only."""
    return (
        margin.limit in limits.sources
        and margin.joint in robot.joints
        and limits.sources[margin.limit][robot.joints.index(margin.joint)] == DERIVED
    )


def segment_quantities(
    constraints: MotionConstraints, trajectory: Trajectory, segment: MotionSegment
) -> Iterator[tuple[FloatArray, BoundedQuantity]]:
    """Yield the bounded quantities of one segment with the times of their samples [s]."""
    if segment.profile is None:
        yield from _fourier_quantities(constraints, trajectory, segment)
    else:
        yield from _ramp_quantities(constraints, trajectory, segment)


def _optimiser_samples(trajectory: Trajectory) -> int:
    """Return the samples over one period at which limits were kept by the optimiser."""
    return int(trajectory.design.get("samples", DEFAULT_SAMPLES))


def _fourier_quantities(
    constraints: MotionConstraints, trajectory: Trajectory, segment: MotionSegment
) -> Iterator[tuple[FloatArray, BoundedQuantity]]:
    """Yield the bounded quantities of one period, derivatives by `oversampling_bound`."""
    fourier = trajectory.motion.fourier
    count = VERIFICATION_DENSITY * max(_optimiser_samples(trajectory), 8 * fourier.harmonics)
    t = fourier.grid(count)
    factor = oversampling_bound(count, fourier.harmonics) - 1.0
    for order, limit in enumerate(("position", "velocity", "acceleration", "jerk")):
        values = fourier.at(t, order)
        # a constant may be subtracted first; the middle of the samples gives the tightest bound
        more = factor * 0.5 * np.ptp(values, axis=0)
        yield (
            segment.start + t,
            constraint_margins.joint_quantity(limit, constraints, values - more, values + more),
        )
    closed = np.append(t, fourier.period)  # second differences also across the end of the period
    for quantity in constraint_margins.model_quantities(constraints, fourier.samples(closed)):
        yield segment.start + closed, quantity


def _ramp_quantities(
    constraints: MotionConstraints, trajectory: Trajectory, segment: MotionSegment
) -> Iterator[tuple[FloatArray, BoundedQuantity]]:
    """Yield the bounded quantities of a ramp.

    Position, velocity, acceleration and jerk of piecewise constant jerk are exact, those of a ramp
    along the path of the periodic motion are bounded between samples. Torque and frames are sampled
    within each piece and bounded between the samples.
    """
    profile, duration = segment.profile, segment.end - segment.start
    assert profile is not None
    step = constraint_margins.ramp_step(
        trajectory.motion.fourier.period, _optimiser_samples(trajectory), trajectory.rate
    )
    if isinstance(profile, PhaseProfile):
        for local, quantity in constraint_margins.phase_quantities(
            constraints, profile, duration, step
        ):
            yield segment.start + local, quantity
        return
    times = profile.critical_times(duration)
    for order, limit in enumerate(("position", "velocity", "acceleration")):
        values = profile.at(times, order)
        yield (
            segment.start + times,
            constraint_margins.joint_quantity(limit, constraints, values, values),
        )
    middle = 0.5 * (times[:-1] + times[1:])
    jerk = profile.at(middle, 3)
    yield segment.start + middle, constraint_margins.joint_quantity("jerk", constraints, jerk, jerk)
    dense, blocks = constraint_margins.divided_pieces(times, step)
    motion = Samples(*(profile.at(dense, order) for order in range(3)))
    for quantity in constraint_margins.model_quantities(constraints, motion, blocks):
        yield segment.start + dense, quantity


def nearest_margins(
    quantity: BoundedQuantity, times: FloatArray, required: float
) -> Iterator[LimitMargin]:
    """Yield the nearest margin of each joint of a quantity."""
    half = 0.5 * (quantity.upper - quantity.lower)
    for j, name in enumerate(quantity.names):
        if not np.isfinite(half[j]):
            continue
        above, below = int(np.argmax(quantity.high[:, j])), int(np.argmin(quantity.low[:, j]))
        up = float((quantity.upper[j] - quantity.high[above, j]) / half[j])
        down = float((quantity.low[below, j] - quantity.lower[j]) / half[j])
        if up <= down:
            yield LimitMargin(
                quantity.limit,
                name,
                float(times[above]),
                float(quantity.high[above, j]),
                float(quantity.upper[j]),
                up,
                required,
            )
        else:
            yield LimitMargin(
                quantity.limit,
                name,
                float(times[below]),
                float(quantity.low[below, j]),
                float(quantity.lower[j]),
                down,
                required,
            )


def limit_faults(stated: Limits, truth: Limits) -> Iterator[str]:
    """Yield a sentence for each limit of the file that differs from its source."""
    for quantity in QUANTITIES:
        for i, joint in enumerate(truth.joints):
            stated_value, true_value = getattr(stated, quantity)[i], getattr(truth, quantity)[i]
            if not np.allclose(stated_value, true_value, rtol=RELATIVE_ROUNDING, atol=0.0):
                source = truth.sources[quantity][i] or "its source"
                yield (
                    f"the {quantity} limit of '{joint}' is {_limit_text(stated_value)} in the "
                    f"file, but {_limit_text(true_value)} by {source}"
                )
    for joint, stated_value, true_value in zip(
        truth.joints, stated.braking, truth.braking, strict=True
    ):
        if stated_value != true_value:
            yield f"the braking limit of '{joint}' in the file is not that of its source"
    if _loads(stated.stand) != _loads(truth.stand):
        yield "the load that the stand takes in the file is not that of its source"


def _loads(stand: Stand | None) -> Stand | None:
    """Return the limits of a stand without their source, which may have been moved."""
    return None if stand is None else replace(stand, source="")


def _limit_text(value: FloatArray) -> str:
    """Format a limit, which may be a range."""
    numbers = np.atleast_1d(value)
    if not np.isfinite(numbers).all():
        return "absent"
    return " to ".join(f"{number:g}" for number in numbers)


def _clearance(
    trajectory: Trajectory, cell: Cell | None, unchecked_reason: str, fault: str | None
) -> tuple[CertificateVerdict, str, list[PairDistance]]:
    """Return the verdict on the distances, a sentence, and the least distance of each pair."""
    if fault is not None:
        return CertificateVerdict.FAILED, fault, []
    if cell is None:
        return CertificateVerdict.NOT_CHECKED, unchecked_reason, []
    inside = continuous_check.find_contained_pair(cell, trajectory.motion.at(np.zeros(1))[0])
    if inside is not None:
        return (
            CertificateVerdict.FAILED,
            f"COLLISION: {cell.names(inside)}, one begins inside the other",
            [],
        )
    distances = continuous_check.least_distances(cell, trajectory.motion)
    return (*distance_verdict(cell, distances), distances)


def distance_verdict(
    cell: Cell, distances: Sequence[PairDistance]
) -> tuple[CertificateVerdict, str]:
    """Return the verdict on the least distances of all pairs, and a sentence."""
    context = "".join(f"; {note}" for note in (cell.floor_words(), *cell.notes))
    if not distances:
        return CertificateVerdict.CERTIFIED, f"collision checked: nothing can meet{context}"
    worst = min(distances, key=lambda near: near.proven)
    if worst.proven <= 0.0:
        return (
            CertificateVerdict.FAILED,
            f"COLLISION: {worst.names} at {worst.time:.2f} s{context}",
        )
    kept = all(distance_margin(near).free_share >= -RELATIVE_ROUNDING for near in distances)
    wide = [near for near in distances if near.pair.margin >= cell.margin]
    parts = (
        [f"never less than {_distance_text(min(wide, key=lambda near: near.proven))}"]
        if wide
        else []
    )
    close = [near for near in distances if near.pair.margin < cell.margin]
    parts += (
        [f"neighbours {_distance_text(min(close, key=lambda near: near.proven))}"] if close else []
    )
    return (
        CertificateVerdict.CERTIFIED if kept else CertificateVerdict.FAILED,
        f"collision checked: {'; '.join(parts)}{context}",
    )


def _distance_text(near: PairDistance) -> str:
    """Format the least distance of a pair."""
    return f"{1e3 * near.proven:.1f} mm, {near.names} at {near.time:.2f} s"


def distance_margin(near: PairDistance) -> LimitMargin:
    """Return the margin of a pair to its clearance."""
    bound = near.pair.margin
    return LimitMargin(
        CLEARANCE, near.names, near.time, near.proven, bound, near.proven / max(bound, 1e-6) - 1.0
    )


def _motion_faults(trajectory: Trajectory) -> Iterator[str]:
    """Yield a sentence for each reason why a motion is not periodic from rest to rest."""
    motion, joints = trajectory.motion, trajectory.joints
    period = motion.fourier.period
    samples = period * trajectory.rate
    if abs(samples - round(samples)) > 1e-6:
        yield f"the period {period:g} s is no whole number of samples at {trajectory.rate:g} Hz"
    if motion.periods < 2:
        yield (
            f"{motion.periods} period(s): noise is separated from physics only "
            "when the motion repeats"
        )
    periodic = motion.segment(SegmentKind.FOURIER)
    duration = periodic.end - periodic.start
    if abs(duration - motion.periods * period) > 1e-9 * max(1.0, periodic.end):
        yield (
            f"the periodic part lasts {duration:g} s, not {motion.periods} periods of {period:g} s"
        )
    for before, after in zip(motion.segments, motion.segments[1:], strict=False):
        if abs(before.end - after.start) > 1e-9:
            yield (
                f"{before.kind} ends at {before.end:g} s but {after.kind} starts at "
                f"{after.start:g} s"
            )
        for order, name in enumerate(("position", "velocity", "acceleration")):
            jump = np.abs(_end(motion, before, order) - _begin(motion, after, order))
            j = int(np.argmax(jump))
            if jump[j] > STATE_TOLERANCE:
                yield (
                    f"{name} of {joints[j]} jumps by {jump[j]:.2g} from {before.kind} "
                    f"to {after.kind}"
                )
    for edge, segment in (("start", motion.segments[0]), ("end", motion.segments[-1])):
        evaluate = _begin if edge == "start" else _end
        for order in (1, 2):
            speed = np.abs(evaluate(motion, segment, order))
            if speed.max() > STATE_TOLERANCE:
                yield f"{joints[int(np.argmax(speed))]} is not at rest at the {edge}"


def _begin(motion: Motion, segment: MotionSegment, order: int) -> FloatArray:
    """Return a derivative at the start of a segment. Shape (n,)."""
    part = motion.fourier if segment.profile is None else segment.profile
    return part.at(np.zeros(1), order)[0]


def _end(motion: Motion, segment: MotionSegment, order: int) -> FloatArray:
    """Return a derivative at the end of a segment. Shape (n,)."""
    part = motion.fourier if segment.profile is None else segment.profile
    return part.at(np.array([segment.end - segment.start]), order)[0]


def _criteria_faults(trajectory: Trajectory, recomputed: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each criterion of the file that is missing or wrong."""
    for part, entries in recomputed.items():
        stated = dict(_flatten(trajectory.criteria.get(part, {})))
        for name, value in _flatten(entries):
            if name not in stated:
                yield f"criterion {part}.{name} is missing in the file"
                continue
            stated_value = stated[name]
            if value is None or not np.isfinite(value):
                continue
            if stated_value is None:
                yield f"criterion {part}.{name} is missing in the file"
                continue
            tolerance = CRITERION_TOLERANCE * max(abs(stated_value), 1e-300)
            if abs(value - stated_value) > tolerance:
                yield f"criterion {part}.{name} is {value:.8g}, the file says {stated_value:.8g}"


def _flatten(entries: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float | None]]:
    """Yield the values of nested entries with their keys joined by dots."""
    for key, value in entries.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value
