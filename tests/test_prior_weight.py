"""Weight of the prior by the evidence."""

from __future__ import annotations

import numpy as np
import pytest

from excite.identification import consistency, prior_weight
from excite.identification.consistency import Prior
from excite.identification.inertia_distance import Distance
from excite.robot import inertial_parameters, limits, robot
from excite.robot.inertial_parameters import DRIVE

URDF = """<robot name="pendulum"><link name="base"/><link name="arm"><inertial>
<origin xyz="0 0 -0.1"/><mass value="0.5"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="motor" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit velocity="15" effort="1"/></joint></robot>"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(URDF, encoding="utf-8")
    machine = robot.load(str(path))
    return inertial_parameters.standard_parameters(machine, limits.resolve(machine), DRIVE)


def start(parameters):
    nominal = consistency.consistent_nominal(parameters)
    joints = parameters.count - 10 * parameters.bodies
    scales = prior_weight.joint_parameter_scales(parameters)
    return Prior(nominal, Distance.BREGMAN, 1.0, np.ones(joints), scales)


@pytest.mark.parametrize("distance", [0.0, 1.0, 40.0])
def test_a_parameter_far_from_nominal_is_not_pulled_back(pendulum, distance):
    """The evidence has two maxima here: 40 scales from nominal, known to ±10 scales."""
    prior = start(pendulum)
    place = pendulum.block("viscous").start
    deviation = 10.0 * pendulum.scale[place, place]
    value = prior.nominal[place] + distance * pendulum.scale[place, place]
    root = np.zeros((1, pendulum.count))
    root[0, place] = 1.0 / deviation
    target = np.array([value / deviation])
    inertial, joint = prior_weight.gamma_by_evidence(pendulum, root, target, prior)
    chosen = Prior(prior.nominal, prior.distance, inertial, joint, prior.joint_scales)
    psi = consistency.maximum_a_posteriori(pendulum, root, target, chosen).psi
    weight = joint[DRIVE.index("viscous")]
    if distance > 10.0:
        assert weight < 1e-2
        assert abs(psi[place] - value) < deviation
    else:
        assert 0.3 < weight < 1.0
