"""MJCF robots: the same inverse dynamics, limits and shapes as in MuJoCo."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import warnings
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from conftest import states
from pytest import MonkeyPatch

from excite import recordings
from excite.api.robot_check import check_robot
from excite.cli.main import main
from excite.collision import urdf_geometry
from excite.errors import ExciteWarning, MissingLimit, UnusableInput
from excite.robot import dynamics, inertial_parameters, mjcf
from excite.robot.limits import Limits, resolve
from excite.robot.robot import Robot, load, locate

mujoco = pytest.importorskip("mujoco")

ARM = """
<mujoco model="arm">
  <compiler angle="degree" autolimits="true"/>
  <default>
    <joint damping="0.3" armature="0.02" frictionloss="0.1"/>
    <geom density="800"/>
    <default class="wrist">
      <joint damping="0.05" armature="0.004" range="-120 120"/>
      <motor ctrlrange="-2 2" gear="15"/>
    </default>
    <default class="visual"><geom contype="0" conaffinity="0" mass="0"/></default>
  </default>
  <worldbody>
    <geom name="ground" type="plane" size="2 2 .1"/>
    <body name="base" pos="0 0 0.2" euler="0 0 30">
      <geom type="cylinder" size="0.08 0.1"/>
      <body name="shoulder" pos="0 0 0.15">
        <joint name="pan" axis="0 0 1" range="-170 170"/>
        <geom type="sphere" size="0.07"/>
        <body name="upper" pos="0 0.05 0.1" quat="0.9 0.1 -0.3 0.2">
          <joint name="lift" axis="0 1 0.2" range="-90 100" pos="0.02 0 -0.01" ref="20"
                 actuatorfrcrange="-90 80"/>
          <inertial pos="0.2 0.01 0.02" mass="3.2" fullinertia="0.02 0.06 0.07 0.001 -0.002 0.003"/>
          <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05"/>
          <geom class="visual" type="box" size="1 1 1"/>
          <body name="fore" pos="0.4 0 0">
            <joint name="slide" type="slide" axis="1 0 0.1" range="0 0.3" ref="0.05"/>
            <joint name="roll" class="wrist" axis="1 0 0" pos="0 0.01 0"/>
            <joint name="bend" class="wrist" axis="0 1 0" pos="0.03 0 0"/>
            <geom type="box" size="0.15 0.03 0.04" pos="0.15 0 0"/>
            <site name="flange" pos="0.3 0 0" euler="0 90 0"/>
            <body name="hand" pos="0.3 0 0">
              <joint name="spin" axis="1 0 0"/>
              <geom type="ellipsoid" size="0.05 0.03 0.02"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="pan" joint="pan" forcerange="-60 60" gear="2"/>
    <position name="lift" joint="lift" kp="100" forcerange="-100 100"/>
    <motor name="roll" joint="roll" class="wrist"/>
    <motor name="bend" joint="bend" class="wrist" forcerange="-1.5 1.5"/>
  </actuator>
</mujoco>
"""

GRIPPER = """
<mujoco model="gripper">
  <worldbody>
    <body name="palm">
      <geom size="0.05"/>
      <body name="left" pos="0 0.02 0">
        <joint name="left" type="slide" axis="0 1 0" range="0 0.04" damping="1"/>
        <geom type="box" size="0.01 0.01 0.03" mass="0.2"/>
      </body>
      <body name="right" pos="0 -0.02 0">
        <joint name="right" type="slide" axis="0 -1 0" range="0 0.04" ref="0.01" damping="2"
               armature="0.1"/>
        <geom type="box" size="0.01 0.01 0.03" mass="0.3" pos="0 0 0.1"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0.002 1.5 0 0 0"/></equality>
</mujoco>
"""


def written(folder: Path, text: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def loaded(path: Path, **options: object) -> Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExciteWarning)
        return load(str(path), **options)  # type: ignore[arg-type]


def unlimited(robot: Robot) -> Limits:
    """Limits that depend on nothing, for the metric."""
    infinite = np.full(robot.n, np.inf)
    return Limits(
        robot.joints,
        np.column_stack([-infinite, infinite]),
        np.ones(robot.n),
        infinite,
        infinite,
        np.ones(robot.n),
        (None,) * robot.n,
        {},
    )


def torque_by_mujoco(robot: Robot, path: Path, q: np.ndarray, v: np.ndarray, a: np.ndarray):
    """Inverse dynamics of the file itself, without contact, springs, couplings and friction."""
    model = mujoco.MjModel.from_xml_path(str(path))
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= int(
        flags.mjDSBL_CONTACT
        | flags.mjDSBL_LIMIT
        | flags.mjDSBL_EQUALITY
        | flags.mjDSBL_FRICTIONLOSS
        | flags.mjDSBL_SPRING
    )
    model.opt.disableflags &= ~int(flags.mjDSBL_GRAVITY)
    model.body_gravcomp[:] = 0.0
    model.opt.gravity[:] = (0.0, 0.0, -9.81)
    model.opt.density = model.opt.viscosity = 0.0
    model.dof_dampingpoly[:] = 0.0
    data = mujoco.MjData(model)
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, n) for n in robot.model.names[1:]]
    data.qpos[model.jnt_qposadr[ids]] = robot.expand(q)
    data.qvel[model.jnt_dofadr[ids]] = robot.spread @ v
    data.qacc[model.jnt_dofadr[ids]] = robot.spread @ a
    mujoco.mj_inverse(model, data)
    return robot.spread.T @ data.qfrc_inverse[model.jnt_dofadr[ids]]


def largest_difference(robot: Robot, path: Path) -> float:
    """Largest difference of the torques along random states, relative to the largest torque."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExciteWarning)
        standard = inertial_parameters.standard_parameters(robot, unlimited(robot))
    standard.nominal[standard.block("coulomb")] = 0.0
    samples = states(robot.n, 20, speed=1.5)
    torque = dynamics.torque(robot, standard, samples)
    expected = np.array(
        [
            torque_by_mujoco(robot, path, *state)
            for state in zip(samples.q, samples.dq, samples.ddq, strict=True)
        ]
    )
    return float(np.abs(torque - expected).max() / np.abs(expected).max())


def test_inverse_dynamics_are_those_of_mujoco(tmp_path):
    path = written(tmp_path, ARM)
    robot = loaded(path)
    assert robot.joints == ("pan", "lift", "slide", "roll", "bend", "spin")
    assert largest_difference(robot, path) < 1e-12


def test_coupled_joints_are_those_of_mujoco(tmp_path):
    path = written(tmp_path, GRIPPER)
    robot = loaded(path)
    assert robot.joints == ("left",) and robot.followers[0].entry.name == "right"
    assert (robot.followers[0].multiplier, robot.followers[0].offset) == pytest.approx(
        (1.5, 0.01 + 0.002)
    )
    assert largest_difference(robot, path) < 1e-12


def test_frames_are_those_of_mujoco(tmp_path):
    path = written(tmp_path, ARM)
    robot = loaded(path)
    q = states(robot.n, 3, seed=5).q
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for configuration, place in zip(q, dynamics.positions(robot, "flange", q), strict=True):
        ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, j) for j in robot.joints]
        data.qpos[model.jnt_qposadr[ids]] = configuration
        mujoco.mj_kinematics(model, data)
        assert np.allclose(place, data.site("flange").xpos, atol=1e-12)


def test_limits_come_from_ranges_and_actuators(tmp_path):
    robot = loaded(written(tmp_path, ARM))
    entries = {entry.name: entry for entry in robot.entries}
    assert entries["pan"].position == pytest.approx(tuple(np.radians([-170, 170])))
    assert entries["slide"].position == (0.0, 0.3)
    assert entries["spin"].kind == "continuous" and entries["spin"].position is None
    torques = {name: entry.torque for name, entry in entries.items()}
    assert torques == {
        "pan": 120.0, "lift": 80.0, "slide": None, "roll": 30.0, "bend": 22.5, "spin": None
    }  # fmt: skip
    assert (entries["lift"].viscous, entries["lift"].coulomb) == (0.3, 0.1)
    assert (entries["roll"].viscous, entries["roll"].rotor_inertia) == (0.05, 0.004)
    with pytest.raises(MissingLimit) as caught:
        resolve(robot)
    text = str(caught.value)
    assert "URDF" not in text and "actuatorfrcrange" in text and "--limits FILE" in text
    missing = [(fault.joint, fault.quantity) for fault in caught.value.faults]
    assert missing == [
        *((joint, "velocity") for joint in ("pan", "lift")),
        ("slide", "velocity"), ("slide", "torque"),
        *((joint, "velocity") for joint in ("roll", "bend")),
        ("spin", "velocity"), ("spin", "torque"),
    ]  # fmt: skip


def test_missing_velocities_alone_are_set_by_the_option(tmp_path):
    robot = loaded(written(tmp_path, ARM), lock={"slide": 0.1, "spin": 0.0})
    with pytest.raises(MissingLimit) as caught:
        resolve(robot)
    assert {fault.quantity for fault in caught.value.faults} == {"velocity"}
    assert "; set them with --limits FILE" in str(caught.value)
    assert "MJCF" not in str(caught.value)


def test_the_place_of_limits_is_by_the_format_and_not_by_the_suffix(tmp_path):
    text = locate("two_link").read_text()
    path = tmp_path / "two.xml"
    path.write_text(re.sub(' velocity="[^"]*"', "", text))
    with pytest.raises(MissingLimit, match="in the URDF's <limit> or with --limits FILE"):
        resolve(load(str(path)))


def test_shapes_are_those_that_collide(tmp_path):
    path = written(tmp_path, ARM)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExciteWarning)
        shapes = {shape.link: shape for shape in urdf_geometry.read(str(path))}
    assert [shapes[link].kind.value for link in ("base", "shoulder", "upper", "fore", "hand")] == [
        "cylinder", "sphere", "capsule", "box", "box"
    ]  # fmt: skip
    assert shapes["base"].size == (0.08, 0.2)
    assert shapes["upper"].size == pytest.approx((0.05, 0.4))
    assert shapes["hand"].size == pytest.approx((0.1, 0.06, 0.04))  # the box around the ellipsoid
    assert "world" not in shapes


def test_omitted_shapes_are_reported(tmp_path):
    with pytest.warns(ExciteWarning) as caught:
        load(str(written(tmp_path, ARM)))
    text = "\n".join(str(warning.message) for warning in caught)
    assert "'ground' is left out; state a floor with --floor Z" in text
    assert "replaced by the box around it" in text


def tetrahedron(path: Path, size: float = 100.0) -> None:
    """A binary STL, in millimetres."""
    corners = size * np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.zeros(len(faces), record)
    triangles["corners"] = corners[list(map(list, faces))]
    path.write_bytes(bytes(80) + np.uint32(len(faces)).tobytes() + triangles.tobytes())


def test_meshes_are_where_mujoco_has_them(tmp_path):
    (tmp_path / "parts").mkdir()
    tetrahedron(tmp_path / "parts" / "wedge.stl")
    path = written(
        tmp_path,
        """<mujoco><compiler meshdir="parts"/>
        <asset><mesh name="wedge" file="wedge.stl" scale="0.001 0.001 0.002"/></asset>
        <worldbody><body name="arm" pos="0 0 1"><joint name="swing" axis="0 1 0" pos="0 0 0.1"/>
        <geom type="mesh" mesh="wedge" pos="0.1 0.2 0.3" euler="10 20 30"/></body></worldbody>
        </mujoco>""",
    )
    (shape,) = urdf_geometry.read(str(path))
    assert Path(str(shape.file)).name == "wedge.stl" and shape.size == (0.001, 0.001, 0.002)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    expected = model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
    robot = loaded(path)
    frame = robot.model.frames[robot.frame("arm")]
    zero = robot.model.createData()
    pin.framesForwardKinematics(robot.model, zero, np.zeros(1))
    placement = zero.oMf[robot.frame("arm")] * shape.placement
    actual = shape.triangles().reshape(-1, 3) @ placement.rotation.T + placement.translation
    assert frame.name == "arm"
    for corner in expected:
        assert np.abs(actual - corner).max(axis=1).min() < 1e-6


def test_a_free_base_is_held_with_a_remark(tmp_path):
    path = written(
        tmp_path,
        """<mujoco><worldbody><body name="trunk" pos="0 0 0.5"><freejoint/><geom size="0.1"/>
        <body name="leg"><joint name="hip" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03"/></body></body></worldbody>
        </mujoco>""",
    )
    with pytest.warns(ExciteWarning, match="free joint of 'trunk' is held"):
        robot = load(str(path))
    assert robot.joints == ("hip",)
    assert largest_difference(robot, path) < 1e-12


@pytest.mark.parametrize(
    ("inside", "extra", "reason"),
    [
        ('<joint name="j" type="ball"/>', "", "joint 'j' is a ball"),
        (
            '<joint name="j"/>',
            '<equality><connect body1="b" anchor="0 0 0"/></equality>',
            "closes a loop",
        ),
        (
            '<joint name="j"/><joint name="k" axis="0 1 0"/>',
            '<equality><joint joint1="j" joint2="k" polycoef="0 1 1 0 0"/></equality>',
            "polynomial",
        ),
        ('<joint name="j" axis="0 0 0"/>', "", "MuJoCo cannot compile it"),
        ('<joint nam="j"/>', "", "MuJoCo cannot compile it"),
    ],
)
def test_unsupported_elements_are_refused(tmp_path, inside, extra, reason):
    text = (
        f'<mujoco><worldbody><body name="b">{inside}<geom size="0.1"/></body></worldbody>{extra}'
        "</mujoco>"
    )
    with pytest.raises(UnusableInput, match=reason) as caught:
        load(str(written(tmp_path, text)))
    assert "\n" not in str(caught.value)


def test_without_mujoco_the_line_says_what_to_install(tmp_path, monkeypatch: MonkeyPatch):
    monkeypatch.setattr(mjcf, "find_spec", lambda _: None)
    with pytest.raises(UnusableInput, match=r"is an MJCF; .*pip install -e '\.\[sim\]'"):
        load(str(written(tmp_path, ARM.replace('"arm"', '"other"'))))


def test_an_include_is_followed(tmp_path):
    start = ARM.index("<default>")
    end = ARM.index("</default>\n  <worldbody>") + len("</default>")
    written(tmp_path, f"<mujocoinclude>{ARM[start:end]}</mujocoinclude>", "defaults.xml")
    text = ARM[:start] + '<include file="defaults.xml"/>' + ARM[end:]
    path = written(tmp_path, text)
    assert loaded(path).entries[1].viscous == 0.3


LIMITS = """
[joints.pan]
velocity = 2.0
[joints.lift]
velocity = 2.0
[joints.slide]
velocity = 0.5
torque = 200
[joints.roll]
velocity = 3.0
[joints.bend]
velocity = 3.0
[joints.spin]
velocity = 3.0
torque = 5
"""
SHORT = ("--starts", "1", "--harmonics", "3", "--samples", "60", "--iterations", "20")


def test_a_design_of_an_mjcf_is_certified_and_verified(tmp_path, capsys):
    path = written(tmp_path, ARM)
    limits = written(tmp_path, LIMITS, "limits.toml")
    out = tmp_path / "out"
    design = ("design", str(path), "--limits", str(limits), "-o", str(out), "--no-floor")
    assert main([*design, *SHORT]) == 0, capsys.readouterr().err
    document = json.loads((out / "trajectory.json").read_text())
    assert document["robot"]["sha256"] == mujoco_sha256(path)
    assert main(["verify", str(out / "trajectory.json")]) == 0
    simulated = ("simulate", str(path), str(out / "trajectory.json"))
    assert main([*simulated, "-o", str(tmp_path / "run.csv")]) == 0, capsys.readouterr().err
    recording = recordings.read(tmp_path / "run.csv", loaded(path))
    assert np.abs(recording.torque).max() > 1.0
    path.write_text(ARM.replace('mass="3.2"', 'mass="3.3"'))
    assert main(["verify", str(out / "trajectory.json")]) == 2
    assert "sha256" in capsys.readouterr().err


def mujoco_sha256(path: Path) -> str:
    import hashlib

    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_check_of_an_mjcf(tmp_path):
    result = check_robot(written(tmp_path, ARM))
    assert not result.usable and len(result.missing) == 8
    assert result.robot.name == "arm" and result.base_link == "world"


@pytest.mark.parametrize("text", [ARM, GRIPPER], ids=["arm", "gripper"])
def test_an_identified_mjcf_becomes_a_urdf(tmp_path, text):
    from excite.identification import urdf_export

    path = written(tmp_path, text)
    robot = loaded(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExciteWarning)
        standard = inertial_parameters.standard_parameters(robot, unlimited(robot))
    widths = np.full(robot.n, 0.01)
    exported = urdf_export.identified_urdf(robot, standard, standard.nominal, widths)
    copy = written(tmp_path, exported, "identified.urdf")
    again = load(str(copy))
    assert again.joints == robot.joints
    assert largest_difference(again, path) < 1e-9


# -- models of other packages ----------------------------------------------------------------------

MODELS = Path(os.environ.get("EXCITE_MJCF_DATA", "/tmp/rs/robosuite/models/assets/robots"))
"""Where the wheel robosuite is unpacked."""


@pytest.mark.skipif(not MODELS.is_dir(), reason=f"robosuite is not unpacked at {MODELS}")
@pytest.mark.parametrize("name", ["panda", "sawyer", "iiwa", "jaco", "kinova3", "ur5e", "xarm7"])
def test_models_of_robosuite_have_mujocos_inverse_dynamics(name):
    path = MODELS / name / "robot.xml"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    robot = loaded(path)
    assert dataclasses.is_dataclass(robot)
    assert largest_difference(robot, path) < 1e-9


def test_mujoco_is_an_extra():
    assert find_spec("mujoco") is not None
