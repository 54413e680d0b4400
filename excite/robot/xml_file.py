"""XML documents (URDF, SRDF) read in their declared encoding, within bounds and without document
type definitions.

Expat expands the entities that a document type definition (DTD) declares, so that a file of 1 kB
can grow to gigabytes ("billion laughs"). Robot descriptions need no DTD; one that has a DTD is
refused before the first entity is expanded.
"""

from __future__ import annotations

import codecs
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.parsers import expat

from ..errors import UnusableInput

LARGEST = 1 << 24
"""Largest file that is parsed [bytes]: 16 MiB. None of the 100 URDFs of the wheel
example-robot-data has 0.3 MB."""
DEEPEST = 100
"""Deepest nesting of elements. A URDF nests 5 deep with a <sensor> in a <gazebo> about 10;
`ElementTree` recurses when it writes."""
BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""First bytes of a file and the encoding that they state. The marks of UTF-32 begin like those of
UTF-16."""


UNDECLARED = "urn:undeclared:"
"""Beginning of the namespace that an undeclared prefix gets."""
COMMENT = re.compile(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>", re.DOTALL)
TAG = re.compile(r"<[^<>!?][^<>]*>")
VALUE = re.compile(r"\"[^\"]*\"|'[^']*'")
PREFIX = re.compile(r"(?<=[<\s/])([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*(?=[\s/>=])")
"""Prefix of the name of an element or an attribute."""
DECLARATION = re.compile(r"\sxmlns:([A-Za-z_][\w.-]*)\s*=")
ROOT_NAME = re.compile(r"\A(?:\ufeff|\s|<\?.*?\?>|<!--.*?-->)*<[A-Za-z_][\w.:-]*", re.DOTALL)
"""Everything before the root element's attributes."""
ROOT_TAG = re.compile(ROOT_NAME.pattern + "[^>]*", re.DOTALL)
"""Everything up to the end of the root element's tag."""
DEFAULT_NAMESPACE = re.compile(r"""\sxmlns\s*=\s*("[^"]*"|'[^']*')""")


class _BoundedBuilder(ElementTree.TreeBuilder):
    """A tree builder that refuses document type definitions and deep nesting."""

    def __init__(self, path: Path, *, keep_comments: bool = False) -> None:
        super().__init__(insert_comments=keep_comments)
        self._path = path
        self._depth = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self._depth += 1
        if self._depth > DEEPEST:
            raise UnusableInput(
                f"{self._path}: its elements are nested more than {DEEPEST} deep; export the file "
                "again"
            )
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)

    def doctype(self, name: str, public_id: str | None, system_id: str | None) -> None:
        raise UnusableInput(
            f"{self._path}: has a document type definition <!DOCTYPE {name}>, which is not read; "
            "remove it"
        )


def read_text(path: Path, kind: str) -> str:
    """Read an XML file in the encoding of its byte order mark or declaration, UTF-8 without either.

    Args:
        path: The file.
        kind: What the file should be, for messages: "a URDF".

    Raises:
        UnusableInput: The file cannot be read, is larger than LARGEST, or is not in the encoding
            that it declares.
    """
    try:
        size = path.stat().st_size
        data = path.read_bytes() if size <= LARGEST else b""
    except OSError as error:
        raise UnusableInput(
            f"{path}: cannot be read as {kind} ({error.strerror}); give {kind}"
        ) from error
    if size > LARGEST:
        raise UnusableInput(
            f"{path}: has {size / 1e6:.0f} MB, more than the {LARGEST >> 20} MiB that are read; "
            f"give {kind}"
        )
    encoding = _encoding(data)
    try:
        return data.decode(encoding)
    except LookupError as error:
        raise UnusableInput(
            f"{path}: declares the encoding '{encoding}', which is not known; save it as UTF-8"
        ) from error
    except UnicodeDecodeError as error:
        line = 1 + data.count(b"\n", 0, error.start)
        raise UnusableInput(
            f"{path}: line {line}: the byte 0x{data[error.start]:02x} is not {encoding.upper()}; "
            "save the file as UTF-8, "
            'or declare its encoding in the first line: <?xml version="1.0" encoding="ISO-8859-1"?>'
        ) from error
    except UnicodeError as error:
        raise UnusableInput(
            f"{path}: is not in the encoding '{encoding}' that it declares ({error}); save it as "
            "UTF-8"
        ) from error


def _encoding(data: bytes) -> str:
    marked = next((encoding for mark, encoding in BYTE_ORDER_MARKS if data.startswith(mark)), None)
    if marked is not None:
        return marked
    declared = re.match(
        rb"""\s*<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z][A-Za-z0-9._-]*)["']""", data[:1000]
    )
    return "utf-8" if declared is None else declared[1].decode("ascii").lower()


def parse(path: Path, kind: str) -> ElementTree.Element:
    """Parse an XML file to its root element.

    Args:
        path: The file.
        kind: What the file should be, for messages: "a URDF".

    Raises:
        UnusableInput: The file cannot be read or decoded, is no well-formed XML, has a document
            type definition, or is nested more than DEEPEST deep.
    """
    return parse_text(path, read_text(path, kind))


def undeclared_prefixes(text: str) -> list[str]:
    """XML prefixes that a document uses and does not declare, which ROS and Pinocchio ignore."""
    if ":" not in text:
        return []
    tags = [VALUE.sub('""', tag) for tag in TAG.findall(COMMENT.sub("", text)) if ":" in tag]
    used = dict.fromkeys(prefix for tag in tags for prefix in PREFIX.findall(tag))
    declared = {"xml", "xmlns"} | {name for tag in tags for name in DECLARATION.findall(tag)}
    return [prefix for prefix in used if prefix not in declared]


def without_default_namespace(text: str) -> str:
    """The text of an XML file whose root element declares no default namespace, so that its
    elements have plain names."""
    return ROOT_TAG.sub(lambda match: DEFAULT_NAMESPACE.sub("", match[0]), text, count=1)


def parse_text(path: Path, text: str) -> ElementTree.Element:
    """Parse the text of an XML file, as `read_text` returns it, to its root element; see
    `parse`."""
    prefixes = undeclared_prefixes(text)
    if prefixes:
        declared = " ".join(f'xmlns:{prefix}="{UNDECLARED}{prefix}"' for prefix in prefixes)
        text = ROOT_NAME.sub(lambda match: f"{match[0]} {declared}", text, count=1)
    parser = ElementTree.XMLParser(target=_BoundedBuilder(path))
    try:
        parser.feed(text)
        return parser.close()
    except (ElementTree.ParseError, UnicodeError) as error:
        raise _invalid(path, error) from error


def parse_as_written(path: Path, text: str) -> ElementTree.Element:
    """Parse the text of an XML file to a tree that is written again: with its comments, and with
    names as in the text, their prefixes included, declared or not.

    `ElementTree` replaces prefixes by namespaces and writes others, ns0, ns1, …; here xmlns
    attributes are attributes like any other.

    Args:
        path: The file, for messages.
        text: Its text.

    Raises:
        UnusableInput: As `parse`.
    """
    builder = _BoundedBuilder(path, keep_comments=True)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.CommentHandler = builder.comment
    parser.StartDoctypeDeclHandler = lambda name, system, public, _: builder.doctype(
        name, public, system
    )
    try:
        parser.Parse(text, True)
    except (expat.ExpatError, UnicodeError) as error:
        raise _invalid(path, error) from error
    return builder.close()


def _invalid(path: Path, error: Exception) -> UnusableInput:
    return UnusableInput(f"{path}: is not valid XML ({error}); repair the file or export it again")
