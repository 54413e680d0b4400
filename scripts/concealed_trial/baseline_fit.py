"""The base model fitted to a recording by weighted least squares, in one band on both sides; for baselines and the oracle.

τ = Yπ with rotor inertia, viscous and Coulomb friction and an offset per joint, from the URDF and the CSV alone.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy import linalg, signal

from excite.simulator import mujoco_dynamics as arms
from excite.simulator import urdf_tree as trees
from excite.simulator.mujoco_dynamics import Arm
from excite.simulator.regressor import bodies, drives

Array = np.ndarray
BAND, MOTION_BAND, RATE, OUT = 20.0, 60.0, 250.0, 50.0
WIDTHS = (3e-3, 4e-3, 5e-3, 6e-3)
"""Of the smooth sign of Coulomb friction, what is tried [rad/s]."""


@dataclass(frozen=True)
class Data:
    """A recording in one band, at RATE. q, v, a, tau: Shapes (N, n)."""

    joints: tuple[str, ...]
    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array


def read(path: Path) -> Data:
    """Read t, q.*, tau.* of a CSV, low-pass and differentiate."""
    with path.open(encoding="utf-8", newline="") as stream:
        header = next(csv.reader(stream))
        table = np.loadtxt(stream, delimiter=",")
    joints = tuple(name[2:] for name in header if name.startswith("q."))
    t = table[:, header.index("t")]
    q, tau = (
        table[:, [header.index(f"{kind}.{joint}") for joint in joints]] for kind in ("q", "tau")
    )
    rate = 1.0 / float(np.median(np.diff(t)))
    every = max(1, round(rate / RATE))
    smooth = signal.sosfiltfilt(signal.butter(4, MOTION_BAND, fs=rate, output="sos"), q, axis=0)
    v = np.gradient(smooth, 1.0 / rate, axis=0)
    a = np.gradient(v, 1.0 / rate, axis=0)
    aliasless = (
        signal.sosfiltfilt(signal.butter(4, 0.4 * rate / every, fs=rate, output="sos"), tau, axis=0)
        if every > 1
        else tau
    )
    return Data(joints, t[::every], smooth[::every], v[::every], a[::every], aliasless[::every])


def low(x: Array, t: Array) -> Array:
    """Below 20 Hz, at 50 Hz, the ends (where the filters begin) left out."""
    rate = 1.0 / float(np.median(np.diff(t)))
    every = max(1, round(rate / OUT))
    edge = round(0.5 * rate)
    return np.asarray(signal.sosfiltfilt(_filter(round(rate, 6)), x, axis=0)[edge:-edge:every])


@lru_cache
def _filter(rate: float) -> Array:
    return np.asarray(signal.butter(4, BAND, fs=rate, output="sos"))


def arm_of(urdf: Path, joints: tuple[str, ...]) -> Arm:
    """The rigid bodies of a URDF whose other joints are locked at 0."""
    return arms.build(trees.read(urdf), joints)


def columns(arm: Arm, data: Data, width: Array) -> Array:
    """The base model's columns at RATE, joints in the arm's order. width: Shape (n,). Shape (N, n, P)."""
    return np.concatenate(
        [bodies(arm, data.q, data.v, data.a), drives(data.v, data.a, width)], axis=2
    )


def ordered(data: Data, joints: tuple[str, ...]) -> Data:
    """The same recording with its joints in another order."""
    order = [data.joints.index(name) for name in joints]
    return Data(joints, data.t, *(x[:, order] for x in (data.q, data.v, data.a, data.tau)))


def best_width(arm: Arm, data: Data, tau: Array) -> Array:
    """For each joint the width that leaves least; every joint tries them at once. tau: in the band. Shape (n,) [rad/s]."""
    same = [np.full(arm.n, width) for width in WIDTHS]
    inertial = low(bodies(arm, data.q, data.v, data.a), data.t)
    left = [
        rmse(
            fit(
                np.concatenate([inertial, low(drives(data.v, data.a, width), data.t)], axis=2),
                tau,
                1,
            ).left()
        )
        for width in same
    ]
    return np.array(WIDTHS)[np.argmin(np.array(left), axis=0)]


@dataclass(frozen=True)
class Base:
    """A fit. solution: of all columns, Shape (P,). noise: standard deviation per joint, (n,). basis: orthonormal, of the whitened columns.

    rest: whitened residual of the training data. Shape (N, n).
    """

    solution: Array
    noise: Array
    basis: Array
    rest: Array

    def predict(self, y: Array) -> Array:
        """Torque of columns. Shape (N, n, P) -> (N, n) [N m]."""
        return np.asarray(y @ self.solution)

    def left(self) -> Array:
        """Residual of the training data. Shape (N, n) [N m]."""
        return self.rest * self.noise


def fit(y: Array, tau: Array, rounds: int = 2) -> Base:
    """Weighted least squares, weights from the fit before. y: Shape (N, n, P), tau: (N, n), both in the band."""
    noise = np.std(tau, axis=0) + 1e-12
    for _ in range(rounds):
        target = (tau / noise).ravel()
        basis, solve = span((y / noise[:, None]).reshape(-1, y.shape[2]))
        part = basis.T @ target
        rest = (target - basis @ part).reshape(tau.shape)
        used, noise = noise, noise * np.std(rest, axis=0)
    return Base(solve @ part, used, basis, rest)


def span(y: Array) -> tuple[Array, Array]:
    """Orthonormal basis of the columns' span, whatever their rank, and what turns its coefficients into theirs: y (S c) = Q c.

    Shapes (N, P) -> (N, r), (P, r). By QR with pivoting, columns scaled to equal size.
    """
    size = np.sqrt(np.square(y).mean(axis=0))
    kept = np.flatnonzero(size > 1e-12 * size.max())
    q, triangle, order = linalg.qr(y[:, kept] / size[kept], mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(triangle)) > 1e-8 * abs(triangle[0, 0])).sum())
    solve = np.zeros((y.shape[1], rank))
    chosen = kept[order[:rank]]
    solve[chosen] = (
        linalg.solve_triangular(triangle[:rank, :rank], np.eye(rank)) / size[chosen, None]
    )
    return q[:, :rank], solve


def rmse(x: Array) -> Array:
    """Root mean square of each joint. Shape (N, n) -> (n,)."""
    return np.sqrt(np.square(x).mean(axis=0))


Hidden = Callable[[Array], Array]


def oracle(folder: Path, hidden: tuple[Hidden, Hidden]) -> tuple[Array, Array]:
    """Held-out RMSE per joint of the refit base model alone, and with the hidden torque known. Shapes (n,) [N m].

    folder: of the case. hidden: the true torque of the effects at times t, in each recording. Shape (N,) -> (N, n).
    """
    first, second = (read(folder / f"{name}.csv") for name in ("train", "validate"))
    arm, told_order = arm_of(folder / "robot.urdf", first.joints), first.joints
    known, told = (
        low(more(data.t), data.t) for more, data in zip(hidden, (first, second), strict=True)
    )
    order = [told_order.index(name) for name in arm.joints]
    known, told = known[:, order], told[:, order]
    first, second = ordered(first, arm.joints), ordered(second, arm.joints)
    tau, other = (low(data.tau, data.t) for data in (first, second))
    out = []
    for train, held in ((tau, other), (tau - known, other - told)):
        width = best_width(arm, first, train)
        y, z = (low(columns(arm, data, width), data.t) for data in (first, second))
        out.append(rmse(held - fit(y, train).predict(z)))
    back = np.argsort(order)
    return out[0][back], out[1][back]
