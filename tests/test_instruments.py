"""Instruments from a simulated robot under its controllers, and the Hausman test."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from synthetic_recordings import true_parameters

from excite._types import FloatArray
from excite.errors import UnusableInput
from excite.identification import (
    consistency,
    estimators,
    hausman_test,
    instruments,
    regression,
    segments,
)
from excite.identification.consistency import Prior
from excite.identification.estimators import Method
from excite.identification.inertia_distance import Distance
from excite.identification.instruments import InstrumentMotion, Instruments
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording
from excite.recordings.sidecar import Sidecar
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.robot import locate

HERTZ = 20.0


@dataclasses.dataclass(frozen=True)
class SimulatedExperiment:
    """A simulated two-link robot. truth: θ. psi: ψ̂ by least squares."""

    model: IdentificationModel
    recording: Recording
    equations: regression.TorqueEquations
    truth: FloatArray
    psi: FloatArray

    def instruments(
        self,
        motion: InstrumentMotion | None = None,
        *,
        recording: Recording | None = None,
        psi: FloatArray | None = None,
        average: bool = True,
    ) -> Instruments:
        return instruments.build_instruments(
            self.model,
            [self.recording if recording is None else recording],
            HERTZ,
            self.psi if psi is None else psi,
            motion,
            average=average,
        )


def simulate(encoder: float, step: float) -> SimulatedExperiment:
    """Simulate with an encoder step of the recording and of the controller [rad]."""
    pytest.importorskip("mujoco")
    from excite.simulator import experiment
    from excite.simulator.actuator import ControllerGains

    settings = experiment.ExperimentSettings(
        seed=3, encoder=encoder, control=ControllerGains(step=step)
    )
    session = experiment.simulate(
        locate("two_link"),
        Path(__file__).parents[1] / "trajectories/two_link.json",
        settings,
        periods=2,
    )
    signals, arm = session.recording, robot.load("two_link")
    table = limits.resolve(arm)
    standard = inertial_parameters.standard_parameters(arm, table)
    true_psi = true_parameters(session.robot, standard, table)
    model = IdentificationModel(
        arm, standard, base_parameters.find(arm, standard, table), session.robot.actuators.width
    )
    recording = Recording(
        "bench.csv",
        signals.joints,
        signals.t,
        signals.q,
        tau=signals.tau,
        qref=signals.qref,
        sidecar=Sidecar(period=signals.period, periodic=signals.periodic),
    )
    equations = regression.build_equations(model, segments.extract_segments([recording]), HERTZ)
    data = estimators.estimate(equations)
    prior = Prior(
        consistency.consistent_nominal(standard),
        Distance.PULLBACK,
        1.0,
        1e-3 * np.ones(standard.count - 10 * standard.bodies),
        np.diag(standard.scale)[10 * standard.bodies :],
    )
    psi = consistency.maximum_a_posteriori(
        standard,
        data.information_root @ model.base.matrix,
        data.information_root @ data.theta,
        prior,
    ).psi
    return SimulatedExperiment(model, recording, equations, model.base.matrix @ true_psi, psi)


@pytest.fixture(scope="module")
def exact() -> SimulatedExperiment:
    """Positions are recorded without quantization."""
    return simulate(0.0, 0.0)


@pytest.fixture(scope="module")
def coarse() -> SimulatedExperiment:
    """Positions are quantized to 2 mrad, for the controller too."""
    return simulate(2e-3, 2e-3)


def test_the_auxiliary_model_is_closer_to_the_recorded_motion_than_the_reference(exact):
    built = exact.instruments()
    assert built.motion is InstrumentMotion.AUXILIARY and "auxiliary" in built.summary
    assert (built.auxiliary_distance < 0.6 * built.reference_distance).all()


def test_the_controllers_are_identified(exact):
    controller = exact.instruments().controller
    assert (controller.explained > 0.999).all()
    assert np.abs(controller.forward[0] - 0.8).max() < 0.06  # the simulated share of feed-forward
    assert (controller.gains >= 0.0).all() and (controller.gains[:2] > 0.0).all()


def test_instruments_have_the_filter_and_the_periods_of_the_equations(exact):
    reference_is_motion = dataclasses.replace(exact.recording, qref=exact.recording.q)
    built = exact.instruments(InstrumentMotion.REFERENCE, recording=reference_is_motion)
    assert np.array_equal(built.rows, exact.equations.regressor)
    unaveraged = regression.build_equations(
        exact.model, segments.extract_segments([reference_is_motion], average=False), HERTZ
    )
    built = exact.instruments(
        InstrumentMotion.REFERENCE, recording=reference_is_motion, average=False
    )
    assert np.array_equal(built.rows, unaveraged.regressor)


def test_the_regressor_as_its_own_instrument_gives_least_squares(exact):
    ls = estimators.estimate(exact.equations)
    iv = estimators.estimate(exact.equations, Method.IV, instruments=exact.equations.regressor)
    assert np.allclose(iv.theta, ls.theta, rtol=1e-7)
    assert np.allclose(iv.covariance, ls.covariance, rtol=1e-5)
    test = hausman_test.durbin_wu_hausman(ls, iv, exact.equations, exact.equations.regressor)
    assert test.degrees_of_freedom == 0 and test.p_value == 1.0 and not test.needs_instruments
    assert test.strength == pytest.approx(1.0)


def test_directions_that_are_not_excited_have_infinite_variance(exact):
    regressor = exact.equations.regressor.copy()
    regressor[:, :, 3] = 0.0
    equations = dataclasses.replace(exact.equations, regressor=regressor)
    Z = exact.instruments(InstrumentMotion.REFERENCE).rows
    iv = estimators.estimate(equations, Method.IV, instruments=Z)
    assert np.isinf(iv.covariance[3, 3]) and len(iv.information_root) == len(iv.theta) - 1
    assert np.isfinite(np.delete(np.diag(iv.covariance), 3)).all()


def test_the_instrumental_estimator_without_instruments_is_refused(exact):
    with pytest.raises(UnusableInput, match="instruments"):
        estimators.estimate(exact.equations, Method.IV)


def test_a_missing_reference_is_refused_with_file_and_joint(exact):
    without_reference = dataclasses.replace(exact.recording, qref=None)
    with pytest.raises(
        UnusableInput, match=r"bench\.csv: joint 'joint_1' has no commanded position.*qref\.joint_1"
    ):
        exact.instruments(recording=without_reference)
    incomplete = exact.recording.qref.copy()
    incomplete[5, 1] = np.nan
    with pytest.raises(UnusableInput, match="joint 'joint_2' lacks the commanded position"):
        exact.instruments(recording=dataclasses.replace(exact.recording, qref=incomplete))


def test_an_auxiliary_model_that_loses_the_reference_is_not_used(exact):
    heavy = exact.psi.copy()
    heavy[:20] *= 1000.0
    assert exact.instruments(psi=heavy).motion is InstrumentMotion.REFERENCE
    with pytest.raises(UnusableInput, match="loses qref"):
        exact.instruments(InstrumentMotion.AUXILIARY, psi=heavy)


@pytest.mark.parametrize("pole", [0.0, 0.8])
def test_p_values_are_uniform_without_position_noise(exact, pole):
    from scipy import signal, stats

    Z = exact.instruments(InstrumentMotion.REFERENCE).rows
    rng, rows = np.random.default_rng(7), len(exact.equations)
    p_values = []
    for _ in range(50):
        noise = signal.lfilter([1.0], [1.0, -pole], rng.normal(size=(rows + 200, 2)), axis=0)[200:]
        torque = exact.equations.predicted(exact.truth) + noise * [0.2, 0.1]
        equations = dataclasses.replace(
            exact.equations, torque=torque, periods=(0,), repeats=(None,)
        )
        ls = estimators.estimate(equations)
        iv = estimators.estimate(equations, Method.IV, instruments=Z)
        test = hausman_test.durbin_wu_hausman(ls, iv, equations, Z)
        assert test.degrees_of_freedom >= 1
        p_values.append(test.p_value)
    assert np.mean(np.array(p_values) < 0.05) < 0.15
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("motion", list(InstrumentMotion))
def test_the_bias_due_to_coarse_encoders_is_detected_and_removed(coarse, motion):
    Z = coarse.instruments(motion).rows
    ls = estimators.estimate(coarse.equations)
    iv = estimators.estimate(coarse.equations, Method.IV, instruments=Z)
    test = hausman_test.durbin_wu_hausman(ls, iv, coarse.equations, Z)
    assert test.p_value < 1e-6 and test.needs_instruments
    assert "use --estimator iv" in test.summary
    names = coarse.model.base.expressions
    inertias = [k for k, name in enumerate(names) if name.startswith(("Iyy", "mcx"))]
    ls_error, iv_error = (
        np.abs(estimate.theta / coarse.truth - 1.0)[inertias].max() for estimate in (ls, iv)
    )
    assert ls_error > 0.03 and iv_error < 0.4 * ls_error


def test_a_delay_of_the_reference_is_estimated(exact):
    early = dataclasses.replace(exact.recording, qref=exact.recording.qref.copy())
    early.qref[:-10] = exact.recording.qref[10:]
    delayed = exact.instruments(InstrumentMotion.REFERENCE, recording=early)
    original = exact.instruments(InstrumentMotion.REFERENCE)
    assert delayed.delay == pytest.approx(original.delay + 0.02, abs=1e-4)
    assert delayed.reference_distance == pytest.approx(original.reference_distance, rel=0.02)
