"""`excite replay`: replay recorded commands in MuJoCo with an identified robot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .. import api
from .._system.output_files import output_folder
from ..api.replay_result import REPLAY_FILES
from . import options as shared
from .outcome import Outcome, with_files, written_lines


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite replay`."""
    output = output_folder(Path(arguments.out), REPLAY_FILES, shared.input_files(arguments))
    result = api.replay(
        arguments.model,
        arguments.recording,
        command=arguments.drive_with,
        gains=arguments.gains,
        robot=arguments.robot,
        columns=shared.columns(arguments),
    )
    written = output.replace(result.contents())
    document = result.document()
    return (
        0,
        with_files(document, written),
        "\n".join([*_lines(result, document), *written_lines(written)]),
    )


def _lines(result: api.ReplayResult, document: dict[str, Any]) -> list[str]:
    """The errors of the free run as a table."""
    robots = document["robots"]
    lines = [f"{document['command']} replayed over {document['seconds']:.4g} s; RMS error"]
    names = "".join(f"{robot['name']!s:>30}" for robot in robots)
    lines.append(f"{'joint':25}{names}")
    for entry in result.model.model.robot.entries:
        cells = ""
        for robot in robots:
            torque = robot["torque_rmse"][entry.name]
            force = "" if torque is None else f", {torque:.3g} {entry.unit('N m')}"
            position = f"{robot['position_rmse'][entry.name]:.3g} {entry.unit('rad')}"
            cells += f"{position + force:>30}"
        lines.append(f"{entry.name:25}{cells}")
    return lines
