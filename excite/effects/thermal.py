"""Friction that changes as a drive warms up: with run time, by its own power, or with the temperature that was recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..errors import UnusableInput
from .effect import CandidateModel, Effect, alone, family, named, within
from .recorded_motion import RecordedMotion

Array = np.ndarray
COLDEST = 3.0
"""Times its mean, what friction at the start may have more: a joint that is cold, not one that has yet to slide."""
DEGREES = 1.0
"""Range of temperatures from which friction may be told to depend on them [°C]: sensors have steps."""


def _changed(t: RecordedMotion, s: CandidateModel) -> Array:
    """A joint's friction by the base fit, as it changes with run time, where a mean `power` is stated, by what heats it, or where a
    `reference` is, with temperature."""
    if "reference" in s.values:
        warm = t.temperature[:, s.joint_index] - s.values["reference"]
        if not np.isfinite(warm).all():
            joint = t.fitted_robot.robot.joints[s.joint_index]
            raise UnusableInput(
                f"{t.segment.source}: has no temp.{joint}, on which the friction of joint '{joint}' depends; record it"
            )
    elif "power" in s.values:
        warm = _heated(t, s)
    else:
        warm = 1.0 - np.exp(-t.run_time / s.values["time_constant"])
    return alone(
        t,
        s.joint_index,
        warm
        * (s.values["coulomb"] * t.sign(s.joint_index) + s.values["viscous"] * t.samples.dq[:, s.joint_index]),
    )


def _heated(t: RecordedMotion, s: CandidateModel) -> Array:
    """How warm a joint is that its own friction heats, T ϑ̇ = p/p̄ − ϑ: 1 where it goes on at the usual power p̄, as it is taken to have done
    before a gap. Shape (M,)."""
    from scipy.signal import lfilter  # slow to import

    constant = s.values["time_constant"]
    keeps, before = (
        float(np.exp(-1.0 / (t.segment.rate * constant))),
        float(1.0 - np.exp(-t.run_time[0] / constant)),
    )
    power = _losses(t, s.joint_index, s.values["coulomb"], s.values["viscous"]) / s.values["power"]
    return np.asarray(
        lfilter([0.0, 1.0 - keeps], [1.0, -keeps], power)
        + before * np.exp(-(t.times - t.times[0]) / constant)
    )


def _losses(t: RecordedMotion, joint: int, coulomb: float, viscous: float) -> Array:
    """Power that friction takes. Shape (M,) [W]."""
    speed = t.samples.dq[:, joint]
    return np.asarray((coulomb * t.sign(joint) + viscous * speed) * speed)


def _thermal(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    for j in range(tracks[0].n):
        yield from _by_time(tracks, j)
        yield from _by_temperature(tracks, j)


def _friction(track: RecordedMotion, joint: int) -> tuple[float, float]:
    """Coulomb and viscous friction of the base fit, of which something can change."""
    coulomb, viscous = (float(track.fitted_robot.drive(kind)[joint]) for kind in ("coulomb", "viscous"))
    return max(coulomb, 1e-9), viscous


def _by_time(tracks: Sequence[RecordedMotion], j: int) -> Iterator[CandidateModel]:
    length = max(float(t.run_time[-1]) for t in tracks)
    coulomb, viscous = _friction(tracks[0], j)
    power = float(np.mean(np.concatenate([_losses(t, j, coulomb, viscous) for t in tracks])))

    def shape(constant: float, heated: bool = False) -> CandidateModel:
        fixed = {"time_constant": constant, "coulomb": coulomb, "viscous": viscous} | (
            {"power": power} if heated else {}
        )
        reached = 1.0 - np.exp(-length / constant)
        mean = 1.0 - reached * constant / length
        words = (
            "friction changes as its own power heats the joint"
            if heated
            else "friction changes with run time"
        )
        bare = CandidateModel(
            "thermal_drift",
            j,
            _changed,
            fixed,
            parameters=named("change", time_constant=constant),
            signature=words,
        )
        if heated:
            warm = np.concatenate([_heated(t, bare) for t in tracks])
            reached, mean = float(warm.max()), float(warm.mean())
        # what the base fit has of friction is the mean: it never falls below nothing, nor does it begin many times as high
        return replace(
            bare, plausible=within(max(-1.0 / (reached - mean), -COLDEST / mean), 5.0 / reached)
        )

    constants = (np.array([0.1, 0.3, 1.0, 3.0]) * length).tolist()
    yield from family(constants, shape)
    if power > 0.0:  # a joint that stands heats nothing
        yield from family(constants, lambda constant: shape(constant, heated=True))


def _by_temperature(tracks: Sequence[RecordedMotion], j: int) -> Iterator[CandidateModel]:
    """Where every stretch has a joint's temperature and that varies. The change is from the coldest to the warmest seen."""
    seen = np.concatenate([t.temperature[:, j] for t in tracks])
    span = float(np.ptp(seen))
    if not span > DEGREES:  # nor where it is not a number
        return
    coulomb, viscous = _friction(tracks[0], j)
    mean = float(seen.mean())
    below, above = mean - float(seen.min()), float(seen.max()) - mean
    least, most = (
        -min(1.0 / above, COLDEST / below),
        min(1.0 / below, COLDEST / above),
    )  # never below nothing, nor many times the mean
    size = float(np.mean(np.abs(np.concatenate([t.samples.dq[:, j] for t in tracks])))) * viscous
    for dry in (coulomb, 0.0):  # grease thins, and dry friction may go with it or not
        share = (dry + size) / (coulomb + size)
        told = lambda c, share=share: {  # noqa: E731
            "change": float(c[0] * share * span / (1.0 - c[0] * share * below))
        }
        fixed = {"reference": mean, "coulomb": dry, "viscous": viscous}
        words = "friction changes with temperature"
        yield CandidateModel(
            "thermal_drift",
            j,
            _changed,
            fixed,
            parameters=told,
            plausible=within(least, most),
            signature=words,
        )


EFFECTS = (
    Effect(
        "thermal_drift",
        "friction × (1 + c (1 − e^(−t/T))), or × (1 + c ϑ), T ϑ̇ = p/p̄ − ϑ, heated by its power p, or × (1 + c (ϑ − ϑ₀)) where temperatures "
        "were recorded (Bittencourt & Gunnarsson 2012)",
        _changed,
        _thermal,
        {"change": "1", "time_constant": "s"},
        "friction changes with run time or temperature",
        ("asymmetric_viscous",),
        "a long run that ends with its first motion, temperatures recorded",
        form={"change": 0.25, "time_constant": 0.25},
        residual_log_offset=-0.4,
    ),
)
