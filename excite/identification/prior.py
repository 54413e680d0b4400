"""Prior file `excite.prior/1`: parameters that are known and kept as they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..schemas import prior
from ..schemas.document_file import DocumentFile
from ..schemas.model import SCHEMA as MODEL_SCHEMA
from ..schemas.prior import PriorDocument
from . import identified_model
from .identified_model import IdentifiedModel

PLACEMENT_TOLERANCE = 1e-6
"""Difference of joint placements in two URDFs that rounding of their numbers explains [m, 1]."""


@dataclass(frozen=True)
class TrustedPrior:
    """Trusted knowledge about a robot, which is kept as it is.

    Attributes:
        parameters: By index in ψ: the value of a standard parameter.
        model: The model that states them, with its effects; None for a prior file.
    """

    parameters: Mapping[int, float] = field(default_factory=dict)
    model: IdentifiedModel | None = None

    @property
    def widths(self) -> FloatArray | None:
        """Widths of Coulomb friction, shape (n,) [rad/s or m/s]; None where no model states them.

        They belong to the friction and to the effects of a model: other ones would change both.
        """
        return None if self.model is None else self.model.widths

    @classmethod
    def of_model(cls, model: IdentifiedModel) -> TrustedPrior:
        """Return all that a model states, its parameters and its effects."""
        return cls(dict(enumerate(model.psi.tolist())), model)


def read_prior(path: str | Path | None, robot: Robot, parameters: Parameters) -> TrustedPrior:
    """Read a prior file or a `model.json`.

    A prior trusts all inertial parameters of the URDF and the stated joint parameters; a
    `model.json` trusts all its parameters and effects.

    Args:
        path: Path of the file; nothing is known if None.
        robot: The robot to identify.
        parameters: Its standard parameters.

    Raises:
        UnusableInput: The file is missing, breaks a rule of `schemas.prior` or `schemas.model`, or
            does not fit the robot.
    """
    if path is None:
        return TrustedPrior()
    path = Path(path)
    file = DocumentFile(
        path, "a prior", "correct it", f"{{'schema': '{prior.SCHEMA}', …}} or a model.json"
    )
    content = file.json()
    if file.schema(content, (prior.SCHEMA, MODEL_SCHEMA)) == MODEL_SCHEMA:
        return TrustedPrior.of_model(_model(path, robot, parameters))
    document = file.converted(content, PriorDocument)
    if not document.trust_prior:
        raise UnusableInput(
            f'{path}: "trust_prior" is false; leave --prior out where the URDF is only a guess'
        )
    known = dict(enumerate(parameters.nominal[: 10 * parameters.bodies].tolist()))
    for joint, values in document.joints.items():
        if joint not in parameters.joints:
            raise file.error(
                f"no joint '{joint}'; the joints are {', '.join(parameters.joints)}", "joints"
            )
        for kind in parameters.drive:
            value = getattr(values, kind)
            if value is not None:
                known[parameters.block(kind).start + parameters.joints.index(joint)] = float(value)
    return TrustedPrior(known)


def _model(path: Path, robot: Robot, parameters: Parameters) -> IdentifiedModel:
    """Read the `model.json` of the same robot."""
    fitted = identified_model.read_model(path)
    if fitted.robot.joints != parameters.joints:
        raise UnusableInput(
            f"{path}: is a model of other joints ({', '.join(fitted.robot.joints)}); choose them "
            "with --joints"
        )
    if not _have_equal_placements(fitted.robot, robot):
        raise UnusableInput(
            f"{path}: is a model of another robot, as its joint placements differ from those of "
            f"{robot.source}; identify this robot"
        )
    if fitted.drive != parameters.drive or len(fitted.psi) != parameters.count:
        raise UnusableInput(
            f"{path}: has the joint parameters {', '.join(fitted.drive) or 'none'}, expected "
            f"{', '.join(parameters.drive) or 'none'}; identify with the same --parameters and "
            "--without"
        )
    return fitted


def _have_equal_placements(first: Robot, second: Robot) -> bool:
    """True if the joint placements of two robots agree within PLACEMENT_TOLERANCE."""
    a, b = (
        [placement.homogeneous for placement in robot.model.jointPlacements]
        for robot in (first, second)
    )
    return len(a) == len(b) and bool(np.allclose(a, b, atol=PLACEMENT_TOLERANCE))
