"""The table of a trial: what was asked, and what every analyst reached."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

ROWS = (
    ("cases answered", "", "answered"),
    ("dense: recall at unique severity 1", "≥ 0.90", "dense_recall_1"),
    ("dense: recall at unique severity 3", "≥ 0.95", "dense_recall_3"),
    ("dense: precision (effect and joint)", "≥ 0.95", "dense_precision"),
    ("half-dense: recall at unique severity 1", "≥ 0.90", "half_dense_recall_1"),
    ("half-dense: recall at unique severity 3", "", "half_dense_recall_3"),
    ("half-dense: precision", "≥ 0.90", "half_dense_precision"),
    ("dense: special effect named", "≥ 0.80", "special"),
    ("severity intervals of 90 % cover the truth", "0.80-0.97", "severity_coverage"),
    ("dense: held-out gain over the oracle's, median", "≥ 0.95", "gain_median"),
    ("… 10 % quantile", "≥ 0.85", "gain_low"),
    ("dense: RMSE over the oracle's, median", "≤ 1.25", "oracle_ratio"),
    ("sparse: right name first, severity 3 and above", "≥ 0.90", "sparse_first_from 3"),
    ("sparse: right name first, near 1", "≥ 0.75", "sparse_first_near 1"),
    ("sparse: recall at unique severity 1", "", "sparse_recall_1"),
    ("sparse: precision", "≥ 0.90", "sparse_precision"),
    ("equivalents per finding, mean", "", "equivalents"),
    ("null: something asserted", "≤ 0.02", "null_asserted"),
    ("out of catalogue: unknown, and nothing named", "≥ 0.80", "unknown_not_named"),
    ("… unknown reported", "", "unknown_reported"),
    ("model re-read, RMSE over the claimed one, largest", "≤ 1.01", "model_ratio"),
    ("processor seconds, dense, median", "≤ 20", "seconds"),
    ("… of all cases, largest", "", "seconds_max"),
    ("relative parameter error, median", "", "parameter_error"),
    ("parameter ± 2 std covers the truth", "", "parameter_coverage"),
)
"""Rows of the table: words, required value and key of the score."""


def table(scores: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a Markdown table with a row per figure and a column per analyst.

    Each rate has its 95 % interval, each figure the number of cases or findings.
    """
    lines = [f"| | asked | {' | '.join(scores)} |", "|---|---" + "|---" * len(scores) + "|"]
    for words, asked, key in ROWS:
        cells = (_cell(figures[key]) for figures in scores.values())
        lines.append(f"| {words} | {asked} | {' | '.join(cells)} |")
    probabilities = [figures["probability"] for figures in scores.values()]
    losses = (
        "–" if not p["count"] else f"{p['log_loss']:.3f}; {p['base_rate_log_loss']:.3f}"
        for p in probabilities
    )
    lines.append(f"| log loss; of the base rate | lower | {' | '.join(losses)} |")
    errors = ("–" if p["error"] is None else f"{p['error']:.3f}" for p in probabilities)
    lines.append(f"| reliability, largest error of a bin of ≥ 30 | ≤ 0.05 | {' | '.join(errors)} |")
    for name, p in zip(scores, probabilities, strict=True):
        bins = (f"{b['reported']:.2f}: {b['observed']:.2f} ({b['count']})" for b in p["bins"])
        lines.append(f"\n{name}, probability reported: share right (count): {'; '.join(bins)}")
    return "\n".join(lines)


def _cell(figure: Mapping[str, Any]) -> str:
    """Return a value with its interval and count, as a cell of the table."""
    if figure["value"] is None:
        return "–"
    low, high = figure.get("interval", (None, None))
    spread = "" if low is None else f" [{low:.2f}-{high:.2f}]"
    return f"{figure['value']:.3g}{spread} ({figure['count']})"
