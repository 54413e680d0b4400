"""Record the files that the commands write, and compare two such records.

    python scripts/golden_record.py make before/   # all built-in robots, 20 recordings
    python scripts/golden_record.py make after/
    python scripts/golden_record.py compare before/ after/

A change of structure must not change any file. Files are compared byte by byte, except for the JSON
keys of `--ignore` (package versions differ between releases).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROBOTS = ("fr3", "iiwa14", "panda", "two_link", "tx40", "ur10e", "ur5e")
"""Built-in robots."""
FAST = ("--starts", "1", "--iterations", "60")
"""Options of a short design."""
COMPARED = ("*.json", "*.csv", "*.urdf")
"""Patterns of the files that are compared."""


@dataclass(frozen=True)
class Case:
    """A training recording.

    Attributes:
        robot: The recorded robot.
        effects: Effects that it hides.
        seed: Seed of its bodies, actuators and noise.
    """

    robot: str
    effects: tuple[str, ...]
    seed: int

    @property
    def name(self) -> str:
        """Name of the case's folder."""
        return f"{self.robot}-{self.seed}"


def cases() -> tuple[Case, ...]:
    """Return 20 recordings: 14 of the small robot, which take seconds, and 6 of larger ones."""
    hidden: tuple[tuple[str, tuple[str, ...]], ...] = (
        ("two_link", ()),
        ("two_link", ("stribeck:joint_1",)),
        ("two_link", ("load_friction:joint_1",)),
        ("two_link", ("torque_ripple:joint_2",)),
        ("two_link", ("delay",)),
        ("two_link", ("elasticity:joint_2",)),
        ("two_link", ("backlash:joint_1",)),
        ("two_link", ("hysteresis:joint_2",)),
        ("two_link", ("spring:joint_2",)),
        ("two_link", ("contact:joint_2",)),
        ("two_link", ("thermal_drift:joint_1",)),
        ("two_link", ("stribeck:joint_1", "torque_ripple:joint_2")),
        ("two_link", ("base_compliance",)),
        ("two_link", ("asymmetric_viscous:joint_2",)),
        ("ur5e", ()),
        ("ur5e", ("load_friction:elbow_joint",)),
        ("ur10e", ("stribeck:wrist_1_joint",)),
        ("tx40", ("coupling:joint_5",)),
        ("panda", ("torque_ripple:panda_joint4",)),
        ("iiwa14", ("position_friction:iiwa_joint_2",)),
    )
    return tuple(Case(robot, effects, seed) for seed, (robot, effects) in enumerate(hidden, 1))


def excite(folder: Path, *arguments: str) -> None:
    """Run a command in a folder, so that no path of this machine is recorded."""
    process = subprocess.run(
        [sys.executable, "-m", "excite", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if process.returncode:
        sys.exit(
            f"excite {' '.join(arguments)}: exit code {process.returncode}: "
            f"{process.stderr.strip().splitlines()[-1:]}"
        )


def record_design(folder: Path, robot: str) -> None:
    """Design a motion and a validation motion."""
    excite(folder, "design", robot, "--validation", "-o", robot, "--jobs", "1", *FAST)


def record_case(folder: Path, case: Case) -> None:
    """Simulate two recordings, identify and diagnose."""
    (folder / case.name).mkdir()
    hide = [word for effect in case.effects for word in ("--effect", effect)]
    first, second = f"{case.name}/train.csv", f"{case.name}/heldout.csv"
    motion = f"{case.robot}/trajectory.json"
    excite(folder, "simulate", case.robot, motion, *hide, "--seed", str(case.seed), "-o", first)
    excite(
        folder,
        "simulate",
        case.robot,
        f"{case.robot}/validation/trajectory.json",
        "--like",
        f"{case.name}/train.truth.json",
        "-o",
        second,
    )
    excite(folder, "identify", case.robot, first, "--validate", second, "-o", f"{case.name}/model")
    excite(
        folder,
        "diagnose",
        case.robot,
        first,
        "--validate",
        second,
        "--no-report",
        "-o",
        f"{case.name}/diagnosis",
    )


def make(folder: Path, jobs: int) -> None:
    """Record everything into an empty folder."""
    folder.mkdir(parents=True)
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(lambda robot: record_design(folder, robot), ROBOTS))
        list(pool.map(lambda case: record_case(folder, case), cases()))


def without(value: Any, keys: frozenset[str]) -> Any:
    """Return a JSON value without some keys, at any depth."""
    if isinstance(value, dict):
        return {key: without(inner, keys) for key, inner in value.items() if key not in keys}
    return [without(inner, keys) for inner in value] if isinstance(value, list) else value


def differences(before: Path, after: Path, ignored: frozenset[str]) -> Iterator[str]:
    """Names of files that differ or that only one of the records has."""
    names = [
        {path.relative_to(root) for pattern in COMPARED for path in root.rglob(pattern)}
        for root in (before, after)
    ]
    for name in sorted(names[0] | names[1]):
        if name not in names[0] or name not in names[1]:
            yield f"{name}: only in one record"
            continue
        old, new = (root / name for root in (before, after))
        if old.read_bytes() == new.read_bytes():
            continue
        if name.suffix == ".json" and ignored:
            documents = [
                without(json.loads(path.read_text(encoding="utf-8")), ignored)
                for path in (old, new)
            ]
            if documents[0] == documents[1]:
                continue
        yield f"{name}: differs"


def main() -> int:
    """Make a record, or compare two."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    sub = commands.add_parser("make")
    sub.add_argument("folder", type=Path)
    sub.add_argument("--jobs", type=int, default=2)
    sub = commands.add_parser("compare")
    sub.add_argument("before", type=Path)
    sub.add_argument("after", type=Path)
    sub.add_argument(
        "--ignore", nargs="*", default=[], metavar="KEY", help="JSON keys that may differ"
    )
    arguments = parser.parse_args()
    if arguments.command == "make":
        make(arguments.folder, arguments.jobs)
        return 0
    changes = list(differences(arguments.before, arguments.after, frozenset(arguments.ignore)))
    print(
        "\n".join(changes)
        if changes
        else f"identical: {sum(1 for p in arguments.before.rglob('*') if p.is_file())} files"
    )
    return 1 if changes else 0


if __name__ == "__main__":
    sys.exit(main())
