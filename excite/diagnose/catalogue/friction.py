"""Friction beyond viscous and Coulomb."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from ..effect import Effect, Shape, alone, amplitude, beside, family, named, positive, within
from ..track import Track, stroke

Array = np.ndarray
STICKIEST, LEAST_STUCK = 5.0, 0.05
"""Times Coulomb friction that friction at rest or before it slides can be. The base fit takes some of it for its own, and beside other
effects perhaps all: Coulomb friction is taken to be this share of the joint's largest torque, at the least."""
POWERS, NEARBY = (0.5, 1.0, 2.0), 1.2
"""Of a speed, by which friction fades, tried; and the factor from one to those beside it, between them."""
TOLD = 3.0
"""Times the speed at which a joint crosses one step of its encoder while it stays within one, where it turns back: how fast it goes below
that is not told, and friction that changes there is any. In 91 simulated robots with nothing missing it seemed to, seven times."""
POINTS = 200
"""A wave, that its largest and least are told from."""
SPRINGS, APART, SLIPS = (3, 5), 3.0, 0.5
"""How many springs make up friction's memory, as tried; each one's way until it slips, over that of the one before; and the last one's over
a joint's stroke, at the most: what never slips is a spring."""
BACKWARD = 0.05
"""Of all their force, what one of them may have against it by chance."""
FADING = 6.0
"""Times the usual gain that it takes to believe friction under load that fades with speed: what a coarse encoder makes of a reversal does
so too, wherever some load is."""


def _speed(track: Track, joint: int) -> Array:
    return np.asarray(track.fine.dq[:, joint])


def _fastest(tracks: Sequence[Track], joint: int) -> float:
    return max(float(np.abs(track.fine.dq[:, joint]).max()) for track in tracks)


def _slowest(tracks: Sequence[Track], joint: int) -> float:
    """Speed from which an encoder tells it, 0 where it is fine."""
    return TOLD * min((float(t.steps[joint] / t.stays[joint]) for t in tracks if 0.0 < t.stays[joint] < np.inf), default=0.0)


def _seen(speed: float, least: float, gate: Callable[[Array], bool]) -> Callable[[Array], bool]:
    """The gate of a law that changes at a speed: nothing passes where an encoder does not tell that."""
    return gate if speed > least else lambda c: False


def _stickiest(tracks: Sequence[Track], joint: int) -> float:
    """What friction before it slides can be, at the most [N m]."""
    largest = max(float(np.abs(track.torque[:, joint]).max()) for track in tracks)
    return STICKIEST * max(float(tracks[0].body.drive("coulomb")[joint]), LEAST_STUCK * largest, 1e-9)


def _slanted(t: Track, s: Shape) -> Array:
    return alone(t, s.place, np.abs(_speed(t, s.place)))


def _asymmetric(tracks: Sequence[Track]) -> Iterator[Shape]:
    def parameters(viscous: float) -> Callable[[Array], dict[str, float]]:
        return lambda c: {"positive": viscous + float(c[0]), "negative": viscous - float(c[0])}

    for j in range(tracks[0].n):
        viscous, coulomb = (max(float(tracks[0].body.drive(kind)[j]), 1e-9) for kind in ("viscous", "coulomb"))
        most = 1.5 * (viscous + coulomb / max(_fastest(tracks, j), 1e-9))  # what is dissipated in both directions, with all that resists
        yield Shape("asymmetric_viscous", j, _slanted, parameters=parameters(viscous), plausible=within(-most, most))


def _stuck(t: Track, s: Shape) -> Array:
    return alone(t, s.place, t.sign(s.place) * _faded(t, s))


def _stribeck(tracks: Sequence[Track]) -> Iterator[Shape]:
    def shaped(j: int, power: float, least: float, most: float) -> Callable[[float], Shape]:
        def shape(velocity: float) -> Shape:
            fixed = {"velocity": velocity, "exponent": power}
            told = named("amplitude", velocity=velocity)
            near = [p for p in (power / NEARBY, power * NEARBY) if POWERS[0] <= p <= POWERS[-1]]
            kin = lambda: beside(velocity, 2.0, (shaped(j, p, least, most) for p in near))  # noqa: E731
            gate = _seen(velocity, least, within(0.0, most))
            return Shape("stribeck", j, _stuck, fixed, parameters=told, plausible=gate, kin=kin)

        return shape

    for j in range(tracks[0].n):
        velocities = (np.geomspace(0.01, 0.4, 7) * min(1.0, _fastest(tracks, j))).tolist()
        least, most = _slowest(tracks, j), _stickiest(tracks, j)
        for power in POWERS:
            yield from family(velocities, shaped(j, power, least, most))


def _powered(t: Track, s: Shape) -> Array:
    return alone(t, s.place, t.sign(s.place) * np.abs(_speed(t, s.place)) ** s.values["exponent"])


def _nonlinear(tracks: Sequence[Track]) -> Iterator[Shape]:
    def bent(j: int) -> Callable[[float], Shape]:
        least = _slowest(tracks, j) / max(_fastest(tracks, j), 1e-9)

        def shape(power: float) -> Shape:
            told, rises = named("coefficient", exponent=power), 0.5 ** (1.0 / power)  # to half, at this part of the fastest
            return Shape("nonlinear_viscous", j, _powered, {"exponent": power}, parameters=told, plausible=_seen(rises, least, positive))

        return shape

    for j in range(tracks[0].n):
        shape = bent(j)
        yield from family((0.2, 0.35, 0.5, 0.7), shape)
        yield from family((1.4, 1.7, 2.0, 2.5, 3.2), shape)


def _windy(t: Track, s: Shape) -> Array:
    return alone(t, s.place, _speed(t, s.place) * np.abs(_speed(t, s.place)))


def _drag(tracks: Sequence[Track]) -> Iterator[Shape]:
    for j in range(tracks[0].n):
        yield Shape("drag", j, _windy, parameters=named("coefficient"), plausible=positive)


def _rubbed(t: Track, s: Shape) -> Array:
    """sgn q̇ times a power of the load: what the link weighs, or where it is `driven` what the motor makes. Where a `velocity` is stated,
    the same once more as far as it fades with speed."""
    scale, place = s.values["scale"], s.place
    load = (t.motor if "driven" in s.values else t.transmitted)[:, place]
    rubs = t.sign(place) * scale * (np.abs(load) / scale) ** s.values["power"]
    return alone(t, place, np.column_stack([rubs, rubs * _faded(t, s)]) if "velocity" in s.values else rubs)


def _faded(t: Track, s: Shape) -> Array:
    return np.asarray(np.exp(-((np.abs(_speed(t, s.place)) / s.values["velocity"]) ** s.values["exponent"])))


def _load(tracks: Sequence[Track]) -> Iterator[Shape]:
    def fading(j: int, fixed: Mapping[str, float]) -> Callable[[float], Shape]:
        def shape(velocity: float) -> Shape:
            bare = Shape("load_friction", j, _rubbed, {**fixed, "velocity": velocity}, plausible=_rubs, doubt=FADING)
            mean = float(np.mean(np.concatenate([_faded(t, bare) for t in tracks])))
            return replace(bare, parameters=lambda c: {"mu": float(c[0] + mean * c[1])})  # on the average of the motion

        return shape

    for j in range(tracks[0].n):
        scale = {"scale": max(*(float(np.abs(t.transmitted[:, j]).max()) for t in tracks), 1e-9)}
        speeds = (np.array([0.02, 0.06, 0.2]) * _fastest(tracks, j)).tolist()
        for powers, drive in ((1.0, 1.5, 2.0), {}), ((1.0,), {"driven": 1.0}):
            for power in powers:
                fixed = {"power": power, **scale, **drive}
                yield Shape("load_friction", j, _rubbed, fixed, parameters=named("mu"), plausible=within(0.0, 1.0))
            for exponent in (1.0, 2.0):
                yield from family(speeds, fading(j, {"power": 1.0, "exponent": exponent, **scale, **drive}))


def _rubs(c: Array) -> bool:
    """Friction that grows with the load at every speed, the more the slower."""
    return bool(c[0] >= 0.0 and c[1] > 0.0 and c[0] + c[1] < 1.0)


def _placed(t: Track, s: Shape) -> Array:
    """sgn q̇ times the first waves of a periodic function of position, as many as `waves` says, of `order`, 2 `order`, …; each less its mean
    over where the joint was: what does not vary there is Coulomb friction."""
    place, sign = t.fine.q[:, s.place], t.sign(s.place)
    everywhere = np.linspace(s.values["low"], s.values["high"], POINTS)
    waves = [(f, k * s.values["order"]) for k in range(1, int(s.values["waves"]) + 1) for f in (np.cos, np.sin)]
    return alone(t, s.place, np.column_stack([sign * (f(order * place) - f(order * everywhere).mean()) for f, order in waves]))


def _position(tracks: Sequence[Track]) -> Iterator[Shape]:
    def waved(j: int, waves: float) -> Callable[[float], Shape]:
        low, high = stroke(tracks, j)

        def shape(order: float) -> Shape:
            fixed = {"order": order, "waves": waves, "low": low, "high": high}
            return Shape("position_friction", j, _placed, fixed, parameters=amplitude(), several=True)

        return shape

    for j in range(tracks[0].n):
        yield from family((0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6), waved(j, 1.0))
        yield from family((0.5, 1.0, 2.0), waved(j, 3.0))


def _range(parts: Sequence[tuple[Shape, Array]]) -> dict[str, float]:
    """Half of how much friction varies where the joint was, all waves together."""
    first, turns = parts[0][0].values, max(shape.values["order"] * shape.values["waves"] for shape, _ in parts) / (2.0 * np.pi)
    angle = np.linspace(first["low"], first["high"], int(POINTS * max(1.0, turns * (first["high"] - first["low"]))) + 1)
    wave = np.zeros(len(angle))
    for shape, c in parts:
        for k, (cosine, sine) in enumerate(c.reshape(-1, 2), start=1):
            wave += cosine * np.cos(k * shape.values["order"] * angle) + sine * np.sin(k * shape.values["order"] * angle)
    return {"amplitude": 0.5 * float(np.ptp(wave))}


def dahl(q: Array, stiffness: float) -> Array:
    """z of Dahl's model with unit friction: ż = σ q̇ (1 − z sgn q̇), in closed form from one reversal to the next. Shape (M,)."""
    begins, way, gone = _strokes(q)
    limits, decays = np.sign(way), np.exp(-stiffness * np.abs(way))
    strokes = zip(limits.tolist(), decays.tolist(), strict=True)
    *starts, _ = accumulate(strokes, lambda z, stroke: stroke[0] + (z - stroke[0]) * stroke[1], initial=0.0)
    return np.asarray(limits[begins] + (np.array(starts) - limits)[begins] * np.exp(-stiffness * np.abs(gone)))


def slipping(q: Array, reach: float) -> Array:
    """Force of a spring of unit strength that slips `reach` from where it rests. Shape (M,)."""
    begins, way, gone = _strokes(q)
    *starts, _ = accumulate((way / reach).tolist(), lambda z, further: min(max(z + further, -1.0), 1.0), initial=0.0)
    return np.clip(np.array(starts)[begins] + gone / reach, -1.0, 1.0)


def _strokes(q: Array) -> tuple[Array, Array, Array]:
    """From one reversal to the next: of each sample, in which stroke it ends; of each stroke, how far it goes; of each sample, how far it
    is from where its stroke began. Shapes (M,), (strokes,), (M,)."""
    ways = np.sign(np.diff(q, prepend=q[0]))
    first = np.flatnonzero(np.diff(ways, prepend=2.0))  # of each stroke's samples; it begins at the one before
    begins = np.repeat(np.arange(len(first)), np.diff(first, append=len(q)))
    corners = q[np.maximum(first - 1, 0)]
    return begins, np.diff(corners, append=q[-1]), q - corners[begins]


def _softened(t: Track, s: Shape) -> Array:
    q, reach = t.fine.q[:, s.place], s.values["reach"]
    curves = [slipping(q, by * reach) for by in _ways(s)] if "springs" in s.values else [dahl(q, 1.0 / reach)]
    return alone(t, s.place, np.column_stack(curves) - t.sign(s.place)[:, None])


def _ways(s: Shape) -> Array:
    """After which a shape's springs slip, over that of the middle one. Shape (k,)."""
    count = int(s.values["springs"])
    return np.asarray(APART ** (np.arange(count) - count // 2))


def _hysteresis(tracks: Sequence[Track]) -> Iterator[Shape]:
    """Dahl's curve; beside it, springs that slip one after the other, for curves that begin steeper or bend later."""

    def slips(j: int, most: float, springs: int) -> Callable[[float], Shape]:
        low, high = stroke(tracks, j)

        def shape(reach: float) -> Shape:
            bare = Shape("hysteresis", j, _softened, {"reach": reach, "springs": float(springs)})
            ways = reach * _ways(bare)
            slip = bool(ways[-1] < SLIPS * (high - low))
            return replace(
                bare,
                parameters=lambda c: {"amplitude": float(c.sum()), "stiffness": float(np.sum(c / ways))},
                plausible=lambda c: slip and bool(0.0 < c.sum() < most and c.min() > -BACKWARD * c.sum()),
            )

        return shape

    def soft(j: int, most: float) -> Callable[[float], Shape]:
        def shape(reach: float) -> Shape:
            told = lambda c: {"amplitude": float(c[0]), "stiffness": float(c[0] / reach)}  # noqa: E731
            kin = lambda: beside(reach, 4.0, [slips(j, most, springs) for springs in SPRINGS])  # noqa: E731
            return Shape("hysteresis", j, _softened, {"reach": reach}, parameters=told, plausible=within(0.0, most), kin=kin)

        return shape

    for j in range(tracks[0].n):
        most = _stickiest(tracks, j)
        yield from family(np.geomspace(1e-4, 1e-1, 9).tolist(), soft(j, most))


def _steepest(parts: Sequence[tuple[Shape, Array]]) -> dict[str, float]:
    """Springs that slip sooner than the first would look the same: the slope that is told is known to what that one has of it."""
    shape, c = parts[0]
    return {"stiffness": abs(float(c[0])) / (float(_ways(shape)[0]) * shape.values["reach"])} if "springs" in shape.values else {}


def _resisted(t: Track, s: Shape) -> Array:
    return alone(t, s.place, np.column_stack([t.sign(s.place), _speed(t, s.place)]))


def _friction(tracks: Sequence[Track]) -> Iterator[Shape]:
    for j in range(tracks[0].n):
        told = named("coulomb", "viscous")
        yield Shape("friction", j, _resisted, parameters=told, plausible=lambda c: bool(c[0] > 0.0 and c[1] > -0.2 * c[0]))


EFFECTS = (
    Effect(
        "asymmetric_viscous",
        "F_v+ for q̇ > 0, F_v− for q̇ < 0",
        _slanted,
        _asymmetric,
        {"positive": "N m s/rad", "negative": "N m s/rad"},
        "torque against speed has another slope in each direction",
        ("thermal_drift", "drag"),
        "constant speeds in both directions, several of them",
        form={"positive": 0.09, "negative": 0.09},
        loose=0.4,
    ),
    Effect(
        "stribeck",
        "(F_s − F_c) exp(−(|q̇|/v_s)^δ) sgn q̇ (Stribeck 1902; Armstrong-Hélouvry 1994)",
        _stuck,
        _stribeck,
        {"amplitude": "N m", "velocity": "rad/s"},
        "friction is larger near zero speed",
        ("hysteresis", "nonlinear_viscous", "delay"),
        "a ladder of slow constant speeds, 1 mrad/s to 0.5 rad/s",
        form={"amplitude": 0.5, "velocity": 1.1},
    ),
    Effect(
        "nonlinear_viscous",
        "F |q̇|^k sgn q̇",
        _powered,
        _nonlinear,
        {"coefficient": "N m (s/rad)^k", "exponent": "1"},
        "friction against speed is bent",
        ("drag", "stribeck", "thermal_drift"),
        "a wide range of constant speeds",
        form={"coefficient": 0.25, "exponent": 0.25},
        loose=-0.6,
    ),
    Effect(
        "drag",
        "c q̇ |q̇|",
        _windy,
        _drag,
        {"coefficient": "N m s²/rad²"},
        "resistance grows with the square of speed",
        ("nonlinear_viscous",),
        "very fast motion",
    ),
    Effect(
        "load_friction",
        "μ |τ_L|^k sgn q̇ (Hamon, Gautier & Garrec 2010); |τ_L| (μ + μ_s exp(−(|q̇|/v)^δ)) sgn q̇ (Bittencourt & Gunnarsson 2012)",
        _rubbed,
        _load,
        {"mu": "1"},
        "friction grows with the torque carried",
        ("position_friction", "coupling"),
        "repeat the same trajectory with another load at the flange",
        form={"mu": 0.35},
    ),
    Effect(
        "position_friction",
        "sgn q̇ (a cos kq + b sin kq)",
        _placed,
        _position,
        {"amplitude": "N m"},
        "friction depends on where the joint is",
        ("load_friction",),
        "the same stroke at shifted positions",
        told=_range,
        form={"amplitude": 0.5},
        loose=-0.8,
    ),
    Effect(
        "hysteresis",
        "F z, ż = σ q̇ (1 − z sgn q̇) (Dahl 1968), or springs that slip, ż = q̇/s, |z| ≤ 1 (Iwan 1966), instead of F sgn q̇",
        _softened,
        _hysteresis,
        {"amplitude": "N m", "stiffness": "N m/rad"},
        "friction takes some way to build up after a reversal",
        ("delay", "backlash", "stribeck"),
        "strokes of many small amplitudes",
        form={"amplitude": 0.1, "stiffness": 0.4},
        loose=1.0,
        unseen=_steepest,
    ),
    Effect(
        "friction",
        "F_c sgn q̇ + F_v q̇, where the model has none",
        _resisted,
        _friction,
        {"coulomb": "N m", "viscous": "N m s/rad"},
        "torque against the motion",
        ("stribeck",),
        "any motion in both directions",
        prior_only=True,
        form={"coulomb": 0.04, "viscous": 0.04},
    ),
)
