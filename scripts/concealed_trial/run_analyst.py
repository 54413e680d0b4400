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

from .base_model_fit import low_passed, read_recording, rms

TIMEOUT = 600.0
"""Time after which an analyst counts as having given no answer [s]."""
PREDICT_COMMAND = "{python} -m excite predict {model} {recording} -o {csv}"
"""Command that re-reads the analyst's model."""


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
    """Return the RMSE per joint of a model re-read by `excite predict`, below 20 Hz [N m].

    None where `excite predict` refuses the model.

    Args:
        model: The `model.json`.
        recording: The held-out recording.
        csv: File for the predicted torque.
    """
    words = {"python": sys.executable, "model": model, "recording": recording, "csv": csv}
    if _run_command(PREDICT_COMMAND.format(**words), csv.parent) or not csv.exists():
        return None
    measured = read_recording(recording)
    names = csv.read_text(encoding="utf-8").split("\n", 1)[0].strip().split(",")
    table = np.loadtxt(csv, delimiter=",", skiprows=1)
    torque = np.column_stack(
        [
            np.interp(measured.t, table[:, 0], table[:, names.index(f"tau.{joint}")])
            for joint in measured.joints
        ]
    )
    errors = rms(low_passed(measured.tau - torque, measured.t))
    return dict(zip(measured.joints, errors.tolist(), strict=True))


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
