"""`excite.prior/1`: what is known of a robot beforehand and should be kept."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ExciteWarning, UnusableInput
from ..robot.inertial_parameters import DRIVE, Parameters
from ..robot.robot import Robot
from ..trajectory import trajectory_file
from . import identified_model

SCHEMA = "excite.prior/1"
KEYS = ("schema", "trust_prior", "joints")


def trusted(path: Path, robot: Robot, parameters: Parameters) -> Mapping[int, float]:
    """Places in ψ -> values that are right as they stand: all inertial parameters and what is stated of the joints.

    A `model.json` serves too: all that it says. Raises UnusableInput for a file that cannot be read or does not fit the robot.
    """
    stated = trajectory_file.stated(
        path,
        (SCHEMA, identified_model.SCHEMA),
        "prior",
        f"{{'schema': '{SCHEMA}', …}} or a model.json",
    )
    if stated["schema"] == identified_model.SCHEMA:
        return _of_model(path, robot, parameters)
    if stated.get("trust_prior") is not True:
        raise UnusableInput(
            f'{path}: says "trust_prior": {stated.get("trust_prior")!r}; leave --prior out where the URDF is a guess'
        )
    if unknown := set(stated) - {*KEYS, "notes"}:
        warnings.warn(
            f"{path}: '{min(unknown)}' is no key of a prior, which has {', '.join(KEYS)}; ignored",
            ExciteWarning,
            stacklevel=2,
        )
    known = dict(enumerate(parameters.nominal[: 10 * parameters.bodies].tolist()))
    for joint, values in _joints(path, stated, parameters).items():
        for kind, value in values.items():
            known[parameters.block(kind).start + parameters.joints.index(joint)] = value
    return known


def _joints(
    path: Path, stated: Mapping[str, Any], parameters: Parameters
) -> dict[str, dict[str, float]]:
    out: dict[str, dict[str, float]] = {}
    joints = stated.get("joints", {})
    if not isinstance(joints, dict) or not all(
        isinstance(values, dict) for values in joints.values()
    ):
        raise UnusableInput(
            f'{path}: "joints" should be {{"<joint>": {{"coulomb": …, "viscous": …}}}}; correct it'
        )
    for joint, values in joints.items():
        if joint not in parameters.joints:
            raise UnusableInput(
                f"{path}: no joint '{joint}'; there are {', '.join(parameters.joints)}"
            )
        for kind, value in values.items():
            if kind not in DRIVE:
                raise UnusableInput(
                    f"{path}: joint '{joint}': no parameter '{kind}'; there are {', '.join(DRIVE)}"
                )
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float)
                or not math.isfinite(value)
            ):
                raise UnusableInput(
                    f"{path}: joint '{joint}', {kind}: {value!r} is no number; correct it"
                )
            if kind in parameters.drive:
                out.setdefault(joint, {})[kind] = float(value)
    return out


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
