"""Stiffness, backlash and hysteresis of a gear from two encoders, where `qlink` is recorded.

q − q_link = τ_L/K + (b/2) sgn τ_L + d q̇ + h sgn q̇ + e cos(q + φ) + const. The gear deflects by
the torque τ_L = τ − I_a q̈ that it transmits (Spong 1987) and has backlash b. The link's encoder
may be read a time d after the motor's, which differs from a deflection by its dependence on speed;
gear friction causes the hysteresis h, and an eccentric encoder an error e once a turn. Standard
errors come from a sandwich estimator over blocks of one second (Liang & Zeger 1986), because
encoder errors repeat with the angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray
from ..effects.recorded_motion import Motions, RecordedMotion
from ..recordings import Recording
from ..robot.samples import MIN_TRAVEL
from .session_changes import block_numbers, sandwiched

SIGN_WIDTH_RATIO = 0.03
"""Width of the smooth sign of torque and speed over their largest value: manufacturers state a
gear's lost motion at ±3 % of the rated torque."""
MIN_SIGN_SHARE = 0.1
"""Share of the time for which the torque must have either sign to show backlash."""
MIN_BLOCKS = 8
"""Smallest number of blocks for standard errors."""
MIN_STANDARD_ERRORS = 2.0
"""Value over its standard error from which a parameter is reported."""


@dataclass(frozen=True)
class GearEstimate:
    """Parameters of the gear between the encoders of one joint.

    Attributes:
        joint: Index of the joint.
        compliance: 1/K and its standard error [rad/(N m)].
        backlash: b and its standard error [rad]; None if it is not significant, or if the torque
            keeps its sign.
        read_delay: d and its standard error [s].
        before: RMS of q − q_link minus its mean on the held-out recordings [rad].
        after: The same minus the fitted model [rad].
        load: τ_L on the held-out recordings [N m], shape (N,).
        deflection: q − q_link there minus all but the first two terms [rad], shape (N,).
        largest: Largest τ_L of the fitted recordings [N m].
    """

    joint: int
    compliance: tuple[float, float]
    backlash: tuple[float, float] | None
    read_delay: tuple[float, float]
    before: float
    after: float
    load: FloatArray
    deflection: FloatArray
    largest: float

    def curve(self, load: FloatArray) -> FloatArray:
        """Return the deflection under a torque, without friction [rad], shape (N,)."""
        backlash = 0.0 if self.backlash is None else self.backlash[0]
        return self.compliance[0] * load + 0.5 * backlash * np.tanh(
            load / (SIGN_WIDTH_RATIO * self.largest)
        )

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """K and its standard error [N m/rad]; None if it may be infinite."""
        value, std = self.compliance
        if value > max(MIN_STANDARD_ERRORS * std, 0.0):
            return 1.0 / value, std / value**2
        return None


@dataclass(frozen=True)
class _GearRows:
    """Rows of a joint in a segment, each of shape (N,): q − q_link, τ_L, q̇, q, and the block."""

    lag: FloatArray
    load: FloatArray
    speed: FloatArray
    position: FloatArray
    block: IntArray

    def columns(self, load: float, speed: float) -> FloatArray:
        """Return columns of compliance, backlash, delay, friction, and eccentricity, (N, 6).

        `load` and `speed` are the largest ones of the fitted recordings.
        """
        backlash = 0.5 * np.tanh(self.load / (SIGN_WIDTH_RATIO * load))
        friction = np.tanh(self.speed / (SIGN_WIDTH_RATIO * speed))
        eccentricity = np.cos(self.position), np.sin(self.position)
        return np.column_stack([self.load, backlash, self.speed, friction, *eccentricity])


def gears(
    motions: Sequence[Motions], recordings: Sequence[Sequence[Recording]]
) -> tuple[GearEstimate, ...]:
    """Estimate the gear of every joint that has two encoders, from fitted and held-out data."""
    entries = motions[0][0].fitted_robot.robot.entries
    estimates = []
    for j in range(motions[0][0].n):
        train, held_out = (
            _segments(group, records, j) for group, records in zip(motions, recordings, strict=True)
        )
        estimates.append(_estimate(j, entries[j].kind == "prismatic", train, held_out))
    return tuple(gear for gear in estimates if gear is not None)


def _segments(motions: Motions, recordings: Sequence[Recording], joint: int) -> list[_GearRows]:
    """Rows of every segment in which a joint has two encoders and moves."""
    linked = {record.source: record for record in recordings if record.qlink is not None}
    rows = (
        _rows(motion, linked[motion.segment.source], joint)
        for motion in motions
        if motion.segment.source in linked
    )
    return [part for part in rows if part is not None]


def _rows(motion: RecordedMotion, recording: Recording, joint: int) -> _GearRows | None:
    """Rows of a segment; None if the joint has no second encoder, or does not move."""
    if (
        not recording.has("qlink", recording.joints[joint])
        or np.ptp(motion.segment.q[:, joint]) < MIN_TRAVEL
    ):
        return None
    assert recording.qlink is not None
    first = int(np.argmin(np.abs(recording.t - motion.segment.start)))
    link = recording.qlink[first : first + len(motion.segment), joint]
    if not np.isfinite(link).all():
        return None
    moving = motion.moving[:, joint]
    lag = motion.lowpass((motion.segment.q[:, joint] - link)[:, None])[:, 0]
    position, speed, acceleration = motion.lowpass(
        np.column_stack([getattr(motion.samples, name)[:, joint] for name in ("q", "dq", "ddq")])
    ).T
    rotor_inertia = motion.fitted_robot.actuator_parameter("rotor_inertia")[joint]
    load = motion.torque[:, joint] - rotor_inertia * acceleration
    block = block_numbers(motion.time)
    return _GearRows(lag[moving], load[moving], speed[moving], position[moving], block[moving])


def _estimate(
    joint: int, is_prismatic: bool, train: Sequence[_GearRows], held_out: Sequence[_GearRows]
) -> GearEstimate | None:
    """Estimate of a joint; None if there is too little data for standard errors."""
    if not train or not held_out:
        return None
    load, speed = (
        max(1e-12, *(float(np.abs(getattr(rows, name)).max()) for rows in train))
        for name in ("load", "speed")
    )
    blocks: list[tuple[FloatArray, FloatArray]] = []
    for rows in train:
        # incremental encoders count from where a recording began: every segment has its own mean
        c, z = _centred(rows.columns(load, speed)), _centred(rows.lag)
        blocks += [(c[rows.block == k], z[rows.block == k]) for k in np.unique(rows.block)]
    if len(blocks) < MIN_BLOCKS:
        return None
    positive = np.concatenate([rows.load > 0.0 for rows in train]).mean()
    shows_backlash = MIN_SIGN_SHARE < positive < 1.0 - MIN_SIGN_SHARE
    is_kept = (True, shows_backlash, True, True, not is_prismatic, not is_prismatic)
    kept = np.flatnonzero(is_kept).tolist()
    x, std = _fit(blocks, kept)
    # neither compliance nor backlash may be negative
    while negative := [k for k in kept if k < 2 and x[k] < 0.0]:
        kept = [k for k in kept if k not in negative]
        x, std = _fit(blocks, kept)
    lag = np.concatenate([_centred(rows.lag) for rows in held_out])
    if not lag.any():  # a copy of the motor's encoder
        return None
    columns = [rows.columns(load, speed) for rows in held_out]
    centred, gear = np.concatenate([_centred(c) for c in columns]), [0, 1]
    compliance, backlash, delay, *_ = zip(x.tolist(), std.tolist(), strict=True)
    return GearEstimate(
        joint,
        compliance,
        backlash if x[1] > MIN_STANDARD_ERRORS * std[1] else None,
        delay,
        float(np.sqrt(np.mean(lag**2))),
        float(np.sqrt(np.mean((lag - centred @ x) ** 2))),
        np.concatenate([rows.load for rows in held_out]),
        lag - centred[:, 2:] @ x[2:] + float(np.mean(np.concatenate(columns)[:, gear] @ x[gear])),
        load,
    )


def _centred(x: FloatArray) -> FloatArray:
    """Signals without their means over the rows."""
    return np.asarray(x - x.mean(axis=0))


def _fit(
    blocks: Sequence[tuple[FloatArray, FloatArray]], kept: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Coefficients of some columns and their standard errors, 0 of the others; shapes (6,)."""
    solution, covariance = sandwiched([(c[:, kept], z) for c, z in blocks])
    freedom = len(blocks) / max(len(blocks) - len(kept), 1)
    x, std = np.zeros(6), np.zeros(6)
    x[kept], std[kept] = solution, np.sqrt(np.diag(covariance) * freedom)
    return x, std
