"""Tables of joint positions at a control rate, each described by a profile in `vendors.toml`.

A profile states how a controller counts positions: unit, sign, zero, coupling of joints, and
whether they are relative to the start pose. The numbers are angles, so that robots with prismatic
joints are refused. Signs and zeros are those of the URDF unless the profile states the vendor's
own.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from .._types import FloatArray
from .file_format import (
    Columns,
    ExportedText,
    ExportJob,
    fixed,
    note_path,
    notes,
    require_joints,
    require_rate,
    require_turning,
    sampled,
)

SCALE = {"rad": 1.0, "deg": 180.0 / np.pi}
"""Numbers of each unit per radian."""
LABELS = {"start": "start [rad]:", "rate": "rate [Hz]:"}
"""Labels of the comments that `read` needs."""


@dataclass(frozen=True)
class TableProfile:
    """Description of a controller's table of positions.

    The fields have the names of the keys of `vendors.toml`, whose comments describe them.
    """

    title: str
    unit: str
    rates: tuple[float, ...]
    tried_on_hardware: bool
    joints: tuple[int, ...] = ()
    sign: tuple[float, ...] = ()
    offset: tuple[float, ...] = ()
    coupling: tuple[tuple[int, int, float], ...] = ()
    relative: bool = False
    columns: tuple[str, ...] = ()
    separator: str = ","
    comment: str = "#"
    note: str = ""

    def encode(self, q: FloatArray) -> FloatArray:
        """Convert joint positions to the numbers of the controller.

        Args:
            q: Positions; the first row is the start pose. Shape (N, n) [rad].

        Returns:
            Numbers of the table. Shape (N, n).
        """
        out = self._absolute(q)
        return out - out[0] if self.relative else out

    def decode(self, values: FloatArray, start: FloatArray) -> FloatArray:
        """Convert the numbers of a table to joint positions; inverse of `encode`.

        Args:
            values: Numbers of the table. Shape (N, n).
            start: Start pose, for tables relative to it. Shape (n,) [rad].

        Returns:
            Positions. Shape (N, n) [rad].
        """
        n = values.shape[1]
        sign, offset, mix = self._factors(n)
        absolute = values + self._absolute(start[None, :]) if self.relative else values
        out: FloatArray = (np.linalg.solve(mix, absolute.T).T - offset) / (sign * SCALE[self.unit])
        return out

    def _absolute(self, q: FloatArray) -> FloatArray:
        sign, offset, mix = self._factors(q.shape[1])
        out: FloatArray = (q * sign * SCALE[self.unit] + offset) @ mix.T
        return out

    def _factors(self, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Signs, shape (n,), offsets, shape (n,), and coupling matrix, shape (n, n)."""
        mix = np.eye(n)
        for joint, other, factor in self.coupling:
            mix[joint - 1, other - 1] += factor
        return np.array(self.sign or (1.0,) * n), np.array(self.offset or (0.0,) * n), mix


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value


@cache
def profiles() -> Mapping[str, TableProfile]:
    """Return all profiles of `vendors.toml` by the names of their formats.

    Raises:
        ValueError: An entry has an unknown key.
    """
    text = (resources.files(__package__) / "vendors.toml").read_text(encoding="utf-8")
    known = {f.name for f in fields(TableProfile)}
    table = tomllib.loads(text)
    for name, entry in table.items():
        if set(entry) - known:
            raise ValueError(
                f"vendors.toml: [{name}] has unknown keys {sorted(set(entry) - known)}"
            )
    return {
        name: TableProfile(**{key: _tuples(value) for key, value in entry.items()})
        for name, entry in table.items()
    }


def render_table(job: ExportJob, profile: TableProfile) -> ExportedText:
    """Return a table with one row per control cycle, with comments or a separate note.

    Args:
        job: The file to export.
        profile: Description of the table.

    Raises:
        UnusableInput: The number of joints or the rate does not fit the profile, a joint slides, or
            the motion does not begin and end at rest.
    """
    require_joints(job, profile.joints)
    require_turning(job)
    rate = require_rate(job, profile.rates)
    _, samples = sampled(job, rate)
    values = profile.encode(samples.q)
    columns = profile.columns or job.joints
    relative = ", relative to the start pose" if profile.relative else ""
    lines = notes(
        job,
        [
            f"{LABELS['rate']} {rate:g}",
            f"{LABELS['start']} {' '.join(fixed(q) for q in samples.q[0])}",
            f"columns [{profile.unit}{relative}]: {', '.join(columns)}",
            profile.note,
        ],
        profile.tried_on_hardware,
    )
    body = "\n".join(profile.separator.join(fixed(value) for value in row) for row in values) + "\n"
    if not profile.comment:
        return ExportedText(body, "\n".join(lines) + "\n")
    return ExportedText("".join(f"{profile.comment} {line}\n" for line in lines) + body)


def read(path: Path, profile: TableProfile) -> Columns:
    """Read a table, with the rate and the start pose that its comments state.

    Args:
        path: The file.
        profile: Description of the table.

    Returns:
        Times, shape (N,) [s], and positions, shape (N, n) [rad].

    Raises:
        ValueError: There are no rows, their lengths differ, or a relative table does not state its
            start pose.
    """
    lines = path.read_text(encoding="utf-8").splitlines()
    remarks = [line for line in lines if profile.comment and line.startswith(profile.comment)]
    rows = [line for line in lines if line and line not in remarks]
    if not profile.comment and note_path(path).exists():
        remarks = note_path(path).read_text(encoding="utf-8").splitlines()
    stated = {
        key: line.partition(label)[2].split()
        for key, label in LABELS.items()
        for line in remarks
        if label in line
    }
    values = np.array([[float(v) for v in row.split(profile.separator)] for row in rows])
    if values.ndim != 2:
        raise ValueError("it holds no rows")
    if profile.relative and "start" not in stated:
        raise ValueError(f"it has no line '{LABELS['start']}'")
    start = np.array(stated["start"], float) if "start" in stated else np.zeros(values.shape[1])
    rate = float(stated["rate"][0]) if "rate" in stated else profile.rates[0]
    return np.arange(len(values)) / rate, profile.decode(values, start)
