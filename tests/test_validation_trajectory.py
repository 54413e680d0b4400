"""A second motion that judges a model honestly: what a fit on the first swallowed comes back on it."""

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
        first, two_link, lambda apart: pipeline.design_trajectory(two_link, table, OPTIONS, overlap_penalty=apart)
    )


# -- what it is ----------------------------------------------------------------------------------------------------


def test_it_is_certified_asks_for_the_same_and_goes_elsewhere(first, second):
    assert second.delivery.certificate.ok
    assert second.values[1] < 1.5 * second.values[0]
    assert second.other_starts is not None
    assert second.similarity.overlap < second.other_starts.overlap
    gauge = motion_overlap.StateScaling.for_robot(first.design.setup.problem.robot, first.trajectory.limits)
    assert second.similarity.overlap == pytest.approx(
        motion_overlap.compute_overlap(gauge, first.design.motion, second.delivery.design.motion)
    )


def test_one_seed_gives_one_second_motion_from_starts_of_its_own(two_link, table, first, second):
    again = validation_trajectory.design_validation(
        first, two_link, lambda apart: pipeline.design_trajectory(two_link, table, OPTIONS, overlap_penalty=apart)
    )
    assert np.array_equal(again.delivery.design.motion.sine, second.delivery.design.motion.sine)
    assert {a.number for a in second.delivery.design.attempts} == {2, 3}


def test_without_another_start_nothing_is_compared(two_link, table):
    options = replace(OPTIONS, starts=1, iterations=5)
    run = partial(pipeline.design_trajectory, two_link, table, options)
    alone = validation_trajectory.design_validation(run(), two_link, lambda apart: run(overlap_penalty=apart))
    assert alone.other_starts is None and alone.design_entry()["independent"] is None
    assert "another start" not in alone.summary()


def test_both_files_say_what_they_are_to_each_other(first, second):
    one, other = second.annotate(first.trajectory).design, second.trajectory.design
    assert one["validation"] == other["validation"] == second.design_entry()
    assert other["validates"] == "../trajectory.json" and "validates" not in one
    assert set(second.design_entry()["torque_correlation"]) == set(first.trajectory.joints)


def test_torque_correlation_is_one_for_the_same_motion_later_and_less_for_another(
    two_link, first, second
):
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


def test_it_is_the_price_that_drives_them_apart(two_link, table, first):
    gauge = motion_overlap.StateScaling.for_robot(two_link, table)
    found: list[FourierSeries] = []
    for weight in (0.0, 4.0):
        kept = replace(motion_overlap.penalise_overlap(gauge, first.design.motion), weight=weight)
        found.append(pipeline.design_trajectory(two_link, table, OPTIONS, overlap_penalty=kept).design.motion)
    values = [motion_overlap.compute_overlap(gauge, first.design.motion, motion) for motion in found]
    assert values[1] < 0.8 * values[0]


# -- what it is for ------------------------------------------------------------------------------------------------


class Lab:
    """A simulated robot that is not the nominal one, recorded with noise, and its identification by least squares."""

    def __init__(self, robot: Robot, limits: Limits, rng: np.random.Generator) -> None:
        self.robot, self.rng = robot, rng
        self.standard = inertial_parameters.standard(robot, limits)
        self.base = base_parameters.find(robot, self.standard, limits)
        self.noise = 0.01 * limits.torque
        direction = rng.normal(size=self.standard.count)
        self.truth = self.standard.nominal + 0.3 * self.standard.scale @ direction / np.linalg.norm(
            direction
        )

    def record(self, motion: Motion, effect: float, phase: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows and torque, both over the noise. effect: of friction that depends on position, in noises."""
        samples: Samples = motion.samples(motion.grid(RATE))
        Y = dynamics.regressor(self.robot, self.standard, samples)
        torque = Y @ self.truth / self.noise + effect * np.sin(samples.q + phase) * np.tanh(
            samples.dq / 0.02
        )
        rows = (Y / self.noise[:, None]).reshape(-1, Y.shape[2]) @ self.base.geometric
        return rows, (torque + self.rng.normal(size=torque.shape)).ravel()

    def errors(self, fitted: Motion, judged: list[Motion], effect: float) -> np.ndarray:
        """RMS over noise of what a fit leaves in its own recording, then in others. Means over phases of the effect."""
        squares = []
        for phase in np.linspace(0.0, np.pi, 6, endpoint=False):
            rows, torque = self.record(fitted, effect, phase)
            found = np.linalg.lstsq(rows, torque, rcond=None)[0]
            left = [torque - rows @ found]
            for motion in judged:
                rows, torque = self.record(motion, effect, phase)
                left.append(torque - rows @ found)
            squares.append([np.mean(r**2) for r in left])
        return np.sqrt(np.mean(squares, axis=0))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_right_model_predicts_the_second_motion_to_the_noise(
    two_link, table, first, second, seed
):
    lab = Lab(two_link, table, np.random.default_rng(seed))
    own, held_out = lab.errors(first.trajectory.motion, [second.delivery.trajectory.motion], 0.0)
    assert own == pytest.approx(1.0, abs=0.05)
    assert held_out == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_effect_that_the_model_lacks_shows_on_the_second_motion_and_hides_in_a_repeat(
    two_link, table, first, second, seed
):
    lab = Lab(two_link, table, np.random.default_rng(seed))
    motion = first.trajectory.motion
    own, repeat, held_out = lab.errors(motion, [motion, second.delivery.trajectory.motion], 5.0)
    assert own > 1.3  # the effect is there
    assert repeat < 1.03 * own
    assert held_out > 1.2 * own
