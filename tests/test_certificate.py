"""Certificate: valid motions pass, tampering is detected, bounds hold between samples."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import LIMIT, QUICK, loaded, pendulum, verified

from excite import _json
from excite.api.verification_result import VerificationResult
from excite.designer import certificate as certificate_module
from excite.designer import constraint_margins, pipeline, ramps
from excite.designer.certificate import Certificate
from excite.designer.options import WorkspaceBox
from excite.designer.pipeline import CertifiedDesign
from excite.errors import UnusableInput
from excite.robot import dynamics, inertial_parameters
from excite.robot.limits import Limits, resolve
from excite.robot.robot import Payload, load, locate
from excite.trajectory import trajectory_file
from excite.trajectory.fourier import FourierSeries, oversampling_bound
from excite.trajectory.trajectory_file import Trajectory

ORDERS = {"position": 0, "velocity": 1, "acceleration": 2, "jerk": 3}


@pytest.fixture(params=["delivery", "braked"])
def any_delivery(request: pytest.FixtureRequest) -> CertifiedDesign:
    return request.getfixturevalue(request.param)


def reread(document: dict) -> Trajectory:
    content = json.loads(_json.dumps(document))
    return trajectory_file.parse_trajectory(content, Path("trajectory.json"))


def certificate(document: dict) -> Certificate:
    trajectory = reread(document)
    return verified(trajectory)


# valid motions


def test_certified_motion_is_certified_after_reading_its_file(any_delivery, tmp_path: Path):
    path = tmp_path / "trajectory.json"
    path.write_text(_json.dumps(any_delivery.trajectory.document()), encoding="utf-8")
    again = trajectory_file.read_trajectory(path)
    certificate = verified(again)
    assert certificate.ok and [m.document() for m in certificate.margins] == again.margins


def test_file_reads_back_exactly(any_delivery):
    stated = any_delivery.trajectory.document()
    assert _json.dumps(reread(stated).document()) == _json.dumps(stated)


def test_file_has_the_keys_of_the_contract(delivery):
    keys = {
        "schema",
        "robot",
        "joints",
        "base_frequency",
        "harmonics",
        "period",
        "periods",
        "sine",
        "cosine",
        "offset",
        "segments",
        "rate",
    }
    keys |= {
        "limits",
        "torque_noise",
        "criterion",
        "criteria",
        "margins",
        "collision",
        "seed",
        "versions",
    }
    document = delivery.trajectory.document()
    assert keys <= set(document) and {"name", "source", "sha256"} <= set(document["robot"])
    assert set(document["criteria"]) == {"optimum", "exported"}


def test_derived_limits_are_marked(two_link, table):
    bare = replace(table, jerk=np.full(2, np.inf), sources={**table.sources, "jerk": ("", "")})
    limits = pipeline.design_trajectory(
        two_link, bare, replace(QUICK, iterations=3)
    ).trajectory.document()["limits"]
    assert {entry["source"] for entry in limits["jerk"].values()} == {"derived"}
    assert {entry["source"] for entry in limits["torque"].values()} == {"two_link.toml"}


def test_slowed_motion_is_certified(two_link, table):
    assert pipeline.design_trajectory(
        two_link, table, replace(QUICK, iterations=3), speed=0.5
    ).certificate.ok


def test_robot_is_loaded_with_the_payload_and_gravity_of_the_design(table):
    held = load("two_link", payload=Payload("tip", 0.4, (0.0, 0.0, 0.1)), gravity=(0.0, 0.0, -5.0))
    trajectory = reread(
        pipeline.design_trajectory(held, table, replace(QUICK, iterations=3)).trajectory.document()
    )
    again = trajectory.load_robot()
    assert again.model.inertias[2] == held.model.inertias[2] and np.array_equal(
        again.model.gravity.linear, [0, 0, -5]
    )


# tampering


def coefficient(d: dict) -> None:
    d["sine"][0][0] *= 1.01


def jump(d: dict) -> None:
    d["segments"][1]["profile"]["position"][1] += 1e-6


def gap(d: dict) -> None:
    for edge in ("start", "end"):
        d["segments"][-1][edge] += 0.1


def moving_start(d: dict) -> None:
    d["segments"][0]["profile"]["velocity"][0] = 1e-3


def moving_end(d: dict) -> None:
    pieces = d["segments"][-1]["profile"]["pieces"]["joint_2"]
    pieces[-1][0] *= 0.98


def odd_rate(d: dict) -> None:
    d["rate"] = 99.3


def single_period(d: dict) -> None:
    d["periods"] = 1
    part = next(i for i, segment in enumerate(d["segments"]) if segment["kind"] == "fourier")
    d["segments"][part]["end"] -= d["period"]
    for segment in d["segments"][part + 1 :]:
        segment["start"] -= d["period"]
        segment["end"] -= d["period"]


def improved_criterion(d: dict) -> None:
    d["criteria"]["optimum"]["geometric"]["a"] *= 0.999


TAMPERED = {
    "coefficient": (coefficient, "criterion optimum.|jumps"),
    "jump": (jump, "position of joint_2 jumps by 1e-06 from approach to ramp_in"),
    "moving start": (moving_start, "joint_1 is not at rest at the start"),
    "moving end": (moving_end, "joint_2 is not at rest at the end"),
    "odd rate": (odd_rate, "the period 2 s is no whole number of samples at 99.3 Hz"),
    "single period": (single_period, "1 period"),
    "improved criterion": (improved_criterion, "criterion optimum.geometric.a is"),
}


def tampered(delivery: CertifiedDesign, how: Callable[[dict], None]) -> Certificate:
    document = copy.deepcopy(json.loads(_json.dumps(delivery.trajectory.document())))
    how(document)
    return certificate(document)


@pytest.mark.parametrize("case", TAMPERED)
def test_tampering_is_reported_as_a_fault(delivery, case):
    how, words = TAMPERED[case]
    certificate = tampered(delivery, how)
    assert not certificate.ok
    assert any(re.search(words, fault) for fault in certificate.faults), certificate.faults


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("key", ["sine", "cosine", "offset"])
def test_changed_coefficient_is_detected(delivery, joint, key):
    def tamper(d):
        entry = d[key][joint]
        d[key][joint] = [1.01 * entry[0], *entry[1:]] if isinstance(entry, list) else 1.01 * entry

    assert not tampered(delivery, tamper).ok


@pytest.mark.parametrize("quantity", ["velocity", "jerk", "torque"])
@pytest.mark.parametrize("factor", [0.5, 1000.0])
def test_limit_that_differs_from_its_source_is_a_fault(delivery, quantity, factor):
    def tamper(d):
        d["limits"][quantity]["joint_2"]["value"] *= factor

    certificate = tampered(delivery, tamper)
    assert not certificate.ok and any(
        f"the {quantity} limit of 'joint_2'" in fault for fault in certificate.faults
    )


@pytest.mark.parametrize("quantity", ["position", "velocity", "jerk", "torque"])
def test_limit_below_the_reached_value_fails(delivery, quantity):
    trajectory = delivery.trajectory
    robot = trajectory.load_robot()
    reached = {m.joint: abs(m.value) for m in delivery.certificate.margins if m.limit == quantity}
    size = 0.99 * np.array([reached[joint] for joint in robot.joints])
    lowered = {quantity: np.column_stack([-size, size]) if quantity == "position" else size}
    certificate = certificate_module.verify(trajectory, robot, replace(resolve(robot), **lowered))
    assert not certificate.ok and certificate.limits is certificate_module.CertificateVerdict.FAILED
    assert {m.limit for m in certificate.margins if m.free_share < 0} == {quantity}


def test_removed_limit_is_a_fault(braked):
    def tamper(d):
        d["limits"]["braking"] = {
            j: {**entry, "offset": 0.0} for j, entry in d["limits"]["braking"].items()
        }

    certificate = tampered(braked, tamper)
    assert not certificate.ok and any("braking limit" in fault for fault in certificate.faults)


def test_promised_margin_is_required(delivery):
    def tamper(d):
        d["design"]["margin"]["velocity"] = 0.5

    certificate = tampered(delivery, tamper)
    assert (
        not certificate.ok
        and certificate.worst().limit == "velocity"
        and "should stay free" in certificate.failure_reason()
    )


def test_design_keeps_its_margin(delivery):
    kept = {m.limit: m.free_share for m in reversed(delivery.certificate.margins)}
    assert all(kept[kind] >= 0.02 - 1e-9 for kind in ("velocity", "acceleration", "jerk", "torque"))
    assert "-0" not in " ".join(
        certificate_module.format_percent(share) for share in (-0.0, -1e-12, 1e-12)
    )


def spike(d: dict, joint: str, length: float, jerk: float) -> None:
    """Insert pieces of opposite jerk into a ramp that leave the state after them unchanged."""
    pieces = d["segments"][0]["profile"]["pieces"][joint]
    whole = pieces[0][0]
    pieces[:1] = [[length, jerk], [2.0 * length, -jerk], [length, jerk]] * 2 + [
        [whole - 8.0 * length, pieces[0][1]]
    ]


@pytest.mark.parametrize("length", [1e-3, 1e-4, 1e-6])
def test_jerk_spike_between_samples_is_detected(delivery, length):
    """A spike of any duration exceeds the limits, as each piece is checked and sampled."""
    certificate = tampered(delivery, lambda d: spike(d, "joint_1", length, 1e3 / length))
    broken = {m.limit for m in certificate.margins if m.free_share < 0}
    assert not certificate.ok and {"acceleration", "jerk", "torque"} <= broken


def test_changed_urdf_is_refused(delivery, tmp_path: Path):
    other = tmp_path / "two_link.urdf"
    other.write_text(locate("two_link").read_text() + "\n")
    with pytest.raises(UnusableInput, match=r"sha256 differs.* --robot"):
        delivery.trajectory.load_robot(str(other))


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda d: d.pop("sine"), "has no 'sine'"),
        (lambda d: d["sine"].pop(), "sine: should hold 2 rows, one a joint, not 1"),
        (lambda d: d["offset"].__setitem__(0, None), r"offset\[0\]: null should be a number"),
        (
            lambda d: d.update(base_frequency=1.0),
            "base_frequency: 1 rad/s is not 2π over the period of 2 s",
        ),
        (lambda d: d.update(schema="excite.trajectory/9"), "its schema is 'excite.trajectory/9'"),
        (lambda d: d["torque_noise"].clear(), "torque_noise: has no entry for the joint 'joint_1'"),
        (gap, "start: .* is not where ramp_out ends"),
    ],
)
def test_malformed_file_is_refused(delivery, change, part, tmp_path: Path):
    document = json.loads(_json.dumps(delivery.trajectory.document()))
    change(document)
    path = tmp_path / "trajectory.json"
    path.write_text(json.dumps(document))
    with pytest.raises(UnusableInput, match=part) as caught:
        trajectory_file.read_trajectory(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", ["", "[]", "{", "\x00"])
def test_file_that_is_no_trajectory_is_refused(text, tmp_path: Path):
    path = tmp_path / "trajectory.json"
    path.write_text(text)
    with pytest.raises(UnusableInput, match=r"give the trajectory.json"):
        trajectory_file.read_trajectory(path)


# bounds between samples


def dense_margins(delivery: CertifiedDesign, per_step: int = 100) -> dict[tuple[str, str], float]:
    """Return the margins to all limits of dense samples of one period and all ramps.

    Samples are `per_step` times denser than those of the certificate for torques.
    """
    trajectory, problem = delivery.trajectory, delivery.design.setup.problem
    motion, limits, robot = trajectory.motion, trajectory.limits, problem.robot
    step = motion.fourier.period / (10 * problem.options.samples * per_step)
    out: dict[tuple[str, str], float] = {}
    for segment in motion.segments:
        length = motion.fourier.period if segment.profile is None else segment.end - segment.start
        part = motion.fourier if segment.profile is None else segment.profile
        t = np.linspace(0, length, int(length / step))
        for kind, order in ORDERS.items():
            derived = [
                source == "derived" and segment.profile is None for source in limits.sources[kind]
            ]
            _record_margin(
                out, kind, robot.joints, part.at(t, order), getattr(limits, kind), derived
            )
        coarse = t[:: max(1, len(t) // 4000)]
        samples = certificate_module.Samples(*(part.at(coarse, order) for order in range(3)))
        Y = dynamics.regressor(robot, problem.parameters, samples)
        nominal, width = dynamics.band(Y, problem.parameters, problem.options.uncertainty)
        for values in (nominal + width, nominal - width):
            _record_margin(out, "torque", robot.joints, values, limits.torque, [False] * robot.n)
    return out


def _record_margin(
    out: dict,
    kind: str,
    names: tuple[str, ...],
    values: np.ndarray,
    bound: np.ndarray,
    skip: list[bool],
) -> None:
    lower, upper = bound.T if kind == "position" else (-bound, bound)
    margins = np.minimum(upper - values.max(axis=0), values.min(axis=0) - lower) / (
        0.5 * (upper - lower)
    )
    for name, margin, skipped in zip(names, margins, skip, strict=True):
        if not skipped:
            out[kind, name] = min(out.get((kind, name), np.inf), float(margin))


def test_margins_are_below_those_of_dense_samples(any_delivery):
    dense = dense_margins(any_delivery)
    claimed = {
        (m.limit, m.joint): m.free_share
        for m in any_delivery.certificate.margins
        if (m.limit, m.joint) in dense
    }
    assert set(claimed) == set(dense)
    assert all(claimed[key] <= dense[key] + 1e-12 for key in dense)


def test_margins_are_close_to_those_of_dense_samples(any_delivery):
    dense = dense_margins(any_delivery, 10)
    assert all(
        m.free_share > dense[m.limit, m.joint] - 0.1
        for m in any_delivery.certificate.margins
        if (m.limit, m.joint) in dense
    )


def test_margin_value_is_reached_at_its_time(any_delivery):
    motion = any_delivery.trajectory.motion
    for m in any_delivery.certificate.margins:
        if m.limit in ("position", "velocity", "acceleration"):
            values = motion.at(m.time + np.array([-1e-3, 0.0, 1e-3]), ORDERS[m.limit])[
                :, motion.joints.index(m.joint)
            ]
            half = abs(m.bound) if m.limit != "position" else 1.0
            assert np.abs(values - m.value).min() < 0.02 * half, m


@pytest.mark.parametrize("seed", range(5))
def test_intersample_bound_holds_for_smooth_and_kinked_functions(seed):
    rng = np.random.default_rng(seed)

    def smooth(t):
        return np.sum(
            [a * np.sin(w * t + p) for a, w, p in zip(rng_a, rng_w, rng_p, strict=True)], axis=0
        )

    rng_a, rng_w, rng_p = rng.normal(size=4), rng.uniform(0.5, 12, 4), rng.uniform(0, 6, 4)
    coarse, kink = np.linspace(0, 2, 201), rng.uniform(0.3, 1.7)
    fine = np.linspace(0, 2, 20001)
    blocks = np.repeat(np.arange(3), 67)  # no differences across the ends of blocks
    for function in (smooth, lambda t: 3 * np.abs(t - kink)):
        ends = np.concatenate([function(coarse[blocks == k]) for k in range(3)])[:, None]
        separate = np.concatenate(
            [constraint_margins.intersample_bound(ends[blocks == k]) for k in range(3)]
        )
        assert np.array_equal(constraint_margins.intersample_bound(ends, blocks), separate)
        values, between = function(coarse), function(fine).reshape(-1)
        more = constraint_margins.intersample_bound(values[:, None])[:, 0]
        cell = np.minimum((fine / coarse[1]).astype(int), 199)
        highest = np.maximum((values + more)[cell], (values + more)[cell + 1])
        lowest = np.minimum((values - more)[cell], (values - more)[cell + 1])
        assert (between <= highest + 1e-12).all() and (between >= lowest - 1e-12).all()


def test_torque_above_its_limit_between_samples_fails(delivery, monkeypatch):
    trajectory = delivery.trajectory
    robot = trajectory.load_robot()
    with monkeypatch.context() as without:
        without.setattr(
            constraint_margins,
            "intersample_bound",
            lambda values, blocks=None: np.zeros_like(values),
        )
        sampled = {
            m.joint: abs(m.value) for m in verified(trajectory).margins if m.limit == "torque"
        }
    just_above = np.array([sampled[joint] * (1 + 1e-9) for joint in trajectory.joints])
    certificate = certificate_module.verify(
        trajectory, robot, replace(resolve(robot), torque=just_above)
    )
    assert {m.limit for m in certificate.margins if m.free_share < 0} == {"torque"}


@pytest.mark.parametrize("side", [0, 1])
def test_braking_limit_is_reached_at_its_velocity(braked, side):
    trajectory = braked.trajectory
    constraints = certificate_module.motion_constraints(
        trajectory, trajectory.load_robot(), trajectory.limits
    )
    sign, brakes = (-1.0, 1.0)[side], trajectory.limits.braking
    q = np.tile([b.stop[side] - sign * 0.3 for b in brakes], (3, 1))
    dq = np.tile([sign * (-b.offset + np.sqrt(0.3 * b.rate)) for b in brakes], (3, 1))
    quantity = constraint_margins.braking_quantity(
        constraints, certificate_module.Samples(q, dq, 0 * q)
    )
    assert np.allclose(
        (quantity.low, quantity.high)[side], (quantity.lower, quantity.upper)[side], rtol=1e-12
    )


# ramps


def test_ramp_extremes_equal_those_of_ruckig(two_link, table, monkeypatch):
    pairs = []
    original = ramps.profile_from_ruckig

    def recorded(begin, planned):
        profile = original(begin, planned)
        pairs.append((profile, planned.duration, planned.position_extrema))
        return profile

    monkeypatch.setattr(ramps, "profile_from_ruckig", recorded)
    pipeline.design_trajectory(
        two_link, table, replace(QUICK, iterations=10), start=np.array([-1.5, 0.3])
    )
    assert pairs
    for profile, duration, extrema in pairs:
        t = np.union1d(
            np.linspace(0, duration, 20001), profile.knots()[profile.knots() <= duration]
        )
        q = profile.at(t)
        assert np.allclose(q.max(axis=0), [e.max for e in extrema], atol=1e-6)
        assert np.allclose(q.min(axis=0), [e.min for e in extrema], atol=1e-6)


def test_certificate_bounds_the_extremes_of_ramps(two_link, table, monkeypatch):
    reached = {}
    original = ramps.profile_from_ruckig

    def recorded(begin, planned):
        profile = original(begin, planned)
        reached[id(profile)] = (profile, [(e.min, e.max) for e in planned.position_extrema])
        return profile

    monkeypatch.setattr(ramps, "profile_from_ruckig", recorded)
    trajectory = pipeline.design_trajectory(
        two_link, table, replace(QUICK, iterations=10), start=np.array([-1.5, 0.3])
    ).trajectory
    constraints = certificate_module.motion_constraints(trajectory, two_link, trajectory.limits)
    used = [
        s for s in trajectory.motion.segments if s.profile is not None and id(s.profile) in reached
    ]
    assert used
    for segment in used:
        quantity = next(
            d
            for _, d in certificate_module.segment_quantities(constraints, trajectory, segment)
            if d.limit == "position"
        )
        lowest, highest = np.array(reached[id(segment.profile)][1]).T
        assert (quantity.high.max(axis=0) >= highest - 1e-12).all() and (
            quantity.low.min(axis=0) <= lowest + 1e-12
        ).all()


def test_huge_jerk_limits_are_reduced_for_ruckig():
    """Limits files may state a huge jerk for no limit."""
    panda = load("panda")
    limits = replace(resolve(panda), jerk=np.full(panda.n, 1e9))
    delivery = pipeline.design_trajectory(
        panda, limits, replace(QUICK, period=6.0, samples=60, iterations=5)
    )
    profiles = [s.profile for s in delivery.trajectory.motion.segments if s.profile is not None]
    largest_jerk = np.max(
        [
            [max(abs(jerk) for _, jerk in pieces) for pieces in profile.pieces]
            for profile in profiles
        ],
        axis=0,
    )
    assert (
        delivery.certificate.ok
        and (largest_jerk <= ramps.MAX_JERK_RATIO * limits.acceleration).all()
    )


def test_ramps_keep_boxes(two_link, table):
    low = WorkspaceBox("tip", (-1.0, -0.1, -1.0), (1.0, 0.1, 0.2))
    delivery = pipeline.design_trajectory(
        two_link, table, replace(QUICK, boxes=(low,)), start=np.array([-1.5, 0.3])
    )
    motion = delivery.trajectory.motion
    heights = dynamics.positions(two_link, "tip", motion.at(np.linspace(0, motion.duration, 4001)))[
        :, 2
    ]
    assert delivery.certificate.ok and heights.max() <= 0.2


def test_derived_limits_do_not_restrict_the_periodic_part(two_link, table):
    bare = replace(table, acceleration=np.full(2, np.inf), jerk=np.full(2, np.inf))
    delivery = pipeline.design_trajectory(two_link, bare, replace(QUICK, iterations=10))
    derived: Limits = ramps.with_derived_limits(bare, delivery.design.motion)
    motion = delivery.design.motion
    t = motion.grid(2000)
    assert (1.2 * np.abs(motion.at(t, 2)).max(axis=0) <= derived.acceleration * (1 + 1e-2)).all()
    titles = {margin.limit: margin.title for margin in delivery.certificate.margins}
    assert titles["acceleration"] == "acceleration (ramps)"
    assert titles["velocity"] == "velocity"
    verification = VerificationResult(delivery.certificate, delivery.trajectory, two_link, derived)
    assert "\nacceleration (ramps) joint_" in verification.text()


def test_oversampling_of_the_certificate_is_accurate():
    assert oversampling_bound(10 * 200, 5) - 1 < 1e-4


def test_friction_at_reversals_is_bounded_tightly():
    """The jump of Coulomb friction between two samples is bounded by its two sides."""
    machine = loaded(pendulum(LIMIT + '<dynamics friction="8" damping="0.1"/>'))
    standard = inertial_parameters.standard_parameters(machine, resolve(machine))
    constraints = constraint_margins.MotionConstraints(machine, resolve(machine), standard)
    motion = FourierSeries(np.array([[0.5]]), np.array([[0.2]]), np.array([0.3]), 4.0)
    coarse, dense = (motion.samples(motion.grid(n)) for n in (400, 200_000))
    bound = float(constraint_margins.torque_quantity(constraints, coarse).high.max())
    true = float((dynamics.regressor(machine, standard, dense) @ standard.nominal).max())
    assert true <= bound <= 1.02 * true


def test_robot_with_a_locked_mimic_joint():
    body = (
        '<inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    pair = "".join(
        f'<link name="{child}">{body}</link><joint name="{name}" type="revolute">'
        f'<parent link="arm"/><child link="{child}"/>'
        f'<limit lower="-1" upper="1" velocity="1" effort="1"/>{mimic}</joint>'
        for name, child, mimic in (
            ("grip", "finger", ""),
            ("follow", "thumb", '<mimic joint="grip"/>'),
        )
    )
    machine = loaded(pendulum().replace("</robot>", pair + "</robot>"), lock={"grip": 0.3})
    assert machine.joints == ("swing",)
    assert machine.options["locked"] == {"grip": 0.3}
