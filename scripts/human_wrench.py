#!/usr/bin/env python
"""Identify a human on a force plate, and compare distances of the prior on held-out data.

The recording `human_wrench` of the shared folder is cut at 60 % of its rows. Each model is
identified from the first part alone with `excite identify --floating` (its cutoff frequencies, the
weights of its rows and γ included), saved, read back by `excite predict`, and judged once on the
second part as the recording's README prescribes: wrench about the pelvis in the axes of the world,
measured wrench and pose low-passed at 4 Hz (4th order, zero phase), every second row, first and
last 2 s left out.

    python scripts/human_wrench.py [FOLDER]   # default: ../shared/recordings/human_wrench
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy import signal

from excite.api import identify_floating, predict
from excite.identification.floating_regression import about_base_origin
from excite.robot.inertial_parameters import pseudo_inertia

SHARED = Path(os.environ.get("EXCITE_SHARED", Path(__file__).resolve().parents[2] / "shared"))
TRAINING_SHARE = 0.6
"""Share of the judged rows before the cut [1]."""
DISCARDED_ROWS = 60
"""Rows at either end that are not judged: 2 s."""
FILTER_HZ = 4.0
"""Cutoff frequency of the measured wrench and pose [Hz]."""
KEEP_NOMINAL = 1e7
"""γ that keeps the nominal bodies: relative deviations of 0.02 %."""
PILOT = {
    "URDF's bodies (README)": (19.0, 29.5, 22.6, 12.1, 14.2, 3.3),
    "Euclidean prior, γ on the test part (README)": (11.8, 23.6, 22.1, 7.1, 7.4, 3.6),
    "pullback prior, γ on the test part (README)": (11.3, 23.4, 21.4, 5.9, 7.6, 2.9),
}
"""Baselines of the recording's README: RMSE of fx fy fz [N], mx my mz [N m]."""
MODELS: dict[str, dict[str, object]] = {
    "URDF's bodies, bands and offsets of the training part": {"gamma": KEEP_NOMINAL},
    "Bregman prior (default)": {},
    "pullback prior": {"distance": "pullback"},
    "Euclidean prior": {"distance": "euclidean"},
    "Bregman prior, --symmetric left_:right_": {"symmetric": ("left_", "right_")},
    "Bregman prior, --band 4": {"band": FILTER_HZ},
}
"""Options of `identify_floating` by name."""


def filtered(values: np.ndarray, rate: float) -> np.ndarray:
    """Low-pass filter of the README."""
    return signal.sosfiltfilt(signal.butter(4, FILTER_HZ, fs=rate, output="sos"), values, axis=0)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=SHARED / "recordings" / "human_wrench")
    parser.add_argument("--json", metavar="FILE", help="write the errors to a file, too")
    options = parser.parse_args()
    folder = Path(options.folder)
    lines = (folder / "motion.csv").read_text(encoding="utf-8").splitlines()
    names = lines[0].split(",")
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    rate = 1.0 / float(np.median(np.diff(table[:, 0])))
    columns = {name: table[:, i] for i, name in enumerate(names)}
    pose = np.column_stack(
        [columns[f"base.{axis}"] for axis in "xyz"] + [np.zeros((len(table), 4))]
    )
    wrench = np.column_stack([columns[name] for name in ("fx", "fy", "fz", "mx", "my", "mz")])
    pose, wrench = filtered(pose, rate), filtered(wrench, rate)
    measured = about_base_origin(wrench, pose)
    judged = np.arange(DISCARDED_ROWS, len(table) - DISCARDED_ROWS, 2)
    held_out = judged[int(TRAINING_SHARE * len(judged)) :]
    cut = int(held_out[0])
    results: dict[str, tuple[float, ...]] = dict(PILOT)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        (work / "training.csv").write_text("\n".join(lines[: 1 + cut]) + "\n", encoding="utf-8")
        (work / "held_out.csv").write_text(
            "\n".join([lines[0], *lines[1 + cut :]]) + "\n", encoding="utf-8"
        )
        for label, choices in MODELS.items():
            start = time.perf_counter()
            result = identify_floating(
                str(folder / "human.urdf"), [work / "training.csv"], **choices
            )
            result.save(work / "model")
            predicted = predict(work / "model" / "model.json", work / "held_out.csv").values
            error = measured[held_out] - about_base_origin(predicted, pose[cut:])[held_out - cut]
            results[label] = tuple(np.sqrt(np.mean(error**2, axis=0)).tolist())
            document = json.loads((work / "model" / "model.json").read_text(encoding="utf-8"))
            values = np.array([entry["value"] for entry in document["standard_parameters"]])
            smallest = min(
                float(np.linalg.eigvalsh(pseudo_inertia(body))[0])
                for body in values.reshape(-1, 10)
            )
            print(
                f"{label}: γ {result.identification.prior.inertial_weight:.3g}, bands "
                f"{', '.join(f'{hertz:.2f}' for hertz in result.identification.hertz)} Hz, "
                f"{result.identification.analysis.identifiable_count} directions identified, "
                f"{sum(values[::10]):.2f} kg, consistent: {smallest > 0.0}, "
                f"{time.perf_counter() - start:.0f} s",
                flush=True,
            )
    width = max(map(len, results))
    print(f"{'':{width}}     fx     fy     fz     mx     my     mz")
    for label, errors in results.items():
        print(f"{label:{width}}" + "".join(f"{error:7.1f}" for error in errors))
    if options.json:
        Path(options.json).write_text(json.dumps(results), encoding="utf-8")


if __name__ == "__main__":
    main()
