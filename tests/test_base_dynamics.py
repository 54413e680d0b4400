"""A robot on a base that gives way: against finite differences of Pinocchio's inverse dynamics, and
against a solver of stiff equations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from scipy import integrate, linalg
from test_diagnosis import found

from excite.effects import base_compliance
from excite.effects.base_dynamics import FloatingBaseDynamics, floating_base_dynamics
from excite.effects.effect import CandidateModel
from excite.robot import robot
from excite.robot.samples import Samples

Array = np.ndarray


@pytest.fixture(scope="module")
def arm() -> robot.Robot:
    return robot.load("tx40")


@pytest.fixture(scope="module")
def moved(arm) -> tuple[Samples, FloatingBaseDynamics]:
    motion = Samples(*(np.random.default_rng(seed).normal(size=(4, arm.n)) for seed in range(3)))
    return motion, floating_base_dynamics(arm, arm.model, motion)


def torque(arm: robot.Robot, motion: Samples, row: int, base: tuple[Array, Array, Array]) -> Array:
    """Force and moment on the base, along its hinges, then torque on the joints, of a base that
    slides, and turns about x, then y, z: Newton's laws in the base's own frame, where gravity is
    turned and all is hastened. base: place, speed, acceleration. Shape (6,)."""
    (place, speed, haste), model = base, arm.model
    about = [pin.exp3(angle * axis) for angle, axis in zip(place[3:], np.eye(3), strict=True)]
    first, second, turn = about[0], about[0] @ about[1], about[0] @ about[1] @ about[2]
    axes = np.column_stack(
        [np.eye(3)[0], first[:, 1], second[:, 2]]
    )  # where the hinges point, in the ground's frame
    spin = axes @ speed[3:]
    # the hinges turn with those before them
    turning = (
        np.cross(axes[:, 0] * speed[3], axes[:, 1]) * speed[4]
        + np.cross(axes[:, 0] * speed[3] + axes[:, 1] * speed[4], axes[:, 2]) * speed[5]
    )
    surge = axes @ haste[3:] + turning
    free = pin.appendModel(_flying(), model, 1, pin.SE3.Identity())
    free.gravity = model.gravity
    data = free.createData()
    ground = turn.T
    pose = np.concatenate(
        [place[:3], pin.Quaternion(turn).coeffs(), arm.expand(motion.q[row : row + 1])[0]]
    )
    twist = np.concatenate([ground @ speed[:3], ground @ spin, arm.spread @ motion.dq[row]])
    linear = ground @ haste[:3] - np.cross(ground @ spin, ground @ speed[:3])
    rate = np.concatenate([linear, ground @ surge, arm.spread @ motion.ddq[row]])
    out = pin.rnea(free, data, pose, twist, rate)
    return np.concatenate([turn @ out[:3], axes.T @ turn @ out[3:6], arm.spread.T @ out[6:]])


def _flying() -> pin.Model:
    model = pin.Model()
    last = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "flying")
    model.addFrame(pin.Frame("flying_base", last, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return model


@pytest.mark.parametrize("kind", ["by_place", "by_speed", "mass"])
def test_what_a_base_does_is_the_slope_of_inverse_dynamics(arm, moved, kind):
    motion, made = moved
    which, step = ("by_place", "by_speed", "mass").index(kind), 1e-5
    for row in range(len(motion)):
        for axis in range(6):
            nudged = np.zeros((2, 3, 6))
            nudged[0, which, axis], nudged[1, which, axis] = step, -step
            up, down = (torque(arm, motion, row, tuple(own)) for own in nudged)
            np.testing.assert_allclose(
                getattr(made, kind)[row, :, axis], (up - down) / (2.0 * step), atol=2e-4
            )


def test_what_holds_the_base_is_the_robots_reaction(arm, moved):
    motion, made = moved
    for row in range(len(motion)):
        np.testing.assert_allclose(
            made.reaction[row], torque(arm, motion, row, (np.zeros(6),) * 3)[:6], atol=1e-9
        )


def test_coupled_masses_swing_as_a_solver_says():
    """Two masses whose inertia turns about, with Coriolis forces, pushed by a wave."""
    rate, seconds = 400.0, 3.0
    t = np.arange(int(rate * seconds)) / rate

    def parts(time: Array) -> tuple[Array, Array, Array, Array]:
        c, s = np.cos(3.0 * time), np.sin(3.0 * time)
        inertia = np.moveaxis(np.array([[2.0 + c, 0.8 * s], [0.8 * s, 2.0 - c]]), -1, 0)
        damping = np.broadcast_to(np.array([[1.0, 0.6], [-0.6, 1.5]]), inertia.shape)
        stiffness = np.broadcast_to(np.array([[900.0, 30.0], [30.0, 1400.0]]), inertia.shape)
        return (
            inertia,
            damping,
            stiffness,
            np.column_stack([np.sin(9.0 * time), np.cos(17.0 * time)]),
        )

    def slope(time: float, z: Array) -> Array:
        m, d, k, f = (x[0] for x in parts(np.array([time])))
        return np.concatenate([z[2:], np.linalg.solve(m, f - d @ z[2:] - k @ z[:2])])

    m, d, k, f = parts(t)
    place, speed, haste = (
        x.sum(axis=2) for x in base_compliance._simulate_base(m, d, k, f, 1.0 / rate)
    )
    start = np.concatenate([np.linalg.solve(k[0], f[0]), np.zeros(2)])
    right = integrate.solve_ivp(slope, (0.0, t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-12).y
    for told, true in ((place, right[:2].T), (speed, right[2:].T)):
        assert np.abs(told - true).max() < 5e-3 * np.abs(true).max()
    again = np.array([slope(time, z)[2:] for time, z in zip(t, right.T, strict=True)])
    assert np.abs(haste - again).max() < 1e-2 * np.abs(again).max()


@pytest.mark.parametrize("size", [0.1, 3.0, 60.0])
def test_the_exponential_of_a_step_holds_however_long_it_is(size):
    """A light stand swings several times in a step of a slow recording."""
    a = (
        size
        * np.random.default_rng(1).normal(size=(5, 4, 4))
        * np.array([[0.0, 0.0, 1.0, 1.0]] * 2 + [[-1.0, -1.0, -0.1, -0.1]] * 2)
    )
    a[:, 2:, :2] = -np.swapaxes(a[:, :2, 2:], 1, 2)  # so that it swings, and hardly grows
    both = np.zeros((5, 8, 8))
    both[:, :4, :4], both[:, :4, 4:] = a, np.eye(4)
    whole, mean = base_compliance._matrix_exponential(a)
    right = linalg.expm(both)
    np.testing.assert_allclose(whole, right[:, :4, :4], atol=1e-4 * np.abs(right).max())
    np.testing.assert_allclose(mean, right[:, :4, 4:], atol=1e-4 * np.abs(right).max())


def test_a_bases_spring_is_the_same_in_every_recording(monkeypatch):
    """Whatever the poses: told by what swings with all joints at zero."""
    from synthetic_recordings import two_link_model

    result, told = found(two_link_model(), None), list[Array]()

    def seen(
        inertia: Array, damping: Array, stiffness: Array, force: Array, dt: float
    ) -> tuple[Array, Array, Array]:
        told.append(np.diagonal(stiffness, axis1=1, axis2=2))
        return (np.zeros((*force.shape, force.shape[1])),) * 3

    monkeypatch.setattr(base_compliance, "_simulate_base", seen)
    fixed = {"frequency": 5.0, "damping": 0.1, "way": 1.0, "stand": 0.2, "apart": 1.5}
    rocks = CandidateModel("base_compliance", None, base_compliance._columns, fixed)
    every = [one for half in result.motions for one in half]
    for one in every:
        one.__dict__["base_dynamics"] = dataclasses.replace(
            one.base_dynamics, by_place=0.0 * one.base_dynamics.by_place
        )
        rocks.columns(one)
    stood = every[0].upright_inertia[3:5]
    for stiffness in told:
        np.testing.assert_allclose(
            stiffness,
            np.tile(
                (2.0 * np.pi * np.array([5.0, 7.5])) ** 2 * (stood + 0.2 * stood.max()),
                (len(stiffness), 1),
            ),
        )
    assert len(told) == len(every) > 1
