"""What each command does: arguments in, (exit code, JSON document, text for people) out."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .. import exporters as exports
from .. import recordings
from .._system.console import say
from .._system.output_files import output_files, output_folder
from ..collision import clearance_builder
from ..collision.workcell import Cell
from ..designer import certificate as certificates
from ..designer import (
    cluster,
    criteria,
    experiment_comparison,
    pipeline,
    time_budget,
    validation_trajectory,
)
from ..designer import identifiability as identifiable
from ..designer.criteria import Criterion
from ..designer.motion_overlap import Apart
from ..designer.problem import Box, Options, noise_levels
from ..designer.validation_trajectory import Validation
from ..errors import CheckFailed, UnusableInput
from ..exporters import csv_json, file_format
from ..report.record import DesignRecord
from ..robot import base_parameters, dynamics, inertial_parameters
from ..robot import limits as limit_tables
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Limits
from ..robot.robot import Robot, builtin_names, load
from ..robot.samples import Samples
from ..trajectory import trajectory_file
from . import options as told

Array = np.ndarray
Outcome = tuple[int, Any, str]
DESIGN_FILES = ("trajectory.json", "trajectory.csv", "identifiability.json", "report.html")
MOTION_FILES = ("trajectory.json", "trajectory.csv")
"""Those of a design's files that a validation motion has too."""

# -- arguments -----------------------------------------------------------------------------------------------------


def _options(arguments: argparse.Namespace, robot: Robot) -> Options:
    """What the user chose, but for the motion, which is the plan's matter."""
    boxes = tuple(Box(frame, (v[0], v[2], v[4]), (v[1], v[3], v[5])) for frame, v in arguments.box)
    for box in boxes:
        robot.frame(box.frame)
    return Options(
        criterion=Criterion(arguments.criterion),
        plain=arguments.plain,
        drive=told.drive(arguments),
        free_period=arguments.optimise_period,
        rate=arguments.rate,
        uncertainty=arguments.uncertainty,
        noise=told.noise(arguments, robot),
        boxes=boxes,
        starts=arguments.starts,
        seed=arguments.seed,
        jobs=arguments.jobs,
        iterations=arguments.iterations,
    )


def _given(paths: Sequence[str], robot: Robot, standard: Parameters, noise: Array) -> Array | None:
    """Rows whose square is the information of earlier recordings, in standard parameters. Shape (m, P)."""
    if not paths:
        return None
    return np.vstack(
        [
            identifiable.information_root(robot, standard, _recorded(Path(path), robot)[0], noise)
            for path in paths
        ]
    )


def _recorded(path: Path, robot: Robot) -> tuple[Samples, trajectory_file.Trajectory | None]:
    """The samples of a trajectory.json at its own rate, or of a recording."""
    if path.suffix == ".json":
        trajectory = trajectory_file.read(path)
        if trajectory.joints != robot.joints:
            raise UnusableInput(
                f"{path}: moves {', '.join(trajectory.joints)}, not {', '.join(robot.joints)}; choose them with --joints"
            )
        return trajectory.motion.samples(trajectory.motion.grid(trajectory.rate)), trajectory
    return recordings.read(path, robot).samples(), None


# -- commands ------------------------------------------------------------------------------------------------------


def robots(arguments: argparse.Namespace) -> Outcome:
    """List the built-in models."""
    rows: list[dict[str, Any]] = []
    for name in builtin_names():
        robot = load(name)
        mass = sum(robot.model.inertias[i].mass for i in range(1, robot.model.njoints))
        rows.append({"name": name, "joints": list(robot.joints), "mass": float(mass)})
    text = "\n".join(
        f"{row['name']:10} {len(row['joints'])} joints, {row['mass']:5.1f} kg moving"
        for row in rows
    )
    return 0, {"robots": rows}, text


def design(arguments: argparse.Namespace) -> Outcome:
    """Design, certify, export and report, with the starts where `--backend` sends them."""
    with cluster.backend(arguments.backend, arguments.cluster):
        return _design(arguments)


def _design(arguments: argparse.Namespace) -> Outcome:
    # an earlier validation motion belongs to the motion that is replaced: it is replaced too, or removed
    output = output_folder(
        Path(arguments.out),
        (*DESIGN_FILES, *(f"{validation_trajectory.FOLDER}/{name}" for name in MOTION_FILES)),
    )
    robot = told.robot(arguments)
    table = told.limits(arguments, robot)
    wish = time_budget.Wish(
        arguments.period, arguments.harmonics, arguments.samples, arguments.periods
    )
    options = wish.fill(_options(arguments, robot), table)
    start = (
        None if not arguments.start else np.array(told.of_joints("--start", arguments.start, robot))
    )
    standard = (
        inertial_parameters.standard(robot, table, options.drive) if arguments.given else None
    )
    earlier = (
        _given(arguments.given, robot, standard, noise_levels(table, options.noise))
        if standard is not None
        else None
    )
    given = None if earlier is None else earlier.T @ earlier
    notes = {
        "parameters": arguments.parameters,
        "given": list(arguments.given),
        "speed": arguments.speed,
        "chosen": wish.open,
    }
    if arguments.torque_noise is None:
        notes["torque_noise_source"] = "1 % of each torque limit (default)"
    cell, unchecked = told.cell(arguments, robot, table)
    planned = None
    if arguments.time is not None:
        covers = None if cell is None else clearance_builder.clearance(cell)
        planned = time_budget.budgeted(
            robot, table, options, wish, arguments.time, start=start, given=given, clearance=covers
        )
    if planned is not None:
        notes["plan"] = planned.facts()
    whole = partial(
        pipeline.run,
        robot,
        table,
        start=start,
        notes=notes,
        force=arguments.force,
        speed=arguments.speed,
        progress=say,
    )
    run = partial(whole, cell=cell, unchecked=unchecked)

    def deliver(apart: Apart | None = None) -> pipeline.Delivery:
        # a motion to judge by should show everything, known or not
        one = partial(run, apart=apart, given=given if apart is None else None)
        return one(options) if planned is None else time_budget.deliver(planned, options, one)

    delivery = deliver()
    second = (
        validation_trajectory.second(delivery, robot, deliver) if arguments.validation else None
    )
    document, contents = workflow_files(delivery, robot, arguments.threshold, earlier, second, cell)
    document |= {"plan": planned.document()} if planned is not None else {}
    written = output.replace(contents)
    document["files"] = [str(path) for path in written]
    more = [one.words() for one in (planned, second) if one is not None]
    return (0 if document["ok"] else 1), document, _design_text(delivery, document, more, written)


def workflow_files(
    delivery: pipeline.Delivery,
    robot: Robot,
    threshold: float,
    earlier: Array | None = None,
    second: Validation | None = None,
    cell: Cell | None = None,
) -> tuple[dict[str, Any], dict[str, str]]:
    """The `--json` document of a design and its files' contents.

    earlier: root of the information already given. second: the validation motion, in a folder of its own. cell: for pictures.
    """
    from .. import report

    trajectory = delivery.trajectory if second is None else second.noted(delivery.trajectory)
    standard, found = delivery.design.setting.problem.parameters, delivery.design.setting.base
    samples = trajectory.motion.samples(trajectory.motion.grid(trajectory.rate))
    root = identifiable.information_root(robot, standard, samples, trajectory.noise)
    known = root if earlier is None else np.vstack([root, earlier])
    analysis = identifiable.analyse_root(
        standard, found, known, trajectory.noise, robot, threshold=threshold, samples=len(samples)
    )
    cases = _cases(robot, standard, found, trajectory, threshold, earlier)
    record, other, near = (
        _record(delivery),
        None if second is None else second.trajectory,
        delivery.certificate.near,
    )
    shown = partial(report.design_page, cases=cases, second=other, cell=cell, near=near)
    contents = {
        **_motion_files(trajectory, robot, standard),
        "identifiability.json": trajectory_file.dumps(analysis.document()),
        "report.html": shown(trajectory, robot, standard, found, analysis, record),
    }
    if other is not None:
        contents |= {
            f"{validation_trajectory.FOLDER}/{name}": text
            for name, text in _motion_files(other, robot, standard).items()
        }
    directions = analysis.document()["directions"]
    document = {
        "ok": delivery.certificate.ok,
        "robot": robot.name,
        "joints": list(robot.joints),
        "base_parameters": found.count,
        "identifiable": sum(bool(d["identifiable"]) for d in directions),
        "criteria": dict(trajectory.criteria),
        "timing": delivery.timing,
        "margins": trajectory.margins,
        "verdict": delivery.certificate.document()["verdict"],
        "collision": trajectory.collision,
        "duration": trajectory.motion.duration,
    }
    if second is not None:
        document["validation"] = second.document()
        document["ok"] = delivery.certificate.ok and second.delivery.certificate.ok
    return document, contents


def _motion_files(
    trajectory: trajectory_file.Trajectory, robot: Robot, standard: Parameters
) -> dict[str, str]:
    job = file_format.Job(
        trajectory,
        trajectory.motion,
        "csv",
        Path("trajectory.csv"),
        1.0,
        None,
        _torque(robot, standard),
    )
    return {
        "trajectory.json": trajectory_file.dumps(trajectory.document()),
        "trajectory.csv": csv_json.write_csv(job).text,
    }


def _cases(
    robot: Robot,
    standard: Parameters,
    found: base_parameters.Base,
    trajectory: trajectory_file.Trajectory,
    threshold: float,
    earlier: Array | None = None,
) -> tuple[experiment_comparison.Scenario, ...]:
    """What twice the time or twice the speed of a trajectory would buy."""
    limits, motion, noise = trajectory.limits, trajectory.motion, trajectory.noise
    return experiment_comparison.what_would_help(
        robot,
        standard,
        found,
        limits,
        motion,
        noise=noise,
        rate=trajectory.rate,
        threshold=threshold,
        given=earlier,
    )


def _torque(robot: Robot, standard: Parameters) -> Callable[[Samples], Array]:
    """Nominal torque of samples."""
    return lambda samples: dynamics.torque(robot, standard, samples)


def _record(delivery: pipeline.Delivery) -> DesignRecord:
    attempts = delivery.design.attempts
    starts = [
        {
            "seed": a.number,
            "value": a.objective,
            "feasible": True,
            "objective": a.values,
            "worst": a.worst,
            "stage": a.stage,
            "stopped": a.stopped,
        }
        for a in attempts
    ]
    return DesignRecord(starts=starts, chosen=0)


def _design_text(
    delivery: pipeline.Delivery,
    document: dict[str, Any],
    more: Sequence[str],
    written: Sequence[Path],
) -> str:
    trajectory, certificate = delivery.trajectory, delivery.certificate
    chosen, plain = Criterion(trajectory.design["criterion"]), bool(trajectory.design["plain"])
    values = [
        criteria.pick(trajectory.criteria[part], chosen, plain=plain)
        for part in ("optimum", "exported")
    ]
    kind = "" if chosen is Criterion.COND_REGRESSOR else ("plain " if plain else "geometric ")
    lines = [
        f"{document['robot']}: {document['identifiable']} of {document['base_parameters']} directions practically identifiable",
        f"{kind}{chosen.value}: {values[0]:.6g} per sample of the periodic part, {values[1]:.6g} of the whole motion",
        f"{trajectory.motion.duration:.2f} s: {' → '.join(s.kind for s in trajectory.motion.segments)}",
        *certificate.lines(),
        *more,
        f"designed in {delivery.timing['total']:.1f} s",
        *(f"wrote {path}" for path in written),
    ]
    return "\n".join(lines)


def _certified(
    arguments: argparse.Namespace,
) -> tuple[trajectory_file.Trajectory, Robot, Limits, certificates.Certificate]:
    """A trajectory file, its robot, the limits from their sources, and the certificate against what is on disk now."""
    path = Path(arguments.trajectory)
    trajectory = trajectory_file.read(path)
    robot = trajectory.load_robot(arguments.robot)
    file = Path(arguments.limits) if arguments.limits else None
    truth = limit_tables.from_sources(robot, trajectory.limits, file, path.resolve().parent)
    certificate = certificates.of_file(
        trajectory,
        robot,
        folder=path.resolve().parent,
        limits_file=file,
        packages=arguments.packages,
    )
    return trajectory, robot, truth, certificate


def verify(arguments: argparse.Namespace) -> Outcome:
    """Recompute everything from the file."""
    certificate = _certified(arguments)[3]
    rows = [f"{'limit':13}{'joint':25}{'worst':>12}{'bound':>12}{'free':>9}{'time [s]':>10}"]
    rows += [
        f"{m.limit:13}{m.joint:25}{m.value:12.5g}{m.bound:12.5g}{certificates.percent(m.room):>9}{m.time:10.3f}"
        for m in certificate.margins
    ]
    rows += ["", *certificate.lines()]
    return (0 if certificate.ok else 1), certificate.document(), "\n".join(rows)


def export(arguments: argparse.Namespace) -> Outcome:
    """Write a controller's file, after the certificate."""
    if arguments.format not in exports.FORMATS:
        raise UnusableInput(
            f"--format {arguments.format}: no such format; there are {', '.join(exports.FORMATS)}"
        )
    file_format.check_options(arguments.speed, arguments.rate)
    output_files(
        Path(arguments.out), inputs=[Path(arguments.trajectory)]
    )  # before the certificate, which takes its time
    trajectory, robot, truth, certificate = _certified(arguments)
    verdict = list(certificate.lines())
    broken = (
        certificates.broken_when_slowed(trajectory, robot, truth, arguments.speed)
        if arguments.speed != 1.0
        else None
    )
    if broken is not None:
        verdict.append(f"at --speed {arguments.speed:g} the {broken.words()}")
    ok = certificate.ok and broken is None
    if not ok and not arguments.force:
        raise CheckFailed(
            f"{arguments.trajectory}: {'; '.join(verdict)}; design it again, or --force"
        )
    # what the new file says of itself is what was computed now
    trajectory = dataclasses.replace(
        trajectory,
        criteria=certificate.criteria,
        margins=[margin.document() for margin in certificate.margins],
        collision=certificate.collision,
        forced=not ok,
    )
    standard = inertial_parameters.standard(
        robot, truth, trajectory.design.get("drive", inertial_parameters.DRIVE)
    )
    torque = _torque(robot, standard)
    path = exports.write(
        trajectory,
        arguments.format,
        Path(arguments.out),
        speed=arguments.speed,
        rate=arguments.rate,
        tau=torque,
    )
    document = {
        "file": str(path),
        "format": arguments.format,
        "forced": trajectory.forced,
        "verdict": certificate.document()["verdict"],
        "collision": certificate.collision,
    }
    return 0, document, "\n".join([*verdict, f"wrote {path}"])


def identifiability(arguments: argparse.Namespace) -> Outcome:
    """What a trajectory or a recording reveals."""
    from .. import report

    output = output_folder(Path(arguments.out), ("identifiability.json", "report.html"))
    robot = told.robot(arguments)
    table = told.limits(arguments, robot)
    standard = inertial_parameters.standard(robot, table, told.drive(arguments))
    found = base_parameters.find(robot, standard, table)
    samples, trajectory = _recorded(Path(arguments.motion), robot)
    stated = told.noise(arguments, robot)
    noise = (
        trajectory.noise
        if trajectory is not None and stated is None
        else noise_levels(table, stated)
    )
    root = identifiable.information_root(robot, standard, samples, noise)
    analysis = identifiable.analyse_root(
        standard, found, root, noise, robot, threshold=arguments.threshold, samples=len(samples)
    )
    document = json.loads(trajectory_file.dumps(analysis.document()))
    cases = (
        ()
        if trajectory is None
        else _cases(robot, standard, found, trajectory, arguments.threshold)
    )
    page = report.identifiability_page(
        robot, standard, found, analysis, arguments.motion, cases=cases
    )
    written = output.replace(
        {"identifiability.json": trajectory_file.dumps(document), "report.html": page}
    )
    seen = sum(bool(d["identifiable"]) for d in document["directions"])
    text = "\n".join(
        [
            f"{robot.name}: {seen} of {found.count} directions practically identifiable",
            *(f"wrote {path}" for path in written),
        ]
    )
    return 0, document, text


def identify(arguments: argparse.Namespace) -> Outcome:
    """Parameters from recordings."""
    from .identify import identify

    return identify(arguments, say)


def predict(arguments: argparse.Namespace) -> Outcome:
    """Torque by an identified model along a recording."""
    from .identify import predict

    return predict(arguments)


def diagnose(arguments: argparse.Namespace) -> Outcome:
    """What the model leaves out."""
    from .diagnose import diagnose

    return diagnose(arguments, say)


def view(arguments: argparse.Namespace) -> Outcome:
    """Play a trajectory in a browser."""
    from .view import view

    return view(arguments, say)


def simulate(arguments: argparse.Namespace) -> Outcome:
    """Record a simulated robot."""
    from .simulate import command

    return command(arguments)
