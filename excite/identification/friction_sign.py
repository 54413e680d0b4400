"""Tell by the friction of a joint whether its torque has the right sign.

Friction takes out power, whatever the links are. At joint j

    τ = s · τ_nominal + s · Y_j S x + a q̈ + f_0 + f_v q̇ + f_c tanh(q̇/w) + e,

with a prior x ~ N(0, 1) for the errors of the nominal links, see `torque_columns`, and coloured
noise e. Without the errors of the links, friction would make up for them where a joint hardly
turns back, and its sign would be a matter of chance.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from .._types import FloatArray
from ..robot.samples import Samples
from .autocorrelation import correlation_length
from .dissipation import CLEARLY_NEGATIVE
from .torque_columns import MIN_NOISE_SHARE, OWN_COLUMNS, friction_columns

COLUMNS_WITHOUT_LINKS = OWN_COLUMNS + 1
"""Columns of a joint without those of the links: its own, and the nominal torque."""
VAGUE_PRIOR_STD = 100.0
"""Prior standard deviation of the torque of such a column, over that of the measured torque [1]:
the data alone decide where they tell its coefficient from the others."""
VARIANCE_ROUNDS = 4
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
    count = columns.shape[1]
    std = np.ones(count)
    size = np.maximum(np.linalg.norm(columns, axis=0)[:COLUMNS_WITHOUT_LINKS], 1e-150)
    std[:COLUMNS_WITHOUT_LINKS] = VAGUE_PRIOR_STD * np.linalg.norm(torque) / size
    scaled = columns * std  # of coefficients in units of their prior
    without_links = columns[:, :COLUMNS_WITHOUT_LINKS]
    residual = torque - without_links @ np.linalg.lstsq(without_links, torque, rcond=None)[0]
    least = MIN_NOISE_SHARE * float(np.var(torque))
    variance = max(float(np.mean(residual**2)), least)
    for _ in range(VARIANCE_ROUNDS):
        share = min(independent, 1.0 / correlation_length(residual))
        root = np.sqrt(share / variance)
        # by QR: columns that are nearly the same make the normal equations singular
        orthogonal, triangle = np.linalg.qr(np.vstack([root * scaled, np.eye(count)]))
        inverse = linalg.solve_triangular(triangle, np.eye(count))
        fitted = inverse @ (orthogonal[: len(torque)].T @ (root * torque))
        residual = torque - scaled @ fitted
        freedom = share * len(torque) - count + float(np.sum(inverse**2))
        variance = max(share * float(residual @ residual) / max(freedom, 1.0), least)
    power = np.zeros(count)
    # an offset, the first column, takes out none on the way back
    power[1 : friction.shape[1]] = std[1 : friction.shape[1]] * (friction[:, 1:].T @ speed)
    return bool(power @ fitted > CLEARLY_NEGATIVE * float(np.linalg.norm(power @ inverse)))
