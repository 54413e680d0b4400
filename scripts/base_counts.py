#!/usr/bin/env python
"""Number of base parameters of many URDFs, as stated and with angles of four decimals.

For every URDF below a folder it prints the number that the structure has, the rank of the
regressor, and the smallest singular value that counts and the largest that does not (relative to
the largest, columns of unit length). The exit code is 1 where a number depends on the rounding or
differs from the rank. Robots with mimic joints have an upper bound instead of a structural number.

    pip download --no-deps example-robot-data && unzip -d DIR example_robot_data*.whl
    python scripts/base_counts.py DIR
"""

from __future__ import annotations

import argparse
import dataclasses
import re
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

from excite.errors import ExciteError
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot

MOST_JOINTS = 40
"""Moving joints above which a robot is left out: factorising its regressor takes minutes."""


def with_rounded_angles(text: str) -> str:
    """A URDF whose angles have four decimals; text that is no number stays."""

    def rounded(match: re.Match[str]) -> str:
        try:
            return 'rpy="' + " ".join(f"{float(word):.4f}" for word in match[1].split()) + '"'
        except ValueError:
            return match[0]

    return re.sub(r'rpy="([^"]*)"', rounded, text)


def loaded(text: str, folder: Path) -> robot.Robot:
    """The robot of a URDF's text, with limits of 1 where the URDF has none."""
    path = folder / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    machine = robot.load(str(path))
    entries = tuple(
        dataclasses.replace(
            entry,
            position=entry.position or (-1.0, 1.0),
            velocity=entry.velocity or 1.0,
            torque=entry.torque or 1.0,
        )
        for entry in machine.entries
    )
    return dataclasses.replace(machine, entries=entries, followers=())


def counted(machine: robot.Robot) -> tuple[int, int, float, float]:
    """Structural number, rank, smallest singular value that counts, largest that does not."""
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    samples = max(40, 4 * standard.count // machine.n + 20)
    motion = base_parameters.random_motion(table, samples, np.random.default_rng(1))
    rows = dynamics.regressor(machine.with_exact_placements(), standard, motion)
    stacked = rows.reshape(-1, standard.count)
    norms = np.linalg.norm(stacked, axis=0)
    present = norms > base_parameters.ABSENT_COLUMN * norms.max()
    triangle = np.linalg.qr(stacked[:, present] / norms[present], mode="r")
    values = np.append(np.linalg.svd(triangle, compute_uv=False), 0.0)
    values = values / values[0]
    rank = base_parameters.find(machine, standard, table).count
    number = base_parameters.base_count(machine, standard)
    return number, rank, float(values[rank - 1]), float(values[rank])


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with URDFs")
    faults, smallest, largest, robots = 0, 1.0, 0.0, 0
    for path in sorted(parser.parse_args().folder.rglob("*.urdf")):
        text = path.read_text(encoding="utf-8", errors="replace")
        results = []
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                for variant in (text, with_rounded_angles(text)):
                    machine = loaded(variant, Path(folder))
                    if machine.n > MOST_JOINTS:
                        raise ExciteError(f"{machine.n} joints")
                    results.append((machine.model.nv == machine.n, *counted(machine)))
            except ExciteError as error:
                print(f"{path.stem}: left out ({error})")
                continue
        tree, number, rank, kept, dropped = results[0]
        wrong = results[0][2] != results[1][2] or (tree and number != rank)
        faults, robots = faults + wrong, robots + 1
        smallest, largest = min(smallest, *(r[3] for r in results)), max(largest, results[1][4])
        largest = max(largest, dropped)
        print(
            f"{path.stem}: {number}{'' if tree else ' (bound)'}, rank {rank}, rounded "
            f"{results[1][2]}; {kept:.1e} > {dropped:.1e}{'  DIFFERS' if wrong else ''}"
        )
    print(f"{robots} robots, {faults} differ; counts above {smallest:.2e}, not below {largest:.2e}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
