"""Robots with a free flyer: rows of the equations of motion and their base parameters."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from floating_base_fixtures import HUMAN, biped_urdf, example_robot, generalised_forces, needs_human

from excite.errors import UnusableInput, UnusableRobot
from excite.robot import floating_base, robot
from excite.robot.dynamics import BLOCK_NUMBERS
from excite.robot.floating_base import Rows
from excite.robot.inertial_parameters import DRIVE

TREES = {
    "solo_description/robots/solo12.urdf": 94,
    "bolt_description/robots/bolt.urdf": 52,
    "anymal_b_simple_description/robots/anymal.urdf": 94,
    "simple_humanoid_description/urdf/simple_humanoid.urdf": 213,
    "talos_data/robots/talos_reduced.urdf": 234,
}
"""URDF in the wheel example-robot-data -> number of base parameters."""


@pytest.fixture
def biped(tmp_path):
    path = tmp_path / "biped.urdf"
    path.write_text(biped_urdf(drive=True), encoding="utf-8")
    return path


@pytest.mark.parametrize("path", TREES)
def test_base_rows_have_as_many_base_parameters_as_all_rows(path):
    machine = floating_base.load(example_robot(path))
    parameters = floating_base.standard_parameters(machine)
    counts = {rows: floating_base.find_base_parameters(machine, parameters, rows) for rows in Rows}
    assert counts[Rows.BASE].count == counts[Rows.BOTH].count == TREES[path]
    assert counts[Rows.JOINTS].count == TREES[path] - 10  # the inertia of the base is in no row
    for rows, base in counts.items():
        assert base.count == floating_base.base_count(machine, parameters, rows)


@needs_human
def test_the_human_has_143_base_parameters_of_16_bodies_with_mass():
    human = floating_base.load(HUMAN / "human.urdf")
    parameters = floating_base.standard_parameters(human)
    assert (human.n, parameters.bodies, parameters.count) == (36, 16, 160)
    for rows in (Rows.BASE, Rows.BOTH):
        assert floating_base.find_base_parameters(human, parameters, rows).count == 143
        assert floating_base.base_count(human, parameters, rows) == 143


def test_the_base_rows_span_the_same_parameters_as_all_rows(biped):
    machine = floating_base.load(biped)
    parameters = floating_base.standard_parameters(machine)
    alone, both = (
        floating_base.find_base_parameters(machine, parameters, rows).plain
        for rows in (Rows.BASE, Rows.BOTH)
    )
    assert np.allclose(alone @ alone.T, both @ both.T, atol=1e-9)


@pytest.mark.parametrize("rows", list(Rows))
def test_the_regressor_times_parameters_is_the_inverse_dynamics_of_pinocchio(biped, rows):
    machine = floating_base.load(biped)
    parameters = floating_base.standard_parameters(machine)
    motion = floating_base.random_motion(machine, 20, np.random.default_rng(0))
    Y = floating_base.regressor(machine, parameters, motion, rows)
    expected = generalised_forces(machine, motion)[:, rows.selection(machine.n)]
    assert np.allclose(Y @ parameters.nominal, expected, atol=1e-9 * np.abs(expected).max())


def test_joint_parameters_appear_in_their_joint_row_alone(biped):
    machine = floating_base.load(biped)
    parameters = floating_base.standard_parameters(machine, drive=DRIVE)
    motion = floating_base.random_motion(machine, 5, np.random.default_rng(0))
    Y = floating_base.regressor(machine, parameters, motion)
    assert not Y[:, :6, 10 * parameters.bodies :].any()
    dq = motion.velocity[:, 6:]
    viscous = Y[:, 6:, parameters.block("viscous")]
    assert np.allclose(viscous, dq[:, :, None] * np.eye(machine.n))
    bodies = floating_base.standard_parameters(machine)
    without = floating_base.find_base_parameters(machine, bodies).count
    with_joints = floating_base.find_base_parameters(machine, parameters).count
    assert with_joints == without + 4 * machine.n
    assert with_joints == floating_base.base_count(machine, parameters)


def test_base_parameters_do_not_change_any_row(biped):
    machine = floating_base.load(biped)
    parameters = floating_base.standard_parameters(machine)
    base = floating_base.find_base_parameters(machine, parameters, Rows.BASE)
    motion = floating_base.random_motion(machine, 10, np.random.default_rng(3))
    Y = floating_base.regressor(machine, parameters, motion)
    independent = Y[:, :, base.independent] @ base.matrix
    assert np.allclose(independent, Y, atol=1e-8 * np.abs(Y).max())


def test_zero_velocity_and_effort_limits_are_no_fault(biped):
    machine = floating_base.load(biped)
    table = floating_base.limits(machine)
    assert (table.velocity > 0.0).all() and (table.torque > 0.0).all()
    assert set(table.sources["torque"]) == {"assumed"}
    assert set(table.sources["position"]) == {"urdf"}


def test_locked_joints_and_payload_are_those_of_the_fixed_base_robot(biped):
    payload = robot.Payload("left_shank", 3.0, (0.1, 0.0, 0.2))
    machine = floating_base.load(biped, lock={"left_knee": 0.4}, payload=payload)
    assert machine.joints == ("left_hip", "right_hip", "right_knee")
    assert machine.mass == pytest.approx(17.0)
    assert machine.links == ("trunk", "left_thigh", "right_thigh", "right_shank")
    knee = machine.model.frames[machine.frame("left_shank")].placement.rotation
    assert np.allclose(pin.rpy.matrixToRpy(knee), [0.0, 0.4, 0.0])


def test_a_link_with_inertia_but_no_mass_is_refused(biped):
    biped.write_text(biped_urdf().replace('<mass value="1.0"/>', '<mass value="0"/>'))
    with pytest.raises(UnusableRobot, match=r"left_shank.*correct its <mass>"):
        floating_base.load(biped)


def test_unknown_frames_are_named_with_similar_ones(biped):
    machine = floating_base.load(biped)
    floating_base.require_frame(machine, "world", "run.csv")
    floating_base.require_frame(machine, "trunk", "run.csv")
    with pytest.raises(UnusableInput, match=r"run.csv: wrench.left_shnk: .*similar: left_shank"):
        floating_base.require_frame(machine, "left_shnk", "run.csv")


def test_blocks_of_the_regressor_have_bounded_size(biped):
    machine = floating_base.load(biped)
    parameters = floating_base.standard_parameters(machine)
    motion = floating_base.random_motion(machine, 20_000, np.random.default_rng(0))
    blocks = list(floating_base.regressor_blocks(machine, parameters, motion))
    assert max(Y.size for Y in blocks) <= BLOCK_NUMBERS
    assert sum(map(len, blocks)) == len(motion)
