"""How much the prior counts: γ by evidence, or by what predicts blocks of the recording that were left out.

Evidence: with ψ ~ N(ψ₀, (2γG)⁻¹), a γ for bodies and one for each kind of drive parameter, the whitened data R θ̂ have a likelihood
that MacKay's fixed point maximises (1992): 2γ_g = (well-determined parameters of group g + 1) / (their squared length + z_g²).
The added one is a parameter as far from nominal as such usually are: a recording that says nothing leaves its word in force.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..robot.inertial_parameters import Parameters
from .consistency import Prior, prior_information, symmetric_pseudo_inverse

Array = np.ndarray
BODIES_OFF = 0.1
"""How far the bodies of a URDF usually are from the true ones, in the metric."""
DRIVES_OFF = 1.0
"""The same for friction, rotor inertia and offset: their stated scales are guesses."""
LONGEST = 0.1
"""Rotor inertia over viscous friction that is nothing unusual [s]; where a joint's own scale is smaller the prior takes this."""
ROUNDS, SETTLED = 60, 1e-3
RANGE = (1e-8, 1e8)


def joint_parameter_scales(parameters: Parameters) -> Array:
    """Scales of the drive parameters in the prior. Those of rotor inertia may be far too small in a wrist, where the links weigh little
    and the rotor behind its gear is most of what moves. Shape (P − 10 bodies,)."""
    edge = 10 * parameters.bodies
    own = np.diag(parameters.scale)[edge:].copy()
    if {"rotor_inertia", "viscous"} <= set(parameters.drive):
        rotor, viscous = (parameters.block(kind) for kind in ("rotor_inertia", "viscous"))
        known = parameters.nominal[rotor] > 0.0
        usual = np.maximum(
            np.diag(parameters.scale)[rotor], LONGEST * np.diag(parameters.scale)[viscous]
        )
        own[rotor.start - edge : rotor.stop - edge] = np.where(
            known, np.diag(parameters.scale)[rotor], usual
        )
    return own


def gamma_by_evidence(
    parameters: Parameters, root: Array, target: Array, start: Prior
) -> tuple[float, Array]:
    """The most likely γ of bodies, and of every drive parameter, alike within a kind. root: R B. Shape (m, P). target: R θ̂."""
    edge, n = 10 * parameters.bodies, len(parameters.joints)
    unit = prior_information(parameters, start)
    half: Array = np.zeros(unit.shape)  # ψ − ψ₀ = half x with x ~ N(0, 1/(2γ))
    for i in range(0, edge, 10):
        half[i : i + 10, i : i + 10] = np.linalg.inv(
            np.linalg.cholesky(unit[i : i + 10, i : i + 10] / 2.0)
        ).T
    index = np.arange(edge, parameters.count)
    half[index, index] = (unit[index, index] / 2.0) ** -0.5
    A, b = root @ half, target - root @ start.nominal
    information, score = A.T @ A, A.T @ b
    group = np.concatenate([np.zeros(edge, int), 1 + np.arange(len(parameters.drive)).repeat(n)])
    off = np.array([BODIES_OFF**2, *[DRIVES_OFF**2] * len(parameters.drive)])
    weights = 1.0 / off
    for _ in range(ROUNDS):
        covariance = symmetric_pseudo_inverse(information + np.diag(weights[group]))
        x = covariance @ score
        told = np.bincount(group, 1.0 - weights[group] * np.diag(covariance), len(off))
        fresh = np.clip(
            (np.maximum(told, 0.0) + 1.0) / (np.bincount(group, x**2, len(off)) + off), *RANGE
        )
        change, weights = float(np.abs(np.log(fresh / weights)).max()), fresh
        if change < SETTLED:
            break
    return float(weights[0] / 2.0), weights[1:].repeat(n) / 2.0


def gamma_by_validation(
    fit: Callable[[float, int], float], start: float, folds: int
) -> tuple[float, list[tuple[float, float]]]:
    """γ with the least error on blocks left out, and every (γ, error) tried. fit: (γ, fold) -> squared error there."""
    tried = [
        (g, sum(fit(g, fold) for fold in range(folds)))
        for g in start * 10.0 ** np.arange(-4.0, 4.5, 0.5)
    ]
    return min(tried, key=lambda pair: pair[1])[0], tried
