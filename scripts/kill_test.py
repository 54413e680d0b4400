"""Kill commands while they run and while they replace their files, and check the remaining files.

    python scripts/kill_test.py [--random 30] [--between 10]

Four cases: `design` into its folder, which is exchanged; `design` with that folder as the current
directory, whose files are replaced in place; `design` into a folder that does not exist; and
`simulate`, whose files are in a folder with others. Each is killed by SIGKILL at random times, and
before operations on names of files (rename, exchange, link, remove), spread evenly over all
operations of a replacement. The same seed gives the same bytes, so every file can be classified as
old or new. The exit code is 1 if files are mixed or broken, a foreign file has changed, or the next
run does not remove the staging directories of a killed one.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

SHORT_DESIGN = ("--starts", "1", "--iterations", "15", "--harmonics", "3", "--samples", "60")
"""Options of a design of about a second."""
CHILD = """
import os, signal, sys
at, count, out = int(sys.argv[1]), 0, sys.argv[-1]
EVENTS = ("os.rename", "os.link", "os.remove", "os.rmdir")

def hook(event, arguments):
    global count
    touches = any(
        ".partial" in str(argument) or str(argument).startswith(out) for argument in arguments
    )
    exchanges = event == "ctypes.dlsym" and arguments[1] in ("renameat2", "renamex_np")
    if event in EVENTS and touches or exchanges:
        count += 1
        if count == at:
            os.kill(os.getpid(), signal.SIGKILL)

sys.addaudithook(hook)
from excite.cli.main import main
code = main(sys.argv[2:])
print(count)
sys.exit(code)
"""
"""Program that runs a command and kills itself before its n-th operation on files."""

FOREIGN = "foreign"
"""Text of a file that the command must not change."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A command that is killed.

    Attributes:
        name: Name in the table.
        command: Its arguments without seed and output.
        target: Its `-o`, relative to the folder of the case.
        exists: True if the target exists before.
        inside: True if the target is the current directory.
    """

    name: str
    command: tuple[str, ...]
    target: str
    exists: bool = True
    inside: bool = False

    def start(self, root: Path, seed: int, at: int = 0) -> subprocess.Popen[str]:
        """Start the command.

        Args:
            root: Folder of the case.
            seed: Seed of the command.
            at: Number of the operation on files before which it is killed; 0: none.
        """
        out = root / self.target
        command = [
            sys.executable,
            "-c",
            CHILD,
            str(at),
            *self.command,
            "--seed",
            str(seed),
            "-o",
            str(out),
        ]
        return subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=out if self.inside else None,
        )

    def run(self, root: Path, seed: int, at: int = 0) -> int:
        """Run the command to its end; return the number of operations on files."""
        process = self.start(root, seed, at)
        printed = process.communicate()[0]
        if at == 0 and process.returncode != 0:
            raise SystemExit(f"{self.name}: exit code {process.returncode}")
        return int(printed.split()[-1]) if at == 0 else 0


def files(root: Path) -> dict[str, bytes]:
    """Return the content of all files of a folder by their relative names."""
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def state(present: dict[str, bytes], old: dict[str, bytes], new: dict[str, bytes]) -> str:
    """Compare the files of a folder with the old and the new set.

    Returns:
        Name of the state, in capitals for a fault.
    """
    kinds = set()
    for name in {*old, *new}:
        content = present.get(name)
        if content is None:
            kinds.add("absent")
        elif content not in (old.get(name), new.get(name)):
            return "BROKEN"
        elif old.get(name) != new.get(name):
            kinds.add("new" if content == new.get(name) else "old")
    if {"old", "new"} <= kinds:
        return "MIXED"
    if "absent" in kinds:
        return "none" if kinds == {"absent"} else "incomplete"
    return kinds.pop()


def prepare(root: Path, before: Path, case: Case) -> None:
    """Set up a folder with the old files and a foreign file."""
    shutil.rmtree(root, ignore_errors=True)
    if case.exists:
        shutil.copytree(before, root)
    else:
        root.mkdir()
    foreign = root / (
        "foreign.txt" if not case.exists or "." in case.target else f"{case.target}/foreign.txt"
    )
    foreign.write_text(FOREIGN)


def run_case(case: Case, folder: Path, randoms: int, betweens: int) -> tuple[list[str], bool]:
    """Kill the command of a case many times.

    Args:
        case: The case.
        folder: Empty folder.
        randoms: Number of kills at random times.
        betweens: Number of kills between operations on files.

    Returns:
        The row of the table, and True without faults.
    """
    before, after, root = folder / "before", folder / "after", folder / "root"
    for path, seed in ((before, 0), (after, 1)):
        (path / case.target).parent.mkdir(parents=True)
        if case.inside:
            (path / case.target).mkdir()
        begun = time.perf_counter()
        case.run(path, seed)
    seconds = time.perf_counter() - begun
    old, new = files(before) if case.exists else {}, files(after)
    prepare(root, before, case)
    operations = case.run(root, 1)
    moments = [(None, seconds * random.random()) for _ in range(randoms)]
    moments += [(1 + operations * (2 * i + 1) // (2 * betweens), 0.0) for i in range(betweens)]
    states: tuple[collections.Counter[str], collections.Counter[str]] = (
        collections.Counter(),
        collections.Counter(),
    )
    good = True
    for at, delay in moments:
        prepare(root, before, case)
        if at is None:
            process = case.start(root, 1)
            time.sleep(delay)
            process.kill()
            process.communicate()
        else:
            case.run(root, 1, at)
        present = files(root)
        kind = state(
            {name: text for name, text in present.items() if ".partial" not in name}, old, new
        )
        states[at is not None][kind] += 1
        good &= kind in ("old", "new", "none", "incomplete")
        if at is None and set(present) <= {*old, *new, "foreign.txt", f"{case.target}/foreign.txt"}:
            continue  # there are no staging directories
        case.run(root, 1)
        final = files(root)
        foreign = {name for name, text in final.items() if text == FOREIGN.encode()}
        clean = (
            set(final) == set(new) | foreign
            and len(foreign) == 1
            and all(final[name] == new[name] for name in new)
        )
        good &= clean
    words = [
        ", ".join(f"{count} {name}" for name, count in sorted(counter.items()))
        for counter in states
    ]
    return [case.name, words[0], words[1], str(operations), "yes" if good else "NO"], good


def main(argv: Sequence[str] | None = None) -> int:
    """Run the cases and print the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--random",
        type=int,
        default=30,
        metavar="N",
        help="kills at random times per case (default %(default)s)",
    )
    parser.add_argument(
        "--between",
        type=int,
        default=10,
        metavar="N",
        help="kills between operations on files per case (default %(default)s)",
    )
    parser.add_argument(
        "--only",
        metavar="CASE",
        action="append",
        help="run this case alone: exchanged, in-place, new or siblings",
    )
    arguments = parser.parse_args(argv)
    os.environ["EXCITE_COMPILER"] = ""
    random.seed(0)
    with tempfile.TemporaryDirectory() as name:
        if not arguments.only or "siblings" in arguments.only:
            Case("motion", ("design", "two_link", *SHORT_DESIGN), "motion").run(Path(name), 0)
        design = ("design", "two_link", "--validation", *SHORT_DESIGN)
        motion = str(Path(name) / "motion" / "trajectory.json")
        cases = (
            Case("exchanged", design, "out"),
            Case("in-place", design, "out", inside=True),
            Case("new", design, "out", exists=False),
            Case("siblings", ("simulate", "two_link", motion), "run.csv"),
        )
        rows, good = [], True
        for case in cases:
            if arguments.only and case.name not in arguments.only:
                continue
            row, ok = run_case(case, Path(name) / case.name, arguments.random, arguments.between)
            rows.append(row)
            good &= ok
    head = (
        "case",
        "killed at random",
        "killed between operations",
        "operations",
        "never mixed or broken, next run clean",
    )
    print("\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
