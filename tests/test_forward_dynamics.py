"""Forward dynamics of an identified robot: inverse of the regressor, exact derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from conftest import loaded, off, random_urdf, slope, states

from excite._types import FloatArray
from excite.identification import consistency, forward_dynamics, simulation_error
from excite.identification.regression import IdentificationModel
from excite.identification.simulation_error import SimulationWindows
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot
from excite.robot.robot import Robot

WIDTH = 0.02


def model_of(arm: Robot, drive: tuple[str, ...] = inertial_parameters.DRIVE) -> IdentificationModel:
    table = limits.resolve(arm)
    standard = inertial_parameters.standard_parameters(arm, table, drive)
    return IdentificationModel(
        arm, standard, base_parameters.find(arm, standard, table), np.full(arm.n, WIDTH)
    )


def with_joint_parameters(model: IdentificationModel, seed: int = 0) -> FloatArray:
    """Nominal links with random friction, rotor inertia and offset. Shape (P,)."""
    rng, psi = np.random.default_rng(seed), consistency.consistent_nominal(model.parameters)
    for kind, size in (("rotor_inertia", 0.5), ("viscous", 0.4), ("coulomb", 1.0), ("offset", 0.3)):
        if kind in model.parameters.drive:
            psi[model.parameters.block(kind)] = size * rng.uniform(0.5, 1.5, model.robot.n)
    return psi


def robot_with_mimic_joint() -> Robot:
    rng = np.random.default_rng(5)
    return loaded(random_urdf(rng, 4, mimics={2: (0, 0.7, 0.1)}, kinds=("revolute",)))


MODELS: dict[str, Callable[[], IdentificationModel]] = {
    "two_link": lambda: model_of(robot.load("two_link")),
    "panda": lambda: model_of(robot.load("panda")),
    "mimic": lambda: model_of(robot_with_mimic_joint()),
    "coulomb_only": lambda: model_of(robot.load("two_link"), ("coulomb",)),
}


@pytest.fixture(params=list(MODELS))
def model(request: pytest.FixtureRequest) -> IdentificationModel:
    return MODELS[request.param]()


def slow_states(n: int, count: int = 4) -> tuple[FloatArray, FloatArray]:
    """Random poses, and speeds of the order of the friction width."""
    motion = states(n, count, 1)
    return motion.q, 0.02 * motion.dq


def test_forward_dynamics_inverts_inverse_dynamics(model):
    motion, psi = states(model.robot.n, 5, 2), with_joint_parameters(model)
    Y = dynamics.regressor(model.robot, model.parameters, motion)
    block = model.parameters.block("coulomb")
    Y[:, range(model.robot.n), range(block.start, block.stop)] = np.tanh(motion.dq / WIDTH)
    acceleration = forward_dynamics.build_dynamics(model, psi).acceleration(
        motion.q, motion.dq, Y @ psi
    )
    assert off(acceleration, motion.ddq) < 1e-9


def test_rigid_torque_agrees_with_the_regressor(model):
    motion, psi = states(model.robot.n, 5, 2), with_joint_parameters(model)
    kept = np.ones(len(psi))
    for kind in ("viscous", "coulomb", "offset"):
        if kind in model.parameters.drive:
            kept[model.parameters.block(kind)] = 0.0
    expected = dynamics.regressor(model.robot, model.parameters, motion) @ (kept * psi)
    torque = forward_dynamics.build_dynamics(model, psi).rigid_torque(motion)
    assert off(torque, expected) < 1e-9


def test_derivatives_of_acceleration_agree_with_finite_differences(model):
    psi, n = with_joint_parameters(model), model.robot.n
    q, v = slow_states(n)
    torque = states(n, 4, 3).ddq
    robot_dynamics = forward_dynamics.build_dynamics(model, psi)
    a, slopes = robot_dynamics.acceleration_derivatives(q, v, torque)
    assert off(a, robot_dynamics.acceleration(q, v, torque)) < 1e-12
    for j in range(n):
        unit, tolerance = np.eye(n)[j], 1e-6 * np.abs(slopes[:, :, : 2 * n]).max()
        by_q = slope(lambda h, u=unit: robot_dynamics.acceleration(q + h * u, v, torque), 1e-4)
        by_v = slope(lambda h, u=unit: robot_dynamics.acceleration(q, v + h * u, torque), 1e-4)
        assert np.abs(slopes[:, :, j] - by_q).max() < tolerance
        assert np.abs(slopes[:, :, n + j] - by_v).max() < tolerance
    lift = np.linalg.pinv(model.base.matrix)  # a change of ψ for a change of θ
    scale = np.abs(slopes[:, :, 2 * n :]).max()
    for k in range(0, model.base.count, 4):
        by_theta = slope(
            lambda h, k=k: forward_dynamics.build_dynamics(
                model, psi + h * lift[:, k]
            ).acceleration(q, v, torque),
            1e-4,
        )
        assert np.abs(slopes[:, :, 2 * n + k] - by_theta).max() < 1e-6 * scale


def short_windows(model: IdentificationModel, count: int = 3) -> SimulationWindows:
    n = model.robot.n
    q, v = slow_states(n, count)
    torque = states(n, count, 4).ddq[:, None] + np.random.default_rng(5).normal(size=(count, 11, n))
    return SimulationWindows(
        np.concatenate([q, v], axis=1), torque, np.repeat(q[:, None], 3, axis=1), 5, 200.0
    )


def test_sensitivities_of_simulated_positions_agree_with_finite_differences(model):
    psi, n, windows = with_joint_parameters(model), model.robot.n, short_windows(model)
    robot_dynamics, start = forward_dynamics.build_dynamics(model, psi), windows.states
    q, slopes = simulation_error.simulate_sensitivities(robot_dynamics, windows, start)
    assert off(q, simulation_error.simulate_positions(robot_dynamics, windows, start)) < 1e-13
    for k in (0, n - 1, n, 2 * n - 1):
        unit = np.eye(2 * n)[k]
        by_state = slope(
            lambda h, u=unit: simulation_error.simulate_positions(
                robot_dynamics, windows, start + h * u
            ),
            1e-4,
        )
        assert off(slopes[..., k], by_state) < 1e-6
    lift = np.linalg.pinv(model.base.matrix)
    scale = np.abs(slopes[..., 2 * n :]).max()
    for k in range(0, model.base.count, 5):
        by_theta = slope(
            lambda h, k=k: simulation_error.simulate_positions(
                forward_dynamics.build_dynamics(model, psi + h * lift[:, k]), windows, start
            ),
            1e-4,
        )
        assert np.abs(slopes[..., 2 * n + k] - by_theta).max() < 1e-6 * scale


def test_friction_is_widened_only_where_integration_would_be_unstable():
    model = model_of(robot.load("two_link"))
    psi, windows = with_joint_parameters(model), short_windows(model)
    unchanged = simulation_error.widen_friction(model, psi, [windows])
    assert np.array_equal(unchanged.widths, model.widths)
    narrow = forward_dynamics.with_widths(model, np.full(2, 1e-6))
    widened = simulation_error.widen_friction(narrow, psi, [windows])
    assert (widened.widths > 1e-4).all()
    positions = simulation_error.simulate_positions(
        forward_dynamics.build_dynamics(widened, psi), windows, windows.states
    )
    assert np.isfinite(positions).all()
