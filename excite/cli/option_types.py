"""Types of numeric command-line options: each states the accepted range and the unit.

An option with one of these types refuses, before its command runs, a text that is no number, not
finite, or outside the range; `argparse` prepends the name of the option to the message. Options
whose values are names, paths or words of a list need no type.
"""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from ..physical_ranges import Range

MAX_SHOWN = 40
"""Largest number of characters of an option's text that a message repeats."""


def _shown(text: str) -> str:
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"


@dataclass(frozen=True)
class Number:
    """One number.

    Attributes:
        accepted: Its range.
        whole: True for integers.
    """

    accepted: Range
    whole: bool = False

    def __call__(self, text: str) -> float:
        """Parse the text of an option.

        Raises:
            ArgumentTypeError: The text has another form, or a number is out of range.
        """
        kind = "a whole number" if self.whole else "a number"
        try:
            value = int(text) if self.whole else float(text)
        except ValueError as error:
            raise ArgumentTypeError(f"'{_shown(text)}' should be {kind} {self.accepted}") from error
        # Python compares integers with infinity exactly, however many digits they have.
        if not (
            self.accepted.lower <= value <= self.accepted.upper and self.accepted.accepts(value)
        ):
            raise ArgumentTypeError(f"{_shown(text)} should be {kind} {self.accepted}")
        return value


@dataclass(frozen=True)
class Numbers:
    """Numbers separated by commas.

    Attributes:
        accepted: Range of all numbers, or one range for each of them.
        counts: Accepted counts of numbers; None: any, the robot decides.
        increasing: True if every number has to be above the previous one.
    """

    accepted: Range | Sequence[Range]
    counts: Sequence[int] | None = None
    increasing: bool = False

    def __call__(self, text: str) -> tuple[float, ...]:
        """Parse the text of an option.

        Raises:
            ArgumentTypeError: The text has another form, or a number is out of range.
        """
        words = text.split(",")
        if self.counts is not None and len(words) not in self.counts:
            raise ArgumentTypeError(
                f"{_shown(text)} should hold {' or '.join(map(str, self.counts))} number(s), not "
                f"{len(words)}"
            )
        ranges = [self.accepted] * len(words) if isinstance(self.accepted, Range) else self.accepted
        values = tuple(
            Number(accepted)(word) for word, accepted in zip(words, ranges, strict=False)
        )
        if self.increasing and any(second <= first for first, second in pairwise(values)):
            raise ArgumentTypeError(f"{_shown(text)} should hold increasing numbers")
        return values


@dataclass(frozen=True)
class NamedNumbers:
    """A name and the numbers assigned to it: `joint=0.5`, `link:1.5,0,0,0.1`.

    Attributes:
        form: The form, for messages: "NAME=VALUE".
        separator: Separator of name and numbers; its last occurrence separates.
        numbers: Type of the numbers.
    """

    form: str
    separator: str
    numbers: Numbers

    def __call__(self, text: str) -> tuple[str, tuple[float, ...]]:
        """Parse the text of an option.

        Raises:
            ArgumentTypeError: The text has another form, or a number is out of range.
        """
        name, separator, numbers = text.rpartition(self.separator)
        if not separator:
            raise ArgumentTypeError(f"{_shown(text)} should read {self.form}")
        return name, self.numbers(numbers)


@dataclass(frozen=True)
class WordOrNumbers:
    """One of several words, or numbers instead.

    Attributes:
        words: Accepted words.
        numbers: Type of the numbers.
    """

    words: Sequence[str]
    numbers: Numbers

    def __call__(self, text: str) -> str | tuple[float, ...]:
        """Parse the text of an option.

        Raises:
            ArgumentTypeError: The text has another form, or a number is out of range.
        """
        if text in self.words:
            return text
        try:
            return self.numbers(text)
        except ArgumentTypeError as error:
            raise ArgumentTypeError(f"{error}, or be one of {', '.join(self.words)}") from error


@dataclass(frozen=True)
class ColumnNames:
    """Names of columns: `t=Time,q.elbow=pos 3`.

    Attributes:
        prefixes: Prefixes of the quantities of joints.
        signals: First words of further columns, those of a floating base.
    """

    prefixes: Sequence[str]
    signals: Sequence[str] = ()

    def __call__(self, text: str) -> dict[str, str]:
        """Return the names in the file by standard name.

        Raises:
            ArgumentTypeError: The text is not of this form.
        """
        out: dict[str, str] = {}
        for part in text.split(","):
            name, separator, column = (word.strip() for word in part.partition("="))
            known = name == "t" or (
                name.partition(".")[0] in (*self.prefixes, *self.signals) and "." in name
            )
            if not (separator and column and known):
                raise ArgumentTypeError(
                    f"'{_shown(part)}' should read NAME=COLUMN, NAME one of t, "
                    f"{', '.join(f'{prefix}.<joint>' for prefix in self.prefixes)}"
                )
            out[name] = column
        return out


NUMERIC = (Number, Numbers, NamedNumbers, WordOrNumbers)
"""All types of numeric options."""
