"""Concealed cases for motions that discriminate: one more run of a robot of unknown physics.

A case is a simulated robot with hidden effects whose diagnosis from one recording leaves a class of
two or more names of which exactly one acts at the joint, and does not decide for it yet. The robot
then moves once more: along a motion designed to discriminate, a D-optimal one, a random one and a
repeat, each of two periods of 8 s between ramps. Each recording is diagnosed together with the
first one. One JSON file per candidate, so that an interrupted run continues, and one folder per
case with its recordings, designs and first diagnosis.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from concealed_trial.case_plan import CasePlan, CaseSpec
from concealed_trial.generate_cases import (
    GeneratedCase,
    analyst_files,
    case_settings,
    generate_case,
)
from concealed_trial.random_excitation import PERIOD, draw_excitation

from excite import api
from excite.api.design_result import CellOptions, motion_samples
from excite.api.discriminating_design import read_questions
from excite.designer import optimize
from excite.designer.criteria import Criterion
from excite.designer.design_objective import SampledMotion
from excite.designer.discrimination import SeparationObjective
from excite.designer.options import DesignOptions
from excite.diagnosis import rival_evidence
from excite.errors import ExciteError, ExciteWarning, UnusableInput
from excite.robot import limits, robot
from excite.robot.dynamics import regressor
from excite.robot.robot import locate
from excite.robot.samples import Samples
from excite.schemas.effects import CONFUSABLE_PAIRS
from excite.simulator.effect_instance import with_effects
from excite.simulator.experiment import run_session
from excite.simulator.recording_file import json_text
from excite.simulator.reference_trajectory import ReferenceTrajectory, read_reference
from excite.trajectory.trajectory_file import read_trajectory

ARMS = ("discriminating", "D-optimal", "random", "repeat")
"""Motions of the second recording."""
GROUPS = ("sparse", "half_dense")
"""Groups of the concealed trial from which cases are drawn, in its proportions: where every
friction acts at every joint, no class of them has a single truth."""
CONFUSABLE = frozenset(name for pair in CONFUSABLE_PAIRS for name in pair)
"""Effects that sparse cases hide: those of which one recording often leaves a class."""
ROBOTS = (*("two_link",) * 5, "ur5e")
"""Robots of the cases, in turn."""
FIRST_RECORDING = "poor_excitation"
"""Nuisance condition of all cases: the first motion has one harmonic at a tenth of the speed, which
leaves most open."""
SEVERITIES = (1.0, 3.0)
"""Severities of the named effects [1]: larger ones are rarely confused."""
PERIODS = 2
"""Periods of the second recording."""
MARGIN = 0.15
"""Share of the limits that designed motions leave to the controller [1]."""
HARMONICS = 5
"""Harmonics of the designed motions, as of the random ones."""
STARTS = 3
"""Starts of each design."""
SAMPLES = 40 * HARMONICS
"""Samples of the optimiser over one period, as in a design that discriminates."""
SAMPLE_RATE = 100.0
"""Samples per second of the motions whose separation is predicted [Hz]."""
SYNONYMS = {"drag": "nonlinear_viscous"}
"""Names that count as one: convex nonlinear viscous friction and drag are equivalents."""
DECIDED = ("right", "wrong", "open")
"""Outcomes of a second recording."""


def canonical(name: str) -> str:
    """Return the name under which an effect counts."""
    return SYNONYMS.get(name, name)


def plan(count: int, seed: int, robots: Sequence[str] = ROBOTS) -> list[CaseSpec]:
    """Return the specifications of candidate cases: one training recording, no prior.

    Args:
        count: Number of candidates.
        seed: Seed of the plan.
        robots: Built-in robots of the cases, in turn.
    """
    drawn = CasePlan(8 * count, seed, "scored", GROUPS).specs()
    usable = [spec for spec in drawn if not spec.trusted and set(spec.names) <= CONFUSABLE][:count]
    return [
        dataclasses.replace(
            spec,
            robot=robots[k % len(robots)],
            training=1,
            nuisance=FIRST_RECORDING,
            severities=tuple(SEVERITIES[spec.seed % len(SEVERITIES)] for _ in spec.names),
        )
        for k, spec in enumerate(usable)
    ]


@dataclass(frozen=True)
class OpenClass:
    """A class of names that a diagnosis leaves open.

    Attributes:
        joint: Name of the joint; None for effects of no single joint.
        names: The finding, its equivalents and its rivals.
        truth: The one of them that acts at the joint.
    """

    joint: str | None
    names: tuple[str, ...]
    truth: str


def open_classes(document: Mapping[str, Any], case: GeneratedCase) -> Iterator[OpenClass]:
    """Yield the classes of a diagnosis that contain exactly one acting effect.

    Args:
        document: Content of `diagnosis.json`.
        case: The case.
    """
    acting = {(canonical(e.name), e.joint) for e in case.effects_of_session(0)}
    anywhere = {name for name, _ in acting}
    for finding in document["findings"]:
        rivals = (rival["effect"] for rival in finding.get("rivals", ()))
        names = tuple(dict.fromkeys((finding["effect"], *finding["equivalents"], *rivals)))
        if len({canonical(name) for name in names}) < 2:
            continue
        joint = finding["joint"]
        true = [
            name
            for name in names
            if (canonical(name) in anywhere and joint is None)
            or {(canonical(name), joint), (canonical(name), None)} & acting
        ]
        if len({canonical(name) for name in true}) == 1:
            yield OpenClass(finding["joint"], names, true[0])


def outcome_by_evidence(arm: Mapping[str, Any]) -> str:
    """Return one of `DECIDED` for the evidence of a diagnosis alone.

    Right: it excludes every rival. Wrong: it excludes the truth in favour of a rival.

    Args:
        arm: Entry of the diagnosis.
    """
    least = min(map(rival_evidence.log_odds, arm["realised"].values()), default=0.0)
    if least >= rival_evidence.DECIDED_LOG_ODDS:
        return "right"
    return "wrong" if least <= -rival_evidence.DECIDED_LOG_ODDS else "open"


def outcome(arm: Mapping[str, Any]) -> str:
    """Return one of `DECIDED` for a diagnosis, open where names and evidence do not agree.

    Args:
        arm: Entry of the diagnosis.
    """
    by_evidence = outcome_by_evidence(arm)
    return by_evidence if by_evidence == arm["outcome"] else "open"


def named_outcome(document: Mapping[str, Any], question: OpenClass) -> str:
    """Return one of `DECIDED` for the names of a diagnosis after the second recording.

    Right: the acting effect is reported alone, and no other name of the class at the joint. Wrong:
    another name of the class is reported alone, and the acting effect nowhere at the joint.

    Args:
        document: Content of `diagnosis.json`.
        question: The class.
    """
    truth = canonical(question.truth)
    members = {canonical(name) for name in question.names}
    reported = [
        {canonical(name) for name in (finding["effect"], *finding["equivalents"])}
        for finding in document["findings"]
        if finding["joint"] in (question.joint, None) or question.joint is None
    ]
    named = [names for names in reported if names & members]
    if named == [{truth}]:
        return "right"
    if not any(truth in names for names in named) and any(
        len(names) == 1 and truth not in names for names in named
    ):
        return "wrong"
    return "open"


class Trial:
    """Second recordings of a case and their diagnoses.

    Attributes:
        case: The case.
        folder: Folder with the files of the analyst.
        robot: Path of the URDF.
        first: Diagnosis of the first recording.
    """

    def __init__(self, case: GeneratedCase, folder: Path) -> None:
        """Write the files of the analyst, and diagnose the first recording."""
        self.case, self.folder = case, folder
        for name, text in analyst_files(case).items():
            (folder / name).write_text(text, encoding="utf-8")
        self.robot = folder / "robot.urdf"
        self.first = api.diagnose(
            self.robot, [folder / "train.csv"], [folder / "validate.csv"], with_report=False
        )
        self.first.save(folder / "before")

    def design(self, **criterion: Any) -> api.DesignResult:
        """Design a motion of the second recording."""
        return api.design(
            self.robot,
            margin=MARGIN,
            cell=CellOptions(check=False),
            period=PERIOD,
            harmonics=HARMONICS,
            periods=PERIODS,
            starts=STARTS,
            jobs=1,
            **criterion,
        )

    def motions(self) -> tuple[dict[str, ReferenceTrajectory], SeparationObjective, float]:
        """Return the motion of each arm, the objective, and the time of the design [s]."""
        given = [self.folder / "train.csv"]
        begun = time.process_time()
        best = self.design(discriminate=self.folder / "before" / "diagnosis.json", given=given)
        seconds = time.process_time() - begun
        best.save(self.folder / "discriminating")
        self.design(criterion=Criterion.D).save(self.folder / "d_optimal")
        objective = best.delivery.design.setup.problem.objective
        assert isinstance(objective, SeparationObjective)
        return motions_of(self.case, self.folder), objective, seconds

    def record(self, arm: str, motion: ReferenceTrajectory) -> Path:
        """Record the robot along a motion; return the file."""
        settings = case_settings(self.case.spec)
        number = 10 + ARMS.index(arm)
        session = run_session(
            with_effects(self.case.robot, self.case.effects_of_session(1)),
            motion,
            dataclasses.replace(settings, seed=settings.seed + number),
        )
        path = self.folder / f"{arm}.csv"
        path.write_text(session.recording.to_csv(), encoding="utf-8")
        sidecar = {**session.recording.to_sidecar(), "notes": ""}
        path.with_suffix(".json").write_text(json_text(sidecar), encoding="utf-8")
        return path

    def diagnose(self, recording: Path) -> api.DiagnosisResult:
        """Diagnose a second recording together with the first."""
        return api.diagnose(
            self.robot,
            [self.folder / "train.csv"],
            [self.folder / "validate.csv"],
            discriminating=[recording],
            before=self.folder / "before" / "diagnosis.json",
            with_report=False,
        )


def motions_of(case: GeneratedCase, folder: Path) -> dict[str, ReferenceTrajectory]:
    """Return the motion of each arm.

    Args:
        case: The case.
        folder: Folder of its files, with both designs.
    """
    motions = (
        read_reference(folder / "discriminating" / "trajectory.json"),
        read_reference(folder / "d_optimal" / "trajectory.json"),
        draw_excitation(case.robot, PERIODS, np.random.default_rng([case.spec.seed, 7])),
        case.motions[0],
    )
    return dict(zip(ARMS, motions, strict=True))


def renewed(path: Path) -> None:
    """Compute the expected evidence of a case again, by its recordings and designs.

    Args:
        path: Result of the case.
    """
    entry, folder = _read(path), path.with_suffix("")
    names = ("names", "severities")
    spec = CaseSpec(**entry["spec"] | {name: tuple(entry["spec"][name]) for name in names})
    case = generate_case(spec, locate("two_link").parent)
    question = OpenClass(**entry["question"] | {"names": tuple(entry["question"]["names"])})
    machine = robot.load(folder / "robot.urdf")
    table = limits.resolve(machine)
    train = motion_samples(folder / "train.csv", machine)[:2]
    diagnosis = folder / "before" / "diagnosis.json"
    questions = read_questions(diagnosis, machine, table, DesignOptions()).with_given([train])
    options = DesignOptions(
        Criterion.D,
        period=PERIOD,
        harmonics=HARMONICS,
        periods=PERIODS,
        samples=SAMPLES,
        noise=questions.noise,
    )
    setup = optimize.set_up(machine, table, options)
    reference = read_trajectory(folder / "d_optimal" / "trajectory.json").motion.fourier
    objective = questions.explanations.objective(setup.problem, setup.base, reference)
    for arm, motion in motions_of(case, folder).items():
        entry["arms"][arm]["expected"] = expected_evidence(objective, motion, question)
    _write(entry, path)


def renew(folder: Path, jobs: int) -> None:
    """Compute the expected evidence of all cases again, after a change of the forecast.

    Args:
        folder: Folder of the results.
        jobs: Number of processes.
    """
    paths = [path for path in sorted(folder.glob("*.json")) if _read(path)["status"] == "class"]
    joblib.Parallel(n_jobs=jobs)(joblib.delayed(renewed)(path) for path in paths)


def expected_evidence(
    objective: SeparationObjective, motion: ReferenceTrajectory, question: OpenClass
) -> dict[str, float]:
    """Return the expected log Bayes factor of the truth over each rival of its class.

    Args:
        objective: Objective of the discriminating motion, with what is given.
        motion: The motion of the second recording.
        question: The class.
    """
    robot, parameters = objective.effects.constants.robot, objective.effects.constants.parameters
    times = motion.periodic[0] + np.arange(round(motion.period * SAMPLE_RATE)) / SAMPLE_RATE
    q, dq, ddq = motion.at(times)
    Y = regressor(robot, parameters, Samples(q, dq, ddq))
    values = 0.5 * objective.separations(SampledMotion(q, dq, ddq, Y, motion.period))
    out = {}
    for comparison, value in zip(objective.comparisons, values.tolist(), strict=True):
        true = objective.explanations[comparison.true].form
        if comparison.rival is None or true.effect != question.truth:
            continue
        joint = None if true.joint is None else robot.joints[true.joint]
        rival = objective.explanations[comparison.rival].form
        if joint == question.joint and rival.effect in question.names:
            out[rival.effect] = value
    return out


def realised_evidence(result: api.DiagnosisResult, question: OpenClass) -> dict[str, float]:
    """Return the log Bayes factor of the truth over each rival of its class.

    Args:
        result: Diagnosis of both recordings.
        question: The class.
    """
    classes = () if result.decisions is None else result.decisions.classes
    known = (e for j, e in classes if j == question.joint and set(question.names) == set(e))
    evidence = next(known, None)
    if evidence is None:
        joints = result.diagnosis.identified.model.robot.joints
        joint = None if question.joint is None else joints.index(question.joint)
        fit = result.diagnosis
        evidence = rival_evidence.compare(fit.model, fit.effects, joint, question.names)
    return {
        name: evidence[question.truth] - evidence[name]
        for name in question.names
        if canonical(name) != canonical(question.truth)
    }


def examine(spec: CaseSpec, work: Path) -> dict[str, Any]:
    """Return the result of a case.

    Args:
        spec: Specification of the case.
        work: Folder of its files, which stays if it has an open class.
    """
    begun = time.process_time()
    out: dict[str, Any] = {"spec": dataclasses.asdict(spec), "status": "no class"}
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    try:
        case = generate_case(spec, locate("two_link").parent)
        trial = Trial(case, work)
        questions = list(open_classes(trial.first.document(), case))
        entries = [(question, _decided(trial.first, question)) for question in questions]
        for question, before in entries:
            if outcome(before) != "right":
                out |= {"before": before} | _compared(trial, question)
                break
        else:
            out["status"] = "decided" if questions else "no class"
    except ExciteError as error:
        out |= {"status": "error", "error": str(error).splitlines()[0]}
    if out["status"] != "class":
        shutil.rmtree(work)
    out["seconds"] = time.process_time() - begun
    return out


def _decided(result: api.DiagnosisResult, question: OpenClass) -> dict[str, Any]:
    """Return the names that a diagnosis gives and its evidence in a class."""
    document = result.document()
    findings = [
        {key: f[key] for key in ("effect", "joint", "probability", "equivalents")}
        for f in document["findings"]
    ]
    return {
        "outcome": named_outcome(document, question),
        "findings": findings,
        "realised": realised_evidence(result, question),
    }


def _compared(trial: Trial, question: OpenClass) -> dict[str, Any]:
    """Return what the second recording of each arm decides."""
    motions, objective, seconds = trial.motions()
    arms = {
        arm: {
            **_decided(trial.diagnose(trial.record(arm, motion)), question),
            "expected": expected_evidence(objective, motion, question),
            "duration": motion.duration,
        }
        for arm, motion in motions.items()
    }
    return {
        "status": "class",
        "question": dataclasses.asdict(question),
        "design_seconds": seconds,
        "arms": arms,
    }


def run(
    folder: Path,
    wanted: int,
    seed: int,
    candidates: int,
    robots: Sequence[str] = ROBOTS,
    jobs: int = 1,
) -> None:
    """Examine candidates until enough of them have an open class; continue where it stopped.

    Args:
        folder: Folder of the results, one JSON file per candidate.
        wanted: Number of cases with an open class; with several processes a few more.
        seed: Seed of the plan.
        candidates: Largest number of candidates.
        robots: Built-in robots of the cases, in turn.
        jobs: Number of processes.

    Raises:
        UnusableInput: The folder has results of another plan.
    """
    folder.mkdir(parents=True, exist_ok=True)

    def open_candidates() -> Iterator[Any]:
        for number, spec in enumerate(plan(candidates, seed, robots)):
            cases = sum(entry["status"] == "class" for entry in results(folder))
            print(f"candidate {number}: {cases} of {wanted} cases", end="\r", file=sys.stderr)
            if cases >= wanted:
                return
            path = folder / f"{number:04d}.json"
            if not path.exists():
                yield joblib.delayed(_examine_and_save)(spec, path)
            elif _read(path)["spec"]["seed"] != spec.seed:
                raise UnusableInput(
                    f"{path}: is a case of another plan; use the same --seed, --candidates and "
                    "--robots, or another --folder"
                )

    # candidates are drawn as processes become free, so that no work is done beyond the last case
    joblib.Parallel(n_jobs=jobs, pre_dispatch="n_jobs", batch_size=1)(open_candidates())
    print(file=sys.stderr)


def _examine_and_save(spec: CaseSpec, path: Path) -> None:
    """Examine a candidate and write its result."""
    warnings.simplefilter("ignore", ExciteWarning)
    _write(examine(spec, path.with_suffix("")), path)


def _write(entry: Mapping[str, Any], path: Path) -> None:
    """Write the result of a candidate."""
    staged = path.with_suffix(".part")
    staged.write_text(json.dumps(entry), encoding="utf-8")
    staged.rename(path)


def results(folder: Path) -> list[dict[str, Any]]:
    """Read the results of all candidates so far."""
    return [_read(path) for path in sorted(folder.glob("*.json"))]


def _read(path: Path) -> dict[str, Any]:
    """Read the result of a candidate."""
    return dict(json.loads(path.read_text(encoding="utf-8")))
