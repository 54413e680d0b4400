"""Candidate effects of the greedy search: textbook models of the effects of the catalogue."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from excite._types import FloatArray
from excite.simulator import mujoco_dynamics
from excite.simulator.regressor import rigid_body_regressor

from .baseline_data import BaselineProblem, RecordedScene
from .baseline_fit import FIT_RATE


@dataclass(frozen=True)
class Candidate:
    """A candidate effect.

    Attributes:
        name: Name of the effect.
        joint: Joint in the answer.
        j: Index of the joint that the columns act on; None: all.
        make: Function from a scene to columns, shape (N, m) at joint j or (N, n, m).
        stated: Parameters that are coefficients: name, unit, index of the coefficient, and the
            function from the coefficient to the value.
        fixed: Parameters of the candidate itself: name, unit and value.
        time: Begin and end of the effect [s].
    """

    name: str
    joint: str | None
    j: int | None
    make: Callable[[RecordedScene], FloatArray]
    stated: tuple[tuple[str, str, int, Callable[[float], float]], ...] = ()
    fixed: tuple[tuple[str, str, float], ...] = ()
    time: tuple[float, float] | None = None


def identity(x: float) -> float:
    """Return the argument."""
    return x


def candidates(problem: BaselineProblem) -> Iterator[Candidate]:
    """Yield all candidates, joint by joint, then those of the whole robot."""
    for j, joint in enumerate(problem.joints):
        yield from _friction_candidates(j, joint)
        yield from _actuator_candidates(j, joint, problem)
        if problem.trusted:
            yield from _absorbed_candidates(j, joint)
    yield from _contact_candidates(problem)
    if problem.trusted:
        yield from _whole_robot_candidates(problem)


def friction_sign(scene: RecordedScene, j: int) -> FloatArray:
    """Return the smooth sign of a joint's velocity, shape (N,)."""
    return np.tanh(scene.data.v[:, j] / scene.width[j])


def _friction_candidates(j: int, joint: str) -> Iterator[Candidate]:
    """Yield the friction models of a joint."""

    def v(s: RecordedScene) -> FloatArray:
        return s.data.v[:, j]

    for speed in (0.03, 0.1, 0.3):
        yield Candidate(
            "stribeck",
            joint,
            j,
            partial(_stribeck_column, j=j, speed=speed),
            (("amplitude", "N m", 0, identity),),
            (("velocity", "rad/s", speed),),
        )
    yield Candidate("asymmetric_viscous", joint, j, lambda s: np.abs(v(s))[:, None])
    yield Candidate(
        "drag",
        joint,
        j,
        lambda s: (v(s) * np.abs(v(s)))[:, None],
        (("coefficient", "N m s²/rad²", 0, identity),),
    )
    yield Candidate(
        "nonlinear_viscous", joint, j, lambda s: (v(s) ** 3)[:, None], (), (("exponent", "1", 3.0),)
    )
    yield Candidate(
        "nonlinear_viscous",
        joint,
        j,
        lambda s: (friction_sign(s, j) * np.sqrt(np.abs(v(s))))[:, None],
        (),
        (("exponent", "1", 0.5),),
    )
    yield Candidate(
        "load_friction",
        joint,
        j,
        lambda s: (friction_sign(s, j) * np.abs(_load_torque(s, j)))[:, None],
        (("mu", "1", 0, identity),),
    )
    yield Candidate(
        "position_friction",
        joint,
        j,
        lambda s: (
            friction_sign(s, j)[:, None]
            * np.column_stack([f(k * s.data.q[:, j]) for k in (1, 2) for f in (np.cos, np.sin)])
        ),
    )
    yield Candidate(
        "thermal_drift",
        joint,
        j,
        lambda s: np.exp(-s.data.t / 10.0)[:, None] * np.column_stack([v(s), friction_sign(s, j)]),
    )
    for distance in (1e-3, 5e-3):
        yield Candidate(
            "hysteresis",
            joint,
            j,
            partial(_dahl_column, j=j, distance=distance),
            (("amplitude", "N m", 0, identity),),
        )


def _load_torque(s: RecordedScene, j: int) -> FloatArray:
    """Return the torque that the base model predicts in a joint, shape (N,) [N m]."""
    return np.asarray(s.load[:, j])


def _stribeck_column(s: RecordedScene, j: int, speed: float) -> FloatArray:
    """Return the column of Stribeck friction, shape (N, 1)."""
    return np.asarray(friction_sign(s, j) * np.exp(-np.square(s.data.v[:, j] / speed)))[:, None]


def _coupling_columns(s: RecordedScene, i: int) -> FloatArray:
    """Return velocity and its sign of the coupled joint, shape (N, 2)."""
    return np.column_stack([s.data.v[:, i], friction_sign(s, i)])


def _encoder_error_torque(s: RecordedScene, j: int, k: int) -> FloatArray:
    """Return the inertial torque of a position error of order k, shape (N, 2)."""
    return np.asarray(
        s.mass[:, j, None]
        * np.column_stack(
            [_derivative(s, _derivative(s, f(k * s.data.q[:, j]))) for f in (np.cos, np.sin)]
        )
    )


def _dahl_column(s: RecordedScene, j: int, distance: float) -> FloatArray:
    """Return Dahl's friction state minus the sign of velocity, shape (N, 1)."""
    q, z, out = s.data.q[:, j], 0.0, np.zeros(len(s.data.t))
    decay, direction = np.exp(-np.abs(np.diff(q)) / distance), np.sign(np.diff(q))
    for k in range(len(decay)):
        z = direction[k] + (z - direction[k]) * decay[k]
        out[k + 1] = z
    return np.asarray(out - friction_sign(s, j))[:, None]


def _derivative(s: RecordedScene, x: FloatArray) -> FloatArray:
    """Return the time derivative of a signal by central differences."""
    return np.gradient(x, s.data.t)


def _actuator_candidates(j: int, joint: str, problem: BaselineProblem) -> Iterator[Candidate]:
    """Yield effects of transmission, motor and sensors of a joint."""
    yield Candidate(
        "delay",
        joint,
        j,
        lambda s: _derivative(s, _smooth_load(s, j))[:, None],
        (("seconds", "s", 0, lambda c: -c),),
    )
    yield Candidate(
        "elasticity",
        joint,
        j,
        lambda s: (s.mass[:, j] * _derivative(s, _derivative(s, _smooth_load(s, j))))[:, None],
        (("stiffness", "N m/rad", 0, lambda c: -1.0 / c if c else 0.0),),
    )
    yield Candidate(
        "backlash",
        joint,
        j,
        lambda s: (
            s.mass[:, j]
            * _derivative(s, _derivative(s, np.tanh(_smooth_load(s, j) / (0.02 * s.limit[j]))))
        )[:, None],
        (("width", "rad", 0, lambda c: abs(2.0 * c)),),
    )
    yield Candidate(
        "torque_saturation",
        joint,
        j,
        lambda s: (_load_torque(s, j) * np.abs(_load_torque(s, j)) / s.limit[j])[:, None],
    )
    yield Candidate(
        "spring",
        joint,
        j,
        lambda s: np.column_stack([s.data.q[:, j], np.sin(s.data.q[:, j]), np.cos(s.data.q[:, j])]),
    )
    for i, _ in enumerate(problem.joints):
        if abs(i - j) == 1:
            yield Candidate(
                "coupling",
                joint,
                j,
                partial(_coupling_columns, i=i),
                (("viscous", "N m s/rad", 0, identity),),
            )
    order = _dominant_order(problem, j)
    yield Candidate(
        "torque_ripple",
        joint,
        j,
        lambda s: np.column_stack([np.cos(order * s.data.q[:, j]), np.sin(order * s.data.q[:, j])]),
        (),
        (("order", "1/turn", order),),
    )
    for k in (1, 2, 3, 4):
        yield Candidate(
            "encoder_error",
            joint,
            j,
            partial(_encoder_error_torque, j=j, k=k),
            (),
            (("order", "1/turn", float(k)),),
        )


def _smooth_load(s: RecordedScene, j: int) -> FloatArray:
    """Return the predicted torque below 30 Hz, which can be differentiated twice, shape (N,)."""
    from scipy import signal

    rate = 1.0 / float(np.median(np.diff(s.data.t)))
    return np.asarray(
        signal.sosfiltfilt(signal.butter(4, 30.0, fs=rate, output="sos"), s.load[:, j])
    )


def _dominant_order(problem: BaselineProblem, j: int) -> float:
    """Return the order with the largest line in the residual's spectrum over position [1/turn]."""
    s, residual = problem.train, problem.residuals[0][:, j]
    dt = float(np.median(np.diff(s.data.t)))
    edge, every = round(0.5 / dt), max(1, round(1.0 / (dt * FIT_RATE)))
    q = s.data.q[edge:-edge:every, j]
    orders = np.arange(5.0, 80.0, 0.25)
    power = np.abs(np.exp(-1j * np.multiply.outer(orders, q)) @ residual)
    return float(orders[int(np.argmax(power))])


def _absorbed_candidates(j: int, joint: str) -> Iterator[Candidate]:
    """Yield the effects that a refit of the base model absorbs."""
    yield Candidate(
        "rotor_inertia",
        joint,
        j,
        lambda s: s.data.a[:, j][:, None],
        (("inertia", "kg m²", 0, identity),),
    )
    yield Candidate(
        "torque_offset",
        joint,
        j,
        lambda s: np.ones((len(s.data.t), 1)),
        (("offset", "N m", 0, identity),),
    )
    yield Candidate(
        "friction",
        joint,
        j,
        lambda s: np.column_stack([friction_sign(s, j), s.data.v[:, j]]),
        (("coulomb", "N m", 0, identity), ("viscous", "N m s/rad", 1, identity)),
    )
    yield Candidate(
        "torque_gain",
        joint,
        j,
        lambda s: _load_torque(s, j)[:, None],
        (("gain", "1", 0, lambda c: 1.0 - c),),
    )


def _contact_candidates(problem: BaselineProblem) -> Iterator[Candidate]:
    """Yield contacts in sliding time windows."""
    t, n = problem.train.data.t, len(problem.joints)
    for length in (2.0, 4.0):
        for start in np.arange(t[0] + 1.0, t[-1] - length, 1.0):

            def pulse(
                s: RecordedScene, start: float = float(start), length: float = length
            ) -> FloatArray:
                u = np.clip((s.data.t - start) / length, 0.0, 1.0)
                return np.sin(np.pi * u)[:, None, None] * np.eye(n)

            yield Candidate(
                "contact",
                problem.joints[-1],
                None,
                pulse,
                time=(float(start), float(start) + length),
            )


def _whole_robot_candidates(problem: BaselineProblem) -> Iterator[Candidate]:
    """Yield gravity tilt, payloads and kinematic errors."""
    dynamics = problem.train.dynamics
    horizontal = [
        mujoco_dynamics.build_dynamics(dynamics.tree, dynamics.joints, gravity=axis)
        for axis in ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    ]
    gravity = float(np.linalg.norm(dynamics.model.opt.gravity))

    def tilt(s: RecordedScene) -> FloatArray:
        zero = np.zeros_like(s.data.q)
        return gravity * np.stack(
            [tilted.inverse_dynamics(s.data.q, zero, zero) for tilted in horizontal], axis=2
        )

    yield Candidate(
        "gravity_tilt",
        None,
        None,
        tilt,
        (("roll", "rad", 0, lambda c: -c), ("pitch", "rad", 1, identity)),
    )
    for j, joint in enumerate(dynamics.joints):
        yield Candidate(
            "payload", joint, None, partial(_body_columns, j=j), (("mass", "kg", 0, identity),)
        )
        if j:
            yield Candidate("kinematic_error", joint, None, partial(_frame_columns, joint=joint))


def _body_columns(s: RecordedScene, j: int) -> FloatArray:
    """Return the columns of mass and first moments of the link that joint j moves."""
    y, model = rigid_body_regressor(s.dynamics, s.data.q, s.data.v, s.data.a), s.dynamics.model
    moving = [b for b in range(1, model.nbody) if model.body_weldid[b] != 0]
    at = 10 * moving.index(int(model.jnt_bodyid[j]))
    return y[:, :, at : at + 4]


def _frame_columns(s: RecordedScene, joint: str) -> FloatArray:
    """Return derivatives of the torque by two rotations and a shift of a joint frame."""
    out, h = [], 1e-4
    nominal = s.dynamics.inverse_dynamics(s.data.q, s.data.v, s.data.a)
    for rotation, shift in (
        ((h, 0.0, 0.0), (0.0,) * 3),
        ((0.0, h, 0.0), (0.0,) * 3),
        ((0.0,) * 3, (h, 0.0, 0.0)),
    ):
        tree = s.dynamics.tree.with_moved_frame(
            joint, Rotation.from_rotvec(rotation).as_matrix(), np.array(shift)
        )
        out.append(
            (
                mujoco_dynamics.build_dynamics(tree, s.dynamics.joints).inverse_dynamics(
                    s.data.q, s.data.v, s.data.a
                )
                - nominal
            )
            / h
        )
    return np.stack(out, axis=2)
