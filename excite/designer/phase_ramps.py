"""Ramps along the path of the periodic motion, whose phase accelerates from standstill.

Where f is the periodic motion, such a ramp is f(σ(t)) with a phase rate σ̇ that rises from 0 to 1
(ramp-in) or falls from 1 to 0 (ramp-out), and a phase acceleration that is 0 at both ends. It stays
on the path of f, so that position limits, boxes and clearances hold by construction (Bobrow,
Dubowsky and Gibson, IJRR 1985, for motion along a path). All other limits are checked.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._types import FloatArray
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import JerkProfile, PhaseProfile
from . import constraint_margins
from .constraint_margins import MotionConstraints

SHORTEST_DURATION = 0.08
"""Shortest duration that is tried [s]: twice the time grid of the segments."""

DURATION_RATIO = 1.3
"""Ratio of a duration to the previous one that is tried [1]."""

MAX_PERIODS = 2.0
"""Longest duration that is tried over the period [1]; the phase advances by half of it."""

COARSE_SAMPLES = 12
"""Samples of a ramp that discard most durations before all limits are checked [1]."""

MAX_RATIO = 1.0 - 1e-6
"""Largest ratio of a quantity to its limit on a ramp [1]: the rest is for rounding."""


def phase_profile(fourier: FourierSeries, duration: float, *, inwards: bool) -> PhaseProfile:
    """Return the ramp of a given duration T.

    The phase has a jerk of ±4/T², changing its sign at T/2, so that its rate rises by 1 and the
    phase itself advances by T/2.

    Args:
        fourier: Periodic motion, which begins at the end of the ramp-in and ends where the
            ramp-out begins.
        duration: Duration T [s].
        inwards: True for a ramp-in, False for a ramp-out.
    """
    jerk = 4.0 / duration**2 if inwards else -4.0 / duration**2
    half = 0.5 * duration
    start, rate = (-half, 0.0) if inwards else (0.0, 1.0)
    phase = JerkProfile(
        np.array([start]), np.array([rate]), np.zeros(1), (((half, jerk), (half, -jerk)),)
    )
    return PhaseProfile(fourier, phase)


def delayed_stop(fourier: FourierSeries, cruise: float, duration: float) -> PhaseProfile:
    """Return a ramp-out that follows the periodic motion for a while before it stops.

    Args:
        fourier: Periodic motion up to the start of the ramp.
        cruise: Time for which its phase goes on at rate 1 [s].
        duration: Duration of the stop that follows [s].
    """
    stop = phase_profile(fourier, duration, inwards=False).phase
    phase = JerkProfile(
        stop.position, stop.velocity, stop.acceleration, (((cruise, 0.0), *stop.pieces[0]),)
    )
    return PhaseProfile(fourier, phase)


def keeps_limits(
    constraints: MotionConstraints, profile: PhaseProfile, duration: float, step: float
) -> bool:
    """Return whether a ramp keeps all limits; clearances hold by its path.

    Args:
        constraints: Constraints, derived limits included.
        profile: The ramp.
        duration: Its duration [s].
        step: Time step at which the certificate will check it [s].
    """
    # a few samples discard most ramps cheaply
    times = duration * (np.arange(COARSE_SAMPLES) + 0.5) / COARSE_SAMPLES
    for order, limit in ((3, "jerk"), (2, "acceleration"), (1, "velocity")):
        if (np.abs(profile.at(times, order)) > getattr(constraints.limits, limit)).any():
            return False
    return all(
        quantity.largest_ratio() <= MAX_RATIO
        for _, quantity in constraint_margins.phase_quantities(constraints, profile, duration, step)
    )


def shortest_ramp(
    constraints: MotionConstraints,
    period: float,
    grid: float,
    step: float,
    ramp_of: Callable[[float], PhaseProfile],
    below: float = np.inf,
) -> tuple[PhaseProfile, float] | None:
    """Return the shortest ramp of the tried durations that keeps all limits.

    Args:
        constraints: Constraints, derived limits included.
        period: Period of the periodic motion [s].
        grid: Duration that ramps are multiples of [s].
        step: Time step at which the certificate will check it [s].
        ramp_of: Returns the ramp of a duration [s].
        below: Duration that the ramp has to undercut [s].

    Returns:
        The ramp and its duration [s]; None where there is none.
    """
    for duration in _durations(period, grid, below):
        ramp = ramp_of(duration)
        if keeps_limits(constraints, ramp, duration, step):
            return ramp, float(duration)
    return None


def _durations(period: float, grid: float, below: float) -> FloatArray:
    """Return the durations to try, ascending multiples of the grid [s]."""
    longest = MAX_PERIODS * period
    count = max(int(np.log(longest / SHORTEST_DURATION) / np.log(DURATION_RATIO)), 0) + 1
    durations = SHORTEST_DURATION * DURATION_RATIO ** np.arange(count + 1)
    rounded = np.unique(np.ceil(durations / grid - 1e-9)) * grid
    return np.asarray(rounded[(rounded <= longest + 1e-9) & (rounded < below - 1e-9)])
