"""Torque budget: what each effect explains of the torque beyond the base model.

With r_b the held-out residual of the base model and T_e the torque of effect e beyond what a refit
of the base model absorbs of it, the share of e is cov(T_e, r_b)/mean(r_b²). The base parameters
that are fitted jointly with the effects differ from those of a refit as well, by their prior, by
the weights of the rows and by physical consistency. With the held-out residual r of the saved
model, their torque is r_b − r − Σ T_e. The shares of all effects, of this torque and of r sum to 1.

The relative standard deviation ρ of an effect is that of the sum of its waves at a joint: the share
s of that sum has the variance (ρ s)². Effects of several joints are taken as independent.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..effects.effect import Key
from ..effects.recorded_motion import Motions
from ..identification import consistency
from ..identification.identification import Identification
from ..schemas.effects import is_recording_filter
from . import joint_model
from .estimates import EffectEstimate
from .final_model import FinalModel, HeldOutErrors
from .regression import independent_share, rms

RECORDING_FILTER = "recording_filter"
"""Name of the filter of the recording chain, which is no effect of the catalogue."""
BASE_PARAMETERS = "base_parameters"
"""Name of the base parameters that are fitted jointly with the effects."""


@dataclass(frozen=True)
class TorqueBudget:
    """Shares of the held-out torque beyond the base model.

    Attributes:
        shares: By effect, and of the base parameters: share in each joint, shape (n,).
        std: By effect: standard deviation of the share, shape (n,).
        residual: Share that remains, shape (n,).
    """

    shares: Mapping[str, FloatArray]
    std: Mapping[str, FloatArray]
    residual: FloatArray


def torque_budget(
    identified: Identification,
    motions: Sequence[Motions],
    final: FinalModel,
    effects: Sequence[EffectEstimate],
    held_out: HeldOutErrors,
) -> TorqueBudget:
    """Return the torque budget of held-out motions.

    Args:
        motions: The fitted motions and the held-out ones, with the identified base model.
    """
    fitted, held_out_motions = motions
    gamma = np.concatenate([motion.gamma for motion in held_out_motions])
    absorbed = _absorbed_parameters(final, identified, fitted)
    torques = [effect.torque(held_out.motions) for effect in final.saved_effects]
    base = held_out.base / np.maximum(np.sum(held_out.base**2, axis=0), 1e-300)
    relative = {e.key: e.relative_std for e in effects}
    n = base.shape[1]
    of_joint: dict[Key, FloatArray] = defaultdict(lambda: np.zeros(n))
    other = held_out.base - held_out.final
    for effect, theta, torque in zip(final.saved_effects, absorbed, torques, strict=True):
        beyond = torque - gamma @ theta
        other = other - beyond
        name, joint = effect.shape.key
        if is_recording_filter(effect.shape.values):
            name = RECORDING_FILTER
        of_joint[name, joint] += np.sum(beyond * base, axis=0)
    shares: dict[str, FloatArray] = defaultdict(lambda: np.zeros(n))
    variances: dict[str, FloatArray] = defaultdict(lambda: np.zeros(n))
    for (name, joint), share in of_joint.items():
        shares[name] += share
        variances[name] += (share * relative.get((name, joint), 0.0)) ** 2
    if shares:
        matrix = identified.model.base.matrix
        slope = np.einsum("rjp,rj->jp", gamma, base) @ matrix
        shares[BASE_PARAMETERS] = np.sum(other * base, axis=0)
        covariance = final.identified.posterior.covariance
        variances[BASE_PARAMETERS] = np.sum((slope @ covariance) * slope, axis=1)
    explained = sum(shares.values(), np.zeros(n))
    return TorqueBudget(
        shares, {name: np.sqrt(v) for name, v in variances.items()}, 1.0 - explained
    )


def _absorbed_parameters(
    final: FinalModel, identified: Identification, motions: Motions
) -> FloatArray:
    """Base parameters that a base model fitted alone absorbs of each saved effect, shape (E, p)."""
    torques = [effect.torque(final.motions) for effect in final.saved_effects]
    free = joint_model.free_parameters(identified)
    gamma = np.concatenate([motion.gamma[:, :, free] for motion in motions])
    residual = np.concatenate([motion.residual for motion in motions])
    moving = final.regression.moving
    weight = np.sqrt(independent_share(residual, moving)) / rms(residual, moving) * moving
    x = (gamma * weight[:, :, None]).reshape(moving.size, len(free))
    a = x.T @ x
    if not identified.options.trusted:
        a += consistency.base_prior_information(
            identified.model.parameters, identified.model.base, identified.prior
        )
    scale = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    inverse = np.linalg.pinv(a * scale[:, None] * scale, rcond=1e-9, hermitian=True)
    out = np.zeros((len(torques), identified.model.base.count))
    for theta, torque in zip(out, torques, strict=True):
        theta[free] = scale * (inverse @ (scale * (x.T @ (torque * weight).reshape(-1))))
    return out
