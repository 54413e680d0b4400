"""Read the explanations of a `diagnosis.json` for `excite design --discriminate`."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..designer.criteria import Criterion
from ..designer.design_objective import SampledMotion
from ..designer.discrimination import Comparison, SeparationObjective
from ..designer.discrimination_design import (
    CandidateExplanation,
    ExplanationSet,
    competing_pairs,
    sampled_motion,
)
from ..designer.discrimination_result import DiscriminationResult
from ..designer.effect_columns import (
    SYMBOLIC_EFFECTS,
    UNKNOWN,
    RobotConstants,
    SymbolicEffect,
    curve_values,
)
from ..designer.experiment_menu import compute_menu
from ..designer.explanations import EffectSpecification, stated_factor, symbolic_effect
from ..designer.options import DesignOptions
from ..designer.problem import DesignProblem
from ..effects import EFFECTS_BY_NAME
from ..errors import ExciteWarning, UnusableInput
from ..identification.identified_model import read_model
from ..robot import inertial_parameters
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import COULOMB_WIDTH
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..robot.samples import Samples
from ..schemas.diagnosis import (
    FindingDocument,
    JointNoiseDocument,
    ResponseDocument,
    UnknownDocument,
    diagnosis_file,
    read_diagnosis,
)
from ..schemas.document_file import DocumentFile
from ..trajectory.fourier import FourierSeries
from .identification_result import REFERENCE_RATE

MIN_PROBABILITY = 0.02
"""Probability that an explanation has at least, however small the diagnosis states it [1]."""
MAX_CONSIDERED = 4
"""Considered effects of a joint that compete, the most probable ones [1]."""
CURVE_REGIMES = {
    "position": (False, False),
    "place": (False, False),
    "position and direction": (False, True),
    "speed": (True, False),
}
"""Regimes of unknown torque that its curve determines: whether the curve is over the speed, and
whether the torque changes its sign with the direction of motion."""
MIN_CURVE_POINTS = 3
"""Points of a curve from which it competes [1]."""
MAX_GIVEN_ROWS = 2000
"""Rows of an earlier recording that count as one period [1]: 20 s, of which the ends are a small
part."""
WITHOUT_JOINT = ("delay", "gravity_tilt")
"""Effects of `SYMBOLIC_EFFECTS` that need no joint."""


@dataclass(frozen=True)
class DiagnosisQuestions:
    """Questions that a diagnosis leaves open.

    Attributes:
        source: Path of the diagnosis.
        explanations: Competing explanations.
        omitted: Effects that take no part, and why.
        noise: Torque noise that the diagnosis found, by joint [N m]; None where it is not stated.
    """

    source: str
    explanations: ExplanationSet
    omitted: tuple[str, ...]
    noise: tuple[float, ...] | None = None

    def with_given(self, given: Sequence[tuple[Samples, Robot]]) -> DiagnosisQuestions:
        """Return the questions with the motions of earlier recordings.

        Args:
            given: Their samples at `REFERENCE_RATE`, and the robots whose dynamics their torques
                contain.
        """
        constants = self.explanations.constants
        motions = []
        for samples, robot in given:
            for start in range(0, len(samples), MAX_GIVEN_ROWS):
                part = samples.rows(slice(start, start + MAX_GIVEN_ROWS))
                Y = regressor(robot, constants.parameters, part)
                motions.append(
                    SampledMotion(part.q, part.dq, part.ddq, Y, len(part) / REFERENCE_RATE)
                )
        return replace(self, explanations=replace(self.explanations, given=tuple(motions)))

    def result(
        self, problem: DesignProblem, limits: Limits, designed: FourierSeries
    ) -> DiscriminationResult:
        """Return what the recording of a designed motion is expected to decide.

        Args:
            problem: The design problem, with its objective and its reference motion.
            limits: Limits of the robot.
            designed: The designed motion.
        """
        objective, reference = problem.objective, problem.warm_start
        assert isinstance(objective, SeparationObjective) and reference is not None
        odds = [
            0.5 * objective.separations(sampled_motion(problem.robot, problem.parameters, motion))
            for motion in (reference, designed)
        ]
        return DiscriminationResult(
            self.source,
            problem.robot.joints,
            objective.explanations,
            objective.comparisons,
            objective.undecidable,
            self.omitted,
            odds[0],
            odds[1],
            compute_menu(problem, limits, objective, reference, designed),
            objective.given is not None,
        )


def read_questions(
    path: Path, robot: Robot, limits: Limits, options: DesignOptions
) -> DiagnosisQuestions:
    """Read the competing explanations of a diagnosis.

    Each finding competes with its equivalents and rivals, and with the effects considered at its
    joint; what stands alone competes with no effect at all. The findings elsewhere are fitted
    jointly. Load and friction are those of the `model.json` next to the diagnosis where it fits the
    robot.

    Args:
        path: The `diagnosis.json`.
        robot: The robot.
        limits: Its limits.
        options: Options of the design.

    Raises:
        UnusableInput: The file cannot be used, names other joints, or leaves nothing to decide; or
            the options ask for another criterion.
    """
    if options.criterion is not Criterion.A or options.plain:
        raise UnusableInput(
            f"--discriminate {path}: replaces the criterion; leave out --criterion and --plain"
        )
    document = read_diagnosis(path)
    builder = _Builder(diagnosis_file(path), robot, _constants(path, robot, limits, options))
    builder.add_findings(document.findings)
    builder.add_considered(document.considered)
    builder.add_unknown(document.unknown)
    comparisons = builder.comparisons()
    if not comparisons:
        raise UnusableInput(
            f"{path}: leaves nothing to decide by a motion"
            + (f" ({'; '.join(builder.omitted)})" if builder.omitted else "")
            + "; design with --for or --criterion"
        )
    explanations = ExplanationSet(builder.constants, tuple(builder.candidates), comparisons)
    stated: dict[str, JointNoiseDocument] = {str(k): v for k, v in document.joints.items()}
    floors = [stated.get(joint, JointNoiseDocument()).noise_floor for joint in robot.joints]
    noise = tuple(floor for floor in floors if floor)
    return DiagnosisQuestions(
        str(path),
        explanations,
        tuple(builder.omitted),
        noise if len(noise) == robot.n else None,
    )


def _constants(path: Path, robot: Robot, limits: Limits, options: DesignOptions) -> RobotConstants:
    """Return the robot with identified parameters where the model next to the diagnosis fits it."""
    standard = inertial_parameters.standard_parameters(robot, limits, options.drive)
    psi, widths = standard.nominal, np.full(robot.n, COULOMB_WIDTH)
    model = path.parent / "model.json"
    if model.is_file():
        fitted = read_model(model)
        if fitted.robot.joints == robot.joints and len(fitted.psi) == standard.count:
            psi, widths = fitted.psi, fitted.widths
        else:
            warnings.warn(
                f"{model}: has other joints or parameters than the robot; loads and friction are "
                "those of the URDF",
                ExciteWarning,
                stacklevel=2,
            )
    return RobotConstants(robot, standard, psi, widths, limits)


def _shares(finding: FindingDocument) -> dict[str, float]:
    """Return the probability of a finding and of each rival, which sum to its probability.

    The odds are those that the diagnosis states, or else even.
    """
    log_odds = {rival.effect: rival.log_odds for rival in finding.rivals}
    names = tuple(dict.fromkeys((finding.effect, *finding.equivalents, *log_odds)))
    logs = np.array([-(log_odds.get(name) or 0.0) for name in names])
    weights = np.exp(logs - logs.max())
    shares = finding.probability * weights / weights.sum()
    return dict(zip(names, shares.tolist(), strict=True))


def _is_usable(response: ResponseDocument) -> bool:
    """Tell whether a curve has enough points, in ascending order."""
    x, y = np.array(response.x), np.array(response.y)
    return len(x) == len(y) >= MIN_CURVE_POINTS and bool(
        (np.diff(x) > 0.0).all() and np.isfinite([x, y]).all() and np.abs(y).max() > 0.0
    )


class _Builder:
    """Collect explanations and comparisons.

    Attributes:
        file: The diagnosis, for messages.
        robot: The robot.
        constants: The robot with its parameters.
        candidates: Explanations so far.
        omitted: Effects that take no part, and why.
    """

    def __init__(self, file: DocumentFile, robot: Robot, constants: RobotConstants) -> None:
        """Begin without explanations."""
        self.file, self.robot, self.constants = file, robot, constants
        self.candidates: list[CandidateExplanation] = []
        self.omitted: list[str] = []
        self._classes: list[list[int]] = []
        self._considered: list[int] = []
        self._unknown: list[int] = []

    def _joint(self, name: str | None, where: str) -> int | None:
        """Return the index of a joint."""
        if name is None:
            return None
        if name not in self.robot.joints:
            raise UnusableInput(
                f"{self.file.path}: {where}: no joint '{name}'; the joints are "
                f"{', '.join(self.robot.joints)}; choose them with --joints"
            )
        return self.robot.joints.index(name)

    def _add(
        self,
        specification: EffectSpecification,
        probability: float,
        like: int | None = None,
    ) -> int | None:
        """Add an explanation and return its index; None where it cannot take part."""
        effect, joint = specification.effect, specification.joint
        if effect not in EFFECTS_BY_NAME:
            raise UnusableInput(
                f"{self.file.path}: this version has no effect '{effect}'; diagnose again"
            )
        place = "" if joint is None else f" at {self.robot.joints[joint]}"
        if effect not in SYMBOLIC_EFFECTS or (joint is None and effect not in WITHOUT_JOINT):
            self.omitted.append(f"{effect}{place}: its torque is no smooth function of the motion")
            return None
        if effect == "coupling" and self.robot.n == 1:
            self.omitted.append(f"{effect}{place}: the robot has no other joint")
            return None
        form = symbolic_effect(specification, self.constants)
        for index, other in enumerate(self.candidates):
            if other.form.effect == effect and other.form.joint == joint:
                return index
        factor = stated_factor(specification, form)
        self.candidates.append(
            CandidateExplanation(form, factor, max(probability, MIN_PROBABILITY), like)
        )
        return len(self.candidates) - 1

    def _specification(self, finding: FindingDocument, where: str) -> EffectSpecification:
        """Return the effect of a finding."""
        parameters = {
            name: entry.value
            for name, entry in finding.parameters.items()
            if entry.value is not None
        }
        return EffectSpecification(
            finding.effect,
            self._joint(finding.joint, f"{where}.joint"),
            parameters,
            self._joint(finding.other, f"{where}.from"),
        )

    def add_findings(self, findings: Sequence[FindingDocument]) -> None:
        """Add each finding, its equivalents and its rivals as one class."""
        specifications = [
            self._specification(finding, f"findings[{number}]")
            for number, finding in enumerate(findings)
        ]
        shares = [_shares(finding) for finding in findings]
        # findings first, as one that is also the equivalent of another has parameters of its own
        mains = [
            self._add(specification, share[finding.effect])
            for finding, specification, share in zip(findings, specifications, shares, strict=True)
        ]
        for main, specification, share in zip(mains, specifications, shares, strict=True):
            members = [] if main is None else [main]
            for name, probability in share.items():
                rival = EffectSpecification(name, specification.joint, {})
                index = self._add(rival, probability, main)
                if index is not None and index not in members:
                    members.append(index)
            if members:
                self._classes.append(members)

    def add_considered(self, considered: Sequence[FindingDocument]) -> None:
        """Add the most probable considered effects of each joint."""
        counts: dict[str | None, int] = {}
        order = sorted(range(len(considered)), key=lambda k: -considered[k].probability)
        for number in order:
            finding = considered[number]
            if counts.get(finding.joint, 0) == MAX_CONSIDERED:
                continue
            specification = self._specification(finding, f"considered[{number}]")
            before = len(self.candidates)
            index = self._add(specification, finding.probability)
            if index is not None and index == before:
                self._considered.append(index)
                counts[finding.joint] = counts.get(finding.joint, 0) + 1

    def add_unknown(self, unknown: Sequence[UnknownDocument]) -> None:
        """Add the curve of each torque that no effect explains."""
        for number, entry in enumerate(unknown):
            joint = self._joint(entry.joint, f"unknown[{number}].joint")
            response, regime = entry.where.response, entry.where.regime
            is_curve = response is not None and not response.relative and regime in CURVE_REGIMES
            if response is None or not is_curve or not _is_usable(response):
                self.omitted.append(
                    f"unknown torque at {entry.joint}: no curve over position or speed ({regime})"
                )
                continue
            over_speed, directed = CURVE_REGIMES[regime]
            values = curve_values(response.x, response.y, over_speed=over_speed, directed=directed)
            name, colon, _ = response.over.rpartition(": ")
            other = self._joint(name, f"unknown[{number}].where.response.over") if colon else None
            self.candidates.append(
                CandidateExplanation(
                    SymbolicEffect(UNKNOWN, joint, values, other),
                    np.ones((1, 1)),
                    max(entry.probability, MIN_PROBABILITY),
                )
            )
            self._unknown.append(len(self.candidates) - 1)

    def _nuisance(self, *pair: int | None) -> tuple[int, ...]:
        """Return the main explanation of every class that neither of a pair belongs to."""
        return tuple(
            members[0] for members in self._classes if not any(index in members for index in pair)
        )

    def comparisons(self) -> tuple[Comparison, ...]:
        """Return all comparisons, with weights that sum to 1."""
        probabilities = [candidate.probability for candidate in self.candidates]
        out: list[Comparison] = []
        for members in self._classes:
            out += competing_pairs(members, probabilities, self._nuisance)
        for index in (*self._considered, *self._unknown):
            joint = self.candidates[index].form.joint
            rivals = [
                rival
                for rival in (
                    *(members[0] for members in self._classes),
                    *(self._considered if index in self._unknown else ()),
                )
                if self.candidates[rival].form.joint == joint
            ]
            for pair in ([index, rival] for rival in rivals):
                out += competing_pairs(pair, probabilities, self._nuisance)
        alone = [members[0] for members in self._classes if len(members) == 1]
        for index in itertools.chain(alone, self._considered, self._unknown):
            p = probabilities[index]
            weight = max(p * (1.0 - p), MIN_PROBABILITY)
            out.append(Comparison(index, None, self._nuisance(index), weight))
        # effects that are each other's equivalents form two classes with the same questions
        unique = {(c.true, c.rival): c for c in reversed(out)}.values()
        total = sum(c.weight for c in unique)
        return tuple(replace(c, weight=c.weight / total) for c in reversed(unique))
