"""The identified robot as something that moves: M(q) q̈ + h(q, q̇) + friction = τ, with exact derivatives by Pinocchio.

∂q̈/∂θ = −M⁻¹Γ, ∂q̈/∂(q, q̇) = −M⁻¹ ∂τ/∂(q, q̇) at constant q̈ (Carpentier & Mansard, RSS 2018: the derivatives of inverse dynamics give
those of forward dynamics), friction and rotor inertia included, mimic joints through the robot's `spread`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..robot.dynamics import regressor
from ..robot.samples import Samples
from .regression import Model

Array = np.ndarray


@dataclass(frozen=True)
class Mechanism:
    """A robot with values of its parameters. W states at once: arrays of shape (W, n) [rad, rad/s, N m].

    model: of the identification; body: Pinocchio's, with the identified bodies; data: its work space.
    inertia, viscous, coulomb, offset: of the drives. widths: of Coulomb friction [rad/s]. Shapes (n,).
    """

    model: Model
    body: pin.Model
    data: Any
    inertia: Array
    viscous: Array
    coulomb: Array
    offset: Array
    widths: Array

    def friction(self, v: Array) -> Array:
        """Friction and offset at speeds. Shapes (…, n)."""
        return self.viscous * v + self.coulomb * np.tanh(v / self.widths) + self.offset

    def steepness(self, v: Array) -> Array:
        """∂friction/∂q̇. Shapes (…, n) [N m s/rad]."""
        return np.asarray(
            self.viscous + self.coulomb / self.widths * (1.0 - np.tanh(v / self.widths) ** 2)
        )

    def masses(self, q: Array) -> Array:
        """M with the rotors. Shapes (W, n) -> (W, n, n)."""
        spread = self.model.robot.spread
        full = np.array([pin.crba(self.body, self.data, x) for x in self.model.robot.expand(q)])
        return np.asarray(spread.T @ full @ spread + np.diag(self.inertia))

    def bias(self, q: Array, v: Array) -> Array:
        """h: gravity, Coriolis and centrifugal torque. Shapes (W, n)."""
        spread = self.model.robot.spread
        rows = zip(self.model.robot.expand(q), v @ spread.T, strict=True)
        return np.asarray(
            np.array([pin.nonLinearEffects(self.body, self.data, x, dx) for x, dx in rows]) @ spread
        )

    def terms(self, q: Array, v: Array) -> tuple[Array, Array]:
        """M without the rotors, and h, at one state. Shapes (n,) -> (n, n), (n,)."""
        robot = self.model.robot
        x, dx = robot.expand(q), robot.spread @ v
        M, h = pin.crba(self.body, self.data, x), pin.nonLinearEffects(self.body, self.data, x, dx)
        return robot.spread.T @ M @ robot.spread, robot.spread.T @ h

    def acceleration(self, q: Array, v: Array, torque: Array) -> Array:
        """q̈ of forward dynamics. Shapes (W, n)."""
        force = torque - self.bias(q, v) - self.friction(v)
        return np.asarray(np.linalg.solve(self.masses(q), force[..., None])[..., 0])

    def sensitive(self, q: Array, v: Array, torque: Array) -> tuple[Array, Array]:
        """q̈ and its derivatives with respect to q, q̇ and θ, side by side. Shapes (W, n), (W, n, 2n + p)."""
        n, spread = self.model.robot.n, self.model.robot.spread
        M = self.masses(q)
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
        slopes[:, range(n), range(n, 2 * n)] += self.steepness(v)
        slopes[:, :, 2 * n :] = self._regressor(Samples(q, v, a))
        return a, -np.linalg.solve(M, slopes)

    def rigid(self, motion: Samples) -> Array:
        """Torque of bodies and rotors along a motion, without friction. Shape (N, n)."""
        spread = self.model.robot.spread
        rows = zip(
            self.model.robot.expand(motion.q),
            motion.dq @ spread.T,
            motion.ddq @ spread.T,
            strict=True,
        )
        return np.asarray(
            np.array([pin.rnea(self.body, self.data, *row) for row in rows]) @ spread
            + self.inertia * motion.ddq
        )

    def _regressor(self, motion: Samples) -> Array:
        gamma = regressor(self.model.robot, self.model.parameters, motion)[
            :, :, self.model.base.independent
        ]
        for k, joint in self.model.friction_columns().items():
            gamma[:, joint, k] = np.tanh(motion.dq[:, joint] / self.widths[joint])
        return gamma


def of(model: Model, psi: Array) -> Mechanism:
    """The robot with parameters ψ, which should be physically consistent: a mass matrix is inverted. psi: Shape (P,)."""
    parameters, n = model.parameters, model.robot.n
    body = model.robot.model.copy()
    for i in range(parameters.bodies):
        body.inertias[i + 1] = pin.Inertia.FromDynamicParameters(psi[10 * i : 10 * i + 10])
    body.armature = np.zeros(body.nv)
    drive = {
        kind: psi[parameters.block(kind)] if kind in parameters.drive else np.zeros(n)
        for kind in ("viscous", "coulomb", "offset")
    }
    inertia = (
        psi[parameters.block("rotor_inertia")]
        if "rotor_inertia" in parameters.drive
        else np.zeros(n)
    )
    return Mechanism(
        model,
        body,
        body.createData(),
        inertia,
        drive["viscous"],
        drive["coulomb"],
        drive["offset"],
        model.widths,
    )


def softened(mechanism: Mechanism, q: Array, step: float, stiffest: float = 2.0) -> Array:
    """Widths of friction no narrower than an explicit step [s] carries: step · F_c (M⁻¹)_jj / width ≤ `stiffest` at poses q.

    stiffest: what the stability limit of classical Runge-Kutta, 2.78, leaves for other joints' part. Shapes (W, n) -> (n,).
    """
    mobility = np.linalg.inv(mechanism.masses(q)).diagonal(axis1=1, axis2=2).max(axis=0)
    return np.maximum(mechanism.widths, step * mechanism.coulomb * mobility / stiffest)


def widened(model: Model, widths: Array) -> Model:
    """The model with other widths."""
    return dataclasses.replace(model, widths=widths)
