"""Joint elasticity: a torsional spring between motor and link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from .effect import (
    CandidateModel,
    Effect,
    NonlinearParameter,
    grid_candidates,
    is_between,
    named_coefficients,
    variants_within,
)
from .gear_dynamics import (
    FREQUENCY_FACTOR,
    elastic_deflection,
    link_lag_torque,
    neighbouring_damping_ratios,
    starts_in_motion,
)
from .recorded_motion import RecordedMotion

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


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Torque of a link on a torsional spring behind its motor."""
    values = model.values
    lag = elastic_deflection(
        motion, model.joint_index, values["stiffness"], values["damping"], bool(values["rests"])
    )
    return link_lag_torque(motion, model.joint_index, lag, Grid.COARSE)


def _dominant_inertial_stiffness(
    motions: Sequence[RecordedMotion], joint: int, stiffness: float
) -> float:
    """M ω² at the frequency that shows a stiff spring best [N m/rad].

    The deflection of a stiff spring scales with 1/(K − M ω²), which the ratio of the deflections
    of K and 1.1 K gives.
    """

    def torque(stiffness: float) -> FloatArray:
        model = CandidateModel(
            "elasticity",
            joint,
            _columns,
            {"stiffness": stiffness, "damping": DAMPING_RATIOS[0], "rests": 0.0},
        )
        return np.concatenate([model.columns(motion) for motion in motions])

    soft, stiff = torque(stiffness), torque(STIFFNESS_RATIO * stiffness)
    ratio = float(
        np.clip(
            np.sum(soft * stiff) / max(float(np.sum(soft * soft)), 1e-300),
            0.0,
            1.0 / STIFFNESS_RATIO,
        )
    )
    # from ratio = (K − M ω²)/(1.1 K − M ω²)
    return stiffness * (1.0 - STIFFNESS_RATIO * ratio) / (1.0 - ratio)


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """The deflection for a stiffness, times a coefficient that should be near 1.

    A link that resonates below the cutoff frequency shows its stiffness by that frequency.
    Otherwise only the size τ/(K − M ω²) of the deflection shows it: a softer spring with a smaller
    coefficient looks the same, and the stiffness with coefficient 1 is reported.
    """
    hertz = motions[0].band.hertz

    def family(
        joint: int,
        inertia: float,
        inertial_stiffness: float,
        starts_at_rest: float,
        min_scale: float,
        damping: float = DAMPING_RATIOS[0],
    ) -> Callable[[float], CandidateModel]:
        def model(stiffness: float) -> CandidateModel:
            resonates = np.sqrt(stiffness / inertia) < 2.0 * np.pi * hertz
            part = min(inertial_stiffness, stiffness)

            def static_stiffness(c: FloatArray) -> dict[str, float]:
                return {"stiffness": float(part + (stiffness - part) / c[0])}

            def variants() -> list[NonlinearParameter]:
                return variants_within(
                    stiffness,
                    FREQUENCY_FACTOR**2,
                    (
                        family(joint, inertia, inertial_stiffness, starts_at_rest, min_scale, z)
                        for z in neighbouring_damping_ratios(damping)
                    ),
                )

            return CandidateModel(
                "elasticity",
                joint,
                _columns,
                {"stiffness": stiffness, "damping": damping, "rests": starts_at_rest},
                parameters=named_coefficients(stiffness=stiffness)
                if resonates
                else static_stiffness,
                is_plausible=is_between(min_scale, MAX_SCALE),
                variants=variants,
            )

        return model

    for j in range(motions[0].n):
        inertia = float(np.mean([motion.link_inertias[:, j].mean() for motion in motions]))
        grid = [float(inertia * (2.0 * np.pi * f) ** 2) for f in RESONANCES]
        inertial_stiffness = _dominant_inertial_stiffness(motions, j, grid[-1])
        in_motion = any(starts_in_motion(motion, j) for motion in motions)
        for starts_at_rest in (0.0, 1.0) if in_motion else (0.0,):
            for damping in DAMPING_RATIOS:
                yield from grid_candidates(
                    grid[:-1],
                    family(j, inertia, inertial_stiffness, starts_at_rest, MIN_SCALE, damping),
                )
        yield family(j, inertia, inertial_stiffness, 0.0, MIN_STIFF_SCALE)(grid[-1])


ELASTICITY = Effect(
    "elasticity",
    "M δ̈ + D δ̇ + K δ = τ, δ the deflection between motor encoder and link (Spong 1987)",
    _columns,
    _candidates,
    {"stiffness": "N m/rad"},
    "residual like the second derivative of the load",
    "fast motion at several poses",
    form_std={"stiffness": 0.14},
)
"""Flexible joint; users call it joint flexibility, gear compliance or harmonic-drive torsion."""
