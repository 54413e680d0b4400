"""Design motions of a robot that stands on one or two feet: certificate and files."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .. import _json
from .._system.progress import Progress, logger
from .._types import FloatArray
from ..designer.certificate import CELL_KEY
from ..designer.sole_geometry import find_sole
from ..designer.support_cell import Surroundings
from ..designer.support_design import SupportDesign, SupportOptions
from ..designer.support_design import design_support as find_motions
from ..designer.support_kinematics import SupportSamples, support_samples
from ..designer.support_trajectory import StatedFoot, SupportTrajectory
from ..recordings.floating_signals import COMPONENTS, POSE
from ..robot.floating_base import FloatingRobot, Rows
from ..robot.inertial_parameters import COULOMB_WIDTH
from ..robot.limits import Limits
from ..trajectory.trajectory_file import package_versions
from .design_result import CellOptions
from .floating_result import load_floating_robot
from .input_files import argument_files
from .robots import RobotSource, resolve_limits
from .saved_result import SavedResult

SUPPORT_FILES = ("trajectory.json", "trajectory.csv", "identifiability.json", "report.html")
"""Files of a design in support."""


@dataclass(frozen=True)
class SupportDesignResult(SavedResult):
    """Designed motions in support.

    Attributes:
        design: The motions with their certificate.
    """

    FILES = SUPPORT_FILES

    design: SupportDesign

    @cached_property
    def trajectory(self) -> SupportTrajectory:
        """The content of `trajectory.json`."""
        design = self.design
        robot, stance, options = design.robot, design.stance, design.options
        certificate = design.certificate
        return SupportTrajectory(
            robot=robot.joint_robot.document(),
            joints=robot.joints,
            feet=tuple(
                StatedFoot(
                    foot.frame,
                    tuple(robot.joints[joint] for joint in foot.joints),
                    foot.half_length,
                    foot.half_width,
                    _triple(foot.in_world.translation),
                    _triple(sole.pose().translation),
                    sole.source,
                    sole.outline,
                )
                for foot, sole in zip(stance.feet, design.options.soles, strict=True)
            ),
            contact=stance.contact,
            base=stance.base,
            pose=stance.pose,
            motions=design.motions,
            rate=options.rate,
            limits=design.limits,
            noise=design.noise,
            criterion=options.criterion.value,
            identifiable=tuple(design.identifiable_counts()),
            base_parameters=design.base.count,
            design={
                "margin": dict(design.limits.margin),
                "starts": options.starts,
                "iterations": options.iterations,
                "prior_deviation": options.prior_deviation,
                **({} if design.cell is None else {CELL_KEY: design.cell.document()}),
            },
            margins=[margin.document() for margin in certificate.margins],
            collision=certificate.collision,
            seed=options.seed,
            versions=package_versions(),
        )

    @cached_property
    def samples(self) -> tuple[SupportSamples, ...]:
        """The motions at the rate of the table, both ends included."""
        design = self.design
        t = np.arange(design.samples_per_motion + 1) / design.options.rate
        return tuple(
            support_samples(design.robot, design.stance, design.parameters, motion, t)
            for motion in design.motions
        )

    def document(self) -> dict[str, Any]:
        """Return the content of `trajectory.json`; floats read back exactly."""
        return self.trajectory.document()

    def html(self) -> str:
        """Return the report as HTML."""
        from ..report.support_design import support_design_page

        return support_design_page(self.trajectory, self.design, self.samples)

    def csv(self) -> str:
        """Return `trajectory.csv`: all motions one after the other.

        Columns are `t`, `base.x` … `base.qw`, `q.<joint>` …, `dq.<joint>` …, `ddq.<joint>` …,
        `tau.<joint>` …, and `wrench.<frame>.fx` … of each foot, in the axes of the frame and about
        its origin.
        """
        design, last = self.design, len(self.samples) - 1
        rows = []
        for number, samples in enumerate(self.samples):
            start = number * design.samples_per_motion / design.options.rate
            table = self._table(samples, start)
            rows.append(table if number == last else table[:-1])
        joints = design.robot.joints
        header = [
            "t",
            *POSE,
            *(f"{name}.{joint}" for name in ("q", "dq", "ddq", "tau") for joint in joints),
            *(
                f"wrench.{foot.frame}.{component}"
                for foot in design.stance.feet
                for component in COMPONENTS
            ),
        ]
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerow(header)
        np.savetxt(stream, np.vstack(rows), fmt="%.12g", delimiter=",")
        return stream.getvalue()

    def _table(self, samples: SupportSamples, start: float) -> FloatArray:
        """Return the rows of one motion that begins at a time [s]."""
        parameters, stance = self.design.parameters, self.design.stance
        friction = parameters.coulomb() * np.tanh(samples.joint_velocity / COULOMB_WIDTH)
        wrenches = []
        for number, foot in enumerate(stance.feet):
            frame = self.design.robot.joint_robot.frame(foot.frame)
            placement = self.design.robot.joint_robot.model.frames[frame].placement
            centre = placement.actInv(foot.in_body).translation
            wrench = samples.wrenches[:, number].copy()
            wrench[:, 3:] += np.cross(centre, wrench[:, :3])
            wrenches.append(wrench)
        return np.column_stack(
            [
                start + samples.t,
                samples.motion.pose,
                samples.motion.q,
                samples.joint_velocity,
                samples.joint_acceleration,
                samples.torque + friction,
                *wrenches,
            ]
        )

    def contents(self) -> dict[str, str]:
        """Return the files of the design by name."""
        analysis = self.design.analysis(Rows.BASE)
        return {
            "trajectory.json": _json.dumps(self.document()),
            "trajectory.csv": self.csv(),
            "identifiability.json": _json.dumps(analysis.document()),
            "report.html": self.html(),
        }

    def __repr__(self) -> str:
        design = self.design
        return (
            f"<SupportDesignResult {design.robot.name}: {len(design.motions)} motions, "
            f"{design.identifiable_counts()[-1]} of {design.base.count} directions identifiable>"
        )


def _triple(point: FloatArray) -> tuple[float, float, float]:
    """Return the coordinates of a point."""
    x, y, z = (float(value) for value in point)
    return x, y, z


def design_support(
    robot: RobotSource | FloatingRobot,
    options: SupportOptions,
    *,
    limits: str | Path | Limits | None = None,
    cell: CellOptions = CellOptions(),  # noqa: B008  # immutable
    progress: Progress | None = None,
) -> SupportDesignResult:
    """Design motions of a robot that stands on one or two feet.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        options: Feet, contact, number and duration of the motions. Without soles, these are found
            from the shapes of the feet.
        limits: Limits file, or limits; None: those of the robot.
        cell: What the bodies keep clear of, besides each other and the ground z = 0; positions
            are in the world.
        progress: Called with a line of text now and then; None: the log.

    Raises:
        CheckFailed: A motion cannot be certified.
        Infeasible: The robot cannot stand within its limits.
        UnusableInput: Options are inconsistent, or the robot cannot be used.
    """
    loaded = load_floating_robot(robot)
    table = limits if isinstance(limits, Limits) else resolve_limits(loaded.joint_robot, limits)
    if not options.soles:
        soles = (
            find_sole(loaded.joint_robot, frame, cell.package_folders) for frame in options.frames
        )
        options = replace(options, soles=tuple(soles))
    surroundings = (
        Surroundings(cell.read_scene(), cell.package_folders, cell.is_required)
        if cell.check
        else None
    )
    report = logger.info if progress is None else progress
    return SupportDesignResult(
        find_motions(loaded, table, options, report, surroundings),
        inputs=argument_files(loaded.joint_robot.source, limits, cell.scene, cell.srdf),
    )
