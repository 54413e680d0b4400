"""Registry of the formats of an identified robot, and the function that writes any of them.

To add a format, add a module with a function that renders a `SimulatorModel` as text and a set
`HOLDS` of the quantities that the format holds, and an entry to `_FORMATS` below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import UnusableInput
from ..schemas.effects import EffectDocument
from . import c_file, isaaclab_file, mjcf_file, python_friction, sdf_file, urdf_file
from .mjcf_merge import merged_mjcf
from .simulator_model import Held, Remainder, SimulatorModel


@dataclass(frozen=True)
class _Format:
    """A format of an identified robot.

    Attributes:
        description: One line for `excite formats`.
        render: Returns the text of the file.
        holds: Quantities that the format holds.
        computes: Whether it computes an effect for which simulators have no quantity.
    """

    description: str
    render: Callable[[SimulatorModel], str]
    holds: frozenset[Held]
    computes: Callable[[EffectDocument], bool] = lambda effect: False


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
    "c": _Format(
        "C99 without dependencies: inverse dynamics, friction with its state, gravity torque",
        c_file.c_text,
        c_file.HOLDS,
        python_friction.is_term,
    ),
    "python-friction": _Format(
        "Python module (NumPy only): friction of q, dq and load, with memory; for any simulator",
        python_friction.python_text,
        python_friction.HOLDS,
        python_friction.is_term,
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


def remainders(model: SimulatorModel, format: str) -> list[Remainder]:
    """Return the parts of an identified robot that a format does not hold, the largest first.

    Raises:
        UnusableInput: The format is unknown.
    """
    entry = _entry(format)
    return model.remainders(entry.holds, entry.computes)


def require_format(name: str) -> None:
    """Raise UnusableInput if there is no such format."""
    _entry(name)


def _entry(name: str) -> _Format:
    if name not in _FORMATS:
        raise UnusableInput(
            f"--format {name}: is no format of an identified robot; there are: "
            f"{', '.join(_FORMATS)}"
        )
    return _FORMATS[name]
