#!/usr/bin/env python
"""Do the intervals hold? Robots of known parameters, recorded many times with fresh noise: how often do 95 % intervals hold the truth?

The robots come from `excite.plant`, which shares no code with the estimators. Directions are the eigenvectors of I·H₀⁻¹ that the
first recording identifies. Also printed: torque error on a motion that no estimate has seen, over the noise floor.
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
from excite.designer import identifiability, pipeline
from excite.designer.options import DesignOptions as DesignOptions
from excite.identification import estimators, identification
from excite.identification.identification import Identification, IdentificationOptions
from excite.identification.lowpass import LowPassFilter
from excite.recordings import Recording, Sidecar
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.simulator import experiment, recording_file
from excite.simulator.experiment import ExperimentSettings, SimulatedSession
from excite.simulator.measurement import MeasurementChain
from excite.trajectory import trajectory_file

Array = np.ndarray
FOLDER = Path(__file__).resolve().parent.parent
KINDS = ("train", "held out")
CORNER = 2.0  # Hz, of the coloured noise's low-pass


def taken(found: recording_file.SimulatedRecording, name: str) -> Recording:
    """A simulated recording, without the detour through a file."""
    side = Sidecar(period=found.period, periodic=found.periodic)
    return Recording(
        name,
        found.joints,
        found.t,
        found.q,
        tau=found.tau,
        qref=found.qref,
        sidecar=side,
        own_times=found.t,
    )


@dataclass(frozen=True)
class Bench:
    """A robot, what it truly is, and two motions of it."""

    name: str
    colour: float | None
    train: SimulatedSession
    held_out: SimulatedSession
    references: tuple[Any, Any]
    truth: Array

    def identified(self, seed: int) -> Identification:
        """From recordings with noise of that seed."""
        machine = robot.load(self.name)
        table = limits.resolve(machine)
        standard = inertial_parameters.standard(machine, table)
        generators = np.random.default_rng([seed, 5]).spawn(2)
        made = [
            taken(recording_file.measure(session.run, reference, session.chain, rng), kind)
            for session, reference, rng, kind in zip(
                (self.train, self.held_out), self.references, generators, KINDS, strict=True
            )
        ]
        return identification.identify(
            machine,
            standard,
            base_parameters.find(machine, standard, table),
            made[:1],
            made[1:],
            IdentificationOptions(),
        )


def bench(name: str, colour: float | None, folder: Path, periods: int) -> Bench:
    """Simulate the robot's own trajectory and another one."""
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
    references = tuple(experiment.references.read(path, periods) for path in (first, other))
    return Bench(name, colour, sessions[0], sessions[1], references, true_psi(sessions[0], machine))  # type: ignore[arg-type]


def true_psi(session: SimulatedSession, machine: robot.Robot) -> Array:
    """ψ of the simulated robot, read back from its URDF by Pinocchio."""
    model = pin.buildModelFromXML(session.plant.tree.text)
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


def one(setup: Bench, seed: int, frame: Array) -> tuple[Array, Array, Array]:
    """Errors of directions over their half-intervals, of base parameters likewise, held-out error over the floor."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = setup.identified(seed)
    off = found.data.theta - found.model.base.matrix @ setup.truth
    half = estimators.interval_half_widths(found.data, frame)
    own = estimators.interval_half_widths(found.data, np.eye(len(off)))
    validation = found.validations[0]
    return (
        frame @ off / half,
        off / own,
        validation.error() / floor(setup.held_out.chain, found.spectra.hertz),
    )


def floor(chain: MeasurementChain, hertz: float) -> Array:
    """RMS of the torque's noise as the estimator's filter leaves it, whose edge is not sharp. Shape (n,) [N m]."""
    edges = np.linspace(0.0, hertz, 201)[1:]
    power = np.diff([chain.floor(f) ** 2 for f in edges], axis=0, prepend=0.0)
    gain = LowPassFilter(hertz, chain.rate, 1).gain(edges, hertz)
    return np.sqrt(np.sum(gain[:, None] ** 2 * power, axis=0))


def main() -> None:
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
        "| robot | noise | directions | pooled | lowest | highest | base parameters, pooled | held-out error over floor, worst joint |"
    )
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    for name in arguments.robots:
        for colour in (None, CORNER):
            setup = bench(name, colour, arguments.folder, arguments.periods)
            first = setup.identified(0)
            values, vectors = identifiability.eigenvalues_and_directions(
                first.data.information_root @ first.model.base.matrix, first.metric_base
            )
            seen = values * first.options.threshold >= 1.0
            frame = vectors[:, seen].T @ np.linalg.inv(
                first.model.base.matrix @ first.metric_base.geometric
            )
            jobs = (
                joblib.delayed(one)(setup, seed, frame) for seed in range(1, arguments.runs + 1)
            )
            results = joblib.Parallel(n_jobs=-1, verbose=1)(jobs)
            direction, parameter, held = (np.array(part) for part in zip(*results, strict=True))
            inside = np.mean(np.abs(direction) <= 1.0, axis=0)
            pooled = np.mean(np.abs(parameter[np.isfinite(parameter)]) <= 1.0)
            noise = "white" if colour is None else f"low-passed at {colour:g} Hz"
            shares = [
                f"{100 * share:.1f} %"
                for share in (inside.mean(), inside.min(), inside.max(), pooled)
            ]
            error = np.sqrt(np.mean(held**2, axis=0)).max()
            print(
                f"| {name} | {noise} | {len(inside)} | {' | '.join(shares)} | {error:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
