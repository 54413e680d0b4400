"""Robots that users brought: what the shared inputs show, each entry for its kind."""

from __future__ import annotations

import itertools
import json
import re
import warnings
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from conftest import LIMIT, document, joint, link, loaded, pendulum, text_of, write_obj
from identified_models import read_model, write_model
from scipy.spatial import ConvexHull
from shared_inputs import INPUTS, needs_inputs

import excite
from excite.cli.main import main
from excite.collision import nominal_inertia, urdf_geometry
from excite.errors import ExciteWarning, MissingLimit, UnusableInput, UnusableRobot
from excite.robot.limits import from_sources, resolve
from excite.robot.robot import load, require_possible_bodies
from excite.trajectory import trajectory_file

REPORTS = Path() if INPUTS is None else INPUTS / "reports"


def run_cli(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def limits_of(name: str, file: str | None = None):
    return resolve(load(str(REPORTS / name)), None if file is None else REPORTS / file)


# -- limits ----------------------------------------------------------------------------------------


@needs_inputs
@pytest.mark.parametrize("name", ["degrees", "deg_pos_only"])
def test_limits_in_degrees_are_doubted(name):
    with pytest.raises(MissingLimit, match=r"'joint_1'.*-177 to 177 rad is 56.3 turns \(degrees\?"):
        limits_of(f"13-limits/{name}.urdf")


def test_two_turns_either_way_are_believed():
    inside = '<limit lower="-12.5" upper="12.5" velocity="3" effort="40"/>'
    assert resolve(loaded(pendulum(inside=inside))).position.tolist() == [[-12.5, 12.5]]


@pytest.mark.parametrize("suffix", ["toml", "yaml"])
def test_degrees_in_a_limits_file_are_doubted(tmp_path, suffix):
    file = tmp_path / f"limits.{suffix}"
    file.write_text(
        "[joints.swing]\nposition = [-170, 170]\n"
        if suffix == "toml"
        else "joint_limits:\n  swing:\n    has_position_limits: true\n"
        "    min_position: -170.0\n    max_position: 170.0\n"
    )
    with pytest.raises(UnusableInput, match=rf"limits.{suffix}.*'swing'.*54.1 turns \(degrees"):
        resolve(loaded(pendulum(inside=LIMIT)), file)


@needs_inputs
def test_soft_limits_of_a_safety_controller_are_kept():
    robot = load(str(REPORTS / "13-limits/safety.urdf"))
    limits = resolve(robot)
    assert limits.position[0].tolist() == [-1.0, 1.0]
    assert limits.sources["position"][0] == "urdf, safety_controller"
    again = from_sources(robot, limits)
    assert again.position.tolist() == limits.position.tolist()


@pytest.mark.parametrize(
    ("soft", "expected"),
    [
        ('soft_lower_limit="-9" soft_upper_limit="9"', [-1.0, 1.0]),
        ('k_position="5"', [-1.0, 1.0]),
        ('soft_upper_limit="0.5"', [0.0, 0.5]),
        ('soft_lower_limit="2" soft_upper_limit="3"', [-1.0, 1.0]),
    ],
)
def test_soft_limits_only_narrow(soft, expected):
    inside = (
        '<limit lower="-1" upper="1" velocity="3" effort="40"/>'
        f'<safety_controller k_velocity="1" {soft}/>'
    )
    assert resolve(loaded(pendulum(inside=inside))).position.tolist() == [expected]


@needs_inputs
def test_a_moveit_file_of_other_joints_is_refused():
    with pytest.raises(UnusableInput, match=r"prefix.yaml: no joint 'left_joint_1' .* joint_1"):
        limits_of("22-leftovers/two_link_find_in_plugin.urdf", "23-yaml/prefix.yaml")


def test_a_moveit_file_of_further_joints_says_so(tmp_path):
    file = tmp_path / "joint_limits.yaml"
    file.write_text(
        "joint_limits:\n  swing: {has_velocity_limits: true, max_velocity: 2.0}\n"
        "  other: {has_velocity_limits: true, max_velocity: 2.0}\n"
    )
    with pytest.warns(ExciteWarning, match="'other' is not in"):
        assert resolve(loaded(pendulum(inside=LIMIT)), file).velocity[0] == 2.0


def test_six_missing_limits_are_reported_at_once():
    """Like KUKA's KR210 in its ROS package: without effort limits."""
    parts = [link("base")]
    for number in range(1, 7):
        parent = "base" if number == 1 else f"link_{number - 1}"
        parts += [link(f"link_{number}", 1.0)]
        parts += [
            joint(
                f"joint_a{number}",
                parent,
                f"link_{number}",
                "revolute",
                (0.1, 0, 0.3),
                (0, 0, 0),
                (0, 1, 0),
                '<limit lower="-1" upper="1" velocity="2" effort="0"/>',
            )
        ]
    robot = loaded(document(*parts))
    with pytest.raises(MissingLimit, match="6 limits are missing") as caught:
        resolve(robot)
    assert [fault.joint for fault in caught.value.faults] == [f"joint_a{i}" for i in range(1, 7)]


# -- bodies ----------------------------------------------------------------------------------------


@needs_inputs
@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("com_mm", "centre of mass is 180 m from its joint"),
        ("gmm2", "inertia of 4e[+]04 kg m²"),
        ("negative", "one of them negative"),
        ("rowmajor", "one of them negative"),
        ("triangle", "largest exceeds the sum"),
    ],
)
def test_impossible_bodies_get_no_certificate(name, fault):
    robot = load(str(REPORTS / f"12-inertia/{name}.urdf"))
    with pytest.raises(UnusableRobot, match=f"link 'link_2': .*{fault}.*correct its <inertial>"):
        require_possible_bodies(robot)


@needs_inputs
@pytest.mark.parametrize(("name", "fault"), [("mass0_geom", "mass 0"), ("massneg", "'-2'")])
def test_a_body_without_positive_mass_names_its_link(name, fault):
    with pytest.raises(UnusableInput, match=f"link 'link_2'.*{fault}"):
        load(str(REPORTS / f"12-inertia/{name}.urdf"))


@needs_inputs
@pytest.mark.parametrize("name", ["extra", "point", "identity"])
def test_possible_bodies_are_accepted(name):
    robot = load(str(REPORTS / f"12-inertia/{name}.urdf"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExciteWarning)
        require_possible_bodies(robot)


def test_an_identity_matrix_is_called_a_placeholder():
    text = pendulum(inside=LIMIT)
    placeholder = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    start, end = text.index("<inertia "), text.index("/>", text.index("<inertia ")) + 2
    robot = loaded(text[:start] + placeholder + text[end:])
    with pytest.warns(ExciteWarning, match=r"'arm'.* placeholder"):
        require_possible_bodies(robot)


@needs_inputs
def test_an_impossible_body_is_refused_by_design(tmp_path, capsys):
    robot = REPORTS / "12-inertia/triangle.urdf"
    assert run_cli("design", robot, "-o", tmp_path / "out", "--no-collision") == 2
    assert "link 'link_2'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@needs_inputs
@pytest.mark.slow
def test_a_robot_without_inertias_gets_nominal_bodies(tmp_path, capsys):
    path = REPORTS / "25-noinertia/ur5e_no_inertial.urdf"
    assert run_cli("design", path, "-o", tmp_path / "none") == 2
    assert "--mass" in capsys.readouterr().err
    short = ("--starts", "1", "--harmonics", "3", "--samples", "60", "--iterations", "15")
    out = tmp_path / "out"
    assert run_cli("design", path, "--mass", "20.6", "-o", out, *short) == 0
    trajectory = trajectory_file.read_trajectory(out / "trajectory.json")
    robot = trajectory.load_robot()
    masses = [robot.model.inertias[i].mass for i in range(1, robot.model.njoints)]
    base = robot.options["inertias"]["base_link"][0]
    assert sum(masses) + base == pytest.approx(20.6)
    assert not robot.inertia_faults
    assert masses[1] == max(masses)  # the upper arm
    assert run_cli("verify", out / "trajectory.json") == 0


def test_nominal_bodies_need_mass_left():
    with pytest.raises(UnusableInput, match="two_link: --mass 5: its links state 6 kg already"):
        nominal_inertia.nominal_inertias("two_link", 5.0)


def test_nominal_bodies_need_collision_shapes(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(pendulum(inside=LIMIT))
    with pytest.raises(UnusableInput, match=r"no link without <inertial> has a <collision>"):
        nominal_inertia.nominal_inertias(str(path), 5.0)


def test_the_inertia_of_a_hull_is_that_of_its_shape(tmp_path):
    half = 0.5 * np.array([0.2, 0.4, 0.6])
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    corners = signs * half + np.array([1.0, 2.0, 3.0])
    write_obj(tmp_path / "box.obj", corners, ConvexHull(corners).simplices)
    mesh = '<collision><geometry><mesh filename="box.obj"/></geometry></collision>'
    path = tmp_path / "robot.urdf"
    path.write_text(pendulum(body=f'<link name="arm">{mesh}</link>'))
    body = nominal_inertia.nominal_inertias(str(path), 5.0)["arm"]
    xx, xy, yy, xz, yz, zz = body.tensor
    assert body.mass == pytest.approx(5.0)
    assert body.centre == pytest.approx([1.0, 2.0, 3.0])
    box = pin.Inertia.FromBox(5.0, 0.2, 0.4, 0.6)
    assert np.allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], box.inertia, rtol=1e-6)


# -- mimic joints and trees ------------------------------------------------------------------------


@needs_inputs
def test_a_follower_that_leaves_no_range_is_named():
    with pytest.raises(
        UnusableInput, match=r"'knuckle_r' \(-1 times 'knuckle_l'.*--lock knuckle_l=0"
    ):
        limits_of("15-mimic/rev.urdf")


@needs_inputs
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("self", "itself"),
        ("fixed_master", "'tip_joint', which is fixed"),
        ("forward_chain", "'knuckle_z', which the robot does not have"),
    ],
)
def test_a_mimic_without_a_moving_master_says_why(name, reason):
    with pytest.raises(UnusableInput, match=f"'knuckle_r' follows {reason}; correct its <mimic>"):
        load(str(REPORTS / f"15-mimic/{name}.urdf"))


@needs_inputs
@pytest.mark.parametrize(
    ("name", "names"),
    [
        ("closing_fixed", ("'joint_1' and 'closing'", "'base_link' and 'tip'")),
        ("closing_to_base", ("'closing'", "from 'tip' to 'base_link'")),
        ("island", ("'yx'", "from 'y' to 'x'")),
        ("self", ("'tip_joint' and 'closing'", "'link_2' and 'tip'")),
        ("two_parents", ("'a' and 'b'", "'base_link' and 'link_2'")),
        ("two_parents_rev", ("'joint_2' and 'b'", "'link_1' and 'rod'")),
    ],
)
def test_a_loop_names_joint_and_parents(name, names):
    with pytest.raises(UnusableInput) as caught:
        load(str(REPORTS / f"19-loops/{name}.urdf"))
    assert all(part in str(caught.value) for part in names)


def test_a_link_and_a_joint_may_have_one_name():
    plain = text_of("two_link")
    text = plain.replace('joint name="joint_2"', 'joint name="link_2"')
    robot = loaded(text, lock={"link_2": 0.3})
    assert robot.joints == ("joint_1",)
    frame = robot.model.frames[robot.frame("link_2")]
    assert frame.name == "link_2" and frame.parentJoint == 1
    assert loaded(text).links == ("link_1", "link_2")


# -- files -----------------------------------------------------------------------------------------


@needs_inputs
@pytest.mark.parametrize("name", ["two_link_dollar_in_gazebo", "two_link_find_in_plugin"])
def test_leftovers_of_xacro_that_are_not_read_are_ignored(name):
    assert load(str(REPORTS / f"22-leftovers/{name}.urdf")).joints == ("joint_1", "joint_2")


def test_a_macro_in_a_visual_is_ignored():
    visual = "<visual><xacro:insert_block name='mesh'/></visual></link>"
    with pytest.warns(ExciteWarning, match="undeclared XML prefix 'xacro' are ignored"):
        assert loaded(pendulum().replace("</link>", visual, 1)).joints == ("swing",)


@pytest.mark.parametrize(
    "text",
    [
        pendulum().replace("</robot>", "<sim:surface sim:mu='1'/></robot>"),
        pendulum().replace(
            "</robot>", "<gazebo><plugin sim:name='1'>a:b</plugin></gazebo></robot>"
        ),
    ],
)
def test_foreign_elements_of_an_undeclared_prefix_are_ignored(text):
    with pytest.warns(ExciteWarning, match="undeclared XML prefix 'sim'"):
        assert loaded(text).joints == ("swing",)


@pytest.mark.parametrize("quote", ['"', "'"])
def test_a_default_namespace_is_ignored(tmp_path, quote):
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<?xml version="1.0"?>\n<!-- from elsewhere -->\n'
        + pendulum().replace("<robot ", f"<robot xmlns={quote}http://drake.mit.edu{quote} ", 1)
    )
    assert load(str(path)).joints == ("swing",)
    identified = read_model(write_model(tmp_path, str(path)))  # whose URDF is read again
    assert identified.robot.joints == ("swing",)


@pytest.mark.parametrize(
    ("declaration", "foreign"),
    [
        ('xmlns:drake="http://drake.mit.edu"', '<drake:rotor_inertia drake:value="1.5" />'),
        ("", '<drake:rotor_inertia drake:value="1.5" />'),
        ("", '<gazebo><a:b xmlns:a="urn:a" a:c="&lt;&quot;1"><d xmlns="urn:d" /></a:b></gazebo>'),
        ('xmlns:a="urn:a" xmlns:b="urn:a"', "<a:one><b:two>ä</b:two></a:one>"),
        ("", '<gazebo><plugin><link name="arm" /><xi:x /></plugin></gazebo><!-- c:d -->'),
    ],
)
def test_foreign_elements_stay_as_they_are_in_the_identified_robot(tmp_path, declaration, foreign):
    path = tmp_path / "arm.urdf"
    text = pendulum().replace("<robot ", f"<robot {declaration} ", 1)
    path.write_text(text.replace("</robot>", f"{foreign}</robot>"), encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the robot's own file, not of the model
        model = write_model(tmp_path, str(path))
    identified = json.loads(model.read_text(encoding="utf-8"))["urdf"]
    for written in (identified, excite.export_model(model, "urdf").text):
        joined = re.sub(r"\n\s*", "", written)
        assert foreign in joined and "ns0" not in written
        assert declaration in written and written.count("xmlns") == (
            declaration.count("xmlns") + foreign.count("xmlns")
        )
        assert written.count("<inertial>") == 1
    assert read_model(model).robot.joints == ("swing",)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_of_several_degrees_of_freedom_is_held(kind):
    parts = (
        *(link("world"), link("base"), link("arm", 2.0, (0.3, 0.0, 0.0)), link("tool", 1.0)),
        joint("stand", "world", "base", kind, inside="", axis=(0, 0, 0)),
        joint("swing", "base", "arm", axis=(0, 1, 0)),
    )
    held = "the {0} joint '{1}' is held: its link is fixed where it begins"
    with pytest.warns(ExciteWarning) as caught:
        robot = loaded(document(*parts, joint("hold", "arm", "tool", kind, (0.5, 0.0, 0.0))))
    assert [str(entry.message).split(": ", 1)[1] for entry in caught] == [
        held.format(kind, name) for name in ("stand", "hold")
    ]
    assert robot.joints == ("swing",)
    assert robot.model.inertias[1].mass == pytest.approx(3.0)


@pytest.mark.skipif(find_spec("xacrodoc") is not None, reason="xacrodoc expands the file")
@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("arm.urdf", "arm_expanded.urdf"),
        ("arm.xacro", "arm.urdf"),
        ("arm.urdf.xacro", "arm.urdf"),
    ],
)
def test_the_remedy_for_a_xacro_writes_to_another_file(tmp_path, name, target):
    path = tmp_path / name
    path.write_text(pendulum().replace("0.3", "${length}"))
    with pytest.raises(UnusableInput, match=rf"xacro {name} > {target}, or install"):
        load(str(path))


@pytest.mark.skipif(find_spec("xacrodoc") is None, reason="needs xacrodoc")
def test_a_xacro_is_expanded(tmp_path, monkeypatch):
    (tmp_path / "xacrodoc.py").write_text("raise SystemExit('a file of the current folder ran')")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "arm.urdf.xacro"
    text = pendulum(inside=LIMIT).replace(
        "<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1
    )
    start = text.index(">", text.index("<robot")) + 1
    path.write_text(
        text[:start]
        + '<xacro:property name="half" value="0.5"/>'
        + text[start:].replace('<limit lower="-1', '<limit lower="${-2 * half}')
    )
    assert load(str(path)).joints == ("swing",)


def test_all_faults_of_a_file_are_collected():
    text = (
        pendulum()
        .replace('mass value="2.0"', 'mass value="nan"')
        .replace("<axis", '<limit effort="inf"/><axis')
    )
    with pytest.raises(UnusableRobot, match=r"1 more fault\(s\): 'excite check'") as caught:
        loaded(text)
    assert len(caught.value.faults) == 2


@needs_inputs
@pytest.mark.parametrize("name", ["box0", "sphere0", "no_geometry"])
def test_shapes_without_extent_are_left_out_with_a_remark(name):
    with pytest.warns(ExciteWarning, match="'link_2': a <collision> shape without extent"):
        shapes = urdf_geometry.read(str(REPORTS / f"30-zero-size/{name}.urdf"))
    assert {shape.link for shape in shapes} == {"base_link", "link_1"}
