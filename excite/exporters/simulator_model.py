"""The identified robot as simulators describe it: links, joint parameters, and their provenance.

Simulators hold per joint an inertia of the rotor, a polynomial of the speed, Coulomb friction and a
spring that is a polynomial of the position. The effects of a diagnosis that have one of these forms
are added to the parameters; `held` and `remainders` say which effects are not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .. import __version__
from .._system.comments import ascii_line
from .._types import FloatArray
from ..diagnosis import fitted_effects
from ..errors import UnusableInput
from ..identification.identified_model import IdentifiedModel
from ..recordings import Recording
from ..robot.inertial_parameters import body_inertia
from ..robot.limits import Limits
from ..schemas.effects import EffectDocument, is_recording_filter

RMS_SECONDS = 20.0
"""Length of a recording, from its start, over which the torque of effects is evaluated [s]."""
SPRING_FORMS = {0: (1,), 2: (1, 2), 3: (1, 2, 3)}
"""Powers of the position in each polynomial form of the effect "spring"."""


class Held(Enum):
    """A part of the model that a simulator may or may not hold."""

    INERTIA = "link inertias"
    ROTOR_INERTIA = "rotor inertia"
    VISCOUS = "viscous friction"
    COULOMB = "Coulomb friction"
    WIDTH = "width of Coulomb friction"
    OFFSET = "offset"
    STATIC_FRICTION = "static friction"
    SPEED_POLYNOMIAL = "damping that grows with powers of the speed"
    SPRING = "linear spring"
    SPRING_POLYNOMIAL = "spring that is a polynomial of the position"
    ACTUATOR_DELAY = "delay of the actuator"


@dataclass(frozen=True)
class JointTorques:
    """Torque of each joint beyond the links', as polynomials and Coulomb friction.

    Attributes:
        rotor_inertia: Reflected rotor inertia. Shape (n,) [kg m² or kg].
        damping: Coefficients of q̇, q̇|q̇|, q̇³. Shape (n, 3) [N m s/rad, …].
        coulomb: Coulomb friction. Shape (n,) [N m or N].
        widths: Width w of its sign function tanh(q̇/w). Shape (n,) [rad/s or m/s].
        static: Friction at the onset of motion. Shape (n,) [N m or N].
        spring: Coefficients of 1, q, q², q³; the first is the offset. Shape (n, 4) [N m, …].
        actuator_delay: Time by which the torque acts after its command. Shape (n,) [s].
    """

    rotor_inertia: FloatArray
    damping: FloatArray
    coulomb: FloatArray
    widths: FloatArray
    static: FloatArray
    spring: FloatArray
    actuator_delay: FloatArray


@dataclass(frozen=True)
class Remainder:
    """A part of the model that a simulator does not hold.

    Attributes:
        name: Name of the effect or quantity.
        joint: Name of its joint; None: all joints.
        rms: RMS of its torque at that joint, or over all joints [N m or N]; None: unknown.
        unit: "N m" or "N".
    """

    name: str
    joint: str | None
    rms: float | None
    unit: str = "N m"

    @property
    def text(self) -> str:
        """The remainder in one line."""
        size = "torque unknown" if self.rms is None else f"{self.rms:.3g} {self.unit} rms"
        return f"{self.name}{'' if self.joint is None else f' at {self.joint}'}: {size}"

    def document(self) -> dict[str, Any]:
        """Content for JSON."""
        return {"name": self.name, "joint": self.joint, "rms": self.rms, "unit": self.unit}


@dataclass(frozen=True)
class SimulatorModel:
    """An identified robot, prepared for the file of a simulator.

    Attributes:
        model: The identified robot.
        document: Content of its `model.json`.
        psi: Standard parameters, with the effects that are parameters of links. Shape (P,).
        torques: Torque of each joint beyond the links'.
        held: For each effect of the model the quantity that stands for it; None where no simulator
            has one.
        rms: RMS torque of each effect at each joint along `rms_source`, shape (effects, n)
            [N m or N]; None: unknown.
        rotor_rms: RMS torque of the rotors along the same motion. Shape (n,) [N m or N].
        rms_source: Recording along which the RMS values hold.
        limits: Limits of the joints; None: those of the model's URDF, where it states some.
    """

    model: IdentifiedModel
    document: Mapping[str, Any]
    psi: FloatArray
    torques: JointTorques
    held: tuple[Held | None, ...]
    rms: FloatArray | None = None
    rotor_rms: FloatArray | None = None
    rms_source: str = ""
    limits: Limits | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.model.robot.joints

    def link_inertia(self, link: int) -> pin.Inertia:
        """Return the inertia of a link, in the frame of the joint that moves it.

        Raises:
            UnusableInput: Its mass is not positive.
        """
        phi = self.psi[10 * link : 10 * link + 10]
        if not phi[0] > 0.0 and np.any(phi):
            raise UnusableInput(
                f"{self.model.source}: link '{self.model.robot.links[link]}' has the mass "
                f"{phi[0]:g} kg but an inertia; identify again"
            )
        return body_inertia(phi)

    def position_limit(self, joint: int) -> tuple[float, float] | None:
        """Return lower and upper limit of a joint [rad or m]; None without."""
        return _position_limit(self.model, self.limits, joint)

    def velocity_limit(self, joint: int) -> float | None:
        """Return the velocity limit of a joint [rad/s or m/s]; None without."""
        if self.limits is not None:
            return float(self.limits.velocity[joint])
        return self.model.robot.entries[joint].velocity

    def torque_limit(self, joint: int) -> float | None:
        """Return the torque limit of a joint [N m or N]; None without."""
        if self.limits is not None:
            return float(self.limits.torque[joint])
        return self.model.robot.entries[joint].torque

    def remainders(
        self,
        holds: frozenset[Held],
        computes: Callable[[EffectDocument], bool] = lambda effect: False,
    ) -> list[Remainder]:
        """Return the parts of the model that a simulator with certain quantities does not hold.

        Args:
            holds: Quantities that the simulator holds.
            computes: Whether the file computes an effect for which simulators have no quantity.
        """
        robot, out = self.model.robot, list[Remainder]()
        for j, joint in enumerate(robot.joints):
            unit = robot.entries[j].unit("N m")
            rotor, offset = self.torques.rotor_inertia[j], self.torques.spring[j, 0]
            if Held.ROTOR_INERTIA not in holds and rotor > 0.0:
                rms = None if self.rotor_rms is None else float(self.rotor_rms[j])
                out.append(Remainder("rotor inertia", joint, rms, unit))
            if Held.OFFSET not in holds and offset:
                out.append(Remainder("offset", joint, abs(float(offset)), unit))
        for k, (effect, quantity) in enumerate(zip(self.model.effects, self.held, strict=True)):
            if (quantity is None or quantity not in holds) and not computes(effect):
                out.append(self._remainder(k, effect))
        return sorted(out, key=lambda part: -(np.inf if part.rms is None else part.rms))

    def _remainder(self, number: int, effect: EffectDocument) -> Remainder:
        """The torque of an effect that a simulator does not hold."""
        if effect.joint is None:
            rms = None if self.rms is None else float(np.linalg.norm(self.rms[number]))
            return Remainder(effect.effect, None, rms)
        joint = self.joints.index(effect.joint)
        rms = None if self.rms is None else float(self.rms[number, joint])
        return Remainder(
            effect.effect, effect.joint, rms, self.model.robot.entries[joint].unit("N m")
        )

    def header(
        self,
        simulator: str,
        holds: frozenset[Held],
        computes: Callable[[EffectDocument], bool] = lambda effect: False,
    ) -> list[str]:
        """Return the lines of the comment at the beginning of an exported file.

        Args:
            simulator: Name of the format.
            holds: Quantities that it holds.
            computes: Whether it computes an effect for which simulators have no quantity.

        Returns:
            Lines of printable ASCII.
        """
        sources = [Path(str(name)).name for name in self.document.get("recordings", [])]
        lines = [
            f"{simulator} written by excite {__version__}; robot {self.model.robot.name}",
            f"identified from: {', '.join(sources) or 'not stated'}",
            f"original description: {self.document.get('robot', {}).get('source', 'not stated')}",
            *self._errors(),
            "joint parameters, value +- standard deviation:",
            *(f"  {line}" for line in self._joint_lines()),
            *self._link_lines(),
        ]
        left = self.remainders(holds, computes)
        along = f" (along {Path(self.rms_source).name})" if self.rms_source else ""
        if left:
            lines.append(f"NOT in this file, as {simulator} has no field for it{along}:")
            lines += [f"  {part.text}" for part in left]
            lines.append("  the format python-friction of 'excite export' writes it as code")
        else:
            lines.append("everything that was identified is in this file")
        return [ascii_line(line) for line in lines]

    def _errors(self) -> list[str]:
        """Torque errors of the first validation recording, else of the first fitted one."""
        for key, words in (("validation", "held-out"), ("fit", "fitted")):
            for entry in self.document.get(key) or []:
                rows = entry.get("joints", {})
                errors = [f"{name} {_figure(row.get('rmse'))}" for name, row in rows.items()]
                source = Path(str(entry.get("recording", ""))).name
                return [f"{words} torque error, RMS [N m or N], {source}: {', '.join(errors)}"]
        return self._position_errors()

    def _position_errors(self) -> list[str]:
        """Position errors of a robot that was identified without torque, and what that means."""
        lines = []
        scale = self.document.get("scale")
        if scale is not None:
            lines.append(f"no torque was recorded: {scale.get('words', '')}")
        for key, words in (("position_validation", "held-out"), ("position_fit", "fitted")):
            for entry in self.document.get(key) or []:
                rows = entry.get("joints", {})
                errors = [f"{joint} {_figure(row['position_rmse'])}" for joint, row in rows.items()]
                source = Path(str(entry.get("recording", ""))).name
                text = f"{words} position error, RMS [rad or m], {source}: {', '.join(errors)}"
                return [*lines, text]
        return lines

    def _joint_lines(self) -> list[str]:
        """Identified joint parameters of each joint with their standard deviations."""
        stated = {
            (str(row.get("of", "")), _kind(str(row["name"]))): row
            for row in self.document.get("standard_parameters", [])
        }
        lines = []
        for joint in self.joints:
            parts = []
            for kind, symbol in (
                ("rotor_inertia", "Ia"),
                ("viscous", "Fv"),
                ("coulomb", "Fc"),
                ("offset", "tau0"),
            ):
                row = stated.get((joint, symbol))
                if row is not None and kind in self.model.drive:
                    std = row.get("std")
                    spread = "" if std is None else f" +- {float(std):.2g}"
                    unit = str(row.get("unit") or "").replace("²", "2")
                    name = kind.replace("_", " ")
                    parts.append(f"{name} {float(row['value']):.4g}{spread} {unit}".rstrip())
            lines.append(f"{joint}: {', '.join(parts) or 'none'}")
        return lines

    def _link_lines(self) -> list[str]:
        """Masses with the share that the data decide."""
        rows = self.document.get("link_estimates") or []
        if not rows:
            return []
        lines = ["masses [kg], and the share that the recordings decide (the rest is the prior's):"]
        for row in rows:
            mass = row["mass"]
            share = None if mass["data_share"] is None else round(100.0 * mass["data_share"])
            lines.append(
                f"  {row['name']}: {_figure(mass['value'], 4)} +- {_figure(mass['std'], 2)}, "
                f"{_figure(share)} % data"
            )
        return lines


def _position_limit(
    model: IdentifiedModel, limits: Limits | None, joint: int
) -> tuple[float, float] | None:
    """Lower and upper limit of a joint [rad or m]; None without."""
    if limits is None:
        return model.robot.entries[joint].position
    lower, upper = (float(value) for value in limits.position[joint])
    return (lower, upper) if np.isfinite([lower, upper]).all() else None


def _figure(value: float | None, digits: int = 3) -> str:
    """A number with some significant digits."""
    return "unknown" if value is None else f"{value:.{digits}g}"


def _kind(name: str) -> str:
    """Symbol of a standard parameter without its number: "Fc3" -> "Fc"."""
    return "tau0" if name.startswith("tau0") else name.rstrip("0123456789")


def simulator_model(
    model: IdentifiedModel,
    document: Mapping[str, Any],
    *,
    recording: Recording | None = None,
    limits: Limits | None = None,
) -> SimulatorModel:
    """Prepare an identified robot for the files of simulators.

    Args:
        model: The identified robot.
        document: Content of its `model.json`.
        recording: Motion along which the torque of the effects is evaluated; None: unknown.
        limits: Limits of the joints; None: those of the model's URDF.
    """
    psi, torques, held = _with_effects(model, limits)
    rms, rotor_rms, source = None, None, ""
    if recording is not None:
        rms, rotor_rms = _effect_rms(model, torques, recording)
        source = recording.source
    return SimulatorModel(
        model, document, psi, torques, tuple(held), rms, rotor_rms, source, limits
    )


def _drive(model: IdentifiedModel, kind: str) -> FloatArray:
    """Joint parameters of one kind; 0 where the model has none. Shape (n,)."""
    if kind not in model.drive:
        return np.zeros(model.robot.n)
    return np.array(model.psi[model.layout.block(kind)])


def _with_effects(
    model: IdentifiedModel, limits: Limits | None
) -> tuple[FloatArray, JointTorques, list[Held | None]]:
    """Parameters with every effect that has the form of one, and the quantity of each effect."""
    n, psi = model.robot.n, model.psi.copy()
    spring, damping = np.zeros((n, 4)), np.zeros((n, 3))
    spring[:, 0], damping[:, 0] = _drive(model, "offset"), _drive(model, "viscous")
    out = JointTorques(
        _drive(model, "rotor_inertia"),
        damping,
        _drive(model, "coulomb"),
        model.widths.copy(),
        np.zeros(n),
        spring,
        np.zeros(n),
    )
    held = [_add_effect(model, effect, psi, out, limits) for effect in model.effects]
    out.static[:] += out.coulomb
    return psi, out, held


def _add_offset(out: JointTorques, j: int, c: FloatArray) -> None:
    out.spring[j, 0] += c[0]


def _add_rotor_inertia(out: JointTorques, j: int, c: FloatArray) -> None:
    out.rotor_inertia[j] += c[0]


def _add_friction(out: JointTorques, j: int, c: FloatArray) -> None:
    out.coulomb[j] += c[0]
    out.damping[j, 0] += c[1]


def _add_drag(out: JointTorques, j: int, c: FloatArray) -> None:
    out.damping[j, 1] += c[0]


_ADDITIONS: Mapping[str, tuple[Held, Callable[[JointTorques, int, FloatArray], None]]] = {
    "torque_offset": (Held.OFFSET, _add_offset),
    "rotor_inertia": (Held.ROTOR_INERTIA, _add_rotor_inertia),
    "friction": (Held.COULOMB, _add_friction),
    "drag": (Held.SPEED_POLYNOMIAL, _add_drag),
}
"""Effects of a joint that are one of its parameters, and how they are added to them."""


def _add_effect(
    model: IdentifiedModel,
    effect: EffectDocument,
    psi: FloatArray,
    out: JointTorques,
    limits: Limits | None,
) -> Held | None:
    """Add an effect to the parameters; return the quantity that stands for it, None without."""
    if effect.effect == "payload" and effect.time is None:
        link, count = int(effect.values["link"]), int(effect.values["count"])
        psi[10 * link : 10 * link + count] += np.array(effect.coefficients)
        return Held.INERTIA
    if effect.effect == "delay":
        return _add_delay(model, effect, out)
    return None if effect.joint is None else _add_joint_effect(model, effect, out, limits)


def _add_joint_effect(
    model: IdentifiedModel, effect: EffectDocument, out: JointTorques, limits: Limits | None
) -> Held | None:
    """Add an effect of one joint to its parameters; see `_add_effect`.

    A polynomial spring stays as it is at the ends of the positions to which it was fitted; one that
    simulators evaluate goes on. It is held only where the joint does not reach beyond them.
    """
    values, c = effect.values, np.array(effect.coefficients, float)
    j = model.robot.joints.index(str(effect.joint))
    held = None
    if effect.effect in _ADDITIONS:
        held, add = _ADDITIONS[effect.effect]
        add(out, j, c)
    elif effect.effect == "stribeck":
        out.static[j] += c.sum()  # each of its curves is 1 at rest
        held = Held.STATIC_FRICTION
    elif (
        effect.effect == "spring"
        and int(values.get("form", -1)) in SPRING_FORMS
        and _stays_within(_position_limit(model, limits, j), values)
    ):
        powers = SPRING_FORMS[int(values["form"])]
        out.spring[j, list(powers)] += c
        held = Held.SPRING if powers == (1,) else Held.SPRING_POLYNOMIAL
    return held


def _stays_within(limit: tuple[float, float] | None, values: Mapping[str, float]) -> bool:
    """True if a joint stays within the positions to which a spring was fitted, if it has any."""
    if "low" not in values:
        return True
    return limit is not None and values["low"] <= limit[0] and limit[1] <= values["high"]


def _add_delay(model: IdentifiedModel, effect: EffectDocument, out: JointTorques) -> Held | None:
    """Add a delay of the actuators: torque that is recorded before the motion that it causes.

    Torque that is recorded after the motion is a delay of its measurement, not of the actuator, and
    so is a filter.
    """
    if is_recording_filter(effect.values):
        return None
    seconds = float(effect.coefficients[0])
    if seconds >= 0.0:
        return None
    out.actuator_delay[effect.joint_index(model.robot.joints)] -= seconds
    return Held.ACTUATOR_DELAY


def _effect_rms(
    model: IdentifiedModel, torques: JointTorques, recording: Recording
) -> tuple[FloatArray, FloatArray]:
    """RMS torque of each effect, shape (effects, n), and of the rotors, shape (n,), along a
    recording."""
    start = float(recording.t[0])
    part = recording.between(start, start + RMS_SECONDS)
    base = fitted_effects.predict(dataclasses.replace(model, effects=()), part)[1]
    rms = np.zeros((len(model.effects), model.robot.n))
    for k, effect in enumerate(model.effects):
        single = dataclasses.replace(model, effects=(effect,))
        rms[k] = np.sqrt(np.mean((fitted_effects.predict(single, part)[1] - base) ** 2, axis=0))
    rotors = torques.rotor_inertia * np.sqrt(np.mean(part.samples().ddq ** 2, axis=0))
    return rms, rotors
