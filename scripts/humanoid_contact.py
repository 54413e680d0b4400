#!/usr/bin/env python
"""Design motions of a humanoid on both feet, simulate them with contact, and identify the robot.

Talos as in `humanoid_support.py`. The robot of the recordings is MuJoCo's: free base, soles on a
floor with friction, position servos, bodies that deviate from the URDF by MODEL_ERROR. Printed are
the errors of the ground reaction along a motion that is held out, and the coverage of the 95 %
intervals of the base parameters.

    python scripts/humanoid_contact.py DATA [-o FOLDER] [--motions 5] [--iterations 40]

DATA is the folder share/example-robot-data of the wheel.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from humanoid_support import FRAMES, LOCKED, SOLE, TALOS

from excite.api import design_support, identify_floating, load_floating_robot, simulate_standing
from excite.api.design_result import CellOptions
from excite.designer.support_design import SupportOptions
from excite.identification import estimators

NOISE = (0.5, 0.15)
"""Standard deviation of force [N] and moment [N m] of the sensor in each foot."""
MODEL_ERROR = 0.1
"""Standard deviation of the true bodies from the nominal ones in the metric [1]."""


def main() -> None:
    """Run the measurement."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", dest="out", type=Path)
    parser.add_argument("--motions", type=int, default=5)
    parser.add_argument("--iterations", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    robot = load_floating_robot(arguments.data / TALOS, lock=LOCKED)
    folder = arguments.out or Path(tempfile.mkdtemp(prefix="contact_"))
    recordings = []
    for name, count, seed in (("motions", arguments.motions, 0), ("validation", 1, 7)):
        options = SupportOptions(
            FRAMES,
            (SOLE, SOLE),
            count=count,
            seed=seed,
            iterations=arguments.iterations,
            starts=2,
            wrench_noise=NOISE,
        )
        designed = design_support(
            robot, options, cell=CellOptions(check=False), progress=lambda text: None
        )
        designed.save(folder / name)
        start = time.perf_counter()
        recording = simulate_standing(
            robot,
            folder / name / "trajectory.json",
            wrench_noise=NOISE,
            model_error=MODEL_ERROR,
            seed=arguments.seed,
        )
        standing = recording.truth["standing"]
        identifiable = designed.design.identifiable_counts()[-1]
        print(
            f"{name}: {identifiable} directions expected, simulated in "
            f"{time.perf_counter() - start:.0f} s, tracking error "
            f"{1e3 * max(standing['tracking_error'].values()):.1f} mrad, slip "
            f"{1e3 * standing['slip']:.1f} mm",
            flush=True,
        )
        recordings.append(recording.save(folder / f"{name}.csv")[0])
    result = identify_floating(
        robot, recordings[:1], validate=recordings[1:], rows="base"
    ).identification
    prediction, base = result.validations[0], result.model.base
    print(f"{result.analysis.identifiable_count} of {base.count} directions identified")
    print("error held out, URDF:      ", np.round(prediction.error("nominal"), 3))
    print("error held out, identified:", np.round(prediction.error(), 3))
    true = np.array(list(recording.truth["parameters"].values()))[: result.model.parameters.count]
    half = estimators.interval_half_widths(result.data, np.eye(base.count))
    finite = np.isfinite(half)
    error = np.abs(result.data.theta - base.matrix @ true)
    print(
        f"95 % intervals: {np.mean((error <= half)[finite]):.1%} of {finite.sum()} cover the truth"
    )


if __name__ == "__main__":
    main()
