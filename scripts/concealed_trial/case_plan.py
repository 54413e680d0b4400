"""The plan of a trial: which case hides which effects, drawn from one seed.

Only the process that generates the cases and the ground truth know it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeVar

import numpy as np

from excite.simulator.effects import CATALOGUE_NAMES, OUT_OF_CATALOGUE_NAMES

T = TypeVar("T")
ROBOTS = ("two_link", "tx40", "ur10e", "panda")
"""Built-in robots of the cases."""
SEVERITIES = (1.0, 3.0, 10.0, 30.0)
"""Severities that the effects are scaled to [1]; see `excite.simulator.severity`."""
NUISANCES = (
    "none",
    "coarse_encoder",
    "heavy_noise",
    "coloured_noise",
    "jitter",
    "poor_excitation",
    "changed_gains",
    "changed_session",
)
"""Conditions that make a recording harder than the best of a laboratory.

With `changed_session`, friction differs between the training and the validation recording.
"""
PRIOR_ONLY_EFFECTS = (
    "payload",
    "gravity_tilt",
    "rotor_inertia",
    "torque_offset",
    "friction",
    "torque_gain",
    "kinematic_error",
)
"""Effects that a refit of the base model absorbs; they are hidden where a prior is trusted."""
REFIT_EFFECTS = tuple(name for name in CATALOGUE_NAMES if name not in PRIOR_ONLY_EFFECTS)
"""Effects that show beyond a refit of the base model."""
CONFUSABLE_PAIRS = (
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
"""Pairs of effects with similar torques."""
NULL_SHARE = 0.2
"""Share of cases that hide nothing [1]."""
PAIR_SHARE = 0.15
"""Share of cases that hide two effects [1]."""
OUT_OF_CATALOGUE_SHARE = 0.1
"""Share of cases that hide an effect outside the catalogue [1]."""
PRIOR_SHARE = 0.2
"""Share of cases with a trusted prior [1], the same whether something is hidden or not."""
CONFUSABLE_SHARE = 0.6
"""Share of pairs that are drawn from `CONFUSABLE_PAIRS` [1]."""


@dataclass(frozen=True)
class CaseSpec:
    """Specification of a case.

    The fields are the keys of `spec` in the ground truth of a case.

    Attributes:
        number: Number of the case.
        name: Random name of its folder.
        robot: Built-in robot.
        category: "null", "single", "pair" or "out_of_catalogue".
        trusted: Whether a trusted prior comes with it.
        names: Names of the hidden effects.
        severities: Severity of each [1].
        nuisance: One of `NUISANCES`.
        family: Family of the model forms.
        seed: Seed of all other draws.
    """

    number: int
    name: str
    robot: str
    category: str
    trusted: bool
    names: tuple[str, ...]
    severities: tuple[float, ...]
    nuisance: str
    family: str
    seed: int


@dataclass(frozen=True)
class CasePlan:
    """Cases of one family of model forms, drawn from one seed.

    Attributes:
        count: Number of cases.
        seed: Seed of the draw.
        family: "tuning" or "scored".
        robots: Robots to choose from.
    """

    count: int
    seed: int
    family: str
    robots: tuple[str, ...] = ROBOTS

    def specs(self) -> list[CaseSpec]:
        """Return all cases, in random order."""
        # the family is part of the seed, so that the two families share no draw for equal seeds
        rng = np.random.default_rng([self.seed, 0 if self.family == "tuning" else 1])
        categories = self._categories()
        rng.shuffle(categories)
        tags = rng.choice(16**6, self.count, replace=False)
        singles = _permutations(REFIT_EFFECTS, rng)
        with_prior = _permutations(PRIOR_ONLY_EFFECTS, rng)
        pairs = _permutations(CONFUSABLE_PAIRS, rng)
        unnamed = _permutations(OUT_OF_CATALOGUE_NAMES, rng)
        any_pairs = _permutations(
            [
                pair
                for pair in combinations(REFIT_EFFECTS, 2)
                if set(pair) != {"elasticity", "backlash"}
            ],
            rng,
        )
        levels = _permutations(SEVERITIES, rng)
        nuisances = {is_null: _permutations(NUISANCES, rng) for is_null in (True, False)}
        robots = {
            category: _permutations(self.robots, rng)
            for category in ("null", "single", "pair", "out_of_catalogue")
        }
        specs = []
        for number, (category, trusted) in enumerate(categories):
            names: tuple[str, ...] = ()
            if category == "single":
                names = (next(with_prior if trusted else singles),)
            elif category == "pair":
                names = next(pairs) if rng.random() < CONFUSABLE_SHARE else next(any_pairs)
            elif category == "out_of_catalogue":
                names = (next(unnamed),)
            level = next(levels)
            severities = () if not names else (level,) * len(names)
            nuisance = next(nuisances[category == "null"])
            seed = int(rng.integers(2**31))
            specs.append(
                CaseSpec(
                    number,
                    f"{tags[number]:06x}",
                    next(robots[category]),
                    category,
                    trusted,
                    names,
                    severities,
                    nuisance,
                    self.family,
                    seed,
                )
            )
        return specs

    def _categories(self) -> list[tuple[str, bool]]:
        """Return category and prior of every case."""
        null = round(NULL_SHARE * self.count)
        pair = round(PAIR_SHARE * self.count)
        unnamed = round(OUT_OF_CATALOGUE_SHARE * self.count)
        single = self.count - null - pair - unnamed
        null_with_prior = round(PRIOR_SHARE * null)
        with_prior = round(PRIOR_SHARE * (self.count - null))
        return [
            *[("null", False)] * (null - null_with_prior),
            *[("null", True)] * null_with_prior,
            *[("pair", False)] * pair,
            *[("out_of_catalogue", False)] * unnamed,
            *[("single", True)] * min(with_prior, single),
            *[("single", False)] * max(single - with_prior, 0),
        ]


def _permutations(items: Sequence[T], rng: np.random.Generator) -> Iterator[T]:
    """Yield random permutations of the items for ever, so that all occur equally often."""
    while True:
        for i in rng.permutation(len(items)):
            yield items[i]
