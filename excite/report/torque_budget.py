"""Torque budget of each joint in words: its held-out error, and what each effect removes of it.

The shares of `diagnosis.json` are of the squared error. What they sum to is at least the share of
the error by which it falls, which is divided in their proportion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from pathlib import Path
from typing import Any

from ..diagnosis.budget import BASE_PARAMETERS, RECORDING_FILTER
from ..diagnosis.diagnosis import EXPLAINED_RMSE_RATIO, Diagnosis
from ..robot.parameter_names import listed, some
from ..robot.robot import Robot
from ..schemas.effects import effect_words
from .formatting import number, significant, value_with_error
from .prediction import FAIR_RELATIVE_ERROR

Document = Mapping[str, Any]
"""The diagnosis as in `diagnosis.json`, or a part of it."""
MIN_SHARE = 0.03
"""Share of the removed error from which an effect is named; smaller ones are summed. An error that
changes by less counts as unchanged."""
MAX_RELATIVE_CHANGE = 2.0
"""Relative change between recordings up to which it is stated."""
NAMED_OTHERS = 0.01
"""Share of all small effects together from which they are mentioned."""
NAMED_JOINTS = 5
"""Joints that are named before they are only counted."""
CHANGED_SHARE = 0.5
"""Share of the squared error from which it is mostly a change between the recordings."""
MAX_UNSEEN_GAIN = 0.995
"""Gain of a filter that rounds to 1 [1]."""
MISLED_SHARE = 0.5
"""Share of the squared error that must go without the trusted prior for the prior to be in doubt:
parameters that are refit without need differ from true ones by less than the noise."""
EXTRAPOLATED_SPEED_RATIO = 1.5
"""Largest held-out speed over that of the fitted recordings from which it is extrapolated:
other motions within the same limits differ by less."""
_MILLISECONDS = 1e3
_PARAMETER_WORDS = {"mu": "μ", "com_x": "centre x", "com_y": "centre y", "com_z": "centre z"}


def base_words(diagnosis: Diagnosis) -> str:
    """Return which base model the errors before the diagnosis are of."""
    has_prior = bool(diagnosis.identified.options.trusted)
    return "the model of the prior" if has_prior else "the base model fitted without effects"


def known_words(document: Document) -> str:
    """Return which effects are known by the prior; "" if none."""
    places: dict[str, list[str]] = {}
    for entry in document["known_effects"]:
        places.setdefault(entry["effect"], []).append(entry["joint"] or "whole robot")
    if not places:
        return ""
    known = listed([f"{effect_words(e)} ({', '.join(joints)})" for e, joints in places.items()])
    return f"The prior knows, so that they are no findings: {known}."


def prior_words(budgets: Sequence[JointBudget]) -> str:
    """Return that the trusted prior does not hold; "" if nothing speaks against it."""
    misled = places_where(budgets, lambda b: b.is_misled)
    if not misled:
        return ""
    return (
        "the parameters of the prior are in doubt: identified without them, the base model alone "
        f"predicts {misled} better than the saved model"
    )


def filter_words(document: Document) -> str:
    """Return how recorded torque and positions differ in their frequency response; "" if not."""
    entry = document[RECORDING_FILTER]
    if entry is None or min(entry["gain"]) > MAX_UNSEEN_GAIN:
        return ""
    gains = [
        f"{gain:.2f} at {significant(hertz)} Hz"
        for hertz, gain in zip(entry["hertz"], entry["gain"], strict=True)
    ]
    return (
        "High frequencies of the recorded torque are smaller than the positions imply "
        f"(gain {', '.join(gains)}): the torque was low-pass filtered, or the positions are noisy "
        "or their time stamps not exact. The saved model has this gain, too."
    )


@dataclass(frozen=True)
class BudgetPart:
    """An effect in the budget of a joint, or the base parameters that are fitted jointly.

    Attributes:
        effect: Its name.
        share: Share of the removed error [1]; negative if it adds to the error.
        std: Its standard deviation [1].
        is_certain: False if the saved model has the effect but it is not among the findings.
        inseparable: Effects whose parts are in this one, since they cancel it.
    """

    effect: str
    share: float
    std: float
    is_certain: bool
    inseparable: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """Its name in a sentence: 'perhaps presliding hysteresis'."""
        text = f"{'' if self.is_certain else 'perhaps '}{effect_words(self.effect)}"
        if self.inseparable:
            text += f" with {listed([effect_words(name) for name in self.inseparable])}"
        return text


@dataclass(frozen=True)
class JointBudget:
    """Held-out RMSE of a joint with the base model and with the saved model.

    Attributes:
        joint: Name of the joint.
        unit: Unit of its torque.
        before: RMSE of the base model.
        after: RMSE of the saved model.
        floor: Noise floor.
        parts: Those whose share of before − after is at least `MIN_SHARE`, the largest first.
        others: Share of all other effects together [1].
        is_withheld: Whether findings are withheld, so that the saved model is the base model.
        torque: RMS of the measured torque.
        changed: Share of the saved model's squared error that friction and offsets explain which
            differ from those of the fitted recordings [1].
        changed_before: The same of the base model [1].
        unknown: Whether the joint has torque that no effect explains.
        small: Effects that would explain a part of that, but are too small.
        absent: Findings at the joint that remove no notable part of its error.
        speed_ratio: Largest held-out speed over that of the fitted recordings; infinite if the
            joint stands still in those [1].
        refit: RMSE of the base model identified without the trusted prior; infinite without one.
        acceleration_ratio: Largest held-out acceleration over that of the fitted recordings [1].
        is_noise_known: Whether the noise floor was found by repetition, not by a spectrum that may
            contain errors of the model.
    """

    joint: str
    unit: str
    before: float
    after: float
    floor: float
    parts: tuple[BudgetPart, ...]
    others: float
    is_withheld: bool
    torque: float = inf
    changed: float = 0.0
    changed_before: float = 0.0
    unknown: bool = False
    small: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    speed_ratio: float = 1.0
    refit: float = inf
    acceleration_ratio: float = 1.0
    is_noise_known: bool = False

    @property
    def removed(self) -> float:
        """Share of the base model's error that the saved model removes [1]."""
        return 1.0 - self.after / max(self.before, 1e-300)

    @property
    def has_torque(self) -> bool:
        """False if no torque was measured that could be predicted, as of a joint at rest."""
        return self.torque > 0.0

    @property
    def is_explained(self) -> bool:
        """True if the error is near that of noise."""
        return self.noise_ratio <= EXPLAINED_RMSE_RATIO or not self.has_torque

    @property
    def is_extrapolated(self) -> bool:
        """True if there is an error at speeds to which the model was not fitted."""
        return self.speed_ratio > EXTRAPOLATED_SPEED_RATIO and not self.is_explained

    @property
    def is_changed(self) -> bool:
        """True if most of the squared error is friction or offset that changed."""
        return self.changed > CHANGED_SHARE and not (
            self.is_explained or self.is_extrapolated or self.is_misled
        )

    @property
    def is_unforeseen(self) -> bool:
        """True if there is an error for which neither a change nor speed nor unknown torque
        stands."""
        return not (
            self.is_explained
            or self.is_changed
            or self.is_extrapolated
            or self.is_misled
            or self.unknown
        )

    @property
    def is_misled(self) -> bool:
        """True if most of the squared error goes where the trusted prior is not used."""
        is_less = self.refit**2 < (1.0 - MISLED_SHARE) * self.after**2
        return is_less and not self.is_explained

    @property
    def unchanged(self) -> float:
        """RMSE of the saved model without what changed between the recordings."""
        return float(self.after * (1.0 - self.changed) ** 0.5) if self.is_changed else self.after

    @property
    def is_improved(self) -> bool:
        """True if the effects reduce the error notably."""
        return bool(self.parts) and self.before - self.after > MIN_SHARE * self.before

    @property
    def is_worse(self) -> bool:
        """True if the saved model predicts notably worse than the base model."""
        return self.after > (1.0 + MIN_SHARE) * self.before and self.has_torque

    @property
    def is_spoiled(self) -> bool:
        """True if it does so without what changed between the recordings, too."""
        changed = self.changed_before if self.is_changed else 0.0
        before = self.before * (1.0 - changed) ** 0.5
        return self.is_worse and self.unchanged > (1.0 + MIN_SHARE) * before

    @property
    def noise_ratio(self) -> float:
        """RMSE of the saved model in noise floors."""
        return self.after / max(self.floor, 1e-300)

    @property
    def relative_error(self) -> float:
        """RMSE of the saved model over the RMS torque [1]."""
        return self.after / max(self.torque, 1e-300)

    @property
    def is_poor(self) -> bool:
        """True if its error is a large part of the torque."""
        return self.relative_error > FAIR_RELATIVE_ERROR and self.has_torque

    @property
    def is_useless(self) -> bool:
        """True if a prediction of no torque would have a smaller error than either model."""
        is_more = min(self.before, self.after) > self.torque
        return is_more and self.has_torque and not self.is_noise

    @property
    def is_noise(self) -> bool:
        """True if the error is known to be that of noise, however small the torque is."""
        return self.is_explained and self.is_noise_known

    @property
    def error(self) -> str:
        """The error in words: '3.2 → 0.20 N m (1.3 × noise)'."""
        values = [significant(self.after)]
        if self.is_improved or self.is_worse:
            values.insert(0, significant(self.before))
        return f"{' → '.join(values)} {self.unit} ({significant(self.noise_ratio)} × noise)"

    @property
    def causes(self) -> str:
        """Effects that remove the error, by how much of it, and causes of the remaining error."""
        if not self.has_torque:
            return "the measured torque is zero"
        if self.is_withheld:
            return "findings are withheld"
        texts = [*self._removed(), *self._remaining()]
        worse = [
            f"{name} ({100.0 * error / self.torque:.0f} % of the torque)"
            for name, error in (("the base model", self.before), ("the saved model", self.after))
            if error > self.torque and not self.is_noise
        ]
        if worse:
            verb = "are" if worse[1:] else "is"
            texts.append(f"{listed(worse)} {verb} worse than predicting no torque")
        elif self.is_poor:
            texts.append(f"the error is {100.0 * self.relative_error:.0f} % of the torque")
        return "; ".join(texts)

    def change_words(self, share: float) -> str:
        """Return by how much a part of the removed error changes the error: '−30 %'."""
        return f"{-100.0 * share * self.removed:+.0f} %".replace("-", "−")

    def _removed(self) -> list[str]:
        """Effects that remove the error: 'load friction −30 %, delay −5 %'."""
        if self.is_spoiled:
            causes = [effect_words(p.effect) for p in self.parts if p.share * self.removed < 0.0]
            because = f" because of {listed(causes)}" if causes else ""
            return [f"the saved model predicts this joint worse than the base model{because}"]
        if not self.is_improved:
            if self.is_explained:
                hidden = "noise hides what may be missing"
                return [hidden if self.is_poor else "nothing notable is missing"]
            is_caused = self.unknown or self.is_changed or self.is_misled
            if is_caused:
                return []
            certain = [p.effect for p in self.parts if p.is_certain and p.effect != BASE_PARAMETERS]
            if named := [effect_words(name) for name in (*self.absent, *certain)]:
                return [f"{listed(named)} {'do' if named[1:] else 'does'} not reduce it"]
            return ["no effect found reduces it"]
        texts = [
            f"{part.words} {self.change_words(part.share)}"
            for part in self.parts
            if round(100.0 * part.share * self.removed)
        ]
        if abs(self.others) * self.removed >= NAMED_OTHERS:
            texts.append(f"others {self.change_words(self.others)}")
        if self.absent:
            names = listed([effect_words(name) for name in self.absent])
            texts.append(f"no change by {names}")
        return [", ".join(texts)]

    def _remaining(self) -> list[str]:
        """Causes of the remaining error."""
        texts = []
        if self.is_unforeseen and self.is_improved:
            texts.append("the cause of what remains is not known")
        if self.unknown and not self.is_explained:
            texts.append("torque that repeats and that no known effect explains remains")
            if self.small:
                texts.append(small_words(self.small))
        if self.is_misled:
            texts.append(
                "the base model identified without the prior has an error of "
                f"{significant(self.refit)} {self.unit}"
            )
        if self.is_extrapolated:
            accelerations = (
                f" and accelerations {self.acceleration_ratio:.1f}"
                if self.acceleration_ratio > 1.0
                else ""
            )
            texts.append(
                f"the model is extrapolated to speeds {self.speed_ratio:.1f}{accelerations} times "
                "those of the fitted recordings"
                if isfinite(self.speed_ratio)
                else "its friction is not known, as it stands still in the fitted recordings"
            )
        if self.is_changed:
            start = "of the remaining squared error" if self.is_improved else "of its square"
            texts.append(
                f"{100.0 * self.changed:.0f} % {start} may be friction or offset that changed "
                "between the recordings"
                if self.unknown
                else f"friction or offset changed between the recordings: "
                f"{100.0 * self.changed:.0f} % {start}"
            )
        return texts


def small_words(effects: Sequence[str]) -> str:
    """Return effects that would explain a part of unknown torque in a sentence."""
    names = listed([effect_words(name) for name in effects])
    verb = "are" if effects[1:] else "is"
    return f"{names} would explain a part, but {verb} too small to be sure of"


def joint_words(joints: Sequence[str], count: int) -> str:
    """Return joints in a sentence by name, or how many there are if they are all or many."""
    if len(joints) == count > 1:
        return "both joints" if count == 2 else f"all {count} joints"
    return some(joints, NAMED_JOINTS)


def places_where(budgets: Sequence[JointBudget], holds: Callable[[JointBudget], bool]) -> str:
    """Return the joints of which something holds, as `joint_words` does; "" if there is none."""
    joints = [budget.joint for budget in budgets if holds(budget)]
    return joint_words(joints, len(budgets)) if joints else ""


def undecided_words(undecided: Sequence[Document], count: int) -> str:
    """Say which recordings have too little motion to tell a change of friction from chance."""
    joints = list(dict.fromkeys(change["joint"] for change in undecided))
    recordings = list(dict.fromkeys(Path(change["recording"]).name for change in undecided))
    longest = max(change["seconds"] for change in undecided)
    return (
        f"Not known of {listed(recordings)} at {joint_words(joints, count)}, with {longest:g} s "
        "of motion to judge by at most: a change of friction or offset would explain a part of "
        "the error, but cannot be told from chance. Record a longer motion."
    )


def probability_words(probability: float) -> str:
    """Return a probability with two decimals; certainty is not claimed."""
    if not 0.01 <= probability <= 0.99:
        return "> 0.99" if probability > 0.5 else "< 0.01"
    return f"{probability:.2f}"


def change_words(change: Document) -> str:
    """Return a change between recordings with its standard error, and relative to the value."""
    text = value_with_error(change["value"], change["std"], change["unit"])
    share = change.get("relative")
    if share is None or abs(share) > MAX_RELATIVE_CHANGE:  # of a value that is practically zero
        return text
    return f"{text} ({100.0 * share:+.0f} %)".replace("-", "−")


def parameter_words(parameters: Mapping[str, Document]) -> str:
    """Return parameters of `diagnosis.json` with standard errors."""
    return ", ".join(_parameter(*entry) for entry in parameters.items()) or "not determined"


def finding_parameter_words(finding: Document) -> str:
    """Return the parameters of a finding, and the orders of all waves of a ripple."""
    text = parameter_words(finding["parameters"])
    weaker = [
        f"{significant(wave['order'], 3)} ({significant(wave['amplitude'])})"
        for wave in finding.get("weaker_waves", ())
    ]
    if not weaker:
        return text
    unit = finding["parameters"].get("amplitude", {"unit": "N m"})["unit"]
    return f"{text}; weaker waves of order (amplitude in {unit}) {listed(weaker)}"


def _parameter(name: str, entry: Document) -> str:
    """Return a parameter; a delay says which of torque and motion is late."""
    if name != "seconds":
        return f"{_PARAMETER_WORDS.get(name, name.replace('_', ' '))} {value_with_error(**entry)}"
    value, std = entry["value"], entry["std"]
    order = "after" if value > 0.0 else "before"
    size = value_with_error(
        _MILLISECONDS * abs(value), None if std is None else _MILLISECONDS * std, "ms"
    )
    return f"torque {size} {order} position"


def origin_words(finding: Document) -> str:
    """Return the other joint of a finding, or the interval in which it acts; empty without one."""
    text = f" from {finding['from']}" if finding.get("from") else ""
    if finding["where"]["time"] is None:
        return text
    start, end = finding["where"]["time"]
    recording = Path(finding["where"]["recording"]).name
    return f"{text}, {number(start)} to {number(end)} s of {recording} only"


def certainty_words(entry: Document) -> str:
    """Return how sure torque that no effect explains is; no probability that is not calibrated."""
    if entry["z_score"] is not None:
        return f"{significant(entry['z_score'])} × its standard error"
    return f"probability {probability_words(entry['probability'])}"


def regime_words(entry: Document) -> str:
    """Return the quantities on which torque depends that no effect explains, with their joints."""
    regime = str(entry["where"]["regime"]).replace("place", "position")
    if "other" in entry:
        regime = regime.replace("two joints", f"{entry['joint']} and {entry['other']}")
    return regime


def sorted_findings(document: Document) -> list[Document]:
    """Return the findings of `diagnosis.json` by joint, the largest of each joint first."""
    joints = [None, *document["joints"]]
    return sorted(
        document["findings"], key=lambda f: (joints.index(f["joint"]), -f["evidence"]["severity"])
    )


def _separable(parts: list[BudgetPart], removed: float) -> list[BudgetPart]:
    """Return parts of which none changes an error by more than all of it, the largest first.

    Base parameters that are fitted jointly with an effect may take what the effect adds elsewhere,
    as gravity that of a spring where the held-out motion leaves the fitted positions, and one
    friction curve what another one adds beyond the fitted speeds. Only their sum says something.

    Args:
        parts: The parts, with shares of the removed error.
        removed: Share of the base model's error that is removed [1].
    """
    while max((abs(part.share) for part in parts), default=0.0) * removed > 1.0:
        largest = max(parts, key=lambda part: abs(part.share))
        opposed = [part for part in parts if part.share * largest.share < 0.0]
        if not opposed:
            break
        pair = largest, max(opposed, key=lambda part: abs(part.share))
        first, second = sorted(pair, key=lambda part: part.effect != BASE_PARAMETERS)
        together = replace(
            first,
            share=first.share + second.share,
            inseparable=(*first.inseparable, second.effect, *second.inseparable),
        )
        parts = [*(part for part in parts if part not in pair), together]
    return sorted(parts, key=lambda part: -part.share)


def joint_budgets(document: Document, robot: Robot) -> list[JointBudget]:
    """Return the budget of every joint."""
    uncertain = {(e["effect"], e["joint"]) for e in document["considered"] if e["modelled"]}
    small = {entry["joint"]: tuple(entry["too_small"]) for entry in document["unknown"]}
    out = []
    for entry, (joint, errors) in zip(robot.entries, document["joints"].items(), strict=True):
        budget = document["budget"][joint]
        shares = {name: value for name, value in budget.items() if name != "residual"}
        total = max(1.0 - budget["residual"]["share"], 1e-300)
        parts = []
        for name, value in shares.items():
            is_certain = not uncertain & {(name, joint), (name, None)}
            share, std = value["share"] / total, value["std"] / total
            parts.append(BudgetPart(name, share, std, is_certain))
        parts = _separable(parts, 1.0 - errors["rmse_after"] / max(errors["rmse_before"], 1e-300))
        shown = tuple(part for part in parts if abs(part.share) >= MIN_SHARE)
        named = {name for part in shown for name in (part.effect, *part.inseparable)}
        effects = (f["effect"] for f in document["findings"] if f["joint"] == joint)
        changed, changed_before = (
            sum(c[key] for c in document["between_recordings"] if c["joint"] == joint)
            for key in ("error_share", "error_share_before")
        )
        out.append(
            JointBudget(
                joint,
                entry.unit("N m"),
                errors["rmse_before"],
                errors["rmse_after"],
                errors["noise_floor"],
                shown,
                sum(part.share for part in parts if abs(part.share) < MIN_SHARE),
                "doubts" in document,
                errors["torque_rms"],
                changed,
                changed_before,
                joint in small,
                small.get(joint, ()),
                tuple(name for name in effects if name not in named),
                inf if errors["speed_ratio"] is None else errors["speed_ratio"],
                errors.get("rmse_refit", inf),
                inf if errors["acceleration_ratio"] is None else errors["acceleration_ratio"],
                errors["noise_floor_method"] == "periods",
            )
        )
    return out
