"""Delay: torque and position are not recorded on one clock, or the actuator lags."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

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
from .recorded_motion import RecordedMotion, interpolated

DELAYS = (0.003, 0.008, 0.02)
"""Grid of delays [s]."""
MAX_LINEAR_DELAY = 0.05
"""Largest delay and time constant that are sought by the derivative of the torque [s]."""
MIN_LAG = 0.5 * DELAYS[0]
"""Smallest time constant that is sought [s]: that of the smallest delay of the grid."""
MIN_DELAY_DWELL = 0.1
"""Smallest delay of the torque over the time that a joint dwells in one encoder step at a reversal.
Positions smoothed within the encoder's steps reverse late where friction is large, so that torque
seems early: by up to 0.27 of that time in 91 simulated robots without any effect; late by 0.08."""
MIN_LEAD_DWELL = 0.3
"""Smallest lead of the torque, over the same time."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Change of the torque by a delay, per second.

    −τ̇ of the measured torque for a first-order lag, and for a small delay; else (τ − τ(t + d))/d.
    """
    joints = slice(None) if model.joint is None else [model.joint]
    if is_recording_filter(model.values):
        torque = motion.motor_torque
        change = _filter_of(model.values).passed(motion, torque) - torque
        return motion.lowpass(change)[:, :, None]
    torque = motion.measured_torque if model.values["measured"] else motion.motor_torque
    torque = torque[:, joints]
    if seconds := model.values.get("seconds", 0.0):
        change = (torque - _delayed(motion, torque, -seconds)) / seconds
        return _at_joint(motion, model, motion.lowpass(change))
    slope = motion.band.transform(torque).filter(motion.grid, 1)
    return _at_joint(motion, model, -slope[motion.kept])


def _delayed(motion: RecordedMotion, torque: FloatArray, seconds: float) -> FloatArray:
    """Torque that comes later, shape (M, k)."""
    return interpolated(motion.times - seconds, motion.times, torque)


def clock_delay() -> CandidateModel:
    """Return the delay of all torque by one time, its coefficient [s]."""
    return CandidateModel(
        "delay", None, _columns, {"measured": 1.0}, parameters=named_coefficients("seconds")
    )


@dataclass(frozen=True)
class LowPass:
    """Butterworth low-pass filter whose delay at low frequencies is not part of it.

    Attributes:
        poles: Number of poles.
        passes: 1; 2 for a filter that is passed forwards and backwards, which has no phase.
        hertz: Corner frequency [Hz].
    """

    poles: int
    passes: int
    hertz: float

    def response(self, frequencies: FloatArray) -> NDArray[np.complex128]:
        """Return the frequency response, shape (k,).

        Args:
            frequencies: The frequencies [Hz], shape (k,).
        """
        s = 1j * frequencies / self.hertz
        angles = 0.5 * np.pi * (1.0 + (2.0 * np.arange(self.poles) + 1.0) / self.poles)
        poles = np.exp(1j * angles)
        once = np.prod([pole / (pole - s) for pole in poles], axis=0)
        if self.passes == 2:
            return np.abs(once) ** 2 + 0j
        return np.asarray(once * np.exp(-s * np.sum(1.0 / poles).real))

    def slope(self, frequencies: FloatArray) -> NDArray[np.complex128]:
        """Return the derivative of the response by the logarithm of the corner frequency.

        Args:
            frequencies: The frequencies [Hz], shape (k,).
        """
        step = 1e-4
        above, below = (
            self.with_corner(self.hertz * np.exp(x)).response(frequencies) for x in (step, -step)
        )
        return np.asarray((above - below) / (2.0 * step))

    def with_corner(self, hertz: float) -> LowPass:
        """Return the filter with another corner frequency [Hz]."""
        return replace(self, hertz=hertz)

    def passed(
        self, motion: RecordedMotion, torque: FloatArray, inverse: bool = False
    ) -> FloatArray:
        """Return torque filtered below the cutoff frequency of a motion, the rest as it is.

        Args:
            motion: The recorded motion.
            torque: The torque at every sample, shape (M, n) [N m].
            inverse: Undo the filter.
        """

        def change(frequencies: FloatArray) -> NDArray[np.complex128]:
            return self.response(frequencies) ** (-1 if inverse else 1) - 1.0

        return torque + motion.band.transform(torque).filter(Grid.RECORDED, response=change)


def filtered_recording(filter_: LowPass) -> CandidateModel:
    """Return the filter that all recorded torque has passed, over that of the positions.

    Its coefficient is 1.

    Args:
        filter_: The filter.
    """
    values = {"measured": 1.0, **{k: float(v) for k, v in asdict(filter_).items()}}
    return CandidateModel("delay", None, _columns, values)


def _filter_of(values: Mapping[str, float]) -> LowPass:
    """Return the filter of a candidate model with some values."""
    return LowPass(int(values["poles"]), int(values["passes"]), values["hertz"])


def _predicted_torque(
    motion: RecordedMotion, model: CandidateModel, c: FloatArray, produced: FloatArray
) -> FloatArray:
    """Change of the produced torque by a delay or a filter, shape (M, n)."""
    if is_recording_filter(model.values):
        return float(c[0]) * (_filter_of(model.values).passed(motion, produced) - produced)
    joints, out = slice(None) if model.joint is None else [model.joint], np.zeros_like(produced)
    torque, seconds = produced[:, joints], float(c[0])
    if "lagging" in model.values:
        low = motion.band.transform(torque)
        lagging = low.filter(Grid.RECORDED, time_constant=seconds) - low.filter(Grid.RECORDED)
        out[:, joints] = lagging
    else:
        out[:, joints] = _delayed(motion, torque, seconds) - torque
    return out


def _at_joint(motion: RecordedMotion, model: CandidateModel, torque: FloatArray) -> FloatArray:
    """Torque of the model's joint, or of all joints, as a column of shape (N, n, 1)."""
    if model.joint is None:
        return torque[:, :, None]
    return single_joint_rows(motion, model.joint, torque)


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Delays of one joint: small ones to first order, of either sign, larger ones, and lags."""

    def model(
        joint: int, is_plausible: Callable[[FloatArray], bool], **kind: float
    ) -> CandidateModel:
        return CandidateModel(
            "delay",
            joint,
            _columns,
            {"measured": 1.0, **kind},
            parameters=named_coefficients("seconds"),
            is_plausible=is_plausible,
        )

    def family(joint: int) -> Callable[[float], CandidateModel]:
        return lambda d: model(joint, is_between(0.5 * d, 2.0 * d), seconds=d)

    dwell = min(
        (
            float(motion.reversal_dwell.min())
            for motion in motions
            if np.isfinite(motion.reversal_dwell).any()
        ),
        default=0.0,
    )
    min_delay = MIN_DELAY_DWELL * dwell
    is_plausible = _is_resolved(min_delay, MIN_LEAD_DWELL * dwell)
    for joint in range(motions[0].n):
        # of the same columns: a lag, but for delays so small that both are alike
        yield model(joint, is_between(max(MIN_LAG, min_delay), MAX_LINEAR_DELAY), lagging=1.0)
        yield model(joint, is_plausible)
        yield from grid_candidates(DELAYS, family(joint))


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
