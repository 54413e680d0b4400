"""Design an excitation trajectory: search, certificate, identifiability analysis, files."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from .. import _json, recordings
from .._system.one_or_several import one_or_several, one_or_several_texts
from .._system.progress import Progress, logger
from .._types import FloatArray, Paths
from ..collision import clearance_builder, scene_file
from ..collision.scene_file import Scene
from ..collision.workcell import NOT_CHECKED, Cell
from ..designer import (
    experiment_comparison,
    identifiability,
    optimize,
    pipeline,
    task_variance,
    time_budget,
)
from ..designer import validation_trajectory as validation
from ..designer.criteria import Criterion
from ..designer.discrimination_result import DiscriminationResult
from ..designer.identifiability_threshold import IDENTIFIABLE_VARIANCE
from ..designer.isolability_forecast import PairForecast, forecast_isolability
from ..designer.motion_overlap import OverlapPenalty
from ..designer.options import DesignOptions, WorkspaceBox, torque_noise_levels
from ..designer.payload_weighting import PayloadDeviation, payload_deviation
from ..designer.task_variance import TaskPrediction
from ..errors import UnusableInput
from ..exporters import csv_json, file_format
from ..recordings.periodicity import with_detected_period
from ..robot import dynamics, inertial_parameters
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..robot.samples import Samples
from ..trajectory.trajectory_file import Trajectory
from . import identification_result
from .discriminating_design import DiagnosisQuestions, read_questions
from .identification_result import (
    TrajectorySources,
    reference_samples,
    robot_of_torque,
    with_trajectory,
)
from .input_files import argument_files
from .robots import RobotSource, load_robot, resolve_limits
from .saved_result import SavedResult
from .task_design import TaskDesign, is_recording, read_task, trajectory_samples

MOTION_FILES: tuple[str, ...] = ("trajectory.json", "trajectory.csv")
"""Files of a motion."""
DESIGN_FILES = (
    *MOTION_FILES,
    "identifiability.json",
    "report.html",
    *(f"{validation.VALIDATION_FOLDER}/{name}" for name in MOTION_FILES),
)
"""Files of a design; a validation motion of an earlier design is removed with it."""
PAYLOAD_SECONDS = 15.0
"""Robot time of a motion for a payload, unless it is stated [s]."""
SEPARATION_STARTS = 4
"""Random starts of a discriminating motion where none are stated; separations have more local
optima than criteria."""


@dataclass(frozen=True)
class CellOptions:
    """Surroundings of the robot.

    Attributes:
        scene: Scene file (TOML), None without.
        floor: Height of the floor in the base frame [m]; False: none; None: the mounting plane.
        clearance: Smallest allowed distance [m]; None: that of the scene, or 0.02.
        srdf: SRDF whose disabled pairs of links may touch.
        packages: Folder or folders of `package://` meshes.
        check: True if distances are checked.
    """

    scene: str | Path | None = None
    floor: float | bool | None = None
    clearance: float | None = None
    srdf: str | Path | None = None
    packages: Paths = ()
    check: bool = True

    def __post_init__(self) -> None:
        """Refuse surroundings that would not be checked.

        Raises:
            UnusableInput: There are some.
        """
        stated = {
            "--scene": self.scene,
            "--srdf": self.srdf,
            "--floor": None if self.floor is False else self.floor,
            "--clearance": self.clearance,
        }
        given = [option for option, value in stated.items() if value is not None]
        if given and not self.check:
            raise UnusableInput(
                f"{given[0]}: has no effect with --no-collision; leave one of them out"
            )

    @property
    def package_folders(self) -> tuple[str, ...]:
        """Paths of the folders of `package://` meshes."""
        return one_or_several_texts(self.packages)

    def cell(self, robot: Robot, limits: Limits) -> tuple[Cell | None, str]:
        """Build the cell.

        Returns:
            The cell, or None if distances cannot be checked or are not to be checked; and the
            reason in the latter case.

        Raises:
            UnusableInput: A file cannot be used.
        """
        if not self.check:
            return None, f"{NOT_CHECKED} (--no-collision)"
        return scene_file.find_cell(
            robot, limits, self.read_scene(), self.package_folders, required=self.is_required
        )

    def read_scene(self) -> Scene:
        """Read the scene file and the SRDF, with the floor and the clearance that are stated.

        Raises:
            UnusableInput: A file cannot be used.
        """
        scene = Scene() if self.scene is None else scene_file.read(Path(self.scene))
        scene = scene.overridden(self.floor, self.clearance)
        return scene if self.srdf is None else scene.with_srdf(Path(self.srdf))

    @property
    def is_required(self) -> bool:
        """True if an option is stated that has no meaning without shapes."""
        floor = None if self.floor is False else self.floor
        return any(value is not None for value in (self.scene, self.srdf, floor, self.clearance))


@dataclass(frozen=True)
class DesignResult(SavedResult):
    """A designed motion with its certificate and its identifiability analysis.

    Attributes:
        delivery: The trajectory, its certificate, and the record of the search.
        robot: The robot.
        analysis: Directions of the parameters that the motion makes identifiable.
        validation: The second, different motion; None if none was requested.
        cell: Surroundings that were checked; None if distances were not checked.
        plan: Trade-off of robot time; None without a time budget.
        given_root: Root of the information of earlier recordings; None without. Shape (m, P).
        task_design: Task that the motion was designed for; None without.
        questions: Explanations that the motion was designed to tell apart; None without.
    """

    FILES = DESIGN_FILES

    delivery: pipeline.CertifiedDesign
    robot: Robot
    analysis: identifiability.Identifiability
    validation: validation.ValidationDesign | None = None
    cell: Cell | None = None
    plan: time_budget.BudgetPlan | None = None
    given_root: FloatArray | None = field(default=None, repr=False)
    task_design: TaskDesign | None = field(default=None, repr=False)
    questions: DiagnosisQuestions | None = field(default=None, repr=False)

    @cached_property
    def discrimination(self) -> DiscriminationResult | None:
        """Decisions expected of the recording; None without `--discriminate`."""
        if self.questions is None:
            return None
        problem, trajectory = self.delivery.design.setup.problem, self.delivery.trajectory
        return self.questions.result(problem, trajectory.limits, trajectory.motion.fourier)

    @cached_property
    def isolability(self) -> tuple[PairForecast, ...]:
        """Expected log-odds between often confused effects at each joint, the least first."""
        trajectory, setup = self.trajectory, self.delivery.design.setup
        motion = trajectory.motion
        return forecast_isolability(
            self.robot,
            setup.problem.parameters,
            setup.base,
            trajectory.limits,
            motion.fourier,
            trajectory.noise,
            motion.periods,
        )

    @cached_property
    def task(self) -> TaskPrediction | None:
        """Predicted torque band along the task of `--for`; None without a task."""
        if self.task_design is None:
            return None
        base = self.delivery.design.setup.base
        designed = _motion_root(self.delivery, self.robot)
        return self.task_design.predict(self.robot, base, self.given_root, designed)

    @property
    def ok(self) -> bool:
        """True if every certificate holds."""
        second = self.validation
        return self.delivery.certificate.ok and (second is None or second.delivery.certificate.ok)

    @property
    def trajectory(self) -> Trajectory:
        """The content of `trajectory.json`."""
        first = self.delivery.trajectory
        if self.discrimination is not None:
            expected = self.discrimination.expected_evidence()
            first = replace(first, design={**first.design, "discrimination": expected})
        return first if self.validation is None else self.validation.annotate(first)

    @property
    def parameters(self) -> Parameters:
        """Standard parameters of the robot with their nominal values."""
        return self.delivery.design.setup.problem.parameters

    def at(self, t: float | FloatArray, order: int = 0) -> FloatArray:
        """Evaluate the complete motion or a time derivative of it.

        Args:
            t: Time from the start [s]. Shape () or (N,).
            order: Order of the derivative, 0 to 3.

        Returns:
            Joint positions [rad or m] or derivatives. Shape (n,) or (N, n).
        """
        return self.trajectory.motion.at(t, order)

    @cached_property
    def comparison(self) -> tuple[experiment_comparison.Scenario, ...]:
        """Predicted gain of twice the time and of twice the speed."""
        trajectory, setting = self.trajectory, self.delivery.design.setup
        return compare_experiments(
            self.robot,
            setting.problem.parameters,
            setting.base,
            trajectory,
            self.analysis.threshold,
            self.given_root,
        )

    def contents(self) -> dict[str, str]:
        """Return the files of the design by name, relative to its folder."""
        out = {
            **motion_files(self.trajectory, self.robot, self.parameters),
            "identifiability.json": _json.dumps(self.analysis.document()),
            "report.html": self.html(),
        }
        if self.validation is not None:
            second = motion_files(self.validation.trajectory, self.robot, self.parameters)
            out |= {f"{validation.VALIDATION_FOLDER}/{name}": text for name, text in second.items()}
        return out

    def html(self) -> str:
        """Return the report as HTML."""
        from .. import report

        second = None if self.validation is None else self.validation.trajectory
        return report.design_page(
            self.trajectory,
            self.robot,
            self.parameters,
            self.delivery.design.setup.base,
            self.analysis,
            self.delivery.design.attempts,
            cases=self.comparison,
            second=second,
            cell=self.cell,
            near=self.delivery.certificate.pair_distances,
            task=self.task,
            discrimination=self.discrimination,
            isolability=self.isolability,
        )

    @cached_property
    def payload(self) -> PayloadDeviation | None:
        """Predicted deviations of a payload, of a motion designed for one."""
        setup, trajectory = self.delivery.design.setup, self.trajectory
        link = setup.problem.options.payload_link
        if link is None:
            return None
        samples = trajectory.motion.samples(
            trajectory.motion.grid(identification_result.REFERENCE_RATE)
        )
        noise = np.asarray(trajectory.noise, float)
        return payload_deviation(self.robot, setup.problem.parameters, samples, noise, link)

    def document(self) -> dict[str, Any]:
        """Return what `excite design --json` prints."""
        certificate, trajectory = self.delivery.certificate, self.trajectory
        directions = self.analysis.document()["directions"]
        out = {
            "ok": self.ok,
            "robot": self.robot.name,
            "joints": list(self.robot.joints),
            "base_parameters": self.delivery.design.setup.base.count,
            "identifiable": sum(bool(d["identifiable"]) for d in directions),
            "criteria": dict(trajectory.criteria),
            "timing": self.delivery.timing,
            "margins": trajectory.margins,
            "verdict": certificate.document()["verdict"],
            "collision": trajectory.collision,
            "duration": trajectory.motion.duration,
        }
        out |= {} if self.payload is None else {"payload": self.payload.document()}
        out |= {} if self.validation is None else {"validation": self.validation.document()}
        out |= {} if self.task is None else {"task": self.task.document()}
        if self.discrimination is not None:
            out["discrimination"] = self.discrimination.document()
        out["isolability"] = [dataclasses.asdict(pair) for pair in self.isolability]
        return out | ({} if self.plan is None else {"plan": self.plan.document()})

    def __repr__(self) -> str:
        certificate = self.delivery.certificate
        return (
            f"<DesignResult {self.robot.name}: {self.trajectory.motion.duration:.2f} s, "
            f"clearance {certificate.clearance.value}, limits {certificate.limits.value}>"
        )


def design(
    robot: RobotSource,
    *,
    limits: str | Path | Limits | None = None,
    margin: float | None = None,
    cell: CellOptions = CellOptions(),  # immutable
    options: DesignOptions = DesignOptions(),  # noqa: B008
    period: float | None = None,
    harmonics: int | None = None,
    samples: int | None = None,
    periods: int | None = None,
    time: float | None = None,
    start: Sequence[float] | None = None,
    given: Paths = (),
    trajectory: TrajectorySources = (),
    columns: Mapping[str, str] = MappingProxyType({}),
    for_task: str | Path | None = None,
    discriminate: str | Path | None = None,
    validate: bool = False,
    starts: int | None = None,
    speed: float = 1.0,
    threshold: float = IDENTIFIABLE_VARIANCE,
    force: bool = False,
    progress: Progress | None = None,
    notes: Mapping[str, Any] | None = None,
    **search: Any,
) -> DesignResult:
    """Design, certify and analyse an excitation trajectory, as `excite design` does.

    The motion is a finite Fourier series (Swevers et al. 1997) that is optimal for the geometric
    criterion σ(I·H₀⁻¹) (Lee, Lee and Park, Automatica 131, 2021) under the limits of the robot and
    the clearances of its cell, with ramps from rest to rest.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot.
        limits: Limits file, or limits; None: the URDF's.
        margin: Share of velocity, acceleration, jerk and torque limits to keep free [1].
        cell: Surroundings; by default the floor and the robot itself, by the URDF's collision
            shapes.
        options: Criterion, noise, boxes and search; single fields may be given by keyword, e.g.
            `starts=4`.
        period: Period of the Fourier series [s]; None: from the limits.
        harmonics: Number of harmonics; None: 5, or chosen for `time`.
        samples: Samples of the optimiser over one period; None: 20 per harmonic.
        periods: Repeats of the period; None: 2, or as many as fit into `time`.
        time: Robot time with ramps [s], for which the four options above are chosen; None: 15 of a
            motion for a payload whose period and repeats are not stated.
        start: Pose at which the motion begins and ends at rest. Shape (n,) [rad or m].
        given: Trajectory or recording, or several, whose information is already available.
        trajectory: The `trajectory.json` that was executed in recordings of `given`, or several:
            each recording takes its period and window from the one that it holds.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in the CSV files
            of `given` and `for_task`.
        for_task: Motion of a task, a recording or a `trajectory.json`, along which the identified
            model is to predict the torque with the least variance (V-optimality); replaces the
            criterion.
        discriminate: A `diagnosis.json`, between whose competing explanations the recording is to
            decide: the smallest separation is maximised; replaces the criterion.
        validate: Also design a second, different motion.
        starts: Number of random starts; None: that of `options`, with `discriminate` at least 4.
        speed: Share of the speed at which the motion is played.
        threshold: Largest scale-free variance of an identifiable direction.
        force: Return a motion even if its certificate fails.
        progress: Called with each line of progress; None: the logger "excite" at level INFO.
        notes: Further entries of the file's `design`.
        **search: Fields of `DesignOptions`, e.g. criterion, seed, jobs, iterations,
            uncertainty, rate.

    Raises:
        UnusableInput: An argument or a file cannot be used.
        Infeasible: No motion satisfies all limits.
        CheckFailed: The certificate fails and `force` is not set.
    """
    given = _require_recordings(given, for_task, trajectory, columns)
    loaded = load_robot(robot)
    table = resolve_limits(loaded, limits, margin)
    request = time_budget.MotionRequest(period, harmonics, samples, periods)
    if starts is None:
        starts = options.starts if discriminate is None else max(options.starts, SEPARATION_STARTS)
    chosen = request.complete(replace(options, starts=starts, **search), table)
    _require_consistent(loaded, chosen, period, for_task, discriminate)
    file_format.check_options(speed, None)
    if not (np.isfinite(threshold) and threshold > 0.0):
        raise UnusableInput(f"--threshold {threshold:g} should be a positive number")
    is_timed = any(value is not None for value in (time, period, periods, chosen.free_period))
    if chosen.payload_link is not None and not is_timed:
        time = PAYLOAD_SECONDS
    pose = None if start is None else np.asarray(start, float)
    recorded = [motion_samples(Path(path), loaded, trajectory, columns)[:2] for path in given]
    questions = None
    if discriminate is not None:
        questions = read_questions(Path(discriminate), loaded, table, chosen).with_given(recorded)
        count = 2 * chosen.samples if samples is None else chosen.samples
        noise = questions.noise if chosen.noise is None else chosen.noise
        chosen = replace(chosen, criterion=Criterion.D, samples=count, noise=noise)
    earlier = _information(recorded, loaded, table, chosen)
    information = None if earlier is None else earlier.T @ earlier
    task = None if for_task is None else read_task(Path(for_task), loaded, table, chosen, columns)
    if task is not None:
        weak = task_variance.prior_information(task.parameters)
        information = weak if information is None else information + weak
    facts = {
        **(notes or {}),
        **({} if task is None else {"for": task.source}),
        **({} if questions is None else {"discriminate": questions.source}),
        "given": [str(path) for path in given],
        "chosen": request.unspecified,
    }
    if questions is not None and questions.noise is not None and chosen.noise is questions.noise:
        facts["torque_noise_source"] = f"from {questions.source}"
    if chosen.noise is None:
        facts["torque_noise_source"] = "1 % of each torque limit (default)"
    workcell, unchecked = cell.cell(loaded, table)
    plan = None
    if time is not None:
        clearance = None if workcell is None else clearance_builder.build_constraint(workcell)
        plan = time_budget.plan_for_budget(
            loaded,
            table,
            chosen,
            request,
            time,
            start=pose,
            earlier_information=information,
            clearance=clearance,
            speed=speed,
        )
        facts["plan"] = plan.reproducible_document()
    run = partial(
        pipeline.design_trajectory,
        loaded,
        table,
        start=pose,
        notes=facts,
        force=force,
        speed=speed,
        progress=progress or logger.info,
        cell=workcell,
        unchecked_reason=unchecked,
    )

    with_objective: optimize.ObjectiveBuilder | None = None
    if task is not None:
        with_objective = task.with_objective
    elif questions is not None:
        with_objective = questions.explanations.with_objective

    def deliver(overlap: OverlapPenalty | None = None) -> pipeline.CertifiedDesign:
        # the validation motion has to excite all directions, identified before or not
        search_once = partial(
            run,
            overlap_penalty=overlap,
            earlier_information=information if overlap is None else None,
            objective=with_objective if overlap is None else None,
        )
        return (
            search_once(chosen) if plan is None else time_budget.run_plan(plan, chosen, search_once)
        )

    delivery = deliver()
    second = validation.design_validation(delivery, loaded, deliver) if validate else None
    return DesignResult(
        delivery,
        loaded,
        _analyse(delivery, loaded, threshold, earlier),
        second,
        workcell,
        plan,
        earlier,
        task,
        questions,
        inputs=argument_files(
            loaded.source,
            *(limits, cell.scene, cell.srdf, for_task, discriminate, trajectory),
            recordings=given,
        ),
    )


def _require_consistent(
    robot: Robot,
    options: DesignOptions,
    period: float | None,
    for_task: str | Path | None,
    discriminate: str | Path | None,
) -> None:
    """Raise UnusableInput for options that contradict each other, or name no frame of the robot."""
    for box in options.boxes:
        robot.frame(box.frame)
    if period is not None and options.free_period is not None:
        raise UnusableInput(
            "--period and --optimise-period both choose the period; drop one of them"
        )
    if for_task is not None and discriminate is not None:
        raise UnusableInput("--for and --discriminate are two criteria; choose one")
    if options.payload_link is None:
        return
    if for_task is not None or discriminate is not None:
        name = "--for" if discriminate is None else "--discriminate"
        raise UnusableInput(f"{name} and --for-payload are two criteria; choose one")
    robot.carrying_body(options.payload_link, "--for-payload")


def _require_recordings(
    stated: Paths,
    for_task: str | Path | None,
    trajectory: TrajectorySources,
    columns: Mapping[str, str],
) -> tuple[str | Path, ...]:
    """Return the stated motions.

    Raises:
        UnusableInput: There are options of recordings without a recording that they apply to.
    """
    given = one_or_several(stated)
    recorded = any(is_recording(path) for path in given)
    if trajectory and not recorded:
        raise UnusableInput(
            "--trajectory: is for a recording of --given; add --given RECORDING or leave it out"
        )
    if columns and not recorded and (for_task is None or not is_recording(for_task)):
        raise UnusableInput(
            "--columns: is for a recording of --given or --for; add one or leave it out"
        )
    return given


def motion_files(trajectory: Trajectory, robot: Robot, standard: Parameters) -> dict[str, str]:
    """Return the texts of `trajectory.json` and `trajectory.csv` by their names."""
    torque = nominal_torque(robot, standard)
    job = file_format.ExportJob(
        trajectory, trajectory.motion, "csv", Path("trajectory.csv"), 1.0, None, torque
    )
    return {
        "trajectory.json": _json.dumps(trajectory.document()),
        "trajectory.csv": csv_json.render_csv(job).text,
    }


def nominal_torque(robot: Robot, standard: Parameters) -> Callable[[Samples], FloatArray]:
    """Return the function from samples to nominal torque. Shape (N, n) [N m]."""
    return lambda samples: dynamics.torque(robot, standard, samples)


def compare_experiments(
    robot: Robot,
    standard: Parameters,
    base: Any,
    trajectory: Trajectory,
    threshold: float,
    given: FloatArray | None = None,
) -> tuple[experiment_comparison.Scenario, ...]:
    """Predict the gain of information by twice the time and by twice the speed.

    Args:
        robot: The robot.
        standard: Its standard parameters.
        base: Its base parameters.
        trajectory: The trajectory.
        threshold: Largest scale-free variance of an identifiable direction [1].
        given: Root of the information of earlier recordings. Shape (m, P).
    """
    return experiment_comparison.compare_scenarios(
        robot,
        standard,
        base,
        trajectory.limits,
        trajectory.motion,
        noise=trajectory.noise,
        rate=trajectory.rate,
        threshold=threshold,
        earlier_root=given,
    )


def motion_samples(
    path: Path,
    robot: Robot,
    executed: TrajectorySources = (),
    columns: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Samples, Robot, Trajectory | None]:
    """Read the samples of a trajectory, or of a recording, at REFERENCE_RATE.

    Of a recording with a periodic window, only the samples within the window are used. The window
    is that of an executed trajectory, of the sidecar, or of a period found in the recording.

    Args:
        path: A `trajectory.json`, or a recording.
        robot: The robot.
        executed: Trajectory files, one of which was executed during the recording.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file.

    Returns:
        The samples, the robot whose dynamics their torque contains, and the trajectory; None for a
        recording.

    Raises:
        UnusableInput: The file cannot be used, or moves other joints.
    """
    if is_recording(path):
        recording = with_detected_period(
            with_trajectory(recordings.read(path, robot, columns=columns), executed)
        )
        return reference_samples(recording), robot_of_torque(robot, [recording]), None
    samples, trajectory = trajectory_samples(path, robot)
    return samples, robot, trajectory


def _information(
    recorded: Sequence[tuple[Samples, Robot]], robot: Robot, limits: Limits, options: DesignOptions
) -> FloatArray | None:
    """Return a root of the information of earlier recordings in standard parameters.

    Args:
        recorded: Samples of each recording, and the robot whose dynamics its torque contains.
        robot: The robot.
        limits: Its limits.
        options: Options of the design.

    Returns:
        R with information matrix RᵀR, shape (m, P); None without recordings.
    """
    if not recorded:
        return None
    standard = inertial_parameters.standard_parameters(robot, limits, options.drive)
    noise = torque_noise_levels(limits, options.noise)
    roots = [
        identifiability.information_root(measured, standard, samples, noise)
        for samples, measured in recorded
    ]
    return np.vstack(roots)


def _analyse(
    delivery: pipeline.CertifiedDesign, robot: Robot, threshold: float, earlier: FloatArray | None
) -> identifiability.Identifiability:
    trajectory, setting = delivery.trajectory, delivery.design.setup
    standard = setting.problem.parameters
    root = _motion_root(delivery, robot)
    known = root if earlier is None else np.vstack([root, earlier])
    return identifiability.analyse_root(
        standard,
        setting.base,
        known,
        trajectory.noise,
        robot,
        threshold=threshold,
        samples=len(trajectory.motion.grid(identification_result.REFERENCE_RATE)),
    )


def _motion_root(delivery: pipeline.CertifiedDesign, robot: Robot) -> FloatArray:
    """Return a root of the information of a complete motion. Shape (m, P)."""
    trajectory = delivery.trajectory
    samples = trajectory.motion.samples(
        trajectory.motion.grid(identification_result.REFERENCE_RATE)
    )
    standard = delivery.design.setup.problem.parameters
    return identifiability.information_root(robot, standard, samples, trajectory.noise)


__all__ = ["CellOptions", "DesignResult", "WorkspaceBox", "design"]
