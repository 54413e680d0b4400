"""Check and repair of a recording: from rows as they were read to an even grid of trusted values.

Wrong units, a time axis that cannot be repaired and too many missing values are errors (`units`,
`time_axis`, `missing_values`). Row order, repeated rows, uneven steps, timestamp jitter, gaps and
few missing values are repaired by the rules stated there, with a remark and a warning. The
quantization of positions is reduced with a remark (`quantization`). Findings of `signal_checks` are
remarks only.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from .._types import BoolArray, FloatArray
from ..errors import ExciteWarning, UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from . import (
    encoder_resolution,
    floating_signals,
    glitches,
    held_values,
    missing_values,
    position_wraps,
    quantization,
    signal_checks,
    timestamp_jitter,
    uneven_stamps,
    units,
)
from .block import QUANTITIES, Block
from .recording import MIN_ROWS, Recording
from .remark import Remark, RemarkKind
from .sidecar import KEYS, Sidecar
from .time_axis import TimeGrid, find_grid, resample

ENCODER_QUANTITIES = ("q", "qlink")
"""Quantities that encoders measure."""


@dataclass(frozen=True)
class RecordingContext:
    """Source, robot and stated properties of a recording.

    Attributes:
        source: Name of the recording.
        robot: Robot that it records.
        sidecar: Its sidecar.
        limits: Limits of the robot, None: those of the URDF.
        columns: Standard names of columns -> differing names in the file.
    """

    source: str
    robot: Robot
    sidecar: Sidecar
    limits: Limits | None
    columns: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RowWindow:
    """Ordered rows of which a part is wanted.

    The other rows are context, so that repairs are the same as in the complete recording.

    Attributes:
        block: The rows.
        start: Time of the first wanted row [s].
        end: Time of the last wanted row [s].
        done: Time up to which rows were in an earlier window [s].
        remarks: Remarks about the order of rows.
    """

    block: Block
    start: float = -np.inf
    end: float = np.inf
    done: float = -np.inf
    remarks: tuple[Remark, ...] = ()


def check_and_repair(
    context: RecordingContext, window: RowWindow, grid: TimeGrid, *, complete: bool
) -> Recording:
    """Check and repair a window of rows.

    Args:
        context: The recording.
        window: Rows of it.
        grid: Even grid of its rows.
        complete: The window is the complete recording, so that signals can be judged.

    Raises:
        UnusableInput: Units are wrong, or there are too few rows or values.
    """
    source, robot = context.source, context.robot
    block = floating_signals.with_continuous_quaternions(source, window.block)
    repairs = list[Remark]()
    held, freezes, irregular = list[Remark](), np.empty(0), False
    if complete:
        block, held, freezes = held_values.keep_updates(block)
        if held:
            irregular = any(remark.kind is RemarkKind.REPEATED for remark in held)
            grid = find_grid(source, block.t, freezes, complete=irregular)
        try:
            block, repairs = glitches.mask_glitches(source, block, robot, context.limits)
        except UnusableInput:
            # in another unit, all motion is too fast
            glitch_share = glitches.MAX_GLITCH_SHARE
            units.check_positions(source, block, robot, context.limits, glitch_share)
            raise
        block, wraps = position_wraps.unwrap_positions(block, robot, context.limits)
        repairs += wraps
    block, missing = missing_values.fill_missing(source, robot.joints, block)
    if len(block) < (MIN_ROWS if complete else 2):
        raise UnusableInput(f"{source}: has {len(block)} usable rows; give at least {MIN_ROWS}")
    units.check_positions(source, block, robot, context.limits)
    units.check_further_positions(source, block, robot)
    inconsistent = units.check_velocities(source, block, robot)
    stamps: list[Remark] = []
    if complete:
        block, stamps = uneven_stamps.correct_uneven_stamps(block, grid)
        if stamps:
            grid = find_grid(source, block.t, freezes, complete=irregular)
    gridded, uneven = resample(block, grid)
    remarks = [*block.remarks, *window.remarks, *held, *repairs, *missing, *stamps, *uneven]
    smoothed = np.zeros(robot.n, bool)
    if complete:
        remarks += [
            *_unknown_keys(context.sidecar),
            *inconsistent,
            *signal_checks.check_signals(block, robot, context.limits),
        ]
        gridded, jitter = _without_jitter(gridded, grid)
        if not jitter:  # positions read at other times than their stamps are not smooth
            resolution = encoder_resolution.estimate_resolution(block.values["q"])
            gridded, smoothed = _without_quantization(gridded, resolution)
        remarks += [*jitter, *_quantization_remarks(robot, smoothed)]
    inside = gridded.rows((gridded.t >= window.start) & (gridded.t <= window.end))
    joint_values = {name: inside.values[name] for name in QUANTITIES if name in inside.values}
    base = inside.values.get("base")
    t = window.block.t
    return Recording(
        source=source,
        joints=robot.joints,
        t=inside.t,
        **joint_values,
        base=None if base is None else floating_signals.unit_quaternions(base),
        signals={
            name: value
            for name, value in inside.values.items()
            if name != "base" and name not in joint_values
        },
        sidecar=context.sidecar,
        remarks=tuple(remarks),
        row_times=t[(t >= window.start) & (t <= window.end)],
        encoder_noise=encoder_resolution.quantization_noise(block.values["q"]),
        smoothed=smoothed,
        run_in=int(np.searchsorted(inside.t, window.done, side="right")),
        columns=context.columns,
    )


def _without_jitter(block: Block, grid: TimeGrid) -> tuple[Block, list[Remark]]:
    """Correct positions of all encoders where the joints agree that stamps are jittered."""
    jitter = timestamp_jitter.estimate_jitter(block.t, block.values["q"], grid.step)
    if jitter is None:
        return block, []
    values = {
        name: jitter.corrected(value) if name in ENCODER_QUANTITIES else value
        for name, value in block.values.items()
    }
    error = f"{1e3 * jitter.rms:.2g} ms (rms)"
    text = (
        f"positions of all joints were read with a timing error of {error}; their values at the "
        "stamps are estimated"
    )
    remark = Remark(RemarkKind.TIMESTAMP_JITTER, text, repaired=True)
    return Block(block.t, values, block.remarks), [remark]


def _without_quantization(block: Block, resolution: FloatArray) -> tuple[Block, BoolArray]:
    """Smooth positions within the resolution of their encoders; return a mask of these joints."""
    q, smoothed = quantization.smooth_positions(block.t, block.values["q"], resolution)
    return Block(block.t, {**block.values, "q": q}, block.remarks), smoothed


def _quantization_remarks(robot: Robot, smoothed: BoolArray) -> list[Remark]:
    joints = ", ".join(f"'{robot.joints[j]}'" for j in np.flatnonzero(smoothed))
    text = f"positions of joints {joints} are smoothed within the resolution of their encoders"
    return [Remark(RemarkKind.ROUNDED, text, repaired=True)] if joints else []


def warn_of_repairs(source: str, remarks: Iterable[Remark]) -> None:
    """Warn of each repaired fault; quantization and a slow refresh are no faults."""
    for remark in remarks:
        if remark.repaired and remark.kind not in (RemarkKind.HELD, RemarkKind.ROUNDED):
            warnings.warn(f"{source}: {remark.text}", ExciteWarning, stacklevel=3)


def _unknown_keys(sidecar: Sidecar) -> list[Remark]:
    return [
        Remark(
            RemarkKind.SKIPPED,
            f"the sidecar's '{key}' is none of {', '.join(KEYS)}; it is ignored",
        )
        for key in sidecar.unknown
    ]
