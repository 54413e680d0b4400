"""What a joint's two encoders say of the gear between them, where recordings have the link's (`qlink`).

q − q_link = τ_L/K + (b/2) sgn τ_L + h sgn q̇ + d q̇ + const. The gear winds up by the torque that it carries, τ_L = τ − I_a q̈ (Spong 1987),
and has a play b; friction in it holds h back; and the link's encoder may be read a time d after the motor's, which looks like a wind-up but
goes with speed. Errors are sandwiched between blocks of a second (Liang & Zeger 1986), since what encoders err by repeats with the angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..recordings import Recording
from .looks import BLOCK, block_starts
from .track import Track

Array = np.ndarray
TURNED = 0.03
"""Of the largest torque, over which its sign changes: gears state their lost motion at three per cent of what they may carry."""
BOTH = 0.1
"""Share of the time that torque must have either sign to show a play."""
LEAST_BLOCKS = 8
SURE = 2.0
"""Standard deviations."""


@dataclass(frozen=True)
class Gear:
    """Between the encoders of one joint. Each value with its standard deviation; joint: its index.

    compliance: 1/K [rad/(N m)]. play: b [rad], None where torque keeps its sign. apart: d [s]. before, after: RMS of q − q_link that its
    mean, and all of this, leave of the held-out recordings [rad]. load, windup: τ_L [N m] and q − q_link without d q̇ and the constant
    [rad], held out, at the rows that count. Shape (N,).
    """

    joint: int
    compliance: tuple[float, float]
    play: tuple[float, float] | None
    apart: tuple[float, float]
    before: float
    after: float
    load: Array
    windup: Array

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """K [N m/rad]; None where it may as well be infinite."""
        value, std = self.compliance
        return (1.0 / value, std / value**2) if value > SURE * std else None


@dataclass(frozen=True)
class _Rows:
    """Of one joint in one stretch. lag: q − q_link. load: τ_L. block: of each row. Shapes (N,)."""

    lag: Array
    load: Array
    speed: Array
    block: Array


def gears(tracks: Sequence[Sequence[Track]], recordings: Sequence[Sequence[Recording]]) -> tuple[Gear, ...]:
    """Every joint that has two encoders. Both: those fitted, those held out. Empty where no recording has `qlink`."""
    n = tracks[0][0].n
    halves = [
        [[_rows(track, own[track.piece.source], j) for track in half if track.piece.source in own] for j in range(n)]
        for half, group in zip(tracks, recordings, strict=True)
        for own in ({r.source: r for r in group if r.qlink is not None},)
    ]
    found = [_gear(j, *([rows for rows in half[j] if rows is not None] for half in halves)) for j in range(n)]
    return tuple(one for one in found if one is not None)


def _rows(track: Track, recording: Recording, joint: int) -> _Rows | None:
    """None where the joint has no second encoder, or does not move."""
    if not recording.has("qlink", recording.joints[joint]) or np.ptp(track.piece.q[:, joint]) < 1e-6:
        return None
    assert recording.qlink is not None
    first = int(np.argmin(np.abs(recording.t - track.piece.start)))
    link = recording.qlink[first : first + len(track.piece), joint]
    if not np.isfinite(link).all():
        return None
    moves = track.moves[:, joint]
    lag = track.reduce((track.piece.q[:, joint] - link)[:, None])[:, 0]
    speed, hastened = track.reduce(np.column_stack([track.fine.dq[:, joint], track.fine.ddq[:, joint]])).T
    load = track.torque[:, joint] - track.body.drive("rotor_inertia")[joint] * hastened
    block = np.searchsorted(block_starts(track.time - track.time[0], BLOCK), np.arange(len(track)), side="right")
    return _Rows(lag[moves], load[moves], speed[moves], block[moves])


def _columns(rows: _Rows, load: float, speed: float, play: bool) -> Array:
    """Of compliance, delay, friction, and play. Shape (N, 3 or 4)."""
    columns = [rows.load, rows.speed, np.tanh(rows.speed / (TURNED * speed))]
    return np.column_stack([*columns, 0.5 * np.tanh(rows.load / (TURNED * load))] if play else columns)


def _gear(joint: int, train: Sequence[_Rows], held_out: Sequence[_Rows]) -> Gear | None:
    if not train or not held_out:
        return None
    load, speed = (max(float(np.abs(getattr(rows, name)).max()) for rows in train) for name in ("load", "speed"))
    signs = np.concatenate([rows.load > 0.0 for rows in train])
    play = bool(BOTH < signs.mean() < 1.0 - BOTH)
    # encoders count from where each recording began: every stretch has a mean of its own
    parts = [(c - c.mean(axis=0), r.lag - r.lag.mean(), r.block) for r in train for c in (_columns(r, load, speed, play),)]
    A, y = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
    blocks = [(c[b == k], z[b == k]) for c, z, b in parts for k in np.unique(b)]
    size = np.linalg.norm(A, axis=0)
    if len(blocks) < LEAST_BLOCKS or np.linalg.cond(A / size) > 1e6:
        return None
    inverse = np.linalg.inv((A / size).T @ (A / size)) / np.outer(size, size)
    x = inverse @ (A.T @ y)
    scores = np.array([c.T @ (z - c @ x) for c, z in blocks])
    freedom = len(blocks) / max(len(blocks) - A.shape[1], 1)
    std = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse) * freedom)
    told = [(float(value), float(error)) for value, error in zip(x, std, strict=True)]
    lag = np.concatenate([r.lag - r.lag.mean() for r in held_out])
    columns = [_columns(r, load, speed, play) for r in held_out]
    centred = np.concatenate([c - c.mean(axis=0) for c in columns])
    return Gear(
        joint,
        told[0],
        told[3] if play else None,
        told[1],
        float(np.sqrt(np.mean(lag**2))),
        float(np.sqrt(np.mean((lag - centred @ x) ** 2))),
        np.concatenate([r.load for r in held_out]),
        lag - centred[:, 1] * x[1] + float(np.mean(np.concatenate(columns) @ (x * (np.arange(len(x)) != 1)))),
    )
