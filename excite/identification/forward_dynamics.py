"""Forward dynamics of the identified robot, M(q) q̈ + h(q, q̇) + friction = τ, with derivatives.

∂q̈/∂θ = −M⁻¹Γ and ∂q̈/∂(q, q̇) = −M⁻¹ ∂τ/∂(q, q̇) at constant q̈: the derivatives of inverse
dynamics give those of forward dynamics (Carpentier & Mansard, "Analytical derivatives of rigid
body dynamics algorithms", RSS 2018). Friction and rotor inertia are included; mimic joints enter
through the robot's `spread` matrix.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..robot.dynamics import inverse_dynamics, regressor
from ..robot.inertial_parameters import model_with_inertias
from ..robot.samples import Samples
from .regression import IdentificationModel

MAX_FRICTION_STIFFNESS = 2.0
"""Largest step size times friction decay rate of a joint in explicit integration: below the
stability limit 2.78 of the classical Runge-Kutta method, to allow for the coupling with other
joints."""


@dataclass(frozen=True)
class RobotDynamics:
    """A robot with values of its parameters; methods take W states at once, shape (W, n).

    Attributes:
        model: The model of the identification.
        body: Pinocchio's model with the identified link inertias.
        data: Pinocchio's working memory.
        inertia: Rotor inertias. Shape (n,) [kg m²].
        viscous: Viscous friction. Shape (n,) [N m s/rad].
        coulomb: Coulomb friction. Shape (n,) [N m].
        offset: Torque offsets. Shape (n,) [N m].
        widths: Speed scales of Coulomb friction. Shape (n,) [rad/s].
    """

    model: IdentificationModel
    body: pin.Model
    data: Any
    inertia: FloatArray
    viscous: FloatArray
    coulomb: FloatArray
    offset: FloatArray
    widths: FloatArray

    def friction(self, v: FloatArray) -> FloatArray:
        """Compute friction and offset. Shapes (…, n) [rad/s] -> (…, n) [N m]."""
        return self.viscous * v + self.coulomb * np.tanh(v / self.widths) + self.offset

    def friction_slope(self, v: FloatArray) -> FloatArray:
        """Compute ∂friction/∂q̇. Shapes (…, n) [rad/s] -> (…, n) [N m s/rad]."""
        return np.asarray(
            self.viscous + self.coulomb / self.widths * (1.0 - np.tanh(v / self.widths) ** 2)
        )

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Compute M with the rotor inertias. Shapes (W, n) -> (W, n, n)."""
        spread = self.model.robot.spread
        full = np.array([pin.crba(self.body, self.data, x) for x in self.model.robot.expand(q)])
        return np.asarray(spread.T @ full @ spread + np.diag(self.inertia))

    def bias(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Compute h: gravity, Coriolis and centrifugal torque. Shapes (W, n) -> (W, n)."""
        spread = self.model.robot.spread
        rows = zip(self.model.robot.expand(q), v @ spread.T, strict=True)
        return np.asarray(
            np.array([pin.nonLinearEffects(self.body, self.data, x, dx) for x, dx in rows]) @ spread
        )

    def single_state_terms(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute M without the rotors, and h, at one state. Shapes (n,) -> (n, n), (n,)."""
        robot = self.model.robot
        x, dx = robot.expand(q), robot.spread @ v
        M, h = pin.crba(self.body, self.data, x), pin.nonLinearEffects(self.body, self.data, x, dx)
        return robot.spread.T @ M @ robot.spread, robot.spread.T @ h

    def acceleration(self, q: FloatArray, v: FloatArray, torque: FloatArray) -> FloatArray:
        """Compute q̈ of forward dynamics. Shapes (W, n) -> (W, n)."""
        force = torque - self.bias(q, v) - self.friction(v)
        return np.asarray(np.linalg.solve(self.mass_matrix(q), force[..., None])[..., 0])

    def acceleration_derivatives(
        self, q: FloatArray, v: FloatArray, torque: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Compute q̈ and its derivatives with respect to q, q̇ and θ, side by side.

        Shapes (W, n) -> (W, n), (W, n, 2n + p).
        """
        n, spread = self.model.robot.n, self.model.robot.spread
        M = self.mass_matrix(q)
        a = np.linalg.solve(M, (torque - self.bias(q, v) - self.friction(v))[..., None])[..., 0]
        slopes = np.empty((len(q), n, 2 * n + self.model.base.count))
        for w, state in enumerate(
            zip(self.model.robot.expand(q), v @ spread.T, a @ spread.T, strict=True)
        ):
            by_q, by_v, _ = pin.computeRNEADerivatives(self.body, self.data, *state)
            slopes[w, :, :n], slopes[w, :, n : 2 * n] = (
                spread.T @ by_q @ spread,
                spread.T @ by_v @ spread,
            )
        slopes[:, range(n), range(n, 2 * n)] += self.friction_slope(v)
        slopes[:, :, 2 * n :] = self.regressor(Samples(q, v, np.asarray(a, np.float64)))
        return np.asarray(a, np.float64), np.asarray(-np.linalg.solve(M, slopes), np.float64)

    def rigid_torque(self, motion: Samples) -> FloatArray:
        """Compute the torque of links and rotors along a motion, without friction. Shape (N, n)."""
        links = inverse_dynamics(self.model.robot, self.body, motion)
        return np.asarray(links + self.inertia * motion.ddq)

    def regressor(self, motion: Samples) -> FloatArray:
        """Compute Γ with the widths of this model. Shape (N, n, p)."""
        gamma = regressor(self.model.robot, self.model.parameters, motion)[
            :, :, self.model.base.independent
        ]
        for k, joint in self.model.friction_columns().items():
            gamma[:, joint, k] = np.tanh(motion.dq[:, joint] / self.widths[joint])
        return gamma


def build_dynamics(model: IdentificationModel, psi: FloatArray) -> RobotDynamics:
    """Build the dynamics of the robot with parameters ψ.

    Args:
        model: The model of the identification.
        psi: Physically consistent parameters, as the mass matrix is inverted. Shape (P,).
    """
    parameters, n = model.parameters, model.robot.n
    body = model_with_inertias(model.robot, parameters.of_bodies(psi))
    body.armature = np.zeros(body.nv)
    rotor_inertia, viscous, coulomb, offset = (
        psi[parameters.block(kind)] if kind in parameters.drive else np.zeros(n)
        for kind in ("rotor_inertia", "viscous", "coulomb", "offset")
    )
    return RobotDynamics(
        model, body, body.createData(), rotor_inertia, viscous, coulomb, offset, model.widths
    )


def stable_friction_widths(dynamics: RobotDynamics, q: FloatArray, step: float) -> FloatArray:
    """Widen Coulomb friction so that explicit integration is stable.

    step · F_c (M⁻¹)_jj / width ≤ MAX_FRICTION_STIFFNESS at all poses.

    Args:
        dynamics: The robot.
        q: Poses. Shape (W, n).
        step: Step of integration [s].

    Returns:
        Widths, not below those of the model. Shape (n,).
    """
    mobility = np.linalg.inv(dynamics.mass_matrix(q)).diagonal(axis1=1, axis2=2).max(axis=0)
    return np.maximum(dynamics.widths, step * dynamics.coulomb * mobility / MAX_FRICTION_STIFFNESS)


def with_widths(model: IdentificationModel, widths: FloatArray) -> IdentificationModel:
    """Return the model with other widths of Coulomb friction."""
    return dataclasses.replace(model, widths=widths)
