"""Evidence that errors of the recorded positions give effects of a robot that has none.

An error of a position enters the residual and the columns of each effect alike. The recorded
motions are therefore disturbed once more, by noise of the density that is seen above the cutoff
frequency and by quantisation, with the torque of the base model along the positions before. The
evidence that an effect has there discounts its evidence (`probability.beyond_errors`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .._types import FloatArray
from ..effects.delay import LowPass
from ..effects.effect import CandidateModel, Key
from ..effects.recorded_motion import RecordedMotion
from ..identification.identification import Identification
from ..identification.lowpass import MOTION_BANDWIDTH_RATIO, Grid
from ..recordings import quantization
from . import joint_model, posterior
from .filter_search import FILTERS, FilterFits
from .joint_model import JointModel

NOISE_WINDOW = 2.0
"""Length of the windows of the positions' spectrum [s]."""
CORRECTIONS = 5
"""Corrections of the torque by its residual, each of which leaves a quarter of it."""


def smooth_positions(motion: RecordedMotion) -> FloatArray:
    """Return the positions of a motion without their quantisation, shape (M, n)."""
    segment = motion.segment
    low_passed = motion.band.transform(segment.q).filter(Grid.RECORDED, 0, MOTION_BANDWIDTH_RATIO)
    return np.where(segment.smoothed, segment.q, low_passed)


def position_noise(motion: RecordedMotion) -> FloatArray:
    """Return the standard deviation of white noise of the positions, with quantisation, shape (n,).

    It has the median density above the cutoff frequency, where no motion is expected.
    """
    from scipy import signal  # slow to import

    segment, length = motion.segment, int(NOISE_WINDOW * motion.segment.rate)
    frequency, density = signal.welch(  # differences: less leaks from the motion
        np.diff(segment.q, axis=0), segment.rate, nperseg=min(len(segment) - 1, length), axis=0
    )
    above = frequency > MOTION_BANDWIDTH_RATIO * motion.band.hertz
    if not above.any():
        return np.zeros(motion.n)
    slope = 2.0 * np.sin(np.pi * frequency[above] / segment.rate)
    level = np.median(density[above] / slope[:, None] ** 2, axis=0)
    return np.asarray(np.sqrt(0.5 * segment.rate * level))


def quantized_positions(
    motion: RecordedMotion, smooth: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return smooth positions as the encoders of a motion would have recorded them, shape (M, n).

    `rng` draws the origins of the encoders. Those of coarse encoders are smoothed as the recorded.
    """
    step, segment = motion.steps, motion.segment
    coarse, positions = step > 0.0, smooth.copy()
    origin = rng.uniform(size=motion.n) * step
    positions[:, coarse] = (
        np.round((smooth + origin)[:, coarse] / step[coarse]) * step[coarse] - origin[coarse]
    )
    for j in np.flatnonzero(segment.smoothed):
        positions[:, j] = quantization.smoothest_line(
            positions[:, j], float(step[j]), 1.0 / segment.rate
        )
    return positions


@dataclass(frozen=True)
class PositionErrors:
    """Motions of a robot without effects whose positions have further errors."""

    identified: Identification
    motions: Sequence[RecordedMotion]
    _filter_fits: dict[LowPass | None, FilterFits] = field(default_factory=dict)
    _friction_fits: dict[LowPass | None, JointModel] = field(default_factory=dict)

    def evidence(self, shapes: Sequence[CandidateModel], model: JointModel) -> dict[Key, float]:
        """Return the log Bayes factors that the errors give effects, of those that have any.

        `shapes` are models of rare effects, with which frictions and ripple are judged. The rows
        have the weights of a joint model.
        """
        if not self._matter(model):
            return {}
        fitted = self._fitted(shapes, model)
        fitted.regression.reweighted(model.regression.sigma, model.regression.independent_share)
        factors = {
            key: posterior.evidence_of(fitted, members).log_bayes_factor
            for key, members in posterior.effect_groups(fitted).items()
        }
        return {key: factor for key, factor in factors.items() if factor > 0.0}

    def filter_evidence(self, model: JointModel) -> float:
        """Return the log likelihood ratio that the errors give the kind of a model's filter."""
        if not self._matter(model):
            return 0.0
        fits, regression = self._fits(_kind_of_filter(model)), model.regression
        without, with_ = (
            float(np.sum((m.regression.residual() / regression.sigma)[regression.moving] ** 2))
            for m in (fits.plain, fits.filtered)
        )
        return max(0.5 * regression.independent_share * (without - with_), 0.0)

    def residual(self, model: JointModel) -> FloatArray:
        """Return the residual that the errors leave of the frictions, shape (N, n) [N m]."""
        if not self._matter(model):
            return np.zeros_like(model.regression.torque)
        regression = self._fitted((), model).regression
        return np.where(regression.moving, regression.residual(), 0.0)

    def _fitted(self, shapes: Sequence[CandidateModel], model: JointModel) -> JointModel:
        """Frictions and some effects of the motions with errors; a filter if the model has one."""
        kind = _kind_of_filter(model)
        fitted = None if shapes else self._friction_fits.get(kind)
        if fitted is None:
            fits = self._fits(kind)
            start = fits.start if kind is None else fits.chosen()
            fitted = joint_model.fit(self.identified, self._disturbed, shapes, start)
        if not shapes:
            self._friction_fits[kind] = fitted
        return replace(fitted, regression=fitted.regression.copy())

    def _fits(self, kind: LowPass | None) -> FilterFits:
        """Frictions of the motions with errors, without a filter and with one of a kind."""
        if kind not in self._filter_fits:
            filters = [of_kind for of_kind in FILTERS if of_kind[0].with_corner(1.0) == kind]
            self._filter_fits[kind] = FilterFits(self.identified, self._disturbed, filters)
        return self._filter_fits[kind]

    def _matter(self, model: JointModel) -> bool:
        """Tell whether the errors would be evidence for an effect that explained all they leave."""
        regression = model.regression
        residual = np.concatenate([np.where(m.moving, m.residual, 0.0) for m in self._disturbed])
        squares = float(np.sum((residual / regression.sigma) ** 2))
        return 0.5 * regression.independent_share * squares > 1.0

    @cached_property
    def _disturbed(self) -> list[RecordedMotion]:
        """The motions with further errors of the positions, and torque without any."""
        hertz, rng = self.motions[0].band.hertz, np.random.default_rng(0)

        def motions(positions: Sequence[FloatArray]) -> list[RecordedMotion]:
            segments = [
                replace(motion.segment, q=q)
                for motion, q in zip(self.motions, positions, strict=True)
            ]
            return joint_model.identified_motions(self.identified, segments, hertz)

        smooth = [smooth_positions(motion) for motion in self.motions]
        noisy = [
            quantized_positions(motion, q + _further_noise(motion, rng), rng)
            for motion, q in zip(self.motions, smooth, strict=True)
        ]
        return [
            motion.with_torque(_modelled_torque(exact))
            for motion, exact in zip(motions(noisy), motions(smooth), strict=True)
        ]


def _kind_of_filter(model: JointModel) -> LowPass | None:
    """Filter of a model with a corner frequency of 1 Hz; None without one."""
    return model.chain.filter and model.chain.filter.with_corner(1.0)


def _further_noise(motion: RecordedMotion, rng: np.random.Generator) -> FloatArray:
    """Noise of the positions of a motion beyond their quantisation, shape (M, n)."""
    variance = position_noise(motion) ** 2 - motion.segment.encoder**2
    std = np.sqrt(np.where(motion.segment.smoothed, 0.0, np.maximum(variance, 0.0)))
    return np.asarray(std * rng.standard_normal(motion.segment.q.shape))


def _modelled_torque(motion: RecordedMotion) -> FloatArray:
    """Torque at every sample of which the base model leaves no residual, shape (M, n)."""
    torque = motion.motor_torque
    for _ in range(CORRECTIONS):
        torque = torque - motion.at_samples(motion.with_torque(torque).residual)
    return torque
