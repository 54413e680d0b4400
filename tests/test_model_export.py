"""Identified robots in the files of simulators: the torque of the file is that of the model."""

from __future__ import annotations

import json
import math
import re
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin
import pytest
from conftest import BUILTIN, text_of
from diagnosis_cases import effect_entry
from identified_models import model_torque, random_states, read_model, write_model

import excite
from excite import exporters
from excite.cli.main import main
from excite.errors import UnusableInput
from excite.exporters.isaaclab_file import viscous_per_degree
from excite.exporters.mjcf_file import friction_solver, spring
from excite.robot.robot import load

mujoco = pytest.importorskip("mujoco")

STATES = 1000
"""Random states at which the torque of a file is compared with the model."""
NO_CONSTRAINTS = int(mujoco.mjtDisableBit.mjDSBL_EQUALITY | mujoco.mjtDisableBit.mjDSBL_CONTACT)
"""Mimic joints are followed exactly below, not by a soft constraint; links may overlap."""


def mujoco_torque(text: str, model, motion, friction: bool = True):
    """Torque of an MJCF by mj_inverse, of the model's joints. Shape (N, n)."""
    compiled = mujoco.MjModel.from_xml_string(text)
    if not friction:
        compiled.dof_frictionloss[:] = 0.0
    compiled.opt.disableflags |= NO_CONSTRAINTS
    data = mujoco.MjData(compiled)
    names = list(model.robot.model.names)[1:]
    places = [int(compiled.joint(name).dofadr[0]) for name in names]
    states = (
        model.robot.expand(motion.q),
        motion.dq @ model.robot.spread.T,
        motion.ddq @ model.robot.spread.T,
    )
    out = np.empty((len(motion), len(names)))
    for k, (q, v, a) in enumerate(zip(*states, strict=True)):
        data.qpos[places], data.qvel[places], data.qacc[places] = q, v, a
        mujoco.mj_inverse(compiled, data)
        out[k] = data.qfrc_inverse[places]
    return out @ model.robot.spread


@pytest.mark.parametrize("name", BUILTIN)
def test_the_mjcf_gives_the_torque_of_the_model(name, tmp_path):
    path = write_model(tmp_path, name)
    model = read_model(path)
    motion = random_states(model, STATES)
    text = excite.export_model(path, "mjcf").text
    smooth = mujoco_torque(text, model, motion, friction=False)
    np.testing.assert_allclose(smooth, model_torque(model, motion, coulomb=False), atol=1e-9)
    friction = model.psi[model.layout.block("coulomb")]
    error = np.abs(mujoco_torque(text, model, motion) - model_torque(model, motion)) / friction
    assert error[np.abs(motion.dq) > 3.0 * model.widths].max() <= 0.02


@pytest.mark.parametrize("name", BUILTIN)
def test_excite_reads_the_same_parameters_from_its_mjcf(name, tmp_path):
    path = write_model(tmp_path, name)
    model = read_model(path)
    file = excite.export_model(path, "mjcf").save(tmp_path / "robot.xml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = load(str(file), joints=model.robot.joints)
    assert again.joints == model.robot.joints
    for i, link in enumerate(model.robot.links):
        phi = again.model.inertias[again.links.index(link) + 1].toDynamicParameters()
        np.testing.assert_allclose(phi, model.psi[10 * i : 10 * i + 10], atol=1e-12)
    for kind in ("rotor_inertia", "viscous", "coulomb", "offset"):
        values = [getattr(entry, kind) for entry in again.entries]
        np.testing.assert_allclose(values, model.psi[model.layout.block(kind)], atol=1e-12)
    for before, after in zip(model.robot.entries, again.entries, strict=True):
        assert after.position == pytest.approx(before.position)
        assert after.torque == pytest.approx(before.torque)


@pytest.mark.parametrize("name", BUILTIN)
def test_pinocchio_reads_the_links_and_the_friction_of_the_urdf(name, tmp_path):
    path = write_model(tmp_path, name)
    model, text = read_model(path), excite.export_model(path, "urdf").text
    parsed = pin.buildModelFromXML(text)
    for i, link in enumerate(model.robot.links):
        joint = parsed.frames[parsed.getFrameId(link, pin.FrameType.BODY)].parentJoint
        phi = parsed.inertias[joint].toDynamicParameters()
        np.testing.assert_allclose(phi, model.psi[10 * i : 10 * i + 10], atol=1e-9)
    for j, joint in enumerate(model.robot.joints):
        degree = parsed.joints[parsed.getJointId(joint)].idx_v
        for array, kind in ((parsed.damping, "viscous"), (parsed.friction, "coulomb")):
            value = array[degree] if len(array) else np.nan
            expected = model.psi[model.layout.block(kind)][j]
            assert value == pytest.approx(expected, rel=1e-12)


def sdf_model(text: str) -> pin.Model:
    """Build Pinocchio's model from an SDF, by its specification and not by excite's reader."""
    root = ElementTree.fromstring(text).find("model")
    out, known = pin.Model(), {"world": 0}
    pending = root.findall("joint")
    while pending:
        joint = next(j for j in pending if j.findtext("parent") in known)
        pending.remove(joint)
        xyz, rpy = np.split(np.array([float(x) for x in joint.findtext("pose").split()]), 2)
        axis = np.array([float(x) for x in joint.findtext("axis/xyz").split()])
        slides = joint.get("type") == "prismatic"
        kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
        placement = pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
        number = out.addJoint(
            known[joint.findtext("parent")], kind(axis), placement, joint.get("name")
        )
        child = joint.findtext("child")
        known[child] = number
        link = next(e for e in root.findall("link") if e.get("name") == child)
        assert link.find("pose").get("relative_to") == joint.get("name")
        lever = np.array([float(x) for x in link.findtext("inertial/pose").split()])
        assert not lever[3:].any()
        xx, xy, xz, yy, yz, zz = (
            float(link.findtext(f"inertial/inertia/{key}"))
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        mass = float(link.findtext("inertial/mass"))
        out.appendBodyToJoint(number, pin.Inertia(mass, lever[:3], tensor), pin.SE3.Identity())
    return out


def sdf_torque(text: str, model, motion):
    """Torque of the links of an SDF by Pinocchio, of the model's joints. Shape (N, n)."""
    parsed = sdf_model(text)
    parsed.gravity = model.robot.model.gravity
    data, order = parsed.createData(), [str(name) for name in parsed.names][1:]
    places = [order.index(str(name)) for name in list(model.robot.model.names)[1:]]
    torque = np.empty((len(motion), parsed.nv))
    for k in range(len(motion)):
        state = np.zeros((3, parsed.nv))
        state[0, places] = model.robot.expand(motion.q[k])
        state[1, places] = model.robot.spread @ motion.dq[k]
        state[2, places] = model.robot.spread @ motion.ddq[k]
        torque[k] = pin.rnea(parsed, data, *state)
    return torque[:, places] @ model.robot.spread


@pytest.mark.parametrize("name", BUILTIN)
def test_the_sdf_gives_the_torque_of_the_links(name, tmp_path):
    path = write_model(tmp_path, name)
    model, text = read_model(path), excite.export_model(path, "sdf").text
    motion = random_states(model, 20)
    psi = model.psi.copy()
    psi[10 * len(model.robot.links) :] = 0.0
    bare = type(model)(model.source, model.robot, model.drive, psi, model.widths, model.hertz)
    expected = bare.torque(motion, motion.dq)
    np.testing.assert_allclose(sdf_torque(text, model, motion), expected, atol=1e-8)
    joints = ElementTree.fromstring(text).findall("model/joint")
    dynamics = {joint.get("name"): joint.find("axis/dynamics") for joint in joints}
    for j, joint in enumerate(model.robot.joints):
        for key, kind in (("damping", "viscous"), ("friction", "coulomb")):
            value = float(dynamics[joint].findtext(key))
            assert value == model.psi[model.layout.block(kind)][j]


@pytest.mark.parametrize(
    ("renamed", "links", "joints"),
    [
        (
            {"joint_1": "a", "link_1": "a", "joint_2": "a_joint", "link_2": "b"},
            ["a", "b"],
            ["a_joint_joint", "a_joint"],
        ),
        (
            {"joint_1": "a", "link_1": "b", "joint_2": "b", "link_2": "a"},
            ["b", "a"],
            ["a_joint", "b_joint"],
        ),
        ({"link_1": "world", "joint_2": "world"}, ["world_link", "link_2"], None),
        ({"base_link": "world"}, ["link_1", "link_2"], ["joint_1", "joint_2"]),
    ],
)
def test_names_in_an_sdf_are_unique(renamed, links, joints, tmp_path, capsys):
    urdf = ElementTree.fromstring(text_of("two_link"))
    for element in urdf.iter():
        for key in ("name", "link", "joint"):
            if element.get(key) in renamed:
                element.set(key, renamed[element.get(key)])
    file, out = tmp_path / "robot.urdf", tmp_path / "robot.sdf"
    file.write_text(ElementTree.tostring(urdf, encoding="unicode"))
    path = write_model(tmp_path, str(file))
    assert main(["export", str(path), "--format", "sdf", "-o", str(out)]) == 0
    warned, text = capsys.readouterr().err, out.read_text()
    body = ElementTree.fromstring(text).find("model")
    names = {kind: [e.get("name") for e in body.findall(kind)] for kind in ("link", "joint")}
    joints = ["joint_1", "world_joint"] if joints is None else joints
    assert names == {"link": links, "joint": joints}
    comment = text.partition("-->")[0]
    for new in {*links, *joints} - {"joint_1", "joint_2", "link_1", "link_2", *renamed.values()}:
        assert f"is '{new}'" in comment and f"is '{new}'" in warned
    model, parsed = read_model(path), sdf_model(text)
    for i, joint in enumerate(joints):  # the joints are connected as before
        phi = parsed.inertias[parsed.getJointId(joint)].toDynamicParameters()
        np.testing.assert_allclose(phi, model.psi[10 * i : 10 * i + 10], atol=1e-9)


# -- effects ---------------------------------------------------------------------------------------


def test_effects_that_mujoco_holds_are_parameters_of_the_file(tmp_path):
    effects = (
        effect_entry("drag", "joint_1", {}, 0.3),
        effect_entry("spring", "joint_1", {"form": 3.0}, 2.0, -0.5, 0.4),
        effect_entry("spring", "joint_2", {"form": 0.0}, 1.7),
        effect_entry("friction", "joint_2", {}, 0.4, 0.2),
    )
    path = write_model(tmp_path, "two_link", effects)
    model = read_model(path)
    exported, motion = excite.export_model(path, "mjcf"), random_states(model, 200)
    assert not exported.remainders
    q, dq = motion.q, motion.dq
    expected = model_torque(model, motion, coulomb=False)
    expected[:, 0] += 0.3 * dq[:, 0] * np.abs(dq[:, 0])
    expected[:, 0] += 2.0 * q[:, 0] - 0.5 * q[:, 0] ** 2 + 0.4 * q[:, 0] ** 3
    expected[:, 1] += 1.7 * q[:, 1] + 0.2 * dq[:, 1]
    torque = mujoco_torque(exported.text, model, motion, friction=False)
    np.testing.assert_allclose(torque, expected, atol=1e-9)


def test_a_spring_that_ends_within_the_range_of_its_joint_is_no_polynomial_of_the_file(tmp_path):
    form = {"form": 3.0, "low": -0.2, "high": 0.3}
    path = write_model(
        tmp_path, "two_link", (effect_entry("spring", "joint_1", form, 2.0, -0.5, 0.4),)
    )
    model = read_model(path)
    exported, motion = excite.export_model(path, "mjcf"), random_states(model, 200)
    assert [part.name for part in exported.remainders] == ["spring"]
    torque = mujoco_torque(exported.text, model, motion, friction=False)
    np.testing.assert_allclose(torque, model_torque(model, motion, coulomb=False), atol=1e-9)


def test_every_file_states_what_its_simulator_cannot_hold(tmp_path):
    effects = (
        effect_entry("load_friction", "joint_1", {"dense": 1.0, "scale": 20.0}, 0.1, 0.0, 0.0, 0.0),
        effect_entry("torque_ripple", "joint_2", {"order": 23.0, "load": 9.0}, 0.3, 0.4, 0.1, 0.1),
    )
    path = write_model(tmp_path, "two_link", effects)
    for name in ("mjcf", "urdf", "sdf", "isaaclab"):
        exported = excite.export_model(path, name)
        left = {(part.name, part.joint) for part in exported.remainders}
        assert {("load_friction", "joint_1"), ("torque_ripple", "joint_2")} <= left
        assert ("rotor inertia" in {kind for kind, _ in left}) == (name in ("urdf", "sdf"))
        assert "load_friction at joint_1: torque unknown" in exported.text
        assert "monday.csv" in exported.text and "+- 0.1" in exported.text


def test_the_springs_that_stand_for_offsets_are_named_in_the_comment(tmp_path):
    path = write_model(
        tmp_path, "two_link", (effect_entry("spring", "joint_2", {"form": 0.0}, 1.7),)
    )
    text = excite.export_model(path, "mjcf").text
    note = next(line for line in text.splitlines() if "constant torque" in line)
    offset = read_model(path).psi[read_model(path).layout.block("offset")][0]
    assert f"joint_1 {-offset:.4g} N m" in note and "joint_2" not in note  # it has a true spring
    assert "stiffness 1e-12" in text


def test_a_spring_with_an_offset_has_its_rest_position_where_its_torque_is_zero():
    rng, q = np.random.default_rng(0), np.linspace(-2.0, 2.0, 9)
    for coefficients in (*rng.normal(size=(20, 4)), np.array([0.3, 2.0, 0.0, 0.0])):
        k, reference, holds = spring(coefficients)
        x = q - reference
        assert holds
        expected = np.polynomial.polynomial.polyval(q, coefficients)
        np.testing.assert_allclose(k @ [x, x**2, x**3], expected, atol=1e-9)
    assert not spring(np.array([1.0, 0.0, 1.0, 0.0]))[2]  # 1 + q² has no zero


def test_the_friction_of_mujoco_has_the_width_that_was_identified():
    timestep, width, friction = 1e-3, 0.02, 3.0
    solref, solimp = friction_solver(friction, width, 0.8, timestep)
    text = f"""<mujoco><option timestep="{timestep}" gravity="0 0 0"/><worldbody><body>
      <joint name="j" frictionloss="{friction}" solreffriction="{solref[0]} {solref[1]}"
        solimpfriction="{" ".join(map(repr, solimp))}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1.25 1.25 1.25"/></body></worldbody></mujoco>"""
    compiled = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(compiled)
    for speed in np.linspace(-0.05, 0.05, 21):
        data.qvel[0], data.qacc[0] = speed, 0.0
        mujoco.mj_inverse(compiled, data)
        expected = friction * np.clip(speed / width, -1.0, 1.0)
        assert data.qfrc_inverse[0] == pytest.approx(expected, abs=1e-9)


# -- Isaac Lab -------------------------------------------------------------------------------------


def test_isaac_lab_is_per_radian_and_usd_per_degree(tmp_path):
    curves = (0.3, 0.0, 0.2, 0.0, 0.0, 0.1, 0.1, 0.0)
    effects = (effect_entry("stribeck", "joint_2", {"top_speed": 2.0}, *curves),)
    path = write_model(tmp_path, "two_link", effects)
    model = read_model(path)
    scope: dict[str, dict[str, dict[str, float]]] = {}
    exec(excite.export_model(path, "isaaclab").text, scope)
    actuator, usd = scope["ACTUATOR"], scope["USD_ATTRIBUTES"]
    viscous, coulomb = (model.psi[model.layout.block(kind)] for kind in ("viscous", "coulomb"))
    for j, joint in enumerate(model.robot.joints):
        static = coulomb[j] + (0.7 if joint == "joint_2" else 0.0)
        assert actuator["viscous_friction"][joint] == viscous[j]
        assert actuator["dynamic_friction"][joint] == coulomb[j]
        assert actuator["friction"][joint] == pytest.approx(static)
        axis = "physxJointAxis:angular"
        per_degree = usd[joint][f"{axis}:viscousFrictionCoefficient"]
        # the torque at one turn a second: 2 pi rad/s or 360 deg/s
        assert per_degree * 360.0 == pytest.approx(viscous[j] * 2.0 * math.pi)
        assert usd[joint][f"{axis}:staticFrictionEffort"] == pytest.approx(static)
        velocity = usd[joint][f"{axis}:maxJointVelocity"]
        assert velocity == pytest.approx(math.degrees(model.robot.entries[j].velocity))


def test_one_newton_metre_second_per_degree_is_57_per_radian():
    assert viscous_per_degree(57.29577951308232) == pytest.approx(1.0)


# -- the user's own MJCF --------------------------------------------------------------------------


def own_mjcf(text: str) -> str:
    """Return an MJCF of the same robot as its user would have it: other inertias, frames, units."""
    text = re.sub(r"<!--.*?-->", "<!-- the lab's arm: é -->", text, flags=re.DOTALL)
    keys = "armature|damping|frictionloss|solreffriction|solimpfriction|stiffness|springref"
    text = re.sub(rf' ({keys})="[^"]*"', "", text)
    text = re.sub(r"<inertial [^>]*/>", '<geom size="0.03"/>  <!-- kept -->', text)
    text = text.replace('angle="radian"', 'angle="degree"')
    text = re.sub(r' range="[^"]*"', "", text).replace('timestep="0.0005"', 'timestep="0.002"')
    return text.replace("<worldbody>", '<worldbody>\n    <geom type="plane" size="1 1 1"/>')


@pytest.mark.parametrize("name", ["two_link", "ur5e", "panda"])
def test_a_merge_changes_only_what_was_identified(name, tmp_path):
    path = write_model(tmp_path, name)
    model = read_model(path)
    mine = tmp_path / "mine.xml"
    mine.write_text(own_mjcf(excite.export_model(path, "mjcf").text), encoding="utf-8")
    merged = excite.export_model(path, "mjcf", into=mine).text
    motion = random_states(model, 50)
    smooth = mujoco_torque(merged, model, motion, friction=False)
    np.testing.assert_allclose(smooth, model_torque(model, motion, coulomb=False), atol=1e-8)
    before, after = mine.read_text(encoding="utf-8"), merged
    assert after.count("<!-- kept -->") == before.count("<!-- kept -->") > 0
    assert "the lab's arm: é" in after and 'timestep="0.002"' in after
    unchanged = re.compile(r"^(?!.*<(?:joint|inertial|body)).*$", re.MULTILINE)
    kept = {match[0] for match in unchanged.finditer(before)}
    assert kept <= {*after.splitlines(), ""}


def test_a_merge_keeps_what_other_joints_move_and_empties_what_is_fixed(tmp_path):
    path = write_model(tmp_path, "two_link")
    model = read_model(path)
    text = own_mjcf(excite.export_model(path, "mjcf").text)
    hand = """<body name="hand"><geom size="0.02" mass="0.3"/>
      <body name="finger" pos="0.05 0 0"><joint name="finger" type="slide"/>
      <inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/></body></body>"""
    mine = tmp_path / "mine.xml"
    mine.write_text(re.sub(r"(<site)", hand + r"\1", text, count=1), encoding="utf-8")
    compiled = mujoco.MjModel.from_xml_string(excite.export_model(path, "mjcf", into=mine).text)
    assert compiled.body("hand").mass[0] == 0.0
    assert compiled.body("finger").mass[0] == 0.05
    total = float(model.psi[10 * (len(model.robot.links) - 1)])
    carrier = model.robot.links[-1]
    parent = mujoco.mj_id2name(
        compiled, mujoco.mjtObj.mjOBJ_BODY, int(compiled.body("hand").parentid[0])
    )
    if parent == carrier:
        assert compiled.body(carrier).mass[0] == pytest.approx(total - 0.05)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda t: t.replace('name="joint_2"', 'name="elbow"'), "joint 'joint_2' of the model"),
        (lambda t: t.replace("<compiler", '<compiler inertiafromgeom="true"'), "inertiafromgeom"),
        (
            lambda t: re.sub(r'(name="joint_2"[^>]*)axis="[^"]*"', r'\1axis="1 0 0"', t),
            "at q = 0 its axis differs",
        ),
        (lambda t: t.replace("</mujoco>", "</mujoc>"), "mine.xml: "),
    ],
)
def test_a_merge_into_another_robot_is_refused(change, problem, tmp_path):
    path = write_model(tmp_path, "two_link")
    mine = tmp_path / "mine.xml"
    text = own_mjcf(excite.export_model(path, "mjcf").text)
    text = text.replace(' joint="joint_2"', ' joint="joint_1"')
    mine.write_text(change(text), encoding="utf-8")
    with pytest.raises(UnusableInput, match=re.escape(problem)):
        excite.export_model(path, "mjcf", into=mine)


# -- the command -----------------------------------------------------------------------------------


def test_the_kind_of_the_document_decides_what_is_exported(tmp_path, capsys):
    path, out = write_model(tmp_path, "two_link"), tmp_path / "robot.sdf"
    arguments = ["export", str(path), "--format", "sdf", "-o", str(out), "--json"]
    assert main(arguments) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["file"] == str(out) and document["format"] == "sdf"
    assert {part["name"] for part in document["not_held"]} == {"rotor inertia", "offset"}


def test_the_format_decides_what_a_file_that_cannot_be_read_should_be(tmp_path, capsys):
    for name, kind in (("mjcf", "model.json"), ("csv", "trajectory.json")):
        words = ["export", str(tmp_path / "none.json"), "--format", name, "-o", str(tmp_path / "x")]
        assert main(words) == 2
        error = capsys.readouterr().err
        assert "none.json: cannot be read" in error and kind in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--format", "csv"], "--format csv: is no format of an identified robot"),
        (["--format", "urdf", "--into", "mine.xml"], "--into mine.xml: goes with --format mjcf"),
        (["--format", "mjcf", "--speed", "0.1"], "--speed: goes with a trajectory.json"),
        (["--format", "mjcf", "--lead", "8"], "--lead: goes with a trajectory.json"),
        (["--format", "mjcf", "--recording", "none.csv"], "none.csv"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_one_line(options, problem, tmp_path, capsys):
    path = write_model(tmp_path, "two_link")
    assert main(["export", str(path), *options, "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert problem in error and error.count("\n") == 1


PROVENANCE = {
    "recordings": ["monday.csv"],
    "link_estimates": [
        {"name": "link_1", "mass": {"value": 4.0, "std": 0.5, "data_share": 0.7}},
        {"name": "link_2", "mass": {"value": None, "std": None, "data_share": None}},
    ],
    "fit": [{"recording": "monday.csv", "joints": {"joint_1": {"rmse": 0.2}, "joint_2": {}}}],
    "validation": None,
    "position_fit": [{"recording": "monday.csv", "joints": {"joint_1": {"position_rmse": None}}}],
    "position_validation": [],
    "scale": {"words": "of the gains"},
}
"""Sections of a `model.json` that an export states in its comment."""


def with_provenance(folder, key, value):
    """Write a `model.json` with another value at a key such as `fit.0.joints`; "absent" removes
    the key."""
    path = write_model(folder, "two_link")
    content = json.loads(path.read_text(encoding="utf-8")) | json.loads(json.dumps(PROVENANCE))
    *parents, last = [int(word) if word.isdigit() else word for word in key.split(".")]
    target = content
    for parent in parents:
        target = target[parent]
    if value == "absent":
        del target[last]
    else:
        target[last] = value
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("format", exporters.MODEL_FORMATS)
@pytest.mark.parametrize("key", ["scale", "fit", "validation", "recordings", "link_estimates"])
def test_a_model_without_a_section_of_its_provenance_is_exported(key, format, tmp_path):
    path = with_provenance(tmp_path, key, "absent")
    assert excite.export_model(path, format).text


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("recordings", "monday.csv"),
        ("recordings", [5]),
        ("link_estimates", {"link_1": 4.0}),
        ("link_estimates.0", 4.0),
        ("link_estimates.0.name", "absent"),
        ("link_estimates.0.mass", "absent"),
        ("link_estimates.0.mass", 4.0),
        ("link_estimates.0.mass.value", "4"),
        ("link_estimates.0.mass.std", "absent"),
        ("link_estimates.1.mass.std", [0.5]),
        ("link_estimates.1.mass.data_share", "absent"),
        ("fit", {"monday.csv": 0.2}),
        ("fit", ["monday.csv"]),
        ("fit.0.recording", 5),
        ("fit.0.joints", ["joint_1"]),
        ("fit.0.joints.joint_1", 0.2),
        ("fit.0.joints.joint_1.rmse", "0.2"),
        ("validation", 0.2),
        ("validation", [[]]),
        ("position_fit.0.joints.joint_1", {}),
        ("position_fit.0.joints.joint_1.position_rmse", "0.2"),
        ("position_validation", "monday.csv"),
        ("scale", "of the gains"),
        ("scale.words", 5),
        ("standard_parameters.20.std", "0.1"),
        ("standard_parameters.20.unit", 5),
    ],
)
def test_a_faulty_provenance_is_refused_in_one_line(key, value, tmp_path, capsys):
    path, out = with_provenance(tmp_path, key, value), tmp_path / "out"
    assert main(["export", str(path), "--format", "sdf", "-o", str(out)]) == 2
    error = capsys.readouterr().err
    assert f"{path}: {key.partition('.')[0]}" in error and error.count("\n") == 1
    assert not out.exists()
