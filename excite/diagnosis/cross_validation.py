"""Cross-validation of effects: what is fitted to some recordings has to predict the others.

Folds are the training recordings, or the thirds of a single one. Models are compared by the
likelihood of their errors, with a variance E_rj / N_rj of its own for each joint and recording,

    Σ_j Σ_r N_rj ln E_rj / Σ_r N_rj,

E_rj is the sum of N_rj squared errors. Fitted to a slow recording, any model predicts a fast one
badly: in a sum over all, the joint and the recording that it predicts worst would decide alone.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from .._types import BoolArray, FloatArray
from . import posterior, session_changes
from .joint_model import JointModel, transient_rows
from .posterior import EffectEvidence

PARTS = 3
"""Folds of a single recording."""


def _folds(model: JointModel) -> list[BoolArray]:
    """Return the rows of each fold, shapes (N,)."""
    sources = [motion.segment.source for motion in model.motions]
    of_row = np.repeat(sources, [len(motion) for motion in model.motions])
    names = session_changes.sources(model.motions)
    if len(names) > 1:
        return [np.asarray(of_row == name) for name in names]
    third = np.concatenate(
        [np.arange(len(motion)) * PARTS // len(motion) for motion in model.motions]
    )
    return [np.asarray(third == part) for part in range(PARTS)]


def gain(
    model: JointModel, left_out: Collection[int], other: JointModel, other_left_out: Collection[int]
) -> float:
    """Return the log-likelihood that a model gains over another on rows that are not fitted.

    Each is taken without the effects of the numbers `left_out`; both have the same motions. Rows in
    which a transient effect of either acts say nothing of it, and their large errors would hide all
    others; but other rows are predicted better by a fit that has its torque.
    """
    judged = ~transient_rows([*model.models, *other.models], model.motions)
    rows = model.regression.independent_share * model.regression.moving[judged].sum(axis=0)
    errors = _log_errors(other, [other_left_out], judged)
    errors -= _log_errors(model, [left_out], judged)
    return 0.5 * float(rows @ errors[0])


def select(model: JointModel) -> list[EffectEvidence]:
    """Return the evidence of all effects, after some are left out.

    These are effects that are not needed, and those that spoil the prediction of a joint which is
    predicted worse than by the base model alone.
    """
    evidence = posterior.select(model)
    everything = set(range(len(model.models)))
    judged = ~transient_rows(model.models, model.motions)
    while True:
        left_out = posterior.left_out(evidence)
        base, present = _log_errors(model, [everything, left_out], judged)
        joint = int(np.argmax(present - base))
        if present[joint] <= base[joint]:
            return evidence
        # a joint without effects is predicted worse where the folds do not determine the base model
        group = _spoiling_group(model, joint, left_out, present, evidence, judged)
        if not group:
            return evidence
        spoiling = {e.key for e in evidence if group & set(e.members)}
        evidence = [
            replace(e, is_in_model=False, spoils_prediction=True) if e.key in spoiling else e
            for e in evidence
        ]


def _spoiling_group(
    model: JointModel,
    joint: int,
    left_out: Collection[int],
    present: FloatArray,
    evidence: Sequence[EffectEvidence],
    judged: BoolArray,
) -> frozenset[int]:
    """Return the effect without which a joint and the whole robot are predicted better, or none.

    All effects of the joint together are an alternative. `present` are the logarithms of the errors
    of all joints without those that are left out already, shape (n,).
    """
    groups = [
        frozenset(entry.members)
        for entry in evidence
        if entry.is_in_model and joint in model.regression.joints_of(entry.members)
    ]
    if not groups:
        return frozenset()
    groups.append(frozenset().union(*groups))
    errors = _log_errors(model, [{*left_out, *group} for group in groups], judged)
    total = np.where(errors[:, joint] < present[joint], errors.sum(axis=1), np.inf)
    best = int(np.argmin(total))
    return groups[best] if total[best] < present.sum() else frozenset()


def _log_errors(
    model: JointModel, variants: Sequence[Collection[int]], judged: BoolArray
) -> FloatArray:
    """Mean log squared errors on rows to which variants are not fitted, shape (variants, n).

    `judged` rows count, shape (N,).
    """
    regression, parts = model.regression, _folds(model)
    unused = np.zeros(len(regression.nonnegative), bool)
    unused[model.session_places] = True
    unused[model.form_places] = True  # the saved model has none
    # a change from the mean of the others, not from the mean of all, as its column is
    change = ((1.0 - model.weights_in_mean) ** 2).reshape(len(model.weights_in_mean), -1)
    change = np.tile(change, len(change) - 1)
    errors = regression.cross_validated(
        parts, variants, unused, model.session_places, change, judged
    )
    rows = np.array([regression.moving[part & judged].sum(axis=0) for part in parts], float)
    if len(session_changes.sources(model.motions)) == 1:
        errors, rows = (x.sum(axis=0, keepdims=True) for x in (errors, rows))
    weights = rows / np.maximum(rows.sum(axis=0), 1.0)
    logs = np.log(np.maximum(errors, 1e-300))
    return np.asarray(np.einsum("rj,rvj->vj", weights, logs))
