"""Identifiability against independent computations."""

from __future__ import annotations

import dataclasses
import json
from functools import cache

import numpy as np
import pytest
import scipy.linalg

from excite import _json
from excite.designer.experiment_comparison import compare_scenarios
from excite.designer.identifiability import (
    Identifiability,
    analyse_root,
    information_root,
    named_coordinates_root,
    regressor_root,
    rotation_to_named_coordinates,
)
from excite.robot import base_parameters as base_parameters_module
from excite.robot import dynamics, inertial_parameters, limits, robot
from excite.robot.base_parameters import Base
from excite.robot.parameter_names import percent, spoken
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries
from excite.trajectory.rest_to_rest import Motion, MotionSegment

RNG_SEED = 3


@cache
def setup(name: str) -> tuple:
    loaded = robot.load(name)
    table = limits.resolve(loaded)
    standard = inertial_parameters.standard_parameters(loaded, table)
    return loaded, table, standard, base_parameters_module.find(loaded, standard, table)


def motion_of(name: str, count: int = 300, period: float = 5.0) -> tuple[Motion, Samples]:
    loaded, table, _, _ = setup(name)
    rng = np.random.default_rng(RNG_SEED)
    speed = np.where(np.isfinite(table.velocity), table.velocity, 1.0)[:, None]
    series = FourierSeries(
        0.1 * speed * rng.normal(size=(loaded.n, 4)),
        0.1 * speed * rng.normal(size=(loaded.n, 4)),
        rng.normal(size=loaded.n),
        period,
    )
    motion = Motion(loaded.joints, series, 2, (MotionSegment("fourier", 0.0, 2.0 * period),))
    return motion, series.samples(series.grid(count))


def result(name: str) -> tuple[Identifiability, np.ndarray]:
    loaded, table, standard, base = setup(name)
    noise = 0.01 * table.torque
    root = information_root(loaded, standard, motion_of(name)[1], noise)
    return analyse_root(standard, base, root, noise, loaded), root


def test_eigenvalues_equal_those_of_the_generalised_problem() -> None:
    """I v = λ H₀ v in the base coordinates of an arbitrary B, by LAPACK's generalised solver."""
    _, table, standard, base = setup("two_link")
    analysis, _ = result("two_link")
    Y = dynamics.regressor(setup("two_link")[0], standard, motion_of("two_link")[1])
    weighted = (Y / (0.01 * table.torque)[:, None]).reshape(-1, standard.count)
    gamma = weighted @ np.linalg.pinv(base.matrix)
    inverse_metric = standard.scale @ standard.scale.T
    H0 = np.linalg.inv(base.matrix @ inverse_metric @ base.matrix.T)
    expected = scipy.linalg.eigh(gamma.T @ gamma, 0.5 * (H0 + H0.T), eigvals_only=True)[::-1]
    np.testing.assert_allclose(analysis.eigenvalues, expected, rtol=1e-6)
    assert [d.identifiable for d in analysis.directions] == [
        bool(1.0 / v <= analysis.threshold) for v in expected
    ]


def test_information_by_blocks_equals_that_of_all_samples() -> None:
    loaded, table, standard, _ = setup("ur10e")
    samples = motion_of("ur10e", 900)[1]
    noise = 0.01 * table.torque
    complete = regressor_root(dynamics.regressor(loaded, standard, samples), noise)
    blocks = information_root(loaded, standard, samples, noise)
    np.testing.assert_allclose(
        blocks.T @ blocks,
        complete.T @ complete,
        rtol=1e-9,
        atol=1e-9 * np.abs(complete.T @ complete).max(),
    )


@pytest.mark.parametrize("name", ["two_link", "ur10e"])
def test_results_do_not_depend_on_the_choice_of_base(name: str) -> None:
    loaded, table, standard, base = setup(name)
    analysis, root = result(name)
    rng = np.random.default_rng(0)
    other_rows = scipy.linalg.qr(rng.normal(size=(base.count, base.count)))[0] @ base.matrix
    geometric = standard.scale @ np.linalg.qr((other_rows @ standard.scale).T)[0]
    other: Base = dataclasses.replace(base, matrix=other_rows, geometric=geometric)
    again = analyse_root(standard, other, root, 0.01 * table.torque, loaded)
    np.testing.assert_allclose(
        again.eigenvalues, analysis.eigenvalues, rtol=1e-6, atol=1e-12 * analysis.eigenvalues[0]
    )
    for share, other_share in zip(
        analysis.links + analysis.joints, again.links + again.joints, strict=True
    ):
        assert share.name == other_share.name
        assert share.identifiable_share == pytest.approx(other_share.identifiable_share, abs=1e-6)
    if name == "two_link":  # distinct eigenvalues: the directions themselves are the same
        for a, b in zip(analysis.directions, again.directions, strict=True):
            assert a.words == b.words
            assert a.weights == pytest.approx(b.weights, abs=1e-5)


def test_weights_are_shares_of_a_unit_direction() -> None:
    analysis, _ = result("ur10e")
    names = set(setup("ur10e")[2].names)
    for direction in analysis.directions:
        assert set(direction.weights) <= names
        assert all(0.01 < share <= 1.0 + 1e-12 for share in direction.weights.values())
        assert sum(direction.weights.values()) <= 1.0 + 1e-9


@pytest.mark.parametrize("name", ["two_link", "ur10e", "fr3"])
def test_directions_are_orthonormal_in_named_coordinates(name: str) -> None:
    """Named coordinates are white, and a change of mass alone changes only the first of them."""
    standard = setup(name)[2]
    rotation = rotation_to_named_coordinates(standard)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(standard.count), atol=1e-9)
    total = float(standard.nominal[0 : 10 * standard.bodies : 10].sum())
    for i in range(standard.bodies):
        block = slice(10 * i, 10 * i + 10)
        phi = inertial_parameters.proper_body(standard.nominal[block], total)[0]
        named, whitened = named_coordinates_root(phi), standard.scale[block, block]
        expected = whitened @ whitened.T
        np.testing.assert_allclose(named @ named.T, expected, atol=1e-10 * np.abs(expected).max())
        # added mass with constant centre of mass: δφ ∝ (m, mc, inertia of a point mass at c)
        c = phi[1:4] / phi[0]
        point = np.array(
            [
                1.0,
                *c,
                c[1] ** 2 + c[2] ** 2,
                -c[0] * c[1],
                c[0] ** 2 + c[2] ** 2,
                -c[0] * c[2],
                -c[1] * c[2],
                c[0] ** 2 + c[1] ** 2,
            ]
        )
        np.testing.assert_allclose(
            named[:, 0], np.sqrt(2.0) * phi[0] * point, atol=1e-9 * np.abs(named).max()
        )


def test_deviations_equal_those_of_repeated_least_squares() -> None:
    loaded, table, standard, base = setup("two_link")
    samples = motion_of("two_link", 120)[1]
    noise = 0.01 * table.torque
    root = information_root(loaded, standard, samples, noise)
    analysis = analyse_root(standard, base, root, noise, loaded)
    gamma = dynamics.regressor(loaded, standard, samples) @ np.linalg.pinv(base.matrix)
    rows = (gamma / noise[:, None]).reshape(-1, base.count)
    rng = np.random.default_rng(7)
    truth = base.matrix @ standard.nominal
    torque = rows @ truth
    draws = np.linalg.lstsq(
        rows, (torque[:, None] + rng.normal(size=(len(torque), 4000))), rcond=None
    )[0]
    measured = draws.std(axis=1)
    predicted = np.array([b.std for b in analysis.base_parameters])
    np.testing.assert_allclose(predicted, measured, rtol=0.06)  # five sigmas of 1/√(2·4000)
    np.testing.assert_allclose([b.nominal for b in analysis.base_parameters], truth)


def test_parameters_of_a_resting_joint_are_reported_as_unknown() -> None:
    loaded, table, standard, base = setup("two_link")
    samples = motion_of("two_link")[1]
    moving = np.array([1.0, 0.0])
    frozen = Samples(
        samples.q * moving + 0.3 * (1.0 - moving), samples.dq * moving, samples.ddq * moving
    )
    noise = 0.01 * table.torque
    root = information_root(loaded, standard, frozen, noise)
    analysis = analyse_root(standard, base, root, noise, loaded)
    # friction and rotor inertia of a joint at rest produce no torque
    hidden = [d for d in analysis.directions if not np.isfinite(d.variance)]
    assert hidden
    assert all(not d.identifiable and d.words.startswith("not seen: ") for d in hidden)
    stds = {b.name: b.std for b in analysis.base_parameters}
    assert np.isinf(stds["Fv2"]) and np.isinf(stds["Fc2"])
    assert np.isfinite(stds["Fv1"])
    text = _json.dumps(analysis.document())
    document = json.loads(
        text, parse_constant=lambda name: pytest.fail(f"{name} is not strict JSON")
    )
    assert document["directions"][-1]["variance"] is None
    assert {b["name"]: b["std"] for b in document["base_parameters"]}["Fv2"] is None
    json.dumps(analysis.document(), allow_nan=False)


def test_document_has_the_keys_of_the_contract() -> None:
    analysis, _ = result("ur10e")
    document = json.loads(json.dumps(analysis.document(), allow_nan=False))
    assert document["schema"] == "excite.identifiability/1"
    assert {
        "threshold",
        "eigenvalues",
        "directions",
        "base_parameters",
        "links",
        "torque_noise",
    } <= set(document)
    assert (
        len(document["eigenvalues"])
        == len(document["directions"])
        == len(document["base_parameters"])
        == 58
    )
    assert set(document["directions"][0]) == {"variance", "identifiable", "words", "weights"}
    assert set(document["base_parameters"][0]) == {"name", "expression", "nominal", "std"}
    loaded = setup("ur10e")[0]
    assert [link["name"] for link in document["links"]] == list(loaded.links)
    assert list(document["torque_noise"]) == list(loaded.joints)
    assert document["eigenvalues"] == sorted(document["eigenvalues"], reverse=True)
    for direction, value in zip(document["directions"], document["eigenvalues"], strict=True):
        assert direction["variance"] == pytest.approx(1.0 / value)
    for link in document["links"]:
        assert link["identifiable_share"] is None or 0.0 <= link["identifiable_share"] <= 1.0


def test_larger_threshold_identifies_more_directions() -> None:
    loaded, table, standard, base = setup("ur10e")
    _, root = result("ur10e")
    counts, shares = [], []
    for threshold in (1e-4, 1e-2, 1e12):
        analysis = analyse_root(
            standard, base, root, 0.01 * table.torque, loaded, threshold=threshold
        )
        counts.append(analysis.identifiable_count)
        shares.append([s.identifiable_share for s in analysis.links])
    assert counts == sorted(counts) and counts[-1] == base.count
    assert np.all(np.diff(np.array(shares), axis=0) >= -1e-12)
    np.testing.assert_allclose(shares[-1], 1.0)


def test_descriptions_name_links_and_joints() -> None:
    analysis, _ = result("ur10e")
    loaded = setup("ur10e")[0]
    for direction in analysis.directions:
        assert any(name in direction.words for name in (*loaded.links, *loaded.joints))
        assert (
            "seen to ±" in direction.words and not direction.words.startswith("not")
        ) == direction.identifiable
    assert percent(0.0234) == "2.3 %" and percent(3.4) == "340 %"
    standard = setup("ur10e")[2]
    assert spoken("mcx3", standard) == "m·c along x of forearm_link"
    assert spoken("Fc2", standard) == "Coulomb friction of shoulder_lift_joint"


def test_scenarios_of_twice_the_time_and_twice_the_speed() -> None:
    loaded, table, standard, base = setup("two_link")
    motion, _ = motion_of("two_link")
    noise = 0.01 * table.torque
    now, time, speed = compare_scenarios(
        loaded, standard, base, table, motion, noise=noise, rate=100.0
    )
    np.testing.assert_allclose(time.eigenvalues, 2.0 * now.eigenvalues, rtol=1e-9)
    assert (now.name, time.name, speed.name) == ("now", "time", "speed") and not time.broken_limits
    # the same number of samples of the faster series, counted directly
    fast = motion.fourier.slowed(2.0)
    count = round(100.0 * motion.duration)
    t = np.arange(count) * (motion.duration / count)
    direct = analyse_root(
        standard, base, information_root(loaded, standard, fast.samples(t), noise), noise, loaded
    )
    np.testing.assert_allclose(speed.eigenvalues, direct.eigenvalues, rtol=0.02)
    peak = np.abs(fast.at(fast.grid(300), 1)).max(axis=0) / table.velocity
    assert any(b.limit == "velocity" for b in speed.broken_limits) == bool(peak.max() > 1.0)
    # derived limits apply to the ramps only, stated ones to the excitation, too
    low = dataclasses.replace(table, acceleration=np.full(2, 0.1))
    derived = dataclasses.replace(
        low, sources={**table.sources, "acceleration": ("derived", "derived")}
    )
    for limited, expected in ((low, True), (derived, False)):
        broken_limits = compare_scenarios(
            loaded, standard, base, limited, motion, noise=noise, rate=100.0
        )[2].broken_limits
        assert any(b.limit == "acceleration" for b in broken_limits) == expected
    slow = dataclasses.replace(table, velocity=0.5 * np.abs(fast.at(fast.grid(300), 1)).max(axis=0))
    broken_limits = compare_scenarios(
        loaded, standard, base, slow, motion, noise=noise, rate=100.0
    )[2].broken_limits
    assert next(b for b in broken_limits if b.limit == "velocity").factor == pytest.approx(2.0)
