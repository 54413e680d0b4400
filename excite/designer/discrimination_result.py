"""Result of a design that discriminates: explanations, expected log-odds, menu of experiments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import FloatArray
from ..schemas.effects import effect_words
from .discrimination import Comparison, Explanation
from .effect_columns import LINEARISED
from .experiment_menu import DECISIVE_LOG_ODDS, Experiment, recommended

CONFIRMATION_REMARK = "no explanation has a rival: a recording can only confirm what is found"
"""Remark where a diagnosis leaves no class of several names."""


@dataclass(frozen=True)
class DiscriminationResult:
    """Decisions expected of the recording of a discriminating motion.

    Attributes:
        source: The diagnosis.
        joints: Names of the robot's joints.
        explanations: The competing explanations.
        comparisons: The comparisons that a motion can decide.
        undecidable: The comparisons that no motion decides.
        omitted: Effects of the diagnosis that have no columns, and why.
        reference: Expected log-odds of each comparison after a D-optimal motion. Shape (c,) [nat].
        designed: The same after the designed motion. Shape (c,) [nat].
        menu: Experiments and what they would decide.
        with_given: True if all log-odds contain the recordings that were given.
    """

    source: str
    joints: tuple[str, ...]
    explanations: tuple[Explanation, ...]
    comparisons: tuple[Comparison, ...]
    undecidable: tuple[Comparison, ...]
    omitted: tuple[str, ...]
    reference: FloatArray
    designed: FloatArray
    menu: tuple[Experiment, ...]
    with_given: bool = False

    @property
    def recommendation(self) -> Experiment:
        """The cheapest experiment that decides, or else the one that decides most."""
        return recommended(self.menu)

    def name_of(self, index: int | None) -> str:
        """Return the name of an explanation, with its joint; None is no effect at all."""
        if index is None:
            return "no effect"
        form = self.explanations[index].form
        effect = effect_words(form.effect)
        return effect if form.joint is None else f"{effect} at {self.joints[form.joint]}"

    def question_of(self, comparison: Comparison) -> str:
        """Return a comparison in words."""
        return f"{self.name_of(comparison.true)} against {self.name_of(comparison.rival)}"

    @property
    def linearised(self) -> dict[str, str]:
        """How the nonlinear form of each effect became columns."""
        effects = dict.fromkeys(e.form.effect for e in self.explanations)
        return {effect: LINEARISED[effect] for effect in effects if effect in LINEARISED}

    @property
    def is_confirmation(self) -> bool:
        """True if no explanation has a rival, so that the motion can only confirm them."""
        return all(comparison.rival is None for comparison in self.comparisons)

    def summary(self) -> str:
        """Return one line: the smallest expected log-odds, and the recommendation."""
        least = int(np.argmin(self.designed))
        question = self.question_of(self.comparisons[least])
        return (
            f"least expected log-odds {self.designed[least]:.1f} ({question}; D-optimal: "
            f"{self.reference[least]:.1f}); recommended: {self.recommendation.name}"
            + (f"; {CONFIRMATION_REMARK}" if self.is_confirmation else "")
        )

    def _names_of(self, comparison: Comparison) -> dict[str, Any]:
        """Return a comparison by effect, joint and rival."""
        true = self.explanations[comparison.true].form
        rival = None if comparison.rival is None else self.explanations[comparison.rival].form
        return {
            "effect": true.effect,
            "joint": None if true.joint is None else self.joints[true.joint],
            "rival": None if rival is None else rival.effect,
        }

    def expected_evidence(self) -> dict[str, Any]:
        """Return the `discrimination` entry in the `design` of `trajectory.json`."""
        return {
            "with_given": self.with_given,
            "comparisons": [
                {**self._names_of(comparison), "log_bayes_factor": value}
                for comparison, value in zip(self.comparisons, self.designed.tolist(), strict=True)
            ],
        }

    def document(self) -> dict[str, Any]:
        """Return the `discrimination` entry of `excite design --json`."""

        def pair(comparison: Comparison) -> dict[str, Any]:
            return {**self._names_of(comparison), "weight": comparison.weight}

        odds = zip(self.comparisons, self.reference.tolist(), self.designed.tolist(), strict=True)
        return {
            "source": self.source,
            "decisive_log_odds": DECISIVE_LOG_ODDS,
            "comparisons": [
                {**pair(c), "log_odds": {"d_optimal": before, "designed": after}}
                for c, before, after in odds
            ],
            "undecidable": [pair(c) for c in self.undecidable],
            "omitted": list(self.omitted),
            "linearised": self.linearised,
            "usual_size": sorted({e.form.effect for e in self.explanations if e.nominal}),
            "menu": [
                {
                    "experiment": e.name,
                    "seconds": e.seconds,
                    "log_odds": None if e.log_odds is None else e.log_odds.tolist(),
                    "decides": e.decides,
                    "obstacle": e.obstacle or None,
                }
                for e in self.menu
            ],
            "recommended": self.recommendation.name,
        }
