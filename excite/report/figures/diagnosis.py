"""Figures of a diagnosis: torque budget, curves of effects, and held-out prediction."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ...diagnosis.budget import BASE_PARAMETERS
from ...diagnosis.diagnosis import Diagnosis
from ...diagnosis.estimates import QUANTILE
from ...effects.recorded_motion import split_by_motion
from ...identification.identification import Prediction
from ...schemas.effects import effect_words
from ..torque_budget import BudgetPart, JointBudget
from . import drawing
from .drawing import BLUE, GREEN, GREY, INK, ORANGE, RED
from .trajectory import short_names

_USUAL_COLORS = {
    "nonlinear_viscous": BLUE,
    "stribeck": "#5f9bd1",
    "hysteresis": "#8e5ea2",
    "load_friction": GREEN,
    "torque_ripple": "#4aa8a4",
    BASE_PARAMETERS: "#7a8f2a",
}
"""Colours of what nearly every robot has in the torque budget, the same in all reports."""
_RARE_COLORS = (ORANGE, "#c9a227", "#d16ba5", "#8c564b")
"""Colours of other effects, the largest one of the robot first."""
_OTHERS_COLOR = "#cfd6dd"
_REMAINING_COLOR = "#5b6775"
_CHANGED_COLOR = "#a9b4c0"
_BAR_HEIGHT = 0.36
"""Height of a joint in the torque budget [in]."""
_FONT_SIZE = 9.0
"""Size of its texts [pt]."""
_LETTER_WIDTH = 0.085
"""Mean width of a letter of a joint's name [in]."""
_TEXT_WIDTH = 2.6
"""Width of the text at the end of a bar [in]."""
_LABELLED_WIDTH = 0.07
"""Width of a part over the base model's error from which its share is written on it."""
_WHISKER_PLACES = (0.37, 0.43, 0.49)
"""Where below the middle of a bar the whiskers of its parts are, so that they cross no label."""
_END = 1.08
"""End of the axis of the torque budget; the bar of a larger error ends in an arrow there."""
_ARROW_LENGTH = 0.02
"""Length of this arrow, in the same unit."""
LOGARITHMIC_QUANTITY = "travel since the reversal"
"""Quantity of a curve that is drawn on a logarithmic axis."""
_CURVE_HEIGHT = 1.35
"""Height of the axes of an effect's curve [in]."""


def draw_budget(budgets: Sequence[JointBudget]) -> str:
    """Draw a bar for each joint: the parts of its error that effects remove, and what remains.

    The length of a bar is the held-out RMSE of the base model; the difference to that of the saved
    model is divided by the shares of the effects that reduce it.

    Args:
        budgets: Budgets of the joints.
    """
    totals: dict[str, float] = {}
    for part in (part for budget in budgets for part in _removing_parts(budget)):
        totals[part.effect] = totals.get(part.effect, 0.0) + part.share
    ranked = sorted(totals, key=lambda effect: -totals[effect])
    rare = [effect for effect in ranked if effect not in _USUAL_COLORS]
    palette = _USUAL_COLORS | dict(zip(rare, _RARE_COLORS, strict=False))
    colors = {effect: palette[effect] for effect in ranked if effect in palette}
    names = short_names([budget.joint for budget in budgets], 24)

    def draw(figure: Any) -> None:
        width, height = figure.get_size_inches()
        left, bottom, top = 0.3 + _LETTER_WIDTH * max(map(len, names)), 0.48, 0.62
        across, up = (width - left - _TEXT_WIDTH) / width, (height - bottom - top) / height
        axes = figure.add_axes((left / width, bottom / height, across, up))
        for y, budget in enumerate(budgets):
            _draw_bar(axes, y, budget, colors)
        axes.set_xlim(0.0, _END)
        axes.set_ylim(len(budgets) - 0.5, -0.5)
        axes.set_yticks(range(len(budgets)), names)
        axes.set_xticks(np.arange(0.0, 1.01, 0.2), [f"{20 * k} %" for k in range(6)])
        axes.tick_params(labelsize=_FONT_SIZE)
        axes.tick_params(axis="y", length=0, labelcolor=INK)
        axes.set_xlabel(
            "held-out torque error (RMS), over that of the base model", fontsize=_FONT_SIZE
        )
        _budget_legend(figure, colors, budgets)

    label = "Torque budget of every joint"
    return drawing.render_svg(label, 1.15 + _BAR_HEIGHT * len(budgets), draw)


def _removing_parts(budget: JointBudget) -> list[BudgetPart]:
    """Return the parts of the budget that reduce the error."""
    return [part for part in budget.parts if part.share > 0.0 and budget.is_improved]


def _draw_bar(axes: Any, y: int, budget: JointBudget, colors: Mapping[str, str]) -> None:
    """Draw the bar of a joint."""
    bar = functools.partial(axes.barh, y, height=0.62)
    scale = max(budget.before, 1e-300)
    remaining, floor = min(budget.after / scale, _END), budget.floor / scale
    unchanged = min(budget.unchanged / scale, _END)
    bar(unchanged, color=_REMAINING_COLOR)
    if budget.is_changed:
        bar(remaining - unchanged, left=unchanged, color=_CHANGED_COLOR)
    if budget.is_worse:
        bar(remaining - 1.0, left=1.0, color=RED)
    parts = _removing_parts(budget)
    at, removed = remaining, (1.0 - remaining) / max(sum(part.share for part in parts), 1.0)
    for k, part in enumerate(parts):
        size, alpha = part.share * removed, 1.0 if part.is_certain else 0.45
        bar(size, left=at, color=colors.get(part.effect, _OTHERS_COLOR), alpha=alpha)
        if size >= _LABELLED_WIDTH:
            text = budget.change_words(part.share)
            axes.text(at + 0.5 * size, y, text, ha="center", va="center", color="white", fontsize=8)
        # the right end is where the error comes from, the left one what the effect reduces it to
        reach, place = QUANTILE * part.std * removed, y + _WHISKER_PLACES[k % 3]
        ends = max(at - reach, 0.0), min(at + reach, 1.0)
        axes.plot(ends, (place, place), color=INK, linewidth=0.8, marker="|", markersize=3.0)
        at += size
    if budget.is_improved:
        bar(max(1.0 - at, 0.0), left=at, color=_OTHERS_COLOR)
    drawn = [remaining, 1.0]
    if budget.after > _END * scale:  # the bar goes on
        axes.plot(_END, y, marker=">", color=RED, markersize=11.0, clip_on=False)
        drawn.append(_END + _ARROW_LENGTH)
    if floor <= _END:
        axes.plot([floor, floor], [y - 0.42, y + 0.42], color=RED, linewidth=1.4)
        drawn.append(floor)
    axes.text(max(drawn) + 0.02, y, budget.error, va="center", fontsize=_FONT_SIZE)


def _budget_legend(figure: Any, colors: Mapping[str, str], budgets: Sequence[JointBudget]) -> None:
    """Legend of the torque budget."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    patches = {"error that remains": _REMAINING_COLOR}
    if any(budget.is_changed for budget in budgets):
        patches["friction or offset changed between recordings"] = _CHANGED_COLOR
    patches |= {effect_words(effect): color for effect, color in colors.items()}
    if any(budget.is_improved and budget.others > 0.0 for budget in budgets):
        patches["other effects"] = _OTHERS_COLOR
    if any(budget.is_worse for budget in budgets):
        patches["worse than the base model"] = RED
    handles = [Line2D([], [], color=RED), *(Patch(color=color) for color in patches.values())]
    figure.legend(
        handles,
        ["noise floor", *patches],
        loc="upper left",
        ncols=min(len(handles), 4),
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.0,
        handlelength=1.2,
        columnspacing=1.2,
        fontsize=_FONT_SIZE,
    )


def draw_effect_curves(findings: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> str:
    """Draw the torque of each finding over the quantity on which it depends, with its 90 % band.

    Args:
        findings: Entries of `findings` of `diagnosis.json` that have a curve.
        units: Unit of each joint's torque.
    """

    names = dict(zip(units, short_names(list(units), 26), strict=True))

    def draw(axes: Any, finding: Mapping[str, Any]) -> None:
        curve = finding["curve"]
        x, torque, std = (np.array(curve[key], float) for key in ("x", "torque", "std"))
        axes.axhline(0.0, color=GREY, linewidth=0.5)
        low, high = torque - QUANTILE * std, torque + QUANTILE * std
        axes.fill_between(x, low, high, color=BLUE, alpha=0.22, linewidth=0)
        axes.plot(x, torque, color=BLUE, linewidth=1.1)
        drawing.set_titles(axes, names[finding["joint"]], effect_words(finding["effect"]))
        kind = "resistance" if curve["opposes_motion"] else "torque"
        axes.set_ylabel(f"{kind} [{units[finding['joint']]}]")
        axes.set_xlabel(f"{curve['over']} [{curve['unit']}]")
        drawing.limit_ticks(axes, 5, 4)
        if curve["over"] == LOGARITHMIC_QUANTITY:  # from a fraction of a milliradian to a turn
            axes.set_xscale("log")
            drawing.set_decade_ticks(axes, divided=x.max() < 100.0 * x[x > 0.0].min(initial=np.inf))

    label = "Torque of the effects"
    return drawing.render_panels(label, findings, draw, _CURVE_HEIGHT, subtitles=True)


def held_out_predictions(diagnosis: Diagnosis, *, withheld: bool) -> Iterator[Prediction]:
    """Yield the held-out predictions: `nominal` is the base model, `fitted` the saved model.

    Args:
        diagnosis: The diagnosis.
        withheld: Whether the saved model is the base model, because findings are withheld.
    """
    held_out = diagnosis.held_out
    residuals = (
        split_by_motion(np.where(held_out.moving, residual, np.nan), held_out.motions)
        for residual in (held_out.base, held_out.base if withheld else held_out.final)
    )
    torque = split_by_motion(held_out.torque, held_out.motions)
    for source, group in itertools.groupby(
        zip(held_out.motions, torque, *residuals, strict=True),
        key=lambda entry: entry[0].segment.source,
    ):
        motions, torques, before, after = zip(*group, strict=True)
        measured = np.concatenate(torques)
        yield Prediction(
            source,
            np.concatenate([motion.time for motion in motions]),
            measured,
            measured - np.concatenate(before),
            measured - np.concatenate(after),
            diagnosis.noise.floor,
            tuple(np.cumsum([0, *(len(motion) for motion in motions)])[:-1].tolist()),
            np.concatenate([motion.moving for motion in motions]),
        )
