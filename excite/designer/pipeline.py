"""Design a trajectory: optimise the periodic motion, add ramps from rest to rest, and certify it.

A motion that fails its certificate is optimised again with more reserve; it is returned only on
demand, and then says so.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import threadpoolctl

from .._types import FloatArray
from ..collision import clearance_builder
from ..collision.workcell import NOT_CHECKED, Cell
from ..errors import CheckFailed, Infeasible, UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory, package_versions
from . import certificate as certificate_module
from . import design_cost, optimize, ramps
from .certificate import CELL_KEY, CLEARANCE, Certificate
from .motion_overlap import OverlapPenalty
from .multistart import Progress
from .optimize import OptimizedDesign
from .options import DesignOptions, check_options, samples_per_period
from .problem import LIMIT_RESERVE

CertifiedTrajectory = tuple[Trajectory, Certificate]

MAX_LIMIT_RESERVE = 0.3
"""Largest share of torque, braking and box limits that is kept free between samples [1]."""

MAX_TIGHTENINGS = 3
"""Times that a motion is optimised again after its certificate fails [1]."""

MAX_CLEARANCE_DEFICIT = 5e-3
"""Clearance missed between samples beyond which the samples are too coarse for it [m]."""

SINGULAR_EIGENVALUE_RATIO = 1e-24
"""Ratio of eigenvalues of the information below which a direction is rounding noise [1]."""


@dataclass(frozen=True)
class CertifiedDesign:
    """Certified trajectory and how it was found.

    Attributes:
        trajectory: Content of the trajectory file.
        certificate: Its certificate.
        design: Result of the search for its periodic part.
        timing: Durations of the steps, by name [s].
    """

    trajectory: Trajectory
    certificate: Certificate
    design: OptimizedDesign
    timing: dict[str, float]


# on small matrices threads cost more than they gain
@threadpoolctl.threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def design_trajectory(
    robot: Robot,
    limits: Limits,
    options: DesignOptions,
    *,
    start: FloatArray | None = None,
    earlier_information: FloatArray | None = None,
    overlap_penalty: OverlapPenalty | None = None,
    cell: Cell | None = None,
    unchecked_reason: str = NOT_CHECKED,
    notes: dict[str, Any] | None = None,
    speed: float = 1.0,
    force: bool = False,
    progress: Progress | None = None,
) -> CertifiedDesign:
    """Design and certify a trajectory.

    Args:
        robot: The robot.
        limits: Its limits.
        options: Options of the design.
        start: Pose at which the motion starts and ends at rest; None: near the periodic motion.
            Shape (n,).
        earlier_information: Information of earlier recordings in standard parameters.
            Shape (P, P).
        overlap_penalty: Penalty on similarity to another motion, for a validation motion.
        cell: Surroundings to keep clear of; None: distances are not checked.
        unchecked_reason: Sentence that the file states where `cell` is None.
        notes: Further entries of the file's `design`.
        speed: Share of the designed speed at which the motion is delivered [1].
        force: Return a motion even when its certificate fails.
        progress: Called with a line of text now and then.

    Raises:
        CheckFailed: The certificate fails and `force` is not set.
        Infeasible: No motion or ramp obeys the limits.
        UnusableInput: Options are inconsistent.
    """
    report = progress or (lambda text: None)
    begun = time.perf_counter()
    if not 0.0 < speed <= 1.0:
        raise UnusableInput(f"--speed {speed:g} should be above 0 and at most 1")
    if options.free_period is None:
        samples_per_period(options.period / speed, options.rate)
    check_options(options)
    design_cost.require(robot, options, speed, progress)
    clearance = None if cell is None else clearance_builder.build_constraint(cell)
    setup = optimize.set_up(
        robot, limits, options, earlier_information, overlap_penalty, clearance, start
    )
    if start is not None:  # the search needs a valid start pose
        ramps.check_start_pose(setup.constraints(limits.reduced()), start)
    report(f"{robot.name}: {robot.n} joints, {setup.base.count} base parameters")
    design = optimize.solve(setup, progress)
    timing = {"build": setup.build_time - begun, **design.timing()}
    entries = {**(notes or {}), **({} if cell is None else {CELL_KEY: cell.document()})}

    def certify(design: OptimizedDesign) -> CertifiedTrajectory:
        trajectory = _assemble(design, robot, limits, start, speed, entries, unchecked_reason)
        return trajectory, certificate_module.verify(
            trajectory, robot, limits, cell, unchecked_reason=unchecked_reason
        )

    design, (trajectory, certificate) = _add_ramps(design, certify)
    reserve = LIMIT_RESERVE
    for _ in range(MAX_TIGHTENINGS):
        if certificate.ok:
            break
        design, reserve = _tighten(design, limits, certificate, reserve, report)
        trajectory, certificate = certify(design)
    timing |= {
        "solve": time.perf_counter() - setup.build_time,
        "total": time.perf_counter() - begun,
    }
    _check(robot, trajectory, certificate, force, earlier_information)
    trajectory = dataclasses.replace(
        trajectory,
        margins=[m.document() for m in certificate.margins],
        collision=certificate.collision,
        forced=not certificate.ok,
    )
    return CertifiedDesign(trajectory, certificate, design, timing)


def _check(
    robot: Robot,
    trajectory: Trajectory,
    certificate: Certificate,
    force: bool,
    earlier_information: FloatArray | None,
) -> None:
    """Raise CheckFailed for a motion that must not be delivered."""
    if not certificate.ok and not force:
        raise CheckFailed(
            f"{robot.source}: the designed motion fails its certificate: "
            f"{certificate.failure_reason()}; try another --seed or --force"
        )
    # directions known from earlier recordings need not be excited again
    if earlier_information is None and not _condition(trajectory) < 1.0 / SINGULAR_EIGENVALUE_RATIO:
        raise CheckFailed(
            f"{robot.source}: the designed motion does not excite all base parameters; "
            "try another --seed, fewer limits or a longer --period"
        )


def _condition(trajectory: Trajectory) -> float:
    """Return the geometric condition number of the periodic part."""
    return float(trajectory.criteria["optimum"]["geometric"]["cond"])


def _add_ramps(
    design: OptimizedDesign, certify: Callable[[OptimizedDesign], CertifiedTrajectory]
) -> tuple[OptimizedDesign, CertifiedTrajectory]:
    """Return the best attempt for which ramps, approach and return exist, and its trajectory.

    Raises:
        Infeasible: No attempt has them; the error is that of the best attempt.
    """
    first_error = None
    for attempt in design.attempts:
        if attempt.motion.period != design.motion.period:  # its period was not rounded
            continue
        others = (other for other in design.attempts if other is not attempt)
        candidate = OptimizedDesign(design.setup, (attempt, *others))
        try:
            return candidate, certify(candidate)
        except Infeasible as error:
            first_error = first_error or error
    assert first_error is not None
    raise first_error


def _tighten(
    design: OptimizedDesign,
    limits: Limits,
    certificate: Certificate,
    reserve: float,
    report: Progress,
) -> tuple[OptimizedDesign, float]:
    """Optimise a motion again with more reserve, or clearance, than its certificate found.

    Returns:
        The new design, and the share of the limits that it keeps free.
    """
    worst, deficits = certificate.worst(), certificate.clearance_deficits()
    # more samples, not more clearance, prevent a motion from passing through thin bodies
    finer = max(deficits.values(), default=0.0) > MAX_CLEARANCE_DEFICIT
    if worst.limit != CLEARANCE:
        reserve = min(max(2.0 * reserve, reserve - 1.5 * worst.spare_share), MAX_LIMIT_RESERVE)
    report(f"between samples: {worst.describe()}; tightening the constraints")
    added = {pair: 1.5 * min(missed, MAX_CLEARANCE_DEFICIT) for pair, missed in deficits.items()}
    tighter = optimize.tighten(design.setup, limits, reserve, added, finer=finer)
    improved = optimize.improve(tighter, design.motion, design.attempts[0].number)
    return OptimizedDesign(tighter, (improved, *design.attempts[1:])), reserve


def _assemble(
    design: OptimizedDesign,
    robot: Robot,
    limits: Limits,
    start: FloatArray | None,
    speed: float,
    notes: dict[str, Any],
    unchecked_reason: str,
) -> Trajectory:
    """Return the content of the trajectory file, with ramps but before its certificate."""
    setup = design.setup
    options = setup.problem.options
    usable = ramps.with_derived_limits(limits, design.motion).reduced()
    motion = ramps.plan_rest_to_rest(
        setup.constraints(usable), design.motion, options.periods, options.rate, start
    )
    if speed != 1.0:
        motion = motion.slowed(speed)
    entry = {
        "criterion": options.criterion.value,
        "plain": options.plain,
        "drive": list(options.drive),
        "samples": options.samples,
        "starts": options.starts,
        "uncertainty": options.uncertainty,
        "margin": dict(limits.margin),
        "speed": speed,
        "boxes": [dataclasses.asdict(box) for box in options.boxes],
        **notes,
    }
    draft = Trajectory(
        robot={"name": robot.name, "source": robot.source, "sha256": robot.sha256, **robot.options},
        motion=motion,
        rate=options.rate,
        limits=ramps.with_derived_limits(limits, motion.fourier),
        noise=setup.noise,
        design=entry,
        criteria={},
        margins=[],
        collision=unchecked_reason,
        seed=options.seed,
        versions=package_versions(),
    )
    return dataclasses.replace(
        draft,
        criteria=certificate_module.recompute_criteria(
            draft, robot, limits, setup.problem.parameters
        ),
    )
