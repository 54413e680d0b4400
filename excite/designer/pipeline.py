"""Design a trajectory: optimise the periodic motion, add ramps from rest to rest, and certify it.

A motion that fails its certificate is optimised again with more reserve, and the search is repeated
from other initial guesses; a motion that fails is returned only on demand, and then says so.
"""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._system.blas_threads import single_blas_thread
from .._types import FloatArray
from ..collision import clearance_builder
from ..collision.clearance_constraint import ClearanceConstraint
from ..collision.workcell import NOT_CHECKED, Cell
from ..errors import CheckFailed, ExciteError, ExciteWarning, Infeasible, UnusableInput
from ..robot.limits import Limits
from ..robot.parameter_names import plural
from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory
from . import certificate as certificate_module
from . import design_cost, optimize
from .certificate import CLEARANCE, Certificate
from .evaluator import Evaluator
from .motion_overlap import OverlapPenalty
from .multistart import MIN_SPECTRUM_RATIO, Attempt, Progress
from .optimize import DesignSetup, ObjectiveBuilder, OptimizedDesign
from .options import DesignOptions, check_options, check_played_period
from .problem import LIMIT_RESERVE

MAX_LIMIT_RESERVE = 0.3
"""Largest share of torque, braking and box limits that is kept free between samples [1]."""

MAX_TIGHTENINGS = 12
"""Times that a motion is optimised again after its certificate fails [1]."""

STALLED_TIGHTENINGS = 3
"""Consecutive times after which a motion is given up whose violation does not decrease [1]."""

VIOLATION_DECREASE = 0.8
"""Ratio of a violation to the least one before, above which it counts as not decreased [1]."""

MAX_REFINEMENT = 2
"""Largest ratio of the samples to those that were asked for [1]."""

MAX_CERTIFIED_ATTEMPTS = 3
"""Attempts of one search that are tried, the best first, until one is certified."""

MAX_RESTARTS = 3
"""Searches that follow the first one, from other initial guesses, until one is certified."""

MAX_BLIND_RESTARTS = 1
"""The same where no start finds a motion that keeps all limits and excites all base parameters."""

NOTABLE_LOSS = 0.7
"""Loss of the objective, a logarithm, beyond which a warning states that the best motion has no
ramps [1]: a factor of two in the criterion."""

MAX_CLEARANCE_DEFICIT = 5e-3
"""Clearance missed between samples beyond which the samples are too coarse for it [m]."""


@dataclass(frozen=True)
class CertifiedDesign:
    """Certified trajectory and how it was found.

    Attributes:
        trajectory: Content of the trajectory file.
        certificate: Its certificate.
        design: Result of the search for its periodic part, which is its first attempt.
        timing: Durations of the steps, by name [s].
    """

    trajectory: Trajectory
    certificate: Certificate
    design: OptimizedDesign
    timing: dict[str, float] = dataclasses.field(default_factory=dict)


@single_blas_thread()
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
    objective: ObjectiveBuilder | None = None,
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
        objective: Sets the objective that replaces the criterion; None: the criterion.

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
        check_played_period(options.period, options.rate, speed)
    check_options(options)
    design_cost.require(robot, options, speed, progress)
    clearance = None if cell is None else clearance_builder.build_constraint(cell)
    setup = optimize.set_up(
        robot, limits, options, earlier_information, overlap_penalty, clearance, start, objective
    )
    report(f"{robot.name}: {plural(robot.n, 'joint')}, {setup.base.count} base parameters")
    design = optimize.solve(setup, progress)
    timing = {"build": setup.build_time - begun, **design.timing()}

    def certify(design: OptimizedDesign) -> CertifiedDesign:
        motion = design.setup.complete(design.motion).slowed(speed)
        entry = {**_design_entry(design.setup, speed), **(notes or {})}
        options, noise = design.setup.problem.options, design.setup.noise
        trajectory, certificate = certificate_module.certified_trajectory(
            robot, limits, motion, options, noise, entry, cell, unchecked_reason
        )
        return CertifiedDesign(trajectory, certificate, design)

    search = _CertifiedSearch(certify, report)
    result = search.best_of(design)
    for restart in range(1, MAX_RESTARTS + 1):
        # faults of the file are no matter of the motion
        if result is not None and (result.certificate.ok or result.certificate.faults):
            break
        if not design.attempts[0].usable and restart > MAX_BLIND_RESTARTS:
            break
        report(f"{search.reason}; searching from other poses ({restart} of {MAX_RESTARTS})")
        try:
            design = optimize.solve(search.tightened(setup), progress, restart)
        except Infeasible:  # the tightened clearances leave no pose
            design = optimize.solve(setup, progress, restart)
        result = search.best_of(design) or result
    if result is None:
        raise search.error or _unexcited(setup, design)
    _check(robot, result, force, earlier_information)
    timing |= {
        "solve": time.perf_counter() - setup.build_time,
        "total": time.perf_counter() - begun,
    }
    return dataclasses.replace(result, timing=timing)


def _check(
    robot: Robot, result: CertifiedDesign, force: bool, earlier_information: FloatArray | None
) -> None:
    """Raise CheckFailed for a motion that must not be delivered."""
    trajectory, certificate = result.trajectory, result.certificate
    if certificate.faults and not force:
        raise CheckFailed(
            f"{robot.source}: the designed motion fails its certificate: "
            f"{certificate.failure_reason()}; --force delivers it all the same"
        )
    if not certificate.ok and not force:
        remedy = (
            "lower --clearance or clear the scene"
            if certificate.worst().limit == CLEARANCE
            else "lengthen --period or widen that limit"
        )
        raise CheckFailed(
            f"{robot.source}: no motion of {1 + MAX_RESTARTS} searches keeps all limits between "
            f"its samples: {certificate.failure_reason()}; {remedy}, or --force"
        )
    # directions known from earlier recordings need not be excited again, nor the robot of a payload
    is_known = earlier_information is not None or "payload_link" in trajectory.design
    condition = float(trajectory.criteria["optimum"]["geometric"]["cond"])
    if not is_known and not condition < 1.0 / MIN_SPECTRUM_RATIO:
        raise CheckFailed(
            f"{robot.source}: the designed motion does not excite all base parameters; "
            "widen the limits or lengthen --period"
        )


def _unexcited(setup: DesignSetup, design: OptimizedDesign) -> ExciteError:
    """Return the error that says what no motion of a search could show, or keep."""
    robot, attempt = setup.problem.robot, design.attempts[0]
    evaluator = Evaluator(setup.problem)
    x = attempt.state.best
    active = evaluator.active_constraints(x)
    if not attempt.feasible:
        return Infeasible(
            f"{robot.source}: no motion of {1 + MAX_BLIND_RESTARTS} searches keeps all limits: "
            f"{' and '.join(active)} conflict; widen one of them or lengthen --period"
        )
    names = evaluator.unexcited_parameters(x)
    hint = f"; {' and '.join(active)} leave no room to move" if active else ""
    return Infeasible(
        f"{robot.source}: no motion of {1 + MAX_BLIND_RESTARTS} searches excites all base "
        f"parameters: {', '.join(names)} stay unknown{hint}; widen those limits, or design with "
        "--joints for the joints that can move"
    )


class _CertifiedSearch:
    """Certify the motions of searches, with more reserve where a certificate fails.

    Attributes:
        certify: Function that adds ramps to a design and certifies it.
        report: Called with a line of text.
        reason: Why the last motion was not certified.
        error: First error of a motion without ramps.
    """

    def __init__(
        self, certify: Callable[[OptimizedDesign], CertifiedDesign], report: Progress
    ) -> None:
        """Store the functions."""
        self.certify, self.report = certify, report
        self.reason = ""
        self.error: Infeasible | None = None
        self._clearance: ClearanceConstraint | None = None
        self._best_objective = np.inf

    def tightened(self, setup: DesignSetup) -> DesignSetup:
        """Return a design problem with the clearances that the last certificates asked for."""
        if self._clearance is None:
            return setup
        problem = dataclasses.replace(setup.problem, clearance=self._clearance)
        return dataclasses.replace(setup, problem=problem)

    def best_of(self, design: OptimizedDesign) -> CertifiedDesign | None:
        """Return the certified trajectory of the best attempt that has one.

        Returns:
            The result; one whose certificate fails where none is certified; None where no motion
            has ramps, keeps all limits at its samples and excites all base parameters.
        """
        failed: CertifiedDesign | None = None
        usable = [
            a for a in design.attempts if a.usable and a.motion.period == design.motion.period
        ]
        if not usable:
            self.reason = (
                "no motion excites all base parameters"
                if design.attempts[0].feasible
                else "no motion keeps all limits"
            )
        self._best_objective = min([self._best_objective, *(a.objective for a in usable)])
        tried = 0
        for attempt in usable:
            others = (other for other in design.attempts if other is not attempt)
            candidate = OptimizedDesign(design.setup, (attempt, *others))
            try:
                result = self._until_certified(candidate)
            except Infeasible as error:
                self.error = self.error or error
                self.reason = f"no ramps ({str(error).rpartition(': ')[2]})"
                continue
            if result.certificate.ok:
                self._warn_of_loss(attempt)
                return result
            failed = failed or result
            tried += 1
            if tried == MAX_CERTIFIED_ATTEMPTS:
                break
        return failed

    def _warn_of_loss(self, delivered: Attempt) -> None:
        """Warn where the delivered motion is much worse than one that was not certified."""
        loss = delivered.objective - self._best_objective
        if loss > NOTABLE_LOSS:
            warnings.warn(
                f"the best motion found was not certified ({self.reason}); the delivered one is "
                f"worse by a factor of {np.exp(min(loss, 300.0)):.2g} in the criterion",
                ExciteWarning,
                stacklevel=4,
            )

    def _until_certified(self, design: OptimizedDesign) -> CertifiedDesign:
        """Optimise a motion with more reserve until its certificate holds or nothing improves.

        Raises:
            Infeasible: The motion has no ramps.
        """
        result = self.certify(design)
        reserve, least, stalled = LIMIT_RESERVE, np.inf, 0
        asked = design.setup.problem.options.samples
        for _ in range(MAX_TIGHTENINGS):
            if result.certificate.ok or result.certificate.faults:
                break
            self.reason = result.certificate.failure_reason()
            violation = -result.certificate.worst().spare_share
            stalled = 0 if violation < VIOLATION_DECREASE * least else stalled + 1
            least = min(least, violation)
            if stalled >= STALLED_TIGHTENINGS:
                break
            design, reserve = _tighten(
                design, result.certificate, reserve, MAX_REFINEMENT * asked, self.report
            )
            self._clearance = design.setup.problem.clearance
            if not design.attempts[0].usable:
                break
            result = self.certify(design)
        return result


def _tighten(
    design: OptimizedDesign,
    certificate: Certificate,
    reserve: float,
    max_samples: int,
    report: Progress,
) -> tuple[OptimizedDesign, float]:
    """Optimise a motion again with more reserve, or clearance, than its certificate found.

    Returns:
        The new design, and the share of the limits that it keeps free.
    """
    worst, deficits = certificate.worst(), certificate.clearance_deficits()
    # more samples, not more clearance, prevent a motion from passing through thin bodies
    finer = (
        max(deficits.values(), default=0.0) > MAX_CLEARANCE_DEFICIT
        and 2 * design.setup.problem.options.samples <= max_samples
    )
    if worst.limit != CLEARANCE:
        reserve = min(max(2.0 * reserve, reserve - 1.5 * worst.spare_share), MAX_LIMIT_RESERVE)
    report(f"between samples: {worst.describe()}; tightening the constraints")
    added = {pair: 1.5 * min(missed, MAX_CLEARANCE_DEFICIT) for pair, missed in deficits.items()}
    tighter = optimize.tighten(design.setup, reserve, added, finer=finer)
    attempt = design.attempts[0]
    improved = optimize.improve(tighter, design.motion, attempt.number, attempt.state)
    return OptimizedDesign(tighter, (improved, *design.attempts[1:])), reserve


def _design_entry(setup: DesignSetup, speed: float) -> dict[str, Any]:
    """Return the entries of the file's `design` that the options of a design determine."""
    options = setup.problem.options
    return {
        "criterion": options.criterion.value,
        "plain": options.plain,
        "drive": list(options.drive),
        "samples": options.samples,
        "starts": options.starts,
        "uncertainty": options.uncertainty,
        "margin": dict(setup.limits.margin),
        "speed": speed,
        "boxes": [dataclasses.asdict(box) for box in options.boxes],
        **({} if options.payload_link is None else {"payload_link": options.payload_link}),
    }
