"""Tests marked `slow`, which pytest leaves out unless they are asked for: a plugin of pytest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

LEFT_OUT = pytest.StashKey[int]()
"""Number of slow tests that were left out."""
SELECTING_OPTIONS = ("all_tests", "markexpr", "keyword", "lf")
"""Options that select tests (`--all`, `-m`, `-k`, `--lf`): each of them decides alone."""


def slow(*values: object) -> Any:
    """Return parameters of a test that is slow with them."""
    return pytest.param(*values, marks=pytest.mark.slow)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option `--all`."""
    parser.addoption(
        "--all", action="store_true", dest="all_tests", help="run the slow tests too (marker slow)"
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out slow tests, except those of a file that the command line names."""
    if any(config.getoption(name, default=None) for name in SELECTING_OPTIONS):
        return
    paths = [Path(argument.partition("::")[0]).resolve() for argument in config.args]
    named = {path for path in paths if path.is_file()}
    slow = [item for item in items if item.get_closest_marker("slow") and item.path not in named]
    config.stash[LEFT_OUT] = len(slow)
    if slow:
        items[:] = [item for item in items if item not in set(slow)]
        config.hook.pytest_deselected(items=slow)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Send the number of tests left out from a worker of pytest-xdist, which alone collects."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = session.config.stash.get(LEFT_OUT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Receive the number of tests that a worker left out; all workers collect the same tests."""
    if "left_out" in getattr(node, "workeroutput", {}):
        node.config.stash[LEFT_OUT] = node.workeroutput["left_out"]


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Print how many slow tests were left out, and how to run them."""
    if count := config.stash.get(LEFT_OUT, 0):
        terminalreporter.write_line(
            f"{count} slow tests were left out; scripts/test --all runs them too"
        )
