"""Which effects these recordings cannot tell apart, whatever they show: how alike their torques are once the base model is refit."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .search import EffectRegression, gains

Array = np.ndarray
RANK = 1e-9
ALIKE = 0.9
"""Canonical correlation from which two effects count as alike."""


@dataclass(frozen=True)
class EffectAtJoint:
    """An effect at a joint, in the shape that fits best. joint: None where it is nobody's."""

    effect: str
    joint: int | None
    shape: int


@dataclass(frozen=True)
class Isolability:
    """matrix: largest canonical correlation of each two candidates' torques, 0 to 1. Shape (m, m)."""

    candidates: tuple[EffectAtJoint, ...]
    matrix: Array

    def of(self, joint: int) -> list[int]:
        """Candidates at a joint, or at none in particular."""
        return [k for k, c in enumerate(self.candidates) if c.joint in (joint, None)]

    def pairs(self, least: float = ALIKE) -> list[tuple[EffectAtJoint, EffectAtJoint, float]]:
        """Two names that are alike, the most alike first."""
        couples = [
            (a, b, float(self.matrix[i, k]))
            for (i, a), (k, b) in itertools.combinations(enumerate(self.candidates), 2)
            if a.effect != b.effect and self.matrix[i, k] >= least
        ]
        return sorted(couples, key=lambda pair: -pair[2])


def isolability(one: EffectRegression) -> Isolability:
    """Canonical correlations over both recording sets of what the base model leaves of every effect's columns."""
    best: dict[tuple[str, int | None], tuple[float, int]] = {}
    for i, (shape, gain) in enumerate(zip(one.shapes, gains(one).tolist(), strict=True)):
        key = (shape.effect, shape.joint)
        if key not in best or gain > best[key][0]:
            best[key] = gain, i
    gram = one.grams[0].matrix + one.grams[1].matrix
    candidates, parts = list[EffectAtJoint](), list[Array]()
    for (effect, joint), (_, i) in best.items():
        place = one.places[i]
        values, vectors = np.linalg.eigh(gram[place, place])
        kept = values > RANK * max(float(values.max()), 1e-300)
        if values.max() <= 0.0:
            continue
        part = np.zeros((len(gram), int(kept.sum())))
        part[place] = vectors[:, kept] / np.sqrt(values[kept])
        candidates.append(EffectAtJoint(effect, joint, i))
        parts.append(part)
    matrix = np.eye(len(parts))
    if parts:
        ends = np.cumsum([0, *(p.shape[1] for p in parts)])
        everything = np.hstack(parts)
        products = everything.T @ gram @ everything
        for i, k in itertools.combinations(range(len(parts)), 2):
            cross = products[ends[i] : ends[i + 1], ends[k] : ends[k + 1]]
            matrix[i, k] = matrix[k, i] = min(float(np.linalg.norm(cross, 2)), 1.0)
    return Isolability(tuple(candidates), matrix)
