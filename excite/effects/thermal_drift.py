"""Thermal drift: friction that changes with run time, friction losses or recorded temperature."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from .effect import (
    CandidateModel,
    Effect,
    grid_candidates,
    is_between,
    single_joint_columns,
)
from .recorded_motion import FittedRobot, RecordedMotion

MAX_COLD_EXCESS = 3.0
"""Largest excess of the initial friction over its mean, over the mean: a cold joint, not one that
has not yet broken away."""
MAX_WARM_EXCESS = 5.0
"""Largest growth of friction over its initial value: heat may press a bearing or a seal."""
TIME_CONSTANTS = (0.1, 0.3, 1.0, 3.0)
"""Grid of time constants, over the longest run."""
MIN_TEMPERATURE_RANGE = 1.0
"""Range of temperatures from which a dependence is fitted [°C], as sensors are quantised."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Friction of the base fit times its relative change per coefficient.

    The change is that with temperature where a "reference" is stated, with the joint's friction
    losses where a mean "power" is, and otherwise with run time. An "origin" is the time at which
    the joint was cold, by the clock of all recordings.

    Raises:
        UnusableInput: If the friction depends on a temperature that was not recorded.
    """
    values, j = model.values, model.joint_index
    friction = values["coulomb"] * motion.sign(j) + values["viscous"] * motion.samples.dq[:, j]
    return single_joint_columns(motion, j, _warming(motion, model) * friction)


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


def _run_time(motion: RecordedMotion, values: Mapping[str, float]) -> FloatArray:
    """Return the time since the joint was cold [s], shape (M,).

    That is the start of the recording, or an "origin" by the clock of all recordings. A recording
    from before it has another clock.
    """
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
    losses = _friction_losses(
        motion, model.joint_index, model.values["coulomb"], model.values["viscous"]
    )
    power = losses / model.values["power"]
    return np.asarray(
        lfilter([0.0, 1.0 - decay], [1.0, -decay], power)
        + initial * np.exp(-(motion.times - motion.times[0]) / constant)
    )


def _friction_losses(
    motion: RecordedMotion, joint: int, coulomb: float, viscous: float
) -> FloatArray:
    """Power that friction dissipates [W], shape (M,)."""
    speed = motion.samples.dq[:, joint]
    return np.asarray((coulomb * motion.sign(joint) + viscous * speed) * speed)


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Changes with run time, with friction losses, and with recorded temperature."""
    origins = [{}, *({"origin": time} for time in _common_origin(motions))]
    for j in range(motions[0].n):
        for origin in origins:
            yield from _by_time(motions, j, origin)
        yield from _by_temperature(motions, j)


def _base_friction(base: FittedRobot, joint: int) -> tuple[float, float]:
    """Coulomb and viscous friction of the base model; the former is positive."""
    coulomb, viscous = (
        float(base.actuator_parameter(kind)[joint]) for kind in ("coulomb", "viscous")
    )
    return max(coulomb, 1e-9), viscous


def _share_of_friction(
    motions: Sequence[RecordedMotion], joint: int
) -> Callable[[Mapping[str, float], FittedRobot], float]:
    """Return the function of the friction that changes, over that of a base model, at mean speed.

    The friction that changes is stated in the values of a candidate.
    """
    speed = float(np.mean(np.abs(np.concatenate([m.samples.dq[:, joint] for m in motions]))))

    def share(values: Mapping[str, float], base: FittedRobot) -> float:
        coulomb, viscous = _base_friction(base, joint)
        return (values["coulomb"] + values["viscous"] * speed) / (coulomb + viscous * speed)

    return share


def _common_origin(motions: Sequence[RecordedMotion]) -> list[float]:
    """Return the start of the first of several recordings by one clock [s]; none without one.

    Recordings that follow each other without an overlap have the same clock: the joint was cold
    before the first, and is warm when the next one starts.
    """
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


def _by_time(
    motions: Sequence[RecordedMotion], j: int, origin: Mapping[str, float]
) -> Iterator[CandidateModel]:
    """Exponential changes with run time, and with the heat of the joint's friction losses."""
    length = max(float(_run_time(motion, origin)[-1]) for motion in motions)
    coulomb, viscous = _base_friction(motions[0].fitted_robot, j)
    losses = [_friction_losses(motion, j, coulomb, viscous) for motion in motions]
    power = float(np.mean(np.concatenate(losses)))
    share = _share_of_friction(motions, j)

    def model(constant: float, by_losses: bool = False) -> CandidateModel:
        def parameters(c: FloatArray, base: FittedRobot) -> dict[str, float]:
            return {"change": float(c[0]) * share(values, base), "time_constant": constant}

        values = {"time_constant": constant, "coulomb": coulomb, "viscous": viscous, **origin} | (
            {"power": power} if by_losses else {}
        )
        candidate = CandidateModel(
            "thermal_drift",
            j,
            _columns,
            values,
            parameters_on_base=parameters,
            signature="friction changes as its own power heats the joint"
            if by_losses
            else "friction changes with run time",
        )
        warming = np.concatenate([_warming(motion, candidate) for motion in motions])
        largest, mean = float(warming.max()), float(warming.mean())
        # the base fit has the mean of the friction, which must never become negative, nor start
        # at a large multiple
        return replace(
            candidate,
            is_plausible=is_between(
                max(-1.0 / (largest - mean), -MAX_COLD_EXCESS / mean), MAX_WARM_EXCESS / largest
            ),
        )

    constants = (np.array(TIME_CONSTANTS) * length).tolist()
    yield from grid_candidates(constants, model)
    if power > 0.0:
        yield from grid_candidates(constants, lambda constant: model(constant, by_losses=True))


def _by_temperature(motions: Sequence[RecordedMotion], j: int) -> Iterator[CandidateModel]:
    """Linear change with temperature, where all motions have it and it varies.

    The reported change is that from the coldest to the warmest state recorded.
    """
    temperatures = np.concatenate([motion.temperature[:, j] for motion in motions])
    span = float(np.ptp(temperatures))
    if not span > MIN_TEMPERATURE_RANGE:  # also where it is not a number
        return
    coulomb, viscous = _base_friction(motions[0].fitted_robot, j)
    share_of_friction = _share_of_friction(motions, j)
    mean = float(temperatures.mean())
    below, above = mean - float(temperatures.min()), float(temperatures.max()) - mean
    # friction never becomes negative, nor a large multiple of its mean
    lower = -min(1.0 / above, MAX_COLD_EXCESS / below)
    upper = min(1.0 / below, MAX_COLD_EXCESS / above)

    def change(values: Mapping[str, float], c: FloatArray, base: FittedRobot) -> dict[str, float]:
        per_degree = float(c[0]) * share_of_friction(values, base)
        return {"change": per_degree * span / (1.0 - per_degree * below)}

    for changing_coulomb in (coulomb, 0.0):  # lubricant thins; dry friction may change or not
        values = {"reference": mean, "coulomb": changing_coulomb, "viscous": viscous}
        yield CandidateModel(
            "thermal_drift",
            j,
            _columns,
            values,
            parameters_on_base=partial(change, values),
            is_plausible=is_between(lower, upper),
            signature="friction changes with temperature",
        )


THERMAL_DRIFT = Effect(
    "thermal_drift",
    "friction × (1 + c (1 − e^(−t/T))), or × (1 + c ϑ), T ϑ̇ = p/p̄ − ϑ, heated by its power p, or "
    "× (1 + c (ϑ − ϑ₀)) where temperatures were recorded (Bittencourt & Gunnarsson 2012)",
    _columns,
    _candidates,
    {"change": "1", "time_constant": "s"},
    "friction changes with run time or temperature",
    "a long run that ends with its first motion, temperatures recorded",
    form_std={"change": 0.25, "time_constant": 0.25},
)
"""Warm-up: friction that falls as lubricant and gear get warm."""
