"""Friction and other joint torques of one robot, for simulators and controllers.

Needs NumPy only. `Friction.torque` is the torque that the motors have to produce on top of that of
the rigid links and rotors: friction opposes the motion, so that a simulator applies its negative.

    friction = Friction(TABLE)
    tau = friction.torque(q, dq, load)

Positions, velocities and loads have the shape (n,), or (environments, n) for many robots at once.
The load is the torque of the rigid links, without rotors and friction [N m]: inverse dynamics of q,
dq, ddq. Presliding hysteresis (Maxwell-slip elements), and other dry friction that builds up in the
same elements, has a state, which `torque` advances by the change of q since the last call; `reset`
forgets it. The state does not depend on time, so that
repeated calls at one position change nothing.

MuJoCo: `install(mujoco, model, friction, beyond="mjcf")` subtracts from the passive forces what the
exported MJCF does not hold. Isaac Lab: subtract `friction.torque(q, dq, load, beyond="isaaclab")`
in `compute` of an actuator, with the tensors as NumPy arrays.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

CURVE_POINTS = 200
"""Positions over which the mean of a wave of position-dependent friction is formed."""
STRIBECK_SPEEDS = np.geomspace(0.03, 0.3, 4)
"""Speeds to which Stribeck curves fall, over the largest speed."""
ASINH_SPEEDS = (0.02, 0.1, 0.4)
"""Speeds of the asinh curves of nonlinear viscous friction, over the largest speed."""
TANH_SPEEDS = (0.1, 0.4)
"""Speeds of its tanh curves, over the largest speed."""
ELEMENTS = 20
"""Maxwell-slip elements of a joint."""
UNEQUAL_ELEMENTS = [10, 14]
"""Maxwell-slip elements whose branches may be unequal."""
DAMPING_TIME = 0.15
"""Damping over stiffness of an element, over the root of its reach in radians [s/√rad]."""
LAST_REACH = 0.181
"""Reach of the last element of a revolute joint [rad]."""


class JointMotion(NamedTuple):
    """JointMotion of a joint, as its torque depends on it; numbers, arrays or symbols.

    Attributes:
        q: Position [rad or m].
        dq: Velocity.
        ddq: Acceleration.
        load: Torque of the rigid links [N m or N].
        other_dq: Velocity of the joint that a coupling comes from.
        other_ddq: Acceleration of that joint.
        width: Width of the base model's sign function [rad/s or m/s].
    """

    q: Any
    dq: Any
    ddq: Any
    load: Any
    other_dq: Any
    other_ddq: Any
    width: float


class Term(NamedTuple):
    """A part of the torque of one joint.

    Attributes:
        effect: Name of the effect.
        joint: Index of the joint.
        other: Index of the joint that a coupling comes from; -1 without.
        values: Nonlinear parameters.
        coefficients: Linear coefficients.
        held_by: Simulators whose exported file holds this part.
    """

    effect: str
    joint: int
    other: int
    values: dict[str, float]
    coefficients: list[float]
    held_by: list[str]


def stateless(term: Term, x: JointMotion, m: Any = np) -> tuple[Any, Any]:
    """Return both parts of a term's torque s + d sign(dq), the sign smooth over the width.

    Args:
        term: A term without memory.
        x: JointMotion of its joint.
        m: Module of the functions: numpy, or casadi for symbols.

    Returns:
        The smooth part s and the factor d of the sign [N m or N].
    """
    return _FUNCTIONS[term.effect](term.values, term.coefficients, x, m)


def _base(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    return c[0] * x.dq, c[1]


def _asymmetric_viscous(
    v: dict[str, float], c: list[float], x: JointMotion, m: Any
) -> tuple[Any, Any]:
    return c[0] * m.fabs(x.dq), 0.0


def _stribeck(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    shares = [m.fabs(x.dq) / (speed * v["top_speed"]) for speed in STRIBECK_SPEEDS.tolist()]
    curves = [m.exp(-share) for share in shares] + [m.exp(-(share**2)) for share in shares]
    return 0.0, _combination(c, curves)


def _nonlinear_viscous(
    v: dict[str, float], c: list[float], x: JointMotion, m: Any
) -> tuple[Any, Any]:
    # beyond the speeds of the fit the friction goes on linearly
    share = m.fmin(m.fmax(x.dq / v["top_speed"], -1.0), 1.0)
    size = m.fabs(share)
    curves = [m.arcsinh(share / w) / float(np.arcsinh(1.0 / w)) for w in ASINH_SPEEDS]
    curves += [m.tanh(share / w) / float(np.tanh(1.0 / w)) for w in TANH_SPEEDS]
    curves += [m.sign(share) * m.sqrt(size), share * size, share**3]
    return _combination(c, [curve - share for curve in curves]), 0.0


def _combination(c: list[float], curves: list[Any]) -> Any:
    """Sum of curves times their coefficients."""
    return sum(a * curve for a, curve in zip(c, curves, strict=True))


def _drag(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    return c[0] * x.dq * m.fabs(x.dq), 0.0


def _load_friction(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    size = m.fabs(x.load)
    return c[2] * x.load, c[0] * size + c[1] * size**2 / v["scale"]


def _position_friction(
    v: dict[str, float], c: list[float], x: JointMotion, m: Any
) -> tuple[Any, Any]:
    positions, total = np.linspace(v["low"], v["high"], CURVE_POINTS), 0.0
    for k in range(int(v["waves"])):
        order = (k + 1) * v["order"]
        total = total + c[2 * k] * (m.cos(order * x.q) - float(np.cos(order * positions).mean()))
        total = total + c[2 * k + 1] * (
            m.sin(order * x.q) - float(np.sin(order * positions).mean())
        )
    return 0.0, total


def _friction(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    return c[1] * x.dq, c[0]


def _torque_offset(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    return c[0], 0.0


def _spring(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    q = m.fmin(m.fmax(x.q, v["low"]), v["high"]) if "low" in v else x.q
    if "waves" in v:
        phase = np.pi * (q - v["low"]) / (v["high"] - v["low"])
        return _combination(c, [m.cos((k + 1) * phase) for k in range(int(v["waves"]))]), 0.0
    if "bend" in v:
        distance = x.q - v["bend"]  # a line goes on beyond the ends of a curve
        return c[0] * m.fmin(distance, 0.0) + c[1] * m.fmax(distance, 0.0), 0.0
    if "order" in v:
        phase = v["order"] * (q - v["about"])
        wave = c[1] * (m.cos(phase) - 1.0) + c[2] * m.sin(phase)
        return c[0] * (q - v["about"]) + wave, 0.0
    columns = (
        (q,),
        (m.cos(q), m.sin(q)),
        (q, q**2),
        (q, q**2, q**3),
        (m.cos(q), m.sin(q), m.cos(2 * q), m.sin(2 * q)),
    )[int(v["form"])]
    return _combination(c, list(columns)), 0.0


def _torque_ripple(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    angle, load = v["order"] * x.q, x.load / v["load"]
    return (c[0] + c[2] * load) * m.cos(angle) + (c[1] + c[3] * load) * m.sin(angle), 0.0


def _coupling(v: dict[str, float], c: list[float], x: JointMotion, m: Any) -> tuple[Any, Any]:
    speed = x.dq + v["ratio"] * x.other_dq
    total = c[0] * speed + c[1] * m.tanh(speed / x.width)
    return (total if "light" in v else total + c[2] * v["ratio"] * x.other_ddq), 0.0


_FUNCTIONS = {
    "base": _base,
    "base_offset": _torque_offset,
    "asymmetric_viscous": _asymmetric_viscous,
    "stribeck": _stribeck,
    "nonlinear_viscous": _nonlinear_viscous,
    "drag": _drag,
    "load_friction": _load_friction,
    "position_friction": _position_friction,
    "friction": _friction,
    "torque_offset": _torque_offset,
    "spring": _spring,
    "torque_ripple": _torque_ripple,
    "coupling": _coupling,
}
"""Smooth part and factor of the sign of each effect without memory; "base" has the coefficients
viscous and Coulomb friction of the base model, "base_offset" its offset."""
WITH_MEMORY = ("hysteresis",)
"""Effects whose torque depends on the past of the position."""


def has_state(term: Term) -> bool:
    """Return whether a term has Maxwell-slip elements: its own, or those in which it builds up."""
    return term.effect in WITH_MEMORY or "share_0" in term.values


KNOWN = (*_FUNCTIONS, *WITH_MEMORY)
"""Effects that this module computes."""


class MaxwellSlipBank:
    """Maxwell-slip elements of one joint (Iwan 1966), of presliding hysteresis or other friction.

    Each element is a spring that slips at its distance d, so that its force is rate-independent:
    z advances by dq/d and stays within -1 and 1. The force of an element with unequal branches also
    has a part that is proportional to |z| - 1. While it sticks, an element is damped.

    Attributes:
        distances: Deflection at which each element slips, shape (elements,) [rad or m].
        strengths: Force of each element while it slips, shape (elements,) [N m or N], or its share
            of the force of a friction that builds up.
        unequal: Factor of |z| - 1 of the elements `UNEQUAL_ELEMENTS` [N m or N].
        damping: Damping of each element while it sticks, shape (elements,) [N m s/rad or N s/m].
    """

    def __init__(self, term: Term) -> None:
        """Begin with relaxed springs."""
        last = term.values["last_reach"]
        self.distances = np.geomspace(term.values["reach"], last, ELEMENTS)
        shares = np.array([term.values.get(f"share_{i}", 0.0) for i in range(ELEMENTS)])
        self.strengths, self.damping = shares, np.zeros(ELEMENTS)
        self.unequal = np.zeros(len(UNEQUAL_ELEMENTS))
        if term.effect in WITH_MEMORY:
            c = np.array(term.coefficients, float)
            self.strengths, self.unequal = np.split(c[: ELEMENTS + len(self.unequal)], [ELEMENTS])
            times = DAMPING_TIME * np.sqrt(self.distances * LAST_REACH / last)
            self.damping = shares * times / self.distances * c[-1]
        self.last: Any = None
        self.z: Any = None

    def advance(self, q: Any, dq: Any) -> Any:
        """Move to a position and velocity, shapes (...); return the force [N m or N]."""
        q = np.asarray(q, float)
        if self.z is None or self.z.shape[:-1] != q.shape:
            self.last, self.z = q.copy(), np.zeros((*q.shape, ELEMENTS))
        self.z = np.clip(self.z + (q - self.last)[..., None] / self.distances, -1.0, 1.0)
        self.last = q.copy()
        deflection = np.abs(self.z)
        force = self.z @ self.strengths + (deflection[..., UNEQUAL_ELEMENTS] - 1) @ self.unequal
        return force + np.asarray(dq, float) * ((deflection < 1.0) @ self.damping)


class Friction:
    """Friction and other joint torques of a robot.

    Attributes:
        joints: Names of the joints.
        widths: Widths of the sign function of friction, shape (n,) [rad/s or m/s].
    """

    def __init__(self, table: dict[str, Any]) -> None:
        """Build the terms from a table as this module states it."""
        self.joints = list(table["joints"])
        self.widths = np.array(table["widths"], float)
        self.terms = [Term(**term) for term in table["terms"]]
        self.banks: dict[int, MaxwellSlipBank] = {}
        self.reset()

    def reset(self) -> None:
        """Forget the past: presliding springs are relaxed at the next position."""
        self.banks = {
            k: MaxwellSlipBank(term) for k, term in enumerate(self.terms) if has_state(term)
        }

    def parts(
        self, q: Any, dq: Any, load: Any = None, ddq: Any = None, beyond: str | None = None
    ) -> tuple[Any, Any]:
        """Return the smooth torque and the factor of the sign; see `torque`, which adds both."""
        q, dq = np.asarray(q, float), np.asarray(dq, float)
        load = np.zeros_like(q) if load is None else np.asarray(load, float)
        ddq = np.zeros_like(q) if ddq is None else np.asarray(ddq, float)
        smooth, dry = np.zeros_like(q), np.zeros_like(q)
        for k, term in enumerate(self.terms):
            level: Any = 1.0
            if beyond not in term.held_by and term.effect not in WITH_MEMORY:
                s, level = stateless(term, self._motion(term, q, dq, ddq, load))
                smooth[..., term.joint] += s
                dry[..., term.joint] += level
            if k in self.banks:
                # the elements replace their part of the sign
                force = self.banks[k].advance(q[..., term.joint], dq[..., term.joint])
                if beyond not in term.held_by:
                    smooth[..., term.joint] += level * force
                    dry[..., term.joint] -= level * self.banks[k].strengths.sum()
        return smooth, dry

    def torque(
        self, q: Any, dq: Any, load: Any = None, ddq: Any = None, beyond: str | None = None
    ) -> Any:
        """Return the torque that the motors need on top of links and rotors.

        Args:
            q: Positions, shape (..., n) [rad or m].
            dq: Velocities.
            load: Torque of the rigid links [N m or N]; None: 0.
            ddq: Accelerations; None: 0. Only couplings with inertia depend on them.
            beyond: Simulator whose exported file is in use ("mjcf", "isaaclab"): only what it does
                not hold. None: all terms.

        Returns:
            Torque, shape (..., n) [N m or N].
        """
        smooth, dry = self.parts(q, dq, load, ddq, beyond)
        return smooth + dry * np.tanh(np.asarray(dq, float) / self.widths)

    def _motion(self, term: Term, q: Any, dq: Any, ddq: Any, load: Any) -> JointMotion:
        j, other = term.joint, max(term.other, 0)
        return JointMotion(
            q[..., j],
            dq[..., j],
            ddq[..., j],
            load[..., j],
            dq[..., other],
            ddq[..., other],
            float(self.widths[j]),
        )


def install(mujoco: Any, model: Any, friction: Friction, beyond: str | None = "mjcf") -> None:
    """Let MuJoCo subtract the friction from its passive forces, until mjcb_passive is set to None.

    Passive forces are integrated explicitly: the sign function is widened where a step would
    reverse the joint, to timestep times friction over inertia.

    Args:
        mujoco: The module mujoco.
        model: The compiled model; joints are matched by name.
        friction: The friction.
        beyond: See `Friction.torque`.
    """
    joints = [model.joint(name) for name in friction.joints]
    position = np.array([int(joint.qposadr[0]) for joint in joints])
    degree = np.array([int(joint.dofadr[0]) for joint in joints])
    step = model.opt.timestep * model.dof_invweight0[degree]
    load = np.zeros(model.nv)

    def passive(m: Any, data: Any) -> None:
        if m.nv != model.nv:
            return
        mujoco.mj_rne(m, data, 1, load)
        smooth, dry = friction.parts(
            data.qpos[position], data.qvel[degree], load[degree], data.qacc[degree], beyond
        )
        widths = np.maximum(friction.widths, step * np.abs(dry))
        data.qfrc_passive[degree] -= smooth + dry * np.tanh(data.qvel[degree] / widths)

    mujoco.set_mjcb_passive(passive)
