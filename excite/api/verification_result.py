"""Verify a trajectory file, and export it for a controller."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import _json, exporters
from .._system.one_or_several import one_or_several_texts
from .._system.output_files import output_files, output_folder
from .._types import Paths
from ..collision.scene_file import files_of_cell
from ..designer import certificate as certificates
from ..designer import support_trajectory
from ..designer.certificate import CELL_KEY, Certificate, CertificateVerdict
from ..designer.support_trajectory import SupportTrajectory, parse_support_trajectory
from ..errors import CheckFailed, UnusableInput
from ..exporters import file_format
from ..exporters.goal_options import GoalOptions
from ..exporters.next_steps import next_steps
from ..robot import inertial_parameters
from ..robot.floating_base import FloatingRobot
from ..robot.limits import Limits, from_sources, limits_files
from ..robot.robot import Robot
from ..schemas.support_trajectory import SCHEMA as SUPPORT_SCHEMA
from ..trajectory.trajectory_file import (
    Trajectory,
    parse_trajectory,
    read_document,
    stated_schema,
)
from .design_result import nominal_torque
from .input_files import argument_files


@dataclass(frozen=True)
class VerificationResult:
    """A trajectory with the certificate that was computed from its file.

    Attributes:
        certificate: Verdicts on limits and clearance, with every margin.
        trajectory: Content of the file.
        robot: The robot, with a floating base for motions in support.
        limits: Limits, read from their sources.
    """

    certificate: Certificate
    trajectory: Trajectory | SupportTrajectory
    robot: Robot | FloatingRobot
    limits: Limits

    @property
    def ok(self) -> bool:
        """True if nothing failed; the clearance may be unchecked."""
        return self.certificate.ok

    def text(self) -> str:
        """Return the table of margins and both verdicts, as `excite verify` prints them."""
        margins = self.certificate.margins
        limit, joint = (
            max(width, *(len(getattr(m, name)) + 1 for m in margins))
            for name, width in (("title", 13), ("joint", 25))
        )
        rows = [
            f"{'limit':{limit}}{'joint':{joint}}{'worst':>12}{'bound':>12}{'free':>9}"
            f"{'time [s]':>10}"
        ]
        rows += [
            f"{m.title:{limit}}{m.joint:{joint}}{m.value:12.5g}{m.bound:12.5g}"
            f"{certificates.format_percent(m.free_share):>9}{m.time:10.3f}"
            for m in self.certificate.margins
        ]
        return "\n".join([*rows, "", *self.certificate.verdict_lines()])

    def document(self) -> dict[str, Any]:
        """Return what `excite verify --json` prints."""
        return self.certificate.document()

    def save(self, folder: str | Path) -> list[Path]:
        """Write `certificate.json`; return its path.

        Raises:
            UnusableInput: The file cannot be written.
        """
        contents = {"certificate.json": _json.dumps(self.document())}
        return output_folder(Path(folder), tuple(contents)).replace(contents)

    def report(self, path: str | Path) -> Path:
        """Write the table of margins as a text file; return its path.

        Raises:
            UnusableInput: The file cannot be written.
        """
        path = Path(path)
        return output_files(path).replace({path.name: self.text() + "\n"})[0]

    def __repr__(self) -> str:
        clearance, limits = self.certificate.clearance.value, self.certificate.limits.value
        return f"<VerificationResult {self.robot.name}: clearance {clearance}, limits {limits}>"


def verify(
    trajectory: str | Path,
    *,
    robot: str | Path | None = None,
    limits: str | Path | None = None,
    packages: Paths = (),
) -> VerificationResult:
    """Recompute limits, clearance and criteria of a trajectory file, as `excite verify` does.

    Limits are compared with their sources, and the cell is built again from its files. Motions of a
    robot on its feet are verified likewise, with the contact of the feet.

    Args:
        trajectory: Path of a `trajectory.json`.
        robot: Present path of the URDF; None: that of the file.
        limits: Present path of the limits file; None: that of the file.
        packages: Further folder or folders of `package://` meshes.

    Raises:
        UnusableInput: A file is missing or malformed.
    """
    packages = one_or_several_texts(packages)
    path = Path(trajectory)
    content = read_document(path)
    if stated_schema(content) != SUPPORT_SCHEMA:
        return VerificationResult(*_verify_arm(content, path, robot, limits, packages))
    motions = parse_support_trajectory(content, path)
    loaded = motions.load_robot(None if robot is None else str(robot))
    file = None if limits is None else Path(limits)
    truth = from_sources(loaded.joint_robot, motions.limits, file, path.resolve().parent)
    certificate = support_trajectory.verify(motions, loaded, truth, packages)
    return VerificationResult(certificate, motions, loaded, truth)


def _verify_arm(
    content: Any,
    path: Path,
    robot: str | Path | None,
    limits: str | Path | None,
    packages: Sequence[str],
) -> tuple[Certificate, Trajectory, Robot, Limits]:
    """Verify the content of the trajectory file of a robot with a fixed base; see `verify`."""
    trajectory = parse_trajectory(content, path)
    loaded = trajectory.load_robot(None if robot is None else str(robot))
    file = None if limits is None else Path(limits)
    truth = from_sources(loaded, trajectory.limits, file, path.resolve().parent)
    certificate = certificates.verify_with_cell_on_disk(trajectory, loaded, truth, packages)
    return certificate, trajectory, loaded, truth


@dataclass(frozen=True)
class ExportedFile:
    """A file that was exported for a controller.

    Attributes:
        path: The file.
        format: Its format.
        verdict: Lines about clearance and limits; a third line if the slower motion breaks a limit.
        certificate: Certificate of the exported trajectory at full speed.
        forced: True if the file was written although a check failed.
        next_steps: Lines that say how to run the file, how to record, and how to identify.
    """

    path: Path
    format: str
    verdict: tuple[str, ...]
    certificate: Certificate
    forced: bool
    next_steps: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return what `excite export --json` prints."""
        return {
            "file": str(self.path),
            "format": self.format,
            "forced": self.forced,
            "verdict": self.certificate.document()["verdict"],
            "collision": self.certificate.collision,
            "next_steps": list(self.next_steps),
        }


def export(
    trajectory: str | Path,
    format: str,
    path: str | Path,
    *,
    speed: float = 1.0,
    rate: float | None = None,
    force: bool = False,
    robot: str | Path | None = None,
    limits: str | Path | None = None,
    packages: Paths = (),
    goal: GoalOptions = GoalOptions(),  # noqa: B008  # immutable
) -> ExportedFile:
    """Verify a trajectory and export it for a controller, as `excite export` does.

    Args:
        trajectory: Path of a `trajectory.json`.
        format: Name of a format; `excite.exporters.FORMATS` lists them.
        path: The file to write.
        speed: Share of the speed at which the motion is played.
        rate: Rows or knots per second, if the format allows a choice [Hz].
        force: Write the file even if a check fails; it states the failure.
        robot: Present path of the URDF.
        limits: Present path of the limits file.
        packages: Further folder or folders of `package://` meshes.
        goal: Lead and tolerances of a ROS 2 goal.

    Raises:
        UnusableInput: A file is missing or malformed, or the format does not fit the robot.
        CheckFailed: The certificate fails, or the slower motion breaks a limit, and `force` is not
            set.
    """
    if format not in exporters.FORMATS:
        known = ", ".join(exporters.FORMATS)
        raise UnusableInput(f"--format {format}: no such format; there are {known}")
    file_format.check_options(speed, rate)
    goal.require_format(format)
    # checked before the certificate is computed, which takes time
    inputs = argument_files(robot, trajectory, limits)
    output_files(Path(path), inputs=inputs)
    path_of_motion = Path(trajectory)
    document = read_document(path_of_motion)
    if stated_schema(document) == SUPPORT_SCHEMA:
        raise UnusableInput(
            f"{trajectory}: motions of a robot on its feet are not exported; play the "
            "trajectory.csv of its folder, which has positions, torques and wrenches of the feet"
        )
    certificate, motion, loaded, truth = _verify_arm(
        document, path_of_motion, robot, limits, one_or_several_texts(packages)
    )
    cell = motion.design.get(CELL_KEY)
    files = [*limits_files(loaded, truth), *([] if cell is None else files_of_cell(cell))]
    inputs += argument_files(loaded.source, files)
    verdict, broken = list(certificate.verdict_lines()), None
    if speed != 1.0:
        broken = certificates.broken_when_slowed(motion, loaded, truth, speed)
    if broken is not None:
        verdict.append(f"at --speed {speed:g} the {broken.describe()}")
    is_safe = certificate.ok and broken is None
    if not is_safe and not force:
        raise CheckFailed(f"{trajectory}: {'; '.join(verdict)}; design it again, or --force")
    # the exported file states the values that were computed now
    content = dataclasses.replace(
        motion,
        criteria=certificate.criteria,
        margins=[margin.document() for margin in certificate.margins],
        collision=certificate.collision,
        forced=not is_safe,
    )
    kinds = content.design.get("drive", inertial_parameters.DRIVE)
    standard = inertial_parameters.standard_parameters(loaded, truth, kinds)
    torque = nominal_torque(loaded, standard)
    sliding = [entry.name for entry in loaded.entries if entry.kind == "prismatic"]
    written = exporters.write(
        content,
        format,
        Path(path),
        speed=speed,
        rate=rate,
        tau=torque,
        goal=goal,
        sliding=sliding,
        inputs=inputs,
    )
    steps = next_steps(content, loaded, truth, str(trajectory), format, written, goal, speed)
    return ExportedFile(written, format, tuple(verdict), certificate, content.forced, tuple(steps))


__all__ = ["CertificateVerdict", "ExportedFile", "VerificationResult", "export", "verify"]
