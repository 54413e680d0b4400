"""The health check: from rows as found to a recording that can be trusted, with what was done.

Wrong units, a clock that cannot be repaired and mostly missing numbers are errors (`units`,
`clock`, `missing`); order, repeats, jitter, stamps that waver (`waver`), gaps and few missing
numbers are repaired by the rules stated there, remarked and warned of; what an encoder rounded is
repaired and remarked (`rounding`); `signs` are remarked only.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import ExciteWarning, UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from . import encoder, missing_values, quantization, signal_checks, timestamp_jitter, units
from .block import Block
from .recording import SHORTEST, Recording
from .remark import Kind, Remark
from .sidecar import KEYS, Sidecar
from .time_axis import Clock, even

Array = np.ndarray
ENCODERS = ("q", "qlink")


@dataclass(frozen=True)
class Patient:
    """What is known of a recording before its rows are looked at."""

    source: str
    robot: Robot
    sidecar: Sidecar
    limits: Limits | None


@dataclass(frozen=True)
class Window:
    """Ordered rows, of which those with start ≤ t ≤ end are wanted and those with t ≤ done were
    handed out before [s].

    The others are context, so that repairs come out as in the whole file. remarks: how they were
    ordered.
    """

    block: Block
    start: float = -np.inf
    end: float = np.inf
    done: float = -np.inf
    remarks: tuple[Remark, ...] = ()


def recording(patient: Patient, window: Window, clock: Clock, *, whole: bool) -> Recording:
    """Check and repair a window of rows. whole: it is the whole recording, whose channels can be
    judged.

    Raises UnusableInput for wrong units, too few rows or too few numbers.
    """
    source, robot = patient.source, patient.robot
    block, lacks = missing_values.fill(source, robot.joints, window.block)
    if len(block) < (SHORTEST if whole else 2):
        raise UnusableInput(f"{source}: has {len(block)} usable rows; give at least {SHORTEST}")
    units.check_positions(source, block, robot, patient.limits)
    unlike = units.check_velocities(source, block, robot)
    gridded, uneven = even(block, clock)
    remarks = [*block.remarks, *window.remarks, *lacks, *uneven]
    smoothed = np.zeros(robot.n, bool)
    if whole:
        remarks += [
            *_unknown(patient.sidecar),
            *unlike,
            *signal_checks.look(block, robot, patient.limits),
        ]
        gridded, wavered = _steadied(gridded, clock)
        if not wavered:  # positions that were read at other instants are not smooth
            gridded, smoothed = _unrounded(gridded, encoder.steps(block.values["q"]))
        remarks += [*wavered, *_rounded(robot, smoothed)]
    inside = gridded.rows((gridded.t >= window.start) & (gridded.t <= window.end))
    own = window.block.t[(window.block.t >= window.start) & (window.block.t <= window.end)]
    return Recording(
        source=source,
        joints=robot.joints,
        t=inside.t,
        **inside.values,
        sidecar=patient.sidecar,
        remarks=tuple(remarks),
        own_times=own,
        steps=encoder.noise(block.values["q"]),
        smoothed=smoothed,
        run_in=int(np.searchsorted(inside.t, window.done, side="right")),
    )


def _steadied(block: Block, clock: Clock) -> tuple[Block, list[Remark]]:
    """Rows whose positions are what they were at their stamps, where all joints say together that
    they were read at other instants."""
    found = timestamp_jitter.found(block.t, block.values["q"], clock.step)
    if found is None:
        return block, []
    values = {
        name: found.taken(value) if name in ENCODERS else value
        for name, value in block.values.items()
    }
    text = f"positions of all joints were read {1e3 * found.rms:.2g} ms (rms) off their stamps; where they were at the stamps is estimated"  # noqa: E501
    return Block(block.t, values, block.remarks), [Remark(Kind.WAVER, text, repaired=True)]


def _unrounded(block: Block, steps: Array) -> tuple[Block, Array]:
    """Rows whose positions are the smoothest within the steps of their encoders, and of which
    joints they are."""
    q, smoothed = quantization.smoothest(block.t, block.values["q"], steps)
    return Block(block.t, {**block.values, "q": q}, block.remarks), smoothed


def _rounded(robot: Robot, smoothed: Array) -> list[Remark]:
    joints = ", ".join(f"'{robot.joints[j]}'" for j in np.flatnonzero(smoothed))
    text = f"of joints {joints} the smoothest motion is taken that their encoders' steps allow"
    return [Remark(Kind.ROUNDED, text, repaired=True)] if joints else []


def warn(source: str, remarks: Iterable[Remark]) -> None:
    """Tell of each repair of a fault: that an encoder rounds is none."""
    for remark in remarks:
        if remark.repaired and remark.kind is not Kind.ROUNDED:
            warnings.warn(f"{source}: {remark.text}", ExciteWarning, stacklevel=3)


def _unknown(sidecar: Sidecar) -> list[Remark]:
    return [
        Remark(Kind.SKIPPED, f"the sidecar's '{key}' is none of {', '.join(KEYS)}; it is ignored")
        for key in sidecar.unknown
    ]
