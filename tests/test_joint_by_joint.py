"""Joints that move one after the other: at rest, static friction takes any value."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from diagnosis_cases import COULOMB, NOISE, PSI, RATE, SUBJECT, diagnose, findings_of, noise_ratios
from synthetic_recordings import rnea_torque

from excite.diagnosis.diagnosis import Diagnosis
from excite.effects import contact
from excite.identification import identification
from excite.recordings import Recording

SECONDS = 24.0
STROKES = ((1.0, 12.0), (13.0, 17.0))
"""Time during which each joint moves [s]; it is at rest for more than half of the recording."""


def one_after_the_other(seed: int, is_constant: bool = False) -> Recording:
    """Return a recording whose joints hold by static friction while the other one moves.

    The friction at rest varies slowly, or is the same at all times.
    """
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
        wave = np.ones_like(t) if is_constant else wave
        held[:, joint] = np.where(at_rest, 0.9 * COULOMB[joint] * wave, 0.0)
    tau = rnea_torque(SUBJECT, PSI, q, dq, ddq) + held + NOISE * rng.normal(size=held.shape)
    return Recording(f"{seed}.csv", SUBJECT.robot.joints, t, q, tau=tau, row_times=t)


def one_file_of_each_joint(seed: int) -> list[Recording]:
    """Return the recording as two files, in each of which one joint stands still throughout."""
    whole = one_after_the_other(seed, is_constant=True)
    cut = round(12.5 * RATE)
    return [
        dataclasses.replace(whole.rows(rows), source=f"{seed}_{joint}.csv")
        for joint, rows in enumerate((slice(0, cut), slice(cut, None)))
    ]


@cache
def diagnosed() -> Diagnosis:
    return diagnose([one_after_the_other(1), one_after_the_other(2), one_after_the_other(3)])


def test_joint_that_stands_still_throughout_a_recording_does_not_count_there():
    """Static friction would be taken for offset."""
    files = [*one_file_of_each_joint(1), *one_file_of_each_joint(2)]
    options = identification.IdentificationOptions(band=20.0)
    parts = SUBJECT.robot, SUBJECT.parameters, SUBJECT.base
    psi = identification.identify(*parts, files, (), options).psi
    offset = SUBJECT.parameters.block("offset")
    assert (np.abs(psi[offset] - PSI[offset]) < 0.05 * COULOMB).all()


@pytest.mark.slow
def test_diagnosis_of_one_file_of_each_joint_predicts_their_motion():
    result = diagnose(
        [*one_file_of_each_joint(1), *one_file_of_each_joint(2), one_after_the_other(3)]
    )
    assert not findings_of(result)
    assert noise_ratios(result)[1].max() < 4.0


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
