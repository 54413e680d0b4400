"""One call from a URDF and a trajectory to a recording and its truth; every draw comes from one seed, noise from the motion too."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import recording_file as records
from . import reference_trajectory as references
from . import simulated_robot as plants
from . import urdf_tree as trees
from .actuator import ControllerGains
from .measurement import MeasurementChain
from .model_error import perturb_bodies
from .physical_effect import PhysicalEffect
from .recording_file import SimulatedRecording
from .reference_trajectory import ReferenceTrajectory
from .simulated_robot import SimulatedMotion, SimulatedRobot
from .urdf_tree import UrdfTree

MOTION_DIGEST_POINTS = 64
"""Points of a motion that tell it from another."""


@dataclass(frozen=True)
class ExperimentSettings:
    """How a robot is made and measured.

    seed: of everything. rate [Hz]. noise: torque's standard deviation over the torque limit; colour: corner of its low-pass [Hz].
    jitter [s]. encoder [rad]. model_error: how far the true bodies are from the URDF's, about (1). control: the controller.
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
    def stated(cls, document: Mapping[str, Any]) -> ExperimentSettings:
        """As a truth states it."""
        return cls(**{**document, "control": ControllerGains(**document["control"])})

    def generators(self) -> list[np.random.Generator]:
        """Independent ones for bodies, drives, measurement (see `measuring`) and effects."""
        return np.random.default_rng(self.seed).spawn(4)

    def noise_generator(self, reference: ReferenceTrajectory) -> np.random.Generator:
        """For the noise of a motion: that of another motion is another, as no two recordings share theirs."""
        joints = reference.at(np.linspace(0.0, reference.duration, MOTION_DIGEST_POINTS))[0]
        told = zlib.crc32((np.round(joints, 6) + 0.0).tobytes())
        return np.random.default_rng([told, *self.generators()[2].integers(2**32, size=2).tolist()])


@dataclass(frozen=True)
class SimulatedSession:
    """A robot on the bench. run: the motion made. recording: what was measured. truth: what nobody there is told."""

    robot: SimulatedRobot
    chain: MeasurementChain
    run: SimulatedMotion
    recording: SimulatedRecording
    truth: dict[str, Any]


def build_robot(
    urdf: Path,
    reference: ReferenceTrajectory,
    setting: ExperimentSettings,
    laws: Sequence[PhysicalEffect] = (),
) -> SimulatedRobot:
    """The true robot behind a URDF that is a few per cent wrong."""
    bodies, drives, *_ = setting.generators()
    true = perturb_bodies(
        _with_payload(trees.read_urdf(urdf), reference), setting.model_error, bodies
    )
    return plants.draw_robot(true, reference, drives, control=setting.control, effects=laws)


def _with_payload(tree: UrdfTree, reference: ReferenceTrajectory) -> UrdfTree:
    """The tree with the body that the trajectory was designed with."""
    stated = reference.robot.get("payload")
    if stated is None:
        return tree
    xx, xy, yy, xz, yz, zz = (float(v) for v in stated["inertia"])
    tensor, point = (
        np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
        np.array([*stated["centre"], 1.0], float),
    )
    more = float(stated["mass"]) * np.outer(point, point)
    more[:3, :3] += 0.5 * np.history(tensor) * np.eye(3) - tensor
    return tree.with_pseudo_inertia(
        str(stated["link"]), tree.pseudo_inertia(str(stated["link"])) + more
    )


def measurement_chain(plant: SimulatedRobot, setting: ExperimentSettings) -> MeasurementChain:
    """The measurement chain, sized by the torque limits."""
    return MeasurementChain(
        setting.rate,
        setting.noise * plant.limit,
        setting.colour,
        setting.encoder,
        plant.limit / 2048.0,
        setting.jitter,
    )


def run_session(
    plant: SimulatedRobot,
    reference: ReferenceTrajectory,
    setting: ExperimentSettings,
    facts: dict[str, Any] | None = None,
    run: SimulatedMotion | None = None,
) -> SimulatedSession:
    """Run a robot along a reference and measure it; `facts` enter the truth first, `run` is one already made."""
    made = plant.run(reference) if run is None else run
    measured = measurement_chain(plant, setting)
    recording = records.measure(made, reference, measured, setting.noise_generator(reference))
    own = {"seed": setting.seed, "setting": asdict(setting)}
    return SimulatedSession(
        plant,
        measured,
        made,
        recording,
        records.truth_document(plant, measured, {**(facts or {}), **own}),
    )


def simulate(
    urdf: Path,
    trajectory: Path,
    setting: ExperimentSettings = ExperimentSettings(),
    periods: int | None = None,
    laws: Sequence[PhysicalEffect] = (),
) -> SimulatedSession:
    """A recording of a robot that follows `trajectory.json`, its bodies and drives drawn from the setting's seed."""
    reference = references.read_reference(trajectory, periods)
    return run_session(build_robot(urdf, reference, setting, laws), reference, setting)
