#!/usr/bin/env python
"""Whether designs keep clear of everything, judged by brute force, and what that costs: Markdown tables, all from one run.

cases: arms on a table before a wall and one with a tool, designed free and in their cell. The free motions should collide there.
scenes: random obstacles and start poses. Every outcome is a motion that is clear, or a refusal that says what is in the way.

The judge looks every 1 ms (scenes: 2 ms) at every pair of bodies on different links, with coal and without excite's own search
for nearest moments. The wheel's UR10 and Panda, whose links are meshes, are tried where it is at hand (robots.py says how to
get it). The exit code is 1 when a motion breaks a margin or anything ends in a traceback.
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
from brute_force import CLEARLY, Judge, Least
from robots import wheel

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

Array = np.ndarray
SEEDS = 3
AGREE = 2e-3
"""What the certificate proves may stay behind what brute force finds by this [m] and a twentieth of it, never be more."""
STANDING = """
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
TOOL = """
[[cylinder]]
name = "tool"
radius = 0.04
length = 0.2
position = [0.0, 0.0, 0.11]
link = "iiwa_link_ee"
ignore = ["iiwa_link_7", "iiwa_link_6"]
"""
REACH = {"ur10e": 1.3, "panda": 0.85, "iiwa14": 0.82, "ur5e": 0.85, "fr3": 0.85}


# -- cases ---------------------------------------------------------------------------------------------------------


@dataclass
class Case:
    """An arm in its cell and what came of it, a design per seed: free, and in the cell. free: its worst pair there, by the sweep."""

    name: str
    robot: Robot
    limits: Limits
    cell: Cell
    placing: float
    free: list[pipeline.CertifiedDesign] = field(default_factory=list)
    clear: list[pipeline.CertifiedDesign] = field(default_factory=list)
    work: dict[bool, list[float]] = field(default_factory=lambda: {False: [], True: []})
    said: list[str] = field(default_factory=list)
    hits: list[continuous_check.Near] = field(default_factory=list)
    judged: list[Least] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def run(self) -> None:
        prepared(self.robot, self.limits, MotionRequest().complete(DesignOptions(), self.limits))
        judge = Judge(self.cell)
        for seed in range(SEEDS):
            say(f"{self.name}, seed {seed}, load {os.getloadavg()[0]:.1f}")
            try:
                self.free.append(self._designed(seed, None))
                self.hits.append(
                    continuous_check.along(self.cell, self.free[-1].trajectory.motion)[0]
                )
                self.clear.append(self._designed(seed, self.cell))
            except ExciteError as error:
                self.faults.append(f"seed {seed}: {error}")
                continue
            least = judge.along(self.clear[-1].trajectory.motion, 1e-3)
            self.judged += [least[0], *[one for one in least if one.margin >= self.cell.margin][:1]]
            self.faults += [f"seed {seed}: {text}" for text in disagreements(self.clear[-1], least)]

    def _designed(self, seed: int, cell: Cell | None) -> pipeline.CertifiedDesign:
        """One design; the processor's seconds besides the clock's, for others use the machine too."""
        options = MotionRequest().complete(DesignOptions(starts=1, seed=seed, jobs=1), self.limits)
        begun = time.process_time()
        out = pipeline.design_trajectory(self.robot, self.limits, options, cell=cell, progress=self.said.append)
        self.work[cell is not None].append(time.process_time() - begun)
        return out

    def cells(self) -> list[str]:
        """Its row of the table."""
        if not self.judged:
            return [self.name, *[""] * 10]
        criterion = DesignOptions().criterion
        values = [
            float(
                np.median(
                    [
                        criteria.select_criterion(one.trajectory.criteria["optimum"], criterion, plain=False)
                        for one in some
                    ]
                )
            )
            for some in (self.free, self.clear)
        ]
        clock = [
            f"{np.median([one.timing['total'] for one in some]):.1f}"
            for some in (self.free, self.clear)
        ]
        proven = [near for one in self.clear for near in one.certificate.pair_distances]
        nearest = min(proven, key=lambda near: near.proven - near.pair.margin)
        hit = min(self.hits, key=lambda near: near.found - near.pair.margin)
        struck = sum(near.found < near.pair.margin for near in self.hits)
        effect = (
            f"{struck} of {len(self.hits)}: {1e3 * hit.found:.0f} mm, {hit.names}"
            if struck
            else "none: NO EFFECT"
        )
        wide = min(
            (one for one in self.judged if one.margin >= self.cell.margin), key=lambda one: one.room
        )
        return [
            self.name,
            effect,
            min(self.judged, key=lambda one: one.room).words(),
            wide.words(),
            f"{1e3 * nearest.proven:.1f} of {1e3 * nearest.pair.margin:.0f} mm, {nearest.names}",
            f"{values[0]:.4g}",
            f"{values[1]:.4g} ({100.0 * (values[1] / values[0] - 1.0):+.0f} %)",
            f"{np.median(self.work[False]):.1f} ({clock[0]})",
            f"{', '.join(f'{seconds:.1f}' for seconds in sorted(self.work[True]))} ({clock[1]})",
            str(sum("tightening" in text for text in self.said)),
            f"{self.placing:.1f}",
        ]


def disagreements(one: pipeline.CertifiedDesign, least: Sequence[Least]) -> Iterator[str]:
    """What brute force finds broken or other than the certificate states it."""
    stated = {near.names: near for near in one.certificate.pair_distances}
    for found in least:
        near = stated.get(found.names)
        if found.room < 0.0 or found.distance <= 0.0:
            yield f"BROKEN: {found.words()}"
        elif near is not None and near.proven > found.distance + 1e-6:
            yield f"PROVEN TOO MUCH: {found.words()}, proven {1e3 * near.proven:.2f} mm"
        elif (
            near is not None
            and found.room < CLEARLY
            and near.proven < 0.95 * found.distance - AGREE
        ):
            yield f"proven little: {found.words()}, proven {1e3 * near.proven:.2f} mm"


def cases(folder: Path | None) -> Iterator[Case]:
    """The issue's cases."""
    yield placed("UR10e, table and wall", "ur10e", STANDING)
    yield placed("Panda, table and wall", "panda", STANDING)
    yield placed("iiwa14 with a tool", "iiwa14", STANDING + TOOL)
    if folder is not None:
        yield placed("UR10, meshes", str(folder / "ur_description/urdf/ur10_robot.urdf"), STANDING)
        yield placed("Panda, meshes", str(folder / "panda_description/urdf/panda.urdf"), STANDING)


def placed(name: str, source: str, text: str) -> Case:
    lock = {"panda_finger_joint1": 0.02} if source.endswith("panda.urdf") else {}
    machine = robot.load(source, lock=lock)
    table = limits.resolve(machine)
    with tempfile.TemporaryDirectory() as folder:
        (path := Path(folder) / "scene.toml").write_text(text, encoding="utf-8")
        read = scene_file.read(path)
    begun = time.process_time()
    cell = scene_file.cell(machine, table, read)
    clearance_builder.clearance(cell)
    return Case(name, machine, table, cell, time.process_time() - begun)


def report_cases(folder: Path | None) -> bool:
    """Whether every design kept its margins."""
    done = []
    for case in cases(folder):
        case.run()
        done.append(case)
        say("  " + " | ".join(case.cells()))
    head = [
        "case",
        "free designs that break a margin",
        "brute force, 1 kHz: least room",
        "of pairs with the full margin",
        "verify: proven",
    ]
    head += ["A free", "A clear", "free [s]", "clear [s]", "tightened", "cell [s]"]
    note = f"Seeds 0 to {SEEDS - 1}, one start each; medians, distances the worst. Seconds: the processor's, building and certifying too "
    note += "(clear: of each seed); in brackets the clock's. Cell: its pairs and covers, once, by the processor. "
    note += (
        f"Load {', '.join(f'{load:.1f}' for load in os.getloadavg())} on {os.cpu_count()} cores."
    )
    show("Cases", head, [case.cells() for case in done], note)
    faults = [f"{case.name}: {text}" for case in done for text in case.faults]
    print("\n".join(["", *faults]) if faults else "", flush=True)
    return all(case.judged for case in done) and not any(
        "BROKEN" in text or "TOO MUCH" in text for text in faults
    )


# -- random scenes -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What became of one scene. kind: "motion", the refusal's class, or what is wrong."""

    number: int
    robot: str
    kind: str
    text: str
    seconds: float
    legs: int = 0
    from_pose: bool = False
    least: Least | None = None

    def words(self) -> str:
        return f"{self.robot}{', from a pose' * self.from_pose}, {self.seconds:.1f} s, {self.kind}: {self.text}"


def obstacles(rng: np.random.Generator, reach: float) -> str:
    """TOML of a floor and 1 to 5 things within reach that leave the base alone."""
    lines = [f"floor = {0.0 if rng.random() < 0.5 else -round(rng.uniform(0.0, 0.8), 3)}"]
    count = int(rng.integers(1, 6))
    while count:
        kind = str(rng.choice(["box", "sphere", "capsule", "cylinder"]))
        size = np.round(rng.uniform(0.05, 0.6, 3), 3)
        size = size if kind == "box" else size * [0.5, 1.0, 1.0]  # the round ones: a radius first
        angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 1.0) * reach
        place = np.array([far * np.cos(angle), far * np.sin(angle), rng.uniform(-0.1, 1.0) * reach])
        ball = {
            "box": 0.5 * np.linalg.norm(size),
            "sphere": size[0],
            "capsule": size[0] + 0.5 * size[1],
        }
        if far < ball.get(kind, np.hypot(size[0], 0.5 * size[1])) + 0.15:
            continue
        own = (
            f"size = {size.tolist()}"
            if kind == "box"
            else f"radius = {size[0]}" + f"\nlength = {size[1]}" * (kind != "sphere")
        )
        turned = np.round(rng.uniform(-np.pi, np.pi, 3), 3).tolist()
        lines.append(
            f'[[{kind}]]\nname = "{kind} {count}"\n{own}\nposition = {np.round(place, 3).tolist()}\nrotation = {turned}'
        )
        count -= 1
    return "\n".join(lines) + "\n"


def pose(rng: np.random.Generator, judge: Judge, table: Limits) -> Array:
    """A random pose, of a few the first that is clear: the last of them may touch something, and is to be refused."""
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
    """One random scene, as a user would give it."""
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
        bodies += ["floor", *(one.name for one in read.shapes)]
        cell = scene_file.cell(machine, table, read)
        bodies += [body.name for body in cell.bodies]
        judge = Judge(cell)
        start = pose(rng, judge, table) if from_pose else None
        begun = time.perf_counter()
        found = pipeline.design_trajectory(machine, table, options, start=start, cell=cell)
    except (Infeasible, UnusableInput, CheckFailed) as error:
        said = any(body in str(error) for body in bodies)
        kind = type(error).__name__ if said else "refused without naming"
        return dataclasses.replace(
            outcome, kind=kind, text=str(error), seconds=time.perf_counter() - begun
        )
    except Exception:  # a traceback is a finding, and the others go on
        return dataclasses.replace(
            outcome,
            kind="TRACEBACK",
            text=traceback.format_exc(),
            seconds=time.perf_counter() - begun,
        )
    seconds, motion = time.perf_counter() - begun, found.trajectory.motion
    least = judge.along(motion, 2e-3)
    wrong = [text for text in disagreements(found, least) if text[:6] in ("BROKEN", "PROVEN")]
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
    """Whether every motion kept clear and nothing crashed."""
    with tempfile.TemporaryDirectory() as folder:
        done = []
        for number in range(count):
            done.append(one := attempt(number, seed, Path(folder)))
            say(f"scene {number}: {one.words()}")
    kinds = collections.Counter(one.kind for one in done)
    rows = []
    for kind, times in kinds.most_common():
        own = [one for one in done if one.kind == kind]
        seconds = [one.seconds for one in own]
        posed, round_about = sum(one.from_pose for one in own), sum(one.legs > 2 for one in own)
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
    motions = [one.least for one in done if one.least is not None]
    if motions:
        note += f"Least room of all motions, every 2 ms: {min(motions, key=lambda one: one.room).words()}."
    show(
        f"{count} random scenes",
        ["outcome", "scenes", "from a pose", "through poses between", "median (most) [s]"],
        rows,
        note,
    )
    for one in done:
        if one.kind != "motion":
            print(f"- {one.number}: {one.words()}")
    return not {"BROKEN", "TRACEBACK"} & set(kinds)


def arguments() -> argparse.Namespace:
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
    warnings.simplefilter("ignore", ExciteWarning)
    given = arguments()
    clear = report_cases(wheel(given.data)) if given.only != "scenes" else True
    if given.only != "cases":
        clear &= report_scenes(given.scenes, given.seed)
    return 0 if clear else 1


if __name__ == "__main__":
    sys.exit(main())
