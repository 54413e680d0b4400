"""The width of each joint's smooth Coulomb friction tanh(q̇/width), from the data: too wide a step looks like a Stribeck effect."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from .band import EDGE, Band, Grid
from .equations import Equations, Model, kept_rows
from .signals import Piece

Array = np.ndarray
CANDIDATES = 5e-4 * 1.25 ** np.arange(21)
"""From half a mrad/s to 43."""
ENOUGH = 1 << 16
"""Samples of a recording that settle the widths."""


def fitted(model: Model, equations: Equations, pieces: Sequence[Piece]) -> Model:
    """The model with the widths that explain the equations best, joint by joint (Frisch & Waugh: the other columns projected out)."""
    friction = model.friction_columns()
    if not friction:
        return model
    widths = model.widths.copy()
    tried = _tried(pieces, equations.hertz)
    for k, joint in friction.items():
        gamma, torque = equations.regressor[:, joint], equations.torque[:, joint]
        others = np.delete(gamma, k, axis=1)
        others = others[:, np.any(others != 0.0, axis=0)]
        Q = np.linalg.qr(others / np.linalg.norm(others, axis=0))[0]
        left = torque - Q @ (Q.T @ torque)

        def unexplained(column: Array, Q: Array = Q, left: Array = left) -> float:
            free = column - Q @ (Q.T @ column)
            size = float(free @ free)
            amplitude = float(free @ left) / size if size > 1e-9 * float(column @ column) else 0.0
            return float(left @ left) - max(amplitude, 0.0) ** 2 * size

        widths[joint] = min(tried, key=lambda width: unexplained(tried[width][:, joint]))
    return dataclasses.replace(model, widths=widths)


def _tried(pieces: Sequence[Piece], hertz: float) -> dict[float, Array]:
    """Filtered tanh(q̇/width) for every candidate at the rows of the equations."""
    out: dict[float, list[Array]] = {float(width): [] for width in CANDIDATES}
    for piece in pieces:
        for part, kept, speed in _speeds(piece, Band(hertz, piece.rate, len(piece), piece.periodic)):
            for width, columns in out.items():
                columns.append(part.low(np.tanh(speed / width), Grid.KEPT)[kept])
    return {width: np.concatenate(columns) for width, columns in out.items()}


def _speeds(piece: Piece, band: Band) -> Iterator[tuple[Band, slice, Array]]:
    """Chunk by chunk its band, the rows kept, and speed at every sample."""
    for rows, kept in kept_rows(piece, band):
        part = dataclasses.replace(band, count=rows.stop - rows.start)
        yield part, kept, part.low(piece.q[rows], Grid.RECORDED, 1, reach=EDGE)


def applied(model: Model, rows: Equations, pieces: Iterable[Piece]) -> Equations:
    """The same equations with the model's widths."""
    friction = model.friction_columns()
    if not friction:
        return rows
    gamma, fresh = rows.regressor.copy(), columns(pieces, model.widths, rows.hertz)
    for k, joint in friction.items():
        gamma[:, joint, k] = fresh[:, joint]
    return dataclasses.replace(rows, regressor=gamma)


def columns(pieces: Iterable[Piece], width: float | Array, hertz: float) -> Array:
    """Filtered tanh(q̇/width) of all joints at the rows of the equations. Shape (N, n)."""
    return _rows(pieces, hertz, lambda speed: np.tanh(speed / width))


def slopes(pieces: Iterable[Piece], widths: Array, hertz: float) -> Array:
    """Filtered ∂tanh(q̇/width)/∂ log width: what an error of a width adds to its joint's torque. Shape (N, n)."""
    return _rows(pieces, hertz, lambda speed: -speed / widths / np.cosh(np.clip(speed / widths, -300.0, 300.0)) ** 2)


def _rows(pieces: Iterable[Piece], hertz: float, function: Callable[[Array], Array]) -> Array:
    parts = []
    for piece in pieces:
        band = Band(hertz, piece.rate, len(piece), piece.periodic)
        parts += [part.low(function(speed), Grid.KEPT)[kept] for part, kept, speed in _speeds(piece, band)]
    return np.concatenate(parts)
