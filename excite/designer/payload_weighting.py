"""Design of a motion for a payload: the ten parameters of a body on one link, friction eliminated.

The robot itself is known from an identification; friction and offset of the joints are not, as they
differ from day to day. The A-criterion over payload and friction, friction in a unit so large that
its own variance hardly counts, is the trace of the payload's covariance after the elimination of
friction, tr((I_pp − I_pf I_ff⁻¹ I_fp)⁻¹), in the metric of a ball.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._types import FloatArray
from ..robot.inertial_parameters import Parameters, frame_map, inverse_root
from ..robot.robot import Robot
from ..robot.samples import Samples
from .criteria import Weighting
from .identifiability import information_root

LINK_PARAMETERS = 10
"""Inertial parameters of a body."""
BALL_MASS = 1.0
"""Mass of the ball whose metric weighs the ten parameters [kg]."""
BALL_RADIUS = 0.05
"""Its radius [m]."""
FRICTION_UNIT = 30.0
"""Unit of friction and offset over their natural scales [1]: their variances count 1/900."""
ELIMINATED = ("viscous", "coulomb", "offset")
"""Joint parameters that are unknown next to the payload."""


@dataclass(frozen=True)
class PayloadDeviation:
    """Predicted standard deviations of a payload, in the frame of its link.

    Attributes:
        mass: Of the mass [kg].
        centre: Of the centre of mass of a payload of 1 kg. Shape (3,) [m].
        inertia: Of xx, xy, yy, xz, yz, zz about the frame's origin. Shape (6,) [kg m²].
        metric: Of all ten together, in the metric of a ball at the frame's origin: the root of the
            trace of their covariance [1].
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray
    metric: float

    @property
    def text(self) -> str:
        """One line for people."""
        inertia = f"inertia up to {float(self.inertia.max()):.2g} kg m²"
        return f"{predicted_text(self.mass, self.centre)}, {inertia}"

    def document(self) -> dict[str, object]:
        """Content for JSON."""
        return {
            "mass": self.mass,
            "centre_of_1_kg": self.centre.tolist(),
            "inertia": self.inertia.tolist(),
            "metric": self.metric,
        }


def predicted_text(mass: float, centre: FloatArray) -> str:
    """Say the predicted standard deviations of mass and centre of mass.

    Args:
        mass: Of the mass [kg].
        centre: Of the centre of mass of a payload of 1 kg. Shape (3,) [m].
    """
    axes = ", ".join(f"{1e3 * value:.2g}" for value in centre)
    return (
        f"predicted standard deviations of a payload: mass {1e3 * mass:.3g} g, centre of 1 kg "
        f"{axes} mm"
    )


def payload_weighting(
    robot: Robot, parameters: Parameters, noise: FloatArray, link: str
) -> Weighting:
    """Return the coordinates in which the A-criterion is that of a payload.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        link: Link that carries the payload.
    """
    body, placement = robot.carrying_body(link, "--for-payload")
    kinds = [kind for kind in ELIMINATED if kind in parameters.drive]
    columns = np.zeros((parameters.count, LINK_PARAMETERS + robot.n * len(kinds)))
    start = LINK_PARAMETERS * body
    columns[start : start + LINK_PARAMETERS, :LINK_PARAMETERS] = _ball_root(placement)
    for k, kind in enumerate(kinds):
        block = parameters.block(kind)
        place = LINK_PARAMETERS + robot.n * k
        columns[block, place : place + robot.n] = FRICTION_UNIT * parameters.scale[block, block]
    return Weighting(columns, noise)


def _ball_root(placement: pin.SE3) -> FloatArray:
    """Return G^{-1/2} of the metric of the ball at a pose in its body. Shape (10, 10)."""
    inertia = 0.4 * BALL_MASS * BALL_RADIUS**2 * np.eye(3)
    ball = placement.act(pin.Inertia(BALL_MASS, np.zeros(3), inertia))
    return np.asarray(inverse_root(ball.toDynamicParameters()))


def payload_deviation(
    robot: Robot, parameters: Parameters, samples: Samples, noise: FloatArray, link: str
) -> PayloadDeviation:
    """Predict the standard deviations of a payload from a motion, friction eliminated.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        samples: The motion, at the rate at which the noise of rows is independent.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        link: Link that carries the payload.
    """
    body, placement = robot.carrying_body(link, "--for-payload")
    root = information_root(robot, parameters, samples, noise)
    start = LINK_PARAMETERS * body
    carried = list(range(start, start + LINK_PARAMETERS))
    friction = [
        index
        for kind in ELIMINATED
        if kind in parameters.drive
        for index in range(parameters.count)[parameters.block(kind)]
    ]
    information = root[:, carried + friction].T @ root[:, carried + friction]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12)
    covariance = (covariance / np.outer(scale, scale))[:LINK_PARAMETERS, :LINK_PARAMETERS]
    change = frame_map(placement.inverse().homogeneous)
    std = np.sqrt(np.maximum(np.diag(change @ covariance @ change.T), 0.0))
    inverse = np.linalg.inv(_ball_root(placement))
    metric = np.sqrt(max(float(np.trace(inverse @ covariance @ inverse.T)), 0.0))
    return PayloadDeviation(float(std[0]), std[1:4], std[4:], float(metric))
