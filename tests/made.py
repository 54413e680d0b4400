"""Recordings of robots of known parameters, made by Pinocchio's inverse dynamics and not by a regressor."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from conftest import loaded

from excite.diagnosis.columns import Columns
from excite.diagnosis.half import Half, whitened
from excite.effects.effect import Shape
from excite.effects.track import Track
from excite.identification import consistency
from excite.identification.regression import Model
from excite.recordings import Recording, Sidecar
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.inertial_parameters import Parameters
from excite.robot.limits import Limits
from excite.schemas.document_file import DocumentFile
from excite.schemas.effects import EffectDocument
from excite.trajectory.fourier import Fourier

if TYPE_CHECKING:  # of an extra that need not be there
    from excite.simulator.simulated_robot import Plant

Array = np.ndarray
PERIOD, RATE = 5.2, 500.0
WIDTH = 0.004


def two_links() -> Model:
    """The built-in two-link robot with all parameters, and friction steps of WIDTH."""
    machine = robot.load("two_link")
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    return Model(
        machine, standard, base_parameters.find(machine, standard, table), np.full(machine.n, WIDTH)
    )


def perturbed(standard: Parameters, rng: np.random.Generator, size: float = 0.1) -> Array:
    psi = consistency.nominal_bodies(standard)
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


def simulated(plant: Plant, standard: Parameters, table: Limits) -> Array:
    """ψ of a robot that was simulated: its bodies, and what its drives are."""
    psi = inertial_parameters.standard(loaded(plant.tree.text), table).nominal.copy()
    for kind, name in (
        ("rotor_inertia", "inertia"),
        ("viscous", "viscous"),
        ("coulomb", "coulomb"),
        ("offset", "offset"),
    ):
        psi[standard.block(kind)] = getattr(plant.drive, name)
    return psi


def bodied(model: Model, psi: Array) -> pin.Model:
    """Pinocchio's model with those bodies."""
    own = model.robot.model.copy()
    for i in range(model.parameters.bodies):
        own.inertias[i + 1] = pin.Inertia.FromDynamicParameters(psi[10 * i : 10 * i + 10])
    return own


def torque(model: Model, psi: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """Inverse dynamics of a model with those bodies, by Pinocchio's rnea and not by a regressor."""
    standard, own = model.parameters, bodied(model, psi)
    data = own.createData()
    rigid = np.array([pin.rnea(own, data, *state) for state in zip(q, dq, ddq, strict=True)])
    drive = {kind: psi[standard.block(kind)] for kind in standard.drive}
    return (
        rigid
        + drive["rotor_inertia"] * ddq
        + drive["viscous"] * dq
        + drive["coulomb"] * np.tanh(dq / WIDTH)
        + drive["offset"]
    )


def motion(n: int, seed: int = 0, period: float = PERIOD) -> Fourier:
    rng = np.random.default_rng(seed)
    return Fourier(rng.normal(0.0, 0.7, (n, 4)), rng.normal(0.0, 0.7, (n, 4)), np.zeros(n), period)


def recorded(
    model: Model, psi: Array, fourier: Fourier, periods: float, noise: float, **side: object
) -> Recording:
    t = np.arange(round(periods * fourier.period * RATE) + 1) / RATE
    s = fourier.samples(t)
    exact = torque(model, psi, s.q, s.dq, s.ddq)
    rng = np.random.default_rng(1)
    sidecar = Sidecar(**({"period": fourier.period, "periodic": (0.0, float(t[-1]))} | side))  # type: ignore[arg-type]
    return Recording(
        "made.csv",
        model.robot.joints,
        t,
        s.q,
        tau=exact + noise * rng.normal(size=exact.shape),
        sidecar=sidecar,
        own_times=t,
    )


def written(recording: Recording, path: Path, decimals: int = 9) -> Path:
    """The contract's CSV and its sidecar."""
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


EMPTY = (np.zeros((0, 1)), np.zeros(0))


def nothing(track: Track, shape: Shape) -> Array:
    raise AssertionError("not asked for")


def halved(gamma: Array, torque: Array, known: tuple[Array, Array], scale: float = 1.0) -> Half:
    """Of a robot with one joint, which never rests."""
    return whitened(
        [gamma[:, None, :]], [torque], [np.ones(torque.shape, bool)], np.full(1, scale), known
    )


def on_one(first: Array, second: Array) -> tuple[Columns, Columns]:
    """Columns of both halves, of a robot with one joint."""
    return Columns.of(first[:, None]), Columns.of(second[:, None])


def validated(effect: dict[str, Any]) -> EffectDocument:
    """An effect of a `model.json`, as reading the file gives it."""
    file = DocumentFile(Path("model.json"), "a model", "diagnose again", "a model.json")
    return file.converted(effect, EffectDocument)
