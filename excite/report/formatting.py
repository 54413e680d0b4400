"""Numbers and counts as reports print them."""

from __future__ import annotations

import numpy as np

from ..recordings.remark import shown_time

MAX_SHOWN_ODDS = 1000.0
"""Odds beyond which they are not written out [1]."""


def odds_words(log_odds: float | None) -> str:
    """Format odds: '150 : 1', '1 : 4', '> 1000 : 1'; '–' for None.

    Args:
        log_odds: Logarithm of the odds [nat].
    """
    if log_odds is None:
        return "–"
    shown = min(float(np.exp(min(abs(log_odds), 700.0))), MAX_SHOWN_ODDS)
    larger = f"{float(f'{shown:.2g}'):g}"
    is_clipped = shown == MAX_SHOWN_ODDS
    if log_odds >= 0.0:
        return f"{'> ' if is_clipped else ''}{larger} : 1"
    return f"{'< ' if is_clipped else ''}1 : {larger}"


def number(value: float | None, digits: int = 4) -> str:
    """Format a number: '1.234', '−0.05', '3.1·10⁻⁷'; '–' for None and NaN."""
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
    """Format a power of ten with superscript digits: '10⁻³'."""
    return "10" + "".join("⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".index(c)] for c in str(exponent))


def capitalized(text: str) -> str:
    """Raise the first letter and keep all others, unlike `str.capitalize`."""
    return text[:1].upper() + text[1:]


def uncapitalized(text: str) -> str:
    """Lower the first letter, so that the text may stand inside a sentence."""
    return text[:1].lower() + text[1:]


def significant(value: float, digits: int = 2) -> str:
    """Format a number with its trailing zeros and without a power of ten: '0.20', '1.0', '160'."""
    if not np.isfinite(value) or not 1e-4 <= abs(value) < 1e5:
        return number(value, digits)
    rounded = float(f"{value:.{digits}g}")
    decimals = max(digits - 1 - int(np.floor(np.log10(abs(rounded)))), 0)
    return f"{rounded:.{decimals}f}".replace("-", "−")


def value_with_error(value: float, std: float | None, unit: str) -> str:
    """Format a value with its standard error and unit, to the same decimal: '1.85 ± 0.46 N m'."""
    unit = "" if unit == "1" else unit
    if std is None or not 1e-4 <= std < 1e5 or abs(value) >= 1e5:
        error = "" if std is None else f" ± {number(std, 2)}"
        return f"{number(value, 3)}{error} {unit}".rstrip()
    decimals = 1 - int(np.floor(np.log10(std)))
    text = f"{round(value, decimals):.{max(decimals, 0)}f}".replace("-", "−")
    return f"{text} ± {significant(std)} {unit}".rstrip()


def seconds_between(start: float, end: float) -> str:
    """Format an interval of time: '1 to 1.12'."""
    return f"{shown_time(start)} to {shown_time(end)}"
