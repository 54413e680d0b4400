"""`excite.prior/1`: what is known of a robot beforehand and should be kept."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import artefact
from ..errors import UnusableInput
from ..parameters import DRIVE, Parameters
from . import model

SCHEMA = "excite.prior/1"


def trusted(path: Path, parameters: Parameters) -> Mapping[int, float]:
    """Places in ψ -> values that are right as they stand: all inertial parameters and what is stated of the joints.

    A `model.json` serves too: all that it says. Raises UnusableInput for a file that cannot be read or does not fit the robot.
    """
    stated = artefact.stated(path, (SCHEMA, model.SCHEMA), "prior", f"{{'schema': '{SCHEMA}', …}} or a model.json")
    if stated["schema"] == model.SCHEMA:
        return _of_model(path, parameters)
    if stated.get("trust_prior") is not True:
        raise UnusableInput(f'{path}: says "trust_prior": {stated.get("trust_prior")!r}; leave --prior out where the URDF is a guess')
    known = dict(enumerate(parameters.nominal[: 10 * parameters.bodies].tolist()))
    for joint, values in _joints(path, stated, parameters).items():
        for kind, value in values.items():
            known[parameters.block(kind).start + parameters.joints.index(joint)] = value
    return known


def _joints(path: Path, stated: Mapping[str, Any], parameters: Parameters) -> dict[str, dict[str, float]]:
    out: dict[str, dict[str, float]] = {}
    for joint, values in stated.get("joints", {}).items():
        if joint not in parameters.joints:
            raise UnusableInput(f"{path}: no joint '{joint}'; there are {', '.join(parameters.joints)}")
        for kind, value in values.items():
            if kind not in DRIVE:
                raise UnusableInput(f"{path}: joint '{joint}': no parameter '{kind}'; there are {', '.join(DRIVE)}")
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise UnusableInput(f"{path}: joint '{joint}', {kind}: {value!r} is no number; correct it")
            if kind in parameters.drive:
                out.setdefault(joint, {})[kind] = float(value)
    return out


def _of_model(path: Path, parameters: Parameters) -> Mapping[int, float]:
    fitted = model.read(path)
    if fitted.robot.joints != parameters.joints or fitted.drive != parameters.drive or len(fitted.psi) != parameters.count:
        raise UnusableInput(f"{path}: is a model of other joints ({', '.join(fitted.robot.joints)}); choose them with --joints")
    return dict(enumerate(fitted.psi.tolist()))
