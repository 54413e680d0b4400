"""`trajectory.json`: a designed motion with all that is needed to replay and to check it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from .._system.text import displayable
from ..errors import UnusableInput
from ..robot import limits
from ..robot.limits import Limits
from ..robot.robot import Payload, Robot, load
from ..schemas.document_file import DocumentFile
from ..schemas.trajectory import SCHEMA, TrajectoryDocument
from .fourier import Fourier
from .rest_to_rest import Motion, read_segments, segment_document

Array = np.ndarray


@dataclass(frozen=True)
class Trajectory:
    """What `trajectory.json` says. Fields carry the names of its keys where these are one word.

    robot: name, source, sha256, and how it was loaded (locked, payload, gravity).
    noise: torque standard deviation per joint. Shape (n,) [N m].
    design: the options of the design (criterion, plain, parameters, uncertainty, boxes, samples …).
    criteria, margins, collision: as certified when the file was written.
    """

    robot: Mapping[str, Any]
    motion: Motion
    rate: float
    limits: Limits
    noise: Array
    design: Mapping[str, Any]
    criteria: Mapping[str, Any]
    margins: list[dict[str, Any]]
    collision: str
    seed: int
    forced: bool = False
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[str, ...]:
        return self.motion.joints

    def document(self) -> dict[str, Any]:
        """The file's content; floats are written so that they read back exactly."""
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
            "segments": segment_document(self.motion),
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
            "versions": dict(self.versions) or versions(),
        }

    def load_robot(self, source: str | None = None) -> Robot:
        """The robot the motion was designed for; `source` overrides where its URDF is looked for.

        Raises UnusableInput when the URDF's sha256 differs from the file's.
        """
        stated = self.robot
        payload = stated.get("payload")
        robot = load(
            source or str(stated["source"]),
            joints=self.joints,
            lock={k: v for k, v in stated.get("locked", {}).items()},
            payload=None if payload is None else _payload(payload),
            gravity=stated.get("gravity", (0.0, 0.0, -9.81)),
        )
        if robot.sha256 != stated["sha256"]:
            raise UnusableInput(
                f"{robot.source}: is not the URDF this trajectory was designed for (sha256 differs); give that one with --robot"
            )
        return robot


def _payload(stated: Mapping[str, Any]) -> Payload:
    numbers = [tuple(float(v) for v in stated[key]) for key in ("centre", "inertia")]
    return Payload(str(stated["link"]), float(stated["mass"]), numbers[0], numbers[1])  # type: ignore[arg-type]


def versions() -> dict[str, str]:
    """Versions of what computed a file."""
    return {"excite": __version__} | {
        name: metadata.version(name) for name in ("casadi", "pin", "numpy", "scipy", "ruckig")
    }


def plain(value: Any) -> Any:
    """A value as strict JSON holds it: arrays as lists, what is not finite as null, text without lone surrogates."""
    if isinstance(value, str):  # names of files may have bytes that are not UTF-8
        return displayable(value)
    if isinstance(value, Mapping):
        return {plain(str(k)): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def dumps(document: Any) -> str:
    """Strict JSON, keys in the order given, numbers that read back exactly."""
    return json.dumps(plain(document), indent=1, allow_nan=False, ensure_ascii=False)


def read(path: Path) -> Trajectory:
    """Read `trajectory.json`.

    Raises:
        UnusableInput: The file is missing, is of another schema, or breaks a rule of
            `schemas.trajectory`.
    """
    return parse(_document_file(path).json(), path)


def parse(content: Any, path: Path) -> Trajectory:
    """The trajectory of the plain values of a `trajectory.json`; raises as `read` does.

    path: of the file, for messages.
    """
    file = _document_file(path)
    file.schema(content, (SCHEMA,))
    return _from_document(file.converted(content, TrajectoryDocument), content)


def _document_file(path: Path) -> DocumentFile:
    return DocumentFile(
        path, "a trajectory", "design it again", "the trajectory.json of 'excite design'"
    )


def _from_document(document: TrajectoryDocument, content: Mapping[str, Any]) -> Trajectory:
    """The trajectory of a validated document.

    content: the same as plain values, with keys that the schema does not know.
    """
    joints: tuple[str, ...] = tuple(document.joints)
    arrays = [np.array(rows, float) for rows in (document.sine, document.cosine, document.offset)]
    fourier = Fourier(arrays[0], arrays[1], arrays[2], float(document.period))
    motion = Motion(joints, fourier, document.periods, read_segments(document.segments, joints))
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
