"""Simulated robots with several frictions at every joint."""

from __future__ import annotations

import pytest
from simulated_robots import TRAJECTORIES

import excite

pytest.importorskip("mujoco")


@pytest.mark.slow
def test_a_dense_robot_has_several_frictions_at_every_joint(tmp_path):
    trajectory = TRAJECTORIES / "two_link.json"
    result = excite.simulate("two_link", trajectory, dense=1.0, seed=3, periods=1)
    for joint in result.joints:
        frictions = {effect.name for effect in result.effects if effect.joint == joint}
        assert {"stribeck", "nonlinear_viscous", "hysteresis"} <= frictions
    assert any(effect.name == "delay" for effect in result.effects)
    result.save(tmp_path / "first.csv")
    again = excite.simulate("two_link", trajectory, like=tmp_path / "first.truth.json", periods=1)
    assert again.effects == result.effects


def test_a_half_dense_robot_has_some_of_the_frictions():
    trajectory = TRAJECTORIES / "two_link.json"
    counts = [
        len(excite.simulate("two_link", trajectory, dense=p, seed=1, periods=1).effects)
        for p in (0.0, 0.5, 1.0)
    ]
    assert counts[0] <= counts[1] <= counts[2] and counts[0] < counts[2]
