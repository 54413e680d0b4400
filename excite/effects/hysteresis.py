"""Presliding hysteresis: friction that builds up over a travel after each reversal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from .._types import FloatArray, IntArray
from .effect import CandidateModel, Effect, no_candidates, single_joint_rows
from .recorded_motion import RecordedMotion, radian

DENSE_REACH = 1e-3
"""Deflection at which the first element of `dense_model` slips [rad], see `recorded_motion.radian`.
"""
REACH_RATIOS = 2.0 ** np.arange(0.0, 8.0, 0.5)
"""Deflections at which all of them slip, over that of the first."""
UNEQUAL_ELEMENTS = [6, 10]
"""Elements of `dense_model` that may have unequal branches."""


def maxwell_slip(q: FloatArray, reach: float) -> FloatArray:
    """Return the force of a Maxwell-slip element of unit strength (Iwan 1966).

    Args:
        q: Joint position, shape (M,).
        reach: Deflection at which the element slips [rad or m].
    """
    stroke, travel, distance = _strokes(q)
    *starts, _ = accumulate(
        (travel / reach).tolist(), lambda z, step: min(max(z + step, -1.0), 1.0), initial=0.0
    )
    return np.clip(np.array(starts)[stroke] + distance / reach, -1.0, 1.0)


def _strokes(q: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Divide a motion at its reversals.

    Returns:
        The stroke of each sample, (M,); the travel of each stroke; and the distance of each sample
        from the start of its stroke, (M,).
    """
    directions = np.sign(np.diff(q, prepend=q[0]))
    # first sample of each stroke; the stroke starts at the sample before
    first = np.flatnonzero(np.diff(directions, prepend=2.0))
    stroke = np.repeat(np.arange(len(first)), np.diff(first, append=len(q)))
    corners = q[np.maximum(first - 1, 0)]
    return stroke, np.diff(corners, append=q[-1]), q - corners[stroke]


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Presliding friction minus the smooth sign function that it replaces."""
    j = model.joint_index
    reaches = model.values["reach"] * REACH_RATIOS

    def low_passed() -> FloatArray:
        q = motion.samples.q[:, j]
        elements = np.column_stack([maxwell_slip(q, d) for d in reaches.tolist()])
        unequal = np.abs(elements[:, UNEQUAL_ELEMENTS]) - 1.0
        return motion.lowpass(np.hstack([elements, unequal]))

    name = f"Maxwell-slip elements of joint {j} from {reaches[0]}"
    columns = motion.for_all_fits(name, low_passed).copy()
    columns[:, : len(REACH_RATIOS)] -= motion.lowpass(motion.sign(j)[:, None])
    return single_joint_rows(motion, j, columns)


def dense_model(motions: Sequence[RecordedMotion], joint: int) -> CandidateModel:
    """Return a nonnegative combination of Maxwell-slip elements of a joint.

    The last columns, of either sign, make the two branches of the loop unequal.
    """
    count, reach = len(REACH_RATIOS), DENSE_REACH * radian(motions, joint)
    reaches = reach * REACH_RATIOS
    return CandidateModel(
        "hysteresis",
        joint,
        _columns,
        {"elements": float(count), "reach": reach},
        parameters=lambda c: {
            "amplitude": float(c[:count].sum()),
            "stiffness": float(np.sum(c[:count] / reaches)),
        },
        nonnegative=(True,) * count + (False,) * len(UNEQUAL_ELEMENTS),
    )


HYSTERESIS = Effect(
    "hysteresis",
    "F z, ż = σ q̇ (1 − z sgn q̇) (Dahl 1968), or Maxwell-slip elements ż = q̇/s, |z| ≤ 1 "
    "(Iwan 1966), instead of F sgn q̇",
    _columns,
    no_candidates,
    {"amplitude": "N m", "stiffness": "N m/rad"},
    "friction takes some way to build up after a reversal",
    "strokes of many small amplitudes",
    form_std={"amplitude": 0.1, "stiffness": 0.4},
)
"""Presliding friction; users call it friction hysteresis, LuGre or Dahl friction."""
