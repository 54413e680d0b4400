"""NumPy archives (.npz), compressed or not, read as streams.

Only arrays in Fortran order are loaded completely.
"""

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

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import Block
from .column_names import (
    PREFIXES,
    RTDE_POSITION,
    ColumnLayout,
    find_columns,
    listed,
    similar,
)

BLOCK_ROWS = 50_000
"""Number of rows in a block."""
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
"""Exceptions of zipfile and numpy for files that are no archives, or that need a password or an
unknown compression."""


@dataclass
class _Member:
    """An array of the archive, read row by row from the stream of the zip member.

    Attributes:
        path: The archive.
        name: Name of the array.
        stream: Stream that stands at the first number.
        shape: Shape of the array.
        dtype: Type of its numbers.
        loaded: The array, if it is in Fortran order and has no rows to stream.
        position: Number of rows read so far.
    """

    path: Path
    name: str
    stream: IO[bytes]
    shape: tuple[int, ...]
    dtype: np.dtype
    loaded: np.ndarray | None
    position: int = 0

    def take(self, count: int) -> FloatArray:
        """Read the next rows, at most `count`. Shape (rows,) or (rows, columns)."""
        count = min(count, self.shape[0] - self.position)
        self.position += count
        if self.loaded is not None:
            return self.loaded[self.position - count : self.position].astype(float)
        width = int(np.prod(self.shape[1:]))
        data = self.stream.read(count * width * self.dtype.itemsize)
        if len(data) < count * width * self.dtype.itemsize:
            raise UnusableInput(f"{self.path}: array '{self.name}' ends early; save the file again")
        return np.frombuffer(data, self.dtype).reshape(count, *self.shape[1:]).astype(float)


MemberOpener = Callable[[str, int], _Member]
"""Function that opens an array by name and number of dimensions."""


def read_blocks(path: Path, robot: Robot) -> Iterator[Block]:
    """Read an archive of columns or matrices.

    Args:
        path: Archive with `t` and either columns `q.<joint>`, …, or matrices `q`, `dq`, `tau`, `i`,
            `qref`, `qlink`, `temp` of shape (N, m) with the names of their columns in `joints`.
        robot: Robot whose joints are recorded.

    Yields:
        Consecutive blocks of BLOCK_ROWS rows.

    Raises:
        UnusableInput: The archive cannot be read, lacks an array, or its arrays differ in length.
    """
    try:
        with zipfile.ZipFile(path) as file, ExitStack() as opened:
            open_member = partial(_open, path, file, opened)
            names = [name.removesuffix(".npy") for name in file.namelist()]
            if "q" in names:
                joints = _joint_names(path, file, names)
                yield from _read_matrices(path, open_member, joints, names, robot)
            else:
                yield from _read_columns(path, open_member, names, robot)
    except UNREADABLE as error:
        raise UnusableInput(
            f"{path}: is no readable .npz ({error}); save it again with np.savez"
        ) from error


def _read_columns(
    path: Path, open_member: MemberOpener, names: list[str], robot: Robot
) -> Iterator[Block]:
    missing = [name for name in ("t", *(f"q.{j}" for j in robot.joints)) if name not in names]
    if missing and f"{RTDE_POSITION}0" not in names:
        raise UnusableInput(
            f"{path}: has no column '{missing[0]}' {similar(missing[0], names)}; save t and "
            "q.<joint> of each joint, or t, joints (names of the columns of q) and q"
        )
    layout = find_columns(str(path), names, robot)
    members = [open_member(name, 1) for name in layout.names]
    yield from _merge(path, members, layout)


def _read_matrices(
    path: Path, open_member: MemberOpener, joints: list[str], names: list[str], robot: Robot
) -> Iterator[Block]:
    if "t" not in names or "joints" not in names:
        missing = "t" if "t" not in names else "joints"
        raise UnusableInput(
            f"{path}: has no array '{missing}' but {listed(names)}; save t, joints (names of the "
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
    layout = find_columns(str(path), header, robot)
    yield from _merge(path, members, layout, [header.index(name) for name in layout.names])


def _merge(
    path: Path, members: list[_Member], layout: ColumnLayout, columns: list[int] | None = None
) -> Iterator[Block]:
    """Yield blocks of the columns of several arrays; columns: those to use, None: all."""
    lengths = {member.name: member.shape[0] for member in members}
    other = next((name for name, length in lengths.items() if length != members[0].shape[0]), None)
    if other is not None:
        raise UnusableInput(
            f"{path}: array '{other}' has {lengths[other]} rows and '{members[0].name}' "
            f"{members[0].shape[0]}; save equally many"
        )
    for _ in range(0, members[0].shape[0], BLOCK_ROWS):
        table = np.column_stack([member.take(BLOCK_ROWS) for member in members])
        yield layout.block(table if columns is None else table[:, columns])


def _joint_names(path: Path, file: zipfile.ZipFile, names: list[str]) -> list[str]:
    """Read the array `joints`; empty without one."""
    if "joints" not in names:
        return []
    with file.open("joints.npy") as stream:
        _read_header(path, file, "joints", stream)
    with file.open("joints.npy") as stream:
        return [
            name.decode() if isinstance(name, bytes) else str(name)
            for name in np.atleast_1d(np.lib.format.read_array(stream, allow_pickle=False))
        ]


def _read_header(
    path: Path, file: zipfile.ZipFile, name: str, stream: IO[bytes]
) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Read the header of an array; the stream then stands at its first number.

    Returns:
        Shape, True for Fortran order, and type of the numbers.

    Raises:
        UnusableInput: The array holds Python objects, which may execute code when they are loaded,
            or is larger than its file.
    """
    version = np.lib.format.read_magic(stream)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, is_fortran, dtype = read(stream)
    if dtype.hasobject:
        raise UnusableInput(
            f"{path}: array '{name}' holds Python objects, which are not loaded; save numbers and "
            "names"
        )
    size = file.getinfo(f"{name}.npy").file_size
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > size:
        raise UnusableInput(
            f"{path}: array '{name}' of shape {shape} should have more than the {size} bytes that "
            "are there; save it again"
        )
    return shape, is_fortran, dtype


def _open(
    path: Path, file: zipfile.ZipFile, opened: ExitStack, name: str, dimensions: int
) -> _Member:
    stream = opened.enter_context(file.open(f"{name}.npy"))
    shape, is_fortran, dtype = _read_header(path, file, name, stream)
    if len(shape) != dimensions or dtype.kind not in "fiu":
        raise UnusableInput(
            f"{path}: array '{name}' is {len(shape)}-dimensional of type {dtype}; save "
            f"{dimensions}-dimensional numbers"
        )
    loaded = None
    if is_fortran and dimensions > 1:
        data = np.frombuffer(stream.read(), dtype)
        loaded = data.reshape(shape, order="F")
    return _Member(path, name, stream, shape, dtype, loaded)
