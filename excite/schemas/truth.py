"""The truth of a simulated recording, schema excite.truth/1, from which `--like` simulates."""

from __future__ import annotations

from typing import Literal

import msgspec

from .. import physical_ranges as ranges
from ..physical_ranges import Range
from .quantities import InertialParameter, Name, Quantity, Text, shown

SCHEMA = "excite.truth/1"


class SimulationRate(Quantity):
    """Sampling rate of the simulator, whose time step is 0.5 to 2 ms."""

    accepted = Range(125.0, 1000.0, "Hz")


class RelativeNoise(Quantity):
    """A standard deviation of torque over the torque limit, or a relative error of the URDF."""

    accepted = Range(0.0, 10.0, "1")


class Jitter(Quantity):
    """A standard deviation of the times of sampling."""

    accepted = Range(0.0, 1.0, "s")


class Resolution(Quantity):
    """The step of an encoder."""

    accepted = Range(0.0, 1.0, "rad or m")


class Gain(Quantity):
    """A gain of the simulated controller, or its bandwidth."""

    accepted = Range(0.0, 1e4, "1/s or rad/s")


class ForwardShare(Quantity):
    """Share of the model's torque that the simulated controller feeds forward."""

    accepted = Range(0.0, 10.0, "1")


class Lag(Quantity):
    """The time constant of the current loop."""

    accepted = Range(1e-6, 10.0, "s")


class Corner(Quantity):
    """The corner frequency of coloured noise; it lies below half the rate."""

    accepted = Range(1e-3, 500.0, "Hz")


class EffectValue(Quantity):
    """A parameter of a hidden effect, whose unit the document states."""

    accepted = Range(-1e12, 1e12, "1")


class ControlDocument(msgspec.Struct, forbid_unknown_fields=True):
    """The controller of the simulated robot."""

    position: Gain
    speed: Gain
    integral: Gain
    forward: ForwardShare
    lag: Lag
    step: Resolution


class SettingDocument(msgspec.Struct, forbid_unknown_fields=True):
    """Settings of the simulated robot and its measurement."""

    seed: int
    rate: SimulationRate
    noise: RelativeNoise
    colour: Corner | None
    jitter: Jitter
    encoder: Resolution
    model_error: RelativeNoise
    control: ControlDocument

    def __post_init__(self) -> None:
        if not ranges.SEED.accepts(self.seed):
            raise ValueError(f"seed: {shown(self.seed)} should be {ranges.SEED}")
        if self.colour is not None and not self.colour < 0.5 * self.rate:
            raise ValueError(
                f"colour: {self.colour:g} Hz should be below half the rate, {0.5 * self.rate:g} Hz"
            )


class EffectParameterDocument(msgspec.Struct):
    """A parameter of an effect."""

    value: EffectValue
    unit: Text = Text("")


class HiddenEffectDocument(msgspec.Struct):
    """A hidden effect.

    Attributes:
        effect: Name of the effect.
        joint: Joint on which it acts.
        family: Family of similar effects.
        parameters: Parameters that the catalogue names.
        details: Further parameters.
        source: Joint from which a coupling comes.
    """

    effect: Name
    joint: Name | None
    family: Name
    parameters: dict[str, EffectParameterDocument]
    details: dict[str, EffectParameterDocument] = {}
    source: Name | None = msgspec.field(name="from", default=None)


class TruthDocument(msgspec.Struct):
    """The keys that `--like` reads."""

    schema: Literal["excite.truth/1"]
    joints: list[Name]
    bodies: dict[str, list[InertialParameter]]
    setting: SettingDocument
    effects: list[HiddenEffectDocument]

    def __post_init__(self) -> None:
        for link, values in self.bodies.items():
            if len(values) != 10:
                raise ValueError(f"bodies.{shown(link)}: should hold 10 values, not {len(values)}")
