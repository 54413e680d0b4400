"""The course of an optimisation, for the report: it has no times of the clock, so that a seed gives the same report again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class DesignRecord:
    """The course of an optimisation.

    Attributes:
        starts: Each with `seed` (its number), `value` (smooth objective at its end, a logarithm, lower is better), `feasible`, and per
            iterate `objective` and `worst` (largest constraint value, at most 1 inside all limits). Where the criterion is smoothed in
            stages, `stage` per iterate: only values of the last stage compare. `stopped`: stopped early, because others were ahead.
        chosen: Place of the chosen start in `starts`.
        notes: Remarks of the run.
    """

    starts: Sequence[Mapping[str, Any]]
    chosen: int = 0
    notes: tuple[str, ...] = ()
