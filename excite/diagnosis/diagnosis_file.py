"""`diagnosis.json`: the contract's document of a diagnosis."""

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

RIVALS = 5
"""Names that a finding is compared with, at the most."""
SCHEMA = "excite.diagnosis/1"
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


def document(found: Diagnosis, looked: Atlas | None = None) -> dict[str, Any]:
    """Everything that a diagnosis says. looked: its atlas, for p-values, which are null without."""
    joints = found.identified.model.robot.joints
    rows = {
        joint: {
            "noise_floor": float(found.floor[i]),
            "noise_floor_method": found.method,
            "rmse_before": float(found.before[i]),
            "rmse_after": float(found.after[i]),
            "systematic_share": float(found.systematic[i]),
            "unexplained_share": float(found.unexplained[i]),
        }
        for i, joint in enumerate(joints)
    }
    findings = [_finding(found, i, looked) for i in range(len(found.verdict.findings))]
    return {
        "schema": SCHEMA,
        "verdict": found.name,
        "findings": sorted(findings, key=lambda f: -f["probability"]),
        "joints": rows,
        "unknown": [_unknown(found, j) for j in found.unknown],
        "considered": [
            *(_doubted(found, f) for f in found.verdict.doubted),
            *(_considered(found, h) for h in found.verdict.considered),
        ],
        "band_hz": found.hertz,
        "simulation": _simulation(found),
        "between_recordings": [_change(found, change) for change in found.changes if change.is_significant],
        "encoders": {joints[gear.joint]: _gear(found, gear) for gear in found.gears},
        "parameters": _parameters(found),
    }


def _simulation(found: Diagnosis) -> dict[str, Any] | None:
    """RMS of positions simulated ahead from held-out torque, without and with the findings."""
    before, after = found.ahead
    if before is None or after is None:
        return None
    joints = found.identified.model.robot.joints
    rows = zip(joints, before.fitted[-1].tolist(), after.fitted[-1].tolist(), strict=True)
    return {
        "seconds": float(before.lag[-1]),
        "joints": {j: {"before": a, "after": b} for j, a, b in rows},
    }


def _change(found: Diagnosis, change: SessionChange) -> dict[str, Any]:
    """By how much a drive differs in a recording from what it was in the first."""
    entry = found.identified.model.robot.entries[change.joint]
    units = (entry.unit("N m"), entry.unit("N m s/rad"), entry.unit("N m"))
    told = zip(
        session_changes.KINDS, change.change.tolist(), change.std.tolist(), units, strict=True
    )
    of_each: dict[str, dict[str, Any]] = {
        kind: {"value": value, "std": std, "unit": unit} for kind, value, std, unit in told
    }
    fitted = found.refitted or found.identified
    for kind in (
        "coulomb",
        "viscous",
    ):  # over what it is in the recordings that the model is fitted to
        usual = float(fitted.psi[fitted.model.parameters.block(kind)][change.joint])
        of_each[kind]["relative"] = of_each[kind]["value"] / usual if usual > 0.0 else None
    return {"recording": change.source, "joint": _joint(found, change.joint), **of_each}


def _gear(found: Diagnosis, gear: GearEstimate) -> dict[str, Any]:
    """What two encoders say of the gear between them, and RMS of their difference, held out, without and with it."""
    unit = found.identified.model.robot.entries[gear.joint].unit

    def told(value: tuple[float, float] | None, turning: str) -> dict[str, Any] | None:
        return (
            None if value is None else {"value": value[0], "std": value[1], "unit": unit(turning)}
        )

    return {
        "stiffness": told(gear.stiffness, "N m/rad"),
        "lost_motion": told(gear.backlash, "rad"),
        "read_apart": told(gear.read_delay, "s"),
        "before": gear.before,
        "after": gear.after,
        "unit": unit("rad"),
    }


def _parameters(found: Diagnosis) -> list[dict[str, Any]]:
    """Base parameters without and with the findings, those first that move most in their own uncertainty."""
    if found.refitted is None or not found.verdict.findings:
        return []
    base, plain, refitted = found.identified.model.base, found.identified, found.refitted
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


def _joint(found: Diagnosis, joint: int | None) -> str | None:
    return None if joint is None else found.identified.model.robot.joints[joint]


def _where(found: Diagnosis, shape: CandidateModel) -> dict[str, Any]:
    place = "all joints" if shape.joint is None else f"joint '{_joint(found, shape.joint)}'"
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


def _finding(found: Diagnosis, number: int, looked: Atlas | None) -> dict[str, Any]:
    finding = found.verdict.findings[number]
    hypothesis = finding.main
    shape, effect = found.design.shapes[hypothesis.shape], EFFECTS_BY_NAME[hypothesis.effect]
    values = finding_parameters(found.design, found.verdict, number)
    out: dict[str, Any] = {
        "effect": hypothesis.effect,
        "joint": _joint(found, hypothesis.joint),
        "probability": finding.probability,
        "equivalents": list(finding.equivalents),
        "where": _where(found, shape),
        "parameters": _told(found, shape, values),
        "evidence": {
            "severity": hypothesis.size,
            **_share(found, hypothesis),
            "p_value": _chance(looked, hypothesis),
            **_weight(finding),
        },
        "experiment": effect.experiment,
    }
    if shape.other is not None:
        out["from"] = _joint(found, shape.other)
    if hidden := sorted(
        set(shape.parameters(hypothesis.trial.coefficients)) & set(effect.units) - set(values)
    ):
        out["not_shown"] = hidden
    return out


def _told(
    found: Diagnosis, shape: CandidateModel, values: Mapping[str, tuple[float, float | None]]
) -> dict[str, dict[str, Any]]:
    """Parameters in the units of the joint: a slide has N and m. An angle is one wherever it is."""
    units = dict(EFFECTS_BY_NAME[shape.effect].units)
    if shape.joint is not None:
        entry = found.identified.model.robot.entries[shape.joint]
        units |= {key: entry.unit(unit) for key, unit in units.items() if key != "angle"}
    return {
        key: {"value": v, "std": s, "unit": units.get(key, "")}
        for key, (v, s) in values.items()
        if np.isfinite(v)
    }


def _weight(finding: Finding) -> dict[str, Any]:
    """What a finding gains, what the next best names would gain in its place, and what its probability is made of."""
    best = sorted(finding.rivals.items(), key=lambda entry: -entry[1])
    return {"held_out_gain": finding.gain, "rivals": dict(best[:RIVALS]), **finding.evidence}


def _share(found: Diagnosis, hypothesis: Hypothesis) -> dict[str, float]:
    """How much of what the base model left repeats, at the joint or at the one where most does."""
    share = found.systematic
    return {
        "systematic_share": float(
            share.max() if hypothesis.joint is None else share[hypothesis.joint]
        )
    }


def _chance(looked: Atlas | None, hypothesis: Hypothesis) -> float | None:
    """That noise alone would show anything as clear as the clearest curve of the joint, or of all, in all the atlas."""
    if looked is None:
        return None
    own = looked.panels if hypothesis.joint is None else looked.of(hypothesis.joint)
    return min((panel.p_before for panel in own), default=None)


def _considered(found: Diagnosis, hypothesis: Hypothesis) -> dict[str, Any]:
    shape, effect = found.design.shapes[hypothesis.shape], EFFECTS_BY_NAME[hypothesis.effect]
    values = shape.parameters(hypothesis.trial.coefficients)
    return {
        "effect": hypothesis.effect,
        "joint": _joint(found, hypothesis.joint),
        "probability": 0.0,
        "equivalents": [],
        "where": _where(found, shape),
        "parameters": _told(found, shape, {key: (v, None) for key, v in values.items()}),
        "evidence": {"severity": hypothesis.size, "held_out_gain": hypothesis.trial.gain},
        "experiment": effect.experiment,
    }


def _doubted(found: Diagnosis, finding: Finding) -> dict[str, Any]:
    """What is likelier wrong than right by its name: not asserted, but modelled beside what is, if it predicts better."""
    stated, together = _considered(found, finding.main), found.verdict.together
    modelled = together is not None and finding.main.shape in together.shapes
    told = {
        "probability": finding.probability,
        "equivalents": list(finding.equivalents),
        "modelled": modelled,
    }
    return stated | told | {"evidence": {**stated["evidence"], **_weight(finding)}}


def _unknown(found: Diagnosis, joint: int) -> dict[str, Any]:
    name = found.identified.model.robot.joints[joint]
    share, sight = float(found.unexplained[joint]), found.residual_predictions[joint]
    where: dict[str, Any] = {
        "statement": f"joint '{name}': torque that no effect of the catalogue takes",
        "regime": "all",
    }
    experiment = "that joint alone, slowly to and fro over its range, then faster"
    n = len(found.floor)
    if unsure(found.verdict, n)[joint] and not sight.counts:
        where["statement"] = (
            f"joint '{name}': torque that several names take together, likelier not all right"
        )
    doubted = [f for f in found.real if f.main.joint in (joint, None)]
    if doubted and found.doubted[joint] > DOUBTED * found.floor[joint]:
        likest = max(doubted, key=lambda f: f.probability).main.effect
        where["statement"] += f"; likest to {likest}, and not enough so"
        experiment = EFFECTS_BY_NAME[likest].experiment
    if sight.counts:
        where["statement"] += f"; {sight.regime} foresees {percent(sight.share)} of it, held out"
        where |= {"regime": sight.regime, "foreseen": sight.share}
        share = max(share, sight.share)
        response = sight.response
        over = (
            response.over
            if response.other is None
            else f"{found.identified.model.robot.joints[response.other]}: {response.over}"
        )
        where["response"] = {
            "over": over,
            "relative": response.relative,
            "x": response.x.tolist(),
            "y": response.y.tolist(),
        }
        experiment = BASES[sight.regime].experiment
    if found.has_session_change[joint]:
        other = "friction or offset is another in the recordings held out"
        if found.has_unmodelled_torque[joint]:
            where["statement"] += f"; besides, {other}"
        else:
            where = {"statement": f"joint '{name}': {other}", "regime": "recording"}
            experiment = session_changes.EXPERIMENT
    return {
        "joint": name,
        "where": where,
        "share": share,
        "probability": float(
            np.clip(max(0.5 + 0.5 * share, doubt(found.verdict, n)[joint]), 0.5, 0.99)
        ),
        "experiment": experiment,
    }
