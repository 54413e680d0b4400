"""Smoothing of quantized positions within the resolution of their encoders.

    q̂ = argmin ∫ (d²q/dt²)² dt  subject to  |q̂ − q_read| ≤ Δ/2 at every row,

with the encoder's resolution Δ. A reading is an interval, not a value with white noise: where a
joint moves slowly, the quantization error is a staircase with power in the band of the motion,
which a low-pass filter keeps. The penalty is on curvature and not on its derivative because
acceleration jumps where friction reverses; a penalty on jerk would smooth the reversals and bias
the friction model. The problem is solved by the alternating direction method of multipliers (Boyd
et al., Foundations and Trends in Machine Learning 3, 2011, section 5): a filter, then a projection
on the intervals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._types import BoolArray, FloatArray
from .padding import pad_to_fast_length
from .recording import MIN_ROWS
from .time_axis import gap_free_slices

MIN_RESOLUTION = 1e-5
"""Resolution up to which quantization is of no concern [rad or m]."""
FILTER_CORNER = 40.0
"""Corner of the filter for REFERENCE_RESOLUTION [Hz]. Any corner leads to the same solution; this
one converges fast. It decreases with the fourth root of the resolution, as a coarser encoder keeps
a motion in an interval for longer."""
REFERENCE_RESOLUTION = 1e-4
"""Resolution for which FILTER_CORNER holds [rad or m]."""
ITERATIONS = 80
"""Iterations of the alternating direction method."""
OVERRELAXATION = 1.6
"""Over-relaxation of its steps [1]."""
PADDING_TIME = 1.0
"""Time by which a stretch is continued at its ends [s]."""
VIOLATION_TOLERANCE = 0.05
"""Violation of the interval that counts as none, over the resolution [1]."""
MAX_VIOLATION_SHARE = 0.02
"""Share of rows that may violate their interval [1]."""
EDGE_ERROR = 0.45
"""Error over the resolution from which a row counts as at the edge of its interval [1]."""
MAX_EDGE_SHARE = 0.17
"""Share of moving rows at the edge above which positions have noise of other kinds as well [1]. An
error of pure quantization is uniform in ±Δ/2, 0.06 to 0.10 were observed; noise of a sixth of Δ
moves more rows to the edge."""
CENTRE_ERROR = 0.25
"""Error over the resolution up to which a row counts as in the centre of its interval [1]."""
MAX_CENTRE_SHARE = 0.65
"""Share of moving rows in the centre above which positions were not quantized and are multiples of
a step by chance [1]; 0.5 was observed for pure quantization."""
STANDSTILL_TIME = 0.02
"""A row whose reading is the same so long before and after belongs to a joint at standstill [s]."""


def smooth_positions(
    t: FloatArray, q: FloatArray, resolution: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Replace quantized positions by the smoothest within their intervals.

    Positions of joints whose error does not look like quantization are kept.

    Args:
        t: Times, evenly spaced but for gaps. Shape (N,) [s].
        q: Positions. Shape (N, n) [rad or m].
        resolution: Resolution Δ of each joint, 0 where it is not known. Shape (n,) [rad or m].

    Returns:
        Positions, shape (N, n), and a mask of the smoothed joints, shape (n,).
    """
    out, step = q.copy(), float(np.median(np.diff(t)))
    stretches = [rows for rows in gap_free_slices(t, step) if rows.stop - rows.start >= MIN_ROWS]
    smoothed = np.zeros(q.shape[1], bool)
    standstill_rows = max(1, int(STANDSTILL_TIME / step))
    for j in np.flatnonzero(resolution > MIN_RESOLUTION) if stretches else ():
        read = [q[rows, j] for rows in stretches]
        smooth = [smoothest_line(values, float(resolution[j]), step) for values in read]
        if _is_quantization_error(read, smooth, float(resolution[j]), standstill_rows):
            smoothed[j] = True
            for rows, line in zip(stretches, smooth, strict=True):
                out[rows, j] = line
    return out, smoothed


def _is_quantization_error(
    read: Sequence[FloatArray],
    smooth: Sequence[FloatArray],
    resolution: float,
    standstill_rows: int,
) -> bool:
    """Return True if readings differ from the smoothest lines as quantization makes them differ."""
    errors = [np.abs(a - b) / resolution for a, b in zip(read, smooth, strict=True)]
    if np.mean(np.concatenate(errors) > 0.5 + VIOLATION_TOLERANCE) > MAX_VIOLATION_SHARE:
        return False
    k = standstill_rows
    moving = np.concatenate(
        [
            error[k:-k][values[2 * k :] != values[: -2 * k]]
            for error, values in zip(errors, read, strict=True)
        ]
    )
    return not len(moving) or bool(
        np.mean(moving > EDGE_ERROR) < MAX_EDGE_SHARE
        and np.mean(moving < CENTRE_ERROR) < MAX_CENTRE_SHARE
    )


def smoothest_line(read: FloatArray, resolution: float, step: float) -> FloatArray:
    """Find the line of least curvature within half a resolution of readings.

    Args:
        read: Readings at even times. Shape (N,) [rad or m].
        resolution: Resolution Δ of the encoder [rad or m].
        step: Time step [s].

    Returns:
        Positions. Shape (N,) [rad or m].
    """
    from scipy import fft  # slow to import

    count = len(read)
    line, head = pad_to_fast_length(read, int(PADDING_TIME / step))
    trend = np.linspace(line[0], line[-1], len(line))
    line = line - trend  # periodic
    corner = FILTER_CORNER * (REFERENCE_RESOLUTION / resolution) ** 0.25
    gain = 1.0 / (1.0 + (fft.rfftfreq(len(line), step) / corner) ** 4)
    projected, multiplier, smooth = line.copy(), np.zeros_like(line), line
    for _ in range(ITERATIONS):
        smooth = fft.irfft(gain * fft.rfft(projected - multiplier), len(line))
        relaxed = OVERRELAXATION * smooth + (1.0 - OVERRELAXATION) * projected
        projected = np.clip(relaxed + multiplier, line - 0.5 * resolution, line + 0.5 * resolution)
        multiplier += relaxed - projected
    return np.asarray((smooth + trend)[head : head + count])
