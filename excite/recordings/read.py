"""Read recordings from files: completely, or block by block in bounded memory."""

from __future__ import annotations

import enum
import os
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ..errors import ExciteWarning, UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from . import (
    csv_reader,
    data_quality,
    echo_reader,
    held_values,
    interleaved_rows,
    locked_joints,
    magnitudes,
    npz_reader,
    recording_cost,
    rosbag_reader,
    sidecar,
    unsigned_values,
)
from .block import Block, concatenate
from .clock_steps import remove_clock_steps
from .data_quality import RecordingContext, RowWindow
from .periodicity import check_repetition
from .recording import Recording
from .remark import Remark, RemarkKind, shown_time
from .time_axis import find_grid, sort_rows

DELAY_ROWS = 128
"""Rows at the end of a block that wait for the next block, so that delayed rows can be sorted
in."""
CONTEXT_ROWS = 32
"""Rows before and after a block that its repairs take into account; the effect of a row on a cubic
spline decays over fewer."""
FORMATS = "CSV, .npz, rosbag2 folder, .mcap, .db3, .bag or text of ros2 topic echo"

_AS_CSV = "write its table as CSV, as with pandas: {}(…).to_csv('run.csv', index=False)"
FOREIGN = (
    (b"PAR1", "a Parquet file", _AS_CSV.format("read_parquet")),
    (b"ARROW1", "a Feather file", _AS_CSV.format("read_feather")),
    (
        b"PK\x03\x04",
        "an archive or a spreadsheet",
        "extract the CSV or save it as one; NumPy's has the suffix .npz",
    ),
    (b"MATLAB 5.0", "a MAT-file", "write CSV with writetable, with the names t,q.<joint>,…"),
    (b"\x89HDF", "an HDF5 or MAT-file", "write its table as CSV, with the names t,q.<joint>,…"),
    (b"\x93NUMPY", "an array without names", "save t and q.<joint>, … with numpy.savez as .npz"),
    *(
        (sign, "JSON", "write the rows that it holds as CSV, with the columns t,q.<joint>,…")
        for sign in (b'{"', b'[{"', b"[\n", b"{\n")
    ),
)
"""First bytes of files of other formats, their names and the remedies."""


class FileFormat(enum.Enum):
    """Formats of recordings, one for each reader."""

    BAG = enum.auto()
    ARCHIVE = enum.auto()
    ECHO = enum.auto()
    TABLE = enum.auto()


def read(
    path: Path,
    robot: Robot,
    limits: Limits | None = None,
    columns: Mapping[str, str] = MappingProxyType({}),
    *,
    floating: bool = False,
) -> Recording:
    """Read, check and repair a recording.

    An `ExciteWarning` is issued for each repair of a fault; `Recording.remarks` lists repairs, too.

    Args:
        path: A CSV file (columns `q.<joint>`, … or Universal Robots' RTDE), an .npz, a rosbag2
            folder, an .mcap, .db3 or .bag, or the text of `ros2 topic echo`. A sidecar
            `<name>.json` in the same folder is read, too.
        robot: Robot that it records.
        limits: Limits of the robot, by which wrong units are detected; None: those of the URDF.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file.
        floating: Read the signals of a floating base, too, from a CSV file; see `floating_signals`.

    Raises:
        UnusableInput: It cannot be read, assigned to the robot's joints or repaired.
    """
    context = RecordingContext(str(path), robot, sidecar.read(path, robot), limits, dict(columns))
    blocks, rows, numbers = list[Block](), 0, 0
    positions = locked_joints.LockedPositions(robot)
    for block in map(positions.watched, _read_blocks(path, context, floating=floating)):
        if len(block) or block.remarks:
            blocks.append(block)
        rows += len(block)
        numbers += len(block) * (1 + robot.n * len(block.values))
        recording_cost.require_readable(str(path), rows, numbers)
    if not blocks:
        raise UnusableInput(f"{path}: has no rows; record again")
    cut, steps = remove_clock_steps(concatenate(blocks))
    unsigned_values.check_signs(str(path), cut, robot)  # interpolated values would hide them
    joined, interleaved = interleaved_rows.join_rows(cut, robot)
    ordered, late = sort_rows(str(path), joined)
    remarks = [*steps, *interleaved, *late]
    window = RowWindow(ordered, remarks=tuple(remarks))
    grid = find_grid(str(path), ordered.t)
    recording = data_quality.check_and_repair(context, window, grid, complete=True)
    recording = replace(recording, remarks=(*recording.remarks, *positions.check(str(path))))
    recording.require_segment()
    stated = recording.sidecar
    if stated.period is not None:
        stated_by = str(sidecar.sidecar_path(path))
        recording.check_period(stated.period, stated.periodic, stated_by)
    recording = check_repetition(recording)
    data_quality.warn_of_repairs(str(path), recording.remarks)
    return recording


def stream(
    path: Path, robot: Robot, limits: Limits | None = None, *, rows: int = 200_000, overlap: int = 0
) -> Iterator[Recording]:
    """Read consecutive blocks of a recording in memory that depends on `rows` alone.

    Each block is repaired as `read` repairs the recording, on the grid of the first block. Shares
    of missing values, negative numbers stored unsigned, held values, repeated rows and freezes are
    judged by block. Held values, repeated rows and freezes are warned of and kept, with a doubt
    among the remarks: which rows are new depends on the complete recording. Not judged are other
    properties of the complete recording: clock steps, interleaved rows, wrapped positions,
    glitches, the period, joints that never move, locked joints that move, timestamp jitter,
    quantization, coarse or clipped signals and torques that jump to one value. A fault is warned of
    where it first occurs; numbers in a remark may include up to 32 rows around the block. Memory is
    bounded for CSV, bags and .npz, except long tables and 2-D arrays in Fortran order.

    Args:
        path: As of `read`.
        robot: Robot that it records.
        limits: As of `read`.
        rows: Approximate number of new rows in a block.
        overlap: Number of rows at the end of a block that the next block repeats, so that filters
            can settle; `Recording.run_in` counts them.

    Raises:
        UnusableInput: As `read`; or rows are out of order by more than about 100 rows.
    """
    if rows < 2 * DELAY_ROWS or overlap < 0:
        raise UnusableInput(
            f"{path}: a stream needs blocks of at least {2 * DELAY_ROWS} rows and an overlap of 0 "
            "or more; raise rows"
        )
    context = RecordingContext(str(path), robot, sidecar.read(path, robot), limits)
    grid, warned = None, set[tuple[RemarkKind, str | None, bool]]()
    positions = locked_joints.LockedPositions(robot)
    blocks = map(positions.watched, _read_blocks(path, context))
    for window in _windows(str(path), _regrouped(blocks, rows), overlap):
        positions.check(str(path))
        unsigned_values.check_signs(str(path), window.block, robot)
        grid = grid or find_grid(str(path), window.block.t)
        part = data_quality.check_and_repair(context, window, grid, complete=False)
        repetitions = _repetitions(window.block)
        part = replace(part, remarks=(*part.remarks, *repetitions))
        kinds = {remark: (remark.kind, remark.joint, remark.doubt) for remark in part.remarks}
        new = [remark for remark, kind in kinds.items() if kind not in warned]
        data_quality.warn_of_repairs(str(path), new)
        for remark in repetitions:
            if remark in new:
                warnings.warn(f"{path}: {remark.text}", ExciteWarning, stacklevel=2)
        warned |= set(kinds.values())
        if len(part):
            yield part


def _repetitions(block: Block) -> list[Remark]:
    """Doubt rows that repeat values of earlier ones, which a stream keeps."""
    _, held, _ = held_values.keep_updates(block)
    remedy = "a stream keeps rows that repeat values; `read` the complete recording to drop them"
    texts = [f"{remark.text.rpartition('; ')[0]}; {remedy}" for remark in held]
    return [
        replace(remark, text=text, repaired=False, doubt=True)
        for remark, text in zip(held, texts, strict=True)
    ]


def _read_blocks(
    path: Path,
    context: RecordingContext,
    *,
    floating: bool = False,
) -> Iterator[Block]:
    """Yield blocks as the reader of the file's format returns them."""
    columns = context.columns
    row, holds_current = 1, context.sidecar.effort == "current"
    form = _file_format(path)
    if columns and form is not FileFormat.TABLE:
        raise UnusableInput(f"{path}: has no named columns; leave --columns out")
    if floating and form is not FileFormat.TABLE:
        raise UnusableInput(
            f"{path}: signals of a floating base are read from CSV; give columns t, base.x, … "
            "base.qw, q.<joint>, …, wrench.<frame>.fx, …"
        )
    try:
        if form is FileFormat.BAG:
            blocks = rosbag_reader.read_blocks(path, context.robot, context.sidecar)
        elif form is FileFormat.ARCHIVE:
            blocks = npz_reader.read_blocks(path, context.robot)
        elif form is FileFormat.ECHO:
            blocks = echo_reader.read_blocks(path, context.robot, context.sidecar)
        else:
            blocks = csv_reader.read_blocks(
                path,
                context.robot,
                columns,
                context.sidecar.topic,
                effort="i" if holds_current else "tau",
                floating=floating,
            )
        for block in blocks:
            if holds_current and "tau" in block.values and "current" not in block.values:
                raise UnusableInput(
                    f'{sidecar.sidecar_path(path)}: "effort": "current" holds for efforts of '
                    f"JointState messages, but {path.name} has columns tau.<joint>; name them "
                    "i.<joint>, or remove it"
                )
            first = row if block.row is None else block.row
            magnitudes.check_magnitudes(str(path), block, context.robot, first)
            row += len(block)
            yield block
    except OSError as error:
        raise _unreadable(path, error) from error


def _file_format(path: Path) -> FileFormat:
    """Find the format of a file by its suffix, or the beginning of its text.

    Raises:
        UnusableInput: There is no file, or it cannot be read.
    """
    if not (os.path.isdir(path) or os.path.isfile(path)):
        if os.path.exists(path):
            raise UnusableInput(f"{path}: is a pipe or a device; write the recording to a file")
        raise UnusableInput(f"{path}: no such file; give a recording: {FORMATS}")
    if path.suffix == ".json":
        raise UnusableInput(
            f"{path}: is no recording but JSON; give the recording whose metadata it holds, or "
            f"write the rows that it holds as CSV, with the columns t,q.<joint>,…: {FORMATS}"
        )
    if rosbag_reader.is_bag(path):
        return FileFormat.BAG
    if path.suffix == ".npz":
        return FileFormat.ARCHIVE
    try:
        with path.open("rb") as stream:
            head = stream.read(16)
        for sign, name, remedy in FOREIGN:
            if head.startswith(sign):
                raise UnusableInput(f"{path}: is {name}; {remedy}")
        return FileFormat.ECHO if echo_reader.is_echo(path) else FileFormat.TABLE
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError) -> UnusableInput:
    """Return the error of a file that the operating system does not read."""
    return UnusableInput(f"{path}: cannot be read ({error.strerror}); give a {FORMATS}")


def _regrouped(blocks: Iterator[Block], rows: int) -> Iterator[tuple[Block, bool]]:
    """Yield blocks of `rows` rows, the last of up to twice as many, and True with the last."""
    waiting: list[Block] = []
    for block in blocks:
        waiting.append(block)
        while sum(map(len, waiting)) >= 2 * rows:
            full = concatenate(waiting)
            yield full.rows(slice(0, rows)), False
            waiting = [
                Block(full.t[rows:], {name: value[rows:] for name, value in full.values.items()})
            ]
    if waiting:
        yield concatenate(waiting), True


def _windows(
    source: str, blocks: Iterator[tuple[Block, bool]], overlap: int
) -> Iterator[RowWindow]:
    """Yield ordered rows of each block, with context before and rows that wait behind."""
    kept: Block | None = None
    done, pending, is_last = -np.inf, list[Remark](), False
    for block, is_last in blocks:
        earliest = float(np.fmin.reduce(block.t, initial=np.inf))
        if earliest < done:
            raise UnusableInput(
                f"{source}: time goes back to {shown_time(earliest)} s after {shown_time(done)} s; "
                "sort the rows, or give each recording its own file"
            )
        ordered, remarks = sort_rows(source, block if kept is None else concatenate([kept, block]))
        pending += remarks
        first_new = int(np.searchsorted(ordered.t, done, side="right"))
        if len(ordered) <= first_new + DELAY_ROWS and not is_last:  # nearly all rows were repeated
            kept = ordered
            continue
        end = np.inf if is_last else float(ordered.t[-1 - DELAY_ROWS])
        cut = int(np.searchsorted(ordered.t, end, side="right"))
        start = (
            float(ordered.t[max(first_new - overlap, 0)])
            if overlap and first_new
            else float(np.nextafter(done, np.inf))
        )
        yield RowWindow(
            ordered.rows(slice(0, cut + CONTEXT_ROWS)), start, end, done, tuple(pending)
        )
        tail = ordered.rows(slice(max(cut - overlap - CONTEXT_ROWS, 0), None))
        # copies, so that the window's arrays can be freed
        kept = Block(tail.t.copy(), {name: value.copy() for name, value in tail.values.items()})
        done, pending = end, []
    if not is_last:
        raise UnusableInput(f"{source}: has no rows; record again")
