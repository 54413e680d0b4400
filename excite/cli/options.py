"""What the options of several commands mean: robots, limits, parameters and noise from the command
line."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..collision.workcell import NOT_CHECKED, Cell
from ..errors import UnusableInput
from ..robot import inertial_parameters
from ..robot import limits as limit_tables
from ..robot.limits import Limits
from ..robot.robot import Payload, Robot, load


def robot(arguments: argparse.Namespace) -> Robot:
    """The robot that the options describe."""
    payload = None
    if arguments.payload:
        link, values = arguments.payload
        values += (0.0,) * (10 - len(values))
        payload = Payload(link, values[0], values[1:4], values[4:])
    joints = arguments.joints.split(",") if arguments.joints else None
    lock = {name: value for name, (value,) in arguments.lock}
    return load(
        arguments.robot, joints=joints, lock=lock, payload=payload, gravity=arguments.gravity
    )


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
    around = around.overridden(
        False if arguments.no_floor else arguments.floor, arguments.clearance
    )
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
            f"--without {min(unknown)}: no such joint parameter; there are "
            f"{', '.join(inertial_parameters.DRIVE)}"
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
    return of_joints(
        "--torque-noise",
        arguments.torque_noise * machine.n
        if len(arguments.torque_noise) == 1
        else arguments.torque_noise,
        machine,
    )


def of_joints(option: str, values: tuple[float, ...], machine: Robot) -> tuple[float, ...]:
    """An option's numbers, one per moving joint. Raises UnusableInput for another number of
    them."""
    if len(values) != machine.n:
        raise UnusableInput(
            f"{option}: should hold {machine.n} number(s), one per moving joint "
            f"({', '.join(machine.joints)}), not {len(values)}"
        )
    return values
