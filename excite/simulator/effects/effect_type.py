"""A kind of hidden effect: its parameters, their units and usual sizes, and the forms of its law."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ..actuator import Drive
from ..physical_effect import Instant, Law

Array = np.ndarray
FAMILIES = ("tuning", "scored")
"""Two families of forms: nothing tuned on the one has seen the other."""
WIDTH = 4e-3
"""Speed over which a sign is smooth [rad/s]."""


@dataclass(frozen=True)
class Quantity:
    """A parameter. low, high: its usual size, times `of` at the joint: 1, torque limit, torque/speed, torque/speed², 1/speed….

    power: how it grows with the size of the effect: 1 for an amplitude, −1 for a stiffness, 0 for what is only shape;
    about: value of an effect of size 0, when that is not 0. stated: whether the contract names it. most: what physics allows of it, of
    either sign: friction that falls as it warms never pushes, a motor that saturates never brakes. within: the joint's own friction,
    "viscous" or "coulomb", of which it takes away no more than there is.
    """

    name: str
    unit: str
    low: float
    high: float
    of: str = "1"
    power: float = 1.0
    about: float = 0.0
    stated: bool = True
    most: float = np.inf
    within: str = ""

    def range(self, torque: float, speed: float) -> tuple[float, float]:
        """Usual size at a joint of these limits [N m, rad/s]."""
        by = {
            "1": 1.0,
            "torque": torque,
            "viscous": torque / speed,
            "square": torque / speed**2,
            "speed": speed,
            "inertia": torque / 150.0,
        }[self.of]
        return self.low * by, self.high * by

    def middle(self, torque: float, speed: float) -> float:
        """What it is when nobody says: the mean of the range, or half its end for a size of either sign."""
        low, high = self.range(torque, speed)
        if low > 0.0:
            return float(np.sqrt(low * high))
        return 0.5 * (low + high) if self.power == 0.0 or low + high != 0.0 else 0.5 * high

    def draw(self, torque: float, speed: float, rng: np.random.Generator) -> float:
        """A random size; evenly in the logarithm where all are positive."""
        low, high = self.range(torque, speed)
        return (
            float(np.exp(rng.uniform(np.log(low), np.log(high))))
            if low > 0.0
            else float(rng.uniform(low, high))
        )

    def room(self, value: float, site: Site) -> float:
        """How many times as large an effect of this value may be made at the most, where it sits."""
        size = abs(value - self.about)
        most = float(getattr(site.drive, self.within)[site.j]) if self.within else self.most
        return float((most / size) ** (1.0 / self.power)) if np.isfinite(most) and size else np.inf

    def accepts(self, value: float) -> bool:
        """Whether a value is finite and of a sign that the quantity can have.

        An amplitude may be 0; a shape, such as the velocity over which friction falls, may not.
        """
        if not np.isfinite(value) or self.low <= 0.0:
            return bool(np.isfinite(value))
        return value > 0.0 or (value == 0.0 and self.power > 0.0)

    def sized(self, value: float, size: float) -> float:
        """The parameter of the effect made `size` > 0 times as large."""
        return value if self.power == 0.0 else self.about + (value - self.about) * size**self.power


@dataclass(frozen=True)
class Site:
    """Where an effect sits: joint number j of n, the joint it comes from (coupling), limits and drives of the robot, name of the link.

    torque, speed: Shape (n,).
    """

    n: int
    j: int
    source: int
    torque: Array
    speed: Array
    drive: Drive
    joint: str
    link: str


Form = Callable[[Site, Mapping[str, float]], Law]
Meaning = Callable[[Mapping[str, float]], Mapping[str, float]]
"""From a law's parameters to those whose number is another one in the contract's words."""


@dataclass(frozen=True)
class Kind:
    """One name of the contract's list, or an outsider. forms: one per family. place: "joint", "robot" or "either".

    vanishes: an effect of size 0 has no finite parameters (a rigid spring), so it is left out. meant: by family, where the contract's
    words mean another number than the law's parameter of that name.
    """

    name: str
    quantities: tuple[Quantity, ...]
    forms: Mapping[str, Form]
    place: str = "joint"
    outsider: bool = False
    vanishes: bool = False
    meant: Mapping[str, Meaning] = field(default_factory=dict)

    def quantity(self, name: str) -> Quantity:
        return next(q for q in self.quantities if q.name == name)


@dataclass(frozen=True)
class Curve(Law):
    """A torque at one joint that depends on the present alone. law: Instant of the joint (arrays of shape (…)) to torque."""

    n: int
    j: int
    law: Callable[[Instant], Array]

    def torque(self, x: Instant, z: Array) -> Array:
        return put(self.n, self.j, self.law(one(x, self.j)))


def one(x: Instant, j: int) -> Instant:
    """The instant of one joint."""
    return Instant(x.t, x.q[..., j], x.v[..., j], x.a[..., j], x.load[..., j])


def put(n: int, j: int, torque: Array) -> Array:
    """Torque at joint j, none elsewhere. Shape (…) -> (…, n)."""
    out = np.zeros((*np.shape(torque), n))
    out[..., j] = torque
    return out


def curve(site: Site, law: Callable[[Instant], Array]) -> Law:
    return Curve(site.n, site.j, law)


def sign(v: Array) -> Array:
    """A sign smooth over a few mrad/s, of another shape than the base's: v/√(v² + w²)."""
    return v / np.sqrt(v * v + WIDTH**2)


def angle(name: str = "phase") -> Quantity:
    """A phase: shape, not size."""
    return Quantity(name, "rad", -np.pi, np.pi, power=0.0, stated=False)
