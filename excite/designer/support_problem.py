"""The design problem of one motion in single or double support, from rest to rest.

The motion is f(σ(t)): f is a Fourier series of the base coordinates and of the joints outside the
support legs, σ a phase that starts and ends at rest and advances by one period. f(0) is the
standing pose, so that each motion starts and ends there, and motions can be played one after the
other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..collision.clearance_constraint import ClearanceConstraint
from ..errors import UnusableInput
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.fourier import FourierSeries, fourier_basis
from ..trajectory.rest_to_rest import JerkProfile, PhaseProfile
from .options import DesignOptions
from .support_model import SupportFunctions
from .support_stance import BASE_COORDINATES, Stance

BASE_REACH = (0.08, 0.08, 0.08, 0.25, 0.25, 0.25)
"""Units of the base coordinates [m and rad]: the order of magnitude of what bent legs allow."""

STOPPING_GAIN = 5e-5
"""Decrease of the objective over ten iterations below which a search ends [1]: of the mean
logarithm of over a hundred eigenvalues."""

RAMP_SHARE = 0.2
"""Share of a motion in which its phase accelerates, and in which it decelerates [1]."""


@dataclass(frozen=True)
class SupportProblem:
    """Everything that the search for one motion needs.

    Attributes:
        robot: The robot.
        limits: Limits of position, velocity and acceleration at the optimiser's samples.
        stance: The feet and the standing pose.
        functions: Dynamics and their derivatives.
        columns: W; the information in these coordinates is Wᵀ (Σ Yᵀ Σ⁻¹ Y) W with the regressor Y
            of the base rows. Shape (10·(n + 1), p).
        wrench_noise: Standard deviation of each base row. Shape (6,) [N, N m].
        earlier_information: Information before the motion in these coordinates, a prior included.
            Shape (p, p).
        options: Options; `period` is that of the Fourier series.
        scale: Units of the variables, the coefficients (a, b) of each independent coordinate.
            Shape (m, 2K).
        torque_reserve: Share of the torque limits of `functions` that is kept free [1].
        contact_reserve: Share of the weight that contact constraints keep free [1].
        clearance: Bodies that keep their distance at poses (b, q); None: distances are free.
    """

    robot: Robot
    limits: Limits
    stance: Stance
    functions: SupportFunctions
    columns: FloatArray
    wrench_noise: FloatArray
    earlier_information: FloatArray
    options: DesignOptions
    scale: FloatArray
    torque_reserve: float = 0.0
    contact_reserve: float = 0.0
    clearance: ClearanceConstraint | None = None

    @property
    def stopping_gain(self) -> float:
        """Decrease of the objective over ten iterations below which a search ends."""
        return STOPPING_GAIN

    @property
    def size(self) -> int:
        """Number of decision variables."""
        return self.scale.size

    def motion(self, x: FloatArray) -> PhaseProfile:
        """Return the motion of the independent coordinates that variables describe.

        Args:
            x: Variables. Shape (size,).
        """
        K = self.options.harmonics
        table = x.reshape(self.scale.shape) * self.scale
        sine, cosine = table[:, :K], table[:, K:]
        k = 2.0 * np.pi / self.options.period * np.arange(1, K + 1)
        home = self.stance.home
        series = FourierSeries(sine, cosine, home + cosine @ (1.0 / k), self.options.period)
        return PhaseProfile(series, rest_to_rest_phase(self.options.period))

    def bases(self) -> tuple[FloatArray, ...]:
        """Return the factors of (a, b) at the samples, for derivatives of order 0 to 2.

        Returns:
            Three matrices of shape (N, 2K).
        """
        o = self.options
        phase = rest_to_rest_phase(o.period)
        t = sample_times(o)
        sigma, rate, acceleration = (phase.at(t, order)[:, 0] for order in range(3))
        omega = 2.0 * np.pi / o.period
        f = [np.hstack(fourier_basis(sigma, omega, o.harmonics, order)) for order in range(3)]
        f[0][:, o.harmonics :] += 1.0 / (omega * np.arange(1, o.harmonics + 1))
        return (
            f[0],
            f[1] * rate[:, None],
            f[2] * rate[:, None] ** 2 + f[1] * acceleration[:, None],
        )


def ramp_duration(period: float) -> float:
    """Return the duration of each ramp of a motion whose Fourier series has this period [s].

    With the share r of the motion in either ramp, the phase advances by T (1 − r) = P.
    """
    return RAMP_SHARE * motion_duration(period)


def motion_duration(period: float) -> float:
    """Return the duration of a motion whose Fourier series has this period [s]."""
    return period / (1.0 - RAMP_SHARE)


def profile_duration(profile: PhaseProfile) -> float:
    """Return the duration of a motion, that of all pieces of its phase [s]."""
    return float(sum(duration for duration, _ in profile.phase.pieces[0]))


def series_period(duration: float) -> float:
    """Return the period of the Fourier series of a motion of this duration [s]."""
    return duration * (1.0 - RAMP_SHARE)


def rest_to_rest_phase(period: float) -> JerkProfile:
    """Return the phase that advances by one period from rest to rest.

    Its rate rises from 0 to 1 with a jerk of ±4/T², as in `phase_ramps`, and falls likewise.

    Args:
        period: Period of the Fourier series [s].
    """
    ramp = ramp_duration(period)
    half, jerk = 0.5 * ramp, 4.0 / ramp**2
    pieces = (
        (half, jerk),
        (half, -jerk),
        (period - ramp, 0.0),
        (half, -jerk),
        (half, jerk),
    )
    return JerkProfile(np.zeros(1), np.zeros(1), np.zeros(1), (pieces,))


def sample_times(options: DesignOptions) -> FloatArray:
    """Return the optimiser's samples, both ends included [s]. Shape (N,)."""
    return np.linspace(0.0, motion_duration(options.period), options.samples)


def variable_scale(
    robot: Robot, limits: Limits, stance: Stance, options: DesignOptions
) -> FloatArray:
    """Return the units of the variables, see `SupportProblem`. Shape (m, 2K).

    Raises:
        UnusableInput: A jerk limit is stated, which the joints of a support leg cannot be given.
    """
    if np.isfinite(limits.jerk).any():
        raise UnusableInput(
            f"{robot.source}: jerk limits are not supported with --support; remove them"
        )
    bounded = np.isfinite(limits.position).all(axis=1)
    half = np.where(
        bounded,
        0.5 * (limits.position[:, 1] - np.where(bounded, limits.position[:, 0], 0.0)),
        np.pi,
    )
    reach = np.concatenate([BASE_REACH, half])
    speed = np.concatenate([np.full(BASE_COORDINATES, np.inf), limits.velocity])
    omega = 2.0 * np.pi / options.period
    unit = np.minimum(speed, reach * omega)[stance.independent]
    harmonics = np.arange(1, options.harmonics + 1)
    table = unit[:, None] / np.sqrt(harmonics)
    return np.hstack([table, table])
