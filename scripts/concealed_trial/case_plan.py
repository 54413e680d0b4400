"""What is hidden in which case: drawn from one seed, known to the process that conceals and to the key, to nobody else."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeVar

import numpy as np

from excite.simulator.effects import CATALOGUE, OUTSIDERS

T = TypeVar("T")
ROBOTS = ("two_link", "tx40", "ur10e", "panda")
SEVERITIES = (1.0, 3.0, 10.0, 30.0)
TRAPS = (
    "none",
    "coarse_encoder",
    "heavy_noise",
    "coloured_noise",
    "jitter",
    "poor_excitation",
    "changed_gains",
    "another_day",
)
"""What makes recordings harder than a laboratory's best; on another day friction is another by the second recording."""
PRIOR_ONLY = (
    "payload",
    "gravity_tilt",
    "rotor_inertia",
    "torque_offset",
    "friction",
    "torque_gain",
    "kinematic_error",
)
"""What a refit of the base model absorbs (the contract): hidden where the prior is trusted."""
REFIT = tuple(name for name in CATALOGUE if name not in PRIOR_ONLY)
CONFUSABLE = (
    ("delay", "hysteresis"),
    ("load_friction", "position_friction"),
    ("stribeck", "nonlinear_viscous"),
    ("elasticity", "delay"),
    ("backlash", "hysteresis"),
    ("torque_ripple", "encoder_error"),
    ("coupling", "load_friction"),
    ("thermal_drift", "asymmetric_viscous"),
    ("stribeck", "delay"),
    ("torque_saturation", "load_friction"),
)


@dataclass(frozen=True)
class Spec:
    """One case. sort: null, single, pair or outsider. names, severities: of its effects. trusted: a prior comes with it."""

    number: int
    name: str
    robot: str
    sort: str
    trusted: bool
    names: tuple[str, ...]
    severities: tuple[float, ...]
    trap: str
    family: str
    seed: int


@dataclass(frozen=True)
class Plan:
    """count cases of one family of forms, from one seed; a fifth of them nulls, and a fifth with a trusted prior."""

    count: int
    seed: int
    family: str
    robots: tuple[str, ...] = ROBOTS

    def specs(self) -> list[Spec]:
        """All cases, in an order that says nothing."""
        # the family is in the seed: tuning and scored cases share no draw even where the number is the same
        rng = np.random.default_rng([self.seed, 0 if self.family == "tuning" else 1])
        sorts = self._sorts()
        rng.shuffle(sorts)
        tags = rng.choice(16**6, self.count, replace=False)
        singles = _rounds(REFIT, rng)
        with_prior = _rounds(PRIOR_ONLY, rng)
        pairs, odd = _rounds(CONFUSABLE, rng), _rounds(OUTSIDERS, rng)
        mixed = _rounds(
            [pair for pair in combinations(REFIT, 2) if set(pair) != {"elasticity", "backlash"}],
            rng,
        )
        levels = _rounds(SEVERITIES, rng)
        traps = {True: _rounds(TRAPS, rng), False: _rounds(TRAPS, rng)}
        robots = {
            sort: _rounds(self.robots, rng) for sort in ("null", "single", "pair", "outsider")
        }
        out = []
        for number, (sort, trusted) in enumerate(sorts):
            names: tuple[str, ...] = ()
            if sort == "single":
                names = (next(with_prior if trusted else singles),)
            elif sort == "pair":
                names = next(pairs) if rng.random() < 0.6 else next(mixed)
            elif sort == "outsider":
                names = (next(odd),)
            level = next(levels)
            severities = () if not names else (level,) * len(names)
            trap = next(traps[sort == "null"])
            seed = int(rng.integers(2**31))
            out.append(
                Spec(
                    number,
                    f"{tags[number]:06x}",
                    next(robots[sort]),
                    sort,
                    trusted,
                    names,
                    severities,
                    trap,
                    self.family,
                    seed,
                )
            )
        return out

    def _sorts(self) -> list[tuple[str, bool]]:
        """Sort and prior of every case; the share of priors is the same among nulls and among the rest."""
        null, pair, odd = round(0.2 * self.count), round(0.15 * self.count), round(0.1 * self.count)
        rest = self.count - null - pair - odd
        out = [("null", False)] * (null - round(0.2 * null)) + [("null", True)] * round(0.2 * null)
        prior = round(0.2 * (self.count - null))
        out += [("pair", False)] * pair + [("outsider", False)] * odd
        return (
            out + [("single", True)] * min(prior, rest) + [("single", False)] * max(rest - prior, 0)
        )


def _rounds(items: Sequence[T], rng: np.random.Generator) -> Iterator[T]:
    """Each item once in random order, then again: no name is left to luck."""
    while True:
        for i in rng.permutation(len(items)):
            yield items[i]
