"""Every script starts: its imports exist and its options are described."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "scripts"
SCRIPTS = sorted(
    path for path in FOLDER.glob("*.py") if "argparse" in path.read_text(encoding="utf-8")
)
"""Scripts with options; the others run at once."""
HELP = """
import contextlib, io, json, runpy, sys, traceback
folder, *scripts = sys.argv[1:]
sys.path.insert(0, folder)
endings = {}
for script in scripts:
    sys.argv = [script, "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            runpy.run_path(script, run_name="__main__")
            endings[script] = "it did not end after its help"
        except SystemExit as ending:
            endings[script] = out.getvalue() if not ending.code else f"exit code {ending.code}"
        except BaseException:
            endings[script] = traceback.format_exc()
print(json.dumps(endings))
"""
"""Program that runs all scripts, so that each library is imported once."""


@pytest.fixture(scope="module")
def endings() -> dict[str, str]:
    """Help of each script, or why there is none."""
    command = [sys.executable, "-c", HELP, str(FOLDER), *map(str, SCRIPTS)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    endings: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return endings


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_the_help_of_a_script_is_printed(script, endings):
    assert endings[str(script)].startswith("usage:"), endings[str(script)]
