"""The robot's controller, as far as a recording tells it, and the motion of a model under it: the auxiliary model of IDIM-IV.

Per joint u = a₁ τ_rigid(q_ref) + a₂ τ_Coulomb(q_ref) + a₃ q̇_ref + K_p e + K_d ė + K_i ∫e + constant, e = q_ref − q: a cascade, a PD or a
PID controller with any share of feed-forward. The coefficients are those of measured torque on these columns, both below the band,
gains not below 0. Limits: the law is linear and of one joint each; what a controller does above the band isn't seen; noise of
positions makes its gains look smaller. It need not be right: instruments have to follow the motion and be free of its noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..robot.samples import Samples
from .forward_dynamics import Mechanism
from .lowpass import EDGE, Grid
from .segments import Piece

Array = np.ndarray
STEP = 2e-3
"""Longest step of the loop [s]."""
IDLE = 1e-6
"""Share of the torque below which a column of the law counts as absent: an interior-point solver leaves a trace of what it drops."""
LOST = 1.0
"""Distance from the reference at which a loop counts as lost [rad or m]."""


@dataclass(frozen=True)
class Law:
    """forward: a₁, a₂, a₃. Shape (3, n). gains: K_p, K_d, K_i. Shape (3, n). constant: of each piece. Shape (pieces, n) [N m].

    explained: share of the torque's variance below the band that the law explains. Shape (n,).
    """

    forward: Array
    gains: Array
    constant: Array
    explained: Array


@dataclass(frozen=True)
class Command:
    """What a controller is told. motion: the reference. columns: torque per unit of `Law.forward`. Shape (3, N, n)."""

    motion: Samples
    columns: Array
    rate: float
    periodic: bool


def commanded(mechanism: Mechanism, reference: Piece, hertz: float) -> Command:
    """The command along a reference motion, from a piece whose q is q_ref."""
    band = reference.band(hertz)
    motion = Samples(
        *(band.low(reference.q, Grid.RECORDED, order, reach=EDGE) for order in range(3))
    )
    coulomb = mechanism.coulomb * np.tanh(motion.dq / mechanism.widths)
    return Command(
        motion,
        np.stack([mechanism.rigid(motion), coulomb, motion.dq]),
        reference.rate,
        reference.periodic,
    )


def identified(commands: Sequence[Command], measured: Sequence[Piece], hertz: float) -> Law:
    """The law by bounded least squares, joint by joint; every piece has a constant of its own. commands, measured: piece by piece."""
    from scipy import optimize  # slow to import

    parts = [
        _columns(command, piece, hertz) for command, piece in zip(commands, measured, strict=True)
    ]
    columns = np.concatenate([part - part.mean(axis=1, keepdims=True) for part in parts], axis=1)
    n = columns.shape[2]
    found, explained = np.zeros((6, n)), np.zeros(n)
    low = np.repeat([-np.inf, 0.0], 3)
    for joint in range(n):
        A, b = columns[:6, :, joint].T, columns[6, :, joint]
        size = np.linalg.norm(A, axis=0)
        size[size == 0.0] = 1.0
        solution = optimize.lsq_linear(A / size, b, (low, np.full(6, np.inf))).x / size
        found[:, joint] = np.where(
            np.abs(solution * size) > IDLE * np.linalg.norm(b), solution, 0.0
        )
        explained[joint] = 1.0 - float(np.sum((b - A @ solution) ** 2)) / max(float(b @ b), 1e-300)
    constant = np.array(
        [
            part[6].mean(axis=0) - np.einsum("kj,kj->j", found, part[:6].mean(axis=1))
            for part in parts
        ]
    )
    return Law(found[:3], found[3:], constant, explained)


def _columns(command: Command, piece: Piece, hertz: float) -> Array:
    """The law's six columns and the torque, below the band. Shape (7, rows, n)."""
    band = piece.band(hertz)
    error = command.motion.q - piece.q
    summed = np.cumsum(error - error.mean(axis=0) if piece.periodic else error, axis=0) / piece.rate
    parts = [
        *(band.low(column, Grid.KEPT) for column in command.columns),
        band.low(error, Grid.KEPT),
        band.low(error, Grid.KEPT, 1),
    ]
    parts += [band.low(summed, Grid.KEPT), band.low(piece.torque, Grid.KEPT)]
    spoilt = band.margin // band.steps(Grid.KEPT) if not piece.periodic else 0
    return np.stack(parts)[:, spoilt : len(parts[0]) - spoilt]


def followed(mechanism: Mechanism, law: Law, command: Command, piece: int) -> Array | None:
    """Positions of the robot under the law; of a period the second one, when the loop has settled. None where it loses the reference.

    Steps of at most STEP, implicit in the gains and linearly so in friction: stable whatever their size. piece: whose constant is
    meant. Shape (N, n) [rad or m].
    """
    q = command.motion.q
    start = (q[0], command.motion.dq[0], np.zeros(q.shape[1]))
    for _ in range(2 if command.periodic else 1):
        run = _run(mechanism, law, command, law.constant[piece], start)
        if run is None:
            return None
        out, start = run
    return out


def _run(
    mechanism: Mechanism,
    law: Law,
    command: Command,
    constant: Array,
    start: tuple[Array, Array, Array],
) -> tuple[Array, tuple[Array, Array, Array]] | None:
    from scipy.linalg import lapack  # slow to import

    steps = max(1, int(np.ceil(1.0 / (command.rate * STEP) - 1e-9)))
    h, n = 1.0 / command.rate / steps, len(constant)
    Kp, Kd, Ki = law.gains
    stiff = mechanism.inertia + h * Kd + h * h * Kp + h * mechanism.viscous
    forward = np.einsum("kj,ktj->tj", law.forward, command.columns) + constant - mechanism.offset
    wanted = np.concatenate([command.motion.q, command.motion.dq, forward], axis=1)
    following = np.vstack([wanted[1:], wanted[:1] if command.periodic else wanted[-1:]])
    (q, v, total), diagonal = start, np.arange(n)
    out = np.empty_like(command.motion.q)
    for t, now in enumerate(wanted):
        out[t] = q
        change = following[t] - now
        for k in range(1, steps + 1):
            told = now + (k / steps) * change
            grip = np.tanh(v / mechanism.widths)
            M, bias = mechanism.terms(q, v)
            M[diagonal, diagonal] += stiff + h * mechanism.coulomb / mechanism.widths * (
                1.0 - grip * grip
            )
            force = (
                told[2 * n :]
                + Kp * (told[:n] - q - h * v)
                + Kd * (told[n : 2 * n] - v)
                + Ki * total
            )
            force -= bias + mechanism.viscous * v + mechanism.coulomb * grip
            v = v + lapack.dposv(M, h * force)[1]
            q = q + h * v
            total = total + h * (told[:n] - q)
        if not np.abs(out[t] - now[:n]).max() < LOST:
            return None
    return out, (q, v, total)
