#!/usr/bin/env python
"""How well recordings are turned into parameters, and how fast: Markdown tables, all from one run.

1. Real machines (--data FOLDER): torque error on a recording that was not used, joint by joint.
2. Poor data: what a prior's distance is worth where recordings say little. Robots that differ from the URDF by 20 % per direction in
   the metric are recorded (by Pinocchio's inverse dynamics, not by a regressor) and judged on motions they never made.
3. Time and memory for a million samples of a seven-axis arm, from the file to consistent parameters.
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

Array = np.ndarray
TRAJECTORIES = Path(__file__).resolve().parent.parent / "trajectories"
REAL = {
    "EMPS": ("emps/emps.urdf", ("train",), "validate_pulses", 25.0),
    "TX40": ("tx40/tx40.urdf", ("train",), "validate", None),
    "KUKA KR300": ("kuka_kr300/kuka_kr300.urdf", ("traj_A", "traj_B"), "traj_C", None),
}
RATE = 250.0
NOISE = 0.01  # of the torque limits
ROBOTS = 8


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> None:
    lines = ["| " + " | ".join(row) + " |" for row in (head, *rows)]
    lines.insert(1, "|---|" + "---:|" * (len(head) - 1))
    print(f"\n### {title}\n\n" + "\n".join(lines) + (f"\n\n{note}" if note else ""), flush=True)


def model_of(machine: Robot) -> tuple[IdentificationModel, limits.Limits]:
    table = limits.resolve(machine)
    standard = inertial_parameters.standard(machine, table)
    return IdentificationModel(
        machine,
        standard,
        base_parameters.find(machine, standard, table),
        np.full(machine.n, COULOMB_WIDTH),
    ), table


def identified(
    model: IdentificationModel, train: Sequence[Recording], held_out: Sequence[Recording], options: IdentificationOptions
) -> Identification:
    return identification.identify(
        model.robot, model.parameters, model.base, train, held_out, options
    )


# -- real machines ---------------------------------------------------------------------------------------------------


def real(folder: Path) -> None:
    rows = []
    for name, (urdf, train, held_out, band) in REAL.items():
        path = folder / urdf
        model, table = model_of(robot.load(str(path)))
        first, (last,) = (
            [recordings.read(path.parent / f"{one}.csv", model.robot, table) for one in names]
            for names in (train, (held_out,))
        )
        found = identified(model, first, [last], IdentificationOptions(band=band))
        prediction = found.validations[0]
        for i, joint in enumerate(model.robot.joints):
            floor = (
                "no repeated period" if prediction.noise_floor is None else f"{prediction.noise_floor[i]:.3g}"
            )
            errors = f"{prediction.error('nominal')[i]:.4g}", f"{prediction.error()[i]:.4g}"
            rows.append(
                [
                    f"{name}, {joint}",
                    f"{found.spectra.hertz:.3g}",
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


# -- poor data -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Truth:
    """A robot whose bodies and drives are not the URDF's."""

    model: IdentificationModel
    psi: Array

    def recording(
        self, fourier: FourierSeries, duration: float, noise: Array, rng: np.random.Generator
    ) -> Recording:
        machine, standard = self.model.robot, self.model.parameters
        t = np.arange(round(duration * RATE) + 1) / RATE
        s = fourier.samples(t)
        own = machine.model.copy()
        for i in range(standard.bodies):
            own.inertias[i + 1] = pin.Inertia.FromDynamicParameters(self.psi[10 * i : 10 * i + 10])
        data = own.createData()
        tau = np.array(
            [pin.rnea(own, data, *state) for state in zip(s.q, s.dq, s.ddq, strict=True)]
        )
        inertia, viscous, coulomb, offset = (
            self.psi[standard.block(kind)] for kind in standard.drive
        )
        tau += inertia * s.ddq + viscous * s.dq + coulomb * np.tanh(s.dq / COULOMB_WIDTH) + offset
        tau += noise * rng.normal(size=tau.shape)
        return Recording("made", machine.joints, t, s.q, tau=tau, sidecar=Sidecar(), own_times=t)


def true_psi(standard: Parameters, torque: Array, rng: np.random.Generator) -> Array:
    """20 % off in every direction of the bodies, 3 % of the torque limit of friction; drawn again until it is a robot."""
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
    stiff = np.ones((fourier.n, 1))
    stiff[fourier.n // 2] = 1e-3
    stuck = FourierSeries(stiff * fourier.sine, stiff * fourier.cosine, fourier.offset, fourier.period)
    still = FourierSeries(0.0 * fourier.sine, 0.0 * fourier.cosine, fourier.offset, fourier.period)
    return {
        "two periods": (fourier, 2.0 * fourier.period),
        f"joint {fourier.n // 2 + 1} hardly moves": (stuck, 10.0),
        "2 s": (fourier, 2.0),
        "stands still": (still, 10.0),
    }


def poor(name: str) -> None:
    model, table = model_of(robot.load(name))
    fourier = trajectory_file.read_trajectory(TRAJECTORIES / f"{name}.json").motion.fourier
    noise = NOISE * table.torque
    totals: dict[tuple[str, Distance], list[float]] = {}
    seen: dict[str, list[int]] = {}
    for seed in range(ROBOTS):
        rng = np.random.default_rng(seed)
        truth = Truth(model, true_psi(model.parameters, table.torque, rng))
        turned = fourier.shifted(0.3 * fourier.period)
        other = FourierSeries(
            np.roll(turned.sine, 1, axis=1) * 0.7,
            -np.roll(turned.cosine, 1, axis=1) * 0.7,
            fourier.offset,
            fourier.period,
        )
        judge = truth.recording(other, 10.0, 0.0 * noise, rng)
        for case, (motion, duration) in poor_motions(fourier).items():
            train = truth.recording(motion, duration, noise, rng)
            for kind in Distance:
                found = identified(model, [train], [judge], IdentificationOptions(distance=kind, band=20.0))
                error = np.sqrt(np.mean((found.validations[0].error() / noise) ** 2))
                totals.setdefault((case, kind), []).append(float(error))
            seen.setdefault(case, []).append(found.analysis.identifiable_count)
    rows = [
        [
            f"{name}, {case}",
            f"{np.mean(seen[case]):.0f} of {model.base.count}",
            *(f"{np.median(totals[case, kind]):.3g}" for kind in Distance),
        ]
        for case in seen
    ]
    note = f"Torque error on another motion over the noise's standard deviation, all joints; median over {ROBOTS} robots; γ by evidence."
    show("Poor data", ["", "identified", *(kind.value for kind in Distance)], rows, note)


# -- speed -----------------------------------------------------------------------------------------------------------


def speed(rows: int = 1_000_000, rate: float = 1000.0) -> None:
    model, table = model_of(robot.load("panda"))
    fourier = trajectory_file.read_trajectory(TRAJECTORIES / "panda.json").motion.fourier
    rng = np.random.default_rng(0)
    truth = Truth(model, true_psi(model.parameters, table.torque, rng))
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
        begun = time.perf_counter()
        recording = recordings.read(path, model.robot, table)
        read = time.perf_counter()
        found = identified(model, [recording], [], IdentificationOptions())
        done = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    head = ["", "reading [s]", "identifying [s]", "together [s]", "peak memory [GB]", "rows kept"]
    cells = [f"{v:.1f}" for v in (read - begun, done - read, done - begun)]
    show(
        "A million samples of a seven-axis arm",
        head,
        [["panda", *cells, f"{peak:.2f}", str(len(found.equations))]],
    )


def main() -> None:
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
    if "3" in wanted:  # first: peak memory is the process's
        speed()
    if "1" in wanted and arguments.data is not None:
        real(arguments.data)
    if "2" in wanted:
        poor("ur10e")


if __name__ == "__main__":
    main()
