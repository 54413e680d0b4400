"""What twice the time or twice the speed would buy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robot.base_parameters import Base
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import Parameters
from ..robot.limits import DERIVED, Limits
from ..robot.parameter_names import listed
from ..robot.robot import Robot
from ..robot.samples import Samples
from ..trajectory.fourier import FourierSeries
from ..trajectory.rest_to_rest import Motion
from .identifiability import IDENTIFIABLE_VARIANCE, eigenvalues_and_directions, information_root

Array = np.ndarray


@dataclass(frozen=True)
class BrokenLimit:
    """A limit that a scenario would break: the largest value over the limit, and where."""

    limit: str
    joint: str
    factor: float


@dataclass(frozen=True)
class Scenario:
    """A change of the experiment and what it would show. eigenvalues: λ, falling. Shape (p,)."""

    name: str
    words: str
    identifiable: int
    eigenvalues: Array
    broken_limits: tuple[BrokenLimit, ...] = ()


def compare_scenarios(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    limits: Limits,
    motion: Motion,
    *,
    noise: Array,
    rate: float,
    threshold: float = IDENTIFIABLE_VARIANCE,
    given: Array | None = None,
) -> tuple[Scenario, ...]:
    """The motion as it is; recorded for twice the time; its Fourier part run at twice the speed for as long as now.

    Twice the speed is the same path with q̇ doubled, q̈ times four, half the period and twice as many periods: what it
    gains is speed, not time. given: a root of the information of earlier recordings, which counts once in each. Shape (m, P).
    """
    t = motion.grid(rate)
    fourier = motion.segment("fourier")
    inside = (t >= fourier.start) & (t < fourier.end)
    outer = information_root(robot, parameters, motion.samples(t[~inside]), noise)
    earlier = np.zeros((0, parameters.count)) if given is None else given
    inner = [
        _fourier_root(robot, parameters, motion.fourier.slowed(speed), noise, int(inside.sum()))
        for speed in (1.0, 2.0)
    ]
    now = np.vstack([outer, inner[0]])
    cases = {"now": now, "time": np.sqrt(2.0) * now, "speed": np.vstack([outer, inner[1]])}
    spectra = {name: eigenvalues_and_directions(np.vstack([root, earlier]), base)[0] for name, root in cases.items()}
    broken: dict[str, tuple[BrokenLimit, ...]] = {
        "now": (),
        "time": (),
        "speed": _broken(robot, parameters, limits, motion, 2.0),
    }
    seen = {name: int(np.sum(values * threshold >= 1.0)) for name, values in spectra.items()}
    words = {
        "now": f"{seen['now']} of {base.count} directions are identifiable",
        "time": _gain(seen["time"] - seen["now"], "Twice the recording time"),
        "speed": _gain(seen["speed"] - seen["now"], "Twice the speed")
        + _break_words(broken["speed"]),
    }
    return tuple(
        Scenario(name, words[name], seen[name], spectra[name], broken[name]) for name in cases
    )


def _gain(more: int, what: str) -> str:
    if more == 0:
        return f"{what} would make no further direction identifiable"
    return f"{what} would make {abs(more)} {'more' if more > 0 else 'fewer'} direction{'s' * (abs(more) != 1)} identifiable"


def _break_words(broken: tuple[BrokenLimit, ...]) -> str:
    if not broken:
        return ", and no limit would break"
    return ", but would break " + listed(
        [f"the {b.limit} limit of {b.joint} ({b.factor:.2g} times)" for b in broken]
    )


def _fourier_root(
    robot: Robot, parameters: Parameters, series: FourierSeries, noise: Array, rows: int
) -> Array:
    """Root of what `rows` samples of a periodic motion tell; one period is computed and counted as often as it fits."""
    count = int(np.clip(rows, 1, 300))
    root = information_root(robot, parameters, series.samples(series.grid(count)), noise)
    out: Array = np.sqrt(rows / count) * root
    return out


def _broken(
    robot: Robot, parameters: Parameters, limits: Limits, motion: Motion, speed: float
) -> tuple[BrokenLimit, ...]:
    """For each kind of limit the joint that would exceed it most, if any would."""
    series = motion.fourier.slowed(speed)
    t = series.grid(300)
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
        # a derived limit binds the ramps only, not the excitation
        stated = [source != DERIVED for source in limits.sources.get(kind, ("",) * robot.n)]
        ratio = np.where(stated, np.abs(array).max(axis=0) / getattr(limits, kind), 0.0)
        worst = int(np.argmax(ratio))
        if ratio[worst] > 1.0:
            out.append(BrokenLimit(kind, robot.joints[worst], float(ratio[worst])))
    if not any(b.limit == "velocity" for b in out):
        out += _braking(limits, samples)
    return tuple(out)


def _braking(limits: Limits, samples: Samples) -> list[BrokenLimit]:
    """Velocity limits that fall towards a stop."""
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
