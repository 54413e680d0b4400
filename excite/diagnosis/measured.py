"""How well recordings were made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Measured:
    """feigned: further gain that each effect at each joint needs, for what faults of measurement may give it. stepped: share of the noise
    that is an encoder's steps. noise: its mean square over the scale, per joint, Shape (n,), where it is what differs when a motion is made
    again; None where it is but a guess from below."""

    feigned: Mapping[tuple[str, int | None], float] = field(default_factory=dict)
    stepped: float = 0.0
    noise: Array | None = None

    def feigns(self, effect: str, joint: int | None) -> float:
        """What an effect at a joint needs; where that joint was not looked at, as much as where it is most."""
        if (effect, joint) in self.feigned:
            return self.feigned[effect, joint]
        return max(
            (gain for (name, _), gain in self.feigned.items() if name == effect), default=0.0
        )
