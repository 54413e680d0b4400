"""Every notebook runs from top to bottom."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
REAL = FOLDER.parent.parent / "shared" / "recordings"
SAID = {"real_machines": "torque_ripple at"}
"""What a notebook must print; usually that its motion is certified."""
PICTURES = {"real_machines": 5}
"""What it must show; usually a figure for every cell that displays one."""


# A kernel's own threads and sockets close after the test; their warnings are not ours.
@pytest.mark.filterwarnings(
    "ignore::ResourceWarning",
    "ignore::DeprecationWarning",
    "ignore::pytest.PytestUnraisableExceptionWarning",
)
@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda p: p.stem)
def test_notebook_runs(path):
    if path.stem == "real_machines" and not REAL.is_dir():
        pytest.skip(f"no real recordings at {REAL}")
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(FOLDER)}}).execute()
    texts = [
        o.get("text", "")
        for cell in notebook.cells
        if cell.cell_type == "code"
        for o in cell.outputs
    ]
    assert any(SAID.get(path.stem, "certified: True") in text for text in texts)
    shown = [
        o.get("data", {})
        for cell in notebook.cells
        if cell.cell_type == "code"
        for o in cell.outputs
    ]
    assert (
        sum("image/png" in data for data in shown)
        == PICTURES.get(path.stem, sum("display(figure)" in cell.source for cell in notebook.cells))
        > 0
    )
