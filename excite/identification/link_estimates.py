"""Mass and centre of mass of each link with deviations, and the share that the data decide.

The share of a quantity g(ψ) is 1 − var(g | data and prior) / var(g | prior): 1 where the recording
decides it, 0 where the prior does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import FloatArray
from ..robot.inertial_parameters import Parameters
from . import consistency
from .consistency import ConsistentEstimate, Prior

DECIDED_SHARE = 0.5
"""Share from which a quantity counts as decided by the data [1]."""


@dataclass(frozen=True)
class LinkEstimate:
    """Mass and centre of mass of a link, with everything that is fixed to it.

    Attributes:
        name: Name of the link.
        mass: Mass [kg].
        mass_deviation: Its standard deviation [kg].
        mass_share: Share of the mass that the data decide [1].
        centre: Centre of mass in the frame of the joint that moves the link. Shape (3,) [m].
        centre_deviation: Its standard deviations. Shape (3,) [m].
        centre_share: Share of the centre that the data decide, of the least decided axis [1].
    """

    name: str
    mass: float
    mass_deviation: float
    mass_share: float
    centre: FloatArray
    centre_deviation: FloatArray
    centre_share: float

    @property
    def is_prior(self) -> bool:
        """True if the prior decides the mass."""
        return self.mass_share < DECIDED_SHARE

    def document(self) -> dict[str, Any]:
        """Entry of `model.json`."""
        return {
            "name": self.name,
            "mass": {
                "value": self.mass,
                "std": self.mass_deviation,
                "data_share": self.mass_share,
                "decided_by": "prior" if self.is_prior else "data",
            },
            "centre": {
                "value": self.centre.tolist(),
                "std": self.centre_deviation.tolist(),
                "data_share": self.centre_share,
            },
        }


def link_estimates(
    parameters: Parameters,
    posterior: ConsistentEstimate,
    prior: Prior,
    further: FloatArray | None = None,
) -> list[LinkEstimate]:
    """Return mass and centre of mass of each link.

    Args:
        parameters: Standard parameters.
        posterior: Their estimate.
        prior: The prior of that estimate.
        further: Information of other prior knowledge. Shape (P, P).
    """
    local = consistency.local_prior(parameters, prior, posterior.psi)
    information = consistency.prior_information(parameters, local)
    before = consistency.symmetric_pseudo_inverse(
        information if further is None else information + further
    )
    rows = consistency.inertial_rows(parameters, posterior.psi)
    out = []
    for i, (name, phi) in enumerate(zip(parameters.links, rows, strict=True)):
        block = slice(10 * i, 10 * i + 4)
        after = posterior.covariance[block, block]
        gradients = _gradients(phi)
        spread = np.diag(gradients @ before[block, block] @ gradients.T)
        variance = np.diag(gradients @ after @ gradients.T)
        share = np.clip(1.0 - variance / np.maximum(spread, 1e-300), 0.0, 1.0)
        deviation = np.sqrt(np.maximum(variance, 0.0))
        out.append(
            LinkEstimate(
                name,
                float(phi[0]),
                float(deviation[0]),
                float(share[0]),
                phi[1:4] / phi[0],
                deviation[1:],
                float(share[1:].min()),
            )
        )
    return out


def _gradients(phi: FloatArray) -> FloatArray:
    """Derivatives of mass and centre by mass and first moments. Shape (4, 4)."""
    mass, centre = float(phi[0]), phi[1:4] / phi[0]
    out = np.zeros((4, 4))
    out[0, 0] = 1.0
    out[1:, 0] = -centre / mass
    out[1:, 1:] = np.eye(3) / mass
    return out
