"""What the catalogue is made of: effects, each with the shapes that it can take and what would be needed to believe it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .track import Track

Array = np.ndarray
Columns = Callable[[Track], Array]
"""Torque that an effect adds, at the kept rows, per unit of each coefficient. Shape (N, n, k)."""


@dataclass(frozen=True)
class Shape:
    """One form of an effect at one joint: linear in its coefficients once `values` are fixed.

    joint: index of the joint that carries it, None where it is nobody's. columns: what it adds. values: the fixed, non-linear
    parameters. parameters: from coefficients (k,) to the contract's names and values. plausible: whether coefficients (k,) can be
    physics: sign, range, dissipation. other: a further joint it is tied to.
    """

    effect: str
    joint: int | None
    columns: Columns
    parameters: Callable[[Array], dict[str, float]]
    plausible: Callable[[Array], bool] = lambda c: bool(np.isfinite(c).all())
    values: Mapping[str, float] = field(default_factory=dict)
    other: int | None = None
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class Effect:
    """An entry of the catalogue.

    name: the contract's. shapes: all forms on a robot whose recordings are these tracks. units: of its parameters. prior_only: a refit
    of the base model absorbs it. signature: what it looks like. confused: names it is taken for. experiment: what would tell them apart.
    """

    name: str
    source: str
    shapes: Callable[[Sequence[Track]], Iterator[Shape]]
    units: Mapping[str, str]
    signature: str
    confused: tuple[str, ...]
    experiment: str
    prior_only: bool = False


def alone(joint: int, column: Callable[[Track], Array]) -> Columns:
    """Columns in one joint's torque only, from values at every sample: (M,) or (M, k)."""

    def build(track: Track) -> Array:
        x = column(track)
        x = x[:, None] if x.ndim == 1 else x
        low = track.reduce(x)
        out = np.zeros((len(low), track.n, x.shape[1]))
        out[:, joint] = low
        return out

    return build


def column(joint: int, function: Callable[..., Array], *values: float) -> Columns:
    """Columns in one joint's torque, from a function of (track, joint, *values)."""
    return alone(joint, lambda track: function(track, joint, *values))


def named(*names: str, **fixed: float) -> Callable[[Array], dict[str, float]]:
    """Coefficients by name, and values that are fixed."""
    return lambda c: {name: float(value) for name, value in zip(names, c, strict=False)} | fixed


def amplitude(**fixed: float) -> Callable[[Array], dict[str, float]]:
    """The size of a pair of cosine and sine, and values that are fixed."""
    return lambda c: {"amplitude": float(np.hypot(c[0], c[1]))} | fixed


def within(low: float, high: float) -> Callable[[Array], bool]:
    """The first coefficient lies between two bounds."""
    return lambda c: bool(low < c[0] < high)


def positive(c: Array) -> bool:
    """Every coefficient is above zero."""
    return bool((c > 0.0).all())
