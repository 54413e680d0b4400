"""Cross-validation of effects: what is fitted to some recordings has to predict the others.

Folds are the training recordings, or the thirds of a single one.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from .._types import BoolArray, FloatArray
from . import session_changes
from .joint_model import JointModel
from .posterior import EffectEvidence

PARTS = 3
"""Folds of a single recording."""
WORSE = 1.02
"""Squared error of a joint over that of the base model from which its effects do not predict."""


def folds(model: JointModel) -> list[BoolArray]:
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


def pays(
    model: JointModel,
    effects: Sequence[int],
    left_out: Collection[int] = (),
    min_gain: float = 0.0,
) -> bool:
    """Tell whether effects lower the error on recordings to which they are not fitted.

    An effect that acts only for some time cannot be judged in this way, and passes.

    Args:
        model: A joint model that has them.
        effects: Their numbers.
        left_out: Numbers of other effects that are left out.
        min_gain: Least gain of the log likelihood of those recordings.
    """
    if any(model.models[e].interval is not None for e in effects):
        return True
    without, with_ = _errors(model, [{*left_out, *effects}, left_out])
    return bool(0.5 * (without.sum() - with_.sum()) > min_gain)


def without_unpredictive(
    model: JointModel, left_out: Collection[int], evidence: Sequence[EffectEvidence]
) -> frozenset[int]:
    """Leave out effects of joints that are predicted worse than by the base model alone.

    Args:
        model: The joint model.
        left_out: Effects that are left out already.
        evidence: Evidence of all effects.

    Returns:
        All effects that are left out.
    """
    out = set(left_out)
    everything = set(range(len(model.models)))
    while True:
        base, present = _errors(model, [everything, out])
        joint = int(np.argmax(present / base))
        if present[joint] <= WORSE * base[joint]:
            return frozenset(out)
        # a joint without effects is predicted worse where the folds do not determine the base model
        group = _spoiling_group(model, joint, out, present, evidence)
        if not group:
            return frozenset(out)
        out |= group


def _spoiling_group(
    model: JointModel,
    joint: int,
    left_out: Collection[int],
    present: FloatArray,
    evidence: Sequence[EffectEvidence],
) -> frozenset[int]:
    """Return the effect without which a joint and the whole robot are predicted better.

    All effects of the joint together are an alternative. Empty if there is none: an effect may
    explain more at other joints than it spoils at this one.

    Args:
        model: The joint model.
        joint: Index of the joint.
        left_out: Effects that are left out already.
        present: Cross-validated errors of all joints with all others, shape (n,).
        evidence: Evidence of all effects.
    """
    groups = [
        frozenset(entry.effects)
        for entry in evidence
        if not set(entry.effects) <= set(left_out)
        and joint in [j for e in entry.effects for j in model.regression.joints_of(e)]
        and all(model.models[e].interval is None for e in entry.effects)
    ]
    if not groups:
        return frozenset()
    groups.append(frozenset().union(*groups))
    errors = _errors(model, [{*left_out, *group} for group in groups])
    total = np.where(errors[:, joint] < present[joint], errors.sum(axis=1), np.inf)
    best = int(np.argmin(total))
    return groups[best] if total[best] < present.sum() else frozenset()


def _errors(model: JointModel, variants: Sequence[Collection[int]]) -> FloatArray:
    """Cross-validated errors of variants, shape (variants, n)."""
    regression = model.regression
    unused = np.zeros(len(regression.nonnegative), bool)
    unused[model.session_places] = True
    unused[model.form_places] = True  # the saved model has none
    return regression.cross_validated(folds(model), variants, unused)
