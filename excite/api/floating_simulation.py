"""Simulate recordings of a floating-base robot: wrench and torque by inverse dynamics, with noise.

The motion is that of a recording or table of base pose and joint positions, low-passed. The true
bodies deviate at random from the nominal ones and stay physically consistent. The wrench on the
base is distributed over the contacts with the smallest forces and moments.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from .. import _json
from .._system.one_or_several import one_or_several
from .._system.output_files import output_files
from .._types import FloatArray
from ..designer.floating_identifiability import RowNoise, assumed_noise
from ..errors import UnusableInput
from ..identification import floating_regression
from ..identification.lowpass import Grid, LowPassFilter
from ..recordings.floating_signals import COMPONENTS, POSE, WORLD
from ..robot import floating_base
from ..robot.floating_base import FloatingMotion, FloatingRobot, Rows
from ..robot.inertial_parameters import (
    DRIVE,
    Parameters,
    of_pseudo_inertia,
    proper_body,
    pseudo_inertia,
)
from ..robot.limits import Limits
from .floating_result import load_floating_robot, read_floating_recording
from .identification_result import RecordingSource
from .input_files import argument_files
from .robots import RobotSource

TRUTH_SCHEMA = "excite.floating_truth/1"
"""Schema of the true parameters of a simulated recording."""
MOTION_HZ = 20.0
"""Cutoff frequency of the motion that is simulated [Hz]."""
MAX_RATE_SHARE = 0.4
"""Cutoff frequency over the rate of the motion, at most."""
CONTACT_LEVER = 0.1
"""Lever by which moments and forces of contacts are weighed against each other [m]."""


@dataclass(frozen=True)
class SimulatedFloatingRecording:
    """A simulated recording with its true parameters.

    Attributes:
        columns: Names of its columns.
        table: Its rows. Shape (N, columns).
        truth: Content of the truth file.
        inputs: Files that it was computed from, which `save` does not replace.
    """

    columns: tuple[str, ...]
    table: FloatArray
    truth: Mapping[str, Any]
    inputs: tuple[Path, ...] = field(default=(), repr=False)

    def csv(self) -> str:
        """Return the recording as CSV."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerow(self.columns)
        np.savetxt(stream, self.table, fmt="%.9g", delimiter=",")
        return stream.getvalue()

    def contents(self, name: str) -> dict[str, str]:
        """Return the recording and its truth by file name.

        Args:
            name: File name of the recording.
        """
        return {name: self.csv(), f"{Path(name).stem}.truth.json": _json.dumps(dict(self.truth))}

    def save(self, path: str | Path) -> list[Path]:
        """Write the recording, and next to it `<name>.truth.json`; return their paths.

        Raises:
            UnusableInput: A file cannot be written, or is among `inputs`.
        """
        path = Path(path)
        contents = self.contents(path.name)
        siblings = [name for name in contents if name != path.name]
        return output_files(path, siblings, self.inputs).replace(contents)

    def __repr__(self) -> str:
        return f"<SimulatedFloatingRecording of {len(self.table)} rows>"


def simulate_floating(
    robot: RobotSource | FloatingRobot,
    motion: RecordingSource,
    *,
    contacts: str | Sequence[str] = (WORLD,),
    wrench_noise: tuple[float, float] | None = None,
    torque_noise: tuple[float, ...] | None = None,
    offset: Mapping[str, Sequence[float]] = MappingProxyType({}),
    model_error: float = 0.05,
    seed: int = 0,
    columns: Mapping[str, str] = MappingProxyType({}),
) -> SimulatedFloatingRecording:
    """Simulate a recording of a floating-base robot, as `excite simulate --floating` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        motion: Recording, or CSV file with the columns `t`, `base.x` … `base.qw`, `q.<joint>`.
        contacts: Frames of the contacts, or "world" for the total wrench about the world's origin;
            joint torques are recorded in the first case.
        wrench_noise: Standard deviations of forces and moments of each contact [N, N m]; None: 1 %
            of the weight, and that at 0.1 m.
        torque_noise: Standard deviation of the joint torques, one value or one per joint [N m];
            None: 1 % of the limit.
        offset: Constant offsets of the sensors, six numbers by contact [N, N m].
        model_error: Standard deviation of the true bodies from the nominal ones in the metric.
        seed: Random seed.
        columns: Standard names of columns -> differing names in the file.

    Raises:
        UnusableInput: An argument or a file cannot be used.
    """
    loaded, contacts = load_floating_robot(robot), one_or_several(contacts)
    for frame in contacts:
        floating_base.require_frame(loaded, frame, "--contact")
    if WORLD in contacts and len(contacts) > 1:
        raise UnusableInput("--contact world: is the sum of all contacts; name it alone")
    recording = read_floating_recording(motion, loaded, columns)
    rng = np.random.default_rng(seed)
    limits = floating_base.limits(loaded)
    parameters, true = drawn_parameters(loaded, limits, model_error, rng)
    if torque_noise is not None and len(torque_noise) == 1:
        torque_noise = torque_noise * loaded.n
    noise = assumed_noise(loaded, limits, wrench_noise, torque_noise)
    times, poses, joints, measured = [], [], [], []
    for segment in recording.segments():
        cutoff = min(MOTION_HZ, MAX_RATE_SHARE * segment.rate)
        band = LowPassFilter(cutoff, segment.rate, len(segment))
        part = floating_regression.filtered_motion(segment, loaded, band, Grid.RECORDED, 1.0)
        blocks = floating_base.regressor_blocks(loaded, parameters, part, Rows.BOTH)
        forces = np.concatenate([Y @ true for Y in blocks])
        times.append(segment.t)
        poses.append(part.pose)
        joints.append(part.q)
        measured.append(_measured(loaded, part, forces, contacts, noise, offset, rng))
    if not times:
        raise UnusableInput(f"{recording.source}: has no gap-free stretch that is long enough")
    wrench = [f"wrench.{frame}.{component}" for frame in contacts for component in COMPONENTS]
    torque = [] if WORLD in contacts else [f"tau.{joint}" for joint in loaded.joints]
    names = ("t", *POSE, *(f"q.{joint}" for joint in loaded.joints), *wrench, *torque)
    table = np.column_stack([np.concatenate(x) for x in (times, poses, joints, measured)])
    truth = truth_document(
        loaded, recording.source, contacts, seed, model_error, parameters, true, noise
    )
    truth["offsets"] = {frame: list(map(float, values)) for frame, values in offset.items()}
    inputs = argument_files(loaded.joint_robot.source, recordings=[motion])
    return SimulatedFloatingRecording(names, table, truth, inputs)


def drawn_parameters(
    robot: FloatingRobot, limits: Limits, model_error: float, rng: np.random.Generator
) -> tuple[Parameters, FloatArray]:
    """Draw true bodies near the nominal ones; joint parameters keep their nominal values.

    Args:
        robot: The robot.
        limits: Limits of its joints.
        model_error: Standard deviation of the true bodies from the nominal ones in the metric.
        rng: Source of randomness.

    Returns:
        The standard parameters, and their true values. Shape (P,).
    """
    parameters = floating_base.standard_parameters(robot, limits, DRIVE)
    true = parameters.nominal.copy()
    for i in range(0, 10 * parameters.bodies, 10):
        body = proper_body(true[i : i + 10], robot.mass)[0]
        true[i : i + 10] = random_body(body, model_error, rng)
    return parameters, true


def truth_document(
    robot: FloatingRobot,
    motion: str,
    contacts: Sequence[str],
    seed: int,
    model_error: float,
    parameters: Parameters,
    true: FloatArray,
    noise: RowNoise,
) -> dict[str, Any]:
    """Return the content of the truth file.

    Args:
        robot: The robot.
        motion: Path of the motion.
        contacts: Frames of the measured wrenches.
        seed: Random seed.
        model_error: Standard deviation of the true bodies from the nominal ones.
        parameters: Standard parameters.
        true: Their true values. Shape (P,).
        noise: Noise of wrenches and torques.
    """
    return {
        "schema": TRUTH_SCHEMA,
        "robot": {
            "name": robot.name,
            "source": robot.source,
            "sha256": robot.joint_robot.sha256,
        },
        "motion": motion,
        "contacts": list(contacts),
        "seed": seed,
        "model_error": model_error,
        "parameters": dict(zip(parameters.names, true.tolist(), strict=True)),
        "noise": {
            "force": noise.force,
            "moment": noise.moment,
            "torque": dict(zip(robot.joints, noise.torque.tolist(), strict=True)),
        },
    }


def random_body(phi: FloatArray, deviation: float, rng: np.random.Generator) -> FloatArray:
    """Return a physically consistent body at a random distance from another.

    P = C exp(E) Cᵀ with P₀ = C Cᵀ and E a symmetric matrix whose ten coordinates in the metric are
    normally distributed.

    Args:
        phi: Inertial parameters. Shape (10,).
        deviation: Standard deviation of each coordinate.
        rng: Source of randomness.
    """
    from scipy.linalg import expm  # slow to import

    factor = np.linalg.cholesky(pseudo_inertia(phi))
    entries = deviation * rng.normal(size=(4, 4))
    symmetric = np.tril(entries, -1) + np.tril(entries, -1).T + np.diag(np.diag(entries)) * 2**0.5
    return of_pseudo_inertia(factor @ expm(symmetric) @ factor.T)


def _measured(
    robot: FloatingRobot,
    motion: FloatingMotion,
    forces: FloatArray,
    contacts: Sequence[str],
    noise: RowNoise,
    offset: Mapping[str, Sequence[float]],
    rng: np.random.Generator,
) -> FloatArray:
    """Noisy wrenches of the contacts and torques of the joints. Shape (N, 6 contacts [+ n])."""
    rows = Rows.BASE if WORLD in contacts else Rows.BOTH
    maps = floating_regression.contact_maps(robot, motion, contacts, rows)
    total = floating_regression.in_world_axes(forces[:, :6], motion.pose)
    lever = np.tile([1.0, 1.0, 1.0, CONTACT_LEVER, CONTACT_LEVER, CONTACT_LEVER], len(contacts))
    inverse = lever[:, None] * np.linalg.pinv(maps[:, :6] * lever)
    wrenches = np.einsum("tkr,tr->tk", inverse, total)
    deviations = np.tile([noise.force] * 3 + [noise.moment] * 3, len(contacts))
    constant = np.concatenate([np.asarray(offset.get(frame, np.zeros(6))) for frame in contacts])
    out = [wrenches + constant + deviations * rng.normal(size=wrenches.shape)]
    if rows.has_joints:
        torque = forces[:, 6:] - np.einsum("trk,tk->tr", maps[:, 6:], wrenches)
        out.append(torque + noise.torque * rng.normal(size=torque.shape))
    return np.hstack(out)
