"""Faults of streams, signals, memory and unexpected errors: exit codes and at most one line."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest
from slow_tests import slow

import excite

TRAJECTORY = Path(excite.__file__).parent.parent / "trajectories" / "two_link.json"
QUICK = ["--starts", "1", "--iterations", "15", "--harmonics", "3", "--samples", "60"]
PROGRAM = [sys.executable, "-c", "import sys\nfrom excite.__main__ import main\nsys.exit(main())"]


def run(
    *arguments: object, shell: str = "", cwd: Path | None = None, **environment: str | None
) -> subprocess.CompletedProcess[bytes]:
    """Run the program.

    shell: redirections. environment: variables; None removes one.
    """
    variables = {k: v for k, v in (os.environ | environment).items() if v is not None}
    command = ["/bin/sh", "-c", f'"$@" {shell}', "sh", *PROGRAM, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, env=variables, cwd=cwd, check=False)


def lines(done: subprocess.CompletedProcess[bytes]) -> list[str]:
    """Return the lines on standard error except progress and warnings."""
    text = done.stderr.decode()
    assert "Traceback" not in text and "Exception ignored" not in text, text
    return [line for line in text.splitlines() if line.startswith("excite: ")]


# -- standard streams ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "encoding", ["latin1", slow("ascii"), "utf-16", slow("cp437"), "ascii:strict"]
)
def test_standard_output_in_any_encoding(encoding: str) -> None:
    done = run("verify", TRAJECTORY, PYTHONIOENCODING=encoding)
    assert done.returncode == 0 and not lines(done)
    assert "certified" in done.stdout.decode(encoding.partition(":")[0])


@pytest.mark.parametrize("encoding", [slow("latin1"), "ascii"])
def test_a_document_does_not_depend_on_the_encoding(encoding: str) -> None:
    done, other = (
        run("verify", TRAJECTORY, "--json", PYTHONIOENCODING=e) for e in (encoding, "utf-8")
    )
    assert done.stdout == other.stdout and json.loads(done.stdout)["ok"]


def test_a_design_is_printed_in_latin1(tmp_path: Path) -> None:
    done = run("design", "two_link", "-o", tmp_path / "o", *QUICK, PYTHONIOENCODING="latin1")
    assert (
        done.returncode == 0
        and b"ramp_in ? fourier" in done.stdout
        and len(list((tmp_path / "o").iterdir())) == 4
    )


CLOSED_STREAMS = (">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-", "2>/dev/full")
COMMANDS = {
    "text": (["verify", TRAJECTORY], 0),
    "json": (["verify", TRAJECTORY, "--json"], 0),
    "refused": (["verify", "no.json"], 2),
    "help": (["--help"], 0),
    "wrong-use": (["bogus"], 2),
}
"""By name: a command and its exit code."""


@pytest.mark.parametrize(
    ("redirection", "command", "code"),
    [
        pytest.param(
            redirection,
            *command,
            id=f"{name}-{redirection}",
            marks=[pytest.mark.slow] * (name in ("json", "refused") and redirection != ">&-"),
        )
        for name, command in COMMANDS.items()
        for redirection in CLOSED_STREAMS
    ],
)
def test_closed_streams_change_no_exit_code(
    redirection: str, command: list[object], code: int
) -> None:
    done = run(*command, shell=redirection)
    assert done.returncode == code
    assert len(lines(done)) == (code == 2 and redirection == ">&-")
    is_closed = any(part == ">&-" for part in redirection.split())
    assert bool(done.stdout) is (code == 0 and not is_closed)


def test_output_of_libraries_does_not_reach_files_if_standard_output_is_closed(
    tmp_path: Path,
) -> None:
    done = run("design", "two_link", "-o", tmp_path / "o", *QUICK, shell="<&- >&- 2>&-")
    assert done.returncode == 0
    assert (
        json.loads((tmp_path / "o" / "trajectory.json").read_text())["schema"]
        == "excite.trajectory/1"
    )
    assert (tmp_path / "o" / "report.html").read_text().startswith("<!")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize(
    "command", [["verify", TRAJECTORY], ["verify", TRAJECTORY, "--json"], ["--help"], ["--version"]]
)
def test_a_full_standard_output_is_one_line(command: list[object]) -> None:
    done = run(*command, shell=">/dev/full")
    assert done.returncode == 2
    assert lines(done) == [
        "excite: standard output cannot be written (No space left on device); send it elsewhere"
    ]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_standard_output_after_a_design_names_the_written_files(tmp_path: Path) -> None:
    done = run("design", "two_link", "-o", tmp_path / "o", *QUICK, shell=">/dev/full")
    (line,) = lines(done)
    assert done.returncode == 2 and all(str(path) in line for path in (tmp_path / "o").iterdir())


@pytest.mark.parametrize("command", [["robots"], ["verify", TRAJECTORY, "--json"], ["--help"]])
def test_a_closed_pipe_is_no_error(command: list[object]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb") as stream:
        done = subprocess.run(
            [*PROGRAM, *map(str, command)], stdout=stream, stderr=subprocess.PIPE, check=False
        )
    assert (done.returncode, done.stderr) == (0, b"")


# -- environment -----------------------------------------------------------------------------------


@pytest.mark.parametrize("home", [None, *map(slow, ("", "relative", "absent", "/dev/null"))])
def test_commands_run_without_a_home_directory(tmp_path: Path, home: str | None) -> None:
    home = str(tmp_path / "absent") if home == "absent" else home
    done = run(
        "design",
        "two_link",
        "-o",
        "o",
        *QUICK,
        cwd=tmp_path,
        HOME=home,
        XDG_CACHE_HOME=None,
        EXCITE_COMPILER="cc",
    )
    assert done.returncode == 0 and not lines(done) and len(list((tmp_path / "o").iterdir())) == 4
    assert not list(tmp_path.rglob("excite"))


def test_file_names_that_are_not_utf_8(tmp_path: Path) -> None:
    folder = os.fsdecode(bytes(tmp_path) + b"/o\xff")
    robot = os.fsdecode(bytes(tmp_path) + b"/r\xff.urdf")
    Path(robot).write_bytes(
        (Path(excite.__file__).parent / "robot" / "models" / "two_link.urdf").read_bytes()
    )
    done = run("design", robot, "-o", folder, "--json", *QUICK)
    document = json.loads(done.stdout.decode("utf-8"))
    assert done.returncode == 0 and document["files"][0].encode().endswith(
        "/o\N{REPLACEMENT CHARACTER}/trajectory.json".encode()
    )
    assert len(os.listdir(folder)) == 4
    for name in os.listdir(folder):
        (Path(folder) / name).read_bytes().decode("utf-8")
    done = run("verify", f"{folder}/trajectory.json", "--robot", robot, PYTHONIOENCODING="ascii")
    assert done.returncode == 0
    done = run("verify", f"{folder}/no.json")
    assert done.returncode == 2 and len(lines(done)) == 1


# -- errors ----------------------------------------------------------------------------------------

FAULT = """
import sys
from excite.cli import robots as command
from excite.cli.main import main

def robots(arguments):
    {fault}

command.run = robots
sys.exit(main(["robots"]))
"""


def faulty(
    fault: str, tmp_path: Path, shell: str = "", **environment: str | None
) -> subprocess.CompletedProcess[bytes]:
    """Run a command that raises an unexpected error."""
    before = (
        os.environ
        | {"XDG_STATE_HOME": str(tmp_path / "state"), "TMPDIR": str(tmp_path)}
        | environment
    )
    variables = {k: v for k, v in before.items() if v is not None}
    command = [
        "/bin/sh",
        "-c",
        f'{shell} exec "$0" -c "$1"',
        sys.executable,
        FAULT.format(fault=fault),
    ]
    return subprocess.run(command, capture_output=True, env=variables, check=False)


def log_of(done: subprocess.CompletedProcess[bytes]) -> Path:
    (line,) = lines(done)
    match = re.search(r"its log is (\S+)$", line)
    assert done.returncode == 70 and done.stdout == b"" and match, line
    return Path(match[1])


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("raise ValueError('first\\nsecond')", "ValueError: first second"),
        ("robots(arguments)", "RecursionError"),
        ("raise MemoryError", "out of memory"),
        ("raise UnicodeDecodeError('utf-8', bytes(1), 0, 1, 'nothing')", "UnicodeDecodeError"),
        ("raise BrokenPipeError(32, 'of another process')", "BrokenPipeError"),
        ("return 0, {1: object()}, object()", "TypeError|AttributeError|object"),
    ],
)
def test_an_unexpected_error_is_one_line_and_a_log(tmp_path: Path, fault: str, words: str) -> None:
    if fault.startswith("return"):
        fault = "arguments.json = True; " + fault
    done = faulty(fault, tmp_path)
    (line,) = lines(done)
    log = log_of(done)
    assert re.search(words, line)
    assert log.parent == tmp_path / "state" / "excite"
    assert (
        stat.S_IMODE(log.parent.stat().st_mode) == 0o700
        and stat.S_IMODE(log.stat().st_mode) == 0o600
    )
    text = log.read_text()
    assert (
        "Traceback" in text
        and "excite 'robots'" in text
        and f"excite {excite.__version__}" in text
        and "numpy" in text
    )


@pytest.mark.parametrize("home", ["/dev/null", "/proc/none"])
def test_without_a_state_directory_the_log_is_a_temporary_file(tmp_path: Path, home: str) -> None:
    done = faulty("1 / 0", tmp_path, XDG_STATE_HOME=home)
    assert log_of(done).parent == tmp_path and "ZeroDivisionError" in log_of(done).read_text()
    done = faulty("1 / 0", tmp_path, XDG_STATE_HOME=None, HOME=home)
    assert log_of(done).parent == tmp_path


def test_a_state_directory_that_others_can_read_gets_no_log(tmp_path: Path) -> None:
    (tmp_path / "state" / "excite").mkdir(parents=True, mode=0o755)
    (tmp_path / "state" / "excite").chmod(0o755)
    assert log_of(faulty("1 / 0", tmp_path)).parent == tmp_path


def test_without_a_writable_directory_the_line_states_that_there_is_no_log(tmp_path: Path) -> None:
    done = faulty("1 / 0", tmp_path, "ulimit -f 0;", HOME="/dev/null", XDG_STATE_HOME="/dev/null")
    (line,) = lines(done)
    assert (
        done.returncode == 70
        and "ZeroDivisionError" in line
        and line.endswith("no log of it could be written")
    )


def test_exhausted_memory_is_one_line(tmp_path: Path) -> None:
    done = faulty("import numpy; numpy.ones(10**12)", tmp_path)
    (line,) = lines(done)
    assert (
        done.returncode == 70
        and line.startswith("excite: out of memory (")
        and "use fewer samples" in line
    )
    assert "MemoryError" in log_of(done).read_text()


def test_an_error_after_writing_names_the_written_files(tmp_path: Path) -> None:
    fault = "from excite._system.output_files import output_files; from pathlib import Path; "
    fault += f"output_files(Path({str(tmp_path / 'x')!r})).replace({{'x': ''}}); 1 / 0"
    (line,) = lines(faulty(fault, tmp_path))
    assert line.endswith(f"files that were written before: {tmp_path / 'x'}")


# -- limits of the system --------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="the default back end elsewhere is loky")
def test_processes_that_cannot_be_started_are_refused(tmp_path: Path) -> None:
    """The processes that were started end, too."""
    arguments = ["--starts", "24", "--jobs", "24", "-o", str(tmp_path / "out")]
    limited = ["bash", "-c", 'ulimit -n 32; exec "$@"', "bash", *PROGRAM]
    command = [*limited, "design", "two_link", *arguments]
    done = subprocess.run(command, capture_output=True, timeout=120, check=False)
    (line,) = lines(done)
    assert done.returncode == 2 and "24 processes" in line and "--jobs 1" in line, line
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="opens all files that it may")
def test_an_unexpected_error_without_a_free_file_is_one_line(tmp_path: Path) -> None:
    fault = "import os, builtins; builtins.kept = [os.open('/dev/null', 0) for _ in range(10**6)]"
    done = faulty(fault, tmp_path)
    (line,) = lines(done)
    assert done.returncode == 70 and "Too many open files" in line


# -- signals ---------------------------------------------------------------------------------------


def started(
    tmp_path: Path, *arguments: object, program: list[str] = PROGRAM
) -> subprocess.Popen[bytes]:
    command = [*program, *map(str, arguments)]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=tmp_path,
        start_new_session=True,
    )


def ended(process: subprocess.Popen[bytes]) -> subprocess.CompletedProcess[bytes]:
    out, err = process.communicate(timeout=60)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


DESIGN = ["design", "two_link", "--starts", "40", "--jobs", "2", "-o", "out"]


@pytest.mark.parametrize(
    ("number", "to_group"),
    [
        (signal.SIGINT, True),
        slow(signal.SIGINT, False),
        slow(signal.SIGTERM, True),
        (signal.SIGTERM, False),
        slow(signal.SIGHUP, True),
        slow(signal.SIGHUP, False),
    ],
    ids=lambda value: ("group" if value else "process") if isinstance(value, bool) else value.name,
)
def test_a_signal_ends_a_design_and_its_workers(
    tmp_path: Path, number: signal.Signals, to_group: bool
) -> None:
    process = started(tmp_path, *DESIGN)
    assert process.stderr is not None
    while b"start 1/40" not in (line := process.stderr.readline()):  # the workers are running
        assert line
    (os.killpg if to_group else os.kill)(process.pid, number)
    done = ended(process)
    word = "interrupted" if number == signal.SIGINT else "terminated"
    assert done.returncode == 1 and lines(done) == [f"excite: {word}; nothing was written"]
    assert b"resource_tracker" not in done.stderr
    assert not list(tmp_path.iterdir())
    if Path("/proc").is_dir():
        assert not workers(process)


def workers(process: subprocess.Popen[bytes], seconds: float = 10.0) -> list[str]:
    """Return the worker processes of a process that has ended."""
    until = time.monotonic() + seconds
    while True:
        children = []
        for path in Path("/proc").glob("[0-9]*"):
            try:
                status = (path / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(status[3]) == process.pid and status[0] != "Z":  # of the same session
                children.append(path.name)
        if not children or time.monotonic() > until:
            return children
        time.sleep(0.05)


@pytest.mark.skipif(sys.platform != "linux", reason="PR_SET_PDEATHSIG is Linux's")
def test_workers_end_with_a_killed_process(tmp_path: Path) -> None:
    process = started(tmp_path, *DESIGN)
    assert process.stderr is not None
    while b"start 1/40" not in (line := process.stderr.readline()):
        assert line
    process.kill()
    ended(process)
    assert not workers(process)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("backend", ["multiprocessing", slow("loky")])
def test_a_killed_worker_ends_a_design(tmp_path: Path, backend: str) -> None:
    """As the system does where memory is short."""
    process = started(tmp_path, *DESIGN, "--backend", backend)
    assert process.stderr is not None
    while b"start 1/40" not in (line := process.stderr.readline()):
        assert line
    os.kill(max(int(number) for number in workers(process, 0.0)), signal.SIGKILL)
    done = ended(process)
    assert done.returncode == 70 and "--jobs 1" in lines(done)[-1]
    assert not list(tmp_path.iterdir()) and not workers(process)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems need not have the limit")
def test_the_processor_time_of_an_expansion_is_bounded(tmp_path: Path) -> None:
    """If its parent is killed, no one ends a xacro that never ends."""
    urdf = Path(excite.__file__).parent / "robot" / "models" / "two_link.urdf"
    (tmp_path / "xacrodoc.py").write_text(
        "import resource\nfrom pathlib import Path\n"
        "assert resource.getrlimit(resource.RLIMIT_CPU)[1] != resource.RLIM_INFINITY\n"
        "class XacroDoc:\n"
        "    from_file = classmethod(lambda kind, path, resolve_packages: kind())\n"
        f"    to_urdf_string = lambda self: Path({str(urdf)!r}).read_text()\n"
    )
    (tmp_path / "arm.urdf.xacro").write_text("<robot name='arm'/>")
    path = os.pathsep.join([str(tmp_path), str(Path(excite.__file__).parent.parent)])
    done = run("check", tmp_path / "arm.urdf.xacro", PYTHONPATH=path)
    assert done.returncode == 0, done.stderr.decode()


@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask is not installed")
def test_a_cluster_that_accepts_connections_but_never_answers_is_refused(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = "tcp://127.0.0.1:{1}".format(*server.getsockname())
        done = ended(started(tmp_path, *DESIGN, "--cluster", address))
    assert done.returncode == 2 and "does not answer" in lines(done)[-1]
    assert not list(tmp_path.iterdir())


ANNOUNCED = [
    sys.executable,
    "-c",
    "import sys\nfrom excite.cli.main import main\nprint('ready', file=sys.stderr, flush=True)\n"
    "sys.exit(main())",
]
"""Program that reports when Python has started: before, it cannot handle signals."""


@pytest.mark.parametrize("delay", [0.05, 0.2, 0.4, 0.7, 1.0])
def test_a_signal_during_the_start_of_a_command(tmp_path: Path, delay: float) -> None:
    process = started(tmp_path, *DESIGN, program=ANNOUNCED)
    assert process.stderr is not None and process.stderr.readline() == b"ready\n"
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    done = ended(process)
    assert done.returncode == 1 and lines(done) == ["excite: interrupted; nothing was written"]


WRITING = """
import os, signal, sys
count = 0

def hook(event, arguments):
    global count
    renames = event == "os.rename" and ".partial" in str(arguments[0])
    exchanges = event == "ctypes.dlsym" and arguments[1] in ("renameat2", "renamex_np")
    if renames or exchanges:
        count += 1
        if count == 1:
            os.kill(os.getpid(), signal.SIGINT)

sys.addaudithook(hook)
from excite.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize("exists", [slow(False), True])
def test_a_signal_during_the_replacement_of_files_is_delayed(tmp_path: Path, exists: bool) -> None:
    if exists:
        assert (
            run("identifiability", "two_link", TRAJECTORY, "-o", tmp_path / "out").returncode == 0
        )
    command = [
        sys.executable,
        "-c",
        WRITING,
        "identifiability",
        "two_link",
        str(TRAJECTORY),
        "-o",
        "out",
    ]
    done = subprocess.run(command, capture_output=True, cwd=tmp_path, check=False)
    (line,) = lines(done)
    assert done.returncode == 1
    files = "out/identifiability.json, out/report.html"
    assert line == f"excite: interrupted after all files were written: {files}"
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "identifiability.json",
        "report.html",
    }
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_ignored_signals_stay_ignored(tmp_path: Path) -> None:
    """As with `nohup` and background jobs of a shell."""
    command = ["/bin/sh", "-c", 'trap "" INT HUP; exec "$@"', "sh", *PROGRAM, "robots"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    for _ in range(5):
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGHUP)
    done = ended(process)
    assert done.returncode == 0 and b"ur10e" in done.stdout


def test_a_calling_program_keeps_its_signal_handlers() -> None:
    from excite.cli.main import main

    before = [signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)]
    streams = sys.stdout, sys.stderr
    assert main(["--version"]) == 0
    assert [signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)] == before
    assert (sys.stdout, sys.stderr) == streams
