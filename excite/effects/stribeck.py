"""Stribeck friction: friction that falls with speed near zero speed (velocity-weakening)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._types import FloatArray
from .effect import (
    CandidateModel,
    Effect,
    NonlinearParameterSet,
    grid_candidates,
    named_coefficients,
    single_joint_columns,
    variants_within,
)
from .friction import (
    if_resolved,
    joint_speed,
    max_speed,
    max_static_friction,
    min_resolved_speed,
    velocity_weakening,
)
from .recorded_motion import RecordedMotion

EXPONENTS = 0.5, 1.0, 2.0
"""Grid of the exponent δ."""
EXPONENT_RANGES = {False: (1.0, 1.4, 2.0), True: (1.0, 2.0, 3.0)}
"""Lower bound, start and upper bound of δ where it is optimised; by whether the curve is rational.
Exponential: Tustin 1947; Armstrong-Hélouvry 1991. Rational: Popp & Stelter 1990; Hess & Soom 1990.
Exponents below 1 are not sought: their peak at rest is sharp, and any height would fit."""
DENSE_VELOCITIES = np.geomspace(0.03, 0.3, 4)
"""Velocities of the curves of `dense_model`, over the joint's largest speed."""
WIDTHS = 1e-3, 4e-3, 2e-2
"""Lower bound, start and upper bound of the width of the sign function [rad/s, or over the largest
speed if that is less than 1 rad/s]."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Stribeck friction; with a "width", also the change of Coulomb friction by that width.

    A base fit without the Stribeck effect finds too narrow a width of the sign function, and a
    joint that creeps through a reversal stays within that width for long.
    """
    j, values = model.joint_index, model.values
    speed = joint_speed(motion, j)
    if "top_speed" in values:
        share = np.abs(speed)[:, None] / (DENSE_VELOCITIES * values["top_speed"])
        curves = np.hstack([np.exp(-share), np.exp(-(share**2))])
        return single_joint_columns(motion, j, motion.sign(j)[:, None] * curves)
    if "width" not in values:
        return single_joint_columns(motion, j, motion.sign(j) * velocity_weakening(speed, values))
    sign, usual_sign = (np.tanh(speed / values[name]) for name in ("width", "usual"))
    return single_joint_columns(
        motion,
        j,
        np.column_stack([sign * velocity_weakening(speed, values), sign - usual_sign]),
    )


def dense_model(motions: Sequence[RecordedMotion], joint: int) -> CandidateModel:
    """Return a nonnegative combination of exponential and Gaussian Stribeck curves of a joint."""
    top_speed = max_speed(motions, joint)
    velocities = np.tile(DENSE_VELOCITIES * top_speed, 2)
    exponents = np.repeat((1.0, 2.0), len(DENSE_VELOCITIES))

    def parameters(c: FloatArray) -> dict[str, float]:
        """Excess at rest, and the speed at which it has fallen to 1/e."""
        speeds = np.geomspace(1e-3, 1.0, 400) * top_speed
        curve = np.exp(-((speeds[:, None] / velocities) ** exponents)) @ c
        below = curve < float(c.sum()) / np.e
        velocity = speeds[int(np.argmax(below))] if below.any() else top_speed
        return {"amplitude": float(c.sum()), "velocity": float(velocity)}

    return CandidateModel(
        "stribeck",
        joint,
        _columns,
        {"top_speed": top_speed},
        parameters=parameters,
        nonnegative=(True,) * len(velocities),
    )


@dataclass(frozen=True)
class _StribeckFamily:
    """Stribeck curves of a joint, all of whose parameters can be optimised.

    Attributes:
        joint: Index of the joint.
        min_speed: Speed from which the encoder resolves the curve [rad/s].
        max_amplitude: Largest plausible friction [N m].
        widths: See `WIDTHS`, in rad/s.
        usual_width: Width of the base model [rad/s].
        exponent: Exponent δ.
        is_rational: Whether the curve is rational; see `velocity_weakening`.
        velocity: Stribeck velocity v [rad/s].
        width: Width of the sign function [rad/s]; None for the usual one.
    """

    joint: int
    min_speed: float
    max_amplitude: float
    widths: tuple[float, float, float]
    usual_width: float
    exponent: float
    is_rational: bool = False
    velocity: float = 0.0
    width: float | None = None

    def at(self, velocity: float) -> CandidateModel:
        """Return the model at a velocity; its variants optimise all parameters jointly."""
        values = {"velocity": velocity, "exponent": self.exponent}
        values |= {"rational": 1.0} if self.is_rational else {}
        values |= {} if self.width is None else {"width": self.width, "usual": self.usual_width}
        family = replace(self, velocity=velocity)
        return CandidateModel(
            "stribeck",
            self.joint,
            _columns,
            values,
            parameters=named_coefficients("amplitude", velocity=velocity),
            is_plausible=if_resolved(velocity, self.min_speed, self._is_plausible),
            variants=lambda: [family._parameter_set(rational) for rational in (False, True)],
        )

    def _parameter_set(self, is_rational: bool) -> NonlinearParameterSet:
        lower, start, upper = EXPONENT_RANGES[is_rational]
        exponent = max(self.exponent, lower) if is_rational == self.is_rational else start
        values = {
            "velocity": (self.velocity, self.velocity / 2.0, self.velocity * 2.0),
            "power": (exponent, lower, upper),
        }
        narrowest, middle, widest = np.maximum(self.widths, self.min_speed).tolist()
        if narrowest < widest:
            values["width"] = self.width or middle, narrowest, widest
        return NonlinearParameterSet(values, replace(self, is_rational=is_rational)._with)

    def _with(self, values: Mapping[str, float]) -> CandidateModel:
        family = replace(self, exponent=values["power"], width=values.get("width"))
        (by_velocity,) = variants_within(values["velocity"], 2.0, [family.at])
        return by_velocity.current

    def _is_plausible(self, c: FloatArray) -> bool:
        return bool(
            0.0 < c[0] < self.max_amplitude and np.abs(c[1:]).max(initial=0.0) < self.max_amplitude
        )


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """A grid of velocities for each exponent."""
    for j in range(motions[0].n):
        scale, usual_width = min(1.0, max_speed(motions, j)), float(motions[0].widths[j])
        low, middle, high = (scale * width for width in WIDTHS)
        velocities = (scale * np.geomspace(0.01, 0.4, 7)).tolist()
        min_speed, max_amplitude = min_resolved_speed(motions, j), max_static_friction(motions, j)
        for exponent in EXPONENTS:
            family = _StribeckFamily(
                j, min_speed, max_amplitude, (low, middle, high), usual_width, exponent
            )
            yield from grid_candidates(velocities, family.at)


STRIBECK = Effect(
    "stribeck",
    "(F_s − F_c) exp(−(|q̇|/v_s)^δ) sgn q̇, or / (1 + (e − 1) (|q̇|/v_s)^δ) "
    "(Stribeck 1902; Hess & Soom 1990; Armstrong-Hélouvry 1994)",
    _columns,
    _candidates,
    {"amplitude": "N m", "velocity": "rad/s"},
    "friction is larger near zero speed",
    ("hysteresis", "nonlinear_viscous", "delay"),
    "a ladder of slow constant speeds, 1 mrad/s to 0.5 rad/s",
    form_std={"amplitude": 0.25, "velocity": 0.25},
)
"""Stribeck friction; users call it stiction, breakaway friction or stick-slip."""
