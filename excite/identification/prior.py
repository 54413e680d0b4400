"""`excite.prior/1`: what is known of a robot beforehand and should be kept."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import UnusableInput
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..schemas import prior
from ..schemas.document_file import DocumentFile
from ..schemas.model import SCHEMA as MODEL_SCHEMA
from ..schemas.prior import PriorDocument
from . import identified_model


def trusted(path: Path, robot: Robot, parameters: Parameters) -> Mapping[int, float]:
    """Places in ψ -> values to be kept: all inertial parameters, and joint parameters that are stated.

    Of a `model.json`, all parameters are kept.

    Raises:
        UnusableInput: The file is missing, breaks a rule of `schemas.prior` or `schemas.model`, or
            does not fit the robot.
    """
    file = DocumentFile(
        path, "a prior", "correct it", f"{{'schema': '{prior.SCHEMA}', …}} or a model.json"
    )
    content = file.json()
    if file.schema(content, (prior.SCHEMA, MODEL_SCHEMA)) == MODEL_SCHEMA:
        return _of_model(path, robot, parameters)
    document = file.converted(content, PriorDocument)
    if not document.trust_prior:
        raise UnusableInput(
            f'{path}: says "trust_prior": false; leave --prior out where the URDF is a guess'
        )
    known = dict(enumerate(parameters.nominal[: 10 * parameters.bodies].tolist()))
    for joint, values in document.joints.items():
        if joint not in parameters.joints:
            raise file.error(
                f"no joint '{joint}'; there are {', '.join(parameters.joints)}", "joints"
            )
        for kind in parameters.drive:
            value = getattr(values, kind)
            if value is not None:
                known[parameters.block(kind).start + parameters.joints.index(joint)] = float(value)
    return known


def _of_model(path: Path, robot: Robot, parameters: Parameters) -> Mapping[int, float]:
    fitted = identified_model.read(path)
    if fitted.robot.joints != parameters.joints:
        raise UnusableInput(
            f"{path}: is a model of other joints ({', '.join(fitted.robot.joints)}); choose them with --joints"
        )
    if not _built_alike(fitted.robot, robot):
        raise UnusableInput(
            f"{path}: is a model of another robot, whose joints sit elsewhere than in {robot.source}; identify this one"
        )
    if fitted.drive != parameters.drive or len(fitted.psi) != parameters.count:
        raise UnusableInput(
            f"{path}: has {', '.join(fitted.drive) or 'no parameters of drives'}, wanted are {', '.join(parameters.drive) or 'none'}; "
            "identify with the same --parameters and --without"
        )
    return dict(enumerate(fitted.psi.tolist()))


def _built_alike(one: Robot, other: Robot) -> bool:
    """Whether the joints of two robots sit alike in their links, to what a URDF's digits leave."""
    here, there = (
        [place.homogeneous for place in robot.model.jointPlacements] for robot in (one, other)
    )
    return len(here) == len(there) and bool(np.allclose(here, there, atol=1e-6))
