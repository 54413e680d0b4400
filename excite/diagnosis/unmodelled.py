"""Unmodelled torque: what a flexible model explains, or a period repeats, and no effect describes.

Two kinds of evidence count. A flexible model (`flexible_models`) entered the joint model as an
effect would: by its evidence for the whole robot, its size, and its prediction of recordings to
which it was not fitted. And where a motion repeats, whatever remains in one period and recurs in
another is caused by the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from .._types import BoolArray, FloatArray
from ..effects.effect import CandidateModel
from . import noise, posterior
from .flexible_models import EXPERIMENTS, UNMODELLED
from .joint_model import JointModel
from .motion_rows import MotionRows, binned_means
from .noise import NoiseEstimate
from .posterior import EffectEvidence
from .regression import rms

REPETITION = "repetition"
"""Regime of torque that repeats with the motion, whatever it depends on."""
LOG_ODDS = -4.0
"""Prior log odds that a joint has torque that repeats and that no effect explains: about 2 %."""
MIN_SIZE = 0.5
"""RMS of torque that repeats from which it is reported, over the noise floor."""
RESPONSE_BINS = 100
"""Bins of a reported response."""
ERROR_BLOCKS = 40
"""Blocks between which the standard error of a share is estimated."""
DECAYED = 0.05
"""Amplitude at which a drawn oscillation ends, over that at its start."""


@dataclass(frozen=True)
class ResidualResponse:
    """A joint's torque that no effect explains, over what it depends on.

    Attributes:
        over: Quantity of the abscissa, with its unit; empty where nothing is drawn.
        x: Abscissa, shape (b,).
        y: Torque [N m], or the impulse response over its largest value, shape (b,).
        other: Index of the joint whose quantity `over` is; None for the same joint.
    """

    over: str
    x: FloatArray
    y: FloatArray
    other: int | None = None
    relative: bool = False


@dataclass(frozen=True)
class UnmodelledTorque:
    """Torque of a joint that no effect explains.

    Attributes:
        regime: Quantity it depends on; see `flexible_models.EXPERIMENTS`, or `REPETITION`.
        share: Its share of the residual's power without it.
        size: Its RMS [N m].
        probability: That it is physics and neither noise nor an effect of the catalogue.
        response: The torque over the quantity on which it depends.
        frequency: Frequency of a resonance [Hz]; None of anything else.
        other: Index of a second joint on whose motion it depends.
        z_score: Power that repeats over its standard error [1], None of a flexible model. Its
            probability is not calibrated.
    """

    joint: int
    regime: str
    share: float
    size: float
    probability: float
    response: ResidualResponse
    frequency: float | None = None
    other: int | None = None
    z_score: float | None = None

    @property
    def experiment(self) -> str:
        """Experiment that would show the dependence alone."""
        if self.regime == REPETITION:
            return "each joint alone over the same positions and speeds, the others at rest"
        return EXPERIMENTS[self.regime]


def find(
    model: JointModel,
    evidence: Sequence[EffectEvidence],
    estimate: NoiseEstimate,
    residual: FloatArray,
    by_errors: FloatArray,
) -> list[UnmodelledTorque]:
    """Find torque that no effect of a joint model explains.

    Args:
        residual: Residual of the joint model, zero at standstill, shape (N, n) [N m].
        by_errors: Residual that errors of the positions alone leave, shape (N, n) [N m].
    """
    rows, regression = model.rows, model.regression
    solution = regression.without(posterior.left_out(evidence))
    products, expected = (
        noise.products_of_periods(estimate.periods, model.motions, x) for x in (residual, by_errors)
    )
    present = posterior.probabilities(model.n, evidence)
    out = []
    for entry in evidence:
        if entry.effect != UNMODELLED or not entry.is_in_model:
            continue
        assert entry.joint is not None
        after = float(rms(residual, regression.moving)[entry.joint])
        size = float(entry.growth[entry.joint])
        shape = model.models[entry.members[0]]
        part = regression.slices[entry.members[0]]
        torque = regression.torque_along(solution.at(part))[:, entry.joint]
        out.append(
            UnmodelledTorque(
                entry.joint,
                shape.signature,
                size**2 / (size**2 + after**2),
                size,
                present[entry.key].value,
                _response(rows, regression.moving[:, entry.joint], torque, entry.joint, shape),
                shape.values.get("frequency"),
                shape.other,
            )
        )
    named = {entry.joint for entry in out}
    for j in (j for j in range(model.n) if j not in named and len(products[j])):
        square = float(np.mean(residual[regression.moving[:, j], j] ** 2))
        known = expected[j]
        known = known + max(float(estimate.steps[j]) ** 2 - float(known.mean()), 0.0)
        share, z_score = repeated_share(products[j], square, known)
        size = float(np.sqrt(max(share, 0.0) * square))
        probability = float(special.expit(0.5 * max(z_score, 0.0) ** 2 + LOG_ODDS))
        if probability >= 0.5 and size > MIN_SIZE * estimate.floor[j]:
            curve = _curve(rows, regression.moving[:, j], residual[:, j], j, "q", j)
            out.append(
                UnmodelledTorque(j, REPETITION, share, size, probability, curve, z_score=z_score)
            )
    return sorted(out, key=lambda entry: entry.joint)


def repeated_share(products: FloatArray, square: float, known: FloatArray) -> tuple[float, float]:
    """Return the share of a residual's power that repeats, and that share over its standard error.

    `products` are those of the residuals of two periods, `known` those of one draw of errors of
    positions and torque that repeat as well, shapes (m,); `square` is the mean square residual.
    """
    count = min(ERROR_BLOCKS, len(products))
    blocks, known_blocks = (
        np.array([part.mean() for part in np.array_split(x, count)]) for x in (products, known)
    )
    power = float(blocks.mean() - known_blocks.mean())
    std = max(float(np.sqrt((blocks.var() + known_blocks.var()) / count)), 1e-300)
    return min(power / max(square, 1e-300), 1.0), power / std


def _response(
    rows: MotionRows, moving: BoolArray, torque: FloatArray, joint: int, shape: CandidateModel
) -> ResidualResponse:
    """Torque of a flexible model over what it depends on most plainly."""
    if "frequency" in shape.values:
        omega = 2.0 * np.pi * shape.values["frequency"]
        damping = shape.values["damping"]
        time = np.linspace(0.0, -np.log(DECAYED) / (damping * omega), 2 * RESPONSE_BINS)
        y = np.exp(-damping * omega * time) * np.sin(omega * time)
        return ResidualResponse(f"{shape.signature}: time [s]", time, y, relative=True)
    quantity = "dq" if shape.signature.startswith("speed") else "q"
    over = joint if shape.other is None else shape.other
    if shape.signature == "position and direction":
        direction = rows.direction(joint)
        curve = _curve(rows, moving & (direction != 0.0), torque * direction, joint, "q", over)
        return replace(curve, over=curve.over.replace("position", "position, along the motion"))
    return _curve(rows, moving, torque, joint, quantity, over)


def _curve(
    rows: MotionRows, moving: BoolArray, y: FloatArray, joint: int, quantity: str, over: int
) -> ResidualResponse:
    """Mean torque over a position or a speed."""
    unit = ("m" if rows.linear[over] else "rad") + ("/s" if quantity == "dq" else "")
    label = f"{'speed' if quantity == 'dq' else 'position'} [{unit}]"
    x = (rows.dq if quantity == "dq" else rows.q)[moving, over]
    curve = binned_means(x, y[moving], np.linspace(x.min(), x.max(), RESPONSE_BINS + 1))
    return ResidualResponse(label, *curve[:2], other=None if over == joint else over)
