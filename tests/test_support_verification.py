"""Motions on the feet: distances between bodies, `excite verify`, and the report."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pinocchio as pin
import pytest
from test_support_design import options as support_options
from test_support_design import walker_urdf

from excite.api import design_support, verify
from excite.api.design_result import CellOptions
from excite.cli.main import main
from excite.collision import clearance_builder
from excite.collision.continuous_check import approach_speeds
from excite.designer import support_cell
from excite.designer.support_cell import BASE_NAMES, Surroundings, robot_in_world
from excite.designer.support_design import SupportOptions, SupportSearch
from excite.designer.support_evaluator import SupportEvaluator
from excite.designer.support_stance import standing
from excite.errors import UnusableInput
from excite.robot import floating_base, limits

SHAPES = {
    "torso_link": '<origin xyz="0 0 0.2"/><geometry><box size="0.2 0.25 0.4"/></geometry>',
    "arm_link": '<origin xyz="0 0 -0.25"/><geometry><cylinder radius="0.04" length="0.4"/>'
    "</geometry>",
    "left_hip_pitch_link": '<origin xyz="0 0 -0.2"/><geometry><cylinder radius="0.05" '
    'length="0.3"/></geometry>',
    "right_hip_pitch_link": '<origin xyz="0 0 -0.2"/><geometry><cylinder radius="0.05" '
    'length="0.3"/></geometry>',
    "left_ankle_roll_link": '<origin xyz="0.01 0 -0.08"/><geometry><box size="0.2 0.12 0.02"/>'
    "</geometry>",
    "right_ankle_roll_link": '<origin xyz="0.01 0 -0.08"/><geometry><box size="0.2 0.12 0.02"/>'
    "</geometry>",
}
"""Collision shapes of the walker's links."""


def solid_walker_urdf() -> str:
    """Return the walker with collision shapes of torso, arm, thighs and feet."""
    text = walker_urdf()
    for link, shape in SHAPES.items():
        start = text.index(f'<link name="{link}">')
        end = text.index("</link>", start)
        text = f"{text[:end]}<collision>{shape}</collision>{text[end:]}"
    return text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("solid")


@pytest.fixture(scope="module")
def walker(folder):
    path = folder / "walker.urdf"
    path.write_text(solid_walker_urdf())
    return floating_base.load(path)


@pytest.fixture(scope="module")
def table(walker):
    return limits.resolve(walker.joint_robot)


def options(*frames: str, **changes) -> SupportOptions:
    return support_options(*frames, **{"rate": 50.0, **changes})


@pytest.fixture(scope="module")
def designed(walker, table, folder):
    result = design_support(walker, options("right_sole"), limits=table, progress=lambda text: None)
    result.save(folder)
    return result


def test_base_joints_move_the_robot_like_its_free_flyer(walker):
    world, rng = robot_in_world(walker), np.random.default_rng(0)
    assert world.joints[:6] == BASE_NAMES
    b, q = rng.normal(size=6), rng.uniform(-0.5, 0.5, walker.n)
    data = world.model.createData()
    pin.framesForwardKinematics(world.model, data, world.expand(np.concatenate([b, q])))
    pose = pin.SE3(pin.rpy.rpyToMatrix(*b[3:]), b[:3])
    free = walker.model.createData()
    pin.framesForwardKinematics(walker.model, free, np.concatenate([pin.SE3ToXYZQUAT(pose), q]))
    for frame in ("left_sole", "arm_link"):
        moved = free.oMf[walker.model.getFrameId(frame)]
        assert data.oMf[world.model.getFrameId(frame)].isApprox(moved, 1e-12)


def test_a_link_in_the_world_may_have_the_name_of_a_joint(tmp_path):
    path = tmp_path / "walker.urdf"
    path.write_text(walker_urdf().replace("left_sole_joint", "left_sole"))
    world = robot_in_world(floating_base.load(path))
    assert world.model.frames[world.frame("left_sole")].type == pin.FrameType.BODY


def test_the_gradients_of_clearances_are_exact(walker, table):
    chosen = options("right_sole")
    usable = table.reduced()
    stance = standing(walker.joint_robot, usable, chosen.frames, chosen.soles, chosen.contact)
    cell, _ = support_cell.find_cell(walker, table, stance, Surroundings())
    clearance = clearance_builder.build_constraint(cell)
    problem = SupportSearch(walker, table, chosen, stance, cell).problem(0.0, 0.0)
    evaluator = SupportEvaluator(dataclasses.replace(problem, clearance=clearance))
    x = 0.2 * np.random.default_rng(3).normal(size=evaluator.problem.size)
    values = evaluator.constraint_values(x)
    mask = np.concatenate(
        [np.full(v.size, kind == "clearance") & (v.ravel() > 0.7) for kind, v in values.items()]
    )
    rows, step = evaluator.rows(x, mask), 1e-6
    assert len(rows) > 10
    direction = np.random.default_rng(5).normal(size=len(x))
    jacobian = evaluator.row_gradients(x, rows)
    change = evaluator.row_values(x + step * direction, rows) - evaluator.row_values(
        x - step * direction, rows
    )
    np.testing.assert_allclose(change / (2.0 * step), jacobian @ direction, atol=1e-5)


def test_no_pair_approaches_faster_than_its_bound(designed):
    cell, step = designed.design.cell, 1e-3
    rng = np.random.default_rng(1)
    query = cell.distance_query()
    moving = 0
    for _ in range(20):
        q = np.concatenate([designed.design.stance.base, designed.design.stance.pose])
        q, dq = q + 0.1 * rng.normal(size=len(q)), rng.normal(size=len(q))
        bound = approach_speeds(cell, q[None], dq[None])[0]
        for pair in range(len(cell.pairs)):
            before, after = (
                query.set_configuration(q + sign * step * dq).distance(pair) for sign in (-1.0, 1.0)
            )
            speed = abs(after - before) / (2.0 * step)
            assert speed <= bound[pair] + 5e-3
            moving += speed > 0.2 * bound[pair]
    assert moving > 50


def test_bodies_keep_their_clearance_from_each_other_and_the_ground(designed):
    certificate = designed.design.certificate
    assert certificate.ok
    assert certificate.clearance.value == "certified"
    pairs = {near.names for near in certificate.pair_distances}
    assert any("floor" in pair and "left_ankle_roll_link" in pair for pair in pairs)
    assert not any("floor" in pair and "right_ankle_roll_link" in pair for pair in pairs)
    assert any("arm_link" in pair for pair in pairs)
    for near in certificate.pair_distances:
        assert near.proven >= near.pair.margin


@pytest.mark.slow
def test_an_obstacle_in_the_way_is_kept_clear_of(walker, table, folder, designed):
    """A ball in the world where the hand passes in the motion without it."""
    model, motion = designed.design.cell.robot.model, designed.samples[0]
    data, frame, points = model.createData(), model.getFrameId("arm_link"), []
    for pose in np.hstack([motion.base, motion.motion.q]):
        pin.framesForwardKinematics(model, data, designed.design.cell.robot.expand(pose))
        points.append(data.oMf[frame].act(np.array([0.0, 0.0, -0.45])))
    distance = np.linalg.norm(np.array(points) - points[0], axis=1)
    assert distance.max() > 0.08
    x, y, z = points[int(np.argmax(distance))]
    scene = folder / "scene.toml"
    scene.write_text(
        f'[[sphere]]\nname = "ball"\nradius = 0.02\nposition = [{x:.4f}, {y:.4f}, {z:.4f}]\n'
    )
    result = design_support(
        walker,
        options("right_sole"),
        limits=table,
        cell=CellOptions(scene=scene),
        progress=lambda text: None,
    )
    certificate = result.design.certificate
    assert certificate.clearance.value == "certified"
    assert any("ball" in near.names for near in certificate.pair_distances)


def test_bodies_that_touch_in_the_standing_pose_are_refused(table, tmp_path):
    path = tmp_path / "long_armed.urdf"
    long_arm = '<origin xyz="0 0 -0.5"/><geometry><cylinder radius="0.09" length="0.9"/></geometry>'
    path.write_text(solid_walker_urdf().replace(SHAPES["arm_link"], long_arm))
    robot = floating_base.load(path)
    with pytest.raises(
        UnusableInput, match="'left_hip_pitch_link' touches 'arm_link' in the standing pose"
    ):
        design_support(robot, options("left_sole", "right_sole"), limits=table)


def test_the_file_is_verified(designed, folder):
    result = verify(folder / "trajectory.json")
    assert result.ok, result.text()
    stated = {(m.limit, m.joint): m.value for m in designed.design.certificate.margins}
    again = {(m.limit, m.joint): m.value for m in result.certificate.margins}
    assert again.keys() == stated.keys()
    for key, value in again.items():
        assert value == pytest.approx(stated[key], rel=1e-6, abs=1e-9)
    assert result.document()["criteria"] == {
        "identifiable": designed.design.identifiable_counts(),
        "base_parameters": designed.design.base.count,
    }
    assert "centre of pressure" in result.text()


def changed(folder, tmp_path, change):
    document = json.loads((folder / "trajectory.json").read_text())
    change(document)
    path = tmp_path / "trajectory.json"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["limits"]["torque"]["torso"].update(value=300.0), "torque limit of 'torso'"),
        (lambda d: d["support"][0].update(half_width=0.03), "centre of pressure"),
        (lambda d: d["contact"].update(friction=0.01), "friction"),
        (lambda d: d["standing"]["joints"].update(arm=0.4), "is not the standing pose"),
        (lambda d: d.update(identifiable=[150]), "directions are identifiable"),
        (lambda d: d["motions"][0]["sine"][6].__setitem__(0, 4.0), "limits: failed"),
        (lambda d: d["support"][0].update(centre=[0.0, 0.0, 0.1]), "over the ground"),
        (lambda d: d["design"]["cell"].update(margin=0.1), "clearance is"),
    ],
)
def test_a_changed_file_fails(designed, folder, tmp_path, change, message, capsys):
    path = changed(folder, tmp_path, change)
    assert main(["verify", str(path)]) == 1
    assert message in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(motions=[]), "motions: is empty"),
        (lambda d: d.pop("standing"), "standing"),
        (lambda d: d["support"].clear(), "1 or 2 feet"),
        (lambda d: d["coordinates"].reverse(), "coordinates"),
        (lambda d: d["robot"].update(sha256="0" * 64), "sha256 differs"),
        (lambda d: d["support"][0].update(frame="arm_link"), "a support leg has 6"),
        (lambda d: d.update(duration=9.0), "duration"),
    ],
)
def test_an_unusable_file_is_one_line_with_exit_code_2(
    designed, folder, tmp_path, change, message, capsys
):
    path = changed(folder, tmp_path, change)
    assert main(["verify", str(path)]) == 2
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("excite:")]
    assert message in line


def test_the_robot_of_a_file_may_have_moved(designed, folder, tmp_path):
    def lose(document):
        document["robot"]["source"] = str(tmp_path / "gone.urdf")

    path = changed(folder, tmp_path, lose)
    assert verify(path, robot=folder / "walker.urdf").ok


def test_motions_on_the_feet_are_not_exported(designed, folder, tmp_path, capsys):
    out = tmp_path / "out.csv"
    code = main(["export", str(folder / "trajectory.json"), "--format", "csv", "-o", str(out)])
    assert code == 2
    assert "trajectory.csv" in capsys.readouterr().err
    assert not out.exists()


def test_the_report_answers_on_its_first_screen(designed, folder):
    page = (folder / "report.html").read_text()
    head, _, body = page.partition("<nav")
    assert "Limits: certified" in head and "Clearance: certified" in head
    assert f"{designed.design.identifiable_counts()[-1]} of {designed.design.base.count}" in head
    assert "<svg" in head and "from the edge" in head
    assert "Which limits are the closest?" in body
    assert "http://" not in page.replace("http://www.w3.org", "") and "<script" not in page
    assert dataclasses.replace(designed, design=designed.design).html() == page
