#!/usr/bin/env python
"""Design motions of a humanoid in double support, and identify a simulated one with them.

Talos of the wheel example-robot-data (grippers locked, 30 joints) stands on both feet. Motions of
3 s from the standing pose and back are designed one after the other, each given the earlier ones,
for the six rows of the base with a noise of 0.5 N and 1.5 N m at 100 rows a second. The paper
(Lee, Lee and Park, Automatica 131, 2021) reports 70 of 204 directions identifiable at 1e-2.

With --identify the motions are simulated with true bodies that deviate at random, identified, and
judged along another motion: error of the ground reaction without noise, coverage of the intervals.

    python scripts/humanoid_support.py DATA [-o FOLDER] [--motions 20] [--identify]

DATA is the folder share/example-robot-data of the wheel.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from excite.api import (
    design_support,
    identify_floating,
    load_floating_robot,
    read_floating_recording,
    simulate_floating,
)
from excite.api.design_result import CellOptions
from excite.api.support_design_result import SupportDesignResult
from excite.designer.criteria import Criterion
from excite.designer.support_design import SupportOptions
from excite.designer.support_stance import SoleSize
from excite.identification import estimators, floating_regression
from excite.identification.estimators import Method
from excite.identification.floating_regression import FloatingModel
from excite.robot import floating_base
from excite.robot.floating_base import FloatingRobot, Rows
from excite.robot.inertial_parameters import COULOMB_WIDTH

TALOS = "robots/talos_data/robots/talos_reduced.urdf"
LOCKED = {"gripper_left_joint": 0.0, "gripper_right_joint": 0.0}
"""Joints whose URDF states a friction as large as their torque limit, with the locked position."""
FRAMES = ("left_sole_link", "right_sole_link")
SOLE = SoleSize(0.10, 0.06)
"""Half length and half width of a sole [m]."""
NOISE = (0.5, 1.5)
"""Standard deviation of force [N] and moment [N m] of the paper."""
MODEL_ERROR = 0.1
"""Standard deviation of the true bodies from the nominal ones in the metric [1]."""
COVERAGE_SEEDS = 4
"""Simulated robots over which the coverage of intervals is counted."""
COVERAGE_HZ = 8.0
"""Cutoff frequency of the rows when it is counted [Hz]."""


def designed(robot: FloatingRobot, arguments: argparse.Namespace) -> SupportDesignResult:
    """Design the motions, and print what they make identifiable."""
    options = SupportOptions(
        FRAMES,
        (SOLE, SOLE),
        count=arguments.motions,
        criterion=Criterion(arguments.criterion),
        iterations=arguments.iterations,
        wrench_noise=NOISE,
        seed=arguments.seed,
    )
    processor = time.process_time()
    result = design_support(
        robot,
        options,
        cell=CellOptions(check=arguments.distances),
        progress=lambda text: print(f"  {text}", flush=True),
    )
    design = result.design
    processor = time.process_time() - processor
    print(f"{design.seconds:.0f} s ({processor:.0f} s of processor time)")
    print("identifiable after each motion:", design.identifiable_counts())
    both = design.analysis(Rows.BOTH)
    print(f"with joint torques: {both.identifiable_count} of {len(both.directions)}")
    for line in design.certificate.verdict_lines():
        print(line)
    for kind in ("centre of pressure", "normal force", "friction", "turning friction", "torque"):
        nearest = min(
            (m for m in design.certificate.margins if m.limit == kind), key=lambda m: m.free_share
        )
        print(f"  {nearest.describe()}")
    return result


def judged(robot: FloatingRobot, folder: Path, arguments: argparse.Namespace) -> None:
    """Identify simulated robots with the motions, and print errors and coverage."""
    other = SupportOptions(FRAMES, (SOLE, SOLE), iterations=20, wrench_noise=NOISE, seed=77)
    unchecked = CellOptions(check=False)
    validation = design_support(robot, other, cell=unchecked, progress=lambda text: None)
    validation.save(folder / "validation")
    test_motion = floating_motion(validation)
    parameters = floating_base.standard_parameters(robot)
    base = floating_base.find_base_parameters(robot, parameters, Rows.BASE)
    Y = floating_base.regressor(robot, parameters, test_motion, Rows.BASE)
    motion = read_floating_recording(folder / "trajectory.csv", robot)
    widths = np.full(robot.n, COULOMB_WIDTH)
    model = FloatingModel(robot, parameters, base, Rows.BASE, ("world",), widths)
    covered: list[bool] = []
    for seed in range(COVERAGE_SEEDS):
        simulated = simulate_floating(
            robot, motion, seed=seed, wrench_noise=NOISE, model_error=MODEL_ERROR
        )
        path = folder / f"simulated_{seed}.csv"
        path.write_text(simulated.csv(), encoding="utf-8")
        recording = read_floating_recording(path, robot)
        true = np.array(list(simulated.truth["parameters"].values()))[: parameters.count]
        system = floating_regression.build_equations(model, [recording], np.full(6, COVERAGE_HZ))
        estimate = estimators.estimate(system.equations, Method.WLS, nuisance=system.offsets)
        half = estimators.interval_half_widths(estimate, np.eye(base.count))
        error = np.abs(estimate.theta - base.matrix @ true)
        finite = np.isfinite(half)
        covered += list((error <= half)[finite])
        print(f"  robot {seed}: {np.mean((error <= half)[finite]):.1%} of intervals", flush=True)
        if seed == 0:
            # a plate with free offsets hides the mass of whoever hardly accelerates upwards
            plates = {
                name: identify_floating(
                    robot, [recording], gamma=arguments.gamma, offsets=offsets
                ).identification.psi
                for name, offsets in (("identified", True), ("plate without offsets", False))
            }
            for name, psi in {"nominal": parameters.nominal, **plates}.items():
                rms = np.sqrt(np.mean((Y @ (psi - true)) ** 2, axis=0))
                print(f"  ground reaction along another motion, {name}: {np.round(rms, 4)}")
    print(f"intervals that contain the true value: {np.mean(covered):.1%} of {len(covered)}")


def floating_motion(result: SupportDesignResult) -> floating_base.FloatingMotion:
    """Return the motion of a design as exported."""
    from excite.designer.support_kinematics import support_samples

    design = result.design
    t = np.arange(design.samples_per_motion) / design.options.rate
    return support_samples(
        design.robot, design.stance, design.parameters, design.motions[0], t
    ).motion


def main() -> None:
    """Run the measurement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", dest="out", type=Path)
    parser.add_argument("--motions", type=int, default=20)
    parser.add_argument("--criterion", choices=("a", "d"), default="a")
    parser.add_argument("--iterations", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--identify", action="store_true")
    parser.add_argument(
        "--distances", action="store_true", help="keep bodies apart, which takes minutes a motion"
    )
    parser.add_argument("--gamma", type=float, default=10.0)
    arguments = parser.parse_args()
    robot = load_floating_robot(arguments.data / TALOS, lock=LOCKED)
    folder = arguments.out or Path(tempfile.mkdtemp(prefix="humanoid_"))
    result = designed(robot, arguments)
    print("\n".join(str(path) for path in result.save(folder)), flush=True)
    if arguments.identify:
        judged(robot, folder, arguments)


if __name__ == "__main__":
    main()
