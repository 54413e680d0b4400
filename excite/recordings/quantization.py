"""Positions that an encoder rounded: of all that it would have read so, the smoothest.

    q̂ = argmin ∫ (d²q/dt²)² dt  with  |q̂ − q_read| ≤ Δ/2 at every row,

Δ the encoder's step. A reading is no number with noise but an interval, and a low-pass takes no
notice of it: where a joint moves slowly, a staircase has its noise where the motion is. Curvature,
not its slope: friction that reverses makes acceleration jump, and a motion that may not turns back
so gently that friction seems to be of another law. Solved by alternating directions (Boyd et al.,
Foundations and Trends in Machine Learning 3, 2011, section 5): a filter, then the nearest within
the steps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .padding import reflected
from .recording import SHORTEST
from .time_axis import pieces

Array = np.ndarray
FINE = 1e-5
"""Steps below which nobody needs more [rad or m]."""
HERTZ, USUAL = 40.0, 1e-4
"""Corner of the filter [Hz], and for which steps [rad or m]: any leads to the same motion, but this
one soon. It falls with the fourth root of the steps: the coarser they are, the longer a motion
stays within one."""
ROUNDS, FURTHER = 80, 1.6
"""Times that is done, and how much further than it leads each goes."""
REACH = 1.0
"""How far a stretch is continued at its ends [s]."""
OUTSIDE, SLACK = 0.02, 0.05
"""Share of rows that may lie outside their steps, by more than this part of one."""
EDGE, PILED = 0.45, 0.17
MIDDLE, FEW = 0.25, 0.65
"""What rounding takes off is spread evenly over ± half a step. Noise besides, of a sixth of one,
piles it up beyond EDGE of a step, where more than PILED of the rows then are; positions that were
never rounded, multiples of something by chance, leave more than FEW within MIDDLE. Either would be
made worse, and is left as read. Of pure rounding 0.06 to 0.10 and 0.5 were seen."""
MOVED = 0.02
"""A reading that is the same so long before and after tells nothing of that: the joint stands
[s]."""


def smoothest(t: Array, q: Array, steps: Array) -> tuple[Array, Array]:
    """Positions within the steps of their encoders, and of which joints they are: of the others
    they are as read.

    t: [s]. q: Shape (N, n). steps: Δ, 0 where none is known. Shape (n,).
    """
    out, step = q.copy(), float(np.median(np.diff(t)))
    stretches = [rows for rows in pieces(t, step) if rows.stop - rows.start >= SHORTEST]
    smoothed = np.zeros(q.shape[1], bool)
    for j in np.flatnonzero(steps > FINE) if stretches else ():
        found = [unrounded(q[rows, j], float(steps[j]), step) for rows in stretches]
        if _only_rounded(
            [q[rows, j] for rows in stretches], found, float(steps[j]), max(1, int(MOVED / step))
        ):
            smoothed[j] = True
            for rows, line in zip(stretches, found, strict=True):
                out[rows, j] = line
    return out, smoothed


def _only_rounded(
    read: Sequence[Array], found: Sequence[Array], resolution: float, reach: int
) -> bool:
    """Whether what was read differs from the smoothest as rounding makes it. reach: rows."""
    off = [np.abs(a - b) / resolution for a, b in zip(read, found, strict=True)]
    if np.mean(np.concatenate(off) > 0.5 + SLACK) > OUTSIDE:
        return False
    moving = np.concatenate(
        [o[reach:-reach][a[2 * reach :] != a[: -2 * reach]] for o, a in zip(off, read, strict=True)]
    )
    return not len(moving) or bool(
        np.mean(moving > EDGE) < PILED and np.mean(moving < MIDDLE) < FEW
    )


def unrounded(read: Array, resolution: float, step: float) -> Array:
    """The smoothest line within half a resolution of what was read, evenly each `step` [s]. Shapes
    (N,) -> (N,)."""
    from scipy import fft  # slow to import

    count = len(read)
    head = min(count - 1, int(REACH / step))
    tail = min(fft.next_fast_len(count + 2 * head, real=True) - count - head, count - 1)
    line = reflected(read, head, tail)
    slope = np.linspace(line[0], line[-1], len(line))
    line = line - slope  # closed
    corner = HERTZ * (USUAL / resolution) ** 0.25
    low = 1.0 / (1.0 + (fft.rfftfreq(len(line), step) / corner) ** 4)
    within, off, smooth = line.copy(), np.zeros_like(line), line
    for _ in range(ROUNDS):
        smooth = fft.irfft(low * fft.rfft(within - off), len(line))
        further = FURTHER * smooth + (1.0 - FURTHER) * within
        within = np.clip(further + off, line - 0.5 * resolution, line + 0.5 * resolution)
        off += further - within
    return np.asarray((smooth + slope)[head : head + count])
