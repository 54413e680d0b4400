"""Positions that an encoder rounded: of all that it would have read so, the smoothest.

    q̂ = argmin ∫ (d²q/dt²)² dt  with  |q̂ − q_read| ≤ Δ/2 at every row,

Δ the encoder's step. A reading is no number with noise but an interval, and a low-pass takes no notice of it: where a joint moves slowly, a
staircase has its noise where the motion is. Curvature, not its slope: friction that reverses makes acceleration jump, and a motion that may
not turns back so gently that friction seems to be of another law. Solved by alternating directions (Boyd et al., Foundations and Trends in
Machine Learning 3, 2011, section 5): a filter, then the nearest within the steps.
"""

from __future__ import annotations

import numpy as np

from .clock import pieces

Array = np.ndarray
FINE = 1e-5
"""Steps below which nobody needs more [rad or m]."""
HERTZ, USUAL = 40.0, 1e-4
"""Corner of the filter [Hz], and for which steps [rad or m]: any leads to the same motion, but this one soon. It falls with the fourth root
of the steps: the coarser they are, the longer a motion stays within one."""
ROUNDS, FURTHER = 80, 1.6
"""Times that is done, and how much further than it leads each goes."""
REACH = 1.0
"""How far a stretch is continued at its ends [s]."""
OUTSIDE, SLACK = 0.02, 0.05
"""Share of rows that may lie outside their steps, by more than this part of one; else what was read has other noise, and is left."""
SHORTEST = 1.0
"""Of a stretch [s]."""


def smoothest(t: Array, q: Array, steps: Array) -> tuple[Array, Array]:
    """Positions within the steps of their encoders, and of which joints they are: of the others they are as read.

    t: [s]. q: Shape (N, n). steps: Δ, 0 where none is known. Shape (n,).
    """
    out, step, coarse = q.copy(), float(np.median(np.diff(t))), np.flatnonzero(steps > FINE)
    for rows in pieces(t, step):
        if (rows.stop - rows.start) * step < SHORTEST or not len(coarse):
            continue
        read = q[rows][:, coarse].T
        found = unrounded(read, steps[coarse], step)
        beyond = np.mean(np.abs(found - read) > (0.5 + SLACK) * steps[coarse][:, None], axis=1)
        coarse, found = coarse[beyond < OUTSIDE], found[beyond < OUTSIDE]
        out[rows, coarse] = found.T
    kept = np.isin(np.arange(q.shape[1]), coarse)
    out[:, ~kept] = q[:, ~kept]
    return out, kept


def unrounded(read: Array, steps: Array, step: float) -> Array:
    """The smoothest lines within half their steps of what was read, evenly each `step` [s]. Shapes (n, N), (n,) -> (n, N)."""
    from scipy import fft  # slow to import

    count = read.shape[1]
    head = min(count - 1, int(REACH / step))
    length = fft.next_fast_len(count + 2 * head, real=True)
    tail = min(length - count - head, count - 1)
    lines = np.hstack([2.0 * read[:, :1] - read[:, head:0:-1], read, 2.0 * read[:, -1:] - read[:, -2 : -tail - 2 : -1]])
    slope = lines[:, :1] + (lines[:, -1:] - lines[:, :1]) * np.linspace(0.0, 1.0, lines.shape[1])
    lines = lines - slope  # closed
    half = 0.5 * steps[:, None]
    corner = HERTZ * (USUAL / steps[:, None]) ** 0.25
    low = 1.0 / (1.0 + (fft.rfftfreq(lines.shape[1], step) / corner) ** 4)
    within, off = lines.copy(), np.zeros_like(lines)
    smooth = lines
    for _ in range(ROUNDS):
        smooth = fft.irfft(low * fft.rfft(within - off), lines.shape[1])
        further = FURTHER * smooth + (1.0 - FURTHER) * within
        within = np.clip(further + off, lines - half, lines + half)
        off += further - within
    return np.asarray((smooth + slope)[:, head : head + count])
