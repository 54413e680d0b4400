"""Weight γ of the prior, by the evidence or by validation on recording parts that were left out.

Evidence: with ψ ~ N(ψ₀, (2γG)⁻¹), one γ for the inertial parameters and one for each kind of joint
parameter, the whitened data R θ̂ have a likelihood that MacKay's fixed point maximises ("Bayesian
interpolation", Neural Computation 4, 1992):
2γ_g = (well-determined parameters of group g + 1) / (their squared length + z_g²). The additional
parameter, at a usual distance z_g from nominal, keeps a recording without information from
determining γ.

The evidence may have several maxima: a parameter far from nominal is explained by a weak prior, or
by a strong one and a larger residual. The fixed point is therefore sought from a usual prior and
from a weak one, and the γ with the larger evidence is taken.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._types import FloatArray, IntArray
from ..robot.inertial_parameters import Parameters
from .consistency import Prior, prior_information, symmetric_pseudo_inverse

USUAL_INERTIAL_DISTANCE = 0.1
"""Usual distance of a URDF's inertial parameters from the true ones in the metric: about 10 %."""
USUAL_JOINT_DISTANCE = 1.0
"""The same for joint parameters, in their scales, which are guesses."""
MAX_TIME_CONSTANT = 0.1
"""Rotor inertia over viscous friction that is not unusual [s]; where a joint's own scale of rotor
inertia is smaller, the prior takes this."""
MAX_EVIDENCE_ITERATIONS = 60
"""Number of iterations of the fixed point, at most."""
EVIDENCE_TOLERANCE = 1e-3
"""Change of log γ below which the fixed point has converged."""
WEAK_PRIOR_FACTOR = 1e-4
"""2γ of a weak prior over that of a usual one [1]: parameters at a hundred usual distances."""
WEIGHT_RANGE = (1e-8, 1e8)
"""Smallest and largest 2γ."""
VALIDATION_FACTORS = 10.0 ** np.arange(-4.0, 4.5, 0.5)
"""Values of γ compared by validation, in units of the initial γ."""


def joint_parameter_scales(parameters: Parameters) -> FloatArray:
    """Return the scales of the joint parameters in the prior.

    The stated scale of rotor inertia may be far too small in a wrist, where the links weigh little
    and most of the inertia is the rotor's behind its gear. Shape (P − 10 bodies,).
    """
    edge = 10 * parameters.bodies
    scales = np.diag(parameters.scale)[edge:].copy()
    if {"rotor_inertia", "viscous"} <= set(parameters.drive):
        rotor, viscous = (parameters.block(kind) for kind in ("rotor_inertia", "viscous"))
        known = parameters.nominal[rotor] > 0.0
        usual = np.maximum(
            np.diag(parameters.scale)[rotor], MAX_TIME_CONSTANT * np.diag(parameters.scale)[viscous]
        )
        scales[rotor.start - edge : rotor.stop - edge] = np.where(
            known, np.diag(parameters.scale)[rotor], usual
        )
    return scales


def gamma_by_evidence(
    parameters: Parameters, root: FloatArray, target: FloatArray, start: Prior
) -> tuple[float, FloatArray]:
    """Find the γ that maximise the evidence.

    Args:
        parameters: Standard parameters.
        root: R B. Shape (m, P).
        target: R θ̂. Shape (m,).
        start: Prior with γ = 1.

    Returns:
        γ of the inertial parameters, and γ of every joint parameter, equal within a kind. Shape
        (P − 10 bodies,).
    """
    edge, n = 10 * parameters.bodies, len(parameters.joints)
    unit = prior_information(parameters, start)
    half: FloatArray = np.zeros(unit.shape)  # ψ − ψ₀ = half x with x ~ N(0, 1/(2γ))
    for i in range(0, edge, 10):
        half[i : i + 10, i : i + 10] = np.linalg.inv(
            np.linalg.cholesky(unit[i : i + 10, i : i + 10] / 2.0)
        ).T
    index = np.arange(edge, parameters.count)
    half[index, index] = (unit[index, index] / 2.0) ** -0.5
    A, b = root @ half, target - root @ start.nominal
    group = np.concatenate([np.zeros(edge, int), 1 + np.arange(len(parameters.drive)).repeat(n)])
    usual = np.array(
        [USUAL_INERTIAL_DISTANCE**2, *[USUAL_JOINT_DISTANCE**2] * len(parameters.drive)]
    )
    maxima = [
        _evidence_maximum(A, b, group, usual, factor / usual) for factor in (1.0, WEAK_PRIOR_FACTOR)
    ]
    weights = max(maxima, key=lambda maximum: maximum[0])[1]
    return float(weights[0] / 2.0), weights[1:].repeat(n) / 2.0


def _evidence_maximum(
    A: FloatArray, b: FloatArray, group: IntArray, usual: FloatArray, weights: FloatArray
) -> tuple[float, FloatArray]:
    """Find a maximum of the evidence of b = A x + noise of variance 1, x_i ~ N(0, 1/w_g(i)).

    Args:
        A: Shape (m, P).
        b: Shape (m,).
        group: Group of each parameter. Shape (P,).
        usual: Squared usual distance z² of each group. Shape (G,).
        weights: w = 2γ to begin with. Shape (G,).

    Returns:
        Logarithm of the evidence up to a constant, and w. Shape (G,).
    """
    information, score = A.T @ A, A.T @ b
    for _ in range(MAX_EVIDENCE_ITERATIONS):
        covariance = symmetric_pseudo_inverse(information + np.diag(weights[group]))
        x = covariance @ score
        determined = np.bincount(group, 1.0 - weights[group] * np.diag(covariance), len(usual))
        updated = np.clip(
            (np.maximum(determined, 0.0) + 1.0) / (np.bincount(group, x**2, len(usual)) + usual),
            *WEIGHT_RANGE,
        )
        change, weights = float(np.abs(np.log(updated / weights)).max()), updated
        if change < EVIDENCE_TOLERANCE:
            break
    spread = np.eye(len(b)) + (A / weights[group]) @ A.T
    log_likelihood = np.linalg.slogdet(spread)[1] + b @ np.linalg.solve(spread, b)
    # the additional parameter of each group, at its usual distance
    log_prior = np.sum(np.log(weights) - usual * weights)
    return float(0.5 * (log_prior - log_likelihood)), weights


def gamma_by_validation(
    squared_error: Callable[[float, int], float],
    start: float,
    folds: int,
    factors: FloatArray = VALIDATION_FACTORS,
) -> tuple[float, list[tuple[float, float]]]:
    """Find the γ of the inertial parameters with the smallest error on parts that were left out.

    Args:
        squared_error: Squared error on a fold of the model fitted to the others with a given γ.
        start: γ around which values are compared.
        folds: Number of folds.
        factors: Values to compare, in units of `start`.

    Returns:
        The best γ, and all pairs of γ and error.
    """
    trials = [
        (gamma, sum(squared_error(gamma, fold) for fold in range(folds)))
        for gamma in start * factors
    ]
    return min(trials, key=lambda trial: trial[1])[0], trials
