"""Asking an analyst: one process a case, which sees a copy of the case's files and nothing else."""

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
PATIENCE = 600.0
"""After this an analyst has no answer [s]."""


@dataclass(frozen=True)
class Analyst:
    """names: of the answers it gives, one file `<name>.json` each (or `diagnosis.json`, where it gives one).

    command: with {robot}, {train}, {validate}, {prior} ("--prior FILE" or nothing), {case} (the folder), {out}.
    """

    names: tuple[str, ...]
    command: str


def baseline_analysts() -> Analyst:
    """The three baselines, in one process."""
    return Analyst(
        BASELINES,
        f"{shlex.quote(sys.executable)} {shlex.quote(str(Path(__file__).parent))} baselines {{case}} -o {{out}}",
    )


def ask(analyst: Analyst, case: Path, answers: Path) -> float | None:
    """Let an analyst answer a case unless it has; returns the seconds it took, None where the answer was there.

    A process that fails or says nothing leaves an answer that says so: no answer is an answer, and a wrong one.
    """
    targets = {name: answers / name / f"{case.name}.json" for name in analyst.names}
    if all(path.exists() for path in targets.values()):
        return None
    with tempfile.TemporaryDirectory(prefix="case") as place:
        folder, out = Path(place) / "case", Path(place) / "out"
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
        fault = _run(analyst.command.format(**words), Path(place))
        taken = time.perf_counter() - start
        for name, path in targets.items():
            found = next(
                (f for f in (out / f"{name}.json", out / "diagnosis.json") if f.exists()), None
            )
            document = (
                {"error": fault or "no diagnosis.json"}
                if found is None or fault
                else json.loads(found.read_text(encoding="utf-8"))
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            staged = path.with_suffix(".part")
            staged.write_text(json.dumps({"seconds": taken, "answer": document}), encoding="utf-8")
            staged.rename(path)
    return taken


def _run(command: str, place: Path) -> str:
    """Run in a bare environment; returns what went wrong, or nothing."""
    kept = {
        key: os.environ[key]
        for key in ("PATH", "HOME", "LANG", "VIRTUAL_ENV", "PYTHONPATH")
        if key in os.environ
    }
    # the commands of this environment, `excite` for one, whether or not it is activated
    kept["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), kept.get("PATH", os.defpath)])
    environment = {**kept, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            shlex.split(command),
            cwd=place,
            env=environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return (
        ""
        if done.returncode == 0
        else (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]
    )
