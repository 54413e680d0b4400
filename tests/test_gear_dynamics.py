"""What winds up behind a motor: springs and play, against the differential equation."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import accumulate

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate
from scipy.interpolate import CubicSpline
from synthetic_recordings import perturbed_parameters, pinocchio_model
from test_diagnosis import found

from excite.diagnosis import interval
from excite.effects import EFFECTS_BY_NAME, gear_dynamics, hysteresis
from excite.effects.recorded_motion import Grid

Array = np.ndarray


def test_wind_up_is_that_of_the_differential_equation():
    """At the rate at which dynamics are evaluated, with a link that hung still while its motor
    turned."""
    dt, start = 8e-3, (0.01, -0.3)
    t = np.arange(500) * dt
    force, inertia = np.sin(9.0 * t) + 0.4 * np.sin(31.0 * t), 0.5 + 0.1 * np.sin(2.0 * t)
    stiffness, damping = 400.0 + 30.0 * np.cos(3.0 * t), 1.5 + np.sin(5.0 * t)
    place, speed = gear_dynamics.simulate_oscillator(force, inertia, stiffness, damping, dt, start)

    def slope(at: float, state: Array) -> Array:
        f, m, k, d = (np.interp(at, t, x) for x in (force, inertia, stiffness, damping))
        return np.array([state[1], (f - k * state[0] - d * state[1]) / m])

    exact = integrate.solve_ivp(slope, (0.0, t[-1]), start, t_eval=t, rtol=1e-8, atol=1e-12).y
    assert np.abs(place - exact[0]).max() < 0.008 * np.abs(exact[0]).max()
    assert np.abs(speed - exact[1]).max() < 0.008 * np.abs(exact[1]).max()


def step_by_step(push: Array, dt: float, half: float, omega: float) -> Array:
    x, v, places = half if push[0] > 0.0 else -half, 0.0, []
    for a in push.tolist():
        v += (a - omega**2 * x - 2.0 * gear_dynamics.GAP_DAMPING_RATIO * omega * v) * dt
        x += v * dt
        if abs(x) > half:
            x, v = float(np.copysign(half, x)), 0.0
        places.append(x)
    return np.array(places)


@given(
    st.integers(0, 2**31),
    st.sampled_from([0.0, 1.5, 6.0, 20.0]),
    st.floats(1e-5, 3e-3),
    st.sampled_from([1, 1500]),
)
def test_a_link_goes_from_flank_to_flank_as_it_does_step_by_step(seed, hold, half, count):
    dt, omega = 4e-3, 2.0 * np.pi * hold
    t, rng = dt * np.arange(count), np.random.default_rng(seed)
    push = sum(
        a * np.sin(w * t + p) for a, w, p in rng.uniform([0.0, 0.5, 0.0], [8.0, 30.0, 6.0], (4, 3))
    )
    assert gear_dynamics.simulate_backlash_gap(push, dt, half, omega) == pytest.approx(
        step_by_step(push, dt, half, omega), abs=1e-5 * half
    )


@pytest.mark.parametrize("dt", [1e-3, 2.5e-2])
def test_a_link_in_its_play_goes_on_for_minutes_and_where_samples_hardly_follow_it(dt):
    t, omega = dt * np.arange(100_000), 2.0 * np.pi * (0.0 if dt < 1e-2 else 20.0)
    push = 30.0 + 45.0 * np.sin(3.0 * t)
    assert gear_dynamics.simulate_backlash_gap(push, dt, 5e-5, omega) == pytest.approx(
        step_by_step(push, dt, 5e-5, omega), abs=1e-9
    )


def swung(
    bodies: pin.Model, stiffness: float, damping: float, t: Array, q: Array, still: bool
) -> tuple[Array, Array]:
    """Wind-up of the second of two links on a spring behind its motor, by rnea where the link is,
    and what both joints feel of it.

    still: whether it hung still when its motor began; else it came along.
    """
    data, zero, e = bodies.createData(), np.zeros(2), np.array([0.0, 1.0])
    place = CubicSpline(t, q)
    speed, haste = place.derivative(), place.derivative(2)
    mass = float(pin.crba(bodies, data, zero)[1, 1])  # the last link's own, in any pose

    def slope(at: float, state: Array) -> Array:
        load = pin.rnea(
            bodies, data, place(at) - e * state[0], speed(at) - e * state[1], haste(at)
        )[1]
        return np.array([state[1], (load - stiffness * state[0] - damping * state[1]) / mass])

    began = (zero, zero) if still else (speed(t[0]), haste(t[0]))
    start = [
        pin.rnea(bodies, data, q[0], *began)[1] / stiffness,
        float(speed(t[0])[1]) if still else 0.0,
    ]
    lag = integrate.solve_ivp(slope, (t[0], t[-1]), start, t_eval=t, rtol=1e-7, atol=1e-10).y.T
    felt = np.empty_like(q)
    for k, state in enumerate(lag):
        link = pin.rnea(
            bodies,
            data,
            q[k] - e * state[0],
            speed(t[k]) - e * state[1],
            haste(t[k]) - e * slope(t[k], state)[1],
        )
        felt[k] = link - pin.rnea(bodies, data, q[k], speed(t[k]), haste(t[k]))
    return lag[:, 0], felt


@pytest.mark.parametrize("stiffness", [50.0, 60.0, 72.0])
def test_a_link_on_a_spring_that_is_hardly_damped_is_found_between_any_that_are_tried(
    subject, stiffness
):
    bodies = pinocchio_model(
        subject, perturbed_parameters(subject.parameters, np.random.default_rng(4))
    )
    result = found(subject, lambda t, q, dq, tau: swung(bodies, stiffness, 0.05, t, q, False)[1])
    assert [(h.effect, h.joint) for h in result.verdict.chosen] == [("elasticity", 1)]
    told, _ = interval.finding_parameters(result.design, result.verdict, 0)["stiffness"]
    assert told == pytest.approx(stiffness, rel=0.05)
    assert result.verdict.findings[0].evidence["left"] < 0.25


@pytest.mark.parametrize("over", [0.75, 0.9, 1.3])
def test_a_spring_that_swings_beyond_the_band_is_told_where_its_coefficient_is_one(subject, over):
    """A softer one with a lesser coefficient looks the same where what shakes the link is near its
    resonance."""
    calm = found(subject, None).motions[0][0]
    t, q = calm.times, calm.segment.q
    shaken = dataclasses.replace(
        calm,
        segment=dataclasses.replace(
            calm.segment, q=q + 0.002 * np.sin(2.0 * np.pi * 11.0 * t)[:, None]
        ),
    )
    for track, least in ((calm, 0.0), (shaken, 0.02)):
        knob = next(
            s
            for s in EFFECTS_BY_NAME["elasticity"].candidates([track])
            if s.joint == 1 and not s.values["rests"]
        ).nonlinear
        stiffness = (
            float(gear_dynamics.link_inertia(track, 1).mean())
            * (2.0 * np.pi * 1.3 * track.band.hertz) ** 2
        )
        true, other = knob.at(stiffness), knob.at(over * stiffness)
        (c,) = np.linalg.lstsq(
            other.columns(track).reshape(-1, 1), true.columns(track).ravel(), rcond=None
        )[0]
        assert other.parameters(np.array([c]))["stiffness"] == pytest.approx(stiffness, rel=0.005)
        assert other.is_plausible(np.array([c]))
        assert abs(over / c - 1.0) >= least  # as it would be without inertia


@pytest.mark.parametrize("rests", [False, True])
def test_a_link_winds_up_from_where_it_was_when_its_motor_began(subject, rests):
    track = found(subject, None).motions[1][0]
    assert gear_dynamics.starts_in_motion(track, 1)  # slowly: its link may hang still or come along
    t, K, ratio = np.arange(len(track.coarse_samples)) / track.band.rate_of(Grid.COARSE), 60.0, 0.02
    damping = 2.0 * ratio * float(np.sqrt(K * gear_dynamics.link_inertia(track, 1).mean()))
    exact = swung(track.fitted_robot.model, K, damping, t, track.coarse_samples.q, rests)[0]
    told, other = (
        gear_dynamics.elastic_deflection(track, 1, K, ratio, which) for which in (rests, not rests)
    )
    second = slice(0, 120)
    assert (
        np.abs(told - exact)[second].max()
        < 0.03 * np.abs(exact).max()
        < np.abs(other - exact)[second].max()
    )


def test_play_whose_load_never_turns_is_none(subject):
    every = [one for half in found(subject, None).motions for one in half]
    assert {shape.joint for shape in EFFECTS_BY_NAME["backlash"].candidates(every)} == {0, 1}
    pressed = [dataclasses.replace(one) for one in every]
    for one in pressed:
        one.__dict__["rigid_torque"] = one.rigid_torque + np.array([1e4, 0.0])
    assert {shape.joint for shape in EFFECTS_BY_NAME["backlash"].candidates(pressed)} == {1}


def _step_by_step(q: Array, step: Callable[[float, float], float]) -> Array:
    """Force after each step of a motion, of the force before it and the step."""
    return np.array(list(accumulate(np.diff(q, prepend=q[0]).tolist(), step, initial=0.0))[1:])


@given(st.lists(st.integers(-9, 9), min_size=2, max_size=60), st.floats(0.3, 30.0))
def test_friction_with_memory_from_reversal_to_reversal_is_what_it_is_step_by_step(places, reach):
    """Whatever a joint does: it may rest, begin either way, turn at once or step from end to
    end."""
    q = np.array(places, float)
    slipped = _step_by_step(q, lambda z, step: min(max(z + step / reach, -1.0), 1.0))
    np.testing.assert_allclose(hysteresis.maxwell_slip(q, reach), slipped, atol=1e-12)
    bent = _step_by_step(
        q,
        lambda z, step: (
            np.sign(step) + (z - np.sign(step)) * np.exp(-abs(step) / reach) if step else z
        ),
    )
    np.testing.assert_allclose(hysteresis.dahl(q, 1.0 / reach), bent, atol=1e-12)
