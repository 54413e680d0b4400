"""The plan of a trial: which case hides which effects, drawn from one seed.

Only the process that generates the cases and the ground truth know it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeVar

import numpy as np

from excite.simulator.effects import CATALOGUE_NAMES, EFFECT_TYPES, OUT_OF_CATALOGUE_NAMES

T = TypeVar("T")
GROUPS = {"sparse": 0.3, "dense": 0.25, "half_dense": 0.15, "null": 0.2, "out_of_catalogue": 0.1}
"""Groups of cases and their usual shares of a plan [1].

- sparse: one or two effects in an otherwise perfect robot.
- dense: every friction at every joint, and in half of the cases one special effect.
- half_dense: each friction at each joint with probability ½, which tests attribution.
- null: nothing is hidden.
- out_of_catalogue: an effect that the contract has no name for.
"""
SPARSE_ROBOTS = ("two_link", "tx40", "ur10e", "panda")
"""Built-in robots of the cases with one training recording."""
DENSE_ROBOTS = ("ur10e", "iiwa14", "ur5e", "panda", "tx40", "fr3")
"""Built-in robots of the cases with two training recordings."""
SEVERITIES = (1.0, 3.0, 10.0, 30.0)
"""Severities that the effects are scaled to [1]; see `excite.simulator.severity`."""
SPECIAL_SEVERITIES = (3.0, 10.0)
"""Severities of the special effect of a dense robot beyond its frictions [1]."""
NUISANCES = (
    "none",
    "coarse_encoder",
    "heavy_noise",
    "coloured_noise",
    "jitter",
    "poor_excitation",
    "changed_gains",
    "changed_session",
    "rounded_angles",
)
"""Conditions that make a recording harder than the best of a laboratory.

With `changed_session`, friction differs between the training and the validation recording; with
`rounded_angles`, the analyst's URDF states its angles with four decimals.
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
SPECIAL_EFFECTS = (
    "elasticity",
    "backlash",
    "base_compliance",
    "spring",
    "coupling",
    "position_friction",
    "torque_saturation",
    "encoder_error",
    "asymmetric_viscous",
    "drag",
    "contact",
    "thermal_drift",
)
"""Effects of which a dense robot may have one in addition to its frictions."""
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
PAIR_SHARE = 0.25
"""Share of sparse cases that hide two effects [1]."""
PRIOR_SHARE = 0.2
"""Share of sparse cases, and of nulls with one training recording, with a trusted prior [1]."""
CONFUSABLE_SHARE = 0.6
"""Share of pairs that are drawn from `CONFUSABLE_PAIRS` [1]."""
SPECIAL_SHARE = 0.5
"""Share of dense cases with a special effect [1]."""


@dataclass(frozen=True)
class CaseSpec:
    """Specification of a case.

    The fields are the keys of `spec` in the ground truth of a case.

    Attributes:
        number: Number of the case.
        name: Random name of its folder.
        robot: Built-in robot.
        category: "null", "single", "pair", "out_of_catalogue", "dense" or "half_dense".
        trusted: Whether a trusted prior comes with it.
        names: Names of the hidden effects; of a dense robot, of its special effect only.
        severities: Severity of each [1].
        nuisance: One of `NUISANCES`.
        family: Family of the model forms.
        seed: Seed of all other draws.
        training: Number of training recordings.
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
    training: int = 1

    @property
    def is_dense(self) -> bool:
        """True if the robot has frictions beyond the named effects."""
        return self.category in ("dense", "half_dense")


def out_of_catalogue_names(family: str) -> tuple[str, ...]:
    """Return the effects outside the catalogue that cases of a family may hide."""
    return tuple(name for name in OUT_OF_CATALOGUE_NAMES if family in EFFECT_TYPES[name].forms)


@dataclass(frozen=True)
class CasePlan:
    """Cases of one family of model forms, drawn from one seed.

    Attributes:
        count: Number of cases.
        seed: Seed of the draw.
        family: "tuning" or "scored".
        groups: Groups of cases to draw, in their usual proportions.
    """

    count: int
    seed: int
    family: str
    groups: tuple[str, ...] = tuple(GROUPS)

    def specs(self) -> list[CaseSpec]:
        """Return all cases, in random order."""
        # the family is part of the seed, so that the two families share no draw for equal seeds
        rng = np.random.default_rng([self.seed, 0 if self.family == "tuning" else 1])
        categories = self._categories()
        rng.shuffle(categories)
        tags = rng.choice(16**6, self.count, replace=False)
        draws: dict[str, Iterator[tuple[str, ...]]] = {
            "single": _permutations([(name,) for name in REFIT_EFFECTS], rng),
            "prior": _permutations([(name,) for name in PRIOR_ONLY_EFFECTS], rng),
            "special": _permutations([(name,) for name in SPECIAL_EFFECTS], rng),
            "unnamed": _permutations(
                [(name,) for name in out_of_catalogue_names(self.family)], rng
            ),
            "confusable": _permutations(CONFUSABLE_PAIRS, rng),
            "pair": _permutations(
                [
                    pair
                    for pair in combinations(REFIT_EFFECTS, 2)
                    if set(pair) != {"elasticity", "backlash"}
                ],
                rng,
            ),
        }
        levels = {
            is_dense: _permutations(SPECIAL_SEVERITIES if is_dense else SEVERITIES, rng)
            for is_dense in (True, False)
        }
        nuisances = {is_null: _permutations(NUISANCES, rng) for is_null in (True, False)}
        robots = {
            (category, training): _permutations(
                SPARSE_ROBOTS if training == 1 else DENSE_ROBOTS, rng
            )
            for category in ("null", "single", "pair", "out_of_catalogue", "dense", "half_dense")
            for training in (1, 2)
        }
        specs = []
        for number, (category, kind, trusted, training) in enumerate(categories):
            is_dense = category in ("dense", "half_dense")
            is_confusable = kind == "pair" and rng.random() < CONFUSABLE_SHARE
            names = next(draws["confusable" if is_confusable else kind]) if kind else ()
            severities = (next(levels[is_dense]),) * len(names) if names else ()
            nuisance = "none" if is_dense else next(nuisances[category == "null"])
            seed = int(rng.integers(2**31))
            specs.append(
                CaseSpec(
                    number,
                    f"{tags[number]:06x}",
                    next(robots[category, training]),
                    category,
                    trusted,
                    names,
                    severities,
                    nuisance,
                    self.family,
                    seed,
                    training,
                )
            )
        return specs

    def _categories(self) -> list[tuple[str, str, bool, int]]:
        """Return category, kind of named effect, prior and training recordings of every case."""
        shares = np.array([GROUPS[group] for group in self.groups])
        ends = np.round(np.cumsum(shares) / shares.sum() * self.count).astype(int)
        counts = dict(zip(self.groups, np.diff(ends, prepend=0).tolist(), strict=True))
        sparse, dense, half_dense, null, unnamed = (counts.get(group, 0) for group in GROUPS)
        pair, prior = round(PAIR_SHARE * sparse), round(PRIOR_SHARE * sparse)
        special = round(SPECIAL_SHARE * dense)
        null_once = null // 2
        null_prior = round(PRIOR_SHARE * null_once)
        return [
            *[("pair", "pair", False, 1)] * pair,
            *[("single", "prior", True, 1)] * prior,
            *[("single", "single", False, 1)] * (sparse - pair - prior),
            *[("dense", "special", False, 2)] * special,
            *[("dense", "", False, 2)] * (dense - special),
            *[("half_dense", "", False, 2)] * half_dense,
            *[("null", "", True, 1)] * null_prior,
            *[("null", "", False, 1)] * (null_once - null_prior),
            *[("null", "", False, 2)] * (null - null_once),
            *[("out_of_catalogue", "unnamed", False, 1)] * unnamed,
        ]


def _permutations(items: Sequence[T], rng: np.random.Generator) -> Iterator[T]:
    """Yield random permutations of the items for ever, so that all occur equally often."""
    while True:
        for i in rng.permutation(len(items)):
            yield items[i]
