"""Identified robot and its file `model.json`, from which torque is predicted."""

from __future__ import annotations

import dataclasses
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .. import __version__
from .._types import FloatArray, IntArray
from ..errors import ExciteWarning, UnusableInput
from ..recordings import Recording
from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.floating_base import FloatingRobot
from ..robot.inertial_parameters import DRIVE, Parameters
from ..robot.robot import LockedJoint, Robot, load
from ..robot.samples import Samples
from ..schemas.document_file import DocumentFile
from ..schemas.effects import EffectDocument
from ..schemas.model import SCHEMA, ModelDocument, PositionLoopDocument
from ..trajectory import trajectory_file
from . import estimators
from .consistency import ConsistentEstimate, Prior
from .estimators import Estimate
from .hausman_test import HausmanTest
from .identification import MAX_BAND_SHARE, Identification, Prediction
from .link_estimates import LinkEstimate, link_estimates
from .lowpass import MOTION_BANDWIDTH_RATIO, Grid, LowPassFilter, friction_speed
from .regression import BLOCK_ROWS
from .simulation_error import SimulationError
from .urdf_export import identified_urdf

StatedRobot = TypeVar("StatedRobot", Robot, FloatingRobot)

JOINT_PARAMETER_UNITS = {
    "rotor_inertia": "kg m²",
    "viscous": "N m s/rad",
    "coulomb": "N m",
    "offset": "N m",
}
"""Unit of each kind of joint parameter, of a revolute joint."""
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
"""Units of a link's ten inertial parameters."""
ROW_TIME_TOLERANCE = 1e-9
"""Tolerance of the times of rows at the ends of a gap-free stretch [s]: rounding."""
COVARIANCE_TOLERANCE = 1e-6
"""Asymmetry and excess of an element of a covariance over the standard deviations: rounding [1]."""


@dataclass(frozen=True)
class BaseCovariance:
    """Covariance of the base parameters of a model.

    Attributes:
        columns: Indices in ψ of the columns of Y that are those of the base parameters. Shape (p,).
        matrix: The covariance. Shape (p, p).
    """

    columns: IntArray
    matrix: FloatArray

    @property
    def root(self) -> FloatArray:
        """S with S Sᵀ the covariance. Shape (p, p)."""
        size = np.sqrt(np.maximum(np.diag(self.matrix), 1e-300))
        values, vectors = np.linalg.eigh(self.matrix / np.outer(size, size))
        return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True)
class IdentifiedModel:
    """A robot with identified parameters.

    Attributes:
        source: Path of the `model.json`.
        robot: The robot of its URDF.
        drive: Kinds of joint parameters.
        psi: Standard parameters. Shape (P,).
        widths: Widths of Coulomb friction. Shape (n,) [rad/s or m/s].
        hertz: Cutoff frequency of the fit [Hz]; motion is filtered in the same way for prediction.
        effects: Effects found by a diagnosis, as stated in the file.
        position_loop: Position loop of each servo, where it was identified.
        base_covariance: Covariance of the base parameters, if the file states it.
    """

    source: str
    robot: Robot
    drive: tuple[str, ...]
    psi: FloatArray
    widths: FloatArray
    hertz: float
    effects: tuple[EffectDocument, ...] = ()
    position_loop: Mapping[str, PositionLoopDocument] = field(default_factory=dict)
    base_covariance: BaseCovariance | None = None

    @property
    def layout(self) -> Parameters:
        """Positions of the parameters in ψ; names and scales are left empty."""
        return Parameters(
            self.drive,
            ("",) * len(self.psi),
            self.psi,
            np.eye(1),
            self.robot.links,
            self.robot.joints,
            (),
        )

    def torque(self, motion: Samples, speed: FloatArray) -> FloatArray:
        """Compute the torque Y ψ.

        Args:
            motion: The motion.
            speed: Speed in Coulomb friction, see `lowpass.friction_speed`. Shape (N, n).

        Returns:
            Shape (N, n) [N m].
        """
        layout, out = self.layout, np.empty_like(motion.q)
        coulomb = (
            self.psi[layout.block("coulomb")] if "coulomb" in self.drive else np.zeros(self.robot.n)
        )
        smooth = self.psi.copy()
        if "coulomb" in self.drive:
            smooth[layout.block("coulomb")] = 0.0
        for start in range(0, len(motion), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            out[part] = regressor(
                self.robot, layout, motion.rows(part)
            ) @ smooth + coulomb * np.tanh(speed[part] / self.widths)
        return out

    def predict(
        self, recording: Recording, effect_torque: Callable[[Recording], FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Predict the torque along a recording, below the model's band.

        Args:
            recording: The motion. Gaps in it get no prediction.
            effect_torque: Additional torque of each gap-free stretch, below the band, at its rows.

        Returns:
            Times of the recording's rows, shape (N,) [s], and torque, shape (N, n) [N m].

        Raises:
            UnusableInput: The recording has no gap-free stretch that is long enough.
        """
        torques = []
        for stretch in recording.segments():
            band = LowPassFilter(
                min(self.hertz, MAX_BAND_SHARE * stretch.rate),
                stretch.rate,
                len(stretch),
                encoder=float(recording.quantization_noise.max()),
            )
            position = band.transform(stretch.q)
            motion = Samples(
                *(
                    position.filter(Grid.RECORDED, order, MOTION_BANDWIDTH_RATIO)
                    for order in range(3)
                )
            )
            torque = band.filter(
                self.torque(motion, friction_speed(stretch.q, band, position)), Grid.RECORDED
            )
            if effect_torque is not None:
                torque = torque + effect_torque(stretch)
            torques.append((stretch, torque))
        return at_row_times(recording, torques)


def at_row_times(
    recording: Recording, values: Sequence[tuple[Recording, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Interpolate values at the samples of gap-free stretches at the rows of their recording.

    Args:
        recording: The recording.
        values: Its gap-free stretches, each with values at its samples, shape (N, r).

    Returns:
        Times of the recording's rows within the stretches, shape (N,) [s], and the values there,
        shape (N, r).

    Raises:
        UnusableInput: The recording has no gap-free stretch that is long enough.
    """
    if not values:
        raise UnusableInput(
            f"{recording.source}: has no gap-free stretch that is long enough; record again"
        )
    times, out = [], []
    for stretch, samples in values:
        first, last = stretch.t[0] - ROW_TIME_TOLERANCE, stretch.t[-1] + ROW_TIME_TOLERANCE
        rows = recording.row_times[(recording.row_times >= first) & (recording.row_times <= last)]
        times.append(rows)
        out.append(np.column_stack([np.interp(rows, stretch.t, column) for column in samples.T]))
    return np.concatenate(times), np.concatenate(out)


def provenance(
    robot: Robot, recordings: Sequence[Recording], links: Sequence[LinkEstimate]
) -> list[str]:
    """Return the lines that say where the figures of an identified URDF come from.

    Args:
        robot: The robot before its identification.
        recordings: Recordings that it was identified from.
        links: Masses and centres of mass.
    """
    names = ", ".join(Path(recording.source).name for recording in recordings)
    out = [
        f"Identified by excite {__version__} from {names};",
        f"robot {robot.source}.",
        "Inertial parameters, friction and <excite> elements are replaced. Masses [kg], and the",
        "share of each mass that the recordings decide (below 50 %: it is the prior's):",
    ]
    for link in links:
        mark = "  the prior's" if link.is_prior else ""
        out.append(
            f"  {link.name}: {link.mass:.4g} +- {link.mass_deviation:.2g}, "
            f"{100.0 * link.mass_share:.0f} % data{mark}"
        )
    doubts = [doubt.text for recording in recordings for doubt in recording.doubts]
    if doubts:
        out += ["DOUBTS about the recordings, which make these figures doubtful, too:"]
        out += [f"  {text}" for text in doubts]
    return out


def model_document(
    identification: Identification, recordings: Sequence[Recording]
) -> dict[str, Any]:
    """Return the content of `model.json`.

    Args:
        identification: The result of an identification.
        recordings: The recordings that the model was fitted to.
    """
    robot, parameters = identification.model.robot, identification.model.parameters
    widths, edge = identification.model.widths, 10 * parameters.bodies
    prior, data, delay = identification.prior, identification.data, identification.delay
    gamma = identification.options.gamma
    links = link_estimates(parameters, identification.posterior, prior)
    return {
        "schema": SCHEMA,
        "robot": robot_entry(robot),
        "urdf": identified_urdf(
            robot,
            parameters,
            identification.psi,
            widths,
            provenance(robot, recordings, links),
        ),
        "link_estimates": [link.document() for link in links],
        "joints": list(robot.joints),
        "links": list(parameters.links),
        "drive": list(parameters.drive),
        "standard_parameters": standard_parameter_table(
            parameters, robot, identification.posterior, identification.reduced.psi
        ),
        "coulomb_width": dict(zip(robot.joints, widths.tolist(), strict=True)),
        "base_parameters": base_parameter_table(
            parameters, identification.model.base, data, identification.psi
        ),
        "base_covariance": base_covariance_entry(
            parameters, identification.model.base, identification.posterior
        ),
        "directions": _direction_table(identification),
        "identifiable": identification.analysis.identifiable_count,
        "threshold": identification.options.threshold,
        "prior": {
            "distance": identification.options.distance.value,
            "gamma": {"bodies": prior.inertial_weight, **joint_gamma(parameters, prior)},
            "chosen_by": gamma if isinstance(gamma, str) else "given",
            "scales": dict(zip(parameters.names[edge:], prior.joint_scales.tolist(), strict=True)),
        },
        "consistency": {
            "misfit": identification.posterior.misfit,
            "distance_squared": identification.posterior.distance,
        },
        "method": identification.options.method.value,
        "outliers": data.outliers,
        "band_hz": identification.spectra.hertz,
        "rows": len(identification.equations),
        "noise": {
            joint: {
                "model": float(deviation),
                "periods": None
                if identification.noise_floor is None
                else float(identification.noise_floor[i]),
            }
            for i, (joint, deviation) in enumerate(zip(robot.joints, data.noise, strict=True))
        },
        "delay": {
            joint: {"seconds": float(s), "std": float(d)}
            for joint, s, d in zip(robot.joints, delay.seconds, delay.deviation, strict=True)
        },
        "recordings": [r.source for r in recordings],
        "fit": [prediction_summary(p, robot.joints) for p in identification.fits],
        "validation": [prediction_summary(p, robot.joints) for p in identification.validations],
        "endogeneity": None
        if identification.endogeneity is None
        else _hausman_summary(identification.endogeneity),
        "simulation": None
        if identification.simulation is None
        else _simulation_summary(identification.simulation, robot.joints),
        # the equations are those of torque without its delay, recordings have it
        "effects": _delays(robot, delay.significant) if identification.options.align else [],
        "versions": trajectory_file.package_versions(),
    }


def _delays(robot: Robot, seconds: FloatArray) -> list[dict[str, Any]]:
    """Return the delay of the torque of each joint, shape (n,) [s], as effects of a model."""
    effect = {"effect": "delay", "from": None, "time": None, "recording": None}
    return [
        {**effect, "joint": joint, "values": {"measured": 1.0}, "coefficients": [float(delay)]}
        for joint, delay in zip(robot.joints, seconds, strict=True)
        if delay
    ]


def robot_entry(robot: Robot) -> dict[str, Any]:
    """Return the entry "robot" of `model.json`.

    Locked joints, payload and nominal inertias are part of the identified URDF; where the locked
    joints stood is stated for comparisons with recordings.

    Args:
        robot: The robot before its identification.
    """
    entry = {**robot.document(), "locked": {}, "payload": None}
    entry.pop("inertias", None)
    if robot.locked:
        entry["fixed"] = {
            joint.name: {"position": joint.position, "unit": joint.unit, "share": joint.share}
            for joint in robot.locked
        }
    return entry


def standard_parameter_table(
    parameters: Parameters,
    robot: Robot,
    posterior: ConsistentEstimate,
    reduced: FloatArray | None = None,
) -> list[dict[str, Any]]:
    """Return nominal and identified value, standard deviation and unit of each parameter.

    Args:
        parameters: The standard parameters.
        robot: The robot.
        posterior: The estimate.
        reduced: Values with the unidentified directions at their nominal values. Shape (P,).
    """
    deviation = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0))
    joint_units = [
        entry.unit(JOINT_PARAMETER_UNITS[kind])
        for kind in parameters.drive
        for entry in robot.entries
    ]
    units = [*INERTIAL_UNITS] * parameters.bodies + joint_units
    columns = (
        parameters.names,
        parameters.owners(),
        parameters.nominal,
        posterior.psi,
        posterior.psi if reduced is None else reduced,
        deviation,
        units,
    )
    keys = ("name", "of", "nominal", "value", "reduced", "std", "unit")
    return [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]


def _hausman_summary(test: HausmanTest) -> dict[str, Any]:
    """Content of "endogeneity"."""
    return {
        "statistic": test.statistic,
        "freedom": test.degrees_of_freedom,
        "p": test.p_value,
        "needed": test.needs_instruments,
        "words": test.summary,
    }


def _simulation_summary(error: SimulationError, joints: Sequence[str]) -> dict[str, Any]:
    """Content of "simulation": the error at the end of the windows."""
    rows = {
        key: dict(zip(joints, getattr(error, key)[-1].tolist(), strict=True))
        for key in ("fitted", "nominal")
    }
    return {"ahead": float(error.lag[-1]), "windows": error.windows, "share": error.share, **rows}


def joint_gamma(parameters: Parameters, prior: Prior) -> dict[str, list[float]]:
    """Return γ of each kind of joint parameter, joint by joint.

    Args:
        parameters: Standard parameters.
        prior: The prior.
    """
    n = len(parameters.joints)
    return {
        kind: prior.joint_weights[k * n : k * n + n].tolist()
        for k, kind in enumerate(parameters.drive)
    }


def base_parameter_table(
    parameters: Parameters, base: Base, data: Estimate, psi: FloatArray
) -> list[dict[str, Any]]:
    """Return the base parameters: nominal, from the data with 95 % interval, of the model.

    Args:
        parameters: The standard parameters.
        base: The base parameters.
        data: Their estimate from the data alone.
        psi: Standard parameters of the model. Shape (P,).
    """
    names = [parameters.names[i] for i in base.independent]
    half = estimators.interval_half_widths(data, np.eye(base.count))
    deviation = np.sqrt(np.diag(data.covariance))
    value, nominal = base.matrix @ psi, base.matrix @ parameters.nominal
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


def base_covariance_entry(
    parameters: Parameters, base: Base, posterior: ConsistentEstimate
) -> dict[str, Any]:
    """Return the covariance of the model's base parameters, B P Bᵀ.

    Args:
        parameters: The standard parameters.
        base: The base parameters.
        posterior: The estimate, whose covariance of ψ is P.
    """
    matrix = base.matrix @ posterior.covariance @ base.matrix.T
    return {
        "parameters": [parameters.names[i] for i in base.independent],
        "matrix": matrix.tolist(),
    }


def _direction_table(identification: Identification) -> list[dict[str, Any]]:
    """Directions of I·H₀⁻¹: variance, and share of the value that the data determine."""
    shares = identification.data_shares()
    return [
        {
            "variance": d.variance,
            "identifiable": d.identifiable,
            "data_share": float(share),
            "words": d.words,
            "weights": dict(d.weights),
        }
        for d, share in zip(identification.analysis.directions, shares, strict=True)
    ]


def prediction_summary(prediction: Prediction, joints: Sequence[str]) -> dict[str, Any]:
    """Return the torque errors of one recording, joint by joint."""
    errors = {
        key: (prediction.error(key), prediction.relative(key)) for key in ("fitted", "nominal")
    }
    rows = {
        joint: {
            "rmse": float(errors["fitted"][0][i]),
            "relative": float(errors["fitted"][1][i]),
            "rmse_nominal": float(errors["nominal"][0][i]),
            "relative_nominal": float(errors["nominal"][1][i]),
            "noise_floor": None
            if prediction.noise_floor is None
            else float(prediction.noise_floor[i]),
        }
        for i, joint in enumerate(joints)
    }
    return {"recording": prediction.source, "joints": rows}


def read_model(path: Path) -> IdentifiedModel:
    """Read `model.json`.

    Raises:
        UnusableInput: The file is missing, is of another schema, breaks a rule of `schemas.model`,
            or contains an invalid URDF.
    """
    return model_from_document(*read_content(path))


def read_content(path: Path) -> tuple[DocumentFile, dict[str, Any]]:
    """Read the file and the plain values of a `model.json`.

    Raises:
        UnusableInput: The file is missing or of another schema.
    """
    file = model_file(path)
    content = file.json()
    file.schema(content, (SCHEMA,))
    return file, content


def model_file(path: Path) -> DocumentFile:
    """Return the reader of a `model.json`."""
    return DocumentFile(
        path, "a model", "identify or diagnose again", "the model.json of 'excite identify'"
    )


def model_from_document(file: DocumentFile, content: Any) -> IdentifiedModel:
    """Build the model from the plain values of a `model.json`.

    Args:
        file: The file, for error messages.
        content: Its parsed content.

    Raises:
        UnusableInput: As `read_model`.
    """
    document = file.converted(content, ModelDocument)
    if document.floating_base is not None:
        raise file.error(
            "is the model of a robot with a floating base, which only 'excite predict' reads",
            "floating_base",
        )
    robot, drive = load_stated_urdf(
        file,
        document,
        lambda path: load(path, joints=document.joints, gravity=document.robot.gravity),
    )
    fixed = document.robot.fixed.items()
    locked = tuple(
        LockedJoint(name, float(at.position), at.unit, float(at.share)) for name, at in fixed
    )
    robot = dataclasses.replace(robot, locked=locked)
    psi = np.array([entry.value for entry in document.standard_parameters], float)
    widths = np.array([document.coulomb_width[joint] for joint in robot.joints], float)
    return IdentifiedModel(
        str(file.path),
        robot,
        drive,
        psi,
        widths,
        float(document.band_hz),
        tuple(document.effects),
        document.position_loop,
        _base_covariance(file, document),
    )


def _base_covariance(file: DocumentFile, document: ModelDocument) -> BaseCovariance | None:
    """Covariance of the base parameters; None if the file does not state it."""
    stated = document.base_covariance
    if stated is None:
        return None
    names = [entry.name for entry in document.standard_parameters]
    count = len(stated.parameters)
    if not set(stated.parameters) <= set(names) or len(set(stated.parameters)) < count:
        raise file.error("should name standard parameters, each once", "base_covariance.parameters")
    if len(stated.matrix) != count or any(len(row) != count for row in stated.matrix):
        raise file.error(f"should have {count} rows and columns", "base_covariance.matrix")
    matrix = np.array(stated.matrix, float).reshape(count, count)
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    largest = np.outer(size, size)
    if (np.abs(matrix - matrix.T) > COVARIANCE_TOLERANCE * largest).any():
        raise file.error("should be symmetric", "base_covariance.matrix")
    if (np.abs(matrix) > (1.0 + COVARIANCE_TOLERANCE) * largest).any():
        raise file.error(
            "has a correlation beyond ±1 or a negative variance", "base_covariance.matrix"
        )
    return BaseCovariance(np.array([names.index(name) for name in stated.parameters]), matrix)


@contextmanager
def stated_urdf(text: str) -> Iterator[Path]:
    """Write the URDF of a `model.json` to a temporary file.

    That it has undeclared XML prefixes is not remarked on: they are those of the robot's own file.

    Args:
        text: The URDF.
    """
    with tempfile.TemporaryDirectory(prefix="excite-") as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* undeclared XML prefix", ExciteWarning)
        path = Path(folder) / "identified.urdf"
        path.write_text(text, encoding="utf-8")
        yield path


def load_stated_urdf(
    file: DocumentFile, document: ModelDocument, loader: Callable[[str], StatedRobot]
) -> tuple[StatedRobot, tuple[str, ...]]:
    """Load the robot of the URDF in a `model.json`.

    Args:
        file: The file, for error messages.
        document: Its content.
        loader: Loads the robot from the path of a URDF.

    Returns:
        The robot and the kinds of its joint parameters.

    Raises:
        UnusableInput: The URDF is invalid, or its order is not that of the parameters.
    """
    with stated_urdf(document.urdf) as urdf:
        try:
            robot = loader(str(urdf))
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
    return robot, drive
