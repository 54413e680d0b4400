from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from made import simulated

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
from excite.identification.instruments import InstrumentMotion
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording
from excite.recordings.sidecar import Sidecar
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.robot import locate

HERTZ = 20.0


@dataclasses.dataclass(frozen=True)
class Bench:
    model: IdentificationModel
    recording: Recording
    rows: regression.TorqueEquations
    truth: np.ndarray  # θ
    psi: np.ndarray  # by least squares


def bench(encoder: float, step: float) -> Bench:
    pytest.importorskip("mujoco")
    from excite.simulator import experiment
    from excite.simulator.actuator import ControllerGains

    setting = experiment.ExperimentSettings(seed=3, encoder=encoder, control=ControllerGains(step=step))
    session = experiment.simulate(
        locate("two_link"),
        Path(__file__).parents[1] / "trajectories/two_link.json",
        setting,
        periods=2,
    )
    told = session.recording
    arm = robot.load("two_link")
    table = limits.resolve(arm)
    own = inertial_parameters.standard(arm, table)
    true = simulated(session.plant, own, table)
    model = IdentificationModel(arm, own, base_parameters.find(arm, own, table), session.plant.drive.width)
    sidecar = Sidecar(period=told.period, periodic=told.periodic)
    recording = Recording(
        "bench.csv", told.joints, told.t, told.q, tau=told.tau, qref=told.qref, sidecar=sidecar
    )
    rows = regression.build_equations(model, segments.extract_segments([recording]), HERTZ)
    data = estimators.estimate(rows)
    prior = Prior(
        consistency.consistent_nominal(own),
        Distance.PULLBACK,
        1.0,
        1e-3 * np.ones(own.count - 10 * own.bodies),
        np.diag(own.scale)[10 * own.bodies :],
    )
    psi = consistency.maximum_a_posteriori(
        own, data.information_root @ model.base.matrix, data.information_root @ data.theta, prior
    ).psi
    return Bench(model, recording, rows, model.base.matrix @ true, psi)


@pytest.fixture(scope="module")
def quiet() -> Bench:
    return bench(0.0, 0.0)


@pytest.fixture(scope="module")
def coarse() -> Bench:
    return bench(2e-3, 2e-3)


def test_the_model_under_the_controller_found_moves_more_like_the_robot_than_the_reference(quiet):
    found = instruments.build_instruments(quiet.model, [quiet.recording], HERTZ, quiet.psi)
    assert found.kind is InstrumentMotion.AUXILIARY and "auxiliary" in found.words
    assert (found.strayed < 0.6 * found.behind).all()
    assert (found.law.explained > 0.999).all()
    assert (
        np.abs(found.law.forward[0] - 0.8).max() < 0.06
    )  # of the plant's controller: Control.forward
    assert (found.law.gains >= 0.0).all() and (found.law.gains[:2] > 0.0).all()


def test_instruments_pass_the_filter_and_the_periods_of_the_equations(quiet):
    same = dataclasses.replace(quiet.recording, qref=quiet.recording.q)
    found = instruments.build_instruments(quiet.model, [same], HERTZ, quiet.psi, InstrumentMotion.REFERENCE)
    assert np.array_equal(found.rows, quiet.rows.regressor)
    single = regression.build_equations(quiet.model, segments.extract_segments([same], average=False), HERTZ)
    found = instruments.build_instruments(quiet.model, [same], HERTZ, quiet.psi, InstrumentMotion.REFERENCE, average=False)
    assert np.array_equal(found.rows, single.regressor)


def test_the_regressor_as_its_own_instrument_is_least_squares(quiet):
    ls = estimators.estimate(quiet.rows)
    iv = estimators.estimate(quiet.rows, Method.IV, instruments=quiet.rows.regressor)
    assert np.allclose(iv.theta, ls.theta, rtol=1e-7)
    assert np.allclose(iv.covariance, ls.covariance, rtol=1e-5)
    test = hausman_test.durbin_wu_hausman(ls, iv, quiet.rows, quiet.rows.regressor)
    assert (
        test.freedom == 0
        and test.p == 1.0
        and not test.needed
        and test.strength == pytest.approx(1.0)
    )


def test_directions_that_the_recording_hides_stay_open(quiet):
    hidden = quiet.rows.regressor.copy()
    hidden[:, :, 3] = 0.0
    rows = dataclasses.replace(quiet.rows, regressor=hidden)
    told = instruments.build_instruments(quiet.model, [quiet.recording], HERTZ, quiet.psi, InstrumentMotion.REFERENCE)
    iv = estimators.estimate(rows, Method.IV, instruments=told.rows)
    assert np.isinf(iv.covariance[3, 3]) and len(iv.root) == len(iv.theta) - 1
    assert np.isfinite(np.delete(np.diag(iv.covariance), 3)).all()


def test_an_estimator_by_instruments_needs_some(quiet):
    with pytest.raises(UnusableInput, match="instruments"):
        estimators.estimate(quiet.rows, Method.IV)


def test_a_recording_without_reference_is_named(quiet):
    bare = dataclasses.replace(quiet.recording, qref=None)
    with pytest.raises(
        UnusableInput, match=r"bench\.csv: joint 'joint_1' has no commanded position.*qref\.joint_1"
    ):
        instruments.build_instruments(quiet.model, [bare], HERTZ, quiet.psi)
    torn = quiet.recording.qref.copy()
    torn[5, 1] = np.nan
    with pytest.raises(UnusableInput, match="joint 'joint_2' has rows without"):
        instruments.build_instruments(
            quiet.model, [dataclasses.replace(quiet.recording, qref=torn)], HERTZ, quiet.psi
        )


def test_a_model_that_loses_the_reference_is_no_silent_substitute(quiet):
    heavy = quiet.psi.copy()
    heavy[:20] *= 1000.0
    assert instruments.build_instruments(quiet.model, [quiet.recording], HERTZ, heavy).kind is InstrumentMotion.REFERENCE
    with pytest.raises(UnusableInput, match="loses qref"):
        instruments.build_instruments(quiet.model, [quiet.recording], HERTZ, heavy, InstrumentMotion.AUXILIARY)


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_p_values_are_uniform_where_positions_have_no_noise(quiet, colour):
    from scipy import signal, stats

    Z = instruments.build_instruments(quiet.model, [quiet.recording], HERTZ, quiet.psi, InstrumentMotion.REFERENCE).rows
    rng, N = np.random.default_rng(7), len(quiet.rows)
    found = []
    for _ in range(50):
        noise = signal.lfilter([1.0], [1.0, -colour], rng.normal(size=(N + 200, 2)), axis=0)[200:]
        torque = quiet.rows.predicted(quiet.truth) + noise * [0.2, 0.1]
        rows = dataclasses.replace(quiet.rows, torque=torque, periods=(0,), repeats=(None,))
        ls, iv = estimators.estimate(rows), estimators.estimate(rows, Method.IV, instruments=Z)
        test = hausman_test.durbin_wu_hausman(ls, iv, rows, Z)
        assert test.freedom >= 1
        found.append(test.p)
    assert np.mean(np.array(found) < 0.05) < 0.15
    assert stats.kstest(found, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("kind", list(InstrumentMotion))
def test_coarse_encoders_are_noticed_and_their_bias_removed(coarse, kind):
    Z = instruments.build_instruments(coarse.model, [coarse.recording], HERTZ, coarse.psi, kind).rows
    ls, iv = (
        estimators.estimate(coarse.rows),
        estimators.estimate(coarse.rows, Method.IV, instruments=Z),
    )
    test = hausman_test.durbin_wu_hausman(ls, iv, coarse.rows, Z)
    assert test.p < 1e-6 and test.needed and "take instruments" in test.words
    names = coarse.model.base.expressions
    inertias = [k for k, name in enumerate(names) if name.startswith(("Iyy", "mcx"))]
    off = [np.abs(one.theta / coarse.truth - 1.0)[inertias].max() for one in (ls, iv)]
    assert off[0] > 0.03 and off[1] < 0.4 * off[0]


def test_a_reference_that_the_controller_gets_late_is_taken_late(quiet):
    early = dataclasses.replace(quiet.recording, qref=quiet.recording.qref.copy())
    early.qref[:-10] = quiet.recording.qref[10:]
    found = instruments.build_instruments(quiet.model, [early], HERTZ, quiet.psi, InstrumentMotion.REFERENCE)
    plain = instruments.build_instruments(quiet.model, [quiet.recording], HERTZ, quiet.psi, InstrumentMotion.REFERENCE)
    assert found.delay == pytest.approx(plain.delay + 0.02, abs=1e-4)
    assert found.behind == pytest.approx(plain.behind, rel=0.02)
