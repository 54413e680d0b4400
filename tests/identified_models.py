"""Files `model.json` of robots with known parameters, with and without effects."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from synthetic_recordings import perturbed_parameters

from excite._types import FloatArray
from excite.identification.identified_model import IdentifiedModel, read_model
from excite.identification.urdf_export import identified_urdf
from excite.robot import inertial_parameters, limits, robot
from excite.robot.limits import Limits
from excite.robot.samples import Samples

WIDTH = 0.005
"""Width of Coulomb friction [rad/s or m/s]."""


def known_limits(machine: robot.Robot, assumed: tuple[float, float] | None) -> Limits:
    """Limits of a robot, with assumed velocity and torque limits where it states none."""
    if assumed is None:
        return limits.resolve(machine)
    stated = [
        {
            "position": entry.position or (-1.0, 1.0),
            "velocity": entry.velocity or assumed[0],
            "torque": entry.torque or assumed[1],
        }
        for entry in machine.entries
    ]
    values = {key: np.array([row[key] for row in stated], float) for key in stated[0]}
    none = np.full(machine.n, np.inf)
    return Limits(
        joints=machine.joints,
        position=values["position"],
        velocity=values["velocity"],
        acceleration=none,
        jerk=none,
        torque=values["torque"],
        braking=(None,) * machine.n,
        sources={},
    )


def write_model(
    folder: Path,
    name: str,
    effects: tuple[dict[str, Any], ...] = (),
    seed: int = 0,
    joints: Sequence[str] | None = None,
    assumed: tuple[float, float] | None = None,
) -> Path:
    """Write the `model.json` of a robot with random, physically consistent parameters."""
    machine = robot.load(name, joints=joints)
    table = known_limits(machine, assumed)
    standard = inertial_parameters.standard_parameters(machine, table)
    psi = perturbed_parameters(standard, np.random.default_rng(seed))
    widths = np.full(machine.n, WIDTH)
    document = {
        "schema": "excite.model/1",
        "robot": {
            "name": name,
            "source": name,
            "sha256": machine.sha256,
            "gravity": list(machine.model.gravity.linear),
        },
        "urdf": identified_urdf(machine, standard, psi, widths, ["an identified robot"]),
        "joints": list(machine.joints),
        "links": list(standard.links),
        "drive": list(standard.drive),
        "standard_parameters": [
            {"name": parameter, "of": owner, "value": float(value), "std": 0.1, "unit": "1"}
            for parameter, owner, value in zip(standard.names, standard.owners(), psi, strict=True)
        ],
        "coulomb_width": dict.fromkeys(machine.joints, WIDTH),
        "band_hz": 20.0,
        "recordings": ["monday.csv"],
        "effects": list(effects),
    }
    path = folder / "model.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def random_states(
    model: IdentifiedModel, count: int, seed: int = 1, assumed: tuple[float, float] | None = None
) -> Samples:
    """Return random states within the limits of a robot, accelerations within ±10 rad/s²."""
    table = known_limits(model.robot, assumed)
    rng = np.random.default_rng(seed)
    low, high = inertial_parameters.ranges(table).T
    inset = 0.02 * (high - low)
    size = (count, model.robot.n)
    q = rng.uniform(low + inset, high - inset, size)
    dq = rng.uniform(-1.0, 1.0, size) * table.velocity
    return Samples(q, dq, rng.uniform(-10.0, 10.0, size))


def model_torque(model: IdentifiedModel, motion: Samples, coulomb: bool = True) -> FloatArray:
    """Return the torque of an identified model, without Coulomb friction if so stated."""
    torque = model.torque(motion, motion.dq)
    if coulomb:
        return torque
    friction = model.psi[model.layout.block("coulomb")]
    return np.asarray(torque - friction * np.tanh(motion.dq / model.widths))


__all__ = ["WIDTH", "model_torque", "random_states", "read_model", "write_model"]
