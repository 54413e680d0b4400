"""The certificate: limits and clearance of a finished motion, recomputed from its file, the robot's URDF and the cell on disk.

Nothing that the file says about itself is taken for a result. Limits come from where the file says they come from, torques from
Pinocchio, distances from the shapes and meshes as they are on disk now; the Fourier part is bounded between samples by the
oversampling bound, ramps at the knots and the extremes of each cubic.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from ..collision import continuous_check, scene_file
from ..collision.continuous_check import Near
from ..collision.workcell import NOT_CHECKED, Cell
from ..robot import base_parameters, dynamics, inertial_parameters
from ..robot.limits import DERIVED, QUANTITIES, WITH_MARGIN, Limits, from_sources
from ..robot.robot import Robot
from ..robot.samples import Samples
from ..trajectory.fourier import VERIFICATION_DENSITY, oversampling_bound
from ..trajectory.rest_to_rest import Motion, MotionSegment
from ..trajectory.trajectory_file import Trajectory
from . import constraint_margins, criteria
from .constraint_margins import BoundedQuantity, MotionConstraints
from .options import WorkspaceBox
from .ramps import with_derived_limits

Array = np.ndarray
RELATIVE_ROUNDING = 1e-9
"""Share of a limit by which rounding may exceed it [1]."""
CELL_KEY = "cell"
CLEARANCE = "clearance"
MAX_LISTED_FAULTS = 3
"""Faults that a line of the verdict lists; `faults` of the document has all."""
MAX_LISTED_PAIRS = 12
"""Pairs of bodies that a certificate lists, the nearest to their margin."""
MIN_STEPS_PER_PIECE = 4
"""Least number of steps over one polynomial piece of a ramp for what has no closed form (torque, frames) [1]."""


class CertificateVerdict(Enum):
    """What a certificate says about one of its two parts."""

    CERTIFIED = "certified"
    FAILED = "failed"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True)
class LimitMargin:
    """How near one joint comes to one limit: the worst value with its time [s], and the bound it must not pass.

    room: distance to the bound over the half width of the allowed range; negative where the limit is broken.
    required: room that the file promises to keep.
    """

    limit: str
    joint: str
    time: float
    value: float
    bound: float
    free_share: float
    required_share: float = 0.0

    @property
    def spare_share(self) -> float:
        """Room beyond what is required; negative where the limit, or the promised margin, is broken."""
        return self.free_share - self.required_share

    def words(self) -> str:
        """The value reached and the bound, in a sentence."""
        if self.limit == CLEARANCE:
            state = f"come within {1e3 * self.value:.1f} mm" if self.value > 0.0 else "collide"
            return (
                f"{self.joint} {state} at {self.time:.2f} s, of {1e3 * self.bound:.1f} mm to keep"
            )
        text = f"{self.limit} of '{self.joint}' reaches {self.value:.4g} of {self.bound:.4g} at {self.time:.3f} s"
        return (
            text
            if self.free_share < -RELATIVE_ROUNDING or not self.required_share
            else f"{text}, where {format_percent(self.required_share)} should stay free"
        )

    def document(self) -> dict[str, Any]:
        """The margin as `excite verify --json` prints it."""
        return {
            "limit": self.limit,
            "joint": self.joint,
            "time": self.time,
            "value": self.value,
            "bound": self.bound,
            "margin": self.free_share,
        }


@dataclass(frozen=True)
class Certificate:
    """The result of verification.

    margins: nearest first. criteria: recomputed. faults: sentences about the file itself (a jump, a limit that differs from its source).
    clearance: verdict on distances, which `collision` explains. near: pairs of bodies with the least distance each, the one nearest to
    its margin first.
    """

    margins: tuple[LimitMargin, ...]
    criteria: Mapping[str, Any]
    faults: tuple[str, ...]
    clearance: CertificateVerdict = CertificateVerdict.NOT_CHECKED
    collision: str = NOT_CHECKED
    pair_distances: tuple[Near, ...] = ()
    joints: tuple[str, ...] = ()

    @property
    def limits(self) -> CertificateVerdict:
        """Verdict on the limits and on the file itself."""
        kept = all(
            margin.spare_share >= -RELATIVE_ROUNDING for margin in self.margins if margin.limit != CLEARANCE
        )
        return CertificateVerdict.CERTIFIED if kept and not self.faults else CertificateVerdict.FAILED

    @property
    def ok(self) -> bool:
        """Nothing failed; the clearance may be unchecked."""
        return self.limits is CertificateVerdict.CERTIFIED and self.clearance is not CertificateVerdict.FAILED

    def worst(self) -> LimitMargin:
        """The margin with the least room to spare."""
        return min(self.margins, key=lambda margin: margin.spare_share)

    def clearance_deficits(self) -> dict[str, float]:
        """By how much each pair that breaks its clearance misses it [m]."""
        return {
            m.joint: m.bound - m.value
            for m in self.margins
            if m.limit == CLEARANCE and m.free_share < -RELATIVE_ROUNDING
        }

    def verdict_lines(self) -> tuple[str, str]:
        """Both verdicts, one line each; the clearance first, so that nothing unchecked follows a certificate."""
        nearest = min(
            (m for m in self.margins if m.limit != CLEARANCE), key=lambda margin: margin.spare_share
        )
        detail = f"nearest: {nearest.limit} of {nearest.joint}, {nearest.value:.5g} of {nearest.bound:.5g} at {nearest.time:.3f} s"
        more = len(self.faults) - MAX_LISTED_FAULTS
        faults = [*self.faults[:MAX_LISTED_FAULTS], *([f"and {more} more faults"] if more > 0 else [])]
        limits = [self.limits.value, *faults, f"{detail} ({format_percent(nearest.free_share)} free)"]
        return (
            f"clearance: {self.clearance.value}; {self.collision}",
            f"limits: {'; '.join(limits)}",
        )

    def failure_reason(self) -> str:
        """Why the certificate fails, in one sentence."""
        if self.faults:
            return self.faults[0]
        worst = self.worst()
        return worst.words() if worst.spare_share < -RELATIVE_ROUNDING else self.collision

    def document(self) -> dict[str, Any]:
        """The certificate as `excite verify --json` prints it."""
        return {
            "ok": self.ok,
            "verdict": {"limits": self.limits.value, "clearance": self.clearance.value},
            "margins": [margin.document() for margin in self.margins],
            "criteria": dict(self.criteria),
            "collision": self.collision,
            "clearance": [near.document(self.joints) for near in self.pair_distances[:MAX_LISTED_PAIRS]],
            "faults": list(self.faults),
        }


def format_percent(share: float) -> str:
    """A share as text; what is zero within rounding has no sign."""
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
    unchecked: str = NOT_CHECKED,
    cell_fault: str | None = None,
) -> Certificate:
    """Recompute every limit, the distances, the junctions, the rests and the criteria of a trajectory.

    Args:
        trajectory: The file's content.
        robot: The robot it was designed for.
        limits: The limits that hold, from their sources; `limits.of_trajectory` reads them. Those of the file are compared with them.
        cell: What must not be touched, as it is now; None: distances are not checked.
        unchecked: Why `cell` is None.
        cell_fault: Why the cell is not the one that the motion was designed for; the clearance fails.

    Returns:
        The certificate; nothing is raised for a motion that fails.
    """
    truth = with_derived_limits(limits, trajectory.motion.fourier)
    subject = motion_constraints(trajectory, robot, truth)
    margins = limit_margins(trajectory, subject)
    clearance, collision, near = _clearance(trajectory, cell, unchecked, cell_fault)
    margins += [_distance_margin(one) for one in near[:MAX_LISTED_PAIRS]]
    scores = recompute_criteria(trajectory, robot, truth, subject.parameters)
    faults = (
        *_limit_faults(trajectory.limits, truth),
        *_motion_faults(trajectory),
        *_criteria_faults(trajectory, scores),
    )
    ordered = tuple(sorted(margins, key=lambda margin: margin.free_share))
    return Certificate(ordered, scores, faults, clearance, collision, tuple(near), robot.joints)


def motion_constraints(trajectory: Trajectory, robot: Robot, limits: Limits) -> MotionConstraints:
    """What a trajectory is held against: the robot, its limits, and the uncertainty and boxes that the design promised."""
    design = trajectory.design
    standard = inertial_parameters.standard(
        robot, limits, design.get("drive", inertial_parameters.DRIVE)
    )
    boxes = tuple(
        WorkspaceBox(b["frame"], tuple(b["lower"]), tuple(b["upper"])) for b in design.get("boxes", ())
    )
    return MotionConstraints(robot, limits, standard, float(design.get("uncertainty", 0.0)), boxes)


def recompute_criteria(
    trajectory: Trajectory, robot: Robot, limits: Limits, standard: inertial_parameters.Parameters
) -> dict[str, Any]:
    """All criteria of the Fourier part on the optimiser's grid, and of the motion as exported."""
    motion = trajectory.motion
    found = base_parameters.find(robot, standard, limits)
    samples = int(trajectory.design.get("samples", round(motion.fourier.period * trajectory.rate)))
    parts = {
        "optimum": motion.fourier.samples(motion.fourier.grid(samples)),
        "exported": motion.samples(motion.grid(trajectory.rate)),
    }
    return {
        name: criteria.evaluate_criteria(
            dynamics.regressor_blocks(robot, standard, part), found, trajectory.noise
        )
        for name, part in parts.items()
    }


def verify_file(
    trajectory: Trajectory,
    robot: Robot,
    *,
    folder: Path | None = None,
    limits_file: Path | None = None,
    packages: Sequence[str] = (),
) -> Certificate:
    """Verify a trajectory that was read from a file, against its limits' sources and the cell as they are on disk now.

    Args:
        trajectory: The file's content.
        robot: The robot of its URDF.
        folder: The folder that the file is in, where a limits file is looked for too.
        limits_file: Where the limits file is now; None: where the trajectory says.
        packages: Further folders of `package://` meshes.

    Raises:
        UnusableInput: The limits file is not there or cannot be read.
    """
    truth = from_sources(robot, trajectory.limits, limits_file, folder)
    if CELL_KEY not in trajectory.design:
        return verify(
            trajectory,
            robot,
            truth,
            unchecked_reason=f"{NOT_CHECKED}: the file states no shapes to keep clear of",
        )
    cell, fault = scene_file.as_on_disk(robot, truth, trajectory.design[CELL_KEY], packages)
    return verify(trajectory, robot, truth, cell, cell_fault=fault)


# -- limits ----------------------------------------------------------------------------------------------------------


def limit_margins(trajectory: Trajectory, subject: MotionConstraints) -> list[LimitMargin]:
    """The least margin of every limit of every joint over a motion. subject: with the limits that hold, derived ones included."""
    margins: dict[tuple[str, str], LimitMargin] = {}
    for segment in trajectory.motion.segments:
        for times, demand in _demands(subject, trajectory, segment):
            for margin in _margins(demand, times, _promised(trajectory, demand.limit)):
                if segment.profile is None and _is_derived(subject.limits, subject.robot, margin):
                    continue
                key = (margin.limit, margin.joint)
                if key not in margins or margin.free_share < margins[key].free_share:
                    margins[key] = margin
    return list(margins.values())


def broken_when_slowed(
    trajectory: Trajectory, robot: Robot, limits: Limits, speed: float
) -> LimitMargin | None:
    """The limit that the same path breaks most at a share of its speed, None where it keeps all.

    A slower run is not safe by itself: where inertia helps the actuator against gravity, less speed asks for more torque.
    """
    slower = replace(trajectory, motion=trajectory.motion.slowed(speed))
    subject = motion_constraints(slower, robot, with_derived_limits(limits, slower.motion.fourier))
    worst = min(limit_margins(slower, subject), key=lambda margin: margin.free_share)
    return worst if worst.free_share < -RELATIVE_ROUNDING else None


def _promised(trajectory: Trajectory, limit: str) -> float:
    """Share of a limit that the design promises to keep free."""
    return (
        float(trajectory.design.get("margin", {}).get(limit, 0.0)) if limit in WITH_MARGIN else 0.0
    )


def _is_derived(limits: Limits, robot: Robot, margin: LimitMargin) -> bool:
    """Whether a limit is stated by nobody: then it binds the ramps only."""
    return (
        margin.limit in limits.sources
        and margin.joint in robot.joints
        and limits.sources[margin.limit][robot.joints.index(margin.joint)] == DERIVED
    )


def _demands(
    subject: MotionConstraints, trajectory: Trajectory, segment: MotionSegment
) -> Iterator[tuple[Array, BoundedQuantity]]:
    """Demands of one segment with the times of their samples [s]."""
    if segment.profile is None:
        yield from _fourier_demands(subject, trajectory, segment)
    else:
        yield from _ramp_demands(subject, trajectory, segment)


def _fourier_demands(
    subject: MotionConstraints, trajectory: Trajectory, segment: MotionSegment
) -> Iterator[tuple[Array, BoundedQuantity]]:
    """One period stands for all; derivatives are bounded between samples by Ehlich and Zeller's factor."""
    fourier = trajectory.motion.fourier
    count = VERIFICATION_DENSITY * max(int(trajectory.design.get("samples", 100)), 8 * fourier.harmonics)
    t = fourier.grid(count)
    factor = oversampling_bound(count, fourier.harmonics) - 1.0
    for order, limit in enumerate(("position", "velocity", "acceleration", "jerk")):
        values = fourier.at(t, order)
        swing = values - (fourier.offset if order == 0 else 0.0)
        more = factor * np.abs(swing).max(axis=0)
        yield (
            segment.start + t,
            constraint_margins.joint_quantity(limit, subject, values - more, values + more),
        )
    closed = np.append(t, fourier.period)  # second differences across the end of the period
    for demand in constraint_margins.model_quantities(subject, fourier.samples(closed)):
        yield segment.start + closed, demand


def _ramp_demands(
    subject: MotionConstraints, trajectory: Trajectory, segment: MotionSegment
) -> Iterator[tuple[Array, BoundedQuantity]]:
    """Exact for position, velocity, acceleration and jerk; torque and frames are sampled within each piece and bounded between."""
    profile, length = segment.profile, segment.end - segment.start
    assert profile is not None
    times = profile.critical_times(length)
    for order, limit in enumerate(("position", "velocity", "acceleration")):
        values = profile.at(times, order)
        yield segment.start + times, constraint_margins.joint_quantity(limit, subject, values, values)
    middle = 0.5 * (times[:-1] + times[1:])
    jerk = profile.at(middle, 3)
    yield segment.start + middle, constraint_margins.joint_quantity("jerk", subject, jerk, jerk)
    step = min(
        trajectory.motion.fourier.period / (VERIFICATION_DENSITY * int(trajectory.design.get("samples", 100))),
        1.0 / trajectory.rate,
    )
    counts = np.maximum(np.ceil(np.diff(times) / step).astype(int), MIN_STEPS_PER_PIECE)
    dense = np.concatenate(
        [np.linspace(a, b, n + 1) for a, b, n in zip(times[:-1], times[1:], counts, strict=True)]
    )
    samples = Samples(*(profile.at(dense, order) for order in range(3)))
    for demand in constraint_margins.model_quantities(
        subject, samples, np.repeat(np.arange(len(counts)), counts + 1)
    ):
        yield segment.start + dense, demand


def _margins(demand: BoundedQuantity, times: Array, required: float) -> Iterator[LimitMargin]:
    half = 0.5 * (demand.upper - demand.lower)
    for j, name in enumerate(demand.names):
        if not np.isfinite(half[j]):
            continue
        above, below = int(np.argmax(demand.high[:, j])), int(np.argmin(demand.low[:, j]))
        up = float((demand.upper[j] - demand.high[above, j]) / half[j])
        down = float((demand.low[below, j] - demand.lower[j]) / half[j])
        if up <= down:
            yield LimitMargin(
                demand.limit,
                name,
                float(times[above]),
                float(demand.high[above, j]),
                float(demand.upper[j]),
                up,
                required,
            )
        else:
            yield LimitMargin(
                demand.limit,
                name,
                float(times[below]),
                float(demand.low[below, j]),
                float(demand.lower[j]),
                down,
                required,
            )


def _limit_faults(stated: Limits, truth: Limits) -> Iterator[str]:
    """Limits of the file that differ from their source."""
    for quantity in QUANTITIES:
        for i, joint in enumerate(truth.joints):
            said, right = getattr(stated, quantity)[i], getattr(truth, quantity)[i]
            if not np.allclose(said, right, rtol=RELATIVE_ROUNDING, atol=0.0):
                source = truth.sources[quantity][i] or "its source"
                yield f"the {quantity} limit of '{joint}' is {_limit_words(said)} in the file, but {_limit_words(right)} by {source}"
    for joint, said, right in zip(truth.joints, stated.braking, truth.braking, strict=True):
        if said != right:
            yield f"the braking limit of '{joint}' in the file is not that of its source"


def _limit_words(value: Array) -> str:
    numbers = np.atleast_1d(value)
    if not np.isfinite(numbers).all():
        return "absent"
    return " to ".join(f"{number:g}" for number in numbers)


# -- clearance -------------------------------------------------------------------------------------------------------


def _clearance(
    trajectory: Trajectory, cell: Cell | None, unchecked: str, fault: str | None
) -> tuple[CertificateVerdict, str, list[Near]]:
    """Verdict on the distances, a sentence about them, and the least distance of each pair."""
    if fault is not None:
        return CertificateVerdict.FAILED, fault, []
    if cell is None:
        return CertificateVerdict.NOT_CHECKED, unchecked, []
    inside = continuous_check.contained(cell, trajectory.motion.at(np.zeros(1))[0])
    if inside is not None:
        return CertificateVerdict.FAILED, f"COLLISION: {cell.names(inside)}, one begins inside the other", []
    near = continuous_check.along(cell, trajectory.motion)
    context = "".join(f"; {note}" for note in (cell.floor_words(), *cell.notes))
    if not near:
        return CertificateVerdict.CERTIFIED, f"collision checked: nothing can meet{context}", []
    worst = min(near, key=lambda one: one.proven)
    if worst.proven <= 0.0:
        return CertificateVerdict.FAILED, f"COLLISION: {worst.names} at {worst.time:.2f} s{context}", near
    kept = all(_distance_margin(one).free_share >= -RELATIVE_ROUNDING for one in near)
    wide = [one for one in near if one.pair.margin >= cell.margin]
    parts = (
        [f"never less than {_distance_words(min(wide, key=lambda one: one.proven))}"]
        if wide
        else []
    )
    close = [one for one in near if one.pair.margin < cell.margin]
    parts += (
        [f"neighbours {_distance_words(min(close, key=lambda one: one.proven))}"] if close else []
    )
    return (
        CertificateVerdict.CERTIFIED if kept else CertificateVerdict.FAILED,
        f"collision checked: {'; '.join(parts)}{context}",
        near,
    )


def _distance_words(near: Near) -> str:
    return f"{1e3 * near.proven:.1f} mm, {near.names} at {near.time:.2f} s"


def _distance_margin(near: Near) -> LimitMargin:
    bound = near.pair.margin
    return LimitMargin(
        CLEARANCE, near.names, near.time, near.proven, bound, near.proven / max(bound, 1e-6) - 1.0
    )


# -- the motion itself -----------------------------------------------------------------------------------------------


def _motion_faults(trajectory: Trajectory) -> Iterator[str]:
    """Sentences about what makes a motion no motion from rest to rest with whole periods."""
    motion, joints = trajectory.motion, trajectory.joints
    samples = motion.fourier.period * trajectory.rate
    if abs(samples - round(samples)) > 1e-6:
        yield f"the period {motion.fourier.period:g} s is no whole number of samples at {trajectory.rate:g} Hz"
    if motion.periods < 2:
        yield f"{motion.periods} period(s): noise can be told from physics only when the motion repeats"
    periodic = motion.segment("fourier")
    if abs(periodic.end - periodic.start - motion.periods * motion.fourier.period) > 1e-9 * max(
        1.0, periodic.end
    ):
        yield f"the periodic part lasts {periodic.end - periodic.start:g} s, not {motion.periods} periods of {motion.fourier.period:g} s"
    for before, after in zip(motion.segments, motion.segments[1:], strict=False):
        if abs(before.end - after.start) > 1e-9:
            yield f"{before.kind} ends at {before.end:g} s but {after.kind} starts at {after.start:g} s"
        for order, name in enumerate(("position", "velocity", "acceleration")):
            jump = np.abs(_end(motion, before, order) - _begin(motion, after, order))
            j = int(np.argmax(jump))
            if jump[j] > 1e-7:
                yield f"{name} of {joints[j]} jumps by {jump[j]:.2g} from {before.kind} to {after.kind}"
    for edge, segment in (("start", motion.segments[0]), ("end", motion.segments[-1])):
        read = _begin if edge == "start" else _end
        for order in (1, 2):
            speed = np.abs(read(motion, segment, order))
            if speed.max() > 1e-7:
                yield f"{joints[int(np.argmax(speed))]} is not at rest at the {edge}"


def _begin(motion: Motion, segment: MotionSegment, order: int) -> Array:
    zero = np.zeros(1)
    out: Array = (
        motion.fourier.at(zero, order)
        if segment.profile is None
        else segment.profile.at(zero, order)
    )[0]
    return out


def _end(motion: Motion, segment: MotionSegment, order: int) -> Array:
    at = np.array([segment.end - segment.start])
    out: Array = (
        motion.fourier.at(at, order) if segment.profile is None else segment.profile.at(at, order)
    )[0]
    return out


def _criteria_faults(trajectory: Trajectory, found: Mapping[str, Any]) -> Iterator[str]:
    """Criteria that the file states and that come out otherwise; a criterion that is missing is a fault too."""
    for part, entries in found.items():
        stated = dict(_flat(trajectory.criteria.get(part, {})))
        for name, again in _flat(entries):
            if name not in stated:
                yield f"criterion {part}.{name} is missing in the file"
                continue
            value = stated[name]
            if value is None or again is None or not np.isfinite(again):
                continue
            if abs(again - value) > 1e-5 * max(abs(value), 1e-300):
                yield f"criterion {part}.{name} is {again:.8g}, the file says {value:.8g}"


def _flat(entries: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float | None]]:
    for key, value in entries.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value
