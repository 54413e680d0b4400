"""Prediction of unmodelled torque: none for coloured noise, by the right features for physics."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from excite.diagnosis import unmodelled
from excite.diagnosis.motion_rows import MotionRows, block_starts, travel_since_reversal

RATE, SECONDS = 50.0, 40.0
COUNT = int(RATE * SECONDS)
MIN_SHARE = 0.05
"""Share of a residual that noise alone does not predict."""
MIN_STANDARD_ERRORS = 1.5
"""Share over its standard error of what is predicted for sure."""


def multisine(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration of a multisine motion. Shapes (N, 2)."""
    rng = np.random.default_rng(seed)
    t = np.arange(COUNT) / RATE
    w, phase, size = (
        rng.uniform(0.5, 6.0, (2, 6)),
        rng.uniform(0.0, 6.3, (2, 6)),
        rng.uniform(0.1, 0.5, (2, 6)),
    )
    angle = t[:, None, None] * w + phase
    return tuple(
        np.sum(size * x, axis=2)
        for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )  # type: ignore[return-value]


def motion_rows(joints: int = 2, linear: bool = False, size: float = 1.0) -> MotionRows:
    """Return two recordings of 40 s; all torque is multiplied by `size`."""
    q, dq, ddq = (
        np.concatenate(pair)[:, :joints] for pair in zip(multisine(1), multisine(2), strict=True)
    )
    clock = np.tile(np.arange(COUNT) / RATE, 2)
    time = clock + np.repeat([0.0, SECONDS + 1.0], COUNT)
    load = size * (3.0 * np.sin(q) + 0.5 * ddq)
    zeros, moves, starts = np.zeros_like(q), np.ones(q.shape, bool), np.array([0, COUNT])
    motor, prismatic = load + 0.5 * size * np.sign(dq), (linear,) * joints
    return MotionRows(
        time,
        clock,
        q,
        dq,
        ddq,
        load,
        motor,
        zeros,
        zeros,
        moves,
        starts,
        starts,
        RATE,
        20.0,
        prismatic,
    )


def oscillator_response(force: np.ndarray, hertz: float, damping: float) -> np.ndarray:
    """Return the position of an oscillator, simulated for each recording in tenths of a sample."""
    out, omega = np.zeros_like(force), 2.0 * np.pi * hertz
    for start in (0, COUNT):
        x = v = 0.0
        for k in range(start, start + COUNT):
            for _ in range(10):
                v += (force[k] - 2.0 * damping * omega * v - omega**2 * x) / RATE / 10.0
                x += v / RATE / 10.0
            out[k] = x
    return out / out.std()


def coloured(rng: np.random.Generator) -> np.ndarray:
    white = rng.normal(size=2 * COUNT)
    for k in range(1, len(white)):
        white[k] += 0.9 * white[k - 1]
    return white / white.std()


def predict(
    residual: np.ndarray, motion: MotionRows | None = None
) -> unmodelled.ResidualPrediction:
    first = np.arange(2 * COUNT) < COUNT
    return unmodelled.predict_residual(motion or motion_rows(), (first, ~first), residual, 0)


def physics(regime: str) -> np.ndarray:
    motion = motion_rows()
    direction, angle = np.sign(motion.dq[:, 0]), motion.q[:, 0] % (2.0 * np.pi)
    if regime == "position":
        out = np.cos(3.0 * angle) + np.cos(7.0 * angle + 1.0)
    elif regime == "place":
        out = np.exp(-np.square((motion.q[:, 0] - 0.5) / 0.015))
    elif regime == "position and direction":
        out = direction * (np.abs(angle - 0.5) < 0.25)
    elif regime == "speed":
        out = np.exp(-np.square((motion.dq[:, 1] - 1.0) / 0.4))
    elif regime == "past acceleration":
        out = oscillator_response(motion.ddq[:, 0], 0.6, 0.15)
    elif regime == "past load":
        out = oscillator_response(motion.load[:, 0], 0.6, 0.15)
    else:
        out = motion.motor_torque[:, 0] * np.square(np.sum(motion.motor_torque * motion.dq, axis=1))
    return np.asarray((out - out.mean()) / out.std())


def test_coloured_noise_is_not_predictable():
    predictions = [predict(coloured(np.random.default_rng(seed))) for seed in range(20)]
    assert not any(prediction.share > MIN_SHARE for prediction in predictions)


@pytest.mark.parametrize(
    "regime", ["position", "place", "position and direction", "speed", "past acceleration", "power"]
)
def test_unmodelled_torque_is_predicted_by_the_features_that_generate_it(regime):
    prediction = predict(physics(regime) + coloured(np.random.default_rng(7)))
    assert prediction.regime == regime
    assert MIN_SHARE < prediction.share < 0.55 and prediction.sure > MIN_STANDARD_ERRORS


def test_a_resonance_of_the_load_is_predicted_by_past_motion():
    """Past load and past acceleration are correlated: either may be selected."""
    prediction = predict(physics("past load") + 0.5 * coloured(np.random.default_rng(7)))
    assert prediction.regime.startswith("past") and prediction.share > 0.2


def test_the_predicted_share_increases_with_the_signal():
    """The share is that of the signal, minus the error of a finite recording."""
    weak, strong = (
        predict(size * physics("past acceleration") + coloured(np.random.default_rng(3))).share
        for size in (0.5, 3.0)
    )
    assert 0.05 < weak < 0.2 and 0.6 < strong < 0.9


def test_torque_of_one_fold_only_is_not_predictable():
    first = np.arange(2 * COUNT) < COUNT
    assert (
        predict(
            np.where(first, physics("position"), 0.0) + coloured(np.random.default_rng(5))
        ).share
        < MIN_SHARE
    )


def test_past_features_do_not_cross_recordings():
    motion = motion_rows()
    past = unmodelled.BASES["past acceleration"].features(motion, 0)
    assert (
        not past[COUNT, 1:].any() and not past[0, 1:].any() and past[COUNT + 1, 1] == past[COUNT, 0]
    )


def test_the_prediction_does_not_depend_on_the_scale_of_the_torque():
    """Torque and power are scaled by their own size."""
    shares = []
    for size in (1.0, 1000.0):
        motion = motion_rows(size=size)
        residual = motion.motor_torque[:, 0] * np.abs(motion.motor_torque[:, 1])
        shares.append(
            predict(residual / residual.std() + coloured(np.random.default_rng(4)), motion).share
        )
    assert shares[1] == pytest.approx(shares[0], rel=0.02) and shares[0] > 0.3


def test_the_curve_is_over_the_speed_of_the_right_joint():
    response = predict(physics("speed") + coloured(np.random.default_rng(7))).response
    assert response.other == 1 and not response.relative
    assert abs(response.x[np.argmax(response.y)] - 1.0) < 0.4


def test_the_impulse_response_has_the_frequency_of_the_resonance():
    response = predict(
        3.0 * physics("past acceleration") + coloured(np.random.default_rng(3))
    ).response
    assert response.relative and np.abs(response.y).max() == 1.0
    spectrum = np.abs(np.fft.rfft(response.y, 4096))
    assert np.fft.rfftfreq(4096, response.x[1] - response.x[0])[
        np.argmax(spectrum)
    ] == pytest.approx(0.6, abs=0.15)


def test_past_features_do_not_depend_on_the_sampling_rate():
    """The second recording has a third of the sampling rate."""
    motion = motion_rows()
    keep = np.r_[0:COUNT, COUNT : 2 * COUNT : 3]
    thinned_columns = {
        name: getattr(motion, name)[keep]
        for name in (
            "time",
            "clock",
            "q",
            "dq",
            "ddq",
            "load",
            "motor_torque",
            "distance",
            "temperature",
            "moving",
        )
    }
    thin = dataclasses.replace(motion, **thinned_columns)
    residual = physics("past acceleration")[keep]
    prediction = unmodelled.predict_residual(
        thin, (np.arange(len(keep)) < COUNT, np.arange(len(keep)) >= COUNT), residual, 0
    )
    assert prediction.regime == "past acceleration" and prediction.share > 0.5


@pytest.mark.parametrize("linear", [False, True])
def test_a_single_joint_and_a_joint_at_rest(linear):
    noise = coloured(np.random.default_rng(1))
    prediction = predict(physics("position") + noise, motion_rows(1, linear))
    assert (
        prediction.share > 0.3
        and prediction.response.over == f"position [{'m' if linear else 'rad'}]"
    )
    motion = motion_rows(1, linear)
    at_rest = dataclasses.replace(
        motion,
        q=0.0 * motion.q + 0.3,
        dq=0.0 * motion.dq,
        ddq=0.0 * motion.ddq,
        load=0.0 * motion.load,
        motor_torque=0.0 * motion.motor_torque,
    )
    assert predict(noise, at_rest).share < MIN_SHARE
    assert np.isfinite(predict(noise, at_rest).response.y).all()
    assert predict(0.0 * noise, motion).share < MIN_SHARE


def test_blocks_of_a_motion_last_about_a_second():
    clock = np.arange(0.0, 10.0, 0.025)
    np.testing.assert_allclose(np.diff(clock[block_starts(clock, 1.0)]), 1.0)


def test_travel_since_reversal_ignores_small_speed_reversals():
    t = np.linspace(0.0, 2.0 * np.pi, 401)
    q, dq = np.sin(t), np.cos(t) + 0.001 * (-1.0) ** np.arange(401)
    distance = travel_since_reversal(q, dq)
    assert distance.max() == pytest.approx(2.0, abs=0.01)
    assert distance[130] < 0.15 < distance[60]
