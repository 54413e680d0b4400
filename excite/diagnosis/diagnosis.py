"""Diagnosis of a robot from recordings: the effects that the base model lacks.

The training recordings decide everything; the held-out recordings are read once, at the end, by
the saved model. The README of this folder names the steps and their modules.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .._types import FloatArray
from ..effects import recorded_motion
from ..effects.effect import Key
from ..effects.recorded_motion import Motions, RecordedMotion
from ..errors import UnusableInput
from ..identification import identification, segments
from ..identification.identification import Identification
from ..identification.prior import TrustedPrior
from ..identification.segments import RecordingSegment
from ..recordings import Recording
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from . import (
    bandwidth,
    budget,
    cross_validation,
    estimates,
    final_model,
    fitted_effects,
    gear_encoders,
    joint_model,
    noise,
    posterior,
    probability,
    rival_evidence,
    selection,
    session_changes,
    unmodelled,
)
from .budget import TorqueBudget
from .estimates import EffectEstimate
from .final_model import FinalModel, HeldOutErrors
from .fitted_effects import FittedEffect
from .flexible_models import UNMODELLED
from .gear_encoders import GearEstimate
from .joint_model import FRICTIONS, JointModel
from .noise import NoiseEstimate
from .position_errors import PositionErrors
from .regression import rms
from .selection import RareEffect
from .session_changes import SessionChange
from .unmodelled import UnmodelledTorque

Progress = Callable[[str], None]
"""Receives a line of text at each stage."""
EXPLAINED_RMSE_RATIO = 1.2
"""RMSE over the noise floor up to which a joint counts as explained (the contract's value)."""


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis.

    Attributes:
        identified: The base model without effects.
        hertz: Cutoff frequency [Hz].
        effects: All effects that were considered, the most probable first.
        residual: RMS residual of the joint model on the training recordings, shape (n,) [N m].
        document: Content of the `model.json` by which the held-out errors are computed.
        rivals: Of each finding: its log Bayes factor over every effect that is not excluded.
        session_changes: Estimated changes of friction and offset between recordings.
    """

    identified: Identification
    hertz: float
    model: JointModel
    effects: tuple[EffectEstimate, ...]
    final: FinalModel
    noise: NoiseEstimate
    residual: FloatArray
    unmodelled: tuple[UnmodelledTorque, ...]
    held_out: HeldOutErrors
    budget: TorqueBudget
    document: Mapping[str, Any]
    rivals: Mapping[Key, Mapping[str, float]] = field(default_factory=dict)
    session_changes: tuple[SessionChange, ...] = ()
    gears: tuple[GearEstimate, ...] = ()
    known: tuple[FittedEffect, ...] = ()

    @property
    def findings(self) -> tuple[EffectEstimate, ...]:
        """The effects that are asserted."""
        return tuple(effect for effect in self.effects if effect.asserted)

    @property
    def changes(self) -> list[SessionChange]:
        """The changes between recordings that are significant."""
        return [change for change in self.session_changes if change.is_significant]

    @property
    def undecided_changes(self) -> list[SessionChange]:
        """The changes that a recording with little motion cannot tell from chance."""
        return [change for change in self.session_changes if change.is_undecided]

    @property
    def considered(self) -> tuple[EffectEstimate, ...]:
        """The effects that are not asserted but had some evidence."""
        return tuple(
            effect
            for effect in self.effects
            if not effect.asserted and (effect.needed or effect.log_bayes_factor > 0.0)
        )

    @property
    def verdict(self) -> str:
        """Verdict: "no-mismatch", "explained", "partly-explained" or "unexplained"."""
        above_noise = self.held_out.rmse_after > EXPLAINED_RMSE_RATIO * self.noise.floor
        if not self.findings:
            is_left = self.unmodelled or bool((above_noise & self.held_out.is_useless).any())
            return "unexplained" if is_left else "no-mismatch"
        return "partly-explained" if self.unmodelled or bool(above_noise.any()) else "explained"


def diagnose(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    train: Sequence[Recording],
    validate: Sequence[Recording],
    progress: Progress = lambda _: None,
    *,
    band: float | None = None,
    prior: TrustedPrior | None = None,
) -> Diagnosis:
    """Find the effects that the base model lacks.

    Args:
        band: Cutoff frequency [Hz]; chosen from the data when None.
        prior: Known parameters, which are not refit, and known effects, which are no findings.

    Raises:
        UnusableInput: If there is no held-out recording, or a recording is too short.
    """
    prior = prior or TrustedPrior()
    if not validate:
        raise UnusableInput(
            "--validate: a diagnosis needs a held-out recording; "
            "give one that is not among the training recordings"
        )
    pieces = [segments.usable_segments(group, average=False) for group in (train, validate)]
    hertz = band or bandwidth.chosen_hertz(pieces[0], pieces[1], robot)
    segments.require_sampled([*pieces[0], *pieces[1]], hertz)
    recorded = validate, pieces[1]
    known: tuple[FittedEffect, ...] = ()
    if (stated := prior.model) is not None and stated.effects:
        stated = replace(stated, hertz=hertz)
        known = tuple(fitted_effects.restored(effect, robot) for effect in stated.effects)
        train, validate = (
            [fitted_effects.without_effects(stated, recording) for recording in group]
            for group in (train, validate)
        )
        pieces = [segments.usable_segments(group, average=False) for group in (train, validate)]
    settings = identification.IdentificationOptions(
        band=hertz, trusted=prior.parameters, widths=prior.widths
    )
    identified = identification.identify(robot, parameters, base, train, (), settings, progress)
    motions = [_motions(identified, group, hertz) for group in pieces]
    errors = PositionErrors(identified, motions[0])
    progress("fitting all frictions jointly, then rare effects")
    model, rare, small = selection.find_rare_effects(identified, motions[0], errors, progress)
    progress("evidence of each effect")
    evidence = cross_validation.select(model)
    residual = model.regression.residual(model.regression.without(posterior.left_out(evidence)))
    residual = np.where(model.regression.moving, residual, 0.0)
    parts = recorded_motion.split_by_motion(residual, model.motions)
    estimate = noise.estimate_noise(identified.model, model.motions, parts, train)
    by_errors = errors.residual(model) if estimate.periods else np.zeros_like(residual)
    remaining = unmodelled.find(model, evidence, estimate, residual, by_errors)
    in_model = estimates.estimate_effects(model, rare, evidence)
    too_small = (
        EffectEstimate.of(e, probability.rare_probability(e.log_bayes_factor, e.size))
        for e in small
    )
    considered = [*in_model, *too_small]
    residual_rms = rms(residual, model.regression.moving)
    refit: Identification | None = None
    if settings.trusted:
        progress("base model without the trusted parameters")
        free = replace(settings, trusted={}, widths=None)
        refit = identification.identify(robot, parameters, base, train, (), free, progress)
        rmse = _rmse(_motions(refit, pieces[0], hertz))
        considered = estimates.with_doubts_about_prior(considered, residual_rms, rmse)
    effects = estimates.with_unmodelled(considered, model, remaining)
    progress("base model of the recordings without the effects")
    savable, probabilities = _savable(identified, model, rare, in_model)
    final = final_model.fit(identified, savable, probabilities, train, progress)
    effects = estimates.as_saved(effects, final)
    progress("held-out recordings")
    document = final.document(train, known)
    measured = _motions(identified, recorded[1], hertz) if known else motions[1]
    held_out = _held_out_errors(final, document, recorded[0], measured, motions[1])
    if refit is not None:
        held_out = replace(held_out, rmse_refit=_rmse(_motions(refit, pieces[1], hertz)))
    return Diagnosis(
        identified=identified,
        hertz=hertz,
        model=model,
        effects=tuple(effects),
        final=final,
        noise=estimate,
        residual=residual_rms,
        unmodelled=tuple(remaining),
        held_out=held_out,
        budget=budget.torque_budget(identified, motions, final, effects, held_out),
        document=document,
        rivals=rival_evidence.not_excluded(model, effects, bool(settings.trusted)),
        session_changes=tuple(_changes(final, held_out)),
        gears=gear_encoders.gears(motions, (train, validate)),
        known=known,
    )


def _motions(
    identified: Identification, pieces: Sequence[RecordingSegment], hertz: float
) -> list[RecordedMotion]:
    """Motions of some segments; an error if all are too short for the cutoff frequency."""
    motions = joint_model.identified_motions(identified, pieces, hertz)
    if not motions:
        longest = max(pieces, key=lambda segment: len(segment) / segment.rate)
        rows = recorded_motion.MIN_KEPT_ROWS
        needed = longest.band(hertz).needed_samples(rows) / longest.rate
        raise segments.too_short(longest.source, needed, hertz, longest, rows)
    return motions


def _rmse(motions: Motions) -> FloatArray:
    """RMS residual of the base model in the rows that count, shape (n,) [N m]."""
    return rms(
        np.concatenate([motion.residual for motion in motions]),
        np.concatenate([motion.moving for motion in motions]),
    )


def _savable(
    identified: Identification,
    model: JointModel,
    rare: Sequence[RareEffect],
    effects: Sequence[EffectEstimate],
) -> tuple[JointModel, dict[Key, float]]:
    """Return a joint model without flexible models, and the probabilities of effects to be saved.

    Flexible models cannot be saved: the effects are judged by the residual without them. A friction
    that is not asserted is no reason to change one that a prior states.
    """
    named = [i for i, m in enumerate(model.models) if m.effect != UNMODELLED]
    if len(named) < len(model.models):
        model = model.keeping(named)
        joint_model.reweight(model.regression)
        effects = estimates.estimate_effects(model, rare, cross_validation.select(model))
    trusted, block = identified.options.trusted, identified.model.parameters.block
    stated = {
        j
        for j in range(model.n)
        if {block("viscous").start + j, block("coulomb").start + j} <= trusted.keys()
    }
    saved = [e for e in effects if e.needed and (e.asserted or e.joint not in stated)]
    # an effect other than a friction is saved only if it is asserted, and then it is there
    return model, {e.key: e.probability if e.effect in FRICTIONS else 1.0 for e in saved}


def _held_out_errors(
    final: FinalModel,
    document: Mapping[str, Any],
    validate: Sequence[Recording],
    measured: Motions,
    motions: Motions,
) -> HeldOutErrors:
    """Errors of the base model and of the model that is read back from the saved file.

    `motions` are those of `measured` without the torque of the known effects.
    """
    base = np.concatenate([motion.residual for motion in motions])
    torque = np.concatenate([motion.torque for motion in measured])
    moving = np.concatenate([motion.moving for motion in motions])
    saved = fitted_effects.read_back(document)
    residual = fitted_effects.residuals(saved, validate, measured)
    plain = final_model.with_identified_base(final.identified, motions)
    beyond_known = np.concatenate([motion.torque for motion in motions])
    predicted = recorded_motion.split_by_motion(beyond_known - residual, plain)
    present = (
        motion.with_modelled_torque(motion.at_samples(part))
        for motion, part in zip(plain, predicted, strict=True)
    )
    return HeldOutErrors(
        motions=tuple(present),
        torque=torque,
        base=np.where(moving, base, 0.0),
        final=np.where(moving, residual, 0.0),
        moving=moving,
    )


def _changes(final: FinalModel, held_out: HeldOutErrors) -> list[SessionChange]:
    """Changes of friction between the recordings, whether significant or not."""
    residual, moving = final.residual, final.regression.moving
    return [
        *(
            session_changes.changes(final.motions, residual, moving)
            if len(session_changes.sources(final.motions)) > 1
            else []
        ),
        *session_changes.changes(held_out.motions, held_out.final, held_out.moving),
    ]
