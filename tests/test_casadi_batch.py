"""Compiled functions equal the interpreter, and faults of the cache fall back to it."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import QUICK, loaded, pendulum, random_urdf

from excite.designer import casadi_batch, casadi_model, optimize
from excite.designer.evaluator import Evaluator
from excite.robot import inertial_parameters, limits
from excite.robot.robot import load

needs_compiler = pytest.mark.skipif(
    casadi_batch.find_compiler() is None and not Path("/usr/bin/cc").exists(),
    reason="no C compiler",
)


@pytest.fixture
def cached(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("EXCITE_COMPILER", "cc")
    return tmp_path / "excite"


def build_functions(name: str) -> casadi_model.DynamicsFunctions:
    """Build the functions of a built-in robot, which begins their compilation."""
    robot = load(name)
    return casadi_model.dynamics_functions(
        robot,
        inertial_parameters.standard_parameters(
            robot, limits.resolve(robot), inertial_parameters.DRIVE
        ),
    )


def wait(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "timeout"
        time.sleep(0.01)


def wait_until_ready(library: casadi_batch.CompiledLibrary | None) -> casadi_batch.CompiledLibrary:
    assert library is not None
    wait(library.is_ready)
    return library


def arguments(functions: casadi_model.DynamicsFunctions, count: int) -> dict[str, list[np.ndarray]]:
    rng = np.random.default_rng(0)
    out = {}
    for name in ("regressor", "adjoint", "row"):
        blank = casadi_batch.MappedFunction(getattr(functions, name), count).inputs
        out[name] = [rng.normal(size=a.shape) for a in blank]
    return out


def results(
    functions: casadi_model.DynamicsFunctions, library: casadi_batch.CompiledLibrary | None
) -> list[np.ndarray]:
    """Evaluate all three functions at random arguments."""
    inputs = arguments(functions, 70)
    return [
        a.copy()
        for name, values in inputs.items()
        for a in casadi_batch.MappedFunction(getattr(functions, name), 70, library)(*values)
    ]


def are_equal(first: list[np.ndarray], second: list[np.ndarray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


@needs_compiler
def test_compiled_functions_equal_the_interpreter_bit_by_bit(cached):
    functions = build_functions("panda")
    interpreted = results(functions, None)
    library = wait_until_ready(functions.library)
    assert library.load("row") is not None and are_equal(results(functions, library), interpreted)
    inputs = arguments(functions, 70)["row"]
    assert are_equal(
        casadi_batch.PaddedFunction(functions.row, library)(*inputs),
        casadi_batch.MappedFunction(functions.row, 70)(*inputs),
    )


@needs_compiler
def test_cache_is_private_and_has_no_other_files(cached):
    wait_until_ready(build_functions("two_link").library)
    wait(lambda: not [path for path in cached.iterdir() if path.suffix == ".partial"])
    assert sorted(path.suffix for path in cached.iterdir()) == [".sha256", ".so"]
    assert stat.S_IMODE(cached.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in cached.iterdir()} == {0o600}


@needs_compiler
def test_library_replaces_the_interpreter_without_changing_results(cached):
    robot = load("two_link")
    setup = optimize.set_up(robot, limits.resolve(robot), QUICK)
    evaluator, x = Evaluator(setup.problem), np.full(setup.problem.size, 0.1)
    before = evaluator.objective(x, 1.0)
    wait_until_ready(setup.problem.functions.library)
    evaluator.objective(x + 1.0, 1.0)
    after = evaluator.objective(x, 1.0)
    assert before[0] == after[0]
    assert np.array_equal(before[1], after[1])
    assert optimize.set_up(
        robot, limits.resolve(robot), QUICK
    ).problem.functions.library.is_intact()  # from the cache


@pytest.mark.parametrize("value", ["", "no-such-compiler"])
def test_no_library_without_a_compiler(monkeypatch, value):
    monkeypatch.setenv("EXCITE_COMPILER", value)
    robot = loaded(pendulum())
    assert (
        casadi_model.dynamics_functions(
            robot, inertial_parameters.standard_parameters(robot, limits.resolve(robot), ())
        ).library
        is None
    )


def test_interpreter_is_used_where_the_compiler_fails(cached, monkeypatch):
    monkeypatch.setenv("EXCITE_COMPILER", "false")
    functions = build_functions("two_link")
    assert functions.library is not None
    wait(lambda: not list(cached.iterdir()))
    assert are_equal(results(functions, functions.library), results(functions, None))


def test_large_functions_are_not_compiled(cached):
    robot = loaded(random_urdf(np.random.default_rng(0), 45, kinds=("revolute",), tree=False))
    assert (
        casadi_model.dynamics_functions(
            robot,
            inertial_parameters.standard_parameters(
                robot, limits.resolve(robot), inertial_parameters.DRIVE
            ),
        ).library
        is None
    )


def test_interpreter_is_used_where_the_cache_cannot_be_written(cached):
    cached.parent.mkdir(exist_ok=True)
    cached.write_text("a file where the folder should be")
    assert build_functions("two_link").library is None


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701])
def test_cache_that_others_can_access_is_not_used(cached, mode):
    cached.mkdir()
    cached.chmod(mode)
    assert build_functions("two_link").library is None
    assert not list(cached.iterdir())


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files to others"
)
def test_cache_of_another_user_is_not_used(cached):
    cached.mkdir(mode=0o700)
    os.chown(cached, 12345, 12345)
    assert build_functions("two_link").library is None


def _garbage(path: Path) -> None:
    path.write_bytes(b"garbage")


def _truncated(path: Path) -> None:  # the loader would crash on it
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])


def _writable_by_others(path: Path) -> None:
    path.chmod(0o666)


def _owned_by_another_user(path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give files to others")
    os.chown(path, 12345, 12345)


def _link(path: Path) -> None:
    path.rename(path.with_suffix(".moved"))
    path.symlink_to(path.with_suffix(".moved"))


def _absent(path: Path) -> None:
    path.unlink()


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path, 0o600)


@needs_compiler
@pytest.mark.parametrize("suffix", [".so", ".sha256"])
@pytest.mark.parametrize(
    "damage",
    [_garbage, _truncated, _writable_by_others, _owned_by_another_user, _link, _absent, _pipe],
)
def test_damaged_library_is_compiled_again(cached, damage, suffix):
    functions = build_functions("two_link")
    expected, library = results(functions, None), wait_until_ready(functions.library)
    damage(next(path for path in cached.iterdir() if path.suffix == suffix))
    assert not library.is_intact() and library.load("row") is None
    assert are_equal(results(functions, library), expected)
    assert wait_until_ready(build_functions("two_link").library).load("row") is not None


@needs_compiler
def test_library_without_the_functions_is_not_used(cached, tmp_path):
    functions = build_functions("two_link")
    library = wait_until_ready(functions.library)
    (tmp_path / "other.c").write_text("int unrelated(void) { return 0; }")
    other = tmp_path / "other.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", str(tmp_path / "other.c"), "-o", str(other)], check=True
    )
    library.publish(other)
    assert library.is_intact() and library.load("row") is None
    assert are_equal(results(functions, library), results(functions, None))


@needs_compiler
def test_library_of_another_robot_is_not_used(cached):
    functions, others = build_functions("two_link"), build_functions("ur5e")
    library, other = wait_until_ready(functions.library), wait_until_ready(others.library)
    library.record.write_text(other.record.read_text())
    assert library.load("row") is not None
    assert are_equal(results(functions, library), results(functions, None))


NOEXEC = """
import os, time
import conftest  # which switches the compiler off
os.environ["EXCITE_COMPILER"] = "cc"
from test_casadi_batch import build_functions, are_equal, results
functions = build_functions("two_link")
until = time.monotonic() + 60.0
while not functions.library.is_ready():
    assert time.monotonic() < until
    time.sleep(0.01)
assert functions.library.is_intact() and functions.library.load("row") is None
assert are_equal(results(functions, functions.library), results(functions, None))
print("interpreted")
"""


@needs_compiler
def test_interpreter_is_used_where_the_file_system_forbids_execution(tmp_path):
    script = 'mount -t tmpfs -o noexec none "$XDG_CACHE_HOME" || exit 77; exec "$0" -c "$1"'
    command = ["unshare", "--mount", "/bin/sh", "-c", script, sys.executable, NOEXEC]
    if shutil.which("unshare") is None:
        pytest.skip("unshare is missing")
    path = os.pathsep.join(
        [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode in (1, 77) and "Traceback" not in done.stderr:
        pytest.skip("only root can mount file systems")
    assert done.stdout == "interpreted\n", done.stderr


# process of the compiler

SLOW = """#!/bin/sh
echo $$ > "$PIDS/$$"
sleep 1000 &
echo $! > "$PIDS/$!"
wait
"""
BUILD = """
import os, signal, sys, time
from excite.designer import casadi_model
from excite.robot import inertial_parameters, limits
from excite.robot.robot import load
robot = load("two_link")
standard = inertial_parameters.standard_parameters(robot, limits.resolve(robot), ())
functions = casadi_model.dynamics_functions(robot, standard)
assert functions.library is not None
until = time.monotonic() + 60.0
while len(os.listdir(os.environ["PIDS"])) < 2:
    assert time.monotonic() < until
    time.sleep(0.01)
if sys.argv[1] != "end":
    os.kill(os.getpid(), getattr(signal, sys.argv[1]))
"""


def _is_running(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("end", ["end", "SIGTERM", "SIGKILL"])
def test_compiler_ends_with_the_process_and_its_files_are_removed(
    cached, tmp_path, monkeypatch, end
):
    (tmp_path / "pids").mkdir()
    compiler = tmp_path / "slow-cc"
    compiler.write_text(SLOW)
    compiler.chmod(0o755)
    environment = os.environ | {"EXCITE_COMPILER": str(compiler), "PIDS": str(tmp_path / "pids")}
    subprocess.run([sys.executable, "-c", BUILD, end], env=environment, check=end == "end")
    pids = [int(path.name) for path in (tmp_path / "pids").iterdir()]
    assert len(pids) == 2
    wait(lambda: not any(_is_running(process) for process in pids), 10.0)
    if end == "end":
        assert not list(cached.iterdir())
    monkeypatch.setenv("EXCITE_COMPILER", "false")
    build_functions("ur5e")  # the next run, of any robot, removes the files
    wait(lambda: not list(cached.iterdir()))


def test_compiler_is_limited_in_time_and_memory(cached, tmp_path, monkeypatch):
    compiler = tmp_path / "reporting-cc"
    compiler.write_text(f"#!/bin/sh\n(ulimit -t; ulimit -v; ulimit -c) > '{tmp_path}/bounds'\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("EXCITE_COMPILER", str(compiler))
    assert build_functions("two_link").library is not None
    bounds = tmp_path / "bounds"
    wait(lambda: bounds.exists() and len(bounds.read_text().split()) == 3)
    assert bounds.read_text().split() == [
        str(casadi_batch.COMPILER_SECONDS),
        str(casadi_batch.COMPILER_KILOBYTES),
        "0",
    ]


def test_a_library_that_another_process_compiles_is_not_compiled_twice(
    cached, tmp_path, monkeypatch
):
    calls = tmp_path / "calls"
    compiler = tmp_path / "slow-cc"
    compiler.write_text(f"#!/bin/sh\necho called >> '{calls}'\nsleep 2\nexit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("EXCITE_COMPILER", str(compiler))
    first, second = build_functions("two_link").library, build_functions("two_link").library
    assert first is not None and first == second
    wait(calls.exists)
    wait(lambda: not list(cached.iterdir()))
    assert calls.read_text().split() == ["called"]


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_padding_changes_no_sample(count):
    robot = load("two_link")
    functions = casadi_model.dynamics_functions(
        robot, inertial_parameters.standard_parameters(robot, limits.resolve(robot), ())
    )
    inputs = arguments(functions, count)["row"]
    plain = [a.copy() for a in casadi_batch.MappedFunction(functions.row, count)(*inputs)]
    assert all(
        np.array_equal(a, b)
        for a, b in zip(casadi_batch.PaddedFunction(functions.row)(*inputs), plain, strict=True)
    )
