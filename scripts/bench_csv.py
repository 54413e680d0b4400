#!/usr/bin/env python
"""Processor time of reading CSV recordings.

    python scripts/bench_csv.py [--rows 1000000] [--columns 20]

It writes files of random numbers in the usual notations, parses each with `excite.recordings` and
prints a Markdown table.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from excite.recordings import csv_reader
from excite.robot.robot import load

FORMATS = ("%.9g", "%.17g", "%+.9e")
"""Notations of the numbers; a few recorders write signs of positive numbers."""
ROBOT = "ur10e"
CHUNK_ROWS = 50_000
"""Number of rows that are written at once."""


def write_table(path: Path, names: list[str], rows: int, notation: str) -> None:
    """Write a file of random numbers with increasing times."""
    rng = np.random.default_rng(0)
    with path.open("w", encoding="ascii") as stream:
        stream.write(",".join(names) + "\n")
        for start in range(0, rows, CHUNK_ROWS):
            count = min(CHUNK_ROWS, rows - start)
            t = (start + np.arange(count)) / 1000.0
            values = rng.normal(size=(count, len(names) - 1))
            np.savetxt(stream, np.column_stack([t, values]), fmt=notation, delimiter=",")


def main() -> None:
    """Write the files, read them and print the times."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--columns", type=int, default=20)
    arguments = parser.parse_args()
    robot = load(ROBOT)
    recorded = ["t", *(f"{prefix}.{j}" for prefix in ("q", "dq", "tau") for j in robot.joints)]
    others = [f"other_{k}" for k in range(arguments.columns - len(recorded))]
    names = [*recorded, *others][: max(arguments.columns, 1 + robot.n)]
    print("| numbers | file [MB] | processor time [s] |")
    print("|---|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        for notation in FORMATS:
            write_table(path, names, arguments.rows, notation)
            begin = time.process_time()
            rows = sum(len(block) for block in csv_reader.read_blocks(path, robot))
            seconds = time.process_time() - begin
            assert rows == arguments.rows
            print(f"| {notation} | {path.stat().st_size / 1e6:.0f} | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main()
