"""Scene files, and collision checks on the command line."""

import itertools
import json
from pathlib import Path

import pytest
from conftest import document, joint, link
from test_cli import refused, run
from test_collision import octahedron

from excite.collision import scene_file
from excite.collision.geometry import ShapeKind
from excite.robot.limits import resolve
from excite.robot.robot import load

FAST = [
    "--starts",
    "1",
    "--iterations",
    "15",
    "--harmonics",
    "3",
    "--samples",
    "60",
    "--period",
    "4",
]
SCENES = {
    "negative size": ('[[box]]\nname = "b"\nsize = [1, -1, 1]', "box[0].size[1]: -1 should be"),
    "two numbers": (
        "[[sphere]]\nradius = 0.1\nposition = [1, 2]",
        "position: should hold 3 values",
    ),
    "no radius": ('[[sphere]]\nname = "s"', "has no 'radius'"),
    "not finite": ("[[sphere]]\nradius = inf", "finite"),
    "unknown kind": ("[[cone]]\nradius = 1", "'cone'"),
    "unknown key": ('[[box]]\nname = "b"\nsize = [1, 1, 1]\ncolour = "red"', "'colour'"),
    "same name": (
        '[[box]]\nname = "b"\nsize = [1, 1, 1]\n[[box]]\nname = "b"\nsize = [1, 1, 1]',
        "'b' is the name of another shape too",
    ),
    "missing mesh": ('[[mesh]]\nname = "m"\nfile = "nowhere.stl"', "nowhere.stl"),
    "unknown link": ('[[box]]\nsize = [0.1, 0.1, 0.1]\nlink = "hand"', "no frame 'hand'"),
    "name of a link": ('[[sphere]]\nname = "link_1"\nradius = 0.1', "'link_1'"),
    "no toml": ("[[box", "cannot be read as a scene"),
    "ignored stranger": (
        '[[sphere]]\nname = "s"\nradius = 0.1\nposition = [3, 0, 0]\nignore = ["nobody"]',
        "'nobody'",
    ),
    "floor": ('floor = "low"', "floor"),
    "clearance": ("clearance = -1", "clearance"),
    "in the robot": ('[[sphere]]\nname = "s"\nradius = 0.2', "'s' touches 'link_1' in every pose"),
}


@pytest.mark.parametrize("case", SCENES)
def test_faulty_scene_gives_a_one_line_error(capsys, tmp_path, case):
    text, wanted = SCENES[case]
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert wanted in refused(
        capsys, "design", "two_link", "-o", tmp_path / "out", "--scene", path, *FAST
    )
    assert not (tmp_path / "out").exists()


def test_file_that_is_no_mesh_gives_a_one_line_error(capsys, tmp_path):
    (tmp_path / "m.stl").write_text("solid nothing\nendsolid\n")
    (tmp_path / "scene.toml").write_text('[[mesh]]\nname = "m"\nfile = "m.stl"\n')
    assert "m.stl" in refused(
        capsys,
        "design",
        "two_link",
        "-o",
        tmp_path / "out",
        "--scene",
        tmp_path / "scene.toml",
        *FAST,
    )


def test_start_pose_in_an_obstacle_gives_a_one_line_error(capsys, tmp_path):
    (tmp_path / "scene.toml").write_text(
        '[[box]]\nname = "block"\nsize = [0.1, 0.6, 0.3]\nposition = [0.85, 0, 0]\n'
    )
    line = refused(
        capsys,
        "design",
        "two_link",
        "-o",
        tmp_path / "o",
        "--scene",
        tmp_path / "scene.toml",
        "--start",
        "0,0",
        *FAST,
    )
    assert "start pose" in line and "block" in line


def test_design_in_a_scene_reports_least_distances(capsys, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        'clearance = 0.03\n[[box]]\nname = "block"\nsize = [0.1, 0.6, 0.3]\n'
        "position = [0.75, 0, 0.45]\n"
        '[[sphere]]\nname = "tool"\nradius = 0.05\nlink = "tip"\nposition = [0.05, 0, 0]\n'
    )
    code, out, _ = run(
        capsys, "design", "two_link", "-o", tmp_path / "o", "--scene", path, "--json", *FAST
    )
    assert code == 0
    assert json.loads(out)["collision"].startswith("collision checked: never less than")
    stated = json.loads((tmp_path / "o" / "trajectory.json").read_text())
    assert stated["design"]["cell"]["margin"] == 0.03
    code, out, _ = run(capsys, "verify", tmp_path / "o" / "trajectory.json", "--json")
    listed = json.loads(out)["clearance"]
    assert code == 0 and {"pair", "least", "proven", "margin", "time", "pose"} == set(listed[0])
    assert all(entry["proven"] >= entry["margin"] for entry in listed)
    assert any("tool" in entry["pair"] for entry in listed)
    page = (tmp_path / "o" / "report.html").read_text()
    assert "Does it touch anything?" in page and "tool" in page


def test_robot_without_shapes_is_reported_as_not_checked(capsys, tmp_path):
    bare = tmp_path / "bare.urdf"
    inside = '<limit lower="-2" upper="2" velocity="3" effort="40"/>'
    bare.write_text(
        document(
            link("l0"),
            link("l1", 1.0, (0.2, 0, 0)),
            joint("a", "l0", "l1", axis=(0, 1, 0), inside=inside),
        )
    )
    code, out, _ = run(capsys, "design", bare, "-o", tmp_path / "o", "--json", *FAST)
    assert code == 0 and json.loads(out)["collision"].startswith("collision not checked")
    assert json.loads((tmp_path / "o" / "trajectory.json").read_text())["collision"].startswith(
        "collision not checked"
    )
    code, out, _ = run(capsys, "verify", tmp_path / "o" / "trajectory.json", "--json")
    assert code == 0 and "not checked" in json.loads(out)["collision"]
    line = refused(capsys, "design", bare, "-o", tmp_path / "p", "--floor", "-1", *FAST)
    assert "<collision>" in line


def test_no_collision_option_is_reported(capsys, tmp_path):
    code, out, _ = run(
        capsys, "design", "two_link", "-o", tmp_path / "o", "--no-collision", "--json", *FAST
    )
    assert code == 0 and json.loads(out)["collision"] == "collision not checked (--no-collision)"


@pytest.mark.parametrize(
    "options",
    [
        ("--scene", "nowhere.toml", "--no-collision"),
        ("--srdf", "nowhere.srdf", "--no-collision"),
        ("--clearance", "0.1", "--no-collision"),
        ("--floor", "0", "--no-collision"),
        ("--floor", "0", "--no-floor"),
    ],
)
def test_contradictory_surroundings_are_refused(capsys, tmp_path, options):
    line = refused(capsys, "design", "two_link", "-o", tmp_path / "out", *options, *FAST)
    assert options[0] in line and options[-1] in line


def test_changed_mesh_fails_the_verification(capsys, tmp_path):
    mesh = Path(octahedron(tmp_path / "m.obj", 0.1))
    (tmp_path / "scene.toml").write_text(
        '[[mesh]]\nname = "m"\nfile = "m.obj"\nposition = [0.9, 0, 0.6]\n'
    )
    code, _, err = run(
        capsys,
        "design",
        "two_link",
        "-o",
        tmp_path / "o",
        "--scene",
        tmp_path / "scene.toml",
        *FAST,
    )
    assert code == 0, err
    octahedron(mesh, 0.2)
    code, out, _ = run(capsys, "verify", tmp_path / "o" / "trajectory.json", "--json")
    result = json.loads(out)
    assert code == 1 and "sha256" in result["collision"]
    assert result["verdict"] == {"limits": "certified", "clearance": "failed"}
    code, _, err = run(
        capsys,
        "export",
        tmp_path / "o" / "trajectory.json",
        "--format",
        "csv",
        "-o",
        tmp_path / "x.csv",
    )
    assert code == 1 and "clearance: failed" in err and not (tmp_path / "x.csv").exists()
    mesh.unlink()
    code, out, _ = run(capsys, "verify", tmp_path / "o" / "trajectory.json", "--json")
    assert code == 1 and str(mesh) in json.loads(out)["collision"]


def test_cell_is_rebuilt_from_its_document(tmp_path):
    round_sizes = dict.fromkeys(("capsule", "cylinder"), "radius = 0.1\nlength = 0.2")
    sizes = {"sphere": "radius = 0.1", "box": "size = [1, 1, 1]", **round_sizes}
    path = tmp_path / "scene.toml"
    path.write_text(
        "\n".join(
            f"[[{kind}]]\n{size}\nposition = [2, {k}, 0]"
            for k, (kind, size) in enumerate(sizes.items())
        )
    )
    robot = load("two_link")
    scene = scene_file.read(path).overridden(floor=False)
    cell = scene_file.build_cell(robot, resolve(robot), scene)
    assert {body.shapes[0].kind for body in cell.bodies if body.is_surrounding} == {
        ShapeKind.SPHERE,
        ShapeKind.CAPSULE,
        ShapeKind.CYLINDER,
        ShapeKind.BOX,
    }
    names = set(itertools.chain(*(cell.names(pair).split(" – ") for pair in cell.pairs)))
    assert sum(name.endswith(" 1") for name in names) == 4
    stated = json.loads(json.dumps(cell.document()))
    rebuilt, fault = scene_file.rebuild_cell(robot, cell.limits, stated)
    assert fault is None and rebuilt is not None
    assert rebuilt.pairs == cell.pairs and rebuilt.document() == cell.document()
    for change, words in (
        (lambda d: d["shapes"][-1].update(size=[9.0, 9.0, 9.0]), "another size"),
        (lambda d: d["shapes"].pop(), "another number of shapes"),
        (lambda d: d.update(margin=0.0), "the clearance is"),
        (lambda d: d.update(disabled=[["link_1", "box 1"]]), "may touch"),
    ):
        tampered = json.loads(json.dumps(stated))
        change(tampered)
        rebuilt, fault = scene_file.rebuild_cell(robot, cell.limits, tampered)
        assert rebuilt is None and fault is not None and words in fault
