"""Friction that remembers where it turned back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from .effect import CandidateModel, Effect, alone, beside, family, within
from .friction import stickiest
from .recorded_motion import RecordedMotion, position_range

Array = np.ndarray
SPRINGS, APART, SLIPS = (3, 5), 3.0, 0.5
"""How many springs make up friction's memory, as tried; each one's way until it slips, over that of the one before; and the last one's over
a joint's stroke, at the most: what never slips is a spring."""
BACKWARD = 0.05
"""Of all their force, what one of them may have against it by chance."""


def dahl(q: Array, stiffness: float) -> Array:
    """z of Dahl's model with unit friction: ż = σ q̇ (1 − z sgn q̇), in closed form from one reversal to the next. Shape (M,)."""
    begins, way, gone = _strokes(q)
    limits, decays = np.sign(way), np.exp(-stiffness * np.abs(way))
    strokes = zip(limits.tolist(), decays.tolist(), strict=True)
    *starts, _ = accumulate(
        strokes, lambda z, stroke: position_range[0] + (z - position_range[0]) * position_range[1], initial=0.0
    )
    return np.asarray(
        limits[begins] + (np.array(starts) - limits)[begins] * np.exp(-stiffness * np.abs(gone))
    )


def slipping(q: Array, reach: float) -> Array:
    """Force of a spring of unit strength that slips `reach` from where it rests. Shape (M,)."""
    begins, way, gone = _strokes(q)
    *starts, _ = accumulate(
        (way / reach).tolist(), lambda z, further: min(max(z + further, -1.0), 1.0), initial=0.0
    )
    return np.clip(np.array(starts)[begins] + gone / reach, -1.0, 1.0)


def _strokes(q: Array) -> tuple[Array, Array, Array]:
    """From one reversal to the next: of each sample, in which stroke it ends; of each stroke, how far it goes; of each sample, how far it
    is from where its stroke began. Shapes (M,), (strokes,), (M,)."""
    ways = np.sign(np.diff(q, prepend=q[0]))
    first = np.flatnonzero(
        np.diff(ways, prepend=2.0)
    )  # of each stroke's samples; it begins at the one before
    begins = np.repeat(np.arange(len(first)), np.diff(first, append=len(q)))
    corners = q[np.maximum(first - 1, 0)]
    return begins, np.diff(corners, append=q[-1]), q - corners[begins]


def _softened(t: RecordedMotion, s: CandidateModel) -> Array:
    q, reach = t.samples.q[:, s.joint_index], s.values["reach"]
    curves = (
        [slipping(q, by * reach) for by in _ways(s)]
        if "springs" in s.values
        else [dahl(q, 1.0 / reach)]
    )
    return alone(t, s.joint_index, np.column_stack(curves) - t.sign(s.joint_index)[:, None])


def _ways(s: CandidateModel) -> Array:
    """After which a shape's springs slip, over that of the middle one. Shape (k,)."""
    count = int(s.values["springs"])
    return np.asarray(APART ** (np.arange(count) - count // 2))


def _hysteresis(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Dahl's curve; beside it, springs that slip one after the other, for curves that begin steeper or bend later."""

    def slips(j: int, most: float, springs: int) -> Callable[[float], CandidateModel]:
        low, high = position_range(tracks, j)

        def shape(reach: float) -> CandidateModel:
            bare = CandidateModel("hysteresis", j, _softened, {"reach": reach, "springs": float(springs)})
            ways = reach * _ways(bare)
            slip = bool(ways[-1] < SLIPS * (high - low))
            return replace(
                bare,
                parameters=lambda c: {
                    "amplitude": float(c.sum()),
                    "stiffness": float(np.sum(c / ways)),
                },
                plausible=lambda c: (
                    slip and bool(0.0 < c.sum() < most and c.min() > -BACKWARD * c.sum())
                ),
            )

        return shape

    def soft(j: int, most: float) -> Callable[[float], CandidateModel]:
        def shape(reach: float) -> CandidateModel:
            told = lambda c: {"amplitude": float(c[0]), "stiffness": float(c[0] / reach)}  # noqa: E731
            kin = lambda: beside(reach, 4.0, [slips(j, most, springs) for springs in SPRINGS])  # noqa: E731
            return CandidateModel(
                "hysteresis",
                j,
                _softened,
                {"reach": reach},
                parameters=told,
                plausible=within(0.0, most),
                variants=kin,
            )

        return shape

    for j in range(tracks[0].n):
        most = stickiest(tracks, j)
        yield from family(np.geomspace(1e-4, 1e-1, 9).tolist(), soft(j, most))


def _steepest(parts: Sequence[tuple[CandidateModel, Array]]) -> dict[str, float]:
    """Springs that slip sooner than the first would look the same: the slope that is told is known to what that one has of it."""
    shape, c = parts[0]
    return (
        {"stiffness": abs(float(c[0])) / (float(_ways(shape)[0]) * shape.values["reach"])}
        if "springs" in shape.values
        else {}
    )


EFFECTS = (
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
        residual_log_offset=1.0,
        unobserved_std=_steepest,
    ),
)
