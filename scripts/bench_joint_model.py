"""Does the diagnosis name the frictions of dense, half-dense and plain simulated robots?

    python scripts/bench_joint_model.py [--count 6] [--first 0] [--families dense half null]

Every robot has three random motions of 26 s; two are fitted, the third is held out. On a dense
robot every joint has all frictions, on a half-dense one each with probability ½ (so that naming
them without looking is wrong half of the time), on a plain one ("null") none is hidden. The table
counts effect and joint of the findings; an effect counts as present if the residual of the joint
model grows by at least one noise floor without it, given all others.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from concealed_trial.case_plan import CaseSpec
from concealed_trial.generate_cases import case_settings
from concealed_trial.random_excitation import draw_excitation

from excite import api
from excite._types import FloatArray
from excite.diagnosis import posterior
from excite.robot.robot import locate
from excite.simulator import dense_robot
from excite.simulator.effect_instance import EffectInstance, with_effects
from excite.simulator.experiment import build_robot, run_session
from excite.simulator.recording_file import json_text
from excite.simulator.reference_trajectory import ReferenceTrajectory
from excite.simulator.urdf_tree import read_urdf

ROBOTS = ("ur10e", "iiwa14", "ur5e", "panda", "tx40", "fr3")
"""Built-in robots, one after the other."""
FAMILIES = {"dense": 1.0, "half": 0.5, "null": None}
"""Probability of each friction at each joint; None: nothing is hidden."""
PERIODS = 3
"""Periods of 8 s in each motion."""
TIME_STEP = 2e-3
"""Time step of the simulation [s]."""
NOISE_BAND = 20.0
"""Frequency below which the noise floor is stated [Hz]."""


@dataclass(frozen=True)
class SimulatedCase:
    """A simulated robot and its recordings.

    Attributes:
        robot: Name of the built-in robot.
        effects: The hidden effects.
        noise: Noise floor of each joint, shape (n,) [N m].
        folder: Folder of train1.csv, train2.csv and validate.csv.
    """

    robot: str
    effects: tuple[EffectInstance, ...]
    noise: FloatArray
    folder: Path


def simulate_case(family: str, seed: int, folder: Path) -> SimulatedCase:
    """Simulate a case; the same family and seed give the same numbers."""
    rng = np.random.default_rng([seed, list(FAMILIES).index(family)])
    name = ROBOTS[seed % len(ROBOTS)]
    spec = CaseSpec(seed, family, name, "single", False, (), (), "none", "tuning", seed)
    settings = case_settings(spec)
    path = locate(name)
    joints = read_urdf(path).joints
    still = ReferenceTrajectory(joints, lambda t: (t, t, t), 0.0, 1.0, (0.0, 1.0), {})
    robot = replace(build_robot(path, still, settings), step=TIME_STEP)
    motions = [draw_excitation(robot, PERIODS, rng) for _ in range(3)]
    effects: tuple[EffectInstance, ...] = ()
    probability = FAMILIES[family]
    if probability is not None:
        chosen = replace(dense_robot.DenseSettings(), friction_probability=probability)
        load = dense_robot.static_load(robot, motions[0])
        effects = dense_robot.draw_dense_effects(robot, load, rng, chosen)
    noise = np.zeros(0)
    for motion, file in zip(motions, ("train1", "train2", "validate"), strict=True):
        session = run_session(with_effects(robot, effects), motion, settings)
        (folder / f"{file}.csv").write_text(session.recording.to_csv(), encoding="utf-8")
        sidecar = json_text({**session.recording.to_sidecar(), "notes": ""})
        (folder / f"{file}.json").write_text(sidecar, encoding="utf-8")
        noise = session.chain.noise_floor(NOISE_BAND)
    return SimulatedCase(name, effects, noise, folder)


@dataclass(frozen=True)
class CaseScore:
    """Counts of a case.

    Attributes:
        named: Findings, by effect and joint.
        right: Those among them that are there.
        strong: Effects worth at least one noise floor.
        strong_named: Those among them that are named.
        ratio: Held-out RMSE over the noise floor, geometric mean over the joints.
        base_ratio: The same of the base model.
        seconds: Processor time of the diagnosis [s].
    """

    named: int
    right: int
    strong: int
    strong_named: int
    ratio: float
    base_ratio: float
    seconds: float


def score_case(case: SimulatedCase) -> CaseScore:
    """Diagnose a case and compare the findings with the truth."""
    train = [case.folder / f"{name}.csv" for name in ("train1", "train2")]
    begin = time.process_time()
    result = api.diagnose(
        case.robot, train, [case.folder / "validate.csv"], with_report=False
    ).diagnosis
    seconds = time.process_time() - begin
    model, joints = result.model, result.identified.model.robot.joints
    truth = {(e.name, joints.index(e.joint)) for e in case.effects if e.joint is not None}
    severity = {
        key: float((posterior.evidence_of(model, members).growth / case.noise).max())
        for key, members in posterior.effect_groups(model).items()
    }
    named = {(e.effect, e.joint) for e in result.findings if e.joint is not None}
    strong = {key for key in truth if severity.get(key, np.inf) >= 1.0}
    before, after = (
        float(np.exp(np.mean(np.log(rmse / case.noise))))
        for rmse in (result.held_out.rmse_before, result.held_out.rmse_after)
    )
    return CaseScore(
        len(named), len(named & truth), len(strong), len(named & strong), after, before, seconds
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=6, help="robots of each family (default 6)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--families", nargs="+", default=list(FAMILIES), choices=FAMILIES)
    arguments = parser.parse_args(argv)
    print(
        "| family | robots | precision | recall at 1 noise floor | held-out RMSE / noise "
        "(base model) | s |\n|---|---|---|---|---|---|"
    )
    for family in arguments.families:
        scores = []
        for seed in range(arguments.first, arguments.first + arguments.count):
            with tempfile.TemporaryDirectory() as folder:
                scores.append(score_case(simulate_case(family, seed, Path(folder))))
        named, right, strong, strong_named = (
            sum(getattr(score, key) for score in scores)
            for key in ("named", "right", "strong", "strong_named")
        )
        print(
            f"| {family} | {len(scores)} | {right} of {named} | {strong_named} of {strong} | "
            f"{np.median([s.ratio for s in scores]):.2f} "
            f"({np.median([s.base_ratio for s in scores]):.1f}) | "
            f"{np.median([s.seconds for s in scores]):.1f} |",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
