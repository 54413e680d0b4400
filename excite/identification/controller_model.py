"""Model of the joint controllers, identified from a recording, and the robot's motion under it.

The auxiliary model of the instrumental variable method (IDIM-IV: Janot, Vandanjon & Gautier 2014)
needs a controller. Per joint it is
u = a₁ τ_rigid(q_ref) + a₂ τ_Coulomb(q_ref) + a₃ q̇_ref + K_p e + K_d ė + K_i ∫e + constant,
e = q_ref − q: a cascade, PD or PID controller with any share of feed-forward. Its coefficients are
fitted to the measured torque, all signals filtered to the same band, gains not below 0.

Limitations: the controller is linear and acts on its own joint only; its behaviour above the band
is not seen; position noise biases the gains towards 0. It need not be exact: instruments have to
be correlated with the motion and uncorrelated with its noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..robot.samples import Samples
from .forward_dynamics import RobotDynamics
from .lowpass import FRICTION_BANDWIDTH_RATIO, Grid
from .segments import RecordingSegment

MAX_SIMULATION_STEP = 2e-3
"""Longest step of the closed-loop simulation [s]."""
MIN_TORQUE_SHARE = 1e-6
"""Share of the torque below which a term counts as absent: the interior-point solver leaves a trace
of the terms it drops."""
LOST_DISTANCE = 1.0
"""Distance from the reference at which the simulation counts as lost [rad or m]."""


@dataclass(frozen=True)
class ControllerModel:
    """Coefficients of the controllers.

    Attributes:
        forward: Feed-forward coefficients a₁, a₂, a₃. Shape (3, n).
        gains: Feedback gains K_p, K_d, K_i. Shape (3, n).
        constant: Constant of each segment. Shape (segments, n) [N m].
        explained: Share of the variance of torque below the band that the controllers explain.
            Shape (n,).
    """

    forward: FloatArray
    gains: FloatArray
    constant: FloatArray
    explained: FloatArray


@dataclass(frozen=True)
class ControllerCommand:
    """Input of the controllers along a reference motion.

    Attributes:
        motion: The reference motion.
        columns: Torque per unit of `ControllerModel.forward`. Shape (3, N, n).
        rate: Sample rate [Hz].
        periodic: True if the motion is a period.
    """

    motion: Samples
    columns: FloatArray
    rate: float
    periodic: bool


def controller_command(
    dynamics: RobotDynamics, reference: RecordingSegment, hertz: float
) -> ControllerCommand:
    """Compute the controllers' input along a reference motion.

    Args:
        dynamics: The robot.
        reference: A segment whose q is q_ref.
        hertz: Cutoff frequency [Hz].
    """
    band = reference.band(hertz)
    motion = Samples(
        *(
            band.filter(reference.q, Grid.RECORDED, order, bandwidth_ratio=FRICTION_BANDWIDTH_RATIO)
            for order in range(3)
        )
    )
    coulomb = dynamics.coulomb * np.tanh(motion.dq / dynamics.widths)
    return ControllerCommand(
        motion,
        np.stack([dynamics.rigid_torque(motion), coulomb, motion.dq]),
        reference.rate,
        reference.periodic,
    )


def identify_controller(
    commands: Sequence[ControllerCommand], measured: Sequence[RecordingSegment], hertz: float
) -> ControllerModel:
    """Fit the controllers by bounded least squares, joint by joint.

    Args:
        commands: Input of the controllers in each segment.
        measured: The segments as recorded; each has a constant of its own.
        hertz: Cutoff frequency [Hz].
    """
    from scipy import optimize  # slow to import

    parts = [
        _columns(command, segment, hertz)
        for command, segment in zip(commands, measured, strict=True)
    ]
    columns = np.concatenate([part - part.mean(axis=1, keepdims=True) for part in parts], axis=1)
    n = columns.shape[2]
    coefficients, explained = np.zeros((6, n)), np.zeros(n)
    low = np.repeat([-np.inf, 0.0], 3)
    for joint in range(n):
        A, b = columns[:6, :, joint].T, columns[6, :, joint]
        size = np.linalg.norm(A, axis=0)
        size[size == 0.0] = 1.0
        solution = optimize.lsq_linear(A / size, b, (low, np.full(6, np.inf))).x / size
        coefficients[:, joint] = np.where(
            np.abs(solution * size) > MIN_TORQUE_SHARE * np.linalg.norm(b), solution, 0.0
        )
        explained[joint] = 1.0 - float(np.sum((b - A @ solution) ** 2)) / max(float(b @ b), 1e-300)
    constant = np.array(
        [
            part[6].mean(axis=0) - np.einsum("kj,kj->j", coefficients, part[:6].mean(axis=1))
            for part in parts
        ]
    )
    return ControllerModel(coefficients[:3], coefficients[3:], constant, explained)


def _columns(command: ControllerCommand, segment: RecordingSegment, hertz: float) -> FloatArray:
    """Filtered columns of the six coefficients, and the torque. Shape (7, rows, n)."""
    band = segment.band(hertz)
    error = command.motion.q - segment.q
    integral = (
        np.cumsum(error - error.mean(axis=0) if segment.periodic else error, axis=0) / segment.rate
    )
    parts = [
        *(band.filter(column, Grid.KEPT) for column in command.columns),
        band.filter(error, Grid.KEPT),
        band.filter(error, Grid.KEPT, 1),
        band.filter(integral, Grid.KEPT),
        band.filter(segment.torque, Grid.KEPT),
    ]
    margin = band.margin // band.steps(Grid.KEPT) if not segment.periodic else 0
    return np.stack(parts)[:, margin : len(parts[0]) - margin]


def simulate_tracking(
    dynamics: RobotDynamics, controller: ControllerModel, command: ControllerCommand, segment: int
) -> FloatArray | None:
    """Simulate the robot under its controllers.

    Steps of at most MAX_SIMULATION_STEP, implicit in the gains and linearly implicit in friction,
    so that they are stable for gains of any size.

    Args:
        dynamics: The robot.
        controller: The controllers.
        command: Their input.
        segment: Index of the segment, for its constant.

    Returns:
        Joint positions; of a periodic motion those of the second period, when the loop has settled.
        None if the robot loses the reference. Shape (N, n) [rad or m].
    """
    q = command.motion.q
    state = (q[0], command.motion.dq[0], np.zeros(q.shape[1]))
    for _ in range(2 if command.periodic else 1):
        run = _simulated(dynamics, controller, command, controller.constant[segment], state)
        if run is None:
            return None
        positions, state = run
    return positions


def _simulated(
    dynamics: RobotDynamics,
    controller: ControllerModel,
    command: ControllerCommand,
    constant: FloatArray,
    state: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]] | None:
    """Positions from a state (q, q̇, ∫e), and the final state; None if the reference is lost."""
    from scipy.linalg import lapack  # slow to import

    steps = max(1, int(np.ceil(1.0 / (command.rate * MAX_SIMULATION_STEP) - 1e-9)))
    h, n = 1.0 / command.rate / steps, len(constant)
    Kp, Kd, Ki = controller.gains
    stiff = dynamics.inertia + h * Kd + h * h * Kp + h * dynamics.viscous
    forward = (
        np.einsum("kj,ktj->tj", controller.forward, command.columns) + constant - dynamics.offset
    )
    inputs = np.concatenate([command.motion.q, command.motion.dq, forward], axis=1)
    following = np.vstack([inputs[1:], inputs[:1] if command.periodic else inputs[-1:]])
    (q, v, integral), diagonal = state, np.arange(n)
    out = np.empty_like(command.motion.q)
    for t, now in enumerate(inputs):
        out[t] = q
        change = following[t] - now
        for k in range(1, steps + 1):
            reference = now + (k / steps) * change
            coulomb_sign = np.tanh(v / dynamics.widths)
            M, bias = dynamics.single_state_terms(q, v)
            M[diagonal, diagonal] += stiff + h * dynamics.coulomb / dynamics.widths * (
                1.0 - coulomb_sign * coulomb_sign
            )
            force = (
                reference[2 * n :]
                + Kp * (reference[:n] - q - h * v)
                + Kd * (reference[n : 2 * n] - v)
                + Ki * integral
            )
            force -= bias + dynamics.viscous * v + dynamics.coulomb * coulomb_sign
            v = v + lapack.dposv(M, h * force)[1]
            q = q + h * v
            integral = integral + h * (reference[:n] - q)
        if not np.abs(out[t] - now[:n]).max() < LOST_DISTANCE:
            return None
    return out, (q, v, integral)
