"""How a design was made: history of the optimiser, criteria, options and sources."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from ..designer.multistart import Attempt
from ..robot.inertial_parameters import Parameters
from ..robot.limits import QUANTITIES
from ..robot.parameter_names import plural
from ..robot.robot import Robot
from ..trajectory.rest_to_rest import SegmentKind
from ..trajectory.trajectory_file import Trajectory
from .content import Section, Table, TableCell
from .figures import information_spectrum
from .formatting import number, significant

NEAR_BEST = 0.05
"""Starts whose log criterion ends within this much of the best (5 %) count as equal."""
MAX_LOG_EXCESS = 20.0
"""Cap on the logarithm of an excess, against overflow."""
DEFAULT_NOISE_SHARE = 0.01
"""Torque noise over the torque limit where none is stated."""
LARGE_RATIO = 10.0
"""Ratio from which a change is stated as a factor, not in percent."""
_LABELS = {
    "a": "A: Σ 1/λ",
    "d": "D: Σ log λ",
    "e": "E: min λ",
    "cond": "max λ / min λ",
    "cond_regressor": "condition of the regressor",
}
_HIGHER_IS_BETTER = ("d", "e")


def history_section(attempts: Sequence[Attempt]) -> Section:
    """Build the section on the starts of the optimiser.

    It counts iterations, not seconds: a report is the same from run to run.
    """
    values, best = np.array([a.objective for a in attempts]), attempts[0]
    iterations = plural(len(best.history.time) - 1, "iteration")
    if len(attempts) == 1:
        answer = (
            f"The only start converged after {iterations}; a single start tells nothing about "
            "better local optima."
        )
    else:
        near = int(np.sum(values <= values[0] + NEAR_BEST))
        log_excess = float(values.max() - values[0])
        excess = max(100.0 * np.expm1(min(log_excess, MAX_LOG_EXCESS)), 0.0)
        stopped = sum(a.stopped for a in attempts)
        behind = f" ({stopped} were stopped early, being behind)" if stopped else ""
        answer = (
            f"The best of {len(attempts)} starts is number {best.number}, after {iterations}; "
            f"{near} of {len(attempts)} starts end within {100 * NEAR_BEST:.0f} % of it, the worst "
            f"{significant(excess)} % above{behind}. One more start would be better with a "
            f"probability of 1 in {len(attempts) + 1}."
        )
    infeasible = sum(not a.feasible for a in attempts)
    data = {
        "figure": Markup(information_spectrum.draw_history(attempts)),
        "infeasible": plural(infeasible, "start") if infeasible else "",
    }
    return Section("history", "How was it found?", answer, data)


def criteria_section(trajectory: Trajectory) -> Section:
    """Build the section on all criteria, of the excitation alone and of the complete motion."""
    optimum, exported = (
        _flat(trajectory.criteria.get(part, {})) for part in ("optimum", "exported")
    )
    chosen = _chosen_criterion(trajectory)
    rows = []
    for key in optimum:
        group, _, name = key.rpartition(".")
        rows.append(
            (
                group or "–",
                f"{_LABELS.get(name, name)}{' ← optimised' if key == chosen else ''}",
                number(optimum[key]),
                number(exported.get(key)),
                _change(name, optimum[key], exported.get(key)),
                "higher" if name in _HIGHER_IS_BETTER else "lower",
            )
        )
    head = ("weighting", "criterion", "excitation alone", "complete motion", "change", "better is")
    return Section(
        "criteria",
        "How do the ramps change the criterion?",
        _ramps_answer(trajectory, optimum.get(chosen), exported.get(chosen)),
        {"table": Table(head, rows, (2, 3, 4))},
    )


def is_for_purpose(trajectory: Trajectory) -> bool:
    """Tell whether a task or competing explanations took the place of the criterion."""
    return bool(trajectory.design.get("for") or trajectory.design.get("discriminate"))


def _chosen_criterion(trajectory: Trajectory) -> str:
    """Key of the criterion that was optimised, such as 'geometric.a'; empty if none was."""
    if is_for_purpose(trajectory):
        return ""
    name = str(trajectory.design.get("criterion", "a"))
    if name == "cond_regressor":
        return name
    return f"{'plain' if trajectory.design.get('plain') else 'geometric'}.{name}"


def _flat(entries: Mapping[str, Any]) -> dict[str, float | None]:
    """Criteria with keys such as 'geometric.a'."""
    out: dict[str, float | None] = {}
    for key, value in entries.items():
        if isinstance(value, Mapping):
            out |= {f"{key}.{name}": None if v is None else float(v) for name, v in value.items()}
        else:
            out[key] = None if value is None else float(value)
    return out


def _change(name: str, before: float | None, after: float | None) -> str:
    """Change of a criterion, absolute where it is a logarithm."""
    if before is None or after is None or not np.isfinite(before) or not np.isfinite(after):
        return "–"
    if name == "d":
        return f"{'' if after < before else '+'}{number(after - before, 3)}"
    if not before:
        return "–"
    ratio = after / before
    if ratio > LARGE_RATIO:
        return f"× {number(ratio, 2)}"
    return f"{100.0 * (ratio - 1.0):+.1f} %".replace("-", "−")


def _ramps_answer(trajectory: Trajectory, before: float | None, after: float | None) -> str:
    """Cost of approach, ramps and return, in time and in the criterion."""
    motion = trajectory.motion
    extra = motion.duration - (part := motion.segment(SegmentKind.FOURIER)).end + part.start
    name = str(trajectory.design.get("criterion", "a"))
    answer = (
        "The excitation itself is exported exactly; approach, ramps and return add "
        f"{extra:.1f} s ({100.0 * extra / motion.duration:.0f} % of the time)"
    )
    usable = before is not None and after is not None
    if before is None or after is None or not usable:
        return answer + "."
    if not np.isfinite(before) or not np.isfinite(after) or before == 0.0:
        return answer + "."
    if after == before:
        return answer + " and leave the criterion per sample unchanged."
    if name == "d":
        is_worse, size = after < before, f"{abs(after - before):.2g}"
    else:
        is_worse = (after < before) == (name in _HIGHER_IS_BETTER)
        size = f"{100.0 * abs(after / before - 1.0):.2g} %"
    return f"{answer} and make the criterion per sample {size} {'worse' if is_worse else 'better'}."


def provenance_section(trajectory: Trajectory, robot: Robot, parameters: Parameters) -> Section:
    """Build the section on options, sources of limits, and versions."""
    motion, design = trajectory.motion, trajectory.design
    series = f"{motion.fourier.harmonics} harmonics of {1.0 / motion.fourier.period:.4g} Hz"
    drive = ", ".join(kind.replace("_", " ") for kind in parameters.drive)
    facts: dict[str, str] = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "joints": ", ".join(robot.joints),
        "options of the robot": _words({k: v for k, v in robot.options.items() if v}),
        "parameters": f"inertial and {drive}" if drive else "inertial only",
        "Fourier series": f"{series}, {motion.periods} periods of {motion.fourier.period:g} s",
        "exported at": f"{trajectory.rate:g} Hz",
        "seed": str(trajectory.seed),
        "versions": ", ".join(f"{k} {v}" for k, v in trajectory.versions.items()),
    }
    facts |= {
        str(key).replace("_", " "): _words(value)
        for key, value in design.items()
        if key not in ("drive", "plan", "validation", "discrimination")
    }
    data = {
        "facts": Table(("option", "value"), [(k, v or "–") for k, v in facts.items()]),
        "limits": _limits_table(trajectory),
        "noise_source": _noise_source(trajectory),
    }
    answer = (
        f"With excite {trajectory.versions.get('excite', '')} and seed {trajectory.seed}; the same "
        "options give the same motion."
    )
    return Section("made", "How was it made?", answer, data)


def _words(value: Any) -> str:
    """A value of the design's options as text."""
    if isinstance(value, Mapping):
        return ", ".join(f"{k}: {_words(v)}" for k, v in value.items()) or "–"
    if isinstance(value, (list, tuple)):
        return ", ".join(_words(v) for v in value) or "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "–" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _noise_source(trajectory: Trajectory) -> str:
    """Source of the torque noise."""
    stated = trajectory.design.get("torque_noise_source")
    if isinstance(stated, str):
        return stated
    default = DEFAULT_NOISE_SHARE * trajectory.limits.torque
    if np.allclose(trajectory.noise, default, rtol=1e-9):
        return "assumed, 1 % of each torque limit"
    return "as given"


def _limits_table(trajectory: Trajectory) -> Table:
    """Limits of each joint with their sources, and its torque noise."""
    limits, sources = trajectory.limits, trajectory.limits.sources
    shown = [q for q in QUANTITIES if np.isfinite(np.asarray(getattr(limits, q))).any()]
    rows: list[tuple[str | TableCell, ...]] = [
        (
            joint,
            *(TableCell(_limit(getattr(limits, q)[j]), note=sources[q][j]) for q in shown),
            number(float(trajectory.noise[j]), 3),
        )
        for j, joint in enumerate(limits.joints)
    ]
    return Table(("joint", *shown, "noise (std)"), rows, (len(shown) + 1,))


def _limit(value: Any) -> str:
    """A limit, or the two ends of a range."""
    numbers = np.atleast_1d(value)
    if not np.isfinite(numbers).any():
        return "none"
    return " … ".join(number(float(v)) for v in numbers)
