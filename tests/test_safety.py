"""No certificate without a check, and no export of an unsafe motion."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from conftest import document, joint, link
from shared_inputs import INPUTS, needs_inputs

from excite.cli import main as main_module
from excite.collision import scene_file
from excite.designer import certificate, pipeline
from excite.designer.options import DesignOptions
from excite.robot.limits import resolve
from excite.robot.robot import load, locate
from excite.trajectory import trajectory_file

FAST = ("--starts", "1", "--iterations", "40", "--period", "4")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main_module.main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def octahedron(path: Path, size: float, lift: float = 0.0) -> None:
    corners = "".join(
        f"v {x} {y} {z + lift}\n" for x, y, z in size * np.vstack([np.eye(3), -np.eye(3)])
    )
    path.write_text(
        corners
        + "".join(
            f"f {f}\n"
            for f in ("1 2 3", "2 4 3", "4 5 3", "5 1 3", "2 1 6", "4 2 6", "5 4 6", "1 5 6")
        )
    )


# -- shared inputs ---------------------------------------------------------------------------------


@needs_inputs
@pytest.mark.parametrize(
    "name", ["spike", "spike_criteria_kept", "five_times_speed", "t_lim_neg", "limits_raised"]
)
def test_a_file_that_violates_its_limits_is_not_certified(capsys, name, tmp_path):
    code, out, err = run(capsys, "verify", INPUTS / f"{name}.json")
    assert code in (1, 2) and "limits: certified" not in out + err
    code, _, _ = run(
        capsys, "export", INPUTS / f"{name}.json", "--format", "csv", "-o", tmp_path / "x.csv"
    )
    assert code in (1, 2) and not list(tmp_path.iterdir())


@needs_inputs
@pytest.mark.parametrize("name", ["cell_deleted", "t_collision_words"])
def test_a_file_without_a_cell_has_no_clearance_certificate(capsys, name, tmp_path):
    code, out, _ = run(capsys, "verify", INPUTS / f"{name}.json", "--json")
    content = json.loads(out)
    assert code == 0 and content["verdict"] == {"limits": "certified", "clearance": "not checked"}
    assert content["collision"].startswith("collision not checked") and "9999 mm" not in out
    _, out, _ = run(capsys, "verify", INPUTS / f"{name}.json")
    assert out.index("not checked") < out.index("certified")
    code, out, _ = run(
        capsys, "export", INPUTS / f"{name}.json", "--format", "csv", "-o", tmp_path / "x.csv"
    )
    assert code == 0 and "clearance: not checked" in out and "limits: certified" in out
    code, _, _ = run(
        capsys, "export", INPUTS / f"{name}.json", "--format", "json", "-o", tmp_path / "x.json"
    )
    assert "9999 mm" not in (tmp_path / "x.json").read_text()


@needs_inputs
def test_a_negative_margin_is_refused(capsys):
    code, out, err = run(capsys, "verify", INPUTS / "t_margin_neg.json")
    assert code in (1, 2) and "clearance: certified" not in out + err


@needs_inputs
def test_a_cell_that_changed_after_the_design_fails(capsys, tmp_path):
    shutil.copy(INPUTS / "s_mesh.toml", tmp_path)
    shutil.copy(INPUTS / "m.stl", tmp_path / "wall.stl")
    code, _, err = run(
        capsys,
        "design",
        "two_link",
        "-o",
        tmp_path / "o",
        "--scene",
        tmp_path / "s_mesh.toml",
        *FAST,
    )
    assert code == 0, err
    (tmp_path / "wall.stl").write_bytes(
        (tmp_path / "wall.stl").read_bytes().replace(b"0.", b"1.", 1) + b"\n"
    )
    code, out, _ = run(capsys, "verify", tmp_path / "o" / "trajectory.json")
    assert code == 1 and "clearance: failed" in out and "wall.stl" in out
    code, _, err = run(
        capsys,
        "export",
        tmp_path / "o" / "trajectory.json",
        "--format",
        "csv",
        "-o",
        tmp_path / "x.csv",
    )
    assert code == 1 and "wall.stl" in err and not (tmp_path / "x.csv").exists()


# -- sources of limits -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Design with a limits file and a scene."""
    folder = tmp_path_factory.mktemp("designed")
    (folder / "mine.toml").write_text(
        "[joints.joint_1]\nvelocity = 2.0\n[margin]\nvelocity = 0.1\n"
    )
    (folder / "cell.toml").write_text(
        '[[sphere]]\nname = "ball"\nradius = 0.1\nposition = [1.5, 0, 0.5]\n'
    )
    options = ("--limits", str(folder / "mine.toml"), "--scene", str(folder / "cell.toml"))
    assert main_module.main(["design", "two_link", "-o", str(folder / "o"), *options, *FAST]) == 0
    return folder


def copied(designed: Path, to: Path) -> Path:
    """Copies of the same files in another folder, as on another machine."""
    shutil.copytree(designed, to / "copy")
    path = to / "copy" / "o" / "trajectory.json"
    path.write_text(path.read_text().replace(str(designed), str(to / "copy")))
    return to / "copy"


def test_a_changed_limits_file_fails(capsys, designed, tmp_path):
    here = copied(designed, tmp_path)
    code, out, _ = run(capsys, "verify", here / "o" / "trajectory.json")
    assert code == 0 and "clearance: certified" in out and "limits: certified" in out
    (here / "mine.toml").write_text("[joints.joint_1]\nvelocity = 1.0\n")
    code, out, _ = run(capsys, "verify", here / "o" / "trajectory.json")
    assert (
        code == 1
        and "the velocity limit of 'joint_1' is 2 in the file, but 1 by" in out
        and "mine.toml" in out
    )


def test_a_moved_limits_file_is_requested(capsys, designed, tmp_path):
    here = copied(designed, tmp_path)
    (here / "mine.toml").rename(here / "moved.toml")
    code, out, err = run(capsys, "verify", here / "o" / "trajectory.json")
    assert code == 2 and "--limits FILE" in err and not out
    code, _, _ = run(
        capsys, "verify", here / "o" / "trajectory.json", "--limits", here / "moved.toml"
    )
    assert code == 0


def test_a_changed_scene_fails(capsys, designed, tmp_path):
    here = copied(designed, tmp_path)
    cell = here / "cell.toml"
    cell.write_text(cell.read_text().replace("radius = 0.1", "radius = 0.2"))
    code, out, _ = run(capsys, "verify", here / "o" / "trajectory.json")
    assert code == 1 and "clearance: failed" in out and "'ball' has another size" in out
    cell.unlink()
    code, out, _ = run(capsys, "verify", here / "o" / "trajectory.json")
    assert code == 1 and "clearance: failed" in out and "cell.toml" in out


def test_removed_shapes_of_the_robot_fail(capsys, designed, tmp_path):
    path = copied(designed, tmp_path) / "o" / "trajectory.json"
    stated = json.loads(path.read_text())
    stated["design"]["cell"]["shapes"] = [
        s for s in stated["design"]["cell"]["shapes"] if s["name"] != "link_2"
    ]
    path.write_text(json.dumps(stated))
    code, out, _ = run(capsys, "verify", path)
    assert code == 1 and "'link_2' has another number of shapes" in out


# -- margins ---------------------------------------------------------------------------------------


def test_margins_are_kept_by_kind_and_stated(designed):
    trajectory = trajectory_file.read_trajectory(designed / "o" / "trajectory.json")
    assert trajectory.design["margin"] == {
        "velocity": 0.1,
        "acceleration": 0.02,
        "jerk": 0.02,
        "torque": 0.02,
    }
    motion = trajectory.motion
    speed = np.abs(motion.at(np.linspace(0.0, motion.duration, 20_001), 1)).max(axis=0)
    assert (speed <= 0.9 * trajectory.limits.velocity + 1e-9).all()
    assert (speed > 0.7 * trajectory.limits.velocity).any()


def test_the_verdict_states_the_terms_of_the_certificate(capsys, designed, tmp_path):
    path = copied(designed, tmp_path) / "o" / "trajectory.json"
    stated = json.loads(path.read_text())
    code, out, _ = run(capsys, "verify", path)
    assert (
        code == 0 and "for robots within 0.1 of the nominal one; kept free: velocity 10 %," in out
    )
    stated["design"]["uncertainty"] = 0.0
    stated["design"]["margin"]["velocity"] = 0.05
    stated["design"]["boxes"] = [{"frame": "tip", "lower": [-9] * 3, "upper": [9] * 3}]
    path.write_text(json.dumps(stated))
    code, out, _ = run(capsys, "verify", path)
    assert code == 0 and "for the nominal robot; kept free: velocity 5 % (limits file or" in out
    assert "default: 10 %), acceleration 2 %" in out and "tip in its box" in out
    terms = json.loads(run(capsys, "verify", path, "--json")[1])["terms"]
    assert (terms["uncertainty"], terms["boxes"]) == (0.0, ["tip"])
    assert terms["margin"] == stated["design"]["margin"]


def test_a_margin_worsens_the_criterion_and_may_be_zero(two_link):
    free = DesignOptions(period=4.0, samples=60, starts=1, iterations=60)
    values = [
        pipeline.design_trajectory(
            two_link, resolve(two_link, margin=share), free
        ).trajectory.criteria["optimum"]["geometric"]["a"]
        for share in (0.0, 0.3)
    ]
    assert values[1] > 1.05 * values[0]


@pytest.mark.parametrize("text", ["1", "-0.1", "nan"])
def test_a_margin_outside_its_range_is_refused(capsys, text, tmp_path):
    code, _, err = run(capsys, "design", "two_link", "-o", tmp_path / "o", f"--margin={text}")
    assert code == 2 and "--margin" in err and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "table", ["velocity = 1.0", "velocity = -0.1", 'velocity = "much"', "speed = 0.1"]
)
def test_an_invalid_margin_table_is_refused(capsys, table, tmp_path):
    (tmp_path / "m.toml").write_text(f"[joints.joint_1]\nvelocity = 2.0\n[margin]\n{table}\n")
    code, _, err = run(
        capsys, "design", "two_link", "-o", tmp_path / "o", "--limits", tmp_path / "m.toml"
    )
    assert code == 2 and "margin" in err and "m.toml" in err


def test_percentages_have_no_negative_zero():
    assert {certificate.format_percent(share) for share in (0.0, -0.0, 1e-12, -1e-10)} == {"0 %"}
    assert (
        certificate.format_percent(-0.004) == "-0.4 %"
        and certificate.format_percent(0.02) == "2.0 %"
        and certificate.format_percent(3.3) == "330 %"
    )


# -- the cell --------------------------------------------------------------------------------------

ARM = (
    '<link name="base"></link>',
    link("post", 1.0, (0.0, 0.0, 0.1)),
    link("arm", 1.0, (0.0, 0.0, 0.2)),
)


def arm(mesh: str, lift: float = 0.0) -> str:
    """Robot with two joints and a mesh as the shape of its base."""
    inside = '<limit lower="-2" upper="2" velocity="3" effort="40"/>'
    shape = '<collision><origin xyz="0 0 {z}"/><geometry>{solid}</geometry></collision></link>'
    base = ARM[0].replace("</link>", shape.format(z=lift, solid=f'<mesh filename="{mesh}"/>'))
    post = ARM[1].replace(
        "</link>", shape.format(z=0.1, solid='<cylinder radius="0.04" length="0.1"/>')
    )
    tip = ARM[2].replace("</link>", shape.format(z=0.3, solid='<sphere radius="0.05"/>'))
    first = joint("a", "base", "post", axis=(0, 0, 1), inside=inside)
    second = joint("b", "post", "arm", axis=(0, 1, 0), inside=inside, xyz=(0, 0, 0.3))
    return document(base, post, tip, first, second)


@pytest.mark.parametrize(("lift", "floor"), [(0.2, 0.0), (0.1, 0.0), (0.05, -0.05), (-0.3, -0.4)])
def test_the_floor_is_the_mounting_plane_or_the_exact_lowest_point_of_the_base(
    tmp_path, lift, floor
):
    octahedron(tmp_path / "base.obj", 0.1)
    (tmp_path / "arm.urdf").write_text(arm("base.obj", lift))
    robot = load(str(tmp_path / "arm.urdf"))
    cell = scene_file.build_cell(robot, resolve(robot), scene_file.Scene())
    assert cell.floor == pytest.approx(floor, abs=1e-7)  # meshes have single precision


def test_the_height_of_the_floor_is_printed_and_reported(capsys, tmp_path):
    octahedron(tmp_path / "base.obj", 0.1)
    (tmp_path / "arm.urdf").write_text(arm("base.obj", 0.05))
    code, out, err = run(capsys, "design", tmp_path / "arm.urdf", "-o", tmp_path / "o", *FAST)
    assert code == 0, err
    assert (
        "floor at z = -0.05 m" in out
        and "floor at z = -0.05 m" in (tmp_path / "o" / "report.html").read_text()
    )


@pytest.mark.parametrize("name", ["ur10e", "panda"])
def test_all_links_keep_their_clearance_above_the_mounting_plane(name):
    """Lowest corner of the bounding box of each shape along the motion, by Pinocchio."""
    trajectory = trajectory_file.read_trajectory(
        Path(__file__).resolve().parents[1] / "trajectories" / f"{name}.json"
    )
    path = locate(name)
    model = pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(model, str(path), pin.COLLISION)
    data, placed = model.createData(), geometry.createData()
    motion = trajectory.motion
    lowest = np.inf
    ground = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    for q in motion.at(np.arange(0.0, motion.duration, 0.01)):
        pin.updateGeometryPlacements(model, data, geometry, placed, q)
        for entry, placement in zip(geometry.geometryObjects, placed.oMg, strict=True):
            if entry.parentJoint > 0:
                at = coal.Transform3s(placement.rotation, placement.translation)
                lowest = min(
                    lowest,
                    coal.distance(
                        entry.geometry,
                        at,
                        ground,
                        coal.Transform3s(),
                        coal.DistanceRequest(),
                        coal.DistanceResult(),
                    ),
                )
    assert lowest >= trajectory.design["cell"]["margin"] - 1e-6


def test_a_missing_mesh_is_refused_unless_distances_are_not_checked(capsys, tmp_path):
    (tmp_path / "arm.urdf").write_text(arm("package://gone/base.obj"))
    code, _, err = run(capsys, "design", tmp_path / "arm.urdf", "-o", tmp_path / "o", *FAST)
    assert (
        code == 2
        and "package://gone/base.obj" in err
        and "--no-collision" in err
        and "'base'" in err
    )
    assert not (tmp_path / "o").exists()
    code, out, err = run(
        capsys, "design", tmp_path / "arm.urdf", "-o", tmp_path / "o", "--no-collision", *FAST
    )
    assert code == 0, err
    assert "clearance: not checked" in out and out.index("not checked") < out.index("certified")
    for command in (("verify",), ("export", "--format", "csv", "-o", str(tmp_path / "x.csv"))):
        code, out, _ = run(capsys, command[0], tmp_path / "o" / "trajectory.json", *command[1:])
        assert code == 0 and "clearance: not checked" in out


def test_a_link_at_a_constant_distance_from_the_floor_is_excepted(tmp_path):
    """No motion can change its distance."""
    octahedron(tmp_path / "base.obj", 0.02, 0.02)
    (tmp_path / "arm.urdf").write_text(
        arm("base.obj").replace(
            '<origin xyz="0 0 0.1"/><geometry><cyl', '<origin xyz="0 0 0.055"/><geometry><cyl'
        )
    )
    robot = load(str(tmp_path / "arm.urdf"))
    cell = scene_file.build_cell(robot, resolve(robot), scene_file.Scene())
    assert cell.floor == 0.0 and [
        (pair.first, pair.second) for pair in cell.excepted if "floor" in (pair.first, pair.second)
    ] == [("post", "floor")]


# -- slower is not safer ---------------------------------------------------------------------------


def test_a_slower_motion_with_excessive_torque_is_not_exported(capsys, two_link, tmp_path):
    """If inertia compensates gravity, a lower speed needs more torque."""
    table = resolve(two_link)
    delivery = pipeline.design_trajectory(
        two_link, table, DesignOptions(period=4.0, samples=60, starts=1, iterations=60)
    )
    slow = certificate.limit_margins(
        dataclasses.replace(delivery.trajectory, motion=delivery.trajectory.motion.slowed(0.05)),
        certificate.motion_constraints(delivery.trajectory, two_link, table),
    )
    still = {m.joint: abs(m.value) for m in slow if m.limit == "torque"}
    weak = table.scaled(torque=np.array([still[j] * 0.99 for j in two_link.joints]) / table.torque)
    broken = certificate.broken_when_slowed(delivery.trajectory, two_link, weak, 0.05)
    assert broken is not None and broken.limit == "torque"
    assert certificate.broken_when_slowed(delivery.trajectory, two_link, table, 0.05) is None


def test_environment_variables_are_not_needed(capsys, designed, monkeypatch):
    for name in ("HOME", "ROS_PACKAGE_PATH"):
        monkeypatch.delenv(name, raising=False)
    code, _, _ = run(capsys, "verify", designed / "o" / "trajectory.json")
    assert code == 0 and "HOME" not in os.environ
