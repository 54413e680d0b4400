"""Base compliance: the base oscillates under the robot's reaction forces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import factorial

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from ..schemas.effects import BASE_MODES
from .effect import CandidateModel, Effect, NonlinearParameter, Values, grid_candidates, within
from .gear_dynamics import (
    FREQUENCY_FACTOR,
    MIN_STIFFNESS_SHARE,
    neighbouring_damping_ratios,
    simulate_oscillator,
    solve_linear_recursion,
)
from .recorded_motion import FittedRobot, Motions, RecordedMotion

FREQUENCIES = np.geomspace(1.9, 19.0, 10)
"""Grid of natural frequencies of the base under the moving robot, of two axes their mean [Hz].
Optimised between its points they have a prior from 1.5 to 24 Hz: mounts of robots lie at 5 to 20 Hz
(the catalogue's usual sizes), soft stands below."""
DAMPING_RATIOS = (0.08, 0.3)
"""Damping ratios of the initial grid; the second, wide one locates a resonance that lies between
two grid frequencies, from where it is optimised."""
PEDESTAL_INERTIA = 0.12
"""Initial inertia of the pedestal over the robot's largest inertia with all joints at zero."""
MIN_PEDESTAL_INERTIA = 0.02
"""Smallest inertia of the pedestal, in the same unit."""
MAX_PEDESTAL_INERTIA = 2.0
"""Largest inertia of the pedestal, in the same unit."""
PEDESTAL_FACTOR = 2.5
"""Factor between neighbouring inertias of the pedestal."""
FREQUENCY_RATIO_FACTOR = 1.15
"""Factor between neighbouring ratios of the frequencies about the second and the first axis."""
MAX_FREQUENCY_RATIO = 2.0
"""Largest ratio of these frequencies, over that of equal ones or of equal springs."""
MAX_SCALE, MAX_OPPOSED = 4.0, 0.3
"""Largest plausible coefficient of the response to a force, by errors of the robot's inertia, and
the largest one against the force, over the largest along it."""


def simulate_base(
    inertia: FloatArray, damping: FloatArray, stiffness: FloatArray, force: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Simulate coupled oscillators under each force (C, k) alone, with matrices (C, k, k).

    Each step `dt` [s] is exact for the means of all coefficients over the step. Position, velocity
    and acceleration have the shape (C, k, k), with a column for each force.
    """
    count, k = force.shape
    if k == 1:  # in closed form
        m, d, s = (x[:, 0, 0] for x in (inertia, damping, stiffness))
        position, speed = simulate_oscillator(force[:, 0], m, s, d, dt)
        acceleration = (force[:, 0] - s * position - d * speed) / m
        return position[:, None, None], speed[:, None, None], acceleration[:, None, None]
    forces = force[:, :, None] * np.eye(k)
    m, d, s, f = (0.5 * (x[1:] + x[:-1]) for x in (inertia, damping, stiffness, forces))
    inverse_mass = np.linalg.inv(m)
    # velocities are divided by the largest rate, so that all entries are of similar size
    fastest = np.sqrt(np.abs(inverse_mass @ s).sum(axis=2).max())
    rate = np.zeros((count - 1, 2 * k, 2 * k))
    rate[:, :k, k:], rate[:, k:, :k], rate[:, k:, k:] = (
        fastest * np.eye(k),
        -inverse_mass @ s / fastest,
        -inverse_mass @ d,
    )
    push = np.concatenate([np.zeros((count - 1, k, k)), inverse_mass @ f / fastest], axis=1)
    transition, integral = matrix_exponential(rate * dt)
    start = np.concatenate([np.linalg.solve(stiffness[0], forces[0]), np.zeros((k, k))])
    state = solve_linear_recursion(transition, integral @ push * dt, start)
    position, speed = state[:, :k], fastest * state[:, k:]
    acceleration = np.linalg.solve(inertia, forces - stiffness @ position - damping @ speed)
    return position, speed, acceleration


def matrix_exponential(a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return exp(A) and ∫₀¹ exp(A s) ds of stacked matrices, shape (…, k, k).

    Scaling and squaring with Taylor series of order nine (Higham, Functions of Matrices, 2008,
    ch. 10). `scipy.linalg.expm` takes five times as long for 2,000 matrices.
    """
    halvings = max(0, int(np.ceil(np.log2(max(float(np.abs(a).sum(axis=-1).max()), 1e-300)))))
    unit, a = np.eye(a.shape[-1]), a * 0.5**halvings
    square = a @ a
    cube = square @ a

    # the mean Σ Aᵏ/(k + 1)!, in powers of the cube (Paterson & Stockmeyer 1973)
    c = [1.0 / factorial(k + 1) for k in range(10)]
    parts = [c[k] * unit + c[k + 1] * a + c[k + 2] * square for k in (0, 3, 6)]
    mean = parts[0] + cube @ (parts[1] + cube @ (parts[2] + c[9] * cube))
    exponential = unit + a @ mean
    for _ in range(halvings):
        exponential, mean = exponential @ exponential, 0.5 * (unit + exponential) @ mean
    return exponential, mean


def _upright_inertia(motion: RecordedMotion, axes: Sequence[int], pedestal: float) -> FloatArray:
    """Inertia of robot and pedestal about some axes with all joints at zero, shape (k,)."""
    upright = motion.upright_inertia[list(axes)]
    return np.asarray(upright + pedestal * upright.max())


def _upright_frequency_ratio(motions: Motions, axes: Sequence[int], pedestal: float) -> float:
    """Frequency of the base with all joints at zero over that under the moving robot."""
    upright, along = motions[0].upright_inertia[list(axes)], list(axes)
    in_motion = np.mean(
        [motion.base_dynamics.mass[:, along, along].mean(axis=0) for motion in motions], axis=0
    )
    added = pedestal * upright.max()
    return float(np.exp(0.5 * np.mean(np.log((in_motion + added) / (upright + added)))))


def _usual_frequency_ratios(
    motions: Motions, axes: Sequence[int], pedestal: float
) -> tuple[float, ...]:
    """Ratios of the frequencies about the second and the first axis, all joints at zero.

    Both frequencies are the same, or both springs: with the arm stretched, the moments of inertia
    about the axes differ by a factor of ten.
    """
    inertia = _upright_inertia(motions[0], axes, pedestal)
    of_equal_springs = float(np.sqrt(inertia[0] / inertia[-1]))
    is_same = abs(np.log(of_equal_springs)) < np.log(FREQUENCY_RATIO_FACTOR)
    return (1.0,) if is_same else (1.0, of_equal_springs)


class _BaseCompliance(Effect):
    """A base on springs, with a column for the force of the robot along each coordinate.

    (M + I₀) ẍ + (∂τ/∂ẋ + D) ẋ + (∂τ/∂x + K) x = force of the robot minus its mean; see
    `FloatingBaseDynamics`. The inertia is that in the present pose; the frequencies are stated for
    all joints at zero, so that the springs are the same in all recordings. A tilting base also
    tilts gravity, which dominates in slow motion.
    """

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        values = model.values
        axes = list(BASE_MODES[int(values["way"])])
        dynamics = motion.base_dynamics
        mass, by_speed, by_place = (
            x[:, :, axes] for x in (dynamics.mass, dynamics.by_speed, dynamics.by_place)
        )
        inertia = _upright_inertia(motion, axes, values["stand"])
        spring = (
            2.0 * np.pi * values["frequency"] * values["apart"] ** np.arange(len(axes))
        ) ** 2 * inertia
        damping = 2.0 * values["damping"] * np.sqrt(spring * inertia)
        # gravity may not take more of a spring's stiffness than a standing base can lose
        toppling = float(np.abs(by_place[:, axes]).sum(axis=2).max() / spring.min())
        stiffness = np.diag(spring) + by_place[:, axes] * min(
            1.0, (1.0 - MIN_STIFFNESS_SHARE) / max(toppling, 1e-9)
        )
        base_motion = simulate_base(
            mass[:, axes] + np.diag(inertia - motion.upright_inertia[axes]),
            by_speed[:, axes] + np.diag(damping),
            stiffness,
            (dynamics.reaction.mean(axis=0) - dynamics.reaction)[:, axes],
            1.0 / motion.band.rate_of(Grid.COARSE),
        )
        on_joints = (x[:, 6:] for x in (by_place, by_speed, mass))
        torque = [part @ x for part, x in zip(on_joints, base_motion, strict=True)]
        return motion.lowpass(np.sum(torque, axis=0), Grid.COARSE)

    def candidates(self, motions: Motions) -> Iterator[CandidateModel]:
        """Yield frequencies and damping ratios of every mode, and both usual frequency ratios."""
        for mode, axes in enumerate(BASE_MODES):
            ratio = _upright_frequency_ratio(motions, axes, PEDESTAL_INERTIA)
            for apart in _usual_frequency_ratios(motions, axes, PEDESTAL_INERTIA):
                # the mean of both frequencies
                frequencies = (FREQUENCIES * ratio / np.sqrt(apart)).tolist()
                for damping in DAMPING_RATIOS:
                    values = {
                        "frequency": frequencies[0],
                        "damping": damping,
                        "way": float(mode),
                        "stand": PEDESTAL_INERTIA,
                        "apart": apart,
                    }
                    model = CandidateModel(self, None, values, motions=motions)
                    yield from grid_candidates(model, "frequency", frequencies)

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        return {"frequency": model.values["frequency"]}

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Check that the base moves in the direction of the force."""
        return bool(0.0 < c.max() < MAX_SCALE and c.min() > -MAX_OPPOSED * c.max())

    def variants(self, model: CandidateModel) -> list[NonlinearParameter]:
        """Change damping, the pedestal's inertia, or the ratio of two frequencies."""
        v, axes = model.values, BASE_MODES[int(model.values["way"])]
        out = [model.with_values(damping=z) for z in neighbouring_damping_ratios(v["damping"])]
        for stand in (v["stand"] / PEDESTAL_FACTOR, v["stand"] * PEDESTAL_FACTOR):
            if MIN_PEDESTAL_INERTIA < stand < MAX_PEDESTAL_INERTIA:
                # the same frequency under the moving robot
                frequency = (
                    v["frequency"]
                    * _upright_frequency_ratio(model.motions, axes, stand)
                    / _upright_frequency_ratio(model.motions, axes, v["stand"])
                )
                out.append(model.with_values(frequency=frequency, stand=stand))
        neighbours = v["apart"] / FREQUENCY_RATIO_FACTOR, v["apart"] * FREQUENCY_RATIO_FACTOR
        usual = _usual_frequency_ratios(model.motions, axes, v["stand"])
        out += [
            model.with_values(apart=ratio)
            for ratio in (neighbours if len(axes) > 1 else ())
            if min(usual) / MAX_FREQUENCY_RATIO < ratio < max(usual) * MAX_FREQUENCY_RATIO
        ]
        return [within(variant, "frequency", FREQUENCY_FACTOR) for variant in out]


BASE_COMPLIANCE = _BaseCompliance(
    "base_compliance",
    "a mass on springs under the robot that slides, tilts or turns (its frequency: all joints at "
    "zero)",
    {"frequency": "Hz"},
    "the same resonance in all joints",
    "a chirp of joint 1 with the arm stretched",
    regime="frequency",
    max_models=2,
    form_std={"frequency": 0.2},
)
"""Compliant base; users call it a wobbly table, a soft mount or an oscillating pedestal."""
