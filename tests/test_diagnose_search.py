"""The search of a diagnosis against first principles: marginal likelihoods, noise floors, wind-up, and what joins the model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made import motion, perturbed, recorded, two_links
from scipy import integrate, stats
from test_diagnose import PLANTED, found, recordings_of

from excite.diagnose import diagnosis, noise, search, track, whole
from excite.diagnose.catalogue import windup
from excite.diagnose.effect import Shape, family
from excite.diagnose.track import Track
from excite.identify import identification, signals
from excite.identify.equations import Model

Array = np.ndarray


@pytest.fixture(scope="module")
def subject() -> Model:
    return two_links()


def nothing(track: Track, shape: Shape) -> Array:
    raise AssertionError("not asked for")


def test_the_gain_is_the_quotient_of_marginal_likelihoods():
    rng = np.random.default_rng(0)
    rows, p, k = (40, 30), 3, 2
    gammas, columns = [rng.normal(size=(m, p)) for m in rows], [rng.normal(size=(m, k)) for m in rows]
    torques = [g @ [1.0, -2.0, 0.5] + c @ [0.4, 0.1] + rng.normal(size=len(g)) for g, c in zip(gammas, columns, strict=True)]
    known = (1e-2 * np.eye(p), np.zeros(p))  # a proper prior, so that densities exist
    first, second = (search.half([g[:, None, :]], [t[:, None]], np.ones(1), known) for g, t in zip(gammas, torques, strict=True))
    one = search.design((first, second), [Shape("drag", 0, nothing)], lambda _: (columns[0], columns[1]), np.zeros(1), 0.0)
    gain = search.trial(one, [0]).gain

    def evidence(parts: tuple[int, ...], wide: bool) -> float:
        G = np.vstack([np.hstack([gammas[i], columns[i]]) if wide else gammas[i] for i in parts])
        y = np.concatenate([torques[i] for i in parts])
        variance = np.concatenate([np.full(p, 1e4), 1.0 / one.prior if wide else []])
        return float(stats.multivariate_normal(np.zeros(len(y)), np.eye(len(y)) + G @ np.diag(variance) @ G.T).logpdf(y))

    def predictive(wide: bool) -> float:
        return 2.0 * evidence((0, 1), wide) - evidence((0,), wide) - evidence((1,), wide)

    assert gain == pytest.approx(predictive(True) - predictive(False), abs=1e-6)
    assert search.trial(one, []).gain == 0.0


def test_a_grid_is_left_for_the_value_between_its_neighbours():
    rng = np.random.default_rng(1)
    x = np.linspace(0.0, 1.0, 400)
    halves = [search.half([np.ones((400, 1, 1))], [5.0 * x[:, None] ** 1.7 + 0.1 * rng.normal(size=(400, 1))], np.full(1, 0.1), EMPTY)] * 2

    def build(shape: Shape) -> tuple[Array, Array]:
        column = x[:, None] ** shape.values["power"] / 0.1
        return column, column

    shapes = list(family((1.0, 1.4, 2.0, 2.8), lambda power: Shape("drag", 0, nothing, {"power": power})))
    one = search.design((halves[0], halves[1]), shapes, build, np.zeros(1), 0.0)
    coarse = max(range(4), key=lambda i: search.trial(one, [i]).gain)
    finer, (best,) = search.refined(one, [coarse])
    assert finer.shapes[best].values["power"] == pytest.approx(1.7, abs=0.05)
    assert search.trial(finer, [best]).gain > search.trial(one, [coarse]).gain


EMPTY = (np.zeros((0, 1)), np.zeros(0))


def measured(subject: Model, change: float = 0.0, step: float = 0.0) -> tuple[Array, Array]:
    """Noise found and the RMS that the base model leaves, of a periodic recording whose torque noise is known to be 0.1 N m."""
    psi = perturbed(subject.parameters, np.random.default_rng(4))
    recording = recorded(subject, psi, motion(2, 1), 3.0, 0.1)
    q = recording.q + change * np.random.default_rng(7).normal(size=recording.q.shape)
    recording = dataclasses.replace(recording, q=np.round(q / step) * step if step else q)
    done = identification.identify(
        subject.robot, subject.parameters, subject.base, [recording], [recording], identification.Options(band=20.0), lambda _: None
    )
    theta = subject.base.matrix @ done.psi
    body = track.body(subject.robot, subject.parameters, done.psi)
    tracks = track.tracks(done.model, body, theta, list(signals.pieces([recording], average=False)), 20.0)
    left = np.concatenate([t.torque - t.gamma @ theta for t in tracks])
    return noise.measured(done, (tracks,), [recording]).floor, np.sqrt(np.mean(left**2, axis=0))


@pytest.mark.parametrize(("change", "step", "low", "high"), [(0.0, 0.0, 0.85, 1.15), (2e-5, 0.0, 0.85, 1.15), (0.0, 1e-4, 0.6, 1.7)])
def test_the_floor_is_what_a_right_model_leaves_whatever_is_noisy(subject, change, step, low, high):
    floor, left = measured(subject, change, step)
    assert (low < left / floor).all() and (left / floor < high).all(), left / floor


def test_a_period_is_found_where_nobody_states_it(subject):
    psi = perturbed(subject.parameters, np.random.default_rng(4))
    stated = recorded(subject, psi, motion(2, 1), 3.0, 0.1)
    assert stated.sidecar.period is not None
    silent = dataclasses.replace(stated, sidecar=dataclasses.replace(stated.sidecar, period=None, periodic=None))
    found_period = noise._period(silent)
    assert found_period is not None and found_period[0] == pytest.approx(stated.sidecar.period, abs=2e-3)
    once = recorded(subject, psi, motion(2, 1, 9.0), 1.0, 0.1, period=None, periodic=None)
    assert noise._period(once) is None


def test_wind_up_is_that_of_the_differential_equation():
    dt, K = 1e-3, 400.0
    t = np.arange(2000) * dt
    force, inertia = np.sin(9.0 * t) + 0.4 * np.sin(31.0 * t), 0.5 + 0.1 * np.sin(2.0 * t)
    place, _ = windup.oscillator(force, inertia, K, 0.07, dt)

    def slope(at: float, state: Array) -> Array:
        f, m = np.interp(at, t, force), np.interp(at, t, inertia)
        return np.array([state[1], (f - K * state[0] - 2.0 * 0.07 * np.sqrt(K * m) * state[1]) / m])

    exact = integrate.solve_ivp(slope, (0.0, t[-1]), [force[0] / K, 0.0], t_eval=t, rtol=1e-8, atol=1e-12).y[0]
    assert np.abs(place - exact).max() < 0.02 * np.abs(exact).max()


def test_what_was_found_is_predicted_and_gone_from_the_recording(subject):
    result = found(subject, PLANTED["stribeck"][0])
    assert result.parts and result.refitted is not None
    _, validate = recordings_of(subject, PLANTED["stribeck"][0])
    bare = whole.removed(result.parts, validate, result.tracks[1])
    _, clean = recordings_of(subject, None)
    one = result.tracks[1][0]
    apart = one.band.low(bare.torque - clean.torque, track.Grid.KEPT)[one.kept]
    hidden = one.band.low(validate.torque - clean.torque, track.Grid.KEPT)[one.kept]
    assert np.sqrt(np.mean(apart**2)) < 0.25 * np.sqrt(np.mean(hidden**2))
    again = [whole.restored(whole.entry(part, subject.robot), subject.robot, "model.json") for part in result.parts]
    np.testing.assert_allclose(whole.torque(again, one), whole.torque(result.parts, one))
    before, after = result.ahead
    assert before is not None and after is not None and after.fitted[-1].sum() < before.fitted[-1].sum()


def test_options_name_what_is_looked_for(subject):
    train, validate = recordings_of(subject, None)
    done = diagnosis.diagnose(subject.robot, subject.parameters, subject.base, [train], [validate], diagnosis.Options(names=("drag",)))
    assert {shape.effect for shape in done.design.shapes} == {"drag"}
