"""Search for the filter that recorded torque has passed, before any other effect is fitted.

Presliding hysteresis explains smoothed steps of friction nearly as well as a filter does: once it
is fitted, no evidence for a filter remains. Filters of all kinds and corner frequencies, one for
all joints, are therefore compared first, each with the frictions of every joint.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from .._types import FloatArray
from ..effects.delay import LowPass
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import RecordedMotion
from ..identification.identification import Identification
from . import joint_model, probability
from .joint_model import MIN_ENTRY_EVIDENCE, JointModel, renewed_chain
from .recording_chain import MIN_CORNER, RecordingChain
from .regression import log_error_ratio

CORNERS = MIN_CORNER * 2.0 ** np.arange(3, -1, -1)
"""Corner frequencies that are compared, down from the highest while the next is better; a step of
Gauss-Newton leads to those between [Hz]."""
FILTERS = tuple(
    tuple(LowPass(poles, passes, hertz) for hertz in CORNERS.tolist())
    for passes in (1, 2)
    for poles in (1, 2, 3, 4)
)
"""Filters that are compared: of every kind, those of all corner frequencies."""
WIDTHS = 1e-4 * 3.0 ** np.arange(5)
"""Widths of Coulomb friction that are compared [rad/s]: those that were identified from smoothed
torque are too large."""
STEPS = 3
"""Gauss-Newton steps of the recording chain."""


@dataclass(frozen=True, eq=False)
class FilterFits:
    """Frictions of all joints at the identified parameters, with several recording chains.

    Attributes:
        kinds: Filters that are compared, of every kind those of all corner frequencies.
    """

    identified: Identification
    motions: Sequence[RecordedMotion]
    kinds: Sequence[Sequence[LowPass]] = FILTERS
    _columns: dict[Hashable, FloatArray] = field(default_factory=dict)

    @cached_property
    def start(self) -> JointModel:
        """Those without a filter, at the identified widths of Coulomb friction."""
        return self._fitted(RecordingChain(), self.identified.model.widths)

    @cached_property
    def plain(self) -> JointModel:
        """Those without a filter, widths and delay chosen."""
        return self._refined(self.start)

    @cached_property
    def filtered(self) -> JointModel:
        """The same with the filter of most evidence."""
        plain = self.plain

        def with_filter(low_pass: LowPass | None) -> tuple[float, JointModel]:
            chain = replace(plain.chain, filter=low_pass)
            model = joint_model.base_model(self.identified, plain.motions, plain.psi, chain)
            model = model.with_effects(plain.models)
            return _evidence(model, plain), model

        def best(of_kind: Sequence[LowPass]) -> tuple[float, JointModel]:
            highest = with_filter(of_kind[0])
            for low_pass in of_kind[1:]:
                lower = with_filter(low_pass)
                if lower[0] < highest[0]:
                    break
                highest = lower
            return highest

        fits = [best(of_kind) for of_kind in self.kinds]
        fits += [with_filter(renewed_chain(model).filter) for _, model in fits]
        _, model = max(fits, key=lambda fit: fit[0])
        return self._refined(model)

    def chosen(self, by_errors: Callable[[JointModel], float] = lambda _: 0.0) -> JointModel:
        """Return the frictions that start every fit, with a filter if the motions show one.

        `by_errors` returns the evidence that position errors alone give the filter of a model.
        """
        if self.motions[0].n == 1:  # a filter looks like the dynamics of a single joint
            return self.start
        plain, filtered = (
            replace(model, regression=model.regression.copy())
            for model in (self.plain, self.filtered)
        )
        for model in (plain, filtered):
            joint_model.reweight(model.regression)
        evidence = _evidence(filtered, plain) - np.log(sum(map(len, self.kinds)))
        low_pass = filtered.chain.filter
        assert low_pass is not None
        # friction at rest passes from one value to another in a time of its own, as if filtered; it
        # is the same at all other times, which a filter would change
        without, with_ = (model.regression.residual() for model in (plain, filtered))
        lost = log_error_ratio(without, with_, plain.far_from_rest)
        against = plain.regression.independent_share * float(lost.sum())
        if low_pass.hertz > MIN_CORNER and evidence > MIN_ENTRY_EVIDENCE > against:
            # noise of the positions is the larger part of fast motion, whose torque a filter
            # reduces
            evidence = probability.beyond_errors(evidence, by_errors(filtered))
            if evidence > MIN_ENTRY_EVIDENCE:
                return filtered
        return self.start

    def started_from(self, model: JointModel, chain: RecordingChain) -> JointModel:
        """Return the frictions at the widths of a joint model, with a recording chain."""
        return self._fitted(chain, model.motions[0].widths)

    def _fitted(self, chain: RecordingChain, widths: FloatArray) -> JointModel:
        """Return the frictions with a recording chain and widths of Coulomb friction."""
        psi = joint_model.initial_parameters(self.identified)
        moved = [chain.without_delay(motion) for motion in self.motions]
        present = joint_model.with_parameters(self.identified, moved, psi, widths)
        model = joint_model.base_model(self.identified, present, psi, chain)
        frictions = joint_model.dense_models(present)
        return model.with_effects(
            [replace(m, own_columns=partial(self._columns_of, m)) for m in frictions]
        )

    def _columns_of(self, friction: CandidateModel, motion: RecordedMotion) -> FloatArray:
        """Columns of a friction, which one width and the identified parameters determine."""
        width = float(motion.widths[friction.joint_index])
        key = friction.form, motion.segment.source, motion.segment.start, width
        if key not in self._columns:
            self._columns[key] = friction.columns(motion)
        return self._columns[key]

    def _refined(self, model: JointModel) -> JointModel:
        """Return a model after a choice of its widths and steps of its recording chain."""
        chain = renewed_chain(model)
        widths = model.motions[0].widths
        if self.identified.options.widths is None:
            candidates = np.array([*(np.full(model.n, width) for width in WIDTHS), widths])
            gains = [_gain(self._fitted(chain, widths), model) for widths in candidates]
            widths = candidates[np.argmax(gains, axis=0), range(model.n)]
        for _ in range(STEPS):
            model = self._fitted(chain, widths)
            chain = renewed_chain(model)
        return model


def evidence_for_chain(model: JointModel, simpler: JointModel) -> FloatArray:
    """Return the evidence at each joint for a recording chain over a simpler one, shape (n,) [nat].

    Both fits have all frictions and their waves of ripple, whose numbers may differ: the log
    likelihood ratio pays for its coefficients by the Bayesian information criterion (Schwarz 1978).
    """
    further = model.regression.fitted_per_joint() - simpler.regression.fitted_per_joint()
    cost = 0.5 * further * np.log(np.maximum(_independent_rows(simpler), 1.0))
    return _gain(model, simpler) - cost


def _gain(model: JointModel, plain: JointModel) -> FloatArray:
    """Log likelihood ratio of two models at each joint, shape (n,)."""
    new, old = (np.maximum(m.regression.residual_rms(m.solution), 1e-300) for m in (model, plain))
    return np.asarray(_independent_rows(plain) * np.log(old / new))


def _independent_rows(model: JointModel) -> FloatArray:
    """Number of independent rows of each joint beyond those that its coefficients fit, (n,).

    A recording of hardly more rows than coefficients is fitted well by any recording chain.
    """
    free = model.regression.moving.sum(axis=0) - model.regression.fitted_per_joint()
    return np.asarray(model.regression.independent_share * np.maximum(free, 0.0))


def _evidence(model: JointModel, plain: JointModel) -> float:
    """Log likelihood ratio of two models."""
    return float(_gain(model, plain).sum())
