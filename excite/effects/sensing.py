"""Clocks and encoders."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from ..identification.lowpass import Grid
from .effect import (
    MULTIPLES,
    CandidateModel,
    Effect,
    amplitude,
    beside,
    family,
    named,
    waves,
    within,
)
from .recorded_motion import RecordedMotion

Array = np.ndarray
LATE = (0.003, 0.008, 0.02)
"""Delays that are tried [s]."""
SLOPED = 0.05
"""Up to which a slope tells them [s]."""
BEHIND, AHEAD = 0.1, 0.3
"""Of the time that a joint stays within one step of its encoder where it turns back: no torque is told to come later, or earlier, by less.
The smoothest motion within the steps turns back late where friction is much, and torque seems early: of 91 simulated robots with nothing
missing by up to 0.27 of it, and late by 0.08."""
MISREAD = 0.1
"""What no encoder is off by [rad]."""
MISTAKEN, NEAR = 1.5, 1.25
"""The order of a wave with its multiples over that for which it may be mistaken, two of whose three waves are near two of its own; and how
far it may be from there."""
BLURRED = 6.0
"""Whatever blurs positions puts the steps of friction at another time."""


def _late(t: RecordedMotion, s: CandidateModel) -> Array:
    """−τ̇ of one joint or of all; or what it was some time ago, or what passes a filter of first order, less what it is, over the time.

    Of the base model's torque, or of what was measured: whatever else is hidden comes late too, but there is noise in it. A signal's
    slope says nothing of the signal itself; what it was some time ago does, which is why that is the base model's alone.
    """
    seconds = s.values.get("seconds", 0.0)
    if not seconds:
        return _of(
            s,
            -t.band.transform(t.measured_torque if s.values["measured"] else t.motor_torque).filter(
                t.grid, 1
            )[t.kept],
        )
    if "lagging" in s.values:
        of_all = t.band.transform(t.motor_torque)
        return _of(
            s,
            (of_all.filter(t.grid, time_constant=seconds) - of_all.filter(t.grid))[t.kept]
            / seconds,
        )
    then = np.column_stack([np.interp(t.times - seconds, t.times, x) for x in t.motor_torque.T])
    return _of(s, t.lowpass((then - t.motor_torque) / seconds))


def _behind(t: RecordedMotion, s: CandidateModel, c: Array, made: Array) -> Array:
    """What a delay of all that was measured adds to what is made. Shape (M, n)."""
    late = np.column_stack([np.interp(t.times - float(c[0]), t.times, column) for column in made.T])
    return _of(s, late - made)[:, :, 0]


def _of(s: CandidateModel, torque: Array) -> Array:
    """Of all joints' torque that of the shape's joint, or all of it. Shape (N, n) -> (N, n, 1)."""
    if s.joint is None:
        return torque[:, :, None]
    out = np.zeros((*torque.shape, 1))
    out[:, s.joint, 0] = torque[:, s.joint]
    return out


def _delay(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """To first order, ahead or behind; and behind by so much that a slope does not tell it, by a clock or by a filter."""

    def behind(joint: int | None, how: Mapping[str, float]) -> Callable[[float], CandidateModel]:
        def shape(seconds: float) -> CandidateModel:
            gate, fixed = within(0.5 * seconds, 2.0 * seconds), {"seconds": seconds, **how}
            return CandidateModel(
                "delay",
                joint,
                _late,
                fixed,
                parameters=named("seconds"),
                plausible=gate,
                threshold_factor=BLURRED,
            )

        return shape

    alone = tracks[0].n == 1  # the joint is the whole robot
    hides = min(
        (float(t.reversal_dwell.min()) for t in tracks if np.isfinite(t.reversal_dwell).any()),
        default=0.0,
    )
    gate = _told(BEHIND * hides, AHEAD * hides)
    for joint in (*(() if alone else (None,)), *range(tracks[0].n)):
        for measured in (0.0, 1.0):
            yield CandidateModel(
                "delay",
                joint,
                _late,
                {"measured": measured},
                parameters=named("seconds"),
                plausible=gate,
                threshold_factor=BLURRED,
            )
        for how in ({}, {"lagging": 1.0}):
            yield from family(LATE, behind(joint, how))


def _told(later: float, earlier: float) -> Callable[[Array], bool]:
    """Torque comes later, or earlier, by so much at the least, and by less than a slope tells."""
    return lambda c: bool(later <= c[0] < SLOPED or earlier <= -c[0] < SLOPED)


def _misread(t: RecordedMotion, s: CandidateModel) -> Array:
    """Torque when a joint is where its encoder says less an error: −(∂τ/∂q δ + ∂τ/∂q̇ δ̇ + (M + I_a) δ̈)."""
    joint = s.joint_index
    by_q, by_v, mass = (matrix[:, :, joint, None] for matrix in t.derivatives)
    shifts = waves(s.values, t.coarse_samples.q[:, joint])
    line = t.band.transform(shifts, Grid.COARSE)
    first, second = line.filter(Grid.COARSE, 1, 2.0), line.filter(Grid.COARSE, 2, 2.0)
    torque = by_q * shifts[:, None] + by_v * first[:, None] + mass * second[:, None]
    torque[:, joint] += (
        t.fitted_robot.drive("rotor_inertia")[joint] * second
        + t.fitted_robot.drive("viscous")[joint] * first
    )
    return -t.lowpass(torque, Grid.COARSE)


def _encoder(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """A wave; and one with its multiples: of a disc off its centre, which torque shows by the square of their order."""

    def small(c: Array) -> bool:
        return bool(np.hypot(c[::2], c[1::2]).max() < MISREAD)

    def wrong(j: int, more: Mapping[str, float]) -> Callable[[float], CandidateModel]:
        def shape(order: float) -> CandidateModel:
            fixed, told = {"order": order, **more}, amplitude(order=order)
            kin = lambda: beside(MISTAKEN * order, NEAR, [wrong(j, more)] if more else [])  # noqa: E731
            return CandidateModel(
                "encoder_error",
                j,
                _misread,
                fixed,
                parameters=told,
                plausible=small,
                allows_several=True,
                variants=kin,
            )

        return shape

    for j in range(tracks[0].n):
        yield from family((0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0), wrong(j, {}))
        yield from family((1.0, 1.6, 2.5, 4.0), wrong(j, dict.fromkeys(MULTIPLES.values(), 1.0)))


EFFECTS = (
    Effect(
        "delay",
        "τ(t − d) ≈ τ − d τ̇, or behind a filter, d τ̇_told = τ − τ_told",
        _late,
        _delay,
        {"seconds": "s"},
        "residual like the slope of torque",
        ("hysteresis", "elasticity", "stribeck"),
        "fast, jerky motion; the same delay on all joints is the logging's",
        form={"seconds": 0.1},
        recorded=_behind,
    ),
    Effect(
        "encoder_error",
        "q + ε cos(kq + φ), with its multiples",
        _misread,
        _encoder,
        {"amplitude": "rad", "order": "1/turn"},
        "once or a few times a turn, growing with the square of speed",
        ("torque_ripple",),
        "constant speeds, slow and fast, over a turn",
        form={"amplitude": 0.4, "order": 0.4},
        residual_log_offset=0.8,
    ),
)
