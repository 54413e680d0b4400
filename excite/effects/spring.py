"""Spring: a conservative torque that depends on the joint position only."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._types import FloatArray
from ..robot.samples import MIN_TRAVEL
from .effect import CandidateModel, Values, grid_candidates
from .friction_runtime import SPRING_FORMS, JointMotion, columns
from .joint_torque import JointTorque
from .recorded_motion import FittedRobot, Motions, position_range

UNBOUNDED_FORMS = (0, 1)
"""Forms that hold beyond the positions to which they were fitted. The others say nothing there:
polynomials, and two waves of which a part of a turn determines little."""
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


class _Spring(JointTorque):
    """Standard forms; a line with a slow wave; two lines that meet; and a curve of any form.

    The wave stands for springs that stiffen, soften or pass a dead centre, the two lines for an
    end stop or a slack cable, the curve for a dress pack. The former two are zero at their centre,
    as a constant torque is the base model's offset.
    """

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        low, high = position_range(motions, joint)
        length, ends = high - low, {"low": low, "high": high}
        if length < MIN_TRAVEL:
            return
        for form in range(len(SPRING_FORMS)):
            values = {"form": float(form), **({} if form in UNBOUNDED_FORMS else ends)}
            yield CandidateModel(self, joint, values, facts=ends)
        if length > MIN_CURVE_RANGE:
            orders = (2.0 * np.pi / length * np.array(WAVES_OVER_RANGE)).tolist()
            values = {"order": orders[0], "about": 0.5 * (low + high), **ends}
            waving = CandidateModel(self, joint, values, facts=ends)
            yield from grid_candidates(waving, "order", orders)
            bent = CandidateModel(self, joint, {"bend": 0.0, **ends}, facts=ends)
            yield from grid_candidates(bent, "bend", (length * KINK_POSITIONS).tolist())
            for waves in CURVE_WAVES:
                shares = tuple(1.0 / m for m in range(1, waves + 1))
                values = {"waves": float(waves), **ends}
                yield CandidateModel(self, joint, values, facts=ends, prior_shares=shares)

    def varied(self, model: CandidateModel, key: str, value: float) -> CandidateModel:
        """Return the model with another value; that of a bend is its distance from the low end."""
        return super().varied(model, key, value + (model.facts["low"] if key == "bend" else 0.0))

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        """Return the steepest slope, with the sign of the whole curve, and half of the range."""
        q = np.linspace(model.facts["low"], model.facts["high"], CURVE_POINTS)
        parts = columns(self.name, model.values, JointMotion(q))
        torque = np.column_stack([part.smooth for part in parts]) @ c
        steepest = np.abs(np.gradient(torque, q)).max() * np.sign((q - q.mean()) @ torque)
        return {"stiffness": float(steepest), "amplitude": 0.5 * float(np.ptp(torque))}


SPRING = _Spring(
    "spring",
    "a conservative torque of position: k q, K sin(q + φ), …",
    {"stiffness": "N m/rad", "amplitude": "N m"},
    "the same in both directions, pose alone",
    "poses up to both ends",
    # a refit base model absorbs as much of the slope into gravity as the form permits
    regime="position",
    max_models=2,
    form_std={"stiffness": 1.0, "amplitude": 0.25},
)
"""Position-dependent torque; users call it counterbalance, gas spring, cable or dress pack."""
