"""Identification of a robot by mujoco.sysid, from the recording that excite gets.

mujoco.sysid is in the MuJoCo wheel (Apache 2.0) and needs further packages:

    pip install 'mujoco[sysid]'

or, without the packages of its reports, `pip install --target DIR absl-py colorama tabulate`
(Apache 2.0, BSD, MIT) and PYTHONPATH=DIR.

The problem is posed as its documentation does: least squares of the recorded joint positions over
windows that start from the recorded state, from the URDF. The actuators are the position loop that
excite fitted, with its feed-forward and integral from the recording as control. Parameters are the
pseudo-inertia of each link with the bounds of `body_inertia_param`, and armature, damping and
frictionloss of each joint, nonnegative and at most a share of its limits.
"""

from __future__ import annotations

import contextlib
import importlib.util
import sys
import time
from typing import Any

import mujoco
import numpy as np

from excite.exporters import mjcf_file, mujoco_replay
from excite.exporters.mujoco_replay import PositionLoop, ReplayInput
from excite.exporters.simulator_model import SimulatorModel

PACKAGES = ("absl", "colorama", "tabulate")
"""Packages that mujoco.sysid imports beyond those of excite."""
WINDOW_SECONDS = 1.0
"""Length of a window [s]."""
WINDOWS = 8
"""Windows, one after the other over a period of the motion."""
FIRST_SECOND = 1.5
"""Start of the first window [s]: after the motion has blended in."""
TIMESTEP = 1e-3
"""Time step of the simulation [s]."""
LARGEST_FRICTION = 0.2
"""Upper bound of frictionloss, and of damping at the velocity limit, over the torque limit [1]."""
LARGEST_ARMATURE = 1.0 / 20.0
"""Upper bound of the armature over the torque limit [s²/rad]."""
START_SHARE = 0.1
"""Start of armature, damping and frictionloss over their upper bounds, where the URDF has none."""
MAX_ITERATIONS = 100
"""Largest number of iterations."""


class OutOfTimeError(Exception):
    """The processor time has been used up."""


def require() -> None:
    """End the script with the command that installs what is missing."""
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        sys.exit(f"mujoco.sysid needs {', '.join(missing)}: pip install 'mujoco[sysid]'")


def identified_mjcf(
    nominal: SimulatorModel, data: ReplayInput, loop: PositionLoop, seconds: float
) -> str:
    """Identify a robot and return its MJCF.

    Args:
        nominal: The robot as its URDF describes it.
        data: The recording.
        loop: The position loop that was fitted to it.
        seconds: Processor time after which the best parameters so far are returned [s].
    """
    from mujoco.sysid._src import optimize, parameter, residual, timeseries, trajectory

    spec = _servo_spec(nominal, loop)
    model = spec.compile()
    control = _control(data, loop)
    starts = [
        int(np.searchsorted(data.t, FIRST_SECOND + k * WINDOW_SECONDS)) for k in range(WINDOWS)
    ]
    length = int(np.searchsorted(data.t, WINDOW_SECONDS)) + 1
    windows = [slice(start, start + length) for start in starts]
    order = [nominal.joints.index(str(model.joint(j).name)) for j in range(model.njnt)]
    sequences = trajectory.ModelSequences(
        "robot",
        spec,
        [f"window {k}" for k in range(WINDOWS)],
        [
            trajectory.create_initial_state(
                model, data.q[rows.start][order], data.motion.dq[rows.start][order]
            )
            for rows in windows
        ],
        [timeseries.TimeSeries(data.t[rows] - data.t[rows][0], control[rows]) for rows in windows],
        [
            timeseries.TimeSeries.from_names(
                data.t[rows] - data.t[rows][0], data.q[rows][:, order], model
            )
            for rows in windows
        ],
    )
    parameters = _parameters(nominal, spec, model, parameter)
    function = residual.build_residual_fn(models_sequences=[sequences], n_threads=1)
    best = (np.inf, parameters.as_vector())
    end = time.process_time() + seconds

    def limited(x: np.ndarray, *arguments: Any, **keywords: Any) -> Any:
        nonlocal best
        if time.process_time() > end:
            raise OutOfTimeError
        out = function(x, *arguments, **keywords)
        cost = float(np.sum(np.concatenate(out[0]) ** 2)) if x.ndim == 1 else np.inf
        if cost < best[0]:
            best = (cost, x.copy())
        return out

    # it prints a line per iteration
    with contextlib.suppress(OutOfTimeError), contextlib.redirect_stdout(sys.stderr):
        optimize.optimize(
            parameters, limited, verbose=False, max_iters=MAX_ITERATIONS, x_scale="jac"
        )
    parameters.update_from_vector(best[1])
    for fitted in parameters.parameters.values():
        fitted.apply_modifier(spec)
    spec.compile()
    return str(spec.to_xml())


def _servo_spec(nominal: SimulatorModel, loop: PositionLoop) -> Any:
    """The robot with its position loop as actuators, and position sensors."""
    spec = mujoco.MjSpec.from_string(mjcf_file.mjcf_text(nominal, servos=False))
    spec.option.timestep = TIMESTEP
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for joint in spec.joints:
        # frictionloss as MuJoCo has it by default, not with the width of an identified friction
        joint.solref_friction = [0.02, 1.0]
        joint.solimp_friction = [0.9, 0.95, 0.001, 0.5, 2.0]
        spec.add_sensor(
            name=joint.name,
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
        )
    for actuator in spec.actuators:
        j = nominal.joints.index(actuator.name)
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[0] = 1.0
        actuator.biasprm[:3] = [0.0, -loop.gains[0, j], -loop.gains[1, j]]
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    return spec


def _control(data: ReplayInput, loop: PositionLoop) -> np.ndarray:
    """Torque of the loop beyond −K_p q − K_d q̇, shape (N, n) [N m]."""
    assert data.reference is not None
    proportional, derivative, _ = loop.gains
    torque = mujoco_replay.loop_torque(loop, data)
    return np.asarray(torque + proportional * data.motion.q + derivative * data.motion.dq)


def _parameters(nominal: SimulatorModel, spec: Any, model: Any, parameter: Any) -> Any:
    """Parameters with their bounds."""
    from mujoco.sysid._src import model_modifier

    out = parameter.ParameterDict()
    for link in nominal.model.robot.links:

        def set_body(changed: Any, value: Any, link: str = link) -> None:
            # the modifier of mujoco.sysid leaves the body without inertia in MuJoCo 4.0.0
            pi = model_modifier.pi_from_theta(value.value)
            _set_body(changed.body(link), pi[0], pi[1:4], pi[4:].reshape(3, 3))

        out.add(
            model_modifier.body_inertia_param(
                spec,
                model,
                link,
                inertia_type=parameter.InertiaType.Pseudo,
                modifier=set_body,
            )
        )
    for j, name in enumerate(nominal.joints):
        torque, speed = nominal.torque_limit(j), nominal.velocity_limit(j)
        assert torque is not None and speed is not None  # the built-in robots state both
        bounds = {
            "armature": LARGEST_ARMATURE * torque,
            "damping": LARGEST_FRICTION * torque / speed,
            "frictionloss": LARGEST_FRICTION * torque,
        }
        for key, largest in bounds.items():
            stated = float(np.ravel(getattr(spec.joint(name), key))[0])
            start = stated if 0.0 < stated < largest else START_SHARE * largest

            def modify(changed: Any, value: Any, name: str = name, key: str = key) -> None:
                joint = changed.joint(name)
                if np.ndim(getattr(joint, key)):
                    getattr(joint, key)[0] = value.value[0]
                else:
                    setattr(joint, key, float(value.value[0]))

            out.add(parameter.Parameter(f"{name} {key}", start, 0.0, largest, modifier=modify))
    return out


def _set_body(body: Any, mass: float, moment: np.ndarray, inertia: np.ndarray) -> None:
    """Set a body by its mass, first moment, and inertia tensor about its frame."""
    centre = moment / mass
    about_centre = inertia - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    moments, axes = np.linalg.eigh(about_centre)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    body.mass, body.ipos, body.inertia, body.iquat = mass, centre, moments, quaternion
    body.fullinertia, body.explicitinertial = np.full(6, np.nan), True
