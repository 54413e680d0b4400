"""What lies between motor and link: springs, lost motion, gears, and other joints' drives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from ..identification.lowpass import Grid
from .effect import CandidateModel, Effect, NonlinearParameter, alone, beside, family, named, within
from .gear_dynamics import NEAR, damped, felt, launched, mass, played, wound
from .recorded_motion import RecordedMotion, position_range

Array = np.ndarray


RESONANCES = np.geomspace(2.0, 34.0, 16)
"""Of a link on its motor, which stiffnesses are tried by [Hz]."""
STIFFER = 1.1
"""Factor between two stiffnesses whose wind-ups are compared."""
DAMPINGS = (0.07, 0.25)
"""Damping ratios of a link on its motor that are tried first: gears have a few per cent; the second says where a resonance is that lies
between two of those frequencies; it is turned from there."""
WIDTHS = np.geomspace(1e-4, 1e-2, 13)
"""Of play, tried [rad]."""
HOLDS, FURTHER, HARDEST = (0.0, 1.5, 3.0, 6.0, 12.0), 1.5, 20.0
"""Of a link in its play, tried [Hz]: the softer teeth meet, the more of it they hold; the factor from one to those beside it; and the most,
beyond which it is a spring."""
LEAST_STROKE, LEAST_TURN = 1e-6, 0.05
"""Of a joint, from which it moves at all, and from which more is said of its place than that it pulls [rad or m]."""


def _sprung(t: RecordedMotion, s: CandidateModel) -> Array:
    lag = wound(t, s.joint_index, s.values["stiffness"], s.values["damping"], bool(s.values["rests"]))
    return felt(t, s.joint_index, lag, Grid.COARSE)


def _carried(tracks: Sequence[RecordedMotion], joint: int, stiffness: float) -> float:
    """M ω² at the frequency that shows a stiff spring best [N m/rad]: a stiffer one's wind-up is less, as 1/(K − M ω²) is."""

    def torque(stiffness: float) -> Array:
        bare = CandidateModel(
            "elasticity",
            joint,
            _sprung,
            {"stiffness": stiffness, "damping": DAMPINGS[0], "rests": 0.0},
        )
        return np.concatenate([bare.columns(t) for t in tracks])

    one, other = torque(stiffness), torque(STIFFER * stiffness)
    alike = float(
        np.clip(np.sum(one * other) / max(float(np.sum(one * one)), 1e-300), 0.0, 1.0 / STIFFER)
    )
    return stiffness * (1.0 - STIFFER * alike) / (1.0 - alike)  # of (K − M ω²)/(1.1 K − M ω²)


def _elasticity(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """The wind-up for a stiffness, times a coefficient that should come out near 1; where it is too stiff to swing, at any below.

    A link that swings below the band tells its stiffness by how fast it does. Else by how far it lies behind, τ/(K − M ω²) at what shows
    that best: there a softer spring with a lesser coefficient looks the same, and it is the one with coefficient 1 that is told.
    """
    hertz = tracks[0].band.hertz

    def spring(
        joint: int,
        inertia: float,
        carried: float,
        rests: float,
        least: float,
        damping: float = DAMPINGS[0],
    ) -> Callable[[float], CandidateModel]:
        def shape(stiffness: float) -> CandidateModel:
            swings = np.sqrt(stiffness / inertia) < 2.0 * np.pi * hertz
            part = min(carried, stiffness)
            behind = lambda c: {"stiffness": float(part + (stiffness - part) / c[0])}  # noqa: E731
            told = named(stiffness=stiffness) if swings else behind
            fixed = {"stiffness": stiffness, "damping": damping, "rests": rests}

            def kin() -> list[NonlinearParameter]:
                return beside(
                    stiffness,
                    NEAR**2,
                    (spring(joint, inertia, carried, rests, least, z) for z in damped(damping)),
                )

            return CandidateModel(
                "elasticity",
                joint,
                _sprung,
                fixed,
                parameters=told,
                plausible=within(least, 3.0),
                variants=kin,
            )

        return shape

    for j in range(tracks[0].n):
        inertia = float(np.mean([mass(t, j).mean() for t in tracks]))
        grid = [float(inertia * (2.0 * np.pi * f) ** 2) for f in RESONANCES]
        carried = _carried(tracks, j, grid[-1])
        for rests in (0.0, 1.0) if any(launched(t, j) for t in tracks) else (0.0,):
            for damping in DAMPINGS:
                yield from family(grid[:-1], spring(j, inertia, carried, rests, 0.3, damping))
        yield spring(j, inertia, carried, 0.0, 0.01)(grid[-1])


def _loose(t: RecordedMotion, s: CandidateModel) -> Array:
    return felt(t, s.joint_index, played(t, s.joint_index, s.values["width"], s.values["hold"]), Grid.RECORDED)


def _backlash(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    hardest = min(
        HARDEST, *(t.segment.rate / (2.0 * np.pi) for t in tracks)
    )  # that samples can follow

    def play(joint: int, hold: float) -> Callable[[float], CandidateModel]:
        def shape(width: float) -> CandidateModel:
            told = lambda c: {"width": float(width * c[0])}  # noqa: E731
            fixed = {"width": width, "hold": hold}
            near = [hold * by for by in (1.0 / FURTHER, FURTHER) if 0.0 < hold * by <= hardest]
            kin = lambda: beside(width, FURTHER, (play(joint, h) for h in near))  # noqa: E731
            return CandidateModel(
                "backlash",
                joint,
                _loose,
                fixed,
                parameters=told,
                plausible=within(0.4, 2.5),
                variants=kin,
            )

        return shape

    for j in range(tracks[0].n):
        if any(
            np.ptp(np.sign(t.rigid_torque[:, j])) > 1.0 for t in tracks
        ):  # else it lies on one flank, like a link that is mounted askew
            for hold in (h for h in HOLDS if h <= hardest):
                yield from family(WIDTHS.tolist(), play(j, hold))


FORMS: tuple[Callable[[Array], Array], ...] = (
    lambda q: q[:, None],
    lambda q: np.column_stack([np.cos(q), np.sin(q)]),
    lambda q: np.column_stack([q, q**2]),
    lambda q: np.column_stack([q, q**2, q**3]),
    lambda q: np.column_stack([np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)]),
)
"""Of a spring, over its joint's angle."""
SLOW, BENDS = (0.35, 0.6, 0.9), np.linspace(0.15, 0.85, 8)
"""Waves of a spring's torque over the range seen, and shares of it from which its slope is another, tried."""
SPANS = 200
"""Angles that a spring's torque is told from: its stiffness is the slope where it is steepest, with the sign of all of it, its amplitude
half of what it varies by."""


def _force(values: Mapping[str, float], q: Array) -> Array:
    """Columns of a spring's torque over its joint's angle. Shape (M,) -> (M, k)."""
    if "bend" in values:
        away = q - values["bend"]
        return np.column_stack([np.minimum(away, 0.0), np.maximum(away, 0.0)])
    if "order" in values:
        away = q - values["about"]
        return np.column_stack(
            [away, np.cos(values["order"] * away) - 1.0, np.sin(values["order"] * away)]
        )
    return FORMS[int(values["form"])](q)


def _pulled(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(t, s.joint_index, _force(s.values, t.samples.q[:, s.joint_index]))


def _spring(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Laws of the field; a line with a slow wave about it, for those that stiffen, yield or turn over; and one with a bend: a stop, a slack
    cable. Both are nothing in the middle and at the bend: a constant torque is an offset."""

    def laws(j: int, low: float, high: float) -> Iterator[CandidateModel]:
        q = np.linspace(low, high, SPANS)

        def law(**values: float) -> CandidateModel:
            def told(c: Array) -> dict[str, float]:
                torque = _force(values, q) @ c
                steepest = np.abs(np.gradient(torque, q)).max() * np.sign((q - q.mean()) @ torque)
                return {"stiffness": float(steepest), "amplitude": 0.5 * float(np.ptp(torque))}

            return CandidateModel("spring", j, _pulled, values, parameters=told)

        for form in range(len(FORMS)):
            yield law(form=float(form))
        if high - low > LEAST_TURN:
            slow = (2.0 * np.pi / (high - low) * np.array(SLOW)).tolist()
            yield from family(slow, lambda order: law(order=order, about=0.5 * (low + high)))
            yield from family(((high - low) * BENDS).tolist(), lambda into: law(bend=low + into))

    for j in range(tracks[0].n):
        low, high = position_range(tracks, j)
        if high - low >= LEAST_STROKE:
            yield from laws(j, low, high)


RATIOS = (0.5, 1.0, 2.0)
"""Of a shaft's turns by the other joint over those by its own, tried with either sign."""
AGAINST = 0.1
"""Share of a coupling's torque that may have the wrong sign by chance."""


def _turned(t: RecordedMotion, s: CandidateModel) -> Array:
    """Friction and inertia of a shaft that turns with w = q̇ᵢ + r q̇ⱼ, as joint i feels them: viscous w, Coulomb sgn w, inertia r q̈ⱼ.

    What w, sgn q̇ᵢ and q̈ᵢ have of joint i's own is the base model's. A shaft whose inertia does not show has none: fitted, it would be
    whatever else is left, and of either sign.
    """
    assert s.other is not None
    ratio = s.values["ratio"]
    speed = t.samples.dq[:, s.joint_index] + ratio * t.samples.dq[:, s.other]
    columns = [speed, np.tanh(speed / t.widths[s.joint_index]), ratio * t.samples.ddq[:, s.other]]
    return alone(t, s.joint_index, np.column_stack(columns[:2] if "light" in s.values else columns))


def _rubs(speed: float, acceleration: float) -> Callable[[Array], bool]:
    """Whether a shaft takes energy, slow or as fast as `speed`, and has mass, as far as `acceleration` shows it.

    The power of viscous w + Coulomb sgn w is a sum of squares in w: neither may be negative, whatever the ratio.
    """

    def plausible(c: Array) -> bool:
        parts = c * np.array([speed, 1.0, acceleration])[: len(c)]
        return bool(parts[:2].max() > 0.0 and parts.min() > -AGAINST * parts.max())

    return plausible


def _coupling(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Shafts that either joint turns the faster, either way round, with inertia and without."""
    n = tracks[0].n

    def shaft(i: int, j: int, sign: float, light: bool) -> Callable[[float], CandidateModel]:
        def shape(ratio: float) -> CandidateModel:
            turns, hastes = (
                max(float(np.abs(x[:, i] + sign * ratio * x[:, j]).max()) for x in both)
                for both in ([t.samples.dq for t in tracks], [t.samples.ddq for t in tracks])
            )
            fixed = {"ratio": sign * ratio} | ({"light": 1.0} if light else {})
            told = named("viscous", "coulomb", "inertia")
            return CandidateModel(
                "coupling", i, _turned, fixed, j, parameters=told, plausible=_rubs(turns, hastes)
            )

        return shape

    for i in range(n):
        for j in range(max(0, i - 2), min(n, i + 3)):
            for sign, light in product((1.0, -1.0), (False, True)) if i != j else ():
                yield from family(RATIOS, shaft(i, j, sign, light))


EFFECTS = (
    Effect(
        "elasticity",
        "a link that swings on K behind its motor (Spong 1987), on the motor's encoder",
        _sprung,
        _elasticity,
        {"stiffness": "N m/rad"},
        "residual like the second derivative of the load",
        ("delay", "base_compliance"),
        "fast motion at several poses",
        form={"stiffness": 0.14},
        residual_log_offset=2.0,
    ),
    Effect(
        "backlash",
        "a link that flies from flank to flank of a play b, on the motor's encoder",
        _loose,
        _backlash,
        {"width": "rad"},
        "a kick where the load changes sign",
        ("hysteresis", "elasticity"),
        "slow reversals through zero load",
        form={"width": 0.47},
        residual_log_offset=3.0,
    ),
    Effect(
        "spring",
        "a conservative torque of position: k q, K sin(q + φ), …",
        _pulled,
        _spring,
        {"stiffness": "N m/rad", "amplitude": "N m"},
        "the same in both directions, pose alone",
        ("payload", "gravity_tilt"),
        "poses up to both ends",
        form={
            "stiffness": 1.0,
            "amplitude": 0.25,
        },  # a refit base takes as much of a slope for gravity as a law lets it
        residual_log_offset=-0.9,
    ),
    Effect(
        "coupling",
        "friction and inertia of a shaft that turns with q̇ᵢ + r q̇ⱼ (a drive that another joint turns too)",
        _turned,
        _coupling,
        {"viscous": "N m s/rad", "coulomb": "N m", "inertia": "kg m²"},
        "torque where only the other joint moves",
        ("load_friction",),
        "each joint singly, then together",
        form={"viscous": 0.1, "coulomb": 0.1, "inertia": 0.1},
        residual_log_offset=-0.4,
    ),
)
