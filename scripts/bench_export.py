"""Replay of unseen commands in MuJoCo by exported robots, before and after the identification.

    python scripts/bench_export.py [--count 20] [--first 0] [--diagnose]

Dense robots with a position servo are simulated along two random motions of 26 s. The robot and its
position loop are identified from the first, exported as MJCF, and driven in MuJoCo by the commands
of the second, for 20 s from one recorded state. "Before" is the URDF as given, with the same loop.
With --diagnose, a model with the effects that a diagnosis finds is replayed as well, without and
with the friction module, which adds what MJCF does not hold. "Noise-limited" is the same robot
without hidden effects, along the same motions with the same noise, identified and replayed in the
same way: the model is then exact, and what remains is due to measurement noise, the fitted position
loop and MuJoCo's integration. The last line says whether mujoco.sysid could be run; it is not
compared.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from concealed_trial.random_excitation import draw_excitation

import excite
from excite.api.model_export import read_simulator_model
from excite.api.replay_result import nominal_model
from excite.exporters import mujoco_replay
from excite.exporters.mjcf_file import HOLDS
from excite.exporters.mujoco_replay import PositionLoop, Replay, ReplayInput
from excite.exporters.simulator_model import SimulatorModel
from excite.robot.robot import locate
from excite.simulator import dense_robot
from excite.simulator.effect_instance import with_effects
from excite.simulator.experiment import ExperimentSettings, build_robot, run_session
from excite.simulator.mujoco_dynamics import build_dynamics
from excite.simulator.recording_file import json_text
from excite.simulator.reference_trajectory import ReferenceTrajectory
from excite.simulator.simulated_robot import SimulatedRobot
from excite.simulator.urdf_tree import read_urdf

ROBOTS = ("ur10e", "iiwa14", "ur5e", "panda", "tx40", "fr3")
"""Built-in robots, one after the other."""
PERIODS = 3
"""Periods of 8 s in each motion."""
REPLAY_SECONDS = 20.0
"""Length of the replay [s]."""

LARGEST_RATIO = 1.2
"""Position error over the noise-limited one that is required [1]."""


@dataclass(frozen=True)
class CaseScore:
    """Errors of one robot, RMS over the joints.

    Attributes:
        robot: Its name.
        position: Position error before and after the identification, and after a diagnosis
            without and with the friction module [rad or m].
        torque: Motor torque errors of the same, over the RMS torque [1].
        noise_limited: Position error after the identification of the same robot without hidden
            effects [rad or m].
        seconds: Time of identification and replay of the dense robot [s].
    """

    robot: str
    position: tuple[float, ...]
    torque: tuple[float, ...]
    noise_limited: float
    seconds: float


def simulate_case(seed: int, folder: Path) -> str:
    """Write train.csv and unseen.csv of a dense robot, and both of it without hidden effects into
    the folder `exact`; return the name of its model."""
    rng = np.random.default_rng([seed, 23])
    name = ROBOTS[seed % len(ROBOTS)]
    path, settings = locate(name), ExperimentSettings(seed=seed)
    joints = read_urdf(path).joints
    still = ReferenceTrajectory(joints, lambda t: (t, t, t), 0.0, 1.0, (0.0, 1.0), {})
    robot = build_robot(path, still, settings)
    motions = [draw_excitation(robot, PERIODS, rng) for _ in range(2)]
    load = dense_robot.static_load(robot, motions[0])
    effects = dense_robot.draw_dense_effects(robot, load, rng)
    (folder / "exact").mkdir()
    for place, machine in (
        (folder, with_effects(robot, effects)),
        (folder / "exact", robot),
    ):
        for motion, file in zip(motions, ("train", "unseen"), strict=True):
            servo = with_gains_of(machine, motions[0], motion)
            session = run_session(servo, motion, settings)
            (place / f"{file}.csv").write_text(session.recording.to_csv(), encoding="utf-8")
            sidecar = json_text({**session.recording.to_sidecar(), "notes": ""})
            (place / f"{file}.json").write_text(sidecar, encoding="utf-8")
    return name


def with_gains_of(
    robot: SimulatedRobot, first: ReferenceTrajectory, motion: ReferenceTrajectory
) -> SimulatedRobot:
    """Return a robot whose controller has the same gains along a motion as along the first.

    The simulator scales the gain of the speed loop with the inertia in the first pose of a motion;
    a servo does not.
    """
    dynamics = build_dynamics(robot.tree, robot.joints, robot.lock, robot.gravity)
    inertia = [
        np.diag(dynamics.mass_and_bias(q, np.zeros_like(q))[0]) + robot.actuators.inertia
        for q in (m.at(np.zeros(1))[0][0] for m in (first, motion))
    ]
    gains = replace(robot.gains, speed=robot.gains.speed * inertia[0] / inertia[1])
    return replace(robot, gains=gains)


@dataclass(frozen=True)
class ReplayCase:
    """Replays of the unseen commands.

    Attributes:
        model: The identified robot.
        data: The recording with the unseen commands.
        loop: The position loop, fitted to the training recording.
    """

    model: SimulatorModel
    data: ReplayInput
    loop: PositionLoop

    def errors(self, machine: SimulatorModel, with_friction: bool) -> tuple[float, float]:
        """Replay a robot for `REPLAY_SECONDS`.

        Args:
            machine: The robot.
            with_friction: Whether the friction module adds what MJCF does not hold.

        Returns:
            RMS position error [rad or m], and RMS torque error over the RMS torque [1].
        """
        end = int(np.searchsorted(self.data.t, REPLAY_SECONDS))
        run = Replay(machine, self.data, self.loop, with_friction).run(0, end)
        assert self.data.torque is not None
        torque = self.data.torque[:end]
        position = _rms(np.nan_to_num(run.q, posinf=1e3) - self.data.q[:end])
        return position, _rms(np.nan_to_num(run.torque, nan=1e3) - torque) / _rms(torque)


def identify_case(name: str, folder: Path, with_diagnosis: bool) -> ReplayCase:
    """Identify a robot and its position loop from train.csv, and read unseen.csv.

    A diagnosis takes no effects and no parameters from its validation recording, unseen.csv.
    """
    train, unseen = folder / "train.csv", folder / "unseen.csv"
    if with_diagnosis:
        excite.diagnose(name, [train], [unseen]).save(folder / "model")
    else:
        excite.identify(name, [train]).save(folder / "model")
    model = read_simulator_model(folder / "model" / "model.json", recording=None)
    robot = model.model.robot
    learnt, data = (
        mujoco_replay.replay_input(model.model, excite.read_recording(path, robot), False)
        for path in (train, unseen)
    )
    loop = mujoco_replay.fit_position_loop(learnt, mujoco_replay.torque_limits(model), str(train))
    return ReplayCase(model, data, loop)


def score_case(seed: int, with_diagnosis: bool) -> CaseScore:
    """Identify a robot from one motion and replay the commands of the other."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        name = simulate_case(seed, folder)
        start = time.perf_counter()
        case = identify_case(name, folder, False)
        errors = [case.errors(nominal_model(case.model), False), case.errors(case.model, False)]
        if with_diagnosis:
            case = identify_case(name, folder, True)
            errors.append(case.errors(case.model, False))
            errors.append(case.errors(case.model, bool(case.model.remainders(HOLDS))))
        seconds = time.perf_counter() - start
        exact = identify_case(name, folder / "exact", False)
        limit = exact.errors(exact.model, False)[0]
        return CaseScore(
            name, tuple(e[0] for e in errors), tuple(e[1] for e in errors), limit, seconds
        )


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
        "| seed | robot | position error [mrad] before / after | noise-limited | "
        "torque error / torque | s |\n|---|---|---|---|---|---|"
    )
    scores = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        score = score_case(seed, arguments.diagnose)
        scores.append(score)
        position = " / ".join(f"{1e3 * value:.3g}" for value in score.position)
        torque = " / ".join(f"{value:.3g}" for value in score.torque)
        print(
            f"| {seed} | {score.robot} | {position} | {1e3 * score.noise_limited:.3g} | {torque} | "
            f"{score.seconds:.0f} |",
            flush=True,
        )
    ratios = [score.position[-1] / score.position[0] for score in scores]
    torques = np.median([score.torque[-1] / score.torque[0] for score in scores])
    limited = [score.position[-1] / score.noise_limited for score in scores]
    better = sum(ratio < 1.0 for ratio in ratios)
    print(
        f"median position error after over before: {np.median(ratios):.2f}, torque {torques:.2f}; "
        f"better in {better} of {len(scores)}; over the noise-limited error: median "
        f"{np.median(limited):.2f}, at most {LARGEST_RATIO:g} in "
        f"{sum(ratio <= LARGEST_RATIO for ratio in limited)}"
    )
    print(sysid_state())
    return 0


if __name__ == "__main__":
    sys.exit(main())
