"""Validation motion: errors that a fit has absorbed on the first motion are visible on it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from conftest import off

from excite.designer import motion_overlap, pipeline, validation_trajectory
from excite.designer.options import DesignOptions
from excite.designer.pipeline import CertifiedDesign
from excite.designer.validation_trajectory import ValidationDesign, torque_correlation
from excite.robot import base_parameters, dynamics, inertial_parameters
from excite.robot.limits import Limits
from excite.robot.robot import Robot
from excite.robot.samples import Samples
from excite.trajectory.fourier import FourierSeries
from excite.trajectory.rest_to_rest import Motion

OPTIONS = DesignOptions(period=5.2, starts=2, iterations=80, jobs=1)
RATE = 50.0


@pytest.fixture(scope="module")
def first(two_link: Robot, table: Limits) -> CertifiedDesign:
    return pipeline.design_trajectory(two_link, table, OPTIONS)


@pytest.fixture(scope="module")
def second(two_link: Robot, table: Limits, first: CertifiedDesign) -> ValidationDesign:
    return validation_trajectory.design_validation(
        first,
        two_link,
        lambda penalty: pipeline.design_trajectory(
            two_link, table, OPTIONS, overlap_penalty=penalty
        ),
    )


# design of the motion


def test_validation_motion_is_certified_informative_and_different(first, second):
    assert second.delivery.certificate.ok
    assert second.values[1] < 1.5 * second.values[0]
    assert second.other_starts is not None
    assert second.similarity.overlap < second.other_starts.overlap
    scaling = motion_overlap.StateScaling.for_robot(
        first.design.setup.problem.robot, first.trajectory.limits
    )
    assert second.similarity.overlap == pytest.approx(
        motion_overlap.compute_overlap(scaling, first.design.motion, second.delivery.design.motion)
    )


def test_same_seed_gives_the_same_validation_motion_from_other_starts(
    two_link, table, first, second
):
    again = validation_trajectory.design_validation(
        first,
        two_link,
        lambda penalty: pipeline.design_trajectory(
            two_link, table, OPTIONS, overlap_penalty=penalty
        ),
    )
    assert np.array_equal(again.delivery.design.motion.sine, second.delivery.design.motion.sine)
    assert {a.number for a in second.delivery.design.attempts} == {2, 3}


def test_no_comparison_without_another_start(two_link, table):
    options = replace(OPTIONS, starts=1, iterations=5)
    run = partial(pipeline.design_trajectory, two_link, table, options)
    alone = validation_trajectory.design_validation(
        run(), two_link, lambda penalty: run(overlap_penalty=penalty)
    )
    assert alone.other_starts is None and alone.design_entry()["independent"] is None
    assert "another start" not in alone.summary()


def test_both_files_describe_the_pair(first, second):
    training, validation = second.annotate(first.trajectory).design, second.trajectory.design
    assert training["validation"] == validation["validation"] == second.design_entry()
    assert validation["validates"] == "../trajectory.json"
    assert "validates" not in training
    assert set(second.design_entry()["torque_correlation"]) == set(first.trajectory.joints)


def test_torque_correlation_is_one_only_for_the_same_motion(two_link, first, second):
    standard, motion = first.design.setup.problem.parameters, first.design.motion
    assert torque_correlation(
        two_link, standard, motion, motion.shifted(motion.period / 8.0)
    ) == pytest.approx(1.0, abs=1e-6)
    other = torque_correlation(two_link, standard, motion, second.delivery.design.motion)
    assert ((other > 0.0) & (other < 0.98)).all()
    assert (
        off(torque_correlation(two_link, standard, second.delivery.design.motion, motion), other)
        < 1e-9
    )


def test_penalty_reduces_the_overlap(two_link, table, first):
    scaling = motion_overlap.StateScaling.for_robot(two_link, table)
    motions: list[FourierSeries] = []
    for weight in (0.0, 4.0):
        penalty = replace(
            motion_overlap.penalise_overlap(scaling, first.design.motion), weight=weight
        )
        motions.append(
            pipeline.design_trajectory(
                two_link, table, OPTIONS, overlap_penalty=penalty
            ).design.motion
        )
    values = [
        motion_overlap.compute_overlap(scaling, first.design.motion, motion) for motion in motions
    ]
    assert values[1] < 0.8 * values[0]


# validation of a model


class SimulatedLaboratory:
    """Simulated robot with perturbed parameters, its noisy recordings and least-squares fits."""

    def __init__(self, robot: Robot, limits: Limits, rng: np.random.Generator) -> None:
        self.robot, self.rng = robot, rng
        self.standard = inertial_parameters.standard_parameters(robot, limits)
        self.base = base_parameters.find(robot, self.standard, limits)
        self.noise = 0.01 * limits.torque
        direction = rng.normal(size=self.standard.count)
        self.truth = self.standard.nominal + 0.3 * self.standard.scale @ direction / np.linalg.norm(
            direction
        )

    def record(self, motion: Motion, effect: float, phase: float) -> tuple[np.ndarray, np.ndarray]:
        """Return regressor rows and torque, both over the noise.

        `effect` is the amplitude of position-dependent friction over the noise.
        """
        samples: Samples = motion.samples(motion.grid(RATE))
        Y = dynamics.regressor(self.robot, self.standard, samples)
        torque = Y @ self.truth / self.noise + effect * np.sin(samples.q + phase) * np.tanh(
            samples.dq / 0.02
        )
        rows = (Y / self.noise[:, None]).reshape(-1, Y.shape[2]) @ self.base.geometric
        return rows, (torque + self.rng.normal(size=torque.shape)).ravel()

    def errors(self, fitted: Motion, judged: list[Motion], effect: float) -> np.ndarray:
        """Return the RMS residual over the noise of a fit, on its own recording and on others.

        The mean square over phases of the effect is taken.
        """
        squares = []
        for phase in np.linspace(0.0, np.pi, 6, endpoint=False):
            rows, torque = self.record(fitted, effect, phase)
            estimate = np.linalg.lstsq(rows, torque, rcond=None)[0]
            residuals = [torque - rows @ estimate]
            for motion in judged:
                rows, torque = self.record(motion, effect, phase)
                residuals.append(torque - rows @ estimate)
            squares.append([np.mean(r**2) for r in residuals])
        return np.sqrt(np.mean(squares, axis=0))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_correct_model_predicts_the_validation_motion_to_the_noise(
    two_link, table, first, second, seed
):
    lab = SimulatedLaboratory(two_link, table, np.random.default_rng(seed))
    training, held_out = lab.errors(
        first.trajectory.motion, [second.delivery.trajectory.motion], 0.0
    )
    assert training == pytest.approx(1.0, abs=0.05)
    assert held_out == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_missing_effect_is_visible_in_validation_but_not_in_a_repeat(
    two_link, table, first, second, seed
):
    lab = SimulatedLaboratory(two_link, table, np.random.default_rng(seed))
    motion = first.trajectory.motion
    training, repeat, held_out = lab.errors(
        motion, [motion, second.delivery.trajectory.motion], 5.0
    )
    assert training > 1.3  # the effect is present
    assert repeat < 1.03 * training
    assert held_out > 1.2 * training
