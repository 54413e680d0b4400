"""The whole way once: optimise, make it rest-to-rest, certify; nothing leaves here that breaks a limit unsaid."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import threadpoolctl

from . import design, ramps, verify
from .artefact import Trajectory, versions
from .checks import Subject
from .design import Design
from .errors import CheckFailed, UnusableInput
from .limits import Limits
from .overlap import Apart
from .problem import RESERVE, Options
from .robot import Robot
from .starts import Progress
from .verify import Certificate

Array = np.ndarray


MOST_RESERVE = 0.3
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
    notes: dict[str, Any] | None = None,
    speed: float = 1.0,
    force: bool = False,
    progress: Progress | None = None,
) -> Delivery:
    """Design, smooth and certify a trajectory.

    start: pose at which the motion begins and ends at rest, or None. given: information of earlier recordings.
    apart: another motion that this one should keep apart from, for validation.
    notes: further facts for the file's `design` entry. speed: the motion is delivered at this share of the speed it was
    designed for. Raises CheckFailed when the certificate fails and `force` is
    not set, Infeasible when no motion or ramp obeys the limits, UnusableInput for options that contradict themselves.
    """
    say = progress or (lambda text: None)
    begun = time.perf_counter()
    if not 0.0 < speed <= 1.0:
        raise UnusableInput(f"--speed {speed:g} should be above 0 and at most 1")
    if options.free_period is None:
        design.whole_samples(options.period / speed, options.rate)
    setting = design.prepare(robot, limits, options, given, apart)
    say(f"{robot.name}: {robot.n} joints, {setting.base.count} base parameters")
    found = design.solve(setting, progress)
    timing = {"build": setting.built - begun, **found.timing()}
    reserve = RESERVE
    for attempt in range(4):
        trajectory = _assemble(found, robot, limits, start, speed, notes or {})
        certificate = verify.verify(trajectory, robot)
        if certificate.ok or attempt == 3:
            break
        reserve = min(max(2.0 * reserve, reserve - 1.5 * certificate.worst().room), MOST_RESERVE)
        say(f"between samples {certificate.worst().limit} of {certificate.worst().joint} breaks its limit; tightening by {reserve:.2g}")
        tighter = design.tightened(found.setting, limits, reserve)
        found = Design(tighter, (design.improve(tighter, found.motion, found.attempts[0].number), *found.attempts[1:]))
    timing["solve"] = time.perf_counter() - setting.built
    timing["total"] = time.perf_counter() - begun
    if not certificate.ok and not force:
        worst = certificate.worst()
        reason = (
            certificate.faults[0]
            if certificate.faults
            else f"{worst.limit} of '{worst.joint}' reaches {worst.value:.4g} of {worst.bound:.4g}"
        )
        raise CheckFailed(f"{robot.source}: the designed motion fails its certificate: {reason}; try another --seed or --force")
    # what earlier recordings gave need not be shown again
    if given is None and not trajectory.criteria["optimum"]["geometric"]["cond"] < 1.0 / SINGULAR:
        raise CheckFailed(
            f"{robot.source}: the motion found does not show all base parameters; try another --seed, fewer limits or a longer --period"
        )
    trajectory = dataclasses.replace(
        trajectory, margins=[m.document() for m in certificate.margins], collision=certificate.collision, forced=not certificate.ok
    )
    return Delivery(trajectory, certificate, found, timing)


def _assemble(found: Design, robot: Robot, limits: Limits, start: Array | None, speed: float, notes: dict[str, Any]) -> Trajectory:
    setting = found.setting
    options = setting.problem.options
    stated = ramps.with_derived(limits, found.motion)
    subject = Subject(robot, stated, setting.problem.parameters, options.uncertainty, options.boxes)
    whole = ramps.rest_to_rest(subject, found.motion, options.periods, options.rate, start)
    if speed != 1.0:
        whole = whole.slowed(speed)
    entry = {
        "criterion": options.criterion.value,
        "plain": options.plain,
        "drive": list(options.drive),
        "samples": options.samples,
        "starts": options.starts,
        "uncertainty": options.uncertainty,
        "speed": speed,
        "boxes": [dataclasses.asdict(box) for box in subject.boxes],
        **notes,
    }
    draft = Trajectory(
        robot={"name": robot.name, "source": robot.source, "sha256": robot.sha256, **robot.options},
        motion=whole,
        rate=options.rate,
        limits=stated,
        noise=setting.noise,
        design=entry,
        criteria={},
        margins=[],
        collision=verify.NOT_CHECKED,
        seed=options.seed,
        versions=versions(),
    )
    return dataclasses.replace(draft, criteria=verify.score(draft, robot, setting.problem.parameters))
