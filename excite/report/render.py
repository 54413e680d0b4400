"""Render a report with jinja2: one self-contained HTML file that loads nothing from elsewhere."""

from __future__ import annotations

from functools import cache
from typing import Any

from .content import ReportContent

NO_BREAK_PERCENT = "\u00a0%"
"""A percent sign stays in the line of its number."""


@cache
def _environment() -> Any:
    """The one environment of all templates: autoescape on, undefined names are errors."""
    import jinja2  # slow to import

    return jinja2.Environment(
        loader=jinja2.PackageLoader("excite", "report/templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_without_line_breaks,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def _without_line_breaks(value: Any) -> Any:
    """Bind percent signs to their numbers in plain text; markup passes unchanged."""
    return value.replace(" %", NO_BREAK_PERCENT) if type(value) is str else value


def render(template: str, content: ReportContent) -> str:
    """Render a report as HTML.

    Args:
        template: Name of the report: "design", "identifiability", "identification" or "diagnosis".
        content: Data of the report; all strings are escaped, only `Markup` is not.
    """
    return str(
        _environment()
        .get_template(f"{template}.html.j2")
        .render(content=content, sections={s.key: s for s in content.sections})
    )
