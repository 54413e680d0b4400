from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from conftest import (
    BUILTIN,
    LIMIT,
    document,
    joint,
    link,
    loaded,
    off,
    pendulum,
    random_tensor,
    random_urdf,
    raw_torque,
    seeds,
    states,
    text_of,
)
from hypothesis import example, given
from hypothesis import strategies as st

from excite.errors import UnusableInput
from excite.identification.urdf_export import identified_urdf
from excite.robot import inertial_parameters
from excite.robot.dynamics import regressor
from excite.robot.limits import resolve
from excite.robot.robot import Payload, Robot, builtin_names, load
from excite.robot.samples import Samples
from excite.robot.urdf import JointEntry

INERTIAL: tuple[str, ...] = ()


def torque(robot: Robot, motion: Samples) -> np.ndarray:
    standard = inertial_parameters.standard_parameters(robot, resolve(robot), INERTIAL)
    return regressor(robot, standard, motion) @ standard.nominal


# -- joints of every kind --------------------------------------------------------------------------


@given(seeds, st.booleans())
def test_torque_of_any_tree_is_pinocchios_on_the_urdf_as_it_stands(rng, tidy):
    text = random_urdf(rng, 5, tidy=tidy)
    robot = loaded(text)
    motion = states(robot.n)
    assert off(torque(robot, motion), raw_torque(text, robot.joints, motion)) < 1e-12


@pytest.mark.parametrize("name", BUILTIN)
def test_torque_of_a_builtin_model_is_pinocchios(name):
    robot = load(name)
    motion = states(robot.n)
    assert off(torque(robot, motion), raw_torque(text_of(name), robot.joints, motion)) < 1e-12


def test_builtin_models_are_all_listed():
    assert builtin_names() == BUILTIN


def test_continuous_joint_has_one_coordinate():
    robot = loaded(pendulum(kind="continuous"))
    assert (robot.model.nq, robot.model.nv, robot.n) == (1, 1, 1)


def test_continuous_joint_ignores_position_limits_stated_for_it():
    assert resolve(loaded(pendulum(kind="continuous"))).position.tolist() == [[-np.inf, np.inf]]


def test_continuous_joint_repeats_every_turn():
    robot, motion = loaded(pendulum(kind="continuous")), states(1)
    turned = Samples(motion.q + 2 * np.pi, motion.dq, motion.ddq)
    assert off(torque(robot, turned), torque(robot, motion)) < 1e-12


def test_prismatic_joint_lifts_its_mass():
    robot = loaded(pendulum(kind="prismatic", axis=(0, 0, 2)))
    motion = states(1)
    assert np.allclose(torque(robot, motion), 2.0 * (9.81 + motion.ddq), rtol=1e-14)


def test_axis_need_not_be_of_unit_length():
    motion = states(1)
    long, unit = (loaded(pendulum(axis=(0, length, 0))) for length in (5.0, 1.0))
    assert np.array_equal(torque(long, motion), torque(unit, motion))


MIMICS = {2: (0, -1.7, 0.3), 3: (2, 0.5, -0.4)}  # the second follows the first


@given(seeds)
def test_mimic_torque_is_the_virtual_work_of_all_its_joints(rng):
    text = random_urdf(rng, 5, mimics=MIMICS)
    robot, motion = loaded(text), states(3)
    everyone = tuple(f"j{i}" for i in range(5))

    def follow(x, constant):
        j0, j1, j4 = (x[:, robot.joints.index(name)] for name in ("j0", "j1", "j4"))
        j2 = -1.7 * j0 + 0.3 * constant
        return np.column_stack([j0, j1, j2, 0.5 * j2 - 0.4 * constant, j4])

    free = raw_torque(
        text, everyone, Samples(follow(motion.q, 1), follow(motion.dq, 0), follow(motion.ddq, 0))
    )
    virtual = [follow(unit[None, :], 0)[0] for unit in np.eye(3)]
    assert off(torque(robot, motion), free @ np.array(virtual).T) < 1e-12


@given(seeds)
def test_mimic_model_balances_power(rng):
    text = random_urdf(rng, 4, mimics={2: (0, -1.7, 0.3)})
    robot, motion = loaded(text), states(3, count=1)
    model = robot.model
    data = model.createData()

    def energy(t):
        q, dq = motion.q + t * motion.dq + t**2 / 2 * motion.ddq, motion.dq + t * motion.ddq
        x = robot.expand(q)[0]
        return pin.computeKineticEnergy(
            model, data, x, (dq @ robot.spread.T)[0]
        ) + pin.computePotentialEnergy(model, data, x)

    h = 1e-4
    rate = (8 * (energy(h) - energy(-h)) - energy(2 * h) + energy(-2 * h)) / (12 * h)
    assert np.isclose(np.sum(torque(robot, motion) * motion.dq), rate, rtol=1e-7, atol=1e-6)


def test_mimic_joints_are_no_joints_of_the_robot():
    robot = loaded(random_urdf(np.random.default_rng(0), 5, mimics=MIMICS))
    assert set(robot.joints) == {"j0", "j1", "j4"}


def test_body_of_a_joint_is_its_own_where_others_are_mimics():
    robot = loaded(random_urdf(np.random.default_rng(0), 5, mimics=MIMICS))
    bodies = [robot.model.names[robot.body_of(j)] for j in range(robot.n)]
    assert bodies == list(robot.joints)


def test_locking_the_master_locks_its_mimic_where_it_belongs():
    text = random_urdf(np.random.default_rng(0), 3, mimics={2: (0, 0.5, 0.1)}, tree=False)
    robot, motion = loaded(text, lock={"j0": 0.8}), states(1)
    held = np.tile([0.8, 0.0, 0.5], (len(motion), 1))
    held[:, 1] = motion.q[:, 0]
    zero = np.zeros_like(held)
    dq, ddq = zero.copy(), zero.copy()
    dq[:, 1], ddq[:, 1] = motion.dq[:, 0], motion.ddq[:, 0]
    assert (
        off(
            torque(robot, motion),
            raw_torque(text, ("j0", "j1", "j2"), Samples(held, dq, ddq))[:, 1:2],
        )
        < 1e-12
    )


def test_identified_urdf_holds_a_chain_of_locked_mimics_where_they_follow(tmp_path: Path):
    def follows(master: str, multiplier: float) -> str:
        return LIMIT + f'<mimic joint="{master}" multiplier="{multiplier}"/>'

    path, exported = tmp_path / "chain.urdf", tmp_path / "identified.urdf"
    place, across = (0.3, 0.0, 0.0), (0, 1, 0)
    path.write_text(
        document(
            *(link(name, 1.0, (0.1, 0.0, 0.0)) for name in ("base", "l1", "l2", "l3", "l4")),
            joint("j1", "base", "l1", axis=across),
            joint("j2", "l1", "l2", xyz=place, axis=across),
            joint("j3", "l2", "l3", xyz=place, axis=across, inside=follows("j2", 0.5)),
            joint("j4", "l3", "l4", xyz=place, axis=across, inside=follows("j3", 2.0)),
        ),
        encoding="utf-8",
    )
    robot = load(str(path), lock={"j2": 0.8})
    standard = inertial_parameters.standard_parameters(robot, resolve(robot))
    text = identified_urdf(robot, standard, standard.nominal, np.full(1, 0.01))
    exported.write_text(text, encoding="utf-8")
    places = []
    for model in (robot.model, load(str(exported)).model):
        data = model.createData()
        pin.framesForwardKinematics(model, data, np.array([0.3]))
        places.append(data.oMf[model.getFrameId("l4")].homogeneous)
    np.testing.assert_allclose(*places, atol=1e-9)


def test_fixed_links_keep_their_mass():
    parts = [
        link("base"),
        link("arm", 2.0),
        link("tool", 0.7),
        joint("swing", "base", "arm"),
        joint("mount", "arm", "tool", "fixed"),
    ]
    assert np.isclose(loaded(document(*parts)).model.inertias[1].mass, 2.7)


# -- locking, payload, gravity ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "choice", [{"lock": {"joint_2": 1.1}}, {"joints": ["joint_1"], "lock": {"joint_2": 1.1}}]
)
def test_locked_joint_holds_its_masses_at_its_angle(choice):
    robot, motion = load("two_link", **choice), states(1)
    both = [
        np.column_stack([column, np.full(len(column), held)])
        for column, held in ((motion.q, 1.1), (motion.dq, 0.0), (motion.ddq, 0.0))
    ]
    expected = raw_torque(text_of("two_link"), ("joint_1", "joint_2"), Samples(*both))[:, :1]
    assert off(torque(robot, motion), expected) < 1e-12


def test_joints_left_out_rest_at_neutral():
    assert load("ur10e", joints=["elbow_joint"]).options["locked"]["shoulder_pan_joint"] == 0.0


def test_joint_whose_range_excludes_neutral_rests_at_its_nearest_bound():
    locked = load("panda", joints=["panda_joint1"]).options["locked"]
    assert locked["panda_joint4"] == pytest.approx(-0.0698)


def test_locking_outside_the_limits_is_refused_with_the_joint():
    with pytest.raises(
        UnusableInput, match=r"--lock joint_2=9: .* limits of the joint, -2\.6 to 2\.6"
    ):
        load("two_link", lock={"joint_2": 9.0})
    assert load("two_link", lock={"joint_2": 2.60004}).options["locked"] == {"joint_2": 2.60004}


def test_order_of_joints_is_the_models_whatever_was_asked():
    assert load("two_link", joints=["joint_2", "joint_1"]).joints == ("joint_1", "joint_2")


@given(seeds)
def test_payload_is_a_body_in_the_urdf(rng):
    mass, centre, tensor = rng.uniform(0.5, 3), rng.uniform(-0.2, 0.2, 3), random_tensor(rng)
    text = random_urdf(rng, 3)
    with_body = text.replace(
        "</robot>",
        link("load", mass, tuple(centre), tensor)
        + joint("weld", "tool", "load", "fixed")
        + "</robot>",
    )
    load_at = Payload(
        "tool",
        mass,
        tuple(centre),
        (tensor[0, 0], tensor[0, 1], tensor[1, 1], tensor[0, 2], tensor[1, 2], tensor[2, 2]),
    )
    motion = states(3)
    assert (
        off(torque(loaded(text, payload=load_at), motion), torque(loaded(with_body), motion))
        < 1e-12
    )


def test_gravity_points_where_it_is_told():
    motion, pull = states(2), (3.0, -2.0, 8.0)
    robot = load("two_link", gravity=pull)
    assert (
        off(torque(robot, motion), raw_torque(text_of("two_link"), robot.joints, motion, pull))
        < 1e-12
    )


def test_fingerprint_is_the_files(tmp_path: Path):
    import hashlib

    path = tmp_path / "arm.urdf"
    path.write_text(pendulum())
    assert load(str(path)).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


# -- what cannot be used ---------------------------------------------------------------------------

ARM = link("arm", 2.0)
BROKEN = {
    "broken XML": (pendulum()[:-12], "valid XML", "repair"),
    "empty": ("", "valid XML", "repair"),
    "a model": ('{"format": "excite.model/1"}', "not a URDF", "first comes"),
    "other root": ("<model/>", "<model>", "give a URDF"),
    "xacro inside": (pendulum().replace("0.3", "${length}"), "xacro", "expand it"),
    "unknown type": (pendulum(kind="screw"), "'swing' is of type 'screw'", "correct its type"),
    "nothing moves": (pendulum(kind="fixed"), "no movable joint", "needs at least one"),
    "no links": (document(), "thing.urdf", ""),
    "no mass": (pendulum(body='<link name="arm"/>'), "'swing' moves no mass", "<inertial>"),
    "nan mass": (
        pendulum().replace('mass value="2.0"', 'mass value="nan"'),
        "'arm'",
        "not finite; correct",
    ),
    "inf limit": (
        pendulum(inside='<limit effort="inf"/>'),
        "'swing', effort",
        "not finite; correct",
    ),
    "word": (pendulum(inside='<limit effort="strong"/>'), "'swing', effort", "'strong'"),
    "two numbers": (pendulum().replace('xyz="0.3 0.0 0.0"', 'xyz="0.3 0.0"'), "'arm'", "3 number"),
    "zero axis": (pendulum(axis=(0, 0, 0)), "'swing'", "axis is zero"),
    "unknown link": (
        document(link("base"), ARM, joint("swing", "base", "leg")),
        "'swing'",
        "add the <link>",
    ),
    "two roots": (
        document(link("base"), ARM, link("island", 1.0), joint("swing", "base", "arm")),
        "'base' and 'island'",
        "connect them",
    ),
    "loop": (
        document(link("base"), ARM, joint("a", "base", "arm"), joint("b", "arm", "base")),
        "joint 'b'",
        "closes a loop",
    ),
    "nameless link": (
        pendulum().replace('<link name="arm">', "<link>"),
        "<link> has no attribute 'name'",
        "add it",
    ),
    "only a mimic": (
        pendulum(inside=LIMIT + '<mimic joint="swing"/>'),
        "no movable joint",
        "needs at least one",
    ),
    "mimics a stranger": (
        document(
            link("base"),
            ARM,
            link("leg", 1.0),
            joint("a", "base", "arm"),
            joint("b", "arm", "leg", inside='<mimic joint="ghost"/>'),
        ),
        "'ghost'",
        "correct its <mimic>",
    ),
    "mimics in a circle": (
        document(
            *(link(name, 1.0) for name in ("base", "arm", "leg", "toe")),
            joint("a", "base", "arm"),
            joint("b", "arm", "leg", inside='<mimic joint="c"/>'),
            joint("c", "leg", "toe", inside='<mimic joint="b"/>'),
        ),
        "mimic joint",
        "correct its <mimic>",
    ),
}


def refusal(path: Path, **options: object) -> str:
    with pytest.raises(UnusableInput) as caught:
        load(str(path), **options)  # type: ignore[arg-type]
    return str(caught.value)


@pytest.mark.parametrize("case", BROKEN)
def test_unusable_urdf_says_why_in_one_line_with_its_name(case, tmp_path: Path):
    text, *parts = BROKEN[case]
    path = tmp_path / "thing.urdf"
    path.write_text(text)
    line = refusal(path)
    assert all(part in line for part in (str(path), *parts)) and "\n" not in line, line


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"joints": ["knee"]}, "no joint 'knee'; there are: swing"),
        ({"lock": {"knee": 0.0}}, "no joint 'knee'; there are: swing"),
        ({"lock": {"swing": 0.0}}, "every joint is locked; leave at least one"),
        (
            {"lock": {"swing": 0.0}, "joints": ["swing"]},
            "'swing' is both in --joints and in --lock; drop one",
        ),
        ({"lock": {"swing": np.nan}}, "--lock swing=nan: the position should be from -1e+06"),
        ({"gravity": (0.0, 0.0)}, "--gravity 0,0: should be three numbers [m/s²]"),
        ({"gravity": (0.0, 0.0, np.nan)}, "--gravity 0,0,nan: should be three numbers"),
        ({"payload": Payload("claw", 1.0)}, "no link 'claw'"),
        ({"payload": Payload("arm", 0.0)}, "positive mass"),
        ({"payload": Payload("arm", -1.0)}, "its mass -1 should be from 0 to 1e+06 kg"),
        ({"payload": Payload("arm", np.nan)}, "its mass nan should be from 0"),
        ({"payload": Payload("base", 1.0)}, "'base' does not move"),
    ],
)
def test_unusable_options_say_why_with_file_and_joint(options, part, tmp_path: Path):
    path = tmp_path / "thing.urdf"
    path.write_text(pendulum())
    line = refusal(path, **options)
    assert str(path) in line and part in line, line


def test_naming_a_mimic_names_its_master(tmp_path: Path):
    path = tmp_path / "thing.urdf"
    path.write_text(random_urdf(np.random.default_rng(0), 3, mimics={2: (0, 1.0, 0.0)}))
    assert "'j2' mimics 'j0'; name that one" in refusal(path, joints=["j2"])


def test_a_xacro_file_gets_the_line_that_expands_it(tmp_path: Path):
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(pendulum())
    if find_spec("xacrodoc") is None:
        assert "xacro arm.urdf.xacro > arm.urdf" in refusal(path)


def test_a_missing_file_says_how_to_name_one(tmp_path: Path):
    assert "no such file; give a URDF's path" in refusal(tmp_path / "none.urdf")


def test_a_folder_or_a_pipe_is_no_robot(tmp_path: Path):
    """As in `excite check <(xacro arm.xacro)`."""
    assert "is a folder, a pipe" in refusal(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    assert "write the robot's URDF to a file" in refusal(tmp_path / "pipe")


def test_an_unknown_name_lists_the_builtin_ones():
    assert "ur10e" in refusal(Path("pumba"))


def test_an_unknown_frame_offers_the_nearest():
    with pytest.raises(UnusableInput, match="did you mean tip"):
        load("two_link").frame("tipp")


@given(st.text(max_size=40))
@example("<robot/>")
@example("<robot name='x'><link name='a'/></robot>")
def test_any_text_at_all_is_refused_not_crashed(text):
    with pytest.raises(UnusableInput):
        loaded(text)


def test_a_comment_does_not_make_a_xacro():
    assert loaded(
        pendulum().replace("</robot>", '<!-- <xacro:include filename="${x}"/> --></robot>')
    ).joints == ("swing",)


@pytest.mark.parametrize(("tag", "name"), [("joint", "swing"), ("link", "arm")])
def test_names_that_occur_twice_are_named(tag, name):
    text = pendulum()
    copy = text[text.index(f'<{tag} name="{name}"') :]
    copy = copy[: copy.index(f"</{tag}>") + len(f"</{tag}>")]
    with pytest.raises(UnusableInput, match=rf"two {tag}s are named '{name}'"):
        loaded(text.replace("</robot>", copy + "</robot>"))


def test_a_payload_whose_inertia_is_no_bodys_is_refused():
    with pytest.raises(UnusableInput, match="no body has that inertia"):
        loaded(pendulum(), payload=Payload("arm", 1.0, inertia=(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0)))


def test_a_sliding_joint_has_units_of_its_own():
    slide, hinge = (
        JointEntry("a", kind, "arm", None, None, None, 0.0, 0.0, None)
        for kind in ("prismatic", "revolute")
    )
    units = {
        "N m": "N",
        "rad/s": "m/s",
        "N m s/rad": "N s/m",
        "N m/rad": "N/m",
        "kg m²": "kg",
        "N m (s/rad)^k": "N (s/m)^k",
        "s": "s",
    }
    assert {unit: slide.unit(unit) for unit in units} == units
    assert {hinge.unit(unit) for unit in units} == set(units)
