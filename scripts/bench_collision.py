#!/usr/bin/env python
"""Check by brute force that designed motions keep clear of all obstacles, and measure the cost.

It prints Markdown tables, all from one run:

- cases: arms on a table in front of a wall, one with a tool, designed without and with the cell.
  Without the cell the motions should collide.
- scenes: random obstacles and start poses. Each outcome is a clear motion, or a refusal that names
  the obstacle.

The judge evaluates every pair of bodies on different links every 1 ms (scenes: 2 ms) with coal,
independently of excite's own search for the times of least distance. The UR10 and the Panda of
example-robot-data, whose links are meshes, are included where the wheel is available (robots.py
says how to get it). The exit code is 1 when a motion violates a margin or anything raises.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import os
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bench_design import prepared, say, show  # first: it keeps BLAS to one thread

# isort: split
import numpy as np
from brute_force import HULL_CLEARANCE, DistanceJudge, PairDistance
from robots import wheel

from excite._types import FloatArray
from excite.collision import clearance_builder, continuous_check, scene_file
from excite.collision.workcell import Cell
from excite.designer import criteria, pipeline
from excite.designer.options import DesignOptions
from excite.designer.time_budget import MotionRequest
from excite.errors import CheckFailed, ExciteError, ExciteWarning, Infeasible, UnusableInput
from excite.robot import limits, robot
from excite.robot.inertial_parameters import ranges
from excite.robot.limits import Limits
from excite.robot.robot import Robot

SEEDS = 3
"""Number of designs per case."""
PROOF_TOLERANCE = 2e-3
"""Tolerance by which a proven distance may fall below the true one [m].

A twentieth of the distance is allowed in addition; proving more than the truth is an error.
"""
TABLE_AND_WALL = """
floor = -0.8
[[box]]
name = "table"
size = [1.4, 1.2, 0.05]
position = [0.3, 0.0, -0.03]
[[box]]
name = "wall"
size = [0.05, 2.4, 2.6]
position = [-0.5, 0.0, 0.5]
"""
"""Scene of the cases."""
FLANGE_TOOL = """
[[cylinder]]
name = "tool"
radius = 0.04
length = 0.2
position = [0.0, 0.0, 0.11]
link = "iiwa_link_ee"
ignore = ["iiwa_link_7", "iiwa_link_6"]
"""
"""Tool of the iiwa14."""
REACH = {"ur10e": 1.3, "panda": 0.85, "iiwa14": 0.82, "ur5e": 0.85, "fr3": 0.85}
"""Robots of the random scenes, with their reach [m]."""


# -- cases ------------------------------------------------------------------------------------


@dataclass
class Case:
    """An arm in its cell and its designs, one per seed, without and with the cell.

    Attributes:
        name: Name in the table.
        robot: The robot.
        limits: Its limits.
        cell: The cell.
        placing: Processor time to build the cell [s].
        free: Designs without the cell.
        clear: Designs with the cell.
        work: Processor time of each design [s], by whether the cell was used.
        progress: Lines of progress.
        free_distances: Nearest pair of each free design in the cell.
        brute_force: Nearest pairs of the clear designs, by brute force.
        faults: Disagreements and errors.
    """

    name: str
    robot: Robot
    limits: Limits
    cell: Cell
    placing: float
    free: list[pipeline.CertifiedDesign] = field(default_factory=list)
    clear: list[pipeline.CertifiedDesign] = field(default_factory=list)
    work: dict[bool, list[float]] = field(default_factory=lambda: {False: [], True: []})
    progress: list[str] = field(default_factory=list)
    free_distances: list[continuous_check.PairDistance] = field(default_factory=list)
    brute_force: list[PairDistance] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def run(self) -> None:
        """Design with every seed, with and without the cell, and check the results."""
        prepared(self.robot, self.limits, MotionRequest().complete(DesignOptions(), self.limits))
        judge = DistanceJudge(self.cell)
        for seed in range(SEEDS):
            say(f"{self.name}, seed {seed}, load {os.getloadavg()[0]:.1f}")
            try:
                self.free.append(self._designed(seed, None))
                self.free_distances.append(
                    continuous_check.least_distances(self.cell, self.free[-1].trajectory.motion)[0]
                )
                self.clear.append(self._designed(seed, self.cell))
            except ExciteError as error:
                self.faults.append(f"seed {seed}: {error}")
                continue
            least = judge.along(self.clear[-1].trajectory.motion, 1e-3)
            self.brute_force += [
                least[0],
                *[entry for entry in least if entry.margin >= self.cell.margin][:1],
            ]
            self.faults += [f"seed {seed}: {text}" for text in disagreements(self.clear[-1], least)]

    def _designed(self, seed: int, cell: Cell | None) -> pipeline.CertifiedDesign:
        """Design once and record the processor time, because other programs share the machine."""
        options = MotionRequest().complete(DesignOptions(starts=1, seed=seed, jobs=1), self.limits)
        begun = time.process_time()
        out = pipeline.design_trajectory(
            self.robot, self.limits, options, cell=cell, progress=self.progress.append
        )
        self.work[cell is not None].append(time.process_time() - begun)
        return out

    def cells(self) -> list[str]:
        """Return the row of the table."""
        if not self.brute_force:
            return [self.name, *[""] * 10]
        criterion = DesignOptions().criterion
        values = [
            float(
                np.median(
                    [
                        criteria.select_criterion(
                            design.trajectory.criteria["optimum"], criterion, plain=False
                        )
                        for design in designs
                    ]
                )
            )
            for designs in (self.free, self.clear)
        ]
        clock = [
            f"{np.median([design.timing['total'] for design in designs]):.1f}"
            for designs in (self.free, self.clear)
        ]
        proven = [near for design in self.clear for near in design.certificate.pair_distances]
        nearest = min(proven, key=lambda near: near.proven - near.pair.margin)
        worst = min(self.free_distances, key=lambda near: near.observed - near.pair.margin)
        count = sum(near.observed < near.pair.margin for near in self.free_distances)
        effect = (
            f"{count} of {len(self.free_distances)}: {1e3 * worst.observed:.0f} mm, {worst.names}"
            if count
            else "none: NO EFFECT"
        )
        full_margin = min(
            (design for design in self.brute_force if design.margin >= self.cell.margin),
            key=lambda design: design.room,
        )
        return [
            self.name,
            effect,
            min(self.brute_force, key=lambda design: design.room).words(),
            full_margin.words(),
            f"{1e3 * nearest.proven:.1f} of {1e3 * nearest.pair.margin:.0f} mm, {nearest.names}",
            f"{values[0]:.4g}",
            f"{values[1]:.4g} ({100.0 * (values[1] / values[0] - 1.0):+.0f} %)",
            f"{np.median(self.work[False]):.1f} ({clock[0]})",
            f"{', '.join(f'{seconds:.1f}' for seconds in sorted(self.work[True]))} ({clock[1]})",
            str(sum("tightening" in text for text in self.progress)),
            f"{self.placing:.1f}",
        ]


def disagreements(design: pipeline.CertifiedDesign, least: Sequence[PairDistance]) -> Iterator[str]:
    """Yield violated margins and differences between the certificate and brute force."""
    proven = {near.names: near for near in design.certificate.pair_distances}
    for entry in least:
        near = proven.get(entry.names)
        if entry.room < 0.0 or entry.distance <= 0.0:
            yield f"BROKEN: {entry.words()}"
        elif near is not None and near.proven > entry.distance + 1e-6:
            yield f"PROVEN TOO MUCH: {entry.words()}, proven {1e3 * near.proven:.2f} mm"
        elif (
            near is not None
            and entry.room < HULL_CLEARANCE
            and near.proven < 0.95 * entry.distance - PROOF_TOLERANCE
        ):
            yield f"proven little: {entry.words()}, proven {1e3 * near.proven:.2f} mm"


def cases(folder: Path | None) -> Iterator[Case]:
    """Yield the cases."""
    yield placed("UR10e, table and wall", "ur10e", TABLE_AND_WALL)
    yield placed("Panda, table and wall", "panda", TABLE_AND_WALL)
    yield placed("iiwa14 with a tool", "iiwa14", TABLE_AND_WALL + FLANGE_TOOL)
    if folder is not None:
        yield placed(
            "UR10, meshes", str(folder / "ur_description/urdf/ur10_robot.urdf"), TABLE_AND_WALL
        )
        yield placed(
            "Panda, meshes", str(folder / "panda_description/urdf/panda.urdf"), TABLE_AND_WALL
        )


def placed(name: str, source: str, text: str) -> Case:
    """Build a case from a robot and the text of a scene."""
    lock = {"panda_finger_joint1": 0.02} if source.endswith("panda.urdf") else {}
    machine = robot.load(source, lock=lock)
    table = limits.resolve(machine)
    with tempfile.TemporaryDirectory() as folder:
        (path := Path(folder) / "scene.toml").write_text(text, encoding="utf-8")
        read = scene_file.read(path)
    begun = time.process_time()
    cell = scene_file.build_cell(machine, table, read)
    clearance_builder.build_constraint(cell)
    return Case(name, machine, table, cell, time.process_time() - begun)


def report_cases(folder: Path | None) -> bool:
    """Run and print all cases; return whether every design kept its margins."""
    done = []
    for case in cases(folder):
        case.run()
        done.append(case)
        say("  " + " | ".join(case.cells()))
    head = [
        "case",
        "free designs that break a margin",
        "brute force, 1 kHz: least clearance beyond the margin",
        "of pairs with the full margin",
        "verify: proven",
    ]
    head += ["A free", "A clear", "free [s]", "clear [s]", "tightened", "cell [s]"]
    note = f"Seeds 0 to {SEEDS - 1}, one start each; medians, of distances the worst. "
    note += "Seconds: processor time with building and certifying (clear: of each seed), "
    note += "in brackets wall time. Cell: processor time to build it once. "
    note += (
        f"Load {', '.join(f'{load:.1f}' for load in os.getloadavg())} on {os.cpu_count()} cores."
    )
    show("Cases", head, [case.cells() for case in done], note)
    faults = [f"{case.name}: {text}" for case in done for text in case.faults]
    print("\n".join(["", *faults]) if faults else "", flush=True)
    return all(case.brute_force for case in done) and not any(
        "BROKEN" in text or "TOO MUCH" in text for text in faults
    )


# -- random scenes ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """The outcome of one random scene.

    Attributes:
        number: Number of the scene.
        robot: Name of the robot.
        kind: "motion", the class of the refusal, or the fault.
        text: Description.
        seconds: Duration [s].
        legs: Number of approach and return segments.
        from_pose: Whether a start pose was given.
        least: Nearest pair by brute force.
    """

    number: int
    robot: str
    kind: str
    text: str
    seconds: float
    legs: int = 0
    from_pose: bool = False
    least: PairDistance | None = None

    def words(self) -> str:
        """Return a description."""
        pose = ", from a pose" * self.from_pose
        return f"{self.robot}{pose}, {self.seconds:.1f} s, {self.kind}: {self.text}"


def obstacles(rng: np.random.Generator, reach: float) -> str:
    """Return a scene file: a floor and one to five obstacles in reach, clear of the base."""
    lines = [f"floor = {0.0 if rng.random() < 0.5 else -round(rng.uniform(0.0, 0.8), 3)}"]
    count = int(rng.integers(1, 6))
    while count:
        kind = str(rng.choice(["box", "sphere", "capsule", "cylinder"]))
        size = np.round(rng.uniform(0.05, 0.6, 3), 3)
        size = size if kind == "box" else size * [0.5, 1.0, 1.0]  # round shapes: radius first
        angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 1.0) * reach
        position = np.array(
            [distance * np.cos(angle), distance * np.sin(angle), rng.uniform(-0.1, 1.0) * reach]
        )
        bounding_radius = {
            "box": 0.5 * np.linalg.norm(size),
            "sphere": size[0],
            "capsule": size[0] + 0.5 * size[1],
        }
        if distance < bounding_radius.get(kind, np.hypot(size[0], 0.5 * size[1])) + 0.15:
            continue
        dimensions = (
            f"size = {size.tolist()}"
            if kind == "box"
            else f"radius = {size[0]}" + f"\nlength = {size[1]}" * (kind != "sphere")
        )
        rotation = np.round(rng.uniform(-np.pi, np.pi, 3), 3).tolist()
        lines.append(
            f'[[{kind}]]\nname = "{kind} {count}"\n{dimensions}\n'
            f"position = {np.round(position, 3).tolist()}\nrotation = {rotation}"
        )
        count -= 1
    return "\n".join(lines) + "\n"


def pose(rng: np.random.Generator, judge: DistanceJudge, table: Limits) -> FloatArray:
    """Draw up to five random poses until one is clear.

    The last may be in collision; it then has to be refused.
    """
    low, high = ranges(table).T
    data = judge.robot.model.createData()
    for _ in range(5):
        q = np.asarray(rng.uniform(low, high))
        if (
            judge.at(q, data, np.full(len(judge.names), np.inf)) >= np.array(judge.margins) + 2e-3
        ).all():
            break
    return q


def attempt(number: int, seed: int, folder: Path) -> Outcome:
    """Design for one random scene, as a user would."""
    rng = np.random.default_rng([seed, number])
    name = list(REACH)[number % len(REACH)]
    machine = robot.load(name)
    table = limits.resolve(machine)
    path = folder / f"scene_{number}.toml"
    path.write_text(obstacles(rng, REACH[name]), encoding="utf-8")
    options = dataclasses.replace(
        MotionRequest().complete(DesignOptions(starts=1, seed=seed, jobs=1), table), iterations=60
    )
    begun, start, bodies, from_pose = time.perf_counter(), None, list[str](), number % 3 == 0
    outcome = Outcome(number, name, "", "", 0.0, from_pose=from_pose)
    try:
        read = scene_file.read(path)
        bodies += ["floor", *(shape.name for shape in read.shapes)]
        cell = scene_file.build_cell(machine, table, read)
        bodies += [body.name for body in cell.bodies]
        judge = DistanceJudge(cell)
        start = pose(rng, judge, table) if from_pose else None
        begun = time.perf_counter()
        result = pipeline.design_trajectory(machine, table, options, start=start, cell=cell)
    except (Infeasible, UnusableInput, CheckFailed) as error:
        names_body = any(body in str(error) for body in bodies)
        kind = type(error).__name__ if names_body else "refused without naming"
        return dataclasses.replace(
            outcome, kind=kind, text=str(error), seconds=time.perf_counter() - begun
        )
    except Exception:  # a traceback is a result; the other scenes go on
        return dataclasses.replace(
            outcome,
            kind="TRACEBACK",
            text=traceback.format_exc(),
            seconds=time.perf_counter() - begun,
        )
    seconds, motion = time.perf_counter() - begun, result.trajectory.motion
    least = judge.along(motion, 2e-3)
    wrong = [text for text in disagreements(result, least) if text[:6] in ("BROKEN", "PROVEN")]
    legs = sum(segment.kind in ("approach", "return") for segment in motion.segments)
    text = "; ".join(wrong) or least[0].words()
    return dataclasses.replace(
        outcome,
        kind="BROKEN" if wrong else "motion",
        text=text,
        seconds=seconds,
        legs=legs,
        least=least[0],
    )


def report_scenes(count: int, seed: int) -> bool:
    """Run and print all random scenes; return whether all motions are clear and nothing raised."""
    with tempfile.TemporaryDirectory() as folder:
        results = []
        for number in range(count):
            results.append(outcome := attempt(number, seed, Path(folder)))
            say(f"scene {number}: {outcome.words()}")
    kinds = collections.Counter(outcome.kind for outcome in results)
    rows = []
    for kind, times in kinds.most_common():
        outcomes = [outcome for outcome in results if outcome.kind == kind]
        seconds = [outcome.seconds for outcome in outcomes]
        posed, round_about = (
            sum(outcome.from_pose for outcome in outcomes),
            sum(outcome.legs > 2 for outcome in outcomes),
        )
        rows.append(
            [
                kind,
                str(times),
                str(posed),
                str(round_about),
                f"{np.median(seconds):.1f} ({max(seconds):.1f})",
            ]
        )
    note = f"Seed {seed}; up to 60 iterations, one start. "
    motions = [outcome.least for outcome in results if outcome.least is not None]
    if motions:
        least = min(motions, key=lambda pair: pair.room)
        note += f"Least clearance beyond the margin of all motions, every 2 ms: {least.words()}."
    show(
        f"{count} random scenes",
        ["outcome", "scenes", "from a pose", "through intermediate poses", "median (most) [s]"],
        rows,
        note,
    )
    for outcome in results:
        if outcome.kind != "motion":
            print(f"- {outcome.number}: {outcome.words()}")
    return not {"BROKEN", "TRACEBACK"} & set(kinds)


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        help="example-robot-data: its unpacked wheel or folder of robots",
    )
    parser.add_argument("--only", choices=("cases", "scenes"), help="one part alone")
    parser.add_argument(
        "--scenes", type=int, default=100, metavar="N", help="random scenes (default %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="of the random scenes (default %(default)s)"
    )
    return parser.parse_args()


def main() -> int:
    """Run the benchmark; return the exit code."""
    warnings.simplefilter("ignore", ExciteWarning)
    given = parse_arguments()
    clear = report_cases(wheel(given.data)) if given.only != "scenes" else True
    if given.only != "cases":
        clear &= report_scenes(given.scenes, given.seed)
    return 0 if clear else 1


if __name__ == "__main__":
    sys.exit(main())
