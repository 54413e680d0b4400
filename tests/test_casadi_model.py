"""Symbolic dynamics against Pinocchio and finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from conftest import BUILTIN, loaded, off, random_urdf, seeds, slope, states, text_of
from hypothesis import given
from hypothesis import strategies as st

from excite.designer import casadi_model
from excite.errors import UnusableInput
from excite.robot import dynamics, inertial_parameters
from excite.robot.inertial_parameters import COULOMB_WIDTH, Parameters
from excite.robot.limits import resolve
from excite.robot.robot import Robot, load
from excite.robot.samples import Samples

MIMICS = {2: (0, -1.7, 0.3)}
STEP = 0.02 * COULOMB_WIDTH


def layout(robot: Robot) -> Parameters:
    return inertial_parameters.standard_parameters(robot, resolve(robot))


def near_standstill(n: int) -> Samples:
    """Return states in which smooth Coulomb friction is not saturated."""
    motion = states(n, count=3, seed=5)
    return Samples(motion.q, 1e-3 * motion.dq, motion.ddq)


def symbolic_regressor(robot: Robot, standard: Parameters, motion: Samples) -> np.ndarray:
    function = casadi_model.dynamics_functions(robot, standard).regressor
    return np.array(
        [
            np.asarray(function(*state)).T
            for state in zip(motion.q, motion.dq, motion.ddq, strict=True)
        ]
    )


@pytest.mark.parametrize("name", BUILTIN)
def test_regressor_of_built_in_models_equals_pinocchio(name):
    robot = load(name)
    standard, motion = layout(robot), states(robot.n)
    assert (
        off(
            symbolic_regressor(robot, standard, motion), dynamics.regressor(robot, standard, motion)
        )
        < 1e-12
    )


@given(
    seeds,
    st.booleans(),
    st.sampled_from([None, MIMICS]),
    st.sampled_from([(0, 0, -9.81), (1.0, -2.0, 7.0)]),
)
def test_regressor_of_random_robots_equals_pinocchio(rng, tidy, mimics, gravity):
    robot = loaded(random_urdf(rng, 4, tidy=tidy, mimics=mimics), gravity=gravity)
    standard = layout(robot)
    for motion in (states(robot.n), near_standstill(robot.n)):
        assert (
            off(
                symbolic_regressor(robot, standard, motion),
                dynamics.regressor(robot, standard, motion),
            )
            < 1e-12
        )


# gradients


def differences(
    robot: Robot, standard: Parameters, motion: Samples, scalar: Callable[[np.ndarray], float]
) -> np.ndarray:
    """Return finite-difference gradients of a function of Y at each sample. Shape (N, 3n)."""
    out = np.empty((len(motion), 3 * robot.n))
    for t in range(len(motion)):
        state = np.concatenate([motion.q[t], motion.dq[t], motion.ddq[t]])

        def value(x):
            parts = Samples(*x.reshape(3, 1, -1))
            return scalar(dynamics.regressor(robot, standard, parts)[0])

        for i, unit in enumerate(np.eye(len(state))):
            out[t, i] = slope(
                lambda h, unit=unit, state=state, value=value: value(state + h * unit), STEP
            )
    return out


ROBOTS = ["two_link", "tx40", "mimic"]


def robot_named(name: str) -> Robot:
    return (
        loaded(random_urdf(np.random.default_rng(1), 4, mimics=MIMICS))
        if name == "mimic"
        else load(name)
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_adjoint_equals_finite_differences(name):
    robot = robot_named(name)
    standard, motion = layout(robot), near_standstill(robot.n)
    seed = np.random.default_rng(2).normal(size=(robot.n, standard.count))
    adjoint = casadi_model.dynamics_functions(robot, standard).adjoint
    computed = [
        np.concatenate([np.asarray(g).ravel() for g in adjoint(*s, seed.T)])
        for s in zip(motion.q, motion.dq, motion.ddq, strict=True)
    ]
    assert (
        off(
            np.array(computed),
            differences(robot, standard, motion, lambda Y: float(np.sum(seed * Y))),
        )
        < 1e-8
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_torque_gradients_equal_finite_differences(name):
    robot = robot_named(name)
    standard, motion = layout(robot), near_standstill(robot.n)
    weight = np.random.default_rng(2).normal(size=standard.count)
    row = casadi_model.dynamics_functions(robot, standard).row
    for j, pick in enumerate(np.eye(robot.n)):
        computed = [
            np.concatenate([np.asarray(g).ravel() for g in row(*s, weight, pick)])
            for s in zip(motion.q, motion.dq, motion.ddq, strict=True)
        ]
        assert (
            off(
                np.array(computed),
                differences(robot, standard, motion, lambda Y, j=j: float(Y[j] @ weight)),
            )
            < 1e-8
        )


# frames


def pinocchio_position(text: str, frame: str, joints: tuple[str, ...], q: np.ndarray) -> np.ndarray:
    model = pin.buildModelFromXML(text)
    data = model.createData()
    x = np.zeros(model.nq)
    x[[model.joints[model.getJointId(name)].idx_q for name in joints]] = q
    pin.forwardKinematics(model, data, x)
    return pin.updateFramePlacement(model, data, model.getFrameId(frame)).translation


@pytest.mark.parametrize(
    ("name", "frame"),
    [("two_link", "tip"), ("ur10e", "tool0"), ("panda", "panda_link4"), ("tree", "tool")],
)
def test_frame_position_equals_pinocchio(name, frame):
    text = (
        random_urdf(np.random.default_rng(4), 5, kinds=("revolute", "prismatic"))
        if name == "tree"
        else text_of(name)
    )
    robot = loaded(text)
    function = casadi_model.frame_position(robot, frame)
    for q in states(robot.n).q:
        assert np.allclose(
            np.asarray(function(q)[0]).ravel(),
            pinocchio_position(text, frame, robot.joints, q),
            atol=1e-12,
        )


def test_frame_jacobian_equals_finite_differences():
    robot = load("ur10e")
    function, q = casadi_model.frame_position(robot, "tool0"), states(6).q[0]
    computed = np.asarray(function(q)[1])
    measured = [
        slope(lambda h, e=e: dynamics.positions(robot, "tool0", (q + h * e)[None])[0], 1e-2)
        for e in np.eye(6)
    ]
    assert off(computed, np.array(measured).T) < 1e-8


def test_frame_position_with_mimic_joints():
    robot = robot_named("mimic")
    q = states(robot.n).q
    function = casadi_model.frame_position(robot, "tool")
    assert (
        off(
            np.array([np.asarray(function(x)[0]).ravel() for x in q]),
            dynamics.positions(robot, "tool", q),
        )
        < 1e-12
    )


def test_unknown_frame_is_refused():
    with pytest.raises(UnusableInput, match="no frame 'claw'"):
        casadi_model.frame_position(load("two_link"), "claw")
