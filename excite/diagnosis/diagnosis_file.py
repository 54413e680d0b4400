"""Write `diagnosis.json`: the document of a diagnosis, as the contract defines it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..effects import EFFECTS_BY_NAME
from ..effects.effect import CandidateModel
from ..robot.parameter_names import percent
from . import session_changes
from .belief import doubt, unsure
from .diagnosis import DOUBTED, Diagnosis
from .gear_encoders import GearEstimate
from .hypothesis import Hypothesis
from .interval import finding_parameters
from .judge import Finding
from .residual_atlas import Atlas
from .session_changes import SessionChange
from .unmodelled import BASES

MAX_RIVALS = 5
"""Largest number of rival effects that are listed with a finding."""
SCHEMA = "excite.diagnosis/1"
"""Schema of the document."""
REGIMES = {
    "stribeck": "speed",
    "nonlinear_viscous": "speed",
    "drag": "speed",
    "asymmetric_viscous": "direction",
    "load_friction": "load",
    "torque_saturation": "load",
    "position_friction": "position",
    "spring": "position",
    "torque_ripple": "order",
    "encoder_error": "order",
    "hysteresis": "reversal",
    "backlash": "reversal",
    "thermal_drift": "run time",
    "contact": "time",
    "delay": "frequency",
    "elasticity": "frequency",
    "base_compliance": "frequency",
    "coupling": "other joints",
}
"""Quantity over which an effect shows, by effect."""


def document(diagnosis: Diagnosis, atlas: Atlas | None = None) -> dict[str, Any]:
    """Return the content of `diagnosis.json`.

    Args:
        diagnosis: The diagnosis.
        atlas: Its residual atlas, for the p-values; they are null without.
    """
    joints = diagnosis.identified.model.robot.joints
    rows = {
        joint: {
            "noise_floor": float(diagnosis.floor[i]),
            "noise_floor_method": diagnosis.method,
            "rmse_before": float(diagnosis.before[i]),
            "rmse_after": float(diagnosis.after[i]),
            "systematic_share": float(diagnosis.systematic[i]),
            "unexplained_share": float(diagnosis.unexplained[i]),
        }
        for i, joint in enumerate(joints)
    }
    findings = [_finding(diagnosis, i, atlas) for i in range(len(diagnosis.verdict.findings))]
    return {
        "schema": SCHEMA,
        "verdict": diagnosis.name,
        "findings": sorted(findings, key=lambda f: -f["probability"]),
        "joints": rows,
        "unknown": [_unknown(diagnosis, j) for j in diagnosis.unknown],
        "considered": [
            *(_doubted(diagnosis, f) for f in diagnosis.verdict.doubted),
            *(_considered(diagnosis, h) for h in diagnosis.verdict.considered),
        ],
        "band_hz": diagnosis.hertz,
        "simulation": _simulation(diagnosis),
        "between_recordings": [
            _change(diagnosis, change) for change in diagnosis.changes if change.is_significant
        ],
        "encoders": {joints[gear.joint]: _gear(diagnosis, gear) for gear in diagnosis.gears},
        "parameters": _parameters(diagnosis),
    }


def _simulation(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """RMS error of positions simulated from held-out torque, without and with the findings."""
    before, after = diagnosis.ahead
    if before is None or after is None:
        return None
    joints = diagnosis.identified.model.robot.joints
    rows = zip(joints, before.fitted[-1].tolist(), after.fitted[-1].tolist(), strict=True)
    return {
        "seconds": float(before.lag[-1]),
        "joints": {j: {"before": a, "after": b} for j, a, b in rows},
    }


def _change(diagnosis: Diagnosis, change: SessionChange) -> dict[str, Any]:
    """Change of a joint actuator in a recording since the first recording."""
    entry = diagnosis.identified.model.robot.entries[change.joint]
    units = (entry.unit("N m"), entry.unit("N m s/rad"), entry.unit("N m"))
    values = zip(
        session_changes.KINDS, change.change.tolist(), change.std.tolist(), units, strict=True
    )
    changes: dict[str, dict[str, Any]] = {
        kind: {"value": value, "std": std, "unit": unit} for kind, value, std, unit in values
    }
    fitted = diagnosis.refitted or diagnosis.identified
    for kind in ("coulomb", "viscous"):
        mean = float(fitted.psi[fitted.model.parameters.block(kind)][change.joint])
        changes[kind]["relative"] = changes[kind]["value"] / mean if mean > 0.0 else None
    return {"recording": change.source, "joint": _joint(diagnosis, change.joint), **changes}


def _gear(diagnosis: Diagnosis, gear: GearEstimate) -> dict[str, Any]:
    """Gear parameters, and RMS of the held-out difference of both encoders without and with it."""
    unit = diagnosis.identified.model.robot.entries[gear.joint].unit

    def estimate(value: tuple[float, float] | None, revolute: str) -> dict[str, Any] | None:
        if value is None:
            return None
        return {"value": value[0], "std": value[1], "unit": unit(revolute)}

    return {
        "stiffness": estimate(gear.stiffness, "N m/rad"),
        "lost_motion": estimate(gear.backlash, "rad"),
        "read_apart": estimate(gear.read_delay, "s"),
        "before": gear.before,
        "after": gear.after,
        "unit": unit("rad"),
    }


def _parameters(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Base parameters without and with the findings, the most significant change first."""
    if diagnosis.refitted is None or not diagnosis.verdict.findings:
        return []
    base, plain, refitted = (
        diagnosis.identified.model.base,
        diagnosis.identified,
        diagnosis.refitted,
    )
    without, with_ = base.matrix @ plain.psi, base.matrix @ refitted.psi
    spread = base.matrix @ refitted.posterior.covariance @ base.matrix.T
    std = np.sqrt(np.maximum(np.diag(spread), 0.0))
    moved = np.abs(with_ - without) / np.maximum(std, 1e-12 * np.maximum(np.abs(with_), 1e-12))
    names = [plain.model.parameters.names[i] for i in base.independent]
    keys = ("name", "expression", "without", "with", "std", "moved")
    rows = zip(
        names,
        base.expressions,
        without.tolist(),
        with_.tolist(),
        std.tolist(),
        moved.tolist(),
        strict=True,
    )
    return sorted(
        (dict(zip(keys, row, strict=True)) for row in rows), key=lambda row: -float(row["moved"])
    )


def _joint(diagnosis: Diagnosis, joint: int | None) -> str | None:
    """Name of a joint."""
    return None if joint is None else diagnosis.identified.model.robot.joints[joint]


def _where(diagnosis: Diagnosis, shape: CandidateModel) -> dict[str, Any]:
    """Place of a finding: statement, regime and time."""
    place = "all joints" if shape.joint is None else f"joint '{_joint(diagnosis, shape.joint)}'"
    where: dict[str, Any] = {
        "statement": f"{place}: {shape.signature or EFFECTS_BY_NAME[shape.effect].signature}",
        "regime": "temperature"
        if "reference" in shape.values
        else REGIMES.get(shape.effect, "all"),
        "time": None if shape.interval is None else list(shape.interval),
    }
    if shape.interval is not None:
        where["recording"] = shape.source
    return where


def _finding(diagnosis: Diagnosis, number: int, atlas: Atlas | None) -> dict[str, Any]:
    """Element of "findings"."""
    finding = diagnosis.verdict.findings[number]
    hypothesis = finding.main
    shape, effect = diagnosis.design.shapes[hypothesis.shape], EFFECTS_BY_NAME[hypothesis.effect]
    values = finding_parameters(diagnosis.design, diagnosis.verdict, number)
    out: dict[str, Any] = {
        "effect": hypothesis.effect,
        "joint": _joint(diagnosis, hypothesis.joint),
        "probability": finding.probability,
        "equivalents": list(finding.equivalents),
        "where": _where(diagnosis, shape),
        "parameters": _reported(diagnosis, shape, values),
        "evidence": {
            "severity": hypothesis.size,
            **_share(diagnosis, hypothesis),
            "p_value": _p_value(atlas, hypothesis),
            **_rivals(finding),
        },
        "experiment": effect.experiment,
    }
    if shape.other is not None:
        out["from"] = _joint(diagnosis, shape.other)
    if hidden := sorted(
        set(shape.parameters(hypothesis.trial.coefficients)) & set(effect.units) - set(values)
    ):
        out["not_shown"] = hidden
    return out


def _reported(
    diagnosis: Diagnosis, shape: CandidateModel, values: Mapping[str, tuple[float, float | None]]
) -> dict[str, dict[str, Any]]:
    """Parameters in the units of the joint, N and m if prismatic; an angle is always in rad."""
    units = dict(EFFECTS_BY_NAME[shape.effect].units)
    if shape.joint is not None:
        entry = diagnosis.identified.model.robot.entries[shape.joint]
        units |= {key: entry.unit(unit) for key, unit in units.items() if key != "angle"}
    return {
        key: {"value": v, "std": s, "unit": units.get(key, "")}
        for key, (v, s) in values.items()
        if np.isfinite(v)
    }


def _rivals(finding: Finding) -> dict[str, Any]:
    """Gain of a finding, gains of the best rival effects, and the evidence for its probability."""
    best = sorted(finding.rivals.items(), key=lambda entry: -entry[1])
    return {"held_out_gain": finding.gain, "rivals": dict(best[:MAX_RIVALS]), **finding.evidence}


def _share(diagnosis: Diagnosis, hypothesis: Hypothesis) -> dict[str, float]:
    """Systematic share of the joint's residual, or the largest of all joints."""
    share = diagnosis.systematic
    return {
        "systematic_share": float(
            share.max() if hypothesis.joint is None else share[hypothesis.joint]
        )
    }


def _p_value(atlas: Atlas | None, hypothesis: Hypothesis) -> float | None:
    """Smallest p-value of the joint's curves in the atlas, or of all curves."""
    if atlas is None:
        return None
    curves = atlas.panels if hypothesis.joint is None else atlas.of(hypothesis.joint)
    return min((curve.p_before for curve in curves), default=None)


def _considered(diagnosis: Diagnosis, hypothesis: Hypothesis) -> dict[str, Any]:
    """Element of "considered" for an effect that was not accepted."""
    shape, effect = diagnosis.design.shapes[hypothesis.shape], EFFECTS_BY_NAME[hypothesis.effect]
    values = shape.parameters(hypothesis.trial.coefficients)
    return {
        "effect": hypothesis.effect,
        "joint": _joint(diagnosis, hypothesis.joint),
        "probability": 0.0,
        "equivalents": [],
        "where": _where(diagnosis, shape),
        "parameters": _reported(diagnosis, shape, {key: (v, None) for key, v in values.items()}),
        "evidence": {"severity": hypothesis.size, "held_out_gain": hypothesis.trial.gain},
        "experiment": effect.experiment,
    }


def _doubted(diagnosis: Diagnosis, finding: Finding) -> dict[str, Any]:
    """Element of "considered" for a finding of low probability; it may still be in the model."""
    stated, together = _considered(diagnosis, finding.main), diagnosis.verdict.together
    modelled = together is not None and finding.main.shape in together.shapes
    changed = {
        "probability": finding.probability,
        "equivalents": list(finding.equivalents),
        "modelled": modelled,
    }
    return stated | changed | {"evidence": {**stated["evidence"], **_rivals(finding)}}


def _unknown(diagnosis: Diagnosis, joint: int) -> dict[str, Any]:
    """Element of "unknown": a joint with unmodelled torque or a session change."""
    name = diagnosis.identified.model.robot.joints[joint]
    share = float(diagnosis.unexplained[joint])
    prediction = diagnosis.residual_predictions[joint]
    where: dict[str, Any] = {
        "statement": f"joint '{name}': torque that no effect of the catalogue explains",
        "regime": "all",
    }
    experiment = "that joint alone, slowly back and forth over its range, then faster"
    n = len(diagnosis.floor)
    if unsure(diagnosis.verdict, n)[joint] and not prediction.counts:
        where["statement"] = (
            f"joint '{name}': torque that several effects explain together, "
            "which are probably not all right"
        )
    doubted = [f for f in diagnosis.credible_doubts if f.main.joint in (joint, None)]
    if doubted and diagnosis.doubted[joint] > DOUBTED * diagnosis.floor[joint]:
        likeliest = max(doubted, key=lambda f: f.probability).main.effect
        where["statement"] += f"; most similar to {likeliest}, but not similar enough"
        experiment = EFFECTS_BY_NAME[likeliest].experiment
    if prediction.counts:
        where["statement"] += (
            f"; {prediction.regime} predicts {percent(prediction.share)} of it on held-out data"
        )
        where |= {"regime": prediction.regime, "foreseen": prediction.share}
        share = max(share, prediction.share)
        response = prediction.response
        over = (
            response.over
            if response.other is None
            else f"{diagnosis.identified.model.robot.joints[response.other]}: {response.over}"
        )
        where["response"] = {
            "over": over,
            "relative": response.relative,
            "x": response.x.tolist(),
            "y": response.y.tolist(),
        }
        experiment = BASES[prediction.regime].experiment
    if diagnosis.has_session_change[joint]:
        change = "friction or offset differs in the held-out recordings"
        if diagnosis.has_unmodelled_torque[joint]:
            where["statement"] += f"; in addition, {change}"
        else:
            where = {"statement": f"joint '{name}': {change}", "regime": "recording"}
            experiment = session_changes.EXPERIMENT
    probability = max(0.5 + 0.5 * share, doubt(diagnosis.verdict, n)[joint])
    return {
        "joint": name,
        "where": where,
        "share": share,
        "probability": float(np.clip(probability, 0.5, 0.99)),
        "experiment": experiment,
    }
