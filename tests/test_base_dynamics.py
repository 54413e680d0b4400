"""Dynamics of a robot on a compliant base, against finite differences of inverse dynamics and an
integrator of differential equations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from conftest import loaded, text_of
from diagnosis_cases import motions
from scipy import integrate, linalg

from excite._types import FloatArray
from excite.effects import EFFECTS_BY_NAME, base_compliance
from excite.effects.base_dynamics import FloatingBaseDynamics, floating_base_dynamics
from excite.robot import robot
from excite.robot.samples import Samples


@pytest.fixture(scope="module")
def arm() -> robot.Robot:
    return robot.load("tx40")


@pytest.fixture(scope="module")
def base_motion(arm) -> tuple[Samples, FloatingBaseDynamics]:
    motion = Samples(*(np.random.default_rng(seed).normal(size=(4, arm.n)) for seed in range(3)))
    return motion, floating_base_dynamics(arm, arm.model, motion)


def torque(
    arm: robot.Robot, motion: Samples, row: int, base: tuple[FloatArray, FloatArray, FloatArray]
) -> FloatArray:
    """Return force and moment on the base along its six degrees of freedom, then joint torque.

    The base translates and rotates about x, then y, then z. Inverse dynamics with a free-flyer are
    evaluated in the frame of the base, with the rotated gravity.

    Args:
        arm: The robot.
        motion: Motion of the joints.
        row: Sample of the motion.
        base: Position, velocity and acceleration of the base. Shape (6,) each.
    """
    (position, velocity, acceleration), model = base, arm.model
    about = [pin.exp3(angle * axis) for angle, axis in zip(position[3:], np.eye(3), strict=True)]
    first, second, turn = about[0], about[0] @ about[1], about[0] @ about[1] @ about[2]
    axes = np.column_stack(
        [np.eye(3)[0], first[:, 1], second[:, 2]]
    )  # axes of rotation in the frame of the ground
    spin = axes @ velocity[3:]
    # each axis rotates with the previous ones
    turning = (
        np.cross(axes[:, 0] * velocity[3], axes[:, 1]) * velocity[4]
        + np.cross(axes[:, 0] * velocity[3] + axes[:, 1] * velocity[4], axes[:, 2]) * velocity[5]
    )
    surge = axes @ acceleration[3:] + turning
    free = pin.appendModel(_flying(), model, 1, pin.SE3.Identity())
    free.gravity = model.gravity
    data = free.createData()
    ground = turn.T
    pose = np.concatenate(
        [position[:3], pin.Quaternion(turn).coeffs(), arm.expand(motion.q[row : row + 1])[0]]
    )
    twist = np.concatenate([ground @ velocity[:3], ground @ spin, arm.spread @ motion.dq[row]])
    linear = ground @ acceleration[:3] - np.cross(ground @ spin, ground @ velocity[:3])
    rate = np.concatenate([linear, ground @ surge, arm.spread @ motion.ddq[row]])
    out = pin.rnea(free, data, pose, twist, rate)
    return np.concatenate([turn @ out[:3], axes.T @ turn @ out[3:6], arm.spread.T @ out[6:]])


def _flying() -> pin.Model:
    model = pin.Model()
    last = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "flying")
    model.addFrame(pin.Frame("flying_base", last, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return model


@pytest.mark.parametrize("kind", ["by_place", "by_speed", "mass"])
def test_base_motion_changes_the_torque_by_the_derivative_of_inverse_dynamics(
    arm, base_motion, kind
):
    motion, dynamics = base_motion
    which, step = ("by_place", "by_speed", "mass").index(kind), 1e-5
    for row in range(len(motion)):
        for axis in range(6):
            perturbed = np.zeros((2, 3, 6))
            perturbed[0, which, axis], perturbed[1, which, axis] = step, -step
            up, down = (torque(arm, motion, row, tuple(base)) for base in perturbed)
            np.testing.assert_allclose(
                getattr(dynamics, kind)[row, :, axis], (up - down) / (2.0 * step), atol=2e-4
            )


def test_reaction_equals_the_force_on_a_fixed_base(arm, base_motion):
    motion, dynamics = base_motion
    for row in range(len(motion)):
        np.testing.assert_allclose(
            dynamics.reaction[row], torque(arm, motion, row, (np.zeros(6),) * 3)[:6], atol=1e-9
        )


def test_a_link_may_have_the_name_of_a_joint():
    plain = text_of("two_link")
    named, other = (loaded(plain.replace('name="joint_2"', f'name="{x}"')) for x in ("link_2", "b"))
    motion = Samples(*(np.random.default_rng(seed).normal(size=(4, 2)) for seed in range(3)))
    np.testing.assert_allclose(
        floating_base_dynamics(named, named.model, motion).reaction,
        floating_base_dynamics(other, other.model, motion).reaction,
    )


def test_coupled_oscillators_agree_with_an_integrator():
    """Two masses with rotating inertia and Coriolis forces, driven by sinusoidal forces."""
    rate, seconds = 400.0, 3.0
    t = np.arange(int(rate * seconds)) / rate

    def coefficients(time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
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

    def derivative(time: float, z: FloatArray) -> FloatArray:
        m, d, k, f = (x[0] for x in coefficients(np.array([time])))
        return np.concatenate([z[2:], np.linalg.solve(m, f - d @ z[2:] - k @ z[:2])])

    m, d, k, f = coefficients(t)
    position, velocity, acceleration = (
        x.sum(axis=2) for x in base_compliance.simulate_base(m, d, k, f, 1.0 / rate)
    )
    start = np.concatenate([np.linalg.solve(k[0], f[0]), np.zeros(2)])
    exact = integrate.solve_ivp(derivative, (0.0, t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-12).y
    for computed, expected in ((position, exact[:2].T), (velocity, exact[2:].T)):
        assert np.abs(computed - expected).max() < 5e-3 * np.abs(expected).max()
    accelerations = np.array([derivative(time, z)[2:] for time, z in zip(t, exact.T, strict=True)])
    assert np.abs(acceleration - accelerations).max() < 1e-2 * np.abs(accelerations).max()


@pytest.mark.parametrize("size", [0.1, 3.0, 60.0])
def test_matrix_exponential_agrees_with_scipy_for_steps_of_any_length(size):
    """A light stand oscillates several times within a time step of a slow recording."""
    a = (
        size
        * np.random.default_rng(1).normal(size=(5, 4, 4))
        * np.array([[0.0, 0.0, 1.0, 1.0]] * 2 + [[-1.0, -1.0, -0.1, -0.1]] * 2)
    )
    a[:, 2:, :2] = -np.swapaxes(a[:, :2, 2:], 1, 2)  # an oscillation that hardly grows
    block = np.zeros((5, 8, 8))
    block[:, :4, :4], block[:, :4, 4:] = a, np.eye(4)
    exponential, mean = base_compliance.matrix_exponential(a)
    expected = linalg.expm(block)
    np.testing.assert_allclose(exponential, expected[:, :4, :4], atol=1e-4 * np.abs(expected).max())
    np.testing.assert_allclose(mean, expected[:, :4, 4:], atol=1e-4 * np.abs(expected).max())


def test_base_stiffness_is_the_same_in_all_recordings(monkeypatch):
    """The inertia at zero joint positions determines it, not the poses of the recording."""
    stiffnesses, recorded = list[FloatArray](), motions()

    def record_stiffness(
        inertia: FloatArray,
        damping: FloatArray,
        stiffness: FloatArray,
        force: FloatArray,
        dt: float,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        stiffnesses.append(np.diagonal(stiffness, axis1=1, axis2=2))
        return (np.zeros((*force.shape, force.shape[1])),) * 3

    monkeypatch.setattr(base_compliance, "simulate_base", record_stiffness)
    fixed = {"frequency": 5.0, "damping": 0.1, "way": 1.0, "stand": 0.2, "apart": 1.5}
    candidate = next(iter(EFFECTS_BY_NAME["base_compliance"].candidates(recorded)))
    model = dataclasses.replace(candidate, values=fixed)
    for motion in recorded:
        motion.__dict__["base_dynamics"] = dataclasses.replace(
            motion.base_dynamics, by_place=0.0 * motion.base_dynamics.by_place
        )
        model.columns(motion)
    inertia_at_zero = recorded[0].upright_inertia[3:5]
    for stiffness in stiffnesses:
        np.testing.assert_allclose(
            stiffness,
            np.tile(
                (2.0 * np.pi * np.array([5.0, 7.5])) ** 2
                * (inertia_at_zero + 0.2 * inertia_at_zero.max()),
                (len(stiffness), 1),
            ),
        )
    assert len(stiffnesses) == len(recorded) > 1


def test_a_base_on_equal_springs_is_tried_next_to_one_of_equal_frequencies():
    """With the arm stretched, its inertias about both axes differ, and with them frequencies."""
    recorded = motions()
    inertia_at_zero = recorded[0].upright_inertia[3:5]
    stiffness_ratios = {
        round(float((inertia[1] / inertia[0]) * model.values["apart"] ** 2), 6)
        for model in EFFECTS_BY_NAME["base_compliance"].candidates(recorded)
        if model.values["way"] == 1.0
        for inertia in [inertia_at_zero + model.values["stand"] * inertia_at_zero.max()]
    }
    assert len(stiffness_ratios) == 2
    assert 1.0 in stiffness_ratios
