"""What lies between motor and link: springs, lost motion, gears, and other joints' drives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ...identify.band import Grid
from ..effect import Columns, Effect, Shape, amplitude, column, named, within
from ..track import Track

Array = np.ndarray


def moved_link(joint: int, lag: Callable[[Track], Array]) -> Columns:
    """Torque on all joints when a link lies `lag` behind its motor [rad, at the coarse samples].

    First order: −(∂τ/∂q δ + ∂τ/∂q̇ δ̇ + M δ̈), the rotor staying with the encoder.
    """

    def build(track: Track) -> Array:
        by_q, by_v, mass = track.derivatives
        shift = lag(track)
        rate = track.band.rate_of(Grid.COARSE)
        first = np.gradient(shift, 1.0 / rate)
        second = np.gradient(first, 1.0 / rate)
        torque = by_q[:, :, joint] * shift[:, None] + by_v[:, :, joint] * first[:, None] + mass[:, :, joint] * second[:, None]
        return -track.reduce(torque, Grid.COARSE)[:, :, None]

    return build


def _smooth(track: Track, x: Array) -> Array:
    """Below one band, on the coarse grid: twice differentiated, what is above would drown everything."""
    lines = track.band.transformed(x, Grid.COARSE)
    return lines.low(Grid.COARSE, 0, 1.0)


def _elasticity(tracks: Sequence[Track]) -> Iterator[Shape]:
    def loaded(joint: int) -> Callable[[Track], Array]:
        return lambda t: _smooth(t, t.rigid[:, joint])

    for j in range(tracks[0].n):
        yield Shape("elasticity", j, moved_link(j, loaded(j)), lambda c: {"stiffness": float(1.0 / c[0])}, within(1e-7, 1.0))


def _backlash(tracks: Sequence[Track]) -> Iterator[Shape]:
    def lost(joint: int, soft: float) -> Callable[[Track], Array]:
        return lambda t: _smooth(t, 0.5 * np.tanh(t.rigid[:, joint] / soft))

    for j in range(tracks[0].n):
        load = max(*(float(np.std(t.rigid[:, j])) for t in tracks), 1e-9)
        for soft in (0.02, 0.1):
            yield Shape("backlash", j, moved_link(j, lost(j, soft * load)), named("width"), within(0.0, 0.05), {"softness": soft})


def _ripple(tracks: Sequence[Track]) -> Iterator[Shape]:
    def waves(t: Track, j: int, k: float) -> Array:
        angle = k * t.fine.q[:, j]
        return np.column_stack([np.cos(angle), np.sin(angle)])

    for j in range(tracks[0].n):
        for order in _orders(tracks, j):
            yield Shape("torque_ripple", j, column(j, waves, order), amplitude(order=order), values={"order": order})


def _orders(tracks: Sequence[Track], joint: int, most: int = 12) -> list[float]:
    """Orders at which the base fit's residual has power, found on a fine grid from 3 to 300 a turn (Lomb 1976, over angle)."""
    track = max(tracks, key=len)
    left = track.torque[:, joint] - track.gamma[:, joint] @ track.theta
    q = np.interp(track.time, track.clock, track.fine.q[:, joint])
    turn = float(np.ptp(q))
    if turn < 0.05:
        return []
    speed = np.interp(track.time, track.clock, track.fine.dq[:, joint])
    step = 2.0 * np.pi / turn / 3.0
    orders = np.arange(max(3.0, 2.0 * step), 300.0, max(step, 0.05))

    def power(order: float) -> float:
        seen = np.abs(order * speed) < 2.0 * np.pi * track.band.hertz  # the rest is above the band
        if seen.sum() < 0.05 * len(seen):
            return 0.0
        return float(((left @ (np.cos(order * q) * seen)) ** 2 + (left @ (np.sin(order * q) * seen)) ** 2) / seen.sum())

    found = np.array([power(order) for order in orders])
    out: list[float] = []
    for i in np.argsort(-found):
        if len(out) >= most:
            break
        if found[i] > 0.0 and all(abs(orders[i] - other) > 1.5 * step for other in out):
            out.append(float(max(orders[i] + step * np.linspace(-1.0, 1.0, 41), key=power)))
    return out


FORMS: dict[str, Callable[[Array], Array]] = {
    "linear": lambda q: q[:, None],
    "sine": lambda q: np.column_stack([np.cos(q), np.sin(q)]),
    "square": lambda q: np.column_stack([q, q**2]),
    "double": lambda q: np.column_stack([np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)]),
}


def _spring(tracks: Sequence[Track]) -> Iterator[Shape]:
    def pose(form: Callable[[Array], Array]) -> Callable[[Track, int], Array]:
        return lambda t, j: form(t.fine.q[:, j])

    for j in range(tracks[0].n):
        for number, (name, form) in enumerate(FORMS.items()):
            parameters = named("stiffness") if name == "linear" else amplitude()
            yield Shape("spring", j, column(j, pose(form)), parameters, values={"form": float(number)})


def _rubs(c: Array) -> bool:
    """Whether a coupling takes energy and has mass."""
    return bool(c[0] > 0.0 and c[1] > 0.0 and c[2] > -0.1 * (c[0] + c[1]))


def _coupling(tracks: Sequence[Track]) -> Iterator[Shape]:
    def turned(other: int, sign: float) -> Callable[[Track, int], Array]:
        """Friction of the sum or difference of two speeds, or of the other one's alone (sign 0), and its inertia."""

        def build(t: Track, j: int) -> Array:
            speed = t.fine.dq[:, other] + (sign * t.fine.dq[:, j] if sign else 0.0)
            return np.column_stack([speed, np.tanh(speed / t.widths[other]), t.fine.ddq[:, other]])

        return build

    n = tracks[0].n
    for i in range(n):
        for j in range(max(0, i - 2), min(n, i + 3)):
            for sign in (1.0, -1.0, 0.0) if i != j else ():
                told = named("viscous", "coulomb", "inertia")
                yield Shape("coupling", i, column(i, turned(j, sign)), told, _rubs, {"sign": sign}, other=j)


EFFECTS = (
    Effect(
        "elasticity",
        "link at θ − τ_L/K (Spong 1987), to first order in 1/K on the motor's encoder",
        _elasticity,
        {"stiffness": "N m/rad"},
        "residual like the second derivative of the load",
        ("delay", "base_compliance"),
        "fast motion at several poses",
    ),
    Effect(
        "backlash",
        "link at θ − (b/2) sgn τ_L, to first order",
        _backlash,
        {"width": "rad"},
        "a kick where the load changes sign",
        ("hysteresis", "elasticity"),
        "slow reversals through zero load",
    ),
    Effect(
        "torque_ripple",
        "A cos kq + B sin kq",
        _ripple,
        {"order": "1/turn", "amplitude": "N m"},
        "periodic in the angle, whatever the speed",
        ("encoder_error",),
        "slow constant speed over a turn",
    ),
    Effect(
        "spring",
        "a conservative torque of position: k q, K sin(q + φ), …",
        _spring,
        {"stiffness": "N m/rad", "amplitude": "N m"},
        "the same in both directions, pose alone",
        ("payload", "gravity_tilt"),
        "poses up to both ends",
    ),
    Effect(
        "coupling",
        "friction and inertia of q̇ᵢ ± q̇ⱼ (a drive that turns with another joint)",
        _coupling,
        {"viscous": "N m s/rad", "coulomb": "N m", "inertia": "kg m²"},
        "torque where only the other joint moves",
        ("load_friction",),
        "each joint singly, then together",
    ),
)
