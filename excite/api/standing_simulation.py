"""Simulate recordings of a robot that stands on its feet, by MuJoCo with contact and friction.

The motion is a design of `excite design --floating --support`. The true bodies deviate at random
from the nominal ones, as in `floating_simulation`; the joints have rotors, friction and offsets of
which the model knows nothing. The dynamics are MuJoCo's, so that an error of ours cannot cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from .._system.one_or_several import one_or_several
from .._system.progress import logger
from .._types import FloatArray, IntArray
from ..designer.floating_identifiability import RowNoise, assumed_noise
from ..errors import UnusableInput
from ..identification.floating_regression import pose_of
from ..identification.urdf_export import identified_urdf
from ..recordings import Recording
from ..recordings.floating_signals import COMPONENTS, POSE, WORLD
from ..robot import floating_base
from ..robot.floating_base import FloatingMotion, FloatingRobot
from ..robot.inertial_parameters import DRIVE, Parameters
from ..schemas.document_file import DocumentFile
from ..schemas.support_trajectory import (
    SCHEMA,
    FootDocument,
    SupportTrajectoryDocument,
)
from ..trajectory.trajectory_file import load_designed_robot
from .floating_result import read_floating_recording
from .floating_simulation import SimulatedFloatingRecording, drawn_parameters, truth_document
from .input_files import argument_files
from .mujoco_extra import require_mujoco

if TYPE_CHECKING:
    from ..simulator.standing_robot import StandingRecord, StandingRobot

DEFAULT_RATE = 200.0
"""Rows of the recording per second [Hz]."""


def simulate_standing(
    robot: str | Path | FloatingRobot,
    trajectory: str | Path,
    *,
    contacts: str | Sequence[str] = (),
    wrench_noise: tuple[float, float] | None = None,
    torque_noise: tuple[float, ...] | None = None,
    model_error: float = 0.05,
    rate: float = DEFAULT_RATE,
    seed: int = 0,
) -> SimulatedFloatingRecording:
    """Simulate a robot on its feet, as `excite simulate --floating` does with a `trajectory.json`.

    Args:
        robot: Path of a URDF, name of a built-in model, or the robot of the design.
        trajectory: `trajectory.json` of a design in support, with its `trajectory.csv` next to it.
        contacts: Frames of the feet, whose wrenches are recorded with the joint torques; or
            "world" for the total wrench about the world's origin alone. All feet by default.
        wrench_noise: Standard deviations of forces and moments of each sensor [N, N m]; None: 1 %
            of the weight, and that at 0.1 m.
        torque_noise: Standard deviation of the joint torques, one value or one per joint [N m];
            None: 1 % of the limit.
        model_error: Standard deviation of the true bodies from the nominal ones in the metric.
        rate: Rows of the recording per second [Hz].
        seed: Random seed.

    Raises:
        CheckFailed: The robot falls.
        UnusableInput: MuJoCo is not installed, or an argument or a file cannot be used.
    """
    require_mujoco()
    from ..simulator.standing_robot import PlannedMotion

    path = Path(trajectory)
    design, loaded = _read_design(path, robot)
    feet = tuple(str(foot.frame) for foot in design.support)
    contacts = one_or_several(contacts) or feet
    if contacts != (WORLD,) and sorted(contacts) != sorted(feet):
        raise UnusableInput(
            f"--contact {', '.join(contacts)}: the robot stands on {', '.join(feet)}; name all of "
            f"them, or '{WORLD}' for their sum"
        )
    motion = read_floating_recording(path.with_suffix(".csv"), loaded)
    limits = floating_base.limits(loaded)
    if torque_noise is not None and len(torque_noise) == 1:
        torque_noise = torque_noise * loaded.n
    noise = assumed_noise(loaded, limits, wrench_noise, torque_noise)
    rng = np.random.default_rng(seed)
    parameters, true = drawn_parameters(loaded, limits, model_error, rng)
    standing = _true_robot(loaded, design, motion, parameters, true, rng)
    order = [loaded.joints.index(joint) for joint in standing.joints]
    back = np.argsort(order)
    logger.info(
        f"simulating {motion.t[-1] - motion.t[0]:.3g} s of {loaded.name} on {' and '.join(feet)}"
    )
    record = standing.follow(
        PlannedMotion(
            motion.t - motion.t[0], pose_of(motion), motion.q[:, order], motion.torque[:, order]
        ),
        rate,
    )
    for kind, name in zip(DRIVE, ("inertia", "viscous", "coulomb", "offset"), strict=True):
        true[parameters.block(kind)] = getattr(standing.actuators, name)[back]
    frames = contacts if contacts == (WORLD,) else feet
    names, table = _recorded(loaded, record, frames, back, noise, rng)
    truth = truth_document(loaded, str(path), frames, seed, model_error, parameters, true, noise)
    truth["standing"] = {
        "friction": float(design.contact.friction),
        "tracking_error": dict(
            zip(loaded.joints, record.tracking_error[back].tolist(), strict=True)
        ),
        "slip": record.slip,
    }
    inputs = argument_files(loaded.joint_robot.source, path)
    return SimulatedFloatingRecording(names, table, truth, inputs)


def _true_robot(
    robot: FloatingRobot,
    design: SupportTrajectoryDocument,
    motion: Recording,
    parameters: Parameters,
    true: FloatArray,
    rng: np.random.Generator,
) -> StandingRobot:
    """Build the robot with true bodies, which stands as at the start of the motion.

    Args:
        robot: The nominal robot.
        design: The design.
        motion: Its motion.
        parameters: Standard parameters.
        true: Their true values. Shape (P,).
        rng: Source of randomness of the actuators.
    """
    from ..simulator.standing_robot import Sole, build_standing_robot
    from ..simulator.urdf_tree import parse_urdf

    urdf = identified_urdf(robot.joint_robot, parameters, true, np.ones(robot.n), model=robot.model)
    limits = floating_base.limits(robot)
    table = zip(limits.velocity.tolist(), limits.torque.tolist(), strict=True)
    return build_standing_robot(
        parse_urdf(urdf, robot.source),
        robot.base_link,
        [
            Sole(str(foot.frame), centre, float(foot.half_length), float(foot.half_width))
            for foot, centre in zip(
                design.support, _sole_centres(robot, design.support, motion), strict=True
            )
        ],
        float(design.contact.friction),
        dict(zip(robot.joints, table, strict=True)),
        np.asarray(robot.model.gravity.linear).tolist(),
        rng,
    )


def _recorded(
    robot: FloatingRobot,
    record: StandingRecord,
    frames: tuple[str, ...],
    order: IntArray,
    noise: RowNoise,
    rng: np.random.Generator,
) -> tuple[tuple[str, ...], FloatArray]:
    """Return columns and rows of the recording, with noise.

    Args:
        robot: The robot.
        record: The simulated motion.
        frames: Frames of the feet, or "world" for the total wrench without joint torques.
        order: Places in the record of the robot's joints. Shape (n,).
        noise: Noise of wrenches and torques.
        rng: Source of randomness.
    """
    is_total = frames == (WORLD,)
    wrenches = record.total_wrench if is_total else np.hstack(list(record.wrenches.swapaxes(0, 1)))
    deviations = np.tile([noise.force] * 3 + [noise.moment] * 3, len(frames))
    names = ["t", *POSE, *(f"q.{joint}" for joint in robot.joints)]
    names += [f"wrench.{frame}.{component}" for frame in frames for component in COMPONENTS]
    columns = [
        record.t[:, None],
        record.pose,
        record.q[:, order],
        wrenches + deviations * rng.normal(size=wrenches.shape),
    ]
    if not is_total:
        names += [f"tau.{joint}" for joint in robot.joints]
        torque = record.torque[:, order]
        columns.append(torque + noise.torque * rng.normal(size=torque.shape))
    return tuple(names), np.hstack(columns)


def _read_design(
    path: Path, robot: str | Path | FloatingRobot
) -> tuple[SupportTrajectoryDocument, FloatingRobot]:
    """Read a design in support, and load its robot unless it is loaded.

    Raises:
        UnusableInput: The file cannot be used, or the robot is not that of the design.
    """
    file = DocumentFile(
        path,
        "a design in support",
        "design it again",
        "the trajectory.json of 'excite design --floating --support'",
    )
    content: Any = file.json()
    file.schema(content, (SCHEMA,))
    design = file.converted(content, SupportTrajectoryDocument)
    if isinstance(robot, FloatingRobot):
        loaded = robot
    else:
        loaded = floating_base.load(
            load_designed_robot(content["robot"], design.joints, str(robot), require_mass=False)
        )
    if list(loaded.joints) != design.joints:
        raise UnusableInput(
            f"{path}: is a design for the joints {', '.join(design.joints)}; give its robot"
        )
    for foot in design.support:
        if not loaded.model.existFrame(str(foot.frame), pin.FrameType.BODY):
            raise UnusableInput(
                f"{path}: support: '{foot.frame}' is no link of {loaded.source}; design with "
                "--support on the links of the soles"
            )
    return design, loaded


def _sole_centres(
    robot: FloatingRobot, feet: Sequence[FootDocument], motion: Recording
) -> list[FloatArray]:
    """Return the centre of each sole in the frame of its foot.

    Args:
        robot: The robot.
        feet: The feet with the centres of their soles in the world, where they stand at the start.
        motion: The motion.
    """
    no_motion = np.zeros((1, 6 + robot.n))
    start = FloatingMotion(pose_of(motion)[:1], motion.q[:1], no_motion, no_motion)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.configurations(start)[0])
    return [
        np.asarray(data.oMf[robot.frame(str(foot.frame))].actInv(np.array(foot.centre, float)))
        for foot in feet
    ]
