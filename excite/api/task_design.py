"""Read the user's task for `excite design --for`, and predict the torque band along it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from .. import recordings
from .._types import FloatArray
from ..designer.criteria import Criterion, criterion_weighting
from ..designer.options import DesignOptions, torque_noise_levels
from ..designer.problem import DesignProblem
from ..designer.task_variance import TaskPrediction, TaskVariance, task_moment, torque_band
from ..errors import UnusableInput
from ..robot import dynamics, inertial_parameters
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..robot.samples import MIN_TRAVEL, Samples
from ..trajectory import trajectory_file
from ..trajectory.trajectory_file import Trajectory
from .identification_result import REFERENCE_RATE

MAX_TASK_SAMPLES = 4000
"""Samples of a task beyond which it is thinned out evenly [1]; the band is an average over them."""


@dataclass(frozen=True)
class TaskDesign:
    """The motion that the identified model has to predict.

    Attributes:
        source: File of the task.
        parameters: Standard parameters of the robot.
        regressor: Regressor along the task. Shape (N, n, P).
        noise: Standard deviation of the torque noise. Shape (n,) [N m].
    """

    source: str
    parameters: Parameters
    regressor: FloatArray
    noise: FloatArray

    def with_objective(self, problem: DesignProblem, base: Base) -> DesignProblem:
        """Return a design problem whose objective is the predicted variance along the task.

        Args:
            problem: The design problem, whose earlier information contains the prior.
            base: Base parameters of the robot.
        """
        weighting = criterion_weighting(Criterion.A, base, self.noise, plain=False)
        assert problem.earlier_root is not None
        moment = task_moment(self.regressor, weighting)
        objective = TaskVariance(problem.weighting, moment, problem.earlier_root)
        return dataclasses.replace(problem, objective=objective)

    def predict(
        self, robot: Robot, base: Base, given: FloatArray | None, designed: FloatArray
    ) -> TaskPrediction:
        """Predict the torque band along the task.

        Args:
            robot: The robot.
            base: Its base parameters.
            given: Root of the information of earlier recordings; None without. Shape (m, P).
            designed: Root of the information of the designed motion. Shape (m, P).
        """
        known = designed[:0] if given is None else given
        return TaskPrediction(
            self.source,
            robot.joints,
            self.regressor @ self.parameters.nominal,
            self.noise,
            *(
                torque_band(self.regressor, base, np.vstack([known, *[designed] * runs]))
                for runs in range(3)
            ),
        )


def read_task(
    path: Path,
    robot: Robot,
    limits: Limits,
    options: DesignOptions,
    columns: Mapping[str, str] = MappingProxyType({}),
) -> TaskDesign:
    """Read the motion of a task.

    Args:
        path: A `trajectory.json`, or a recording, of which only the positions are used.
        robot: The robot.
        limits: Its limits.
        options: Options of the design.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file.

    Raises:
        UnusableInput: The file cannot be used, moves other joints or does not move at all, or the
            options ask for another criterion.
    """
    if options.criterion is not Criterion.A or options.plain:
        raise UnusableInput(
            f"--for {path}: replaces the criterion; leave out --criterion and --plain"
        )
    samples = _task_samples(path, robot, columns)
    samples = samples.rows(
        np.linspace(0, len(samples) - 1, min(len(samples), MAX_TASK_SAMPLES)).round().astype(int)
    )
    if np.ptp(samples.q, axis=0).max() < MIN_TRAVEL:
        raise UnusableInput(f"{path}: no joint moves; record the task that the model is for")
    standard = inertial_parameters.standard_parameters(robot, limits, options.drive)
    noise = torque_noise_levels(limits, options.noise)
    return TaskDesign(str(path), standard, dynamics.regressor(robot, standard, samples), noise)


def _task_samples(path: Path, robot: Robot, columns: Mapping[str, str]) -> Samples:
    """Read a task at about REFERENCE_RATE."""
    if is_recording(path):
        recording = recordings.read(path, robot, columns=columns)
        samples = recording.samples()
        step = max(1, round(recording.rate / REFERENCE_RATE))
        return samples.rows(slice(None, None, step))
    return trajectory_samples(path, robot)[0]


def is_recording(path: str | Path) -> bool:
    """Return True for the path of a recording, False for a `trajectory.json`."""
    return Path(path).suffix != ".json"


def trajectory_samples(path: Path, robot: Robot) -> tuple[Samples, Trajectory]:
    """Read a trajectory and its samples at REFERENCE_RATE.

    Raises:
        UnusableInput: The file cannot be used, or moves other joints.
    """
    trajectory = trajectory_file.read_trajectory(path)
    if trajectory.joints != robot.joints:
        raise UnusableInput(
            f"{path}: moves {', '.join(trajectory.joints)}, not {', '.join(robot.joints)}; "
            "choose them with --joints"
        )
    return trajectory.motion.samples(trajectory.motion.grid(REFERENCE_RATE)), trajectory
