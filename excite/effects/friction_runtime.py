"""Friction and other joint torques of one robot, for simulators and controllers.

Needs NumPy only. `Friction.torque` is the torque that the motors have to produce on top of that of
the rigid links and rotors: friction opposes the motion, so that a simulator applies its negative.

    friction = Friction(TABLE)
    tau = friction.torque(q, dq, load)

Positions, velocities and loads have the shape (n,), or (environments, n) for many robots at once.
The load is the torque of the rigid links, without rotors and friction [N m]: inverse dynamics of q,
dq, ddq. Presliding hysteresis (Maxwell-slip elements), and other dry friction that builds up in the
same elements, has a state, which `torque` advances by the change of q since the last call; `reset`
forgets it. The state does not depend on time: repeated calls at one position change nothing.

MuJoCo: `install(mujoco, model, friction, beyond="mjcf")` subtracts from the passive forces what the
exported MJCF does not hold. Isaac Lab: subtract `friction.torque(q, dq, load, beyond="isaaclab")`
in `compute` of an actuator, with the tensors as NumPy arrays.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

STRIBECK_SPEEDS = np.geomspace(0.03, 0.3, 4).tolist()
"""Speeds to which Stribeck curves fall, over the largest speed."""
ASINH_SPEEDS = (0.02, 0.1, 0.4)
"""Speeds of the asinh curves of nonlinear viscous friction (Eyring), over the largest speed."""
TANH_SPEEDS = (0.1, 0.4)
"""Speeds of its tanh curves, over the largest speed."""
CONCAVE_CURVES = len(ASINH_SPEEDS) + len(TANH_SPEEDS) + 1
"""Number of concave curves of nonlinear viscous friction, the first ones: the last is the root."""
CURVE_POINTS = 200
"""Positions over which the mean of a wave of position-dependent friction is formed."""
ELEMENTS = 20
"""Maxwell-slip elements of a joint: half an octave of deflection from one to the next."""
UNEQUAL_ELEMENTS = [10, 14]
"""Elements whose branches may be unequal: those of 8 and 32 mrad, in the middle of the reaches."""
LAST_REACH = 0.181
"""Deflection at which the last element of a revolute joint slips [rad]."""
DAMPING_TIME = 0.15
"""Damping over stiffness of an element, over the root of its reach in radians [s/√rad]. A bristle
of mass I with a damping ratio ζ has 2 ζ √(I d/F): 0.15 √d for ζ = 0.15, of a usual 0.05 to 0.4, and
F/I = 4 rad/s²."""


class JointMotion(NamedTuple):
    """Motion of a joint, as its torque depends on it; numbers, arrays or symbols.

    Attributes:
        q: Position [rad or m].
        dq: Velocity.
        ddq: Acceleration.
        load: Torque of the rigid links [N m or N].
        other_dq: Velocity of the joint that a coupling comes from.
        other_ddq: Acceleration of that joint.
        width: Width of the base model's sign function [rad/s or m/s].
    """

    q: Any = 0.0
    dq: Any = 0.0
    ddq: Any = 0.0
    load: Any = 0.0
    other_dq: Any = 0.0
    other_ddq: Any = 0.0
    width: float = 1.0


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


class Column(NamedTuple):
    """Torque per unit of a coefficient, over `unit`: smooth + dry · sign(dq).

    Attributes:
        dry: Factor of the sign of the velocity.
        smooth: Part without a sign.
    """

    dry: Any = 0.0
    smooth: Any = 0.0


def columns(effect: str, v: dict[str, float], x: JointMotion, m: Any = np) -> list[Column]:
    """Return the columns of an effect without memory, in the order of its coefficients.

    The functions are those of a module m: numpy, or casadi for symbols.
    """
    return _COLUMNS[effect](v, x, m)


def unit(v: dict[str, float]) -> float:
    """Return the torque over which columns are stated [N m or N]: that of load friction, or 1."""
    return v.get("scale", 1.0)


def stateless(term: Term, x: JointMotion, m: Any = np) -> tuple[Any, Any]:
    """Return s and d of a term's torque s + d sign(dq), the sign smooth over the width."""
    parts = columns(term.effect, term.values, x, m)
    c, scale = term.coefficients, unit(term.values)
    smooth = sum(a * part.smooth for a, part in zip(c, parts, strict=True))
    return scale * smooth, scale * sum(a * part.dry for a, part in zip(c, parts, strict=True))


def _dry(factors: list[Any]) -> list[Column]:
    return [Column(dry=factor) for factor in factors]


def _smooth(parts: list[Any]) -> list[Column]:
    return [Column(smooth=part) for part in parts]


def _stribeck(v: dict[str, float], x: JointMotion, m: Any) -> list[Column]:
    shares = [m.fabs(x.dq) / (speed * v["top_speed"]) for speed in STRIBECK_SPEEDS]
    return _dry([m.exp(-share) for share in shares] + [m.exp(-(share**2)) for share in shares])


def _nonlinear_viscous(v: dict[str, float], x: JointMotion, m: Any) -> list[Column]:
    # beyond the speeds of the fit no curve rises by more than the line through its end: concave
    # ones go on as they are, convex ones, which would grow without bound, along that line
    share = x.dq / v["top_speed"]
    size, sign = m.fabs(share), m.sign(share)
    inner = m.fmin(size, 1.0)
    concave = [m.arcsinh(share / w) / float(np.arcsinh(1.0 / w)) for w in ASINH_SPEEDS]
    concave += [m.tanh(share / w) / float(np.tanh(1.0 / w)) for w in TANH_SPEEDS]
    concave.append(sign * m.sqrt(size))
    convex = [share * inner, share * inner**2]
    # less the line of equal friction at the largest speed, as far as viscous friction makes it up
    line = share - (1.0 - v.get("line_share", 1.0)) * sign * (size - inner)
    return _smooth([curve - line for curve in concave] + [curve - share for curve in convex])


def _load_friction(v: dict[str, float], x: JointMotion, m: Any) -> list[Column]:
    # what is lost in driving the load and in being driven by it: a common part of both, and more
    # of one of them
    share = m.fabs(x.load) / v["scale"]
    load = x.load / v["scale"]
    return [*_dry([share, share**2]), Column(share, load), Column(share, -load)]


def _position_friction(v: dict[str, float], x: JointMotion, m: Any) -> list[Column]:
    positions, waves = np.linspace(v["low"], v["high"], CURVE_POINTS), []
    # like a spring, a sum of waves says nothing beyond the positions of its recordings if these are
    # less than a period
    is_part = v["waves"] > 1.0 and v["order"] * (v["high"] - v["low"]) < 2.0 * np.pi
    q = m.fmin(m.fmax(x.q, v["low"]), v["high"]) if is_part else x.q
    for order in [(k + 1) * v["order"] for k in range(int(v["waves"]))]:
        # friction that does not vary over the range of the joint is Coulomb friction
        waves.append(m.cos(order * q) - float(np.cos(order * positions).mean()))
        waves.append(m.sin(order * q) - float(np.sin(order * positions).mean()))
    return _dry(waves)


SPRING_FORMS = (
    lambda q, m: [q],
    lambda q, m: [m.cos(q), m.sin(q)],
    lambda q, m: [q, q**2],
    lambda q, m: [q, q**2, q**3],
    lambda q, m: [m.cos(q), m.sin(q), m.cos(2 * q), m.sin(2 * q)],
)
"""Torque of usual springs and counterbalances over the position, by their number in a model."""


def _spring(v: dict[str, float], x: JointMotion, m: Any) -> list[Column]:
    # only a line and a sine wave say something beyond the positions of their recordings
    q = m.fmin(m.fmax(x.q, v["low"]), v["high"]) if "low" in v else x.q
    if "waves" in v:
        place = (q - v["low"]) / (v["high"] - v["low"])
        return _smooth([m.cos(np.pi * (place * (k + 1))) for k in range(int(v["waves"]))])
    if "bend" in v:
        distance = q - v["bend"]
        return _smooth([m.fmin(distance, 0.0), m.fmax(distance, 0.0)])
    if "order" in v:
        phase = v["order"] * (q - v["about"])
        return _smooth([q - v["about"], m.cos(phase) - 1.0, m.sin(phase)])
    return _smooth(SPRING_FORMS[int(v["form"])](q, m))


def _torque_ripple(v: dict[str, float], x: JointMotion, m: Any) -> list[Column]:
    waves = [m.cos(v["order"] * x.q), m.sin(v["order"] * x.q)]
    return _smooth([*waves, *(x.load / v["load"] * wave for wave in waves)])


def _coupling(v: dict[str, float], x: JointMotion, m: Any) -> list[Column]:
    speed = x.dq + v["ratio"] * x.other_dq
    friction = [speed, m.tanh(speed / x.width)]
    return _smooth(friction if "light" in v else [*friction, v["ratio"] * x.other_ddq])


_COLUMNS: dict[str, Any] = {
    "base": lambda v, x, m: [Column(dry=1.0), Column(smooth=x.dq)],
    "base_offset": lambda v, x, m: _smooth([1.0]),
    "asymmetric_viscous": lambda v, x, m: _smooth([m.fabs(x.dq)]),
    "stribeck": _stribeck,
    "nonlinear_viscous": _nonlinear_viscous,
    "drag": lambda v, x, m: _smooth([x.dq * m.fabs(x.dq)]),
    "load_friction": _load_friction,
    "position_friction": _position_friction,
    "friction": lambda v, x, m: [Column(dry=1.0), Column(smooth=x.dq)],
    "torque_offset": lambda v, x, m: _smooth([1.0]),
    "spring": _spring,
    "torque_ripple": _torque_ripple,
    "coupling": _coupling,
}
"""Columns of each effect without memory; "base" has the coefficients Coulomb and viscous friction
of the base model, "base_offset" its offset."""
WITH_MEMORY = ("hysteresis",)
"""Effects whose torque depends on the past of the position."""


def has_state(term: Term) -> bool:
    """Return whether a term has Maxwell-slip elements: its own, or those in which it builds up."""
    return term.effect in WITH_MEMORY or "share_0" in term.values


KNOWN = (*_COLUMNS, *WITH_MEMORY)
"""Effects that this module computes."""


def reaches(v: dict[str, float]) -> Any:
    """Return the deflections at which the elements slip, shape (ELEMENTS,) [rad or m]."""
    return np.geomspace(v["reach"], v["last_reach"], ELEMENTS)


def shares(v: dict[str, float]) -> Any:
    """Return the shares of the elements in dry friction, shape (ELEMENTS,)."""
    return np.array([v[f"share_{i}"] for i in range(ELEMENTS)])


def damping(v: dict[str, float]) -> Any:
    """Return the damping of each element while it sticks, per damping coefficient, (ELEMENTS,)."""
    times = DAMPING_TIME * np.sqrt(reaches(v) * LAST_REACH / v["last_reach"])
    return shares(v) * times / reaches(v)


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
        self.distances = reaches(term.values)
        self.strengths, self.damping = shares(term.values), np.zeros(ELEMENTS)
        self.unequal = np.zeros(len(UNEQUAL_ELEMENTS))
        if term.effect in WITH_MEMORY:
            c = np.array(term.coefficients, float)
            self.strengths, self.unequal = np.split(c[: ELEMENTS + len(self.unequal)], [ELEMENTS])
            self.damping = damping(term.values) * c[-1]
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
        q, load, others = q[..., j], load[..., j], (dq[..., other], ddq[..., other])
        return JointMotion(q, dq[..., j], ddq[..., j], load, *others, float(self.widths[j]))


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
