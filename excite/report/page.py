"""The HTML of a report: one file, nothing loaded from elsewhere, text that cannot be mistaken for markup."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

CSS = """
:root{--ink:#1c2530;--soft:#5b6775;--line:#dde2e8;--good:#1f7a4d;--bad:#b3261e;--warn:#8a5a00;--blue:#1f5fa8}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0 auto;max-width:62rem;padding:1.5rem 1.1rem 4rem;color:var(--ink);background:#fff;
font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif}
h1{font-size:1.7rem;line-height:1.2;margin:0 0 .2rem;overflow-wrap:anywhere}
h2{font-size:1.25rem;line-height:1.3;margin:2.6rem 0 .3rem;padding-top:.9rem;border-top:1px solid var(--line)}
h3{font-size:1rem;margin:1.3rem 0 .3rem}
p{margin:.35rem 0 .7rem;max-width:48rem}
.lede{color:var(--soft)}.answer{font-size:1.06rem}.note{color:var(--soft);font-size:.86rem}
.good{color:var(--good)}.bad{color:var(--bad)}.warn{color:var(--warn)}
.cards{display:grid;grid-template-columns:repeat(auto-fill,minmax(10.5rem,1fr));gap:.6rem;margin:1.1rem 0}
.card{border:1px solid var(--line);border-radius:.5rem;padding:.55rem .75rem}
.card b{display:block;font-size:1.2rem;line-height:1.3;overflow-wrap:anywhere}.card span{color:var(--soft);font-size:.82rem}
.banner{border-left:.3rem solid;padding:.5rem .8rem;margin:.6rem 0;background:#f7f8fa;border-radius:0 .4rem .4rem 0}
nav{font-size:.92rem;margin:1.2rem 0}nav ol{margin:.3rem 0;padding-left:1.4rem;columns:22rem;column-gap:2rem}
nav a{color:var(--blue);text-decoration:none}nav a:hover{text-decoration:underline}
.figure{margin:.8rem 0;overflow-x:auto}.figure svg{display:block;width:100%;height:auto}
.table{overflow-x:auto;margin:.6rem 0}
table{border-collapse:collapse;font-size:.88rem;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .9rem .25rem 0;text-align:left;vertical-align:top;border-bottom:1px solid var(--line)}
th{font-weight:600;color:var(--soft);white-space:nowrap}td.n,th.n{text-align:right;white-space:nowrap}
td code{white-space:normal;overflow-wrap:anywhere}
code{font:.9em ui-monospace,SFMono-Regular,Menlo,Consolas,monospace}
.meter{display:inline-block;width:5.5rem;height:.6rem;background:#e9edf1;border-radius:.2rem;overflow:hidden;vertical-align:middle}
.meter i{display:block;height:100%;background:#2f6fb5}.meter.low i{background:#c98a1b}.meter.none i{background:#b3261e}
ul{padding-left:1.2rem;margin:.4rem 0}li{margin:.15rem 0}
details{margin:.6rem 0}summary{cursor:pointer;color:var(--blue)}
footer{margin-top:3rem;color:var(--soft);font-size:.85rem}
@media (max-width:40rem){body{font-size:15px;padding:1rem .8rem 3rem}.figure svg{min-width:44rem}}
@media print{body{max-width:none;font-size:10pt;padding:0}.figure,.table,.cards{break-inside:avoid}h2,.answer{break-after:avoid}
nav{display:none}.figure{overflow:visible}a{color:inherit}}
"""


@dataclass(frozen=True)
class Section:
    """A question, its answer in one sentence (plain text), and what shows it (HTML)."""

    key: str
    question: str
    answer: str
    body: str
    tone: str = ""


def escape(text: object) -> str:
    """Text as it may stand in HTML, in an attribute too."""
    return html.escape(str(text).replace(" %", "\u00a0%"), quote=True)


def number(value: float | None, digits: int = 4) -> str:
    """A number for people: '1.234', '−0.05', '3.1e-7'; '–' where there is none."""
    if value is None or np.isnan(value):
        return "–"
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa}·{power_of_ten(int(exponent))}"
    return text.replace("-", "−")


def power_of_ten(exponent: int) -> str:
    """'10⁻³'."""
    return "10" + "".join("⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".index(c)] for c in str(exponent))


def plural(count: int, noun: str) -> str:
    """'1 joint', '3 joints'."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f"<p{f' class={chr(34)}{kind}{chr(34)}' if kind else ''}>{escape(text)}</p>"


def figure(svg: str) -> str:
    """A plot, scrolled sideways where the screen is narrower than it can be read."""
    return f'<div class="figure">{svg}</div>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Iterable[int] = ()) -> str:
    """A table of cells that are HTML already (use `escape`); `numeric` columns are right-aligned."""
    right = set(numeric)

    def line(tag: str, cells: Sequence[str]) -> str:
        return (
            "<tr>"
            + "".join(
                f'<{tag} class="n">{c}</{tag}>' if k in right else f"<{tag}>{c}</{tag}>"
                for k, c in enumerate(cells)
            )
            + "</tr>"
        )

    body = "".join(line("td", row) for row in rows)
    return f'<div class="table"><table><thead>{line("th", [escape(h) for h in head])}</thead><tbody>{body}</tbody></table></div>'


def folded(summary: str, body: str, *, unfolded: bool = False) -> str:
    """What one may look up but need not read."""
    return f"<details{' open' if unfolded else ''}><summary>{escape(summary)}</summary>{body}</details>"


def bullets(lines: Iterable[str]) -> str:
    """A list of plain texts."""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def meter(share: float, *, broken: bool = False) -> str:
    """A small bar for how much of something is used; red where more than all."""
    kind = " none" if broken else " low" if share > 0.98 else ""
    width = 100.0 if broken else 100.0 * min(max(share, 0.0), 1.0)
    return f'<span class="meter{kind}"><i style="width:{width:.0f}%"></i></span>'


def cards(entries: Iterable[tuple[str, str]]) -> str:
    """Headline figures: (value, what it is)."""
    return (
        '<div class="cards">'
        + "".join(
            f'<div class="card"><b>{escape(v)}</b><span>{escape(k)}</span></div>'
            for v, k in entries
        )
        + "</div>"
    )


def banner(text: str, tone: str) -> str:
    """A line that must not be overlooked. tone: good, warn or bad."""
    return f'<p class="banner {tone}">{escape(text)}</p>'


def _section(s: Section) -> str:
    tone = f"answer {s.tone}".strip()
    return f'<section id="{s.key}"><h2>{escape(s.question)}</h2><p class="{tone}">{escape(s.answer)}</p>{s.body}</section>'


def page(title: str, lede: str, head: str, sections: Sequence[Section], foot: str) -> str:
    """The whole document. `head` is HTML between the title and the table of contents."""
    contents = "".join(f'<li><a href="#{s.key}">{escape(s.question)}</a></li>' for s in sections)
    body = "".join(map(_section, sections))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{CSS}</style></head><body>"
        f'<header><h1>{escape(title)}</h1><p class="lede">{escape(lede)}</p>{head}</header>'
        f'<nav aria-label="Contents"><ol>{contents}</ol></nav><main>{body}</main><footer>{escape(foot)}</footer></body></html>\n'
    )
