"""Where a design comes from: the optimiser's history, the criteria, the options and the sources."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..designer.sqp import FEASIBLE
from ..robot.inertial_parameters import Parameters
from ..robot.limits import QUANTITIES
from ..robot.robot import Robot
from ..trajectory.trajectory_file import Trajectory
from .figures import information_spectrum
from .page import Section, bullets, escape, figure, folded, number, paragraph, plural, table
from .record import DesignRecord

_LABELS = {
    "a": "A: Σ 1/λ",
    "d": "D: Σ log λ",
    "e": "E: min λ",
    "cond": "max λ / min λ",
    "cond_regressor": "condition of the regressor",
}
_HIGHER = ("d", "e")


def history_section(record: DesignRecord) -> Section:
    """(i) How was it found?"""
    starts = record.starts
    if not starts:
        return Section(
            "history", "How was it found?", "No history of the optimisation was kept.", ""
        )
    values = np.array([float(s["value"]) for s in starts])
    best = starts[record.chosen]
    near = int(np.sum(values <= values[record.chosen] + 0.05))
    answer = (
        f"The best of {len(starts)} starts is number {best['seed']}, "
        if len(starts) > 1
        else "The only start was "
    )
    answer += f"done after {plural(len(best['objective']), 'iteration')}"
    if len(starts) > 1:
        excess = 100.0 * np.expm1(min(float(values.max() - values[record.chosen]), 20.0))
        stopped = sum(bool(s.get("stopped")) for s in starts)
        behind = f" ({stopped} were stopped on the way, being behind)" if stopped else ""
        answer += f"; {near} of {len(starts)} starts end within 5 % of it, the worst {max(excess, 0.0):.2g} % above{behind}. "
        answer += f"One more start would beat it with a chance of 1 in {len(starts) + 1}."
    else:
        answer += "; a single start tells nothing about better local optima."
    inside = np.flatnonzero(np.array(best["worst"]) <= FEASIBLE)
    rows = [
        (
            "chosen start: first motion inside all limits",
            str(inside[0] + 1) if len(inside) else "–",
        ),
        ("chosen start: end", str(len(best["objective"]))),
        ("all starts together", str(sum(len(start["objective"]) for start in starts))),
    ]
    body = figure(information_spectrum.history(record)) + table(("step", "iterations"), rows, (1,))
    infeasible = sum(not s["feasible"] for s in starts)
    if infeasible:
        body += paragraph(
            f"{plural(infeasible, 'start')} found no motion inside all limits.", "warn"
        )
    return Section("history", "How was it found?", answer, body)


def criteria_section(trajectory: Trajectory) -> Section:
    """(j) What did the ramps and smoothing change?"""
    optimum, exported = (
        _flat(trajectory.criteria.get(part, {})) for part in ("optimum", "exported")
    )
    chosen = _chosen(trajectory)
    rows = []
    for key in optimum:
        group, _, name = key.rpartition(".")
        label = f"{_LABELS.get(name, name)}{' ← optimised' if key == chosen else ''}"
        better = "higher" if name in _HIGHER else "lower"
        rows.append(
            (
                escape(group or "–"),
                escape(label),
                number(optimum[key]),
                number(exported.get(key)),
                _change(name, optimum[key], exported.get(key)),
                better,
            )
        )
    head = ("weighting", "criterion", "excitation alone", "whole motion", "change", "better is")
    note = (
        "All values are means per sample, so that motions of different length compare. "
        "Geometric: weighted by the robot's own metric, without units; plain: Euclidean, as most of the literature reports."
    )
    body = table(head, rows, (2, 3, 4)) + paragraph(note, "note")
    return Section(
        "criteria",
        "What did ramps and smoothing change?",
        _smoothing(trajectory, optimum.get(chosen), exported.get(chosen)),
        body,
    )


def _chosen(trajectory: Trajectory) -> str:
    name = str(trajectory.design.get("criterion", "a"))
    return (
        name
        if name == "cond_regressor"
        else f"{'plain' if trajectory.design.get('plain') else 'geometric'}.{name}"
    )


def _flat(entries: Mapping[str, Any]) -> dict[str, float | None]:
    out: dict[str, float | None] = {}
    for key, value in entries.items():
        if isinstance(value, Mapping):
            out.update(
                {f"{key}.{name}": None if v is None else float(v) for name, v in value.items()}
            )
        else:
            out[key] = None if value is None else float(value)
    return out


def _change(name: str, before: float | None, after: float | None) -> str:
    if before is None or after is None or not np.isfinite(before) or not np.isfinite(after):
        return "–"
    if name == "d":
        return f"{number(after - before, 3) if after < before else '+' + number(after - before, 3)}"
    return f"{100.0 * (after / before - 1.0):+.1f} %".replace("-", "−") if before else "–"


def _smoothing(trajectory: Trajectory, before: float | None, after: float | None) -> str:
    motion = trajectory.motion
    extra = motion.duration - (part := motion.segment("fourier")).end + part.start
    name = str(trajectory.design.get("criterion", "a"))
    share = f"{100.0 * extra / motion.duration:.0f} % of the time"
    answer = f"The excitation itself is exported exactly; approach, ramps and return add {extra:.1f} s ({share})"
    if (
        before is None
        or after is None
        or not np.isfinite(before)
        or not np.isfinite(after)
        or before == 0.0
    ):
        return answer + "."
    if name == "d":
        worse, size = after < before, f"{abs(after - before):.2g}"
    else:
        worse, size = (
            (after < before) == (name in _HIGHER),
            f"{100.0 * abs(after / before - 1.0):.2g} %",
        )
    if after == before:
        return answer + " and leave the criterion per sample as it is."
    return f"{answer} and make the criterion per sample {size} {'worse' if worse else 'better'}."


def made_section(
    trajectory: Trajectory, robot: Robot, parameters: Parameters, record: DesignRecord
) -> Section:
    """(k) How was it made?"""
    motion, design = trajectory.motion, trajectory.design
    series = f"{motion.fourier.harmonics} harmonics of {1.0 / motion.fourier.period:.4g} Hz"
    facts: dict[str, str] = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "joints": ", ".join(robot.joints),
        "loaded with": _words({k: v for k, v in robot.options.items() if v}),
        "parameters": "inertial"
        + (
            f" and {', '.join(k.replace('_', ' ') for k in parameters.drive)}"
            if parameters.drive
            else " only"
        ),
        "Fourier series": f"{series}, {motion.periods} periods of {motion.fourier.period:g} s",
        "exported at": f"{trajectory.rate:g} Hz",
        "seed": str(trajectory.seed),
        "versions": ", ".join(f"{k} {v}" for k, v in trajectory.versions.items()),
    }
    facts |= {
        str(key).replace("_", " "): _words(value)
        for key, value in design.items()
        if key not in ("drive", "plan", "validation")
    }
    body = table(("what", "value"), [(escape(k), escape(v or "–")) for k, v in facts.items()])
    body += "<h3>Limits, where each came from, and torque noise</h3>" + _limits_table(trajectory)
    body += paragraph(
        f"Torque noise: {_noise_source(trajectory)}. It scales every predicted variance.", "note"
    )
    if record.notes:
        body += folded("Remarks of the run", bullets(record.notes))
    answer = f"With excite {trajectory.versions.get('excite', '')} and seed {trajectory.seed}; the same options give the same motion again."
    return Section("made", "How was it made?", answer, body)


def _words(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{k}: {_words(v)}" for k, v in value.items()) or "–"
    if isinstance(value, (list, tuple)):
        return ", ".join(_words(v) for v in value) or "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "–" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _noise_source(trajectory: Trajectory) -> str:
    stated = trajectory.design.get("torque_noise_source")
    if isinstance(stated, str):
        return stated
    default = np.allclose(trajectory.noise, 0.01 * trajectory.limits.torque, rtol=1e-9)
    return "assumed, 1 % of each torque limit" if default else "as given"


def _limits_table(trajectory: Trajectory) -> str:
    limits, sources = trajectory.limits, trajectory.limits.sources
    shown = [q for q in QUANTITIES if np.isfinite(np.asarray(getattr(limits, q))).any()]
    rows = []
    for j, joint in enumerate(limits.joints):
        cells = [f"{_limit(getattr(limits, q)[j])}<br>{_source(sources[q][j])}" for q in shown]
        rows.append((escape(joint), *cells, number(float(trajectory.noise[j]), 3)))
    return table(("joint", *shown, "noise (std)"), rows, (len(shown) + 1,))


def _limit(value: Any) -> str:
    numbers = np.atleast_1d(value)
    if not np.isfinite(numbers).any():
        return "none"
    return (
        number(float(numbers[0]))
        if len(numbers) == 1
        else f"{number(float(numbers[0]))} … {number(float(numbers[1]))}"
    )


def _source(text: str) -> str:
    return f'<span class="note">{escape(text)}</span>' if text else ""
