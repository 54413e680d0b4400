"""Payload: the inertial parameters of a link differ from the model, as with a tool or a load."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import pseudo_inertia
from .effect import CandidateModel, Effect
from .recorded_motion import RecordedMotion

MAX_CENTRE_DISTANCE = 1.5
"""Largest distance of a payload's centre of mass from its link's frame [m]."""

MAX_INDEFINITENESS = 0.05
"""Largest magnitude of a negative eigenvalue of its pseudo-inertia over the largest one: noise
makes that of a compact load indefinite."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Regressor columns of a link's first inertial parameters."""
    link, count = int(model.values["link"]), int(model.values["count"])
    robot = motion.fitted_robot

    def low_passed() -> FloatArray:
        Y = regressor(robot.robot, robot.parameters, motion.coarse_samples)
        return motion.lowpass(Y[:, :, : 10 * robot.parameters.bodies], Grid.COARSE)

    Y = motion.for_all_fits("regressor of the links", low_passed)
    return Y[:, :, 10 * link : 10 * link + count]


def _is_physically_consistent(c: FloatArray) -> bool:
    """Check that the mass is positive, its centre within reach, and its inertia nearly feasible."""
    if c[0] <= 0.0 or np.linalg.norm(c[1:4]) > MAX_CENTRE_DISTANCE * c[0]:
        return False
    if len(c) == 4:
        return True
    values = np.linalg.eigvalsh(pseudo_inertia(c))
    return bool(values[0] > -MAX_INDEFINITENESS * values[-1])


def _is_change_of_tool(link: FloatArray, c: FloatArray) -> bool:
    """Check that a change of a link's parameters is a body more or less, or its tool moved.

    A body may be gone that the model has in part on other links, since recordings do not tell them
    apart.
    """
    changed = link + np.append(c, np.zeros(10 - len(c)))
    return any(_is_physically_consistent(x) for x in (c, -c, changed))


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """A point mass, and a body with inertia, on every link.

    The last link of a chain may also have lost a body, or carry it in another way: its tool.
    """

    def parameters(c: FloatArray) -> dict[str, float]:
        reach = float(np.linalg.norm(c[1:4]))
        # otherwise a tool was moved, which is no body of its own
        is_body = c[0] != 0.0 and reach <= MAX_CENTRE_DISTANCE * abs(c[0])
        centre = c[1:4] / c[0] if is_body else np.full(3, np.nan)
        return {
            "mass": float(c[0]),
            "com_x": float(centre[0]),
            "com_y": float(centre[1]),
            "com_z": float(centre[2]),
        }

    fitted = motions[0].fitted_robot
    spread, carrying = fitted.robot.spread, set(fitted.model.parents)
    for link in range(len(fitted.parameters.links)):
        joint = int(np.flatnonzero(spread[link])[0])
        plausible_change = partial(_is_change_of_tool, fitted.psi[10 * link : 10 * (link + 1)])
        is_last = link + 1 not in carrying  # body 0 is the base
        for count in (4, 10):
            yield CandidateModel(
                "payload",
                joint,
                _columns,
                {"link": float(link), "count": float(count)},
                parameters=parameters,
                is_plausible=plausible_change if is_last else _is_physically_consistent,
            )


PAYLOAD = Effect(
    "payload",
    "Y_L δφ_L: a link's ten parameters",
    _columns,
    _candidates,
    {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m"},
    "many joints, in a ratio that the kinematics fix",
    "static poses and fast ones, with and without the load",
    prior_only=True,
    form_std={"mass": 0.04, "com_x": 0.04, "com_y": 0.04, "com_z": 0.04},
    of_link=True,
)
"""Unmodelled tool or load."""
