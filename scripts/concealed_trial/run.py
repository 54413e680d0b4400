"""The trial's three acts, each resumable at any case: conceal, answer, score."""

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

from . import commitment
from . import generate_cases as concealing
from . import run_analyst as answers
from .case_plan import Plan, Spec
from .run_analyst import Analyst
from .score import Mark, confusion, mark, score

MODELS = Path(str(resources.files("excite") / "robot" / "models"))
Say = Callable[[str], None]
BATCH = 24


@dataclass(frozen=True)
class Place:
    """Folders of a trial: what analysts are given, what they answered, and the key, out of their sight."""

    root: Path

    @property
    def cases(self) -> Path:
        return self.root / "cases"

    @property
    def key(self) -> Path:
        return self.root / "key"

    @property
    def answers(self) -> Path:
        return self.root / "answers"

    @property
    def sealed(self) -> Path:
        return self.root / "sealed.sha256"

    def names(self) -> list[str]:
        """Names of the concealed cases, in the order of their random names."""
        return sorted(
            path.name
            for path in self.cases.iterdir()
            if path.is_dir() and not path.name.startswith(".")
        )

    def log(self, text: str) -> None:
        """A line of the log, with the date: it is only ever appended to."""
        self.root.mkdir(parents=True, exist_ok=True)
        with (self.root / "log.txt").open("a", encoding="utf-8") as stream:
            stream.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {text}\n")


def conceal(place: Place, plan: Plan, jobs: int, say: Say) -> str:
    """Make the cases that are not there yet and bind the key; returns its hash, which is also published in `sealed.sha256`."""
    specs = plan.specs()
    missing = [spec for spec in specs if not (place.cases / spec.name).exists()]
    place.log(f"conceal: {len(missing)} of {len(specs)} cases of family {plan.family}")
    for number, taken in enumerate(
        _spread(_conceal_one, ((place, spec) for spec in missing), jobs), start=1
    ):
        say(f"concealed {number} of {len(missing)}, {taken:.1f} s")
    sealed = commitment.close(place.key, [spec.name for spec in specs])
    if place.sealed.exists() and place.sealed.read_text(encoding="utf-8").strip() != sealed:
        raise UnusableInput(
            f"{place.sealed}: another key was published here before; start a trial in a new folder"
        )
    place.sealed.write_text(sealed + "\n", encoding="utf-8")
    place.log(f"sealed: {sealed}")
    return sealed


def _conceal_one(place: Place, spec: Spec) -> float:
    start = time.perf_counter()
    concealing.write(
        concealing.bench(spec, MODELS), place.cases / spec.name, place.key / f"{spec.name}.json"
    )
    return time.perf_counter() - start


def answer(place: Place, analysts: Sequence[Analyst], jobs: int, say: Say) -> None:
    """Ask every analyst what it has not answered yet, a process a case. Raises UnusableInput before the key is sealed."""
    if not place.sealed.exists():
        raise UnusableInput(f"{place.root}: its key is not sealed yet; run 'conceal' first")
    work = [
        (analyst, place.cases / name, place.answers)
        for name in place.names()
        for analyst in analysts
    ]
    place.log(
        f"answer: {len(work)} questions to {', '.join(name for analyst in analysts for name in analyst.names)}"
    )
    for number, taken in enumerate(_spread(answers.ask, work, jobs), start=1):
        if taken is not None:
            say(f"answered {number} of {len(work)}, {taken:.1f} s")
    place.log("answered")


def _spread(task: Callable[..., Any], work: Iterable[tuple[Any, ...]], jobs: int) -> Iterable[Any]:
    """Results in the order of the work, batch by batch; where they are computed is joblib's configuration.

    Batches, because not every back end (Ray, multiprocessing) hands over results as they come, and an hour of silence is long.
    """
    todo = iter(work)
    with joblib.Parallel(n_jobs=jobs) as pool:
        while batch := list(islice(todo, BATCH)):
            yield from pool(joblib.delayed(task)(*one) for one in batch)


def marks(place: Place) -> dict[str, list[Mark]]:
    """Marks of every analyst that answered, once the key is open."""
    cases = commitment.unlock(place.key, place.sealed.read_text(encoding="utf-8").strip())
    out: dict[str, list[Mark]] = {}
    for folder in sorted(place.answers.iterdir()):
        paths = {path.stem: path for path in folder.glob("*.json")}
        lacking = set(cases) - set(paths)
        if lacking:
            raise UnusableInput(
                f"{folder}: {len(lacking)} cases are not answered yet, {min(lacking)} for one; run 'answer' again"
            )
        out[folder.name] = [
            mark(cases[name], json.loads(paths[name].read_text(encoding="utf-8")))
            for name in sorted(cases)
        ]
    return out


def report(place: Place) -> str:
    """Score, tables and pictures, written beside the answers; returns the table in Markdown."""
    from . import figures

    found = marks(place)
    scores = {name: score(of) for name, of in found.items()}
    tables = {name: confusion(of) for name, of in found.items()}
    text = table(scores)
    document = {
        "schema": "concealed_trial/1",
        "sealed": place.sealed.read_text(encoding="utf-8").strip(),
        "scores": scores,
        "confusion": tables,
    }
    (place.root / "score.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    (place.root / "score.md").write_text(text + "\n", encoding="utf-8")
    (place.root / "confusion.svg").write_text(figures.confusion(tables), encoding="utf-8")
    (place.root / "reliability.svg").write_text(
        figures.reliability({name: of["calibration"] for name, of in scores.items()}),
        encoding="utf-8",
    )
    place.log("scored")
    return text


ROWS = (
    ("false_alarms", "false alarms on nulls"),
    ("abstained", "abstains, or no answer, where something is hidden"),
    ("right_first", "right name first"),
    ("right_first_from_3", "… at severity ≥ 2, where 3, 10 or 30 was aimed at"),
    ("right_first_trusted", "… where a prior is trusted"),
    ("within_equivalents", "truth within the first and its equivalents"),
    ("equivalents", "… how many equivalents then"),
    ("right_joint", "right joint, where rightly named"),
    ("both_of_two", "both of two named"),
    ("unknown_where_it_is", "`unknown` where it is"),
    ("contact_overlap", "time interval of contacts, overlap"),
    ("parameter_error", "parameter error, median, relative"),
    ("interval_coverage", "parameter ± 2 std covers the truth"),
    ("held_out_gain", "held-out gain, oracle = 1, median"),
)


def table(scores: dict[str, dict[str, Any]]) -> str:
    """Markdown: a row per figure, a column per analyst; the 95 % interval of each rate, and the number of cases behind it, in brackets."""
    names = list(scores)
    lines = [f"| | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for key, words in ROWS:
        lines.append(f"| {words} | {' | '.join(_cell(scores[name][key]) for name in names)} |")
    for bounds in scores[names[0]]["right_first_by_severity"]:
        cells = (_cell(scores[name]["right_first_by_severity"][bounds]) for name in names)
        lines.append(f"| right name first, severity {bounds} | {' | '.join(cells)} |")
    errors = (scores[name]["calibration"]["error"] for name in names)
    lines.append(
        f"| calibration error | {' | '.join('–' if e is None else f'{e:.2f}' for e in errors)} |"
    )
    seconds = (scores[name]["seconds"] for name in names)
    lines.append(f"| seconds a case, median | {' | '.join(f'{s:.1f}' for s in seconds)} |")
    return "\n".join(lines)


def _cell(figure: dict[str, Any]) -> str:
    if figure["value"] is None:
        return "–"
    low, high = figure.get("interval", (None, None))
    spread = "" if low is None else f" [{low:.2f}–{high:.2f}]"
    return f"{figure['value']:.2f}{spread} ({figure['count']})"
