"""What the robot stands on, and what it touches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import factorial

import numpy as np

from ..identification.lowpass import Grid
from ..recordings.missing_values import runs
from .effect import CandidateModel, Effect, NonlinearParameter, beside, family, named
from .gear_dynamics import NEAR, SOFTEST, damped, oscillator, stepped
from .recorded_motion import RecordedMotion

Array = np.ndarray
PARTS = 40
"""Intervals of a recording among which a contact is looked for."""
FORCES = ((0.0, 0.0, 0.0), (0.15, 0.0, 0.0), (0.15, 1.0, 0.0), (0.4, 1.0, 0.0), (0.0, 0.0, 8.0))
"""Courses of a force: how much longer than the loud interval, over it, on either side; whether it swells; of any course, how many times
it is told at."""
BEYOND = 0.3
"""How far before and after the loud interval a force of any course is told, over its length."""

SHAKY, PATIENT = 16.0, 4.0
"""A clock that wavers shakes all joints at once, as a base does, and most where motion is fast: for some of the time, as a contact does."""
WAYS = ((0, 1), (3, 4), (5,), (3,), (4,))
"""Coordinates of a base that slides, rocks, turns about the vertical, or rocks about one axis."""
SWINGS = np.geomspace(1.5, 19.0, 11)
"""Frequencies of a base under an arm as it moves, tried [Hz]."""
DAMPINGS = (0.08, 0.3)
"""Damping ratios tried first: the second says where a resonance is that lies between two of those frequencies; it is turned from there."""
PEDESTAL, LIGHTEST, HEAVIEST, HEAVIER = 0.12, 0.02, 2.0, 2.5
"""Inertia of what the robot stands on, over the largest of the robot's with all joints at zero: tried first, at the least and at the most;
and the factor from one to those beside it."""
APART, FARTHEST = 1.15, 2.0
"""Of a base's frequencies about two axes, the second over the first: the factor from one to those beside it, and at the most."""


def _swung(t: RecordedMotion, s: CandidateModel) -> Array:
    """Torque of a base that swings on springs under the robot's reaction, a column for what pushes along each coordinate; its inertia is
    the arm's pose's, and the frequencies those of all joints at zero: a spring is the same in every recording.

    (M + I₀) ẍ + (∂τ/∂ẋ + D) ẋ + (∂τ/∂x + K) x = what the robot pushes beyond its mean (`Afloat`). A base that rocks also leans: its joints
    feel gravity turned, which is most of what a slow motion shows.
    """
    axes, dt = WAYS[int(s.values["way"])], 1.0 / t.band.rate_of(Grid.COARSE)
    own, stood = t.base_dynamics.cut(axes), t.upright_inertia[list(axes)]
    heavy = stood + s.values["stand"] * stood.max()
    spring = (
        2.0 * np.pi * s.values["frequency"] * s.values["apart"] ** np.arange(len(axes))
    ) ** 2 * heavy
    damping = 2.0 * s.values["damping"] * np.sqrt(spring * heavy)
    topples = float(
        np.abs(own.by_place).sum(axis=2).max() / spring.min()
    )  # a spring bears what gravity takes off it, or there is no base
    stiffness = np.diag(spring) + own.by_place * min(1.0, (1.0 - SOFTEST) / max(topples, 1e-9))
    motion = _carried(
        own.mass + np.diag(heavy - stood), own.by_speed + np.diag(damping), stiffness, own.force, dt
    )
    felt = [part @ moved for part, moved in zip(own.felt, motion, strict=True)]
    return t.lowpass(np.sum(felt, axis=0), Grid.COARSE)


def _carried(
    inertia: Array, damping: Array, stiffness: Array, force: Array, dt: float
) -> tuple[Array, Array, Array]:
    """Place, speed and acceleration of coupled masses under the force on each alone. Each step is exact for the means of all at its ends.
    Shapes (C, k, k), force (C, k) -> three of (C, k, k), a column each force."""
    count, k = force.shape
    if k == 1:  # in closed form
        m, d, s = (x[:, 0, 0] for x in (inertia, damping, stiffness))
        place, speed = oscillator(force[:, 0], m, s, d, dt)
        haste = (force[:, 0] - s * place - d * speed) / m
        return place[:, None, None], speed[:, None, None], haste[:, None, None]
    alone = force[:, :, None] * np.eye(k)
    m, d, s, f = (0.5 * (x[1:] + x[:-1]) for x in (inertia, damping, stiffness, alone))
    light = np.linalg.inv(m)
    fast = np.sqrt(
        np.abs(light @ s).sum(axis=2).max()
    )  # speeds are over it, so that all rates are of a size
    rate = np.zeros((count - 1, 2 * k, 2 * k))
    rate[:, :k, k:], rate[:, k:, :k], rate[:, k:, k:] = (
        fast * np.eye(k),
        -light @ s / fast,
        -light @ d,
    )
    push = np.concatenate([np.zeros((count - 1, k, k)), light @ f / fast], axis=1)
    turn, along = _exponential(rate * dt)
    start = np.concatenate([np.linalg.solve(stiffness[0], alone[0]), np.zeros((k, k))])
    state = stepped(turn, along @ push * dt, start)
    place, speed = state[:, :k], fast * state[:, k:]
    return place, speed, np.linalg.solve(inertia, alone - stiffness @ place - damping @ speed)


def _exponential(a: Array) -> tuple[Array, Array]:
    """exp(A), and ∫₀¹ exp(A s) ds: of halves of halves, in which nothing turns by more than a radian, by their series to the ninth power,
    then doubled (Higham, Functions of Matrices, 2008, ch. 10). Shapes (…, k, k)."""
    halved = max(0, int(np.ceil(np.log2(max(float(np.abs(a).sum(axis=-1).max()), 1e-300)))))
    unit, a = np.eye(a.shape[-1]), a * 0.5**halved
    square = a @ a
    cube = square @ a

    def series(order: int) -> Array:
        """Σ Aᵏ/(k + order)!, in powers of the cube (Paterson & Stockmeyer 1973)."""
        c = [1.0 / factorial(k + order) for k in range(10)]
        parts = [c[k] * unit + c[k + 1] * a + c[k + 2] * square for k in (0, 3, 6)]
        return parts[0] + cube @ (parts[1] + cube @ (parts[2] + c[9] * cube))

    whole, mean = series(0), series(1)
    for _ in range(halved):
        whole, mean = whole @ whole, 0.5 * (unit + whole) @ mean
    return whole, mean


def _compliance(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    def swing(
        way: int, damping: float, stand: float = PEDESTAL, apart: float = 1.0
    ) -> Callable[[float], CandidateModel]:
        def shape(frequency: float) -> CandidateModel:
            fixed = {
                "frequency": frequency,
                "damping": damping,
                "way": float(way),
                "stand": stand,
                "apart": apart,
            }

            def kin() -> list[NonlinearParameter]:
                near = beside(
                    frequency, NEAR, (swing(way, z, stand, apart) for z in damped(damping))
                )
                for p in (stand / HEAVIER, stand * HEAVIER):
                    if LIGHTEST < p < HEAVIEST:  # as fast under the arm as it moves
                        f = (
                            frequency
                            * _heavier(tracks, WAYS[way], p)
                            / _heavier(tracks, WAYS[way], stand)
                        )
                        near += beside(f, NEAR, [swing(way, damping, p, apart)])
                for r in (apart / APART, apart * APART) if len(WAYS[way]) > 1 else ():
                    if 1.0 / FARTHEST < r < FARTHEST:
                        near += beside(frequency, NEAR, [swing(way, damping, stand, r)])
                return near

            told = named(frequency=frequency)
            return CandidateModel(
                "base_compliance",
                None,
                _swung,
                fixed,
                parameters=told,
                plausible=_gives_way,
                variants=kin,
                allows_several=True,
                threshold_factor=SHAKY,
            )

        return shape

    for way, axes in enumerate(WAYS):
        frequencies = (SWINGS * _heavier(tracks, axes, PEDESTAL)).tolist()
        for damping in DAMPINGS:
            yield from family(frequencies, swing(way, damping))


def _heavier(tracks: Sequence[RecordedMotion], axes: Sequence[int], stand: float) -> float:
    """The frequency of a base on a stand with all joints at zero, over that under the arm as it moves: a straight one is light about the
    vertical."""
    stood, along = tracks[0].upright_inertia[list(axes)], list(axes)
    borne = np.mean([t.base_dynamics.mass[:, along, along].mean(axis=0) for t in tracks], axis=0)
    below = stand * stood.max()
    return float(np.exp(0.5 * np.mean(np.log((borne + below) / (stood + below)))))


def _gives_way(c: Array) -> bool:
    """Whether a base moves with what pushes it."""
    return bool(c.max() > 0.0 and c.min() > -0.3 * c.max() and c.max() < 4.0)


def _pushed(t: RecordedMotion, s: CandidateModel) -> Array:
    """Torque of a force in the base frame on the centre of a link, while it lasts: even, swelling and fading, or as it likes."""
    size = _course(t, s)
    torque = -np.einsum("tk,txj->tjkx", size, t.link_jacobians[:, s.joint_index])
    return t.lowpass(torque.reshape(*torque.shape[:2], -1), Grid.COARSE)


def _course(t: RecordedMotion, s: CandidateModel) -> Array:
    """How large a force is at the coarse samples, by as many functions as are needed to say so. Shape (C, k)."""
    assert s.interval is not None
    low, high = s.interval
    time = t.segment.start + np.arange(len(t.coarse_samples)) / t.band.rate_of(Grid.COARSE)
    u = (time - low) / (high - low)
    inside = (u > 0.0) & (u < 1.0) & (t.segment.source == s.source)
    if not s.values["knots"]:
        return np.where(inside, np.sin(np.pi * u) if s.values["swells"] else 1.0, 0.0)[:, None]
    count = int(s.values["knots"])
    u = (u + BEYOND) / (1.0 + 2.0 * BEYOND) * (count + 1.0)
    hats = np.maximum(1.0 - np.abs(u[:, None] - np.arange(1, count + 1)), 0.0)
    return hats * (t.segment.source == s.source)


def _largest(c: Array) -> dict[str, float]:
    """Force where it is largest."""
    return {"force": float(np.linalg.norm(c.reshape(-1, 3), axis=1).max())}


def _contact(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Where the residual is large for some of the time and the rest is quiet: the intervals that stand out most, and a little more."""
    for track in tracks:
        quiet = np.median(np.abs(track.residual), axis=0) + 1e-12
        loud = np.mean((track.residual / quiet) ** 2, axis=1)
        for low, high in _intervals(track.time, loud):
            for wider, swells, knots in FORCES:
                span = low - wider * (high - low), high + wider * (high - low)
                for joint in range(tracks[0].n):
                    fixed, where = {"swells": swells, "knots": knots}, track.segment.source
                    yield CandidateModel(
                        "contact",
                        joint,
                        _pushed,
                        fixed,
                        None,
                        span,
                        where,
                        _largest,
                        allows_several=True,
                        threshold_factor=PATIENT,
                    )


def _intervals(time: Array, loud: Array) -> list[tuple[float, float]]:
    """Up to two stretches of time in which the residual is loud, the loudest first."""
    size = max(4, len(loud) // PARTS)
    smooth = np.convolve(loud, np.ones(size) / size, mode="same")
    level = 3.0 * np.median(smooth)
    found = [
        (float(time[a]), float(time[min(b, len(time) - 1)]), float(smooth[a:b].sum()))
        for a, b in runs(smooth > level)
        if b - a >= 3
    ]
    return [(a, b) for a, b, _ in sorted(found, key=lambda f: -f[2])[:2]]


EFFECTS = (
    Effect(
        "base_compliance",
        "a mass on springs under the robot, that slides, rocks or turns (its frequency: all joints at zero)",
        _swung,
        _compliance,
        {"frequency": "Hz"},
        "the same resonance in all joints",
        ("elasticity", "backlash"),
        "a chirp of joint 1 with the arm stretched",
        form={"frequency": 0.2},
        residual_log_offset=2.0,
    ),
    Effect(
        "contact",
        "Jᵀ f on an interval",
        _pushed,
        _contact,
        {"force": "N"},
        "for some of the time only, in the joints before the contact",
        (),
        "the same motion without anything near the robot",
        form={"force": 0.1},
        residual_log_offset=0.5,
    ),
)
