"""How far bodies are from their nominal ones: the four distances of Lee, Wensing & Park's review, with exact derivatives.

Riemannian (16): d² = ½ tr Log²(P₀⁻¹P). Bregman (17): D = log|P₀|/|P| + tr(P₀⁻¹P) − 4 ≈ d². Pullback (18): d² = δᵀ g(φ₀) δ.
Euclidean, to compare: d² = δᵀδ in SI units, which depends on units and frames. Bodies are rows: φ has shape (b, 10).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from ..parameters import metric, pseudo_inertia

Array = np.ndarray
UNITS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])
"""∂P/∂φ. Shape (10, 4, 4)."""


class Distance(enum.Enum):
    """Which distance from the nominal body."""

    RIEMANNIAN = "riemannian"
    BREGMAN = "bregman"
    PULLBACK = "pullback"
    EUCLIDEAN = "euclidean"


@dataclass(frozen=True)
class Value:
    """A function of each body: values, gradients, Hessians. Shapes (b,), (b, 10), (b, 10, 10)."""

    value: Array
    gradient: Array
    hessian: Array


def pseudo(phi: Array) -> Array:
    """P(φ) of every body. Shapes (b, 10) -> (b, 4, 4)."""
    return np.einsum("bk,kij->bij", phi, UNITS)


def squared(kind: Distance, phi: Array, nominal: Array) -> Value:
    """d² of each body from its nominal one, with derivatives with respect to φ. Both must be physically consistent."""
    if kind is Distance.BREGMAN:
        return _bregman(phi, nominal)
    if kind is Distance.RIEMANNIAN:
        return _riemannian(phi, nominal)
    G = metrics(kind, nominal)
    delta = phi - nominal
    slope = np.einsum("bij,bj->bi", G, delta)
    return Value(np.einsum("bi,bi->b", delta, slope), 2.0 * slope, 2.0 * G)


def metrics(kind: Distance, nominal: Array) -> Array:
    """G with d² ≈ δᵀ G δ near the nominal bodies. Shape (b, 10, 10)."""
    return np.array([np.eye(10) if kind is Distance.EUCLIDEAN else metric(phi) for phi in nominal])


def barrier(phi: Array) -> Value:
    """−log|P(φ)|, infinite where a body ceases to be one, and convex."""
    P = pseudo(phi)
    scaled = np.linalg.inv(P)[:, None] @ UNITS[None]
    hessian = np.einsum("biac,bjca->bij", scaled, scaled, optimize=True)
    return Value(-np.linalg.slogdet(P)[1], -np.trace(scaled, axis1=2, axis2=3), hessian)


def _bregman(phi: Array, nominal: Array) -> Value:
    own = barrier(phi)
    P0 = pseudo(nominal)
    slope = np.trace(np.linalg.inv(P0)[:, None] @ UNITS[None], axis1=2, axis2=3)
    value = own.value + np.linalg.slogdet(P0)[1] + np.einsum("bk,bk->b", slope, phi) - 4.0
    return Value(value, own.gradient + slope, own.hessian)


def _riemannian(phi: Array, nominal: Array) -> Value:
    """Spectral calculus (Daleckii & Krein): for f = Σ h(dᵢ), h = ½ log² d, of P in the frame where P₀ = 1.

    The Hessian's divided differences of h' are kept above a tenth of 1/(dᵢdⱼ): far from the nominal body d² isn't convex in φ.
    """
    inverse = np.linalg.inv(np.linalg.cholesky(pseudo(nominal)))
    d, V = np.linalg.eigh(inverse @ pseudo(phi) @ np.swapaxes(inverse, 1, 2))
    frame = np.swapaxes(inverse, 1, 2) @ V
    changes = np.einsum("bai,kac,bcj->bkij", frame, UNITS, frame, optimize=True)
    slope = np.log(d) / d
    gap, middle = d[:, :, None] - d[:, None, :], np.sqrt(d[:, :, None] * d[:, None, :])
    close = np.abs(gap) < 1e-6 * middle
    rise = np.where(close, (1.0 - np.log(middle)) / middle**2, (slope[:, :, None] - slope[:, None, :]) / np.where(close, 1.0, gap))
    rise = np.maximum(rise, 0.1 / middle**2)
    hessian = np.einsum("bkij,bij,blij->bkl", changes, rise, changes, optimize=True)
    return Value(0.5 * np.sum(np.log(d) ** 2, axis=1), np.einsum("bkii,bi->bk", changes, slope), hessian)


def reach(phi: Array, step: Array) -> float:
    """Largest α with every body of φ + α·step still one; inf where there is none."""
    inverse = np.linalg.inv(np.linalg.cholesky(pseudo(phi)))
    lowest = float(np.linalg.eigvalsh(inverse @ pseudo(step) @ np.swapaxes(inverse, 1, 2)).min())
    return np.inf if lowest >= 0.0 else -1.0 / lowest
