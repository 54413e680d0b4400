"""What the robot stands on, and what it touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from ...identify.band import Grid
from ..effect import Columns, Effect, Shape, named
from ..track import Track

Array = np.ndarray
PARTS = 40
"""Intervals of a recording among which a contact is looked for."""


def _reaction(track: Track) -> Array:
    """Force and moment of the rigid robot on its base, base frame, at the coarse samples. Shape (C, 6)."""
    robot, model, s = track.body.robot, track.body.model, track.coarse
    data = model.createData()
    out = np.empty((len(s), 6))
    roots = [i for i in range(1, model.njoints) if model.parents[i] == 0]
    for t, state in enumerate(zip(robot.expand(s.q), s.dq @ robot.spread.T, s.ddq @ robot.spread.T, strict=True)):
        pin.rnea(model, data, *state)
        out[t] = sum(data.liMi[i].act(data.f[i]).vector for i in roots)
    return out


def _sway(frequency: float, damping: float) -> Columns:
    """Torque of a base that sways horizontally under the robot's reaction: acceleration of a damped oscillator per unit of force."""

    def build(track: Track) -> Array:
        force = -_reaction(track)[:, :2]
        omega, rate = 2.0 * np.pi * frequency, track.band.rate_of(Grid.COARSE)
        padded = np.concatenate([force - force.mean(axis=0), np.zeros((len(force), 2))])
        s = 2j * np.pi * np.fft.rfftfreq(len(padded), 1.0 / rate)
        response = s**2 / (s**2 + 2.0 * damping * omega * s + omega**2)
        sway = np.fft.irfft(np.fft.rfft(padded, axis=0) * response[:, None], len(padded), axis=0)[: len(force)]
        columns = [track.gravity[:, :, axis] * sway[:, axis, None] for axis in range(2)]
        return track.reduce(np.stack(columns, axis=2), Grid.COARSE)

    return build


def _compliance(tracks: Sequence[Track]) -> Iterator[Shape]:
    for frequency in (4.0, 5.5, 7.0, 9.0, 11.0, 14.0, 18.0):
        for damping in (0.03, 0.1):
            fixed = {"frequency": frequency, "damping": damping}
            told = named(frequency=frequency)
            yield Shape("base_compliance", None, _sway(frequency, damping), told, lambda c: bool(c.max() > 0.0), fixed)


def _pushed(source: str, joint: int, low: float, high: float) -> Columns:
    """Torque of a constant force in the base frame at the origin of a link, while it lasts."""

    def build(track: Track) -> Array:
        robot, model, s = track.body.robot, track.body.model, track.coarse
        t = track.piece.start + np.arange(len(s)) / track.band.rate_of(Grid.COARSE)
        on = (t >= low) & (t < high) if track.piece.source == source else np.zeros(len(t), bool)
        out = np.zeros((len(s), robot.n, 3))
        data = model.createData()
        for k in np.flatnonzero(on):
            frame = model.nframes - 1
            full = np.reshape(pin.computeFrameJacobian(model, data, robot.expand(s.q[k]), frame, pin.LOCAL_WORLD_ALIGNED), (6, -1))
            J = full[:3].copy()
            J[:, joint + 1 :] = 0.0
            out[k] = -(J @ robot.spread).T
        return track.reduce(out, Grid.COARSE)

    return build


def _contact(tracks: Sequence[Track]) -> Iterator[Shape]:
    """Where the residual is large for some of the time and the rest is quiet: the intervals that stand out most."""
    n = tracks[0].n
    for track in tracks:
        left = track.torque - np.einsum("tip,p->ti", track.gamma, track.theta)
        quiet = np.median(np.abs(left), axis=0) + 1e-12
        loud = np.mean((left / quiet) ** 2, axis=1)
        for low, high in _intervals(track.time, loud):
            yield Shape(
                "contact",
                n - 1,
                _pushed(track.piece.source, n - 1, low, high),
                lambda c: {"force": float(np.linalg.norm(c))},
                interval=(low, high),
            )


def _intervals(time: Array, loud: Array) -> list[tuple[float, float]]:
    """Up to three stretches of time in which the residual is loud, the loudest first."""
    size = max(4, len(loud) // PARTS)
    smooth = np.convolve(loud, np.ones(size) / size, mode="same")
    level = 3.0 * np.median(smooth)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (smooth > level).astype(int), [0]])))
    found = [(float(time[a]), float(time[min(b, len(time) - 1)]), float(smooth[a:b].sum())) for a, b in edges.reshape(-1, 2) if b - a >= 3]
    return [(a, b) for a, b, _ in sorted(found, key=lambda f: -f[2])[:3]]


EFFECTS = (
    Effect(
        "base_compliance",
        "a mass on springs under the robot, horizontal",
        _compliance,
        {"frequency": "Hz"},
        "the same resonance in all joints",
        ("elasticity",),
        "a chirp of joint 1 with the arm stretched",
    ),
    Effect(
        "contact",
        "Jᵀ f on an interval",
        _contact,
        {"force": "N"},
        "for some of the time only, in the joints before the contact",
        (),
        "the same motion without anything near the robot",
    ),
)
