"""The width of each joint's smooth Coulomb friction tanh(q̇/width), from the data: too wide a step looks like a Stribeck effect."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from .estimators import Estimate
from .lowpass import Grid, LowPassFilter, friction_speed
from .regression import IdentificationModel, TorqueEquations, kept_rows
from .regression import filtered_friction as friction_of
from .segments import Segment

Array = np.ndarray
CANDIDATE_WIDTHS = 1e-4 * 1.3 ** np.arange(21)
"""From a tenth of a mrad/s (mm/s) to 19: a wider step is no Coulomb friction any more."""
GAIN = 2.0
"""Log-likelihood, rows taken as independent, that a width must gain over the usual one."""
FARTHEST = 0.4
"""Change of a width's logarithm in one step, at the most."""
MAX_WIDTH_SAMPLES = 1 << 16
"""Samples of a recording that settle the widths."""


def fit_widths(model: IdentificationModel, equations: TorqueEquations, pieces: Sequence[Segment]) -> IdentificationModel:
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

        best = min(tried, key=lambda width: unexplained(tried[width][:, joint]))
        now, then = unexplained(gamma[:, k]), unexplained(tried[best][:, joint])
        if 0.5 * len(torque) * np.log(max(now, 1e-300) / max(then, 1e-300)) > GAIN:
            widths[joint] = best
    return dataclasses.replace(model, widths=widths)


def _tried(pieces: Sequence[Segment], hertz: float) -> dict[float, Array]:
    """Filtered tanh(q̇/width) for every candidate at the rows of the equations."""
    out: dict[float, list[Array]] = {float(width): [] for width in CANDIDATE_WIDTHS}
    for piece in pieces:
        for part, kept, speed in _speeds(piece, hertz):
            for width, columns in out.items():
                columns.append(part.low(np.tanh(speed / width), Grid.KEPT)[kept])
    return {width: np.concatenate(columns) for width, columns in out.items()}


def _speeds(piece: Segment, hertz: float) -> Iterator[tuple[LowPassFilter, slice, Array]]:
    """Chunk by chunk its band, the rows kept, and speed at every sample."""
    band = piece.band(hertz)
    for rows, kept in kept_rows(piece, band):
        part = dataclasses.replace(band, count=rows.stop - rows.start)
        yield part, kept, friction_speed(piece.q[rows], part)


def refine_widths(model: IdentificationModel, data: Estimate) -> IdentificationModel:
    """The model after a Gauss-Newton step of its widths: the slope's coefficient is the friction times the change of log width."""
    widths = model.widths.copy()
    for step, (k, joint) in zip(data.beside, model.friction_columns().items(), strict=True):
        if data.theta[k] > 0.0:
            widths[joint] *= np.exp(np.clip(step / data.theta[k], -FARTHEST, FARTHEST))
    return dataclasses.replace(model, widths=np.clip(widths, CANDIDATE_WIDTHS[0], CANDIDATE_WIDTHS[-1]))


def apply_widths(model: IdentificationModel, rows: TorqueEquations, pieces: Iterable[Segment]) -> TorqueEquations:
    """The same equations with the model's widths."""
    friction = model.friction_columns()
    if not friction:
        return rows
    gamma, fresh = (
        rows.regressor.copy(),
        [
            (coulomb[kept], slopes[kept])
            for piece in pieces
            for part, kept, speed in _speeds(piece, rows.hertz)
            for coulomb, slopes in [friction_of(model.widths, speed, part)]
        ],
    )
    coulomb, slopes = (np.concatenate(column) for column in zip(*fresh, strict=True))
    for k, joint in friction.items():
        gamma[:, joint, k] = coulomb[:, joint]
    return dataclasses.replace(rows, regressor=gamma, slopes=slopes)
