"""The simulated robot against Pinocchio, against itself, and against the arithmetic of energy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from contract import EFFECT_NAMES
from scipy import signal

pytest.importorskip("mujoco")

from excite.errors import UnusableInput
from excite.robot.robot import locate
from excite.simulator import effect_instance as effects
from excite.simulator import experiment, reference_trajectory, regressor, severity
from excite.simulator import mujoco_dynamics as arms
from excite.simulator import urdf_tree as trees
from excite.simulator.actuator import ControllerGains
from excite.simulator.effects import CATALOGUE_NAMES, EFFECT_TYPES, FORM_FAMILIES
from excite.simulator.experiment import ExperimentSettings
from excite.simulator.model_error import perturb_bodies
from excite.simulator.physical_effect import PhysicalEffect, TransmissionSpring
from excite.simulator.recording_file import inertial_vector
from excite.simulator.reference_trajectory import ReferenceTrajectory

MODELS, TRAJECTORIES = (
    locate("two_link").parent,
    Path(__file__).parents[1] / "trajectories",
)


def urdf(name: str) -> Path:
    return MODELS / f"{name}.urdf"


def swing(seconds: float = 2.0, seed: int = 0, n: int = 2) -> ReferenceTrajectory:
    """A quick motion of two_link, or of n joints like it."""
    rng = np.random.default_rng(seed)
    sine, cosine = 1.2 * rng.standard_normal((2, n, 3))
    return reference_trajectory.blended_fourier(
        trees.read_urdf(urdf("two_link")).joints,
        sine,
        cosine,
        np.array([-1.4, 0.6]),
        seconds - 0.6,
        1,
        0.3,
    )


@pytest.fixture(scope="module")
def bench():
    motion, setting = swing(), ExperimentSettings(seed=3)
    plant = experiment.build_robot(urdf("two_link"), motion, setting)
    return plant, motion, setting, experiment.run_session(plant, motion, setting)


@pytest.fixture(scope="module")
def quick():
    """The same, shorter and in coarser steps: enough to see whether two runs are equal."""
    motion, setting = swing(1.2), ExperimentSettings(seed=3)
    plant = replace(experiment.build_robot(urdf("two_link"), motion, setting), step=2e-3)
    return plant, motion, setting, experiment.run_session(plant, motion, setting)


def hidden(plant, text: str):
    return effects.with_effects(plant, (effects.parse_effect(text, plant),))


# -- rigid bodies ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["two_link", "tx40", "ur10e", "panda", "iiwa14"])
def test_base_physics_agrees_with_pinocchio(name):
    rng = np.random.default_rng(1)
    tree = perturb_bodies(trees.read_urdf(urdf(name)), 0.05, rng)
    arm = arms.build_dynamics(tree, tree.joints)
    q, v, a = (
        rng.uniform(-2, 2, (20, arm.n)),
        rng.normal(size=(20, arm.n)),
        5 * rng.normal(size=(20, arm.n)),
    )
    model = pin.buildModelFromXML(tree.text)
    data = model.createData()
    assert tuple(model.names[1:]) == arm.joints
    expected = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])
    assert np.abs(arm.inverse_dynamics(q, v, a) - expected).max() < 1e-8
    for row in range(3):
        mass, bias = arm.mass_and_bias(q[row], v[row])
        assert np.abs(mass @ a[row] + bias - expected[row]).max() < 1e-8


def test_a_prismatic_joint_too_and_locked_ones():
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
    tree = trees.UrdfTree("text", trees.ElementTree.fromstring(text))
    whole, locked = (
        arms.build_dynamics(tree, tree.joints),
        arms.build_dynamics(tree, ("j1", "j2"), {"j3": 0.7}),
    )
    q, v, a = rng.normal(size=(3, 10, 2))
    wide = [np.column_stack([x, np.full(10, fill)]) for x, fill in ((q, 0.7), (v, 0.0), (a, 0.0))]
    np.testing.assert_allclose(
        locked.inverse_dynamics(q, v, a), whole.inverse_dynamics(*wide)[:, :2], atol=1e-10
    )
    y = regressor.rigid_body_regressor(whole, *wide)
    parameters = np.concatenate([inertial_vector(tree, name) for name in "abc"])
    np.testing.assert_allclose(y @ parameters, whole.inverse_dynamics(*wide), atol=1e-10)


@pytest.mark.parametrize("name", ["ur10e", "panda"])
def test_regressor_times_parameters_is_the_torque(name):
    rng = np.random.default_rng(3)
    tree = trees.read_urdf(urdf(name))
    arm = arms.build_dynamics(tree, tree.joints)
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


def test_wrong_bodies_are_bodies_and_differ_by_what_is_stated():
    tree = trees.read_urdf(urdf("ur10e"))
    other = perturb_bodies(tree, 0.05, np.random.default_rng(0))
    masses = []
    for link in tree.link_motion:
        assert np.linalg.eigvalsh(other.pseudo_inertia(link)).min() > 0.0
        masses.append(other.pseudo_inertia(link)[3, 3] / tree.pseudo_inertia(link)[3, 3] - 1.0)
    assert 0.01 < np.std(masses) < 0.12
    assert perturb_bodies(tree, 0.0, np.random.default_rng(0)).pseudo_inertia(
        "forearm_link"
    ) == pytest.approx(tree.pseudo_inertia("forearm_link"), rel=1e-12)


# -- the loop --------------------------------------------------------------------------------------


def test_recorded_torque_is_what_the_motion_needs(bench):
    plant, motion, _, session = bench
    t = np.linspace(0.0, motion.duration, 300)
    q, v, a = session.motion.motor_motion(t)
    expected = (
        plant.dynamics().inverse_dynamics(q, v, a)
        + plant.actuators.inertia * a
        + plant.actuators.friction_torque(v)
    )
    assert np.abs(session.motion.torque(t) - expected).max() < 1e-10
    h = 1e-5
    after, before = (
        session.motion.motor_motion(t[1:-1] + h)[0],
        session.motion.motor_motion(t[1:-1] - h)[0],
    )
    np.testing.assert_allclose((after - before) / (2 * h), v[1:-1], atol=1e-6)


def test_work_is_energy_plus_loss(bench):
    plant, motion, _, session = bench
    t = np.linspace(0.0, motion.duration, 12001)
    q, v, _ = session.motion.motor_motion(t)
    arm, drive = plant.dynamics(), plant.actuators
    energy = arm.total_energy(q, v) + 0.5 * np.square(v) @ drive.inertia
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


def test_two_masses_without_drive_keep_their_energy(bench):
    """Let a wound-up elastic joint swing with no friction, no controller and no damping: only the scheme's own loss is left."""
    from excite.simulator.closed_loop import ClosedLoop
    from excite.simulator.effects.transmission import HardeningSpring

    plant, *_ = bench
    zero = np.zeros(2)
    drive = replace(plant.actuators, viscous=zero, coulomb=zero, offset=zero)
    law = HardeningSpring(effects.effect_site(plant, "joint_2"), 500.0)
    law.__dict__["damping"] = 0.0
    off = ControllerGains(position=0.0, speed=0.0, integral=0.0, forward=0.0)
    loop = ClosedLoop(
        arms.build_dynamics(plant.tree, plant.joints, gravity=(0.0, 0.0, 0.0)),
        drive,
        off,
        (law,),
        None,
        plant.torque_limit,
        1e-3,
    )
    loop._begin(np.array([0.3, 0.5]))
    loop.u, loop.theta[1] = zero, loop.theta[1] + 0.05
    energies = []
    for step in range(400):
        wind = loop.theta[1] - loop.q[1]
        spring = 500.0 * (wind**2 / 2 + wind**4 / 4 * (500.0 / (2 * plant.torque_limit[1])) ** 2)
        kinetic = (
            loop.dynamics.total_energy(loop.q[None], loop.v[None])[0]
            + 0.5 * drive.inertia[0] * loop.v[0] ** 2
            + 0.5 * drive.inertia[1] * loop.omega[1] ** 2
        )
        energies.append(spring + kinetic)
        loop._advance(step * 1e-3)
    assert max(energies) < 1.02 * energies[0]
    assert min(energies) > 0.5 * energies[0]


def test_the_loop_tracks_with_an_error_that_softer_gains_make_larger(bench):
    plant, motion, _, session = bench
    error = np.abs(session.recording.q - session.recording.qref).max()
    soft = replace(plant, gains=ControllerGains(position=8.0, speed=60.0, forward=0.3)).follow(
        motion
    )
    softer = np.abs(soft.measured(session.recording.t)[0] - session.recording.qref).max()
    assert 1e-5 < error < 5e-3 < softer < 0.3


def test_finer_steps_change_little(bench):
    plant, motion, _, session = bench
    fine = replace(plant, step=2.5e-4).follow(motion)
    t = session.recording.t
    assert np.abs(fine.motor_motion(t)[0] - session.motion.motor_motion(t)[0]).max() < 2e-4


def test_a_spring_passes_on_what_its_law_says(bench):
    plant, motion, *_ = bench
    chosen = hidden(plant, "elasticity:joint_2:stiffness=2000")
    run, t = chosen.follow(motion), np.linspace(0.6, motion.duration - 0.6, 400)
    law, load = run.robot.effects[0].transmission_spring(), run.joint_states(t).load[:, 1]
    link, motor = run.link_motion(t), run.motor_motion(t)
    pulled = [
        law.torque_and_slopes(d, rate)[0]
        for d, rate in zip(
            motor[0][:, 1] - link[0][:, 1], motor[1][:, 1] - link[1][:, 1], strict=True
        )
    ]
    assert np.sqrt(np.mean(np.square(pulled - load))) < 0.08 * np.std(load)


def test_a_link_stays_in_its_play(bench):
    """Speeds at whole steps do not tell where teeth knock a link between them: integrated, a wrist left its play of 1 mrad by 46."""
    plant, motion, *_ = bench
    chosen = hidden(replace(plant, step=2e-3), "backlash:joint_2:width=0.001")
    run, t = chosen.follow(motion), np.linspace(0.0, motion.duration, 4001)
    wind = run.motor_motion(t)[0][:, 1] - run.link_motion(t)[0][:, 1]
    law, load = run.robot.effects[0].transmission_spring(), run.joint_states(t).load[:, 1]
    carried = [law.torque_and_slopes(d, 0.0)[0] for d in wind]
    assert (
        np.abs(wind).max() < 0.5e-3 + 1e-3
    )  # the play, and how far teeth give way to twice the joint's largest torque
    assert np.ptp(wind) > 0.9e-3  # both flanks carry
    assert np.sqrt(np.mean(np.square(carried - load))) < 0.1 * np.std(load)


def test_teeth_hide_the_same_whatever_the_step(bench):
    plant, motion, *_ = bench
    t = np.arange(0.6, motion.duration - 0.6, 2e-3)
    low = signal.butter(4, 20.0, fs=500.0, output="sos")
    left = []
    for step in (2e-3, 1.25e-4):
        run = hidden(replace(plant, step=step), "backlash:joint_2:width=0.001").follow(motion)
        left.append(signal.sosfiltfilt(low, severity.hidden_torque(run, plant, t).torque[:, 1]))
    assert np.std(left[0] - left[1]) < 0.2 * np.std(left[1])


def test_what_swings_fast_does_not_pass_for_slow(bench, monkeypatch):
    """Looked at 200 times a second, teeth that knock at hundreds of Hz seemed to be eight times as loud below 20 Hz."""
    plant, motion, _, session = bench
    run = hidden(plant, "backlash:joint_2:width=0.0002").follow(motion)
    told = severity.evaluate_severity(run, plant, motion, session.chain).joints
    monkeypatch.setattr(severity, "RATTLING", 8000.0)
    finer = severity.evaluate_severity(run, plant, motion, session.chain).joints
    assert np.abs(np.log(told / finer)).max() < np.log(2.0)


def test_a_base_moves_as_its_springs_let_it(bench):
    plant, motion, *_ = bench
    run = hidden(plant, "base_compliance::frequency=8").follow(motion)
    t = np.linspace(0.5, motion.duration - 0.5, 300)
    q, v, a = run.link_motion(t)
    own = run.dynamics.inverse_dynamics(q, v, a)[:, :2]
    law = run.robot.effects[0].base_suspension()
    carried = -law.stiffness * q[:, :2] - law.damping * v[:, :2]
    assert np.abs(q[:, :2]).max() > 1e-4
    assert np.sqrt(np.mean(np.square(own - carried))) < 0.05 * np.std(own)


# -- effects ---------------------------------------------------------------------------------------


def test_every_name_of_the_contract_is_there():
    assert set(CATALOGUE_NAMES) == set(EFFECT_NAMES)
    assert all(set(kind.forms) == set(FORM_FAMILIES) for kind in EFFECT_TYPES.values())


@pytest.mark.parametrize("name", list(EFFECT_TYPES))
def test_an_effect_of_size_zero_changes_nothing_and_one_of_its_usual_size_does(quick, name):
    plant, motion, setting, bare = quick
    kind, csv = EFFECT_TYPES[name], bare.recording.to_csv()
    place = "" if kind.place == "robot" else "joint_1" if name == "kinematic_error" else "joint_2"
    extra = ",start=0.3,end=0.9" if name == "contact" else ""
    for family in FORM_FAMILIES:
        effect = effects.parse_effect(f"{name}:{place}:form={family}{extra}", plant)
        nothing = experiment.run_session(
            effects.with_effects(plant, (effect.scaled(0.0),)), motion, setting
        )
        assert nothing.recording.to_csv() == csv
        run = effects.with_effects(plant, (effect,)).follow(motion)
        told = run.measured(bare.recording.t)
        before = bare.motion.measured(bare.recording.t)
        least = 1e-6 * plant.torque_limit
        assert (np.abs(told[1] - before[1]) > least).any()
        assert np.isfinite(told[1]).all()


def test_a_wrong_length_is_of_the_joint_before_it(quick):
    plant, *_ = quick
    effect = effects.parse_effect("kinematic_error:joint_1:angle=0,length=0.01", plant)
    altered = effect.physics(plant).modify_tree(plant.tree)
    for name, apart in (("joint_1", 0.0), ("joint_2", 0.01)):
        at = [
            np.array(str(tree.joint_element(name).find("origin").get("xyz")).split(), float)
            for tree in (altered, plant.tree)
        ]
        assert np.linalg.norm(at[0] - at[1]) == pytest.approx(apart)


def test_forms_of_the_two_families_differ(bench):
    plant, motion, *_ = bench
    t = np.linspace(0.6, motion.duration - 0.6, 200)
    x = plant.follow(motion).joint_states(t)
    for name in (
        "stribeck",
        "drag",
        "load_friction",
        "spring",
        "torque_ripple",
        "position_friction",
    ):
        one, other = (
            effects.parse_effect(f"{name}:joint_2:form={family}", plant)
            .physics(plant)
            .torque(x, np.zeros((200, 0)))
            for family in FORM_FAMILIES
        )
        assert np.std(one - other) > 0.03 * np.std(one)


@pytest.mark.parametrize("form", FORM_FAMILIES)
def test_hysteresis_remembers_and_dissipates(bench, form):
    plant, *_ = bench
    law = effects.parse_effect(
        f"hysteresis:joint_2:amplitude=1,stiffness=500,form={form}", plant
    ).physics(plant)
    t = np.arange(4000) * 1e-3
    q, v = 0.02 * np.sin(2 * np.pi * t), 0.02 * 2 * np.pi * np.cos(2 * np.pi * t)
    z, torque = np.zeros(law.state_size), []
    for speed in v:
        x = experiment.plants.Instant(
            np.asarray(0.0), np.zeros(2), np.array([0.0, speed]), np.zeros(2), np.zeros(2)
        )
        z = law.advance_state(x, z, 1e-3)
        torque.append(law.torque(x, z)[1])
    torque = np.array(torque)
    assert 0.8 < np.abs(torque).max() <= 1.0 + 1e-9
    assert (torque * v)[2000:].sum() * 1e-3 > 0.03  # J over two cycles
    assert torque[0] == pytest.approx(500.0 * q[1], rel=0.1)


def test_severity_is_zero_for_what_a_refit_absorbs_and_scales(bench):
    plant, motion, setting, bare = bench
    chain = experiment.measurement_chain(plant, setting)
    assert severity.evaluate_severity(bare.motion, plant, motion, chain).value < 1e-6
    run = hidden(plant, "payload:joint_2:mass=1").follow(motion)
    assert severity.evaluate_severity(run, plant, motion, chain, trusted=True).value > 3.0
    assert severity.evaluate_severity(run, plant, motion, chain).value < 1e-6
    effect = effects.parse_effect("position_friction:joint_2", plant)
    _, _, reached = severity.scale_to_severity(effect, 3.0, plant, motion, chain)
    assert reached.value == pytest.approx(3.0, rel=0.16)


def test_no_severity_goes_beyond_what_physics_allows(bench):
    plant, motion, setting, _ = bench
    chain = experiment.measurement_chain(plant, setting)
    viscous, coulomb = (float(getattr(plant.actuators, kind)[1]) for kind in ("viscous", "coulomb"))
    for text, key, most in (
        ("thermal_drift:joint_2:change=-0.5", "change", 0.9),
        ("load_friction:joint_2:mu=0.3", "mu", 0.6),
        ("asymmetric_viscous:joint_2", "negative", viscous),
        ("position_friction:joint_2", "amplitude", coulomb),
    ):
        effect = effects.parse_effect(text, plant)
        assert effect.largest_scale(plant) == pytest.approx(most / abs(effect.values[key]))
        reached = severity.scale_to_severity(effect, 1e3, plant, motion, chain)[0]
        assert 0.0 < abs(reached.values[key]) <= most + 1e-12
    assert effects.parse_effect("spring:joint_2", plant).largest_scale(plant) == np.inf


def test_a_robot_that_is_lost_is_said_to_be(bench):
    plant, motion, *_ = bench
    with pytest.raises(UnusableInput, match="smaller"):
        hidden(plant, "coupling:joint_2:inertia=50").follow(motion)


class Runaway(PhysicalEffect):
    """A spring that pushes the further it is wound, until no number holds it."""

    def transmission_spring(self) -> TransmissionSpring:
        return TransmissionSpring(1, lambda d, rate: (-1e9 * (d + 1e-3) ** 3, 0.0, 0.0))


def test_so_is_one_that_no_number_holds(bench):
    plant, motion, *_ = bench
    with pytest.raises(UnusableInput, match="smaller"):
        replace(plant, effects=(Runaway(),)).follow(motion)
