"""Inertial parameters: pseudo-inertia, metric, nominal values, and repair of invalid bodies."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from conftest import (
    BUILTIN,
    LIMIT,
    document,
    joint,
    link,
    loaded,
    off,
    pendulum,
    random_body,
    random_urdf,
    raw_torque,
    seeds,
    states,
)
from hypothesis import given
from hypothesis import strategies as st

from excite.errors import ExciteWarning, UnusableInput
from excite.robot import inertial_parameters
from excite.robot.dynamics import regressor
from excite.robot.inertial_parameters import (
    COULOMB_WIDTH,
    DRIVE,
    inverse_root,
    metric,
    proper_body,
    pseudo_inertia,
)
from excite.robot.limits import resolve
from excite.robot.robot import load

STEP = 1e-3


def body(mass, com, moments):
    """Return ten arbitrary parameters; moments are about the centre of mass."""
    com = np.array(com, float)
    tensor = np.diag(moments) + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array(
        [
            mass,
            *(mass * com),
            tensor[0, 0],
            tensor[0, 1],
            tensor[1, 1],
            tensor[0, 2],
            tensor[1, 2],
            tensor[2, 2],
        ]
    )


def smallest(phi):
    return float(np.linalg.eigvalsh(pseudo_inertia(phi))[0])


# -- pseudo-inertia and metric ---------------------------------------------------------------------


@given(seeds)
def test_pseudo_inertia_equals_pinocchio(rng):
    phi = random_body(rng)
    assert np.allclose(
        pseudo_inertia(phi),
        pin.PseudoInertia.FromDynamicParameters(phi).toMatrix(),
        rtol=0,
        atol=1e-13,
    )


@given(seeds)
def test_metric_is_half_the_trace_of_the_definition(rng):
    phi = random_body(rng)
    inverse = np.linalg.inv(pseudo_inertia(phi))
    units = [pseudo_inertia(e) for e in np.eye(10)]
    defined = [[0.5 * np.trace(inverse @ a @ inverse @ b) for b in units] for a in units]
    assert off(metric(phi), np.array(defined)) < 1e-9


@given(seeds)
def test_inverse_root_inverts_the_metric(rng):
    phi = random_body(rng)
    R = inverse_root(phi)
    whitened = R.T @ metric(phi) @ R  # similar to R Rᵀ g, with a better scaling
    assert np.allclose(whitened, np.eye(10), atol=1e-8)
    assert np.allclose(R @ R.T @ metric(phi), np.eye(10), atol=1e-6)


def bregman(first, second):
    """Log-det divergence (METHOD, eq. 17)."""
    return (
        np.linalg.slogdet(second)[1]
        - np.linalg.slogdet(first)[1]
        + np.trace(np.linalg.solve(second, first))
        - 4.0
    )


def affine(first, second):
    """Squared affine-invariant distance (METHOD, eq. 16)."""
    return 0.5 * np.sum(np.log(scipy.linalg.eigh(first, second, eigvals_only=True)) ** 2)


@pytest.mark.parametrize("distance", [bregman, affine])
@given(rng=seeds)
def test_metric_is_the_second_order_of_the_distances(distance, rng):
    phi = random_body(rng)
    direction = inverse_root(phi) @ rng.normal(size=10)  # of similar length in every direction
    ahead, behind = (
        distance(pseudo_inertia(phi + s * STEP * direction), pseudo_inertia(phi)) for s in (1, -1)
    )
    assert np.isclose(
        (ahead + behind) / (2 * STEP**2), direction @ metric(phi) @ direction, rtol=1e-3
    )


@given(seeds)
def test_metric_does_not_depend_on_the_links_frame(rng):
    phi, change = random_body(rng), 0.1 * random_body(rng)
    placement = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    matrix = np.block(
        [[placement.rotation, placement.translation[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]
    )
    moved = [from_pseudo(matrix @ pseudo_inertia(x) @ matrix.T) for x in (phi, change)]
    assert np.isclose(
        moved[1] @ metric(moved[0]) @ moved[1], change @ metric(phi) @ change, rtol=1e-6
    )


def from_pseudo(P):
    tensor = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    return np.array(
        [
            P[3, 3],
            *P[:3, 3],
            tensor[0, 0],
            tensor[0, 1],
            tensor[1, 1],
            tensor[0, 2],
            tensor[1, 2],
            tensor[2, 2],
        ]
    )


# -- nominal values --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUILTIN)
def test_nominal_torque_is_that_of_pinocchio_plus_friction(name):
    robot = load(name)
    standard, motion = (
        inertial_parameters.standard_parameters(robot, resolve(robot)),
        states(robot.n),
    )
    data = robot.model.createData()
    expected = np.array(
        [
            pin.rnea(robot.model, data, *state)
            for state in zip(motion.q, motion.dq, motion.ddq, strict=True)
        ]
    )
    for j, entry in enumerate(robot.entries):
        expected[:, j] += entry.viscous * motion.dq[:, j] + entry.coulomb * np.tanh(
            motion.dq[:, j] / COULOMB_WIDTH
        )
    assert off(regressor(robot, standard, motion) @ standard.nominal, expected) < 1e-12


def test_friction_of_the_urdf_is_nominal_and_its_own_scale():
    robot = loaded(pendulum(LIMIT + '<dynamics damping="0.7" friction="1.3"/>'))
    standard = inertial_parameters.standard_parameters(robot, resolve(robot))
    assert standard.nominal[10:].tolist() == [0.0, 0.7, 1.3, 0.0]
    assert standard.scale.diagonal()[11:13].tolist() == [0.7, 1.3]


def test_friction_without_a_nominal_value_gets_the_stated_scale():
    robot = loaded(pendulum())  # torque 40 N m, velocity 3 rad/s
    scale = inertial_parameters.standard_parameters(robot, resolve(robot), DRIVE).scale.diagonal()[
        11:
    ]
    assert np.allclose(scale, [0.02 * 40 / 3, 0.02 * 40, 0.02 * 40], rtol=1e-14)


def test_rotor_inertia_scales_with_the_joints_inertia():
    robot = loaded(pendulum())  # 2 kg at 0.3 m and 0.02 kg m² about its centre
    scale = inertial_parameters.standard_parameters(
        robot, resolve(robot), ("rotor_inertia",)
    ).scale[10, 10]
    assert np.isclose(scale, 0.05 * (2 * 0.3**2 + 0.02), rtol=1e-12)


def test_rotor_inertia_scale_is_a_mean_over_poses():
    robot = loaded(random_urdf(np.random.default_rng(3), 4, kinds=("revolute",)))
    limits = resolve(robot)
    data, rng = robot.model.createData(), np.random.default_rng(0)
    poses = rng.uniform(limits.position[:, 0], limits.position[:, 1], (4000, 4))
    mean = np.mean([np.diag(pin.crba(robot.model, data, q)) for q in poses], axis=0)
    assert np.allclose(
        inertial_parameters.standard_parameters(robot, limits, ("rotor_inertia",)).scale.diagonal()[
            40:
        ],
        0.05 * mean,
        rtol=0.1,
    )


def test_scale_is_block_diagonal_with_each_bodys_inverse_root():
    robot = load("two_link")
    scale = inertial_parameters.standard_parameters(robot, resolve(robot), ()).scale
    blocks = [inverse_root(robot.model.inertias[i].toDynamicParameters()) for i in (1, 2)]
    assert np.array_equal(scale, scipy.linalg.block_diag(*blocks))


@given(st.sets(st.sampled_from(DRIVE)))
def test_layout_names_each_parameter_once_in_one_order(drive):
    robot = load("two_link")
    standard = inertial_parameters.standard_parameters(robot, resolve(robot), drive)
    assert standard.drive == tuple(kind for kind in DRIVE if kind in drive)
    assert (
        len(set(standard.names))
        == standard.count
        == 20 + 2 * len(drive)
        == len(standard.owners())
        == len(standard.nominal)
    )


@pytest.mark.parametrize("kind", DRIVE)
def test_drive_column_acts_on_its_own_joint_only(kind):
    robot, motion = load("two_link"), states(2)
    standard = inertial_parameters.standard_parameters(robot, resolve(robot), (kind,))
    columns = regressor(robot, standard, motion)[:, :, 20:]
    expected = {
        "rotor_inertia": motion.ddq,
        "viscous": motion.dq,
        "coulomb": np.sign(motion.dq),
        "offset": np.ones_like(motion.q),
    }[kind]
    assert np.allclose(columns, np.einsum("ti,ij->tij", expected, np.eye(2)), atol=1e-12)


def test_an_unknown_drive_parameter_is_refused():
    robot = load("two_link")
    with pytest.raises(UnusableInput, match="no joint parameter 'magic'; there are: rotor_inertia"):
        inertial_parameters.standard_parameters(robot, resolve(robot), ("magic",))


# -- inconsistent bodies ---------------------------------------------------------------------------

IMPROPER = {
    "massless": body(0.0, (0, 0, 0), (0, 0, 0)),
    "point": body(2.0, (0.1, 0, 0), (0, 0, 0)),
    "rod": body(2.0, (0.1, 0, 0), (0, 0.1, 0.1)),
    "plate": body(2.0, (0, 0.1, 0), (0.1, 0.1, 0.2)),
    "no triangle": body(2.0, (0, 0, 0.1), (0.1, 0.1, 0.5)),
    "negative moment": body(2.0, (0, 0, 0.1), (-0.1, 0.1, 0.1)),
    "negative mass": body(-2.0, (0, 0, 0), (0.1, 0.1, 0.1)),
}


@pytest.mark.parametrize("case", IMPROPER)
def test_an_inconsistent_body_is_repaired(case):
    phi, changed = proper_body(IMPROPER[case], robot_mass=10.0)
    assert changed and smallest(phi) > 0.0 and np.isfinite(inverse_root(phi)).all()


@pytest.mark.parametrize("case", ["point", "rod", "plate", "no triangle", "negative moment"])
def test_a_repair_keeps_mass_and_centre(case):
    assert np.allclose(proper_body(IMPROPER[case], 10.0)[0][:4], IMPROPER[case][:4])


def test_a_repaired_rod_keeps_its_moments():
    rod = IMPROPER["rod"]
    assert np.allclose(proper_body(rod, 10.0)[0][[6, 9]], rod[[6, 9]], rtol=2e-3)


@given(seeds)
def test_a_consistent_body_is_not_changed(rng):
    phi = random_body(rng)
    kept, changed = proper_body(phi, 10.0)
    assert not changed and kept is phi


@pytest.mark.parametrize(
    "sick",
    [
        link("hand"),
        link("hand", 1.0, tensor=np.zeros((3, 3))),
        link("hand", 1.0, (0.1, 0, 0), np.diag([0.0, 0.1, 0.1])),
    ],
)
def test_a_warning_names_the_repaired_link(sick):
    tail = [link("tip", 0.5), joint("twist", "hand", "tip", axis=(0, 0, 1))]
    robot = loaded(
        document(
            link("base"),
            link("arm", 2.0),
            sick,
            joint("swing", "base", "arm"),
            joint("bend", "arm", "hand"),
            *tail,
        )
    )
    with pytest.warns(ExciteWarning, match=r"no proper body in link\(s\) hand ") as caught:
        standard = inertial_parameters.standard_parameters(robot, resolve(robot))
    assert len(caught) == 1 and standard.repaired == ("hand",)
    assert np.linalg.matrix_rank(standard.scale[10:20, 10:20]) == 10


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (link("arm", 2.0, (0.3, 0, 0), np.diag([0.1, 0.1, 0.5])), "exceeds the sum"),
        (link("arm", 2.0, (0.3, 0, 0), np.diag([0.0, 0.1, 0.1])), "singular inertia"),
    ],
)
def test_a_repair_states_what_is_wrong_with_the_body(body, reason):
    robot = loaded(pendulum(body=body))
    with pytest.warns(ExciteWarning, match=reason) as caught:
        inertial_parameters.standard_parameters(robot, resolve(robot), ())
    words = {"exceeds the sum", "singular inertia", "massless"} - {reason}
    assert not any(word in str(caught[0].message) for word in words)


def test_a_repair_does_not_change_the_nominal_torque():
    text = pendulum(body=link("arm", 2.0, (0.3, 0, 0), np.diag([0.0, 0.1, 0.1])))
    robot, motion = loaded(text), states(1)
    with pytest.warns(ExciteWarning, match="arm"):
        standard = inertial_parameters.standard_parameters(robot, resolve(robot), ())
    assert (
        off(
            regressor(robot, standard, motion) @ standard.nominal,
            raw_torque(text, ("swing",), motion),
        )
        < 1e-12
    )


def test_inertia_without_mass_is_refused():
    arm = (
        '<link name="arm"><inertial><mass value="0"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    with pytest.raises(UnusableInput, match="link 'arm' has an inertia but the mass 0"):
        loaded(pendulum(body=arm))
