"""Section of a design's report: predicted torque band along the task of `--for`."""

from __future__ import annotations

import numpy as np

from ..designer.task_variance import TaskPrediction
from ..robot.robot import Robot
from .content import Section, Table
from .formatting import number


def task_section(task: TaskPrediction, robot: Robot) -> Section:
    """Return the section on the torque band along a task, before and after the motion.

    Args:
        task: The predictions.
        robot: The robot, whose sliding joints have forces.
    """
    before, after, again = (
        100.0 * task.relative(band) for band in (task.before, task.after, task.again)
    )
    answer = (
        f"To {after:.2g} % of the torque along {task.source} ({before:.2g} % before). One more run "
        f"of this motion would gain {after - again:.1g} %. Next: {task.advice}."
    )
    torque = np.sqrt(np.mean(task.torque**2, axis=0))
    columns = (torque, *(band.rms for band in (task.before, task.after, task.again)))
    units = [entry.unit("N m") for entry in robot.entries]
    rows = [
        (joint, *(number(float(column[j])) for column in columns), unit)
        for j, (joint, unit) in enumerate(zip(task.joints, units, strict=True))
    ]
    head = (
        "joint",
        "torque, RMS",
        "before",
        "after this motion",
        "after one more run",
        "unit",
    )
    question = "How well will the torque of the task be known?"
    return Section("task", question, answer, {"table": Table(head, rows, (1, 2, 3, 4))})
