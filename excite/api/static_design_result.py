"""Design static poses that show the mass and the centre of mass of a payload."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .. import _json
from .._system.progress import Progress, logger
from ..collision.workcell import Cell
from ..designer import identifiability
from ..designer.identifiability_threshold import IDENTIFIABLE_VARIANCE
from ..designer.options import DesignOptions
from ..designer.static_poses import StaticDesign, design_static_poses
from ..robot import base_parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory
from .design_result import MOTION_FILES, CellOptions, motion_files
from .identification_result import REFERENCE_RATE
from .input_files import argument_files
from .robots import RobotSource, load_robot, resolve_limits
from .saved_result import SavedResult

STATIC_FILES = (*MOTION_FILES, "identifiability.json", "report.html")
"""Files of a design of static poses."""
STATIC_POSES = 6
"""Number of poses, unless it is stated."""


@dataclass(frozen=True)
class StaticDesignResult(SavedResult):
    """Static poses with a certified motion through them.

    Attributes:
        design: The poses, the motion and its certificate.
        robot: The robot.
        limits: Its limits.
        cell: Surroundings that were checked; None if distances were not checked.
    """

    FILES = STATIC_FILES

    design: StaticDesign
    robot: Robot
    limits: Limits
    cell: Cell | None

    @property
    def ok(self) -> bool:
        """True if the certificate holds."""
        return self.design.certificate.ok

    @property
    def trajectory(self) -> Trajectory:
        """The content of `trajectory.json`."""
        return self.design.trajectory

    @cached_property
    def analysis(self) -> identifiability.Identifiability:
        """Identifiability of the robot by the complete motion, with the ways between the poses."""
        trajectory, standard = self.trajectory, self.design.parameters
        samples = trajectory.motion.samples(trajectory.motion.grid(REFERENCE_RATE))
        return identifiability.analyse_root(
            standard,
            base_parameters.find(self.robot, standard, self.limits),
            identifiability.information_root(self.robot, standard, samples, trajectory.noise),
            trajectory.noise,
            self.robot,
            threshold=IDENTIFIABLE_VARIANCE,
            samples=len(samples),
        )

    def document(self) -> dict[str, Any]:
        """Return what `excite design --for-payload LINK --static --json` prints."""
        design, trajectory = self.design, self.trajectory
        return {
            "ok": self.ok,
            "robot": self.robot.name,
            "joints": list(self.robot.joints),
            "static": {"poses": design.poses.tolist(), "efficiency": design.efficiency},
            "payload": design.deviation.document(),
            "criteria": dict(trajectory.criteria),
            "margins": trajectory.margins,
            "verdict": design.certificate.document()["verdict"],
            "collision": trajectory.collision,
            "duration": trajectory.motion.duration,
        }

    def contents(self) -> dict[str, str]:
        """Return the files of the design by name."""
        return {
            **motion_files(self.trajectory, self.robot, self.design.parameters),
            "identifiability.json": _json.dumps(self.analysis.document()),
            "report.html": self.html(),
        }

    def html(self) -> str:
        """Return the report as HTML."""
        from ..report.static_poses import static_poses_page

        return static_poses_page(self.design, self.robot, self.cell)

    def __repr__(self) -> str:
        return (
            f"<StaticDesignResult {self.robot.name}: {len(self.design.poses)} poses in "
            f"{self.trajectory.motion.duration:.2f} s>"
        )


def design_static(
    robot: RobotSource,
    link: str,
    *,
    poses: int = STATIC_POSES,
    limits: str | Path | Limits | None = None,
    margin: float | None = None,
    cell: CellOptions = CellOptions(),  # noqa: B008
    options: DesignOptions = DesignOptions(),  # noqa: B008
    start: Sequence[float] | None = None,
    speed: float = 1.0,
    force: bool = False,
    progress: Progress | None = None,
) -> StaticDesignResult:
    """Design static poses for a payload, as `excite design --for-payload LINK --static` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        link: Link that carries the payload.
        poses: Number of poses.
        limits: Limits file, or limits; None: the URDF's.
        margin: Share of velocity, acceleration, jerk and torque limits to keep free [1].
        cell: Surroundings; by default the floor and the robot itself.
        options: Rate, noise, boxes, uncertainty and seed.
        start: Pose at which the motion begins and ends at rest. Shape (n,) [rad or m].
        speed: Share of the speed at which the motion is played.
        force: Return a motion even if its certificate fails.
        progress: Called with each line of progress; None: the logger "excite" at level INFO.

    Raises:
        UnusableInput: An argument or a file cannot be used.
        Infeasible: There are no such poses, or no ways between them.
        CheckFailed: The certificate fails and `force` is not set.
    """
    loaded = load_robot(robot)
    table = resolve_limits(loaded, limits, margin)
    for box in options.boxes:
        loaded.frame(box.frame)
    workcell, unchecked = cell.cell(loaded, table)
    design = design_static_poses(
        loaded,
        table,
        options,
        link,
        poses,
        start=None if start is None else np.asarray(start, float),
        cell=workcell,
        unchecked_reason=unchecked,
        speed=speed,
        force=force,
        progress=progress or logger.info,
    )
    inputs = argument_files(loaded.source, limits, cell.scene, cell.srdf)
    return StaticDesignResult(design, loaded, table, workcell, inputs=inputs)
