#!/usr/bin/env python
"""Measure the accuracy and speed of identification: Markdown tables, all from one run.

1. Real machines (--data FOLDER): torque error on a held-out recording, joint by joint.
2. Poor data: the value of each prior distance where recordings say little. Robots that differ from
   the URDF by 20 % per direction of the metric are recorded by Pinocchio's inverse dynamics (not by
   a regressor) and judged on other motions.
3. Time and memory for a million samples of a seven-axis arm, from file to consistent parameters.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
import pinocchio as pin

from excite import recordings
from excite._types import FloatArray
from excite.errors import ExciteWarning
from excite.identification import consistency, identification
from excite.identification.identification import Identification, IdentificationOptions
from excite.identification.inertia_distance import Distance
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording, Sidecar
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.robot.inertial_parameters import COULOMB_WIDTH, Parameters
from excite.robot.robot import Robot
from excite.trajectory import trajectory_file
from excite.trajectory.fourier import FourierSeries

TRAJECTORIES = Path(__file__).resolve().parent.parent / "trajectories"
"""Folder of the designed trajectories."""
REAL = {
    "EMPS": ("emps/emps.urdf", ("train",), "validate_pulses", 25.0),
    "TX40": ("tx40/tx40.urdf", ("train",), "validate", None),
    "KUKA KR300": ("kuka_kr300/kuka_kr300.urdf", ("traj_A", "traj_B"), "traj_C", None),
}
"""Real machines: URDF, training recordings, held-out recording, band [Hz]."""
RATE = 250.0
"""Sampling rate of the simulated recordings [Hz]."""
NOISE = 0.01
"""Standard deviation of the torque noise over the torque limit [1]."""
ROBOTS = 8
"""Random robots per case of section 2."""


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> None:
    """Print a Markdown table under a heading."""
    lines = ["| " + " | ".join(row) + " |" for row in (head, *rows)]
    lines.insert(1, "|---|" + "---:|" * (len(head) - 1))
    print(f"\n### {title}\n\n" + "\n".join(lines) + (f"\n\n{note}" if note else ""), flush=True)


def model_of(machine: Robot) -> tuple[IdentificationModel, limits.Limits]:
    """Return a robot's model with all parameters, and its limits."""
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    return IdentificationModel(
        machine,
        standard,
        base_parameters.find(machine, standard, table),
        np.full(machine.n, COULOMB_WIDTH),
    ), table


def identify(
    model: IdentificationModel,
    train: Sequence[Recording],
    held_out: Sequence[Recording],
    options: IdentificationOptions,
) -> Identification:
    """Identify a model from recordings."""
    return identification.identify(
        model.robot, model.parameters, model.base, train, held_out, options
    )


# -- real machines ----------------------------------------------------------------------------


def report_real_machines(folder: Path) -> None:
    """Print section 1."""
    rows = []
    for name, (urdf, train, held_out, band) in REAL.items():
        path = folder / urdf
        model, table = model_of(robot.load(str(path)))
        first, (last,) = (
            [
                recordings.read(path.parent / f"{recording}.csv", model.robot, table)
                for recording in names
            ]
            for names in (train, (held_out,))
        )
        result = identify(model, first, [last], IdentificationOptions(band=band))
        prediction = result.validations[0]
        for i, joint in enumerate(model.robot.joints):
            floor = (
                "no repeated period"
                if prediction.noise_floor is None
                else f"{prediction.noise_floor[i]:.3g}"
            )
            errors = f"{prediction.error('nominal')[i]:.4g}", f"{prediction.error()[i]:.4g}"
            rows.append(
                [
                    f"{name}, {joint}",
                    f"{result.spectra.hertz:.3g}",
                    *errors,
                    f"{100 * prediction.relative()[i]:.1f} %",
                    floor,
                ]
            )
    show(
        "Real machines, held out",
        ["", "band [Hz]", "URDF [N m]", "identified [N m]", "relative", "noise [N m]"],
        rows,
    )


# -- poor data --------------------------------------------------------------------------------


@dataclass(frozen=True)
class TrueRobot:
    """A robot whose bodies and actuators differ from the URDF.

    Attributes:
        model: Model of the URDF.
        psi: True parameters ψ.
    """

    model: IdentificationModel
    psi: FloatArray

    def recording(
        self, fourier: FourierSeries, duration: float, noise: FloatArray, rng: np.random.Generator
    ) -> Recording:
        """Return a recording of a Fourier motion."""
        machine, standard = self.model.robot, self.model.parameters
        t = np.arange(round(duration * RATE) + 1) / RATE
        s = fourier.samples(t)
        rigid_model = machine.model.copy()
        for i in range(standard.bodies):
            rigid_model.inertias[i + 1] = pin.Inertia.FromDynamicParameters(
                self.psi[10 * i : 10 * i + 10]
            )
        data = rigid_model.createData()
        tau = np.array(
            [pin.rnea(rigid_model, data, *state) for state in zip(s.q, s.dq, s.ddq, strict=True)]
        )
        inertia, viscous, coulomb, offset = (
            self.psi[standard.block(kind)] for kind in standard.drive
        )
        tau += inertia * s.ddq + viscous * s.dq + coulomb * np.tanh(s.dq / COULOMB_WIDTH) + offset
        tau += noise * rng.normal(size=tau.shape)
        return Recording(
            "synthetic", machine.joints, t, s.q, tau=tau, sidecar=Sidecar(), row_times=t
        )


def draw_true_parameters(
    standard: Parameters, torque: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Draw consistent parameters: 20 % off in every direction of the bodies, with friction.

    Coulomb friction is about 3 % of the torque limit.
    """
    edge = 10 * standard.bodies
    while True:
        psi = consistency.consistent_nominal(standard)
        psi[:edge] += 0.2 * standard.scale[:edge, :edge] @ rng.normal(size=edge)
        for kind, share in (
            ("rotor_inertia", 1e-3),
            ("viscous", 0.01),
            ("coulomb", 0.03),
            ("offset", 0.003),
        ):
            psi[standard.block(kind)] = share * torque * rng.uniform(0.5, 1.5, len(torque))
        if consistency.is_consistent(standard, psi):
            return psi


def poor_motions(fourier: FourierSeries) -> dict[str, tuple[FourierSeries, float]]:
    """Return motions that say little, with their durations [s]."""
    factors = np.ones((fourier.n, 1))
    factors[fourier.n // 2] = 1e-3
    one_joint_stuck = FourierSeries(
        factors * fourier.sine, factors * fourier.cosine, fourier.offset, fourier.period
    )
    standing = FourierSeries(
        0.0 * fourier.sine, 0.0 * fourier.cosine, fourier.offset, fourier.period
    )
    return {
        "two periods": (fourier, 2.0 * fourier.period),
        f"joint {fourier.n // 2 + 1} hardly moves": (one_joint_stuck, 10.0),
        "2 s": (fourier, 2.0),
        "stands still": (standing, 10.0),
    }


def report_poor_data(name: str) -> None:
    """Print section 2."""
    model, table = model_of(robot.load(name))
    fourier = trajectory_file.read_trajectory(TRAJECTORIES / f"{name}.json").motion.fourier
    noise = NOISE * table.torque
    totals: dict[tuple[str, Distance], list[float]] = {}
    identified_counts: dict[str, list[int]] = {}
    for seed in range(ROBOTS):
        rng = np.random.default_rng(seed)
        truth = TrueRobot(model, draw_true_parameters(model.parameters, table.torque, rng))
        shifted = fourier.shifted(0.3 * fourier.period)
        other = FourierSeries(
            np.roll(shifted.sine, 1, axis=1) * 0.7,
            -np.roll(shifted.cosine, 1, axis=1) * 0.7,
            fourier.offset,
            fourier.period,
        )
        test_recording = truth.recording(other, 10.0, 0.0 * noise, rng)
        for case, (motion, duration) in poor_motions(fourier).items():
            train = truth.recording(motion, duration, noise, rng)
            for kind in Distance:
                result = identify(
                    model,
                    [train],
                    [test_recording],
                    IdentificationOptions(distance=kind, band=20.0),
                )
                error = np.sqrt(np.mean((result.validations[0].error() / noise) ** 2))
                totals.setdefault((case, kind), []).append(float(error))
            identified_counts.setdefault(case, []).append(result.analysis.identifiable_count)
    rows = [
        [
            f"{name}, {case}",
            f"{np.mean(identified_counts[case]):.0f} of {model.base.count}",
            *(f"{np.median(totals[case, kind]):.3g}" for kind in Distance),
        ]
        for case in identified_counts
    ]
    note = "Torque error on another motion over the noise's standard deviation, all joints; "
    note += f"median over {ROBOTS} robots; γ by evidence."
    show("Poor data", ["", "identified", *(kind.value for kind in Distance)], rows, note)


# -- speed ------------------------------------------------------------------------------------


def report_speed(rows: int = 1_000_000, rate: float = 1000.0) -> None:
    """Print section 3."""
    model, table = model_of(robot.load("panda"))
    fourier = trajectory_file.read_trajectory(TRAJECTORIES / "panda.json").motion.fourier
    rng = np.random.default_rng(0)
    truth = TrueRobot(model, draw_true_parameters(model.parameters, table.torque, rng))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.csv"
        piece = truth.recording(fourier, 40.0, 0.0 * table.torque, rng)
        names = [f"{kind}.{joint}" for kind in ("q", "tau") for joint in model.robot.joints]
        with path.open("w", encoding="utf-8") as stream:
            stream.write(",".join(["t", *names]) + "\n")
            for start in range(0, rows, 10_000):
                t = (start + np.arange(10_000)) / rate
                s = fourier.at(t)
                tau = np.column_stack(
                    [np.interp(t % (7 * fourier.period), piece.t, c) for c in piece.tau.T]
                )
                block = np.hstack(
                    [t[:, None], s, tau + NOISE * table.torque * rng.normal(size=tau.shape)]
                )
                np.savetxt(stream, block, fmt="%.8g", delimiter=",")
        start = time.perf_counter()
        recording = recordings.read(path, model.robot, table)
        after_reading = time.perf_counter()
        result = identify(model, [recording], [], IdentificationOptions())
        after_fit = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    head = ["", "reading [s]", "identifying [s]", "together [s]", "peak memory [GB]", "rows kept"]
    cells = [
        f"{v:.1f}" for v in (after_reading - start, after_fit - after_reading, after_fit - start)
    ]
    show(
        "A million samples of a seven-axis arm",
        head,
        [["panda", *cells, f"{peak:.2f}", str(len(result.equations))]],
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--data", type=Path, metavar="FOLDER", help="real recordings: emps, tx40, kuka_kr300"
    )
    parser.add_argument("--only", default="1,2,3", metavar="N,…", help="these sections alone")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", ExciteWarning)
    wanted = set(arguments.only.split(","))
    if "3" in wanted:  # first, because peak memory is that of the process
        report_speed()
    if "1" in wanted and arguments.data is not None:
        report_real_machines(arguments.data)
    if "2" in wanted:
        report_poor_data("ur10e")


if __name__ == "__main__":
    main()
