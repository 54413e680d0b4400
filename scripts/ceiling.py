#!/usr/bin/env python
"""How often could any method name what a trial's robots hide? An upper bound, case by case, from an opened trial.

    scripts/ceiling.py out/scored --cases 60 --jobs 2

For every case with one hidden effect, refit with its base, the torque that it hides is simulated again, exactly. The best that any other
name of the catalogue can make of it, together with the base parameters, leaves a part of it, of length δ in units of the noise. Between the
true effect, its law known to the last digit, and that nearest rival (which may also be: nothing), equally likely, no test errs less often
than Φ(−δ/2) (Neyman & Pearson 1933). A method that knows the laws less well does worse; rivals that nobody thought of are not counted.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from concealed_trial import commitment, generate_cases
from concealed_trial.case_plan import Spec
from concealed_trial.score import equal
from scipy.stats import norm

from excite import recordings
from excite.diagnosis import diagnosis
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.simulator import severity

Array = np.ndarray
MODELS = robot.locate("two_link").parent


@dataclass(frozen=True)
class Ceiling:
    """A case: its effect, the severity asked for, the nearest rival, how far off it is [noise], and the least error."""

    case: str
    effect: str
    severity: float
    rival: str
    apart: float
    error: float


def ceiling(name: str, key: dict[str, Any], folder: Path) -> Ceiling:
    """The least error between the hidden effect and the rival that is hardest to tell from it."""
    warnings.simplefilter("ignore")
    stated = {
        field: tuple(value) if isinstance(value, list) else value
        for field, value in key["spec"].items()
    }
    bench = generate_cases.bench(Spec(**stated), MODELS)
    machine = robot.load(str(folder / "robot.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    files = [recordings.read(folder / f"{part}.csv", machine) for part in ("train", "validate")]
    found = diagnosis.diagnose(
        machine, standard, base_parameters.find(machine, standard, table), [files[0]], [files[1]]
    )
    tracks = [one for half in found.motions for one in half]
    sessions = [
        session for half, session in zip(found.motions, bench.sessions, strict=True) for _ in half
    ]
    hidden = [
        one.lowpass(severity.hidden_torque(s.run, bench.plant, one.times).torque)
        for one, s in zip(tracks, sessions, strict=True)
    ]
    truth = np.concatenate([x / found.floor for x in hidden]).ravel()
    gamma = np.concatenate([one.gamma / found.floor[:, None] for one in tracks]).reshape(
        len(truth), -1
    )
    basis, _ = np.linalg.qr(gamma)
    left = truth - basis @ (basis.T @ truth)
    # rows closer than the band's own step are not independent
    rate = 1.0 / float(tracks[0].time[1] - tracks[0].time[0])
    independent = min(1.0, 2.0 * found.hertz / rate)
    apart = {"nothing": float(left @ left)}
    effect = str(key["effects"][0]["effect"])
    for shape in found.design.shapes:
        if equal(shape.effect, effect):
            continue
        columns = np.concatenate(
            [shape.columns(one) / found.floor[:, None] for one in tracks]
        ).reshape(len(truth), -1)
        free = columns - basis @ (basis.T @ columns)
        fitted, *_ = np.linalg.lstsq(free, left, rcond=1e-9)
        apart[shape.effect] = min(
            apart.get(shape.effect, np.inf), float(np.sum((left - free @ fitted) ** 2))
        )
    rival = min(apart, key=lambda which: apart[which])
    delta = float(np.sqrt(independent * apart[rival]))
    return Ceiling(
        name,
        effect,
        float(key["spec"]["severities"][0]),
        rival,
        delta,
        float(norm.cdf(-0.5 * delta)),
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="DIR", help="of a trial whose key is open")
    parser.add_argument(
        "--cases", type=int, default=60, metavar="N", help="at most (default %(default)s)"
    )
    parser.add_argument("--jobs", type=int, default=-1, metavar="N")
    given = parser.parse_args()
    keys = commitment.unlock(
        given.folder / "key", (given.folder / "sealed.sha256").read_text(encoding="utf-8").strip()
    )
    single = {
        name: key
        for name, key in sorted(keys.items())
        if key["spec"]["sort"] == "single" and not key["spec"]["trusted"]
    }
    chosen = list(single.items())[: given.cases]
    work = (
        joblib.delayed(ceiling)(name, key, given.folder / "cases" / name) for name, key in chosen
    )
    done: list[Ceiling] = joblib.Parallel(n_jobs=given.jobs, batch_size=1)(work)
    print("| severity | cases | best that any method can do |\n|---:|---:|---:|")
    for level in sorted({one.severity for one in done}):
        errors = [one.error for one in done if one.severity == level]
        print(f"| {level:g} | {len(errors)} | {1.0 - np.mean(errors):.3f} |")
    print(f"| all | {len(done)} | {1.0 - np.mean([one.error for one in done]):.3f} |\n")
    for one in sorted(done, key=lambda one: -one.error)[:10]:
        facts = {
            "case": one.case,
            "effect": one.effect,
            "severity": one.severity,
            "nearest": one.rival,
            "apart": round(one.apart, 2),
        }
        print(json.dumps(facts))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
