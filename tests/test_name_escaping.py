"""Names with special characters are escaped in programs, pages, tables and figures.

A robot whose joints and links have all characters with a special meaning in some format is
designed for, exported, simulated, identified and reported.
"""

from __future__ import annotations

import ast
import contextlib
import csv
import io
import json
import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from conftest import text_of
from diagnosis_cases import effect_entry
from identified_models import write_model
from test_export import JOINTS, complete_motion

import excite
from excite import exporters
from excite.cli.main import main
from excite.errors import UnusableInput, toml_key
from excite.payload.snippets import snippets
from excite.robot import urdf
from excite.schemas.quantities import Name, converted
from excite.trajectory.rest_to_rest import Motion, MotionSegment

HOSTILE = {
    "joint_1": "$x_1$ <script>alert(1)</script> & \"q\" 'a' {0} %s %n\\n",
    "joint_2": "_" + "é\u202e😀日本,;#`[x](y)" + "z" * 200,
    "link_1": "<b>$L_1$</b> & \" ' { % \\",
    "link_2": "--><!-- -- ]]> </text></svg>",
}
ROBOT = "rob$ot <i>&\"'</i> {x} %d"
FOLDER = "<u>&'$d$ {0} %s"
TAGS_OF_NAMES = {"script", "u"}
"""Elements that are in names and not in the pages of the package."""


def run(*words: object) -> int:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return main([str(word) for word in words])


def done(*words: object) -> None:
    """Run a command and check that it succeeds."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(word) for word in words])
    assert code == 0, err.getvalue()


def renamed(text: str) -> str:
    """Return a URDF with special names; no original name is a prefix of another."""
    root = ElementTree.fromstring(text)
    root.set("name", ROBOT)
    for element in root.iter():
        for key in ("name", "link", "joint"):
            if element.get(key) in HOSTILE:
                element.set(key, HOSTILE[str(element.get(key))])
    return ElementTree.tostring(root, encoding="unicode")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the files of all commands."""
    folder = tmp_path_factory.mktemp("hostile") / FOLDER
    folder.mkdir()
    robot, table = folder / "robot.urdf", folder / "limits.toml"
    robot.write_text(renamed(text_of("two_link")), encoding="utf-8")
    limits = {"acceleration": 15.0, "jerk": 200.0}
    stated = [f"{key} = {value}" for key, value in limits.items()]
    tables = [
        "\n".join([f"[joints.{toml_key(HOSTILE[j])}]", *stated]) for j in ("joint_1", "joint_2")
    ]
    table.write_text("\n".join(tables), encoding="utf-8")
    quick = ("--period", 2, "--harmonics", 3, "--samples", 40, "--starts", 1, "--iterations", 5)
    words = ("design", robot, "--limits", table, *quick, "--jobs", 1)
    done(*words, "-o", folder / "design")
    pytest.importorskip("mujoco")
    trajectory = folder / "design" / "trajectory.json"
    done("verify", trajectory)
    words = ("simulate", robot, trajectory, "--periods", 4)
    done(*words, "--effect", f"stribeck:{HOSTILE['joint_2']}", "-o", folder / "first.csv")
    done(*words, "--seed", 1, "-o", folder / "second.csv")
    recordings = (folder / "first.csv", "--validate", folder / "second.csv")
    done("identify", robot, *recordings, "-o", folder / "identify")
    done("diagnose", robot, *recordings, "-o", folder / "diagnose")
    out = ("-o", folder / "identifiability")
    done("identifiability", robot, trajectory, "--limits", table, *out)
    model = folder / "identify" / "model.json"
    done("predict", model, folder / "second.csv", "-o", folder / "torque.csv")
    return folder


class Page(HTMLParser):
    """Elements, attributes and text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.attributes: set[str] = set()
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.attributes |= {key for key, _ in attrs}

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.mark.parametrize("report", ["design", "identify", "diagnose", "identifiability"])
def test_names_are_text_in_reports(folder, report):
    text = (folder / report / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert not page.tags.keys() & TAGS_OF_NAMES
    assert all(re.fullmatch(r"[a-zA-Z:-]+", key) for key in page.attributes)
    assert HOSTILE["joint_1"].replace(" %", "\u00a0%") in "".join(page.words)
    figures = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert figures
    for figure in figures:
        ElementTree.fromstring(figure)


def test_names_are_text_in_figures(folder):
    root = ElementTree.parse(folder / "first.svg").getroot()
    words = [element.text for element in root.iter() if element.tag.endswith("text")]
    assert HOSTILE["joint_1"] in words and HOSTILE["joint_2"] in words


def test_names_are_the_same_in_tables(folder):
    joints = [HOSTILE["joint_1"], HOSTILE["joint_2"]]
    for path, kinds in (
        (folder / "design" / "trajectory.csv", ("q", "dq", "ddq", "tau")),
        (folder / "first.csv", ("q", "tau", "qref")),
        (folder / "torque.csv", ("tau",)),
    ):
        with path.open(encoding="utf-8", newline="") as stream:
            header = next(csv.reader(stream))
        assert header == ["t", *(f"{kind}.{joint}" for kind in kinds for joint in joints)]


def test_names_are_the_same_in_the_identified_robot(folder):
    root = ElementTree.parse(folder / "identify" / "identified.urdf").getroot()
    assert root.get("name") == ROBOT
    written = {element.get("name") for element in root.iter() if element.tag in ("joint", "link")}
    assert set(HOSTILE.values()) <= written
    quick = ("--period", 2, "--harmonics", 3, "--samples", 40, "--starts", 1, "--iterations", 2)
    words = ("design", folder / "identify" / "identified.urdf", *quick, "--jobs", 1)
    assert run(*words, "--force", "-o", folder / "again") in (0, 1)


@pytest.mark.parametrize("name", exporters.FORMATS)
def test_names_do_not_enter_programs(name, tmp_path):
    """Lines that are no comments do not depend on the names."""
    trajectory = complete_motion(JOINTS.get(name, 2))
    joints = tuple(f"{i} {HOSTILE['joint_1']}" for i in range(len(trajectory.joints)))
    motion = replace(trajectory.motion, joints=joints)
    limits = replace(trajectory.limits, joints=joints)
    robot = {**trajectory.robot, "name": f"{ROBOT}\u2028movej()\u0085stopj(9)\x1b[2J"}
    collision = "collision checked\r\nset_digital_out(0, True)\x0b\x0c# \x00"
    hostile = replace(trajectory, motion=motion, limits=limits, robot=robot, collision=collision)
    if name == "json":
        robot, collision = trajectory.robot, "collision checked\nset_digital_out(0, True)"
        hostile = replace(hostile, robot=robot, collision=collision)
    texts = [
        exporters.write(stated, name, tmp_path / f"{i}").read_text(encoding="utf-8")
        for i, stated in enumerate((trajectory, hostile))
    ]
    if name == "json":
        assert json.loads(texts[1])["collision"] == collision
        assert exporters.read("json", tmp_path / "1")
    elif name == "csv":
        rows = [list(csv.reader(io.StringIO(text))) for text in texts]
        assert rows[0][1:] == rows[1][1:] and len(rows[0][0]) == len(rows[1][0])
    elif name.startswith("ros2"):
        documents = [yaml.load(text, yaml.CSafeLoader) for text in texts]
        assert documents[1] == json.loads(texts[1])
        for document, stated in zip(documents, (trajectory.joints, joints), strict=True):
            body = document.get("trajectory", document)
            assert tuple(body.pop("joint_names")) == stated
        assert documents[0] == documents[1]
    else:
        programs = [[line for line in t.split("\n") if not line.startswith("#")] for t in texts]
        assert programs[0] == programs[1]
        assert all(letter.isprintable() or letter == "\n" for text in texts for letter in text)
        assert all(text.isascii() for text in texts)


CODE = {
    "joint_1": "a*/ int injected_1; /*/ b \\",
    "joint_2": '--> <injected/> """ --- </robot> -->',
    "link_1": "**/ int injected_2; /* ---",
    "link_2": "\"\"\"; injected = 3; ''' --> <injected/>",
}
"""Names that end the comments and strings of some language."""


def statements(text: str, format: str) -> object:
    """Return what a program does apart from its names: C without comments, statements of Python,
    elements of XML."""
    if format == "c":
        return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    if format in ("isaaclab", "python-friction"):
        return [type(node) for node in ast.walk(ast.parse(text))]
    return [element.tag for element in ElementTree.fromstring(text).iter()]


@pytest.mark.parametrize("format", exporters.MODEL_FORMATS)
def test_names_do_not_enter_the_files_of_an_identified_robot(format, tmp_path):
    plain, hostile = text_of("two_link"), ElementTree.fromstring(text_of("two_link"))
    hostile.set("name", CODE["link_2"])
    for element in hostile.iter():
        for key in ("name", "link", "joint"):
            element.set(key, CODE.get(str(element.get(key)), str(element.get(key))))
    texts = []
    for i, text in enumerate((plain, ElementTree.tostring(hostile, encoding="unicode"))):
        folder = tmp_path / str(i)
        folder.mkdir()
        (folder / "robot.urdf").write_text(text, encoding="utf-8")
        joint = CODE["joint_2"] if i else "joint_2"
        # a parabola without a zero: MJCF states in a comment that the offset has no place
        parabola = effect_entry("spring", joint, {"form": 2.0}, 0.0, 500.0)
        path = write_model(folder, str(folder / "robot.urdf"), (parabola,))
        texts.append(excite.export_model(path, format).text)
    assert statements(texts[0], format) == statements(texts[1], format)


def test_names_do_not_enter_the_snippets_of_a_payload():
    body = pin.Inertia.Random()
    for name in CODE.values():
        for words, text in snippets(body, name).items():
            plain = snippets(body, "link")[words]
            if words in ("URDF", "MJCF"):
                tags = [
                    [e.tag for e in ElementTree.fromstring(f"<robot>{t}</robot>").iter()]
                    for t in (plain, text)
                ]
                assert tags[0] == tags[1]
            else:
                assert text.splitlines()[1:] == plain.splitlines()[1:]


def test_the_kind_of_a_segment_stays_in_its_comment(tmp_path):
    """A motion that is built in Python may have other kinds of segments than files have."""
    trajectory = complete_motion(6)
    kind = "fourier\n  set_digital_out(0, True)\r  movej()\u2028#"
    odd = tuple(
        MotionSegment(kind if segment.profile is None else segment.kind, *segment_rest(segment))
        for segment in trajectory.motion.segments
    )
    motion = trajectory.motion
    hostile = replace(trajectory, motion=Motion(motion.joints, motion.fourier, motion.periods, odd))
    texts = [
        exporters.write(stated, "urscript", tmp_path / "p.script").read_text(encoding="utf-8")
        for stated in (trajectory, hostile)
    ]
    programs = [[li for li in t.split("\n") if not li.lstrip().startswith("#")] for t in texts]
    assert programs[0] == programs[1] and "\r" not in texts[1]


def segment_rest(segment: MotionSegment) -> tuple[object, ...]:
    return segment.start, segment.end, segment.profile


@pytest.mark.parametrize(
    "name", ["a\nb", "a\tb", "\x1b[31m", "a\u2028b", "\x85", " ", "", "n" * 1001]
)
def test_a_name_with_a_line_break_is_refused(name):
    with pytest.raises(ValueError, match="the name "):
        converted(Name, name)


def test_a_joint_name_with_a_line_break_is_refused_before_writing(tmp_path):
    """The XML parser accepts it as a character reference."""
    text = text_of("two_link").replace(
        'name="joint_1"', 'name="joint&#10;set_digital_out(0, True)"'
    )
    path = tmp_path / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnusableInput, match="control character"):
        urdf.read(path)
    assert run("design", path, "-o", tmp_path / "out") == 2
    assert not (tmp_path / "out").exists()


def test_names_that_look_like_numbers_are_not_rounded_in_figures(folder):
    """Numbers in the SVG are rounded, texts are not."""
    from excite.report.figures.drawing import render_svg as render

    name = "joint 1.23456 font-family: x xlink:href"

    def draw(figure: object) -> None:
        axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))  # type: ignore[attr-defined]
        axes.plot([0.123456789, np.pi], [0.0, 1.0])
        axes.set_title(name)

    root = ElementTree.fromstring(render("a figure", 2.0, draw))
    assert name in [element.text for element in root.iter() if element.tag.endswith("text")]
