"""Predict which effects the recording of a designed motion will not tell apart.

For each joint and each pair of effects that is often confused: the expected log-odds after the
recording if one of them acts with the smallest torque that counts as an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import COULOMB_WIDTH, Parameters
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..schemas.effects import CONFUSABLE_PAIRS, MIN_SEVERITY
from ..trajectory.fourier import FourierSeries
from .discrimination import (
    Comparison,
    RunSettings,
    SeparationObjective,
)
from .discrimination_design import (
    CandidateExplanation,
    ExplanationSet,
    sampled_motion,
)
from .effect_columns import EffectColumns, RobotConstants, SymbolicEffect
from .experiment_menu import DECISIVE_LOG_ODDS
from .explanations import EffectSpecification, friction_of, symbolic_effect

FORECAST_RATE = 40.0
"""Samples per second of the forecast [Hz]: twice the band in which torque is compared."""
MAX_LINK_JOINTS = 12
"""Joints up to which effects of the links behind a joint are forecast, too [1]: their columns take
the dynamics of the complete robot once per joint."""
LINK_EFFECTS = ("elasticity", "encoder_error")
"""These effects."""


@dataclass(frozen=True)
class PairForecast:
    """Expected decision between two effects at a joint.

    Attributes:
        joint: Name of the joint.
        first: Name of an effect.
        second: Name of the effect that it may be confused with.
        log_odds: Expected log-odds, the smaller of both directions [nat].
    """

    joint: str
    first: str
    second: str
    log_odds: float

    @property
    def is_decided(self) -> bool:
        """True if the recording will tell the effects apart."""
        return self.log_odds >= DECISIVE_LOG_ODDS


def _effects_of(
    constants: RobotConstants, joint: int, pairs: Sequence[tuple[str, str]]
) -> dict[str, SymbolicEffect]:
    """Return the effects of pairs at a joint, and both kinds of thermal drift."""
    names = dict.fromkeys(name for pair in pairs for name in pair)
    out = {name: symbolic_effect(EffectSpecification(name, joint, {}), constants) for name in names}
    coulomb, viscous = friction_of(constants, joint)
    constant = symbolic_effect(EffectSpecification("thermal_drift", joint, {}), constants)
    for name, parts in {
        "thermal_drift of Coulomb friction": {"coulomb": coulomb, "viscous": 0.0},
        "thermal_drift of viscous friction": {"coulomb": 0.0, "viscous": viscous},
    }.items():
        out[name] = SymbolicEffect("thermal_drift", joint, {**constant.values, **parts})
    return out


def forecast_isolability(
    robot: Robot,
    parameters: Parameters,
    base: Base,
    limits: Limits,
    motion: FourierSeries,
    noise: FloatArray,
    periods: int,
) -> tuple[PairForecast, ...]:
    """Predict the log-odds between often confused effects at each joint.

    Args:
        robot: The robot.
        parameters: Its standard parameters.
        base: Its base parameters.
        limits: Its limits.
        motion: The periodic motion.
        noise: Standard deviation of the torque. Shape (n,) [N m].
        periods: Number of periods that are recorded.

    Returns:
        Forecasts, the least decided first.
    """
    widths = np.full(robot.n, COULOMB_WIDTH)
    constants = RobotConstants(robot, parameters, parameters.nominal, widths, limits)
    settings = RunSettings(base.geometric, noise, periods)
    sampled = sampled_motion(robot, parameters, motion, FORECAST_RATE)
    out: list[PairForecast] = []
    usual = [
        pair
        for pair in CONFUSABLE_PAIRS
        if robot.n <= MAX_LINK_JOINTS or not set(pair) & set(LINK_EFFECTS)
    ]
    for joint in range(robot.n):
        effects = _effects_of(constants, joint, usual)
        names = list(effects)
        thermal = (names[-2], names[-1])
        pairs = (*usual, thermal)
        comparisons = tuple(
            Comparison(names.index(a), names.index(b), (), 0.5 / len(pairs))
            for pair in pairs
            for a, b in (pair, pair[::-1])
        )
        candidates = tuple(CandidateExplanation(form, None, 0.5) for form in effects.values())
        question = ExplanationSet(constants, candidates, comparisons)
        columns = EffectColumns(constants, list(effects.values()), uncertain_forms=True)
        explanations = question.sized(columns, sampled, settings, MIN_SEVERITY)
        objective = SeparationObjective(columns, explanations, comparisons, settings)
        values = objective.separations(sampled)
        odds = 0.5 * values.reshape(len(pairs), 2).min(axis=1)
        out += [
            PairForecast(robot.joints[joint], a, b, float(value))
            for (a, b), value in zip(pairs, odds, strict=True)
        ]
    return tuple(sorted(out, key=lambda pair: pair.log_odds))
