"""Replay of unseen commands in MuJoCo by exported robots, before and after the identification.

    python scripts/bench_export.py [--count 20] [--first 0] [--diagnose]

Dense robots with a position servo are simulated along two random motions of 26 s. The robot and its
position loop are identified from the first, exported as MJCF, and driven in MuJoCo by the commands
of the second, for 20 s from one recorded state. "Before" is the URDF as given, with the same loop.
With --diagnose the model holds the effects that a diagnosis finds, and the friction module adds
what MJCF does not hold. The last line says whether mujoco.sysid could be run; it is not compared.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from concealed_trial.random_excitation import draw_excitation

import excite
from excite.api.model_export import read_simulator_model
from excite.api.replay_result import nominal_model
from excite.exporters import mujoco_replay
from excite.exporters.mjcf_file import HOLDS
from excite.exporters.mujoco_replay import Replay
from excite.robot.robot import locate
from excite.simulator import dense_robot
from excite.simulator.effect_instance import with_effects
from excite.simulator.experiment import ExperimentSettings, build_robot, run_session
from excite.simulator.recording_file import json_text
from excite.simulator.reference_trajectory import ReferenceTrajectory
from excite.simulator.urdf_tree import read_urdf

ROBOTS = ("ur10e", "iiwa14", "ur5e", "panda", "tx40", "fr3")
"""Built-in robots, one after the other."""
PERIODS = 3
"""Periods of 8 s in each motion."""
REPLAY_SECONDS = 20.0
"""Length of the replay [s]."""


@dataclass(frozen=True)
class CaseScore:
    """Errors of one robot, RMS over the joints.

    Attributes:
        robot: Its name.
        position: Position error before, after, and with the friction module [rad or m].
        torque: Motor torque error of the three, over the RMS torque [1].
        seconds: Time of identification and replay [s].
    """

    robot: str
    position: tuple[float, ...]
    torque: tuple[float, ...]
    seconds: float


def simulate_case(seed: int, folder: Path) -> str:
    """Write train.csv and unseen.csv of a dense robot; return the name of its model."""
    rng = np.random.default_rng([seed, 23])
    name = ROBOTS[seed % len(ROBOTS)]
    path, settings = locate(name), ExperimentSettings(seed=seed)
    joints = read_urdf(path).joints
    still = ReferenceTrajectory(joints, lambda t: (t, t, t), 0.0, 1.0, (0.0, 1.0), {})
    robot = build_robot(path, still, settings)
    motions = [draw_excitation(robot, PERIODS, rng) for _ in range(2)]
    load = dense_robot.static_load(robot, motions[0])
    effects = dense_robot.draw_dense_effects(robot, load, rng)
    for motion, file in zip(motions, ("train", "unseen"), strict=True):
        session = run_session(with_effects(robot, effects), motion, settings)
        (folder / f"{file}.csv").write_text(session.recording.to_csv(), encoding="utf-8")
        sidecar = json_text({**session.recording.to_sidecar(), "notes": ""})
        (folder / f"{file}.json").write_text(sidecar, encoding="utf-8")
    return name


def score_case(seed: int, with_diagnosis: bool) -> CaseScore:
    """Identify a robot from one motion and replay the commands of the other."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        name = simulate_case(seed, folder)
        start = time.perf_counter()
        train, unseen = folder / "train.csv", folder / "unseen.csv"
        if with_diagnosis:
            excite.diagnose(name, [train], [train]).save(folder / "model")
        else:
            excite.identify(name, [train]).save(folder / "model")
        model = read_simulator_model(folder / "model" / "model.json", recording=None)
        fitted = model.model
        learnt = mujoco_replay.replay_input(
            fitted, excite.read_recording(train, fitted.robot), False
        )
        limits = mujoco_replay.torque_limits(model)
        loop = mujoco_replay.fit_position_loop(learnt, limits, str(train))
        data = mujoco_replay.replay_input(
            fitted, excite.read_recording(unseen, fitted.robot), False
        )
        end = int(np.searchsorted(data.t, REPLAY_SECONDS))
        robots = [(nominal_model(model), False), (model, False)]
        if model.remainders(HOLDS):
            robots.append((model, True))
        runs = [Replay(machine, data, loop, friction).run(0, end) for machine, friction in robots]
        assert data.torque is not None
        size = float(np.sqrt(np.mean(data.torque[:end] ** 2)))
        position = [_rms(np.nan_to_num(run.q, posinf=1e3) - data.motion.q[:end]) for run in runs]
        torque = [
            _rms(np.nan_to_num(run.torque, nan=1e3) - data.torque[:end]) / size for run in runs
        ]
        return CaseScore(name, tuple(position), tuple(torque), time.perf_counter() - start)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def sysid_state() -> str:
    """State of MuJoCo's own identification: its wheel holds it, its extra the packages it needs."""
    try:
        importlib.import_module("mujoco.sysid._src.optimize")
    except ModuleNotFoundError as error:
        return f"mujoco.sysid does not run here: {error}; it needs pip install 'mujoco[sysid]'"
    return f"mujoco.sysid of MuJoCo {mujoco.__version__} could be run; it is not compared yet"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=20, help="robots (default 20)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--diagnose", action="store_true", help="with the effects of a diagnosis")
    arguments = parser.parse_args(argv)
    print(
        "| seed | robot | position error [mrad] before / after | torque error / torque | s |\n"
        "|---|---|---|---|---|"
    )
    scores = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        score = score_case(seed, arguments.diagnose)
        scores.append(score)
        position = " / ".join(f"{1e3 * value:.3g}" for value in score.position)
        torque = " / ".join(f"{value:.3g}" for value in score.torque)
        print(
            f"| {seed} | {score.robot} | {position} | {torque} | {score.seconds:.0f} |", flush=True
        )
    ratios = [score.position[-1] / score.position[0] for score in scores]
    torques = np.median([score.torque[-1] / score.torque[0] for score in scores])
    better = sum(ratio < 1.0 for ratio in ratios)
    print(
        f"median position error after over before: {np.median(ratios):.2f}, torque {torques:.2f}; "
        f"better in {better} of {len(scores)}"
    )
    print(sysid_state())
    return 0


if __name__ == "__main__":
    sys.exit(main())
