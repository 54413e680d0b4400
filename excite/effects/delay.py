"""Delay: torque and position are not recorded on one clock, or the actuator lags."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from .._types import FloatArray
from ..identification.lowpass import Grid
from ..schemas.effects import is_recording_filter
from .effect import (
    CandidateModel,
    Effect,
    grid_candidates,
    is_between,
    named_coefficients,
    single_joint_rows,
)
from .recorded_motion import RecordedMotion

DELAYS = (0.003, 0.008, 0.02)
"""Grid of delays and time constants [s]."""
MAX_LINEAR_DELAY = 0.05
"""Largest delay that the derivative of the torque describes [s]."""
MIN_DELAY_DWELL = 0.1
"""Smallest delay of the torque over the time that a joint dwells in one encoder step at a reversal.
Positions smoothed within the encoder's steps reverse late where friction is large, so that torque
seems early: by up to 0.27 of that time in 91 simulated robots without any effect; late by 0.08."""
MIN_LEAD_DWELL = 0.3
"""Smallest lead of the torque, over the same time."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Change of the torque by a delay, per second.

    −τ̇ for a small delay; else (τ(t − d) − τ)/d, or the same for a first-order lag.
    """
    seconds = model.values.get("seconds", 0.0)
    joints = slice(None) if model.joint is None else [model.joint]
    torque = motion.motor_torque
    if is_recording_filter(model.values):
        return filter_columns(motion, torque, model.values["hertz"])
    if not seconds:
        torque = motion.measured_torque if model.values["measured"] else torque
        spectrum = motion.band.transform(torque[:, joints])
        return _at_joint(motion, model, -spectrum.filter(motion.grid, 1)[motion.kept])
    torque = torque[:, joints]
    if "lagging" in model.values:
        spectrum = motion.band.transform(torque)
        change = spectrum.filter(motion.grid, time_constant=seconds) - spectrum.filter(motion.grid)
        return _at_joint(motion, model, change[motion.kept] / seconds)
    return _at_joint(
        motion, model, motion.lowpass((_delayed(motion, torque, seconds) - torque) / seconds)
    )


def _delayed(motion: RecordedMotion, torque: FloatArray, seconds: float) -> FloatArray:
    """Torque that comes later, shape (M, k)."""
    return np.column_stack(
        [np.interp(motion.times - seconds, motion.times, column) for column in torque.T]
    )


def clock_delay() -> CandidateModel:
    """Return the delay of all torque by one time, its coefficient [s]."""
    return CandidateModel(
        "delay", None, _columns, {"measured": 1.0}, parameters=named_coefficients("seconds")
    )


def filtered_recording(hertz: float) -> CandidateModel:
    """Return the filter that all recorded torque has passed, over that of the positions.

    Its coefficients are those of `filter_response`.

    Args:
        hertz: Cutoff frequency of the coefficients [Hz].
    """
    return CandidateModel("delay", None, _columns, {"measured": 1.0, "hertz": hertz})


def filter_response(coefficients: FloatArray, x: FloatArray) -> NDArray[np.complex128]:
    """Return exp(a x² − i p x³ + b x⁴), shape (k,).

    Args:
        coefficients: a, p and b.
        x: Frequencies over the cutoff frequency, shape (k,); the response at 1 holds beyond it.
    """
    a, p, b = coefficients
    x = np.minimum(x, 1.0)
    return np.asarray(np.exp(a * x**2 - 1j * p * x**3 + b * x**4))


def filter_columns(motion: RecordedMotion, torque: FloatArray, hertz: float) -> FloatArray:
    """Return the change of torque per unit of a, p and b, shape (N, n, 3).

    Args:
        motion: The recorded motion.
        torque: The torque at every sample, shape (M, n) [N m].
        hertz: Cutoff frequency of the coefficients [Hz].
    """
    spectrum, unit = motion.band.transform(torque), 2.0 * np.pi * hertz
    second, third, fourth = (
        spectrum.filter(motion.grid, order)[motion.kept] / unit**order for order in (2, 3, 4)
    )
    return np.stack([-second, third, fourth], axis=2)


def filtered(
    motion: RecordedMotion, torque: FloatArray, coefficients: FloatArray, hertz: float
) -> FloatArray:
    """Return torque filtered below the cutoff frequency of a motion, the rest as it is.

    Args:
        motion: The recorded motion.
        torque: The torque at every sample, shape (M, n) [N m].
        coefficients: a, p and b.
        hertz: Their cutoff frequency [Hz].
    """

    def change(frequency: FloatArray) -> NDArray[np.complex128]:
        return filter_response(coefficients, frequency / hertz) - 1.0

    return torque + motion.band.transform(torque).filter(Grid.RECORDED, response=change)


def _predicted_torque(
    motion: RecordedMotion, model: CandidateModel, c: FloatArray, produced: FloatArray
) -> FloatArray:
    """Change of the produced torque by a delay or a filter, shape (M, n)."""
    if is_recording_filter(model.values):
        return filtered(motion, produced, c, model.values["hertz"]) - produced
    joints, out = slice(None) if model.joint is None else [model.joint], np.zeros_like(produced)
    out[:, joints] = _delayed(motion, produced[:, joints], float(c[0])) - produced[:, joints]
    return out


def _at_joint(motion: RecordedMotion, model: CandidateModel, torque: FloatArray) -> FloatArray:
    """Torque of the model's joint, or of all joints, as a column of shape (N, n, 1)."""
    if model.joint is None:
        return torque[:, :, None]
    return single_joint_rows(motion, model.joint, torque)


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Delays of one joint: small ones to first order, of either sign, and larger ones and lags."""

    def family(joint: int, kind: Mapping[str, float]) -> Callable[[float], CandidateModel]:
        def model(seconds: float) -> CandidateModel:
            return CandidateModel(
                "delay",
                joint,
                _columns,
                {"seconds": seconds, **kind},
                parameters=named_coefficients("seconds"),
                is_plausible=is_between(0.5 * seconds, 2.0 * seconds),
            )

        return model

    dwell = min(
        (
            float(motion.reversal_dwell.min())
            for motion in motions
            if np.isfinite(motion.reversal_dwell).any()
        ),
        default=0.0,
    )
    is_plausible = _is_resolved(MIN_DELAY_DWELL * dwell, MIN_LEAD_DWELL * dwell)
    for joint in range(motions[0].n):
        yield CandidateModel(
            "delay",
            joint,
            _columns,
            {"measured": 1.0},
            parameters=named_coefficients("seconds"),
            is_plausible=is_plausible,
        )
        for kind in ({}, {"lagging": 1.0}):
            yield from grid_candidates(DELAYS, family(joint, kind))


def _is_resolved(min_delay: float, min_lead: float) -> Callable[[FloatArray], bool]:
    """Return a check that a delay or lead is resolved and small enough to be linear [s]."""
    return lambda c: bool(
        min_delay <= c[0] < MAX_LINEAR_DELAY or min_lead <= -c[0] < MAX_LINEAR_DELAY
    )


DELAY = Effect(
    "delay",
    "τ(t − d) ≈ τ − d τ̇, or a first-order lag, d τ̇_recorded = τ − τ_recorded",
    _columns,
    _candidates,
    {"seconds": "s"},
    "residual like the slope of torque",
    "fast, jerky motion",
    form_std={"seconds": 0.1},
    predicted_torque=_predicted_torque,
)
"""Time delay between torque and position, actuator lag, latency; torque later: positive."""
