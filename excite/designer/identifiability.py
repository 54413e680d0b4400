"""Practical identifiability: how precisely a recording determines each parameter direction.

1/λ, with λ an eigenvalue of I·H₀⁻¹ and I the information of the whole recording, is the scale-free
variance of its direction. A direction is practically identifiable when 1/λ is at most a threshold
(Lee, Kwon, Wensing and Park, section 4.4).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from .._linear_algebra import triangle
from .._types import BoolArray, FloatArray
from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import (
    Parameters,
    of_pseudo_inertia,
    proper_body,
    pseudo_inertia,
)
from ..robot.parameter_names import SMALLEST_SHARE, sentence
from ..robot.robot import Robot
from ..robot.samples import Samples
from .identifiability_threshold import IDENTIFIABLE_VARIANCE, is_identifiable

SCHEMA = "excite.identifiability/1"
"""Schema of `identifiability.json`."""

SAMPLES_PER_BLOCK = 400
"""Samples whose regressor is held in memory at once [1]."""

MIN_NULL_SHARE = 1e-20
"""Squared share of a base parameter in an unexcited direction above which it is unknown [1]."""

MIN_OBSERVABLE_TRACE = 1e-9
"""Trace of the projector on observable directions below which a link has none [1]."""


class NamedRows(Protocol):
    """A robot, or any equations of which each row has a name."""

    @property
    def name(self) -> str:
        """Name of the robot."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the rows: of a robot with a fixed base, its joints."""
        ...


@dataclass(frozen=True)
class Direction:
    """Direction in parameter space.

    Attributes:
        variance: Scale-free variance 1/λ, infinite where the direction is not excited.
        identifiable: True if the variance is at most the threshold.
        words: Sentence that names the direction.
        weights: Share of each parameter in the direction, where it is above 1 %.
    """

    variance: float
    identifiable: bool
    words: str
    weights: Mapping[str, float]

    @property
    def deviation(self) -> float:
        """Standard deviation in the metric, approximately the relative one."""
        return float(np.sqrt(self.variance))


@dataclass(frozen=True)
class BaseParameter:
    """Base parameter.

    Attributes:
        name: Name of its independent parameter.
        expression: Linear combination of standard parameters.
        nominal: Nominal value.
        std: Cramér–Rao bound of the standard deviation.
    """

    name: str
    expression: str
    nominal: float
    std: float


@dataclass(frozen=True)
class IdentifiableShare:
    """Identifiable share of the parameters of a link or a joint.

    Attributes:
        name: Name of the link or joint.
        identifiable_share: Share of its observable directions that are identifiable, between 0 and
            1; None where no direction is observable.
    """

    name: str
    identifiable_share: float | None


@dataclass(frozen=True)
class Identifiability:
    """Identifiability of the parameters by a recording.

    Attributes:
        robot: Name of the robot.
        threshold: Largest scale-free variance of an identifiable direction [1].
        eigenvalues: Descending eigenvalues λ of I·H₀⁻¹. Shape (p,).
        directions: Directions, the most precise first.
        base_parameters: Base parameters with their Cramér–Rao bounds.
        links: Identifiable shares of the inertial parameters of each link.
        joints: Identifiable shares of the actuator parameters of each joint.
        joint_names: Names of the joints; with a floating base, of the rows.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        samples: Number of samples of the recording, None where unknown.
    """

    robot: str
    threshold: float
    eigenvalues: FloatArray
    directions: tuple[Direction, ...]
    base_parameters: tuple[BaseParameter, ...]
    links: tuple[IdentifiableShare, ...]
    joints: tuple[IdentifiableShare, ...]
    joint_names: tuple[str, ...]
    noise: FloatArray
    samples: int | None = None

    @property
    def identifiable_count(self) -> int:
        """Number of practically identifiable directions."""
        return sum(d.identifiable for d in self.directions)

    def document(self) -> dict[str, Any]:
        """Return the content of `identifiability.json`; values that are not finite are null."""
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
    """Return a value, None where it is not finite."""
    return float(value) if np.isfinite(value) else None


def regressor_root(Y: FloatArray, noise: FloatArray) -> FloatArray:
    """Return R with RᵀR = Σₜ Yᵀ Σ⁻¹ Y.

    The product is not formed, as that would lose half of the digits.

    Args:
        Y: Regressor along a motion. Shape (N, n, P).
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].

    Returns:
        The root R. Shape (≤ P, P).
    """
    return triangle((Y / noise[:, None]).reshape(-1, Y.shape[2]))


def information_root(
    robot: Robot, parameters: Parameters, samples: Samples, noise: FloatArray
) -> FloatArray:
    """Return the root R of the information of a motion, computed block by block.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        samples: Samples of the motion.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].

    Returns:
        R with RᵀR = Σₜ Yᵀ Σ⁻¹ Y. Shape (≤ P, P).
    """
    parts = (
        samples.rows(slice(start, start + SAMPLES_PER_BLOCK))
        for start in range(0, len(samples), SAMPLES_PER_BLOCK)
    )
    blocks = (regressor(robot, parameters, part) for part in parts)
    return root_of_blocks(blocks, noise, parameters.count)


def root_of_blocks(blocks: Iterable[FloatArray], noise: FloatArray, count: int) -> FloatArray:
    """Return the root R of the information of consecutive samples, computed block by block.

    Args:
        blocks: Regressor Y of each block. Shape (N, n, P).
        noise: Standard deviation of each row of a sample. Shape (n,).
        count: Number P of parameters.

    Returns:
        R with RᵀR = Σₜ Yᵀ Σ⁻¹ Y. Shape (≤ P, P).
    """
    root = np.zeros((0, count))
    for Y in blocks:
        root = triangle(np.vstack([root, regressor_root(Y, noise)]))
    return root


def analyse_root(
    parameters: Parameters,
    base: Base,
    root: FloatArray,
    noise: FloatArray,
    robot: NamedRows,
    *,
    threshold: float = IDENTIFIABLE_VARIANCE,
    samples: int | None = None,
) -> Identifiability:
    """Analyse identifiability from a root of the information matrix.

    Args:
        parameters: Standard parameters of the robot.
        base: Its base parameters.
        root: R with RᵀR = Σₜ Yᵀ Σ⁻¹ Y of the whole recording: a result of `information_root` or
            several of them stacked. Shape (m, P).
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        robot: The robot.
        threshold: Largest scale-free variance of an identifiable direction [1].
        samples: Number of samples of the recording, for the record.
    """
    values, vectors = eigenvalues_and_directions(root, base)
    with np.errstate(divide="ignore"):
        variances = 1.0 / values
    identifiable_mask = is_identifiable(values, threshold)
    # W = G₀^{-1/2} V: undo the root to obtain unit vectors, then rotate to named coordinates
    units = rotation_to_named_coordinates(parameters) @ np.linalg.solve(
        parameters.scale, base.geometric @ vectors
    )
    directions = []
    for variance, identifiable, unit in zip(variances, identifiable_mask, units.T, strict=True):
        shares = unit**2 / np.sum(unit**2)
        weights = {
            parameters.names[i]: float(shares[i])
            for i in np.argsort(-shares, kind="stable")
            if shares[i] > SMALLEST_SHARE
        }
        words = sentence(parameters, shares, float(variance), bool(identifiable))
        directions.append(Direction(float(variance), bool(identifiable), words, weights))
    links, joints = _shares(parameters, units, identifiable_mask)
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


def identifiable_count(
    root: FloatArray, base: Base, threshold: float = IDENTIFIABLE_VARIANCE
) -> int:
    """Return the number of practically identifiable directions.

    Args:
        root: Root of the information. Shape (m, P).
        base: Base parameters.
        threshold: Largest scale-free variance of an identifiable direction [1].
    """
    return int(is_identifiable(eigenvalues_and_directions(root, base)[0], threshold).sum())


def eigenvalues_and_directions(root: FloatArray, base: Base) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues and directions of the scaled information.

    Args:
        root: Root of the information. Shape (m, P).
        base: Base parameters.

    Returns:
        Descending eigenvalues λ of I·H₀⁻¹, shape (p,), and their directions as columns in the
        coordinates of `base.geometric`, shape (p, p).
    """
    _, singular, right = np.linalg.svd(triangle(root @ base.geometric), full_matrices=True)
    values = np.zeros(base.count)
    floor = (
        base.count * np.finfo(float).eps * max(float(singular[0]), 0.0) if len(singular) else 0.0
    )
    values[: len(singular)] = np.where(singular > floor, singular, 0.0) ** 2
    return values, right.T


def _base_parameters(
    parameters: Parameters, base: Base, vectors: FloatArray, variances: FloatArray
) -> tuple[BaseParameter, ...]:
    """Return base parameters θ = Bψ with covariance (BWV) diag(1/λ) (BWV)ᵀ (Cramér–Rao)."""
    factors = (base.matrix @ base.geometric @ vectors) ** 2
    # an unexcited direction makes all base parameters with a share in it unknown
    has_share = factors > MIN_NULL_SHARE * factors.sum(axis=1, keepdims=True)
    spread = np.where(has_share, factors, 0.0)
    finite = np.isfinite(variances)
    std = np.sqrt(spread[:, finite] @ variances[finite])
    std[has_share[:, ~finite].any(axis=1)] = np.inf
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
    parameters: Parameters, units: FloatArray, identifiable_mask: BoolArray
) -> tuple[tuple[IdentifiableShare, ...], tuple[IdentifiableShare, ...]]:
    """Return the identifiable shares of links and of joint actuators.

    A share is the trace of the projector on the identifiable directions over that on all observable
    directions, both restricted to the parameters of the link or joint. The traces are taken in the
    metric, where they do not depend on units or on the choice of a base.

    Args:
        parameters: Standard parameters.
        units: Directions as unit vectors in named coordinates. Shape (P, p).
        identifiable_mask: Mask of the identifiable directions. Shape (p,).
    """
    squares = units**2
    identifiable, observable = squares[:, identifiable_mask].sum(axis=1), squares.sum(axis=1)

    def share(name: str, rows: list[int]) -> IdentifiableShare:
        total = float(observable[rows].sum())
        return IdentifiableShare(
            name,
            min(1.0, float(identifiable[rows].sum()) / total)
            if total > MIN_OBSERVABLE_TRACE
            else None,
        )

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


def rotation_to_named_coordinates(parameters: Parameters) -> FloatArray:
    """Return the rotation from whitened coordinates to coordinates that are named after parameters.

    Whitened coordinates may be rotated within a body. The rotated ones are: mass (with constant
    centre of mass and shape), centre of mass along x, y, z (with constant mass), and moments of
    inertia about the centre of mass, each as close to the parameter it is named after as whitened
    coordinates can be.

    Returns:
        Orthogonal matrix. Shape (P, P).
    """
    out = np.eye(parameters.count)
    masses = parameters.nominal[0 : 10 * parameters.bodies : 10]
    total = float(np.maximum(masses, 0.0).sum())
    for i in range(parameters.bodies):
        block = slice(10 * i, 10 * i + 10)
        named = named_coordinates_root(proper_body(parameters.nominal[block], total)[0])
        size = np.linalg.norm(named, axis=1)[:, None]  # rows differ in unit: kg, kg m, kg m²
        rotation = np.linalg.solve(named / size, parameters.scale[block, block] / size)
        left, _, right = np.linalg.svd(rotation)
        out[block, block] = left @ right  # nearest orthogonal matrix, against rounding
    return out


def named_coordinates_root(phi: FloatArray) -> FloatArray:
    """Return K with K Kᵀ = g(φ)⁻¹, a column per named parameter of a body. Shape (10, 10)."""
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
        out[:, k] = of_pseudo_inertia(factor @ unit @ factor.T)
    block = out[4:, 4:]
    spread = np.linalg.norm(block, axis=1)
    correlation, vectors = np.linalg.eigh((block / spread[:, None]) @ (block / spread[:, None]).T)
    # whitening that correlates most with the named quantities (Kessy, Lewin and Strimmer 2018,
    # "ZCA-cor")
    out[4:, 4:] = spread[:, None] * ((vectors * np.sqrt(np.maximum(correlation, 0.0))) @ vectors.T)
    return out
