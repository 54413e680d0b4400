"""`model.json`, schema excite.model/1: an identified robot."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from .effects import EffectDocument
from .quantities import (
    Band,
    CommandDelay,
    CoulombFriction,
    Covariance,
    FilePath,
    FrictionWidth,
    Gravity,
    InertialParameter,
    Mass,
    Name,
    Position,
    PositionError,
    PositionGain,
    RotorInertia,
    Sha256,
    Statistic,
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


class LockedJointDocument(msgspec.Struct):
    """A joint that the model's URDF holds as a fixed one: where it stood, and the share of the
    mass of the robot that it carries."""

    position: Position
    unit: Literal["rad", "m"]
    share: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 1.0


class ModelRobotDocument(msgspec.Struct):
    """The identified robot; locked joints and the payload are part of the model's URDF.

    Attributes:
        fixed: The locked joints, with which recordings are compared.
    """

    name: Name
    source: FilePath
    sha256: Sha256
    gravity: tuple[Gravity, Gravity, Gravity]
    fixed: dict[str, LockedJointDocument] = {}


class ParameterDocument(msgspec.Struct):
    """A standard parameter: its name, its link or joint, and its identified value.

    Attributes:
        std: Standard deviation of the value; null if unknown.
        unit: Its unit.
    """

    name: Text
    value: InertialParameter
    of: Text = Text("")
    std: Statistic | None = None
    unit: Text | None = None


class CovarianceDocument(msgspec.Struct):
    """Covariance of base parameters, in SI units.

    Attributes:
        parameters: Names of the standard parameters that stand for them: their columns of the
            regressor are those of the base parameters.
        matrix: The covariance.
    """

    parameters: list[Text]
    matrix: list[list[Covariance]]


class MassDocument(msgspec.Struct):
    """Mass of a link, its standard deviation [kg], and the share that the data decide [1]."""

    value: Statistic | None
    std: Statistic | None
    data_share: Statistic | None


class LinkEstimateDocument(msgspec.Struct):
    """A link and its mass."""

    name: Text
    mass: MassDocument


class TorqueErrorDocument(msgspec.Struct):
    """RMS torque error of a joint [N m or N]."""

    rmse: Statistic | None = None


class PredictionDocument(msgspec.Struct):
    """Torque errors along one recording by joint."""

    recording: Text = Text("")
    joints: dict[str, TorqueErrorDocument] = {}


class PositionErrorDocument(msgspec.Struct):
    """RMS position error of a joint [rad or m]."""

    position_rmse: Statistic | None


class ReplayDocument(msgspec.Struct):
    """Position errors along one recording by joint."""

    recording: Text = Text("")
    joints: dict[str, PositionErrorDocument] = {}


class ScaleDocument(msgspec.Struct):
    """Statement of what fixes the scale of a model that was identified without torque."""

    words: Text = Text("")


class PositionLoopDocument(msgspec.Struct):
    """Position loop of a servo: u = K_p clip(e, ±error_limit) + K_d ė, e = q_ref(t − delay) − q.

    Attributes:
        proportional: K_p of recordings that state `position_gain` [N m/rad].
        derivative: K_d of the same [N m s/rad].
        delay: Time by which the command acts late [s].
        error_limit: Position error at which the motor saturates; null without [rad or m].
        position_gain: Gain in the servo's own unit to which K_p and K_d belong.
    """

    proportional: PositionGain
    derivative: ViscousFriction
    delay: CommandDelay
    error_limit: PositionError | None = None
    position_gain: PositionGain = PositionGain(1.0)


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
    """The keys that predictions and exports read.

    Attributes:
        urdf: Description of the identified robot.
        joints: Names of the joints.
        links: Names of the links that they move.
        drive: Kinds of joint parameters.
        standard_parameters: Ten of each link, then those of each kind in `drive`, joint by joint.
        base_covariance: Covariance of the base parameters.
        coulomb_width: Velocity over which Coulomb friction changes sign [rad/s or m/s].
        band_hz: Cutoff frequency of the identification [Hz].
        effects: Effects beyond the base model.
        position_loop: Position loop of each joint, where it was identified.
        floating_base: Present if the base moves freely: `links` then contains the base, and only
            links with a mass.
        recordings: Paths of the recordings that the model was fitted to.
        recording_columns: Standard names of columns -> differing names in the file, of fitted and
            held-out recordings that were read with `--columns`.
        link_estimates: Masses of the links.
        fit: Torque errors along the fitted recordings.
        validation: Torque errors along the held-out recordings.
        position_fit: Position errors along the fitted recordings, of a model without torque.
        position_validation: The same along the held-out recordings.
        scale: Present if no torque was recorded.
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
    base_covariance: CovarianceDocument | None = None
    position_loop: dict[str, PositionLoopDocument] = {}
    floating_base: FloatingBaseDocument | None = None
    recordings: list[Text] = []
    recording_columns: dict[str, dict[str, str]] = {}
    link_estimates: list[LinkEstimateDocument] | None = None
    fit: list[PredictionDocument] | None = None
    validation: list[PredictionDocument] | None = None
    position_fit: list[ReplayDocument] | None = None
    position_validation: list[ReplayDocument] | None = None
    scale: ScaleDocument | None = None

    def __post_init__(self) -> None:
        if not self.joints or len(set(self.joints)) < len(self.joints):
            raise ValueError("joints: should hold the name of each joint once")
        for joint in self.joints:
            if joint not in self.coulomb_width:
                raise ValueError(f"coulomb_width: has no entry for the joint {shown(joint)}")
        _check_parameters(self)
        if self.position_loop and set(self.position_loop) != set(self.joints):
            raise ValueError("position_loop: should have one entry for each of the joints, or none")
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
