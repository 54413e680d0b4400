"""Triangle meshes from files, checked before coal builds its structures from them.

Files are read by Assimp in a process of its own (`assimp_process`), several at a time: starting it
takes 0.2 s.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import physical_ranges as ranges
from ..errors import UnusableInput

Array = np.ndarray
MOST_TRIANGLES = 5_000_000
"""Largest number of triangles of one mesh; coal needs about 1 kB for each. The largest mesh of 777
published ones has 351,394."""
LARGEST_FILE = 1 << 29
"""Largest mesh file that is read [bytes]: 512 MiB."""
TIMEOUT = 600.0
"""Longest time that reading the meshes of one robot may take [s]; `assimp_process` bounds its
processor time besides."""
THINNEST = 1e-12
"""Height of a triangle over its longest side below which it is dropped. Distances to triangles of
the area 0 are wrong in coal 3.0 (it reports contact at any distance); at 1e-15 they are still
right."""
REMEDY = "export it as STL, OBJ or DAE"


@dataclass(frozen=True)
class Mesh:
    """Triangles of a mesh file as they are in it, not yet scaled.

    Attributes:
        vertices: Corners. Shape (N, 3) [m].
        triangles: Rows of `vertices`. Shape (M, 3).
    """

    vertices: Array
    triangles: Array


_meshes: dict[tuple[str, int, int], Mesh] = {}
"""Meshes read so far, by path, time of the last change and size of their files."""


def read_all(files: Iterable[str]) -> list[Mesh]:
    """Read mesh files that were not read before.

    Args:
        files: Paths in any format that Assimp knows.

    Returns:
        A mesh for each file.

    Raises:
        UnusableInput: A file is missing or too large, no mesh, holds no triangle, or has a corner
            that is not finite.
    """
    keys = [_key(file) for file in files]
    unread = [key for key in dict.fromkeys(keys) if key not in _meshes]
    if unread:
        _meshes.update(zip(unread, _read_apart([key[0] for key in unread]), strict=True))
    return [_meshes[key] for key in keys]


def _key(file: str) -> tuple[str, int, int]:
    try:
        state = Path(file).stat()
    except OSError as error:
        raise UnusableInput(
            f"{file}: cannot be read as a mesh ({error.strerror}); {REMEDY}"
        ) from error
    if state.st_size > LARGEST_FILE:
        raise UnusableInput(
            f"{file}: has {state.st_size / 1e6:.0f} MB, a mesh may have {LARGEST_FILE >> 20} MiB; "
            "simplify it"
        )
    return file, state.st_mtime_ns, state.st_size


def _read_apart(files: Sequence[str]) -> Iterator[Mesh]:
    """Read files in a process of its own."""
    command = [sys.executable, "-m", "excite.collision.assimp_process"]
    try:
        done = subprocess.run(
            command,
            input=json.dumps(list(files)).encode(),
            capture_output=True,
            timeout=TIMEOUT,
            check=False,
        )
        answer, code = done.stdout, done.returncode
    except subprocess.TimeoutExpired as error:
        answer, code = error.stdout or b"", -signal.SIGXCPU
    at = 0
    for file in files:
        end = answer.find(b"\n", at)
        if end < 0:
            raise UnusableInput(f"{file}: cannot be read as a mesh ({_end(code)}); {REMEDY}")
        header = json.loads(answer[at:end])
        if "error" in header:
            raise UnusableInput(f"{file}: cannot be read as a mesh ({header['error']}); {REMEDY}")
        corners, count = int(header["vertices"]), int(header["triangles"])
        begin, middle = end + 1, end + 1 + 24 * corners
        at = middle + 24 * count
        if len(answer) < at:
            raise UnusableInput(f"{file}: cannot be read as a mesh ({_end(code)}); {REMEDY}")
        vertices = np.frombuffer(answer[begin:middle], np.float64).reshape(-1, 3)
        triangles = np.frombuffer(answer[middle:at], np.int64).reshape(-1, 3)
        yield _checked(file, Mesh(vertices, triangles))


def _end(code: int) -> str:
    """How the process ended, for messages."""
    if code == -signal.SIGXCPU:
        return "reading it takes too long"
    return (
        f"the reader crashed: {signal.strsignal(-code)}"
        if code < 0
        else f"the reader ended with exit code {code}"
    )


def _checked(file: str, mesh: Mesh) -> Mesh:
    """A mesh without faults; UnusableInput says which one it has."""
    if not len(mesh.triangles):
        raise UnusableInput(f"{file}: holds no triangles; {REMEDY}")
    if len(mesh.triangles) > MOST_TRIANGLES:
        raise UnusableInput(
            f"{file}: has {len(mesh.triangles)} triangles, more than {MOST_TRIANGLES}; simplify it"
        )
    if mesh.triangles.min() < 0 or mesh.triangles.max() >= len(mesh.vertices):
        raise UnusableInput(
            f"{file}: a triangle names a corner that the mesh does not have; {REMEDY}"
        )
    finite = np.isfinite(mesh.vertices).all(axis=1)
    if not finite.all():
        where = int(np.flatnonzero(~finite)[0])
        raise UnusableInput(
            f"{file}: corner {where + 1} is at {mesh.vertices[where].tolist()}, not finite; "
            f"{REMEDY}"
        )
    return mesh


def scaled(file: str, scale: Sequence[float]) -> Mesh:
    """Read a mesh and apply its scale; triangles without an area, of which others cover the sides,
    are dropped.

    Args:
        file: Path of the mesh.
        scale: Factors along x, y and z. Shape (3,).

    Raises:
        UnusableInput: As `read_all`; or the scale, the size or the area of the mesh is none that a
            part of a robot has.
    """
    if not all(ranges.MESH_SCALE.accepts(factor) for factor in scale):
        raise UnusableInput(
            f"{file}: the scale {list(scale)} of the mesh should be {ranges.MESH_SCALE}; correct it"
        )
    mesh = read_all([file])[0]
    vertices = mesh.vertices * np.array(scale)
    reach, extent = float(np.abs(vertices).max()), float(np.ptp(vertices, axis=0).max())
    if not (ranges.LENGTH.accepts(reach) and ranges.SIZE.accepts(extent)):
        raise UnusableInput(
            f"{file}: with the scale {list(scale)} the mesh is {extent:.3g} m long and reaches "
            f"{reach:.3g} m from its origin; "
            f"a length should be {ranges.SIZE}; correct its unit or scale"
        )
    proper = _has_area(vertices[mesh.triangles])
    if not proper.any():
        raise UnusableInput(
            f"{file}: with the scale {list(scale)} its triangles have no area; {REMEDY}"
        )
    return Mesh(vertices, mesh.triangles[proper])


def _has_area(triangles: Array) -> Array:
    """Whether triangles have an area, but for rounding. Shapes (M, 3, 3) -> (M,)."""
    sides = triangles - np.roll(triangles, 1, axis=1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    return np.asarray(twice_area > THINNEST * longest**2)
