"""Search for torque ripple in what the frictions of a joint model leave.

A wave is sought at the highest peak of the order spectrum (`order_spectrum`). The spatial
frequencies (orders) of all waves of a joint are refined jointly by Gauss-Newton steps, together
with all coefficients of the joint model: refined one at a time, waves run into one another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._types import FloatArray
from ..effects import encoder_error, recorded_motion, torque_ripple
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import RecordedMotion
from .order_spectrum import MIN_RIPPLE_ORDER, OrderSpectrum, angle_and_speed
from .regression import CandidateBatch, Columns

if TYPE_CHECKING:
    from .joint_model import JointModel

MIN_RIPPLE_EVIDENCE = 5.0
"""Log Bayes factor from which a wave enters the model, after the search over its order."""
FREE_TORQUE_RATIO = 1e3
"""RMS torque of the prior of a free coefficient, over the friction of its joint [1]: too wide to
matter where the data determine it. A term of the model, not a threshold."""
NEAR_ORDERS = 9
"""Orders around a peak of the spectrum from the best of which the refinement starts."""
GAUSS_NEWTON_STEPS = 6
"""Steps of the refinement of an order."""
MAX_WAVES = 12
"""Waves of a joint at most."""
MAX_ORDER_STEP = 0.3
"""Largest step of an order, over the width of a peak in the order spectrum."""
MIN_ORDER_DISTANCE = 0.5
"""Smallest distance of two orders that count as two waves, over the width of a peak."""
ORDER_TOLERANCE = 1e-4
"""Step at which the refinement of an order ends, in the same unit."""
MIN_WAVES = 3.0
"""Periods over the range of a joint from which a torque counts as periodic."""


def find_waves(fitted: JointModel) -> list[CandidateModel]:
    """Find torque ripple in the residual, at each joint until no wave has evidence.

    Each order is refined jointly with those of the waves before it, which were biased without it.
    """
    share = fitted.regression.independent_share
    out = []
    for j in range(fitted.n):
        moving = fitted.regression.moving[:, j]
        known = [
            m.values["order"] for m in fitted.models if m.effect == "torque_ripple" and m.joint == j
        ]
        width = _peak_width(fitted.motions, j)
        if not np.isfinite(width):
            continue
        low = max(MIN_RIPPLE_ORDER / recorded_motion.radian(fitted.motions, j), MIN_WAVES * width)
        waves: list[_Wave] = []
        present, spectrum = fitted, OrderSpectrum.of(fitted, j, low)
        while len(known) + len(waves) < MAX_WAVES:
            order, gain = spectrum.peak(present)
            gain *= share / float(np.mean(present.regression.residual_of(j)[moving] ** 2))
            evidence = gain - np.log(max(len(spectrum.orders) * max(gain, 1.0), 1.0))
            before = [wave.order for wave in waves]
            if evidence < MIN_RIPPLE_EVIDENCE or _are_near([*known, *before, order], width):
                break
            refined = _refined(fitted, j, waves, order, width)
            orders = [wave.order for wave in refined]
            # of so few periods, a spring; near another one, a part of it
            if min(orders) < low or _are_near([*known, *orders], width):
                break
            waves = refined
            present = fitted.with_effects(_models(fitted, j, waves))
        out += _models(fitted, j, waves)
    return out


@dataclass(frozen=True)
class _Wave:
    """A wave over the angle q of a joint.

    Attributes:
        order: Its spatial frequency k [1/rad].
        columns: Low-pass cos kq, sin kq, q cos kq and q sin kq, shape (N, 4).
    """

    order: float
    columns: FloatArray

    @classmethod
    def of(cls, motions: Sequence[RecordedMotion], joint: int, order: float) -> _Wave:
        """Return the wave of an order along some motions."""

        def wave(q: FloatArray) -> FloatArray:
            cosine, sine = np.cos(order * q), np.sin(order * q)
            return np.array([cosine, sine, q * cosine, q * sine]).T

        return cls(order, _filtered(motions, joint, wave))

    @property
    def pair(self) -> FloatArray:
        """Its cosine and sine, shape (N, 2)."""
        return self.columns[:, :2]

    def slope(self, c: FloatArray) -> FloatArray:
        """Return its derivative by the order, shape (N, 1), with coefficients c of the pair."""
        return c[1] * self.columns[:, 2:3] - c[0] * self.columns[:, 3:]


def _models(fitted: JointModel, joint: int, waves: Sequence[_Wave]) -> list[CandidateModel]:
    """Models of waves at a joint."""
    return [torque_ripple.wave_model(fitted.motions, joint, wave.order) for wave in waves]


def _are_near(orders: Sequence[float], width: float) -> bool:
    """Tell whether two orders are too close to count as two waves, by the width of a peak."""
    distances = np.diff(np.sort(orders))
    return bool(np.any(distances < MIN_ORDER_DISTANCE * width))


def refined_waves(fitted: JointModel) -> list[CandidateModel]:
    """Return the waves of a joint model, the orders of a joint refined by a Gauss-Newton step.

    A wave whose order comes near that of an earlier one was a part of it.
    """
    out = list[CandidateModel]()
    for j in range(fitted.n):
        waves = [
            (wave.values["order"], fitted.coefficients(i))
            for i, wave in enumerate(fitted.models)
            if wave.effect == "torque_ripple" and wave.joint == j
        ]
        if not waves:
            continue
        slopes = np.hstack([_Wave.of(fitted.motions, j, k).slope(c) for k, c in waves])
        steps = fitted.regression.candidate(_free_columns(fitted, j, slopes)).coefficients
        width = _peak_width(fitted.motions, j)
        limit = MAX_ORDER_STEP * width
        known: list[float] = []
        for (order, _), step in zip(waves, np.clip(steps, -limit, limit).tolist(), strict=True):
            if not _are_near([*known, order + step], width):
                known.append(order + step)
        out += [torque_ripple.wave_model(fitted.motions, j, order) for order in known]
    return out


def _free_columns(fitted: JointModel, joint: int, torque: FloatArray) -> Columns:
    """Columns of one joint, shape (N, k), with coefficients of either sign and a wide prior."""
    size = np.sqrt(np.mean(torque**2, axis=0))
    std = FREE_TORQUE_RATIO * fitted.level[joint] / np.where(size > 0.0, size, 1.0)
    return Columns((joint,), (torque,), np.zeros(len(std), bool), std)


def _peak_width(motions: Sequence[RecordedMotion], joint: int) -> float:
    """Width of a peak in the order spectrum [1/rad], ∞ for a joint that does not move."""
    span = float(np.ptp(angle_and_speed(motions, joint)[0]))
    return 2.0 * np.pi / span if span > 0.0 else np.inf


def encoder_errors(fitted: JointModel) -> list[CandidateModel]:
    """Return the encoder error of each joint that fits the residual best, above the grid."""
    out = []
    for j in range(fitted.n):
        width = _peak_width(fitted.motions, j)
        if not np.isfinite(width) or not fitted.regression.moving[:, j].any():
            continue
        unit = recorded_motion.radian(fitted.motions, j)
        low = max(encoder_error.ORDERS[-1] / unit, MIN_WAVES * width)
        spectrum = OrderSpectrum.of(fitted, j, low, grows_with_speed=True)
        order, gain = spectrum.peak(fitted)
        if gain > 0.0:
            count = float(len(spectrum.orders))
            out.append(encoder_error.high_order(j, unit, order, 0.5 * width, count))
    return out


def _refined(
    fitted: JointModel, joint: int, known: Sequence[_Wave], order: float, width: float
) -> list[_Wave]:
    """Refine orders by Gauss-Newton steps, jointly with all coefficients of a model without waves.

    The known waves were refined without the last one, whose order is that of a peak in the order
    spectrum of some width [1/rad].
    """
    distances = width * np.linspace(-1.0, 1.0, NEAR_ORDERS)

    def near(q: FloatArray) -> FloatArray:
        """Waves of all near orders, by powers of the phasor between two of them."""
        lowest, step = (np.exp(1j * k * q) for k in (order - width, distances[1] - distances[0]))
        waves = np.cumprod([lowest, *[step] * (NEAR_ORDERS - 1)], axis=0)
        return np.stack([waves.real, waves.imag], axis=1).reshape(-1, len(q)).T

    pairs = np.split(_filtered(fitted.motions, joint, near), NEAR_ORDERS, axis=1)
    others = [wave.pair for wave in known]
    batch = CandidateBatch.of(
        [_free_columns(fitted, joint, np.hstack([*others, pair])) for pair in pairs],
        fitted.regression.moving,
    )
    gains = [fit.gain for fit in fitted.regression.candidates(batch)]
    nearest = order + float(distances[int(np.argmax(gains))])
    waves = [*known, _Wave.of(fitted.motions, joint, nearest)]
    count, limit = 2 * len(waves), MAX_ORDER_STEP * width
    for _ in range(GAUSS_NEWTON_STEPS):
        columns = np.hstack([wave.pair for wave in waves])
        c = fitted.regression.candidate(_free_columns(fitted, joint, columns)).coefficients
        slopes = [wave.slope(part) for wave, part in zip(waves, c.reshape(-1, 2), strict=True)]
        fit = fitted.regression.candidate(
            _free_columns(fitted, joint, np.hstack([columns, *slopes]))
        )
        steps = np.clip(fit.coefficients[count:], -limit, limit).tolist()
        moved = [abs(step) >= ORDER_TOLERANCE * width for step in steps]
        if not any(moved):
            break
        waves = [
            _Wave.of(fitted.motions, joint, wave.order + step) if is_moved else wave
            for wave, step, is_moved in zip(waves, steps, moved, strict=True)
        ]
    return waves


def _filtered(
    motions: Sequence[RecordedMotion], joint: int, functions: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Low-pass functions of a joint's angle, shape (N, k)."""
    return np.concatenate([m.lowpass(functions(m.samples.q[:, joint])) for m in motions])
