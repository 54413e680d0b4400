"""Torque budget of each joint in words: its held-out error, and what each effect removes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..diagnosis.diagnosis import EXPLAINED_RMSE_RATIO
from ..robot.robot import Robot
from .formatting import significant, value_with_error

MIN_SHARE = 0.03
"""Share of the removed error from which an effect is named; smaller ones are summed. An error that
falls by less counts as unchanged."""
MAX_RELATIVE_CHANGE = 2.0
"""Relative change between recordings up to which it is stated."""
NAMED_OTHERS = 0.01
"""Share of all small effects together from which they are mentioned."""
MAIN_SHARE = 0.6
"""Share of the removed error from which it is mostly due to one effect."""
_WORDS = {
    "asymmetric_viscous": "viscous friction that differs by direction",
    "drag": "drag (square of speed)",
    "friction": "Coulomb and viscous friction",
    "hysteresis": "presliding hysteresis",
    "nonlinear_viscous": "nonlinear viscous friction",
    "position_friction": "friction that depends on position",
    "stribeck": "Stribeck friction",
    "torque_gain": "torque scale error",
}


def effect_words(effect: str) -> str:
    """Return the name of an effect in a sentence."""
    return _WORDS.get(effect, effect.replace("_", " "))


@dataclass(frozen=True)
class BudgetPart:
    """An effect in the budget of a joint.

    Attributes:
        effect: Its name.
        share: Share of the removed error [1].
        std: Its standard deviation [1].
        is_certain: False if the saved model has the effect but it is not among the findings.
    """

    effect: str
    share: float
    std: float
    is_certain: bool


@dataclass(frozen=True)
class JointBudget:
    """Held-out RMSE of a joint with the base model and with the saved model.

    Attributes:
        joint: Name of the joint.
        unit: Unit of its torque.
        before: RMSE of the base model.
        after: RMSE of the saved model.
        floor: Noise floor.
        parts: Effects that remove at least `MIN_SHARE` of before − after, the largest first.
        others: Share of all other effects together [1].
        is_withheld: Whether findings are withheld, so that the saved model is the base model.
    """

    joint: str
    unit: str
    before: float
    after: float
    floor: float
    parts: tuple[BudgetPart, ...]
    others: float
    is_withheld: bool

    @property
    def is_improved(self) -> bool:
        """True if the effects reduce the error notably."""
        return bool(self.parts) and self.before - self.after > MIN_SHARE * self.before

    @property
    def is_worse(self) -> bool:
        """True if the saved model predicts notably worse than the base model."""
        return self.after > (1.0 + MIN_SHARE) * self.before

    @property
    def noise_ratio(self) -> float:
        """RMSE of the saved model in noise floors."""
        return self.after / max(self.floor, 1e-300)

    @property
    def error(self) -> str:
        """The error in words: '3.2 → 0.20 N m (1.3 × noise)'."""
        values = [significant(self.after)]
        if self.is_improved or self.is_worse:
            values.insert(0, significant(self.before))
        return f"{' → '.join(values)} {self.unit} ({significant(self.noise_ratio)} × noise)"

    @property
    def causes(self) -> str:
        """Effects that remove the error: 'mostly load friction (95 %), some delay (5 %)'."""
        if self.is_withheld:
            return "findings are withheld"
        if self.is_worse:
            return "the effects of the model do not hold here"
        if not self.is_improved:
            is_noise = self.noise_ratio <= EXPLAINED_RMSE_RATIO
            return "nothing notable is missing" if is_noise else "no effect found reduces it"
        texts = [
            f"{'' if part.is_certain else 'perhaps '}{effect_words(part.effect)} "
            f"({100.0 * part.share:.0f} %)"
            for part in self.parts
        ]
        if self.parts[0].share >= MAIN_SHARE and len(texts) > 1:
            texts[0] = f"mostly {texts[0]}"
            texts[1] = f"some {texts[1]}" if self.parts[1].is_certain else texts[1]
        if self.others >= NAMED_OTHERS:
            texts.append(f"others ({100.0 * self.others:.0f} %)")
        return ", ".join(texts)


def probability_words(probability: float) -> str:
    """Return a probability with two decimals; certainty is not claimed."""
    if not 0.01 <= probability <= 0.99:
        return "> 0.99" if probability > 0.5 else "< 0.01"
    return f"{probability:.2f}"


def change_words(change: Mapping[str, Any]) -> str:
    """Return a change between recordings with its standard error, and relative to the value."""
    text = value_with_error(change["value"], change["std"], change["unit"])
    share = change.get("relative")
    if share is None or abs(share) > MAX_RELATIVE_CHANGE:  # of a value that is practically zero
        return text
    return f"{text} ({100.0 * share:+.0f} %)".replace("-", "−")


def parameter_words(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return parameters of `diagnosis.json` with standard errors."""
    texts = [f"{key.replace('_', ' ')} {value_with_error(**v)}" for key, v in parameters.items()]
    return ", ".join(texts) or "uncertain"


def sorted_findings(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the findings of `diagnosis.json` by joint, the largest of each joint first."""
    joints = [None, *document["joints"]]
    return sorted(
        document["findings"], key=lambda f: (joints.index(f["joint"]), -f["evidence"]["severity"])
    )


def joint_budgets(document: Mapping[str, Any], robot: Robot) -> list[JointBudget]:
    """Return the budget of every joint.

    Args:
        document: The diagnosis as in `diagnosis.json`.
        robot: The robot.
    """
    uncertain = {(e["effect"], e["joint"]) for e in document["considered"] if e["modelled"]}
    out = []
    for entry, (joint, errors) in zip(robot.entries, document["joints"].items(), strict=True):
        budget = document["budget"][joint]
        shares = {name: v for name, v in budget.items() if name != "residual" and v["share"] > 0.0}
        total = sum(value["share"] for value in shares.values())
        parts = []
        for name, value in sorted(shares.items(), key=lambda entry: -entry[1]["share"]):
            is_certain = not uncertain & {(name, joint), (name, None)}
            share, std = value["share"] / total, value["std"] / total
            parts.append(BudgetPart(name, share, std, is_certain))
        out.append(
            JointBudget(
                joint,
                entry.unit("N m"),
                errors["rmse_before"],
                errors["rmse_after"],
                errors["noise_floor"],
                tuple(part for part in parts if part.share >= MIN_SHARE),
                sum(part.share for part in parts if part.share < MIN_SHARE),
                "doubts" in document,
            )
        )
    return out
