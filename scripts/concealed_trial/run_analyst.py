"""Ask an analyst: one process per case, which sees a copy of the case's files and nothing else."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

BASELINES = ("greedy", "stribeck", "blackbox")
"""Names of the baseline analysts."""
TIMEOUT = 600.0
"""Time after which an analyst counts as having given no answer [s]."""


@dataclass(frozen=True)
class Analyst:
    """A command that answers cases.

    Attributes:
        names: Names of the answers that it gives, each in a file `<name>.json`; a single answer may
            be called `diagnosis.json`.
        command: Command with the placeholders {robot}, {train}, {validate}, {prior} ("--prior FILE"
            or nothing), {case} (folder of the case) and {out} (folder of the answers).
    """

    names: tuple[str, ...]
    command: str


def baseline_analysts() -> Analyst:
    """Return the three baselines, which answer in one process."""
    package = shlex.quote(str(Path(__file__).parent))
    return Analyst(
        BASELINES, f"{shlex.quote(sys.executable)} {package} baselines {{case}} -o {{out}}"
    )


def ask(analyst: Analyst, case: Path, answers: Path) -> float | None:
    """Let an analyst answer a case, unless it has already.

    The answer of a process that fails or writes nothing is `{"error": …}`, which counts as wrong.

    Args:
        analyst: The analyst.
        case: Folder of the case.
        answers: Folder of all answers.

    Returns:
        Time that the analyst took [s]; None where the answer exists already.
    """
    targets = {name: answers / name / f"{case.name}.json" for name in analyst.names}
    if all(path.exists() for path in targets.values()):
        return None
    with tempfile.TemporaryDirectory(prefix="case") as work:
        folder, out = Path(work) / "case", Path(work) / "out"
        shutil.copytree(case, folder)
        out.mkdir()
        prior = folder / "prior.json"
        words = {
            "robot": folder / "robot.urdf",
            "train": folder / "train.csv",
            "validate": folder / "validate.csv",
            "prior": f"--prior {prior}" if prior.exists() else "",
            "case": folder,
            "out": out,
        }
        start = time.perf_counter()
        fault = _run_command(analyst.command.format(**words), Path(work))
        seconds = time.perf_counter() - start
        for name, path in targets.items():
            written = next(
                (f for f in (out / f"{name}.json", out / "diagnosis.json") if f.exists()), None
            )
            document = (
                {"error": fault or "no diagnosis.json"}
                if written is None or fault
                else json.loads(written.read_text(encoding="utf-8"))
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            staged = path.with_suffix(".part")
            staged.write_text(
                json.dumps({"seconds": seconds, "answer": document}), encoding="utf-8"
            )
            staged.rename(path)
    return seconds


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
