"""Random errors of a URDF: bodies that differ by a few per cent and stay physically consistent."""

from __future__ import annotations

import numpy as np

from .urdf_tree import UrdfTree


def perturb_bodies(tree: UrdfTree, size: float, rng: np.random.Generator) -> UrdfTree:
    """Return the tree with bodies that differ by about a relative `size` (0.05: 5 %).

    The pseudo-inertia P becomes (1 + ε) A P Aᵀ with an affine map A near the identity. The result
    is a pseudo-inertia for any A (Lee, Wensing & Park, "Geometric robot dynamic identification",
    eq. 15).

    Args:
        tree: The robot.
        size: Relative size of the error [1].
        rng: Generator of the draw.
    """
    for link in tree.links:
        pseudo_inertia = tree.pseudo_inertia(link)
        mass = pseudo_inertia[3, 3]
        if mass <= 0.0:
            continue
        length = float(np.sqrt(max(np.trace(pseudo_inertia[:3, :3]), 0.0) / mass))
        affine = np.eye(4)
        affine[:3, :3] += size * rng.standard_normal((3, 3)) / np.sqrt(3.0)
        affine[:3, 3] = size * length * rng.standard_normal(3)
        tree = tree.with_pseudo_inertia(
            link, float(np.exp(size * rng.standard_normal())) * affine @ pseudo_inertia @ affine.T
        )
    return tree
