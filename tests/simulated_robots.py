"""Simulated robots and their motions, shared by the tests of the simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from excite._types import FloatArray
from excite.robot.robot import locate
from excite.simulator.effect_instance import EffectInstance, with_effects
from excite.simulator.experiment import (
    ExperimentSettings,
    SimulatedSession,
    build_robot,
    run_session,
)
from excite.simulator.recording_file import json_text
from excite.simulator.reference_trajectory import ReferenceTrajectory, blended_fourier
from excite.simulator.simulated_robot import SimulatedRobot
from excite.simulator.urdf_tree import read_urdf

MODELS = locate("two_link").parent
TRAJECTORIES = Path(__file__).parents[1] / "trajectories"


def builtin_urdf(name: str) -> Path:
    """Return the path of a built-in model."""
    return MODELS / f"{name}.urdf"


def quick_motion(seconds: float = 2.0, seed: int = 0, n: int = 2) -> ReferenceTrajectory:
    """Return a fast motion of `two_link`, or of n joints like it."""
    rng = np.random.default_rng(seed)
    sine, cosine = 1.2 * rng.standard_normal((2, n, 3))
    return blended_fourier(
        read_urdf(builtin_urdf("two_link")).joints,
        sine,
        cosine,
        np.array([-1.4, 0.6]),
        seconds - 0.6,
        1,
        0.3,
    )


DrawEffects = Callable[
    [SimulatedRobot, ReferenceTrajectory, np.random.Generator], list[EffectInstance]
]
"""Returns the hidden effects, from the robot, its first motion and a generator."""


@dataclass(frozen=True)
class RecordedRobot:
    """Recordings of a simulated robot along random motions.

    Attributes:
        robot: The robot, with its hidden effects.
        effects: These effects.
        noise: RMS torque noise below 20 Hz, shape (n,) [N m].
        sessions: A session for each motion.
        files: A recording of each motion.
    """

    robot: SimulatedRobot
    effects: tuple[EffectInstance, ...]
    noise: FloatArray
    sessions: tuple[SimulatedSession, ...]
    files: tuple[Path, ...]


def record_robot(
    name: str,
    draw: Callable[
        [SimulatedRobot, ReferenceTrajectory, np.random.Generator], list[EffectInstance]
    ],
    folder: Path,
    seed: int,
    settings: ExperimentSettings,
    periods: int = 2,
    motions: int = 3,
) -> RecordedRobot:
    """Record a simulated robot along random motions of 8 s per period.

    Args:
        name: Name of a built-in model.
        draw: Draws the hidden effects.
        folder: Folder of the files.
        seed: Seed of motions and effects.
        settings: Measurement and model error.
        periods: Periods of each motion.
        motions: Number of motions.
    """
    from concealed_trial.random_excitation import draw_excitation

    rng, path = np.random.default_rng(seed), builtin_urdf(name)
    still = ReferenceTrajectory(
        read_urdf(path).joints, lambda t: (t, t, t), 0.0, 1.0, (0.0, 1.0), {}
    )
    robot = replace(build_robot(path, still, settings), step=2e-3)
    references = [draw_excitation(robot, periods, rng) for _ in range(motions)]
    effects = tuple(draw(robot, references[0], rng))
    robot = with_effects(robot, effects)
    sessions = tuple(run_session(robot, reference, settings) for reference in references)
    files = tuple(folder / f"{number}.csv" for number in range(motions))
    for file, session in zip(files, sessions, strict=True):
        file.write_text(session.recording.to_csv(), encoding="utf-8")
        file.with_suffix(".json").write_text(json_text(session.recording.to_sidecar()))
    noise = np.asarray(sessions[0].chain.noise_floor(20.0))
    return RecordedRobot(robot, effects, noise, sessions, files)
