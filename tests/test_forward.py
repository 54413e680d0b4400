from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from conftest import loaded, off, random_urdf, slope, states
from made import simulated

from excite.errors import UnusableInput
from excite.identification import (
    consistency,
    estimators,
    forward_dynamics,
    regression,
    segments,
    simulation_error,
    simulation_refinement,
)
from excite.identification.consistency import Prior
from excite.identification.inertia_distance import Distance
from excite.identification.regression import IdentificationModel
from excite.identification.simulation_error import SimulationWindows
from excite.recordings import Recording
from excite.recordings.sidecar import Sidecar
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot
from excite.robot.robot import locate

WIDTH = 0.02


def model_of(arm, drive=inertial_parameters.DRIVE) -> IdentificationModel:
    own = inertial_parameters.standard(arm, limits.resolve(arm), drive)
    return IdentificationModel(
        arm, own, base_parameters.find(arm, own, limits.resolve(arm)), np.full(arm.n, WIDTH)
    )


def driven(model: IdentificationModel, seed: int = 0) -> np.ndarray:
    """Nominal bodies with drives that do something."""
    rng, psi = np.random.default_rng(seed), consistency.consistent_nominal(model.parameters)
    for kind, size in (("rotor_inertia", 0.5), ("viscous", 0.4), ("coulomb", 1.0), ("offset", 0.3)):
        if kind in model.parameters.drive:
            psi[model.parameters.block(kind)] = size * rng.uniform(0.5, 1.5, model.robot.n)
    return psi


def mimicking() -> IdentificationModel:
    return model_of(
        loaded(
            random_urdf(np.random.default_rng(5), 4, mimics={2: (0, 0.7, 0.1)}, kinds=("revolute",))
        )
    )


MODELS = {
    "two_link": lambda: model_of(robot.load("two_link")),
    "panda": lambda: model_of(robot.load("panda")),
    "mimic": mimicking,
    "bare": lambda: model_of(robot.load("two_link"), ("coulomb",)),
}


@pytest.fixture(params=list(MODELS))
def model(request) -> IdentificationModel:
    return MODELS[request.param]()


def slow(n: int, count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Poses, and speeds of the order of friction's width."""
    motion = states(n, count, 1)
    return motion.q, 0.02 * motion.dq


def test_forward_dynamics_undoes_inverse_dynamics(model):
    motion, psi = states(model.robot.n, 5, 2), driven(model)
    Y = dynamics.regressor(model.robot, model.parameters, motion)
    block = model.parameters.block("coulomb")
    Y[:, range(model.robot.n), range(block.start, block.stop)] = np.tanh(motion.dq / WIDTH)
    found = forward_dynamics.build_dynamics(model, psi).acceleration(motion.q, motion.dq, Y @ psi)
    assert off(found, motion.ddq) < 1e-9


def test_rigid_torque_is_that_of_the_regressor(model):
    motion, psi = states(model.robot.n, 5, 2), driven(model)
    kept = np.ones(len(psi))
    for kind in ("viscous", "coulomb", "offset"):
        if kind in model.parameters.drive:
            kept[model.parameters.block(kind)] = 0.0
    expected = dynamics.regressor(model.robot, model.parameters, motion) @ (kept * psi)
    assert off(forward_dynamics.build_dynamics(model, psi).rigid(motion), expected) < 1e-9


def test_derivatives_of_acceleration(model):
    psi, n = driven(model), model.robot.n
    q, v = slow(n)
    torque = states(n, 4, 3).ddq
    a, slopes = forward_dynamics.build_dynamics(model, psi).sensitive(q, v, torque)
    assert off(a, forward_dynamics.build_dynamics(model, psi).acceleration(q, v, torque)) < 1e-12
    body, back = forward_dynamics.build_dynamics(model, psi), np.linalg.pinv(model.base.matrix)
    for j in range(n):
        at, size = np.eye(n)[j], 1e-6 * np.abs(slopes[:, :, : 2 * n]).max()
        by_q = slope(lambda h, at=at: body.acceleration(q + h * at, v, torque), 1e-4)
        by_v = slope(lambda h, at=at: body.acceleration(q, v + h * at, torque), 1e-4)
        assert (
            np.abs(slopes[:, :, j] - by_q).max() < size
            and np.abs(slopes[:, :, n + j] - by_v).max() < size
        )
    scale = np.abs(slopes[:, :, 2 * n :]).max()
    for k in range(0, model.base.count, 4):
        found = slope(
            lambda h, k=k: forward_dynamics.build_dynamics(model, psi + h * back[:, k]).acceleration(
                q, v, torque
            ),
            1e-4,
        )
        assert np.abs(slopes[:, :, 2 * n + k] - found).max() < 1e-6 * scale


def some_windows(model: IdentificationModel, count: int = 3) -> SimulationWindows:
    n = model.robot.n
    q, v = slow(n, count)
    torque = states(n, count, 4).ddq[:, None] + np.random.default_rng(5).normal(size=(count, 11, n))
    return SimulationWindows(
        np.concatenate([q, v], axis=1), torque, np.repeat(q[:, None], 3, axis=1), 5, 200.0
    )


def test_derivatives_of_simulated_positions_are_those_of_the_discrete_map(model):
    psi, n, windows = driven(model), model.robot.n, some_windows(model)
    body, start = forward_dynamics.build_dynamics(model, psi), windows.states
    q, slopes = simulation_error.simulate_sensitivities(body, windows, start)
    assert off(q, simulation_error.simulate_positions(body, windows, start)) < 1e-13
    for k in (0, n - 1, n, 2 * n - 1):
        unit = np.eye(2 * n)[k]
        found = slope(
            lambda h, unit=unit: simulation_error.simulate_positions(body, windows, start + h * unit), 1e-4
        )
        assert off(slopes[..., k], found) < 1e-6
    back = np.linalg.pinv(model.base.matrix)
    size = np.abs(slopes[..., 2 * n :]).max()
    for k in range(0, model.base.count, 5):
        found = slope(
            lambda h, k=k: simulation_error.simulate_positions(
                forward_dynamics.build_dynamics(model, psi + h * back[:, k]), windows, start
            ),
            1e-4,
        )
        assert np.abs(slopes[..., 2 * n + k] - found).max() < 1e-6 * size


def test_friction_is_as_wide_as_a_step_of_integration_needs():
    model = model_of(robot.load("two_link"))
    psi, windows = driven(model), some_windows(model)
    assert np.array_equal(simulation_error.widen_friction(model, psi, [windows]).widths, model.widths)
    narrow = forward_dynamics.with_widths(model, np.full(2, 1e-6))
    soft = simulation_error.widen_friction(narrow, psi, [windows])
    assert (soft.widths > 1e-4).all()
    assert np.isfinite(
        simulation_error.simulate_positions(forward_dynamics.build_dynamics(soft, psi), windows, windows.states)
    ).all()


# -- on a recording ------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Known:
    model: IdentificationModel
    groups: list[SimulationWindows]
    share: float
    data: estimators.Estimate
    prior: Prior
    psi: np.ndarray
    truth: np.ndarray


@pytest.fixture(scope="module")
def known() -> Known:
    pytest.importorskip("mujoco")
    from excite.simulator import experiment

    path = locate("two_link")
    session = experiment.simulate(
        path,
        Path(__file__).parents[1] / "trajectories/two_link.json",
        experiment.ExperimentSettings(seed=5, noise=1e-3),
        periods=2,
    )
    told, arm = session.recording, robot.load("two_link")
    own = inertial_parameters.standard(arm, limits.resolve(arm))
    truth = simulated(session.plant, own, limits.resolve(arm))
    model = IdentificationModel(
        arm, own, base_parameters.find(arm, own, limits.resolve(arm)), session.plant.drive.width
    )
    sidecar = Sidecar(period=told.period, periodic=told.periodic)
    pieces = list(
        segments.extract_segments(
            [Recording("bench.csv", told.joints, told.t, told.q, tau=told.tau, sidecar=sidecar)]
        )
    )
    data = estimators.estimate(regression.build_equations(model, pieces, 20.0))
    prior = Prior(
        consistency.consistent_nominal(own),
        Distance.BREGMAN,
        1.0,
        1e-6 * np.ones(own.count - 10 * own.bodies),
        np.diag(own.scale)[10 * own.bodies :],
    )
    psi = consistency.maximum_a_posteriori(
        own, data.information_root @ model.base.matrix, data.information_root @ data.theta, prior
    ).psi
    groups, share = simulation_error.cut_windows(pieces, 20.0, 0.1, 12)
    return Known(model, groups, share, data, prior, psi, truth)


def test_windows_lie_in_the_recording(known):
    (windows,) = known.groups
    assert len(windows) == 12 and 0.0 < known.share < 1.0
    assert windows.lag[-1] == pytest.approx(0.1) and windows.q.shape[1] == len(windows.lag)
    assert np.abs(windows.states[:, :2] - windows.q[:, 0]).max() < 1e-3


def test_the_identified_robot_foresees_positions_and_the_nominal_one_does_not(known):
    found = simulation_error.compute_simulation_error(
        known.model, known.psi, known.prior.nominal, known.groups, known.share
    )
    assert (found.fitted[-1] < 2e-3).all() and (found.nominal[-1] > 10.0 * found.fitted[-1]).all()
    assert (np.diff(found.nominal, axis=0) > 0.0).all()
    assert found.windows == 12 and "0.1 s ahead" in found.words
    true = simulation_error.compute_simulation_error(known.model, known.truth, known.prior.nominal, known.groups)
    assert (true.fitted[-1] < 1.1 * found.fitted[-1] + 1e-5).all()


def test_refined_parameters_foresee_positions_better_and_stay_where_equation_error_puts_them(known):
    found = simulation_refinement.refine(
        known.model, known.groups, known.psi, known.data, known.prior
    )
    assert (
        all(b <= a for a, b in zip(found.costs, found.costs[1:], strict=False))
        and found.costs[-1] < found.costs[0]
    )
    assert consistency.is_consistent(known.model.parameters, found.psi)
    moved = known.data.information_root @ known.model.base.matrix @ (found.psi - known.psi)
    assert float(moved @ moved) < 4.0 * len(moved)


def test_from_a_wrong_start_it_finds_the_truth_without_equation_error(known):
    wrong, P = known.psi.copy(), known.model.parameters
    wrong[P.block("viscous")] *= 1.5
    wrong[P.block("coulomb")] *= 0.6
    wrong[:20] *= 1.1
    weak = dataclasses.replace(known.prior, bodies=1e-2)
    found = simulation_refinement.refine(
        known.model, known.groups, wrong, known.data, weak, anchored=False
    )
    B = known.model.base.matrix
    before, after = (
        np.linalg.norm(known.data.information_root @ B @ (psi - known.truth)) for psi in (wrong, found.psi)
    )
    assert after < 0.1 * before and consistency.is_consistent(P, found.psi)


def test_a_model_that_loses_the_robot_is_not_refined(known):
    light = known.psi.copy()
    light[:20] *= 1e-4
    light[known.model.parameters.block("rotor_inertia")] *= 1e-4
    with pytest.raises(
        UnusableInput, match=r"loses the recorded motion within a window, joint 'joint_[12]' first"
    ):
        simulation_refinement.refine(known.model, known.groups, light, known.data, known.prior)
    assert simulation_error.cut_windows([], 20.0) == ([], 0.0)
    with pytest.raises(UnusableInput, match="shorter horizon"):
        simulation_error.compute_simulation_error(known.model, known.psi, known.psi, [])
    with pytest.raises(UnusableInput, match="shorter horizon"):
        simulation_refinement.refine(known.model, [], known.psi, known.data, known.prior)
