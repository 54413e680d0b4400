"""Joints that move one after the other: at rest, static friction takes any value."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from diagnosis_cases import COULOMB, NOISE, PSI, RATE, SUBJECT, diagnose, findings_of, noise_ratios
from synthetic_recordings import rnea_torque

from excite.diagnosis.diagnosis import Diagnosis
from excite.effects import contact
from excite.recordings import Recording

SECONDS = 24.0
STROKES = ((1.0, 12.0), (13.0, 17.0))
"""Time during which each joint moves [s]; it is at rest for more than half of the recording."""


def one_after_the_other(seed: int) -> Recording:
    """Return a recording whose joints hold by static friction while the other one moves."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * RATE)) / RATE
    q, dq, ddq, held = np.zeros((4, len(t), 2))
    for joint, (start, end) in enumerate(STROKES):
        u = np.clip((t - start) / (end - start), 0.0, 1.0)
        rate, size = 2.0 * np.pi / (end - start), rng.uniform(0.8, 1.2)
        # a sine wave of three strokes that begins and ends at rest
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi * u)
        q[:, joint] = size * window * np.sin(6.0 * np.pi * u)
        dq[:, joint] = np.gradient(q[:, joint], t)
        ddq[:, joint] = np.gradient(dq[:, joint], t)
        at_rest = (u <= 0.0) | (u >= 1.0)
        wave = np.sin(rng.uniform(0.1, 0.4) * rate * t + rng.uniform(0.0, 6.0))
        held[:, joint] = np.where(at_rest, 0.9 * COULOMB[joint] * wave, 0.0)
    tau = rnea_torque(SUBJECT, PSI, q, dq, ddq) + held + NOISE * rng.normal(size=held.shape)
    return Recording(f"{seed}.csv", SUBJECT.robot.joints, t, q, tau=tau, row_times=t)


@cache
def diagnosed() -> Diagnosis:
    return diagnose([one_after_the_other(1), one_after_the_other(2), one_after_the_other(3)])


def test_torque_at_rest_is_no_reason_for_an_effect():
    assert not findings_of(diagnosed())
    assert noise_ratios(diagnosed())[1].max() < 4.0  # 10 if rows at rest count


def test_rows_at_rest_do_not_count():
    for motion in diagnosed().model.motions:
        for joint, (start, end) in enumerate(STROKES):
            inside = (motion.time > start) & (motion.time < end)
            assert motion.moving[inside, joint].mean() > 0.5
            assert motion.moving[~inside, joint].mean() < 0.05


@pytest.mark.parametrize(
    ("link", "interval", "is_plausible"),
    [(0, (2.0, 4.0), True), (1, (2.0, 4.0), True), (1, (12.5, 17.5), False), (0, (1, 11), False)],
)
def test_a_contact_is_told_from_what_a_joint_always_needs(link, interval, is_plausible):
    """The second joint moves during the third contact alone: all of its torque would be one."""
    motions = diagnosed().model.motions[:1]
    models = [m for m in contact.contact_models(motions, 0, *interval, 1.0) if m.joint == link]
    for model in models:
        if not model.values["knots"]:
            assert model.is_plausible(np.ones(3)) == is_plausible
