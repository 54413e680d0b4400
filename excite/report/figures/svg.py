"""Elements of SVG pictures, and the clean-up of those that matplotlib writes.

Matplotlib draws most figures (see `drawing`). Grids of small panels and tables of shades are
assembled from the elements below: a robot of 30 joints needs 150 panels, too many for matplotlib.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence

import numpy as np

from ..._types import FloatArray

UNITS_PER_INCH = 72.0
"""Units of a picture's coordinates in an inch, as matplotlib writes them."""
PIXELS_PER_INCH = 96.0
"""CSS pixels in an inch."""


def escape(text: object) -> str:
    """Escape text for an element or an attribute; a percent sign stays with its number."""
    return html.escape(str(text).replace(" %", "\u00a0%"), quote=True)


def coordinate(value: float) -> str:
    """Format a coordinate with a tenth of a unit."""
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


def points_of(x: FloatArray, y: FloatArray) -> list[str]:
    """Format points for a path.

    Args:
        x: Shape (N,).
        y: Shape (N,).
    """
    return [f"{coordinate(a)} {coordinate(b)}" for a, b in zip(x, y, strict=True)]


def line(
    x1: float,
    y1: float,
    x2: float,
    y2: float,
    color: str,
    *,
    width: float = 0.8,
    dashed: bool = False,
    opacity: float = 1.0,
) -> str:
    """Draw a straight line."""
    dash = ' stroke-dasharray="4 2"' if dashed else ""
    path = f"M{coordinate(x1)} {coordinate(y1)}L{coordinate(x2)} {coordinate(y2)}"
    return f'<path d="{path}" stroke="{color}" stroke-width="{width:g}"{dash}{_stroke(opacity)}/>'


def curve(
    points: Sequence[str],
    color: str,
    *,
    width: float = 1.0,
    opacity: float = 1.0,
    closed: bool = False,
) -> str:
    """Draw a line through points from `points_of`."""
    path = f"M{'L'.join(points)}{'Z' if closed else ''}"
    return (
        f'<path d="{path}" fill="none" stroke="{color}" stroke-width="{width:g}" '
        f'stroke-linejoin="round"{_stroke(opacity)}/>'
    )


def polygon(points: Sequence[str], color: str, opacity: float) -> str:
    """Fill the area between points from `points_of`."""
    return f'<path d="M{"L".join(points)}Z" fill="{color}" fill-opacity="{opacity:.2g}"/>'


def rectangle(
    x: float,
    y: float,
    width: float,
    height: float,
    color: str,
    *,
    opacity: float = 1.0,
    stroke: str = "",
) -> str:
    """Fill a rectangle, with an outline where `stroke` is a colour."""
    alpha = "" if opacity == 1.0 else f' fill-opacity="{opacity:g}"'
    outline = f' stroke="{stroke}" stroke-width=".4"' if stroke else ""
    place = f'x="{coordinate(x)}" y="{coordinate(y)}"'
    size = f'width="{coordinate(width)}" height="{coordinate(height)}"'
    return f'<rect {place} {size} fill="{color}"{alpha}{outline}/>'


def circle(
    x: float, y: float, radius: float, color: str, *, opacity: float = 1.0, stroke: str = ""
) -> str:
    """Fill a circle."""
    alpha = "" if opacity == 1.0 else f' opacity="{opacity:g}"'
    outline = f' stroke="{stroke}" stroke-width=".8"' if stroke else ""
    place = f'cx="{coordinate(x)}" cy="{coordinate(y)}"'
    return f'<circle {place} r="{radius:g}" fill="{color}"{alpha}{outline}/>'


def text(
    x: float,
    y: float,
    content: str,
    *,
    size: float,
    anchor: str = "",
    color: str = "",
    weight: int = 0,
    rotation: float = 0.0,
) -> str:
    """Set a line of text; anchor: "middle" or "end"; rotation [degrees] about its beginning."""
    place = f'x="{coordinate(x)}" y="{coordinate(y)}"'
    if rotation:
        place = f'transform="translate({coordinate(x)} {coordinate(y)}) rotate({rotation:g})"'
    extra = f' text-anchor="{anchor}"' if anchor else ""
    extra += f' fill="{color}"' if color else ""
    extra += f' font-weight="{weight}"' if weight else ""
    return f'<text {place} font-size="{size:g}"{extra}>{escape(content)}</text>'


def picture(label: str, width: float, height: float, elements: Iterable[str], color: str) -> str:
    """Assemble a picture.

    Args:
        label: Description for screen readers.
        width: Width in units; the picture is never shown wider than this.
        height: Height in units.
        elements: Elements in the order in which they are drawn.
        color: Colour of texts.
    """
    box = f'viewBox="0 0 {coordinate(width)} {coordinate(height)}"'
    style = f"max-width:{width / UNITS_PER_INCH * PIXELS_PER_INCH:.0f}px"
    return (
        f'<svg {box} role="img" aria-label="{escape(label)}" style="{style}" '
        f'font-family="sans-serif" fill="{color}">{"".join(elements)}</svg>'
    )


def round_ticks(low: float, high: float, at_least: int) -> list[float]:
    """Round numbers within a range, 1, 2 or 5 times a power of ten apart.

    Args:
        low: Lower end of the range.
        high: Upper end of the range.
        at_least: Number of ticks that are wanted; the widest spacing that has as many is taken.
    """
    power = 10.0 ** np.ceil(np.log10(high - low))
    for step in (s * power * scale for scale in (1.0, 0.1, 0.01) for s in (1.0, 0.5, 0.2)):
        count = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1.0)
        if len(count) >= at_least:
            break
    return [float(v) for v in count * step + 0.0]


def shorten(svg: str, label: str, width: float) -> str:
    """Remove from matplotlib's SVG what HTML does not need.

    Prolog, metadata, comments, ids of groups, excess digits and font families go; texts stay.

    Args:
        svg: Picture as matplotlib writes it.
        label: Description for screen readers.
        width: Largest width at which it is shown [in].
    """
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r"<!--.*?-->", "", svg, flags=re.S)
    svg = re.sub(r"<[^>]*>", _shorten_tag, svg)
    box = re.search(r'viewBox="[^"]*"', svg)
    style = f"max-width:{width * PIXELS_PER_INCH:.0f}px"
    head = f'<svg {box[0] if box else ""} role="img" aria-label="{escape(label)}" style="{style}">'
    svg = head + svg[svg.index(">") + 1 :]
    return re.sub(r">\s+<", "><", svg).strip()


def standalone(svg: str) -> str:
    """Add the namespaces that an SVG file needs outside of HTML."""
    namespaces = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    return svg.replace("<svg ", f"<svg {namespaces} ", 1)


def _shorten_tag(tag: re.Match[str]) -> str:
    """Shorten one tag; text between tags, such as names, stays."""
    content = re.sub(r'^<g id="[^"]*"', "<g", tag[0]).replace("xlink:href", "href")
    content = re.sub(r'(?<= d=")[^"]*', _shorten_path, content)
    content = re.sub(r"\d+\.\d{3,}", lambda m: f"{float(m[0]):.2f}", content)
    content = re.sub(r"font-family:[^;\"]*", "font-family: sans-serif", content)
    return re.sub(r"(font: [^;\"]*?px) [^;\"]*", r"\1 sans-serif", content)


def _shorten_path(path: re.Match[str]) -> str:
    """Round the coordinates of a path."""
    return re.sub(r"-?\d+\.\d+", lambda m: coordinate(float(m[0])), " ".join(path[0].split()))


def _stroke(opacity: float) -> str:
    """Attribute for the opacity of a line."""
    return "" if opacity == 1.0 else f' stroke-opacity="{opacity:g}"'
