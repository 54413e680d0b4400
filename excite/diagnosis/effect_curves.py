"""Curves of effects: the torque of an effect over the quantity on which it depends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import FloatArray
from .estimates import EffectEstimate
from .fitted_effects import FittedEffect
from .joint_model import JointModel, transient_rows
from .motion_rows import MotionRows, binned_means

BINS = 40
"""Bins of a curve."""
LOW_QUANTILE = 0.01
"""Quantile of a quantity at which its logarithmic bins begin."""
MIN_SHOWN_POWER = 0.5
"""Share of the power of an effect's torque that its curve must hold to show the effect."""
DISSIPATIVE_EFFECTS = ("position_friction",)
"""Effects that oppose the motion though their regime is that of conservative ones too."""


@dataclass(frozen=True)
class _Abscissa:
    """Quantity over which a regime shows; `{}` in the unit stands for rad or m, `N m` for N."""

    over: str
    unit: str
    values: Callable[[MotionRows, int], FloatArray]
    along: bool = False
    logarithmic: bool = False


_ABSCISSAS: Mapping[str, _Abscissa] = {
    "speed": _Abscissa("speed", "{}/s", lambda rows, j: np.abs(rows.dq[:, j]), along=True),
    "direction": _Abscissa("speed", "{}/s", lambda rows, j: rows.dq[:, j]),
    "load": _Abscissa("load", "N m", lambda rows, j: rows.load[:, j], along=True),
    "position": _Abscissa("position", "{}", lambda rows, j: rows.q[:, j]),
    "order": _Abscissa("position", "{}", lambda rows, j: rows.q[:, j]),
    "reversal": _Abscissa(
        "travel since the reversal",
        "{}",
        lambda rows, j: rows.distance[:, j],
        along=True,
        logarithmic=True,
    ),
    "run time": _Abscissa("time", "s", lambda rows, j: rows.run_time, along=True),
    "time": _Abscissa("time", "s", lambda rows, j: rows.time),
}


def effect_curve(model: JointModel, estimate: EffectEstimate, regime: str) -> dict[str, Any] | None:
    """Return the curve of a finding: its mean torque over the quantity on which it depends.

    Torque [N m or N] is positive where it opposes the motion if "opposes_motion". The standard
    deviation contains the distance of the saved effect from that of the joint model. None where no
    single quantity, which `regime` names, shows the effect.
    """
    abscissa, j, rows = _ABSCISSAS.get(regime), estimate.joint, model.rows
    if abscissa is None or j is None:
        return None
    torque = _torque(model, estimate.reported, j)
    in_joint_model = _torque(model, estimate.in_joint_model, j)
    x = abscissa.values(rows, j)
    if "origin" in estimate.models[0].values:
        x = rows.time - estimate.models[0].values["origin"]
    along = abscissa.along or estimate.effect in DISSIPATIVE_EFFECTS
    sign = rows.direction(j) if along else np.ones(len(rows))
    shown = rows.moving[:, j] & (sign != 0.0)
    if estimate.models[0].interval is not None:
        shown &= transient_rows(estimate.models, model.motions)
    x, y, fitted = x[shown], (torque * sign)[shown], (in_joint_model * sign)[shown]
    if not len(x) or np.ptp(x) <= 0.0:
        return None
    edges = _edges(x, logarithmic=abscissa.logarithmic)
    centres, means, at_rows = binned_means(x, y, edges)
    distance = means - binned_means(x, fitted, edges)[1]
    power = float(np.sum(torque[rows.moving[:, j]] ** 2))
    if float(np.sum(at_rows**2)) < MIN_SHOWN_POWER * power:
        return None
    unit = abscissa.unit.format("m" if rows.linear[j] else "rad")
    if rows.linear[j]:
        unit = unit.replace("N m", "N")
    return {
        "over": abscissa.over,
        "unit": unit,
        "opposes_motion": along,
        "x": centres.tolist(),
        "torque": means.tolist(),
        "std": np.hypot(estimate.relative_std * means, distance).tolist(),
    }


def _torque(model: JointModel, effects: Sequence[FittedEffect], joint: int) -> FloatArray:
    """Torque of effects at a joint, along the motions of the joint model, shape (N,) [N m]."""
    out = np.zeros(len(model.rows))
    for effect in effects:
        columns = model.columns(effect.shape)
        if columns is not None and joint in columns.joints:
            out += columns.values[columns.joints.index(joint)] @ effect.coefficients
    return out


def _edges(x: FloatArray, *, logarithmic: bool) -> FloatArray:
    """Edges of the bins of a curve, shape (BINS + 1,)."""
    low, high = float(x.min()), float(x.max())
    if not logarithmic:
        return np.linspace(low, high, BINS + 1)
    first = max(float(np.quantile(x, LOW_QUANTILE)), 1e-6 * high)
    return np.concatenate([[low], np.geomspace(first, high, BINS)])
