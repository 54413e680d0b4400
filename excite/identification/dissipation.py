"""Check that the fitted friction dissipates energy; torque of inverted sign makes it feed energy
in."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from .._types import FloatArray
from ..errors import ExciteWarning, UnusableInput
from ..recordings import Recording, RemarkKind
from .estimators import Estimate
from .regression import IdentificationModel, TorqueEquations

CLEARLY_NEGATIVE = 10.0
"""Standard errors by which the power of friction must be negative. Standard errors are too small by
a factor of 2 to 3 where physics is missing from the model; inverted torque gives 40 to 300."""
MAX_NEGATIVE_SHARE = 0.5
"""Share of the joints with clearly negative friction from which the recording is refused [1]."""


def require_dissipation(
    recordings: Sequence[Recording],
    model: IdentificationModel,
    equations: TorqueEquations,
    data: Estimate,
) -> None:
    """Check that the friction of the unconstrained estimate dissipates power at every joint.

    The power of joint j is P = E[q̇ (f_v q̇ + f_c tanh(q̇/w) + f_0)]. The offset f_0 counts:
    a joint that turns in one direction only does not distinguish it from Coulomb friction, and
    for an oscillating joint E[q̇] = 0.

    Inverted torque turns the torque of the links and rotors as well. Where these do not oppose
    those of the nominal robot as clearly, a motor that brakes may do the same: its torque follows
    the speed of a joint that something else moves.

    A joint whose sign the comparison with the nominal model already doubts is not judged again: the
    user has been warned of it, with the remedy.

    Args:
        recordings: The recordings.
        model: The model.
        equations: The equations that it is fitted to.
        data: Base parameters estimated from the data alone.

    Raises:
        UnusableInput: It is clearly negative at half of the joints or more, and the sign of one of
            them is not doubted yet. At fewer joints, a warning.
    """
    powers = friction_powers(model, equations, data, ("viscous", "coulomb", "offset"))
    negative = [
        j for j, (power, deviation) in powers.items() if power < -CLEARLY_NEGATIVE * deviation
    ]
    doubted = {
        doubt.joint
        for recording in recordings
        for doubt in recording.doubts
        if doubt.kind is RemarkKind.TORQUE_SIGN
    }
    unnamed = [j for j in negative if model.robot.joints[j] not in doubted]
    if not unnamed:
        return
    joint = model.robot.joints[unnamed[0]]
    power, deviation = powers[unnamed[0]]
    text = (
        f"{recordings[0].source}: joint '{joint}': in the unconstrained fit friction feeds in "
        f"{-power:.3g} ± {deviation:.2g} W instead of taking it out"
    )
    if len(negative) >= MAX_NEGATIVE_SHARE * model.robot.n:
        joints = f"{len(negative)} of {model.robot.n} joints"
        is_inverted = any(_opposes_nominal(model, equations, data, j) for j in negative)
        cause = (
            "the sign of the torque is inverted, turn it and read again"
            if is_inverted
            else "turn the sign of the torque if it is inverted; if motors brake what something "
            "else moves, record a motion that the motors drive"
        )
        raise UnusableInput(f"{text}, and so at {joints}; {cause}")
    warnings.warn(f"{text}; check the sign of its torque", ExciteWarning, stacklevel=3)


def _opposes_nominal(
    model: IdentificationModel, equations: TorqueEquations, data: Estimate, joint: int
) -> bool:
    """Tell whether the torque of links and rotors at a joint is clearly opposite to the nominal."""
    parameters, independent = model.parameters, np.asarray(model.base.independent)
    psi, rigid = parameters.nominal.copy(), np.ones(len(independent), bool)
    for kind in {"viscous", "coulomb", "offset"} & set(parameters.drive):
        block = parameters.block(kind)
        psi[block] = 0.0
        rigid &= (independent < block.start) | (independent >= block.stop)
    columns = equations.regressor[:, joint]
    weight = np.where(rigid, columns.T @ (columns @ (model.base.matrix @ psi)), 0.0)
    product, deviation = _combination(weight, data)
    return product < -CLEARLY_NEGATIVE * deviation


def friction_powers(
    model: IdentificationModel, equations: TorqueEquations, data: Estimate, kinds: Sequence[str]
) -> dict[int, tuple[float, float]]:
    """Return the mean power of friction and its standard error of each joint that has some [W].

    Args:
        model: The model.
        equations: The equations that it is fitted to.
        data: Base parameters estimated from the data alone.
        kinds: Actuator parameters that count: "viscous", "coulomb", "offset".
    """
    parameters, out = model.parameters, dict[int, tuple[float, float]]()
    weights: dict[int, FloatArray] = {}
    for kind in kinds:
        if kind not in parameters.drive:
            continue
        block = parameters.block(kind)
        for k, place in enumerate(model.base.independent):
            if block.start <= place < block.stop:
                j = int(place) - block.start
                column = equations.regressor[:, j, k]
                weight = weights.setdefault(j, np.zeros(len(data.theta)))
                weight[k] = float(np.mean(column * equations.motion.dq[:, j]))
    for j, weight in weights.items():
        power, deviation = _combination(weight, data)
        if deviation < np.inf:
            out[j] = power, deviation
    return out


def _combination(weight: FloatArray, data: Estimate) -> tuple[float, float]:
    """Return w·θ̂ of weights w, and its standard error, ∞ where the data do not determine it."""
    used = np.flatnonzero(weight)
    covariance = data.covariance[np.ix_(used, used)]
    if not len(used) or not np.isfinite(covariance).all():
        return 0.0, np.inf
    variance = float(weight[used] @ covariance @ weight[used])
    return float(weight @ data.theta), float(np.sqrt(max(variance, 0.0)))
