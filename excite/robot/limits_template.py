"""A limits file to fill in: the known limits of a robot, and a line for each that is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .._system.comments import plain_line
from ..errors import LimitFault, toml_key
from .limits import QUANTITIES, REQUIRED, LimitTable
from .robot import Robot

UNITS = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s²",
    "jerk": "rad/s³",
    "torque": "N m",
}
"""Units of the limits of a turning joint."""


def limits_template(robot: Robot, table: LimitTable, missing: Sequence[LimitFault]) -> str:
    """Write the text of a TOML file for `--limits`.

    Args:
        robot: The robot.
        table: The limits that are known.
        missing: The limits that have to be filled in.
    """
    lines = [
        f"# Limits of {plain_line(robot.name)} for --limits FILE.toml; see 'excite check'.",
        "# Fill in the lines with …, and remove their first #.",
    ]
    for entry in robot.entries:
        lines += ["", f"[joints.{toml_key(entry.name)}]"]
        reasons = {fault.quantity: fault for fault in missing if fault.joint == entry.name}
        for quantity in QUANTITIES:
            unit = entry.unit(UNITS[quantity])
            if quantity in table[entry.name]:
                value, source = table[entry.name][quantity]
                lines.append(f"{quantity} = {_toml(value)}  # {unit}, {plain_line(source)}")
            elif quantity in reasons:
                blank = "[…, …]" if quantity == "position" else "…"
                reason = plain_line(reasons[quantity].reason)
                lines.append(
                    f"# {quantity} = {blank}  # {unit}, needed{f': {reason}' if reason else ''}"
                )
            elif quantity not in REQUIRED:
                lines.append(f"# {quantity} = …  # {unit}, optional")
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """A number or a pair of numbers."""
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(repr(float(number)) for number in value)}]"
    return repr(float(value))
