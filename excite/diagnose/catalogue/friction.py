"""Friction beyond viscous and Coulomb."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ..effect import Effect, Shape, amplitude, column, named, positive, within
from ..track import Track

Array = np.ndarray


def _sign(track: Track, joint: int) -> Array:
    return np.tanh(track.fine.dq[:, joint] / track.widths[joint])


def _speed(track: Track, joint: int) -> Array:
    return np.asarray(track.fine.dq[:, joint])


def _fastest(tracks: Sequence[Track], joint: int) -> float:
    return max(float(np.abs(track.fine.dq[:, joint]).max()) for track in tracks)


def _asymmetric(tracks: Sequence[Track]) -> Iterator[Shape]:
    def parameters(viscous: float) -> Callable[[Array], dict[str, float]]:
        return lambda c: {"positive": viscous + float(c[0]), "negative": viscous - float(c[0])}

    for j in range(tracks[0].n):
        viscous = float(tracks[0].body.drive("viscous")[j])
        most = 1.5 * max(viscous, 1e-9)
        speed = column(j, lambda t, j: np.abs(_speed(t, j)))
        yield Shape("asymmetric_viscous", j, speed, parameters(viscous), within(-most, most))


def _stribeck(tracks: Sequence[Track]) -> Iterator[Shape]:
    def bump(t: Track, j: int, v: float, p: float) -> Array:
        return _sign(t, j) * np.exp(-((np.abs(_speed(t, j)) / v) ** p))

    for j in range(tracks[0].n):
        fastest = _fastest(tracks, j)
        for velocity in map(float, np.geomspace(0.01, 0.4, 9) * min(1.0, fastest)):
            for power in (1.0, 2.0):
                fixed = {"velocity": velocity, "exponent": power}
                yield Shape("stribeck", j, column(j, bump, velocity, power), named("amplitude", velocity=velocity), positive, fixed)


def _power(t: Track, j: int, p: float) -> Array:
    v = _speed(t, j)
    return np.asarray(np.tanh(v / t.widths[j]) * np.abs(v) ** p)


def _nonlinear(tracks: Sequence[Track]) -> Iterator[Shape]:
    for j in range(tracks[0].n):
        for power in (0.3, 0.5, 0.7, 1.4, 1.7, 2.0, 2.5, 3.0):
            yield Shape(
                "nonlinear_viscous", j, column(j, _power, power), named("coefficient", exponent=power), positive, {"exponent": power}
            )


def _drag(tracks: Sequence[Track]) -> Iterator[Shape]:
    for j in range(tracks[0].n):
        yield Shape("drag", j, column(j, lambda t, j: _speed(t, j) * np.abs(_speed(t, j))), named("coefficient"), positive)


def _load(tracks: Sequence[Track]) -> Iterator[Shape]:
    def rubbed(t: Track, j: int, p: float, scale: float) -> Array:
        return _sign(t, j) * scale * (np.abs(t.transmitted[:, j]) / scale) ** p

    for j in range(tracks[0].n):
        largest = max(*(float(np.abs(t.transmitted[:, j]).max()) for t in tracks), 1e-9)
        for power in (1.0, 1.5, 2.0):
            yield Shape("load_friction", j, column(j, rubbed, power, largest), named("mu"), within(0.0, 1.0), {"power": power})


def _position(tracks: Sequence[Track]) -> Iterator[Shape]:
    def waves(t: Track, j: int, k: float) -> Array:
        angle = k * t.fine.q[:, j]
        return np.column_stack([_sign(t, j) * np.cos(angle), _sign(t, j) * np.sin(angle)])

    for j in range(tracks[0].n):
        for order in (1.0, 2.0, 3.0, 4.0, 6.0):
            yield Shape("position_friction", j, column(j, waves, order), amplitude(), values={"order": order})


def dahl(q: Array, stiffness: float, start: float = 0.0) -> Array:
    """z of Dahl's model with unit friction: ż = σ q̇ (1 − z sgn q̇), exact for steps of constant speed. Shape (M,)."""
    steps = np.diff(q, prepend=q[0])
    out, z = np.empty(len(q)), start
    decay = np.exp(-stiffness * np.abs(steps))
    for k, (step, keep) in enumerate(zip(steps, decay, strict=True)):
        if step != 0.0:
            limit = 1.0 if step > 0.0 else -1.0
            z = limit + (z - limit) * keep
        out[k] = z
    return out


def _hysteresis(tracks: Sequence[Track]) -> Iterator[Shape]:
    def built(t: Track, j: int, stiffness: float) -> Array:
        return dahl(t.fine.q[:, j], stiffness) - _sign(t, j)

    def parameters(reach: float) -> Callable[[Array], dict[str, float]]:
        return lambda c: {"amplitude": float(c[0]), "stiffness": float(c[0] / reach)}

    for j in range(tracks[0].n):
        most = 3.0 * max(float(tracks[0].body.drive("coulomb")[j]), 1e-9)
        for reach in map(float, np.geomspace(1e-4, 3e-2, 8)):
            yield Shape("hysteresis", j, column(j, built, 1.0 / reach), parameters(reach), within(0.0, most), {"reach": reach})


def _friction(tracks: Sequence[Track]) -> Iterator[Shape]:
    def both(t: Track, j: int) -> Array:
        return np.column_stack([_sign(t, j), _speed(t, j)])

    for j in range(tracks[0].n):
        yield Shape("friction", j, column(j, both), named("coulomb", "viscous"), lambda c: bool(c[0] > 0.0 and c[1] > -0.2 * c[0]))


def _thermal(tracks: Sequence[Track]) -> Iterator[Shape]:
    def warmed(t: Track, j: int, constant: float, coulomb: float, viscous: float) -> Array:
        warm = 1.0 - np.exp(-(t.clock - t.clock[0]) / constant)
        return np.asarray(warm * (coulomb * _sign(t, j) + viscous * _speed(t, j)))

    length = max(float(np.ptp(t.clock)) for t in tracks)
    for j in range(tracks[0].n):
        coulomb, viscous = max(float(tracks[0].body.drive("coulomb")[j]), 1e-9), float(tracks[0].body.drive("viscous")[j])
        for constant in (0.1 * length, 0.3 * length, length, 3.0 * length):
            fixed = {"time_constant": constant}
            yield Shape(
                "thermal_drift", j, column(j, warmed, constant, coulomb, viscous), named("change", **fixed), within(-1.0, 5.0), fixed
            )


EFFECTS = (
    Effect(
        "asymmetric_viscous",
        "F_v+ for q̇ > 0, F_v− for q̇ < 0",
        _asymmetric,
        {"positive": "N m s/rad", "negative": "N m s/rad"},
        "torque against speed has another slope in each direction",
        ("thermal_drift", "drag"),
        "constant speeds in both directions, several of them",
    ),
    Effect(
        "stribeck",
        "(F_s − F_c) exp(−(|q̇|/v_s)^δ) sgn q̇ (Stribeck 1902; Armstrong-Hélouvry 1994)",
        _stribeck,
        {"amplitude": "N m", "velocity": "rad/s"},
        "friction is larger near zero speed",
        ("hysteresis", "nonlinear_viscous", "delay"),
        "a ladder of slow constant speeds, 1 mrad/s to 0.5 rad/s",
    ),
    Effect(
        "nonlinear_viscous",
        "F |q̇|^k sgn q̇",
        _nonlinear,
        {"coefficient": "N m (s/rad)^k", "exponent": "1"},
        "friction against speed is bent",
        ("drag", "stribeck", "thermal_drift"),
        "a wide range of constant speeds",
    ),
    Effect(
        "drag",
        "c q̇ |q̇|",
        _drag,
        {"coefficient": "N m s²/rad²"},
        "resistance grows with the square of speed",
        ("nonlinear_viscous",),
        "very fast motion",
    ),
    Effect(
        "load_friction",
        "μ |τ_L|^k sgn q̇ (Hamon, Gautier & Garrec 2010)",
        _load,
        {"mu": "1"},
        "friction grows with the torque carried",
        ("position_friction", "coupling"),
        "repeat the same trajectory with another load at the flange",
    ),
    Effect(
        "position_friction",
        "sgn q̇ (a cos kq + b sin kq)",
        _position,
        {"amplitude": "N m"},
        "friction depends on where the joint is",
        ("load_friction",),
        "the same stroke at shifted positions",
    ),
    Effect(
        "hysteresis",
        "F z, ż = σ q̇ (1 − z sgn q̇) (Dahl 1968) instead of F sgn q̇",
        _hysteresis,
        {"amplitude": "N m", "stiffness": "N m/rad"},
        "friction takes some way to build up after a reversal",
        ("delay", "backlash", "stribeck"),
        "strokes of many small amplitudes",
    ),
    Effect(
        "friction",
        "F_c sgn q̇ + F_v q̇, where the model has none",
        _friction,
        {"coulomb": "N m", "viscous": "N m s/rad"},
        "torque against the motion",
        ("stribeck",),
        "any motion in both directions",
        prior_only=True,
    ),
    Effect(
        "thermal_drift",
        "friction × (1 + c (1 − e^(−t/T)))",
        _thermal,
        {"change": "1", "time_constant": "s"},
        "friction changes over the run",
        ("asymmetric_viscous",),
        "a long run that ends with its first motion",
    ),
)
