"""Reader of `trajectory.json` for the simulator, independent of `trajectory/trajectory_file.py`.

The simulator shares no code with the design, so that neither can hide an error of the other
(`tests/test_architecture.py`). The commanded motion is a finite Fourier series between ramps of
piecewise constant jerk (`trajectory.json`), or between smooth blends.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput

SCHEMA = "excite.trajectory/1"
"""Schema of a trajectory file."""


@dataclass(frozen=True)
class ReferenceTrajectory:
    """A commanded motion.

    Attributes:
        joints: Names of the n joints.
        at: Function from times of shape (N,) [s] to position, velocity and acceleration, each of
            shape (N, n).
        duration: End of the motion [s].
        period: Period of the excitation [s].
        periodic: Begin and end of the part that repeats [s]; equal where nothing moves in it, as in
            a motion between static poses.
        robot: The `robot` of the trajectory file.
    """

    joints: tuple[str, ...]
    at: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
    duration: float
    period: float
    periodic: tuple[float, float]
    robot: Mapping[str, Any]


def read_reference(path: Path, periods: int | None = None) -> ReferenceTrajectory:
    """Read a `trajectory.json`.

    Args:
        path: Path of the file.
        periods: Repeats of the Fourier part; None: as the file states.

    Raises:
        UnusableInput: The file cannot be used.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise UnusableInput(
            f"{path}: cannot be read as a trajectory ({error}); "
            "give the trajectory.json of 'excite design'"
        ) from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise UnusableInput(
            f"{path}: is not of schema {SCHEMA!r}; give the trajectory.json of 'excite design'"
        )
    if periods is not None and periods < 1:
        raise UnusableInput(f"--periods {periods}: should be at least 1")
    try:
        return _reference(document, periods)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise UnusableInput(
            f"{path}: is incomplete or malformed ({type(error).__name__}: {error}); design it again"
        ) from error


def _reference(document: Mapping[str, Any], periods: int | None) -> ReferenceTrajectory:
    """Build the reference from the content of a trajectory file."""
    joints = tuple(str(j) for j in document["joints"])
    period, extra = float(document["period"]), 0.0
    if periods is not None:
        extra = (periods - int(document["periods"])) * period
    sine, cosine, offset = (np.array(document[key], float) for key in ("sine", "cosine", "offset"))
    wave = fourier_series(sine, cosine, offset, period)
    parts: list[
        tuple[float, float, Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]]
    ] = []
    shift, window = 0.0, (0.0, 0.0)
    for segment in document["segments"]:
        start, end = float(segment["start"]) + shift, float(segment["end"]) + shift
        if segment["kind"] == "fourier":
            shift, end = extra, end + extra
            window = (start, end if sine.any() or cosine.any() else start)
            parts.append((start, end, wave))
        else:
            ramp = (
                _phase_ramp(segment["phase"], wave)
                if "phase" in segment
                else _ramp(segment["profile"], joints)
            )
            parts.append((start, end, ramp))

    def at(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        out = tuple(np.empty((len(t), len(joints))) for _ in range(3))
        clipped = np.clip(t, parts[0][0], parts[-1][1])
        for start, end, part in parts:
            inside_part = (clipped >= start - 1e-12) & (clipped <= end)
            for output, piece in zip(out, part(clipped[inside_part] - start), strict=True):
                output[inside_part] = piece
        at_rest = (t < parts[0][0]) | (t > parts[-1][1])
        out[1][at_rest], out[2][at_rest] = 0.0, 0.0
        return out[0], out[1], out[2]

    return ReferenceTrajectory(joints, at, parts[-1][1], period, window, document["robot"])


def fourier_series(
    sine: FloatArray, cosine: FloatArray, offset: FloatArray, period: float
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]:
    """Return q = q₀ + Σ a/(ωk) sin ωkt − b/(ωk) cos ωkt and its derivatives as a function of t.

    Args:
        sine: Coefficients a, shape (n, K) [rad/s].
        cosine: Coefficients b, shape (n, K) [rad/s].
        offset: Centre q₀, shape (n,) [rad].
        period: 2π/ω [s].
    """
    k = 2.0 * np.pi / period * np.arange(1, sine.shape[1] + 1)

    def at(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        s, c = np.sin(np.multiply.outer(t, k)), np.cos(np.multiply.outer(t, k))
        return (
            offset + (s / k) @ sine.T - (c / k) @ cosine.T,
            c @ sine.T + s @ cosine.T,
            (c * k) @ cosine.T - (s * k) @ sine.T,
        )

    return at


def _ramp(
    profile: Mapping[str, Any], joints: tuple[str, ...]
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]:
    """Return a motion of piecewise constant jerk, as a function of the time since its start."""
    first = np.array([profile[key] for key in ("position", "velocity", "acceleration")], float)

    def at(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        out = tuple(np.empty((len(t), len(joints))) for _ in range(3))
        for j, joint in enumerate(joints):
            q, v, a = first[:, j]
            knots, states = [0.0], [(q, v, a, 0.0)]
            for duration, jerk in profile["pieces"][joint]:
                states[-1] = (q, v, a, jerk)
                q += duration * (v + duration * (a / 2 + duration * jerk / 6))
                v += duration * (a + duration * jerk / 2)
                a += duration * jerk
                knots.append(knots[-1] + duration)
                states.append((q, v, a, 0.0))
            index = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 1)
            s = t - np.array(knots)[index]
            q0, v0, a0, j0 = np.array(states)[index].T
            out[0][:, j] = q0 + s * (v0 + s * (a0 / 2 + s * j0 / 6))
            out[1][:, j] = v0 + s * (a0 + s * j0 / 2)
            out[2][:, j] = a0 + s * j0
        return out[0], out[1], out[2]

    return at


def _phase_ramp(
    phase: Mapping[str, Any],
    wave: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]:
    """Return a ramp along the path of the Fourier part, as a function of the time since its start.

    Args:
        phase: Entry `phase` of the segment.
        wave: The Fourier part as a function of the phase.
    """
    profile = {
        "position": [phase["start"]],
        "velocity": [phase["rate"]],
        "acceleration": [phase["acceleration"]],
        "pieces": {"phase": phase["pieces"]},
    }
    phase_at = _ramp(profile, ("phase",))

    def at(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        sigma, rate, acceleration = phase_at(t)
        q, dq, ddq = wave(sigma[:, 0])
        return q, dq * rate, ddq * rate**2 + dq * acceleration

    return at


def blended_fourier(
    joints: tuple[str, ...],
    sine: FloatArray,
    cosine: FloatArray,
    offset: FloatArray,
    period: float,
    periods: int,
    ramp: float,
) -> ReferenceTrajectory:
    """Return a Fourier motion that starts and ends at rest at the centre of its range.

    References with the same `period`, `periods` and `ramp` have the same duration.

    Args:
        joints: Names of the n joints.
        sine: See `fourier_series`.
        cosine: See `fourier_series`.
        offset: See `fourier_series`.
        period: Period of the series [s].
        periods: Number of periods between the blends.
        ramp: Duration of each blend [s].
    """
    wave, end = fourier_series(sine, cosine, offset, period), 2 * ramp + periods * period

    def at(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        q, v, a = wave(np.asarray(t) - ramp)
        u = np.clip(np.minimum(t, end - t) / ramp, 0.0, 1.0)
        sign = np.where(t < end / 2, 1.0, -1.0) / ramp
        # u⁴(35 − 84u + 70u² − 20u³): three derivatives vanish at both ends
        w = u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)
        dw = sign * 140 * u**3 * (1 - u) ** 3
        ddw = sign**2 * 420 * u**2 * (1 - u) ** 2 * (1 - 2 * u)
        w, dw, ddw, deviation = w[:, None], dw[:, None], ddw[:, None], q - offset
        return offset + w * deviation, w * v + dw * deviation, w * a + 2 * dw * v + ddw * deviation

    return ReferenceTrajectory(joints, at, end, period, (ramp, end - ramp), {})
