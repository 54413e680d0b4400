"""Contact: an external force on a link for some of the time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from ..recordings.missing_values import true_runs
from .effect import CandidateModel, Effect
from .recorded_motion import RecordedMotion

WINDOWS = 40
"""Windows of a recording among which a contact is sought."""
COURSES = ((0.0, 0.0, 0.0), (0.15, 0.0, 0.0), (0.15, 1.0, 0.0), (0.4, 1.0, 0.0), (0.0, 0.0, 8.0))
"""Time courses of the force that are tried, each (extension, swells, knots).

Extension of the interval on either side over its length [1]; 1 if the force rises and falls as half
a sine, 0 if it is constant; number of knots of a piecewise linear course, 0 for the other two.
"""
KNOT_EXTENSION = 0.3
"""Extension of a piecewise linear course before and after the interval, over its length."""
MIN_INTERVAL_POWER = 3.0
"""Smoothed residual power over its median from which an interval stands out."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the torque −Jᵀ f of a force f on a link's centre of mass during an interval.

    The force is in the base frame; one column per basis function and component. Shape (C, n, 3 k).
    """
    course = _course(motion, model)
    torque = -np.einsum("tk,txj->tjkx", course, motion.link_jacobians[:, model.joint_index])
    return motion.lowpass(torque.reshape(*torque.shape[:2], -1), Grid.COARSE)


def _course(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the basis functions of the force over time, at the coarse samples. Shape (C, k)."""
    assert model.interval is not None
    low, high = model.interval
    rate = motion.band.rate_of(Grid.COARSE)
    time = motion.segment.start + np.arange(len(motion.coarse_samples)) / rate
    u = (time - low) / (high - low)
    inside = (u > 0.0) & (u < 1.0) & (motion.segment.source == model.source)
    if not model.values["knots"]:
        return np.where(inside, np.sin(np.pi * u) if model.values["swells"] else 1.0, 0.0)[:, None]
    count = int(model.values["knots"])
    u = (u + KNOT_EXTENSION) / (1.0 + 2.0 * KNOT_EXTENSION) * (count + 1.0)
    hats = np.maximum(1.0 - np.abs(u[:, None] - np.arange(1, count + 1)), 0.0)
    return hats * (motion.segment.source == model.source)


def _largest_force(c: FloatArray) -> dict[str, float]:
    """Return the largest force of the course [N]."""
    return {"force": float(np.linalg.norm(c.reshape(-1, 3), axis=1).max())}


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Yield forces on every link in the intervals in which the base model's residual stands out."""
    for motion in motions:
        usual = np.median(np.abs(motion.residual), axis=0) + 1e-12
        power = np.mean((motion.residual / usual) ** 2, axis=1)
        for low, high in _intervals(motion.time, power):
            for extension, swells, knots in COURSES:
                interval = low - extension * (high - low), high + extension * (high - low)
                for joint in range(motions[0].n):
                    yield CandidateModel(
                        "contact",
                        joint,
                        _columns,
                        {"swells": swells, "knots": knots},
                        None,
                        interval,
                        motion.segment.source,
                        _largest_force,
                    )


def _intervals(time: FloatArray, power: FloatArray) -> list[tuple[float, float]]:
    """Return up to two intervals in which the residual power stands out, the largest first."""
    size = max(4, len(power) // WINDOWS)
    smooth = np.convolve(power, np.ones(size) / size, mode="same")
    level = MIN_INTERVAL_POWER * np.median(smooth)
    intervals = [
        (float(time[a]), float(time[min(b, len(time) - 1)]), float(smooth[a:b].sum()))
        for a, b in true_runs(smooth > level)
        if b - a >= 3
    ]
    return [(a, b) for a, b, _ in sorted(intervals, key=lambda f: -f[2])[:2]]


CONTACT = Effect(
    "contact",
    "Jᵀ f on an interval",
    _columns,
    _candidates,
    {"force": "N"},
    "for some of the time only, in the joints before the contact",
    (),
    "the same motion without anything near the robot",
    form_std={"force": 0.1},
)
"""Collision or contact with the environment or a person."""
