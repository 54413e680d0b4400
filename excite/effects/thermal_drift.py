"""Thermal drift: friction that changes with run time, friction losses or recorded temperature."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from .effect import CandidateModel, Effect, Values, grid_candidates, single_joint_columns
from .recorded_motion import FittedRobot, Motions, RecordedMotion

MAX_COLD_EXCESS = 3.0
"""Largest excess of the initial friction over its mean, over the mean: a cold joint, not one that
has not yet broken away."""
MAX_WARM_EXCESS = 5.0
"""Largest growth of friction over its initial value: heat may press a bearing or a seal."""
TIME_CONSTANTS = (0.1, 0.3, 1.0, 3.0)
"""Grid of time constants, over the longest run."""
MIN_TIME_CONSTANT = 2.0
"""Smallest time constant [s], a bound of the model's parameter: the film of lubricant and the
surfaces of a gear need seconds to get warm; those of simulated robots are 5 to 30 s."""
MIN_TEMPERATURE_RANGE = 1.0
"""Range of temperatures from which a dependence is fitted [°C], as sensors are quantised."""


class _ThermalDrift(Effect):
    """Friction of the base fit times its relative change per coefficient.

    The change is that with temperature where a "reference" is stated, with the joint's friction
    losses where a mean "power" is, and otherwise with run time. An "origin" is the time at which
    the joint was cold, by the clock of all recordings.
    """

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        j = model.joint_index
        friction = _friction_torque(motion, j, model.values)
        return single_joint_columns(motion, j, _warming(motion, model) * friction)

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        for origin in ({}, *({"origin": time} for time in _common_origin(motions))):
            yield from self._by_time(motions, joint, origin)
        yield from self._by_temperature(motions, joint)

    def _by_time(self, motions: Motions, j: int, origin: Values) -> Iterator[CandidateModel]:
        """Exponential changes with run time, and with the heat of the joint's friction losses."""
        length = max(float(_run_time(motion, origin)[-1]) for motion in motions)
        friction = _base_friction(motions[0].fitted_robot, j)
        losses = [_friction_losses(motion, j, friction) for motion in motions]
        power = float(np.mean(np.concatenate(losses)))
        constants = (np.array(TIME_CONSTANTS) * length).tolist()
        by_run_time = CandidateModel(
            self,
            j,
            {"time_constant": constants[0], **friction, **origin},
            facts={"mean_speed": _mean_speed(motions, j)},
            motions=motions,
            signature="friction changes with run time",
        )
        yield from grid_candidates(by_run_time, "time_constant", constants, MIN_TIME_CONSTANT)
        if power > 0.0:
            by_losses = replace(
                by_run_time.with_values(power=power),
                signature="friction changes as its own power heats the joint",
            )
            yield from grid_candidates(by_losses, "time_constant", constants, MIN_TIME_CONSTANT)

    def _by_temperature(self, motions: Motions, j: int) -> Iterator[CandidateModel]:
        """Linear change with temperature, where all motions have it and it varies."""
        temperatures = np.concatenate([motion.temperature[:, j] for motion in motions])
        if not np.ptp(temperatures) > MIN_TEMPERATURE_RANGE:  # also where it is not a number
            return
        friction = _base_friction(motions[0].fitted_robot, j)
        mean = float(temperatures.mean())
        facts = {
            "mean_speed": _mean_speed(motions, j),
            "below": mean - float(temperatures.min()),
            "above": float(temperatures.max()) - mean,
        }
        # lubricant thins; dry friction may change or not
        for changing in (friction, {**friction, "coulomb": 0.0}):
            values = {"reference": mean, **changing}
            signature = "friction changes with temperature"
            yield CandidateModel(self, j, values, facts=facts, signature=signature)

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        """Return the change of friction at mean speed, by temperature that over the whole range."""
        values, facts = model.values, model.facts
        changing, friction = (
            part["coulomb"] + part["viscous"] * facts["mean_speed"]
            for part in (values, _base_friction(base, model.joint_index))
        )
        change = float(c[0]) * (changing / friction)
        if "reference" not in values:
            return {"change": change, "time_constant": values["time_constant"]}
        span = facts["below"] + facts["above"]
        return {"change": change * span / (1.0 - change * facts["below"])}

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Check that friction never becomes negative, nor starts at a multiple of its mean."""
        if "reference" in model.values:
            below, above = model.facts["below"], model.facts["above"]
            lower = -min(1.0 / above, MAX_COLD_EXCESS / below)
            upper = min(1.0 / below, MAX_COLD_EXCESS / above)
        else:
            warming = np.concatenate([_warming(motion, model) for motion in model.motions])
            largest, mean = float(warming.max()), float(warming.mean())
            lower = max(-1.0 / max(largest - mean, 1e-12), -MAX_COLD_EXCESS / mean)
            upper = MAX_WARM_EXCESS / largest
        return bool(lower < c[0] < upper)


def _warming(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the change of friction per coefficient, over friction; shape (M,)."""
    values, j = model.values, model.joint_index
    if "power" in values:
        return warming_by_losses(motion, model)
    if "reference" not in values:
        return np.asarray(1.0 - np.exp(-_run_time(motion, values) / values["time_constant"]))
    warming = motion.temperature[:, j] - values["reference"]
    if not np.isfinite(warming).all():
        joint = motion.fitted_robot.robot.joints[j]
        raise UnusableInput(
            f"{motion.segment.source}: the friction of joint '{joint}' depends on its "
            f"temperature, but there is no column temp.{joint}; record it"
        )
    return warming


def _run_time(motion: RecordedMotion, values: Values) -> FloatArray:
    """Return the time since the start of the recording or the "origin" before it [s], (M,)."""
    if "origin" not in values or motion.times[0] < values["origin"]:
        return motion.run_time
    return motion.times - values["origin"]


def warming_by_losses(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the relative temperature ϑ of a self-heated joint: T ϑ̇ = p/p̄ − ϑ; shape (M,).

    It tends to 1 at the mean power p̄, which is assumed for the time before the segment.
    """
    from scipy.signal import lfilter  # slow to import

    constant = model.values["time_constant"]
    decay = float(np.exp(-1.0 / (motion.segment.rate * constant)))
    initial = float(1.0 - np.exp(-_run_time(motion, model.values)[0] / constant))
    power = _friction_losses(motion, model.joint_index, model.values) / model.values["power"]
    return np.asarray(
        lfilter([0.0, 1.0 - decay], [1.0, -decay], power)
        + initial * np.exp(-(motion.times - motion.times[0]) / constant)
    )


def _friction_torque(motion: RecordedMotion, joint: int, friction: Values) -> FloatArray:
    """Torque of Coulomb and viscous friction [N m], shape (M,)."""
    speed = motion.samples.dq[:, joint]
    return friction["coulomb"] * motion.sign(joint) + friction["viscous"] * speed


def _friction_losses(motion: RecordedMotion, joint: int, friction: Values) -> FloatArray:
    """Power that friction dissipates [W], shape (M,)."""
    return _friction_torque(motion, joint, friction) * motion.samples.dq[:, joint]


def _base_friction(base: FittedRobot, joint: int) -> Values:
    """Coulomb and viscous friction of the base model; the former is positive."""
    coulomb, viscous = (
        float(base.actuator_parameter(kind)[joint]) for kind in ("coulomb", "viscous")
    )
    return {"coulomb": max(coulomb, 1e-9), "viscous": viscous}


def _mean_speed(motions: Motions, joint: int) -> float:
    return float(np.mean(np.abs(np.concatenate([m.samples.dq[:, joint] for m in motions]))))


def _common_origin(motions: Motions) -> list[float]:
    """Return the start of several recordings by one clock [s], one after the other; else none."""
    spans = {
        source: (
            min(float(m.times[0] - m.run_time[0]) for m in motions if m.segment.source == source),
            max(float(m.times[-1]) for m in motions if m.segment.source == source),
        )
        for source in {motion.segment.source for motion in motions}
    }
    ordered = sorted(spans.values())
    if len(ordered) > 1 and all(a[1] <= b[0] for a, b in itertools.pairwise(ordered)):
        return [ordered[0][0]]
    return []


THERMAL_DRIFT = _ThermalDrift(
    "thermal_drift",
    "friction × (1 + c (1 − e^(−t/T))), or × (1 + c ϑ), T ϑ̇ = p/p̄ − ϑ, heated by its power p, or "
    "× (1 + c (ϑ − ϑ₀)) where temperatures were recorded (Bittencourt & Gunnarsson 2012)",
    {"change": "1", "time_constant": "s"},
    "friction changes with run time or temperature",
    "a long run that ends with its first motion, temperatures recorded",
    regime="run time",
    form_std={"change": 0.25, "time_constant": 0.25},
)
"""Warm-up: friction that falls as lubricant and gear get warm."""
