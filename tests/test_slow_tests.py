"""Selection of the tests marked `slow`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FILE = """
import pytest

def test_quick():
    pass

@pytest.mark.slow
def test_slow():
    pass
"""
SETTINGS = "[tool.pytest.ini_options]\nmarkers = ['slow']\ntestpaths = ['.']\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two files, each of which has a quick and a slow test."""
    path = tmp_path_factory.mktemp("tests")
    (path / "pyproject.toml").write_text(SETTINGS)
    for name in ("test_a.py", "test_b.py"):
        (path / name).write_text(FILE)
    return path


def run(folder: Path, *arguments: str) -> tuple[set[str], str]:
    """Return file and name of the tests that pytest runs, and what it prints."""
    plugins = ["-p", "slow_tests", *(["-p", "xdist"] if "-n" in arguments else [])]
    command = [sys.executable, "-m", "pytest", "-rA", *plugins, *arguments]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env=os.environ
        | {"PYTHONPATH": str(Path(__file__).parent), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
    )
    passed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("PASSED ")]
    return {name.replace("test_", "").replace(".py::", " ") for name in passed}, done.stdout


QUICK, SLOW = {"a quick", "b quick"}, {"a slow", "b slow"}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((), QUICK),
        ((".",), QUICK),
        (("-n", "1"), QUICK),
        (("--all",), QUICK | SLOW),
        (("test_a.py",), {"a quick", "a slow"}),
        (("-n", "1", "test_a.py"), {"a quick", "a slow"}),
        (("test_a.py::test_slow", "."), {"a slow", *QUICK}),
        (("-k", "slow"), SLOW),
        (("-m", "slow", "test_a.py"), {"a slow"}),
        (("-m", "not slow", "--all"), QUICK),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_slow_tests_run_if_they_are_asked_for(
    folder: Path, arguments: tuple[str, ...], expected: set[str]
) -> None:
    passed, printed = run(folder, *arguments)
    assert passed == expected
    left_out = "2 slow tests were left out; scripts/test --all runs them too"
    assert (left_out in printed) is (expected == QUICK and "-m" not in arguments)
