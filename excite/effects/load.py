"""Bodies, drives and geometry that differ from the model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from ..identification.lowpass import Grid
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import pseudo_inertia
from .effect import CandidateModel, Effect, alone, named
from .recorded_motion import RecordedMotion

Array = np.ndarray
FAR = 1.5
"""Distance of a payload's centre from its link's frame, at the most [m]."""
ANGLE, LENGTH = 1e-4, 1e-5
"""Changes of geometry that a column is the secant of [rad, m]."""
STEEP, SHORTER, UNFELT = 0.7, 0.1, 0.08
"""Sine of the largest turn; of a turn's sine, how much of gravity may go amiss besides; what an unfelt turn of 0.4 rad takes."""
ROUNDED = 1e-6
"""Of the largest column, one that is rounding: a turn about the joint's own upright axis."""


def _carried(t: RecordedMotion, s: CandidateModel) -> Array:
    """Columns of a link's first inertial parameters."""
    place, count = int(s.values["link"]), int(s.values["count"])
    Y = regressor(t.fitted_robot.robot, t.fitted_robot.parameters, t.coarse_samples)[:, :, 10 * place : 10 * place + count]
    return t.lowpass(Y, Grid.COARSE)


def _a_body(c: Array) -> bool:
    """Whether coefficients are a body's: mass positive, its centre within arm's reach, its inertia one that a body can have."""
    if c[0] <= 0.0 or np.linalg.norm(c[1:4]) > FAR * c[0]:
        return False
    if len(c) == 4:
        return True
    values = np.linalg.eigvalsh(pseudo_inertia(c))
    return bool(values[0] > -0.05 * values[-1])


def _payload(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    def parameters(c: Array) -> dict[str, float]:
        centre = c[1:4] / c[0] if abs(c[0]) > 1e-9 else np.full(3, np.nan)
        return {
            "mass": float(c[0]),
            "com_x": float(centre[0]),
            "com_y": float(centre[1]),
            "com_z": float(centre[2]),
        }

    links = len(tracks[0].fitted_robot.parameters.links)
    for place in range(links):
        for count in (4, 10):
            fixed = {"link": float(place), "count": float(count)}
            yield CandidateModel(
                "payload",
                min(place, tracks[0].n - 1),
                _carried,
                fixed,
                parameters=parameters,
                plausible=_a_body,
            )


def _leaning(t: RecordedMotion, s: CandidateModel) -> Array:
    """Torque of gravity turned about x and y, per radian; and of what a turn that is not small takes from its old direction."""
    columns = [t.leaning[:, :, :2]]
    if s.values.get("large"):
        columns.append(-(t.gravity @ t.fitted_robot.model.gravity.linear)[:, :, None])
    return t.lowpass(np.concatenate(columns, axis=2), Grid.COARSE)


def _turned(c: Array) -> dict[str, float]:
    """Roll and pitch, URDF's angles, of a base that sees gravity changed by c: twice across, and along."""
    if len(c) == 2:
        return {"roll": float(c[0]), "pitch": float(c[1])}
    return {
        "roll": float(np.arctan2(c[0], 1.0 + c[2])),
        "pitch": float(np.arctan2(c[1], np.hypot(c[0], 1.0 + c[2]))),
    }


def _leans(c: Array) -> bool:
    """Whether gravity is turned, and not longer than it is; shorter it may seem to an arm that does not feel all that it is turned by."""
    across = float(np.hypot(c[0], c[1]))
    if len(c) == 2 or across > STEEP:
        return across < STEEP
    longer = float(c[2] - np.sqrt(1.0 - across**2) + 1.0)
    return -UNFELT - SHORTER * across < longer < SHORTER * across


def _tilt(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    upright = not np.any(tracks[0].fitted_robot.model.gravity.linear[:2])  # else x and y are not across
    for large in (0.0, 1.0) if upright else (0.0,):
        yield CandidateModel(
            "gravity_tilt", None, _leaning, {"large": large}, parameters=_turned, plausible=_leans
        )


def _spun(t: RecordedMotion, s: CandidateModel) -> Array:
    return alone(t, s.joint_index, t.samples.ddq[:, s.joint_index])


def _rotor(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    for j in range(tracks[0].n):
        yield CandidateModel("rotor_inertia", j, _spun, parameters=named("inertia"))


def _misplaced(t: RecordedMotion, s: CandidateModel) -> Array:
    """Torque by turning or moving what comes after a joint's link, in the joint's frame, and `whole`: that link's own body too."""
    robot, columns, m, angle, joint = t.fitted_robot.robot, [], t.coarse_samples, s.values["angle"] > 0.0, s.joint_index
    Q, V, A = robot.expand(m.q), m.dq @ robot.spread.T, m.ddq @ robot.spread.T
    after = [i for i in range(1, t.fitted_robot.model.njoints) if t.fitted_robot.model.parents[i] == joint + 1]
    for axis in range(3):
        model = t.fitted_robot.model.copy()
        twist = np.zeros(6)
        twist[(3 if angle else 0) + axis] = ANGLE if angle else LENGTH
        change = pin.exp6(twist)
        for i in after:
            model.jointPlacements[i] = change * model.jointPlacements[i]
        if s.values["whole"]:
            model.inertias[joint + 1] = change.act(model.inertias[joint + 1])
        data = model.createData()
        torque = (
            np.array([pin.rnea(model, data, *state) for state in zip(Q, V, A, strict=True)])
            @ robot.spread
        )
        columns.append((torque - t.rigid_torque) / (ANGLE if angle else LENGTH))
    out = np.stack(columns, axis=2)
    seen = np.abs(out).max(axis=(0, 1))
    return t.lowpass(out * (seen > ROUNDED * seen.max()), Grid.COARSE)


def _kinematic(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    def small(c: Array) -> bool:
        return bool(np.linalg.norm(c) < 0.2)

    for j in range(min(tracks[0].n, tracks[0].fitted_robot.model.njoints - 1)):
        for angle, name in ((1.0, "angle"), (0.0, "length")):
            told = lambda c, name=name: {name: float(np.linalg.norm(c))}  # noqa: E731
            for body in (0.0, 1.0):
                fixed = {"angle": angle, "whole": body}
                yield CandidateModel(
                    "kinematic_error",
                    j,
                    _misplaced,
                    fixed,
                    parameters=told,
                    plausible=small,
                    allows_several=True,
                )


def _both(parts: Sequence[tuple[CandidateModel, Array]]) -> dict[str, float]:
    """Angle and length of a joint where both are wrong; of one that is found in two shapes, the larger."""
    return {
        name: value for shape, c in reversed(parts) for name, value in shape.parameters(c).items()
    }


EFFECTS = (
    Effect(
        "payload",
        "Y_L δφ_L: a link's ten parameters",
        _carried,
        _payload,
        {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m"},
        "many joints, in a ratio that the kinematics fix",
        ("torque_gain", "gravity_tilt"),
        "static poses and fast ones, with and without the load",
        prior_only=True,
        form={"mass": 0.04, "com_x": 0.04, "com_y": 0.04, "com_z": 0.04},
    ),
    Effect(
        "gravity_tilt",
        "∂τ/∂g (Rᵀ − 1) g, R = roll and pitch of the base",
        _leaning,
        _tilt,
        {"roll": "rad", "pitch": "rad"},
        "joint 1 of an upright arm feels gravity",
        ("spring",),
        "joint 1 a full turn, arm stretched",
        prior_only=True,
        form={"roll": 0.05, "pitch": 0.05},
    ),
    Effect(
        "rotor_inertia",
        "I_a q̈",
        _spun,
        _rotor,
        {"inertia": "kg m²"},
        "like the joint's own acceleration, at any pose",
        ("payload",),
        "small fast motion at several poses",
        prior_only=True,
        form={"inertia": 0.04},
    ),
    Effect(
        "kinematic_error",
        "Σ δ_k ∂τ/∂(placement)_k",
        _misplaced,
        _kinematic,
        {"angle": "rad", "length": "m"},
        "small cross terms of gravity and inertia",
        ("payload",),
        "poses, and an external measurement of them",
        prior_only=True,
        told=_both,
    ),
)
