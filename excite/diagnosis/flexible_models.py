"""Flexible models of torque that no effect of the catalogue describes.

They are further candidates of the selection: smooth functions of one or two states of the robot,
and linear resonances, at one joint each. Their coefficients are independent normal variables that
together may explain the present residual, so that the evidence weighs their flexibility (Rasmussen
& Williams, Gaussian Processes for Machine Learning, 2006, sec. 5.4). An effect of the catalogue has
few coefficients and wins where its form is right.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from .._types import FloatArray
from ..effects.effect import (
    CandidateModel,
    Effect,
    NonlinearParameter,
    single_joint_rows,
    within,
)
from ..effects.recorded_motion import Motions, RecordedMotion, split_by_motion
from ..identification.lowpass import Grid
from .motion_rows import MotionRows, motion_rows

UNMODELLED = "unknown"
"""Name of torque that no effect of the catalogue describes, as a candidate of the selection."""
SMOOTH_WAVES, FINE_WAVES = 12, 60
"""Half waves over the range of a joint: of a smooth curve, and of a bump of a few degrees."""
BUMPS = 7
"""Bumps over the range of each state of a surface: the square of their number are fitted."""
FREQUENCIES = np.geomspace(0.4, 15.0, 28)
"""Grid of resonance frequencies [Hz]; between two of them the frequency is optimised."""
MIN_PERIODS = 3.0
"""Periods of a resonance in the longest stretch, at least: a slow function shows fewer."""
DAMPING_RATIOS = (0.02, 0.1)
"""Damping ratios of resonances: of a liquid or a beam, and a wide one."""
DAMPING_STEP = 1.6
"""Factor by which the damping moves in a step of the optimisation."""
FREQUENCY_STEP = 1.05
"""Factor within which the frequency is optimised again after such a step."""
MIN_COLUMN_SHARE = 1e-3
"""RMS of a column over the largest from which it is fitted."""


EXPERIMENTS: Mapping[str, str] = {
    "position": "that joint alone, slowly back and forth over its range",
    "place": "that joint alone, slowly past the place, both ways",
    "position and direction": "that joint alone, slowly, with reversals at varied positions",
    "position and speed": "that joint alone over its range, at several constant speeds",
    "position and load": "that joint alone over its range, with and without a load",
    "speed and load": "constant speeds of that joint, with and without a load",
    "speed and acceleration": "the same path of that joint at full and at half speed",
    "positions of two joints": "each of the two joints alone, then both together",
    "speeds of two joints": "each of the two joints alone, then both together",
    "load of all joints": "that joint slowly, alone, then while the others move fast",
    "past acceleration": "a sharp stop, then standstill, which shows the oscillation alone",
    "past load": "a sharp stop, then standstill, which shows the oscillation alone",
}
"""By what a flexible model depends on: the experiment that would show the dependence alone."""


def flexible_models(
    motions: Motions, sigma: FloatArray, joints: Sequence[int] | None = None
) -> Iterator[CandidateModel]:
    """Yield the flexible models of some joints, of all if None.

    `sigma` is the RMS residual of each joint without them, shape (n,) [N m].
    """
    rows = motion_rows(motions)
    for j in range(rows.n) if joints is None else joints:
        columns = _Columns(motions, rows, j, float(sigma[j]))
        yield from _functions_of_state(columns)
        for state, drive in (("ddq", "past acceleration"), ("load", "past load")):
            yield from _resonances(columns, state, drive)


_FLEXIBLE = Effect(UNMODELLED, "a smooth function of one or two states", {}, "", "")
"""Definition of models that state their columns themselves."""


@dataclass(frozen=True)
class _Columns:
    """Makes candidate models from features of a joint at all rows of some motions."""

    motions: Motions
    rows: MotionRows
    joint: int
    sigma: float

    def model(self, features: FloatArray, regime: str, other: int | None = None) -> CandidateModel:
        """Return the model of features, shape (N, k), each scaled to unit RMS."""
        moving = self.rows.moving[:, self.joint]
        size = np.sqrt(moving @ np.square(features) / np.count_nonzero(moving))
        kept = size > MIN_COLUMN_SHARE * max(float(size.max(initial=0.0)), 1e-300)
        scaled = features[:, kept] / size[kept]
        parts = split_by_motion(scaled, self.motions)
        by_motion = {_key(motion): part for motion, part in zip(self.motions, parts, strict=True)}
        joint = self.joint

        def columns(motion: RecordedMotion) -> FloatArray:
            return single_joint_rows(motion, joint, by_motion[_key(motion)])

        return CandidateModel(
            _FLEXIBLE,
            joint,
            other=other,
            own_columns=columns,
            prior_std=self.sigma / np.sqrt(max(scaled.shape[1], 1)),
            signature=regime,
        )


def _key(motion: RecordedMotion) -> tuple[str, float]:
    """Source and start of a motion, by which its rows are found."""
    return motion.segment.source, motion.segment.start


def _functions_of_state(columns: _Columns) -> Iterator[CandidateModel]:
    """Yield curves of the position, and surfaces over pairs of states."""
    rows, j = columns.rows, columns.joint
    moving = rows.moving[:, j]

    def over_range(x: FloatArray) -> FloatArray:
        low, high = x[moving].min(), x[moving].max()
        return np.asarray((x - low) / max(high - low, 1e-12))

    def surface(x: FloatArray, y: FloatArray) -> FloatArray:
        pair = _bumps(over_range(x)), _bumps(over_range(y))
        return (pair[0][:, :, None] * pair[1][:, None, :]).reshape(len(x), -1)

    q, dq, ddq, load = (x[:, j] for x in (rows.q, rows.dq, rows.ddq, rows.load))
    place = over_range(q)
    smooth = _waves(place, SMOOTH_WAVES)
    yield columns.model(smooth, "position")
    yield columns.model(_waves(place, FINE_WAVES), "place")
    directed = np.hstack([smooth, rows.direction(j)[:, None] * smooth])
    yield columns.model(directed, "position and direction")
    yield columns.model(surface(q, dq), "position and speed")
    yield columns.model(surface(q, load), "position and load")
    yield columns.model(surface(dq, load), "speed and load")
    yield columns.model(surface(dq, ddq), "speed and acceleration")
    for k in (k for k in range(rows.n) if k != j):
        yield columns.model(surface(q, rows.q[:, k]), "positions of two joints", k)
        yield columns.model(surface(dq, rows.dq[:, k]), "speeds of two joints", k)
    if rows.n > 1:
        torque = np.abs(rows.motor_torque)
        torque = torque / np.maximum(torque.max(axis=0), 1e-300)
        total = torque.sum(axis=1) - torque[:, j]
        yield columns.model(surface(load, total), "load of all joints")
        yield columns.model(surface(dq, total), "load of all joints")


def _waves(place: FloatArray, count: int) -> FloatArray:
    """cos(π m x) for m = 1 … count, shape (N, count)."""
    return np.cos(np.pi * np.outer(place, np.arange(1, count + 1)))


def _bumps(place: FloatArray) -> FloatArray:
    """Gaussian bumps over the unit interval, shape (N, BUMPS)."""
    centres = np.linspace(0.0, 1.0, BUMPS)
    return np.exp(-0.5 * np.square((place[:, None] - centres) * (BUMPS - 1)))


def _resonances(columns: _Columns, state: str, regime: str) -> Iterator[CandidateModel]:
    """Yield oscillators z̈ + 2ζω ż + ω² z = u that an acceleration or a load drives."""
    states = [m.coarse_samples.ddq if state == "ddq" else m.rigid_torque for m in columns.motions]
    drives = [x[:, columns.joint] - x[:, columns.joint].mean() for x in states]
    resonance = _Resonance(
        name=UNMODELLED,
        equation="z̈ + 2ζω ż + ω² z = u",
        units={},
        signature="",
        experiment="",
        columns=columns,
        drives=drives,
        regime=regime,
    )
    longest = max(float(motion.time[-1] - motion.time[0]) for motion in columns.motions)
    grid_hertz = FREQUENCIES[FREQUENCIES * longest >= MIN_PERIODS]
    for damping in DAMPING_RATIOS:
        model = CandidateModel(resonance, columns.joint, {"frequency": 0.0, "damping": damping})
        for low, middle, high in zip(
            grid_hertz[:-2], grid_hertz[1:-1], grid_hertz[2:], strict=True
        ):
            grid = float(middle), float(low), float(high)
            yield NonlinearParameter(model, "frequency", *grid).current


@dataclass(frozen=True, eq=False, kw_only=True)
class _Resonance(Effect):
    """An oscillator driven by some torque: columns ω² z, ω ż, and free oscillation of a motion."""

    columns: _Columns
    drives: Sequence[FloatArray]
    regime: str

    def varied(self, model: CandidateModel, key: str, value: float) -> CandidateModel:
        values = {**model.values, key: value}
        driven = _driven(self.columns.motions, self.drives, values["frequency"], values["damping"])
        return replace(self.columns.model(driven, self.regime), definition=self, values=values)

    def variants(self, model: CandidateModel) -> list[NonlinearParameter]:
        ratios = (model.values["damping"] * f for f in (1.0 / DAMPING_STEP, DAMPING_STEP))
        variants = [model.with_values(damping=ratio) for ratio in ratios]
        return [within(variant, "frequency", FREQUENCY_STEP) for variant in variants]


@functools.lru_cache(2 * len(FREQUENCIES) * len(DAMPING_RATIOS))
def _oscillator(
    omega: float, damping: float, rate: float
) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return the filters (b, a) of ω² z and ω ż of an oscillator at a sampling rate [Hz].

    They are the bilinear transform s = c (1 − d)/(1 + d), c twice the sampling rate and d the delay
    of a row; `scipy.signal.bilinear` takes 2 ms for one of the hundreds that are compared.
    """
    c = 2.0 * rate
    square, mixed, constant = np.array([[1.0, -2.0, 1.0], [1.0, 0.0, -1.0], [1.0, 2.0, 1.0]])
    a = c**2 * square + 2.0 * damping * omega * c * mixed + omega**2 * constant
    return (omega**2 * constant / a[0], a / a[0]), (omega * c * mixed / a[0], a / a[0])


def _driven(
    motions: Motions, drives: Sequence[FloatArray], hertz: float, damping: float
) -> FloatArray:
    """States of an oscillator along some motions, shape (N, 2 + 2 motions)."""
    from scipy.signal import lfilter  # slow to import

    omega = 2.0 * np.pi * hertz
    driven, free = [], []
    for motion, u in zip(motions, drives, strict=True):
        rate = motion.band.rate_of(Grid.COARSE)
        states = [lfilter(b, a, u) for b, a in _oscillator(omega, damping, rate)]
        driven.append(motion.at_rows(np.column_stack(states), Grid.COARSE))
        clock = motion.time - motion.time[0]
        phase = omega * np.sqrt(max(1.0 - damping**2, 0.0)) * clock
        decay = np.exp(-damping * omega * clock)
        free.append(decay[:, None] * np.column_stack([np.cos(phase), np.sin(phase)]))
    return np.hstack([np.vstack(driven), linalg.block_diag(*free)])
