"""Test of findings on held-out torque, predicted with coefficients fitted to the training fold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .._types import BoolArray, FloatArray
from . import hypothesis, judge, search
from .judge import Finding, Verdict
from .search import EffectRegression, Trial

WORSE, SHOWN = 1.05, 0.1
"""Held-out mean square with a finding over that without, from which it is refuted; unless the
halves, each by itself, show so much of its gain: a law whose columns are nearly alike in the first
is foretold badly though it is right."""
CHANCE = 9.0
"""Times the variance that coefficients bring which the first half does not tell, that is forgiven:
three standard deviations, as noise has colour, and a law that is not quite right is told worse than
noise lets it."""
BELIEVED = 0.12
"""Probability of a finding that is refuted."""


def residuals(
    one: EffectRegression, together: Trial | None, scale: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the held-out residual of the base model, and with candidate models [N m], (N, n)."""
    before = one.across.reshape(-1, len(scale)) * scale
    if together is None:
        return before, before
    which = one.which(together.shapes)
    # what happened once, in one recording, is known from it alone
    known = (one.split(together.shapes, c) for c in (together.coefficients, together.halves[0]))
    own = [
        c if one.shapes[i].interval is not None else first
        for i, c, first in zip(together.shapes, *known, strict=True)
    ]
    added = one.carried(which) @ np.concatenate(own)
    return before, before - added.reshape(before.shape) * scale


def reach(one: EffectRegression, scale: FloatArray) -> FloatArray:
    """Return the RMS error of held-out torque by the uncertainty of the base parameters [N m],
    (n,).

    Actuator parameters of the held-out recordings alone are not included.
    """
    first, second = one.halves
    gamma, covariance = second.gamma[second.rows] * ~_own(one), first.inverse @ first.inverse.T
    variance = np.sum((gamma @ covariance) * gamma, axis=1)
    return np.asarray(
        np.sqrt(np.mean(np.maximum(variance, 0.0).reshape(-1, len(scale)), axis=0)) * scale
    )


def tested(one: EffectRegression, verdict: Verdict, moves: BoolArray, noise: FloatArray) -> Verdict:
    """Reject findings that worsen the prediction of held-out torque, one by one, the worst first.

    Args:
        one: The effect regression.
        verdict: The verdict.
        moves: Rows of the held-out fold that are judged, shape (N, n).
        noise: Mean square noise over the scale, shape (n,).
    """
    while verdict.findings:
        ratios = [_ratios(one, verdict, finding, moves, noise) for finding in verdict.findings]
        worst = max(range(len(ratios)), key=lambda number: ratios[number])
        if ratios[worst][0] <= WORSE:
            break
        refuted = replace(
            verdict.findings[worst], probability=BELIEVED, evidence={"foretold": ratios[worst][1]}
        )
        verdict = judge.refused(one, verdict, [refuted])
    return verdict


def _ratios(
    one: EffectRegression, verdict: Verdict, finding: Finding, moves: BoolArray, noise: FloatArray
) -> tuple[float, float]:
    """Held-out mean square with a finding over that without it, net of chance, and as it is.

    Zero for transient effects, which cannot be predicted, and for findings that a fold shows by
    itself.
    """
    together = verdict.together
    assert together is not None
    rest = search.trial(one, judge.without(together.shapes, finding.parts))
    if together.seen - rest.seen > SHOWN * finding.gain or any(
        one.shapes[part.shape].interval is not None for part in finding.parts
    ):
        return 0.0, 0.0
    acts, unit = hypothesis.acting(one, together, finding.main.shape), np.ones(len(noise))
    bare, with_all = (levelled(one, left) for left in residuals(one, together, unit))
    without = levelled(one, residuals(one, rest, unit)[1]) if rest.shapes else bare
    spent = [
        float(np.sum((search.mean_square(left, moves) / noise)[acts]))
        for left in (with_all, without, bare)
    ]
    unsure, others = _unsure(one, together, moves), _unsure(one, rest, moves)
    chance = [float(np.sum((x / noise)[acts])) for x in (np.maximum(unsure - others, 0.0), unsure)]
    beyond = [
        (spent[0] - CHANCE * by_chance) / max(than, 1e-300)
        for by_chance, than in zip(chance, spent[1:], strict=True)
    ]
    return max(beyond), spent[0] / max(min(spent[1:]), 1e-300)


def levelled(one: EffectRegression, left: FloatArray) -> FloatArray:
    """Return the held-out residual without what separate actuator parameters explain, (N, n)."""
    own, second = _own(one), one.halves[1]
    if not own.any():
        return left
    columns, known = second.gamma[second.rows][:, own], second.gamma[~second.rows][:, own]
    taken = columns @ np.linalg.solve(
        columns.T @ columns + known.T @ known, columns.T @ left.ravel()
    )
    return np.asarray(left - taken.reshape(left.shape))


def _own(one: EffectRegression) -> BoolArray:
    """Base columns that only the held-out recordings have, shape (p,)."""
    first, second = one.halves
    return np.asarray(~first.gamma[first.rows].any(axis=0) & second.gamma[second.rows].any(axis=0))


def _unsure(one: EffectRegression, found: Trial, moves: BoolArray) -> FloatArray:
    """Mean square error of held-out torque by the uncertainty of the coefficients, shape (n,)."""
    which = one.which(
        [i for i in found.shapes if one.shapes[i].interval is None]
    )  # what happened once is known from where it did
    root = one.usual[which]  # in units of what is usual, where a column of nothing is no matter
    precision = one.grams[0].matrix[np.ix_(which, which)] * np.outer(root, root) + np.eye(
        len(which)
    )
    carried = one.carried(which) * root
    variance = np.sum((carried @ np.linalg.inv(precision)) * carried, axis=1)
    return search.mean_square(np.sqrt(np.maximum(variance, 0.0)).reshape(moves.shape), moves)
