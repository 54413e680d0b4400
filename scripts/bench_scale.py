#!/usr/bin/env python
"""Measure time and memory against joints, samples, harmonics and rows, and compare the estimates.

    python scripts/bench_scale.py          # iterations of designs of 2 to 60 joints (5 minutes)
    python scripts/bench_scale.py --whole  # also complete commands with up to 60 joints and long
                                           # recordings (20 minutes)

It prints Markdown tables: measured processor time and memory against the estimates of
excite.designer.design_cost and excite.recordings.recording_cost, and the coefficients that fit the
time of an iteration best. Each case runs in its own process, on one thread, without a compiler.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["EXCITE_COMPILER"] = ""
sys.path.append(str(Path(__file__).resolve().parent.parent / "tests"))

import numpy as np
import threadpoolctl
from large_robots import tree_urdf
from scipy.optimize import nnls

from excite.designer import design_cost, initial_guess, optimize, sqp, time_budget
from excite.designer.evaluator import Evaluator
from excite.designer.options import DesignOptions
from excite.errors import ExciteWarning
from excite.robot import dynamics, inertial_parameters, limits
from excite.robot.robot import load
from excite.robot.samples import Samples

Case = tuple[str, int, int, int]
CASES: tuple[Case, ...] = (  # robot, or joints/limbs; harmonics; samples; iterations
    ("two_link", 5, 100, 30),
    ("two_link", 100, 2100, 4),
    ("two_link", 5, 50_000, 4),
    ("ur10e", 5, 100, 30),
    ("ur10e", 5, 1000, 20),
    ("ur10e", 5, 5000, 8),
    ("ur10e", 20, 400, 15),
    ("ur10e", 50, 1000, 8),
    ("10/1", 5, 100, 20),
    ("20/4", 5, 100, 20),
    ("20/1", 5, 100, 15),
    ("30/5", 5, 100, 15),
    ("30/1", 5, 100, 10),
    ("30/5", 15, 300, 5),
    ("40/5", 5, 100, 8),
    ("60/5", 5, 100, 5),
    ("60/1", 5, 100, 4),
)
WHOLE = ("ur10e", "20/4", "40/5", "60/5")
ROWS = (("two_link", 1_000_000), ("ur10e", 1_000_000))
DIAGNOSED = (("two_link", 50_000), ("two_link", 300_000), ("ur10e", 50_000))


def source(robot: str, folder: Path) -> str:
    """Return the name of a built-in robot, or the path of a tree that is written for the case."""
    if "/" not in robot:
        return robot
    joints, limbs = map(int, robot.split("/"))
    path = folder / f"tree_{joints}_{limbs}.urdf"
    path.write_text(tree_urdf(joints, limbs), encoding="utf-8")
    return str(path)


def iteration(case: Case) -> dict[str, Any]:
    """Measure an iteration: processor time [s], memory of the process [bytes], and the sizes."""
    warnings.simplefilter("ignore", ExciteWarning)
    name, harmonics, samples, count = case
    with tempfile.TemporaryDirectory() as folder, threadpoolctl.threadpool_limits(1):
        robot = load(source(name, Path(folder)))
        table = limits.resolve(robot)
        request = time_budget.MotionRequest(None, harmonics, samples, None)
        options = request.complete(DesignOptions(starts=1), table)
        setup = optimize.set_up(robot, table, options)
        evaluator, rng = Evaluator(setup.problem), np.random.default_rng([0, 0])
        poses = initial_guess.find_static_poses(evaluator, rng)
        state = sqp.initial_state(initial_guess.scale_random_motion(evaluator, poses[0], rng))
        begun = time.process_time()
        state = sqp.advance(evaluator, state, sqp.History(), count)
        seconds = (time.process_time() - begun) / max(state.iterations, 1)
    n, P = robot.n, setup.problem.parameters.count
    return {
        "seconds": seconds,
        "memory": 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "n": n,
        "P": P,
        "p": setup.base.count,
        "V": n * (2 * harmonics + 1),
        "pairs": sum(len(list(way)) - 1 for way in list(robot.model.supports)[1:]),
        "expected": design_cost.estimated(robot, options).memory,
    }


def iterations() -> None:
    """Measure all cases, fit the coefficients of an iteration, and print both."""
    results = [_apart("iteration", case) for case in CASES]
    terms = []
    for (_, _, N, _), r in zip(CASES, results, strict=True):
        passes, products = N * r["n"] * r["P"], N * r["n"] * r["p"] ** 2
        terms.append([1.0, N * r["pairs"], passes, products, r["V"] ** 3])
    measured = np.array([r["seconds"] for r in results])
    weights = nnls(np.array(terms) / measured[:, None], np.ones(len(measured)))[0]
    stated = np.array(
        [
            design_cost.FIXED_TIME,
            design_cost.PAIR_TIME,
            design_cost.PASS_TIME,
            design_cost.PRODUCT_TIME,
            design_cost.SUBPROBLEM_TIME,
        ]
    )
    print(
        "| robot (joints/limbs) | harmonics | samples | iteration [s] | estimated | memory [MB] | "
        "estimated |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|")
    for (name, K, N, _), r, row in zip(CASES, results, terms, strict=True):
        print(
            f"| {name} | {K} | {N} | {r['seconds']:.3g} | {np.dot(row, stated):.3g} "
            f"| {r['memory'] / 1e6:.0f} | {r['expected'] / 1e6:.0f} |"
        )
    names = ("fixed", "per sample and pair", "per number", "per product", "per V³")
    print(
        "\nbest fit: "
        + ", ".join(f"{name} {w:.2g}" for name, w in zip(names, weights, strict=True))
    )


def whole() -> None:
    """Measure complete commands against their estimates, which they print."""
    print("\n| command | processor time [s] | largest process [MB] | what it said before |")
    print("|---|---:|---:|---|")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in WHOLE:
            urdf = source(name, folder)
            _command(
                f"design {name}", ["design", urdf, "--no-collision", "-o", str(folder / "out")]
            )
        for name, rows in ROWS:
            file = recording(name, rows, folder)
            _command(
                f"identify {name}, {rows} rows", ["identify", name, file, "-o", str(folder / "out")]
            )
        for name, rows in DIAGNOSED:
            both = recording(name, 2 * rows, folder)
            lines = Path(both).read_text(encoding="ascii").splitlines(keepends=True)
            parts = [folder / "a.csv", folder / "b.csv"]
            for part, chosen in zip(parts, (lines[1 : rows + 1], lines[rows + 1 :]), strict=True):
                part.write_text(lines[0] + "".join(chosen), encoding="ascii")
            words = ["diagnose", name, str(parts[0]), "--validate", str(parts[1]), "--no-report"]
            _command(f"diagnose {name}, 2 × {rows} rows", [*words, "-o", str(folder / "out")])


def recording(name: str, rows: int, folder: Path, rate: float = 1000.0) -> str:
    """Write a recording of a multisine motion with friction and white noise."""
    robot = load(name)
    standard = inertial_parameters.standard_parameters(robot, limits.resolve(robot))
    rng, t = np.random.default_rng(0), np.arange(rows) / rate
    q, dq, ddq = (np.zeros((rows, robot.n)) for _ in range(3))
    for k in range(1, 12):
        w, amplitude = (
            2.0 * np.pi * 0.07 * k * (1.0 + 0.013 * k),
            0.4 * rng.normal(size=robot.n) / k,
        )
        phase = w * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, robot.n)
        q += amplitude * np.sin(phase)
        dq += amplitude * w * np.cos(phase)
        ddq -= amplitude * w**2 * np.sin(phase)
    torque = dynamics.torque(robot, standard, Samples(q, dq, ddq)) + 0.05 * dq
    torque += 0.5 * np.tanh(dq / 0.01) + 0.05 * rng.normal(size=q.shape)
    header = ",".join(
        ["t", *(f"{kind}.{joint}" for kind in ("q", "tau") for joint in robot.joints)]
    )
    path = folder / f"{name}_{rows}.csv"
    np.savetxt(
        path, np.column_stack([t, q, torque]), fmt="%.9g", delimiter=",", header=header, comments=""
    )
    return str(path)


def _command(title: str, words: Sequence[str]) -> None:
    script = (
        "import resource, subprocess, sys, json\n"
        "done = subprocess.run([sys.executable, '-m', 'excite', *sys.argv[1:]], "
        "stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(json.dumps([done.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3, "
        "done.stderr]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=True
    )
    code, seconds, memory, said = json.loads(done.stdout)
    announced = next((line for line in said.splitlines() if "this takes" in line), "nothing")
    print(
        f"| {title}{'' if code == 0 else f' (exit code {code})'} | {seconds:.0f} | {memory:.0f} | "
        f"{announced} |",
        flush=True,
    )


def _apart(function: str, case: Case) -> dict[str, Any]:
    """Run a function of this file in a process of its own."""
    words = [sys.executable, __file__, "--run", function, json.dumps(case)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--whole", action="store_true", help="also measure complete commands")
    parser.add_argument("--run", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.run:
        print(json.dumps(iteration(tuple(json.loads(arguments.run[1])))))
        return
    iterations()
    if arguments.whole:
        whole()


if __name__ == "__main__":
    main()
