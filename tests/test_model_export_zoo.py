"""Exported models of public robots (wheel example-robot-data): round trip through three formats.

The wheel is unpacked where EXCITE_ROBOT_DATA says: `pip download --no-deps example-robot-data`.
"""

from __future__ import annotations

import os
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from identified_models import model_torque, random_states, read_model, write_model
from test_model_export import STATES, mujoco_torque, sdf_torque

import excite
from excite.robot.robot import load

mujoco = pytest.importorskip("mujoco")
pytestmark = pytest.mark.filterwarnings("ignore::excite.errors.ExciteWarning")

ZOO = {
    "ur3": ("ur_description/urdf/ur3_robot.urdf", None),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", None),
    "panda": ("panda_description/urdf/panda.urdf", [f"panda_joint{i}" for i in range(1, 8)]),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", None),
    "z1": ("z1_description/urdf/z1.urdf", None),
    "kinova": ("kinova_description/robots/kinova.urdf", None),
    "so101": ("so_arm_description/urdf/so101.urdf", None),
    "tiago": (
        "tiago_description/robots/tiago.urdf",
        ["torso_lift_joint", *(f"arm_{i}_joint" for i in range(1, 8))],
    ),
    "talos": (
        "talos_data/robots/talos_reduced.urdf",
        [f"arm_left_{i}_joint" for i in range(1, 8)],
    ),
    "baxter": (
        "baxter_description/urdf/baxter.urdf",
        [f"right_{j}" for j in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")],
    ),
    "hyq_leg": (
        "hyq_description/robots/hyq_no_sensors.urdf",
        ["rh_haa_joint", "rh_hfe_joint", "rh_kfe_joint"],
    ),
    "g1_arm": (
        "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        [
            f"left_{j}_joint"
            for j in (
                "shoulder_pitch",
                "shoulder_roll",
                "shoulder_yaw",
                "elbow",
                "wrist_roll",
                "wrist_pitch",
                "wrist_yaw",
            )
        ],
    ),
    "double_pendulum": ("double_pendulum_description/urdf/double_pendulum.urdf", None),
}
"""Robot -> its file in the wheel, and the joints that move; None: all."""
LIMITS = (3.0, 50.0)
"""Velocity and torque limit where the file states none [rad/s, N m]; scales of random states."""
FOLDER = Path(os.environ.get("EXCITE_ROBOT_DATA", "/tmp/erd"))
"""Where the wheel is unpacked; see scripts/base_counts.py."""


def zoo_path(file: str) -> Path:
    """Path of a robot of the wheel; the test is skipped without it."""
    path = next(FOLDER.glob(f"**/robots/{file}"), None)
    if path is None:
        pytest.skip(f"example-robot-data is not unpacked at {FOLDER}")
    return path


@pytest.fixture(params=ZOO)
def exported(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """`model.json` of a robot with random, physically consistent parameters."""
    file, joints = ZOO[request.param]
    return write_model(tmp_path, str(zoo_path(file)), joints=joints, assumed=LIMITS)


def bare_torque(model, motion):
    """Torque of the links alone. Shape (N, n)."""
    psi = model.psi.copy()
    psi[10 * len(model.robot.links) :] = 0.0
    bare = type(model)(model.source, model.robot, model.drive, psi, model.widths, model.hertz)
    return bare.torque(motion, motion.dq)


def test_the_files_of_a_public_robot_give_the_torque_of_its_model(exported: Path, tmp_path: Path):
    model = read_model(exported)
    motion = random_states(model, STATES, assumed=LIMITS)
    text = excite.export_model(exported, "mjcf").text
    smooth = mujoco_torque(text, model, motion, friction=False)
    np.testing.assert_allclose(smooth, model_torque(model, motion, coulomb=False), atol=1e-9)
    friction = model.psi[model.layout.block("coulomb")]
    error = np.abs(mujoco_torque(text, model, motion) - model_torque(model, motion)) / friction
    assert error[np.abs(motion.dq) > 3.0 * model.widths].max() <= 0.02
    few = motion.rows(slice(20))
    np.testing.assert_allclose(
        sdf_torque(excite.export_model(exported, "sdf").text, model, few),
        bare_torque(model, few),
        atol=1e-8,
    )
    urdf = mujoco_urdf(excite.export_model(exported, "urdf").text, model)
    viscous = model.psi[model.layout.block("viscous")]
    np.testing.assert_allclose(
        mujoco_torque(urdf, model, few, friction=False),
        bare_torque(model, few) + viscous * few.dq,
        atol=1e-6,
    )
    file = excite.export_model(exported, "mjcf").save(tmp_path / "robot.xml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = load(str(file), joints=model.robot.joints)
    for i, link in enumerate(model.robot.links):
        phi = again.model.inertias[again.links.index(link) + 1].toDynamicParameters()
        np.testing.assert_allclose(phi, model.psi[10 * i : 10 * i + 10], atol=1e-12)
    for kind in ("rotor_inertia", "viscous", "coulomb", "offset"):
        values = [getattr(entry, kind) for entry in again.entries]
        np.testing.assert_allclose(values, model.psi[model.layout.block(kind)], rtol=1e-9)


def mujoco_urdf(text: str, model) -> str:
    """The URDF for MuJoCo's own reader, without shapes, whose meshes it would look for, and without
    the inertias of links that do not move, which it refuses unless they are positive."""
    root = ElementTree.fromstring(text)
    frames = model.robot.model.frames
    moved = {f.name for f in frames if f.type == pin.FrameType.BODY and f.parentJoint > 0}
    for link in root.findall("link"):
        inertia = [] if link.get("name") in moved else link.findall("inertial")
        for element in (*link.findall("visual"), *link.findall("collision"), *inertia):
            link.remove(element)
    options = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(options, "compiler", fusestatic="true", strippath="false")
    return ElementTree.tostring(root, encoding="unicode")
