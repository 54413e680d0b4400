"""Comments of generated files.

Names of robots, joints, links and files are written into comments of programs and documents. Each
function here makes any text harmless in the comments of one language, so that no name ends a
comment and becomes a statement.
"""

from __future__ import annotations

import re
from collections.abc import Iterable


def plain_line(text: str) -> str:
    """Return a text as one line of printable characters, with its indentation."""
    indent = len(text) - len(text.lstrip(" "))
    line = " ".join(text.split())
    return " " * indent + "".join(letter if letter.isprintable() else "?" for letter in line)


def ascii_line(text: str) -> str:
    """Return a text as one line of printable ASCII, which the parser of any controller accepts."""
    return plain_line(text).encode("ascii", "replace").decode()


def xml_comment_text(text: str) -> str:
    """Return a text as one line that is valid inside an XML comment, which may not hold "--"."""
    return re.sub("-(?=-)", "- ", plain_line(text))


def xml_comment(lines: Iterable[str]) -> str:
    """Return lines as a comment of XML."""
    return "\n".join(["<!--", *map(xml_comment_text, lines), "-->"])


def c_comment(lines: Iterable[str]) -> str:
    """Return lines as a comment of C, without the marks of a comment's begin and end in them."""
    apart = (re.sub(r"\*(?=/)|/(?=\*)", r"\g<0> ", ascii_line(line)) for line in lines)
    return "\n".join(["/*", *(f" * {line}" for line in apart), " */"])


def line_comment(lines: Iterable[str], mark: str = "#") -> str:
    """Return lines as a comment of a language whose comments end with the line.

    Args:
        lines: The lines.
        mark: Begin of a comment.
    """
    return "\n".join(f"{mark} {ascii_line(line)}" for line in lines)


def python_docstring(lines: Iterable[str]) -> str:
    """Return lines as the docstring of a Python module."""
    text = "\n".join(ascii_line(line) for line in lines)
    return '"""' + text.replace("\\", "/").replace('"', "'") + '\n"""'
