"""Estimate of a payload: least squares with all of the robot as nuisance, then a physical body.

The data give φ̂ and its information Λ, the robot's parameters and friction integrated out. The body
minimises ½ (φ − φ̂)ᵀ Λ (φ − φ̂) + γ D(φ, φ₀), D the log-det Bregman divergence from a uniform body
φ₀ (Lee, Wensing & Park, eq. 17), so that it can exist. Mass and centre of φ₀ are those of the
estimate unless they are stated: the prior then says nothing about them, only about the moments of
inertia.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..errors import UnusableInput
from ..identification.estimators import Estimate, estimate, student_quantile
from ..robot.inertial_parameters import (
    PSEUDO_INERTIA_BASIS,
    metric,
    of_pseudo_inertia,
    pseudo_inertia,
)
from .equations import LINK_PARAMETERS, LOAD_SHAPES, SPEED_SHAPES, PayloadEquations
from .shape import PayloadShape, ball_of_mass

LOAD_ITERATIONS = 4
"""Number of times that the friction columns are computed from the estimate of the load."""
PRIOR_ITERATIONS = 20
"""Number of times that mass and centre of the prior are moved to those of the estimate."""
NEWTON_ITERATIONS = 50
"""Largest number of Newton steps of a body."""
MASS_DEVIATION = 1e-3
"""Relative standard deviation of a stated mass."""
CENTRE_DEVIATION = 5e-3
"""Standard deviation of a stated centre [m]."""
CLEAR_DIFFERENCE = 5.0
"""Difference of a mass from another one, over its standard deviation, from which it is clear."""
SMALLEST_MASS = 1e-3
"""Mass that the prior has at least [kg]."""
UNSHOWN_INFORMATION = 1e-14
"""Least information of a direction in coordinates of unit information: rounding leaves no more."""
QUANTITIES = (
    ("mass", "kg"),
    ("centre_x", "m"),
    ("centre_y", "m"),
    ("centre_z", "m"),
    ("ixx", "kg m²"),
    ("ixy", "kg m²"),
    ("iyy", "kg m²"),
    ("ixz", "kg m²"),
    ("iyz", "kg m²"),
    ("izz", "kg m²"),
)
"""Reported quantities, the inertia about the centre of mass, and their units."""


@dataclass(frozen=True)
class DecisionRule:
    """When the data decide a quantity.

    Attributes:
        mass: Largest standard deviation of the mass over the mass.
        centre: Largest standard deviation of a coordinate of the centre [m].
        share: Smallest share of the variance of a moment of inertia that the data remove from that
            of the prior.
    """

    mass: float = 0.25
    centre: float = 0.02
    share: float = 0.5


@dataclass(frozen=True)
class PayloadQuantity:
    """A quantity of the payload.

    Attributes:
        name: Its name in `QUANTITIES`.
        unit: Its unit.
        value: Estimate.
        std: Standard deviation.
        interval: 95 % interval.
        shown: True if the data decide it, or it was stated.
    """

    name: str
    unit: str
    value: float
    std: float
    interval: tuple[float, float]
    shown: bool

    def document(self) -> dict[str, object]:
        """Content for JSON."""
        return {
            "value": self.value,
            "std": self.std,
            "interval": list(self.interval),
            "unit": self.unit,
            "shown": self.shown,
        }


@dataclass(frozen=True)
class PayloadData:
    """Estimate and information of the data, the robot's parameters and friction integrated out.

    Attributes:
        theta: φ̂, 0 in directions that the data do not show. Shape (10,).
        information: Λ. Shape (10, 10).
        degrees_of_freedom: Number of equations minus number of parameters.
    """

    theta: FloatArray
    information: FloatArray
    degrees_of_freedom: float

    @property
    def mass_deviation(self) -> float:
        """Standard deviation of the mass; ∞ where the data do not show it [kg]."""
        others, cross = self.information[1:, 1:], self.information[0, 1:]
        marginal = self.information[0, 0] - cross @ np.linalg.pinv(others, rcond=1e-12) @ cross
        return float(1.0 / np.sqrt(marginal)) if marginal > 0.0 else np.inf

    def contradicts(self, mass: float) -> bool:
        """Tell whether the data show clearly another mass than a stated one [kg]."""
        std = float(np.hypot(self.mass_deviation, MASS_DEVIATION * mass))
        return bool(abs(self.theta[0] - mass) > CLEAR_DIFFERENCE * std)


@dataclass(frozen=True)
class PayloadEstimate:
    """A payload with its uncertainty.

    Attributes:
        phi: Inertial parameters in the link's frame. Shape (10,).
        covariance: Their covariance, that of the prior included. Shape (10, 10).
        quantities: Mass, centre and inertia about it.
        load_friction: Coefficient of load friction of each joint; None: not fitted. Shape (n,) [1].
        data: Estimate of φ from the data alone.
        residual: RMS of the remaining torque of each joint. Shape (n,) [N m].
        mounting: p-value of equal payloads in all recordings; None for one recording.
    """

    phi: FloatArray
    covariance: FloatArray
    quantities: tuple[PayloadQuantity, ...]
    load_friction: FloatArray | None
    data: PayloadData
    residual: FloatArray
    mounting: float | None = None

    def __getitem__(self, name: str) -> PayloadQuantity:
        return next(quantity for quantity in self.quantities if quantity.name == name)

    @property
    def body(self) -> pin.Inertia:
        """The payload as a rigid body in the link's frame."""
        return pin.Inertia.FromDynamicParameters(self.phi)


def estimate_payload(
    equations: PayloadEquations,
    shape: PayloadShape | None = None,
    mass: float | None = None,
    rule: DecisionRule = DecisionRule(),
) -> PayloadEstimate:
    """Estimate a payload.

    Args:
        equations: Equations of recordings with and without it.
        shape: Its shape; None: unknown.
        mass: Its mass, if it was weighed [kg].
        rule: When the data decide a quantity.
    """
    fit, friction = _data_estimate(equations)
    information: FloatArray = fit.information_root.T @ fit.information_root
    data = PayloadData(fit.theta, information, fit.degrees_of_freedom)
    body = physical_payload(data, shape, mass, rule)
    columns = equations.equations.n * (LOAD_SHAPES + SPEED_SHAPES)
    return dataclasses.replace(
        body,
        load_friction=equations.load_coefficients(friction, body.phi, friction[-columns:]),
        residual=np.asarray(np.sqrt(np.mean(fit.residual**2, axis=0)), float),
        mounting=_mounting_p_value(equations, fit, body.phi),
    )


def physical_payload(
    data: PayloadData,
    shape: PayloadShape | None = None,
    mass: float | None = None,
    rule: DecisionRule = DecisionRule(),
) -> PayloadEstimate:
    """Return the body that fits the data and the prior, without load friction and residuals.

    Args:
        data: What the data say.
        shape: Its shape; None: unknown.
        mass: Its mass, if it was weighed [kg].
        rule: When the data decide a quantity.
    """
    information, target = _with_stated(data, mass)
    shape, phi0 = _start(target, shape, mass)
    phi = phi0.copy()
    for _ in range(PRIOR_ITERATIONS):
        information, target = _with_stated(data, mass, shape.centre, float(phi[0]))
        phi = _physical_body(information, target, phi0, 0.5 / shape.deviation**2, phi)
        moved = _shaped(phi, shape, mass)
        if np.linalg.norm(moved - phi0) < 1e-9 * np.linalg.norm(moved):
            break
        phi0 = moved
    prior = _prior_information(phi, shape, mass)
    covariance = _inverse(information + prior)
    quantile = student_quantile(data.degrees_of_freedom)
    quantities = _quantities(phi, covariance, prior, quantile, rule, mass)
    return PayloadEstimate(phi, covariance, quantities, None, data, np.zeros(0))


def _data_estimate(equations: PayloadEquations) -> tuple[Estimate, FloatArray]:
    """Estimate of φ from the data alone, and the coefficients of the robot and its friction."""
    fixed, columns = equations.robot_columns(), equations.payload_columns()
    rows = dataclasses.replace(equations.equations, regressor=columns)
    theta, phi = np.zeros(fixed.shape[2]), np.zeros(LINK_PARAMETERS)
    first = estimate(rows, nuisance=fixed)
    theta, phi = first.nuisance_coefficients, first.theta
    out = first
    for _ in range(LOAD_ITERATIONS):
        nuisance = np.concatenate([fixed, equations.friction_columns(theta, phi)], axis=2)
        out = estimate(rows, nuisance=nuisance)
        theta, phi = out.nuisance_coefficients, out.theta
    return out, theta


def _inverse(information: FloatArray) -> FloatArray:
    """Invert an information matrix; directions without information get a very large variance."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    half = scale[:, None] * vectors / np.sqrt(np.maximum(values, UNSHOWN_INFORMATION))
    return np.asarray(half @ half.T)


def _with_stated(
    data: PayloadData,
    mass: float | None,
    centre: FloatArray | None = None,
    amount: float = SMALLEST_MASS,
) -> tuple[FloatArray, FloatArray]:
    """Information of the data and of a stated mass and centre, and the parameters of its minimum.

    A stated centre c says that h − m c is zero with a deviation of m times that of the centre, and
    nothing about the mass m.

    Args:
        data: What the data say.
        mass: The stated mass [kg]; None: none.
        centre: The stated centre of mass, shape (3,) [m]; None: none.
        amount: The mass by which the deviation is multiplied [kg].
    """
    information = data.information.copy()
    score = information @ data.theta
    if mass is not None:
        weight = 1.0 / (MASS_DEVIATION * mass) ** 2
        information[0, 0] += weight
        score[0] += weight * mass
    if centre is not None:
        offset = np.zeros((3, LINK_PARAMETERS))
        offset[:, 0], offset[:, 1:4] = -centre, np.eye(3)
        information += offset.T @ offset / (amount * CENTRE_DEVIATION) ** 2
    return information, np.asarray(np.linalg.lstsq(information, score, rcond=1e-12)[0], float)


def _start(
    target: FloatArray, shape: PayloadShape | None, mass: float | None
) -> tuple[PayloadShape, FloatArray]:
    """The shape, and a body of it with the mass and the centre that the data suggest."""
    amount = float(mass if mass is not None else max(float(target[0]), SMALLEST_MASS))
    shape = ball_of_mass(amount) if shape is None else shape
    centre = shape.centre
    if centre is None:
        centre = np.clip(target[1:4] / amount, -1.0, 1.0)
    return shape, _body(amount, centre, shape.second)


def _body(mass: float, centre: FloatArray, second: FloatArray) -> FloatArray:
    """Inertial parameters of a body by its mass, centre and second moments over the mass."""
    point, spread = np.append(centre, 1.0), np.zeros((4, 4))
    spread[:3, :3] = second
    return of_pseudo_inertia(mass * (np.outer(point, point) + spread))


def _shaped(phi: FloatArray, shape: PayloadShape, mass: float | None) -> FloatArray:
    """The body of the shape with the mass and the centre of an estimate, unless they are stated."""
    amount = float(phi[0]) if mass is None else mass
    centre = phi[1:4] / phi[0] if shape.centre is None else shape.centre
    return _body(amount, centre, shape.second)


def _prior_information(phi: FloatArray, shape: PayloadShape, mass: float | None) -> FloatArray:
    """Information of the prior at the estimate φ (Laplace), without its directions of mass and
    centre unless they are stated. Shape (10, 10).

    The second derivative of D is twice the metric at φ.
    """
    G = metric(phi) / shape.deviation**2
    free = [phi / phi[0]] if mass is None else []
    if shape.centre is None:
        free += _shifts(phi)
    if free:
        U = np.column_stack(free)
        G = G - G @ U @ np.linalg.solve(U.T @ G @ U, U.T @ G)
    return np.asarray(G)


def _shifts(phi: FloatArray) -> list[FloatArray]:
    """Changes of the parameters per metre of a shift of the body along x, y and z."""
    P, out = pseudo_inertia(phi), []
    for k in range(3):
        D = np.zeros((4, 4))
        D[k, 3] = 1.0
        out.append(of_pseudo_inertia(D @ P + P @ D.T))
    return out


def _physical_body(
    information: FloatArray, target: FloatArray, phi0: FloatArray, weight: float, start: FloatArray
) -> FloatArray:
    """Minimise ½ (φ − φ̂)ᵀ Λ (φ − φ̂) + γ D(φ, φ₀) by a damped Newton method.

    Args:
        information: Λ. Shape (10, 10).
        target: φ̂. Shape (10,).
        phi0: Body of the prior. Shape (10,).
        weight: γ.
        start: A body from which to start. Shape (10,).
    """
    inverse0 = np.linalg.inv(pseudo_inertia(phi0))
    linear = np.einsum("ab,iba->i", inverse0, PSEUDO_INERTIA_BASIS)

    def value(phi: FloatArray) -> float:
        P = pseudo_inertia(phi)
        values = np.linalg.eigvalsh(P)
        if values[0] <= 0.0:
            return np.inf
        misfit = phi - target
        barrier = float(np.sum(inverse0 * P)) - float(np.sum(np.log(values)))
        return 0.5 * float(misfit @ information @ misfit) + weight * barrier

    phi = start.copy()
    for _ in range(NEWTON_ITERATIONS):
        scaled = np.linalg.solve(pseudo_inertia(phi), PSEUDO_INERTIA_BASIS)
        gradient = information @ (phi - target) + weight * (
            linear - np.trace(scaled, axis1=1, axis2=2)
        )
        hessian = information + weight * np.einsum("iab,jba->ij", scaled, scaled)
        step = -np.linalg.solve(hessian, gradient)
        length, current = 1.0, value(phi)
        while value(phi + length * step) > current + 1e-4 * length * float(gradient @ step):
            length *= 0.5
            if length < 1e-12:
                return phi
        phi = phi + length * step
        if -float(gradient @ step) < 1e-12:
            break
    return phi


def _quantities(
    phi: FloatArray,
    covariance: FloatArray,
    prior: FloatArray,
    quantile: float,
    rule: DecisionRule,
    stated_mass: float | None,
) -> tuple[PayloadQuantity, ...]:
    """Mass, centre and inertia about it, by the delta method."""
    values, J = _centred(phi), _centred_jacobian(phi)
    std = np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0))
    # before the recordings, mass and centre are unknown, and moments as the prior has them
    alone = np.linalg.pinv(prior, rcond=1e-10)
    before = np.sqrt(np.maximum(np.diag(J @ alone @ J.T), 1e-300))
    out = []
    for k, (name, unit) in enumerate(QUANTITIES):
        value, deviation = float(values[k]), float(std[k])
        if name == "mass":
            shown = stated_mass is not None or deviation < rule.mass * value
        elif name.startswith("centre"):
            shown = deviation < rule.centre
        else:
            shown = 1.0 - (deviation / before[k]) ** 2 > rule.share
        half = quantile * deviation
        out.append(
            PayloadQuantity(name, unit, value, deviation, (value - half, value + half), shown)
        )
    if not out[0].shown:  # without a mass there is no centre
        out = [dataclasses.replace(quantity, shown=False) for quantity in out]
    return tuple(out)


def _centred(phi: FloatArray) -> FloatArray:
    """Mass, centre, and the six moments about the centre. Shape (10,)."""
    mass = float(phi[0])
    centre = phi[1:4] / mass
    shift = float(centre @ centre) * np.eye(3) - np.outer(centre, centre)
    moments = [shift[k] for k in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    return np.array([mass, *centre, *(phi[4:] - mass * np.array(moments))])


def _centred_jacobian(phi: FloatArray) -> FloatArray:
    """Derivative of `_centred` by central differences. Shape (10, 10)."""
    steps = 1e-6 * np.maximum(np.abs(phi), 1e-6)
    columns = []
    for k, step in enumerate(steps):
        change = np.zeros(LINK_PARAMETERS)
        change[k] = step
        columns.append((_centred(phi + change) - _centred(phi - change)) / (2.0 * step))
    return np.array(columns).T


def _mounting_p_value(equations: PayloadEquations, data: Estimate, phi: FloatArray) -> float | None:
    """p-value of the same payload in all recordings (Wald); None for one recording.

    Each recording gets parameters of its own; their differences from the first recording's are
    compared with their covariance in the directions that the data show.
    """
    from scipy import stats  # slow to import

    count = int(equations.recording.max()) + 1
    if count < 2:
        return None
    separate = [equations.payload_columns(k) for k in range(1, count)]
    rows = dataclasses.replace(equations.equations, regressor=np.concatenate(separate, axis=2))
    theta = data.nuisance_coefficients
    nuisance = np.concatenate(
        [
            equations.payload_columns(),
            equations.robot_columns(),
            equations.friction_columns(theta, phi),
        ],
        axis=2,
    )
    differences = estimate(rows, nuisance=nuisance)
    R = differences.information_root
    statistic = float(np.sum((R @ differences.theta) ** 2))
    return float(stats.chi2.sf(statistic, max(np.linalg.matrix_rank(R), 1)))


def require_mass(result: PayloadEstimate, names: Sequence[str]) -> None:
    """Check that the recordings hold a payload at all.

    Raises:
        UnusableInput: The mass is significantly below 0.
    """
    mass, std = float(result.data.theta[0]), result.data.mass_deviation
    if np.isfinite(std) and mass < -CLEAR_DIFFERENCE * std:
        raise UnusableInput(
            f"{', '.join(names)}: the payload has the mass {mass:.3g} ± {std:.2g} kg; exchange "
            "--with and --without"
        )
