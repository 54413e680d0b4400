"""What the robot may touch: distances against brute force and coal, covers that cover, a check
between the moments looked at."""

import dataclasses
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from conftest import QUICK, document, joint, link, seeds, slope
from hypothesis import given
from scipy.spatial.transform import Rotation

from excite.collision import (
    batch_kinematics,
    capsule_cover,
    clearance_builder,
    continuous_check,
    scene_file,
    segment_distance,
    urdf_geometry,
)
from excite.collision.geometry import Kind, Shape
from excite.collision.scene_file import Scene
from excite.designer import certificate as certificate_module
from excite.designer import optimize, pipeline, ramps
from excite.designer.constraint_margins import MotionConstraints
from excite.designer.evaluator import Evaluator
from excite.errors import Infeasible, UnusableInput
from excite.robot.limits import resolve
from excite.robot.robot import load, locate

BOX = Shape("block", Kind.BOX, (0.1, 0.6, 0.3), (0.75, 0.0, 0.45))
"""In reach of the two links' tip, not of the first link."""


def two_links(*shapes: Shape, floor: float | bool | None = False, margin: float = 0.02):
    robot = load("two_link")
    return scene_file.cell(
        robot, resolve(robot), Scene(tuple(shapes), floor=floor, clearance=margin)
    )


def octahedron(path: Path, size: float = 0.2) -> str:
    """A closed mesh whose faces are turned either way."""
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
def test_poses_are_pinocchios(name):
    robot = load(name)
    q = np.random.default_rng(0).uniform(-3, 3, (5, robot.n))
    R, p = batch_kinematics.of(robot).poses(q)
    data = robot.model.createData()
    for k, row in enumerate(q):
        pin.forwardKinematics(robot.model, data, robot.expand(row))
        for i in range(robot.model.njoints):
            np.testing.assert_allclose(R[k, i], data.oMi[i].rotation, atol=1e-12)
            np.testing.assert_allclose(p[k, i], data.oMi[i].translation, atol=1e-12)


@given(seeds)
def test_nearest_points_are_nearest(rng):
    a, b, c, d = rng.normal(size=(4, 1, 3))
    half, turn = (
        rng.uniform(0.1, 1.0, (1, 3)),
        Rotation.random(random_state=int(rng.integers(1000))).as_matrix()[None],
    )
    s = np.linspace(0.0, 1.0, 401)[:, None]
    first, second = a + s * (b - a), c + s * (d - c)
    apart = segment_distance.segments(a, b, c, d)
    brute = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    assert -1e-9 <= brute - apart.distance[0] < 0.02
    np.testing.assert_allclose(
        np.linalg.norm(apart.first - apart.second), apart.distance[0], atol=1e-9
    )
    boxed = segment_distance.box(a, b, turn, c, half)
    inside = (first - c) @ turn[0]
    brute = np.linalg.norm(inside - np.clip(inside, -half, half), axis=1).min()
    assert boxed.distance[0] <= brute + 1e-9
    assert boxed.distance[0] <= 0.0 or brute - boxed.distance[0] < 0.02
    above = segment_distance.plane(a, b, np.array([[0.0, 0.0, 1.0]]), np.array([0.3]))
    assert above.distance[0] == pytest.approx(min(a[0, 2], b[0, 2]) - 0.3)


def test_parallel_and_pointlike_segments_have_a_distance():
    x, y = np.eye(3)[:1], np.eye(3)[1:2]
    assert segment_distance.segments(0 * x, x, y, x + y).distance[0] == pytest.approx(1.0)
    assert segment_distance.segments(x, x, y, y).distance[0] == pytest.approx(np.sqrt(2.0))


@given(seeds)
def test_a_capsule_encloses_its_points(rng):
    points = rng.normal(size=(40, 3)) * rng.uniform(0.05, 1.0, 3)
    one = capsule_cover.enclosing(points)
    along = one.end - one.begin
    share = np.clip((points - one.begin) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
    assert np.linalg.norm(
        points - one.begin - share[:, None] * along, axis=1
    ).max() <= one.radius * (1 + 1e-6)


@pytest.mark.parametrize(
    "shape",
    [
        Shape("s", Kind.BOX, (0.5, 0.1, 0.3), (0.1, 0.2, 0.3), (0.3, -0.2, 1.0)),
        Shape("s", Kind.CYLINDER, (0.1, 0.6), (0.1, 0.2, 0.3), (0.3, -0.2, 1.0)),
        Shape("s", Kind.CAPSULE, (0.1, 0.6), (0.1, 0.2, 0.3), (0.3, -0.2, 1.0)),
        Shape("s", Kind.SPHERE, (0.2,), (0.1, 0.2, 0.3)),
    ],
    ids=lambda shape: shape.kind.value,
)
def test_covers_are_never_further_than_the_shape(shape):
    """By coal, from a small ball anywhere around."""
    ball, rng = coal.Sphere(0.01), np.random.default_rng(0)
    at = coal.Transform3s(shape.placement.rotation, shape.placement.translation)
    for centre in rng.uniform(-1, 1, (50, 3)):
        result = coal.DistanceResult()
        coal.distance(
            shape.solid(),
            at,
            ball,
            coal.Transform3s(np.eye(3), centre),
            coal.DistanceRequest(),
            result,
        )
        zero = np.zeros((1, 3))
        own = min(
            segment_distance.segments(
                c.begin + zero, c.end + zero, centre + zero, centre + zero
            ).distance[0]
            - c.radius
            - 0.01
            for c in capsule_cover.capsules(shape)
        )
        assert own <= result.min_distance + 1e-6
        if shape.kind in (Kind.SPHERE, Kind.CAPSULE):
            assert own == pytest.approx(result.min_distance, abs=1e-6)


def test_boxes_enclose_a_mesh(tmp_path):
    shape = Shape("m", Kind.MESH, (1.0, 1.0, 1.0), file=octahedron(tmp_path / "m.obj"))
    boxes, rng = capsule_cover.boxes(shape), np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3), 200)
    surface = np.einsum("mk,mki->mi", weights, shape.triangles()[rng.integers(8, size=200)])
    assert len(boxes) > 1
    assert all(
        any(((p >= low - 1e-9) & (p <= high + 1e-9)).all() for low, high in boxes) for p in surface
    )


@pytest.mark.parametrize("name", ["panda", "ur10e"])
def test_clearance_is_coals_and_its_slopes_are_derivatives(name):
    robot = load(name)
    limits = resolve(robot)
    around = (
        Shape("wall", Kind.BOX, (0.1, 3.0, 3.0), (-0.6, 0.0, 0.0), (0.0, 0.1, 0.3)),
        Shape("ball", Kind.SPHERE, (0.2,), (0.5, 0.2, 0.3)),
    )
    cell = scene_file.cell(robot, limits, Scene(around))
    clear, probe = clearance_builder.clearance(cell), cell.probe()
    assert set(clear.kind) == {0, 1, 2}
    q = np.random.default_rng(1).uniform(*limits.position.T, (30, robot.n))
    distances, room = clear.at(q).distances(), np.full(len(q), np.inf)
    for k, row in enumerate(q):
        probe.to(row)
        for number, pair in enumerate(cell.pairs):
            mine = distances[k, np.array(clear.names) == cell.names(pair)]
            if mine.size and -0.02 < mine.min() < pair.margin + 0.1:
                # other covers of the pair may be left out, for they never come near
                assert mine.min() == pytest.approx(probe.distance(number), abs=1e-4)
                room[k] = min(room[k], mine.min())
    rows = np.flatnonzero(room < 0.1)
    assert len(rows) > 5
    pair = np.argmin(np.where(distances > -0.02, distances, np.inf), axis=1)[rows]
    slopes = clear.at(q).slopes(rows, pair)
    for j, unit in enumerate(np.eye(robot.n)):
        measured = slope(lambda h, u=unit: clear.at(q + h * u).values()[rows, pair], 1e-6)
        np.testing.assert_allclose(slopes[:, j], measured, atol=2e-5)


def test_rows_of_the_design_problem_have_exact_gradients():
    cell = two_links(BOX)
    robot, limits = cell.robot, cell.limits
    e = Evaluator(
        optimize.set_up(robot, limits, QUICK, clearance=clearance_builder.clearance(cell)).problem
    )
    assert e.kinds[-1] == "clearance"
    x = 0.4 * np.random.default_rng(3).normal(size=e.problem.size)
    rows = e.rows(e.rows_above(x, -np.inf))
    chosen = np.flatnonzero((rows.kind == len(e.kinds) - 1) & (e.row_values(x, rows) > 0.6))
    assert len(chosen)
    picked = dataclasses.replace(
        rows, **{k: getattr(rows, k)[chosen] for k in ("kind", "sample", "joint", "sign")}
    )
    d = np.random.default_rng(4).normal(size=len(x))
    measured = slope(lambda h: e.row_values(x + h * d, picked), 1e-6)
    np.testing.assert_allclose(e.row_gradients(x, picked) @ d, measured, atol=1e-4)


# -- which pairs -----------------------------------------------------------------------------------


def test_neighbours_are_not_a_pair_and_the_rest_are():
    cell = two_links()
    assert {cell.names(pair) for pair in cell.pairs} == {"base_link – link_2"}


def test_a_default_floor_is_below_the_links_that_stand():
    cell = two_links(floor=None)
    height = next(body.placements[0].translation[2] for body in cell.bodies if body.name == "floor")
    assert height == pytest.approx(-1.0)


def test_no_floor_is_guessed_where_gravity_points_elsewhere():
    robot = load("two_link", gravity=(9.81, 0.0, 0.0))
    cell = scene_file.cell(robot, resolve(robot), Scene())
    assert "floor" not in {body.name for body in cell.bodies}
    assert any("no floor" in note for note in cell.notes)


def test_what_is_disabled_may_touch(tmp_path):
    srdf = tmp_path / "arm.srdf"
    srdf.write_text(
        '<robot name="x"><disable_collisions link1="base_link" link2="link_2" reason="Never"/></robot>'  # noqa: E501
    )
    robot = load("two_link")
    cell = scene_file.cell(
        robot, resolve(robot), Scene(floor=False, disabled=urdf_geometry.disabled(srdf))
    )
    assert not cell.pairs
    assert clearance_builder.clearance(cell) is None


def test_wrist_links_that_nearly_touch_keep_less_and_are_listed():
    robot = load("iiwa14")
    cell = scene_file.cell(robot, resolve(robot), Scene())
    close = next(pair for pair in cell.pairs if cell.names(pair) == "iiwa_link_5 – iiwa_link_7")
    assert 0.0 < close.margin < 0.02
    assert any("close by construction" in one.why for one in cell.excepted)


def test_loose_covers_give_way_to_hulls(tmp_path):
    """Two flat plates as meshes pass each other closer than any capsule around them would."""
    plate = Path(octahedron(tmp_path / "plate.obj", 0.5))
    mesh = f'<collision><geometry><mesh filename="{plate.name}" scale="1 1 0.02"/></geometry></collision>'  # noqa: E501
    parts = [link(f"l{k}", 1.0).replace("</link>", mesh * (k != 1) + "</link>") for k in range(3)]
    tilted = joint("b", "l1", "l2", xyz=(0, 0, 0.03), axis=(0, 0.05, 1))
    urdf = tmp_path / "plates.urdf"
    urdf.write_text(document(*parts, joint("a", "l0", "l1", xyz=(0, 0, 0.03)), tilted))
    robot = load(str(urdf))
    cell = scene_file.cell(robot, resolve(robot), Scene(floor=False, clearance=0.005))
    assert [cell.names(pair) for pair in cell.pairs] == ["l0 – l2"]
    clear = clearance_builder.clearance(cell)
    assert (clear.kind == 3).all()
    q = np.array([[0.3, -0.2], [1.0, 0.7]])
    probe, slopes = cell.probe(), clear.at(q).slopes(np.arange(2), np.zeros(2, int))
    for k, row in enumerate(q):
        assert clear.at(q).distances()[k, 0] == pytest.approx(probe.to(row).distance(0), abs=1e-6)
    for j, unit in enumerate(np.eye(2)):
        measured = slope(lambda h, u=unit: clear.at(q + h * u).values()[:, 0], 1e-6)
        np.testing.assert_allclose(slopes[:, j], measured, atol=1e-3)


# -- along a motion --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def free():
    robot = load("two_link")
    return pipeline.design_trajectory(robot, resolve(robot), QUICK)


def brute(cell, motion, number: int, step: float) -> float:
    probe = cell.probe()
    return min(
        probe.to(q).distance(number) for q in motion.at(np.arange(0.0, motion.duration, step))
    )


def test_the_least_distance_is_bounded_from_both_sides(free):
    cell = two_links(BOX, floor=-0.7)
    motion = free.trajectory.motion
    found = continuous_check.along(cell, motion)
    assert found == sorted(found, key=lambda near: near.proven - near.pair.margin)
    for near in found:
        least = brute(cell, motion, cell.pairs.index(near.pair), 1e-3)
        assert near.proven <= least + 1e-9
        if near.found < near.pair.margin:
            assert near.found - least < 1e-3 + 0.02 * abs(least)
        assert cell.probe().to(near.pose).distance(cell.pairs.index(near.pair)) == pytest.approx(
            near.found
        )


def test_a_wire_between_two_samples_is_seen(free):
    """Thinner than the way from one sample of the check to the next."""
    motion = free.trajectory.motion
    moment = motion.fourier.period * 0.5 + motion.segment("fourier").start + 0.3e-3
    robot = load("two_link")
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.expand(motion.at(np.array([moment]))[0]))
    tip = data.oMf[robot.frame("tip")].translation
    wire = Shape("wire", Kind.SPHERE, (1e-5,), tuple(tip))
    near = next(
        n
        for n in continuous_check.along(two_links(wire), motion)
        if n.names.endswith("wire") and "link_2" in n.names
    )
    assert near.proven <= 0.0


def test_inside_a_mesh_is_no_distance(tmp_path, free):
    shell = Shape(
        "shell",
        Kind.MESH,
        (1.0, 1.0, 1.0),
        (0.0, 0.0, 0.0),
        file=octahedron(tmp_path / "s.obj", 9.0),
    )
    with pytest.raises(UnusableInput, match="inside"):
        continuous_check.along(two_links(shell), free.trajectory.motion)
    beside = dataclasses.replace(shell, position=(20.0, 0.0, 0.0))
    assert all(
        near.proven > 1.0
        for near in continuous_check.along(two_links(beside), free.trajectory.motion)
        if "shell" in near.names
    )


def test_the_constraint_has_an_effect(free):
    cell = two_links(BOX)
    before = certificate_module.verify(free.trajectory, cell.robot, cell.limits, cell)
    assert not before.ok and before.worst().limit == "clearance"
    assert (
        before.collision.startswith("COLLISION")
        and before.clearance is certificate_module.CertificateVerdict.FAILED
    )
    kept = pipeline.design_trajectory(cell.robot, cell.limits, QUICK, cell=cell)
    assert kept.certificate.ok
    assert "collision checked" in kept.trajectory.collision
    for number, pair in enumerate(cell.pairs):
        assert brute(cell, kept.trajectory.motion, number, 1e-3) >= pair.margin
    # what it costs: the criterion is a sum of variances
    assert (
        kept.trajectory.criteria["optimum"]["geometric"]["a"]
        > free.trajectory.criteria["optimum"]["geometric"]["a"]
    )
    # and the cell is made again from the file
    again = certificate_module.verify_file(kept.trajectory, cell.robot)
    assert again.collision == kept.certificate.collision
    assert [n.names for n in again.pair_distances] == [
        n.names for n in kept.certificate.pair_distances
    ]


def test_the_way_back_goes_round():
    """A pillar stands between two poses that a straight line in joint space would join."""
    pillar = Shape("pillar", Kind.BOX, (0.2, 1.0, 0.2), (0.75, 0.0, 0.0))
    cell = two_links(pillar)
    clear, robot = clearance_builder.clearance(cell), cell.robot
    limits = dataclasses.replace(cell.limits, acceleration=np.full(2, 10.0), jerk=np.full(2, 100.0))
    standard = optimize.set_up(robot, limits, QUICK).problem.parameters
    planner = ramps.RampPlanner(MotionConstraints(robot, limits, standard, clearance=clear), 100.0)
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
    fence = clearance_builder.clearance(
        two_links(wide, Shape("back", Kind.BOX, (0.5, 1, 0.2), (-0.6, 0, 0)))
    )
    shut = ramps.RampPlanner(MotionConstraints(robot, limits, standard, clearance=fence), 100.0)
    legs, reason = shut.plan_transfer(begin, end, begin[None])
    assert not legs and "pillar" in reason


def test_no_pose_is_refused_with_what_is_in_the_way():
    lid = Shape("lid", Kind.BOX, (3.0, 3.0, 0.1), (0.0, 0.0, 0.25))
    pit = Shape("pit", Kind.BOX, (3.0, 3.0, 0.1), (0.0, 0.0, -0.25))
    sides = [Shape(f"side {x}", Kind.BOX, (0.1, 3.0, 3.0), (x, 0.0, 0.0)) for x in (-0.7, 0.7)]
    cell = two_links(lid, pit, *sides, margin=0.16)
    with pytest.raises(Infeasible, match="no pose keeps the clearance of"):
        pipeline.design_trajectory(cell.robot, cell.limits, QUICK, cell=cell)


# -- shapes of a URDF ------------------------------------------------------------------------------


def test_shapes_of_a_urdf_are_pinocchios():
    robot = load("panda")
    path = str(locate("panda"))
    model = pin.buildModelFromUrdf(path)
    theirs = sorted(
        pin.buildGeomFromUrdf(model, path, pin.COLLISION).geometryObjects,
        key=lambda one: int(one.parentJoint),
    )
    bodies = scene_file.cell(robot, resolve(robot), Scene(floor=False)).bodies
    mine = [(body, k) for body in bodies for k in range(len(body.shapes))]
    assert len(mine) == len(theirs)
    for (body, k), other in zip(mine, theirs, strict=True):
        assert isinstance(other.geometry, coal.Capsule | coal.Sphere)
        assert body.joint == other.parentJoint
        assert body.placements[k].isApprox(other.placement, 1e-9)


def test_meshes_are_found_by_package(tmp_path):
    (tmp_path / "arm_description" / "meshes").mkdir(parents=True)
    octahedron(tmp_path / "arm_description" / "meshes" / "l1.obj")
    mesh = '<collision><geometry><mesh filename="package://arm_description/meshes/l1.obj"/></geometry></collision>'
    parts = (
        link("l0", 1.0),
        link("l1", 1.0).replace("</link>", mesh + "</link>"),
        joint("a", "l0", "l1"),
    )
    (tmp_path / "urdf").mkdir()
    urdf = tmp_path / "urdf" / "arm.urdf"
    urdf.write_text(document(*parts))
    assert urdf_geometry.read(str(urdf))[0].kind is Kind.MESH  # beside the URDF's folder
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    moved = elsewhere / "arm.urdf"
    moved.write_text(document(*parts).replace("arm_description", "other"))
    with pytest.raises(urdf_geometry.MissingMesh, match=r"other/meshes/l1\.obj"):
        urdf_geometry.read(str(moved))
    (tmp_path / "arm_description").rename(tmp_path / "other")
    assert urdf_geometry.read(str(moved), [str(tmp_path)])
