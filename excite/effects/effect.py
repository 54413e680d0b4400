"""What the catalogue is made of: effects, each with the shapes that it can take and what would be needed to believe it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from .recorded_motion import RecordedMotion

Array = np.ndarray
MULTIPLES = {2: "twice", 3: "thrice"}
"""Of an order, that are told with it where a shape states them."""
KIN = 4
"""Steps from kin to kin, at the most."""
CORNER, TURNS = 0.3, 150
"""How far off the logarithms of values are tried first that are turned together, and how many are."""


class RecordingDelay(NamedTuple):
    """By how much torque is recorded later than position [s]: as it was, or lagging, through a filter of first order."""

    seconds: float
    lagging: bool = False


@dataclass(frozen=True)
class CandidateModel:
    """One form of an effect at one joint: linear in its coefficients once `values` are fixed.

    joint: index of the joint that carries it, None where it is nobody's. add: the torque it adds, which depends on what is said here and
    nothing else. values: the fixed, non-linear parameters. other: a further joint it is tied to. interval, source: when [s] and in
    which recording, if only then. parameters: from coefficients (k,) to the contract's names and values. plausible: whether
    coefficients (k,) can be physics: sign, range, dissipation. knob: turns the value that a grid has fixed. kin: knobs of the shapes beside
    it, by a further value that no grid is worth. several: whether one joint can have more than one of the kind. doubt: how many times the
    usual gain it takes to be believed where an encoder is coarse, and its root where it is fine. grain: noise over the torque up to which
    its columns, of measured torque, are not noise themselves; noisy: of such columns times coefficients (k,), RMS of the noise in them over
    that of the torque. words: its signature, if not the effect's.
    """

    effect: str
    joint: int | None
    add: Add
    values: Mapping[str, float] = field(default_factory=dict)
    other: int | None = None
    interval: tuple[float, float] | None = None
    source: str = ""
    parameters: Callable[[Array], dict[str, float]] = lambda c: {}
    plausible: Callable[[Array], bool] = lambda c: bool(np.isfinite(c).all())
    nonlinear: NonlinearParameter | None = None
    variants: Callable[[], Sequence[NonlinearParameter | NonlinearParameterSet]] = tuple
    allows_several: bool = False
    threshold_factor: float = 1.0
    max_noise_ratio: float = np.inf
    noisy: Callable[[Array], float] = lambda c: 0.0
    signature: str = ""

    def columns(self, track: RecordedMotion) -> Array:
        """Torque that it adds, where the track's rows are, per unit of each coefficient. Shape (N, n, k)."""
        if "late" not in self.values:
            return self.add(track, self)
        late = self.add(track.delayed(self.values["late"], "lagging" in self.values), self)
        if "late_joint" not in self.values:
            return late
        joint = int(self.values["late_joint"])
        if not np.delete(late, joint, axis=1).any():
            return late
        out = self.add(track, self)
        out[:, joint] = late[:, joint]
        return out

    def delayed(self, delay: RecordingDelay, joint: int | None) -> CandidateModel:
        """The same where a joint's torque, or all, is recorded later; turned, too."""
        values = {**self.values, "late": delay.seconds} | (
            {} if joint is None else {"late_joint": float(joint)}
        )
        values |= {"lagging": 1.0} if delay.lagging else {}
        knob = None if self.nonlinear is None else self.nonlinear.delayed(delay, joint)
        return replace(
            self,
            values=values,
            nonlinear=knob,
            variants=lambda: [other.delayed(delay, joint) for other in self.variants()],
        )

    @property
    def joint_index(self) -> int:
        """The joint, of a shape that has one."""
        assert self.joint is not None
        return self.joint


Add = Callable[[RecordedMotion, CandidateModel], Array]
Recorded = Callable[[RecordedMotion, CandidateModel, Array, Array], Array]


@dataclass(frozen=True)
class NonlinearParameter:
    """A non-linear parameter: the value that a shape has, between its neighbours on the grid, and the shape at any other."""

    value: float
    low: float
    high: float
    shape: Callable[[float], CandidateModel]

    def turned(self, gain: Callable[[CandidateModel], float]) -> CandidateModel:
        """The shape where the gain is highest, between the neighbours, or one of its kin where that is more, from kin to kin."""
        best, most = self.best(gain, gain(self.here))
        for _ in range(KIN):
            gains = [(gain(near.here), near) for near in best.variants()]
            if not gains:
                break
            together = [pair for pair in gains if isinstance(pair[1], NonlinearParameterSet)]
            tried = together or [max(gains, key=lambda pair: pair[0])]
            better, found = max(
                (near.best(gain, now) for now, near in tried), key=lambda pair: pair[1]
            )
            if found <= most + 1e-6:
                break
            best, most = better, found
            if together:
                break  # turned every way
        return best

    @property
    def here(self) -> CandidateModel:
        """The shape at the value that it has."""
        return self.at(self.value)

    def best(self, gain: Callable[[CandidateModel], float], now: float) -> tuple[CandidateModel, float]:
        """By this value alone, where the gain is `now`, with the gain. In the logarithm, to two parts in a thousand of the range."""
        from scipy.optimize import minimize_scalar  # slow to import

        low, high = np.log(self.low), np.log(self.high)
        found = minimize_scalar(
            lambda x: -max(gain(self.at(float(np.exp(x)))), -1e12),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 4e-3 * (high - low), "maxiter": 12},
        )
        best, most = self.at(float(np.exp(found.x))), -float(found.fun)
        return (best, most) if most > max(now + 1e-6, -1e12) else (self.here, now)

    def delayed(self, delay: RecordingDelay, joint: int | None) -> NonlinearParameter:
        """See `Shape.late`."""
        return replace(self, shape=lambda value: self.shape(value).delayed(delay, joint))

    def at(self, value: float) -> CandidateModel:
        """The shape at a value, which can be turned further within the same range."""
        return replace(self.shape(value), nonlinear=replace(self, value=value))


@dataclass(frozen=True)
class NonlinearParameterSet:
    """Several non-linear parameters that make up for each other: of each the value, what it is at the least and at the most; and the shape
    at any other."""

    values: Mapping[str, tuple[float, float, float]]
    shape: Callable[[Mapping[str, float]], CandidateModel]

    @property
    def here(self) -> CandidateModel:
        """The shape at the values that it has."""
        return self.shape({name: value for name, (value, _, _) in self.values.items()})

    def best(self, gain: Callable[[CandidateModel], float], now: float) -> tuple[CandidateModel, float]:
        """By all values together, where the gain is `now`, with the gain. In logarithms, without derivatives (Nelder & Mead 1965)."""
        from scipy.optimize import minimize  # slow to import

        start, low, high = np.log(np.array(list(self.values.values()))).T

        def at(x: Array) -> CandidateModel:
            return self.shape(dict(zip(self.values, np.exp(x).tolist(), strict=True)))

        corners = np.vstack(
            [start, start + np.diag(np.where(start + CORNER < high, CORNER, -CORNER))]
        )
        found = minimize(
            lambda x: -max(gain(at(x)), -1e12),
            start,
            method="Nelder-Mead",
            bounds=list(zip(low, high, strict=True)),
            options={"xatol": 3e-3, "fatol": 0.1, "maxfev": TURNS, "initial_simplex": corners},
        )
        return (at(found.x), -float(found.fun)) if -found.fun > now + 1e-6 else (self.here, now)

    def delayed(self, delay: RecordingDelay, joint: int | None) -> NonlinearParameterSet:
        """See `Shape.late`."""
        return replace(self, shape=lambda values: self.shape(values).delayed(delay, joint))


def beside(value: float, factor: float, families: Iterable[Callable[[float], CandidateModel]]) -> list[NonlinearParameter]:
    """Each of several families at one value, to be turned within a factor."""
    return [NonlinearParameter(value, value / factor, value * factor, shape) for shape in families]


def family(grid: Sequence[float], shape: Callable[[float], CandidateModel]) -> Iterator[CandidateModel]:
    """A shape at each value of a rising grid, to be turned between the neighbours."""
    for i, value in enumerate(grid):
        low = grid[i - 1] if i else value**2 / grid[1]
        high = grid[i + 1] if i + 1 < len(grid) else value**2 / grid[-2]
        yield NonlinearParameter(value, low, high, shape).at(value)


def multiples(values: Mapping[str, float]) -> list[int]:
    """Those of a shape, the order itself first."""
    return [1, *(k for k, name in MULTIPLES.items() if name in values)]


def waves(values: Mapping[str, float], angle: Array) -> Array:
    """Cosine and sine of a shape's order, and of those of its multiples, over a joint's angle. Shapes (M,) -> (M, k)."""
    return np.column_stack(
        [f(k * values["order"] * angle) for k in multiples(values) for f in (np.cos, np.sin)]
    )


@dataclass(frozen=True)
class Effect:
    """An entry of the catalogue.

    name: the contract's. add: the torque that a shape of it adds. shapes: all forms on a robot whose recordings are these tracks.
    units: of its parameters. prior_only: a refit of the base model absorbs it. signature: what it looks like. confused: names it
    is taken for. experiment: what would tell them apart. form: relative standard deviation of parameters where a robot's form is not
    quite this one. loose: by how much more than of most the logarithm of the share is that it leaves where it is right (`belief.py`).
    told: the contract's parameters of a joint's shapes with their coefficients, the largest first. recorded: of an effect with shapes of
    measured torque, what one adds where nothing is measured yet, by all the torque that is made, Shape (M, n). unseen: standard
    deviation of parameters by what such shapes could have and recordings would not show.
    """

    name: str
    source: str
    add: Add
    shapes: Callable[[Sequence[RecordedMotion]], Iterator[CandidateModel]]
    units: Mapping[str, str]
    signature: str
    are_confusable: tuple[str, ...]
    experiment: str
    prior_only: bool = False
    form: Mapping[str, float] = field(default_factory=dict)
    residual_log_offset: float = 0.0
    told: Callable[[Sequence[tuple[CandidateModel, Array]]], dict[str, float]] = lambda parts: parts[0][
        0
    ].parameters(parts[0][1])
    recorded: Recorded | None = None
    unobserved_std: Callable[[Sequence[tuple[CandidateModel, Array]]], dict[str, float]] = lambda parts: {}


def alone(track: RecordedMotion, joint: int, x: Array) -> Array:
    """Columns in one joint's torque only, from values at every sample: (M,) or (M, k)."""
    low = track.lowpass(x[:, None] if x.ndim == 1 else x)
    out = np.zeros((len(low), track.n, low.shape[1]))
    out[:, joint] = low
    return out


def named(*names: str, **fixed: float) -> Callable[[Array], dict[str, float]]:
    """Coefficients by name, and values that are fixed."""
    return lambda c: {name: float(value) for name, value in zip(names, c, strict=False)} | fixed


def amplitude(**fixed: float) -> Callable[[Array], dict[str, float]]:
    """The size of a pair of cosine and sine, and values that are fixed."""
    return lambda c: {"amplitude": float(np.hypot(c[0], c[1]))} | fixed


def within(low: float, high: float) -> Callable[[Array], bool]:
    """The first coefficient lies between two bounds."""
    return lambda c: bool(low < c[0] < high)


def positive(c: Array) -> bool:
    """Every coefficient is above zero."""
    return bool((c > 0.0).all())
