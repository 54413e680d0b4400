from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from conftest import QUICK, loaded, pendulum

from excite.designer import casadi_batch, casadi_model, optimize
from excite.designer.evaluator import Evaluator
from excite.robot import inertial_parameters, limits
from excite.robot.robot import load

needs_compiler = pytest.mark.skipif(
    casadi_batch.compiler() is None and not Path("/usr/bin/cc").exists(),
    reason="no C compiler here",
)


@pytest.fixture
def cached(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("EXCITE_COMPILER", "cc")
    return tmp_path / "excite"


def arrived(path: Path, seconds: float = 60.0) -> Path:
    until = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < until, "the compiler never came back"
        time.sleep(0.01)
    return path


def arguments(functions: casadi_model.DynamicsFunctions, count: int) -> dict[str, list[np.ndarray]]:
    rng = np.random.default_rng(0)
    out = {}
    for name in ("regressor", "adjoint", "row"):
        blank = casadi_batch.Mapped(getattr(functions, name), count).inputs
        out[name] = [rng.normal(size=a.shape) for a in blank]
    return out


@needs_compiler
def test_compiled_functions_equal_the_virtual_machine_bit_by_bit(cached):
    robot = load("panda")
    functions = casadi_model.dynamics_functions(
        robot, inertial_parameters.standard(robot, limits.resolve(robot), inertial_parameters.DRIVE)
    )
    given = arguments(functions, 70)
    slow = {
        name: [a.copy() for a in casadi_batch.Mapped(getattr(functions, name), 70)(*values)]
        for name, values in given.items()
    }
    arrived(functions.library)
    for name, values in given.items():
        for maker in (
            casadi_batch.Mapped(getattr(functions, name), 70, functions.library),
            casadi_batch.Padded(getattr(functions, name), functions.library),
        ):
            assert all(
                np.array_equal(a, b) for a, b in zip(maker(*values), slow[name], strict=True)
            ), name
    assert [path.suffix for path in cached.iterdir()] == [".so"]  # nothing else is left behind


@needs_compiler
def test_the_library_takes_over_without_a_trace_while_an_evaluator_runs(cached):
    robot = load("two_link")
    setting = optimize.set_up(robot, limits.resolve(robot), QUICK)
    evaluator, x = Evaluator(setting.problem), np.full(setting.problem.size, 0.1)
    before = evaluator.objective(x, 1.0)
    arrived(setting.problem.functions.library)
    evaluator.objective(x + 1.0, 1.0)
    after = evaluator.objective(x, 1.0)
    assert before[0] == after[0]
    assert np.array_equal(before[1], after[1])
    assert optimize.set_up(
        robot, limits.resolve(robot), QUICK
    ).problem.functions.library.exists()  # found again


@pytest.mark.parametrize("value", ["", "no-such-compiler"])
def test_without_a_compiler_there_is_no_library(monkeypatch, value):
    monkeypatch.setenv("EXCITE_COMPILER", value)
    robot = loaded(pendulum())
    assert (
        casadi_model.dynamics_functions(
            robot, inertial_parameters.standard(robot, limits.resolve(robot), ())
        ).library
        is None
    )


def test_a_compiler_that_fails_leaves_the_virtual_machine(cached, monkeypatch):
    monkeypatch.setenv("EXCITE_COMPILER", "false")
    robot = load("two_link")
    functions = casadi_model.dynamics_functions(
        robot, inertial_parameters.standard(robot, limits.resolve(robot), ())
    )
    assert functions.library is not None
    given = arguments(functions, 3)["regressor"]
    assert np.isfinite(
        casadi_batch.Mapped(functions.regressor, 3, functions.library)(*given)[0]
    ).all()
    time.sleep(0.3)
    assert not functions.library.exists()


def test_a_folder_that_cannot_be_written_leaves_the_virtual_machine(cached, monkeypatch):
    cached.parent.mkdir(exist_ok=True)
    cached.write_text("a file where the folder should be")
    robot = load("two_link")
    assert (
        casadi_model.dynamics_functions(
            robot, inertial_parameters.standard(robot, limits.resolve(robot), ())
        ).library
        is None
    )


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_padding_changes_no_sample(count):
    robot = load("two_link")
    functions = casadi_model.dynamics_functions(
        robot, inertial_parameters.standard(robot, limits.resolve(robot), ())
    )
    given = arguments(functions, count)["row"]
    plain = [a.copy() for a in casadi_batch.Mapped(functions.row, count)(*given)]
    assert all(
        np.array_equal(a, b)
        for a, b in zip(casadi_batch.Padded(functions.row)(*given), plain, strict=True)
    )
