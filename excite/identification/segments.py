"""Segments of recordings for identification: mean periods or gap-free stretches.

The mean over P periods has 1/P of the noise variance, and the deviations of the periods from it
measure the noise without a model, because what repeats is not noise (Swevers et al., "Optimal robot
excitation and identification", IEEE Trans. Robotics and Automation 13(5), 1997).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from .._types import BoolArray, FloatArray
from ..errors import UnusableInput
from ..recordings import Recording
from ..recordings.recording import MIN_ROWS
from .lowpass import LowPassFilter, settling_time

DEFAULT_BAND_HZ = 20.0
"""Cutoff frequency unless the data ask for another [Hz]."""
MIN_TORQUE_TO_NOISE_POWER = 4.0
"""Power of torque over the power of its noise below which the torque holds no usable signal."""
TORQUE_BANDWIDTH_RATIO = 10.0
"""Bandwidth of torque over bandwidth of motion: products of joint motions and reversals of friction
reach beyond the motion's own band."""
MAX_BAND_HZ = 50.0
"""Highest cutoff chosen automatically [Hz]: above it links and gears of an arm are not rigid."""
MIN_KEPT_SHARE = 0.5
"""Share of the longest segment that the filter leaves if the cutoff is chosen from the data [1]."""
CHUNK_SAMPLES = 1 << 17
"""Number of samples of a long segment that are processed together, to bound memory."""


@dataclass(frozen=True)
class RecordingSegment:
    """An evenly sampled segment of a recording, or the mean of its periods.

    Attributes:
        source: Name of the recording.
        start: Time of the first sample [s].
        rate: Sample rate [Hz].
        q: Joint positions. Shape (N, n) [rad or m].
        torque: Joint torques. Shape (N, n) [N m or N].
        periods: Number of averaged periods; 0 if the segment is not periodic.
        noise: Torque of each period minus the mean. Shape (periods, N, n).
        encoder: Standard deviation of the quantization error of positions. Shape (n,) or (1,).
        smoothed: True for joints whose positions were smoothed within the encoder's resolution.
            Shape (n,), or (1,) if there are none.
        temperature: Joint temperatures, NaN where a joint's was not recorded; None if none was.
            Shape (N, n) [°C].
        recording_start: Time of the recording's first sample [s], if not `start`.
    """

    source: str
    start: float
    rate: float
    q: FloatArray
    torque: FloatArray
    periods: int = 0
    noise: FloatArray | None = None
    encoder: FloatArray = field(default_factory=lambda: np.zeros(1))
    smoothed: BoolArray = field(default_factory=lambda: np.zeros(1, bool))
    temperature: FloatArray | None = None
    recording_start: float | None = None

    def __len__(self) -> int:
        return len(self.q)

    def head(self, count: int) -> RecordingSegment:
        """Return the first samples of an aperiodic segment."""
        temperature = None if self.temperature is None else self.temperature[:count]
        return dataclasses.replace(
            self, q=self.q[:count], torque=self.torque[:count], temperature=temperature
        )

    @property
    def periodic(self) -> bool:
        """True if the segment is a mean period."""
        return self.periods > 0

    def band(self, hertz: float) -> LowPassFilter:
        """Return the low-pass filter of this segment with a cutoff frequency [Hz]."""
        return LowPassFilter(hertz, self.rate, len(self), self.periodic, float(self.encoder.max()))


def usable_segments(
    recordings: Sequence[Recording], average: bool = True
) -> list[RecordingSegment]:
    """Return what `extract_segments` yields.

    Args:
        recordings: Recordings with torque.
        average: Whether periods are averaged.

    Raises:
        UnusableInput: There is no segment.
    """
    out = list(extract_segments(recordings, average=average))
    if not out:
        raise UnusableInput(
            f"{recordings[0].source}: has no gap-free stretch that is long enough; record again"
        )
    return out


def too_short(
    source: str, needed: float, hertz: float, longest: RecordingSegment | None = None, rows: int = 0
) -> UnusableInput:
    """Return the error for recordings of which the low-pass filter leaves nothing.

    Args:
        source: Name of the recordings.
        needed: Length of a stretch of which the filter leaves something [s].
        hertz: Cutoff frequency [Hz].
        longest: The longest stretch, if there is one.
        rows: Rows that a fit needs.
    """
    rounded = np.ceil(100.0 * needed) / 100.0
    remedy = "record for longer"
    if longest is not None:
        higher = range(int(hertz) + 1, int(np.ceil(0.5 * longest.rate)))
        bands = map(longest.band, map(float, higher))
        fitting = (band for band in bands if band.needed_samples(rows) <= len(longest))
        if least := next(fitting, None):
            remedy += f", or give a higher --band: at least {least.hertz:.0f} Hz"
    return UnusableInput(
        f"{source}: no gap-free stretch is longer than the {rounded:g} s that a band of "
        f"{hertz:.3g} Hz needs; {remedy}"
    )


def extract_segments(
    recordings: Iterable[Recording], *, average: bool = True
) -> Iterator[RecordingSegment]:
    """Yield the segments of recordings in order.

    Args:
        recordings: Recordings with torque.
        average: Average whole periods where a recording repeats; else every gap-free stretch of it
            is a segment.
    """
    for recording in recordings:
        if average and recording.repetition is not None:
            mean = average_periods(recording, *recording.repetition)
            if mean is not None:
                yield mean
                continue
        for part in recording.segments():
            signals = (recording.source, float(part.t[0]), part.rate, part.q, part.torque)
            yield RecordingSegment(
                *signals,
                encoder=recording.quantization_noise,
                smoothed=recording.smoothed,
                temperature=part.temperature,
                recording_start=float(recording.t[0]),
            )


def longest_of_each_recording(segments: Sequence[RecordingSegment]) -> list[RecordingSegment]:
    """Return the longest segment of each recording."""
    longest: dict[str, RecordingSegment] = {}
    for segment in sorted(segments, key=len, reverse=True):
        longest.setdefault(segment.source, segment)
    return list(longest.values())


def leading_segments(segments: Sequence[RecordingSegment], samples: int) -> list[RecordingSegment]:
    """Return the first segments until they hold a number of samples.

    The last of them is cut if it is aperiodic and more than twice as long as needed.
    """
    out: list[RecordingSegment] = []
    for segment in segments:
        missing = samples - sum(map(len, out))
        if missing <= 0:
            break
        keep = segment.periodic or len(segment) <= 2 * missing
        out.append(segment if keep else segment.head(missing))
    return out


def average_periods(
    recording: Recording, period: float, window: tuple[float, float]
) -> RecordingSegment | None:
    """Average the whole periods within a window, on a grid of a whole number of samples.

    Periods interrupted by a gap are left out.

    Args:
        recording: Recording of a periodic motion.
        period: Period [s].
        window: Start and end of the periodic part [s].

    Returns:
        The mean period; None if fewer than two periods are complete, or if a period has fewer than
        MIN_ROWS samples.
    """
    first = float(
        recording.t[min(int(np.searchsorted(recording.t, window[0] - 1e-9)), len(recording) - 1)]
    )
    # a window may end with the last row of a period, one step before the next one begins
    last = min(window[1], float(recording.t[-1])) + 1.0 / recording.rate
    samples = round(period * recording.rate)
    if samples < MIN_ROWS or (last - first) / period + 1e-6 < 2.0:
        return None
    starts = first + period * np.arange(int((last - first) / period + 1e-6))
    offsets = np.arange(samples) * (period / samples)
    folded = [
        _folded(part, starts[complete, None] + offsets)
        for part in recording.segments()
        if (
            complete := (starts > part.t[0] - 0.5 * part.step)
            & (starts + offsets[-1] < part.t[-1] + 0.5 * part.step)
        ).any()
    ]
    count = sum(len(q) for q, _ in folded)
    if count < 2:
        return None
    q, torque = (np.concatenate(values) for values in zip(*folded, strict=True))
    mean = torque.mean(axis=0)
    return RecordingSegment(
        recording.source,
        first,
        samples / period,
        q.mean(axis=0),
        mean,
        count,
        torque - mean,
        recording.quantization_noise / np.sqrt(count),
        recording.smoothed,
    )


def _folded(part: Recording, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sample positions and torque of a gap-free stretch at the times of its periods.

    Shape (count, samples) of `times` -> (count, samples, n).
    """
    both, step = (part.q, part.torque), times[0, 1] - times[0, 0]
    index = np.searchsorted(part.t, times - 0.25 * step)
    if index.max() < len(part) and np.abs(part.t[index] - times).max() < 1e-3 * step:
        return both[0][index], both[1][index]
    from scipy.interpolate import CubicSpline  # slow to import

    q, torque = (np.asarray(CubicSpline(part.t, values, axis=0)(times)) for values in both)
    return q, torque


def noise_floor(
    segments: Sequence[RecordingSegment], hertz: float, *, tapered: bool = False
) -> FloatArray | None:
    """Estimate the standard deviation of torque noise below a cutoff from the spread of periods.

    Differences between the periods' means are left out, as they may be warming up.

    Args:
        segments: Segments, of which those with averaged periods are used.
        hertz: Cutoff frequency [Hz].
        tapered: Use the tapered gain of aperiodic signals, to compare with torque that was not
            averaged over periods.

    Returns:
        Standard deviation per joint; None without repeated periods. Shape (n,) [N m].
    """
    power, weight = 0.0, 0
    for segment in segments:
        if segment.noise is None:
            continue
        spectrum = np.fft.rfft(segment.noise, axis=1)
        gain = LowPassFilter(hertz, segment.rate, len(segment), periodic=not tapered).gain(
            np.fft.rfftfreq(len(segment), 1.0 / segment.rate), hertz
        )
        sides = np.where(np.arange(len(gain)) > 0, 2.0, 0.0) * gain**2
        square = np.sum(sides[:, None] * np.abs(spectrum) ** 2, axis=1) / len(segment) ** 2
        power = power + square.sum(axis=0)
        weight += segment.periods - 1
    return None if weight == 0 else np.sqrt(np.asarray(power) / weight)


@dataclass(frozen=True)
class TorqueSpectra:
    """Power spectral densities of torque and of its noise, and the band chosen by them.

    Attributes:
        frequency: Frequencies. Shape (F,) [Hz].
        torque: Density of the measured torque. Shape (F, n) [(N m)²/Hz].
        noise: Density of the torque noise. Shape (F, n) [(N m)²/Hz].
        motion: Bandwidth of the motion [Hz], see `motion_bandwidth`.
        hertz: Cutoff frequency [Hz].
    """

    frequency: FloatArray
    torque: FloatArray
    noise: FloatArray
    motion: float
    hertz: float


def require_sampled(segments: Sequence[RecordingSegment], hertz: float) -> None:
    """Check that every segment is sampled fast enough for a stated cutoff frequency.

    Args:
        segments: Segments of recordings.
        hertz: Cutoff frequency [Hz].

    Raises:
        UnusableInput: A segment has no more than two samples per period of the cutoff frequency.
    """
    slowest = min(segments, key=lambda segment: segment.rate)
    if hertz >= 0.5 * slowest.rate:
        raise UnusableInput(
            f"--band {hertz:g}: must be below half of the recording's rate, which is "
            f"{0.5 * slowest.rate:.4g} Hz at {slowest.source}; lower it, or leave that one out"
        )


def torque_spectra(
    segments: Sequence[RecordingSegment],
    hertz: float | None = None,
    carried: Callable[[RecordingSegment], float] | None = None,
    others: Sequence[RecordingSegment] = (),
) -> TorqueSpectra:
    """Compute the spectra of the longest segment and choose the cutoff frequency by them.

    The cutoff is 20 Hz, higher if the motion is faster, lower if noise covers the torque before, if
    positions do not carry the accelerations (`position_bandwidth`), or as the rate of the slowest
    segment requires.
    The noise spectrum is that of the deviations between periods if there are any, else the median
    density above half of the Nyquist frequency.

    Args:
        segments: Segments of recordings.
        hertz: Cutoff frequency to use instead [Hz].
        carried: Returns the highest frequency up to which a segment's positions carry its
            accelerations [Hz], of which the lowest counts; None: not limited.
        others: Further segments that are filtered likewise, of which only the rate counts.

    Raises:
        UnusableInput: A segment is too slow for `hertz`.
    """
    from scipy import signal  # slow to import

    if hertz is not None:
        require_sampled([*segments, *others], hertz)
    slowest = min(segment.rate for segment in (*segments, *others))
    longest = leading_segments([max(segments, key=len)], CHUNK_SAMPLES)[0]
    rate, size = longest.rate, _welch_window(longest)
    frequency, torque = signal.welch(longest.torque, rate, nperseg=size, axis=0, detrend="linear")
    if longest.noise is not None:
        noise = np.mean(
            [signal.welch(deviation, rate, nperseg=size, axis=0)[1] for deviation in longest.noise],
            axis=0,
        )
        noise *= longest.periods / (longest.periods - 1)
    else:
        noise = np.tile(np.median(torque[frequency >= 0.25 * rate], axis=0), (len(frequency), 1))
    motion = motion_bandwidth(longest)
    chosen = _chosen_cutoff(frequency, torque, noise, motion, slowest) if hertz is None else hertz
    if hertz is None and carried is not None:
        lowest = min(map(carried, longest_of_each_recording(segments)))
        chosen = min(chosen, max(lowest, usable_from_hertz([longest])))
    return TorqueSpectra(frequency, torque, noise, motion, chosen)


def usable_from_hertz(segments: Sequence[RecordingSegment]) -> float:
    """Return the cutoff frequency from which the filter leaves half of the longest segment [Hz].

    Args:
        segments: Segments of recordings.
    """
    longest = max(segments, key=len)
    duration = len(longest) / longest.rate
    return 0.0 if longest.periodic else 2.0 * settling_time(1.0) / (MIN_KEPT_SHARE * duration)


def motion_bandwidth(segment: RecordingSegment) -> float:
    """Return the frequency below which 99 % of the power of the joint velocities lies [Hz]."""
    from scipy import signal  # slow to import

    size = _welch_window(segment)
    frequency, speed = signal.welch(
        np.gradient(segment.q, 1.0 / segment.rate, axis=0), segment.rate, nperseg=size, axis=0
    )
    share = np.cumsum((speed / np.maximum(speed.sum(axis=0), 1e-300)).sum(axis=1)) / speed.shape[1]
    return float(frequency[np.searchsorted(share, 0.99 * share[-1])])


def _welch_window(segment: RecordingSegment) -> int:
    """Number of samples per window of Welch's method."""
    return min(len(segment), max(256, int(4.0 * segment.rate)))


def _chosen_cutoff(
    frequency: FloatArray, torque: FloatArray, noise: FloatArray, motion: float, rate: float
) -> float:
    """Cutoff frequency by the bandwidth of the motion and the frequency at which noise prevails.

    `rate`: the lowest sample rate [Hz].
    """
    lowest = min(max(TORQUE_BANDWIDTH_RATIO * motion, 5.0), MAX_BAND_HZ, 0.4 * rate)
    above = (torque > MIN_TORQUE_TO_NOISE_POWER * noise).any(axis=1)
    noisy_from = float(frequency[np.flatnonzero(above)[-1]]) if above.any() else lowest
    return float(
        min(
            max(lowest, min(DEFAULT_BAND_HZ, noisy_from)),
            0.4 * rate,
            max(DEFAULT_BAND_HZ, lowest),
        )
    )


def split_into_chunks(
    segment: RecordingSegment | Recording,
    overlap: int,
    multiple: int,
    chunk_samples: int | None = None,
) -> Iterator[tuple[slice, slice]]:
    """Split a long aperiodic segment into overlapping chunks that are processed one by one.

    Args:
        segment: The segment.
        overlap: Minimum number of samples that a chunk shares with its neighbour at either end.
        multiple: Chunks start at multiples of this number of samples.
        chunk_samples: Number of samples of a chunk without its overlap; None: `CHUNK_SAMPLES`.

    Yields:
        The rows of a chunk, and those of its rows (relative to its start) that are not overlap.
    """
    chunk_samples = chunk_samples or CHUNK_SAMPLES
    is_periodic = isinstance(segment, RecordingSegment) and segment.periodic
    if is_periodic or len(segment) <= chunk_samples + 2 * overlap:
        yield slice(0, len(segment)), slice(0, len(segment))
        return
    size, margin = -(-chunk_samples // multiple) * multiple, -(-overlap // multiple) * multiple
    starts = list(range(0, len(segment), size))
    if len(segment) - starts[-1] <= 2 * overlap:
        starts.pop()
    for k, start in enumerate(starts):
        stop = len(segment) if k == len(starts) - 1 else start + size
        begin, end = max(0, start - margin), min(len(segment), stop + margin)
        yield slice(begin, end), slice(start - begin, stop - begin)
