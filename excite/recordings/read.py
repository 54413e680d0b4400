"""Recordings from files: whole, or block by block in bounded memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from . import (
    csv_reader,
    data_quality,
    magnitudes,
    npz_reader,
    recording_cost,
    rosbag_reader,
    sidecar,
)
from .block import Block, joined
from .data_quality import Patient, Window
from .recording import Recording
from .remark import Kind, Remark
from .time_axis import measure, order

HOLD = 128
"""Rows held back at the end of a block, among which late rows are sorted in."""
CONTEXT = 32
"""Rows before and after a block that its repairs see. A spline forgets a row after fewer."""
FORMATS = "CSV, .npz, rosbag2 folder, .mcap, .db3 or .bag"


def read(path: Path, robot: Robot, limits: Limits | None = None) -> Recording:
    """A whole recording, checked and repaired.

    path: a CSV (the contract's columns, or Universal Robots' RTDE), an .npz, a rosbag2 folder, an
        .mcap, .db3 or .bag; a sidecar `<name>.json` beside it is read too. limits: to tell degrees
        from radians; without, the URDF's. Raises UnusableInput, with file, joint and remedy, for
        what cannot be read, matched or repaired; gives an ExciteWarning for each repair of a fault;
        `remarks` lists these too.
    """
    patient = Patient(str(path), robot, sidecar.read(path, robot), limits)
    found, rows, numbers = list[Block](), 0, 0
    for part in _blocks(path, patient):
        if len(part) or part.remarks:
            found.append(part)
        rows += len(part)
        numbers += len(part) * (1 + robot.n * len(part.values))
        recording_cost.require_readable(str(path), rows, numbers)
    if not found:
        raise UnusableInput(f"{path}: has no rows; record again")
    block, remarks = order(str(path), joined(found))
    whole = data_quality.recording(
        patient, Window(block, remarks=tuple(remarks)), measure(str(path), block.t), whole=True
    )
    if whole.sidecar.period is not None:
        whole.check_period(whole.sidecar.period, whole.sidecar.periodic, str(sidecar.beside(path)))
    data_quality.warn(str(path), whole.remarks)
    return whole


def stream(
    path: Path, robot: Robot, limits: Limits | None = None, *, rows: int = 200_000, overlap: int = 0
) -> Iterator[Recording]:
    """Consecutive blocks of a recording, of about `rows` new rows each, in memory that depends on
    `rows` alone.

    overlap: rows at the end of the block before that are repeated in front, so that a filter can
        run in; `run_in` counts them. Each block is repaired as `read` repairs the whole, on the
        grid of the first block's clock; what takes the whole to see (joints that never move, a
        clock that wavers, coarse, frozen and clipped channels, what encoders rounded) is not
        judged, and shares of missing numbers are judged by block. A repair is warned of where it
        first occurs; what a remark counts may include the up to 32 rows around the block. Bounded
        are CSV, bags and .npz but for 2-D arrays stored column by column, which are held whole.
        Raises UnusableInput as `read` does, and for rows that come more than some 100 rows late.
    """
    if rows < 2 * HOLD or overlap < 0:
        raise UnusableInput(
            f"{path}: a stream needs blocks of at least {2 * HOLD} rows and an overlap of 0 or "
            "more; raise rows"
        )
    patient = Patient(str(path), robot, sidecar.read(path, robot), limits)
    clock, said = None, set[tuple[Kind, str | None]]()
    for window in _windows(str(path), _sized(_blocks(path, patient), rows), overlap):
        clock = clock or measure(str(path), window.block.t)
        part = data_quality.recording(patient, window, clock, whole=False)
        data_quality.warn(str(path), [r for r in part.remarks if (r.kind, r.joint) not in said])
        said |= {(remark.kind, remark.joint) for remark in part.remarks}
        if len(part):
            yield part


def _blocks(path: Path, patient: Patient) -> Iterator[Block]:
    if not (os.path.isdir(path) or os.path.isfile(path)):
        raise UnusableInput(f"{path}: no such file; give a recording: {FORMATS}")
    if path.suffix == ".json":
        raise UnusableInput(f"{path}: is no recording but JSON; give the file beside it: {FORMATS}")
    row = 1
    try:
        if rosbag_reader.is_bag(path):
            found = rosbag_reader.blocks(path, patient.robot, patient.sidecar)
        elif path.suffix == ".npz":
            found = npz_reader.blocks(path, patient.robot)
        else:
            found, row = csv_reader.blocks(path, patient.robot), 2  # the header is row 1
        for block in found:
            magnitudes.check(str(path), block, patient.robot, row)
            row += len(block)
            yield block
    except OSError as error:
        raise UnusableInput(
            f"{path}: cannot be read ({error.strerror}); give a {FORMATS}"
        ) from error


def _sized(blocks: Iterator[Block], rows: int) -> Iterator[tuple[Block, bool]]:
    """Blocks of `rows` rows each but the last, which may hold up to twice as many; True with the
    last."""
    waiting: list[Block] = []
    for block in blocks:
        waiting.append(block)
        while sum(map(len, waiting)) >= 2 * rows:
            full = joined(waiting)
            yield full.rows(slice(0, rows)), False
            waiting = [
                Block(full.t[rows:], {name: value[rows:] for name, value in full.values.items()})
            ]
    if waiting:
        yield joined(waiting), True


def _windows(source: str, blocks: Iterator[tuple[Block, bool]], overlap: int) -> Iterator[Window]:
    """Ordered rows of each block between context before and held rows behind."""
    kept: Block | None = None
    done, pending, last = -np.inf, list[Remark](), False
    for block, last in blocks:
        earliest = float(np.fmin.reduce(block.t, initial=np.inf))
        if earliest < done:
            raise UnusableInput(
                f"{source}: time goes back to {earliest:.6g} s after {done:.6g} s; sort the rows, "
                "or give each recording its own file"
            )
        ordered, remarks = order(source, block if kept is None else joined([kept, block]))
        pending += remarks
        fresh = int(np.searchsorted(ordered.t, done, side="right"))
        if len(ordered) <= fresh + HOLD and not last:  # all but a few rows were repeats
            kept = ordered
            continue
        end = np.inf if last else float(ordered.t[-1 - HOLD])
        cut = int(np.searchsorted(ordered.t, end, side="right"))
        start = (
            float(ordered.t[max(fresh - overlap, 0)])
            if overlap and fresh
            else float(np.nextafter(done, np.inf))
        )
        yield Window(ordered.rows(slice(0, cut + CONTEXT)), start, end, done, tuple(pending))
        tail = ordered.rows(slice(max(cut - overlap - CONTEXT, 0), None))
        kept, done, pending = (
            Block(tail.t.copy(), {name: value.copy() for name, value in tail.values.items()}),
            end,
            [],
        )
    if not last:
        raise UnusableInput(f"{source}: has no rows; record again")
