"""What a joint's two encoders say of the gear between them, where recordings have the link's (`qlink`).

q − q_link = τ_L/K + (b/2) sgn τ_L + d q̇ + h sgn q̇ + e cos(q + φ) + const. The gear winds up by the torque that it carries,
τ_L = τ − I_a q̈ (Spong 1987), and has a play b; the link's encoder may be read a time d after the motor's, which looks like a wind-up but
goes with speed; friction in the gear holds h back; and an encoder that is not centred errs once a turn, by e. Errors are sandwiched between
blocks of a second (Liang & Zeger 1986), since what encoders err by repeats with the angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..effects.recorded_motion import RecordedMotion
from ..recordings import Recording
from .blocks import sandwiched
from .residual_curves import BLOCK, block_starts

Array = np.ndarray
TURNED = 0.03
"""Of the largest torque, over which its sign changes: gears state their lost motion at three per cent of what they may carry."""
BOTH = 0.1
"""Share of the time that torque must have either sign to show a play."""
LEAST_BLOCKS = 8
SURE = 2.0
"""Standard deviations."""


@dataclass(frozen=True)
class GearEstimate:
    """Between the encoders of one joint. Each value with its standard deviation; joint: its index.

    compliance: 1/K [rad/(N m)]. play: b [rad], None where none is seen, or torque keeps its sign. apart: d [s]. before, after: RMS of
    q − q_link that its mean, and all of this, leave of the held-out recordings [rad]. load, windup: τ_L [N m] and q − q_link without
    all but the first two terms [rad], held out, at the rows that count. Shape (N,). largest: of τ_L, fitted.
    """

    joint: int
    compliance: tuple[float, float]
    play: tuple[float, float] | None
    apart: tuple[float, float]
    before: float
    after: float
    load: Array
    windup: Array
    largest: float

    def curve(self, load: Array) -> Array:
        """Wind-up under a torque, friction aside. Shape (N,)."""
        play = 0.0 if self.play is None else self.play[0]
        return self.compliance[0] * load + 0.5 * play * np.tanh(load / (TURNED * self.largest))

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """K [N m/rad]; None where it may as well be infinite."""
        value, std = self.compliance
        return (1.0 / value, std / value**2) if value > max(SURE * std, 0.0) else None


@dataclass(frozen=True)
class _Rows:
    """Of one joint in one stretch. lag: q − q_link. load: τ_L. speed: q̇. place: q. block: of each row. Shapes (N,)."""

    lag: Array
    load: Array
    speed: Array
    joint_index: Array
    block: Array


def gears(
    tracks: Sequence[Sequence[RecordedMotion]], recordings: Sequence[Sequence[Recording]]
) -> tuple[GearEstimate, ...]:
    """Every joint that has two encoders. Both: those fitted, those held out. Empty where no recording has `qlink`."""
    entries = tracks[0][0].fitted_robot.robot.entries
    found = []
    for j in range(tracks[0][0].n):
        train, held_out = (
            _stretches(half, group, j) for half, group in zip(tracks, recordings, strict=True)
        )
        found.append(_gear(j, entries[j].kind == "prismatic", train, held_out))
    return tuple(gear for gear in found if gear is not None)


def _stretches(tracks: Sequence[RecordedMotion], recordings: Sequence[Recording], joint: int) -> list[_Rows]:
    linked = {one.source: one for one in recordings if one.qlink is not None}
    rows = (
        _rows(track, linked[track.segment.source], joint)
        for track in tracks
        if track.segment.source in linked
    )
    return [one for one in rows if one is not None]


def _rows(track: RecordedMotion, recording: Recording, joint: int) -> _Rows | None:
    """None where the joint has no second encoder, or does not move."""
    if (
        not recording.has("qlink", recording.joints[joint])
        or np.ptp(track.segment.q[:, joint]) < 1e-6
    ):
        return None
    assert recording.qlink is not None
    first = int(np.argmin(np.abs(recording.t - track.segment.start)))
    link = recording.qlink[first : first + len(track.segment), joint]
    if not np.isfinite(link).all():
        return None
    moves = track.moving[:, joint]
    lag = track.lowpass((track.segment.q[:, joint] - link)[:, None])[:, 0]
    place, speed, hastened = track.lowpass(
        np.column_stack([getattr(track.samples, name)[:, joint] for name in ("q", "dq", "ddq")])
    ).T
    load = track.torque[:, joint] - track.fitted_robot.actuator_parameter("rotor_inertia")[joint] * hastened
    block = np.searchsorted(
        block_starts(track.time - track.time[0], BLOCK), np.arange(len(track)), side="right"
    )
    return _Rows(*(x[moves] for x in (lag, load, speed, place, block)))


def _columns(rows: _Rows, load: float, speed: float) -> Array:
    """Of compliance, play, delay, friction, and once a turn. Shape (N, 6)."""
    play, friction = (
        0.5 * np.tanh(rows.load / (TURNED * load)),
        np.tanh(rows.speed / (TURNED * speed)),
    )
    return np.column_stack(
        [rows.load, play, rows.speed, friction, np.cos(rows.joint_index), np.sin(rows.joint_index)]
    )


def _gear(
    joint: int, linear: bool, train: Sequence[_Rows], held_out: Sequence[_Rows]
) -> GearEstimate | None:
    """None where there is too little of it to tell errors by."""
    if not train or not held_out:
        return None
    load, speed = (
        max(1e-12, *(float(np.abs(getattr(rows, name)).max()) for rows in train))
        for name in ("load", "speed")
    )
    signs = np.concatenate([rows.load > 0.0 for rows in train])
    # encoders count from where each recording began: every stretch has a mean of its own
    parts = [
        (c - c.mean(axis=0), r.lag - r.lag.mean(), r.block)
        for r in train
        for c in (_columns(r, load, speed),)
    ]
    blocks = [(c[b == k], z[b == k]) for c, z, b in parts for k in np.unique(b)]
    if len(blocks) < LEAST_BLOCKS:
        return None
    kept = [
        0,
        *([1] if BOTH < signs.mean() < 1.0 - BOTH else []),
        2,
        3,
        *([] if linear else [4, 5]),
    ]
    x, std = _fitted(blocks, kept)
    while bad := [k for k in kept if k < 2 and x[k] < 0.0]:  # neither gives way against the torque
        kept = [k for k in kept if k not in bad]
        x, std = _fitted(blocks, kept)
    lag, columns = (
        np.concatenate([r.lag - r.lag.mean() for r in held_out]),
        [_columns(r, load, speed) for r in held_out],
    )
    centred, gear = np.concatenate([c - c.mean(axis=0) for c in columns]), [0, 1]
    told = [(float(value), float(error)) for value, error in zip(x, std, strict=True)]
    return GearEstimate(
        joint,
        told[0],
        told[1] if x[1] > SURE * std[1] else None,
        told[2],
        float(np.sqrt(np.mean(lag**2))),
        float(np.sqrt(np.mean((lag - centred @ x) ** 2))),
        np.concatenate([r.load for r in held_out]),
        lag - centred[:, 2:] @ x[2:] + float(np.mean(np.concatenate(columns)[:, gear] @ x[gear])),
        load,
    )


def _fitted(blocks: Sequence[tuple[Array, Array]], kept: Sequence[int]) -> tuple[Array, Array]:
    """Coefficients of some columns and their standard deviations between blocks; 0 of the others. Shapes (6,)."""
    found, covariance = sandwiched([(c[:, kept], z) for c, z in blocks])
    freedom = len(blocks) / max(len(blocks) - len(kept), 1)
    x, std = np.zeros(6), np.zeros(6)
    x[kept], std[kept] = found, np.sqrt(np.diag(covariance) * freedom)
    return x, std
