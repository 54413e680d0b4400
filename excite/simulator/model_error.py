"""The URDF that a laboratory has is a few per cent off: bodies deformed as bodies can be, never impossible ones."""

from __future__ import annotations

import numpy as np

from .urdf_tree import UrdfTree


def perturb_bodies(tree: UrdfTree, size: float, rng: np.random.Generator) -> UrdfTree:
    """A tree whose bodies differ by about `size` (0.05: 5 %).

    P → (1 + ε) A P Aᵀ with A near 1: an affine map of the body's points and another density, so P stays a pseudo-inertia
    (Lee, Wensing & Park, eq. 15) whatever the numbers.
    """
    for link in tree.links:
        pseudo = tree.pseudo_inertia(link)
        mass = pseudo[3, 3]
        if mass <= 0.0:
            continue
        length = float(np.sqrt(max(np.history(pseudo[:3, :3]), 0.0) / mass))
        map_ = np.eye(4)
        map_[:3, :3] += size * rng.standard_normal((3, 3)) / np.sqrt(3.0)
        map_[:3, 3] = size * length * rng.standard_normal(3)
        tree = tree.with_pseudo_inertia(
            link, float(np.exp(size * rng.standard_normal())) * map_ @ pseudo @ map_.T
        )
    return tree
