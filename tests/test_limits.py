from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from conftest import LIMIT, loaded, pendulum
from hypothesis import given
from hypothesis import strategies as st

from excite.errors import ExciteWarning, MissingLimit, UnusableInput
from excite.robot.limits import QUANTITIES, Limits, from_document, resolve
from excite.robot.robot import load
from excite.schemas import quantities
from excite.schemas.limits import StatedLimits

MOVEIT = """
joint_limits:
  swing:
    has_position_limits: true
    min_position: -1.0
    max_position: 1.5
    has_velocity_limits: true
    max_velocity: 1.25
    has_acceleration_limits: true
    max_acceleration: 7.0
    has_jerk_limits: false
    max_jerk: 70.0
    has_effort_limits: true
    max_effort: 33.0
"""


def of(inside: str, file: Path | None = None, kind: str = "revolute") -> Limits:
    return resolve(loaded(pendulum(inside, kind)), file)


def written(tmp_path: Path, text: str, name: str = "limits.toml") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def stated(limits: Limits) -> StatedLimits:
    return msgspec.convert(limits.document(), StatedLimits, dec_hook=quantities.converted)


def test_urdf_limits_are_taken_and_their_source_told():
    limits = of(LIMIT)
    assert (limits.position.tolist(), limits.velocity[0], limits.torque[0]) == (
        [[-2.0, 2.5]],
        3.0,
        40.0,
    )
    assert [limits.sources[q][0] for q in QUANTITIES] == ["urdf", "urdf", "", "", "urdf"]


def test_acceleration_and_jerk_bind_only_where_given():
    limits = of(LIMIT)
    assert np.isinf([limits.acceleration[0], limits.jerk[0]]).all()


@pytest.mark.parametrize(
    ("inside", "quantity"),
    [
        ('<limit lower="0" upper="0" velocity="3" effort="40"/>', "position"),
        ('<limit lower="1" upper="-1" velocity="3" effort="40"/>', "position"),
        ('<limit velocity="3" effort="40"/>', "position"),
        ('<limit lower="-1" upper="1" velocity="0" effort="40"/>', "velocity"),
        ('<limit lower="-1" upper="1" velocity="-3" effort="40"/>', "velocity"),
        ('<limit lower="-1" upper="1" effort="40"/>', "velocity"),
        ('<limit lower="-1" upper="1" velocity="3" effort="0"/>', "torque"),
        ('<limit lower="-1" upper="1" velocity="3" effort="-1"/>', "torque"),
        ('<limit lower="-1" upper="1" velocity="3"/>', "torque"),
    ],
)
def test_a_missing_limit_names_joint_quantity_and_the_place_to_set_it(inside, quantity):
    with pytest.raises(
        MissingLimit, match=rf"'swing'.* {quantity} .*; set (it|them) .* --limits FILE"
    ) as caught:
        of(inside)
    fault = caught.value.faults[0]
    assert (fault.joint, fault.quantity) == ("swing", quantity)


def test_all_missing_limits_are_reported_at_once():
    with pytest.raises(
        MissingLimit,
        match=r"3 limits are missing or unusable \('swing': position, velocity \(it states 0\), "
        r"torque\).*'excite check .* --limits-template",
    ) as caught:
        of('<limit velocity="0"/>')
    assert [fault.quantity for fault in caught.value.faults] == ["position", "velocity", "torque"]


def test_an_omitted_bound_is_zero_as_urdf_says():
    assert of('<limit upper="1" velocity="3" effort="40"/>').position.tolist() == [[0.0, 1.0]]


def test_a_continuous_joint_needs_no_position_limit():
    assert np.isinf(of('<limit velocity="3" effort="40"/>', kind="continuous").position).all()


def test_a_missing_limit_can_come_from_the_file(tmp_path):
    file = written(tmp_path, "[joints.swing]\nposition = [-1, 2]\nvelocity = 3\ntorque = 4\n")
    limits = of("", file)
    assert limits.position.tolist() == [[-1.0, 2.0]] and limits.sources["torque"] == (str(file),)


def test_toml_overrides_only_what_it_states(tmp_path):
    file = written(tmp_path, "[joints.swing]\nvelocity = 1.5\njerk = 90\n")
    limits = of(LIMIT, file)
    assert (limits.velocity[0], limits.jerk[0], limits.torque[0]) == (1.5, 90.0, 40.0)
    assert [limits.sources[q][0] for q in QUANTITIES] == ["urdf", str(file), "", str(file), "urdf"]


def test_moveit_yaml_overrides_what_it_switches_on(tmp_path):
    limits = of(LIMIT, written(tmp_path, MOVEIT, "joint_limits.yaml"))
    assert limits.position.tolist() == [[-1.0, 1.5]]
    assert (limits.velocity[0], limits.acceleration[0], limits.jerk[0], limits.torque[0]) == (
        1.25,
        7.0,
        np.inf,
        33.0,
    )


def test_moveit_yaml_of_a_bigger_robot_warns_of_joints_it_ignores(tmp_path):
    file = written(
        tmp_path,
        MOVEIT + "  finger: {has_velocity_limits: true, max_velocity: 1.0}\n",
        "joint_limits.yaml",
    )
    with pytest.warns(ExciteWarning, match="'finger' .* ignored"):
        of(LIMIT, file)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[joints.knee]\nvelocity = 1\n", "no joint 'knee' in .* there are: swing"),
        (
            "[joints.swing]\nspeed = 1\n",
            "joints.swing: has the unknown key 'speed'; it may have position, velocity",
        ),
        ("[joints.swing]\nvelocity = 0\n", "joints.swing.velocity: 0 should be from 1e-09 to"),
        ("[joints.swing]\nvelocity = -1\n", "joints.swing.velocity: -1 should be from"),
        ("[joints.swing]\nvelocity = nan\n", "joints.swing.velocity: the number is not finite"),
        (
            "[joints.swing]\nvelocity = [1, 2]\n",
            "joints.swing.velocity: a list of 2 should be a number",
        ),
        ("[joints.swing]\nvelocity = 'fast'\n", "joints.swing.velocity: 'fast' should be a number"),
        ("[joints.swing]\nposition = 2\n", "joints.swing.position: 2 should be a list"),
        (
            "[joints.swing]\nposition = [1, nan]\n",
            r"joints.swing.position\[1\]: the number is not finite",
        ),
        (
            "[joints.swing]\nposition = [2, 1]\n",
            "joints.swing.position: the lower bound 2 is not below the upper bound 1; swap",
        ),
        ("[joints.swing]\nbraking = {offset = 1}\n", "joints.swing.braking: has no 'rate'"),
        ("velocity = 1\n", "has the unknown key 'velocity'; it may have joints, margin"),
        ("", "no .joints.<name>. tables; write one per joint"),
        ("[joints]\nswing = 1\n", "joints.swing: 1 should be a table"),
        ("[joints.swing\n", "cannot be read as a limits file"),
    ],
)
def test_a_toml_that_contradicts_itself_is_refused_with_the_joint(text, part, tmp_path):
    file = written(tmp_path, text)
    with pytest.raises(UnusableInput, match=part) as caught:
        of(LIMIT, file)
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("joint_limits: 3\n", "joint_limits: 3 should be a table"),
        ("{}", "has no 'joint_limits'"),
        ("", "null should be a table"),
        ("joint_limits: {swing: 3}\n", "joint_limits.swing: 3 should be a table"),
        (
            MOVEIT.replace("    max_velocity: 1.25\n", ""),
            "joint_limits.swing: has no 'max_velocity', but has_velocity_limits is true",
        ),
        (
            MOVEIT.replace("max_velocity", "max_velocty"),
            "joint_limits.swing: has the unknown key 'max_velocty'",
        ),
        (MOVEIT.replace("1.25", "&v 1.25").replace("7.0", "*v"), "the alias .v is not read"),
        (MOVEIT + "    max_effort: 1.0\n", "the key 'max_effort' occurs twice"),
        (
            MOVEIT.replace("min_position: -1.0", "min_position: 2.0"),
            "joint_limits.swing.position: the lower bound 2 is not below",
        ),
        (
            MOVEIT.replace("max_velocity: 1.25", "max_velocity: -1.25"),
            "joint_limits.swing.max_velocity: -1.25 should be from",
        ),
    ],
)
def test_a_yaml_that_contradicts_itself_is_refused_with_the_joint(text, part, tmp_path):
    with pytest.raises(UnusableInput, match=part):
        of(LIMIT, written(tmp_path, text, "joint_limits.yaml"))


def test_a_limits_file_that_is_not_there_is_refused():
    with pytest.raises(UnusableInput, match="cannot be read as a limits file"):
        of(LIMIT, Path("/nowhere/limits.toml"))


def test_limits_of_a_locked_joint_may_be_stated(tmp_path):
    file = written(tmp_path, "[joints.joint_2]\nvelocity = 1\n")
    assert resolve(load("two_link", joints=["joint_1"]), file).joints == ("joint_1",)


def test_builtin_table_overrides_its_urdf_and_is_the_source():
    assert resolve(load("two_link")).sources["jerk"] == ("two_link.toml", "two_link.toml")


@pytest.mark.parametrize("name", ["fr3", "two_link"])
def test_limits_survive_their_document(name):
    limits = resolve(load(name))
    again = from_document(stated(limits), limits.joints)
    assert all(np.array_equal(getattr(again, q), getattr(limits, q)) for q in QUANTITIES)
    assert (again.braking, dict(again.sources)) == (limits.braking, dict(limits.sources))


def test_fr3_has_braking_limits_to_survive():
    assert all(brake is not None for brake in resolve(load("fr3")).braking)


def test_an_absent_limit_is_absent_in_the_document():
    limits = of('<limit velocity="3" effort="40"/>', kind="continuous")
    document = limits.document()
    assert (document["position"], document["jerk"], "braking" in document) == ({}, {}, False)
    assert np.isinf(from_document(stated(limits), limits.joints).position).all()


@given(st.floats(0.1, 10))
def test_scaling_leaves_positions_alone(factor):
    limits = resolve(load("two_link"))
    scaled = limits.scaled(velocity=factor)
    assert np.allclose(scaled.velocity, factor * limits.velocity) and np.array_equal(
        scaled.position, limits.position
    )


@pytest.mark.parametrize(
    "entry",
    [
        "position = [-inf, 1.0]",
        "position = [-1.0, inf]",
        "velocity = inf",
        "torque = inf",
        "velocity = true",
        "velocity = '3'",
        "velocity = -1",
        "braking = {offset = nan, rate = 1.0, stop = [-1.0, 1.0]}",
        "braking = {offset = 0.1, rate = -1.0, stop = [-1.0, 1.0]}",
        "braking = {offset = 0.1, rate = 1.0, stop = [1.0, -1.0]}",
    ],
)
def test_limits_that_make_no_sense_are_refused(tmp_path, entry):
    file = written(tmp_path, f"[joints.swing]\n{entry}\n")
    with pytest.raises(UnusableInput, match=r"swing.*" + entry.split()[0]):
        of(LIMIT, file)


def test_a_mimic_joint_keeps_its_own_limits():
    follower = (
        '<link name="finger"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="follow" type="revolute"><parent link="arm"/><child link="finger"/>'
        '<axis xyz="0 1 0"/><limit lower="-0.4" upper="0.6" velocity="0.5" effort="1"/>'
        '<mimic joint="swing" multiplier="-2" offset="0.1"/></joint></robot>'
    )
    limits = resolve(loaded(pendulum().replace("</robot>", follower)))
    assert limits.position[0] == pytest.approx([-0.25, 0.25])
    assert limits.velocity[0] == pytest.approx(0.25)
    assert limits.sources["velocity"] == ("urdf, mimic follow",)


def test_a_yaml_may_say_degrees(tmp_path):
    text = (
        "joint_limits:\n  swing:\n    has_velocity_limits: true\n    max_velocity: !degrees 180.0\n"
    )
    assert of(LIMIT, written(tmp_path, text, "joint_limits.yaml")).velocity[0] == pytest.approx(
        np.pi
    )
