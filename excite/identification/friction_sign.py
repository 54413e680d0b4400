"""Tell by the friction of a joint whether its torque has the right sign.

Friction takes out power, whatever the links are. At joint j

    τ = s · τ_nominal + s · Y_j S x + a q̈ + f_0 + f_v q̇ + f_c tanh(q̇/w) + e,

with a prior x ~ N(0, 1) for the errors of the nominal links, see `link_columns`, and coloured
noise e. Without the errors of the links, friction would make up for them where a joint hardly
turns back, and its sign would be a matter of chance.
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..robot.samples import Samples
from .autocorrelation import correlation_length
from .dissipation import CLEARLY_NEGATIVE
from .link_columns import friction_columns

OWN_COLUMNS = 5
"""Columns of a joint without those of the links: friction, rotor inertia, nominal torque."""
VAGUE = 100.0
"""Prior standard deviation of the torque of such a column, over that of the measured torque [1]."""
ROUNDS = 4
"""Rounds in which variance and autocorrelation of the residual settle."""


def friction_dissipates(
    torque: FloatArray,
    motion: Samples,
    joint: int,
    nominal: FloatArray,
    links: FloatArray,
    independent: float,
) -> bool:
    """Tell whether the friction of a joint clearly takes out power.

    Args:
        torque: Its measured torque. Shape (N,) [N m or N].
        motion: Motion at N rows.
        joint: Its index.
        nominal: Its nominal torque, of whatever scale. Shape (N,).
        links: Columns of the errors of the links, in units of the measured torque. Shape (N, k).
        independent: Largest number of independent rows, over N [1].
    """
    speed = motion.dq[:, joint]
    friction = friction_columns(speed)
    columns = np.column_stack([friction, motion.ddq[:, joint], nominal, links])
    gram, right = columns.T @ columns, columns.T @ torque
    precision = np.ones(len(gram))
    precision[:OWN_COLUMNS] = np.diag(gram)[:OWN_COLUMNS] / (VAGUE**2 * (torque @ torque))
    precision = np.maximum(precision, 1e-300)
    without_links = columns[:, :OWN_COLUMNS]
    residual = torque - without_links @ np.linalg.lstsq(without_links, torque, rcond=None)[0]
    variance = float(np.mean(residual**2))
    for _ in range(ROUNDS):
        share = min(independent, 1.0 / correlation_length(residual))
        weight = share / max(variance, 1e-300)
        covariance = np.linalg.inv(weight * gram + np.diag(precision))
        fitted = weight * covariance @ right
        residual = torque - columns @ fitted
        freedom = share * len(torque) - weight * float(np.sum(covariance * gram))
        variance = share * float(residual @ residual) / max(freedom, 1.0)
    power = np.zeros(len(fitted))
    # an offset, the first column, takes out none on the way back
    power[1 : friction.shape[1]] = friction[:, 1:].T @ speed
    std = np.sqrt(power @ covariance @ power)
    return bool(power @ fitted > CLEARLY_NEGATIVE * std)
