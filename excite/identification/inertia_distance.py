"""How far bodies are from their nominal ones: the four distances of Lee, Wensing & Park's review, with exact derivatives.

Riemannian (16): d² = ½ tr Log²(P₀⁻¹P). Bregman (17): D = log|P₀|/|P| + tr(P₀⁻¹P) − 4 ≈ d². Pullback (18): d² = δᵀ g(φ₀) δ.
Euclidean, to compare: d² = δᵀδ in SI units, which depends on units and frames. Bodies are rows: φ has shape (b, 10).
Everything is reckoned in the frame of each nominal body, M = L⁻¹PL⁻ᵀ with P₀ = LLᵀ, where numbers are near 1.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np

from ..robot.inertial_parameters import metric, pseudo_inertia

Array = np.ndarray
ROUNDING = 1e-12
PSEUDO_INERTIA_BASIS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])
"""∂P/∂φ. Shape (10, 4, 4)."""


class Distance(enum.Enum):
    """Which distance from the nominal body."""

    RIEMANNIAN = "riemannian"
    BREGMAN = "bregman"
    PULLBACK = "pullback"
    EUCLIDEAN = "euclidean"


@dataclass(frozen=True)
class BodyFunction:
    """A function of each body: values, gradients, Hessians. Shapes (b,), (b, 10), (b, 10, 10)."""

    value: Array
    gradient: Array
    hessian: Array


def pseudo_inertias(phi: Array) -> Array:
    """P(φ) of every body. Shapes (b, 10) -> (b, 4, 4)."""
    return np.einsum("bk,kij->bij", phi, PSEUDO_INERTIA_BASIS)


def distance_metrics(kind: Distance, nominal: Array) -> Array:
    """G with d² ≈ δᵀ G δ near the nominal bodies. Shape (b, 10, 10)."""
    return np.array([np.eye(10) if kind is Distance.EUCLIDEAN else metric(phi) for phi in nominal])


@dataclass(frozen=True)
class NominalFrames:
    """Nominal bodies and the frames in which they are 1.

    nominal: physically consistent. Shape (b, 10). units: ∂M/∂φ. Shape (b, 10, 4, 4).
    """

    nominal: Array
    units: Array = field(init=False)

    def __post_init__(self) -> None:
        inverse = np.linalg.inv(np.linalg.cholesky(pseudo_inertias(self.nominal)))
        object.__setattr__(
            self, "units", inverse[:, None] @ PSEUDO_INERTIA_BASIS @ np.swapaxes(inverse, 1, 2)[:, None]
        )

    def matrix(self, phi: Array) -> Array:
        """M, 1 for the nominal bodies. Shape (b, 4, 4)."""
        return np.einsum("bk,bkij->bij", phi, self.units)

    def least(self, phi: Array) -> float:
        """Smallest eigenvalue of any M, less what rounding makes of it: positive where all are bodies."""
        values = np.linalg.eigvalsh(self.matrix(phi))
        return float(np.min(values[:, 0] - ROUNDING * values[:, -1]))

    def barrier(self, phi: Array, floor: float = 0.0) -> BodyFunction:
        """−log|M − floor|, infinite where a body ceases to be one, and convex."""
        M = self.matrix(phi) - floor * np.eye(4)
        scaled = np.linalg.inv(M)[:, None] @ self.units
        hessian = np.einsum("biac,bjca->bij", scaled, scaled, optimize=True)
        return BodyFunction(-np.linalg.slogdet(M)[1], -np.trace(scaled, axis1=2, axis2=3), hessian)

    def reach(self, phi: Array, step: Array, floor: float = 0.0) -> float:
        """Largest α with M(φ + α·step) above `floor`; inf where there is none."""
        inverse = np.linalg.inv(np.linalg.cholesky(self.matrix(phi) - floor * np.eye(4)))
        lowest = float(
            np.linalg.eigvalsh(inverse @ self.matrix(step) @ np.swapaxes(inverse, 1, 2)).min()
        )
        return np.inf if lowest >= 0.0 else -1.0 / lowest

    def squared(self, kind: Distance, phi: Array) -> BodyFunction:
        """d² of each body from its nominal one, with derivatives with respect to φ."""
        if kind is Distance.BREGMAN:
            return self._bregman(phi)
        if kind is Distance.RIEMANNIAN:
            return self._riemannian(phi)
        G = distance_metrics(kind, self.nominal)
        delta = phi - self.nominal
        change = np.einsum("bij,bj->bi", G, delta)
        return BodyFunction(np.einsum("bi,bi->b", delta, change), 2.0 * change, 2.0 * G)

    def _bregman(self, phi: Array) -> BodyFunction:
        own, trace = self.barrier(phi), np.trace(self.units, axis1=2, axis2=3)
        return BodyFunction(
            own.value + np.einsum("bk,bk->b", trace, phi) - 4.0, own.gradient + trace, own.hessian
        )

    def _riemannian(self, phi: Array) -> BodyFunction:
        """Spectral calculus (Daleckii & Krein): f = Σ h(dᵢ), h = ½ log² d, of the eigenvalues of M.

        The Hessian's divided differences of h' are kept above a tenth of 1/(dᵢdⱼ): far from the nominal body d² isn't convex in φ.
        """
        d, V = np.linalg.eigh(self.matrix(phi))
        d = np.maximum(d, 1e-12)
        changes = np.swapaxes(V, 1, 2)[:, None] @ self.units @ V[:, None]
        rate = np.log(d) / d
        gap, middle = d[:, :, None] - d[:, None, :], np.sqrt(d[:, :, None] * d[:, None, :])
        close = np.abs(gap) < 1e-6 * middle
        rise = np.where(
            close,
            (1.0 - np.log(middle)) / middle**2,
            (rate[:, :, None] - rate[:, None, :]) / np.where(close, 1.0, gap),
        )
        rise = np.maximum(rise, 0.1 / middle**2)
        hessian = np.einsum("bkij,bij,blij->bkl", changes, rise, changes, optimize=True)
        return BodyFunction(
            0.5 * np.sum(np.log(d) ** 2, axis=1), np.einsum("bkii,bi->bk", changes, rate), hessian
        )
