"""Estimation of the speed scale (width) of smooth Coulomb friction tanh(q̇/width).

A width that is too large is mistaken for Stribeck friction.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from .._types import FloatArray
from .estimators import Estimate
from .lowpass import Grid, LowPassFilter, friction_speed
from .regression import IdentificationModel, TorqueEquations, filtered_friction, kept_rows
from .segments import RecordingSegment

CANDIDATE_WIDTHS = 1e-4 * 1.3 ** np.arange(21)
"""Widths compared, 0.1 to 19 mrad/s (mm/s): a wider step is not Coulomb friction."""
MIN_LOG_LIKELIHOOD_GAIN = 2.0
"""Log-likelihood, rows taken as independent, that a width must gain over the initial one."""
MAX_LOG_WIDTH_STEP = 0.4
"""Largest change of the logarithm of a width in one Gauss-Newton step."""
MAX_WIDTH_SAMPLES = 1 << 16
"""Number of recorded samples from which widths are estimated, at most."""


def fit_widths(
    model: IdentificationModel,
    equations: TorqueEquations,
    segments: Sequence[RecordingSegment],
) -> IdentificationModel:
    """Choose the widths that explain the torque best, joint by joint.

    The other columns are projected out (Frisch & Waugh, Econometrica 1(4), 1933).

    Args:
        model: The model with initial widths.
        equations: Its equations.
        segments: The segments that the equations come from.

    Returns:
        The model with the chosen widths.
    """
    friction = model.friction_columns()
    if not friction:
        return model
    widths = model.widths.copy()
    candidates = _candidate_columns(segments, equations.hertz)
    for k, joint in friction.items():
        rows = equations.moving[:, joint]
        gamma, torque = equations.regressor[rows, joint], equations.torque[rows, joint]
        others = np.delete(gamma, k, axis=1)
        others = others[:, np.any(others != 0.0, axis=0)]
        Q = np.linalg.qr(others / np.linalg.norm(others, axis=0))[0]
        residual = torque - Q @ (Q.T @ torque)

        def unexplained(
            column: FloatArray, Q: FloatArray = Q, residual: FloatArray = residual
        ) -> float:
            projected = column - Q @ (Q.T @ column)
            size = float(projected @ projected)
            amplitude = (
                float(projected @ residual) / size if size > 1e-9 * float(column @ column) else 0.0
            )
            return float(residual @ residual) - max(amplitude, 0.0) ** 2 * size

        errors = {width: unexplained(columns[rows, joint]) for width, columns in candidates.items()}
        best = min(errors, key=lambda width: errors[width])
        before, after = unexplained(gamma[:, k]), errors[best]
        gain = 0.5 * len(torque) * np.log(max(before, 1e-300) / max(after, 1e-300))
        if gain > MIN_LOG_LIKELIHOOD_GAIN:
            widths[joint] = best
    return dataclasses.replace(model, widths=widths)


def _candidate_columns(
    segments: Sequence[RecordingSegment], hertz: float
) -> dict[float, FloatArray]:
    """Filtered tanh(q̇/width) at the rows of the equations, for every candidate width."""
    out: dict[float, list[FloatArray]] = {float(width): [] for width in CANDIDATE_WIDTHS}
    for segment in segments:
        for band, kept, speed in _speeds(segment, hertz):
            for width, columns in out.items():
                columns.append(band.filter(np.tanh(speed / width), Grid.KEPT)[kept])
    return {width: np.concatenate(columns) for width, columns in out.items()}


def _speeds(
    segment: RecordingSegment, hertz: float
) -> Iterator[tuple[LowPassFilter, slice, FloatArray]]:
    """Yield for each chunk its filter, its kept rows, and the speed at every sample."""
    band = segment.band(hertz)
    for samples, kept in kept_rows(segment, band):
        part = dataclasses.replace(band, count=samples.stop - samples.start)
        yield part, kept, friction_speed(segment.q[samples], part)


def refine_widths(model: IdentificationModel, data: Estimate) -> IdentificationModel:
    """Return the model after one Gauss-Newton step of its widths.

    The coefficient of a width's slope is the Coulomb friction times the change of log width.

    Args:
        model: The model.
        data: Estimate with the slopes as nuisance columns.
    """
    widths = model.widths.copy()
    for step, (k, joint) in zip(
        data.nuisance_coefficients, model.friction_columns().items(), strict=True
    ):
        if data.theta[k] > 0.0:
            widths[joint] *= np.exp(
                np.clip(step / data.theta[k], -MAX_LOG_WIDTH_STEP, MAX_LOG_WIDTH_STEP)
            )
    return dataclasses.replace(
        model, widths=np.clip(widths, CANDIDATE_WIDTHS[0], CANDIDATE_WIDTHS[-1])
    )


def apply_widths(
    model: IdentificationModel, equations: TorqueEquations, segments: Iterable[RecordingSegment]
) -> TorqueEquations:
    """Recompute the friction columns of equations with the model's widths."""
    friction = model.friction_columns()
    if not friction:
        return equations
    gamma = equations.regressor.copy()
    columns = [
        (coulomb[kept], slopes[kept])
        for segment in segments
        for band, kept, speed in _speeds(segment, equations.hertz)
        for coulomb, slopes in [filtered_friction(model.widths, speed, band)]
    ]
    coulomb, slopes = (np.concatenate(column) for column in zip(*columns, strict=True))
    for k, joint in friction.items():
        gamma[:, joint, k] = coulomb[:, joint]
    return dataclasses.replace(equations, regressor=gamma, slopes=slopes)
