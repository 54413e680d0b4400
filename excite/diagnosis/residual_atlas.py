"""The residual atlas: where a held-out residual is not noise, by p-values that survive that many looks.

**The rule.** A curve is a set of weighted means of the held-out residual (`looks`), each over its standard error; the curve's statistic
is the sum of their squares (of orders: the largest). Errors are those between blocks (`looks.block_length`) of what the fullest model
(findings included) leaves, each block's part of the mean taken off, with Student's tail for as many blocks as there are. To them comes
what the noise of the fitted recordings adds through the base fit, and the findings' fit. The null is the same pipeline with nothing
missing: every block of either set with a random sign (Rademacher; all joints of a block the same). What repeats with the motion is not
in these nulls; noise of any colour that forgets within a block is. A block counts at most LOUD times as loud as the median one, so that
what happens once stands out, and at most LOUD noise floors where repeated periods say what the floor is. Statistics are brought to one
scale by their own nulls (cube root: Wilson & Hilferty 1931), and a p-value is the share of nulls whose *largest* over all curves and
joints is as large (Westfall & Young 1993): the chance that an atlas of pure noise shows anything at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._linear_algebra import inverse
from . import residual_curves
from .diagnosis import Diagnosis
from .residual_curves import CurveKind, MotionRows, ResidualCurve
from .search import mean_square

Array = np.ndarray
DRAWS = 999
LOUD = 3.0
SIGNIFICANT = 0.05
CHUNK = 4096
"""Rows that are weighted at a time."""


@dataclass(frozen=True)
class AtlasCurve:
    """One curve of one joint. joint: its index. centres, mean_before, mean_after, error: Shape (b,) [`unit`; N m]; amplitudes have no sign.

    error: standard error of mean_before over blocks. p_before, p_after: see the module. score_before: the statistic in null
    deviations. share_before: part of the joint's held-out residual power that this curve explains.
    """

    joint: int
    against: str
    unit: str
    kind: CurveKind
    centres: Array
    mean_before: Array
    mean_after: Array
    error: Array
    p_before: float
    p_after: float
    score_before: float
    share_before: float
    logarithmic: bool = False


@dataclass(frozen=True)
class Atlas:
    """All curves of all joints that move. blocks: how many the held-out recordings have."""

    panels: tuple[AtlasCurve, ...]
    blocks: int

    def of(self, joint: int) -> list[AtlasCurve]:
        """The curves of a joint."""
        return [p for p in self.panels if p.joint == joint]

    @property
    def shown(self) -> list[AtlasCurve]:
        """Curves that are not noise before the findings, the one that explains most of its joint's residual first."""
        return sorted(
            (p for p in self.panels if p.p_before < SIGNIFICANT), key=lambda p: -p.share_before
        )


@dataclass(frozen=True)
class _Null:
    """A residual over the scale of the fit, and how noise gets into it. residual: Shape (N, n). loud: the same, loud blocks limited.

    gamma: by which fitted coefficients enter. Shape (N, n, p). scores: what each block of the fitted recordings adds to them. Shape (K, p).
    """

    residual: Array
    loud: Array
    gamma: Array
    scores: Array


@dataclass(frozen=True)
class _Curve:
    """mean: Shape (c,). error: Shape (c,). statistic: of the data; nulls: of each draw."""

    mean: Array
    error: Array
    statistic: float
    nulls: Array


def compute_atlas(found: Diagnosis, *, draws: int = DRAWS, seed: int = 0) -> Atlas:
    """The atlas of a diagnosis."""
    rows = residual_curves.motion_rows(found.motions[1])
    rng = np.random.default_rng(seed)
    scale = found.before / np.maximum(
        np.sqrt(mean_square(found.design.across.reshape(len(rows), -1), rows.moving)), 1e-300
    )
    nulls = _nulls(found, scale, rows)
    signs = (
        rng.choice((-1.0, 1.0), size=(draws, len(rows.starts))),
        rng.choice((-1.0, 1.0), size=(draws, len(nulls[0].scores))),
    )
    all_looks = list(residual_curves.residual_curves(rows, found.identified.model.robot.joints))
    curves = [[_curve(one, null, rows, signs) for one in all_looks] for null in nulls]
    judged = [_p_values(own) for own in curves]
    panels = []
    for k, one in enumerate(all_looks):
        unit = float(scale[one.joint])
        mean, share = zip(
            *(_told(one, own[k], null) for own, null in zip(curves, nulls, strict=True)),
            strict=True,
        )
        error = _amplitude(one, curves[0][k].error) / (
            np.sqrt(2.0) if one.kind is CurveKind.AMPLITUDE else 1.0
        )
        panels.append(
            AtlasCurve(
                one.joint,
                one.against,
                one.unit,
                one.kind,
                one.centres,
                mean[0] * unit,
                mean[1] * unit,
                error * unit,
                p_before=float(judged[0][0][k]),
                p_after=float(judged[1][0][k]),
                score_before=float(judged[0][1][k]),
                share_before=share[0],
                logarithmic=one.logarithmic,
            )
        )
    return Atlas(tuple(panels), len(rows.starts))


def _told(one: ResidualCurve, curve: _Curve, null: _Null) -> tuple[Array, float]:
    """A curve and the share of the joint's power that it explains, what noise adds to it taken off."""
    power = float(np.mean(null.residual[:, one.joint] ** 2))
    mean, noise = _amplitude(one, curve.mean), _amplitude(one, curve.error)
    if one.kind is CurveKind.AMPLITUDE:
        squares = np.maximum(mean**2 - noise**2, 0.0)
        explained = (
            0.5 * float((squares * one.counts).max()) / len(null.residual)
            if one.against == "order"
            else float(squares.sum())
        )
    else:
        explained = float(
            np.sum(one.counts * np.maximum(mean**2 - noise**2, 0.0)) / len(null.residual)
        )
    return mean, min(explained / max(power, 1e-300), 1.0)


def _amplitude(one: ResidualCurve, cells: Array) -> Array:
    """Of each centre: the value itself, or of cosine and sine."""
    if one.kind is not CurveKind.AMPLITUDE:
        return cells
    half = len(cells) // 2
    return np.hypot(cells[:half], cells[half:]) * one.size


# -- nulls -----------------------------------------------------------------------------------------------------------


def _nulls(found: Diagnosis, scale: Array, rows: MotionRows) -> tuple[_Null, _Null]:
    """How noise becomes the residual of the base model, and of the model with the findings."""
    design, n = found.design, len(scale)
    fitted, held_out = design.halves
    gamma = held_out.gamma[held_out.rows].reshape(len(rows), n, -1)
    starts, recorded = _train_starts(found), fitted.rows
    floor = found.floor / scale if found.method == "periods" else None
    left, residuals, columns = design.residual[0], [r / scale for r in found.residuals], [fitted.gamma]
    together = found.verdict.together
    if together is not None:
        which = design.which(together.shapes)
        columns.append(fitted.free(design.columns[0].picked(which).full()))
        left = left - columns[1] @ together.halves[0]
    # what the fit took out of its own residual is put back on average
    spent = min(sum(c.shape[1] for c in columns) / int(recorded.sum()), 0.5)
    noise = (_limited(left[recorded].reshape(-1, n), starts, floor) / np.sqrt(1.0 - spent)).reshape(
        -1, 1
    )
    scores = [
        np.add.reduceat(inverse(c)[:, recorded].T * noise, starts * n, axis=0) for c in columns
    ]
    loud = _limited(residuals[1], rows.starts, floor)
    before = _Null(residuals[0], loud, gamma, scores[0])
    if together is None:
        return before, before
    wider = np.concatenate([gamma, design.carried(which).reshape(len(rows), n, -1)], axis=2)
    return before, _Null(residuals[1], loud, wider, np.hstack(scores))


def _train_starts(found: Diagnosis) -> Array:
    at, out = 0, list[Array]()
    length = residual_curves.block_length(found.motions[0])
    for track in found.motions[0]:
        out.append(at + residual_curves.block_starts(track.time - track.time[0], length))
        at += len(track)
    return np.concatenate(out)


def _limited(residual: Array, starts: Array, floor: Array | None) -> Array:
    """Blocks at most LOUD times as loud as the median block of the joint, and as the floor, where it is known."""
    counts = np.diff([*starts, len(residual)])
    rms = np.sqrt(np.add.reduceat(residual**2, starts, axis=0) / counts[:, None])
    limit = LOUD * (
        np.median(rms, axis=0) if floor is None else np.minimum(np.median(rms, axis=0), floor)
    )
    return residual * np.repeat(np.minimum(1.0, limit / np.maximum(rms, 1e-300)), counts, axis=0)


def _curve(one: ResidualCurve, null: _Null, rows: MotionRows, signs: tuple[Array, Array]) -> _Curve:
    """The curve of the data, its errors, and its statistic under every draw of signs."""
    j, count = one.joint, len(rows.starts)
    cells = one.centres.size * (2 if one.kind is CurveKind.AMPLITUDE else 1)
    blocks, shares = np.empty((count, cells)), np.empty((count, cells))
    mean, entering = np.zeros(cells), np.zeros((cells, null.gamma.shape[2]))
    for first, last in _chunks(rows.starts, len(rows)):
        begin, end = int(rows.starts[first]), int(rows.starts[last]) if last < count else len(rows)
        part = slice(begin, end)
        weights, inner = one.weights(part), rows.starts[first:last] - begin
        blocks[first:last] = np.add.reduceat(weights * null.loud[part, j, None], inner, axis=0)
        shares[first:last] = np.add.reduceat(weights**2, inner, axis=0)
        mean += weights.T @ null.residual[part, j]
        entering += weights.T @ null.gamma[part, j]
    if one.kind is CurveKind.AMPLITUDE:
        half = cells // 2
        shares = np.tile(shares[:, :half] + shares[:, half:], 2)
    shares /= np.maximum(shares.sum(axis=0), 1e-300)
    effective = 1.0 / np.sum(shares**2, axis=0)
    spread = (blocks - shares * blocks.sum(axis=0)) * np.sqrt(
        effective / np.maximum(effective - 1.0, 0.5)
    )
    if one.centred:
        centre = np.eye(cells) - one.counts / one.counts.sum()
        mean, entering, spread = centre @ mean, centre @ entering, spread @ centre.T
    carried = entering @ null.scores.T
    error = np.sqrt(np.maximum(np.sum(spread**2, axis=0) + np.sum(carried**2, axis=1), 1e-300))
    drawn = (signs[0] @ spread - signs[1] @ carried.T) / error
    z = _normal(mean / error, np.maximum(effective - 1.0, 1.0))
    return _Curve(mean, error, float(_statistic(one, z[None])[0]), _statistic(one, drawn))


def _normal(t: Array, freedom: Array) -> Array:
    """Normal deviates as unlikely as these of Student's: an error from a few blocks may be too small by chance."""
    from scipy import special  # slow to import

    return np.asarray(
        -np.sign(t) * special.ndtri(np.maximum(special.stdtr(freedom, -np.abs(t)), 1e-300))
    )


def _chunks(starts: Array, count: int) -> list[tuple[int, int]]:
    """Ranges of whole blocks of about CHUNK rows."""
    size = max(1, int(CHUNK * len(starts) / max(count, 1)))
    return [(k, min(k + size, len(starts))) for k in range(0, len(starts), size)]


def _statistic(one: ResidualCurve, z: Array) -> Array:
    """Of each row of z. Shape (d, c) -> (d,)."""
    squares = z**2
    if one.against == "order":
        half = squares.shape[1] // 2
        return np.asarray(np.cbrt((squares[:, :half] + squares[:, half:]).max(axis=1)))
    return np.asarray(np.cbrt(squares.sum(axis=1)))


def _p_values(curves: Sequence[_Curve]) -> tuple[Array, Array]:
    """p-value of each curve against the largest of all, and its statistic in null deviations."""
    if not curves:
        return np.empty(0), np.empty(0)
    nulls = np.array([c.nulls for c in curves])
    middle, spread = nulls.mean(axis=1), np.maximum(nulls.std(axis=1), 1e-12)
    score = (np.array([c.statistic for c in curves]) - middle) / spread
    largest = np.max((nulls - middle[:, None]) / spread[:, None], axis=0)
    return (1.0 + (largest[None] >= score[:, None]).sum(axis=1)) / (1.0 + len(largest)), score
