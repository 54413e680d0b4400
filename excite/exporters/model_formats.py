"""Registry of the formats of an identified robot, and the function that writes any of them.

To add a format, add a module with a function that renders a `SimulatorModel` as text and a set
`HOLDS` of the quantities that the format holds, and an entry to `_FORMATS` below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import UnusableInput
from . import isaaclab_file, mjcf_file, sdf_file, urdf_file
from .mjcf_merge import merged_mjcf
from .simulator_model import Held, SimulatorModel


@dataclass(frozen=True)
class _Format:
    """A format of an identified robot.

    Attributes:
        description: One line for `excite formats`.
        render: Returns the text of the file.
        holds: Quantities that the format holds.
    """

    description: str
    render: Callable[[SimulatorModel], str]
    holds: frozenset[Held]


_FORMATS = {
    "mjcf": _Format(
        "MuJoCo: inertias, armature, damping, frictionloss of the fitted width, springs, limits",
        mjcf_file.mjcf_text,
        mjcf_file.HOLDS,
    ),
    "urdf": _Format(
        "URDF: inertias, damping and friction; meshes and everything else as they are",
        urdf_file.urdf_text,
        urdf_file.HOLDS,
    ),
    "sdf": _Format(
        "SDFormat (Gazebo): inertias, damping, friction, linear springs, limits",
        sdf_file.sdf_text,
        sdf_file.HOLDS,
    ),
    "isaaclab": _Format(
        "Isaac Lab: actuator configuration (Python), USD attributes; static and dynamic friction",
        isaaclab_file.isaaclab_text,
        isaaclab_file.HOLDS,
    ),
}
MODEL_FORMATS: Mapping[str, str] = {name: entry.description for name, entry in _FORMATS.items()}
"""Name of each format of an identified robot -> its description in one line."""


def model_text(model: SimulatorModel, format: str, into: Path | None = None) -> str:
    """Return the text of an identified robot in a format.

    Args:
        model: The identified robot.
        format: Name of the format.
        into: The user's own MJCF, of which only what was identified changes; None: a new file.

    Raises:
        UnusableInput: The format is unknown, or `into` cannot be used with it.
    """
    entry = _entry(format)
    if into is None:
        return entry.render(model)
    if format != "mjcf":
        raise UnusableInput(f"--into {into}: goes with --format mjcf, not {format}")
    return merged_mjcf(model, into)


def held_quantities(format: str) -> frozenset[Held]:
    """Return the quantities that a format holds.

    Raises:
        UnusableInput: The format is unknown.
    """
    return _entry(format).holds


def _entry(name: str) -> _Format:
    if name not in _FORMATS:
        raise UnusableInput(
            f"--format {name}: is no format of an identified robot; there are: "
            f"{', '.join(_FORMATS)}"
        )
    return _FORMATS[name]
