"""Presliding hysteresis: friction that builds up over a travel after each reversal.

Dahl's model, and Maxwell-slip elements (a Prandtl-Ishlinskii model) for curves that it does not
fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from .._types import FloatArray, IntArray
from .effect import (
    CandidateModel,
    Effect,
    FittedModels,
    NonlinearParameter,
    grid_candidates,
    is_between,
    single_joint_columns,
    variants_within,
)
from .friction import max_static_friction
from .recorded_motion import RecordedMotion, position_range

ELEMENT_COUNTS = (3, 5)
"""Numbers of Maxwell-slip elements that are tried."""
REACH_RATIO = 3.0
"""Slip distance of an element over that of the one before."""
MAX_REACH_SHARE = 0.5
"""Largest slip distance over the joint's range: an element that never slips is a spring."""
MAX_NEGATIVE_SHARE = 0.05
"""Negative force that one element may have by chance, over the force of all elements."""

DENSE_REACHES = 1e-3 * 2.0 ** np.arange(0.0, 8.0, 0.5)
"""Deflections at which the elements of `dense_model` slip [rad or m]."""
UNEQUAL_ELEMENTS = [6, 10]
"""Elements of `dense_model` that may have unequal branches."""


def dahl(q: FloatArray, stiffness: float) -> FloatArray:
    """Return the state z of Dahl's model of unit friction, ż = σ q̇ (1 − z sgn q̇) (Dahl 1968).

    In closed form from one reversal to the next.

    Args:
        q: Joint position, shape (M,).
        stiffness: σ [1/rad].
    """
    stroke, travel, distance = _strokes(q)
    limits, decays = np.sign(travel), np.exp(-stiffness * np.abs(travel))
    strokes = zip(limits.tolist(), decays.tolist(), strict=True)
    *starts, _ = accumulate(strokes, lambda z, s: s[0] + (z - s[0]) * s[1], initial=0.0)
    return np.asarray(
        limits[stroke] + (np.array(starts) - limits)[stroke] * np.exp(-stiffness * np.abs(distance))
    )


def maxwell_slip(q: FloatArray, reach: float) -> FloatArray:
    """Return the force of a Maxwell-slip element of unit strength (Iwan 1966).

    Args:
        q: Joint position, shape (M,).
        reach: Deflection at which the element slips [rad].
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
    if "elements" in model.values:
        elements = np.column_stack([maxwell_slip(motion.samples.q[:, j], d) for d in DENSE_REACHES])
        unequal = np.abs(elements[:, UNEQUAL_ELEMENTS]) - 1.0
        return single_joint_columns(
            motion, j, np.hstack([elements - motion.sign(j)[:, None], unequal])
        )
    q, reach = motion.samples.q[:, j], model.values["reach"]
    curves = (
        [maxwell_slip(q, ratio * reach) for ratio in _reach_ratios(model)]
        if "springs" in model.values
        else [dahl(q, 1.0 / reach)]
    )
    return single_joint_columns(motion, j, np.column_stack(curves) - motion.sign(j)[:, None])


def dense_model(motions: Sequence[RecordedMotion], joint: int) -> CandidateModel:
    """Return a nonnegative combination of Maxwell-slip elements of a joint.

    The last columns, of either sign, make the two branches of the loop unequal.
    """
    count = len(DENSE_REACHES)
    return CandidateModel(
        "hysteresis",
        joint,
        _columns,
        {"elements": float(count)},
        parameters=lambda c: {
            "amplitude": float(c[:count].sum()),
            "stiffness": float(np.sum(c[:count] / DENSE_REACHES)),
        },
        nonnegative=(True,) * count + (False,) * len(UNEQUAL_ELEMENTS),
    )


def _reach_ratios(model: CandidateModel) -> FloatArray:
    """Slip distances of a model's elements over that of the middle one, shape (k,)."""
    count = int(model.values["springs"])
    return np.asarray(REACH_RATIO ** (np.arange(count) - count // 2))


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Dahl's model; its variants have Maxwell-slip elements instead."""

    def slip_family(j: int, max_force: float, count: int) -> Callable[[float], CandidateModel]:
        low, high = position_range(motions, j)

        def model(reach: float) -> CandidateModel:
            candidate = CandidateModel(
                "hysteresis", j, _columns, {"reach": reach, "springs": float(count)}
            )
            reaches = reach * _reach_ratios(candidate)
            all_slip = bool(reaches[-1] < MAX_REACH_SHARE * (high - low))
            return replace(
                candidate,
                parameters=lambda c: {
                    "amplitude": float(c.sum()),
                    "stiffness": float(np.sum(c / reaches)),
                },
                is_plausible=lambda c: (
                    all_slip
                    and bool(0.0 < c.sum() < max_force and c.min() > -MAX_NEGATIVE_SHARE * c.sum())
                ),
            )

        return model

    def dahl_family(j: int, max_force: float) -> Callable[[float], CandidateModel]:
        def model(reach: float) -> CandidateModel:
            def variants() -> list[NonlinearParameter]:
                return variants_within(
                    reach, 4.0, [slip_family(j, max_force, count) for count in ELEMENT_COUNTS]
                )

            return CandidateModel(
                "hysteresis",
                j,
                _columns,
                {"reach": reach},
                parameters=lambda c: {
                    "amplitude": float(c[0]),
                    "stiffness": float(c[0] / reach),
                },
                is_plausible=is_between(0.0, max_force),
                variants=variants,
            )

        return model

    for j in range(motions[0].n):
        family = dahl_family(j, max_static_friction(motions, j))
        yield from grid_candidates(np.geomspace(1e-4, 1e-1, 9).tolist(), family)


def _stiffness_std(parts: FittedModels) -> dict[str, float]:
    """Stiffness is known only up to that of the first element to slip.

    Elements that slip even earlier would look the same.
    """
    model, c = parts[0]
    if "springs" not in model.values:
        return {}
    reach = float(_reach_ratios(model)[0]) * model.values["reach"]
    return {"stiffness": abs(float(c[0])) / reach}


HYSTERESIS = Effect(
    "hysteresis",
    "F z, ż = σ q̇ (1 − z sgn q̇) (Dahl 1968), or Maxwell-slip elements ż = q̇/s, |z| ≤ 1 "
    "(Iwan 1966), instead of F sgn q̇",
    _columns,
    _candidates,
    {"amplitude": "N m", "stiffness": "N m/rad"},
    "friction takes some way to build up after a reversal",
    ("delay", "backlash", "stribeck"),
    "strokes of many small amplitudes",
    form_std={"amplitude": 0.1, "stiffness": 0.4},
    residual_log_offset=1.0,
    unobserved_std=_stiffness_std,
)
"""Presliding friction; users call it friction hysteresis, LuGre or Dahl friction."""
