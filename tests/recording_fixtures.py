"""Recordings as files, and their remarks and warnings."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from excite import recordings
from excite._types import BoolArray, FloatArray, IntArray
from excite.errors import ExciteWarning, UnusableInput
from excite.recordings import RemarkKind

JOINTS = ("joint_1", "joint_2")


def two_joint_motion(rows: int = 400, rate: float = 100.0) -> dict[str, FloatArray]:
    """Return columns of two moving joints with torques; the keys are those of the contract."""
    t = np.arange(rows) / rate
    phase = np.outer(t, [2.0, 3.0])
    q, dq = 0.5 * np.sin(phase), 0.5 * np.array([2.0, 3.0]) * np.cos(phase)
    tau = 3.0 * np.cos(1.7 * phase) + 1e-3 * np.sin(1e5 * phase)
    columns = {"t": t}
    for prefix, values in (("q", q), ("dq", dq), ("tau", tau)):
        columns |= {f"{prefix}.{name}": values[:, i] for i, name in enumerate(JOINTS)}
    return columns


def write_columns(
    path: Path, columns: dict[str, FloatArray], separator: str = ",", order: list[str] | None = None
) -> Path:
    """Write columns as CSV."""
    names = order or list(columns)
    lines = [separator.join(names)]
    lines += [
        separator.join(repr(float(columns[name][k])) for name in names)
        for k in range(len(columns[names[0]]))
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def remark_kinds(recording: recordings.Recording) -> list[RemarkKind]:
    """Return the kinds of a recording's remarks."""
    return [remark.kind for remark in recording.remarks]


def read_with_warnings(path: Path, robot, **options) -> tuple[recordings.Recording, list[str]]:
    """Return a recording and its warnings.

    Every warning is also a remark, and every repair is warned of, except that an encoder rounds and
    that values are refreshed more slowly than rows.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = recordings.read(path, robot, **options)
    texts = [str(w.message) for w in caught]
    assert texts == [
        f"{path}: {r.text}"
        for r in recording.remarks
        if r.repaired and r.kind not in (RemarkKind.HELD, RemarkKind.ROUNDED)
    ]
    assert all(issubclass(w.category, ExciteWarning) for w in caught)
    return recording, texts


def assert_refused(path: Path, robot, *words: str, **options) -> str:
    """Assert that reading a file fails with one line that contains the words; return the line."""
    with pytest.raises(UnusableInput) as caught:
        recordings.read(path, robot, **options)
    text = str(caught.value)
    assert "\n" not in text and text.startswith(str(path)), text
    for word in words:
        assert word in text, (word, text)
    return text


@dataclass
class DamagedMotion:
    """A motion with a fault, as columns of a file."""

    columns: dict[str, FloatArray]

    def rows(self, which: IntArray | BoolArray) -> DamagedMotion:
        """Return the motion with some of its rows."""
        return DamagedMotion({name: values[which] for name, values in self.columns.items()})

    def read(self, folder: Path, robot):
        """Write and read the motion."""
        return read_with_warnings(write_columns(folder / "r.csv", self.columns), robot)
