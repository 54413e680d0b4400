"""Text that comes from outside, such as names of files."""

from __future__ import annotations


def displayable(text: str) -> str:
    """Replace what no encoding of Unicode can hold, such as the bytes of a file name that are not
    UTF-8, by U+FFFD."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
