"""Coupling: a joint's torque that depends on another joint's motion through the transmission."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np

from .._types import FloatArray
from .effect import (
    CandidateModel,
    Effect,
    grid_candidates,
    named_coefficients,
    single_joint_columns,
)
from .recorded_motion import RecordedMotion

RATIOS = (0.5, 1.0, 2.0)
"""Turns of the shaft by the other joint over those by its own, tried with either sign."""
RELATIVE_RATIOS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""The same of a revolute and a prismatic joint, as of a screw, over the ratio that makes both parts
equally fast: a smaller one is not visible, and the shaft of a larger one turns with the other."""
MAX_NEGATIVE_SHARE = 0.1
"""Share of a coupling's torque that may have the wrong sign by chance."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Friction and inertia of a shaft with speed w = q̇ᵢ + r q̇ⱼ as joint i feels them.

    Viscous w, Coulomb sgn w, inertia r q̈ⱼ; the parts of w, sgn q̇ᵢ and q̈ᵢ that depend on joint i
    alone belong to the base model. Where "light" is stated the shaft has no inertia: fitted
    without being visible, it would absorb any residual.
    """
    assert model.other is not None
    j, ratio = model.joint_index, model.values["ratio"]
    speed = motion.samples.dq[:, j] + ratio * motion.samples.dq[:, model.other]
    columns = [
        speed,
        np.tanh(speed / motion.widths[j]),
        ratio * motion.samples.ddq[:, model.other],
    ]
    acting = columns[:2] if "light" in model.values else columns
    return single_joint_columns(motion, j, np.array(acting).T)


def _dissipates(speed: float, acceleration: float) -> Callable[[FloatArray], bool]:
    """Check that a shaft dissipates energy up to `speed` and has positive inertia.

    The power of viscous w + Coulomb sgn w is a sum of squares in w, so neither coefficient may be
    negative, whatever the ratio.
    """

    def is_plausible(c: FloatArray) -> bool:
        parts = c * np.array([speed, 1.0, acceleration])[: len(c)]
        return bool(parts[:2].max() > 0.0 and parts.min() > -MAX_NEGATIVE_SHARE * parts.max())

    return is_plausible


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Shafts between joints up to two apart, with either sign, with and without inertia."""
    n = motions[0].n
    slides = [e.kind == "prismatic" for e in motions[0].fitted_robot.robot.entries]
    speeds = np.sqrt(np.mean(np.vstack([motion.samples.dq for motion in motions]) ** 2, axis=0))

    def ratios(i: int, j: int) -> Sequence[float]:
        if slides[i] == slides[j]:
            return RATIOS
        if not speeds[i] * speeds[j] > 0.0:
            return ()
        return (np.array(RELATIVE_RATIOS) * speeds[i] / speeds[j]).tolist()

    def family(i: int, j: int, sign: float, is_light: bool) -> Callable[[float], CandidateModel]:
        def model(ratio: float) -> CandidateModel:
            speed, acceleration = (
                max(float(np.abs(x[:, i] + sign * ratio * x[:, j]).max()) for x in signals)
                for signals in (
                    [motion.samples.dq for motion in motions],
                    [motion.samples.ddq for motion in motions],
                )
            )
            values = {"ratio": sign * ratio} | ({"light": 1.0} if is_light else {})
            return CandidateModel(
                "coupling",
                i,
                _columns,
                values,
                j,
                parameters=named_coefficients("viscous", "coulomb", "inertia"),
                is_plausible=_dissipates(speed, acceleration),
            )

        return model

    for i in range(n):
        for j in range(max(0, i - 2), min(n, i + 3)):
            for sign, is_light in product((1.0, -1.0), (False, True)) if i != j else ():
                yield from grid_candidates(ratios(i, j), family(i, j, sign, is_light))


COUPLING = Effect(
    "coupling",
    "friction and inertia of a shaft that turns with q̇ᵢ + r q̇ⱼ, as in an actuator that another "
    "joint turns too",
    _columns,
    _candidates,
    {"viscous": "N m s/rad", "coulomb": "N m", "inertia": "kg m²"},
    "torque where only the other joint moves",
    "each joint singly, then together",
    form_std={"viscous": 0.1, "coulomb": 0.1, "inertia": 0.1},
)
"""Transmission coupling of wrist joints; users call it gear coupling or a differential wrist."""
