"""Design of static poses for a payload: few poses at rest, each reached from both sides.

At rest, a payload adds A(q) (m, m c) to the torques: poses show mass and centre of mass, not the
inertia. The poses are D-optimal, max log det Σ_k (A_k − Ā)ᵀ V⁻¹ (A_k − Ā), the mean Ā taken off as
the offsets of the torques may differ between the recordings with and without payload; they are
found by exchanging poses with candidates (Fedorov, "Theory of Optimal Experiments", 1972). Every
joint arrives at every pose once from above and once from below, so that Coulomb friction at rest,
which has the direction of the arrival, differs in sign between both rests and not between poses.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace

import numpy as np

from .._system.progress import Progress
from .._types import BoolArray, FloatArray, IntArray
from ..collision import clearance_builder
from ..collision.workcell import NOT_CHECKED, Cell
from ..errors import CheckFailed, Infeasible
from ..robot import dynamics, inertial_parameters
from ..robot.inertial_parameters import Parameters, frame_map, spread_poses
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..robot.samples import Samples
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import JerkProfile, Motion, SegmentKind
from ..trajectory.trajectory_file import Trajectory
from . import constraint_margins, ramps
from .certificate import Certificate, certified_trajectory
from .constraint_margins import MotionConstraints
from .criteria import Criterion
from .options import DesignOptions, torque_noise_levels
from .payload_weighting import LINK_PARAMETERS, predicted_text
from .ramps import EXTRA_CLEARANCE, Part, RampPlanner, with_derived_limits

GRAVITY_PARAMETERS = 4
"""Parameters of a body that the torque at rest depends on: mass and first moments."""
CANDIDATES = 1500
"""Poses that fill the joint ranges, from which the first poses are chosen."""
REFINEMENTS = 3
"""Times that the poses are exchanged with poses in their neighbourhood."""
NEIGHBOURS = 60
"""Candidates in the neighbourhood of each pose."""
NEIGHBOURHOOD = 0.15
"""Standard deviation of the first neighbourhood over the joint range, halved each time."""
EXCHANGE_ROUNDS = 20
"""Largest number of rounds over all poses of an exchange."""
REACH = 0.1
"""Distance from which every joint arrives at a pose [rad], larger than presliding distances."""
PRISMATIC_REACH = 0.02
"""The same of a prismatic joint [m]."""
REST_PERIOD = 0.5
"""Half of the time at rest after each arrival [s]."""
SETTLING_TIME = 0.25
"""Time after an arrival in which torques settle and are not used [s]."""
INDEPENDENT_ROWS = 100.0
"""Rows per second whose torque noise is independent [Hz], as of a design of a motion."""
MAX_REPLACEMENTS = 40
"""Number of poses that are given up because no way leads to them, at most."""


@dataclass(frozen=True)
class StaticDeviation:
    """Predicted standard deviations of a payload by poses at rest, in the frame of its link.

    Attributes:
        mass: Of the mass [kg].
        centre: Of the centre of mass of a payload of 1 kg. Shape (3,) [m].
        friction: Coulomb friction that the prediction assumes. Shape (n,) [N m or N].
    """

    mass: float
    centre: FloatArray
    friction: FloatArray

    @property
    def text(self) -> str:
        """One line for people."""
        return (
            f"{predicted_text(self.mass, self.centre)}, with any friction at rest up to Coulomb "
            "friction; moments of inertia are not shown by static poses"
        )

    def document(self) -> dict[str, object]:
        """Content for JSON."""
        return {
            "mass": self.mass,
            "centre_of_1_kg": self.centre.tolist(),
            "inertia": None,
            "not_shown": ["ixx", "ixy", "iyy", "ixz", "iyz", "izz"],
            "assumed_friction": self.friction.tolist(),
        }


@dataclass(frozen=True)
class StaticDesign:
    """Static poses with the certified motion that visits them.

    Attributes:
        trajectory: Content of the trajectory file.
        certificate: Its certificate.
        parameters: Standard parameters of the robot.
        link: Link that carries the payload.
        poses: Poses in their order. Shape (P, n) [rad or m].
        deviation: Predicted standard deviations.
        efficiency: D-efficiency over the same number of random poses: ratio of the fourth roots of
            the determinants, the median of the random ones [1].
    """

    trajectory: Trajectory
    certificate: Certificate
    parameters: Parameters
    link: str
    poses: FloatArray
    deviation: StaticDeviation
    efficiency: float


@dataclass(frozen=True)
class _PoseSet:
    """Feasible poses and what they show.

    Attributes:
        poses: Poses. Shape (N, n) [rad or m].
        rows: Torque per unit of mass and first moments over the standard deviation of a pose.
            Shape (N, n, 4).
    """

    poses: FloatArray
    rows: FloatArray

    def __len__(self) -> int:
        return len(self.poses)

    def without(self, index: int) -> _PoseSet:
        """Return the set without one pose."""
        return _PoseSet(np.delete(self.poses, index, axis=0), np.delete(self.rows, index, axis=0))

    def joined(self, other: _PoseSet) -> _PoseSet:
        """Return the poses of both sets."""
        return _PoseSet(
            np.concatenate([self.poses, other.poses]), np.concatenate([self.rows, other.rows])
        )


class _StaticProblem:
    """Feasibility and information of poses at rest.

    Attributes:
        constraints: Constraints on the motion between the poses.
        parameters: Standard parameters.
        link: Link that carries the payload.
        reach: Distance from which each joint arrives. Shape (n,) [rad or m].
        friction: Assumed Coulomb friction. Shape (n,) [N m or N].
        variance: Variance of the torque of a pose, without payload subtracted. Shape (n,).
    """

    def __init__(
        self, constraints: MotionConstraints, parameters: Parameters, noise: FloatArray, link: str
    ) -> None:
        """Compute what all poses have in common."""
        robot = constraints.robot
        self.constraints, self.parameters, self.link = constraints, parameters, link
        self.reach = np.array(
            [PRISMATIC_REACH if e.kind == "prismatic" else REACH for e in robot.entries]
        )
        scale = np.diag(parameters.scale[parameters.block("coulomb"), parameters.block("coulomb")])
        nominal = parameters.coulomb()
        self.friction = np.where(nominal > 0.0, nominal, scale)
        rows = INDEPENDENT_ROWS * (2.0 * REST_PERIOD - SETTLING_TIME)
        # any friction within ±F_c, evenly: its variance is F_c²/3; two rests in each of both
        # recordings
        self.variance = noise**2 / rows + self.friction**2 / 3.0
        body, self._placement = robot.carrying_body(link, "--for-payload")
        start = LINK_PARAMETERS * body
        self._columns = slice(start, start + GRAVITY_PARAMETERS)

    def feasible(self, poses: FloatArray) -> _PoseSet:
        """Return those poses that keep all limits and clearances at rest and around them."""
        limits = self.constraints.limits
        low, high = limits.position.T
        inside = ((poses - self.reach >= low) & (poses + self.reach <= high)).all(axis=1)
        poses = poses[inside]
        poses = poses[self._is_held(poses)]
        clearance = self.constraints.clearance
        if clearance is not None and len(poses):
            around = (poses, poses + self.reach, poses - self.reach)
            excess = np.min([clearance.least_excess(part)[0] for part in around], axis=0)
            poses = poses[excess >= EXTRA_CLEARANCE]
        return _PoseSet(poses, self._rows(poses))

    def _is_held(self, poses: FloatArray) -> BoolArray:
        """Return which poses keep torque limits and boxes at rest. Shape (N,)."""
        if not len(poses):
            return np.zeros(0, bool)
        still, blocks = np.repeat(poses, 3, axis=0), np.repeat(np.arange(len(poses)), 3)
        zero = np.zeros_like(still)
        kept = np.ones(len(still), bool)
        quantities = constraint_margins.model_quantities(
            self.constraints, Samples(still, zero, zero), blocks
        )
        for quantity in quantities:
            kept &= ((quantity.low >= quantity.lower) & (quantity.high <= quantity.upper)).all(1)
        return np.asarray(kept.reshape(-1, 3).all(axis=1))

    def _rows(self, poses: FloatArray) -> FloatArray:
        """Torque per unit of mass and first moments at the joint, whitened. Shape (N, n, 4)."""
        zero = np.zeros_like(poses)
        Y = dynamics.regressor(self.constraints.robot, self.parameters, Samples(poses, zero, zero))
        return np.asarray(Y[:, :, self._columns] / np.sqrt(self.variance)[:, None])

    def deviation(self, chosen: _PoseSet) -> StaticDeviation:
        """Predict the standard deviations of a payload by chosen poses."""
        covariance = np.linalg.inv(_information(chosen.rows))
        gravity = slice(GRAVITY_PARAMETERS)
        change = frame_map(self._placement.inverse().homogeneous)[gravity, gravity]
        std = np.sqrt(np.diag(change @ covariance @ change.T))
        return StaticDeviation(float(std[0]), std[1:4], self.friction)


def _within_a_turn(limits: Limits, robot: Robot) -> Limits:
    """Narrow the ranges of revolute joints to one turn about their middle, as torques repeat."""
    low, high = inertial_parameters.ranges(limits).T
    turn = np.array([np.inf if e.kind == "prismatic" else np.pi for e in robot.entries])
    middle, half = 0.5 * (low + high), np.minimum(0.5 * (high - low), turn)
    return replace(limits, position=np.column_stack([middle - half, middle + half]))


def _information(rows: FloatArray) -> FloatArray:
    """Information on mass and first moments, offsets eliminated. Shape (P, n, 4) -> (4, 4)."""
    centred = (rows - rows.mean(axis=0)).reshape(-1, GRAVITY_PARAMETERS)
    return np.asarray(centred.T @ centred)


def _log_determinants(rows: FloatArray) -> FloatArray:
    """log det of the information of many sets of poses. Shape (N, P, n, 4) -> (N,)."""
    centred = rows - rows.mean(axis=1, keepdims=True)
    flat = centred.reshape(len(rows), -1, GRAVITY_PARAMETERS)
    sign, value = np.linalg.slogdet(np.einsum("nra,nrb->nab", flat, flat))
    return np.where(sign > 0.0, value, -np.inf)


def _exchanged(candidates: _PoseSet, chosen: IntArray) -> IntArray:
    """Exchange poses one by one with the candidate that raises the determinant most."""
    chosen = chosen.copy()
    for _ in range(EXCHANGE_ROUNDS):
        before = chosen.copy()
        for k in range(len(chosen)):
            sets = np.repeat(candidates.rows[chosen][None], len(candidates), axis=0)
            sets[:, k] = candidates.rows
            chosen[k] = int(np.argmax(_log_determinants(sets)))
        if (chosen == before).all():
            break
    return chosen


def _choose(
    problem: _StaticProblem, candidates: _PoseSet, count: int, rng: np.random.Generator
) -> _PoseSet:
    """Choose D-optimal poses among the candidates and their neighbourhoods."""
    chosen = _exchanged(candidates, rng.choice(len(candidates), count, replace=False))
    best = _PoseSet(candidates.poses[chosen], candidates.rows[chosen])
    span = np.ptp(inertial_parameters.ranges(problem.constraints.limits), axis=1)
    for level in range(REFINEMENTS):
        steps = rng.standard_normal((NEIGHBOURS, *best.poses.shape))
        near = best.poses + NEIGHBOURHOOD * 0.5**level * span * steps
        pool = best.joined(problem.feasible(near.reshape(-1, near.shape[2])))
        chosen = _exchanged(pool, np.arange(count))
        best = _PoseSet(pool.poses[chosen], pool.rows[chosen])
    return best


def _efficiency(candidates: _PoseSet, best: _PoseSet, rng: np.random.Generator) -> float:
    """Return the D-efficiency over random poses; see `StaticDesign`."""
    count = len(best)
    random = np.array([rng.choice(len(candidates), count, replace=False) for _ in range(101)])
    values = _log_determinants(candidates.rows[random])
    optimum = _log_determinants(best.rows[None])[0]
    return float(np.exp((optimum - np.median(values)) / GRAVITY_PARAMETERS))


def _ordered(poses: FloatArray, velocity: FloatArray, start: FloatArray | None) -> IntArray:
    """Order of the poses for a short round trip: the nearest next, then reversed stretches (2-opt).

    Args:
        poses: Poses. Shape (P, n).
        velocity: Velocity limits. Shape (n,).
        start: Pose at which the motion begins and ends; None: the first pose.
    """
    stops = poses if start is None else np.vstack([start, poses])
    time = np.abs((stops[:, None] - stops[None]) / velocity).max(axis=2)
    tour, left = [0], list(range(1, len(stops)))
    while left:
        nearest = min(left, key=lambda k: time[tour[-1], k])
        left.remove(nearest)
        tour.append(nearest)

    def length(path: list[int]) -> float:
        return float(sum(time[a, b] for a, b in zip(path, [*path[1:], path[0]], strict=True)))

    is_shorter = True
    while is_shorter:
        is_shorter = False
        for i in range(1, len(tour) - 1):
            for k in range(i + 1, len(tour)):
                other = [*tour[:i], *tour[i : k + 1][::-1], *tour[k + 1 :]]
                if length(other) < length(tour) - 1e-9:
                    tour, is_shorter = other, True
    return np.array(tour) if start is None else np.array(tour[1:]) - 1


@dataclass(frozen=True)
class _Blocked(Exception):
    """A pose to which no way leads.

    Attributes:
        pose: Index of the pose.
        reason: What is violated.
    """

    pose: int
    reason: str


def _visits(
    planner: RampPlanner,
    problem: _StaticProblem,
    poses: FloatArray,
    known: FloatArray,
    start: FloatArray | None,
) -> list[Part]:
    """Plan the parts from the start to the last rest, and back to the start.

    Args:
        planner: Planner of the parts.
        problem: What is required of the poses.
        poses: Poses in their order. Shape (P, n).
        known: Clear poses through which ways may lead. Shape (m, n).
        start: Pose at which the motion begins and ends; None: near the first pose.

    Raises:
        _Blocked: No way leads to a pose.
    """
    parts, reach = list[Part](), problem.reach
    here = poses[0] + reach if start is None else start
    home = here
    for k, pose in enumerate(poses):
        is_last = k == len(poses) - 1
        for side in (1.0, -1.0):
            for target in (pose + side * reach, pose):
                if np.abs(here - target).max() < ramps.SAME_POSE:
                    continue
                legs, reason = planner.plan_transfer(here, target, known)
                is_near = np.abs(here - target).max() <= reach.max() + ramps.SAME_POSE
                if not legs or (is_near and len(legs) > 1):
                    raise _Blocked(k, reason or "the clearances on the direct way")
                parts += [(SegmentKind.APPROACH, *leg) for leg in legs]
                here = target
            if is_last and side < 0.0:
                parts.append((SegmentKind.FOURIER, None, 2.0 * REST_PERIOD))  # it is constant
            else:
                parts.append((SegmentKind.APPROACH, *_rest(pose)))
    legs, reason = planner.plan_transfer(here, home, known)
    if not legs:
        raise _Blocked(len(poses) - 1, reason)
    return parts + [(SegmentKind.RETURN, *leg) for leg in legs]


def _rest(pose: FloatArray) -> tuple[JerkProfile, float]:
    """Return the rest at a pose after an arrival, and its duration [s]."""
    zero, duration = np.zeros_like(pose), 2.0 * REST_PERIOD
    return JerkProfile(pose, zero, zero, (((duration, 0.0),),) * len(pose)), duration


def _motion(joints: tuple[str, ...], parts: list[Part], pose: FloatArray, rate: float) -> Motion:
    """Join the parts to a motion, whose Fourier part is the rest at the last pose."""
    zero = np.zeros((len(pose), 1))
    fourier = FourierSeries(zero, zero, pose, REST_PERIOD)
    return ramps.joined_parts(joints, fourier, 2, parts, rate)


def design_static_poses(
    robot: Robot,
    limits: Limits,
    options: DesignOptions,
    link: str,
    count: int,
    *,
    start: FloatArray | None = None,
    cell: Cell | None = None,
    unchecked_reason: str = NOT_CHECKED,
    speed: float = 1.0,
    force: bool = False,
    progress: Progress = lambda text: None,
) -> StaticDesign:
    """Choose static poses for a payload, and certify the motion that visits them.

    Args:
        robot: The robot.
        limits: Its limits.
        options: Rate, noise, boxes, uncertainty and seed; the other options are those of motions.
        link: Link that carries the payload.
        count: Number of poses.
        start: Pose at which the motion starts and ends at rest; None: near the first pose. Shape
            (n,).
        cell: Surroundings to keep clear of; None: distances are not checked.
        unchecked_reason: Sentence that the file states where `cell` is None.
        speed: Share of the designed speed at which the motion is delivered [1].
        force: Return a motion even when its certificate fails.
        progress: Called with a line of text now and then.

    Raises:
        CheckFailed: The certificate fails and `force` is not set.
        Infeasible: There are too few poses that keep all limits, or that can be reached.
        UnusableInput: The link does not move, or the start pose violates a limit.
    """
    parameters = inertial_parameters.standard_parameters(robot, limits, options.drive)
    still = FourierSeries(np.zeros((robot.n, 1)), np.zeros((robot.n, 1)), np.zeros(robot.n), 1.0)
    constraints = MotionConstraints(
        robot,
        with_derived_limits(limits, still).reduced(),
        parameters,
        options.uncertainty,
        options.boxes,
        None if cell is None else clearance_builder.build_constraint(cell),
    )
    if start is not None:
        ramps.check_start_pose(constraints, start)
    noise = torque_noise_levels(limits, options.noise)
    problem, rng = (
        _StaticProblem(constraints, parameters, noise, link),
        np.random.default_rng(options.seed),
    )
    candidates = problem.feasible(spread_poses(_within_a_turn(limits, robot), CANDIDATES))
    progress(f"{len(candidates)} of {CANDIDATES} poses keep all limits and clearances")
    planner, reason = RampPlanner(constraints, options.rate), "the limits at rest"
    for _ in range(MAX_REPLACEMENTS):
        if len(candidates) < max(count, GRAVITY_PARAMETERS):
            break
        best = _choose(problem, candidates, count, rng)
        order = _ordered(best.poses, limits.velocity, start)
        best = _PoseSet(best.poses[order], best.rows[order])
        try:
            parts = _visits(planner, problem, best.poses, candidates.poses, start)
        except _Blocked as blocked:
            reason = blocked.reason
            progress(f"no way to a pose keeps {reason}; choosing another one")
            distance = np.abs(candidates.poses - best.poses[blocked.pose]).max(axis=1)
            candidates = candidates.without(int(np.argmin(distance)))
            continue
        motion = _motion(robot.joints, parts, best.poses[-1], options.rate).slowed(speed)
        design = {
            "criterion": Criterion.D.value,
            "plain": False,
            "drive": list(options.drive),
            "samples": GRAVITY_PARAMETERS,
            "uncertainty": options.uncertainty,
            "margin": dict(limits.margin),
            "boxes": [dataclasses.asdict(box) for box in options.boxes],
            "payload_link": link,
            "speed": speed,
            "static": {"poses": best.poses.tolist(), "rest": 2.0 * REST_PERIOD / speed},
        }
        trajectory, certificate = certified_trajectory(
            robot, limits, motion, options, noise, design, cell, unchecked_reason
        )
        if not certificate.ok and not force:
            raise CheckFailed(
                f"{robot.source}: the motion between static poses fails its certificate: "
                f"{certificate.failure_reason()}; try another --seed, widen that limit, or --force"
            )
        return StaticDesign(
            trajectory,
            certificate,
            parameters,
            link,
            best.poses,
            problem.deviation(best),
            _efficiency(candidates, best, rng),
        )
    raise Infeasible(
        f"{robot.source}: no {count} static poses can be reached within {reason}; widen them, "
        "clear the scene or give fewer --poses"
    )
