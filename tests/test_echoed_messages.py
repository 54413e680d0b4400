"""Text of `ros2 topic echo /joint_states` and of `rostopic echo`, read as a recording."""

from __future__ import annotations

import gzip
import re
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from recording_fixtures import (
    JOINTS,
    assert_refused,
    read_with_warnings,
    remark_kinds,
    two_joint_motion,
)

from excite import recordings
from excite.cli import main as main_module
from excite.recordings import RemarkKind
from excite.robot import robot

START = 1_700_000_000
"""Time of the first message [s since 1970]."""
FIELDS = {"position": "q", "velocity": "dq", "effort": "tau"}


def block_list(field: str, elements: Sequence[str]) -> str:
    """Return a field as `ros2 topic echo` prints it."""
    if not elements:
        return f"{field}: []\n"
    return f"{field}:\n" + "".join(f"- {element}\n" for element in elements)


def ros_2(nanoseconds: int, lists: dict[str, list[str]]) -> str:
    """Return a message as `ros2 topic echo` prints it."""
    sec, nanosec = divmod(nanoseconds, 10**9)
    header = f"header:\n  stamp:\n    sec: {sec}\n    nanosec: {nanosec}\n  frame_id: ''\n"
    return header + "".join(block_list(*field) for field in lists.items())


def ros_1(nanoseconds: int, lists: dict[str, list[str]]) -> str:
    """Return a message as `rostopic echo` prints it."""
    secs, nsecs = divmod(nanoseconds, 10**9)
    header = f"header: \n  seq: 12\n  stamp: \n    secs: {secs}\n    nsecs:  {nsecs}\n"
    return header + "".join(f"{name}: [{', '.join(cells)}]\n" for name, cells in lists.items())


def flow_style(nanoseconds: int, lists: dict[str, list[str]]) -> str:
    """Return a message as `ros2 topic echo --flow-style` prints it."""
    sec, nanosec = divmod(nanoseconds, 10**9)
    stamp = f"{{header: {{stamp: {{sec: {sec}, nanosec: {nanosec}}}, frame_id: ''}}, "
    fields = ", ".join(f"{name}: [{', '.join(cells)}]" for name, cells in lists.items())
    return f"{stamp}{fields}}}\n"


def messages(
    style=ros_2, joints: Sequence[str] = JOINTS, fields: Sequence[str] = tuple(FIELDS)
) -> list[str]:
    """Return the messages of `two_joint_motion`, without the lines between them."""
    columns = two_joint_motion()
    out = []
    for k, t in enumerate(columns["t"]):
        lists = {"name": list(joints)}
        for field, prefix in FIELDS.items():
            values = [repr(float(columns[f"{prefix}.{joint}"][k])) for joint in joints]
            lists[field] = values if field in fields else []
        out.append(style(START * 10**9 + round(1e9 * t), lists))
    return out


def text_of(documents: Sequence[str]) -> str:
    """Join messages as they are printed."""
    return "".join(f"{document}---\n" for document in documents)


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", newline="")
    return path


def assert_motion(recording: recordings.Recording, rows: int = 400) -> None:
    """Assert that a recording holds the first rows of `two_joint_motion`."""
    columns = two_joint_motion()
    assert recording.t == pytest.approx(columns["t"][:rows], abs=1e-9)
    for name, prefix in (("q", "q"), ("dq", "dq"), ("tau", "tau")):
        for i, joint in enumerate(JOINTS):
            assert (getattr(recording, name)[:, i] == columns[f"{prefix}.{joint}"][:rows]).all()


@pytest.mark.parametrize("style", [ros_2, ros_1, flow_style])
@pytest.mark.parametrize("name", ["states.txt", "states.yaml", "states.csv", "states"])
def test_printed_messages_are_a_recording(style, name, two_link, tmp_path):
    recording, texts = read_with_warnings(
        written(tmp_path / name, text_of(messages(style))), two_link
    )
    assert_motion(recording)
    assert not texts


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n").encode(),
        lambda text: text.encode("utf-16"),
        lambda text: gzip.compress(text.encode()),
        lambda text: ("WARNING: topic [/joint_states] does not exist yet\n" + text).encode(),
        lambda text: text.replace("- joint_1", '- "joint_1"').encode(),
        lambda text: ("---\n" + text).removesuffix("---\n").encode(),
    ],
    ids=["Windows", "PowerShell", "gzip", "warning", "quotes", "dump_all"],
)
def test_files_of_printed_messages_as_they_occur(change, two_link, tmp_path):
    path = tmp_path / "states.txt"
    path.write_bytes(change(text_of(messages())))
    recording, texts = read_with_warnings(path, two_link)
    assert_motion(recording)
    assert not texts


def test_order_of_joints_may_differ_between_messages(two_link, tmp_path):
    text = text_of([*messages()[:200], *messages(joints=JOINTS[::-1])[200:]])
    recording, _ = read_with_warnings(written(tmp_path / "states.txt", text), two_link)
    assert_motion(recording)


def test_notices_of_lost_messages_and_other_joints_are_left_out(two_link, tmp_path):
    documents = messages()
    notice = "A message was lost!!!\n\ttotal count change:1\n\ttotal count: 1---\n"
    gripper = ros_2(START * 10**9 + 5, {"name": ["finger"], "position": ["0.1"]})
    text = text_of(documents[:100]) + notice + text_of([gripper, *documents[100:]])
    recording, texts = read_with_warnings(written(tmp_path / "states.txt", text), two_link)
    assert_motion(recording)
    assert len(texts) == 1 and "lack some of the robot's joints" in texts[0]


@pytest.mark.parametrize("style", [ros_2, ros_1, flow_style])
def test_the_last_message_may_be_cut_anywhere(style, two_link, tmp_path):
    whole, last = text_of(messages(style)[:-1]), messages(style)[-1]
    for length in (2, 40, len(last) // 2, len(last) - 3):
        path = written(tmp_path / "states.txt", whole + last[:length])
        recording, texts = read_with_warnings(path, two_link)
        assert_motion(recording, 399)
        assert [text.partition(": ")[2] for text in texts] == [
            "the last message is cut short and left out"
        ]


def test_a_value_that_is_no_number_leaves_its_message_out(two_link, tmp_path):
    documents = messages()
    documents[50] = re.sub(r"position:\n- [^\n]*", "position:\n- garbled", documents[50])
    path = written(tmp_path / "states.txt", text_of(documents))
    recording, texts = read_with_warnings(path, two_link)
    assert "1 message that cannot be read is left out" in texts[0]
    assert len(recording) == 400 and RemarkKind.JITTER in remark_kinds(recording)


def test_missing_values_of_yaml_are_interpolated(two_link, tmp_path):
    documents = messages()
    documents[50] = re.sub(r"effort:\n- [^\n]*", "effort:\n- .nan", documents[50])
    path = written(tmp_path / "states.txt", text_of(documents))
    _, texts = read_with_warnings(path, two_link)
    assert [text.partition(": ")[2] for text in texts] == [
        "joint 'joint_1': 1 missing value of tau, 1 interpolated"
    ]


def test_messages_of_single_joints_are_merged(two_link, tmp_path):
    pairs = zip(messages(joints=JOINTS[:1]), messages(joints=JOINTS[1:]), strict=True)
    text = text_of([document for pair in pairs for document in pair])
    recording, texts = read_with_warnings(written(tmp_path / "states.txt", text), two_link)
    assert_motion(recording)
    assert len(texts) == 1 and "merged in time" in texts[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: re.sub(r"sec: \d+", "sec: 0", text), ("stamps", "zero", "bag")),
        (
            lambda text: re.sub(
                r"(\w+):\n(?:- .*\n)+", r"\1: '<sequence type: double, length: 2>'\n", text
            ),
            ("without their arrays", "--no-arr"),
        ),
        (lambda text: text.replace("joint_2", "elbow"), ("'joint_2' is missing", "--joints")),
        (lambda text: text.replace("name:", "joint_names:"), ("JointState", "echo")),
        (lambda text: "- 0.1\n- 0.2\n---\n" * 20, ("JointState", "echo")),
        (lambda text: text.partition("---")[0] + "---\n", ("1 row ", "record more")),
    ],
    ids=["zero stamps", "no arrays", "other joint", "other type", "single field", "one message"],
)
def test_text_that_is_no_recording_is_refused(change, words, two_link, tmp_path):
    path = written(tmp_path / "states.txt", change(text_of(messages())))
    assert_refused(path, two_link, *words)


def test_names_of_columns_do_not_fit_messages(two_link, tmp_path):
    path = written(tmp_path / "states.txt", text_of(messages()))
    assert_refused(path, two_link, "leave --columns out", columns={"t": "stamp"})


def test_a_command_refuses_other_yaml_in_one_line(tmp_path, capsys):
    path = written(tmp_path / "states.yaml", "rate: 100\n")
    words = ["identify", "two_link", str(path), "-o", str(tmp_path / "out")]
    assert main_module.main(words) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and str(path) in lines[0] and "ros2 topic echo" in lines[0]


def test_a_long_text_is_read_block_by_block_and_fast(tmp_path):
    """20,000 messages of seven joints take 2 s; PyYAML would take 8 s."""
    panda = robot.load("panda")
    t = np.arange(20_000) / 500.0
    centre = np.array([np.mean(entry.position or (0.0, 0.0)) for entry in panda.entries])
    q = (centre + 0.1 * np.sin(np.outer(t, 1.0 + np.arange(7.0) / 3.0))).round(9)
    text = text_of(
        [
            ros_2(
                START * 10**9 + round(1e9 * t[k]),
                {"name": list(panda.joints), "position": list(map(repr, q[k].tolist()))},
            )
            for k in range(len(t))
        ]
    )
    path = written(tmp_path / "states.txt", text)
    start = time.process_time()
    recording = recordings.read(path, panda)
    assert time.process_time() - start < 15.0
    assert (recording.q == q).all()
    blocks = list(recordings.stream(path, panda, rows=5000))
    assert np.array_equal(np.concatenate([block.q for block in blocks]), q)
