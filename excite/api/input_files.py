"""Files that a result is computed from, which its output must not replace."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..payload.shape import shape_mesh
from ..recordings import Recording
from ..recordings.sidecar import sidecar_path
from ..robot.source_text import included_files


def argument_files(
    robot: str | Path | None,
    *others: object,
    recordings: Iterable[str | Path | Recording] = (),
    shape: str | None = None,
) -> tuple[Path, ...]:
    """Return the absolute paths of the files among the arguments of a function or a command.

    They are the stated files, the sidecars of recordings, the mesh of a payload, and what the file
    of the robot includes. A name of a built-in robot is the path of no file.

    Args:
        robot: Path of the robot, None without.
        others: Paths and sequences of paths; other objects, such as None or limits that were read,
            come from no file.
        recordings: Paths of recordings, or recordings that were read.
        shape: Stated shape of a payload, None without.
    """
    files = [] if robot is None else [Path(robot), *included_files(Path(robot))]
    for recording in recordings:
        path = Path(recording.source if isinstance(recording, Recording) else recording)
        files += [path, sidecar_path(path)]
    mesh = None if shape is None else shape_mesh(shape)
    files += [] if mesh is None else [mesh]
    for other in others:
        paths = other if isinstance(other, list | tuple) else (other,)
        files += [Path(path) for path in paths if isinstance(path, str | Path)]
    return tuple(path.absolute() for path in files)
