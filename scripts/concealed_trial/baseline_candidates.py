"""What a greedy search tries: columns for the effects of the contract's list, as a textbook has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from excite.simulator import mujoco_dynamics as arms
from excite.simulator.regressor import bodies

from .baseline_data import Problem, Scene
from .baseline_fit import OUT

Array = np.ndarray


@dataclass(frozen=True)
class Candidate:
    """name, joint: as an answer states them. make: a scene's columns, Shape (N, m) at joint j or (N, n, m) at all.

    stated: names of parameters that the coefficients are; each with a unit, the coefficient's number, and what turns it into the value.
    """

    name: str
    joint: str | None
    j: int | None
    make: Callable[[Scene], Array]
    stated: tuple[tuple[str, str, int, Callable[[float], float]], ...] = ()
    fixed: tuple[tuple[str, str, float], ...] = ()
    time: tuple[float, float] | None = None


def same(x: float) -> float:
    return x


def candidates(problem: Problem) -> Iterator[Candidate]:
    """All of them, joint by joint, then those of the whole robot."""
    for j, joint in enumerate(problem.joints):
        yield from _friction(j, joint)
        yield from _drive(j, joint, problem)
        if problem.trusted:
            yield from _absorbed(j, joint)
    yield from _windows(problem)
    if problem.trusted:
        yield from _robot(problem)


def sign(scene: Scene, j: int) -> Array:
    return np.tanh(scene.data.v[:, j] / scene.width[j])


def _friction(j: int, joint: str) -> Iterator[Candidate]:
    def v(s: Scene) -> Array:
        return s.data.v[:, j]

    for speed in (0.03, 0.1, 0.3):
        yield Candidate(
            "stribeck",
            joint,
            j,
            partial(_stribeck, j=j, speed=speed),
            (("amplitude", "N m", 0, same),),
            (("velocity", "rad/s", speed),),
        )
    yield Candidate("asymmetric_viscous", joint, j, lambda s: np.abs(v(s))[:, None])
    yield Candidate(
        "drag",
        joint,
        j,
        lambda s: (v(s) * np.abs(v(s)))[:, None],
        (("coefficient", "N m s²/rad²", 0, same),),
    )
    yield Candidate(
        "nonlinear_viscous", joint, j, lambda s: (v(s) ** 3)[:, None], (), (("exponent", "1", 3.0),)
    )
    yield Candidate(
        "nonlinear_viscous",
        joint,
        j,
        lambda s: (sign(s, j) * np.sqrt(np.abs(v(s))))[:, None],
        (),
        (("exponent", "1", 0.5),),
    )
    yield Candidate(
        "load_friction",
        joint,
        j,
        lambda s: (sign(s, j) * np.abs(_load(s, j)))[:, None],
        (("mu", "1", 0, same),),
    )
    yield Candidate(
        "position_friction",
        joint,
        j,
        lambda s: (
            sign(s, j)[:, None]
            * np.column_stack([f(k * s.data.q[:, j]) for k in (1, 2) for f in (np.cos, np.sin)])
        ),
    )
    yield Candidate(
        "thermal_drift",
        joint,
        j,
        lambda s: np.exp(-s.data.t / 10.0)[:, None] * np.column_stack([v(s), sign(s, j)]),
    )
    for way in (1e-3, 5e-3):
        yield Candidate(
            "hysteresis", joint, j, partial(_dahl, j=j, way=way), (("amplitude", "N m", 0, same),)
        )


def _load(s: Scene, j: int) -> Array:
    return np.asarray(s.load[:, j])


def _stribeck(s: Scene, j: int, speed: float) -> Array:
    return np.asarray(sign(s, j) * np.exp(-np.square(s.data.v[:, j] / speed)))[:, None]


def _coupled(s: Scene, i: int) -> Array:
    return np.column_stack([s.data.v[:, i], sign(s, i)])


def _waver(s: Scene, j: int, k: int) -> Array:
    """Inertial torque of a wave in the position read."""
    return np.asarray(
        s.mass[:, j, None]
        * np.column_stack([_rate(s, _rate(s, f(k * s.data.q[:, j]))) for f in (np.cos, np.sin)])
    )


def _dahl(s: Scene, j: int, way: float) -> Array:
    """Dahl's friction state less its sign: what memory adds. Shape (N, 1)."""
    q, z, out = s.data.q[:, j], 0.0, np.zeros(len(s.data.t))
    keep, towards = np.exp(-np.abs(np.diff(q)) / way), np.sign(np.diff(q))
    for k in range(len(keep)):
        z = towards[k] + (z - towards[k]) * keep[k]
        out[k + 1] = z
    return np.asarray(out - sign(s, j))[:, None]


def _rate(s: Scene, x: Array) -> Array:
    return np.gradient(x, s.data.t)


def _drive(j: int, joint: str, problem: Problem) -> Iterator[Candidate]:
    yield Candidate(
        "delay",
        joint,
        j,
        lambda s: _rate(s, _smooth(s, j))[:, None],
        (("seconds", "s", 0, lambda c: -c),),
    )
    yield Candidate(
        "elasticity",
        joint,
        j,
        lambda s: (s.mass[:, j] * _rate(s, _rate(s, _smooth(s, j))))[:, None],
        (("stiffness", "N m/rad", 0, lambda c: -1.0 / c if c else 0.0),),
    )
    yield Candidate(
        "backlash",
        joint,
        j,
        lambda s: (s.mass[:, j] * _rate(s, _rate(s, np.tanh(_smooth(s, j) / (0.02 * s.limit[j])))))[
            :, None
        ],
        (("width", "rad", 0, lambda c: abs(2.0 * c)),),
    )
    yield Candidate(
        "torque_saturation",
        joint,
        j,
        lambda s: (_load(s, j) * np.abs(_load(s, j)) / s.limit[j])[:, None],
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
                "coupling", joint, j, partial(_coupled, i=i), (("viscous", "N m s/rad", 0, same),)
            )
    order = _order(problem, j)
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
            partial(_waver, j=j, k=k),
            (),
            (("order", "1/turn", float(k)),),
        )


def _smooth(s: Scene, j: int) -> Array:
    """Torque that may be differentiated twice: below 30 Hz, at the scene's own rate."""
    from scipy import signal

    rate = 1.0 / float(np.median(np.diff(s.data.t)))
    return np.asarray(
        signal.sosfiltfilt(signal.butter(4, 30.0, fs=rate, output="sos"), s.load[:, j])
    )


def _order(problem: Problem, j: int) -> float:
    """The order at which the residual has its largest line in the angle's spectrum."""
    s, rest = problem.train, problem.rest[0][:, j]
    dt = float(np.median(np.diff(s.data.t)))
    edge, every = round(0.5 / dt), max(1, round(1.0 / (dt * OUT)))
    q = s.data.q[edge:-edge:every, j]
    orders = np.arange(5.0, 80.0, 0.25)
    power = np.abs(np.exp(-1j * np.multiply.outer(orders, q)) @ rest)
    return float(orders[int(np.argmax(power))])


def _absorbed(j: int, joint: str) -> Iterator[Candidate]:
    yield Candidate(
        "rotor_inertia",
        joint,
        j,
        lambda s: s.data.a[:, j][:, None],
        (("inertia", "kg m²", 0, same),),
    )
    yield Candidate(
        "torque_offset",
        joint,
        j,
        lambda s: np.ones((len(s.data.t), 1)),
        (("offset", "N m", 0, same),),
    )
    yield Candidate(
        "friction",
        joint,
        j,
        lambda s: np.column_stack([sign(s, j), s.data.v[:, j]]),
        (("coulomb", "N m", 0, same), ("viscous", "N m s/rad", 1, same)),
    )
    yield Candidate(
        "torque_gain",
        joint,
        j,
        lambda s: _load(s, j)[:, None],
        (("gain", "1", 0, lambda c: 1.0 - c),),
    )


def _windows(problem: Problem) -> Iterator[Candidate]:
    t, n = problem.train.data.t, len(problem.joints)
    for length in (2.0, 4.0):
        for start in np.arange(t[0] + 1.0, t[-1] - length, 1.0):

            def pulse(s: Scene, start: float = float(start), length: float = length) -> Array:
                u = np.clip((s.data.t - start) / length, 0.0, 1.0)
                return np.sin(np.pi * u)[:, None, None] * np.eye(n)

            yield Candidate(
                "contact",
                problem.joints[-1],
                None,
                pulse,
                time=(float(start), float(start) + length),
            )


def _robot(problem: Problem) -> Iterator[Candidate]:
    arm = problem.train.arm
    across = [
        arms.build(arm.tree, arm.joints, gravity=axis)
        for axis in ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    ]
    size = float(np.linalg.norm(arm.model.opt.gravity))

    def tilt(s: Scene) -> Array:
        still = np.zeros_like(s.data.q)
        return size * np.stack([one.inverse(s.data.q, still, still) for one in across], axis=2)

    yield Candidate(
        "gravity_tilt",
        None,
        None,
        tilt,
        (("roll", "rad", 0, lambda c: -c), ("pitch", "rad", 1, same)),
    )
    for j, joint in enumerate(arm.joints):
        yield Candidate("payload", joint, None, partial(_body, j=j), (("mass", "kg", 0, same),))
        if j:
            yield Candidate("kinematic_error", joint, None, partial(_frame, joint=joint))


def _body(s: Scene, j: int) -> Array:
    """Mass and first moments of the link that joint j moves."""
    y, model = bodies(s.arm, s.data.q, s.data.v, s.data.a), s.arm.model
    moving = [b for b in range(1, model.nbody) if model.body_weldid[b] != 0]
    at = 10 * moving.index(int(model.jnt_bodyid[j]))
    return y[:, :, at : at + 4]


def _frame(s: Scene, joint: str) -> Array:
    """Derivatives of the torque by two turns and a shift of the joint's frame."""
    out, h = [], 1e-4
    plain = s.arm.inverse(s.data.q, s.data.v, s.data.a)
    for turn, shift in (
        ((h, 0.0, 0.0), (0.0,) * 3),
        ((0.0, h, 0.0), (0.0,) * 3),
        ((0.0,) * 3, (h, 0.0, 0.0)),
    ):
        tree = s.arm.tree.moved(joint, Rotation.from_rotvec(turn).as_matrix(), np.array(shift))
        out.append(
            (arms.build(tree, s.arm.joints).inverse(s.data.q, s.data.v, s.data.a) - plain) / h
        )
    return np.stack(out, axis=2)
