#!/usr/bin/env python
"""How long a design takes and how good it is, on one thread: Markdown tables, all from one run.

1. Designs: time to the first feasible motion, to within 1 % of the final value and to the end; value; margin in the certificate.
2. The same work by figaroh, run by another interpreter (--peer PYTHON; peers/figaroh_design.py says how to install it).
3. The cost of objective, gradient and constraint Jacobian in Pinocchio's own regressor loops.
4. How the cost grows with samples and joints.
5. The whole command against another checkout (--against DIR): every built-in robot, in turn, with the ratio of times.

UR10 and most trees come from example-robot-data (robots.py says how to get it); without it they are left out. The dynamics
may be compiled in the background: that is waited for before anything is timed.
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

os.environ["OMP_NUM_THREADS"] = (
    "1"  # read when numpy is imported; the peer and all workers inherit it
)
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
import pinocchio as pin
from robots import source_of, wheel

from excite.designer import criteria, optimize, pipeline, sqp
from excite.designer.criteria import Criterion
from excite.designer.evaluator import ConstraintRows, Evaluator
from excite.designer.optimize import DesignSetup
from excite.designer.problem import DesignProblem
from excite.designer.options import DesignOptions
from excite.errors import ExciteError, ExciteWarning, UnusableInput
from excite.robot import dynamics, limits, robot
from excite.robot.limits import Limits
from excite.robot.robot import Robot
from excite.robot.samples import Samples
from excite.trajectory import trajectory_file

Array = np.ndarray
Job = tuple[
    Callable[[], Array], Callable[[Array], object]
]  # untimed: the point to work at; timed: the work there
PEER = Path(__file__).resolve().parent / "peers" / "figaroh_design.py"
PEER_ITERATIONS = 50
PATIENCE = 120.0  # seconds to wait for a compiler in the background; after that the virtual machine is timed
UR10 = "ur_description/urdf/ur10_robot.urdf"
TREES: dict[
    str, tuple[str, ...]
] = {  # with the joints that are locked: grippers, and a head beside two arms
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
COSTED = ("UR10, κ", "Panda, A")
SAMPLES = (100, 200, 500, 1000, 2000, 5000, 10000)


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> None:
    """Print a Markdown table under a heading; its first column is text, the others are numbers."""
    lines = ["| " + " | ".join(row) + " |" for row in (head, *rows)]
    lines.insert(1, "|---|" + "---:|" * (len(head) - 1))
    print(f"\n### {title}\n\n" + "\n".join(lines) + (f"\n\n{note}" if note else ""), flush=True)


def percent(share: float) -> str:
    return f"{round(100.0 * share, 2) + 0.0:.2f} %"  # no -0.00


def prepared(machine: Robot, table: Limits, options: DesignOptions) -> DesignSetup:
    """The built problem, with its dynamics compiled if they are going to be."""
    setting = optimize.set_up(machine, table, options)
    library, until = setting.problem.functions.library, time.perf_counter() + PATIENCE
    while library is not None and not library.is_ready() and time.perf_counter() < until:
        time.sleep(0.1)
    return setting


def condition(problem: DesignProblem, samples: Samples) -> float:
    """`cond_regressor` of a motion's samples, by Pinocchio's regressor."""
    return float(
        np.linalg.cond(
            problem.weighting.rows(dynamics.regressor(problem.robot, problem.parameters, samples))
        )
    )


@dataclass
class Case:
    """A design problem and what came of it. bounds: the kinds of limits. done: one design per seed that has one."""

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
            options, said = dataclasses.replace(self.options, seed=seed), list[str]()
            try:
                self.done.append(
                    pipeline.design_trajectory(self.robot, self.limits, options, progress=said.append)
                )
            except ExciteError as error:
                self.failed.append(str(error))
            self.tightened |= any("tightening" in text for text in said)

    def values(self) -> list[float]:
        return [
            criteria.select_criterion(one.trajectory.criteria["optimum"], self.options.criterion, plain=False)
            for one in self.done
        ]

    def times(self, key: str) -> list[float]:
        return [one.timing[key] for one in self.done]

    def cells(self) -> list[str]:
        """Its row of the table."""
        if not self.done:
            return [self.name, self.bounds, *[""] * 5, f"no design: {self.failed[0]}"]
        columns = [
            (self.times(key), min, ".2f") for key in ("first_feasible", "within_1_percent", "solve")
        ]
        columns.append(
            (self.values(), max if self.options.criterion in criteria.MAXIMISED_CRITERIA else min, ".4g")
        )
        steps = (
            f"{np.median([len(one.design.attempts[0].time) - 1 for one in self.done]):.0f}"
            + "*" * self.tightened
        )
        room, whose = min(nearest(one) for one in self.done)
        numbers = [
            f"{np.median(values):{style}} ({best(values):{style}})"
            for values, best, style in columns
        ]
        return [
            self.name,
            self.bounds,
            *numbers,
            steps,
            f"{percent(room)}, {whose}" + f"; {len(self.failed)} failed" * bool(self.failed),
        ]


def cases(folder: Path | None) -> Iterator[Case]:
    """The problems: the peers' own, and all limits and parameters in the metric."""
    bare = DesignOptions(
        criterion=Criterion.COND_REGRESSOR, drive=(), harmonics=5, uncertainty=0.0, starts=1
    )
    geometric = [
        DesignOptions(criterion=c, samples=200, starts=1) for c in (Criterion.A, Criterion.D, Criterion.E)
    ]
    if folder is not None:
        ur10 = robot.load(str(folder / UR10))
        full = limits.resolve(ur10)  # neither its URDF nor its maker states acceleration or jerk
        yield Case(
            "UR10, κ", "q q̇ τ", ur10, full, dataclasses.replace(bare, period=12.0, samples=240)
        )
        yield from (Case(f"UR10, {o.criterion.name}", "q q̇ τ", ur10, full, o) for o in geometric)
    panda = robot.load("panda")
    full = limits.resolve(panda)
    # Torque at a thousand times its limit is as good as none.
    kinematic = dataclasses.replace(full, jerk=np.full(panda.n, np.inf), torque=1e3 * full.torque)
    yield Case(
        "Panda, κ", "q q̇ q̈", panda, kinematic, dataclasses.replace(bare, period=10.0, samples=100)
    )
    yield from (Case(f"Panda, {o.criterion.name}", "q q̇ q̈ q⃛ τ", panda, full, o) for o in geometric)


def nearest(one: pipeline.CertifiedDesign) -> tuple[float, str]:
    """The smallest share of a stated limit that is left, and whose. Derived limits bind ramps only, which run up to them."""
    own = [
        m for m in one.certificate.margins if source_of(one.trajectory.limits, m) != limits.DERIVED
    ]
    worst = min(own, key=lambda margin: margin.free_share)
    return worst.free_share, f"{worst.limit} of {worst.joint}"


def report_designs(problems: Sequence[Case]) -> None:
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
    note = "One start; median (best) over seeds. κ: `cond_regressor`, inertial parameters (Panda: no torque limits); A, D, E: "
    note += "geometric, all parameters, 200 samples, uncertainty 0.1. Nearest limit: the worst of all seeds, recomputed by Pinocchio."
    if any(case.tightened for case in problems):
        note += " *: the certificate asked for a larger reserve in some seed; its iterations are those after that."
    show("Designs", head, [case.cells() for case in problems], note)


def report_starts(problems: Sequence[Case], starts: int) -> None:
    """The best of many starts on all cores, and what the others found."""
    rows = []
    for case in problems:
        say(f"{case.name}, {starts} starts")
        one = pipeline.design_trajectory(
            case.robot, case.limits, dataclasses.replace(case.options, starts=starts)
        )
        feasible = [a.motion for a in one.design.attempts if min(a.worst) <= sqp.MAX_FEASIBLE_ROW_VALUE]
        problem = one.design.setup.problem
        found = [
            condition(problem, motion.samples(motion.grid(case.options.samples)))
            for motion in feasible
        ]
        spread = [f"{value:.2f}" for value in np.quantile(found, (0.0, 0.25, 0.5, 0.75, 1.0))]
        rows.append(
            [
                case.name,
                str(len(feasible)),
                f"{one.timing['solve']:.1f}",
                *spread,
                percent(nearest(one)[0]),
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


def asked(python: Path, urdf: Path, seed: int) -> dict[str, Any]:
    """What figaroh found in its own process; UnusableInput with the last line of what went wrong there."""
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
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise UnusableInput(
            f"--peer {python}: {(getattr(error, 'stderr', '') or str(error)).splitlines()[-1]}"
        ) from error
    return dict(json.loads(done.stdout))


def judged(case: Case, found: Mapping[str, Any]) -> tuple[float, float]:
    """`cond_regressor` of the peer's samples by our definition, and the share left of its nearest limit ten times denser."""
    problem, table = optimize.set_up(case.robot, case.limits, case.options).problem, case.limits
    own, dense = (Samples(*(np.array(part) for part in found[grid])) for grid in ("own", "dense"))
    torque = dynamics.regressor(case.robot, problem.parameters, dense) @ problem.parameters.nominal
    lower, upper = table.position.T
    used = (
        (2.0 * dense.q - lower - upper) / (upper - lower),
        dense.dq / table.velocity,
        torque / table.torque,
    )
    return condition(problem, own), 1.0 - max(float(np.abs(part).max()) for part in used)


def reaching(one: pipeline.CertifiedDesign, value: float) -> float:
    """Seconds until a design was as good as `value`, infinite if never; its objective is the smooth log of the square."""
    best = one.design.attempts[0]
    history = zip(best.time, best.values, best.worst, strict=True)
    return min(
        (at for at, v, worst in history if worst <= sqp.MAX_FEASIBLE_ROW_VALUE and v <= 2.0 * np.log(value)),
        default=np.inf,
    )


def report_peer(case: Case, python: Path, urdf: Path, seeds: int) -> None:
    """figaroh's motion for the same robot, duration, rate and limits."""
    peers = [asked(python, urdf, seed) for seed in range(seeds)]
    done = [peer for peer in peers if peer["solved"]]
    title, note = (
        f"The same by figaroh {peers[0]['figaroh']}",
        f"{len(done)} of {seeds} of its runs ended with a feasible motion.",
    )
    if not done or not case.done:
        print(f"\n### {title}\n\n{note}", flush=True)
        return
    values, shares = zip(*(judged(case, peer) for peer in done), strict=True)
    within = [
        next(
            (at for at, v, ok in peer["history"] if ok and v <= 1.01 * peer["value"]),
            peer["seconds"],
        )
        for peer in done
    ]
    ends, middle = [peer["seconds"] for peer in done], float(np.median(values))
    compared: dict[str, tuple[Sequence[float], Sequence[float]]] = {
        "to the first feasible motion [s]": (
            [peer["guess"] for peer in done],
            case.times("first_feasible"),
        ),
        "to within 1 % of its own end [s]": (within, case.times("within_1_percent")),
        "to the end [s]": (ends, case.times("solve")),
        "to what figaroh ends with [s]": (ends, [reaching(one, middle) for one in case.done]),
        "`cond_regressor`, 12 s at 20 Hz": (values, case.values()),
    }
    rows = []
    for name, both in compared.items():
        cells = [f"{np.median(numbers):.3g} ({min(numbers):.3g})" for numbers in both]
        rows.append([name, *cells, f"{np.median(both[0]) / np.median(both[1]):.3g}"])
    rows.append(
        [
            "nearest limit, ten times denser",
            percent(min(shares)),
            percent(min(nearest(one)[0] for one in case.done)),
            "",
        ]
    )
    note += f" Median (best) over seeds; {PEER_ITERATIONS} iterations of IPOPT, its search for base parameters not counted. "
    note += f"On the columns that figaroh picks, its condition number is {np.median([peer['value'] for peer in done]):.3g}."
    show(title, ["UR10, κ", "figaroh", "excite", "ratio"], rows, note)


def fastest(jobs: Mapping[str, Job], seconds: float) -> dict[str, float]:
    """The least time of each job, taken in turns for so many seconds and at least four times: the first ones load and allocate."""
    best, until, turns = dict.fromkeys(jobs, np.inf), time.perf_counter() + seconds, 0
    while time.perf_counter() < until or (turns := turns + 1) <= 4:
        for name, (at, work) in jobs.items():
            x = at()
            began = time.perf_counter()
            work(x)
            best[name] = min(best[name], time.perf_counter() - began)
    return best


def loop(machine: Robot, motion: Samples) -> None:
    """Pinocchio's regressor at every sample, as bare as Python allows."""
    model, data, compute = (
        machine.model,
        machine.model.createData(),
        pin.computeJointTorqueRegressor,
    )
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        compute(model, data, q, dq, ddq)


def costs(case: Case) -> dict[str, tuple[float, int]]:
    """Per quantity its least time [s] and how many rows it has, at the optimum, as the solver asks for it."""
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
    rows = evaluator.rows(evaluator.rows_above(optimum, 1.0 - sqp.WORKING_SET_BAND))
    torque = np.array(evaluator.kinds)[rows.kind] == "torque"
    everywhere = evaluator.rows(
        np.concatenate(
            [np.full(v.size, k == "torque") for k, v in evaluator.constraint_values(optimum).items()]
        )
    )

    def fresh() -> Array:
        return optimum + 1e-9 * rng.normal(
            size=optimum.shape
        )  # the evaluator remembers its last point

    def known() -> Array:
        evaluator.objective(x := fresh(), sharpness)
        evaluator.max_constraint_value(x)
        return x

    def some(which: Array) -> ConstraintRows:
        return ConstraintRows(*(getattr(rows, f.name)[which] for f in dataclasses.fields(ConstraintRows)))

    parts = {
        "Jacobian: torque near its limit": some(torque),
        "kinematic rows near theirs": some(~torque),
        "both": rows,
    }
    parts["every torque row, for comparison"] = everywhere
    weigh, criterion = problem.weighting.rows, case.options.criterion
    jobs: dict[str, Job] = {
        "bare regressor loop": (fresh, lambda x: loop(problem.robot, samples)),
        "objective and all row values": (
            fresh,
            lambda x: (evaluator.constraint_values(x), criteria.smooth_objective(criterion, weigh(Y), sharpness)),
        ),
        "objective and gradient": (fresh, lambda x: evaluator.objective(x, sharpness)),
        **{
            name: (known, functools.partial(evaluator.row_gradients, rows=part))
            for name, part in parts.items()
        },
    }
    return {
        name: (seconds, len(parts[name]) if name in parts else -1)
        for name, seconds in fastest(jobs, 3.0).items()
    }


def report_costs(measured: Mapping[str, Mapping[str, tuple[float, int]]]) -> None:
    rows = []
    for quantity in next(iter(measured.values())):
        row = [quantity]
        for one in measured.values():
            seconds, count = one[quantity]
            row += [
                f"{1e3 * seconds:.2f}" + f" ({count} rows)" * (count >= 0),
                f"{seconds / one['bare regressor loop'][0]:.2f}",
            ]
        rows.append(row)
    head = ["", *(cell for name in measured for cell in (f"{name} [ms]", "over the loop"))]
    note = f"Near: above {1.0 - sqp.WORKING_SET_BAND:g} of the limit at the optimum, as the solver asks; there the objective is known already."
    show("Cost of one evaluation", head, rows, note)


def grown(machine: Robot, samples: int) -> tuple[float, float]:
    """Milliseconds per objective and gradient and per iteration of the solver."""
    say(f"{machine.name}: {machine.n} joints, {samples} samples")
    setting = prepared(
        machine, limits.resolve(machine), DesignOptions(samples=samples, starts=1, iterations=8)
    )
    found = optimize.solve(setting)
    evaluator, x, rng = (
        Evaluator(setting.problem),
        setting.problem.variables(found.motion),
        np.random.default_rng(0),
    )
    work: Job = lambda: x + 1e-9 * rng.normal(size=x.shape), lambda y: evaluator.objective(y, 1.0)
    return 1e3 * fastest({"": work}, 0.5)[""], 1e3 * float(
        np.median(np.diff(found.attempts[0].time))
    )


def report_growth(folder: Path | None, plot: Path | None) -> None:
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
    note = "Geometric A, all limits and parameters, 5 harmonics, one start; median of the first 8 iterations."
    rows = [
        [tree.name, str(at), f"{f:.2f}", f"{step:.1f}"]
        for tree, (at, f, step) in zip(trees, joints, strict=True)
    ]
    show("Growth with joints (100 samples)", ["robot", "joints", *head], rows, note)
    if plot is not None:
        draw({"samples (ur10e, 6 joints)": samples, "joints (100 samples)": joints}, plot)


def draw(growths: Mapping[str, Sequence[tuple[int, float, float]]], file: Path) -> None:
    """Each growth on logarithmic axes; grey lines have slope 1."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    labels = (
        ("#1f5f9e", "objective and gradient", (9, -12), "left"),
        ("#b03030", "one solver iteration", (-9, 9), "right"),
    )
    for axis, (label, ones) in zip(
        figure.subplots(1, 2, sharey=True), growths.items(), strict=True
    ):
        at, *curves = np.array(ones).T
        for times, (color, text, shift, side) in zip(curves, labels, strict=True):
            axis.loglog(at, times, "o-", markersize=4, linewidth=1.3, color=color)
            axis.loglog(at, times[0] * at / at[0], color="0.75", linewidth=0.8, zorder=0)
            place = at[len(at) // 2], times[len(at) // 2]
            axis.annotate(
                text, place, shift, textcoords="offset points", ha=side, color=color, fontsize=9
            )
        axis.set(xlabel=label, xticks=at, xticklabels=[f"{value:g}" for value in at])
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
    """Time of the command's search [s] and of the process [s]: `excite design` of a built-in robot, by a checkout's own code."""
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
        done = subprocess.run(
            [sys.executable, "-m", "excite", *words],
            env=environment,
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
        return float(json.loads(done.stdout)["timing"]["solve"]), time.perf_counter() - begun


def report_against(other: Path, seeds: int) -> None:
    """Time `excite design` of this checkout and of another, in turn, and print the median ratios."""
    here = Path(__file__).resolve().parent.parent
    print(
        f"\n## `excite design`: here over {other}\n\n| robot | search here [s] | there [s] | ratio | process ratio |\n|---|---|---|---|---|"
    )
    every: list[tuple[float, float]] = []
    for name in robot.builtin_names():
        pairs = []
        for seed in range(seeds + 1):
            both = [
                command_time(checkout, name, seed)
                for checkout in ((here, other) if seed % 2 else (other, here))
            ]
            mine, theirs = both if seed % 2 else both[::-1]
            if seed:  # the first fills the cache of compiled dynamics
                pairs.append((mine, theirs))
        search = [mine[0] / theirs[0] for mine, theirs in pairs]
        process = [mine[1] / theirs[1] for mine, theirs in pairs]
        every += zip(search, process, strict=True)
        middle = [float(np.median([times[k][0] for times in pairs])) for k in (0, 1)]
        print(
            f"| {name} | {middle[0]:.2f} | {middle[1]:.2f} | {np.median(search):.2f} | {np.median(process):.2f} |",
            flush=True,
        )
    ratios = np.median(np.array(every), axis=0)
    total = np.exp(np.log(np.array(every)).mean(axis=0))
    print(
        f"| all | | | {ratios[0]:.2f} (geometric mean {total[0]:.2f}) | {ratios[1]:.2f} ({total[1]:.2f}) |"
    )


def arguments() -> argparse.Namespace:
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
            "--only takes 1 to 4 with commas between, --seeds 1 or more, --starts 0 or more, --plot section 4"
        )
    folder = wheel(given.data)
    if folder is None:
        say(
            "example-robot-data is not installed and no --data is given: without UR10 and most trees"
        )
    print(
        ", ".join(f"{name} {version}" for name, version in trajectory_file.package_versions().items())
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
    warnings.simplefilter("ignore", ExciteWarning)
    given = arguments()
    try:
        report(given)
    except (ExciteError, OSError, SystemExit) as error:  # the last is what robots.wheel raises
        say(f"bench_design: {error}")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
