"""Residual atlas: all curves of the held-out residual, with p-values for their number.

**Statistic.** A curve is a set of weighted means of the held-out residual (`residual_curves`), each
divided by its standard error; its statistic is the sum of their squares (over spatial frequency:
the largest). Standard errors are those between blocks (`residual_curves.block_length`) of the
residual of the fullest model, findings included, with Student's t for the number of blocks. The
uncertainty of the base fit and of the findings' fit by the noise of the fitted recordings is added.

**Null distribution.** Every block of either set gets a random sign (Rademacher), the same for all
joints. It contains noise of any colour that decorrelates within a block, but nothing that repeats
with the motion. Blocks are limited to `MAX_BLOCK_RATIO` times the median block, so that a single
event stands out, and where repetitions give it to as many noise floors.

**p-values.** Statistics are standardised by their own null distribution (cube root: Wilson &
Hilferty 1931). A p-value is the share of nulls whose *largest* statistic over all curves and joints
is as large (Westfall & Young 1993): the probability that an atlas of noise shows anything at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._linear_algebra import inverse
from .._types import FloatArray, IntArray
from . import residual_curves
from .diagnosis import Diagnosis
from .residual_curves import CurveKind, MotionRows, ResidualCurve
from .search import mean_square

DRAWS = 999
"""Draws of the null distribution."""
MAX_BLOCK_RATIO = 3.0
"""Largest RMS of a block over that of the median block, and over the noise floor."""
SIGNIFICANT = 0.05
"""p-value below which a curve is significant."""
CHUNK_ROWS = 4096
"""Rows that are weighted at a time."""


@dataclass(frozen=True)
class AtlasCurve:
    """One curve of one joint.

    Attributes:
        joint: Index of the joint.
        against: Name of the abscissa.
        unit: Its unit.
        kind: Kind of the curve.
        centres: Abscissa, shape (b,).
        mean_before: Residual of the base model [N m], shape (b,); an amplitude has no sign.
        mean_after: Residual of the model with the findings [N m], shape (b,).
        error: Standard error of `mean_before` over blocks [N m], shape (b,).
        p_before: p-value of `mean_before`; see the module.
        p_after: p-value of `mean_after`.
        score_before: Statistic of `mean_before` in standard deviations of the null distribution.
        share_before: Share of the joint's held-out residual power that the curve explains.
        logarithmic: Whether the abscissa is drawn logarithmically.
    """

    joint: int
    against: str
    unit: str
    kind: CurveKind
    centres: FloatArray
    mean_before: FloatArray
    mean_after: FloatArray
    error: FloatArray
    p_before: float
    p_after: float
    score_before: float
    share_before: float
    logarithmic: bool = False


@dataclass(frozen=True)
class Atlas:
    """All curves of all joints that move.

    Attributes:
        panels: The curves.
        blocks: Number of blocks of the held-out recordings.
    """

    panels: tuple[AtlasCurve, ...]
    blocks: int

    def of(self, joint: int) -> list[AtlasCurve]:
        """Return the curves of a joint."""
        return [p for p in self.panels if p.joint == joint]

    @property
    def shown(self) -> list[AtlasCurve]:
        """Significant curves before the findings, that with the largest explained share first."""
        return sorted(
            (p for p in self.panels if p.p_before < SIGNIFICANT), key=lambda p: -p.share_before
        )


@dataclass(frozen=True)
class _NullModel:
    """A residual over the scale of the fit, and how noise enters it.

    Attributes:
        residual: Residual, shape (N, n).
        limited: The same with blocks of large power limited.
        gamma: Columns by which fitted coefficients enter, shape (N, n, p).
        scores: Contribution of each block of the fitted recordings to the coefficients, (K, p).
    """

    residual: FloatArray
    limited: FloatArray
    gamma: FloatArray
    scores: FloatArray


@dataclass(frozen=True)
class _CurveStatistic:
    """Means and standard errors of a curve, shapes (c,), its statistic and that of each draw."""

    mean: FloatArray
    error: FloatArray
    statistic: float
    nulls: FloatArray


def compute_atlas(diagnosis: Diagnosis, *, draws: int = DRAWS, seed: int = 0) -> Atlas:
    """Compute the residual atlas of a diagnosis.

    Args:
        diagnosis: The diagnosis.
        draws: Draws of the null distribution.
        seed: Seed of the random signs.
    """
    rows = residual_curves.motion_rows(diagnosis.motions[1])
    rng = np.random.default_rng(seed)
    across = diagnosis.design.across.reshape(len(rows), -1)
    scale = diagnosis.before / np.maximum(np.sqrt(mean_square(across, rows.moving)), 1e-300)
    nulls = _null_models(diagnosis, scale, rows)
    signs = (
        rng.choice((-1.0, 1.0), size=(draws, len(rows.starts))),
        rng.choice((-1.0, 1.0), size=(draws, len(nulls[0].scores))),
    )
    curves = list(residual_curves.residual_curves(rows, diagnosis.identified.model.robot.joints))
    statistics = [[_statistics(curve, null, rows, signs) for curve in curves] for null in nulls]
    p_values = [_p_values(of_model) for of_model in statistics]
    panels = []
    for k, curve in enumerate(curves):
        unit = float(scale[curve.joint])
        mean, share = zip(
            *(
                _mean_and_share(curve, of_model[k], null)
                for of_model, null in zip(statistics, nulls, strict=True)
            ),
            strict=True,
        )
        error = _amplitude(curve, statistics[0][k].error) / (
            np.sqrt(2.0) if curve.kind is CurveKind.AMPLITUDE else 1.0
        )
        panels.append(
            AtlasCurve(
                curve.joint,
                curve.against,
                curve.unit,
                curve.kind,
                curve.centres,
                mean[0] * unit,
                mean[1] * unit,
                error * unit,
                p_before=float(p_values[0][0][k]),
                p_after=float(p_values[1][0][k]),
                score_before=float(p_values[0][1][k]),
                share_before=share[0],
                logarithmic=curve.logarithmic,
            )
        )
    return Atlas(tuple(panels), len(rows.starts))


def _mean_and_share(
    curve: ResidualCurve, statistics: _CurveStatistic, null: _NullModel
) -> tuple[FloatArray, float]:
    """Values of a curve and the share of residual power that it explains, minus that of noise."""
    power = float(np.mean(null.residual[:, curve.joint] ** 2))
    mean, noise = _amplitude(curve, statistics.mean), _amplitude(curve, statistics.error)
    if curve.kind is CurveKind.AMPLITUDE:
        squares = np.maximum(mean**2 - noise**2, 0.0)
        explained = (
            0.5 * float((squares * curve.counts).max()) / len(null.residual)
            if curve.against == "order"
            else float(squares.sum())
        )
    else:
        explained = float(
            np.sum(curve.counts * np.maximum(mean**2 - noise**2, 0.0)) / len(null.residual)
        )
    return mean, min(explained / max(power, 1e-300), 1.0)


def _amplitude(curve: ResidualCurve, cells: FloatArray) -> FloatArray:
    """Value at each point, or amplitude of cosine and sine."""
    if curve.kind is not CurveKind.AMPLITUDE:
        return cells
    half = len(cells) // 2
    return np.hypot(cells[:half], cells[half:]) * curve.size


def _null_models(
    diagnosis: Diagnosis, scale: FloatArray, rows: MotionRows
) -> tuple[_NullModel, _NullModel]:
    """Noise in the residual of the base model, and of the model with the findings."""
    regression, n = diagnosis.design, len(scale)
    fitted, held_out = regression.halves
    gamma = held_out.gamma[held_out.rows].reshape(len(rows), n, -1)
    starts, recorded = _training_block_starts(diagnosis), fitted.rows
    floor = diagnosis.floor / scale if diagnosis.method == "periods" else None
    residual, columns = regression.residual[0], [fitted.gamma]
    held_out_residuals = [r / scale for r in diagnosis.residuals]
    together = diagnosis.verdict.together
    if together is not None:
        which = regression.which(together.shapes)
        columns.append(fitted.free(regression.columns[0].picked(which).full()))
        residual = residual - columns[1] @ together.halves[0]
    # degrees of freedom that the fit took from its own residual
    spent = min(sum(c.shape[1] for c in columns) / int(recorded.sum()), 0.5)
    limited = _limited(residual[recorded].reshape(-1, n), starts, floor)
    noise = (limited / np.sqrt(1.0 - spent)).reshape(-1, 1)
    scores = [
        np.add.reduceat(inverse(c)[:, recorded].T * noise, starts * n, axis=0) for c in columns
    ]
    held_out_limited = _limited(held_out_residuals[1], rows.starts, floor)
    before = _NullModel(held_out_residuals[0], held_out_limited, gamma, scores[0])
    if together is None:
        return before, before
    wider = np.concatenate([gamma, regression.carried(which).reshape(len(rows), n, -1)], axis=2)
    return before, _NullModel(held_out_residuals[1], held_out_limited, wider, np.hstack(scores))


def _training_block_starts(diagnosis: Diagnosis) -> IntArray:
    """First row of each block of the training recordings."""
    at, out = 0, list[IntArray]()
    length = residual_curves.block_length(diagnosis.motions[0])
    for motion in diagnosis.motions[0]:
        out.append(at + residual_curves.block_starts(motion.time - motion.time[0], length))
        at += len(motion)
    return np.concatenate(out)


def _limited(residual: FloatArray, starts: IntArray, floor: FloatArray | None) -> FloatArray:
    """Residual with blocks limited to `MAX_BLOCK_RATIO` medians, and floors where known."""
    counts = np.diff([*starts, len(residual)])
    rms = np.sqrt(np.add.reduceat(residual**2, starts, axis=0) / counts[:, None])
    limit = MAX_BLOCK_RATIO * (
        np.median(rms, axis=0) if floor is None else np.minimum(np.median(rms, axis=0), floor)
    )
    return residual * np.repeat(np.minimum(1.0, limit / np.maximum(rms, 1e-300)), counts, axis=0)


def _statistics(
    curve: ResidualCurve,
    null: _NullModel,
    rows: MotionRows,
    signs: tuple[FloatArray, FloatArray],
) -> _CurveStatistic:
    """Means and errors of a curve, its statistic, and that under every draw of signs."""
    j, count = curve.joint, len(rows.starts)
    cells = curve.centres.size * (2 if curve.kind is CurveKind.AMPLITUDE else 1)
    blocks, shares = np.empty((count, cells)), np.empty((count, cells))
    mean, entering = np.zeros(cells), np.zeros((cells, null.gamma.shape[2]))
    for first, last in _chunks(rows.starts, len(rows)):
        begin, end = int(rows.starts[first]), int(rows.starts[last]) if last < count else len(rows)
        part = slice(begin, end)
        weights, inner = curve.weights(part), rows.starts[first:last] - begin
        blocks[first:last] = np.add.reduceat(weights * null.limited[part, j, None], inner, axis=0)
        shares[first:last] = np.add.reduceat(weights**2, inner, axis=0)
        mean += weights.T @ null.residual[part, j]
        entering += weights.T @ null.gamma[part, j]
    if curve.kind is CurveKind.AMPLITUDE:
        half = cells // 2
        shares = np.tile(shares[:, :half] + shares[:, half:], 2)
    shares /= np.maximum(shares.sum(axis=0), 1e-300)
    effective_blocks = 1.0 / np.sum(shares**2, axis=0)
    spread = (blocks - shares * blocks.sum(axis=0)) * np.sqrt(
        effective_blocks / np.maximum(effective_blocks - 1.0, 0.5)
    )
    if curve.centred:
        centre = np.eye(cells) - curve.counts / curve.counts.sum()
        mean, entering, spread = centre @ mean, centre @ entering, spread @ centre.T
    by_fit = entering @ null.scores.T
    error = np.sqrt(np.maximum(np.sum(spread**2, axis=0) + np.sum(by_fit**2, axis=1), 1e-300))
    drawn = (signs[0] @ spread - signs[1] @ by_fit.T) / error
    z = _normal_deviates(mean / error, np.maximum(effective_blocks - 1.0, 1.0))
    return _CurveStatistic(
        mean, error, float(_statistic(curve, z[None])[0]), _statistic(curve, drawn)
    )


def _normal_deviates(t: FloatArray, freedom: FloatArray) -> FloatArray:
    """Normal deviates with the tail probability of Student's t."""
    from scipy import special  # slow to import

    return np.asarray(
        -np.sign(t) * special.ndtri(np.maximum(special.stdtr(freedom, -np.abs(t)), 1e-300))
    )


def _chunks(starts: IntArray, count: int) -> list[tuple[int, int]]:
    """Ranges of complete blocks of about `CHUNK_ROWS` rows."""
    size = max(1, int(CHUNK_ROWS * len(starts) / max(count, 1)))
    return [(k, min(k + size, len(starts))) for k in range(0, len(starts), size)]


def _statistic(curve: ResidualCurve, z: FloatArray) -> FloatArray:
    """Cube root of a curve's statistic for each row of z: (d, c) -> (d,)."""
    squares = z**2
    if curve.against == "order":
        half = squares.shape[1] // 2
        return np.asarray(np.cbrt((squares[:, :half] + squares[:, half:]).max(axis=1)))
    return np.asarray(np.cbrt(squares.sum(axis=1)))


def _p_values(curves: Sequence[_CurveStatistic]) -> tuple[FloatArray, FloatArray]:
    """p-value of each curve against the largest of all, and its standardised statistic."""
    if not curves:
        return np.empty(0), np.empty(0)
    nulls = np.array([c.nulls for c in curves])
    middle, spread = nulls.mean(axis=1), np.maximum(nulls.std(axis=1), 1e-12)
    score = (np.array([c.statistic for c in curves]) - middle) / spread
    largest = np.max((nulls - middle[:, None]) / spread[:, None], axis=0)
    return (1.0 + (largest[None] >= score[:, None]).sum(axis=1)) / (1.0 + len(largest)), score
