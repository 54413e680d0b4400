"""V-optimality: least predicted torque variance along the user's task.

With the information I of all recordings, the torque that the identified model predicts along a task
has the covariance Γ_task I⁻¹ Γ_taskᵀ. A design for the task minimises tr(Γ_task I⁻¹ Γ_taskᵀ Σ⁻¹)
(V- or I-optimality; Atkinson, Donev and Tobias, Optimum Experimental Designs, 2007, chapter 10).
The information contains a weak prior: every direction of the parameters has a standard deviation
of 1 in the robot's metric, so that directions that no recording shows have a finite variance
(Bayesian V-optimality; Chaloner and Verdinelli, Statistical Science 10, 1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._linear_algebra import triangle
from .._types import FloatArray
from ..robot.base_parameters import Base
from ..robot.inertial_parameters import Parameters
from .criteria import Weighting, spectrum
from .design_objective import ObjectiveGradient, SampledMotion

KNOWN_SHARE = 0.01
"""Standard deviation of the torque along a task over the torque itself, from which it counts as
known [1]."""
WORTHWHILE_GAIN = 0.001
"""Decrease of that share below which a further run is not worth it [1]."""
PRIOR_STD = 1.0
"""Prior standard deviation of every direction of the parameters in the metric [1]: 100 %, ten times
what URDFs are usually off by."""
STOPPING_GAIN = 1e-3
"""Decrease of the logarithm of the variance over ten iterations below which the search ends [1].

With 4e-3, as for the other criteria, it ends 3 % higher (TX40)."""


def prior_information(parameters: Parameters) -> FloatArray:
    """Return the information of the weak prior in standard parameters, G₀/s². Shape (P, P).

    Args:
        parameters: Standard parameters with their metric G₀.
    """
    inverse_scale = np.linalg.inv(parameters.scale)
    return np.asarray(inverse_scale.T @ inverse_scale) / PRIOR_STD**2


@dataclass(frozen=True)
class TaskVariance:
    """Objective log tr(M S⁻¹): predicted torque variance along a task over the noise variance.

    Attributes:
        weighting: Coordinates of the information.
        moment: M, the mean over samples and joints of γᵀγ/σ², with γ the rows of the task's
            regressor in these coordinates. Shape (p, p).
        known_root: G, with GᵀG the prior's and earlier recordings' information per sample of the
            motion to be designed. Shape (m, p).
    """

    weighting: Weighting
    moment: FloatArray
    known_root: FloatArray
    stopping_gain: float = STOPPING_GAIN

    def evaluate(self, motion: SampledMotion) -> ObjectiveGradient:
        """Evaluate log tr(M S⁻¹) with S = AᵀA + GᵀG, and its gradient −S⁻¹MS⁻¹/tr(M S⁻¹) by S."""
        rows = self.weighting.rows(motion.regressor)
        values, vectors = spectrum(np.vstack([rows, self.known_root]))
        inverse = (vectors / values) @ vectors.T
        product = inverse @ self.moment
        variance = float(np.trace(product))
        slope = -(product @ inverse) / variance
        return ObjectiveGradient(
            float(np.log(variance)), self.weighting.regressor_gradient(motion.regressor, slope)
        )

    def statement(self, value: float) -> str:
        """Return a value of the objective in words.

        Args:
            value: The objective.
        """
        return (
            f"torque variance along the task over that of the noise: {np.exp(value):.6g} per "
            "sample of the periodic part"
        )


def task_moment(Y: FloatArray, weighting: Weighting) -> FloatArray:
    """Return M of `TaskVariance`.

    Args:
        Y: Regressor along the task. Shape (N, n, P).
        weighting: Coordinates of the information.

    Returns:
        Second moment of the task's rows. Shape (p, p).
    """
    rows = weighting.rows(Y)
    return np.asarray(rows.T @ rows) / Y.shape[1]


@dataclass(frozen=True)
class TorqueBand:
    """Predicted standard deviation of the torque along a task.

    Attributes:
        std: Standard deviation at each sample. Shape (N, n) [N m].
    """

    std: FloatArray

    @property
    def rms(self) -> FloatArray:
        """Root mean square over the task, per joint. Shape (n,) [N m]."""
        return np.asarray(np.sqrt(np.mean(self.std**2, axis=0)))

    @property
    def largest(self) -> FloatArray:
        """Largest value along the task, per joint. Shape (n,) [N m]."""
        return np.asarray(self.std.max(axis=0))


def torque_band(Y: FloatArray, base: Base, root: FloatArray) -> TorqueBand:
    """Predict the torque band along a task from the information of recordings and the weak prior.

    Args:
        Y: Regressor along the task. Shape (N, n, P).
        base: Base parameters of the robot.
        root: Root R of the information RᵀR of the recordings, in standard parameters. Shape (m, P),
            m ≥ 0.

    Returns:
        The band: σ²_tj = y_tj W (WᵀRᵀRW + 1/s²)⁻¹ Wᵀ y_tjᵀ, with W the geometric coordinates.
    """
    p = base.count
    known = np.vstack([root @ base.geometric, np.eye(p) / PRIOR_STD])
    rows = (Y @ base.geometric).reshape(-1, p)
    white = np.linalg.solve(triangle(known).T, rows.T)
    return TorqueBand(np.sqrt(np.sum(white**2, axis=0)).reshape(Y.shape[:2]))


@dataclass(frozen=True)
class TaskPrediction:
    """Predicted torque band along a task before and after a designed motion.

    Attributes:
        source: File of the task.
        joints: Names of the joints.
        torque: Nominal torque along the task. Shape (N, n) [N m].
        noise: Standard deviation of the torque noise. Shape (n,) [N m].
        before: Band with what was given only.
        after: Band with the designed motion, too.
        again: Band after one more recording of the designed motion.
    """

    source: str
    joints: tuple[str, ...]
    torque: FloatArray
    noise: FloatArray
    before: TorqueBand
    after: TorqueBand
    again: TorqueBand

    def relative(self, band: TorqueBand) -> float:
        """Return the band over the RMS torque of the task, each joint over its noise [1]."""
        scaled = self.torque / self.noise
        return float(np.linalg.norm(band.std / self.noise) / np.linalg.norm(scaled))

    @property
    def is_known(self) -> bool:
        """True if what is given suffices: the torque is known, and this motion gains too little."""
        return self._suffices(self.before, self.after)

    @property
    def is_last(self) -> bool:
        """True if this motion suffices: the torque is known after it, and a further run gains too
        little."""
        return self._suffices(self.after, self.again)

    def _suffices(self, present: TorqueBand, later: TorqueBand) -> bool:
        known = self.relative(present)
        return known <= KNOWN_SHARE and known - self.relative(later) <= WORTHWHILE_GAIN

    @property
    def advice(self) -> str:
        """Next step by the stopping rule."""
        rule = (
            f"rule: known to {100.0 * KNOWN_SHARE:g} %, and a further run would gain less than "
            f"{100.0 * WORTHWHILE_GAIN:g} %"
        )
        if self.is_known:
            return f"stop, what is given suffices ({rule})"
        if self.is_last:
            return f"record this motion, then stop ({rule})"
        return f"record this motion, then design again with --given RECORDING ({rule})"

    def summary(self) -> str:
        """Return two lines: how well the torque is known, what another run gains, what to do."""
        before, after, again = (
            100.0 * self.relative(band) for band in (self.before, self.after, self.again)
        )
        return (
            f"along {self.source}: torque known to {after:.2g} % after this motion "
            f"({before:.2g} % before); one more run would gain {after - again:.1g} %\n"
            f"next: {self.advice}"
        )

    def document(self) -> dict[str, object]:
        """Return the `task` entry of `excite design --json`."""
        torque = np.sqrt(np.mean(self.torque**2, axis=0))
        bands = {"before": self.before, "after": self.after, "after_one_more": self.again}
        return {
            "source": self.source,
            "relative_std": {name: self.relative(band) for name, band in bands.items()},
            "advice": self.advice,
            "joints": {
                joint: {
                    "torque_rms": float(torque[j]),
                    **{
                        name: {"rms": float(band.rms[j]), "max": float(band.largest[j])}
                        for name, band in bands.items()
                    },
                }
                for j, joint in enumerate(self.joints)
            },
        }
