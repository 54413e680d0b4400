"""Base types of the catalogue: an effect, and the candidate models by which it is fitted."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .._types import FloatArray
from .recorded_motion import FittedRobot, RecordedMotion

HARMONIC_KEYS = {2: "twice", 3: "thrice"}
"""Multiples of a spatial frequency that a candidate may fit jointly, by their key in its values."""
MAX_VARIANT_STEPS = 4
"""Largest number of moves from a model variant to a better neighbouring one."""
Key = tuple[str, int | None]
"""Name of an effect and index of its joint; None for an effect of no single joint."""


@dataclass(frozen=True)
class CandidateModel:
    """One form of an effect at one joint: a torque that is linear in its coefficients.

    Nonlinear parameters are fixed in `values`; `nonlinear` and `variants` say how they may be
    optimised.

    Attributes:
        effect: Name of the effect in the catalogue.
        joint: Index of the joint that carries the effect; None for an effect of no single joint.
        torque_columns: Function that returns the torque per unit of each coefficient. It depends
            on nothing but the recorded motion and this model.
        values: Fixed nonlinear parameters by name.
        other: Index of a second joint that the effect depends on.
        interval: Start and end of an effect that acts for some of the time [s].
        source: Recording in which `interval` lies.
        parameters: Converts coefficients, shape (k,), to the reported parameters by name.
        parameters_on_base: The same of parameters that depend on the base model to which the effect
            is added; None where `parameters` says it all.
        is_plausible: Tells whether coefficients, shape (k,), are physically possible: sign, range,
            dissipation.
        nonlinear: The nonlinear parameter to optimise; None if there is none.
        variants: Returns nonlinear parameters of neighbouring models that no grid contains.
        nonnegative: Coefficients whose sign physics fixes to be ≥ 0; empty: none.
        prior_std: Prior standard deviation of the coefficients; None: the friction level of the
            joint.
        prior_shares: Share of `prior_std` of each coefficient; empty: 1.
        form_columns: Number of last columns that are the discrepancy of its form.
        exact: The model without this discrepancy; None of a model that has none.
        signature: Description of the residual, if it differs from the effect's.
        alternatives: Number of models, each as likely, of which it was chosen before it became a
            candidate.
    """

    effect: str
    joint: int | None
    torque_columns: TorqueColumns
    values: Mapping[str, float] = field(default_factory=dict)
    other: int | None = None
    interval: tuple[float, float] | None = None
    source: str = ""
    parameters: Callable[[FloatArray], dict[str, float]] = lambda c: {}
    parameters_on_base: Callable[[FloatArray, FittedRobot], dict[str, float]] | None = None
    is_plausible: Callable[[FloatArray], bool] = lambda c: bool(np.isfinite(c).all())
    nonlinear: NonlinearParameter | None = None
    variants: Callable[[], Sequence[NonlinearParameter]] = tuple
    nonnegative: tuple[bool, ...] = ()
    prior_std: float | None = None
    prior_shares: tuple[float, ...] = ()
    form_columns: int = 0
    exact: CandidateModel | None = None
    signature: str = ""
    alternatives: float = 1.0

    def columns(self, motion: RecordedMotion) -> FloatArray:
        """Return the torque per unit of each coefficient at the motion's rows.

        Returns:
            Torque columns [N m], shape (N, n, k).
        """
        return self.torque_columns(motion, self)

    def plain(self, c: FloatArray) -> FloatArray:
        """Return coefficients without those of the discrepancy of its form.

        Args:
            c: Coefficients, shape (k,).
        """
        return c[: len(c) - self.form_columns]

    def reported(self, c: FloatArray, base: FittedRobot) -> dict[str, float]:
        """Return the reported parameters by name.

        Args:
            c: Coefficients without those of the discrepancy of its form, shape (k,).
            base: The base model to which the effect is added.
        """
        if self.parameters_on_base is None:
            return self.parameters(c)
        return self.parameters_on_base(c, base)

    @property
    def key(self) -> Key:
        """Effect and joint."""
        return self.effect, self.joint

    @property
    def form(self) -> Hashable:
        """All that tells its torque from that of other models, but for functions."""
        values = tuple(sorted(self.values.items()))
        return self.key, self.other, self.interval, self.source, self.signature, values

    @property
    def joint_index(self) -> int:
        """Index of the joint, of a model that has one."""
        assert self.joint is not None
        return self.joint


TorqueColumns = Callable[[RecordedMotion, CandidateModel], FloatArray]
"""Torque per unit of each coefficient, shape (N, n, k)."""
PredictedTorque = Callable[[RecordedMotion, CandidateModel, FloatArray, FloatArray], FloatArray]
"""Torque of an effect of measured torque where none is measured: by coefficients, shape (k,), and
the torque that the actuators produce, shape (M, n); returns shape (M, n)."""


@dataclass(frozen=True)
class NonlinearParameter:
    """A nonlinear parameter of a candidate model, between its neighbours on a grid.

    Attributes:
        value: Present value.
        low: Lower bound.
        high: Upper bound.
        model: Returns the candidate model at a value.
    """

    value: float
    low: float
    high: float
    model: Callable[[float], CandidateModel]

    def optimised(self, gain: Callable[[CandidateModel], float]) -> CandidateModel:
        """Return the model with the highest gain between the bounds, or a better model variant.

        Args:
            gain: Log-likelihood gain of a model.
        """
        best, best_gain = self.maximise(gain, gain(self.current))
        for _ in range(MAX_VARIANT_STEPS):
            gains = [(gain(variant.current), variant) for variant in best.variants()]
            if not gains:
                break
            start, variant = max(gains, key=lambda pair: pair[0])
            better, better_gain = variant.maximise(gain, start)
            if better_gain <= best_gain + 1e-6:
                break
            best, best_gain = better, better_gain
        return best

    @property
    def current(self) -> CandidateModel:
        """The model at the present value."""
        return self.at(self.value)

    def maximise(
        self, gain: Callable[[CandidateModel], float], current_gain: float
    ) -> tuple[CandidateModel, float]:
        """Maximise the gain over this parameter alone.

        The search is bounded and runs over the logarithm, to 0.4 % of its range.

        Returns:
            The best model and its gain; the present model and `current_gain` if none is better.
        """
        from scipy.optimize import minimize_scalar  # slow to import

        low, high = np.log(self.low), np.log(self.high)
        solution = minimize_scalar(
            lambda x: -max(gain(self.at(float(np.exp(x)))), -1e12),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 4e-3 * (high - low), "maxiter": 12},
        )
        best, best_gain = self.at(float(np.exp(solution.x))), -float(solution.fun)
        if best_gain > max(current_gain + 1e-6, -1e12):
            return best, best_gain
        return self.current, current_gain

    def at(self, value: float) -> CandidateModel:
        """Return the model at a value; the value may be optimised further in the same range."""
        here = self if value == self.value else replace(self, value=value)
        return replace(self.model(value), nonlinear=here)


def variants_within(
    value: float, factor: float, families: Iterable[Callable[[float], CandidateModel]]
) -> list[NonlinearParameter]:
    """Return the parameter of each model family at one value, free within a factor of it."""
    return [
        NonlinearParameter(value, value / factor, value * factor, family) for family in families
    ]


def grid_candidates(
    grid: Sequence[float], family: Callable[[float], CandidateModel]
) -> Iterator[CandidateModel]:
    """Yield a model at each value of a rising grid, free between the neighbouring values."""
    for i, value in enumerate(grid):
        low = grid[i - 1] if i else value**2 / grid[1]
        high = grid[i + 1] if i + 1 < len(grid) else value**2 / grid[-2]
        yield NonlinearParameter(value, low, high, family).at(value)


def harmonic_columns(values: Mapping[str, float], angle: FloatArray) -> FloatArray:
    """Return cosine and sine of a model's spatial frequency and its multiples.

    Args:
        values: Values of the model: "order" is the spatial frequency [1/rad].
        angle: Joint angle [rad], shape (M,).

    Returns:
        Columns of shape (M, k).
    """
    numbers = [1, *(k for k, key in HARMONIC_KEYS.items() if key in values)]
    return np.array([f(k * values["order"] * angle) for k in numbers for f in (np.cos, np.sin)]).T


@dataclass(frozen=True)
class Effect:
    """An entry of the catalogue: physics that the base model leaves out.

    Attributes:
        name: Name in `diagnosis.json`.
        equation: Equation and its source.
        torque_columns: Torque per unit of each coefficient of a candidate model.
        candidates: Yields all candidate models for a robot with these recorded motions;
            `no_candidates` for an effect that is part of the joint model or sought in its residual.
        units: Units of the reported parameters.
        signature: Description of the residual that the effect causes.
        experiment: Experiment that shows it apart from others.
        prior_only: Whether a refit of the base model absorbs the effect, so that it can be found
            only with a trusted prior.
        form_std: Relative standard deviation of the parameters where the robot's effect has not
            exactly the form of the model.
        predicted_torque: Torque of candidate models of measured torque where none is measured.
        of_link: Whether it acts on the link of its joint, so that all joints before it show it, and
            its place is less certain than its name.
    """

    name: str
    equation: str
    torque_columns: TorqueColumns
    candidates: Callable[[Sequence[RecordedMotion]], Iterator[CandidateModel]]
    units: Mapping[str, str]
    signature: str
    experiment: str
    prior_only: bool = False
    form_std: Mapping[str, float] = field(default_factory=dict)
    predicted_torque: PredictedTorque | None = None
    of_link: bool = False


def no_candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Yield nothing: the joint model of a diagnosis has the effect, or its residual shows it."""
    return iter(())


def one_per_joint(
    name: str, torque_columns: TorqueColumns, **attributes: Any
) -> Callable[[Sequence[RecordedMotion]], Iterator[CandidateModel]]:
    """Return a function that yields a model of an effect at every joint.

    Args:
        name: Name of the effect.
        torque_columns: Its columns.
        **attributes: Further attributes of `CandidateModel`.
    """
    return lambda motions: (
        CandidateModel(name, j, torque_columns, **attributes) for j in range(motions[0].n)
    )


def single_joint_columns(motion: RecordedMotion, joint: int, x: FloatArray) -> FloatArray:
    """Return low-passed columns that act on one joint only.

    Args:
        motion: The recorded motion.
        joint: Index of the joint.
        x: Torque at every sample, shape (M,) or (M, k).

    Returns:
        Columns of shape (N, n, k).
    """
    return single_joint_rows(motion, joint, motion.lowpass(x[:, None] if x.ndim == 1 else x))


def single_joint_rows(motion: RecordedMotion, joint: int, low: FloatArray) -> FloatArray:
    """Return columns that act on one joint only.

    Args:
        motion: The recorded motion.
        joint: Index of the joint.
        low: Low-passed columns of the joint, shape (N, k).

    Returns:
        Columns of shape (N, n, k), in whose memory the rows of each joint are adjacent.
    """
    out = np.zeros((motion.n, *low.shape))
    out[joint] = low
    return out.swapaxes(0, 1)


def named_coefficients(*names: str, **fixed: float) -> Callable[[FloatArray], dict[str, float]]:
    """Return a conversion of coefficients to parameters of these names, and of fixed values."""
    return lambda c: {name: float(value) for name, value in zip(names, c, strict=False)} | fixed


def pair_amplitude(**fixed: float) -> Callable[[FloatArray], dict[str, float]]:
    """Return a conversion of a cosine and sine pair to its amplitude, and of fixed values."""
    return lambda c: {"amplitude": float(np.hypot(c[0], c[1]))} | fixed


def is_between(low: float, high: float) -> Callable[[FloatArray], bool]:
    """Return a check that the first coefficient lies between two bounds."""
    return lambda c: bool(low < c[0] < high)


def is_positive(c: FloatArray) -> bool:
    """Return True if every coefficient is above zero."""
    return bool((c > 0.0).all())
