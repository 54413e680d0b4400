"""Replay of unseen commands in MuJoCo by exported robots, before and after the identification.

    python scripts/bench_export.py [--count 20] [--first 0] [--folder DIR] [--sysid SECONDS]

Dense robots with a position servo are simulated along two random motions of 26 s. The robot and its
position loop are identified from the first, exported as MJCF, and driven in MuJoCo by the commands
of the second, for 20 s from its first state: the URDF as given, the robot of `excite identify`, and
that of `excite diagnose`, without and with the friction module, which adds what MJCF does not hold.
All have the same loop, with the integrator's state at the start of the second motion. The position
error is the RMS over joints and time against the recorded positions.

"Noise-limited" is the same robot without hidden effects, along the same motions with the same
noise, identified and replayed in the same way: the form of the model is then exact, and what
remains is due to measurement noise in the parameters and in the position loop, and to MuJoCo's
integration. It has fewer parameters than any model of the dense robot. "Forms known" is what one
has to expect who knows the form of every hidden effect and fits all parameters: the noise-limited
error plus what the bound of `known_forms` adds for the parameters of the effects.

With --sysid, MuJoCo's own identification (`peers/mujoco_sysid.py`) gets the first motion as well,
for the stated processor time. With --folder, recordings, models and errors are kept, and a later
run continues where this one ended.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from concealed_trial.random_excitation import draw_excitation
from known_forms import KnownForms
from peers import mujoco_sysid

import excite
from excite.api.model_export import read_simulator_model
from excite.api.replay_result import nominal_model
from excite.exporters import mujoco_replay
from excite.exporters.mjcf_file import HOLDS
from excite.exporters.mujoco_replay import PositionLoop, Replay, ReplayInput
from excite.exporters.simulator_model import SimulatorModel
from excite.robot.robot import locate
from excite.simulator import dense_robot
from excite.simulator.effect_instance import EffectInstance, with_effects
from excite.simulator.experiment import (
    ExperimentSettings,
    build_robot,
    measurement_chain,
    run_session,
)
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
START_SECONDS = 1.0
"""Time from which the state of a loop's integrator is found [s]."""
VARIANTS = {
    "urdf": "URDF as given",
    "identified": "identified",
    "diagnosed": "diagnosed",
    "module": "with module",
    "sysid": "mujoco.sysid",
    "exact": "noise-limited",
    "known": "forms known",
}
"""Replayed robots: key in score.json and head of the column."""


@dataclass(frozen=True)
class ReplayCase:
    """Replays of the unseen commands.

    Attributes:
        model: The identified robot.
        learnt: The recording from which it was identified.
        data: The recording with the unseen commands.
        loop: The position loop, fitted to the training recording.
    """

    model: SimulatorModel
    learnt: ReplayInput
    data: ReplayInput
    loop: PositionLoop

    def errors(self, machine: SimulatorModel, with_friction: bool = False) -> tuple[float, float]:
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


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def robot_name(seed: int) -> str:
    """Return the built-in robot of a seed."""
    return ROBOTS[seed % len(ROBOTS)]


@dataclass(frozen=True)
class DenseCase:
    """A simulated robot and its motions.

    Attributes:
        robot: The robot without hidden effects.
        effects: Its hidden effects.
        motions: The motion that is learnt, and the one that is replayed.
        settings: How it is measured.
    """

    robot: SimulatedRobot
    effects: tuple[EffectInstance, ...]
    motions: tuple[ReferenceTrajectory, ReferenceTrajectory]
    settings: ExperimentSettings

    @classmethod
    def of(cls, seed: int) -> DenseCase:
        """Draw the case of a seed."""
        rng = np.random.default_rng([seed, 23])
        path, settings = locate(robot_name(seed)), ExperimentSettings(seed=seed)
        joints = read_urdf(path).joints
        still = ReferenceTrajectory(joints, lambda t: (t, t, t), 0.0, 1.0, (0.0, 1.0), {})
        robot = build_robot(path, still, settings)
        motions = draw_excitation(robot, PERIODS, rng), draw_excitation(robot, PERIODS, rng)
        load = dense_robot.static_load(robot, motions[0])
        effects = dense_robot.draw_dense_effects(robot, load, rng)
        return cls(robot, effects, motions, settings)

    def simulate(self, folder: Path) -> None:
        """Write train.csv and unseen.csv, and both without hidden effects into `exact`."""
        (folder / "exact").mkdir()
        for place, machine in (
            (folder, with_effects(self.robot, self.effects)),
            (folder / "exact", self.robot),
        ):
            for motion, file in zip(self.motions, ("train", "unseen"), strict=True):
                servo = with_gains_of(machine, self.motions[0], motion)
                session = run_session(servo, motion, self.settings)
                (place / f"{file}.csv").write_text(session.recording.to_csv(), encoding="utf-8")
                sidecar = json_text({**session.recording.to_sidecar(), "notes": ""})
                (place / f"{file}.json").write_text(sidecar, encoding="utf-8")

    def known_forms_error(self, case: ReplayCase, noise_limited: float) -> float:
        """Return the position error to expect of one who knows the form of every effect [rad].

        Args:
            case: The replay of a model of this robot, with the fitted position loop.
            noise_limited: Position error without hidden effects [rad].
        """
        chain = measurement_chain(self.robot, self.settings)
        forms = KnownForms(
            self.robot,
            self.effects,
            case.model.model,
            chain.noise_floor(0.5 * chain.rate),
            chain.rate,
        )
        end = int(np.searchsorted(case.data.t, REPLAY_SECONDS))
        unseen = case.data.motion.rows(slice(0, end))
        dense, plain = forms.position_error(case.learnt.motion, unseen, case.loop)
        return float(np.sqrt(noise_limited**2 + dense**2 - plain**2))


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


def continued_loop(loop: PositionLoop, data: ReplayInput) -> PositionLoop:
    """Return a loop with the state that its integrator has at the start of another recording.

    The constant c is that of the recorded torque in the first `START_SECONDS`.

    Args:
        loop: The loop, fitted to one recording.
        data: Another recording, with torque.
    """
    assert data.smooth_torque is not None
    first = data.t < START_SECONDS
    late = loop.lag + data.torque_delay
    missing = [
        np.mean(data.smooth_torque[first, j] - np.interp(data.t[first] - late[j], data.t, x))
        for j, x in enumerate(mujoco_replay.loop_torque(loop, data).T)
    ]
    return replace(loop, constant=loop.constant + np.array(missing))


def replay_case(model: Path, recordings: Path) -> ReplayCase:
    """Prepare the replay of a saved model, with a position loop fitted to train.csv."""
    machine = read_simulator_model(model / "model.json", recording=None)
    robot, train = machine.model.robot, recordings / "train.csv"
    learnt, data = (
        mujoco_replay.replay_input(machine.model, excite.read_recording(path, robot), False)
        for path in (train, recordings / "unseen.csv")
    )
    fitted = mujoco_replay.fit_position_loop(
        learnt, mujoco_replay.torque_limits(machine), str(train)
    )
    return ReplayCase(machine, learnt, data, continued_loop(fitted, data))


@contextlib.contextmanager
def finished_folder(place: Path) -> Iterator[Path]:
    """Yield a folder that gets its name when it is complete."""
    part = place.with_name(f"{place.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    yield part
    part.rename(place)


def score_case(seed: int, folder: Path, sysid_seconds: float) -> dict[str, list[float]]:
    """Simulate, identify, diagnose and replay a robot, as far as this has not been done.

    A diagnosis takes no effects and no parameters from its validation recording, unseen.csv.

    Args:
        seed: Number of the case.
        folder: Folder of all cases.
        sysid_seconds: Processor time of mujoco.sysid [s]; 0: it is not run.

    Returns:
        Position error, torque error (0: not computed) and processor time by variant.
    """
    place, name = folder / f"{seed:02d}", robot_name(seed)
    if not place.exists():
        with finished_folder(place) as part:
            DenseCase.of(seed).simulate(part)
    train, unseen = place / "train.csv", place / "unseen.csv"
    models: dict[str, tuple[Path, Callable[[Path], object]]] = {
        "identified": (place, lambda out: excite.identify(name, [train]).save(out)),
        "diagnosed": (place, lambda out: excite.diagnose(name, [train], [unseen]).save(out)),
        "exact": (
            place / "exact",
            lambda out: excite.identify(name, [place / "exact" / "train.csv"]).save(out),
        ),
    }
    file = place / "score.json"
    scores: dict[str, list[float]] = json.loads(file.read_text()) if file.exists() else {}
    cases = dict[str, ReplayCase]()

    def case(key: str) -> ReplayCase:
        if key not in cases:
            recordings, fit = models[key]
            out = recordings / ("identified" if key == "exact" else key)
            if not out.exists():
                with finished_folder(out) as part:
                    fit(part)
            cases[key] = replay_case(out, recordings)
        return cases[key]

    def with_module() -> tuple[float, float]:
        needed = bool(case("diagnosed").model.remainders(HOLDS))
        return case("diagnosed").errors(case("diagnosed").model, needed)

    def by_sysid() -> tuple[float, float]:
        known = case("diagnosed")
        nominal = nominal_model(known.model)
        text = mujoco_sysid.identified_mjcf(nominal, known.learnt, known.loop, sysid_seconds)
        out = place / "sysid.xml"
        out.write_text(text, encoding="utf-8")
        return known.errors(nominal_model(known.model, out))

    def with_known_forms() -> tuple[float, float]:
        error = DenseCase.of(seed).known_forms_error(case("diagnosed"), scores["exact"][0])
        return error, 0.0

    runs: dict[str, Callable[[], tuple[float, float]]] = {
        "identified": lambda: case("identified").errors(case("identified").model),
        "exact": lambda: case("exact").errors(case("exact").model),
        "urdf": lambda: case("diagnosed").errors(nominal_model(case("diagnosed").model)),
        "diagnosed": lambda: case("diagnosed").errors(case("diagnosed").model),
        "module": with_module,
        "known": with_known_forms,
    }
    if sysid_seconds:
        runs["sysid"] = by_sysid
    for key, run in runs.items():
        if key not in scores:
            start = time.process_time()
            scores[key] = [*run(), time.process_time() - start]
            file.write_text(json_text(scores), encoding="utf-8")
    return scores


def table_row(seed: int, scores: dict[str, list[float]]) -> str:
    """Return a row of the table: position errors [mrad], their ratio, torque errors."""
    position = [f"{1e3 * scores[key][0]:.3g}" if key in scores else "–" for key in VARIANTS]
    ratio = " / ".join(f"{scores['module'][0] / scores[k][0]:.2f}" for k in ("exact", "known"))
    torque = " / ".join(f"{scores[key][1]:.3g}" for key in ("urdf", "identified", "module"))
    cells = (str(seed), robot_name(seed), *position, ratio, torque)
    return f"| {' | '.join(cells)} |"


def summary(scores: Sequence[dict[str, list[float]]]) -> str:
    """Return medians over the robots."""
    lines = []
    for key, words in VARIANTS.items():
        for limit in ("exact", "known"):
            errors = [score[key][0] / score[limit][0] for score in scores if key in score]
            if errors and key not in ("exact", limit):
                within = sum(error <= LARGEST_RATIO for error in errors)
                lines.append(
                    f"{words}: {np.median(errors):.3g} times the error '{VARIANTS[limit]}' in the "
                    f"median ({min(errors):.3g} to {max(errors):.3g}), at most {LARGEST_RATIO:g} "
                    f"in {within} of {len(errors)}"
                )
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=20, help="robots (default 20)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--folder", type=Path, help="keep and continue the cases in this folder")
    parser.add_argument(
        "--sysid", type=float, default=0.0, help="processor time of mujoco.sysid [s] (default: 0)"
    )
    arguments = parser.parse_args(argv)
    if arguments.sysid:
        mujoco_sysid.require()
    heads = ("seed", "robot", *VARIANTS.values(), "ratio", "torque error")
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    scores = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        for seed in range(arguments.first, arguments.first + arguments.count):
            scores.append(score_case(seed, folder, arguments.sysid))
            print(table_row(seed, scores[-1]), flush=True)
    print(summary(scores))
    return 0


if __name__ == "__main__":
    sys.exit(main())
