"""The residual atlas as pictures: one table for the robot, one picture a joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...diagnosis.residual_atlas import SIGNIFICANT, Atlas, Panel
from ...diagnosis.residual_curves import Kind
from ..page import escape
from .drawing import BLUE, FIGURE_WIDTH, GREY, INK, ORANGE, RED, SOFT, thin_curve
from .heatmap import Heat, heat
from .small_multiples import ticks
from .trajectory import short

Array = np.ndarray
_COLUMNS = 4
_TOTAL = FIGURE_WIDTH * 72.0
_LEFT, _RIGHT, _GAP, _TOP, _HEIGHT, _STEP = 32.0, 6.0, 32.0, 44.0, 74.0, 128.0
_OTHER = "speed of "
_ORDER = (
    "speed",
    "direction",
    "load",
    "load, along the motion",
    "position",
    "position, along the motion",
    "order",
)
_PHASES = {-2.0: "− faster", -1.0: "− slower", 1.0: "+ slower", 2.0: "+ faster"}


def drawn(panels: Sequence[Panel]) -> list[Panel]:
    """A joint's curves as they are shown: of the other joints' speeds the one that stands out most."""
    others = [p for p in panels if p.against.startswith(_OTHER)]
    own = [p for p in panels if not p.against.startswith(_OTHER)]
    return [*own, max(others, key=lambda p: p.score_before)] if others else own


def overview(atlas: Atlas, joints: Sequence[str]) -> str:
    """Joints across what the residual was looked at against: shaded by how much of it shows there, blank where it may be noise."""
    rows = {j: {_column(p): p for p in drawn(atlas.of(j))} for j in range(len(joints))}
    known = dict.fromkeys(
        name for row in sorted(rows.values(), key=len, reverse=True) for name in row
    )
    columns = [
        *(name for name in _ORDER if name in known),
        *(name for name in known if name not in _ORDER),
    ]
    values, words = (
        np.full((len(joints), len(columns)), np.nan),
        [[""] * len(columns) for _ in joints],
    )
    marked = np.zeros(values.shape, bool)
    for j, row in rows.items():
        for name, p in row.items():
            k = columns.index(name)
            if p.p_before < SIGNIFICANT:
                values[j, k] = p.share_before
                words[j][k] = f"{100 * p.share_before:.0f} %"
            marked[j, k] = p.p_after < SIGNIFICANT
    names = [short(joint, 22) for joint in joints]
    return heat(
        "Which joints' residual shows against what",
        Heat(names, columns, values, words, marked),
        cell=(46.0, 20.0),
    )


def _column(panel: Panel) -> str:
    return "another joint's speed" if panel.against.startswith(_OTHER) else panel.against


def joint_figure(
    panels: Sequence[Panel], joint: str, unit: str, floor: float, *, changed: bool
) -> str:
    """All curves of a joint, before and after the findings, against the noise floor. changed: there are findings."""
    shown = drawn(panels)
    reach = _reach(shown, floor, changed=changed)
    parts = _legend(changed=changed)
    parts.append(_text(_LEFT, 11.0, f"residual [{unit}], one scale for all", size=7.5, color=SOFT))
    width = (_TOTAL - _LEFT - _RIGHT - _GAP * (_COLUMNS - 1)) / _COLUMNS
    for k, panel in enumerate(shown):
        row, column = divmod(k, _COLUMNS)
        frame = Frame.of(
            panel,
            _LEFT + column * (width + _GAP),
            _TOP + row * _STEP,
            width,
            reach[panel.kind is Kind.AMPLITUDE],
        )
        parts += _panel(frame, panel, floor, changed=changed)
    bottom = _TOP + -(-len(shown) // _COLUMNS) * _STEP - 24.0
    head = f'<svg viewBox="0 0 {_TOTAL:g} {bottom:g}" role="img" aria-label="{escape(f"Held-out residual of {joint} against everything")}" '
    return f'{head}style="max-width:{FIGURE_WIDTH * 96:.0f}px" font-family="sans-serif" fill="{INK}">{"".join(parts)}</svg>'


@dataclass(frozen=True)
class Frame:
    """A panel's place in the SVG and its scales. low, high: of x, as drawn (logarithm, or number of the bin)."""

    x: float
    y: float
    width: float
    low: float
    high: float
    floor: float
    reach: float

    @classmethod
    def of(cls, panel: Panel, x: float, y: float, width: float, reach: float) -> Frame:
        """The frame that a panel's curve fills."""
        at = places(panel)
        pad = 0.4 if panel.against == "direction" else 0.04 * float(np.ptp(at))
        amplitude = panel.kind is Kind.AMPLITUDE
        return cls(
            x,
            y,
            width,
            float(at.min()) - pad,
            float(at.max()) + pad,
            0.0 if amplitude else -reach,
            reach,
        )

    def across(self, at: Array | float) -> Array:
        return np.asarray(
            self.x + self.width * (np.asarray(at) - self.low) / (self.high - self.low)
        )

    def up(self, value: Array | float) -> Array:
        inside = np.clip(value, self.floor, self.reach)
        return np.asarray(
            self.y + _HEIGHT * (1.0 - (inside - self.floor) / (self.reach - self.floor))
        )

    def curve(self, at: Array, values: Array) -> list[str]:
        """Points of a path."""
        return [f"{a:.1f} {b:.1f}" for a, b in zip(self.across(at), self.up(values), strict=True)]


def places(panel: Panel) -> Array:
    """Where the centres lie along the axis."""
    if panel.against == "direction":
        return np.arange(len(panel.centres), dtype=float)
    return np.log10(panel.centres) if panel.logarithmic else panel.centres


def _reach(shown: Sequence[Panel], floor: float, *, changed: bool) -> dict[bool, float]:
    """Largest value on the axis of means, and of amplitudes: one scale a joint, so that what is large looks large."""
    out = {}
    for kind in (False, True):
        own = [p for p in shown if (p.kind is Kind.AMPLITUDE) is kind]
        curves = [p.mean_before for p in own] + ([p.mean_after for p in own] if changed else [])
        out[kind] = 1.15 * max([floor, *(float(np.abs(c).max()) for c in curves)])
    return out


def _panel(frame: Frame, panel: Panel, floor: float, *, changed: bool) -> list[str]:
    at, seen, right = places(panel), panel.p_before < SIGNIFICANT, frame.x + frame.width
    bottom, title = frame.y + _HEIGHT, INK if seen else SOFT
    text = probability(panel.p_before) + (f" → {probability(panel.p_after)}" if changed else "")
    parts = [
        _text(
            frame.x,
            frame.y - 13.0,
            short(panel.against, 32),
            size=8.0,
            color=title,
            weight=600 if seen else 0,
        ),
        _text(frame.x, frame.y - 4.0, text, size=6.5, color=RED if seen else SOFT),
    ]
    low, high = (
        float(frame.up(v)) for v in (0.0 if panel.kind is Kind.AMPLITUDE else -floor, floor)
    )
    parts += _axes(frame, panel, bottom)
    parts.append(
        f'<path d="M{frame.x:.1f} {low:.1f}H{right:.1f}V{high:.1f}H{frame.x:.1f}Z" fill="{GREY}" fill-opacity=".35"/>'
    )
    parts.append(_line(frame.x, float(frame.up(0.0)), right, float(frame.up(0.0)), GREY, 0.5))
    faint = 1.0 if seen else 0.45
    if panel.kind is not Kind.AMPLITUDE:
        above, below = (
            frame.curve(at, panel.mean_before + sign * 2.0 * panel.error) for sign in (1.0, -1.0)
        )
        parts.append(
            f'<path d="M{"L".join([*above, *reversed(below)])}Z" fill="{ORANGE}" fill-opacity="{0.22 * faint:.2g}"/>'
        )
    curves = [(panel.mean_before, ORANGE), *([(panel.mean_after, BLUE)] if changed else [])]
    for values, color in curves:
        parts.append(_path(thinned(frame, at, values), color, faint))
        if len(at) <= 30:
            parts += [f'<circle cx="{a}" cy="{b}" r="1.5" fill="{color}" opacity="{faint:g}"/>'
                      for a, b in (point.split() for point in frame.curve(at, values))]  # fmt: skip
    return [
        *parts,
        _line(frame.x, frame.y, frame.x, bottom, RED if seen else GREY, 2.0 if seen else 0.8),
    ]


def thinned(frame: Frame, at: Array, values: Array) -> list[str]:
    """Points of a curve that a small panel can show."""
    return frame.curve(*thin_curve(at, values, 160))


def _axes(frame: Frame, panel: Panel, bottom: float) -> list[str]:
    parts = [_line(frame.x, bottom, frame.x + frame.width, bottom, GREY, 0.8)]
    if panel.against == "direction":
        marks = [(float(k), _PHASES[float(v)]) for k, v in enumerate(panel.centres)]
    elif panel.logarithmic:
        powers = [s * 10.0**e for e in range(-6, 7) for s in (1.0, 2.0, 5.0)]
        seen = [v for v in powers if frame.low <= np.log10(v) <= frame.high]
        tens = [v for v in seen if f"{v:e}"[0] == "1"]
        marks = [
            (float(np.log10(v)), plain(v))
            for v in (tens if len(seen) > 5 and len(tens) > 1 else seen)
        ]
    else:
        marks = [(v, plain(v)) for v in ticks(frame.low, frame.high, 3)]
    for at, word in marks:
        x = float(frame.across(at))
        parts += [
            _line(x, frame.y, x, bottom, "#eef1f4", 0.6),
            _text(x, bottom + 9.0, word, size=6.5, anchor="middle", color=SOFT),
        ]
    for value in ticks(frame.floor, frame.reach, 3):
        y = float(frame.up(value))
        parts += [_line(frame.x, y, frame.x + frame.width, y, "#eef1f4", 0.6)]
        parts.append(
            _text(frame.x - 3.0, y + 2.4, plain(value), size=6.5, anchor="end", color=SOFT)
        )
    if panel.unit:
        parts.append(
            _text(
                frame.x + 0.5 * frame.width,
                bottom + 18.0,
                f"[{panel.unit}]",
                size=6.5,
                anchor="middle",
                color=SOFT,
            )
        )
    return parts


def probability(p: float) -> str:
    """'p ≤ .001', 'p = .03'."""
    return "p ≤ .001" if p <= 0.001 else f"p = {plain(float(f'{p:.2g}'))}"


def plain(value: float) -> str:
    """A number for a small figure: '.005', '20' (three digits behind a zero would be cut as excess ones of the drawing)."""
    text = f"{value:g}".replace("-", "−")
    return text.replace("0.", ".", 1) if text.removeprefix("−").startswith("0.") else text


def _legend(*, changed: bool) -> list[str]:
    """What lines and shades mean, set from the right."""
    entries = [(ORANGE, 1.4, 1.0, "base model"), (ORANGE, 7.0, 0.22, "±2 standard errors")]
    if changed:
        entries.append((BLUE, 1.4, 1.0, "with the findings"))
    entries += [
        (GREY, 7.0, 0.35, "noise floor"),
        (RED, 2.0, 1.0, f"p < {plain(SIGNIFICANT)}, all looks counted"),
    ]
    x, parts = _TOTAL - _RIGHT, list[str]()
    for color, width, opacity, word in reversed(entries):
        x -= 4.2 * len(word)
        parts.append(_text(x, 11.0, word, size=7.5))
        parts.append(
            f'<path d="M{x - 20.0:.1f} 8.5h15" stroke="{color}" stroke-width="{width:g}" stroke-opacity="{opacity:g}"/>'
        )
        x -= 30.0
    return parts


def _path(points: Sequence[str], color: str, opacity: float) -> str:
    return f'<path d="M{"L".join(points)}" fill="none" stroke="{color}" stroke-width="1.1" stroke-opacity="{opacity:g}"/>'


def _line(x1: float, y1: float, x2: float, y2: float, color: str, width: float) -> str:
    return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="{color}" stroke-width="{width:g}"/>'


def _text(
    x: float,
    y: float,
    text: str,
    *,
    size: float,
    anchor: str = "",
    color: str = "",
    weight: int = 0,
) -> str:
    extra = f' text-anchor="{anchor}"' if anchor else ""
    extra += f' fill="{color}"' if color else ""
    extra += f' font-weight="{weight}"' if weight else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}"{extra}>{escape(text)}</text>'
