"""Position replay of real servo robots that were identified without torque.

    python scripts/replay_servos.py [--data /path/to/recordings] [--only xl330|so101] [--unused]

XL330: a servo with a pendulum, identified from qref and q alone, next to the identification from
its computed torque and the replay errors that its authors state. SO-101: an arm of five servos,
identified from slow motions, next to its URDF with the same position loop and the parameters of
two published MuJoCo models. Every robot is exported as MJCF and driven in MuJoCo by the commands of
the held-out recordings, from their first state to their end.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

import excite
import excite.errors
from excite.api.model_export import read_simulator_model
from excite.api.replay_result import nominal_model
from excite.exporters import mujoco_replay
from excite.exporters.simulator_model import SimulatorModel, simulator_model
from excite.recordings import Recording

XL330_TRAIN = ("kp400_sin_sin", "kp200_sin_time_square", "kp400_up_and_down")
XL330_HELD_OUT = ("kp200_sin_sin", "kp400_sin_time_square")
XL330_SATURATION = 0.87 * 400.0
"""Firmware gain times the position error at which the duty cycle reaches 1 [rad]: 0.87 rad at 400,
from the columns qref, q and duty."""
SO101_TRAIN = ("multisine", "friction_gravity", "large_amplitude")
SO101_HELD_OUT = ("pick_place", "reaching_points")
SO101_UNUSED = ("random_waypoints",)
"""Recording that no development saw; evaluated once, with --unused (scripts/README.md)."""
PUBLIC_JOINTS = {"rotor_inertia": 0.028, "viscous": 0.60, "coulomb": 0.052}
"""Class "sts3215" of Simulation/SO101/so101_new_calib.xml of TheRobotStudio/SO-ARM100: armature,
damping, frictionloss."""
PUBLIC_GAINS = {"public MJCF, kp 998.22": (998.22, 2.731), "public MJCF, kp 17.8": (17.8, 0.0)}
"""K_p and kv of the same class, and of its earlier version, which Open_Duck_Playground uses."""
PUBLIC_LIMIT = 3.35
"""Its forcerange [N m]."""


def position_error(
    model: SimulatorModel, recording: Recording, loop: mujoco_replay.PositionLoop
) -> np.ndarray:
    """RMS position error of a free run in MuJoCo by joint [rad]."""
    data = mujoco_replay.replay_input(model.model, recording, False)
    run = mujoco_replay.Replay(model, data, loop).run(0, len(data.t))
    difference = np.nan_to_num(run.q, posinf=1.0, neginf=1.0) - data.q
    return np.asarray(np.sqrt(np.mean(np.clip(difference, -1.0, 1.0) ** 2, axis=0)))


def servo_recording(folder: Path, robot: object, name: str) -> Recording:
    """A recording without its torque; that of the XL330 with its firmware gain."""
    recording = excite.read_recording(folder / f"{name}.csv", robot)  # type: ignore[arg-type]
    sidecar = recording.sidecar
    if name.startswith("kp"):
        gain = float(name[2:5])
        sidecar = dataclasses.replace(
            sidecar, position_gain={"motor": gain}, error_limit={"motor": XL330_SATURATION / gain}
        )
    return dataclasses.replace(recording, tau=None, current=None, sidecar=sidecar)


def public_model(nominal: SimulatorModel) -> SimulatorModel:
    """The robot of the URDF with the joint parameters of the published MJCF."""
    psi, fitted = nominal.model.psi.copy(), nominal.model
    for kind, value in PUBLIC_JOINTS.items():
        psi[fitted.layout.block(kind)] = value
    return simulator_model(dataclasses.replace(fitted, psi=psi), {}, limits=nominal.limits)


def replay_xl330(folder: Path) -> None:
    """Print the table of the XL330 in degrees."""
    robot = excite.load_robot(folder / "xl330_pendulum.urdf")
    start = time.perf_counter()
    result = excite.identify_servo(
        robot, [servo_recording(folder, robot, name) for name in XL330_TRAIN]
    )
    seconds = time.perf_counter() - start
    held_out = [servo_recording(folder, robot, name) for name in XL330_HELD_OUT]
    with tempfile.TemporaryDirectory() as place:
        result.save(Path(place) / "servo")
        servo = read_simulator_model(Path(place) / "servo" / "model.json")
        with_torque = excite.identify(robot, [folder / f"{name}.csv" for name in XL330_TRAIN])
        with_torque.save(Path(place) / "torque")
        torque = read_simulator_model(Path(place) / "torque" / "model.json")
        rows: dict[str, list[float]] = {}
        for name, recording in zip(XL330_HELD_OUT, held_out, strict=True):
            loop = mujoco_replay.identified_loop(servo.model, recording)
            measured = excite.read_recording(folder / f"{name}.csv", robot)
            measured = dataclasses.replace(measured, tau=measured.torque)
            data = mujoco_replay.replay_input(torque.model, measured, False)
            fitted = mujoco_replay.fit_position_loop(data, np.array([np.inf]), name)
            assert recording.qref is not None
            tracking = np.sqrt(np.mean((recording.qref - recording.q) ** 2, axis=0))
            errors = {
                "commanded position": tracking,
                "URDF, identified position loop": position_error(
                    nominal_model(servo), recording, loop
                ),
                "identified from the torque column": position_error(torque, measured, fitted),
                "identified without it": position_error(servo, recording, loop),
            }
            for key, value in errors.items():
                rows.setdefault(key, []).append(float(np.degrees(value[0])))
    print(f"\nXL330, position error [deg]; identification {seconds:.0f} s\n")
    print(f"| | {' | '.join(XL330_HELD_OUT)} |\n|---|{'---:|' * len(XL330_HELD_OUT)}")
    for key, values in rows.items():
        print(f"| {key} | {' | '.join(f'{value:.2f}' for value in values)} |")
    print("| authors' M6, as stated by them for another unit; refit | 3.50; 1.16 | |")
    print(f"\n{_joint_lines(result)}")


def replay_so101(folder: Path, held_out: Sequence[str]) -> None:
    """Print the table of the SO-101 in mrad.

    Args:
        folder: Folder of its recordings.
        held_out: Names of the recordings that are replayed.
    """
    robot = excite.load_robot(folder / "so101.urdf")
    start = time.perf_counter()
    result = excite.identify_servo(
        robot, [servo_recording(folder, robot, name) for name in SO101_TRAIN]
    )
    seconds = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as place:
        result.save(place)
        servo = read_simulator_model(Path(place) / "model.json")
        nominal = nominal_model(servo)
    print(f"\nSO-101, position error [mrad], joints in order; identification {seconds:.0f} s\n")
    print(f"| | {' | '.join(held_out)} |\n|---|{'---|' * len(held_out)}")
    rows: dict[str, list[np.ndarray]] = {}
    for name in held_out:
        recording = servo_recording(folder, robot, name)
        loop = mujoco_replay.identified_loop(servo.model, recording)
        assert recording.qref is not None
        rows.setdefault("commanded position", []).append(
            np.sqrt(np.mean((recording.qref - recording.q) ** 2, axis=0))
        )
        rows.setdefault("URDF, identified position loop", []).append(
            position_error(nominal, recording, loop)
        )
        for key, (kp, kv) in PUBLIC_GAINS.items():
            gains = np.full(robot.n, kp), np.full(robot.n, kv)
            stated = dataclasses.replace(
                mujoco_replay.stated_loop(*gains),
                error_limit=np.full(robot.n, PUBLIC_LIMIT / kp),
            )
            rows.setdefault(key, []).append(
                position_error(public_model(nominal), recording, stated)
            )
        rows.setdefault("identified without torque", []).append(
            position_error(servo, recording, loop)
        )
    for key, errors in rows.items():
        cells = [
            f"{' '.join(f'{1e3 * value:.3g}' for value in error)} "
            f"({1e3 * float(np.sqrt(np.mean(error**2))):.3g})"
            for error in errors
        ]
        print(f"| {key} | {' | '.join(cells)} |")
    print(f"\n{_joint_lines(result)}")


def _joint_lines(result: excite.ServoIdentificationResult) -> str:
    """Identified gains and joint parameters."""
    identification = result.identification
    lines = [
        "| joint | K_p | frictionloss | damping | armature | delay [ms] |",
        "|---|" + 5 * "---:|",
    ]
    blocks = {kind: identification.model.parameters.block(kind) for kind in PUBLIC_JOINTS}
    for j, joint in enumerate(identification.model.robot.joints):
        cells = [identification.loop.proportional[j]]
        cells += [
            identification.psi[blocks[kind]][j] for kind in ("coulomb", "viscous", "rotor_inertia")
        ]
        cells.append(1e3 * identification.loop.delay[j])
        lines.append(f"| {joint} | {' | '.join(f'{value:.3g}' for value in cells)} |")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shared = Path(os.environ.get("EXCITE_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    parser.add_argument("--data", type=Path, default=shared / "recordings", help="recordings")
    parser.add_argument("--only", choices=("xl330", "so101"), help="one robot")
    parser.add_argument(
        "--unused", action="store_true", help="replay the SO-101's unused recording instead"
    )
    arguments = parser.parse_args(argv)
    held_out = SO101_UNUSED if arguments.unused else SO101_HELD_OUT
    replay_arm = partial(replay_so101, held_out=held_out)
    warnings.simplefilter("ignore", excite.errors.ExciteWarning)
    for name, replay in (("xl330", replay_xl330), ("so101", replay_arm)):
        if arguments.only in (None, name):
            if not (arguments.data / name).is_dir():
                print(f"{arguments.data / name}: not there; give the recordings with --data")
                return 2
            replay(arguments.data / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
