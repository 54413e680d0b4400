"""Delay: torque and position are not recorded on one clock, or the actuator lags."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .._types import FloatArray
from ..identification.lowpass import FLAT_BANDWIDTH_RATIO, Grid
from ..schemas.effects import is_recording_filter
from .effect import CandidateModel, Effect, Values, grid_candidates, single_joint_rows
from .recorded_motion import FittedRobot, Motions, RecordedMotion, interpolated

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


@dataclass(frozen=True)
class LowPass:
    """Butterworth low-pass filter whose delay at low frequencies is not part of it.

    Attributes:
        passes: 1; 2 for a filter that is passed forwards and backwards, which has no phase.
        hertz: Corner frequency [Hz].
    """

    poles: int
    passes: int
    hertz: float

    def response(self, frequencies: FloatArray) -> NDArray[np.complex128]:
        """Return the response at frequencies [Hz], shape (k,)."""
        from scipy import signal  # slow to import

        b, a = signal.butter(self.poles, 1.0, analog=True)
        omega = frequencies / self.hertz
        once = signal.freqs(b, a, omega)[1]
        if self.passes == 2:
            return np.abs(once) ** 2 + 0j
        return np.asarray(once * np.exp(1j * omega * a[-2]))  # its delay at low frequencies

    def slope(self, frequencies: FloatArray) -> NDArray[np.complex128]:
        """Return the derivative of the response by the logarithm of the corner frequency, (k,)."""
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
        """Return torque (M, n), filtered below the cutoff frequency of a motion."""

        def change(frequencies: FloatArray) -> NDArray[np.complex128]:
            return self.response(frequencies) ** (-1 if inverse else 1) - 1.0

        return torque + motion.band.transform(torque).filter(
            Grid.RECORDED, response=change, bandwidth_ratio=FLAT_BANDWIDTH_RATIO
        )


class _Delay(Effect):
    """Change of the torque by a delay, per second; or by a filter of the recording.

    −τ̇ of the measured torque for a first-order lag, and for a small delay; else (τ − τ(t + d))/d.
    """

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        if is_recording_filter(model.values):
            torque = motion.motor_torque
            change = _filter_of(model.values).passed(motion, torque) - torque
            return motion.lowpass(change)[:, :, None]
        torque = motion.measured_torque[:, model.joints]
        if seconds := model.values.get("seconds", 0.0):
            change = motion.lowpass((torque - _delayed(motion, torque, -seconds)) / seconds)
        else:
            slope = motion.band.transform(torque).filter(motion.grid, 1)
            change = -slope[motion.kept]
        if model.joint is None:
            return change[:, :, None]
        return single_joint_rows(motion, model.joint, change)

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        """Yield delays of one joint: small ones of either sign, larger ones, and lags."""
        dwells = [motion.reversal_dwell for motion in motions]
        dwell = min((float(x.min()) for x in dwells if np.isfinite(x).any()), default=0.0)
        facts = {"dwell": dwell}
        # of the same columns: a lag, but for delays so small that both are alike
        yield CandidateModel(self, joint, {"measured": 1.0, "lagging": 1.0}, facts=facts)
        yield CandidateModel(self, joint, {"measured": 1.0}, facts=facts)
        delayed = CandidateModel(self, joint, {"measured": 1.0, "seconds": DELAYS[0]})
        yield from grid_candidates(delayed, "seconds", DELAYS)

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        return {} if is_recording_filter(model.values) else {"seconds": float(c[0])}

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Check that a delay is near that of its column, or resolved and small enough for it."""
        if "seconds" in model.values:
            return bool(0.5 * model.values["seconds"] < c[0] < 2.0 * model.values["seconds"])
        if "dwell" not in model.facts:
            return super().is_plausible(model, c)
        min_delay = MIN_DELAY_DWELL * model.facts["dwell"]
        if "lagging" in model.values:
            return bool(max(MIN_LAG, min_delay) < c[0] < MAX_LINEAR_DELAY)
        min_lead = MIN_LEAD_DWELL * model.facts["dwell"]
        return bool(min_delay <= c[0] < MAX_LINEAR_DELAY or min_lead <= -c[0] < MAX_LINEAR_DELAY)

    def recorded_change(
        self, motion: RecordedMotion, model: CandidateModel, c: FloatArray, produced: FloatArray
    ) -> FloatArray:
        """Return the change of the produced torque by a delay or a filter, shape (M, k)."""
        if is_recording_filter(model.values):
            return float(c[0]) * (_filter_of(model.values).passed(motion, produced) - produced)
        seconds = float(c[0])
        if "lagging" not in model.values:
            return _delayed(motion, produced, seconds) - produced
        low = motion.band.transform(produced)
        lagging, direct = (
            low.filter(Grid.RECORDED, 0, FLAT_BANDWIDTH_RATIO, time) for time in (seconds, 0.0)
        )
        return lagging - direct


def _delayed(motion: RecordedMotion, torque: FloatArray, seconds: float) -> FloatArray:
    """Torque that comes later, shape (M, k)."""
    return interpolated(motion.times - seconds, motion.times, torque)


def _filter_of(values: Values) -> LowPass:
    """Return the filter of a candidate model with some values."""
    return LowPass(int(values["poles"]), int(values["passes"]), values["hertz"])


DELAY = _Delay(
    "delay",
    "τ(t − d) ≈ τ − d τ̇, or a first-order lag, d τ̇_recorded = τ − τ_recorded",
    {"seconds": "s"},
    "residual like the slope of torque",
    "fast, jerky motion",
    regime="frequency",
    form_std={"seconds": 0.1},
)
"""Time delay between torque and position, actuator lag, latency; torque later: positive."""


def clock_delay() -> CandidateModel:
    """Return the delay of all torque by one time, its coefficient [s]."""
    return CandidateModel(DELAY, None, {"measured": 1.0})


def filtered_recording(filter_: LowPass) -> CandidateModel:
    """Return the filter that all recorded torque has passed; its coefficient is 1."""
    values = {"measured": 1.0, **{k: float(v) for k, v in asdict(filter_).items()}}
    return CandidateModel(DELAY, None, values)
