"""The `trajectory.json` of a design in support: all that is needed to replay and to verify it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..collision.workcell import NOT_CHECKED
from ..robot import floating_base, limits
from ..robot.floating_base import FloatingRobot, Rows
from ..robot.inertial_parameters import DRIVE
from ..robot.limits import Limits
from ..schemas.document_file import DocumentFile
from ..schemas.support_trajectory import SCHEMA, SupportTrajectoryDocument
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import JerkProfile, PhaseProfile
from ..trajectory.trajectory_file import load_designed_robot, package_versions
from . import support_cell, support_certificate
from .certificate import CELL_KEY, CRITERION_TOLERANCE, Certificate, limit_faults
from .floating_identifiability import RowNoise, added_root
from .identifiability import identifiable_count
from .identifiability_threshold import IDENTIFIABLE_VARIANCE
from .support_cell import BASE_NAMES
from .support_certificate import SupportConstraints
from .support_kinematics import exported_motion
from .support_problem import profile_duration
from .support_stance import ContactLimits, Foot, Stance, leg_of

GROUND_TOLERANCE = 1e-9
"""Largest height of a sole over the ground [m]: rounding."""


@dataclass(frozen=True)
class StatedFoot:
    """A foot on the ground, as the file states it.

    Attributes:
        frame: Name of its contact frame.
        joints: Names of the joints between the base link and the foot.
        half_length: Half of the length of the sole along x [m].
        half_width: Half of its width along y [m].
        centre: Centre of the sole in the world [m].
        sole_centre: Centre of the sole in the contact frame [m].
        sole_source: Where the size of the sole comes from.
        outline: Corners of the sole's outline about its centre; none: the rectangle [m].
    """

    frame: str
    joints: tuple[str, ...]
    half_length: float
    half_width: float
    centre: tuple[float, float, float]
    sole_centre: tuple[float, float, float]
    sole_source: str = ""
    outline: tuple[tuple[float, float], ...] = ()

    def document(self) -> dict[str, Any]:
        """Return the entry of the file."""
        return {
            "frame": self.frame,
            "joints": list(self.joints),
            "half_length": self.half_length,
            "half_width": self.half_width,
            "centre": list(self.centre),
            "sole_centre": list(self.sole_centre),
            "sole_source": self.sole_source,
            "outline": [list(corner) for corner in self.outline],
        }


@dataclass(frozen=True)
class SupportTrajectory:
    """Content of the trajectory file of a design in support.

    Attributes:
        robot: Name, source and sha256 of the URDF; locked joints, payload and gravity.
        joints: Names of the joints.
        feet: The feet on the ground.
        contact: Limits of their contact.
        base: Base coordinates of the standing pose. Shape (6,) [m and rad].
        pose: Joint positions of the standing pose. Shape (n,) [rad or m].
        motions: Motions of the independent coordinates, played one after the other.
        rate: Rows per second of the exported table [Hz].
        limits: Limits that the motions keep, with their sources and the shares kept free.
        noise: Noise of the rows.
        criterion: Criterion of the design, a or d.
        identifiable: Identifiable directions of the base rows after each motion.
        base_parameters: Number of base parameters of the base rows.
        design: Options of the design (margin, cell, …).
        margins: Nearest margin to each limit, as certified when the file was written.
        collision: Sentence about the clearance, as certified when the file was written.
        seed: Seed of the random starts.
        versions: Versions of the packages that computed the file.
    """

    robot: Mapping[str, Any]
    joints: tuple[str, ...]
    feet: tuple[StatedFoot, ...]
    contact: ContactLimits
    base: FloatArray
    pose: FloatArray
    motions: tuple[PhaseProfile, ...]
    rate: float
    limits: Limits
    noise: RowNoise
    criterion: str
    identifiable: tuple[int, ...]
    base_parameters: int
    design: Mapping[str, Any]
    margins: list[dict[str, Any]]
    collision: str
    seed: int
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Duration of each motion [s]."""
        return profile_duration(self.motions[0])

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the independent coordinates: all but those of the support legs' joints."""
        legs = {joint for foot in self.feet for joint in foot.joints}
        return (*BASE_NAMES, *(joint for joint in self.joints if joint not in legs))

    def document(self) -> dict[str, Any]:
        """Return the content of the file; floats read back exactly."""
        first = self.motions[0].fourier
        return {
            "schema": SCHEMA,
            "robot": dict(self.robot),
            "joints": list(self.joints),
            "support": [foot.document() for foot in self.feet],
            "contact": {
                "friction": self.contact.friction,
                "cop_margin": self.contact.margin,
                "least_share": self.contact.least_share,
            },
            "standing": {
                "base": dict(zip(BASE_NAMES, self.base.tolist(), strict=True)),
                "joints": dict(zip(self.joints, self.pose.tolist(), strict=True)),
            },
            "coordinates": list(self.coordinates),
            "base_frequency": first.omega,
            "harmonics": first.harmonics,
            "period": first.period,
            "duration": self.duration,
            "phase": [list(piece) for piece in self.motions[0].phase.pieces[0]],
            "motions": [
                {
                    "sine": motion.fourier.sine.tolist(),
                    "cosine": motion.fourier.cosine.tolist(),
                    "offset": motion.fourier.offset.tolist(),
                }
                for motion in self.motions
            ],
            "rate": self.rate,
            "limits": self.limits.document(),
            "wrench_noise": {"force": self.noise.force, "moment": self.noise.moment},
            "torque_noise": dict(zip(self.joints, self.noise.torque.tolist(), strict=True)),
            "criterion": self.criterion,
            "identifiable": list(self.identifiable),
            "base_parameters": self.base_parameters,
            "design": dict(self.design),
            "margins": self.margins,
            "collision": self.collision,
            "seed": self.seed,
            "versions": dict(self.versions) or package_versions(),
        }

    def load_robot(self, source: str | None = None) -> FloatingRobot:
        """Load the robot that the motions were designed for.

        Args:
            source: Path of the URDF, or name of a built-in model; None: as the file says.

        Raises:
            UnusableInput: The URDF is not the one of the design (its sha256 differs).
        """
        fixed = load_designed_robot(self.robot, self.joints, source, require_mass=False)
        return floating_base.load(fixed)

    def stance(self, robot: FloatingRobot) -> Stance:
        """Return the feet and the standing pose.

        Args:
            robot: The robot of the file.

        Raises:
            UnusableInput: A foot is not at the end of a leg of six joints of this robot.
        """
        fixed = robot.joint_robot
        feet = tuple(
            Foot(
                foot.frame,
                leg_of(fixed, foot.frame),
                fixed.model.frames[fixed.frame(foot.frame)].placement
                * pin.SE3(np.eye(3), np.array(foot.sole_centre)),
                pin.SE3(np.eye(3), np.array(foot.centre)),
                foot.half_length,
                foot.half_width,
            )
            for foot in self.feet
        )
        return Stance(feet, self.contact, fixed.weight, self.base, self.pose)


def parse_support_trajectory(content: Any, path: Path) -> SupportTrajectory:
    """Validate the parsed JSON of the trajectory file of a design in support.

    Args:
        content: Content of the file as plain values.
        path: Path of the file, for messages.

    Raises:
        UnusableInput: The content is of another schema, or breaks a rule of
            `schemas.support_trajectory`.
    """
    file = _document_file(path)
    file.schema(content, (SCHEMA,))
    document = file.converted(content, SupportTrajectoryDocument)
    joints: tuple[str, ...] = tuple(document.joints)
    missing = [name for name in BASE_NAMES if name not in document.standing.base]
    if missing:
        raise file.error(f"has no entry '{missing[0]}'", "standing.base")
    pieces = tuple((float(duration), float(jerk)) for duration, jerk in document.phase)
    phase = JerkProfile(np.zeros(1), np.zeros(1), np.zeros(1), (pieces,))
    out = SupportTrajectory(
        robot=content["robot"],
        joints=joints,
        feet=tuple(
            StatedFoot(
                str(foot.frame),
                tuple(map(str, foot.joints)),
                float(foot.half_length),
                float(foot.half_width),
                foot.centre,
                foot.sole_centre,
                str(foot.sole_source),
                tuple(foot.outline),
            )
            for foot in document.support
        ),
        contact=ContactLimits(
            float(document.contact.friction),
            float(document.contact.cop_margin),
            float(document.contact.least_share),
        ),
        base=np.array([document.standing.base[name] for name in BASE_NAMES], float),
        pose=np.array([document.standing.joints[joint] for joint in joints], float),
        motions=tuple(
            PhaseProfile(
                FourierSeries(
                    np.array(motion.sine, float),
                    np.array(motion.cosine, float),
                    np.array(motion.offset, float),
                    float(document.period),
                ),
                phase,
            )
            for motion in document.motions
        ),
        rate=float(document.rate),
        limits=replace(
            limits.from_document(document.limits, joints),
            margin={kind: float(share) for kind, share in document.design.margin.items()},
        ),
        noise=RowNoise(
            float(document.wrench_noise.force),
            float(document.wrench_noise.moment),
            np.array([document.torque_noise[joint] for joint in joints], float),
        ),
        criterion=document.criterion,
        identifiable=tuple(document.identifiable),
        base_parameters=document.base_parameters,
        design=content["design"],
        margins=content["margins"],
        collision=str(document.collision),
        seed=document.seed,
        versions=content["versions"],
    )
    if list(out.coordinates) != list(document.coordinates):
        raise file.error("are not the base coordinates and the free joints", "coordinates")
    return out


def _document_file(path: Path) -> DocumentFile:
    """Return the adapter that words the errors of a trajectory file."""
    return DocumentFile(
        path,
        "a trajectory",
        "design it again",
        "the trajectory.json of 'excite design --floating --support'",
    )


def verify(
    trajectory: SupportTrajectory,
    robot: FloatingRobot,
    truth: Limits,
    packages: Sequence[str] = (),
) -> Certificate:
    """Verify motions in support: contact, limits, distances, rest and identifiable directions.

    Args:
        trajectory: The file's content.
        robot: The robot of its URDF.
        truth: Limits from their sources; those of the file are compared with them.
        packages: Further folders of `package://` meshes.

    Returns:
        The certificate; nothing is raised for motions that fail.

    Raises:
        UnusableInput: The feet are not at the ends of legs of this robot.
    """
    stance = trajectory.stance(robot)
    parameters = floating_base.standard_parameters(robot, truth, DRIVE)
    constraints = SupportConstraints(
        robot,
        replace(truth, margin=trajectory.limits.margin),
        stance,
        parameters,
        unchecked_reason=f"{NOT_CHECKED}: the file states no shapes to keep clear of",
    )
    if CELL_KEY in trajectory.design:
        cell, fault = support_cell.rebuild_cell(
            robot, truth, stance, trajectory.design[CELL_KEY], packages
        )
        constraints = replace(constraints, cell=cell, cell_fault=fault)
    certificate = support_certificate.certify(constraints, trajectory.motions)
    counts, base_count, faults = _identifiable(trajectory, constraints)
    return replace(
        certificate,
        criteria={"identifiable": counts, "base_parameters": base_count},
        faults=(
            *limit_faults(trajectory.limits, truth),
            *_foot_faults(trajectory, robot, stance),
            *certificate.faults,
            *faults,
        ),
    )


def _foot_faults(
    trajectory: SupportTrajectory, robot: FloatingRobot, stance: Stance
) -> Iterator[str]:
    """Yield a sentence for each foot that is not on the ground, or has other joints."""
    for stated, foot in zip(trajectory.feet, stance.feet, strict=True):
        if abs(stated.centre[2]) > GROUND_TOLERANCE:
            yield f"the sole of {stated.frame} is {stated.centre[2]:.2g} m over the ground"
        joints = tuple(robot.joints[joint] for joint in foot.joints)
        if joints != stated.joints:
            yield f"the leg of {stated.frame} has the joints {', '.join(joints)} in the URDF"
        if min(foot.half_length, foot.half_width) <= trajectory.contact.margin:
            yield f"the sole of {stated.frame} leaves no room for the margin of the pressure"


def _identifiable(
    trajectory: SupportTrajectory, constraints: SupportConstraints
) -> tuple[list[int], int, list[str]]:
    """Recompute the identifiable directions after each motion.

    Returns:
        Their numbers, that of the base parameters, and sentences about numbers of the file that
        differ by more than rounding.
    """
    robot, stance = constraints.robot, constraints.stance
    inertial = floating_base.standard_parameters(robot, constraints.limits)
    base = floating_base.find_base_parameters(robot, inertial, Rows.BASE)
    root, roots = np.zeros((0, inertial.count)), []
    for profile in trajectory.motions:
        motion = exported_motion(robot, stance, constraints.parameters, profile, trajectory.rate)
        root = added_root(root, robot, inertial, motion, trajectory.noise, Rows.BASE)
        roots.append(root)
    counts, fewest, most = (
        [identifiable_count(root, base, factor * IDENTIFIABLE_VARIANCE) for root in roots]
        for factor in (1.0, 1.0 - CRITERION_TOLERANCE, 1.0 + CRITERION_TOLERANCE)
    )
    faults = [
        f"{count} directions are identifiable after motion {number}, the file says {stated}"
        for number, (count, low, high, stated) in enumerate(
            zip(counts, fewest, most, trajectory.identifiable, strict=True), start=1
        )
        if not low <= stated <= high
    ]
    if base.count != trajectory.base_parameters:
        faults.append(
            f"the base rows have {base.count} base parameters, the file says "
            f"{trajectory.base_parameters}"
        )
    return counts, base.count, faults
