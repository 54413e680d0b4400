"""Presliding hysteresis: friction that builds up over a travel after each reversal.

Coulomb friction builds up in Maxwell-slip elements. So may the other dry frictions of the joint,
Stribeck and load friction, as in the LuGre model (Canudas de Wit et al. 1995) and in generalised
Maxwell-slip (Al-Bender, Lampaert & Swevers 2005): `direction`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate

import numpy as np

from .._types import FloatArray, IntArray
from .effect import CandidateModel, Effect, no_candidates, single_joint_rows
from .recorded_motion import RecordedMotion, radian

import os
N=int(os.environ.get("EX_N","10")); ND=int(os.environ.get("EX_D","5")); LO=float(os.environ.get("EX_LO","2.5e-4"))
DENSE_REACH = LO
"""Deflection at which the first element of `dense_model` slips [rad], see `recorded_motion.radian`.
"""
REACH_RATIOS = np.arange(float(N))
LAST_REACH = 0.128
"""Deflections at which all of them slip, over that of the first."""
UNEQUAL_ELEMENTS = [int(.56*N), int(.78*N)]
"""Elements of `dense_model` that may have unequal branches."""
DAMPED_ELEMENTS = [i*N//ND for i in range(ND)]
"""Elements of `dense_model` that may be damped while they stick."""
DAMPING_TIME = 0.01
"""Damping over stiffness of an element that a damping coefficient is the force of [s]."""


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


def reaches_of(values):
    return np.geomspace(values["reach"], values["last_reach"], N)


def _elements(motion: RecordedMotion, joint: int, values) -> FloatArray:
    """Forces of the elements of a joint, the first of which slips at `reach`, shape (M, k)."""

    def compute() -> FloatArray:
        q, reaches = motion.samples.q[:, joint], reaches_of(values)
        return np.column_stack([maxwell_slip(q, d) for d in reaches.tolist()])

    return motion.for_all_fits(f"Maxwell-slip elements of joint {joint} from {values['reach']}", compute)


def build_up(model: CandidateModel, c: FloatArray, coulomb: float) -> dict[str, float]:
    """Return how the dry friction of a joint builds up: the values that `direction` needs.

    The elements have shares of it, and what remains of Coulomb friction needs no travel.

    Args:
        model: What `dense_model` returns.
        c: Its coefficients, shape (k,).
        coulomb: Coulomb friction of the joint [N m].
    """
    strengths = c[: len(REACH_RATIOS)]
    total = max(coulomb, float(strengths.sum()), 1e-300)
    return {k: model.values[k] for k in ("reach", "last_reach")} | {
        f"share_{i}": strength / total for i, strength in enumerate(strengths.tolist())
    }


def built_up_share(values: Mapping[str, float]) -> float:
    """Return the share of the dry friction that builds up, of the values of `build_up`."""
    return sum(value for key, value in values.items() if key.startswith("share_"))


def direction(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the direction of a dry friction, within -1 and 1, shape (M,).

    It is the smooth sign of the speed, or, if the values of the model say how the friction builds
    up, the mean of the Maxwell-slip elements.

    Args:
        motion: The recorded motion.
        model: A friction of one joint.
    """
    j, values = model.joint_index, model.values
    sign = motion.sign(j)
    if "share_0" not in values:
        return sign
    shares = np.array([values[f"share_{i}"] for i in range(len(REACH_RATIOS))])
    built_up = _elements(motion, j, values) @ shares
    return np.asarray(built_up + (1.0 - shares.sum()) * sign)


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Presliding friction minus the smooth sign function that it replaces."""
    j, reach = model.joint_index, model.values["reach"]

    def low_passed() -> FloatArray:
        elements = _elements(motion, j, model.values)
        unequal = np.abs(elements[:, UNEQUAL_ELEMENTS]) - 1.0
        damped = elements[:, DAMPED_ELEMENTS]
        rates = motion.samples.dq[:, [j]] / reaches_of(model.values)[DAMPED_ELEMENTS]
        damping = np.where(np.abs(damped) < 1.0, DAMPING_TIME * rates, 0.0)
        return motion.lowpass(np.hstack([elements, unequal, damping]))

    name = f"low-passed Maxwell-slip elements of joint {j} from {reach}"
    columns = motion.for_all_fits(name, low_passed).copy()
    columns[:, : len(REACH_RATIOS)] -= motion.lowpass(motion.sign(j)[:, None])
    return single_joint_rows(motion, j, columns)


def dense_model(motions: Sequence[RecordedMotion], joint: int) -> CandidateModel:
    """Return a nonnegative combination of Maxwell-slip elements of a joint.

    The last columns, of either sign, make the two branches of the loop unequal.
    """
    count, unit = len(REACH_RATIOS), radian(motions, joint)
    step = max(float(motion.steps[joint]) for motion in motions)
    values = {"elements": float(count), "reach": min(max(DENSE_REACH * unit, step), 0.03*unit), "last_reach": LAST_REACH * unit}
    reaches = reaches_of(values)
    return CandidateModel(
        "hysteresis",
        joint,
        _columns,
        values,
        parameters=lambda c: {
            "amplitude": float(c[:count].sum()),
            "stiffness": float(np.sum(c[:count] / reaches)),
        },
        nonnegative=(True,) * count
        + (False,) * len(UNEQUAL_ELEMENTS)
        + (True,) * len(DAMPED_ELEMENTS),
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
