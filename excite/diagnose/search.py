"""Fitting every shape of the catalogue beside the base model, on one recording set, and judging it on the other.

Frisch & Waugh (1933): with the base refit, a shape's columns count by what the base cannot say of them. All Gram products
are formed once; any set of shapes is then a small least-squares problem, on either half and in either direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .effect import Shape

Array = np.ndarray
RANK = 1e-8


@dataclass(frozen=True)
class Half:
    """Whitened equations of some recordings, and below them what was known before. gamma: base columns. Shape (m + k, p).

    torque: Shape (m + k,). joint: of each row, −1 of the k rows that no recording made. Shape (m + k,).
    """

    gamma: Array
    torque: Array
    joint: Array

    @property
    def rows(self) -> Array:
        """Rows that were recorded."""
        return self.joint >= 0


@dataclass(frozen=True)
class Design:
    """Two halves with all shapes' columns, and the products that fits are made of.

    places: of each shape's columns. free: what the base leaves of them. left: the residual of each half by its own base fit.
    carried, across: columns and torque of the other half less what this half's base fit makes of them. gram, score: of free and
    left; gram_across, score_across: of carried and across.
    """

    shapes: tuple[Shape, ...]
    places: tuple[slice, ...]
    halves: tuple[Half, Half]
    free: tuple[Array, Array]
    left: tuple[Array, Array]
    carried: tuple[Array, Array]
    across: tuple[Array, Array]
    gram: tuple[Array, Array]
    score: tuple[Array, Array]
    gram_across: tuple[Array, Array]
    score_across: tuple[Array, Array]

    def which(self, chosen: Sequence[int]) -> Array:
        """Columns of several shapes."""
        return np.concatenate([np.arange(self.places[i].start, self.places[i].stop) for i in chosen])


def half(base: Sequence[Array], torque: Sequence[Array], scale: Array, known: tuple[Array, Array]) -> Half:
    """Rows of several stretches over a scale. base: base columns of each, (N, n, p); torque: what they explain, (N, n).

    known: further rows and their right side, already over their uncertainty. Shapes (k, p), (k,).
    """
    n = len(scale)
    gamma = np.concatenate([b / scale[:, None] for b in base]).reshape(-1, base[0].shape[2])
    left = np.concatenate([t / scale for t in torque]).ravel()
    joint = np.concatenate([np.tile(np.arange(n), len(left) // n), np.full(len(known[1]), -1)])
    return Half(np.vstack([gamma, known[0]]), np.concatenate([left, known[1]]), joint)


def design(halves: tuple[Half, Half], shapes: Sequence[Shape], widths: Sequence[int], columns: tuple[Array, Array]) -> Design:
    """All products that the search needs.

    widths: how many columns each shape has. columns: of all shapes, over the scale, per half, at the rows
    that were recorded. Shapes (m, K).
    """
    places, start = [], 0
    for width in widths:
        places.append(slice(start, start + width))
        start += width
    fits = [_solver(h.gamma) for h in halves]
    free, left, carried, across = [], [], [], []
    for k in (0, 1):
        own, other = halves[k], halves[1 - k]
        full = np.zeros((len(own.joint), columns[k].shape[1]))
        full[own.rows] = columns[k]
        theta, part = fits[k] @ own.torque, fits[k] @ full
        free.append(full - own.gamma @ part)
        left.append(own.torque - own.gamma @ theta)
        carried.append(columns[1 - k] - other.gamma[other.rows] @ part)  # fitted on k, judged on the other
        across.append((other.torque - other.gamma @ theta)[other.rows])
    return Design(
        tuple(shapes),
        tuple(places),
        halves,
        _two(free),
        _two(left),
        _two(carried),
        _two(across),
        _two([f.T @ f for f in free]),
        _two([f.T @ r for f, r in zip(free, left, strict=True)]),
        _two([c.T @ c for c in carried]),
        _two([c.T @ r for c, r in zip(carried, across, strict=True)]),
    )


def _two(xs: list[Array]) -> tuple[Array, Array]:
    return xs[0], xs[1]


def _solver(gamma: Array) -> Array:
    """Γ⁺ with relative tolerance, columns at unit length."""
    size = np.linalg.norm(gamma, axis=0)
    size[size <= 1e-9 * size.max(initial=0.0)] = np.inf
    return np.asarray(np.linalg.pinv(gamma / size, rcond=RANK) / size[:, None])


@dataclass(frozen=True)
class Trial:
    """A set of shapes, fitted. coefficients, deviation: on both halves together. halves: on each. gain: log-likelihood on the halves
    that did not fit it, both directions added. train: on those that did. plausible: whether every part passes its gates."""

    shapes: tuple[int, ...]
    coefficients: Array
    deviation: Array
    halves: tuple[Array, Array]
    gain: float
    train: float
    plausible: bool


def trial(one: Design, chosen: Sequence[int]) -> Trial:
    """Fit the shapes on each half, judge on the other, and once more on both together."""
    which = one.which(chosen)
    index = np.ix_(which, which)
    found, gain = [], 0.0
    for k in (0, 1):
        c = _solved(one.gram[k][index], one.score[k][which])
        found.append(c)
        gain += float(c @ one.score_across[k][which] - 0.5 * c @ one.gram_across[k][index] @ c)
    G, b = one.gram[0][index] + one.gram[1][index], one.score[0][which] + one.score[1][which]
    c = _solved(G, b)
    spread = np.sqrt(np.maximum(np.diag(_pseudo(G)), 0.0))
    plausible, start = True, 0
    for i in chosen:
        width = one.places[i].stop - one.places[i].start
        plausible &= bool(one.shapes[i].plausible(c[start : start + width]))
        start += width
    return Trial(tuple(chosen), c, spread, (found[0], found[1]), gain, float(0.5 * c @ b), plausible)


def _solved(G: Array, b: Array) -> Array:
    return np.asarray(_pseudo(G) @ b)


def _pseudo(G: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(G), 1e-300))
    return np.linalg.pinv(G / np.outer(size, size), rcond=1e-9, hermitian=True) / np.outer(size, size)
