"""`excite check`: print what is missing or implausible in a robot, all at once."""

from __future__ import annotations

import argparse
from pathlib import Path

from .._system.output_files import output_files
from ..api.robot_check import check_robot
from ..errors import UnusableRobot
from . import options as shared
from .outcome import Outcome, written_lines


def run(arguments: argparse.Namespace) -> Outcome:
    """Examine a robot; exit code 0 when it is usable, 1 when something has to be corrected before a
    design, 2 when the file cannot be used at all."""
    output = None
    if arguments.limits_template:
        path = Path(arguments.limits_template)
        inputs = shared.input_files(arguments)
        output = output_files(path, inputs=inputs, option="--limits-template")
    try:
        result = check_robot(**shared.robot_choices(arguments), limits=arguments.limits or None)
    except UnusableRobot as error:
        document = {"usable": False, "faults": list(error.faults)}
        return 2, document, "\n".join(error.faults)
    written = []
    if output is not None:
        written = output.replace({output.names[0]: result.template()})
    lines = [*result.lines(), *written_lines(written)]
    document = result.document() | {"files": [str(path) for path in written]}
    return (0 if result.usable else 1), document, "\n".join(lines)
