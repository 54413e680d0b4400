"""Design motions of a robot that stands on one or two feet: certificate and files."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import _json
from .._system.output_files import output_folder
from .._system.progress import Progress, logger
from .._types import FloatArray
from ..designer.support_design import SupportDesign, SupportOptions
from ..designer.support_design import design_support as find_motions
from ..designer.support_kinematics import SupportSamples, support_samples
from ..designer.support_problem import motion_duration, rest_to_rest_phase
from ..recordings.floating_signals import COMPONENTS, POSE
from ..robot.floating_base import FloatingRobot, Rows
from ..robot.inertial_parameters import COULOMB_WIDTH
from ..robot.limits import Limits
from ..trajectory.trajectory_file import package_versions
from .floating_result import load_floating_robot
from .robots import RobotSource, resolve_limits

SCHEMA = "excite.support_trajectory/1"
"""Schema of the `trajectory.json` of a design in support."""

SUPPORT_FILES = ("trajectory.json", "trajectory.csv", "identifiability.json")
"""Files of a design in support."""

BASE_NAMES = tuple(f"base.{name}" for name in ("x", "y", "z", "roll", "pitch", "yaw"))
"""Names of the base coordinates of the Fourier series."""


@dataclass(frozen=True)
class SupportDesignResult:
    """Designed motions in support.

    Attributes:
        design: The motions with their certificate.
    """

    design: SupportDesign

    def document(self) -> dict[str, Any]:
        """Return the content of `trajectory.json`; floats read back exactly."""
        design = self.design
        robot, stance, options = design.robot, design.stance, design.options
        series = [motion.fourier for motion in design.motions]
        first = series[0]
        names = [*BASE_NAMES, *robot.joints]
        legs = {len(BASE_NAMES) + int(joint) for joint in stance.leg_joints}
        certificate = design.certificate
        return {
            "schema": SCHEMA,
            "robot": {
                "name": robot.name,
                "source": robot.source,
                "sha256": robot.joint_robot.sha256,
                **robot.joint_robot.options,
            },
            "joints": list(robot.joints),
            "support": [
                {
                    "frame": foot.frame,
                    "joints": [robot.joints[joint] for joint in foot.joints],
                    "half_length": foot.half_length,
                    "half_width": foot.half_width,
                    "centre": np.array(foot.in_world.translation).tolist(),
                }
                for foot in stance.feet
            ],
            "contact": {
                "friction": stance.contact.friction,
                "cop_margin": stance.contact.margin,
                "least_share": stance.contact.least_share,
            },
            "standing": {
                "base": dict(zip(BASE_NAMES, stance.base.tolist(), strict=True)),
                "joints": dict(zip(robot.joints, stance.pose.tolist(), strict=True)),
            },
            "coordinates": [name for i, name in enumerate(names) if i not in legs],
            "base_frequency": first.omega,
            "harmonics": first.harmonics,
            "period": first.period,
            "duration": motion_duration(first.period),
            "phase": [list(piece) for piece in rest_to_rest_phase(first.period).pieces[0]],
            "motions": [
                {
                    "sine": fourier.sine.tolist(),
                    "cosine": fourier.cosine.tolist(),
                    "offset": fourier.offset.tolist(),
                }
                for fourier in series
            ],
            "rate": options.rate,
            "limits": design.limits.document(),
            "wrench_noise": {"force": design.noise.force, "moment": design.noise.moment},
            "torque_noise": dict(zip(robot.joints, design.noise.torque.tolist(), strict=True)),
            "criterion": options.criterion.value,
            "identifiable": design.identifiable_counts(),
            "base_parameters": design.base.count,
            "margins": [margin.document() for margin in certificate.margins],
            "collision": certificate.collision,
            "seed": options.seed,
            "versions": package_versions(),
        }

    def csv(self) -> str:
        """Return `trajectory.csv`: all motions one after the other.

        Columns are `t`, `base.x` … `base.qw`, `q.<joint>` …, `dq.<joint>` …, `ddq.<joint>` …,
        `tau.<joint>` …, and `wrench.<frame>.fx` … of each foot, in the axes of the frame and about
        its origin.
        """
        design = self.design
        rows = []
        for number, motion in enumerate(design.motions):
            is_last = number == len(design.motions) - 1
            count = design.samples_per_motion + is_last
            t = np.arange(count) / design.options.rate
            samples = support_samples(design.robot, design.stance, design.parameters, motion, t)
            start = number * design.samples_per_motion / design.options.rate
            rows.append(self._table(samples, start))
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
        }

    def save(self, folder: str | Path) -> list[Path]:
        """Write the files named in `contents`; return their paths.

        Raises:
            UnusableInput: The files cannot be written.
        """
        return output_folder(Path(folder), SUPPORT_FILES).replace(self.contents())

    def __repr__(self) -> str:
        design = self.design
        return (
            f"<SupportDesignResult {design.robot.name}: {len(design.motions)} motions, "
            f"{design.identifiable_counts()[-1]} of {design.base.count} directions identifiable>"
        )


def design_support(
    robot: RobotSource | FloatingRobot,
    options: SupportOptions,
    *,
    limits: str | Path | Limits | None = None,
    progress: Progress | None = None,
) -> SupportDesignResult:
    """Design motions of a robot that stands on one or two feet.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        options: Feet, contact, number and duration of the motions.
        limits: Limits file, or limits; None: those of the robot.
        progress: Called with a line of text now and then; None: the log.

    Raises:
        CheckFailed: A motion cannot be certified.
        Infeasible: The robot cannot stand within its limits.
        UnusableInput: Options are inconsistent, or the robot cannot be used.
    """
    loaded = load_floating_robot(robot)
    table = limits if isinstance(limits, Limits) else resolve_limits(loaded.joint_robot, limits)
    return SupportDesignResult(
        find_motions(loaded, table, options, logger.info if progress is None else progress)
    )
