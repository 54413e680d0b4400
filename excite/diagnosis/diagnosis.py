"""Diagnosis: is something missing, where, what, how much, and how do we know."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

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

Array = np.ndarray
QUIET = 1.2
"""RMSE over the expected one at which a joint counts as explained."""
MUCH = 0.15
"""RMSE over the torque itself from which what is left is something, where no period repeats to show the noise."""
LOUD = 1.6
"""RMSE over a right model's from which what is left is called something though nothing foresees it: the most in 90 simulated robots with
nothing missing is 1.44, where a clock wavers."""
LITTLE = 0.03
"""The same, of what a doubted name or a flexible model foresees in recordings that it was not fitted to: something is there."""
DOUBTED = 0.5
"""RMS over the noise of what names take that are likelier wrong than right, from which something is there, whatever its name: in 65
simulated robots with nothing missing no name was as much as doubted."""
GENUINE = 0.75
"""Share of a doubted name's gain that an encoder's steps must not feign, if what it foresees is to be called something."""
UNSAID, UNTOLD = 0.0625, 0.2
"""Share of the excess over the noise that may stay unexplained beside a finding before it is called unknown, a quarter of its RMS; and over
what a right model would leave, of held-out torque."""


@dataclass(frozen=True)
class DiagnosisOptions:
    """band: [Hz], None: by the data. trusted: parameter -> value that is right as it stands (a prior); nothing of it is refit.
    names: effects to look for."""

    band: float | None = None
    trusted: Mapping[int, float] = field(default_factory=dict)
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Diagnosis:
    """floor: noise below the band per joint [N m], how it was found: `method`. before, after: RMSE on held-out recordings. Shapes (n,).

    hertz: the band. tracks: stretches of the recordings fitted, and of those held out. identified: the base model. residuals: held-out
    torque less the base model's and less that with the findings. Shape (N, n) each. refitted: the base model of the recordings
    without the findings. ahead: positions simulated from held-out torque, by the base model and by it with the findings; None where no
    window is long enough. expected: RMSE that a right model would leave on the held-out recordings: noise, an encoder's steps, and what
    the base parameters are not known to. fitted: RMSE of the base model fitted to all recordings, alone and with what is asserted: no
    base parameters take what that leaves. quiet: what it is of a right model. Shape (n,) each. sights: what a flexible model foresees of
    what is left at a joint. doubted: RMS of what names take of it that are likelier wrong than right. Shape (n,). gears: what two encoders
    say of joints that have them. changes: by how much drives differ between recordings, where they do. taken: RMS of the held-out torque
    that is left for these. Shape (n,).
    """

    identified: Identification
    options: DiagnosisOptions
    hertz: float
    motions: tuple[list[RecordedMotion], list[RecordedMotion]]
    design: EffectRegression
    verdict: Verdict
    floor: Array
    method: str
    before: Array
    after: Array
    residuals: tuple[Array, Array]
    refitted: Identification | None = None
    ahead: tuple[SimulationError | None, SimulationError | None] = (None, None)
    expected: Array = field(default_factory=lambda: np.zeros(0))
    fitted: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
    noise_rms: Array = field(default_factory=lambda: np.zeros(0))
    residual_predictions: Mapping[int, ResidualPrediction] = field(default_factory=dict)
    doubted: Array = field(default_factory=lambda: np.zeros(0))
    gears: tuple[GearEstimate, ...] = ()
    changes: tuple[SessionChange, ...] = ()
    change_rms: Array = field(default_factory=lambda: np.zeros(1))

    @property
    def parts(self) -> tuple[FittedEffect, ...]:
        """What was found, as it adds to the base model."""
        return fitted_effects.parts(self.design, self.verdict.together)

    @property
    def real(self) -> tuple[Finding, ...]:
        """What is doubted, though something is there."""
        return _real(self.design, self.verdict)

    @property
    def moving(self) -> Array:
        """Where the held-out torque is judged. Shape (N, n)."""
        return _moves(self.motions[1])

    @property
    def has_effect(self) -> Array:
        """Joints where something acts that is asserted. Shape (n,)."""
        one, together = self.design, self.verdict.together
        acting = [
            hypothesis.acting(one, together, f.main.shape)
            for f in self.verdict.findings
            if together is not None
        ]
        return np.any([np.zeros(len(self.floor), bool), *acting], axis=0)

    @property
    def torque(self) -> Array:
        """RMS of the held-out torque there. Shape (n,) [N m]."""
        return np.sqrt(
            search.mean_square(np.concatenate([one.torque for one in self.motions[1]]), self.moving)
        )

    @property
    def rmse_without_changes(self) -> Array:
        """RMSE held out if drives were the same in all recordings. Shape (n,) [N m]."""
        return np.asarray(np.sqrt(np.maximum(self.after**2 - self.change_rms**2, 0.0)))

    @property
    def systematic(self) -> Array:
        """1 − (floor/before)² per joint."""
        return np.maximum(1.0 - (self.floor / np.maximum(self.before, 1e-300)) ** 2, 0.0)

    @property
    def unexplained(self) -> Array:
        """1 − (floor/after)² per joint."""
        return np.maximum(1.0 - (self.floor / np.maximum(self.after, 1e-300)) ** 2, 0.0)

    @property
    def unknown(self) -> list[int]:
        """Joints where something is left that no name takes, and those whose drive is another in the recordings held out."""
        return [int(j) for j in np.flatnonzero(self.has_unmodelled_torque | self.has_session_change)]

    @property
    def has_unmodelled_torque(self) -> Array:
        """Joints where something is left that no name takes: a flexible model foresees it, or a name that is doubted, or it is far louder
        than noise, or a fifth louder where a name acts, or held-out torque is foretold worse than without names; much of it, by a fit to
        all recordings, or of the held-out torque by the others. And those where several names are likelier wrong than right together.
        What drives that differ between recordings take is not among it. Shape (n,)."""
        bare, named = self.fitted
        loud, floor = (
            (named > LOUD * self.noise_rms) | (self.doubted > DOUBTED * self.floor),
            self.floor.copy(),
        )
        loud |= (self.after**2 > held_out_test.WORSE * self.before**2) & (
            self.rmse_without_changes > LOUD * self.expected
        )
        loud |= self.has_effect & (
            named > QUIET * self.noise_rms
        )  # a name that leaves that is not, or not all, of what is there
        told = self.doubted.copy()
        for j, sight in self.residual_predictions.items():
            if sight.counts:  # what is foreseen is no noise, though it may differ each time: a load that swings on from where it was
                floor[j] = min(floor[j], np.sqrt(1.0 - sight.share) * named[j])
                told[j] = max(told[j], np.sqrt(sight.share) * named[j])
                loud[j] |= np.sqrt(sight.share) * named[j] > hypothesis.SMALLEST * floor[j]
        if (
            self.method != "periods"
        ):  # nothing repeats: the floor is a guess from below, and only much is worth a word
            torque = np.sqrt(
                np.mean(
                    np.concatenate([one.torque for half in self.motions for one in half]) ** 2,
                    axis=0,
                )
            )
            loud &= (named > MUCH * torque) | (told > LITTLE * torque)
        untold = (self.rmse_without_changes > LOUD * self.expected) & (
            _left(self.before, self.rmse_without_changes, self.expected) > UNTOLD
        )
        return np.asarray(
            (loud & (untold | (_left(bare, named, floor) > UNSAID)))
            | belief.unsure(self.verdict, len(floor))
        )

    @property
    def has_session_change(self) -> Array:
        """Joints whose held-out torque is another because their drive is, by then. Shape (n,)."""
        out = np.zeros(len(self.floor), bool)
        held_out = {t.segment.source for t in self.motions[1]}
        for change in self.changes:
            out[change.joint] |= change.source in held_out and change.is_significant
        return out & (self.after > QUIET * self.noise_rms)

    @property
    def name(self) -> str:
        """The verdict."""
        if not self.verdict.findings:
            return "unexplained" if self.unknown else "no-mismatch"
        return (
            "partly-explained"
            if self.unknown or bool((self.after > QUIET * self.expected).any())
            else "explained"
        )


def diagnose(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    train: Sequence[Recording],
    validate: Sequence[Recording],
    options: DiagnosisOptions | None = None,
    progress: Progress = lambda _: None,
) -> Diagnosis:
    """Find what the base model leaves out. Raises UnusableInput where there is nothing to judge by."""
    options = options or DiagnosisOptions()
    if not validate:
        raise UnusableInput(
            "--validate: a diagnosis needs a recording to judge by; give one that is not among those it is fitted to"
        )
    pieces = [list(segments.extract_segments(group, average=False)) for group in (train, validate)]
    hertz = options.band or bandwidth.needed_hertz([*pieces[0], *pieces[1]])
    settings = identification.IdentificationOptions(band=hertz, trusted=options.trusted)
    identified = identification.identify(
        robot, parameters, base, train, validate, settings, progress
    )
    psi = equations.kept(identified.psi, options.trusted)
    fitted, model, theta = recorded_motion.fitted_robot(robot, parameters, psi), identified.model, base.matrix @ psi
    halves = tuple(recorded_motion.recorded_motions(model, fitted, theta, parts, hertz) for parts in pieces)
    for group, own in zip((train, validate), halves, strict=True):
        if not own:
            raise UnusableInput(
                f"{group[0].source}: is too short for a band of {hertz:g} Hz; record at least two seconds"
            )
    noisy = noise.estimate_noise(identified, halves, [*train, *validate])
    progress("columns of the catalogue")
    found = course.run(
        identified, (halves[0], halves[1]), noisy, options.trusted, options.names, progress
    )
    one, noisy, scale = found.one, found.noisy, found.scale
    verdict, refitted = (
        held_out_test.tested(one, found.verdict, _moves(halves[1]), (noisy.floor / scale) ** 2),
        None,
    )
    if verdict.findings:
        progress("the base model without what was found")
        one, verdict, refitted = _refitted(
            one,
            verdict,
            identified,
            halves,
            (train, validate),
            settings,
            options,
            noisy.floor,
            scale,
        )
    out = _judged(
        dataclasses.replace(found, one=one, verdict=verdict),
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
    bare = [fitted_effects.removed(out.parts, r, halves[1]) for r in validate]
    return dataclasses.replace(
        out, ahead=(_ahead(identified, validate, hertz), _ahead(out.refitted, bare, hertz))
    )


def _refitted(
    one: EffectRegression,
    verdict: Verdict,
    identified: Identification,
    halves: Sequence[list[RecordedMotion]],
    recordings: tuple[Sequence[Recording], Sequence[Recording]],
    settings: identification.IdentificationOptions,
    options: DiagnosisOptions,
    floor: Array,
    scale: Array,
) -> tuple[EffectRegression, Verdict, Identification]:
    """The base model of the recordings without what was found, and the findings with columns of that model."""
    model, found = identified.model, fitted_effects.parts(one, verdict.together)
    pure = [
        [fitted_effects.removed(found, r, own) for r in group]
        for group, own in zip(recordings, halves, strict=True)
    ]
    refitted = identification.identify(
        model.robot, model.parameters, model.base, pure[0], pure[1], settings, lambda _: None
    )
    body = recorded_motion.fitted_robot(model.robot, model.parameters, equations.kept(refitted.psi, options.trusted))
    again = [[dataclasses.replace(t, fitted_robot=body) for t in own] for own in halves]
    named = {f.main.effect for f in verdict.findings}
    one, verdict = _again(
        one,
        verdict,
        equations.shapes(again, bool(options.trusted), floor, named),
        equations.builder(again, scale),
    )
    return one, verdict, refitted


def _judged(
    found: Course,
    identified: Identification,
    refitted: Identification | None,
    tracks: tuple[list[RecordedMotion], list[RecordedMotion]],
    options: DiagnosisOptions,
    hertz: float,
) -> Diagnosis:
    """Probabilities, and what the held-out recordings say of what is asserted."""
    one, noisy, scale, floor = found.one, found.noisy, found.scale, found.noisy.floor
    found = dataclasses.replace(
        found, verdict=belief.weighed(one, found.verdict, (floor / scale) ** 2, noisy.bounds)
    )
    verdict = found.verdict
    before, after = held_out_test.residuals(one, verdict.together, scale)
    fitted = course.rms(one, (), scale), course.rms(one, verdict.named, scale)
    quiet, expected = noisy.noise_rms, np.sqrt(noisy.noise_rms**2 + held_out_test.reach(one, scale) ** 2)
    moves = _moves(tracks[1])
    rms = [np.sqrt(search.mean_square(r, moves)) for r in (before, after)]
    told = (identified, options, hertz, tracks, one, verdict, floor, noisy.method)
    much = (
        (fitted[1] ** 2 > UNSAID * fitted[0] ** 2)
        | (rms[1] > LOUD * expected)
        | belief.unsure(verdict, len(floor))
        | found.differing
    )
    sights = _sights(search.remaining(one, verdict.named) * scale, tracks, np.flatnonzero(much))
    every = course.rms(
        one,
        (
            *verdict.named,
            *(part.shape for finding in _real(one, verdict) for part in finding.parts),
        ),
        scale,
    )
    doubted = np.sqrt(np.maximum(fitted[1] ** 2 - every**2, 0.0))
    judged = (rms[0], rms[1], (before, after), refitted if verdict.findings else None)
    differs = session_changes.changes(one, found.shapes, tracks) if found.differing else ()
    same = search.mean_square(held_out_test.levelled(one, after / scale) * scale, moves)
    known = {
        "expected": expected,
        "fitted": fitted,
        "noise_rms": quiet,
        "residual_predictions": sights,
        "doubted": doubted,
        "change_rms": np.sqrt(np.maximum(rms[1] ** 2 - same, 0.0)),
    }
    return Diagnosis(*told, *judged, **known, changes=differs)


def _real(one: EffectRegression, verdict: Verdict) -> tuple[Finding, ...]:
    """What is doubted for its name, and nothing that an encoder's steps may feign."""
    return tuple(
        f
        for f in verdict.doubted
        if belief.genuine(one, f.main.effect, f.main.joint, f.gain) > GENUINE
    )


def _sights(
    left: Array, tracks: tuple[list[RecordedMotion], list[RecordedMotion]], joints: Iterable[int]
) -> dict[int, ResidualPrediction]:
    """What a flexible model foresees of what is left of both halves' torque at some joints. left: Shape (N, n) [N m]."""
    rows = residual_curves.motion_rows([*tracks[0], *tracks[1]])
    first = np.arange(len(rows)) < sum(len(one) for one in tracks[0])
    out = {}
    for j in joints:
        moves = rows.moving[:, j]
        out[int(j)] = unmodelled.predict_residual(rows, (moves & first, moves & ~first), left[:, j], int(j))
    return out


def _ahead(
    fitted: Identification, recordings: Sequence[Recording], hertz: float
) -> SimulationError | None:
    """Positions that a model predicts from recorded torque. Effects act as along the recorded motion: their torque is taken off it."""
    groups, share = simulation_error.cut_windows(list(segments.extract_segments(recordings, average=False)), hertz)
    return (
        simulation_error.compute_simulation_error(fitted.model, fitted.psi, fitted.psi, groups, share)
        if groups
        else None
    )


def _again(
    one: EffectRegression, verdict: Verdict, shapes: Sequence[CandidateModel], build: search.Build
) -> tuple[EffectRegression, Verdict]:
    """The same findings with columns of a base model that they no longer distort, or those of them that predict better then; as they were,
    where that finds others."""
    assert verdict.together is not None
    named = {(f.main.effect, f.main.joint) for f in verdict.findings}
    made = late.renewed(one, verdict.together, [s for s in shapes if (s.effect, s.joint) in named])
    small = search.design(one.halves, made, build)
    small, better = late.followed(
        *judge.judged(dataclasses.replace(small, measured=one.measured)), again=True
    )
    found = {(f.main.effect, f.main.joint) for f in better.findings}
    if better.together is None or (found != named and better.together.gain < verdict.together.gain):
        return one, verdict
    start = len(one.shapes)
    wider = search.appended(
        dataclasses.replace(one, build=build), [small.shapes[i] for i in better.together.shapes]
    )
    if len(wider.shapes) != start + len(better.together.shapes):
        return one, verdict
    if found == named:
        return wider, judge.moved(wider, verdict, better, start)
    return wider, judge.instead(wider, verdict, range(start, len(wider.shapes)))


def _moves(half: Sequence[RecordedMotion]) -> Array:
    """Rows of one half that are judged. Shape (N, n)."""
    return np.concatenate([one.moving for one in half])


def _left(before: Array, after: Array, floor: Array) -> Array:
    """Of the mean square beyond the noise, what remains. Shape (n,)."""
    return np.asarray(
        np.maximum(after**2 - floor**2, 0.0) / np.maximum(before**2 - floor**2, 0.1 * floor**2)
    )
