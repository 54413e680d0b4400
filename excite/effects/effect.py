"""Base types of the catalogue: an effect, and the candidate models by which it is fitted."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .._types import BoolArray, FloatArray
from .recorded_motion import FittedRobot, Motions, RecordedMotion

MAX_VARIANT_STEPS = 4
"""Largest number of moves from a model variant to a better neighbouring one."""
Values = dict[str, float]
"""Quantities by their names."""
Key = tuple[str, int | None]
"""Name of an effect and index of its joint; None for an effect of no single joint."""


@dataclass(frozen=True, eq=False)
class Effect:
    """An entry of the catalogue: physics that the base model leaves out.

    Derived classes state its torque, candidate models and constraints.

    Attributes:
        equation: Equation and its source.
        regime: Quantity over which the effect shows.
        nonnegative: Coefficients whose sign physics fixes to be ≥ 0; empty: none.
        has_candidates: False for an effect that the joint model has at every joint, see
            `dense_model`, or that is sought in its residual.
        max_models: Largest number of its models at one joint, where several describe it: modes of
            a base, waves of a curve.
        prior_only: Whether a refit of the base model absorbs the effect, if it acts all the time,
            so that it can be found only with a trusted prior.
        form_std: Relative standard deviation of the parameters where the robot's effect has not
            exactly the form of the model.
        bounds: Physically possible coefficients, both ends included.
        of_link: Whether it acts on the link of its joint, so that all joints before it show it, and
            its place is less certain than its name.
    """

    name: str
    equation: str
    units: Mapping[str, str]
    signature: str
    experiment: str
    regime: str = "all"
    nonnegative: tuple[bool, ...] = ()
    has_candidates: bool = True
    max_models: int = 1
    prior_only: bool = False
    form_std: Mapping[str, float] = field(default_factory=dict)
    of_link: bool = False
    bounds: tuple[float, float] = (-np.inf, np.inf)

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        """Return the torque per unit of each coefficient at the motion's rows [N m], (N, n, k).

        It depends on nothing but the recorded motion, and the joints, values, interval and source
        of the model.
        """
        raise NotImplementedError

    def candidates(self, motions: Motions) -> Iterator[CandidateModel]:
        """Yield all candidate models for a robot with recorded motions: those of every joint."""
        for joint in range(motions[0].n if self.has_candidates else 0):
            yield from self.joint_candidates(motions, joint)

    def joint_candidates(self, motions: Motions, joint: int) -> Iterator[CandidateModel]:
        """Yield the candidate models of one joint."""
        yield CandidateModel(self, joint)

    def dense_model(self, motions: Motions, joint: int) -> CandidateModel:
        """Return the model of a joint, linear in its coefficients, of a friction of every joint."""
        raise NotImplementedError

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        """Return the reported parameters by name: the coefficients, in the order of the units.

        Of waves, these are the order, and the amplitude of the first cosine and sine. `c` has no
        coefficients of the discrepancy of its form, shape (k,).
        """
        if "order" in self.units:
            return {"amplitude": float(np.hypot(c[0], c[1])), "order": model.values["order"]}
        return dict(zip(self.units, c.tolist(), strict=False))

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Return whether coefficients (k,) are physically possible: sign, range, dissipation."""
        low, high = self.bounds
        return bool(np.isfinite(c).all() and (c >= low).all() and (c <= high).all())

    def variants(self, model: CandidateModel) -> list[NonlinearParameter]:
        """Return nonlinear parameters of neighbouring models that no grid contains."""
        return []

    def varied(self, model: CandidateModel, key: str, value: float) -> CandidateModel:
        """Return a model with another value of a nonlinear parameter."""
        return model.with_values(**{key: value})

    def richer(self, model: CandidateModel) -> CandidateModel | None:
        """Return a form of a model with further coefficients; None if there is none."""
        return None

    def recorded_change(
        self, motion: RecordedMotion, model: CandidateModel, c: FloatArray, produced: FloatArray
    ) -> FloatArray:
        """Return recorded minus produced torque of an effect of measured torque, (M, k) [N m].

        `produced` is the torque that the actuators of the model's joints produce, of the same
        shape, where none is measured.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class CandidateModel:
    """One form of an effect at one joint: a torque that is linear in its coefficients.

    Attributes:
        joint: Index of the joint that carries the effect; None for an effect of no single joint.
        other: Index of a second joint that the effect depends on.
        interval: Start and end of an effect that acts for some of the time [s].
        source: Recording in which `interval` lies.
        facts: Quantities of the recorded motions by which the effect judges and reports its
            coefficients. They are not saved: a model that is read from a file has none.
        motions: Recorded motions, of effects whose constraints evaluate them.
        nonlinear: The nonlinear parameter to optimise; None if there is none.
        own_columns: Torque columns in the place of those of the effect.
        prior_std: Prior standard deviation of the coefficients; None: the friction level of the
            joint.
        prior_shares: Share of `prior_std` of each coefficient; empty: 1.
        form_columns: Number of last columns that are the discrepancy of its form.
        exact: The model without this discrepancy; None of a model that has none.
        signature: Description of the residual, if it differs from the effect's.
        alternatives: Number of models, each as likely, of which it was chosen before it became a
            candidate.
    """

    definition: Effect
    joint: int | None
    values: Values = field(default_factory=dict)
    other: int | None = None
    interval: tuple[float, float] | None = None
    source: str = ""
    facts: Values = field(default_factory=dict)
    motions: Motions = field(default=(), repr=False, compare=False)
    nonlinear: NonlinearParameter | None = None
    own_columns: Callable[[RecordedMotion], FloatArray] | None = None
    prior_std: float | None = None
    prior_shares: tuple[float, ...] = ()
    form_columns: int = 0
    exact: CandidateModel | None = None
    signature: str = ""
    alternatives: float = 1.0

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.definition.name

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

    @property
    def joints(self) -> slice:
        """The joint of the model; all joints of a model that has none."""
        return slice(None) if self.joint is None else slice(self.joint, self.joint + 1)

    @property
    def is_absorbed(self) -> bool:
        """True if a refit of the base model absorbs it: nothing that acts for some of the time."""
        return self.definition.prior_only and self.interval is None

    @property
    def nonnegative(self) -> tuple[bool, ...]:
        """Coefficients whose sign physics fixes to be ≥ 0; empty: none."""
        signs = self.definition.nonnegative
        return (*signs, *(False,) * self.form_columns) if signs else ()

    def columns(self, motion: RecordedMotion) -> FloatArray:
        """Return the torque per unit of each coefficient at the motion's rows [N m], (N, n, k)."""
        if self.own_columns is not None:
            return self.own_columns(motion)
        return self.definition.torque_columns(motion, self)

    def acts_during(self, motion: RecordedMotion) -> BoolArray:
        """Tell at which rows of a motion it may act: all without an interval, shape (N,)."""
        if self.interval is None:
            return np.ones(len(motion), bool)
        low, high = self.interval
        inside = (motion.time >= low) & (motion.time <= high)
        return np.asarray(inside & (motion.segment.source == self.source))

    def plain(self, c: FloatArray) -> FloatArray:
        """Return coefficients, shape (k,), without those of the discrepancy of its form."""
        return c[: len(c) - self.form_columns]

    def parameters(self, c: FloatArray, base: FittedRobot) -> Values:
        """Return the reported parameters by name, see `Effect.parameters`."""
        return self.definition.parameters(self, c, base)

    def is_plausible(self, c: FloatArray) -> bool:
        """Return whether coefficients, shape (k,), are physically possible."""
        return self.definition.is_plausible(self, c)

    def variants(self) -> list[NonlinearParameter]:
        """Return nonlinear parameters of neighbouring models that no grid contains."""
        return self.definition.variants(self)

    def with_values(self, **values: float) -> CandidateModel:
        """Return the exact model with other values, and without a parameter to optimise."""
        return replace(
            self,
            values={**self.values, **values},
            nonlinear=None,
            own_columns=None,
            form_columns=0,
            exact=None,
        )


@dataclass(frozen=True)
class NonlinearParameter:
    """A nonlinear parameter of a candidate model, between its neighbours on a grid.

    Attributes:
        model: A model of which it is the only nonlinear parameter to change.
        key: Name of the parameter, as `Effect.varied` takes it: usually its key in the values.
    """

    model: CandidateModel
    key: str
    value: float
    low: float
    high: float

    def optimised(self, gain: Callable[[CandidateModel], float]) -> CandidateModel:
        """Return the model with the highest gain between the bounds, or a better model variant."""
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
        """Return the model of maximal gain over this parameter alone, and its gain.

        The search is bounded and runs over the logarithm, to 0.4 % of its range. If none is better,
        the present model and `current_gain` are returned.
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
        moved = self.model.definition.varied(self.model, self.key, value)
        return replace(moved, nonlinear=here)


def within(model: CandidateModel, key: str, factor: float) -> NonlinearParameter:
    """Return a parameter of a model that is free within a factor of its value."""
    value = model.values[key]
    return NonlinearParameter(model, key, value, value / factor, value * factor)


def grid_candidates(
    model: CandidateModel, key: str, grid: Sequence[float], least: float = 0.0
) -> Iterator[CandidateModel]:
    """Yield a model with each value of a rising grid, free between the neighbouring values.

    Values below `least`, and the range below it, are left out.
    """
    values = sorted({max(value, least) for value in grid})
    for i, value in enumerate(values):
        low = values[i - 1] if i else max(value * grid[0] / grid[1], least)
        high = values[i + 1] if i + 1 < len(values) else value * grid[-1] / grid[-2]
        yield NonlinearParameter(model, key, value, low, high).current


def single_joint_columns(motion: RecordedMotion, joint: int, x: FloatArray) -> FloatArray:
    """Return columns (N, n, k) of a torque (M,) or (M, k) that acts on one joint."""
    return single_joint_rows(motion, joint, motion.lowpass(x[:, None] if x.ndim == 1 else x))


def single_joint_rows(motion: RecordedMotion, joint: int, low: FloatArray) -> FloatArray:
    """Return columns (N, n, k) that are the low-passed columns (N, k) of one joint.

    In memory the rows of each joint are adjacent.
    """
    out = np.zeros((motion.n, *low.shape))
    out[joint] = low
    return out.swapaxes(0, 1)
