"""Base parameters by the joint regression, with an uncertainty that includes all that is fitted.

With the columns Γ of the base model, X of all else with the prior information Λ, and weights W,

    θ̂ = I⁻¹ ZᵀWτ,   Z = Γ − X F,   F = (XᵀWX + Λ)⁻¹ XᵀWΓ,   I = ΓᵀWZ,
    Cov θ̂ = I⁻¹ (ZᵀW S WZ + FᵀΛF) I⁻¹,

with the covariance S of the residual by its spectrum, as in `identification.estimators`. Were the
effects taken as known, the intervals would leave out what an effect and the base model share.
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..identification.estimators import ZERO_COLUMN_RATIO, Estimate, Method
from ..identification.lowpass import Grid
from ..identification.noise_spectrum import noise_spectrum
from ..identification.regression import RowLayout
from .joint_model import JointModel
from .regression import JointRegression

EXCITED = 1e-12
"""Eigenvalue of the information, each parameter in units of its column, relative to the largest,
above which a combination of base parameters counts as excited."""


def base_estimate(joint: JointModel) -> Estimate:
    """Return the base parameters by the data, with all else of a joint model unknown.

    All base parameters of the joint model must be free.
    """
    regression, p = joint.regression, len(joint.free)
    information, score, follow = regression.data_information(p)
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    size[size <= ZERO_COLUMN_RATIO * size.max()] = 1.0
    values, vectors = np.linalg.eigh(information / size[:, None] / size)
    known = values > EXCITED * values.max()
    half = vectors[:, known] / np.sqrt(values[known]) / size[:, None]
    inward = (vectors[:, known] * np.sqrt(values[known])).T * size
    theta = half @ (half.T @ score)
    others = np.flatnonzero(regression.solution.active[p:]) + p
    along = np.zeros((len(regression.nonnegative), half.shape[1]))
    along[:p], along[others] = half, follow @ half
    white = np.sqrt(regression.weights)
    residual = np.where(regression.moving, regression.residual(), 0.0)
    leverage, scores = _rows(regression, along)
    spectrum, spread = noise_spectrum(
        _layout(joint), residual * white, leverage, np.diag(1.0 / white), scores
    )
    prior = regression.prior_matrix[np.ix_(others, others)]
    spread += along[others].T @ prior @ along[others]
    covariance = half @ spread @ half.T
    hidden = np.any(np.abs(vectors[:, ~known]) > 1e-6, axis=1)
    covariance[hidden, hidden] = np.inf
    freedom = float(regression.moving.sum() - regression.fitted_per_joint().sum())
    return Estimate(
        method=Method.WLS,
        theta=theta,
        information_root=np.linalg.solve(np.linalg.cholesky(spread), inward),
        covariance=covariance,
        noise_root=np.diag(regression.sigma),
        noise_spectrum=spectrum,
        residual=residual,
        degrees_of_freedom=freedom,
    )


def _rows(regression: JointRegression, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted rows whose squares are leverages (N, n, k), and those along directions (N, n, r)."""
    joints = range(regression.n)
    columns, places = zip(*(regression.active_columns(j) for j in joints), strict=True)
    inverse = regression.solution.solve(np.eye(int(regression.solution.active.sum())))
    leverage = np.zeros((*regression.torque.shape, max(map(len, places))))
    for j, weight in enumerate(np.sqrt(regression.weights).tolist()):
        values, vectors = np.linalg.eigh(inverse[np.ix_(places[j], places[j])])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        leverage[:, j, : len(places[j])] = weight * columns[j] @ root
    scores = np.stack([regression.torque_along(x) for x in along.T], axis=2)
    return leverage, scores * np.sqrt(regression.weights)[:, None]


def _layout(joint: JointModel) -> RowLayout:
    """Segments of the regression's rows."""
    counts = [len(motion) for motion in joint.motions]
    return RowLayout(
        moving=joint.regression.moving,
        starts=tuple(np.cumsum([0, *counts[:-1]]).tolist()),
        periods=(0,) * len(counts),
        repeats=(None,) * len(counts),
        rate=max(motion.band.rate_of(Grid.KEPT) for motion in joint.motions),
    )
