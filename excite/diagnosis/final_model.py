"""The model that a diagnosis saves: a physically consistent base model and the effects it needs.

The base model is identified from the recordings without the torque of the effects, then the
coefficients of the effects are fitted anew to that base model. What the diagnosis reports is
computed with the `model.json` that holds the result.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .._types import BoolArray, FloatArray
from ..effects import delay, nonlinear_viscous
from ..effects.effect import CandidateModel, Key
from ..effects.recorded_motion import Motions, RecordedMotion
from ..identification import identification, identified_model
from ..identification.identification import Identification
from ..recordings import Recording
from . import base_estimate, fitted_effects, joint_model, recording_chain, session_changes
from .fitted_effects import FittedEffect
from .flexible_models import UNMODELLED
from .joint_model import FRICTIONS, JointModel
from .recording_chain import RecordingChain
from .regression import JointRegression, rms


@dataclass(frozen=True)
class FinalModel:
    """The saved model.

    Attributes:
        identified: The base model, fitted without the torque of the effects.
        motions: The fitted motions, with that base model and torque without the recording delay.
        effects: The effects, without the recording chain.
        regression: Regression of their coefficients, next to the changes between recordings, at
            the parameters of the base model.
        chain: How torque is recorded.
    """

    identified: Identification
    motions: tuple[RecordedMotion, ...]
    effects: tuple[FittedEffect, ...]
    regression: JointRegression
    chain: RecordingChain

    @property
    def saved_effects(self) -> tuple[FittedEffect, ...]:
        """All effects, last the filter and the delay of the recording chain, if it has them."""
        out, chain = list(self.effects), self.chain
        if chain.filter is not None:
            out.append(FittedEffect(delay.filtered_recording(chain.filter), np.ones(1)))
        if abs(chain.delay) >= recording_chain.MIN_DELAY:
            out.append(FittedEffect(delay.clock_delay(), np.array([chain.delay])))
        return tuple(out)

    @property
    def residual(self) -> FloatArray:
        """Torque of the fitted motions that it does not predict, shape (N, n) [N m]."""
        coefficients = self.regression.solution.coefficients.copy()
        coefficients[: self.regression.base_count] = 0.0  # the changes between recordings
        return self.regression.torque - self.regression.torque_along(coefficients)

    def has(self, effect: str, joint: int | None) -> bool:
        """Tell whether an effect is saved."""
        return any((e.shape.effect, e.shape.joint) == (effect, joint) for e in self.saved_effects)

    def document(
        self, recordings: Sequence[Recording], known: Sequence[FittedEffect] = ()
    ) -> dict[str, Any]:
        """Return the content of `model.json`, which contains the known effects of the prior."""
        out = identified_model.model_document(self.identified, recordings)
        robot = self.identified.model.robot
        out["effects"] = [
            fitted_effects.entry(effect, robot) for effect in (*known, *self.saved_effects)
        ]
        moving, torque = self.regression.moving, np.concatenate([m.torque for m in self.motions])
        sources = np.concatenate([[m.segment.source] * len(m) for m in self.motions])
        for fit in out["fit"]:
            rows = sources == fit["recording"]
            errors, sizes = (rms(x[rows], moving[rows]) for x in (self.residual, torque))
            for joint, error, size in zip(
                fit["joints"].values(), errors.tolist(), sizes.tolist(), strict=True
            ):
                joint |= {"rmse": error, "relative": error / max(size, 1e-300)}
        return out


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors of the base model and of the saved model on held-out recordings.

    Attributes:
        motions: The held-out motions, with the saved base model.
        torque: Measured torque, shape (N, n) [N m].
        base: Residual of the base model, shape (N, n) [N m].
        final: Residual of the saved model, shape (N, n) [N m].
        moving: Rows that count, shape (N, n).
        rmse_refit: RMSE of the base model identified without the trusted prior, shape (n,) [N m];
            None without one.
    """

    motions: tuple[RecordedMotion, ...]
    torque: FloatArray
    base: FloatArray
    final: FloatArray
    moving: BoolArray
    rmse_refit: FloatArray | None = None

    @cached_property
    def rmse_before(self) -> FloatArray:
        """RMSE of the base model, shape (n,) [N m]."""
        return rms(self.base, self.moving)

    @cached_property
    def rmse_after(self) -> FloatArray:
        """RMSE of the saved model, shape (n,) [N m]."""
        return rms(self.final, self.moving)

    @property
    def torque_rms(self) -> FloatArray:
        """RMS of the measured torque, shape (n,) [N m]."""
        return rms(self.torque, self.moving)

    @property
    def is_useless(self) -> BoolArray:
        """Joints with torque of which neither model predicts more than none would, shape (n,)."""
        torque = self.torque_rms
        return np.asarray((np.minimum(self.rmse_before, self.rmse_after) > torque) & (torque > 0.0))


def fit(
    identified: Identification,
    model: JointModel,
    probabilities: Mapping[Key, float],
    recordings: Sequence[Recording],
    progress: Callable[[str], None] = lambda _: None,
) -> FinalModel:
    """Fit the model that is saved, with effects of these probabilities."""
    left_out = [i for i, shape in enumerate(model.models) if shape.key not in probabilities]
    solution = model.regression.without(left_out)
    shapes = [
        shape.exact or shape
        for i, (shape, part) in enumerate(zip(model.models, model.regression.slices, strict=True))
        if i not in left_out and shape.effect != UNMODELLED and solution.coefficients[part].any()
    ]
    base_model = model.regression.keeping(())
    # the saved model has the widths and the chain of the motions, and no further change of them
    base_model.fix_at_zero(range(len(model.free), model.filter_place + 1))
    joint = dataclasses.replace(model, models=(), regression=base_model).with_effects(shapes)
    first = joint.regression
    first.reduce_prior([probabilities[shape.key] for shape in joint.models])
    # the effects that were left out explain nothing of the residual
    joint_model.reweight(first, joint_model.transient_rows(shapes, model.motions))
    effects = _fitted(joint.models, first)
    cleaned = [_cleaned(effects, recording, model) for recording in recordings]
    refitted = identification.identify(
        identified.model.robot,
        identified.model.parameters,
        identified.model.base,
        cleaned,
        (),
        dataclasses.replace(identified.options, dissipation=False),
        progress,
    )
    several = len(session_changes.sources(model.motions)) > 1
    if (shapes or several or model.chain.filter) and not identified.options.trusted:
        # the same recordings, but effects and base model at once: where an effect can stand for a
        # part of the base model, the recordings without its torque cannot show that part, a change
        # between them would be fitted by other parameters, and the noise of torque whose filter is
        # undone is large
        refitted = identification.with_estimate(
            dataclasses.replace(
                refitted,
                model=dataclasses.replace(refitted.model, widths=_widths(refitted, model, shapes)),
            ),
            # not of the saved effects alone: those that were left out are not known to be zero
            base_estimate.base_estimate(model),
            joint_model.consistent_estimate(refitted, joint),
        )
    # errors are those of the recordings with all of their torque
    refitted = dataclasses.replace(refitted, fits=identified.fits)
    motions = [
        new.with_modelled_torque(old.measured_torque, old.motor_torque)
        for new, old in zip(
            with_identified_base(refitted, model.motions), model.motions, strict=True
        )
    ]
    torque = np.concatenate([m.torque - model.chain.passed(m, m.gamma @ m.theta) for m in motions])
    changes = session_changes.prior_std(motions, model.change_scale)
    changed = session_changes.columns(motions, model.weights_in_mean)
    fixed_base = JointRegression.of_base(
        torque,
        model.regression.moving,
        np.concatenate([model.chain.passed(m, x) for m, x in zip(motions, changed, strict=True)]),
        (np.zeros_like(changes), np.diag(changes**-2.0)),
        first.sigma,
        first.independent_share,
    )
    final = dataclasses.replace(
        model, motions=tuple(motions), models=(), regression=fixed_base
    ).with_effects(shapes)
    final.regression.reduce_prior([probabilities[shape.key] for shape in final.models])
    viscous = final.motions[0].fitted_robot.actuator_parameter("viscous")
    return FinalModel(
        refitted,
        final.motions,
        tuple(_continued(effect, viscous) for effect in _fitted(final.models, final.regression)),
        final.regression,
        model.chain,
    )


def _widths(
    refitted: Identification, model: JointModel, shapes: Sequence[CandidateModel]
) -> FloatArray:
    """Return the widths of Coulomb friction (n,): the joint model's where frictions are saved."""
    widths = refitted.model.widths.copy()
    for shape in shapes:
        if shape.effect in FRICTIONS:
            widths[shape.joint_index] = model.motions[0].widths[shape.joint_index]
    return widths


def _fitted(
    shapes: Sequence[CandidateModel], regression: JointRegression
) -> tuple[FittedEffect, ...]:
    """Effects with the coefficients of a regression."""
    return tuple(
        FittedEffect(shape, np.asarray(regression.solution.coefficients[part]))
        for shape, part in zip(shapes, regression.slices, strict=True)
    )


def _continued(effect: FittedEffect, viscous: FloatArray) -> FittedEffect:
    """Return an effect that is dissipative beyond the recorded speeds."""
    shape = effect.shape
    if shape.effect != "nonlinear_viscous":
        return effect
    of_joint = float(viscous[shape.joint_index])
    return FittedEffect(
        nonlinear_viscous.without_falling(shape, effect.coefficients, of_joint), effect.coefficients
    )


def _cleaned(
    effects: Sequence[FittedEffect],
    recording: Recording,
    model: JointModel,
) -> Recording:
    """Return a recording whose torque is without the recording chain and the effects."""
    tau = recording.torque.copy()
    for motion in model.motions:
        if motion.segment.source == recording.source:
            first = int(np.argmin(np.abs(recording.t - motion.segment.start)))
            rows = slice(first, first + len(motion.segment))
            torque = model.chain.without_filter(motion, motion.segment.torque)
            tau[rows] = torque - fitted_effects.torque(effects, motion)
    return dataclasses.replace(recording, tau=tau)


def with_identified_base(identified: Identification, motions: Motions) -> list[RecordedMotion]:
    """Return motions with an identified base model."""
    psi = joint_model.initial_parameters(identified)
    return joint_model.with_parameters(identified, motions, psi, identified.model.widths)
