"""What the options of several commands mean: robots, limits, parameters and noise from the command line."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..collision.workcell import NOT_CHECKED, Cell
from ..errors import UnusableInput
from ..robot import inertial_parameters
from ..robot import limits as limit_tables
from ..robot.limits import Limits
from ..robot.robot import Payload, Robot, load


def floats(option: str, text: str, counts: Sequence[int]) -> list[float]:
    """Numbers separated by commas, as many as one of `counts`."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError as error:
        raise UnusableInput(f"{option} {text}: should be numbers separated by commas") from error
    if len(values) not in counts:
        raise UnusableInput(
            f"{option} {text}: should hold {' or '.join(map(str, counts))} number(s), not {len(values)}"
        )
    if not np.isfinite(values).all():
        raise UnusableInput(f"{option} {text}: should hold finite numbers")
    return values


def robot(arguments: argparse.Namespace) -> Robot:
    """The robot that the options describe."""
    lock: dict[str, float] = {}
    for entry in arguments.lock:
        name, separator, value = entry.partition("=")
        if not separator:
            raise UnusableInput(f"--lock {entry}: should read NAME=VALUE")
        lock[name] = floats(f"--lock {name}", value, (1,))[0]
    payload = None
    if arguments.payload:
        link, separator, numbers = arguments.payload.rpartition(":")
        if not separator:
            raise UnusableInput(
                f"--payload {arguments.payload}: should read LINK:MASS[,CX,CY,CZ[,IXX,IXY,IYY,IXZ,IYZ,IZZ]]"
            )
        values = floats("--payload", numbers, (1, 4, 10))
        values += [0.0] * (10 - len(values))
        payload = Payload(link, values[0], tuple(values[1:4]), tuple(values[4:]))  # type: ignore[arg-type]
    gravity = floats("--gravity", arguments.gravity, (3,))
    joints = arguments.joints.split(",") if arguments.joints else None
    return load(arguments.robot, joints=joints, lock=lock, payload=payload, gravity=gravity)


def limits(arguments: argparse.Namespace, machine: Robot) -> Limits:
    """Its limits."""
    return limit_tables.resolve(
        machine,
        Path(arguments.limits) if arguments.limits else None,
        getattr(arguments, "margin", None),
    )


def cell(arguments: argparse.Namespace, machine: Robot, table: Limits) -> tuple[Cell | None, str]:
    """What the robot must not touch, or None and why there is nothing to check."""
    from ..collision import scene_file

    if arguments.no_collision:
        return None, f"{NOT_CHECKED} (--no-collision)"
    around = scene_file.read(Path(arguments.scene)) if arguments.scene else scene_file.Scene()
    floor = None if arguments.floor is None else floats("--floor", arguments.floor, (1,))[0]
    around = around.overridden(False if arguments.no_floor else floor, arguments.clearance)
    if arguments.srdf:
        around = around.with_srdf(Path(arguments.srdf))
    asked = bool(
        arguments.scene
        or arguments.srdf
        or arguments.floor is not None
        or arguments.clearance is not None
    )
    return scene_file.known(machine, table, around, arguments.packages, required=asked)


def drive(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Which joint parameters the options leave in."""
    without = [name for name in arguments.without.split(",") if name]
    unknown = set(without) - set(inertial_parameters.DRIVE)
    if unknown:
        raise UnusableInput(
            f"--without {min(unknown)}: no such joint parameter; there are {', '.join(inertial_parameters.DRIVE)}"
        )
    return (
        ()
        if arguments.parameters == "inertial"
        else tuple(k for k in inertial_parameters.DRIVE if k not in without)
    )


def noise(arguments: argparse.Namespace, machine: Robot) -> tuple[float, ...] | None:
    """Torque noise per joint as stated, None where it is not."""
    if arguments.torque_noise is None:
        return None
    values = floats("--torque-noise", arguments.torque_noise, (1, machine.n))
    if min(values) <= 0.0:
        raise UnusableInput(f"--torque-noise {arguments.torque_noise}: should be positive")
    return tuple(values * machine.n if len(values) == 1 else values)
