"""Simulation error and refinement on a recording of a simulated two-link robot."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from synthetic_recordings import true_parameters

from excite._types import FloatArray
from excite.errors import UnusableInput
from excite.identification import (
    consistency,
    estimators,
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
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.robot import locate


@dataclasses.dataclass(frozen=True)
class IdentifiedRobot:
    """A robot identified by equation error. truth, psi: true and identified ψ."""

    model: IdentificationModel
    groups: list[SimulationWindows]
    share: float
    data: estimators.Estimate
    prior: Prior
    psi: FloatArray
    truth: FloatArray


@pytest.fixture(scope="module")
def identified() -> IdentifiedRobot:
    pytest.importorskip("mujoco")
    from excite.simulator import experiment

    session = experiment.simulate(
        locate("two_link"),
        Path(__file__).parents[1] / "trajectories/two_link.json",
        experiment.ExperimentSettings(seed=5, noise=1e-3),
        periods=2,
    )
    signals, arm = session.recording, robot.load("two_link")
    table = limits.resolve(arm)
    standard = inertial_parameters.standard_parameters(arm, table)
    truth = true_parameters(session.robot, standard, table)
    model = IdentificationModel(
        arm, standard, base_parameters.find(arm, standard, table), session.robot.actuators.width
    )
    recording = Recording(
        "bench.csv",
        signals.joints,
        signals.t,
        signals.q,
        tau=signals.tau,
        sidecar=Sidecar(period=signals.period, periodic=signals.periodic),
    )
    parts = list(segments.extract_segments([recording]))
    data = estimators.estimate(regression.build_equations(model, parts, 20.0))
    prior = Prior(
        consistency.consistent_nominal(standard),
        Distance.BREGMAN,
        1.0,
        1e-6 * np.ones(standard.count - 10 * standard.bodies),
        np.diag(standard.scale)[10 * standard.bodies :],
    )
    psi = consistency.maximum_a_posteriori(
        standard,
        data.information_root @ model.base.matrix,
        data.information_root @ data.theta,
        prior,
    ).psi
    groups, share = simulation_error.cut_windows(parts, 20.0, 0.1, 12)
    return IdentifiedRobot(model, groups, share, data, prior, psi, truth)


def test_windows_agree_with_the_recording(identified):
    (windows,) = identified.groups
    assert len(windows) == 12 and 0.0 < identified.share < 1.0
    assert windows.lag[-1] == pytest.approx(0.1) and windows.q.shape[1] == len(windows.lag)
    assert np.abs(windows.states[:, :2] - windows.q[:, 0]).max() < 1e-3


def test_the_identified_model_predicts_positions_better_than_the_nominal_one(identified):
    error = simulation_error.compute_simulation_error(
        identified.model,
        identified.psi,
        identified.prior.nominal,
        identified.groups,
        identified.share,
    )
    assert (error.fitted[-1] < 2e-3).all()
    assert (error.nominal[-1] > 10.0 * error.fitted[-1]).all()
    assert (np.diff(error.nominal, axis=0) > 0.0).all()
    assert error.windows == 12 and "0.1 s ahead" in error.summary
    true_error = simulation_error.compute_simulation_error(
        identified.model, identified.truth, identified.prior.nominal, identified.groups
    )
    assert (true_error.fitted[-1] < 1.1 * error.fitted[-1] + 1e-5).all()


def test_refinement_lowers_the_cost_and_stays_near_the_equation_error_estimate(identified):
    refined = simulation_refinement.refine(
        identified.model, identified.groups, identified.psi, identified.data, identified.prior
    )
    assert all(after <= before for before, after in itertools.pairwise(refined.costs))
    assert refined.costs[-1] < refined.costs[0]
    assert consistency.is_consistent(identified.model.parameters, refined.psi)
    B = identified.model.base.matrix
    change = identified.data.information_root @ B @ (refined.psi - identified.psi)
    assert float(change @ change) < 4.0 * len(change)


def test_refinement_without_the_equation_error_recovers_the_truth_from_a_wrong_start(identified):
    wrong, parameters = identified.psi.copy(), identified.model.parameters
    wrong[parameters.block("viscous")] *= 1.5
    wrong[parameters.block("coulomb")] *= 0.6
    wrong[:20] *= 1.1
    weak = dataclasses.replace(identified.prior, inertial_weight=1e-2)
    nothing = dataclasses.replace(
        identified.data, information_root=0.0 * identified.data.information_root
    )
    refined = simulation_refinement.refine(
        identified.model, identified.groups, wrong, nothing, weak
    )
    B = identified.model.base.matrix
    before, after = (
        np.linalg.norm(identified.data.information_root @ B @ (psi - identified.truth))
        for psi in (wrong, refined.psi)
    )
    assert after < 0.1 * before and consistency.is_consistent(parameters, refined.psi)


def test_a_model_that_loses_the_recorded_motion_is_not_refined(identified):
    light = identified.psi.copy()
    light[:20] *= 1e-4
    light[identified.model.parameters.block("rotor_inertia")] *= 1e-4
    with pytest.raises(
        UnusableInput, match=r"loses the recorded motion within a window, joint 'joint_[12]' first"
    ):
        simulation_refinement.refine(
            identified.model, identified.groups, light, identified.data, identified.prior
        )


def test_recordings_shorter_than_a_window_are_refused(identified):
    assert simulation_error.cut_windows([], 20.0) == ([], 0.0)
    with pytest.raises(UnusableInput, match="record for longer"):
        simulation_error.compute_simulation_error(
            identified.model, identified.psi, identified.psi, []
        )
    with pytest.raises(UnusableInput, match="record for longer"):
        simulation_refinement.refine(
            identified.model, [], identified.psi, identified.data, identified.prior
        )
