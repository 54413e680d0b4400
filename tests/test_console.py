"""Standard error of a command, the logger of the package, and shell completion."""

from __future__ import annotations

import logging
import shutil
import subprocess
import sys

import pytest

import excite
from excite.cli.main import main

ROBOT = ("two_link", "--starts", "1", "--iterations", "5", "--harmonics", "2", "--samples", "30")


def test_library_reports_progress_through_its_logger(caplog, capfd):
    with caplog.at_level(logging.INFO, logger="excite"):
        excite.design("two_link", starts=1, iterations=5, harmonics=2, samples=30)
    messages = [record.getMessage() for record in caplog.records if record.name == "excite"]
    assert any(message.startswith("start 1/1") for message in messages)
    assert capfd.readouterr() == ("", "")


def test_library_is_silent_without_a_handler(capfd):
    excite.design("two_link", starts=1, iterations=5, harmonics=2, samples=30)
    assert capfd.readouterr() == ("", "")


def test_progress_function_replaces_the_logger(caplog):
    lines: list[str] = []
    with caplog.at_level(logging.INFO, logger="excite"):
        excite.design(
            "two_link", starts=1, iterations=5, harmonics=2, samples=30, progress=lines.append
        )
    assert lines and not caplog.records


@pytest.mark.parametrize(("option", "expected"), [((), True), (("--quiet",), False)])
def test_command_shows_progress_on_standard_error(tmp_path, capsys, option, expected):
    assert main(["design", *ROBOT, "-o", str(tmp_path / "out"), *option]) == 0
    printed = capsys.readouterr()
    assert ("start 1/1" in printed.err) == expected and "start 1/1" not in printed.out


def test_verbose_progress_has_the_time(tmp_path, capsys):
    assert main(["design", *ROBOT, "-o", str(tmp_path / "out"), "--verbose"]) == 0
    assert all(" s  " in line for line in capsys.readouterr().err.splitlines())


def test_command_leaves_the_logger_as_it_was(tmp_path):
    logger = logging.getLogger("excite")
    before = logger.level, list(logger.handlers)
    assert main(["robots"]) == 0
    assert (logger.level, list(logger.handlers)) == before


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_script_knows_commands_and_options(shell, capsys):
    pytest.importorskip("shtab")
    assert main(["--print-completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(word in script for word in ("identifiability", "torque-noise", "urscript"))


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [("excite des", "design"), ("excite export --format ros2-f", "ros2-follow-joint-trajectory")],
)
def test_bash_completes_commands_and_formats(words, expected, capsys, tmp_path):
    pytest.importorskip("shtab")
    assert main(["--print-completion", "bash"]) == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out, encoding="utf-8")
    count = len(words.split()) - 1
    commands = (
        f"source {script}; COMP_WORDS=({words}); COMP_CWORD={count}; "
        '_shtab_excite; echo "${COMPREPLY[@]}"'
    )
    done = subprocess.run(["bash", "-c", commands], capture_output=True, text=True, check=False)
    assert done.stdout.split() == [expected], done.stderr


def test_help_does_not_import_the_completion_library():
    code = (
        "import sys; from excite.cli.parser import parser; parser(); print('shtab' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
