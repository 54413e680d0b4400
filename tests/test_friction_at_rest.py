"""Joints that stop and stand: friction holds them with any torque up to the breakaway torque."""

from __future__ import annotations

import dataclasses
import itertools
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from diagnosis_cases import (
    COULOMB,
    NOISE,
    PSI,
    RATE,
    SUBJECT,
    VISCOUS,
    diagnose,
    findings_of,
    recording_of,
)
from slow_tests import slow
from synthetic_recordings import pinocchio_model, rest_to_rest, rnea_torque

from excite._types import FloatArray
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document
from excite.identification.segments import RecordingSegment
from excite.identification.standstill import LargestMotion, far_from_rest, moving_rows
from excite.recordings import Recording
from excite.report import diagnosis_page, verdict
from excite.report.torque_budget import joint_budgets

MOVES = 14
"""Moves of a recording, each followed by a dwell."""
STEP = 2.5e-4
"""Step of the simulation [s]."""
PRESLIDING = 4e-5
"""Travel within which friction passes from one direction to the other [rad]: nearly none."""
STIFFNESS, DAMPING = 4000.0, 200.0
"""Gains of the position controllers [N m/rad, N m s/rad]."""
RESOLUTION = 2.0 * np.pi / 2**16
"""Resolution of the encoders [rad]."""


def way(count: int) -> FloatArray:
    """Return the samples of a move from 0 to 1, shape (count,)."""
    return rest_to_rest(np.linspace(0.0, 1.0, count))


def reference(seed: int) -> FloatArray:
    """Return moves between random poses with dwells, at every step, shape (N, 2)."""
    rng = np.random.default_rng(seed)
    poses, parts = rng.uniform(-1.2, 1.2, (MOVES + 1, 2)), []
    for start, end in itertools.pairwise(poses):
        move, dwell = (int(x / STEP) for x in rng.uniform([0.6, 0.3], [1.2, 0.8]))
        parts += [start + way(move)[:, None] * (end - start), np.tile(end, (dwell, 1))]
    return np.concatenate(parts)


@cache
def point_to_point(seed: int) -> Recording:
    """Return a recording of controlled motion with Coulomb friction that holds at rest."""
    wanted = reference(seed)
    speed = np.gradient(wanted, STEP, axis=0)
    acceleration = np.gradient(speed, STEP, axis=0)
    expected = 0.9 * rnea_torque(SUBJECT, PSI, wanted, speed, acceleration)
    model = pinocchio_model(SUBJECT, PSI)
    model.armature = PSI[SUBJECT.parameters.block("rotor_inertia")]
    data, offset = model.createData(), PSI[SUBJECT.parameters.block("offset")]
    q, dq, strain = wanted[0].copy(), np.zeros(2), np.zeros(2)
    positions, torques = [], []
    every = round(1.0 / (RATE * STEP))
    for k, (target, target_speed) in enumerate(zip(wanted, speed, strict=True)):
        motor = expected[k] + STIFFNESS * (target - q) + DAMPING * (target_speed - dq)
        sliding = np.abs(strain) >= PRESLIDING
        held = COULOMB * strain / PRESLIDING + np.where(sliding, 0.0, 100.0 * dq)
        dq = dq + STEP * pin.aba(model, data, q, dq, motor - held - VISCOUS * dq - offset)
        q = q + STEP * dq
        strain = np.clip(strain + STEP * dq, -PRESLIDING, PRESLIDING)
        positions.append(q)
        torques.append(motor)
    mean = np.array(torques)[: len(torques) // every * every].reshape(-1, every, 2).mean(axis=1)
    q = np.round(np.array(positions)[every // 2 :: every][: len(mean)] / RESOLUTION) * RESOLUTION
    t = np.arange(len(q)) / RATE
    tau = mean + NOISE * np.random.default_rng(seed).normal(size=mean.shape)
    return Recording(f"moves_{seed}.csv", SUBJECT.robot.joints, t, q, tau=tau, row_times=t)


@cache
def with_dwells(seed: int) -> Diagnosis:
    """Return the diagnosis of moves with dwells; a motion without them is held out."""
    return diagnose([point_to_point(seed), recording_of(None, 5)])


@pytest.mark.parametrize("seed", [slow(0), 1, slow(2)])
def test_friction_at_rest_is_no_effect(seed):
    assert findings_of(with_dwells(seed)) == []


@pytest.mark.parametrize("seed", [slow(0), 1, slow(2)])
def test_friction_at_rest_spoils_no_prediction_of_motion(seed):
    result = with_dwells(seed)
    assert result.final.chain.filter is None
    assert np.all(result.held_out.rmse_after < 1.05 * result.held_out.rmse_before)


def segment_of(q: FloatArray) -> tuple[RecordingSegment, FloatArray]:
    """Return the segment of a joint's positions, shape (N,), and its speeds, shape (N, 1)."""
    column = q[:, None]
    dq = np.gradient(column, 1.0 / RATE, axis=0)
    return RecordingSegment("stop.csv", 0.0, RATE, column, np.zeros_like(column)), dq


def test_rows_near_a_stop_do_not_count_and_those_near_a_reversal_do():
    rising = way(200)
    stop = np.concatenate([rising, np.ones(100), 1.0 - rising])
    swing = np.cos(np.linspace(0.0, 8.0 * np.pi, 1600))
    for q, stands in ((stop, True), (swing, False)):
        segment, dq = segment_of(q)
        rows, largest = np.arange(len(q)), LargestMotion.of([(segment.q, dq)])
        near, far = (
            moving_rows(segment, segment.q, dq, rows, largest, reach=x)[:, 0] for x in (0.0, 0.1)
        )
        assert np.all(near[far])
        lost = np.flatnonzero(near & ~far)
        if not stands:
            assert not len(lost)
            continue
        first, last = np.flatnonzero(~near[100:400])[[0, -1]] + 100  # of the stop and breakaway
        assert set(lost) >= set(range(first - int(0.1 * RATE), first))
        assert not np.any(far[first:last])


@pytest.mark.parametrize(
    ("size", "turns", "share"),
    [(0.0, 4.0, 0.0), (1e-3, 16.0, 0.0), (0.1, 0.25, 1.0), (0.01, 200.0, 1.0)],
    ids=["held exactly", "held by a servo", "slow motion", "small, fast motion"],
)
def test_joint_that_is_held_throughout_a_segment_does_not_count_there(size, turns, share):
    phase = np.linspace(0.0, 2.0 * np.pi, 1600)
    (wide, fast), (small, speed) = (
        segment_of(factor * np.cos(count * phase)) for factor, count in ((1.0, 4.0), (size, turns))
    )
    largest = LargestMotion.of([(wide.q, fast), (small.q, speed)])
    rows = np.arange(len(phase))
    assert moving_rows(wide, wide.q, fast, rows, largest).all()
    assert moving_rows(small, small.q, speed, rows, largest).mean() == share
    if not share:
        assert not far_from_rest(small.q, speed, rows, largest, 1).any()


def test_rows_far_from_rest_are_those_without_a_reversal_nearby():
    q = np.cos(np.linspace(0.0, 4.0 * np.pi, 800))
    _, dq = segment_of(q)
    reach = 40
    column, rows = q[:, None], np.arange(len(q))
    far = far_from_rest(column, dq, rows, LargestMotion.of([(column, dq)]), reach)[:, 0]
    reversals = np.array([0, 200, 400, 600, 799])
    distance = np.abs(np.arange(len(q))[:, None] - reversals).min(axis=1)
    assert np.all(far[distance > reach + 4]) and not np.any(far[distance < reach - 4])


def test_a_joint_at_rest_without_torque_is_no_error():
    """Friction holds it, and its motor gives no torque: there is nothing to predict."""

    def held(recording: Recording) -> Recording:
        q, tau = recording.q.copy(), recording.torque.copy()
        q[:, 1], tau[:, 1] = 0.3, 0.0
        return dataclasses.replace(recording, q=q, tau=tau)

    result = diagnose([held(recording_of(None, seed)) for seed in (2, 5, 7)])
    stated = document(result)
    budget = joint_budgets(stated, SUBJECT.robot)[1]
    assert budget.is_explained and not (budget.is_useless or budget.is_poor or budget.is_worse)
    assert "joint_2" not in verdict.verdict_words(stated, [budget])
    page = diagnosis_page(result, stated)
    assert "the measured torque is zero" in page
