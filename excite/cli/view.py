"""`excite view`: a motion in a browser, the robot's shapes among its surroundings (pin's viser
visualizer; extra [view])."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from .._system.signals import raised
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

Array = np.ndarray
FRAMES = 50.0
"""Pictures a second."""
FLOOR = 4.0
ROBOT, AROUND = np.array([0.35, 0.55, 0.8, 1.0]), np.array([0.65, 0.68, 0.72, 0.6])


def run(arguments: argparse.Namespace) -> Outcome:
    """Play a trajectory over and over until interrupted; `--once` once."""
    if not 0.0 < arguments.speed <= 4.0:
        raise UnusableInput(f"--speed {arguments.speed:g} should be above 0 and at most 4")
    trajectory = trajectory_file.read_trajectory(Path(arguments.trajectory))
    robot = trajectory.load_robot(arguments.robot)
    cell = _cell(trajectory, robot)
    if importlib.util.find_spec("viser") is None:
        raise UnusableInput(
            "excite view: viser is not installed; install the extra: pip install 'excite[view]'"
        )
    import viser
    from pinocchio.visualize import ViserVisualizer

    shown = geometry(cell)
    player = ViserVisualizer(robot.model, shown, shown)
    with contextlib.redirect_stdout(
        sys.stderr
    ):  # what viser says has no place where the document goes
        player.initViewer(viewer=viser.ViserServer(arguments.host, arguments.port))
        player.loadViewerModel()
        player.displayCollisions(False)
        address = f"http://{player.viewer.get_host()}:{player.viewer.get_port()}"
        arguments.console.progress(
            f"{address} shows {trajectory.motion.duration:.1f} s of {robot.name}; Ctrl-C ends it"
        )
        with contextlib.suppress(KeyboardInterrupt), raised():
            _play(player, trajectory, robot, arguments.speed)
            while not arguments.once:
                _play(player, trajectory, robot, arguments.speed)
        player.viewer.stop()
    return 0, {"address": address, "collision": trajectory.collision}, trajectory.collision


def _cell(trajectory: Trajectory, robot: Robot) -> Cell:
    """What the file states; where it states none, the shapes of the URDF without surroundings."""
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
        time.sleep(1.0 / FRAMES)


def geometry(cell: Cell) -> pin.GeometryModel:
    """All bodies as the visualizer can draw them: it knows neither capsules nor half spaces."""
    model = pin.GeometryModel()
    for body in cell.bodies:
        for number, (solid, placement, path, scale) in enumerate(_drawn(body)):
            entry = pin.GeometryObject(
                f"{body.name}_{number}", body.joint, placement, solid, path, scale
            )
            entry.meshColor = AROUND if body.is_surrounding else ROBOT
            model.addGeometryObject(entry)
    return model


def _drawn(body: Body) -> Iterator[tuple[coal.CollisionGeometry, pin.SE3, str, Array]]:
    one_to_one = np.ones(3)
    for one, placement, solid in zip(body.shapes, body.placements, body.solids, strict=True):
        if one.kind is ShapeKind.CAPSULE:
            radius, length = one.size
            yield coal.Cylinder(radius, length), placement, "", one_to_one
            for end in (-0.5 * length, 0.5 * length):
                yield (
                    coal.Sphere(radius),
                    placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])),
                    "",
                    one_to_one,
                )
        elif one.kind is ShapeKind.FLOOR:
            below = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.01]))
            yield coal.Box(FLOOR, FLOOR, 0.02), placement * below, "", one_to_one
        else:
            yield (
                solid,
                placement,
                one.file or "",
                np.array(one.size) if one.kind is ShapeKind.MESH else one_to_one,
            )
