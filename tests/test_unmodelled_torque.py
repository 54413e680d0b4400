"""The flexible foreseen: noise of any colour is foreseen by nothing, physics without a name by the
features that it is made of."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from excite.diagnosis import unmodelled
from excite.diagnosis.residual_curves import MotionRows
from excite.diagnosis.unmodelled import MIN_SHARE, MIN_STANDARD_ERRORS

RATE, SECONDS = 50.0, 40.0
COUNT = int(RATE * SECONDS)


def half(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, speed and acceleration of two joints that move by some sines. Shapes (N, 2)."""
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


def rows(joints: int = 2, linear: bool = False, size: float = 1.0) -> MotionRows:
    """Two recordings of 40 s, one after the other. size: of all torque."""
    q, dq, ddq = (np.concatenate(pair)[:, :joints] for pair in zip(half(1), half(2), strict=True))
    clock = np.tile(np.arange(COUNT) / RATE, 2)
    time = clock + np.repeat([0.0, SECONDS + 1.0], COUNT)
    load = size * (3.0 * np.sin(q) + 0.5 * ddq)
    none, moves, starts = np.zeros_like(q), np.ones(q.shape, bool), np.array([0, COUNT])
    motor, still = load + 0.5 * size * np.sign(dq), (linear,) * joints
    return MotionRows(
        time, clock, q, dq, ddq, load, motor, none, none, moves, starts, starts, RATE, 20.0, still
    )


def swung(drive: np.ndarray, hertz: float, damping: float) -> np.ndarray:
    """An oscillator's place, of each recording by itself, in steps of a tenth of a sample."""
    out, omega = np.zeros_like(drive), 2.0 * np.pi * hertz
    for start in (0, COUNT):
        x = v = 0.0
        for k in range(start, start + COUNT):
            for _ in range(10):
                v += (drive[k] - 2.0 * damping * omega * v - omega**2 * x) / RATE / 10.0
                x += v / RATE / 10.0
            out[k] = x
    return out / out.std()


def coloured(rng: np.random.Generator) -> np.ndarray:
    white = rng.normal(size=2 * COUNT)
    for k in range(1, len(white)):
        white[k] += 0.9 * white[k - 1]
    return white / white.std()


def seen(residual: np.ndarray, made: MotionRows | None = None) -> unmodelled.ResidualPrediction:
    first = np.arange(2 * COUNT) < COUNT
    return unmodelled.predict_residual(made or rows(), (first, ~first), residual, 0)


def physics(regime: str) -> np.ndarray:
    made = rows()
    direction, angle = np.sign(made.dq[:, 0]), made.q[:, 0] % (2.0 * np.pi)
    if regime == "position":
        out = np.cos(3.0 * angle) + np.cos(7.0 * angle + 1.0)
    elif regime == "place":
        out = np.exp(-np.square((made.q[:, 0] - 0.5) / 0.015))
    elif regime == "position and direction":
        out = direction * (np.abs(angle - 0.5) < 0.25)
    elif regime == "speed":
        out = np.exp(-np.square((made.dq[:, 1] - 1.0) / 0.4))
    elif regime == "past acceleration":
        out = swung(made.ddq[:, 0], 0.6, 0.15)
    elif regime == "past load":
        out = swung(made.load[:, 0], 0.6, 0.15)
    else:
        out = made.motor_torque[:, 0] * np.square(np.sum(made.motor_torque * made.dq, axis=1))
    return np.asarray((out - out.mean()) / out.std())


def test_coloured_noise_is_foreseen_by_nothing():
    sights = [seen(coloured(np.random.default_rng(seed))) for seed in range(20)]
    assert not any(one.share > MIN_SHARE for one in sights)


@pytest.mark.parametrize(
    "regime", ["position", "place", "position and direction", "speed", "past acceleration", "power"]
)
def test_physics_without_a_name_is_foreseen_by_what_it_is_made_of(regime):
    found = seen(physics(regime) + coloured(np.random.default_rng(7)))
    assert found.regime == regime
    assert MIN_SHARE < found.share < 0.55 and found.sure > MIN_STANDARD_ERRORS


def test_a_resonance_of_the_load_is_told_by_what_went_before():
    """Which of the two pasts tells it best is not sure: one is much of the other."""
    found = seen(physics("past load") + 0.5 * coloured(np.random.default_rng(7)))
    assert found.regime.startswith("past") and found.share > 0.2


def test_the_share_is_that_of_the_physics():
    """As much physics as noise: half is foreseen, less what a finite recording does not tell."""
    weak, strong = (
        seen(size * physics("past acceleration") + coloured(np.random.default_rng(3))).share
        for size in (0.5, 3.0)
    )
    assert 0.05 < weak < 0.2 and 0.6 < strong < 0.9


def test_what_happens_at_one_half_only_is_not_foreseen():
    first = np.arange(2 * COUNT) < COUNT
    assert (
        seen(np.where(first, physics("position"), 0.0) + coloured(np.random.default_rng(5))).share
        < MIN_SHARE
    )


def test_a_recording_does_not_remember_the_one_before():
    made = rows()
    past = unmodelled.BASES["past acceleration"].features(made, 0)
    assert (
        not past[COUNT, 1:].any() and not past[0, 1:].any() and past[COUNT + 1, 1] == past[COUNT, 0]
    )


def test_a_robot_of_any_strength_is_told_alike():
    """What all drives draw is told in its own size: a share of it that changes a torque is as
    visible in watts as in kilowatts."""
    shares = []
    for size in (1.0, 1000.0):
        made = rows(size=size)
        residual = made.motor_torque[:, 0] * np.abs(made.motor_torque[:, 1])
        shares.append(
            seen(residual / residual.std() + coloured(np.random.default_rng(4)), made).share
        )
    assert shares[1] == pytest.approx(shares[0], rel=0.02) and shares[0] > 0.3


def test_the_curve_is_over_the_joint_whose_speed_it_is():
    response = seen(physics("speed") + coloured(np.random.default_rng(7))).response
    assert response.other == 1 and not response.relative
    assert abs(response.x[np.argmax(response.y)] - 1.0) < 0.4


def test_the_response_to_an_acceleration_rings_as_the_load_does():
    response = seen(
        3.0 * physics("past acceleration") + coloured(np.random.default_rng(3))
    ).response
    assert response.relative and np.abs(response.y).max() == 1.0
    spectrum = np.abs(np.fft.rfft(response.y, 4096))
    assert np.fft.rfftfreq(4096, response.x[1] - response.x[0])[
        np.argmax(spectrum)
    ] == pytest.approx(0.6, abs=0.15)


def test_recordings_of_different_rates_remember_alike():
    """The second recording has every third row only."""
    made = rows()
    keep = np.r_[0:COUNT, COUNT : 2 * COUNT : 3]
    taken = {
        name: getattr(made, name)[keep]
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
    thin = dataclasses.replace(made, **taken)
    residual = physics("past acceleration")[keep]
    sight = unmodelled.predict_residual(
        thin, (np.arange(len(keep)) < COUNT, np.arange(len(keep)) >= COUNT), residual, 0
    )
    assert sight.regime == "past acceleration" and sight.share > 0.5


@pytest.mark.parametrize("linear", [False, True])
def test_one_joint_and_one_that_never_moves_are_told_too(linear):
    noise = coloured(np.random.default_rng(1))
    one = seen(physics("position") + noise, rows(1, linear))
    assert one.share > 0.3 and one.response.over == f"position [{'m' if linear else 'rad'}]"
    made = rows(1, linear)
    still = dataclasses.replace(
        made,
        q=0.0 * made.q + 0.3,
        dq=0.0 * made.dq,
        ddq=0.0 * made.ddq,
        load=0.0 * made.load,
        motor_torque=0.0 * made.motor_torque,
    )
    assert not seen(noise, still).counts and np.isfinite(seen(noise, still).response.y).all()
    assert not seen(0.0 * noise, made).counts
