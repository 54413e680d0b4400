"""Blocks of rows as a reader returns them: times and measured quantities, joints in the robot's
order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from .remark import Remark

QUANTITIES = ("q", "dq", "tau", "current", "qref", "qlink", "temperature")
"""Measured quantities, as the fields of `Recording` are named."""


@dataclass(frozen=True)
class Block:
    """Consecutive rows of a recording.

    Attributes:
        t: Times. Shape (N,) [s].
        values: Measured quantities, NaN where a value is missing. Shape (N, n) each; those of a
            floating base have other names and widths, see `floating_signals`.
        remarks: Remarks of the reader.
        locked: Positions of locked joints by name, where the file has them; NaN where a value is
            missing. Only as a reader returns the block [rad or m].
        row: Number of the first row in the file, as users count; None: not known.
    """

    t: FloatArray
    values: Mapping[str, FloatArray]
    remarks: tuple[Remark, ...] = ()
    locked: Mapping[str, FloatArray] = field(default_factory=dict)
    row: int | None = None

    def __len__(self) -> int:
        return len(self.t)

    def rows(self, which: IntArray | BoolArray | slice) -> Block:
        """Return the rows of an index, a mask or a slice."""
        return Block(
            self.t[which], {name: value[which] for name, value in self.values.items()}, self.remarks
        )


def concatenate(blocks: Sequence[Block]) -> Block:
    """Join consecutive blocks with the same quantities."""
    if len(blocks) == 1:
        return blocks[0]
    values = {
        name: np.concatenate([block.values[name] for block in blocks]) for name in blocks[0].values
    }
    return Block(
        np.concatenate([block.t for block in blocks]),
        values,
        tuple(remark for block in blocks for remark in block.remarks),
    )
