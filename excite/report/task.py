"""Section of a design's report: predicted torque band along the task of `--for`."""

from __future__ import annotations

import numpy as np

from ..designer.task_variance import TaskPrediction
from .content import Section, Table
from .formatting import number


def task_section(task: TaskPrediction) -> Section:
    """Return the section on the torque band along a task, before and after the motion.

    Args:
        task: The predictions.
    """
    before, after, again = (
        100.0 * task.relative(band) for band in (task.before, task.after, task.again)
    )
    answer = (
        f"To {after:.2g} % of the torque along {task.source} ({before:.2g} % before). One more run "
        f"of this motion would gain {after - again:.1g} %. Next: {task.advice}."
    )
    torque = np.sqrt(np.mean(task.torque**2, axis=0))
    rows = [
        (joint, *(number(float(v[j])) for v in (torque, *(band.rms for band in bands))))
        for bands in [(task.before, task.after, task.again)]
        for j, joint in enumerate(task.joints)
    ]
    head = (
        "joint",
        "torque, RMS [N m]",
        "before [N m]",
        "after this motion [N m]",
        "after one more run [N m]",
    )
    question = "How well will the torque of the task be known?"
    return Section("task", question, answer, {"table": Table(head, rows, (1, 2, 3, 4))})
