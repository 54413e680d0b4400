"""Reported parameters of a finding and their standard deviations.

Three causes contribute: noise, by the covariance of the fit; nonlinear parameters, which are
linearised and estimated jointly with the coefficients; and an effect whose form is not quite the
model's, or that has parts no recording shows. For the latter, the fit leaves a misfit r and absorbs
a part of similar size: by the Cauchy-Schwarz inequality a misfit of norm ‖r‖ moves a parameter by
at most ‖r‖ √(G⁻¹)ᵢᵢ, with G the Gram matrix of the columns projected off the base.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..effects import EFFECTS_BY_NAME
from ..effects.effect import CandidateModel, Effect, FittedModels
from . import search
from .hypothesis import acting
from .judge import Verdict
from .search import EffectRegression

FORM = 0.1
"""Relative standard deviation of a parameter by the form of the effect, where the effect states
none; with it the intervals of the other effects cover nine in ten."""
ABSORBED_MISFIT = 0.3
"""Misfit that the fit absorbs over the misfit that it leaves."""
LOG_STEP = 0.02
"""Step of the finite differences by the logarithm of a nonlinear parameter."""
MAX_LOG_CHANGE = 1.5
"""Largest change of the logarithm of a nonlinear parameter in the random draws."""
UNOBSERVED_RATIO = 1e-6
"""Column RMS over that of the largest column of the same model, below which it is rounding."""
NUDGE = 1e-3
"""Change of an unobserved coefficient over the RMS of the observed ones that tests a parameter."""
MIN_RELATIVE_CHANGE = 1e-4
"""Relative change of a parameter by that nudge from which it counts as unobserved."""
DRAWS = 200
"""Random draws of coefficients from their covariance."""
PERCENTILES = 15.87, 84.13
"""Percentiles of the normal distribution one standard deviation below and above the mean."""


@dataclass(frozen=True)
class FitCovariance:
    """Joint covariance of the fitted candidate models.

    Attributes:
        root: Square root of the covariance of all coefficients, then of the logarithms of the
            nonlinear parameters, shape (K + m, K + m).
        places: Index in `root` of the nonlinear parameter of a model, by the model's position in
            the fit; absent where nothing was optimised.
    """

    root: FloatArray
    places: dict[int, int]


def finding_parameters(
    regression: EffectRegression, verdict: Verdict, number: int
) -> dict[str, tuple[float, float]]:
    """Return the observed parameters of a finding: value and standard deviation by name.

    Parameters that no recording shows are left out, as the tilt of a planar arm's base out of its
    plane.

    Args:
        regression: The effect regression.
        verdict: The verdict.
        number: Index of the finding.
    """
    together, finding = verdict.together, verdict.findings[number]
    assert together is not None
    effect = EFFECTS_BY_NAME[finding.main.effect]
    positions = [together.shapes.index(part.shape) for part in finding.parts]

    def models(c: FloatArray, log_changes: FloatArray | None = None) -> FittedModels:
        coefficients = regression.split(together.shapes, c)
        changed = {k: regression.shapes[together.shapes[k]] for k in positions}
        if log_changes is not None:
            changed = {
                k: _with_log_change(
                    model, log_changes[covariance.places[k]] if k in covariance.places else 0.0
                )
                for k, model in changed.items()
            }
        return [(changed[k], coefficients[k]) for k in positions]

    covariance = fit_covariance(regression, verdict)
    fitted = models(together.coefficients)
    values, unobserved_std = effect.reported_parameters(fitted), effect.unobserved_std(fitted)
    by_fold = [effect.reported_parameters(models(c)) for c in together.halves]
    inflation = np.sqrt(1.0 + (ABSORBED_MISFIT * misfit(regression, verdict, number)) ** 2)
    normal = np.random.default_rng(0).normal(size=(DRAWS, len(covariance.root)))
    draws = inflation * normal @ covariance.root.T
    count = len(together.coefficients)
    cloud = [
        effect.reported_parameters(
            models(
                together.coefficients + draw[:count], np.clip(draw, -MAX_LOG_CHANGE, MAX_LOG_CHANGE)
            )
        )
        for draw in draws
    ]
    observed = [
        _observed_columns(regression.prior[regression.places[together.shapes[k]]])
        for k in positions
    ]
    out, unobserved = {}, _unobserved_parameters(effect, fitted, observed)
    for key, value in values.items():
        if key in unobserved:
            continue
        low, high = np.nanpercentile([c[key] for c in cloud], PERCENTILES)
        fold_difference = (
            abs(by_fold[0][key] - by_fold[1][key]) / 2.0
            if regression.shapes[finding.main.shape].interval is None
            else 0.0
        )
        form = effect.form_std.get(key, FORM) * abs(value)
        variance = (
            (0.5 * (high - low)) ** 2
            + fold_difference**2
            + form**2
            + unobserved_std.get(key, 0.0) ** 2
        )
        out[key] = (value, float(np.sqrt(variance)))
    return out


def _unobserved_parameters(
    effect: Effect, fitted: FittedModels, observed: Sequence[BoolArray]
) -> set[str]:
    """Parameters that depend on coefficients which no joint observes."""
    out, values = set[str](), effect.reported_parameters(fitted)
    for number, ((model, c), columns) in enumerate(zip(fitted, observed, strict=True)):
        for k in np.flatnonzero(~columns):
            nudged = c.copy()
            nudged[k] += NUDGE * float(np.sqrt(np.mean(c[columns] ** 2)))
            changed = effect.reported_parameters(
                [*fitted[:number], (model, nudged), *fitted[number + 1 :]]
            )
            out |= {
                key
                for key, value in values.items()
                if abs(changed[key] - value) > MIN_RELATIVE_CHANGE * abs(value)
            }
    return out


def _observed_columns(prior: FloatArray) -> BoolArray:
    """Columns of a model that some joint observes, shape (k,)."""
    return np.asarray(prior >= UNOBSERVED_RATIO**2 * prior.max())


def _with_log_change(model: CandidateModel, change: float) -> CandidateModel:
    """The model with the logarithm of its nonlinear parameter changed."""
    if model.nonlinear is None or not change:
        return model
    return model.nonlinear.at(model.nonlinear.value * float(np.exp(change)))


def fit_covariance(regression: EffectRegression, verdict: Verdict) -> FitCovariance:
    """Return the joint covariance of all coefficients and nonlinear parameters."""
    together = verdict.together
    assert together is not None
    which = regression.which(together.shapes)
    columns = [part.picked(which) for part in regression.columns]
    coefficients = regression.split(together.shapes, together.coefficients)
    derivatives = list[list[FloatArray]]()
    places: dict[int, int] = {}
    for k, (i, c) in enumerate(zip(together.shapes, coefficients, strict=True)):
        above, below = (
            regression.build(_with_log_change(regression.shapes[i], step))
            if regression.shapes[i].nonlinear
            else None
            for step in (LOG_STEP, -LOG_STEP)
        )
        if above is not None and below is not None:
            places[k] = len(which) + len(places)
            derivatives.append(
                [
                    ((a.full() - b.full()) @ c)[:, None] / (2.0 * LOG_STEP)
                    for a, b in zip(above, below, strict=True)
                ]
            )
    joint_columns = [
        np.hstack([part.full(), *(by_fold[fold] for by_fold in derivatives)])
        for fold, part in enumerate(columns)
    ]
    free = regression.both.free(np.concatenate(joint_columns))
    G = free.T @ free
    # prior: a nonlinear parameter is known within a factor e, about the distance of grid values
    G[np.diag_indices_from(G)] += np.concatenate([regression.prior[which], np.ones(len(places))])
    rows_by_model = regression.split(together.shapes, np.arange(len(which)))
    for rows, c in zip(rows_by_model, coefficients, strict=True):
        _decouple_unobserved(G, rows, regression.prior[which[rows]], c)
    values, vectors = np.linalg.eigh(G)
    return FitCovariance(vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])), places)


def _decouple_unobserved(G: FloatArray, rows: IntArray, prior: FloatArray, c: FloatArray) -> None:
    """Give unobserved coefficients the size of the observed ones as their standard deviation.

    An example is a force out of the plane of a planar arm.
    """
    unobserved = ~_observed_columns(prior)
    if unobserved.any():
        places = rows[unobserved]
        G[places] = G[:, places] = 0.0
        G[places, places] = 1.0 / max(float(np.mean(c[~unobserved] ** 2)), 1e-300)


def misfit(regression: EffectRegression, verdict: Verdict, number: int) -> float:
    """Return the norm of the residual beyond unit noise on the joints where a finding acts."""
    together, main = verdict.together, verdict.findings[number].main
    assert together is not None
    acts = acting(regression, together, main.shape)
    residual = search.remaining(regression, together.shapes)[:, acts]
    return float(np.sqrt(max(np.sum(residual**2) - residual.size, 0.0)))
