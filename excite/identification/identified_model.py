"""`model.json`: an identified robot, whole; `excite predict` needs it, a recording and nothing else."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UnusableInput
from ..recordings import Recording
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import DRIVE, Parameters
from ..robot.robot import Robot, load
from ..robot.samples import Samples
from ..schemas.document_file import DocumentFile
from ..schemas.effects import EffectDocument
from ..schemas.model import SCHEMA, ModelDocument
from ..trajectory import trajectory_file
from . import confidence
from .hausman_test import HausmanTest
from .identification import Identification, Prediction
from .lowpass import MOTION_BANDWIDTH_RATIO, Grid, LowPassFilter, friction_speed
from .regression import BLOCK_ROWS
from .simulation_error import SimulationError
from .urdf_export import identified_urdf

Array = np.ndarray
JOINT_PARAMETER_UNITS = {"rotor_inertia": "kg m²", "viscous": "N m s/rad", "coulomb": "N m", "offset": "N m"}
INERTIAL_UNITS = (
    "kg",
    "kg m",
    "kg m",
    "kg m",
    "kg m²",
    "kg m²",
    "kg m²",
    "kg m²",
    "kg m²",
    "kg m²",
)


@dataclass(frozen=True)
class IdentifiedModel:
    """What predicts torque. psi: standard parameters. Shape (P,). widths: of Coulomb friction. Shape (n,). hertz: the band of the
    recordings it was fitted to; motion is filtered accordingly. effects: what a diagnosis found beyond it, as stated."""

    source: str
    robot: Robot
    drive: tuple[str, ...]
    psi: Array
    widths: Array
    hertz: float
    effects: tuple[EffectDocument, ...] = ()

    @property
    def layout(self) -> Parameters:
        """What stands where in ψ."""
        return Parameters(
            self.drive,
            ("",) * len(self.psi),
            self.psi,
            np.eye(1),
            self.robot.links,
            self.robot.joints,
            (),
        )

    def torque(self, motion: Samples, speed: Array) -> Array:
        """Y ψ, with `speed` in Coulomb friction. Shape (N, n) [N m]."""
        layout, out = self.layout, np.empty_like(motion.q)
        friction = (
            self.psi[layout.block("coulomb")] if "coulomb" in self.drive else np.zeros(self.robot.n)
        )
        smooth = self.psi.copy()
        if "coulomb" in self.drive:
            smooth[layout.block("coulomb")] = 0.0
        for start in range(0, len(motion), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            out[part] = regressor(
                self.robot, layout, motion.rows(part)
            ) @ smooth + friction * np.tanh(speed[part] / self.widths)
        return out

    def predict(
        self, recording: Recording, beyond: Callable[[Recording], Array] | None = None
    ) -> tuple[Array, Array]:
        """Torque along a recording at its own times: (times, torque). Shapes (N,) [s], (N, n) [N m].

        Below the model's band, zero phase; in gaps of the recording there is no prediction. beyond: further torque along each stretch,
        at its rows, below the band.
        """
        times, torques = [], []
        for piece in recording.segments():
            band = LowPassFilter(
                min(self.hertz, 0.45 * piece.rate),
                piece.rate,
                len(piece),
                encoder=float(recording.encoder.max()),
            )
            position = band.transformed(piece.q)
            motion = Samples(*(position.low(Grid.RECORDED, order, MOTION_BANDWIDTH_RATIO) for order in range(3)))
            torque = band.low(
                self.torque(motion, friction_speed(piece.q, band, position)), Grid.RECORDED
            )
            if beyond is not None:
                torque = torque + beyond(piece)
            own = recording.own_times[
                (recording.own_times >= piece.t[0] - 1e-9)
                & (recording.own_times <= piece.t[-1] + 1e-9)
            ]
            times.append(own)
            torques.append(
                np.column_stack([np.interp(own, piece.t, column) for column in torque.T])
            )
        if not times:
            raise UnusableInput(
                f"{recording.source}: has no stretch without a gap that is long enough; record again"
            )
        return np.concatenate(times), np.concatenate(torques)


def model_document(found: Identification, recordings: Sequence[Recording]) -> dict[str, Any]:
    """The content of `model.json`."""
    robot, parameters = found.model.robot, found.model.parameters
    widths, edge = found.model.widths, 10 * parameters.bodies
    stated = {**robot.options, "locked": {}, "payload": None}  # both are in the identified URDF
    return {
        "schema": SCHEMA,
        "robot": {"name": robot.name, "source": robot.source, "sha256": robot.sha256, **stated},
        "urdf": identified_urdf(robot, parameters, found.psi, widths),
        "joints": list(robot.joints),
        "links": list(parameters.links),
        "drive": list(parameters.drive),
        "standard_parameters": _standard(found),
        "coulomb_width": dict(zip(robot.joints, widths.tolist(), strict=True)),
        "base_parameters": base_parameter_table(found),
        "directions": _directions(found),
        "identifiable": found.analysis.identifiable,
        "threshold": found.options.threshold,
        "prior": {
            "distance": found.options.distance.value,
            "gamma": {"bodies": found.prior.bodies, **_by_kind(found)},
            "chosen_by": found.options.gamma if isinstance(found.options.gamma, str) else "given",
            "scales": dict(zip(parameters.names[edge:], found.prior.scales.tolist(), strict=True)),
        },
        "consistency": {
            "misfit": found.posterior.misfit,
            "distance_squared": found.posterior.distance,
        },
        "method": found.options.method.value,
        "outliers": found.data.outliers,
        "band_hz": found.spectra.hertz,
        "rows": len(found.equations),
        "noise": {
            joint: {
                "model": float(a),
                "periods": None if found.floor is None else float(found.floor[i]),
            }
            for i, (joint, a) in enumerate(zip(robot.joints, found.data.noise, strict=True))
        },
        "delay": {
            joint: {"seconds": float(s), "std": float(d)}
            for joint, s, d in zip(
                robot.joints, found.delay.seconds, found.delay.deviation, strict=True
            )
        },
        "recordings": [r.source for r in recordings],
        "fit": [prediction_summary(p, robot.joints) for p in found.fits],
        "validation": [prediction_summary(p, robot.joints) for p in found.validations],
        "endogeneity": None if found.endogeneity is None else _endogeneity(found.endogeneity),
        "simulation": None
        if found.simulation is None
        else _simulation(found.simulation, robot.joints),
        "effects": [],
        "versions": trajectory_file.package_versions(),
    }


def _standard(found: Identification) -> list[dict[str, Any]]:
    parameters = found.model.parameters
    deviation = np.sqrt(np.maximum(np.diag(found.posterior.covariance), 0.0))
    drives = [
        entry.unit(JOINT_PARAMETER_UNITS[kind]) for kind in parameters.drive for entry in found.model.robot.entries
    ]
    units = [*INERTIAL_UNITS] * parameters.bodies + drives
    columns = (
        parameters.names,
        parameters.owners(),
        parameters.nominal,
        found.psi,
        found.reduced.psi,
        deviation,
        units,
    )
    keys = ("name", "of", "nominal", "value", "reduced", "std", "unit")
    return [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]


def _endogeneity(test: HausmanTest) -> dict[str, Any]:
    facts = {
        "statistic": test.statistic,
        "freedom": test.freedom,
        "p": test.p,
        "needed": test.needed,
    }
    return facts | {"words": test.words}


def _simulation(error: SimulationError, joints: Sequence[str]) -> dict[str, Any]:
    rows = {
        key: dict(zip(joints, getattr(error, key)[-1].tolist(), strict=True))
        for key in ("fitted", "nominal")
    }
    return {"ahead": float(error.lag[-1]), "windows": error.windows, "share": error.share, **rows}


def _by_kind(found: Identification) -> dict[str, list[float]]:
    """γ of each kind of drive parameter, joint by joint."""
    n = found.model.robot.n
    return {
        kind: found.prior.drives[k * n : k * n + n].tolist()
        for k, kind in enumerate(found.model.parameters.drive)
    }


def base_parameter_table(found: Identification) -> list[dict[str, Any]]:
    """θ: nominal, by the data alone with its 95 % interval, and as the consistent model has it."""
    base, data = found.model.base, found.data
    names = [found.model.parameters.names[i] for i in base.independent]
    half = confidence.interval_half_widths(data, np.eye(base.count))
    deviation = np.sqrt(np.diag(data.covariance))
    value, nominal = base.matrix @ found.psi, base.matrix @ found.model.parameters.nominal
    return [
        {
            "name": names[k],
            "expression": base.expressions[k],
            "nominal": nominal[k],
            "value": value[k],
            "data": data.theta[k] if np.isfinite(deviation[k]) else None,
            "std": deviation[k],
            "interval": [data.theta[k] - half[k], data.theta[k] + half[k]]
            if np.isfinite(half[k])
            else None,
        }
        for k in range(base.count)
    ]


def _directions(found: Identification) -> list[dict[str, Any]]:
    """Each direction of I·H₀⁻¹, how well it is known, and how much of the model's value in it the data decided."""
    shares = found.decided()
    return [
        {
            "variance": d.variance,
            "identifiable": d.identifiable,
            "data_share": float(share),
            "words": d.words,
            "weights": dict(d.weights),
        }
        for d, share in zip(found.analysis.directions, shares, strict=True)
    ]


def prediction_summary(prediction: Prediction, joints: Sequence[str]) -> dict[str, Any]:
    """Torque errors of one recording, joint by joint."""
    errors = {
        key: (prediction.error(key), prediction.relative(key)) for key in ("fitted", "nominal")
    }
    rows = {
        joint: {
            "rmse": float(errors["fitted"][0][i]),
            "relative": float(errors["fitted"][1][i]),
            "rmse_nominal": float(errors["nominal"][0][i]),
            "relative_nominal": float(errors["nominal"][1][i]),
            "noise_floor": None if prediction.floor is None else float(prediction.floor[i]),
        }
        for i, joint in enumerate(joints)
    }
    return {"recording": prediction.source, "joints": rows}


def read_model(path: Path) -> IdentifiedModel:
    """Read `model.json`.

    Raises:
        UnusableInput: The file is missing, is of another schema, breaks a rule of `schemas.model`, or its URDF is none.
    """
    file = DocumentFile(
        path, "a model", "identify or diagnose again", "the model.json of 'excite identify'"
    )
    content = file.json()
    file.schema(content, (SCHEMA,))
    return model_from_document(file, content)


def model_from_document(file: DocumentFile, content: Any) -> IdentifiedModel:
    """The model of the plain values of a `model.json`; raises as `read` does."""
    document = file.converted(content, ModelDocument)
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "identified.urdf"
        urdf.write_text(document.urdf, encoding="utf-8")
        try:
            robot = load(str(urdf), joints=document.joints, gravity=document.robot.gravity)
        except UnusableInput as error:
            raise file.error(str(error).replace(str(urdf), "the URDF in it"), "urdf") from error
    drive = tuple(kind for kind in DRIVE if kind in document.drive)
    if (
        list(robot.joints) != document.joints
        or list(robot.links) != document.links
        or list(drive) != document.drive
    ):
        raise file.error(
            "its joints, links and joint parameters are not in the order of the URDF in it",
            "urdf",
        )
    psi = np.array([entry.value for entry in document.standard_parameters], float)
    widths = np.array([document.coulomb_width[joint] for joint in robot.joints], float)
    return IdentifiedModel(
        str(file.path), robot, drive, psi, widths, float(document.band_hz), tuple(document.effects)
    )
