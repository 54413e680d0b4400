"""Isaac Lab actuators of an identified robot: a Python file with an `ImplicitActuatorCfg`.

Isaac Lab's configuration is per radian. USD attributes of rotational axes are per degree where
angles enter: `viscousFrictionCoefficient` [N m s/deg] and `maxJointVelocity` [deg/s]; PhysX
multiplies the former by 180/π when it reads the file. Friction efforts [N m] and armature [kg m²]
are not. Both sets of values are written, so that none has to be converted by hand.
"""

from __future__ import annotations

import math
import pprint
import re

from .._system.comments import python_docstring
from .._types import FloatArray
from .simulator_model import Held, SimulatorModel

HOLDS: frozenset[Held] = frozenset(
    {
        Held.ROTOR_INERTIA,
        Held.VISCOUS,
        Held.COULOMB,
        Held.STATIC_FRICTION,
        Held.INERTIA,
    }
)
"""Quantities that Isaac Lab holds; the link inertias are those of the URDF that it imports."""
DEGREES = 180.0 / math.pi
"""Degrees per radian."""


def viscous_per_degree(per_radian: float) -> float:
    """Return a viscous friction coefficient per degree per second, for a rotational USD axis.

    Args:
        per_radian: The coefficient [N m s/rad].

    Returns:
        The same friction [N m s/deg], 57.3 times smaller.
    """
    return per_radian / DEGREES


def isaaclab_text(model: SimulatorModel) -> str:
    """Return a Python module with the actuators of an identified robot.

    Args:
        model: The identified robot.
    """
    tables = _tables(model)
    names = [re.escape(name) for name in model.joints]
    fields = "\n".join(f"    {name}={_shown(value)}," for name, value in tables.items())
    return (
        f"{python_docstring(_header(model))}\n\n"
        "try:\n"
        "    from isaaclab.actuators import ImplicitActuatorCfg\n"
        "except ImportError:  # readable without Isaac Lab\n"
        "    ImplicitActuatorCfg = dict\n\n"
        "ACTUATOR = ImplicitActuatorCfg(\n"
        f"    joint_names_expr={_shown(names)},\n"
        "    stiffness=None,  # those of your controller\n"
        "    damping=None,\n"
        f"{fields}\n"
        ")\n"
        '"""Actuators of the articulation: `actuators={"arm": ACTUATOR}`; per radian."""\n\n'
        f"USD_ATTRIBUTES = {_shown(_usd(model))}\n"
        '"""Attributes of each joint prim in USD; per degree for rotational axes."""\n'
    )


def _header(model: SimulatorModel) -> list[str]:
    """Lines of the module's docstring."""
    lines = model.header("Isaac Lab", HOLDS)
    lines += [
        "link inertias: import the file of the format urdf of 'excite export' into USD",
        "Isaac Sim 5 or later: friction and dynamic_friction are efforts [N m],",
        "viscous_friction is [N m s/rad]",
    ]
    return lines


def _tables(model: SimulatorModel) -> dict[str, dict[str, float]]:
    """Fields of the configuration by joint."""
    torques, joints = model.torques, model.joints

    def table(values: FloatArray) -> dict[str, float]:
        return dict(zip(map(re.escape, joints), values.tolist(), strict=True))

    limits: dict[str, dict[str, float]] = {"effort_limit_sim": {}, "velocity_limit_sim": {}}
    for j, joint in enumerate(joints):
        for key, value in (
            ("effort_limit_sim", model.torque_limit(j)),
            ("velocity_limit_sim", model.velocity_limit(j)),
        ):
            if value is not None and math.isfinite(value):
                limits[key][re.escape(joint)] = float(value)
    return {
        **{key: value for key, value in limits.items() if value},
        "armature": table(torques.rotor_inertia),
        "friction": table(torques.static),
        "dynamic_friction": table(torques.coulomb),
        "viscous_friction": table(torques.damping[:, 0]),
    }


def _usd(model: SimulatorModel) -> dict[str, dict[str, float]]:
    """Attributes of the joint prims in USD."""
    torques, out = model.torques, dict[str, dict[str, float]]()
    for j, joint in enumerate(model.joints):
        slides = model.model.robot.entries[j].kind == "prismatic"
        axis = f"physxJointAxis:{'linear' if slides else 'angular'}"
        viscous, velocity = float(torques.damping[j, 0]), model.velocity_limit(j)
        out[joint] = {
            f"{axis}:armature": float(torques.rotor_inertia[j]),
            f"{axis}:staticFrictionEffort": float(torques.static[j]),
            f"{axis}:dynamicFrictionEffort": float(torques.coulomb[j]),
            f"{axis}:viscousFrictionCoefficient": viscous
            if slides
            else viscous_per_degree(viscous),
        }
        if velocity is not None and math.isfinite(velocity):
            out[joint][f"{axis}:maxJointVelocity"] = velocity * (1.0 if slides else DEGREES)
    return out


def _shown(value: object) -> str:
    """A Python literal, wrapped and indented."""
    return pprint.pformat(value, width=88, sort_dicts=False).replace("\n", "\n    ")
