"""`model.json` of a floating-base robot, and the wrench and torque that it predicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from .._types import FloatArray
from ..errors import UnusableInput
from ..recordings import Recording
from ..recordings.floating_signals import COMPONENTS, WORLD
from ..robot import floating_base
from ..robot import robot as robots
from ..robot.floating_base import FloatingRobot, Rows
from ..robot.inertial_parameters import Parameters
from ..schemas.document_file import DocumentFile
from ..schemas.model import SCHEMA, ModelDocument
from ..trajectory import trajectory_file
from . import floating_regression
from .floating_identification import FloatingIdentification
from .floating_regression import RowFilter
from .identification import MAX_BAND_SHARE, Prediction
from .identified_model import (
    at_row_times,
    base_parameter_table,
    load_stated_urdf,
    robot_entry,
    standard_parameter_table,
)
from .lowpass import FRICTION_BANDWIDTH_RATIO, Grid
from .urdf_export import identified_urdf


@dataclass(frozen=True)
class FloatingIdentifiedModel:
    """A floating-base robot with identified parameters.

    Attributes:
        source: Path of the `model.json`.
        robot: The robot of its URDF.
        drive: Kinds of joint parameters.
        psi: Standard parameters. Shape (P,).
        widths: Widths of Coulomb friction. Shape (n,) [rad/s or m/s].
        rows: Rows that were fitted, which are those that it predicts.
        contacts: Frames of the contact wrenches of the fit.
        offset: Offsets of their sensors, six of each contact; empty without.
        hertz: Cutoff frequency of each row. Shape (r,) [Hz].
    """

    source: str
    robot: FloatingRobot
    drive: tuple[str, ...]
    psi: FloatArray
    widths: FloatArray
    rows: Rows
    contacts: tuple[str, ...]
    offset: FloatArray
    hertz: FloatArray

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

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the predicted columns: `wrench.world.fx`, …, `tau.<joint>`, …"""
        wrench = [f"wrench.{WORLD}.{component}" for component in COMPONENTS]
        return tuple([*wrench, *self.robot.row_names[6:]][self.rows.selection(self.robot.n)])

    def predict(self, recording: Recording) -> tuple[FloatArray, FloatArray]:
        """Predict wrench and torque along a recording, below the model's bands.

        The wrench is the sum of all contacts about the world's origin, as sensors with the
        identified offsets would measure it. The torque of joints is what remains after the
        recorded contact wrenches; of a recording without wrenches the predicted wrench is taken to
        act at the model's only contact.

        Args:
            recording: The motion. Gaps in it get no prediction.

        Returns:
            Times of the recording's rows, shape (N,) [s], and the columns, shape (N, r).

        Raises:
            UnusableInput: The recording has no gap-free stretch that is long enough, or joint
                torques need a contact wrench that it lacks.
        """
        return at_row_times(
            recording, [(stretch, self._rows_of(stretch)) for stretch in recording.segments()]
        )

    def _rows_of(self, stretch: Recording) -> FloatArray:
        """Predicted columns at the samples of a gap-free recording. Shape (N, r)."""
        limit = MAX_BAND_SHARE * stretch.rate
        rows = RowFilter.of(stretch, np.minimum(self.hertz, limit))
        motion = floating_regression.filtered_motion(stretch, self.robot, rows.band, Grid.RECORDED)
        layout, smooth = self.layout, self.psi.copy()
        has_coulomb = "coulomb" in self.drive and self.rows.has_joints
        if has_coulomb:
            smooth[layout.block("coulomb")] = 0.0
        blocks = floating_base.regressor_blocks(self.robot, layout, motion, self.rows)
        out: FloatArray = np.concatenate([Y @ smooth for Y in blocks])
        if has_coulomb:
            speed = rows.band.transform(stretch.q).filter(
                Grid.RECORDED, 1, FRICTION_BANDWIDTH_RATIO
            )
            out[:, -self.robot.n :] += self.psi[layout.block("coulomb")] * np.tanh(
                speed / self.widths
            )
        if self.rows.has_base:
            out[:, :6] = floating_regression.in_world_axes(out[:, :6], motion.pose)
        maps = floating_regression.contact_maps(self.robot, motion, self.contacts, self.rows)
        offset = maps @ self.offset if len(self.offset) else np.zeros(out.shape)
        if self.rows.has_joints:
            torque = slice(-self.robot.n, None)
            out[:, torque] -= self._contact_torque(stretch, out, maps)[:, torque]
            offset[:, torque] = 0.0  # of the sensors of wrenches
        out = rows.filter(out + offset, Grid.RECORDED)
        if self.rows.has_base:
            out[:, :6] = floating_regression.about_world_origin(out[:, :6], motion.pose)
        return out

    def _contact_torque(
        self, stretch: Recording, rigid: FloatArray, maps: FloatArray
    ) -> FloatArray:
        """Rows of the contact wrenches, which the joint torques need not hold. Shape (N, r)."""
        if not self.contacts:
            return np.zeros(rigid.shape)
        if stretch.contacts == tuple(sorted(self.contacts)):
            wrench: FloatArray = np.hstack([stretch.wrench(name) for name in self.contacts])
            if len(self.offset):
                wrench = wrench - self.offset
        elif len(self.contacts) == 1 and self.rows.has_base:
            wrench = np.asarray(np.linalg.solve(maps[:, :6], rigid[:, :6, None]))[:, :, 0]
        else:
            raise UnusableInput(
                f"{stretch.source}: has no wrench of {', '.join(self.contacts)}, without which the "
                f"joint torques of {self.source} are not determined; record wrench.<frame>.fx … mz"
            )
        return np.asarray(np.einsum("trk,tk->tr", maps, wrench))


def model_document(
    identification: FloatingIdentification, recordings: Sequence[Recording]
) -> dict[str, Any]:
    """Return the content of `model.json`.

    Args:
        identification: The result of an identification.
        recordings: The recordings that the model was fitted to.
    """
    model, options = identification.model, identification.options
    robot, parameters, prior = model.robot, model.parameters, identification.prior
    joint_robot, edge = robot.joint_robot, 10 * parameters.bodies
    weights, shares = identification.weights, identification.body_shares()
    names = ", ".join(Path(recording.source).name for recording in recordings)
    provenance = [
        f"Identified by excite {__version__} from {names};",
        f"robot {robot.source}, floating base. Shares of the bodies that the data decide:",
        *(f"  {link}: {100.0 * share:.0f} %" for link, share in shares.items()),
    ]
    offsets = identification.offset.reshape(-1, 6)
    offset_deviations = identification.offset_deviation.reshape(-1, 6)
    return {
        "schema": SCHEMA,
        "robot": robot_entry(joint_robot),
        "urdf": identified_urdf(
            joint_robot, parameters, identification.psi, model.widths, provenance, robot.model
        ),
        "floating_base": {
            "base_link": robot.base_link,
            "rows": model.rows.value,
            "contacts": list(model.contacts),
            "offsets": offsets.tolist(),
            "offset_std": offset_deviations.tolist(),
            "row_band_hz": identification.hertz.tolist(),
            "body_shares": shares,
            "symmetric": None if options.symmetric is None else list(options.symmetric),
        },
        "link_estimates": [link.document() for link in identification.links()],
        "joints": list(robot.joints),
        "links": list(parameters.links),
        "drive": list(parameters.drive),
        "standard_parameters": standard_parameter_table(
            parameters, joint_robot, identification.posterior
        ),
        "coulomb_width": dict(zip(robot.joints, model.widths.tolist(), strict=True)),
        "base_parameters": base_parameter_table(
            parameters, model.base, identification.data, identification.psi
        ),
        "directions": [
            {
                "variance": direction.variance,
                "identifiable": direction.identifiable,
                "words": direction.words,
                "weights": dict(direction.weights),
            }
            for direction in identification.analysis.directions
        ],
        "identifiable": identification.analysis.identifiable_count,
        "threshold": options.threshold,
        "prior": {
            "distance": options.distance.value,
            "gamma": {"bodies": prior.inertial_weight, "joints": prior.joint_weights.tolist()},
            "chosen_by": options.gamma if isinstance(options.gamma, str) else "given",
            "trials": [list(trial) for trial in identification.gamma_trials],
            "scales": dict(zip(parameters.names[edge:], prior.joint_scales.tolist(), strict=True)),
        },
        "consistency": {
            "misfit": identification.posterior.misfit,
            "distance_squared": identification.posterior.distance,
        },
        "method": "wls",
        "band_hz": float(identification.hertz.max()),
        "rows": identification.rows_fitted,
        "noise": {
            row: {"model": float(deviation), "samples_per_independent": float(samples)}
            for row, deviation, samples in zip(
                model.joints, weights.deviation, weights.samples_per_independent, strict=True
            )
        },
        "recordings": [recording.source for recording in recordings],
        "fit": [prediction_summary(p, model.joints) for p in identification.fits],
        "validation": [prediction_summary(p, model.joints) for p in identification.validations],
        "effects": [],
        "versions": trajectory_file.package_versions(),
    }


def prediction_summary(prediction: Prediction, rows: Sequence[str]) -> dict[str, Any]:
    """Return the errors of one recording, row by row."""
    signals = prediction.measured.std(axis=0)
    errors = zip(prediction.error(), prediction.error("nominal"), signals, strict=True)
    return {
        "recording": prediction.source,
        "rows": {
            row: {"rmse": float(after), "rmse_nominal": float(before), "signal": float(signal)}
            for row, (after, before, signal) in zip(rows, errors, strict=True)
        },
    }


def is_floating(content: Any) -> bool:
    """Return True if the content of a `model.json` is that of a floating base."""
    return isinstance(content, dict) and content.get("floating_base") is not None


def model_from_document(file: DocumentFile, content: Any) -> FloatingIdentifiedModel:
    """Build the model from the plain values of a `model.json`.

    Args:
        file: The file, for error messages.
        content: Its parsed content.

    Raises:
        UnusableInput: The file breaks a rule of `schemas.model`, or contains an invalid URDF.
    """
    document = file.converted(content, ModelDocument)
    stated = document.floating_base
    assert stated is not None
    robot, drive = load_stated_urdf(
        file,
        document,
        lambda path: floating_base.load(
            robots.load(
                path, joints=document.joints, gravity=document.robot.gravity, require_mass=False
            )
        ),
    )
    for frame in stated.contacts:
        floating_base.require_frame(robot, frame, str(file.path))
    return FloatingIdentifiedModel(
        str(file.path),
        robot,
        drive,
        np.array([entry.value for entry in document.standard_parameters], float),
        np.array([document.coulomb_width[joint] for joint in robot.joints], float),
        Rows(stated.rows),
        tuple(stated.contacts),
        np.array(stated.offsets, float).ravel(),
        np.array(stated.row_band_hz, float),
    )
