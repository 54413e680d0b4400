"""`excite payload`: identify what is attached to a link."""

from __future__ import annotations

import argparse
from pathlib import Path

from .. import api
from .._system.output_files import output_folder
from ..api.payload_result import PAYLOAD_FILES
from ..report.payload import stated_mass_words
from . import options as shared
from .outcome import Outcome, doubt_line, with_files, written_lines


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite payload`."""
    output = output_folder(Path(arguments.out), PAYLOAD_FILES, shared.input_files(arguments))
    robot = shared.robot(arguments)
    result = api.identify_payload(
        robot,
        arguments.carrying,
        empty=arguments.empty,
        model=arguments.model,
        link=arguments.link,
        mass=arguments.payload_mass,
        shape=arguments.shape,
        limits=shared.limits(arguments, robot),
        band=arguments.band,
        trajectory=arguments.trajectory,
        columns=shared.columns(arguments),
        static=arguments.static,
    )
    written = output.replace(result.contents())
    lines = [f"payload at {result.link}, 95 % intervals:"]
    if result.rests is not None:
        without = f" and {result.rests[1]} without" if result.rests[1] else ""
        lines.insert(0, f"{result.rests[0]} rests with{without} the payload")
    for quantity in result.estimate.quantities:
        if quantity.shown:
            half = quantity.interval[1] - quantity.value
            text = f"{quantity.value:.5g} ± {half:.2g} {quantity.unit}"
        elif result.rests is not None and quantity.unit == "kg m²":
            text = "not shown by static poses"
        else:
            text = "not shown by these recordings"
        lines.append(f"  {quantity.name:10}{text}")
    if result.mounting == "different":
        lines.append("the payload differs between the recordings: it was mounted differently")
    lines += stated_mass_words(result.document())
    if result.doubts:
        lines.append(doubt_line(result.doubts, "payload"))
    lines += written_lines(written)
    return 0, with_files(result.document(), written), "\n".join(lines)
