"""Presliding hysteresis: friction that builds up over a travel after each reversal.

Coulomb friction builds up in Maxwell-slip elements. So may the other dry frictions of the joint,
Stribeck and load friction, as in the LuGre model (Canudas de Wit et al. 1995) and in generalised
Maxwell-slip (Al-Bender, Lampaert & Swevers 2005): `direction`. While an element sticks, it is
damped, as the bristles of the LuGre model are: σ₁ ż.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate

import numpy as np

from .._types import FloatArray, IntArray
from .effect import CandidateModel, Effect, Values, single_joint_rows
from .friction_runtime import ELEMENTS, LAST_REACH, UNEQUAL_ELEMENTS, damping, reaches, shares
from .recorded_motion import FittedRobot, Motions, RecordedMotion, for_all_fits, radian

FIRST_REACH = 2.5e-4
"""Deflection at which the first of the elements slips [rad], see `recorded_motion.radian`; it does
at no less than a step of the encoder."""
MAX_FIRST_REACH = 0.03
"""Largest deflection at which the first slips, over that of the last [1], so that a very coarse
encoder does not make all elements alike."""
STICKING_SHARE = 1e-6
"""Factor on the prior standard deviation of the strength of an element that never slips in both
directions [1]: such a motion shows only a spring, which a larger motion would not show."""


def maxwell_slip(q: FloatArray, reach: float) -> FloatArray:
    """Return the force of a Maxwell-slip element of unit strength (Iwan 1966), shape (M,).

    It slips at the deflection `reach` [rad or m].
    """
    stroke, travel, distance = _strokes(q)
    *starts, _ = accumulate(
        (travel / reach).tolist(), lambda z, step: min(max(z + step, -1.0), 1.0), initial=0.0
    )
    return np.clip(np.array(starts)[stroke] + distance / reach, -1.0, 1.0)


def _strokes(q: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return each sample's stroke (M,), travels of strokes, and distances in the strokes (M,)."""
    directions = np.sign(np.diff(q, prepend=q[0]))
    # first sample of each stroke; the stroke starts at the sample before
    first = np.flatnonzero(np.diff(directions, prepend=2.0))
    stroke = np.repeat(np.arange(len(first)), np.diff(first, append=len(q)))
    corners = q[np.maximum(first - 1, 0)]
    return stroke, np.diff(corners, append=q[-1]), q - corners[stroke]


def _bank(model: CandidateModel) -> tuple[int, float, float]:
    """Joint of a model, and reaches of the first and of the last element [rad or m]."""
    return model.joint_index, model.values["reach"], model.values["last_reach"]


@for_all_fits
def _elements(motion: RecordedMotion, joint: int, first: float, last: float) -> FloatArray:
    """Forces of the elements of a joint, shape (M, ELEMENTS)."""
    q, bank = motion.samples.q[:, joint], reaches({"reach": first, "last_reach": last})
    return np.column_stack([maxwell_slip(q, reach) for reach in bank.tolist()])


@for_all_fits
def _low_passed(motion: RecordedMotion, joint: int, first: float, last: float) -> FloatArray:
    """Low-passed forces of the elements, and by which unequal ones differ, shape (N, k)."""
    elements = _elements(motion, joint, first, last)
    return motion.lowpass(np.hstack([elements, np.abs(elements[:, UNEQUAL_ELEMENTS]) - 1.0]))


def build_up(model: CandidateModel, c: FloatArray, coulomb: float) -> dict[str, float]:
    """Return how the dry friction of a joint builds up: the values that `direction` needs.

    The elements of a `dense_model` with coefficients c have shares of it, and the part of the
    Coulomb friction [N m] beyond them needs no travel.
    """
    strengths = c[:ELEMENTS]
    total = max(coulomb, float(strengths.sum()), 1e-300)
    shares = {f"share_{i}": strength / total for i, strength in enumerate(strengths.tolist())}
    return {key: model.values[key] for key in ("reach", "last_reach")} | shares


def built_up_share(values: Mapping[str, float]) -> float:
    """Return the share of the dry friction that builds up, of the values of `build_up`."""
    return sum(value for key, value in values.items() if key.startswith("share_"))


def direction(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the direction of a dry friction of one joint, within -1 and 1, shape (M,).

    It is the smooth sign of the speed, or, if the values of the model say how the friction builds
    up, the mean of the Maxwell-slip elements.
    """
    sign = motion.sign(model.joint_index)
    if "share_0" not in model.values:
        return sign
    share = shares(model.values)
    return np.asarray(_elements(motion, *_bank(model)) @ share + (1.0 - share.sum()) * sign)


class _Hysteresis(Effect):
    """Presliding friction minus the smooth sign function that it replaces, and its damping."""

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        j, values = model.joint_index, model.values
        columns = _low_passed(motion, *_bank(model)).copy()
        columns[:, :ELEMENTS] -= motion.lowpass(motion.sign(j)[:, None])
        sticks = np.abs(_elements(motion, *_bank(model))) < 1.0
        damped = motion.lowpass((motion.samples.dq[:, j] * (sticks @ damping(values)))[:, None])
        return single_joint_rows(motion, j, np.hstack([columns, damped]))

    def dense_model(self, motions: Motions, joint: int) -> CandidateModel:
        """Return a nonnegative combination of Maxwell-slip elements of a joint.

        The columns after them, of either sign, make the two branches of the loop unequal; the last
        one is the damping of the elements, by equal shares of each.
        """
        unit = radian(motions, joint)
        last = LAST_REACH * unit
        step = max(float(motion.steps[joint]) for motion in motions)
        first = min(max(FIRST_REACH * unit, step), MAX_FIRST_REACH * last)
        values = {"reach": first, "last_reach": last}
        values |= {f"share_{i}": 1.0 / ELEMENTS for i in range(ELEMENTS)}
        travel = max(float(np.ptp(motion.samples.q[:, joint])) for motion in motions)
        slips = 2.0 * reaches(values) < travel
        prior_shares = tuple(np.where(slips, 1.0, STICKING_SHARE).tolist())
        return CandidateModel(self, joint, values, prior_shares=prior_shares)

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        stiffness = float(np.sum(c[:ELEMENTS] / reaches(model.values)))
        return {"amplitude": float(c[:ELEMENTS].sum()), "stiffness": stiffness}


HYSTERESIS = _Hysteresis(
    "hysteresis",
    "F z, ż = σ q̇ (1 − z sgn q̇) (Dahl 1968), or Maxwell-slip elements ż = q̇/s, |z| ≤ 1 "
    "(Iwan 1966), damped while they stick, instead of F sgn q̇",
    {"amplitude": "N m", "stiffness": "N m/rad"},
    "friction takes some way to build up after a reversal",
    "strokes of many small amplitudes",
    regime="reversal",
    nonnegative=(True,) * ELEMENTS + (False,) * len(UNEQUAL_ELEMENTS) + (True,),
    has_candidates=False,
    form_std={"amplitude": 0.1, "stiffness": 0.4},
)
"""Presliding friction; users call it friction hysteresis, LuGre or Dahl friction."""
