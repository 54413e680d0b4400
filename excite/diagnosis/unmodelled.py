"""Unmodelled torque: the share of a residual that a flexible model predicts on held-out data.

What generic features predict in recordings that they were not fitted to is physics, even if no
effect in the catalogue explains it; noise cannot be predicted. Ridge regression (Hoerl & Kennard,
Technometrics 12, 1970) on one basis of features at a time, fitted to either fold and judged on the
other. Waves and bumps over position and speed show what depends on a joint's state; a finite
impulse response of its acceleration or load shows any linear resonance (Ljung, System
Identification, 1999, sec. 4.2).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from .._types import BoolArray, FloatArray
from . import noise
from .joint_model import JointModel
from .motion_rows import MIN_BIN_ROWS, MotionRows, motion_rows
from .noise import NoiseEstimate

HARMONICS = 40
"""Largest harmonic of a turn, or of a prismatic joint's range."""
SPEED_BUMPS = 13
"""Bumps over a joint's speeds."""
POSITION_BUMPS = 150
"""Narrow bumps over a joint's range."""
MEMORY = 4.0
"""Length of the impulse response of a resonance [s]."""
MAX_LAGS = 250
"""Largest number of values of the impulse response."""
RIDGES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Ridge parameters over the mean square of the features."""
LOG_ODDS = -4.0
"""Prior log odds that a joint has torque that no effect explains: about 2 %."""
MIN_SIZE = 0.5
"""RMS of unmodelled torque from which it is reported, over the noise floor."""
RESPONSE_BINS = 100
"""Bins of a reported response."""
ERROR_BLOCKS = 40
"""Blocks between which the standard error of a share is estimated."""
CONSTANT_TOLERANCE = 1e-9
"""Standard deviation of a feature over its largest value below which it is constant."""


@dataclass(frozen=True)
class ResidualResponse:
    """A joint's residual over what it depends on.

    Attributes:
        over: Quantity of the abscissa, with its unit.
        x: Abscissa, shape (b,).
        y: Torque [N m], or the impulse response over its largest value, shape (b,).
        other: Index of the joint whose quantity `over` is; None for the same joint.
        relative: Whether y is relative.
    """

    over: str
    x: FloatArray
    y: FloatArray
    other: int | None = None
    relative: bool = False


@dataclass(frozen=True)
class ResidualPrediction:
    """Best prediction of a joint's residual.

    Attributes:
        regime: Name of the basis of features; see `BASES`.
        share: Predicted share of the held-out mean square; about zero for noise.
        sure: That share over its standard error.
        response: The residual over what it depends on.
    """

    regime: str
    share: float
    sure: float
    response: ResidualResponse


@dataclass(frozen=True)
class UnmodelledTorque:
    """Torque of a joint that no effect explains.

    Attributes:
        joint: Index of the joint.
        prediction: How it is predicted.
        size: RMS of what is predicted [N m].
        probability: That it is physics and not noise.
    """

    joint: int
    prediction: ResidualPrediction
    size: float
    probability: float


def _position_waves(rows: MotionRows, joint: int) -> FloatArray:
    """Harmonics of the joint position."""
    q = rows.q[:, joint]
    angle = 2.0 * np.pi * (q - q.min()) / max(np.ptp(q), 1e-12) if rows.linear[joint] else q
    waves = np.outer(angle, np.arange(1, HARMONICS + 1))
    return np.hstack([np.cos(waves), np.sin(waves)])


def _position_bumps(rows: MotionRows, joint: int) -> FloatArray:
    """Narrow bumps over the joint's range, as for a broken tooth or a dent in a bearing race."""
    q = rows.q[:, joint]
    centres = np.linspace(q.min(), q.max(), POSITION_BUMPS)
    width = max(float(centres[1] - centres[0]), 1e-12)
    return np.asarray(np.exp(-0.5 * np.square((q[:, None] - centres) / width)))


def _directed_waves(rows: MotionRows, joint: int) -> FloatArray:
    """Harmonics of the joint position times the direction of motion."""
    return _position_waves(rows, joint) * rows.direction(joint)[:, None]


def _speed_bumps(rows: MotionRows, joint: int) -> FloatArray:
    """Bumps over every joint's speed."""
    centres = np.linspace(-1.0, 1.0, SPEED_BUMPS)
    relative = rows.dq / np.maximum(np.abs(rows.dq).max(axis=0), 1e-12)
    return np.exp(
        -0.5 * np.square((relative[:, :, None] - centres) * 0.5 * (SPEED_BUMPS - 1))
    ).reshape(len(rows), -1)


def _power_features(rows: MotionRows, joint: int) -> FloatArray:
    """The joint's torque times the power and load of all actuators, as for a weak supply."""
    torque, load = rows.motor_torque[:, joint], _normalised(np.abs(rows.motor_torque))
    power = _normalised(rows.motor_torque * rows.dq)
    total_power = _normalised(_total_power(rows, joint))
    mean_load = load.sum(axis=1) / load.shape[1]
    total = np.column_stack(
        [total_power, np.abs(total_power), total_power**2, mean_load, mean_load**2]
    )
    modulated = _normalised(torque)[:, None] * np.hstack(
        [total, power, np.maximum(power, 0.0), load]
    )
    return np.hstack([modulated, rows.direction(joint)[:, None] * total_power[:, None]])


def _total_power(rows: MotionRows, joint: int) -> FloatArray:
    """Power of all actuators [W], shape (N,)."""
    return np.asarray(np.sum(rows.motor_torque * rows.dq, axis=1))


def _normalised(x: FloatArray) -> FloatArray:
    """Columns over their largest magnitudes."""
    return np.asarray(x / np.maximum(np.abs(x).max(axis=0), 1e-300))


def _lag_step(rows: MotionRows) -> float:
    """Time between values of the impulse response [s]."""
    return max(MEMORY / MAX_LAGS, 1.0 / rows.rate)


def _lagged(x: FloatArray, rows: MotionRows) -> FloatArray:
    """Past values of x within the memory; zero before a recording begins."""
    step = _lag_step(rows)
    out = np.zeros((len(rows), int(MEMORY / step)))
    for a, b in itertools.pairwise([*rows.begins.tolist(), len(rows)]):
        time, values = rows.time[a:b], x[a:b] - x.mean()
        for k in range(out.shape[1]):
            out[a:b, k] = np.interp(time - k * step, time, values, left=0.0)
    return out


@dataclass(frozen=True)
class FeatureBasis:
    """Features of one kind.

    Attributes:
        features: Returns the features of a joint at all rows, shape (N, k).
        experiment: Experiment that would show the dependence alone.
        label: Label of the response's abscissa.
        over: Returns the abscissa, shape (N,); None for the time since a cause.
        sign: Returns the factor on the residual in the response, 0 to leave a row out.
        every: Whether the features are those of every joint, one after the other.
    """

    features: Callable[[MotionRows, int], FloatArray]
    experiment: str
    label: str
    over: Callable[[MotionRows, int], FloatArray] | None = None
    sign: Callable[[MotionRows, int], FloatArray] = lambda rows, joint: np.ones(len(rows))
    every: bool = False


SHARP_STOP = "a sharp stop, then standstill, which shows the oscillation alone"
"""Experiment that shows a resonance."""
BASES: Mapping[str, FeatureBasis] = {
    "position": FeatureBasis(
        _position_waves,
        "that joint alone, slowly back and forth over its range",
        "position [{}]",
        lambda rows, j: rows.q[:, j],
    ),
    "place": FeatureBasis(
        _position_bumps,
        "that joint alone, slowly past the place, both ways",
        "position [{}]",
        lambda rows, j: rows.q[:, j],
    ),
    "position and direction": FeatureBasis(
        _directed_waves,
        "that joint alone, slowly back and forth, between ends that shift",
        "position, along the motion [{}]",
        lambda rows, j: rows.q[:, j],
        lambda rows, j: rows.direction(j),
    ),
    "speed": FeatureBasis(
        _speed_bumps,
        "constant speeds of one joint after the other",
        "speed [{}/s]",
        lambda rows, j: rows.dq[:, j],
        every=True,
    ),
    "past acceleration": FeatureBasis(
        lambda rows, j: _lagged(rows.ddq[:, j], rows), SHARP_STOP, "since an acceleration [s]"
    ),
    "past load": FeatureBasis(
        lambda rows, j: _lagged(rows.load[:, j], rows), SHARP_STOP, "since a load [s]"
    ),
    "power": FeatureBasis(
        _power_features,
        "that joint slowly, alone, then while the others move fast",
        "power of all drives, along the torque [W]",
        _total_power,
        lambda rows, j: np.sign(rows.motor_torque[:, j]),
    ),
}
"""Bases of features by regime."""


REPETITION = "repetition"
"""Regime of torque that repeats with the motion, whatever it depends on."""


def experiment(regime: str) -> str:
    """Return the experiment that shows torque of a regime alone."""
    if regime == REPETITION:
        return "each joint alone over the same positions and speeds, the others at rest"
    return BASES[regime].experiment


def find(
    model: JointModel, residual: FloatArray, estimate: NoiseEstimate
) -> list[UnmodelledTorque]:
    """Find torque that no effect of a joint model explains.

    Physics is what is predictable: by a flexible model that is fitted to one half of the training
    recordings and predicts the other, or where a motion repeats, by another period. The evidence
    is ½ z² − ln K, with z the predicted power over its standard error, and K kinds of features.

    Args:
        model: The joint model.
        residual: Its residual, shape (N, n) [N m].
        estimate: The noise of that residual.
    """
    rows = motion_rows(model.motions)
    middle = np.concatenate([np.arange(len(motion)) < len(motion) // 2 for motion in model.motions])
    products = noise.products_of_periods(estimate.periods, model.motions, residual)
    out = []
    for j in range(model.n):
        moving = model.regression.moving[:, j]
        square = float(np.mean(residual[moving, j] ** 2))
        prediction = predict_residual(rows, (moving & middle, moving & ~middle), residual[:, j], j)
        if len(products):
            repeated = _repeated_share(products[:, j], square, float(estimate.steps[j]))
            if repeated[1] > prediction.sure:
                prediction = replace(
                    prediction, regime=REPETITION, share=repeated[0], sure=repeated[1]
                )
        size = np.sqrt(max(prediction.share, 0.0) * square)
        evidence = 0.5 * max(prediction.sure, 0.0) ** 2 - np.log(len(BASES) + 1)
        chance = float(special.expit(evidence + LOG_ODDS))
        if chance >= 0.5 and size > MIN_SIZE * estimate.floor[j]:
            out.append(UnmodelledTorque(j, prediction, float(size), chance))
    return out


def _repeated_share(products: FloatArray, square: float, steps: float) -> tuple[float, float]:
    """Share of a residual's power that repeats, and that share over its standard error.

    Args:
        products: Products of the residuals of two periods, shape (m,).
        square: Mean square residual.
        steps: RMS of the errors by encoder quantisation, which repeat as well.
    """
    blocks = np.array([part.mean() for part in np.array_split(products, ERROR_BLOCKS)])
    power = float(blocks.mean()) - steps**2
    std = max(float(blocks.std() / np.sqrt(ERROR_BLOCKS)), 1e-300)
    return power / max(square, 1e-300), power / std


def predict_residual(
    rows: MotionRows, halves: Sequence[BoolArray], residual: FloatArray, joint: int
) -> ResidualPrediction:
    """Predict a joint's residual by each basis and return the best significant prediction.

    Args:
        rows: Motion at all rows.
        halves: Masks of the rows of either fold.
        residual: Torque residual [N m], shape (N,).
        joint: Index of the joint.
    """
    predictions = list[tuple[float, float, float, str]]()
    for regime, basis in BASES.items():
        x = _standardised(basis.features(rows, joint))[0]
        share, errors, ridge = _cross_validate(
            [x[half] for half in halves], [residual[half] for half in halves]
        )
        predictions.append((errors, share, ridge, regime))
    errors, share, ridge, regime = max(predictions)
    moves = np.logical_or(*halves)
    return ResidualPrediction(
        regime, share, errors, _response(rows, moves, residual, joint, regime, ridge)
    )


def _standardised(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns with mean 0 and standard deviation 1, and the latter; zeros for constant columns."""
    centred = x - x.mean(axis=0)
    spread = centred.std(axis=0)
    spread[spread <= CONSTANT_TOLERANCE * np.abs(x).max(axis=0, initial=0.0)] = np.inf
    return centred / spread, spread


def _response(
    rows: MotionRows,
    moves: BoolArray,
    residual: FloatArray,
    joint: int,
    regime: str,
    ridge: float,
) -> ResidualResponse:
    """The residual, where a joint moves, over the quantity of a regime."""
    basis = BASES[regime]
    if basis.over is None:
        c, _, spread = _fit(rows, basis, moves, residual, joint, ridge)
        impulse_response = c / spread  # 0 for constant features
        return ResidualResponse(
            basis.label,
            np.asarray(_lag_step(rows) * np.arange(len(c)), float),
            np.asarray(
                impulse_response / max(float(np.abs(impulse_response).max()), 1e-300), float
            ),
            relative=True,
        )
    if basis.every:  # over the joint that explains most
        c, x, _ = _fit(rows, basis, moves, residual, joint, ridge)
        joint = int(np.argmax((x * c).reshape(len(x), rows.n, -1).sum(axis=2).var(axis=0)))
    sign = basis.sign(rows, joint)
    shown = moves & (sign != 0.0)
    curve = _binned_means(basis.over(rows, joint)[shown], (residual * sign)[shown])
    label = basis.label.format("m" if rows.linear[joint] else "rad")
    return ResidualResponse(label, *curve, other=joint if basis.every else None)


def _fit(
    rows: MotionRows,
    basis: FeatureBasis,
    moves: BoolArray,
    residual: FloatArray,
    joint: int,
    ridge: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients over all rows where a joint moves, the features there, and their spread."""
    features, spread = _standardised(basis.features(rows, joint))
    x = features[moves]
    c = np.linalg.solve(
        x.T @ x / len(x) + ridge * np.eye(x.shape[1]), x.T @ residual[moves] / len(x)
    )
    return np.asarray(c, float), x, spread


def _binned_means(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of y in equal bins of x that have enough rows, shapes (b,)."""
    edges = np.linspace(x.min(), x.max(), RESPONSE_BINS + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, RESPONSE_BINS - 1)
    count = np.bincount(place, minlength=RESPONSE_BINS)
    enough = count >= MIN_BIN_ROWS
    mean = np.bincount(place, y, minlength=RESPONSE_BINS) / np.maximum(count, 1)
    return 0.5 * (edges[1:] + edges[:-1])[enough], np.asarray(mean[enough], float)


def _cross_validate(
    features: Sequence[FloatArray], residual: Sequence[FloatArray]
) -> tuple[float, float, float]:
    """Share of the residual power that each fold predicts of the other.

    Returns:
        The share, the share over its standard error, and the best ridge parameter.
    """
    square = np.square(np.concatenate(residual))
    error, at = np.zeros((len(RIDGES), len(square))), 0
    for train, test in ((1, 0), (0, 1)):
        values, vectors = np.linalg.eigh(features[train].T @ features[train] / len(features[train]))
        score = vectors.T @ (features[train].T @ residual[train]) / len(features[train])
        rotated = features[test] @ vectors
        for k, ridge in enumerate(RIDGES):
            remainder = residual[test] - rotated @ (score / (np.maximum(values, 0.0) + ridge))
            error[k, at : at + len(remainder)] = np.square(remainder)
        at += len(residual[test])
    explained = square - error
    best = int(np.argmax(explained.sum(axis=1)))
    blocks = np.array([part.sum() for part in np.array_split(explained[best], ERROR_BLOCKS)])
    std = max(float(blocks.std() * np.sqrt(ERROR_BLOCKS)), 1e-300)
    return (
        float(blocks.sum() / max(square.sum(), 1e-300)),
        float(blocks.sum() / std),
        RIDGES[best],
    )
