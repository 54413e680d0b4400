"""The three steps of a trial, each resumable at any case: conceal, answer, score."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import islice
from pathlib import Path
from typing import Any

import joblib

from excite.errors import UnusableInput

from . import commitment, generate_cases, run_analyst, table
from .case_plan import CasePlan, CaseSpec
from .run_analyst import Analyst
from .score import BLIND, Mark, blind_answer, compare_answer, score

MODELS = Path(str(resources.files("excite") / "robot" / "models"))
"""Folder of the built-in robots."""
Progress = Callable[[str], None]
BATCH_SIZE = 24
"""Cases that are handed to the processes at once.

Not every joblib backend (Ray, multiprocessing) returns results as they come; batches keep progress
visible.
"""


@dataclass(frozen=True)
class TrialFolder:
    """Folders and files of a trial.

    Attributes:
        root: Folder of the trial.
    """

    root: Path

    @property
    def cases(self) -> Path:
        """Folder of the cases that analysts see."""
        return self.root / "cases"

    @property
    def key(self) -> Path:
        """Folder of the ground truth, which analysts do not see."""
        return self.root / "key"

    @property
    def answers(self) -> Path:
        """Folder of the answers."""
        return self.root / "answers"

    @property
    def commitment(self) -> Path:
        """File with the published hash of the ground truth."""
        return self.root / "commitment.sha256"

    def published_hash(self) -> str:
        """Return the published hash of the ground truth."""
        return self.commitment.read_text(encoding="utf-8").strip()

    def names(self) -> list[str]:
        """Return the random names of the cases, sorted."""
        return sorted(
            path.name
            for path in self.cases.iterdir()
            if path.is_dir() and not path.name.startswith(".")
        )

    def log(self, text: str) -> None:
        """Append a line with the date to `log.txt`."""
        self.root.mkdir(parents=True, exist_ok=True)
        with (self.root / "log.txt").open("a", encoding="utf-8") as stream:
            stream.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {text}\n")


def conceal(folder: TrialFolder, plan: CasePlan, jobs: int, progress: Progress) -> str:
    """Generate the missing cases and commit to their ground truth.

    Args:
        folder: Folder of the trial.
        plan: The cases.
        jobs: Number of processes.
        progress: Function that reports a line of progress.

    Returns:
        Hash of the ground truth, which is also published in `commitment.sha256`.

    Raises:
        UnusableInput: Another hash was published in this folder.
    """
    specs = plan.specs()
    missing = [spec for spec in specs if not (folder.cases / spec.name).exists()]
    folder.log(f"conceal: {len(missing)} of {len(specs)} cases of family {plan.family}")
    for number, seconds in enumerate(
        _in_parallel(_conceal_case, ((folder, spec) for spec in missing), jobs), start=1
    ):
        progress(f"concealed {number} of {len(missing)}, {seconds:.1f} s")
    digest = commitment.commit(folder.key, [spec.name for spec in specs])
    if folder.commitment.exists() and folder.published_hash() != digest:
        raise UnusableInput(
            f"{folder.commitment}: another ground truth was published here; "
            "start a trial in a new folder"
        )
    folder.commitment.write_text(digest + "\n", encoding="utf-8")
    folder.log(f"ground truth committed: {digest}")
    return digest


def _conceal_case(folder: TrialFolder, spec: CaseSpec) -> float:
    """Generate a case and return the time that it took [s]."""
    start = time.perf_counter()
    generate_cases.write_case(
        generate_cases.generate_case(spec, MODELS),
        folder.cases / spec.name,
        folder.key / f"{spec.name}.json",
    )
    return time.perf_counter() - start


def answer(folder: TrialFolder, analysts: Sequence[Analyst], jobs: int, progress: Progress) -> None:
    """Ask every analyst for the answers that are missing, one process per case.

    Raises:
        UnusableInput: The ground truth is not committed yet.
    """
    if not folder.commitment.exists():
        raise UnusableInput(
            f"{folder.root}: its ground truth is not committed yet; run 'conceal' first"
        )
    work = [
        (analyst, folder.cases / name, folder.answers)
        for name in folder.names()
        for analyst in analysts
    ]
    analyst_names = ", ".join(analyst.name for analyst in analysts)
    folder.log(f"answer: {len(work)} questions to {analyst_names}")
    for number, seconds in enumerate(_in_parallel(run_analyst.ask, work, jobs), start=1):
        if seconds is not None:
            progress(f"answered {number} of {len(work)}, {seconds:.1f} s")
    folder.log("answered")


def _in_parallel(
    task: Callable[..., Any], work: Iterable[tuple[Any, ...]], jobs: int
) -> Iterable[Any]:
    """Yield results in the order of the work, batch by batch, from joblib's configured backend."""
    remaining = iter(work)
    with joblib.Parallel(n_jobs=jobs) as pool:
        while batch := list(islice(remaining, BATCH_SIZE)):
            yield from pool(joblib.delayed(task)(*arguments) for arguments in batch)


def marks(folder: TrialFolder) -> dict[str, list[Mark]]:
    """Open the ground truth and return the marks of every analyst, the blind one included.

    Raises:
        UnusableInput: The ground truth is not the committed one, or answers are missing.
    """
    cases = commitment.open_ground_truth(folder.key, folder.published_hash())
    marks_by_analyst: dict[str, list[Mark]] = {}
    for analyst in sorted(folder.answers.iterdir()) if folder.answers.exists() else ():
        paths = {path.stem: path for path in analyst.glob("*.json")}
        missing = set(cases) - set(paths)
        if missing:
            raise UnusableInput(
                f"{analyst}: {len(missing)} cases are not answered yet (such as {min(missing)}); "
                "run 'answer' again"
            )
        marks_by_analyst[analyst.name] = [
            compare_answer(cases[name], json.loads(paths[name].read_text(encoding="utf-8")))
            for name in sorted(cases)
        ]
    marks_by_analyst[BLIND] = [compare_answer(case, blind_answer(case)) for case in cases.values()]
    return marks_by_analyst


def report(folder: TrialFolder) -> str:
    """Write score and table into the trial's folder; return the Markdown table."""
    scores = {name: score(of_analyst) for name, of_analyst in marks(folder).items()}
    text = table.table(scores)
    document = {
        "schema": "concealed_trial/3",
        "commitment": folder.published_hash(),
        "scores": scores,
    }
    (folder.root / "score.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    (folder.root / "score.md").write_text(text + "\n", encoding="utf-8")
    folder.log("scored")
    return text
