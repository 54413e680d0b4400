#!/usr/bin/env python
"""A trial that can't be cheated: conceal physics in simulated robots, let analysts answer from the recordings alone, open the key, score.

    scripts/concealed_trial run --quick -o out/quick
    scripts/concealed_trial run --family scored --cases 300 --seed 1 -o out/scored \\
        --analyst 'excite=excite diagnose {robot} {train} --validate {validate} {prior} -o {out}'

`run` is `conceal` (a process of its own), `answer` and `score`, one after the other; each goes on where it was interrupted.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

sys.path.insert(
    0, str(Path(__file__).resolve().parent.parent)
)  # to be run as `python scripts/concealed_trial`

from concealed_trial import baselines, run
from concealed_trial.case_plan import ROBOTS, Plan
from concealed_trial.run_analyst import BASELINES, Analyst, baseline_analysts
from excite.designer.cluster import BACKENDS, backend
from excite.errors import ExciteError, UnusableInput

QUICK = 24


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def analysts(arguments: argparse.Namespace) -> list[Analyst]:
    out = [] if arguments.no_baselines else [baseline_analysts()]
    for text in arguments.analyst:
        name, separator, command = text.partition("=")
        if not separator or not name.isidentifier() or name in BASELINES:
            raise UnusableInput(
                f"--analyst {text}: should read NAME=COMMAND, with a name of its own"
            )
        out.append(Analyst((name,), command))
    return out


def conceal(arguments: argparse.Namespace) -> None:
    plan = Plan(
        arguments.cases, arguments.seed, arguments.family, tuple(arguments.robots.split(","))
    )
    sealed = run.conceal(run.Place(arguments.out), plan, arguments.jobs, say)
    print(f"key sealed, sha256 {sealed}", flush=True)


def answer(arguments: argparse.Namespace) -> None:
    run.answer(run.Place(arguments.out), analysts(arguments), arguments.jobs, say)


def score(arguments: argparse.Namespace) -> None:
    print(run.report(run.Place(arguments.out)))


def everything(arguments: argparse.Namespace) -> None:
    analysts(arguments)  # a wrong --analyst is found before an hour of concealing
    words = sys.argv[1:]
    words[words.index("run")] = "conceal"
    done = subprocess.run([sys.executable, str(Path(__file__).parent), *words], check=False)
    if done.returncode != 0:
        raise UnusableInput(
            "the concealing process failed; see above, then run the same command again"
        )
    answer(arguments)
    score(arguments)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if sys.argv[1:2] == ["baselines"]:
        return baselines.main(sys.argv[2:])
    parser.add_argument("act", choices=("run", "conceal", "answer", "score"))
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--cases", type=int, metavar="N", help="default 300")
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"{QUICK} cases, for CI: at most five minutes on two cores",
    )
    parser.add_argument(
        "--family",
        choices=("tuning", "scored"),
        default="tuning",
        help="forms of the effects; default %(default)s",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="of the plan, with the family; default %(default)s",
    )
    parser.add_argument(
        "--robots", default=",".join(ROBOTS), metavar="A,B,…", help="default %(default)s"
    )
    parser.add_argument(
        "--analyst",
        action="append",
        default=[],
        metavar="NAME=COMMAND",
        help="see above; answers in diagnosis.json",
    )
    parser.add_argument("--no-baselines", action="store_true")
    parser.add_argument(
        "--jobs", type=int, default=-1, metavar="N", help="processes (default: one a core)"
    )
    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default="loky",
        help="joblib's; where cases are made and answered",
    )
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="of a Dask scheduler or Ray head that shares the folder DIR",
    )
    arguments = parser.parse_args()
    arguments.cases = arguments.cases or (QUICK if arguments.quick else 300)
    try:
        with backend(arguments.backend, arguments.cluster):
            {"run": everything, "conceal": conceal, "answer": answer, "score": score}[
                arguments.act
            ](arguments)
    except ExciteError as error:
        say(f"concealed_trial: {error}")
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
