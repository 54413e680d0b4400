"""Order spectrum of a joint: a least-squares periodogram over its angle (Lomb 1976).

By Fourier transforms of sums in narrow bins of the angle. Rows where a wave lies above the cutoff
frequency do not count; the speeds are divided into classes for that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._types import BoolArray, FloatArray, IntArray
from ..effects import recorded_motion
from ..effects.recorded_motion import Motions

if TYPE_CHECKING:
    from .joint_model import JointModel

MIN_RIPPLE_ORDER, MAX_RIPPLE_ORDER = 3.0, 300.0
"""Spatial frequencies that are searched [1/rad], see `recorded_motion.radian`."""
ORDER_STEPS = 4.0
"""Length of the Fourier transform over the range of the angle."""
ANGLE_BIN = np.pi / 2400.0
"""Width of the bins of angle in the order spectrum [rad], a sixteenth of the shortest wave."""
SPEED_CLASSES = 8
"""Classes of speed in the order spectrum."""
MIN_WAVE_ROWS = 0.05
"""Smallest share of rows in which a wave lies below the cutoff frequency."""


def angle_and_speed(motions: Motions, joint: int) -> tuple[FloatArray, FloatArray]:
    """Return angle and speed of a joint at the rows of all motions, shapes (N,)."""
    states = [np.column_stack([m.samples.q[:, joint], m.samples.dq[:, joint]]) for m in motions]
    angle, speed = np.vstack([m.at_rows(x) for m, x in zip(motions, states, strict=True)]).T
    return angle, speed


@dataclass(frozen=True)
class OrderSpectrum:
    """Order spectrum of a joint along some motions, of any residual.

    Attributes:
        joint: Index of the joint.
        rows: Rows that count, shape (N,).
        size: Amplitude of the wave at these rows, shape (N,).
        place: Bin of each row, shape (N,).
        speed_class: Class of speed of each row, shape (N,).
        length: Number of bins.
        wanted: Places of the orders in the transform, shape (K,).
        orders: Spatial frequencies [1/rad or 1/m], shape (K,).
        below: Orders that lie below the cutoff frequency in each class of speed, shape (C, K).
    """

    joint: int
    rows: IntArray
    size: FloatArray
    place: IntArray
    speed_class: IntArray
    length: int
    wanted: IntArray
    orders: FloatArray
    below: BoolArray

    @classmethod
    def of(
        cls, fitted: JointModel, joint: int, low: float, *, grows_with_speed: bool = False
    ) -> OrderSpectrum:
        """Return the spectrum of the motions of a joint model from the order `low` [1/rad or 1/m].

        `grows_with_speed`: whether the amplitude grows with the square of the speed.
        """
        rows = np.flatnonzero(fitted.regression.moving[:, joint])
        angle, speed = (x[rows] for x in angle_and_speed(fitted.motions, joint))
        size = np.ones(len(rows))
        if grows_with_speed:
            size = (speed / max(float(np.abs(speed).max()), 1e-300)) ** 2
        unit = recorded_motion.radian(fitted.motions, joint)
        place = np.rint((angle - angle.min()) / (ANGLE_BIN * unit)).astype(int)
        length = int(2 ** np.ceil(np.log2(ORDER_STEPS * (int(place.max()) + 1))))
        orders = 2.0 * np.pi * np.arange(length // 2 + 1) / (length * ANGLE_BIN * unit)
        wanted = np.flatnonzero((orders >= low) & (orders <= MAX_RIPPLE_ORDER / unit))
        highest = 2.0 * np.pi * fitted.motions[0].band.hertz / np.maximum(np.abs(speed), 1e-9)
        edges = np.quantile(highest, np.linspace(0.0, 1.0, SPEED_CLASSES + 1)[1:-1])
        speed_class = np.searchsorted(edges, highest, side="right")
        below = np.zeros((SPEED_CLASSES, len(wanted)), bool)
        for k in np.unique(speed_class):
            below[k] = orders[wanted] <= float(np.median(highest[speed_class == k]))
        return cls(
            joint=joint,
            rows=rows,
            size=size,
            place=place,
            speed_class=speed_class,
            length=length,
            wanted=wanted,
            orders=np.asarray(orders[wanted]),
            below=below,
        )

    @cached_property
    def _products(self) -> tuple[BoolArray, FloatArray]:
        """Orders whose cosine and sine differ in enough rows, shape (K,).

        And for these the sums of cos², sin² and cos · sin over the rows, shape (3, U).
        """
        squares = self.size**2
        number = np.bincount(self.speed_class, squares, SPEED_CLASSES) @ self.below
        square = self._transform(squares, 2 * self.wanted)
        cc, ss, cs = 0.5 * (number + square.real), 0.5 * (number - square.real), -0.5 * square.imag
        usable = (cc * ss - cs**2 > 1e-3 * (cc + ss) ** 2) & (
            number > MIN_WAVE_ROWS * float(np.sum(squares))
        )
        return usable, np.array([cc, ss, cs])[:, usable]

    def peak(self, fitted: JointModel) -> tuple[float, float]:
        """Return the order [1/rad or 1/m] that fits the residual best, and half its power [(N m)²].

        Both are 0 where there is none. The joint model is of the same motions.
        """
        usable, (cc, ss, cs) = self._products
        if not usable.any():
            return 0.0, 0.0
        residual = fitted.regression.residual_of(self.joint)[self.rows]
        wave = self._transform(residual * self.size, self.wanted)[usable]
        yc, ys = wave.real, -wave.imag
        power = (ss * yc**2 - 2.0 * cs * yc * ys + cc * ys**2) / (cc * ss - cs**2)
        k = int(np.argmax(power))
        return float(self.orders[usable][k]), 0.5 * float(power[k])

    def _transform(self, values: FloatArray, places: IntArray) -> NDArray[np.complex128]:
        """Fourier transform of values at the rows, where the orders are below the cutoff, (K,).

        `places` (K,) are those in the transform.
        """
        total = np.zeros(len(places), complex)
        for k in np.unique(self.speed_class):
            members = self.speed_class == k
            sums = np.bincount(self.place[members], values[members], self.length)
            total += np.where(self.below[k], np.fft.rfft(sums)[places], 0.0)
        return total
