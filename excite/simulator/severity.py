"""How much of a hidden effect survives a refit of the base model, over the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, signal

from .._types import FloatArray
from ..errors import UnusableInput
from . import mujoco_dynamics as arms
from .effect_instance import EffectInstance, with_effects
from .measurement import MeasurementChain
from .physical_effect import PhysicalEffect
from .reference_trajectory import ReferenceTrajectory
from .regressor import actuator_regressor, rigid_body_regressor
from .simulated_robot import SimulatedMotion, SimulatedRobot

SEVERITY_BAND = 20.0
RATE, RATTLING, KEPT = 200.0, 2000.0, 100.0
"""At which torque is looked at; where teeth or springs may swing at hundreds of Hz, which must not pass for slow; and of what is below
20 Hz, kept [Hz]."""


@dataclass(frozen=True)
class Severity:
    """joints: RMS of the surviving torque below 20 Hz over the noise's, Shape (n,). value: the largest."""

    joints: FloatArray

    @property
    def value(self) -> float:
        return float(self.joints.max())


@dataclass(frozen=True)
class HiddenTorque:
    """What a run hides at given times, and where the base model looks for it.

    torque: told beyond the base model's, Shape (N, n) [N m]. q, v, a: the motion that the robot tells, without noise.
    """

    torque: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray


def hidden_torque(run: SimulatedMotion, plant: SimulatedRobot, t: FloatArray) -> HiddenTorque:
    """The torque that the base model, rightly parametrised, misses along the told motion; `plant` is the robot without effects."""
    (q, v, a), (told, tau) = run.motor_motion(t), run.measured_torque(t)
    if any(
        type(law).measured_position is not PhysicalEffect.measured_position
        for law in run.robot.effects
    ):
        # the error's derivatives, by central differences much finer than its waves
        h = 1e-4
        before, here, after = (_position_error(run, t + shift) for shift in (-h, 0.0, h))
        q, v, a = told, v + (after - before) / (2 * h), a + (after - 2 * here + before) / h**2
    arm, drive = (
        arms.build_dynamics(plant.tree, plant.joints, plant.lock, plant.gravity),
        plant.drive,
    )
    return HiddenTorque(
        tau - (arm.inverse_dynamics(q, v, a) + drive.inertia * a + drive.friction_torque(v)),
        q,
        v,
        a,
    )


def _position_error(run: SimulatedMotion, t: FloatArray) -> FloatArray:
    theta = run.motor_motion(t)[0]
    seen = theta
    for law in run.robot.effects:
        seen = law.measured_position(seen)
    return seen - theta


def residual_torque(
    run: SimulatedMotion,
    plant: SimulatedRobot,
    reference: ReferenceTrajectory,
    *,
    trusted: bool = False,
) -> FloatArray:
    """Torque below 20 Hz that the base model does not explain along the periodic part of a motion. Shape (N, n) [N m].

    trusted: the base model stays as it is, nothing is refit.
    """
    rate = RATTLING if run.robot.springs else RATE
    found = hidden_torque(
        run, plant, np.arange(reference.periodic[0], reference.periodic[1], 1.0 / rate)
    )
    rest = _low_passed(found.torque, rate)
    if trusted:
        return rest
    arm = arms.build_dynamics(plant.tree, plant.joints, plant.lock, plant.gravity)
    every = [
        _low_passed(part, rate)
        for part in (
            rigid_body_regressor(arm, found.q, found.v, found.a),
            actuator_regressor(found.v, found.a, plant.drive.width),
        )
    ]
    weight = 1.0 / plant.limit
    columns = np.concatenate(every, axis=2) * weight[:, None]
    return np.asarray(
        rest
        - _projection(columns.reshape(-1, columns.shape[2]), (rest * weight).ravel()).reshape(
            rest.shape
        )
        / weight
    )


def _projection(columns: FloatArray, target: FloatArray) -> FloatArray:
    """The part of the target in the columns' span, whatever their rank."""
    size = np.sqrt(np.square(columns).mean(axis=0))
    kept = columns[:, size > 1e-12 * size.max()] / size[size > 1e-12 * size.max()]
    basis, triangle, _ = linalg.qr(kept, mode="economic", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    basis = basis[:, diagonal > 1e-9 * diagonal[0]]
    return np.asarray(basis @ (basis.T @ target))


def _low_passed(x: FloatArray, rate: float) -> FloatArray:
    """Below 20 Hz, zero phase, as many samples as that needs."""
    return np.asarray(
        signal.sosfiltfilt(signal.butter(4, SEVERITY_BAND, fs=rate, output="sos"), x, axis=0)[
            :: round(rate / KEPT)
        ]
    )


def evaluate_severity(
    run: SimulatedMotion,
    plant: SimulatedRobot,
    reference: ReferenceTrajectory,
    chain: MeasurementChain,
    *,
    trusted: bool = False,
) -> Severity:
    """Severity of what a run hides; `plant` is the same robot without it."""
    rest = residual_torque(run, plant, reference, trusted=trusted)
    return Severity(np.sqrt(np.square(rest).mean(axis=0)) / chain.noise_floor(SEVERITY_BAND))


def scale_to_severity(
    effect: EffectInstance,
    target: float,
    plant: SimulatedRobot,
    reference: ReferenceTrajectory,
    chain: MeasurementChain,
    *,
    trusted: bool = False,
    tolerance: float = 0.15,
    tries: int = 4,
    largest: float = np.inf,
) -> tuple[EffectInstance, SimulatedMotion, Severity]:
    """The effect scaled until its severity is `target`, to a factor of 1 ± tolerance, or as near as `tries` runs come.

    Secant steps in the logarithms, from the effect as given and never beyond `largest` times it, nor beyond what physics allows. A robot
    that the controller loses has too much of it. Raises UnusableInput when all tries are lost.
    """

    def probe(size: float) -> tuple[EffectInstance, SimulatedMotion, Severity]:
        sized = effect.sized(size)
        run = with_effects(plant, (sized,)).run(reference)
        return sized, run, evaluate_severity(run, plant, reference, chain, trusted=trusted)

    largest = min(largest, effect.most(plant))
    size, slope, last = min(1.0, largest), 1.0, None
    found: list[tuple[float, tuple[EffectInstance, SimulatedMotion, Severity]]] = []
    for _ in range(tries):
        try:
            tried = probe(size)
        except UnusableInput as error:
            lost, size = error, 0.3 * size
            continue
        here = (float(np.log(size)), float(np.log(max(tried[2].value, 1e-9) / target)))
        found.append((abs(here[1]), tried))
        if abs(here[1]) < np.log1p(tolerance) or (size >= largest and here[1] < 0.0):
            break
        if last is not None and abs(here[0] - last[0]) > 1e-6:
            slope = float(np.clip((here[1] - last[1]) / (here[0] - last[0]), 0.5, 4.0))
        last, size = here, min(largest, size * float(np.exp(np.clip(-here[1] / slope, -4.0, 4.0))))
    if not found:
        raise lost
    return min(found, key=lambda entry: entry[0])[1]
