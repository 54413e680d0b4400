"""Language of the project, and its public interface."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import excite
from excite import api

ROOT = Path(__file__).resolve().parents[1]


def test_the_style_check_has_no_faults():
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "style_check.py")],
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
    assert set(excite.__all__) == set(api.__all__)


@pytest.mark.slow
def test_readme_script_runs(tmp_path, monkeypatch):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    script = text.split("```python\n", 1)[1].split("```", 1)[0]
    monkeypatch.chdir(tmp_path)
    subprocess.run([sys.executable, "-c", script], check=True, cwd=tmp_path, capture_output=True)
    assert (tmp_path / "out" / "ur10e" / "trajectory.json").exists()
    assert (tmp_path / "out" / "model" / "model.json").exists()
