"""Ramps along the path of the periodic motion: derivatives, bounds, files, exports, certificate."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import QUICK, off, slope, verified
from hypothesis import given
from hypothesis import strategies as st
from test_export import run, trajectory_of

from excite import _json, exporters
from excite.designer import constraint_margins, phase_ramps, pipeline, ramps
from excite.designer.pipeline import CertifiedDesign
from excite.errors import UnusableInput
from excite.exporters import urscript
from excite.simulator import reference_trajectory
from excite.trajectory import trajectory_file
from excite.trajectory.fourier import FourierSeries
from excite.trajectory.rest_to_rest import Motion, MotionSegment

seeds = st.integers(0, 10**4)


def series(seed: int, n: int = 3, harmonics: int = 4, period: float = 3.0) -> FourierSeries:
    rng = np.random.default_rng(seed)
    return FourierSeries(
        rng.normal(size=(n, harmonics)), rng.normal(size=(n, harmonics)), rng.normal(size=n), period
    )


@pytest.fixture(scope="module")
def phase_delivery(two_link, table) -> CertifiedDesign:
    """A design for which Ruckig finds no ramp."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ramps.RampPlanner, "plan_stop", lambda *_, **__: None)
        return pipeline.design_trajectory(two_link, table, QUICK)


@given(seeds, st.floats(0.2, 6.0), st.booleans(), st.integers(0, 2))
def test_each_order_is_the_derivative_of_the_previous_order(seed, duration, inwards, order):
    ramp = phase_ramps.phase_profile(series(seed), duration, inwards=inwards)
    for t in (0.1 * duration, 0.3 * duration, 0.8 * duration):
        numeric = slope(lambda h, t=t: ramp.at(np.array([t + h]), order), 1e-3 * duration)
        exact = ramp.at(np.array([t]), order + 1)
        assert off(exact, numeric) < 1e-5 * max(1.0, np.abs(exact).max())


@given(seeds, st.floats(0.2, 6.0), st.booleans())
def test_ramp_is_at_rest_at_one_end_and_periodic_at_the_other(seed, duration, inwards):
    fourier = series(seed)
    ramp = phase_ramps.phase_profile(fourier, duration, inwards=inwards)
    still, moving = (0.0, duration) if inwards else (duration, 0.0)
    for order in (1, 2):
        assert np.abs(ramp.at(still, order)).max() < 1e-10 * 10**order
    for order in range(3):
        assert np.allclose(ramp.at(moving, order), fourier.at(0.0, order), atol=1e-9)


@given(seeds, st.floats(0.2, 6.0), st.booleans(), st.integers(1, 5))
def test_derivative_bounds_hold(seed, duration, inwards, order):
    fourier = series(seed)
    ramp = phase_ramps.phase_profile(fourier, duration, inwards=inwards)
    bound = ramp.derivative_bound(order, duration)
    t = np.linspace(0.0, duration, 401)
    if order <= 3:
        values = ramp.at(t, order)
    else:  # within one cubic of the phase, by differences of the jerk
        t = np.linspace(0.05 * duration, 0.45 * duration, 4001)
        values = np.diff(ramp.at(t, 3), order - 3, axis=0) / (t[1] - t[0]) ** (order - 3)
    assert (np.abs(values).max(axis=0) <= bound * (1.0 + 1e-4)).all()


@given(seeds, st.floats(0.2, 1.0), st.integers(0, 3))
def test_slowed_ramp_takes_the_same_path(seed, speed, order):
    ramp = phase_ramps.phase_profile(series(seed), 1.7, inwards=True)
    t = np.linspace(0.01, 1.69, 53)
    expected = ramp.at(t, order) * speed**order
    assert np.allclose(ramp.slowed(speed).at(t / speed, order), expected, atol=1e-9)


@given(seeds, st.floats(0.3, 4.0))
def test_quantities_bound_the_ramp_between_samples(two_link, table, seed, duration):
    ramp = phase_ramps.phase_profile(series(seed, n=2), duration, inwards=False)
    standard = pipeline.optimize.set_up(two_link, table, QUICK).problem.parameters
    constraints = constraint_margins.MotionConstraints(two_link, table, standard)
    t = np.linspace(0.0, duration * (1 - 1e-12), 3001)
    quantities = constraint_margins.phase_quantities(constraints, ramp, duration, 0.05)
    for order, (_, quantity) in zip(range(4), quantities, strict=False):
        values = ramp.at(t, order)
        assert (values.max(axis=0) <= quantity.high.max(axis=0) + 1e-9).all()
        assert (values.min(axis=0) >= quantity.low.min(axis=0) - 1e-9).all()


def test_design_without_ruckig_ramps_is_certified(phase_delivery):
    motion = phase_delivery.trajectory.motion
    assert phase_delivery.certificate.ok
    kinds = {s.kind: type(s.profile).__name__ for s in motion.segments}
    assert kinds["ramp_in"] == kinds["ramp_out"] == "PhaseProfile"
    t = motion.grid(100.0)
    for edge in (t[:1], t[-1:]):
        assert not motion.at(edge, 1).any() and not motion.at(edge, 2).any()


def test_motion_without_a_return_ends_where_it_began(two_link, table):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ramps.RampPlanner, "plan_transfer", lambda *_: ([], "a clearance"))
        delivery = pipeline.design_trajectory(two_link, table, QUICK)
    motion = delivery.trajectory.motion
    assert delivery.certificate.ok
    assert [s.kind for s in motion.segments] == ["ramp_in", "fourier", "ramp_out"]
    begin, end = motion.at(np.array([0.0, motion.duration]))
    assert np.allclose(begin, end, atol=1e-9)
    t = np.linspace(0.0, motion.duration * (1 - 1e-9), 4001)
    for order in range(2):  # no jump between the segments
        steps = np.abs(np.diff(motion.at(t, order), axis=0)).max()
        assert steps < 2.0 * np.abs(motion.at(t, order + 1)).max() * (t[1] - t[0])
    again = trajectory_file.parse_trajectory(
        json.loads(_json.dumps(delivery.trajectory.document())), Path("trajectory.json")
    )
    assert verified(again).ok


def test_file_with_phase_ramps_reads_back_and_is_certified(phase_delivery, tmp_path: Path):
    path = tmp_path / "trajectory.json"
    path.write_text(text := _json.dumps(phase_delivery.trajectory.document()), encoding="utf-8")
    again = trajectory_file.read_trajectory(path)
    assert _json.dumps(again.document()) == text
    assert verified(again).ok
    t = again.motion.grid(500.0)
    reference = reference_trajectory.read_reference(path)
    for order, values in enumerate(reference.at(t[1:-1])):
        assert np.allclose(values, again.motion.at(t[1:-1], order), atol=1e-9)


@pytest.mark.parametrize("factor", [2.0, 4.0])
def test_faster_phase_is_no_longer_certified(phase_delivery, factor):
    document = json.loads(_json.dumps(phase_delivery.trajectory.document()))
    segment = next(s for s in document["segments"] if s["kind"] == "ramp_in")
    phase = segment["phase"]
    phase["start"] /= factor
    phase["pieces"] = [[d / factor, j * factor**2] for d, j in phase["pieces"]]
    removed = (segment["end"] - segment["start"]) * (1.0 - 1.0 / factor)
    segment["end"] -= removed
    for later in document["segments"][document["segments"].index(segment) + 1 :]:
        later["start"], later["end"] = later["start"] - removed, later["end"] - removed
    again = trajectory_file.parse_trajectory(document, Path("trajectory.json"))
    certificate = verified(again)
    assert not certificate.ok
    assert certificate.worst().limit in ("acceleration", "jerk", "torque")


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda s: s["ramp_in"].update(phase=None), "the ramp_in has no profile"),
        (lambda s: s["fourier"].update(phase=s["ramp_in"]["phase"]), "the fourier has a phase"),
        (lambda s: s["ramp_in"]["phase"].update(rate=1.5), "phase.rate: 1.5 should be from -1 to"),
        (lambda s: s["ramp_in"]["phase"].pop("pieces"), "pieces"),
        (lambda s: s["ramp_in"]["phase"]["pieces"].append([1.0]), "should hold 2 values, not 1"),
    ],
)
def test_faulty_phase_is_refused(phase_delivery, change, problem):
    document = json.loads(_json.dumps(phase_delivery.trajectory.document()))
    change({segment["kind"]: segment for segment in document["segments"]})
    with pytest.raises(UnusableInput, match=problem):
        trajectory_file.parse_trajectory(document, Path("trajectory.json"))


def with_phase_ramps(n: int):
    fourier = series(n, n=n, harmonics=3, period=4.0)
    parts = (
        MotionSegment("ramp_in", 0.0, 1.2, phase_ramps.phase_profile(fourier, 1.2, inwards=True)),
        MotionSegment("fourier", 1.2, 9.2),
        MotionSegment(
            "ramp_out", 9.2, 10.8, phase_ramps.phase_profile(fourier, 1.6, inwards=False)
        ),
    )
    return trajectory_of(Motion(tuple(f"joint_{i + 1}" for i in range(n)), fourier, 2, parts))


@pytest.mark.parametrize(("step", "speed"), [(0.002, 1.0), (0.008, 0.3)])
def test_urscript_follows_the_phase(step, speed, tmp_path: Path):
    trajectory = with_phase_ramps(6)
    script = exporters.write(trajectory, "urscript", tmp_path / "p.script", speed=speed).read_text()
    targets, _ = run(script, step)
    motion = trajectory.motion.slowed(speed)
    t = step * np.arange(1, len(targets) + 1)
    np.testing.assert_allclose(targets, motion.at(t), atol=1e-9)
    replayed = urscript.rebuilt_motion(script)
    assert [s.kind for s in replayed.segments] == [s.kind for s in motion.segments]
    inside = t[t < motion.duration - 0.01]
    np.testing.assert_allclose(replayed.at(inside), motion.at(inside), atol=1e-9)


def test_ramps_over_one_period_together_need_no_return(two_link, table):
    """Where no return is possible, ramps of a period each begin and end at the same pose."""
    design = pipeline.design_trajectory(two_link, replace(table), QUICK).design
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ramps.RampPlanner, "plan_transfer", lambda *_: ([], "the clearance of a – b"))
        delivery = pipeline.design_trajectory(two_link, table, QUICK)
    kinds = [s.kind for s in delivery.trajectory.motion.segments]
    assert kinds == ["ramp_in", "fourier", "ramp_out"] and delivery.certificate.ok
    assert design.motion.period == delivery.design.motion.period
