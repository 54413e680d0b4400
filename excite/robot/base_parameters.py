"""Base parameters θ = Bψ: the combinations of ψ that motion and torque determine, with names.

Their number follows from the structure of the robot alone, by the recursion of Wensing, Niemeyer &
Slotine (A geometric characterization of observability in inertial parameter identification, IJRR
2024): the invisible directions are sums of transfers across single joints. A change δI of body i's
inertia is invisible across joint i, up to an equal change of its parent, when for all attainable
velocities v, w of the body (gravity counted as an acceleration of the base) Sᵢᵀ δI v = 0 and
vᵀ (ad(S)ᵀ δI + δI ad(S)) w = 0. Here it also counts rotor inertia and a constant torque offset,
which the first condition can trade against δI.

Both the number and B are those of exact placements (see `exact_placement`).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._types import FloatArray, IntArray
from ..errors import ExciteWarning
from .dynamics import regressor
from .inertial_parameters import Parameters, spread_poses
from .limits import Limits
from .parameter_names import some
from .robot import Robot
from .samples import Samples

RANK_TOLERANCE = 1e-7
"""Singular value, relative to the largest, below which a direction of the unit-length columns is
invisible; also the remainder below which a unit column depends on others. Over the 69 URDFs of the
wheel example-robot-data with exact placements, the values of structural zeros are below 1.3e-10 and
all others above 3.5e-5 (scripts/base_counts.py); this is about their geometric mean."""
RECURSION_TOLERANCE = 1e-9
"""Singular value below which a condition of the structural recursion holds, relative to the largest
or to 1."""
ABSENT_COLUMN = 1e-12
"""Length of a column, relative to the longest, below which it is zero to rounding."""
LARGEST_WEIGHT_RATIO = 1e-3
"""Smallest torque limit, relative to the largest, that weighs the rows of its joint [1]: with
limits further apart (a URDF may state 1e9 N m for "none") whole joints would be invisible."""
COUNTING_SPEEDS = (0.1, 10.0)
"""Slowest and fastest typical speed of the motion that counts ranks [rad/s or m/s]. Gravity and
inertial torques are of one magnitude within; a URDF may state 1e4 rad/s, where gravity is lost to
rounding."""
NAMED_JOINTS = 7
"""Number of joints that a message names one by one."""
ALWAYS_INDEPENDENT = ("viscous", "coulomb", "offset")
"""Parameters of a joint that are among the independent ones whatever else could stand for them."""
SMALLEST_COEFFICIENT = 1e-8
"""Coefficient of a unit column below which it is zero: the error of the factorisation of columns
that differ by more than RANK_TOLERANCE."""


@dataclass(frozen=True)
class Base:
    """The observable part of the standard parameters; nothing downstream depends on the choice of
    basis.

    Attributes:
        matrix: B in reduced row-echelon form, θ = Bψ. Shape (p, P).
        independent: For each θ the place in ψ of the parameter it is named after. Shape (p,).
        geometric: W = G₀^{-1/2} V, V an orthonormal basis of Range(G₀^{-1/2} Bᵀ). Shape (P, p). The
            eigenvalues of Wᵀ (Σ Yᵀ Σ⁻¹ Y) W are those of I·H₀⁻¹ (Lee, Wensing & Park, eq. 20).
        plain: The same with orthonormal rows of B and H₀ = 1. Shape (P, p).
        expressions: A name such as "m3 + m4 + 0.613*mcx2" for each θ.
    """

    matrix: FloatArray
    independent: IntArray
    geometric: FloatArray
    plain: FloatArray
    expressions: tuple[str, ...]

    @property
    def count(self) -> int:
        """p, the number of base parameters."""
        return len(self.independent)

    @property
    def selection(self) -> FloatArray:
        """The 0/1 matrix that takes the independent columns of Y: Γ = Y · selection. Shape (P,
        p)."""
        out: FloatArray = np.eye(self.matrix.shape[1])[:, self.independent]
        return out


def random_motion(limits: Limits, count: int, rng: np.random.Generator) -> Samples:
    """Unrelated states spread over the limits, for counting ranks."""
    n = len(limits.joints)
    speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0).clip(*COUNTING_SPEEDS)
    q = spread_poses(limits, count)
    return Samples(
        q, speed * rng.normal(size=(count, n)), 4.0 * speed * rng.normal(size=(count, n))
    )


def find(robot: Robot, parameters: Parameters, limits: Limits) -> Base:
    """Base parameters by a rank-revealing factorisation, checked against the structure.

    The columns of the regressor along a random motion, with exact placements, are compared after
    scaling to unit length. A warning names joints whose placement is rounded, and another says when
    the numerical and the structural number differ.
    """
    exact = robot.with_exact_placements()
    motion = random_motion(
        limits, max(40, 4 * parameters.count // robot.n + 20), np.random.default_rng(1)
    )
    noise = np.maximum(limits.torque, LARGEST_WEIGHT_RATIO * limits.torque.max())
    stacked = (regressor(exact, parameters, motion) / noise[:, None]).reshape(-1, parameters.count)
    base = base_of_columns(stacked, parameters)
    _warn(robot, parameters, base.count)
    return base


def base_of_columns(stacked: FloatArray, parameters: Parameters) -> Base:
    """Base parameters by a rank-revealing factorisation of the stacked regressor of a motion.

    Args:
        stacked: Rows of the regressor along a motion that excites everything. Shape (m, P).
        parameters: The standard parameters.
    """
    norms = np.linalg.norm(stacked, axis=0)
    present = (norms > RANK_TOLERANCE * _largest_of_kind(norms, parameters)) & (
        norms > ABSENT_COLUMN * norms.max()
    )
    unit = np.asarray(np.linalg.qr(stacked[:, present] / norms[present], mode="r"))
    values = np.linalg.svd(unit, compute_uv=False)
    rank = int(np.sum(values > RANK_TOLERANCE * values[0]))
    chosen, coefficients = _echelon(unit, rank, _order(parameters)[present])
    matrix = np.zeros((rank, parameters.count))
    matrix[:, present] = coefficients * norms[present] / norms[present][chosen][:, None]
    return Base(
        matrix=matrix,
        independent=np.flatnonzero(present)[chosen],
        geometric=parameters.scale @ np.linalg.qr((matrix @ parameters.scale).T)[0],
        plain=np.linalg.qr(matrix.T)[0],
        expressions=tuple(_expression(row, parameters.names) for row in matrix),
    )


def _warn(robot: Robot, parameters: Parameters, rank: int) -> None:
    """Warn of rounded placements, and of a rank that is not the structural number."""
    if robot.rounded:
        names = some(robot.rounded, NAMED_JOINTS)
        text = (
            f"{robot.source}: the placement of {names} is rounded (as 1.57 or 1.5708 for "
            "π/2); the base parameters are those of exact right angles"
        )
        warnings.warn(text, ExciteWarning, stacklevel=3)
    expected = base_count(robot, parameters)
    if rank != expected and robot.model.nv == robot.n:
        text = (
            f"{robot.source}: {rank} base parameters are visible, {expected} exist by structure; "
            "the difference is left out (a length or an angle of the robot is nearly zero)"
        )
        warnings.warn(text, ExciteWarning, stacklevel=3)


def _order(parameters: Parameters) -> IntArray:
    """Rank of each parameter in the choice of independent ones: a joint's own friction and offset
    before all others."""
    first = np.zeros(parameters.count, bool)
    for kind in parameters.drive:
        first[parameters.block(kind)] = kind in ALWAYS_INDEPENDENT
    return np.where(first, 0, 1)


def _largest_of_kind(norms: FloatArray, parameters: Parameters) -> FloatArray:
    """For each column the largest norm among columns of its kind: masses, first moments, inertias,
    and each drive block."""
    n = len(parameters.joints)
    kinds = [0, 1, 1, 1, 2, 2, 2, 2, 2, 2] * parameters.bodies + [
        3 + k for k in range(len(parameters.drive)) for _ in range(n)
    ]
    kind = np.array(kinds)
    largest = np.array([norms[kind == k].max() for k in range(kind.max() + 1)])
    return largest[kind]


def _echelon(unit: FloatArray, rank: int, order: IntArray) -> tuple[IntArray, FloatArray]:
    """Independent columns of a regressor, and every column in terms of them: the coefficients of
    reduced row-echelon B.

    Gram-Schmidt over unit columns from the base outwards, so that each θ is named after its
    innermost parameter and grouped with outer ones; exactly `rank` columns are kept.

    Args:
        unit: Columns of unit length. Shape (m, k).
        rank: Number of columns to choose.
        order: Columns of a lower number are tried first. Shape (k,).
    """
    remainder, taken = np.zeros(unit.shape[1]), np.zeros((len(unit), 0))
    for column in np.argsort(order, kind="stable"):
        orthogonal = unit[:, column]
        for _ in range(2):  # once more, against cancellation
            orthogonal = orthogonal - taken @ (taken.T @ orthogonal)
        length = float(np.linalg.norm(orthogonal))
        if length > RANK_TOLERANCE and taken.shape[1] < rank:
            remainder[column] = length
            taken = np.column_stack([taken, orthogonal / length])
    chosen = np.flatnonzero(remainder)
    if len(chosen) < rank:  # nearly invisible columns: let pivoting decide
        import scipy.linalg  # slow to import

        chosen = np.sort(scipy.linalg.qr(unit, mode="r", pivoting=True)[1][:rank])
    orthonormal, triangular = np.linalg.qr(unit[:, chosen])
    coefficients = np.linalg.solve(triangular, orthonormal.T @ unit)
    coefficients[np.abs(coefficients) < SMALLEST_COEFFICIENT] = 0.0
    coefficients[:, chosen] = np.eye(rank)
    return chosen, coefficients


def _expression(row: FloatArray, names: tuple[str, ...]) -> str:
    words = []
    for name, value in zip(names, row, strict=True):
        if value == 0.0:
            continue
        sign = "-" if value < 0 else "+"
        factor = "" if abs(abs(value) - 1.0) < 1e-9 else f"{abs(value):.4g}*"
        words.append(f"{sign} {factor}{name}")
    text = " ".join(words)
    return text[2:] if text.startswith("+ ") else text


def _spatial_inertia(phi: FloatArray) -> FloatArray:
    """6x6 inertia about the joint's origin for (linear, angular) vectors; linear in φ, defined for
    mass 0 too."""
    lever = pin.skew(phi[1:4])
    tensor = np.array(
        [[phi[4], phi[5], phi[7]], [phi[5], phi[6], phi[8]], [phi[7], phi[8], phi[9]]]
    )
    return np.block([[phi[0] * np.eye(3), -lever], [lever, tensor]])


_INERTIAS = np.array([_spatial_inertia(unit) for unit in np.eye(10)])


def _span(columns: FloatArray) -> FloatArray:
    """Orthonormal basis of the columns' span."""
    if columns.shape[1] == 0:
        return columns
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    keep = values > RECURSION_TOLERANCE * max(1.0, float(values[0]))
    return np.ascontiguousarray(left[:, keep])


def _poses(robot: Robot, index: int, axis: FloatArray) -> list[pin.SE3]:
    """Placements of body `index` in its parent at coordinates that together show all the joint can
    do.

    A joint's action on velocities is a trigonometric polynomial of degree ≤ 2, or one of degree ≤ 2
    in a slide: five coordinates determine it.
    """
    placement = robot.model.jointPlacements[index]
    steps = (
        np.arange(5) * (2.0 * np.pi / 5.0)
        if np.linalg.norm(axis[3:]) > 0.5
        else np.linspace(-1.0, 1.0, 5)
    )
    return [placement * pin.exp6(pin.Motion(axis * step)) for step in steps]


def _ad(axis: FloatArray) -> FloatArray:
    """Matrix of the motion cross product S × for (linear, angular) vectors."""
    linear, angular = pin.skew(axis[:3]), pin.skew(axis[3:])
    return np.block([[angular, linear], [np.zeros((3, 3)), angular]])


def base_count(robot: Robot, parameters: Parameters) -> int:
    """Number of base parameters that the structure of `robot` admits.

    Exact for every tree of one-degree joints. Mimic joints, whose transfers are not single-joint,
    are not covered: the count is then of the robot with its mimic joints moving freely, an upper
    bound.
    """
    robot = robot.with_exact_placements()
    model = robot.model
    rotor, offset = "rotor_inertia" in parameters.drive, "offset" in parameters.drive
    motions: list[FloatArray] = [np.zeros((6, 0))]
    gravity: list[FloatArray] = [np.concatenate([np.asarray(model.gravity.linear), np.zeros(3)])]
    changes: list[FloatArray] = [np.zeros((6, 0))]
    invisible = 0
    for i, axis in enumerate(robot.axes(), start=1):
        parent, poses = model.parents[i], _poses(robot, i, axis)
        actions = [pose.inverse().action for pose in poses]
        reached = _span(np.hstack([action @ motions[parent] for action in actions]))
        pulls = [action @ gravity[parent] for action in actions]
        varying = _span(
            np.hstack(
                [
                    np.column_stack(pulls[1:]) - pulls[0][:, None],
                    *[a @ changes[parent] for a in actions],
                ]
            )
        )
        invisible += transfers(axis, reached, pulls[0], varying, rotor, offset).shape[1]
        motions.append(_span(np.column_stack([reached, axis])))
        gravity.append(pulls[0])
        changes.append(varying)
    drives = len(parameters.drive) * (model.nv if robot.n == model.nv else robot.n)
    return 10 * parameters.bodies + drives - invisible


def transfers(
    axis: FloatArray,
    reached: FloatArray,
    pull: FloatArray,
    varying: FloatArray,
    rotor: bool,
    offset: bool,
) -> FloatArray:
    """Basis of the invisible changes (δφ, rotor inertia, offset) of one body and joint.

    Args:
        axis: Motion subspace of the joint, (linear, angular). Shape (6,).
        reached: Basis of the velocities that the body attains. Shape (6, k).
        pull: Gravity in the frame of the body. Shape (6,).
        varying: Basis of the changes of gravity in that frame. Shape (6, m).
        rotor: True if the joint has a rotor inertia among its parameters.
        offset: True if it has a torque offset.

    Returns:
        Columns of 10 to 12 numbers; rotor inertia and offset follow the inertial parameters.
    """
    momenta = np.einsum("a,kab->kb", axis, _INERTIAS)  # Sᵀ E_k
    conditions = [
        np.hstack([(momenta @ vector), 0.0, 0.0]) for vector in np.hstack([reached, varying]).T
    ]
    conditions.append(np.hstack([momenta @ axis, 1.0, 0.0]))
    conditions.append(np.hstack([momenta @ pull, 0.0, 1.0]))
    turned = np.array([_ad(axis).T @ inertia + inertia @ _ad(axis) for inertia in _INERTIAS])
    others = np.column_stack([reached, varying, pull])
    conditions += [np.hstack([turned @ w @ v, 0.0, 0.0]) for v in reached.T for w in others.T]
    matrix = np.array(conditions)
    keep = [True] * 10 + [rotor, offset]
    _, values, right = np.linalg.svd(matrix[:, keep])
    rank = int(np.sum(values > RECURSION_TOLERANCE * max(1.0, float(values[0]))))
    return np.asarray(right[rank:].T)
