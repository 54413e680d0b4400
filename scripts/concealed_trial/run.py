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

from . import commitment, generate_cases, run_analyst
from .case_plan import CasePlan, CaseSpec
from .run_analyst import Analyst
from .score import Mark, compare_answer, confusion, score

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
    analyst_names = ", ".join(name for analyst in analysts for name in analyst.names)
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
    """Open the ground truth and return the marks of every analyst.

    Raises:
        UnusableInput: The ground truth is not the committed one, or answers are missing.
    """
    cases = commitment.open_ground_truth(folder.key, folder.published_hash())
    marks_by_analyst: dict[str, list[Mark]] = {}
    for analyst in sorted(folder.answers.iterdir()):
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
    return marks_by_analyst


def report(folder: TrialFolder) -> str:
    """Write score, tables and figures into the trial's folder; return the Markdown table."""
    from . import figures

    marks_by_analyst = marks(folder)
    scores = {name: score(of_analyst) for name, of_analyst in marks_by_analyst.items()}
    tables = {name: confusion(of_analyst) for name, of_analyst in marks_by_analyst.items()}
    text = table(scores)
    document = {
        "schema": "concealed_trial/2",
        "commitment": folder.published_hash(),
        "scores": scores,
        "confusion": tables,
    }
    (folder.root / "score.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    (folder.root / "score.md").write_text(text + "\n", encoding="utf-8")
    (folder.root / "confusion.svg").write_text(figures.confusion(tables), encoding="utf-8")
    (folder.root / "reliability.svg").write_text(
        figures.reliability({name: figure["calibration"] for name, figure in scores.items()}),
        encoding="utf-8",
    )
    folder.log("scored")
    return text


ROWS = (
    ("false_alarms", "false alarms where nothing is hidden"),
    ("abstained", "no finding, or no answer, where something is hidden"),
    ("right_first", "right effect first"),
    ("right_first_from_3", "… at severity ≥ 2 (targets 3, 10 and 30)"),
    ("right_first_trusted", "… where a prior is trusted"),
    ("within_equivalents", "truth among the first effect and its equivalents"),
    ("equivalents", "… number of equivalents then"),
    ("right_joint", "right joint, where the effect is right"),
    ("both_of_two", "both of two effects named"),
    ("unknown_where_it_is", "`unknown` where the effect is not in the catalogue"),
    ("contact_overlap", "overlap of the time interval of contacts"),
    ("parameter_error", "relative parameter error, median"),
    ("interval_coverage", "parameter ± 2 std covers the truth"),
    ("held_out_gain", "held-out gain, oracle = 1, median"),
)
"""Rows of the table: key of the score and its words."""


def table(scores: dict[str, dict[str, Any]]) -> str:
    """Return a Markdown table with a row per figure and a column per analyst.

    Each rate has its 95 % interval and the number of cases.
    """
    names = list(scores)
    lines = [f"| | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for key, words in ROWS:
        lines.append(f"| {words} | {' | '.join(_cell(scores[name][key]) for name in names)} |")
    for bounds in scores[names[0]]["right_first_by_severity"]:
        cells = (_cell(scores[name]["right_first_by_severity"][bounds]) for name in names)
        lines.append(f"| right effect first, severity {bounds} | {' | '.join(cells)} |")
    errors = (scores[name]["calibration"]["error"] for name in names)
    lines.append(
        f"| calibration error | {' | '.join('–' if e is None else f'{e:.2f}' for e in errors)} |"
    )
    seconds = (scores[name]["seconds"] for name in names)
    lines.append(f"| seconds per case, median | {' | '.join(f'{s:.1f}' for s in seconds)} |")
    return "\n".join(lines)


def _cell(figure: dict[str, Any]) -> str:
    """Return a value with its interval and count, as a cell of the table."""
    if figure["value"] is None:
        return "–"
    low, high = figure.get("interval", (None, None))
    spread = "" if low is None else f" [{low:.2f}–{high:.2f}]"
    return f"{figure['value']:.2f}{spread} ({figure['count']})"
