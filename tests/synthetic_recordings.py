"""Recordings of robots with known parameters, by Pinocchio's inverse dynamics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from conftest import loaded

from excite._types import FloatArray
from excite.identification import consistency
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording, Sidecar
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.inertial_parameters import Parameters
from excite.robot.limits import Limits
from excite.schemas.document_file import DocumentFile
from excite.schemas.effects import EffectDocument
from excite.trajectory.fourier import FourierSeries

if TYPE_CHECKING:  # MuJoCo is an optional extra
    from excite.simulator.simulated_robot import SimulatedRobot

PERIOD = 5.2
"""Period of the excitation [s]."""
RATE = 500.0
"""Sampling rate [Hz]."""
FRICTION_WIDTH = 0.004
"""Speed over which Coulomb friction changes sign [rad/s]."""


def two_link_model() -> IdentificationModel:
    """Return the model of the built-in two-link robot with all parameters."""
    machine = robot.load("two_link")
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    return IdentificationModel(
        machine,
        standard,
        base_parameters.find(machine, standard, table),
        np.full(machine.n, FRICTION_WIDTH),
    )


def perturbed_parameters(
    standard: Parameters, rng: np.random.Generator, size: float = 0.1
) -> FloatArray:
    """Return physically consistent parameters near the nominal ones, with friction."""
    psi = consistency.consistent_nominal(standard)
    edge = 10 * standard.bodies
    psi[:edge] += size * standard.scale[:edge, :edge] @ rng.normal(size=edge)
    for kind, value in (
        ("rotor_inertia", 0.3),
        ("viscous", 0.8),
        ("coulomb", 1.5),
        ("offset", 0.2),
    ):
        psi[standard.block(kind)] = value * rng.uniform(0.5, 1.5, len(standard.joints))
    assert consistency.is_consistent(standard, psi)
    return psi


def true_parameters(simulated: SimulatedRobot, standard: Parameters, table: Limits) -> FloatArray:
    """Return ψ of a simulated robot: its bodies and actuators."""
    psi = inertial_parameters.standard_parameters(loaded(simulated.tree.xml), table).nominal.copy()
    for kind, name in (
        ("rotor_inertia", "inertia"),
        ("viscous", "viscous"),
        ("coulomb", "coulomb"),
        ("offset", "offset"),
    ):
        psi[standard.block(kind)] = getattr(simulated.actuators, name)
    return psi


def pinocchio_model(model: IdentificationModel, psi: FloatArray) -> pin.Model:
    """Return Pinocchio's model with the bodies of ψ."""
    copy = model.robot.model.copy()
    for i in range(model.parameters.bodies):
        copy.inertias[i + 1] = pin.Inertia.FromDynamicParameters(psi[10 * i : 10 * i + 10])
    return copy


def rnea_torque(
    model: IdentificationModel, psi: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> FloatArray:
    """Return the inverse dynamics with parameters ψ, by Pinocchio's rnea and not by a regressor."""
    standard, rigid_model = model.parameters, pinocchio_model(model, psi)
    data = rigid_model.createData()
    rigid = np.array(
        [pin.rnea(rigid_model, data, *state) for state in zip(q, dq, ddq, strict=True)]
    )
    drive = {kind: psi[standard.block(kind)] for kind in standard.drive}
    return (
        rigid
        + drive["rotor_inertia"] * ddq
        + drive["viscous"] * dq
        + drive["coulomb"] * np.tanh(dq / FRICTION_WIDTH)
        + drive["offset"]
    )


def rest_to_rest(phase: FloatArray) -> FloatArray:
    """Return a smooth way from 0 to 1 over the phase, at rest at both ends."""
    return np.asarray(phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2))


def random_fourier(n: int, seed: int = 0, period: float = PERIOD) -> FourierSeries:
    """Return a random Fourier series of n joints."""
    rng = np.random.default_rng(seed)
    return FourierSeries(
        rng.normal(0.0, 0.7, (n, 4)), rng.normal(0.0, 0.7, (n, 4)), np.zeros(n), period
    )


def synthetic_recording(
    model: IdentificationModel,
    psi: FloatArray,
    fourier: FourierSeries,
    periods: float,
    noise: float,
    rate: float = RATE,
    **side: object,
) -> Recording:
    """Return a recording along a Fourier series, with white torque noise."""
    t = np.arange(round(periods * fourier.period * rate) + 1) / rate
    s = fourier.samples(t)
    exact = rnea_torque(model, psi, s.q, s.dq, s.ddq)
    rng = np.random.default_rng(1)
    fields = {"period": fourier.period, "periodic": (0.0, float(t[-1]))} | side
    sidecar = Sidecar(**fields)  # type: ignore[arg-type]
    return Recording(
        "synthetic.csv",
        model.robot.joints,
        t,
        s.q,
        tau=exact + noise * rng.normal(size=exact.shape),
        sidecar=sidecar,
        row_times=t,
    )


def write_recording(recording: Recording, path: Path, decimals: int = 9) -> Path:
    """Write a recording as the contract's CSV and its sidecar."""
    names = [f"{kind}.{joint}" for kind in ("q", "tau") for joint in recording.joints]
    table = np.hstack([recording.t[:, None], recording.q, recording.torque])
    np.savetxt(
        path,
        table,
        fmt=f"%.{decimals}g",
        delimiter=",",
        header=",".join(["t", *names]),
        comments="",
    )
    side = recording.sidecar
    if side.period is not None and side.periodic is not None:
        stated = {
            "schema": "excite.recording/1",
            "period": side.period,
            "periodic": list(side.periodic),
        }
        path.with_suffix(".json").write_text(json.dumps(stated), encoding="utf-8")
    return path


def validated(effect: dict[str, Any]) -> EffectDocument:
    """An effect of a `model.json`, as reading the file gives it."""
    file = DocumentFile(Path("model.json"), "a model", "diagnose again", "a model.json")
    return file.converted(effect, EffectDocument)


def sum_of_sines(
    t: FloatArray, omega: FloatArray, amplitude: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, speed and acceleration of one joint, sines of random phases."""
    angle = np.outer(t, omega) + rng.uniform(0.0, 2.0 * np.pi, len(omega))
    sine, cosine = np.sin(angle), np.cos(angle)
    return sine @ amplitude, cosine @ (amplitude * omega), -sine @ (amplitude * omega**2)


def write_joint_recording(
    path: Path, joint: str, t: FloatArray, q: FloatArray, torque: FloatArray
) -> Path:
    """Write a recording of a single joint."""
    table, header = np.column_stack([t, q, torque]), f"t,q.{joint},tau.{joint}"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    return path
