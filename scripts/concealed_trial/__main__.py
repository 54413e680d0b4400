#!/usr/bin/env python
"""Test diagnoses blindly: hide physics in simulated robots, collect answers, then score them.

    scripts/concealed_trial run --quick -o out/quick
    scripts/concealed_trial conceal --groups dense,half_dense --cases 40 -o out/tuning
    scripts/concealed_trial run --family scored --cases 300 --seed 1 -o out/scored \\
        --analyst 'excite=excite diagnose {robot} {train} --validate {validate} {prior} -o {out}'

`run` executes `conceal` (in a process of its own), `answer` and `score` in turn. Each can be
interrupted and continues where it stopped when it is started again.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

sys.path.insert(
    0, str(Path(__file__).resolve().parent.parent)
)  # for `python scripts/concealed_trial`

from concealed_trial import run
from concealed_trial.case_plan import GROUPS, CasePlan
from concealed_trial.run_analyst import Analyst
from concealed_trial.score import BLIND
from excite.designer.cluster import BACKENDS, backend
from excite.errors import ExciteError, UnusableInput

QUICK_CASES = 24
"""Cases of `--quick`, of all groups: about five minutes on two cores."""
DEFAULT_CASES = 300
"""Cases without `--cases`: enough for 95 % intervals of ±6 % on the rates."""


def report_progress(text: str) -> None:
    """Print a line of progress to standard error."""
    print(text, file=sys.stderr, flush=True)


def parse_analysts(arguments: argparse.Namespace) -> list[Analyst]:
    """Return the analysts of `--analyst`."""
    analysts = []
    for text in arguments.analyst:
        name, separator, command = text.partition("=")
        if not separator or not name.isidentifier() or name == BLIND:
            raise UnusableInput(
                f"--analyst {text}: must read NAME=COMMAND; NAME must be an identifier "
                f"other than {BLIND}"
            )
        analysts.append(Analyst(name, command))
    return analysts


def parse_groups(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the groups of cases of `--groups`."""
    groups = tuple(arguments.groups.split(","))
    if unknown := set(groups) - set(GROUPS):
        raise UnusableInput(
            f"--groups {arguments.groups}: no group '{min(unknown)}'; they are {', '.join(GROUPS)}"
        )
    return groups


def conceal(arguments: argparse.Namespace) -> None:
    """Generate the cases and publish the hash of their ground truth."""
    plan = CasePlan(arguments.cases, arguments.seed, arguments.family, parse_groups(arguments))
    digest = run.conceal(run.TrialFolder(arguments.out), plan, arguments.jobs, report_progress)
    print(f"ground truth committed, sha256 {digest}", flush=True)


def answer(arguments: argparse.Namespace) -> None:
    """Ask all analysts."""
    run.answer(
        run.TrialFolder(arguments.out), parse_analysts(arguments), arguments.jobs, report_progress
    )


def score(arguments: argparse.Namespace) -> None:
    """Score all answers and print the table."""
    print(run.report(run.TrialFolder(arguments.out)))


def run_all(arguments: argparse.Namespace) -> None:
    """Conceal in a process of its own, then answer and score."""
    parse_analysts(arguments)  # refuse a wrong --analyst before an hour of simulation
    words = sys.argv[1:]
    words[words.index("run")] = "conceal"
    process = subprocess.run([sys.executable, str(Path(__file__).parent), *words], check=False)
    if process.returncode != 0:
        raise UnusableInput(
            "generating the cases failed; see the message above, then run the same command again"
        )
    answer(arguments)
    score(arguments)


def main() -> int:
    """Run the command line of the trial."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("step", choices=("run", "conceal", "answer", "score"))
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--cases", type=int, metavar="N", help=f"number of cases (default {DEFAULT_CASES})"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"{QUICK_CASES} cases, for CI: about five minutes on two cores",
    )
    parser.add_argument(
        "--family",
        choices=("tuning", "scored"),
        default="tuning",
        help="model forms of the hidden effects (default %(default)s)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="seed of the case plan (default %(default)s)",
    )
    parser.add_argument(
        "--groups",
        default=",".join(GROUPS),
        metavar="A,B,…",
        help="groups of cases (default %(default)s)",
    )
    parser.add_argument(
        "--analyst",
        action="append",
        default=[],
        metavar="NAME=COMMAND",
        help="command that writes diagnosis.json, see above; may be repeated",
    )
    parser.add_argument(
        "--jobs", type=int, default=-1, metavar="N", help="processes (default: one per core)"
    )
    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default="loky",
        help="joblib backend that generates and answers the cases",
    )
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="address of a Dask scheduler or Ray head that shares the folder DIR",
    )
    arguments = parser.parse_args()
    arguments.cases = arguments.cases or (QUICK_CASES if arguments.quick else DEFAULT_CASES)
    steps = {"run": run_all, "conceal": conceal, "answer": answer, "score": score}
    try:
        with backend(arguments.backend, arguments.cluster):
            steps[arguments.step](arguments)
    except ExciteError as error:
        report_progress(f"concealed_trial: {error}")
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
