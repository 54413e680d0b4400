"""Motions in single and double support: derivatives, forces, certificate, files."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from excite.api.support_design_result import SUPPORT_FILES
from excite.api.support_design_result import design_support as design_files
from excite.cli.main import main
from excite.designer import support_certificate
from excite.designer.criteria import Criterion
from excite.designer.support_certificate import SupportConstraints
from excite.designer.support_design import SupportOptions, SupportSearch, design_support
from excite.designer.support_evaluator import SupportEvaluator
from excite.designer.support_kinematics import support_samples
from excite.designer.support_model import BASE_COORDINATES
from excite.designer.support_problem import sample_times
from excite.designer.support_stance import ContactLimits, SoleSize, leg_of, standing
from excite.errors import Infeasible, UnusableInput
from excite.robot import floating_base, limits
from excite.robot.floating_base import Rows

SOLE = SoleSize(0.1, 0.06, (0.01, 0.0))
LEG = (
    ("hip_yaw", "0 0 1", (-0.6, 0.6), "0 0 -0.05", 1.0),
    ("hip_roll", "1 0 0", (-0.5, 0.5), "0 0 0", 1.2),
    ("hip_pitch", "0 1 0", (-2.0, 0.7), "0 0 0", 4.0),
    ("knee", "0 1 0", (0.0, 2.4), "0 0 -0.38", 3.0),
    ("ankle_pitch", "0 1 0", (-1.3, 0.8), "0 0 -0.33", 0.8),
    ("ankle_roll", "1 0 0", (-0.5, 0.5), "0 0 0", 1.1),
)
"""Joint, axis, range [rad], origin [m] and mass [kg] of the links of a leg."""


def _link(name: str, mass: float, height: float = -0.1) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.01 0.005 {height}"/><mass value="{mass}"/>'
        f'<inertia ixx="{0.01 * mass}" ixy="0.0002" ixz="0.0001" iyy="{0.012 * mass}" iyz="0" '
        f'izz="{0.006 * mass}"/></inertial></link>'
    )


def _joint(name: str, parent: str, origin: str, axis: str, span: tuple[float, float]) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{name}_link"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
        f'<limit lower="{span[0]}" upper="{span[1]}" velocity="5" effort="150"/>'
        '<dynamics damping="0.2" friction="0.5"/></joint>'
    )


def walker_urdf() -> str:
    """Return a biped with legs of six joints and a torso with one arm."""
    parts = ['<robot name="walker">', _link("pelvis", 9.0, 0.05)]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        parent = "pelvis"
        for number, (name, axis, span, origin, mass) in enumerate(LEG):
            place = f"0 {0.09 * sign} -0.08" if number == 0 else origin
            parts += [
                _joint(f"{side}_{name}", parent, place, axis, span),
                _link(f"{side}_{name}_link", mass),
            ]
            parent = f"{side}_{name}_link"
        parts.append(
            f'<link name="{side}_sole"/><joint name="{side}_sole_joint" type="fixed">'
            f'<parent link="{parent}"/><child link="{side}_sole"/><origin xyz="0 0 -0.09"/></joint>'
        )
    parts += [
        _joint("torso", "pelvis", "0 0 0.15", "0 0 1", (-1.0, 1.0)),
        _link("torso_link", 14.0, 0.2),
        _joint("arm", "torso_link", "0 0.2 0.4", "0 1 0", (-1.5, 1.5)),
        _link("arm_link", 3.0, -0.25),
        "</robot>",
    ]
    return "".join(parts)


@pytest.fixture(scope="module")
def walker(tmp_path_factory):
    path = tmp_path_factory.mktemp("walker") / "walker.urdf"
    path.write_text(walker_urdf())
    return floating_base.load(path)


@pytest.fixture(scope="module")
def walker_limits(walker):
    return limits.resolve(walker.joint_robot)


def options(*frames: str, **changes) -> SupportOptions:
    values = {
        "frames": frames,
        "soles": (SOLE,) * len(frames),
        "duration": 2.0,
        "harmonics": 3,
        "starts": 2,
        "iterations": 12,
        "wrench_noise": (0.5, 1.5),
    }
    return SupportOptions(**{**values, **changes})


def search(walker, table, *frames: str) -> SupportSearch:
    chosen = options(*frames)
    stance = standing(walker.joint_robot, table.reduced(), frames, chosen.soles, chosen.contact)
    return SupportSearch(walker, table, chosen, stance)


@pytest.fixture(scope="module")
def double(walker, walker_limits):
    return search(walker, walker_limits, "left_sole", "right_sole")


@pytest.fixture(scope="module")
def single(walker, walker_limits):
    return search(walker, walker_limits, "right_sole")


@pytest.fixture(params=["double", "single"])
def evaluated(request):
    searched = request.getfixturevalue(request.param)
    evaluator = SupportEvaluator(searched.problem(0.0, 0.0))
    x = 0.1 * np.random.default_rng(3).normal(size=evaluator.problem.size)
    assert np.isfinite(evaluator.max_constraint_value(x))
    return searched, evaluator, x


def test_the_standing_pose_puts_the_soles_on_the_ground_under_the_centre_of_mass(walker, double):
    stance, model, data = double.stance, walker.model, walker.model.createData()
    assert stance.base[2] > 0.7
    q = np.concatenate([stance.base[:3], [0.0, 0.0, 0.0, 1.0], stance.pose])
    pin.framesForwardKinematics(model, data, q)
    for foot in stance.feet:
        pose = data.oMf[model.getFrameId(foot.frame)]
        np.testing.assert_allclose(pose.rotation, np.eye(3), atol=1e-9)
        centre = pose.act(np.array([0.01, 0.0, 0.0]))
        np.testing.assert_allclose(centre, foot.in_world.translation, atol=1e-9)
        assert abs(centre[2]) < 1e-9
    com = pin.centerOfMass(model, data, q)
    middle = np.mean([foot.in_world.translation for foot in stance.feet], axis=0)
    np.testing.assert_allclose(com[:2], middle[:2], atol=1e-4)


@pytest.mark.parametrize("criterion", [Criterion.A, Criterion.D])
def test_the_gradient_of_the_objective_is_exact(evaluated, criterion):
    _, evaluator, x = evaluated
    chosen = dataclasses.replace(evaluator.problem.options, criterion=criterion)
    evaluator = SupportEvaluator(dataclasses.replace(evaluator.problem, options=chosen))
    direction = np.random.default_rng(4).normal(size=len(x))
    _, gradient = evaluator.objective(x, 1.0)
    step = 1e-5
    change = (
        evaluator.objective(x + step * direction, 1.0)[0]
        - evaluator.objective(x - step * direction, 1.0)[0]
    )
    assert change / (2.0 * step) == pytest.approx(gradient @ direction, rel=1e-5)


def test_the_gradients_of_all_constraints_are_exact(evaluated):
    _, evaluator, x = evaluated
    direction = np.random.default_rng(5).normal(size=len(x))
    count = sum(values.size for values in evaluator.constraint_values(x).values())
    rows = evaluator.rows(x, np.ones(count, bool))
    jacobian = evaluator.row_gradients(x, rows)
    step = 1e-6
    change = evaluator.row_values(x + step * direction, rows) - evaluator.row_values(
        x - step * direction, rows
    )
    np.testing.assert_allclose(change / (2.0 * step), jacobian @ direction, atol=2e-6)


def test_motion_and_forces_are_those_of_pinocchio(walker, walker_limits, evaluated):
    searched, evaluator, x = evaluated
    problem = evaluator.problem
    samples = support_samples(
        walker,
        searched.stance,
        searched.parameters,
        problem.motion(x),
        sample_times(problem.options),
    )
    q, dq, ddq = (array[:, BASE_COORDINATES:] for array in evaluator.motion(x))
    np.testing.assert_allclose(samples.motion.q, q, atol=1e-9)
    np.testing.assert_allclose(samples.joint_velocity, dq, atol=1e-9)
    np.testing.assert_allclose(samples.joint_acceleration, ddq, atol=1e-8)
    bound = walker_limits.reduced().torque - searched.parameters.coulomb()
    torque = evaluator.constraint_values(x)["torque"][0] * bound
    np.testing.assert_allclose(samples.torque, torque, atol=1e-7)


def test_wrenches_of_the_feet_and_torques_balance_the_equations_of_motion(walker, evaluated):
    searched, evaluator, x = evaluated
    motion = evaluator.problem.motion(x)
    samples = support_samples(
        walker, searched.stance, searched.parameters, motion, np.array([0.4, 0.9, 1.3])
    )
    model, data = walker.model, walker.model.createData()
    for i, coordinates in enumerate(walker.configurations(samples.motion)):
        pin.computeJointJacobians(model, data, coordinates)
        total = np.zeros(model.nv)
        for foot, wrench in zip(searched.stance.feet, samples.wrenches[i], strict=True):
            frame = model.getFrameId(foot.frame)
            pin.updateFramePlacement(model, data, frame)
            jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            local = pin.SE3(np.eye(3), np.array([0.01, 0.0, 0.0])).act(pin.Force(wrench))
            total += jacobian.T @ local.vector
            assert np.abs(jacobian @ samples.motion.velocity[i]).max() < 1e-9
        viscous = np.concatenate([np.zeros(6), 0.2 * samples.joint_velocity[i]])
        total[6:] += samples.torque[i]
        forces = pin.rnea(
            model, data, coordinates, samples.motion.velocity[i], samples.motion.acceleration[i]
        )
        np.testing.assert_allclose(total, forces + viscous, atol=1e-7)


def test_velocity_and_acceleration_are_derivatives_of_the_motion(walker, evaluated):
    searched, evaluator, x = evaluated
    motion, step = evaluator.problem.motion(x), 1e-4
    samples = support_samples(
        walker, searched.stance, searched.parameters, motion, 0.7 + step * np.arange(-1.0, 2.0)
    )
    q = walker.configurations(samples.motion)
    speed = pin.difference(walker.model, q[0], q[2]) / (2.0 * step)
    # the difference of poses is taken in the axes of the first of them, half a step earlier
    np.testing.assert_allclose(speed, samples.motion.velocity[1], atol=2e-4)
    rate = (samples.motion.velocity[2] - samples.motion.velocity[0]) / (2.0 * step)
    np.testing.assert_allclose(rate, samples.motion.acceleration[1], atol=1e-5)


@pytest.fixture(scope="module")
def designed(walker, walker_limits):
    return design_support(walker, walker_limits, options("left_sole", "right_sole", count=2))


def test_designed_motions_are_certified_and_inform(designed, walker, walker_limits):
    assert designed.certificate.ok
    constraints = SupportConstraints(walker, walker_limits, designed.stance, designed.parameters)
    again = support_certificate.certify(constraints, designed.motions)
    assert again.ok
    kinds = {margin.limit for margin in again.margins}
    assert {"position", "torque", "centre of pressure", "friction", "normal force"} <= kinds
    first, second = designed.identifiable_counts()
    assert 5 < first <= second == designed.analysis(Rows.BASE).identifiable_count
    assert designed.analysis(Rows.BOTH).identifiable_count > second


def test_the_centre_of_pressure_keeps_its_margin(designed, walker):
    t = np.linspace(0.0, 2.0, 401)
    for motion in designed.motions:
        samples = support_samples(walker, designed.stance, designed.parameters, motion, t)
        for wrench in np.moveaxis(samples.wrenches, 1, 0):
            assert wrench[:, 2].min() > 0.0
            assert np.abs(wrench[:, 4] / wrench[:, 2]).max() <= 0.1 - 0.02
            assert np.abs(wrench[:, 3] / wrench[:, 2]).max() <= 0.06 - 0.02


def test_a_motion_beyond_its_limits_is_not_certified(designed, walker, walker_limits):
    slow = dataclasses.replace(walker_limits, velocity=0.1 * walker_limits.velocity)
    constraints = SupportConstraints(walker, slow, designed.stance, designed.parameters)
    certificate = support_certificate.certify(constraints, designed.motions)
    assert not certificate.ok
    assert certificate.worst().limit == "velocity"


def test_the_files_replay_the_motions(walker, walker_limits, tmp_path):
    result = design_files(
        walker, options("right_sole", rate=50.0), limits=walker_limits, progress=lambda text: None
    )
    assert result.save(tmp_path)
    document = json.loads((tmp_path / "trajectory.json").read_text())
    assert document["schema"] == "excite.support_trajectory/1"
    assert [foot["frame"] for foot in document["support"]] == ["right_sole"]
    assert len(document["motions"]) == 1
    header, *lines = (tmp_path / "trajectory.csv").read_text().splitlines()
    columns, table = header.split(","), np.array([line.split(",") for line in lines], float)
    assert len(table) == 101
    assert {"base.x", "base.qw", "q.left_knee", "wrench.right_sole.mz"} <= set(columns)
    end_rates = table[[0, -1]][:, [name.startswith(("dq.", "ddq.")) for name in columns]]
    assert np.abs(end_rates).max() < 1e-9
    weight = 9.81 * walker.mass
    assert table[0, columns.index("wrench.right_sole.fz")] == pytest.approx(weight)


def test_a_leg_has_six_joints(walker, walker_limits):
    assert len(leg_of(walker.joint_robot, "left_sole")) == 6
    with pytest.raises(UnusableInput, match="a support leg has 6"):
        leg_of(walker.joint_robot, "arm_link")
    with pytest.raises(UnusableInput, match="two of different legs"):
        standing(
            walker.joint_robot, walker_limits, ("left_sole",) * 2, (SOLE,) * 2, ContactLimits()
        )


def test_a_margin_wider_than_the_sole_is_refused(walker, walker_limits):
    with pytest.raises(UnusableInput, match="--cop-margin"):
        standing(
            walker.joint_robot,
            walker_limits,
            ("left_sole",),
            (SOLE,),
            ContactLimits(margin=0.07),
        )


def test_a_stand_and_feet_do_not_go_together(walker, walker_limits):
    clamped = dataclasses.replace(walker_limits, stand=limits.Stand(force=1e3, source="s.toml"))
    with pytest.raises(UnusableInput, match="limits the load of a clamped base"):
        design_support(walker, clamped, options("left_sole"))


def test_jerk_limits_are_refused(walker, walker_limits):
    jerky = dataclasses.replace(walker_limits, jerk=np.full(walker.n, 1e3))
    with pytest.raises(UnusableInput, match="jerk limits are not supported with --support"):
        design_support(walker, jerky, options("left_sole"))


def test_mimic_joints_are_refused(tmp_path):
    text = walker_urdf().replace(
        '<child link="arm_link"/>', '<child link="arm_link"/><mimic joint="torso"/>'
    )
    path = tmp_path / "mimic.urdf"
    path.write_text(text)
    robot = floating_base.load(path)
    with pytest.raises(UnusableInput, match="mimic joints; lock torso with --lock"):
        design_support(robot, limits.resolve(robot.joint_robot), options("left_sole"))


def test_a_robot_too_weak_to_stand_is_infeasible(walker, walker_limits):
    weak = dataclasses.replace(walker_limits, torque=np.full(walker.n, 5.0))
    with pytest.raises(Infeasible, match="standing pose"):
        design_support(walker, weak, options("left_sole", "right_sole"))


def run(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def test_the_command_designs_a_motion_on_one_foot(walker, capsys, tmp_path):
    code, out, err = run(
        capsys,
        *("design", walker.source, "--floating", "--support", "left_sole", "--sole", "0.2,0.12"),
        *("--duration", 2, "--harmonics", 3, "--iterations", 4, "--starts", 1, "--json"),
        *("--wrench-noise", "0.5,1.5", "-o", tmp_path),
    )
    assert code == 0, err
    document = json.loads(out)
    assert {Path(name).name for name in document["files"]} == set(SUPPORT_FILES)
    assert all(margin["margin"] >= 0.0 for margin in document["margins"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--support", "left_sole"], "is for a robot with --floating; add it"),
        (["--floating"], "--support FRAME"),
        (["--floating", "--support", "left_sole"], "--sole"),
        (["--floating", "--support", "a,b,c", "--sole", "0.2,0.1"], "one or two frames"),
        (["--floating", "--support", "foot", "--sole", "0.2,0.1"], "no frame 'foot'"),
        (["--floating", "--support", "left_sole", "--sole", "0.2,0.1", "--plain"], "--plain"),
        (
            ["--floating", "--support", "left_sole", "--sole", "0.2,0.1", "--floor", "0"],
            "--floor: is not available",
        ),
        (
            ["--floating", "--support", "left_sole", "--sole", "0.2,0.1", "--threshold", "0.1"],
            "--threshold: is not available",
        ),
        (
            ["--floating", "--support", "left_sole", "--sole", "0.2,0.1", "--criterion", "e"],
            "a or d",
        ),
    ],
)
def test_faults_of_the_command_are_one_line_with_exit_code_2(
    walker, capsys, tmp_path, words, message
):
    code, out, err = run(capsys, "design", walker.source, *words, "-o", tmp_path)
    assert (code, out) == (2, "")
    (line,) = [line for line in err.splitlines() if line.startswith("excite:")]
    assert message in line
