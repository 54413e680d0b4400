"""A legged robot on a stand: design with all limbs, clearance between legs, joint parameters."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from excite.api import design, identify, simulate, verify
from excite.api.design_result import CellOptions
from excite.cli.main import main
from excite.designer.evaluator import Evaluator
from excite.designer.options import DesignOptions


def legs_urdf() -> str:
    """Return a trunk with two legs of two joints that meet where both hips roll inwards."""
    parts = [
        '<robot name="legs"><link name="trunk"><inertial><mass value="8"/><inertia ixx="0.1" '
        'ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'
    ]
    for side, sign in (("left", 1), ("right", -1)):
        for name, parent, origin, axis, mass in (
            ("hip", "trunk", f"0 {0.1 * sign} 0", "1 0 0", 2.0),
            ("knee", f"{side}_thigh", "0 0 -0.3", "0 1 0", 1.0),
        ):
            child = f"{side}_{'thigh' if name == 'hip' else 'shank'}"
            parts.append(
                f'<link name="{child}"><inertial><origin xyz="0.01 0.005 -0.14"/>'
                f'<mass value="{mass}"/><inertia ixx="{0.015 * mass}" ixy="0" ixz="0" '
                f'iyy="{0.014 * mass}" iyz="0" izz="{0.002 * mass}"/></inertial>'
                '<collision><origin xyz="0 0 -0.15"/><geometry><cylinder radius="0.04" '
                'length="0.26"/></geometry></collision></link>'
                f'<joint name="{side}_{name}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{child}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
                '<limit lower="-0.9" upper="0.9" velocity="6" effort="60"/>'
                '<dynamics damping="0.3" friction="0.5"/></joint>'
            )
    return "".join([*parts, "</robot>"])


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    folder = tmp_path_factory.mktemp("legs")
    (folder / "legs.urdf").write_text(legs_urdf(), encoding="utf-8")
    urdf = folder / "legs.urdf"
    result = design(
        urdf,
        period=5.0,
        harmonics=4,
        options=DesignOptions(starts=1, jobs=1, iterations=40),
        progress=lambda text: None,
    )
    result.save(folder)
    recording = simulate(urdf, folder / "trajectory.json")
    recording.save(folder / "recording.csv")
    model = identify(urdf, [folder / "recording.csv"], progress=lambda text: None)
    return result, recording, model


def test_the_legs_keep_clear_of_each_other(identified):
    certificate = identified[0].delivery.certificate
    assert certificate.ok
    pairs = {margin.joint for margin in certificate.margins if margin.limit == "clearance"}
    assert any("left" in pair and "right" in pair for pair in pairs)


def test_friction_and_armature_of_each_leg_are_in_their_intervals(identified):
    _, recording, model = identified
    document = model.document()
    parameters = {entry["name"]: entry for entry in document["base_parameters"]}
    drive = recording.truth["drive"]
    inside, count = 0, 0
    for symbol, kind in (("Ia", "inertia"), ("Fv", "viscous"), ("Fc", "coulomb")):
        for number, joint in enumerate(document["joints"], start=1):
            entry = parameters.get(f"{symbol}{number}")
            if entry is None or entry["expression"] != f"{symbol}{number}":
                continue  # an armature that no motion separates from the link's inertia
            lower, upper = entry["interval"]
            inside += lower <= drive[kind][joint] <= upper
            count += 1
    assert count >= 8
    assert inside >= count - 1


STAND = "[stand]\nforce = 400.0\nmoment = 7.0\npoint = [0.0, 0.0, -0.05]\n"


@pytest.fixture(scope="module")
def weak_stand(tmp_path_factory):
    """The legs on a stand that takes a small moment, designed and saved."""
    folder = tmp_path_factory.mktemp("stand")
    (folder / "legs.urdf").write_text(legs_urdf(), encoding="utf-8")
    (folder / "stand.toml").write_text(STAND, encoding="utf-8")
    options = DesignOptions(starts=1, jobs=1, iterations=25)

    def designed(limits):
        return design(
            folder / "legs.urdf",
            period=3.0,
            harmonics=3,
            limits=limits,
            options=options,
            cell=CellOptions(check=False),
            progress=lambda text: None,
        )

    free, limited = designed(None), designed(folder / "stand.toml")
    limited.save(folder)
    return folder, free, limited


def largest_loads(result) -> np.ndarray:
    """Return the largest force and moment of a motion, from its rate of momentum."""
    robot, motion = result.robot, result.trajectory.motion
    model, step = robot.model, 1e-4
    data = model.createData()
    times = np.linspace(0.01, motion.duration - 0.01, 300)

    def momentum(t):
        pin.computeCentroidalMomentum(model, data, motion.at(t), motion.at(t, 1))
        com, mass = data.com[0].copy(), sum(i.mass for i in list(model.inertias)[1:])
        linear = data.hg.linear.copy()
        return mass, com, linear, data.hg.angular + np.cross(com, linear)

    worst = np.zeros(2)
    gravity = model.gravity.linear
    for t in times:
        mass, com, *_ = momentum(t)
        (_, _, p0, l0), (_, _, p1, l1) = momentum(t - step), momentum(t + step)
        base = model.inertias[0]
        force = (p1 - p0) / (2.0 * step) - (mass + base.mass) * gravity
        weight_moment = np.cross(mass * com + base.mass * base.lever, gravity)
        moment = (l1 - l0) / (2.0 * step) - weight_moment
        moment = moment - np.cross([0.0, 0.0, -0.05], force)
        worst = np.maximum(worst, [np.linalg.norm(force), np.linalg.norm(moment)])
    return worst


def test_the_stand_limits_the_motion(weak_stand):
    _, free, limited = weak_stand
    assert largest_loads(free)[1] > 9.0
    force, moment = largest_loads(limited)
    assert force < 400.0
    assert moment <= 7.0
    stated = {m.joint: m for m in limited.delivery.certificate.margins if m.limit == "stand load"}
    assert stated["moment"].value == pytest.approx(moment, rel=0.02)
    assert stated["force"].value == pytest.approx(force, rel=0.02)
    criterion = [r.trajectory.criteria["optimum"]["geometric"]["a"] for r in (free, limited)]
    assert criterion[0] < criterion[1]


def test_verification_has_the_stand_from_its_file(weak_stand):
    folder = weak_stand[0]
    result = verify(folder / "trajectory.json")
    assert result.ok, result.text()
    assert "stand load" in result.text()
    (folder / "weaker.toml").write_text(
        STAND.replace("moment = 7.0", "moment = 4.0"), encoding="utf-8"
    )
    weaker = verify(folder / "trajectory.json", limits=folder / "weaker.toml")
    assert not weaker.ok
    assert "load that the stand takes" in weaker.text()
    assert weaker.certificate.worst().limit == "stand load"


def test_the_report_shows_the_load_on_the_stand(weak_stand):
    page = (weak_stand[0] / "report.html").read_text(encoding="utf-8")
    assert "Does the stand take the load?" in page
    assert "moment on the stand [N m]" in page
    assert "the weight of the robot included" in page


def test_gradients_of_the_load_on_the_stand_are_exact(weak_stand):
    problem = weak_stand[2].delivery.design.setup.problem
    evaluator = Evaluator(problem)
    rng = np.random.default_rng(2)
    x = problem.variables(weak_stand[2].trajectory.motion.fourier)
    x = x + 0.05 * rng.normal(size=len(x))
    mask = np.concatenate(
        [
            np.full(v.size, kind == "stand load")
            for kind, v in evaluator.constraint_values(x).items()
        ]
    )
    rows, direction, step = evaluator.rows(x, mask), rng.normal(size=len(x)), 1e-6
    jacobian = evaluator.row_gradients(x, rows)
    change = evaluator.row_values(x + step * direction, rows) - evaluator.row_values(
        x - step * direction, rows
    )
    assert len(rows) == 2 * problem.options.samples
    np.testing.assert_allclose(change / (2.0 * step), jacobian @ direction, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[stand]\n", "has neither force"),
        ("[stand]\nforce = -3.0\n", "stand.force"),
        ("[stand]\nmoment = 5.0\nforces = 3.0\n", "forces"),
        ("[stand]\nforce = 100.0\n", "is not above the weight"),
        ("[stand]\nmoment = 9.0\npoint = [0.0, 0.0]\n", "stand.point"),
    ],
)
def test_bad_stands_are_one_line_with_exit_code_2(tmp_path, capsys, text, message):
    (tmp_path / "legs.urdf").write_text(legs_urdf(), encoding="utf-8")
    (tmp_path / "stand.toml").write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    words = ["design", tmp_path / "legs.urdf", "--limits", tmp_path / "stand.toml", "-o", out]
    assert main([*map(str, words), "--starts", "1", "--no-collision"]) == 2
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("excite:")]
    assert message in line and "stand.toml" in line
    assert not out.exists()
