"""`excite view`: drawing of all kinds of shapes, and playback of a motion."""

import json
import socket
from pathlib import Path

import coal
import pytest
from test_cli import refused, run

from excite.cli import view
from excite.collision import scene_file
from excite.collision.geometry import Shape, ShapeKind
from excite.collision.scene_file import Scene
from excite.robot.limits import resolve
from excite.robot.robot import load

MOTION = Path(__file__).parent.parent / "trajectories" / "two_link.json"
KINDS = {
    ShapeKind.SPHERE: (0.1,),
    ShapeKind.CAPSULE: (0.1, 0.2),
    ShapeKind.CYLINDER: (0.1, 0.2),
    ShapeKind.BOX: (0.1, 0.2, 0.3),
}


def test_every_kind_of_shape_is_drawn():
    robot = load("two_link")
    surroundings = tuple(
        Shape(kind.value, kind, size, (2.0, 0.0, float(k)))
        for k, (kind, size) in enumerate(KINDS.items())
    )
    cell = scene_file.build_cell(robot, resolve(robot), Scene(surroundings))
    drawn = view.geometry(cell).geometryObjects
    assert all(
        isinstance(entry.geometry, coal.Sphere | coal.Cylinder | coal.Box) for entry in drawn
    )
    assert {entry.name.split("_")[0] for entry in drawn} >= {
        "base",
        "link",
        "floor",
        *(kind.value for kind in KINDS),
    }


def test_motion_is_played(capsys):
    pytest.importorskip("viser", reason="the extra [view] is not installed")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    code, out, err = run(capsys, "view", MOTION, "--once", "--speed", "4", "--port", port, "--json")
    assert code == 0 and "collision checked" in json.loads(out)["collision"]
    assert f"http://localhost:{port} " in err
    assert "--speed" in refused(capsys, "view", MOTION, "--speed", "9")


@pytest.mark.parametrize("host", ["192.0.2.1", "x" * 70])
def test_a_host_without_a_server_is_refused(capsys, host):
    """192.0.2.1 is reserved for documentation (RFC 5737); no label has 70 letters."""
    pytest.importorskip("viser", reason="the extra [view] is not installed")
    line = refused(capsys, "view", MOTION, "--once", "--host", host)
    assert f"--host {host}" in line and "localhost" in line


def test_the_next_free_port_is_taken(capsys):
    pytest.importorskip("viser", reason="the extra [view] is not installed")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, _, err = run(
            capsys, "view", MOTION, "--once", "--speed", "4", "--port", port, "--json"
        )
    assert code == 0 and f":{port} " not in err and "http://localhost:" in err
