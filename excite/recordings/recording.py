"""A recording of a robot's motion, joints in the robot's order."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import UnusableInput
from ..robot.samples import Samples
from . import encoder_resolution
from .block import QUANTITIES
from .remark import Remark, RemarkKind, shown_time
from .sidecar import Sidecar, sidecar_path
from .time_axis import gap_free_slices, mean_step

DEFAULT_CUTOFF_HZ = 20.0
"""Cutoff frequency of `Recording.samples` [Hz]."""
MAX_CUTOFF_PER_RATE = 0.45
"""Cutoff frequency over the sampling rate from which `Recording.samples` does not filter [1]."""
FILTER_ORDER = 4
"""Order of the low-pass filter of `Recording.samples`, which is applied forward and backward."""
MIN_ROWS = 16
"""Number of rows below which a segment is too short to be filtered."""


@dataclass(frozen=True)
class Recording:
    """Measured signals, checked, repaired and evenly spaced but for gaps.

    A column is NaN where a joint lacks the quantity; a quantity is None where all joints lack it.

    Attributes:
        source: Name of the recording.
        joints: Names of the joints.
        t: Times. Shape (N,) [s].
        q: Positions. Shape (N, n) [rad or m].
        dq: Velocities. Shape (N, n) [rad/s or m/s].
        tau: Torques. Shape (N, n) [N m or N].
        current: Motor currents. Shape (N, n) [A].
        qref: Commanded positions. Shape (N, n) [rad or m].
        qlink: Positions measured on the link's side of the gear. Shape (N, n) [rad or m].
        temperature: Temperatures. Shape (N, n) [°C].
        base: Pose of a floating base: position [m], unit quaternion x, y, z, w whose sign does not
            change. Shape (N, 7).
        signals: Other signals of a floating base by name: "wrench.<frame>", shape (N, 6) [N, N m],
            "gyroscope" [rad/s] and "accelerometer" [m/s²], shape (N, 3); see `floating_signals`.
        sidecar: Sidecar of the file.
        remarks: Remarks about its data, and repairs.
        row_times: Distinct times of the rows in the file, in order. Shape (M,) [s], with M ≠ N
            where rows were resampled.
        encoder_noise: Standard deviation of the quantization error of positions as they were read.
            Shape (n,); None if `q` is as it was read.
        smoothed: True for joints whose `q` was smoothed within the encoder's resolution. Shape
            (n,), or (1,) if there are none.
        run_in: Number of leading rows that repeat the end of the previous block of a `stream`.
        columns: Standard names of columns -> differing names in the file, with which it was read.
    """

    source: str
    joints: tuple[str, ...]
    t: FloatArray
    q: FloatArray
    dq: FloatArray | None = None
    tau: FloatArray | None = None
    current: FloatArray | None = None
    qref: FloatArray | None = None
    qlink: FloatArray | None = None
    temperature: FloatArray | None = None
    base: FloatArray | None = None
    signals: Mapping[str, FloatArray] = field(default_factory=dict)
    sidecar: Sidecar = field(default_factory=Sidecar)
    remarks: tuple[Remark, ...] = ()
    row_times: FloatArray = field(default_factory=lambda: np.empty(0))
    encoder_noise: FloatArray | None = None
    smoothed: BoolArray = field(default_factory=lambda: np.zeros(1, bool))
    run_in: int = 0
    columns: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def step(self) -> float:
        """Time between rows [s]."""
        return mean_step(self.t)

    @functools.cached_property
    def quantization_noise(self) -> FloatArray:
        """Standard deviation of the quantization error of positions, 0 if unknown. Shape (n,)."""
        if self.encoder_noise is not None:
            return self.encoder_noise
        return encoder_resolution.quantization_noise(self.q)

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return 1.0 / self.step

    @property
    def repetition(self) -> tuple[float, tuple[float, float]] | None:
        """Stated period, and the window in which the motion repeats [s]; None if not stated.

        Without a stated window it is the complete recording.
        """
        period = self.sidecar.period
        return (
            None
            if period is None
            else (period, self.sidecar.periodic or (float(self.t[0]), float(self.t[-1])))
        )

    def check_period(
        self, period: float, periodic: tuple[float, float] | None, stated_by: str
    ) -> None:
        """Check that a period and a window fit the recording.

        Args:
            period: Period of the motion [s].
            periodic: Window in which the motion repeats [s]; None: the complete recording.
            stated_by: Option or file that states them, for messages.

        Raises:
            UnusableInput: The period has fewer than MIN_ROWS rows, or the window has none.
        """
        if period < MIN_ROWS * self.step:
            raise UnusableInput(
                f"{stated_by}: the period {period:g} s has fewer than {MIN_ROWS} rows of "
                f"{self.source}, {self.step:.3g} s apart; correct it"
            )
        if periodic is not None and not (periodic[0] < self.t[-1] and periodic[1] > self.t[0]):
            raise UnusableInput(
                f"{stated_by}: no row of {self.source} is between {shown_time(periodic[0])} and "
                f"{shown_time(periodic[1])} s; it runs from {self._span}"
            )

    @property
    def _span(self) -> str:
        """First and last time, for messages."""
        return f"{shown_time(self.t[0])} to {shown_time(self.t[-1])} s"

    @property
    def doubts(self) -> tuple[Remark, ...]:
        """Unrepaired doubts about what the columns hold.

        While there are any, a difference between the recording and a model says nothing about a
        single joint of the robot.
        """
        return tuple(remark for remark in self.remarks if remark.doubt)

    @property
    def quantities(self) -> int:
        """Number of measured quantities, positions included."""
        return sum(getattr(self, name) is not None for name in QUANTITIES)

    def has(self, quantity: str, joint: str) -> bool:
        """Return True if a quantity of a joint was measured in at least one row."""
        values = getattr(self, quantity)
        return values is not None and bool(np.isfinite(values[:, self.joints.index(joint)]).any())

    @property
    def torque(self) -> FloatArray:
        """Measured torque: `tau` of a joint, else its current times its drive gain. Shape (N, n)
        [N m or N].

        Raises:
            UnusableInput: A joint has neither, or a current without a drive gain.
        """
        out = np.empty(self.q.shape)
        for i, joint in enumerate(self.joints):
            if self.tau is not None and self.has("tau", joint):
                out[:, i] = self.tau[:, i]
            elif self.current is not None and self.has("current", joint):
                out[:, i] = self.current[:, i] * self._drive_gain(joint)
            else:
                raise UnusableInput(
                    f"{self.source}: joint '{joint}' has no torque; record tau.{joint}, or "
                    f"i.{joint} with a drive_gain{self._unread(joint)}"
                )
        return out

    def _unread(self, joint: str) -> str:
        """State the columns of the file that are not read, for a message; empty without any."""
        from .column_names import listed
        from .csv_reader import read_column_names
        from .spelled_columns import unread_columns

        try:
            header = read_column_names(Path(self.source))
        except (UnusableInput, OSError):  # no CSV, or no longer there
            return ""
        names = [
            name
            for name in unread_columns(header, self.joints)
            if name not in self.columns.values()
        ]
        if not names or header[0].isdigit():  # of `ros2 topic echo --csv`, which has no names
            return ""
        return f", or name its column with --columns tau.{joint}=COLUMN (not read: {listed(names)})"

    def _drive_gain(self, joint: str) -> float:
        """Drive gain of a joint [N m/A]."""
        if joint not in self.sidecar.drive_gain:
            require_drive_gains([self])
        return self.sidecar.drive_gain[joint]

    @property
    def lacks_drive_gain(self) -> tuple[str, ...]:
        """Names of the joints with a current, no torque and no drive gain."""
        return tuple(
            name
            for name in self.joints
            if self.has("current", name)
            and not self.has("tau", name)
            and name not in self.sidecar.drive_gain
        )

    def rows(self, which: IntArray | BoolArray | slice) -> Recording:
        """Return the rows of an index, a mask or a slice, with all remarks."""
        selected = {
            name: value[which] for name in QUANTITIES if (value := getattr(self, name)) is not None
        }
        signals = {name: value[which] for name, value in self.signals.items()}
        base = None if self.base is None else self.base[which]
        return dataclasses.replace(self, t=self.t[which], base=base, signals=signals, **selected)

    @property
    def contacts(self) -> tuple[str, ...]:
        """Frames of the contact wrenches of a floating base, "world" among them, by name."""
        prefix = "wrench."
        frames = (name[len(prefix) :] for name in self.signals if name.startswith(prefix))
        return tuple(sorted(frames))

    def wrench(self, frame: str) -> FloatArray:
        """Return the wrench at a frame. Shape (N, 6) [N, N m]."""
        return self.signals[f"wrench.{frame}"]

    def between(self, start: float, end: float) -> Recording:
        """Return the rows with start ≤ t ≤ end and the remarks that concern them.

        Args:
            start: First time [s].
            end: Last time [s].

        Raises:
            UnusableInput: There are no rows.
        """
        inside = (self.t >= start) & (self.t <= end)
        if not inside.any():
            raise UnusableInput(
                f"{self.source}: has no rows from {shown_time(start)} to {shown_time(end)} s; it "
                f"runs from {self._span}"
            )
        remarks = tuple(
            r
            for r in self.remarks
            if r.start is None or r.end is None or (r.start <= end and r.end >= start)
        )
        row_times = self.row_times[(self.row_times >= start) & (self.row_times <= end)]
        run_in = int(inside[: self.run_in].sum())
        return dataclasses.replace(
            self.rows(inside), remarks=remarks, row_times=row_times, run_in=run_in
        )

    def segments(self, min_rows: int = MIN_ROWS) -> Iterator[Recording]:
        """Yield the evenly sampled segments between gaps, without those of fewer rows."""
        for rows in gap_free_slices(self.t, self.step):
            count = rows.stop - rows.start
            if count >= min_rows:
                run_in = min(max(self.run_in - rows.start, 0), count)
                yield dataclasses.replace(self.rows(rows), run_in=run_in)

    def require_segment(self) -> None:
        """Check that there is a segment that can be filtered.

        Raises:
            UnusableInput: All segments have fewer than MIN_ROWS rows.
        """
        if next(self.segments(), None) is None:
            frozen = [r.text for r in self.remarks if r.kind is RemarkKind.FROZEN and r.repaired]
            cause = f", since {frozen[0]}" if frozen else ""
            raise UnusableInput(
                f"{self.source}: has no {MIN_ROWS} rows without a gap{cause}; record again"
            )

    def samples(self, cutoff: float = DEFAULT_CUTOFF_HZ) -> Samples:
        """Compute positions, velocities and accelerations of all segments.

        Positions are filtered by a zero-phase low-pass filter, then differentiated by central
        differences.

        Args:
            cutoff: Cutoff frequency [Hz].

        Raises:
            UnusableInput: All segments have fewer than MIN_ROWS rows.
        """
        from scipy import signal  # slow to import

        self.require_segment()
        dt = self.step
        is_slow = cutoff * dt >= MAX_CUTOFF_PER_RATE  # nothing above the cutoff is sampled
        filtered = [
            segment.q
            if is_slow
            else signal.sosfiltfilt(
                signal.butter(FILTER_ORDER, cutoff, fs=1.0 / dt, output="sos"), segment.q, axis=0
            )
            for segment in self.segments()
        ]
        dq = [np.gradient(q, dt, axis=0) for q in filtered]
        ddq = [np.gradient(v, dt, axis=0) for v in dq]
        return Samples(np.concatenate(filtered), np.concatenate(dq), np.concatenate(ddq))


def require_drive_gains(recordings: Sequence[Recording]) -> None:
    """Check that all joints with a current and no torque have a drive gain.

    Raises:
        UnusableInput: Some have none; the message names all recordings.
    """
    lacking = [recording for recording in recordings if recording.lacks_drive_gain]
    if not lacking:
        return
    joints = list(dict.fromkeys(name for r in lacking for name in r.lacks_drive_gain))
    sources = ", ".join(recording.source for recording in lacking)
    files = ", ".join(sidecar_path(Path(recording.source)).name for recording in lacking)
    gains = ", ".join(f'"{name}": N m/A' for name in joints)
    raise UnusableInput(
        f"{sources}: joint '{joints[0]}' has a current but no drive gain; put "
        f'"drive_gain": {{{gains}}} into {files} ("schema": "excite.recording/1")'
    )


def require_distinct(fitted: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """Check that no recording is fitted twice, and that no validation recording is a fitted one.

    Raises:
        UnusableInput: Two fitted recordings hold the same values, or a validation recording has the
            positions of a fitted one.
    """
    for first, second in itertools.combinations(fitted, 2):
        if _hold_same_values(first, second):
            raise UnusableInput(
                f"{second.source}: is the same recording as {first.source} and would count twice; "
                "name it once"
            )
    for validation in held_out:
        for training in fitted:
            if len(validation) == len(training) and np.array_equal(validation.q, training.q):
                raise UnusableInput(
                    f"{validation.source}: is the same motion as {training.source}; validate with "
                    "another recording"
                )


def _hold_same_values(first: Recording, second: Recording) -> bool:
    """True if all signals of two recordings are equal."""
    values, others = _measured_values(first), _measured_values(second)
    return values.keys() == others.keys() and all(
        np.array_equal(value, others[name], equal_nan=True) for name, value in values.items()
    )


def _measured_values(recording: Recording) -> dict[str, FloatArray]:
    """All signals of a recording by name."""
    named = {name: getattr(recording, name) for name in (*QUANTITIES, "base")}
    recorded = {name: value for name, value in named.items() if value is not None}
    return {**recorded, **recording.signals}
