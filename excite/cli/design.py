"""`excite design`: design, certify, export and report a motion."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .. import api
from .._system.output_files import output_folder
from .._system.progress import logger
from ..api.design_result import DESIGN_FILES
from ..api.identification_result import REFERENCE_RATE
from ..designer import cluster, criteria
from ..designer.criteria import Criterion
from ..designer.options import DesignOptions
from ..robot.robot import Robot
from . import options as shared
from . import static_design, support_design
from .outcome import Outcome, with_files, written_lines


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite design`, with its starts on the back end of `--backend`."""
    with cluster.backend(arguments.backend, arguments.cluster):
        return _design(arguments)


def _design(arguments: argparse.Namespace) -> Outcome:
    if arguments.floating:
        return support_design.run(arguments)
    shared.require_floating(arguments, support_design.FLOATING_ONLY)
    if arguments.static or arguments.poses is not None:
        return static_design.run(arguments)
    robot = shared.robot(arguments)
    limits = shared.limits(arguments, robot)
    output = output_folder(Path(arguments.out), DESIGN_FILES, shared.input_files(arguments))
    result = api.design(
        robot,
        limits=limits,
        cell=shared.cell_options(arguments),
        options=_options(arguments, robot),
        period=arguments.period,
        harmonics=arguments.harmonics,
        samples=arguments.samples,
        periods=arguments.periods,
        time=arguments.time,
        start=None if not arguments.start else shared.of_joints("--start", arguments.start, robot),
        given=arguments.given,
        trajectory=arguments.trajectory,
        columns=shared.columns(arguments),
        for_task=arguments.for_task,
        discriminate=arguments.discriminate,
        validate=arguments.validation,
        starts=arguments.starts,
        speed=arguments.speed,
        threshold=arguments.threshold,
        force=arguments.force,
        notes={"parameters": arguments.parameters},
    )
    logger.info("writing the report")
    written = output.replace(result.contents())
    document = with_files(result.document(), written)
    return (0 if result.ok else 1), document, _text(result, document, written)


def _options(arguments: argparse.Namespace, robot: Robot) -> DesignOptions:
    """Options of the design, except period, harmonics, samples and repeats of the motion."""
    return DesignOptions(
        criterion=Criterion(arguments.criterion),
        plain=arguments.plain,
        drive=shared.drive(arguments),
        free_period=arguments.optimise_period,
        rate=arguments.rate,
        uncertainty=arguments.uncertainty,
        noise=shared.noise(arguments, robot),
        boxes=shared.boxes(arguments),
        seed=arguments.seed,
        jobs=arguments.jobs,
        iterations=arguments.iterations,
        payload_link=arguments.for_payload,
    )


def _optimum(result: api.DesignResult) -> str:
    """State the value of what was optimised."""
    trajectory, design = result.trajectory, result.delivery.design
    objective = design.setup.problem.objective
    if objective is not None:
        return objective.statement(design.attempts[0].objective)
    criterion, plain = Criterion(trajectory.design["criterion"]), bool(trajectory.design["plain"])
    periodic, complete = (
        criteria.select_criterion(trajectory.criteria[part], criterion, plain=plain)
        for part in ("optimum", "exported")
    )
    kind = "" if criterion is Criterion.COND_REGRESSOR else ("plain " if plain else "geometric ")
    return (
        f"{kind}{criterion.value}: {periodic:.6g} per sample of the periodic part, "
        f"{complete:.6g} of the whole motion"
    )


def _text(result: api.DesignResult, document: dict[str, Any], written: list[Path]) -> str:
    trajectory, certificate = result.trajectory, result.delivery.certificate
    directions = f"{document['identifiable']} of {document['base_parameters']} directions"
    source = trajectory.design.get("torque_noise_source", "as stated")
    noise = shared.noise_in_words(trajectory.noise, trajectory.limits, source)
    lines = [
        f"{document['robot']}: {directions} practically identifiable "
        f"(torque noise {noise}, {REFERENCE_RATE:g} rows a second)",
        _optimum(result) if result.payload is None else result.payload.text,
        f"{trajectory.motion.duration:.2f} s: "
        f"{' → '.join(s.kind for s in trajectory.motion.segments)}",
        *certificate.verdict_lines(),
        *(
            part.summary()
            for part in (result.plan, result.validation, result.task, result.discrimination)
            if part is not None
        ),
        f"designed in {result.delivery.timing['total']:.1f} s",
        *written_lines(written),
    ]
    return "\n".join(lines)
