"""The effects in a model: their nonlinear parameters with ranges, and numbers of coefficients.

The forms are those of the catalogue in `excite.effects`; tests/test_document_schemas.py compares
every candidate model of the catalogue with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from .. import physical_ranges as ranges
from ..physical_ranges import Range
from .quantities import ClockTime, Coefficient, Name, Text, shown

Values = Mapping[str, float]
FLAG = Range(1.0, 1.0, "1")
"""Value of a key whose presence selects a variant."""
SWITCH = Range(0.0, 1.0, "1")
COUNT = Range(1.0, 100.0, "1")
POSITIVE = Range(1e-12, 1e9, "1")
EXPONENT = Range(1e-2, 1e2, "1")
SPATIAL_FREQUENCY = Range(1e-6, 1e6, "1/rad or 1/m")
SECONDS = Range(1e-9, 1e6, "s")
CLOCK = Range(-1e12, 1e12, "s")
FREQUENCY = Range(1e-3, 1e5, "Hz")
FRICTION_SPEED = Range(1e-12, ranges.VELOCITY.upper, "rad/s or m/s")
POSITION = ranges.POSITION
TORQUE = Range(1e-12, ranges.EFFORT.upper, "N m or N")
COULOMB = Range(0.0, ranges.COULOMB_FRICTION.upper, "N m or N")
VISCOUS = Range(0.0, ranges.VISCOUS_FRICTION.upper, "N m s/rad or N s/m")
STIFFNESS = Range(1e-6, 1e12, "N m/rad or N/m")
DAMPING_RATIO = Range(1e-6, 10.0, "1")
WAVE_MULTIPLES = {"twice": FLAG, "thrice": FLAG}
INTEGERS = ("waves", "knots", "elements", "way", "form", "link", "count", "poles", "passes")
"""Values that are integers."""
BASE_MODES = ((0, 1), (3, 4), (5,), (3,), (4,))
"""Coordinates of a base that slides horizontally, tilts about both horizontal axes, turns about the
vertical, or tilts about one axis."""
ENDS = {"low": POSITION, "high": POSITION}
"""Positions between which a spring was fitted, and beyond which its torque is that of the end."""
COLUMNS_OF_FORMS = (1, 2, 2, 3, 4)
"""Number of columns of each form of a spring."""


@dataclass(frozen=True)
class EffectForm:
    """One form of an effect.

    Attributes:
        needed: Required nonlinear parameters, with their ranges.
        optional: Optional nonlinear parameters.
        coefficients: Function from its values to its number of coefficients.
        joint: True if it needs a joint, False if it has none, None if both are allowed.
        other: True if it comes from another joint.
        interval: True if it needs an interval of time and a recording, None if it may have one.
    """

    needed: Mapping[str, Range] = field(default_factory=dict)
    optional: Mapping[str, Range] = field(default_factory=dict)
    coefficients: Callable[[Values], int] = lambda values: 1
    joint: bool | None = True
    other: bool = False
    interval: bool | None = False


def _waves(values: Values) -> int:
    """Number of coefficients: a cosine and a sine of the order and of each stated multiple."""
    return 2 * (1 + len(WAVE_MULTIPLES.keys() & values.keys()))


STRIBECK_CURVES = 8
"""Curves of friction that falls with speed, over a joint's largest speed."""
VISCOUS_CURVES = 8
"""Curves of friction that is not linear in speed, over a joint's largest speed."""
HYSTERESIS_ELEMENTS = 20
"""Maxwell-slip elements of presliding hysteresis."""
UNEQUAL_ELEMENTS = 2
"""Maxwell-slip elements whose branches may be unequal."""
REACH = Range(1e-12, 1e2, "rad or m")
BUILD_UP = {"reach": REACH, "last_reach": REACH} | {
    f"share_{i}": SWITCH for i in range(HYSTERESIS_ELEMENTS)
}
"""How a dry friction builds up after a reversal: shares of Maxwell-slip elements."""
FORMS: Mapping[str, tuple[EffectForm, ...]] = {
    "torque_offset": (EffectForm(),),
    "torque_gain": (EffectForm({"measured": FLAG}),),
    "torque_saturation": (
        EffectForm({"power": EXPONENT, "largest": TORQUE, "measured": FLAG}),
        EffectForm({"level": TORQUE, "bend": EXPONENT, "largest": TORQUE, "measured": FLAG}),
    ),
    "asymmetric_viscous": (EffectForm(),),
    "stribeck": (
        EffectForm({"top_speed": FRICTION_SPEED}, coefficients=lambda values: STRIBECK_CURVES),
        EffectForm(
            {"top_speed": FRICTION_SPEED, **BUILD_UP},
            coefficients=lambda values: STRIBECK_CURVES,
        ),
    ),
    "nonlinear_viscous": (
        EffectForm(
            {"top_speed": FRICTION_SPEED},
            {"line_share": SWITCH},
            coefficients=lambda values: VISCOUS_CURVES,
        ),
    ),
    "drag": (EffectForm(),),
    "load_friction": (
        EffectForm({"dense": FLAG, "scale": TORQUE}, coefficients=lambda values: 4),
        EffectForm({"dense": FLAG, "scale": TORQUE, **BUILD_UP}, coefficients=lambda values: 4),
    ),
    "position_friction": (
        EffectForm(
            {"order": SPATIAL_FREQUENCY, "waves": COUNT, "low": POSITION, "high": POSITION},
            coefficients=lambda values: 2 * int(values["waves"]),
        ),
    ),
    "friction": (EffectForm(coefficients=lambda values: 2),),
    "hysteresis": (
        EffectForm(
            BUILD_UP, coefficients=lambda values: HYSTERESIS_ELEMENTS + UNEQUAL_ELEMENTS + 1
        ),
    ),
    "thermal_drift": (
        EffectForm(
            {"time_constant": SECONDS, "coulomb": COULOMB, "viscous": VISCOUS},
            {"power": POSITIVE, "origin": CLOCK},
        ),
        EffectForm(
            {"reference": Range(-273.15, 1e4, "°C"), "coulomb": COULOMB, "viscous": VISCOUS}
        ),
    ),
    "elasticity": (
        EffectForm({"stiffness": STIFFNESS, "damping": DAMPING_RATIO, "rests": SWITCH}),
    ),
    "backlash": (
        EffectForm({"width": Range(1e-12, 1e2, "rad or m"), "hold": Range(0.0, 1e3, "Hz")}),
    ),
    "spring": (
        EffectForm(
            {"form": Range(0.0, 4.0, "1")},
            ENDS,
            coefficients=lambda values: COLUMNS_OF_FORMS[int(values["form"])],
        ),
        EffectForm(
            {"order": SPATIAL_FREQUENCY, "about": POSITION}, ENDS, coefficients=lambda values: 3
        ),
        EffectForm({"bend": POSITION}, ENDS, coefficients=lambda values: 2),
        EffectForm(
            {"waves": COUNT, "low": POSITION, "high": POSITION},
            coefficients=lambda values: int(values["waves"]),
        ),
    ),
    "coupling": (
        EffectForm({"ratio": Range(-1e6, 1e6, "1")}, coefficients=lambda values: 3, other=True),
        EffectForm(
            {"ratio": Range(-1e6, 1e6, "1"), "light": FLAG},
            coefficients=lambda values: 2,
            other=True,
        ),
    ),
    "torque_ripple": (
        EffectForm({"order": SPATIAL_FREQUENCY, "load": TORQUE}, coefficients=lambda values: 4),
    ),
    "encoder_error": (EffectForm({"order": SPATIAL_FREQUENCY}, WAVE_MULTIPLES, _waves),),
    "delay": (
        EffectForm({"measured": FLAG}, joint=None),
        EffectForm(
            {
                "measured": FLAG,
                "hertz": FREQUENCY,
                "poles": Range(1.0, 4.0, "1"),
                "passes": Range(1.0, 2.0, "1"),
            },
            joint=False,
        ),
        EffectForm({"measured": FLAG, "seconds": Range(1e-9, 10.0, "s")}),
        EffectForm({"measured": FLAG, "lagging": FLAG}),
    ),
    "payload": (
        EffectForm(
            {"link": Range(0.0, 1000.0, "1"), "count": Range(4.0, 10.0, "1")},
            coefficients=lambda values: int(values["count"]),
            interval=None,
        ),
    ),
    "gravity_tilt": (
        EffectForm(
            {"large": SWITCH}, coefficients=lambda values: 2 + (values["large"] > 0.0), joint=False
        ),
    ),
    "rotor_inertia": (EffectForm(),),
    "kinematic_error": (
        EffectForm({"angle": SWITCH, "whole": SWITCH}, coefficients=lambda values: 3),
    ),
    "base_compliance": (
        EffectForm(
            {
                "frequency": FREQUENCY,
                "damping": DAMPING_RATIO,
                "way": Range(0.0, len(BASE_MODES) - 1.0, "1"),
                "stand": POSITIVE,
                "apart": Range(1e-2, 1e2, "1"),
            },
            coefficients=lambda values: len(BASE_MODES[int(values["way"])]),
            joint=False,
        ),
    ),
    "contact": (
        EffectForm(
            {"swells": SWITCH, "knots": Range(0.0, 1000.0, "1")},
            coefficients=lambda values: 3 * max(int(values["knots"]), 1),
            interval=True,
        ),
    ),
}
"""The forms of every effect of the catalogue, by its name."""


CONFUSABLE_PAIRS = (
    ("nonlinear_viscous", "drag"),
    ("load_friction", "position_friction"),
    ("hysteresis", "delay"),
    ("stribeck", "drag"),
    ("stribeck", "hysteresis"),
    ("torque_gain", "torque_saturation"),
    ("elasticity", "delay"),
    ("torque_ripple", "encoder_error"),
    ("stribeck", "nonlinear_viscous"),
    ("load_friction", "torque_saturation"),
    ("thermal_drift", "asymmetric_viscous"),
)
"""Effects that one recording often cannot tell apart."""
MIN_SEVERITY = 0.3
"""Smallest RMS torque of an effect beyond the base model and all others, over the noise [1]."""
FORM_POSITION_WAVES = 4
"""Half waves of the form error of an effect over the range of its joint: it is smooth [1]."""
FORM_SPEED_WAVES = 2
"""Half waves of this error over the range of speeds [1]."""
FORM_ERROR_STD = 0.15
"""Prior standard deviation η of each of its factors [1]: the least form error of load friction,
ripple and hysteresis of real gears. A term of the model, not a threshold."""

_WORDS = {
    "asymmetric_viscous": "viscous friction that differs by direction",
    "base_parameters": "base parameters fitted jointly",
    "drag": "drag (square of speed)",
    "friction": "Coulomb and viscous friction",
    "hysteresis": "presliding hysteresis",
    "nonlinear_viscous": "nonlinear viscous friction",
    "position_friction": "friction that depends on position",
    "recording_filter": "filter of the recorded torque",
    "stribeck": "Stribeck friction",
    "torque_gain": "torque scale error",
}


def effect_words(effect: str) -> str:
    """Return the name of an effect, or of another part of a torque budget, in a sentence."""
    return _WORDS.get(effect, effect.replace("_", " "))


def is_recording_filter(values: Values) -> bool:
    """Tell whether a "delay" with these values is a filter of the recorded torque."""
    return "hertz" in values


class EffectDocument(msgspec.Struct):
    """An effect in a model: a candidate model of the catalogue with its coefficients."""

    effect: Name
    joint: Name | None
    other: Name | None = msgspec.field(name="from")
    values: dict[str, float]
    coefficients: list[Coefficient]
    time: tuple[ClockTime, ClockTime] | None
    recording: Text | None

    def __post_init__(self) -> None:
        if self.effect not in FORMS:
            raise ValueError(f"effect: this version has no effect {shown(self.effect)}")
        form = _form(self.effect, self.values)
        _check_values(self.values, form)
        needed = form.coefficients(self.values)
        if len(self.coefficients) != needed:
            count = len(self.coefficients)
            raise ValueError(f"coefficients: '{self.effect}' should have {needed}, not {count}")
        if form.joint is not None and form.joint != (self.joint is not None):
            expected = "needs a joint" if form.joint else "has no joint"
            raise ValueError(f"joint: '{self.effect}' {expected}, not {shown(self.joint)}")
        if form.other != (self.other is not None) or (form.other and self.other == self.joint):
            expected = "comes from another joint" if form.other else "has none"
            raise ValueError(f"from: '{self.effect}' {expected}, not {shown(self.other)}")
        if form.interval is not None and form.interval != (self.time is not None):
            expected = "needs an interval" if form.interval else "has no interval"
            raise ValueError(f"time: '{self.effect}' {expected}, not {shown(self.time)}")
        if self.time is not None and not (self.time[0] < self.time[1] and self.recording):
            raise ValueError(
                "time: should be [start, end] with start < end, of a recording that is named"
            )

    def joint_index(self, joints: Sequence[str]) -> int | slice:
        """Return the index of its joint among those of a robot; of all joints if it has none."""
        return slice(None) if self.joint is None else joints.index(self.joint)


def _form(effect: str, values: Values) -> EffectForm:
    """Find the form with the given values; raise ValueError without one."""
    forms = FORMS[effect]
    for form in forms:
        if form.needed.keys() <= values.keys() <= {*form.needed, *form.optional}:
            return form
    known = {key for form in forms for key in (*form.needed, *form.optional)}
    for key in values:
        if key not in known:
            raise ValueError(f"values: '{effect}' has no {shown(key)}")
    choices = " or ".join(", ".join(form.needed) or "none" for form in forms)
    raise ValueError(f"values: '{effect}' should have {choices}, not {', '.join(values) or 'none'}")


def _check_values(values: Values, form: EffectForm) -> None:
    """Raise ValueError for a value outside its range, or for two that contradict each other."""
    accepted = {**form.optional, **form.needed}
    for key, value in values.items():
        if not accepted[key].accepts(value):
            raise ValueError(f"values.{key}: {shown(value)} should be {accepted[key]}")
        if key in INTEGERS and value != round(value):
            raise ValueError(f"values.{key}: {shown(value)} should be a whole number")
    if ("low" in values) != ("high" in values):
        raise ValueError("values: low and high go together")
    if "low" in values and not values["low"] < values["high"]:
        raise ValueError(f"values.low: {values['low']:g} should be below high, {values['high']:g}")
    if "count" in values and int(values["count"]) not in (4, 10):
        raise ValueError(f"values.count: {shown(values['count'])} should be 4 or 10")
