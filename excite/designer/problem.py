"""The design problem: variables, objective and constraints of one periodic motion."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..collision.clearance_constraint import ClearanceConstraint
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
from .design_objective import DesignObjective
from .motion_overlap import OverlapPenalty
from .options import DesignOptions, WorkspaceBox

LIMIT_RESERVE = 2e-3
"""Share of torque, braking, stand and box limits kept free for the solver's tolerance and for what
happens between samples [1]. The certificate decides whether it suffices; `pipeline` enlarges it if
not."""

STOPPING_GAIN = 4e-3
"""Decrease of the criterion's logarithm over ten iterations below which a search ends [1]."""

STOPPING_GAIN_OF_REGRESSOR = 2e-3
"""The same for the condition number of the regressor [1]."""


@dataclass(frozen=True)
class DesignProblem:
    """Everything that one start needs; picklable, so that starts run in other processes.

    Attributes:
        robot: The robot.
        parameters: Its standard parameters.
        limits: Limits at the optimiser's samples, shrunk so that the given ones hold in between.
        boxes: Boxes at the optimiser's samples, shrunk likewise.
        weighting: Coordinates in which the criterion is a function of the eigenvalues.
        earlier_root: G, with GᵀG the information of earlier recordings in these coordinates per
            sample of the motion to be designed. Shape (p, p).
        options: Options of the design.
        scale: Units of the variables: coefficients (a, b, offset) of each joint. Shape (n, 2K+1).
        functions: Dynamics and their derivatives.
        overlap_penalty: Penalty on similarity to another motion, None without.
        clearance: Bodies that keep their distance at the samples, None where no shape is known.
        start_pose: Pose from which the motion has to be reachable, None without. Shape (n,).
        objective: Objective in place of the criterion of the options, None for the criterion.
        warm_start: Motion with which start 0 begins, None for a random one.
    """

    robot: Robot
    parameters: Parameters
    limits: Limits
    boxes: tuple[WorkspaceBox, ...]
    weighting: Weighting
    earlier_root: FloatArray | None
    options: DesignOptions
    scale: FloatArray
    functions: DynamicsFunctions
    overlap_penalty: OverlapPenalty | None = None
    clearance: ClearanceConstraint | None = None
    start_pose: FloatArray | None = None
    objective: DesignObjective | None = None
    warm_start: FourierSeries | None = None

    @property
    def stopping_gain(self) -> float:
        """Decrease of the objective over ten iterations below which a search ends."""
        if self.objective is not None:
            return self.objective.stopping_gain
        is_regressor = self.options.criterion is Criterion.COND_REGRESSOR
        return STOPPING_GAIN_OF_REGRESSOR if is_regressor else STOPPING_GAIN

    @property
    def size(self) -> int:
        """Number of decision variables."""
        return self.scale.size + (self.options.free_period is not None)

    def fourier(self, x: FloatArray) -> FourierSeries:
        """Return the motion that the variables `x` describe. Shape of `x`: (size,)."""
        K = self.options.harmonics
        table = x[: self.scale.size].reshape(self.scale.shape) * self.scale
        return FourierSeries(table[:, :K], table[:, K : 2 * K], table[:, 2 * K], self.period(x))

    def period(self, x: FloatArray) -> float:
        """Return the period T of the motion that the variables `x` describe [s]."""
        return (
            float(self.options.period * x[-1])
            if self.options.free_period is not None
            else self.options.period
        )

    def variables(self, motion: FourierSeries) -> FloatArray:
        """Return the variables that describe a motion; inverse of `fourier`. Shape (size,)."""
        table = np.column_stack([motion.sine, motion.cosine, motion.offset])
        x: FloatArray = (table / self.scale).ravel()
        return (
            np.append(x, motion.period / self.options.period)
            if self.options.free_period is not None
            else x
        )

    def bases(self) -> tuple[FloatArray, ...]:
        """Return the factors of (a, b, offset) at the samples, for derivatives of order 0 to 3.

        Returns:
            Four matrices of shape (N, 2K+1).
        """
        o = self.options
        t = np.arange(o.samples, dtype=np.float64) * (o.period / o.samples)
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
    earlier_root: FloatArray | None = None,
) -> DesignProblem:
    """Build a design problem: shrink the limits and scale the variables.

    Args:
        robot: The robot.
        limits: Limits that the motion has to keep at all times.
        parameters: Standard parameters of the robot.
        weighting: Coordinates of the criterion.
        options: Options of the design.
        earlier_root: Root of the information of earlier recordings, see `DesignProblem`.
    """
    functions = casadi_model.dynamics_functions(robot, parameters)
    return DesignProblem(
        robot,
        parameters,
        limits_at_samples(limits, options),
        tuple(_shrink_box(box, LIMIT_RESERVE) for box in options.boxes),
        dataclasses.replace(weighting, support=functions.support),
        earlier_root,
        options,
        variable_scale(limits, options),
        functions,
    )


def rebuild_problem(
    problem: DesignProblem,
    limits: Limits,
    options: DesignOptions,
    earlier_root: FloatArray | None,
    reserve: float = LIMIT_RESERVE,
) -> DesignProblem:
    """Return a problem with other limits, options, earlier information or reserve.

    Args:
        problem: The problem.
        limits: Limits that the motion has to keep at all times.
        options: Options of the design.
        earlier_root: Root of the information of earlier recordings, see `DesignProblem`.
        reserve: Share of torque, braking, stand and box limits to keep free [1].
    """
    return dataclasses.replace(
        problem,
        limits=limits_at_samples(limits, options, reserve),
        boxes=tuple(_shrink_box(box, reserve) for box in options.boxes),
        earlier_root=earlier_root,
        options=options,
        scale=variable_scale(limits, options),
    )


def limits_at_samples(
    limits: Limits, options: DesignOptions, reserve: float = LIMIT_RESERVE
) -> Limits:
    """Shrink limits so that motions that keep them at the samples keep the given ones between.

    Args:
        limits: Limits that the motion has to keep at all times.
        options: Options of the design.
        reserve: Share of torque, braking and stand limits to keep free [1].
    """
    # The first bound keeps a limit between the optimiser's samples (exact for Fourier series), the
    # second one compensates for the certificate's own bound between its denser samples.
    K = options.harmonics
    factor = 1.0 / (
        oversampling_bound(options.samples, K)
        * oversampling_bound(VERIFICATION_DENSITY * options.samples, K)
    )
    bounded = np.isfinite(limits.position).all(axis=1, keepdims=True)
    lower, upper = np.where(bounded, limits.position, 0.0).T
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    shrunk = np.column_stack([middle - factor * half, middle + factor * half])
    free = limits.reduced()
    scaled = free.scaled(velocity=factor, acceleration=factor, jerk=factor, torque=1.0 - reserve)
    return dataclasses.replace(
        scaled,
        position=np.where(bounded, shrunk, limits.position),
        braking=tuple(None if b is None else _shrink_braking(b, reserve) for b in free.braking),
        stand=None
        if free.stand is None
        else dataclasses.replace(
            free.stand,
            force=(1.0 - reserve) * free.stand.force,
            moment=(1.0 - reserve) * free.stand.moment,
        ),
    )


def variable_scale(limits: Limits, options: DesignOptions) -> FloatArray:
    """Return the units of the variables: range and speed that the limits allow. Shape (n, 2K+1)."""
    bounded = np.asarray(np.isfinite(limits.position).all(axis=1))
    lower, upper = np.where(bounded[:, None], limits.position, 0.0).T
    reach = np.where(bounded, 0.5 * (upper - lower), np.pi)
    harmonics = np.arange(1, options.harmonics + 1)
    speed = np.minimum(limits.velocity, reach * 2.0 * np.pi / options.period)[:, None] / np.sqrt(
        harmonics
    )
    return np.column_stack([speed, speed, reach])


def _shrink_braking(brake: Braking, reserve: float) -> Braking:
    """Move the stops of a braking limit inwards by a share of the half range."""
    middle, half = 0.5 * sum(brake.stop), 0.5 * (1.0 - reserve) * (brake.stop[1] - brake.stop[0])
    return dataclasses.replace(brake, stop=(middle - half, middle + half))


def _shrink_box(box: WorkspaceBox, reserve: float) -> WorkspaceBox:
    """Shrink a box by a share of its half widths."""
    lower, upper = np.array(box.lower), np.array(box.upper)
    middle, half = 0.5 * (lower + upper), 0.5 * (1.0 - reserve) * (upper - lower)
    return WorkspaceBox(box.frame, tuple(middle - half), tuple(middle + half))
