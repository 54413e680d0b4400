"""Torque ripple: torque that is periodic in the joint or motor angle, as cogging or gear mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from .._linear_algebra import factors
from .._types import FloatArray, IntArray
from .effect import (
    HARMONIC_KEYS,
    CandidateModel,
    Effect,
    NonlinearParameter,
    harmonic_columns,
    harmonic_numbers,
    single_joint_columns,
)
from .recorded_motion import RecordedMotion
from .spring import MIN_CURVE_RANGE

ComplexArray = NDArray[np.complex128]

ORDER_TOLERANCE = 0.02
"""Relative difference below which two orders count as the same."""
WEAK_WAVE_RATIO = 0.3
"""Amplitude over that of its strongest multiple below which a wave counts as absent."""
MAX_ORDERS = 12
"""Largest number of orders that are tried at each joint by each of both searches."""
MAX_ORDER = 300.0
"""Largest order that is searched [1/turn]."""
ORDER_ERROR_TURNS = 2.5
"""Error of an order times the joint's range [rad] within which it is optimised."""
MAX_GRID_CELLS = 20_000_000
"""Largest number of orders times rows that are evaluated."""
MIN_FREE_SHARE = 0.01
"""Smallest share of a wave's power that the base model does not absorb."""
MIN_ROW_SHARE = 0.05
"""Smallest share of rows in which a wave lies below the cutoff frequency."""
MIN_RELATIVE_RESIDUAL = 1e-3
"""Smallest residual of a joint as a weight, over that of the joint with the largest."""
MIN_WAVES = 1.5
"""Waves over the longest motion from which a torque counts as periodic; below, it is a spring."""


def _columns(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Waves of an order and its stated multiples; with a "load", also waves that grow with it."""
    j = model.joint_index
    if "load" in model.values:
        phase = model.values["order"] * motion.samples.q[:, j]
        load = motion.transmitted_torque[:, j] / model.values["load"]
        waves = np.column_stack([np.cos(phase), np.sin(phase)])
        return single_joint_columns(motion, j, np.hstack([waves, load[:, None] * waves]))
    return single_joint_columns(motion, j, harmonic_columns(model.values, motion.samples.q[:, j]))


def _candidates(motions: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    """Orders with large residual power; each alone, and with multiples that no other has."""

    def family(j: int, multiples: Mapping[str, float]) -> Callable[[float], CandidateModel]:
        def model(order: float) -> CandidateModel:
            values = {"order": order, **multiples}
            return CandidateModel(
                "torque_ripple",
                j,
                _columns,
                values,
                parameters=lambda c: _strongest_wave(values, c),
                allows_several=True,
            )

        return model

    for j in range(motions[0].n):
        travel = max(float(np.ptp(motion.samples.q[:, j])) for motion in motions)
        used = list[float]()
        for order in _peak_orders(motions, j):
            factor = 1.0 + ORDER_ERROR_TURNS / (travel * order)
            free = [k for k in HARMONIC_KEYS if not _is_near(k * order, used)]
            yield NonlinearParameter(order, order / factor, order * factor, family(j, {})).at(order)
            if free and not _is_near(order, used):
                multiples = {HARMONIC_KEYS[k]: 1.0 for k in free}
                yield NonlinearParameter(
                    order, order / factor, order * factor, family(j, multiples)
                ).at(order)
                used += [order, *(k * order for k in free)]


def wave_model(motions: Sequence[RecordedMotion], joint: int, order: float) -> CandidateModel:
    """Return the wave of one order [1/turn] at a joint, whose amplitude may grow with the load."""
    load = max(float(np.abs(motion.transmitted_torque[:, joint]).max()) for motion in motions)
    values = {"order": order, "load": max(load, 1e-9)}
    return CandidateModel(
        "torque_ripple",
        joint,
        _columns,
        values,
        parameters=lambda c: {"amplitude": float(np.hypot(c[0], c[1])), "order": order},
        allows_several=True,
    )


def _is_near(order: float, others: Sequence[float]) -> bool:
    """Check whether an order is the same as another, within `ORDER_TOLERANCE`."""
    return any(abs(order - other) <= ORDER_TOLERANCE * other for other in others)


def _strongest_wave(values: Mapping[str, float], c: FloatArray) -> dict[str, float]:
    """Amplitude and order of the first wave, or of its strongest multiple if that is absent."""
    sizes = np.hypot(c[::2], c[1::2])
    strongest = int(np.argmax(sizes)) if sizes[0] < WEAK_WAVE_RATIO * sizes.max() else 0
    return {
        "amplitude": float(sizes[strongest]),
        "order": values["order"] * harmonic_numbers(values)[strongest],
    }


def _peak_orders(motions: Sequence[RecordedMotion], joint: int) -> list[float]:
    """Orders at which the residual has power, in the longest motion, up to 300 a turn.

    First jointly with the whole base model, then with the residual as it is, since with a trusted
    prior nothing is refit.
    """
    motion = max(motions, key=len)
    q = np.interp(motion.time, motion.times, motion.samples.q[:, joint])
    travel = float(np.ptp(q))
    if travel < MIN_CURVE_RANGE:
        return []
    speed = np.interp(motion.time, motion.times, motion.samples.dq[:, joint])
    step = 2.0 * np.pi / travel / 3.0
    grid = np.arange(max(3.0, MIN_WAVES * 2.0 * np.pi / travel), MAX_ORDER, max(step, 0.05))
    rows = (
        slice(None)
        if len(grid) * len(q) <= MAX_GRID_CELLS
        else _random_rows(len(q), MAX_GRID_CELLS // len(grid))
    )
    q, speed = q[rows], speed[rows]
    max_frequency = 2.0 * np.pi * motion.band.hertz

    def waves(orders: FloatArray) -> ComplexArray:
        """exp(i k q), zero where the wave is above the cutoff frequency."""
        below = np.abs(np.outer(orders, speed)) < max_frequency
        return np.exp(1j * np.outer(orders, q)) * below

    grid_waves, out = waves(grid), list[float]()
    for residual, base in (
        without_base_columns(motion.residual[rows], motion.gamma[rows], joint),
        (motion.residual[rows, joint], np.zeros((len(q), 0))),
    ):
        peaks = periodogram_peaks(waves, (grid, grid_waves, step), residual, base)
        out += [order for order in peaks if not _is_near(order, out)]
    return out


def _random_rows(rows: int, count: int) -> IntArray:
    """Random selection of rows: evenly spaced ones would alias."""
    return np.sort(np.random.default_rng(0).permutation(rows)[:count])


def without_base_columns(
    residual: FloatArray, gamma: FloatArray, joint: int
) -> tuple[FloatArray, FloatArray]:
    """Project the residual off the base regressor, all joints weighted by their residual.

    Args:
        residual: Residual of the base fit, shape (N, n).
        gamma: Base regressor, shape (N, n, p).
        joint: Index of the joint.

    Returns:
        The joint's projected residual, (N,), and its rows of an orthonormal basis of the weighted
        regressor, (N, r).
    """
    rms = np.sqrt(np.mean(residual**2, axis=0))
    rms = np.maximum(rms, max(MIN_RELATIVE_RESIDUAL * float(rms.max()), 1e-300))
    span = factors((gamma / rms[:, None]).reshape(residual.size, -1))[0]
    y = (residual / rms).ravel()
    free = (y - span @ (span.T @ y)).reshape(residual.shape)
    return np.asarray(free[:, joint] * rms[joint]), np.asarray(
        span.reshape(*residual.shape, -1)[:, joint]
    )


def periodogram_peaks(
    waves: Callable[[FloatArray], ComplexArray],
    search: tuple[FloatArray, ComplexArray, float],
    residual: FloatArray,
    base: FloatArray,
) -> list[float]:
    """Return the orders of the waves that fit best jointly with a base, strongest first.

    Periodogram over the angle (Lomb 1976; generalised: Zechmeister & Kürster 2009). Each wave is
    subtracted before the next is sought, so that side lobes do not hide it (CLEAN: Högbom 1974).

    Args:
        waves: Returns the complex waves of orders.
        search: Grid of orders, their waves, and the smallest distance of two orders.
        residual: Residual without the base, shape (N,).
        base: One joint's rows of columns that are orthonormal over all joints, shape (N, r).
    """
    grid, grid_waves, step = search

    def prepared(of: ComplexArray) -> tuple[ComplexArray, FloatArray]:
        """Waves with the inverse of their Gram matrix without the base.

        The inverse is zero where the base absorbs the wave or too few rows are below the cutoff.
        """
        projection, parts = of @ base, np.stack([of.real, of.imag])
        squares = np.einsum("akr,bkr->kab", parts, parts)
        absorbed = np.stack([projection.real, projection.imag])
        free = squares - np.einsum("akp,bkp->kab", absorbed, absorbed)
        usable = np.linalg.eigvalsh(free)[:, 0] > MIN_FREE_SHARE * np.trace(
            squares, axis1=1, axis2=2
        )
        usable &= np.count_nonzero(of, axis=1) >= MIN_ROW_SHARE * of.shape[1]
        out = np.zeros_like(free)
        out[usable] = np.linalg.inv(free[usable])
        return of, out

    def fit(of: ComplexArray, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Power and coefficients of each wave, shapes (k,) and (k, 2)."""
        scores = np.stack([of.real @ residual, of.imag @ residual], axis=1)
        coefficients = np.einsum("kab,kb->ka", inverse, scores)
        return np.sum(coefficients * scores, axis=1), coefficients

    out, on_grid = list[float](), prepared(grid_waves)
    while len(out) < MAX_ORDERS:
        power = fit(*on_grid)[0]
        for other in out:
            power[np.abs(grid - other) <= 1.5 * step] = 0.0
        if not power.any():
            break
        fine = grid[int(np.argmax(power))] + step * np.linspace(-1.0, 1.0, 41)
        fine_waves = waves(fine)
        fine_power, coefficients = fit(*prepared(fine_waves))
        best = int(np.argmax(fine_power))
        out.append(float(fine[best]))
        torque = (
            np.column_stack([fine_waves[best].real, fine_waves[best].imag]) @ coefficients[best]
        )
        residual = residual - torque + base @ (base.T @ torque)
    return out


TORQUE_RIPPLE = Effect(
    "torque_ripple",
    "A cos kq + B sin kq",
    _columns,
    _candidates,
    {"order": "1/turn", "amplitude": "N m"},
    "periodic in the angle, whatever the speed",
    ("encoder_error",),
    "slow constant speed over a turn",
    form_std={"order": 0.02, "amplitude": 0.1},
    residual_log_offset=-0.5,
)
"""Torque ripple; users call it cogging, gear meshing or motor pole ripple."""
