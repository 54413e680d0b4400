"""`model.json` of a robot that was identified without torque."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..recordings import Recording
from ..schemas.model import SCHEMA
from ..trajectory import trajectory_file
from .identified_model import joint_gamma, provenance, robot_entry, standard_parameter_table
from .link_estimates import link_estimates
from .servo_identification import PositionReplay, ServoIdentification
from .urdf_export import identified_urdf

BAND_HZ = 20.0
"""Cutoff frequency of the motion in predictions of torque [Hz]."""
LOOP_KEYS = ("proportional", "derivative", "delay")
"""Parameters of a position loop."""


def servo_model_document(
    identification: ServoIdentification, recordings: Sequence[Recording]
) -> dict[str, Any]:
    """Return the content of `model.json`.

    Args:
        identification: The result.
        recordings: The recordings that the model was fitted to.
    """
    model, prior = identification.model, identification.prior
    robot, parameters = model.robot, model.parameters
    links = link_estimates(parameters, identification.posterior, prior)
    origin = provenance(robot, recordings, links)
    origin.append("No torque was recorded:")
    origin.append(identification.scale_statement)
    rate = min(recording.rate for recording in recordings)
    edge = 10 * parameters.bodies
    return {
        "schema": SCHEMA,
        "robot": robot_entry(robot),
        "urdf": identified_urdf(robot, parameters, identification.psi, model.widths, origin),
        "link_estimates": [link.document() for link in links],
        "joints": list(robot.joints),
        "links": list(parameters.links),
        "drive": list(parameters.drive),
        "standard_parameters": standard_parameter_table(
            model.parameters, model.robot, identification.posterior
        ),
        "coulomb_width": dict(zip(robot.joints, model.widths.tolist(), strict=True)),
        "identified_from": "position",
        "scale": {
            "fixed_by": "description" if identification.is_ratio else "gains",
            "words": identification.scale_statement,
        },
        "position_loop": position_loop_table(identification),
        "over_gain": _ratio_table(identification),
        "over_gain_std": {
            joint: dict(
                zip(parameters.drive, identification.ratio_deviation[:, j].tolist(), strict=True)
            )
            for j, joint in enumerate(robot.joints)
        },
        "prior": {
            "distance": identification.options.distance.value,
            "gamma": {"bodies": prior.inertial_weight, **joint_gamma(parameters, prior)},
            "chosen_by": "evidence" if identification.options.gamma is None else "given",
            "scales": dict(zip(parameters.names[edge:], prior.joint_scales.tolist(), strict=True)),
        },
        "band_hz": min(BAND_HZ, 0.4 * rate),
        "recordings": [recording.source for recording in recordings],
        "position_fit": [_replay_entry(r, robot.joints) for r in identification.fits],
        "position_validation": [_replay_entry(r, robot.joints) for r in identification.validations],
        "effects": [],
        "versions": trajectory_file.package_versions(),
    }


def position_loop_table(identification: ServoIdentification) -> dict[str, dict[str, Any]]:
    """Return gains and delay of each joint, with standard deviations; null where stated.

    Args:
        identification: The result.
    """
    loop, deviation = identification.loop, identification.loop_deviation
    out = {}
    for j, joint in enumerate(identification.model.robot.joints):
        limit = float(identification.error_limit[j])
        values = {key: float(getattr(loop, key)[j]) for key in LOOP_KEYS}
        std = {key: float(deviation[k, j]) or None for k, key in enumerate(LOOP_KEYS)}
        out[joint] = {
            **values,
            "std": std,
            "error_limit": limit if np.isfinite(limit) else None,
            "position_gain": float(identification.reference_gain[j]),
        }
    return out


def _ratio_table(identification: ServoIdentification) -> dict[str, dict[str, float]]:
    """Joint parameters over K_p: what positions alone determine."""
    parameters, gain = identification.model.parameters, identification.loop.proportional
    return {
        joint: {
            kind: float(identification.psi[parameters.block(kind)][j] / gain[j])
            for kind in parameters.drive
        }
        for j, joint in enumerate(identification.model.robot.joints)
    }


def _replay_entry(replay: PositionReplay, joints: Sequence[str]) -> dict[str, Any]:
    """Position errors of one recording, joint by joint."""
    errors = replay.error(), replay.error("command")
    return {
        "recording": replay.source,
        "joints": {
            joint: {"position_rmse": float(errors[0][j]), "tracking_rmse": float(errors[1][j])}
            for j, joint in enumerate(joints)
        },
    }
