"""Torque ripple: torque that is periodic in the joint or motor angle, as cogging or gear mesh."""

from __future__ import annotations

import numpy as np

from .effect import CandidateModel, NonlinearParameter
from .joint_torque import JointTorque
from .recorded_motion import Motions, position_range

TORQUE_RIPPLE = JointTorque(
    "torque_ripple",
    "A cos kq + B sin kq",
    {"order": "1/turn", "amplitude": "N m"},
    "periodic in the angle, whatever the speed",
    "slow constant speed over a turn",
    regime="order",
    has_candidates=False,
    form_std={"order": 0.0, "amplitude": 0.1},  # teeth and poles are whole numbers
)
"""Torque ripple; users call it cogging, gear meshing or motor pole ripple."""


def wave_model(motions: Motions, joint: int, order: float) -> CandidateModel:
    """Return the wave of one order [1/rad] at a joint, whose amplitude may grow with the load.

    The order is known to half a period over the range of the joint, the width of its peak in a
    spectrum over the angle.

    At a load as large as the largest torque of the joint, the growth has the prior of the wave
    itself: a joint that carried next to nothing says nothing about loads.
    """
    torque = max(float(np.abs(motion.torque[:, joint]).max()) for motion in motions)
    load = np.concatenate([motion.transmitted_torque[:, joint] for motion in motions])
    scale = max(torque, float(np.abs(load).max()), 1e-9)
    share = float(np.sqrt(np.mean(load**2))) / scale
    values = {"order": order, "load": scale}
    model = CandidateModel(TORQUE_RIPPLE, joint, values, prior_shares=(1.0, 1.0, share, share))
    low, high = position_range(motions, joint)
    width = np.pi / (high - low)
    return NonlinearParameter(model, "order", order, order - width, order + width).current
