"""The base model fitted to a recording by weighted least squares, for the baselines and the oracle.

τ = Yπ with bodies, rotor inertia, viscous and Coulomb friction and an offset per joint, from URDF
and CSV alone. Torque and regressor pass the same low-pass.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy import linalg, signal

from excite._types import FloatArray
from excite.simulator import mujoco_dynamics, urdf_tree
from excite.simulator.mujoco_dynamics import RigidBodyDynamics
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


def read_recording(path: Path) -> FilteredRecording:
    """Read t, q.* and tau.* of a CSV; low-pass and differentiate."""
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
    unaliased = (
        signal.sosfiltfilt(signal.butter(4, 0.4 * rate / every, fs=rate, output="sos"), tau, axis=0)
        if every > 1
        else tau
    )
    return FilteredRecording(
        joints, t[::every], smooth[::every], v[::every], a[::every], unaliased[::every]
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


def dynamics_of_urdf(urdf: Path, joints: tuple[str, ...]) -> RigidBodyDynamics:
    """Build the dynamics of a URDF whose other joints are locked at 0."""
    return mujoco_dynamics.build_dynamics(urdf_tree.read_urdf(urdf), joints)


def base_regressor(
    dynamics: RigidBodyDynamics, recording: FilteredRecording, width: FloatArray
) -> FloatArray:
    """Return the regressor of the base model at `RATE`.

    Args:
        dynamics: The robot.
        recording: Recording with the joints in the order of `dynamics`.
        width: Width of the smooth sign of Coulomb friction, shape (n,) [rad/s].

    Returns:
        Shape (N, n, P).
    """
    return np.concatenate(
        [
            rigid_body_regressor(dynamics, recording.q, recording.v, recording.a),
            actuator_regressor(recording.v, recording.a, width),
        ],
        axis=2,
    )


def with_joint_order(recording: FilteredRecording, joints: tuple[str, ...]) -> FilteredRecording:
    """Return the recording with its joints in another order."""
    order = [recording.joints.index(name) for name in joints]
    return FilteredRecording(
        joints,
        recording.t,
        *(x[:, order] for x in (recording.q, recording.v, recording.a, recording.tau)),
    )


def best_friction_width(
    dynamics: RigidBodyDynamics, recording: FilteredRecording, tau: FloatArray
) -> FloatArray:
    """Return for each joint the friction width with the least residual.

    All joints try the same width at once.

    Args:
        dynamics: The robot.
        recording: The training recording.
        tau: Its torque, low-passed, shape (M, n) [N m].

    Returns:
        Shape (n,) [rad/s].
    """
    widths = [np.full(dynamics.n, width) for width in FRICTION_WIDTHS]
    inertial = low_passed(
        rigid_body_regressor(dynamics, recording.q, recording.v, recording.a), recording.t
    )
    residuals = [
        rmse(
            fit_base(
                np.concatenate(
                    [
                        inertial,
                        low_passed(
                            actuator_regressor(recording.v, recording.a, width), recording.t
                        ),
                    ],
                    axis=2,
                ),
                tau,
                1,
            ).residual()
        )
        for width in widths
    ]
    return np.array(FRICTION_WIDTHS)[np.argmin(np.array(residuals), axis=0)]


@dataclass(frozen=True)
class BaseFit:
    """A fit of the base model.

    Attributes:
        solution: Coefficients of all columns, shape (P,).
        noise: Standard deviation of the residual per joint, shape (n,) [N m].
        basis: Orthonormal basis of the whitened columns, shape (N·n, r).
        whitened_residual: Residual of the training data over the noise, shape (N, n).
    """

    solution: FloatArray
    noise: FloatArray
    basis: FloatArray
    whitened_residual: FloatArray

    def predict(self, y: FloatArray) -> FloatArray:
        """Return the torque of a regressor. Shape (N, n, P) to (N, n) [N m]."""
        return np.asarray(y @ self.solution)

    def residual(self) -> FloatArray:
        """Return the residual of the training data, shape (N, n) [N m]."""
        return self.whitened_residual * self.noise


def fit_base(y: FloatArray, tau: FloatArray, rounds: int = 2) -> BaseFit:
    """Fit by weighted least squares, with the residuals of the previous round as weights.

    Args:
        y: Regressor, low-passed, shape (N, n, P).
        tau: Torque, low-passed, shape (N, n) [N m].
        rounds: Number of rounds.
    """
    noise = np.std(tau, axis=0) + 1e-12
    for _ in range(rounds):
        target = (tau / noise).ravel()
        basis, solve = column_space((y / noise[:, None]).reshape(-1, y.shape[2]))
        part = basis.T @ target
        residual = (target - basis @ part).reshape(tau.shape)
        used, noise = noise, noise * np.std(residual, axis=0)
    return BaseFit(solve @ part, used, basis, residual)


def column_space(y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an orthonormal basis Q of the column space, and S with y S = Q.

    The columns may be linearly dependent; QR with pivoting, on columns scaled to equal size.

    Args:
        y: Shape (N, P).

    Returns:
        Q, shape (N, r), and S, shape (P, r).
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


def rmse(x: FloatArray) -> FloatArray:
    """Return the root mean square of each joint. Shape (N, n) to (n,)."""
    return np.sqrt(np.square(x).mean(axis=0))


TorqueFunction = Callable[[FloatArray], FloatArray]
"""Function from times, shape (N,) [s], to torques, shape (N, n) [N m]."""


def oracle_rmse(
    folder: Path, hidden: tuple[TorqueFunction, TorqueFunction]
) -> tuple[FloatArray, FloatArray]:
    """Return held-out RMSEs of the refit base model, without and with the hidden torque.

    Args:
        folder: Folder of the case.
        hidden: True torque of the effects in the training and the validation recording.

    Returns:
        RMSE of the base model alone and of the oracle, in the joint order of the CSV, shapes (n,)
        [N m].
    """
    first, second = (read_recording(folder / f"{name}.csv") for name in ("train", "validate"))
    dynamics, csv_joints = dynamics_of_urdf(folder / "robot.urdf", first.joints), first.joints
    known_training, known_validation = (
        low_passed(torque(data.t), data.t)
        for torque, data in zip(hidden, (first, second), strict=True)
    )
    order = [csv_joints.index(name) for name in dynamics.joints]
    known_training, known_validation = known_training[:, order], known_validation[:, order]
    first, second = (
        with_joint_order(first, dynamics.joints),
        with_joint_order(second, dynamics.joints),
    )
    tau, tau_validation = (low_passed(data.tau, data.t) for data in (first, second))
    out = []
    for train, held_out in (
        (tau, tau_validation),
        (tau - known_training, tau_validation - known_validation),
    ):
        width = best_friction_width(dynamics, first, train)
        y, z = (
            low_passed(base_regressor(dynamics, data, width), data.t) for data in (first, second)
        )
        out.append(rmse(held_out - fit_base(y, train).predict(z)))
    csv_order = np.argsort(order)
    return out[0][csv_order], out[1][csv_order]
