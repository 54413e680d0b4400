"""Diagnosis of a robot from recordings: the effects that the base model lacks."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .._types import BoolArray, FloatArray
from ..effects import recorded_motion
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import RecordedMotion
from ..errors import UnusableInput
from ..identification import identification, segments, simulation_error
from ..identification.identification import Identification
from ..identification.simulation_error import SimulationError
from ..recordings import Recording
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from . import (
    bandwidth,
    belief,
    course,
    equations,
    fitted_effects,
    gear_encoders,
    held_out_test,
    hypothesis,
    judge,
    late,
    noise,
    residual_curves,
    search,
    session_changes,
    unmodelled,
)
from .course import Course, Progress
from .fitted_effects import FittedEffect
from .gear_encoders import GearEstimate
from .judge import Finding, Verdict
from .search import EffectRegression
from .session_changes import SessionChange
from .unmodelled import ResidualPrediction

EXPLAINED_RMSE_RATIO = 1.2
"""RMSE over the expected RMSE up to which a joint counts as explained (the contract's value)."""
MAX_UNKNOWN_NOISE_SHARE = 0.15
"""RMSE over the torque from which a residual counts if no repeated period shows the noise."""
UNEXPECTED_RMSE_RATIO = 1.6
"""RMSE over a right model's from which a residual counts though no flexible model predicts it. The
largest ratio in 90 simulated robots without any effect is 1.44, with timestamp jitter."""
MIN_PREDICTED_SHARE = 0.03
"""Torque that a doubted finding explains or a flexible model predicts, over the torque, from which
it counts if no repeated period shows the noise."""
DOUBTED = 0.5
"""RMS that doubted findings explain, over the noise floor, from which the joint is reported as
unknown. In 65 simulated robots without any effect there was no doubted finding."""
MIN_GENUINE_SHARE = 0.75
"""Share of a doubted finding's gain that encoder quantisation must not mimic if the finding is to
count."""
MAX_UNEXPLAINED_SHARE = 0.0625
"""Share of the mean square beyond the noise that may remain unexplained next to a finding before
the joint is reported as unknown: a quarter in RMS."""
MAX_HELD_OUT_SHARE = 0.2
"""The same on the held-out recordings, beyond what a right model would leave."""


@dataclass(frozen=True)
class DiagnosisOptions:
    """Options of a diagnosis.

    Attributes:
        band: Cutoff frequency [Hz]; chosen from the data when None.
        trusted: By index of a standard parameter: the value of a trusted prior. These parameters
            are not refit.
        names: Effects to look for; all when empty.
    """

    band: float | None = None
    trusted: Mapping[int, float] = field(default_factory=dict)
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis. Arrays of shape (n,) have one value a joint.

    Attributes:
        identified: The base model.
        options: Options.
        hertz: Cutoff frequency [Hz].
        motions: Motions of the training and of the held-out recordings.
        design: The effect regression.
        verdict: Findings.
        floor: RMS noise below the cutoff [N m], shape (n,).
        method: How the noise was found: "periods" or "differences".
        before: RMSE of the base model on the held-out recordings [N m], shape (n,).
        after: RMSE of the model with the findings there [N m], shape (n,).
        residuals: Held-out torque minus that of either model [N m], shapes (N, n).
        refitted: Base model of the recordings without the findings.
        ahead: Errors of positions simulated from held-out torque by the base model, and by it with
            the findings; None if no window is long enough.
        expected: RMSE that a right model would have on the held-out recordings: noise, encoder
            quantisation, and the uncertainty of the base parameters [N m], shape (n,).
        fitted: RMSE of the base model fitted to all recordings, alone and with the findings
            [N m], shapes (n,).
        noise_rms: The same of a right model [N m], shape (n,).
        residual_predictions: By joint: prediction of the residual by a flexible model.
        doubted: RMS torque that doubted findings explain [N m], shape (n,).
        gears: Gear parameters of joints with two encoders.
        changes: Changes of the joint actuators between recordings.
        change_rms: RMS of the held-out residual that these changes explain [N m], shape (n,).
    """

    identified: Identification
    options: DiagnosisOptions
    hertz: float
    motions: tuple[list[RecordedMotion], list[RecordedMotion]]
    design: EffectRegression
    verdict: Verdict
    floor: FloatArray
    method: str
    before: FloatArray
    after: FloatArray
    residuals: tuple[FloatArray, FloatArray]
    refitted: Identification | None = None
    ahead: tuple[SimulationError | None, SimulationError | None] = (None, None)
    expected: FloatArray = field(default_factory=lambda: np.zeros(0))
    fitted: tuple[FloatArray, FloatArray] = (np.zeros(0), np.zeros(0))
    noise_rms: FloatArray = field(default_factory=lambda: np.zeros(0))
    residual_predictions: Mapping[int, ResidualPrediction] = field(default_factory=dict)
    doubted: FloatArray = field(default_factory=lambda: np.zeros(0))
    gears: tuple[GearEstimate, ...] = ()
    changes: tuple[SessionChange, ...] = ()
    change_rms: FloatArray = field(default_factory=lambda: np.zeros(1))

    @property
    def parts(self) -> tuple[FittedEffect, ...]:
        """The fitted effects that are added to the base model."""
        return fitted_effects.parts(self.design, self.verdict.together)

    @property
    def credible_doubts(self) -> tuple[Finding, ...]:
        """Doubted findings that encoder quantisation cannot mimic: some effect is there."""
        return _credible_doubts(self.design, self.verdict)

    @property
    def moving(self) -> BoolArray:
        """Rows at which the held-out torque is judged, shape (N, n)."""
        return _moving_rows(self.motions[1])

    @property
    def has_effect(self) -> BoolArray:
        """Joints on which a finding acts, shape (n,)."""
        together = self.verdict.together
        acting = [
            hypothesis.acting(self.design, together, f.main.shape)
            for f in self.verdict.findings
            if together is not None
        ]
        return np.any([np.zeros(len(self.floor), bool), *acting], axis=0)

    @property
    def torque(self) -> FloatArray:
        """RMS of the held-out torque at these rows [N m], shape (n,)."""
        torque = np.concatenate([motion.torque for motion in self.motions[1]])
        return np.sqrt(search.mean_square(torque, self.moving))

    @property
    def rmse_without_changes(self) -> FloatArray:
        """RMSE on the held-out recordings without session changes [N m], shape (n,)."""
        return np.asarray(np.sqrt(np.maximum(self.after**2 - self.change_rms**2, 0.0)))

    @property
    def systematic(self) -> FloatArray:
        """Systematic share 1 − (floor/before)², shape (n,)."""
        return np.maximum(1.0 - (self.floor / np.maximum(self.before, 1e-300)) ** 2, 0.0)

    @property
    def unexplained(self) -> FloatArray:
        """Unexplained share 1 − (floor/after)², shape (n,)."""
        return np.maximum(1.0 - (self.floor / np.maximum(self.after, 1e-300)) ** 2, 0.0)

    @property
    def unknown(self) -> list[int]:
        """Joints with unmodelled torque, or whose actuator has changed in the held-out session."""
        return [
            int(j) for j in np.flatnonzero(self.has_unmodelled_torque | self.has_session_change)
        ]

    @property
    def has_unmodelled_torque(self) -> BoolArray:
        """Joints with a residual that no finding explains, shape (n,).

        The residual counts if a flexible model predicts it, or a doubted finding explains it, or it
        is far larger than the noise (or 20 % larger where a finding acts), or held-out torque is
        predicted worse than without findings. In addition it must be a large part of the residual
        of the base model. Joints at which several findings are unlikely to be all right count too.
        What session changes explain is not included.
        """
        base_rmse, rmse = self.fitted
        counts = (rmse > UNEXPECTED_RMSE_RATIO * self.noise_rms) | (
            self.doubted > DOUBTED * self.floor
        )
        floor = self.floor.copy()
        exceeds_expected = self.rmse_without_changes > UNEXPECTED_RMSE_RATIO * self.expected
        counts |= (self.after**2 > held_out_test.WORSE * self.before**2) & exceeds_expected
        # a finding that leaves more than noise is not, or not all, of what is there
        counts |= self.has_effect & (rmse > EXPLAINED_RMSE_RATIO * self.noise_rms)
        explained = self.doubted.copy()
        for j, prediction in self.residual_predictions.items():
            # what is predicted is not noise, though it may differ in each period, as the
            # oscillation of a load does by its initial state
            if prediction.counts:
                predicted = np.sqrt(prediction.share) * rmse[j]
                floor[j] = min(floor[j], np.sqrt(1.0 - prediction.share) * rmse[j])
                explained[j] = max(explained[j], predicted)
                counts[j] |= predicted > hypothesis.SMALLEST * floor[j]
        if self.method != "periods":  # the floor is a lower bound: only a large residual counts
            motions = [motion for half in self.motions for motion in half]
            torque = np.sqrt(
                np.mean(np.concatenate([motion.torque for motion in motions]) ** 2, axis=0)
            )
            counts &= (rmse > MAX_UNKNOWN_NOISE_SHARE * torque) | (
                explained > MIN_PREDICTED_SHARE * torque
            )
        held_out_share = _unexplained_share(self.before, self.rmse_without_changes, self.expected)
        on_held_out = exceeds_expected & (held_out_share > MAX_HELD_OUT_SHARE)
        on_all = _unexplained_share(base_rmse, rmse, floor) > MAX_UNEXPLAINED_SHARE
        return np.asarray(
            (counts & (on_held_out | on_all)) | belief.unsure(self.verdict, len(floor))
        )

    @property
    def has_session_change(self) -> BoolArray:
        """Joints whose held-out torque differs by a session change, shape (n,)."""
        out = np.zeros(len(self.floor), bool)
        held_out = {motion.segment.source for motion in self.motions[1]}
        for change in self.changes:
            out[change.joint] |= change.source in held_out and change.is_significant
        return out & (self.after > EXPLAINED_RMSE_RATIO * self.noise_rms)

    @property
    def name(self) -> str:
        """Verdict: "no-mismatch", "explained", "partly-explained" or "unexplained"."""
        if not self.verdict.findings:
            return "unexplained" if self.unknown else "no-mismatch"
        if self.unknown or bool((self.after > EXPLAINED_RMSE_RATIO * self.expected).any()):
            return "partly-explained"
        return "explained"


def diagnose(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    train: Sequence[Recording],
    validate: Sequence[Recording],
    options: DiagnosisOptions | None = None,
    progress: Progress = lambda _: None,
) -> Diagnosis:
    """Find the effects that the base model lacks.

    Args:
        robot: The robot.
        parameters: Layout of its standard parameters.
        base: Its base parameters.
        train: Training recordings.
        validate: Held-out recordings.
        options: Options; defaults when None.
        progress: Called with a line of text at each stage.

    Raises:
        UnusableInput: If there is no held-out recording, or a recording is too short.
    """
    options = options or DiagnosisOptions()
    if not validate:
        raise UnusableInput(
            "--validate: a diagnosis needs a held-out recording; "
            "give one that is not among the training recordings"
        )
    pieces = [list(segments.extract_segments(group, average=False)) for group in (train, validate)]
    hertz = options.band or bandwidth.needed_hertz([*pieces[0], *pieces[1]])
    settings = identification.IdentificationOptions(band=hertz, trusted=options.trusted)
    identified = identification.identify(
        robot, parameters, base, train, validate, settings, progress
    )
    psi = equations.kept(identified.psi, options.trusted)
    fitted_robot = recorded_motion.fitted_robot(robot, parameters, psi)
    halves = tuple(
        recorded_motion.recorded_motions(
            identified.model, fitted_robot, base.matrix @ psi, group, hertz
        )
        for group in pieces
    )
    for group, motions in zip((train, validate), halves, strict=True):
        if not motions:
            raise UnusableInput(
                f"{group[0].source}: the recording is too short for a cutoff frequency of "
                f"{hertz:g} Hz; record at least two seconds"
            )
    noise_estimate = noise.estimate_noise(identified, halves, [*train, *validate])
    progress("columns of the catalogue")
    selection = course.run(
        identified, (halves[0], halves[1]), noise_estimate, options.trusted, options.names, progress
    )
    regression, noise_estimate, scale = selection.one, selection.noisy, selection.scale
    verdict = held_out_test.tested(
        regression,
        selection.verdict,
        _moving_rows(halves[1]),
        (noise_estimate.floor / scale) ** 2,
    )
    refitted = None
    if verdict.findings:
        progress("base model of the recordings without the findings")
        regression, verdict, refitted = _refit_base(
            regression,
            verdict,
            identified,
            halves,
            (train, validate),
            settings,
            options,
            noise_estimate.floor,
            scale,
        )
    out = _assess(
        dataclasses.replace(selection, one=regression, verdict=verdict),
        identified,
        refitted,
        (halves[0], halves[1]),
        options,
        hertz,
    )
    out = dataclasses.replace(out, gears=gear_encoders.gears(halves, (train, validate)))
    if out.refitted is None:
        return out
    progress("simulating ahead")
    cleaned = [fitted_effects.removed(out.parts, r, halves[1]) for r in validate]
    return dataclasses.replace(
        out,
        ahead=(
            _simulation_error(identified, validate, hertz),
            _simulation_error(out.refitted, cleaned, hertz),
        ),
    )


def _refit_base(
    regression: EffectRegression,
    verdict: Verdict,
    identified: Identification,
    halves: Sequence[list[RecordedMotion]],
    recordings: tuple[Sequence[Recording], Sequence[Recording]],
    settings: identification.IdentificationOptions,
    options: DiagnosisOptions,
    floor: FloatArray,
    scale: FloatArray,
) -> tuple[EffectRegression, Verdict, Identification]:
    """Fit the base model to the recordings without the findings, and the findings to that model."""
    model, effects = identified.model, fitted_effects.parts(regression, verdict.together)
    cleaned = [
        [fitted_effects.removed(effects, r, motions) for r in group]
        for group, motions in zip(recordings, halves, strict=True)
    ]
    refitted = identification.identify(
        model.robot, model.parameters, model.base, cleaned[0], cleaned[1], settings, lambda _: None
    )
    fitted_robot = recorded_motion.fitted_robot(
        model.robot, model.parameters, equations.kept(refitted.psi, options.trusted)
    )
    renewed = [
        [dataclasses.replace(motion, fitted_robot=fitted_robot) for motion in motions]
        for motions in halves
    ]
    effect_names = {f.main.effect for f in verdict.findings}
    regression, verdict = _refit_findings(
        regression,
        verdict,
        equations.shapes(renewed, bool(options.trusted), floor, effect_names),
        equations.builder(renewed, scale),
    )
    return regression, verdict, refitted


def _assess(
    selection: Course,
    identified: Identification,
    refitted: Identification | None,
    motions: tuple[list[RecordedMotion], list[RecordedMotion]],
    options: DiagnosisOptions,
    hertz: float,
) -> Diagnosis:
    """Compute probabilities, and the errors of the findings on the held-out recordings."""
    regression, estimate, scale = selection.one, selection.noisy, selection.scale
    floor = estimate.floor
    verdict = belief.weighed(regression, selection.verdict, (floor / scale) ** 2, estimate.bounds)
    selection = dataclasses.replace(selection, verdict=verdict)
    before, after = held_out_test.residuals(regression, verdict.together, scale)
    fitted = course.rms(regression, (), scale), course.rms(regression, verdict.named, scale)
    noise_rms = estimate.noise_rms
    expected = np.sqrt(noise_rms**2 + held_out_test.reach(regression, scale) ** 2)
    moving = _moving_rows(motions[1])
    rmse = [np.sqrt(search.mean_square(r, moving)) for r in (before, after)]
    is_large = (
        (fitted[1] ** 2 > MAX_UNEXPLAINED_SHARE * fitted[0] ** 2)
        | (rmse[1] > UNEXPECTED_RMSE_RATIO * expected)
        | belief.unsure(verdict, len(floor))
        | selection.differing
    )
    remaining = search.remaining(regression, verdict.named) * scale
    predictions = _predict_residuals(remaining, motions, np.flatnonzero(is_large))
    credible = _credible_doubts(regression, verdict)
    with_doubts = (*verdict.named, *(part.shape for f in credible for part in f.parts))
    rms_with_doubts = course.rms(regression, with_doubts, scale)
    doubted = np.sqrt(np.maximum(fitted[1] ** 2 - rms_with_doubts**2, 0.0))
    changes = (
        session_changes.changes(regression, selection.shapes, motions)
        if selection.differing
        else ()
    )
    without_changes = search.mean_square(
        held_out_test.levelled(regression, after / scale) * scale, moving
    )
    return Diagnosis(
        identified,
        options,
        hertz,
        motions,
        regression,
        verdict,
        floor,
        estimate.method,
        rmse[0],
        rmse[1],
        (before, after),
        refitted if verdict.findings else None,
        expected=expected,
        fitted=fitted,
        noise_rms=noise_rms,
        residual_predictions=predictions,
        doubted=doubted,
        changes=changes,
        change_rms=np.sqrt(np.maximum(rmse[1] ** 2 - without_changes, 0.0)),
    )


def _credible_doubts(regression: EffectRegression, verdict: Verdict) -> tuple[Finding, ...]:
    """Doubted findings that encoder quantisation cannot mimic."""
    return tuple(
        f
        for f in verdict.doubted
        if belief.genuine(regression, f.main.effect, f.main.joint, f.gain) > MIN_GENUINE_SHARE
    )


def _predict_residuals(
    residual: FloatArray,
    motions: tuple[list[RecordedMotion], list[RecordedMotion]],
    joints: Iterable[int],
) -> dict[int, ResidualPrediction]:
    """Predictions of the residual of both folds, (N, n) [N m], at some joints."""
    rows = residual_curves.motion_rows([*motions[0], *motions[1]])
    first = np.arange(len(rows)) < sum(len(motion) for motion in motions[0])
    out = {}
    for j in joints:
        moving = rows.moving[:, j]
        out[int(j)] = unmodelled.predict_residual(
            rows, (moving & first, moving & ~first), residual[:, j], int(j)
        )
    return out


def _simulation_error(
    fitted: Identification, recordings: Sequence[Recording], hertz: float
) -> SimulationError | None:
    """Error of positions simulated from recorded torque.

    Effects act as along the recorded motion: their torque is subtracted from the recorded one.
    """
    groups, share = simulation_error.cut_windows(
        list(segments.extract_segments(recordings, average=False)), hertz
    )
    if not groups:
        return None
    return simulation_error.compute_simulation_error(
        fitted.model, fitted.psi, fitted.psi, groups, share
    )


def _refit_findings(
    regression: EffectRegression,
    verdict: Verdict,
    candidates: Sequence[CandidateModel],
    build: search.Build,
) -> tuple[EffectRegression, Verdict]:
    """Fit the findings to columns of a base model that they no longer distort.

    Findings that predict no better there are dropped; if other effects would be found, nothing
    changes.
    """
    assert verdict.together is not None
    findings = {(f.main.effect, f.main.joint) for f in verdict.findings}
    renewed = late.renewed(
        regression, verdict.together, [s for s in candidates if (s.effect, s.joint) in findings]
    )
    small = search.design(regression.halves, renewed, build)
    small, better = late.followed(
        *judge.judged(dataclasses.replace(small, measured=regression.measured)), again=True
    )
    better_findings = {(f.main.effect, f.main.joint) for f in better.findings}
    if better.together is None or (
        better_findings != findings and better.together.gain < verdict.together.gain
    ):
        return regression, verdict
    start = len(regression.shapes)
    wider = search.appended(
        dataclasses.replace(regression, build=build),
        [small.shapes[i] for i in better.together.shapes],
    )
    if len(wider.shapes) != start + len(better.together.shapes):
        return regression, verdict
    if better_findings == findings:
        return wider, judge.moved(wider, verdict, better, start)
    return wider, judge.instead(wider, verdict, range(start, len(wider.shapes)))


def _moving_rows(motions: Sequence[RecordedMotion]) -> BoolArray:
    """Rows of some motions that are judged, shape (N, n)."""
    return np.concatenate([motion.moving for motion in motions])


def _unexplained_share(before: FloatArray, after: FloatArray, floor: FloatArray) -> FloatArray:
    """Share of the mean square beyond the noise that remains, shape (n,)."""
    return np.asarray(
        np.maximum(after**2 - floor**2, 0.0) / np.maximum(before**2 - floor**2, 0.1 * floor**2)
    )
