"""Sections of a design's report on effects: what the recording is expected to tell apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..designer.discrimination_result import CONFIRMATION_REMARK, DiscriminationResult
from ..designer.experiment_menu import DECISIVE_LOG_ODDS, Experiment
from ..designer.isolability_forecast import PairForecast
from ..robot.parameter_names import plural
from ..schemas.effects import MIN_SEVERITY, effect_words
from .content import Section, Table, TableCell
from .formatting import capitalized, number, odds_words

LISTED_COMPARISONS = 10
"""Comparisons that are listed, the least certain first, before the others are folded."""
MENU_COMPARISONS = 6
"""Comparisons with a column of their own in the menu, the least certain ones."""


def _cell(log_odds: float) -> TableCell:
    """Return expected log-odds, coloured by whether they decide."""
    return TableCell(f"{log_odds:.1f}", "good" if log_odds >= DECISIVE_LOG_ODDS else "warn")


def _menu_row(
    experiment: Experiment, shown: Sequence[int], best: Experiment
) -> list[str | TableCell]:
    """Return a row of the menu: the least log-odds of all comparisons, then those shown."""
    name = experiment.name + (" ← recommended" if experiment is best else "")
    time = f"{experiment.seconds:.0f} s"
    if experiment.log_odds is None:
        return [name, time, f"not possible: {experiment.obstacle}", *["–"] * (1 + len(shown))]
    return [
        name,
        time,
        "yes" if experiment.decides else "no",
        _cell(float(experiment.log_odds.min())),
        *(_cell(float(experiment.log_odds[index])) for index in shown),
    ]


def discrimination_section(result: DiscriminationResult) -> Section:
    """Return the section on the comparisons of a discriminating motion and the menu.

    Args:
        result: The expected decisions.
    """
    least = int(np.argmin(result.designed))
    best = result.recommendation
    answer = (
        f"The least certain decision ({result.question_of(result.comparisons[least])}) has "
        f"expected log-odds of {result.designed[least]:.1f} after this motion, "
        f"{result.reference[least]:.1f} after a D-optimal one. "
    )
    answer += (
        f"The cheapest experiment that decides: {best.name}."
        if best.decides
        else f"No experiment of the list decides everything; the best is: {best.name}."
    )
    if result.is_confirmation:
        answer += f" {capitalized(CONFIRMATION_REMARK)}."
    order = np.argsort(result.designed, kind="stable").tolist()
    pairs = [
        (
            f"({place}) {result.question_of(result.comparisons[index])}",
            f"{number(100.0 * result.comparisons[index].weight, 2)} %",
            _cell(float(result.reference[index])),
            _cell(float(result.designed[index])),
        )
        for place, index in enumerate(order, start=1)
    ]
    shown = order[:MENU_COMPARISONS]
    menu = [_menu_row(experiment, shown, best) for experiment in result.menu]
    notes = [f"{effect_words(effect)}: {how}" for effect, how in result.linearised.items()]
    notes += [f"no motion decides: {result.question_of(c)}" for c in result.undecidable]
    notes += list(result.omitted)
    nominal = sorted({effect_words(e.form.effect) for e in result.explanations if e.nominal})
    if nominal:
        notes.append(f"the size is a usual one, as the diagnosis states none: {', '.join(nominal)}")
    head = ("comparison", "weight", "D-optimal", "this motion")
    closest, others = Table(head, pairs, (1, 2, 3)).split(LISTED_COMPARISONS)
    data = {
        "pairs": closest,
        "others": others,
        "others_summary": plural(len(others.rows), "more comparison"),
        "menu": Table(
            (
                "experiment",
                "robot time",
                "decides all",
                "least",
                *(f"({place})" for place in range(1, len(shown) + 1)),
            ),
            menu,
            (1, *range(3, 4 + len(shown))),
        ),
        "notes": notes,
        "decisive": f"{DECISIVE_LOG_ODDS:g}",
        "earlier": "the earlier recordings" if result.with_given else "one of the D-optimal motion",
    }
    question = "Which explanation will the recording confirm?"
    return Section("discrimination", question, answer, data)


def isolability_section(pairs: Sequence[PairForecast]) -> Section:
    """Return the section on effects that the recording will not tell apart.

    Args:
        pairs: Forecasts, the least decided first.
    """
    open_pairs = [pair for pair in pairs if not pair.is_decided]
    kinds = dict.fromkeys((pair.first, pair.second) for pair in open_pairs)
    answer = (
        f"{len(open_pairs)} of {len(pairs)} often confused pairs would stay open: "
        f"{'; '.join(f'{effect_words(a)} and {effect_words(b)}' for a, b in kinds)}."
        if open_pairs
        else f"None of {len(pairs)} often confused pairs would stay open."
    )
    rows = [
        (pair.joint, effect_words(pair.first), effect_words(pair.second), odds_words(pair.log_odds))
        for pair in open_pairs
    ]
    data = {
        "table": Table(("joint", "effect", "rival", "expected odds"), rows, (3,)),
        "severity": f"{MIN_SEVERITY:g}",
        "decisive": odds_words(DECISIVE_LOG_ODDS),
    }
    return Section("isolability", "Which effects will it not tell apart?", answer, data)
