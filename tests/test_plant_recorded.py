"""What a simulated robot is told to do, and what its chain of measurement makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco")

from test_plant import TRAJECTORIES, swing, urdf

from excite.errors import UnusableInput
from excite.simulator import experiment, reference_trajectory
from excite.simulator import urdf_tree as trees
from excite.simulator.experiment import ExperimentSettings
from excite.simulator.measurement import MeasurementChain, coloured_noise
from excite.simulator.reference_trajectory import ReferenceTrajectory


@pytest.fixture(scope="module")
def bench():
    motion, setting = swing(), ExperimentSettings(seed=3)
    plant = experiment.build_robot(urdf("two_link"), motion, setting)
    return plant, motion, setting, experiment.run_session(plant, motion, setting)


@pytest.mark.parametrize("name", ["two_link", "ur10e"])
def test_a_trajectory_is_replayed_as_designed(name):
    from excite.trajectory import trajectory_file

    path = TRAJECTORIES / f"{name}.json"
    designed, replayed = trajectory_file.read_trajectory(path).motion, reference_trajectory.read_reference(path)
    t = np.linspace(0.0, designed.duration, 777)
    for order, values in enumerate(replayed.at(t)[:2]):
        np.testing.assert_allclose(values, designed.at(t, order), atol=1e-9)
    more = reference_trajectory.read_reference(path, designed.periods + 1)
    assert more.duration == pytest.approx(designed.duration + designed.fourier.period)
    assert np.abs(np.diff(more.at(np.linspace(0, more.duration, 5000))[0], axis=0)).max() < 0.05


def test_the_body_a_trajectory_was_designed_with_is_carried():
    stated = {
        "link": "link_2",
        "mass": 1.5,
        "centre": [0.1, 0.0, 0.05],
        "inertia": [0.01, 0.001, 0.02, 0.0, 0.0, 0.015],
    }
    tree = trees.read_urdf(urdf("two_link"))
    name = tree.child("joint_2")
    motion = replace(swing(), robot={"payload": {**stated, "link": name}})
    plant = experiment.build_robot(urdf("two_link"), motion, ExperimentSettings(model_error=0.0))
    from excite.robot.robot import Payload, load

    model = load(
        "two_link",
        payload=Payload(name, 1.5, (0.1, 0.0, 0.05), (0.01, 0.001, 0.02, 0.0, 0.0, 0.015)),
    ).model
    q, v, a = np.random.default_rng(0).normal(size=(3, 5, 2))
    expected = [pin.rnea(model, model.createData(), *row) for row in zip(q, v, a, strict=True)]
    np.testing.assert_allclose(plant.arm().inverse(q, v, a), expected, atol=1e-10)


def test_what_the_plant_cannot_read_is_refused(tmp_path):
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
        trees.read_urdf(mimic)
    (tmp_path / "no.urdf").write_text("<sdf/>")
    with pytest.raises(UnusableInput, match="not <robot>"):
        trees.read_urdf(tmp_path / "no.urdf")
    with pytest.raises(UnusableInput, match="no velocity or torque limit"):
        trees.UrdfTree(
            "text",
            trees.ElementTree.fromstring(
                document(link("b"), link("x", 1.0), joint("j", "b", "x", inside=""))
            ),
        ).limits("j")


def test_noise_has_its_size_and_colour():
    rng = np.random.default_rng(0)
    for colour in (None, 8.0):
        chain = MeasurementChain(500.0, np.array([2.0]), colour)
        noise = 2.0 * coloured_noise((200_000, 1), 500.0, colour, rng)
        assert np.std(noise) == pytest.approx(2.0, rel=0.05)
        spectrum = np.abs(np.fft.rfft(noise[:, 0])) ** 2
        below = spectrum[: int(len(spectrum) * 20.0 / 250.0)].sum() / spectrum.sum()
        assert chain.floor(20.0)[0] == pytest.approx(2.0 * np.sqrt(below), rel=0.05)


def test_the_chain_quantises_and_jitters(bench):
    plant, motion, setting, bare = bench
    coarse = experiment.run_session(plant, motion, replace(setting, encoder=1e-3), run=bare.run)
    assert np.abs(coarse.recording.q / 1e-3 - np.round(coarse.recording.q / 1e-3)).max() < 1e-6
    late = experiment.run_session(plant, motion, replace(setting, jitter=1e-3), run=bare.run)
    assert (late.recording.t == bare.recording.t).all() and 1e-4 < np.abs(
        late.recording.q - bare.recording.q
    ).max() < 2e-2
    assert len(bare.recording.csv().splitlines()[1]) == len(bare.recording.csv().splitlines()[-1])


def test_one_seed_gives_one_recording():
    motion, setting = swing(1.5), ExperimentSettings(seed=11)
    first, second = (
        experiment.run_session(experiment.build_robot(urdf("two_link"), motion, setting), motion, setting)
        for _ in range(2)
    )
    assert first.recording.csv() == second.recording.csv() and first.truth == second.truth
    assert first.truth["seed"] == 11


def test_noise_of_another_motion_is_another_and_of_the_same_motion_the_same():
    """What is seen in two recordings of one seed must not be what they were drawn from."""
    setting = ExperimentSettings(seed=11, noise=0.01)

    def noise(motion: ReferenceTrajectory) -> np.ndarray:
        plant = experiment.build_robot(urdf("two_link"), motion, setting)
        silent, loud = (
            experiment.run_session(plant, motion, replace(setting, noise=level))
            for level in (0.0, 0.01)
        )
        return loud.recording.tau - silent.recording.tau

    first, again, other = noise(swing(1.5)), noise(swing(1.5)), noise(swing(1.5, seed=1))
    assert (first == again).all() and len(first) == len(other)
    assert abs(np.corrcoef(first[:, 0], other[:, 0])[0, 1]) < 0.2
    assert (first.std(axis=0) > 0.0).all()
