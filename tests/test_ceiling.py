"""The flexible ceiling: noise of any colour is foreseen by nothing, physics without a name by the features that it is made of."""

from __future__ import annotations

import numpy as np
import pytest

from excite.diagnose import ceiling
from excite.diagnose.ceiling import FORESEEN, SURE
from excite.diagnose.looks import Rows

RATE, SECONDS = 50.0, 40.0
COUNT = int(RATE * SECONDS)


def half(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, speed and acceleration of two joints that move by some sines. Shapes (N, 2)."""
    rng = np.random.default_rng(seed)
    t = np.arange(COUNT) / RATE
    w, phase, size = rng.uniform(0.5, 6.0, (2, 6)), rng.uniform(0.0, 6.3, (2, 6)), rng.uniform(0.1, 0.5, (2, 6))
    angle = t[:, None, None] * w + phase
    return tuple(np.sum(size * x, axis=2) for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))  # type: ignore[return-value]


def rows() -> Rows:
    """Two recordings of 40 s, one after the other."""
    q, dq, ddq = (np.concatenate(pair) for pair in zip(half(1), half(2), strict=True))
    clock = np.tile(np.arange(COUNT) / RATE, 2)
    time = clock + np.repeat([0.0, SECONDS + 1.0], COUNT)
    load = 3.0 * np.sin(q) + 0.5 * ddq
    none, moves, starts = np.zeros_like(q), np.ones(q.shape, bool), np.array([0, COUNT])
    return Rows(time, clock, q, dq, ddq, load, load + 0.5 * np.sign(dq), none, none, moves, starts, starts, RATE, 20.0, (False, False))


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


def seen(residual: np.ndarray, joint: int = 0) -> ceiling.Sight:
    first = np.arange(2 * COUNT) < COUNT
    return ceiling.seen(rows(), (first, ~first), residual, joint)


def physics(regime: str) -> np.ndarray:
    made = rows()
    direction, angle = np.sign(made.dq[:, 0]), made.q[:, 0] % (2.0 * np.pi)
    if regime == "position":
        out = 1.0 * (np.abs(angle - 0.5) < 0.15)
    elif regime == "position and direction":
        out = direction * (np.abs(angle - 0.5) < 0.25)
    elif regime == "speed":
        out = np.exp(-np.square((made.dq[:, 1] - 1.0) / 0.4))
    elif regime == "past acceleration":
        out = swung(made.ddq[:, 0], 0.6, 0.15)
    elif regime == "past load":
        out = swung(made.load[:, 0], 0.6, 0.15)
    else:
        out = made.motor[:, 0] * np.square(np.sum(made.motor * made.dq, axis=1))
    return np.asarray((out - out.mean()) / out.std())


def test_coloured_noise_is_foreseen_by_nothing():
    sights = [seen(coloured(np.random.default_rng(seed))) for seed in range(20)]
    assert not any(one.share > FORESEEN for one in sights)


@pytest.mark.parametrize("regime", ["position", "position and direction", "speed", "past acceleration", "power"])
def test_physics_without_a_name_is_foreseen_by_what_it_is_made_of(regime):
    found = seen(physics(regime) + coloured(np.random.default_rng(7)))
    assert found.regime == regime
    assert FORESEEN < found.share < 0.55 and found.sure > SURE


def test_a_resonance_of_the_load_is_told_by_what_went_before():
    """Which of the two pasts tells it best is not sure: one is much of the other."""
    found = seen(physics("past load") + 0.5 * coloured(np.random.default_rng(7)))
    assert found.regime.startswith("past") and found.share > 0.2


def test_the_share_is_that_of_the_physics():
    """As much physics as noise: half is foreseen, less what a finite recording does not tell."""
    weak, strong = (seen(size * physics("past acceleration") + coloured(np.random.default_rng(3))).share for size in (0.5, 3.0))
    assert 0.05 < weak < 0.2 and 0.6 < strong < 0.9


def test_what_happens_at_one_half_only_is_not_foreseen():
    first = np.arange(2 * COUNT) < COUNT
    assert seen(np.where(first, physics("position"), 0.0) + coloured(np.random.default_rng(5))).share < FORESEEN


def test_a_recording_does_not_remember_the_one_before():
    made = rows()
    past = ceiling.KINDS["past acceleration"].features(made, 0)
    assert not past[COUNT, 1:].any() and not past[0, 1:].any() and past[COUNT + 1, 1] == past[COUNT, 0]
