"""`model.json`, schema excite.model/1: an identified robot."""

from __future__ import annotations

from typing import Literal

import msgspec

from .effects import EffectDocument
from .quantities import (
    Band,
    CoulombFriction,
    FilePath,
    FrictionWidth,
    Gravity,
    InertialParameter,
    Mass,
    Name,
    RotorInertia,
    Sha256,
    Text,
    Torque,
    ViscousFriction,
    shown,
)
from .trajectory import Drive

SCHEMA = "excite.model/1"
LINK_PARAMETERS = 10
"""Inertial parameters of a link: mass, first moments, elements of the inertia tensor."""
DRIVE_RANGES = {
    "rotor_inertia": RotorInertia.accepted,
    "viscous": ViscousFriction.accepted,
    "coulomb": CoulombFriction.accepted,
    "offset": Torque.accepted,
}


class ModelRobotDocument(msgspec.Struct):
    """The identified robot; locked joints and the payload are part of the model's URDF."""

    name: Name
    source: FilePath
    sha256: Sha256
    gravity: tuple[Gravity, Gravity, Gravity]


class ParameterDocument(msgspec.Struct):
    """A standard parameter: its name, its link or joint, and its identified value."""

    name: Text
    value: InertialParameter
    of: Text = Text("")


class FloatingBaseDocument(msgspec.Struct):
    """The part of a model whose base moves freely.

    Attributes:
        base_link: Name of the link of the base.
        rows: Rows that were fitted.
        contacts: Frames of the contact wrenches.
        offsets: Offsets of their sensors, fx … mz of each contact [N, N m].
        row_band_hz: Cutoff frequency of each row [Hz].
    """

    base_link: Name
    rows: Literal["base", "joints", "both"]
    contacts: list[Name]
    offsets: list[tuple[Torque, Torque, Torque, Torque, Torque, Torque]]
    row_band_hz: list[Band]


class ModelDocument(msgspec.Struct):
    """The keys that a prediction reads.

    Attributes:
        urdf: Description of the identified robot.
        joints: Names of the joints.
        links: Names of the links that they move.
        drive: Kinds of joint parameters.
        standard_parameters: Ten of each link, then those of each kind in `drive`, joint by joint.
        coulomb_width: Velocity over which Coulomb friction changes sign [rad/s or m/s].
        band_hz: Cutoff frequency of the identification [Hz].
        effects: Effects beyond the base model.
        floating_base: Present if the base moves freely: `links` then contains the base, and only
            links with a mass.
    """

    schema: Literal["excite.model/1"]
    robot: ModelRobotDocument
    urdf: str
    joints: list[Name]
    links: list[Name]
    drive: list[Drive]
    standard_parameters: list[ParameterDocument]
    coulomb_width: dict[str, FrictionWidth]
    band_hz: Band
    effects: list[EffectDocument]
    floating_base: FloatingBaseDocument | None = None

    def __post_init__(self) -> None:
        if not self.joints or len(set(self.joints)) < len(self.joints):
            raise ValueError("joints: should hold the name of each joint once")
        for joint in self.joints:
            if joint not in self.coulomb_width:
                raise ValueError(f"coulomb_width: has no entry for the joint {shown(joint)}")
        _check_parameters(self)
        if self.floating_base is not None:
            _check_floating_base(self.floating_base, len(self.joints))
        for i, effect in enumerate(self.effects):
            for key, named in (("joint", effect.joint), ("from", effect.other)):
                if named is not None and named not in self.joints:
                    raise ValueError(f"effects[{i}].{key}: {shown(named)} is none of the joints")
            if effect.values.get("link", 0.0) >= len(self.links):
                raise ValueError(
                    f"effects[{i}].values.link: {effect.values['link']:g} is the number of no link"
                )


def _check_floating_base(document: FloatingBaseDocument, joints: int) -> None:
    """Raise ValueError unless offsets and bands fit the contacts and rows."""
    if len(document.offsets) not in (0, len(document.contacts)):
        raise ValueError("floating_base.offsets: should hold six values of each contact, or none")
    count = {"base": 6, "joints": joints, "both": 6 + joints}[document.rows]
    if len(document.row_band_hz) != count:
        raise ValueError(f"floating_base.row_band_hz: should hold {count} values, one of each row")


def _check_parameters(document: ModelDocument) -> None:
    """Raise ValueError unless the standard parameters fit the links and joints.

    Masses, friction coefficients and rotor inertias must not be negative.
    """
    if len(set(document.drive)) < len(document.drive):
        raise ValueError("drive: a parameter is named twice")
    edge, n = LINK_PARAMETERS * len(document.links), len(document.joints)
    count, stated = edge + n * len(document.drive), document.standard_parameters
    if len(stated) != count:
        expected = f"should hold {count} values for these links and joints"
        raise ValueError(f"standard_parameters: {expected}, not {len(stated)}")
    accepted = {i: Mass.accepted for i in range(0, edge, LINK_PARAMETERS)}
    for k, kind in enumerate(document.drive):
        accepted |= dict.fromkeys(range(edge + k * n, edge + (k + 1) * n), DRIVE_RANGES[kind])
    for i, allowed in accepted.items():
        if not allowed.accepts(stated[i].value):
            raise ValueError(
                f"standard_parameters[{i}].value: {shown(stated[i].value)} should be {allowed}"
            )
