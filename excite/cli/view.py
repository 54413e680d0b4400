"""`excite view`: play a motion in a browser, with the shapes of the robot and its surroundings.

It uses Pinocchio's visualizer for viser (extra [view]).
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib.util
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from .._system.bounded_wait import value_within
from .._system.progress import logger
from .._system.signals import raised
from .._types import FloatArray
from ..collision import scene_file
from ..collision.distance_query import Body
from ..collision.geometry import ShapeKind
from ..collision.workcell import Cell
from ..designer.certificate import CELL_KEY
from ..errors import UnusableInput
from ..robot.robot import Robot
from ..trajectory import trajectory_file
from ..trajectory.trajectory_file import Trajectory
from .outcome import Outcome

FRAME_RATE = 50.0
"""Frames per second [Hz]."""
START_SECONDS = 30.0
"""Longest time in which the server has to start [s]; it takes less than one."""
FLOOR_SIZE = 4.0
"""Side of the square that represents the floor [m]."""
ROBOT_COLOUR = np.array([0.35, 0.55, 0.8, 1.0])
"""Red, green, blue and opacity of the robot's shapes."""
SURROUNDINGS_COLOUR = np.array([0.65, 0.68, 0.72, 0.6])
"""Red, green, blue and opacity of the shapes around the robot."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite view`: repeat a trajectory until interrupted, or play it once with `--once`.

    Raises:
        UnusableInput: viser is not installed, its server cannot start, or a file cannot be used.
    """
    if not 0.0 < arguments.speed <= 4.0:
        raise UnusableInput(f"--speed {arguments.speed:g} should be above 0 and at most 4")
    trajectory = trajectory_file.read_trajectory(Path(arguments.trajectory))
    robot = trajectory.load_robot(arguments.robot)
    cell = _cell(trajectory, robot)
    if importlib.util.find_spec("viser") is None:
        raise UnusableInput(
            "excite view: viser is not installed; install the extra: "
            ".venv/bin/pip install -e '.[view]'"
        )
    from pinocchio.visualize import ViserVisualizer

    shapes = geometry(cell)
    player = ViserVisualizer(robot.model, shapes, shapes)
    with contextlib.redirect_stdout(sys.stderr):  # standard output is for the JSON document
        player.initViewer(viewer=_start_server(arguments.host, arguments.port))
        player.loadViewerModel()
        player.displayCollisions(False)
        host = f"[{arguments.host}]" if ":" in arguments.host else arguments.host
        address = f"http://{host}:{player.viewer.get_port()}"
        logger.info(
            f"{address} shows {trajectory.motion.duration:.1f} s of {robot.name}; Ctrl-C ends it"
        )
        with contextlib.suppress(KeyboardInterrupt), raised():
            _play(player, trajectory, robot, arguments.speed)
            while not arguments.once:
                _play(player, trajectory, robot, arguments.speed)
        player.viewer.stop()
    return 0, {"address": address, "collision": trajectory.collision}, trajectory.collision


def _start_server(host: str, port: int) -> Any:
    """Start viser's server.

    viser waits for ever for a server that cannot start: the address is tried before, and the
    server is made in a thread.

    Raises:
        UnusableInput: The computer has no such address, or the server does not start.
    """
    import viser

    address, free = _bindable(host, port)
    try:
        return value_within(START_SECONDS, lambda: viser.ViserServer(address, free))
    except TimeoutError:
        raise UnusableInput(
            f"excite view: the server at {address}, port {free}, has not started within "
            f"{START_SECONDS:g} s; give another --host or --port"
        ) from None


def _bindable(host: str, port: int) -> tuple[str, int]:
    """Return an address of a host at which a server may listen, and the first free port."""
    reason = "none of these ports is free"
    try:
        # by RFC 6761 that is this computer, whatever its resolver says
        name = "127.0.0.1" if host == "localhost" else host
        entries = socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        entries, reason = [], str(error)
    for family, kind, protocol, _, address in entries:
        for number in range(port, 1 << 16):
            try:
                with socket.socket(family, kind, protocol) as trial:
                    trial.bind((address[0], number))
                return str(address[0]), number
            except OSError as error:
                if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                    reason = error.strerror or str(error)
                    break
    raise UnusableInput(
        f"excite view: no server can listen at --host {host}, --port {port} or above ({reason}); "
        "give localhost, or 0.0.0.0 for all addresses of this computer"
    )


def _cell(trajectory: Trajectory, robot: Robot) -> Cell:
    """Build the cell that the file states; without one, the shapes of the URDF alone."""
    if CELL_KEY in trajectory.design:
        cell, fault = scene_file.rebuild_cell(robot, trajectory.limits, trajectory.design[CELL_KEY])
        if cell is None:
            raise UnusableInput(f"{robot.source}: {fault}")
        return cell
    return scene_file.build_cell(robot, trajectory.limits, scene_file.Scene(floor=False))


def _play(player: Any, trajectory: Trajectory, robot: Robot, speed: float) -> None:
    begun, duration = time.perf_counter(), trajectory.motion.duration / speed
    while (now := time.perf_counter() - begun) < duration:
        player.display(robot.expand(trajectory.motion.at(np.array([now * speed]))[0]))
        time.sleep(1.0 / FRAME_RATE)


def geometry(cell: Cell) -> pin.GeometryModel:
    """Return all bodies in shapes that the visualizer can draw.

    It has neither capsules nor half spaces: these become a cylinder with two spheres, and a thin
    box.
    """
    model = pin.GeometryModel()
    for body in cell.bodies:
        for number, (solid, placement, path, scale) in enumerate(_drawable_shapes(body)):
            entry = pin.GeometryObject(
                f"{body.name}_{number}", body.joint, placement, solid, path, scale
            )
            entry.meshColor = SURROUNDINGS_COLOUR if body.is_surrounding else ROBOT_COLOUR
            model.addGeometryObject(entry)
    return model


def _drawable_shapes(
    body: Body,
) -> Iterator[tuple[coal.CollisionGeometry, pin.SE3, str, FloatArray]]:
    unit_scale = np.ones(3)
    for shape, placement, solid in zip(body.shapes, body.placements, body.solids, strict=True):
        if shape.kind is ShapeKind.CAPSULE:
            radius, length = shape.size
            yield coal.Cylinder(radius, length), placement, "", unit_scale
            for end in (-0.5 * length, 0.5 * length):
                yield (
                    coal.Sphere(radius),
                    placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])),
                    "",
                    unit_scale,
                )
        elif shape.kind is ShapeKind.FLOOR:
            below = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.01]))
            yield coal.Box(FLOOR_SIZE, FLOOR_SIZE, 0.02), placement * below, "", unit_scale
        else:
            yield (
                solid,
                placement,
                shape.file or "",
                np.array(shape.size) if shape.kind is ShapeKind.MESH else unit_scale,
            )
