"""Decisions between effects that an earlier diagnosis could not tell apart."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..schemas.diagnosis import DiagnosisDocument
from . import rival_evidence
from .diagnosis import Diagnosis
from .rival_evidence import DECIDED_LOG_ODDS

Pair = tuple[str | None, str, str]
"""Joint, effect and rival."""


@dataclass(frozen=True)
class Decision:
    """Log odds of an effect over its rival at a joint, of which one acts [nat].

    Attributes:
        before: Log odds by the earlier recordings; None where the earlier diagnosis has none.
        expected: Log odds that were expected after the discriminating recording, if the effect acts
            and if the rival does; None where no design is given.
        after: Log odds by all recordings.
    """

    joint: str | None
    effect: str
    rival: str
    before: float | None
    expected: tuple[float, float] | None
    after: float

    @property
    def decided_for(self) -> str | None:
        """Name of the effect that is decided for; None while the pair is open."""
        if abs(self.after) < DECIDED_LOG_ODDS:
            return None
        return self.effect if self.after > 0.0 else self.rival

    def document(self) -> dict[str, Any]:
        """Return the element of "decisions" in `diagnosis.json`."""
        return {
            "joint": self.joint,
            "effect": self.effect,
            "rival": self.rival,
            "log_odds": {
                "before": self.before,
                "expected": None
                if self.expected is None
                else {"effect": self.expected[0], "rival": self.expected[1]},
                "after": self.after,
            },
            "decided_for": self.decided_for,
        }


@dataclass(frozen=True)
class ExpectedEvidence:
    """Evidence that a design expects of its recording.

    Attributes:
        log_bayes_factors: By joint, acting effect and rival: that of the effect over the rival.
        with_given: True if it contains the evidence of the earlier recordings.
    """

    log_bayes_factors: Mapping[Pair, float]
    with_given: bool

    @classmethod
    def of_design(cls, design: Mapping[str, Any]) -> ExpectedEvidence | None:
        """Read it from the `design` of a `trajectory.json`; None where there is none."""
        entry = design.get("discrimination")
        if not isinstance(entry, Mapping):
            return None
        return cls(
            {
                (c["joint"], c["effect"], c["rival"]): float(c["log_bayes_factor"])
                for c in entry.get("comparisons", ())
                if c["rival"] is not None
            },
            bool(entry.get("with_given")),
        )

    def log_odds(self, pair: Pair, before: float | None) -> tuple[float, float] | None:
        """Return the log odds after the recording if the effect acts, and if the rival does.

        Log odds `before` by the earlier recordings that are None count as even.
        """
        joint, effect, rival = pair
        if not {pair, (joint, rival, effect)} <= set(self.log_bayes_factors):
            return None
        start = 0.0 if self.with_given or before is None else before
        gains = (self.log_bayes_factors[pair], -self.log_bayes_factors[joint, rival, effect])
        first, second = (start + rival_evidence.log_odds(gain) for gain in gains)
        return first, second


@dataclass(frozen=True)
class Decisions:
    """Decisions of all recordings on the classes of an earlier diagnosis.

    Attributes:
        pairs: Each finding of the earlier diagnosis against each of its rivals.
        classes: Log evidence of the members of each class, with the name of its joint.
    """

    pairs: tuple[Decision, ...]
    classes: tuple[tuple[str | None, Mapping[str, float]], ...]

    def excluded(self, joint: str | None, effect: str, names: Iterable[str]) -> set[str]:
        """Return those names that are excluded in favour of an effect."""
        return {
            name
            for name in names
            for place, evidence in self.classes
            if place == joint
            and {effect, name} <= set(evidence)
            and rival_evidence.log_odds(evidence[effect] - evidence[name]) >= DECIDED_LOG_ODDS
        }


def decide(
    earlier: DiagnosisDocument,
    diagnosis: Diagnosis,
    expected: Sequence[ExpectedEvidence] = (),
) -> Decisions:
    """Compare the members of each class of an earlier diagnosis by all recordings."""
    joints = diagnosis.identified.model.robot.joints
    pairs, classes = [], []
    for finding in earlier.findings:
        before = {rival.effect: rival.log_odds for rival in finding.rivals}
        names = tuple(dict.fromkeys((finding.effect, *finding.equivalents, *before)))
        if len(names) < 2:
            continue
        joint = None if finding.joint is None else joints.index(finding.joint)
        evidence = rival_evidence.compare(diagnosis.model, diagnosis.effects, joint, names)
        classes.append((finding.joint, evidence))
        for rival in names[1:]:
            pair = finding.joint, finding.effect, rival
            odds = (design.log_odds(pair, before.get(rival)) for design in expected)
            factor = evidence[finding.effect] - evidence[rival]
            pairs.append(
                Decision(
                    *pair,
                    before=before.get(rival),
                    expected=next((entry for entry in odds if entry is not None), None),
                    after=rival_evidence.log_odds(factor),
                )
            )
    return Decisions(tuple(pairs), tuple(classes))
