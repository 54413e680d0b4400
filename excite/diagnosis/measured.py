"""Quality of the measurements, as far as it limits the evidence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .._types import FloatArray


@dataclass(frozen=True)
class Measured:
    """Quality of the measurements.

    Attributes:
        artefact_gains: Further gain that an effect at a joint needs, as artefacts may mimic it.
        stepped: Share of the noise power by encoder quantisation.
        noise: Mean square noise over the scale, shape (n,); None if only a lower bound is known.
    """

    artefact_gains: Mapping[tuple[str, int | None], float] = field(default_factory=dict)
    stepped: float = 0.0
    noise: FloatArray | None = None

    def artefact_gain(self, effect: str, joint: int | None) -> float:
        """Return the further gain that an effect needs; the largest if its joint was not tested."""
        if (effect, joint) in self.artefact_gains:
            return self.artefact_gains[effect, joint]
        return max(
            (gain for (name, _), gain in self.artefact_gains.items() if name == effect), default=0.0
        )
