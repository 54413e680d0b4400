"""A recording of a robot's motion, joints in the robot's order."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import UnusableInput
from ..robot.samples import Samples
from . import encoder
from .block import QUANTITIES
from .remark import Remark
from .sidecar import Sidecar
from .time_axis import pieces

Array = np.ndarray
BAND_HZ = 20.0
SHORTEST = 16
"""Rows below which a piece is too short to be filtered."""


@dataclass(frozen=True)
class Recording:
    """What was measured, checked and on an even grid but for gaps. Shapes (N, n); a column is NaN
    where a joint lacks the quantity.

    t: Shape (N,) [s]. q: position [rad or m]. dq: velocity [rad/s]. tau: torque [N m or N].
        current: of the motor [A].
    qref: commanded position. qlink: position by the encoder behind the gear. temperature: [°C].
    remarks: what the health check found and did. own_times: times of the file's rows, in order,
        each once: N rows or, where the rows were put on an even grid, another number. Shape (M,)
        [s]. steps: standard deviation of positions by their encoders' steps, as they were read.
        Shape (n,); None where q is as it was read. smoothed: joints whose q is the smoothest within
        its encoder's steps. Shape (n,) or, where none is, (1,). run_in: leading rows that repeat
        the end of the block before (`stream`).
    """

    source: str
    joints: tuple[str, ...]
    t: Array
    q: Array
    dq: Array | None = None
    tau: Array | None = None
    current: Array | None = None
    qref: Array | None = None
    qlink: Array | None = None
    temperature: Array | None = None
    sidecar: Sidecar = field(default_factory=Sidecar)
    remarks: tuple[Remark, ...] = ()
    own_times: Array = field(default_factory=lambda: np.empty(0))
    steps: Array | None = None
    smoothed: Array = field(default_factory=lambda: np.zeros(1, bool))
    run_in: int = 0

    def __len__(self) -> int:
        return len(self.t)

    @property
    def step(self) -> float:
        """Time between rows [s]."""
        return float(np.median(np.diff(self.t)))

    @functools.cached_property
    def encoder(self) -> Array:
        """Standard deviation of positions by the encoders' steps, 0 where none shows. Shape
        (n,)."""
        return encoder.noise(self.q) if self.steps is None else self.steps

    @property
    def rate(self) -> float:
        """Rows a second [Hz]."""
        return 1.0 / self.step

    @property
    def repeats(self) -> tuple[float, tuple[float, float]] | None:
        """After how long the motion is stated to repeat, and from when to when: all of the
        recording, where no window is stated [s]."""
        period = self.sidecar.period
        return (
            None
            if period is None
            else (period, self.sidecar.periodic or (float(self.t[0]), float(self.t[-1])))
        )

    def check_period(
        self, period: float, periodic: tuple[float, float] | None, stated_by: str
    ) -> None:
        """Raise UnusableInput for a period of fewer than SHORTEST rows, or a window in which the
        recording has no row.

        Args:
            period: Period of the motion [s].
            periodic: Window in which the motion repeats [s]; None: the whole recording.
            stated_by: Option or file that says so, for messages.
        """
        if period < SHORTEST * self.step:
            raise UnusableInput(
                f"{stated_by}: the period {period:g} s has fewer than {SHORTEST} rows of "
                f"{self.source}, {self.step:.3g} s apart; correct it"
            )
        if periodic is not None and not (periodic[0] < self.t[-1] and periodic[1] > self.t[0]):
            raise UnusableInput(
                f"{stated_by}: no row of {self.source} is between {periodic[0]:g} and "
                f"{periodic[1]:g} s; "
                f"it runs from {self.t[0]:g} to {self.t[-1]:g} s"
            )

    @property
    def quantities(self) -> int:
        """Number of quantities that were measured, positions included."""
        return sum(getattr(self, name) is not None for name in QUANTITIES)

    def has(self, quantity: str, joint: str) -> bool:
        """Whether a quantity of a joint was measured at all."""
        values = getattr(self, quantity)
        return values is not None and bool(np.isfinite(values[:, self.joints.index(joint)]).any())

    @property
    def torque(self) -> Array:
        """Measured torque: `tau` of a joint, or else its current times its drive gain. Shape (N, n)
        [N m].

        Raises UnusableInput, naming the joint, where there is neither or no gain.
        """
        out = np.empty(self.q.shape)
        for i, joint in enumerate(self.joints):
            if self.tau is not None and self.has("tau", joint):
                out[:, i] = self.tau[:, i]
            elif self.current is not None and self.has("current", joint):
                out[:, i] = self.current[:, i] * self._gain(joint)
            else:
                raise UnusableInput(
                    f"{self.source}: joint '{joint}' has no torque; record tau.{joint}, or "
                    f"i.{joint} with a drive_gain"
                )
        return out

    def _gain(self, joint: str) -> float:
        if joint not in self.sidecar.drive_gain:
            raise UnusableInput(
                f"{self.source}: joint '{joint}' has a current but no drive gain; put "
                f'"drive_gain": {{"{joint}": N m/A}} into the .json beside the recording ("schema": "excite.recording/1")'  # noqa: E501
            )
        return self.sidecar.drive_gain[joint]

    def rows(self, which: Array | slice) -> Recording:
        """The rows that `which` selects, with the remarks as they are."""
        chosen = {
            name: value[which] for name in QUANTITIES if (value := getattr(self, name)) is not None
        }
        return dataclasses.replace(self, t=self.t[which], **chosen)

    def between(self, start: float, end: float) -> Recording:
        """The rows with start ≤ t ≤ end [s], and what was remarked of that time or of no time.

        Raises UnusableInput where there are none.
        """
        inside = (self.t >= start) & (self.t <= end)
        if not inside.any():
            raise UnusableInput(
                f"{self.source}: has no rows from {start:g} to {end:g} s; it runs from "
                f"{self.t[0]:g} to {self.t[-1]:g} s"
            )
        remarks = tuple(
            r
            for r in self.remarks
            if r.start is None or r.end is None or (r.start <= end and r.end >= start)
        )
        own = self.own_times[(self.own_times >= start) & (self.own_times <= end)]
        repeated = int(inside[: self.run_in].sum())
        return dataclasses.replace(
            self.rows(inside), remarks=remarks, own_times=own, run_in=repeated
        )

    def segments(self, shortest: int = SHORTEST) -> Iterator[Recording]:
        """Pieces without a gap, evenly sampled; those of fewer than `shortest` rows are left
        out."""
        for piece in pieces(self.t, self.step):
            if piece.stop - piece.start >= shortest:
                yield dataclasses.replace(
                    self.rows(piece),
                    run_in=min(max(self.run_in - piece.start, 0), piece.stop - piece.start),
                )

    def samples(self, band: float = BAND_HZ) -> Samples:
        """Positions, velocities and accelerations below `band` [Hz]: a zero-phase low-pass, then
        central differences, piece by piece."""
        from scipy import signal  # slow to import

        dt = self.step
        slow = band * dt >= 0.45  # sampled too slowly for there to be anything above the band
        filtered = [
            piece.q
            if slow
            else signal.sosfiltfilt(
                signal.butter(4, band, fs=1.0 / dt, output="sos"), piece.q, axis=0
            )
            for piece in self.segments()
        ]
        if not filtered:
            raise UnusableInput(
                f"{self.source}: has no {SHORTEST} rows without a gap; record again"
            )
        dq = [np.gradient(q, dt, axis=0) for q in filtered]
        ddq = [np.gradient(v, dt, axis=0) for v in dq]
        return Samples(np.concatenate(filtered), np.concatenate(dq), np.concatenate(ddq))


def refuse_same(fitted: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """Raise UnusableInput where a recording to judge by is one of those that are fitted."""
    for one in held_out:
        for other in fitted:
            if len(one) == len(other) and np.array_equal(one.q, other.q):
                raise UnusableInput(
                    f"{one.source}: is the same motion as {other.source}; validate with another "
                    "recording"
                )
