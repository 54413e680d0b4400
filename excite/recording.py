"""Recordings of a robot's motion: the contract's CSV, read by joint name and differentiated with zero phase."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import UnusableInput
from .robot import Robot
from .trajectory import Samples

Array = np.ndarray
BAND_HZ = 20.0


@dataclass(frozen=True)
class Recording:
    """Times and joint positions as recorded. t: Shape (N,) [s]. q: Shape (N, n) [rad or m]."""

    source: str
    t: Array
    q: Array

    def samples(self, band: float = BAND_HZ) -> Samples:
        """Positions, velocities and accelerations below `band` [Hz]: a zero-phase low-pass, then central differences."""
        from scipy import signal  # slow to import

        dt = float(np.median(np.diff(self.t)))
        t = np.arange(self.t[0], self.t[-1] + 0.5 * dt, dt)
        q = np.column_stack([np.interp(t, self.t, column) for column in self.q.T])
        slow = band * dt >= 0.45  # sampled too slowly for there to be anything above the band
        filtered = q if slow else signal.sosfiltfilt(signal.butter(4, band, fs=1.0 / dt, output="sos"), q, axis=0)
        dq = np.gradient(filtered, dt, axis=0)
        return Samples(filtered, dq, np.gradient(dq, dt, axis=0))


def read(path: Path, robot: Robot) -> Recording:
    """Read `t` and `q.<joint>` of a CSV; UnusableInput names what is missing, not a number or out of order."""
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            header = [name.strip() for name in next(csv.reader(stream), [])]
            table = np.loadtxt(stream, delimiter=",", ndmin=2)
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise UnusableInput(f"{path}: cannot be read as a recording ({error}); give a CSV with a header t,q.<joint>,…") from error
    if "t" not in header:
        raise UnusableInput(f"{path}: has no column 't'; the first row should name the columns t,q.<joint>,…")
    for joint in robot.joints:
        if f"q.{joint}" not in header:
            raise UnusableInput(f"{path}: has no column 'q.{joint}'; record that joint, or leave it out with --joints")
    if len(table) < 16 or table.shape[1] != len(header):
        raise UnusableInput(
            f"{path}: has {table.shape[0]} rows of {table.shape[1]} values for {len(header)} columns; give at least 16 full rows"
        )
    t, q = table[:, header.index("t")], table[:, [header.index(f"q.{joint}") for joint in robot.joints]]
    bad = ~np.isfinite(q)
    if bad.any() or not np.isfinite(t).all():
        row, column = np.argwhere(bad)[0] if bad.any() else (int(np.argmin(np.isfinite(t))), 0)
        raise UnusableInput(f"{path}: row {row + 2}: joint '{robot.joints[column]}' or its time is not a number; drop or repair the row")
    if not (np.diff(t) > 0.0).all():
        raise UnusableInput(
            f"{path}: row {int(np.argmin(np.diff(t) > 0)) + 3}: time does not increase; sort the rows and drop repeated ones"
        )
    return Recording(str(path), t, q)
