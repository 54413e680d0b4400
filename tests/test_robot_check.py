"""`excite check`: everything that is missing or implausible in a robot, on one page."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from conftest import BUILTIN, LIMIT, document, joint, link, pendulum, text_of
from shared_inputs import INPUTS, needs_inputs

from excite.api.robot_check import check_robot
from excite.cli.main import main
from excite.robot.limits import resolve
from excite.robot.robot import load

REPORTS = Path() if INPUTS is None else INPUTS / "reports"


def written(folder: Path, text: str, name: str = "robot.urdf") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def checked(folder: Path, text: str):
    return check_robot(written(folder, text))


@pytest.mark.parametrize("name", BUILTIN)
def test_builtin_robots_are_usable(name, capsys):
    assert main(["check", name]) == 0
    page = capsys.readouterr().out
    assert "base parameters" in page and page.rstrip().endswith("usable")
    assert all(joint in page for joint in load(name).joints)


def test_the_document_has_limits_with_their_sources(capsys):
    assert main(["check", "ur10e", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["usable"] and document["faults"] == []
    assert document["base_parameters"] == 58 and document["base_link"] == "base_link"
    limits = document["joints"][0]["limits"]
    assert limits["velocity"]["source"] == "ur10e.toml"
    assert document["joints"][1]["gravity_torque"] > 50.0


def arm(*limits: str) -> str:
    """Six joints in a row with these limits."""
    parts = [link("base")]
    for number, inside in enumerate(limits, start=1):
        parent = "base" if number == 1 else f"link_{number - 1}"
        parts.append(link(f"link_{number}", 1.0, (0.1, 0.0, 0.0)))
        parts.append(
            joint(
                f"joint_a{number}",
                parent,
                f"link_{number}",
                xyz=(0.1, 0.0, 0.3),
                axis=(0.0, 1.0, 0.0),
                inside=inside,
            )
        )
    return document(*parts)


def test_six_missing_limits_are_all_listed(tmp_path, capsys):
    no_effort = '<limit lower="-1" upper="1" velocity="2" effort="0"/>'
    path = written(tmp_path, arm(*[no_effort] * 6))
    assert main(["check", str(path)]) == 1
    page = capsys.readouterr().out
    for number in range(1, 7):
        assert f"joint 'joint_a{number}' has no usable torque limit (it states 0)" in page
    assert "to correct (6)" in page and "not usable" in page


def test_the_template_holds_what_is_known_and_blanks(tmp_path):
    path = written(tmp_path, arm(LIMIT, '<limit velocity="2"/>'))
    template = tmp_path / "limits.toml"
    assert main(["check", str(path), "--limits-template", str(template)]) == 1
    text = template.read_text(encoding="utf-8")
    known = tomllib.loads(text)["joints"]
    assert known["joint_a1"] == {"position": [-2.0, 2.5], "velocity": 3.0, "torque": 40.0}
    assert known["joint_a2"] == {"velocity": 2.0}
    assert "# position = […, …]  # rad, needed" in text and "# torque = …  # N m, needed" in text
    filled = (
        text.replace("# position = […, …]", "position = [-1, 1]")
        .replace("# torque = …", "torque = 5")
        .replace("# acceleration = …", "acceleration = 9", 1)
    )
    template.write_text(filled, encoding="utf-8")
    limits = resolve(load(str(path)), template)
    assert limits.torque.tolist() == [40.0, 5.0] and limits.acceleration[0] == 9.0
    assert main(["check", str(path), "--limits", str(template)]) == 0


def test_implausible_figures_are_remarks(tmp_path):
    result = checked(
        tmp_path,
        arm(
            '<limit lower="-1" upper="1" velocity="180" effort="40"/>',
            '<limit lower="-1" upper="1" velocity="3" effort="1e6"/>',
            '<limit lower="-1" upper="1" velocity="3" effort="0.001"/>',
        ),
    )
    text = "\n".join(result.remarks)
    assert result.usable
    assert "'joint_a1': its velocity limit is 180 rad/s (degrees per second?)" in text
    assert "'joint_a2': its torque limit of 1e+06 N m is a placeholder" in text
    assert "'joint_a3': gravity needs up to" in text


@pytest.mark.parametrize(("effort", "doubted"), [("8e5", False), ("1e9", True)])
def test_the_torque_limit_of_a_heavy_machine_is_no_placeholder(tmp_path, effort, doubted):
    limit = f'<limit lower="-1" upper="1" velocity="1" effort="{effort}"/>'
    boom = link("boom", 2e4, (1.0, 0.0, 0.0))  # 2e5 N m of gravity
    lift = joint("lift", "base", "boom", axis=(0.0, 1.0, 0.0), inside=limit)
    remarks = checked(tmp_path, document(link("base"), boom, lift)).remarks
    assert (
        any("torque limit" in remark and "placeholder" in remark for remark in remarks) == doubted
    )


def test_missing_meshes_are_all_listed(tmp_path):
    mesh = '<collision><geometry><mesh filename="package://p/{}.stl"/></geometry></collision>'
    text = pendulum(inside=LIMIT).replace(
        "</link>", mesh.format("one") + mesh.format("two") + "</link>", 1
    )
    result = checked(tmp_path, text)
    assert not result.usable
    assert [fault for fault in result.faults if "is not found" in fault] == [
        f"link 'arm': its mesh package://p/{name}.stl is not found" for name in ("one", "two")
    ]


def test_shapes_of_fixed_links_alone_are_a_remark(tmp_path):
    shape = '<link name="base"><collision><geometry><sphere radius="0.1"/></geometry></collision>'
    text = pendulum(inside=LIMIT).replace('<link name="base"/>', f"{shape}</link>")
    result = checked(tmp_path, text)
    assert result.usable and any("no moving link has a" in remark for remark in result.remarks)


def test_rounded_angles_and_mimics_are_told(tmp_path, capsys):
    path = written(tmp_path, text_of("ur10e").replace("1.570796326795", "1.5708"))
    assert main(["check", str(path), "--lock", "wrist_3_joint=0.5"]) == 0
    page = capsys.readouterr().out
    assert "is rounded (as 1.57 or 1.5708 for π/2)" in page
    assert "locked 'wrist_3_joint' at 0.5" in page


@needs_inputs
def test_a_follower_without_range_is_a_fault(capsys):
    assert main(["check", str(REPORTS / "15-mimic/rev.urdf")]) == 1
    page = capsys.readouterr().out
    assert "mimic 'knuckle_r' = -1 · 'knuckle_l' + 0" in page
    assert "leaves 'knuckle_l' no range" in page


@needs_inputs
@pytest.mark.parametrize("name", ["negative", "rowmajor", "triangle", "com_mm", "gmm2"])
def test_impossible_inertias_are_faults(name):
    result = check_robot(REPORTS / f"12-inertia/{name}.urdf")
    assert any(fault.startswith("link 'link_2'") for fault in result.faults)


@needs_inputs
def test_degrees_are_doubted_in_position_and_velocity(capsys):
    assert main(["check", str(REPORTS / "13-limits/degrees.urdf")]) == 1
    page = capsys.readouterr().out
    assert "56.3 turns (degrees?)" in page and "degrees per second?" in page


@needs_inputs
def test_a_robot_without_inertias_is_usable_with_its_mass(capsys):
    path = str(REPORTS / "25-noinertia/ur5e_no_inertial.urdf")
    assert main(["check", path]) == 1
    assert "'elbow_joint' moves no mass" in capsys.readouterr().out
    assert main(["check", path, "--mass", "20.6"]) == 0


def test_faults_of_numbers_are_all_listed_with_exit_code_2(tmp_path, capsys):
    text = pendulum('<limit effort="inf" lower="0" upper="1" velocity="1"/>')
    path = written(tmp_path, text.replace('mass value="2.0"', 'mass value="nan"'))
    assert main(["check", str(path)]) == 2
    page = capsys.readouterr().out
    assert "'swing', effort" in page and "'arm', value" in page


def test_a_file_that_is_no_robot_is_one_line(tmp_path, capsys):
    assert main(["check", str(written(tmp_path, "<model/>"))]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("excite: ") and err.count("\n") == 1


@pytest.mark.parametrize(("joints", "words"), [("joint_1", "1 moving joint,"), (None, "2 moving")])
def test_the_number_of_joints_is_in_the_right_grammatical_number(capsys, joints, words):
    options = () if joints is None else ("--joints", joints)
    main(["check", "two_link", *options])
    assert words in capsys.readouterr().out
