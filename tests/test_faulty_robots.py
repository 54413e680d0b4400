"""Damaged, contradictory and malicious robot descriptions and meshes: read, or refused in one
line."""

from __future__ import annotations

import codecs
import re
import struct
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from conftest import LIMIT, document, joint, link, pendulum, text_of
from shared_inputs import INPUTS, needs_inputs

from excite.cli import main as main_module
from excite.collision import urdf_geometry
from excite.collision.geometry import Shape, ShapeKind
from excite.errors import UnusableInput
from excite.identification.urdf_export import identified_urdf
from excite.robot.inertial_parameters import standard_parameters
from excite.robot.limits import resolve
from excite.robot.robot import load

HOSTILE = (
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e40",
    "9" * 400,
    "",
    "heavy",
    "0x10",
    "1,5",
    "1 2 3 4",
)
"""Values that no numeric attribute of a URDF accepts."""


def refused(path: Path, *parts: str) -> str:
    """Return the error message of a refused robot."""
    with pytest.raises(UnusableInput) as caught:
        load(str(path))
        urdf_geometry.read(str(path))
    line = str(caught.value)
    assert (
        "\n" not in line and len(line) < 600 and all(part in line for part in (path.name, *parts))
    ), line
    return line


def written(folder: Path, text: str | bytes, name: str = "thing.urdf") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


# -- the shared inputs -----------------------------------------------------------------------------


@needs_inputs
@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("u_mesh_scale0", ["link_1", "'0 0 0'", "not 0"]),
        ("u_mesh_scale1e300", ["link_1", "1e300 1 1"]),
        ("u_mesh_nan", ["nan.stl", "not finite"]),
    ],
)
def test_a_faulty_mesh_is_refused_without_a_crash(name, parts, tmp_path):
    command = [
        sys.executable,
        "-m",
        "excite",
        "design",
        str(INPUTS / f"{name}.urdf"),
        "-o",
        str(tmp_path / "out"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and all(part in done.stderr for part in parts), done.stderr
    assert not (tmp_path / "out").exists()


@needs_inputs
@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("u_latin1", ["line 3", "0xe4", "encoding"]),
        ("u_klingon", ["klingon"]),
        ("u_iyz1e308", ["link_1", "iyz", "kg m²"]),
        ("u_mass0", ["link_1", "mass"]),
        ("u_mimic1e300", ["joint_2", "multiplier"]),
        ("u_pos1e300", ["joint_2", "lower", "rad"]),
        ("u_vel1e300", ["joint_2", "velocity", "rad/s"]),
    ],
)
def test_a_faulty_robot_is_refused_with_its_fault(name, parts, tmp_path, capsys):
    assert (
        main_module.main(["design", str(INPUTS / f"{name}.urdf"), "-o", str(tmp_path / "out")]) == 2
    )
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and all(part in err for part in parts), err
    assert not (tmp_path / "out").exists()


@needs_inputs
@pytest.mark.parametrize(("name", "joint"), [("u_comma", "a,b"), ("u_dollar", "$x_{$")])
def test_names_with_characters_of_other_formats_are_read(name, joint):
    assert load(str(INPUTS / f"{name}.urdf")).joints == (joint, "joint_2")


@needs_inputs
@pytest.mark.parametrize(
    "path",
    sorted((INPUTS / "reports" / "19-loops").glob("*.urdf")) if INPUTS else [],
    ids=lambda path: path.stem,
)
def test_closed_loops_name_a_joint_and_the_links_it_connects(path):
    line = refused(path)
    assert "not modelled" in line or "base link" in line
    assert line.count("'") >= 6, "a joint and two links"


# -- encodings and XML -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("encoding", "mark"),
    [
        ("ISO-8859-1", b""),
        ("windows-1252", b""),
        ("shift_jis", b""),
        ("UTF-8", b""),
        ("UTF-8", codecs.BOM_UTF8),
        ("UTF-16", codecs.BOM_UTF16_LE),
        ("UTF-16", codecs.BOM_UTF16_BE),
    ],
)
def test_a_declared_encoding_is_read_as_declared(encoding, mark, tmp_path):
    name = "関節" if encoding == "shift_jis" else "Gerät"
    text = f'<?xml version="1.0" encoding="{encoding}"?>\n' + pendulum().replace("swing", name)
    codec = {codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}.get(mark, encoding)
    path = written(tmp_path, mark + text.encode(codec))
    robot = load(str(path))
    assert robot.joints == (name,)
    again = written(tmp_path, identified_urdf(robot, *_nominal(robot)), "again.urdf")
    assert load(str(again)).joints == (name,)


def _nominal(robot):
    parameters = standard_parameters(robot, resolve(robot))
    return parameters, parameters.nominal, np.full(robot.n, 0.01)


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (
            pendulum().replace("swing", "Gerät").encode("latin-1"),
            ["line 4", "UTF-8", "declare its encoding"],
        ),
        (b'<?xml version="1.0" encoding="hex"?>' + pendulum().encode(), ["'hex'", "UTF-8"]),
        (b'<?xml version="1.0" encoding="utf-16"?>' + pendulum().encode(), []),
        (b"\x00" * 200, ["not a URDF"]),
        (b"", ["valid XML"]),
        (b"\xff\xfe", ["valid XML"]),
        ((b"<robot>" + b"<a>" * 5000), ["nested"]),
        (b"<robot name='r'><link name='a'/>" + b" " * (17 << 20) + b"</robot>", ["MB"]),
        (
            document(link("base"), link("arm", 2.0), joint("a&#10;b", "base", "arm")).encode(),
            ["joint 'a\\nb'", "U+000A"],
        ),
        (document(link("base"), link(" ", 2.0), joint("a", "base", " ")).encode(), ["empty name"]),
        (
            document(link("base"), link("arm", 2.0), joint(" a ", "base", "arm")).encode(),
            ["joint ' a '", "rename it"],
        ),
    ],
)
def test_invalid_xml_is_refused(content, parts, tmp_path):
    refused(written(tmp_path, content), *parts)


def test_entities_are_not_expanded(tmp_path):
    """1 kB that expands to 3 GB ("billion laughs"), and a local file as an entity."""
    laughs = '<!DOCTYPE robot [<!ENTITY a "lol">' + "".join(
        f'<!ENTITY {name} "{f"&{before};" * 10}">'
        for before, name in zip("abcdefghi", "bcdefghij", strict=True)
    )
    for kind in (
        laughs + "]><robot>&j;</robot>",
        '<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>',
    ):
        refused(written(tmp_path, kind), "<!DOCTYPE", "remove it")


def test_included_files_are_not_read(tmp_path):
    """XInclude is no part of URDF: the element is ignored."""
    include = (
        '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="/etc/passwd" parse="text"/>'
    )
    robot = load(str(written(tmp_path, pendulum().replace("</robot>", include + "</robot>"))))
    assert robot.joints == ("swing",)


def test_an_srdf_is_read_with_the_same_checks(tmp_path):
    with pytest.raises(UnusableInput, match="DOCTYPE"):
        urdf_geometry.disabled_pairs(written(tmp_path, '<!DOCTYPE r SYSTEM "x"><robot/>', "r.srdf"))
    with pytest.raises(UnusableInput, match="SRDF"):
        urdf_geometry.disabled_pairs(tmp_path / "absent.srdf")


@pytest.mark.parametrize("name", ["x" * 5000 + ".urdf", "a/" * 3000 + "x.urdf"])
def test_a_name_that_is_too_long_for_the_file_system(name, capsys):
    assert main_module.main(["design", name, "-o", "unused"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


# -- numbers ---------------------------------------------------------------------------------------


RICH = text_of("two_link").replace(
    '<limit lower="-2.6" upper="2.6" velocity="4" effort="20"/>',
    '<limit lower="-2.6" upper="2.6" velocity="4" effort="20"/>'
    '<dynamics damping="0.1" friction="0.2"/>'
    '<mimic joint="joint_1" multiplier="0.5" offset="0.1"/>'
    '<excite rotor_inertia="0.01" offset="0.1"/>',
)
"""URDF with all numeric attributes that are read."""
NUMERIC = {
    "limit": ("lower", "upper", "velocity", "effort"),
    "dynamics": ("damping", "friction"),
    "mimic": ("multiplier", "offset"),
    "excite": ("rotor_inertia", "offset"),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "cylinder": ("radius", "length"),
    "box": ("size",),
    "sphere": ("radius",),
    "mesh": ("scale",),
}
SHAPES = '<box size="1 1 1"/>', '<sphere radius="1"/>'


def attributes() -> list[tuple[int, str]]:
    """Return all numeric attributes of RICH: number of the element in document order, and name."""
    root = ElementTree.fromstring(RICH)
    return [
        (number, key)
        for number, element in enumerate(root.iter())
        for key in NUMERIC.get(element.tag, ())
        if key in element.attrib
    ]


@pytest.mark.parametrize(("number", "key"), attributes(), ids=str)
def test_every_numeric_attribute_has_a_range(number, key, tmp_path):
    for value in HOSTILE:
        root = ElementTree.fromstring(RICH)
        element = list(root.iter())[number]
        words = element.get(key).split()
        element.set(key, " ".join([value, *words[1:]]))
        line = refused(written(tmp_path, ElementTree.tostring(root)), "correct it")
        assert re.search(r"(joint|link) '", line), line


@pytest.mark.parametrize(
    "solid", ['<box size="{}"/>', '<sphere radius="{}"/>', '<cylinder radius="{}" length="1"/>']
)
def test_sizes_of_shapes_are_lengths(solid, tmp_path):
    count = 3 if "box" in solid else 1
    for value in ("nan", "1e300", "-1", "1e-300", "", "wide", "1 2"):
        shape_text = solid.format(" ".join([value] * count))
        geometry = f"<collision><geometry>{shape_text}</geometry></collision></link>"
        refused(
            written(tmp_path, pendulum().replace("</link>", geometry, 1)),
            "link 'arm'",
            "correct it",
        )


@pytest.mark.parametrize(
    "inside",
    [
        '<limit lower="-1e16" upper="1e16" velocity="3" effort="40"/>',
        '<limit velocity="3" effort="40"/>',
        LIMIT,
    ],
)
def test_position_limits_of_a_continuous_joint_are_ignored(inside, tmp_path):
    assert load(str(written(tmp_path, pendulum(inside, "continuous")))).n == 1


def test_a_chain_of_mimic_joints_has_a_bounded_multiplier(tmp_path):
    names = ["base", *(f"l{k}" for k in range(6))]
    mimics = [f'<mimic joint="j{k - 1}" multiplier="9e5"/>' if k else "" for k in range(6)]
    joints = [joint(f"j{k}", names[k], names[k + 1], inside=LIMIT + mimics[k]) for k in range(6)]
    refused(
        written(tmp_path, document(*(link(name, 1.0) for name in names), *joints)),
        "mimic joint 'j2'",
        "8.1e+11 times 'j0'",
    )


def test_a_body_with_inertia_has_a_mass(tmp_path):
    body = link("arm", 0.0, tensor=np.eye(3) * 0.1)
    refused(written(tmp_path, pendulum(body=body)), "link 'arm'", "mass 0")


@pytest.mark.parametrize("count", [300, 1100])
def test_long_chains_are_read_or_refused(count, tmp_path):
    """A chain of fixed joints: recursive C++ parsers overflow their stack."""
    chain = [joint(f"f{k}", f"b{k}", f"b{k + 1}", "fixed") for k in range(count)]
    parts = [
        *(link(f"b{k}") for k in range(count + 1)),
        *chain,
        link("arm", 1.0),
        joint("swing", f"b{count}", "arm"),
    ]
    path = written(tmp_path, document(*parts))
    if count < 1000:
        assert load(str(path)).n == 1
    else:
        refused(path, f"{count + 2} links")


# -- meshes ----------------------------------------------------------------------------------------


TETRAHEDRON = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def stl(triangles: np.ndarray, count: int | None = None) -> bytes:
    """Return a binary STL; `count` is the number of triangles in its header."""
    head = b"mesh".ljust(80) + struct.pack("<I", len(triangles) if count is None else count)
    return head + b"".join(
        struct.pack("<12fH", 0, 0, 0, *np.ravel(triangle), 0) for triangle in triangles
    )


def shape(
    folder: Path, content: bytes, scale: tuple[float, ...] = (1.0, 1.0, 1.0), name: str = "part.stl"
) -> Shape:
    return Shape("part", ShapeKind.MESH, scale, file=str(written(folder, content, name)))


def touched(mesh: Shape) -> None:
    """Return all geometries that are built from a shape."""
    mesh.solid()
    mesh.hull()
    mesh.triangles()


@pytest.mark.parametrize(
    ("content", "name", "part"),
    [
        (b"", "part.stl", "cannot be read as a mesh"),
        (b"solid x\nfacet normal 0 0 1\n", "part.stl", "part.stl"),
        (stl(TETRAHEDRON[FACES], count=2**32 - 1), "part.stl", "cannot be read as a mesh"),
        (stl(TETRAHEDRON[FACES])[:-30], "part.stl", "cannot be read as a mesh"),
        (stl(np.full((4, 3, 3), np.nan)), "part.stl", "not finite"),
        (stl(np.where(TETRAHEDRON[FACES] > 0.1, np.inf, 0.0)), "part.stl", "not finite"),
        (stl(1e30 * TETRAHEDRON[FACES]), "part.stl", "m long"),
        (stl(np.zeros((4, 3, 3))), "part.stl", "part.stl"),
        (stl(np.linspace(0, 1, 9).reshape(1, 3, 3)), "part.stl", "no area"),
        (b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", "part.obj", "part.obj"),
        (b"v 0 0 0\nv 1 0 0\n", "part.obj", "part.obj"),
        (b"<COLLADA/>", "part.dae", "part.dae"),
        (
            b"<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a 'b'>]><COLLADA>&a;",
            "part.dae",
            "part.dae",
        ),
        (b"\x00\xff" * 500, "part.dae", "part.dae"),
        (b"what", "part.xyz", "part.xyz"),
    ],
)
def test_damaged_meshes_are_refused(content, name, part, tmp_path):
    mesh = shape(tmp_path, content, name=name)
    with pytest.raises(UnusableInput) as caught:
        touched(mesh)
    assert part in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "scale",
    [(0.0, 1.0, 1.0), (1e300, 1.0, 1.0), (np.nan, 1.0, 1.0), (1e-300, 1.0, 1.0), (1e6, 1e6, 1e6)],
)
def test_unrealistic_scales_are_refused(scale, tmp_path):
    with pytest.raises(UnusableInput, match="scale"):
        touched(shape(tmp_path, stl(TETRAHEDRON[FACES]), scale))


def test_a_missing_mesh_is_refused(tmp_path):
    for file in (tmp_path / "absent.stl", tmp_path):
        with pytest.raises(UnusableInput, match="cannot be read as a mesh"):
            touched(Shape("part", ShapeKind.MESH, (1.0, 1.0, 1.0), file=str(file)))


@pytest.mark.parametrize("height", [0.0, 1e-300, 1e-12, 1e-9, 1e-6])
def test_a_flat_mesh_is_its_own_hull(height, tmp_path):
    """The convex hull of coal crashes on flat meshes."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, height]], float)
    mesh = shape(tmp_path, stl(corners[[[0, 1, 2], [0, 2, 3]]]))
    assert distance(mesh, 2.0) == pytest.approx((1.5, 1.5), abs=1e-6)


def distance(mesh: Shape, x: float) -> tuple[float, float]:
    """Return the distances of a mesh and of its hull to a sphere of radius 0.5 on the x axis."""
    import coal

    place, request = (
        coal.Transform3s(np.eye(3), np.array([x + 1.0, 0.0, 0.0])),
        coal.DistanceRequest(),
    )
    ball = coal.Sphere(0.5)
    return tuple(
        coal.distance(s, coal.Transform3s(), ball, place, request, coal.DistanceResult())
        for s in (mesh.solid(), mesh.hull())
    )


def test_triangles_without_area_are_removed(tmp_path):
    """coal reports contact with them at any distance."""
    needle = np.array(
        [[[0.0145, 2.7404076e-15, 0.004], [0.0145, -0.0312, 0.004], [0.0145, 2.7396728e-15, 0.004]]]
    )
    mesh = shape(tmp_path, stl(np.concatenate([TETRAHEDRON[FACES], needle])))
    assert len(mesh.triangles()) == 4
    assert distance(mesh, 2.0) == pytest.approx((2.3, 2.3), abs=1e-4)


def test_reading_a_mesh_imports_no_file_of_the_current_folder(tmp_path, monkeypatch):
    (tmp_path / "coal.py").write_text("raise SystemExit('a file of the current folder ran')")
    monkeypatch.chdir(tmp_path)
    touched(shape(tmp_path, stl(TETRAHEDRON[FACES])))


def test_mirrored_meshes_are_read(tmp_path):
    mesh = shape(tmp_path, stl(TETRAHEDRON[FACES]), (-1.0, 1.0, 1.0))
    assert mesh.triangles().reshape(-1, 3).min() == pytest.approx(-0.2)
    touched(mesh)


def test_the_unreadable_file_of_several_is_named(tmp_path):
    good, bad = (
        written(tmp_path, stl(TETRAHEDRON[FACES]), "good.stl"),
        written(tmp_path, b"solid", "bad.stl"),
    )
    meshes = "".join(
        f'<collision><geometry><mesh filename="{file.name}"/></geometry></collision>'
        for file in (good, bad)
    )
    path = written(tmp_path, pendulum().replace("</link>", meshes + "</link>", 1))
    with pytest.raises(UnusableInput, match=r"bad\.stl"):
        urdf_geometry.read(str(path))
