"""Replay recorded commands in MuJoCo with an identified robot, and with the robot as described."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from .. import _json
from .._system.progress import logger
from ..errors import UnusableInput
from ..exporters import mujoco_replay
from ..exporters.mjcf_file import HOLDS
from ..exporters.mujoco_replay import PositionLoop, Replay, ReplayErrors, ReplayInput
from ..exporters.simulator_model import SimulatorModel, simulator_model
from ..identification.identified_model import IdentifiedModel
from ..recordings import Recording
from ..robot.inertial_parameters import COULOMB_WIDTH, DRIVE
from .identification_result import RecordingSource, read_recording
from .input_files import argument_files
from .model_export import read_fitted_model
from .mujoco_extra import require_mujoco
from .robots import load_robot
from .saved_result import SavedResult
from .servo_identification_result import gain_pairs
from .stated_recordings import stated_columns

REPLAY_FILES = ("replay.json", "report.html")
"""Files of a replay."""
COMMANDS = ("qref", "torque")
"""Commands that can be replayed."""


@dataclass(frozen=True)
class ReplayResult(SavedResult):
    """Deviation of simulated robots from a recording under its commands.

    Attributes:
        model: The identified robot.
        recording: The recording.
        data: The stretch of it that was replayed.
        loop: Position loop; None: the torque was replayed.
        errors: Errors of the robot as its URDF describes it ("before"), as identified ("after"),
            and, where MJCF does not hold all of it, with the friction module.
    """

    FILES = REPLAY_FILES

    model: SimulatorModel
    recording: Recording
    data: ReplayInput
    loop: PositionLoop | None
    errors: tuple[ReplayErrors, ...]

    def document(self) -> dict[str, Any]:
        """Return the content of `replay.json`."""
        joints = self.model.joints
        horizons = mujoco_replay.fitting_horizons(self.data)

        def plain(values: Any) -> dict[str, float | None]:
            numbers = [float(v) if np.isfinite(v) else None for v in values]
            return dict(zip(joints, numbers, strict=True))

        return {
            "schema": "excite.replay/1",
            "model": self.model.model.source,
            "recording": self.recording.source,
            "command": "torque" if self.loop is None else "qref",
            "seconds": float(self.data.t[-1]),
            "position_loop": None if self.loop is None else self.loop.document(joints),
            "robots": [
                {
                    "name": errors.name,
                    "position_rmse": plain(errors.position),
                    "torque_rmse": plain(errors.torque),
                    "lost_at": errors.lost,
                    "horizons": [
                        {"seconds": horizon, "position_rmse": plain(row)}
                        for horizon, row in zip(horizons, errors.horizons, strict=True)
                    ],
                }
                for errors in self.errors
            ],
        }

    def html(self) -> str:
        """Return the report as HTML."""
        from ..report.replay import replay_page

        return replay_page(self.model, self.recording.source, self.data, self.loop, self.errors)

    def contents(self) -> dict[str, str]:
        """Return the files of the replay by name."""
        return {"replay.json": _json.dumps(self.document()), "report.html": self.html()}

    def __repr__(self) -> str:
        before, after = self.errors[0], self.errors[-1]
        return (
            f"<ReplayResult of {self.recording.source}: position RMSE "
            f"{_total(before):.3g} before, {_total(after):.3g} after>"
        )


def _total(errors: ReplayErrors) -> float:
    """RMS position error over all joints."""
    return float(np.sqrt(np.mean(errors.position**2)))


def replay(
    model: str | Path,
    recording: RecordingSource,
    *,
    command: str | None = None,
    gains: Sequence[float] | None = None,
    robot: str | Path | None = None,
    columns: Mapping[str, str] = MappingProxyType({}),
) -> ReplayResult:
    """Replay the commands of a recording in MuJoCo, as `excite replay` does.

    Args:
        model: Path of a `model.json`.
        recording: Recording with commanded positions, `qref.<joint>`, or torque.
        command: "qref" or "torque"; None: qref where it was recorded.
        gains: K_p and K_d of the position loop: one pair, or one for each joint [N m/rad,
            N m s/rad]; None: those that were identified with the model, else they are fitted to the
            recorded torque.
        robot: Description of the robot before its identification; None: the one that the model
            states.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file;
            without any those that the model states for the recording.

    Raises:
        UnusableInput: MuJoCo is not installed, or a file or an option cannot be used.
    """
    require_mujoco()
    fitted, content = read_fitted_model(model)
    prepared = simulator_model(fitted, content)
    named = columns or stated_columns(content, recording)
    measured = read_recording(recording, fitted.robot, columns=named)
    if command is None:
        command = "torque" if measured.qref is None and gains is None else "qref"
    data = mujoco_replay.replay_input(fitted, measured, command == "torque")
    loop = None
    if command == "qref" and gains is not None:
        loop = mujoco_replay.stated_loop(*gain_pairs(gains, fitted.robot))
    elif command == "qref" and fitted.position_loop:
        loop = mujoco_replay.identified_loop(fitted, measured)
    elif command == "qref":
        loop = mujoco_replay.fit_position_loop(
            data, mujoco_replay.torque_limits(prepared), measured.source
        )
    described = nominal_model(prepared, robot)
    robots = [("before", described, False), ("after", prepared, False)]
    if prepared.remainders(HOLDS):
        robots.append(("after, with friction module", prepared, True))
    errors = []
    for name, machine, with_friction in robots:
        logger.info(f"replaying {data.t[-1]:.3g} s: {name}")
        errors.append(
            mujoco_replay.replay_errors(name, Replay(machine, data, loop, with_friction), data)
        )
    inputs = argument_files(robot, model, recordings=[recording])
    return ReplayResult(prepared, measured, data, loop, tuple(errors), inputs=inputs)


def nominal_model(model: SimulatorModel, robot: str | Path | None = None) -> SimulatorModel:
    """Return the robot as it was described before its identification.

    Args:
        model: The identified robot.
        robot: Its description; None: the one that the `model.json` states.

    Raises:
        UnusableInput: The description is missing or has other joints.
    """
    fitted, stated = model.model, model.document.get("robot", {})
    source = str(robot if robot is not None else stated.get("source", ""))
    try:
        described = load_robot(
            source, joints=list(fitted.robot.joints), gravity=fitted.robot.model.gravity.linear
        )
    except UnusableInput as error:
        raise UnusableInput(
            f"{error}; state the robot before its identification with --robot"
        ) from error
    bodies = [
        described.model.inertias[i].toDynamicParameters() for i in range(1, described.model.njoints)
    ]
    joint_parameters = [[getattr(entry, kind) for entry in described.entries] for kind in DRIVE]
    psi = np.concatenate([*bodies, *np.array(joint_parameters, float)])
    nominal = IdentifiedModel(
        source, described, DRIVE, psi, np.full(described.n, COULOMB_WIDTH), fitted.hertz
    )
    return simulator_model(nominal, {}, limits=model.limits)
