"""The whole way once: optimise, make it rest-to-rest, certify; nothing leaves here that breaks a limit unsaid."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import threadpoolctl

from ..collision import clearance_builder
from ..collision.workcell import NOT_CHECKED, Cell
from ..errors import CheckFailed, Infeasible, UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory, versions
from . import certificate as certificate_module
from . import design_cost, optimize, ramps
from .certificate import CELL, CLEARANCE, Certificate
from .motion_overlap import Apart
from .multistart import Progress
from .optimize import Design
from .problem import RESERVE, Options

Array = np.ndarray
Whole = tuple[Trajectory, Certificate]


MOST_RESERVE = 0.3
TIGHTENINGS = 3
"""Times that a motion is improved on when its certificate fails."""
COARSE = 5e-3
"""Clearance that a motion may lack between samples without these being too coarse for it [m]."""
SINGULAR = 1e-24
"""Ratio of eigenvalues of the information below which a direction is rounding noise, not seen."""


@dataclass(frozen=True)
class Delivery:
    """A certified motion with how it came about. timing: seconds, the contract's keys."""

    trajectory: Trajectory
    certificate: Certificate
    design: Design
    timing: dict[str, float]


@threadpoolctl.threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]  # small matrices: threads cost more than they bring
def run(
    robot: Robot,
    limits: Limits,
    options: Options,
    *,
    start: Array | None = None,
    given: Array | None = None,
    apart: Apart | None = None,
    cell: Cell | None = None,
    unchecked: str = NOT_CHECKED,
    notes: dict[str, Any] | None = None,
    speed: float = 1.0,
    force: bool = False,
    progress: Progress | None = None,
) -> Delivery:
    """Design, smooth and certify a trajectory.

    start: pose at which the motion begins and ends at rest, or None. given: information of earlier recordings.
    apart: another motion that this one should keep apart from, for validation. cell: what must not be touched; None: collisions are
    not checked, and `unchecked` says so in the file.
    notes: further facts for the file's `design` entry. speed: the motion is delivered at this share of the speed it was
    designed for. Raises CheckFailed when the certificate fails and `force` is
    not set, Infeasible when no motion or ramp obeys the limits, UnusableInput for options that contradict themselves.
    """
    say = progress or (lambda text: None)
    begun = time.perf_counter()
    if not 0.0 < speed <= 1.0:
        raise UnusableInput(f"--speed {speed:g} should be above 0 and at most 1")
    if options.free_period is None:
        optimize.whole_samples(options.period / speed, options.rate)
    optimize.check(options)
    design_cost.require(robot, options, speed, progress)
    clearance = None if cell is None else clearance_builder.clearance(cell)
    setting = optimize.prepare(robot, limits, options, given, apart, clearance, start)
    if start is not None:  # before the optimisation, which begins within its sight
        ramps.check_start(setting.subject(limits.reduced()), start)
    say(f"{robot.name}: {robot.n} joints, {setting.base.count} base parameters")
    found = optimize.solve(setting, progress)
    timing = {"build": setting.built - begun, **found.timing()}
    facts = {**(notes or {}), **({} if cell is None else {CELL: cell.document()})}

    def certified(found: Design) -> Whole:
        trajectory = _assemble(found, robot, limits, start, speed, facts, unchecked)
        return trajectory, certificate_module.verify(
            trajectory, robot, limits, cell, unchecked=unchecked
        )

    found, (trajectory, certificate) = _with_ramps(found, certified)
    reserve = RESERVE
    for _ in range(TIGHTENINGS):
        if certificate.ok:
            break
        found, reserve = _tightened(found, limits, certificate, reserve, say)
        trajectory, certificate = certified(found)
    timing |= {"solve": time.perf_counter() - setting.built, "total": time.perf_counter() - begun}
    _check(robot, trajectory, certificate, force, given)
    trajectory = dataclasses.replace(
        trajectory,
        margins=[m.document() for m in certificate.margins],
        collision=certificate.collision,
        forced=not certificate.ok,
    )
    return Delivery(trajectory, certificate, found, timing)


def _check(
    robot: Robot, trajectory: Trajectory, certificate: Certificate, force: bool, given: Array | None
) -> None:
    """Raise CheckFailed for a motion that should not leave."""
    if not certificate.ok and not force:
        raise CheckFailed(
            f"{robot.source}: the designed motion fails its certificate: {certificate.reason()}; try another --seed or --force"
        )
    # what earlier recordings gave need not be shown again
    if given is None and not trajectory.criteria["optimum"]["geometric"]["cond"] < 1.0 / SINGULAR:
        raise CheckFailed(
            f"{robot.source}: the motion found does not show all base parameters; try another --seed, fewer limits or a longer --period"
        )


def _with_ramps(found: Design, certified: Callable[[Design], Whole]) -> tuple[Design, Whole]:
    """The best attempt that ramps, approach and return go with. Raises what the best of all lacks where none has them."""
    lacks = None
    for one in found.attempts:
        if one.motion.period != found.motion.period:  # not settled on whole samples
            continue
        first = Design(
            found.setting, (one, *(other for other in found.attempts if other is not one))
        )
        try:
            return first, certified(first)
        except Infeasible as error:
            lacks = lacks or error
    assert lacks is not None
    raise lacks


def _tightened(
    found: Design, limits: Limits, certificate: Certificate, reserve: float, say: Progress
) -> tuple[Design, float]:
    """The design with more reserve or clearance, as its certificate found too little of them between samples; and the reserve."""
    worst, short = certificate.worst(), certificate.short_of_clearance()
    # things that are slipped through between samples are met on a finer grid, not by more clearance
    finer = max(short.values(), default=0.0) > COARSE
    if worst.limit != CLEARANCE:
        reserve = min(max(2.0 * reserve, reserve - 1.5 * worst.spare), MOST_RESERVE)
    say(f"between samples {worst.words()}; tightening")
    lacking = {pair: 1.5 * min(missed, COARSE) for pair, missed in short.items()}
    tighter = optimize.tightened(found.setting, limits, reserve, lacking, finer=finer)
    return Design(
        tighter,
        (optimize.improve(tighter, found.motion, found.attempts[0].number), *found.attempts[1:]),
    ), reserve


def _assemble(
    found: Design,
    robot: Robot,
    limits: Limits,
    start: Array | None,
    speed: float,
    notes: dict[str, Any],
    unchecked: str,
) -> Trajectory:
    """The file of a motion with its ramps, before its certificate."""
    setting = found.setting
    options = setting.problem.options
    usable = ramps.with_derived(limits, found.motion).reduced()
    whole = ramps.rest_to_rest(
        setting.subject(usable), found.motion, options.periods, options.rate, start
    )
    if speed != 1.0:
        whole = whole.slowed(speed)
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
        motion=whole,
        rate=options.rate,
        limits=ramps.with_derived(limits, whole.fourier),
        noise=setting.noise,
        design=entry,
        criteria={},
        margins=[],
        collision=unchecked,
        seed=options.seed,
        versions=versions(),
    )
    return dataclasses.replace(
        draft, criteria=certificate_module.score(draft, robot, limits, setting.problem.parameters)
    )
