#!/usr/bin/env python
"""Measure how long a design takes and how good it is, on one thread: Markdown tables from one run.

1. Designs: time to the first feasible motion, to within 1 % of the final value and to the end;
   value; margin in the certificate.
2. The same task by figaroh in another interpreter (--peer PYTHON; peers/figaroh_design.py says how
   to install it).
3. Cost of objective, gradient and constraint Jacobian, in units of Pinocchio's bare regressor loop.
4. Growth of the cost with samples and joints.
5. The complete command against another checkout (--against DIR): every built-in robot, alternating,
   with the ratio of times.

The UR10 and most trees come from example-robot-data (robots.py says how to get it) and are left
out without it. Compiling of the dynamics in the background is waited for before anything is timed.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

# read when numpy is imported; the peer and all workers inherit it
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
import pinocchio as pin
from robots import source_of, wheel

from excite._types import FloatArray
from excite.designer import criteria, optimize, pipeline, sqp
from excite.designer.criteria import Criterion
from excite.designer.evaluator import Evaluator
from excite.designer.optimize import DesignSetup
from excite.designer.options import DesignOptions
from excite.designer.problem import DesignProblem
from excite.errors import ExciteError, ExciteWarning, UnusableInput
from excite.robot import dynamics, limits, robot
from excite.robot.limits import Limits
from excite.robot.robot import Robot
from excite.robot.samples import Samples
from excite.trajectory import trajectory_file

Job = tuple[Callable[[], FloatArray], Callable[[FloatArray], object]]
"""A function that returns the point to evaluate (untimed), and the evaluation (timed)."""
PEER = Path(__file__).resolve().parent / "peers" / "figaroh_design.py"
"""Script of the peer."""
PEER_ITERATIONS = 50
"""Iterations of IPOPT that the peer may take."""
COMPILE_TIMEOUT = 120.0
"""Time to wait for a compiler in the background [s]; after it, interpreted dynamics are timed."""
UR10 = "ur_description/urdf/ur10_robot.urdf"
"""URDF below example-robot-data."""
TREES: dict[str, tuple[str, ...]] = {
    "solo_description/robots/solo12.urdf": (),
    "baxter_description/urdf/baxter.urdf": (
        "head_pan",
        "l_gripper_l_finger_joint",
        "r_gripper_l_finger_joint",
    ),
    "tiago_pro_description/robots/tiago_pro.urdf": (),
    "talos_data/robots/talos_reduced.urdf": ("gripper_left_joint", "gripper_right_joint"),
    "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf": (),
}
"""URDFs of larger trees, with the joints that are locked (grippers, a head)."""
COSTED = ("UR10, κ", "Panda, A")
"""Cases of section 3."""
SAMPLES = (100, 200, 500, 1000, 2000, 5000, 10000)
"""Numbers of samples in section 4."""


def say(text: str) -> None:
    """Print a line to standard error."""
    print(text, file=sys.stderr, flush=True)


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> None:
    """Print a Markdown table under a heading; its first column is text, the others are numbers."""
    lines = ["| " + " | ".join(row) + " |" for row in (head, *rows)]
    lines.insert(1, "|---|" + "---:|" * (len(head) - 1))
    print(f"\n### {title}\n\n" + "\n".join(lines) + (f"\n\n{note}" if note else ""), flush=True)


def percent(share: float) -> str:
    """Return a share as a percentage."""
    return f"{round(100.0 * share, 2) + 0.0:.2f} %"  # + 0.0 avoids -0.00


def prepared(machine: Robot, table: Limits, options: DesignOptions) -> DesignSetup:
    """Build the problem and wait until its dynamics are compiled."""
    setting = optimize.set_up(machine, table, options)
    library, until = setting.problem.functions.library, time.perf_counter() + COMPILE_TIMEOUT
    while library is not None and not library.is_ready() and time.perf_counter() < until:
        time.sleep(0.1)
    return setting


def condition(problem: DesignProblem, samples: Samples) -> float:
    """Return `cond_regressor` of a motion's samples, by Pinocchio's regressor."""
    return float(
        np.linalg.cond(
            problem.weighting.rows(dynamics.regressor(problem.robot, problem.parameters, samples))
        )
    )


@dataclass
class Case:
    """A design problem and its designs.

    Attributes:
        name: Name in the tables.
        bounds: Symbols of the limits that bind.
        robot: The robot.
        limits: Its limits.
        options: Options of the design.
        done: One design for each seed that has one.
        failed: Messages of the seeds that failed.
        tightened: Whether the certificate asked for a larger reserve.
    """

    name: str
    bounds: str
    robot: Robot
    limits: Limits
    options: DesignOptions
    done: list[pipeline.CertifiedDesign] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    tightened: bool = False

    def run(self, seeds: int) -> None:
        """Design and certify once per seed."""
        prepared(self.robot, self.limits, self.options)
        for seed in range(seeds):
            say(f"{self.name}, seed {seed}")
            options, messages = dataclasses.replace(self.options, seed=seed), list[str]()
            try:
                self.done.append(
                    pipeline.design_trajectory(
                        self.robot, self.limits, options, progress=messages.append
                    )
                )
            except ExciteError as error:
                self.failed.append(str(error))
            self.tightened |= any("tightening" in text for text in messages)

    def values(self) -> list[float]:
        """Return the criterion of each design."""
        return [
            criteria.select_criterion(
                design.trajectory.criteria["optimum"], self.options.criterion, plain=False
            )
            for design in self.done
        ]

    def times(self, key: str) -> list[float]:
        """Return a time of each design [s]."""
        return [design.timing[key] for design in self.done]

    def cells(self) -> list[str]:
        """Return the row of the table."""
        if not self.done:
            return [self.name, self.bounds, *[""] * 5, f"no design: {self.failed[0]}"]
        columns = [
            (self.times(key), min, ".2f") for key in ("first_feasible", "within_1_percent", "solve")
        ]
        columns.append(
            (
                self.values(),
                max if self.options.criterion in criteria.MAXIMISED_CRITERIA else min,
                ".4g",
            )
        )
        counts = [len(design.design.attempts[0].history.time) - 1 for design in self.done]
        steps = f"{np.median(counts):.0f}" + "*" * self.tightened
        margin, owner = min(nearest(design) for design in self.done)
        numbers = [
            f"{np.median(values):{style}} ({best(values):{style}})"
            for values, best, style in columns
        ]
        return [
            self.name,
            self.bounds,
            *numbers,
            steps,
            f"{percent(margin)}, {owner}" + f"; {len(self.failed)} failed" * bool(self.failed),
        ]


def cases(folder: Path | None) -> Iterator[Case]:
    """Yield the peers' problem, and problems with all limits and parameters in the metric H₀."""
    bare = DesignOptions(
        criterion=Criterion.COND_REGRESSOR, drive=(), harmonics=5, uncertainty=0.0, starts=1
    )
    geometric = [
        DesignOptions(criterion=c, samples=200, starts=1)
        for c in (Criterion.A, Criterion.D, Criterion.E)
    ]
    if folder is not None:
        ur10 = robot.load(str(folder / UR10))
        full = limits.resolve(ur10)  # no acceleration or jerk limits are published
        yield Case(
            "UR10, κ", "q q̇ τ", ur10, full, dataclasses.replace(bare, period=12.0, samples=240)
        )
        yield from (Case(f"UR10, {o.criterion.name}", "q q̇ τ", ur10, full, o) for o in geometric)
    panda = robot.load("panda")
    full = limits.resolve(panda)
    # a thousand times the torque limit never binds
    kinematic = dataclasses.replace(full, jerk=np.full(panda.n, np.inf), torque=1e3 * full.torque)
    yield Case(
        "Panda, κ", "q q̇ q̈", panda, kinematic, dataclasses.replace(bare, period=10.0, samples=100)
    )
    bounds = "q q̇ q̈ q⃛ τ"
    yield from (Case(f"Panda, {o.criterion.name}", bounds, panda, full, o) for o in geometric)


def nearest(design: pipeline.CertifiedDesign) -> tuple[float, str]:
    """Return the smallest free share of a stated limit, and its name.

    Derived limits bind the ramps only, which always reach them.
    """
    margins = [
        m
        for m in design.certificate.margins
        if source_of(design.trajectory.limits, m) != limits.DERIVED
    ]
    worst = min(margins, key=lambda margin: margin.free_share)
    return worst.free_share, f"{worst.limit} of {worst.joint}"


def report_designs(problems: Sequence[Case]) -> None:
    """Print section 1."""
    head = [
        "problem",
        "limits",
        "first feasible [s]",
        "within 1 % [s]",
        "end, certified [s]",
        "value",
        "iterations",
        "nearest limit",
    ]
    note = "One start; median (best) over seeds. κ: `cond_regressor`, inertial parameters "
    note += "(Panda: no torque limits); A, D, E: geometric, all parameters, 200 samples, "
    note += "uncertainty 0.1. Nearest limit: the worst of all seeds, recomputed by Pinocchio."
    if any(case.tightened for case in problems):
        note += " *: the certificate asked for a larger reserve in some seed; "
        note += "its iterations are those after that."
    show("Designs", head, [case.cells() for case in problems], note)


def report_starts(problems: Sequence[Case], starts: int) -> None:
    """Print the best of many starts on all cores, and the distribution of all."""
    rows = []
    for case in problems:
        say(f"{case.name}, {starts} starts")
        design = pipeline.design_trajectory(
            case.robot, case.limits, dataclasses.replace(case.options, starts=starts)
        )
        feasible = [
            a.motion
            for a in design.design.attempts
            if min(a.history.worst) <= sqp.MAX_FEASIBLE_ROW_VALUE
        ]
        problem = design.design.setup.problem
        values = [
            condition(problem, motion.samples(motion.grid(case.options.samples)))
            for motion in feasible
        ]
        spread = [f"{value:.2f}" for value in np.quantile(values, (0.0, 0.25, 0.5, 0.75, 1.0))]
        rows.append(
            [
                case.name,
                str(len(feasible)),
                f"{design.timing['solve']:.1f}",
                *spread,
                percent(nearest(design)[0]),
            ]
        )
    head = [
        "problem",
        "feasible",
        "end, certified [s]",
        "best",
        "quartile",
        "median",
        "quartile",
        "worst",
        "margin of the best",
    ]
    show(f"The best of {starts} starts on {os.cpu_count()} cores", head, rows)


def run_peer(python: Path, urdf: Path, seed: int) -> dict[str, Any]:
    """Run the peer in its own process and return its result.

    Raises:
        UnusableInput: It failed; the message is the last line of its errors.
    """
    say(f"figaroh, seed {seed}")
    command = [
        str(python),
        str(PEER),
        str(urdf),
        "--iterations",
        str(PEER_ITERATIONS),
        "--seed",
        str(seed),
    ]
    try:
        process = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise UnusableInput(
            f"--peer {python}: {(getattr(error, 'stderr', '') or str(error)).splitlines()[-1]}"
        ) from error
    return dict(json.loads(process.stdout))


def evaluate_peer(case: Case, result: Mapping[str, Any]) -> tuple[float, float]:
    """Return the peer's `cond_regressor` by our definition, and its nearest limit's free share.

    The limits are checked on a grid ten times denser than the peer's own.
    """
    problem, table = optimize.set_up(case.robot, case.limits, case.options).problem, case.limits
    peer_samples, dense = (
        Samples(*(np.array(part) for part in result[grid])) for grid in ("own", "dense")
    )
    torque = dynamics.regressor(case.robot, problem.parameters, dense) @ problem.parameters.nominal
    lower, upper = table.position.T
    relative = (
        (2.0 * dense.q - lower - upper) / (upper - lower),
        dense.dq / table.velocity,
        torque / table.torque,
    )
    return condition(problem, peer_samples), 1.0 - max(
        float(np.abs(part).max()) for part in relative
    )


def time_to_value(design: pipeline.CertifiedDesign, value: float) -> float:
    """Return the time until a design reached a value [s]; infinite if never.

    The objective is the smooth logarithm of the squared value.
    """
    best = design.design.attempts[0]
    history = zip(best.time, best.values, best.worst, strict=True)
    return min(
        (
            at
            for at, v, worst in history
            if worst <= sqp.MAX_FEASIBLE_ROW_VALUE and v <= 2.0 * np.log(value)
        ),
        default=np.inf,
    )


def report_peer(case: Case, python: Path, urdf: Path, seeds: int) -> None:
    """Print section 2."""
    peers = [run_peer(python, urdf, seed) for seed in range(seeds)]
    solved = [peer for peer in peers if peer["solved"]]
    title, note = (
        f"The same by figaroh {peers[0]['figaroh']}",
        f"{len(solved)} of {seeds} of its runs ended with a feasible motion.",
    )
    if not solved or not case.done:
        print(f"\n### {title}\n\n{note}", flush=True)
        return
    values, shares = zip(*(evaluate_peer(case, peer) for peer in solved), strict=True)
    within = [
        next(
            (at for at, v, ok in peer["history"] if ok and v <= 1.01 * peer["value"]),
            peer["seconds"],
        )
        for peer in solved
    ]
    ends, middle = [peer["seconds"] for peer in solved], float(np.median(values))
    compared: dict[str, tuple[Sequence[float], Sequence[float]]] = {
        "to the first feasible motion [s]": (
            [peer["guess"] for peer in solved],
            case.times("first_feasible"),
        ),
        "to within 1 % of its own end [s]": (within, case.times("within_1_percent")),
        "to the end [s]": (ends, case.times("solve")),
        "to what figaroh ends with [s]": (
            ends,
            [time_to_value(design, middle) for design in case.done],
        ),
        "`cond_regressor`, 12 s at 20 Hz": (values, case.values()),
    }
    rows = []
    for name, pair in compared.items():
        cells = [f"{np.median(numbers):.3g} ({min(numbers):.3g})" for numbers in pair]
        rows.append([name, *cells, f"{np.median(pair[0]) / np.median(pair[1]):.3g}"])
    rows.append(
        [
            "nearest limit, ten times denser",
            percent(min(shares)),
            percent(min(nearest(design)[0] for design in case.done)),
            "",
        ]
    )
    note += f" Median (best) over seeds; {PEER_ITERATIONS} iterations of IPOPT, "
    note += "its search for base parameters not counted. On the columns that figaroh picks, "
    picked = float(np.median([peer["value"] for peer in solved]))
    note += f"its condition number is {picked:.3g}."
    show(title, ["UR10, κ", "figaroh", "excite", "ratio"], rows, note)


def fastest(jobs: Mapping[str, Job], seconds: float) -> dict[str, float]:
    """Return the least time of each job [s].

    Jobs alternate for some time and at least four times, because the first runs load and allocate.
    """
    best, until, turns = dict.fromkeys(jobs, np.inf), time.perf_counter() + seconds, 0
    while time.perf_counter() < until or (turns := turns + 1) <= 4:
        for name, (at, work) in jobs.items():
            x = at()
            began = time.perf_counter()
            work(x)
            best[name] = min(best[name], time.perf_counter() - began)
    return best


def loop(machine: Robot, motion: Samples) -> None:
    """Evaluate Pinocchio's regressor at every sample, with as little Python as possible."""
    model, data, compute = (
        machine.model,
        machine.model.createData(),
        pin.computeJointTorqueRegressor,
    )
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        compute(model, data, q, dq, ddq)


def costs(case: Case) -> dict[str, tuple[float, int]]:
    """Return least time [s] and number of rows of each quantity at the optimum.

    Rows are those that the solver evaluates there.
    """
    problem, motion = case.done[0].design.setup.problem, case.done[0].trajectory.motion.fourier
    evaluator, optimum, rng = (
        Evaluator(problem),
        problem.variables(motion),
        np.random.default_rng(0),
    )
    samples, sharpness = (
        motion.samples(motion.grid(case.options.samples)),
        sqp.sharpness_stages(case.options.criterion)[-1],
    )
    Y = dynamics.regressor(problem.robot, problem.parameters, samples)
    rows = evaluator.rows(optimum, evaluator.rows_above(optimum, 1.0 - sqp.WORKING_SET_BAND))
    torque = np.array(evaluator.kinds)[rows.kind] == "torque"
    all_torque_rows = evaluator.rows(
        optimum,
        np.concatenate(
            [
                np.full(v.size, k == "torque")
                for k, v in evaluator.constraint_values(optimum).items()
            ]
        ),
    )

    def fresh() -> FloatArray:
        return optimum + 1e-9 * rng.normal(
            size=optimum.shape
        )  # the evaluator remembers its last point

    def evaluated() -> FloatArray:
        evaluator.objective(x := fresh(), sharpness)
        evaluator.max_constraint_value(x)
        return x

    parts = {
        "Jacobian: torque near its limit": rows.subset(np.flatnonzero(torque)),
        "kinematic rows near theirs": rows.subset(np.flatnonzero(~torque)),
        "both": rows,
    }
    parts["every torque row, for comparison"] = all_torque_rows
    weigh, criterion = problem.weighting.rows, case.options.criterion
    jobs: dict[str, Job] = {
        "bare regressor loop": (fresh, lambda x: loop(problem.robot, samples)),
        "objective and all row values": (
            fresh,
            lambda x: (
                evaluator.constraint_values(x),
                criteria.smooth_objective(criterion, weigh(Y), sharpness),
            ),
        ),
        "objective and gradient": (fresh, lambda x: evaluator.objective(x, sharpness)),
        **{
            name: (evaluated, functools.partial(evaluator.row_gradients, rows=part))
            for name, part in parts.items()
        },
    }
    return {
        name: (seconds, len(parts[name]) if name in parts else -1)
        for name, seconds in fastest(jobs, 3.0).items()
    }


def report_costs(measured: Mapping[str, Mapping[str, tuple[float, int]]]) -> None:
    """Print section 3."""
    rows = []
    for quantity in next(iter(measured.values())):
        row = [quantity]
        for times in measured.values():
            seconds, count = times[quantity]
            row += [
                f"{1e3 * seconds:.2f}" + f" ({count} rows)" * (count >= 0),
                f"{seconds / times['bare regressor loop'][0]:.2f}",
            ]
        rows.append(row)
    head = ["", *(cell for name in measured for cell in (f"{name} [ms]", "over the loop"))]
    note = f"Near: above {1.0 - sqp.WORKING_SET_BAND:g} of the limit at the optimum, "
    note += "as the solver evaluates them; there the objective is known already."
    show("Cost of one evaluation", head, rows, note)


def grown(machine: Robot, samples: int) -> tuple[float, float]:
    """Return milliseconds per objective with gradient, and per iteration of the solver."""
    say(f"{machine.name}: {machine.n} joints, {samples} samples")
    setting = prepared(
        machine, limits.resolve(machine), DesignOptions(samples=samples, starts=1, iterations=8)
    )
    design = optimize.solve(setting)
    evaluator, x, rng = (
        Evaluator(setting.problem),
        setting.problem.variables(design.motion),
        np.random.default_rng(0),
    )
    work: Job = lambda: x + 1e-9 * rng.normal(size=x.shape), lambda y: evaluator.objective(y, 1.0)
    return 1e3 * fastest({"": work}, 0.5)[""], 1e3 * float(
        np.median(np.diff(design.attempts[0].history.time))
    )


def report_growth(folder: Path | None, plot: Path | None) -> None:
    """Print section 4 and draw its figure."""
    trees = [robot.load(name) for name in ("two_link", "ur10e", "panda")]
    trees += [
        robot.load(str(folder / name), lock=dict.fromkeys(locked, 0.0))
        for name, locked in TREES.items()
        if folder
    ]
    samples, joints = (
        [(count, *grown(trees[1], count)) for count in SAMPLES],
        [(tree.n, *grown(tree, 100)) for tree in trees],
    )
    head = ["objective and gradient [ms]", "iteration [ms]"]
    show(
        "Growth with samples (ur10e)",
        ["samples", *head],
        [[str(at), f"{f:.2f}", f"{step:.1f}"] for at, f, step in samples],
    )
    note = "Geometric A, all limits and parameters, 5 harmonics, one start; "
    note += "median of the first 8 iterations."
    rows = [
        [tree.name, str(at), f"{f:.2f}", f"{step:.1f}"]
        for tree, (at, f, step) in zip(trees, joints, strict=True)
    ]
    show("Growth with joints (100 samples)", ["robot", "joints", *head], rows, note)
    if plot is not None:
        draw({"samples (ur10e, 6 joints)": samples, "joints (100 samples)": joints}, plot)


def draw(growths: Mapping[str, Sequence[tuple[int, float, float]]], file: Path) -> None:
    """Draw both growths on logarithmic axes, with grey lines of slope 1."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    labels = (
        ("#1f5f9e", "objective and gradient", (9, -12), "left"),
        ("#b03030", "one solver iteration", (-9, 9), "right"),
    )
    for axis, (label, points) in zip(
        figure.subplots(1, 2, sharey=True), growths.items(), strict=True
    ):
        sizes, *curves = np.array(points).T
        for times, (color, text, shift, side) in zip(curves, labels, strict=True):
            axis.loglog(sizes, times, "o-", markersize=4, linewidth=1.3, color=color)
            axis.loglog(sizes, times[0] * sizes / sizes[0], color="0.75", linewidth=0.8, zorder=0)
            place = sizes[len(sizes) // 2], times[len(sizes) // 2]
            axis.annotate(
                text, place, shift, textcoords="offset points", ha=side, color=color, fontsize=9
            )
        axis.set(xlabel=label, xticks=sizes, xticklabels=[f"{value:g}" for value in sizes])
        axis.yaxis.set_major_formatter("{x:g}")
        axis.minorticks_off()
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("time [ms]")
    figure.axes[1].annotate(
        "grey: slope 1", (1.0, 0.02), xycoords="axes fraction", ha="right", color="0.5", fontsize=8
    )
    figure.savefig(file, metadata={"Date": None} if file.suffix == ".svg" else None)


def command_time(checkout: Path, name: str, seed: int) -> tuple[float, float]:
    """Time `excite design` of a checkout: its search [s] and the process [s]."""
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve())}
    with tempfile.TemporaryDirectory() as folder:
        words = [
            "design",
            name,
            "-o",
            f"{folder}/out",
            "--seed",
            str(seed),
            "--jobs",
            "1",
            "--json",
        ]
        begun = time.perf_counter()
        process = subprocess.run(
            [sys.executable, "-m", "excite", *words],
            env=environment,
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
        return float(json.loads(process.stdout)["timing"]["solve"]), time.perf_counter() - begun


def report_against(other: Path, seeds: int) -> None:
    """Print section 5: `excite design` of this checkout and of another, alternating."""
    here = Path(__file__).resolve().parent.parent
    print(
        f"\n## `excite design`: here over {other}\n\n"
        "| robot | search here [s] | there [s] | ratio | process ratio |\n|---|---|---|---|---|"
    )
    ratios_of_all: list[tuple[float, float]] = []
    for name in robot.builtin_names():
        pairs = []
        for seed in range(seeds + 1):
            pair = [
                command_time(checkout, name, seed)
                for checkout in ((here, other) if seed % 2 else (other, here))
            ]
            here_times, there_times = pair if seed % 2 else pair[::-1]
            if seed:  # the first fills the cache of compiled dynamics
                pairs.append((here_times, there_times))
        search = [here_times[0] / there_times[0] for here_times, there_times in pairs]
        process = [here_times[1] / there_times[1] for here_times, there_times in pairs]
        ratios_of_all += zip(search, process, strict=True)
        middle = [float(np.median([times[k][0] for times in pairs])) for k in (0, 1)]
        print(
            f"| {name} | {middle[0]:.2f} | {middle[1]:.2f} "
            f"| {np.median(search):.2f} | {np.median(process):.2f} |",
            flush=True,
        )
    ratios = np.median(np.array(ratios_of_all), axis=0)
    total = np.exp(np.log(np.array(ratios_of_all)).mean(axis=0))
    print(
        f"| all | | | {ratios[0]:.2f} (geometric mean {total[0]:.2f}) "
        f"| {ratios[1]:.2f} ({total[1]:.2f}) |"
    )


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        help="example-robot-data: its unpacked wheel or folder of robots",
    )
    parser.add_argument("--only", default="1,2,3,4", metavar="N,…", help="these sections alone")
    parser.add_argument(
        "--seeds", type=int, default=3, help="designs per problem (default %(default)s)"
    )
    parser.add_argument(
        "--starts",
        type=int,
        default=0,
        help="also the best of so many starts, on all cores (section 1)",
    )
    parser.add_argument(
        "--peer", type=Path, metavar="PYTHON", help="interpreter that has figaroh (section 2)"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw section 4")
    parser.add_argument(
        "--against",
        type=Path,
        metavar="DIR",
        help="another checkout of excite (section 5, then alone)",
    )
    return parser.parse_args()


def report(given: argparse.Namespace) -> None:
    """Print the sections that were asked for."""
    if given.against is not None:
        report_against(given.against, given.seeds)
        return
    sections = given.only.split(",")
    if (
        not set(sections) <= set("1234")
        or given.seeds < 1
        or given.starts < 0
        or (given.plot and "4" not in sections)
    ):
        raise UnusableInput(
            "--only takes 1 to 4 with commas between, --seeds 1 or more, --starts 0 or more, "
            "--plot section 4"
        )
    folder = wheel(given.data)
    if folder is None:
        say(
            "example-robot-data is not installed and no --data is given: "
            "UR10 and most trees are left out"
        )
    print(
        ", ".join(
            f"{name} {version}" for name, version in trajectory_file.package_versions().items()
        )
        + f"; {os.cpu_count()} cores, BLAS on one"
    )
    problems = {case.name: case for case in cases(folder)}
    for case in problems.values():
        if (
            "1" in sections
            or ("3" in sections and case.name in COSTED)
            or ("2" in sections and given.peer and case.name == "UR10, κ")
        ):
            case.run(given.seeds)
    if "1" in sections:
        report_designs(list(problems.values()))
    if "1" in sections and given.starts:
        report_starts([case for name, case in problems.items() if name.endswith("κ")], given.starts)
    if "2" in sections and given.peer and folder:
        report_peer(problems["UR10, κ"], given.peer, folder / UR10, given.seeds)
    elif "2" in sections:
        print("\nfigaroh: not compared; --peer names an interpreter that has it, --data the UR10")
    if "3" in sections and (
        costed := [case for case in problems.values() if case.name in COSTED and case.done]
    ):
        report_costs({case.name: costs(case) for case in costed})
    if "4" in sections:
        report_growth(folder, given.plot)


def main() -> int:
    """Run the benchmark; return the exit code."""
    warnings.simplefilter("ignore", ExciteWarning)
    given = parse_arguments()
    try:
        report(given)
    except (ExciteError, OSError, SystemExit) as error:  # the last is what robots.wheel raises
        say(f"bench_design: {error}")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
