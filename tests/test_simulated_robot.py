"""The simulated robot against Pinocchio, against itself and against conservation of energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from contract import EFFECT_NAMES
from scipy import signal

pytest.importorskip("mujoco")

from simulated_robots import builtin_urdf, quick_motion

from excite.errors import UnusableInput
from excite.simulator import (
    effect_instance,
    experiment,
    mujoco_dynamics,
    regressor,
    severity,
    urdf_tree,
)
from excite.simulator.actuator import ControllerGains
from excite.simulator.effects import CATALOGUE_NAMES, EFFECT_TYPES, FORM_FAMILIES
from excite.simulator.experiment import ExperimentSettings
from excite.simulator.model_error import perturb_bodies
from excite.simulator.physical_effect import JointStates, PhysicalEffect, TransmissionSpring
from excite.simulator.recording_file import inertial_vector


@pytest.fixture(scope="module")
def robot_session():
    motion, setting = quick_motion(), ExperimentSettings(seed=3)
    robot = experiment.build_robot(builtin_urdf("two_link"), motion, setting)
    return robot, motion, setting, experiment.run_session(robot, motion, setting)


@pytest.fixture(scope="module")
def short_session():
    """A shorter session with coarser steps: enough to see whether two runs are equal."""
    motion, setting = quick_motion(1.2), ExperimentSettings(seed=3)
    robot = replace(experiment.build_robot(builtin_urdf("two_link"), motion, setting), step=2e-3)
    return robot, motion, setting, experiment.run_session(robot, motion, setting)


def robot_with(robot, text: str):
    return effect_instance.with_effects(robot, (effect_instance.parse_effect(text, robot),))


# -- rigid bodies ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["two_link", "tx40", "ur10e", "panda", "iiwa14"])
def test_base_physics_agrees_with_pinocchio(name):
    rng = np.random.default_rng(1)
    tree = perturb_bodies(urdf_tree.read_urdf(builtin_urdf(name)), 0.05, rng)
    arm = mujoco_dynamics.build_dynamics(tree, tree.joints)
    q, v, a = (
        rng.uniform(-2, 2, (20, arm.n)),
        rng.normal(size=(20, arm.n)),
        5 * rng.normal(size=(20, arm.n)),
    )
    model = pin.buildModelFromXML(tree.xml)
    data = model.createData()
    assert tuple(model.names[1:]) == arm.joints
    expected = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])
    assert np.abs(arm.inverse_dynamics(q, v, a) - expected).max() < 1e-8
    for row in range(3):
        mass, bias = arm.mass_and_bias(q[row], v[row])
        assert np.abs(mass @ a[row] + bias - expected[row]).max() < 1e-8


def test_first_of_repeated_elements_counts():
    text = builtin_urdf("two_link").read_text()
    repeated = text.replace("</joint>", '<origin xyz="9 9 9" rpy="1 1 1"/></joint>')
    assert repeated.count("<origin") > text.count("<origin")
    q, v, a = np.random.default_rng(5).normal(size=(3, 10, 2))
    original, other = (
        mujoco_dynamics.build_dynamics(urdf_tree.parse_urdf(t, "text"), ("joint_1", "joint_2"))
        for t in (text, repeated)
    )
    np.testing.assert_array_equal(
        other.inverse_dynamics(q, v, a), original.inverse_dynamics(q, v, a)
    )


def test_dynamics_of_prismatic_and_locked_joints():
    from tests.conftest import document, joint, link, random_link

    rng = np.random.default_rng(2)
    text = document(
        link("base"),
        random_link(rng, "a"),
        random_link(rng, "b"),
        random_link(rng, "c"),
        joint("j1", "base", "a", "revolute", (0.1, 0, 0.3), (0.3, 0.2, 0.1), (0, 1, 0)),
        joint("j2", "a", "b", "prismatic", (0.2, 0.1, 0), (0.1, -0.4, 0), (0.6, 0, 0.8)),
        joint("j3", "b", "c", "continuous", (0, 0.2, 0), (0, 0, 1.0), (0, 0, 1)),
    )
    tree = urdf_tree.UrdfTree("text", urdf_tree.ElementTree.fromstring(text))
    complete, locked = (
        mujoco_dynamics.build_dynamics(tree, tree.joints),
        mujoco_dynamics.build_dynamics(tree, ("j1", "j2"), {"j3": 0.7}),
    )
    q, v, a = rng.normal(size=(3, 10, 2))
    wide = [np.column_stack([x, np.full(10, fill)]) for x, fill in ((q, 0.7), (v, 0.0), (a, 0.0))]
    np.testing.assert_allclose(
        locked.inverse_dynamics(q, v, a), complete.inverse_dynamics(*wide)[:, :2], atol=1e-10
    )
    y = regressor.rigid_body_regressor(complete, *wide)
    parameters = np.concatenate([inertial_vector(tree, name) for name in "abc"])
    np.testing.assert_allclose(y @ parameters, complete.inverse_dynamics(*wide), atol=1e-10)


@pytest.mark.parametrize("name", ["ur10e", "panda"])
def test_regressor_times_parameters_is_the_torque(name):
    rng = np.random.default_rng(3)
    tree = urdf_tree.read_urdf(builtin_urdf(name))
    arm = mujoco_dynamics.build_dynamics(tree, tree.joints)
    q, v, a = rng.normal(size=(3, 15, arm.n))
    y = regressor.rigid_body_regressor(arm, q, v, a)
    moving = [
        str(arm.model.body(b).name)
        for b in range(1, arm.model.nbody)
        if arm.model.body_weldid[b] != 0
    ]
    np.testing.assert_allclose(
        y @ np.concatenate([inertial_vector(tree, link) for link in moving]),
        arm.inverse_dynamics(q, v, a),
        atol=1e-9,
    )


def test_perturbed_bodies_are_consistent_and_differ_by_the_stated_size():
    tree = urdf_tree.read_urdf(builtin_urdf("ur10e"))
    other = perturb_bodies(tree, 0.05, np.random.default_rng(0))
    masses = []
    for link in tree.links:
        assert np.linalg.eigvalsh(other.pseudo_inertia(link)).min() > 0.0
        masses.append(other.pseudo_inertia(link)[3, 3] / tree.pseudo_inertia(link)[3, 3] - 1.0)
    assert 0.01 < np.std(masses) < 0.12
    assert perturb_bodies(tree, 0.0, np.random.default_rng(0)).pseudo_inertia(
        "forearm_link"
    ) == pytest.approx(tree.pseudo_inertia("forearm_link"), rel=1e-12)


# -- closed loop ------------------------------------------------------------------------------


def test_recorded_torque_is_the_inverse_dynamics_of_the_motion(robot_session):
    robot, motion, _, session = robot_session
    t = np.linspace(0.0, motion.duration, 300)
    q, v, a = session.motion.motor_motion(t)
    expected = (
        robot.dynamics().inverse_dynamics(q, v, a)
        + robot.actuators.inertia * a
        + robot.actuators.friction_torque(v)
    )
    assert np.abs(session.motion.torque(t) - expected).max() < 1e-10
    h = 1e-5
    after, before = (
        session.motion.motor_motion(t[1:-1] + h)[0],
        session.motion.motor_motion(t[1:-1] - h)[0],
    )
    np.testing.assert_allclose((after - before) / (2 * h), v[1:-1], atol=1e-6)


def total_energy(
    dynamics: mujoco_dynamics.RigidBodyDynamics, q: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Return kinetic plus potential energy. Shapes (N, n) to (N,) [J]."""
    import mujoco

    model, data, out = dynamics.model, dynamics.data, np.empty(len(q))
    for k in range(len(q)):
        mass, _ = dynamics.mass_and_bias(q[k], v[k])
        mujoco.mj_energyPos(model, data)
        out[k] = 0.5 * v[k] @ mass @ v[k] + data.energy[0]
    return out


def test_actuator_work_equals_energy_plus_friction_loss(robot_session):
    robot, motion, _, session = robot_session
    t = np.linspace(0.0, motion.duration, 12001)
    q, v, _ = session.motion.motor_motion(t)
    arm, drive = robot.dynamics(), robot.actuators
    energy = total_energy(arm, q, v) + 0.5 * np.square(v) @ drive.inertia
    work = np.concatenate(
        [
            [0.0],
            np.cumsum(
                np.diff(t) * 0.5 * ((p := (session.motion.torque(t) * v).sum(axis=1))[1:] + p[:-1])
            ),
        ]
    )
    loss = np.concatenate(
        [
            [0.0],
            np.cumsum(
                np.diff(t) * 0.5 * ((p := (drive.friction_torque(v) * v).sum(axis=1))[1:] + p[:-1])
            ),
        ]
    )
    assert np.ptp(energy) > 1.0
    assert np.abs(work - loss - (energy - energy[0])).max() < 1e-3 * np.ptp(energy)


def test_undamped_two_mass_joint_conserves_energy(robot_session):
    """A deflected elastic joint oscillates with no friction, controller or damping."""
    from excite.simulator.closed_loop import ClosedLoop
    from excite.simulator.effects.transmission import HardeningSpring

    robot, *_ = robot_session
    zero = np.zeros(2)
    frictionless = replace(robot.actuators, viscous=zero, coulomb=zero, offset=zero)
    spring = HardeningSpring(effect_instance.effect_site(robot, "joint_2"), 500.0)
    spring.__dict__["damping"] = 0.0
    no_control = ControllerGains(position=0.0, speed=0.0, integral=0.0, forward=0.0)
    loop = ClosedLoop(
        mujoco_dynamics.build_dynamics(robot.tree, robot.joints, gravity=(0.0, 0.0, 0.0)),
        frictionless,
        no_control,
        (spring,),
        None,
        robot.torque_limit,
        1e-3,
    )
    loop.initialise(np.array([0.3, 0.5]))
    loop.motor_torque, loop.theta[1] = zero, loop.theta[1] + 0.05
    energies = []
    for step in range(400):
        deflection = loop.theta[1] - loop.q[1]
        elastic = 500.0 * (
            deflection**2 / 2 + deflection**4 / 4 * (500.0 / (2 * robot.torque_limit[1])) ** 2
        )
        kinetic = (
            total_energy(loop.dynamics, loop.q[None], loop.v[None])[0]
            + 0.5 * frictionless.inertia[0] * loop.v[0] ** 2
            + 0.5 * frictionless.inertia[1] * loop.omega[1] ** 2
        )
        energies.append(elastic + kinetic)
        loop.advance(step * 1e-3)
    assert max(energies) < 1.02 * energies[0]
    assert min(energies) > 0.5 * energies[0]


def test_tracking_error_grows_with_lower_gains(robot_session):
    robot, motion, _, session = robot_session
    error = np.abs(session.recording.q - session.recording.qref).max()
    soft = replace(robot, gains=ControllerGains(position=8.0, speed=60.0, forward=0.3)).follow(
        motion
    )
    softer = np.abs(soft.measured(session.recording.t)[0] - session.recording.qref).max()
    assert 1e-5 < error < 5e-3 < softer < 0.3


def test_smaller_time_steps_change_little(robot_session):
    robot, motion, _, session = robot_session
    fine = replace(robot, step=2.5e-4).follow(motion)
    t = session.recording.t
    assert np.abs(fine.motor_motion(t)[0] - session.motion.motor_motion(t)[0]).max() < 2e-4


def test_transmitted_torque_follows_the_spring_characteristic(robot_session):
    robot, motion, *_ = robot_session
    chosen = robot_with(robot, "elasticity:joint_2:stiffness=2000")
    simulated, t = chosen.follow(motion), np.linspace(0.6, motion.duration - 0.6, 400)
    spring, load = (
        simulated.robot.effects[0].transmission_spring(),
        simulated.joint_states(t).load[:, 1],
    )
    link, motor = simulated.link_motion(t), simulated.motor_motion(t)
    expected = [
        spring.torque_and_slopes(d, rate)[0]
        for d, rate in zip(
            motor[0][:, 1] - link[0][:, 1], motor[1][:, 1] - link[1][:, 1], strict=True
        )
    ]
    assert np.sqrt(np.mean(np.square(expected - load))) < 0.08 * np.std(load)


def test_link_stays_within_its_backlash_gap(robot_session):
    """Integrating speeds at whole steps once let a wrist drift 46 mrad out of a gap of 1 mrad."""
    robot, motion, *_ = robot_session
    chosen = robot_with(replace(robot, step=2e-3), "backlash:joint_2:width=0.001")
    simulated, t = chosen.follow(motion), np.linspace(0.0, motion.duration, 4001)
    deflection = simulated.motor_motion(t)[0][:, 1] - simulated.link_motion(t)[0][:, 1]
    spring, load = (
        simulated.robot.effects[0].transmission_spring(),
        simulated.joint_states(t).load[:, 1],
    )
    carried = [spring.torque_and_slopes(d, 0.0)[0] for d in deflection]
    assert (
        np.abs(deflection).max() < 0.5e-3 + 1e-3
    )  # half the gap, and the elastic deflection at twice the largest torque
    assert np.ptp(deflection) > 0.9e-3  # both gap boundaries are in contact
    assert np.sqrt(np.mean(np.square(carried - load))) < 0.1 * np.std(load)


def test_hidden_torque_of_backlash_does_not_depend_on_the_time_step(robot_session):
    robot, motion, *_ = robot_session
    t = np.arange(0.6, motion.duration - 0.6, 2e-3)
    low_pass = signal.butter(4, 20.0, fs=500.0, output="sos")
    hidden = []
    for step in (2e-3, 1.25e-4):
        simulated = robot_with(replace(robot, step=step), "backlash:joint_2:width=0.001").follow(
            motion
        )
        hidden.append(
            signal.sosfiltfilt(low_pass, severity.hidden_torque(simulated, robot, t).torque[:, 1])
        )
    assert np.std(hidden[0] - hidden[1]) < 0.2 * np.std(hidden[1])


def test_severity_does_not_alias_fast_oscillations_of_backlash(robot_session, monkeypatch):
    """Sampled at 200 Hz, backlash seemed to have eight times its torque below 20 Hz."""
    robot, motion, _, session = robot_session
    simulated = robot_with(robot, "backlash:joint_2:width=0.0002").follow(motion)
    coarse = severity.evaluate_severity(simulated, robot, motion, session.chain).joints
    monkeypatch.setattr(severity, "ELASTIC_RATE", 8000.0)
    finer = severity.evaluate_severity(simulated, robot, motion, session.chain).joints
    assert np.abs(np.log(coarse / finer)).max() < np.log(2.0)


def test_base_moves_as_its_suspension_allows(robot_session):
    robot, motion, *_ = robot_session
    simulated = robot_with(robot, "base_compliance::frequency=8").follow(motion)
    t = np.linspace(0.5, motion.duration - 0.5, 300)
    q, v, a = simulated.link_motion(t)
    torque = simulated.dynamics.inverse_dynamics(q, v, a)[:, :2]
    suspension = simulated.robot.effects[0].base_suspension()
    expected = -suspension.stiffness * q[:, :2] - suspension.damping * v[:, :2]
    assert np.abs(q[:, :2]).max() > 1e-4
    assert np.sqrt(np.mean(np.square(torque - expected))) < 0.05 * np.std(torque)


# -- effects --------------------------------------------------------------------------------------


def test_every_effect_of_the_contract_exists_in_both_families():
    assert set(CATALOGUE_NAMES) == set(EFFECT_NAMES)
    for name, kind in EFFECT_TYPES.items():
        families = set(FORM_FAMILIES) & set(kind.forms)
        assert len(families) == len(kind.forms) == (1 if kind.out_of_catalogue else 2), name


@pytest.mark.parametrize("name", list(EFFECT_TYPES))
def test_effect_of_zero_size_changes_nothing_and_usual_size_does(short_session, name):
    robot, motion, setting, bare = short_session
    effect_type, csv = EFFECT_TYPES[name], bare.recording.to_csv()
    place = (
        ""
        if effect_type.place == "robot"
        else "joint_1"
        if name == "kinematic_error"
        else "joint_2"
    )
    extra = ",start=0.3,end=0.9" if name == "contact" else ""
    for family in effect_type.forms:
        effect = effect_instance.parse_effect(f"{name}:{place}:form={family}{extra}", robot)
        zero_size = experiment.run_session(
            effect_instance.with_effects(robot, (effect.scaled(0.0),)), motion, setting
        )
        assert zero_size.recording.to_csv() == csv
        simulated = effect_instance.with_effects(robot, (effect,)).follow(motion)
        measured = simulated.measured(bare.recording.t)
        before = bare.motion.measured(bare.recording.t)
        threshold = 1e-6 * robot.torque_limit
        assert (np.abs(measured[1] - before[1]) > threshold).any()
        assert np.isfinite(measured[1]).all()


def test_kinematic_error_displaces_the_following_joint(short_session):
    robot, *_ = short_session
    effect = effect_instance.parse_effect("kinematic_error:joint_1:angle=0,length=0.01", robot)
    altered = effect.physics(robot).modify_tree(robot.tree)
    for name, apart in (("joint_1", 0.0), ("joint_2", 0.01)):
        at = [
            np.array(str(tree.joint_element(name).find("origin").get("xyz")).split(), float)
            for tree in (altered, robot.tree)
        ]
        assert np.linalg.norm(at[0] - at[1]) == pytest.approx(apart)


def test_model_forms_of_the_two_families_differ(robot_session):
    robot, motion, *_ = robot_session
    t = np.linspace(0.6, motion.duration - 0.6, 200)
    x = robot.follow(motion).joint_states(t)
    for name in (
        "stribeck",
        "drag",
        "load_friction",
        "spring",
        "torque_ripple",
        "position_friction",
    ):
        tuning, scored = (
            effect_instance.parse_effect(f"{name}:joint_2:form={family}", robot)
            .physics(robot)
            .torque(x, np.zeros((200, 0)))
            for family in FORM_FAMILIES
        )
        assert np.std(tuning - scored) > 0.03 * np.std(tuning)


@pytest.mark.parametrize("form", FORM_FAMILIES)
def test_hysteresis_has_memory_and_dissipates(robot_session, form):
    robot, *_ = robot_session
    effect = effect_instance.parse_effect(
        f"hysteresis:joint_2:amplitude=1,stiffness=500,form={form}", robot
    ).physics(robot)
    t = np.arange(4000) * 1e-3
    q, v = 0.02 * np.sin(2 * np.pi * t), 0.02 * 2 * np.pi * np.cos(2 * np.pi * t)
    z, torque = np.zeros(effect.state_size), []
    for speed in v:
        x = JointStates(
            np.asarray(0.0), np.zeros(2), np.array([0.0, speed]), np.zeros(2), np.zeros(2)
        )
        z = effect.advance_state(x, z, 1e-3)
        torque.append(effect.torque(x, z)[1])
    torque = np.array(torque)
    assert 0.8 < np.abs(torque).max() <= 1.0 + 1e-9
    assert (torque * v)[2000:].sum() * 1e-3 > 0.03  # J over two cycles
    assert torque[0] == pytest.approx(500.0 * q[1], rel=0.1)


def test_severity_is_zero_where_a_refit_absorbs_the_effect(robot_session):
    robot, motion, setting, bare = robot_session
    chain = experiment.measurement_chain(robot, setting)
    assert severity.evaluate_severity(bare.motion, robot, motion, chain).value < 1e-6
    run = robot_with(robot, "payload:joint_2:mass=1").follow(motion)
    assert severity.evaluate_severity(run, robot, motion, chain, trusted=True).value > 3.0
    assert severity.evaluate_severity(run, robot, motion, chain).value < 1e-6
    effect = effect_instance.parse_effect("position_friction:joint_2", robot)
    _, _, reached = severity.scale_to_severity(effect, 3.0, robot, motion, chain)
    assert reached.value == pytest.approx(3.0, rel=0.16)


def test_scaling_respects_physical_bounds(robot_session):
    robot, motion, setting, _ = robot_session
    chain = experiment.measurement_chain(robot, setting)
    viscous, coulomb = (float(getattr(robot.actuators, kind)[1]) for kind in ("viscous", "coulomb"))
    for text, key, largest in (
        ("thermal_drift:joint_2:change=-0.5", "change", 0.9),
        ("load_friction:joint_2:mu=0.3", "mu", 0.6),
        ("asymmetric_viscous:joint_2", "negative", viscous),
        ("position_friction:joint_2", "amplitude", coulomb),
    ):
        effect = effect_instance.parse_effect(text, robot)
        assert effect.largest_scale(robot) == pytest.approx(largest / abs(effect.values[key]))
        reached = severity.scale_to_severity(effect, 1e3, robot, motion, chain)[0]
        assert 0.0 < abs(reached.values[key]) <= largest + 1e-12
    assert effect_instance.parse_effect("spring:joint_2", robot).largest_scale(robot) == np.inf


def test_unstable_loop_is_reported(robot_session):
    robot, motion, *_ = robot_session
    with pytest.raises(UnusableInput, match="smaller"):
        robot_with(robot, "coupling:joint_2:inertia=50").follow(motion)


class UnstableSpring(PhysicalEffect):
    """A spring with negative stiffness that grows without bound."""

    def transmission_spring(self) -> TransmissionSpring:
        return TransmissionSpring(1, lambda d, rate: (-1e9 * (d + 1e-3) ** 3, 0.0, 0.0))


def test_overflowing_loop_is_reported(robot_session):
    robot, motion, *_ = robot_session
    with pytest.raises(UnusableInput, match="smaller"):
        replace(robot, effects=(UnstableSpring(),)).follow(motion)
