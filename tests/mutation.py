"""Seeded mutations of valid inputs: robots, recordings, documents and options.

`make_case(valid, seed)` returns a command line and the files that it reads, one of them damaged;
the same seed gives the same case. `run` executes cases in forked processes and reports every one
that ends in a way no command may end, a crash of the process included.

To add a kind of document, enter it in COMMANDS, with the names of the valid files that its commands
read, and its mutator in MUTATORS. Run as a script, the module tries other seeds than the tests:
`python tests/mutation.py FIRST COUNT [KIND…]`.
"""

# ruff: noqa: PLR0911, PLR0912
from __future__ import annotations

import contextlib
import copy
import io
import json
import os
import pickle
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from excite.cli import main as cli
from excite.cli.option_types import NUMERIC, NamedNumbers, Number, Numbers, WordOrNumbers
from excite.cli.parser import parser
from excite.physical_ranges import Range

NUMBERS = (
    "nan", "-nan", "inf", "-inf", "Infinity", "NaN", "1e308", "-1e308", "1e-320", "1e400", "-1",
    "0", "-0.0", "1e-12", "1e12", "3", "0.5", "1e6", "9" * 400, "", " ", "x", "0x10", "1_000",
    "1,5", "1;5", "--", "true", "null", "٣", "1e", "+", "1/2", "{}", "[1]",
)  # fmt: skip
"""Texts to stand where a number stands."""
WORDS = (
    "",
    " ",
    "x",
    "joint_1",
    "link_2",
    "tip",
    "é",
    "$x_{$",
    "a,b",
    "a\tb",
    "a\nb",
    "\u202e",
    "<b>",
    "%s",
    "../x",
    "{}",
    "'",
    '"',
    "\\",
    "A" * 300,
)
"""Texts to stand where a name stands."""
VALUES: tuple[object, ...] = (
    None, True, False, 0, -1, 1, 2.5, 1e308, -1e308, 1e-320, float("nan"), float("inf"), 10**400,
    10**18, "", "x", "joint_1", "NaN", [], {}, [[]], [None], [1], [1, 2], [1, 2, 3], [1e308] * 3,
    {"x": 1}, {"joint_1": 1}, {"joint_1": None}, {"value": -1}, "A" * 1000,
)  # fmt: skip
"""Values to stand anywhere in a JSON document."""
SECONDS = 60
"""A case that takes longer than this has failed."""
MEMORY = 6 << 30
"""Largest address space of the process that runs cases [bytes]."""


@dataclass(frozen=True)
class Case:
    """A command line and the files that it reads.

    Attributes:
        argv: words, in which {name} stands for the path of a file of that name and {out} for the
            path of the output.
        damage: description of the damage, for the failure message.
    """

    seed: int
    kind: str
    argv: tuple[str, ...]
    files: Mapping[str, bytes]
    damage: str


@dataclass
class Failure:
    """A case that ended in a way that no command may end, and the reason."""

    case: Case
    reason: str
    detail: str = ""

    def __str__(self) -> str:
        return (
            f"seed {self.case.seed} ({self.case.kind}; {self.case.damage}): {self.reason}\n"
            f"  excite {' '.join(self.case.argv)}\n{self.detail}"
        )


# -- texts -----------------------------------------------------------------------------------------


def text(rng: random.Random, content: bytes) -> tuple[bytes, str]:
    """Damage a text without regard to what it says."""
    data = bytearray(content)
    at = rng.randrange(max(len(data), 1))
    span = min(rng.choice((1, 3, 30, 300, 3000)), len(data) - at)
    match rng.randrange(8):
        case 0:
            return bytes(data[:at]), f"cut at {at}"
        case 1:
            return bytes(data[:at] + data[at + span :]), f"{span} bytes at {at} removed"
        case 2:
            return bytes(
                data[: at + span] + data[at : at + span] + data[at + span :]
            ), f"{span} bytes at {at} twice"
        case 3:
            for _ in range(rng.choice((1, 1, 5, 50))):
                data[rng.randrange(len(data))] = rng.randrange(256)
            return bytes(data), "bytes changed"
        case 4:
            codec = rng.choice(("utf-16", "utf-32", "utf-8-sig", "utf-16-le"))
            return content.decode("utf-8", "replace").encode(codec), codec
        case 5:
            return content.replace(
                b"\n", rng.choice((b"\r", b"\r\n", b"\n\n", b"\x00\n", b""))
            ), "other line ends"
        case 6:
            word = rng.choice((*NUMBERS, *WORDS, "\x00", "\ufeff", "\ud7ff", "#", "//")).encode()
            return bytes(data[:at] + word + data[at:]), f"{word[:40]!r} inserted at {at}"
    return number_in(rng, content)


def number_in(rng: random.Random, content: bytes) -> tuple[bytes, str]:
    """Put another text in the place of a number."""
    places = list(re.finditer(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])", content))
    if not places:
        return content + b"1", "a number appended"
    place, word = rng.choice(places), rng.choice(NUMBERS)
    return content[: place.start()] + word.encode() + content[
        place.end() :
    ], f"{place[0].decode()} became {word[:40]!r}"


def json_document(rng: random.Random, content: bytes) -> tuple[bytes, str]:
    """Change a value somewhere in a JSON document; now and then the text itself."""
    if rng.random() < 0.15:
        return text(rng, content)
    document = json.loads(content)
    path, parent, key = "", None, None
    node: object = document
    for _ in range(rng.randrange(1, 8)):
        if isinstance(node, dict) and node:
            parent, key = node, rng.choice(list(node))
        elif isinstance(node, list) and node:
            parent, key = node, rng.randrange(len(node))
        else:
            break
        path, node = f"{path}/{key}", parent[key]  # type: ignore[index]
    if parent is None:
        return json.dumps(rng.choice(VALUES)).encode(), "another document"
    match rng.randrange(8):
        case 0:
            del parent[key]
            done = "removed"
        case 1 if isinstance(parent, list):
            parent.insert(key, copy.deepcopy(parent[key]))
            done = "twice"
        case 1 | 2 if isinstance(parent, dict):
            parent[rng.choice((*WORDS, "unknown"))] = parent.pop(key)
            done = "renamed"
        case 3 if isinstance(node, (int, float)) and not isinstance(node, bool):
            parent[key] = rng.choice(
                (-node, 1e3 * node, 1e-3 * node, node + 1, 1e30 * node, 1e-30 * node)
            )
            done = f"scaled to {parent[key]}"
        case 4:
            for _ in range(rng.choice((100, 5000))):
                node = [node]
            return re.sub(
                rb'"@"', b"[" * 5000 + b"]" * 5000, _with(document, parent, key, "@")
            ), f"{path} nested"
        case _:
            parent[key] = rng.choice(VALUES)
            done = f"became {str(parent[key])[:40]}"
    return json.dumps(document).encode(), f"{path} {done}"


def _with(document: object, parent: object, key: object, value: object) -> bytes:
    parent[key] = value  # type: ignore[index]
    return json.dumps(document).encode()


def toml_document(rng: random.Random, content: bytes) -> tuple[bytes, str]:
    """Change a line, a name or a number of a TOML or YAML document."""
    if rng.random() < 0.3:
        return text(rng, content)
    if rng.random() < 0.5:
        return number_in(rng, content)
    lines = content.split(b"\n")
    at = rng.randrange(len(lines))
    match rng.randrange(4):
        case 0:
            del lines[at]
        case 1:
            lines.insert(at, lines[at])
        case 2:
            word = rng.choice(WORDS).encode()
            lines[at] = re.sub(rb"\w+", lambda _: word, lines[at], count=1)
        case 3:
            lines.insert(
                at,
                rng.choice(
                    (
                        b"unknown = 1",
                        b"[unknown]",
                        b"[[box]]",
                        b"x = [[[[]]]]",
                        b"a.b.c = {}",
                        b"joints = 3",
                        b"\x00",
                    )
                ),
            )
    return b"\n".join(lines), f"line {at + 1} changed"


# -- robots ----------------------------------------------------------------------------------------


def robot(rng: random.Random, content: bytes) -> tuple[bytes, str]:
    """Change an element or an attribute of a URDF; now and then the text itself."""
    if rng.random() < 0.15:
        return text(rng, content)
    root = ElementTree.fromstring(content)
    pairs = [(parent, child) for parent in root.iter() for child in parent]
    parent, child = rng.choice(pairs)
    name = f"<{child.tag} {child.attrib}>"[:80]
    match rng.randrange(8):
        case 0:
            parent.remove(child)
            done = "removed"
        case 1:
            parent.append(copy.deepcopy(child))
            done = "twice"
        case 2:
            other = rng.choice(pairs)[0]
            other.append(copy.deepcopy(child))
            done = f"put into <{other.tag}> too"
        case 3:
            child.tag = rng.choice(
                ("link", "joint", "mesh", "robot", "mimic", "inertial", "x", "{ns}x")
            )
            done = f"became <{child.tag}>"
        case _ if child.attrib:
            key = rng.choice(list(child.attrib))
            done = f"{key} became {_attribute(rng, child, key)[:60]!r}"
        case _:
            child.set(
                rng.choice(("name", "type", "value", "xyz", "scale")),
                rng.choice(WORDS).replace("\x00", ""),
            )
            done = "got an attribute"
    return ElementTree.tostring(root), f"{name} {done}"


def _attribute(rng: random.Random, element: ElementTree.Element, key: str) -> str:
    value = element.attrib[key]
    words = value.split()
    match rng.randrange(5):
        # a number as a name would look like a number of the output
        case _ if key in ("name", "link", "filename"):
            new = rng.choice(WORDS)
        case 0:
            new = rng.choice(WORDS)
        case 1 if key == "type":
            new = rng.choice(
                ("fixed", "prismatic", "continuous", "floating", "planar", "revolute", "x")
            )
        case 2:
            del element.attrib[key]
            return "nothing"
        case 3 if len(words) > 1:
            new = " ".join(words[:-1])
        case _:
            words = words or [""]
            words[rng.randrange(len(words))] = rng.choice(NUMBERS)
            new = " ".join(words)
    element.set(key, new)
    return new


def mesh(rng: random.Random, content: bytes) -> tuple[bytes, str]:
    """Damage a mesh: numbers of a text, bytes of anything."""
    return number_in(rng, content) if rng.random() < 0.5 else text(rng, content)


# -- recordings ------------------------------------------------------------------------------------


def table(rng: random.Random, content: bytes) -> tuple[bytes, str]:
    """Change cells, rows or columns of a CSV; now and then the text itself."""
    if rng.random() < 0.2:
        return text(rng, content)
    rows = [line.split(b",") for line in content.strip().split(b"\n")]
    row, column = rng.randrange(len(rows)), rng.randrange(len(rows[0]))
    name = rows[0][column].decode()
    match rng.randrange(12):
        case 0 | 1:
            rows[row][column] = rng.choice(NUMBERS).encode()
            done = f"cell {row + 1}, {name} became {rows[row][column][:40]!r}"
        case 2:
            word = rng.choice(NUMBERS).encode()
            for cells in rows[1:]:
                cells[column] = word
            done = f"column {name} became {word[:40]!r}"
        case 3:
            factor = rng.choice((-1.0, 0.0, 1e-9, 1e3, 1e9, 57.3, 1e100))
            for cells in rows[1:]:
                cells[column] = b"%r" % (factor * float(cells[column]))
            done = f"column {name} times {factor}"
        case 4:
            for cells in rows:
                del cells[column]
            done = f"column {name} removed"
        case 5:
            for cells in rows:
                cells.append(cells[column])
            done = f"column {name} twice"
        case 6:
            rows[0][column] = rng.choice(
                (*WORDS, "t", "q.joint_1", "q.joint_9", "tau.joint_1")
            ).encode()
            done = f"column {name} renamed {rows[0][column][:40]!r}"
        case 7:
            count = rng.choice((0, 1, 2, 10, 40))
            rows = rows[: count + 1]
            done = f"{count} rows left"
        case 8:
            body = rows[1:]
            rng.shuffle(body)
            rows = [rows[0], *(body if rng.random() < 0.5 else body[::-1])]
            done = "rows shuffled"
        case 9:
            count = rng.choice((1, 50))
            rows[row : row + 1] = [rows[row]] * count
            done = f"row {row + 1} {count + 1} times"
        case 10:
            rows[row] = rows[row][: rng.randrange(len(rows[row]) + 1)]
            done = f"row {row + 1} cut"
        case _:
            separator = rng.choice((b";", b"\t", b" ", b",,", b'","', b"|"))
            return b"\n".join(
                separator.join(cells) for cells in rows
            ), f"separated by {separator!r}"
    return b"\n".join(b",".join(cells) for cells in rows) + b"\n", done


class _Mark:
    """An object that, when it is unpickled, creates a file that `run` detects."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str, str]]:
        return open, ("PICKLE_WAS_LOADED", "w")


def archive(rng: random.Random, content: bytes) -> tuple[bytes, str]:
    """Change an array of an .npz archive, or its bytes."""
    if rng.random() < 0.4:
        return text(rng, content)
    with np.load(io.BytesIO(content)) as opened:
        arrays = {name: opened[name] for name in opened.files}
    name = rng.choice(list(arrays))
    match rng.randrange(7):
        case 0:
            del arrays[name]
            done = "removed"
        case 1:
            arrays[name] = arrays[name][: rng.choice((0, 1, 5, 300))]
            done = f"cut to {len(arrays[name])}"
        case 2:
            arrays[name] = (
                arrays[name].astype(rng.choice(("U8", "f2", "i1", "c16", "bool")))
                if name != "joints"
                else arrays[name][::-1]
            )
            done = f"as {arrays[name].dtype}"
        case 3:
            arrays[name] = np.expand_dims(arrays[name], rng.choice((0, -1)))
            done = f"of shape {arrays[name].shape}"
        case 4:
            values = np.array(arrays[name], dtype=object if name == "joints" else float)
            values[rng.randrange(len(values))] = rng.choice((np.nan, np.inf, 1e308, -1e308, 1e12))
            arrays[name] = values.astype(str) if name == "joints" else values
            done = "with a hostile number"
        case 5:
            stream = io.BytesIO()
            with zipfile.ZipFile(stream, "w") as file:
                for key, value in arrays.items():
                    member = io.BytesIO()
                    np.lib.format.write_array(member, value)
                    data = member.getvalue()
                    if key == name:
                        data = data.replace(
                            b"'shape': (",
                            b"'shape': (" + rng.choice((b"-", b"9" * 15, b"9", b"None, ")),
                            1,
                        )
                    file.writestr(f"{key}.npy", data)
            return stream.getvalue(), f"{name} with another shape in its header"
        case _:
            stream = io.BytesIO()
            with zipfile.ZipFile(stream, "w") as file:
                for key, value in arrays.items():
                    member = io.BytesIO()
                    np.lib.format.write_array(member, value)
                    data = member.getvalue()
                    if key == name:
                        data = data[:128].replace(value.dtype.str.encode(), b"|O") + pickle.dumps(
                            _Mark()
                        )
                    file.writestr(f"{key}.npy", data)
            return stream.getvalue(), f"{name} with a pickled object"
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue(), f"{name} {done}"


# -- kinds -----------------------------------------------------------------------------------------

SHORT = (
    "--starts",
    "1",
    "--iterations",
    "3",
    "--harmonics",
    "2",
    "--samples",
    "24",
    "--period",
    "2",
    "--jobs",
    "1",
)
DESIGN = ("design", "{robot.urdf}", "-o", "{out}", *SHORT)
DIAGNOSE = (
    "diagnose", "two_link", "{recording.csv}", "--validate", "{other.csv}", "-o", "{out}",
)  # fmt: skip
COMMANDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "robot.urdf": (
        DESIGN,
        ("identifiability", "{robot.urdf}", "{trajectory.json}", "-o", "{out}"),
        ("identify", "{robot.urdf}", "{recording.csv}", "-o", "{out}"),
        ("simulate", "{robot.urdf}", "{trajectory.json}", "-o", "{out}.csv"),
    ),
    "meshed.urdf": (("design", "{meshed.urdf}", "-o", "{out}", *SHORT),),
    "part.stl": (("design", "{meshed.urdf}", "-o", "{out}", *SHORT),),
    "recording.csv": (
        ("identify", "two_link", "{recording.csv}", "-o", "{out}"),
        ("identify", "two_link", "{other.csv}", "--validate", "{recording.csv}", "-o", "{out}"),
        ("predict", "{model.json}", "{recording.csv}", "-o", "{out}.csv"),
        ("identifiability", "two_link", "{recording.csv}", "-o", "{out}"),
        DIAGNOSE,
    ),
    "recording.npz": (("identifiability", "two_link", "{recording.npz}", "-o", "{out}"),),
    "recording.json": (("identify", "two_link", "{recording.csv}", "-o", "{out}"),),
    "trajectory.json": (
        ("verify", "{trajectory.json}"),
        ("export", "{trajectory.json}", "--format", "csv", "-o", "{out}.csv"),
        ("export", "{trajectory.json}", "--format", "ros2-joint-trajectory", "-o", "{out}.yaml"),
        ("identifiability", "two_link", "{trajectory.json}", "-o", "{out}"),
        ("simulate", "two_link", "{trajectory.json}", "-o", "{out}.csv"),
        (*DESIGN, "--given", "{trajectory.json}"),
    ),
    "arm.json": (
        ("export", "{arm.json}", "--format", "urscript", "-o", "{out}.script"),
        ("export", "{arm.json}", "--format", "ur-csv", "-o", "{out}.csv"),
    ),
    "model.json": (
        ("predict", "{model.json}", "{recording.csv}", "-o", "{out}.csv"),
        ("identify", "two_link", "{recording.csv}", "--prior", "{model.json}", "-o", "{out}"),
    ),
    "prior.json": (
        ("identify", "two_link", "{recording.csv}", "--prior", "{prior.json}", "-o", "{out}"),
    ),
    "truth.json": (
        ("simulate", "two_link", "{trajectory.json}", "--like", "{truth.json}", "-o", "{out}.csv"),
    ),
    "limits.toml": ((*DESIGN, "--limits", "{limits.toml}"),),
    "limits.yaml": ((*DESIGN, "--limits", "{limits.yaml}"),),
    "scene.toml": ((*DESIGN, "--scene", "{scene.toml}"),),
    "bounds.toml": (
        ("identify", "two_link", "{recording.csv}", "--bounds", "{bounds.toml}", "-o", "{out}"),
    ),
    "options": (
        DESIGN,
        ("verify", "{trajectory.json}"),
        ("export", "{trajectory.json}", "--format", "csv", "-o", "{out}.csv"),
        ("identifiability", "two_link", "{trajectory.json}", "-o", "{out}"),
        ("identify", "two_link", "{recording.csv}", "-o", "{out}"),
        ("predict", "{model.json}", "{recording.csv}", "-o", "{out}.csv"),
        ("simulate", "two_link", "{trajectory.json}", "-o", "{out}.csv"),
        DIAGNOSE,
    ),
}
"""Kind: the file that is damaged -> the commands that read it."""
Mutator = Callable[[random.Random, bytes], tuple[bytes, str]]
MUTATORS: dict[str, Mutator] = {
    "robot.urdf": robot,
    "meshed.urdf": robot,
    "part.stl": mesh,
    "recording.csv": table,
    "recording.npz": archive,
    "recording.json": json_document,
    "trajectory.json": json_document,
    "arm.json": json_document,
    "model.json": json_document,
    "prior.json": json_document,
    "truth.json": json_document,
    "limits.toml": toml_document,
    "limits.yaml": toml_document,
    "scene.toml": toml_document,
    "bounds.toml": toml_document,
}
COMPANIONS = {
    "recording.csv": ("recording.json",),
    "other.csv": ("other.json",),
    "meshed.urdf": ("part.stl",),
    "scene.toml": ("part.stl",),
}
"""Files that another file names, or that are read together with it."""
KINDS = tuple(COMMANDS)


def make_case(valid: Mapping[str, bytes], seed: int, kinds: Sequence[str] = KINDS) -> Case:
    """Return the case of a seed: a kind, one of its commands, and one or two kinds of damage."""
    rng = random.Random(seed)
    kind = kinds[seed % len(kinds)]
    argv = list(rng.choice(COMMANDS[kind]))
    files = _files_read(valid, argv)
    if kind == "options":
        argv, damage = _options(rng, argv)
    else:
        files[kind], damage = MUTATORS[kind](rng, files[kind])
        if rng.random() < 0.2:
            with contextlib.suppress(
                ValueError, LookupError, RecursionError, ElementTree.ParseError, zipfile.BadZipFile
            ):
                files[kind], more = MUTATORS[kind](rng, files[kind])
                damage += f"; {more}"
    return Case(seed, kind, tuple(argv), files, damage)


def undamaged_case(valid: Mapping[str, bytes], argv: Sequence[str]) -> Case:
    """Return the case of a command whose files are all valid."""
    return Case(0, "valid", tuple(argv), _files_read(valid, argv), "none")


def _files_read(valid: Mapping[str, bytes], argv: Sequence[str]) -> dict[str, bytes]:
    names = set(re.findall(r"\{([\w.]+)\}", " ".join(argv))) - {"out"}
    names |= {companion for name in names for companion in COMPANIONS.get(name, ())}
    return {name: valid[name] for name in sorted(names)}


def _options(rng: random.Random, argv: list[str]) -> tuple[list[str], str]:
    """Add options of the command, most of them numeric, with numbers from their whole range."""
    commands = next(action for action in parser()._actions if isinstance(action.choices, dict))
    actions = [
        action
        for action in commands.choices[argv[0]]._actions
        if action.option_strings and action.dest not in ("help", "out", "backend", "cluster")
    ]
    numeric = [action for action in actions if isinstance(action.type, NUMERIC)]
    added = []
    for action in [
        rng.choice(numeric or actions) for _ in range(rng.choice((1, 2, 3)))
    ] + rng.sample(actions, rng.choice((0, 1))):
        option = action.option_strings[-1]
        if action.nargs == 0:
            added.append(option)
        elif isinstance(action.type, NUMERIC):
            added.append(f"{option}={_fitting(rng, action.type)}")
        else:
            choices = list(action.choices or ())
            word = rng.choice(choices if choices and rng.random() < 0.7 else WORDS)
            added.append(f"{option}={word}".replace("\x00", ""))
    return [*argv, *added], " ".join(added)[:200]


def _fitting(rng: random.Random, kind: object) -> str:
    """Return a text for an option of a numeric type: valid in form, with arbitrary numbers."""
    if isinstance(kind, NamedNumbers):
        name = rng.choice(("joint_1", "joint_2", "tip", "link_2", *WORDS))
        return f"{name}{kind.separator}{_fitting(rng, kind.numbers)}".replace("\x00", "")
    if isinstance(kind, WordOrNumbers):
        return rng.choice((*kind.words, _fitting(rng, kind.numbers)))
    if isinstance(kind, Numbers):
        ranges = (
            [kind.accepted] * (2 if kind.counts is None else rng.choice(list(kind.counts)))
            if isinstance(kind.accepted, Range)
            else kind.accepted
        )
        return ",".join(_number(rng, accepted, whole=False) for accepted in ranges)
    assert isinstance(kind, Number)
    return _number(rng, kind.accepted, whole=kind.whole)


def _number(rng: random.Random, accepted: Range, *, whole: bool) -> str:
    if rng.random() < 0.2:
        return rng.choice(NUMBERS)
    least = max(accepted.lower, accepted.smallest, 1e-6)
    magnitude = rng.choice(
        (least, accepted.upper, least * (accepted.upper / least) ** rng.random())
    )
    value = (
        -magnitude
        if accepted.lower < 0.0 and rng.random() < 0.5
        else rng.choice((magnitude, magnitude, accepted.lower))
    )
    return str(round(value)) if whole else repr(float(value))


# -- running ---------------------------------------------------------------------------------------


@dataclass
class Ending:
    """Exit code, standard output and error, and the files written by a case."""

    code: int
    out: str
    err: str
    written: Mapping[str, bytes] = field(default_factory=dict)
    folder_exists: bool = False


def run(cases: Sequence[Case], folder: Path, batch: int = 25) -> Iterator[Failure]:
    """Run cases in forked processes, a batch in each, and yield those that failed."""
    waiting = list(cases)
    while waiting:
        done, failures, crash = _forked(waiting[:batch], folder)
        yield from failures
        if crash:
            yield Failure(waiting[done], crash)
            done += 1
        waiting = waiting[done:]


def _forked(cases: Sequence[Case], folder: Path) -> tuple[int, list[Failure], str]:
    """Return the number of cases done, the failures, and how the process crashed, if it did."""
    reading, writing = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        os.close(reading)
        code = 1
        try:
            _limit()
            with os.fdopen(writing, "w") as stream:
                for case in cases:
                    signal.alarm(SECONDS)
                    failure = failure_of(case, folder)
                    signal.alarm(0)
                    print(
                        json.dumps(None if failure is None else [failure.reason, failure.detail]),
                        file=stream,
                        flush=True,
                    )
            code = 0
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading) as stream:
        lines = [json.loads(line) for line in stream if line.endswith("\n")]
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    failures = [
        Failure(case, *line) for case, line in zip(cases, lines, strict=False) if line is not None
    ]
    if len(lines) == len(cases):
        return len(cases), failures, ""
    ending = (
        f"longer than {SECONDS} s"
        if status == -signal.SIGALRM
        else f"the process ended with {status}"
    )
    return len(lines), failures, ending


def _limit() -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def failure_of(case: Case, folder: Path) -> Failure | None:
    """Run a case in this process and return its failure, if it has one."""
    try:
        return _fault(case, run_here(case, folder))
    except BaseException:  # an escape from the command line's own handler is the failure
        return Failure(case, "traceback", traceback.format_exc(limit=-6))


def run_here(case: Case, folder: Path) -> Ending:
    """Run a case in this process, in a temporary folder inside `folder`."""
    place = Path(tempfile.mkdtemp(dir=folder))
    before = Path.cwd()
    try:
        for name, content in case.files.items():
            (place / name).write_bytes(content)
        os.chdir(place)
        return _run_command(case, place)
    finally:
        os.chdir(before)
        shutil.rmtree(place, ignore_errors=True)


def _run_command(case: Case, place: Path) -> Ending:
    words = [
        re.sub(r"\{([\w.]+)\}", lambda match: str(place / match[1]), word) for word in case.argv
    ]
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(),
    ):
        try:
            code = cli.main(words)
        except SystemExit as ended:
            code = int(ended.code or 0)
    written = {
        str(path.relative_to(place)): path.read_bytes()
        for path in place.rglob("*")
        if path.is_file() and str(path.relative_to(place)) not in case.files
    }
    folder_exists = (place / "out").exists()
    return Ending(code, out.getvalue(), err.getvalue(), written, folder_exists)


def _fault(case: Case, ending: Ending) -> Failure | None:
    reasons = []
    if ending.code not in (0, 1, 2):
        reasons.append(f"exit code {ending.code}")
    if "Traceback" in ending.err:
        reasons.append("a traceback on standard error")
    if ending.code == 2:
        messages = [line for line in ending.err.splitlines() if line.startswith("excite:")]
        if len(messages) != 1 or not ending.err.endswith(messages[-1] + "\n"):
            reasons.append(f"{len(messages)} lines say why it is refused")
        if ending.written:
            reasons.append(f"a refusal left {sorted(ending.written)}")
        if ending.folder_exists:
            reasons.append("a refusal left an empty folder")
    if "PICKLE_WAS_LOADED" in ending.written:
        reasons.append("a pickled object was loaded")
    reasons += [
        f"{name} is not finite: {where}"
        for name, content in ending.written.items()
        if (where := _not_finite(name, content))
    ]
    for line in ending.err.splitlines():
        if "RuntimeWarning" in line or re.search(
            r"warning: (invalid value|divide by zero|overflow|All-NaN|Mean of empty)", line
        ):
            reasons.append(f"a warning of numpy: {line[:100]}")
    return Failure(case, "; ".join(reasons), ending.err[-1500:]) if reasons else None


def _not_finite(name: str, content: bytes) -> str:
    """Return the surroundings of the first number in an output that is not finite, or ""."""
    shown = content.decode("utf-8", "replace")
    if name.endswith(".json"):
        json.loads(shown, parse_constant=lambda word: (_ for _ in ()).throw(ValueError(word)))
        match = None
    elif name.endswith((".csv", ".script", ".yaml")):
        match = re.search(
            r"(?i)(?<![\w.$-])[-+]?(nan|inf(inity)?)(?![\w.-])", shown.partition("\n")[2]
        )
    elif name.endswith((".html", ".urdf", ".svg")):
        match = re.search(r"(?<=[>\s\"])[-+−]?(nan|inf)(?=[<\s\"%,])", shown)
    else:
        match = None
    if match is None:
        return ""
    return shown[max(match.start() - 40, 0) : match.end() + 20].replace("\n", " ")


# -- valid inputs ----------------------------------------------------------------------------------


def valid_inputs(folder: Path) -> dict[str, bytes]:
    """Return valid files of every kind, written by the commands themselves for `two_link`."""
    from excite.robot.robot import locate

    def done(*words: object) -> None:
        with (
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()) as err,
        ):
            assert cli.main([str(word) for word in words]) == 0, err.getvalue()

    urdf = locate("two_link").read_bytes()
    done(
        "design",
        "two_link",
        "-o",
        folder / "design",
        *SHORT,
        "--iterations",
        "15",
        "--period",
        "2.4",
    )
    done("design", "ur5e", "--no-collision", "-o", folder / "arm", *SHORT)
    trajectory = folder / "design" / "trajectory.json"
    for seed, name in ((0, "recording"), (1, "other")):
        done(
            "simulate",
            "two_link",
            trajectory,
            "--rate",
            "125",
            "--seed",
            0,
            "--periods",
            2 + seed,
            "-o",
            folder / f"{name}.csv",
        )
    done("identify", "two_link", folder / "recording.csv", "-o", folder / "model")
    columns = np.genfromtxt(
        folder / "recording.csv", delimiter=",", names=True, deletechars="", dtype=float
    )
    names = ("joint_1", "joint_2")
    arrays = {"t": columns["t"], "joints": np.array(names)}
    arrays |= {
        kind: np.column_stack([columns[f"{kind}.{name}"] for name in names])
        for kind in ("q", "tau")
    }
    np.savez(folder / "recording.npz", **arrays)
    meshed = re.sub(
        rb'<cylinder radius="0.03" length="0.4"/>',
        b'<mesh filename="part.stl" scale="1 1 1"/>',
        urdf,
    )
    corners = ((0, 0, 0), (0.05, 0, 0), (0, 0.05, 0), (0, 0, 0.05))
    facets = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    part = "solid part\n"
    for facet in facets:
        vertices = "".join("vertex {} {} {}\n".format(*corners[corner]) for corner in facet)
        part += f"facet normal 0 0 1\nouter loop\n{vertices}endloop\nendfacet\n"
    joints = {
        name: {"coulomb": 0.3, "viscous": 0.2, "rotor_inertia": 0.01, "offset": 0.0}
        for name in names
    }
    limits = "".join(
        f"[joints.{name}]\nposition = [-2.0, 2.0]\nvelocity = 2.0\nacceleration = 20.0\njerk = "
        "300.0\ntorque = 50.0\n"
        for name in names
    )
    yaml = "joint_limits:\n" + "".join(
        f"  {name}:\n    has_velocity_limits: true\n    max_velocity: 2.0\n    "
        "has_acceleration_limits: true\n    max_acceleration: 9.0\n"
        for name in names
    )
    return {
        "robot.urdf": urdf,
        "meshed.urdf": meshed,
        "part.stl": (part + "endsolid part\n").encode(),
        "recording.csv": (folder / "recording.csv").read_bytes(),
        "recording.json": (folder / "recording.json").read_bytes(),
        "recording.npz": (folder / "recording.npz").read_bytes(),
        "other.csv": (folder / "other.csv").read_bytes(),
        "other.json": (folder / "other.json").read_bytes(),
        "truth.json": (folder / "recording.truth.json").read_bytes(),
        "trajectory.json": trajectory.read_bytes(),
        "arm.json": (folder / "arm" / "trajectory.json").read_bytes(),
        "model.json": (folder / "model" / "model.json").read_bytes(),
        "prior.json": json.dumps(
            {"schema": "excite.prior/1", "trust_prior": True, "joints": joints}
        ).encode(),
        "limits.toml": limits.encode(),
        "limits.yaml": yaml.encode(),
        "scene.toml": (
            b"floor = -1.5\nclearance = 0.01\n"
            b'[[box]]\nname = "table"\nsize = [1.0, 1.0, 0.1]\nposition = [0.0, 2.0, 0.0]\n'
            b"[[sphere]]\nradius = 0.1\nposition = [0.0, -2.0, 0.0]\n"
            b'[[mesh]]\nname = "wall"\nfile = "part.stl"\nposition = [2.0, 2.0, 2.0]\n'
        ),
        "bounds.toml": (
            b"[links.link_2]\nmass = [1.0, 3.0]\ncentre = [[0.0, -0.1, -0.1], [0.4, 0.1, 0.1]]\n"
        ),
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        os.environ["EXCITE_COMPILER"] = ""
        inputs = valid_inputs(Path(temporary))
        first, count = int(sys.argv[1]), int(sys.argv[2])
        began, failed = time.perf_counter(), 0
        for failure in run(
            [
                make_case(inputs, seed, sys.argv[3:] or KINDS)
                for seed in range(first, first + count)
            ],
            Path(temporary),
        ):
            failed += 1
            print(failure, flush=True)
        print(f"{failed} of {count} failed in {time.perf_counter() - began:.0f} s")
