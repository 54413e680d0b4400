"""Dependencies of the packages, light imports, and calls that the library must not contain."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import excite

PACKAGE = Path(excite.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))

# Order of the data flow: a package imports from itself and from earlier ones.
ORDER = (
    "errors",
    "_types",
    "physical_ranges",
    "_linear_algebra",
    "_system",
    "_json",
    "schemas",
    "robot",
    "trajectory",
    "collision",
    "designer",
    "recordings",
    "identification",
    "payload",
    "effects",
    "diagnosis",
    "exporters",
    "report",
    "simulator",
    "api",
    "__init__",
    "cli",
    "__main__",
)
INDEPENDENT = {"simulator": {"errors", "_types"}}
"""Package -> the packages that it may import: the simulated robot must not share code with the
identification."""


def module(path: Path) -> str:
    """Return the package that a file belongs to: the name of its folder, or its own."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return parts[0]


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported(path: Path) -> frozenset[str]:
    """Return the packages of excite that a file imports, in any scope."""
    depth = len(path.relative_to(PACKAGE).parts)
    known = {module(file) for file in FILES}
    out: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom) and (
            node.level == depth or (node.module or "").split(".")[0] == "excite"
        ):
            inner = (node.module or "").removeprefix("excite").strip(".")
            out |= {inner.split(".")[0]} if inner else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            out |= {
                alias.name.split(".")[1] for alias in node.names if alias.name.startswith("excite.")
            }
    return frozenset(out & known)


def loaded_by(*arguments: str) -> set[str]:
    """Return the top-level modules in memory after a run of a new interpreter."""
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def after(code: str) -> set[str]:
    return loaded_by(
        "-c", f"import sys; {code}; print(*{{name.split('.')[0] for name in sys.modules}})"
    )


def test_every_package_is_listed_in_the_order():
    assert {module(file) for file in FILES} <= set(ORDER)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_module_imports_from_a_later_package(path):
    here = ORDER.index(module(path))
    assert not {name for name in imported(path) if ORDER.index(name) > here}


def test_imports_are_detected():
    packages = imported(PACKAGE / "designer" / "ramps.py")
    assert {"errors", "robot", "trajectory"} <= packages


def test_no_cyclic_imports():
    graph = {
        name: set().union(*(imported(f) for f in FILES if module(f) == name)) - {name}
        for name in {module(f) for f in FILES}
    }
    while leaves := {name for name, needs in graph.items() if not needs & set(graph)}:
        graph = {name: needs for name, needs in graph.items() if name not in leaves}
    assert not graph


@pytest.mark.parametrize(
    "path", [file for file in FILES if module(file) in INDEPENDENT], ids=lambda path: path.name
)
def test_the_simulator_shares_no_code_with_the_identification(path):
    assert imported(path) - {module(path)} <= INDEPENDENT[module(path)]
    names = [
        alias.name if isinstance(n, ast.Import) else str(n.module)
        for n in ast.walk(tree(path))
        if isinstance(n, ast.Import) or (isinstance(n, ast.ImportFrom) and not n.level)
        for alias in n.names
    ]
    assert not {name.split(".")[0] for name in names} & {"excite", "pinocchio", "casadi"}


def test_only_the_public_interface_and_the_command_line_use_the_simulator():
    assert {module(file) for file in FILES if "simulator" in imported(file)} <= {
        "simulator",
        "api",
        "cli",
    }


def test_the_simulator_loads_no_other_package():
    modules = "[name for name in sys.modules if name.startswith('excite.')]"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys, excite.simulator.experiment; print(*{modules})"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert {name.split(".")[1] for name in done.stdout.split()} <= {"simulator", "errors", "_types"}


def test_designing_needs_no_plots_and_no_yaml():
    assert not {"matplotlib", "yaml", "argparse"} & after("import excite.designer.pipeline")


def test_the_interface_imports_no_packages_that_take_long():
    """Those that few functions need are imported by them: a command would start a second later."""
    packages = ("stats", "signal", "optimize", "interpolate", "spatial", "sparse", "ndimage")
    slow = {"matplotlib", "mujoco", *(f"scipy.{name}" for name in packages)}
    code = f"import sys; from excite.api import *; print(*{slow!r} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not done.stdout.split()


@pytest.mark.parametrize("name", ["argparse", "matplotlib", "yaml"])
def test_the_core_does_not_import_libraries_of_the_interface(name):
    """limits.py imports yaml in the function that reads a .yaml file."""
    core = [file for file in FILES if ORDER.index(module(file)) < ORDER.index("exporters")]
    tops = {file.name: tree(file).body for file in core}
    names = {
        f: [a.name for n in body if isinstance(n, ast.Import) for a in n.names]
        for f, body in tops.items()
    }
    assert not [f for f, imports in names.items() if name in {i.split(".")[0] for i in imports}]


@pytest.mark.parametrize("name", ["excite", "excite.errors", "excite.cli"])
def test_light_modules_stay_light(name):
    assert not {"casadi", "pinocchio", "matplotlib", "scipy", "numpy", "ruckig"} & after(
        f"import {name}"
    )


def test_help_needs_no_heavy_import():
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "excite", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    names = {line.rsplit("|", 1)[-1].strip().split(".")[0] for line in done.stderr.splitlines()}
    assert done.stdout.startswith("usage: excite")
    assert "argparse" in names and not {"casadi", "pinocchio", "matplotlib", "scipy"} & names


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_the_library_neither_swallows_exceptions_nor_prints(path):
    bare = [
        n.lineno
        for n in ast.walk(tree(path))
        if isinstance(n, ast.ExceptHandler)
        and (n.type is None or getattr(n.type, "id", "") in ("Exception", "BaseException"))
    ]
    prints = [
        n.lineno
        for n in ast.walk(tree(path))
        if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "print"
    ]
    name = path.relative_to(PACKAGE).as_posix()
    assert not bare or name == "_system/process.py"  # the outermost handler, which writes a log
    assert not prints or module(path) == "cli" or name == "_system/console.py"
