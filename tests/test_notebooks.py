"""The notebooks run from top to bottom, and show what they say."""

from __future__ import annotations

import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
STAR = ROOT / "examples" / "protostar.h5"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_kept_without_their_output(path):
    nbformat = pytest.importorskip("nbformat")
    book = nbformat.read(path, as_version=4)
    nbformat.validate(book)
    assert all(not cell.get("outputs") for cell in book.cells)


@pytest.mark.exhaustive
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(path, tmp_path):
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    shutil.copy(STAR, tmp_path)
    book = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(book, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    shown = [output.get("data", {}) for cell in book.cells for output in cell.get("outputs", ())]
    assert any("image/png" in data for data in shown)
    # A saved notebook shows pictures where no kernel answers widgets.
    assert all("image/png" in data for data in shown if any("widget-view" in kind for kind in data))


def test_the_file_of_the_class_is_that_of_its_script():
    made, kept = (
        runpy.run_path(str(ROOT / "docs" / "class_protostar.py"))["protostar"](),
        vm.open(STAR),
    )
    assert STAR.stat().st_size < 3_000_000
    assert np.array_equal(kept.grid.levels, made.grid.levels)
    for name in made:
        np.testing.assert_allclose(kept.array(name), made.array(name), rtol=1e-5, atol=1e-5)
        assert kept.field_unit(name) == made.field_unit(name)
