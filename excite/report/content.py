"""Plain data that the templates of a report render: sections, tables and their cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class TableCell:
    """A cell that needs more than plain text.

    Attributes:
        text: The text, escaped by the template.
        tone: "good", "warn" or "bad" colours the text.
        bold: Whether the text is printed bold.
        code: Whether the text is an expression in a fixed-width font.
        before: Plain text in front of a bold text, such as "0.3 → ".
        after: Text behind it in the tone `after_tone`, such as "± 0.1".
        after_tone: Tone of `after`.
        note: Small text below.
        share: Draws a bar of this share (0 to 1) in front of the text.
        exceeded: Whether the bar is drawn full and red.
    """

    text: str
    tone: str = ""
    bold: bool = False
    code: bool = False
    before: str = ""
    after: str = ""
    after_tone: str = ""
    note: str = ""
    share: float | None = None
    exceeded: bool = False


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Attributes:
        head: Title of each column.
        rows: Cells of each row, as many as there are titles.
        numeric: Indices of the columns that are aligned to the right.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str | TableCell]]
    numeric: Sequence[int] = ()

    def split(self, count: int) -> tuple[Table, Table]:
        """Return the first `count` rows and the others as two tables."""
        return (
            Table(self.head, self.rows[:count], self.numeric),
            Table(self.head, self.rows[count:], self.numeric),
        )


@dataclass(frozen=True)
class Section:
    """A question, its answer in a sentence or two, and the data that support it.

    Attributes:
        key: Identifier of the section in links.
        question: Heading.
        answer: Answer, plain text.
        data: Tables, figures (as `Markup`) and values that the template of the report shows.
        tone: "good", "warn" or "bad" colours the answer.
    """

    key: str
    question: str
    answer: str
    data: Mapping[str, Any] = field(default_factory=dict)
    tone: str = ""


@dataclass(frozen=True)
class Banner:
    """A line at the head of a report; tone: "good", "warn", "bad", or "" for none."""

    text: str
    tone: str


@dataclass(frozen=True)
class ReportContent:
    """Everything that a template needs to render a report.

    Attributes:
        title: Title of the page.
        subtitle: One sentence on what the report is about.
        banners: The answer to the reader's first question, and warnings.
        cards: Key figures: (value, its meaning).
        sections: Sections in their order.
        footer: Version and seed.
    """

    title: str
    subtitle: str
    banners: Sequence[Banner]
    cards: Sequence[tuple[str, str]]
    sections: Sequence[Section]
    footer: str
