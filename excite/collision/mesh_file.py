"""Triangle meshes from files, checked before coal builds its structures from them.

Assimp reads the files in a child process (`assimp_process`), all of a robot at once because the
process takes 0.2 s to start.
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
from .._types import BoolArray, FloatArray, IntArray
from ..errors import UnusableInput

MAX_TRIANGLES = 5_000_000
"""Largest number of triangles of a mesh; coal needs about 1 kB for each. The largest of 777
published meshes has 351,394."""
MAX_FILE_SIZE = 1 << 29
"""Largest mesh file that is read [bytes]: 512 MiB."""
READ_TIMEOUT = 600.0
"""Longest time in which the meshes of a robot must be read [s]; `assimp_process` bounds its
processor time too."""
MIN_RELATIVE_HEIGHT = 1e-12
"""Ratio of a triangle's height to its longest side below which the triangle is dropped [1]. Coal
3.0 reports contact at any distance for triangles of area 0; at 1e-15 its distances are still
correct."""
REMEDY = "export it as STL, OBJ or DAE"


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles over shared vertices.

    Attributes:
        vertices: Coordinates of the vertices. Shape (N, 3) [m].
        triangles: Indices of the vertices of each triangle. Shape (M, 3).
    """

    vertices: FloatArray
    triangles: IntArray


_meshes: dict[tuple[str, int, int], TriangleMesh] = {}
"""Meshes read so far, by path, modification time and size of the file, before scaling."""


def read_all(files: Iterable[str]) -> list[TriangleMesh]:
    """Read mesh files, each only once per process and version of the file.

    Args:
        files: Paths, in any format that Assimp reads.

    Returns:
        The mesh of each file, not scaled.

    Raises:
        UnusableInput: A file is missing, too large or no mesh, has no triangle, or has a vertex
            that is not finite.
    """
    keys = [_key(file) for file in files]
    unread = [key for key in dict.fromkeys(keys) if key not in _meshes]
    if unread:
        _meshes.update(zip(unread, _read_with_assimp([key[0] for key in unread]), strict=True))
    return [_meshes[key] for key in keys]


def _key(file: str) -> tuple[str, int, int]:
    try:
        state = Path(file).stat()
    except OSError as error:
        raise UnusableInput(
            f"{file}: cannot be read as a mesh ({error.strerror}); {REMEDY}"
        ) from error
    if state.st_size > MAX_FILE_SIZE:
        raise UnusableInput(
            f"{file}: has {state.st_size / 1e6:.0f} MB, a mesh may have {MAX_FILE_SIZE >> 20} MiB; "
            "simplify it"
        )
    return file, state.st_mtime_ns, state.st_size


def _read_with_assimp(files: Sequence[str]) -> Iterator[TriangleMesh]:
    """Read files with Assimp in a child process, which imports no files of the current folder."""
    program = Path(__file__).with_name("assimp_process.py")
    command = [sys.executable, "-P", str(program)]
    try:
        done = subprocess.run(
            command,
            input=json.dumps(list(files)).encode(),
            capture_output=True,
            timeout=READ_TIMEOUT,
            check=False,
        )
        answer, code = done.stdout, done.returncode
    except subprocess.TimeoutExpired as error:
        answer, code = error.stdout or b"", -signal.SIGXCPU
    position = 0
    for file in files:
        end = answer.find(b"\n", position)
        if end < 0:
            raise UnusableInput(f"{file}: cannot be read as a mesh ({_failure(code)}); {REMEDY}")
        header = json.loads(answer[position:end])
        if "error" in header:
            raise UnusableInput(f"{file}: cannot be read as a mesh ({header['error']}); {REMEDY}")
        corners, count = int(header["vertices"]), int(header["triangles"])
        begin, middle = end + 1, end + 1 + 24 * corners
        position = middle + 24 * count
        if len(answer) < position:
            raise UnusableInput(f"{file}: cannot be read as a mesh ({_failure(code)}); {REMEDY}")
        vertices = np.frombuffer(answer[begin:middle], np.float64).reshape(-1, 3)
        triangles = np.frombuffer(answer[middle:position], np.int64).reshape(-1, 3)
        yield _checked(file, TriangleMesh(vertices, triangles))


def _failure(code: int) -> str:
    """Describe in a message how the child process failed."""
    if code == -signal.SIGXCPU:
        return "reading it takes too long"
    return (
        f"the reader crashed: {signal.strsignal(-code)}"
        if code < 0
        else f"the reader ended with exit code {code}"
    )


def _checked(file: str, mesh: TriangleMesh) -> TriangleMesh:
    """Return a valid mesh; raise UnusableInput for a faulty one."""
    if not len(mesh.triangles):
        raise UnusableInput(f"{file}: holds no triangles; {REMEDY}")
    if len(mesh.triangles) > MAX_TRIANGLES:
        raise UnusableInput(
            f"{file}: has {len(mesh.triangles)} triangles, more than {MAX_TRIANGLES}; simplify it"
        )
    if mesh.triangles.min() < 0 or mesh.triangles.max() >= len(mesh.vertices):
        raise UnusableInput(
            f"{file}: a triangle refers to a vertex that the mesh does not have; {REMEDY}"
        )
    finite = np.isfinite(mesh.vertices).all(axis=1)
    if not finite.all():
        where = int(np.flatnonzero(~finite)[0])
        raise UnusableInput(
            f"{file}: vertex {where + 1} is at {mesh.vertices[where].tolist()}, not finite; "
            f"{REMEDY}"
        )
    return mesh


def scaled(file: str, scale: Sequence[float]) -> TriangleMesh:
    """Read a mesh and apply its scale.

    Triangles without an area are dropped: their neighbours cover their edges.

    Args:
        file: Path of the mesh.
        scale: Factors along x, y and z. Shape (3,).

    Raises:
        UnusableInput: `read_all` raises it; or the scale or the size is outside the range for parts
            of a robot, or no triangle has an area.
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
    has_area = _has_area(vertices[mesh.triangles])
    if not has_area.any():
        raise UnusableInput(
            f"{file}: with the scale {list(scale)} its triangles have no area; {REMEDY}"
        )
    return TriangleMesh(vertices, mesh.triangles[has_area])


def _has_area(triangles: FloatArray) -> BoolArray:
    """Mark triangles whose area exceeds rounding errors. Shapes (M, 3, 3) -> (M,)."""
    sides = triangles - np.roll(triangles, 1, axis=1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    return np.asarray(twice_area > MIN_RELATIVE_HEIGHT * longest**2)
