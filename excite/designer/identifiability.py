"""Practical identifiability: how well a recording will show each direction of the parameters, in words too.

1/λ, λ an eigenvalue of I·H₀⁻¹ with I the information of the whole recording, is the scale-free variance of its
direction; a direction is identifiable when 1/λ ≤ threshold (Lee, Wensing & Park, section 4.4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import Parameters, proper_body, pseudo_inertia
from ..robot.parameter_names import SMALLEST_SHARE, sentence
from ..robot.robot import Robot
from ..robot.samples import Samples

Array = np.ndarray
SCHEMA = "excite.identifiability/1"
IDENTIFIABLE_VARIANCE = 1e-2
SAMPLES_PER_BLOCK = 400


@dataclass(frozen=True)
class Direction:
    """One direction of the parameters. variance: 1/λ, inf where it is not excited at all. weights: shares above 1 %."""

    variance: float
    identifiable: bool
    words: str
    weights: Mapping[str, float]

    @property
    def deviation(self) -> float:
        """Standard deviation in the metric, roughly a relative one."""
        return float(np.sqrt(self.variance))


@dataclass(frozen=True)
class BaseParameter:
    """One base parameter: what it is called, its nominal value and the least standard deviation an unbiased fit has."""

    name: str
    expression: str
    nominal: float
    std: float


@dataclass(frozen=True)
class IdentifiableShare:
    """Part of what can be known of a link or joint that the recording will show; None where nothing can be known."""

    name: str
    identifiable_share: float | None


@dataclass(frozen=True)
class Identifiability:
    """What a recording will tell. Directions are ordered from the best seen to the worst.

    eigenvalues: λ of I·H₀⁻¹, falling. Shape (p,).
    links, joints: shares of each link's ten inertial parameters, and of each joint's drive parameters.
    noise: standard deviation of torque per joint. Shape (n,) [N m]. samples: rows of the recording, if known.
    """

    robot: str
    threshold: float
    eigenvalues: Array
    directions: tuple[Direction, ...]
    base_parameters: tuple[BaseParameter, ...]
    links: tuple[IdentifiableShare, ...]
    joints: tuple[IdentifiableShare, ...]
    joint_names: tuple[str, ...]
    noise: Array
    samples: int | None = None

    @property
    def identifiable_count(self) -> int:
        """How many directions are practically identifiable."""
        return sum(d.identifiable for d in self.directions)

    def document(self) -> dict[str, Any]:
        """`identifiability.json`; what is not finite (a direction never excited) is null, so that the JSON is strict."""
        return {
            "schema": SCHEMA,
            "robot": self.robot,
            "threshold": self.threshold,
            "samples": self.samples,
            "identifiable": self.identifiable_count,
            "eigenvalues": [_finite(v) for v in self.eigenvalues],
            "directions": [
                {
                    "variance": _finite(d.variance),
                    "identifiable": d.identifiable,
                    "words": d.words,
                    "weights": dict(d.weights),
                }
                for d in self.directions
            ],
            "base_parameters": [
                {
                    "name": b.name,
                    "expression": b.expression,
                    "nominal": _finite(b.nominal),
                    "std": _finite(b.std),
                }
                for b in self.base_parameters
            ],
            "links": [
                {"name": s.name, "identifiable_share": s.identifiable_share} for s in self.links
            ],
            "joints": [
                {"name": s.name, "identifiable_share": s.identifiable_share} for s in self.joints
            ],
            "torque_noise": {
                j: _finite(v) for j, v in zip(self.joint_names, self.noise, strict=True)
            },
        }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


# -- information ---------------------------------------------------------------------------------------------


def _triangle(rows: Array) -> Array:
    """R of the QR factorisation."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def regressor_root(Y: Array, noise: Array) -> Array:
    """R with RᵀR = Σ Yᵀ Σ⁻¹ Y, without forming the product, which would lose half of the digits. Shape (≤ P, P)."""
    return _triangle((Y / noise[:, None]).reshape(-1, Y.shape[2]))


def information_root(robot: Robot, parameters: Parameters, samples: Samples, noise: Array) -> Array:
    """`root_of` the regressor along a motion, block by block so that long motions of large robots fit in memory."""
    root = np.zeros((0, parameters.count))
    for start in range(0, len(samples), SAMPLES_PER_BLOCK):
        block = regressor_root(
            regressor(robot, parameters, samples.rows(slice(start, start + SAMPLES_PER_BLOCK))), noise
        )
        root = _triangle(np.vstack([root, block]))
    return root


def analyse_information(
    parameters: Parameters,
    base: Base,
    information: Array,
    noise: Array,
    robot: Robot,
    *,
    threshold: float = IDENTIFIABLE_VARIANCE,
    samples: int | None = None,
) -> Identifiability:
    """Identifiability from the information Σ Yᵀ Σ⁻¹ Y of the whole recording, in standard parameters. Shape (P, P).

    `analyse_root` is more accurate where directions are seen very unequally; use it when the regressor is at hand.
    """
    values, vectors = np.linalg.eigh(base.geometric.T @ information @ base.geometric)
    # below this the digits are those of rounding, not of the motion
    kept = np.where(
        values > len(values) * np.finfo(float).eps * max(float(values[-1]), 0.0), values, 0.0
    )
    frame = _Frame(parameters, base, kept[::-1], vectors[:, ::-1])
    return _describe(frame, robot, noise, threshold, samples)


def analyse_root(
    parameters: Parameters,
    base: Base,
    root: Array,
    noise: Array,
    robot: Robot,
    *,
    threshold: float = IDENTIFIABLE_VARIANCE,
    samples: int | None = None,
) -> Identifiability:
    """Identifiability from R with RᵀR = Σ Yᵀ Σ⁻¹ Y: `root_of`, `information_root`, or any such rows stacked. Shape (m, P)."""
    values, vectors = eigenvalues_and_directions(root, base)
    return _describe(_Frame(parameters, base, values, vectors), robot, noise, threshold, samples)


def eigenvalues_and_directions(root: Array, base: Base) -> tuple[Array, Array]:
    """λ, falling, and the directions in the coordinates of base.geometric as columns. Shapes (p,), (p, p)."""
    _, singular, right = np.linalg.svd(_triangle(root @ base.geometric), full_matrices=True)
    values = np.zeros(base.count)
    floor = (
        base.count * np.finfo(float).eps * max(float(singular[0]), 0.0) if len(singular) else 0.0
    )
    values[: len(singular)] = np.where(singular > floor, singular, 0.0) ** 2
    return values, right.T


# -- description ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Frame:
    """Eigenvalues, falling, with their directions as columns in the coordinates of base.geometric."""

    parameters: Parameters
    base: Base
    values: Array
    vectors: Array


def _describe(
    frame: _Frame, robot: Robot, noise: Array, threshold: float, samples: int | None
) -> Identifiability:
    parameters, base, values, vectors = frame.parameters, frame.base, frame.values, frame.vectors
    with np.errstate(divide="ignore"):
        variances = 1.0 / values
    seen = variances <= threshold
    # W = G₀^{-1/2} V: undo the root to have each direction as a unit vector, then name its components
    units = _rotation(parameters) @ np.linalg.solve(parameters.scale, base.geometric @ vectors)
    directions = []
    for variance, identifiable, unit in zip(variances, seen, units.T, strict=True):
        shares = unit**2 / np.sum(unit**2)
        weights = {
            parameters.names[i]: float(shares[i])
            for i in np.argsort(-shares, kind="stable")
            if shares[i] > SMALLEST_SHARE
        }
        words = sentence(parameters, shares, float(variance), bool(identifiable))
        directions.append(Direction(float(variance), bool(identifiable), words, weights))
    links, joints = _shares(parameters, units, seen)
    return Identifiability(
        robot=robot.name,
        threshold=float(threshold),
        eigenvalues=values,
        directions=tuple(directions),
        base_parameters=_base_parameters(parameters, base, vectors, variances),
        links=links,
        joints=joints,
        joint_names=robot.joints,
        noise=np.asarray(noise, float),
        samples=samples,
    )


def _base_parameters(
    parameters: Parameters, base: Base, vectors: Array, variances: Array
) -> tuple[BaseParameter, ...]:
    """Cramér-Rao standard deviations of θ = Bψ: the covariance is (BWV) diag(1/λ) (BWV)ᵀ."""
    factors = (base.matrix @ base.geometric @ vectors) ** 2
    # a direction never excited makes every θ that has a part in it unknown, and no other
    touched = factors > 1e-20 * factors.sum(axis=1, keepdims=True)
    spread = np.where(touched, factors, 0.0)
    finite = np.isfinite(variances)
    std = np.sqrt(spread[:, finite] @ variances[finite])
    std[touched[:, ~finite].any(axis=1)] = np.inf
    nominal = base.matrix @ parameters.nominal
    return tuple(
        BaseParameter(
            parameters.names[base.independent[k]],
            base.expressions[k],
            float(nominal[k]),
            float(std[k]),
        )
        for k in range(base.count)
    )


def _shares(
    parameters: Parameters, units: Array, seen: Array
) -> tuple[tuple[IdentifiableShare, ...], tuple[IdentifiableShare, ...]]:
    """Per link, and per joint for its drive: trace of the projector onto the identifiable directions, restricted to the
    block of the link's ten parameters, over that of the projector onto all observable directions.

    Traces are taken in the metric, where they depend on no choice of units or of a base.
    """
    squares = units**2
    visible, all_of_it = squares[:, seen].sum(axis=1), squares.sum(axis=1)

    def share(name: str, rows: list[int]) -> IdentifiableShare:
        total = float(all_of_it[rows].sum())
        return IdentifiableShare(name, min(1.0, float(visible[rows].sum()) / total) if total > 1e-9 else None)

    links = tuple(
        share(link, list(range(10 * i, 10 * i + 10))) for i, link in enumerate(parameters.links)
    )
    start, n = 10 * parameters.bodies, len(parameters.joints)
    joints = tuple(
        share(joint, [start + k * n + j for k in range(len(parameters.drive))])
        for j, joint in enumerate(parameters.joints)
        if parameters.drive
    )
    return links, joints


def _rotation(parameters: Parameters) -> Array:
    """Orthogonal Q that takes whitened coordinates to ones that can be named after a parameter. Shape (P, P).

    Whitened coordinates may be turned within a body. Here they become: mass (centre of mass and shape kept), centre of
    mass along x, y, z (mass kept), and moments of inertia about the centre of mass, each as close as a whitened
    coordinate can be to the parameter whose name it gets.
    """
    out = np.eye(parameters.count)
    masses = parameters.nominal[0 : 10 * parameters.bodies : 10]
    total = float(np.maximum(masses, 0.0).sum())
    for i in range(parameters.bodies):
        block = slice(10 * i, 10 * i + 10)
        named = _named_root(proper_body(parameters.nominal[block], total)[0])
        size = np.linalg.norm(named, axis=1)[:, None]  # rows in kg beside rows in kg m²
        turned = np.linalg.solve(named / size, parameters.scale[block, block] / size)
        left, _, right = np.linalg.svd(turned)
        out[block, block] = left @ right  # the nearest orthogonal matrix, against rounding
    return out


def _named_root(phi: Array) -> Array:
    """K with K Kᵀ = g(φ)⁻¹, one column for each of a body's parameters (see `_rotation`). Shape (10, 10)."""
    mass, centre = phi[0], phi[1:4] / phi[0]
    values, axes = np.linalg.eigh(pseudo_inertia(phi)[:3, :3] - mass * np.outer(centre, centre))
    size = (axes * np.sqrt(np.maximum(values, 1e-300))) @ axes.T
    factor = np.zeros((4, 4))  # P = factor factorᵀ
    factor[:3, :3], factor[:3, 3], factor[3, 3] = size, np.sqrt(mass) * centre, np.sqrt(mass)
    pairs = [(3, 3), (0, 3), (1, 3), (2, 3), (0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    out = np.empty((10, 10))
    for k, (i, j) in enumerate(pairs):
        unit = np.zeros((4, 4))
        unit[i, j] = unit[j, i] = np.sqrt(2.0) if i == j else 1.0
        out[:, k] = _vector(factor @ unit @ factor.T)
    block = out[4:, 4:]
    spread = np.linalg.norm(block, axis=1)
    correlation, vectors = np.linalg.eigh((block / spread[:, None]) @ (block / spread[:, None]).T)
    # whitening that correlates most with the named quantities (Kessy, Lewin & Strimmer 2018, "ZCA-cor")
    out[4:, 4:] = spread[:, None] * ((vectors * np.sqrt(np.maximum(correlation, 0.0))) @ vectors.T)
    return out


def _vector(change: Array) -> Array:
    """The inertial parameters of a pseudo-inertia; the inverse of `pseudo_inertia`. Shapes (4, 4) -> (10,)."""
    second = change[:3, :3]
    t = np.trace(second) * np.eye(3) - second
    return np.array(
        [change[3, 3], *change[:3, 3], t[0, 0], t[0, 1], t[1, 1], t[0, 2], t[1, 2], t[2, 2]]
    )
