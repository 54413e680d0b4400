"""Write `diagnosis.json`: the document of a diagnosis, as the contract defines it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from .._types import FloatArray
from ..effects import EFFECTS_BY_NAME
from ..effects.recorded_motion import MIN_SPEED, Motions, split_by_motion, stands_still
from ..robot.parameter_names import percent
from . import effect_curves, rival_evidence, session_changes, unmodelled
from .decisions import Decisions
from .diagnosis import Diagnosis
from .estimates import QUANTILE, EffectEstimate, Rejection
from .gear_encoders import GearEstimate
from .posterior import DENSE_NAMES
from .session_changes import SessionChange
from .unmodelled import UnmodelledTorque

SCHEMA = "excite.diagnosis/1"
"""Schema of the document."""
CONSIDERED = 20
"""Effects that are listed though they are not asserted."""
NEUTRAL_VALUES = {"exponent": 1.0}
"""Values of parameters at which there is no effect, where that is not zero."""
SINGLE_JOINT_REPETITION = "the same positions at half the speed, then with another load"
"""Experiment on torque that repeats with the motion of a robot of one joint."""
WITHHELD = "withheld: a recording is in doubt"
"""Why an effect is no finding if a recording may not hold what its columns say."""


def document(diagnosis: Diagnosis, decisions: Decisions | None = None) -> dict[str, Any]:
    """Return the content of `diagnosis.json`, after the decisions of discriminating recordings."""
    joints = diagnosis.identified.model.robot.joints
    held_out, noise = diagnosis.held_out, diagnosis.noise
    errors = (noise.floor.tolist(), held_out.rmse_before.tolist(), held_out.rmse_after.tolist())
    rows = {
        joint: _joint_entry(floor, noise.method, before, after)
        for joint, floor, before, after in zip(joints, *errors, strict=True)
    }
    further = {
        "torque_rms": held_out.torque_rms.tolist(),
        "speed_ratio": _motion_ratio(diagnosis.model.motions, held_out.motions, "dq"),
        "acceleration_ratio": _motion_ratio(diagnosis.model.motions, held_out.motions, "ddq"),
    }
    if held_out.rmse_refit is not None:
        further["rmse_refit"] = held_out.rmse_refit.tolist()
    for key, values in further.items():
        for row, value in zip(rows.values(), values, strict=True):
            row[key] = value
    return {
        "schema": SCHEMA,
        "verdict": diagnosis.verdict,
        "findings": [_entry(diagnosis, effect, decisions) for effect in diagnosis.findings],
        "joints": rows,
        "unknown": [_unknown(diagnosis, entry) for entry in diagnosis.unmodelled],
        "considered": [_entry(diagnosis, effect) for effect in diagnosis.considered[:CONSIDERED]],
        "band_hz": diagnosis.hertz,
        "recording_filter": _recording_filter(diagnosis),
        "known_effects": [
            {"effect": effect, "joint": _joint(diagnosis, joint)}
            for effect, joint in dict.fromkeys(known.shape.key for known in diagnosis.known)
        ],
        "budget": _budget(diagnosis),
        "model_check": dict(zip(joints, held_out.rmse_after.tolist(), strict=True)),
        "between_recordings": _changes(diagnosis),
        "undecided_between_recordings": [
            {
                "recording": change.source,
                "joint": _joint(diagnosis, change.joint),
                "seconds": change.blocks * session_changes.BLOCK_SECONDS,
            }
            for change in diagnosis.undecided_changes
        ],
        "encoders": {joints[gear.joint]: _gear(diagnosis, gear) for gear in diagnosis.gears},
        "parameters": _parameters(diagnosis),
        **({"decisions": [pair.document() for pair in decisions.pairs]} if decisions else {}),
    }


def _motion_ratio(fitted: Motions, held_out: Motions, quantity: str) -> list[float | None]:
    """Largest held-out speed or acceleration of each joint over that of the fitted recordings [1].

    None for a joint that moves in the held-out recordings alone, 1 for one that never moves.
    `quantity` is the field of `Samples`.
    """
    largest, known = (_largest(motions, quantity) for motions in (held_out, fitted))
    out: list[float | None] = (largest / known).tolist()
    for joint in range(len(out)):
        if stands_still(fitted, joint):
            out[joint] = 1.0 if stands_still(held_out, joint) else None
    return out


def _largest(motions: Motions, quantity: str) -> FloatArray:
    """Return the largest speed or acceleration of each joint in the fitted rows, shape (n,)."""
    largest = [
        np.abs(getattr(m.samples, quantity)[(m.times >= m.time[0]) & (m.times <= m.time[-1])])
        for m in motions
    ]
    return np.maximum(np.max([x.max(axis=0) for x in largest], axis=0), MIN_SPEED)


def _joint_entry(floor: float, method: str, before: float, after: float) -> dict[str, Any]:
    """Return an element of "joints", by noise floor and held-out RMSE before and after [N m]."""
    shares = [1.0 - (floor / rmse) ** 2 if rmse > floor else 0.0 for rmse in (before, after)]
    return {
        "noise_floor": floor,
        "noise_floor_method": method,
        "rmse_before": before,
        "rmse_after": after,
        "systematic_share": shares[0],
        "unexplained_share": shares[1],
    }


def withhold_findings(
    document: Mapping[str, Any], doubts: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return a diagnosis without findings and changes at joints, because a recording is in doubt.

    If a column may hold another quantity than assumed, a residual is no evidence about a joint. The
    withheld findings are listed among those that were considered.
    """
    withheld = [entry for entry in document["findings"] if entry["joint"] is not None]
    kept = [entry for entry in document["findings"] if entry["joint"] is None]
    verdict = document["verdict"]
    if (not kept and verdict != "no-mismatch") or verdict == "explained":
        verdict = "partly-explained" if kept else "unexplained"
    return {
        **document,
        "verdict": "unexplained" if verdict == "no-mismatch" else verdict,
        "findings": kept,
        "considered": [
            *({**entry, "modelled": False, "reason": WITHHELD} for entry in withheld),
            *({**entry, "modelled": False} for entry in document["considered"]),
        ],
        "unknown": [],
        "between_recordings": [],
        "undecided_between_recordings": [],
        **({"decisions": []} if "decisions" in document else {}),
        "joints": {
            joint: entry
            | _joint_entry(
                entry["noise_floor"],
                entry["noise_floor_method"],
                entry["rmse_before"],
                entry["rmse_before"],
            )
            for joint, entry in document["joints"].items()
        },
        "model_check": {j: entry["rmse_before"] for j, entry in document["joints"].items()},
        "budget": {joint: {"residual": {"share": 1.0, "std": 0.0}} for joint in document["joints"]},
        "recording_filter": None,
        "parameters": [],
        "doubts": [dict(doubt) for doubt in doubts],
    }


def _joint(diagnosis: Diagnosis, joint: int | None) -> str | None:
    """Name of a joint."""
    return None if joint is None else diagnosis.identified.model.robot.joints[joint]


def _entry(
    diagnosis: Diagnosis, estimate: EffectEstimate, decisions: Decisions | None = None
) -> dict[str, Any]:
    """Element of "findings" or "considered", without equivalents that are excluded."""
    effect, shape = EFFECTS_BY_NAME[estimate.effect], estimate.models[0]
    place = "all joints" if estimate.joint is None else f"joint '{_joint(diagnosis, shape.joint)}'"
    regime = "temperature" if "reference" in shape.values else effect.regime
    where: dict[str, Any] = {
        "statement": f"{place}: {shape.signature or effect.signature}",
        "regime": regime,
        "time": None,
    }
    if shape.interval is not None:
        times = [
            m.times[[0, -1]] for m in diagnosis.model.motions if m.segment.source == shape.source
        ]
        # the course of a force may begin before its recording, and end after it
        where["time"] = np.clip(shape.interval, np.min(times), np.max(times)).tolist()
        where["recording"] = shape.source
    shown, joint = _determined(estimate.parameters), _joint(diagnosis, estimate.joint)
    excluded = decisions.excluded(joint, estimate.effect, estimate.equivalents) if decisions else ()
    out: dict[str, Any] = {
        "effect": estimate.effect,
        "joint": joint,
        "probability": estimate.probability,
        "equivalents": [name for name in estimate.equivalents if name not in excluded],
        "where": where,
        "parameters": _stated(diagnosis, estimate, shown),
        "evidence": {
            "severity": estimate.severity,
            "severity_interval": list(estimate.severity_interval),
            "severity_beyond_others": estimate.size,
            "log_bayes_factor": max(estimate.log_bayes_factor, -1e9),
            "systematic_share": _systematic_share(diagnosis, estimate.joint),
            "p_value": _p_value(estimate),
        },
        "experiment": effect.experiment,
        "modelled": diagnosis.final.has(estimate.effect, estimate.joint),
        "curve": effect_curves.effect_curve(diagnosis.model, estimate, regime)
        if estimate.needed
        else None,
    }
    if shape.other is not None:
        out["from"] = _joint(diagnosis, shape.other)
    if weaker := _weaker_waves(diagnosis, estimate):
        out["weaker_waves"] = weaker
    if hidden := sorted(set(estimate.parameters) - set(shown)):
        out["not_shown"] = hidden
    if not estimate.asserted:
        out["reason"] = str(estimate.rejection)
    if estimate.asserted and (rivals := diagnosis.rivals.get(estimate.key)):
        out["rivals"] = [
            {"effect": name, "log_bayes_factor": x, "log_odds": rival_evidence.log_odds(x)}
            for name, x in rivals.items()
            if name not in excluded
        ]
    return out


def _weaker_waves(diagnosis: Diagnosis, estimate: EffectEstimate) -> list[dict[str, float]]:
    """Order and amplitude of all waves of a ripple but the one that is reported, as it."""
    if estimate.effect != "torque_ripple" or "order" not in estimate.parameters:
        return []
    base, (reported, _) = diagnosis.model.motions[0].fitted_robot, estimate.parameters["order"]
    waves = [
        wave.shape.parameters(wave.coefficients, base)
        for wave in estimate.reported
        if wave.shape.values["order"] != reported
    ]
    return sorted(waves, key=lambda wave: -wave["amplitude"])


def _determined(
    parameters: Mapping[str, tuple[float, float]],
) -> dict[str, tuple[float, float]]:
    """Parameters whose interval excludes zero, or their neutral value; none if that is in it."""
    out = {
        key: (value, std)
        for key, (value, std) in parameters.items()
        if np.isfinite(value) and QUANTILE * std < abs(value)
    }
    for key, neutral in NEUTRAL_VALUES.items():
        if key in parameters and QUANTILE * parameters[key][1] >= abs(parameters[key][0] - neutral):
            return {}
    return out


def _stated(
    diagnosis: Diagnosis, estimate: EffectEstimate, shown: Mapping[str, tuple[float, float]]
) -> dict[str, dict[str, Any]]:
    """Parameters in the units of the joint, N and m if prismatic; an angle is always in rad."""
    units = dict(EFFECTS_BY_NAME[estimate.effect].units)
    if estimate.joint is not None:
        entries, other = diagnosis.identified.model.robot.entries, estimate.models[0].other
        entry = entries[estimate.joint]
        units |= {key: entry.unit(unit) for key, unit in units.items() if key != "angle"}
        if "ratio" in units and other is not None:
            of_ratio = entry.unit("rad"), entries[other].unit("rad")
            units["ratio"] = "1" if len(set(of_ratio)) == 1 else "/".join(of_ratio)
    return {
        key: {"value": value, "std": std, "unit": units.get(key, "")}
        for key, (value, std) in shown.items()
    }


def _systematic_share(diagnosis: Diagnosis, joint: int | None) -> float:
    """Systematic share of a joint's error, or the largest of all joints."""
    before = np.maximum(diagnosis.held_out.rmse_before, 1e-300)
    share = np.maximum(1.0 - (diagnosis.noise.floor / before) ** 2, 0.0)
    return float(share.max() if joint is None else share[joint])


def _p_value(estimate: EffectEstimate) -> float | None:
    """p-value of a likelihood-ratio test: twice the log Bayes factor is at most χ² of k degrees."""
    if not np.isfinite(estimate.log_bayes_factor):
        return None
    freedom = estimate.freedom
    return float(special.chdtrc(freedom, max(2.0 * estimate.log_bayes_factor, 0.0)))


def _recording_filter(diagnosis: Diagnosis) -> dict[str, list[float]] | None:
    """The gain by which torque is recorded, at the quarters of the band; None if it is 1."""
    chain, hertz = diagnosis.final.chain, diagnosis.hertz
    if chain.filter is None:
        return None
    frequencies = hertz * np.linspace(0.25, 1.0, 4)
    return {"hertz": frequencies.tolist(), "gain": chain.gain(frequencies).tolist()}


def _budget(diagnosis: Diagnosis) -> dict[str, dict[str, dict[str, float]]]:
    """Shares of each joint's held-out torque beyond the base model."""
    budget = diagnosis.budget
    out = {}
    for i, joint in enumerate(diagnosis.identified.model.robot.joints):
        entry = {
            name: {"share": float(share[i]), "std": float(budget.std[name][i])}
            for name, share in budget.shares.items()
            if share[i]
        }
        std = float(np.sqrt(sum(value["std"] ** 2 for value in entry.values())))
        out[joint] = {**entry, "residual": {"share": float(budget.residual[i]), "std": std}}
    return out


def _changes(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Changes of joint actuators, with their shares of the errors of both models."""
    if not diagnosis.changes:
        return []
    held_out = diagnosis.held_out
    before = {
        (change.source, change.joint): change
        for change in session_changes.changes(held_out.motions, held_out.base, held_out.moving)
    }
    return [
        {
            **_change(diagnosis, change),
            "error_share": _error_share(diagnosis, held_out.final, change),
            "error_share_before": _error_share(
                diagnosis, held_out.base, before.get((change.source, change.joint), change)
            ),
        }
        for change in diagnosis.changes
    ]


def _change(diagnosis: Diagnosis, change: SessionChange) -> dict[str, Any]:
    """Change of a joint actuator in a recording, from the mean of the fitted recordings."""
    entry = diagnosis.identified.model.robot.entries[change.joint]
    units = (entry.unit("N m"), entry.unit("N m s/rad"), entry.unit("N m"))
    values = zip(
        session_changes.KINDS, change.change.tolist(), change.std.tolist(), units, strict=True
    )
    changes: dict[str, dict[str, Any]] = {
        kind: {"value": value, "std": std, "unit": unit} for kind, value, std, unit in values
    }
    fitted = diagnosis.final.identified
    for kind in ("coulomb", "viscous"):
        mean = float(fitted.psi[fitted.model.parameters.block(kind)][change.joint])
        changes[kind]["relative"] = changes[kind]["value"] / mean if mean > 0.0 else None
    return {
        "recording": change.source,
        "joint": _joint(diagnosis, change.joint),
        **changes,
    }


def _error_share(diagnosis: Diagnosis, residual: FloatArray, change: SessionChange) -> float:
    """Share of a joint's squared held-out error that a change in one recording explains."""
    held_out, j = diagnosis.held_out, change.joint
    parts = split_by_motion(np.where(held_out.moving, residual, 0.0), held_out.motions)
    powers = [
        (motion.segment.source, float(np.sum(part[:, j] ** 2)))
        for motion, part in zip(held_out.motions, parts, strict=True)
    ]
    power = sum(value for source, value in powers if source == change.source)
    return change.share * power / max(sum(value for _, value in powers), 1e-300)


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
    """Base parameters without and with the effects, the most significant change first."""
    if not diagnosis.final.effects:
        return []
    plain, final = diagnosis.identified, diagnosis.final.identified
    base = plain.model.base
    without, with_ = base.matrix @ plain.psi, base.matrix @ final.psi
    spread = base.matrix @ final.posterior.covariance @ base.matrix.T
    std = np.sqrt(np.maximum(np.diag(spread), 0.0))
    moved = np.abs(with_ - without) / np.maximum(std, 1e-12 * np.maximum(np.abs(with_), 1e-12))
    rows = [
        {
            "name": plain.model.parameters.names[place],
            "expression": base.expressions[i],
            "without": float(without[i]),
            "with": float(with_[i]),
            "std": float(std[i]),
            "moved": float(moved[i]),
        }
        for i, place in enumerate(base.independent)
    ]
    return sorted(rows, key=lambda row: -row["moved"])


def _unknown(diagnosis: Diagnosis, entry: UnmodelledTorque) -> dict[str, Any]:
    """Element of "unknown": a joint with torque that no effect explains."""
    name, response = _joint(diagnosis, entry.joint), entry.response
    by = (
        "another period of the motion"
        if entry.regime == unmodelled.REPETITION
        else entry.regime
        if entry.frequency is None
        else f"{entry.regime}, as a resonance of {entry.frequency:.2g} Hz,"
    )
    experiment = (
        SINGLE_JOINT_REPETITION
        if len(diagnosis.identified.model.robot.joints) == 1
        and entry.regime == unmodelled.REPETITION
        else entry.experiment
    )
    other = None if entry.other is None else _joint(diagnosis, entry.other)
    if other is not None:
        pair = f"{name} and {other}"
        by = by.replace("two joints", pair)
        experiment = experiment.replace("each of the two joints", f"{pair}, each")
    over = (
        response.over
        if response.other is None
        else f"{_joint(diagnosis, response.other)}: {response.over}"
    )
    small = [
        effect.effect
        for effect in diagnosis.considered
        if effect.joint == entry.joint
        and effect.effect not in DENSE_NAMES
        and effect.rejection == Rejection.TOO_SMALL
    ]
    return {
        "joint": name,
        **({} if other is None else {"other": other}),
        "too_small": small,
        "where": {
            "statement": f"joint '{name}': torque that no effect of the catalogue explains; "
            f"{by} predicts {percent(entry.share)} of the residual",
            "regime": entry.regime,
            "frequency_hz": entry.frequency,
            "response": {
                "over": over,
                "relative": response.relative,
                "x": response.x.tolist(),
                "y": response.y.tolist(),
            },
        },
        "share": entry.share,
        "probability": entry.probability,
        "z_score": entry.z_score,
        "experiment": experiment,
    }
