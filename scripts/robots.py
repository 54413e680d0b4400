#!/usr/bin/env python
"""Design and certify a motion for many robots: built-in models and example-robot-data.

It prints a Markdown table (or JSON); the exit code is 1 when a robot fails, not when it is refused.
example-robot-data is used where its wheel is installed or unpacked. Robots of other wheels are used
where these are unpacked, each in a folder of its distribution's name:

    pip download --no-deps example-robot-data && unzip -d DIR example_robot_data*.whl
    for NAME in rtb-data dexmate-urdf hello-robot-stretch-urdf icub-models armar jvrc-description \\
        robosuite dm-control gymnasium-robotics; do
        pip download --no-deps "$NAME" && unzip -d "OTHERS/${NAME//-/_}" "${NAME//-/_}"*.whl
    done
    python scripts/robots.py --data DIR --wheels OTHERS

Single starts of all criteria: --starts 1 --criteria a,d,e,cond,cond_regressor --seeds 0,1,2.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import signal
import subprocess
import sys
import sysconfig
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from robot_cases import LIMBS, MJCF, OTHER_WHEELS, RECORDED, WHEEL, Case

from excite import _json
from excite.collision import scene_file
from excite.designer import certificate as certificate_module
from excite.designer import criteria, pipeline, sqp, time_budget
from excite.designer.criteria import Criterion
from excite.designer.options import DesignOptions
from excite.errors import CheckFailed
from excite.robot import limits, robot
from excite.trajectory import trajectory_file

REFUSALS = ("UnusableInput", "UnusableRobot", "MissingLimit", "MissingMesh", "Infeasible")
"""Errors that state in one line why there is no motion; any other one is a failure."""

HERE = Path(__file__).resolve().parent
RECORDINGS = HERE.parent.parent / "shared" / "recordings"
PLACES = (
    "",
    "robots",
    "share/example-robot-data/robots",
    "cmeel.prefix/share/example-robot-data/robots",
)
"""Folders of the wheel that may hold the robots."""


@dataclass
class Row:
    """The outcome for one robot; None where a step was not reached.

    Attributes:
        robot: Name of the robot.
        joints: Number of joints.
        base_parameters: Number of base parameters.
        timing: Times of the design [s].
        processor: Processor time of the design, with loading and reading back [s].
        start: Criterion of the first feasible motion, per sample.
        after: Criterion of the optimum, per sample.
        nearest: The nearest limit.
        duration: Duration of the motion [s].
        near: Least distance between bodies [mm].
        ok: Whether the motion is certified.
        reason: Fault, where it is not.
        warnings: Warnings.
    """

    robot: str
    joints: int | None = None
    base_parameters: int | None = None
    timing: dict[str, float] | None = None
    processor: float | None = None
    start: float | None = None
    after: float | None = None
    nearest: dict[str, Any] | None = None
    duration: float | None = None
    near: float | None = None
    ok: bool = False
    reason: str = ""
    warnings: list[str] = field(default_factory=list)


def say(text: str) -> None:
    """Print a line to standard error."""
    print(text, file=sys.stderr, flush=True)


def cases(data: Path | None, wheels: Path | None = None) -> list[tuple[Case, str]]:
    """Return every available robot, with the argument of `robot.load`.

    Args:
        data: Folder of example-robot-data.
        wheels: Folder in which the other wheels are unpacked.
    """
    entries = [(Case(name, ""), name) for name in robot.builtin_names()]
    folder = wheel(data)
    if folder is None:
        say("example-robot-data is not installed and no --data is given: built-in models only")
    else:
        entries += [(case, str(folder / case.path)) for case in WHEEL + LIMBS]
    if wheels is not None:
        entries += [
            (case, str(path))
            for case in OTHER_WHEELS + MJCF
            if (path := wheels / case.path).is_file()
        ]
    # recorded robots exist in the project's own workspace only
    return entries + [
        (case, str(RECORDINGS / case.path))
        for case in RECORDED
        if (RECORDINGS / case.path).is_file()
    ]


def wheel(data: Path | None) -> Path | None:
    """Return the wheel's folder of robots, below --data or where the wheel is installed."""
    root = Path(sysconfig.get_path("purelib")) if data is None else data
    for place in PLACES:
        if (root / place / "ur_description").is_dir():
            return root / place
    if data is not None:
        raise SystemExit(
            f"--data {data}: holds no example-robot-data (a folder with ur_description in it)"
        )
    return None


def run_in_process(name: str, criterion: str, seed: int, given: argparse.Namespace) -> Row:
    """Try a robot with one criterion and seed in a process of its own.

    A crash or a solver that never ends then does not affect the others.
    """
    command = [sys.executable, str(Path(__file__).resolve()), "--alone", "--json", "--only", name]
    command += [
        "--starts",
        str(given.starts),
        "--criteria",
        criterion,
        "--uncertainty",
        str(given.uncertainty),
    ]
    command += [] if given.data is None else ["--data", str(given.data)]
    command += [] if given.wheels is None else ["--wheels", str(given.wheels)]
    command += ["--seeds", str(seed), "--jobs", str(given.jobs)]
    # in a session of its own, so that the workers of a robot that hangs can be ended with it
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        out, _ = child.communicate(timeout=given.patience)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        child.communicate()
        return Row(name, reason=f"no result within {given.patience:g} s")
    return (
        Row(**json.loads(out)[0])
        if out
        else Row(name, reason=f"the process ended with exit code {child.returncode} and no result")
    )


def attempt(case: Case, source: str, options: DesignOptions) -> Row:
    """Design and verify a robot; any exception becomes the reason of the row."""
    row, before = Row(case.name), processor_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            run(row, case, source, options)
        except Exception as error:  # one faulty robot must not hide the others
            row.ok, row.reason = False, f"{type(error).__name__}: {' '.join(str(error).split())}"
    row.processor = processor_time() - before
    row.warnings = [f"{w.category.__name__}: {w.message}" for w in caught]
    return row


def processor_time() -> float:
    """Return the processor time of this process and of its ended children [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def run(row: Row, case: Case, source: str, options: DesignOptions) -> None:
    """Fill in the row as far as the design gets; raises what excite raises."""
    machine = robot.load(source, joints=case.joints, lock=case.lock)
    row.joints = machine.n
    with tempfile.TemporaryDirectory() as folder:
        file = limits_file(case, source, machine, Path(folder))
        design(row, machine, limits.resolve(machine, file), options)


def limits_file(case: Case, source: str, machine: robot.Robot, folder: Path) -> Path | None:
    """Return the limits file of a robot, one with the assumed limits of its case, or None."""
    stated = HERE / "limits" / f"{case.name}.toml"
    if stated.is_file() and not is_builtin(source):
        return stated
    faults = limits.missing_limits(machine, limits.stated_limits(machine)[0])
    missing = {(fault.joint, fault.quantity) for fault in faults}
    lines = []
    for joint in machine.joints:
        values = {q: v for q, v in case.assumed.items() if (joint, q) in missing}
        if values:
            lines += [f"[joints.{json.dumps(joint)}]", *(f"{q} = {v}" for q, v in values.items())]
    if not lines:
        return None
    path = folder / "limits.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def design(row: Row, machine: robot.Robot, table: limits.Limits, options: DesignOptions) -> None:
    """Design and verify a motion of a loaded robot, and fill in the row."""
    cell, unchecked = scene_file.find_cell(machine, table, scene_file.Scene())
    options = time_budget.MotionRequest().complete(options, table)
    delivery = pipeline.design_trajectory(
        machine,
        table,
        options,
        cell=cell,
        unchecked_reason=unchecked,
        progress=lambda text: say(f"  {text}"),
    )
    row.base_parameters, row.timing = delivery.design.setup.base.count, delivery.timing
    row.duration = delivery.trajectory.motion.duration
    row.start = first_feasible(delivery, options)
    row.after = criteria.select_criterion(
        delivery.trajectory.criteria["optimum"], options.criterion, plain=options.plain
    )
    certificate = round_trip(delivery.trajectory)
    row.nearest = certificate.worst().document()
    row.nearest["source"] = source_of(delivery.trajectory.limits, certificate.worst())
    row.near = min((1e3 * near.proven for near in certificate.pair_distances), default=None)
    row.ok = certificate.ok
    row.reason = "" if row.ok else refusal(certificate)


def refusal(certificate: certificate_module.Certificate) -> str:
    """Return the fault of a motion that was read back from its file, in one line."""
    if not certificate.faults:
        worst = certificate.worst()
        return f"{worst.limit} of {worst.joint} is violated in the motion read back from its file"
    more = len(certificate.faults) - 1
    return certificate.faults[0] + (f" (and {more} more)" if more else "")


def source_of(table: limits.Limits, margin: certificate_module.LimitMargin) -> str:
    """Return the source of a limit.

    Derived limits bind the ramps only, which always reach them.
    """
    sources = dict(zip(table.joints, table.sources.get(margin.limit, ()), strict=False))
    return sources.get(margin.joint, "")


def is_builtin(source: str) -> bool:
    """Return True if a robot is a built-in model."""
    return source in robot.builtin_names()


def first_feasible(delivery: pipeline.CertifiedDesign, options: DesignOptions) -> float:
    """Return the criterion of the earliest feasible motion of all starts.

    The histories hold the objective, a logarithm. A start that the certificate asked to tighten has
    lost its beginning; another start is used then.
    """
    first_values = []
    for start in delivery.design.attempts:
        index = int(np.argmax(np.array(start.worst) <= sqp.MAX_FEASIBLE_ROW_VALUE))
        first_values.append((start.time[index], start.values[index]))
    objective = min(first_values)[1]
    if options.criterion is Criterion.D:
        return -delivery.design.setup.base.count * objective
    power = {Criterion.E: -1.0, Criterion.COND_REGRESSOR: 0.5}.get(options.criterion, 1.0)
    return float(np.exp(power * objective))


def round_trip(trajectory: trajectory_file.Trajectory) -> certificate_module.Certificate:
    """Certify the file as a user would, with the robot that it names."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trajectory.json"
        path.write_text(text := _json.dumps(trajectory.document()), encoding="utf-8")
        again = trajectory_file.read_trajectory(path)
    if _json.dumps(again.document()) != text:
        raise CheckFailed("trajectory.json does not read back as it was written")
    robot = again.load_robot()
    truth = limits.from_sources(robot, again.limits)
    return certificate_module.verify_with_cell_on_disk(again, robot, truth)


def markdown(rows: Sequence[Row]) -> str:
    """Return the table; the last cell of a robot that failed is the reason."""
    values = ["criterion at start", "criterion after"]
    head = [
        "robot",
        "joints",
        "base par.",
        "design [s]",
        "processor [s]",
        *values,
        "nearest limit",
        "clearance [mm]",
        "motion [s]",
        "outcome",
    ]
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * 6 + "---|---:|---:|---|"]
    return "\n".join(lines + ["| " + " | ".join(cells(row)) + " |" for row in rows])


def cells(row: Row) -> list[str]:
    """Return the row of a robot."""

    def number(value: float | None, style: str) -> str:
        return "" if value is None else format(value, style)

    near = row.nearest
    derived = " (derived)" if near is not None and near["source"] == limits.DERIVED else ""
    return [
        row.robot,
        number(row.joints, "d"),
        number(row.base_parameters, "d"),
        number(None if row.timing is None else row.timing["total"], ".1f"),
        number(row.processor, ".1f"),
        number(row.start, ".3g"),
        number(row.after, ".3g"),
        ""
        if near is None
        else f"{near['limit']}, {near['joint']}, "
        f"{round(100.0 * near['margin'], 2) + 0.0:.2f} %{derived}",
        "unknown" if row.near is None else number(row.near, ".1f"),
        number(row.duration, ".2f"),
        outcome(row).replace("|", "\\|"),
    ]


def outcome(row: Row) -> str:
    """Return the last cell of a robot: designed and verified, refused in one line, or failed."""
    if row.ok:
        return "designed and verified"
    refused = row.reason.partition(":")[0] in REFUSALS
    return f"{'refused' if refused else 'FAILED'}: {row.reason}"


def summary(rows: Sequence[Row]) -> str:
    """Return the counts of the outcomes and the longest time, in one line."""
    words = [outcome(row).partition(":")[0] for row in rows]
    counts = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
    slowest = max(rows, key=lambda row: row.processor or 0.0)
    longest = slowest.processor or 0.0
    return f"{len(rows)} robots: {counts}; most processor time {longest:.1f} s ({slowest.robot})"


def chosen(entries: list[tuple[Case, str]], only: str | None) -> list[tuple[Case, str]]:
    """Return the robots of --only, in the order of the table."""
    if only is None:
        return entries
    names = only.split(",")
    unknown = sorted(set(names) - {case.name for case, _ in entries})
    if unknown:
        raise SystemExit(
            f"--only {unknown[0]}: not among {', '.join(case.name for case, _ in entries)}"
        )
    return [(case, source) for case, source in entries if case.name in names]


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    standard = DesignOptions()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        help="example-robot-data: its unpacked wheel or folder of robots",
    )
    parser.add_argument(
        "--wheels", type=Path, metavar="DIR", help="folder of other unpacked wheels, one each"
    )
    parser.add_argument(
        "--seeds",
        type=lambda text: tuple(int(part) for part in text.split(",")),
        default=(standard.seed,),
        metavar="N,…",
        help="of the starts; every robot is tried with each (default 0)",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=1,
        help="processes per robot (default %(default)s, whose processor time is complete)",
    )
    parser.add_argument("--only", metavar="NAME,…", help="these robots alone")
    parser.add_argument(
        "--starts",
        type=int,
        default=standard.starts,
        help="random starts per robot (default %(default)s)",
    )
    parser.add_argument(
        "--criteria",
        type=lambda text: tuple(Criterion(part) for part in text.split(",")),
        default=(standard.criterion,),
        metavar="NAME,…",
        help=f"of {', '.join(c.value for c in Criterion)}; every robot is tried with each "
        f"(default {standard.criterion.value})",
    )
    parser.add_argument(
        "--uncertainty",
        type=float,
        default=standard.uncertainty,
        help="as of excite design (default %(default)s)",
    )
    parser.add_argument(
        "--patience",
        type=float,
        default=300.0,
        metavar="S",
        help="end a robot that takes longer (default %(default)g)",
    )
    parser.add_argument(
        "--json", action="store_true", help="one JSON document instead of the table"
    )
    parser.add_argument(
        "--alone", action="store_true", help=argparse.SUPPRESS
    )  # in this process, as `apart` asks
    return parser.parse_args()


def main() -> int:
    """Try the robots; return the exit code."""
    given = parse_arguments()
    combinations = list(itertools.product(given.criteria, given.seeds))
    rows = []
    for case, source in chosen(cases(given.data, given.wheels), given.only):
        for criterion, seed in combinations:
            if given.alone:
                options = DesignOptions(
                    criterion=criterion,
                    starts=given.starts,
                    uncertainty=given.uncertainty,
                    seed=seed,
                    jobs=given.jobs,
                )
                rows.append(attempt(case, source, options))
                continue
            label = f" {criterion.value} {seed}" if len(combinations) > 1 else ""
            say(f"{case.name}{label}: {source}")
            row = run_in_process(case.name, criterion.value, seed, given)
            row.robot += label
            rows.append(row)
            for text in row.warnings:
                say(f"  {text}")
            say("  " + " | ".join(cells(row)))
    if not given.alone:
        say(summary(rows))
    print(
        json.dumps([dataclasses.asdict(r) for r in rows], indent=1)
        if given.json
        else markdown(rows)
    )
    return 1 if any(outcome(row).startswith("FAILED") for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
