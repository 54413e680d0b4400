"""Base parameters θ = Bψ: what motion and torque can tell of ψ, and names for it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from ..errors import ExciteWarning
from .dynamics import regressor
from .inertial_parameters import Parameters, spread_poses
from .limits import Limits
from .robot import Robot
from .samples import Samples
from .structural_count import base_count

Array = np.ndarray
RANK_TOLERANCE = 1e-4
"""Relative size below which a direction counts as invisible. Real arms keep above 0.05; a right
angle rounded to 1.5708 in a URDF makes directions of 1e-6, which no motion shows but a criterion
would chase."""
GREEDY_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Base:
    """The observable part of the standard parameters; nothing downstream depends on the choice of
    basis.

    matrix: B in reduced row-echelon form, θ = Bψ. Shape (p, P).
    independent: for each θ the place in ψ of the parameter it is named after. Shape (p,).
    geometric: W = G₀^{-1/2} V, V an orthonormal basis of Range(G₀^{-1/2} Bᵀ). Shape (P, p). The
        eigenvalues of Wᵀ (Σ Yᵀ Σ⁻¹ Y) W are those of I·H₀⁻¹ (Lee, Wensing & Park, eq. 20).
    plain: the same with orthonormal rows of B and H₀ = 1. Shape (P, p).
    expressions: a name such as "m3 + m4 + 0.613*mcx2" for each θ.
    """

    matrix: Array
    independent: Array
    geometric: Array
    plain: Array
    expressions: tuple[str, ...]

    @property
    def count(self) -> int:
        """p, the number of base parameters."""
        return len(self.independent)

    @property
    def selection(self) -> Array:
        """The 0/1 matrix that takes the independent columns of Y: Γ = Y · selection. Shape (P,
        p)."""
        out: Array = np.eye(self.matrix.shape[1])[:, self.independent]
        return out


def random_motion(limits: Limits, count: int, rng: np.random.Generator) -> Samples:
    """Unrelated states spread over what the limits allow, for counting ranks."""
    n = len(limits.joints)
    speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    q = spread_poses(limits, count)
    return Samples(
        q, speed * rng.normal(size=(count, n)), 4.0 * speed * rng.normal(size=(count, n))
    )


def find(robot: Robot, parameters: Parameters, limits: Limits) -> Base:
    """Base parameters by a rank-revealing factorisation with relative tolerance, checked against
    the structure.

    Columns are compared after scaling to unit length. A warning says when the numerical and the
    structural count differ.
    """
    motion = random_motion(
        limits, max(40, 4 * parameters.count // robot.n + 20), np.random.default_rng(1)
    )
    noise = np.maximum(limits.torque, 1e-9)
    stacked = (regressor(robot, parameters, motion) / noise[:, None]).reshape(-1, parameters.count)
    norms = np.linalg.norm(stacked, axis=0)
    present = (norms > RANK_TOLERANCE * _largest_of_kind(norms, parameters)) & (
        norms > 1e-12 * norms.max()
    )
    unit: Array = np.linalg.qr(stacked[:, present] / norms[present], mode="r")  # type: ignore[assignment]
    values = np.linalg.svd(unit, compute_uv=False)
    rank = int(np.sum(values > RANK_TOLERANCE * values[0]))
    expected = base_count(robot, parameters)
    if rank != expected and robot.model.nv == robot.n:
        text = (
            f"{robot.source}: {rank} base parameters are visible, {expected} exist by structure; "
            "the difference is left out "
            "(often a right angle that is rounded in the URDF)"
        )
        warnings.warn(text, ExciteWarning, stacklevel=2)
    chosen, coefficients = _echelon(unit, rank)
    matrix = np.zeros((rank, parameters.count))
    matrix[:, present] = coefficients * norms[present] / norms[present][chosen][:, None]
    return Base(
        matrix=matrix,
        independent=np.flatnonzero(present)[chosen],
        geometric=parameters.scale @ np.linalg.qr((matrix @ parameters.scale).T)[0],
        plain=np.linalg.qr(matrix.T)[0],
        expressions=tuple(_expression(row, parameters.names) for row in matrix),
    )


def _largest_of_kind(norms: Array, parameters: Parameters) -> Array:
    """For each column the largest norm among columns of its kind: masses, first moments, inertias,
    and each drive block."""
    n = len(parameters.joints)
    kinds = [0, 1, 1, 1, 2, 2, 2, 2, 2, 2] * parameters.bodies + [
        3 + k for k in range(len(parameters.drive)) for _ in range(n)
    ]
    kind = np.array(kinds)
    largest = np.array([norms[kind == k].max() for k in range(kind.max() + 1)])
    return largest[kind]


def _echelon(unit: Array, rank: int) -> tuple[Array, Array]:
    """Independent columns of a regressor, and every column in terms of them: the coefficients of
    reduced row-echelon B.

    Gram-Schmidt over unit columns from the base outwards, so that each θ is named after its
    innermost parameter and grouped with outer ones; exactly `rank` columns are kept.
    """
    remainder, taken = np.zeros(unit.shape[1]), np.zeros((len(unit), 0))
    for column in range(unit.shape[1]):
        rest = unit[:, column]
        for _ in range(2):  # once more, against cancellation
            rest = rest - taken @ (taken.T @ rest)
        remainder[column] = np.linalg.norm(rest)
        if remainder[column] > GREEDY_TOLERANCE and taken.shape[1] < rank:
            taken = np.column_stack([taken, rest / remainder[column]])
    chosen = np.flatnonzero(remainder > GREEDY_TOLERANCE)[:rank]
    if len(chosen) < rank:  # nearly invisible columns: let pivoting decide
        import scipy.linalg  # slow to import

        chosen = np.sort(scipy.linalg.qr(unit, mode="r", pivoting=True)[1][:rank])
    orthonormal, triangular = np.linalg.qr(unit[:, chosen])
    coefficients = np.linalg.solve(triangular, orthonormal.T @ unit)
    coefficients[np.abs(coefficients) < 1e-8] = 0.0
    coefficients[:, chosen] = np.eye(rank)
    return chosen, coefficients


def _expression(row: Array, names: tuple[str, ...]) -> str:
    words = []
    for name, value in zip(names, row, strict=True):
        if value == 0.0:
            continue
        sign = "-" if value < 0 else "+"
        factor = "" if abs(abs(value) - 1.0) < 1e-9 else f"{abs(value):.4g}*"
        words.append(f"{sign} {factor}{name}")
    text = " ".join(words)
    return text[2:] if text.startswith("+ ") else text
