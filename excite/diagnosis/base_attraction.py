"""Attraction of a base model with effects to the base model that is fitted alone.

The base parameters are fitted jointly with the effects. On a short recording the torque of a joint
that the effects explain well may then decide parameters of links that other joints carry as well,
and bend their torque elsewhere. The torque that the base model predicts alone is therefore a prior,

    J(θ, c) + ½ Σ_j α_j (θ − θ_b)ᵀ A_j (θ − θ_b),

with the estimate θ_b of that fit and the information A_j that joint j has in it. The α_j are raised
one after the other, as long as a joint is predicted worse than by the base model alone on folds to
which both are fitted anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray
from ..identification.identification import Identification
from . import cross_validation, joint_model
from .joint_model import JointModel
from .normal_equations import Solution
from .regression import JointRegression

WORSE = 1.02
"""Squared error of a joint over that of the base model alone from which it is predicted worse."""
ATTRACTIONS = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Values of α_j that are compared: with 0 the effects alone decide, with 30 the base model hardly
moves."""


def attract(identified: Identification, model: JointModel) -> None:
    """Add the prior to the regression of a joint model, where a joint needs it.

    Args:
        identified: The base model that is fitted alone.
        model: The joint model of what is saved.
    """
    psi = joint_model.initial_parameters(identified)
    motions = joint_model.renewed(identified, model.motions, psi, identified.model.widths)
    alone = joint_model.base_model(identified, motions, psi).regression
    alone.fix_at_zero(range(len(model.free), model.delay_place + 1))
    alpha = _attractions(model, alone)
    if alpha.any():
        mean = (identified.model.base.matrix @ psi)[model.free]
        information = alone.information_by_joint(len(model.free))
        model.regression.attract(mean, np.tensordot(alpha, information, 1))


def _attractions(model: JointModel, alone: JointRegression) -> FloatArray:
    """Return the α_j with which no joint is predicted worse than by the base model alone, (n,).

    Where it is always one, those with which it is least so.

    Args:
        model: The joint model.
        alone: The regression of the base model alone.
    """
    judged = ~joint_model.transient_rows(model.models, model.motions)
    folds = [_Fold.of(model, alone, rows, judged) for rows in cross_validation.folds(model)]
    base = cross_validation.mean_log(model, np.array([fold.base_error for fold in folds]))
    steps = np.zeros(model.n, int)
    tried: list[tuple[float, FloatArray]] = []
    while True:
        alpha = np.array(ATTRACTIONS)[steps]
        errors = np.array([fold.error(alpha) for fold in folds])
        ratio = np.exp(cross_validation.mean_log(model, errors) - base)
        tried.append((float(ratio.max()), alpha))
        raised = (ratio > WORSE) & (steps < len(ATTRACTIONS) - 1)
        if not raised.any():
            return min(tried, key=lambda entry: max(entry[0], WORSE))[1]
        steps[int(np.argmax(np.where(raised, ratio, 0.0)))] += 1


@dataclass(frozen=True)
class _Fold:
    """Rows that are predicted by fits to the others.

    Attributes:
        rows: The rows that are predicted, shape (N,).
        model: The joint model.
        fitted: Its regression on the other rows.
        mean: Base parameters of the base model alone, fitted to the other rows, shape (p,).
        information: Their information from the rows of each joint, shape (n, p, p).
        base_error: Squared error of the base model alone on the rows, shape (n,).
    """

    rows: BoolArray
    model: JointModel
    fitted: JointRegression
    mean: FloatArray
    information: FloatArray
    base_error: FloatArray

    @classmethod
    def of(
        cls, model: JointModel, alone: JointRegression, rows: BoolArray, judged: BoolArray
    ) -> _Fold:
        """Fit the base model alone to the other rows.

        Args:
            model: The joint model.
            alone: The regression of the base model alone.
            rows: The rows of the fold, shape (N,).
            judged: Rows that are predicted at all, shape (N,).
        """
        p = len(model.free)
        others = alone.on_rows(~rows)
        base = _without_changes(others, model)
        predicted = rows & judged
        return cls(
            predicted,
            model,
            model.regression.on_rows(~rows),
            base.coefficients[:p],
            others.information_by_joint(p),
            _squared_error(alone, base, predicted),
        )

    def error(self, alpha: FloatArray) -> FloatArray:
        """Return the squared error of the joint model on the rows, shape (n,).

        Args:
            alpha: Attraction of its base model to the base model alone, shape (n,).
        """
        fitted = self.fitted.copy()
        fitted.attract(self.mean, np.tensordot(alpha, self.information, 1))
        solution = _without_changes(fitted, self.model)
        return _squared_error(self.model.regression, solution, self.rows)


def _without_changes(regression: JointRegression, model: JointModel) -> Solution:
    """Minimum without changes between recordings, which say nothing about another recording."""
    return regression.without((), range(model.session_places.start, model.session_places.stop))


def _squared_error(regression: JointRegression, solution: Solution, rows: BoolArray) -> FloatArray:
    """Squared error of a solution on some rows of a regression, shape (n,)."""
    residual = np.where(regression.moving, regression.residual(solution), 0.0)
    return np.asarray(np.sum(residual[rows] ** 2, axis=0))
