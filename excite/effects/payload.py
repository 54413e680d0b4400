"""Payload: the inertial parameters of a link differ from the model, as with a tool or a load.

A load that the robot carries in one of several recordings is found without a trusted prior.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import pseudo_inertia
from .effect import CandidateModel, Effect, Values
from .recorded_motion import FittedRobot, Motions, RecordedMotion, for_all_fits

MAX_CENTRE_DISTANCE = 1.5
"""Largest distance of a payload's centre of mass from its link's frame [m]."""
MAX_INDEFINITENESS = 0.05
"""Largest magnitude of a negative eigenvalue of its pseudo-inertia over the largest one: noise
makes that of a compact load indefinite."""
COUNTS = (4, 10)
"""Numbers of inertial parameters [1]: mass and first moments of a point mass, and those of a body,
which has six second moments as well."""
ONE_LOAD = "a load that the other recordings have not"
"""Description of the residual of a load in one recording."""


def _is_physically_consistent(c: FloatArray) -> bool:
    """Check that the mass is positive, its centre within reach, and its inertia nearly feasible."""
    if c[0] <= 0.0 or np.linalg.norm(c[1:4]) > MAX_CENTRE_DISTANCE * c[0]:
        return False
    if len(c) == 4:
        return True
    values = np.linalg.eigvalsh(pseudo_inertia(c))
    return bool(values[0] > -MAX_INDEFINITENESS * values[-1])


@for_all_fits
def _link_regressor(motion: RecordedMotion) -> FloatArray:
    """Low-passed regressor of the links' inertial parameters, shape (N, n, 10 bodies)."""
    robot = motion.fitted_robot
    Y = regressor(robot.robot, robot.parameters, motion.coarse_samples)
    return motion.lowpass(Y[:, :, : 10 * robot.parameters.bodies], Grid.COARSE)


class _Payload(Effect):
    """Regressor columns of a link's first inertial parameters."""

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        link, count = int(model.values["link"]), int(model.values["count"])
        if model.source not in ("", motion.segment.source):
            return np.zeros((len(motion), motion.n, count))
        return _link_regressor(motion)[:, :, 10 * link : 10 * link + count]

    def candidates(self, motions: Motions) -> Iterator[CandidateModel]:
        """Yield a point mass, and a body with inertia, on every link.

        Of several recordings, each may be the one with a load on a link that ends a chain.
        """
        fitted, times = motions[0].fitted_robot, _times_of_recordings(motions)
        for link in range(len(fitted.parameters.links)):
            joint = int(np.flatnonzero(fitted.robot.spread[link])[0])
            for count in COUNTS:
                values = {"link": float(link), "count": float(count)}
                model = CandidateModel(self, joint, values, motions=motions)
                yield model
                if _ends_a_chain(fitted, link) and len(times) > 1:
                    for source, interval in times.items():
                        yield replace(model, source=source, interval=interval, signature=ONE_LOAD)

    def richer(self, model: CandidateModel) -> CandidateModel | None:
        """Return a body with inertia in the place of a point mass."""
        is_body = model.values["count"] == COUNTS[-1]
        return None if is_body else model.with_values(count=float(COUNTS[-1]))

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        reach = float(np.linalg.norm(c[1:4]))
        # otherwise a tool was moved, which is no body of its own
        is_body = c[0] != 0.0 and reach <= MAX_CENTRE_DISTANCE * abs(c[0])
        centre = c[1:4] / c[0] if is_body else np.full(3, np.nan)
        return dict(zip(self.units, (float(c[0]), *centre.tolist()), strict=True))

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Check that it is a body, or on the last link of a chain also a change of its tool.

        The last link may have lost a body, or carry it in another place. The model may have a part
        of the lost body on other links, as recordings do not tell links of one body apart. A load
        in one of several recordings is a body.
        """
        fitted, link = model.motions[0].fitted_robot, int(model.values["link"])
        if model.source or not _ends_a_chain(fitted, link):
            return _is_physically_consistent(c)
        changed = fitted.psi[10 * link : 10 * (link + 1)] + np.append(c, np.zeros(10 - len(c)))
        return any(_is_physically_consistent(x) for x in (c, -c, changed))


def _ends_a_chain(fitted: FittedRobot, link: int) -> bool:
    """Return whether no joint carries another link beyond a link."""
    return link + 1 not in set(fitted.model.parents)  # body 0 is the base


def _times_of_recordings(motions: Motions) -> dict[str, tuple[float, float]]:
    """Return begin and end of the motions of each recording [s]."""
    out: dict[str, tuple[float, float]] = {}
    for motion in motions:
        begin, end = float(motion.time[0]), float(motion.time[-1])
        low, high = out.get(motion.segment.source, (begin, end))
        out[motion.segment.source] = min(low, begin), max(high, end)
    return out


PAYLOAD = _Payload(
    "payload",
    "Y_L δφ_L: a link's ten parameters",
    {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m"},
    "many joints, in a ratio that the kinematics fix",
    "static poses and fast ones, with and without the load",
    prior_only=True,
    form_std={"mass": 0.04, "com_x": 0.04, "com_y": 0.04, "com_z": 0.04},
    of_link=True,
)
"""Unmodelled tool or load."""
