"""Design of motions in single or double support: a sequence from rest to rest, certified.

The information of each motion is added to that of the earlier ones, so that the next motion excites
the directions that are still uncertain. Before the first motion there is a prior: every parameter
direction is known to a share of its nominal value in the metric.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field

import numpy as np

from .._system.one_or_several import one_or_several
from .._system.progress import Progress
from .._types import FloatArray
from ..collision import clearance_builder, continuous_check
from ..collision.clearance_constraint import ClearanceConstraint
from ..collision.workcell import NOT_CHECKED, Cell
from ..errors import CheckFailed, Infeasible, UnusableInput
from ..robot import floating_base
from ..robot.base_parameters import Base
from ..robot.floating_base import FloatingRobot, Rows
from ..robot.inertial_parameters import DRIVE, Parameters
from ..robot.limits import Limits
from ..trajectory.rest_to_rest import PhaseProfile
from . import floating_identifiability, sqp, support_cell, support_certificate
from .certificate import CLEARANCE, Certificate
from .criteria import Criterion
from .evaluator import without_friction
from .floating_identifiability import RowNoise
from .identifiability import Identifiability, identifiable_count
from .identifiability_threshold import IDENTIFIABLE_VARIANCE
from .options import DesignOptions, samples_per_period
from .support_cell import Surroundings
from .support_certificate import CONTACT_LIMITS, JOINT_LIMITS, SupportConstraints
from .support_evaluator import SupportEvaluator
from .support_kinematics import exported_motion
from .support_model import support_functions
from .support_problem import (
    SupportProblem,
    motion_duration,
    series_period,
    variable_scale,
)
from .support_stance import ContactLimits, SoleSize, Stance, standing, without_singularities

FIRST_RESERVES = (0.03, 0.06)
"""Shares of the joint limits, and of the weight in contact limits, that the optimiser keeps free
for what happens between its samples [1]. Motions of Talos exceed limits there by 3 and 5 %."""

MAX_TIGHTENINGS = 8
"""Times that these shares are raised, or pairs of bodies added, until the certificate holds [1]."""

LEAST_RAISE = 1.4
"""Least factor by which a share is raised [1]."""

START_AMPLITUDE = 0.5
"""Standard deviation of the variables of a random start [1]."""

SHRINKAGE = 0.9
"""Factor on the variables of a motion that exceeds a limit [1]."""

MAX_SHRINKAGES = 130
"""Times that a motion is shrunk, to 1e-6 of its amplitude [1]."""

START_MAX_VALUE = 0.98
"""Largest constraint value of a start [1]."""

SAMPLES_PER_OSCILLATION = 30
"""Samples of the optimiser over a period of the highest harmonic [1]: forces have twice its
frequency and more."""

REPAIR_ITERATIONS = 15
"""Iterations after the limits are tightened [1]."""

MAX_RESERVE = 0.3
"""Largest share that is kept free [1]."""

MAX_CLEARANCE_RAISE = 0.01
"""Largest missing distance for which a clearance is raised at once [m]: bodies that pass through
each other between samples miss more than a wider clearance could prevent."""

CLEARANCE_SCALE_RATIO = 4.0
"""Scale of a clearance constraint over the clearance [1]. The working set of the optimiser takes up
pairs within a quarter of the scale, 20 mm: with the 100 mm of arms, the hundred pairs of a humanoid
would fill it (two thirds of the time of Talos)."""

MAX_COLLISION_ROUNDS = 6
"""Times that a motion is optimised again with the pairs of bodies that it brings too near [1]."""

VIOLATION_FACTOR = 1.2
"""Increase of the share that is kept free, over the violation that the certificate found [1]."""


@dataclass(frozen=True)
class SupportOptions:
    """Options of a design in support.

    Attributes:
        frames: Contact frame of each foot on the ground.
        soles: Sole of each foot.
        contact: Limits of the contact.
        count: Number of motions.
        duration: Duration of each motion [s].
        harmonics: Number of harmonics of the Fourier series.
        criterion: A or D, of the base rows.
        wrench_noise: Standard deviation of forces [N] and moments [N m] of the base rows; None: as
            `floating_identifiability.assumed_noise`.
        torque_noise: Standard deviation of the joint torques [N m]; None: likewise.
        prior_deviation: Standard deviation of every direction before the first motion, in the
            metric [1].
        rate: Rows per second of the exported motion [Hz].
        starts: Random starts of each motion, of which the best is optimised.
        iterations: Iterations for each motion.
        seed: Seed of the random starts.
    """

    frames: tuple[str, ...]
    soles: tuple[SoleSize, ...]
    contact: ContactLimits = field(default_factory=ContactLimits)
    count: int = 1
    duration: float = 3.0
    harmonics: int = 5
    criterion: Criterion = Criterion.A
    wrench_noise: tuple[float, float] | None = None
    torque_noise: tuple[float, ...] | None = None
    prior_deviation: float = IDENTIFIABLE_VARIANCE**0.5
    rate: float = 100.0
    starts: int = 8
    iterations: int = 120
    seed: int = 0

    def __post_init__(self) -> None:
        """Accept the name of a single foot."""
        object.__setattr__(self, "frames", one_or_several(self.frames))

    def design_options(self) -> DesignOptions:
        """Return the options of the search for one motion."""
        return DesignOptions(
            criterion=self.criterion,
            drive=DRIVE,
            harmonics=self.harmonics,
            period=series_period(self.duration),
            samples=SAMPLES_PER_OSCILLATION * self.harmonics + 1,
            rate=self.rate,
            uncertainty=0.0,
            starts=self.starts,
            seed=self.seed,
            iterations=self.iterations,
        )


@dataclass(frozen=True)
class SupportDesign:
    """Certified motions in support.

    Attributes:
        robot: The robot.
        limits: Limits of its joints.
        options: Options of the design.
        stance: The feet and the standing pose.
        parameters: Standard parameters with those of the joints.
        inertial: Standard parameters of the bodies alone.
        base: Base parameters of the base rows.
        noise: Noise of the rows.
        cell: Bodies that keep their distance; None: distances are not checked.
        motions: Motions of the independent coordinates.
        certificate: Certificate of all motions, played one after the other.
        roots: R with RᵀR the information of the base rows after each motion. Shape (r, P) each.
        root_of_all_rows: R of base and joint rows after the last motion, with the joint parameters.
        seconds: Wall-clock time of the design [s].
    """

    robot: FloatingRobot
    limits: Limits
    options: SupportOptions
    stance: Stance
    parameters: Parameters
    inertial: Parameters
    base: Base
    noise: RowNoise
    cell: Cell | None
    motions: tuple[PhaseProfile, ...]
    certificate: Certificate
    roots: tuple[FloatArray, ...]
    root_of_all_rows: FloatArray
    seconds: float

    @property
    def duration(self) -> float:
        """Duration of all motions [s]."""
        return len(self.motions) * motion_duration(self.motions[0].fourier.period)

    @property
    def samples_per_motion(self) -> int:
        """Number of rows of a motion as exported."""
        return round(self.duration / len(self.motions) * self.options.rate)

    def identifiable_counts(self, threshold: float = IDENTIFIABLE_VARIANCE) -> list[int]:
        """Return the number of identifiable directions of the base rows after each motion."""
        return [identifiable_count(root, self.base, threshold) for root in self.roots]

    def analysis(self, rows: Rows, threshold: float = IDENTIFIABLE_VARIANCE) -> Identifiability:
        """Return the identifiability by all motions.

        Args:
            rows: Base rows, for the inertial parameters; or both, with those of the joints.
            threshold: Largest variance of an identifiable direction [1].
        """
        is_base = rows is Rows.BASE
        parameters = self.inertial if is_base else self.parameters
        base = (
            self.base
            if is_base
            else floating_base.find_base_parameters(self.robot, parameters, Rows.BOTH)
        )
        return floating_identifiability.analyse(
            self.robot,
            parameters,
            base,
            self.roots[-1] if is_base else self.root_of_all_rows,
            self.noise,
            rows,
            threshold=threshold,
            samples=len(self.motions) * self.samples_per_motion,
        )


def design_support(
    robot: FloatingRobot,
    limits: Limits,
    options: SupportOptions,
    progress: Progress | None = None,
    surroundings: Surroundings | None = Surroundings(),  # noqa: B008  # immutable
) -> SupportDesign:
    """Design and certify motions in single or double support.

    Args:
        robot: The robot.
        limits: Limits of its joints.
        options: Options of the design.
        progress: Called with a line of text after each motion.
        surroundings: What the bodies of the robot keep clear of; None: distances are not checked.

    Raises:
        CheckFailed: A motion cannot be certified.
        Infeasible: The robot cannot stand within its limits.
        UnusableInput: Options are inconsistent, or bodies touch in the standing pose.
    """
    began = time.perf_counter()
    report = progress or (lambda text: None)
    _check_options(options)
    if limits.stand is not None:
        raise UnusableInput(
            f"{limits.stand.source}: [stand] limits the load of a clamped base, but --floating "
            "--support stands on its feet; remove the table, or design without --floating"
        )
    usable = limits.reduced()
    stance = standing(robot.joint_robot, usable, options.frames, options.soles, options.contact)
    cell, reason = (
        (None, f"{NOT_CHECKED} (--no-collision)")
        if surroundings is None
        else support_cell.find_cell(robot, limits, stance, surroundings)
    )
    search = SupportSearch(robot, limits, options, stance, cell, reason or NOT_CHECKED)
    motions: list[PhaseProfile] = []
    certificates: list[Certificate] = []
    roots: list[FloatArray] = []
    report(
        f"{robot.name}: {robot.n} joints, {search.base.count} base parameters of the base rows, "
        f"{len(stance.feet)} feet on the ground"
    )
    for number in range(options.count):
        motion, certificate = search.next_motion(number)
        motions.append(motion)
        certificates.append(certificate)
        roots.append(search.root)
        known = identifiable_count(search.root, search.base)
        report(
            f"motion {number + 1} of {options.count}: {known} of {search.base.count} directions "
            "identifiable"
        )
    certificate = support_certificate.joined(search.constraints, certificates)
    return SupportDesign(
        robot,
        limits,
        options,
        stance,
        search.parameters,
        search.inertial,
        search.base,
        search.noise,
        cell,
        tuple(motions),
        certificate,
        tuple(roots),
        search.root_of_all_rows(motions),
        time.perf_counter() - began,
    )


def _check_options(options: SupportOptions) -> None:
    """Check that options are in range.

    Raises:
        UnusableInput: One is not.
    """
    if options.criterion not in (Criterion.A, Criterion.D):
        raise UnusableInput("--criterion: a design with --support has a or d")
    if options.count < 1:
        raise UnusableInput("--motions should be at least 1")
    samples_per_period(options.duration, options.rate)
    contact = options.contact
    if not (contact.friction > 0.0 and contact.margin >= 0.0):
        raise UnusableInput("--friction should be positive and --cop-margin 0 or more")


class SupportSearch:
    """Search for the motions of a sequence.

    Attributes:
        parameters: Standard parameters with those of the joints.
        base: Base parameters of the base rows.
        noise: Noise of the rows.
        root: R with RᵀR the information of the motions so far. Shape (r, P).
    """

    def __init__(
        self,
        robot: FloatingRobot,
        limits: Limits,
        options: SupportOptions,
        stance: Stance,
        cell: Cell | None = None,
        unchecked_reason: str = NOT_CHECKED,
    ) -> None:
        """Build the dynamics and count the base parameters."""
        self.robot, self.limits, self.options, self.stance = robot, limits, options, stance
        self.parameters = floating_base.standard_parameters(robot, limits, DRIVE)
        self.inertial = floating_base.standard_parameters(robot, limits)
        self.base = floating_base.find_base_parameters(robot, self.inertial, Rows.BASE)
        self.noise = floating_identifiability.assumed_noise(
            robot, limits, options.wrench_noise, options.torque_noise
        )
        self.root = np.zeros((0, self.inertial.count))
        self.prior = np.eye(self.base.count) / options.prior_deviation**2
        torque = without_friction(limits.reduced().torque, self.parameters)
        self._functions = support_functions(robot.joint_robot, self.parameters, stance, torque)
        self.constraints = SupportConstraints(
            robot, limits, stance, self.parameters, cell, unchecked_reason
        )
        self._clearance = _LazyClearance(cell)
        self._search_limits = without_singularities(robot.joint_robot, limits.reduced(), stance)

    @property
    def information(self) -> FloatArray:
        """Information of the motions so far, in the metric. Shape (p, p)."""
        rows = self.root @ self.base.geometric
        return np.asarray(rows.T @ rows)

    def problem(self, joint_reserve: float, contact_reserve: float) -> SupportProblem:
        """Return the problem of the next motion, which keeps shares of its limits free."""
        options = self.options.design_options()
        places = np.concatenate(
            [np.arange(10 * (i - 1), 10 * i) for i in self.robot.bodies]
        )  # bodies without mass have no parameters
        columns = np.zeros((10 * (self.robot.n + 1), self.base.count))
        columns[places] = self.base.geometric
        return SupportProblem(
            self.robot.joint_robot,
            _shrunk(self._search_limits, joint_reserve),
            self.stance,
            self._functions,
            columns,
            self.noise.of(Rows.BASE),
            self.information + self.prior,
            options,
            variable_scale(self.robot.joint_robot, self.limits, self.stance, options),
            joint_reserve,
            contact_reserve,
            self._clearance.constraint(),
        )

    def next_motion(self, number: int) -> tuple[PhaseProfile, Certificate]:
        """Find the next certified motion with its certificate, and add its information.

        Args:
            number: Number of the motion, from 0.

        Raises:
            CheckFailed: No motion is certified.
        """
        reserves, reason = list(FIRST_RESERVES), ""
        x = self._apart(reserves, number)
        for tightening in range(MAX_TIGHTENINGS + 1):
            problem = self.problem(*reserves)
            if tightening:
                x = self._repaired(SupportEvaluator(problem), x)
            motion = problem.motion(x)
            certificate = support_certificate.certify_motion(self.constraints, motion, number)
            if certificate.ok:
                self.root = self._with_motion(self.root, motion, self.inertial, Rows.BASE)
                return motion, certificate
            reason = certificate.failure_reason()
            reserves = _raised(reserves, certificate)
            self._clearance.tighten(certificate)
        remedy = (
            "lower --clearance or clear the scene"
            if certificate.worst().limit == CLEARANCE
            else "lengthen --duration or widen that limit"
        )
        raise CheckFailed(
            f"{self.robot.source}: no motion keeps all limits between its samples: {reason}; "
            f"{remedy}"
        )

    def _apart(self, reserves: list[float], number: int) -> FloatArray:
        """Return the variables of an optimised motion whose bodies keep apart at the samples.

        Args:
            reserves: Shares of joint limits and contact limits that are kept free.
            number: Number of the motion.
        """
        evaluator = SupportEvaluator(self.problem(*reserves))
        state = self._optimised(evaluator, sqp.initial_state(self._start(evaluator, number)))
        for _ in range(MAX_COLLISION_ROUNDS):
            if not self._clearance.add_near_pairs(evaluator.clearance_poses(state.best)):
                break
            evaluator = SupportEvaluator(self.problem(*reserves))
            state = self._optimised(evaluator, sqp.initial_state(_shrink(evaluator, state.best)))
        return state.best

    def _repaired(self, evaluator: SupportEvaluator, x: FloatArray) -> FloatArray:
        """Return variables near those of a slightly infeasible motion that keep all limits.

        Short steps weigh the constraints heavily; where they do not suffice, the motion is shrunk
        and optimised again.
        """
        state = sqp.SearchState(x, x, radius=sqp.RETURN_RADIUS, penalty=sqp.RETURN_PENALTY)
        state = self._optimised(evaluator, state, REPAIR_ITERATIONS)
        if not np.isfinite(state.best_value):
            state = self._optimised(evaluator, sqp.initial_state(_shrink(evaluator, x)))
        return state.best

    def _optimised(
        self,
        evaluator: SupportEvaluator,
        state: sqp.SearchState,
        iterations: int | None = None,
    ) -> sqp.SearchState:
        """Return the state after some iterations of the search, None for all."""
        return sqp.advance(evaluator, state, sqp.History(), iterations)

    def _start(self, evaluator: SupportEvaluator, number: int) -> FloatArray:
        """Return the best of some random feasible motions.

        Raises:
            Infeasible: The standing pose does not keep the limits.
        """
        best, least = np.zeros(evaluator.problem.size), np.inf
        if evaluator.max_constraint_value(best) > START_MAX_VALUE:
            raise Infeasible(
                f"{self.robot.source}: the standing pose does not keep "
                f"{evaluator.worst_constraint(best)}; widen that limit"
            )
        for start in range(self.options.starts):
            rng = np.random.default_rng([self.options.seed, number, start])
            x = _shrink(evaluator, START_AMPLITUDE * rng.normal(size=evaluator.problem.size))
            value = evaluator.objective(x, 1.0)[0]
            if value < least:
                best, least = x, value
        return best

    def _with_motion(
        self, root: FloatArray, motion: PhaseProfile, parameters: Parameters, rows: Rows
    ) -> FloatArray:
        """Return a root of information to which that of a motion as exported is added."""
        exported = exported_motion(
            self.robot, self.stance, self.parameters, motion, self.options.rate
        )
        return floating_identifiability.added_root(
            root, self.robot, parameters, exported, self.noise, rows
        )

    def root_of_all_rows(self, motions: list[PhaseProfile]) -> FloatArray:
        """Return a root of the information of base and joint rows of all motions."""
        root = np.zeros((0, self.parameters.count))
        for motion in motions:
            root = self._with_motion(root, motion, self.parameters, Rows.BOTH)
        return root


def _raised(reserves: list[float], certificate: Certificate) -> list[float]:
    """Return larger shares of joint limits and contact limits to keep free, where one fails."""
    out = list(reserves)
    for kind, limits in enumerate((JOINT_LIMITS, CONTACT_LIMITS)):
        spare = min(m.spare_share for m in certificate.margins if m.limit in limits)
        if spare < 0.0:
            out[kind] = min(
                max(LEAST_RAISE * reserves[kind], reserves[kind] - VIOLATION_FACTOR * spare),
                MAX_RESERVE,
            )
    return out


class _LazyClearance:
    """Clearance constraint whose pairs of bodies enter once a motion brings them too near.

    Of the hundreds of pairs of a humanoid few come near each other in a motion. Covers of capsules,
    which are cheap enough for all of them, leave hardly any room near the standing pose.
    """

    def __init__(self, cell: Cell | None) -> None:
        """Begin without pairs.

        Args:
            cell: The cell; None: there is no constraint.
        """
        self._cell = cell
        self._extra: dict[str, float] = {}

    def constraint(self) -> ClearanceConstraint | None:
        """Return the constraint of the pairs that are active; None without one."""
        if self._cell is None or not self._extra:
            return None
        pairs = [pair for pair in self._cell.pairs if self._cell.names(pair) in self._extra]
        built = clearance_builder.build_hull_constraint(self._cell, pairs)
        return dataclasses.replace(
            built,
            extra=np.array([self._extra[name] for name in built.names]),
            scale_ratio=CLEARANCE_SCALE_RATIO,
        )

    def add_near_pairs(self, poses: FloatArray) -> bool:
        """Activate the pairs that are too near in some poses; return whether there are new ones.

        Args:
            poses: Poses (b, q). Shape (N, 6 + n).
        """
        if self._cell is None:
            return False
        names = {
            self._cell.names(self._cell.pairs[i])
            for i in continuous_check.find_near_pairs(self._cell, poses)
        }
        new = names - self._extra.keys()
        self._extra |= dict.fromkeys(sorted(new), 0.0)
        return bool(new)

    def tighten(self, certificate: Certificate) -> None:
        """Activate the pairs that violate their clearance, and widen those that were active."""
        for pair, deficit in certificate.clearance_deficits().items():
            raised = VIOLATION_FACTOR * min(deficit, MAX_CLEARANCE_RAISE)
            self._extra[pair] = self._extra[pair] + raised if pair in self._extra else 0.0


def _shrink(evaluator: SupportEvaluator, x: FloatArray) -> FloatArray:
    """Scale a motion down until it keeps all limits."""
    for _ in range(MAX_SHRINKAGES):
        if evaluator.max_constraint_value(x) <= START_MAX_VALUE:
            break
        x = SHRINKAGE * x
    return x


def _shrunk(limits: Limits, reserve: float) -> Limits:
    """Return limits of which a share is kept free, position ranges included, but torque."""
    lower, upper = limits.position.T
    half = np.where(np.isfinite(upper - lower), 0.5 * (upper - lower), 0.0)
    position = np.column_stack([lower + reserve * half, upper - reserve * half])
    factor = 1.0 - reserve
    scaled = limits.scaled(velocity=factor, acceleration=factor)
    return dataclasses.replace(scaled, position=position)
