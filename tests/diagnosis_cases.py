"""Simulated recordings of a two-link robot with known effects, and their diagnoses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    validated,
)

from excite._types import FloatArray
from excite.diagnosis import diagnosis
from excite.diagnosis.diagnosis import Diagnosis, DiagnosisOptions
from excite.identification.identified_model import IdentifiedModel
from excite.identification.regression import IdentificationModel
from excite.recordings import Recording

NOISE = 0.1
"""Standard deviation of the white torque noise [N m]."""
Effect = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]
"""Torque of an effect [N m], shape (N, 2), from t, q, dq and the torque without it."""


def recordings_of(
    subject: IdentificationModel, effect: Effect | None
) -> tuple[Recording, Recording]:
    """Return a training and a held-out recording of a robot with an effect."""
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    out = []
    for seed in (2, 5):
        fourier = random_fourier(2, seed)
        recording = synthetic_recording(subject, psi, fourier, 4, 0.0)
        s = fourier.samples(recording.t)
        added = (
            np.zeros_like(recording.q)
            if effect is None
            else effect(recording.t, s.q, s.dq, recording.tau)
        )
        noise = NOISE * np.random.default_rng(seed).normal(size=recording.q.shape)
        out.append(
            dataclasses.replace(recording, tau=recording.tau + added + noise, source=f"{seed}.csv")
        )
    return out[0], out[1]


def diagnose_effect(
    subject: IdentificationModel, effect: Effect | None, **options: object
) -> Diagnosis:
    """Return the diagnosis of a robot with an effect."""
    train, held_out = recordings_of(subject, effect)
    return diagnosis.diagnose(
        subject.robot,
        subject.parameters,
        subject.base,
        [train],
        [held_out],
        DiagnosisOptions(**options),  # type: ignore[arg-type]
    )


def at_joint(joint: int, torque: FloatArray) -> FloatArray:
    """Return a torque of one joint, shape (N,), as a torque of both, shape (N, 2)."""
    out = np.zeros((len(torque), 2))
    out[:, joint] = torque
    return out


def shaft_friction(speed: FloatArray) -> FloatArray:
    """Return the friction of a shaft that is driven by two joints [N m]."""
    return 0.9 * np.tanh(speed / FRICTION_WIDTH) + 0.2 * speed


def maxwell_slip_force(q: FloatArray, thresholds: FloatArray) -> FloatArray:
    """Return the mean force of Maxwell-slip elements, each over its largest force [1].

    Each element is a spring that slips at a deflection of its threshold; simulated sample by
    sample.
    """
    out, anchors = np.empty((len(q), len(thresholds))), np.full(len(thresholds), q[0])
    for k, position in enumerate(q):
        anchors = np.clip(anchors, position - thresholds, position + thresholds)
        out[k] = (position - anchors) / thresholds
    return np.asarray(out.mean(axis=1))


EFFECTS: dict[str, tuple[Effect, int | None]] = {
    "asymmetric_viscous": (lambda t, q, dq, tau: at_joint(1, 0.35 * np.abs(dq[:, 1])), 1),
    "stribeck": (
        lambda t, q, dq, tau: at_joint(
            0, 1.5 * np.tanh(dq[:, 0] / FRICTION_WIDTH) * np.exp(-((np.abs(dq[:, 0]) / 0.12) ** 2))
        ),
        0,
    ),
    "torque_ripple": (lambda t, q, dq, tau: at_joint(1, 0.5 * np.cos(23.0 * q[:, 1] + 0.4)), 1),
    "spring": (lambda t, q, dq, tau: at_joint(1, 1.7 * q[:, 1]), 1),
    "position_friction": (
        lambda t, q, dq, tau: at_joint(
            0, 0.8 * np.tanh(dq[:, 0] / FRICTION_WIDTH) * np.cos(2.0 * q[:, 0] + 1.0)
        ),
        0,
    ),
    "coupling": (lambda t, q, dq, tau: at_joint(0, shaft_friction(dq[:, 0] - 0.7 * dq[:, 1])), 0),
    "delay": (
        lambda t, q, dq, tau: np.column_stack([np.interp(t - 0.006, t, c) for c in tau.T]) - tau,
        None,
    ),
}
"""Effects by name, each with its joint; independent of the formulas of `excite.effects`."""


def model_with_effects(
    subject: IdentificationModel, effects: tuple[dict[str, Any], ...]
) -> IdentifiedModel:
    """Return an identified model that contains some effects."""
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    return IdentifiedModel(
        "model.json",
        subject.robot,
        subject.parameters.drive,
        psi,
        np.full(2, FRICTION_WIDTH),
        20.0,
        tuple(validated(effect) for effect in effects),
    )


def effect_entry(
    effect: str, joint: str | None, values: dict[str, float], *coefficients: float
) -> dict[str, Any]:
    """Return the entry of an effect in a `model.json`."""
    return {
        "effect": effect,
        "joint": joint,
        "from": None,
        "values": values,
        "coefficients": list(coefficients),
        "time": None,
        "recording": None,
    }
