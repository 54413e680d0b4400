"""JointState messages of bags, written with the package that reads them."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from slow_tests import slow

rosbags = pytest.importorskip("rosbags", reason="bags need pip install 'excite[bags]'")

from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

from excite import recordings  # noqa: E402
from excite._types import FloatArray  # noqa: E402
from excite.errors import ExciteWarning, UnusableInput  # noqa: E402
from excite.recordings import RemarkKind  # noqa: E402
from excite.robot.robot import load  # noqa: E402

STORE = get_typestore(Stores.ROS2_HUMBLE)
JOINTS = ("joint_1", "joint_2")
TRAJECTORY = Path(__file__).resolve().parents[1] / "trajectories" / "ur5e.json"
START = 1_700_000_000_000_000_000
T = np.arange(300) / 100.0
Q = np.column_stack([np.sin(2.0 * T), np.cos(T)])
DQ = np.column_stack([2.0 * np.cos(2.0 * T), -np.sin(T)])
TAU = np.column_stack([np.cos(5.0 * T), np.sin(7.0 * T)])


def message(t: float, names: Sequence[str], *values: FloatArray, stamped: bool = True):
    types = STORE.types
    nanoseconds = START + round(t * 1e9) if stamped else 0
    stamp = types["builtin_interfaces/msg/Time"](
        sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
    )
    arrays = [np.asarray(v, float) for v in (*values, *([[]] * (3 - len(values))))]
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    return types["sensor_msgs/msg/JointState"](header, list(names), *arrays)


def arm(stamped: bool = True):
    """Messages of an arm with joints in changing order and a joint that the robot does not have."""
    for k, t in enumerate(T):
        order = [1, 0] if k % 3 else [0, 1]
        yield (
            t,
            message(
                t,
                [*(JOINTS[i] for i in order), "finger"],
                *(np.append(v[k, order], 9.0) for v in (Q, DQ, TAU)),
                stamped=stamped,
            ),
        )


def write(path: Path, topics: dict, storage: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    kind = "sensor_msgs/msg/JointState"
    with Writer(path, version=9, storage_plugin=storage) as writer:
        rows = []
        for topic, messages in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            rows += [(t, connection, m) for t, m in messages]
        for t, connection, m in sorted(rows, key=lambda row: row[0]):
            writer.write(
                connection, START + 5_000_000 + round(t * 1e9), STORE.serialize_cdr(m, kind)
            )
    return path


@pytest.mark.parametrize("form", ["folder", "mcap folder", "mcap", "db3"])
def test_bags_are_read_by_joint_name(two_link, tmp_path, form):
    path = write(
        tmp_path / "bag",
        {"/joint_states": arm()},
        StoragePlugin.MCAP if "mcap" in form else StoragePlugin.SQLITE3,
    )
    if "folder" not in form:
        path = next(path.glob(f"*.{form}"))
    recording = recordings.read(path, two_link)
    assert (
        np.allclose(recording.t, T, atol=1e-9)
        and (recording.q == Q).all()
        and (recording.dq == DQ).all()
        and (recording.torque == TAU).all()
    )
    assert [r.kind for r in recording.remarks] == [
        RemarkKind.UNIT
    ] and "effort is taken to be in N m" in recording.remarks[0].text
    blocks = list(recordings.stream(path, two_link, rows=256, overlap=10))
    assert np.array_equal(np.concatenate([b.q[b.run_in :] for b in blocks]), Q)


def test_effort_may_be_current(two_link, tmp_path):
    path = write(tmp_path / "bag", {"/joint_states": arm()})
    sidecar = {
        "schema": "excite.recording/1",
        "effort": "current",
        "drive_gain": {"joint_1": 2.0, "joint_2": 3.0},
    }
    (tmp_path / "bag.json").write_text(json.dumps(sidecar))
    recording = recordings.read(path, two_link)
    assert (
        recording.tau is None
        and (recording.torque == TAU * [2.0, 3.0]).all()
        and not recording.remarks
    )


def test_messages_of_other_joints_are_skipped(two_link, tmp_path):
    fingers = [(t + 1e-3, message(t, ["finger"], [0.1])) for t in T[::2]]
    path = write(tmp_path / "bag", {"/joint_states": [*arm(), *fingers]})
    with pytest.warns(ExciteWarning, match="150 messages on /joint_states that lack"):
        recording = recordings.read(path, two_link)
    assert (recording.q == Q).all()


def test_time_of_reception_replaces_zero_stamps(two_link, tmp_path):
    path = write(tmp_path / "bag", {"/joint_states": arm(stamped=False)})
    with pytest.warns(ExciteWarning, match="time of reception"):
        assert np.allclose(recordings.read(path, two_link).t, T, atol=1e-9)


def test_selection_of_the_topic(two_link, tmp_path):
    other = [(t, message(t, ["finger"], [0.1])) for t in T]
    path = write(tmp_path / "one", {"/gripper": other, "/arm": arm()})
    assert (recordings.read(path, two_link).q == Q).all()
    path = write(tmp_path / "two", {"/copy": arm(), "/arm": arm()})
    with pytest.raises(
        UnusableInput,
        match=r"several topics with all of joint_1, joint_2 among '/arm', '/copy'; .*two\.json",
    ):
        recordings.read(path, two_link)
    (tmp_path / "two.json").write_text('{"schema": "excite.recording/1", "topic": "/copy"}')
    assert (recordings.read(path, two_link).q == Q).all()
    (tmp_path / "two.json").write_text('{"schema": "excite.recording/1", "topic": "/none"}')
    with pytest.raises(UnusableInput, match="no topic '/none'"):
        recordings.read(path, two_link)
    path = write(tmp_path / "none", {"/gripper": other, "/tool": other})
    with pytest.raises(UnusableInput, match="no topic with all of joint_1, joint_2"):
        recordings.read(path, two_link)


def test_bags_without_the_joints_are_refused(two_link, tmp_path):
    path = write(
        tmp_path / "bag",
        {"/joint_states": [(t, message(t, ["joint_1", "joint2"], [0.1, 0.2])) for t in T]},
    )
    with pytest.raises(
        UnusableInput, match=r"joint 'joint_2' is missing \(similar: .*'joint2'.*--joints"
    ):
        recordings.read(path, two_link)
    path = write(tmp_path / "nothing", {})
    with pytest.raises(
        UnusableInput, match=r"no topic of sensor_msgs/msg/JointState|cannot be read as a bag"
    ):
        recordings.read(path, two_link)
    path = write(
        tmp_path / "odd", {"/joint_states": [(t, message(t, JOINTS, [0.1, 0.2], [1.0])) for t in T]}
    )
    with pytest.raises(UnusableInput, match="1 values of velocity for 2 joints"):
        recordings.read(path, two_link)


def test_positions_alone_and_incomplete_arrays(two_link, tmp_path):
    path = write(
        tmp_path / "bag",
        {"/joint_states": [(t, message(t, JOINTS, q)) for t, q in zip(T, Q, strict=True)]},
    )
    recording = recordings.read(path, two_link)
    assert recording.dq is None and recording.tau is None and not recording.remarks
    rows = [(t, message(t, JOINTS, Q[k], DQ[k] if k != 50 else [])) for k, t in enumerate(T)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = recordings.read(write(tmp_path / "gone", {"/joint_states": rows}), two_link)
    assert len(caught) == 2 and recording.dq is not None and np.isfinite(recording.dq).all()


@pytest.mark.parametrize("hashes", [0, 1, slow(2), slow(3)])
def test_messages_with_efforts_precede_those_with_velocities(tmp_path, hashes):
    """Whatever the order of a set, which the seed of Python's hashes decides."""
    rows = [
        (t, message(t, JOINTS, Q[k], *((DQ[k],) if k % 2 else ([], TAU[k]))))
        for k, t in enumerate(T)
    ]
    path = write(tmp_path / "bag", {"/joint_states": rows})
    program = (
        "import sys; from pathlib import Path; from excite import load_robot, read_recording; "
        "r = read_recording(Path(sys.argv[1]), load_robot('two_link')); "
        "print(r.tau is None, r.dq is None)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program, str(path)],
        env={**os.environ, "PYTHONHASHSEED": str(hashes)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["False", "True"]


def test_broken_bags_are_refused(two_link, tmp_path):
    (tmp_path / "folder").mkdir()
    for path, word in (
        (tmp_path / "folder", "without metadata.yaml"),
        (tmp_path / "r.mcap", "cannot be read as a bag"),
    ):
        if path.suffix:
            path.write_bytes(b"\x89MCAP0\r\n" + bytes(40))
        with pytest.raises(UnusableInput, match=word):
            recordings.read(path, two_link)
    complete = next(
        write(tmp_path / "bag", {"/joint_states": arm()}, StoragePlugin.MCAP).glob("*.mcap")
    ).read_bytes()
    for size in (9, 60, len(complete) // 2):
        (tmp_path / "r.mcap").write_bytes(complete[:size])
        with pytest.raises(UnusableInput, match="cannot be read as a bag"):
            recordings.read(tmp_path / "r.mcap", two_link)


def test_missing_package_is_reported(two_link, tmp_path, monkeypatch):
    path = write(tmp_path / "bag", {"/joint_states": arm()})
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(UnusableInput, match=r"pip install 'excite\[bags\]'"):
        recordings.read(path, two_link)


def test_bags_of_ros_1_are_read(two_link, tmp_path):
    from rosbags.rosbag1 import Writer as Writer1

    store = get_typestore(Stores.ROS1_NOETIC)
    types, kind = store.types, "sensor_msgs/msg/JointState"
    with Writer1(tmp_path / "r.bag") as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for k, t in enumerate(T):
            now = START + round(t * 1e9)
            stamp = types["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)
            header = types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="")
            state = types[kind](header, list(JOINTS), Q[k], DQ[k], np.empty(0))
            writer.write(connection, now, store.serialize_ros1(state, kind))
    recording = recordings.read(tmp_path / "r.bag", two_link)
    assert (
        (recording.q == Q).all()
        and (recording.dq == DQ).all()
        and recording.tau is None
        and not recording.remarks
    )


# -- a recorded motion -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def logged_bag(tmp_path_factory) -> tuple[Path, float, tuple[float, float]]:
    """Bag of a simulated UR5e at 100 Hz, its period, and the window in which it repeats.

    The robot stands at the start pose for 5 s before the motion. Stamps deviate by up to 2 ms from
    an even grid; positions and torques are those at the stamps.
    """
    pytest.importorskip("mujoco")
    from excite import api

    folder = tmp_path_factory.mktemp("logged")
    api.simulate("ur5e", TRAJECTORY, periods=4, seed=7).save(folder / "clean.csv")
    clean = recordings.read(folder / "clean.csv", load("ur5e"))
    generator = np.random.default_rng(0)
    even = np.arange(0.0, clean.t[-1] + 5.0, 0.01)
    stamps = even + generator.uniform(-0.002, 0.002, len(even))
    inner = np.clip(stamps - 5.0, 0.0, clean.t[-1])
    q, tau = (
        np.column_stack([np.interp(inner, clean.t, column) for column in values.T])
        for values in (clean.q, clean.tau)
    )
    floor = np.std(np.diff(clean.tau, axis=0), axis=0) / np.sqrt(2.0)
    tau += floor * generator.standard_normal(tau.shape) * (stamps < 5.0)[:, None]
    rows = [
        (t, message(t, clean.joints, q[k], np.empty(0), tau[k]))
        for k, t in enumerate(stamps - stamps[0])
    ]
    period, (start, end) = clean.repetition
    path = write(folder / "run1", {"/joint_states": rows}, StoragePlugin.MCAP)
    return path, period, (start + 5.0 - stamps[0], end + 5.0 - stamps[0])


@pytest.mark.slow
def test_directions_of_a_bag_do_not_depend_on_what_is_stated(logged_bag):
    from excite import api

    path, period, window = logged_bag
    counts = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for choice in ({"period": period, "window": window}, {"trajectory": TRAJECTORY}, {}):
            result = api.identify("ur5e", [path], **choice)
            counts.append(result.identification.analysis.identifiable_count)
            assert not result.recordings[0].doubts
    assert max(counts) - min(counts) <= 3, counts
    assert min(counts) > 35, counts


@pytest.mark.parametrize("is_split", [True, False])
def test_positions_of_locked_joints_are_compared(tmp_path, is_split):
    standing = np.column_stack([np.ones(len(T)), Q[:, 1]])
    parts = [[0], [1]] if is_split else [[0, 1]]
    messages = [
        (t + 1e-3 * part[0], message(t, [JOINTS[i] for i in part], standing[k, part]))
        for k, t in enumerate(T)
        for part in parts
    ]
    path = write(tmp_path / "bag", {"/joint_states": messages})
    with pytest.raises(UnusableInput, match="locked at 0 rad, but stands at 1 rad"):
        recordings.read(path, load("two_link", joints=("joint_2",)))


def one_publisher_a_joint(late: int = 0, missing: tuple[int, ...] = ()):
    """Messages of single joints, the first ones without effort, some with NaN as effort."""
    return [
        (
            t + 1e-3 * i,
            message(
                t + 1e-3 * i,
                [JOINTS[i]],
                [Q[k, i]],
                [],
                [] if k < late else [np.nan if k in missing else TAU[k, i]],
            ),
        )
        for k, t in enumerate(T)
        for i in (0, 1)
    ]


@pytest.mark.parametrize(
    ("late", "missing", "lost"), [(1, (), 2), (0, (100,), 0), (0, tuple(range(100, 140)), 41)]
)
def test_missing_efforts_of_single_joints_cost_their_rows_alone(
    two_link, tmp_path, late, missing, lost
):
    path = write(tmp_path / "bag", {"/joint_states": one_publisher_a_joint(late, missing)})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = recordings.read(path, two_link)
    assert any("merged in time" in str(entry.message) for entry in caught)
    assert len(T) - 2 - lost <= len(recording) <= len(T)
    assert recording.tau is not None and np.isfinite(recording.tau).all()
    assert np.abs(recording.tau[:, 0] - np.cos(5.0 * recording.t)).max() < 0.06


@pytest.mark.parametrize(
    "others",
    [
        [(-0.1, message(-0.1, JOINTS, [0.0, 0.0]))],
        [(t + 2e-3, message(t + 2e-3, JOINTS, Q[5 * k])) for k, t in enumerate(T[::5])],
        [(t + 2e-3, message(t + 2e-3, JOINTS, Q[k] + 0.1)) for k, t in enumerate(T)],
    ],
    ids=["announced once", "slow aggregator", "aggregator"],
)
def test_publishers_of_all_joints_without_efforts_hide_none(two_link, tmp_path, others):
    path = write(tmp_path / "bag", {"/joint_states": [*one_publisher_a_joint(), *others]})
    with pytest.warns(ExciteWarning, match=f"{len(others)} messages that hold all of them"):
        recording = recordings.read(path, two_link)
    assert recording.tau is not None
    assert np.abs(recording.q[:, 0] - np.sin(2.0 * recording.t)).max() < 0.01


def test_bag_that_is_the_working_folder_keeps_its_sidecar(two_link, tmp_path):
    path = write(tmp_path / "bag", {"/joint_states": arm()})
    (tmp_path / "bag.json").write_text('{"schema": "excite.recording/1", "effort": "torque"}')
    with contextlib.chdir(path):
        assert recordings.read(Path(), two_link).sidecar.effort == "torque"
