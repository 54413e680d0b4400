"""Three analysts to be beaten: a greedy F-test and BIC search, "Stribeck, always", and a flexible black box.

`python scripts/concealed_trial baselines CASE -o DIR` writes DIR/<analyst>.json, each an `excite.diagnosis/1`.
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

from . import baseline_fit
from .baseline_candidates import Candidate, candidates
from .baseline_data import Problem, load

Array = np.ndarray
STEPS, LEVEL = 4, 1e-3
FEATURES, RIDGES = 200, (0.1, 1.0, 10.0, 100.0, 1e3)


@dataclass
class Trial:
    """A candidate's columns on both recordings, below 20 Hz. Shapes (N, n, m), (M, n, m); c: the first over noise, of length 1.

    rows: which of the N·n rows are not 0. seen: what the columns have in common with the basis so far, Shape (r, m).
    """

    candidate: Candidate
    columns: tuple[Array, Array]
    rows: slice
    c: Array
    seen: Array

    def learn(self, new: Array) -> None:
        """The basis has grown by these columns. Shape (N·n, k)."""
        self.seen = np.vstack([self.seen, new[self.rows].T @ self.c])

    def gain(self, rest: Array) -> tuple[float, int]:
        """Fall of the residual sum of squares, over noise², and the number of columns that are new. rest: Shape (N·n,)."""
        values, vectors = np.linalg.eigh(self.c.T @ self.c - self.seen.T @ self.seen)
        keep = values > 1e-6
        towards = vectors[:, keep].T @ (self.c.T @ rest[self.rows])
        return float((np.square(towards) / values[keep]).sum()), int(keep.sum())


def _trial(problem: Problem, candidate: Candidate) -> Trial:
    made, n = [], len(problem.joints)
    for scene in (problem.train, problem.validate):
        y = scene.low(candidate.make(scene))
        if y.ndim == 2:
            whole = np.zeros((len(y), n, y.shape[1]))
            whole[:, candidate.j] = y
            y = whole
        made.append(y)
    c = (made[0] / problem.noise[:, None]).reshape(len(made[0]) * n, -1)
    rows = slice(None) if candidate.j is None else slice(candidate.j, None, n)
    c = c[rows] / (np.linalg.norm(c, axis=0) + 1e-300)
    return Trial(candidate, (made[0], made[1]), rows, c, np.zeros((0, c.shape[1])))


@dataclass(frozen=True)
class Chosen:
    """A candidate taken in: how much its BIC is better than nothing, and what came close at that step."""

    trial: Trial
    bic: float
    rivals: tuple[str, ...]


def greedy(
    problem: Problem, trials: list[Trial], steps: int = STEPS, *, always: bool = False
) -> list[Chosen]:
    """Forward selection: at each step the candidate with the best BIC, if it passes a Bonferroni-corrected F-test, or always."""
    basis = problem.basis.reshape(problem.rest[0].size, -1)
    rest, rank = (problem.rest[0] / problem.noise).ravel(), basis.shape[1]
    rest = rest - basis @ (basis.T @ rest)
    for trial in trials:
        trial.seen = np.zeros((0, trial.c.shape[1]))
        trial.learn(basis)
    out: list[Chosen] = []
    for _ in range(steps):
        rss, size = float(np.square(rest).sum()), rest.size - rank
        scores = []
        for trial in trials:
            fall, m = trial.gain(rest)
            if m and 0.0 < fall < rss:
                p = float(stats.f.sf((fall / m) / ((rss - fall) / (size - m)), m, size - m)) * len(
                    trials
                )
                scores.append(
                    (float(size * np.log(rss / (rss - fall)) - m * np.log(size)), p, trial)
                )
        if not scores:
            break
        bic, p, best = max(scores, key=lambda entry: entry[0])
        if not always and (bic <= 0.0 or p > LEVEL):
            break
        near = {
            t.candidate.name
            for b, _, t in scores
            if b > bic - 6.0 and t.candidate.joint == best.candidate.joint
        }
        out.append(Chosen(best, bic, tuple(sorted(near - {best.candidate.name}))))
        c = np.zeros((rest.size, best.c.shape[1]))
        c[best.rows] = best.c
        c = c - basis @ (basis.T @ c)
        u, s, _ = linalg.svd(c, full_matrices=False)
        new = u[:, s > 1e-3]
        basis, rank, rest = (
            np.hstack([basis, new]),
            rank + new.shape[1],
            rest - new @ (new.T @ rest),
        )
        for trial in trials:
            trial.learn(new)
    return out


def _answer(
    problem: Problem, chosen: list[Chosen], certainty: float | None = None
) -> dict[str, Any]:
    """Refit base and choice together, predict the second recording, and say so in the contract's words."""
    first = np.concatenate([problem.columns[0], *(c.trial.columns[0] for c in chosen)], axis=2)
    second = np.concatenate([problem.columns[1], *(c.trial.columns[1] for c in chosen)], axis=2)
    solution, spread = _solve(problem, first)
    after = problem.rest[1] - second @ solution
    findings, at = [], problem.columns[0].shape[2]
    for one in chosen:
        c, m = one.trial.candidate, one.trial.columns[0].shape[2]
        parameters = {
            name: {
                "value": turn(float(solution[at + k])),
                "std": abs(
                    turn(float(solution[at + k] + spread[at + k])) - turn(float(solution[at + k]))
                ),
                "unit": unit,
            }
            for name, unit, k, turn in c.stated
        } | {name: {"value": value, "std": None, "unit": unit} for name, unit, value in c.fixed}
        probability = (
            certainty
            if certainty is not None
            else float(np.clip(1.0 / (1.0 + np.exp(-0.5 * one.bic)), 0.5, 0.999))
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
                "equivalents": list(one.rivals),
                "where": where,
                "parameters": parameters,
            }
        )
        at += m
    return _document(problem, findings, [], after)


def _solve(problem: Problem, columns: Array) -> tuple[Array, Array]:
    """Coefficients that explain the training residual, and their standard deviations. Shapes (P,), (P,)."""
    if not columns.shape[2]:
        return np.zeros(0), np.zeros(0)
    basis, solve = baseline_fit.span(
        (columns / problem.noise[:, None]).reshape(-1, columns.shape[2])
    )
    return solve @ (basis.T @ (problem.rest[0] / problem.noise).ravel()), np.sqrt(
        np.square(solve).sum(axis=1)
    )


def _document(
    problem: Problem, findings: list[dict[str, Any]], unknown: list[dict[str, Any]], after: Array
) -> dict[str, Any]:
    before, left = baseline_fit.rmse(problem.rest[1]), baseline_fit.rmse(after)
    joints = {
        name: {
            "noise_floor": None,
            "noise_floor_method": None,
            "rmse_before": float(before[j]),
            "rmse_after": float(left[j]),
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
        "band_hz": baseline_fit.BAND,
    }


def blackbox(problem: Problem, period: float, rng: np.random.Generator) -> dict[str, Any]:
    """Random Fourier features of each joint's state and torque, ridge-regressed onto its residual; it names nothing.

    Cross-fitted over eight stretches of the period, each left out in all its repeats at once.
    """
    unknown, after = [], problem.rest[1].copy()
    fold = np.floor(8.0 * np.mod(problem.train.low(problem.train.data.t), period) / period).astype(
        int
    )
    for j, joint in enumerate(problem.joints):
        first, second = (_state(scene, j) for scene in (problem.train, problem.validate))
        middle, size = first.mean(axis=0), first.std(axis=0) + 1e-12
        ways, shifts = (
            rng.standard_normal((first.shape[1], FEATURES)) * 0.3,
            rng.uniform(0.0, 2.0 * np.pi, FEATURES),
        )
        x, held = (np.cos((s - middle) / size @ ways + shifts) for s in (first, second))
        target = problem.rest[0][:, j]
        costs = sum(
            _costs(x[fold != k], target[fold != k], x[fold == k], target[fold == k])
            for k in range(8)
        )
        best = int(np.argmin(costs))
        share = 1.0 - float(np.asarray(costs)[best]) / float(np.square(target).sum())
        if share > 0.1:
            after[:, j] -= held @ _ridges(x, target)[:, best]
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


def _state(scene: Any, j: int) -> Array:
    d = scene.data
    near = [i for i in (j - 1, j + 1) if 0 <= i < d.v.shape[1]]
    own = [d.q[:, j], d.v[:, j], np.tanh(d.v[:, j] / 0.02), d.a[:, j], scene.load[:, j]]
    return np.asarray(scene.low(np.column_stack([*own, d.v[:, near]])))


def _ridges(x: Array, y: Array) -> Array:
    """Ridge regressions, one per strength. Shape (features, len(RIDGES))."""
    values, vectors = np.linalg.eigh(x.T @ x)
    return np.asarray(
        vectors @ ((vectors.T @ (x.T @ y))[:, None] / (values[:, None] + np.array(RIDGES)))
    )


def _costs(x: Array, y: Array, held: Array, out: Array) -> Array:
    """Sum of squares left on what was held out, per strength."""
    return np.asarray(np.square(out[:, None] - held @ _ridges(x, y)).sum(axis=0))


def answers(folder: Path) -> dict[str, dict[str, Any]]:
    """What each baseline says of a case."""
    problem, sidecar = load(folder), json.loads((folder / "train.json").read_text(encoding="utf-8"))
    trials = [_trial(problem, candidate) for candidate in candidates(problem)]
    only = [trial for trial in trials if trial.candidate.name == "stribeck"]
    return {
        "greedy": _answer(problem, greedy(problem, trials)),
        "stribeck": _answer(problem, greedy(problem, only, 1, always=True), 0.9),
        "blackbox": blackbox(problem, float(sidecar["period"]), np.random.default_rng(0)),
    }


def main(argv: Sequence[str] | None = None) -> int:
    """The command line of the three baselines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True)
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, document in answers(arguments.case).items():
        (arguments.out / f"{name}.json").write_text(
            json.dumps(document, indent=1), encoding="utf-8"
        )
    return 0
