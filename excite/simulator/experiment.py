"""Simulated experiments: from a URDF and a trajectory to a recording and its ground truth.

All random draws come from one seed; the measurement noise depends on the motion as well.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .actuator import ControllerGains
from .measurement import MeasurementChain
from .model_error import perturb_bodies
from .physical_effect import PhysicalEffect
from .recording_file import MeasuredSignals, measure, truth_document
from .reference_trajectory import ReferenceTrajectory, read_reference
from .simulated_robot import SimulatedMotion, SimulatedRobot, sample_robot
from .urdf_tree import UrdfTree, read_urdf

MOTION_DIGEST_POINTS = 64
"""Points of a motion from which the seed of its noise is computed."""
TORQUE_RESOLUTION = 2048.0
"""Steps of the recorded torque per torque limit: a 12-bit converter for both signs."""


@dataclass(frozen=True)
class ExperimentSettings:
    """How a simulated robot is built and measured.

    The fields are the keys of `setting` in `excite.truth/1`.

    Attributes:
        seed: Seed of all random draws.
        rate: Sampling rate [Hz].
        noise: Standard deviation of the torque noise over the torque limit [1].
        colour: Corner frequency of the noise's low-pass [Hz]; None: white noise.
        jitter: Standard deviation of the sampling times [s].
        encoder: Resolution of position [rad].
        model_error: Relative difference between the true bodies and those of the URDF [1].
        control: Gains of the controller.
    """

    seed: int = 0
    rate: float = 500.0
    noise: float = 0.005
    colour: float | None = None
    jitter: float = 0.0
    encoder: float = 2e-6
    model_error: float = 0.05
    control: ControllerGains = field(default_factory=ControllerGains)

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> ExperimentSettings:
        """Build the settings from the `setting` of a truth file."""
        return cls(**{**document, "control": ControllerGains(**document["control"])})

    def generators(self) -> list[np.random.Generator]:
        """Return independent generators for bodies, actuators, measurement and effects."""
        return np.random.default_rng(self.seed).spawn(4)

    def noise_generator(self, reference: ReferenceTrajectory) -> np.random.Generator:
        """Return the generator of the noise along a motion.

        It depends on the motion, so that recordings of two motions share no noise.
        """
        q = reference.at(np.linspace(0.0, reference.duration, MOTION_DIGEST_POINTS))[0]
        digest = zlib.crc32((np.round(q, 6) + 0.0).tobytes())
        return np.random.default_rng(
            [digest, *self.generators()[2].integers(2**32, size=2).tolist()]
        )


@dataclass(frozen=True)
class SimulatedSession:
    """One recording of a simulated robot.

    Attributes:
        robot: The robot.
        chain: Its measurement chain.
        motion: The motion that it made.
        recording: The measured signals.
        truth: The ground truth, an `excite.truth/1`.
    """

    robot: SimulatedRobot
    chain: MeasurementChain
    motion: SimulatedMotion
    recording: MeasuredSignals
    truth: dict[str, Any]


def build_robot(
    urdf: Path,
    reference: ReferenceTrajectory,
    settings: ExperimentSettings,
    effects: Sequence[PhysicalEffect] = (),
) -> SimulatedRobot:
    """Build the true robot, of which the URDF is a model with errors of a few per cent.

    Args:
        urdf: Path of the URDF.
        reference: Trajectory that states joints, locked joints, gravity and payload.
        settings: Seed, model error and controller.
        effects: Hidden effects.
    """
    bodies, actuators, *_ = settings.generators()
    tree = perturb_bodies(_with_payload(read_urdf(urdf), reference), settings.model_error, bodies)
    return sample_robot(tree, reference, actuators, gains=settings.control, effects=effects)


def _with_payload(tree: UrdfTree, reference: ReferenceTrajectory) -> UrdfTree:
    """Return the tree with the payload for which the trajectory was designed."""
    payload = reference.robot.get("payload")
    if payload is None:
        return tree
    xx, xy, yy, xz, yz, zz = (float(value) for value in payload["inertia"])
    tensor, point = (
        np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
        np.array([*payload["centre"], 1.0], float),
    )
    added = float(payload["mass"]) * np.outer(point, point)
    added[:3, :3] += 0.5 * np.trace(tensor) * np.eye(3) - tensor
    return tree.with_pseudo_inertia(
        str(payload["link"]), tree.pseudo_inertia(str(payload["link"])) + added
    )


def measurement_chain(robot: SimulatedRobot, settings: ExperimentSettings) -> MeasurementChain:
    """Return the measurement chain of a robot, sized by its torque limits."""
    return MeasurementChain(
        settings.rate,
        settings.noise * robot.torque_limit,
        settings.colour,
        settings.encoder,
        robot.torque_limit / TORQUE_RESOLUTION,
        settings.jitter,
    )


def run_session(
    robot: SimulatedRobot,
    reference: ReferenceTrajectory,
    settings: ExperimentSettings,
    facts: dict[str, Any] | None = None,
    motion: SimulatedMotion | None = None,
) -> SimulatedSession:
    """Simulate a robot along a reference and measure it.

    Args:
        robot: The robot with its hidden effects.
        reference: The commanded motion.
        settings: Seed and measurement.
        facts: Further keys of the truth, which come first.
        motion: The motion, where it has been simulated already.
    """
    if motion is None:
        motion = robot.follow(reference)
    chain = measurement_chain(robot, settings)
    recording = measure(motion, reference, chain, settings.noise_generator(reference))
    settings_facts = {"seed": settings.seed, "setting": asdict(settings)}
    return SimulatedSession(
        robot,
        chain,
        motion,
        recording,
        truth_document(robot, chain, {**(facts or {}), **settings_facts}),
    )


def simulate(
    urdf: Path,
    trajectory: Path,
    settings: ExperimentSettings = ExperimentSettings(),
    periods: int | None = None,
    effects: Sequence[PhysicalEffect] = (),
) -> SimulatedSession:
    """Record a robot that follows a `trajectory.json`.

    Args:
        urdf: Path of the URDF.
        trajectory: Path of the trajectory.
        settings: How the robot is built and measured.
        periods: Repeats of the excitation; None: as the trajectory states.
        effects: Hidden effects.
    """
    reference = read_reference(trajectory, periods)
    return run_session(build_robot(urdf, reference, settings, effects), reference, settings)
