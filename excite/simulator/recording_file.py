"""The files of a simulated recording: CSV, sidecar and ground truth."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import Any

import numpy as np

from .._types import FloatArray
from .measurement import MeasurementChain
from .reference_trajectory import ReferenceTrajectory
from .simulated_robot import SimulatedMotion, SimulatedRobot
from .urdf_tree import INERTIA_INDICES, UrdfTree

SETTLING_TIME = 0.5
"""Begin of the first period that the stated periodic window leaves out [s].

The loop settles in it; at most a tenth of the period is left out.
"""


@dataclass(frozen=True)
class MeasuredSignals:
    """The measured signals of a motion.

    Attributes:
        joints: Names of the n joints.
        t: Time stamps, shape (N,) [s].
        q: Measured positions, shape (N, n) [rad].
        tau: Measured torques, shape (N, n) [N m].
        qref: Commanded positions, shape (N, n) [rad].
        period: Period of the excitation [s].
        periodic: Begin and end of the window in which the motion repeats; equal where it does not
            [s].
    """

    joints: tuple[str, ...]
    t: FloatArray
    q: FloatArray
    tau: FloatArray
    qref: FloatArray
    period: float
    periodic: tuple[float, float]

    def to_csv(self) -> str:
        """Return the rows of `<name>.csv`; every number has the same width."""
        stream = io.StringIO()
        names = [f"{kind}.{joint}" for kind in ("q", "tau", "qref") for joint in self.joints]
        csv.writer(stream, lineterminator="\n").writerow(["t", *names])
        row = "%012.6f" + ",%+.9e" * (3 * len(self.joints)) + "\n"
        table = np.hstack([self.t[:, None], self.q, self.tau, self.qref])
        return stream.getvalue() + "".join(row % tuple(values) for values in table.tolist())

    def to_sidecar(self) -> dict[str, Any]:
        """Return the sidecar, an `excite.recording/1`."""
        begin, end = self.periodic
        repeats = {"period": self.period, "periodic": [begin, end]} if end > begin else {}
        return {
            "schema": "excite.recording/1",
            **repeats,
            "motor_side": True,
            "notes": "simulated by 'excite simulate'",
        }


def measure(
    motion: SimulatedMotion,
    reference: ReferenceTrajectory,
    chain: MeasurementChain,
    rng: np.random.Generator,
) -> MeasuredSignals:
    """Measure a motion.

    Args:
        motion: The simulated motion.
        reference: The trajectory that it follows.
        chain: The measurement chain.
        rng: Generator of the noise; the same state gives the same noise for any hidden effect.
    """
    t = chain.clock_times(reference.duration)
    clock, noise = rng.spawn(2)
    q, tau = motion.measured(chain.sampling_times(t, clock))
    begin, end = reference.periodic
    begin = min(begin + min(SETTLING_TIME, 0.1 * reference.period), end)
    return MeasuredSignals(
        reference.joints,
        t,
        chain.quantise_positions(q),
        chain.measure_torques(tau, noise),
        reference.at(t)[0],
        reference.period,
        (begin, end),
    )


def truth_document(
    robot: SimulatedRobot, chain: MeasurementChain, facts: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the ground truth, an `excite.truth/1`, in the units of the contract.

    Args:
        robot: The simulated robot.
        chain: Its measurement chain.
        facts: Further keys (effects, seed, …), which come first.
    """
    drive = {
        key: dict(zip(robot.joints, values.tolist(), strict=True))
        for key, values in asdict(robot.actuators).items()
    }
    document: dict[str, Any] = {
        "schema": "excite.truth/1",
        **facts,
        "joints": list(robot.joints),
        "drive": drive,
        "bodies": {link: inertial_vector(robot.tree, link) for link in robot.tree.links},
        "control": asdict(robot.gains),
        "chain": {
            k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(chain).items()
        },
        "versions": {name: metadata.version(name) for name in ("mujoco", "numpy", "scipy")},
    }
    return document


def inertial_vector(tree: UrdfTree, link: str) -> list[float]:
    """Return [m, m·cx, m·cy, m·cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] of a link in its own frame."""
    pseudo_inertia = tree.pseudo_inertia(link)
    tensor = np.trace(pseudo_inertia[:3, :3]) * np.eye(3) - pseudo_inertia[:3, :3]
    order = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
    return [
        float(v)
        for v in (
            pseudo_inertia[3, 3],
            *pseudo_inertia[:3, 3],
            *(tensor[INERTIA_INDICES[key]] for key in order),
        )
    ]


def json_text(document: Mapping[str, Any]) -> str:
    """Return strict JSON with the keys in the order given."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)
