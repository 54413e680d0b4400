"""Collision shapes of the built-in models: capsules that cover the links and are clear at home."""

from __future__ import annotations

import os
import struct
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from conftest import BUILTIN, text_of

from excite.robot.robot import locate

coal = pytest.importorskip("coal")

R = np.pi / 2
CLEAR = 0.02

FRANKA_HOME = [(0, -R / 2, 0, -1.5 * R, 0, R, R / 2)]
UR_HOME = [(0, -R, 0, -R, 0, 0), (0, -R, R, -R, -R, 0)]
HOME = {
    "fr3": FRANKA_HOME,
    "panda": FRANKA_HOME,
    "iiwa14": [(0,) * 7, (0, R / 3, 0, -R, 0, 2 * R / 3, 0)],
    "tx40": [(0,) * 6, (0, -R, R, 0, 0, 0), (0, -R / 2, R / 4, 0, R / 2, 0)],
    "two_link": [(0, 0)],
    "ur10e": UR_HOME,
    "ur5e": UR_HOME,
}

# Folded poses in which the two links collide.
FRANKA_FOLDED = (0, 1.7, 0, -2.6, 0, 1, 0)
UR_FOLDED = (0, -R, 2.9, 0, 0, 0)
FOLDED = {
    "fr3": (FRANKA_FOLDED, "fr3_link0", "fr3_link6"),
    "panda": (FRANKA_FOLDED, "panda_link0", "panda_link6"),
    "iiwa14": ((0, 2.09, 0, -2.09, 0, 0, 0), "iiwa_link_0", "iiwa_link_6"),
    "tx40": ((0, -3.7, -0.8, 0, 0, 0), "base_link", "link_6"),
    "two_link": ((-0.6, -2.6), "base_link", "link_2"),
    "ur10e": (UR_FOLDED, "upper_arm_link", "wrist_2_link"),
    "ur5e": (UR_FOLDED, "upper_arm_link", "wrist_2_link"),
}

# Links with one link in between, at distances of millimetres in all poses.
UR_NEAR = {
    ("base_link", "upper_arm_link"),
    ("forearm_link", "wrist_2_link"),
    ("wrist_1_link", "wrist_3_link"),
}
NEAR = {
    "fr3": {("fr3_link5", "fr3_link7")},
    "panda": {("panda_link5", "panda_link7")},
    "iiwa14": {("iiwa_link_5", "iiwa_link_7")},
    "tx40": {("link_4", "link_6")},
    "two_link": set(),
    "ur10e": UR_NEAR,
    "ur5e": UR_NEAR,
}


class Shapes:
    """Shapes of a built-in model, and their pairs on joints that are not adjacent."""

    def __init__(self, name: str) -> None:
        path = str(locate(name))
        self.model = pin.buildModelFromUrdf(path)
        self.geometry = pin.buildGeomFromUrdf(self.model, path, pin.GeometryType.COLLISION)
        joints = [shape.parentJoint for shape in self.geometry.geometryObjects]
        for a, first in enumerate(joints):
            for b, second in enumerate(joints):
                if first < second and self.model.parents[second] != first:
                    self.geometry.addCollisionPair(pin.CollisionPair(a, b))
        self.data, self.found = self.model.createData(), self.geometry.createData()

    def link(self, at: int) -> str:
        return str(self.model.frames[self.geometry.geometryObjects[at].parentFrame].name)

    def distances(self, q: object) -> dict[tuple[str, str], float]:
        """Return the smallest distance of each pair of links, negative for an overlap [m]."""
        pin.computeDistances(self.model, self.data, self.geometry, self.found, np.array(q, float))
        out: dict[tuple[str, str], float] = defaultdict(lambda: np.inf)
        for pair, result in zip(
            self.geometry.collisionPairs, self.found.distanceResults, strict=True
        ):
            key = self.link(pair.first), self.link(pair.second)
            out[key] = min(out[key], result.min_distance)
        return out


@pytest.fixture(scope="module", params=BUILTIN)
def named(request: pytest.FixtureRequest) -> tuple[str, Shapes]:
    return request.param, Shapes(request.param)


@pytest.mark.parametrize("name", BUILTIN)
def test_the_base_and_all_links_with_mass_have_shapes(name):
    links = ElementTree.fromstring(text_of(name)).findall("link")
    bare = [link.get("name") for link in links if link.find("collision") is None]
    assert [
        link for link in links if link.find("inertial") is not None and link.get("name") in bare
    ] == []
    assert links[0].get("name") not in bare


@pytest.mark.parametrize("name", BUILTIN)
def test_shapes_of_a_link_have_unique_names(name):
    for link in ElementTree.fromstring(text_of(name)).findall("link"):
        names = [shape.get("name") for shape in link.findall("collision")]
        assert None not in names and len(set(names)) == len(names)


def test_shapes_are_capsules_and_spheres(named):
    kinds = {type(shape.geometry) for shape in named[1].geometry.geometryObjects}
    assert kinds <= {
        coal.Capsule,
        coal.Sphere,
    }  # a cylinder with flat faces would indicate a misspelt name


def test_home_poses_are_clear(named):
    name, shapes = named
    for q in HOME[name]:
        distances = shapes.distances(q)
        assert {
            pair: d for pair, d in distances.items() if d < CLEAR and pair not in NEAR[name]
        } == {}
        assert all(distances[pair] > 0.0 for pair in NEAR[name])


def test_folded_poses_collide(named):
    name, shapes = named
    q, first, second = FOLDED[name]
    assert np.all(shapes.model.lowerPositionLimit <= q) and np.all(
        q <= shapes.model.upperPositionLimit
    )
    assert shapes.distances(q)[first, second] < 0.0


def test_no_pair_of_links_collides_in_every_pose(named):
    _, shapes = named
    rng = np.random.default_rng(0)
    poses = rng.uniform(
        shapes.model.lowerPositionLimit, shapes.model.upperPositionLimit, (100, shapes.model.nq)
    )
    distances = [shapes.distances(q) for q in poses]
    assert min(max(of_pose[pair] for of_pose in distances) for pair in distances[0]) > 0.0


# -- against the vendor's meshes -------------------------------------------------------------------


MESHES = "cmeel.prefix/share/example-robot-data/robots/panda_description/meshes/collision"


def vertices(path: Path) -> np.ndarray:
    raw = path.read_bytes()
    (count,) = struct.unpack_from("<I", raw, 80)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(raw, record, count, 84)["corners"].reshape(-1, 3).astype(float)


def outside(shape: pin.GeometryObject, points: np.ndarray) -> np.ndarray:
    """Return the signed distances of points in the frame of the joint to the surface [m]."""
    local = (points - shape.placement.translation) @ shape.placement.rotation
    half = getattr(shape.geometry, "halfLength", 0.0)
    local[:, 2] -= np.clip(local[:, 2], -half, half)
    return np.linalg.norm(local, axis=1) - shape.geometry.radius


def test_pandas_capsules_cover_its_meshes():
    root = os.environ.get("EXCITE_ROBOT_DATA")
    if not root:
        pytest.skip("EXCITE_ROBOT_DATA does not name the folder of the example-robot-data wheel")
    folder = Path(root) / MESHES
    if not folder.is_dir():
        pytest.skip(f"{folder}: no such folder")
    shapes = Shapes("panda")
    for number in range(8):
        points = vertices(folder / f"link{number}.stl")
        covers = [
            shape
            for at, shape in enumerate(shapes.geometry.geometryObjects)
            if shapes.link(at) == f"panda_link{number}"
        ]
        assert np.min([outside(shape, points) for shape in covers], axis=0).max() < 0.005
