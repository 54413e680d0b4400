"""Child process of `mesh_file` that reads mesh files with Assimp.

    python -P excite/collision/assimp_process.py

Assimp crashes, hangs or allocates without bound on some corrupted files; in a process of its own it
cannot take the caller down. Standard input: a JSON list of paths. Standard output, for each path in
turn: one line of JSON, {"vertices": N, "triangles": M} or {"error": "…"}, then N × 3 numbers of
type float64 and M × 3 of type int64.
"""

from __future__ import annotations

import json
import os
import sys
from typing import BinaryIO

import coal
import numpy as np

MAX_MEMORY = 4 << 30
"""Largest address space of the process [bytes]."""
MAX_PROCESSOR_TIME = 120
"""Longest processor time of the process [s]. The 29 MB trunk.dae of the Unitree Go1, 350,000
triangles, takes 2 s."""


def _limit_resources() -> None:
    try:
        import resource
    except ImportError:  # Windows has no such limits
        return
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_PROCESSOR_TIME, MAX_PROCESSOR_TIME))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _write(out: BinaryIO, path: str) -> None:
    try:
        mesh = coal.MeshLoader().load(path, np.ones(3))
        # a mesh of one vertex comes as a vector
        vertices = np.ascontiguousarray(mesh.vertices(), np.float64).reshape(-1, 3)
        faces = [mesh.tri_indices(number) for number in range(mesh.num_tris)]
        triangles = np.array([[face[0], face[1], face[2]] for face in faces], np.int64)
    except (ValueError, RuntimeError, MemoryError) as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[-1]
        out.write(json.dumps({"error": reason}).encode() + b"\n")
        return
    out.write(json.dumps({"vertices": len(vertices), "triangles": len(triangles)}).encode() + b"\n")
    out.write(vertices.tobytes() + triangles.tobytes())


def main() -> None:
    """Read the meshes that standard input lists and write them to standard output."""
    paths = json.load(sys.stdin)
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries may print; the answer must not contain that
    _limit_resources()
    for path in paths:
        _write(out, path)
        out.flush()


if __name__ == "__main__":
    main()
