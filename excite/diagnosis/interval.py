"""Parameters of what was found, and how far off they may be.

Three things move a parameter: noise, by the fit's covariance; values that a grid had fixed, linearised beside the coefficients; and a law
that is not quite the catalogue's, or has what no recording shows. Of the last, the fit leaves a part, r, and takes the rest for its own: by
Cauchy and Schwarz a misfit as large as r moves a parameter by no more than ‖r‖ √(G⁻¹)ᵢᵢ, G the products of columns that the base leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..effects import EFFECTS_BY_NAME
from ..effects.effect import CandidateModel, Effect
from . import search
from .hypothesis import acting
from .judge import Verdict
from .search import EffectRegression

Array = np.ndarray
FORM = 0.1
"""Relative standard deviation of a parameter whose effect's form is not quite the robot's, where the effect states none: fitted to other
effects it covers nine in ten."""
HIDDEN = 0.3
"""Of the misfit that the fit leaves, what it takes for its own."""
STEP = 0.02
"""Change of a value's logarithm that its column is the secant of."""
FARTHEST = 1.5
"""Change of a value's logarithm, at the most."""
UNFELT, NUDGE, MOVED = 1e-6, 1e-3, 1e-4
"""Torque of a coefficient over that of another of the same shape, below which it is rounding; and what a parameter moves, over its value,
where such a coefficient moves by so much of the others, from which no recording here shows it."""
DRAWS = 200
MIDDLE = 15.87, 84.13
"""Percentiles between which two standard deviations lie."""


@dataclass(frozen=True)
class FitCovariance:
    """How fitted shapes may vary together. root: of the covariance of all coefficients, then of the logarithms of turned values, of unit
    noise. places: of those in `root`, by the number of the shape; none of a shape whose value is not turned. Shape (K + m, K + m).
    """

    root: Array
    places: dict[int, int]


def finding_parameters(
    one: EffectRegression, verdict: Verdict, number: int
) -> dict[str, tuple[float, float]]:
    """The contract's parameters of a finding that the recordings show: value and standard deviation. How far a planar arm's base leans out
    of its plane, none does."""
    together, finding = verdict.together, verdict.findings[number]
    assert together is not None
    effect = EFFECTS_BY_NAME[finding.main.effect]
    alike = [together.shapes.index(part.shape) for part in finding.parts]

    def parts(c: Array, turned: Array | None = None) -> list[tuple[CandidateModel, Array]]:
        split_by_motion = one.split(together.shapes, c)
        shapes = {k: one.shapes[together.shapes[k]] for k in alike}
        if turned is not None:
            shapes = {
                k: _turned(shape, turned[spread.places[k]] if k in spread.places else 0.0)
                for k, shape in shapes.items()
            }
        return [(shapes[k], split_by_motion[k]) for k in alike]

    spread = spreads(one, verdict)
    fitted = parts(together.coefficients)
    value, unseen, others = (
        effect.reported_parameters(fitted),
        effect.unobserved_std(fitted),
        [effect.reported_parameters(parts(half)) for half in together.halves],
    )
    wide = np.sqrt(1.0 + (HIDDEN * misfit(one, verdict, number)) ** 2)
    draws = wide * np.random.default_rng(0).normal(size=(DRAWS, len(spread.root))) @ spread.root.T
    count = len(together.coefficients)
    cloud = [
        effect.reported_parameters(parts(together.coefficients + draw[:count], np.clip(draw, -FARTHEST, FARTHEST)))
        for draw in draws
    ]
    out, hidden = (
        {},
        _hidden(effect, fitted, [_felt(one.prior[one.places[together.shapes[k]]]) for k in alike]),
    )
    for key, mean in value.items():
        if key in hidden:
            continue
        low, high = np.nanpercentile([c[key] for c in cloud], MIDDLE)
        halves = (
            abs(others[0][key] - others[1][key]) / 2.0
            if one.shapes[finding.main.shape].interval is None
            else 0.0
        )
        form = effect.form_std.get(key, FORM) * abs(mean)
        out[key] = (
            mean,
            float(
                np.sqrt((0.5 * (high - low)) ** 2 + halves**2 + form**2 + unseen.get(key, 0.0) ** 2)
            ),
        )
    return out


def _hidden(
    effect: Effect, fitted: Sequence[tuple[CandidateModel, Array]], which: Sequence[Array]
) -> set[str]:
    """Parameters that hang on coefficients which no joint feels. which: those that one does. Shapes (k,)."""
    out, value = set[str](), effect.reported_parameters(fitted)
    for number, ((shape, c), felt) in enumerate(zip(fitted, which, strict=True)):
        for k in np.flatnonzero(~felt):
            nudged = c.copy()
            nudged[k] += NUDGE * float(np.sqrt(np.mean(c[felt] ** 2)))
            moved = effect.reported_parameters([*fitted[:number], (shape, nudged), *fitted[number + 1 :]])
            out |= {key for key, was in value.items() if abs(moved[key] - was) > MOVED * abs(was)}
    return out


def _felt(prior: Array) -> Array:
    """Which columns of a shape some joint feels. Shape (k,)."""
    return np.asarray(prior >= UNFELT**2 * prior.max())


def _turned(shape: CandidateModel, by: float) -> CandidateModel:
    """A shape whose value's logarithm is another."""
    return (
        shape
        if shape.nonlinear is None or not by
        else shape.nonlinear.at(shape.nonlinear.value * float(np.exp(by)))
    )


def spreads(one: EffectRegression, verdict: Verdict) -> FitCovariance:
    """The covariance of everything that was fitted."""
    together = verdict.together
    assert together is not None
    which = one.which(together.shapes)
    columns = [part.picked(which) for part in one.columns]
    turned = list[list[Array]]()
    places: dict[int, int] = {}
    for k, (i, c) in enumerate(
        zip(together.shapes, one.split(together.shapes, together.coefficients), strict=True)
    ):
        above, below = (
            one.build(_turned(one.shapes[i], by)) if one.shapes[i].nonlinear else None
            for by in (STEP, -STEP)
        )
        if above is not None and below is not None:
            places[k] = len(which) + len(places)
            turned.append(
                [
                    ((a.full() - b.full()) @ c)[:, None] / (2.0 * STEP)
                    for a, b in zip(above, below, strict=True)
                ]
            )
    every = [
        np.hstack([part.full(), *(own[half] for own in turned)])
        for half, part in enumerate(columns)
    ]
    free = one.both.free(np.concatenate(every))
    G = free.T @ free
    # a value's logarithm is known to one, as its grid's neighbours are
    G[np.diag_indices_from(G)] += np.concatenate([one.prior[which], np.ones(len(places))])
    own = one.split(together.shapes, np.arange(len(which)))
    for rows, c in zip(own, one.split(together.shapes, together.coefficients), strict=True):
        _unfelt(G, rows, one.prior[which[rows]], c)
    values, vectors = np.linalg.eigh(G)
    return FitCovariance(vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])), places)


def _unfelt(G: Array, rows: Array, prior: Array, c: Array) -> None:
    """Columns of a shape that no joint feels, such as a force out of an arm's plane, are taken to be as large as those that one feels."""
    unfelt = ~_felt(prior)
    if unfelt.any():
        places = rows[unfelt]
        G[places] = G[:, places] = 0.0
        G[places, places] = 1.0 / max(float(np.mean(c[~unfelt] ** 2)), 1e-300)


def misfit(one: EffectRegression, verdict: Verdict, number: int) -> float:
    """Norm of what the fit leaves beyond unit noise where a finding acts."""
    together, main = verdict.together, verdict.findings[number].main
    assert together is not None
    left = search.remaining(one, together.shapes)[:, acting(one, together, main.shape)]
    return float(np.sqrt(max(np.sum(left**2) - left.size, 0.0)))
