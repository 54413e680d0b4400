"""Spring: a conservative torque that depends on the joint position only."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from .._types import FloatArray
from ..robot.samples import MIN_TRAVEL
from .effect import CandidateModel, Effect, grid_candidates, single_joint_columns
from .recorded_motion import RecordedMotion, position_range

_Form = Callable[[FloatArray], FloatArray]
"""Torque of usual springs and counterbalances over the joint position, (M,) -> (M, k)."""
UNBOUNDED_FORMS: tuple[_Form, ...] = (
    lambda q: q[:, None],
    lambda q: np.column_stack([np.cos(q), np.sin(q)]),
)
"""Forms that hold beyond the positions to which they were fitted."""
BOUNDED_FORMS: tuple[_Form, ...] = (
    lambda q: np.column_stack([q, q**2]),
    lambda q: np.column_stack([q, q**2, q**3]),
    lambda q: np.column_stack([np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)]),
)
"""Forms that say nothing there: polynomials, and two waves of which a part of a turn determines
little."""
FORMS = (*UNBOUNDED_FORMS, *BOUNDED_FORMS)
"""All of them by their number in `model.json`."""
WAVES_OVER_RANGE = (0.35, 0.6, 0.9)
"""Periods over the joint's range of the slow wave that is added to a linear spring."""
KINK_POSITIONS = np.linspace(0.15, 0.85, 8)
"""Positions, as shares of the joint's range, at which a spring's stiffness may change."""
CURVE_WAVES = (6, 12)
"""Half waves over the joint's range of a curve of any form."""
CURVE_POINTS = 200
"""Positions at which a spring's torque is evaluated to report stiffness and amplitude."""
MIN_CURVE_RANGE = 0.05
"""Range from which more than a standard form is fitted [rad or m]."""


def _torque(values: Mapping[str, float], q: FloatArray) -> FloatArray:
    """Torque per coefficient over the joint position, (M,) -> (M, k)."""
    # a curve says nothing beyond the positions of its recordings; two lines that meet go on there
    inside = np.clip(q, values["low"], values["high"]) if "low" in values else q
    if "waves" in values:
        place = (inside - values["low"]) / (values["high"] - values["low"])
        return np.cos(np.pi * np.outer(place, np.arange(1, int(values["waves"]) + 1)))
    if "bend" in values:
        distance = q - values["bend"]
        return np.column_stack([np.minimum(distance, 0.0), np.maximum(distance, 0.0)])
    if "order" in values:
        phase = values["order"] * (inside - values["about"])
        return np.column_stack([inside - values["about"], np.cos(phase) - 1.0, np.sin(phase)])
    return FORMS[int(values["form"])](inside)


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Torque of a spring at one joint."""
    j = model.joint_index
    return single_joint_columns(motion, j, _torque(model.values, motion.samples.q[:, j]))


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Standard forms; a line with a slow wave; two lines that meet; and a curve of any form.

    The wave stands for springs that stiffen, soften or pass a dead centre, the two lines for an
    end stop or a slack cable, the curve for a dress pack. The former two are zero at their centre,
    as a constant torque is the base model's offset.
    """

    def candidates(j: int, low: float, high: float) -> Iterator[CandidateModel]:
        q = np.linspace(low, high, CURVE_POINTS)

        def model(**values: float) -> CandidateModel:
            def parameters(c: FloatArray) -> dict[str, float]:
                """Steepest slope, with the sign of the whole curve, and half of the range."""
                torque = _torque(values, q) @ c
                steepest = np.abs(np.gradient(torque, q)).max() * np.sign((q - q.mean()) @ torque)
                return {"stiffness": float(steepest), "amplitude": 0.5 * float(np.ptp(torque))}

            shares = tuple(1.0 / m for m in range(1, int(values.get("waves", 0.0)) + 1))
            return CandidateModel(
                "spring", j, _columns, values, parameters=parameters, prior_shares=shares
            )

        for number, form in enumerate(FORMS):
            ends = {} if form in UNBOUNDED_FORMS else {"low": low, "high": high}
            yield model(form=float(number), **ends)
        if high - low > MIN_CURVE_RANGE:
            slow = (2.0 * np.pi / (high - low) * np.array(WAVES_OVER_RANGE)).tolist()
            yield from grid_candidates(
                slow, lambda order: model(order=order, about=0.5 * (low + high), low=low, high=high)
            )
            yield from grid_candidates(
                ((high - low) * KINK_POSITIONS).tolist(),
                lambda distance: model(bend=low + distance, low=low, high=high),
            )
            for waves in CURVE_WAVES:
                yield model(waves=float(waves), low=low, high=high)

    for j in range(motions[0].n):
        low, high = position_range(motions, j)
        if high - low >= MIN_TRAVEL:
            yield from candidates(j, low, high)


SPRING = Effect(
    "spring",
    "a conservative torque of position: k q, K sin(q + φ), …",
    _columns,
    _candidates,
    {"stiffness": "N m/rad", "amplitude": "N m"},
    "the same in both directions, pose alone",
    "poses up to both ends",
    # a refit base model absorbs as much of the slope into gravity as the form permits
    form_std={"stiffness": 1.0, "amplitude": 0.25},
)
"""Position-dependent torque; users call it counterbalance, gas spring, cable or dress pack."""
