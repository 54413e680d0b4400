"""The trajectory file `trajectory.json`: all that is needed to replay and to verify a motion.

The simulator has a reader of its own, `simulator/reference_trajectory.py`, for independence.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from .._types import FloatArray
from ..errors import UnusableInput
from ..robot import limits
from ..robot.limits import SHOWN_PATH, Limits
from ..robot.robot import Payload, Robot, inertias_of_document, load, locate
from ..schemas.document_file import DocumentFile
from ..schemas.quantities import shown
from ..schemas.trajectory import SCHEMA, TrajectoryDocument
from .fourier import FourierSeries
from .rest_to_rest import Motion, segments_from_document, segments_to_document


@dataclass(frozen=True)
class Trajectory:
    """Content of a trajectory file.

    Attributes:
        robot: Name, source and sha256 of the URDF; locked joints, payload and gravity.
        motion: Motion from rest to rest.
        rate: Rows per second of the exported table [Hz].
        limits: Limits that the motion keeps, and their sources.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        design: Options of the design (criterion, plain, uncertainty, boxes, samples, …).
        criteria: All criteria of the periodic part and of the exported motion.
        margins: Nearest margin to each limit, as certified when the file was written.
        collision: Sentence about the clearance, as certified when the file was written.
        seed: Seed of the random starts.
        forced: True if the file was written although its certificate failed.
        versions: Versions of the packages that computed the file.
    """

    robot: Mapping[str, Any]
    motion: Motion
    rate: float
    limits: Limits
    noise: FloatArray
    design: Mapping[str, Any]
    criteria: Mapping[str, Any]
    margins: list[dict[str, Any]]
    collision: str
    seed: int
    forced: bool = False
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.motion.joints

    def document(self) -> dict[str, Any]:
        """Return the content of the file; floats read back exactly."""
        f = self.motion.fourier
        return {
            "schema": SCHEMA,
            "robot": dict(self.robot),
            "joints": list(self.joints),
            "base_frequency": f.omega,
            "harmonics": f.harmonics,
            "period": f.period,
            "periods": self.motion.periods,
            "sine": f.sine.tolist(),
            "cosine": f.cosine.tolist(),
            "offset": f.offset.tolist(),
            "segments": segments_to_document(self.motion),
            "rate": self.rate,
            "limits": self.limits.document(),
            "torque_noise": dict(zip(self.joints, self.noise.tolist(), strict=True)),
            "criterion": self.design.get("criterion"),
            "design": dict(self.design),
            "criteria": dict(self.criteria),
            "margins": self.margins,
            "collision": self.collision,
            "forced": self.forced,
            "seed": self.seed,
            "versions": dict(self.versions) or package_versions(),
        }

    def load_robot(self, source: str | None = None) -> Robot:
        """Load the robot that the motion was designed for.

        Args:
            source: Path of the URDF, or name of a built-in model; None: as the file says.

        Raises:
            UnusableInput: The URDF is not the one of the design (its sha256 differs).
        """
        return load_designed_robot(self.robot, self.joints, source)


def load_designed_robot(
    stated: Mapping[str, Any],
    joints: Sequence[str],
    source: str | None = None,
    *,
    require_mass: bool = True,
) -> Robot:
    """Load the robot that a trajectory file states.

    Args:
        stated: The entry of the robot.
        joints: Names of its joints.
        source: Path of the URDF, or name of a built-in model; None: as the file says.
        require_mass: Whether every joint has to move a mass.

    Raises:
        UnusableInput: The URDF is missing, or not the one of the design (its sha256 differs).
    """
    payload, path = stated.get("payload"), source or str(stated["source"])
    if source is None and not os.path.isfile(locate(path)):
        raise UnusableInput(
            f"{shown(path, SHOWN_PATH)}: the robot of this trajectory is not there; say where it "
            "is with --robot URDF"
        )
    robot = load(
        path,
        joints=joints,
        lock={k: v for k, v in stated.get("locked", {}).items()},
        payload=None if payload is None else _payload(payload),
        gravity=stated.get("gravity", (0.0, 0.0, -9.81)),
        inertias=inertias_of_document(stated.get("inertias") or {}),
        require_mass=require_mass,
    )
    if robot.sha256 != stated["sha256"]:
        raise UnusableInput(
            f"{robot.source}: is not the URDF this trajectory was designed for "
            "(sha256 differs); give that one with --robot"
        )
    return robot


def _payload(stated: Mapping[str, Any]) -> Payload:
    """Return the payload that a trajectory file states."""
    x, y, z = (float(value) for value in stated["centre"])
    ixx, ixy, iyy, ixz, iyz, izz = (float(value) for value in stated["inertia"])
    return Payload(
        str(stated["link"]), float(stated["mass"]), (x, y, z), (ixx, ixy, iyy, ixz, iyz, izz)
    )


def package_versions() -> dict[str, str]:
    """Return the versions of excite and of the packages that compute its results."""
    return {"excite": __version__} | {
        name: metadata.version(name)
        for name in ("casadi", "daqp", "pin", "numpy", "scipy", "ruckig")
    }


def read_trajectory(path: Path) -> Trajectory:
    """Read a `trajectory.json`.

    Args:
        path: Path of the file.

    Returns:
        The validated content.

    Raises:
        UnusableInput: The file is missing, is of another schema, or breaks a rule of
            `schemas.trajectory`.
    """
    return parse_trajectory(read_document(path), path)


def read_document(path: Path) -> Any:
    """Read the JSON of a trajectory file of any schema, as plain values.

    Raises:
        UnusableInput: The file is missing, or is no JSON.
    """
    return _document_file(path).json()


def stated_schema(content: Any) -> str | None:
    """Return the schema that the content of a file states; None without one."""
    schema = content.get("schema") if isinstance(content, Mapping) else None
    return schema if isinstance(schema, str) else None


def parse_trajectory(content: Any, path: Path) -> Trajectory:
    """Validate the parsed JSON of a trajectory file.

    Args:
        content: Content of the file as plain values.
        path: Path of the file, for messages.

    Raises:
        UnusableInput: The content is of another schema, or breaks a rule of `schemas.trajectory`.
    """
    file = _document_file(path)
    file.schema(content, (SCHEMA,))
    return _from_document(file.converted(content, TrajectoryDocument), content)


def _document_file(path: Path) -> DocumentFile:
    """Return the adapter that words the errors of a trajectory file."""
    return DocumentFile(
        path, "a trajectory", "design it again", "the trajectory.json of 'excite design'"
    )


def _from_document(document: TrajectoryDocument, content: Mapping[str, Any]) -> Trajectory:
    """Build the trajectory of a validated document.

    Args:
        document: The validated document.
        content: The same as plain values, with keys that the schema does not know.
    """
    joints: tuple[str, ...] = tuple(document.joints)
    arrays = [np.array(rows, float) for rows in (document.sine, document.cosine, document.offset)]
    fourier = FourierSeries(arrays[0], arrays[1], arrays[2], float(document.period))
    motion = Motion(
        joints,
        fourier,
        document.periods,
        segments_from_document(document.segments, joints, fourier),
    )
    return Trajectory(
        robot=content["robot"],
        motion=motion,
        rate=float(document.rate),
        limits=limits.from_document(document.limits, joints),
        noise=np.array([document.torque_noise[joint] for joint in joints], float),
        design=content.get("design", {}),
        criteria=content["criteria"],
        margins=content["margins"],
        collision=str(document.collision),
        seed=document.seed,
        forced=document.forced,
        versions=content["versions"],
    )
