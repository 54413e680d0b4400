"""Torque that is not what the drive says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from .effect import CandidateModel, Effect, alone, family, named, within
from .recorded_motion import STILL, RecordedMotion

Array = np.ndarray
FINE, FINEST, GRAINY = 0.01, 0.003, 3.0
"""Noise of measured torque over the torque, up to which powers of it are columns, and up to which what levels off is, whose column is
nearly the torque itself; and how many times the usual gain either takes."""
POWERS, BENDS, FULL, LITTLE = (2.0, 3.0, 5.0), (1.0, 2.0, 4.0), 1.1, 0.3
"""Of torque, that are lost; how sharply a drive levels off; its largest coefficient, 1 where nothing more is made beyond the level; and
what it may lose, at the most, of a usual torque."""


def _constant(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(t, s.joint_index, np.ones(len(t.segment)))


def _offset(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    for j in range(tracks[0].n):
        yield CandidateModel("torque_offset", j, _constant, parameters=named("offset"))


def _made(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(t, s.joint_index, t.motor_torque[:, s.joint_index])


def _gain(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """True over stated: the torque recorded is the true one over the gain."""
    for j in range(tracks[0].n):
        yield CandidateModel(
            "torque_gain",
            j,
            _made,
            parameters=lambda c: {"gain": 1.0 / (1.0 + float(c[0]))},
            plausible=within(-0.7, 2.0),
        )


def _bent(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(
        t,
        s.joint_index,
        _missing(s.values, (t.measured_torque if s.values.get("measured") else t.motor_torque)[:, s.joint_index]),
    )


def _missing(values: Mapping[str, float], x: Array) -> Array:
    """Torque that is lost of one, per unit of the coefficient: a power of it, or what levels off. Shape (M,)."""
    if "level" in values:
        bend = values["bend"]
        return np.asarray(x * (1.0 - (1.0 + np.abs(x / values["level"]) ** bend) ** (-1.0 / bend)))
    return np.asarray(x * (np.abs(x) / values["largest"]) ** (values["power"] - 1.0))


def _saturation(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Recorded τ stands for a current that made less: true = τ (1 − loss (τ/τ_max)²), or recorded ≈ true + loss true³/τ_max².

    The first is exact, of torque as it was measured: only where that has little noise, whose square its cube has in it. The second is of
    the base model's, which a strong loss has bent. A drive whose iron is full makes hardly more however much it draws, of what was measured
    τ/(1 + |τ/L|^p)^(1/p).
    """

    def of_motor(joint: int, largest: float) -> Iterator[CandidateModel]:
        for power in POWERS:
            told = lambda c: {"loss": float(c[0] / (1.0 + c[0]))}  # noqa: E731
            fixed = {"power": power, "largest": largest}
            yield CandidateModel(
                "torque_saturation",
                joint,
                _bent,
                fixed,
                parameters=told,
                plausible=within(0.0, 2.0),
            )

    def of_measured(joint: int) -> Iterator[CandidateModel]:
        both = zip(*((t.measured_torque, t.samples.dq) for t in tracks), strict=True)
        drawn, speed = (np.abs(np.concatenate([x[:, joint] for x in parts])) for parts in both)
        largest = max(float(drawn.max()), 1e-9)
        usual = max(
            float(np.median(drawn[speed >= STILL * speed.max()])), 1e-9
        )  # at rest a joint may bear nothing
        x = np.linspace(0.0, 1.1 * largest, 400)

        def law(most: float, grain: float, **values: float) -> CandidateModel:
            """With the loss at the largest torque seen; of a usual one it is little, or it is all of the torque that is taken for lost."""
            fixed = {"measured": 1.0, "largest": largest, **values}
            little, there = (
                _missing(fixed, np.array([usual, largest])) / [usual, largest]
            ).tolist()
            told, gate = (
                (lambda c: {"loss": there * float(c[0])}),
                within(0.0, min(most, LITTLE / max(little, 1e-9))),
            )
            slope = np.gradient(_missing(fixed, x), x)[np.searchsorted(x, usual)]
            shape = CandidateModel(
                "torque_saturation",
                joint,
                _bent,
                fixed,
                parameters=told,
                plausible=gate,
                threshold_factor=GRAINY,
                max_noise_ratio=grain,
            )
            return replace(shape, noisy=lambda c: abs(float(c[0]) * slope))

        for power in POWERS:
            yield law(1.0, FINE, power=power)
        for bend in BENDS:
            level = lambda at, bend=bend: law(FULL, FINEST, level=at, bend=bend)  # noqa: E731
            yield from family(np.geomspace(usual, largest, 6).tolist(), level)

    for j in range(tracks[0].n):
        yield from of_motor(j, max(*(float(np.abs(t.motor_torque[:, j]).max()) for t in tracks), 1e-9))
        yield from of_measured(j)


def _overdrawn(t: RecordedMotion, s: CandidateModel, c: Array, made: Array) -> Array:
    """What a drive that loses torque is recorded with beyond what it makes. Shape (M, n)."""
    out = np.zeros_like(made)
    out[:, s.joint_index] = overdrawn(float(c[0]), s.values, made[:, s.joint_index]) - made[:, s.joint_index]
    return out


def overdrawn(loss: float, values: Mapping[str, float], torque: Array) -> Array:
    """What is recorded where a drive that loses as `_missing` says makes a torque: x of x − c missing(x) = τ. Shape (M,)."""
    x = np.linspace(0.0, 2.0 * values["largest"], 4001)
    made = x - loss * _missing(values, x)
    rising = slice(0, int(np.argmax(made)) + 1)  # a drive makes no more than that
    size = np.abs(torque)
    return np.asarray(np.sign(torque) * np.maximum(size, np.interp(size, made[rising], x[rising])))


EFFECTS = (
    Effect(
        "torque_offset",
        "τ₀",
        _constant,
        _offset,
        {"offset": "N m"},
        "constant, whatever the motion",
        ("payload",),
        "hold a pose, reached from both sides",
        prior_only=True,
        form={"offset": 0.04},
    ),
    Effect(
        "torque_gain",
        "τ = (1 + ε) k_t i",
        _made,
        _gain,
        {"gain": "1"},
        "every term of one joint scaled",
        ("payload", "torque_saturation"),
        "two known loads",
        prior_only=True,
        form={"gain": 0.035},
    ),
    Effect(
        "torque_saturation",
        "k_t (1 − β i²); or τ/(1 + |τ/L|^p)^(1/p), which levels off (Fröhlich 1881 for p = 1)",
        _bent,
        _saturation,
        {"loss": "1"},
        "torque is missing at high current only",
        ("load_friction", "nonlinear_viscous"),
        "short bursts near the torque limit",
        recorded=_overdrawn,
        residual_log_offset=-0.2,
    ),
)
