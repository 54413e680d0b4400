"""Options of a design, and their consistency check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.limits import Limits
from .criteria import Criterion

DEFAULT_TORQUE_NOISE = 0.01
"""Standard deviation of a joint torque over its limit where the user states none [1]."""


@dataclass(frozen=True)
class WorkspaceBox:
    """Box in the base frame that the origin of a frame has to stay in.

    Attributes:
        frame: Name of the frame.
        lower: Lower corner (x, y, z) [m].
        upper: Upper corner (x, y, z) [m].
    """

    frame: str
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


@dataclass(frozen=True)
class DesignOptions:
    """Options that the user may choose for a design.

    Attributes:
        criterion: Criterion that is optimised, or its name.
        plain: Optimise the Euclidean criterion instead of the geometric one.
        drive: Joint parameters that are identified with the inertial ones.
        harmonics: Number of harmonics K of the Fourier series.
        period: Period T of the Fourier series [s].
        free_period: Bounds within which the period is optimised [s], None for a fixed period.
        samples: Samples of the optimiser over one period.
        periods: Number of periods in the motion.
        rate: Rows per second of the exported motion [Hz].
        uncertainty: Radius r of the ellipsoid of robots for which torque limits hold [1].
        noise: Standard deviation of the torque of each joint [N m]; None: 1 % of the torque limit.
        boxes: Boxes that frames have to stay in.
        starts: Number of random starts.
        seed: Seed of the random starts.
        jobs: Number of processes, -1 for one per core.
        iterations: Iterations per start.
        payload_link: Link whose payload the motion is to show; None: it shows the robot.
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
    payload_link: str | None = None

    def __post_init__(self) -> None:
        """Accept the name of a criterion.

        Raises:
            UnusableInput: There is no such criterion.
        """
        names = [criterion.value for criterion in Criterion]
        if not isinstance(self.criterion, Criterion) and self.criterion not in names:
            raise UnusableInput(
                f"--criterion {self.criterion}: no such criterion; there are {', '.join(names)}"
            )
        object.__setattr__(self, "criterion", Criterion(self.criterion))


def check_options(options: DesignOptions) -> None:
    """Check that options are in range and consistent with each other.

    Raises:
        UnusableInput: An option is not; the message names the option and the remedy.
    """
    if options.free_period is None:
        samples_per_period(options.period, options.rate)
    elif not 0.0 < options.free_period[0] < options.free_period[1] < np.inf:
        bounds = ",".join(f"{bound:g}" for bound in options.free_period)
        raise UnusableInput(f"--optimise-period {bounds}: should be MIN,MAX with 0 < MIN < MAX")
    if options.payload_link is not None and (options.criterion is not Criterion.A or options.plain):
        raise UnusableInput("--for-payload: has the A-criterion; leave --criterion and --plain out")
    if options.samples <= 2 * options.harmonics:
        raise UnusableInput(
            f"--samples {options.samples} cannot carry {options.harmonics} harmonics; "
            f"use more than {2 * options.harmonics}"
        )
    positive = {
        "--harmonics": options.harmonics,
        "--period": options.period,
        "--periods": options.periods - 1,
        "--rate": options.rate,
        "--starts": options.starts,
        "--iterations": options.iterations,
    }
    for name, value in positive.items():
        if not (np.isfinite(value) and value > 0):
            least = "at least 2" if name == "--periods" else "positive"
            raise UnusableInput(f"{name} should be {least}")
    if not (np.isfinite(options.uncertainty) and options.uncertainty >= 0.0):
        raise UnusableInput(f"--uncertainty {options.uncertainty:g} should be 0 or more")
    if options.seed < 0:
        raise UnusableInput(f"--seed {options.seed} should be 0 or more")
    if options.jobs == 0:
        raise UnusableInput("--jobs 0 does nothing; give 1 or more, or -1 for one per core")
    for box in options.boxes:
        if not all(low < high for low, high in zip(box.lower, box.upper, strict=True)):
            raise UnusableInput(
                f"--box {box.frame}: its lower corner {box.lower} is not below "
                f"its upper one {box.upper}"
            )


def samples_per_period(period: float, rate: float) -> int:
    """Return the number of samples in one period.

    Args:
        period: Period [s].
        rate: Samples per second [Hz].

    Raises:
        UnusableInput: The number is not an integer, or an argument is not positive.
    """
    if not (np.isfinite(period) and np.isfinite(rate) and period > 0.0 and rate > 0.0):
        raise UnusableInput(
            f"--period {period:g} and --rate {rate:g} should be positive and finite"
        )
    count = period * rate
    if abs(count - round(count)) > 1e-6 or round(count) < 1:
        better = max(round(count), 1) / rate
        raise UnusableInput(
            f"--period {period:g} s is no whole number of samples at --rate {rate:g} Hz; "
            f"use --period {better:.6g}"
        )
    return round(count)


def check_played_period(period: float, rate: float, speed: float) -> None:
    """Check that a period holds a whole number of samples at the speed at which it is played.

    Args:
        period: Period at full speed [s].
        rate: Samples per second [Hz].
        speed: Share of the full speed [1].

    Raises:
        UnusableInput: It does not.
    """
    count = samples_per_period(period, rate)

    def is_whole(samples: int) -> bool:
        return abs(samples / speed - round(samples / speed)) < 1e-6

    if is_whole(count):
        return
    near = sorted(range(1, 2 * count), key=lambda samples: abs(samples - count))
    better = next((samples for samples in near if is_whole(samples)), None)
    remedy = "use another --speed" if better is None else f"use --period {better / rate:.6g}"
    raise UnusableInput(
        f"--speed {speed:g} makes the period {period / speed:.6g} s, no whole number of samples at "
        f"--rate {rate:g} Hz; {remedy}"
    )


def torque_noise_levels(limits: Limits, noise: Sequence[float] | None) -> FloatArray:
    """Return the standard deviation of the torque of each joint.

    Args:
        limits: Limits of the robot.
        noise: Stated standard deviations [N m]; None: 1 % of each torque limit.

    Returns:
        Standard deviations. Shape (n,) [N m].
    """
    return np.asarray(noise, float) if noise is not None else DEFAULT_TORQUE_NOISE * limits.torque
