"""Distances against brute force and coal, covers, clearance constraints, and the continuous check
along a motion."""

import dataclasses
import json
from pathlib import Path

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pytest
from conftest import QUICK, document, joint, link, seeds, slope, verified, write_obj
from hypothesis import given
from scipy.spatial.transform import Rotation

from excite.collision import (
    batch_kinematics,
    capsule_cover,
    clearance_builder,
    clearance_constraint,
    continuous_check,
    distance_query,
    scene_file,
    segment_distance,
    urdf_geometry,
)
from excite.collision.clearance_constraint import CoverPairKind
from excite.collision.geometry import Shape, ShapeKind
from excite.collision.scene_file import Scene
from excite.designer import certificate as certificate_module
from excite.designer import optimize, pipeline, ramps
from excite.designer.constraint_margins import MotionConstraints
from excite.designer.evaluator import Evaluator
from excite.errors import Infeasible, UnusableInput
from excite.robot.limits import resolve
from excite.robot.robot import load, locate
from excite.schemas import quantities
from excite.schemas.cell import ShapeDocument

BOX = Shape("block", ShapeKind.BOX, (0.1, 0.6, 0.3), (0.75, 0.0, 0.45))
"""Obstacle in reach of the tip of two_link, not of its first link."""


def two_links(*shapes: Shape, floor: float | bool | None = False, margin: float = 0.02):
    robot = load("two_link")
    return scene_file.build_cell(
        robot, resolve(robot), Scene(tuple(shapes), floor=floor, clearance=margin)
    )


def octahedron(path: Path, size: float = 0.2) -> str:
    """Write a closed mesh with faces of both orientations and return its path."""
    corners = [
        tuple(size * v for v in row) for row in (*np.eye(3).tolist(), *(-np.eye(3)).tolist())
    ]
    faces = [(x, y, z) for x in (1, 4) for y in (2, 5) for z in (3, 6)]
    text = [f"v {' '.join(map(str, c))}" for c in corners] + [
        f"f {' '.join(map(str, f))}" for f in faces
    ]
    path.write_text("\n".join(text) + "\n")
    return str(path)


# -- kinematics and distances ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["panda", "ur10e", "two_link"])
def test_poses_equal_pinocchio(name):
    robot = load(name)
    q = np.random.default_rng(0).uniform(-3, 3, (5, robot.n))
    R, p = batch_kinematics.KinematicTree.from_robot(robot).poses(q)
    data = robot.model.createData()
    for k, row in enumerate(q):
        pin.forwardKinematics(robot.model, data, robot.expand(row))
        for i in range(robot.model.njoints):
            np.testing.assert_allclose(R[k, i], data.oMi[i].rotation, atol=1e-12)
            np.testing.assert_allclose(p[k, i], data.oMi[i].translation, atol=1e-12)


@given(seeds)
def test_nearest_points_against_brute_force(rng):
    a, b, c, d = rng.normal(size=(4, 1, 3))
    half_size = rng.uniform(0.1, 1.0, (1, 3))
    rotation = Rotation.random(random_state=int(rng.integers(1000))).as_matrix()[None]
    s = np.linspace(0.0, 1.0, 401)[:, None]
    first, second = a + s * (b - a), c + s * (d - c)
    nearest = segment_distance.segment_to_segment(a, b, c, d)
    brute = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    assert -1e-9 <= brute - nearest.distance[0] < 0.02
    np.testing.assert_allclose(
        np.linalg.norm(nearest.first - nearest.second), nearest.distance[0], atol=1e-9
    )
    to_box = segment_distance.segment_to_box(a, b, rotation, c, half_size)
    local = (first - c) @ rotation[0]
    brute = np.linalg.norm(local - np.clip(local, -half_size, half_size), axis=1).min()
    assert to_box.distance[0] <= brute + 1e-9
    assert to_box.distance[0] <= 0.0 or brute - to_box.distance[0] < 0.02
    to_plane = segment_distance.segment_to_plane(a, b, np.array([[0.0, 0.0, 1.0]]), np.array([0.3]))
    assert to_plane.distance[0] == pytest.approx(min(a[0, 2], b[0, 2]) - 0.3)


def test_distance_of_parallel_and_degenerate_segments():
    x, y = np.eye(3)[:1], np.eye(3)[1:2]
    assert segment_distance.segment_to_segment(0 * x, x, y, x + y).distance[0] == pytest.approx(1.0)
    assert segment_distance.segment_to_segment(x, x, y, y).distance[0] == pytest.approx(
        np.sqrt(2.0)
    )


@given(seeds)
def test_capsule_encloses_its_points(rng):
    points = rng.normal(size=(40, 3)) * rng.uniform(0.05, 1.0, 3)
    capsule = capsule_cover.enclosing_capsule(points)
    axis = capsule.end - capsule.begin
    fraction = (points - capsule.begin) @ axis / max(float(axis @ axis), 1e-30)
    offset = points - capsule.begin - np.clip(fraction, 0.0, 1.0)[:, None] * axis
    assert np.linalg.norm(offset, axis=1).max() <= capsule.radius * (1 + 1e-6)


@pytest.mark.parametrize(
    "shape",
    [
        Shape("s", ShapeKind.BOX, (0.5, 0.1, 0.3), (0.1, 0.2, 0.3), (0.3, -0.2, 1.0)),
        Shape("s", ShapeKind.CYLINDER, (0.1, 0.6), (0.1, 0.2, 0.3), (0.3, -0.2, 1.0)),
        Shape("s", ShapeKind.CAPSULE, (0.1, 0.6), (0.1, 0.2, 0.3), (0.3, -0.2, 1.0)),
        Shape("s", ShapeKind.SPHERE, (0.2,), (0.1, 0.2, 0.3)),
    ],
    ids=lambda shape: shape.kind.value,
)
def test_distance_of_covers_is_a_lower_bound(shape):
    """Compared with coal's distance from a small ball at random places."""
    ball, rng = coal.Sphere(0.01), np.random.default_rng(0)
    placement = coal.Transform3s(shape.placement.rotation, shape.placement.translation)
    for centre in rng.uniform(-1, 1, (50, 3)):
        result = coal.DistanceResult()
        coal.distance(
            shape.solid(),
            placement,
            ball,
            coal.Transform3s(np.eye(3), centre),
            coal.DistanceRequest(),
            result,
        )
        zero = np.zeros((1, 3))
        distance = min(
            segment_distance.segment_to_segment(
                c.begin + zero, c.end + zero, centre + zero, centre + zero
            ).distance[0]
            - c.radius
            - 0.01
            for c in capsule_cover.cover_with_capsules(shape)
        )
        assert distance <= result.min_distance + 1e-6
        if shape.kind in (ShapeKind.SPHERE, ShapeKind.CAPSULE):
            assert distance == pytest.approx(result.min_distance, abs=1e-6)


def test_boxes_enclose_a_mesh(tmp_path):
    shape = Shape("m", ShapeKind.MESH, (1.0, 1.0, 1.0), file=octahedron(tmp_path / "m.obj"))
    boxes, rng = capsule_cover.cover_with_boxes(shape), np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3), 200)
    surface = np.einsum("mk,mki->mi", weights, shape.triangles()[rng.integers(8, size=200)])
    assert len(boxes) > 1
    assert all(
        any(((p >= low - 1e-9) & (p <= high + 1e-9)).all() for low, high in boxes) for p in surface
    )


@pytest.mark.parametrize("name", ["panda", "ur10e"])
def test_clearance_equals_coal_and_gradients_equal_differences(name):
    robot = load(name)
    limits = resolve(robot)
    surroundings = (
        Shape("wall", ShapeKind.BOX, (0.1, 3.0, 3.0), (-0.6, 0.0, 0.0), (0.0, 0.1, 0.3)),
        Shape("ball", ShapeKind.SPHERE, (0.2,), (0.5, 0.2, 0.3)),
    )
    cell = scene_file.build_cell(robot, limits, Scene(surroundings))
    constraint, query = clearance_builder.build_constraint(cell), cell.distance_query()
    assert set(constraint.kind) == {0, 1, 2}
    q = np.random.default_rng(1).uniform(*limits.position.T, (30, robot.n))
    distances = constraint.evaluate(q).distances()
    least = np.full(len(q), np.inf)
    for k, row in enumerate(q):
        query.set_configuration(row)
        for number, pair in enumerate(cell.pairs):
            of_covers = distances[k, np.array(constraint.names) == cell.names(pair)]
            if of_covers.size and -0.02 < of_covers.min() < pair.margin + 0.1:
                # at larger distances, covers that are never near are missing
                assert of_covers.min() == pytest.approx(query.distance(number), abs=1e-4)
                least[k] = min(least[k], of_covers.min())
    rows = np.flatnonzero(least < 0.1)
    assert len(rows) > 5
    pair = np.argmin(np.where(distances > -0.02, distances, np.inf), axis=1)[rows]
    gradients = constraint.evaluate(q).gradients(rows, pair)

    def values(q):
        return constraint.evaluate(q).constraint_values()[rows, pair]

    for j, unit in enumerate(np.eye(robot.n)):
        measured = slope(lambda h, u=unit: values(q + h * u), 1e-6)
        np.testing.assert_allclose(gradients[:, j], measured, atol=2e-5)


def test_gradients_of_clearance_in_the_design_problem():
    cell = two_links(BOX)
    robot, limits = cell.robot, cell.limits
    e = Evaluator(
        optimize.set_up(
            robot, limits, QUICK, clearance=clearance_builder.build_constraint(cell)
        ).problem
    )
    assert e.kinds[-1] == "clearance"
    x = 0.4 * np.random.default_rng(3).normal(size=e.problem.size)
    rows = e.rows(x, e.rows_above(x, -np.inf))
    chosen = np.flatnonzero((rows.kind == len(e.kinds) - 1) & (e.row_values(x, rows) > 0.6))
    assert len(chosen)
    picked = rows.subset(chosen)
    d = np.random.default_rng(4).normal(size=len(x))
    measured = slope(lambda h: e.row_values(x + h * d, picked), 1e-6)
    np.testing.assert_allclose(e.row_gradients(x, picked) @ d, measured, atol=1e-4)


# -- pairs of bodies -------------------------------------------------------------------------------


def test_neighbouring_links_are_no_pair():
    cell = two_links()
    assert {cell.names(pair) for pair in cell.pairs} == {"base_link – link_2"}


def test_links_beyond_a_locked_joint_are_no_neighbours():
    robot = load("ur5e", joints=["elbow_joint"], lock={"wrist_2_joint": 1.57})
    cell = scene_file.build_cell(robot, resolve(robot), Scene(floor=False))
    names = {cell.names(pair) for pair in cell.pairs}
    assert {"upper_arm_link – wrist_1_link", "upper_arm_link – wrist_2_link"} <= names
    listed = names | {f"{pair.first} – {pair.second}" for pair in cell.excepted}
    fixed = [body.name for body in cell.bodies if body.joint == 0]
    moving = [body.name for body in cell.bodies if body.joint > 0]
    assert listed == {f"{first} – {second}" for first in fixed for second in moving}


def test_only_links_that_one_joint_joins_are_neighbours(tmp_path):
    """A frame without shape may be between them, a tool or another link with a shape may not."""
    ball = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
    parts = [link(f"l{k}", 1.0).replace("</link>", ball + "</link>") for k in range(3)]
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        document(
            *(*parts, link("frame"), link("flange")),
            joint("mount", "l0", "frame", "fixed", xyz=(0, 0, 0.2)),
            joint("a", "frame", "l1", axis=(0, 1, 0)),
            joint("weld", "l1", "l2", "fixed", xyz=(-0.2, 0, 0)),
            joint("end", "l1", "flange", "fixed", xyz=(0.2, 0, 0)),
        )
    )
    robot = load(str(urdf))
    tool = Shape("tool", ShapeKind.SPHERE, (0.05,), link="flange")
    cell = scene_file.build_cell(robot, resolve(robot), Scene((tool,), floor=False))
    assert {cell.names(pair) for pair in cell.pairs} == {"l0 – l2", "l0 – tool"}
    assert [(pair.first, pair.second) for pair in cell.excepted] == [("l0", "l1")]


def test_default_floor_is_below_the_fixed_links():
    cell = two_links(floor=None)
    height = next(body.placements[0].translation[2] for body in cell.bodies if body.name == "floor")
    assert height == pytest.approx(-1.0)


def test_no_floor_is_assumed_without_vertical_gravity():
    robot = load("two_link", gravity=(9.81, 0.0, 0.0))
    cell = scene_file.build_cell(robot, resolve(robot), Scene())
    assert "floor" not in {body.name for body in cell.bodies}
    assert any("no floor" in note for note in cell.notes)


def test_pairs_disabled_by_srdf_are_excluded(tmp_path):
    srdf = tmp_path / "arm.srdf"
    disabled = '<disable_collisions link1="base_link" link2="link_2" reason="Never"/>'
    srdf.write_text(f'<robot name="x">{disabled}</robot>')
    robot = load("two_link")
    cell = scene_file.build_cell(
        robot, resolve(robot), Scene(floor=False, disabled=urdf_geometry.disabled_pairs(srdf))
    )
    assert not cell.pairs
    assert ("base_link", "link_2", "allowed to touch") in map(dataclasses.astuple, cell.excepted)
    assert clearance_builder.build_constraint(cell) is None


def test_links_close_by_construction_get_a_reduced_margin():
    robot = load("iiwa14")
    cell = scene_file.build_cell(robot, resolve(robot), Scene())
    close = next(pair for pair in cell.pairs if cell.names(pair) == "iiwa_link_5 – iiwa_link_7")
    assert 0.0 < close.margin < 0.02
    assert any("close by construction" in pair.why for pair in cell.excepted)


def test_contact_between_two_configurations_of_the_grid_is_no_exception(tmp_path):
    """A thin post of the base in reach of the second of two links, which a grid of poses misses."""
    shapes = (((0.005, 0.005, 0.3), (0.61, 0.2, 0.15)), ((0.4, 0.005, 0.05), (0.2, 0.0, 0.2)))
    post, rod = (
        f'<collision><origin xyz="{x} {y} {z}"/><geometry><box size="{a} {b} {c}"/></geometry>'
        "</collision></link>"
        for (a, b, c), (x, y, z) in shapes
    )
    urdf = tmp_path / "scara.urdf"
    urdf.write_text(
        document(
            link("l0", 1.0).replace("</link>", post),
            link("l1", 1.0),
            link("l2", 1.0).replace("</link>", rod),
            joint("a", "l0", "l1"),
            joint("b", "l1", "l2", xyz=(0.4, 0, 0)),
        )
    )
    robot = load(str(urdf))
    cell = scene_file.build_cell(robot, resolve(robot), Scene(floor=False))
    assert [cell.names(pair) for pair in cell.pairs] == ["l0 – l2"]
    assert not cell.excepted


def test_links_that_never_touch_are_excepted():
    robot = load("ur10e")
    cell = scene_file.build_cell(robot, resolve(robot), Scene())
    never = [pair for pair in cell.excepted if pair.why.startswith("never in contact")]
    assert {(pair.first, pair.second) for pair in never} == {
        ("base_link", "upper_arm_link"),
        ("forearm_link", "wrist_2_link"),
        ("wrist_1_link", "wrist_3_link"),
    }


def test_hulls_replace_loose_covers(tmp_path):
    """Two flat plates pass each other at less distance than their capsules would."""
    plate = Path(octahedron(tmp_path / "plate.obj", 0.5))
    geometry = f'<geometry><mesh filename="{plate.name}" scale="1 1 0.02"/></geometry>'
    mesh = f"<collision>{geometry}</collision>"
    parts = [link(f"l{k}", 1.0).replace("</link>", mesh * (k != 1) + "</link>") for k in range(3)]
    tilted = joint("b", "l1", "l2", xyz=(0, 0, 0.03), axis=(0, 0.05, 1))
    urdf = tmp_path / "plates.urdf"
    urdf.write_text(document(*parts, joint("a", "l0", "l1", xyz=(0, 0, 0.03)), tilted))
    robot = load(str(urdf))
    cell = scene_file.build_cell(robot, resolve(robot), Scene(floor=False, clearance=0.005))
    assert [cell.names(pair) for pair in cell.pairs] == ["l0 – l2"]
    constraint = clearance_builder.build_constraint(cell)
    assert (constraint.kind == CoverPairKind.HULLS).all()
    q = np.array([[0.3, -0.2], [1.0, 0.7]])
    query, evaluation = cell.distance_query(), constraint.evaluate(q)
    for k, row in enumerate(q):
        exact = query.set_configuration(row).distance(0)
        assert evaluation.distances()[k, 0] == pytest.approx(exact, abs=1e-6)
    gradients = evaluation.gradients(np.arange(2), np.zeros(2, int))

    def values(q):
        return constraint.evaluate(q).constraint_values()[:, 0]

    for j, unit in enumerate(np.eye(2)):
        measured = slope(lambda h, u=unit: values(q + h * u), 1e-6)
        np.testing.assert_allclose(gradients[:, j], measured, atol=1e-3)


# -- along a motion --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def unconstrained_design():
    """Design of two_link without surroundings."""
    robot = load("two_link")
    return pipeline.design_trajectory(robot, resolve(robot), QUICK)


def brute_force_distance(cell, motion, number: int, step: float) -> float:
    query = cell.distance_query()
    poses = motion.at(np.arange(0.0, motion.duration, step))
    return min(query.set_configuration(q).distance(number) for q in poses)


def test_least_distance_is_bounded_from_both_sides(unconstrained_design):
    cell = two_links(BOX, floor=-0.7)
    motion, query = unconstrained_design.trajectory.motion, cell.distance_query()
    entries = continuous_check.least_distances(cell, motion)
    assert entries == sorted(entries, key=lambda entry: entry.proven - entry.pair.margin)
    for entry in entries:
        number = cell.pairs.index(entry.pair)
        least = brute_force_distance(cell, motion, number, 1e-3)
        assert entry.proven <= least + 1e-9
        if entry.observed < entry.pair.margin:
            assert entry.observed - least < 1e-3 + 0.02 * abs(least)
        distance = query.set_configuration(entry.pose).distance(number)
        assert distance == pytest.approx(entry.observed)


def test_the_least_distance_of_the_nearest_pairs_is_bounded_closely_however_far(
    unconstrained_design,
):
    ball = Shape("ball", ShapeKind.SPHERE, (0.1,), (3.0, 0.0, 0.5))
    motion, cell = unconstrained_design.trajectory.motion, two_links(ball, floor=-3.0)
    far = [
        entry
        for entry in continuous_check.least_distances(cell, motion)
        if entry.names.endswith(("ball", "floor"))
    ]
    assert len(far) >= 3 and far[0].proven > far[0].pair.margin + 0.5
    for entry in far:
        least = brute_force_distance(cell, motion, cell.pairs.index(entry.pair), 5e-3)
        assert 0.97 * least < entry.proven <= least
        assert entry.observed == pytest.approx(least, rel=0.01)
    _, words = certificate_module.distance_verdict(cell, far)
    assert f"never less than {1e3 * far[0].proven:.1f} mm, {far[0].names} at" in words


def test_wire_between_two_samples_is_detected(unconstrained_design):
    """The wire is thinner than the path between two samples of the check."""
    motion = unconstrained_design.trajectory.motion
    moment = motion.fourier.period * 0.5 + motion.segment("fourier").start + 0.3e-3
    robot = load("two_link")
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.expand(motion.at(np.array([moment]))[0]))
    tip = data.oMf[robot.frame("tip")].translation
    wire = Shape("wire", ShapeKind.SPHERE, (1e-5,), tuple(tip))
    entry = next(
        entry
        for entry in continuous_check.least_distances(two_links(wire), motion)
        if entry.names.endswith("wire") and "link_2" in entry.names
    )
    assert entry.proven <= 0.0


def test_body_inside_a_mesh_is_refused(tmp_path, unconstrained_design):
    shell = Shape(
        "shell",
        ShapeKind.MESH,
        (1.0, 1.0, 1.0),
        (0.0, 0.0, 0.0),
        file=octahedron(tmp_path / "s.obj", 9.0),
    )
    with pytest.raises(UnusableInput, match="inside"):
        continuous_check.least_distances(two_links(shell), unconstrained_design.trajectory.motion)
    distant = two_links(dataclasses.replace(shell, position=(20.0, 0.0, 0.0)))
    assert all(
        entry.proven > 1.0
        for entry in continuous_check.least_distances(
            distant, unconstrained_design.trajectory.motion
        )
        if "shell" in entry.names
    )


def test_design_keeps_the_clearance(unconstrained_design):
    cell = two_links(BOX)
    violated = certificate_module.verify(
        unconstrained_design.trajectory, cell.robot, cell.limits, cell
    )
    assert not violated.ok and violated.worst().limit == "clearance"
    assert violated.collision.startswith("COLLISION")
    assert violated.clearance is certificate_module.CertificateVerdict.FAILED
    design = pipeline.design_trajectory(cell.robot, cell.limits, QUICK, cell=cell)
    assert design.certificate.ok
    assert "collision checked" in design.trajectory.collision
    for number, pair in enumerate(cell.pairs):
        assert brute_force_distance(cell, design.trajectory.motion, number, 1e-3) >= pair.margin
    # the constraint costs information: the criterion is a sum of variances
    criterion, unconstrained = (
        d.trajectory.criteria["optimum"]["geometric"]["a"] for d in (design, unconstrained_design)
    )
    assert criterion > unconstrained
    # the cell can be rebuilt from the file
    again = verified(design.trajectory)
    assert again.collision == design.certificate.collision
    assert [n.names for n in again.pair_distances] == [
        n.names for n in design.certificate.pair_distances
    ]


def test_transfer_avoids_an_obstacle():
    """A pillar stands between two poses that a straight line in joint space would join."""
    pillar = Shape("pillar", ShapeKind.BOX, (0.2, 1.0, 0.2), (0.75, 0.0, 0.0))
    cell = two_links(pillar)
    constraint, robot = clearance_builder.build_constraint(cell), cell.robot
    limits = dataclasses.replace(cell.limits, acceleration=np.full(2, 10.0), jerk=np.full(2, 100.0))
    standard = optimize.set_up(robot, limits, QUICK).problem.parameters
    constraints = MotionConstraints(robot, limits, standard, clearance=constraint)
    planner = ramps.RampPlanner(constraints, 100.0)
    begin, end = np.array([0.9, -0.2]), np.array([-0.9, 0.2])
    assert "pillar" in planner.clearance_violation(
        begin + np.linspace(0, 1, 50)[:, None] * (end - begin)
    )
    legs, _ = planner.plan_transfer(begin, end, begin[None])
    assert len(legs) > 1
    for profile, duration in legs:
        assert not planner.clearance_violation(profile.at(np.linspace(0.0, duration, 500)))
    np.testing.assert_allclose(legs[-1][0].at(np.array([legs[-1][1]]))[0], end, atol=1e-9)
    wide = dataclasses.replace(pillar, size=(0.5, 1.0, 0.2))
    fence = clearance_builder.build_constraint(
        two_links(wide, Shape("back", ShapeKind.BOX, (0.5, 1, 0.2), (-0.6, 0, 0)))
    )
    blocked = ramps.RampPlanner(dataclasses.replace(constraints, clearance=fence), 100.0)
    legs, reason = blocked.plan_transfer(begin, end, begin[None])
    assert not legs and "pillar" in reason


@pytest.mark.slow
def test_cell_without_a_feasible_pose_is_refused():
    lid = Shape("lid", ShapeKind.BOX, (3.0, 3.0, 0.1), (0.0, 0.0, 0.25))
    pit = Shape("pit", ShapeKind.BOX, (3.0, 3.0, 0.1), (0.0, 0.0, -0.25))
    sides = [Shape(f"side {x}", ShapeKind.BOX, (0.1, 3.0, 3.0), (x, 0.0, 0.0)) for x in (-0.7, 0.7)]
    cell = two_links(lid, pit, *sides, margin=0.16)
    with pytest.raises(Infeasible, match="no pose keeps the clearance of"):
        pipeline.design_trajectory(cell.robot, cell.limits, QUICK, cell=cell)


# -- shapes of a URDF ------------------------------------------------------------------------------


def test_shapes_of_a_urdf_equal_pinocchio():
    robot = load("panda")
    path = str(locate("panda"))
    model = pin.buildModelFromUrdf(path)
    expected = sorted(
        pin.buildGeomFromUrdf(model, path, pin.COLLISION).geometryObjects,
        key=lambda entry: int(entry.parentJoint),
    )
    bodies = scene_file.build_cell(robot, resolve(robot), Scene(floor=False)).bodies
    shapes = [(body, k) for body in bodies for k in range(len(body.shapes))]
    assert len(shapes) == len(expected)
    for (body, k), other in zip(shapes, expected, strict=True):
        assert isinstance(other.geometry, coal.Capsule | coal.Sphere)
        assert body.joint == other.parentJoint
        assert body.placements[k].isApprox(other.placement, 1e-9)


def test_meshes_are_found_by_package(tmp_path):
    (tmp_path / "arm_description" / "meshes").mkdir(parents=True)
    octahedron(tmp_path / "arm_description" / "meshes" / "l1.obj")
    geometry = '<geometry><mesh filename="package://arm_description/meshes/l1.obj"/></geometry>'
    mesh = f"<collision>{geometry}</collision>"
    parts = (
        link("l0", 1.0),
        link("l1", 1.0).replace("</link>", mesh + "</link>"),
        joint("a", "l0", "l1"),
    )
    (tmp_path / "urdf").mkdir()
    urdf = tmp_path / "urdf" / "arm.urdf"
    urdf.write_text(document(*parts))
    assert urdf_geometry.read(str(urdf))[0].kind is ShapeKind.MESH  # in a parent folder
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    moved = elsewhere / "arm.urdf"
    moved.write_text(document(*parts).replace("arm_description", "other"))
    with pytest.raises(urdf_geometry.MissingMesh, match=r"other/meshes/l1\.obj"):
        urdf_geometry.read(str(moved))
    (tmp_path / "arm_description").rename(tmp_path / "other")
    assert urdf_geometry.read(str(moved), [str(tmp_path)])


# -- rows for every pair ---------------------------------------------------------------------------


def channel(path: Path, length: float = 1.2, gap: float = 0.5, wall: float = 0.05) -> str:
    """Write a channel: two walls along the x axis that a back at the left joins."""
    vertices, triangles = [], []
    for low, high in (
        ((-0.3, gap / 2, -0.3), (length, gap / 2 + wall, 0.3)),
        ((-0.3, -gap / 2 - wall, -0.3), (length, -gap / 2, 0.3)),
        ((-0.3 - wall, -gap / 2 - wall, -0.3), (-0.3, gap / 2 + wall, 0.3)),
    ):
        box = Shape("box", ShapeKind.BOX, tuple(np.subtract(high, low)))
        corners = box.triangles().reshape(-1, 3) + 0.5 * np.add(low, high)
        triangles += [np.arange(len(corners)).reshape(-1, 3) + sum(map(len, vertices))]
        vertices += [corners]
    return write_obj(path, np.vstack(vertices), np.vstack(triangles))


def test_base_of_capsules_and_boxes_has_rows_for_both():
    base = (
        Shape("pedestal", ShapeKind.CYLINDER, (0.05, 0.2), (0.3, 0.0, 0.9)),
        Shape("pedestal", ShapeKind.BOX, (0.2, 0.2, 0.2), (0.6, 0.0, 0.3)),
    )
    cell = two_links(*base)
    constraint = clearance_builder.build_constraint(cell)
    kinds = {
        kind
        for kind, names in zip(constraint.kind, constraint.names, strict=True)
        if "pedestal" in names
    }
    assert kinds == {CoverPairKind.CAPSULES, CoverPairKind.CAPSULE_BOX}


def test_meshes_take_the_place_of_hulls_that_always_overlap(tmp_path):
    """A robot within a channel whose convex hull contains the robot in all poses."""
    robot = load("two_link")
    file = channel(tmp_path / "channel.obj", gap=1.2)
    cell = two_links(Shape("shell", ShapeKind.MESH, (1.0, 1.0, 1.0), file=file))
    pairs = clearance_builder.build_hull_constraint(cell, cell.pairs)
    rows = np.flatnonzero(pairs.kind == CoverPairKind.MESHES)
    assert len(rows)
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (30, robot.n))
    evaluation = pairs.evaluate(q)
    query = distance_query.DistanceQuery(robot, cell.bodies, cell.pairs, np.inf)
    distances = evaluation.distances()
    names = np.array(pairs.names)
    is_hull = np.isin(pairs.kind, clearance_constraint.HULL_KINDS)
    equal = 0
    for k, pose in enumerate(q):
        query.set_configuration(pose)
        for number, pair in enumerate(cell.pairs):
            rows = (names == cell.names(pair)) & is_hull
            nearest = distances[k, rows].min()
            exact = query.distance(number)
            assert nearest <= exact + 1e-6
            expected = min(exact, pairs.resolved[rows].min())
            equal += exact > 0.0 and abs(nearest - expected) < 1e-6
    assert equal > 10
    sample, pair = np.nonzero((distances > 1e-3) & (pairs.kind == CoverPairKind.MESHES))
    gradient, h = evaluation.gradients(sample, pair), 1e-6
    for moved in range(robot.n):
        step = h * np.eye(robot.n)[moved]
        ahead, behind = (pairs.evaluate(q + d).constraint_values() for d in (step, -step))
        numeric = ((ahead - behind) / (2 * h))[sample, pair]
        assert np.median(np.abs(numeric - gradient[:, moved])) < 1e-5


def test_hull_of_a_disc_with_many_vertices_is_built(tmp_path):
    """Qhull triangulates the flat ends of a cylinder as fans, of which coal takes 255 triangles."""
    angle = np.arange(400) * (2.0 * np.pi / 400)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    vertices = np.vstack([np.column_stack([ring, np.full(400, z)]) for z in (0.0, 0.1)])
    following = np.roll(np.arange(400), -1)
    triangles = np.column_stack([np.arange(400), following, np.arange(400) + 400])
    file = write_obj(tmp_path / "disc.obj", vertices, triangles)
    hull = Shape("disc", ShapeKind.MESH, (1.0, 1.0, 1.0), file=file).hull()
    ball = coal.Sphere(0.1)
    far = coal.Transform3s(np.eye(3), np.array([0.0, 2.0, 0.05]))
    result = coal.DistanceResult()
    distance = coal.distance(
        hull, coal.Transform3s.Identity(), ball, far, coal.DistanceRequest(), result
    )
    assert distance == pytest.approx(0.9, abs=1e-4)


def test_mirrored_mesh_survives_the_file(tmp_path):
    shape = Shape("m", ShapeKind.MESH, (1.0, -1.0, 1.0), file=octahedron(tmp_path / "m.obj"))
    document = msgspec.convert(
        json.loads(json.dumps(shape.document())), ShapeDocument, dec_hook=quantities.converted
    )
    assert list(document.size) == [1.0, -1.0, 1.0]
    negative = Shape("b", ShapeKind.BOX, (1.0, -1.0, 1.0)).document()
    with pytest.raises(msgspec.ValidationError, match=r"size\[1\]"):
        msgspec.convert(negative, ShapeDocument, dec_hook=quantities.converted)
