"""Every notebook runs from top to bottom."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from slow_tests import slow

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
REAL_RECORDINGS = FOLDER.parent.parent / "shared" / "recordings"
QUICK = ("first_trajectory",)
"""Notebooks that run within seconds."""
EXPECTED_TEXT = {"real_machines": "torque_ripple at"}
"""Text that a notebook prints; usually that its trajectory is certified."""
EXPECTED_FIGURES = {"real_machines": 5}
"""Number of figures that a notebook shows; usually one for every cell that displays one."""


# The kernel's threads and sockets close after the test; their warnings do not concern us.
@pytest.mark.filterwarnings(
    "ignore::ResourceWarning",
    "ignore::DeprecationWarning",
    "ignore::pytest.PytestUnraisableExceptionWarning",
)
@pytest.mark.parametrize(
    "path",
    [p if p.stem in QUICK else slow(p) for p in sorted(FOLDER.glob("*.ipynb"))],
    ids=lambda p: p.stem,
)
def test_notebook_runs(path):
    if path.stem == "real_machines" and not REAL_RECORDINGS.is_dir():
        pytest.skip(f"no real recordings at {REAL_RECORDINGS}")
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(FOLDER)}}).execute()
    texts = [
        o.get("text", "")
        for cell in notebook.cells
        if cell.cell_type == "code"
        for o in cell.outputs
    ]
    assert any(EXPECTED_TEXT.get(path.stem, "certified: True") in text for text in texts)
    shown = [
        o.get("data", {})
        for cell in notebook.cells
        if cell.cell_type == "code"
        for o in cell.outputs
    ]
    assert (
        sum("image/png" in data for data in shown)
        == EXPECTED_FIGURES.get(
            path.stem, sum("display(figure)" in cell.source for cell in notebook.cells)
        )
        > 0
    )
