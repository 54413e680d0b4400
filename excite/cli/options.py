"""Options that several commands share: robot, limits, joint parameters and torque noise."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._types import FloatArray
from ..api.design_result import CellOptions
from ..api.input_files import argument_files
from ..api.robots import load_robot, resolve_limits
from ..designer.options import WorkspaceBox, torque_noise_levels
from ..errors import UnusableInput
from ..robot import inertial_parameters
from ..robot.limits import Limits
from ..robot.robot import Payload, Robot

OF_EXCITATION = (
    "--jobs",
    "--backend",
    "--cluster",
    "--parameters",
    "--without",
    "--threshold",
)
"""Options of `excite design` for periodic excitations alone."""
INPUT_FILES = (
    *("limits", "prior", "bounds", "before", "trajectory", "like", "scene", "srdf"),
    *("discriminate", "model", "into"),
)
"""Attributes of options and arguments, besides the robot, that name files, which a command must not
replace."""
INPUT_RECORDINGS = (
    *("recordings", "validate", "discriminating", "carrying", "empty", "recording", "motion"),
    *("given", "for_task"),
)
"""The same of recordings, whose sidecars a command must not replace either."""
ATTRIBUTES = {"--for": "for_task"}
"""Names of attributes that are not those of their options."""


def robot_choices(arguments: argparse.Namespace) -> dict[str, Any]:
    """Arguments of `api.load_robot` that the options state.

    Raises:
        UnusableInput: There are several payloads, or several positions of a locked joint.
    """
    payload, bodies = None, getattr(arguments, "payload", [])
    if len(bodies) > 1:
        raise UnusableInput(
            f"--payload {bodies[1][0]}: there is one already; state one body with the mass, centre "
            "and inertia of all, or add them to the URDF"
        )
    for link, values in bodies:
        numbers = values + (0.0,) * (10 - len(values))
        payload = Payload(link, numbers[0], numbers[1:4], numbers[4:])
    joints = arguments.joints.split(",") if arguments.joints else None
    lock: dict[str, float] = {}
    for name, (value,) in arguments.lock:
        if name in lock:
            raise UnusableInput(f"--lock {name}: is given twice; leave one of them out")
        lock[name] = value
    return {
        "source": arguments.robot,
        "joints": joints,
        "lock": lock,
        "payload": payload,
        "gravity": arguments.gravity,
        "mass": mass[0] if (mass := getattr(arguments, "mass", None)) else None,
        "packages": getattr(arguments, "packages", ()),
    }


def require_floating(arguments: argparse.Namespace, options: Iterable[str]) -> None:
    """Check that no option of a floating base is given without `--floating`.

    Args:
        arguments: The arguments.
        options: The options.

    Raises:
        UnusableInput: One is.
    """
    refuse_given(arguments, options, "is for a robot with --floating; add it")


def refuse_with_floating(arguments: argparse.Namespace, options: Iterable[str]) -> None:
    """Check that no option is given that a floating base does not have.

    Args:
        arguments: The arguments.
        options: The options.

    Raises:
        UnusableInput: One is.
    """
    refuse_given(arguments, options, "is not available with --floating; leave it out")


def refuse_given(arguments: argparse.Namespace, options: Iterable[str], reason: str) -> None:
    """Check that none of some options has another value than its default.

    Args:
        arguments: The arguments.
        options: The options.
        reason: Reason and remedy, for the message.

    Raises:
        UnusableInput: One has.
    """
    for option in options:
        name = ATTRIBUTES.get(option, option[2:].replace("-", "_"))
        if getattr(arguments, name) != arguments.default_of(name):
            raise UnusableInput(f"{option}: {reason}")


def input_files(arguments: argparse.Namespace) -> list[Path]:
    """Return the files that a command reads, which its output must not replace."""
    return list(
        argument_files(
            getattr(arguments, "robot", None),
            *(getattr(arguments, name, None) for name in INPUT_FILES),
            recordings=[
                recording
                for name in INPUT_RECORDINGS
                for recording in _names(getattr(arguments, name, None))
            ],
            shape=getattr(arguments, "shape", None),
        )
    )


def _names(value: str | Sequence[str] | None) -> Sequence[str]:
    """Names that are the value of an attribute."""
    return [value] if isinstance(value, str) else value or []


def robot(arguments: argparse.Namespace) -> Robot:
    """Load the robot that the options describe."""
    return load_robot(**robot_choices(arguments))


def limits(arguments: argparse.Namespace, machine: Robot) -> Limits:
    """Resolve the limits of a robot with the limits file and the margin of the options.

    Raises:
        UnusableInput: The limits file cannot be used.
        MissingLimit: A joint has no usable limit.
    """
    return resolve_limits(machine, arguments.limits or None, getattr(arguments, "margin", None))


def drive(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the joint parameters that the model contains, by `--parameters` and `--without`.

    Raises:
        UnusableInput: `--without` names an unknown parameter.
    """
    without = [name for name in arguments.without.split(",") if name]
    unknown = set(without) - set(inertial_parameters.DRIVE)
    if unknown:
        raise UnusableInput(
            f"--without {min(unknown)}: no such joint parameter; there are "
            f"{', '.join(inertial_parameters.DRIVE)}"
        )
    return (
        ()
        if arguments.parameters == "inertial"
        else tuple(k for k in inertial_parameters.DRIVE if k not in without)
    )


def noise(arguments: argparse.Namespace, machine: Robot) -> tuple[float, ...] | None:
    """Return the stated torque noise per joint [N m or N]; None if none is stated.

    Raises:
        UnusableInput: The number of values does not equal that of the joints.
    """
    if arguments.torque_noise is None:
        return None
    return of_joints(
        "--torque-noise",
        arguments.torque_noise * machine.n
        if len(arguments.torque_noise) == 1
        else arguments.torque_noise,
        machine,
    )


def of_joints(option: str, values: tuple[float, ...], machine: Robot) -> tuple[float, ...]:
    """Return the numbers of an option with one number per moving joint.

    Args:
        option: Name of the option, for messages.
        values: Its numbers.
        machine: The robot.

    Raises:
        UnusableInput: The number of values does not equal that of the joints.
    """
    if len(values) != machine.n:
        raise UnusableInput(
            f"{option}: should hold {machine.n} number(s), one per moving joint "
            f"({', '.join(machine.joints)}), not {len(values)}"
        )
    return values


def columns(arguments: argparse.Namespace) -> dict[str, str]:
    """Return the column names of `--columns`: standard name -> name in the file."""
    return {name: column for stated in arguments.columns for name, column in stated.items()}


def cell_options(arguments: argparse.Namespace) -> CellOptions:
    """Return the surroundings that the options describe."""
    return CellOptions(
        scene=arguments.scene,
        floor=False if arguments.no_floor else arguments.floor,
        clearance=arguments.clearance,
        srdf=arguments.srdf,
        packages=arguments.packages,
        check=not arguments.no_collision,
    )


def boxes(arguments: argparse.Namespace) -> tuple[WorkspaceBox, ...]:
    """Return the boxes of `--box`."""
    return tuple(
        WorkspaceBox(frame, (v[0], v[2], v[4]), (v[1], v[3], v[5])) for frame, v in arguments.box
    )


def noise_in_words(noise: FloatArray, limits: Limits, source: str) -> str:
    """Describe the torque noise that a number of identifiable directions assumes.

    Args:
        noise: Standard deviation for each joint. Shape (n,) [N m or N].
        limits: Limits of the robot.
        source: Its source where it is not the default.
    """
    default = np.allclose(noise, torque_noise_levels(limits, None))
    return "1 % of the torque limits" if default else source
