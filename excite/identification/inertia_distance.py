"""Distances of link inertias from their nominal values, with exact derivatives.

The four distances of Lee, Wensing & Park (review): Riemannian (eq. 16), d² = ½ tr Log²(P₀⁻¹P);
log-det Bregman divergence (eq. 17), D = log(|P₀|/|P|) + tr(P₀⁻¹P) − 4 ≈ d²; pullback of the
Riemannian metric at φ₀ (eq. 18), d² = δᵀ g(φ₀) δ; and, for comparison, the Euclidean distance of
the SI values, d² = δᵀδ, which depends on units and frames. φ holds one body per row, shape (b,
10), in Pinocchio's order.

All are computed in normalised coordinates M = L⁻¹PL⁻ᵀ with P₀ = LLᵀ, in which nominal bodies are
the identity and numbers are of order 1.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np

from .._types import FloatArray
from ..robot.inertial_parameters import PSEUDO_INERTIA_BASIS, metric

EIGENVALUE_ROUNDING = 1e-12
"""Rounding error of the smallest eigenvalue relative to the largest, subtracted to be safe."""
MIN_EIGENVALUE = 1e-12
"""Smallest eigenvalue of M of which the Riemannian distance takes a logarithm."""
EQUAL_EIGENVALUES = 1e-6
"""Relative difference of two eigenvalues below which a divided difference is a derivative."""
MIN_RIEMANNIAN_CURVATURE = 0.1
"""Smallest divided difference of the Riemannian distance's derivative, in units of 1/(dᵢdⱼ): far
from the nominal body d² is not convex in φ, and a Newton step needs a positive definite
Hessian."""


class Distance(enum.Enum):
    """Distances from the nominal body, named as on the command line."""

    RIEMANNIAN = "riemannian"
    BREGMAN = "bregman"
    PULLBACK = "pullback"
    EUCLIDEAN = "euclidean"


@dataclass(frozen=True)
class BodyFunction:
    """Values of a function of each body, with derivatives with respect to φ.

    Attributes:
        value: Shape (b,).
        gradient: Shape (b, 10).
        hessian: Shape (b, 10, 10).
    """

    value: FloatArray
    gradient: FloatArray
    hessian: FloatArray


def pseudo_inertias(phi: FloatArray) -> FloatArray:
    """Compute the pseudo-inertia P(φ) of every body. Shapes (b, 10) -> (b, 4, 4)."""
    return np.einsum("bk,kij->bij", phi, PSEUDO_INERTIA_BASIS)


def distance_metrics(kind: Distance, nominal: FloatArray) -> FloatArray:
    """Compute G with d² ≈ δᵀ G δ near the nominal bodies. Shapes (b, 10) -> (b, 10, 10)."""
    return np.array([np.eye(10) if kind is Distance.EUCLIDEAN else metric(phi) for phi in nominal])


@dataclass(frozen=True)
class NominalFrames:
    """Coordinates in which the pseudo-inertia of each nominal body is the identity.

    Attributes:
        nominal: Physically consistent nominal bodies. Shape (b, 10).
        coordinates: D of coordinates x of the bodies, φ = D x, by which functions are
            differentiated; φ itself if None. Shape (b, 10, 10).
        units: ∂M/∂φ. Shape (b, 10, 4, 4).
        directions: ∂M/∂x. Shape (b, 10, 4, 4).
    """

    nominal: FloatArray
    coordinates: FloatArray | None = None
    units: FloatArray = field(init=False)
    directions: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        inverse = np.linalg.inv(np.linalg.cholesky(pseudo_inertias(self.nominal)))
        object.__setattr__(
            self,
            "units",
            inverse[:, None] @ PSEUDO_INERTIA_BASIS @ np.swapaxes(inverse, 1, 2)[:, None],
        )
        D = self.coordinates
        object.__setattr__(
            self,
            "directions",
            self.units if D is None else np.einsum("bkx,bkij->bxij", D, self.units),
        )

    def matrix(self, phi: FloatArray) -> FloatArray:
        """Compute M, the identity for nominal bodies. Shapes (b, 10) -> (b, 4, 4)."""
        return np.einsum("bk,bkij->bij", phi, self.units)

    def min_eigenvalue(self, phi: FloatArray) -> float:
        """Return the smallest eigenvalue of all M minus its rounding error.

        It is positive if all bodies are physically consistent.
        """
        values = np.linalg.eigvalsh(self.matrix(phi))
        return float(np.min(values[:, 0] - EIGENVALUE_ROUNDING * values[:, -1]))

    def barrier(self, phi: FloatArray, floor: float = 0.0) -> BodyFunction:
        """Compute the convex barrier −log|M − floor · 1| of each body."""
        M = self.matrix(phi) - floor * np.eye(4)
        scaled = np.linalg.inv(M)[:, None] @ self.directions
        hessian = np.einsum("biac,bjca->bij", scaled, scaled, optimize=True)
        return BodyFunction(-np.linalg.slogdet(M)[1], -np.trace(scaled, axis1=2, axis2=3), hessian)

    def max_step(self, phi: FloatArray, step: FloatArray, floor: float = 0.0) -> float:
        """Return the largest α with M(φ + α·step) ≻ floor · 1 for all bodies; ∞ if unbounded."""
        inverse = np.linalg.inv(np.linalg.cholesky(self.matrix(phi) - floor * np.eye(4)))
        lowest = float(
            np.linalg.eigvalsh(inverse @ self.matrix(step) @ np.swapaxes(inverse, 1, 2)).min()
        )
        return np.inf if lowest >= 0.0 else -1.0 / lowest

    def squared_distance(self, kind: Distance, phi: FloatArray) -> BodyFunction:
        """Compute the squared distance of each body from its nominal values."""
        if kind is Distance.BREGMAN:
            return self._bregman(phi)
        if kind is Distance.RIEMANNIAN:
            return self._riemannian(phi)
        G = distance_metrics(kind, self.nominal)
        delta = phi - self.nominal
        change = np.einsum("bij,bj->bi", G, delta)
        value = np.einsum("bi,bi->b", delta, change)
        if self.coordinates is not None:
            D = np.swapaxes(self.coordinates, 1, 2)
            change, G = np.einsum("bij,bj->bi", D, change), D @ G @ self.coordinates
        return BodyFunction(value, 2.0 * change, 2.0 * G)

    def _bregman(self, phi: FloatArray) -> BodyFunction:
        """Log-det Bregman divergence (review, eq. 17)."""
        log_det = self.barrier(phi)
        return BodyFunction(
            log_det.value + np.trace(self.matrix(phi), axis1=1, axis2=2) - 4.0,
            log_det.gradient + np.trace(self.directions, axis1=2, axis2=3),
            log_det.hessian,
        )

    def _riemannian(self, phi: FloatArray) -> BodyFunction:
        """Riemannian distance Σ h(dᵢ), h = ½ log² d, dᵢ the eigenvalues of M (review, eq. 16).

        Derivatives of spectral functions by divided differences of h′ (Daleckii & Krein).
        """
        d, V = np.linalg.eigh(self.matrix(phi))
        d = np.maximum(d, MIN_EIGENVALUE)
        changes = np.swapaxes(V, 1, 2)[:, None] @ self.directions @ V[:, None]
        rate = np.log(d) / d
        gap, middle = d[:, :, None] - d[:, None, :], np.sqrt(d[:, :, None] * d[:, None, :])
        close = np.abs(gap) < EQUAL_EIGENVALUES * middle
        rise = np.where(
            close,
            (1.0 - np.log(middle)) / middle**2,
            (rate[:, :, None] - rate[:, None, :]) / np.where(close, 1.0, gap),
        )
        rise = np.maximum(rise, MIN_RIEMANNIAN_CURVATURE / middle**2)
        hessian = np.einsum("bkij,bij,blij->bkl", changes, rise, changes, optimize=True)
        return BodyFunction(
            0.5 * np.sum(np.log(d) ** 2, axis=1), np.einsum("bkii,bi->bk", changes, rate), hessian
        )
