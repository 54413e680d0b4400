"""Rows of a recording as a reader found them: times and whatever was measured, joints in the
robot's order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .remark import Remark

Array = np.ndarray
QUANTITIES = ("q", "dq", "tau", "current", "qref", "qlink", "temperature")


@dataclass(frozen=True)
class Block:
    """t: Shape (N,) [s]. values: quantity -> shape (N, n), NaN where not measured. remarks: what
    the reader has to say."""

    t: Array
    values: Mapping[str, Array]
    remarks: tuple[Remark, ...] = ()

    def __len__(self) -> int:
        return len(self.t)

    def rows(self, which: Array | slice) -> Block:
        """The rows that `which` selects."""
        return Block(
            self.t[which], {name: value[which] for name, value in self.values.items()}, self.remarks
        )


def joined(blocks: Sequence[Block]) -> Block:
    """Blocks one after the other."""
    if len(blocks) == 1:
        return blocks[0]
    values = {
        name: np.concatenate([block.values[name] for block in blocks]) for name in blocks[0].values
    }
    return Block(
        np.concatenate([block.t for block in blocks]),
        values,
        tuple(r for block in blocks for r in block.remarks),
    )
