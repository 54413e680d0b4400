"""Design a validation trajectory that optimises the same criterion in other parts of state space.

A model is validated by torque that it was not fitted to. Another run of the same motion repeats
errors that the fit has absorbed in part; a motion that excites the same parameters elsewhere does
not (tests/test_validation_trajectory.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import FloatArray
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

VALIDATION_FOLDER = "validation"
"""Folder of the second trajectory, inside that of the first one."""

CORRELATION_SAMPLES = 400
"""Samples of one period for the correlation of torques [1]."""


@dataclass(frozen=True)
class MotionSimilarity:
    """Similarity of two motions.

    Attributes:
        overlap: Overlap ρ of their joint states, between 0 and 1.
        torque: Largest correlation of each joint's nominal torque over all phase shifts.
            Shape (n,).
    """

    overlap: float
    torque: FloatArray


@dataclass(frozen=True)
class ValidationDesign:
    """Second, different motion for the validation of an identified model.

    Attributes:
        delivery: The second motion.
        similarity: Its similarity to the first motion.
        other_starts: Mean similarity of the other starts of the first design to its best one; None
            where there was only one start.
        values: Criterion per sample of the first and of the second motion.
    """

    delivery: CertifiedDesign
    similarity: MotionSimilarity
    other_starts: MotionSimilarity | None
    values: tuple[float, float]

    def design_entry(self) -> dict[str, Any]:
        """Return the entry `validation` in the `design` of both trajectory files."""
        joints = self.delivery.trajectory.joints

        def entries(similarity: MotionSimilarity) -> dict[str, Any]:
            correlations = dict(zip(joints, similarity.torque.tolist(), strict=True))
            return {"overlap": similarity.overlap, "torque_correlation": correlations}

        return {
            **entries(self.similarity),
            "independent": None if self.other_starts is None else entries(self.other_starts),
            "criterion": {"first": self.values[0], "second": self.values[1]},
            "weight": OVERLAP_WEIGHT,
            "width": KERNEL_WIDTH,
        }

    def document(self) -> dict[str, Any]:
        """Return the entry of `excite design --json`."""
        trajectory = self.delivery.trajectory
        return {
            "ok": self.delivery.certificate.ok,
            **self.design_entry(),
            "criteria": dict(trajectory.criteria),
            "margins": trajectory.margins,
            "duration": trajectory.motion.duration,
            "timing": self.delivery.timing,
        }

    def summary(self) -> str:
        """Return a line of text about the second motion."""
        reference = (
            ""
            if self.other_starts is None
            else f" (another start: {self.other_starts.overlap:.2f})"
        )
        certificate = self.delivery.certificate
        first, second = self.values
        return (
            f"validation: overlap {self.similarity.overlap:.2f}{reference}, "
            f"criterion {second:.6g} (first motion: {first:.6g}); "
            f"{self.delivery.trajectory.motion.duration:.2f} s; "
            f"clearance {certificate.clearance.value}, limits {certificate.limits.value}"
        )

    def annotate(self, first: Trajectory) -> Trajectory:
        """Return a trajectory with the entry about this validation motion."""
        return dataclasses.replace(
            first, design={**first.design, "validation": self.design_entry()}
        )

    @property
    def trajectory(self) -> Trajectory:
        """Content of the trajectory file of the second motion."""
        annotated = self.annotate(self.delivery.trajectory)
        return dataclasses.replace(
            annotated, design={**annotated.design, "validates": "../trajectory.json"}
        )


def design_validation(
    first: CertifiedDesign, robot: Robot, run: Callable[[OverlapPenalty], CertifiedDesign]
) -> ValidationDesign:
    """Design a validation motion with little overlap with a first motion.

    Args:
        first: The first motion.
        robot: The robot.
        run: Design of the same problem with a given overlap penalty; its errors are passed on.
    """
    limits, standard = first.trajectory.limits, first.design.setup.problem.parameters
    motion, scaling = first.design.motion, StateScaling.for_robot(robot, limits)
    delivery = run(penalise_overlap(scaling, motion))

    def similarity(other: FourierSeries) -> MotionSimilarity:
        return MotionSimilarity(
            compute_overlap(scaling, motion, other),
            torque_correlation(robot, standard, motion, other),
        )

    others = [similarity(a.motion) for a in first.design.attempts[1:] if not a.stopped]
    mean = (
        MotionSimilarity(
            float(np.mean([o.overlap for o in others])), np.mean([o.torque for o in others], axis=0)
        )
        if others
        else None
    )
    return ValidationDesign(
        delivery,
        similarity(delivery.design.motion),
        mean,
        (_criterion_of(first.trajectory), _criterion_of(delivery.trajectory)),
    )


def torque_correlation(
    robot: Robot, standard: Parameters, first: FourierSeries, other: FourierSeries
) -> FloatArray:
    """Correlate the nominal torques of two motions.

    Args:
        robot: The robot.
        standard: Its standard parameters.
        first: First motion.
        other: Second motion.

    Returns:
        Largest absolute correlation over all phase shifts, 0 for a constant torque. Shape (n,).
    """
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


def _criterion_of(trajectory: Trajectory) -> float:
    """Return the criterion per sample of the periodic part."""
    design = trajectory.design
    return criteria.select_criterion(
        trajectory.criteria["optimum"], Criterion(design["criterion"]), plain=bool(design["plain"])
    )
