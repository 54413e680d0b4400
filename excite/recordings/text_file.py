"""Text of a recording as UTF-8, out of files that are compressed or in UTF-16 or UTF-32."""

from __future__ import annotations

import bz2
import codecs
import gzip
import io
import lzma
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, cast

from ..errors import UnusableInput

COMPRESSIONS = ((b"\x1f\x8b", gzip.open), (b"BZh", bz2.open), (b"\xfd7zXZ\x00", lzma.open))
"""First bytes of compressed files, and the functions that open them."""
SUFFIXES = (".gz", ".bz2", ".xz")
"""Suffixes of compressed files, behind that of their content."""
ENCODINGS = (
    *((codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32")),
    *((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16")),
)
"""First bytes of text in other encodings, as PowerShell writes it for `>`; those of UTF-32 begin
like those of UTF-16."""


@contextmanager
def open_text(path: Path) -> Iterator[BinaryIO]:
    """Open a file as UTF-8 text that can be read in parts.

    Text in UTF-16 or UTF-32 is loaded completely.

    Args:
        path: The file; it may be compressed by gzip, bzip2 or xz.

    Raises:
        UnusableInput: It cannot be decompressed or decoded; also while it is read in the context.
    """
    with path.open("rb") as file:
        head = file.read(6)
    opener = next((opener for sign, opener in COMPRESSIONS if head.startswith(sign)), None)
    try:
        with cast(BinaryIO, path.open("rb") if opener is None else opener(path, "rb")) as stream:
            encoding = _encoding(stream.read(8))
            stream.seek(0)
            if encoding is None:
                yield stream
            else:
                yield io.BytesIO(stream.read().decode(encoding).encode())
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        if isinstance(error, OSError) and error.strerror:
            raise  # of the operating system, not of damaged data
        raise UnusableInput(
            f"{path}: cannot be decompressed ({error}); copy it again, or give the file that was "
            "compressed"
        ) from error
    except UnicodeDecodeError as error:
        raise UnusableInput(
            f"{path}: is no complete text in {error.encoding} ({error.reason} at byte "
            f"{error.start}); save it in UTF-8"
        ) from error


def _encoding(head: bytes) -> str | None:
    """Return the encoding of text that is not in UTF-8; None of other bytes.

    The first character has to be one of ASCII: bytes of other files may begin like such a text.
    """
    for sign, name in ENCODINGS:
        if head.startswith(sign):
            is_text = head.decode(name, "replace")[:1].isascii()
            return name if is_text else None
    zeros = tuple(byte == 0 for byte in head[:4])  # letters of ASCII without a mark before them
    if not head.isascii() or zeros not in ((False, True) * 2, (True, False) * 2):
        return None
    return "utf-16-be" if zeros[0] else "utf-16-le"
