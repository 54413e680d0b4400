"""Arguments that are one value or several, such as paths of recordings."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar, overload

T = TypeVar("T")


@overload
def one_or_several(stated: str | Iterable[str]) -> tuple[str, ...]: ...
@overload
def one_or_several(stated: str | Path | Iterable[str | Path]) -> tuple[str | Path, ...]: ...
@overload
def one_or_several(
    stated: str | Path | T | Iterable[str | Path | T],
) -> tuple[str | Path | T, ...]: ...
def one_or_several(stated: Any) -> tuple[Any, ...]:
    """Return the values of an argument as a tuple, a single value as a tuple of one.

    A text is a single value and no sequence of letters: `given="a.csv"` means `given=["a.csv"]`.

    Args:
        stated: A text, a path, another object that cannot be iterated over, or several of these.
    """
    if isinstance(stated, str | os.PathLike) or not isinstance(stated, Iterable):
        return (stated,)
    return tuple(stated)


def one_or_several_texts(stated: str | Path | Iterable[str | Path]) -> tuple[str, ...]:
    """Return texts, and paths as texts, as a tuple; see `one_or_several`."""
    return tuple(map(str, one_or_several(stated)))
