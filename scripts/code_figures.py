"""Print lines of code, share of docstrings and import times of `excite/`, now and at a commit.

    python scripts/code_figures.py [--against COMMIT] [--runs 10]

Lines are those of the Python files of the package. A line of a docstring (also of an attribute or a
constant) or of a comment counts as such; the share of docstrings is relative to all lines that are
not blank. Times are processor times of a new interpreter, the smallest of some runs, including the
start of Python. The default commit, f38fb8d, is the last one before the package got its present
layout.
"""

from __future__ import annotations

import argparse
import ast
import io
import os
import resource
import subprocess
import sys
import tarfile
import tempfile
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BEFORE = "f38fb8d"
"""Last commit before the present layout of the package."""
STARTS = {
    "python": ("-c", "pass"),
    "import excite": ("-c", "import excite"),
    "import excite.design": ("-c", "import excite; excite.design"),
    "excite --help": ("-m", "excite", "--help"),
}
"""Arguments of the interpreter whose time is measured, by the name of the row."""


def line_kinds(source: str) -> Counter[str]:
    """Return the numbers of lines of code, docstrings, comments and blank lines."""
    lines = source.splitlines()
    kinds = ["code" if line.strip() else "blank" for line in lines]
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and token.line.lstrip().startswith("#"):
            kinds[token.start[0] - 1] = "comment"
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            for number in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                kinds[number - 1] = "docstring"
    return Counter(kinds)


def statements(source: str) -> int:
    """Return the number of statements without docstrings: it does not depend on line lengths."""
    return sum(
        isinstance(node, ast.stmt)
        and not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        for node in ast.walk(ast.parse(source))
    )


def package_lines(package: Path) -> Counter[str]:
    """Return the numbers of lines and statements of all files of a package, and of files."""
    counts: Counter[str] = Counter()
    for path in package.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        counts += line_kinds(source)
        counts["statements"] += statements(source)
        counts["files"] += 1
    return counts


def processor_time() -> float:
    """Return the processor time of all child processes that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def start_time(checkout: Path, arguments: tuple[str, ...], runs: int) -> float | None:
    """Return the least processor time of an interpreter [s]; None if it fails."""
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    shortest = float("inf")
    for _ in range(runs):
        begun = processor_time()
        done = subprocess.run(
            [sys.executable, *arguments],
            env=environment,
            cwd=checkout,
            capture_output=True,
            check=False,
        )
        if done.returncode != 0:
            return None
        shortest = min(shortest, processor_time() - begun)
    return shortest


def column(checkout: Path, runs: int) -> dict[str, str]:
    """Return the figures of a checkout in words, by the name of the row."""
    counts = package_lines(checkout / "excite")
    text = counts["code"] + counts["docstring"] + counts["comment"]
    out = {f"{kind} lines": f"{counts[kind]:,}" for kind in ("code", "docstring", "comment")}
    out["blank lines"] = f"{counts['blank']:,}"
    out["docstrings, share of all lines that are not blank"] = (
        f"{100 * counts['docstring'] / text:.0f} %"
    )
    out["statements"] = f"{counts['statements']:,}"
    out["files"] = str(counts["files"])
    for name, arguments in STARTS.items():
        seconds = start_time(checkout, arguments, runs)
        out[f"`{name}` [s]"] = "–" if seconds is None else f"{seconds:.2f}"
    return out


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--against", default=BEFORE, metavar="COMMIT", help="commit to compare with (%(default)s)"
    )
    parser.add_argument(
        "--runs", type=int, default=10, metavar="N", help="runs per time (default %(default)s)"
    )
    arguments = parser.parse_args()
    archive = subprocess.run(
        ["git", "archive", arguments.against, "excite"], cwd=ROOT, capture_output=True, check=True
    ).stdout
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(archive)) as files:
            files.extractall(folder, filter="data")
        before, now = column(Path(folder), arguments.runs), column(ROOT, arguments.runs)
    print(f"| | {arguments.against} | now |\n|---|---:|---:|")
    for name, value in now.items():
        print(f"| {name} | {before[name]} | {value} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
