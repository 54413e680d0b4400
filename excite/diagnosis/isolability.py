"""Isolability: which effects the recordings cannot distinguish, whatever they show.

Two effects are alike if the canonical correlation of their torque columns is large after projection
off the base model.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from .search import EffectRegression, gains

RANK_TOLERANCE = 1e-9
"""Eigenvalue of a Gram matrix over its largest one, below which it counts as zero."""
ALIKE = 0.9
"""Canonical correlation from which two effects count as alike."""


@dataclass(frozen=True)
class EffectAtJoint:
    """An effect at a joint in its best candidate model.

    Attributes:
        effect: Name of the effect.
        joint: Index of the joint; None for an effect of no single joint.
        shape: Index of the candidate model in the regression.
    """

    effect: str
    joint: int | None
    shape: int


@dataclass(frozen=True)
class Isolability:
    """Similarity of effects.

    Attributes:
        candidates: Effects at joints, m of them.
        matrix: Largest canonical correlation of each pair's torques, 0 to 1, shape (m, m).
    """

    candidates: tuple[EffectAtJoint, ...]
    matrix: FloatArray

    def of(self, joint: int) -> list[int]:
        """Return the indices of candidates at a joint, or at no single joint."""
        return [k for k, c in enumerate(self.candidates) if c.joint in (joint, None)]

    def pairs(self, threshold: float = ALIKE) -> list[tuple[EffectAtJoint, EffectAtJoint, float]]:
        """Return pairs of different effects with at least this correlation, the largest first."""
        couples = [
            (a, b, float(self.matrix[i, k]))
            for (i, a), (k, b) in itertools.combinations(enumerate(self.candidates), 2)
            if a.effect != b.effect and self.matrix[i, k] >= threshold
        ]
        return sorted(couples, key=lambda pair: -pair[2])


def isolability(regression: EffectRegression) -> Isolability:
    """Compute canonical correlations over both recording sets, after projection off the base."""
    best: dict[tuple[str, int | None], tuple[float, int]] = {}
    for i, (model, gain) in enumerate(
        zip(regression.shapes, gains(regression).tolist(), strict=True)
    ):
        key = (model.effect, model.joint)
        if key not in best or gain > best[key][0]:
            best[key] = gain, i
    gram = regression.grams[0].matrix + regression.grams[1].matrix
    candidates, parts = list[EffectAtJoint](), list[FloatArray]()
    for (effect, joint), (_, i) in best.items():
        place = regression.places[i]
        values, vectors = np.linalg.eigh(gram[place, place])
        kept = values > RANK_TOLERANCE * max(float(values.max()), 1e-300)
        if values.max() <= 0.0:
            continue
        part = np.zeros((len(gram), int(kept.sum())))
        part[place] = vectors[:, kept] / np.sqrt(values[kept])
        candidates.append(EffectAtJoint(effect, joint, i))
        parts.append(part)
    matrix = np.eye(len(parts))
    if parts:
        ends = np.cumsum([0, *(p.shape[1] for p in parts)])
        orthonormal = np.hstack(parts)
        products = orthonormal.T @ gram @ orthonormal
        for i, k in itertools.combinations(range(len(parts)), 2):
            cross = products[ends[i] : ends[i + 1], ends[k] : ends[k + 1]]
            matrix[i, k] = matrix[k, i] = min(float(np.linalg.norm(cross, 2)), 1.0)
    return Isolability(tuple(candidates), matrix)
