"""NumPy archives (.npz), compressed or not, read as streams: no member is held whole unless it is
stored column by column."""

from __future__ import annotations

import lzma
import math
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np

from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import PREFIXES, Layout, layout, listed

Array = np.ndarray
ROWS = 50_000
UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    LookupError,
    ValueError,
    OverflowError,
    RuntimeError,
    TypeError,
)
"""What zipfile and numpy raise for files that are no archives or that ask for a compression or a
password that is not there."""


@dataclass
class _Member:
    """One array of the archive, read row by row. A memory map needs a plain .npy file, so the zip
    member's stream is read instead."""

    path: Path
    name: str
    stream: IO[bytes]
    shape: tuple[int, ...]
    dtype: np.dtype
    whole: Array | None  # of an array stored column by column, which has no rows to stream
    at: int = 0

    def take(self, count: int) -> Array:
        """The next rows, at most `count`. Shape (rows,) or (rows, columns)."""
        count = min(count, self.shape[0] - self.at)
        self.at += count
        if self.whole is not None:
            return self.whole[self.at - count : self.at].astype(float)
        width = int(np.prod(self.shape[1:]))
        data = self.stream.read(count * width * self.dtype.itemsize)
        if len(data) < count * width * self.dtype.itemsize:
            raise UnusableInput(f"{self.path}: array '{self.name}' ends early; save the file again")
        return np.frombuffer(data, self.dtype).reshape(count, *self.shape[1:]).astype(float)


Opener = Callable[[str, int], _Member]


def blocks(path: Path, robot: Robot) -> Iterator[Block]:
    """Blocks of an archive with `t` and either the contract's columns (`q.<joint>`, …) or arrays
    (N, m) `q`, `dq`, `tau`, `i`, `qref`, `qlink`, `temp` whose columns `joints` names.

    Raises UnusableInput for an archive that cannot be read, lacks an array or whose arrays differ
    in length.
    """
    try:
        with zipfile.ZipFile(path) as file, ExitStack() as opened:
            open_member = partial(_open, path, file, opened)
            names = [name.removesuffix(".npy") for name in file.namelist()]
            if "q" in names:
                yield from _matrices(path, open_member, _names(path, file, names), names, robot)
            else:
                yield from _columns(path, open_member, names, robot)
    except UNREADABLE as error:
        raise UnusableInput(
            f"{path}: is no readable .npz ({error}); save it again with np.savez"
        ) from error


def _columns(path: Path, open_member: Opener, names: list[str], robot: Robot) -> Iterator[Block]:
    places = layout(str(path), names, robot)
    members = [open_member(name, 1) for name in places.names]
    yield from _merged(path, members, places)


def _matrices(
    path: Path, open_member: Opener, joints: list[str], names: list[str], robot: Robot
) -> Iterator[Block]:
    if "t" not in names or "joints" not in names:
        lacking = "t" if "t" not in names else "joints"
        raise UnusableInput(
            f"{path}: has no array '{lacking}' but {listed(names)}; save t, joints (names of the "
            "columns of q) and q"
        )
    prefixes = [prefix for prefix in PREFIXES if prefix in names]
    members = [open_member("t", 1), *(open_member(prefix, 2) for prefix in prefixes)]
    for member in members[1:]:
        if member.shape[1] != len(joints):
            raise UnusableInput(
                f"{path}: array '{member.name}' has {member.shape[1]} columns for {len(joints)} "
                "joints; save one a joint"
            )
    header = ["t", *(f"{prefix}.{joint}" for prefix in prefixes for joint in joints)]
    places = layout(str(path), header, robot)
    yield from _merged(path, members, places, [header.index(name) for name in places.names])


def _merged(
    path: Path, members: list[_Member], places: Layout, columns: list[int] | None = None
) -> Iterator[Block]:
    lengths = {member.name: member.shape[0] for member in members}
    odd = next((name for name, length in lengths.items() if length != members[0].shape[0]), None)
    if odd is not None:
        raise UnusableInput(
            f"{path}: array '{odd}' has {lengths[odd]} rows and '{members[0].name}' "
            f"{members[0].shape[0]}; save equally many"
        )
    for _ in range(0, members[0].shape[0], ROWS):
        table = np.column_stack([member.take(ROWS) for member in members])
        yield places.block(table if columns is None else table[:, columns])


def _names(path: Path, file: zipfile.ZipFile, names: list[str]) -> list[str]:
    """What the array `joints` holds, if it is there."""
    if "joints" not in names:
        return []
    with file.open("joints.npy") as stream:
        _header(path, file, "joints", stream)
    with file.open("joints.npy") as stream:
        return [
            str(name)
            for name in np.atleast_1d(np.lib.format.read_array(stream, allow_pickle=False))
        ]


def _header(
    path: Path, file: zipfile.ZipFile, name: str, stream: IO[bytes]
) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether columns are stored one after the other, and type of an array; the stream then
    stands at its first number.

    Raises UnusableInput for an array of objects, which is not loaded since it may hold code, and
    for one that is larger than its file.
    """
    version = np.lib.format.read_magic(stream)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, by_column, dtype = read(stream)
    if dtype.hasobject:
        raise UnusableInput(
            f"{path}: array '{name}' holds Python objects, which are not loaded; save numbers and "
            "names"
        )
    there = file.getinfo(f"{name}.npy").file_size
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > there:
        raise UnusableInput(
            f"{path}: array '{name}' of shape {shape} should have more than the {there} bytes that "
            "are there; save it again"
        )
    return shape, by_column, dtype


def _open(
    path: Path, file: zipfile.ZipFile, opened: ExitStack, name: str, dimensions: int
) -> _Member:
    stream = opened.enter_context(file.open(f"{name}.npy"))
    shape, by_column, dtype = _header(path, file, name, stream)
    if len(shape) != dimensions or dtype.kind not in "fiu":
        raise UnusableInput(
            f"{path}: array '{name}' is {len(shape)}-dimensional of type {dtype}; save "
            f"{dimensions}-dimensional numbers"
        )
    whole = None
    if by_column and dimensions > 1:
        data = np.frombuffer(stream.read(), dtype)
        whole = data.reshape(shape, order="F")
    return _Member(path, name, stream, shape, dtype, whole)
