"""The URDF text of a robot's file: the file itself, an expanded xacro or a converted MJCF."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from ..errors import UnusableInput
from . import xml_file
from .mjcf import Conversion, convert_mjcf

SUBSTITUTION = re.compile(r"\$\{[^}]*\}|\$\((arg|find|eval|env|optenv|dirname|anon)\b")
"""Substitutions that only xacro understands."""
READ_ELEMENTS = ("link", "joint")
"""Children of <robot> that are read."""
IGNORED_ELEMENTS = ("visual",)
"""Elements inside these that are not."""
HELD = ("floating", "planar")
"""Types of joints of several degrees of freedom."""
HELD_TYPE = re.compile(rf"""(<joint\b[^>]*\stype\s*=\s*)(["'])(?:{"|".join(HELD)})\2""")
"""A joint's tag up to its type, if it is one of these."""
XACRO = "xacro"
"""Word that the prefix or the namespace of xacro's elements contains."""
INCLUDE = "include"
"""Name of the element by which xacro and MJCF include a file."""
DECLARED_XACRO = re.compile(r"""\sxmlns:xacro\s*=\s*["']([^"']*)""")
EXPANSION = """
import sys
from importlib.util import find_spec
if find_spec("resource"):  # not on Windows
    import resource
    resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[2]), int(sys.argv[2])))
from xacrodoc import XacroDoc
sys.stdout.reconfigure(encoding="utf-8")
print(XacroDoc.from_file(sys.argv[1], resolve_packages=False).to_urdf_string())
"""
"""Program that prints an expanded xacro. It runs in a process of its own, as a file's expressions
can fail in any way or never end, with -P, so that it imports no files of the current folder. It
bounds its own processor time in case that the process that waits for it is killed."""
LONGEST_EXPANSION = 60.0
"""Time after which an expansion is given up [s]; the largest descriptions take a few seconds."""
LONGEST_REASON = 300
"""Characters of xacro's own message that are repeated."""


def is_file(path: Path) -> bool:
    """Look up a path: true for a regular file, false for others and for names that are too long."""
    try:
        return path.is_file()
    except OSError:
        return False


def included_files(path: Path) -> list[Path]:
    """Return the files that a xacro file or an MJCF includes, directly and indirectly.

    Files of ROS packages, `$(find …)`, are left out: they are looked up when xacro expands them.

    Args:
        path: The robot's file; one that cannot be read includes none, and `read_robot` says why.
    """
    files, unread = list[Path](), [path]
    while unread:
        file = unread.pop()
        for name in _included_names(file):
            included = Path(os.path.realpath(file.parent / name))
            if included not in files:
                files.append(included)
                unread.append(included)
    return files


def read_urdf_text(path: Path) -> str:
    """Read the URDF text of a robot's file; see `read_robot`."""
    return read_robot(path).text


def read_robot(path: Path) -> Conversion:
    """Read a robot's file as URDF.

    Args:
        path: A URDF, a xacro file that the package xacrodoc expands, or an MJCF file that MuJoCo
            compiles.

    Raises:
        UnusableInput: The file is missing or in none of these formats, or the package that
            converts it is not installed.
    """
    if not is_file(path):
        if os.path.exists(path):
            raise UnusableInput(
                f"{path}: is a folder, a pipe or a device; write the robot's URDF to a file and "
                "give its path"
            )
        raise UnusableInput(
            f"{path}: no such file; give a URDF's path or a name that 'excite robots' lists"
        )
    status = path.stat()
    return _read_version(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _read_version(path: Path, modified: int, size: int) -> Conversion:
    """Read a version of a file, which its time of modification and its size tell from others."""
    raw = xml_file.without_default_namespace(xml_file.read_text(path, "a URDF"))
    if raw.strip() and not raw.lstrip("\ufeff \t\r\n").startswith("<"):
        raise UnusableInput(
            f"{path}: is not a URDF; first comes the robot's URDF or a name that 'excite robots' "
            "lists"
        )
    if path.suffix == ".xacro":
        return _held(path, _expanded(path))
    root = xml_file.parse_text(path, raw)
    if root.tag == "mujoco":
        return convert_mjcf(path)
    if root.tag != "robot":
        raise UnusableInput(
            f"{path}: its root is <{root.tag}>, not <robot>; give a URDF or an MJCF"
        )
    namespaces = {XACRO, *DECLARED_XACRO.findall(raw)}
    return _held(path, _expanded(path) if _is_xacro(root, namespaces) else raw)


def _included_names(path: Path) -> list[str]:
    """Names of the files that a file includes, as it states them."""
    if not is_file(path):
        return []
    try:
        text = xml_file.read_text(path, "a URDF")
        elements = xml_file.parse_text(path, text).iter() if INCLUDE in text else iter(())
    except UnusableInput:
        return []
    names = [
        element.get("filename") or element.get("file") or ""
        for element in elements
        if str(element.tag).rpartition("}")[2] == INCLUDE
    ]
    names = [name.replace("$(dirname)", str(path.parent.absolute())) for name in names]
    return [name for name in names if name and not SUBSTITUTION.search(name)]


def _held(path: Path, text: str) -> Conversion:
    """Fix the joints of several degrees of freedom where they begin, as the free joints of an
    MJCF."""
    root = xml_file.parse_text(path, text)
    remarks = (
        f"{path}: the {joint.get('type')} joint '{joint.get('name')}' is held: its link is fixed "
        "where it begins"
        for joint in root.findall("joint")
        if joint.get("type") in HELD
    )
    return Conversion(HELD_TYPE.sub(r"\1\2fixed\2", text), tuple(remarks))


def _is_xacro(root: ElementTree.Element, namespaces: set[str]) -> bool:
    """Look for macros in what is read of a URDF; leftovers elsewhere do no harm."""
    return any(
        _is_macro(child, namespaces)
        or (child.tag in READ_ELEMENTS and _has_macros(child, namespaces))
        for child in root
    )


def _is_macro(element: ElementTree.Element, namespaces: set[str]) -> bool:
    """True for an element of xacro's namespace."""
    namespace, closed, _ = str(element.tag).removeprefix("{").rpartition("}")
    return bool(closed) and (XACRO in namespace or namespace in namespaces)


def _has_macros(element: ElementTree.Element, namespaces: set[str]) -> bool:
    if any(SUBSTITUTION.search(value) for value in element.attrib.values()):
        return True
    return any(
        _is_macro(child, namespaces) or _has_macros(child, namespaces)
        for child in element
        if child.tag not in IGNORED_ELEMENTS
    )


def _expanded(path: Path) -> str:
    """Expand a xacro file.

    Raises:
        UnusableInput: The package xacrodoc is not installed, or cannot expand the file.
    """
    name = path.name.removesuffix(".xacro").removesuffix(".urdf") + ".urdf"
    if name == path.name:
        name = f"{path.stem}_expanded.urdf"
    if find_spec("xacrodoc") is None:
        raise UnusableInput(
            f"{path}: is a xacro file; expand it first: xacro {path.name} > {name}, or install "
            "what expands it: .venv/bin/pip install -e '.[xacro]'"
        )
    seconds = str(round(2.0 * LONGEST_EXPANSION))
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", EXPANSION, str(path.resolve()), seconds],
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=LONGEST_EXPANSION,
            check=False,
        )
        reason = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        if done.returncode == 0:
            return done.stdout
    except subprocess.TimeoutExpired:
        reason = [f"it takes more than {LONGEST_EXPANSION:g} s"]
    raise UnusableInput(
        f"{path}: xacro cannot expand it ({reason[0][:LONGEST_REASON]}); expand it with its "
        f"arguments: xacro {path.name} name:=value > {name}"
    )
