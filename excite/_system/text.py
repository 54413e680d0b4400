"""Text from outside the program, such as names of files."""

from __future__ import annotations


def displayable(text: str) -> str:
    """Replace lone surrogates by U+FFFD; they stand for bytes of a name that are not UTF-8."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
