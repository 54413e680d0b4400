"""Verdict of a diagnosis in words: what is missing, of what use the saved model is, what to do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..effects import EFFECTS_BY_NAME
from ..robot.parameter_names import listed
from ..schemas.effects import effect_words
from .formatting import capitalized, significant
from .torque_budget import (
    Document,
    JointBudget,
    joint_words,
    places_where,
    prior_words,
    sorted_findings,
)

SURE_PROBABILITY = 0.9
"""Probability from which no experiment to confirm a finding is proposed."""
MAX_NAMED_FINDINGS = 3
"""Findings that the verdict names; of more it states the number."""
_VERDICTS = {
    "no-mismatch": "the base model lacks nothing that these recordings show",
    "explained": "{effects} what the base model lacks",
    "partly-explained": "{effects} a part of what the base model lacks",
    "unexplained": "the base model lacks something that no known effect explains",
}
_ONE_SESSION = (
    "warm up alike, or record temp.<joint>, and record training and validation again in one session"
)
_AS_FAST = "record training motion as fast as the motion that is to be predicted"
LONGER = "record a longer motion"
"""Action on changes between recordings that cannot be told from chance."""
_CHECK_ROBOT = (
    "check the robot description, the order and signs of the joints, gravity and the time stamps"
)
_WITHOUT_PRIOR = "diagnose without --prior, or with a prior that states only what is known"


@dataclass(frozen=True)
class Action:
    """Something to do on what recordings leave open.

    Attributes:
        line: A sentence with its cause.
        brief: The action in an enumeration of the first ones; "" for one that is not among them.
    """

    line: str
    brief: str = ""


_DISCRIMINATE = Action(
    "One motion for all effects that resemble each other: excite design ROBOT --discriminate "
    "diagnosis.json -o DIR. What its recording decides: excite diagnose … --discriminating "
    "RECORDING.",
    "excite design ROBOT --discriminate diagnosis.json designs the motion that decides between the "
    "effects that resemble each other",
)


def verdict_words(document: Document, budgets: Sequence[JointBudget]) -> str:
    """Say whether the base model lacks something, and what of the error is not explained."""
    verdict = document["verdict"]
    text = _VERDICTS[verdict].format(effects=_effects_explain(document))
    unknown = list(dict.fromkeys(entry["joint"] for entry in document["unknown"]))
    if verdict == "no-mismatch" and not all(b.is_explained for b in budgets):
        text = "no effect is found that the base model lacks"
    if unknown:
        places = joint_words(unknown, len(budgets))
        remains = f"torque at {places} repeats with the motion and no known effect explains it"
        text = remains if verdict == "unexplained" else f"{text}; {remains}"
    if changed := places_where(budgets, lambda b: b.is_changed and not b.unknown):
        text += f"; most of the error of {changed} is friction or offset "
        text += "that changed between the recordings"
    if doubted := prior_words(budgets):
        text += f"; {doubted}"
    if extrapolated := places_where(budgets, lambda b: b.is_extrapolated):
        text += f"; the model is extrapolated at {extrapolated}, where the "
        text += "held-out motion is faster than the fitted recordings"
    if above := [b for b in budgets if b.is_unforeseen]:
        worst = max(above, key=lambda b: b.noise_ratio)
        ratio = f"{'up to ' if above[1:] else ''}{significant(worst.noise_ratio)} times the noise"
        if not worst.is_noise_known:
            ratio += ", which is only estimated,"
        places = joint_words([b.joint for b in above], len(budgets))
        text += f"; the error of the held-out motion is still {ratio} at {places}"
    if useless := places_where(budgets, lambda b: b.is_useless):
        text += f"; no model fits {useless}: a prediction of no torque would be better"
    return text


def _effects_explain(document: Document) -> str:
    """Name the findings, if they are few, with the verb of which they are the subject."""
    findings = sorted_findings(document)
    if len(findings) > MAX_NAMED_FINDINGS:
        return f"{len(findings)} effects explain"
    several = len(document["joints"]) > 1
    words = [
        f"{effect_words(f['effect'])} ({f['joint'] or 'the whole robot'})"
        if several
        else effect_words(f["effect"])
        for f in findings
    ]
    return f"{listed(words)} explain{'' if words[1:] else 's'}" if words else ""


def tone(document: Document, budgets: Sequence[JointBudget]) -> str:
    """Return "good" where the error is near that of noise at every joint, else "warn" or "bad"."""
    if document["verdict"] == "unexplained" or any(b.is_useless for b in budgets):
        return "bad"
    return "good" if all(b.is_explained for b in budgets) else "warn"


def use_words(budgets: Sequence[JointBudget]) -> str:
    """Say whether the saved model is of use, and which file to load."""
    if useless := places_where(budgets, lambda b: b.is_useless):
        return f"none; model.json does not predict {useless}"
    if spoiled := places_where(budgets, lambda b: b.is_spoiled):
        return (
            f"model.json with care; it predicts {spoiled} worse than the base model, "
            "which is its field without_effects"
        )
    if improved := places_where(budgets, lambda b: b.is_improved):
        text = (
            f"load model.json; it predicts unseen motion better than the base model at {improved}"
        )
        if worse := places_where(budgets, lambda b: b.is_worse):
            text += f", worse only by what changed between the recordings at {worse}"
        elif budgets[1:]:
            text += ", worse at none"
        return text + _poor_words(budgets)
    if all(b.is_explained for b in budgets):
        text = "load model.json; it predicts unseen motion down to the noise"
        return text + _poor_words(budgets)
    worst = max(budgets, key=lambda b: b.noise_ratio)
    text = (
        f"model.json is no better than the base model, with errors up to "
        f"{significant(worst.noise_ratio)} × noise ({worst.joint})"
    )
    if any(b.is_changed for b in budgets):
        text += "; its friction holds only in the session that it was fitted to"
    return text


def _poor_words(budgets: Sequence[JointBudget]) -> str:
    """Say which joints have errors that are a large part of their torque; "" if none has."""
    poor = [b for b in budgets if b.is_poor]
    if not poor:
        return ""
    ratio = 100.0 * max(b.relative_error for b in poor)
    return (
        f"; its error is {'up to ' if poor[1:] else ''}{ratio:.0f} % of the torque at "
        f"{joint_words([b.joint for b in poor], len(budgets))}"
    )


def next_words(document: Document, budgets: Sequence[JointBudget]) -> str:
    """Return the first actions on what these recordings leave open."""
    for actions in next_actions(document, budgets):
        if briefs := [action.brief for action in actions if action.brief]:
            return "; ".join(briefs)
    return "nothing is needed"


def next_actions(document: Document, budgets: Sequence[JointBudget]) -> list[list[Action]]:
    """Return all actions on what these recordings leave open, those that go first in front."""
    count, groups = len(budgets), open_effects(document)
    changed = [b.joint for b in budgets if b.is_changed]
    fast = [b.joint for b in budgets if b.is_extrapolated]
    above = [b.joint for b in budgets if b.is_unforeseen]
    partly_changed = [
        joint
        for joint in dict.fromkeys(c["joint"] for c in document["between_recordings"])
        if joint not in (*changed, *fast)
    ]

    def at(
        joints: Sequence[str], words: str, cause: str, brief: str = "{words}"
    ) -> Iterator[Action]:
        """An action and its cause, where there is one."""
        if joints:
            place = joint_words(joints, count)
            line = f"{capitalized(words)}: {cause} at {place}."
            yield Action(line, brief.format(words=words, place=place))

    # without the first, all others are in vain
    urgent = []
    if any(b.is_misled for b in budgets):
        urgent = [_WITHOUT_PRIOR]  # what else there is shows without it
    elif any(b.is_useless for b in budgets):
        urgent = [_CHECK_ROBOT]
    wanted = [
        f"for the unknown torque at {entry['joint']}, record {entry['experiment']}"
        for entry in document["unknown"]
    ]
    of_unknown = [
        Action(f"{capitalized(words)}.", "" if k else words) for k, words in enumerate(wanted)
    ]
    discriminating = [_DISCRIMINATE] if any(names[1:] for names in groups) else []
    for names, joints in sorted(groups.items(), key=lambda group: -len(group[0])):
        purpose = "To tell apart" if names[1:] else "To be surer of"
        effects = listed([effect_words(name) for name in names])
        experiments = "; ".join(EFFECTS_BY_NAME[name].experiment for name in names)
        place = joint_words(list(dict.fromkeys(joints)), count)
        discriminating.append(Action(f"{purpose} {effects} ({place}): {experiments}."))
    undecided = document["undecided_between_recordings"]
    too_short = list(dict.fromkeys(change["joint"] for change in undecided))
    alone = "each joint alone at several speeds" if count > 1 else "at several constant speeds"
    alone = f"record twice, {alone} in both directions"
    return [
        [Action(f"{capitalized(words)}.", words) for words in urgent],
        [
            *at(changed, _ONE_SESSION, "friction or offset changed"),
            *at(fast, _AS_FAST, "the model is extrapolated"),
            *of_unknown,
        ],
        discriminating,
        [
            *at(above, alone, "what remains has no known cause", "{words} ({place})"),
            *at(partly_changed, _ONE_SESSION, "friction or offset changed as well", ""),
        ],
        [*at(too_short, LONGER, "a change of friction or offset cannot be told from chance")],
    ]


def open_effects(document: Document) -> dict[tuple[str, ...], list[str]]:
    """Return findings that are unsure or resemble others: the joints of each group of effects."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for finding in sorted_findings(document):
        rivals = (rival["effect"] for rival in finding.get("rivals", ()))
        key = tuple(sorted({finding["effect"], *finding["equivalents"], *rivals}))
        if key[1:] or finding["probability"] < SURE_PROBABILITY:
            groups.setdefault(key, []).append(finding["joint"] or "the whole robot")
    return groups
