"""How coarse encoders are, by the positions they were read at: told before these are put on another
grid."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def noise(positions: Array) -> Array:
    """Standard deviation of positions by the encoder's resolution, step/√12. Shapes (M, n) -> (n,)
    [rad or m]."""
    return np.array([_resolution(_steps(q), len(q)) for q in positions.T]) / np.sqrt(12.0)


def steps(positions: Array) -> Array:
    """Of what changes of position are multiples, 0 where they are of nothing. Shapes (M, n) -> (n,)
    [rad or m]."""
    return np.array([_multiple(_steps(q)) for q in positions.T])


def _steps(q: Array) -> Array:
    found = np.abs(np.diff(q))
    return np.asarray(found[found > 1e-12])


def _multiple(steps: Array) -> float:
    """Of what these are multiples, as most rows are of an encoder; 0 where they are of nothing."""
    least = float(steps.min(initial=np.inf))
    few = steps[steps < 50.0 * least]  # more would show the digits that a file leaves out
    whole = np.round(few / least)
    return (
        float(np.median(few / whole))
        if len(few) > 20 and np.mean(np.abs(few / least - whole) < 0.1) > 0.99
        else 0.0
    )


def _resolution(steps: Array, samples: int) -> float:
    """The same; or what the least are, where positions repeat."""
    repeated = len(steps) > 0 and samples - 1 - len(steps) > 0.02 * samples
    return _multiple(steps) or (float(np.percentile(steps, 1.0)) if repeated else 0.0)
