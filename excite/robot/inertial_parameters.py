"""Standard parameters ψ of a robot: their order, names, nominal values and natural metric.

ψ = [φ₁ … φ_nv, rotor inertia, viscous, Coulomb, offset], φᵢ = [m, m·cx, m·cy, m·cz, Ixx, Ixy, Iyy,
Ixz, Iyz, Izz] in Pinocchio's order at the joint frame; the blocks after the inertial ones hold one
number per moving joint.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .._system.one_or_several import one_or_several
from .._types import FloatArray
from ..errors import ExciteWarning, UnusableInput
from .limits import Limits
from .link_inertia import impossible_moments
from .robot import Robot

INERTIAL = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
DRIVE = ("rotor_inertia", "viscous", "coulomb", "offset")
DRIVE_SYMBOLS = {"rotor_inertia": "Ia", "viscous": "Fv", "coulomb": "Fc", "offset": "tau0"}
COULOMB_WIDTH = 0.005
"""Width v of the smooth Coulomb column tanh(q̇/v) [rad/s or m/s]."""

MIN_MOMENT_RATIO = 1e-6
"""Principal second moment, relative to the largest, below which a body is flat to rounding [1]: the
inertias of URDFs have six digits."""
MIN_MASS_SHARE = 1e-6
"""Share of the robot's mass below which a body counts as massless [1], for the same reason."""
FLAT_BODY_MOMENT_RATIO = 1e-3
"""Principal second moment that a flat body gets, relative to its largest [1]: that of a plate whose
thickness is a thirtieth of its width."""
MASS_SHARE = 1e-2
"""Share of the robot's mass that a massless body gets [1], that of a cover or a small link."""
BALL_RADIUS = 0.05
"""Radius of the uniform ball that a body without second moment becomes [m]: half the width of a
small arm's link."""
POINT_SHARE = 1e-4
"""Largest second moment, relative to that ball's, below which a body has none [1]: a ball of 0.5 mm
radius."""
ROTOR_INERTIA_SCALE = 0.05
"""Scale of an unknown rotor inertia over the joint's mean mass-matrix diagonal [1]."""
FRICTION_SCALE = 0.02
"""Scale of unknown Coulomb friction and offset over the torque limit, and of unknown viscous
friction over torque limit per velocity limit [1]: the order of magnitude in robot joints."""
MEAN_INERTIA_POSES = 64
"""Poses over which the mass matrix is averaged [1]; the mean enters a scale only."""
GOLDEN_RATIO_ITERATIONS = 60
"""Fixed-point iterations after which the generalised golden ratio is exact to rounding [1]."""


@dataclass(frozen=True)
class Parameters:
    """The standard parameters that a design considers.

    Attributes:
        drive: The kinds of DRIVE that are included, in that order.
        names: P names such as "m3", "mcx3", "Izz3", "Ia3", "Fc3"; the number is the joint's place,
            from 1.
        nominal: ψ₀ as the URDF states it. Shape (P,).
        scale: G₀^{-1/2}, block diagonal: δψ = scale · (unit vector) has length 1 in the metric.
            Shape (P, P).
        links: Names of the links with inertial parameters.
        joints: Names of the joints with parameters of their own.
        repaired: Names of links whose nominal inertia was no body; the metric uses a substitute,
            see `proper_body`.
    """

    drive: tuple[str, ...]
    names: tuple[str, ...]
    nominal: FloatArray
    scale: FloatArray
    links: tuple[str, ...]
    joints: tuple[str, ...]
    repaired: tuple[str, ...]

    @property
    def count(self) -> int:
        """P, the number of standard parameters."""
        return len(self.names)

    @property
    def bodies(self) -> int:
        """Number of bodies with ten inertial parameters each."""
        return len(self.links)

    def of_bodies(self, psi: FloatArray) -> FloatArray:
        """Return the inertial parameters of each body, shape (bodies, 10).

        Args:
            psi: Standard parameters. Shape (P,).
        """
        return psi[: 10 * self.bodies].reshape(-1, 10)

    def norms(self, rows: FloatArray) -> FloatArray:
        """Return y G₀⁻¹ yᵀ of each row y, block by block. Shapes (m, P) -> (m,)."""
        edge = 10 * self.bodies
        blocks = np.stack([self.scale[i : i + 10, i : i + 10] for i in range(0, edge, 10)])
        bodies = np.swapaxes(rows[:, :edge].reshape(len(rows), self.bodies, 10), 0, 1) @ blocks
        drive = rows[:, edge:] * np.diag(self.scale)[edge:]
        return np.einsum("bri,bri->r", bodies, bodies) + np.einsum("ri,ri->r", drive, drive)

    def coulomb(self) -> FloatArray:
        """Return the nominal Coulomb friction [N m or N], 0 without such parameters. Shape (n,)."""
        return (
            self.nominal[self.block("coulomb")]
            if "coulomb" in self.drive
            else np.zeros(len(self.joints))
        )

    def block(self, kind: str) -> slice:
        """Return the positions in ψ of one kind of joint parameter.

        Args:
            kind: One of `drive`.

        Raises:
            ValueError: The kind is not included.
        """
        n = len(self.joints)
        start = 10 * self.bodies + n * self.drive.index(kind)
        return slice(start, start + n)

    def owners(self) -> tuple[str, ...]:
        """Return for each parameter the link (inertial) or joint (drive) that it belongs to."""
        inertial = [link for link in self.links for _ in INERTIAL]
        return tuple(inertial + [joint for _ in self.drive for joint in self.joints])


def pseudo_inertia(phi: FloatArray) -> FloatArray:
    """Return P(φ) = [[S, h], [hᵀ, m]] with S = ½ tr(I)·1 − I (Lee, Wensing & Park, eq. 15).

    Args:
        phi: Inertial parameters of a body. Shape (10,).

    Returns:
        The pseudo-inertia. Shape (4, 4).
    """
    tensor = np.array(
        [[phi[4], phi[5], phi[7]], [phi[5], phi[6], phi[8]], [phi[7], phi[8], phi[9]]]
    )
    out = np.empty((4, 4))
    out[:3, :3] = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    out[:3, 3] = out[3, :3] = phi[1:4]
    out[3, 3] = phi[0]
    return out


def of_pseudo_inertia(matrix: FloatArray) -> FloatArray:
    """Return the inertial parameters of a pseudo-inertia, the inverse of `pseudo_inertia`.

    Args:
        matrix: Symmetric matrix. Shape (4, 4).

    Returns:
        Inertial parameters. Shape (10,).
    """
    second = matrix[:3, :3]
    t = np.trace(second) * np.eye(3) - second
    return np.array(
        [matrix[3, 3], *matrix[:3, 3], t[0, 0], t[0, 1], t[1, 1], t[0, 2], t[1, 2], t[2, 2]]
    )


PSEUDO_INERTIA_BASIS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])
"""∂P/∂φ. Shape (10, 4, 4)."""


def frame_map(T: FloatArray) -> FloatArray:
    """Return the map of inertial parameters by P' = T P Tᵀ.

    Args:
        T: Homogeneous transformation from a frame to another one, or a reflection. Shape (4, 4).

    Returns:
        Shape (10, 10).
    """
    return np.column_stack([of_pseudo_inertia(T @ unit @ T.T) for unit in PSEUDO_INERTIA_BASIS])


def metric(phi: FloatArray) -> FloatArray:
    """Return g_ij = ½ tr(P⁻¹ Eᵢ P⁻¹ Eⱼ), the affine-invariant metric at φ (eq. 18).

    Args:
        phi: Inertial parameters of a physically consistent body. Shape (10,).

    Returns:
        The metric g. Shape (10, 10).
    """
    scaled = np.linalg.solve(pseudo_inertia(phi), PSEUDO_INERTIA_BASIS)
    return 0.5 * np.einsum("iab,jba->ij", scaled, scaled)


def inverse_root(phi: FloatArray) -> FloatArray:
    """Return R with R Rᵀ = g(φ)⁻¹, from a factor of P, accurate where g is ill-conditioned.

    P = C Cᵀ; δP = C E Cᵀ with E symmetric has length² ½ tr(E²), so an orthonormal basis of such E
    is one of the tangent.

    Args:
        phi: Inertial parameters of a physically consistent body. Shape (10,).

    Returns:
        The root R. Shape (10, 10).
    """
    factor = np.linalg.cholesky(pseudo_inertia(phi))
    columns = []
    for i in range(4):
        for j in range(i + 1):
            unit = np.zeros((4, 4))
            unit[i, j] = unit[j, i] = np.sqrt(2.0) if i == j else 1.0
            columns.append(of_pseudo_inertia(factor @ unit @ factor.T))
    return np.array(columns).T


def proper_body(phi: FloatArray, robot_mass: float) -> tuple[FloatArray, bool]:
    """Return the body itself if it is physically consistent, else a substitute.

    A mass below 1e-6 of the robot's becomes 1 % of it, at the joint's origin; a body with next to
    no second moment becomes a uniform ball of 5 cm radius; a principal second moment about the
    centre of mass that is below 1e-6 of the largest one rises to 1e-3 of it.

    Args:
        phi: Inertial parameters of the body. Shape (10,).
        robot_mass: Mass of the robot [kg].

    Returns:
        Inertial parameters, shape (10,), and True if they are a substitute.
    """
    mass, centre, second = phi[0], np.zeros(3), np.zeros((3, 3))
    if mass < MIN_MASS_SHARE * robot_mass:
        mass = MASS_SHARE * robot_mass
    else:
        centre = phi[1:4] / mass
        second = pseudo_inertia(phi)[:3, :3] - mass * np.outer(centre, centre)
    values, vectors = np.linalg.eigh(second)
    ball = 0.2 * mass * BALL_RADIUS**2
    if values[-1] < POINT_SHARE * ball:
        second = ball * np.eye(3)
    elif values[0] < MIN_MOMENT_RATIO * values[-1]:
        second = (vectors * np.maximum(values, FLAT_BODY_MOMENT_RATIO * values[-1])) @ vectors.T
    else:
        return phi, False
    second = second + mass * np.outer(centre, centre)
    tensor = np.trace(second) * np.eye(3) - second
    moments = [tensor[0, 0], tensor[0, 1], tensor[1, 1], tensor[0, 2], tensor[1, 2], tensor[2, 2]]
    return np.array([mass, *(mass * centre), *moments]), True


def drive_kinds(drive: str | Iterable[str]) -> tuple[str, ...]:
    """Return kinds of joint parameters in the order of DRIVE.

    Raises:
        UnusableInput: One of them is unknown.
    """
    wanted = set(one_or_several(drive))
    unknown = wanted - set(DRIVE)
    if unknown:
        raise UnusableInput(f"no joint parameter '{min(unknown)}'; there are: {', '.join(DRIVE)}")
    return tuple(kind for kind in DRIVE if kind in wanted)


def standard_parameters(
    robot: Robot, limits: Limits, drive: str | Iterable[str] = DRIVE
) -> Parameters:
    """Return the standard parameters of a robot, with nominal values and metric.

    The scale of a joint parameter is its nominal value, or where that is 0: Coulomb and offset 0.02
    τ_max, viscous 0.02 τ_max/v_max, rotor inertia 5 % of the joint's mean mass-matrix diagonal.

    Args:
        robot: The robot.
        limits: Its limits, for the scales.
        drive: Kinds of joint parameters to include.

    Returns:
        The parameters; their metric has substitutes for bodies that are not physically consistent.

    Raises:
        UnusableInput: `drive` names an unknown kind.
    """
    kinds = drive_kinds(drive)
    model = robot.model
    bodies = [model.inertias[i].toDynamicParameters() for i in range(1, model.njoints)]
    nominal, scale = drive_values(robot, limits, consistent_bodies(bodies))
    numbers = range(1, len(bodies) + 1)
    return assembled_parameters(robot, kinds, bodies, robot.links, numbers, nominal, scale)


def consistent_bodies(bodies: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the bodies of a robot, with a substitute for each that is not physically consistent.

    Args:
        bodies: Inertial parameters of all bodies of the robot. Shape (10,) each.
    """
    return [proper_body(phi, _robot_mass(bodies))[0] for phi in bodies]


def _robot_mass(bodies: Iterable[FloatArray]) -> float:
    """Mass of a robot, or 1 where nothing has a mass [kg]."""
    return float(sum(max(phi[0], 0.0) for phi in bodies)) or 1.0


def _fault_of_body(phi: FloatArray) -> str:
    """Say why inertial parameters are those of no rigid body with an extent. Shape (10,)."""
    if phi[0] <= 0.0:
        return "massless"
    moments = np.linalg.eigvalsh(body_inertia(phi).inertia)
    return impossible_moments(moments) or "singular inertia"


def assembled_parameters(
    robot: Robot,
    kinds: tuple[str, ...],
    bodies: Sequence[FloatArray],
    links: tuple[str, ...],
    numbers: Iterable[int],
    nominal: Mapping[str, FloatArray],
    scale: Mapping[str, FloatArray],
) -> Parameters:
    """Assemble the standard parameters of bodies and joints.

    Args:
        robot: The robot, for its joints and for warnings.
        kinds: Kinds of joint parameters.
        bodies: Inertial parameters of the bodies. Shape (10,) each.
        links: Names of the links that the bodies are named after.
        numbers: Number of each body in the names of its parameters.
        nominal: Nominal values of each kind of joint parameter. Shape (n,) each.
        scale: Their scales.
    """
    n, mass = robot.n, _robot_mass(bodies)
    proper = [proper_body(phi, mass) for phi in bodies]
    roots = [inverse_root(phi) for phi, _ in proper]
    repaired = [link for link, (_, changed) in zip(links, proper, strict=True) if changed]
    if repaired:
        reasons = [
            f"{link} ({_fault_of_body(phi)})"
            for link, phi, (_, changed) in zip(links, bodies, proper, strict=True)
            if changed
        ]
        text = (
            f"{robot.source}: no proper body in link(s) {', '.join(reasons)}; the metric uses a "
            "substitute"
        )
        warnings.warn(text, ExciteWarning, stacklevel=3)
    size = 10 * len(bodies)
    matrix = np.zeros((size + n * len(kinds),) * 2)
    for i, root in enumerate(roots):
        matrix[10 * i : 10 * i + 10, 10 * i : 10 * i + 10] = root
    tail = [scale[kind] for kind in kinds]
    matrix[range(size, len(matrix)), range(size, len(matrix))] = np.concatenate([*tail, []])
    names = [f"{symbol}{i}" for i in numbers for symbol in INERTIAL]
    names += [f"{DRIVE_SYMBOLS[kind]}{j}" for kind in kinds for j in range(1, n + 1)]
    return Parameters(
        drive=kinds,
        names=tuple(names),
        nominal=np.concatenate([*bodies, *[nominal[kind] for kind in kinds]]),
        scale=matrix,
        links=links,
        joints=robot.joints,
        repaired=tuple(repaired),
    )


def drive_values(
    robot: Robot, limits: Limits, bodies: list[FloatArray]
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return nominal values and scales of each kind of joint parameter. Shape (n,) each.

    Args:
        robot: The robot.
        limits: Its limits.
        bodies: Inertial parameters of its physically consistent bodies. Shape (10,) each.
    """
    nominal = {
        kind: np.array([getattr(entry, kind) for entry in robot.entries], float) for kind in DRIVE
    }
    for follower in robot.followers:  # at the joint that it follows: q̇ = m q̇_joint, τ_joint = m τ
        joint, m = robot.index(follower.master), follower.multiplier
        nominal["rotor_inertia"][joint] += m**2 * follower.entry.rotor_inertia
        nominal["viscous"][joint] += m**2 * follower.entry.viscous
        nominal["coulomb"][joint] += abs(m) * follower.entry.coulomb
        nominal["offset"][joint] += m * follower.entry.offset
    fallback = {
        "rotor_inertia": ROTOR_INERTIA_SCALE * mean_inertia(robot, limits, bodies),
        "viscous": FRICTION_SCALE * limits.torque / limits.velocity,
        "coulomb": FRICTION_SCALE * limits.torque,
        "offset": FRICTION_SCALE * limits.torque,
    }
    known = {
        kind: (nominal[kind] > 0.0) & (kind != "offset") for kind in DRIVE
    }  # an offset is signed
    return nominal, {kind: np.where(known[kind], nominal[kind], fallback[kind]) for kind in DRIVE}


TENSOR_ELEMENTS = {
    "ixx": (0, 0),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyy": (1, 1),
    "iyz": (1, 2),
    "izz": (2, 2),
}
"""Row and column of each element of an inertia tensor, by its name in URDF and SDF."""


def body_inertia(phi: FloatArray) -> pin.Inertia:
    """Return the inertia of a body; zero without mass, which has no centre.

    Args:
        phi: Its inertial parameters. Shape (10,).
    """
    return pin.Inertia.FromDynamicParameters(phi) if phi[0] > 0.0 else pin.Inertia.Zero()


def model_with_inertias(robot: Robot, bodies: Iterable[FloatArray]) -> pin.Model:
    """Return a copy of a robot's model whose bodies have other inertias.

    Args:
        robot: The robot.
        bodies: Inertial parameters of each body. Shape (10,) each.
    """
    model = robot.model.copy()
    for i, phi in enumerate(bodies, start=1):
        model.inertias[i] = body_inertia(phi)
    return model


def mean_inertia(robot: Robot, limits: Limits, bodies: Iterable[FloatArray]) -> FloatArray:
    """Return the mean diagonal of the mass matrix over poses spread evenly in the joint ranges.

    Args:
        robot: The robot.
        limits: Its limits.
        bodies: Inertial parameters of each body. Shape (10,) each.

    Returns:
        Mean diagonal. Shape (n,) [kg m² or kg].
    """
    model = model_with_inertias(robot, bodies)
    data = model.createData()
    total = np.zeros(robot.n)
    poses = spread_poses(limits, MEAN_INERTIA_POSES)
    for q in robot.expand(poses):
        upper = np.triu(pin.crba(model, data, q))
        mass = upper + np.triu(upper, 1).T
        total += np.einsum("vi,vw,wi->i", robot.spread, mass, robot.spread)
    return total / len(poses)


def ranges(limits: Limits) -> FloatArray:
    """Return position limits, or half a turn each way without. Shape (n, 2) [rad or m]."""
    return np.where(np.isfinite(limits.position), limits.position, [-np.pi, np.pi])


def spread_poses(limits: Limits, count: int) -> FloatArray:
    """Return poses that fill the joint ranges evenly: a Kronecker sequence, without randomness.

    Args:
        limits: Limits of the joints.
        count: Number of poses.

    Returns:
        Poses. Shape (count, n) [rad or m].
    """
    n = len(limits.joints)
    lower, upper = ranges(limits).T
    root = 2.0
    for _ in range(GOLDEN_RATIO_ITERATIONS):  # the generalised golden ratio: x^(n+1) = x + 1
        root = (1.0 + root) ** (1.0 / (n + 1))
    steps = root ** -np.arange(1.0, n + 1)
    fractions = (0.5 + np.outer(np.arange(count), steps)) % 1.0
    return lower + fractions * (upper - lower)
