"""A second motion, to hold an identified model against: the same criterion, over ground that the first does not cover.

A model is judged by torque that it was not fitted to. Another run of the same motion repeats the same errors, which the
fit has half swallowed; a motion that asks for the same parameters elsewhere does not (tests/test_validation.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..robot import dynamics
from ..robot.inertial_parameters import Parameters
from ..robot.robot import Robot
from ..trajectory.fourier import FourierSeries
from ..trajectory.trajectory_file import Trajectory
from . import criteria
from .criteria import Criterion
from .motion_overlap import (
    KERNEL_WIDTH,
    OVERLAP_WEIGHT,
    OverlapPenalty,
    StateScaling,
    compute_overlap,
    penalise_overlap,
)
from .pipeline import CertifiedDesign

Array = np.ndarray
VALIDATION_FOLDER = "validation"
CORRELATION_SAMPLES = 400
"""Samples of a period over which torques are correlated."""


@dataclass(frozen=True)
class MotionSimilarity:
    """How alike two motions are: ρ of `overlap`, and per joint the largest correlation of nominal torque. Shape (n,)."""

    overlap: float
    torque: Array


@dataclass(frozen=True)
class ValidationDesign:
    """The second motion, how like the first it is, and how like the first its design's other starts came out, on average.

    independent: None where there was no other start. values: the criterion per sample of both.
    """

    delivery: CertifiedDesign
    similarity: MotionSimilarity
    other_starts: MotionSimilarity | None
    values: tuple[float, float]

    def facts(self) -> dict[str, Any]:
        """What both trajectory files' `design` says of the pair."""
        joints = self.delivery.trajectory.joints

        def words(one: MotionSimilarity) -> dict[str, Any]:
            return {
                "overlap": one.overlap,
                "torque_correlation": dict(zip(joints, one.torque.tolist(), strict=True)),
            }

        independent = None if self.other_starts is None else words(self.other_starts)
        values = {"first": self.values[0], "second": self.values[1]}
        return {
            **words(self.similarity),
            "independent": independent,
            "criterion": values,
            "weight": OVERLAP_WEIGHT,
            "width": KERNEL_WIDTH,
        }

    def document(self) -> dict[str, Any]:
        """As `excite design --json` states it."""
        own = self.delivery.trajectory
        more = {
            "criteria": dict(own.criteria),
            "margins": own.margins,
            "duration": own.motion.duration,
            "timing": self.delivery.timing,
        }
        return {"ok": self.delivery.certificate.ok, **self.facts(), **more}

    def words(self) -> str:
        """The same in a line."""
        usual = (
            ""
            if self.other_starts is None
            else f" (another start: {self.other_starts.overlap:.2f})"
        )
        certificate = self.delivery.certificate
        state = f"clearance {certificate.clearance.value}, limits {certificate.limits.value}"
        first, second = self.values
        text = f"validation: overlap {self.similarity.overlap:.2f}{usual}, criterion {second:.6g} beside {first:.6g}"
        return f"{text}; {self.delivery.trajectory.motion.duration:.2f} s; {state}"

    def annotate(self, first: Trajectory) -> Trajectory:
        """The first motion's file, with what there is to say of the second."""
        return dataclasses.replace(first, design={**first.design, "validation": self.facts()})

    @property
    def trajectory(self) -> Trajectory:
        """The second motion's file, which says what it is."""
        own = self.annotate(self.delivery.trajectory)
        return dataclasses.replace(own, design={**own.design, "validates": "../trajectory.json"})


def design_validation(
    first: CertifiedDesign, robot: Robot, run: Callable[[OverlapPenalty], CertifiedDesign]
) -> ValidationDesign:
    """Design a motion apart from the first. run: `workflow.run` for the same problem with that `apart`; raises what it raises."""
    limits, standard = first.trajectory.limits, first.design.setup.problem.parameters
    motion, gauge = first.design.motion, StateScaling.of(robot, limits)
    delivery = run(penalise_overlap(gauge, motion))

    def alike(other: FourierSeries) -> MotionSimilarity:
        return MotionSimilarity(
            compute_overlap(gauge, motion, other),
            torque_correlation(robot, standard, motion, other),
        )

    others = [alike(a.motion) for a in first.design.attempts[1:] if not a.stopped]
    mean = (
        MotionSimilarity(
            float(np.mean([o.overlap for o in others])), np.mean([o.torque for o in others], axis=0)
        )
        if others
        else None
    )
    return ValidationDesign(
        delivery,
        alike(delivery.design.motion),
        mean,
        (_value(first.trajectory), _value(delivery.trajectory)),
    )


def torque_correlation(
    robot: Robot, standard: Parameters, first: FourierSeries, other: FourierSeries
) -> Array:
    """Per joint the largest |correlation| of the nominal torques over all shifts by a phase; 0 for a constant torque. Shape (n,)."""
    spectra = []
    for motion in (first, other):
        torque = (
            dynamics.regressor(robot, standard, motion.samples(motion.grid(CORRELATION_SAMPLES)))
            @ standard.nominal
        )
        torque -= torque.mean(axis=0)
        spectra.append(
            np.fft.rfft(torque / np.maximum(np.linalg.norm(torque, axis=0), 1e-300), axis=0)
        )
    shifted = np.fft.irfft(spectra[0].conj() * spectra[1], n=CORRELATION_SAMPLES, axis=0)
    return np.asarray(np.abs(shifted).max(axis=0))


def _value(trajectory: Trajectory) -> float:
    """The criterion per sample of the periodic part."""
    design = trajectory.design
    return criteria.select_criterion(
        trajectory.criteria["optimum"], Criterion(design["criterion"]), plain=bool(design["plain"])
    )
