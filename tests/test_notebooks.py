"""Every notebook runs from top to bottom, its exercises' answers included, and is committed without output."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient", reason="the notebooks need the [docs] extra")
nbformat = pytest.importorskip("nbformat", reason="the notebooks need the [docs] extra")

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_has_the_shape_of_a_lesson(path: Path) -> None:
    cells = json.loads(path.read_text())["cells"]
    sources = ["".join(cell["source"]) for cell in cells]
    assert sources[0].startswith("# "), "opens with its title"
    assert "?" in sources[0], "and with its question"
    assert any("cv2." in s for s in sources), "checks itself against OpenCV"
    assert any("## Exercises" in s for s in sources), "ends with exercises"
    answers = [cell for cell in cells if "answer" in cell.get("metadata", {}).get("tags", [])]
    assert answers, "whose answers are tested"
    assert all("assert " in "".join(cell["source"]) for cell in answers)
    assert all(not cell.get("outputs") for cell in cells if cell["cell_type"] == "code"), "committed without output"
