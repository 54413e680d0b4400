"""Three baseline analysts: a greedy search by F-test and BIC, "always Stribeck", and a black box.

`python scripts/concealed_trial baselines CASE -o DIR` writes DIR/<analyst>.json, each an
`excite.diagnosis/1`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg, stats

from excite._types import FloatArray

from . import baseline_fit
from .baseline_candidates import Candidate, candidates
from .baseline_data import BaselineProblem, load_case

MAX_EFFECTS = 4
"""Most effects that the greedy search accepts."""
SIGNIFICANCE_LEVEL = 1e-3
"""Significance level of the F-test, Bonferroni-corrected."""
RIVAL_BIC_DIFFERENCE = 6.0
"""Difference of BIC within which other candidates count as equivalents.

More than 6 is strong evidence (Raftery 1995).
"""
FEATURE_COUNT = 200
"""Random Fourier features of the black box."""
RIDGES = (0.1, 1.0, 10.0, 100.0, 1e3)
"""Ridge parameters that are tried."""
FOLDS = 8
"""Folds of its cross-validation."""


@dataclass
class CandidateColumns:
    """Columns of a candidate on both recordings, below 20 Hz.

    Attributes:
        candidate: The candidate.
        columns: Columns on both recordings, shapes (N, n, m) and (M, n, m).
        rows: Rows of the stacked N·n rows that are not zero.
        c: Columns of the training recording over noise, of norm 1, on these rows.
        in_basis: Coefficients of the columns in the basis so far, shape (r, m).
    """

    candidate: Candidate
    columns: tuple[FloatArray, FloatArray]
    rows: slice
    c: FloatArray
    in_basis: FloatArray

    def learn(self, new: FloatArray) -> None:
        """Update `in_basis` for a basis that has grown by new columns, shape (N·n, k)."""
        self.in_basis = np.vstack([self.in_basis, new[self.rows].T @ self.c])

    def gain(self, residual: FloatArray) -> tuple[float, int]:
        """Return what the candidate would explain of a residual.

        Args:
            residual: Whitened residual, shape (N·n,).

        Returns:
            Decrease of the residual sum of squares and number of independent columns.
        """
        values, vectors = np.linalg.eigh(self.c.T @ self.c - self.in_basis.T @ self.in_basis)
        keep = values > 1e-6
        projection = vectors[:, keep].T @ (self.c.T @ residual[self.rows])
        return float((np.square(projection) / values[keep]).sum()), int(keep.sum())


def _candidate_columns(problem: BaselineProblem, candidate: Candidate) -> CandidateColumns:
    """Evaluate a candidate on both recordings."""
    columns, n = [], len(problem.joints)
    for scene in (problem.train, problem.validate):
        y = scene.low_passed(candidate.make(scene))
        if y.ndim == 2:
            padded = np.zeros((len(y), n, y.shape[1]))
            padded[:, candidate.j] = y
            y = padded
        columns.append(y)
    c = (columns[0] / problem.noise[:, None]).reshape(len(columns[0]) * n, -1)
    rows = slice(None) if candidate.j is None else slice(candidate.j, None, n)
    c = c[rows] / (np.linalg.norm(c, axis=0) + 1e-300)
    return CandidateColumns(candidate, (columns[0], columns[1]), rows, c, np.zeros((0, c.shape[1])))


@dataclass(frozen=True)
class AcceptedCandidate:
    """A candidate that the search accepted.

    Attributes:
        trial: Its columns.
        bic: Decrease of BIC.
        rivals: Effects in the same joint with nearly the same BIC at that step.
    """

    trial: CandidateColumns
    bic: float
    rivals: tuple[str, ...]


def greedy_search(
    problem: BaselineProblem,
    trials: list[CandidateColumns],
    steps: int = MAX_EFFECTS,
    *,
    always: bool = False,
) -> list[AcceptedCandidate]:
    """Forward selection by BIC.

    Args:
        problem: The residuals.
        trials: Columns of all candidates.
        steps: Most candidates to accept.
        always: Accept the best candidate without the F-test.
    """
    basis = problem.basis.reshape(problem.residuals[0].size, -1)
    residual, rank = (problem.residuals[0] / problem.noise).ravel(), basis.shape[1]
    residual = residual - basis @ (basis.T @ residual)
    for trial in trials:
        trial.in_basis = np.zeros((0, trial.c.shape[1]))
        trial.learn(basis)
    out: list[AcceptedCandidate] = []
    for _ in range(steps):
        rss, size = float(np.square(residual).sum()), residual.size - rank
        scores = []
        for trial in trials:
            decrease, m = trial.gain(residual)
            if m and 0.0 < decrease < rss:
                p = float(
                    stats.f.sf((decrease / m) / ((rss - decrease) / (size - m)), m, size - m)
                ) * len(trials)
                scores.append(
                    (float(size * np.log(rss / (rss - decrease)) - m * np.log(size)), p, trial)
                )
        if not scores:
            break
        bic, p, best = max(scores, key=lambda entry: entry[0])
        if not always and (bic <= 0.0 or p > SIGNIFICANCE_LEVEL):
            break
        rivals = {
            t.candidate.name
            for b, _, t in scores
            if b > bic - RIVAL_BIC_DIFFERENCE and t.candidate.joint == best.candidate.joint
        }
        out.append(AcceptedCandidate(best, bic, tuple(sorted(rivals - {best.candidate.name}))))
        c = np.zeros((residual.size, best.c.shape[1]))
        c[best.rows] = best.c
        c = c - basis @ (basis.T @ c)
        u, s, _ = linalg.svd(c, full_matrices=False)
        new = u[:, s > 1e-3]
        basis, rank, residual = (
            np.hstack([basis, new]),
            rank + new.shape[1],
            residual - new @ (new.T @ residual),
        )
        for trial in trials:
            trial.learn(new)
    return out


def _diagnosis_of(
    problem: BaselineProblem,
    accepted_candidates: list[AcceptedCandidate],
    certainty: float | None = None,
) -> dict[str, Any]:
    """Refit base model and accepted candidates, predict the held-out recording: a diagnosis."""
    first = np.concatenate(
        [problem.columns[0], *(c.trial.columns[0] for c in accepted_candidates)], axis=2
    )
    second = np.concatenate(
        [problem.columns[1], *(c.trial.columns[1] for c in accepted_candidates)], axis=2
    )
    solution, std = _solve(problem, first)
    after = problem.residuals[1] - second @ solution
    findings, start = [], problem.columns[0].shape[2]
    for accepted in accepted_candidates:
        c, m = accepted.trial.candidate, accepted.trial.columns[0].shape[2]
        parameters = {
            name: {
                "value": value_of(float(solution[start + k])),
                "std": abs(
                    value_of(float(solution[start + k] + std[start + k]))
                    - value_of(float(solution[start + k]))
                ),
                "unit": unit,
            }
            for name, unit, k, value_of in c.stated
        } | {name: {"value": value, "std": None, "unit": unit} for name, unit, value in c.fixed}
        probability = (
            certainty
            if certainty is not None
            else float(np.clip(1.0 / (1.0 + np.exp(-0.5 * accepted.bic)), 0.5, 0.999))
        )
        where = {
            "statement": f"{c.name} in {c.joint}",
            "regime": "",
            "time": None if c.time is None else list(c.time),
        }
        findings.append(
            {
                "effect": c.name,
                "joint": c.joint,
                "probability": probability,
                "equivalents": list(accepted.rivals),
                "where": where,
                "parameters": parameters,
            }
        )
        start += m
    return _document(problem, findings, [], after)


def _solve(problem: BaselineProblem, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return coefficients of the training residual and their standard deviations, shapes (P,)."""
    if not columns.shape[2]:
        return np.zeros(0), np.zeros(0)
    basis, solve = baseline_fit.column_space(
        (columns / problem.noise[:, None]).reshape(-1, columns.shape[2])
    )
    return solve @ (basis.T @ (problem.residuals[0] / problem.noise).ravel()), np.sqrt(
        np.square(solve).sum(axis=1)
    )


def _document(
    problem: BaselineProblem,
    findings: list[dict[str, Any]],
    unknown: list[dict[str, Any]],
    after: FloatArray,
) -> dict[str, Any]:
    """Write a diagnosis."""
    before, rmse_after = baseline_fit.rmse(problem.residuals[1]), baseline_fit.rmse(after)
    joints = {
        name: {
            "noise_floor": None,
            "noise_floor_method": None,
            "rmse_before": float(before[j]),
            "rmse_after": float(rmse_after[j]),
            "unexplained_share": None,
        }
        for j, name in enumerate(problem.joints)
    }
    verdict = "explained" if findings else "unexplained" if unknown else "no-mismatch"
    return {
        "schema": "excite.diagnosis/1",
        "verdict": verdict,
        "findings": sorted(findings, key=lambda f: -float(f["probability"])),
        "joints": joints,
        "unknown": unknown,
        "considered": [],
        "band_hz": baseline_fit.TORQUE_BAND,
    }


def blackbox(problem: BaselineProblem, period: float, rng: np.random.Generator) -> dict[str, Any]:
    """Explain the residuals by ridge regression on random Fourier features, without names.

    Eight-fold cross-validation over phases of the period, each left out in all periods at once.

    Args:
        problem: The residuals.
        period: Period of the excitation [s].
        rng: Generator of the features.
    """
    unknown, after = [], problem.residuals[1].copy()
    fold = np.floor(
        8.0 * np.mod(problem.train.low_passed(problem.train.data.t), period) / period
    ).astype(int)
    for j, joint in enumerate(problem.joints):
        first, second = (_state_features(scene, j) for scene in (problem.train, problem.validate))
        centre, scale = first.mean(axis=0), first.std(axis=0) + 1e-12
        directions, shifts = (
            rng.standard_normal((first.shape[1], FEATURE_COUNT)) * 0.3,
            rng.uniform(0.0, 2.0 * np.pi, FEATURE_COUNT),
        )
        x, x_validation = (
            np.cos((s - centre) / scale @ directions + shifts) for s in (first, second)
        )
        target = problem.residuals[0][:, j]
        costs = sum(
            _costs(x[fold != k], target[fold != k], x[fold == k], target[fold == k])
            for k in range(8)
        )
        best = int(np.argmin(costs))
        share = 1.0 - float(np.asarray(costs)[best]) / float(np.square(target).sum())
        if share > 0.1:
            after[:, j] -= x_validation @ _ridges(x, target)[:, best]
            where = {"statement": f"repeatable torque in {joint}"}
            unknown.append(
                {
                    "joint": joint,
                    "where": where,
                    "share": share,
                    "probability": min(0.99, 0.5 + share),
                }
            )
    return _document(problem, [], unknown, after)


def _state_features(scene: Any, j: int) -> FloatArray:
    """Return the state of a joint that the black box sees, shape (M, features)."""
    data = scene.data
    neighbours = [i for i in (j - 1, j + 1) if 0 <= i < data.v.shape[1]]
    state = [
        data.q[:, j],
        data.v[:, j],
        np.tanh(data.v[:, j] / 0.02),
        data.a[:, j],
        scene.load[:, j],
    ]
    return np.asarray(scene.low_passed(np.column_stack([*state, data.v[:, neighbours]])))


def _ridges(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return ridge regressions, one per ridge parameter, shape (features, len(RIDGES))."""
    values, vectors = np.linalg.eigh(x.T @ x)
    return np.asarray(
        vectors @ ((vectors.T @ (x.T @ y))[:, None] / (values[:, None] + np.array(RIDGES)))
    )


def _costs(
    x: FloatArray, y: FloatArray, x_held_out: FloatArray, y_held_out: FloatArray
) -> FloatArray:
    """Return the sum of squared errors on the held-out fold, per ridge parameter."""
    return np.asarray(np.square(y_held_out[:, None] - x_held_out @ _ridges(x, y)).sum(axis=0))


def baseline_answers(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the answer of each baseline to a case."""
    problem, sidecar = (
        load_case(folder),
        json.loads((folder / "train.json").read_text(encoding="utf-8")),
    )
    trials = [_candidate_columns(problem, candidate) for candidate in candidates(problem)]
    only = [trial for trial in trials if trial.candidate.name == "stribeck"]
    return {
        "greedy": _diagnosis_of(problem, greedy_search(problem, trials)),
        "stribeck": _diagnosis_of(problem, greedy_search(problem, only, 1, always=True), 0.9),
        "blackbox": blackbox(problem, float(sidecar["period"]), np.random.default_rng(0)),
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line of the baselines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True)
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, document in baseline_answers(arguments.case).items():
        (arguments.out / f"{name}.json").write_text(
            json.dumps(document, indent=1), encoding="utf-8"
        )
    return 0
