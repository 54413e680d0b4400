"""The language of the project, by its own check."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import excite

ROOT = Path(__file__).resolve().parents[1]


CLEAN = (
    "excite/collision",
    "excite/designer",
    "excite/diagnosis",
    "excite/effects",
    "excite/identification",
    "excite/recordings",
    "excite/report",
    "excite/schemas",
    "excite/simulator",
    "excite/trajectory",
    "scripts/bench_csv.py",
    "scripts/concealed_trial",
    "tests/recording_fixtures.py",
    "tests/synthetic_recordings.py",
    "tests/test_collision.py",
    "tests/test_collision_cli.py",
    "tests/test_collision_start.py",
    "tests/test_diagnosis_columns.py",
    "tests/test_gear_encoders.py",
    "tests/test_hostile_recordings.py",
    "tests/test_quantization.py",
    "tests/test_recording_formats.py",
    "tests/test_recording_repair.py",
    "tests/test_recording_streams.py",
    "tests/test_rosbag_reader.py",
    "tests/test_timestamp_jitter.py",
    "tests/test_view_cli.py",
    "README.md",
)
"""What follows the rules so far; the rest of the project is to join it."""


def test_the_style_check_finds_nothing():
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "style_check.py"), *(str(ROOT / p) for p in CLEAN)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_the_public_interface_is_importable_and_documented():
    for name in excite.__all__:
        documented = getattr(excite, name)
        assert documented.__doc__, name
    assert set(excite.__all__) <= set(dir(excite))


def test_readme_script_runs(tmp_path, monkeypatch):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    script = text.split("```python\n", 1)[1].split("```", 1)[0]
    monkeypatch.chdir(tmp_path)
    subprocess.run([sys.executable, "-c", script], check=True, cwd=tmp_path, capture_output=True)
    assert (tmp_path / "out" / "ur10e" / "trajectory.json").exists()
    assert (tmp_path / "out" / "model" / "model.json").exists()
