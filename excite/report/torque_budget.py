"""Torque budget of each joint in words: its held-out error, and what each effect removes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..robot.robot import Robot
from .formatting import significant

MIN_SHARE = 0.03
"""Share of the removed error from which an effect is named; smaller ones are summed. An error that
falls by less counts as unchanged."""
NOISE_RATIO = 1.2
"""Noise floors up to which an error counts as noise, as in the verdict of a diagnosis."""
NAMED_OTHERS = 0.01
"""Share of all small effects together from which they are mentioned."""
MAIN_SHARE = 0.6
"""Share of the removed error from which it is mostly due to one effect."""
_WORDS = {
    "asymmetric_viscous": "viscous friction that differs by direction",
    "drag": "drag (square of speed)",
    "friction": "friction",
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
    """

    joint: str
    unit: str
    before: float
    after: float
    floor: float
    parts: tuple[BudgetPart, ...]
    others: float

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
    def contributions(self) -> str:
        """Effects that remove the error: 'mostly load friction (95 %), some delay (5 %)'."""
        if not self.is_improved:
            return ""
        texts = [
            f"{'' if part.is_certain else 'perhaps '}{effect_words(part.effect)} "
            f"({100.0 * part.share:.0f} %)"
            for part in self.parts
        ]
        if self.others >= NAMED_OTHERS:
            texts.append(f"others ({100.0 * self.others:.0f} %)")
        if self.parts[0].share < MAIN_SHARE:
            return ", ".join(texts)
        texts[0] = f"mostly {texts[0]}" if len(texts) > 1 else texts[0]
        texts[1:2] = [f"some {texts[1]}"] if len(self.parts) > 1 else texts[1:2]
        return ", ".join(texts)

    @property
    def sentence(self) -> str:
        """The budget in a sentence without the joint."""
        if self.is_improved:
            return f"error {self.error}; {self.contributions}"
        if self.is_worse:
            return f"error {self.error}; the effects of the model do not hold here"
        if self.noise_ratio <= NOISE_RATIO:
            return f"error {self.error}; nothing notable is missing"
        return f"error {self.error}; no effect of the model reduces it"


def sorted_findings(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the findings of `diagnosis.json` by joint, the largest of each joint first."""
    joints = [None, *document["joints"]]
    return sorted(
        document["findings"],
        key=lambda f: (joints.index(f["joint"]), -f["evidence"]["severity"]),
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
        shares = {
            effect: value
            for effect, value in document["budget"][joint].items()
            if effect != "residual" and value["share"] > 0.0
        }
        total = sum(value["share"] for value in shares.values())
        parts = [
            BudgetPart(
                effect,
                value["share"] / total,
                value["std"] / total,
                not uncertain & {(effect, joint), (effect, None)},
            )
            for effect, value in shares.items()
        ]
        named = sorted((p for p in parts if p.share >= MIN_SHARE), key=lambda part: -part.share)
        out.append(
            JointBudget(
                joint,
                entry.unit("N m"),
                errors["rmse_before"],
                errors["rmse_after"],
                errors["noise_floor"],
                tuple(named),
                sum(part.share for part in parts if part.share < MIN_SHARE),
            )
        )
    return out
