"""A case as a baseline sees it: filtered recordings, base model and residuals."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from excite._types import FloatArray
from excite.simulator import urdf_tree
from excite.simulator.mujoco_dynamics import RigidBodyDynamics

from . import baseline_fit
from .baseline_fit import FilteredRecording


@dataclass(frozen=True)
class RecordedScene:
    """A recording with the quantities that candidate effects need.

    Attributes:
        dynamics: Rigid-body dynamics of the URDF.
        limit: Torque limits, shape (n,) [N m].
        data: The recording, in the joint order of `dynamics`, at `baseline_fit.RATE`.
        mass: Diagonal of the mass matrix along the motion, shape (N, n) [kg m²].
        load: Torque predicted by the base model, shape (N, n) [N m].
        width: Width of the smooth sign of Coulomb friction, shape (n,) [rad/s].
    """

    dynamics: RigidBodyDynamics
    limit: FloatArray
    data: FilteredRecording
    mass: FloatArray
    load: FloatArray
    width: FloatArray

    def low_passed(self, x: FloatArray) -> FloatArray:
        """Low-pass a signal at 20 Hz and resample it at 50 Hz."""
        return baseline_fit.low_passed(x, self.data.t)


@dataclass(frozen=True)
class BaselineProblem:
    """The residuals that the baselines have to explain.

    Attributes:
        train: Training recording.
        validate: Validation recording.
        trusted: Whether a prior is trusted, so that nothing is refit.
        noise: Standard deviation of the torque in the band, shape (n,) [N m].
        basis: Orthonormal basis of the base regressor over noise, shape (N, n, r); r = 0 where a
            prior is trusted.
        residuals: Residual torque of both recordings, shapes (N, n) [N m].
        columns: Base regressors of both recordings, shapes (N, n, P).
    """

    train: RecordedScene
    validate: RecordedScene
    trusted: bool
    noise: FloatArray
    basis: FloatArray
    residuals: tuple[FloatArray, FloatArray]
    columns: tuple[FloatArray, FloatArray]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.train.dynamics.joints


def read_scene(dynamics: RigidBodyDynamics, limit: FloatArray, path: Path) -> RecordedScene:
    """Read a recording."""
    data = baseline_fit.with_joint_order(baseline_fit.read_recording(path), dynamics.joints)
    every = 5
    coarse = np.array(
        [
            np.diag(dynamics.mass_and_bias(q, v)[0])
            for q, v in zip(data.q[::every], data.v[::every], strict=True)
        ]
    )
    mass = np.column_stack([np.interp(data.t, data.t[::every], column) for column in coarse.T])
    return RecordedScene(
        dynamics, limit, data, mass, data.tau, np.full(dynamics.n, baseline_fit.FRICTION_WIDTHS[1])
    )


def load_case(folder: Path) -> BaselineProblem:
    """Read a case: robot.urdf, train.csv, validate.csv, and prior.json where there is one."""
    tree = urdf_tree.read_urdf(folder / "robot.urdf")
    dynamics = baseline_fit.dynamics_of_urdf(folder / "robot.urdf", tree.joints)
    limit = np.array([tree.velocity_and_torque_limit(name)[1] for name in dynamics.joints])
    first, second = (
        read_scene(dynamics, limit, folder / f"{name}.csv") for name in ("train", "validate")
    )
    prior = folder / "prior.json"
    if prior.exists():
        return _trusted_problem(
            first, second, json.loads(prior.read_text(encoding="utf-8"))["joints"]
        )
    width = baseline_fit.best_friction_width(dynamics, first.data, first.low_passed(first.data.tau))
    first, second = replace(first, width=width), replace(second, width=width)
    regressors = [
        baseline_fit.base_regressor(dynamics, scene.data, width) for scene in (first, second)
    ]
    y_train, y_validation = (
        scene.low_passed(regressor)
        for scene, regressor in zip((first, second), regressors, strict=True)
    )
    tau_train, tau_validation = (scene.low_passed(scene.data.tau) for scene in (first, second))
    base = baseline_fit.fit_base(y_train, tau_train)
    first, second = (
        replace(scene, load=base.predict(regressor))
        for scene, regressor in zip((first, second), regressors, strict=True)
    )
    residuals = (tau_train - base.predict(y_train), tau_validation - base.predict(y_validation))
    return BaselineProblem(
        first,
        second,
        False,
        base.noise,
        base.basis.reshape(*tau_train.shape, -1),
        residuals,
        (y_train, y_validation),
    )


def _trusted_problem(
    first: RecordedScene, second: RecordedScene, prior: dict[str, Any]
) -> BaselineProblem:
    """Return the problem of a case whose prior is trusted."""
    dynamics, parameters = first.dynamics, [prior[name] for name in first.dynamics.joints]
    inertia, viscous, coulomb, offset = (
        np.array([k[key] for k in parameters])
        for key in ("rotor_inertia", "viscous", "coulomb", "offset")
    )

    def model(scene: RecordedScene, width: FloatArray) -> FloatArray:
        data = scene.data
        return (
            dynamics.inverse_dynamics(data.q, data.v, data.a)
            + inertia * data.a
            + viscous * data.v
            + coulomb * np.tanh(data.v / width)
            + offset
        )

    errors = [
        baseline_fit.rmse(
            first.low_passed(first.data.tau - model(first, np.full(dynamics.n, width)))
        )
        for width in baseline_fit.FRICTION_WIDTHS
    ]
    width = np.array(baseline_fit.FRICTION_WIDTHS)[np.argmin(np.array(errors), axis=0)]
    scenes = [replace(scene, load=model(scene, width), width=width) for scene in (first, second)]
    residuals = [scene.low_passed(scene.data.tau - scene.load) for scene in scenes]
    noise = 1.4826 * np.median(np.abs(np.diff(residuals[0], axis=0)), axis=0) / np.sqrt(2.0)
    empty = [np.zeros((*x.shape, 0)) for x in residuals]
    return BaselineProblem(
        scenes[0],
        scenes[1],
        True,
        noise,
        empty[0],
        (residuals[0], residuals[1]),
        (empty[0], empty[1]),
    )
