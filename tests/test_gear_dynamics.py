"""Elastic gears and backlash, against integration of the differential equations."""

from __future__ import annotations

import dataclasses
from itertools import accumulate

import numpy as np
import pytest
from diagnosis_cases import motions, simulate_elastic_gear
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from excite._types import FloatArray
from excite.effects import EFFECTS_BY_NAME, gear_dynamics, hysteresis
from excite.effects.recorded_motion import Grid


def test_elastic_deflection_agrees_with_an_integrator():
    """At the sampling rate of the dynamics, with a link at rest while its motor moves."""
    dt, start = 8e-3, (0.01, -0.3)
    t = np.arange(500) * dt
    force, inertia = np.sin(9.0 * t) + 0.4 * np.sin(31.0 * t), 0.5 + 0.1 * np.sin(2.0 * t)
    stiffness, damping = 400.0 + 30.0 * np.cos(3.0 * t), 1.5 + np.sin(5.0 * t)
    position, velocity = gear_dynamics.simulate_oscillator(
        force, inertia, stiffness, damping, dt, start
    )

    def derivative(time: float, state: FloatArray) -> FloatArray:
        f, m, k, d = (np.interp(time, t, x) for x in (force, inertia, stiffness, damping))
        return np.array([state[1], (f - k * state[0] - d * state[1]) / m])

    exact = integrate.solve_ivp(derivative, (0.0, t[-1]), start, t_eval=t, rtol=1e-8, atol=1e-12).y
    assert np.abs(position - exact[0]).max() < 0.008 * np.abs(exact[0]).max()
    assert np.abs(velocity - exact[1]).max() < 0.008 * np.abs(exact[1]).max()


def gap_motion_step_by_step(
    acceleration: FloatArray, dt: float, half_gap: float, omega: float
) -> FloatArray:
    x, v, places = half_gap if acceleration[0] > 0.0 else -half_gap, 0.0, []
    for a in acceleration.tolist():
        v += (a - omega**2 * x - 2.0 * gear_dynamics.GAP_DAMPING_RATIO * omega * v) * dt
        x += v * dt
        if abs(x) > half_gap:
            x, v = float(np.copysign(half_gap, x)), 0.0
        places.append(x)
    return np.array(places)


@given(
    st.integers(0, 2**31),
    st.sampled_from([0.0, 1.5, 6.0, 20.0]),
    st.floats(1e-5, 3e-3),
    st.sampled_from([1, 1500]),
)
def test_motion_in_a_backlash_gap_agrees_with_a_simulation_step_by_step(
    seed, hold, half_gap, count
):
    dt, omega = 4e-3, 2.0 * np.pi * hold
    t, rng = dt * np.arange(count), np.random.default_rng(seed)
    acceleration = sum(
        a * np.sin(w * t + p) for a, w, p in rng.uniform([0.0, 0.5, 0.0], [8.0, 30.0, 6.0], (4, 3))
    )
    assert gear_dynamics.simulate_backlash_gap(acceleration, dt, half_gap, omega) == pytest.approx(
        gap_motion_step_by_step(acceleration, dt, half_gap, omega), abs=1e-5 * half_gap
    )


@pytest.mark.parametrize("dt", [1e-3, 2.5e-2])
def test_motion_in_a_backlash_gap_for_long_recordings_and_low_rates(dt):
    t, omega = dt * np.arange(100_000), 2.0 * np.pi * (0.0 if dt < 1e-2 else 20.0)
    acceleration = 30.0 + 45.0 * np.sin(3.0 * t)
    assert gear_dynamics.simulate_backlash_gap(acceleration, dt, 5e-5, omega) == pytest.approx(
        gap_motion_step_by_step(acceleration, dt, 5e-5, omega), abs=1e-9
    )


@pytest.mark.parametrize("over", [0.75, 0.9, 1.3])
def test_a_stiffness_with_a_resonance_above_the_cutoff_is_corrected_by_its_coefficient(
    over,
):
    """A softer gear with a smaller coefficient looks the same for an excitation near resonance."""
    motion = motions()[0]
    t, q = motion.times, motion.segment.q
    excited = dataclasses.replace(
        motion,
        segment=dataclasses.replace(
            motion.segment, q=q + 0.002 * np.sin(2.0 * np.pi * 11.0 * t)[:, None]
        ),
    )
    for recorded, min_correction in ((motion, 0.0), (excited, 0.02)):
        parameter = next(
            s
            for s in EFFECTS_BY_NAME["elasticity"].candidates([recorded])
            if s.joint == 1 and not s.values["rests"]
        ).nonlinear
        stiffness = (
            float(recorded.link_inertias[:, 1].mean())
            * (2.0 * np.pi * 1.3 * recorded.band.hertz) ** 2
        )
        exact, other = parameter.at(stiffness), parameter.at(over * stiffness)
        (c,) = np.linalg.lstsq(
            other.columns(recorded).reshape(-1, 1), exact.columns(recorded).ravel(), rcond=None
        )[0]
        estimate = other.parameters(np.array([c]), recorded.fitted_robot)
        assert estimate["stiffness"] == pytest.approx(stiffness, rel=0.005)
        assert other.is_plausible(np.array([c]))
        assert abs(over / c - 1.0) >= min_correction  # as without inertia


@pytest.mark.parametrize("rests", [False, True])
def test_the_initial_state_of_an_elastic_gear(rests):
    motion = motions()[-1]
    assert gear_dynamics.starts_in_motion(motion, 1)  # slowly: the link may be at rest or move
    t, K, ratio = (
        np.arange(len(motion.coarse_samples)) / motion.band.rate_of(Grid.COARSE),
        60.0,
        0.02,
    )
    damping = 2.0 * ratio * float(np.sqrt(K * motion.link_inertias[:, 1].mean()))
    exact = simulate_elastic_gear(K, damping, t, motion.coarse_samples.q, rests)[0]
    matching, other = (
        gear_dynamics.elastic_deflection(motion, 1, K, ratio, which) for which in (rests, not rests)
    )
    second = slice(0, 120)
    assert (
        np.abs(matching - exact)[second].max()
        < 0.03 * np.abs(exact).max()
        < np.abs(other - exact)[second].max()
    )


def test_backlash_needs_a_load_that_changes_sign():
    assert {shape.joint for shape in EFFECTS_BY_NAME["backlash"].candidates(motions())} == {0, 1}
    preloaded = [dataclasses.replace(motion) for motion in motions()]
    for motion in preloaded:
        motion.__dict__["rigid_torque"] = motion.rigid_torque + np.array([1e4, 0.0])
    assert {shape.joint for shape in EFFECTS_BY_NAME["backlash"].candidates(preloaded)} == {1}


@given(st.lists(st.integers(-9, 9), min_size=2, max_size=60), st.floats(0.3, 30.0))
def test_maxwell_slip_agrees_with_a_simulation_step_by_step(places, reach):
    """For any sequence of positions, with rests, reversals and large steps."""
    q = np.array(places, float)
    steps = (np.diff(q, prepend=q[0]) / reach).tolist()
    slipped = list(accumulate(steps, lambda z, step: min(max(z + step, -1.0), 1.0), initial=0.0))
    np.testing.assert_allclose(hysteresis.maxwell_slip(q, reach), slipped[1:], atol=1e-12)
