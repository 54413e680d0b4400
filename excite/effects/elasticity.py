"""Joint elasticity: a torsional spring between motor and link."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from .effect import CandidateModel, Effect, NonlinearParameter, Values, grid_candidates, within
from .gear_dynamics import (
    FREQUENCY_FACTOR,
    elastic_deflection,
    link_lag_torque,
    neighbouring_damping_ratios,
    starts_in_motion,
)
from .recorded_motion import FittedRobot, Motions, RecordedMotion

RESONANCES = np.geomspace(3.0, 34.0, 14)
"""Resonance frequencies of the link on its motor that define the stiffness grid [Hz]: from where
the softest usual gear, 10³ N m/rad, holds a link of 3 kg m², to above the usual cutoff frequency.
Bounds of a prior, not of a score."""
STIFFNESS_RATIO = 1.1
"""Ratio of two stiffnesses whose deflections are compared to find the dominant M ω²."""
DAMPING_RATIOS = (0.07, 0.25)
"""Damping ratios of the initial grid. Gears have a few per cent; the second, wide one locates a
resonance that lies between two grid frequencies, from where it is optimised."""
MIN_SCALE, MAX_SCALE = 0.3, 3.0
"""Plausible coefficients of the torque of a stiffness [1]: links may be that much heavier."""
MIN_STIFF_SCALE = 0.01
"""Smallest coefficient of the stiffest spring of the grid: it stands for up to 100 times stiffer
ones, whose deflection has the same form."""


class _Elasticity(Effect):
    """Torque of a link on a torsional spring behind its motor.

    Its coefficient should be near 1. A link that resonates below the cutoff frequency shows its
    stiffness by that frequency. Otherwise only the size τ/(K − M ω²) of the deflection shows it: a
    softer spring with a smaller coefficient looks the same, and the stiffness with coefficient 1 is
    reported.
    """

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        values = model.values
        lag = elastic_deflection(
            motion, model.joint_index, values["stiffness"], values["damping"], bool(values["rests"])
        )
        return link_lag_torque(motion, model.joint_index, lag, Grid.COARSE)

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        inertia = float(np.mean([motion.link_inertias[:, joint].mean() for motion in motions]))
        grid = [float(inertia * (2.0 * np.pi * f) ** 2) for f in RESONANCES]
        values = {"stiffness": grid[-1], "damping": DAMPING_RATIOS[0], "rests": 0.0}
        stiffest = CandidateModel(self, joint, values)
        facts = {
            "resonant_stiffness": inertia * (2.0 * np.pi * motions[0].band.hertz) ** 2,
            "inertial_stiffness": _dominant_inertial_stiffness(motions, stiffest),
            "min_scale": MIN_SCALE,
        }
        in_motion = any(starts_in_motion(motion, joint) for motion in motions)
        for starts_at_rest in (0.0, 1.0) if in_motion else (0.0,):
            for damping in DAMPING_RATIOS:
                model = stiffest.with_values(damping=damping, rests=starts_at_rest)
                yield from grid_candidates(replace(model, facts=facts), "stiffness", grid[:-1])
        yield replace(stiffest, facts=facts | {"min_scale": MIN_STIFF_SCALE})

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        stiffness = model.values["stiffness"]
        if stiffness < model.facts["resonant_stiffness"]:
            return {"stiffness": stiffness}
        part = min(model.facts["inertial_stiffness"], stiffness)
        return {"stiffness": float(part + (stiffness - part) / c[0])}

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        return bool(model.facts["min_scale"] < c[0] < MAX_SCALE)

    def variants(self, model: CandidateModel) -> list[NonlinearParameter]:
        ratios = neighbouring_damping_ratios(model.values["damping"])
        variants = [model.with_values(damping=ratio) for ratio in ratios]
        return [within(variant, "stiffness", FREQUENCY_FACTOR**2) for variant in variants]


def _dominant_inertial_stiffness(motions: Motions, model: CandidateModel) -> float:
    """M ω² at the frequency that shows a stiff spring best [N m/rad].

    The deflection of a stiff spring scales with 1/(K − M ω²), which the ratio of the deflections
    of K and 1.1 K gives.
    """
    stiffness = model.values["stiffness"]
    stiffer = model.with_values(stiffness=STIFFNESS_RATIO * stiffness)
    soft, stiff = (
        np.concatenate([spring.columns(motion) for motion in motions])
        for spring in (model, stiffer)
    )
    ratio = float(
        np.clip(
            np.sum(soft * stiff) / max(float(np.sum(soft * soft)), 1e-300),
            0.0,
            1.0 / STIFFNESS_RATIO,
        )
    )
    # from ratio = (K − M ω²)/(1.1 K − M ω²)
    return stiffness * (1.0 - STIFFNESS_RATIO * ratio) / (1.0 - ratio)


ELASTICITY = _Elasticity(
    "elasticity",
    "M δ̈ + D δ̇ + K δ = τ, δ the deflection between motor encoder and link (Spong 1987)",
    {"stiffness": "N m/rad"},
    "residual like the second derivative of the load",
    "fast motion at several poses",
    regime="frequency",
    form_std={"stiffness": 0.14},
)
"""Flexible joint; users call it joint flexibility, gear compliance or harmonic-drive torsion."""
