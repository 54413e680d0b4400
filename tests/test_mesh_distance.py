"""Distances of meshes along a motion are those of separate queries."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from conftest import write_obj
from scipy.spatial import ConvexHull

from excite.collision.geometry import Shape, ShapeKind
from excite.collision.mesh_distance import MeshDistance


def bumpy_mesh(folder: Path, seed: int) -> coal.BVHModelBase:
    """A closed mesh that is not convex, of 0.2 m size."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    triangles = ConvexHull(directions).simplices
    vertices = directions * rng.uniform(0.05, 0.1, 200)[:, None]
    file = write_obj(folder / f"{seed}.obj", vertices, triangles)
    return Shape("mesh", ShapeKind.MESH, (1.0, 1.0, 1.0), file=file).solid()


def test_an_upper_bound_changes_no_distance(tmp_path):
    solids = [bumpy_mesh(tmp_path, 1), bumpy_mesh(tmp_path, 2), coal.Sphere(0.1)]
    bounded, result = MeshDistance(solids), coal.DistanceResult()
    request, separate = coal.DistanceRequest(), coal.DistanceResult()
    rng, contacts = np.random.default_rng(3), 0
    still = coal.Transform3s.Identity()
    for t in np.linspace(0.0, 6.0, 300):
        rotation = pin.exp3(np.array([np.sin(t), np.cos(2 * t), t]))
        placement = coal.Transform3s(
            rotation, np.array([0.2 * np.cos(t), 0.1 * np.sin(t), 0.02 * t])
        )
        if rng.random() < 0.02:  # a jump
            placement = coal.Transform3s(rotation, rng.normal(size=3))
        for pair in ((0, 1), (0, 2), (2, 0)):
            separate.clear()
            expected = coal.distance(
                solids[pair[0]], still, solids[pair[1]], placement, request, separate
            )
            distance = bounded.nearest(pair, still, placement, result)
            assert abs(distance - expected) < 1e-9
            contacts += expected <= 0.0
            if expected > 0.0:
                ends = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
                assert abs(np.linalg.norm(ends[0] - ends[1]) - expected) < 1e-6
    assert 0 < contacts < 900
