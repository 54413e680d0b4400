"""Ask an analyst: one process per case, which sees a copy of the case's files and nothing else."""

from __future__ import annotations

import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from excite._types import BoolArray, FloatArray

from .base_model_fit import TORQUE_BAND, read_table

TIMEOUT = 600.0
"""Time after which an analyst counts as having given no answer [s]."""
PREDICT_COMMAND = "{python} -m excite predict {model} {recording} -o {csv}"
"""Command that re-reads the analyst's model."""
FLAT_BAND = 16.0
"""Frequency below which the filter of the diagnosis lets torque pass unchanged [Hz]."""
MARGIN = 0.375
"""Time at either end of a recording that the filter spoils [s]."""
STANDSTILL_SPEED = 0.01
"""Speed over its largest below which a joint stands still [1]."""
STANDSTILL_TIME = 0.06
"""Time from which a standstill counts [s]."""
BREAKAWAY = 0.02
"""Travel over the range of the motion after which a joint moves again [1]."""


@dataclass(frozen=True)
class Analyst:
    """A command that answers cases.

    Attributes:
        name: Name of its answers.
        command: Command with the placeholders {robot}, {train} (one or several files), {validate},
            {prior} ("--prior FILE" or nothing), {case} (folder of the case) and {out} (folder of
            the answer, where it writes diagnosis.json and model.json).
    """

    name: str
    command: str


def ask(analyst: Analyst, case: Path, answers: Path) -> float | None:
    """Let an analyst answer a case, unless it has already.

    The answer is `<answers>/<analyst>/<case>.json` with `seconds` of processor time, the `answer`,
    and `predicted`: the held-out RMSE [N m] per joint of the model that the analyst wrote, which is
    kept in `<answers>/<analyst>/models`. That of a process that fails or writes nothing is
    `{"error": …}`, which counts as no answer.

    Args:
        analyst: The analyst.
        case: Folder of the case.
        answers: Folder of all answers.

    Returns:
        Processor time that the analyst took [s]; None where the answer exists already.
    """
    target = answers / analyst.name / f"{case.name}.json"
    if target.exists():
        return None
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="case") as work:
        folder, out = Path(work) / "case", Path(work) / "out"
        shutil.copytree(case, folder)
        out.mkdir()
        prior = folder / "prior.json"
        words = {
            "robot": folder / "robot.urdf",
            "train": " ".join(str(path) for path in sorted(folder.glob("train*.csv"))),
            "validate": folder / "validate.csv",
            "prior": f"--prior {prior}" if prior.exists() else "",
            "case": folder,
            "out": out,
        }
        before = _children_seconds()
        fault = _run_command(analyst.command.format(**words), Path(work))
        seconds = _children_seconds() - before
        written, model = out / "diagnosis.json", out / "model.json"
        document: Any = {"error": fault or "no diagnosis.json"}
        if written.exists() and not fault:
            document = json.loads(written.read_text(encoding="utf-8"))
        predicted = None
        if model.exists():
            kept = target.parent / "models" / target.name
            kept.parent.mkdir(exist_ok=True)
            shutil.copyfile(model, kept)
            predicted = predicted_rmse(model, case / "validate.csv", Path(work) / "predicted.csv")
        staged = target.with_suffix(".part")
        entry = {"seconds": seconds, "answer": document, "predicted": predicted}
        staged.write_text(json.dumps(entry), encoding="utf-8")
        staged.rename(target)
    return seconds


def predicted_rmse(model: Path, recording: Path, csv: Path) -> Mapping[str, float] | None:
    """Return the RMSE per joint of a model re-read by `excite predict` [N m].

    Measured torque is filtered as the prediction is; standstill does not count. None where
    `excite predict` refuses the model.

    Args:
        model: The `model.json`.
        recording: The held-out recording.
        csv: File for the predicted torque.
    """
    words = {"python": sys.executable, "model": model, "recording": recording, "csv": csv}
    if _run_command(PREDICT_COMMAND.format(**words), csv.parent) or not csv.exists():
        return None
    measured, predicted = read_table(recording), read_table(csv)
    t = measured["t"]
    rate = 1.0 / float(np.median(np.diff(t)))
    margin = round(MARGIN * rate)
    out = {}
    for name in [key[4:] for key in measured if key.startswith("tau.")]:
        torque = np.interp(t, predicted["t"], predicted[f"tau.{name}"])
        error = in_band(measured[f"tau.{name}"], rate) - torque
        counts = moving(measured[f"q.{name}"], rate)
        counts[:margin] = counts[len(t) - margin :] = False
        out[name] = float(np.sqrt(np.square(error[counts]).mean()))
    return out


def in_band(x: FloatArray, rate: float) -> FloatArray:
    """Low-pass a signal without phase: flat to 16 Hz, zero from 20 Hz, a raised cosine between.

    The signal is continued by reflection about its end points.

    Args:
        x: Signal, shape (N,).
        rate: Its rate [Hz].
    """
    extended = np.concatenate([2.0 * x[0] - x[:0:-1], x, 2.0 * x[-1] - x[-2::-1]])
    frequency = np.fft.rfftfreq(len(extended), 1.0 / rate)
    share = np.clip((frequency - FLAT_BAND) / (TORQUE_BAND - FLAT_BAND), 0.0, 1.0)
    gain = 0.5 + 0.5 * np.cos(np.pi * share)
    filtered = np.fft.irfft(gain * np.fft.rfft(extended), len(extended))
    return np.asarray(filtered[len(x) - 1 : 2 * len(x) - 1])


def moving(q: FloatArray, rate: float) -> BoolArray:
    """Return the samples at which a joint moves, shape (N,): static friction is not modelled.

    A standstill lasts until the joint has travelled `BREAKAWAY` of its range.

    Args:
        q: Position, shape (N,) [rad].
        rate: Its rate [Hz].
    """
    speed = np.abs(np.gradient(in_band(q, rate), 1.0 / rate))
    still = speed < STANDSTILL_SPEED * speed.max()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    out = np.ones(len(q), bool)
    for start, end in edges.reshape(-1, 2).tolist():
        if end - start > STANDSTILL_TIME * rate:
            away = np.abs(q[end:] - q[end - 1]) > BREAKAWAY * np.ptp(q)
            out[start : end + int(np.argmax(away)) if away.any() else len(q)] = False
    return out


def _children_seconds() -> float:
    """Return the processor time of all child processes that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _run_command(command: str, folder: Path) -> str:
    """Run a command in a minimal environment; return its error, or an empty text."""
    kept = {
        key: os.environ[key]
        for key in ("PATH", "HOME", "LANG", "VIRTUAL_ENV", "PYTHONPATH")
        if key in os.environ
    }
    # find `excite` and other commands of this environment even where it is not activated
    kept["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), kept.get("PATH", os.defpath)])
    environment = {**kept, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    try:
        process = subprocess.run(
            shlex.split(command),
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=TIMEOUT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if process.returncode == 0:
        return ""
    return (process.stderr.strip().splitlines() or [f"exit {process.returncode}"])[-1]
