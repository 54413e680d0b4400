"""Interface of objectives that replace the optimality criterion of a design problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from .._types import FloatArray


@dataclass(frozen=True)
class SampledMotion:
    """One period of a periodic motion at the optimiser's N samples.

    Attributes:
        q: Positions. Shape (N, n) [rad or m].
        dq: Velocities. Shape (N, n) [rad/s or m/s].
        ddq: Accelerations. Shape (N, n) [rad/s² or m/s²].
        regressor: Regressor Y. Shape (N, n, P).
        period: Period [s].
    """

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    regressor: FloatArray
    period: float


@dataclass(frozen=True)
class ObjectiveGradient:
    """Value of an objective, to be minimised, and its gradient.

    Attributes:
        value: The objective; a logarithm, so that its change is a relative one.
        by_regressor: Gradient with respect to the regressor. Shape (N, n, P).
        by_motion: Gradients with respect to q, q̇ and q̈, other than through the regressor; None
            where there are none. Shapes (N, n).
    """

    value: float
    by_regressor: FloatArray
    by_motion: tuple[FloatArray, FloatArray, FloatArray] | None = None


class DesignObjective(Protocol):
    """An objective of a periodic motion with an exact gradient; picklable."""

    @property
    def stopping_gain(self) -> float:
        """Decrease over ten iterations below which a search ends."""
        ...

    def evaluate(self, motion: SampledMotion) -> ObjectiveGradient:
        """Evaluate the objective and its gradient.

        Args:
            motion: The motion.
        """
        ...

    def statement(self, value: float) -> str:
        """Return a value of the objective in words.

        Args:
            value: The objective.
        """
        ...
