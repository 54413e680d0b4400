"""The design problem: a periodic motion's coefficients, the criterion to minimise and the rows that bound it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..collision.clearance_constraint import Clearance
from ..robot.inertial_parameters import Parameters
from ..robot.limits import Braking, Limits
from ..robot.robot import Robot
from ..trajectory.fourier import (
    VERIFICATION_DENSITY,
    FourierSeries,
    fourier_basis,
    oversampling_bound,
)
from . import casadi_model
from .casadi_model import DynamicsFunctions
from .criteria import Criterion, Weighting
from .motion_overlap import OverlapPenalty

Array = np.ndarray
LIMIT_RESERVE = 2e-3
"""Share of each curved limit kept for the solver's tolerance and what happens between samples; the certificate decides."""


@dataclass(frozen=True)
class WorkspaceBox:
    """A frame's origin stays in a box of the base frame. lower, upper: Shape (3,) [m]."""

    frame: str
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


@dataclass(frozen=True)
class DesignOptions:
    """What the user may choose of a design.

    criterion, plain: what is optimised, in the metric or Euclidean. drive: joint parameters besides the inertial ones.
    harmonics: K. period: T [s]; free_period: bounds within which T is optimised, or None. samples: N over one period.
    periods: repeats in the motion. rate: rows a second of the exported motion [Hz].
    uncertainty: r, radius of the ball of robots for which torque limits hold.
    noise: torque standard deviation per joint [N m]; None: 1 % of the torque limit.
    boxes: Cartesian boxes. starts, seed, jobs: random starts, their seed, processes. iterations: per start.
    """

    criterion: Criterion = Criterion.A
    plain: bool = False
    drive: tuple[str, ...] = ("rotor_inertia", "viscous", "coulomb", "offset")
    harmonics: int = 5
    period: float = 10.0
    free_period: tuple[float, float] | None = None
    samples: int = 100
    periods: int = 2
    rate: float = 100.0
    uncertainty: float = 0.1
    noise: tuple[float, ...] | None = None
    boxes: tuple[WorkspaceBox, ...] = ()
    starts: int = 2
    seed: int = 0
    jobs: int = -1
    iterations: int = 300


@dataclass(frozen=True)
class DesignProblem:
    """Everything one start needs; picklable, so that starts run in other processes.

    limits, boxes: as the optimiser sees them, shrunk so that they hold between its samples.
    weighting: coordinates of the criterion. given: G, GᵀG the information of earlier recordings in those coordinates,
        per sample of the motion to come. Shape (p, p).
    scale: size of one unit of each variable: coefficients (a, b, offset) per joint. Shape (n, 2K+1).
    functions: the dynamics and their derivatives.
    apart: a motion to keep apart from, at a price added to the objective, or None.
    clearance: bodies that keep apart at the samples, or None where no shape is known. home: pose from which the motion is to be
        reached clear of everything, or None. Shape (n,).
    """

    robot: Robot
    parameters: Parameters
    limits: Limits
    boxes: tuple[WorkspaceBox, ...]
    weighting: Weighting
    given: Array | None
    options: DesignOptions
    scale: Array
    functions: DynamicsFunctions
    overlap_penalty: OverlapPenalty | None = None
    clearance: Clearance | None = None
    start_pose: Array | None = None

    @property
    def size(self) -> int:
        """Number of decision variables."""
        return self.scale.size + (self.options.free_period is not None)

    def fourier(self, x: Array) -> FourierSeries:
        """The motion that the variables describe."""
        K = self.options.harmonics
        table = x[: self.scale.size].reshape(self.scale.shape) * self.scale
        return FourierSeries(table[:, :K], table[:, K : 2 * K], table[:, 2 * K], self.period(x))

    def period(self, x: Array) -> float:
        """T [s]."""
        return (
            float(self.options.period * x[-1])
            if self.options.free_period is not None
            else self.options.period
        )

    def variables(self, motion: FourierSeries) -> Array:
        """The inverse of `fourier`."""
        table = np.column_stack([motion.sine, motion.cosine, motion.offset])
        x: Array = (table / self.scale).ravel()
        return (
            np.append(x, motion.period / self.options.period)
            if self.options.free_period is not None
            else x
        )

    def bases(self) -> tuple[Array, ...]:
        """Per derivative order 0…3 the factors of (a, b, offset) at the samples. Shape (N, 2K+1) each."""
        o = self.options
        t = np.arange(o.samples) * (o.period / o.samples)
        out = []
        for order in range(4):
            a, b = fourier_basis(t, 2.0 * np.pi / o.period, o.harmonics, order)
            out.append(np.column_stack([a, b, np.full(len(t), float(order == 0))]))
        return tuple(out)


def build_problem(
    robot: Robot,
    limits: Limits,
    parameters: Parameters,
    weighting: Weighting,
    options: DesignOptions,
    given: Array | None = None,
    reserve: float = LIMIT_RESERVE,
    functions: DynamicsFunctions | None = None,
) -> DesignProblem:
    """Shrink the limits for what happens between samples and choose the variables' scales."""
    # The first factor bounds what the motion does between samples, exactly; the second is the certificate's own doubt.
    factor = 1.0 / (
        oversampling_bound(options.samples, K := options.harmonics)
        * oversampling_bound(VERIFICATION_DENSITY * options.samples, K)
    )
    bounded = np.isfinite(limits.position).all(axis=1)
    lower, upper = np.where(bounded[:, None], limits.position, 0.0).T
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    position = np.where(
        bounded[:, None],
        np.column_stack([middle - factor * half, middle + factor * half]),
        limits.position,
    )
    free = limits.reduced()
    shrunk = free.scaled(velocity=factor, acceleration=factor, jerk=factor, torque=1.0 - reserve)
    shrunk = dataclasses.replace(
        shrunk,
        position=position,
        braking=tuple(None if b is None else _earlier(b, reserve) for b in free.braking),
    )
    boxes = tuple(_smaller(box, reserve) for box in options.boxes)
    harmonics = np.arange(1, options.harmonics + 1)
    reach = np.where(bounded, half, np.pi)
    speed = np.minimum(limits.velocity, reach * 2.0 * np.pi / options.period)[:, None] / np.sqrt(
        harmonics
    )
    scale = np.column_stack([speed, speed, reach])
    functions = functions or casadi_model.dynamics_functions(robot, parameters)
    weighting = dataclasses.replace(weighting, support=functions.support)
    return DesignProblem(robot, parameters, shrunk, boxes, weighting, given, options, scale, functions)


def rebuild_problem(
    old: DesignProblem, limits: Limits, options: DesignOptions, given: Array | None, reserve: float = LIMIT_RESERVE
) -> DesignProblem:
    """The same problem with other limits, options, earlier information or reserve; it keeps clear of and apart from the same."""
    new = build_problem(
        old.robot, limits, old.parameters, old.weighting, options, given, reserve, old.functions
    )
    return dataclasses.replace(new, overlap_penalty=old.overlap_penalty, clearance=old.clearance, start_pose=old.start_pose)


def _earlier(brake: Braking, reserve: float) -> Braking:
    middle, half = 0.5 * sum(brake.stop), 0.5 * (1.0 - reserve) * (brake.stop[1] - brake.stop[0])
    return dataclasses.replace(brake, stop=(middle - half, middle + half))


def _smaller(box: WorkspaceBox, reserve: float) -> WorkspaceBox:
    lower, upper = np.array(box.lower), np.array(box.upper)
    middle, half = 0.5 * (lower + upper), 0.5 * (1.0 - reserve) * (upper - lower)
    return WorkspaceBox(box.frame, tuple(middle - half), tuple(middle + half))


def torque_noise_levels(limits: Limits, noise: Sequence[float] | None) -> Array:
    """Torque standard deviation per joint [N m]: as given, else 1 % of each torque limit."""
    return np.asarray(noise, float) if noise is not None else 0.01 * limits.torque
