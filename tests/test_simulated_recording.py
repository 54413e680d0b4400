"""Commanded motion, measurement chain and reproducibility of simulated recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco")

from simulated_robots import TRAJECTORIES, builtin_urdf, quick_motion

from excite.errors import UnusableInput
from excite.simulator import experiment, reference_trajectory, urdf_tree
from excite.simulator.experiment import ExperimentSettings
from excite.simulator.measurement import MeasurementChain, coloured_noise
from excite.simulator.reference_trajectory import ReferenceTrajectory


@pytest.fixture(scope="module")
def robot_session():
    motion, setting = quick_motion(), ExperimentSettings(seed=3)
    robot = experiment.build_robot(builtin_urdf("two_link"), motion, setting)
    return robot, motion, setting, experiment.run_session(robot, motion, setting)


@pytest.mark.parametrize("name", ["two_link", "ur10e"])
def test_trajectory_is_replayed_as_designed(name):
    from excite.trajectory import trajectory_file

    path = TRAJECTORIES / f"{name}.json"
    designed, replayed = (
        trajectory_file.read_trajectory(path).motion,
        reference_trajectory.read_reference(path),
    )
    t = np.linspace(0.0, designed.duration, 777)
    for order, values in enumerate(replayed.at(t)[:2]):
        np.testing.assert_allclose(values, designed.at(t, order), atol=1e-9)
    more = reference_trajectory.read_reference(path, designed.periods + 1)
    assert more.duration == pytest.approx(designed.duration + designed.fourier.period)
    assert np.abs(np.diff(more.at(np.linspace(0, more.duration, 5000))[0], axis=0)).max() < 0.05


def test_payload_of_the_trajectory_is_attached():
    payload = {
        "link": "link_2",
        "mass": 1.5,
        "centre": [0.1, 0.0, 0.05],
        "inertia": [0.01, 0.001, 0.02, 0.0, 0.0, 0.015],
    }
    tree = urdf_tree.read_urdf(builtin_urdf("two_link"))
    name = tree.child_link("joint_2")
    motion = replace(quick_motion(), robot={"payload": {**payload, "link": name}})
    robot = experiment.build_robot(
        builtin_urdf("two_link"), motion, ExperimentSettings(model_error=0.0)
    )
    from excite.robot.robot import Payload, load

    model = load(
        "two_link",
        payload=Payload(name, 1.5, (0.1, 0.0, 0.05), (0.01, 0.001, 0.02, 0.0, 0.0, 0.015)),
    ).model
    q, v, a = np.random.default_rng(0).normal(size=(3, 5, 2))
    expected = [pin.rnea(model, model.createData(), *row) for row in zip(q, v, a, strict=True)]
    np.testing.assert_allclose(robot.dynamics().inverse_dynamics(q, v, a), expected, atol=1e-10)


def test_unusable_urdf_is_refused(tmp_path):
    from tests.conftest import document, joint, link

    mimic = tmp_path / "mimic.urdf"
    parts = (
        link("b"),
        link("x", 1.0),
        link("y", 1.0),
        joint("j", "b", "x"),
        joint("k", "x", "y", inside='<mimic joint="j"/>'),
    )
    mimic.write_text(document(*parts))
    with pytest.raises(UnusableInput, match="'k' is a mimic"):
        urdf_tree.read_urdf(mimic)
    fixed = document(*parts).replace('name="k" type="revolute"', 'name="k" type="fixed"')
    assert urdf_tree.parse_urdf(fixed, "fixed.urdf").joints == ("j",)
    (tmp_path / "no.urdf").write_text("<sdf/>")
    with pytest.raises(UnusableInput, match="not <robot>"):
        urdf_tree.read_urdf(tmp_path / "no.urdf")
    with pytest.raises(UnusableInput, match="no velocity or torque limit"):
        urdf_tree.UrdfTree(
            "text",
            urdf_tree.ElementTree.fromstring(
                document(link("b"), link("x", 1.0), joint("j", "b", "x", inside=""))
            ),
        ).velocity_and_torque_limit("j")


def test_noise_has_stated_size_and_spectrum():
    rng = np.random.default_rng(0)
    for colour in (None, 8.0):
        chain = MeasurementChain(500.0, np.array([2.0]), colour)
        noise = 2.0 * coloured_noise((200_000, 1), 500.0, colour, rng)
        assert np.std(noise) == pytest.approx(2.0, rel=0.05)
        spectrum = np.abs(np.fft.rfft(noise[:, 0])) ** 2
        below = spectrum[: int(len(spectrum) * 20.0 / 250.0)].sum() / spectrum.sum()
        assert chain.noise_floor(20.0)[0] == pytest.approx(2.0 * np.sqrt(below), rel=0.05)


def test_measurement_quantises_positions_and_jitters_times(robot_session):
    robot, motion, setting, bare = robot_session
    coarse = experiment.run_session(
        robot, motion, replace(setting, encoder=1e-3), motion=bare.motion
    )
    assert np.abs(coarse.recording.q / 1e-3 - np.round(coarse.recording.q / 1e-3)).max() < 1e-6
    late = experiment.run_session(robot, motion, replace(setting, jitter=1e-3), motion=bare.motion)
    assert (late.recording.t == bare.recording.t).all() and 1e-4 < np.abs(
        late.recording.q - bare.recording.q
    ).max() < 2e-2
    assert len(bare.recording.to_csv().splitlines()[1]) == len(
        bare.recording.to_csv().splitlines()[-1]
    )


def test_same_seed_gives_same_recording():
    motion, setting = quick_motion(1.5), ExperimentSettings(seed=11)
    first, second = (
        experiment.run_session(
            experiment.build_robot(builtin_urdf("two_link"), motion, setting), motion, setting
        )
        for _ in range(2)
    )
    assert first.recording.to_csv() == second.recording.to_csv() and first.truth == second.truth
    assert first.truth["seed"] == 11


def test_noise_depends_on_the_motion():
    """Recordings of one seed must not share their noise."""
    setting = ExperimentSettings(seed=11, noise=0.01)

    def noise(motion: ReferenceTrajectory) -> np.ndarray:
        robot = experiment.build_robot(builtin_urdf("two_link"), motion, setting)
        silent, noisy = (
            experiment.run_session(robot, motion, replace(setting, noise=level))
            for level in (0.0, 0.01)
        )
        return noisy.recording.tau - silent.recording.tau

    first, again, other = (
        noise(quick_motion(1.5)),
        noise(quick_motion(1.5)),
        noise(quick_motion(1.5, seed=1)),
    )
    assert (first == again).all() and len(first) == len(other)
    assert abs(np.corrcoef(first[:, 0], other[:, 0])[0, 1]) < 0.2
    assert (first.std(axis=0) > 0.0).all()
