"""Tables of joint positions at a control rate, each described by a profile in `vendors.toml`.

A profile says what a controller counts: unit, sign, zero, coupling, whether from the start pose.
Profiles in degrees are for arms whose joints all turn. Signs and zeros are the URDF's; where a
maker's own differ, the profile is where to say so.
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

from .file_format import (
    Array,
    Columns,
    Job,
    Written,
    beside,
    fixed,
    notes,
    require_joints,
    require_rate,
    sampled,
)

SCALE = {"rad": 1.0, "deg": 180.0 / np.pi}
MARKS = {"start": "start [rad]:", "rate": "rate [Hz]:"}


@dataclass(frozen=True)
class Profile:
    """One controller's table of positions; the fields carry the names of the TOML's keys, described
    there."""

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

    def encode(self, q: Array) -> Array:
        """What the controller counts, for positions whose first row is the start pose. Shapes (N,
        n) -> (N, n)."""
        out = self._absolute(q)
        return out - out[0] if self.relative else out

    def decode(self, values: Array, start: Array) -> Array:
        """The inverse of `encode`; start: the first pose (n,) [rad], used where the values are
        relative."""
        n = values.shape[1]
        sign, offset, mix = self._factors(n)
        absolute = values + self._absolute(start[None, :]) if self.relative else values
        out: Array = (np.linalg.solve(mix, absolute.T).T - offset) / (sign * SCALE[self.unit])
        return out

    def _absolute(self, q: Array) -> Array:
        sign, offset, mix = self._factors(q.shape[1])
        out: Array = (q * sign * SCALE[self.unit] + offset) @ mix.T
        return out

    def _factors(self, n: int) -> tuple[Array, Array, Array]:
        """Signs (n,), offsets (n,) and the matrix of couplings (n, n)."""
        mix = np.eye(n)
        for joint, other, factor in self.coupling:
            mix[joint - 1, other - 1] += factor
        return np.array(self.sign or (1.0,) * n), np.array(self.offset or (0.0,) * n), mix


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value


@cache
def profiles() -> Mapping[str, Profile]:
    """All profiles of `vendors.toml` by the name of their format."""
    text = (resources.files(__package__) / "vendors.toml").read_text(encoding="utf-8")
    known = {f.name for f in fields(Profile)}
    table = tomllib.loads(text)
    for name, entry in table.items():
        if set(entry) - known:
            raise ValueError(
                f"vendors.toml: [{name}] has unknown keys {sorted(set(entry) - known)}"
            )
    return {
        name: Profile(**{key: _tuples(value) for key, value in entry.items()})
        for name, entry in table.items()
    }


def write(job: Job, profile: Profile) -> Written:
    """One row a cycle, as the profile says; comments at the top, or in a note where the format
    takes none."""
    require_joints(job, profile.joints)
    rate = require_rate(job, profile.rates)
    _, samples = sampled(job, rate)
    values = profile.encode(samples.q)
    columns = profile.columns or job.joints
    relative = ", relative to the start pose" if profile.relative else ""
    lines = notes(
        job,
        [
            f"{MARKS['rate']} {rate:g}",
            f"{MARKS['start']} {' '.join(fixed(q) for q in samples.q[0])}",
            f"columns [{profile.unit}{relative}]: {', '.join(columns)}",
            profile.note,
        ],
        profile.tried_on_hardware,
    )
    body = "\n".join(profile.separator.join(fixed(value) for value in row) for row in values) + "\n"
    if not profile.comment:
        return Written(body, "\n".join(lines) + "\n")
    return Written("".join(f"{profile.comment} {line}\n" for line in lines) + body)


def read(path: Path, profile: Profile) -> Columns:
    """Times [s] and positions [rad] of a table, with what its notes say of rate and start. Shapes
    (N,), (N, n).

    Raises ValueError where rows are missing or uneven, or a relative table doesn't say where it
    starts.
    """
    lines = path.read_text(encoding="utf-8").splitlines()
    remarks = [line for line in lines if profile.comment and line.startswith(profile.comment)]
    rows = [line for line in lines if line and line not in remarks]
    if not profile.comment and beside(path).exists():
        remarks = beside(path).read_text(encoding="utf-8").splitlines()
    said = {
        key: line.partition(mark)[2].split()
        for key, mark in MARKS.items()
        for line in remarks
        if mark in line
    }
    values = np.array([[float(v) for v in row.split(profile.separator)] for row in rows])
    if values.ndim != 2:
        raise ValueError("it holds no rows")
    if profile.relative and "start" not in said:
        raise ValueError(f"it has no line '{MARKS['start']}'")
    start = np.array(said["start"], float) if "start" in said else np.zeros(values.shape[1])
    rate = float(said["rate"][0]) if "rate" in said else profile.rates[0]
    return np.arange(len(values)) / rate, profile.decode(values, start)
