"""Design and certify the trajectories of `trajectories/`, one for every built-in robot."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from excite import _json
from excite._system.output_files import output_files
from excite.collision import scene_file
from excite.designer import pipeline, time_budget
from excite.designer.options import DesignOptions
from excite.robot import limits, robot

FOLDER = Path(__file__).resolve().parent.parent / "trajectories"
"""Folder of the trajectories."""


def main() -> None:
    """Design the trajectories."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=list(robot.builtin_names()))
    parser.add_argument("-o", dest="out", type=Path, default=FOLDER)
    arguments = parser.parse_args()
    for name in arguments.robots:
        machine = robot.load(name)
        table = limits.resolve(machine)
        options = time_budget.MotionRequest().complete(DesignOptions(starts=4), table)
        cell = scene_file.build_cell(machine, table, scene_file.Scene())
        delivery = pipeline.design_trajectory(
            machine, table, options, cell=cell, progress=lambda text: print(text, file=sys.stderr)
        )
        arguments.out.mkdir(parents=True, exist_ok=True)
        file = f"{name}.json"
        written = output_files(arguments.out / file).replace(
            {file: _json.dumps(delivery.trajectory.document())}
        )
        value = delivery.trajectory.criteria["optimum"]["geometric"]["a"]
        length, spent = delivery.trajectory.motion.duration, delivery.timing["total"]
        print(
            f"{written[0]}: geometric a = {value:.5g}, {length:.1f} s long, "
            f"{spent:.1f} s to design; {delivery.trajectory.collision}"
        )


if __name__ == "__main__":
    main()
