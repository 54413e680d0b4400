"""How a design came about, as the report tells it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class DesignRecord:
    """All starts, which one was chosen (its place in `starts`), the command's timing [s] and remarks in words.

    starts: each with `seed` (its number), `value` (smooth objective at its end, a logarithm, lower is better), `feasible`,
    and per iterate `time` since the problem was built [s], `objective` and `worst` (largest row value, ≤ 1 inside all
    limits). Where the criterion is smoothed in stages, `stage` per iterate: only values of the last stage compare.
    `stopped`: put aside before its end, because others were ahead.
    """

    starts: Sequence[Mapping[str, Any]]
    chosen: int = 0
    timing: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
