"""Symbolic columns of effects: against the catalogue's numerical columns, and their gradients."""

from __future__ import annotations

from functools import cache
from itertools import accumulate

import numpy as np
import pytest

from excite._types import FloatArray
from excite.designer import casadi_model
from excite.designer.casadi_batch import MappedFunction
from excite.designer.design_objective import SampledMotion
from excite.designer.effect_columns import (
    SYMBOLIC_EFFECTS,
    EffectColumns,
    RobotConstants,
    SymbolicEffect,
)
from excite.designer.presliding import presliding_state
from excite.effects import EFFECTS_BY_NAME
from excite.effects.effect import CandidateModel, single_joint_columns
from excite.effects.recorded_motion import FittedRobot, RecordedMotion
from excite.identification.lowpass import Grid
from excite.identification.segments import RecordingSegment
from excite.robot import inertial_parameters
from excite.robot.dynamics import regressor
from excite.robot.limits import resolve
from excite.robot.robot import load
from excite.trajectory.fourier import FourierSeries

PERIOD = 10.0
JOINT = 1
BAND = 20.0
"""Cutoff frequency of the numerical columns [Hz]."""
RATE = 500.0
"""Samples per second of the recorded motion [Hz]."""
WIDTH = 0.05
"""Width of Coulomb friction [rad/s]."""


def effect(name: str, joint: int | None = JOINT, other: int | None = None, **values: float):
    return SymbolicEffect(name, joint, values, other)


EFFECTS = (
    effect("rotor_inertia"),
    effect("torque_offset"),
    effect("friction"),
    effect("asymmetric_viscous"),
    effect("stribeck", velocity=0.1, exponent=1.0),
    effect("stribeck", velocity=0.1, exponent=2.0),
    effect("nonlinear_viscous", exponent=0.5),
    effect("nonlinear_viscous", exponent=3.0),
    effect("drag"),
    effect("load_friction", power=1.0, scale=100.0),
    effect("load_friction", power=2.0, scale=100.0),
    effect("position_friction", order=1.0, waves=2.0, low=-2.0, high=2.0),
    effect("spring", form=0.0),
    effect("spring", form=1.0),
    effect("spring", waves=4.0, low=-2.0, high=2.0),
    effect("torque_ripple", order=4.0),
    effect("torque_gain"),
    effect("torque_saturation", power=3.0, largest=200.0),
    effect("hysteresis", reach=0.02),
    effect("thermal_drift", time_constant=8.0, coulomb=4.0, viscous=5.0),
    effect("coupling", other=2, ratio=0.5),
    effect("delay", measured=1.0),
    effect("delay", None, measured=1.0),
    effect("elasticity", stiffness=3e4, damping=0.07, rests=0.0),
    effect("encoder_error", order=2.0),
    effect("gravity_tilt", None, large=0.0),
    effect("payload", 5, link=5.0, count=10.0),
)
IDS = [f"{number}-{e.effect}" for number, e in enumerate(EFFECTS)]


@cache
def constants() -> RobotConstants:
    robot = load("ur10e")
    limits = resolve(robot)
    standard = inertial_parameters.standard_parameters(robot, limits, inertial_parameters.DRIVE)
    psi = standard.nominal.copy()
    for kind, value in {
        "rotor_inertia": 1.0,
        "viscous": 5.0,
        "coulomb": 4.0,
        "offset": 1.0,
    }.items():
        psi[standard.block(kind)] = value
    return RobotConstants(robot, standard, psi, np.full(robot.n, WIDTH), limits)


@cache
def motion() -> FourierSeries:
    rng, n = np.random.default_rng(0), constants().robot.n
    sine, cosine = (0.25 * rng.normal(size=(n, 3)) for _ in range(2))
    return FourierSeries(sine, cosine, 0.3 * rng.normal(size=n), PERIOD)


def sampled(series: FourierSeries, count: int) -> SampledMotion:
    c, s = constants(), series.samples(series.grid(count))
    return SampledMotion(s.q, s.dq, s.ddq, regressor(c.robot, c.parameters, s), PERIOD)


@cache
def recorded() -> RecordedMotion:
    """Return three periods as the catalogue's effects see them."""
    c, t = constants(), np.arange(round(3 * PERIOD * RATE)) / RATE
    n = c.robot.n
    segment = RecordingSegment(
        "test",
        0.0,
        RATE,
        motion().at(t),
        np.zeros((len(t), n)),
        encoder=np.full(n, 1e-9),
        recording_start=0.0,
    )
    robot = FittedRobot(c.robot, c.parameters, c.psi)
    out = RecordedMotion(segment, segment.band(BAND), robot, c.widths)
    return out.with_modelled_torque(out.motor_torque)


def dahl(q: FloatArray, reach: float) -> FloatArray:
    """Return the state z of Dahl's model, ż = q̇ (1 − z sgn q̇)/reach (Dahl 1968)."""
    steps = np.diff(q, prepend=q[0])
    known = zip(np.sign(steps).tolist(), np.exp(-np.abs(steps) / reach).tolist(), strict=True)
    states = accumulate(known, lambda z, step: step[0] + (z - step[0]) * step[1], initial=0.0)
    return np.array(list(states)[1:])


def single_curve(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the column of an effect of which the catalogue has a sum of several curves."""
    v, j = model.values, JOINT
    speed, load = np.abs(motion.samples.dq[:, j]), np.abs(motion.transmitted_torque[:, j])
    if model.effect == "torque_ripple":
        angle = v["order"] * motion.samples.q[:, j]
        return single_joint_columns(motion, j, np.column_stack([np.cos(angle), np.sin(angle)]))
    if model.effect == "hysteresis":
        return single_joint_columns(
            motion, j, dahl(motion.samples.q[:, j], v["reach"]) - motion.sign(j)
        )
    curves = {
        "stribeck": lambda: np.exp(-((speed / v["velocity"]) ** v["exponent"])),
        "nonlinear_viscous": lambda: speed ** v["exponent"],
        "load_friction": lambda: v["scale"] * (load / v["scale"]) ** v["power"],
    }
    return single_joint_columns(motion, j, motion.sign(j) * curves[model.effect]())


SINGLE_CURVES = ("stribeck", "nonlinear_viscous", "load_friction", "hysteresis", "torque_ripple")
"""Effects of which the designer has single curves and the catalogue sums."""


@pytest.mark.parametrize("symbolic", EFFECTS, ids=IDS)
def test_columns_equal_the_catalogues_below_its_band(symbolic: SymbolicEffect):
    columns = EffectColumns(constants(), [symbolic])
    count = 4000
    values = columns.evaluate(sampled(motion(), count)).columns
    times = np.arange(3 * count) * PERIOD / count
    factors = columns.time_factors(times)
    ours = np.tile(values, (3, 1, 1)) * (1.0 if factors is None else factors[:, None])
    band, t = recorded().band, recorded().times
    flat = ours.reshape(len(ours), -1)
    fine = np.column_stack([np.interp(t, times, column) for column in flat.T])
    low = band.filter(fine, Grid.KEPT)[recorded().kept].reshape(-1, *ours.shape[1:])
    is_single = symbolic.effect in SINGLE_CURVES
    definition = EFFECTS_BY_NAME[symbolic.effect]
    model = CandidateModel(definition, symbolic.joint, symbolic.values, symbolic.other)
    expected = single_curve(recorded(), model) if is_single else model.columns(recorded())
    assert expected.shape == low.shape
    # the middle period, away from the ends
    time = recorded().time
    middle = (time > PERIOD + 1.0) & (time < 2.0 * PERIOD - 1.0)
    tolerance = 5e-3 if symbolic.effect in ("elasticity", "hysteresis") else 2e-3
    for k in range(expected.shape[2]):
        error = np.linalg.norm(low[middle, :, k] - expected[middle, :, k])
        assert error < tolerance * np.linalg.norm(expected[middle, :, k])


def test_every_symbolic_effect_is_tested():
    assert {e.effect for e in EFFECTS} == set(SYMBOLIC_EFFECTS)
    assert set(SYMBOLIC_EFFECTS) <= set(EFFECTS_BY_NAME)


@pytest.mark.parametrize("symbolic", EFFECTS, ids=IDS)
def test_gradients_equal_finite_differences(symbolic: SymbolicEffect):
    columns, c = EffectColumns(constants(), [symbolic]), constants()
    rng, count, step = np.random.default_rng(1), 60, 1e-6
    directions = [rng.normal(size=x.shape) for x in (motion().sine, motion().cosine)]
    change = FourierSeries(*directions, rng.normal(size=c.robot.n), PERIOD)
    seed = rng.normal(size=(count, c.robot.n, columns.count))

    def total(share: float) -> float:
        m = motion()
        moved = FourierSeries(
            m.sine + share * change.sine,
            m.cosine + share * change.cosine,
            m.offset + share * change.offset,
            PERIOD,
        )
        return float(np.sum(seed * columns.evaluate(sampled(moved, count)).columns))

    at = sampled(motion(), count)
    by_regressor, direct = columns.gradients(columns.evaluate(at), seed)
    functions = casadi_model.dynamics_functions(c.robot, c.parameters)
    through = MappedFunction(functions.adjoint, count)(at.q, at.dq, at.ddq, by_regressor)
    d = change.samples(change.grid(count))
    gradient = sum(
        float(np.sum((a + b) * x))
        for a, b, x in zip(direct, through, (d.q, d.dq, d.ddq), strict=True)
    )
    expected = (total(step) - total(-step)) / (2.0 * step)
    assert gradient == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_gradients_of_the_presliding_state_equal_finite_differences():
    t = 0.013 + np.arange(80) / 80.0 * 2.0 * np.pi  # no sample at a reversal
    q = 0.3 * np.sin(t) + 0.1 * np.sin(3 * t) + 0.05 * np.cos(2 * t)
    dq = 0.3 * np.cos(t) + 0.3 * np.cos(3 * t) - 0.1 * np.sin(2 * t)
    step, reach = 2.0 * np.pi / 80.0, 0.2
    rng = np.random.default_rng(0)
    seed, by_q, by_dq = (rng.normal(size=80) for _ in range(3))

    def total(h: float) -> float:
        z = presliding_state(q + h * by_q, dq + h * by_dq, step, reach).z
        return float(seed @ z)

    g_q, g_dq = presliding_state(q, dq, step, reach).gradients(seed)
    expected = (total(1e-7) - total(-1e-7)) / 2e-7
    assert g_q @ by_q + g_dq @ by_dq == pytest.approx(expected, rel=1e-6)


def test_presliding_friction_reverses_over_its_reach():
    """Between two reversals the state goes from −1 to 1 and stays there."""
    t = np.arange(4000) / 4000.0 * 2.0 * np.pi
    z: FloatArray = presliding_state(np.sin(t), np.cos(t), t[1], 0.05).z
    position = np.sin(t)
    falling = (t > 0.5 * np.pi) & (t < 1.5 * np.pi)
    travelled = 1.0 - position[falling]
    np.testing.assert_allclose(z[falling], 2.0 * np.exp(-travelled / 0.05) - 1.0, atol=2e-3)
