"""The course of a design's optimisation, as its report shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class DesignRecord:
    """All starts of the optimiser, the chosen one, and remarks.

    Attributes:
        starts: For each start: `seed` (its number), `value` (smoothed objective at its end, a
            logarithm, lower is better), `feasible`, and per iterate `objective` and `worst`
            (largest constraint value, ≤ 1 inside all limits). Where the criterion is smoothed in
            stages, `stage` per iterate: only values of the last stage are comparable. `stopped`:
            ended early by successive halving.
        chosen: Index of the chosen start.
        notes: Remarks of the run, in words.
    """

    starts: Sequence[Mapping[str, Any]]
    chosen: int = 0
    notes: tuple[str, ...] = ()
