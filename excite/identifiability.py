"""Practical identifiability: how well a recording will show each direction of the parameters, in words too.

1/λ, λ an eigenvalue of I·H₀⁻¹ with I the information of the whole recording, is the scale-free variance of its
direction; a direction is identifiable when 1/λ ≤ threshold (METHOD, review section 4.4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .base import Base
from .dynamics import regressor
from .limits import DERIVED, Limits
from .motion import Motion
from .parameters import INERTIAL, Parameters, proper_body, pseudo_inertia
from .robot import Robot
from .trajectory import Fourier, Samples

Array = np.ndarray
SCHEMA = "excite.identifiability/1"
THRESHOLD = 1e-2
SMALLEST_SHARE = 0.01
BLOCK = 400
_AXES = {"mcx": "x", "mcy": "y", "mcz": "z"}
_ABOUT = {"Ixx": "x", "Iyy": "y", "Izz": "z"}
_DRIVE_WORDS = {"rotor_inertia": "rotor inertia", "viscous": "viscous friction", "coulomb": "Coulomb friction", "offset": "torque offset"}


@dataclass(frozen=True)
class Direction:
    """One direction of the parameters. variance: 1/λ, inf where it is not excited at all. weights: shares above 1 %."""

    variance: float
    identifiable: bool
    words: str
    weights: Mapping[str, float]

    @property
    def deviation(self) -> float:
        """Standard deviation in the metric, roughly a relative one."""
        return float(np.sqrt(self.variance))


@dataclass(frozen=True)
class BaseParameter:
    """One base parameter: what it is called, its nominal value and the least standard deviation an unbiased fit has."""

    name: str
    expression: str
    nominal: float
    std: float


@dataclass(frozen=True)
class Share:
    """Part of what can be known of a link or joint that the recording will show; None where nothing can be known."""

    name: str
    identifiable_share: float | None


@dataclass(frozen=True)
class Identifiability:
    """What a recording will tell. Directions are ordered from the best seen to the worst.

    eigenvalues: λ of I·H₀⁻¹, falling. Shape (p,).
    links, joints: shares of each link's ten inertial parameters, and of each joint's drive parameters.
    noise: standard deviation of torque per joint. Shape (n,) [N m]. samples: rows of the recording, if known.
    """

    robot: str
    threshold: float
    eigenvalues: Array
    directions: tuple[Direction, ...]
    base_parameters: tuple[BaseParameter, ...]
    links: tuple[Share, ...]
    joints: tuple[Share, ...]
    joint_names: tuple[str, ...]
    noise: Array
    samples: int | None = None

    @property
    def identifiable(self) -> int:
        """How many directions are practically identifiable."""
        return sum(d.identifiable for d in self.directions)

    def document(self) -> dict[str, Any]:
        """`identifiability.json`; what is not finite (a direction never excited) is null, so that the JSON is strict."""
        return {
            "schema": SCHEMA,
            "robot": self.robot,
            "threshold": self.threshold,
            "samples": self.samples,
            "identifiable": self.identifiable,
            "eigenvalues": [_finite(v) for v in self.eigenvalues],
            "directions": [
                {"variance": _finite(d.variance), "identifiable": d.identifiable, "words": d.words, "weights": dict(d.weights)}
                for d in self.directions
            ],
            "base_parameters": [
                {"name": b.name, "expression": b.expression, "nominal": _finite(b.nominal), "std": _finite(b.std)}
                for b in self.base_parameters
            ],
            "links": [{"name": s.name, "identifiable_share": s.identifiable_share} for s in self.links],
            "joints": [{"name": s.name, "identifiable_share": s.identifiable_share} for s in self.joints],
            "torque_noise": {j: _finite(v) for j, v in zip(self.joint_names, self.noise, strict=True)},
        }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


# -- information ---------------------------------------------------------------------------------------------


def _triangle(rows: Array) -> Array:
    """R of the QR factorisation."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def root_of(Y: Array, noise: Array) -> Array:
    """R with RᵀR = Σ Yᵀ Σ⁻¹ Y, without forming the product, which would lose half of the digits. Shape (≤ P, P)."""
    return _triangle((Y / noise[:, None]).reshape(-1, Y.shape[2]))


def information_root(robot: Robot, parameters: Parameters, samples: Samples, noise: Array) -> Array:
    """`root_of` the regressor along a motion, block by block so that long motions of large robots fit in memory."""
    root = np.zeros((0, parameters.count))
    for start in range(0, len(samples), BLOCK):
        block = root_of(regressor(robot, parameters, samples.rows(slice(start, start + BLOCK))), noise)
        root = _triangle(np.vstack([root, block]))
    return root


def analyse(
    parameters: Parameters,
    base: Base,
    information: Array,
    noise: Array,
    robot: Robot,
    *,
    threshold: float = THRESHOLD,
    samples: int | None = None,
) -> Identifiability:
    """Identifiability from the information Σ Yᵀ Σ⁻¹ Y of the whole recording, in standard parameters. Shape (P, P).

    `analyse_root` is more accurate where directions are seen very unequally; use it when the regressor is at hand.
    """
    values, vectors = np.linalg.eigh(base.geometric.T @ information @ base.geometric)
    # below this the digits are those of rounding, not of the motion
    kept = np.where(values > len(values) * np.finfo(float).eps * max(float(values[-1]), 0.0), values, 0.0)
    frame = _Frame(parameters, base, kept[::-1], vectors[:, ::-1])
    return _describe(frame, robot, noise, threshold, samples)


def analyse_root(
    parameters: Parameters,
    base: Base,
    root: Array,
    noise: Array,
    robot: Robot,
    *,
    threshold: float = THRESHOLD,
    samples: int | None = None,
) -> Identifiability:
    """Identifiability from R with RᵀR = Σ Yᵀ Σ⁻¹ Y: `root_of`, `information_root`, or any such rows stacked. Shape (m, P)."""
    values, vectors = _spectrum(root, base)
    return _describe(_Frame(parameters, base, values, vectors), robot, noise, threshold, samples)


def _spectrum(root: Array, base: Base) -> tuple[Array, Array]:
    """λ, falling, and the directions in the coordinates of base.geometric as columns. Shapes (p,), (p, p)."""
    _, singular, right = np.linalg.svd(_triangle(root @ base.geometric), full_matrices=True)
    values = np.zeros(base.count)
    floor = base.count * np.finfo(float).eps * max(float(singular[0]), 0.0) if len(singular) else 0.0
    values[: len(singular)] = np.where(singular > floor, singular, 0.0) ** 2
    return values, right.T


# -- description ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Frame:
    """Eigenvalues, falling, with their directions as columns in the coordinates of base.geometric."""

    parameters: Parameters
    base: Base
    values: Array
    vectors: Array


def _describe(frame: _Frame, robot: Robot, noise: Array, threshold: float, samples: int | None) -> Identifiability:
    parameters, base, values, vectors = frame.parameters, frame.base, frame.values, frame.vectors
    with np.errstate(divide="ignore"):
        variances = 1.0 / values
    seen = variances <= threshold
    # W = G₀^{-1/2} V: undo the root to have each direction as a unit vector, then name its components
    units = _rotation(parameters) @ np.linalg.solve(parameters.scale, base.geometric @ vectors)
    directions = []
    for variance, identifiable, unit in zip(variances, seen, units.T, strict=True):
        shares = unit**2 / np.sum(unit**2)
        weights = {parameters.names[i]: float(shares[i]) for i in np.argsort(-shares, kind="stable") if shares[i] > SMALLEST_SHARE}
        words = _sentence(parameters, shares, float(variance), bool(identifiable))
        directions.append(Direction(float(variance), bool(identifiable), words, weights))
    links, joints = _shares(parameters, units, seen)
    return Identifiability(
        robot=robot.name,
        threshold=float(threshold),
        eigenvalues=values,
        directions=tuple(directions),
        base_parameters=_base_parameters(parameters, base, vectors, variances),
        links=links,
        joints=joints,
        joint_names=robot.joints,
        noise=np.asarray(noise, float),
        samples=samples,
    )


def _base_parameters(parameters: Parameters, base: Base, vectors: Array, variances: Array) -> tuple[BaseParameter, ...]:
    """Cramér-Rao standard deviations of θ = Bψ: the covariance is (BWV) diag(1/λ) (BWV)ᵀ."""
    factors = (base.matrix @ base.geometric @ vectors) ** 2
    # a direction never excited makes every θ that has a part in it unknown, and no other
    touched = factors > 1e-20 * factors.sum(axis=1, keepdims=True)
    spread = np.where(touched, factors, 0.0)
    finite = np.isfinite(variances)
    std = np.sqrt(spread[:, finite] @ variances[finite])
    std[touched[:, ~finite].any(axis=1)] = np.inf
    nominal = base.matrix @ parameters.nominal
    return tuple(
        BaseParameter(parameters.names[base.independent[k]], base.expressions[k], float(nominal[k]), float(std[k]))
        for k in range(base.count)
    )


def _shares(parameters: Parameters, units: Array, seen: Array) -> tuple[tuple[Share, ...], tuple[Share, ...]]:
    """Per link, and per joint for its drive: trace of the projector onto the identifiable directions, restricted to the
    block of the link's ten parameters, over that of the projector onto all observable directions.

    Traces are taken in the metric, where they depend on no choice of units or of a base.
    """
    squares = units**2
    visible, all_of_it = squares[:, seen].sum(axis=1), squares.sum(axis=1)

    def share(name: str, rows: list[int]) -> Share:
        total = float(all_of_it[rows].sum())
        return Share(name, min(1.0, float(visible[rows].sum()) / total) if total > 1e-9 else None)

    links = tuple(share(link, list(range(10 * i, 10 * i + 10))) for i, link in enumerate(parameters.links))
    start, n = 10 * parameters.bodies, len(parameters.joints)
    joints = tuple(
        share(joint, [start + k * n + j for k in range(len(parameters.drive))])
        for j, joint in enumerate(parameters.joints)
        if parameters.drive
    )
    return links, joints


def _rotation(parameters: Parameters) -> Array:
    """Orthogonal Q that takes whitened coordinates to ones that can be named after a parameter. Shape (P, P).

    Whitened coordinates may be turned within a body. Here they become: mass (centre of mass and shape kept), centre of
    mass along x, y, z (mass kept), and moments of inertia about the centre of mass, each as close as a whitened
    coordinate can be to the parameter whose name it gets.
    """
    out = np.eye(parameters.count)
    masses = parameters.nominal[0 : 10 * parameters.bodies : 10]
    total = float(np.maximum(masses, 0.0).sum())
    for i in range(parameters.bodies):
        block = slice(10 * i, 10 * i + 10)
        named = _named_root(proper_body(parameters.nominal[block], total)[0])
        size = np.linalg.norm(named, axis=1)[:, None]  # rows in kg beside rows in kg m²
        turned = np.linalg.solve(named / size, parameters.scale[block, block] / size)
        left, _, right = np.linalg.svd(turned)
        out[block, block] = left @ right  # the nearest orthogonal matrix, against rounding
    return out


def _named_root(phi: Array) -> Array:
    """K with K Kᵀ = g(φ)⁻¹, one column for each of a body's parameters (see `_rotation`). Shape (10, 10)."""
    mass, centre = phi[0], phi[1:4] / phi[0]
    values, axes = np.linalg.eigh(pseudo_inertia(phi)[:3, :3] - mass * np.outer(centre, centre))
    size = (axes * np.sqrt(np.maximum(values, 1e-300))) @ axes.T
    factor = np.zeros((4, 4))  # P = factor factorᵀ
    factor[:3, :3], factor[:3, 3], factor[3, 3] = size, np.sqrt(mass) * centre, np.sqrt(mass)
    pairs = [(3, 3), (0, 3), (1, 3), (2, 3), (0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    out = np.empty((10, 10))
    for k, (i, j) in enumerate(pairs):
        unit = np.zeros((4, 4))
        unit[i, j] = unit[j, i] = np.sqrt(2.0) if i == j else 1.0
        out[:, k] = _vector(factor @ unit @ factor.T)
    block = out[4:, 4:]
    spread = np.linalg.norm(block, axis=1)
    correlation, vectors = np.linalg.eigh((block / spread[:, None]) @ (block / spread[:, None]).T)
    # whitening that correlates most with the named quantities (Kessy, Lewin & Strimmer 2018, "ZCA-cor")
    out[4:, 4:] = spread[:, None] * ((vectors * np.sqrt(np.maximum(correlation, 0.0))) @ vectors.T)
    return out


def _vector(change: Array) -> Array:
    """The inertial parameters of a pseudo-inertia; the inverse of `pseudo_inertia`. Shapes (4, 4) -> (10,)."""
    second = change[:3, :3]
    t = np.trace(second) * np.eye(3) - second
    return np.array([change[3, 3], *change[:3, 3], t[0, 0], t[0, 1], t[1, 1], t[0, 2], t[1, 2], t[2, 2]])


# -- words ---------------------------------------------------------------------------------------------------


def _sentence(parameters: Parameters, shares: Array, variance: float, identifiable: bool) -> str:
    groups = sorted(_groups(parameters, shares), key=lambda g: -g[1])
    first, share = groups[0]
    rest = [f"{text} ({100 * s:.0f} %)" for text, s in groups[1:4] if s >= 0.08]
    if share < 0.5:
        what = f"a mix of {_listed([f'{first} ({100 * share:.0f} %)', *rest])}"
    else:
        lead = first if share >= 0.9 else f"mostly {first} ({100 * share:.0f} %)"
        what = lead + (f", with {_listed(rest)}" if rest else "")
    if identifiable:
        return f"{what}; seen to ±{percent(np.sqrt(variance))}"
    if not np.isfinite(variance):
        return f"not seen: {what}; this motion does not excite it at all"
    if variance >= 1.0:
        return f"not seen: {what}; what one would fit is noise (±{percent(np.sqrt(variance))})"
    return f"not seen: {what}; known only to ±{percent(np.sqrt(variance))}"


def percent(share: float) -> str:
    """A share as a percentage with two digits, such as '2.3 %' or '340 %'."""
    value = float(f"{100.0 * share:.2g}")
    return f"{value:g} %" if value < 1e5 else f"{value:.0e} %".replace("e+0", "e").replace("e+", "e")


def _groups(parameters: Parameters, shares: Array) -> list[tuple[str, float]]:
    """What roboticists call the parameters, each with its share: the mass of a link, its centre of mass along x …"""
    out = []
    for i, link in enumerate(parameters.links):
        block = dict(zip(INERTIAL, shares[10 * i : 10 * i + 10], strict=True))
        out.append((f"the mass of {link}", float(block["m"])))
        centre = {axis: float(block[key]) for key, axis in _AXES.items()}
        total = sum(centre.values())
        out.append((f"the centre of mass of {link} along {_leading(centre)}", total))
        moments = {axis: float(block[key]) for key, axis in _ABOUT.items()}
        products = float(block["Ixy"] + block["Ixz"] + block["Iyz"])
        inertia = sum(moments.values()) + products
        kind = "the products of inertia of" if products > 0.6 * inertia else "the inertia of"
        about = f" about {_leading(moments)}" if products <= 0.6 * inertia else ""
        out.append((f"{kind} {link}{about}", inertia))
    start, n = 10 * parameters.bodies, len(parameters.joints)
    for k, kind in enumerate(parameters.drive):
        out += [(f"the {_DRIVE_WORDS[kind]} of {joint}", float(shares[start + k * n + j])) for j, joint in enumerate(parameters.joints)]
    return out


def _leading(shares: Mapping[str, float]) -> str:
    """The axes that matter, the first first: 'x', 'x and z'."""
    total = sum(shares.values())
    order = sorted(shares, key=lambda axis: -shares[axis])
    kept = [axis for k, axis in enumerate(order) if k == 0 or shares[axis] > 0.25 * total]
    return _listed(kept)


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def spoken(name: str, parameters: Parameters) -> str:
    """A parameter's name in words: 'mcx3' is 'm·c along x of wrist_1_link'."""
    index = parameters.names.index(name)
    owner = parameters.owners()[index]
    if index >= 10 * parameters.bodies:
        kind = parameters.drive[(index - 10 * parameters.bodies) // len(parameters.joints)]
        return f"{_DRIVE_WORDS[kind]} of {owner}"
    symbol = INERTIAL[index % 10]
    if symbol == "m":
        return f"mass of {owner}"
    return f"m·c along {_AXES[symbol]} of {owner}" if symbol in _AXES else f"{symbol} of {owner}"


# -- what would help -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Break:
    """A limit that a scenario would break: the largest value over the limit, and where."""

    limit: str
    joint: str
    factor: float


@dataclass(frozen=True)
class Scenario:
    """A change of the experiment and what it would show. eigenvalues: λ, falling. Shape (p,)."""

    name: str
    words: str
    identifiable: int
    eigenvalues: Array
    broken: tuple[Break, ...] = ()


def what_would_help(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    limits: Limits,
    motion: Motion,
    *,
    noise: Array,
    rate: float,
    threshold: float = THRESHOLD,
    given: Array | None = None,
) -> tuple[Scenario, ...]:
    """The motion as it is; recorded for twice the time; its Fourier part run at twice the speed for as long as now.

    Twice the speed is the same path with q̇ doubled, q̈ times four, half the period and twice as many periods: what it
    gains is speed, not time. given: a root of the information of earlier recordings, which counts once in each. Shape (m, P).
    """
    t = motion.grid(rate)
    fourier = motion.segment("fourier")
    inside = (t >= fourier.start) & (t < fourier.end)
    outer = information_root(robot, parameters, motion.samples(t[~inside]), noise)
    earlier = np.zeros((0, parameters.count)) if given is None else given
    inner = [_fourier_root(robot, parameters, motion.fourier.slowed(speed), noise, int(inside.sum())) for speed in (1.0, 2.0)]
    now = np.vstack([outer, inner[0]])
    cases = {"now": now, "time": np.sqrt(2.0) * now, "speed": np.vstack([outer, inner[1]])}
    spectra = {name: _spectrum(np.vstack([root, earlier]), base)[0] for name, root in cases.items()}
    broken: dict[str, tuple[Break, ...]] = {"now": (), "time": (), "speed": _broken(robot, parameters, limits, motion, 2.0)}
    seen = {name: int(np.sum(values * threshold >= 1.0)) for name, values in spectra.items()}
    words = {
        "now": f"{seen['now']} of {base.count} directions are identifiable",
        "time": _gain(seen["time"] - seen["now"], "Twice the recording time"),
        "speed": _gain(seen["speed"] - seen["now"], "Twice the speed") + _break_words(broken["speed"]),
    }
    return tuple(Scenario(name, words[name], seen[name], spectra[name], broken[name]) for name in cases)


def _gain(more: int, what: str) -> str:
    if more == 0:
        return f"{what} would make no further direction identifiable"
    return f"{what} would make {abs(more)} {'more' if more > 0 else 'fewer'} direction{'s' * (abs(more) != 1)} identifiable"


def _break_words(broken: tuple[Break, ...]) -> str:
    if not broken:
        return ", and no limit would break"
    return ", but would break " + _listed([f"the {b.limit} limit of {b.joint} ({b.factor:.2g} times)" for b in broken])


def _fourier_root(robot: Robot, parameters: Parameters, series: Fourier, noise: Array, rows: int) -> Array:
    """Root of what `rows` samples of a periodic motion tell; one period is computed and counted as often as it fits."""
    count = int(np.clip(rows, 1, 300))
    root = information_root(robot, parameters, series.samples(series.grid(count)), noise)
    out: Array = np.sqrt(rows / count) * root
    return out


def _broken(robot: Robot, parameters: Parameters, limits: Limits, motion: Motion, speed: float) -> tuple[Break, ...]:
    """For each kind of limit the joint that would exceed it most, if any would."""
    series = motion.fourier.slowed(speed)
    t = series.grid(300)
    samples = series.samples(t)
    torque = regressor(robot, parameters, samples) @ parameters.nominal
    values = {"velocity": samples.dq, "acceleration": samples.ddq, "jerk": series.at(t, 3), "torque": torque}
    out = []
    for kind, array in values.items():
        # a derived limit binds the ramps only, not the excitation
        stated = [source != DERIVED for source in limits.sources.get(kind, ("",) * robot.n)]
        ratio = np.where(stated, np.abs(array).max(axis=0) / getattr(limits, kind), 0.0)
        worst = int(np.argmax(ratio))
        if ratio[worst] > 1.0:
            out.append(Break(kind, robot.joints[worst], float(ratio[worst])))
    if not any(b.limit == "velocity" for b in out):
        out += _braking(limits, samples)
    return tuple(out)


def _braking(limits: Limits, samples: Samples) -> list[Break]:
    """Velocity limits that fall towards a stop."""
    worst = Break("velocity", "", 1.0)
    for j, brake in enumerate(limits.braking):
        if brake is None:
            continue
        for sign, stop in ((1.0, brake.stop[1]), (-1.0, brake.stop[0])):
            distance = np.maximum(sign * (stop - samples.q[:, j]), 0.0)
            allowed = np.maximum(np.sqrt(brake.rate * distance) - brake.offset, 1e-6)
            factor = float(np.max(sign * samples.dq[:, j] / allowed))
            if factor > worst.factor:
                worst = Break("velocity", limits.joints[j], factor)
    return [worst] if worst.joint else []
