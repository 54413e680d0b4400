#!/usr/bin/env python
"""Upper bound of a diagnosis: how often could any method name what a trial's robots hide?

    scripts/diagnosis_upper_bound.py out/scored --cases 60 --jobs 2

For every case with one hidden effect, its torque is simulated again, exactly. The best fit by any
other effect of the catalogue, together with the base parameters, leaves a residual of length δ in
units of noise. Between the true effect, with its model known exactly, and that nearest rival (which
may be: nothing), equally probable, no test has an error rate below Φ(−δ/2) (Neyman & Pearson 1933).
A method with less exact models does worse; rivals outside the catalogue are not counted.
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
from concealed_trial.case_plan import CaseSpec
from concealed_trial.run import TrialFolder
from concealed_trial.score import are_equivalent
from scipy.stats import norm

from excite import recordings
from excite.diagnosis import diagnosis
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.simulator import severity

MODELS = robot.locate("two_link").parent


@dataclass(frozen=True)
class ErrorBound:
    """Least error rate in a case.

    Attributes:
        case: Name of the case.
        effect: Hidden effect.
        severity: Wanted severity [1].
        rival: Nearest rival.
        apart: Distance δ to it [noise].
        error: Least error rate [1].
    """

    case: str
    effect: str
    severity: float
    rival: str
    apart: float
    error: float


def error_bound(name: str, key: dict[str, Any], folder: Path) -> ErrorBound:
    """Return the least error rate between the hidden effect and its nearest rival."""
    warnings.simplefilter("ignore")
    fields = {
        field: tuple(value) if isinstance(value, list) else value
        for field, value in key["spec"].items()
    }
    generated = generate_cases.generate_case(CaseSpec(**fields), MODELS)
    machine = robot.load(str(folder / "robot.urdf"))
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    files = [recordings.read(folder / f"{part}.csv", machine) for part in ("train", "validate")]
    result = diagnosis.diagnose(
        machine, standard, base_parameters.find(machine, standard, table), [files[0]], [files[1]]
    )
    tracks = [track for fold in result.motions for track in fold]
    sessions = [
        session
        for fold, session in zip(result.motions, generated.sessions, strict=True)
        for _ in fold
    ]
    hidden = [
        track.lowpass(severity.hidden_torque(s.motion, generated.robot, track.times).torque)
        for track, s in zip(tracks, sessions, strict=True)
    ]
    truth = np.concatenate([x / result.floor for x in hidden]).ravel()
    gamma = np.concatenate([track.gamma / result.floor[:, None] for track in tracks]).reshape(
        len(truth), -1
    )
    basis, _ = np.linalg.qr(gamma)
    residual = truth - basis @ (basis.T @ truth)
    # rows closer than half a period of the band are not independent
    rate = 1.0 / float(tracks[0].time[1] - tracks[0].time[0])
    independent = min(1.0, 2.0 * result.hertz / rate)
    apart = {"nothing": float(residual @ residual)}
    effect = str(key["effects"][0]["effect"])
    for shape in result.design.shapes:
        if are_equivalent(shape.effect, effect):
            continue
        columns = np.concatenate(
            [shape.columns(track) / result.floor[:, None] for track in tracks]
        ).reshape(len(truth), -1)
        projected = columns - basis @ (basis.T @ columns)
        fitted, *_ = np.linalg.lstsq(projected, residual, rcond=1e-9)
        apart[shape.effect] = min(
            apart.get(shape.effect, np.inf), float(np.sum((residual - projected @ fitted) ** 2))
        )
    rival = min(apart, key=lambda which: apart[which])
    delta = float(np.sqrt(independent * apart[rival]))
    return ErrorBound(
        name,
        effect,
        float(key["spec"]["severities"][0]),
        rival,
        delta,
        float(norm.cdf(-0.5 * delta)),
    )


def main() -> int:
    """Print the table and the ten hardest cases."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of a trial")
    parser.add_argument(
        "--cases",
        type=int,
        default=60,
        metavar="N",
        help="largest number of cases (default %(default)s)",
    )
    parser.add_argument("--jobs", type=int, default=-1, metavar="N")
    given = parser.parse_args()
    trial = TrialFolder(given.folder)
    keys = commitment.open_ground_truth(trial.key, trial.published_hash())
    single = {
        name: key
        for name, key in sorted(keys.items())
        if key["spec"]["category"] == "single" and not key["spec"]["trusted"]
    }
    chosen = list(single.items())[: given.cases]
    work = (
        joblib.delayed(error_bound)(name, key, given.folder / "cases" / name)
        for name, key in chosen
    )
    bounds: list[ErrorBound] = joblib.Parallel(n_jobs=given.jobs, batch_size=1)(work)
    print("| severity | cases | best that any method can do |\n|---:|---:|---:|")
    for level in sorted({bound.severity for bound in bounds}):
        errors = [bound.error for bound in bounds if bound.severity == level]
        print(f"| {level:g} | {len(errors)} | {1.0 - np.mean(errors):.3f} |")
    print(f"| all | {len(bounds)} | {1.0 - np.mean([bound.error for bound in bounds]):.3f} |\n")
    for bound in sorted(bounds, key=lambda bound: -bound.error)[:10]:
        facts = {
            "case": bound.case,
            "effect": bound.effect,
            "severity": bound.severity,
            "nearest": bound.rival,
            "apart": round(bound.apart, 2),
        }
        print(json.dumps(facts))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
