"""Coupling: a joint's torque that depends on another joint's motion through the transmission."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from .._types import FloatArray
from .effect import CandidateModel, Values, grid_candidates
from .joint_torque import JointTorque
from .recorded_motion import FittedRobot, Motions, stands_still

RATIOS = (0.5, 1.0, 2.0)
"""Turns of the shaft by the other joint over those by its own, tried with either sign."""
RELATIVE_RATIOS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""The same of a revolute and a prismatic joint, as of a screw, over the ratio that makes both parts
equally fast: a smaller one is not visible, and the shaft of a larger one turns with the other."""
MAX_NEGATIVE_SHARE = 0.1
"""Share of a coupling's torque that may have the wrong sign by chance."""


class _Coupling(JointTorque):
    """Friction and inertia of a shaft with speed w = q̇ᵢ + r q̇ⱼ as joint i feels them.

    Viscous w, Coulomb sgn w, inertia r q̈ⱼ; the parts of w, sgn q̇ᵢ and q̈ᵢ that depend on joint i
    alone belong to the base model. Where "light" is stated the shaft has no inertia: fitted
    without being visible, it would absorb any residual.
    """

    def candidates(self, motions: Motions) -> Iterator[CandidateModel]:
        """Yield shafts between joints up to two apart, of either sign, with and without inertia."""
        n = motions[0].n
        for i in range(n):
            for j in range(max(0, i - 2), min(n, i + 3)):
                for sign, light in product((1.0, -1.0), ({}, {"light": 1.0})) if i != j else ():
                    model = CandidateModel(self, i, {"ratio": sign, **light}, j, motions=motions)
                    yield from grid_candidates(model, "ratio", _ratios(motions, i, j))

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        """Return the coefficients and the ratio r."""
        return super().parameters(model, c, base) | {"ratio": model.values["ratio"]}

    def varied(self, model: CandidateModel, key: str, value: float) -> CandidateModel:
        """Return the model with another size of the ratio, whose sign stays."""
        return super().varied(model, key, float(np.copysign(value, model.values[key])))

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Check that a shaft dissipates energy in the recorded motion and has positive inertia.

        The power of viscous w + Coulomb sgn w is a sum of squares in w, so neither coefficient may
        be negative, whatever the ratio.
        """
        i, j, ratio = model.joint_index, model.other, model.values["ratio"]
        samples = [motion.samples for motion in model.motions]
        speed, acceleration = (
            max(float(np.abs(x[:, i] + ratio * x[:, j]).max()) for x in signals)
            for signals in ([s.dq for s in samples], [s.ddq for s in samples])
        )
        parts = c * np.array([speed, 1.0, acceleration])[: len(c)]
        return bool(parts[:2].max() > 0.0 and parts.min() > -MAX_NEGATIVE_SHARE * parts.max())


def _ratios(motions: Motions, i: int, j: int) -> Sequence[float]:
    """Return the ratios that are tried of a shaft of joint i that joint j turns, too."""
    entries = motions[0].fitted_robot.robot.entries
    if (entries[i].kind == "prismatic") is (entries[j].kind == "prismatic"):
        return RATIOS
    motions = [m for m in motions if not (stands_still([m], i) or stands_still([m], j))]
    if not motions:
        return ()
    speeds = np.vstack([motion.at_rows(motion.samples.dq[:, [i, j]]) for motion in motions])
    both_move = np.concatenate([motion.moving[:, [i, j]].all(axis=1) for motion in motions])
    if not both_move.any():
        return ()
    first, second = np.sqrt(np.mean(speeds[both_move] ** 2, axis=0)).tolist()
    return (np.array(RELATIVE_RATIOS) * first / second).tolist()


COUPLING = _Coupling(
    "coupling",
    "friction and inertia of a shaft that turns with q̇ᵢ + r q̇ⱼ, as in an actuator that another "
    "joint turns too",
    {"viscous": "N m s/rad", "coulomb": "N m", "inertia": "kg m²", "ratio": "1"},
    "torque where only the other joint moves",
    "each joint singly, then together",
    regime="other joints",
    form_std={"viscous": 0.1, "coulomb": 0.1, "inertia": 0.1, "ratio": 0.1},
)
"""Transmission coupling of wrist joints; users call it gear coupling or a differential wrist."""
