"""A case as a baseline sees it: both recordings in one band, the base model fitted or trusted, what is left."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from excite.simulator import urdf_tree as trees
from excite.simulator.mujoco_dynamics import Arm

from . import baseline_fit
from .baseline_fit import Data

Array = np.ndarray


@dataclass(frozen=True)
class Scene:
    """One recording. data: in the arm's order of joints, at fit.RATE. mass: diagonal of the mass matrix along it, Shape (N, n).

    load: torque that the base model predicts, without the noise of what was measured. Shape (N, n) [N m].
    width: of the smooth sign of each joint's Coulomb friction. Shape (n,) [rad/s].
    """

    arm: Arm
    limit: Array
    data: Data
    mass: Array
    load: Array
    width: Array

    def low(self, x: Array) -> Array:
        """Below 20 Hz, at 50 Hz."""
        return baseline_fit.low(x, self.data.t)


@dataclass(frozen=True)
class Problem:
    """noise: torque's standard deviation per joint in the band, (n,). rest: torque left on the training and validation recordings.

    basis: orthonormal columns that a candidate must get past, Shape (N, n, r), over noise; r = 0 where a prior is trusted.
    """

    train: Scene
    validate: Scene
    trusted: bool
    noise: Array
    basis: Array
    rest: tuple[Array, Array]
    columns: tuple[Array, Array]

    @property
    def joints(self) -> tuple[str, ...]:
        return self.train.arm.joints


def scene(arm: Arm, limit: Array, path: Path) -> Scene:
    """Read a recording."""
    data = baseline_fit.ordered(baseline_fit.read(path), arm.joints)
    every = 5
    coarse = np.array(
        [np.diag(arm.terms(q, v)[0]) for q, v in zip(data.q[::every], data.v[::every], strict=True)]
    )
    mass = np.column_stack([np.interp(data.t, data.t[::every], column) for column in coarse.T])
    return Scene(arm, limit, data, mass, data.tau, np.full(arm.n, baseline_fit.WIDTHS[1]))


def load(folder: Path) -> Problem:
    """A case's folder: robot.urdf, train.csv, validate.csv, and prior.json where there is one."""
    tree = trees.read(folder / "robot.urdf")
    arm = baseline_fit.arm_of(folder / "robot.urdf", tree.joints)
    limit = np.array([tree.limits(name)[1] for name in arm.joints])
    first, second = (scene(arm, limit, folder / f"{name}.csv") for name in ("train", "validate"))
    prior = folder / "prior.json"
    if prior.exists():
        return _trusted(first, second, json.loads(prior.read_text(encoding="utf-8"))["joints"])
    width = baseline_fit.best_width(arm, first.data, first.low(first.data.tau))
    first, second = replace(first, width=width), replace(second, width=width)
    wide = [baseline_fit.columns(arm, one.data, width) for one in (first, second)]
    y, held = (one.low(all_) for one, all_ in zip((first, second), wide, strict=True))
    tau, other = (one.low(one.data.tau) for one in (first, second))
    base = baseline_fit.fit(y, tau)
    first, second = (
        replace(one, load=base.predict(all_))
        for one, all_ in zip((first, second), wide, strict=True)
    )
    rest = (tau - base.predict(y), other - base.predict(held))
    return Problem(
        first, second, False, base.noise, base.basis.reshape(*tau.shape, -1), rest, (y, held)
    )


def _trusted(first: Scene, second: Scene, prior: dict[str, Any]) -> Problem:
    arm, known = first.arm, [prior[name] for name in first.arm.joints]
    inertia, viscous, coulomb, offset = (
        np.array([k[key] for k in known])
        for key in ("rotor_inertia", "viscous", "coulomb", "offset")
    )

    def model(one: Scene, width: Array) -> Array:
        d = one.data
        return (
            arm.inverse(d.q, d.v, d.a)
            + inertia * d.a
            + viscous * d.v
            + coulomb * np.tanh(d.v / width)
            + offset
        )

    tried = [
        baseline_fit.rmse(first.low(first.data.tau - model(first, np.full(arm.n, width))))
        for width in baseline_fit.WIDTHS
    ]
    width = np.array(baseline_fit.WIDTHS)[np.argmin(np.array(tried), axis=0)]
    scenes = [replace(one, load=model(one, width), width=width) for one in (first, second)]
    rest = [one.low(one.data.tau - one.load) for one in scenes]
    noise = 1.4826 * np.median(np.abs(np.diff(rest[0], axis=0)), axis=0) / np.sqrt(2.0)
    empty = [np.zeros((*x.shape, 0)) for x in rest]
    return Problem(
        scenes[0], scenes[1], True, noise, empty[0], (rest[0], rest[1]), (empty[0], empty[1])
    )
