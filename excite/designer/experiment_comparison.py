"""Predict the identifiability after twice the recording time or at twice the speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import Parameters
from ..robot.limits import DERIVED, Limits
from ..robot.parameter_names import listed
from ..robot.robot import Robot
from ..robot.samples import Samples
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import Motion, SegmentKind
from .identifiability import eigenvalues_and_directions, information_root
from .identifiability_threshold import IDENTIFIABLE_VARIANCE, is_identifiable

SAMPLES_PER_PERIOD = 300
"""Samples of one period for information and peak values [1]."""


@dataclass(frozen=True)
class BrokenLimit:
    """Limit that a scenario would exceed.

    Attributes:
        limit: Kind of the limit.
        joint: Name of the joint.
        factor: Largest value over the limit [1].
    """

    limit: str
    joint: str
    factor: float


@dataclass(frozen=True)
class Scenario:
    """Change of the experiment and its predicted identifiability.

    Attributes:
        name: now, time or speed.
        words: Sentence that summarises the scenario.
        identifiable_count: Number of practically identifiable directions.
        eigenvalues: Descending eigenvalues λ of the scaled information. Shape (p,).
        broken_limits: Limits that the motion would exceed.
    """

    name: str
    words: str
    identifiable_count: int
    eigenvalues: FloatArray
    broken_limits: tuple[BrokenLimit, ...] = ()


def compare_scenarios(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    limits: Limits,
    motion: Motion,
    *,
    noise: FloatArray,
    rate: float,
    threshold: float = IDENTIFIABLE_VARIANCE,
    earlier_root: FloatArray | None = None,
) -> tuple[Scenario, ...]:
    """Compare a motion with twice its recording time and with twice the speed.

    At twice the speed the same path has doubled q̇, quadrupled q̈, half the period and twice the
    number of periods, so that the gain is due to speed, not to time.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        base: Its base parameters.
        limits: Its limits.
        motion: The motion.
        noise: Standard deviation of the torque of each joint. Shape (n,) [N m].
        rate: Recorded samples per second [Hz].
        threshold: Largest scale-free variance of an identifiable direction [1].
        earlier_root: Root of the information of earlier recordings, counted once in each scenario.
            Shape (m, P).

    Returns:
        Scenarios now, time and speed.
    """
    t = motion.grid(rate)
    fourier = motion.segment(SegmentKind.FOURIER)
    inside = (t >= fourier.start) & (t < fourier.end)
    outer = information_root(robot, parameters, motion.samples(t[~inside]), noise)
    earlier = np.zeros((0, parameters.count)) if earlier_root is None else earlier_root
    inner = [
        _fourier_root(robot, parameters, motion.fourier.slowed(speed), noise, int(inside.sum()))
        for speed in (1.0, 2.0)
    ]
    now = np.vstack([outer, inner[0]])
    cases = {"now": now, "time": np.sqrt(2.0) * now, "speed": np.vstack([outer, inner[1]])}
    spectra = {
        name: eigenvalues_and_directions(np.vstack([root, earlier]), base)[0]
        for name, root in cases.items()
    }
    broken_limits: dict[str, tuple[BrokenLimit, ...]] = {
        "now": (),
        "time": (),
        "speed": _broken_limits(robot, parameters, limits, motion, 2.0),
    }
    counts = {
        name: int(is_identifiable(values, threshold).sum()) for name, values in spectra.items()
    }
    words = {
        "now": f"{counts['now']} of {base.count} directions are identifiable",
        "time": _gain(counts["time"] - counts["now"], "Twice the recording time"),
        "speed": _gain(counts["speed"] - counts["now"], "Twice the speed")
        + _describe_limits(broken_limits["speed"]),
    }
    return tuple(
        Scenario(name, words[name], counts[name], spectra[name], broken_limits[name])
        for name in cases
    )


def _gain(more: int, change: str) -> str:
    """Return a sentence about the directions that a change makes identifiable."""
    if more == 0:
        return f"{change} would make no further direction identifiable"
    kind = "more" if more > 0 else "fewer"
    return f"{change} would make {abs(more)} {kind} direction{'s' * (abs(more) != 1)} identifiable"


def _describe_limits(broken_limits: tuple[BrokenLimit, ...]) -> str:
    """Return the end of a sentence, about the limits that would break."""
    if not broken_limits:
        return ", and no limit would break"
    return ", but would break " + listed(
        [f"the {b.limit} limit of {b.joint} ({b.factor:.2g} times)" for b in broken_limits]
    )


def _fourier_root(
    robot: Robot, parameters: Parameters, series: FourierSeries, noise: FloatArray, rows: int
) -> FloatArray:
    """Return a root of the information of `rows` samples of a periodic motion.

    One period is computed with at most `SAMPLES_PER_PERIOD` samples and scaled to `rows`.
    """
    count = int(np.clip(rows, 1, SAMPLES_PER_PERIOD))
    root = information_root(robot, parameters, series.samples(series.grid(count)), noise)
    out: FloatArray = np.sqrt(rows / count) * root
    return out


def _broken_limits(
    robot: Robot, parameters: Parameters, limits: Limits, motion: Motion, speed: float
) -> tuple[BrokenLimit, ...]:
    """Return for each kind of limit the joint that would exceed it most, if any would."""
    series = motion.fourier.slowed(speed)
    t = series.grid(SAMPLES_PER_PERIOD)
    samples = series.samples(t)
    torque = regressor(robot, parameters, samples) @ parameters.nominal
    values = {
        "velocity": samples.dq,
        "acceleration": samples.ddq,
        "jerk": series.at(t, 3),
        "torque": torque,
    }
    out = []
    for kind, array in values.items():
        # derived limits apply to the ramps only
        stated = [source != DERIVED for source in limits.sources.get(kind, ("",) * robot.n)]
        ratio = np.where(stated, np.abs(array).max(axis=0) / getattr(limits, kind), 0.0)
        worst = int(np.argmax(ratio))
        if ratio[worst] > 1.0:
            out.append(BrokenLimit(kind, robot.joints[worst], float(ratio[worst])))
    if not any(b.limit == "velocity" for b in out):
        out += _broken_braking(limits, samples)
    return tuple(out)


def _broken_braking(limits: Limits, samples: Samples) -> list[BrokenLimit]:
    """Return the braking limit (velocity towards a stop) that is exceeded most, if any is."""
    worst = BrokenLimit("velocity", "", 1.0)
    for j, brake in enumerate(limits.braking):
        if brake is None:
            continue
        for sign, stop in ((1.0, brake.stop[1]), (-1.0, brake.stop[0])):
            distance = np.maximum(sign * (stop - samples.q[:, j]), 0.0)
            allowed = np.maximum(np.sqrt(brake.rate * distance) - brake.offset, 1e-6)
            factor = float(np.max(sign * samples.dq[:, j] / allowed))
            if factor > worst.factor:
                worst = BrokenLimit("velocity", limits.joints[j], factor)
    return [worst] if worst.joint else []
