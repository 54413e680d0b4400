"""How coarse encoders are, by the positions they were read at: told before these are put on another grid."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def noise(positions: Array) -> Array:
    """Standard deviation of positions by the encoder's resolution, step/√12. Shapes (M, n) -> (n,) [rad or m]."""
    out = np.zeros(positions.shape[1])
    for joint, q in enumerate(positions.T):
        steps = np.abs(np.diff(q))
        steps = steps[steps > 1e-12]
        if len(steps):
            out[joint] = _resolution(steps, len(q)) / np.sqrt(12.0)
    return out


def _resolution(steps: Array, samples: int) -> float:
    """Of what these are multiples, as most rows are of an encoder; 0 where they are of nothing."""
    least = float(steps.min())
    few = steps[steps < 50.0 * least]  # more would show the digits that a file leaves out
    whole = np.round(few / least)
    if len(few) > 20 and np.mean(np.abs(few / least - whole) < 0.1) > 0.99:
        return float(np.median(few / whole))
    repeated = samples - 1 - len(steps) > 0.02 * samples
    return float(np.percentile(steps, 1.0)) if repeated else 0.0
