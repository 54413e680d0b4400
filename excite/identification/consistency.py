"""Physically consistent parameters: min ½‖R(Bψ − θ̂)‖² + γ d(ψ, ψ₀)² with every body a body, every friction ≥ 0 (review, eq. 21).

A damped Newton method inside a logarithmic barrier whose weight falls until it could cost no more than a hundredth
of a unit of log-likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import UnusableInput
from ..robot.inertial_parameters import Parameters, proper_body, pseudo_inertia
from .inertia_distance import Distance, NominalFrames, distance_metrics, pseudo_inertias

Array = np.ndarray
NONNEGATIVE_KINDS = ("rotor_inertia", "viscous", "coulomb")
BARRIER_WEIGHTS = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
MIN_PSEUDO_INERTIA = 1e-6
"""Every body keeps P ≻ FLOOR · P₀: one on the very edge of being none cannot be reckoned with."""
STEPS = 60
DECREMENT = 1e-8
NEAR = 0.05
"""Where a positive parameter is nominally 0 the search starts at this share of its scale."""


@dataclass(frozen=True)
class Bounds:
    """Further convex constraints. mass: link -> (least, most) [kg]. centre: link -> two corners of a box that holds its centre of
    mass, in the frame of the joint that moves it. Shape (2, 3) [m]."""

    mass: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    centre: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Prior:
    """Where ψ should stay near. nominal: ψ₀, every body made one. Shape (P,). distance: which, for bodies.

    bodies: γ for inertial parameters. drives: γ for each friction, rotor inertia and offset, whose nominal values are often
    unknown; scales: theirs. Shapes (P − 10 bodies,).
    """

    nominal: Array
    distance: Distance
    bodies: float
    drives: Array
    scales: Array


@dataclass(frozen=True)
class ConsistentEstimate:
    """psi: ψ̂. Shape (P,). covariance: of ψ̂, data and prior together, (RᵀR + 2γG)⁻¹ at the solution. Shape (P, P).

    misfit: ½‖R(Bψ̂ − θ̂)‖², what consistency and the prior cost in log-likelihood. distance: d(ψ̂, ψ₀)². steps: Newton's.
    """

    psi: Array
    covariance: Array
    misfit: float
    distance: float
    steps: int


def consistent_nominal(parameters: Parameters) -> Array:
    """ψ₀ with every body made physically consistent by the stated rule, and negative friction 0. Shape (P,)."""
    psi, edge = parameters.nominal.copy(), 10 * parameters.bodies
    mass = float(np.maximum(psi[:edge:10], 0.0).sum()) or 1.0
    for i in range(0, edge, 10):
        psi[i : i + 10] = proper_body(psi[i : i + 10], mass)[0]
    for kind in NONNEGATIVE_KINDS:
        if kind in parameters.drive:
            psi[parameters.block(kind)] = np.maximum(psi[parameters.block(kind)], 0.0)
    return psi


def inertial_rows(parameters: Parameters, psi: Array) -> Array:
    """The inertial part of ψ, a row a body. Shape (b, 10)."""
    out: Array = psi[: 10 * parameters.bodies].reshape(-1, 10)
    return out


def prior_information(parameters: Parameters, prior: Prior) -> Array:
    """2γG of the prior near ψ₀, the information it is worth. Shape (P, P)."""
    edge = 10 * parameters.bodies
    out = np.diag(np.concatenate([np.zeros(edge), 2.0 * prior.drives / prior.scales**2]))
    for i, G in enumerate(distance_metrics(prior.distance, inertial_rows(parameters, prior.nominal))):
        out[10 * i : 10 * i + 10, 10 * i : 10 * i + 10] = 2.0 * prior.bodies * G
    return out


class _Problem:
    """The function of ψ at one weight of the barrier, with its derivatives."""

    def __init__(
        self,
        parameters: Parameters,
        root: Array,
        target: Array,
        prior: Prior,
        rows: Array,
        levels: Array,
    ) -> None:
        self.parameters, self.root, self.target, self.prior = parameters, root, target, prior
        self.edge = 10 * parameters.bodies
        self.frame = NominalFrames(inertial_rows(parameters, prior.nominal))
        self.rows, self.levels = rows, levels  # rows ψ > levels
        self.scale = prior.scales
        self.information = root.T @ root

    def slack(self, psi: Array) -> Array:
        return np.asarray(self.rows @ psi - self.levels)

    def split(self, psi: Array) -> Array:
        return inertial_rows(self.parameters, psi)

    def value(self, psi: Array, weight: float) -> float:
        """∞ outside."""
        slack, bodies = self.slack(psi), self.split(psi)
        if (slack.size and float(slack.min()) <= 0.0) or self.frame.least(bodies) <= MIN_PSEUDO_INERTIA:
            return float("inf")
        misfit = self.root @ psi - self.target
        inside = float(np.sum(np.log(slack))) - float(self.frame.barrier(bodies, MIN_PSEUDO_INERTIA).value.sum())
        return 0.5 * float(misfit @ misfit) + self.far(psi) - weight * inside

    def far(self, psi: Array) -> float:
        delta = (psi - self.prior.nominal)[self.edge :] / self.scale
        own = self.frame.squared(self.prior.distance, self.split(psi)).value
        return float(self.prior.drives @ delta**2) + self.prior.bodies * float(own.sum())

    def derivatives(self, psi: Array, weight: float) -> tuple[Array, Array]:
        gradient = self.root.T @ (self.root @ psi - self.target)
        hessian = self.information.copy()
        slack = self.slack(psi)
        gradient -= weight * self.rows.T @ (1.0 / slack)
        hessian += weight * (self.rows.T / slack**2) @ self.rows
        gradient[self.edge :] += (
            2.0 * self.prior.drives * (psi - self.prior.nominal)[self.edge :] / self.scale**2
        )
        index = np.arange(self.edge, len(psi))
        hessian[index, index] += 2.0 * self.prior.drives / self.scale**2
        bodies = self.split(psi)
        parts = (
            (weight, self.frame.barrier(bodies, MIN_PSEUDO_INERTIA)),
            (self.prior.bodies, self.frame.squared(self.prior.distance, bodies)),
        )
        for factor, part in parts:
            gradient[: self.edge] += factor * part.gradient.ravel()
            for i, block in enumerate(part.hessian):
                hessian[10 * i : 10 * i + 10, 10 * i : 10 * i + 10] += factor * block
        return gradient, hessian

    def longest(self, psi: Array, step: Array) -> float:
        """Largest step that stays inside everything."""
        change, slack = self.rows @ step, self.slack(psi)
        falling = change < 0.0
        lines = float(np.min(-slack[falling] / change[falling])) if falling.any() else np.inf
        return min(lines, self.frame.reach(self.split(psi), self.split(step), MIN_PSEUDO_INERTIA))


def maximum_a_posteriori(
    parameters: Parameters, root: Array, target: Array, prior: Prior, bounds: Bounds | None = None
) -> ConsistentEstimate:
    """ψ̂ = argmin ½‖root ψ − target‖² + γ d², physically consistent. root: R B. Shape (m, P). target: R θ̂. Shape (m,).

    Raises UnusableInput when bounds leave no body.
    """
    rows, levels = _halfspaces(parameters, bounds or Bounds())
    problem = _Problem(parameters, root, target, prior, rows, levels)
    psi = _inside(parameters, prior.nominal, bounds or Bounds())
    if rows.size and float(problem.slack(psi).min()) <= 0.0:
        raise UnusableInput("bounds of mass and centre leave no room for a body; widen them")
    steps, ridge = 0, 1e-13 * np.eye(parameters.count)  # below rounding
    for weight in BARRIER_WEIGHTS:
        for _ in range(STEPS):
            gradient, hessian = problem.derivatives(psi, weight)
            scale = 1.0 / np.sqrt(np.diag(hessian))
            step = -scale * np.linalg.solve(
                hessian * np.outer(scale, scale) + ridge, scale * gradient
            )
            decrement = -float(gradient @ step)
            steps += 1
            if decrement < (DECREMENT if weight == BARRIER_WEIGHTS[-1] else 1e-3):
                break
            psi = _searched(problem, psi, step, decrement, weight)
    hessian = problem.derivatives(psi, 0.0)[1]
    misfit = root @ psi - target
    far = problem.far(psi) / prior.bodies if prior.bodies else 0.0
    return ConsistentEstimate(psi, symmetric_pseudo_inverse(hessian), 0.5 * float(misfit @ misfit), far, steps)


def _searched(problem: _Problem, psi: Array, step: Array, decrement: float, weight: float) -> Array:
    length, now = min(1.0, 0.95 * problem.longest(psi, step)), problem.value(psi, weight)
    for _ in range(40):
        if problem.value(psi + length * step, weight) <= now - 1e-4 * length * decrement:
            return np.asarray(psi + length * step)
        length *= 0.5
    return psi


def symmetric_pseudo_inverse(hessian: Array) -> Array:
    """Of a symmetric matrix whose rows have very different units; 0 where it has no information."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    values, vectors = np.linalg.eigh(hessian * np.outer(scale, scale))
    kept = values > 1e-14 * values[-1]
    half = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(half @ half.T)


def _halfspaces(parameters: Parameters, bounds: Bounds) -> tuple[Array, Array]:
    """Linear constraints rows ψ > levels: friction and rotor inertia positive, masses and centres within bounds."""
    rows, levels = [], []

    def add(entries: Mapping[int, float], level: float = 0.0) -> None:
        row = np.zeros(parameters.count)
        for place, factor in entries.items():
            row[place] = factor
        rows.append(row)
        levels.append(level)

    for kind in NONNEGATIVE_KINDS:
        if kind in parameters.drive:
            for place in range(parameters.count)[parameters.block(kind)]:
                add({place: 1.0})
    for link, (least, most) in bounds.mass.items():
        place = 10 * _link(parameters, link)
        add({place: 1.0}, least)
        add({place: -1.0}, -most)
    for link, box in bounds.centre.items():
        place = 10 * _link(parameters, link)
        for axis in range(3):
            add({place + 1 + axis: 1.0, place: -float(box[0][axis])})
            add({place + 1 + axis: -1.0, place: float(box[1][axis])})
    return np.array(rows).reshape(-1, parameters.count), np.array(levels)


def _link(parameters: Parameters, link: str) -> int:
    if link not in parameters.links:
        raise UnusableInput(f"bounds: no link '{link}'; there are {', '.join(parameters.links)}")
    return parameters.links.index(link)


def _inside(parameters: Parameters, nominal: Array, bounds: Bounds) -> Array:
    """A point that obeys every constraint strictly, near the nominal one."""
    psi, edge = nominal.copy(), 10 * parameters.bodies
    for kind in NONNEGATIVE_KINDS:
        if kind in parameters.drive:
            block = parameters.block(kind)
            psi[block] = np.maximum(psi[block], NEAR * np.diag(parameters.scale)[block])
    for i in range(0, edge, 10):
        link = parameters.links[i // 10]
        if link not in bounds.mass and link not in bounds.centre:
            continue
        mass, centre = psi[i], psi[i + 1 : i + 4] / psi[i]
        second = pseudo_inertia(psi[i : i + 10])[:3, :3] - mass * np.outer(centre, centre)
        if link in bounds.mass:
            least, most = bounds.mass[link]
            wanted = float(
                np.clip(mass, least + 0.05 * (most - least), most - 0.05 * (most - least))
            )
            second, mass = second * wanted / mass, wanted
        if link in bounds.centre:
            low, high = np.asarray(bounds.centre[link], float)
            centre = np.clip(centre, low + 0.05 * (high - low), high - 0.05 * (high - low))
        second = second + mass * np.outer(centre, centre)
        tensor = np.trace(second) * np.eye(3) - second
        psi[i : i + 10] = [
            mass,
            *(mass * centre),
            tensor[0, 0],
            tensor[0, 1],
            tensor[1, 1],
            tensor[0, 2],
            tensor[1, 2],
            tensor[2, 2],
        ]
    return psi


def is_consistent(parameters: Parameters, psi: Array) -> bool:
    """Whether every body's pseudo-inertia is positive definite and every friction and rotor inertia is not negative."""
    bodies = bool((np.linalg.eigvalsh(pseudo_inertias(inertial_rows(parameters, psi))) > 0.0).all())
    return bodies and all(
        float(psi[parameters.block(kind)].min()) >= 0.0
        for kind in NONNEGATIVE_KINDS
        if kind in parameters.drive
    )


def map_objective(
    parameters: Parameters, root: Array, target: Array, prior: Prior, psi: Array
) -> float:
    """½‖root ψ − target‖² + γ d(ψ, ψ₀)², what `maximum_a_posteriori` minimises. psi: physically consistent. Shape (P,)."""
    edge = 10 * parameters.bodies
    misfit = root @ psi - target
    bodies = (
        NominalFrames(inertial_rows(parameters, prior.nominal))
        .squared(prior.distance, inertial_rows(parameters, psi))
        .value
    )
    drives = ((psi - prior.nominal)[edge:] / prior.scales) ** 2
    return (
        0.5 * float(misfit @ misfit)
        + prior.bodies * float(bodies.sum())
        + float(prior.drives @ drives)
    )
