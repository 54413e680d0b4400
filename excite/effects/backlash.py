"""Backlash: lost motion between motor and link, with impacts at the boundaries of the gap."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from .effect import CandidateModel, Effect, NonlinearParameter, Values, grid_candidates, within
from .gear_dynamics import link_lag_torque, simulate_backlash_gap
from .recorded_motion import FittedRobot, Motions, RecordedMotion, radian

WIDTHS = np.geomspace(1e-4, 1e-2, 13)
"""Grid of backlash widths [rad], see `recorded_motion.radian`."""
HOLDING_FREQUENCIES = (0.0, 1.5, 3.0, 6.0, 12.0)
"""Grid of natural frequencies of the link inside the gap [Hz]: compliant teeth, oil and seals hold
it there."""
VARIANT_FACTOR = 1.5
"""Factor between neighbouring holding frequencies, and within which the width is optimised."""
MAX_HOLDING_FREQUENCY = 20.0
"""Largest holding frequency [Hz]; above, the joint is elastic."""

SCALES = (0.4, 2.5)
"""Plausible coefficients of the torque of a width [1]; beyond lies another width of the grid."""


class _Backlash(Effect):
    """Torque of a link in its backlash gap, which its load drives from side to side."""

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        j, values = model.joint_index, model.values
        lag = simulate_backlash_gap(
            motion.free_acceleration[:, j],
            1.0 / motion.segment.rate,
            0.5 * values["width"],
            2.0 * np.pi * values["hold"],
        )
        return link_lag_torque(motion, j, lag, Grid.RECORDED)

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        """Yield backlash of a joint whose load changes sign; otherwise the gap stays closed."""
        if not any(np.ptp(np.sign(motion.rigid_torque[:, joint])) > 1.0 for motion in motions):
            return
        # the samples must follow the link
        max_frequency = min(
            MAX_HOLDING_FREQUENCY, *(motion.segment.rate / (2.0 * np.pi) for motion in motions)
        )
        widths = (radian(motions, joint) * WIDTHS).tolist()
        for frequency in (f for f in HOLDING_FREQUENCIES if f <= max_frequency):
            values = {"width": widths[0], "hold": frequency}
            model = CandidateModel(self, joint, values, facts={"max_frequency": max_frequency})
            yield from grid_candidates(model, "width", widths)

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        return {"width": float(model.values["width"] * c[0])}

    def variants(self, model: CandidateModel) -> list[NonlinearParameter]:
        frequencies = (model.values["hold"] * f for f in (1.0 / VARIANT_FACTOR, VARIANT_FACTOR))
        return [
            within(model.with_values(hold=frequency), "width", VARIANT_FACTOR)
            for frequency in frequencies
            if 0.0 < frequency <= model.facts["max_frequency"]
        ]


BACKLASH = _Backlash(
    "backlash",
    "ẍ = τ/M inside a gap ±b/2 with inelastic impacts at its boundaries, x seen from the motor "
    "encoder",
    {"width": "rad"},
    "a kick where the load changes sign",
    "slow reversals through zero load",
    regime="reversal",
    form_std={"width": 0.47},
    bounds=SCALES,
)
"""Backlash; users call it gear play or lost motion."""
