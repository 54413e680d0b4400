#!/usr/bin/env python
"""Measure the coverage of 95 % intervals: robots of known parameters, recorded many times.

The robots come from `excite.simulator`, which shares no code with the estimators. Directions are
the eigenvectors of I·H₀⁻¹ that the first recording identifies. The torque error on a held-out
motion, over the noise floor, is printed as well.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import joblib
import numpy as np
import pinocchio as pin

from excite import _json
from excite._types import FloatArray
from excite.designer import identifiability, pipeline
from excite.designer.options import DesignOptions
from excite.identification import estimators, identification
from excite.identification.identification import Identification, IdentificationOptions
from excite.identification.lowpass import LowPassFilter
from excite.recordings import Recording, Sidecar
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.simulator import experiment, recording_file, reference_trajectory
from excite.simulator.experiment import ExperimentSettings, SimulatedSession
from excite.simulator.measurement import MeasurementChain
from excite.trajectory import trajectory_file

FOLDER = Path(__file__).resolve().parent.parent
KINDS = ("train", "held out")
CORNER = 2.0
"""Corner of the coloured noise's low-pass [Hz]."""


def as_recording(signals: recording_file.MeasuredSignals, name: str) -> Recording:
    """Return a simulated recording without writing a file."""
    side = Sidecar(period=signals.period, periodic=signals.periodic)
    return Recording(
        name,
        signals.joints,
        signals.t,
        signals.q,
        tau=signals.tau,
        qref=signals.qref,
        sidecar=side,
        row_times=signals.t,
    )


@dataclass(frozen=True)
class TestRobot:
    """A simulated robot and two motions of it.

    Attributes:
        name: Built-in robot.
        colour: Corner of the noise's low-pass [Hz]; None: white.
        train: Session of the training motion.
        held_out: Session of the held-out motion.
        references: Both commanded motions.
        truth: True parameters ψ.
    """

    name: str
    colour: float | None
    train: SimulatedSession
    held_out: SimulatedSession
    references: tuple[Any, Any]
    truth: FloatArray

    def identified(self, seed: int) -> Identification:
        """Identify from recordings with noise of a seed."""
        machine = robot.load(self.name)
        table = limits.resolve(machine)
        standard = inertial_parameters.standard(machine, table)
        generators = np.random.default_rng([seed, 5]).spawn(2)
        signals = [
            as_recording(
                recording_file.measure(session.motion, reference, session.chain, rng), kind
            )
            for session, reference, rng, kind in zip(
                (self.train, self.held_out), self.references, generators, KINDS, strict=True
            )
        ]
        return identification.identify(
            machine,
            standard,
            base_parameters.find(machine, standard, table),
            signals[:1],
            signals[1:],
            IdentificationOptions(),
        )


def simulate_robot(name: str, colour: float | None, folder: Path, periods: int) -> TestRobot:
    """Simulate the designed trajectory of a robot, and another one."""
    machine = robot.load(name)
    table = limits.resolve(machine)
    first = FOLDER / "trajectories" / f"{name}.json"
    other = folder / f"{name}.json"
    if not other.exists():
        period = trajectory_file.read_trajectory(first).motion.fourier.period
        delivery = pipeline.design_trajectory(
            machine, table, DesignOptions(period=period, seed=11, starts=1)
        )
        other.write_text(_json.dumps(delivery.trajectory.document()), encoding="utf-8")
    urdf = robot.locate(name)
    setting = ExperimentSettings(seed=3, colour=colour)
    sessions = [
        experiment.simulate(urdf, path, setting, periods=periods) for path in (first, other)
    ]
    references = tuple(
        reference_trajectory.read_reference(path, periods) for path in (first, other)
    )
    return TestRobot(
        name, colour, sessions[0], sessions[1], references, true_parameters(sessions[0], machine)
    )  # type: ignore[arg-type]


def true_parameters(session: SimulatedSession, machine: robot.Robot) -> FloatArray:
    """Return ψ of the simulated robot, read back from its URDF by Pinocchio."""
    model = pin.buildModelFromXML(session.robot.tree.xml)
    bodies = [
        model.inertias[model.getJointId(joint)].toDynamicParameters() for joint in machine.joints
    ]
    drive = session.truth["drive"]
    tail = [
        drive[key][joint]
        for key in ("inertia", "viscous", "coulomb", "offset")
        for joint in machine.joints
    ]
    return np.concatenate([*bodies, tail])


def run_once(
    setup: TestRobot, seed: int, frame: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return errors over half-intervals, of directions and base parameters; held-out errors.

    Held-out errors are over the noise floor.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = setup.identified(seed)
    error = result.data.theta - result.model.base.matrix @ setup.truth
    half_widths = estimators.interval_half_widths(result.data, frame)
    base_half_widths = estimators.interval_half_widths(result.data, np.eye(len(error)))
    validation = result.validations[0]
    return (
        frame @ error / half_widths,
        error / base_half_widths,
        validation.error() / filtered_noise_floor(setup.held_out.chain, result.spectra.hertz),
    )


def filtered_noise_floor(chain: MeasurementChain, hertz: float) -> FloatArray:
    """Return the RMS of the torque noise after the estimator's filter, shape (n,) [N m]."""
    edges = np.linspace(0.0, hertz, 201)[1:]
    power = np.diff([chain.noise_floor(f) ** 2 for f in edges], axis=0, prepend=0.0)
    gain = LowPassFilter(hertz, chain.rate, 1).gain(edges, hertz)
    return np.sqrt(np.sum(gain[:, None] ** 2 * power, axis=0))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robots", nargs="*", default=["ur10e", "panda"])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--periods", type=int, default=5)
    parser.add_argument("--folder", type=Path, default=Path("out/coverage"))
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    print(
        "| robot | noise | directions | pooled | lowest | highest | base parameters, pooled "
        "| held-out error over floor, worst joint |"
    )
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    for name in arguments.robots:
        for colour in (None, CORNER):
            setup = simulate_robot(name, colour, arguments.folder, arguments.periods)
            first = setup.identified(0)
            values, vectors = identifiability.eigenvalues_and_directions(
                first.data.information_root @ first.model.base.matrix, first.metric_base
            )
            identifiable = values * first.options.threshold >= 1.0
            frame = vectors[:, identifiable].T @ np.linalg.inv(
                first.model.base.matrix @ first.metric_base.geometric
            )
            jobs = (
                joblib.delayed(run_once)(setup, seed, frame)
                for seed in range(1, arguments.runs + 1)
            )
            results = joblib.Parallel(n_jobs=-1, verbose=1)(jobs)
            direction, parameter, held_out = (np.array(part) for part in zip(*results, strict=True))
            inside = np.mean(np.abs(direction) <= 1.0, axis=0)
            pooled = np.mean(np.abs(parameter[np.isfinite(parameter)]) <= 1.0)
            noise = "white" if colour is None else f"low-passed at {colour:g} Hz"
            shares = [
                f"{100 * share:.1f} %"
                for share in (inside.mean(), inside.min(), inside.max(), pooled)
            ]
            error = np.sqrt(np.mean(held_out**2, axis=0)).max()
            print(
                f"| {name} | {noise} | {len(inside)} | {' | '.join(shares)} | {error:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
