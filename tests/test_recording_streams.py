"""Parts of recordings, and recordings as streams of blocks."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_fixtures import DamagedMotion, remark_kinds, two_joint_motion, write_columns

from excite import recordings
from excite.errors import ExciteWarning, UnusableInput
from excite.recordings import RemarkKind


def test_part_of_a_recording(two_link, tmp_path, damage):
    recording, _ = damage.rows(np.setdiff1d(np.arange(400), np.arange(200, 230))).read(
        tmp_path, two_link
    )
    part = recording.between(0.5, 1.0)
    assert (
        len(part) == 51
        and (part.t[0], part.t[-1]) == (0.5, 1.0)
        and not part.remarks
        and (part.row_times == part.t).all()
    )
    assert (
        part.tau is not None
        and part.tau.shape == (51, 2)
        and remark_kinds(recording.between(1.0, 3.0)) == [RemarkKind.GAP]
    )
    with pytest.raises(UnusableInput, match="no rows from 9 to 10 s"):
        recording.between(9.0, 10.0)
    with pytest.raises(UnusableInput, match="16 rows without a gap"):
        recording.between(0.0, 0.1).samples()


@given(
    seed=st.integers(0, 10**6), rows=st.integers(256, 700), overlap=st.sampled_from([0, 1, 50, 300])
)
def test_stream_equals_the_complete_recording(two_link, tmp_path_factory, seed, rows, overlap):
    """Delayed and repeated rows, short and long runs of missing values, and gaps are repaired
    across the borders of blocks as in the complete recording."""
    rng = np.random.default_rng(seed)
    columns = two_joint_motion(2000)
    columns["q.joint_1"][rng.integers(20, 1980, 40)] = np.nan
    start = rng.integers(100, 1800)
    columns["tau.joint_2"][start : start + 30] = np.nan
    which = np.argsort(np.arange(2000) + rng.uniform(0.0, 20.0, 2000))
    which = np.insert(which, rng.integers(0, 2000, 5), which[rng.integers(0, 2000)])
    path = write_columns(
        tmp_path_factory.mktemp("r") / "r.csv",
        DamagedMotion(columns).rows(np.unique(which, return_index=False)).columns,
    )
    delayed = write_columns(
        path.with_name("delayed.csv"),
        DamagedMotion(columns)
        .rows(np.argsort(np.arange(2000) + rng.uniform(0.0, 20.0, 2000)))
        .columns,
    )
    for file in (path, delayed):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExciteWarning)
            complete = recordings.read(file, two_link)
            blocks = list(recordings.stream(file, two_link, rows=rows, overlap=overlap))
        assert blocks[0].run_in == 0
        assert np.array_equal(np.concatenate([b.t[b.run_in :] for b in blocks]), complete.t)
        for name in ("q", "dq", "tau"):
            assert np.array_equal(
                np.concatenate([getattr(b, name)[b.run_in :] for b in blocks]),
                getattr(complete, name),
                equal_nan=True,
            )
        for before, after in pairwise(blocks):
            assert after.run_in <= overlap and (
                overlap == 0 or after.run_in >= min(overlap, len(before)) - 31
            )
            assert np.array_equal(
                after.q[: after.run_in],
                np.concatenate([b.q[b.run_in :] for b in blocks])[_repeated_rows(blocks, after)],
            )


def _repeated_rows(blocks: list[recordings.Recording], block: recordings.Recording) -> slice:
    """Rows of the complete recording that a block repeats."""
    start = 0
    for other in blocks:
        if other is block:
            return slice(start - block.run_in, start)
        start += len(other) - other.run_in
    raise AssertionError


def test_stream_resamples_on_one_grid_and_warns_once(two_link, tmp_path):
    columns = two_joint_motion(3000)
    t = columns["t"] = columns["t"] + np.random.default_rng(2).uniform(-1e-3, 1e-3, 3000)
    columns["q.joint_1"] = np.sin(2.0 * t)
    columns["dq.joint_1"] = 2.0 * np.cos(2.0 * t)
    path = write_columns(tmp_path / "r.csv", columns)
    with pytest.warns(ExciteWarning) as caught:
        blocks = list(recordings.stream(path, two_link, rows=500, overlap=20))
    assert len(caught) == 1 and len(blocks) == 6
    t = np.concatenate([b.t[b.run_in :] for b in blocks])
    assert np.ptp(np.diff(t)) < 1e-9 and len(t) >= 2998
    assert (
        np.abs(np.concatenate([b.q[b.run_in :, 0] for b in blocks]) - np.sin(2.0 * t))[5:-5].max()
        < 1e-8
    )
    assert np.allclose(blocks[2].t[: blocks[2].run_in], blocks[1].t[-blocks[2].run_in :])


@pytest.mark.parametrize(
    ("holds", "word"),
    [([4], "positions are refreshed every 4 rows"), ([1, 2, 2, 3], "complete rows repeat")],
)
def test_a_stream_warns_once_of_rows_that_repeat_values(two_link, tmp_path, holds, word):
    columns = two_joint_motion(3000)
    rows = np.cumsum(np.random.default_rng(0).choice(holds, 3000))
    updates = np.union1d([0], rows[rows < 3000])
    latest = updates[np.searchsorted(updates, np.arange(3000), side="right") - 1]
    held = {name: values[latest] for name, values in columns.items()} | {"t": columns["t"]}
    path = write_columns(tmp_path / "r.csv", held)
    with pytest.warns(ExciteWarning, match=word) as caught:
        blocks = list(recordings.stream(path, two_link, rows=500))
    assert len(caught) == 1 and "a stream keeps" in str(caught[0].message)
    assert sum(map(len, blocks)) == 3000
    assert all(word in block.doubts[0].text for block in blocks)


def test_a_stream_of_negative_numbers_stored_unsigned_is_refused(two_link, tmp_path):
    columns = two_joint_motion(3000)
    columns["tau.joint_2"] = np.round(100.0 * columns["tau.joint_2"]) % 2**16
    path = write_columns(tmp_path / "r.csv", columns)
    with pytest.raises(UnusableInput, match="stored unsigned"):
        list(recordings.stream(path, two_link, rows=500))


def test_invalid_streams_are_refused(two_link, tmp_path):
    path = write_columns(tmp_path / "r.csv", two_joint_motion(1000))
    with pytest.raises(UnusableInput, match="at least 256 rows"):
        list(recordings.stream(path, two_link, rows=10))
    repeated = write_columns(
        path, DamagedMotion(two_joint_motion(1000)).rows(np.r_[0:1000, 0:1000]).columns
    )
    with pytest.raises(UnusableInput, match="time goes back"):
        list(recordings.stream(repeated, two_link, rows=300))
