"""The base model fitted to recordings by weighted least squares, without and with the true effects.

τ = Yπ with bodies, rotor inertia, viscous and Coulomb friction and an offset per joint, from URDF
and CSV alone. Torque and regressor pass the same low-pass.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy import linalg, signal

from excite._types import FloatArray
from excite.simulator import mujoco_dynamics, urdf_tree
from excite.simulator.regressor import actuator_regressor, rigid_body_regressor

TORQUE_BAND = 20.0
"""Corner of the low-pass of torque and regressor [Hz], as of the diagnosis."""
MOTION_BAND = 60.0
"""Corner of the low-pass of position before it is differentiated [Hz]."""
RATE = 250.0
"""Rate of the resampled recording [Hz]."""
FIT_RATE = 50.0
"""Rate of the low-passed signals that are fitted [Hz]."""
FRICTION_WIDTHS = (3e-3, 4e-3, 5e-3, 6e-3)
"""Widths of the smooth sign of Coulomb friction that are tried [rad/s]."""
TorqueFunction = Callable[[FloatArray], FloatArray]
"""Function from times, shape (N,) [s], to torques, shape (N, n) [N m]."""


@dataclass(frozen=True)
class FilteredRecording:
    """A recording, low-passed and resampled at `RATE`.

    Attributes:
        joints: Names of the n joints.
        t: Time, shape (N,) [s].
        q: Position, shape (N, n) [rad].
        v: Velocity, shape (N, n) [rad/s].
        a: Acceleration, shape (N, n) [rad/s²].
        tau: Torque, shape (N, n) [N m].
    """

    joints: tuple[str, ...]
    t: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray
    tau: FloatArray


def read_table(path: Path) -> dict[str, FloatArray]:
    """Return the columns of a CSV with a header, by name, shapes (N,)."""
    with path.open(encoding="utf-8", newline="") as stream:
        header = next(csv.reader(stream))
        table = np.loadtxt(stream, delimiter=",")
    return dict(zip(header, table.T, strict=True))


def read_recording(path: Path) -> FilteredRecording:
    """Read t, q.* and tau.* of a CSV; low-pass and differentiate."""
    table = read_table(path)
    joints = tuple(name[2:] for name in table if name.startswith("q."))
    t = table["t"]
    q, tau = (
        np.column_stack([table[f"{kind}.{joint}"] for joint in joints]) for kind in ("q", "tau")
    )
    rate = 1.0 / float(np.median(np.diff(t)))
    every = max(1, round(rate / RATE))
    smooth = signal.sosfiltfilt(signal.butter(4, MOTION_BAND, fs=rate, output="sos"), q, axis=0)
    v = np.gradient(smooth, 1.0 / rate, axis=0)
    a = np.gradient(v, 1.0 / rate, axis=0)
    if every > 1:
        tau = signal.sosfiltfilt(
            signal.butter(4, 0.4 * rate / every, fs=rate, output="sos"), tau, axis=0
        )
    return FilteredRecording(
        joints, t[::every], smooth[::every], v[::every], a[::every], tau[::every]
    )


def low_passed(x: FloatArray, t: FloatArray) -> FloatArray:
    """Low-pass a signal at 20 Hz and resample it at 50 Hz.

    Half a second at either end is left out, where the filter has its transients.

    Args:
        x: Signal, time along the first axis.
        t: Its times [s].
    """
    rate = 1.0 / float(np.median(np.diff(t)))
    every = max(1, round(rate / FIT_RATE))
    edge = round(0.5 * rate)
    return np.asarray(signal.sosfiltfilt(_filter(round(rate, 6)), x, axis=0)[edge:-edge:every])


@lru_cache
def _filter(rate: float) -> FloatArray:
    """Return the low-pass for a rate [Hz]."""
    return np.asarray(signal.butter(4, TORQUE_BAND, fs=rate, output="sos"))


def fit(y: FloatArray, tau: FloatArray, rounds: int) -> FloatArray:
    """Fit by weighted least squares, with the residuals of the previous round as weights.

    The columns may be linearly dependent: QR with pivoting, on columns scaled to equal size.

    Args:
        y: Regressor, low-passed, shape (N, n, P).
        tau: Torque, low-passed, shape (N, n) [N m].
        rounds: Number of rounds.

    Returns:
        Coefficients, shape (P,).
    """
    noise = np.std(tau, axis=0) + 1e-12
    solution = np.zeros(y.shape[2])
    for _ in range(rounds):
        columns = (y / noise[:, None]).reshape(-1, y.shape[2])
        size = np.sqrt(np.square(columns).mean(axis=0))
        kept = np.flatnonzero(size > 1e-12 * size.max())
        q, triangle, order = linalg.qr(
            columns[:, kept] / size[kept], mode="economic", pivoting=True
        )
        rank = int((np.abs(np.diag(triangle)) > 1e-8 * abs(triangle[0, 0])).sum())
        part = q[:, :rank].T @ (tau / noise).ravel()
        chosen = kept[order[:rank]]
        solution = np.zeros(y.shape[2])
        solution[chosen] = linalg.solve_triangular(triangle[:rank, :rank], part) / size[chosen]
        noise = rms(tau - y @ solution) + 1e-12
    return solution


def rms(x: FloatArray) -> FloatArray:
    """Return the root mean square of each joint. Shape (N, n) to (n,)."""
    return np.sqrt(np.square(x).mean(axis=0))


def oracle_rmse(
    folder: Path, names: Sequence[str], hidden: Sequence[TorqueFunction]
) -> tuple[FloatArray, FloatArray]:
    """Return held-out RMSEs of the refit base model, without and with the hidden torque.

    Args:
        folder: Folder of the case.
        names: Names of the training recordings, then that of the validation recording.
        hidden: True torque of the effects in each.

    Returns:
        RMSE of the base model alone and of the oracle, in the joint order of the CSV, shapes (n,)
        [N m].
    """
    recordings = [read_recording(folder / f"{name}.csv") for name in names]
    joints = recordings[0].joints
    dynamics = mujoco_dynamics.build_dynamics(urdf_tree.read_urdf(folder / "robot.urdf"), joints)
    order = [joints.index(name) for name in dynamics.joints]
    tau = [low_passed(data.tau, data.t)[:, order] for data in recordings]
    known = [
        low_passed(torque(data.t), data.t)[:, order]
        for torque, data in zip(hidden, recordings, strict=True)
    ]
    bodies = [
        low_passed(
            rigid_body_regressor(dynamics, data.q[:, order], data.v[:, order], data.a[:, order]),
            data.t,
        )
        for data in recordings
    ]

    def regressor(k: int, width: FloatArray) -> FloatArray:
        data = recordings[k]
        actuators = actuator_regressor(data.v[:, order], data.a[:, order], width)
        return np.concatenate([bodies[k], low_passed(actuators, data.t)], axis=2)

    def training(width: FloatArray) -> FloatArray:
        return np.concatenate([regressor(k, width) for k in range(len(names) - 1)])

    out = []
    for parts in (tau, [total - part for total, part in zip(tau, known, strict=True)]):
        target = np.concatenate(parts[:-1])
        # all joints try the same width at once; each then keeps its best
        errors = []
        for value in FRICTION_WIDTHS:
            y = training(np.full(len(joints), value))
            errors.append(rms(target - y @ fit(y, target, 1)))
        width = np.array(FRICTION_WIDTHS)[np.argmin(np.array(errors), axis=0)]
        solution = fit(training(width), target, 2)
        out.append(rms(parts[-1] - regressor(len(names) - 1, width) @ solution))
    csv_order = np.argsort(order)
    return out[0][csv_order], out[1][csv_order]
